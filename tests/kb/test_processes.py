"""Components as real processes: started, ended, crashed, with parameters.

ROS nodes by a stand-in of `ros2`.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from kb import (
    ConfigurationManager,
    KnowledgeBase,
    Model,
    ProcessComponents,
    Program,
    StagedExecutor,
    Status,
    UnknownName,
)
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.processes import ros_node, ros_node_programs

PATIENCE_S = 120.0
SLEEP = "import time; time.sleep(600)"
STUBBORN = "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"
PARENT = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[2]])
with open(sys.argv[1] + ".part", "w") as file:
    file.write(str(child.pid))
os.rename(sys.argv[1] + ".part", sys.argv[1])
time.sleep(600)
"""
RECORDER = """
import json, os, sys, time
with open(sys.argv[1] + ".part", "w") as file:
    json.dump(sys.argv[2:], file)
os.rename(sys.argv[1] + ".part", sys.argv[1])
time.sleep(600)
"""


def python(code, *arguments, **options):
    return Program([sys.executable, "-c", code, *map(str, arguments)], **options)


def is_alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def wait_for(condition):
    give_up = time.monotonic() + PATIENCE_S
    while not (result := condition()):
        assert time.monotonic() < give_up, "it never came"
        time.sleep(0.01)
    return result


def rover():
    model = Model("rover")
    camera = model.component("camera", kind="process", stops_to_configure=True)
    light = model.environmental_attribute("light")
    camera.configuration("day", {"rate": 5, "label": "sun"}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"rate": 1, "label": "moon"}, priority=2)
    lidar = model.component("lidar", kind="process", package="drivers", executable="lidar_node")
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    see.design("by lidar", [lidar], priority=2)
    model.action("explore", requires=[see])
    return model


class Robot:
    """A rover whose components are processes, and its manager."""

    def __init__(self, **programs):
        self.kb = KnowledgeBase(rover(), clock=time.monotonic)
        self.processes = ProcessComponents({"lidar": python(SLEEP), **programs})
        executor = StagedExecutor(self.processes, back_off=0.01)
        self.manager = ConfigurationManager(self.kb, self.processes, executor=executor)

    def update_until(self, condition):
        wait_for(lambda: (self.manager.update(), condition())[1])

    def is_solved(self):
        return self.kb.actions["explore"].status is Status.SOLVED and self.kb.pending_plan is None

    def explore(self):
        self.kb.request_action("explore")
        self.update_until(self.is_solved)
        return self.processes._processes["camera"].popen.pid


def test_required_component_runs_until_nothing_requires_it():
    robot = Robot(camera=python(SLEEP))
    with robot.processes:
        pid = robot.explore()
        assert os.getpgid(pid) == pid != os.getpgid(0)
        robot.kb.cancel_action("explore")
        robot.update_until(lambda: robot.kb.plans[-1].end and robot.kb.pending_plan is None)
        assert not Path(f"/proc/{pid}").exists()
        assert not robot.kb.components["camera"].is_active
        assert robot.kb.components["camera"].status is Status.FEASIBLE


@pytest.mark.parametrize(
    ("end", "how"),
    [
        (signal.SIGSEGV, "by signal 11 (Segmentation fault)"),
        (signal.SIGTERM, "by signal 15 (Terminated)"),
        (signal.SIGRTMIN + 1, "by signal 35"),
    ],
)
def test_process_that_ends_by_itself_has_failed(end, how):
    robot = Robot(camera=python(SLEEP))
    with robot.processes:
        os.kill(robot.explore(), end)
        robot.update_until(lambda: robot.kb.components["camera"].status is Status.FAILURE)
        assert f"the process of camera ended by itself {how}" in robot.kb.why("camera")
        robot.update_until(robot.is_solved)
        assert robot.kb.components["lidar"].is_active


@pytest.mark.parametrize("status", [0, 3])
def test_program_that_does_not_stay_gives_way(status):
    robot = Robot(camera=python(f"raise SystemExit({status})"))
    with robot.processes:
        robot.kb.request_action("explore")
        robot.update_until(lambda: robot.kb.components["lidar"].is_active and robot.is_solved())
        assert f"with exit status {status}" in robot.kb.why("camera")


def test_parameters_are_in_arguments_and_no_shell_reads_them(tmp_path):
    note = tmp_path / "note"
    arguments = ["--rate={rate}", "{label}", "$(exit 1); * > x"]
    program = python(RECORDER, note, *arguments)
    robot = Robot(camera=program)
    with robot.processes:
        robot.kb.measure("light", 0.9)
        robot.explore()
        wait_for(note.exists)
        assert json.loads(note.read_text()) == ["--rate=5", "sun", "$(exit 1); * > x"]
        note.unlink()
        robot.kb.measure("light", 0.1)
        robot.update_until(lambda: note.exists() and robot.is_solved())
        assert json.loads(note.read_text())[:2] == ["--rate=1", "moon"]


@pytest.mark.parametrize(("code", "grace_s"), [(SLEEP, PATIENCE_S), (STUBBORN, 0.1)])
def test_whole_group_ends_and_is_killed_after_its_grace(tmp_path, code, grace_s):
    note = tmp_path / "child"
    with ProcessComponents({"camera": python(PARENT, note, code, grace_s=grace_s)}) as processes:
        processes.activate("camera")
        wait_for(note.exists)
        child = int(note.read_text())
        assert processes.is_active("camera")
        wait_for(processes.deactivate("camera").done)
        assert not processes.is_active("camera")
        wait_for(lambda: not is_alive(child))


def test_crash_of_the_leader_ends_its_group(tmp_path):
    note = tmp_path / "child"
    robot = Robot(camera=python(PARENT, note, STUBBORN))
    with robot.processes:
        pid = robot.explore()
        wait_for(note.exists)
        os.kill(pid, signal.SIGKILL)
        robot.update_until(lambda: robot.kb.components["camera"].status is Status.FAILURE)
        wait_for(lambda: not is_alive(int(note.read_text())))


def test_commands_given_twice_change_nothing():
    with ProcessComponents({"camera": python(SLEEP)}) as processes:
        assert processes.deactivate("camera") is None
        processes.activate("camera")
        processes.activate("camera")
        assert processes.is_active("camera")
        for _ in range(2):
            wait_for(processes.deactivate("camera").done)
        processes.activate("camera")
        assert processes.is_active("camera")


def test_start_while_the_last_process_ends_is_refused(tmp_path):
    note = tmp_path / "child"
    with ProcessComponents({"camera": python(PARENT, note, STUBBORN, grace_s=0.1)}) as processes:
        processes.activate("camera")
        wait_for(note.exists)
        operation = processes.deactivate("camera")
        with pytest.raises(KnowledgeBaseError, match="still ending"):
            processes.activate("camera")
        wait_for(operation.done)
        processes.activate("camera")


def test_running_program_takes_parameters_by_its_function():
    calls = []
    programs = {"camera": python(SLEEP, configure=calls.append), "lidar": python(SLEEP)}
    with ProcessComponents(programs) as processes:
        for name in programs:
            processes.activate(name)
        processes.set_parameters("camera", {"rate": 2})
        assert calls == [{"rate": 2}]
        with pytest.raises(KnowledgeBaseError, match="stops_to_configure=True"):
            processes.set_parameters("lidar", {"rate": 2})


def test_ros_node_gets_its_parameters_by_ros2_run(tmp_path, monkeypatch):
    note = tmp_path / "note"
    ros2 = tmp_path / "ros2"
    ros2.write_text(f"#!{sys.executable}\n{RECORDER.replace('sys.argv[1]', repr(str(note)))}")
    ros2.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    program = ros_node("drivers", "camera_node")
    with ProcessComponents({"camera": program}) as processes:
        processes.set_parameters("camera", {"rate": 5.0, "on": True, "label": "a b", "x": [1, 2]})
        processes.activate("camera")
        arguments = json.loads(wait_for(note.exists) and note.read_text())
    ros = ["drivers", "camera_node", "--ros-args", "-p", "rate:=5.0"]
    assert arguments == [*ros, "-p", "on:=true", "-p", 'label:="a b"', "-p", "x:=[1, 2]"]


def test_ros_nodes_of_a_model_are_those_with_an_executable():
    kb = KnowledgeBase(rover())
    programs = ros_node_programs(kb.components.values())
    assert list(programs) == ["lidar"]
    assert programs["lidar"].command({}) == ["ros2", "run", "drivers", "lidar_node", "--ros-args"]


def test_close_ends_all():
    robot = Robot(camera=python(SLEEP))
    with robot.processes:
        pid = robot.explore()
    assert not is_alive(pid)
    robot.processes.close()


def test_close_that_is_interrupted_is_repeated_and_no_fork_ends_anything(monkeypatch):
    processes = ProcessComponents({"camera": python(STUBBORN, grace_s=0.1)})
    processes.activate("camera")
    pid = processes._processes["camera"].popen.pid
    monkeypatch.setattr(os, "getpid", lambda: 0)
    processes.close()
    assert is_alive(pid)
    monkeypatch.undo()
    monkeypatch.setattr(time, "sleep", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        processes.close()
    monkeypatch.undo()
    processes.close()
    assert not is_alive(pid)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: Program("camera --quiet"), "no shell takes them apart"),
        (lambda: Program([]), "begins with the executable"),
        (
            lambda: ProcessComponents({"camera": Program(["no such"])}),
            "'camera'.*no executable 'no such'",
        ),
    ],
)
def test_wrong_program_is_refused_with_what_to_write(make, reason):
    with pytest.raises(InvalidValue, match=reason):
        make()


def test_start_that_cannot_be_is_refused_with_why():
    with ProcessComponents({"lidar": python(SLEEP, "{rate}")}) as processes:
        with pytest.raises(UnknownName, match=r"parameter of '\{rate\}' 'rate'"):
            processes.activate("lidar")
        with pytest.raises(UnknownName, match="did you mean 'lidar'"):
            processes.activate("lidr")
