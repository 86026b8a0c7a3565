"""A world made from the state and the log of a knowledge base, so that all of it can be asked in SPARQL.

It is built from copies, beside the base: nobody who tells waits for who asks. What is so for a time is one individual
from its start on, and gets its end once it is over.
"""

import json
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from itertools import chain, count
from threading import Lock
from typing import Any, Final
from weakref import finalize

from kb.elements import KINDS, Attribute, Changeable
from kb.events import Event
from kb.exceptions import InvalidValue, UnknownName
from kb.facts import ActiveFact, RequiredFact, SelectedFact, StatusFact
from kb.knowledge import Knowledge
from kb.network import Node
from kb.owl.individuals import (
    BASE,
    CLASSES,
    STATED,
    Individual,
    Ref,
    Values,
    described,
    element_id,
    individuals,
    metamodel,
    named_id,
)
from kb.owl.worker import Answer, Worker, give_back, stopped, take
from kb.state import State
from kb.store import Store

_CLASSES: Final[Mapping[str, type]] = {kind: cls for cls, kind in KINDS.items()}
_PRESENT: Final[Mapping[str, str]] = {
    "Failure": "failed",
    "Activity": "active",
    "Selection": "selected",
    "AssertedStatus": "asserted",
    "AssertedRequirement": "asserted_required",
}
"""What can be so now, by the facts of the state that say so."""
_STATED: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "component_failed": ("Failure", ("reason",)),
    "component_active": ("Activity", ("is_so",)),
    "component_configured": ("ParametersInForce", ("parameters",)),
    "assert_status": ("AssertedStatus", ("status", "reason", "until")),
    "retract_status": ("AssertedStatus", ()),
    "lapse": ("AssertedStatus", ()),
    "assert_required": ("AssertedRequirement", ("is_so",)),
    "assert_selected": ("Selection", ("is_so", "reason")),
}
"""What is so, or no longer, by the verb that says it of its first argument, and what its others are."""
Period = tuple[str, str, Mapping[str, Any]]
"""What is so for a time: its kind, what it is about, and what else is known of it."""
_ENDS: Final = ("end", "result", "reason")
_RECORDS: Final[Mapping[str, tuple[str, ...]]] = {
    "RequiredAction": ("start", "action", "preference"),
    "ReconfigurationPlan": ("start", "activate", "deactivate", "parameters", "reason"),
    "ComponentProcess": ("start", "component", "pid"),
    "Attempt": ("start", "component", "operation", "number", "configuration", "parameters"),
    "VetoAnswer": ("is_vetoed", "time", "reason"),
}
"""The fields of each kind of record that are told when it begins, beside its plan."""
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
        """Hand over what is new, or all if it has grown too much, or more happened than memory holds."""
        worker, known = self._workers[0], self._known
        is_anew = not self._is_built or self._grown > 2 * self._keep + _MOST_GROWN
        past: list[Event] = []
        store = self._store if is_anew else None
        while store is not None and (some := store.events(past[-1].number if past else 0, _SLICE, measurements=False)):
            past += some
            yield
        chronicle = self._chronicle = _Chronicle(known) if is_anew else self._chronicle
        with reading as state:
            last = (past[-1].number if past else 0) if is_anew else self._last
            past += known.log.since(last, measurements=not is_anew)
            is_amended = is_anew or state.network.revision != self._revision or any(one.verb == "amend" for one in past)
            if known.log.last == last and not is_amended:
                return
            is_lost = not is_anew and len(past) < known.log.last - last
            nodes = state.network.attributes.values() if is_anew else ()
            histories = [(node.name, state.histories[node.index]) for node in nodes if node.index in state.histories]
            measured = [(name, *sample) for name, history in histories for sample in history.samples(self._keep)]
            model = individuals(known.model, known.serials) if is_amended else None
            if not is_lost:
                records, inferred = chronicle.of_records(), self._inferred(state)
                present = chronicle.of_state(state) if is_anew else []
                self._last, self._revision = known.log.last, state.network.revision
        self._is_built = False  # until all of it is there
        if is_lost:
            yield from self._more(reading)
            return
        begins: list[Individual] = []
        if is_anew and model is not None:
            own = next(model)
            worker.tell("open", f"{BASE}{own.id}")
            worker.tell("describe", metamodel())
            model = chain([own], model)
            begins = [Individual("", own.id, {"historyBegins": (float(past[0].time),)})] if past else []
        if model is not None:
            yield from self._replace(worker, "model", model)
        older = (chronicle.measurement(name, value, time) for name, time, value in measured)
        news = chain.from_iterable(map(chronicle.of_event, past))
        yield from worker.write("told", chain(older, begins, news, records, chronicle.older(present)))
        yield from self._replace(worker, "inferred", inferred)
        self._is_built, self._grown = True, 0 if is_anew else self._grown + len(past)

    def _replace(self, worker: Worker, context: str, given: Iterable[Individual]) -> Iterator[None]:
        """Replace the model, or what is inferred; what a model states to be so is told, and is no part of it."""
        worker.tell("clear", context)
        yield from worker.write(context, (one for one in given if not one.id.startswith(f"{STATED}.")))

    def _inferred(self, state: State) -> Iterator[Individual]:
        now = list[tuple[Node, Values]]()
        for node in (node for node in state.network.present() if node.kind != "attribute"):
            required: Values = {"isRequired": (state.required[node.index],)} if node.kind in _REQUIRABLE else {}
            now.append((node, {"status": (str(state.status[node.index]),), **required}))
        return (Individual("", element_id(node.element, self._known.serials), said) for node, said in now)


class _Chronicle:
    """Makes individuals of events and records, each once; what has ended later is given its end."""

    def __init__(self, known: Knowledge) -> None:
        self._known = known
        self._count = count(1)
        self._open: dict[tuple[str, str], str] = {}
        self._asserted_failed: set[str] = set()
        self._ids: dict[tuple[str, int], str] = {}
        self._is_over: dict[tuple[str, int], bool] = {}

    def measurement(self, attribute: str, value: float, time: float) -> Individual:
        values: Values = {"measures": (Ref(named_id(Attribute, attribute)),)}
        return Individual("Measurement", self._next(), {**values, "value": (float(value),), "time": (float(time),)})

    def of_state(self, state: State) -> list[Period]:
        """Return what is so now."""
        found: list[Period] = []
        for node in state.network.present():
            for word, column in _PRESENT.items():
                if value := state.columns[column][node.index]:
                    said = state.reason(column, node)
                    status = {"status": str(value), "until": said.until} if column == "asserted" else {}
                    found.append((word, self._id(node.element), {**status, "reason": said.text}))
        given = state.parameters.items()
        return [*found, *(("ParametersInForce", self._about(name), {"parameters": values}) for name, values in given)]

    def older(self, present: Iterable[Period]) -> Iterator[Individual]:
        """Yield what is so now and began before the events that are known: it has no start."""
        for word, about, values in present:
            if (word, about) not in self._open:
                yield from self._began(word, about, None, **values)

    # ---------------------------------------------------------------- what was so for a time

    def of_event(self, event: Event) -> Iterator[Individual]:
        time = event.time
        match event.verb, event.arguments:
            case "measure", (name, value):
                yield self.measurement(name, value, time)
            case "component_recovered", (name,):
                about = self._about(name)
                yield from self._ended("Failure", about, time)
                if about in self._asserted_failed:
                    yield from self._ended("AssertedStatus", about, time)
            case "finish_attempt", (serial, "completed", _):
                attempt = self._known.records.attempts.get(serial)
                if attempt is not None and attempt.operation == "configure":
                    given, about = attempt.parameters, self._about(attempt.component)
                    yield from self._is_so("ParametersInForce", about, time, True, parameters=given)
            case "select", (designs, configurations, reason):
                yield from self._selected(event, {"function design": designs, "configuration": configurations}, reason)
            case "amend", (how, written):
                yield from self._amended(time, how, written)
            case "begin", _:
                for fact in self._known.model.facts:
                    if isinstance(fact, ActiveFact | StatusFact | RequiredFact | SelectedFact):
                        element = fact.component if isinstance(fact, ActiveFact) else fact.element
                        about = self._about(element) if isinstance(element, str) else self._id(element)
                        yield from self._began(CLASSES[type(fact)], about, time, status=getattr(fact, "status", None))
            case verb, (ref, *said) if verb in _STATED:
                word, names = _STATED[verb]
                values = dict(zip(names, said, strict=False))
                is_so = bool(values.pop("is_so", names))  # of what is only over nothing more is said
                yield from self._is_so(word, self._about(ref), time, is_so, **values)

    def _selected(self, event: Event, chosen: Mapping[str, Mapping[str, str]], reason: str) -> Iterator[Individual]:
        changed = {self._about((kind, name)): is_so for kind, name, is_so in event.effects}
        kept = (self._about((kind, name)) for kind, by_whole in chosen.items() for name in by_whole.values())
        changed |= {about: True for about in kept if about not in changed and ("Selection", about) in self._open}
        for about, is_so in changed.items():
            yield from self._is_so("Selection", about, event.time, is_so, reason)

    def _amended(self, time: float, how: str, written: object) -> Iterator[Individual]:
        change = json.dumps({how: written})
        yield Individual("Amendment", self._next(), {"time": (float(time),), "change": (change,)})
        if how == "removed":
            for word, about in [key for key in self._open if key[1] == written]:
                yield from self._ended(word, about, time)

    def _is_so(
        self, word: str, about: str, time: float, is_so: bool, reason: str = "", **said: object
    ) -> Iterator[Individual]:
        yield from self._ended(word, about, time)
        if is_so:
            yield from self._began(word, about, time, reason=reason, **said)

    def _began(self, word: str, about: str, time: float | None, **said: object) -> Iterator[Individual]:
        self._open[word, about] = own = self._next()
        if word == "AssertedStatus":
            (self._asserted_failed.add if said["status"] == "failure" else self._asserted_failed.discard)(about)
        return described(word, own, {"about": Ref(about), "start": time, **said}, self._known.serials)

    def _ended(self, word: str, about: str, time: float) -> Iterator[Individual]:
        own = self._open.pop((word, about), None)
        if own is not None:
            yield Individual("", own, {"end": (float(time),)})

    def _about(self, ref: Any) -> str:  # noqa: ANN401  # a reference of an event, or the name of a component
        kind, name, *position = ("component", ref) if isinstance(ref, str) else ref
        if not position:
            return named_id(_CLASSES[kind], name)
        try:
            return self._id(self._known.network.referred(ref).element)
        except UnknownName:  # it went, and took its number with it
            return f"Constraint.{kind}.{name}.{position[0]}"

    def _id(self, element: Changeable) -> str:
        return element_id(element, self._known.serials)

    # ---------------------------------------------------------------- records

    def of_records(self) -> list[Individual]:
        """Return the records that are new, or have ended since they were told; these say again what they said."""
        records, found = self._known.records, list[Individual]()
        tables: Any = records.requests, records.plans, records.processes, records.attempts, records.answers
        plans = {id(plan): number for number, plan in records.plans.items()}
        for word, table in zip(_RECORDS, tables, strict=True):
            for number, record in table.items():
                is_over = getattr(record, "end", 0.0) is not None
                if self._is_over.get((word, number)) is not is_over:
                    self._is_over[word, number] = is_over
                    own = self._ids[word, number] = self._ids.get((word, number)) or self._next()
                    said = {name: getattr(record, name, None) for name in (*_RECORDS[word], *_ENDS)}
                    if (plan := plans.get(id(getattr(record, "plan", None)))) is not None:
                        said["of_plan"] = Ref(self._ids["ReconfigurationPlan", plan])
                    found += described(word, own, said, self._known.serials, type(record))
        return found

    def _next(self) -> str:
        return f"{STATED}.{next(self._count)}"
