"""What the numbers of a domain are used for, and the exact costs and resource usage of steps."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, floor, lcm
from typing import TypeAlias

from rosa_pddl.domain import (
    Domain,
    Exact,
    Schema,
    State,
    Step,
    UpThing,
    exact,
    fluents_in,
    head_of,
    numbers_in,
)
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.instances import bound_number, compiled_number, numeric_facts
from rosa_pddl.search import Number, value_of
from rosa_pddl.validate import ended, started, text_of

Numbers: TypeAlias = Mapping[str, float | Exact]
"""The values of numeric facts such as `(travel_cost a b)` by their text."""


class NumberUses:
    """Sorts the numbers of a domain, which are fluents of unified-planning, by how they are used.

    Args:
        schemas: the actions, with all their effects on numbers.
        costs: the costs of the actions.
        derived: the conditions of derived predicates.
        goals: the goals.

    Attributes:
        rises: the numbers without arguments that actions only increase, unconditionally: by how much each action does.
        limits: the goals that only limit how much of a resource is used up.
        resources: the numbers of `rises` that no condition or cost reads, that the goal only limits, and that rise by
            sums of numbers that no action changes: their usage can be added up.
        computed: the numbers that are part of a state: those that conditions read, and those that actions change.
    """

    def __init__(
        self,
        schemas: Iterable[Schema],
        costs: Iterable[UpThing],
        derived: Iterable[UpThing],
        goals: Sequence[UpThing],
    ) -> None:
        changes, read = list[tuple[str, UpThing]](), _numbers_of(derived)
        for one in schemas:
            effects = (*one.start_effects, *one.end_effects)
            read |= _numbers_of(
                (*one.start, *one.over_all, *one.end, *(effect.condition for effect in effects))
            )
            changes += [
                (one.name, effect) for effect in effects if not effect.fluent.type.is_bool_type()
            ]
        self._changed = {effect.fluent.fluent() for _, effect in changes}
        self.rises: dict[UpThing, dict[str, UpThing]] = {}
        for name, effect in changes:
            if not effect.fluent.args:
                rises = self.rises.setdefault(effect.fluent.fluent(), {})
                rises[name] = effect.value if name not in rises else rises[name] + effect.value
        for _, effect in changes:
            if not _is_rise(effect):
                self.rises.pop(effect.fluent.fluent(), None)
        read |= {
            effect.fluent.fluent() for _, effect in changes if not self._is_fixed_sum(effect.value)
        }
        read |= _numbers_of((*costs, *(effect.value for _, effect in changes))) & self._changed
        self.limits = [goal for goal in goals if self._is_limit(goal)]
        read |= _numbers_of(goal for goal in goals if goal not in self.limits)
        self.limits = [goal for goal in self.limits if goal.arg(0).fluent() not in read]
        read |= _numbers_of(goal for goal in goals if goal not in self.limits)
        self.resources = self.rises.keys() - read
        self.computed = read | (self._changed - self.resources)
        self.computed |= _numbers_of(
            one.value for _, one in changes if one.fluent.fluent() in self.computed
        )

    def _is_limit(self, goal: UpThing) -> bool:
        if not (goal.is_le() or goal.is_lt()) or not goal.arg(0).is_fluent_exp():
            return False
        return goal.arg(0).fluent() in self.rises and self._is_fixed_sum(goal.arg(1))

    def _is_fixed_sum(self, amount: UpThing) -> bool:
        """Whether an amount is a sum of numbers that no action changes, with constant factors of 0 or more."""
        if amount.is_constant() or amount.is_fluent_exp():
            return amount.is_constant() or amount.fluent() not in self._changed
        if not (amount.is_plus() or amount.is_minus() or amount.is_times()):
            return False
        factors = [
            part for part in amount.args if not part.is_constant() or part.constant_value() < 0
        ]
        return not (amount.is_times() and len(factors) > 1) and all(
            map(self._is_fixed_sum, amount.args)
        )


def _numbers_of(formulas: Iterable[UpThing]) -> set[UpThing]:
    return {one for one in fluents_in(formulas) if not one.type.is_bool_type()}


def _is_rise(change: UpThing) -> bool:
    is_fall = change.value.is_constant() and change.value.constant_value() < 0
    return change.is_increase() and change.condition.is_true() and not change.forall and not is_fall


@dataclass(frozen=True)
class Remaining:
    """How much of a resource may still be used up: at most this amount, or less than it if the limit is strict."""

    amount: Exact
    is_strict: bool = False

    def whole(self, scale: int) -> int:
        """Return the largest allowed amount, multiplied by a scale that makes all amounts whole numbers."""
        scaled = self.amount * scale
        return ceil(scaled) - 1 if self.is_strict else floor(scaled)


class ResourceUsage:
    """The costs of the steps of a domain, and their usage of limited resources in the order of `domain.limited`.

    A step costs what the metric says, or 1 if there is no metric. Decimal numbers are exact.
    UnsupportedPddlError is raised if a number has no value, or an infinite one.
    """

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        values = domain.up_problem.explicit_initial_values.items()
        numeric = [
            (one, value.constant_value()) for one, value in values if not value.is_bool_constant()
        ]
        self._in_file: dict[str, float | Exact] = {
            text_of(domain, one, {}): exact(value) for one, value in numeric
        }
        self._costs: dict[str, Number] = dict.fromkeys(
            domain.schema_of, 0 if domain.metric == "cost" else 1
        )
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
        self._limits: dict[str, list[tuple[Number, bool]]] = {
            f"({name})": [] for name in domain.limited
        }
        for one in domain.limits:
            amount = bound_number(_compiled(domain, one.arg(1)), ())
            self._limits[text_of(domain, one.arg(0), {})].append((amount, one.is_lt()))
        used = [amount for uses in self._uses for amount in uses.values()]
        self._used = frozenset(name for amount in used for name in numeric_facts(amount))

    def cost_of(self, step: Step) -> Number:
        return bound_number(self._costs[step.schema], step.arguments)

    def uses_of(self, step: Step) -> tuple[Number, ...]:
        return tuple(
            [bound_number(each.get(step.schema, 0), step.arguments) for each in self._uses]
        )

    def duration_of(self, step: Step) -> Number:
        return bound_number(self._durations[step.schema], step.arguments)

    def takes_s(self, step: Step, numbers: Numbers) -> Exact:
        """Return the shortest duration of a step [s]; 0 if it is unknown."""
        with suppress(UnsupportedPddlError):
            return self.value(self.duration_of(step), numbers)
        return 0

    def numbers(self, given: Numbers, state: State = frozenset()) -> Numbers:
        """Return the values of numeric facts: from the state, as given, or else from the problem file."""
        in_state: dict[str, float | Exact] = {**numbers_in(state)} if self._domain.computed else {}
        return {**self._in_file, **given, **in_state}

    def known(self, key: str, numbers: Numbers) -> Exact:
        """Return the value of the numeric fact with this text."""
        try:
            return exact(numbers[key])
        except (ValueError, OverflowError) as error:
            message = f"{key} is {numbers[key]}, expected a finite number"
            raise UnsupportedPddlError(message, self._domain.problem_file) from error
        except KeyError as error:
            message = f"{key} is needed but has no value; state '(= {key} NUMBER)' in :init, or hand it in with the"
            known = nearest(key, list(numbers)[:1000])
            raise UnsupportedPddlError(
                f"{message} problem ({known})", self._domain.problem_file
            ) from error

    def value(self, amount: Number, numbers: Numbers) -> Exact:
        if isinstance(amount, tuple) and amount[0] == "n":
            return self.known(amount[1], numbers)  # a shortcut, as most amounts are like this
        value: Exact | None = value_of(
            amount, {key: self.known(key, numbers) for key in numeric_facts(amount)}
        )
        if value is None:
            message = f"a cost is divided by nothing: {', '.join(numeric_facts(amount))}; state another number"
            raise UnsupportedPddlError(message, self._domain.problem_file)
        return value

    def in_turn(
        self, given: Numbers, state: State, steps: Iterable[Step], begun: int = 0
    ) -> Iterator[tuple[Step, Numbers]]:
        """Yield each step with the numbers when its turn comes; the first `begun` steps run already."""
        domain, numbers = self._domain, self.numbers(given, state)
        for number, step in enumerate(steps):
            yield step, numbers
            if domain.computed:
                state = ended(
                    domain, step, state if number < begun else started(domain, step, state)
                )
                numbers = self.numbers(given, state)

    def remaining(self, numbers: Numbers) -> tuple[Remaining, ...]:
        found = []
        for text, limits in self._limits.items():
            used = self.known(text, numbers)
            left = [
                Remaining(self.value(amount, numbers) - used, is_strict)
                for amount, is_strict in limits
            ]
            found.append(min(left, key=lambda one: (one.amount, not one.is_strict)))
        return tuple(found)

    def overspent(
        self, given: Numbers, steps: Iterable[Step], state: State = frozenset()
    ) -> str | None:
        """Return in words which limit the steps break with the given numbers; None if they keep all limits."""
        if not self._limits:
            return None
        numbers, used = self.numbers(given, state), list[Exact]([0] * len(self._limits))
        for step in steps:
            for number, one in enumerate(self.uses_of(step)):
                used[number] += self.value(one, numbers)
        for name, amount, left in zip(
            self._domain.limited, used, self.remaining(numbers), strict=True
        ):
            if amount > left.amount or (left.is_strict and amount == left.amount):
                return f"it uses {float(amount):.12g} of {name}, {float(left.amount):.12g} are left"
        return None

    def leave_no_more(self, now: Numbers, then: Numbers) -> bool:
        """Whether what was impossible then is impossible now: no limit leaves more, and steps use the same."""
        if now is then or not self._limits:
            return True
        known, before = self.numbers(now), self.numbers(then)
        try:
            limits = zip(self.remaining(before), self.remaining(known), strict=True)
        except UnsupportedPddlError:  # with an unknown number nothing can be planned
            return now == then
        if any(new.amount > old.amount or new.is_strict < old.is_strict for old, new in limits):
            return False
        return all(known[key] == before.get(key) for key in now if head_of(key) in self._used)


def usage_of(domain: Domain) -> ResourceUsage:
    if "usage" not in domain.worked_out:
        domain.worked_out["usage"] = ResourceUsage(domain)
    usage: ResourceUsage = domain.worked_out["usage"]
    return usage


def _compiled(
    domain: Domain, amount: UpThing, parameters: Iterable[tuple[str, str]] = ()
) -> Number:
    return compiled_number(
        domain, amount, {name: place for place, (name, _) in enumerate(parameters)}
    )


def whole(amounts: Iterable[Exact]) -> tuple[list[int], int]:
    """Return the amounts multiplied by a factor that makes them whole numbers, and this factor."""
    listed = list(amounts)
    scale = lcm(*{amount.denominator for amount in listed})
    return [int(amount * scale) for amount in listed], scale
