"""What can be set from outside: declared once, as the fields of a frozen dataclass; listed and read from there."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from math import inf, isfinite
from typing import Any, Self

Value = bool | int | float | str


class MissionError(Exception):
    """A mission cannot be run as it was asked for; the message says what was given and what is possible."""


@dataclass(frozen=True, slots=True)
class Setting:
    """What is known of one setting; the type of its default is that of its values.

    Attributes:
        name: what it is called; a unit at the end may be left out when it is set.
        default: its value when nothing is set.
        unit: its unit, "-" for none.
        meaning: what it is, in a line.
        source: where the default comes from.
        is_published: whether it was taken from published results of what it is a setting of: an input that makes the
            run a reproduction and no prediction, and shows as such among the figures.
        low, high: the bounds of a number, both allowed.
    """

    name: str
    default: Value
    unit: str
    meaning: str
    source: str
    is_published: bool = False
    low: float = 0.0
    high: float = inf

    @property
    def allowed(self) -> str:
        """Its range, such as "from 0 to 1" or "from 0"; empty if it has none."""
        bounds = () if isinstance(self.default, bool | str) else (("from", self.low), ("to", self.high))
        return " ".join(f"{word} {bound:g}" for word, bound in bounds if isfinite(bound))

    @property
    def short_name(self) -> str:
        return self.name.removesuffix("_" + self.unit.replace("/", "_").replace(" ", "_"))

    def read(self, text: str) -> Value:
        """Return the value that a text means.

        Raises:
            MissionError: it means none that is allowed.
        """
        if isinstance(self.default, str):
            return text
        value: object = text
        with suppress(ValueError, KeyError):
            truth = {"true": True, "false": False}
            value = truth[text.strip().lower()] if isinstance(self.default, bool) else float(text)
        if isinstance(value, float) and value.is_integer() and isinstance(self.default, int):
            value = int(value)
        return self.checked(text if value in (inf, -inf) else value, text)

    def checked(self, value: object, given: object = None) -> Value:
        """Return a value; MissionError if it is none that is allowed, which names what was given."""
        if isinstance(self.default, bool | str):
            allowed = "true or false" if isinstance(self.default, bool) else "a text"
            if isinstance(value, type(self.default)):
                return value
        else:
            is_whole = isinstance(self.default, int)
            kind = "a whole number" if is_whole else "a number of seconds" if self.unit == "s" else "a number"
            allowed = f"{kind} {self.allowed}".rstrip()
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if is_number and self.low <= value <= self.high and (not is_whole or float(value).is_integer()):  # type: ignore[operator,arg-type]  # is a number
                return value  # type: ignore[return-value]  # is a number
        raise MissionError(f"setting {self.name} is {given or value!r}; allowed is {allowed}")


def setting(default: Value, unit: str, meaning: str, source: str, low: float = 0.0, high: float = inf) -> Any:  # noqa: ANN401  # as of dataclasses.field: it stands where a value of the field's type would
    """Declare a setting as a field of a dataclass; see `Setting` for the arguments."""
    metadata = {"unit": unit, "meaning": meaning, "source": source, "low": low, "high": high}
    return field(default=default, metadata=metadata)


def declared(kind: Any) -> tuple[Setting, ...]:  # noqa: ANN401  # any dataclass whose fields say these things
    """List the settings that are the fields of a dataclass, in the order of declaration."""
    return tuple(Setting(one.name, one.default, **one.metadata) for one in fields(kind))  # type: ignore[arg-type]  # each has a default


@dataclass(frozen=True, slots=True)
class Constants:
    """A subclass is a frozen dataclass, each field of which is a `setting(...)`; it refuses what is not allowed."""

    def __post_init__(self) -> None:
        for one in declared(type(self)):
            one.checked(getattr(self, one.name))

    @classmethod
    def read(cls, values: Mapping[str, str]) -> Self:
        """Return the settings as they are given on a command line, by name; what is not among them has its default.

        Raises:
            MissionError: an unknown name, or a value that is not allowed.
        """
        return cls(**read_values(declared(cls), values))


@dataclass(frozen=True, slots=True)
class RunSettings(Constants):
    """How a mission is run."""

    duration_s: float = setting(300.0, "s", "time limit of the mission", "as SUAVE, time-constrained mission", 0.001)
    tick_period_s: float = setting(0.1, "s", "from a tick of the task layer to the next", "ROSA's tree: 100 ms", 0.001)
    planning_delay_s: float = setting(0.2, "s", "simulated time in which a plan is found", "own choice; PDDL only")


def own_values(settings: Iterable[Setting], values: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return which values belong to settings, by their full names, and which to none of them.

    Raises:
        MissionError: a setting is given twice, with and without its unit.
    """
    own: dict[str, str] = {}
    rest = dict(values)
    for one in settings:
        given = [name for name in dict.fromkeys((one.short_name, one.name)) if name in rest]
        if len(given) > 1:
            raise MissionError(f"{' and '.join(given)} are the same setting; give it once")
        if given:
            own[one.name] = rest.pop(given[0])
    return own, rest


def read_values(settings: Iterable[Setting], values: Mapping[str, str]) -> dict[str, Any]:
    """Return what texts mean, by full names of settings.

    Raises:
        MissionError: an unknown name, or a value that is not allowed.
    """
    known = {one.name: one for one in settings}
    for name in values:
        if name not in known:
            raise MissionError(f"unknown setting {name!r}; near: {', '.join(near(name, known) or known)}")
    return {name: known[name].read(text) for name, text in values.items()}


def near(name: str, known: Iterable[str]) -> list[str]:
    return get_close_matches(name, sorted(known), n=3)
