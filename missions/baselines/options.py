"""Numbers that a manager can be given from outside, as `--set NAME=VALUE`, with where they come from."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from missions.engine.mission import MissionError

__all__ = ["Option", "split_options"]


@dataclass(frozen=True, slots=True)
class Option:
    """A number that can be set, and is 0 at least.

    Attributes:
        name: what it is called; a unit at the end may be left out when it is set.
        default: its value when nothing is set.
        unit: its unit.
        meaning: what it is, in a line.
        source: where the default comes from.
        is_published: whether it was taken from published results of the very manager: an input that makes the run a
            reproduction and no prediction, and shows as such among the figures.
    """

    name: str
    default: float
    unit: str
    meaning: str
    source: str
    is_published: bool = False

    @property
    def allowed(self) -> str:
        """Its range."""
        return "from 0"


def split_options(options: Iterable[Option], values: Mapping[str, str]) -> tuple[dict[str, float], dict[str, str]]:
    """Return the value of every option, and what of the values belongs to none.

    Raises:
        MissionError: a value is no number from 0 on, or is given twice.
    """
    own, rest = {}, dict(values)
    for option in options:
        names = [name for name in (option.name, option.name.removesuffix(f"_{option.unit}")) if name in rest]
        if len(set(names)) > 1:
            raise MissionError(f"{' and '.join(names)} are the same setting; give it once")
        own[option.name] = _number(option.name, rest.pop(names[0])) if names else option.default
    return own, rest


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise MissionError(f"setting {name} is {text!r}; allowed is a number from 0")
    return value
