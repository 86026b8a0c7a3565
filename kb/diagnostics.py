"""Facts in ROS diagnostics (REP 107): ROSA's own texts, and everybody's by rules.

An array is an object or a mapping with `status`, or a list of statuses. A status has `message` and
`values`, and may have `level` and `name`; its values are a mapping, pairs, or objects or mappings
with `key` and `value`. So a message of rclpy, its JSON and a plain dict are all accepted.
"""

import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from types import MappingProxyType
from typing import Any, Final, NamedTuple

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
# float() alone would also accept underscores and digits of any script
NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_BY_SEVERITY: Final = (OK, WARN, STALE, ERROR)
_MEANINGS: Final = {"warn": ("ignored", "recovered", "failed"), "stale": ("not measured", "failed")}
"""What a level may mean, by name; the first is the default."""
_WORSE: Final = {"measure": "stale", "component_recovered": "component_failed"}
_MOST_NAMES: Final = 1000


@dataclass(frozen=True, slots=True)
class DiagnosticProblem:
    """A part of an array that could not be used, and why."""

    key: str
    value: str
    reason: str

    def __str__(self) -> str:
        return f"{self.key:.200}={self.value!r:.200}: {self.reason}"


class _Status(NamedTuple):
    level: int
    name: str
    message: str
    values: list[tuple[str, str]]

    @property
    def subject(self) -> str:
        return self.message.strip().casefold()


class _Fact(NamedTuple):
    """What an array says of an attribute or component: the verb of its event, or an empty one."""

    verb: str
    name: str
    text: str
    reason: str = ""


class DiagnosticRules:
    """The meaning of everybody's diagnostics, by patterns of the statuses' names.

    Example::

        rules = DiagnosticRules({
            "camera: *": "camera",
            "power: *": {"attributes": {"Charge": "charge"}},
            "lidar: *": {"component": "lidar", "warn": "failed", "stale": "failed"},
        })
        kb.receive(array, rules=rules)

    ERROR fails the component, OK recovers it. WARN is "ignored", or means "recovered" or "failed".
    STALE makes the attributes "not measured"; "failed" makes the component fail, too.

    The first pattern that matches a name counts, with wildcards as in names of files. A component
    that several names are about has failed if one of them says so, and recovers when none does any
    more.

    Args:
        table: for each pattern the name of a component, or a table: the component, the attributes
            by the key that measures them, and what "warn" and "stale" mean.

    Attributes:
        not_understood: how many statuses matched no pattern and are not ROSA's, by name.

    Raises:
        InvalidValue: the table is malformed.
    """

    def __init__(self, table: Mapping[str, str | Mapping[str, Any]]) -> None:
        if not isinstance(table, Mapping):
            raise InvalidValue(f"rules are given by pattern of a status's name, not as {table!r}")
        self.not_understood: Counter[str] = Counter()
        self._rules = {pattern: _Rule.of(pattern, entry) for pattern, entry in table.items()}
        self._failures: dict[str, dict[str, str]] = {}
        """By component: the names that say that it has failed, and why."""

    def check(self, kb: Any) -> None:  # noqa: ANN401  # a KnowledgeBase, which imports this
        """Raise `UnknownName` if a rule names what the model does not have."""
        for rule in self._rules.values():
            if rule.component:
                _ = kb.components[rule.component]
            for attribute in rule.attributes.values():
                _ = kb.attributes[attribute]

    def facts(self, statuses: Iterable[_Status]) -> Iterator[_Fact]:
        """Yield the facts in the statuses of one array, which may be ROSA's own too."""
        worst: dict[str, int] = {}
        for status in statuses:
            levels = (worst.get(status.name, OK), status.level)
            worst[status.name] = max(levels, key=_BY_SEVERITY.index)
        for status in statuses:
            matching = [rule for key, rule in self._rules.items() if fnmatchcase(status.name, key)]
            if matching:
                yield from self._by_rule(matching[0], status, worst[status.name])
                continue
            is_rosas = status.subject in MEASUREMENTS | COMPONENT_REPORTS
            if not is_rosas and len(self.not_understood) < _MOST_NAMES:
                self.not_understood[status.name] += 1

    def _by_rule(self, rule: "_Rule", status: _Status, worst: int) -> Iterator[_Fact]:
        if worst == STALE:
            for attribute in rule.attributes.values():
                yield _Fact("stale", attribute, "STALE")
        else:
            for key, value in status.values:
                if key in rule.attributes:
                    yield _Fact("measure", rule.attributes[key], value)
        meaning = {OK: "recovered", WARN: rule.warn, ERROR: "failed", STALE: rule.stale}[worst]
        if not rule.component or meaning in ("ignored", "not measured"):
            return
        names = self._failures.setdefault(rule.component, {})
        if meaning == "recovered":
            names.pop(status.name, None)
        elif status.name in names or len(names) < _MOST_NAMES:
            names[status.name] = f"{status.name}: {status.message}"
        verb = "component_failed" if names else "component_recovered"
        yield _Fact(verb, rule.component, status.message, next(iter(names.values()), ""))


def record_diagnostics(
    kb: Any,  # noqa: ANN401  # a KnowledgeBase, which imports this
    array: object,
    rules: DiagnosticRules | None = None,
) -> tuple[DiagnosticProblem, ...]:
    """Record the facts in an array; return what could not be used, and why.

    Statuses that are neither ROSA's nor matched by the rules are passed over. Where an array
    contradicts itself about a component or an attribute, the worse counts: failed, or not
    measured.
    """
    problems: list[DiagnosticProblem] = []
    statuses = list(_statuses(array, problems))
    facts = [fact for status in statuses for fact in _rosas_facts(status)]
    if rules is not None:
        facts += rules.facts(statuses)
    stated = {(fact.verb, fact.name) for fact in facts}
    for fact in facts:
        if (_WORSE.get(fact.verb), fact.name) in stated:
            continue
        try:
            _record(kb, fact)
        except KnowledgeBaseError as error:
            problems.append(DiagnosticProblem(fact.name, fact.text, str(error)))
    for problem in problems:
        _log.warning("diagnostics: %s", problem)
    return tuple(problems)


def _record(kb: Any, fact: _Fact) -> None:  # noqa: ANN401  # a KnowledgeBase
    if fact.verb == "measure":
        if not NUMBER.fullmatch(fact.text.strip()):
            raise InvalidValue("a measurement is a finite number")
        kb.measure(fact.name, float(fact.text))
    elif fact.verb == "stale":
        kb.replay(Event(0, kb.now, "stale", (kb.attributes[fact.name].name,)))
    elif fact.verb == "component_recovered":
        kb.component_recovered(fact.name)
    elif not fact.verb:
        raise InvalidValue(f"a component status is one of {', '.join(COMPONENT_VALUES)}")
    elif kb.components[fact.name].status is not Status.FAILURE:
        # a reason that changes with each array (a frequency, say) is no event each time
        kb.component_failed(fact.name, fact.reason)


def _rosas_facts(status: _Status) -> Iterator[_Fact]:
    for key, value in status.values:
        if status.subject in MEASUREMENTS:
            yield _Fact("stale" if status.level == STALE else "measure", key, value)
        elif status.subject in COMPONENT_REPORTS:
            verb = COMPONENT_VALUES.get(value.strip().casefold(), "")
            if verb and status.level == ERROR:
                verb = "component_failed"
            if verb != "component_recovered" or status.level != STALE:
                yield _Fact(verb, key, value)


class _Rule(NamedTuple):
    component: str = ""
    attributes: Mapping[str, str] = MappingProxyType({})
    warn: str = "ignored"
    stale: str = "not measured"

    @classmethod
    def of(cls, pattern: object, entry: object) -> "_Rule":
        """Return the rule that is written for a pattern."""
        if not isinstance(pattern, str) or not pattern:
            raise InvalidValue(f"a pattern is a text such as 'camera: *', not {pattern!r}")
        about = f"the rule for {pattern!r}"
        if isinstance(entry, str):
            entry = {"component": entry}
        if not isinstance(entry, Mapping):
            raise InvalidValue(f"{about} is the name of a component, or a table; not {entry!r}")
        for name in entry:
            if name not in cls._fields:
                fields = ", ".join(cls._fields)
                raise InvalidValue(f"{about} has no field {name!r}; fields are {fields}")
        rule = cls(**entry)
        texts = [rule.component]
        if isinstance(rule.attributes, Mapping):
            texts += [*rule.attributes, *rule.attributes.values()]
        else:
            texts.append(rule.attributes)
        if not all(isinstance(text, str) for text in texts):
            raise InvalidValue(
                f"{about}: component is a name, and attributes are names of attributes by key, "
                f"not {rule.component!r} and {rule.attributes!r}"
            )
        for name, words in _MEANINGS.items():
            if getattr(rule, name) not in words:
                wrong = getattr(rule, name)
                raise InvalidValue(f"{about}: {name} is one of {', '.join(words)}; not {wrong!r}")
        if not rule.component and not rule.attributes:
            raise InvalidValue(f"{about} names a component, or attributes by key, or both")
        return rule


# -------------------------------------------------------------------- the forms of an array


def _statuses(array: object, problems: list[DiagnosticProblem]) -> Iterator[_Status]:
    try:
        statuses = _part(array, "status", array)
        if isinstance(statuses, Mapping | str | bytes) or not isinstance(statuses, Iterable):
            statuses = (statuses,)  # a single status
        for status in statuses:
            yield _status(status, problems)
    except Exception as error:  # an iterator of the caller may raise anything
        reason = f"no more can be read: {error}"
        problems.append(DiagnosticProblem("diagnostics", type(array).__name__, reason))


def _status(status: object, problems: list[DiagnosticProblem]) -> _Status:
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
    return _Status(level, name, message, pairs)


def _level(level: object) -> int:
    if isinstance(level, bytes) and len(level) == 1:  # as rclpy has it
        level = level[0]
    if isinstance(level, int) and level in _BY_SEVERITY:
        return int(level)
    raise ValueError(f"a level is 0 (OK), 1 (WARN), 2 (ERROR) or 3 (STALE), not {level!r}")


def _part(whole: object, name: str, default: object) -> object:
    if isinstance(whole, Mapping):
        return whole.get(name, default)
    return getattr(whole, name, default)


def _pairs(values: object) -> Iterator[tuple[str, str]]:
    items = values.items() if isinstance(values, Mapping) else values
    for item in items if isinstance(items, Iterable) else ():
        if isinstance(item, tuple | list) and len(item) == 2:
            yield str(item[0]), str(item[1])
        else:
            yield str(_part(item, "key", "")), str(_part(item, "value", ""))
