"""Settings: declared once, as fields of a frozen dataclass, from which they are listed, read and checked."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from math import inf, isfinite
from typing import Any, Self

Value = bool | int | float | str


class MissionError(Exception):
    """Something cannot be done as asked; the message says what was given, what exists and what to do."""


@dataclass(frozen=True, slots=True)
class Setting:
    """The declaration of one setting; its values have the type of its default.

    Attributes:
        name: with the unit at the end, which may be left out when it is set.
        default: its value when it is not set.
        unit: its unit, "-" for none.
        meaning: what it is, in a line.
        source: where the default comes from.
        is_published: whether the value is taken from the published results that a run is compared with. Such a run
            reproduces instead of predicting; the setting is then shown among its figures.
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
        bounds = (
            () if isinstance(self.default, bool | str) else (("from", self.low), ("to", self.high))
        )
        return " ".join(f"{word} {bound:g}" for word, bound in bounds if isfinite(bound))

    @property
    def short_name(self) -> str:
        return self.name.removesuffix("_" + self.unit.replace("/", "_").replace(" ", "_"))

    def read(self, given: object) -> Value:
        """Return a value, or the value that a text means; a whole number is written without a point.

        Raises:
            MissionError: the value is not allowed; the message says what is.
        """
        kind = type(self.default)
        value: Any = _meant(given, kind) if isinstance(given, str) else given
        if kind in (bool, str):
            is_allowed = isinstance(value, kind)
        else:
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            is_fit = is_number and (kind is float or value % 1 == 0)
            is_allowed = is_fit and self.low <= value <= self.high
        if is_allowed:
            return value  # type: ignore[no-any-return]  # it was checked
        what = {bool: "true or false", str: "a text", int: "a whole number", float: "a number"}[
            kind
        ]
        what += " of seconds" if kind is float and self.unit == "s" else ""
        raise MissionError(
            f"setting {self.name} is {given!r}; allowed is {what} {self.allowed}".rstrip()
        )


def _meant(text: str, kind: type[Value]) -> Value:
    """Convert a text to a value of some type; return the text itself if that fails, or the number is infinite."""
    if kind is bool:
        return {"true": True, "false": False}.get(text.strip().lower(), text)
    with suppress(ValueError):
        value = kind(text)
        return text if value in (inf, -inf) else value
    return text


def setting(
    default: Value, unit: str, meaning: str, source: str, low: float = 0.0, high: float = inf
) -> Any:  # noqa: ANN401  # as dataclasses.field: it stands where a value of the field's type would
    """Declare a setting as a field of a dataclass; see `Setting` for the arguments."""
    metadata = {"unit": unit, "meaning": meaning, "source": source, "low": low, "high": high}
    return field(default=default, metadata=metadata)


def declared(kind: Any) -> tuple[Setting, ...]:  # noqa: ANN401  # any dataclass with such fields
    """Return the settings that a dataclass declares, in order."""
    return tuple(Setting(one.name, one.default, **one.metadata) for one in fields(kind))  # type: ignore[arg-type]  # each has a default


@dataclass(frozen=True, slots=True)
class Constants:
    """Base of settings: a subclass is a frozen dataclass whose fields are `setting(...)`; it refuses wrong values."""

    def __post_init__(self) -> None:
        for one in declared(type(self)):
            one.read(getattr(self, one.name))

    @classmethod
    def read(cls, values: Mapping[str, object]) -> Self:
        """Return the settings given as texts by name, as on a command line; the others have their defaults.

        Raises:
            MissionError: an unknown name, or a value that is not allowed.
        """
        return cls(**read_values(declared(cls), values))


@dataclass(frozen=True, slots=True)
class RunSettings(Constants):
    """How a mission is run."""

    duration_s: float = setting(
        300.0, "s", "time limit of the mission", "own choice: five minutes", 0.001
    )
    tick_period_s: float = setting(
        0.1, "s", "from a tick of the task layer to the next", "ROSA's tree: 100 ms", 0.001
    )
    planning_delay_s: float = setting(
        0.2, "s", "simulated time in which a plan is found", "own choice; PDDL only"
    )


def full_names(
    settings: Iterable[Setting], values: Mapping[str, Any], mission: str = ""
) -> dict[str, Any]:
    """Return values by full names of settings; in the given names the unit at the end may be left out.

    Raises:
        MissionError: an unknown name, or a setting that is given twice, with and without its unit.
    """
    named: dict[str, Any] = {}
    rest = dict(values)
    for one in settings:
        given = [name for name in dict.fromkeys((one.short_name, one.name)) if name in rest]
        if len(given) > 1:
            raise MissionError(f"{' and '.join(given)} are the same setting; give it once")
        if given:
            named[one.name] = rest.pop(given[0])
    for name in rest:
        known = [one.name for one in settings]
        close = near(name, known)
        is_long = mission and len(known) >= 20
        some = (
            f"`rosa settings {mission}` lists them" if is_long else f"there are {', '.join(known)}"
        )
        hint = f"did you mean {' or '.join(close)}?" if close else some
        raise MissionError(
            f"unknown setting {name!r}{f' of mission {mission}' if mission else ''}; {hint}"
        )
    return named


def read_values(settings: Iterable[Setting], values: Mapping[str, object]) -> dict[str, Any]:
    """Return the values that texts mean, by full names; raises MissionError as `full_names` and `Setting.read` do."""
    known = {one.name: one for one in settings}
    return {
        name: known[name].read(text) for name, text in full_names(known.values(), values).items()
    }


def near(name: str, known: Iterable[str]) -> list[str]:
    return get_close_matches(name, sorted(known), n=3)
