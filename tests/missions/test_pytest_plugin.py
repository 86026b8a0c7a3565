"""The pytest plugin, as its users meet it, and its page of documentation."""

import re
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

import missions

pytest_plugins = "pytester"

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")
PAGE = (Path(__file__).parents[2] / "docs" / "replay_tests.md").read_text()
IS_INSTALLED = bool(entry_points(group="pytest11", name="rosa"))
PLUGINS = ["-p", "no:cacheprovider", "-p", "no:randomly"] + (
    [] if IS_INSTALLED else ["-p", "missions.testing.plugin"]
)
STARTS_WITHOUT = """
import sys, types
package = types.ModuleType("missions")  # what the package itself imports is its own affair
package.__path__ = [sys.argv[1]]
sys.modules["missions"] = package
import missions.testing.plugin
loaded = {name.split(".")[0] for name in sys.modules}
slow = loaded & {"kb", "rosa_bt", "rosa_pddl", "suave_env", "py_trees", "numpy", "rich"}
assert not slow, slow
"""
GOLDEN = """
    from py_trees.behaviours import StatusQueue
    from py_trees.common import Status
    from kb import KnowledgeBase, Model
    from rosa_bt import ForAction, TraceVisitor, TreeRunner

    def test_it_goes(golden_trace):
        statuses = [Status.RUNNING, Status.{}]
        model = Model("rover")
        model.action("explore")
        kb = KnowledgeBase(model, clock=lambda: 0.0)
        wheels = StatusQueue("wheels", statuses, None)
        runner = TreeRunner(ForAction("go", kb, "explore", wheels), clock=lambda: 0.0)
        with TraceVisitor(kb) as visitor:
            runner.tree.add_visitor(visitor)
            for _ in statuses:
                runner.tick()
            runner.shutdown()
            golden_trace(visitor.trace)
"""
PATH = "golden/test_rover.test_it_goes.trace"


@pytest.fixture
def run(pytester):
    """Return what runs pytest on a test file, in this process."""

    def run(source, *arguments):
        pytester.makepyfile(test_rover=source)
        return pytester.runpytest_inprocess(*PLUGINS, *arguments)

    return run


def test_failed_assertion_shows_the_timeline_and_not_the_library(run, pytester):
    pytester.path.joinpath("battery_drop.jsonl").write_bytes(BATTERY_DROP.read_bytes())
    result = run("""
        def test_it_recharges_at_once(replay):
            decisions = replay("battery_drop.jsonl", "suave_extended")
            decisions.assert_adapts(at=150.0, to="recharge", within=0.01)
    """)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "E*AssertionError: expected between 150.00 s and 150.01 s: any -> recharge",
            "E*what happened:",
            "E*150.00 s  EXPECTED  any -> recharge",
            "E*150.00 s  action    recharge is requested",
        ]
    )
    assert "decisions.py" not in result.stdout.str()


def test_golden_trace_is_written_on_request_and_compared(run, pytester):
    result = run(GOLDEN.format("SUCCESS"))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            f"E*AssertionError: not as in *{PATH.replace('/', '?')}",
            'E*write it: pytest --update-traces "test_rover.py::test_it_goes"',
            "E*+  decided  explore is requested",
        ]
    )
    assert not (pytester.path / PATH).exists()
    run(GOLDEN.format("SUCCESS"), "--update-traces").assert_outcomes(passed=1)
    run(GOLDEN.format("SUCCESS")).assert_outcomes(passed=1)
    result = run(GOLDEN.format("FAILURE"))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "E*-  ticked   wheels: SUCCESS",
            "E*+  ticked   wheels: FAILURE",
        ]
    )


def test_fixture_of_a_user_goes_first(pytester):
    pytester.makepyfile("""
        import pytest

        @pytest.fixture
        def replay():
            return "a fixture of the user's"

        def test_their_own_fixture_goes_first(replay):
            assert replay == "a fixture of the user's"
    """)
    pytester.runpytest_subprocess(*PLUGINS, "-W", "error").assert_outcomes(passed=1)


def test_plugin_imports_nothing_slow_when_pytest_starts():
    where = Path(missions.__file__).parent
    command = [sys.executable, "-c", STARTS_WITHOUT, str(where)]
    subprocess.run(command, cwd=where.parent, check=True)


def test_page_is_a_test_file_that_passes(pytester):
    blocks = re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    code = "\n".join(text for language, text in blocks if language == "python")
    pytester.path.joinpath("battery_drop.jsonl").write_bytes(BATTERY_DROP.read_bytes())
    pytester.path.joinpath("test_of_the_page.py").write_text(code)
    result = pytester.runpytest_inprocess(*PLUGINS, "--update-traces")
    result.assert_outcomes(passed=len(re.findall(r"^def test_", code, re.MULTILINE)))
