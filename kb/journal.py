"""What is told to a knowledge base, numbered and in order, as individuals for a store and for queries.

What is so for a time is one individual from its start on, and gets its end once it is over. Whatever one call tells
stays together: it is all written, or nothing of it.
"""

import json
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

from kb.amendments import Changeable
from kb.elements import Action, Component, Configuration, Parameters
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
from kb.network import Node
from kb.reconfiguration import ReconfigurationPlan
from kb.requests import RequiredAction
from kb.state import Reason, State

if TYPE_CHECKING:
    from kb.model import Model

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
        entries: individuals that begin, and further values of some that have begun.
    """

    last: int
    entries: Sequence[Individual]


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

    def __init__(self, model: "Model", *, keeps_measurements: bool = False, most: int | None = None) -> None:
        self.serials = Serials(model)
        self.told = 0
        self.keeps_measurements = keeps_measurements
        self.waiting: deque[Measured | Group] = deque(maxlen=most)
        self.heard: Callable[[], None] = _nobody
        self._open: dict[tuple[str, int], tuple[int, object, Reason | None]] = {}
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
        entries = [entry for node in nodes for entry in self._differences(now, state, node)]
        entries += [entry for record in records for entry in self._recorded(record)]
        if entries:
            self._put(entries)

    def configured(self, now: float, component: Node, parameters: Parameters) -> None:
        """Enter that a component was given parameters."""
        entries = self._ended(self._in_force.pop(component.name, None), now)
        inner = list(nested(PARAMETER, f"{STATED}.{self.told + 1}", parameters))
        values: dict[str, tuple[Value, ...]] = {"about": (self._ref(component),), "start": (float(now),)}
        values["hasParameter"] = tuple(Ref(one.id) for one in inner)
        entries += [*inner, self._begun("ParametersInForce", values)]
        self._in_force[component.name] = self.told
        self._put(entries)

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
        entries = [self._begun("Amendment", {"time": (float(now),), "change": (json.dumps({how: written}),)})]
        for key in [key for key in self._open if not _is_there(state, key[1])]:
            entries += self._ended(self._open.pop(key)[0], now)
        entries += [entry for node in nodes for entry in self._differences(now, state, node)]
        self._put(entries)

    def adopt(self, number: int, column: str, node: Node, value: object, reason: Reason | None) -> None:
        """Take up what was entered before of an array of a state."""
        self._open[column, node.index] = (number, value, reason)

    def adopt_configured(self, number: int, component: str) -> None:
        """Take up which parameters were entered before."""
        self._in_force[component] = number

    def adopt_record(self, number: int, record: Record) -> None:
        """Take up a record that was entered before."""
        if isinstance(record, ReconfigurationPlan):
            self._plans[record] = number
        if not isinstance(record, VetoAnswer) and record.end is None:
            self._records[record] = number

    def _put(self, entries: Sequence[Individual]) -> None:
        self.waiting.append(Group(self.told, entries))
        self.heard()

    def _differences(self, now: float, state: State, node: Node) -> list[Individual]:
        entries: list[Individual] = []
        for column in _OWN[node.kind]:
            key, value = (column, node.index), getattr(state, column)[node.index]
            number, known, said = self._open.get(key, (None, None, None))
            reason = state.reasons.get(key)
            if (value == known and reason == said) or (not value and number is None):
                continue
            entries += self._ended(number, now)
            self._open.pop(key, None)
            if value:
                about: dict[str, tuple[Value, ...]] = {"about": (self._ref(node),), "start": (float(now),)}
                if value is not True:
                    about["status"] = (str(value),)
                entries.append(self._begun(COLUMNS[column], {**about, **_said(reason)}))
                self._open[key] = (self.told, value, reason)
        return entries

    def _recorded(self, record: Record) -> list[Individual]:
        number = self._records.get(record)
        entries = []
        if number is None:
            kind, values = self._described(record)
            entries = self._inner(record, values)
            entries.append(self._begun(kind, values))
            if isinstance(record, VetoAnswer):
                return entries
            if isinstance(record, ReconfigurationPlan):
                self._plans[record] = self.told
            number = self._records[record] = self.told
        if not isinstance(record, VetoAnswer) and record.end is not None:
            entries += self._ended(number, record.end, record)
        return entries

    def _inner(self, record: Record, values: dict[str, tuple[Value, ...]]) -> list[Individual]:
        """Return what is nested in a record that begins now, after adding it to its values."""
        own = f"{STATED}.{self.told + 1}"
        if isinstance(record, Attempt):
            entries = list(nested(PARAMETER, own, record.parameters))
        else:
            entries = list(nested(PREFERENCE, own, _weights(record)))
        if entries:
            word = "hasParameter" if isinstance(record, Attempt) else "hasPreference"
            values[word] = tuple(Ref(one.id) for one in entries)
        return entries

    def _described(self, record: Record) -> tuple[str, dict[str, tuple[Value, ...]]]:
        if isinstance(record, VetoAnswer):
            values: dict[str, tuple[Value, ...]] = {"isVetoed": (record.is_vetoed,), "time": (float(record.time),)}
            return "VetoAnswer", {**self._of_plan(record.plan), **values, **_said(Reason(record.reason))}
        start = float(record.start)
        if isinstance(record, Attempt):
            values = {"about": (Ref(named_id(Component, record.component)),), "operation": (record.operation,)}
            if record.configuration is not None:
                values["setsParametersOf"] = (Ref(named_id(Configuration, record.configuration)),)
            return "Attempt", {**self._of_plan(record.plan), **values, "number": (record.number,), "start": (start,)}
        if isinstance(record, RequiredAction):
            return "RequiredAction", {"about": (Ref(named_id(Action, record.action)),), "start": (start,)}
        if isinstance(record, Process):
            about = Ref(named_id(Component, record.component))
            return "ComponentProcess", {"about": (about,), "pid": (record.pid,), "start": (start,)}
        return "ReconfigurationPlan", {
            "activates": tuple(Ref(named_id(Component, name)) for name in record.activate),
            "deactivates": tuple(Ref(named_id(Component, name)) for name in record.deactivate),
            "setsParametersOf": tuple(Ref(named_id(Configuration, name)) for name in record.parameters),
            "reason": (record.reason,),
            "start": (start,),
        }

    def _of_plan(self, plan: ReconfigurationPlan) -> dict[str, tuple[Value, ...]]:
        number = self._plans.get(plan)
        return {} if number is None else {"ofPlan": (Ref(f"{STATED}.{number}"),)}

    def _begun(self, kind: str, values: Mapping[str, tuple[Value, ...]]) -> Individual:
        self.told += 1
        return Individual(kind, f"{STATED}.{self.told}", values)

    def _ended(self, number: int | None, end: float, record: Record | None = None) -> list[Individual]:
        """Return the end of what has a number; that it ended is a fact too, and counted."""
        if number is None:
            return []
        self.told += 1
        values: dict[str, tuple[Value, ...]] = {"end": (float(end),)}
        if record is not None:
            self._records.pop(record, None)
        if isinstance(record, RequiredAction | ReconfigurationPlan | Attempt):
            values["result"] = (str(record.result),) if record.result else ()
        if isinstance(record, RequiredAction | Attempt) and record.reason:
            values["reason"] = (record.reason,)
        return [Individual("", f"{STATED}.{number}", values)]

    def _ref(self, node: Node) -> Ref:
        return Ref(element_id(node.element, self.serials))


def _nobody() -> None:
    """Nobody waits for what is told."""


def _said(reason: Reason | None) -> dict[str, tuple[Value, ...]]:
    if reason is None:
        return {}
    values: dict[str, tuple[Value, ...]] = {"reason": (reason.text,)} if reason.text else {}
    return values if reason.until is None else {**values, "until": (float(reason.until),)}


def _weights(record: Record) -> Mapping[str, float]:
    given = record.preference if isinstance(record, RequiredAction) else None
    return {given: 1.0} if isinstance(given, str) else given or {}


def _is_there(state: State, index: int) -> bool:
    try:
        state.network.find(state.network.nodes[index].element)
    except UnknownName:
        return False
    return True
