"""What steps use up of the limited resources of a domain, and what of them is left."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, lcm

from rosa_pddl.domain import Domain, Resource, Step, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.sums import (
    ExactNumbers,
    Sum,
    Template,
    arguments_of,
    missing_number,
    numbers_of_the_file,
    template_of,
)
from rosa_pddl.problem import Exact, Problem, exact

__all__ = ["Left", "Uses", "whole"]

_NOTHING = Template(0)


@dataclass(frozen=True)
class Left:
    """What may still be used up of a resource.

    Args:
        amount: so much.
        is_strict: whether it has to be less than that.
    """

    amount: Exact
    is_strict: bool = False

    def is_exceeded_by(self, used: Exact) -> bool:
        """Whether so much is too much."""
        return used > self.amount or (self.is_strict and used == self.amount)

    def whole(self, scale: int) -> int:
        """Return the most that is not too much, of amounts that are whole when multiplied by a scale."""
        scaled = self.amount * scale
        return ceil(scaled) - 1 if self.is_strict else floor(scaled)


class Uses:
    """What the steps of a domain use up of its limited resources, in the order of `domain.limited`.

    Args:
        domain: what `load_domain` returned.

    Raises:
        UnsupportedPddlError: an amount is no sum of numbers and numeric facts.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self._told = dict(numbers_of_the_file(domain))
        self._templates = [
            {name: template_of(domain, amount) for name, amount in resource.uses.items()} for resource in domain.limited
        ]

    def of(self, step: Step) -> tuple[Sum, ...]:
        """Return what a step uses."""
        binding = arguments_of(self._domain.schema_of[step.schema], step)
        return tuple([each.get(step.schema, _NOTHING).bound(binding) for each in self._templates])

    def numbers(self, problem: Problem) -> ExactNumbers:
        """Return the values of numeric facts: those of the problem file, or what the problem says instead.

        Raises:
            UnsupportedPddlError: one is no finite number.
        """
        numbers = dict(self._told)
        for text, value in problem.costs.items():
            try:
                numbers[self._domain.atom(text)] = exact(value)
            except (ValueError, OverflowError) as error:
                message = f"{text} is {value}, expected a finite number"
                raise UnsupportedPddlError(message, self._domain.problem_file) from error
        return numbers

    def left(self, numbers: ExactNumbers) -> tuple[Left, ...]:
        """Return what may still be used up.

        Raises:
            UnsupportedPddlError: a numeric fact has no value.
        """
        return tuple([self._left(resource, numbers) for resource in self._domain.limited])

    def overspent(self, problem: Problem, steps: Iterable[Step]) -> str | None:
        """Return which limit a plan breaks, in words; None if it keeps them all.

        Raises:
            UnsupportedPddlError: a numeric fact has no value.
        """
        numbers = self.numbers(problem)
        used: list[Exact] = [0] * len(self._domain.limited)
        for step in steps:
            for number, one in enumerate(self.of(step)):
                used[number] += self.value(one, numbers)
        for resource, amount, left in zip(self._domain.limited, used, self.left(numbers), strict=True):
            if left.is_exceeded_by(amount):
                return f"it uses {float(amount):.12g} of {resource.name}, {float(left.amount):.12g} are left"
        return None

    def value(self, amount: Sum, numbers: ExactNumbers) -> Exact:
        """Return what a sum comes to.

        Raises:
            UnsupportedPddlError: a numeric fact has no value.
        """
        try:
            return amount.exact_value(numbers)
        except KeyError as error:
            raise missing_number(error, numbers, self._domain.problem_file) from error

    def _left(self, resource: Resource, numbers: ExactNumbers) -> Left:
        used = self._value_of(resource.fluent, numbers)
        left = [Left(self._value_of(limit.amount, numbers) - used, limit.is_strict) for limit in resource.limits]
        return min(left, key=lambda one: (one.amount, not one.is_strict))

    def _value_of(self, amount: UpThing, numbers: ExactNumbers) -> Exact:
        return self.value(template_of(self._domain, amount).bound({}), numbers)


def whole(amounts: Iterable[Exact]) -> tuple[list[int], int]:
    """Return amounts as whole numbers, and by what they were multiplied."""
    listed = list(amounts)
    scale = lcm(*{amount.denominator for amount in listed})
    return [int(amount * scale) for amount in listed], scale
