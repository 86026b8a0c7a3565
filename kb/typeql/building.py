"""From what files tell to a model: elements in the order in which they are told, then what is so from the start."""

import re
from collections.abc import Callable, Container
from itertools import count
from typing import Final, TypeVar

from kb.contents import Contents
from kb.elements import (
    Action,
    Attribute,
    AttributeKind,
    Component,
    ComponentKind,
    Configuration,
    Constraint,
    Element,
    Expression,
    Function,
    FunctionDesign,
    Parameter,
    StalePolicy,
)
from kb.typeql.facts import Elements, facts
from kb.typeql.store import Store, Thing
from kb.typeql.values import parameter
from kb.typeql.words import ROLES, SLIPS, Kind

__all__ = ["ModelT", "build"]

ModelT = TypeVar("ModelT", bound=Contents)

_COMPONENT_KINDS: Final = {"LifeCycleNode": ComponentKind.LIFECYCLE, "ROSNode": ComponentKind.PROCESS}


def build(cls: Callable[[str], ModelT], store: Store, name: str | None, stem: str) -> ModelT:
    """Make a model of all that was told, or raise.

    Args:
        cls: what to make.
        store: what was told.
        name: what the model is called; by default what the files say.
        stem: what it is called if they do not say.
    """
    for kind, roles in ROLES.items():
        for thing in store.things.get(kind, ()):
            for role in roles:
                if len(thing.players(role.name)) < role.least and not _stated(thing):
                    raise thing.place.error(f"this {thing.type.label} has no {role.name}; write ({role.name}: $x, ...)")
    for kind, whole in ((Kind.DESIGN, "function"), (Kind.CONFIGURATION, "component")):
        for thing in store.things.get(kind, ()):
            if thing.own("name") is None:
                _christen(store, thing, f"{thing.players(whole)[0].name} {kind.value.split()[1]}")
    said = (one.name for one in store.things.get(Kind.MODEL, ()))
    model = cls(name if name is not None else next(said, stem))
    _Building(model, store).run()
    model.notes.extend(store.notes)
    return model


def _stated(thing: Thing) -> bool:
    """Tell whether a constraint is only there to carry a status, whatever it compares."""
    return thing.kind is Kind.CONSTRAINT and thing.own("status") is not None and bool(thing.players("constrained"))


class _Building:
    """A model in the making."""

    def __init__(self, model: Contents, store: Store) -> None:
        self.model, self.store = model, store
        self.elements: Elements = {}

    def run(self) -> None:
        """Declare everything, each kind after those that it refers to."""
        makers: dict[Kind, Callable[[Thing], Element | Constraint]] = {
            Kind.ATTRIBUTE: self._attribute,
            Kind.COMPONENT: self._component,
            Kind.CONFIGURATION: self._configuration,
            Kind.FUNCTION: self._function,
            Kind.DESIGN: self._design,
            Kind.ACTION: self._action,
            Kind.CONSTRAINT: self._constraint,
        }
        self.required = self._requirements()
        for kind, make in makers.items():
            for thing in self._told(kind):
                with thing.place.blamed():
                    self.elements[thing] = element = make(thing)
                    self.model.places[element] = str(thing.place)
        for thing in self._told(Kind.ESTIMATION):
            with thing.place.blamed():
                self._estimate(thing)
        for fact, place in facts(self.store, self.elements):
            with place.blamed():
                self.model.add_fact(fact)

    def _told(self, kind: Kind) -> list[Thing]:
        return self.store.things.get(kind, [])

    def _attribute(self, thing: Thing) -> Element:
        environmental = any(one.label == "EnvironmentalAttribute" for one in thing.type.lineage())
        kind = AttributeKind.ENVIRONMENTAL if environmental else AttributeKind.QUALITY
        policy = thing.value("when_stale")
        return self.model.declare(
            Attribute,
            thing.name,
            kind=kind,
            max_age=_number(thing, "max_age", float("inf")),
            when_stale=StalePolicy.NOT_EVALUATED if policy is None else str(policy),
            agreement=_agreement(thing),
        )

    def _component(self, thing: Thing) -> Element:
        kinds = (_COMPONENT_KINDS[one.label] for one in thing.type.lineage() if one.label in _COMPONENT_KINDS)
        return self.model.declare(
            Component,
            thing.name,
            kind=next(kinds, ComponentKind.PLAIN),
            always_improve=bool(thing.value("always_improve")),
            stops_to_configure=bool(thing.value("stops_to_configure")),
            package=str(thing.value("package") or ""),
            executable=str(thing.value("executable") or ""),
        )

    def _configuration(self, thing: Thing) -> Element:
        (component,) = _names(thing, "component")
        values: dict[str, Parameter] = {}
        for one in thing.players("parameter"):
            key, value = _parameter(one)
            if key in values and values[key] != value:
                raise one.place.error(f"parameter {key!r} has two values in one configuration")
            values[key] = value
        return self.model.declare(
            Configuration, thing.name, component=component, parameters=values, priority=_priority(thing)
        )

    def _function(self, thing: Thing) -> Element:
        return self.model.declare(Function, thing.name, always_improve=bool(thing.value("always_improve")))

    def _design(self, thing: Thing) -> Element:
        (function,) = _names(thing, "function")
        parts = _names(thing, "required-component")
        return self.model.declare(
            FunctionDesign, thing.name, function=function, components=parts, priority=_priority(thing)
        )

    def _action(self, thing: Thing) -> Element:
        return self.model.declare(Action, thing.name, functions=self.required.get(thing, ()))

    def _requirements(self) -> dict[Thing, list[str]]:
        """Return the functions of each action; an action may stand in several requirements."""
        required: dict[Thing, list[str]] = {}
        for relation in self._told(Kind.REQUIREMENT):
            functions = [one.name for one in relation.players("required-function")]
            for action in relation.players("action"):
                before = required.setdefault(action, [])
                before += [one for one in functions if one not in before] if before else functions
        return required

    def _constraint(self, thing: Thing) -> Constraint:
        sign = str(thing.value("operator") or ">=").strip()
        attributes = _names(thing, "attribute") or [self._stand_in(thing)]
        value = _number(thing, "value", 0.0 if _stated(thing) else None)
        constrained = [self.elements[one] for one in thing.players("constrained")]
        place = (thing.own("operator") or thing).place
        if sign in SLIPS:
            raise place.error(f"{sign!r} is no comparison; did you mean {SLIPS[sign]!r}?")
        with place.blamed():
            expression = Expression(attributes[0], sign, value, self.model).steady(
                hysteresis=_number(thing, "hysteresis", 0.0), dwell=_number(thing, "dwell", 0.0)
            )
        return self.model.constrain(constrained, expression)  # type: ignore[arg-type]  # the role lets no other in

    def _stand_in(self, thing: Thing) -> str:
        name = _unused("unnamed attribute", self.store.named[Kind.ATTRIBUTE])
        self.store.note(thing.place, f"this constraint has a status and no attribute; it is given {name!r}")
        self.store.named[Kind.ATTRIBUTE][name] = thing
        return self.model.declare(Attribute, name).name

    def _estimate(self, thing: Thing) -> None:
        value, kind = _number(thing, "value"), thing.own("type")
        for attribute in _names(thing, "affected"):
            for causer in thing.players("causer"):
                with (kind or thing).place.blamed():
                    sense = str(kind.value).strip().lower() if kind else "positive"
                    self.model.add_estimation(self.elements[causer], attribute, value, sense)  # type: ignore[arg-type]  # the role lets no other in


def _names(thing: Thing, role: str) -> list[str]:
    return [one.name for one in thing.players(role)]


def _number(thing: Thing, name: str, default: float | None = None) -> float:
    value = thing.value(name)
    if isinstance(value, int | float):
        return value
    if default is None and thing.kind:
        raise thing.place.error(f"this {thing.type.label} has no {name}; write `has {thing.kind.label}-{name} 0.5`")
    return default or 0.0


def _agreement(thing: Thing) -> tuple[int, int]:
    """Return (n, k) of "n of k"."""
    own = thing.own("agreement")
    if own is None:
        return (1, 1)
    found = re.fullmatch(r"\s*(\d+)\s+of\s+(\d+)\s*", str(own.value))
    if found is None:
        raise own.place.error(f"{own.value!r} is no agreement; write e.g. '2 of 3'")
    return int(found[1]), int(found[2])


def _priority(thing: Thing) -> float | None:
    value = thing.value("priority")
    return value if isinstance(value, int | float) else None


def _parameter(thing: Thing) -> tuple[str, Parameter]:
    key, value, sort = thing.own("key"), thing.own("value"), thing.value("type")
    if key is None or value is None:
        missing = "key" if key is None else "value"
        raise thing.place.error(f"this {thing.type.label} has no {missing}; write `has parameter-{missing} '...'`")
    return str(key.value), parameter(value.value, None if sort is None else str(sort), value.place)


def _christen(store: Store, thing: Thing, stem: str) -> None:
    """Give a name that no other has to a design or configuration without one."""
    assert thing.kind is not None
    name = _unused(stem, store.named[thing.kind])
    store.give(thing, "name", name, thing.place)
    store.note(thing.place, f"this {thing.type.label} has no name; it is called {name!r}")


def _unused(stem: str, taken: Container[str]) -> str:
    return next(name for number in count(1) if (name := f"{stem} {number}") not in taken)
