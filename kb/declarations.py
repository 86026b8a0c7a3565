"""What can be given for a field of an element: each check returns it as it is kept, or says what would be right."""

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Any, NamedTuple, TypeGuard, TypeVar

from kb.exceptions import InvalidValue, ModelError, UnknownName

ChoiceT = TypeVar("ChoiceT", bound=StrEnum)


class Field(NamedTuple):
    """How a field of an element is given; stands in its annotation.

    Attributes:
        check: takes the field's name, the element's name and what is given; returns it as it is kept.
        can_change: `Model.change` may give it anew.
    """

    check: Callable[[str, str, Any], object]
    can_change: bool = True


def identifier(kind: str, name: object) -> str:
    """Return the name of a new element."""
    if not isinstance(name, str) or not name.strip():
        article = "an" if kind[:1] in "aeiou" else "a"
        raise ModelError(f"the name of {article} {kind} is a non-empty text, not {name!r}")
    return name


def text(what: str, value: object) -> str:
    if not isinstance(value, str):
        raise ModelError(f"{what} is a text, not {value!r}")
    return value


def flag(what: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise ModelError(f"{what} is True or False, not {value!r}")
    return value


def priority(field: str, name: str, value: object) -> float | None:
    """Return a priority: any finite real number, or None."""
    if value is None or (_is_number(value) and (isinstance(value, int) or math.isfinite(value))):
        return value
    raise ModelError(f"the {field} of {name!r} is a finite number or None, not {value!r}")


def age(field: str, name: str, value: object) -> float:
    """Return a maximum age [s]."""
    if _is_number(value) and (0 < value <= sys.float_info.max or value == math.inf):
        return float(value)
    raise ModelError(f"{field} of {name!r} is a time in seconds above 0, not {value!r}")


def span(field: str, name: str, value: object) -> float:
    """Return a hysteresis or dwell."""
    if _is_number(value) and 0 <= value <= sys.float_info.max:
        return float(value)
    raise ModelError(f"the {field} of {name!r} is a number from 0, not {value!r}")


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def agreement(field: str, name: str, value: object) -> tuple[int, int]:
    """Return how many of the last measurements have to agree."""
    if isinstance(value, tuple | list) and len(value) == 2:
        enough, last = value
        if type(enough) is int and type(last) is int and 0 < enough <= last < 2 * enough:
            return enough, last
    raise ModelError(
        f"{field} of {name!r} is two whole numbers (n, k), n of the last k measurements and more than half of them, "
        f"e.g. (2, 3); not {value!r}"
    )


def pid(value: object) -> int:
    """Return the number of a process."""
    if type(value) is int and value >= 0:
        return value
    raise InvalidValue(f"a process number is a whole number from 0, not {value!r}")


def choice(what: str, options: type[ChoiceT], given: object) -> ChoiceT:
    """Return one of a few words."""
    if isinstance(given, options):
        return given
    try:
        return options(str(given))
    except ValueError:
        raise UnknownName(what, given, [str(option) for option in options]) from None


def listed(what: str, values: object) -> tuple[Any, ...]:
    """Return the items of a list; one text by itself is not taken for its letters."""
    if not isinstance(values, tuple | list) and (isinstance(values, str | bytes) or not isinstance(values, Iterable)):
        raise ModelError(f"{what} are given as a list, not as {values!r}")
    return tuple(values)


def parameters(configuration: str, values: object) -> Mapping[str, Any]:
    """Return the parameters of a configuration, a copy that cannot be changed."""
    if not isinstance(values, Mapping):
        raise ModelError(f"the parameters of {configuration!r} are given as values by name, not as {values!r}")
    for key in values:
        if not isinstance(key, str):
            raise ModelError(f"the name of a parameter of {configuration!r} is a text, not {key!r}")
    return MappingProxyType({key: _parameter(configuration, key, value) for key, value in values.items()})


def _parameter(configuration: str, key: str, value: object) -> object:
    if _is_scalar(value):
        return value
    if isinstance(value, list | tuple) and all(_is_scalar(item) for item in value):
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if len(kinds) <= 1:
            return list(value)
    raise ModelError(
        f"parameter {key!r} of configuration {configuration!r} is {value!r}; "
        "allowed are a boolean, a finite number, a text, or a list of one of these"
    )


def _is_scalar(value: object) -> bool:
    return isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value))
