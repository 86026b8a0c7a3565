"""A problem that was built with unified-planning as a domain: nothing is written or renamed, so numbers stay exact."""

import re
from collections.abc import Iterator, Mapping

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.sums import template_of
from rosa_pddl.reader import lineage_of, schema_of
from rosa_pddl.reading.resources import POSSIBLE, resources_of

__all__ = ["domain_of"]

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


def domain_of(up_problem: UpThing) -> Domain:
    """Return a problem with instantaneous actions as a domain; the problem stays as it is.

    Raises:
        UnsupportedPddlError: it computes with numbers otherwise than to add up costs and resources, or a name is none
            in PDDL.
    """
    where = f"problem {up_problem.name or 'without a name'}"
    read = up_problem.clone()
    inside, outside = _names(read, where)
    _fill_in_numbers(read, where)
    _check_numbers(read, where)
    schemas = {action.name: schema_of(action, outside, where) for action in read.actions}
    domain = Domain(
        name=str(up_problem.name),
        file=where,
        problem_file=where,
        rosa_actions=(),
        schemas=tuple(schemas),
        up_problem=read,
        schema_of=schemas,
        outside=outside,
        inside=inside,
        goals=(),
        places={},
        types={thing.name: tuple(lineage_of(thing.type, outside)) for thing in read.all_objects},
        resources=resources_of(read, outside),
    )
    _check_amounts(domain)
    return domain


def _names(read: UpThing, where: str) -> tuple[Mapping[tuple[str, str], str], Mapping[str, str]]:
    """Return the names by kind and what they are in lower case, and the names by themselves and in lower case."""
    kinds = {"predicate": read.fluents, "object": read.all_objects, "action": read.actions, "type": read.user_types}
    inside: dict[tuple[str, str], str] = {}
    outside = {thing.name: thing.name for things in kinds.values() for thing in things} | {"object": "object"}
    lower: dict[str, str] = {}
    for kind, things in kinds.items():
        for thing in things:
            name = thing.name
            if not _NAME.fullmatch(name):
                message = f"the {kind} {name!r} has no name of PDDL: a letter first, then letters, digits, '_' or '-'"
                raise UnsupportedPddlError(f"{message}; rename it", where)
            if kind != "type" and lower.setdefault(name.lower(), name) != name:
                message = f"{name!r} and {lower[name.lower()]!r} are the same to PDDL, which ignores case"
                raise UnsupportedPddlError(f"{message}; rename one", where)
            inside[kind, name.lower()] = name
    return inside, {**outside, **lower}


def _fill_in_numbers(read: UpThing, where: str) -> None:
    """State the numbers that are there by default."""
    from unified_planning.exceptions import UPException

    try:
        values = read.initial_values
    except UPException as error:
        raise UnsupportedPddlError(f"a fluent has no value in the beginning: {error}", where) from error
    for expression, value in values.items():
        if not expression.type.is_bool_type():
            read.set_initial_value(expression, value)


def _check_numbers(read: UpThing, where: str) -> None:
    """Assure that what actions do with numbers is to add to such without arguments, and that no condition has any."""
    for action in read.actions:
        _refuse_numbers(action.preconditions, action.name, where)
        for effect in action.effects:
            if effect.fluent.type.is_bool_type():
                _refuse_numbers([effect.condition, effect.value], action.name, where)
            elif not effect.is_increase() or effect.fluent.args or effect.is_conditional() or effect.forall:
                message = f"the effect '{effect}' of {action.name} is not planned for; {POSSIBLE}"
                raise UnsupportedPddlError(message, where)


def _refuse_numbers(formulas: list[UpThing], name: str, where: str) -> None:
    for formula in formulas:
        if any(_is_number(part) for part in _parts(formula)):
            raise UnsupportedPddlError(f"the condition '{formula}' of {name} computes with numbers; {POSSIBLE}", where)


def _check_amounts(domain: Domain) -> None:
    """Assure that what is limited is used up, and that no amount depends on what actions change."""
    changed = {resource.fluent for resource in domain.resources}
    amounts = [amount for resource in domain.resources for amount in resource.uses.values()]
    amounts += [limit.amount for resource in domain.resources for limit in resource.limits]
    for metric in domain.up_problem.quality_metrics:
        if metric.is_minimize_action_costs():
            amounts += [cost for cost in map(metric.get_action_cost, domain.up_problem.actions) if cost is not None]
    for amount in amounts:
        template_of(domain, amount)
        if any(part in changed for part in _parts(amount)):
            message = f"the amount '{amount}' depends on what actions change; {POSSIBLE}"
            raise UnsupportedPddlError(message, domain.file)
    for goal in domain.up_problem.goals:
        _refuse_numbers([goal], "the goal", domain.file)


def _parts(formula: UpThing) -> Iterator[UpThing]:
    yield formula
    for part in formula.args:
        yield from _parts(part)


def _is_number(part: UpThing) -> bool:
    return bool(part.type.is_int_type() or part.type.is_real_type())
