"""What a page shows of a knowledge base: its elements, why each is as it is, and what would be if."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import inf
from typing import Any

from kb import KnowledgeBase, Situation
from kb.elements import Action, Attribute, Component, Configuration, Constraint, Function, FunctionDesign
from kb.measurements import turning_point
from kb.network import Node
from kb.planners.choice import Choice, choice_by_priority, ranked
from kb.state import Overlay, State

CHOSEN = ("function", "component")
"""The kinds for which something is chosen."""


def described(node: Node, units: Mapping[str, str]) -> dict[str, Any]:
    """Return what an element is, as plain values; other elements are given by their indices."""
    one = node.element
    shown: dict[str, Any] = {"kind": node.kind, "name": node.name}
    parts = [part.index for part in node.parts]
    if isinstance(one, Constraint):
        shown |= {"attribute": parts[0], "operator": one.operator, "value": one.value, "hysteresis": one.hysteresis}
        return shown | {"dwell": one.dwell, "on": [whole.index for whole in node.wholes]}
    constraints = [each.index for each in node.constraints]
    if isinstance(one, Attribute):
        shown |= {"of": str(one.kind), "unit": units.get(one.name, one.unit), "thresholds": constraints}
        return shown | {"max_age": None if one.max_age == inf else one.max_age}
    if isinstance(one, Function):
        return shown | {"designs": parts, "improve": one.always_improve}
    shown["constraints"] = constraints
    if isinstance(one, Action):
        shown["functions"] = parts
    elif isinstance(one, FunctionDesign):
        shown |= {"function": node.wholes[0].index, "components": parts, "priority": one.priority}
    elif isinstance(one, Component):
        shown |= {"switched": str(one.kind), "configurations": parts}
    elif isinstance(one, Configuration):
        shown |= {"component": node.wholes[0].index, "priority": one.priority}
        shown["parameters"] = {name: plain(value) for name, value in one.parameters.items()}
    return shown


def plain(value: object) -> Any:  # noqa: ANN401  # whatever JSON holds
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, float) and not -inf < value < inf:
        return None
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return [plain(one) for one in value] if isinstance(value, list | tuple) else str(value)


def choice_of(kb: KnowledgeBase, node: Node) -> dict[str, Any]:
    """Return why a function or component has the design or configuration that it has, and not another one."""
    found = kb.explain_choice(node.element)
    parts = {part.name: part.index for part in node.parts}
    return {
        "chosen": None if found.chosen is None else parts[found.chosen],
        "selected": found.is_selected,
        "reason": found.reason,
        "alternatives": [
            {"element": parts[one.name], "status": str(one.status), "priority": one.priority, "reason": one.reason}
            for one in found.alternatives
        ],
    }


def supposed(situation: Situation) -> dict[str, Any]:
    """Return what would be feasible in a situation, and what would be selected then, by priority."""
    with situation.reading() as state:
        assert isinstance(state, Overlay)
        network, choice = state.network, choice_by_priority(state) or Choice({}, {})
        chosen: dict[str, int | None] = {}
        for kind, following in (("function", choice.designs), ("component", choice.configurations)):
            for node in network.kinds[kind].values():
                possible = ranked(state, node)  # the first is what would be selected if nothing is
                name = following.get(node.name)
                kept = [one for one in possible if (state.selected[one.index] if name is None else one.name == name)]
                if node.parts:
                    chosen[str(node.index)] = next((part.index for part in kept or possible), None)
        status = {str(index): str(state.status[index]) for index in sorted(state.changed())}
        feasible = [network.actions[name].index for name in situation.selectable_actions()]
    return {"feasible": feasible, "status": status, "chosen": chosen}


def cases(kb: KnowledgeBase, most: int = 60) -> list[dict[str, Any]]:
    """Return what would be if each measured attribute lay in another interval between its thresholds, at most so many.

    Within an interval nothing turns: what holds for one value of it holds for all.
    """
    with kb.reading() as state:
        intervals = [
            (node, measured, low, high)
            for node in state.network.attributes.values()
            if node.constraints and (measured := state.value[node.index]) is not None
            for low, high in _intervals(node, state)
        ][:most]
    found = []
    for node, value, low, high in intervals:
        is_now = low <= value < high
        if not is_now:
            span = high - low if -inf < low and high < inf else max(abs(low if high == inf else high), 1.0) * 0.2
            value = low + span / 2 if low > -inf else high - span / 2
        case = {"attribute": node.index, "low": plain(low), "high": plain(high), "value": value, "now": is_now}
        found.append(case | supposed(kb.situation({node.name: value})))
    return found


def _intervals(attribute: Node, state: State) -> Iterator[tuple[float, float]]:
    turns = set()
    for node in attribute.constraints:
        assert isinstance(node.element, Constraint)
        turns |= {node.element.value, turning_point(node.element, state.status[node.index])}
    edges = [-inf, *sorted(turns), inf]
    return pairwise(edges)
