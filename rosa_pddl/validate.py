"""What a formula, an effect and a plan mean in a state: the judge of every plan, independent of the planner."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import product

from rosa_pddl.domain import Domain, State, Step, UpThing

Binding = Mapping[str, str]


def goal_holds(domain: Domain, state: State) -> bool:
    """Whether the goal of the problem file holds in a state."""
    return all(_holds(domain, goal, {}, state) for goal in domain.up_problem.goals)


def missing_at_start(domain: Domain, step: Step, state: State) -> str | None:
    """Return the first condition that keeps a step from starting, as text; None if it can start.

    As nothing else happens while a step runs, what must hold later must hold once its effects at start are so.
    """
    schema, binding = domain.schema_of[step.schema], _binding(domain, step)
    missing = _missing(domain, schema.start, binding, state)
    if missing is not None:
        return missing
    return _missing(domain, schema.over_all + schema.end, binding, started(domain, step, state))


def missing_meanwhile(domain: Domain, step: Step, state: State) -> str | None:
    """Return the first `over all` condition that does not hold in the state of a running step, as text.

    That the ROSA action of the step is feasible is watched however the condition is timed: doing it takes time.
    """
    schema = domain.schema_of[step.schema]
    timely = [formula for formula in schema.start + schema.end if _is_feasibility(domain, formula)]
    return _missing(domain, (*schema.over_all, *timely), _binding(domain, step), state)


def missing_at_end(domain: Domain, step: Step, state: State) -> str | None:
    """Return the first condition that keeps a running step from ending well, as text."""
    return _missing(domain, domain.schema_of[step.schema].end, _binding(domain, step), state)


def started(domain: Domain, step: Step, state: State) -> State:
    """Return the state after the effects at the start of a step."""
    return _after(domain, domain.schema_of[step.schema].start_effects, _binding(domain, step), state)


def ended(domain: Domain, step: Step, state: State) -> State:
    """Return the state of a running step after the effects at its end."""
    return _after(domain, domain.schema_of[step.schema].end_effects, _binding(domain, step), state)


def flaw(domain: Domain, steps: Iterable[Step], state: State) -> str | None:
    """Why a plan does not lead from a state to the goal, in words; None if it does."""
    for step in steps:
        missing = missing_at_start(domain, step, state)
        if missing is not None:
            return because(domain, step, missing)
        state = ended(domain, step, started(domain, step, state))
    return None if goal_holds(domain, state) else "the rest of the plan does not reach the goal"


def because(domain: Domain, step: Step, missing: str, verb: str = "is") -> str:
    """Turn a missing condition into a reason to plan anew."""
    if step.action is not None and missing == domain.feasible_atom(step.action):
        return f"{step.action} {verb} unfeasible"
    return f"{step} needs {missing}, which does not hold"


def _is_feasibility(domain: Domain, formula: UpThing) -> bool:
    return bool(formula.is_fluent_exp()) and domain.is_feasibility(f"({domain.outside[formula.fluent().name]})")


def _binding(domain: Domain, step: Step) -> Binding:
    names = (name for name, _ in domain.schema_of[step.schema].parameters)
    return dict(zip(names, step.arguments, strict=True))


def _missing(domain: Domain, formulas: Iterable[UpThing], binding: Binding, state: State) -> str | None:
    for formula in formulas:
        if not _holds(domain, formula, binding, state):
            return _text(domain, formula, binding)
    return None


def _holds(domain: Domain, formula: UpThing, binding: Binding, state: State) -> bool:
    if formula.is_fluent_exp():
        return _text(domain, formula, binding) in state
    if formula.is_bool_constant():
        return bool(formula.constant_value())
    if formula.is_equals():
        left, right = (_text(domain, side, binding) for side in formula.args)
        return left == right
    if formula.is_exists() or formula.is_forall():
        bindings = _bindings(domain, formula.variables(), binding)
        results = (_holds(domain, formula.arg(0), inner, state) for inner in bindings)
        return any(results) if formula.is_exists() else all(results)
    return _connective(formula, [_holds(domain, part, binding, state) for part in formula.args])


def _connective(formula: UpThing, parts: list[bool]) -> bool:
    if formula.is_and():
        return all(parts)
    if formula.is_or():
        return any(parts)
    if formula.is_not():
        return not parts[0]
    if formula.is_implies():
        return not parts[0] or parts[1]
    if formula.is_iff():
        return parts[0] == parts[1]
    raise AssertionError(f"the reader let an unsupported formula through: {formula}")


def _bindings(domain: Domain, variables: Iterable[UpThing], binding: Binding) -> Iterator[Binding]:
    """Return the binding with every choice of objects for the quantified variables."""
    listed = list(variables)
    choices = [domain.objects_of(domain.outside[variable.type.name]) for variable in listed]
    for chosen in product(*choices):
        yield {**binding, **{variable.name: name for variable, name in zip(listed, chosen, strict=True)}}


def _after(domain: Domain, effects: Iterable[UpThing], binding: Binding, state: State) -> State:
    """Effects of one moment together: what is added wins over what is deleted, as PDDL says."""
    added: set[str] = set()
    deleted: set[str] = set()
    for effect in effects:
        for inner in _bindings(domain, effect.forall, binding):
            if _holds(domain, effect.condition, inner, state):
                target = added if _holds(domain, effect.value, inner, state) else deleted
                target.add(_text(domain, effect.fluent, inner))
    return (state - deleted) | added


def _text(domain: Domain, formula: UpThing, binding: Binding) -> str:
    """Return a formula as PDDL text in the names of the files, its parameters replaced by what they are bound to."""
    if formula.is_parameter_exp():
        return binding[formula.parameter().name]
    if formula.is_variable_exp():
        return binding.get(formula.variable().name, f"?{formula.variable().name}")
    if formula.is_object_exp():
        return domain.outside[formula.object().name]
    if formula.is_fluent_exp():
        head = domain.outside[formula.fluent().name]
    elif formula.is_bool_constant():
        return str(formula).lower()
    else:
        head = _HEADS.get(formula.node_type.name, formula.node_type.name.lower())
    return "(" + " ".join([head, *(_text(domain, part, binding) for part in formula.args)]) + ")"


_HEADS = {"EQUALS": "=", "IMPLIES": "imply"}
