"""A trace: the ticks of a tree together with the events of the knowledge base, in JSON lines.

It can be replayed.

The first line names the version and the model. Each other line is a tick, without what is as in the
tick before. It is written when its tick is over, so a program that is killed loses only the tick
that was under way.
"""

import json
import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import get_ident
from types import SimpleNamespace
from typing import Any, NamedTuple, Self, TextIO

from py_trees.behaviour import Behaviour
from py_trees.visitors import VisitorBase

from kb import Event, KnowledgeBase, Model
from rosa_bt.behaviours import KbBehaviour
from rosa_bt.exceptions import TraceError, errors_of, in_words, path_of
from rosa_bt.runner import TreeRunner

_VERSION = 4
_CAUSED_BY_TIME = ("stale", "dwell", "lapse")


class Node(NamedTuple):
    """A behaviour in a tree: depth (0 for the root), name of the class, own name (not unique)."""

    depth: int
    kind: str
    name: str


class Visit(NamedTuple):
    """A behaviour that was ticked: its place in `Tick.tree`, and its status, e.g.

    "RUNNING", and feedback.
    """

    node: int
    status: str
    feedback: str


class Told(NamedTuple):
    """An event since the tick before, and who told it when."""

    event: Event
    place: int | None
    """None if the tree told it. Else it came before the behaviour at this place in `visited`; -1:
    before the tick."""


class Tick(NamedTuple):
    """One tick: its number, from 0, its time [s], what was ticked, and what became known.

    A tick that an exception or Ctrl-C cut short is there as far as it got.
    """

    number: int
    time: float
    tree: tuple[Node, ...]
    """The behaviours of the tree, parents before children."""
    visited: tuple[Visit, ...]
    """The behaviours that were ticked, in order: children before parents."""
    events: tuple[Told, ...] = ()
    """The events since the tick before, in order; a replay tells again those that the tree did not
    tell."""
    errors: tuple[tuple[str, str], ...] = ()
    """The behaviours that raised in the tick, by name, and the text of the exception."""


_NO_TICK = Tick(-1, -math.inf, (), ())
_READERS: Mapping[str, Callable[[Any], object]] = {
    "tree": lambda node: Node(*node),
    "visited": lambda visit: Visit(*visit),
    "events": lambda told: Told(Event.from_json(told[0]), told[1]),
    "errors": tuple,
}
"""How one entry of a field of a tick is read."""


@dataclass(frozen=True, slots=True)
class Trace:
    """The ticks of a tree, and the name of the model.

    A trace from memory may lack the first ticks.
    """

    model: str
    ticks: tuple[Tick, ...]


class TraceVisitor(VisitorBase):
    """Records every tick: the events before it, and what was ticked with which status.

    Add it to the visitors of a tree before the first tick; the trace begins with the first event
    that the log of the knowledge base still holds. The same run gives the same trace, to the byte.
    The last ticks are kept in memory; a file keeps all.

    Args:
        kb: the knowledge base that the tree uses.
        path: a file to write all ticks to; an existing file is overwritten.
        keep: how many of the last ticks to keep in memory, at least 1.
    """

    def __init__(
        self, kb: KnowledgeBase, path: str | Path | None = None, *, keep: int = 10_000
    ) -> None:
        super().__init__(full=False)
        self._kb = kb
        self._file: TextIO | None = None
        if path is not None:
            self._file = Path(path).open("w", buffering=1)  # noqa: SIM115  # closed by __exit__
        self._write({"rosa_bt_trace": _VERSION, "model": kb.model.name})
        self._ticks: deque[Tick] = deque(maxlen=keep)
        self._written = 0  # number of the last event that is written
        self._thread: int | None = None
        kb.log.witnesses += (self._witness,)

    @property
    def trace(self) -> Trace:
        """The ticks that are kept in memory."""
        return Trace(self._kb.model.name, tuple(self._ticks))

    def initialise(self) -> None:
        """Begin a tick: what this thread tells the knowledge base until its end is the tree's."""
        self._begun = self._kb.log.last
        self._seen: list[tuple[Behaviour, str, str]] = []
        self._known: list[int] = []  # for each of them, the last event that it knew of
        self._own: set[int] = set()  # numbers of the events that the tree told
        self._thread = get_ident()

    def run(self, behaviour: Behaviour) -> None:
        self._seen.append((behaviour, behaviour.status.name, behaviour.feedback_message))
        known = self._kb.log.last
        if isinstance(behaviour, KbBehaviour) and behaviour.last_event is not None:
            known = behaviour.last_event
        self._known.append(known)

    def finalise(self) -> None:
        if self._thread is None or not self._seen:
            return
        self._thread = None
        root = path_of(self._seen[-1][0])[-1]
        seen = [
            node for node, *_ in self._seen
        ]  # a step of a plan may have left the tree meanwhile
        nodes = list(dict.fromkeys([*_parents_first(root), *seen]))
        numbers = {node: number for number, node in enumerate(nodes)}
        last = max([self._begun, *self._known, *self._own])  # later events are of the next tick
        with self._kb.reading():
            events = self._kb.log.since(self._written)
            time = float(self._kb.now)
        self._written = max(last, self._written)
        before = self._ticks[-1] if self._ticks else _NO_TICK
        tick = Tick(
            before.number + 1,
            time,
            tuple(Node(len(path_of(node)) - 1, type(node).__name__, node.name) for node in nodes),
            tuple(Visit(numbers[node], status, text) for node, status, text in self._seen),
            tuple(  # without what is not in a file
                Told(Event(*event[:7]), self._place(event.number))
                for event in events
                if event.number <= last
            ),
            tuple((node.name, in_words(error)) for node, error in errors_of(root)),
        )
        earlier = before._asdict()
        changes = {name: new for name, new in tick._asdict().items() if new != earlier[name]}
        self._ticks.append(before._replace(**changes))  # what is the same is there once
        if "events" in changes:
            changes["events"] = [(event.to_json(), place) for event, place in tick.events]
        self._write(changes)

    def _write(self, line: dict[str, Any]) -> None:
        if self._file is not None:
            self._file.write(json.dumps(line, separators=(",", ":")) + "\n")

    def _place(self, number: int) -> int | None:
        if number <= self._begun:
            return -1
        if number in self._own:
            return None
        return bisect_left(self._known, number)

    def _witness(self, event: Event) -> None:
        """Note whether the tree told the event.

        What time causes while a tick is under way is not told by the tree: it is replayed in its
        place.
        """
        if self._thread == get_ident() and event.verb not in _CAUSED_BY_TIME:
            self._own.add(event.number)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Stop recording, and close the file."""
        log = self._kb.log
        log.witnesses = tuple(other for other in log.witnesses if other != self._witness)
        if self._file is not None:
            self._file.close()


def _parents_first(root: Behaviour) -> Iterator[Behaviour]:
    yield root
    for child in root.children:
        yield from _parents_first(child)


def read_trace(path: str | Path) -> Trace:
    """Read a trace from a file.

    Raises:
        OSError: the file cannot be read.
        TraceError: it is not a trace; the message names the line.
    """
    content = Path(path).read_bytes()
    whole = content.rpartition(b"\n")[0]  # a program that is killed cuts the last line
    ticks = [_NO_TICK]
    model = ""
    for number, text in enumerate(whole.splitlines() or [b""], start=1):
        try:
            line = json.loads(text)
            if number == 1:
                model = str(line["model"])
                version = line["rosa_bt_trace"]
                if version != _VERSION:
                    raise ValueError(f"version {version}; this program reads version {_VERSION}")
                continue
            for name, read in _READERS.items():
                if name in line:
                    line[name] = tuple(map(read, line[name]))
            ticks.append(ticks[-1]._replace(**line))
        except Exception as error:  # a wrong line may raise anything
            problem = f"not a line of a trace ({type(error).__name__}: {error})"
            raise TraceError(f"{path}:{number}: {problem}") from None
    return Trace(model, tuple(ticks[1:]))


def replay_trace(trace: Trace, model: Model, build: Callable[[KnowledgeBase], Behaviour]) -> Trace:
    """Tell a new knowledge base the events of a trace, tick a new tree, and return its trace.

    The two traces are equal if model and tree are the same, every leaf decides by the knowledge
    base alone, and no tick was cut short.

    Args:
        trace: a trace from the first tick on, of a knowledge base whose log was complete.
        model: the model of the robot.
        build: makes the tree, with the knowledge base of the replay.

    Raises:
        TraceError: the first ticks or events are missing, or an event cannot be told again.
        kb.KnowledgeBaseError: an event names something that the model does not have.
    """
    ticks = trace.ticks
    first = min([event.number for tick in ticks for event, _ in tick.events], default=1)
    if first != 1 or (ticks and ticks[0].number):
        advice = "keep all ticks, or write them to a file"
        raise TraceError(f"the trace lacks its first ticks, or events before them; {advice}")
    clock = SimpleNamespace(now=ticks[0].time if ticks else 0.0)
    kb = KnowledgeBase(model, clock=lambda: clock.now, is_timed=False)
    runner = TreeRunner(build(kb), clock=lambda: clock.now)
    with _Replay(kb, clock, keep=len(ticks) or 1) as visitor:
        runner.add_visitor(visitor)
        for tick in ticks:
            visitor.tell(event for event, place in tick.events if place == -1)
            visitor.expect(tick)
            runner.tick()
        runner.shutdown()
        return visitor.trace


class _Replay(TraceVisitor):
    """Tells the events of others than the tree at the same place within a tick."""

    def __init__(self, kb: KnowledgeBase, clock: SimpleNamespace, *, keep: int) -> None:
        super().__init__(kb, keep=keep)
        self._clock = clock
        self._tick = _NO_TICK
        kb.subscribe(lambda event: self._follow())

    def tell(self, events: Iterable[Event]) -> None:
        thread = self._thread
        self._thread = None  # these events do not count as told by the tree
        for event in events:
            self._clock.now = event.time
            self._kb.replay(event)
        self._thread = thread

    def expect(self, tick: Tick) -> None:
        self._tick = tick
        self._follow()

    def initialise(self) -> None:
        super().initialise()
        self._follow()

    def run(self, behaviour: Behaviour) -> None:
        super().run(behaviour)
        self._follow()

    def finalise(self) -> None:
        self.tell(event for event, place in self._left() if place is not None)
        self._clock.now = self._tick.time
        super().finalise()

    def _left(self) -> list[Told]:
        """Return the events of the tick that have not happened again yet."""
        last = self._kb.log.last
        return [told for told in self._tick.events if told.event.number > last]

    def _follow(self) -> None:
        """Tell the events that are due, and set the clock to the next event of the tree."""
        left = self._left()
        while self._thread is not None and left:
            event, place = left[0]
            is_due = place is not None and place <= len(self._seen)
            if not is_due or event.number != self._kb.log.last + 1:
                break
            self.tell([event])
            del left[0]
        times = (event.time for event, place in left if place is None)
        self._clock.now = next(times, self._tick.time)
