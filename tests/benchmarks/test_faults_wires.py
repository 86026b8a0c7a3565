"""Wires cut at random, nonsense without end, assistants that mean ill, recordings cut anywhere.

And what wires cost.

`CUTS` says how often a connection is cut, `NONSENSE` how many messages are none, `HOSTILE` how many
requests mean ill, `PREFIXES` at how many places a recording is cut.
"""

import gc
import json
import os
import random
import sys
import time
import tracemalloc
from pathlib import Path

import pytest
from figures import table

sys.path.append(
    str(Path(__file__).parents[1] / "missions")
)  # what is cut and asked is that of the tests there

from cut_wires import requests_through_cuts
from ros_rig import rig, until
from test_assistant import asked
from test_bridge import NONSENSE as SPECIMENS
from test_bridge import diagnose, status
from test_recordings import rosa
from typer.testing import CliRunner

from kb import KnowledgeBase
from missions import cli
from missions.suave_extended import MISSION
from missions.wires import ros
from missions.wires.mcap import read_bag

pytestmark = pytest.mark.benchmark(group="faults")

CUTS, NONSENSE, HOSTILE, PREFIXES = (
    int(os.environ.get(name, most))
    for name, most in (
        ("CUTS", 100),
        ("NONSENSE", 100_000),
        ("HOSTILE", 10_000),
        ("PREFIXES", 1_000),
    )
)


@pytest.fixture(scope="module")
def rows(tables):
    found = []
    tables["faults of wires"] = lambda: table("Faults of wires", ("what", "tried", "figure"), found)
    return found


def test_connections_are_cut_at_random(rows):
    cuts = [requests_through_cuts(seed, cuts=10) for seed in range(CUTS // 10)]
    lost = sum(cut.lost for cut in cuts)
    doubled = sum(cut.doubled for cut in cuts)
    rows.append(
        (
            "connection cut",
            CUTS,
            f"{sum(cut.acknowledged for cut in cuts)} acknowledged, {lost} lost, {doubled} doubled",
        )
    )
    assert (lost, doubled) == (0, 0)
    assert all(cut.acknowledged > 20 for cut in cuts)


def test_nonsense_is_counted_and_memory_is_flat(rows):
    rng = random.Random(1)
    tracemalloc.start()
    try:
        with rig("rosbridge") as robot:
            client = next(client for client in robot.host.clients if client.topics)
            refused = [0]
            held = []
            for _ in range(5):
                for number in range(NONSENSE // 10):
                    text = rng.choice(SPECIMENS)
                    client.websocket.send(text if number % 2 else json.dumps({"op": rng.random()}))
                    robot.measure(f"much {rng.random()}")
                seen = refused[0] + NONSENSE // 10
                until(lambda seen=seen: robot.node.refused.total() >= seen * 0.5)
                refused[0] = robot.node.refused.total() + robot.bridge.refused.total()
                gc.collect()
                held.append(tracemalloc.get_traced_memory()[0])
            until(
                lambda: robot.kb.attributes["energy"].value == 0.7, turn=lambda: robot.measure(0.7)
            )
            figure = f"{refused[0]} refused, memory {held[1] / 1e6:.2f} to {held[-1] / 1e6:.2f} MB"
            rows.append(("nonsense", NONSENSE, figure))
            assert len(robot.node.refused) + len(robot.bridge.refused) < 300
            assert held[-1] < held[1] + 2e6
    finally:
        tracemalloc.stop()


def test_hostile_requests_of_assistants(rows):
    kb = KnowledgeBase(MISSION.model(), clock=lambda: 1.0)
    kb.measure("water_visibility", 3.0)
    kb.measure("battery_level", 0.2)
    rng = random.Random(2)
    values = [
        None,
        3,
        [],
        {},
        "inspect_pipeline",
        ["inspect_pipeline"],
        {"name": "inspect_pipeline"},
        "x" * 5000,
    ]
    keys = ["action", "element", "preference", "measured", "x"]
    before = len(list(kb.log))
    calls = []
    for _ in range(HOSTILE):
        tool = rng.choice(["request_action", "cancel_action", "what_if", "why", "plan"])
        given = {key: rng.choice(values) for key in rng.sample(keys, rng.randint(0, 3))}
        calls.append(
            (tool, given | {"action": "inspect_pipeline"} if rng.random() < 0.5 else given)
        )
    _, answers = asked(kb, calls, allow_actions=True)
    rows.append(("hostile requests", len(answers), f"{len(kb.required_actions)} got through"))
    assert len(answers) == HOSTILE
    assert not kb.required_actions
    assert not [one for one in list(kb.log)[before:] if one.verb == "request_action"]


def test_every_prefix_of_a_recording_replays(rows, tmp_path):
    path = tmp_path / "drop.mcap"
    cut = tmp_path / "cut.mcap"
    rng = random.Random(3)
    rosa("run", "suave_extended", "--no-progress", "--record", path, "--set", "duration_s=200")
    whole = read_bag(path)
    data = path.read_bytes()
    replayed = 0
    for _ in range(PREFIXES):
        cut.write_bytes(data[: rng.randrange(20_000, len(data))])
        bag = read_bag(cut)
        assert bag.cut
        assert bag.messages == whole.messages[: len(bag.messages)]
        assert bag.events == whole.events[: len(bag.events)]
        if bag.events:
            assert "decided as recorded" in rosa("replay", cut)
            replayed += 1
    rows.append(
        ("recording cut", PREFIXES, f"all read up to there, {replayed} decided again, alike")
    )


def test_a_thousand_diagnostics_a_second(rows):
    seconds = 10
    with rig("rosbridge") as robot:
        diagnose(robot, status("robot", 0, "QA status", energy=0.5))
        array = {"header": {}, "status": [status("robot", 0, "QA status", energy=0.5)]}
        before = robot.bridge.heard
        used = time.process_time()
        began = time.monotonic()
        for number in range(1000 * seconds):
            robot.host.publish("/diagnostics", "", array)
            time.sleep(max(0.0, began + number / 1000 - time.monotonic()))
        until(lambda: robot.bridge.heard >= before + 1000 * seconds)
        share = (time.process_time() - used) / (time.monotonic() - began)
        figure = f"{share:.0%} of a core, sender and server included"
        rows.append(("1,000 diagnostics/s", 1000 * seconds, figure))


def test_an_hour_of_diagnostics_is_decided_again(rows, tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer

    kept = ros.types()
    folder = tmp_path / "hour"
    with Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/diagnostics", ros.DIAGNOSTICS, typestore=kept.store)
        for number in range(360_000):
            values = {"battery_level": f"{1 - number / 400_000:.4f}"} | (
                {} if number % 100 else {"water_visibility": "3"}
            )
            heard = ros.diagnostics(
                number / 100, {"status": [{"message": "QA status", "values": values}]}
            )
            writer.write(topic, 10**18 + number * 10**7, kept.encode(ros.DIAGNOSTICS, heard))
    used = time.process_time()
    done = CliRunner().invoke(cli.app, ["replay", str(folder), "--mission", "suave_extended"])
    rows.append(
        ("one hour replayed", 360_000, f"{time.process_time() - used:.1f} s of processor time")
    )
    assert done.exit_code == 0
    assert "heard" not in done.output
