"""`rosa new` writes a robot that runs as it is.

As a mission of one's own it is run by every manager there is.
"""

import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest
from ros_rig import connected
from running import called

from kb import KnowledgeBase
from missions.baselines import Policy, open_run
from missions.engine.mission import Mission, MissionError, find_mission
from missions.engine.percepts import failed, measured
from missions.views.output import figure_in_words
from missions.wires.bridge import Bridge, BridgeSettings

NAMES = iter(f"robot_{number}" for number in range(100))


@pytest.fixture
def new(tmp_path, monkeypatch, capsys):
    """Return what has `rosa new` write a robot with some options and returns the name.

    It can be imported then.
    """
    monkeypatch.chdir(tmp_path)

    def write(*options):
        name = next(NAMES)
        code, out, err = called(capsys, monkeypatch, "new", name, *options)
        assert code == 0, err
        assert f"rosa run {name}:MISSION" in out
        monkeypatch.syspath_prepend(tmp_path / name)
        return name

    return write


def check(*command, folder):
    program, *arguments = command
    command = [str(Path(sys.executable).with_name(program)), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    "options", [["--task", "bt"], ["--task", "pddl"], ["--task", "both", "--ros2"]]
)
def test_new_robot_runs_and_is_clean_in_each_variant(new, options, tmp_path):
    name = new(*options)
    folder = tmp_path / name
    check("ruff", "check", ".", folder=folder)
    check("ruff", "format", "--check", ".", folder=folder)
    assert open_run(find_mission(f"{name}:MISSION")).run().success
    written = [path for kind in ("*.py", "*.md", "*.toml", "*.pddl") for path in folder.rglob(kind)]
    assert not [path for path in written if "#if" in path.read_text() or "#fi" in path.read_text()]
    changes = [path.name for path in written if "CHANGE" in path.read_text()]
    assert {"model.py", "world.py", "README.md"} < set(changes)
    for file in ("bridge.toml", "package.xml", "setup.py", f"launch/{name}.launch.py"):
        assert (folder / file).exists() is ("--ros2" in options)
    packed = tomllib.loads((folder / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert packed["packages"] == [
        name
    ]  # or campaigns/ beside it would make it two, which no pip installs
    assert packed["package-data"] == {name: ["*.pddl"]}


def test_new_robot_in_ros2_is_a_colcon_package(new, tmp_path):
    """What it installs is where ROS 2 looks for it, and its bridge.toml fits its model."""
    name = new("--ros2")
    folder = tmp_path / name
    pytest.importorskip("setuptools")
    build = "from setuptools.build_meta import build_wheel; build_wheel('wheels')"
    done = [sys.executable, "-W", "ignore", "-c", build]
    subprocess.run(done, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    (built,) = (folder / "wheels").glob("*.whl")
    share = f"{name}-0.1.0.data/data/share"
    assert {
        f"{share}/ament_index/resource_index/packages/{name}",
        f"{share}/{name}/package.xml",
        f"{share}/{name}/bridge.toml",
        f"{share}/{name}/launch/{name}.launch.py",
    } <= set(ZipFile(built).namelist())
    kb = KnowledgeBase(find_mission(f"{name}:MISSION").model())
    settings = BridgeSettings.load(folder / "bridge.toml")
    with connected("rosbridge") as (_, node):
        Bridge(kb, node, settings)


def test_new_robot_passes_its_own_tests(new, tmp_path):
    """Its types are checked with ours, in tests/house."""
    check(
        "pytest",
        "-q",
        "-p",
        "no:randomly",
        "-p",
        "no:xdist",
        folder=tmp_path / new("--task", "both"),
    )


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("kb", [], "there is something named kb already"),
        ("my-robot", [], "'my-robot' cannot be one"),
        ("fine", ["--task", "htn"], "--task is 'htn'; there are bt, pddl and both"),
    ],
)
def test_robot_that_cannot_be_written_is_refused_and_nothing_is(
    name, options, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    code, _, err = called(capsys, monkeypatch, "new", name, *options)
    assert code == 2
    assert message in " ".join(err.split())
    assert not list(tmp_path.iterdir())


def ended(mission, manager, **settings):
    run = open_run(mission, manager=manager, settings=settings)
    return run.run().outcome, run.results()["explored_m"], len(run.adaptations)


def test_other_managers_run_a_new_mission(new):
    mission = find_mission(f"{new('--task', 'both')}:MISSION")
    assert ended(mission, "ours")[0] == "explored_all"
    outcome, explored_m, adaptations = ended(mission, "none")
    assert (outcome, adaptations) == ("aborted", 0)
    assert (
        explored_m < 25
    )  # by day's exposure it sees no further, and nobody looks after its energy
    outcome, explored_m, adaptations = ended(mission, "fixed")
    assert (outcome, adaptations > 0) == ("aborted", True)
    assert explored_m < 25
    often = open_run(mission, manager="random", settings={"period": "2"})
    often.run()
    chosen = [plan.parameters for plan in often.kb.plans if plan.parameters]
    assert len(chosen) > 3
    assert open_run(mission, manager="fixed", task="pddl").task == "pddl"


class NightOwl(Policy):
    """Takes what has the lowest priority."""

    def pick(self, kb, possible, selected):
        return possible[-1] if selected is None and possible else None


def test_manager_of_ones_own_chooses_in_any_mission(new):
    run = open_run(find_mission(f"{new()}:MISSION"), manager=NightOwl)
    assert run.run().success
    assert {name for plan in run.kb.plans for name in plan.parameters} == {"night"}


def test_all_stays_feasible_where_nothing_adapts(new):
    run = open_run(find_mission(f"{new()}:MISSION"), manager="none")
    for message in (measured(0.0, energy=0.0), failed(0.0, "camera_node")):
        run.hear(message)
    assert run.kb.is_feasible("explore")


@pytest.mark.parametrize(
    ("mission", "manager", "message"),
    [
        (
            "uav",
            "rosa",
            "there are ours, none, random, fixed in uav; one of your own is given as package:Class",
        ),
        ("uav", "bt", "unknown manager 'bt'; there are ours"),
        ("agv", "none", "the task layer of mission agv selects configurations; run it under ours"),
        (
            "uav",
            "missions.baselines.modes:NoManager",
            "make it a subclass of missions.baselines.Policy",
        ),
    ],
)
def test_manager_that_does_not_go_with_a_mission_is_refused(mission, manager, message):
    with pytest.raises(MissionError) as refusal:
        open_run(find_mission(mission), manager=manager)
    assert message in str(refusal.value)


def test_units_are_those_of_attributes_and_of_endings(new):
    model = find_mission(f"{new()}:MISSION").model()
    model.quality_attribute("tank_level", unit="l")
    model.quality_attribute("time_left_s", unit="min")
    shown = [
        figure_in_words(name, 4.5, model)[:2]
        for name in ("battery_left", "tank_level", "time_left_s", "used_l")
    ]
    assert shown == [
        ("battery left", ""),
        ("tank level", "l"),
        ("time left s", "min"),
        ("used", "l"),
    ]
    assert figure_in_words("mean_speed_m_s", 0.25, model) == ("mean speed", "m/s", "0.25")
    assert figure_in_words("hits_on_wall", 3.0, model) == ("hits on wall", "", "3")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tree": "tree"}, "tree of mission NAME is called with (kb, percepts): 'tree' is not a"),
        (
            {"tree": lambda kb: None},
            "tree of mission NAME is called with (kb, percepts): too many",
        ),
    ],
)
def test_mission_with_a_wrong_field_is_refused_in_a_sentence(new, changes, message):
    name = new()
    with pytest.raises(MissionError) as refusal:
        replace(find_mission(f"{name}:MISSION"), **changes)
    assert str(refusal.value).startswith(message.replace("NAME", name))


def test_mission_that_cannot_be_made_is_refused_with_the_line(tmp_path, monkeypatch):
    (tmp_path / "slip_of_mine.py").write_text(
        "from missions.engine.mission import Mission\n\n"
        "MISSION = Mission(name='slip', trees=None)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissionError) as refusal:
        find_mission("slip_of_mine:MISSION")
    assert "unexpected keyword argument 'trees'" in str(refusal.value)
    assert "slip_of_mine.py, line 3" in str(refusal.value)


def test_mission_that_is_only_planned_has_no_tree(new):
    mission = find_mission(f"{new('--task', 'pddl')}:MISSION")
    assert isinstance(mission, Mission)
    assert open_run(mission).task == "pddl"
    with pytest.raises(MissionError, match="has no tree; run it with --task pddl"):
        open_run(mission, task="bt")
