"""Reading of ROS diagnostics (the /diagnostics convention, REP 107): from an array of statuses to facts.

An array is an object or a mapping with `status`, or a list of statuses; a status is an object or a mapping with
`message` and `values`; values are a mapping, key/value pairs, or objects or mappings with `key` and `value`. So a
message of a ROS 2 Python node, its JSON, and a plain dict are all accepted.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

MEASUREMENTS: Final = frozenset(
    {"qa status", "qa measurement", "ea status", "ea measurement", "attribute measurement"}
)
COMPONENT_REPORTS: Final = frozenset({"component status", "component"})
NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
COMPONENT_VALUES: Final = dict.fromkeys(("ok", "recovered"), "component_recovered") | dict.fromkeys(
    ("error", "failure", "false"), "component_failed"
)


class Reading(NamedTuple):
    """The fact that a key and its value give: the verb and arguments that tell it, and the value as written."""

    verb: str
    arguments: tuple[str] | tuple[str, float]
    written: str


class DiagnosticProblem(NamedTuple):
    """A part of an array that could not be used, and why."""

    key: str
    value: str
    reason: str

    def __str__(self) -> str:
        return f"{self.key:.200}={self.value!r:.200}: {self.reason}"


def read_diagnostics(array: object) -> Iterator[Reading | DiagnosticProblem]:
    """Yield the fact or problem of each key/value in an array; skip statuses with other messages than those above."""
    try:
        found = _part(array, "status", array)
        if isinstance(found, Mapping | str | bytes) or not isinstance(found, Iterable):
            found = (found,)  # a single status
        for status in found:
            yield from _read_status(status)
    except Exception as error:  # an iterator of the caller may raise anything
        yield DiagnosticProblem(
            "diagnostics", type(array).__name__, f"no more can be read: {error}"
        )


def _read_status(status: object) -> Iterator[Reading | DiagnosticProblem]:
    message = ""
    try:
        message = str(_part(status, "message", "")).strip().casefold()
        if message in MEASUREMENTS or message in COMPONENT_REPORTS:
            for key, value in _pairs(_part(status, "values", ())):
                yield _measured(key, value) if message in MEASUREMENTS else _reported(key, value)
    except Exception as error:  # an object of the caller may raise anything when it is read
        yield DiagnosticProblem(
            message or "status", type(status).__name__, f"it cannot be read: {error}"
        )


def _measured(key: str, value: str) -> Reading | DiagnosticProblem:
    # float() alone would also accept underscores and digits of any script
    number = float(value) if NUMBER.fullmatch(value.strip()) else math.nan
    if not math.isfinite(number):
        return DiagnosticProblem(key, value, "a measurement is a finite number")
    return Reading("measure", (key, number), value)


def _reported(key: str, value: str) -> Reading | DiagnosticProblem:
    verb = COMPONENT_VALUES.get(value.strip().casefold())
    if verb is not None:
        return Reading(verb, (key,), value)
    return DiagnosticProblem(
        key, value, f"a component status is one of {', '.join(COMPONENT_VALUES)}"
    )


def _part(whole: object, name: str, default: object) -> object:
    return (
        whole.get(name, default)
        if isinstance(whole, dict | Mapping)
        else getattr(whole, name, default)
    )


def _pairs(values: object) -> Iterator[tuple[str, str]]:
    if isinstance(values, dict | Mapping):
        items: Iterable[object] = values.items()
    else:
        items = values if isinstance(values, Iterable) else ()
    for item in items:
        if isinstance(item, tuple | list) and len(item) == 2:
            key, value = item
        else:
            key, value = _part(item, "key", ""), _part(item, "value", "")
        yield str(key), str(value)
