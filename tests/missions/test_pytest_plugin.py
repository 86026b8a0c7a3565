"""The pytest plugin, as its users meet it: fixtures, golden traces, and failures that a person can read."""

import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from missions.engine.mission import MISSIONS, find_mission
from missions.testing.decisions import golden_path

for (
    _name
) in MISSIONS:  # loaded here, so that the runs inside of a test do not load all of it a second time
    find_mission(_name)

pytest_plugins = "pytester"

BATTERY_DROP = Path(__file__).with_name("battery_drop.jsonl")
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

    def trace_of(*statuses):
        model = Model("rover")
        model.action("explore")
        kb = KnowledgeBase(model, clock=lambda: 0.0)
        wheels = StatusQueue("wheels", list(statuses), None)
        runner = TreeRunner(ForAction("go", kb, "explore", wheels), clock=lambda: 0.0)
        with TraceVisitor(kb) as visitor:
            runner.tree.add_visitor(visitor)
            for _ in statuses:
                runner.tick()
            runner.shutdown()
            return visitor.trace
"""
OUTCOMES = "Status.RUNNING, Status.SUCCESS"
OTHER_OUTCOMES = "Status.RUNNING, Status.FAILURE"


@pytest.fixture
def run(pytester):
    """Return what runs pytest on a test file, in this process."""

    def run(source, *arguments):
        pytester.makepyfile(test_rover=source)
        return pytester.runpytest_inprocess(*PLUGINS, *arguments)

    return run


def golden_test(outcomes, *more):
    lines = [
        "    def test_it_goes(golden_trace):",
        f"        golden_trace(trace_of({outcomes}))",
        *more,
    ]
    return GOLDEN + "\n" + "\n".join(lines)


def test_replay_looks_beside_the_test_and_reads_like_the_story(run, pytester):
    pytester.path.joinpath("battery_drop.jsonl").write_bytes(BATTERY_DROP.read_bytes())
    result = run("""
        def test_it_recharges_when_the_battery_drops(replay):
            decisions = replay("battery_drop.jsonl", "suave_extended")
            decisions.assert_adapts(at=150.0, from_="inspect_pipeline", to="recharge", within=0.2)
            assert replay.__doc__.startswith("Replay a recording")
    """)
    result.assert_outcomes(passed=1)


def test_failed_assertion_shows_the_timeline_and_not_the_inside_of_the_library(run, pytester):
    pytester.path.joinpath("battery_drop.jsonl").write_bytes(BATTERY_DROP.read_bytes())
    result = run("""
        def test_it_recharges_at_once(replay):
            replay("battery_drop.jsonl", "suave_extended").assert_adapts(at=150.0, to="recharge", within=0.01)
    """)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "E*AssertionError: expected between 150.00 s and 150.01 s: any -> recharge",
            "E*but inspect_pipeline -> recharge is decided at 150.00 s and is in force at 150.10 s (because*",
            "E*what happened around 150.00 s:",
            "E*149.00 s  heard     battery_level is 0.255",
            "E*150.00 s  EXPECTED  any -> recharge",
            "E*150.00 s  heard     battery_level is 0.2499",
            "E*150.00 s  action    recharge is requested",
            "E*because inspect_pipeline is unfeasible because battery_level 0.2499 violates >= 0.25*",
        ]
    )
    assert "decisions.py" not in result.stdout.str()


def test_clock_and_managed_system_belong_together(run):
    result = run("""
        def test_slow_node(fake_clock, managed):
            managed.script("node", fail_first=2, takes=0.5)
            operation = managed.activate("node")
            assert managed.clock is fake_clock
            fake_clock.advance(0.5)
            assert operation.done() and operation.exception()
    """)
    result.assert_outcomes(passed=1)


def test_missing_golden_trace_is_a_failure_that_says_what_to_do(run, pytester):
    result = run(golden_test(OUTCOMES))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "E*AssertionError: there is no golden trace *golden?test_rover.test_it_goes.trace",
            'E*if this is as it should be, write it: pytest --update-traces "test_rover.py::test_it_goes"',
            "E*decided  explore is requested",
        ]
    )
    assert not pytester.path.joinpath("golden").exists()


def test_golden_trace_is_written_on_purpose_and_compared_from_then_on(run, pytester):
    result = run(golden_test(OUTCOMES), "--update-traces")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*golden traces written*", "*test_rover.test_it_goes.trace"])
    path = pytester.path / "golden" / "test_rover.test_it_goes.trace"
    written = path.read_bytes()
    run(golden_test(OUTCOMES)).assert_outcomes(passed=1)
    assert path.read_bytes() == written
    assert "golden traces written" not in run(golden_test(OUTCOMES), "--update-traces").stdout.str()


def test_difference_is_shown_in_words_with_how_to_update(run, pytester):
    run(golden_test(OUTCOMES), "--update-traces")
    path = pytester.path / "golden" / "test_rover.test_it_goes.trace"
    written = path.read_bytes()
    result = run(golden_test(OTHER_OUTCOMES))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "E*AssertionError: not as in the golden trace *test_rover.test_it_goes.trace",
            'E*if this is as it should be, update it: pytest --update-traces "test_rover.py::test_it_goes"',
            "E*-  ticked   wheels: SUCCESS",
            "E*-  decided  explore is completed",
            "E*+  ticked   wheels: FAILURE",
            "E*+  decided  explore is failed",
        ]
    )
    assert path.read_bytes() == written
    run(golden_test(OTHER_OUTCOMES), "--update-traces").assert_outcomes(passed=1)
    run(golden_test(OTHER_OUTCOMES)).assert_outcomes(passed=1)


def test_several_traces_of_one_test_have_names(run):
    second = f"        golden_trace(trace_of({OTHER_OUTCOMES}), name='second')"
    run(golden_test(OUTCOMES, second), "--update-traces").assert_outcomes(passed=1)
    run(golden_test(OUTCOMES, second)).assert_outcomes(passed=1)
    nameless = f"        golden_trace(trace_of({OUTCOMES}))"
    result = run(golden_test(OUTCOMES, nameless))
    result.stdout.fnmatch_lines(
        ["E*has compared with test_rover.test_it_goes.trace already; golden_trace(trace, name=*"]
    )


def test_what_is_no_trace_cannot_be_golden(run):
    result = run("def test_text(golden_trace):\n    golden_trace('text')", "--update-traces")
    result.stdout.fnmatch_lines(
        ["E*TypeError: a golden trace is a rosa_bt.Trace, such as decisions.trace, not a str"]
    )


@pytest.mark.parametrize("damage", ["", "{\n", '{"rosa_bt_trace": 99, "model": "rover"}\n'])
def test_golden_file_that_is_damaged_is_named_and_can_be_written_anew(run, pytester, damage):
    run(golden_test(OUTCOMES), "--update-traces")
    (pytester.path / "golden" / "test_rover.test_it_goes.trace").write_text(damage)
    result = run(golden_test(OUTCOMES))
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["E*TraceError: *test_rover.test_it_goes.trace*"])
    run(golden_test(OUTCOMES), "--update-traces").assert_outcomes(passed=1)


def test_tests_of_one_file_have_golden_traces_of_their_own():
    names = ["test_a", "TestB::test_a", "test_a[1-2]", "test_a[1-3]"]
    paths = {
        golden_path(Path("tests/test_rover.py"), name, part)
        for name in names
        for part in ("", "second")
    }
    assert len(paths) == 8
    assert {path.parent for path in paths} == {Path("tests/golden")}


def test_users_who_do_not_use_it_notice_nothing(pytester):
    pytester.makepyfile("""
        import pytest

        @pytest.fixture
        def replay():
            return "a fixture of the user's"

        def test_their_own_fixture_goes_first(replay):
            assert replay == "a fixture of the user's"
    """)
    result = pytester.runpytest_subprocess(*PLUGINS, "-W", "error")
    result.assert_outcomes(passed=1)
    assert "golden" not in result.stdout.str()


def test_fixtures_and_option_are_documented(run):
    listed = run("", "--fixtures").stdout
    for name in ("fake_clock", "managed", "replay", "golden_trace"):
        listed.fnmatch_lines([f"{name} -- *"])
    run("", "--help").stdout.fnmatch_lines(
        ["adaptive missions (rosa):", "*--update-traces*golden traces*"]
    )


def test_plugin_imports_nothing_slow_when_pytest_starts():
    import missions

    where = str(Path(missions.__file__).parent)
    done = subprocess.run(
        [sys.executable, "-c", STARTS_WITHOUT, where],
        cwd=Path(where).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
