"""A world made from the state and the log of a knowledge base, so that all of it can be asked in SPARQL.

It is built from copies, beside the base: nobody who tells waits for who asks. What is so for a time is one individual
from its start on, and gets its end once it is over.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from threading import Lock
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from kb.elements import KINDS, Action, Attribute, Component, Configuration, Parameters
from kb.events import Event
from kb.exceptions import UnknownName
from kb.facts import ActiveFact, Fact, RequiredFact, SelectedFact, StatusFact
from kb.knowledge import Knowledge
from kb.owl.individuals import (
    PARAMETER,
    PREFERENCE,
    STATED,
    Individual,
    Ref,
    Value,
    element_id,
    individuals,
    named_id,
    nested,
)
from kb.owl.queries import Answer
from kb.owl.rdfxml import BASE, metamodel
from kb.records import Attempt, Process, ReconfigurationPlan, RequiredAction, VetoAnswer
from kb.state import State
from kb.store import Store

if TYPE_CHECKING:
    from kb.owl.owlready import Book

Values = dict[str, tuple[Value, ...]]
Given = Mapping[str, tuple[Value, ...]]
Record = RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer

_CLASSES: Final[Mapping[str, type]] = {kind: cls for cls, kind in KINDS.items()}
_NOTHING: Final[Mapping[str, tuple[Value, ...]]] = MappingProxyType({})
_REQUIRABLE: Final = frozenset({"action", "function", "component"})


class World:
    """All that a knowledge base knows, as individuals, brought up to date when it is asked."""

    def __init__(self, known: Knowledge, store: Store | None, keep: int) -> None:
        self._known, self._store, self._keep = known, store, keep
        self._asking = Lock()
        self._book: Book | None = None
        self._chronicle = _Chronicle(known)
        self._last, self._revision = -1, -1
        self._measured = 0

    def ask(self, sparql: str, timeout: float, reading: AbstractContextManager[State]) -> list[tuple[Answer, ...]]:
        with self._asking:
            return self._current(reading).ask(sparql, timeout)

    def _current(self, reading: AbstractContextManager[State]) -> "Book":
        if self._book is None or self._measured > 2 * self._keep:
            return self._anew(reading)
        with reading as state:
            if state.network.revision != self._revision:
                is_amended = True
            else:
                is_amended = any(one.verb == "amend" for one in self._known.log.since(self._last, measurements=False))
            if self._known.log.last == self._last and not is_amended:
                return self._book
            events = list(self._known.log.since(self._last))
            if events and events[0].number > self._last + 1:  # more happened than memory holds
                events = []
            else:
                model = self._model() if is_amended else []
                records, inferred = self._chronicle.of_records(), self._inferred(state)
                self._seen(state)
        if not events:
            return self._anew(reading)
        if model:
            self._book.write_model(model)
        self._book.write([*self._chronicle.of_events(events), *records], inferred)
        self._measured += sum(event.verb == "measure" for event in events)
        return self._book

    def _anew(self, reading: AbstractContextManager[State]) -> "Book":
        from kb.owl.owlready import Book

        past = [] if self._store is None else self._store.events(measurements=False)
        self._chronicle = chronicle = _Chronicle(self._known)
        with reading as state:
            saved = past[-1].number if past else 0
            past += self._known.log.since(saved, measurements=False)
            network = state.network
            measured = [
                (node.name, sample)
                for node in network.attributes.values()
                if node.index in state.histories
                for sample in state.histories[node.index].samples(self._keep)
            ]
            model, records, inferred = self._model(), chronicle.of_records(), self._inferred(state)
            self._seen(state)
        if self._book is not None:
            self._book.close()
        self._book = Book(f"{BASE}{model[0].id}")
        self._book.describe(metamodel(), model)
        samples = [chronicle.measurement(name, value, time) for name, (time, value) in measured]
        self._book.write([*samples, *chronicle.of_events(past), *records], inferred)
        self._measured = 0
        return self._book

    def _seen(self, state: State) -> None:
        self._last, self._revision = self._known.log.last, state.network.revision

    def _model(self) -> list[Individual]:
        return list(individuals(self._known.model, self._known.serials))

    def _inferred(self, state: State) -> list[Individual]:
        found = []
        for node in state.network.present():
            if node.kind != "attribute":
                values: Values = {"status": (str(state.status[node.index]),)}
                if node.kind in _REQUIRABLE:
                    values["isRequired"] = (state.required[node.index],)
                found.append(Individual("", element_id(node.element, self._known.serials), values))
        return found


class _Chronicle:
    """Makes individuals of events and records, each once; what has ended later is given its end."""

    def __init__(self, known: Knowledge) -> None:
        self._known = known
        self._count = 0
        self._open: dict[tuple[str, str], str] = {}
        self._asserted_failed: set[str] = set()
        self._ids: dict[int, str] = {}
        self._records: dict[tuple[str, int], Record] = {}
        self._unended: dict[tuple[str, int], Record] = {}

    def measurement(self, attribute: str, value: float, time: float) -> Individual:
        values: Values = {"measures": (Ref(named_id(Attribute, attribute)),)}
        return Individual("Measurement", self._next(), {**values, "value": (float(value),), "time": (float(time),)})

    # ---------------------------------------------------------------- what was so for a time

    def of_events(self, events: Iterable[Event]) -> Iterator[Individual]:
        for event in events:
            yield from self._of_event(event)

    def _of_event(self, event: Event) -> Iterator[Individual]:
        time, verb, arguments = event.time, event.verb, event.arguments
        if verb == "measure":
            name, value = arguments
            yield self.measurement(name, value, time)
        elif verb in ("component_failed", "component_recovered", "component_active"):
            yield from self._of_component(time, verb, named_id(Component, arguments[0]), arguments)
        elif verb == "component_configured":
            yield from self._configured(time, *arguments)
        elif verb == "finish_attempt":
            attempt = self._known.records.attempts.get(arguments[0])
            if attempt is not None and (attempt.operation, attempt.result) == ("configure", "completed"):
                yield from self._configured(time, attempt.component, attempt.parameters)
        elif verb in ("assert_status", "retract_status", "lapse"):
            about = self._about(arguments[0])
            yield from self._ended("AssertedStatus", about, time)
            if verb == "assert_status":
                _, status, reason, until = arguments
                (self._asserted_failed.add if status == "failure" else self._asserted_failed.discard)(about)
                lapse: Values = {} if until is None else {"until": (until,)}
                yield self._began("AssertedStatus", about, time, {"status": (status,), **_said(reason), **lapse})
        elif verb == "assert_required":
            yield from self._is_so("AssertedRequirement", self._about(arguments[0]), time, bool(arguments[1]))
        elif verb == "assert_selected":
            yield from self._is_so("Selection", self._about(arguments[0]), time, bool(arguments[1]), arguments[2])
        elif verb == "select":
            yield from self._selected(event)
        elif verb == "amend":
            yield from self._amended(time, *arguments)
        elif verb == "begin":
            for fact in self._known.model.facts:
                yield from self._stated(time, fact)

    def _of_component(self, time: float, verb: str, about: str, arguments: Sequence[Any]) -> Iterator[Individual]:
        if verb == "component_failed":
            yield from self._is_so("Failure", about, time, True, arguments[1])
        elif verb == "component_recovered":
            yield from self._is_so("Failure", about, time, False)
            if about in self._asserted_failed:
                yield from self._ended("AssertedStatus", about, time)
        else:
            yield from self._is_so("Activity", about, time, arguments[1])

    def _configured(self, time: float, component: str, parameters: Parameters) -> Iterator[Individual]:
        about = named_id(Component, component)
        yield from self._ended("ParametersInForce", about, time)
        own = self._next()
        within = list(nested(PARAMETER, own, parameters))
        values: Values = {"about": (Ref(about),), "start": (float(time),)}
        yield from within
        yield Individual("ParametersInForce", own, {**values, "hasParameter": tuple(Ref(one.id) for one in within)})
        self._open["ParametersInForce", about] = own

    def _selected(self, event: Event) -> Iterator[Individual]:
        designs, configurations, reason = event.arguments
        for kind, name, is_so in event.effects:
            yield from self._is_so("Selection", named_id(_CLASSES[kind], name), event.time, is_so, reason)
        changed = {(kind, name) for kind, name, _ in event.effects}
        for kind, chosen in (("function design", designs), ("configuration", configurations)):
            for name in chosen.values():
                about = named_id(_CLASSES[kind], name)
                if (kind, name) not in changed and ("Selection", about) in self._open:
                    yield from self._is_so("Selection", about, event.time, True, reason)

    def _amended(self, time: float, how: str, written: object) -> Iterator[Individual]:
        change = json.dumps({how: written})
        yield Individual("Amendment", self._next(), {"time": (float(time),), "change": (change,)})
        if how == "removed":
            for word, about in [key for key in self._open if key[1] == written]:
                yield from self._ended(word, about, time)

    def _stated(self, time: float, fact: Fact) -> Iterator[Individual]:
        if isinstance(fact, ActiveFact):
            yield self._began("Activity", named_id(Component, fact.component), time)
        elif isinstance(fact, StatusFact | RequiredFact | SelectedFact):
            about = element_id(fact.element, self._known.serials)
            if isinstance(fact, StatusFact):
                yield self._began("AssertedStatus", about, time, {"status": (str(fact.status),)})
            else:
                yield self._began("Selection" if isinstance(fact, SelectedFact) else "AssertedRequirement", about, time)

    def _is_so(self, word: str, about: str, time: float, is_so: bool, reason: str = "") -> Iterator[Individual]:
        yield from self._ended(word, about, time)
        if is_so:
            yield self._began(word, about, time, _said(reason))

    def _began(self, word: str, about: str, time: float, values: Given = _NOTHING) -> Individual:
        self._open[word, about] = own = self._next()
        return Individual(word, own, {"about": (Ref(about),), "start": (float(time),), **values})

    def _ended(self, word: str, about: str, time: float) -> Iterator[Individual]:
        own = self._open.pop((word, about), None)
        if own is not None:
            yield Individual("", own, {"end": (float(time),)})

    def _about(self, ref: Any) -> str:  # noqa: ANN401  # a reference of an event
        kind, name, *position = ref
        if not position:
            return named_id(_CLASSES[kind], name)
        try:
            return element_id(self._known.network.referred(ref).element, self._known.serials)
        except UnknownName:  # it went, and took its number with it
            return f"Constraint.{kind}.{name}.{position[0]}"

    # ---------------------------------------------------------------- records

    def of_records(self) -> list[Individual]:
        """Return the records that are new, and the ends of those that have ended."""
        records = self._known.records
        found: list[Individual] = []
        for word, table in (
            ("RequiredAction", records.requests),
            ("ReconfigurationPlan", records.plans),
            ("ComponentProcess", records.processes),
            ("Attempt", records.attempts),
            ("VetoAnswer", records.answers),
        ):
            for number, record in table.items():
                if (word, number) not in self._records:
                    found += self._recorded(word, number, record)
        for key, record in list(self._unended.items()):
            if not isinstance(record, VetoAnswer) and record.end is not None:
                del self._unended[key]
                found.append(Individual("", self._ids[id(record)], _end(record)))
        return found

    def _recorded(self, word: str, number: int, record: Record) -> Iterator[Individual]:
        self._records[word, number] = self._unended[word, number] = record
        own = self._ids[id(record)] = self._next()
        values: Values = {}
        within: list[Individual] = []
        if not isinstance(record, VetoAnswer):
            values["start"] = (float(record.start),)
        if isinstance(record, RequiredAction):
            values["about"] = (Ref(named_id(Action, record.action)),)
            preference = record.preference
            weights = {preference: 1.0} if isinstance(preference, str) else preference or {}
            within = list(nested(PREFERENCE, own, weights))
            values["hasPreference"] = tuple(Ref(one.id) for one in within)
        elif isinstance(record, ReconfigurationPlan):
            values["activates"] = tuple(Ref(named_id(Component, name)) for name in record.activate)
            values["deactivates"] = tuple(Ref(named_id(Component, name)) for name in record.deactivate)
            values["setsParametersOf"] = tuple(Ref(named_id(Configuration, name)) for name in record.parameters)
            values["reason"] = (record.reason,)
        elif isinstance(record, Process):
            values.update(about=(Ref(named_id(Component, record.component)),), pid=(record.pid,))
        else:
            if id(record.plan) in self._ids:
                values["ofPlan"] = (Ref(self._ids[id(record.plan)]),)
            if isinstance(record, VetoAnswer):
                values.update(isVetoed=(record.is_vetoed,), time=(float(record.time),), **_said(record.reason))
            else:
                values.update(about=(Ref(named_id(Component, record.component)),), operation=(record.operation,))
                values["number"] = (record.number,)
                if record.configuration is not None:
                    values["setsParametersOf"] = (Ref(named_id(Configuration, record.configuration)),)
                within = list(nested(PARAMETER, own, record.parameters))
                values["hasParameter"] = tuple(Ref(one.id) for one in within)
        yield from within
        yield Individual(word, own, {name: value for name, value in values.items() if value})

    def _next(self) -> str:
        self._count += 1
        return f"{STATED}.{self._count}"


def _end(record: RequiredAction | ReconfigurationPlan | Process | Attempt) -> Values:
    assert record.end is not None  # else it has not ended
    values: Values = {"end": (float(record.end),)}
    if not isinstance(record, Process) and record.result:
        values["result"] = (record.result,)
    if isinstance(record, RequiredAction | Attempt) and record.reason:
        values["reason"] = (record.reason,)
    return values


def _said(reason: str) -> Values:
    return {"reason": (reason,)} if reason else {}
