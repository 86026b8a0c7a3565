"""Numbers that decide whether there is a plan: limits of resources, and what steps use of them."""

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet

from rosa_pddl.domain import Domain, Step, UpThing, head_of
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.sums import template_of
from rosa_pddl.planning.uses import Left, Uses
from rosa_pddl.problem import Problem, exact

__all__ = ["Bounds"]

Numbers = Mapping[str, float]


class Bounds:
    """The limits of a domain, if it has any.

    Args:
        domain: what `load_domain` returned.

    Raises:
        UnsupportedPddlError: an amount is no sum of numbers and numeric facts.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain, self._uses = domain, Uses(domain)
        self._told = self._uses.numbers(Problem(domain, frozenset()))
        limited = domain.limited
        used = [amount for resource in limited for amount in resource.uses.values()]
        limits = [limit.amount for resource in limited for limit in resource.limits]
        self._used = frozenset(_names(domain, used))
        # a limit on the whole grows when less was used up before
        limiting = [template_of(domain, one).bound({}) for one in (*limits, *(each.fluent for each in limited))]
        self._limiting = frozenset(text for one in limiting for _, text in one.terms)
        self._is_simple = all(_only_grows(amount) for amount in used)

    def overspent(self, steps: Iterable[Step], numbers: Numbers) -> str | None:
        """Return which limit steps break, in words; None if they keep them all."""
        if not self._domain.limited:
            return None
        told = tuple(steps)
        used = {text for step in told for amount in self._uses.of(step) for _, text in amount.terms}
        try:
            return self._uses.overspent(self._asked(numbers, self._limiting | used), told)
        except UnsupportedPddlError:  # what is done without a plan, where a number is not known
            return None

    def leave_no_more(self, now: Numbers, then: Numbers) -> bool:
        """Whether what is impossible with some numbers is so with others: no limit leaves more, no step uses less."""
        if now is then or not self._domain.limited:
            return True
        try:
            before, after = self._left(then), self._left(now)
        except UnsupportedPddlError:  # a number is not known, so nothing can be planned
            return now == then
        if any(
            new.amount > old.amount or new.is_strict < old.is_strict for old, new in zip(before, after, strict=True)
        ):
            return False
        known = {**self._told, **then}
        pairs = [
            (exact(now[key]), exact(known[key]) if key in known else None) for key in now if head_of(key) in self._used
        ]
        return all(new == old or (self._is_simple and old is not None and new > old) for new, old in pairs)

    def _left(self, numbers: Numbers) -> tuple[Left, ...]:
        return self._uses.left(self._uses.numbers(self._asked(numbers, self._limiting)))

    def _asked(self, numbers: Numbers, keys: AbstractSet[str]) -> Problem:
        costs = {key: numbers[key] for key in keys if key in numbers}  # of a large world it is a small part
        return Problem(self._domain, frozenset(), costs=costs)


def _names(domain: Domain, amounts: Iterable[UpThing]) -> Iterator[str]:
    for amount in amounts:
        if amount.is_fluent_exp():
            yield domain.outside[amount.fluent().name]
        else:
            yield from _names(domain, amount.args)


def _only_grows(amount: UpThing) -> bool:
    """Whether an amount can but grow with the numbers that it is made of."""
    if amount.is_constant():
        return bool(amount.constant_value() >= 0)
    if amount.is_fluent_exp():
        return True
    return not amount.is_minus() and all(_only_grows(part) for part in amount.args)
