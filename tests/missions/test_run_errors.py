"""What an author gets wrong is said in one message, which names it and says what to do."""

import math
from dataclasses import replace
from pathlib import Path

import numpy
import pytest
from py_trees.behaviours import Running
from py_trees.common import Status
from running import ROVER, Field, FieldKind, called, register, rosa_run, run_rover

from missions import suave_extended
from missions.baselines import Policy, open_run
from missions.engine.mission import Mission, MissionError, built, find_mission
from missions.engine.percepts import measured
from missions.engine.recording import LineRecorder, read_recording
from missions.views.output import summary
from missions.views.recorder import RunRecorder
from rosa_bt import IsActionFeasible, RosaAction
from rosa_pddl import Planner

HERE = r"test_run_errors\.py, line \d+$"
DOMAIN = Path(suave_extended.__file__).with_name("domain.pddl")
PROBLEM = DOMAIN.with_name("problem.pddl")
STATUS = {"name": "", "message": "component status", "values": {}}


def raising(*arguments, **named):
    raise KeyError("lens")


def drawn(run):
    """Run to the end as `rosa run --report --json` does."""
    page = RunRecorder(run, 0, {})
    verdict = run.run()
    page.end(verdict)
    return summary(run, verdict, 0, {})


@pytest.mark.parametrize(
    ("method", "value", "words"),
    [
        ("advance", None, r"advance\(\) of Odd gives None; expected is a list of messages"),
        ("advance", ["news"], r"advance\(\) of Odd: a message is an object .*, not 'news'"),
        ("advance", [{"time": "1", "status": []}], r'a number "time" .*, not {.time.: .1.'),
        ("advance", [{"time": math.nan, "status": []}], r'a number "time"'),
        ("advance", [{"time": 0.0}], 'a list "status" of objects'),
        ("advance", [{"time": 0.0, "status": [3]}], "of objects, each with"),
        ("advance", [{"time": 0.0, "status": [{**STATUS, "message": 1}]}], 'a text "message"'),
        (
            "advance",
            [{"time": 0.0, "status": [{**STATUS, "values": {1: ""}}]}],
            'an object "values"',
        ),
        ("now", "soon", "now of Odd shows 'soon' after -inf s; expected is the time"),
        (
            "advance",
            raising,
            rf"the world of mission rover failed .*KeyError: 'lens'; {HERE}",
        ),
        ("results", raising, rf"results\(\) of Odd failed .*KeyError: 'lens'; {HERE}"),
    ],
)
def test_world_method_that_is_wrong_is_named(method, value, words):
    function = value if callable(value) else lambda world, *until: value
    if method == "now":
        function = property(function)
    odd = type("Odd", (Field,), {method: function})
    with pytest.raises(MissionError, match=words):
        drawn(rosa_run(ROVER, "bt", odd()))


@pytest.mark.parametrize(
    ("goes", "words"),
    [
        (lambda now, until: now, r"stands still at 0\.000 s, asked to go on to 0\.100 s; advance"),
        (lambda now, until: now + 1e-12, "stands still"),
        (lambda now, until: math.inf, "shows inf after 0.0 s; expected is the time"),
        (lambda now, until: until if now < 1.0 else now - 0.5, r"shows 0\.5\d* after 1\.0"),
    ],
)
def test_world_whose_time_does_not_pass_is_closed_and_refused(goes, words):
    run = run_rover(goes=goes)
    with pytest.raises(MissionError, match=words):
        run.run()
    assert run.world.is_closed


LIT = replace(ROVER, world=FieldKind(news=[measured(0.0, light=0.9, energy=1.0)]))
SEA = find_mission("suave_extended")


def own(**methods):
    return {"manager": type("Own", (Policy,), methods)}


@pytest.mark.parametrize(
    ("mission", "options", "words"),
    [
        (replace(LIT, model=lambda: raising()), {}, f"the model of mission rover.*lens.*{HERE}"),
        (replace(ROVER, world=FieldKind(opens=None)), {}, r"what open\(\) of .* is None, not a W"),
        (
            replace(ROVER, world=FieldKind(verdict="fine")),
            {},
            r"what verdict\(\) .* is 'fine', not",
        ),
        (
            replace(LIT, tree=lambda kb, percepts: None),
            {},
            "the tree of mission rover is None, not",
        ),
        (LIT, own(pick=raising), f"rover under manager .*Own failed after 0.00 s.*lens.*{HERE}"),
        (LIT, own(__init__=raising), f"rover under manager .*Own.*{HERE}"),
        (LIT, own(pick=lambda *_: "fast"), r"pick\(\) of Own gives 'fast'; expected is one of"),
    ],
)
def test_function_of_an_author_that_is_wrong_is_named(mission, options, words):
    with pytest.raises(MissionError, match=words):
        open_run(mission, settings={"duration_s": "1"}, **options).run()


def test_function_of_an_author_gets_what_it_requires():
    assert built("it", int, lambda kb, **named: kb, 1, 2) == 1
    assert built("it", int, lambda kb, percepts, *more: percepts, 1, 2) == 2


def test_exception_of_our_own_stays_a_traceback(monkeypatch):
    name = "missions.engine.runner.AdaptationLog.ticking"
    monkeypatch.setattr(name, lambda log, time: next(iter(())))
    monkeypatch.setitem(globals(), "__name__", "missions.mended")
    with pytest.raises(StopIteration):
        run_rover().run()


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"world": None}, "world of mission m is None; expected is an object of a subclass of"),
        ({"tree": None}, "mission m has no task: give it a tree, or a PDDL domain and problem"),
    ],
)
def test_mission_field_that_is_wrong_is_refused(fields, words):
    with pytest.raises(MissionError, match=words):
        replace(ROVER, name="m", **fields)
    assert isinstance(ROVER, Mission)


class Rash(RosaAction):
    def update(self):
        raise ValueError("no such camera")


class Gone(Planner):
    """Was there when it was looked for, and is not any more."""

    def missing(self):
        return None


def edited(path, before, after=""):
    return lambda folder: _written(folder / path.name, path.read_text().replace(before, after))


def _written(path, content):
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    ("fields", "planner", "options", "words"),
    [
        (
            {"tree": lambda kb, percepts: IsActionFeasible("?", kb, "serch_pipeline")},
            None,
            "",
            "unknown action 'serch_pipeline'; did you mean 'search_pipeline'",
        ),
        (
            {"domain": edited(DOMAIN, "action_feasible", "act_feas")},
            None,
            "--task pddl",
            "domain.pddl",
        ),
        (
            {"problem": edited(PROBLEM, "(inspect_pipeline_action inspect_pipeline)")},
            None,
            "--task pddl",
            "there was no plan: unsolvable proven",
        ),
        ({"domain": lambda folder: folder / "nowhere"}, None, "--task pddl", "nowhere"),
        ({}, lambda *_, **__: Planner("tamer"), "--task pddl", "try 'pip install up-tamer'"),
        ({}, lambda *_, **__: Gone("tamer"), "--task pddl", "aborted"),
        (
            {},
            lambda *_, **__: Planner(timeout_s=1e-6, moves=0),
            "--task pddl",
            "planning ran out of wall-clock time, and going on would make the run depend",
        ),
        (
            {"tree": lambda kb, percepts: Rash("search", kb, "search_pipeline")},
            None,
            "",
            "search_pipeline failed last: ValueError: no such camera",
        ),
        (
            {"facts": lambda kb, percepts: {"(pipeline_found pipelin)": True}},
            None,
            "--task pddl",
            "is sensed, but ignored",
        ),
    ],
)
def test_command_line_says_what_is_wrong_in_a_mission(
    monkeypatch, capsys, tmp_path, fields, planner, options, words
):
    files = {"domain", "problem"} & fields.keys()
    fields = fields | {name: fields[name](tmp_path) for name in files}
    register(monkeypatch, "altered", replace(SEA, name="altered", **fields))
    if planner is not None:
        monkeypatch.setattr("missions.engine.task_layer.Planner", planner)
    arguments = ("--no-progress", "--set", "duration_s=3", *options.split())
    code, out, err = called(capsys, monkeypatch, "run", "altered", *arguments)
    assert code in (1, 2)
    assert words in " ".join((out + err).split())


def test_parts_of_messages_without_meaning_are_reported():
    light = measured(0.0, light=0.5, energy=math.nan, lihgt=1.0)
    run = run_rover([light])
    lines = []
    LineRecorder(run, 0, lines.append)
    run.run()
    assert [problem.key for _, problem in run.problems] == ["energy", "lihgt"]
    assert run.kb.attributes["light"].value == 0.5
    assert len(lines) == 2


def test_exception_in_a_behaviour_is_its_failure_with_the_line():
    class Broken(Running):
        def update(self):
            raise RuntimeError("boom")

    run = run_rover(tree=Broken("broken"))
    assert not run.run().success
    assert run.tree.root.status is Status.FAILURE
    line = Broken.update.__code__.co_firstlineno + 1
    message = f"RuntimeError: boom; test_run_errors.py, line {line}"
    assert run.tree.root.feedback_message == message


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (
            lambda kb, percepts, steps: Running(),
            "the behaviour of the PDDL action .*missing .* 'steps'",
        ),
        (lambda kb, percepts: None, "the behaviour of the PDDL action .* is None, not a py_trees"),
        (lambda kb, percepts: percepts.nothing, "no attribute 'nothing'"),
    ],
)
def test_action_that_cannot_build_a_step_ends_the_run(action, words):
    mission = replace(SEA, actions=dict.fromkeys(SEA.actions, action))
    world = mission.world.open({}, numpy.random.default_rng(0))
    with pytest.raises((MissionError, AttributeError), match=words):
        rosa_run(mission, "pddl", world).run()


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("not json\n", r"x.jsonl:1:1: not JSON"),
        (
            '{"time": 2, "status": []}\n{"time": 1, "status": []}\n',
            "x.jsonl:2: time 1 comes after 2",
        ),
    ],
)
def test_recording_that_is_broken_is_refused_with_its_line(tmp_path, lines, words):
    path = tmp_path / "x.jsonl"
    path.write_text(lines)
    with pytest.raises(MissionError, match=words):
        list(read_recording(path))
    with pytest.raises(MissionError, match="cannot read the recording"):
        list(read_recording(tmp_path / "missing.jsonl"))
