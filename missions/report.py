"""What came of a run: as data that depends on nothing but mission, settings and seed, and as a table."""

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Final

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from missions.baselines.reactions import Reaction
from missions.baselines.watch import WatchedSea
from missions.engine.adaptations import Adaptation
from missions.engine.mission import Verdict
from missions.engine.runner import MissionRun

__all__ = ["adaptation_table", "as_json", "figure_in_words", "summary", "timing"]

SIGNS: Final = {"j": "J", "w": "W", "percent": "%"}
"""How units are written that a name has in small letters or in full."""


def summary(run: MissionRun, verdict: Verdict, seed: int, changed: Mapping[str, str]) -> dict[str, Any]:
    """Return a finished run as plain data; times in [s], units in the names.

    Args:
        run: the run, ended.
        verdict: how it ended.
        seed: of all its chance.
        changed: the settings that were given.
    """
    results = run.world.results()
    return {
        "mission": run.mission.name,
        "task": run.task,
        "manager": run.manager,
        "seed": seed,
        "settings": dict(sorted(changed.items())),
        "outcome": verdict.outcome,
        "outcome_reason": verdict.reason,
        "duration_s": run.world.now,
        **results,
        "adaptations": [
            {
                "at_s": one.at_s,
                "kind": one.kind,
                "trigger": one.trigger,
                "reason": one.reason,
                "change": one.change,
                "reaction_s": one.reaction_s,
            }
            for one in run.adaptations
        ],
        "actions": [
            {
                "name": one.action,
                "start_s": one.start,
                "end_s": one.end,
                "result": one.result,
                "reason": one.reason,
            }
            for one in run.kb.action_history
        ],
        "plans": [
            {
                "at_s": plan.at_s,
                "reason": plan.reason,
                "outcome": str(plan.outcome),
                "engine": plan.engine,
                "steps": [str(step) for step in plan.steps],
            }
            for plan in run.plans
        ],
        "reactions": [
            {"uncertainty": one.uncertainty, "start_s": one.start_s, "delay_s": one.delay_s}
            for one, _ in _reactions(run)
        ],
        "disturbances": [{"at_s": time, "what": text} for time, text in run.world.disturbances()],
        "diagnostics_problems": [{"at_s": time, "problem": str(problem)} for time, problem in run.problems],
    }


def as_json(data: Mapping[str, Any]) -> str:
    """Write data as JSON text; numbers to 6 decimals, so that no rounding of sums shows."""
    return json.dumps(_rounded(data), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def timing(run: MissionRun, wall_s: float) -> dict[str, Any]:
    """Return how long a run took on this machine: whole, and the compute time of each part and each reaction [s]."""
    return {
        "simulated_s": run.world.now,
        "wall_s": wall_s,
        "simulated_s_per_wall_s": run.world.now / wall_s,
        "compute_s": dict(run.compute_s),
        "reactions": [
            {"uncertainty": one.uncertainty, "start_s": one.start_s, "compute_s": computed_s}
            for one, computed_s in _reactions(run)
        ],
    }


def figure_in_words(name: str, value: float | None) -> tuple[str, str, str]:
    """Return what a figure is of, its unit and its value: "energy_used_j" is "energy used", "J" and "3152.6".

    The unit is empty if the name has none; a value that did not come about is "-".
    """
    words, _, unit = name.rpartition("_")
    if value is None:
        shown = "-"
    elif float(value).is_integer() and (not words or len(unit) > 3):  # a count of something, not an amount of a unit
        shown = f"{value:.0f}"
    else:
        shown = f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"
    return (words.replace("_", " "), SIGNS.get(unit, unit), shown) if words else (name, "", shown)


def adaptation_table(adaptations: Iterable[Adaptation]) -> Table:
    """Return a table of adaptations: when, what, what set it off and why, how fast."""
    table = Table(expand=True, box=SIMPLE_HEAD, pad_edge=False)
    table.add_column(escape("at [s]"), justify="right", no_wrap=True)
    table.add_column("kind", no_wrap=True)
    table.add_column("what was changed", ratio=4)
    table.add_column("why", ratio=4)
    table.add_column(escape("reaction [s]"), justify="right", no_wrap=True)
    for one in adaptations:
        reaction = "-" if one.reaction_s is None else f"{one.reaction_s:.2f}"
        why = one.reason if one.reason.startswith(one.trigger) else f"{one.trigger}: {one.reason}"
        table.add_row(f"{one.at_s:.1f}", one.kind, escape(one.change), escape(why), reaction)
    return table


def _reactions(run: MissionRun) -> list[tuple[Reaction, float]]:
    """Return each reaction of a run in the sea with the time of this machine that went into it [s]."""
    sea = run.world
    return [(one, sea.compute_s(one)) for one in sea.reactions] if isinstance(sea, WatchedSea) else []


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return value
