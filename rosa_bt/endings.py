"""How behaviours come to an end whatever they do: stopped for certain, and an exception told in words."""

from py_trees.behaviour import Behaviour
from py_trees.common import Status

__all__ = ["halt", "halt_orphans", "told"]


def told(error: Exception) -> str:
    """Return an exception as the feedback of the behaviour that raised it."""
    return f"{type(error).__name__}: {error}"


def halt(root: Behaviour) -> None:
    """Stop every running behaviour of a subtree, children first; what one raises is its feedback and stops no other."""
    for behaviour in list(root.iterate()):
        if behaviour.status is not Status.RUNNING:
            continue
        try:
            behaviour.stop(Status.INVALID)
        except Exception as error:
            behaviour.feedback_message = f"in terminate: {told(error)}"
        behaviour.status = Status.INVALID


def halt_orphans(root: Behaviour) -> None:
    """Stop what runs below behaviours that do not run."""
    if root.status is not Status.RUNNING:
        halt(root)
    else:
        for child in root.children:
            halt_orphans(child)
