"""Events: everything that becomes known, one after the other, as data that can be written down and told again."""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from typing import Any, Final, NamedTuple, Self

from kb.records import ReconfigurationPlan
from kb.status import Status

__all__ = ["Event", "EventKind", "StatusChange"]


class EventKind(StrEnum):
    """What kind of knowledge arrived: the original's three kinds, and what is only put on record."""

    MONITORING_DATA = "monitoring data"
    ACTION_UPDATE = "action update"
    RECONFIGURATION_PLAN = "reconfiguration plan"
    RECORD = "record"


_KINDS: Final[Mapping[str, EventKind]] = {
    "request_action": EventKind.ACTION_UPDATE,
    "cancel_action": EventKind.ACTION_UPDATE,
    "component_configured": EventKind.RECORD,
    "component_started": EventKind.RECORD,
    "component_ended": EventKind.RECORD,
    "finish_plan": EventKind.RECORD,
    "record_attempt": EventKind.RECORD,
    "finish_attempt": EventKind.RECORD,
    "record_answer": EventKind.RECORD,
    "store": EventKind.RECORD,
}
"""Any other verb is of monitoring data, but for a selection that makes a plan."""


class StatusChange(NamedTuple):
    """A status that is not what it was."""

    kind: str
    name: str
    old: Status
    new: Status


class Event(NamedTuple):
    """Something that became known: somebody told it, or time or the model made it so.

    Attributes:
        number: 1 for the first.
        time: when [s].
        verb: name of the method of `KnowledgeBase` that tells it again, e.g. "measure"; "stale", "dwell" and "lapse"
            are what time does, "begin" is what the model states, "amend" a change of the model, "store" how the store
            is.
        arguments: of the method, all of them, as plain values: names, numbers, texts. An element is (kind, name), a
            constraint (kind, name, position) by what it constrains, a plan or attempt its number.
        changes: the statuses that changed by it.
        cause: number of the event that caused it; None if that is not known, or it is news from outside.
        effects: what was selected, or is no longer, by a selection: (kind, name, whether it is selected).
        plan: the plan that a selection made.
        words: the event in words, if whoever made it knows them better than the arguments say.
    """

    number: int
    time: float
    verb: str
    arguments: tuple[Any, ...]
    changes: tuple[StatusChange, ...] = ()
    cause: int | None = None
    effects: tuple[tuple[str, str, bool], ...] = ()
    plan: ReconfigurationPlan | None = None
    words: str = ""

    @property
    def kind(self) -> EventKind:
        """What kind of knowledge it is."""
        if self.plan is not None:
            return EventKind.RECONFIGURATION_PLAN
        return _KINDS.get(self.verb, EventKind.MONITORING_DATA)

    @property
    def subject(self) -> str:
        """Name of the attribute, component, action or other element that it is about; empty where it is about none."""
        first = self.arguments[0] if self.arguments else ""
        if isinstance(first, tuple):
            return str(first[1])
        return first if isinstance(first, str) and self.verb not in ("store", "amend") else ""

    @property
    def text(self) -> str:
        """What, in words, e.g. "light is 0.3" or "gripper has failed"."""
        if self.words:
            return self.words
        if self.plan is not None:
            return str(self.plan)
        if self.effects:
            return ", ".join(f"{name} is {'' if is_so else 'not '}selected" for _, name, is_so in self.effects)
        found = _WORDS.get(self.verb)
        given = map(str, self.arguments)
        return f"{self.verb.replace('_', ' ')}: {', '.join(given)}" if found is None else found(self)

    def to_json(self) -> dict[str, Any]:
        """Return it as values that JSON can hold; `from_json` is the way back, but for the plan."""
        written: dict[str, Any] = {
            "number": self.number,
            "time": self.time,
            "verb": self.verb,
            "arguments": [_plain(one) for one in self.arguments],
        }
        if self.changes:
            written["changes"] = [list(map(str, one)) for one in self.changes]
        if self.cause is not None:
            written["cause"] = self.cause
        if self.effects:
            written["effects"] = [list(one) for one in self.effects]
        if self.words:
            written["words"] = self.words
        return written

    @classmethod
    def from_json(cls, written: Mapping[str, Any]) -> Self:
        """Return the event that was written.

        Raises:
            LookupError, TypeError, ValueError: that was no event.
        """
        changes = tuple(
            StatusChange(kind, name, Status(old), Status(new)) for kind, name, old, new in written.get("changes", ())
        )
        return cls(
            int(written["number"]),
            float(written["time"]),
            str(written["verb"]),
            tuple(tuple(one) if isinstance(one, list) else one for one in written["arguments"]),
            changes,
            written.get("cause"),
            tuple((kind, name, bool(selected)) for kind, name, selected in written.get("effects", ())),
            None,
            str(written.get("words", "")),
        )


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    return value


def _of(event: Event, place: int) -> str:
    """Return an argument that is a reason, in brackets; nothing if none was given."""
    return f" ({event.arguments[place]})" if event.arguments[place] else ""


_WORDS: Final[Mapping[str, Callable[[Event], str]]] = {
    "measure": lambda one: f"{one.subject} is {one.arguments[1]:g}",
    "component_failed": lambda one: f"{one.subject} has failed{_of(one, 1)}",
    "component_recovered": lambda one: f"{one.subject} is recovered",
    "component_active": lambda one: f"{one.subject} is {'active' if one.arguments[1] else f'inactive{_of(one, 2)}'}",
    "component_started": lambda one: f"{one.subject} runs as process {one.arguments[1]}",
    "component_ended": lambda one: f"{one.subject} no longer runs as process {one.arguments[1] or ''}".rstrip(),
    "request_action": lambda one: f"{one.subject} is requested",
    "cancel_action": lambda one: f"{one.subject} is {': '.join(filter(None, one.arguments[1:]))}",
    "retract_status": lambda one: f"{one.subject} is no longer asserted",
    "lapse": lambda one: f"{one.subject} is no longer asserted {one.arguments[1]}: its time is over",
    "assert_required": lambda one: f"{one.subject} is {'' if one.arguments[1] else 'no longer '}asserted required",
    "assert_selected": lambda one: f"{one.subject} is {'' if one.arguments[1] else 'not '}selected{_of(one, 2)}",
    "note_no_choice": lambda one: (
        f"nothing can be selected because {one.subject}" if one.subject else "something can be selected again"
    ),
    "finish_plan": lambda one: "plan {} is {}".format(*one.arguments),
    "finish_attempt": lambda one: f"attempt {one.arguments[0]} is {one.arguments[1]}{_of(one, 2)}",
    "record_answer": lambda one: (
        f"plan {one.arguments[0]} {'is vetoed' if one.arguments[1] else 'may be executed'}{_of(one, 2)}"
    ),
    "store": lambda one: str(one.arguments[0]),
    "begin": lambda _: "begins with what the model states",
}
"""An event in words, by its verb."""
