"""What the numbers of a domain are for, and what steps cost and use up, exactly, by the values that they have."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, lcm
from typing import TypeAlias

from rosa_pddl.domain import Domain, Exact, Schema, State, Step, UpThing, exact, fluents_in, head_of, numbers_in
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.instances import bound_number, compiled_number, numeric_facts
from rosa_pddl.search import Number, value_of
from rosa_pddl.validate import ended, started, text_of

Numbers: TypeAlias = Mapping[str, float | Exact]
"""The values of numeric facts such as `(travel_cost a b)` by their text."""


class NumberUses:
    """Sorts numbers, as unified-planning's fluents, by what is done with them.

    Args:
        schemas: the actions, with all that they do to numbers.
        costs: what they cost.
        derived: the conditions of what is derived.
        goals: what shall hold in the end.

    Attributes:
        rises: of the numbers without arguments that actions only increase, in any case: by how much each action does.
        limits: of the goals those that only limit what is used up.
        resources: of the rising ones what rises by sums of what none changes, no condition or cost reads, and the goal
            only limits: what is used up is added up.
        computed: those that are part of a state: what conditions read, and what is changed.
    """

    def __init__(
        self, schemas: Iterable[Schema], costs: Iterable[UpThing], derived: Iterable[UpThing], goals: Sequence[UpThing]
    ) -> None:
        changes, read = list[tuple[str, UpThing]](), _numbers_of(derived)
        for one in schemas:
            effects = (*one.start_effects, *one.end_effects)
            read |= _numbers_of((*one.start, *one.over_all, *one.end, *(effect.condition for effect in effects)))
            changes += [(one.name, effect) for effect in effects if not effect.fluent.type.is_bool_type()]
        self._changed = {effect.fluent.fluent() for _, effect in changes}
        self.rises: dict[UpThing, dict[str, UpThing]] = {}
        for name, effect in changes:
            if not effect.fluent.args:
                rises = self.rises.setdefault(effect.fluent.fluent(), {})
                rises[name] = effect.value if name not in rises else rises[name] + effect.value
        for _, effect in changes:
            if not _is_rise(effect):
                self.rises.pop(effect.fluent.fluent(), None)
        read |= {effect.fluent.fluent() for _, effect in changes if not self._is_fixed_sum(effect.value)}
        read |= _numbers_of((*costs, *(effect.value for _, effect in changes))) & self._changed
        self.limits = [goal for goal in goals if self._is_limit(goal)]
        read |= _numbers_of(goal for goal in goals if goal not in self.limits)
        self.limits = [goal for goal in self.limits if goal.arg(0).fluent() not in read]
        read |= _numbers_of(goal for goal in goals if goal not in self.limits)
        self.resources = self.rises.keys() - read
        self.computed = read | (self._changed - self.resources)
        self.computed |= _numbers_of(one.value for _, one in changes if one.fluent.fluent() in self.computed)

    def _is_limit(self, goal: UpThing) -> bool:
        if not (goal.is_le() or goal.is_lt()) or not goal.arg(0).is_fluent_exp():
            return False
        return goal.arg(0).fluent() in self.rises and self._is_fixed_sum(goal.arg(1))

    def _is_fixed_sum(self, amount: UpThing) -> bool:
        """Whether an amount is a sum of numbers that no action changes, with constants of 0 or more as factors."""
        if amount.is_constant() or amount.is_fluent_exp():
            return amount.is_constant() or amount.fluent() not in self._changed
        if not (amount.is_plus() or amount.is_minus() or amount.is_times()):
            return False
        factors = [part for part in amount.args if not part.is_constant() or part.constant_value() < 0]
        return not (amount.is_times() and len(factors) > 1) and all(map(self._is_fixed_sum, amount.args))


def _numbers_of(formulas: Iterable[UpThing]) -> set[UpThing]:
    return {one for one in fluents_in(formulas) if not one.type.is_bool_type()}


def _is_rise(change: UpThing) -> bool:
    is_fall = change.value.is_constant() and change.value.constant_value() < 0
    return change.is_increase() and change.condition.is_true() and not change.forall and not is_fall


@dataclass(frozen=True)
class Remaining:
    """What may still be used up of a resource: so much, or less than that where it is strict."""

    amount: Exact
    is_strict: bool = False

    def whole(self, scale: int) -> int:
        """Return the most that is not too much, of amounts that are whole when multiplied by a scale."""
        scaled = self.amount * scale
        return ceil(scaled) - 1 if self.is_strict else floor(scaled)


class ResourceUsage:
    """What the steps of a domain cost, and what they use up of its limited resources, in the order of `domain.limited`.

    A step costs what the metric says, or 1 if there is none. Decimals count as they are written.
    UnsupportedPddlError is raised where a number has no value, or none that is finite.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        values = domain.up_problem.explicit_initial_values.items()
        numeric = [(one, value.constant_value()) for one, value in values if not value.is_bool_constant()]
        self._in_file: dict[str, float | Exact] = {text_of(domain, one, {}): exact(value) for one, value in numeric}
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
        self._used = frozenset(name for amount in used for name in numeric_facts(amount))

    def cost_of(self, step: Step) -> Number:
        return bound_number(self._costs[step.schema], step.arguments)

    def uses_of(self, step: Step) -> tuple[Number, ...]:
        return tuple([bound_number(each.get(step.schema, 0), step.arguments) for each in self._uses])

    def duration_of(self, step: Step) -> Number:
        return bound_number(self._durations[step.schema], step.arguments)

    def takes_s(self, step: Step, numbers: Numbers) -> Exact:
        """Return how long a step takes at least [s]; 0 where that is not known."""
        with suppress(UnsupportedPddlError):
            return self.value(self.duration_of(step), numbers)
        return 0

    def numbers(self, given: Numbers, state: State = frozenset()) -> Numbers:
        """Return the values of numeric facts: what is part of a state or given, or else those of the problem file."""
        in_state: dict[str, float | Exact] = {**numbers_in(state)} if self._domain.computed else {}
        return {**self._in_file, **given, **in_state}

    def known(self, key: str, numbers: Numbers) -> Exact:
        """Return the value of a numeric fact, by its text."""
        try:
            return exact(numbers[key])
        except (ValueError, OverflowError) as error:
            message = f"{key} is {numbers[key]}, expected a finite number"
            raise UnsupportedPddlError(message, self._domain.problem_file) from error
        except KeyError as error:
            message = f"{key} is needed but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the"
            known = nearest(key, list(numbers)[:1000])
            raise UnsupportedPddlError(f"{message} problem ({known})", self._domain.problem_file) from error

    def value(self, amount: Number, numbers: Numbers) -> Exact:
        if isinstance(amount, tuple) and amount[0] == "n":
            return self.known(amount[1], numbers)  # as most are, which is quicker
        value: Exact | None = value_of(amount, {key: self.known(key, numbers) for key in numeric_facts(amount)})
        if value is None:
            message = f"a cost is divided by nothing: {', '.join(numeric_facts(amount))}; state another number"
            raise UnsupportedPddlError(message, self._domain.problem_file)
        return value

    def in_turn(
        self, given: Numbers, state: State, steps: Iterable[Step], begun: int = 0
    ) -> Iterator[tuple[Step, Numbers]]:
        """Yield steps, of which so many have begun, with the numbers as they are when it is their turn."""
        domain, numbers = self._domain, self.numbers(given, state)
        for number, step in enumerate(steps):
            yield step, numbers
            if domain.computed:
                state = ended(domain, step, state if number < begun else started(domain, step, state))
                numbers = self.numbers(given, state)

    def remaining(self, numbers: Numbers) -> tuple[Remaining, ...]:
        found = []
        for text, limits in self._limits.items():
            used = self.known(text, numbers)
            left = [Remaining(self.value(amount, numbers) - used, is_strict) for amount, is_strict in limits]
            found.append(min(left, key=lambda one: (one.amount, not one.is_strict)))
        return tuple(found)

    def overspent(self, given: Numbers, steps: Iterable[Step], state: State = frozenset()) -> str | None:
        """Return which limit steps break with some numbers, in words; None if they keep them all."""
        if not self._limits:
            return None
        numbers, used = self.numbers(given, state), list[Exact]([0] * len(self._limits))
        for step in steps:
            for number, one in enumerate(self.uses_of(step)):
                used[number] += self.value(one, numbers)
        for name, amount, left in zip(self._domain.limited, used, self.remaining(numbers), strict=True):
            if amount > left.amount or (left.is_strict and amount == left.amount):
                return f"it uses {float(amount):.12g} of {name}, {float(left.amount):.12g} are left"
        return None

    def leave_no_more(self, now: Numbers, then: Numbers) -> bool:
        """Whether what is impossible with some numbers is so with others: no limit leaves more, steps use the same."""
        if now is then or not self._limits:
            return True
        known, before = self.numbers(now), self.numbers(then)
        try:
            limits = zip(self.remaining(before), self.remaining(known), strict=True)
        except UnsupportedPddlError:  # a number is not known, so nothing can be planned
            return now == then
        if any(new.amount > old.amount or new.is_strict < old.is_strict for old, new in limits):
            return False
        return all(known[key] == before.get(key) for key in now if head_of(key) in self._used)


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
