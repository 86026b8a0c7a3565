"""What the numbers of a domain are for: costs and resources that steps add up, or what effects change."""

from collections.abc import Iterable, Sequence

from rosa_pddl.domain import Schema, UpThing, fluents_in


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
