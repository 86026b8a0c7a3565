"""Evaluates formulas, effects and plans in a state: it validates every plan, whoever made it."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import lru_cache, reduce
from itertools import accumulate, permutations
from math import inf
from typing import NamedTuple

from rosa_pddl.domain import (
    OPERATORS,
    Binding,
    Domain,
    Effect,
    Exact,
    Formula,
    Number,
    State,
    Step,
    atom_text,
    bound,
    exact,
    head_of,
    number_fact,
    numbers_in,
    subject_of,
    text_of,
)
from rosa_pddl.grounding import (
    Rule,
    UnsearchableError,
    binding_of,
    cost_of,
    duration_of,
    layers_of,
)

Facts = AbstractSet[str]
_MOST_STATES = 64
SAME_TIME_S = 1e-6
"""Times that differ by less count as the same: sums of times have rounding errors [s]."""


class TimedStep(NamedTuple):
    """A step of a plan in which steps overlap.

    Args:
        step: what is done.
        start_s: when it starts, from the start of the plan [s].
        duration_s: how long it takes [s]; 0 for an instantaneous action.
    """

    step: Step
    start_s: float
    duration_s: float

    @property
    def end_s(self) -> float:
        """When it ends, from the start of the plan [s]."""
        return self.start_s + self.duration_s


class Values:
    """What atoms and numbers are in a state; derived atoms are worked out when one is asked for.

    Args:
        domain: what `load_domain` returned.
        facts: the true atoms, and the values of numbers that are part of a state.
        numbers: the values of other numbers, where they differ from the problem file.
        derived: the derived atoms, if they are known already.
    """

    def __init__(
        self,
        domain: Domain,
        facts: Facts,
        numbers: Mapping[str, float] | None = None,
        derived: Facts | None = None,
    ) -> None:
        self.domain = domain
        self.facts = facts
        self._others = numbers or {}
        self._in_state: Mapping[str, Exact] | None = None
        self._derived = derived if domain.axioms else frozenset()

    def holds(self, formula: Formula, binding: Binding) -> bool:
        """Whether a formula holds, with objects for its variables."""
        head, *parts = formula
        if head == "atom":
            text = atom_text(parts[0], bound(parts[1], binding))
            return text in self.facts or text in self.derived
        if head == "not":
            return not self.holds(parts[0], binding)
        if head == "same":
            first, second = bound(parts, binding)
            return first == second
        if head in ("forall", "exists"):
            bindings = self.domain.bindings(parts[0], binding)
            results = (self.holds(parts[1], inner) for inner in bindings)
            return all(results) if head == "forall" else any(results)
        if head in ("and", "or"):
            results = (self.holds(part, binding) for part in parts)
            return all(results) if head == "and" else any(results)
        left, right = (self.number(part, binding) for part in parts)
        return left is not None and right is not None and OPERATORS[head](left, right)

    def number(self, number: Number, binding: Binding) -> Exact | None:
        """Return the exact value of a number; None if it, or a part of it, has none."""
        if not isinstance(number, tuple):
            return number  # type: ignore[no-any-return]  # it is exact
        head, *parts = number
        if head == "n":
            return self.value_of(atom_text(parts[0], bound(parts[1], binding)))
        values = [self.number(part, binding) for part in parts]
        if None in values or (head == "/" and 0 in values[1:]):
            return None
        return reduce(OPERATORS[head], values)

    def value_of(self, text: str) -> Exact | None:
        """Return the value of a number such as `(fuel rover)`."""
        if head_of(text) not in self.domain.computed:
            value = self._others.get(text, self.domain.numbers.get(text))
            return None if value is None else exact(value)
        if self._in_state is None:
            self._in_state = _numbers(frozenset(self.facts))
        return self._in_state.get(text)

    @property
    def derived(self) -> Facts:
        """The atoms that follow by the axioms."""
        if self._derived is None:
            self._derived = _derived(self.domain, frozenset(self.facts))
        return self._derived


@lru_cache(_MOST_STATES)
def _numbers(facts: State) -> dict[str, Exact]:
    return numbers_in(facts)


@lru_cache(_MOST_STATES)
def _derived(domain: Domain, facts: State) -> Facts:
    """Derive what follows from facts, layer by layer; checks look at lower layers only."""
    derived = set[str]()
    values = Values(domain, facts, derived=derived)

    def accept(rule: Rule, binding: Binding) -> bool:
        return all(values.holds(check, binding) for check in rule.checks)

    for join in layers_of(domain):
        rows = join.close(join.facts(domain, facts | derived), accept)
        for name in rows.keys() & domain.derived:
            derived.update(atom_text(name, row) for row in rows[name])
    return derived


def goal_holds(domain: Domain, state: Facts, goals: Iterable[Formula] | None = None) -> bool:
    """Whether goals hold in a state; by default the goal of the problem file."""
    values = Values(domain, state)
    return all(values.holds(goal, {}) for goal in (domain.goal if goals is None else goals))


# ---------------------------------------------------------------- one step


def missing_at_start(domain: Domain, step: Step, state: Facts) -> str | None:
    """Return the first condition, as text, that prevents a step from starting; None if none does.

    It supposes that nothing else happens while the step runs: later conditions must hold after
    its start effects.
    """
    schema = domain.schema_of[step.schema]
    missing = missing_of(domain, schema.start, step, state)
    after = started(domain, step, frozenset(state)) if schema.start_effects else state
    return missing or missing_of(domain, schema.over_all + schema.end, step, after)


def missing_meanwhile(domain: Domain, step: Step, state: State) -> str | None:
    """Return the first condition of a running step, as text, that does not hold; None if all do.

    The step's ROSA action must stay feasible at whatever time the file requires it.
    """
    schema = domain.schema_of[step.schema]
    conditions = list(schema.over_all)
    for formula in schema.start + schema.end:
        if formula[0] == "atom" and domain.is_feasibility(f"({formula[1]})"):
            conditions.append(formula)
    return missing_of(domain, conditions, step, state)


def missing_of(domain: Domain, formulas: Iterable[Formula], step: Step, state: Facts) -> str | None:
    """Return the first formula, as text, that does not hold for a step; None if all do."""
    values = Values(domain, state)
    binding = binding_of(domain, step)
    for formula in formulas:
        if not values.holds(formula, binding):
            return text_of(formula, binding)
    return None


def started(domain: Domain, step: Step, state: State) -> State:
    """Return the state after the start of a step."""
    return _after(domain, step, state, is_end=False)


def ended(domain: Domain, step: Step, state: State) -> State:
    """Return the state after the end of a step."""
    return _after(domain, step, state, is_end=True)


def _after(domain: Domain, step: Step, state: State, *, is_end: bool) -> State:
    effects = domain.schema_of[step.schema].effects_at(is_end)
    deleted, added = changes(domain, effects, binding_of(domain, step), state)
    return frozenset((state - deleted) | added)


def changes(
    domain: Domain, effects: Iterable[Effect], binding: Binding, state: Facts
) -> tuple[set[str], set[str]]:
    """Return the facts that effects make false and true; if both, true wins, as in PDDL."""
    values = Values(domain, state)
    added = set[str]()
    deleted = set[str]()
    numbers = dict[str, Exact | None]()
    for effect in effects:
        if effect.is_numeric and effect.name not in domain.computed:
            continue
        for inner in domain.bindings(effect.variables, binding):
            if not values.holds(effect.condition, inner):
                continue
            text = atom_text(effect.name, bound(effect.terms, inner))
            if not effect.is_numeric:
                (added if effect.kind == "add" else deleted).add(text)
                continue
            amount = values.number(effect.amount, inner)
            if effect.kind != "assign" and amount is not None:
                before = numbers.get(text, values.value_of(text))
                sign = 1 if effect.kind == "increase" else -1
                amount = None if before is None else before + sign * amount
            numbers[text] = amount
    for text, value in numbers.items():
        before = values.value_of(text)
        if value is not None:
            if before is not None:
                deleted.add(number_fact(text, before))
            added.add(number_fact(text, value))
    return deleted, added


# ---------------------------------------------------------------- whole plans


class StepEvent(NamedTuple):
    """The start or the end of a step, by its number in the plan."""

    number: int
    is_end: bool


def replay(
    domain: Domain,
    steps: Sequence[Step],
    moments: Iterable[Sequence[StepEvent]],
    state: State,
    running: Iterable[int] = (),
    until: Mapping[str, float] | None = None,
    ends_s: Sequence[float] = (),
) -> tuple[str | None, State]:
    """Replay a plan event by event with the semantics of PDDL 2.1; it validates every plan.

    Conditions at the start or the end must hold just before it; `over all` conditions from just
    after the start until just before the end. Of two events at the same time, neither may change
    what the other needs or changes. End conditions of steps that run already are not checked, as
    the world may make them true. `until` gives how long feasibility facts hold [s]: a step that
    needs one must not end later, by its time in `ends_s` [s], unless a step has made the fact true
    again, at its start at the latest.

    Returns:
        Why the plan cannot be executed, in words, or None; and the true atoms where that ends.
    """
    facts = set(state)
    under_way = list(running)
    begun = frozenset(running)
    left = dict(until or {})
    for moment in moments:
        wrong = _happen(domain, steps, moment, facts, begun, left)
        if wrong is not None:
            return wrong, frozenset(facts)
        for number, _ in moment if left else ():
            late = _too_late(domain, steps[number], ends_s[number], left, facts)
            if late is not None:
                return late, frozenset(facts)
        for number, is_end in moment:
            if is_end:
                under_way.remove(number)
            else:
                under_way.append(number)
        for number in under_way:
            over_all = domain.schema_of[steps[number].schema].over_all
            missing = missing_of(domain, over_all, steps[number], facts)
            if missing is not None:
                return because(domain, steps[number], missing), frozenset(facts)
    return None, frozenset(facts)


def _too_late(
    domain: Domain, step: Step, end_s: float, left: Mapping[str, float], facts: Facts
) -> str | None:
    """Return why a step ends too late for what it needs, or None."""
    gone = {atom for atom, left_s in left.items() if atom in facts and end_s - left_s > SAME_TIME_S}
    conditions = domain.schema_of[step.schema].conditions
    if not gone or missing_of(domain, conditions, step, facts - gone) is None:
        return None
    if missing_of(domain, conditions, step, facts) is not None:
        return None
    needed = gone.intersection(mentioned_atoms(domain, conditions, (), binding_of(domain, step)))
    over_s = end_s - min(left[atom] for atom in needed or gone)
    return f"{step} would end in {end_s:.3g} s, too late by {over_s:.2g} s"


def _happen(
    domain: Domain,
    steps: Sequence[Step],
    moment: Sequence[StepEvent],
    facts: set[str],
    begun: AbstractSet[int],
    left: dict[str, float],
) -> str | None:
    """Apply the events of one moment to facts and times left; return why it cannot be, or None."""
    gone = set[str]()
    come = set[str]()
    touched: list[tuple[int, AbstractSet[str], AbstractSet[str]]] = []
    for number, is_end in moment:
        step = steps[number]
        schema = domain.schema_of[step.schema]
        binding = binding_of(domain, step)
        conditions = schema.end if is_end else schema.start
        if is_end and number in begun:
            conditions = ()
        missing = missing_of(domain, conditions, step, facts)
        if missing is not None:
            return because(domain, step, missing)
        effects = schema.effects_at(is_end)
        deleted, added = changes(domain, effects, binding, facts)
        gone |= deleted
        come |= added
        if len(moment) > 1:
            read = set(mentioned_atoms(domain, conditions, effects, binding))
            touched.append((number, read, {subject_of(fact) for fact in deleted | added}))
    for (number, needed, changed), (other, _, also_changed) in permutations(touched, 2):
        shared = also_changed & (needed | changed)
        if number != other and shared:
            both = f"{steps[number]} and {steps[other]}"
            return f"{both} get in each other's way over {min(shared)}"
    facts -= gone
    facts |= come
    for atom in come & left.keys():
        del left[atom]
    return None


def one_after_the_other(count: int) -> tuple[tuple[StepEvent], ...]:
    """Return the moments of steps that follow one another."""
    events = [StepEvent(number, is_end) for number in range(count) for is_end in (False, True)]
    return tuple((event,) for event in events)


def flaw(
    domain: Domain,
    plan: Iterable[Step | TimedStep],
    state: State,
    goals: Iterable[Formula] | None = None,
    until: Mapping[str, float] | None = None,
    numbers: Mapping[str, float] | None = None,
) -> str | None:
    """Return in words why a plan does not lead from a state to the goal; None if it does.

    Args:
        domain: what `load_domain` returned.
        plan: steps that follow one another, or a schedule whose steps may overlap.
        state: the true atoms at the start.
        goals: the goals, as formulas; by default the goal of the problem file.
        until: how much longer feasibility facts hold, see `Problem` [s].
        numbers: the values of numbers where they differ from the problem file.
    """
    listed = list(plan)
    schedule = [each for each in listed if isinstance(each, TimedStep)]
    steps = [each for each in listed if isinstance(each, Step)]
    planned: Iterable[Sequence[StepEvent]] = one_after_the_other(len(steps))
    ends_s = list(accumulate(takes_s(domain, step, state, numbers) for step in steps))
    if schedule:
        planned = moments(schedule)
        steps = [timed.step for timed in schedule]
        ends_s = [timed.end_s for timed in schedule]
    wrong, facts = replay(domain, steps, planned, state, until=until, ends_s=ends_s)
    if wrong is None and not goal_holds(domain, facts, goals):
        return "the plan does not reach the goal"
    return wrong


def moments(schedule: Sequence[TimedStep]) -> Iterator[list[StepEvent]]:
    """Yield the events of each moment, one moment after the other."""
    events = list[tuple[float, StepEvent]]()
    for number, timed in enumerate(schedule):
        events.append((timed.start_s, StepEvent(number, False)))
        events.append((timed.end_s, StepEvent(number, True)))
    together: list[StepEvent] = []
    began_s = -inf
    for at_s, event in sorted(events):
        if at_s - began_s > SAME_TIME_S:
            if together:
                yield together
            together = []
            began_s = at_s
        together.append(event)
    if together:
        yield together


def because(domain: Domain, step: Step, missing: str, verb: str = "is") -> str:
    """Return in words why a step cannot go on."""
    if step.action is not None and missing == domain.feasible_atom(step.action):
        return f"{step.action} {verb} unfeasible"
    return f"{step} needs {missing}, which does not hold"


# ---------------------------------------------------------------- costs and times


def takes_s(
    domain: Domain, step: Step, state: Facts, numbers: Mapping[str, float] | None = None
) -> float:
    """Return the shortest duration of a step [s]; 0 if it is unknown."""
    value = Values(domain, state, numbers).number(duration_of(domain, step), {})
    return float(value or 0)


def plan_cost(
    domain: Domain, steps: Iterable[Step], state: State, numbers: Mapping[str, float] | None = None
) -> float | None:
    """Return what steps that follow one another cost; None if that is unknown."""
    total = 0.0
    for step in steps:
        try:
            cost = Values(domain, state, numbers).number(cost_of(domain, step), {})
        except UnsearchableError:
            return None
        if cost is None:
            return None
        total += float(cost)
        state = ended(domain, step, started(domain, step, state))
    return total


# ---------------------------------------------------------------- what steps touch


def mentioned_atoms(
    domain: Domain, conditions: Iterable[Formula], effects: Iterable[Effect], binding: Binding
) -> Iterator[str]:
    """Yield the atoms that conditions and the conditions of effects mention."""
    seen = set[str]()
    for formula in conditions:
        yield from _atoms(domain, formula, binding, seen)
    for effect in effects:
        for inner in domain.bindings(effect.variables, binding):
            yield from _atoms(domain, effect.condition, inner, seen)
            if isinstance(effect.amount, tuple):
                yield from _atoms(domain, effect.amount, inner, seen)


def affected_atoms(domain: Domain, effects: Iterable[Effect], binding: Binding) -> Iterator[str]:
    """Yield the atoms that effects may change, whether or not their conditions hold."""
    for effect in effects:
        for inner in domain.bindings(effect.variables, binding):
            yield atom_text(effect.name, bound(effect.terms, inner))


def _atoms(domain: Domain, formula: Formula, binding: Binding, seen: set[str]) -> Iterator[str]:
    head, *parts = formula
    if head in ("atom", "n"):
        text = atom_text(parts[0], bound(parts[1], binding))
        axioms = domain.axioms.get(parts[0].lower())
        if axioms is None:
            yield text
        elif text not in seen:
            seen.add(text)
            for axiom in axioms:
                names = [name for name, _ in axiom.variables]
                arguments = dict(zip(names, text[1:-1].split()[1:], strict=True))
                yield from _atoms(domain, axiom.condition, arguments, seen)
    elif head in ("forall", "exists"):
        for inner in domain.bindings(parts[0], binding):
            yield from _atoms(domain, parts[1], inner, seen)
    elif head != "same":
        for part in parts:
            if isinstance(part, tuple):
                yield from _atoms(domain, part, binding, seen)
