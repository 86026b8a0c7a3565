"""Recordings as MCAP: what others read in them, what is decided from them once more, and files that are not sound."""

import json
import os
import random
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from struct import error as Torn
from threading import Event

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from py_trees.behaviours import Running
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from running import read_report
from typer.testing import CliRunner

from kb import KnowledgeBase, Model
from missions import cli
from missions.baselines import open_run
from missions.engine.mission import MissionError, Verdict, find_mission
from missions.engine.recording import header, measured, read_recording
from missions.engine.runner import Listener
from missions.suave.world import Sea
from missions.testing.decisions import replay
from missions.views.recorder import RunRecorder
from missions.wires import mcap, ros
from missions.wires.mcap import RUN, VERSION, Bag, McapFile, McapRecorder, read_bag, read_page
from missions.wires.ros import to_object
from rosa_bt import ForAction, TreeRunner, first_feasible

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")
TOPICS = {
    "/attributes/battery_level",
    "/attributes/water_visibility",
    "/behavior_tree",
    "/behavior_tree_log",
    "/diagnostics",
    "/pose",
    "/rosa/events",
    "/rosa/log",
    "/rosa/rows",
    "/rosa/run",
    "/tf",
}


def rosa(*arguments, code=0):
    done = CliRunner().invoke(cli.app, list(map(str, arguments)))
    assert done.exit_code == code, f"{done.output}\n{done.exception!r}"
    return done.output


@pytest.fixture(scope="module")
def drop(tmp_path_factory):
    """The battery drop, recorded while it ran, with the page that was made beside it."""
    path = tmp_path_factory.mktemp("recorded") / "drop.mcap"
    rosa("run", "suave_extended", "--no-progress", "--record", path, "--set", "duration_s=200")
    return path


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "name": st.text(),
                "message": st.text(),
                "values": st.dictionaries(st.text(), st.text(), max_size=3),
            }
        ),
        max_size=4,
    )
)
def test_bytes_of_diagnostics_are_read_as_they_were_written(statuses):
    types = ros.types()
    message = ros.diagnostics(1.5, {"status": statuses})
    data = types.encode(ros.DIAGNOSTICS, message)
    assert ros.statuses_of(data) == statuses
    other = bytes(
        types.store.serialize_cdr(
            to_object(types, ros.DIAGNOSTICS, message), ros.DIAGNOSTICS, little_endian=False
        )
    )
    assert other[:2] != data[:2]
    assert ros.statuses_of(other) == statuses
    end = 20 if not statuses else len(data.rstrip(b"\0"))  # after it comes padding, if anything
    for size in range(end):
        with pytest.raises((SerdeError, ValueError, Torn)):
            ros.statuses_of(data[:size])


def test_recorder_takes_diagnostics_however_they_come(tmp_path):
    pairs = [{"key": "Charge", "value": "0.5"}]
    about = {"name": "battery: charge", "message": "low", "hardware_id": "b1"}
    array = {"header": {}, "status": [{"level": 1, **about, "values": pairs}]}
    data = ros.types().encode(ros.DIAGNOSTICS, array)
    thing = ros.types().decode(ros.DIAGNOSTICS, data)
    kb = KnowledgeBase(Model("m"), clock=lambda: 2.5)
    with McapRecorder(tmp_path / "x.mcap", kb) as recorder:
        for message in (array, data, thing, {"time": 7.0, "status": array["status"]}):
            recorder.message(message)
        recorder.message(b"no message")
        recorder.message({"status": [{"name": "no values"}]})
    assert recorder.refused.total() == 2
    messages = read_bag(tmp_path / "x.mcap").messages
    assert [message["time"] for message in messages] == [2.5, 2.5, 2.5, 7.0]
    status = {"name": "battery: charge", "message": "low", "values": {"Charge": "0.5"}, "level": 1}
    assert [message["status"] for message in messages] == [[status]] * 4


def test_replay_that_heard_nothing_exits_1(drop, tmp_path):
    path = tmp_path / "silent.mcap"
    with McapRecorder(path, KnowledgeBase(Model("m"), clock=lambda: 0.0)) as recorder:
        array = {"status": [{"name": "gps: fix", "message": "2D", "values": []}]}
        recorder.message({"time": 1.0, **array})
    said = rosa("replay", path, "--mission", "suave_extended", code=1)
    assert "nothing in its 1 message of diagnostics says anything to suave_extended" in said
    with McapRecorder(path, KnowledgeBase(Model("m"), clock=lambda: 0.0)):
        pass
    said = rosa("replay", path, "--mission", "suave_extended", code=1)
    assert "has no message of diagnostics" in said


def as_rosbag2(drop, folder, *, storage=StoragePlugin.MCAP, mode=None, strange=False):
    """Write what was heard as anybody's rosbag2."""
    store, bag = get_typestore(Stores.ROS2_HUMBLE), read_bag(drop)
    if strange:
        store.register(get_types_from_msg("uint8 left", "somebody_msgs/msg/Secret"))
    writer = Writer(folder, version=8, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        diagnostics = writer.add_connection("/diagnostics", ros.DIAGNOSTICS, typestore=store)
        for message in bag.messages:
            stamp = 10**18 + ros.nanoseconds(message["time"])
            data = ros.types().encode(ros.DIAGNOSTICS, ros.diagnostics(message["time"], message))
            writer.write(diagnostics, stamp, data)
        if strange:
            secret = writer.add_connection("/secret", "somebody_msgs/msg/Secret", typestore=store)
            kind = store.types["somebody_msgs/msg/Secret"]
            writer.write(secret, 10**18, store.serialize_cdr(kind(7), "somebody_msgs/msg/Secret"))
    return folder


def decided(decisions, began=0.0):
    return [(name, round(start - began, 6)) for name, start, *_ in decisions.actions[1:]]


def test_others_read_what_was_recorded(drop):
    with drop.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert {channel.topic for channel in summary.channels.values()} == TOPICS
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert len(summary.chunk_indexes) > 1, "what tools seek in"
    with drop.open("rb") as file:
        messages = list(make_reader(file).iter_messages(topics=["/attributes/battery_level"]))
    assert len(messages) > 100
    last = ros.types().decode(ros.FLOAT, messages[-1][2].data).data
    assert (
        last
        == [one for one in read_bag(drop).events if one.subject == "battery_level"][-1].arguments[1]
    )


MCAP = Path(cli.__file__).parent / "views" / "page" / "node_modules" / "@mcap" / "core"


@pytest.mark.skipif(
    not (shutil.which("node") and MCAP.exists()),
    reason="needs Node.js: npm ci in missions/views/page",
)
def test_foxgloves_library_reads_what_was_recorded(drop, tmp_path):
    script = tmp_path / "read.mjs"
    script.write_text(f"""
import {{ readFileSync }} from 'node:fs';
import {{ createRequire }} from 'node:module';
const require = createRequire('{MCAP.as_posix()}/');
const {{ McapIndexedReader, TempBuffer }} = require('@mcap/core');
const {{ decompress }} = require('fzstd');
const readable = new TempBuffer(readFileSync('{drop.as_posix()}'));
const zstd = (data, size) => decompress(new Uint8Array(data), new Uint8Array(Number(size)));
const reader = await McapIndexedReader.Initialize({{ readable, decompressHandlers: {{ zstd }} }});
const counts = {{}};
for await (const message of reader.readMessages()) {{
  const topic = reader.channelsById.get(message.channelId).topic;
  counts[topic] = (counts[topic] || 0) + 1;
}}
console.log(JSON.stringify(counts));
""")
    done = subprocess.run(
        ["node", str(script)], capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        topic: count for topic, (_, count) in read_bag(drop).topics.items()
    }


def test_rosbags_reads_it_as_a_bag(drop, tmp_path):
    (tmp_path / "bag").mkdir()
    copy = tmp_path / "bag" / "bag_0.mcap"
    copy.write_bytes(drop.read_bytes())
    with AnyReader([copy]) as reader:
        assert {one.topic for one in reader.connections} == TOPICS
        logged = [
            reader.deserialize(data, one.msgtype)
            for one, _, data in reader.messages()
            if one.topic == "/rosa/log"
        ]
    assert any(one.msg.startswith("inspect_pipeline is requested") for one in logged)


def test_tree_log_names_nodes_of_the_recorded_tree(drop):
    with drop.open("rb") as file:
        found = [
            (c.topic, m.data)
            for _, c, m in make_reader(file).iter_messages(topics=["/behavior_tree_log"])
        ]
    with drop.open("rb") as file:
        (tree,) = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/behavior_tree"])]
    xml = ros.types().decode(ros.STRING, tree).data
    changes = [one for _, data in found for one in ros.types().decode(ros.TREE_LOG, data).event_log]
    assert {one.current_status for one in changes} >= {"RUNNING", "SUCCESS"}
    for one in changes:
        assert f'name="{one.node_name}" _uid="{one.uid}"' in xml


@pytest.mark.parametrize(
    ("mission", "task"), [("suave_extended", "pddl"), ("agv", "bt"), ("uav", "bt"), ("uav", "pddl")]
)
def test_replay_decides_as_recorded(mission, task, tmp_path):
    path = tmp_path / "run.mcap"
    rosa("run", mission, "--task", task, "--no-progress", "--seed", 3, "--record", path)
    assert "decided as recorded" in rosa("replay", path)


class Stop(Listener):
    def tick(self, run):
        if run.world.now > 20.0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("is_told", [True, False], ids=["Ctrl-C", "SIGTERM"])
def test_replay_of_a_run_that_was_stopped_by_hand_decides_as_recorded(is_told, tmp_path):
    path, run = tmp_path / "run.mcap", open_run(find_mission("suave"), seed=0, settings={})
    page = RunRecorder(run, 0, {})
    with McapRecorder(
        path, run.kb, run.tree, page=page.recorder, run=header(run, 0)["run"]
    ) as recorder:
        run.listen(recorder, Stop())
        with pytest.raises(KeyboardInterrupt):
            run.run()
        if is_told:
            page.end(Verdict("aborted", "stopped by hand"))
    assert read_bag(path).events[-1].verb == "cancel_action"
    assert "decided as recorded" in rosa("replay", path)


def test_recording_is_replayed_from_a_pipe():
    readable, writable = os.pipe()
    os.write(writable, BATTERY_DROP.read_bytes())
    os.close(writable)
    try:
        said = rosa("replay", f"/dev/fd/{readable}", "--mission", "suave_extended")
    finally:
        os.close(readable)
    assert said == rosa("replay", BATTERY_DROP, "--mission", "suave_extended")
    assert "recharge is requested" in said


def test_recording_that_begins_late_holds_all_that_was_known_however_much_that_is(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(mcap, "WAITING", 3)
    kb = KnowledgeBase(find_mission("suave_extended").model(), clock=lambda: 0.0)
    for number in range(2000):
        kb.measure("battery_level", 1.0 - number / 2000)
    McapRecorder(tmp_path / "run.mcap", kb).close()
    assert len(read_bag(tmp_path / "run.mcap").events) == len(kb.log)


def test_run_says_what_could_not_be_recorded(tmp_path, monkeypatch):
    advance = Sea.advance

    def odd(world, until):
        return [
            {**one, "status": [{"message": "\ud800", "values": {}}]}
            for one in advance(world, until)
        ]

    monkeypatch.setattr(Sea, "advance", odd)
    said = rosa(
        "run",
        "suave",
        "--no-progress",
        "--set",
        "duration_s=5",
        "--record",
        tmp_path / "run.mcap",
        code=1,
    )
    assert re.search(r"not recorded, \d+ times: /diagnostics: UnicodeEncodeError", said)


def test_recording_of_the_same_run_is_the_same_bytes(drop, tmp_path):
    again = tmp_path / "again.mcap"
    rosa("run", "suave_extended", "--no-progress", "--record", again, "--set", "duration_s=200")
    assert again.read_bytes() == drop.read_bytes()


def test_report_of_a_recording_is_that_of_the_run(tmp_path):
    path, page = tmp_path / "run.mcap", tmp_path / "run.html"
    rosa("run", "uav", "--no-progress", "--record", path, "--report", page)
    run, recorded = read_report(page), read_page(path)
    assert recorded.header == run.header
    rows = [tuple(row) for row in json.loads(json.dumps(recorded.rows)) if row[1] != "whatif"]
    assert sorted(map(repr, rows)) == sorted(repr(row) for row in run.rows if row[1] != "whatif")


def test_replay_says_from_when_it_decides_otherwise(drop, tmp_path, monkeypatch):
    other = tmp_path / "eager.py"
    other.write_text(
        "from dataclasses import replace\n"
        "from missions.suave_extended import MISSION as ours\n"
        "def model():\n"
        "    model = ours.model()\n"
        "    model.actions['inspect_pipeline'].constrain(model.attributes['battery_level'] >= 0.4)\n"
        "    return model\n"
        "MISSION = replace(ours, model=model)\n"
    )
    said = rosa("replay", drop, "--mission", "suave_extended", "--task", "pddl", code=1)
    assert "decided otherwise from" in said
    assert "which is another one" not in said
    monkeypatch.syspath_prepend(tmp_path)
    said = rosa("replay", drop, "--mission", "eager:MISSION", code=1)
    assert said.startswith(
        "recorded with the model suave_extended, decided with suave_extended, which is another one"
    )
    assert "0.4" in said.splitlines()[1]
    assert said.splitlines()[1].endswith(
        "is not in the recording"
    )  # in the words of the store, see kb.model
    said = rosa("replay", drop, "--mission", "uav", code=1)
    assert said.startswith(
        "recorded with the model suave_extended, decided with uav, which is another one"
    )


def test_folder_whose_file_is_cut_off_is_read_up_to_there(drop, tmp_path):
    folder = as_rosbag2(drop, tmp_path / "bag")
    whole, (file,) = read_bag(folder), folder.glob("*.mcap")
    rosa("record", "convert", folder, tmp_path / "small_chunks.mcap")
    data = (tmp_path / "small_chunks.mcap").read_bytes()
    file.write_bytes(data[: len(data) * 3 // 4])
    bag = read_bag(folder)
    assert "is cut off" in bag.cut
    assert len(bag.messages) > len(whole.messages) / 2
    assert bag.messages == whole.messages[: len(bag.messages)]
    assert "all before that is read" in rosa("replay", folder, "--mission", "suave_extended")


@pytest.mark.parametrize("storage", StoragePlugin)
@pytest.mark.parametrize("mode", [None, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_rosbag2_of_anybody_is_decided_alike(drop, tmp_path, storage, mode):
    if storage is StoragePlugin.MCAP and mode is CompressionMode.FILE:
        mode = None
    folder = as_rosbag2(drop, tmp_path / "bag", storage=storage, mode=mode)
    began = read_bag(drop).messages[0][
        "time"
    ]  # the time of somebody else's begins with its first message
    now, then = (
        decided(replay(folder, "suave_extended")),
        decided(replay(drop, "suave_extended"), began),
    )
    assert [name for name, _ in now] == ["inspect_pipeline", "recharge", "inspect_pipeline"]
    assert [name for name, _ in then] == [name for name, _ in now]
    assert [time for _, time in now] == pytest.approx([time for _, time in then], abs=0.11), (
        "but for a tick"
    )


def test_unknown_types_are_listed_and_not_fatal(drop, tmp_path):
    folder = as_rosbag2(drop, tmp_path / "bag", strange=True)
    assert "somebody_msgs/msg/Secret" in rosa("record", "info", folder)
    rosa("replay", folder, "--mission", "suave_extended")


def test_recording_without_a_mission_asks_for_one(drop, tmp_path):
    folder = as_rosbag2(drop, tmp_path / "bag")
    done = CliRunner().invoke(cli.app, ["replay", str(folder)])
    assert isinstance(done.exception, MissionError)
    assert "--mission" in str(done.exception)


def test_recording_of_ones_own_mission_says_how_to_name_it(tmp_path):
    (tmp_path / "own.jsonl").write_text(
        '{"run": {"mission": "greenhouse"}, "status": [], "time": 0.0}\n'
    )
    done = CliRunner().invoke(cli.app, ["replay", str(tmp_path / "own.jsonl")])
    assert isinstance(done.exception, MissionError)
    assert str(done.exception).endswith(
        "is of a mission 'greenhouse' of your own; name it with --mission module:NAME"
    )


def test_every_prefix_is_read_up_to_there_and_decided_alike(drop, tmp_path):
    whole, data, rng = read_bag(drop), drop.read_bytes(), random.Random(7)
    cut = tmp_path / "cut.mcap"
    for size in [*(rng.randrange(20_000, len(data)) for _ in range(12)), len(data) - 1]:
        cut.write_bytes(data[:size])
        bag = read_bag(cut)
        assert bag.cut
        assert bag.messages == whole.messages[: len(bag.messages)]
        assert bag.events == whole.events[: len(bag.events)]
        if bag.run:
            assert "decided as recorded" in rosa("replay", cut) or not bag.events


def test_file_that_was_never_completed_holds_every_message(drop, tmp_path):
    kb = KnowledgeBase(robot(), clock=lambda: 1.0)
    path = tmp_path / "killed.mcap"
    recorder = McapRecorder(path, kb)
    for value in range(100):
        kb.measure("energy", 0.5 + value / 1000)
    found = Bag()
    while len(found.events) < len(list(kb.log)):  # the thread that writes is at it
        (tmp_path / "copy.mcap").write_bytes(path.read_bytes())
        with suppress(MissionError):  # nothing of it is written yet
            found = read_bag(tmp_path / "copy.mcap")
    recorder.close()
    assert found.cut
    assert found.events == list(kb.log)
    rosa("record", "convert", tmp_path / "copy.mcap", tmp_path / "whole.mcap")
    assert read_bag(tmp_path / "whole.mcap").events == found.events
    assert not read_bag(tmp_path / "whole.mcap").cut


def robot():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    drive = model.function("drive")
    drive.design("wheels", [model.component("base")], priority=1)
    model.action("explore", requires=[drive], constraints=[energy >= 0.2])
    model.action("charge")
    return model


def test_own_robot_is_recorded_and_shown(tmp_path):
    now = [0.0]
    kb = KnowledgeBase(robot(), clock=lambda: now[0])
    root = first_feasible(
        "what to do", [ForAction(name, kb, name, Running(name)) for name in ("explore", "charge")]
    )
    runner = TreeRunner(root, clock=lambda: now[0])
    with McapRecorder(tmp_path / "rover.mcap", kb, runner.tree) as recorder:
        for time, energy in enumerate((0.9, 0.3, 0.1)):
            now[0] = float(time)
            message = measured(now[0], energy=energy)
            recorder.message(message)
            kb.receive(message)
            runner.tick()
    bag, page = read_bag(tmp_path / "rover.mcap"), read_page(tmp_path / "rover.mcap")
    assert [one["time"] for one in bag.messages] == [0.0, 1.0, 2.0]
    assert page.title == "rover"
    assert [value["action"] for value in page.last("action").values()]


def test_what_was_heard_is_converted_to_lines(drop, tmp_path):
    rosa("record", "convert", drop, tmp_path / "drop.jsonl")
    assert [one["time"] for one in read_recording(tmp_path / "drop.jsonl")][1:] == [
        one["time"] for one in read_bag(drop).messages
    ]
    done = CliRunner().invoke(cli.app, ["record", "convert", str(drop), str(tmp_path / "drop.bag")])
    assert "neither .mcap nor .jsonl" in str(done.exception)


def test_what_is_there_stays_until_what_is_converted_is_whole(drop, tmp_path):
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(drop.read_bytes())
    rosa("record", "convert", copy, copy)
    assert read_bag(copy) == read_bag(drop)
    kept, nonsense = copy.read_bytes(), tmp_path / "nonsense.mcap"
    nonsense.write_text("no recording at all\n")
    for source, target, said in (
        (nonsense, copy, "cannot read the recording"),
        (drop, tmp_path / "no" / "drop.mcap", "cannot write"),
        (drop, tmp_path / "no" / "drop.jsonl", "cannot write"),
    ):
        done = CliRunner().invoke(cli.app, ["record", "convert", str(source), str(target)])
        assert isinstance(done.exception, MissionError)
        assert said in str(done.exception)
    assert copy.read_bytes() == kept
    assert {one.name for one in tmp_path.iterdir()} == {"copy.mcap", "nonsense.mcap"}


def malformed(drop, folder):
    data = drop.read_bytes()
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "text.mcap").write_text("no recording at all\n")
    (folder / "magic.mcap").write_bytes(data[:8])
    (folder / "zeros.mcap").write_bytes(data[:8] + bytes(5000))
    (folder / "long.mcap").write_bytes(data[:8] + b"\x01" + b"\xff" * 8)
    (folder / "noise.mcap").write_bytes(data[:8] + random.Random(3).randbytes(5000))
    (folder / "empty.db3").write_bytes(b"")
    (folder / "text.db3").write_text("no database")
    (folder / "heard.jsonl").write_text('{"time": 0.0, "status": []}')
    sqlite3.connect(folder / "other.db3").execute("create table cakes (name)").connection.close()
    (folder / "nothing").mkdir()
    (folder / "wrong").mkdir()
    (folder / "wrong" / "metadata.yaml").write_text("rosbag2_bagfile_information: [1, 2")
    (folder / "missing").mkdir()
    (folder / "missing" / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 5}")
    return sorted(folder.iterdir())


def test_malformed_recordings_get_a_clear_word(drop, tmp_path):
    paths = malformed(drop, tmp_path)
    assert len(paths) >= 10
    for path in [*paths, tmp_path / "nowhere.mcap"]:
        with pytest.raises(MissionError) as error:
            read_bag(path)
        assert path.name in str(error.value)
        assert "\n" not in str(error.value)
        assert ("holds what was heard only, for `rosa replay`" in str(error.value)) is (
            path.suffix == ".jsonl"
        )


def test_flipped_bytes_lose_no_more_than_what_follows(drop, tmp_path):
    whole, rng = read_bag(drop), random.Random(5)
    for _ in range(20):
        data = bytearray(drop.read_bytes())
        data[rng.randrange(100, len(data))] ^= 1 << rng.randrange(8)
        (tmp_path / "flipped.mcap").write_bytes(data)
        try:
            bag = read_bag(tmp_path / "flipped.mcap")
        except MissionError:
            continue
        if not bag.cut and not bag.problems:
            assert bag.events == whole.events


def test_recording_of_another_version_is_refused(tmp_path, monkeypatch):
    kb = KnowledgeBase(robot(), clock=lambda: 0.0)
    McapRecorder(tmp_path / "new.mcap", kb, run={"rosa": 99}).close()
    with pytest.raises(MissionError, match="version 99; this program reads version 1"):
        read_bag(tmp_path / "new.mcap")


def test_file_that_is_there_stays_as_it_is_where_the_library_is_missing(tmp_path, monkeypatch):
    kept = tmp_path / "kept.mcap"
    kept.write_text("a recording")
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(MissionError, match=r"rosa-taca\[mcap\]"):
        McapFile(kept)
    assert kept.read_text() == "a recording"


def test_file_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").touch()
    places = (
        tmp_path / "no" / "folder.mcap",
        tmp_path,
        tmp_path / "file" / "a.mcap",
        "/dev/null",
        "a\0b",
        "a" * 300,
    )
    for place in places:
        with pytest.raises(MissionError, match="cannot write"):
            McapRecorder(place, KnowledgeBase(robot(), clock=lambda: 0.0))


def test_recording_without_room_is_told_when_it_ends_and_holds_what_came_before(tmp_path):
    kb, before = (
        KnowledgeBase(robot(), clock=lambda: 0.0),
        resource.getrlimit(resource.RLIMIT_FSIZE),
    )
    recorder = McapRecorder(tmp_path / "full.mcap", kb)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        for number in range(500):
            kb.measure("energy", number / 500)
        with pytest.raises(MissionError, match=r"cannot write .*full.mcap: File too large"):
            recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(read_bag(tmp_path / "full.mcap").events) > 10


def test_disk_that_hangs_ends_the_recording_and_holds_up_nobody(tmp_path, monkeypatch):
    answers, add = Event(), mcap._Records.add
    monkeypatch.setattr(mcap._Records, "add", lambda *given: answers.wait(60) and add(*given))
    monkeypatch.setattr(mcap, "WAITING", 100)
    monkeypatch.setattr(mcap, "PATIENCE_S", 0.05)
    file = McapFile(tmp_path / "hung.mcap")
    for number in range(1000):
        file.write("/number", ros.FLOAT, float(number), dict, {"data": float(number)})
        while number == 0 and not file._queue.empty():
            time.sleep(0.001)
    assert file._queue.qsize() == 100
    with pytest.raises(
        MissionError,
        match=r"cannot write .*hung.mcap: the disk does not keep up, 100 messages wait",
    ):
        file.close()
    answers.set()  # what was being written when the recording ended is whole, and nothing comes after it
    with pytest.raises(MissionError, match="does not keep up"):
        file.close()
    assert read_bag(tmp_path / "hung.mcap").topics == {"/number": (ros.FLOAT, 1)}


def test_disk_that_hangs_at_the_end_is_told(tmp_path, monkeypatch):
    answers, add = Event(), mcap._Records.add
    monkeypatch.setattr(mcap._Records, "add", lambda *given: answers.wait(60) and add(*given))
    monkeypatch.setattr(mcap, "PATIENCE_S", 0.05)
    file = McapFile(tmp_path / "hung.mcap")
    file.write("/number", ros.FLOAT, 1.0, dict, {"data": 1.0})
    with pytest.raises(MissionError, match="the disk does not answer"):
        file.close()
    answers.set()
    file.close()  # it answers again, and nothing is lost
    assert read_bag(tmp_path / "hung.mcap").topics == {"/number": (ros.FLOAT, 1)}


def test_recording_that_does_not_say_how_it_was_run_is_refused(tmp_path):
    with McapFile(tmp_path / "torn.mcap") as file:
        file.write(RUN, ros.STRING, 0.0, ros.json_text, {"rosa": VERSION, "model": "rover"})
    with pytest.raises(MissionError, match="lacks elements, page"):
        read_page(tmp_path / "torn.mcap")
