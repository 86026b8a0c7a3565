"""Computes reconfiguration plans: which components to switch and to configure when another choice is selected."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from kb.elements import ComponentKind
from kb.events import StatusChange
from kb.inference import propagate
from kb.network import Node
from kb.records import ReconfigurationPlan
from kb.state import State


class Obsolete(NamedTuple):
    """Names of active components and selected designs and configurations that nothing required needs any more."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]

    def __bool__(self) -> bool:
        return any(self)


class Selection(NamedTuple):
    """What the managed system has to do after a selection, by name, and the nodes whose selection changed."""

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    changes: tuple[StatusChange, ...]
    reselected: tuple[Node, ...]

    def __bool__(self) -> bool:
        return bool(self.activate or self.deactivate or self.parameters)


def obsolete(state: State) -> Obsolete:
    """Return what is obsolete: selected or active for no required function (an asserted `required` does not count)."""
    nodes = state.obsolete.nodes()
    kinds = "component", "function design", "configuration"
    return Obsolete(*(_names(node for node in nodes if node.kind == kind) for kind in kinds))


def reselect(state: State, designs: Iterable[Node], configurations: Iterable[Node]) -> Selection:
    """Select designs and configurations instead of the present ones, and unselect what is obsolete."""
    replaced, changed = _choose(state, designs)
    _, newly_configured = _choose(state, configurations)
    changes = propagate(state, [*changed, *newly_configured])
    unneeded = state.obsolete.nodes()
    idle = [node for node in unneeded if node.kind == "component"]
    unselected = [node for node in unneeded if node.kind != "component"]
    for node in unselected:
        state.put(state.selected, node.index, False)
    if unselected:
        changes += propagate(state, unselected)
    given_up = [
        part
        for design in replaced
        for part in design.parts
        if not any(state.required[user.wholes[0].index] for user in state.users[part.index])
    ]
    return Selection(
        activate=_names(_lacking(state)),
        deactivate=_names(node for node in dict.fromkeys([*given_up, *idle]) if state.active[node.index]),
        parameters=_names(node for node in newly_configured if state.selected[node.index]),
        changes=tuple(changes),
        reselected=(*changed, *newly_configured, *unselected),
    )


def by_whole(chosen: Iterable[Node]) -> Mapping[str, str]:
    return MappingProxyType({node.wholes[0].name: node.name for node in chosen})


def planned(
    state: State, selection: Selection, reason: str, now: float, cause: int | None = None, number: int = 0
) -> ReconfigurationPlan:
    activate, deactivate, *_ = selection
    elements = (state.network.components[name].element for name in (*activate, *deactivate))
    plain = frozenset(one.name for one in elements if one.kind is ComponentKind.PLAIN)
    return ReconfigurationPlan(*selection[:3], reason, now, plain=plain, cause=cause, number=number)


def _choose(state: State, chosen: Iterable[Node]) -> tuple[list[Node], list[Node]]:
    """Select each node and unselect the others of its whole; return what was unselected, and all that changed."""
    replaced, changed = [], []
    for node in chosen:
        for rival in node.wholes[0].parts:
            wanted = rival is node
            if state.selected[rival.index] == wanted:
                continue
            state.put(state.selected, rival.index, wanted)
            changed.append(rival)
            if not wanted:
                replaced.append(rival)
    return replaced, changed


def _lacking(state: State) -> list[Node]:
    lacking = state.lacking.nodes()
    users = {user.index: user for component in lacking for user in state.users[component.index]}
    designs = [users[index] for index in sorted(users) if state.required[users[index].wholes[0].index]]
    inactive = (part for design in designs for part in design.parts if not state.active[part.index])
    return list(dict.fromkeys(inactive))


def _names(nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(node.name for node in nodes)
