"""What steps cost and use up, exactly, from numbers and numeric facts whose values may differ each time."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, lcm

from rosa_pddl.domain import Domain, Exact, State, Step, UpThing, exact, head_of, numbers_in
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.instances import bound_number, compiled_number, numeric_facts
from rosa_pddl.search import Number, note_signs, value_of
from rosa_pddl.validate import ended, started, text_of


class Numbers(Mapping[str, Exact]):
    """The values of numeric facts such as `(travel_cost a b)` by their text, decimals taken as they are written.

    Those that are given count, or else those of the problem file; UnsupportedPddlError is raised where one is infinite.
    """

    def __init__(self, given: Mapping[str, float | Exact], domain: Domain, in_file: Mapping[str, Exact]) -> None:
        self._given, self._domain, self._in_file = given, domain, in_file

    def __getitem__(self, text: str) -> Exact:
        if text not in self._given:
            return self._in_file[text]
        try:
            return exact(self._given[text])
        except (ValueError, OverflowError) as error:
            message = f"{text} is {self._given[text]}, expected a finite number"
            raise UnsupportedPddlError(message, self._domain.problem_file) from error

    def __iter__(self) -> Iterator[str]:
        return iter({**self._in_file, **self._given})

    def __len__(self) -> int:
        return len({**self._in_file, **self._given})


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
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        values = domain.up_problem.explicit_initial_values.items()
        numeric = [(one, value.constant_value()) for one, value in values if not value.is_bool_constant()]
        self._in_file = {text_of(domain, one, {}): exact(value) for one, value in numeric}
        self._costs: dict[str, Number] = dict.fromkeys(domain.schema_of, 0 if domain.metric == "cost" else 1)
        self._durations: dict[str, Number] = dict.fromkeys(domain.schema_of, 0)
        self._uses: list[dict[str, Number]] = [{} for _ in domain.limited]
        for one in domain.schema_of.values():
            if one.cost is not None:
                self._costs[one.name] = _compiled(domain, one.cost, one.parameters)
            if one.duration is not None:
                self._durations[one.name] = _compiled(domain, one.duration.lower, one.parameters)
            for name, uses in zip(domain.limited, self._uses, strict=True):
                if name in one.uses:
                    uses[one.name] = _compiled(domain, one.uses[name], one.parameters)
        self._limits: dict[str, list[tuple[Number, bool]]] = {f"({name})": [] for name in domain.limited}
        for one in domain.limits:
            amount = bound_number(_compiled(domain, one.arg(1)), ())
            self._limits[text_of(domain, one.arg(0), {})].append((amount, one.is_lt()))
        used = [amount for uses in self._uses for amount in uses.values()]
        self._signs: dict[str, set[int]] = {name: set() for amount in used for name in numeric_facts(amount)}
        for amount in used:
            note_signs(amount, 1, self._signs)

    def cost_of(self, step: Step) -> Number:
        return bound_number(self._costs[step.schema], step.arguments)

    def uses_of(self, step: Step) -> tuple[Number, ...]:
        """Return what a step uses up of each limited resource."""
        return tuple([bound_number(each.get(step.schema, 0), step.arguments) for each in self._uses])

    def duration_of(self, step: Step) -> Number:
        return bound_number(self._durations[step.schema], step.arguments)

    def takes_s(self, step: Step, numbers: Mapping[str, Exact]) -> Exact:
        """Return how long a step takes at least [s]; 0 where that is not known."""
        with suppress(KeyError):
            return value_of(self.duration_of(step), numbers) or 0
        return 0

    def numbers(self, given: Mapping[str, float], state: State = frozenset()) -> Numbers:
        """Return the values of numeric facts: what is given or part of a state, or else those of the problem file."""
        known = {**given, **numbers_in(state)} if self._domain.computed else given
        return Numbers(known, self._domain, self._in_file)

    def value(self, amount: Number, numbers: Mapping[str, Exact]) -> Exact:
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

    def in_turn(
        self, given: Mapping[str, float], state: State, steps: Iterable[Step], begun: int = 0
    ) -> Iterator[tuple[Step, Numbers]]:
        """Yield steps, of which so many have begun, with the numbers as they are when it is their turn."""
        domain = self._domain
        for number, step in enumerate(steps):
            yield step, self.numbers(given, state)
            if domain.computed:
                state = ended(domain, step, state if number < begun else started(domain, step, state))

    def remaining(self, numbers: Numbers) -> tuple[Remaining, ...]:
        """Return what may still be used up of each limited resource."""
        found = []
        for text, limits in self._limits.items():
            used = self.value(("n", text), numbers)
            left = [Remaining(self.value(amount, numbers) - used, is_strict) for amount, is_strict in limits]
            found.append(min(left, key=lambda one: (one.amount, not one.is_strict)))
        return tuple(found)

    def overspent(self, given: Mapping[str, float], steps: Iterable[Step], state: State = frozenset()) -> str | None:
        """Return which limit steps break with some numbers, in words; None if they keep them all."""
        if not self._limits:
            return None
        numbers, used = self.numbers(given, state), list[Exact]([0] * len(self._limits))
        for step in steps:
            for number, one in enumerate(self.uses_of(step)):
                used[number] += self.value(one, numbers)
        for name, amount, left in zip(self._domain.limited, used, self.remaining(numbers), strict=True):
            if left.is_exceeded_by(amount):
                return f"it uses {float(amount):.12g} of {name}, {float(left.amount):.12g} are left"
        return None

    def leave_no_more(self, now: Mapping[str, float], then: Mapping[str, float]) -> bool:
        """Whether what is impossible with some numbers is so with others: no limit leaves more, no step uses less."""
        if now is then or not self._limits:
            return True
        known, before = self.numbers(now), self.numbers(then)
        try:
            limits = zip(self.remaining(before), self.remaining(known), strict=True)
        except UnsupportedPddlError:  # a number is not known, so nothing can be planned
            return now == then
        if any(new.amount > old.amount or new.is_strict < old.is_strict for old, new in limits):
            return False
        only_grow = all(found == {1} for found in self._signs.values())
        pairs = [(known[key], before.get(key)) for key in now if head_of(key) in self._signs]
        return all(new == old or (only_grow and old is not None and new > old) for new, old in pairs)


def usage_of(domain: Domain) -> ResourceUsage:
    if "usage" not in domain.worked_out:
        domain.worked_out["usage"] = ResourceUsage(domain)
    usage: ResourceUsage = domain.worked_out["usage"]
    return usage


def _compiled(domain: Domain, amount: UpThing, parameters: Iterable[tuple[str, str]] = ()) -> Number:
    return compiled_number(domain, amount, {name: place for place, (name, _) in enumerate(parameters)})


def whole(amounts: Iterable[Exact]) -> tuple[list[int], int]:
    """Return amounts as whole numbers, and by what they were multiplied."""
    listed = list(amounts)
    scale = lcm(*{amount.denominator for amount in listed})
    return [int(amount * scale) for amount in listed], scale
