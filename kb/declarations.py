"""What is accepted in the declaration of a model; anything else is refused before it changes anything."""

import math
import sys
from collections.abc import Iterable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

from kb.elements import Attribute, Element, Expression, Parameter, Parameters
from kb.exceptions import InvalidValue, ModelError, UnknownName

if TYPE_CHECKING:
    from kb.model import Model

__all__ = [
    "age",
    "choice",
    "expressions",
    "flag",
    "identifier",
    "listed",
    "parameters",
    "priority",
    "reference",
    "text",
]

_FAR = sys.float_info.max
ChoiceT = TypeVar("ChoiceT", bound=StrEnum)
ElementT = TypeVar("ElementT", bound=Element)


def identifier(kind: str, name: object) -> str:
    """Return the name of a new element."""
    if not isinstance(name, str) or not name.strip():
        article = "an" if kind[:1] in "aeiou" else "a"
        raise ModelError(f"the name of {article} {kind} is a non-empty text, not {name!r}")
    return name


def text(what: str, value: object) -> str:
    """Return a text."""
    if not isinstance(value, str):
        raise ModelError(f"{what} is a text, not {value!r}")
    return value


def flag(what: str, value: object) -> bool:
    """Return a yes or no."""
    if not isinstance(value, bool):
        raise ModelError(f"{what} is True or False, not {value!r}")
    return value


def priority(name: str, value: object) -> int | None:
    """Return a priority."""
    if value is None or (isinstance(value, int) and not isinstance(value, bool)):
        return value
    raise ModelError(f"the priority of {name!r} is a whole number or None, not {value!r}")


def age(name: str, value: object) -> float:
    """Return a maximum age [s]."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= _FAR:
        return float(value)
    if value == math.inf:
        return math.inf
    raise ModelError(f"max_age of {name!r} is a time in seconds above 0, not {value!r}")


def agreement(name: str, value: object) -> tuple[int, int]:
    """Return how many of the last measurements have to agree."""
    if isinstance(value, tuple | list) and len(value) == 2:
        enough, last = value
        if type(enough) is int and type(last) is int and 0 < enough <= last < 2 * enough:
            return enough, last
    raise ModelError(
        f"agreement of {name!r} is two whole numbers (n, k), n of the last k measurements and more than half of them, "
        f"e.g. (2, 3); not {value!r}"
    )


def span(name: str, value: object) -> float:
    """Return a hysteresis or dwell."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= _FAR:
        return float(value)
    raise ModelError(f"a hysteresis or dwell of {name!r} is a number from 0, not {value!r}")


def pid(value: object) -> int:
    """Return the number of a process."""
    if type(value) is int and value >= 0:
        return value
    raise InvalidValue(f"a process number is a whole number from 0, not {value!r}")


def choice(what: str, options: type[ChoiceT], given: object) -> ChoiceT:
    """Return one of a few words."""
    try:
        return options(str(given))
    except ValueError:
        raise UnknownName(what, given, [str(option) for option in options]) from None


def listed(what: str, values: object) -> tuple[Any, ...]:
    """Return the items of a list; one text by itself is not taken for its letters."""
    if isinstance(values, str | bytes | Element | Expression) or not isinstance(values, Iterable):
        raise ModelError(f"{what} are given as a list, not as {values!r}")
    return tuple(values)


def reference(kind: str, table: Mapping[str, ElementT], given: object, model: "Model") -> str:
    """Return the name of an element that is referred to by itself or by its name."""
    if not isinstance(given, Element):
        if isinstance(given, str) and given in table:
            return given
        raise UnknownName(kind, given, table)
    if given.model is not model:
        raise ModelError(f"{kind} {given.name!r} belongs to model {given.model.name!r}, not to {model.name!r}")
    found = table.get(given.name)
    if found is None or found is not given:
        raise ModelError(f"a {kind} is needed here, not the {type(given).__name__} {given.name!r}")
    return given.name


def expressions(model: "Model", attributes: Mapping[str, Attribute], values: object) -> tuple[Expression, ...]:
    """Return the constraints of an element, all of which can be added."""
    wanted = listed("constraints", values)
    for expression in wanted:
        if not isinstance(expression, Expression):
            raise ModelError(f"a constraint is a comparison such as `light >= 0.5`, not {expression!r}")
        if expression.model is not None and expression.model is not model:
            raise ModelError(f"{expression} compares an attribute of {expression.model.name!r}, not of {model.name!r}")
        reference("attribute", attributes, expression.attribute, model)
    return wanted


def parameters(configuration: str, values: object) -> Parameters:
    """Return the parameters of a configuration, a copy that cannot be changed."""
    if not isinstance(values, Mapping):
        raise ModelError(f"the parameters of {configuration!r} are given as values by name, not as {values!r}")
    return MappingProxyType({_key(configuration, key): _value(configuration, key, values[key]) for key in values})


def _key(configuration: str, key: object) -> str:
    if not isinstance(key, str):
        raise ModelError(f"the name of a parameter of {configuration!r} is a text, not {key!r}")
    return key


def _value(configuration: str, key: str, value: object) -> Parameter:
    if _is_scalar(value):
        return value  # type: ignore[return-value]  # a scalar: checked on the line above
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
