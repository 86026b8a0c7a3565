"""What happened, in order, as lines that a person reads: what was heard, what was decided, and why."""

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from kb import Event, EventKind, ReconfigurationPlan
from missions.testing.witness import TaskChange

__all__ = ["Moment", "around", "seconds", "timeline"]

AROUND: Final = 3
"""How many moments before and after the expected time a failure shows."""
MOST: Final = 24
"""How many moments a failure shows at most."""


class Moment(NamedTuple):
    """One line of a timeline.

    Attributes:
        time: when [s].
        what: "heard", "action" or "plan"; "end", of a mission that ended before its recording.
        text: what happened, in words.
        reason: why; empty where nobody asked.
    """

    time: float
    what: str
    text: str
    reason: str = ""

    def __str__(self) -> str:
        line = f"{seconds(self.time):>11}  {self.what:<8}  {self.text}"
        return f"{line}\n{'':23}because {self.reason}" if self.reason else line


def seconds(time: float) -> str:
    """Return a time as text, to the hundredth of a second."""
    return f"{time:.2f} s"


def timeline(events: Iterable[Event], changes: Iterable[TaskChange]) -> tuple[Moment, ...]:
    """Return what happened as moments, in order.

    Args:
        events: all that were told.
        changes: how the task has changed in them.
    """
    reasons = {(one.at, one.to): one.reason for one in changes}
    moments = []
    for event in events:
        if event.plan is not None:
            moments.append(
                Moment(event.time, "plan", f"{_commanded(event.plan)}: {_ending(event.plan)}", event.plan.reason)
            )
        elif event.kind is EventKind.ACTION_UPDATE:
            is_begun = event.verb == "request_action"
            reason = reasons.get((event.time, event.subject), "") if is_begun else ""
            moments.append(Moment(event.time, "action", event.text, reason))
        elif not _is_our_own(event):
            moments.append(Moment(event.time, "heard", event.text))
    return tuple(moments)


def around(moments: Sequence[Moment], begin: float, end: float, expected: str) -> str:
    """Return the moments in an interval [s], and a few before and after, with the expectation at its place."""
    before = [one for one in moments if one.time < begin]
    within = [one for one in moments if begin <= one.time <= end]
    after = [one for one in moments if one.time > end]
    shown = [*map(str, before[-AROUND:]), f"{seconds(begin):>11}  EXPECTED  {expected}"]
    shown += [*map(str, within[: MOST - 2 * AROUND])]
    if len(within) > MOST - 2 * AROUND:
        shown.append(f"{'':13}... and {len(within) - MOST + 2 * AROUND} more until {seconds(end)}")
    return "\n".join([*shown, *map(str, after[:AROUND])])


def _commanded(plan: ReconfigurationPlan) -> str:
    """Return what a plan commands; what it only notes is left out, unless there is nothing else."""
    return str(plan).partition("; note as ")[0]


def _ending(plan: ReconfigurationPlan) -> str:
    return f"{plan.result} at {seconds(plan.end)}" if plan.end is not None else "still open"


def _is_our_own(event: Event) -> bool:
    """Tell whether an event only notes what a plan has switched; the plan's own line says it."""
    if event.kind is EventKind.RECORD:
        return True
    if event.verb != "component_active":
        return False
    _, is_active, reason = event.arguments
    return is_active or not reason
