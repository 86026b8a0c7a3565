"""The settings of a mission: those that every mission has, and how a world declares, lists and reads its own."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, Self

from missions.engine.mission import Mission, MissionError, Setting

__all__ = ["Constants", "RunSettings", "SettingInfo", "describe", "setting", "split_settings", "text_setting"]


@dataclass(frozen=True, slots=True)
class SettingInfo:
    """What is known of one setting, for listing; allowed: its range, such as "0.001 to 0.01"; empty for a text."""

    name: str
    unit: str
    default: object
    meaning: str
    source: str
    allowed: str = ""


def setting(default: float, unit: str, meaning: str, source: str, low: float = 0.0, high: float = math.inf) -> Any:  # noqa: ANN401  # as of dataclasses.field: it stands where a value of the field's type would
    """Declare a number in a subclass of `Constants`; one whose default is an `int` has to be whole.

    Args:
        default: its value when nothing is set.
        unit: its unit, "-" for none.
        meaning: what it is, in a line.
        source: where the default comes from.
        low: the least that is allowed.
        high: the most that is allowed.
    """
    told = {"unit": unit, "meaning": meaning, "source": source, "low": low, "high": high}
    return field(default=default, metadata=told)


def text_setting(default: str, meaning: str, source: str) -> Any:  # noqa: ANN401  # see setting
    """Declare a text in a subclass of `Constants`."""
    return field(default=default, metadata={"unit": "-", "meaning": meaning, "source": source})


@dataclass(frozen=True, slots=True)
class Constants:
    """A subclass is a frozen dataclass, each field of which is a `setting(...)` or a `text_setting(...)`."""

    @classmethod
    def describe(cls) -> tuple[Setting, ...]:
        """List every setting, in the order of declaration."""
        return tuple(
            SettingInfo(one.name, told["unit"], one.default, told["meaning"], told["source"], _range(told))
            for one, told in ((one, one.metadata) for one in fields(cls))
        )

    @classmethod
    def read(cls, values: Mapping[str, str]) -> Self:
        """Return the settings as they are given on a command line.

        Args:
            values: by name, as texts; what is not among them has its default.

        Raises:
            MissionError: an unknown name, or a value that is not allowed.
        """
        known = {one.name: one for one in fields(cls)}
        read: dict[str, float | str] = {}
        for name, text in values.items():
            if name not in known:
                near = get_close_matches(name, known, n=3) or list(known)
                raise MissionError(f"unknown setting {name!r}; near: {', '.join(near)}")
            default, told = known[name].default, known[name].metadata
            read[name] = text if isinstance(default, str) else _number(name, text, told, isinstance(default, int))
        return cls(**read)


def _range(told: Mapping[str, Any]) -> str:
    """Return which numbers are allowed; empty for a text."""
    if "low" not in told:
        return ""
    low, high = told["low"], told["high"]
    return f"{low:g} to {high:g}" if math.isfinite(high) else f"from {low:g}"


def _number(name: str, text: str, told: Mapping[str, Any], is_whole: bool) -> float:
    low, high = told["low"], told["high"]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and low <= value <= high) or (is_whole and value != int(value)):
        kind = "whole number" if is_whole else "number of seconds" if told["unit"] == "s" else "number"
        upper = f" to {high:g}" if math.isfinite(high) else ""
        raise MissionError(f"setting {name} is {text!r}; allowed is a {kind} from {low:g}{upper}")
    return value


@dataclass(frozen=True, slots=True)
class RunSettings(Constants):
    """How a mission is run."""

    duration_s: float = setting(300.0, "s", "time limit of the mission", "as SUAVE, time-constrained mission", 0.001)
    tick_period_s: float = setting(
        0.1, "s", "from one tick of the task layer to the next", "ROSA's tree: sleep of 100 ms", 0.001
    )
    planning_delay_s: float = setting(0.2, "s", "simulated time in which a plan is found", "own choice; PDDL only")


def describe(mission: Mission) -> tuple[Setting, ...]:
    """Return every setting of a mission: how it is run, then its world."""
    return (*RunSettings.describe(), *mission.world.settings())


def split_settings(mission: Mission, values: Mapping[str, str]) -> tuple[RunSettings, dict[str, str]]:
    """Return how to run, and what remains for the world, whose values the world checks.

    Args:
        mission: whose settings.
        values: by name; a unit at the end of a name may be left out, as in start_y for start_y_m.

    Raises:
        MissionError: an unknown name or a value that is not allowed.
    """
    own = {one.name for one in fields(RunSettings)}
    full = {_without_unit(one): one.name for one in describe(mission)}
    full |= {name: name for name in full.values()}
    for name in values:
        if name not in full:
            near = get_close_matches(name, sorted(set(full.values())), n=3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"`rosa settings {mission.name}` lists them"
            raise MissionError(f"unknown setting {name!r} of mission {mission.name}; {hint}")
        if full[name] != name and full[name] in values:
            raise MissionError(f"{name} and {full[name]} are the same setting; give it once")
    values = {full[name]: value for name, value in values.items()}
    run = RunSettings.read({name: value for name, value in values.items() if name in own})
    return run, {name: value for name, value in {**mission.fixed, **values}.items() if name not in own}


def _without_unit(one: Setting) -> str:
    return one.name.removesuffix("_" + one.unit.replace("/", "_").replace(" ", "_"))
