"""What a robot is made of and can do, in ROSA's words; only a `Model` makes and changes elements.

An element belongs to one model and equals nothing but itself. The annotation of a field says how
the field is checked, and whether it may change after the declaration. The last part has the facts
that a model can state: a knowledge base made of it begins with them.
"""

import math
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from html import escape
from types import MappingProxyType
from typing import Annotated, Any, Final, NamedTuple, Protocol, TypeGuard, TypeVar, get_type_hints

from kb.exceptions import AmbiguousName, InvalidValue, ModelError, UnknownName
from kb.status import OPERATORS, STATUSES, Status

ChoiceT = TypeVar("ChoiceT", bound=StrEnum)
T = TypeVar("T")
Parameter = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]
Parameters = Mapping[str, Parameter]
_MOST: Final = sys.float_info.max
_LEAST: Final = 5e-324  # the least number above 0


def finite_number(value: Any) -> float:  # noqa: ANN401  # whatever is given
    """Return the value as a float; text, booleans, NaN and infinities are refused."""
    number = math.nan
    if hasattr(type(value), "__float__") and not isinstance(value, bool):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)
    if not math.isfinite(number):
        raise InvalidValue(f"a finite number is needed, not {value!r:.200}")
    return number


def table(caption: str, head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as notebooks show it, in HTML with every text escaped."""
    lines = ["".join(f"<th>{escape(title)}</th>" for title in head)]
    for row in rows:
        texts = ("" if cell is None else escape(str(cell)) for cell in row)
        lines.append("".join(f"<td>{text}</td>" for text in texts))
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><caption>{escape(caption)}</caption>{body}</table>"


class Rate(NamedTuple):
    """How fast an attribute changes [its unit / s], always or while an action is done."""

    per_s: float
    while_: str = ""
    learns: bool = False


class Field(NamedTuple):
    """How a field of an element is checked; it stands in the annotation of the field.

    Attributes:
        check: takes the field's name, the element's name and what is given; returns it as it is
            kept.
        can_change: `Model.change` may change it.
    """

    check: Callable[[str, str, Any], object]
    can_change: bool = True


def identifier(kind: str, name: object) -> str:
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        what = f"the {kind}'s name is a non-empty text of printable characters"
        raise ModelError(f"{what}, not {name!r}")
    return name


def text(what: str, value: object) -> str:
    if not isinstance(value, str):
        raise ModelError(f"{what} is a text, not {value!r:.200}")
    return value


def flag(what: str, value: object, error: type[ValueError] = ModelError) -> bool:
    if not isinstance(value, bool):
        raise error(f"{what} is True or False, not {value!r:.200}")
    return value


def is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _number(words: str, low: float, high: float, *, can_change: bool = True) -> Field:
    """Return a field for a number from a lowest to a highest; `words` are for other values."""

    def check(field: str, name: str, value: object) -> float:
        if is_number(value) and low <= value <= high:
            return float(value)
        raise ModelError(f"{words.format(field=field, name=name)}, not {value!r:.200}")

    return Field(check, can_change)


def _priority(field: str, name: str, value: object) -> float | None:
    if value is None or (is_number(value) and abs(value) <= _MOST):
        return value
    raise ModelError(f"the {field} of {name!r} is a finite number or None, not {value!r:.200}")


def agreement(field: str, name: str, value: object) -> tuple[int, int]:
    """Return n and k, given as a pair."""
    match value:
        case [int(enough), int(last)] if 0 < enough <= last < 2 * enough:
            return enough, last
    what = f"{field} of {name!r} is two whole numbers (n, k), n of the last k measurements"
    raise ModelError(f"{what} and more than half of them, e.g. (2, 3); not {value!r:.200}")


def rates(field: str, name: str, value: Any) -> tuple[Rate, ...]:  # noqa: ANN401  # whatever is given
    """Return rates of change; the last one for an action holds."""
    by_action: dict[str, Rate] = {}
    try:
        for rate, action, learns in value:
            text("what it holds while", action)
            by_action[action] = Rate(finite_number(rate), action, flag("learns", learns))
    except (TypeError, ValueError) as error:
        what = f"{field} of {name!r} are (per s, while, learns)"
        raise ModelError(f"{what}, not {value!r:.200}: {error}") from None
    return tuple(by_action.values())


def whole(what: str, value: object) -> int:
    """Return a whole number from 1; any other value is refused."""
    if type(value) is int and value > 0:
        return value
    raise InvalidValue(f"{what} is a whole number from 1, not {value!r:.200}")


def choice(what: str, options: type[ChoiceT], value: object) -> ChoiceT:
    if isinstance(value, options):
        return value
    try:
        return options(str(value))
    except ValueError:
        raise UnknownName(what, value, [str(option) for option in options]) from None


def status_of(kind: str, value: object) -> Status:
    """Return a status that elements of a kind can have."""
    possible = STATUSES.get(kind, ())
    if value not in possible:
        raise InvalidValue(f"a {kind} is never {value!s:.60}; it can be {', '.join(possible)}")
    return Status(str(value))


def listed(what: str, values: object) -> tuple[Any, ...]:
    """Return the items of a list; a single text is refused, as it would be read as its letters."""
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise ModelError(f"{what} are given as a list, not as {values!r}")
    return tuple(values)


def parameters(configuration: str, values: object) -> Mapping[str, Any]:
    """Return the parameters of a configuration, a copy that cannot be changed."""
    if not isinstance(values, Mapping):
        what = f"the parameters of {configuration!r} are given as values by name"
        raise ModelError(f"{what}, not as {values!r}")
    return MappingProxyType({key: _parameter(configuration, key, values[key]) for key in values})


def _parameter(configuration: str, key: object, value: object) -> object:
    if not isinstance(key, str):
        raise ModelError(f"the name of a parameter of {configuration!r} is a text, not {key!r}")
    if _is_scalar(value):
        return value
    if isinstance(value, list | tuple) and all(_is_scalar(item) for item in value):
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if len(kinds) <= 1:
            return list(value)
    raise ModelError(
        f"parameter {key!r} of configuration {configuration!r} is {value!r:.200}; "
        "allowed are a boolean, a finite number, a text, or a list of one of these"
    )


def _is_scalar(value: object) -> bool:
    if isinstance(value, int | float):
        return abs(value) <= _MOST
    return isinstance(value, str)


class AttributeKind(StrEnum):
    """What an attribute describes: the system itself, or its surroundings."""

    QUALITY = "quality"
    ENVIRONMENTAL = "environmental"


class ComponentKind(StrEnum):
    """How a component is switched.

    `plain`: hardware, or software without a driver; never commanded, its activity is bookkeeping.
    `process`: started and stopped. `ros_node`: a process that is started by `ros2 run package
    executable`. `lifecycle`: runs all the time and is made active or inactive.
    """

    PLAIN = "plain"
    PROCESS = "process"
    ROS_NODE = "ros_node"
    LIFECYCLE = "lifecycle"


class StalePolicy(StrEnum):
    """What a measurement counts as once it is older than its attribute's maximum age."""

    NOT_EVALUATED = "not evaluated"
    VIOLATED = "violated"


class Forecasting(StrEnum):
    """How an attribute is forecast beside its rates: not at all, as it is, or by its trend."""

    NONE = ""
    CONSTANT = "constant"
    TREND = "trend"


class EstimationKind(StrEnum):
    """How a choice affects an attribute: adds to it, takes from it, or sets it."""

    POSITIVE = "positive"
    NEGATIVE = "negative"
    ABSOLUTE = "absolute"


_FLAG: Final = Field(lambda field, name, value: flag(f"{field} of {name!r}", value))
_TEXT: Final = Field(lambda field, name, value: text(f"the {field} of {name!r}", value), False)
_NUMBER: Final = Field(lambda _, __, value: finite_number(value))
_TIME: Final = Field(lambda _, __, value: None if value is None else finite_number(value))
_PRIORITY: Final = Field(_priority)
_SPAN: Final = _number("the {field} of {name!r} is a number from 0", 0, _MOST)
_AGE: Final = _number("{field} of {name!r} is a time in seconds above 0", _LEAST, math.inf)
_RANGE: Final = "the {field} end of the range of {name!r} is a number"
_BOUND: Final = _number(_RANGE, -math.inf, math.inf, can_change=False)
_AGREEMENT: Final = Field(agreement)
_RATES: Final = Field(rates)
_PARAMETERS: Final = Field(lambda _, name, value: parameters(name, value))


def _one_of(what: str, options: type[StrEnum], *, can_change: bool = True) -> Field:
    return Field(lambda _, __, value: choice(what, options, value), can_change)


class Owner(Protocol):
    """A model, for its elements and for those who read it; see `Model`."""

    name: str
    actions: Mapping[str, "Action"]
    attributes: Mapping[str, "Attribute"]
    tables: Mapping[type, Mapping[Any, Any]]
    notes: list[str]
    places: dict["Element | Constraint", str]

    @property
    def constraints(self) -> tuple["Constraint", ...]: ...
    @property
    def estimations(self) -> tuple["Estimation", ...]: ...
    @property
    def facts(self) -> tuple["Fact", ...]: ...
    def change(self, element: "Changeable | str", **fields: object) -> None: ...
    def constrain(
        self, elements: Iterable["Constrainable"], *expressions: "Expression"
    ) -> tuple["Constraint", ...]: ...
    def state(
        self, cls: type[T], values: Mapping[str, Any], constraints: Iterable["Expression"] = ()
    ) -> T: ...


@dataclass(frozen=True)
class Expression:
    """A comparison of an attribute with a number, e.g. `light >= 0.5`.

    Becomes a constraint of what is given it.
    """

    attribute: str
    operator: str
    value: float
    model: Owner | None = field(default=None, repr=False, compare=False)
    hysteresis: float = 0.0
    dwell: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.operator, str) or self.operator not in OPERATORS:
            raise ModelError(
                f"{self.operator!r} is no comparison; there are {', '.join(OPERATORS)}"
            )
        finite_number(self.value)
        for what in ("hysteresis", "dwell"):
            _SPAN.check(what, str(self), getattr(self, what))

    def steady(self, *, hysteresis: float = 0.0, dwell: float = 0.0) -> "Expression":
        """Return the same comparison for a constraint that does not flap about its threshold.

        Args:
            hysteresis: once violated, it is satisfied again only this far beyond its threshold [the
                attribute's unit].
            dwell: once satisfied or violated, it stays so for at least this long [s].
        """
        return replace(self, hysteresis=hysteresis, dwell=dwell)

    def __bool__(self) -> bool:
        raise ModelError(
            f"{self} has no truth value before something is measured; a chained comparison such as "
            "`0.2 <= light <= 0.8` is written as two constraints"
        )

    def __str__(self) -> str:
        return f"{self.attribute} {self.operator} {exact(self.value)}"


@dataclass(frozen=True, eq=False)
class Constraint:
    """An expression; while it is violated, the constrained elements are unfeasible.

    See `Expression.steady`.
    """

    attribute: str
    operator: str
    value: Annotated[float, _NUMBER]
    constrained: tuple["Constrainable", ...]
    hysteresis: Annotated[float, _SPAN] = 0.0
    dwell: Annotated[float, _SPAN] = 0.0

    def __str__(self) -> str:
        return f"{self.attribute} {self.operator} {exact(self.value)}"


@dataclass(frozen=True, eq=False)
class Estimation:
    """What choosing a design, component or configuration is expected to do to an attribute."""

    attribute: str
    value: Annotated[float, _NUMBER]
    kind: Annotated[EstimationKind, _one_of("estimation kind", EstimationKind)]
    causer: "Estimable"

    def __str__(self) -> str:
        return self.attribute

    @property
    def adds(self) -> float:
        """What it adds to the attribute; below 0 if it takes from it."""
        return -self.value if self.kind is EstimationKind.NEGATIVE else self.value


@dataclass(frozen=True, eq=False)
class Element:
    """Something with a name in a model."""

    name: str
    model: Owner = field(repr=False, compare=False)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[object, ...]]:
        return _element_of, (self.model, type(self), self.name)


def _element_of(model: Any, cls: type, name: str) -> Any:  # noqa: ANN401  # a model, read anew
    """Return the element of a model that was pickled or copied."""
    return model.tables[cls][name]


@dataclass(frozen=True, eq=False)
class _Constrainable(Element):
    def constrain(self, *expressions: Expression) -> tuple[Constraint, ...]:
        """Add one constraint per expression to this element, or none if one of them is refused."""
        return self.model.constrain([self], *expressions)  # type: ignore[list-item]  # a subclass is one of the four


@dataclass(frozen=True, eq=False)
class _Estimable(_Constrainable):
    def estimate(
        self, attribute: "Attribute | str", value: float, kind: EstimationKind | str = "positive"
    ) -> None:
        """State what choosing this element does to an attribute.

        Args:
            attribute: the affected attribute, or its name.
            value: how much, in the attribute's unit.
            kind: "positive" adds, "negative" takes away, "absolute" sets.
        """
        stated = {"causer": self, "attribute": attribute, "value": value, "kind": kind}
        self.model.state(Estimation, stated)


@dataclass(frozen=True, eq=False)
class Attribute(Element):
    """Something that is measured; comparing it with a number gives an expression.

    Attributes:
        kind: what it describes.
        max_age: how long a measurement holds [s]; for ever by default.
        when_stale: what its constraints are once the latest measurement is older: "not evaluated"
            or "violated".
        agreement: n of the last k measurements have to say so before a constraint on it changes, as
            (n, k).
        unit: of its values, as it is shown, e.g. "V"; may be empty.
        low, high: no value lies outside; a measurement that does is refused. Infinite by default.
        forecasting: how it is forecast; see `forecast`. Empty if only by its rates, or not at all.
        rates: how fast it changes, as far as that is stated; see `changes`.
    """

    kind: Annotated[AttributeKind, _one_of("attribute kind", AttributeKind, can_change=False)] = (
        AttributeKind.QUALITY
    )
    max_age: Annotated[float, _AGE] = math.inf
    when_stale: Annotated[StalePolicy, _one_of("policy for stale measurements", StalePolicy)] = (
        StalePolicy.NOT_EVALUATED
    )
    agreement: Annotated[tuple[int, int], _AGREEMENT] = (1, 1)
    unit: Annotated[str, _TEXT] = ""
    low: Annotated[float, _BOUND] = -math.inf
    high: Annotated[float, _BOUND] = math.inf
    forecasting: Annotated[Forecasting, _one_of("forecast", Forecasting)] = Forecasting.NONE
    rates: Annotated[tuple[Rate, ...], _RATES] = ()

    def __post_init__(self) -> None:
        if not self.low <= self.high or self.low == math.inf or self.high == -math.inf:
            raise ModelError(
                f"the range of {self.name!r} holds no number: from {self.low!r} to {self.high!r}"
            )

    def forecast(self, by: str) -> None:
        """State how this attribute is forecast where no rate applies: "constant" or "trend"."""
        self.model.change(self, forecasting=by)

    def changes(self, rate: float, *, while_: "Action | str" = "", learns: bool = False) -> None:
        """State how fast this attribute changes [its unit / s].

        It holds always, or while an action is done. There is one rate for each action; rates that
        apply at the same time add up. A rate that learns is replaced by the rate that is measured
        while its action alone is done.
        """
        name = while_.name if isinstance(while_, Action) else while_
        if name and name not in self.model.actions:
            raise UnknownName("action", name, self.model.actions)
        self.model.change(self, rates=(*self.rates, Rate(finite_number(rate), name, learns)))

    def checked(self, value: object, use: str = "be") -> float:
        """Return a value of this attribute as a float.

        What is no finite number, or out of range, is refused; `use` says for what it is given.
        """
        try:
            number = finite_number(value)
            if self.low <= number <= self.high:
                return number
            why = f"{self.name} is {self.range}"
        except InvalidValue as error:
            why = str(error)
        raise InvalidValue(f"{self.name} cannot {use} {value!r:.200}: {why}")

    @property
    def range(self) -> str:
        """Where its values lie, in words, e.g. "from 0 to 17 V"."""
        words = [f"from {exact(self.low)}"] if self.low > -math.inf else []
        words += [f"to {exact(self.high)}"] if self.high < math.inf else []
        return self.amount(" ".join(words) or "any number")

    def amount(self, number: str) -> str:
        """Write a number with the unit."""
        return f"{number} {self.unit}" if self.unit else number

    def __ge__(self, value: float) -> Expression:
        return Expression(self.name, ">=", finite_number(value), self.model)

    def __gt__(self, value: float) -> Expression:
        return Expression(self.name, ">", finite_number(value), self.model)

    def __le__(self, value: float) -> Expression:
        return Expression(self.name, "<=", finite_number(value), self.model)

    def __lt__(self, value: float) -> Expression:
        return Expression(self.name, "<", finite_number(value), self.model)


@dataclass(frozen=True, eq=False)
class Configuration(_Estimable):
    """One set of values for the parameters of a component."""

    component: str
    parameters: Annotated[Parameters, _PARAMETERS]
    priority: Annotated[float | None, _PRIORITY] = None


@dataclass(frozen=True, eq=False)
class Component(_Estimable):
    """A hardware or software part of the robot.

    Attributes:
        kind: how it is switched.
        always_improve: choose again for it even while it is solved.
        stops_to_configure: new parameters are given while it is stopped, not while it runs.
        package: where its program is found, for a process or lifecycle component.
        executable: the program's name there.
    """

    kind: Annotated[ComponentKind, _one_of("component kind", ComponentKind, can_change=False)] = (
        ComponentKind.PLAIN
    )
    always_improve: Annotated[bool, _FLAG] = False
    stops_to_configure: Annotated[bool, _FLAG] = False
    package: Annotated[str, _TEXT] = ""
    executable: Annotated[str, _TEXT] = ""

    def configuration(
        self,
        name: str,
        parameters: Parameters | None = None,
        *,
        priority: float | None = None,
        constraints: Iterable[Expression] = (),
    ) -> Configuration:
        """Declare one way to set this component's parameters.

        The lowest priority number is tried first.
        """
        stated = {"name": name, "component": self, "parameters": parameters or {}}
        return self.model.state(Configuration, {**stated, "priority": priority}, constraints)


@dataclass(frozen=True, eq=False)
class FunctionDesign(_Estimable):
    """One way to realise a function: the components that together do it."""

    function: str
    components: tuple[str, ...] = ()
    priority: Annotated[float | None, _PRIORITY] = None


@dataclass(frozen=True, eq=False)
class Function(Element):
    """Something the robot can do as a means, e.g. localise; realised by one of its designs."""

    always_improve: Annotated[bool, _FLAG] = False

    def design(
        self,
        name: str,
        components: Iterable[Component | str],
        *,
        priority: float | None = None,
        constraints: Iterable[Expression] = (),
    ) -> FunctionDesign:
        """Declare one set of components that realises this function.

        The lowest priority number is tried first.
        """
        stated = {"name": name, "function": self, "components": components, "priority": priority}
        return self.model.state(FunctionDesign, stated, constraints)


@dataclass(frozen=True, eq=False)
class Action(_Constrainable):
    """Something a mission does, and the functions it needs for that.

    Attributes:
        functions: the names of the functions that it requires.
        restores: the attributes and components that it can make right again.
    """

    functions: tuple[str, ...] = ()
    restores: tuple["Restorable", ...] = ()


Constrainable = Action | FunctionDesign | Component | Configuration
Restorable = Attribute | Component
Estimable = FunctionDesign | Component | Configuration
Changeable = Element | Constraint | Estimation

KINDS: Final[Mapping[type, str]] = {
    Attribute: "attribute",
    Component: "component",
    Configuration: "configuration",
    Function: "function",
    FunctionDesign: "function design",
    Action: "action",
    Constraint: "constraint",
    Estimation: "estimation",
}
"""What each class of element is called; each class comes after those that it refers to."""

REFERENCES: Final[Mapping[str, type[Element]]] = {
    "functions": Function,
    "function": Function,
    "components": Component,
    "component": Component,
    "configuration": Configuration,
    "attribute": Attribute,
    "action": Action,
    "activate": Component,
    "deactivate": Component,
    "parameters": Configuration,
}
"""The fields of elements, facts and records that name others, and of which class; parameters are
those of a plan."""


class ByName(dict[Any, T]):
    """The elements of one kind by name, in order of declaration.

    The error for an unknown name lists similar ones, or says that it is a sibling's.
    """

    def __init__(
        self,
        kind: str,
        table: Mapping[str, T] | None = None,
        siblings: Mapping[Any, "ByName[T]"] = MappingProxyType({}),
    ) -> None:
        super().__init__(table or {})
        self.kind = kind
        self._siblings = siblings

    def __missing__(self, name: object) -> T:
        others = [table.kind for table in self._siblings.values() if name in table]
        known = map(str, tuple(self))  # as of now: another thread may add to it
        raise UnknownName(self.kind, name, known, *others[:1])


def called(element: Changeable) -> str:
    """Return what an element, constraint or estimation is called in messages."""
    return element.name if isinstance(element, Element) else str(element)


def meant_by(name: object, tables: Mapping[str, Mapping[str, T]], what: str, advice: str = "") -> T:
    """Return what a name stands for in the tables of some kinds: the only one, or the first.

    Raises:
        AmbiguousName: several kinds have such a name, and an advice what to do then is given.
    """
    is_text = isinstance(name, str)
    named = {kind: table[str(name)] for kind, table in tables.items() if is_text and name in table}
    if not named:
        raise UnknownName(what, name, [each for table in tables.values() for each in table])
    if advice and len(named) > 1:
        kinds = ", ".join(f"{'an' if kind[0] == 'a' else 'a'} {kind}" for kind in named)
        first = f"{next(iter(named)).removeprefix('function ')}s[{name!r}]"
        raise AmbiguousName(f"{name!r} names several things: {kinds}; {advice}{first}")
    return next(iter(named.values()))


def weights(
    preference: Mapping[str, float] | None, attributes: Mapping[str, Any]
) -> Mapping[str, float] | None:
    """Return the weights of attributes by name, a copy that cannot be changed; None for none."""
    if not isinstance(preference or {}, Mapping):
        what = "a preference is given as weights by name of attribute"
        raise ModelError(f"{what}, not as {preference!r}")
    checked = {
        attributes[name].name: finite_number(weight) for name, weight in (preference or {}).items()
    }
    return MappingProxyType(checked) if checked else None


def exact(value: float) -> str:
    """Write a number with as few digits as say exactly which it is."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


# ---------------------------------------------------------------- facts from the start


@dataclass(frozen=True)
class MeasurementFact:
    """An attribute had a value, in its unit; one that is not the latest goes to the history only.

    The time is in s since 1970-01-01 UTC; None stands for when the knowledge base is made.
    """

    attribute: str
    value: float
    time: Annotated[float | None, _TIME] = None
    latest: Annotated[bool, _FLAG] = True


@dataclass(frozen=True)
class StatusFact:
    """A status is asserted, in place of the inferred one."""

    element: Element | Constraint
    status: Status


@dataclass(frozen=True)
class RequiredFact:
    """An element is asserted to be required."""

    element: Action | Function | Component


@dataclass(frozen=True)
class SelectedFact:
    """A design or configuration is the one chosen."""

    element: FunctionDesign | Configuration


@dataclass(frozen=True)
class ActiveFact:
    """A component is running."""

    component: str


@dataclass(frozen=True)
class RequiredActionFact:
    """An action was requested, with the weight of each attribute to favour.

    Without an end it is still required. Start and end are times [s since 1970-01-01 UTC]; a start
    of None is the time when the knowledge base is made.
    """

    action: str
    preference: Mapping[str, float] | None = None
    start: Annotated[float | None, _TIME] = None
    end: Annotated[float | None, _TIME] = None
    result: str | None = None


ROSA: Final[Mapping[type, str]] = {
    **KINDS,
    Configuration: "component configuration",
    MeasurementFact: "measurement",
    StatusFact: "asserted status",
    RequiredFact: "asserted requirement",
    SelectedFact: "selection",
    ActiveFact: "activity",
    RequiredActionFact: "required action",
}
"""What each class of element and fact is called, each after those that it refers to."""

CHECKS: Final[Mapping[type, Mapping[str, Field]]] = {
    cls: {
        name: hint.__metadata__[0]
        for name, hint in get_type_hints(cls, include_extras=True).items()
        if hasattr(hint, "__metadata__")
    }
    for cls in ROSA
}
"""How the fields of each class are checked, except fields that name elements."""

Fact = MeasurementFact | StatusFact | RequiredFact | SelectedFact | ActiveFact | RequiredActionFact


class Amended(NamedTuple):
    """One change of a model.

    Attributes:
        how: "declared" or "changed".
        elements: what was.
        put: makes the change, once or again.
        written: what `Model.amend` takes to make it in an equal model, as values for JSON.
    """

    how: str
    elements: tuple[Changeable, ...]
    put: Callable[[], None]
    written: Any
