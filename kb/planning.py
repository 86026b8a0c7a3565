"""Choices of designs and configurations, by priority or a criterion, and what they change."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Protocol

from kb.elements import ComponentKind, Configuration, FunctionDesign
from kb.network import Node
from kb.records import ReconfigurationPlan
from kb.state import State, in_order
from kb.status import Status
from kb.views import ConfigurationView, DesignView, Readable


class Choice(NamedTuple):
    """The chosen design of each function and configuration of each component, and why."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]
    reason: str = ""

    def __repr__(self) -> str:
        choice = f"designs={dict(self.designs)}, configurations={dict(self.configurations)}"
        reason = f", reason={self.reason!r}" if self.reason else ""
        return f"Choice({choice}{reason})"


# -------------------------------------------------------------------- by priority


def by_priority(
    candidate: FunctionDesign | Configuration | DesignView | ConfigurationView,
) -> tuple[bool, float, str]:
    """Return a key for sorting: the lowest number first, none last, ties by name."""
    return candidate.priority is None, candidate.priority or 0, candidate.name


def ranked(state: State, owner: Node) -> list[Node]:
    """Return the parts of a function or component that are not unfeasible, sorted by priority."""
    possible = [part for part in owner.requires if state.status[part] is not Status.UNFEASIBLE]
    possible.sort(key=lambda part: by_priority(part.element))
    return possible


def firsts_by_priority(state: State, owners: Iterable[Node]) -> list[Node]:
    """Return the first of `ranked` for each function or component that has any."""
    firsts = []
    for owner in owners:
        firsts += ranked(state, owner)[:1]
    return firsts


def choice_by_priority(state: State) -> Choice | None:
    """Choose by priority for each adaptable function, and each component adaptable then.

    Returns None if there is nothing to do; an empty choice means that only what is obsolete is
    given up.
    """
    adaptable = in_order(state.adaptable)
    functions = [node for node in adaptable if node.kind == "function"]
    designs = firsts_by_priority(state, functions)
    selection = decide(state, designs)
    if selection.flips:
        following = state.copy()
        apply_selection(following, selection)
        adaptable = in_order(following.adaptable)
    given_up = selection.deactivate
    components = [
        node for node in adaptable if node.kind == "component" and node.name not in given_up
    ]
    configurations = firsts_by_priority(state, components)
    if not (designs or configurations or state.obsolete()):
        return None
    return Choice(by_owner(designs), by_owner(configurations))


class Selecting(Readable, Protocol):
    """A knowledge base, as far as a planner needs it."""

    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
    ) -> ReconfigurationPlan | None: ...


class PriorityPlanner:
    """Chooses the lowest priority number of what is feasible; none last, ties by name."""

    def choose(self, kb: Selecting) -> Choice | None:
        """Choose for each adaptable function, then for each component adaptable with that."""
        with kb.reading() as state:
            return choice_by_priority(state)

    def plan(self, kb: Selecting) -> ReconfigurationPlan | None:
        """Select by priority and return the plan; None if there is nothing to choose."""
        choice = self.choose(kb)
        return None if choice is None else kb.select(*choice)


# -------------------------------------------------------------------- what follows from a choice


class Obsolete(NamedTuple):
    """Names of what is active or selected and nothing required needs any more."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]

    def __bool__(self) -> bool:
        return any(self)


class Selection(NamedTuple):
    """What a choice changes.

    Attributes:
        flips: the designs and configurations that are selected and were not, or the other way
            round.
        activate, deactivate, parameters: what the managed system has to do then, by name.
    """

    flips: tuple[Node, ...]
    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.activate or self.deactivate or self.parameters)

    def plan(
        self, state: State, reason: str, time: float, cause: int | None = None, number: int = 0
    ) -> ReconfigurationPlan:
        """Return the plan that carries it out."""
        components = state.network.components
        plain = tuple(
            name
            for name in (*self.activate, *self.deactivate)
            if components[name].element.kind is ComponentKind.PLAIN
        )
        steps = (self.activate, self.deactivate, self.parameters)
        return ReconfigurationPlan(*steps, reason, time, plain=plain, cause=cause, number=number)


def obsolete(state: State) -> Obsolete:
    """Return what is selected or active for no required function."""
    nodes = state.obsolete()
    kinds = "component", "function design", "configuration"
    return Obsolete(*(_names(node for node in nodes if node.kind == kind) for kind in kinds))


def decide(state: State, chosen: Sequence[Node]) -> Selection:
    """Decide what a choice changes; what is obsolete is given up. Nothing changes yet."""
    unneeded = state.obsolete()
    flips = _flips(state, chosen)
    flipped = set(flips)
    flips += [node for node in unneeded if node.kind != "component" and node not in flipped]
    flipped.update(flips)

    def is_used(design: Node) -> bool:
        is_selected = (design in state.selected) != (design in flipped)
        return is_selected and state.is_required(design.used_by[0])

    owners = {node.used_by[0] for node in chosen}
    replaced = [
        node
        for node in flips
        if node.kind == "function design" and node in state.selected and node.used_by[0] in owners
    ]
    stopped = [
        part
        for design in replaced
        for part in design.requires
        if not any(map(is_used, part.used_by))
    ]
    stopped += [node for node in unneeded if node.kind == "component"]
    waiting = {design for component in state.inactive_required() for design in component.used_by}
    waiting.update(node for node in flips if node.kind == "function design")
    started = [
        part
        for design in sorted(filter(is_used, waiting), key=lambda design: design.index)
        for part in design.requires
    ]
    return Selection(
        flips=tuple(flips),
        activate=_names(part for part in started if part not in state.active),
        deactivate=_names(part for part in stopped if part in state.active),
        parameters=_names(
            node for node in flips if node.kind == "configuration" and node not in state.selected
        ),
    )


def apply_selection(state: State, selection: Selection) -> None:
    """Select and unselect in a copy of a state."""
    state.touch(selection.flips)
    state.selected = state.selected.symmetric_difference(selection.flips)
    state.infer()


def by_owner(chosen: Iterable[Node]) -> Mapping[str, str]:
    """Return the names of what is chosen by what it is chosen for."""
    return MappingProxyType({node.used_by[0].name: node.name for node in chosen})


def _flips(state: State, chosen: Sequence[Node]) -> list[Node]:
    """Return what a choice selects and unselects; what would be obsolete is not selected."""
    flips = []
    for node in chosen:
        owner = node.used_by[0]
        is_needed = state.is_required(owner) if owner.kind == "function" else state.serves(owner)
        for part in owner.requires:
            is_wanted = part is node and bool(is_needed)
            if (part in state.selected) != is_wanted:
                flips.append(part)
    return flips


def _names(nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(node.name for node in nodes))
