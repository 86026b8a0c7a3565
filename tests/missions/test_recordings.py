"""Recordings as MCAP: what others read in them, what is decided from them again, unsound files."""

import json
import random
import resource
from contextlib import suppress
from pathlib import Path
from threading import Event
from xml.etree import ElementTree

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from running import read_report
from typer.testing import CliRunner

from kb import KnowledgeBase, Model
from missions import cli
from missions.baselines import open_run
from missions.engine.mission import MissionError, find_mission
from missions.engine.recording import header
from missions.engine.runner import Listener
from missions.testing.decisions import replay
from missions.views.recorder import RunRecorder
from missions.wires import mcap, ros
from missions.wires.mcap import Bag, McapFile, McapRecorder, messages, read_bag, read_page

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")
TOPICS = {"/attributes/battery_level", "/attributes/water_visibility", "/behavior_tree"} | {
    "/behavior_tree_log",
    "/diagnostics",
    "/pose",
    "/rosa/events",
    "/rosa/log",
    "/rosa/rows",
    "/rosa/run",
}
ARRAY = {
    "status": [
        {
            "level": 1,
            "name": "gps: fix",
            "message": "2D",
            "hardware_id": "b1",
            "values": [{"key": "HDOP", "value": "0.5"}],
        }
    ]
}


def rosa(*arguments, code=0):
    done = CliRunner().invoke(cli.app, list(map(str, arguments)))
    assert done.exit_code == code, f"{done.output}\n{done.exception!r}"
    return done.output


def refused(*arguments):
    error = CliRunner().invoke(cli.app, list(map(str, arguments))).exception
    assert isinstance(error, MissionError)
    return str(error)


@pytest.fixture(scope="module")
def drop(tmp_path_factory):
    """The battery drop, recorded while it ran."""
    path = tmp_path_factory.mktemp("recorded") / "drop.mcap"
    rosa("run", "suave_extended", "--no-progress", "--record", path, "--set", "duration_s=200")
    return path


def robot_kb():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    drive = model.function("drive")
    drive.design("wheels", [model.component("base")], priority=1)
    model.action("explore", requires=[drive], constraints=[energy >= 0.2])
    model.action("charge")
    return KnowledgeBase(model, clock=lambda: 0.0)


def test_recorder_takes_diagnostics_in_every_form(tmp_path):
    array = ros.diagnostics(0.0, ARRAY)
    data = ros.types().encode(ros.DIAGNOSTICS, array)
    thing = ros.types().to_object(ros.DIAGNOSTICS, array)
    with McapRecorder(tmp_path / "x.mcap", robot_kb()) as recorder:
        for message in (array, data, thing, {"time": 7.0, **ARRAY}):
            recorder.message(message)
        recorder.message(b"no message")
        recorder.message({"status": [{"name": "no values"}]})
    assert recorder.refused.total() == 2
    messages = read_bag(tmp_path / "x.mcap").messages
    assert [message["time"] for message in messages] == [0.0, 0.0, 0.0, 7.0]
    status = {**ARRAY["status"][0], "values": {"HDOP": "0.5"}}
    assert [message["status"] for message in messages] == [[status]] * 4


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([ARRAY], "nothing in its 1 message of diagnostics says anything to suave_extended"),
        ([], "has no message of diagnostics"),
    ],
)
def test_replay_that_heard_nothing_exits_1(tmp_path, messages, words):
    path = tmp_path / "silent.mcap"
    with McapRecorder(path, robot_kb()) as recorder:
        for message in messages:
            recorder.message(message)
    assert words in rosa("replay", path, "--mission", "suave_extended", code=1)


# ------------------------------------------------------------ what others read


def test_recording_is_read_by_others(drop, tmp_path):
    with drop.open("rb") as file:
        summary = make_reader(file).get_summary()
    channels = summary.channels.values()
    assert {(channel.topic, channel.message_encoding) for channel in channels} == {
        (topic, "cdr") for topic in TOPICS
    }
    assert len(summary.chunk_indexes) > 1, "what tools seek in"
    with AnyReader([drop]) as reader:
        logged = [
            reader.deserialize(data, connection.msgtype).msg
            for connection, _, data in reader.messages()
            if connection.topic == "/rosa/log"
        ]
    assert any(text.startswith("inspect_pipeline is requested") for text in logged)


def test_tree_log_names_nodes_of_the_recorded_tree(drop):
    with drop.open("rb") as file:
        topics = ["/behavior_tree", "/behavior_tree_log"]
        (tree, *log) = [m.data for _, _, m in make_reader(file).iter_messages(topics=topics)]
    xml = ros.types().decode(ros.STRING, tree)["data"]
    changes = [c for data in log for c in ros.types().decode(ros.TREE_LOG, data)["event_log"]]
    assert {change["current_status"] for change in changes} >= {"RUNNING", "SUCCESS"}
    names = {node.get("_uid"): node.get("name") for node in ElementTree.fromstring(xml).iter()}
    for change in changes:
        assert names[str(change["uid"])] == change["node_name"]


def as_rosbag2(drop, folder, storage=StoragePlugin.MCAP, mode=None):
    """Write the diagnostics as anybody's rosbag2, beside a message of an unknown type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    secret = "somebody_msgs/msg/Secret"
    store.register(get_types_from_msg("uint8 left", secret))
    writer = Writer(folder, version=8, storage_plugin=storage)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        diagnostics = writer.add_connection("/diagnostics", ros.DIAGNOSTICS, typestore=store)
        for message in read_bag(drop).messages:
            data = ros.types().encode(ros.DIAGNOSTICS, ros.diagnostics(message["time"], message))
            writer.write(diagnostics, 10**18 + ros.nanoseconds(message["time"]), data)
        topic = writer.add_connection("/secret", secret, typestore=store)
        writer.write(topic, 10**18, store.serialize_cdr(store.types[secret](7), secret))
    return folder


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (StoragePlugin.MCAP, None),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
    ],
)
def test_rosbag2_of_anybody_is_decided_alike(drop, tmp_path, storage, mode):
    folder = as_rosbag2(drop, tmp_path / "bag", storage, mode)
    began = read_bag(drop).messages[0]["time"]  # that of anybody begins with its first message
    now = replay(folder, "suave_extended").actions[1:]
    then = replay(drop, "suave_extended").actions[1:]
    assert [name for name, *_ in now] == ["inspect_pipeline", "recharge", "inspect_pipeline"]
    assert [name for name, *_ in then] == [name for name, *_ in now]
    times = [start - began for _, start, *_ in then]
    assert [start for _, start, *_ in now] == pytest.approx(times, abs=0.11), "but for a tick"


# ------------------------------------------------------------ what is decided again


@pytest.mark.parametrize(
    ("mission", "task"), [("suave_extended", "pddl"), ("agv", "bt"), ("uav", "pddl")]
)
def test_replay_decides_as_recorded(mission, task, tmp_path):
    path = tmp_path / "run.mcap"
    options = ("--no-progress", "--seed", 3, "--set", "planning_delay_s=0.3", "--record", path)
    rosa("run", mission, "--task", task, *options)
    assert "decided as recorded" in rosa("replay", path)


def test_report_of_a_recording_is_that_of_the_run(tmp_path):
    path = tmp_path / "run.mcap"
    page = tmp_path / "run.html"
    options = ("--no-progress", "--set", "duration_s=60", "--record", path, "--report", page)
    rosa("run", "suave", *options, code=1)
    run = read_report(page)
    recorded = read_page(path)
    assert recorded.header == run.header
    rows = [tuple(row) for row in json.loads(json.dumps(recorded.rows)) if row[1] != "whatif"]
    assert sorted(map(repr, rows)) == sorted(repr(row) for row in run.rows if row[1] != "whatif")


class Stop(Listener):
    def tick(self, run):
        if run.world.now > 20.0:
            raise KeyboardInterrupt


def test_run_stopped_by_hand_is_decided_as_recorded(tmp_path):
    path = tmp_path / "run.mcap"
    run = open_run(find_mission("suave"), seed=0, settings={})
    page = RunRecorder(run, 0, {}).recorder
    about = header(run, 0)["run"]
    with McapRecorder(path, run.kb, run.tree, page=page, run=about) as recorder:
        run.listen(recorder, Stop())
        with pytest.raises(KeyboardInterrupt):
            run.run()
    assert read_bag(path).events[-1].verb == "cancel_action"
    assert "decided as recorded" in rosa("replay", path)


OTHER = """
from dataclasses import replace
from missions.suave_extended import MISSION as ours
def model():
    model = ours.model()
    model.actions['inspect_pipeline'].constrain(model.attributes['battery_level'] >= 0.4)
    return model
MISSION = replace(ours, model=model)
"""


def test_replay_says_from_when_it_decides_otherwise(drop, tmp_path, monkeypatch):
    (tmp_path / "eager.py").write_text(OTHER)
    monkeypatch.syspath_prepend(tmp_path)
    text = rosa("replay", drop, "--mission", "suave_extended", "--task", "pddl", code=1)
    assert "decided otherwise from" in text
    other = "it is decided with another model than the recorded one"
    assert other not in text
    assert other in rosa("replay", drop, "--mission", "eager:MISSION", code=1)


def test_recording_of_an_own_mission_says_how_to_name_it(tmp_path):
    path = tmp_path / "own.jsonl"
    path.write_text('{"run": {"mission": "greenhouse"}, "status": [], "time": 0.0}\n')
    text = "is of a mission 'greenhouse' of your own; name it with --mission module:NAME"
    assert refused("replay", path).endswith(text)


# ------------------------------------------------------------ files that are not sound


def test_prefix_is_read_up_to_there_and_decided_alike(drop, tmp_path):
    whole = read_bag(drop)
    data = drop.read_bytes()
    rng = random.Random(7)
    cut = tmp_path / "cut.mcap"
    for size in [*(rng.randrange(20_000, len(data)) for _ in range(4)), len(data) - 1]:
        cut.write_bytes(data[:size])
        bag = read_bag(cut)
        assert bag.cut
        assert bag.messages == whole.messages[: len(bag.messages)]
        assert bag.events == whole.events[: len(bag.events)]
    assert "decided as recorded" in rosa("replay", cut)


def test_file_that_was_never_completed_holds_every_message(tmp_path):
    kb = robot_kb()
    path = tmp_path / "killed.mcap"
    copy = tmp_path / "copy.mcap"
    recorder = McapRecorder(path, kb)
    for value in range(100):
        kb.measure("energy", 0.5 + value / 1000)
    bag = Bag()
    while len(bag.events) < len(list(kb.log)):  # the thread that writes is at it
        copy.write_bytes(path.read_bytes())
        with suppress(MissionError):  # nothing of it is written yet
            bag = read_bag(copy)
    recorder.close()
    assert bag.cut
    assert bag.events == list(kb.log)


def test_malformed_recording_gets_a_clear_word(drop, tmp_path):
    contents = {
        "empty.mcap": b"",
        "text.mcap": b"no recording at all\n",
        "noise.mcap": drop.read_bytes()[:8] + random.Random(3).randbytes(5000),
        "text.db3": b"no database",
        "heard.jsonl": b'{"time": 0.0, "status": []}',
        "wrong/metadata.yaml": b"rosbag2_bagfile_information: [1, 2",
    }
    for name, content in contents.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    for path in [*tmp_path.iterdir(), tmp_path / "nowhere.mcap"]:
        with pytest.raises(MissionError, match=rf"^[^\n]*{path.name}[^\n]*$"):
            read_bag(path)


def test_recording_of_another_version_is_refused(tmp_path):
    McapRecorder(tmp_path / "new.mcap", robot_kb(), run={"rosa": 99}).close()
    with pytest.raises(MissionError, match="version 99; this program reads version 1"):
        read_bag(tmp_path / "new.mcap")


# ------------------------------------------------------------ what cannot be written


@pytest.mark.parametrize("place", ["no/folder.mcap", ".", "a\0b"])
def test_file_that_cannot_be_written_is_told(tmp_path, place):
    with pytest.raises(MissionError, match="cannot write"):
        McapFile(f"{tmp_path}/{place}")


def test_recording_without_room_holds_what_came_before(tmp_path):
    kb = robot_kb()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = McapRecorder(tmp_path / "full.mcap", kb)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        for number in range(500):
            kb.measure("energy", number / 500)
        with pytest.raises(MissionError, match=r"cannot write .*full.mcap: File too large"):
            recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert len(read_bag(tmp_path / "full.mcap").events) > 10


def test_disk_that_hangs_holds_up_nobody(tmp_path, monkeypatch):
    answers = Event()
    add = mcap._Records.add
    monkeypatch.setattr(mcap._Records, "add", lambda *given: answers.wait(60) and add(*given))
    monkeypatch.setattr(mcap, "PATIENCE_S", 0.05)
    file = McapFile(tmp_path / "hung.mcap")
    for number in range(1000):
        file.write("/number", ros.FLOAT, float(number), dict, {"data": float(number)})
    with pytest.raises(MissionError, match=r"cannot write .*hung.mcap: the disk does not answer"):
        file.close()
    answers.set()
    file._thread.join()
    assert len(list(messages(tmp_path / "hung.mcap", Bag()))) == 1000
