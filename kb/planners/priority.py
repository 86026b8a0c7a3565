"""The choice by priority, a pure function of a state.

Of what is possible the lowest priority number is chosen; no priority comes last, ties go by name.
"""

from collections.abc import Iterable
from typing import Protocol

from kb.elements import Configuration, FunctionDesign
from kb.network import Node
from kb.reconfiguration import by_whole, reselect
from kb.selection import Choice
from kb.state import Overlay, State
from kb.status import Status

__all__ = ["Candidate", "by_priority", "choice_by_priority", "first_by_priority", "ranked"]


class Candidate(Protocol):
    """Something that can be chosen: a function design or a component configuration."""

    @property
    def name(self) -> str: ...

    @property
    def priority(self) -> float | None: ...


def by_priority(candidate: Candidate) -> tuple[bool, float, str]:
    """Return the key that sorts: the lowest priority number first, no priority last, ties by name."""
    priority = candidate.priority
    return priority is None, 0 if priority is None else priority, candidate.name


def first_by_priority(candidates: Iterable[Candidate]) -> str | None:
    """Return the name of the candidate that comes first; None for none."""
    first = min(candidates, key=by_priority, default=None)
    return None if first is None else first.name


def ranked(state: State, whole: Node) -> list[Node]:
    """Return what can be chosen for a function or component, the first by priority first."""
    possible = (part for part in whole.parts if state.status[part.index] is not Status.UNFEASIBLE)
    return sorted(possible, key=lambda part: by_priority(_candidate(part)))


def choice_by_priority(state: State) -> Choice | None:
    """Return what is chosen in a state: for each adaptable function, then for each component adaptable given that.

    None if there is nothing to be done; a choice of nothing has what is obsolete given up.
    """
    adaptable, is_obsolete = state.adaptable.nodes(), bool(state.obsolete)
    designs = _firsts(state, adaptable, "function")
    if is_obsolete or not all(state.selected[design.index] for design in designs):
        following = Overlay(state)
        reselect(following, designs, ())
        adaptable = following.adaptable.nodes()
    configurations = _firsts(state, adaptable, "component")
    if not (designs or configurations or is_obsolete):
        return None
    return Choice(by_whole(designs), by_whole(configurations))


def _firsts(state: State, adaptable: Iterable[Node], kind: str) -> list[Node]:
    """Return the first that can be chosen for each adaptable function or component."""
    possible = (ranked(state, node) for node in adaptable if node.kind == kind)
    return [parts[0] for parts in possible if parts]


def _candidate(node: Node) -> Candidate:
    assert isinstance(node.element, FunctionDesign | Configuration)
    return node.element
