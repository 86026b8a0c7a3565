"""What a state makes of a model that changes while it is in use."""

from collections.abc import Iterable

from kb.elements import Constraint, Element
from kb.inference.network import Node
from kb.inference.settling import serve, settle
from kb.inference.state import State

__all__ = ["grown", "shrunk"]


def grown(state: State, added: Iterable[Element | Constraint]) -> list[Node]:
    """Add elements to a state and its network; returns the nodes from which to infer again."""
    nodes = [state.network.add(element) for element in added]
    state.grow()
    for node in nodes:
        if node.kind == "function design" and state.required[node.wholes[0].index]:
            serve(state, node, True)
    return [*nodes, *(whole for node in nodes for whole in node.wholes)]


def shrunk(state: State, removed: Iterable[Element | Constraint]) -> list[Node]:
    """Take elements out of a state and its network, with all that is known of them; returns as `grown` does."""
    nodes = [state.network.find(element) for element in removed]
    for node in nodes:
        for facts in (state.requested, state.asserted_required, state.selected, state.active, state.failed):
            facts[node.index] = False
        state.asserted[node.index] = None
        for column in ("active", "asserted", "failed", "selected", "unselected"):
            state.give_reason(column, node)
    settle(state, nodes)
    touched: dict[Node, None] = {}
    for node in nodes:
        if node.kind == "function design" and state.required[node.wholes[0].index]:
            serve(state, node, False)
        for marked in (state.adaptable, state.obsolete, state.lacking):
            marked.mark(node, False)
        touched.update(dict.fromkeys(state.network.remove(node)))
    return [node for node in touched if node not in nodes]
