"""What a constraint makes of a measurement, as data and in words; and numbers written as short as is right."""

from collections.abc import Iterable
from dataclasses import dataclass

from kb.elements import Attribute, Constraint, exact
from kb.inference.network import Node
from kb.inference.state import State
from kb.inference.steadiness import turning_point
from kb.status import OPERATORS, Status

__all__ = ["Comparison", "compared", "reading", "shortest", "told"]


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a constraint compares.

    Attributes:
        attribute: name of what is measured.
        operator: one of `>=`, `>`, `<=`, `<`.
        threshold: what it is compared with, in the attribute's unit.
        value: the latest measurement, None before the first.
        time: when that was measured [s]; None before, and where the value is only supposed.
        is_stale: it is older than it may be, and so not compared.
    """

    attribute: str
    operator: str
    threshold: float
    value: float | None
    time: float | None
    is_stale: bool


def compared(state: State, node: Node) -> Comparison:
    """Return what a constraint compares."""
    constraint, attribute = node.element, node.parts[0]
    assert isinstance(constraint, Constraint)
    value, time, is_stale = state.value[attribute.index], state.time[attribute.index], state.stale[attribute.index]
    return Comparison(constraint.attribute, constraint.operator, constraint.value, value, time, is_stale)


def told(one: Comparison, node: Node, now: float, verdict: Status | None) -> str:
    """Write a comparison, with the age of the measurement, and what a steady constraint makes of it.

    Args:
        one: what is compared.
        node: the constraint.
        now: the present time [s].
        verdict: what the constraint is after all that was measured, if it is a steady one.
    """
    bound = f"{one.operator} {exact(one.threshold)}"
    if one.value is None:
        return f"{one.attribute} is not measured (wanted {bound})"
    shown = f"{one.attribute} {shortest(one.value, [one.threshold])}"
    age = _age(one.time, now)
    if one.is_stale:
        return f"{shown} is stale: {age}, {_at_most(node.parts[0])}"
    if verdict is Status.NOT_EVALUATED:
        return f"{shown} is not confirmed: {_votes(node)} have to agree"
    holds = OPERATORS[one.operator](one.value, one.threshold)
    fact = f"{shown} {'satisfies' if holds else 'violates'} {bound} ({age})"
    if verdict is None or holds == (verdict is Status.SATISFIED):
        return fact
    return f"{fact}, but {bound} stays {verdict} {_hold(one, node, verdict)}"


def reading(state: State, attribute: Node, now: float) -> str:
    """Write what is known of an attribute."""
    value, time = state.value[attribute.index], state.time[attribute.index]
    if value is None:
        return f"{attribute.name} is not measured"
    shown = shortest(value, state.network.thresholds(attribute).around(value))
    age = _age(time, now)
    if state.stale[attribute.index]:
        return f"{attribute.name} {shown} is stale: {age}, {_at_most(attribute)}"
    return f"{attribute.name} is {shown} ({age})"


def shortest(value: float, thresholds: Iterable[float]) -> str:
    """Write a number with as few digits as leave it on its side of every threshold; hardly beside one, in words."""
    bounds = tuple(thresholds)
    for digits in (3, 6, 9):
        text = f"{value:.{digits}g}"
        if all((float(text) < bound, float(text) > bound) == (value < bound, value > bound) for bound in bounds):
            return text
    nearest = min(bounds, key=lambda bound: abs(bound - value))
    if nearest == value:
        return exact(value)
    return f"just {'below' if value < nearest else 'above'} {exact(nearest)}"


def _age(time: float | None, now: float) -> str:
    return "supposed" if time is None else f"measured {max(0.0, now - time):.1f} s ago"


def _at_most(attribute: Node) -> str:
    assert isinstance(attribute.element, Attribute)
    return f"at most {exact(attribute.element.max_age)} s"


def _hold(one: Comparison, node: Node, verdict: Status) -> str:
    """Say how long a steady constraint stays as it is although the latest measurement says otherwise."""
    constraint, attribute = node.element, node.parts[0].element
    assert isinstance(constraint, Constraint)
    assert isinstance(attribute, Attribute)
    assert one.value is not None  # else nothing says otherwise
    turn = turning_point(constraint, verdict)
    is_beyond = verdict is Status.SATISFIED or OPERATORS[one.operator](one.value, turn)
    held = [f"for {exact(constraint.dwell)} s at least"] if constraint.dwell else []
    if attribute.agreement != (1, 1):
        held.append(f"until {_votes(node)} {'say otherwise' if is_beyond else f'are {one.operator} {exact(turn)}'}")
    elif not is_beyond:
        held.append(f"until {one.attribute} {one.operator} {exact(turn)}")
    return ", and ".join(held)


def _votes(node: Node) -> str:
    attribute = node.parts[0].element
    assert isinstance(attribute, Attribute)
    enough, last = attribute.agreement
    return f"{enough} of the last {last} measurements"
