"""Read-only views of the elements of a knowledge base: what they are, and what is known of them at this moment.

A view answers from the base it was taken from each time it is asked; nothing can be changed through it.
"""

from collections.abc import ItemsView, Iterator, Mapping, ValuesView
from contextlib import AbstractContextManager
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from kb.elements import (
    Attribute,
    Component,
    ComponentKind,
    Configuration,
    Constraint,
    Element,
    Function,
    FunctionDesign,
    Parameters,
    finite_number,
)
from kb.exceptions import UnknownName
from kb.network import Network, Node
from kb.state import State
from kb.status import Status

__all__ = [
    "ActionView",
    "AttributeView",
    "ComponentView",
    "ConfigurationView",
    "ConstraintView",
    "DesignView",
    "ElementView",
    "FunctionView",
    "Readable",
    "Views",
    "named",
    "views_of",
]


class Readable(Protocol):
    """Whatever can be asked: a knowledge base, or one as it would be if."""

    @property
    def now(self) -> float:
        """The time by the clock [s]."""

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""


class ElementView:
    """What every element has: a name, and its kind in words."""

    __slots__ = ("_base", "_node")

    def __init__(self, base: Readable, node: Node) -> None:
        self._base = base
        self._node = node

    @property
    def name(self) -> str:
        """The element's name, unique within its kind."""
        return self._node.name

    @property
    def element(self) -> Element | Constraint:
        """The element of the model that this is a view of, e.g. to amend it there."""
        return self._node.element

    def is_of(self, base: Readable) -> bool:
        """Tell whether it was taken from this base."""
        return self._base is base

    def _known(self, column: str) -> Any:  # noqa: ANN401  # what the array holds
        with self._base.reading() as state:
            return getattr(state, column)[self._node.index]

    def __repr__(self) -> str:
        return f"<{self._node.kind} {self.name!r}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ElementView) and other._node is self._node and other._base is self._base

    def __hash__(self) -> int:
        return hash((id(self._base), self._node.index))


class _StatusView(ElementView):
    __slots__ = ()

    @property
    def status(self) -> Status:
        """The one status that the element has now."""
        status: Status = self._known("status")
        return status


class ConstraintView(_StatusView):
    """A constraint: `attribute operator value`."""

    __slots__ = ()

    @property
    def attribute(self) -> str:
        """Name of the attribute that is compared."""
        return self._constraint.attribute

    @property
    def operator(self) -> str:
        """One of `>=`, `>`, `<=`, `<`."""
        return self._constraint.operator

    @property
    def value(self) -> float:
        """The threshold, in the attribute's unit."""
        return self._constraint.value

    @property
    def _constraint(self) -> Constraint:
        assert isinstance(self._node.element, Constraint)
        return self._node.element


class _ConstrainedView(_StatusView):
    __slots__ = ()

    @property
    def constraints(self) -> tuple[ConstraintView, ...]:
        """The constraints on this element itself."""
        return tuple(ConstraintView(self._base, node) for node in self._node.constraints)


class _RequiredView(_StatusView):
    __slots__ = ()

    @property
    def is_required(self) -> bool:
        """Whether what the mission is doing needs it."""
        return bool(self._known("required"))


class ActionView(_RequiredView, _ConstrainedView):
    """An action, and whether it can be done now."""

    __slots__ = ()

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the functions that it requires."""
        return tuple(part.name for part in self._node.parts)


class FunctionView(_RequiredView):
    """A function, and whether it is realised now."""

    __slots__ = ()

    @property
    def always_improve(self) -> bool:
        """Whether a better design is taken even while it is solved."""
        assert isinstance(self._node.element, Function)
        return self._node.element.always_improve

    @property
    def designs(self) -> tuple[str, ...]:
        """Names of its designs, in order of declaration."""
        return tuple(part.name for part in self._node.parts)


class ComponentView(_RequiredView, _ConstrainedView):
    """A component: whether it runs, and with which parameters."""

    __slots__ = ()

    @property
    def always_improve(self) -> bool:
        """Whether a better configuration is taken even while it is solved."""
        return self._component.always_improve

    @property
    def is_active(self) -> bool:
        """Whether it is running."""
        return bool(self._known("active"))

    @property
    def kind(self) -> ComponentKind:
        """How it is switched: plain, process or lifecycle."""
        return self._component.kind

    @property
    def stops_to_configure(self) -> bool:
        """Whether new parameters are given while it is stopped."""
        return self._component.stops_to_configure

    @property
    def package(self) -> str:
        """Where its program is found."""
        return self._component.package

    @property
    def executable(self) -> str:
        """Its program's name."""
        return self._component.executable

    @property
    def configurations(self) -> tuple[str, ...]:
        """Names of its configurations, in order of declaration."""
        return tuple(part.name for part in self._node.parts)

    @property
    def selected_configuration(self) -> str | None:
        """Name of the configuration that is selected, if one is."""
        with self._base.reading() as state:
            return next((part.name for part in self._node.parts if state.selected[part.index]), None)

    @property
    def parameters_in_force(self) -> Parameters:
        """The parameters that it was last given; empty before that."""
        with self._base.reading() as state:
            return MappingProxyType(dict(state.parameters.get(self.name, {})))

    @property
    def _component(self) -> Component:
        assert isinstance(self._node.element, Component)
        return self._node.element


class _SelectableView(_ConstrainedView):
    __slots__ = ()

    @property
    def is_selected(self) -> bool:
        """Whether it is the one chosen."""
        return bool(self._known("selected"))

    @property
    def reason(self) -> str:
        """Why it was selected, in the words of whoever selected it; empty if that was not said, or it is not."""
        with self._base.reading() as state:
            return state.reason("selected", self._node).text if state.selected[self._node.index] else ""

    @property
    def priority(self) -> float | None:
        """The lowest number is preferred; None comes last."""
        assert isinstance(self._node.element, FunctionDesign | Configuration)
        return self._node.element.priority


class DesignView(_SelectableView):
    """A function design: one set of components that realises a function."""

    __slots__ = ()

    @property
    def function(self) -> str:
        """Name of the function that it realises."""
        return self._node.wholes[0].name

    @property
    def components(self) -> tuple[str, ...]:
        """Names of its components."""
        return tuple(part.name for part in self._node.parts)


class ConfigurationView(_SelectableView):
    """A component configuration: one set of parameter values."""

    __slots__ = ()

    @property
    def component(self) -> str:
        """Name of the component that it configures."""
        return self._node.wholes[0].name

    @property
    def parameters(self) -> Parameters:
        """Its values by parameter name."""
        assert isinstance(self._node.element, Configuration)
        return self._node.element.parameters


class AttributeView(ElementView):
    """A measured attribute."""

    __slots__ = ()

    @property
    def kind(self) -> str:
        """What it describes: "quality" (the robot) or "environmental"."""
        assert isinstance(self._node.element, Attribute)
        return str(self._node.element.kind)

    @property
    def value(self) -> float | None:
        """The latest measurement, or None before the first."""
        value: float | None = self._known("value")
        return value

    @property
    def time(self) -> float | None:
        """When that was measured [s], or None."""
        time: float | None = self._known("time")
        return time

    @property
    def is_stale(self) -> bool:
        """Whether that is longer ago than `max_age`."""
        return bool(self._known("stale"))

    @property
    def max_age(self) -> float:
        """How long a measurement holds [s]."""
        assert isinstance(self._node.element, Attribute)
        return self._node.element.max_age

    @property
    def history(self) -> tuple[tuple[float, float], ...]:
        """Every measurement so far, as (time [s], value), by time."""
        with self._base.reading() as state:
            history = state.histories.get(self._node.index)
            return () if history is None else history.samples()

    def at(self, time: float) -> float | None:
        """Return what the latest measurement was at a time [s]; None before the first."""
        finite_number(time)
        with self._base.reading() as state:
            history = state.histories.get(self._node.index)
            return None if history is None else history.at(time)


ViewT = TypeVar("ViewT", bound=ElementView)


class Views(Mapping[str, ViewT], Generic[ViewT]):
    """The elements of one kind by name, in order of declaration; an unknown name says which are near it."""

    def __init__(self, base: Readable, kind: str, nodes: Mapping[str, Node], view: type[ViewT]) -> None:
        self._base = base
        self._kind = kind
        self._nodes = nodes
        self._view = view

    def __getitem__(self, name: str) -> ViewT:
        return self._view(self._base, named(self._nodes, self._kind, name))

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._nodes

    def __iter__(self) -> Iterator[str]:
        with self._base.reading():
            return iter(tuple(self._nodes))

    def values(self) -> ValuesView[ViewT]:
        """Return the views, as of now."""
        return self._now().values()

    def items(self) -> ItemsView[str, ViewT]:
        """Return the names and views, as of now."""
        return self._now().items()

    def _now(self) -> dict[str, ViewT]:
        with self._base.reading():
            return {name: self._view(self._base, node) for name, node in self._nodes.items()}

    def __len__(self) -> int:
        return len(self._nodes)


def named(table: Mapping[str, Node], kind: str, name: str | ElementView) -> Node:
    """Return the node of a kind that a name or a view stands for.

    Raises:
        UnknownName: there is none.
    """
    try:
        return table[name]  # type: ignore[index]  # a view is no key: answered below
    except (KeyError, TypeError):
        found = table.get(name.name) if isinstance(name, ElementView) else None
        if found is not None and isinstance(name, ElementView) and found.element is name.element:
            return found
        raise UnknownName(kind, name, table) from None


def views_of(
    base: Readable, network: Network
) -> tuple[
    Views[ActionView],
    Views[FunctionView],
    Views[ComponentView],
    Views[DesignView],
    Views[ConfigurationView],
    Views[AttributeView],
]:
    """Return views of the actions, functions, components, designs, configurations and attributes, by name."""
    return (
        Views(base, "action", network.actions, ActionView),
        Views(base, "function", network.functions, FunctionView),
        Views(base, "component", network.components, ComponentView),
        Views(base, "function design", network.designs, DesignView),
        Views(base, "configuration", network.configurations, ConfigurationView),
        Views(base, "attribute", network.attributes, AttributeView),
    )
