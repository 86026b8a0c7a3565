"""The builder: how the elements of a robot's model are declared and related.

    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera_node", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    camera.configuration("night", {"exposure": 0.20}, priority=2)
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    explore = model.action("explore", requires=[see])
    explore.constrain(light >= 0.05)

A name is unique within its kind, not across kinds. Elements refer to one another by name.
"""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Protocol, TypeVar

from kb.elements import (
    Action,
    Attribute,
    AttributeKind,
    Component,
    ComponentKind,
    Configuration,
    Constrainable,
    Constraint,
    Element,
    Estimable,
    Estimation,
    EstimationKind,
    Expression,
    Function,
    FunctionDesign,
    Parameter,
    Parameters,
    finite_number,
)
from kb.exceptions import DuplicateName, ModelError, UnknownName

__all__ = ["Model"]


class _Named(Protocol):
    @property
    def name(self) -> str: ...


NamedT = TypeVar("NamedT", bound=_Named)


class Model:
    """The knowledge about one robot, complete before it moves.

    Args:
        name: what the model is called in messages and files.

    Each mapping below is by name, in order of declaration, and read-only.

    """

    def __init__(self, name: str) -> None:
        self.name = _identifier("model", name)
        self._attributes: dict[str, Attribute] = {}
        self._components: dict[str, Component] = {}
        self._configurations: dict[str, Configuration] = {}
        self._functions: dict[str, Function] = {}
        self._designs: dict[str, FunctionDesign] = {}
        self._actions: dict[str, Action] = {}
        self._constraints: list[Constraint] = []
        self._estimations: list[Estimation] = []
        self.attributes: Mapping[str, Attribute] = MappingProxyType(self._attributes)
        self.components: Mapping[str, Component] = MappingProxyType(self._components)
        self.configurations: Mapping[str, Configuration] = MappingProxyType(self._configurations)
        self.functions: Mapping[str, Function] = MappingProxyType(self._functions)
        self.designs: Mapping[str, FunctionDesign] = MappingProxyType(self._designs)
        self.actions: Mapping[str, Action] = MappingProxyType(self._actions)

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All constraints, in order of declaration."""
        return tuple(self._constraints)

    @property
    def estimations(self) -> tuple[Estimation, ...]:
        """All estimations, in order of declaration."""
        return tuple(self._estimations)

    def quality_attribute(self, name: str) -> Attribute:
        """Declare a measured property of the robot itself, e.g. its energy."""
        return _add("attribute", self._attributes, Attribute(name, self, AttributeKind.QUALITY))

    def environmental_attribute(self, name: str) -> Attribute:
        """Declare a measured property of the surroundings, e.g. the light."""
        return _add("attribute", self._attributes, Attribute(name, self, AttributeKind.ENVIRONMENTAL))

    def component(
        self,
        name: str,
        *,
        kind: ComponentKind | str = ComponentKind.PLAIN,
        always_improve: bool = False,
        stops_to_configure: bool = False,
        package: str = "",
        executable: str = "",
        constraints: Iterable[Expression] = (),
    ) -> Component:
        """Declare a part of the robot; a part that the manager shall switch is a "process" or a "lifecycle" one."""
        choice = _choice("component kind", ComponentKind, kind)
        component = Component(name, self, choice, always_improve, stops_to_configure, package, executable)
        return self._added("component", self._components, component, constraints)

    def function(self, name: str, *, always_improve: bool = False) -> Function:
        """Declare something the robot can do as a means; `always_improve` chooses again even while it is solved."""
        return _add("function", self._functions, Function(name, self, always_improve))

    def action(
        self, name: str, *, requires: Iterable[Function | str] = (), constraints: Iterable[Expression] = ()
    ) -> Action:
        """Declare something a mission does, and the functions (or their names) that it requires."""
        functions = tuple(_reference("function", self._functions, function, self) for function in requires)
        return self._added("action", self._actions, Action(name, self, functions), constraints)

    def add_design(
        self,
        name: str,
        function: Function | str,
        components: Iterable[Component | str],
        priority: int | None = None,
        constraints: Iterable[Expression] = (),
    ) -> FunctionDesign:
        """Declare a function design; see `Function.design`."""
        of = _reference("function", self._functions, function, self)
        parts = tuple(_reference("component", self._components, component, self) for component in components)
        design = FunctionDesign(name, self, of, parts, _priority(name, priority))
        return self._added("function design", self._designs, design, constraints)

    def add_configuration(
        self,
        name: str,
        component: Component | str,
        parameters: Parameters,
        priority: int | None = None,
        constraints: Iterable[Expression] = (),
    ) -> Configuration:
        """Declare a component configuration; see `Component.configuration`."""
        of = _reference("component", self._components, component, self)
        values = MappingProxyType({str(key): _parameter(name, key, value) for key, value in parameters.items()})
        configuration = Configuration(name, self, of, values, _priority(name, priority))
        return self._added("configuration", self._configurations, configuration, constraints)

    def constrain(self, elements: Iterable[Constrainable], expression: Expression) -> Constraint:
        """Add one constraint that all of the elements share."""
        if not isinstance(expression, Expression):
            raise ModelError(f"a constraint is a comparison such as `light >= 0.5`, not {expression!r}")
        _reference("attribute", self._attributes, expression.attribute, self)
        targets = tuple(elements)
        for element in targets:
            if element.model is not self:
                raise ModelError(f"{element.name!r} belongs to model {element.model.name!r}, not to {self.name!r}")
        constraint = Constraint(expression.attribute, expression.operator, expression.value, targets)
        self._constraints.append(constraint)
        return constraint

    def add_estimation(
        self, causer: Estimable, attribute: Attribute | str, value: float, kind: EstimationKind | str = "positive"
    ) -> Estimation:
        """State what choosing the causer does to an attribute; see `Component.estimate`."""
        affected = _reference("attribute", self._attributes, attribute, self)
        choice = _choice("estimation kind", EstimationKind, kind)
        estimation = Estimation(affected, finite_number(value), choice, causer)
        self._estimations.append(estimation)
        return estimation

    def _added(
        self,
        kind: str,
        table: dict[str, "AddedT"],
        element: "AddedT",
        expressions: Iterable[Expression],
    ) -> "AddedT":
        wanted = tuple(expressions)
        for expression in wanted:
            if not isinstance(expression, Expression):
                raise ModelError(f"a constraint is a comparison such as `light >= 0.5`, not {expression!r}")
            _reference("attribute", self._attributes, expression.attribute, self)
        _add(kind, table, element)
        for expression in wanted:
            self.constrain([element], expression)
        return element


AddedT = TypeVar("AddedT", Action, FunctionDesign, Component, Configuration)
ChoiceT = TypeVar("ChoiceT", bound=StrEnum)


def _identifier(kind: str, name: object) -> str:
    if not isinstance(name, str) or not name.strip():
        raise ModelError(f"the name of a {kind} is a non-empty text, not {name!r}")
    return name


def _add(kind: str, table: dict[str, NamedT], element: NamedT) -> NamedT:
    name = _identifier(kind, element.name)
    if name in table:
        raise DuplicateName(f"there is a {kind} {name!r} already; names are unique within a kind")
    table[name] = element
    return element


def _reference(kind: str, table: Mapping[str, Element], given: object, model: Model) -> str:
    if isinstance(given, Element) and given.model is not model:
        raise ModelError(f"{kind} {given.name!r} belongs to model {given.model.name!r}, not to {model.name!r}")
    name = given.name if isinstance(given, Element) else given
    if not isinstance(name, str) or name not in table:
        raise UnknownName(kind, name, table)
    return name


def _priority(name: str, priority: object) -> int | None:
    if priority is None or (isinstance(priority, int) and not isinstance(priority, bool)):
        return priority
    raise ModelError(f"the priority of {name!r} is a whole number or None, not {priority!r}")


def _choice(what: str, options: type[ChoiceT], given: str) -> ChoiceT:
    try:
        return options(given)
    except ValueError:
        raise UnknownName(what, given, [str(option) for option in options]) from None


def _parameter(configuration: str, key: object, value: object) -> Parameter:
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, list | tuple) and len({type(item) for item in value}) <= 1:
        items = [item for item in value if isinstance(item, bool | int | float | str)]
        if len(items) == len(value):
            return items  # type: ignore[return-value]  # one type throughout: checked on the line above
    raise ModelError(
        f"parameter {key!r} of configuration {configuration!r} is {value!r}; "
        "allowed are a boolean, a number, a text, or a list of one of these"
    )
