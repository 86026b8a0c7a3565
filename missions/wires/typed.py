"""Messages as objects of a library that has ROS 2's types (rclpy; cyclonedds with those of rosbags), made of dicts."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, Protocol

from missions.wires.node import Answer, Message, RosError, plain

_FLOATS: Final = ("float32", "float64")
_INTEGERS: Final = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "byte": (0, 255),
    "char": (0, 255),
}
"""The integers of ROS 2, and the range of each."""


class Field(NamedTuple):
    """The type of a field; `length` is None for one, 0 for a sequence, else how many an array has."""

    kind: str
    length: int | None = None


class Library(Protocol):
    """What has types of ROS 2."""

    def fields(self, kind: str) -> Mapping[str, Field]:
        """Return the fields of a message; `RosError` if it is not known."""

    def new(self, kind: str, values: Message) -> Any:  # noqa: ANN401  # an object of the library
        """Return a message with these values; the other fields are empty."""


def made(library: Library, kind: str, message: Message) -> Any:  # noqa: ANN401  # an object of the library
    """Return a message that was written as a dict.

    Raises:
        RosError: the type is not known, or a field of it; or a value is none of its field's type.
    """
    if not isinstance(message, dict):
        raise RosError(f"{kind} is written as an object, not as {message!r:.60}")
    fields = library.fields(kind)
    for name in message:
        if name not in fields:
            raise RosError(f"{kind} has no field {name!r}; it has {', '.join(fields) or 'none'}")
    values = {}
    for name, value in message.items():
        field, place = fields[name], f"{name} of {kind}"
        if field.length is None:
            values[name] = _made(library, field.kind, value, place)
        elif not isinstance(value, list | tuple) or (field.length and len(value) != field.length):
            raise RosError(f"{place} is a list of {field.length or 'any number'} {field.kind}, not {value!r:.60}")
        else:
            values[name] = [_made(library, field.kind, one, place) for one in value]
    return library.new(kind, values)


def _made(library: Library, kind: str, value: Any, place: str) -> Any:  # noqa: ANN401  # of a field
    if kind in _FLOATS and (value is None or (isinstance(value, int | float) and not isinstance(value, bool))):
        return math.nan if value is None else float(value)
    if kind in _INTEGERS and isinstance(value, int) and not isinstance(value, bool):
        low, high = _INTEGERS[kind]
        if low <= value <= high:
            return value
    if (kind == "bool" and isinstance(value, bool)) or (kind == "string" and isinstance(value, str)):
        return value
    if "/" in kind:
        return made(library, kind, value)
    raise RosError(f"{place} is a {kind}, not {value!r:.60}")


def told(library: Library, kind: str, thing: Any) -> Message:  # noqa: ANN401  # an object of the library
    """Return a message as a dict."""
    message = {}
    for name, field in library.fields(kind).items():
        value = getattr(thing, name)
        several = field.length is not None
        message[name] = (
            [_told(library, field.kind, one) for one in value] if several else _told(library, field.kind, value)
        )
    return message


def _told(library: Library, kind: str, value: Any) -> object:  # noqa: ANN401  # of a field
    if "/" in kind:
        return told(library, kind, value)
    if isinstance(value, bytes):  # rclpy's byte
        return value[0]
    return plain(float(value)) if kind in _FLOATS else value


def response(library: Library, kind: str, answer: Answer, request: Any, log: Callable[..., object]) -> Any:  # noqa: ANN401  # objects of the library
    """Return the answer to a call of a service; refused, or failed, it is an empty one, as ROS 2 has no other word."""
    try:
        return made(library, f"{kind}_Response", answer(told(library, f"{kind}_Request", request)))
    except RosError as error:
        log("a call of %s is refused: %s", kind, error)
    except Exception as error:  # ours is not the caller's to suffer
        log("a call of %s could not be answered: %s: %s", kind, type(error).__name__, error, exc_info=True)
    return library.new(f"{kind}_Response", {})
