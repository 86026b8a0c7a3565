"""Incremental inference: after a fact changes, only the elements that depend on it are inferred again.

Inference has two directions. "Required" goes down: from an action to its functions, from a selected design to its
components. Status goes up, level by level: constraint, configuration, component, design, function, action. While a
function or component stays possible, or impossible, only its users (required actions, selected designs) are inferred.
"""

from collections.abc import Iterable
from typing import Final

from kb.elements import Constraint, StalePolicy
from kb.events import StatusChange
from kb.network import LEVELS, Node
from kb.state import State
from kb.status import (
    ERROR,
    IMPOSSIBLE,
    SOLVED,
    UNSOLVED,
    Status,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

Agenda = list[dict[Node, None]]

_TOP: Final = LEVELS["attribute"]
_NEW: Final = tuple.__new__  # quicker than the constructor


def propagate(state: State, touched: Iterable[Node]) -> list[StatusChange]:
    """Infer all that depends on the touched nodes, whose facts have changed; returns the changes of status."""
    agenda: Agenda = [{}, {}, {}, {}, {}, {}, {}]
    for node in touched:
        _touch(state, node, agenda)
    for node in agenda[_TOP]:
        agenda[0].update(dict.fromkeys(node.constraints))
    changes: list[StatusChange] = []
    status, kept = state.status, state.kept
    for nodes in agenda[:_TOP]:
        state.visited += len(nodes)
        for node in nodes:
            index, kind = node.index, node.kind
            old, new = status[index], infer(state, node)
            if new is old:
                continue
            if kept is not None:
                kept.append((status, index, old))
            status[index] = new
            changes.append(_NEW(StatusChange, (kind, node.name, old, new)))
            wholes: Iterable[Node] = node.wholes
            may_be_chosen_for = kind == "function" or kind == "component"
            if may_be_chosen_for:
                state.mark(state.adaptable, node, is_adaptable(state, node))
            if (old in IMPOSSIBLE) == (new in IMPOSSIBLE):
                wholes = state.users[index].nodes() if may_be_chosen_for else () if kind == "constraint" else wholes
            for whole in wholes:
                agenda[whole.level][whole] = None
    return changes


def _touch(state: State, node: Node, agenda: Agenda) -> None:
    index, kind = node.index, node.kind
    agenda[node.level][node] = None
    if kind == "function" or kind == "component":
        _require(state, node)
        if kind == "component":
            _mark_component(state, node)
    elif kind == "action":
        required = state.requested[index] or state.asserted_required[index]
        if required != state.required[index]:
            state.put(state.required, index, required)
            for function in node.parts:
                _use(state, function, node, required, agenda)
    elif kind == "function design":
        selected = state.selected[index]
        _touch(state, node.wholes[0], agenda)
        state.mark(state.obsolete, node, selected and not state.required[node.wholes[0].index])
        for component in node.parts:
            _use(state, component, node, selected, agenda)
    elif kind == "configuration":
        agenda[node.wholes[0].level][node.wholes[0]] = None  # a component's status depends on which is selected
        _mark_configuration(state, node)


def _use(state: State, part: Node, user: Node, uses: bool, agenda: Agenda) -> None:
    state.mark(state.users.of(part.index), user, uses)
    _touch(state, part, agenda)


def _require(state: State, node: Node) -> None:
    """Update whether a function or component is required, and which components its designs serve."""
    index = node.index
    required = state.asserted_required[index] or bool(state.users[index])
    if required == state.required[index]:
        return
    state.put(state.required, index, required)
    if node.kind == "function":
        for design in node.parts:
            _serve(state, design, required)


def _serve(state: State, design: Node, required: bool) -> None:
    """Update how many designs of required functions each component of this design is in."""
    selected, served, kept, mark = state.selected, state.served, state.kept, state.mark
    if selected[design.index]:
        mark(state.obsolete, design, not required)
    for component in design.parts:
        index = component.index
        before = served[index]
        after = before + (1 if required else -1)
        if kept is not None:
            kept.append((served, index, before))
        served[index] = after
        if not before or not after:
            if state.active[index]:
                mark(state.obsolete, component, not after)
            for configuration in component.parts:
                if selected[configuration.index]:
                    mark(state.obsolete, configuration, not after)


def _mark_component(state: State, component: Node) -> None:
    index = component.index
    state.mark(state.lacking, component, state.required[index] and not state.active[index])
    state.mark(state.obsolete, component, state.active[index] and not state.served[index])


def _mark_configuration(state: State, configuration: Node) -> None:
    selected = state.selected[configuration.index]
    state.mark(state.obsolete, configuration, selected and not state.served[configuration.wholes[0].index])


def is_adaptable(state: State, node: Node) -> bool:
    """Tell whether a choice is needed for a function or component, or a better one may be looked for."""
    status = state.status[node.index]
    if status is SOLVED:
        return bool(node.element.always_improve)
    return status is UNSOLVED or status is ERROR


def infer(state: State, node: Node) -> Status:
    index, kind = node.index, node.kind
    asserted = state.asserted[index]
    if asserted is not None:
        return asserted
    if kind == "constraint":
        return _compared(state, node, node.element, node.parts[0])
    status, selected, required = state.status, state.selected, state.required[index]
    constraints = [status[one.index] for one in node.constraints] if node.constraints else ()
    if kind == "configuration":
        return configuration_status(constraints)
    parts = [status[part.index] for part in node.parts]
    if kind == "function design":
        return design_status(constraints, parts, selected[index])
    if kind == "action":
        return action_status(constraints, parts, required)
    chosen = [status[part.index] for part in node.parts if selected[part.index]] if required else ()
    if kind == "function":
        return function_status(parts, chosen, required)
    return component_status(state.failed[index], constraints, parts, chosen, required, state.active[index])


def _compared(state: State, node: Node, constraint: Constraint, attribute: Node) -> Status:
    if not state.stale[attribute.index]:
        verdict = state.verdict[node.index]
        return verdict or constraint_status(state.value[attribute.index], constraint.operator, constraint.value)
    return Status.VIOLATED if attribute.attribute.when_stale is StalePolicy.VIOLATED else Status.NOT_EVALUATED


def infer_anew(state: State) -> None:
    """Infer everything from the facts, e.g. after a change of the model; it can be called again after an interrupt."""
    state.forget_inferred()
    propagate(state, state.network.present())
