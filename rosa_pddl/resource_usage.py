"""What steps cost and use up, exactly, from numbers and numeric facts whose values may differ each time."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import ceil, floor, lcm
from typing import TypeAlias

from rosa_pddl.domain import Domain, Exact, Step, UpThing, exact, numbers_in
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.instances import bound_number, compiled_number, numeric_facts
from rosa_pddl.problem import Problem
from rosa_pddl.search import Number, value_of
from rosa_pddl.validate import ended, started, text_of

Numbers: TypeAlias = Mapping[str, Exact]
"""The values of numeric facts such as `(travel_cost a b)` by their text, decimals taken as they are written."""


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

    A step costs what the metric says, or 1 if there is none. UnsupportedPddlError is raised where a number has no
    value, or none that is finite.

    Attributes:
        uses: what each action uses up of each, with its parameters.
        limits: what each may come to at most, and whether so much is too much.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        values = domain.up_problem.explicit_initial_values.items()
        numeric = [(one, value.constant_value()) for one, value in values if not value.is_bool_constant()]
        self._in_file = {text_of(domain, one, {}): exact(value) for one, value in numeric}
        self._costs: dict[str, Number] = dict.fromkeys(domain.schema_of, 0 if domain.metric == "cost" else 1)
        for schema in domain.schema_of.values():
            if schema.cost is not None:
                self._costs[schema.name] = _compiled(domain, schema.cost, schema.parameters)
        self.uses: list[dict[str, Number]] = [
            {
                one.name: _compiled(domain, one.uses[name], one.parameters)
                for one in domain.schema_of.values()
                if name in one.uses
            }
            for name in domain.limited
        ]
        self.limits: dict[str, list[tuple[Number, bool]]] = {f"({name})": [] for name in domain.limited}
        for one in domain.limits:
            amount = bound_number(_compiled(domain, one.arg(1)), ())
            self.limits[text_of(domain, one.arg(0), {})].append((amount, one.is_lt()))

    def cost_of(self, step: Step) -> Number:
        return bound_number(self._costs[step.schema], step.arguments)

    def uses_of(self, step: Step) -> tuple[Number, ...]:
        """Return what a step uses up of each limited resource."""
        return tuple([bound_number(each.get(step.schema, 0), step.arguments) for each in self.uses])

    def numbers(self, problem: Problem) -> Numbers:
        """Return the values of numeric facts: those of the problem file, or what the problem says instead."""
        numbers = dict(self._in_file)
        for text, value in problem.costs.items():
            try:
                numbers[problem.domain.atom(text)] = exact(value)
            except (ValueError, OverflowError) as error:
                message = f"{text} is {value}, expected a finite number"
                raise UnsupportedPddlError(message, self._domain.problem_file) from error
        return {**numbers, **numbers_in(problem.state)} if self._domain.computed else numbers

    def value(self, amount: Number, numbers: Numbers) -> Exact:
        try:
            value: Exact | None = value_of(amount, numbers)
        except KeyError as error:
            key = str(error.args[0])
            message = f"{key} is needed but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the"
            known = nearest(key, list(numbers)[:1000])
            raise UnsupportedPddlError(f"{message} problem ({known})", self._domain.problem_file) from error
        if value is None:
            message = f"a cost is divided by nothing: {', '.join(numeric_facts(amount))}; state another number"
            raise UnsupportedPddlError(message, self._domain.problem_file)
        return value

    def costs(self, problem: Problem, steps: Iterable[Step], numbers: Numbers, begun: int = 0) -> Iterator[Exact]:
        """Yield what steps, of which so many have begun, cost in turn, as the numbers of the state are then."""
        domain, state = problem.domain, problem.state
        for number, step in enumerate(steps):
            yield self.value(self.cost_of(step), {**numbers, **numbers_in(state)} if domain.computed else numbers)
            if domain.computed:
                state = ended(domain, step, state if number < begun else started(domain, step, state))

    def remaining(self, numbers: Numbers) -> tuple[Remaining, ...]:
        """Return what may still be used up of each limited resource."""
        found = []
        for text, limits in self.limits.items():
            used = self.value(("n", text), numbers)
            left = [Remaining(self.value(amount, numbers) - used, is_strict) for amount, is_strict in limits]
            found.append(min(left, key=lambda one: (one.amount, not one.is_strict)))
        return tuple(found)

    def overspent(self, problem: Problem, steps: Iterable[Step]) -> str | None:
        """Return which limit a plan breaks, in words; None if it keeps them all."""
        numbers = self.numbers(problem)
        used: list[Exact] = [0] * len(self._domain.limited)
        for step in steps:
            for number, one in enumerate(self.uses_of(step)):
                used[number] += self.value(one, numbers)
        for name, amount, left in zip(self._domain.limited, used, self.remaining(numbers), strict=True):
            if left.is_exceeded_by(amount):
                return f"it uses {float(amount):.12g} of {name}, {float(left.amount):.12g} are left"
        return None


def _compiled(domain: Domain, amount: UpThing, parameters: Iterable[tuple[str, str]] = ()) -> Number:
    return compiled_number(domain, amount, {name: place for place, (name, _) in enumerate(parameters)})


def whole(amounts: Iterable[Exact]) -> tuple[list[int], int]:
    """Return amounts as whole numbers, and by what they were multiplied."""
    listed = list(amounts)
    scale = lcm(*{amount.denominator for amount in listed})
    return [int(amount * scale) for amount in listed], scale
