"""A trace: the ticks of a tree together with the events of the knowledge base, in JSON lines.

It can be replayed.

The first line names the version and the model. Each other line is a tick, with the events since the
tick before. The tree and the visited behaviours are left out of a line if they are as in the tick
before. Each line is written when its tick is over, so a program that is killed loses only the tick
that was under way.
"""

import json
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import get_ident
from typing import Any, NamedTuple, Self, TextIO

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.visitors import VisitorBase

from kb import Event, InvalidValue, KnowledgeBase, Model, StatusChange
from kb import Status as ElementStatus
from rosa_bt.behaviours import KbBehaviour, halt
from rosa_bt.exceptions import TraceError
from rosa_bt.runner import TreeRunner

_VERSION = 3
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


class Decision(NamedTuple):
    """A change of an action: of its request or its feasibility."""

    action: str
    what: str
    """One of "requested", "completed", "failed", "abandoned", "unfeasible" and "feasible"."""
    reason: str
    """Why, in the words of the knowledge base; empty if no reason was given."""


class Told(NamedTuple):
    """An event since the tick before, and who told it when."""

    event: Event
    place: int | None
    """None if the tree told it. Else it came before the behaviour at this place in `visited`; -1:
    before the tick."""


class Tick(NamedTuple):
    """One tick: its number, from 0, its time [s], what was ticked, and what became known."""

    number: int
    time: float
    tree: tuple[Node, ...]
    """The behaviours of the tree, parents before children."""
    visited: tuple[Visit, ...]
    """The behaviours that were ticked, in order: children before parents."""
    events: tuple[Told, ...] = ()
    """The events since the tick before, in order; a replay tells again those that the tree did not
    tell."""
    reasons: tuple[str, ...] = ()
    """The reason for each time that an action became unfeasible in these events."""
    is_interrupted: bool = False
    """Whether the tick was cut short, e.g. by Ctrl-C, and the tree halted; all its events count as
    before the tick."""
    errors: tuple[tuple[str, str], ...] = ()
    """The behaviours that raised since the tick before, by name, and the text of the exception."""

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """The requests, results and changes of feasibility of actions since the last tick."""
        decisions = []
        reasons = iter(self.reasons)
        for event, _ in self.events:
            if event.verb == "request_action":
                decisions.append(Decision(event.subject, "requested", ""))
            elif event.verb == "cancel_action":
                decisions.append(Decision(*event.arguments))
            for change in event.changes:
                if _becomes_unfeasible(change):
                    decisions.append(Decision(change.name, "unfeasible", next(reasons, "")))
                elif change.kind == "action" and change.old is ElementStatus.UNFEASIBLE:
                    decisions.append(Decision(change.name, "feasible", ""))
        return tuple(decisions)


@dataclass(frozen=True, slots=True)
class Trace:
    """The ticks of a tree, and the name of the model.

    A trace from memory may lack the first ticks.
    """

    model: str
    ticks: tuple[Tick, ...]

    def __str__(self) -> str:
        lines = [_first_line(self.model)]
        for before, tick in pairwise([None, *self.ticks]):
            if tick is not None:
                lines.append(_tick_line(tick, before))
        return "".join(lines)


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
            self._file = Path(path).open("w", buffering=1)  # noqa: SIM115  # closed by close()
            self._file.write(_first_line(kb.model.name))
        self._ticks: deque[Tick] = deque(maxlen=keep)
        self._count = 0
        self._written = 0  # number of the last event that is written
        self._tree: tuple[Node, ...] = ()
        self._numbers: dict[Behaviour, int] = {}
        self._reasons: dict[int, list[str]] = {}
        self._errors: list[tuple[str, str]] = []
        self._clear()
        kb.log.witnesses += (self._witness,)

    def _clear(self) -> None:
        self._begun = self._kb.log.last
        self._thread: int | None = None
        self._seen: list[tuple[Behaviour, Status, str]] = []
        self._known: list[int] = []  # for each of them, the last event that it knew of
        self._own: set[int] = set()  # numbers of the events that the tree told

    @property
    def trace(self) -> Trace:
        """The ticks that are kept in memory."""
        return Trace(self._kb.model.name, tuple(self._ticks))

    def initialise(self) -> None:
        """Begin a tick: what this thread tells the knowledge base until its end is the tree's."""
        if self._thread is not None:
            self.interrupt()
        self._clear()
        self._thread = get_ident()

    def run(self, behaviour: Behaviour) -> None:
        self._seen.append((behaviour, behaviour.status, behaviour.feedback_message))
        known = self._kb.log.last
        if isinstance(behaviour, KbBehaviour) and behaviour.last_event is not None:
            known = behaviour.last_event
        self._known.append(known)

    def error(self, behaviour: Behaviour, error: Exception) -> None:
        """Note that a behaviour raised; the tree calls it."""
        self._errors.append((behaviour.name, behaviour.feedback_message))

    def finalise(self) -> None:
        if not all(node in self._numbers for node, _, _ in self._seen):
            self._number()
        visits = [
            Visit(self._numbers[node], status.name, text) for node, status, text in self._seen
        ]
        last = max([self._begun, *self._known, *self._own])  # later events are of the next tick
        self._write(tuple(visits), last)

    def interrupt(self) -> None:
        """End a tick that was cut short.

        A runner calls this instead of `finalise`, after it has halted the tree.
        """
        self._write((), None)

    def _write(self, visited: tuple[Visit, ...], last: int | None) -> None:
        """Write a tick with its events up to a number; with all events if it was interrupted."""
        is_interrupted = last is None
        told = []
        reasons = []
        with self._kb.reading():
            events = self._kb.log.since(self._written)
            time = float(self._kb.now)
        for event in events:
            if last is None or event.number <= last:
                place = -1 if is_interrupted else self._place(event.number)
                told.append(Told(Event(*event[:7]), place))  # without what is not in a file
                count = sum(map(_becomes_unfeasible, event.changes))
                reasons += self._reasons.pop(event.number, [""] * count)
                self._written = event.number
        before = self._ticks[-1] if self._ticks else None
        if before is not None and visited == before.visited:
            visited = before.visited  # keep one copy in memory
        tick = Tick(
            *(self._count, time, self._tree, visited, tuple(told), tuple(reasons)),
            *(is_interrupted, tuple(self._errors)),
        )
        if self._file is not None:
            self._file.write(_tick_line(tick, before))
        self._ticks.append(tick)
        self._count += 1
        self._errors.clear()
        self._thread = None

    def _place(self, number: int) -> int | None:
        if number <= self._begun:
            return -1
        if number in self._own:
            return None
        for place, known in enumerate(self._known):
            if known >= number:
                return place
        return len(self._known)

    def _witness(self, event: Event) -> None:
        """Note whether the tree told the event, and why actions became unfeasible with it.

        What time causes while a tick is under way is not told by the tree: it is replayed in its
        place.
        """
        if self._thread == get_ident() and event.verb not in _CAUSED_BY_TIME:
            self._own.add(event.number)
        names = [change.name for change in event.changes if _becomes_unfeasible(change)]
        if names:
            self._reasons[event.number] = [self._kb.why(self._kb.actions[name]) for name in names]

    def close(self) -> None:
        """Stop recording, and close the file."""
        if self._thread is not None:
            self.interrupt()
        log = self._kb.log
        log.witnesses = tuple(other for other in log.witnesses if other != self._witness)
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _number(self) -> None:
        depths: dict[Behaviour, int] = {}
        pending = [(self._seen[-1][0], 0)]
        while pending:
            behaviour, depth = pending.pop()
            depths[behaviour] = depth
            pending += [(child, depth + 1) for child in reversed(behaviour.children)]
        for behaviour, _, _ in self._seen:  # a step of a plan may have left the tree meanwhile
            depths.setdefault(behaviour, 1)
        self._numbers = {behaviour: number for number, behaviour in enumerate(depths)}
        nodes = [Node(depth, type(node).__name__, node.name) for node, depth in depths.items()]
        self._tree = tuple(nodes)


def _becomes_unfeasible(change: StatusChange) -> bool:
    """Tell whether an action became unfeasible."""
    unfeasible = ElementStatus.UNFEASIBLE
    return change.kind == "action" and change.new is unfeasible and change.old is not unfeasible


def _line(record: dict[str, object]) -> str:
    return json.dumps(record, separators=(",", ":")) + "\n"


def _first_line(model: str) -> str:
    return _line({"rosa_bt_trace": _VERSION, "model": model})


def _tick_line(tick: Tick, before: Tick | None) -> str:
    """Return the line of a tick that follows another; `before` is None for the first tick."""
    line: dict[str, object] = {"tick": tick.number, "time": tick.time}
    if before is None or tick.tree != before.tree:
        line["tree"] = tick.tree
    if before is None or tick.visited != before.visited:
        line["visited"] = tick.visited
    others = {
        "events": [(event.to_json(), place) for event, place in tick.events],
        "reasons": tick.reasons,
        "interrupted": tick.is_interrupted,
        "errors": tick.errors,
    }
    return _line(line | {key: value for key, value in others.items() if value})


def read_trace(path: str | Path) -> Trace:
    """Read a trace from a file.

    Raises:
        TraceError: the file cannot be read, or is not a trace; the message names the line.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise TraceError(f"cannot read the trace {path}: {error}") from error
    whole = content.rpartition(b"\n")[0] or content  # a program that is killed cuts the last line
    model = None
    ticks = list[Tick]()
    for number, text in enumerate(whole.splitlines(), start=1):
        try:
            line = json.loads(text)
            if model is not None:
                ticks.append(_read_tick(line, ticks[-1] if ticks else Tick(0, 0.0, (), ())))
                continue
            version = line["rosa_bt_trace"]
            model = str(line["model"])
        except Exception as error:  # a wrong line may raise anything
            problem = f"not a line of a trace ({type(error).__name__}: {error})"
            raise TraceError(f"{path}:{number}: {problem}") from None
        if version != _VERSION:
            how = f"this program reads version {_VERSION}; see `pytest --update-traces`"
            raise TraceError(f"{path} has version {version}; {how}")
    if model is None:
        raise TraceError(f"{path} is empty; a trace begins with a line that says what it is")
    return Trace(model, tuple(ticks))


def _read_tick(line: dict[str, Any], before: Tick) -> Tick:
    return Tick(
        number=int(line["tick"]),
        time=float(line["time"]),
        tree=tuple(Node(*node) for node in line.get("tree", before.tree)),
        visited=tuple(Visit(*visit) for visit in line.get("visited", before.visited)),
        events=tuple(
            Told(Event.from_json(event), place) for event, place in line.get("events", ())
        ),
        reasons=tuple(line.get("reasons", ())),
        is_interrupted=line.get("interrupted", False),
        errors=tuple((name, text) for name, text in line.get("errors", ())),
    )


def replay_trace(trace: Trace, model: Model, build: Callable[[KnowledgeBase], Behaviour]) -> Trace:
    """Tell a new knowledge base the events of a trace, tick a new tree, and return its trace.

    The two traces are equal if model and tree are the same and every leaf decides by the knowledge
    base alone.

    Args:
        trace: a trace from the first tick on, of a knowledge base whose log was complete.
        model: the model of the robot.
        build: makes the tree, with the knowledge base of the replay.

    Raises:
        TraceError: the first ticks or events are missing, or an event cannot be told again.
        kb.KnowledgeBaseError: an event names something that the model does not have.
    """
    ticks = trace.ticks
    if ticks and ticks[0].number:
        advice = "keep all ticks, or write them to a file"
        raise TraceError(f"the trace begins at tick {ticks[0].number}; {advice}")
    first = min([event.number for tick in ticks for event, _ in tick.events], default=1)
    if first != 1:
        raise TraceError(f"the trace begins at event {first}; the log no longer held those before")
    clock = _Clock()
    if ticks:
        clock.now = ticks[0].time
    kb = KnowledgeBase(model, clock=clock, is_timed=False)
    runner = TreeRunner(build(kb), clock=clock)
    with _Replay(kb, clock, keep=len(ticks) or 1) as visitor:
        runner.tree.add_visitor(visitor)
        for tick in ticks:
            visitor.tell(event for event, place in tick.events if place == -1)
            if tick.is_interrupted:
                clock.now = tick.time
                halt(runner.tree.root)
                visitor.interrupt()
            else:
                visitor.expect(tick)
                runner.tick()
        runner.shutdown()
        return visitor.trace


class _Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


class _Replay(TraceVisitor):
    """Tells the events of others than the tree at the same place within a tick."""

    def __init__(self, kb: KnowledgeBase, clock: _Clock, *, keep: int) -> None:
        super().__init__(kb, keep=keep)
        self._clock = clock
        self._end = clock.now
        self._within: deque[tuple[Event, int]] = deque()
        self._own_events: list[Event] = []
        kb.subscribe(lambda event: self._follow())

    def tell(self, events: Iterable[Event]) -> None:
        thread = self._thread
        self._thread = None  # these events do not count as told by the tree
        for event in events:
            self._clock.now = event.time
            try:
                self._kb.replay(event)
            except InvalidValue as error:
                problem = f"{event.verb}{event.arguments!r} cannot be told again"
                raise TraceError(f"{problem}: {error}") from error
        self._thread = thread

    def expect(self, tick: Tick) -> None:
        self._end = tick.time
        self._within.clear()
        self._own_events.clear()
        for event, place in tick.events:
            if place is None:
                self._own_events.append(event)
            elif place >= 0:
                self._within.append((event, place))
        self._set_clock()

    def initialise(self) -> None:
        super().initialise()
        self._follow()

    def run(self, behaviour: Behaviour) -> None:
        super().run(behaviour)
        self._follow()

    def finalise(self) -> None:
        self._clock.now = self._end
        self.tell(event for event, _ in self._within)
        super().finalise()

    def _follow(self) -> None:
        """Tell the events that are due, and set the clock to the next event of the tree."""
        log = self._kb.log
        while self._thread is not None and self._within:
            event, place = self._within[0]
            if place > len(self._seen) or event.number != log.last + 1:
                break
            self._within.popleft()
            self.tell([event])
        if self._thread is not None:
            self._set_clock()

    def _set_clock(self) -> None:
        later = [event.time for event in self._own_events if event.number > self._kb.log.last]
        self._clock.now = later[0] if later else self._end
