"""Recordings of ours and of ROS 2 (rosbag2 with MCAP or sqlite3), read: what was heard, and what was decided then."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

from kb import Event, KnowledgeBase, Model
from missions.engine.mission import Message, MissionError
from missions.views.recorder import Recorder
from missions.views.rows import Recorded
from missions.wires import mcap, ros

_COMMANDS: Final = {"activate": "activate", "deactivate": "deactivate", "configure": "set_parameters"}
"""What a component is told, by the operation of an attempt."""
_LARGEST_RECORD: Final = 2**30
"""Of an MCAP file [bytes]."""


class Raw(NamedTuple):
    """A message as it stands in a recording: its topic, type and the type's definition, time [ns] and bytes."""

    topic: str
    kind: str
    definition: str
    stamp: int
    data: bytes


@dataclass(slots=True)
class Bag:
    """What a recording holds for us.

    Attributes:
        messages: what was heard, in order of time; times [s], from the beginning of somebody else's recording.
        run: how it was run; empty for somebody else's.
        events: what was known and decided; empty for somebody else's.
        rows: what the report shows beside that, each at its place among the events: (number of the event before, row).
        topics: of every topic, its type and how many messages there are.
        cut: why it is not whole, in words; empty if it is.
        problems: what could not be read, in words.
    """

    messages: list[Message] = field(default_factory=list)
    run: dict[str, Any] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    rows: list[tuple[int, list[Any]]] = field(default_factory=list)
    topics: dict[str, tuple[str, int]] = field(default_factory=dict)
    cut: str = ""
    problems: Counter[str] = field(default_factory=Counter)

    @property
    def duration_s(self) -> float:
        """Time of the last message or event [s]."""
        heard = (float(one["time"]) for one in self.messages[-1:])
        return max(0.0, *heard, *(one.time for one in self.events[-1:]), 0.0)

    def header(self) -> Message:
        """Return the message that a replay begins with: how it was run, and how commands went then."""
        return {"time": 0.0, "status": [], **({"run": {**self.run, "commands": self._commands()}} if self.run else {})}

    def _commands(self) -> list[tuple[str, str, float, bool]]:
        """Return the commands in order: what was told to which component, how long it took [s], and if it went well."""
        given: dict[int, tuple[str, str, float]] = {}
        ended: dict[int, tuple[float, bool]] = {}
        for event in self.events:
            if event.verb == "record_attempt":
                _, component, operation, *_ = event.arguments
                given[len(given) + 1] = _COMMANDS[operation], component, event.time
            elif event.verb == "finish_attempt":
                ended[event.arguments[0]] = event.time, event.arguments[1] == "completed"
        return [
            (verb, component, ended[number][0] - start, ended[number][1])
            for number, (verb, component, start) in given.items()
            if number in ended
        ]


def is_bag(path: str | Path) -> bool:
    """Tell whether a path is a recording of ROS 2, or of ours as MCAP, by its name: `.mcap`, `.db3`, or a folder."""
    place = Path(path)
    return place.is_dir() or place.suffix in (".mcap", ".db3")


def read_bag(path: str | Path) -> Bag:
    """Read a recording; one that is cut off is read up to there.

    Raises:
        MissionError: there is none, or nothing of it can be read; or the extra `mcap` is missing.
    """
    place, bag, types = Reader(path), Bag(), ros.types()
    found: list[tuple[int, list[dict[str, Any]]]] = []
    exact: dict[int, float] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for raw in place:
        counts[raw.topic, raw.kind] += 1
        try:
            if raw.kind == ros.DIAGNOSTICS:
                found.append((raw.stamp, ros.statuses_of(raw.data)))
            elif raw.topic == mcap.EVENTS:
                event = Event.from_json(json.loads(types.decode(ros.STRING, raw.data).data))
                bag.events.append(event)
                exact[raw.stamp] = event.time
            elif raw.topic == mcap.ROWS:
                row = json.loads(types.decode(ros.STRING, raw.data).data)
                bag.rows.append((bag.events[-1].number if bag.events else 0, row))
                exact.setdefault(raw.stamp, row[0])
            elif raw.topic == mcap.RUN:
                bag.run = _run_of(json.loads(types.decode(ros.STRING, raw.data).data), path)
        except MissionError:
            raise
        except Exception as error:  # whatever a message that is none, or a damaged one, may raise
            bag.problems[f"{raw.topic}: {type(error).__name__}: {error}"] += 1
    bag.topics = {topic: (kind, number) for (topic, kind), number in counts.items()}
    bag.cut = place.cut
    bag.problems += place.problems
    found.sort(key=lambda one: one[0])
    start = 0 if bag.run or not found else found[0][0]
    for stamp, statuses in found:  # a time in nanoseconds may miss the one that it was by a rounding
        bag.messages.append({"time": exact.get(stamp, (stamp - start) / 1e9), "status": statuses})
    return bag


def read_page(path: str | Path) -> Recorded:
    """Read a recording of ours as what a report shows: what it knows is told once more, all else is as it was.

    Raises:
        MissionError: it cannot be read, or is somebody else's, which `rosa replay --report` decides and shows.
    """
    bag = read_bag(path)
    if not bag.run:
        raise MissionError(f"{path} is none of ours; rosa replay {path} --mission NAME --report FILE.html shows it")
    now = [0.0]
    kb = KnowledgeBase(model_of(bag, path), clock=lambda: now[0])
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
            kb.tell(event)
    recorder.close()
    return replace(recorder.recorded, note=f"{bag.cut}; all before that is shown" if bag.cut else "")


def model_of(bag: Bag, path: str | Path) -> Model:
    """Return the model that a recording of ours was made with.

    Raises:
        kb.ModelError: it cannot be read.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{Path(path).stem}.tql"
        file.write_text(bag.run["typeql"], encoding="utf-8")
        return Model.load(file, name=bag.run["model"])


def _run_of(run: object, place: str | Path) -> dict[str, Any]:
    if not isinstance(run, dict) or run.get("rosa") != mcap.VERSION:
        version = run.get("rosa") if isinstance(run, Mapping) else run
        raise MissionError(f"{place} is a recording of version {version!r}; this program reads version {mcap.VERSION}")
    return run


class Reader:
    """Yields the messages of a recording as they stand there, in order; up to where it is cut off or damaged.

    Raises:
        MissionError: there is no such file or folder, or nothing of it can be read; or the extra `mcap` is missing.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        if not self._path.exists():
            raise MissionError(f"there is no recording {path}; name a file .mcap or .db3, or the folder of a rosbag2")
        if not is_bag(path):
            is_heard = "holds what was heard only, for `rosa replay` and tests" if self._path.suffix == ".jsonl" else ""
            holds = is_heard or "is no recording (.mcap, .db3, or the folder of a rosbag2)"
            raise MissionError(f"{path} {holds}; `rosa run MISSION --record FILE.mcap` also keeps what was decided")
        self.cut = ""
        self.problems: Counter[str] = Counter()
        self._types = ros.types()

    def __iter__(self) -> Iterator[Raw]:
        is_any = False
        for raw in self._messages():
            is_any = True
            yield raw
        if self.cut and not is_any:
            raise MissionError(f"cannot read the recording {self._path}: {self.cut}")

    def _messages(self) -> Iterator[Raw]:
        place, is_any = self._path, False
        files = sorted(place.glob("*.mcap"), key=lambda one: (len(one.name), one)) if place.is_dir() else [place]
        if (place / "metadata.yaml").exists() if place.is_dir() else place.suffix != ".mcap":
            for raw in self._rosbag2():
                is_any = True
                yield raw
            if is_any or not self.cut or not place.is_dir():
                return
        elif not files:
            self.cut = "the folder has neither metadata.yaml nor a file .mcap; name the file .db3 itself"
        for file in files:  # `rosbags` takes none that has lost its end
            yield from self._mcap(file)

    def _mcap(self, place: Path) -> Iterator[Raw]:
        """Yield the messages from the first byte on, without the index, which a file that is cut off does not have."""
        from mcap import records
        from mcap.stream_reader import StreamReader

        schemas: dict[int, tuple[str, str]] = {}
        channels: dict[int, tuple[str, str, str]] = {}
        try:
            with place.open("rb") as file:
                for record in StreamReader(file, validate_crcs=True, record_size_limit=_LARGEST_RECORD).records:
                    if isinstance(record, records.Schema):
                        schemas[record.id] = record.name, record.data.decode()
                    elif isinstance(record, records.Channel):
                        channels[record.id] = (record.topic, *schemas.get(record.schema_id, ("", "")))
                        if record.message_encoding != "cdr":
                            self.problems[f"{record.topic} is encoded as {record.message_encoding}, not as cdr"] += 1
                    elif isinstance(record, records.Message):
                        yield Raw(*channels[record.channel_id], record.log_time, record.data)
        except Exception as error:  # of the reader and its compression: each has its own
            self._stop(place, error)

    def _rosbag2(self) -> Iterator[Raw]:
        from rosbags.highlevel import AnyReader

        try:
            with AnyReader([self._path], default_typestore=self._types.store) as reader:
                kinds = {one.id: (one.topic, one.msgtype, one.msgdef.data) for one in reader.connections}
                for connection, stamp, data in reader.messages():
                    yield Raw(*kinds[connection.id], stamp, data)
        except Exception as error:
            self._stop(self._path, error)

    def _stop(self, place: Path, error: Exception) -> None:
        said = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
        self.cut = f"{place.name} is cut off or damaged ({said})"
