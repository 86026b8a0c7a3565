"""The choice by priority, a pure function of a state.

Of what is possible the lowest priority number is chosen; no priority comes last, ties go by name.
"""

from kb.elements import Configuration, FunctionDesign
from kb.inference.network import Node
from kb.inference.state import Overlay, State
from kb.reconfiguration import by_whole, reselect
from kb.selection import Choice, by_priority
from kb.status import Status

__all__ = ["choice_by_priority", "ranked"]


def ranked(state: State, whole: Node) -> list[Node]:
    """Return what can be chosen for a function or component, the first by priority first."""
    return sorted((part for part in whole.parts if state.status[part.index] is not Status.UNFEASIBLE), key=_rank)


def choice_by_priority(state: State) -> Choice | None:
    """Return what is chosen in a state: for each adaptable function, then for each component adaptable given that.

    None if there is nothing to be done; a choice of nothing has what is obsolete given up.
    """
    designs, following = _firsts(state, state, "function"), state
    if designs or state.obsolete:
        following = Overlay(state)
        reselect(following, designs, ())
    configurations = _firsts(state, following, "component")
    if not (designs or configurations or state.obsolete):
        return None
    return Choice(by_whole(designs), by_whole(configurations))


def _firsts(state: State, following: State, kind: str) -> list[Node]:
    """Return the first that can be chosen for each function or component that is adaptable in what follows."""
    wholes = (ranked(state, node) for node in following.adaptable.nodes() if node.kind == kind)
    return [parts[0] for parts in wholes if parts]


def _rank(node: Node) -> tuple[bool, float, str]:
    assert isinstance(node.element, FunctionDesign | Configuration)
    return by_priority(node.element)
