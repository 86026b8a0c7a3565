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
from types import MappingProxyType, UnionType
from typing import TypeVar, get_args

from kb.declarations import choice, expressions, flag, identifier, listed, reference, text
from kb.declarations import parameters as checked_parameters
from kb.declarations import priority as checked_priority
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
    Parameters,
    finite_number,
)
from kb.exceptions import DuplicateName, ModelError

__all__ = ["Model"]


NamedT = TypeVar("NamedT", bound=Element)
ConstrainedT = TypeVar("ConstrainedT", bound=Constrainable)


class Model:
    """The knowledge about one robot, complete before it moves.

    Args:
        name: what the model is called in messages and files.

    Each mapping below is by name, in order of declaration, and read-only.
    """

    def __init__(self, name: str) -> None:
        self.name = identifier("model", name)
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
        component = Component(
            name,
            self,
            choice("component kind", ComponentKind, kind),
            flag(f"always_improve of {name!r}", always_improve),
            flag(f"stops_to_configure of {name!r}", stops_to_configure),
            text(f"the package of {name!r}", package),
            text(f"the executable of {name!r}", executable),
        )
        return self._added("component", self._components, component, constraints)

    def function(self, name: str, *, always_improve: bool = False) -> Function:
        """Declare something the robot can do as a means; `always_improve` chooses again even while it is solved."""
        improve = flag(f"always_improve of {name!r}", always_improve)
        return _add("function", self._functions, Function(name, self, improve))

    def action(
        self, name: str, *, requires: Iterable[Function | str] = (), constraints: Iterable[Expression] = ()
    ) -> Action:
        """Declare something a mission does, and the functions (or their names) that it requires."""
        wanted = listed("the functions of an action", requires)
        functions = tuple(reference("function", self._functions, function, self) for function in wanted)
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
        of = reference("function", self._functions, function, self)
        wanted = listed("the components of a design", components)
        parts = dict.fromkeys(reference("component", self._components, component, self) for component in wanted)
        design = FunctionDesign(name, self, of, tuple(parts), checked_priority(name, priority))
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
        of = reference("component", self._components, component, self)
        values = checked_parameters(name, parameters)
        configuration = Configuration(name, self, of, values, checked_priority(name, priority))
        return self._added("configuration", self._configurations, configuration, constraints)

    def constrain(self, elements: Iterable[Constrainable], expression: Expression) -> Constraint:
        """Add one constraint that all of the elements share."""
        (checked,) = expressions(self, self._attributes, [expression])
        targets = listed("constrained elements", elements)
        if not targets:
            raise ModelError(f"{checked} constrains nothing; name at least one element")
        for element in targets:
            self._owned("constrained", element, Constrainable)
        return self._constrained(targets, checked)

    def constrain_all(self, element: Constrainable, constraints: Iterable[Expression]) -> None:
        """Add each constraint to an element, or none if one of them is refused."""
        self._owned("constrained", element, Constrainable)
        for checked in expressions(self, self._attributes, constraints):
            self._constrained((element,), checked)

    def add_estimation(
        self, causer: Estimable, attribute: Attribute | str, value: float, kind: EstimationKind | str = "positive"
    ) -> Estimation:
        """State what choosing the causer does to an attribute; see `Component.estimate`."""
        self._owned("the causer of an estimation", causer, Estimable)
        affected = reference("attribute", self._attributes, attribute, self)
        sense = choice("estimation kind", EstimationKind, kind)
        estimation = Estimation(affected, finite_number(value), sense, causer)
        self._estimations.append(estimation)
        return estimation

    def _added(
        self, kind: str, table: dict[str, ConstrainedT], element: ConstrainedT, constraints: Iterable[Expression]
    ) -> ConstrainedT:
        """Add an element with its constraints, or nothing if one of them is refused."""
        wanted = expressions(self, self._attributes, constraints)
        _add(kind, table, element)
        self.constrain_all(element, wanted)
        return element

    def _constrained(self, targets: tuple[Constrainable, ...], checked: Expression) -> Constraint:
        constraint = Constraint(checked.attribute, checked.operator, checked.value, targets)
        self._constraints.append(constraint)
        return constraint

    def _owned(self, what: str, element: object, kinds: UnionType) -> None:
        if not isinstance(element, kinds):
            names = ", ".join(kind.__name__ for kind in get_args(kinds))
            raise ModelError(f"{what} can be one of {names}; not {element!r}")
        if element.model is not self:
            raise ModelError(f"{element.name!r} belongs to model {element.model.name!r}, not to {self.name!r}")


def _add(kind: str, table: dict[str, NamedT], element: NamedT) -> NamedT:
    name = identifier(kind, element.name)
    if name in table:
        raise DuplicateName(f"{kind} {name!r} is declared already; names are unique within a kind")
    table[name] = element
    return element
