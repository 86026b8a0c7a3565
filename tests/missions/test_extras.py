"""What is optional is not needed for the rest, and says which extra it is when it is missing."""

import json
import subprocess
import sys
from importlib.metadata import version

from running import called

from missions.experiments.campaign import Campaign
from missions.experiments.results import Store
from missions.experiments.workers import do

MISSING = """
import json, os, sys
class Missing:
    def __init__(self, libraries):
        self.libraries = libraries
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.libraries:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
"""
COMMANDS = """
import missions.baselines, missions.commands.check, missions.commands.run, missions.suave
from missions.cli import main
assert not set(json.loads(sys.argv[2])) & set(sys.modules)
for number, (library, arguments, _) in enumerate(json.loads(sys.argv[1])):
    os.mkdir(str(number))
    if not os.fork():
        said = os.open(f"{number}.txt", os.O_CREAT | os.O_WRONLY | os.O_APPEND)
        os.dup2(said, 1)
        os.dup2(said, 2)
        os.chdir(str(number))
        sys.meta_path.insert(0, Missing({library}))
        sys.argv = ["rosa", *arguments]
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
"""
NONE = """
sys.meta_path.insert(0, Missing(json.loads(sys.argv[1])))
from kb import ConfigurationManager, KnowledgeBase, KnowledgeBaseError, OptimalPlanner
import rosa_bt, rosa_pddl, missions
from missions.suave_extended import MISSION
kb = KnowledgeBase(MISSION.model(), clock=lambda: 0.0)
kb.measure("battery_level", 1.0)
print(kb.selectable_actions())
try:
    OptimalPlanner()
except KnowledgeBaseError as error:
    print(error)
"""
OPTIONAL = [
    "mujoco",
    "ortools",
    "scipy",
    "matplotlib",
    "websockets",
    "textual",
    "zmq",
    "mcap",
    "rosbags",
    "mcp",
    "dask",
]
CASES = [
    ("mujoco", ["run", "suave_extended"], "sim"),
    ("mujoco", ["run", "agv"], "sim"),
    ("mujoco", ["run", "uav"], "sim"),
    ("matplotlib", ["run", "suave", "--plot", "x.png"], "plot"),
    ("websockets", ["run", "suave", "--live", "0"], "live"),
    ("rosbags", ["run", "suave", "--record", "x.mcap"], "mcap"),
    ("textual", ["run", "suave", "--tui"], "tui"),
    ("mcp", ["mcp", "suave"], "mcp"),
    ("scipy", ["report", "../results"], "plot"),
]


def program(text, *given, cwd):
    command = [sys.executable, "-c", MISSING + text, *map(json.dumps, given)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_robot_needs_no_extra_and_a_missing_solver_is_named(tmp_path):
    said = program(NONE, OPTIONAL, cwd=tmp_path)
    assert "recharge" in said
    assert "pip install 'rosa-taca[optimal]'" in said


def test_missing_extra_is_named(tmp_path):
    """Each command is a process of its own, which has imported nothing that may be missing."""
    campaign = Campaign("one", ("suave",), runs=1, settings={"duration_s": "5"})
    with Store(tmp_path / "results", campaign) as store:
        store.keep(do(next(campaign.planned())))
    exits = program(COMMANDS, CASES, OPTIONAL, cwd=tmp_path).split()
    assert exits == ["2"] * len(CASES)
    for number, (_, arguments, extra) in enumerate(CASES):
        said = " ".join((tmp_path / f"{number}.txt").read_text().split())
        assert f"pip install 'rosa-taca[{extra}]'" in said, arguments
        assert "Traceback" not in said
        assert not list((tmp_path / str(number)).iterdir()), "nothing half-done stays behind"


IMPORTS = """
import resource, sys
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
import kb
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, *sys.modules)
"""


def test_knowledge_base_is_imported_in_20_megabytes():
    done = subprocess.run(
        [sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True
    )
    kilobytes, *imported = done.stdout.split()
    assert int(kilobytes) < 20 * 1024
    late = {
        "lark",
        "ortools",
        "owlready2",
        "rdflib",
        "numpy",
        "tomllib",
        "multiprocessing",
        "importlib.resources",
    }
    assert not late & set(imported)


def test_version_is_said(capsys, monkeypatch):
    assert called(capsys, monkeypatch, "--version") == (
        0,
        f"rosa-taca {version('rosa-taca')}\n",
        "",
    )
