"""What is optional is not needed for the rest, and says which extra it is when it is missing."""

import subprocess
import sys
from importlib.metadata import version

import pytest

MISSING = """
import sys
from importlib.metadata import version
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""
RUN = "import sys; sys.argv = ['rosa', *{arguments!r}]; from missions.cli import main; main()"
OPTIONAL = {
    "mujoco",
    "ortools",
    "owlready2",
    "scipy",
    "matplotlib",
    "websockets",
    "textual",
    "zmq",
    "mcap",
    "rosbags",
    "cyclonedds",
    "mcp",
    "dask",
}


def without(missing, program):
    text = MISSING.format(missing=missing) + program
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)


def test_a_robot_needs_none_of_the_extras():
    done = without(
        OPTIONAL,
        """
from kb import ConfigurationManager, KnowledgeBase
import rosa_bt, rosa_pddl, missions
from missions.suave_extended import MISSION
kb = KnowledgeBase(MISSION.model(), clock=lambda: 0.0)
kb.measure("battery_level", 1.0)
print(kb.selectable_actions())
""",
    )
    assert done.returncode == 0, done.stderr
    assert "recharge" in done.stdout


@pytest.mark.parametrize(
    ("library", "arguments", "extra"),
    [
        ("mujoco", ["run", "suave_extended"], "sim"),
        ("mujoco", ["run", "agv"], "sim"),
        ("mujoco", ["run", "uav"], "sim"),
        ("matplotlib", ["run", "suave", "--plot", "x.png"], "plot"),
        ("owlready2", ["run", "suave", "--manager", "metacontrol"], "sim"),
        ("owlready2", ["check", "--mission", "suave", "--reason"], "reason"),
        ("websockets", ["run", "suave", "--live", "0"], "live"),
        ("rosbags", ["run", "suave", "--record", "x.mcap"], "mcap"),
        ("textual", ["run", "suave", "--tui"], "tui"),
        ("mcp", ["mcp", "suave"], "mcp"),
    ],
)
def test_missing_extra_is_named(library, arguments, extra, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = without({library}, RUN.format(arguments=arguments))
    assert done.returncode == 2, done.stderr
    assert f"pip install 'rosa-taca[{extra}]'" in " ".join(done.stderr.split())
    assert not list(tmp_path.iterdir()), "nothing half-done stays behind"


def test_missing_solver_is_named():
    done = without({"ortools"}, "from kb import OptimalPlanner; OptimalPlanner()")
    assert "KnowledgeBaseError" in done.stderr
    assert "pip install 'rosa-taca[optimal]'" in done.stderr


IMPORTS = """
import resource, sys
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
import kb
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, *sys.modules)
"""


def test_knowledge_base_is_imported_in_20_megabytes_without_what_few_need():
    done = subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True)
    kilobytes, *imported = done.stdout.split()
    assert int(kilobytes) < 20 * 1024
    late = {"lark", "ortools", "owlready2", "pyoxigraph", "numpy", "tomllib", "multiprocessing", "importlib.resources"}
    assert not late & set(imported)


def test_report_names_the_extra_that_it_needs(tmp_path):
    campaign = tmp_path / "one.toml"
    campaign.write_text('missions = ["suave"]\nruns = 1\n[settings]\nduration_s = 5\n')
    folder = str(tmp_path / "out")
    for arguments in (["campaign", str(campaign), "--workers", "1", "--out", folder], ["report", folder]):
        done = without({"scipy"}, RUN.format(arguments=arguments))
    assert done.returncode == 2
    assert "pip install 'rosa-taca[plot]'" in " ".join(done.stderr.split())


def test_version_is_said():
    done = subprocess.run([sys.executable, "-m", "missions", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"rosa-taca {version('rosa-taca')}\n"
