"""However a run ends, it ends, and says truly how: also with a world or a task that its author got wrong."""

import json
import math
from dataclasses import replace
from fractions import Fraction

import numpy
import pytest
from agv_worlds import building_from
from py_trees.behaviours import Running, Success
from running import register, rosa_run, run_mission
from small_rover import rover_model, rover_tree

from missions.agv import agv_mission
from missions.baselines import Policy, open_run
from missions.engine.mission import (
    Mission,
    MissionError,
    Sample,
    Verdict,
    World,
    WorldKind,
    find_mission,
    split_settings,
)
from missions.engine.recording import LineRecorder, measured, read_recording, sensed
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS
from missions.testing import FakeClock, ScriptedManaged
from missions.views.output import summary
from missions.views.recorder import RunRecorder


class Field(World):
    """A world whose time goes as a function says; it publishes what it is given, once."""

    def __init__(self, goes=lambda now, until: until, news=()):
        self.goes, self.news, self.is_closed = goes, list(news), False
        self.clock = FakeClock()
        self.managed_ = ScriptedManaged(self.clock)
        self.time = 0.0

    @property
    def now(self):
        return self.time

    @property
    def managed(self):
        return self.managed_

    def advance(self, until):
        self.time = self.goes(self.time, until)
        if self.time > self.clock.now:
            self.clock.advance_to(self.time)
        news, self.news = self.news, []
        return news

    def close(self):
        self.is_closed = True


class FieldKind(WorldKind):
    def open(self, values, rng):
        return Field()

    def verdict(self, percepts, results, kb):
        if percepts.holds("explored"):
            return Verdict("explored_all", "all is explored")
        return Verdict("aborted", "time ran out before all was explored")


ROVER = Mission("rover", "explores", rover_model, rover_tree, FieldKind())


def run_in(world, mission=ROVER, **settings):
    return rosa_run(mission, "bt", world, RunSettings(**{"duration_s": 5.0, **settings}))


@pytest.mark.parametrize(
    ("goes", "words"),
    [
        (
            lambda now, until: now,
            r"stands still at 0\.000 s, asked to go on to 0\.100 s; advance\(\) goes on until",
        ),
        (lambda now, until: now + 1e-12, "stands still"),
        (lambda now, until: math.nan, "shows nan s after 0.0 s; its time has to pass"),
        (lambda now, until: math.inf, "shows inf s after 0.0 s; its time has to pass"),
        (
            lambda now, until: until if now < 1.0 else now - 0.5,
            r"shows 0\.5\d* s after 1\.0\d* s; its time has to pass",
        ),
        (
            lambda now, until: until if now < 1.0 else 1 / 0,
            r"rover failed after 1\.0 s: ZeroDivisionError: .*; test_run_ends\.py, line \d+$",
        ),
    ],
)
def test_world_that_does_not_let_time_pass_is_refused_by_name_and_closed(goes, words):
    world = Field(goes)
    run = run_in(world)
    with pytest.raises(MissionError, match=words):
        run.run()
    assert world.is_closed
    assert run.kb.required_actions == ()


NAN = math.nan
STATUS = {"name": "", "message": "component status", "values": {}}
GIVEN = [  # a method of the world, what it gives, and what the message says of it
    (
        "advance",
        None,
        r"advance\(\) of Odd gives None; expected is a list of messages, empty if there are none",
    ),
    (
        "advance",
        ["news"],
        r"advance\(\) of Odd: a message is an object with a number \"time\" .*, not 'news'",
    ),
    (
        "advance",
        [{"status": []}],
        r"advance\(\) of Odd: a message is an object with a number \"time\" \[s\]",
    ),
    ("advance", [{"time": "1.0", "status": []}], r"with a number \"time\" .*, not {'time': '1.0'"),
    ("advance", [{"time": NAN, "status": []}], r"with a number \"time\" .*, not {'time': nan"),
    (
        "advance",
        [{"time": 0.0}],
        'each "status" is an object with a text "message" and an object "values", not None',
    ),
    ("advance", [{"time": 0.0, "status": [STATUS, 3]}], 'each "status" is an object .*, not 3'),
    (
        "advance",
        [{"time": 0.0, "status": [{**STATUS, "message": None}]}],
        'a text "message" .*, not {',
    ),
    (
        "advance",
        [{"time": 0.0, "status": [{**STATUS, "values": [1]}]}],
        'an object "values", not {',
    ),
    (
        "advance",
        [{"time": 0.0, "status": [{**STATUS, "values": {1: ""}}]}],
        'the names in "values" are texts, not 1',
    ),
    ("now", None, r"now of Odd is None; expected is the time, a number \[s\]"),
    ("now", "soon", "now of Odd is 'soon'; expected is the time"),
    (
        "managed",
        None,
        "managed of Odd is None; expected is a kb.ManagedSystem, which has the methods activate, deact",
    ),
    ("results", None, r"results\(\) of Odd gives None; expected is a mapping of names to numbers"),
    (
        "results",
        {"rooms": "many"},
        r"results\(\) of Odd gives {'rooms': 'many'}; expected is a mapping of names",
    ),
    ("results", {3: 1.0}, r"results\(\) of Odd gives {3: 1.0}; expected is a mapping of names"),
    (
        "reactions",
        3,
        r"reactions\(\) of Odd gives 3; expected is a sequence of reactions, each with uncertainty",
    ),
    ("reactions", [3], r"reactions\(\) of Odd gives \[3\]; expected is a sequence of reactions"),
    (
        "sample",
        3,
        r"sample\(\) of Odd gives 3; expected is None or a missions.engine.mission.Sample",
    ),
    (
        "sample",
        Sample(0.0, (1.0, 2.0), {}),
        "expected is None or a .*Sample: a time, a position of three numbers",
    ),
    ("sample", Sample(0.0, (1.0, 2.0, 3.0), {"light": "dim"}), "and signals that are numbers"),
    ("sample", Sample(0.0, (1.0, 2.0, 3.0), {3: 1.0}), "and signals that are numbers"),
    (
        "sample",
        Sample("now", (1.0, 2.0, 3.0), {}),
        "expected is None or a .*Sample: a time, a position",
    ),
    (
        "disturbances",
        None,
        r"disturbances\(\) of Odd gives None; expected is a list of pairs of a time \[s\]",
    ),
    (
        "disturbances",
        [("dark", 1.0)],
        r"disturbances\(\) of Odd gives \[\('dark', 1.0\)\]; expected is a list of pairs",
    ),
    (
        "scenery",
        [1],
        r"scenery\(\) of Odd gives \[1\]; expected is a mapping of names to points, each of two numbers",
    ),
    (
        "scenery",
        {"wall": [(1.0, 2.0, 3.0)]},
        r"scenery\(\) of Odd gives {'wall'.*expected is a mapping",
    ),
]


@pytest.mark.parametrize(("method", "given", "words"), GIVEN)
def test_world_that_gives_something_else_than_it_is_to_give_is_told_what_that_is(
    method, given, words
):
    def gives(world, *until):
        return given

    class Odd(Field):
        pass

    setattr(Odd, method, property(gives) if method in ("now", "managed") else gives)
    with pytest.raises(MissionError, match=words):
        drawn(run_in(Odd(), duration_s=0.5))


@pytest.mark.parametrize("method", ["results", "reactions", "sample", "disturbances", "scenery"])
def test_world_that_raises_is_named_with_the_method_and_the_line(method):
    def fails(world):
        raise KeyError("camera")

    class Odd(Field):
        pass

    setattr(Odd, method, fails)
    with pytest.raises(
        MissionError,
        match=rf"{method}\(\) of Odd failed.*KeyError: 'camera'; test_run_ends\.py, line \d+$",
    ):
        drawn(run_in(Odd(), duration_s=0.5))


def test_figure_may_be_any_real_number():
    world = Field()
    world.results = lambda: {"share": Fraction(1, 3)}
    assert drawn(run_in(world))["share"] == Fraction(1, 3)


def test_scenery_is_checked_once_and_not_at_each_look_of_a_page():
    class Points(list):
        looks = 0

        def __iter__(self):
            self.looks += 1
            return super().__iter__()

    points = Points([(0.0, 1.0), (2.0, 3.0)])
    world = Field()
    world.scenery = lambda: {"wall": points}
    drawn(run_in(world, duration_s=20.0))
    assert 0 < points.looks < 5


def drawn(run):
    """Run to the end as `rosa run --report --json` does."""
    page = RunRecorder(run, 0, {})
    verdict = run.run()
    page.end(verdict)
    return summary(run, verdict, 0, {})


@pytest.mark.parametrize(
    ("method", "given", "words"),
    [
        ("open", None, r"what open\(\) of Odd gives is None, not a World"),
        ("verdict", "fine", r"what verdict\(\) of Odd gives is 'fine', not a Verdict"),
        (
            "settings",
            ("speed",),
            r"settings\(\) of Odd gives 'speed'; expected is a tuple of .*Setting",
        ),
    ],
)
def test_kind_of_world_that_gives_something_else_than_it_is_to_give_is_told_what_that_is(
    method, given, words
):
    class Odd(FieldKind):
        pass

    setattr(Odd, method, lambda *_: given)
    with pytest.raises(MissionError, match=words):
        open_run(replace(ROVER, world=Odd()), settings={"duration_s": "0.5"}).run()


def fails(*given, **named):
    raise KeyError("lens")


class Lit(FieldKind):
    def __init__(self, **methods):
        self.methods = methods

    def open(self, values, rng):
        return type("Odd", (Field,), self.methods)(news=[measured(0.0, light=0.9, energy=1.0)])


LIT = replace(ROVER, world=Lit())
SEA = find_mission("suave_extended")


@pytest.mark.parametrize(
    ("mission", "options", "words"),
    [
        (replace(LIT, model=lambda: fails()), {}, "cannot build the model of mission rover"),
        (
            replace(SEA, facts=lambda kb, percepts: fails()),
            {"task": "pddl"},
            "suave_extended under manager ours",
        ),
        (
            replace(LIT, world=Lit(close=fails)),
            {},
            r"mission rover under manager ours failed after 1\.\d\d s",
        ),
        (
            LIT,
            {"manager": type("Own", (Policy,), {"pick": fails})},
            "rover under manager .*Own failed after 0.00 s",
        ),
        (
            LIT,
            {"manager": type("Own", (Policy,), {"hear": fails})},
            "rover under manager .*Own failed after 0.00 s",
        ),
        (
            LIT,
            {"manager": type("Own", (Policy,), {"__init__": fails})},
            "rover under manager .*Own",
        ),
    ],
)
def test_function_of_an_author_that_raises_is_named_with_its_line(mission, options, words):
    with pytest.raises(
        MissionError, match=rf"{words}: KeyError: 'lens'.*; test_run_ends\.py, line \d+$"
    ):
        open_run(mission, settings={"duration_s": "1"}, **options).run()


@pytest.mark.parametrize(
    ("method", "given", "words"),
    [
        (
            "pick",
            "fast",
            r"pick\(\) of Own gives 'fast'; expected is one of those that are possible, or None",
        ),
        (
            "hear",
            None,
            r"hear\(\) of manager .*Own: a message is an object with a number .*, not None",
        ),
        ("alter", None, r"what alter\(\) of .*Own gives is None, not a Mission"),
    ],
)
def test_manager_that_gives_something_else_than_it_is_to_give_is_told_what_that_is(
    method, given, words
):
    with pytest.raises(MissionError, match=words):
        open_run(
            LIT,
            settings={"duration_s": "1"},
            manager=type("Own", (Policy,), {method: lambda *_: given}),
        ).run()


def test_mistake_of_ours_stays_a_traceback(monkeypatch):
    monkeypatch.setattr(
        "missions.engine.runner.AdaptationLog.ticking", lambda log, time: next(iter(()))
    )
    monkeypatch.setitem(globals(), "__name__", "missions.mended")
    with pytest.raises(StopIteration):
        run_in(Field(), duration_s=0.5).run()


def test_numbers_of_numpy_are_numbers_and_can_be_recorded(tmp_path):
    light = {
        "time": numpy.float32(0.25),
        "status": [{**STATUS, "message": "attribute measurement", "values": {}}],
    }
    light["status"][0]["values"] = {"light": numpy.float32(0.5), "energy": numpy.int64(1)}
    run, lines = run_in(Field(news=[light]), duration_s=0.5), []
    LineRecorder(run, 0, lines.append)
    run.run()
    assert not run.problems
    assert run.kb.attributes["light"].value == 0.5
    (tmp_path / "run.jsonl").write_text("".join(lines))
    *_, read = read_recording(tmp_path / "run.jsonl")
    assert (read["time"], read["status"][0]["values"]) == (0.25, {"light": 0.5, "energy": 1.0})


def test_behaviour_that_has_plans_of_its_own_does_not_plan_for_the_run():
    tourist = Running("tourist")
    tourist.plans = ["beach"]
    run = run_in(Field(), replace(ROVER, tree=lambda kb, percepts: tourist), duration_s=0.5)
    run.run()
    assert run.plans == ()


def test_place_of_a_mistake_is_the_authors_line_and_not_that_in_python(monkeypatch):
    def broken(now, until):
        return json.loads("{")

    with pytest.raises(MissionError, match=r"JSONDecodeError: .*; test_run_ends\.py, line \d+$"):
        run_in(Field(broken)).run()


def test_world_that_publishes_at_one_moment_for_ever_is_refused():
    class Loud(Field):
        def advance(self, until):
            return [measured(self.now, light=0.9)]

    with pytest.raises(MissionError, match="stands still"):
        run_in(Loud()).run()


def test_command_line_tells_of_a_world_that_stands_still_in_one_message(monkeypatch, capsys):
    from running import called

    kind = FieldKind()
    kind.open = lambda values, rng: Field(lambda now, until: now)
    register(monkeypatch, "rover", replace(ROVER, world=kind))
    code, _, err = called(capsys, monkeypatch, "run", "rover", "--no-progress")
    assert code == 2
    assert "the world of mission rover stands still" in err


def test_measurements_that_are_no_numbers_are_told_and_nothing_else_happens():
    world = Field(news=[measured(0.0, light=math.nan), measured(0.0, energy=math.inf, light=0.9)])
    run = run_in(world)
    run.run()
    assert [problem.key for _, problem in run.problems] == ["light", "energy"]
    assert run.kb.attributes["light"].value == 0.9
    assert run.kb.attributes["energy"].value is None


def test_task_that_ends_early_is_told_so_and_not_that_time_ran_out():
    world = Field()
    verdict = run_in(world, replace(ROVER, tree=lambda kb, percepts: Success("done"))).run()
    assert not verdict.success
    assert world.now < 1.0
    assert verdict.outcome == "ended_early"
    assert (
        verdict.reason
        == f"the task ended after {world.now:.1f} s of 5 s, short of the mission's goal"
    )


def test_task_that_ends_in_the_sea_before_anything_is_found_is_told_so(monkeypatch):
    mission = replace(find_mission("suave"), tree=lambda kb, percepts: Success("done"))
    register(monkeypatch, "short", mission)
    _, verdict, data = run_mission("short")
    assert verdict.outcome == data["outcome"] == "ended_early"
    assert "time ran out" not in verdict.reason


def test_task_that_reaches_the_goal_early_is_a_success_and_one_without_time_says_so():
    done = run_in(Field(news=[sensed(0.0, explored=True), measured(0.0, light=0.9, energy=1.0)]))
    assert done.run().outcome == "explored_all"
    world = Field()
    assert run_in(world).run().reason.startswith("time ran out")
    assert world.now == 5.0


@pytest.mark.parametrize("task", TASK_KINDS)
def test_vehicle_that_has_no_way_ends_when_that_is_proven(task):
    plan = {"a": [0, 0], "b": [6, 0]}
    building = {
        "start": "a",
        "goal": "b",
        "places": plan,
        "corridors": {"c1": {"from": "a", "to": "b", "light": 0.0}},
    }
    mission = agv_mission("small", "drives", building_from(building))
    lost = {"incidents": "lamp fails in c1, lidar fails in c1, kinect fails in c1"}
    run = rosa_run(
        mission,
        task,
        mission.world.open(lost, numpy.random.default_rng(0)),
        RunSettings(duration_s=900.0),
    )
    verdict = run.run()
    assert run.world.now < 60.0
    assert verdict.outcome == "aborted"
    assert verdict.reason.startswith("there is no way from within c1")


@pytest.mark.parametrize("task", TASK_KINDS)
def test_aircraft_whose_battery_is_empty_ends_then_and_not_before_all_that_is_wanted_is_known(task):
    run, verdict, data = run_mission(
        "uav", task, seed=0, capacity_j=1000, charge_s=1e6, added_s=100
    )
    empty = next(
        one["at_s"] for one in data["disturbances"] if one["what"] == "the battery is empty"
    )
    assert empty < 100 <= run.world.now < 101
    assert verdict.reason.startswith("the battery ran empty, 0 of 8 samples were analysed")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"duration_s": math.nan}, "duration_s is nan; allowed is a number of seconds from 0.001"),
        ({"duration_s": "soon"}, "duration_s is 'soon'"),
        ({"tick_period_s": 0.0}, "tick_period_s is 0.0; allowed is a number of seconds from 0.001"),
        ({"planning_delay_s": -1}, "planning_delay_s is -1"),
        ({"tick_period_s": True}, "tick_period_s is True"),
    ],
)
def test_settings_that_mean_nothing_are_refused_also_in_python(settings, words):
    with pytest.raises(MissionError, match=words):
        RunSettings(**settings)


def test_settings_that_a_mission_fixes_are_how_it_is_run_and_may_be_changed():
    mission = replace(find_mission("suave"), fixed={"battery": "false", "duration": "7"})
    assert split_settings(mission, {})[0].duration_s == 7.0
    assert split_settings(mission, {"duration_s": "9"})[0].duration_s == 9.0
    assert split_settings(mission, {})[1] == {"battery": "false"}
    with pytest.raises(MissionError, match="'nonsense'"):
        mission.world.open(
            split_settings(replace(mission, fixed={"nonsense": "1"}), {})[1],
            numpy.random.default_rng(0),
        )
