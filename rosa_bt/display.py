"""A tree as text: py_trees' own, with the actions that cannot be done now."""

from contextlib import suppress

from py_trees.behaviour import Behaviour
from py_trees.display import ascii_tree as plain_tree

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.decorators import ForAction
from rosa_bt.requests import why


def ascii_tree(root: Behaviour) -> str:
    """Return a tree as text: statuses and feedback as in py_trees, then why actions are unfeasible.

    The statuses are those after the last tick; the feasibility is that of now.
    """
    reasons = dict[str, None]()
    for node in root.iterate():
        if isinstance(node, ActionBehaviour | ForAction):
            with suppress(Exception):  # its port is not written yet, or names no action
                if not node.kb.is_feasible(node.action):
                    reasons[f"{why(node.kb, node.action)}\n"] = None
    return plain_tree(root, show_status=True) + "".join(reasons)
