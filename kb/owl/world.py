"""A world made from the state and the log of a knowledge base, so that all of it can be asked in SPARQL.

It is built from copies, beside the base: nobody who tells waits for who asks. What is so for a time is one individual
from its start on, and gets its end once it is over.
"""

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import chain
from threading import Lock
from types import MappingProxyType, SimpleNamespace
from typing import Any, Final
from weakref import finalize

from kb.elements import KINDS, Action, Attribute, Changeable, Component, Configuration, Parameters
from kb.events import Event
from kb.exceptions import InvalidValue, UnknownName
from kb.facts import TABLES, ActiveFact, Fact, RequiredFact, SelectedFact, StatusFact
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
from kb.owl.rdfxml import BASE, metamodel
from kb.owl.worker import Answer, Worker, give_back, stopped, take
from kb.records import Attempt, Process, ReconfigurationPlan, RequiredAction, VetoAnswer
from kb.state import State
from kb.status import Status
from kb.store import Store

Values = dict[str, tuple[Value, ...]]
Given = Mapping[str, tuple[Value, ...]]
Record = RequiredAction | ReconfigurationPlan | Process | Attempt | VetoAnswer

_CLASSES: Final[Mapping[str, type]] = {kind: cls for cls, kind in KINDS.items()}
_NOTHING: Final[Mapping[str, tuple[Value, ...]]] = MappingProxyType({})
_PRESENT: Final[Mapping[str, str]] = {
    "Failure": "failed",
    "Activity": "active",
    "Selection": "selected",
    "AssertedStatus": "asserted",
    "AssertedRequirement": "asserted_required",
}
"""What can be so now, by the facts of the state that say so."""
_LONGEST: Final = 1_000_000  # query [characters]
_SLICE: Final = 1000  # events of the store that are read at a time
_MOST_GROWN: Final = 20_000  # events, besides measurements that are kept, that are added before a world is made anew
_REQUIRABLE: Final = frozenset({"action", "function", "component"})


class World:
    """All that a knowledge base knows, as individuals, brought up to date when it is asked."""

    def __init__(self, known: Knowledge, store: Store | None, keep: int) -> None:
        self._known, self._store, self._keep = known, store, keep
        self._asking = Lock()
        self._workers: list[Worker] = []
        self._is_built = False
        self._steps: Iterator[None] = iter(())
        self._chronicle = _Chronicle(known)
        self._last, self._revision = -1, -1
        self._grown = 0
        finalize(self, give_back, self._workers)

    def ask(self, sparql: str, timeout: float, reading: AbstractContextManager[State]) -> list[tuple[Answer, ...]]:
        if not isinstance(sparql, str) or len(sparql) > _LONGEST:
            what = f"{len(sparql)} characters" if isinstance(sparql, str) else repr(sparql)
            raise InvalidValue(f"a query is a text in SPARQL, not {what}; it has at most {_LONGEST} characters")
        deadline = time.monotonic() + timeout
        if not self._asking.acquire(timeout=timeout):
            raise stopped(timeout)
        try:
            worker = self._worker()
            if not worker.is_ready(deadline):
                raise stopped(timeout)
            for _ in self._renewal(reading):
                if time.monotonic() > deadline:
                    raise stopped(timeout)
            now = time.monotonic()
            return worker.ask(sparql, timeout, max(deadline, now + timeout / 4))
        finally:
            self._asking.release()

    def let_go(self) -> None:
        """Have others use the process, unless it is being asked; who asks again gets another one."""
        if self._asking.acquire(blocking=False):
            give_back(self._workers)
            self._asking.release()

    def _worker(self) -> Worker:
        if not self._workers or not self._workers[0].is_alive:
            for worker in self._workers:
                worker.end()
            self._workers[:] = [take()]
            self._is_built, self._steps = False, iter(())
        return self._workers[0]

    def _renewal(self, reading: AbstractContextManager[State]) -> Iterator[None]:
        """Have the worker hold all that is known now, in steps; what was stopped on the way is gone on with."""
        yield from self._steps
        self._steps = self._more(reading)
        yield from self._steps

    def _more(self, reading: AbstractContextManager[State]) -> Iterator[None]:
        """Hand over what is new, or all if it has grown too much."""
        worker = self._workers[0]
        if not self._is_built or self._grown > 2 * self._keep + _MOST_GROWN:
            yield from self._anew(worker, reading)
            return
        with reading as state:
            events = list(self._known.log.since(self._last))
            is_amended = state.network.revision != self._revision or any(one.verb == "amend" for one in events)
            if self._known.log.last == self._last and not is_amended:
                return
            is_lost = len(events) < self._known.log.last - self._last  # more happened than memory holds
            if not is_lost:
                model = self._model() if is_amended else None
                records, inferred = self._chronicle.of_records(), self._inferred(state)
                self._seen(state)
        if is_lost:
            yield from self._anew(worker, reading)
            return
        self._is_built = False  # until all of it is there
        if model is not None:
            yield from self._replace(worker, "model", model)
        yield from worker.write("told", chain(self._chronicle.of_events(events), records))
        yield from self._replace(worker, "inferred", inferred)
        self._is_built = True
        self._grown += len(events)

    def _anew(self, worker: Worker, reading: AbstractContextManager[State]) -> Iterator[None]:
        self._is_built = False
        past: list[Event] = []
        while self._store is not None and (
            some := self._store.events(past[-1].number if past else 0, _SLICE, measurements=False)
        ):
            past += some
            yield
        self._chronicle = chronicle = _Chronicle(self._known)
        with reading as state:
            past += self._known.log.since(past[-1].number if past else 0, measurements=False)
            measured = [
                (node.name, sample)
                for node in state.network.attributes.values()
                if node.index in state.histories
                for sample in state.histories[node.index].samples(self._keep)
            ]
            chronicle.begin(past)
            model, records, inferred = self._model(), chronicle.of_records(), self._inferred(state)
            present = list(chronicle.of_state(state))
            self._seen(state)
        own = next(model)
        begins = [Individual("", own.id, {"historyBegins": (float(past[0].time),)})] if past else []
        worker.tell("open", f"{BASE}{own.id}")
        worker.tell("describe", metamodel())
        yield from self._replace(worker, "model", chain([own], model))
        yield from worker.write("told", (chronicle.measurement(name, value, time) for name, (time, value) in measured))
        yield from worker.write("told", chain(begins, chronicle.of_events(past), records))
        yield from worker.write("told", chronicle.older(present))
        yield from self._replace(worker, "inferred", inferred)
        self._is_built, self._grown = True, 0

    def _replace(self, worker: Worker, context: str, given: Iterable[Individual]) -> Iterator[None]:
        """Replace the model, or what is inferred; what a model states to be so is told, and is no part of it."""
        worker.tell("clear", context)
        yield from worker.write(context, (one for one in given if not one.id.startswith(f"{STATED}.")))

    def _seen(self, state: State) -> None:
        self._last, self._revision = self._known.log.last, state.network.revision

    def _model(self) -> Iterator[Individual]:
        """Describe the model as it is now, whatever becomes of it before that is read."""
        model = self._known.model
        parts: Any = {word: dict(getattr(model, word)) for word in TABLES}
        now: Any = SimpleNamespace(
            name=model.name, constraints=model.constraints, estimations=model.estimations, facts=model.facts, **parts
        )
        return individuals(now, self._known.serials)

    def _inferred(self, state: State) -> Iterator[Individual]:
        nodes = [node for node in state.network.present() if node.kind != "attribute"]
        now = [(node.kind, node.element, state.status[node.index], state.required[node.index]) for node in nodes]
        return (self._status(*one) for one in now)

    def _status(self, kind: str, element: Changeable, status: Status, is_required: bool) -> Individual:
        values: Values = {"status": (str(status),)}
        if kind in _REQUIRABLE:
            values["isRequired"] = (is_required,)
        return Individual("", element_id(element, self._known.serials), values)


class _Chronicle:
    """Makes individuals of events and records, each once; what has ended later is given its end."""

    def __init__(self, known: Knowledge) -> None:
        self._known = known
        self._count = 0
        self._open: dict[tuple[str, str], str] = {}
        self._asserted_failed: set[str] = set()
        self._serial = 0
        self._configuring: dict[int, tuple[str, Parameters]] = {}
        self._ids: dict[int, str] = {}
        self._records: dict[tuple[str, int], Record] = {}
        self._unended: dict[tuple[str, int], Record] = {}

    def measurement(self, attribute: str, value: float, time: float) -> Individual:
        values: Values = {"measures": (Ref(named_id(Attribute, attribute)),)}
        return Individual("Measurement", self._next(), {**values, "value": (float(value),), "time": (float(time),)})

    def begin(self, past: Iterable[Event]) -> None:
        """Expect some events: the attempts among them are the last that there were."""
        last = next(reversed(self._known.records.attempts), 0)
        self._serial = last - sum(event.verb == "record_attempt" for event in past)

    def of_state(self, state: State) -> Iterator[tuple[str, str, Values, Parameters]]:
        """Yield what is so now: its kind, what it is about, and what else is known of it."""
        for node in state.network.present():
            for word, column in _PRESENT.items():
                if value := state.columns[column][node.index]:
                    reason = state.reason(column, node)
                    values = _said(reason.text)
                    if column == "asserted":
                        values |= {"status": (str(value),)} | (
                            {} if reason.until is None else {"until": (reason.until,)}
                        )
                    yield word, element_id(node.element, self._known.serials), values, {}
        for name, parameters in state.parameters.items():
            yield "ParametersInForce", named_id(Component, name), {}, parameters

    def older(self, present: Iterable[tuple[str, str, Values, Parameters]]) -> Iterator[Individual]:
        """Yield what is so now and began before the events that are known: it has no start."""
        for word, about, values, parameters in present:
            if (word, about) not in self._open:
                self._open[word, about] = own = self._next()
                within = list(nested(PARAMETER, own, parameters))
                yield from within
                listed: Values = {"hasParameter": tuple(Ref(one.id) for one in within)} if within else {}
                yield Individual(word, own, {"about": (Ref(about),), **values, **listed})

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
        elif verb == "record_attempt":
            self._serial += 1
            _, component, operation, _, parameters, _ = arguments
            if operation == "configure":
                self._configuring[self._serial] = component, parameters
        elif verb == "finish_attempt":
            given = self._configuring.pop(arguments[0], None)
            if given is not None and arguments[1] == "completed":
                yield from self._configured(time, *given)
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
        tables: tuple[tuple[str, Mapping[int, Any], Iterable[Any]], ...] = (
            ("RequiredAction", records.requests, records.required.values()),
            ("ReconfigurationPlan", records.plans, records.open_plans.values()),
            ("ComponentProcess", records.processes, ()),
            ("Attempt", records.attempts, ()),
            ("VetoAnswer", records.answers, ()),
        )
        for word, table, still in tables:
            for number, record in {**table, **{one.number: one for one in still}}.items():
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
