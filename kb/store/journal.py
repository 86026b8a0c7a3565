"""What is told to a knowledge base, numbered and in order, as individuals for a store and for queries.

What is so for a time is one individual from its start on, and gets its end once it is over. Whatever one call tells
stays together: it is all written, or nothing of it. What is told is noted, and made into individuals when it is asked
for or written.
"""

import json
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from kb.elements import Action, Changeable, Component, Configuration, Parameters
from kb.exceptions import UnknownName
from kb.history import Attempt, Process, VetoAnswer
from kb.individuals import (
    PARAMETER,
    PREFERENCE,
    STATED,
    Individual,
    Ref,
    Serials,
    Value,
    element_id,
    individual,
    named_id,
    nested,
    plain_json,
)
from kb.inference.network import Node
from kb.inference.state import Reason, State
from kb.reconfiguration import ReconfigurationPlan
from kb.requests import RequiredAction

if TYPE_CHECKING:
    from kb.contents import Contents

__all__ = ["COLUMNS", "Group", "Journal", "Measured", "Record"]

Record = RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer

COLUMNS: Final[Mapping[str, str]] = {
    "failed": "Failure",
    "active": "Activity",
    "selected": "Selection",
    "asserted": "AssertedStatus",
    "asserted_required": "AssertedRequirement",
    "verdict": "Verdict",
}
"""What is so for a time is called, by the array of a state that holds it."""

_OWN: Final[Mapping[str, tuple[str, ...]]] = {
    "component": ("failed", "active", "asserted", "asserted_required"),
    "configuration": ("selected", "asserted"),
    "function design": ("selected", "asserted"),
    "function": ("asserted", "asserted_required"),
    "action": ("asserted", "asserted_required"),
    "constraint": ("asserted", "verdict"),
    "attribute": (),
}


_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


class Measured(NamedTuple):
    """A measurement that was told; one of the past is not the latest."""

    number: int
    attribute: str
    value: float
    time: float
    latest: bool = True


class Group(NamedTuple):
    """What one call told.

    Attributes:
        last: the number of the last fact in it.
        notes: what makes the entries, when they are asked for.
    """

    last: int
    notes: Sequence["Note"]

    @property
    def entries(self) -> list[Individual]:
        """Individuals that begin, and further values of some that have begun."""
        return [entry for note in self.notes for entry in note()]


Note = Callable[[], Iterable[Individual]]


class _Entered(NamedTuple):
    number: int
    value: object
    reason: Reason | None


class Journal:
    """Numbers what is told.

    Args:
        model: whose elements are spoken of.
        keeps_measurements: whether they are numbered too; without a store they are on record elsewhere.
        most: how many calls wait to be written at most; the oldest are dropped.

    Attributes:
        serials: the numbers of what has no name.
        told: number of the last fact.
        waiting: what was told and is not written yet.
        heard: called when there is something new.
    """

    def __init__(self, model: "Contents", *, keeps_measurements: bool = False, most: int | None = None) -> None:
        self.serials = Serials(model)
        self.told = 0
        self.keeps_measurements = keeps_measurements
        self.waiting: deque[Measured | Group] = deque(maxlen=most)
        self.heard: Callable[[], None] = _nobody
        self._open: dict[tuple[str, int], _Entered] = {}
        self._records: dict[Record, int] = {}
        self._plans: dict[ReconfigurationPlan, int] = {}
        self._in_force: dict[str, int] = {}

    def measured(self, attribute: str, value: float, time: float, latest: bool = True) -> None:
        """Enter a measurement."""
        self.told += 1
        self.waiting.append(Measured(self.told, attribute, value, time, latest))
        self.heard()

    def enter(self, now: float, state: State, nodes: Iterable[Node], records: Iterable[Record] = ()) -> None:
        """Enter what is different now: of elements, and of requests, plans and processes.

        Args:
            now: since when [s].
            state: the facts.
            nodes: the elements.
            records: those that are new, and those that have ended.
        """
        notes: list[Note] = []
        for node in nodes:
            self._note_differences(notes, now, state, node)
        for record in records:
            self._note_record(notes, record)
        if notes:
            self._put(notes)

    def configured(self, now: float, component: Node, parameters: Parameters) -> None:
        """Enter that a component was given parameters."""
        notes: list[Note] = []
        number = self._in_force.get(component.name)
        if number is not None:
            self._note_end(notes, number, now)
        self._in_force[component.name] = number = self._next()
        notes.append(partial(self._configured, number, now, component, parameters))
        self._put(notes)

    def amended(
        self, now: float, how: str, elements: Sequence[Changeable], state: State, nodes: Iterable[Node]
    ) -> None:
        """Enter that the model was changed.

        Args:
            now: when [s].
            how: "declared", "changed" or "removed".
            elements: of the model; with the first one that was removed went the others.
            state: the facts, as they are after that.
            nodes: what may be different by it.
        """
        if not elements:
            return
        if how == "removed":
            written: object = element_id(elements[0], self.serials)
        else:
            written = plain_json(one for element in elements for one in individual(element, self.serials))
        values: dict[str, tuple[Value, ...]] = {"time": (float(now),), "change": (json.dumps({how: written}),)}
        notes: list[Note] = [partial(_begun, "Amendment", self._next(), values)]
        for key in [key for key in self._open if not _is_there(state, key[1])]:
            self._note_end(notes, self._open.pop(key).number, now)
        for node in nodes:
            self._note_differences(notes, now, state, node)
        self._put(notes)

    def adopt(self, number: int, column: str, node: Node, value: object, reason: Reason | None) -> None:
        """Take up what was entered before of an array of a state."""
        self._open[column, node.index] = _Entered(number, value, reason)

    def adopt_configured(self, number: int, component: str) -> None:
        """Take up which parameters were entered before."""
        self._in_force[component] = number

    def adopt_record(self, number: int, record: Record) -> None:
        """Take up a record that was entered before."""
        if isinstance(record, ReconfigurationPlan):
            self._plans[record] = number
        if not isinstance(record, VetoAnswer) and record.end is None:
            self._records[record] = number

    def _put(self, notes: Sequence[Note]) -> None:
        self.waiting.append(Group(self.told, notes))
        self.heard()

    def _next(self) -> int:
        self.told += 1
        return self.told

    def _note_differences(self, notes: list[Note], now: float, state: State, node: Node) -> None:
        for column in _OWN[node.kind]:
            key, value = (column, node.index), getattr(state, column)[node.index]
            known = self._open.get(key)
            if known is None and not value:
                continue
            reason = state.reasons.get(key)
            if known is not None:
                if value == known.value and reason == known.reason:
                    continue
                self._note_end(notes, known.number, now)
                del self._open[key]
            if value:
                number = self._next()
                self._open[key] = _Entered(number, value, reason)
                notes.append(partial(self._stated, number, now, column, node, value, reason))

    def _note_end(self, notes: list[Note], number: int, end: float) -> None:
        """Note the end of what has a number; that it ended is a fact too, and counted."""
        self.told += 1
        notes.append(partial(_ended, number, end))

    def _note_record(self, notes: list[Note], record: Record) -> None:
        number = self._records.get(record) if not isinstance(record, VetoAnswer) else None
        if number is None:
            number = self._next()
            notes.append(partial(self._recorded, number, record))
        if isinstance(record, VetoAnswer):
            return
        if isinstance(record, ReconfigurationPlan):
            self._plans[record] = number
        self._records[record] = number
        if record.end is not None:
            self.told += 1
            notes.append(partial(_record_ended, number, record))
            del self._records[record]

    def _stated(
        self, number: int, start: float, column: str, node: Node, value: object, reason: Reason | None
    ) -> list[Individual]:
        values: dict[str, tuple[Value, ...]] = {"about": (self._ref(node),), "start": (float(start),)}
        if value is not True:
            values["status"] = (str(value),)
        return _begun(COLUMNS[column], number, {**values, **_said(reason)})

    def _configured(self, number: int, start: float, component: Node, parameters: Parameters) -> list[Individual]:
        values: dict[str, tuple[Value, ...]] = {"about": (self._ref(component),), "start": (float(start),)}
        return _begun("ParametersInForce", number, values, PARAMETER, parameters)

    def _recorded(self, number: int, record: Record) -> list[Individual]:
        if isinstance(record, VetoAnswer):
            answer: dict[str, tuple[Value, ...]] = {"isVetoed": (record.is_vetoed,), "time": (float(record.time),)}
            of_plan = self._of_plan(record.plan)
            return _begun("VetoAnswer", number, {**of_plan, **answer, **_said(Reason(record.reason))})
        values: dict[str, tuple[Value, ...]] = {"start": (float(record.start),)}
        if isinstance(record, RequiredAction):
            values["about"] = (Ref(named_id(Action, record.action)),)
            return _begun("RequiredAction", number, values, PREFERENCE, _weights(record.preference))
        if isinstance(record, ReconfigurationPlan):
            values["activates"] = tuple(Ref(named_id(Component, name)) for name in record.activate)
            values["deactivates"] = tuple(Ref(named_id(Component, name)) for name in record.deactivate)
            values["setsParametersOf"] = tuple(Ref(named_id(Configuration, name)) for name in record.parameters)
            values["reason"] = (record.reason,)
            return _begun("ReconfigurationPlan", number, values)
        values["about"] = (Ref(named_id(Component, record.component)),)
        if isinstance(record, Process):
            return _begun("ComponentProcess", number, {**values, "pid": (record.pid,)})
        values.update(self._of_plan(record.plan))
        values.update(operation=(record.operation,), number=(record.number,))
        if record.configuration is not None:
            values["setsParametersOf"] = (Ref(named_id(Configuration, record.configuration)),)
        return _begun("Attempt", number, values, PARAMETER, record.parameters)

    def _of_plan(self, plan: ReconfigurationPlan) -> dict[str, tuple[Value, ...]]:
        number = self._plans.get(plan)
        return {} if number is None else {"ofPlan": (Ref(f"{STATED}.{number}"),)}

    def _ref(self, node: Node) -> Ref:
        return Ref(element_id(node.element, self.serials))


_NESTED: Final = {PARAMETER: "hasParameter", PREFERENCE: "hasPreference"}


def _begun(
    kind: str,
    number: int,
    values: Mapping[str, tuple[Value, ...]],
    sort: str = PARAMETER,
    inner: Mapping[str, Any] = _NOTHING,
) -> list[Individual]:
    """Return an individual after those nested in it."""
    own = f"{STATED}.{number}"
    within = list(nested(sort, own, inner))
    held = {_NESTED[sort]: tuple(Ref(one.id) for one in within)} if within else {}
    return [*within, Individual(kind, own, {**values, **held})]


def _ended(number: int, end: float) -> list[Individual]:
    return [Individual("", f"{STATED}.{number}", {"end": (float(end),)})]


def _record_ended(number: int, record: RequiredAction | ReconfigurationPlan | Process | Attempt) -> list[Individual]:
    assert record.end is not None  # else it is not noted
    values: dict[str, tuple[Value, ...]] = {"end": (float(record.end),)}
    if not isinstance(record, Process) and record.result:
        values["result"] = (record.result,)
    if isinstance(record, RequiredAction | Attempt) and record.reason:
        values["reason"] = (record.reason,)
    return [Individual("", f"{STATED}.{number}", values)]


def _nobody() -> None:
    """Nobody waits for what is told."""


def _said(reason: Reason | None) -> dict[str, tuple[Value, ...]]:
    if reason is None:
        return {}
    values: dict[str, tuple[Value, ...]] = {"reason": (reason.text,)} if reason.text else {}
    return values if reason.until is None else {**values, "until": (float(reason.until),)}


def _weights(preference: str | Mapping[str, float] | None) -> Mapping[str, float]:
    return {preference: 1.0} if isinstance(preference, str) else preference or {}


def _is_there(state: State, index: int) -> bool:
    try:
        state.network.find(state.network.nodes[index].element)
    except UnknownName:
        return False
    return True
