"""Values of blackboards, ports and scripts, and how each is read as another kind.

Whole numbers are int, doubles float, texts str; a value that the program or a port declares as bool
stays a bool.
"""

import json
import re
from collections.abc import Callable, Mapping
from typing import Any, get_args, get_origin

from py_trees.common import Status
from py_trees.ports_utils import convert_str_to_type, is_instance_of_type

from rosa_bt.exceptions import RosaBtError

Value = Any
"""A text, a number, whatever the program wrote, or `EMPTY`."""


class ScriptError(RosaBtError, ValueError):
    """A script cannot be read, or fails when it runs."""


class _Empty:
    """The value of an entry that is still empty."""

    def __repr__(self) -> str:
        return "what has no value"


EMPTY = _Empty()
_EXACT = 2**53  # from here on, a double cannot hold every whole number
_WHOLE = re.compile(r"-?\d+", re.ASCII)
_NUMBER = re.compile(
    r"\s*[-+]?(?:0x[0-9a-f]+|inf|nan|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", re.IGNORECASE | re.ASCII
)
BOOLS = {
    **dict.fromkeys(("1", "true", "TRUE", "True"), True),
    **dict.fromkeys(("0", "false", "FALSE", "False"), False),
}
_WORDS: Mapping[Any, Mapping[str, Value]] = {
    bool: BOOLS,
    Status: {**Status.__members__, "SKIPPED": Status.INVALID},
}


def is_number(value: object) -> bool:
    return isinstance(value, int | float)


def double(value: Value) -> float:
    if not is_number(value):
        raise ScriptError(f"{value!r} is no number")
    if isinstance(value, int) and abs(value) >= _EXACT:
        raise ScriptError(f"{value} is too large for a double to hold exactly")
    return float(value)


def whole(value: Value) -> int:
    if not is_number(value) or value % 1 != 0:
        raise ScriptError(f"{value!r} is not whole, and a whole number is needed")
    if abs(value) >= 2**63:
        raise ScriptError(f"{value:g} is out of the range of whole numbers, which have 64 bits")
    return int(value)


def truth(value: Value) -> bool:
    """Return the truth of a value: a double is true unless 0, a whole number is 1 or 0."""
    if isinstance(value, float) or value in (0, 1):
        return bool(value)
    raise ScriptError(f"{value!r} is neither true nor false; compare it with something")


def as_text(value: Value) -> str:
    """Return a value as text, as `..` in scripts does: a double with six decimals."""
    if isinstance(value, float):
        return f"{value:.6f}"
    return str(int(value) if isinstance(value, bool) else value)


CASTS: Mapping[Any, Callable[[Value], Value]] = {
    **{bool: truth, int: whole, float: double, str: as_text}
}


def begun(text: str) -> float:
    """Return the number at the beginning of a text, as the C library (`strtod`) reads it."""
    match = _NUMBER.match(text)
    if match is None:
        raise ScriptError(f"{text!r} is no number")
    return float(int(match[0], 16)) if "x" in match[0].lower() else float(match[0])


def fit(value: Value, before: Value) -> Value:
    """Return a value as the kind of value that an entry had before.

    Raises:
        ScriptError: the value cannot be converted.
    """
    if is_number(before) and is_number(value):
        if isinstance(before, float):
            return double(value)
        is_bool = isinstance(before, bool) and value in (0, 1)
        return bool(value) if is_bool else whole(value)
    both_texts = isinstance(before, str) and isinstance(value, str)
    if before is EMPTY or type(before) is type(value) or both_texts:
        return value
    raise ScriptError(f"{value!r} does not fit an entry that holds {before!r}")


def converted(text: str, wanted: Any) -> Value:  # noqa: ANN401  # a type of values
    """Return a text as a type: numbers by their beginning, lists as `1;2;3`, or `json:...`.

    Raises:
        ValueError, TypeError: the text has no meaning as that type.
    """
    if wanted in (None, Any, object, str):
        return text
    if text.startswith("json:"):
        value = json.loads(text[5:])
        if is_instance_of_type(value, wanted):
            return value
    elif wanted in _WORDS:
        if text in _WORDS[wanted]:
            return _WORDS[wanted][text]
    elif wanted is float:
        return begun(text)
    elif wanted is int:
        match = _WHOLE.match(text)
        if match and -(2**31) <= int(match[0]) < 2**31:
            return int(match[0])
    elif get_origin(wanted) is list:
        parts = text.removesuffix(";").split(";") if text else []
        return [converted(part, get_args(wanted)[0]) for part in parts]
    else:
        is_right, value = convert_str_to_type(text, wanted)
        if is_right:
            return value
    raise ValueError(f"{text!r} is no {type_name(wanted)}")


def literal(text: str) -> int | float | str:
    """Return the value of a literal of a SubTree: a whole number, a double, or a text."""
    if re.fullmatch(r"-?\d+", text, re.ASCII):
        return int(text)
    if re.fullmatch(r"-?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text, re.IGNORECASE | re.ASCII):
        return float(text)
    return text


def type_name(wanted: Any) -> str:  # noqa: ANN401  # a type of values
    return getattr(wanted, "__name__", str(wanted))
