"""Recordings: writes a run as MCAP while it happens, and reads ours and any rosbag2.

All messages are ROS 2's own; docs/recordings.md lists the topics.
"""

import json
import logging
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from operator import itemgetter
from os.path import exists, isdir
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, BinaryIO, Final, NamedTuple

from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import Event, EventKind, KnowledgeBase, Model
from kb.files import draft
from missions.engine.mission import Message, MissionError, needs
from missions.engine.runner import Listener
from missions.views.recorder import Recorder
from missions.views.report import VERBATIM, Recorded, Row
from missions.wires import ros
from missions.wires.node import Refusals
from rosa_bt.xml import NumberedTree

DIAGNOSTICS: Final = "/diagnostics"
LOG: Final = "/rosa/log"
EVENTS, RUN, ROWS = "/rosa/events", "/rosa/run", "/rosa/rows"
"""Our own topics: the log's events, how the mission was run, a report's other rows."""
VERSION: Final = 1
"""The version of our recordings."""
_CHUNK_BYTES: Final = 2**16
PATIENCE_S: Final = 60.0
"""How long the queued messages may take to be written when a file is closed [s]."""
_LOGGED: Final = (EventKind.ACTION_UPDATE, EventKind.RECONFIGURATION_PLAN)
"""The kinds of events that are on `/rosa/log`, besides failures of components."""
_log = logging.getLogger(__name__)


class Raw(NamedTuple):
    """A recorded message: topic, type, time [ns] and CDR bytes."""

    topic: str
    kind: str
    stamp: int
    data: bytes


class _Records:
    """Writes the records of an MCAP file: messages, and each topic with its type once."""

    def __init__(self, file: BinaryIO, *, use_chunking: bool) -> None:
        from mcap.writer import Writer

        self._channels: dict[str, int] = {}
        self._writer: Any = Writer(file, chunk_size=_CHUNK_BYTES, use_chunking=use_chunking)
        self._writer.start(profile="ros2", library="rosa-taca")
        self.finish: Callable[[], object] = self._writer.finish

    def add(self, message: Raw) -> None:
        topic, kind, stamp, data = message
        if topic not in self._channels:
            text = ros.types().definition(kind)
            schema = self._writer.register_schema(kind, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schema)
        self._writer.add_message(self._channels[topic], stamp, data, stamp)


class McapFile:
    """An MCAP file that grows with each message; if it is cut off, it can be read up to there.

    `close` rewrites it in chunks with an index. A thread of its own encodes and writes, so a disk
    that is slow or hangs holds up nobody.

    Args:
        path: of the file; an existing file is replaced.

    Attributes:
        refused: how many messages were malformed and left out, by what was wrong.

    Raises:
        MissionError: it cannot be written there, or the extra `mcap` is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with needs("mcap", "recordings as MCAP"):
            import mcap.writer  # noqa: F401  # fails before an existing file is emptied
        ros.types()  # so does this, without `rosbags`
        try:
            self._file = self.path.open("wb")
        except (OSError, ValueError) as error:
            raise self._unwritten(error) from error
        self._records = _Records(self._file, use_chunking=False)
        self.refused = Refusals()
        self._error: Exception | None = None
        self._queue = SimpleQueue[Any]()
        self._thread = Thread(target=self._run, name="mcap", daemon=True)
        self._thread.start()

    def write(
        self,
        topic: str,
        kind: str,
        time_s: float,
        make: Callable[..., dict[str, Any]],
        *arguments: Any,  # noqa: ANN401  # the arguments of make
    ) -> None:
        """Queue a message at a time [s]: the thread writes what `make(*arguments)` returns."""
        if self._error is None:
            self._queue.put((topic, kind, time_s, make, arguments))

    def close(self) -> None:
        """Write the queued messages, and rewrite the file in chunks with an index.

        Raises:
            MissionError: a message could not be written; the file holds those before it.
        """
        self._queue.put(None)
        self._thread.join(PATIENCE_S)
        try:
            if self._thread.is_alive():
                raise TimeoutError("the disk does not answer")
            if self._error is not None:
                raise self._error
            with draft(self.path) as part:
                with part.open("wb") as file:
                    records = _Records(file, use_chunking=True)
                    for message in _mcap_messages(self.path, Counter()):
                        records.add(message)
                    records.finish()
                part.replace(self.path)
        except Exception as error:  # of the disk or of the library
            raise self._unwritten(error) from error

    def _run(self) -> None:
        try:
            with self._file:
                for topic, kind, time_s, make, arguments in iter(self._queue.get, None):
                    try:
                        data = ros.types().encode(kind, make(*arguments))
                    except Exception as error:  # of the message: all others are written
                        self.refused.add(f"{topic}: {type(error).__name__}: {error}")
                        continue
                    self._records.add(Raw(topic, kind, ros.nanoseconds(time_s), data))
                    if self._queue.empty():
                        self._file.flush()
                self._records.finish()
        except Exception as error:  # of the disk; the mission goes on
            self._error = error
            _log.warning("%s is recorded no further: %s", self.path, error)

    def _unwritten(self, error: Exception) -> MissionError:
        reason = getattr(error, "strerror", None) or error
        return MissionError(f"cannot write {self.path}: {reason}")


class McapRecorder(Listener, AbstractContextManager["McapRecorder"]):
    """Records a robot: the events of its knowledge base, its tree, and the other rows of a report.

        recorder = McapRecorder("run.mcap", kb, tree)
        ...
        recorder.close()

    As a listener of a mission's run it also records the messages that the robot hears.

    Args:
        path: of the file.
        kb: its events are recorded, those in its log and those to come.
        page: the recorder that makes the rows of the report; None to make one.
        run: how the robot is run, e.g. mission and settings, as plain values.

    Attributes:
        refused: as of `McapFile`.

    Raises:
        MissionError: the file cannot be written, or the extra `mcap` is missing.
    """

    def __init__(
        self,
        path: str | Path,
        kb: KnowledgeBase,
        tree: BehaviourTree | None = None,
        *,
        page: Recorder | None = None,
        run: Mapping[str, object] | None = None,
    ) -> None:
        self._file = McapFile(path)
        self.refused = self._file.refused
        self._write = self._file.write
        self._kb = kb
        self._tree: NumberedTree | None = None
        self._statuses: dict[int, str] = {}
        self._open = ExitStack()
        self._open.callback(self._file.close)
        shown = page or Recorder(kb, tree, what_if=False)
        if page is None:
            self._open.callback(shown.close)
        header = {"rosa": VERSION, "model": kb.model.name, "elements": kb.model.plain()}
        header |= {"page": shown.header, **(run or {})}
        self._write(RUN, ros.STRING, kb.now, ros.json_text, header)
        for event in kb.log:
            self._event(event)
        for row in shown.rows.since(0)[1]:
            self._row(row)
        self._open.callback(kb.subscribe(self._event))
        shown.rows.listeners.append(self._row)
        self._open.callback(shown.rows.listeners.remove, self._row)
        if tree is not None:
            tree.add_post_tick_handler(self._tick)
            self._open.callback(tree.post_tick_handlers.remove, self._tick)

    def message(self, message: Any) -> None:  # noqa: ANN401  # in any form
        """Record diagnostics: of rclpy, as a dict, CDR bytes, or with a "time" [s]."""
        time_s = self._kb.now
        if isinstance(message, Mapping) and "time" in message:
            time_s = float(message["time"])
        self._write(DIAGNOSTICS, ros.DIAGNOSTICS, time_s, ros.diagnostics, time_s, message)

    def close(self) -> None:
        """Stop recording, and complete the file.

        Raises:
            MissionError: a message could not be written; the file holds those before it.
        """
        self._open.close()

    def __exit__(self, *reason: object) -> None:
        self.close()

    def _event(self, event: Event) -> None:
        self._write(EVENTS, ros.STRING, event.time, ros.json_text, event.to_json())
        if event.verb == "measure":
            value = float(event.arguments[1])
            self._write(
                f"/attributes/{event.subject}", ros.FLOAT, event.time, dict, {"data": value}
            )
        elif event.kind in _LOGGED or event.verb == "component_failed":
            self._write(LOG, ros.LOG, event.time, ros.log_of, event)

    def _row(self, row: Row) -> None:
        time_s, track, _, value = row
        if track not in VERBATIM:
            return
        self._write(ROWS, ros.STRING, time_s, ros.json_text, row)
        if track == "pose":
            self._write("/pose", ros.POSE, time_s, ros.pose, time_s, value)

    def _tick(self, tree: BehaviourTree) -> None:
        now = float(self._kb.now)
        if self._tree is None or not self._tree.shows(tree.root):
            self._tree = NumberedTree(tree.root)
            self._statuses = dict.fromkeys(self._tree.numbers.values(), "IDLE")
            self._write("/behavior_tree", ros.STRING, now, dict, {"data": self._tree.xml})
        changes = []
        for node, number in self._tree.numbers.items():
            status = "IDLE" if node.status is Status.INVALID else node.status.name
            if status != self._statuses[number]:
                changes.append((node.name, number, self._statuses[number], status))
                self._statuses[number] = status
        if changes:
            self._write("/behavior_tree_log", ros.TREE_LOG, now, ros.tree_log, now, changes)


@dataclass(slots=True)
class Bag:
    """The contents of a recording; one that is not ours has no `run`, `events` and `rows`.

    Attributes:
        messages: of diagnostics, in order of time; times [s], from the start of a recording that is
            not ours.
        run: how the robot was run.
        events: of the knowledge base.
        rows: what a report shows besides events: (number of the event before it, row).
        cut: why the recording is not whole, in words; empty if it is.
        problems: what could not be read, in words, and how often.
    """

    messages: list[Message] = field(default_factory=list)
    run: dict[str, Any] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    rows: list[tuple[int, list[Any]]] = field(default_factory=list)
    cut: str = ""
    problems: Counter[str] = field(default_factory=Counter)

    def header(self) -> Message:
        """Return a replay's first message: how the robot was run, and its commands."""
        about = {"run": {**self.run, "commands": self._commands()}} if self.run else {}
        return {"time": 0.0, "status": [], **about}

    def _commands(self) -> list[tuple[str, str, float, bool]]:
        """Return the commands: command, component, duration [s], and whether it succeeded."""
        commands = {}
        given = [event for event in self.events if event.verb == "record_attempt"]
        attempts = {event.number: event for event in given}
        for event in self.events:
            if event.verb == "finish_attempt":
                number, result, *_ = event.arguments
                attempt = attempts[number]
                _, component, operation, *_ = attempt.arguments
                is_done = result == "completed"
                duration_s = event.time - attempt.time
                command = "set_parameters" if operation == "configure" else operation
                commands[number] = (command, component, duration_s, is_done)
        return [commands[number] for number in sorted(commands)]


def is_bag(path: str | Path) -> bool:
    """Tell by its name whether a path is a recording of ROS 2's messages."""
    return isdir(path) or Path(path).suffix in (".mcap", ".db3")  # noqa: PTH112  # Path raises


def read_bag(path: str | Path) -> Bag:
    """Read a recording; if it is cut off, up to there.

    Raises:
        MissionError: it does not exist, nothing of it can be read, or the extra `mcap` is missing.
    """
    bag = Bag()
    diagnostics: list[tuple[int, list[dict[str, Any]]]] = []
    for raw in messages(path, bag):
        try:
            if raw.kind == ros.DIAGNOSTICS:
                array = ros.types().decode(raw.kind, raw.data)
                diagnostics.append((raw.stamp, ros.plain_statuses(array)))
            elif raw.topic in (EVENTS, ROWS, RUN):
                content = json.loads(ros.types().decode(ros.STRING, raw.data)["data"])
                if raw.topic == EVENTS:
                    bag.events.append(Event.from_json(content))
                elif raw.topic == ROWS:
                    bag.rows.append((bag.events[-1].number if bag.events else 0, content))
                else:
                    bag.run = content
        except Exception as error:  # a malformed or damaged message may raise anything
            bag.problems[f"{raw.topic}: {type(error).__name__}: {error}"] += 1
    if bag.run.get("rosa", VERSION) != VERSION:
        raise MissionError(
            f"{path} is a recording of version {bag.run['rosa']!r}; "
            f"this program reads version {VERSION}"
        )
    diagnostics.sort(key=itemgetter(0))
    start = 0 if bag.run or not diagnostics else diagnostics[0][0]
    bag.messages = [
        {"time": (stamp - start) / 1e9, "status": statuses} for stamp, statuses in diagnostics
    ]
    return bag


def read_page(path: str | Path) -> Recorded:
    """Read one of our recordings for a report: apply its events anew, copy the other rows.

    Raises:
        MissionError, kb.ModelError: it cannot be read, or is not ours (`rosa replay --report` shows
            those).
    """
    bag = read_bag(path)
    if not bag.run:
        raise MissionError(
            f"{path} is not rosa's own; "
            f"rosa replay {path} --mission NAME --report FILE.html shows it"
        )
    now = [0.0]
    kb = KnowledgeBase(Model.from_plain(bag.run["elements"]), clock=lambda: now[0])
    recorder = Recorder(kb, header=bag.run["page"])
    rows = deque(bag.rows)
    for event in [*bag.events, None]:
        while rows and (event is None or rows[0][0] < event.number):
            _, (time_s, track, key, value) = rows.popleft()
            now[0] = max(now[0], time_s)
            recorder.put(track, key, value, time_s)
        if event is not None and event.number > kb.log.last:
            now[0] = max(now[0], event.time)
            kb.replay(event)
    recorder.close()
    note = f"{bag.cut}; all before that is shown" if bag.cut else ""
    return replace(recorder.recorded, note=note)


def messages(path: str | Path, bag: Bag) -> Iterator[Raw]:
    """Yield the messages of a recording in order; set `bag.cut` if it is cut off or damaged.

    Raises:
        MissionError: it does not exist, nothing of it can be read, or the extra `mcap` is missing.
    """
    if not exists(path) or not is_bag(path):  # noqa: PTH110  # Path raises for an impossible name
        raise MissionError(
            f"{path} is no recording of a run: name a file .mcap or .db3, or the folder of a "
            "rosbag2; `rosa run MISSION --record FILE.mcap` makes one; .jsonl has diagnostics only"
        )
    ros.types()  # a missing library is not a fault of the recording
    place = Path(path)
    is_mcap = place.suffix == ".mcap"
    is_any = False
    try:
        for raw in _mcap_messages(place, bag.problems) if is_mcap else _rosbag2_messages(place):
            is_any = True
            yield raw
    except Exception as error:  # each library and compression has its own kinds
        reason = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
        bag.cut = f"{place.name} is cut off or damaged ({reason})"
        if not is_any:
            raise MissionError(f"cannot read the recording {place}: {bag.cut}") from error


def _mcap_messages(path: Path, problems: Counter[str]) -> Iterator[Raw]:
    """Yield the messages of an MCAP file from its first byte on, without the index."""
    from mcap.reader import NonSeekingReader

    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if schema is None or channel.message_encoding != "cdr":
                problems[f"{channel.topic} is encoded as {channel.message_encoding}, not cdr"] += 1
                continue
            yield Raw(channel.topic, schema.name, message.log_time, message.data)


def _rosbag2_messages(path: Path) -> Iterator[Raw]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path], default_typestore=ros.types().store) as reader:
        for connection, stamp, data in reader.messages():
            yield Raw(connection.topic, connection.msgtype, stamp, data)
