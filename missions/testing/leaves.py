"""Leaves of a tree that do as they are scripted instead of what they were written for."""

from collections.abc import Iterable
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import UnknownName
from rosa_bt import RosaAction

LETTERS: Final = {"R": Status.RUNNING, "S": Status.SUCCESS, "F": Status.FAILURE}


class LeafMock:
    """What a mocked leaf returns, and how often it was asked to work, began, and was stopped before it had ended."""

    def __init__(self, outcomes: tuple[Status, ...]) -> None:
        self._outcomes = outcomes
        self._is_running = False
        self.ticks = self.starts = self.interruptions = 0

    def initialise(self) -> None:
        self.starts += 1

    def update(self) -> Status:
        """Return the next outcome of the script, the last one again and again; called by the leaf."""
        self.ticks += 1
        outcome = self._outcomes[min(self.ticks, len(self._outcomes)) - 1]
        self._is_running = outcome is Status.RUNNING
        return outcome

    def terminate(self, new_status: Status) -> None:
        self.interruptions += self._is_running and new_status is Status.INVALID
        self._is_running = False


def mock_leaf(root: Behaviour, name: str, outcomes: str | Iterable[Status]) -> LeafMock:
    """Have a leaf of a tree return what a script says, instead of doing anything.

    The leaf stays in its place and stays what it is: a `RosaAction` still requests its action and releases it, so that
    the architecture follows; only its own work is replaced. Trees read from XML are no different.

    Args:
        root: of the tree, or of the part of it in which to look.
        name: of the leaf; where several have that name, all of them share the script.
        outcomes: one for each tick, as letters R, S and F or as statuses; the last one is repeated for ever.

    Raises:
        kb.UnknownName: no leaf has that name; the message lists the nearest ones.
        ValueError: there are no outcomes, or one is none of the three.
    """
    mock = LeafMock(_read(outcomes))
    leaves = [one for one in root.iterate() if not one.children]
    found = [leaf for leaf in leaves if leaf.name == name]
    if not found:
        raise UnknownName("leaf", name, dict.fromkeys(leaf.name for leaf in leaves))
    for leaf in found:
        own = {"initialise": mock.initialise, "update": mock.update, "terminate": mock.terminate}
        if isinstance(leaf, RosaAction):
            own |= {"save_progress": lambda: None, "restore_progress": lambda progress: None}
        vars(leaf).update(own)
    return mock


def _read(outcomes: str | Iterable[Status]) -> tuple[Status, ...]:
    script = tuple(LETTERS.get(one, one) if isinstance(one, str) else one for one in outcomes)
    wrong = [one for one in script if one not in LETTERS.values()]
    if wrong or not script:
        given = f"{wrong[0]!r} is none" if wrong else "none is given"
        raise ValueError(f"outcomes are R, S and F, or RUNNING, SUCCESS and FAILURE, at least one; {given}")
    return tuple(one for one in script if isinstance(one, Status))
