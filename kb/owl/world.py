"""Answers SPARQL queries: describes the state and the log of a knowledge base as individuals in a process of its own.

The description is made from copies, so a query does not delay `measure` and the like, and the process is kept until an
event is told. Something that holds for a time, such as a failure, is one individual with a start, and with an end once
it is over.
"""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import fields
from itertools import chain, count, islice
from pathlib import Path
from typing import Any, Final
from weakref import finalize

from kb.elements import KINDS, Attribute, Changeable
from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError, UnknownName
from kb.facts import ActiveFact, Fact, RequiredFact, SelectedFact, StatusFact
from kb.knowledge import Knowledge
from kb.owl import (
    BASE,
    CLASSES,
    STATED,
    Individual,
    Ref,
    Values,
    described,
    element_id,
    individuals,
    named_id,
)
from kb.records import Records
from kb.state import State
from kb.store import Store

Answer = str | bool | int | float | None

_CLASSES: Final[Mapping[str, type]] = {kind: cls for cls, kind in KINDS.items()}
_PRESENT: Final[Mapping[str, str]] = {
    "Failure": "failed",
    "Activity": "active",
    "Selection": "selected",
    "AssertedStatus": "asserted",
    "AssertedRequirement": "asserted_required",
}
"""The kinds of individuals that hold now, and the column of the state that says so."""
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
"""By verb of an event: the kind that begins or ends for its first argument, and the names of the other arguments."""
Period = tuple[str, str, Mapping[str, Any]]
"""Something that holds for a time: its kind, the id of what it is about, and its other values."""
_RECORDS: Final[Mapping[str, str]] = {
    "plans": "ReconfigurationPlan",
    "requests": "RequiredAction",
    "processes": "ComponentProcess",
    "attempts": "Attempt",
    "answers": "VetoAnswer",
}
"""The kind of individual for each table of the records; plans first, because others refer to them."""
_UNSAID: Final = frozenset({"plan", "plain", "cause", "serial"})
"""The fields of records that are not described."""
_LONGEST: Final = 1_000_000  # query [characters]
_LONGEST_WAIT: Final = 1_000_000.0  # for an answer [s]; the system takes no longer time-outs
_SLICE: Final = (
    1000  # number of events that are read from the store, and of individuals that are sent, at once
)
_REQUIRABLE: Final = frozenset({"action", "function", "component"})
_ERRORS: Final = {cls.__name__: cls for cls in (InvalidValue, UnknownName, KnowledgeBaseError)}
_ENDED: Final = "the process that answers the query has ended; if it needed more than 4 GB of memory, ask for less"


class World:
    """All that a knowledge base knows, with the newest `keep` measurements, to be asked in SPARQL."""

    def __init__(
        self,
        known: Knowledge,
        store: Store | None,
        keep: int,
        reading: Callable[[], AbstractContextManager[State]],
    ) -> None:
        self._known, self._store, self._keep, self._reading = known, store, keep, reading
        self._begun = known.model.facts  # facts that the model states later are not of this base
        self._kept: dict[
            int, _Process
        ] = {}  # by the last event it knows; while it answers it is taken out
        self._is_closed = False
        finalize(self, _end, self._kept)

    def ask(self, sparql: str, timeout: float) -> list[tuple[Answer, ...]]:
        """Answer a query; see `KnowledgeBase.query`."""
        if not isinstance(sparql, str) or len(sparql) > _LONGEST:
            what = f"{len(sparql)} characters" if isinstance(sparql, str) else repr(sparql)
            raise InvalidValue(
                f"a query is a text in SPARQL, not {what}; it has at most {_LONGEST} characters"
            )
        process, deadline = None, time.monotonic() + min(timeout, _LONGEST_WAIT)
        reading = self._reading()  # it reads the clock, which may raise any error, too
        try:
            process = self._taken(reading)
            process.deadline = deadline
            if process.last < 0:
                process.tell(self._individuals(process, reading))
            *parts, end = process.answers(sparql)
        except BaseException as error:
            if process is not None:
                process.end()
            if isinstance(error, TimeoutError):
                much = "ask for less, or allow it a longer timeout"
                raise KnowledgeBaseError(
                    f"the query was stopped after {timeout:g} s; {much}"
                ) from None
            if isinstance(error, ConnectionError | EOFError):
                raise KnowledgeBaseError(_ENDED) from None
            raise
        if self._kept.setdefault(process.last, process) is not process:
            process.end()
        if self._is_closed:  # looked at last: another thread may close it meanwhile
            _end(self._kept)
        if end is not None:
            raise _ERRORS[end["error"]](*end["given"])
        return [tuple(row) for rows in parts for row in rows]

    def close(self) -> None:
        """Keep no process any more; who asks later waits for a new one each time."""
        self._is_closed = True
        _end(self._kept)

    def _taken(self, reading: AbstractContextManager[State]) -> "_Process":
        """Take the process that is kept, if no event was told since, else a new one; end all others."""
        with reading:
            process = self._kept.pop(self._known.log.last, None)
        _end(self._kept)
        if process is not None and not process.is_usable:
            process.end()
            process = None
        return process or _Process()

    def _individuals(
        self, process: "_Process", reading: AbstractContextManager[State]
    ) -> Iterator[Individual]:
        """Yield the model, the inferred statuses, and what was told; older events come from the store."""
        known, chronicle = self._known, _Chronicle(self._known, self._begun)
        held = list(known.log.since(0, measurements=False))
        with reading as state:  # only what is new is read while those who tell wait
            process.last = known.log.last
            held += known.log.since(held[-1].number if held else 0, measurements=False)
            histories = [
                (node.name, state.histories.get(node.index))
                for node in state.network.attributes.values()
            ]
            measured = [
                (name, history.samples(self._keep))
                for name, history in histories
                if history is not None
            ]
            model = individuals(known.model, known.serials)
            inferred, present, records = (
                _inferred(state, known),
                chronicle.of_state(state),
                _recorded(known.records),
            )
        past = [*self._older(held[0].number if held else process.last + 1, process), *held]
        yield (own := next(model))
        yield from (
            one for one in model if not one.id.startswith(f"{STATED}.")
        )  # its facts come from the log
        yield from (
            Individual("", element_id(element, known.serials), said) for element, said in inferred
        )
        if past:
            yield Individual("", own.id, {"historyBegins": (float(past[0].time),)})
        for name, samples in measured:
            yield from (chronicle.measurement(name, *sample) for sample in samples)
        yield from chain.from_iterable(map(chronicle.of_event, past))
        yield from chronicle.of_records(records)
        yield from chronicle.older(present)

    def _older(self, number: int, process: "_Process") -> Iterator[Event]:
        """Yield the events before one that only the store has."""
        after = 0 if self._known.log.begins > 1 else number
        while self._store is not None and after < number:
            process.limit()
            some = self._store.events(after, _SLICE, measurements=False)
            yield from (event for event in some if event.number < number)
            after = some[-1].number if some else number


def _end(kept: "dict[int, _Process]") -> None:
    for last in list(kept):
        if (process := kept.pop(last, None)) is not None:  # else another thread has it
            process.end()


class _Process:
    """A process that is told individuals, once, and then answers queries, one after the other; see `queries`.

    It ends when nobody can ask it any more: when its socket is closed, or the program that started it is no more.

    Attributes:
        last: number of the last event it knows; -1 before it is told anything.
        deadline: when what is under way has to be done [s, monotonic].
    """

    def __init__(self) -> None:
        self.last, self.deadline, self._owner = -1, 0.0, os.getpid()
        self._socket, theirs = socket.socketpair()
        self._lines = self._socket.makefile("rb")
        with theirs:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-PS",
                    str(Path(__file__).with_name("queries.py")),
                    str(self._owner),
                ],
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                stderr=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                start_new_session=True,
            )

    @property
    def is_usable(self) -> bool:
        """Whether it is alive and this program, not one that this was forked from, has started it."""
        return self._owner == os.getpid() and self._process.poll() is None

    def tell(self, given: Iterator[Individual]) -> None:
        """Tell it individuals as N-Triples; the first is the model, whose id is in all names."""
        from kb.owl.files import triples  # slow to import

        own = next(given)
        every = chain([own], given)
        while some := list(islice(every, _SLICE)):
            self._send("".join(triples(one, f"{BASE}{own.id}", _whole) for one in some))
        self._send("\n")

    def answers(self, sparql: str) -> list[Any]:
        """Return lists of rows, and last None or the error."""
        self._send(f"{json.dumps(sparql)}\n")
        found: list[Any] = []
        while not found or isinstance(found[-1], list):
            self.limit()
            if not (line := self._lines.readline()).endswith(b"\n"):
                raise EOFError
            found.append(json.loads(line))
        return found

    def limit(self) -> None:
        """Raise TimeoutError after the deadline, and let the socket wait no longer than until then."""
        if (left := self.deadline - time.monotonic()) <= 0.0:
            raise TimeoutError
        self._socket.settimeout(left)

    def _send(self, text: str) -> None:
        self.limit()
        self._socket.sendall(text.encode())

    def end(self) -> None:
        """End it at once; in a program that was forked, only forget it."""
        self._lines.close()
        self._socket.close()
        self._process.kill()  # only a child of this very program
        self._process.wait()


def _whole(text: str) -> str:
    """Escape lone surrogates, which UTF-8 cannot write."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def _inferred(state: State, known: Knowledge) -> list[tuple[Changeable, Values]]:
    found = list[tuple[Changeable, Values]]()
    for node in (node for node in state.network.present() if node.kind != "attribute"):
        required: Values = (
            {"isRequired": (state.required[node.index],)} if node.kind in _REQUIRABLE else {}
        )
        found.append((node.element, {"status": (str(state.status[node.index]),), **required}))
    return found


def _recorded(records: Records) -> dict[str, list[tuple[int, Any]]]:
    """Return the records by table; those that have not ended are copied."""
    return {
        name: [
            (number, one if getattr(one, "end", 0.0) is not None else copy(one))
            for number, one in table.items()
        ]
        for name, table in ((name, getattr(records, name)) for name in _RECORDS)
    }


class _Chronicle:
    """Makes individuals of events and records; an event that ends something adds the end to its individual."""

    def __init__(self, known: Knowledge, begun: Sequence[Fact]) -> None:
        self._known, self._begun = known, begun
        self._count = count(1)
        self._open: dict[tuple[str, str], str] = {}
        self._asserted_failed: set[str] = set()

    def measurement(self, attribute: str, time: float, value: float) -> Individual:
        values: Values = {"measures": (Ref(named_id(Attribute, attribute)),)}
        return Individual(
            "Measurement",
            self._next(),
            {**values, "value": (float(value),), "time": (float(time),)},
        )

    def of_state(self, state: State) -> list[Period]:
        """Return what holds now."""
        found: list[Period] = []
        for node in state.network.present():
            for word, column in _PRESENT.items():
                if value := state.columns[column][node.index]:
                    said = state.reason(column, node)
                    status = (
                        {"status": str(value), "until": said.until} if column == "asserted" else {}
                    )
                    found.append((word, self._id(node.element), {**status, "reason": said.text}))
        given = state.parameters.items()
        return [
            *found,
            *(
                ("ParametersInForce", self._about(name), {"parameters": values})
                for name, values in given
            ),
        ]

    def older(self, present: Iterable[Period]) -> Iterator[Individual]:
        """Yield what holds now but began before the oldest known event; it has no start."""
        for word, about, values in present:
            if (word, about) not in self._open:
                yield from self._began(word, about, None, **values)

    # ---------------------------------------------------------------- what holds for a time

    def of_event(self, event: Event) -> Iterator[Individual]:
        time = event.time
        match event.verb, event.arguments:
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
                yield from self._selected(
                    event, {"function design": designs, "configuration": configurations}, reason
                )
            case "amend", (how, written):
                yield from self._amended(time, how, written)
            case "begin", _:
                for fact in self._begun:
                    if isinstance(fact, ActiveFact | StatusFact | RequiredFact | SelectedFact):
                        element = fact.component if isinstance(fact, ActiveFact) else fact.element
                        about = (
                            self._about(element) if isinstance(element, str) else self._id(element)
                        )
                        yield from self._began(
                            CLASSES[type(fact)], about, time, status=getattr(fact, "status", None)
                        )
            case verb, (ref, *said) if verb in _STATED:
                word, names = _STATED[verb]
                values = dict(zip(names, said, strict=False))
                is_so = bool(
                    values.pop("is_so", names)
                )  # verbs without further arguments only end something
                yield from self._is_so(word, self._about(ref), time, is_so, **values)

    def _selected(
        self, event: Event, chosen: Mapping[str, Mapping[str, str]], reason: str
    ) -> Iterator[Individual]:
        changed = {self._about((kind, name)): is_so for kind, name, is_so in event.effects}
        kept = (
            self._about((kind, name))
            for kind, by_whole in chosen.items()
            for name in by_whole.values()
        )
        changed |= {
            about: True
            for about in kept
            if about not in changed and ("Selection", about) in self._open
        }
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

    def _began(
        self, word: str, about: str, time: float | None, **said: object
    ) -> Iterator[Individual]:
        self._open[word, about] = own = self._next()
        if word == "AssertedStatus":
            (
                self._asserted_failed.add
                if said["status"] == "failure"
                else self._asserted_failed.discard
            )(about)
        return described(
            word, own, {"about": Ref(about), "start": time, **said}, self._known.serials
        )

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
        except UnknownName:  # it was removed, and its number with it
            return f"Constraint.{kind}.{name}.{position[0]}"

    def _id(self, element: Changeable) -> str:
        return element_id(element, self._known.serials)

    def of_records(self, tables: Mapping[str, Iterable[tuple[int, Any]]]) -> Iterator[Individual]:
        plans: dict[int, str] = {}
        for name, word in _RECORDS.items():
            for number, record in tables[name]:
                own = self._next()
                said = {
                    one.name: getattr(record, one.name)
                    for one in fields(record)
                    if one.name not in _UNSAID
                }
                if name != "attempts":
                    said.pop("number", None)  # of an event, which means nothing here
                if name == "plans":
                    plans[number] = own
                elif name in ("attempts", "answers") and record.plan.number in plans:
                    said["of_plan"] = Ref(plans[record.plan.number])
                yield from described(word, own, said, self._known.serials, type(record))

    def _next(self) -> str:
        return f"{STATED}.{next(self._count)}"
