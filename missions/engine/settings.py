"""Settings: declared once, as fields of a frozen dataclass, then listed, read and checked."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from math import inf, isfinite
from pathlib import Path
from typing import Any, Final, Self, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")
Value = bool | int | float | str

_KINDS: Final[Mapping[Any, str]] = {
    bool: "true or false",
    str: "a text",
    int: "a whole number",
    float: "a number",
    tuple: "a list",
    Mapping: "a table",
}


_TRUTHS: Final = {"true": True, "false": False}


class MissionError(Exception):
    """Something cannot be done as asked; the message says what was given, and what to do."""


@dataclass(frozen=True, slots=True)
class Setting:
    """The declaration of one setting; its values have the type of its default.

    Attributes:
        name: with the unit at the end, which may be left out when it is set.
        default: its value when it is not set.
        unit: its unit, "-" for none.
        meaning: what it is, in a line.
        source: where the default comes from.
        is_published: whether the value is taken from the published results that a run is compared
            with. Such a run reproduces instead of predicting; the setting is shown among its
            figures.
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
        if isinstance(self.default, bool | str):
            return ""
        bounds = (("from", self.low), ("to", self.high))
        return " ".join(f"{word} {bound:g}" for word, bound in bounds if isfinite(bound))

    @property
    def short_name(self) -> str:
        return self.name.removesuffix("_" + self.unit.replace("/", "_").replace(" ", "_"))

    def read(self, source: object) -> Value:
        """Return a value, or the value that a text means.

        Raises:
            MissionError: the value is not allowed; the message says what is.
        """
        kind = type(self.default)
        value: Any = _parse(source, kind) if isinstance(source, str) else source
        is_allowed = isinstance(value, kind)
        if kind in (int, float):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            is_allowed = is_number and isfinite(value) and self.low <= value <= self.high
            is_allowed = is_allowed and (kind is float or value % 1 == 0)
        if is_allowed:
            return value  # type: ignore[no-any-return]  # it was checked
        unit = " of seconds" if kind is float and self.unit == "s" else ""
        text = f"{_KINDS[kind]}{unit} {self.allowed}".rstrip()
        raise MissionError(f"setting {self.name} is {source!r}; allowed is {text}")


def _parse(text: str, kind: type[Value]) -> Value:
    """Return the value that a text means; the text itself if it is none."""
    try:
        return _TRUTHS[text.strip().lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        return text


def setting(
    default: Value, unit: str, meaning: str, source: str, low: float = 0.0, high: float = inf
) -> Any:  # noqa: ANN401  # as dataclasses.field: it stands where a value of the field's type would
    """Declare a setting as a field of a dataclass; see `Setting` for the arguments."""
    metadata = {"unit": unit, "meaning": meaning, "source": source, "low": low, "high": high}
    return field(default=default, metadata=metadata)


def declared(kind: Any) -> tuple[Setting, ...]:  # noqa: ANN401  # any dataclass with such fields
    """Return the settings that a dataclass declares, in order."""
    return tuple(Setting(part.name, part.default, **part.metadata) for part in fields(kind))  # type: ignore[arg-type]  # each has a default


@dataclass(frozen=True, slots=True)
class Constants:
    """Base of settings: a subclass is a frozen dataclass whose fields are `setting(...)`.

    Raises:
        MissionError: a value is not allowed.
    """

    def __post_init__(self) -> None:
        for part in declared(type(self)):
            part.read(getattr(self, part.name))

    @classmethod
    def read(cls, values: Mapping[str, object]) -> Self:
        """Return the settings with texts by name, as on a command line; others have defaults.

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
    plan_ahead: bool = setting(
        False, "-", "plan no step that outlasts its action, by the forecasts", "PDDL only"
    )


def read_values(
    settings: Iterable[Setting], values: Mapping[str, object], mission: str = ""
) -> dict[str, Any]:
    """Return the values that texts mean, by full names; units may be missing in the given ones.

    Raises:
        MissionError: an unknown name, or a value that is not allowed.
    """
    by_name = {part.name: part for part in settings}
    names = [*by_name]
    by_name |= {part.short_name: part for part in by_name.values()} | by_name
    read: dict[str, Any] = {}
    for name, value in values.items():
        if name not in by_name:
            close = near(name, names)
            existing = f"there are {', '.join(names)}"
            if mission:
                existing = f"`rosa settings {mission}` lists them"
            hint = f"did you mean {' or '.join(close)}?" if close else existing
            owner = f" of mission {mission}" if mission else ""
            raise MissionError(f"unknown setting {name!r}{owner}; {hint}")
        part = by_name[name]
        read[part.name] = part.read(value)
    return read


def near(name: str, names: Iterable[str]) -> list[str]:
    """Return the nearest of these names."""
    return get_close_matches(name, sorted(names), n=3)


# ------------------------------------------------------------ tables of a file


def read_toml(path: Path) -> dict[str, Any]:
    """Read the tables of a TOML file.

    Raises:
        MissionError: it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MissionError(f"cannot read {path}: {reason}") from None


def from_table(kind: type[T], table: Mapping[str, Any], source: str) -> T:
    """Return a dataclass with the values of a table, whose keys are its fields.

    Raises:
        MissionError: a key is unknown or a value of another type; the message names the source.
    """
    types = get_type_hints(kind)
    values = {}
    for name, value in table.items():
        if name not in types:
            close = near(name, types)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(types)}"
            raise MissionError(f"{source}: unknown key {name!r}; {hint}")
        try:
            values[name] = _typed(value, types[name])
        except TypeError as error:
            raise MissionError(f"{source}: {name} is {value!r}; expected is {error}") from None
    return kind(**values)


def _typed(value: Any, kind: Any) -> Any:  # noqa: ANN401  # a value of a file, and an annotation
    """Return a value as this type; a number is a text, too. TypeError says what is expected."""
    origin = get_origin(kind) or kind
    if origin is tuple and isinstance(value, list | tuple):
        return tuple(_typed(item, get_args(kind)[0]) for item in value)
    if origin is Mapping and isinstance(value, dict):
        return {name: _typed(item, get_args(kind)[1]) for name, item in value.items()}
    if kind is str and isinstance(value, int | float):
        return str(value).lower()
    if kind is Any or isinstance(value, int | float if kind is float else origin):
        return value
    raise TypeError(_KINDS[origin])
