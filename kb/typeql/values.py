"""Values in TypeQL files, both ways: texts with escapes, numbers, dates, and the typed parameters of components."""

import ast
import json
import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Final

from kb.elements import Parameter
from kb.exceptions import UnknownName
from kb.files import Place
from kb.typeql.syntax import Word
from kb.typeql.words import Field, Value

__all__ = ["Literal", "checked", "literal", "parameter", "quoted", "seconds", "written_parameter", "written_time"]

Literal = bool | int | float | str | datetime

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_ESCAPE: Final = re.compile(r"\\(u[0-9a-fA-F]{4}|[\s\S])")
_ESCAPED: Final = {"n": "\n", "t": "\t", "r": "\r", "0": "\0", "\\": "\\", '"': '"', "'": "'"}
_UNSAFE: Final = re.compile(r'[\\"\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]')
_TYPES: Final[Mapping[Value, tuple[type, ...]]] = {
    Value.TEXT: (str,),
    Value.FLAG: (bool,),
    Value.WHOLE: (int,),
    Value.NUMBER: (int, float),
    Value.TIME: (datetime,),
    Value.ANY: (str, bool, int, float),
}


def literal(word: Word, place: Place) -> Literal:
    """Return what a written value stands for; a date without a zone is in UTC."""
    text = str(word)
    if word.type == "STRING":
        return _ESCAPE.sub(_unescaped, text[1:-1]) if "\\" in text else text[1:-1]
    if word.type == "BOOLEAN":
        return text == "true"
    try:
        if word.type == "DATETIME":
            moment = datetime.fromisoformat(text)
            return moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        return int(text) if re.fullmatch(r"[+-]?\d+", text) else float(text)
    except ValueError as error:
        raise place.error(f"`{text:.40}` is no value: {error!s:.60}") from None


def checked(field: Field, value: Literal, label: str, place: Place) -> Literal:
    """Return the value of an attribute, of the type that the attribute has."""
    if isinstance(value, float) and field.value is Value.WHOLE and value.is_integer():
        return int(value)
    allowed = _TYPES[field.value]
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
        raise place.error(f"{label} is {field.value}, not {_shown(value)}")
    if isinstance(value, float) and not math.isfinite(value):
        raise place.error(f"{label} is a finite number, not {value!r}")
    return value


def seconds(moment: datetime) -> float:
    """Return a time in seconds since 1970-01-01 UTC."""
    return (moment - _EPOCH) / timedelta(seconds=1)


def written_time(time: float) -> str | None:
    """Write a time [s since 1970-01-01 UTC] as a date, or return None where that would not say exactly the same."""
    try:
        moment = _EPOCH + timedelta(milliseconds=round(time * 1000))
    except (OverflowError, ValueError):
        return None
    text = moment.replace(tzinfo=None).isoformat(timespec="milliseconds")
    return text if seconds(datetime.fromisoformat(text).replace(tzinfo=UTC)) == time else None


def quoted(text: str) -> str:
    """Write a text so that it is read back as it is."""
    return f'"{_UNSAFE.sub(_escaped, text)}"'


def parameter(value: Literal, type_name: str | None, place: Place) -> Parameter:
    """Return the value of a component parameter, of its type.

    Args:
        value: as written; a text is read as the type says, e.g. `"[3.0, 5.0]"` as a `double_array`.
        type_name: one of ROSA's types or ROS's names for them; None for a text, or what stands there without quotes.
        place: where it is written.
    """
    if type_name is None:
        return value  # type: ignore[return-value]  # no date: `checked` has seen to that
    word = re.sub(r"[-\s]", "_", type_name.strip().lower()).removeprefix("parameter_").replace("[]", "_array")
    base = word.removesuffix("_array")
    if base not in _READERS:
        known = [*dict.fromkeys(_ROSA_TYPES.values()), *(f"{one}_array" for one in _ROSA_TYPES.values())]
        raise place.error(str(UnknownName("parameter type", type_name, known)))
    try:
        if word == base:
            return _READERS[base](value)
        return [_READERS[base](item) for item in _items(value, base)]  # type: ignore[return-value]  # all of one type
    except ValueError:
        raise place.error(f"{_shown(value)} cannot be read as {type_name}") from None


def written_parameter(value: Parameter) -> tuple[str, str]:
    """Write the value of a component parameter, and its type."""
    if isinstance(value, list):
        name = _ROSA_TYPES[type(value[0])] if value else "string"
        return json.dumps(value, ensure_ascii=False), f"{name}_array"
    return (value if isinstance(value, str) else json.dumps(value)), _ROSA_TYPES[type(value)]


def _flag(value: object) -> bool:
    word = str(value).strip().lower()
    if word not in ("true", "false"):
        raise ValueError
    return word == "true"


def _whole(value: object) -> int:
    if isinstance(value, bool):
        raise ValueError
    if isinstance(value, float):
        if not value.is_integer():
            raise ValueError
        return int(value)
    return int(str(value))


def _number(value: object) -> float:
    if isinstance(value, bool):
        raise ValueError
    number = float(str(value))
    if not math.isfinite(number):
        raise ValueError
    return number


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


_READERS: Final[Mapping[str, Callable[[object], bool | int | float | str]]] = {
    "boolean": _flag,
    "bool": _flag,
    "long": _whole,
    "integer": _whole,
    "int": _whole,
    "double": _number,
    "float": _number,
    "string": _text,
    "str": _text,
}
_ROSA_TYPES: Final[Mapping[type, str]] = {bool: "boolean", float: "double", int: "long", str: "string"}


def _items(value: Literal, base: str) -> list[object]:
    """Split a written list; its texts may stand in quotes or not."""
    if not isinstance(value, str):
        return [value]
    text = value.strip()
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError
    if base in ("string", "str"):
        for read in (json.loads, ast.literal_eval):
            with suppress(ValueError, SyntaxError, RecursionError, MemoryError):
                items = read(text)
                if isinstance(items, list) and all(isinstance(item, str) for item in items):
                    return list(items)
    inner = text[1:-1].strip()
    return [_unquoted(item.strip()) for item in inner.split(",")] if inner else []


def _unquoted(item: str) -> str:
    return item[1:-1] if len(item) > 1 and item[0] == item[-1] and item[0] in "'\"" else item


def _unescaped(found: re.Match[str]) -> str:
    what = found.group(1)
    return chr(int(what[1:], 16)) if len(what) > 1 else _ESCAPED.get(what, f"\\{what}")


def _escaped(found: re.Match[str]) -> str:
    character = found.group()
    short = {"\n": "\\n", "\t": "\\t", "\r": "\\r", "\\": "\\\\", '"': '\\"'}
    return short.get(character) or f"\\u{ord(character):04x}"


def _shown(value: Literal) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"the date {value.isoformat()}" if isinstance(value, datetime) else f"{value!r:.60}"
