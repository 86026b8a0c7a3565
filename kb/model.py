"""The model of a robot: declares its elements, relates them, and changes them later.

    model = Model("rover")
    light = model.environmental_attribute("light")
    camera = model.component("camera_node", kind="lifecycle")
    camera.configuration("day", {"exposure": 0.01}, priority=1, constraints=[light >= 0.5])
    see = model.function("see")
    see.design("by camera", [camera], priority=1)
    model.action("explore", requires=[see], constraints=[light >= 0.05])

A name is unique within its kind, not across kinds. Elements refer to one another by name. A model
can be changed while knowledge bases use it: the next question to them sees the change.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from threading import RLock
from types import MappingProxyType
from typing import Any, Final, Self, TypedDict, TypeVar, Unpack, get_args
from weakref import WeakMethod

from kb import elements
from kb.checks import Finding, check_model
from kb.elements import (
    CHECKS,
    KINDS,
    REFERENCES,
    Action,
    Amended,
    Attribute,
    AttributeKind,
    ByName,
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
    Fact,
    Function,
    FunctionDesign,
    Owner,
    Rate,
    RequiredFact,
    Restorable,
    SelectedFact,
    StalePolicy,
    StatusFact,
    called,
    choice,
    finite_number,
    identifier,
    listed,
    meant_by,
    status_of,
    weights,
)
from kb.elements import table as html_table
from kb.exceptions import DuplicateName, ModelError, UnknownName
from kb.files import SUFFIXES, ModelFileError, write_text
from kb.records import check_result

ElementT = TypeVar("ElementT", bound=Element)
T = TypeVar("T")

_NAMED: Final = (Action, Function, Component, FunctionDesign, Configuration, Attribute)


_MANY: Final = ("functions", "components")
"""The fields that name several elements."""


class Measured(TypedDict, total=False):
    """The options of an attribute; `kb.elements.Attribute` explains each of them."""

    max_age: float
    when_stale: StalePolicy | str
    agreement: tuple[int, int]
    unit: str
    low: float
    high: float
    forecasting: str
    rates: Sequence[Rate]


Observer = Callable[[Amended | None], None]
"""A method that is called with each change of a model, to `put` it when no fact is recorded.

It is called again with a change that was interrupted, and with None before the first observer gets
a change and after the last one did. If it raises an exception before, the model does not change.
"""


class Model:
    """The model of one robot: its actions, functions, designs, components and attributes.

    Args:
        name: name of the model in messages and files.

    The mappings of elements (`actions`, `functions`, ...) are by name, in order of declaration, and
    read-only.

    Attributes:
        tables: all elements, constraints and estimations by class; a class stands after those that
            it refers to.
        notes: statements of a file that have no meaning in a model, and how they were read; `check`
            reports them.
        places: positions in files of the elements that were read from files, as file:line:column.
        pending: the change that is being made or was interrupted, or None; see `settle`.
    """

    def __init__(self, name: str) -> None:
        self.name = identifier("model", name)
        self._tables: dict[type, ByName[Any]] = {}
        for cls, kind in KINDS.items():
            self._tables[cls] = ByName(kind, siblings=self._tables)
        self._facts: list[Fact] = []
        self._observers: list[WeakMethod[Observer]] = []
        self._changing = RLock()
        self.pending: Amended | None = None
        self.notes: list[str] = []
        self.places: dict[Element | Constraint, str] = {}
        self.tables: Mapping[type, Mapping[Any, Any]] = MappingProxyType(
            {cls: MappingProxyType(table) for cls, table in self._tables.items()}
        )
        self.attributes: Mapping[str, Attribute] = self.tables[Attribute]
        self.components: Mapping[str, Component] = self.tables[Component]
        self.configurations: Mapping[str, Configuration] = self.tables[Configuration]
        self.functions: Mapping[str, Function] = self.tables[Function]
        self.designs: Mapping[str, FunctionDesign] = self.tables[FunctionDesign]
        self.actions: Mapping[str, Action] = self.tables[Action]

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """All constraints, in order of declaration."""
        return tuple(self._tables[Constraint])

    @property
    def estimations(self) -> tuple[Estimation, ...]:
        """All estimations, in order of declaration."""
        return tuple(self._tables[Estimation])

    @property
    def facts(self) -> tuple[Fact, ...]:
        """The facts that hold from the start, in the order in which they were added."""
        return tuple(self._facts)

    def quality_attribute(self, name: str, **options: Unpack[Measured]) -> Attribute:
        """Declare a measured property of the robot itself, e.g. its energy.

        Args:
            name: unique among attributes.
            options: the options of `Measured`, which `kb.elements.Attribute` explains.
        """
        return self.declare(Attribute, name, kind=AttributeKind.QUALITY, **options)

    def environmental_attribute(self, name: str, **options: Unpack[Measured]) -> Attribute:
        """Declare a measured property of the surroundings, e.g. the light.

        See `quality_attribute`.
        """
        return self.declare(Attribute, name, kind=AttributeKind.ENVIRONMENTAL, **options)

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
        """Declare a part of the robot.

        One that the manager shall switch is of kind "process" or "lifecycle".
        """
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
        """Declare what the robot can do as a means.

        `always_improve`: look for a better design even while solved.
        """
        return self.declare(Function, name, always_improve=always_improve)

    def action(
        self,
        name: str,
        *,
        requires: Iterable[Function | str] = (),
        restores: Iterable[Restorable | str] = (),
        constraints: Iterable[Expression] = (),
    ) -> Action:
        """Declare what a mission can do.

        Args:
            name: unique among actions.
            requires: the functions that it needs, or their names.
            restores: the attributes and components that it makes right again, or their names.
            constraints: while one of them is violated, the action is unfeasible.
        """
        return self.declare(Action, name, constraints, functions=requires, restores=restores)

    def declare(
        self,
        cls: type[ElementT],
        name: str,
        constraints: Iterable[Expression] = (),
        /,
        **stated: object,
    ) -> ElementT:
        """Declare an element with its constraints, or nothing if anything is refused.

        `stated` holds the fields of the class; other elements in it are given by themselves or by
        their names.
        """
        kind = KINDS[cls]
        identifier(kind, name)
        checked = {field: self._field(cls, name, field, value) for field, value in stated.items()}
        element = cls(name, self, **checked)
        constrained = self._constraints((element,), constraints)  # type: ignore[arg-type]  # it can be, where there are any
        if name in self._tables[cls]:
            raise DuplicateName(
                f"{kind} {name!r} is declared already; names are unique within a kind"
            )
        self._declare([element, *constrained])
        return element

    def constrain(
        self, elements: Iterable[Constrainable], *expressions: Expression
    ) -> tuple[Constraint, ...]:
        """Add constraints that apply to all of the elements, or none if one of them is refused."""
        targets = dict.fromkeys(
            self._own("constrained", element, *get_args(Constrainable))
            for element in listed("constrained elements", elements)
        )
        added = self._constraints(tuple(targets), expressions)
        if added and not targets:
            raise ModelError(f"{added[0]} constrains nothing; name at least one element")
        if added:
            self._declare(added)
        return tuple(added)

    def add_estimation(
        self,
        causer: Estimable,
        attribute: Attribute | str,
        value: float,
        kind: EstimationKind | str = "positive",
    ) -> Estimation:
        """State how the choice of the causer affects an attribute; see `Component.estimate`."""
        self._own("the causer of an estimation", causer, *get_args(Estimable))
        affected = self._own("attribute", attribute, Attribute).name
        sense = choice("estimation kind", EstimationKind, kind)
        estimation = Estimation(affected, finite_number(value), sense, causer)
        self._declare([estimation])
        return estimation

    def add_fact(self, fact: Fact) -> Fact:
        """Add a fact that holds from the start; see `kb.elements`.

        Knowledge bases that exist already do not get it.
        """
        checked = self._checked(fact)
        self._facts.append(checked)
        return checked

    def state(
        self, cls: type[T], values: Mapping[str, Any], constraints: Iterable[Expression] = ()
    ) -> T:
        """Declare an element, constraint, estimation or fact of a class by its fields."""
        others = dict(values)
        stated: Any
        try:
            if cls is Constraint:
                constrained = others.pop("constrained", ())
                (stated,) = self.constrain(constrained, Expression(**others))
            elif cls is Estimation:
                stated = self.add_estimation(**others)
            elif issubclass(cls, Element):
                stated = self.declare(cls, others.pop("name", ""), constraints, **others)
            else:
                stated = cls(**others)
                stated = self.add_fact(stated)
        except TypeError as error:
            raise ModelError(f"this {elements.ROSA[cls]} is not complete: {error}") from None
        return stated  # type: ignore[no-any-return]  # of the class

    def watch(self, observer: Observer) -> None:
        """Inform an observer of every change from now on.

        The model holds only a weak reference to it.
        """
        self._observers.append(WeakMethod(observer, self._observers.remove))

    @classmethod
    def load(cls, paths: str | Path | Iterable[str | Path]) -> Self:
        """Read a model from one or several files, each of which may add to those before it.

        Args:
            paths: files in ROSA's TypeQL (`.tql`) or in OWL (`.owl`); all in the same format.

        Raises:
            ModelError: the message gives the file, line and column, what was found there and what
                was expected.
        """
        files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
        suffixes = {_suffix(file) for file in files}
        if len(suffixes) != 1:
            what = "a model is loaded from one file, or from several of one format, in order"
            raise ModelError(f"{what}; not from {', '.join(map(str, files)) or 'none'}")
        if suffixes == {".owl"}:
            from kb.ontology import load_owl

            return load_owl(cls, files)
        from kb.typeql import load_typeql

        return load_typeql(cls, files)

    def save(self, path: str | Path) -> None:
        """Write the model to an OWL file, whole or not at all; `load` reads back the same model."""
        file = Path(path)
        if _suffix(file) != ".owl":
            why = "a model is saved as .owl; TypeQL files are only read"
            raise ModelFileError(why, str(file))
        from kb.ontology import owl_text

        write_text(file, owl_text(self))

    def plain(self) -> list[Any]:
        """Return all that the model says as values that JSON can hold.

        `from_plain` reads it back.
        """
        elements = (element for table in self.tables.values() for element in table.values())
        rows = [_row(self, described) for described in (*elements, *self.facts)]
        return [["model", {"name": self.name}], *rows]

    @classmethod
    def from_plain(cls, rows: Sequence[Any]) -> Self:
        """Return the model that `plain` described.

        Raises:
            ModelError, LookupError, TypeError, ValueError: it describes none.
        """
        (_, own), *others = rows
        model = cls(own["name"])
        for row in others:
            _declare(model, *row)
        return model

    def __reduce__(self) -> tuple[Callable[[list[Any]], "Model"], tuple[list[Any]]]:
        return type(self).from_plain, (self.plain(),)

    def check(self, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
        """Find what can never work and what is likely a mistake, with advice for each.

        Args:
            names: the names of actions in a mission's tree or PDDL domain; names that do not match
                are found too.
        """
        return check_model(self, names)

    def change(self, element: Changeable | str, **fields: object) -> None:
        """Change fields of an element, e.g.

        `model.change(design, priority=2)`, or nothing if one is refused.

        Args:
            element: an element, constraint or estimation of this model, or a name that only one
                element has.
            fields: the new values. Constraint: `value`, `hysteresis`, `dwell`; design: `priority`;
                configuration: `priority`, `parameters`; function: `always_improve`; component:
                `always_improve`, `stops_to_configure`; attribute: `max_age`, `when_stale`,
                `agreement`, `forecasting`, `rates`; estimation: `value`, `kind`.
        """
        changed: Changeable = self._own("what is changed", element, *_NAMED, Constraint, Estimation)
        kind = KINDS[type(changed)]
        name = called(changed)
        checks = {
            field: check.check for field, check in CHECKS[type(changed)].items() if check.can_change
        }
        for field in fields:
            if field not in checks:
                allowed = ", ".join(checks) or "nothing"
                raise ModelError(f"{field!r} of {kind} {name!r} cannot change; what can: {allowed}")
        values = {field: checks[field](field, name, value) for field, value in fields.items()}

        def put() -> None:
            for field, value in values.items():
                object.__setattr__(changed, field, value)

        self._amend(
            "changed", [changed], put, lambda: [_reference(self, changed), _plain(self, values)]
        )

    def amend(self, how: str, written: Any) -> None:  # noqa: ANN401  # what JSON holds
        """Change the model as an equal one was changed before; see `Amended`."""
        if how == "changed":
            reference, values = written
            self.change(_referred(self, reference), **values)
        elif written[0][0] == "constraint":
            targets = [_referred(self, each) for each in written[0][1]["constrained"]]
            self.constrain(targets, *map(_expression, written))
        else:
            (words, values), *constraints = written
            _declare(self, words, values, map(_expression, constraints))

    def settle(self) -> None:
        """Complete a change that was interrupted, unless another thread is just making it."""
        mine: list[bool] = []
        try:
            mine.extend(
                map(self._changing.acquire, (False,))
            )  # taken and noted in one step despite interrupts
            change = self.pending
            if mine[0] and change is not None:
                observers = self._watching()
                for observer in observers:
                    observer(change)
                if not observers:
                    change.put()
                self.pending = None
        finally:
            if mine and mine[0]:
                self._changing.release()

    def __eq__(self, other: object) -> bool:
        """Tell whether two models have the same name and content in the same order."""
        return isinstance(other, Model) and (self is other or self.plain() == other.plain())

    def __hash__(self) -> int:
        return hash(self.name)

    def __repr__(self) -> str:
        return f"<Model {self.name!r}>"

    def _repr_html_(self) -> str:
        rows = []
        for words, values in self.plain()[1:]:
            if "name" in values:
                name = values.pop("name")
                stated = [f"{field.replace('_', ' ')}: {value}" for field, value in values.items()]
                rows.append((words, name, "; ".join(stated)))
        return html_table(f"model {self.name}", ("kind", "name", "what it is"), rows)

    def _field(self, cls: type, name: str, field: str, value: object) -> Any:  # noqa: ANN401  # of any field
        """Return what is given for a field as it is kept: elements that it names by their names."""
        if field in CHECKS[cls]:
            return CHECKS[cls][field].check(field, name, value)
        if field == "restores":
            what = f"what {name!r} restores"
            each = [self._own(what, item, Attribute, Component) for item in listed(what, value)]
            return tuple(dict.fromkeys(each))
        if field not in REFERENCES:
            raise UnknownName(f"field of {elements.ROSA[cls]}", field, CHECKS[cls])
        target = REFERENCES[field]
        if field not in _MANY:
            return self._own(KINDS[target], value, target).name
        items = listed(f"the {field} of {name!r}", value)
        return tuple(dict.fromkeys(self._own(KINDS[target], item, target).name for item in items))

    def _checked(self, fact: object) -> Fact:
        """Return a fact, after checking that its elements and values are allowed."""
        if not isinstance(fact, Fact):
            raise ModelError(f"a fact is one of those in kb.elements, not {fact!r}")
        kind = elements.ROSA[type(fact)]
        values: dict[str, Any] = {}
        for field in fields(fact):
            name = field.name
            value = getattr(fact, name)
            if name == "element":
                value = self._own(f"what this {kind} is about", value, *_ABOUT[type(fact)])
            elif name == "status":
                value = status_of(KINDS[type(values["element"])], value)
            elif name == "value":
                value = self.attributes[values["attribute"]].checked(value)
            elif name == "preference":
                value = weights(value, self.attributes)
            elif name != "result":
                value = self._field(type(fact), kind, name, value)
            elif value is not None:
                check_result(value)
            values[name] = value
        return replace(fact, **values)

    def _own(self, what: str, element: object, *classes: type) -> Any:  # noqa: ANN401  # of the classes
        """Return an element of this model, given by itself or by a name that only one has."""
        if not isinstance(element, (Element, Constraint, Estimation)):
            tables = {KINDS[cls]: self._tables[cls] for cls in classes if issubclass(cls, Element)}
            return meant_by(element, tables, what, "give the one meant, e.g. model.")
        if not isinstance(element, classes):
            names = ", ".join(cls.__name__ for cls in classes)
            raise ModelError(f"{what} can be one of {names}; not {element!r}")
        if self._tables[type(element)].get(_key(element)) is not element:
            which = f"{KINDS[type(element)]} {called(element)!r}"
            raise ModelError(f"{which} is of another model, not of {self.name!r}")
        return element

    def _constraints(
        self, targets: tuple[Constrainable, ...], expressions: object
    ) -> list[Constraint]:
        """Return the constraints of elements that comparisons become."""
        constraints = []
        for expression in listed("constraints", expressions):
            if not isinstance(expression, Expression):
                what = "a constraint is a comparison such as `light >= 0.5`"
                raise ModelError(f"{what}, not {expression!r}")
            if expression.model not in (None, self):
                other = expression.model.name
                raise ModelError(
                    f"{expression} compares an attribute of {other!r}, not of {self.name!r}"
                )
            name = self._own("attribute", expression.attribute, Attribute).name
            constraint = Constraint(
                name,
                expression.operator,
                expression.value,
                targets,
                expression.hysteresis,
                expression.dwell,
            )
            constraints.append(constraint)
        return constraints

    def _declare(self, added: Sequence[Changeable]) -> None:
        def put() -> None:
            for element in added:
                self._tables[type(element)][_key(element)] = element

        self._amend("declared", added, put, lambda: [_row(self, element) for element in added])

    def _amend(
        self,
        how: str,
        elements: Sequence[Changeable],
        put: Callable[[], None],
        write: Callable[[], Any],
    ) -> None:
        """Make a change; once it is `pending`, it will be completed, for all observers too."""
        self.settle()
        observers = self._watching()
        for observer in observers:
            observer(None)
        with self._changing:
            written = write() if observers else None
            self.pending = Amended(how, tuple(elements), put, written)
            self.settle()
        for observer in observers:
            observer(None)

    def _watching(self) -> list[Observer]:
        return [observer for each in tuple(self._observers) if (observer := each()) is not None]


def _key(element: Changeable) -> object:
    return element.name if isinstance(element, Element) else element


def _suffix(file: Path) -> str:
    suffix = file.suffix.lower()
    if suffix not in SUFFIXES:
        what = f"the name of a model's file ends in {' or '.join(SUFFIXES)}"
        raise ModelFileError(f"{what}, not in {file.suffix!r}", str(file))
    return suffix


_ABOUT: Final[Mapping[type, tuple[type, ...]]] = {
    StatusFact: (*_NAMED, Constraint),
    RequiredFact: (Action, Function, Component),
    SelectedFact: (FunctionDesign, Configuration),
}
"""What each fact about an element can be about."""


# ---------------------------------------------------------------- plain values

_CLASSES: Final = {words: cls for cls, words in elements.ROSA.items()}


def _reference(model: Owner, element: Changeable) -> list[Any]:
    """Return the class of an element, and its name or its position among those without."""
    if isinstance(element, Element):
        return [elements.ROSA[type(element)], element.name]
    return [elements.ROSA[type(element)], list(model.tables[type(element)]).index(element)]


def _plain(model: Owner, value: Any) -> Any:  # noqa: ANN401  # of any field
    """Return the value of a field as JSON can hold it."""
    if isinstance(value, Changeable):
        return _reference(model, value)
    if isinstance(value, tuple | list):
        return [_plain(model, item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(model, item) for key, item in value.items()}
    return value


def _row(model: Owner, described: Any) -> list[Any]:  # noqa: ANN401  # an element or a fact
    """Return what something is and its fields that have not their defaults, as plain values."""
    values = {}
    for field in fields(described):
        value = getattr(described, field.name)
        if field.name != "model" and value != field.default:
            values[field.name] = _plain(model, value)
    return [elements.ROSA[type(described)], values]


def _referred(model: Model, reference: Sequence[Any]) -> Any:  # noqa: ANN401  # an element
    """Return the element of a reference."""
    words, name = reference
    table = model.tables[_CLASSES[words]]
    return list(table.values())[name] if isinstance(name, int) else table[name]


def _declare(
    model: Model, words: str, plain: Mapping[str, Any], constraints: Iterable[Expression] = ()
) -> None:
    """Declare what a row describes."""
    values = dict(plain)
    for name in {"constrained", "restores"} & values.keys():
        values[name] = [_referred(model, each) for each in values[name]]
    for name in {"causer", "element"} & values.keys():
        values[name] = _referred(model, values[name])
    model.state(_CLASSES[words], values, constraints)


def _expression(row: Sequence[Any]) -> Expression:
    """Return the comparison in the row of a constraint."""
    _, values = row
    return Expression(**{name: values[name] for name in values if name != "constrained"})


def differences(then: Model, now: Model) -> list[str]:
    """Return the statements that are in only one of two models."""
    before = [f"{words} {values}" for words, values in then.plain()]
    after = [f"{words} {values}" for words, values in now.plain()]
    rows = [row for row in [*before, *after] if row not in before or row not in after]
    return rows or ["another order"]
