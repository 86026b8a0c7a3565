"""The settings that every mission has, whatever its world."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches

from missions.mission import Mission, MissionError, Setting

__all__ = ["RunSettings", "describe", "split_settings"]


@dataclass(frozen=True, slots=True)
class _Described:
    name: str
    unit: str
    default: object
    meaning: str
    source: str


def _seconds(default: float, meaning: str, source: str, least: float = 0.0) -> float:
    metadata = {"unit": "s", "meaning": meaning, "source": source, "least": least}
    value: float = field(default=default, metadata=metadata)
    return value


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How a mission is run."""

    duration_s: float = _seconds(300.0, "time limit of the mission", "as SUAVE, time-constrained mission", least=0.001)
    tick_period_s: float = _seconds(
        0.1, "from one tick of the task layer to the next", "ROSA's tree: sleep of 100 ms", least=0.001
    )
    planning_delay_s: float = _seconds(0.2, "simulated time in which a plan is found", "own choice; PDDL only")


def describe(mission: Mission) -> tuple[Setting, ...]:
    """Return every setting of a mission: how it is run, then its world."""
    own = tuple(
        _Described(one.name, one.metadata["unit"], one.default, one.metadata["meaning"], one.metadata["source"])
        for one in fields(RunSettings)
    )
    return (*own, *mission.world.settings())


def split_settings(mission: Mission, values: Mapping[str, str]) -> tuple[RunSettings, dict[str, str]]:
    """Return how to run, and what remains for the world, whose values the world checks.

    Args:
        mission: whose settings.
        values: by name; a unit at the end of a name may be left out, as in start_y for start_y_m.

    Raises:
        MissionError: an unknown name or a value that is not allowed.
    """
    own = {one.name for one in fields(RunSettings)}
    full = {_without_unit(setting): setting.name for setting in describe(mission)}
    full |= {name: name for name in full.values()}
    for name in values:
        if name not in full:
            near = get_close_matches(name, sorted(set(full.values())), n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"`rosa settings {mission.name}` lists them"
            raise MissionError(f"unknown setting {name!r} of mission {mission.name}; {hint}")
        if full[name] != name and full[name] in values:
            raise MissionError(f"{name} and {full[name]} are the same setting; give it once")
    values = {full[name]: value for name, value in values.items()}
    least = {one.name: float(one.metadata["least"]) for one in fields(RunSettings)}
    run = RunSettings(**{name: _seconds_of(name, values[name], least[name]) for name in values if name in own})
    return run, {name: value for name, value in {**mission.fixed, **values}.items() if name not in own}


def _without_unit(setting: Setting) -> str:
    return setting.name.removesuffix("_" + setting.unit.replace("/", "_").replace(" ", "_"))


def _seconds_of(name: str, text: str, least: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        raise MissionError(f"setting {name} is {text!r}; allowed is a number of seconds from {least:g}")
    return value
