"""Reconfiguration plans: from what is selected now to what shall be, and what has to be switched on the way."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from kb.elements import Component, ComponentKind
from kb.inference.settling import Change, Node, State, settle

__all__ = ["Obsolete", "ReconfigurationPlan", "Selection", "by_whole", "obsolete", "plain", "planned", "reselect"]


class Obsolete(NamedTuple):
    """Names of what nothing required needs any more: active components, selected designs and configurations."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]

    def __bool__(self) -> bool:
        return any(self)


class Selection(NamedTuple):
    """What has to be done to the managed system after a selection, by name; and what is selected now or no longer."""

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    changes: tuple[Change, ...]
    reselected: tuple[Node, ...]

    def __bool__(self) -> bool:
        return bool(self.activate or self.deactivate or self.parameters)


@dataclass(frozen=True, slots=True, eq=False)
class ReconfigurationPlan:
    """What to switch, and what became of it; only the knowledge base that made it can end it.

    Attributes:
        activate: names of components to activate.
        deactivate: names of components to deactivate.
        parameters: names of configurations whose parameters are to be set.
        reason: why, in words.
        start: when it was made [s].
        end: when it ended [s], None while it is open.
        result: "completed", "failed" or "abandoned", None while it is open.
        plain: those to activate or deactivate that nobody commands: it is only noted that they are active or not.
        cause: number of the event that made it needed, as far as that is known.
        number: 1 for the first plan of a knowledge base.
    """

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    reason: str
    start: float
    end: float | None = None
    result: str | None = None
    plain: frozenset[str] = frozenset()
    cause: int | None = None
    number: int = 0

    def __str__(self) -> str:
        steps = (
            ("deactivate", [name for name in self.deactivate if name not in self.plain]),
            ("activate", [name for name in self.activate if name not in self.plain]),
            ("configure", self.parameters),
            ("note as inactive:", [name for name in self.deactivate if name in self.plain]),
            ("note as active:", [name for name in self.activate if name in self.plain]),
        )
        return "; ".join(f"{verb} {', '.join(names)}" for verb, names in steps if names)

    def __repr__(self) -> str:
        return f"<ReconfigurationPlan {self} ({self.result or 'open'})>"

    def _finish(self, result: str, end: float) -> None:
        object.__setattr__(self, "end", end)
        object.__setattr__(self, "result", result)


def obsolete(state: State) -> Obsolete:
    """Return what is obsolete: selected or active for no required function (an asserted `required` does not count)."""
    nodes = state.obsolete.nodes()
    return Obsolete(
        _names(node for node in nodes if node.kind == "component"),
        _names(node for node in nodes if node.kind == "function design"),
        _names(node for node in nodes if node.kind == "configuration"),
    )


def reselect(state: State, designs: Iterable[Node], configurations: Iterable[Node]) -> Selection:
    """Mark the given designs and configurations selected instead of their rivals, and unselect what is obsolete.

    Returns:
        What leads the managed system there from its present state.
    """
    replaced, changed = _choose(state, designs)
    _, newly_configured = _choose(state, configurations)
    changes = settle(state, [*changed, *newly_configured])
    idle = [node for node in state.obsolete.nodes() if node.kind == "component"]
    unselected = [node for node in state.obsolete.nodes() if node.kind != "component"]
    for node in unselected:
        state.selected[node.index] = False
    changes += settle(state, unselected)
    given_up = [part for design in replaced for part in design.parts if not _is_needed(state, part)]
    return Selection(
        activate=_names(_lacking(state)),
        deactivate=_names(node for node in dict.fromkeys([*given_up, *idle]) if state.active[node.index]),
        parameters=_names(node for node in newly_configured if state.selected[node.index]),
        changes=tuple(changes),
        reselected=(*changed, *newly_configured, *unselected),
    )


def by_whole(chosen: Iterable[Node]) -> Mapping[str, str]:
    """Return the names of designs or configurations, by name of the function or component that each is of."""
    return MappingProxyType({node.wholes[0].name: node.name for node in chosen})


def planned(state: State, selection: Selection, reason: str, now: float) -> ReconfigurationPlan:
    """Return the plan of a selection.

    Args:
        state: the facts and statuses.
        selection: what has to be done.
        reason: why, in words.
        now: the present time [s].
    """
    activate, deactivate, parameters, *_ = selection
    components = (state.network.components[name] for name in (*activate, *deactivate))
    return ReconfigurationPlan(activate, deactivate, parameters, reason, now, plain=plain(components))


def plain(components: Iterable[Node]) -> frozenset[str]:
    """Return the names of those that are plain, and so never commanded."""
    elements = (node.element for node in components)
    return frozenset(one.name for one in elements if isinstance(one, Component) and one.kind is ComponentKind.PLAIN)


def _choose(state: State, chosen: Iterable[Node]) -> tuple[list[Node], list[Node]]:
    """Select each chosen node and unselect its rivals; return those unselected, and all that changed."""
    replaced, changed = [], []
    for node in chosen:
        for rival in node.wholes[0].parts:
            wanted = rival is node
            if state.selected[rival.index] == wanted:
                continue
            state.selected[rival.index] = wanted
            changed.append(rival)
            if not wanted:
                replaced.append(rival)
    return replaced, changed


def _lacking(state: State) -> list[Node]:
    """Return the inactive components of selected designs of required functions, by design."""
    lacking = state.lacking.nodes()
    users = {user.index: user for component in lacking for user in state.users[component.index]}
    designs = [users[index] for index in sorted(users) if state.required[users[index].wholes[0].index]]
    inactive = (part for design in designs for part in design.parts if not state.active[part.index])
    return list(dict.fromkeys(inactive))


def _is_needed(state: State, component: Node) -> bool:
    """Tell whether a selected design of a required function contains the component."""
    return any(state.required[design.wholes[0].index] for design in state.users[component.index])


def _names(nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(node.name for node in nodes)
