"""Recordings: writes a run as MCAP while it happens, and reads ours and any rosbag2.

All messages are ROS 2's own; docs/recordings.md lists the topics.
"""

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
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

DIAGNOSTICS, TREE, TREE_LOG, LOG = (
    "/diagnostics",
    "/behavior_tree",
    "/behavior_tree_log",
    "/rosa/log",
)
EVENTS, RUN, ROWS = "/rosa/events", "/rosa/run", "/rosa/rows"
"""Our own topics: the log's events, how the mission was run, a report's other rows."""
VERSION: Final = 1
"""The version of our recordings."""
_COMMANDS: Final = {
    "activate": "activate",
    "deactivate": "deactivate",
    "configure": "set_parameters",
}
"""The command to a component, by the operation of an attempt."""
_LARGEST_RECORD: Final = 2**30
"""The largest record of an MCAP file [bytes]."""
CHUNK_BYTES: Final = 2**16
WAITING: Final = 100_000
"""How many messages may wait to be written; with more, the recording ends."""
PATIENCE_S: Final = 10.0
"""How long one message may take to be written when a file is closed [s]."""
_LOGGED: Final = (EventKind.ACTION_UPDATE, EventKind.RECONFIGURATION_PLAN)
"""The kinds of events that are on `/rosa/log`, besides failures of components."""
_NAMES: Final = {Status.INVALID: "IDLE"}
_log = logging.getLogger(__name__)


class Raw(NamedTuple):
    """A recorded message: topic, type, definition of the type, time [ns] and CDR bytes."""

    topic: str
    kind: str
    definition: str
    stamp: int
    data: bytes


class _Records:
    """Writes the records of an MCAP file: messages, and each type and topic once."""

    def __init__(self, file: BinaryIO, *, use_chunking: bool) -> None:
        from mcap.writer import Writer

        self._channels, self._schemas = dict[str, int](), dict[str, int]()
        self._writer: Any = Writer(file, chunk_size=CHUNK_BYTES, use_chunking=use_chunking)
        self._writer.start(profile="ros2", library="rosa-taca")
        self.finish: Callable[[], object] = self._writer.finish

    def add(self, one: Raw) -> None:
        topic, kind, definition, stamp, data = one
        if topic not in self._channels:
            if kind not in self._schemas:
                text = definition or ros.types().definition(kind)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        self._writer.add_message(self._channels[topic], stamp, data, stamp)


def write_in_chunks(path: Path, recorded: Iterable[Raw]) -> None:
    """Write messages to an MCAP file in compressed chunks, with an index."""
    with path.open("wb") as file:
        records = _Records(file, use_chunking=True)
        for one in recorded:
            records.add(one)
        records.finish()


class McapFile(AbstractContextManager["McapFile"]):
    """An MCAP file that grows with each message; if it is cut off, it can be read up to there.

    `close` rewrites it in chunks with an index. A thread of its own encodes and writes, so a disk
    that is slow or hangs holds up nobody; nothing more is recorded once 100,000 messages wait for
    it.

    Args:
        path: of the file; an existing file is replaced.

    Attributes:
        refused: how many messages were malformed and left out, by what was wrong.
        most: how many messages may wait to be written.

    Raises:
        MissionError: it cannot be written there, or the extra `mcap` is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with needs("mcap", "recordings as MCAP"):
            import mcap.writer  # noqa: F401  # fails before an existing file is emptied
        ros.types()  # so does this, without `rosbags`
        try:
            if self.path.exists() and not self.path.is_file():
                raise OSError("it is not a file; name a file, or a new one")
            self._file = self.path.open("wb")
        except (OSError, ValueError) as error:
            raise self._unwritten(error) from error
        self._records = _Records(self._file, use_chunking=False)
        self.refused = Refusals()
        self.most: float = WAITING
        self._error: Exception | None = None
        self._queue: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = Thread(target=self._write_all, name="mcap", daemon=True)
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
        if self.waiting < self.most:
            self._queue.put(partial(self._write, topic, kind, time_s, partial(make, *arguments)))
        elif self._error is None:
            self._give_up(
                OSError(f"the disk does not keep up, {self.waiting} messages wait to be written")
            )

    @property
    def waiting(self) -> int:
        """How many messages wait to be written."""
        return self._queue.qsize()

    def close(self) -> None:
        """Write the queued messages, and rewrite the file in chunks with an index.

        Raises:
            MissionError: a message could not be written; the file holds those before it.
        """
        self._queue.put(None)
        while self._thread.is_alive():
            waiting = self.waiting
            self._thread.join(PATIENCE_S)
            if self._thread.is_alive() and self.waiting == waiting:
                raise self._unwritten(
                    self._error or OSError(f"the disk does not answer, {waiting} messages wait")
                )
        if self._file.closed:
            return
        try:
            with self._file:
                if self._error is not None:
                    raise self._error
                self._records.finish()
            with draft(self.path) as part:
                write_in_chunks(part, mcap_messages(self.path, Counter()))
                part.replace(self.path)
        except Exception as error:  # of the disk or of the library
            raise self._unwritten(error) from error

    def _write_all(self) -> None:
        for write in iter(self._queue.get, None):
            write()

    def _write(
        self, topic: str, kind: str, time_s: float, make: Callable[[], dict[str, Any]]
    ) -> None:
        if self._error is not None:
            return
        try:
            one = Raw(topic, kind, "", ros.nanoseconds(time_s), ros.types().encode(kind, make()))
        except Exception as error:  # what was malformed is left out, all others are written
            self.refused.add(f"{topic}: {type(error).__name__}: {error}")
            return
        try:
            self._records.add(one)
            if self._queue.empty():
                self._file.flush()
        except Exception as error:  # the mission goes on
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        """Record nothing more; the error is reported when the file is closed."""
        self._error = error
        _log.warning("%s is recorded no further: %s", self.path, error)

    def _unwritten(self, error: Exception) -> MissionError:
        return MissionError(
            f"cannot write {self.path}: {getattr(error, 'strerror', None) or error}"
        )

    def __exit__(self, *reason: object) -> None:
        self.close()


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
        self._file, self._kb, self._open = McapFile(path), kb, ExitStack()
        self.refused = self._file.refused
        self._numbered: NumberedTree | None = None
        self._statuses: dict[int, str] = {}
        self._open.callback(self._file.close)
        shown = page or Recorder(kb, tree, what_if=False)
        self._open.callback(shown.rows.listeners.remove, self._row)
        if page is None:
            self._open.callback(shown.close)
        header = {
            "rosa": VERSION,
            "model": kb.model.name,
            "elements": kb.model.plain(),
            **(run or {}),
        }
        self._file.most = inf  # all that is known already is recorded, however long that takes
        self._file.write(RUN, ros.STRING, kb.now, ros.json_text, {**header, "page": shown.header})
        for event in kb.log:
            self._event(event)
        for row in shown.rows.since(0)[1]:
            self._row(row)
        self._file.most = self._file.waiting + WAITING
        self._open.callback(kb.subscribe(self._event))
        shown.rows.listeners.append(self._row)
        if tree is not None:
            tree.add_post_tick_handler(self._tick)
            self._open.callback(tree.post_tick_handlers.remove, self._tick)

    def message(self, message: Any) -> None:  # noqa: ANN401  # in any form
        """Record diagnostics: of rclpy, as a dict, CDR bytes, or with a "time" [s]."""
        time_s = self._kb.now
        if isinstance(message, Mapping) and "time" in message:
            time_s = float(message["time"])
        self._file.write(DIAGNOSTICS, ros.DIAGNOSTICS, time_s, ros.diagnostics, time_s, message)

    def close(self) -> None:
        """Stop recording, and complete the file.

        Raises:
            MissionError: a message could not be written; the file holds those before it.
        """
        self._open.close()

    def __exit__(self, *reason: object) -> None:
        self.close()

    def _event(self, event: Event) -> None:
        write = self._file.write
        write(EVENTS, ros.STRING, event.time, ros.json_text, event.to_json())
        if event.verb == "measure":
            write(
                f"/attributes/{event.subject}",
                ros.FLOAT,
                event.time,
                lambda: {"data": float(event.arguments[1])},
            )
        elif event.kind in _LOGGED or event.verb == "component_failed":
            write(LOG, ros.LOG, event.time, ros.log_of, event)

    def _row(self, row: Row) -> None:
        time_s, track, _, value = row
        if track not in VERBATIM:
            return
        self._file.write(ROWS, ros.STRING, time_s, ros.json_text, row)
        if track == "pose":
            self._file.write("/pose", ros.POSE, time_s, ros.pose, time_s, value)
            self._file.write("/tf", ros.TF, time_s, ros.transform, time_s, value)

    def _tick(self, tree: BehaviourTree) -> None:
        now = float(self._kb.now)
        if self._numbered is None or not self._numbered.shows(tree.root):
            self._numbered, self._statuses = NumberedTree(tree.root), {}
            self._file.write(TREE, ros.STRING, now, dict, {"data": self._numbered.xml})
        changes = []
        for node, uid in self._numbered.numbers.items():
            before, status = (
                self._statuses.get(uid, "IDLE"),
                _NAMES.get(node.status, node.status.name),
            )
            if status != before:
                changes.append((node.name, uid, before, status))
                self._statuses[uid] = status
        if changes:
            self._file.write(TREE_LOG, ros.TREE_LOG, now, ros.tree_log, now, changes)


@dataclass(slots=True)
class Bag:
    """The contents of a recording; one that is not ours has no `run`, `events` and `rows`.

    Attributes:
        messages: of diagnostics, in order of time; times [s], from the start of a recording that is
            not ours.
        run: how the robot was run.
        events: of the knowledge base.
        rows: what a report shows besides events: (number of the event before it, row).
        topics: type and number of messages, by topic.
        cut: why the recording is not whole, in words; empty if it is.
        problems: what could not be read, in words, and how often.
    """

    messages: list[Message] = field(default_factory=list)
    run: dict[str, Any] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    rows: list[tuple[int, list[Any]]] = field(default_factory=list)
    topics: dict[str, tuple[str, int]] = field(default_factory=dict)
    cut: str = ""
    problems: Counter[str] = field(default_factory=Counter)

    def header(self) -> Message:
        """Return a replay's first message: how the robot was run, and its commands."""
        return {
            "time": 0.0,
            "status": [],
            **({"run": {**self.run, "commands": self._commands()}} if self.run else {}),
        }

    def _commands(self) -> list[tuple[str, str, float, bool]]:
        """Return the commands: command, component, duration [s], and whether it succeeded."""
        given = [one for one in self.events if one.verb == "record_attempt"]
        ended = {one.arguments[0]: one for one in self.events if one.verb == "finish_attempt"}
        return [
            (
                _COMMANDS[one.arguments[2]],
                one.arguments[1],
                end.time - one.time,
                end.arguments[1] == "completed",
            )
            for number, one in enumerate(given, start=1)
            if (end := ended.get(number)) is not None
        ]


def is_bag(path: str | Path) -> bool:
    """Tell by its name whether a path is a recording of ROS 2's messages."""
    return isdir(path) or Path(path).suffix in (".mcap", ".db3")  # noqa: PTH112  # Path raises


def read_bag(path: str | Path) -> Bag:
    """Read a recording; if it is cut off, up to there.

    Raises:
        MissionError: it does not exist, nothing of it can be read, or the extra `mcap` is missing.
    """
    bag, counts, exact = Bag(), Counter[tuple[str, str]](), dict[int, float]()
    found: list[tuple[int, list[dict[str, Any]]]] = []
    for raw in messages(path, bag):
        counts[raw.topic, raw.kind] += 1
        try:
            if raw.kind == ros.DIAGNOSTICS:
                found.append((raw.stamp, ros.statuses_of(raw.data)))
            elif raw.topic == EVENTS:
                event = Event.from_json(_json_of(raw))
                bag.events.append(event)
                exact[raw.stamp] = event.time
            elif raw.topic == ROWS:
                row = _json_of(raw)
                bag.rows.append((bag.events[-1].number if bag.events else 0, row))
                exact.setdefault(raw.stamp, row[0])
            elif raw.topic == RUN:
                bag.run = _run_of(_json_of(raw), path)
        except MissionError:
            raise
        except Exception as error:  # a malformed or damaged message may raise anything
            bag.problems[f"{raw.topic}: {type(error).__name__}: {error}"] += 1
    bag.topics = {topic: (kind, number) for (topic, kind), number in counts.items()}
    found.sort(key=lambda one: one[0])
    start = 0 if bag.run or not found else found[0][0]
    for stamp, statuses in found:  # events hold the time before it was rounded to nanoseconds
        bag.messages.append({"time": exact.get(stamp, (stamp - start) / 1e9), "status": statuses})
    return bag


def _json_of(raw: Raw) -> Any:  # noqa: ANN401  # whatever JSON holds
    return json.loads(ros.types().decode(ros.STRING, raw.data).data)


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
    kb = KnowledgeBase(recorded_model(bag), clock=lambda: now[0])
    recorder, rows = Recorder(kb, header=bag.run["page"]), iter(bag.rows)
    row = next(rows, None)
    for event in [*bag.events, None]:
        while row is not None and (event is None or row[0] < event.number):
            now[0] = max(now[0], row[1][0])
            time, track, key, value = row[1]
            recorder.put(track, key, value, time)
            row = next(rows, None)
        if event is not None and event.number > kb.log.last:
            now[0] = max(now[0], event.time)
            kb.replay(event)
    recorder.close()
    return replace(
        recorder.recorded, note=f"{bag.cut}; all before that is shown" if bag.cut else ""
    )


def recorded_model(bag: Bag) -> Model:
    """Return the model of one of our recordings; kb.ModelError if it cannot be read any more."""
    return Model.from_plain(bag.run["elements"])


def _run_of(run: object, place: str | Path) -> dict[str, Any]:
    if not isinstance(run, dict) or run.get("rosa") != VERSION:
        version = run.get("rosa") if isinstance(run, Mapping) else run
        raise MissionError(
            f"{place} is a recording of version {version!r}; this program reads version {VERSION}"
        )
    if missing := {"model", "elements", "page"} - run.keys():
        raise MissionError(f"{place} is damaged: its header lacks {', '.join(sorted(missing))}")
    return run


def mcap_messages(place: Path, problems: Counter[str]) -> Iterator[Raw]:
    """Yield the messages of an MCAP file from its first byte on, without the index.

    Counts problems after which it can go on; raises what the library and its compression raise.
    """
    from mcap import records
    from mcap.stream_reader import StreamReader

    schemas: dict[int, tuple[str, str]] = {}
    channels: dict[int, tuple[str, str, str]] = {}
    with place.open("rb") as file:
        for record in StreamReader(
            file, validate_crcs=True, record_size_limit=_LARGEST_RECORD
        ).records:
            if isinstance(record, records.Schema):
                schemas[record.id] = record.name, record.data.decode()
            elif isinstance(record, records.Channel):
                channels[record.id] = (record.topic, *schemas.get(record.schema_id, ("", "")))
                if record.message_encoding != "cdr":
                    problems[
                        f"{record.topic} is encoded as {record.message_encoding}, not as cdr"
                    ] += 1
            elif isinstance(record, records.Message):
                yield Raw(*channels[record.channel_id], record.log_time, record.data)


def messages(path: str | Path, bag: Bag) -> Iterator[Raw]:
    """Yield the messages of a recording in order; set `bag.cut` if it is cut off or damaged.

    Raises:
        MissionError: it does not exist, nothing of it can be read, or the extra `mcap` is missing.
    """
    place, is_any = Path(path), False
    if not exists(path):  # noqa: PTH110  # False for an impossible name, where Path raises
        raise MissionError(
            f"there is no recording {path}; name a file .mcap or .db3, or the folder of a rosbag2"
        )
    if not is_bag(path):
        is_heard = (
            "holds what was heard only, for `rosa replay` and tests"
            if place.suffix == ".jsonl"
            else ""
        )
        holds = is_heard or "is no recording (.mcap, .db3, or the folder of a rosbag2)"
        raise MissionError(
            f"{path} {holds}; `rosa run MISSION --record FILE.mcap` also keeps what was decided"
        )
    ros.types()  # a missing library is not a fault of the recording
    for file, found in _ways(place, bag):
        try:
            for raw in found:
                is_any = True
                yield raw
        except Exception as error:  # each library and compression has its own kinds
            said = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
            bag.cut = f"{file.name} is cut off or damaged ({said})"
        if file is place and (is_any or not bag.cut):
            return
    if bag.cut and not is_any:
        raise MissionError(f"cannot read the recording {place}: {bag.cut}")


def _ways(place: Path, bag: Bag) -> Iterator[tuple[Path, Iterator[Raw]]]:
    """Yield paths with their messages: a rosbag2 as a whole, then file by file."""
    is_bag2 = (place / "metadata.yaml").exists() if place.is_dir() else place.suffix != ".mcap"
    if is_bag2:
        yield place, _rosbag2(place)
    files = (
        sorted(place.glob("*.mcap"), key=lambda one: (len(one.name), one))
        if place.is_dir()
        else [place]
    )
    if not files and not is_bag2:
        bag.cut = "the folder has neither metadata.yaml nor a file .mcap; name the file .db3 itself"
    if place.is_dir() or not is_bag2:
        yield from ((file, mcap_messages(file, bag.problems)) for file in files)


def _rosbag2(place: Path) -> Iterator[Raw]:
    from rosbags.highlevel import AnyReader

    with AnyReader([place], default_typestore=ros.types().store) as reader:
        kinds = {one.id: (one.topic, one.msgtype, one.msgdef.data) for one in reader.connections}
        for connection, stamp, data in reader.messages():
            yield Raw(*kinds[connection.id], stamp, data)
