"""Evaluates formulas, effects and plans in a state: it validates every plan, independently of the planner."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from fractions import Fraction
from functools import lru_cache, reduce
from itertools import accumulate, groupby, permutations
from math import inf
from operator import add, mul, sub
from typing import NamedTuple

from rosa_pddl.domain import (
    Domain,
    Exact,
    State,
    Step,
    TimedStep,
    UpThing,
    exact,
    number_fact,
    numbers_in,
    subject_of,
)

Binding = Mapping[str, str]
Facts = AbstractSet[str]

_MOST_STATES = 64
SAME_TIME_S = 1e-6
"""Times that differ by less count as the same, because sums of an engine's times have rounding errors [s]."""


def goal_holds(domain: Domain, state: Facts, goals: Iterable[UpThing] | None = None) -> bool:
    """Whether goals, as unified-planning expressions, hold in a state; by default the goal of the problem file."""
    return all(
        holds(domain, goal, {}, state)
        for goal in (domain.up_problem.goals if goals is None else goals)
    )


def missing_at_start(domain: Domain, step: Step, state: Facts) -> str | None:
    """Return the first condition, as text, that prevents a step from starting; None if it can start.

    It supposes that nothing else happens while the step runs: later conditions must hold after its start effects.
    """
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    after = _after(domain, schema.start_effects, binding, state) if schema.start_effects else state
    missing = missing_of(domain, schema.start, binding, state)
    return missing or missing_of(domain, schema.over_all + schema.end, binding, after)


def missing_meanwhile(domain: Domain, step: Step, state: State) -> str | None:
    """Return the first `over all` condition of a running step, as text, that does not hold in a state; None if all do.

    The step's ROSA action must stay feasible at whatever time the file requires it, as the execution takes time.
    """
    schema = domain.schema_of[step.schema]
    timely = [formula for formula in schema.start + schema.end if _is_feasibility(domain, formula)]
    return missing_of(domain, (*schema.over_all, *timely), binding_of(domain, step), state)


def missing_at_end(domain: Domain, step: Step, state: State) -> str | None:
    return missing_of(domain, domain.schema_of[step.schema].end, binding_of(domain, step), state)


def started(domain: Domain, step: Step, state: State) -> State:
    return _after(
        domain, domain.schema_of[step.schema].start_effects, binding_of(domain, step), state
    )


def ended(domain: Domain, step: Step, state: State) -> State:
    return _after(
        domain, domain.schema_of[step.schema].end_effects, binding_of(domain, step), state
    )


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
    """Replay a plan event by event with the semantics of PDDL 2.1; every plan is validated by this.

    Conditions at the start or the end must hold just before it; `over all` conditions from just after the start until
    just before the end. Of two events at the same time, neither may change what the other needs or changes.
    End conditions of steps that run already are not checked, as the world may make them true.
    `until` gives how long feasibility facts hold [s]: a step that needs one must not end later, by its time in `ends_s`
    [s], unless an earlier step has made the fact true again.

    Returns:
        Why the plan cannot be executed, in words, or None; and the true atoms at its end, or where it failed.
    """
    facts, under_way, begun, left = set(state), list(running), frozenset(running), dict(until or {})
    for moment in moments:
        late = (
            _too_late(domain, steps[number], ends_s[number], left, facts)
            for number, _ in moment
            if left
        )
        too_late = next(filter(None, late), None)
        wrong = _happen(domain, steps, moment, facts, begun, left) or too_late
        for number, is_end in moment:
            if is_end:
                under_way.remove(number)
            else:
                under_way.append(number)
        for number in under_way if wrong is None else ():
            schema, binding = (
                domain.schema_of[steps[number].schema],
                binding_of(domain, steps[number]),
            )
            missing = missing_of(domain, schema.over_all, binding, facts)
            if missing is not None:
                wrong = because(domain, steps[number], missing)
                break
        if wrong is not None:
            return wrong, frozenset(facts)
    return None, frozenset(facts)


def _too_late(
    domain: Domain, step: Step, end_s: float, left: Mapping[str, float], facts: Facts
) -> str | None:
    gone = {atom for atom, left_s in left.items() if atom in facts and end_s - left_s > SAME_TIME_S}
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    for formula in (*schema.start, *schema.over_all, *schema.end) if gone else ():
        if holds(domain, formula, binding, facts) and not holds(
            domain, formula, binding, facts - gone
        ):
            over_s = end_s - min(
                left[atom] for atom in gone.intersection(_atoms(domain, formula, binding))
            )
            return f"{step} would end in {end_s:.3g} s, too late by {over_s:.2g} s"
    return None


def _happen(
    domain: Domain,
    steps: Sequence[Step],
    moment: Sequence[StepEvent],
    facts: set[str],
    begun: AbstractSet[int],
    left: dict[str, float],
) -> str | None:
    """Apply the events of one moment to the facts and to their times left; return why that is impossible, or None."""
    gone, come = set[str](), set[str]()
    touched: list[tuple[int, AbstractSet[str], AbstractSet[str]]] = []
    for number, is_end in moment:
        step = steps[number]
        schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
        conditions = () if is_end and number in begun else schema.end if is_end else schema.start
        effects = schema.end_effects if is_end else schema.start_effects
        missing = missing_of(domain, conditions, binding, facts)
        if missing is not None:
            return because(domain, step, missing)
        deleted, added = changes(domain, effects, binding, facts)
        gone |= deleted
        come |= added
        if len(moment) > 1:
            read = set(mentioned_atoms(domain, conditions, effects, binding))
            touched.append((number, read, set(map(subject_of, deleted | added))))
    for (one, needed, changed), (other, _, changed_too) in permutations(touched, 2):
        if one != other and changed_too & (needed | changed):
            atom = min(changed_too & (needed | changed))
            return f"{steps[one]} and {steps[other]} get in each other's way over {atom}"
    facts -= gone
    facts |= come
    for atom in come & left.keys():
        del left[atom]
    return None


def one_after_the_other(count: int) -> tuple[tuple[StepEvent], ...]:
    return tuple(
        (StepEvent(number, is_end),) for number in range(count) for is_end in (False, True)
    )


def flaw(
    domain: Domain,
    steps: Iterable[Step],
    state: State,
    goals: Iterable[UpThing] | None = None,
    until: Mapping[str, float] | None = None,
    ends_s: Sequence[float] = (),
) -> str | None:
    """Return in words why a plan does not lead from a state to the goal; None if it does.

    Args:
        domain: what `load_domain` returned.
        steps: the plan; its steps follow one another.
        state: the true atoms at the start.
        goals: the goals, as unified-planning expressions; by default the goal of the problem file.
        until: how much longer feasibility facts hold, see `Problem` [s].
        ends_s: when each step ends [s]; by default from the declared durations, see `Domain.duration_s`.
    """
    listed = tuple(steps)
    ends_s = ends_s or tuple(accumulate(domain.duration_s(step.schema) for step in listed))
    wrong, facts = replay(
        domain, listed, one_after_the_other(len(listed)), state, until=until, ends_s=ends_s
    )
    return wrong or (
        None if goal_holds(domain, facts, goals) else "the rest of the plan does not reach the goal"
    )


def schedule_flaw(
    domain: Domain,
    schedule: Sequence[TimedStep],
    state: State,
    goals: Iterable[UpThing] | None = None,
    until: Mapping[str, float] | None = None,
) -> str | None:
    """Return why a schedule, whose steps may overlap, does not lead from a state to the goal; like `flaw`."""
    for timed in schedule:
        if not _lasts_as_declared(domain, timed):
            return f"{timed.step} takes {timed.duration_s:g} s, which is not its duration"
    steps = [timed.step for timed in schedule]
    ends_s = [timed.end_s for timed in schedule]
    wrong, facts = replay(domain, steps, moments(schedule), state, until=until, ends_s=ends_s)
    return wrong or (
        None if goal_holds(domain, facts, goals) else "the plan does not reach the goal"
    )


def _lasts_as_declared(domain: Domain, timed: TimedStep) -> bool:
    """Whether a step lasts as long as declared; durations that depend on numeric facts are not checked."""
    duration = domain.schema_of[timed.step.schema].duration
    if duration is None:
        return timed.duration_s == 0.0
    lower, upper = duration.lower, duration.upper
    least = float(lower.constant_value()) if lower.is_constant() else 0.0
    most = float(upper.constant_value()) if upper.is_constant() else timed.duration_s
    return least - SAME_TIME_S <= timed.duration_s <= most + SAME_TIME_S and timed.duration_s > 0.0


def moments(schedule: Sequence[TimedStep]) -> Iterator[list[StepEvent]]:
    """Yield the events of each moment, one moment after the other."""
    dated = [(timed.start_s, StepEvent(number, False)) for number, timed in enumerate(schedule)]
    dated += [(timed.end_s, StepEvent(number, True)) for number, timed in enumerate(schedule)]
    together: list[StepEvent] = []
    began_s = -inf
    for at_s, event in sorted(dated):
        if together and at_s - began_s > SAME_TIME_S:
            yield together
            together = []
        if not together:
            began_s = at_s
        together.append(event)
    yield together


def because(domain: Domain, step: Step, missing: str, verb: str = "is") -> str:
    if step.action is not None and missing == domain.feasible_atom(step.action):
        return f"{step.action} {verb} unfeasible"
    return f"{step} needs {missing}, which does not hold"


def _is_feasibility(domain: Domain, formula: UpThing) -> bool:
    return bool(formula.is_fluent_exp()) and domain.is_feasibility(
        f"({domain.outside[formula.fluent().name]})"
    )


def binding_of(domain: Domain, step: Step) -> Binding:
    names = (name for name, _ in domain.schema_of[step.schema].parameters)
    return dict(zip(names, step.arguments, strict=True))


def missing_of(
    domain: Domain, formulas: Iterable[UpThing], binding: Binding, state: Facts
) -> str | None:
    for formula in formulas:
        if not holds(domain, formula, binding, state):
            return text_of(domain, formula, binding)
    return None


def holds(domain: Domain, formula: UpThing, binding: Binding, state: Facts) -> bool:
    if formula.is_fluent_exp():
        text = text_of(domain, formula, binding)
        is_open = domain.axiom(formula) is not None and not isinstance(state, _Derived)
        return text in (_derived(domain, frozenset(state)) if is_open else state)
    if formula.is_bool_constant():
        return bool(formula.constant_value())
    if formula.is_equals() and formula.arg(0).type.is_user_type():
        left, right = (text_of(domain, side, binding) for side in formula.args)
        return left == right
    if formula.is_equals() or formula.is_le() or formula.is_lt():
        one, other = (value_of(domain, side, binding, state) for side in formula.args)
        if one is None or other is None:
            return False
        return (
            one == other
            if formula.is_equals()
            else one <= other
            if formula.is_le()
            else one < other
        )
    if formula.is_exists() or formula.is_forall():
        bindings = domain.bindings(formula.variables(), binding)
        results = (holds(domain, formula.arg(0), inner, state) for inner in bindings)
        return any(results) if formula.is_exists() else all(results)
    parts = [holds(domain, part, binding, state) for part in formula.args]
    if formula.is_and() or formula.is_or():
        return all(parts) if formula.is_and() else any(parts)
    if formula.is_not() or formula.is_implies():
        return not parts[0] or any(parts[1:])
    assert formula.is_iff(), f"the reader let an unsupported formula through: {formula}"
    return parts[0] == parts[1]


class _Derived(set[str]):
    """A state with the atoms that have been derived from it so far."""


@lru_cache(_MOST_STATES)
def _derived(domain: Domain, state: State) -> AbstractSet[str]:
    """Return a state with all derived atoms, computed layer by layer until nothing more follows."""
    found = _Derived(state)
    for _, layer in groupby(
        sorted(domain.axioms.items(), key=lambda one: one[1].layer), lambda one: one[1].layer
    ):
        left = [
            (domain.inside["predicate", name], one.condition, binding)
            for name, one in layer
            for binding in domain.bindings((variable.variable() for variable in one.variables), {})
        ]
        while new := [one for one in left if holds(domain, *one[1:], found)]:
            found.update(
                f"({' '.join([domain.outside[name], *binding.values()])})"
                for name, _, binding in new
            )
            left = [one for one in left if one not in new]
    return found


def value_of(domain: Domain, number: UpThing, binding: Binding, state: Facts) -> Exact | None:
    """Return the exact value of a number in a state; None if it, or a part of it, has no value."""
    if number.is_constant():
        return exact(Fraction(number.constant_value()))
    if number.is_fluent_exp():
        text = text_of(domain, number, binding)
        start = f"(= {text} "
        return numbers_in(fact for fact in state if fact.startswith(start)).get(text)
    parts = [value_of(domain, part, binding, state) for part in number.args]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or (number.is_div() and not known[1]):
        return None
    return reduce(_COMPUTED[number.node_type.name], known)


def _after(domain: Domain, effects: Iterable[UpThing], binding: Binding, state: Facts) -> State:
    deleted, added = changes(domain, effects, binding, state)
    return frozenset((state - deleted) | added)


def changes(
    domain: Domain, effects: Iterable[UpThing], binding: Binding, state: Facts
) -> tuple[AbstractSet[str], AbstractSet[str]]:
    """Return the atoms that the effects of one moment make false and true; if both, true wins, as in PDDL."""
    added, deleted = set[str](), set[str]()
    numbers = dict[str, tuple[Exact | None, Exact | None]]()
    for effect in effects:
        for inner in domain.bindings(effect.forall, binding) if effect.forall else (binding,):
            if holds(domain, effect.condition, inner, state):
                text = text_of(domain, effect.fluent, inner)
                if effect.fluent.fluent().type.is_bool_type():
                    (added if holds(domain, effect.value, inner, state) else deleted).add(text)
                    continue
                before = value_of(domain, effect.fluent, inner, state)
                _, now = numbers.get(text, (before, before))
                numbers[text] = (
                    before,
                    _changed(effect, now, value_of(domain, effect.value, inner, state)),
                )
    for text, (before, now) in numbers.items():
        if now is not None:
            deleted |= set() if before is None else {number_fact(text, before)}
            added.add(number_fact(text, now))
    return deleted, added


def _changed(effect: UpThing, now: Exact | None, amount: Exact | None) -> Exact | None:
    if effect.is_assignment() or now is None or amount is None:
        return amount if effect.is_assignment() else None
    return now + amount if effect.is_increase() else now - amount


def mentioned_atoms(
    domain: Domain, conditions: Iterable[UpThing], effects: Iterable[UpThing], binding: Binding
) -> Iterator[str]:
    """Yield the atoms that conditions and the conditions of effects mention."""
    for formula in conditions:
        yield from _atoms(domain, formula, binding)
    for effect in effects:
        for inner in domain.bindings(effect.forall, binding):
            yield from _atoms(domain, effect.condition, inner)
            yield from _atoms(domain, effect.value, inner)


def affected_atoms(domain: Domain, effects: Iterable[UpThing], binding: Binding) -> Iterator[str]:
    """Yield the atoms that effects may change, whether or not their conditions hold."""
    for effect in effects:
        for inner in domain.bindings(effect.forall, binding):
            yield text_of(domain, effect.fluent, inner)


def _atoms(
    domain: Domain, formula: UpThing, binding: Binding, seen: set[str] | None = None
) -> Iterator[str]:
    seen = set() if seen is None else seen
    if formula.is_fluent_exp():
        text, axiom = text_of(domain, formula, binding), domain.axiom(formula)
        if axiom is None:
            yield text
        elif text not in seen:
            seen.add(text)
            names = [one.variable().name for one in axiom.variables]
            yield from _atoms(
                domain, axiom.condition, dict(zip(names, text[1:-1].split()[1:], strict=True)), seen
            )
    elif formula.is_exists() or formula.is_forall():
        for inner in domain.bindings(formula.variables(), binding):
            yield from _atoms(domain, formula.arg(0), inner, seen)
    else:
        for part in formula.args:
            yield from _atoms(domain, part, binding, seen)


def text_of(domain: Domain, formula: UpThing, binding: Binding) -> str:
    """Return a formula as PDDL text in the names of the files, with its parameters replaced by their bindings."""
    if formula.is_parameter_exp():
        return binding.get(formula.parameter().name, f"?{formula.parameter().name}")
    if formula.is_variable_exp():
        return binding.get(formula.variable().name, f"?{formula.variable().name}")
    if formula.is_object_exp():
        return domain.outside[formula.object().name]
    if formula.is_bool_constant():
        return "(and)" if formula.is_true() else "(or)"
    if formula.is_constant():
        return str(formula.constant_value())
    parts = [text_of(domain, part, binding) for part in formula.args]
    if formula.is_iff():
        return f"(and (imply {parts[0]} {parts[1]}) (imply {parts[1]} {parts[0]}))"
    if formula.is_fluent_exp():
        head = domain.outside[formula.fluent().name]
    else:
        head = _HEADS.get(formula.node_type.name, formula.node_type.name.lower())
    if formula.is_exists() or formula.is_forall():
        variables = (
            f"?{one.name} - {domain.outside[one.type.name]}" for one in formula.variables()
        )
        parts.insert(0, f"({' '.join(variables)})")
    return "(" + " ".join([head, *parts]) + ")"


_HEADS = {
    **{"EQUALS": "=", "IMPLIES": "imply", "LE": "<=", "LT": "<"},
    **{"PLUS": "+", "MINUS": "-", "TIMES": "*", "DIV": "/"},
}
_COMPUTED = {
    "PLUS": add,
    "MINUS": sub,
    "TIMES": mul,
    "DIV": lambda one, other: Fraction(one) / other,
}
