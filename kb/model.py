"""The builder: how the elements of a robot's model are declared and related.

    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera_node", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    model.action("explore", requires=[see], constraints=[light >= 0.05])

A name is unique within its kind, not across kinds. Elements refer to one another by name. A model can be changed while
knowledge bases are at work on it: the next question that they are asked sees it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, TypeVar, get_args
from weakref import ref

from kb.amendments import (
    Changeable,
    Elements,
    Observer,
    checked_changes,
    checked_fact,
    concerns,
    description,
    named,
    removal,
)
from kb.declarations import age, choice, expressions, flag, identifier, listed, reference, text
from kb.declarations import agreement as checked_agreement
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
    StalePolicy,
    finite_number,
)
from kb.exceptions import DuplicateName, ModelError
from kb.facts import Fact, RequiredFact, SelectedFact, StatusFact

if TYPE_CHECKING:
    from kb.judge.findings import Finding

__all__ = ["Model"]

NamedT = TypeVar("NamedT", bound=Element)


class Model:
    """The knowledge about one robot.

    Args:
        name: what the model is called in messages and files.

    Each mapping below is by name, in order of declaration, and read-only.

    Attributes:
        notes: what a file said that has no meaning in a model, and what was made of it; for the judge.
        places: where the elements that come from files stand there, as file:line:column.
    """

    def __init__(self, name: str) -> None:
        self.name = identifier("model", name)
        self._attributes: dict[str, Attribute] = {}
        self._components: dict[str, Component] = {}
        self._configurations: dict[str, Configuration] = {}
        self._functions: dict[str, Function] = {}
        self._designs: dict[str, FunctionDesign] = {}
        self._actions: dict[str, Action] = {}
        self._tables: dict[type[Element], dict[str, Any]] = {
            Attribute: self._attributes,
            Component: self._components,
            Configuration: self._configurations,
            Function: self._functions,
            FunctionDesign: self._designs,
            Action: self._actions,
        }
        self._constraints: dict[Constraint, None] = {}
        self._estimations: dict[Estimation, None] = {}
        self._facts: list[Fact] = []
        self.notes: list[str] = []
        self.places: dict[Element | Constraint, str] = {}
        self._observers: list[ref[Observer]] = []
        self.attributes: Mapping[str, Attribute] = Elements("attribute", self._attributes)
        self.components: Mapping[str, Component] = Elements("component", self._components)
        self.configurations: Mapping[str, Configuration] = Elements("configuration", self._configurations)
        self.functions: Mapping[str, Function] = Elements("function", self._functions)
        self.designs: Mapping[str, FunctionDesign] = Elements("function design", self._designs)
        self.actions: Mapping[str, Action] = Elements("action", self._actions)

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All constraints, in order of declaration."""
        return tuple(self._constraints)

    @property
    def estimations(self) -> tuple[Estimation, ...]:
        """All estimations, in order of declaration."""
        return tuple(self._estimations)

    @property
    def facts(self) -> tuple[Fact, ...]:
        """What is stated to be so from the start, in order."""
        return tuple(self._facts)

    def quality_attribute(
        self,
        name: str,
        *,
        max_age: float = math.inf,
        when_stale: StalePolicy | str = StalePolicy.NOT_EVALUATED,
        agreement: tuple[int, int] = (1, 1),
    ) -> Attribute:
        """Declare a measured property of the robot itself, e.g. its energy.

        Args:
            name: unique among attributes.
            max_age: how long a measurement holds [s].
            when_stale: what its constraints are after that: "not evaluated" or "violated".
            agreement: (n, k): n of the last k measurements have to say so before a constraint on it changes.
        """
        return self._attribute(name, AttributeKind.QUALITY, max_age, when_stale, agreement)

    def environmental_attribute(
        self,
        name: str,
        *,
        max_age: float = math.inf,
        when_stale: StalePolicy | str = StalePolicy.NOT_EVALUATED,
        agreement: tuple[int, int] = (1, 1),
    ) -> Attribute:
        """Declare a measured property of the surroundings, e.g. the light; see `quality_attribute`."""
        return self._attribute(name, AttributeKind.ENVIRONMENTAL, max_age, when_stale, agreement)

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
        return self._added("function", self._functions, Function(name, self, improve))

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
        constraint = self._constrained(targets, checked)
        self._grew([constraint])
        return constraint

    def constrain_all(self, element: Constrainable, constraints: Iterable[Expression]) -> tuple[Constraint, ...]:
        """Add each constraint to an element, or none if one of them is refused."""
        self._owned("constrained", element, Constrainable)
        wanted = expressions(self, self._attributes, constraints)
        added = tuple(self._constrained((element,), one) for one in wanted)
        self._grew(added)
        return added

    def add_estimation(
        self, causer: Estimable, attribute: Attribute | str, value: float, kind: EstimationKind | str = "positive"
    ) -> Estimation:
        """State what choosing the causer does to an attribute; see `Component.estimate`."""
        self._owned("the causer of an estimation", causer, Estimable)
        affected = reference("attribute", self._attributes, attribute, self)
        sense = choice("estimation kind", EstimationKind, kind)
        estimation = Estimation(affected, finite_number(value), sense, causer)
        self._estimations[estimation] = None
        self._grew([estimation])
        return estimation

    def add_fact(self, fact: Fact) -> None:
        """State what is so from the start; see `kb.facts`. A knowledge base that is already at work is not told."""
        if isinstance(fact, StatusFact | RequiredFact | SelectedFact):
            self._owned("what a fact is about", fact.element, Changeable)
        self._facts.append(checked_fact(self, fact))

    def watch(self, observer: Observer) -> None:
        """Have something told of every change from now on, for as long as anybody else holds it."""
        if not isinstance(observer, Observer):
            raise ModelError(
                f"an observer of a model has model_grew, model_changed and model_shrank; {observer!r} has not"
            )
        self._observers.append(ref(observer, self._observers.remove))

    @classmethod
    def load(cls, paths: str | Path | Iterable[str | Path], name: str | None = None) -> "Model":
        """Read a model from one file or several, each of which may add to those before it.

        Args:
            paths: files of ROSA's TypeQL (`.tql`), or of OWL (`.owl`).
            name: what the model is called; by default what the files say, else the first file's name.

        Raises:
            ModelError: the message names the file, line and column, what stands there and what was expected.
        """
        from kb.files import load_model

        return load_model(cls, paths, name)

    def save(self, path: str | Path) -> None:
        """Write the model to a file (`.tql`, `.owl`) that `load` reads back as it is; nothing half-written stays."""
        from kb.files import save_model

        save_model(self, path)

    def check(self, names: Iterable[str] | None = None) -> tuple["Finding", ...]:
        """Judge the model: what can never work, contradicts itself or is likely a slip, and what to do about it.

        Args:
            names: the action names that a mission's tree or PDDL domain uses; those that do not match are found too.
        """
        from kb.judge import check_model

        return check_model(self, names)

    def change(self, element: Changeable | str, **fields: object) -> None:
        """Change what may change of an element, e.g. `model.change(design, priority=2)`, or nothing if one is refused.

        Args:
            element: of this model, or a name that only one has; a constraint is what `constrain` returned.
            fields: new values; of a constraint `value`, `hysteresis` and `dwell`, of a design its `priority`, of a
                configuration also its `parameters`, of a function or component `always_improve`, of an attribute
                `max_age`, `when_stale` and `agreement`, of a component also `stops_to_configure`, of an estimation
                `value` and `kind`.
        """
        element = self._meant("what is changed", element)
        for name, value in checked_changes(element, fields).items():
            object.__setattr__(element, name, value)
        for observer in self._watching():
            observer.model_changed(element)

    def remove(self, element: Changeable | str) -> None:
        """Take an element, or the only one that has a name, out of the model, with what constrains or estimates it.

        Raises:
            ModelError: something else in the model is made of it; the message names what.
        """
        element = self._meant("what is removed", element)
        removed = removal(self, element)
        for one in removed:
            if isinstance(one, Constraint):
                del self._constraints[one]
            elif isinstance(one, Estimation):
                del self._estimations[one]
            else:
                del self._tables[type(one)][one.name]
        self._facts = [fact for fact in self._facts if not concerns(fact, removed)]
        for observer in self._watching():
            observer.model_shrank(removed)

    def __eq__(self, other: object) -> bool:
        """Tell whether two models have the same name and say the same, in the same order within each kind."""
        return isinstance(other, Model) and (self is other or description(self) == description(other))

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"<Model {self.name!r}>"

    def _attribute(
        self,
        name: str,
        kind: AttributeKind,
        max_age: float,
        when_stale: StalePolicy | str,
        agreement: tuple[int, int],
    ) -> Attribute:
        policy = choice("policy for stale measurements", StalePolicy, when_stale)
        agreed = checked_agreement(name, agreement)
        attribute = Attribute(name, self, kind, age(name, max_age), policy, agreed)
        return self._added("attribute", self._attributes, attribute)

    def _added(
        self, kind: str, table: dict[str, NamedT], element: NamedT, constraints: Iterable[Expression] = ()
    ) -> NamedT:
        """Add an element with its constraints, or nothing if one of them is refused."""
        wanted = expressions(self, self._attributes, constraints)
        name = identifier(kind, element.name)
        if name in table:
            raise DuplicateName(f"{kind} {name!r} is declared already; names are unique within a kind")
        table[name] = element
        own = [self._constrained((element,), one) for one in wanted]  # type: ignore[arg-type]  # constrainable, if any
        self._grew([element, *own])
        return element

    def _constrained(self, targets: tuple[Constrainable, ...], checked: Expression) -> Constraint:
        constraint = Constraint(
            checked.attribute, checked.operator, checked.value, targets, checked.hysteresis, checked.dwell
        )
        self._constraints[constraint] = None
        return constraint

    def _grew(self, added: Sequence[Changeable]) -> None:
        for observer in self._watching():
            observer.model_grew(added)

    def _watching(self) -> list[Observer]:
        return [observer for one in tuple(self._observers) if (observer := one()) is not None]

    def _meant(self, what: str, element: Changeable | str) -> Changeable:
        found = named(self, element) if isinstance(element, str) else element
        self._owned(what, found, Changeable)
        return found

    def _owned(self, what: str, element: object, kinds: UnionType) -> None:
        if not isinstance(element, kinds):
            names = ", ".join(kind.__name__ for kind in get_args(kinds))
            raise ModelError(f"{what} can be one of {names}; not {element!r}")
        if isinstance(element, Constraint):
            found, name = element in self._constraints, str(element)
        elif isinstance(element, Estimation):
            found, name = element in self._estimations, f"the estimation of {element.attribute!r}"
        else:
            assert isinstance(element, Element)
            if element.model is not self:
                raise ModelError(f"{element.name!r} belongs to model {element.model.name!r}, not to {self.name!r}")
            found, name = self._tables[type(element)].get(element.name) is element, repr(element.name)
        if not found:
            raise ModelError(f"{name} is not in model {self.name!r}, or no longer")
