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
from typing import Any, Self, TypeVar, get_args
from weakref import ref

from kb.checks.findings import Finding
from kb.checks.model import check_model
from kb.contents import Elements, Observer, checked_fact, concerns, description, named, users_of
from kb.declarations import choice, identifier, listed
from kb.elements import (
    CHECKS,
    KINDS,
    REFERENCES,
    Action,
    Attribute,
    AttributeKind,
    Changeable,
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
    StalePolicy,
    called,
    finite_number,
)
from kb.exceptions import DuplicateName, ModelError, UnknownName
from kb.facts import Fact, RequiredFact, SelectedFact, StatusFact
from kb.files import SUFFIXES, ModelFileError, write_text

__all__ = ["Model"]

ElementT = TypeVar("ElementT", bound=Element)


class Model:
    """The knowledge about one robot.

    Args:
        name: what the model is called in messages and files.

    Each mapping below is by name, in order of declaration, and read-only.

    Attributes:
        notes: what a file said that has no meaning in a model, and what was made of it; `check` reports it.
        places: where the elements that come from files stand there, as file:line:column.
    """

    def __init__(self, name: str) -> None:
        self.name = identifier("model", name)
        self._tables: dict[type[Element], dict[str, Any]] = {cls: {} for cls in KINDS if issubclass(cls, Element)}
        self._constraints: dict[Constraint, None] = {}
        self._estimations: dict[Estimation, None] = {}
        self._facts: list[Fact] = []
        self._observers: list[ref[Observer]] = []
        self.notes: list[str] = []
        self.places: dict[Element | Constraint, str] = {}
        self.attributes: Mapping[str, Attribute] = self._elements(Attribute)
        self.components: Mapping[str, Component] = self._elements(Component)
        self.configurations: Mapping[str, Configuration] = self._elements(Configuration)
        self.functions: Mapping[str, Function] = self._elements(Function)
        self.designs: Mapping[str, FunctionDesign] = self._elements(FunctionDesign)
        self.actions: Mapping[str, Action] = self._elements(Action)

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
        return self.declare(
            Component,
            name,
            constraints,
            kind=kind,
            always_improve=always_improve,
            stops_to_configure=stops_to_configure,
            package=package,
            executable=executable,
        )

    def function(self, name: str, *, always_improve: bool = False) -> Function:
        """Declare something the robot can do as a means; `always_improve` chooses again even while it is solved."""
        return self.declare(Function, name, always_improve=always_improve)

    def action(
        self, name: str, *, requires: Iterable[Function | str] = (), constraints: Iterable[Expression] = ()
    ) -> Action:
        """Declare something a mission does, and the functions (or their names) that it requires."""
        return self.declare(Action, name, constraints, functions=requires)

    def declare(
        self, cls: type[ElementT], name: str, constraints: Iterable[Expression] = (), /, **given: object
    ) -> ElementT:
        """Declare an element of a class with its constraints, or nothing if one of its fields or these is refused.

        What each class is made of is said by its fields; other elements are given by themselves or by their names.
        """
        kind, table = KINDS[cls], self._tables[cls]
        name = identifier(kind, name)
        checks = CHECKS[cls]
        values = {
            field: checks[field].check(field, name, value) if field in checks else self._names(cls, name, field, value)
            for field, value in given.items()
        }
        try:
            element = cls(name, self, **values)
        except TypeError as error:
            raise ModelError(f"{kind} {name!r} is not complete: {error}") from None
        wanted = self._expressions(constraints) if constraints != () else ()
        if wanted:
            self._of_kind("constrained", element, Constrainable)
        if name in table:
            raise DuplicateName(f"{kind} {name!r} is declared already; names are unique within a kind")
        table[name] = element
        self._grew([element, *(self._constrained((element,), one) for one in wanted)])  # type: ignore[arg-type]  # constrainable, if any
        return element

    def constrain(self, elements: Iterable[Constrainable], expression: Expression) -> Constraint:
        """Add one constraint that all of the elements share."""
        (checked,) = self._expressions([expression])
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
        added = tuple(self._constrained((element,), one) for one in self._expressions(constraints))
        self._grew(added)
        return added

    def add_estimation(
        self, causer: Estimable, attribute: Attribute | str, value: float, kind: EstimationKind | str = "positive"
    ) -> Estimation:
        """State what choosing the causer does to an attribute; see `Component.estimate`."""
        self._owned("the causer of an estimation", causer, Estimable)
        affected = self._reference(Attribute, attribute)
        estimation = Estimation(affected, finite_number(value), choice("estimation kind", EstimationKind, kind), causer)
        self._estimations[estimation] = None
        self._grew([estimation])
        return estimation

    def add_fact(self, fact: Fact) -> None:
        """State what is so from the start; see `kb.facts`. A knowledge base that is already at work does not get it."""
        if isinstance(fact, StatusFact | RequiredFact | SelectedFact):
            self._owned("what a fact is about", fact.element, Changeable)
        self._facts.append(checked_fact(self, fact))

    def watch(self, observer: Observer) -> None:
        """Inform an observer of every change from now on, for as long as anybody else holds it."""
        self._observers.append(ref(observer, self._observers.remove))

    @classmethod
    def load(cls, paths: str | Path | Iterable[str | Path], name: str | None = None) -> Self:
        """Read a model from one file or several, each of which may add to those before it.

        Args:
            paths: files of ROSA's TypeQL (`.tql`), or of OWL (`.owl`).
            name: what the model is called; by default what the files say, else the first file's name.

        Raises:
            ModelError: the message names the file, line and column, what stands there and what was expected.
        """
        files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
        if not files:
            raise ModelError("no file is given to load a model from; give one path or several, in order")
        owl = [file for file in files if not _is_folder(file) and _suffix(file) == ".owl"]
        if owl and len(owl) < len(files):
            others = ", ".join(str(file) for file in files if file not in owl)
            raise ModelFileError(f"files of one model are all in one format; {others} is in another", str(owl[0]))
        if owl:
            from kb.owl.owlready import load_owl

            return load_owl(cls, files, name)
        from kb.typeql.reader import load_typeql

        return load_typeql(cls, files, name)

    def save(self, path: str | Path) -> None:
        """Write the model to a file (`.tql`, `.owl`) that `load` reads back as it is; nothing half-written stays."""
        file = Path(path)
        if _suffix(file) == ".owl":
            from kb.owl.rdfxml import owl_text as written
        else:
            from kb.typeql.writer import typeql_text as written
        write_text(file, written(self))

    def check(self, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
        """Find what can never work, contradicts itself or is likely a slip, and what to do about it.

        Args:
            names: the action names that a mission's tree or PDDL domain uses; those that do not match are found too.
        """
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
        checks = {field: one.check for field, one in CHECKS[type(element)].items() if one.can_change}
        for field in fields:
            if field not in checks:
                allowed = ", ".join(checks) or "nothing"
                kind = KINDS[type(element)]
                raise ModelError(f"{field!r} of {kind} {called(element)!r} cannot change; what can: {allowed}")
        values = {field: checks[field](field, called(element), value) for field, value in fields.items()}
        for field, new in values.items():
            object.__setattr__(element, field, new)
        for observer in self._watching():
            observer.model_changed(element)

    def remove(self, element: Changeable | str) -> None:
        """Take an element, or the only one that has a name, out of the model, with what constrains or estimates it.

        A constraint on other elements too is only loosened from this one.

        Raises:
            ModelError: something else in the model is made of it; the message names what.
        """
        element = self._meant("what is removed", element)
        users = users_of(self, element) if isinstance(element, Element) else []
        if users:
            raise ModelError(f"{called(element)!r} is needed by {', '.join(users)}; remove that first")
        removed: list[Changeable] = [element]
        for constraint in self.constraints:
            if element in constraint.constrained:
                rest = tuple(one for one in constraint.constrained if one is not element)
                if rest:
                    object.__setattr__(constraint, "constrained", rest)
                else:
                    removed.append(constraint)
        removed += [one for one in self.estimations if one.causer is element]
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

    def _elements(self, cls: type[ElementT]) -> Elements[ElementT]:
        return Elements(KINDS[cls], self._tables[cls])

    def _attribute(self, name: str, kind: AttributeKind, *given: object) -> Attribute:
        max_age, when_stale, agreement = given
        return self.declare(Attribute, name, kind=kind, max_age=max_age, when_stale=when_stale, agreement=agreement)

    def _names(self, cls: type[Element], name: str, field: str, value: object) -> object:
        """Return the names that a field is given that names other elements."""
        if field not in REFERENCES:
            raise UnknownName(f"field of {KINDS[cls]}", field, CHECKS[cls])
        if field not in ("functions", "components"):
            return self._reference(REFERENCES[field], value)
        given = listed(f"the {field} of {name!r}", value)
        return tuple(dict.fromkeys(self._reference(REFERENCES[field], one) for one in given))

    def _reference(self, cls: type[Element], given: object) -> str:
        """Return the name of an element that is referred to by itself or by its name."""
        kind, table = KINDS[cls], self._tables[cls]
        if not isinstance(given, Element):
            if isinstance(given, str) and given in table:
                return given
            raise UnknownName(kind, given, table)
        if given.model is not self:
            raise ModelError(f"{kind} {given.name!r} belongs to model {given.model.name!r}, not to {self.name!r}")
        name = given.name
        if table.get(name) is not given:
            raise ModelError(f"a {kind} is needed here, not the {type(given).__name__} {name!r}")
        return name

    def _expressions(self, values: object) -> tuple[Expression, ...]:
        wanted = listed("constraints", values)
        for expression in wanted:
            if not isinstance(expression, Expression):
                raise ModelError(f"a constraint is a comparison such as `light >= 0.5`, not {expression!r}")
            of = expression.model
            if of is not None and of is not self:
                raise ModelError(f"{expression} compares an attribute of {of.name!r}, not of {self.name!r}")
            self._reference(Attribute, expression.attribute)
        return wanted

    def _constrained(self, targets: tuple[Constrainable, ...], one: Expression) -> Constraint:
        constraint = Constraint(one.attribute, one.operator, one.value, targets, one.hysteresis, one.dwell)
        self._constraints[constraint] = None
        return constraint

    def _grew(self, added: Sequence[Changeable]) -> None:
        for observer in self._watching() if self._observers else ():
            observer.model_grew(added)

    def _watching(self) -> list[Observer]:
        return [observer for one in tuple(self._observers) if (observer := one()) is not None]

    def _meant(self, what: str, element: Changeable | str) -> Changeable:
        found = named(self, element) if isinstance(element, str) else element
        self._owned(what, found, Changeable)
        return found

    def _of_kind(self, what: str, element: object, kinds: UnionType) -> None:
        if not isinstance(element, kinds):
            names = ", ".join(kind.__name__ for kind in get_args(kinds))
            raise ModelError(f"{what} can be one of {names}; not {element!r}")

    def _owned(self, what: str, element: object, kinds: UnionType) -> None:
        self._of_kind(what, element, kinds)
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


def _is_folder(file: Path) -> bool:
    try:
        return file.is_dir()
    except (OSError, ValueError):
        return False


def _suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        given = f"the suffix {file.suffix!r}" if file.suffix else "no suffix"
        raise ModelFileError(f"{given} says no format of models; there are {', '.join(SUFFIXES)}", str(file))
    return suffix
