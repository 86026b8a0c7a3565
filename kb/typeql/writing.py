"""A model as TypeQL: one `insert` in ROSA's words, with a `define` of what ROSA's schema has no words for."""

import json
import re
from collections.abc import Iterable, Iterator
from typing import Final

from kb.contents import Contents
from kb.elements import AttributeKind, ComponentKind, Constraint, Element, StalePolicy
from kb.exceptions import ModelError
from kb.facts import (
    ActiveFact,
    Fact,
    MeasurementFact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.typeql.values import quoted, written_parameter, written_time

__all__ = ["typeql_text"]

_PERIODS: Final = ("required-action", "component-process", "reconfiguration-plan")
_OWN: Final = {
    "model-name": "string;\nRobotModel sub entity, owns model-name @key",
    "max-age": "double;\nAttribute owns max-age",
    "when-stale": "string;\nAttribute owns when-stale",
    "agreement": "string;\nAttribute owns agreement",
    "hysteresis": "double;\nconstraint owns hysteresis",
    "dwell": "double;\nconstraint owns dwell",
    "stops-to-configure": "boolean;\nComponent owns stops-to-configure",
    "preference-weights": "string;\nrequired-action owns preference-weights",
    "time-seconds": "double;\nmeasurement owns time-seconds",
    "start-seconds": "double;\n" + "\n".join(f"{one} owns start-seconds;" for one in _PERIODS).rstrip(";"),
    "end-seconds": "double;\n" + "\n".join(f"{one} owns end-seconds;" for one in _PERIODS).rstrip(";"),
}
"""What ROSA's schema has no words for: the type of each such attribute, and what has it."""

_COMPONENTS: Final = {
    ComponentKind.PLAIN: "Component",
    ComponentKind.PROCESS: "ROSNode",
    ComponentKind.LIFECYCLE: "LifeCycleNode",
}


def typeql_text(model: Contents) -> str:
    """Write a model so that it is read back as it is; see `Model.save`."""
    told = "\n".join(_Writer(model).lines())
    own = [f"{label} sub attribute, value {rest};" for label, rest in _OWN.items() if f"has {label} " in told]
    return "\n".join(["define", "# beyond ROSA's schema", *own, "", "insert", told, ""])


class _Writer:
    """The statements of a model; each element has a variable by which later ones speak of it."""

    def __init__(self, model: Contents) -> None:
        self.model = model
        self.variables: dict[Element | Constraint, str] = {}
        self.taken: dict[str, int] = {}

    def lines(self) -> Iterator[str]:
        """Write everything, in an order in which it can be read without looking ahead."""
        yield f"$model isa RobotModel, has model-name {quoted(self.model.name)};"
        parts = {
            "attributes": self._attributes(),
            "components": self._components(),
            "component configurations": self._configurations(),
            "functions": self._functions(),
            "function designs": self._designs(),
            "actions": self._actions(),
            "constraints": self._constraints(),
            "estimations": self._estimations(),
            "what is so from the start": self._facts(),
        }
        for title, statements in parts.items():
            written = list(statements)
            if written:
                yield from ("", f"# {title}", *written)

    def _attributes(self) -> Iterator[str]:
        for one in self.model.attributes.values():
            kind = "QualityAttribute" if one.kind is AttributeKind.QUALITY else "EnvironmentalAttribute"
            yield _statement(
                f"{self._variable('attribute', one)} isa {kind}",
                ("attribute-name", quoted(one.name)),
                ("max-age", _number(one.max_age) if one.max_age != float("inf") else None),
                ("when-stale", quoted(one.when_stale) if one.when_stale is not StalePolicy.NOT_EVALUATED else None),
                ("agreement", quoted("{} of {}".format(*one.agreement)) if one.agreement != (1, 1) else None),
            )

    def _components(self) -> Iterator[str]:
        for one in self.model.components.values():
            yield _statement(
                f"{self._variable('component', one)} isa {_COMPONENTS[one.kind]}",
                ("component-name", quoted(one.name)),
                ("always-improve", _true(one.always_improve)),
                ("stops-to-configure", _true(one.stops_to_configure)),
                ("package", quoted(one.package) if one.package else None),
                ("executable", quoted(one.executable) if one.executable else None),
            )

    def _configurations(self) -> Iterator[str]:
        for one in self.model.configurations.values():
            players = [("component", self._of(self.model.components[one.component]))]
            for key, value in one.parameters.items():
                text, sort = written_parameter(value)
                variable = self._fresh("parameter", key)
                yield _statement(
                    f"{variable} isa ComponentParameter",
                    ("parameter-key", quoted(key)),
                    ("parameter-value", quoted(text)),
                    ("parameter-type", quoted(sort)),
                )
                players.append(("parameter", variable))
            yield _statement(
                f"{self._variable('configuration', one)} {_players(players)} isa component-configuration",
                ("component-configuration-name", quoted(one.name)),
                ("priority", None if one.priority is None else repr(one.priority)),
            )

    def _functions(self) -> Iterator[str]:
        for one in self.model.functions.values():
            yield _statement(
                f"{self._variable('function', one)} isa Function",
                ("function-name", quoted(one.name)),
                ("always-improve", _true(one.always_improve)),
            )

    def _designs(self) -> Iterator[str]:
        for one in self.model.designs.values():
            players = [("function", self._of(self.model.functions[one.function]))]
            players += [("required-component", self._of(self.model.components[name])) for name in one.components]
            yield _statement(
                f"{self._variable('design', one)} {_players(players)} isa function-design",
                ("function-design-name", quoted(one.name)),
                ("priority", None if one.priority is None else repr(one.priority)),
            )

    def _actions(self) -> Iterator[str]:
        for one in self.model.actions.values():
            yield _statement(f"{self._variable('action', one)} isa Action", ("action-name", quoted(one.name)))
            if one.functions:
                players = [("action", self._of(one))]
                players += [("required-function", self._of(self.model.functions[name])) for name in one.functions]
                yield _statement(f"{_players(players)} isa functional-requirement")

    def _constraints(self) -> Iterator[str]:
        for one in self.model.constraints:
            players = [("attribute", self._of(self.model.attributes[one.attribute]))]
            players += [("constrained", self._of(element)) for element in one.constrained]
            yield _statement(
                f"{self._variable('constraint', one)} {_players(players)} isa constraint",
                ("constraint-operator", quoted(one.operator)),
                ("constraint-value", _number(one.value)),
                ("hysteresis", _number(one.hysteresis) if one.hysteresis else None),
                ("dwell", _number(one.dwell) if one.dwell else None),
            )

    def _estimations(self) -> Iterator[str]:
        for one in self.model.estimations:
            players = [("causer", self._of(one.causer)), ("affected", self._of(self.model.attributes[one.attribute]))]
            yield _statement(
                f"{_players(players)} isa estimation",
                ("estimation-value", _number(one.value)),
                ("estimation-type", quoted(one.kind)),
            )

    def _facts(self) -> Iterator[str]:
        for fact in self.model.facts:
            yield from self._fact(fact)

    def _fact(self, fact: Fact) -> Iterator[str]:
        components, actions, attributes = self.model.components, self.model.actions, self.model.attributes
        if isinstance(fact, StatusFact):
            yield f"{self._of(fact.element)} has status {quoted(fact.status)};"
        elif isinstance(fact, RequiredFact):
            yield f"{self._of(fact.element)} has is-required true;"
        elif isinstance(fact, SelectedFact):
            yield f"{self._of(fact.element)} has is-selected true;"
        elif isinstance(fact, ActiveFact):
            yield f"{self._of(components[fact.component])} has is-active true;"
        elif isinstance(fact, MeasurementFact):
            yield _statement(
                f"{_players([('measured-attribute', self._of(attributes[fact.attribute]))])} isa measurement",
                ("measurement-value", _number(fact.value)),
                ("latest", "true" if fact.latest else "false"),
                _time("measurement-time", "time-seconds", fact.time),
            )
        elif isinstance(fact, ProcessFact):
            players = [("component", self._of(components[fact.component]))]
            yield _statement(f"{_players(players)} isa component-process", ("pid", str(fact.pid)), *_period(fact))
        elif isinstance(fact, RequiredActionFact):
            preference = fact.preference or {}
            players = [("action", self._of(actions[fact.action]))]
            players += [("preferred-attribute", self._of(attributes[name])) for name in preference]
            weights = None if fact.preference is None else json.dumps(list(preference.values()))
            yield _statement(
                f"{_players(players)} isa required-action",
                ("preference-weights", quoted(weights) if weights else None),
                *_period(fact),
                ("result", quoted(fact.result) if fact.result else None),
            )
        else:
            yield from self._plan(fact)

    def _plan(self, fact: PlanFact) -> Iterator[str]:
        components, configurations = self.model.components, self.model.configurations
        steps = {
            "component-activation": [("component", self._of(components[name])) for name in fact.activate],
            "component-deactivation": [("component", self._of(components[name])) for name in fact.deactivate],
            "parameter-adaptation": [
                ("component-configuration", self._of(configurations[name])) for name in fact.parameters
            ],
        }
        players = []
        for relation, parts in steps.items():
            if parts:
                variable = self._fresh("step", relation)
                yield _statement(f"{variable} {_players(parts)} isa {relation}")
                players.append((relation, variable))
        subject = self._fresh("plan", "")
        yield _statement(
            f"{subject} {f'{_players(players)} ' if players else ''}isa reconfiguration-plan",
            *_period(fact),
            ("result", quoted(fact.result) if fact.result else None),
        )

    def _variable(self, prefix: str, element: Element | Constraint) -> str:
        name = element.name if isinstance(element, Element) else element.attribute
        self.variables[element] = self._fresh(prefix, name)
        return self.variables[element]

    def _fresh(self, prefix: str, name: str) -> str:
        """Return a variable that no other has, and that still reads like the name."""
        stem = re.sub(r"[^A-Za-z0-9]+", "_", f"{prefix}_{name}").strip("_")[:60]
        number = self.taken[stem] = self.taken.get(stem, 0) + 1
        return f"${stem}" if number == 1 else f"${stem}-{number}"

    def _of(self, element: Element | Constraint) -> str:
        return self.variables[element]


def _statement(head: str, *attributes: tuple[str, str | None]) -> str:
    return ", ".join([head, *(f"has {label} {value}" for label, value in attributes if value is not None)]) + ";"


def _players(players: Iterable[tuple[str, str]]) -> str:
    return f"({', '.join(f'{role}: {variable}' for role, variable in players)})"


def _period(fact: RequiredActionFact | ProcessFact | PlanFact) -> list[tuple[str, str | None]]:
    return [_time("start-time", "start-seconds", fact.start), _time("end-time", "end-seconds", fact.end)]


def _time(label: str, otherwise: str, time: float | None) -> tuple[str, str | None]:
    """Write a time as a date, or in seconds where a date would not say exactly the same."""
    if time is None:
        return label, None
    written = written_time(time)
    return (label, written) if written else (otherwise, _number(time))


def _number(value: float) -> str:
    text = repr(value)
    if text.lstrip("-") in ("inf", "nan"):
        raise ModelError(f"{text} cannot be written to a file; a finite number is needed")
    return text


def _true(flag: bool) -> str | None:
    return "true" if flag else None
