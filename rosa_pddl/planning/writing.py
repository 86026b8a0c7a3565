"""Writes PDDL for Fast Downward's translator, on request so that the translated task fits any state.

The names are those of unified-planning's problem, which are unique. Action costs are not written: they are put into the
translated task, because they may differ each time.

What changes between plannings would be folded away by the translator. An atom is kept by one more action that makes it
true, for the atoms that `may` hold: then the translator takes it for something that can be so or not. These actions are
dropped afterwards.
"""

from collections.abc import Collection, Iterable, Iterator

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.problem import Problem

__all__ = ["ADDED", "inside_atom", "written_domain", "written_problem"]

_KEEP = "keep!"
_FINISH = "finish!"
_DONE = "done!"
_MAY = "may!"
ADDED = (_KEEP, _FINISH)
"""What the names of the actions begin with that are added here; the second reaches the stand-in for the goal."""


def written_domain(domain: Domain, up_problem: UpThing, alive: Collection[str] | None) -> str:
    """Write the domain file.

    Args:
        domain: what `load_domain` returned.
        up_problem: its instantaneous actions.
        alive: predicates (of `up_problem`) some of whose atoms are kept alive; None to write what is planned once only.

    Raises:
        UnsupportedPddlError: a formula that Fast Downward cannot be told.
    """
    parts = [f"(define (domain d) (:types {_types(up_problem)})"]
    parts.append(f"(:constants {' '.join(f'{thing.name} - {thing.type.name}' for thing in up_problem.all_objects)})")
    predicates = [fluent for fluent in up_problem.fluents if fluent.type.is_bool_type()]
    signatures = [f"({fluent.name} {_typed(fluent.signature)})" for fluent in predicates]
    kept = [fluent for fluent in predicates if fluent.name in (alive or ())]
    signatures += [f"({_MAY}{fluent.name} {_typed(fluent.signature)})" for fluent in kept]
    parts.append(f"(:predicates ({_DONE}) {' '.join(signatures)})")
    parts += [_action(domain, action) for action in up_problem.actions]
    if alive is not None:
        parts += [_keeper(fluent) for fluent in kept]
        parts.append(f"(:action {_FINISH} :parameters () :precondition (and) :effect ({_DONE}))")
    return "\n".join([*parts, ")"])


def written_problem(problem: Problem, goals: Iterable[UpThing] | None, alive: Iterable[str] = ()) -> str:
    """Write the problem file.

    Args:
        problem: its state.
        goals: what shall hold; None for the stand-in.
        alive: atoms that may hold.
    """
    domain = problem.domain
    facts = [inside_atom(domain, atom) for atom in sorted(problem.state)]
    facts += [f"({_MAY}{inside_atom(domain, atom)[1:]}" for atom in alive]
    goal = f"({_DONE})" if goals is None else f"(and {' '.join(_formula(domain, goal) for goal in goals)})"
    return "\n".join(["(define (problem p) (:domain d) (:init", *facts, f") (:goal {goal}))"])


def inside_atom(domain: Domain, atom: str) -> str:
    """Return an atom in the names of unified-planning's problem."""
    head, *words = atom[1:-1].split()
    inside = domain.inside
    names = [inside["predicate", head.lower()], *(inside["object", word.lower()] for word in words)]
    return f"({' '.join(names)})"


def _types(up_problem: UpThing) -> str:
    return " ".join(f"{kind.name} - {kind.father.name if kind.father else 'object'}" for kind in up_problem.user_types)


def _typed(parameters: Iterable[UpThing]) -> str:
    return " ".join(f"?{parameter.name} - {parameter.type.name}" for parameter in parameters)


def _keeper(fluent: UpThing) -> str:
    arguments = "".join(f" ?{parameter.name}" for parameter in fluent.signature)
    return (
        f"(:action {_KEEP}{fluent.name} :parameters ({_typed(fluent.signature)}) "
        f":precondition ({_MAY}{fluent.name}{arguments}) :effect ({fluent.name}{arguments}))"
    )


def _action(domain: Domain, action: UpThing) -> str:
    conditions = " ".join(_formula(domain, condition) for condition in action.preconditions)
    effects = " ".join(text for effect in action.effects for text in _effect(domain, effect))
    return (
        f"(:action {action.name} :parameters ({_typed(action.parameters)}) "
        f":precondition (and {conditions}) :effect (and {effects}))"
    )


def _effect(domain: Domain, effect: UpThing) -> Iterator[str]:
    if not effect.fluent.type.is_bool_type():
        return
    atom, value = _formula(domain, effect.fluent), effect.value
    for truth, literal in ((True, atom), (False, f"(not {atom})")):
        needed = [] if effect.condition.is_true() else [_formula(domain, effect.condition)]
        if value.is_bool_constant():
            if bool(value.constant_value()) is not truth:
                continue
        else:
            told = _formula(domain, value)
            needed.append(told if truth else f"(not {told})")
        text = f"(when (and {' '.join(needed)}) {literal})" if needed else literal
        yield f"(forall ({_typed(effect.forall)}) {text})" if effect.forall else text


def _formula(domain: Domain, formula: UpThing) -> str:
    if formula.is_fluent_exp():
        return _list(formula.fluent().name, (_formula(domain, part) for part in formula.args))
    if formula.is_parameter_exp():
        return f"?{formula.parameter().name}"
    if formula.is_variable_exp():
        return f"?{formula.variable().name}"
    if formula.is_object_exp():
        return str(formula.object().name)
    if formula.is_bool_constant():
        return "(and)" if formula.constant_value() else "(or)"
    if formula.is_exists() or formula.is_forall():
        head = "exists" if formula.is_exists() else "forall"
        return f"({head} ({_typed(formula.variables())}) {_formula(domain, formula.arg(0))})"
    parts = [_formula(domain, part) for part in formula.args]
    if formula.is_iff():
        return f"(and (imply {parts[0]} {parts[1]}) (imply {parts[1]} {parts[0]}))"
    if formula.node_type.name not in _HEADS:
        raise UnsupportedPddlError(f"Fast Downward cannot be told {formula}", domain.file)
    return _list(_HEADS[formula.node_type.name], parts)


def _list(head: str, parts: Iterable[str]) -> str:
    return "(" + " ".join([head, *parts]) + ")"


_HEADS = {"AND": "and", "OR": "or", "NOT": "not", "IMPLIES": "imply", "EQUALS": "="}
