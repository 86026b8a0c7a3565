"""What a knowledge base tells those who listen: the original's three kinds of events, in order."""

from enum import StrEnum
from typing import NamedTuple

from kb.reconfiguration import ReconfigurationPlan
from kb.status import Status

__all__ = ["Event", "EventKind", "StatusChange"]


class EventKind(StrEnum):
    """What kind of knowledge arrived."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"


class StatusChange(NamedTuple):
    """A status that is not what it was."""

    kind: str
    name: str
    old: Status
    new: Status


class Event(NamedTuple):
    """Something was told to the knowledge base.

    Attributes:
        kind: one of the three kinds.
        time: when [s].
        subject: name of the attribute, component, action or other element that it is about; empty for a plan.
        text: what, in words, e.g. "light is 0.3" or "gripper has failed".
        changes: the statuses that changed because of it.
        plan: the plan, for a reconfiguration plan.
    """

    kind: EventKind
    time: float
    subject: str
    text: str
    changes: tuple[StatusChange, ...] = ()
    plan: ReconfigurationPlan | None = None
