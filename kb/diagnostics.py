"""Facts in ROS diagnostics (REP 107): ROSA's own texts, and everybody's by rules.

An array is an object or a mapping with `status`, or a list of statuses. A status has `message` and
`values`, and may have `level` and `name`; its values are a mapping, pairs, or objects or mappings
with `key` and `value`. So a message of rclpy, its JSON and a plain dict are all accepted.
"""

import logging
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final, Protocol

from kb.events import Event
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.status import Status

_log = logging.getLogger(__name__)

MEASUREMENTS: Final = frozenset(
    {"qa status", "qa measurement", "ea status", "ea measurement", "attribute measurement"}
)
COMPONENT_REPORTS: Final = frozenset({"component status", "component"})
COMPONENT_VALUES: Final = {
    "ok": "component_recovered",
    "recovered": "component_recovered",
    "error": "component_failed",
    "failure": "component_failed",
    "false": "component_failed",
}
NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_BY_SEVERITY: Final = (OK, WARN, STALE, ERROR)
_WARN_MEANINGS: Final = ("ignored", "recovered", "failed")
_STALE_MEANINGS: Final = ("not measured", "failed")
_WORSE: Final = {"measure": "stale", "component_recovered": "component_failed"}
_MOST_NAMES: Final = 1000


@dataclass(frozen=True, slots=True)
class DiagnosticFact:
    """A fact in an array.

    Attributes:
        verb: "measure", "stale", "component_failed" or "component_recovered".
        name: of the attribute or component.
        value: the measured value, or nan.
        text: the value or message as it was written.
        reason: why the component has failed, in words.
    """

    verb: str
    name: str
    text: str
    value: float = math.nan
    reason: str = ""


@dataclass(frozen=True, slots=True)
class DiagnosticProblem:
    """A part of an array that could not be used, and why."""

    key: str
    value: str
    reason: str

    def __str__(self) -> str:
        return f"{self.key:.200}={self.value!r:.200}: {self.reason}"


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """A status of an array, with its parts as text."""

    level: int
    name: str
    message: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class DiagnosticRule:
    """The meaning of the statuses whose names match a pattern.

    ERROR fails the component, OK recovers it. STALE makes the attributes not measured.

    Attributes:
        component: the component that the statuses are about; empty if they are about none.
        attributes: the attribute that each key measures.
        warn: "ignored" leaves the component as it is; "recovered" and "failed" change it.
        stale: "failed" makes the component failed, too; "not measured" leaves it as it is.
    """

    component: str = ""
    attributes: Mapping[str, str] = field(default_factory=dict)
    warn: str = "ignored"
    stale: str = "not measured"

    def __post_init__(self) -> None:
        if not isinstance(self.component, str):
            raise InvalidValue(f"component is the name of a component, not {self.component!r}")
        is_mapping = isinstance(self.attributes, Mapping)
        texts = (*self.attributes, *self.attributes.values()) if is_mapping else (None,)
        if not all(isinstance(text, str) for text in texts):
            raise InvalidValue(
                f"attributes are names of attributes by key, not {self.attributes!r}"
            )
        if self.warn not in _WARN_MEANINGS:
            raise InvalidValue(f"warn is one of {', '.join(_WARN_MEANINGS)}; not {self.warn!r}")
        if self.stale not in _STALE_MEANINGS:
            raise InvalidValue(f"stale is one of {', '.join(_STALE_MEANINGS)}; not {self.stale!r}")
        if not self.component and not self.attributes:
            raise InvalidValue("a rule names a component, or attributes by key, or both")

    def is_failed(self, level: int) -> bool | None:
        """Return whether a level means that the component has failed; None if it says neither."""
        if level == WARN:
            return None if self.warn == "ignored" else self.warn == "failed"
        if level == STALE:
            return True if self.stale == "failed" else None
        return level == ERROR


class _Elements(Protocol):
    @property
    def components(self) -> Mapping[str, Any]: ...
    @property
    def attributes(self) -> Mapping[str, Any]: ...


class _Facts(_Elements, Protocol):
    @property
    def now(self) -> float: ...
    def measure(self, attribute: str, value: float) -> None: ...
    def component_failed(self, component: str, reason: str = "") -> None: ...
    def component_recovered(self, component: str) -> None: ...
    def replay(self, event: Event) -> None: ...


class DiagnosticRules:
    """The meaning of everybody's diagnostics, by patterns of the statuses' names.

    Example::

        rules = DiagnosticRules({
            "camera: *": "camera",
            "battery: *": {"attributes": {"Charge": "battery_level"}},
            "lidar: *": {"component": "lidar", "warn": "failed", "stale": "failed"},
        })
        kb.receive(array, rules=rules)

    The first pattern that matches a name counts, with wildcards as in names of files. A component
    that several names are about has failed if one of them says so, and recovers when none does any
    more.

    Args:
        table: for each pattern the name of a component, or the fields of a `DiagnosticRule`.

    Attributes:
        not_understood: how many statuses matched no pattern and are not ROSA's, by name.

    Raises:
        InvalidValue: the table is malformed.
    """

    def __init__(self, table: Mapping[str, str | Mapping[str, Any] | DiagnosticRule]) -> None:
        if not isinstance(table, Mapping):
            raise InvalidValue(f"rules are given by pattern of a status's name, not as {table!r}")
        self.rules = {pattern: _rule(pattern, entry) for pattern, entry in table.items()}
        self.not_understood: Counter[str] = Counter()
        self._failed_names: dict[str, dict[str, str]] = {}
        """By component: the names that say that it has failed, and why."""

    def check(self, kb: _Elements) -> None:
        """Raise `UnknownName` if a rule names what the model does not have."""
        for rule in self.rules.values():
            if rule.component:
                _ = kb.components[rule.component]
            for attribute in rule.attributes.values():
                _ = kb.attributes[attribute]

    def match(self, name: str) -> DiagnosticRule | None:
        """Return the rule of the first pattern that matches a status's name."""
        for pattern, rule in self.rules.items():
            if fnmatchcase(name, pattern):
                return rule
        return None

    def read(
        self, statuses: Iterable[DiagnosticStatus]
    ) -> Iterator[DiagnosticFact | DiagnosticProblem]:
        """Yield the facts in the statuses of one array, which may be ROSA's own too."""
        worst = _worst_levels(statuses)
        for status in statuses:
            rule = self.match(status.name)
            if rule is not None:
                yield from self._read_matched(rule, status, worst[status.name])
            elif not _is_rosas(status) and len(self.not_understood) < _MOST_NAMES:
                self.not_understood[status.name] += 1

    def _read_matched(
        self, rule: DiagnosticRule, status: DiagnosticStatus, level: int
    ) -> Iterator[DiagnosticFact | DiagnosticProblem]:
        for key, value in status.values:
            if key in rule.attributes and level != STALE:
                yield _measurement(rule.attributes[key], value)
        if level == STALE:
            for attribute in rule.attributes.values():
                yield DiagnosticFact("stale", attribute, "STALE")
        is_failed = rule.is_failed(level)
        if rule.component and is_failed is not None:
            yield self._component_fact(rule.component, status, is_failed)

    def _component_fact(
        self, component: str, status: DiagnosticStatus, is_failed: bool
    ) -> DiagnosticFact:
        names = self._failed_names.setdefault(component, {})
        if not is_failed:
            names.pop(status.name, None)
        elif status.name in names or len(names) < _MOST_NAMES:
            names[status.name] = f"{status.name}: {status.message}"
        if not names:
            return DiagnosticFact("component_recovered", component, status.message)
        reason = next(iter(names.values()))
        return DiagnosticFact("component_failed", component, status.message, reason=reason)


def record_diagnostics(
    kb: _Facts, array: object, rules: DiagnosticRules | None = None
) -> tuple[DiagnosticProblem, ...]:
    """Record the facts in an array; return what could not be used, and why."""
    problems = []
    for fact in read_diagnostics(array, rules):
        if isinstance(fact, DiagnosticProblem):
            problems.append(fact)
            continue
        try:
            _record(kb, fact)
        except KnowledgeBaseError as error:
            problems.append(DiagnosticProblem(fact.name, fact.text, str(error)))
    for problem in problems:
        _log.warning("diagnostics: %s", problem)
    return tuple(problems)


def _record(kb: _Facts, fact: DiagnosticFact) -> None:
    if fact.verb == "measure":
        kb.measure(fact.name, fact.value)
    elif fact.verb == "stale":
        kb.replay(Event(0, kb.now, "stale", (kb.attributes[fact.name].name,)))
    elif fact.verb == "component_recovered":
        kb.component_recovered(fact.name)
    elif kb.components[fact.name].status is not Status.FAILURE:
        # a reason that changes with each array (a frequency, say) is no event each time
        kb.component_failed(fact.name, fact.reason)


def read_diagnostics(
    array: object, rules: DiagnosticRules | None = None
) -> list[DiagnosticFact | DiagnosticProblem]:
    """Return the facts in an array, and what could not be used; never raises.

    Statuses that are neither ROSA's nor matched by the rules are passed over. Where an array
    contradicts itself about a component or an attribute, the worse counts: failed, or not
    measured.
    """
    problems: list[DiagnosticFact | DiagnosticProblem] = []
    statuses = list(_statuses(array, problems))
    facts: list[DiagnosticFact | DiagnosticProblem] = []
    for status in statuses:
        facts += _read_rosas(status)
    if rules is not None:
        facts += rules.read(statuses)
    return [*_resolved(facts), *problems]


def _resolved(
    facts: list[DiagnosticFact | DiagnosticProblem],
) -> Iterator[DiagnosticFact | DiagnosticProblem]:
    """Leave out each fact that a worse one about the same component or attribute contradicts."""
    told = {(fact.verb, fact.name) for fact in facts if isinstance(fact, DiagnosticFact)}
    for fact in facts:
        if isinstance(fact, DiagnosticProblem) or (_WORSE.get(fact.verb), fact.name) not in told:
            yield fact


def _read_rosas(status: DiagnosticStatus) -> Iterator[DiagnosticFact | DiagnosticProblem]:
    message = status.message.strip().casefold()
    if message in MEASUREMENTS:
        for key, value in status.values:
            if status.level == STALE:
                yield DiagnosticFact("stale", key, value)
            else:
                yield _measurement(key, value)
    elif message in COMPONENT_REPORTS:
        for key, value in status.values:
            fact = _component_report(key, value, status.level)
            if fact is not None:
                yield fact


def _component_report(
    key: str, value: str, level: int
) -> DiagnosticFact | DiagnosticProblem | None:
    verb = COMPONENT_VALUES.get(value.strip().casefold())
    if verb is None:
        words = ", ".join(COMPONENT_VALUES)
        return DiagnosticProblem(key, value, f"a component status is one of {words}")
    if level == ERROR:
        return DiagnosticFact("component_failed", key, value)
    if level == STALE and verb == "component_recovered":
        return None
    return DiagnosticFact(verb, key, value)


def _measurement(key: str, value: str) -> DiagnosticFact | DiagnosticProblem:
    # float() alone would also accept underscores and digits of any script
    number = float(value) if NUMBER.fullmatch(value.strip()) else math.nan
    if not math.isfinite(number):
        return DiagnosticProblem(key, value, "a measurement is a finite number")
    return DiagnosticFact("measure", key, value, number)


def _is_rosas(status: DiagnosticStatus) -> bool:
    message = status.message.strip().casefold()
    return message in MEASUREMENTS or message in COMPONENT_REPORTS


def _worst_levels(statuses: Iterable[DiagnosticStatus]) -> dict[str, int]:
    worst: dict[str, int] = {}
    for status in statuses:
        before = worst.get(status.name, OK)
        worst[status.name] = max(before, status.level, key=_BY_SEVERITY.index)
    return worst


def _rule(pattern: object, entry: object) -> DiagnosticRule:
    if not isinstance(pattern, str) or not pattern:
        raise InvalidValue(f"a pattern is a text such as 'camera: *', not {pattern!r}")
    if isinstance(entry, DiagnosticRule):
        return entry
    if isinstance(entry, str):
        entry = {"component": entry}
    if not isinstance(entry, Mapping):
        raise InvalidValue(
            f"the rule for {pattern!r} is the name of a component, or a table; not {entry!r}"
        )
    fields = DiagnosticRule.__dataclass_fields__
    unknown = [name for name in entry if name not in fields]
    if unknown:
        raise InvalidValue(
            f"the rule for {pattern!r} has no field {unknown[0]!r}; fields are {', '.join(fields)}"
        )
    try:
        return DiagnosticRule(**entry)
    except InvalidValue as error:
        raise InvalidValue(f"the rule for {pattern!r}: {error}") from None


# -------------------------------------------------------------------- the forms of an array


def _statuses(
    array: object, problems: list[DiagnosticFact | DiagnosticProblem]
) -> Iterator[DiagnosticStatus]:
    try:
        statuses = _part(array, "status", array)
        if isinstance(statuses, Mapping | str | bytes) or not isinstance(statuses, Iterable):
            statuses = (statuses,)  # a single status
        for status in statuses:
            yield _status(status, problems)
    except Exception as error:  # an iterator of the caller may raise anything
        reason = f"no more can be read: {error}"
        problems.append(DiagnosticProblem("diagnostics", type(array).__name__, reason))


def _status(status: object, problems: list[DiagnosticFact | DiagnosticProblem]) -> DiagnosticStatus:
    message = ""
    name = ""
    pairs: list[tuple[str, str]] = []
    level = WARN  # if it cannot be read: the component is neither well nor failed
    try:
        message = str(_part(status, "message", ""))
        name = str(_part(status, "name", ""))
        pairs.extend(_pairs(_part(status, "values", ())))
        level = _level(_part(status, "level", OK))
    except Exception as error:  # an object of the caller may raise anything when it is read
        reason = f"it cannot be read: {error}"
        problems.append(DiagnosticProblem(message or "status", type(status).__name__, reason))
    return DiagnosticStatus(level, name, message, tuple(pairs))


def _level(level: object) -> int:
    if isinstance(level, bytes) and len(level) == 1:  # as rclpy has it
        return _level(level[0])
    if isinstance(level, int) and level in _BY_SEVERITY:
        return int(level)
    raise ValueError(f"a level is 0 (OK), 1 (WARN), 2 (ERROR) or 3 (STALE), not {level!r}")


def _part(whole: object, name: str, default: object) -> object:
    if isinstance(whole, Mapping):
        return whole.get(name, default)
    return getattr(whole, name, default)


def _pairs(values: object) -> Iterator[tuple[str, str]]:
    items: Iterable[object] = ()
    if isinstance(values, Mapping):
        items = values.items()
    elif isinstance(values, Iterable):
        items = values
    for item in items:
        if isinstance(item, tuple | list) and len(item) == 2:
            key, value = item
        else:
            key = _part(item, "key", "")
            value = _part(item, "value", "")
        yield str(key), str(value)
