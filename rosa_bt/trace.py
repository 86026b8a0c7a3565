"""A trace: the ticks of a tree together with the events of the knowledge base, in JSON lines; it can be replayed.

The first line names the version and the model. Each other line is a tick, with the events since the tick before. The
tree and the visited behaviours are left out of a line if they are as in the tick before. Each line is written when its
tick is over, so a program that is killed loses only the tick that was under way.
"""

import json
import re
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from threading import get_ident
from typing import Any, Final, NamedTuple, Self, TextIO

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.visitors import VisitorBase

from kb import Event, InvalidValue, KnowledgeBase, Model, StatusChange
from kb import Status as ElementStatus
from rosa_bt.behaviours import KbBehaviour, halt
from rosa_bt.exceptions import TraceError
from rosa_bt.runner import TreeRunner

_VERSION: Final = 3
_CAUSED_BY_TIME: Final = frozenset({"stale", "dwell", "lapse"})
_KEPT: Final = 10_000
_ENCODER: Final = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False)
_ESCAPED: Final = re.compile("[\x85\u2028\u2029\ud800-\udfff]")
"""Characters that end a line or cannot be written to a file: they are written as escapes."""


class Node(NamedTuple):
    """A behaviour in a tree: its depth (0 for the root), the name of its class, and its own name, not always unique."""

    depth: int
    kind: str
    name: str


class Visit(NamedTuple):
    """A behaviour that was ticked: its place in `Tick.tree`, and its status, e.g. "RUNNING", and feedback."""

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
    """None if the tree told it. Else it came before the behaviour at this place in `visited`; -1: before the tick."""


class Tick(NamedTuple):
    """One tick: its number, from 0, its time [s], what was ticked, and what became known."""

    number: int
    time: float
    tree: tuple[Node, ...]
    """The behaviours of the tree, parents before children."""
    visited: tuple[Visit, ...]
    """The behaviours that were ticked, in order: children before parents."""
    events: tuple[Told, ...] = ()
    """The events since the tick before, in order; a replay tells again those that the tree did not tell."""
    reasons: tuple[str, ...] = ()
    """The reason for each time that an action became unfeasible in these events."""
    is_interrupted: bool = False
    """Whether the tick was cut short, e.g. by Ctrl-C, and the tree halted; all its events count as before the tick."""
    errors: tuple[tuple[str, str], ...] = ()
    """The behaviours that raised since the tick before, by name, and the text of the exception."""

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """The requests, results and changes of feasibility of actions since the end of the tick before."""
        found, reasons = [], iter(self.reasons)
        for event, _ in self.events:
            if event.verb == "request_action":
                found.append(Decision(event.subject, "requested", ""))
            elif event.verb == "cancel_action":
                found.append(Decision(*event.arguments))
            for change in filter(_turns, event.changes):
                if change.new is ElementStatus.UNFEASIBLE:
                    found.append(Decision(change.name, "unfeasible", next(reasons, "")))
                else:
                    found.append(Decision(change.name, "feasible", ""))
        return tuple(found)


@dataclass(frozen=True, slots=True)
class Trace:
    """The ticks of a tree, and the name of the model; a trace from memory may lack the first ticks."""

    model: str
    ticks: tuple[Tick, ...]

    def __str__(self) -> str:
        ticks = (
            _tick_line(tick, before)
            for before, tick in pairwise([None, *self.ticks])
            if tick is not None
        )
        return "".join([_first_line(self.model), *ticks])

    def statuses(self, name: str) -> tuple[Status, ...]:
        """Return the statuses of all behaviours with this name, in the order of ticks; skipped ones are left out."""
        visits = [
            visit
            for tick in self.ticks
            for visit in tick.visited
            if tick.tree[visit.node].name == name
        ]
        return tuple(
            Status[visit.status] for visit in visits if visit.status != Status.INVALID.name
        )


class TraceVisitor(VisitorBase):
    """Records every tick: the events before it, which behaviours were ticked, with which status and feedback.

    Add it to the visitors of a tree before the first tick; the trace begins with the first event that the log of the
    knowledge base still holds. The same run gives the same trace, to the byte. Memory is bounded: it keeps the last
    ticks; a file keeps all.

    Args:
        kb: the knowledge base that the tree uses.
        path: a file to write all ticks to; an existing file is overwritten.
        keep: how many of the last ticks to keep in memory, at least 1.
    """

    def __init__(
        self, kb: KnowledgeBase, path: str | Path | None = None, *, keep: int = _KEPT
    ) -> None:
        super().__init__(full=False)
        if keep < 1:
            raise ValueError(f"keep is a number of ticks from 1, not {keep!r}")
        self._kb = kb
        self._file: TextIO | None = None
        if path is not None:
            self._file = Path(path).open("w", buffering=1, encoding="utf-8")  # noqa: SIM115  # closed by close()
            self._file.write(_first_line(kb.model.name))
        self._ticks: deque[Tick] = deque(maxlen=keep)
        self._count = self._done = self._begun = 0
        self._tree: tuple[Node, ...] = ()
        self._numbers: dict[Behaviour, int] = {}
        self._seen: list[tuple[Behaviour, Status, str]] = []
        self._known: list[int] = []
        self._own: set[int] = set()
        self._reasons: dict[int, list[str]] = {}
        self._errors: list[tuple[str, str]] = []
        self._thread: int | None = None
        kb.log.witnesses += (self._witness,)

    @property
    def trace(self) -> Trace:
        """The ticks that are kept in memory."""
        return Trace(self._kb.model.name, tuple(self._ticks))

    def initialise(self) -> None:
        """Begin a tick: until its end, what this thread tells the knowledge base comes from the tree."""
        if self._thread is not None:
            self.interrupt()
        self._seen, self._known = [], []
        self._begun, self._thread = self._kb.log.last, get_ident()

    def run(self, behaviour: Behaviour) -> None:
        self._seen.append((behaviour, behaviour.status, behaviour.feedback_message))
        known = behaviour.last_event if isinstance(behaviour, KbBehaviour) else None
        self._known.append(self._kb.log.last if known is None else known)

    def error(self, behaviour: Behaviour, error: Exception) -> None:
        """Note that a behaviour raised; the tree calls it."""
        self._errors.append((behaviour.name, behaviour.feedback_message))

    def finalise(self) -> None:
        if not all(node in self._numbers for node, _, _ in self._seen):
            self._number()
        visited = tuple(
            [Visit(self._numbers[node], status.name, text) for node, status, text in self._seen]
        )
        self._write(visited, is_interrupted=False)

    def interrupt(self) -> None:
        """End a tick that was cut short; a runner calls this instead of `finalise`, after it has halted the tree."""
        self._write((), is_interrupted=True)

    def _write(self, visited: tuple[Visit, ...], *, is_interrupted: bool) -> None:
        with self._kb.reading():
            events = [
                Event(*one[:7]) for one in self._kb.log.since(self._done)
            ]  # without what is not in a file
            time = float(self._kb.now)
        if not is_interrupted:  # later events are of the next tick
            last = max([self._begun, *self._known, *self._own])
            events = [one for one in events if one.number <= last]
        self._done = events[-1].number if events else self._done
        told = tuple(Told(one, -1 if is_interrupted else self._place(one.number)) for one in events)
        whys = [self._reasons.pop(one.number, [""] * len(_unfeasible(one))) for one in events]
        before = self._ticks[-1] if self._ticks else None
        if before is not None and visited == before.visited:
            visited = before.visited  # keep one copy in memory
        tick = Tick(
            self._count,
            time,
            self._tree,
            visited,
            told,
            tuple(chain(*whys)),
            is_interrupted,
            tuple(self._errors),
        )
        self._errors.clear()
        if self._file is not None:
            self._file.write(_tick_line(tick, before))
        self._ticks.append(tick)
        self._count += 1
        self._thread = None
        self._own.clear()

    def _place(self, number: int) -> int | None:
        if number <= self._begun or number in self._own:
            return -1 if number <= self._begun else None
        return next(
            (place for place, known in enumerate(self._known) if known >= number), len(self._known)
        )

    def _witness(self, event: Event) -> None:
        """Note whether the tree told the event, and why actions became unfeasible with it, as it is explained now.

        What time causes while a tick is under way is not told by the tree: it is replayed in its place.
        """
        if self._thread == get_ident() and event.verb not in _CAUSED_BY_TIME:
            self._own.add(event.number)
        names = _unfeasible(event)
        if names:
            self._reasons[event.number] = [self._kb.why(self._kb.actions[name]) for name in names]

    def close(self) -> None:
        """Stop recording, and close the file."""
        if self._thread is not None:
            self.interrupt()
        log = self._kb.log
        log.witnesses = tuple(one for one in log.witnesses if one != self._witness)
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
        for (
            behaviour,
            _,
            _,
        ) in self._seen:  # a step of a plan may have left the tree before the end of the tick
            depths.setdefault(behaviour, 1)
        self._numbers = {behaviour: number for number, behaviour in enumerate(depths)}
        self._tree = tuple(
            Node(depth, type(one).__name__, one.name) for one, depth in depths.items()
        )


def _unfeasible(event: Event) -> list[str]:
    return [
        one.name for one in event.changes if _turns(one) and one.new is ElementStatus.UNFEASIBLE
    ]


def _turns(change: StatusChange) -> bool:
    """Tell whether an action became unfeasible, or is no longer unfeasible."""
    unfeasible = ElementStatus.UNFEASIBLE
    return change.kind == "action" and (change.new is unfeasible) != (change.old is unfeasible)


def _first_line(model: str) -> str:
    return _line({"rosa_bt_trace": _VERSION, "model": model})


def _tick_line(tick: Tick, before: Tick | None) -> str:
    """Return the line of a tick that follows another; `before` is None for the first tick."""
    line: dict[str, object] = {"tick": tick.number, "time": tick.time}
    if before is None or tick.tree != before.tree:
        line["tree"] = tick.tree
    if before is None or tick.visited != before.visited:
        line["visited"] = tick.visited
    if tick.events:
        line["events"] = [(event.to_json(), place) for event, place in tick.events]
    if tick.reasons:
        line["reasons"] = tick.reasons
    if tick.is_interrupted:
        line["interrupted"] = True
    if tick.errors:
        line["errors"] = tick.errors
    return _line(line)


def _line(record: Mapping[str, object]) -> str:
    return _ESCAPED.sub(lambda found: f"\\u{ord(found[0]):04x}", _ENCODER.encode(record)) + "\n"


def read_trace(path: str | Path) -> Trace:
    """Read a trace from a file.

    Raises:
        TraceError: the file cannot be read, or is not a trace; the message names the line.
    """
    try:
        found = Path(path).read_bytes()
        whole = (
            found.rpartition(b"\n")[0] or found
        )  # the last line is incomplete if the program was killed
        lines = whole.decode().splitlines()
    except (OSError, ValueError) as error:
        raise TraceError(f"cannot read the trace {path}: {error}") from error
    if not lines:
        raise TraceError(f"{path} is empty; a trace begins with a line that says what it is")
    model, ticks = "", list[Tick]()
    for number, text in enumerate(lines, start=1):
        try:
            line = json.loads(text)
            if number > 1:
                ticks.append(_tick_of(line, ticks[-1] if ticks else Tick(0, 0.0, (), ())))
                continue
            version, model = line["rosa_bt_trace"], str(line["model"])
        except Exception as error:  # a wrong line may raise anything
            raise TraceError(
                f"{path}:{number}: not a line of a trace ({type(error).__name__}: {error})"
            ) from None
        if version != _VERSION:
            how = f"this program reads version {_VERSION}; `pytest --update-traces` writes a golden one anew"
            raise TraceError(f"{path} has version {version}; {how}")
    return Trace(model, tuple(ticks))


def _tick_of(line: dict[str, Any], before: Tick) -> Tick:
    tree = tuple(Node(*node) for node in line["tree"]) if "tree" in line else before.tree
    visited = (
        tuple(Visit(*visit) for visit in line["visited"]) if "visited" in line else before.visited
    )
    told = tuple(Told(Event.from_json(event), place) for event, place in line.get("events", ()))
    reasons = tuple(map(str, line.get("reasons", ())))
    for visit in visited if "tree" in line or "visited" in line else ():
        if visit.node not in range(len(tree)) or visit.status not in Status.__members__:
            raise ValueError(
                f"{visit} is of no behaviour of the tree, or has no status of py_trees"
            )
    if not all(isinstance(place, int | None) for _, place in told):
        raise ValueError("the place of an event is a number or null")
    tick = Tick(
        int(line["tick"]),
        float(line["time"]),
        tree,
        visited,
        told,
        reasons,
        line.get("interrupted") is True,
        tuple((str(name), str(text)) for name, text in line.get("errors", ())),
    )
    tuple(tick.decisions)  # raises if an event lacks arguments
    return tick


def replay_trace(trace: Trace, model: Model, build: Callable[[KnowledgeBase], Behaviour]) -> Trace:
    """Tell a new knowledge base the events of a trace at their times, tick a new tree, and return its trace.

    The two traces are equal if model and tree are the same and every leaf decides by the knowledge base alone.

    Args:
        trace: a trace from the first tick on, of a knowledge base whose log was complete.
        model: the model of the robot.
        build: makes the tree, with the knowledge base of the replay.

    Raises:
        TraceError: the first ticks or events are missing, or an event cannot be told again.
        kb.KnowledgeBaseError: an event names something that the model does not have.
    """
    if trace.ticks and trace.ticks[0].number:
        raise TraceError(
            f"the trace begins at tick {trace.ticks[0].number}; keep all ticks, or write them to a file"
        )
    first = min((event.number for tick in trace.ticks for event, _ in tick.events), default=1)
    if first != 1:
        raise TraceError(f"the trace begins at event {first}; the log no longer held those before")
    now = [trace.ticks[0].time if trace.ticks else 0.0]
    kb = KnowledgeBase(model, clock=lambda: now[0], is_timed=False)
    runner = TreeRunner(build(kb), clock=lambda: now[0])
    with _Replay(kb, now, len(trace.ticks) or 1) as visitor:
        runner.tree.add_visitor(visitor)
        for tick in trace.ticks:
            visitor.tell(event for event, place in tick.events if place == -1)
            if tick.is_interrupted:
                now[0] = tick.time
                halt(runner.tree.root)
                visitor.interrupt()
            else:
                visitor.expect(tick)
                runner.tick()
        runner.shutdown()
        return visitor.trace


class _Replay(TraceVisitor):
    """Tells the events that others than the tree told during a tick, at the same place within the tick.

    Args:
        now: a list with one number, the time of the clock of the replay [s].
        keep: the number of ticks of the trace.
    """

    def __init__(self, kb: KnowledgeBase, now: list[float], keep: int) -> None:
        super().__init__(kb, keep=keep)
        self._now, self._tick = now, Tick(0, now[0], (), ())
        self._within: deque[tuple[Event, int]] = deque()
        self._own_events: list[Event] = []
        self._stop_following = kb.subscribe(lambda event: self._follow())

    def tell(self, events: Iterable[Event]) -> None:
        thread, self._thread = (
            self._thread,
            None,
        )  # so that these events do not count as told by the tree
        for event in events:
            self._now[0] = event.time
            try:
                self._kb.replay(event)
            except InvalidValue as error:
                raise TraceError(
                    f"{event.verb}{event.arguments!r} cannot be told again: {error}"
                ) from error
        self._thread = thread

    def expect(self, tick: Tick) -> None:
        self._tick = tick
        self._within = deque(
            (event, place) for event, place in tick.events if place is not None and place >= 0
        )
        self._own_events = [event for event, place in tick.events if place is None]
        self._now[0] = self._own_events[0].time if self._own_events else tick.time

    def initialise(self) -> None:
        super().initialise()
        self._follow()

    def run(self, behaviour: Behaviour) -> None:
        super().run(behaviour)
        self._follow()

    def finalise(self) -> None:
        self._now[0] = self._tick.time
        self.tell(event for event, _ in self._within)
        super().finalise()

    def _follow(self) -> None:
        """Tell the events that are due, and set the clock to the time of the next event that the tree told."""
        if self._thread is None:
            return
        last = self._kb.log.last
        while (
            self._within
            and self._within[0][1] <= len(self._seen)
            and self._within[0][0].number == last + 1
        ):
            self.tell([self._within.popleft()[0]])
            last = self._kb.log.last
        self._now[0] = next(
            (one.time for one in self._own_events if one.number > last), self._tick.time
        )
