"""One run of a campaign, done by a worker: what came of it as plain data, also if it crashed."""

import hashlib
import json
import platform
import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter
from typing import Any

from missions.baselines import open_run
from missions.engine.registry import find_mission
from missions.engine.runner import MissionRun
from missions.experiments.campaign import PlannedRun
from missions.views.output import as_json, summary

CRASHED = "crashed"
"""Outcome of a run that raised an exception or took its process down with it."""

PACKAGES = ("kb", "rosa_bt", "rosa_pddl", "suave_env", "missions")
DISTRIBUTIONS = ("rosa-taca", "mujoco", "numpy", "ortools", "py-trees", "unified-planning", "up-fast-downward")
_ALONE = threading.Lock()


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a run.

    Attributes:
        run: which one.
        code: fingerprint of the code that ran it; see `provenance`.
        record: its figures: they depend on nothing but the name of the run and the code.
        timing: how long it took on the machine that did it.
        traceback: where it crashed, for a person to read; empty if it did not.
    """

    run: PlannedRun
    code: str
    record: Mapping[str, Any]
    timing: Mapping[str, Any] = field(default_factory=dict)
    traceback: str = ""


def do(run: PlannedRun) -> Outcome:
    """Do a run and return what came of it; never raises what the run raises.

    A process does one run at a time, as the blackboard of py_trees belongs to the process.
    """
    with _ALONE:
        started = perf_counter()
        try:
            record, timing = _done(run)
        except (Exception, SystemExit) as error:
            return crash(run, f"{type(error).__name__}: {error}", traceback.format_exc())
        return Outcome(
            run, provenance()["code"], record, {"run": run.name, "wall_s": perf_counter() - started} | timing
        )


def crash(run: PlannedRun, error: str, trace: str = "") -> Outcome:
    """Return the outcome of a run that crashed, with what does it again."""
    record = {**_head(run), "outcome": CRASHED, "error": error, "rerun": run.command}
    return Outcome(run, provenance()["code"], record, {}, trace)


@cache
def provenance() -> Mapping[str, str]:
    """Return what results depend on beside a run's name: versions, and a fingerprint of our own code."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and path.suffix not in (".pyc", ""):
                digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return {
        "code": digest.hexdigest()[:12],
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: _version(name) for name in DISTRIBUTIONS},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _head(run: PlannedRun) -> dict[str, Any]:
    return {
        "run": run.name,
        "mission": run.mission,
        "manager": run.manager,
        "task": run.task,
        "seed": run.seed,
        "settings": dict(run.settings),
    }


def _done(run: PlannedRun) -> tuple[dict[str, Any], dict[str, Any]]:
    settings = dict(run.settings)
    opened = open_run(
        find_mission(run.mission), manager=run.manager, task=run.task or "bt", seed=run.seed, settings=settings
    )
    verdict = opened.run()
    data = json.loads(as_json(summary(opened, verdict, run.seed, settings)))
    figures = {name: value for name, value in data.items() if not isinstance(value, dict | list)}
    reactions, thought = _reactions(opened)
    record = {**figures, **_head(run), "adaptations": len(opened.adaptations), "reactions": reactions}
    return {**_head(run), **record}, {"compute_s": opened.compute_s, "reactions": thought}


def _reactions(run: MissionRun) -> tuple[list[Any], list[Any]]:
    """Return each reaction as uncertainty, start and delay [s], and with the time of this machine spent on it [s]."""
    found = run.reactions
    told = [[one.uncertainty, round(one.start_s, 6), round(one.delay_s, 6)] for one, _ in found]
    return told, [[one.uncertainty, took_s] for one, took_s in found]
