"""A run as an MCAP file, written as it happens, in ROS 2's own messages; docs/recordings.md has its topics."""

import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, BinaryIO, Final

from py_trees.common import Status
from py_trees.trees import BehaviourTree

from kb import Event, EventKind, KnowledgeBase
from kb.files import draft
from kb.typeql.writer import typeql_text
from missions.engine.controller import RosaController
from missions.engine.mission import Message, MissionError
from missions.engine.recording import header
from missions.engine.runner import Listener, MissionRun
from missions.extras import needs
from missions.views.recorder import Recorder
from missions.views.rows import VERBATIM, Row
from missions.wires import ros
from rosa_bt.xml import NumberedTree

EVENTS, RUN, ROWS, LOG = "/rosa/events", "/rosa/run", "/rosa/rows", "/rosa/log"
DIAGNOSTICS, TREE, TREE_LOG = "/diagnostics", "/behavior_tree", "/behavior_tree_log"
CHUNK_BYTES: Final = 2**16
VERSION: Final = 1
_NAMES: Final = {Status.INVALID: "IDLE"}
_STOP: Final = None
_log = logging.getLogger(__name__)


class McapFile(AbstractContextManager["McapFile"]):
    """A file that grows by a record with each message, so that one cut off can be read up to there.

    When it is closed it is put in the form that tools seek in: chunks, compressed, with an index. Encoding and writing
    happen in a thread of its own.

    Args:
        path: of the file; one that is there is replaced.

    Raises:
        MissionError: it cannot be written there, or the extra `mcap` is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.types = ros.types()
        try:
            self._file: BinaryIO = path.open("wb")
        except OSError as error:
            raise MissionError(f"cannot write {path}: {error.strerror or error}") from error
        self._writer = _writer(self._file, use_chunking=False)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._error: Exception | None = None
        self._queue: SimpleQueue[tuple[str, str, float, Callable[..., dict[str, Any]], Any] | None] = SimpleQueue()
        self._thread = Thread(target=self._write_all, name="mcap", daemon=True)
        self._thread.start()

    def write(self, topic: str, kind: str, time_s: float, make: Callable[..., dict[str, Any]], *arguments: Any) -> None:  # noqa: ANN401  # the arguments of make
        """Have a message written: what `make(*arguments)` returns, as a type of ROS 2, at a time [s]."""
        self._queue.put((topic, kind, time_s, make, arguments))

    def copy(self, topic: str, kind: str, definition: str, stamp: int, data: bytes) -> None:
        """Write a message as it stands in another recording, at its time [ns]."""
        if topic not in self._channels:
            if kind not in self._schemas:
                text = definition or self.types.definition(kind)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        self._writer.add_message(self._channels[topic], stamp, data, stamp)

    def close(self) -> None:
        """Write what there is, and put the file in its final form.

        Raises:
            MissionError: something could not be written; the file holds what came before.
        """
        if not self._thread.is_alive():
            return
        self._queue.put(_STOP)
        self._thread.join()
        try:
            if self._error is not None:
                raise self._error
            self._writer.finish()
            self._file.close()
            _in_chunks(self.path)
        except OSError as error:
            raise MissionError(f"cannot write {self.path}: {error.strerror or error}") from error
        finally:
            self._file.close()

    def _write_all(self) -> None:
        while (item := self._queue.get()) is not _STOP:
            try:
                if self._error is None:
                    topic, kind, time_s, make, arguments = item
                    self.copy(topic, kind, "", ros.nanoseconds(time_s), self.types.encode(kind, make(*arguments)))
                    if self._queue.empty():
                        self._file.flush()
            except Exception as error:  # told when it is closed; the mission goes on
                self._error = error
                _log.warning("%s is recorded no further: %s", self.path, error)

    def __exit__(self, *reason: object) -> None:
        self.close()


def _writer(file: BinaryIO, *, use_chunking: bool) -> Any:  # noqa: ANN401  # the library states no types
    with needs("mcap", "recordings as MCAP"):
        from mcap.writer import Writer
    writer = Writer(file, chunk_size=CHUNK_BYTES, use_chunking=use_chunking)
    writer.start(profile="ros2", library="rosa-taca")
    return writer


def _in_chunks(path: Path) -> None:
    """Put a file in chunks with an index; it is replaced when that is complete."""
    from mcap import records
    from mcap.stream_reader import StreamReader

    with draft(path) as part:
        with path.open("rb") as source, part.open("wb") as target:
            writer = _writer(target, use_chunking=True)
            for record in StreamReader(source).records:
                if isinstance(record, records.Schema):
                    writer.register_schema(record.name, record.encoding, record.data)
                elif isinstance(record, records.Channel):
                    writer.register_channel(record.topic, record.message_encoding, record.schema_id)
                elif isinstance(record, records.Message):
                    writer.add_message(record.channel_id, record.log_time, record.data, record.publish_time)
            writer.finish()
        part.replace(path)


class McapRecorder(Listener, AbstractContextManager["McapRecorder"]):
    """Records a robot: what its knowledge base hears and decides, its tree, and what a report shows beside that.

        recorder = McapRecorder("run.mcap", kb, tree)
        ...
        recorder.close()

    It also listens to runs of missions, whose messages it records as they were heard.

    Args:
        path: of the file.
        kb: whose events are recorded, those that its log holds and those to come.
        page: what makes the rows of the report, if there is one already.
        run: how it is run, e.g. the mission and its settings; plain values.

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
        self._file, self._kb, self._tree = McapFile(Path(path)), kb, tree
        self._numbered: NumberedTree | None = None
        self._statuses: dict[int, str] = {}
        self._own_page = Recorder(kb, tree, what_if=False) if page is None else None
        self._page = page or self._own_page
        assert self._page is not None
        header = {"rosa": VERSION, "model": kb.model.name, "typeql": typeql_text(kb.model), **(run or {})}
        self._file.write(RUN, ros.STRING, kb.now, ros.json_text, {**header, "page": self._page.header})
        for event in kb.log:
            self._event(event)
        for row in self._page.rows.since(0)[1]:
            self._row(row)
        self._stop = kb.subscribe(self._event)
        self._page.rows.heard.append(self._row)
        if tree is not None:
            tree.add_post_tick_handler(self._tick)

    def message(self, message: Message) -> None:
        """Record what was heard: a message with its time [s] and statuses, each with name, message and values."""
        time_s = float(message["time"])
        self._file.write(DIAGNOSTICS, ros.DIAGNOSTICS, time_s, ros.diagnostics, time_s, message["status"])

    def close(self) -> None:
        """Record no more, and complete the file.

        Raises:
            MissionError: something could not be written; the file holds what came before.
        """
        self._stop()
        if self._own_page is not None:
            self._own_page.close()
        if self._page is not None and self._row in self._page.rows.heard:
            self._page.rows.heard.remove(self._row)
        if self._tree is not None and self._tick in self._tree.post_tick_handlers:
            self._tree.post_tick_handlers.remove(self._tick)
        self._file.close()

    def __exit__(self, *reason: object) -> None:
        self.close()

    def _event(self, event: Event) -> None:
        write = self._file.write
        write(EVENTS, ros.STRING, event.time, ros.json_text, event.to_json())
        if event.verb == "measure":
            write(f"/attributes/{event.subject}", ros.FLOAT, event.time, lambda: {"data": float(event.arguments[1])})
        elif event.kind in (EventKind.ACTION_UPDATE, EventKind.RECONFIGURATION_PLAN):
            why = f" because {event.plan.reason}" if event.plan is not None and event.plan.reason else ""
            write(LOG, ros.LOG, event.time, ros.log, event.time, ros.INFO, f"{event.text}{why}")
        elif event.verb == "component_failed":
            write(LOG, ros.LOG, event.time, ros.log, event.time, ros.WARN, event.text)

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
            before, status = self._statuses.get(uid, "IDLE"), _NAMES.get(node.status, node.status.name)
            if status != before:
                changes.append((node.name, uid, before, status))
                self._statuses[uid] = status
        if changes:
            self._file.write(TREE_LOG, ros.TREE_LOG, now, ros.tree_log, now, changes)


def record_run(path: Path, run: MissionRun, seed: int, page: Recorder) -> McapRecorder:
    """Return the recorder of a run that is opened, to be told its messages."""
    tree = run.controller.tree if isinstance(run.controller, RosaController) else None
    return McapRecorder(path, run.kb, tree, page=page, run=header(run, seed)["run"])
