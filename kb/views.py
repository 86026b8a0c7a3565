"""Read-only views of the elements of a knowledge base: what they are, and what is known of them at this moment.

A view answers from the base it was taken from each time it is asked; nothing can be changed through it.
"""

import math
from collections.abc import Callable, ItemsView, Iterator, Mapping, ValuesView
from contextlib import AbstractContextManager
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from kb.elements import AttributeKind, ComponentKind, Constraint, Element, Parameters, finite_number
from kb.network import Node
from kb.state import History, State
from kb.status import Status

T = TypeVar("T")


class Readable(Protocol):
    """Whatever can be asked: a knowledge base, or one as it would be if."""

    @property
    def now(self) -> float:
        """The time by the clock [s]."""

    @property
    def forecast(self) -> Any:  # noqa: ANN401  # a `Forecaster`, which is made of views
        """What looks ahead."""

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""


@dataclass(frozen=True, repr=False)
class ElementView:
    """What every element has: a name, and its kind in words.

    Attributes:
        base: what it was taken from.
        node: its place there.
    """

    __slots__ = ("base", "node")

    base: Readable
    node: Node

    @property
    def name(self) -> str:
        """The element's name, unique within its kind; a constraint is called by its text."""
        return self.node.name

    @property
    def element(self) -> Element | Constraint:
        """The element of the model that this is a view of, e.g. to amend it there."""
        found: Element | Constraint = self.node.element
        return found

    def __repr__(self) -> str:
        return f"<{self.node.kind} {self.name!r}>"


class Known(Generic[T]):
    """What is known of an element at this moment, by the name of the array of the state that holds it."""

    def __init__(self, column: str) -> None:
        self._column = column

    def __get__(self, view: ElementView, _: type) -> T:
        with view.base.reading() as state:
            value: T = getattr(state, self._column)[view.node.index]
            return value


class Declared(Generic[T]):
    """What the model says of an element, by the name of the field; see the class of that kind in `kb.elements`."""

    def __set_name__(self, _: type, name: str) -> None:
        self._field = name

    def __get__(self, view: ElementView, _: type) -> T:
        value: T = getattr(view.element, self._field)
        return value


class Parts:
    """Names of what an element is made of, in order of declaration."""

    def __get__(self, view: ElementView, _: type) -> tuple[str, ...]:
        with view.base.reading():
            return tuple(part.name for part in view.node.parts)


class ConstraintView(ElementView):
    """A constraint: `attribute operator value`; the value is the threshold, in the attribute's unit."""

    __slots__ = ()

    status = Known[Status]("status")
    attribute = Declared[str]()
    operator = Declared[str]()
    value = Declared[float]()


class _StatusView(ElementView):
    __slots__ = ()

    status = Known[Status]("status")

    @property
    def constraints(self) -> tuple[ConstraintView, ...]:
        """The constraints on this element itself."""
        with self.base.reading():
            return tuple(ConstraintView(self.base, node) for node in self.node.constraints)


class ActionView(_StatusView):
    """An action, and whether it can be done now; it is required while the mission is doing it."""

    __slots__ = ()

    is_required = Known[bool]("required")
    functions = Parts()


class FunctionView(_StatusView):
    """A function, and whether it is realised now; it is required while what the mission is doing needs it."""

    __slots__ = ()

    is_required = Known[bool]("required")
    always_improve = Declared[bool]()
    designs = Parts()


class ComponentView(_StatusView):
    """A component: whether it is required, as a function is, whether it is running, and with which parameters."""

    __slots__ = ()

    is_required = Known[bool]("required")
    is_active = Known[bool]("active")
    always_improve = Declared[bool]()
    kind = Declared[ComponentKind]()
    stops_to_configure = Declared[bool]()
    package = Declared[str]()
    executable = Declared[str]()
    configurations = Parts()

    @property
    def selected_configuration(self) -> str | None:
        """Name of the configuration that is selected, if one is."""
        with self.base.reading() as state:
            return next((part.name for part in self.node.parts if state.selected[part.index]), None)

    @property
    def parameters_in_force(self) -> Parameters:
        """The parameters that it was last given; empty before that."""
        with self.base.reading() as state:
            return MappingProxyType(dict(state.parameters.get(self.name, {})))


class _SelectableView(_StatusView):
    __slots__ = ()

    is_selected = Known[bool]("selected")
    priority = Declared[float | None]()

    @property
    def reason(self) -> str:
        """Why it was selected, in the words of whoever selected it; empty if that was not said, or it is not."""
        with self.base.reading() as state:
            return state.reason("selected", self.node).text if state.selected[self.node.index] else ""


class DesignView(_SelectableView):
    """A function design, one set of components that realises a function, and whether it is the one chosen."""

    __slots__ = ()

    function = Declared[str]()
    components = Declared[tuple[str, ...]]()


class ConfigurationView(_SelectableView):
    """A component configuration, one set of parameter values, and whether it is the one chosen."""

    __slots__ = ()

    component = Declared[str]()
    parameters = Declared[Parameters]()


class AttributeView(ElementView):
    """A measured attribute: the latest value, when that was measured [s], both None before the first, and its history.

    It is stale once that is longer ago than `max_age` [s].
    """

    __slots__ = ()

    kind = Declared[AttributeKind]()
    max_age = Declared[float]()
    unit = Declared[str]()
    low = Declared[float]()
    high = Declared[float]()
    value = Known[float | None]("value")
    time = Known[float | None]("time")
    is_stale = Known[bool]("stale")

    @property
    def history(self) -> tuple[tuple[float, float], ...]:
        """The measurements so far, as (time [s], value), by time; the newest, see `begins`."""
        return self._asked(History.samples, ())

    @property
    def begins(self) -> float:
        """The time from which on every measurement is in the history [s]; `-math.inf` while none is forgotten."""
        return self._asked(attrgetter("begins"), -math.inf)

    def at(self, time: float) -> float | None:
        """Return what the latest measurement was at a time [s]; None before the first.

        Raises:
            InvalidValue: that is forgotten.
        """
        finite_number(time)
        return self._asked(lambda history: history.at(time), None)

    def _asked(self, question: Callable[[History], T], unmeasured: T) -> T:
        with self.base.reading() as state:
            history = state.histories.get(self.node.index)
            return unmeasured if history is None else question(history)


ViewT = TypeVar("ViewT", bound=ElementView)


class Views(Mapping[str, ViewT]):
    """Views of the elements of one kind by name, in order of declaration; an unknown name says which are near it."""

    def __init__(self, base: Readable, nodes: Mapping[str, Node], view: type[ViewT]) -> None:
        self._base, self._table, self._view = base, nodes, view

    def __getitem__(self, name: str) -> ViewT:
        return self._view(self._base, self._table[name])

    def __contains__(self, name: object) -> bool:
        return name in self._table

    def __len__(self) -> int:
        return len(self._table)

    def __repr__(self) -> str:
        return repr(self._now())

    def __iter__(self) -> Iterator[str]:
        with self._base.reading():
            return iter(tuple(self._table))

    def values(self) -> ValuesView[ViewT]:
        """Return the views, as of now."""
        return self._now().values()

    def items(self) -> ItemsView[str, ViewT]:
        """Return the names and views, as of now."""
        return self._now().items()

    def _now(self) -> dict[str, ViewT]:
        with self._base.reading():
            return {name: self._view(self._base, node) for name, node in self._table.items()}
