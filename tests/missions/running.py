"""Runs missions as the command line does, for the tests."""

import json
import sys
from functools import cache
from types import ModuleType

from small_rover import rover_model, rover_tree

from missions import cli
from missions.baselines import open_run
from missions.engine.mission import Mission, Verdict, World, WorldKind, find_mission
from missions.engine.runner import Listener, MissionRun, RosaRun
from missions.engine.settings import RunSettings
from missions.testing import FakeClock, ScriptedManaged
from missions.views.output import as_json, summary
from missions.views.report import Recorded


class Watcher(Listener):
    """Keeps what there was to see."""

    def __init__(self):
        self.samples = []

    def sample(self, sample):
        self.samples.append(sample)


def run_mission(
    name, task="bt", seed=0, listeners=None, **changed
) -> tuple[MissionRun, Verdict, dict]:
    """Run a mission, by default watched by somebody.

    Returns the run, the verdict and the result as data.
    """
    values = {key: str(value) for key, value in changed.items()}
    watching = (Watcher(),) if listeners is None else tuple(listeners)
    run = open_run(find_mission(name), task=task, seed=seed, settings=values)
    run.listen(*watching)
    verdict = run.run()
    return run, verdict, summary(run, verdict, seed, values)


def rosa_run(mission, task, world, settings=None, listeners=()) -> MissionRun:
    """Return a run of a mission in an open world, with a task layer of ours."""
    run = RosaRun(mission, task, world, settings or RunSettings())
    run.listen(*listeners)
    return run


@cache
def result(name, task="bt", seed=0) -> dict:
    """Return the result of a mission with its default settings, run once for all tests."""
    return run_mission(name, task, seed)[2]


@cache
def text(name, task="bt", seed=0) -> str:
    """Return that result as the JSON that the command line writes."""
    return as_json(result(name, task, seed))


def called(capsys, monkeypatch, *arguments) -> tuple[int, str, str]:
    """Call `rosa` as a person does; returns exit status, output and errors."""
    monkeypatch.setattr("sys.argv", ["rosa", *map(str, arguments)])
    code = 0
    try:
        cli.main()
    except SystemExit as end:
        code = end.code or 0
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err
    return code, captured.out, captured.err


def register(monkeypatch, name: str, mission: object) -> None:
    """Have a mission be the only one of the registry, under a name."""
    home = ModuleType("registered_by_a_test")
    home.MISSION = mission
    monkeypatch.setitem(sys.modules, home.__name__, home)
    monkeypatch.setattr("missions.engine.mission.MISSIONS", {name: f"{home.__name__}:MISSION"})


def read_report(path):
    """Return the run that a report shows."""
    _, data = path.read_text().split('<script type="application/json" id="rosa-data">')
    run = json.loads(data.partition("</script>")[0])["run"]
    return Recorded(run["header"], [tuple(row) for row in run["rows"]])


class Field(World):
    """A world whose time goes as a function says; it publishes its news once."""

    def __init__(self, news=(), goes=lambda now, until: until):
        self.news = list(news)
        self.goes = goes
        self.clock = FakeClock()
        self.scripted = ScriptedManaged(self.clock)
        self.time = 0.0
        self.is_closed = False

    @property
    def now(self):
        return self.time

    @property
    def managed(self):
        return self.scripted

    def advance(self, until):
        self.time = self.goes(self.time, until)
        if self.time > self.clock.now:
            self.clock.advance_to(self.time)
        messages = self.news
        self.news = []
        return messages

    def close(self):
        self.is_closed = True


class FieldKind(WorldKind):
    """Opens a field; each answer can be replaced by one that is wrong."""

    def __init__(self, news=(), **answers):
        self.news = news
        self.answers = answers

    def open(self, values, rng):
        return self.answers.get("opens", Field(self.news))

    def settings(self):
        return self.answers.get("settings", ())

    def verdict(self, percepts, results, kb):
        if "verdict" in self.answers:
            return self.answers["verdict"]
        if percepts.holds("explored"):
            return Verdict("explored_all", "all is explored")
        return Verdict("aborted", "time ran out before all was explored")


ROVER = Mission("rover", "explores", rover_model, rover_tree, FieldKind())


def run_rover(news=(), tree=None, goes=lambda now, until: until) -> MissionRun:
    """Return a run of the rover in a field, for 5 s, perhaps with another tree."""
    build = rover_tree if tree is None else lambda kb, percepts: tree
    mission = Mission("rover", "explores", rover_model, build, FieldKind())
    return rosa_run(mission, "bt", Field(news, goes), RunSettings(duration_s=5.0))
