"""The errors of the PDDL layer; all derive from `RosaPddlError`."""

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path


class RosaPddlError(Exception):
    """Base of every error that this package raises."""


class PddlError(RosaPddlError):
    """A PDDL file cannot be used; the message says where, what was found and what was expected.

    Line and column are counted from 1; None when unknown.
    """

    def __init__(
        self, message: str, file: str | Path, line: int | None = None, column: int | None = None
    ) -> None:
        self.message = message
        self.file = str(file)
        self.line = line
        self.column = column
        place = ":".join(str(part) for part in (file, line, column) if part is not None)
        super().__init__(f"{place}: {message}")


class UnsupportedPddlError(PddlError):
    """PDDL that is correct, but that the executor or its planner cannot handle."""


class UnknownNameError(RosaPddlError):
    """A name that the domain does not know; the message lists the nearest known ones."""


class UnknownObjectError(UnknownNameError):
    """The name of an object that the files do not have."""


class MissingBehaviourError(RosaPddlError):
    """A PDDL action has no factory that makes its behaviour."""


class GoalError(RosaPddlError):
    """A goal that cannot be added or dropped."""


class SensingError(RosaPddlError):
    """A value that is sensed or forecast cannot be used."""


class PlannerSettingError(RosaPddlError):
    """A setting of a planner makes no sense."""


class PlanningBudgetError(RosaPddlError):
    """In lock-step simulation, planning took more wall-clock time than its budget.

    Going on would make the run depend on the speed of the machine, so the run ends instead.
    """


def nearest(name: str, known: Iterable[str]) -> str:
    """Return half a sentence for an error message: the known names nearest to a misspelt one, or else the first ten."""
    names = sorted(set(known))
    if not names:
        return "there are none"
    by_lower = {candidate.lower(): candidate for candidate in names}
    close = [
        by_lower[match] for match in get_close_matches(name.lower(), by_lower, n=3, cutoff=0.5)
    ]
    if close:
        return "nearest: " + ", ".join(close)
    shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
    return "known: " + shown
