"""What steps cost and use up, in exact sums of numbers and of numeric facts, whose values may differ each time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from math import ceil, floor, lcm
from typing import NamedTuple, TypeAlias

from rosa_pddl.domain import Domain, Exact, Step, UpThing, exact
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.problem import Problem, action_costs
from rosa_pddl.validate import binding_of, text_of

Numbers: TypeAlias = Mapping[str, Exact]
"""The values of numeric facts such as `(travel_cost a b)` by their text, decimals taken as they are written."""


class Sum(NamedTuple):
    """A constant, and numeric facts with their factors; words of these with a mark, such as `?x`, are parameters."""

    constant: Exact
    terms: tuple[tuple[Exact, str], ...] = ()

    def bound(self, binding: Mapping[str, str]) -> "Sum":
        """Return the sum with its parameters replaced by what they are bound to."""
        words = [(factor, text[1:-1].split()) for factor, text in self.terms]
        bound = [(factor, " ".join([binding.get(word, word) for word in some])) for factor, some in words]
        return Sum(self.constant, tuple([(factor, f"({text})") for factor, text in bound]))

    def times(self, factor: Exact) -> "Sum":
        return Sum(factor * self.constant, tuple((factor * weight, text) for weight, text in self.terms))

    def plus(self, other: "Sum") -> "Sum":
        return Sum(self.constant + other.constant, self.terms + other.terms)


@dataclass(frozen=True)
class Remaining:
    """What may still be used up of a resource: so much, or less than that where it is strict."""

    amount: Exact
    is_strict: bool = False

    def is_exceeded_by(self, used: Exact) -> bool:
        return used > self.amount or (self.is_strict and used == self.amount)

    def whole(self, scale: int) -> int:
        """Return the most that is not too much, of amounts that are whole when multiplied by a scale."""
        scaled = self.amount * scale
        return ceil(scaled) - 1 if self.is_strict else floor(scaled)


class ResourceUsage:
    """What the steps of a domain cost, and what they use up of its limited resources, in the order of `domain.limited`.

    A step costs what the metric says, or 1 if there is none. UnsupportedPddlError is raised where an amount is no sum
    of numbers and numeric facts, the metric cannot be kept, or a numeric fact has no value, or none that is finite.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        values = domain.up_problem.explicit_initial_values.items()
        numeric = [(one, value.constant_value()) for one, value in values if not value.is_bool_constant()]
        self._in_file = {text_of(domain, one, {}): exact(value) for one, value in numeric}
        metric = action_costs(domain)
        self._costs: dict[str, Sum] = {}
        for action in domain.up_problem.actions:
            cost = None if metric is None else metric.get_action_cost(action)
            fixed = Sum(1 if metric is None else 0)
            self._costs[domain.outside[action.name]] = fixed if cost is None else sum_of(domain, cost)
        self._uses = [
            {name: sum_of(domain, amount) for name, amount in resource.uses.items()} for resource in domain.limited
        ]

    def cost_of(self, step: Step) -> Sum:
        return self._costs[step.schema].bound(self._binding(step))

    def uses_of(self, step: Step) -> tuple[Sum, ...]:
        """Return what a step uses up of each limited resource."""
        binding, nothing = self._binding(step), Sum(0)
        return tuple([each.get(step.schema, nothing).bound(binding) for each in self._uses])

    def numbers(self, problem: Problem) -> Numbers:
        """Return the values of numeric facts: those of the problem file, or what the problem says instead."""
        numbers = dict(self._in_file)
        for text, value in problem.costs.items():
            try:
                numbers[problem.domain.atom(text)] = exact(value)
            except (ValueError, OverflowError) as error:
                message = f"{text} is {value}, expected a finite number"
                raise UnsupportedPddlError(message, self._domain.problem_file) from error
        return numbers

    def value(self, amount: Sum, numbers: Numbers) -> Exact:
        try:
            return amount.constant + sum([factor * numbers[key] for factor, key in amount.terms])
        except KeyError as error:
            key = str(error.args[0])
            message = f"{key} is needed but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the"
            known = nearest(key, list(numbers)[:1000])
            raise UnsupportedPddlError(f"{message} problem ({known})", self._domain.problem_file) from error

    def total_cost(self, steps: Iterable[Step], numbers: Numbers) -> float:
        return float(sum(self.value(self.cost_of(step), numbers) for step in steps))

    def remaining(self, numbers: Numbers) -> tuple[Remaining, ...]:
        """Return what may still be used up of each limited resource."""
        found = []
        for resource in self._domain.limited:
            used = self._value_of(resource.fluent, numbers)
            left = [Remaining(self._value_of(one.amount, numbers) - used, one.is_strict) for one in resource.limits]
            found.append(min(left, key=lambda one: (one.amount, not one.is_strict)))
        return tuple(found)

    def overspent(self, problem: Problem, steps: Iterable[Step]) -> str | None:
        """Return which limit a plan breaks, in words; None if it keeps them all."""
        numbers = self.numbers(problem)
        used: list[Exact] = [0] * len(self._domain.limited)
        for step in steps:
            for number, one in enumerate(self.uses_of(step)):
                used[number] += self.value(one, numbers)
        for resource, amount, left in zip(self._domain.limited, used, self.remaining(numbers), strict=True):
            if left.is_exceeded_by(amount):
                return f"it uses {float(amount):.12g} of {resource.name}, {float(left.amount):.12g} are left"
        return None

    def _binding(self, step: Step) -> Mapping[str, str]:
        return {f"?{name}": thing for name, thing in binding_of(self._domain, step).items()}

    def _value_of(self, amount: UpThing, numbers: Numbers) -> Exact:
        return self.value(sum_of(self._domain, amount), numbers)


def sum_of(domain: Domain, amount: UpThing) -> Sum:
    """Return an amount, an expression of unified-planning, as a sum, with parameters if it has some."""
    if amount.is_constant():
        return Sum(exact(amount.constant_value()))
    if amount.is_fluent_exp():
        return Sum(0, ((1, text_of(domain, amount, {})),))
    parts = [sum_of(domain, part) for part in amount.args]
    if amount.is_plus():
        return reduce(Sum.plus, parts)
    if amount.is_minus():
        return parts[0].plus(parts[1].times(-1))
    factors = [part for part in parts if not part.terms]
    if amount.is_times() and len(factors) >= len(parts) - 1:
        product = next((part for part in parts if part.terms), Sum(1))
        return reduce(lambda one, factor: one.times(factor.constant), factors, product)
    message = f"the cost {amount} is no sum of numbers and numeric facts; Fast Downward plans with those only"
    raise UnsupportedPddlError(message, domain.file)


def whole(amounts: Iterable[Exact]) -> tuple[list[int], int]:
    """Return amounts as whole numbers, and by what they were multiplied."""
    listed = list(amounts)
    scale = lcm(*{amount.denominator for amount in listed})
    return [int(amount * scale) for amount in listed], scale
