"""Runs missions as the command line does, for the tests."""

from functools import cache

import numpy

from missions import cli
from missions.engine.mission import Verdict
from missions.engine.registry import find_mission
from missions.engine.runner import MissionRun
from missions.engine.settings import split_settings
from missions.views.output import as_json, summary


def run_mission(name, task="bt", seed=0, listeners=(), **changed) -> tuple[MissionRun, Verdict, dict]:
    """Run a mission; returns the run, the verdict and the result as data."""
    mission = find_mission(name)
    values = {key: str(value) for key, value in changed.items()}
    settings, world_settings = split_settings(mission, values)
    world = mission.world.open(world_settings, numpy.random.default_rng(seed))
    run = MissionRun(mission, task, world, settings, tuple(listeners))
    verdict = run.run()
    return run, verdict, summary(run, verdict, seed, values)


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
