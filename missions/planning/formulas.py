"""Formulas and effects of a step as text that can be read again, without parameters and quantifiers."""

from collections.abc import Iterable, Iterator, Mapping
from itertools import product
from typing import Final

from rosa_pddl import Domain
from rosa_pddl.domain import UpThing

__all__ = ["written_condition", "written_effects"]

_HEADS: Final = {"AND": "and", "OR": "or", "NOT": "not", "IMPLIES": "imply", "EQUALS": "="}

Binding = Mapping[str, str]


def written_condition(domain: Domain, formula: UpThing, binding: Binding) -> str:
    """Return a condition as text; instead of a quantifier, every object is named."""
    if formula.is_parameter_exp():
        return binding[formula.parameter().name]
    if formula.is_variable_exp():
        return binding[_marked(formula.variable().name)]
    if formula.is_object_exp():
        return domain.outside[formula.object().name]
    if formula.is_fluent_exp():
        return _list(domain.outside[formula.fluent().name], domain, formula.args, binding)
    if formula.is_bool_constant():
        return "(and)" if formula.constant_value() else "(or)"
    if formula.is_exists() or formula.is_forall():
        bindings = _bindings(domain, formula.variables(), binding)
        parts = [written_condition(domain, formula.arg(0), inner) for inner in bindings]
        return f"({' '.join(['or' if formula.is_exists() else 'and', *parts])})"
    if formula.is_iff():
        left, right = (written_condition(domain, part, binding) for part in formula.args)
        return f"(and (imply {left} {right}) (imply {right} {left}))"
    return _list(_HEADS[formula.node_type.name], domain, formula.args, binding)


def written_effects(domain: Domain, effects: Iterable[UpThing], binding: Binding) -> list[str]:
    """Return effects as texts: `ATOM`, `(not ATOM)`, or `(when CONDITION ...)` of one of these."""
    return [text for effect in effects for text in _effect(domain, effect, binding)]


def _effect(domain: Domain, effect: UpThing, binding: Binding) -> Iterator[str]:
    for inner in _bindings(domain, effect.forall, binding):
        atom = written_condition(domain, effect.fluent, inner)
        needed = [] if effect.condition.is_true() else [written_condition(domain, effect.condition, inner)]
        if effect.value.is_bool_constant():
            yield _when(needed, atom if effect.value.constant_value() else f"(not {atom})")
        else:
            value = written_condition(domain, effect.value, inner)
            yield _when([*needed, value], atom)
            yield _when([*needed, f"(not {value})"], f"(not {atom})")


def _when(needed: list[str], literal: str) -> str:
    if not needed:
        return literal
    condition = needed[0] if len(needed) == 1 else f"(and {' '.join(needed)})"
    return f"(when {condition} {literal})"


def _list(head: str, domain: Domain, parts: Iterable[UpThing], binding: Binding) -> str:
    return f"({' '.join([head, *(written_condition(domain, part, binding) for part in parts)])})"


def _bindings(domain: Domain, variables: Iterable[UpThing], binding: Binding) -> Iterator[Binding]:
    listed = list(variables)
    choices = [domain.objects_of(domain.outside[variable.type.name]) for variable in listed]
    for chosen in product(*choices):
        named = {_marked(variable.name): name for variable, name in zip(listed, chosen, strict=True)}
        yield {**binding, **named}


def _marked(variable: str) -> str:
    """Return the name of a variable such that no parameter has it too."""
    return f"?{variable}"
