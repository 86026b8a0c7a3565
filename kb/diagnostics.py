"""Facts in ROS diagnostics (REP 107): ROSA's own texts, and everybody's by rules.

An array is an object or a mapping with `status`, a list of statuses, or a single status. A status
has `message` and `values`, and may have `level` and `name`; its values are a mapping, or objects or
mappings with `key` and `value`. So a message of rclpy, its JSON and a plain dict are all accepted.
"""

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
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
OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_MEANINGS: Final = {"warn": ("ignored", "recovered", "failed"), "stale": ("not measured", "failed")}
"""What a level may mean, by name; the first is the default."""
_WORSE: Final = {"measure": "stale", "component_recovered": "component_failed"}


class DiagnosticProblem(NamedTuple):
    """A part of an array that could not be used, and why."""

    key: str
    value: str
    reason: str

    def __str__(self) -> str:
        return f"{self.key}={self.value!r}: {self.reason}"


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


class _Rule(NamedTuple):
    component: str = ""
    attributes: Mapping[str, str] = MappingProxyType({})
    warn: str = "ignored"
    stale: str = "not measured"


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
        self.not_understood: Counter[str] = Counter()
        self._rules: dict[str, _Rule] = {}
        self._failures: dict[str, dict[str, str]] = {}
        """By component: the names that say that it has failed, and why."""
        for pattern, entry in table.items():
            try:
                rule = _Rule(entry) if isinstance(entry, str) else _Rule(**entry)
            except TypeError:
                raise InvalidValue(
                    f"the rule for {pattern!r} is the name of a component, or a table of "
                    f"component, attributes, warn, stale; not {entry!r}"
                ) from None
            for name, words in _MEANINGS.items():
                word = getattr(rule, name)
                if word not in words:
                    raise InvalidValue(
                        f"the rule for {pattern!r}: {name} is one of {', '.join(words)}; "
                        f"not {word!r}"
                    )
            self._rules[pattern] = rule

    def check(self, kb: Any) -> None:  # noqa: ANN401  # a KnowledgeBase, which imports this
        """Raise `UnknownName` if a rule names what the model does not have."""
        for rule in self._rules.values():
            if rule.component:
                _ = kb.components[rule.component]
            for attribute in rule.attributes.values():
                _ = kb.attributes[attribute]

    def facts(self, status: _Status) -> Iterator[_Fact]:
        """Yield the facts in a status."""
        matching = [rule for key, rule in self._rules.items() if fnmatchcase(status.name, key)]
        if not matching:
            if status.subject not in MEASUREMENTS | COMPONENT_REPORTS:
                self.not_understood[status.name] += 1
            return
        rule = matching[0]
        values = dict(status.values)
        for key, attribute in rule.attributes.items():
            if status.level == STALE:
                yield _Fact("stale", attribute, "STALE")
            elif key in values:
                yield _Fact("measure", attribute, values[key])
        meaning = ("recovered", rule.warn, "failed", rule.stale)[status.level]
        if not rule.component or meaning in ("ignored", "not measured"):
            return
        failures = self._failures.setdefault(rule.component, {})
        failures.pop(status.name, None)
        if meaning == "failed":
            failures[status.name] = f"{status.name}: {status.message}"
        verb = "component_failed" if failures else "component_recovered"
        yield _Fact(verb, rule.component, status.message, next(iter(failures.values()), ""))


def _rosas_facts(status: _Status) -> Iterator[_Fact]:
    for key, value in status.values:
        if status.subject in MEASUREMENTS:
            yield _Fact("stale" if status.level == STALE else "measure", key, value)
        elif status.subject in COMPONENT_REPORTS:
            verb = COMPONENT_VALUES.get(value.strip().casefold(), "")
            is_error = verb and status.level == ERROR  # a level that contradicts a value wins
            yield _Fact("component_failed" if is_error else verb, key, value)


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
    facts: list[_Fact] = []
    for status in _statuses(array, problems):
        facts += _rosas_facts(status)
        if rules is not None:
            facts += rules.facts(status)
    stated = {(fact.verb, fact.name) for fact in facts}
    for fact in facts:
        if (_WORSE.get(fact.verb), fact.name) in stated:
            continue
        try:
            _record(kb, fact)
        except (KnowledgeBaseError, ValueError) as error:
            problems.append(DiagnosticProblem(fact.name, fact.text, str(error)))
    for problem in problems:
        _log.warning("diagnostics: %s", problem)
    return tuple(problems)


def _record(kb: Any, fact: _Fact) -> None:  # noqa: ANN401  # a KnowledgeBase
    if fact.verb == "measure":
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


# -------------------------------------------------------------------- the forms of an array


def _statuses(array: object, problems: list[DiagnosticProblem]) -> Iterator[_Status]:
    try:  # an object of the caller may raise anything when it is read
        statuses = array if isinstance(array, list | tuple) else _part(array, "status", (array,))
        for status in statuses if isinstance(statuses, Iterable) else ():
            try:
                yield _status(status)
            except Exception as error:
                problems.append(_unreadable(status, error))
    except Exception as error:
        problems.append(_unreadable(array, error))


def _unreadable(part: object, error: Exception) -> DiagnosticProblem:
    return DiagnosticProblem("status", type(part).__name__, f"it cannot be read: {error}")


def _status(status: object) -> _Status:
    level = _part(status, "level", OK)
    if isinstance(level, bytes):  # as rclpy has it
        (level,) = level
    if level not in (OK, WARN, ERROR, STALE):
        raise ValueError(f"a level is 0 (OK), 1 (WARN), 2 (ERROR) or 3 (STALE), not {level!r}")
    values = _part(status, "values", ())
    if not isinstance(values, Mapping):
        values = {_part(value, "key", ""): _part(value, "value", "") for value in values}
    texts = [(str(key), str(value)) for key, value in values.items()]
    name = str(_part(status, "name", ""))
    return _Status(int(level), name, str(_part(status, "message", "")), texts)


def _part(whole: Any, name: str, default: object) -> Any:  # noqa: ANN401  # of any form
    if isinstance(whole, Mapping):
        return whole.get(name, default)
    return getattr(whole, name, default)
