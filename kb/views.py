"""Read-only views of the elements of a knowledge base: what is declared, and what is known.

A view reads from its knowledge base each time it is asked; nothing can be changed through it.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, Protocol, TypeVar

from kb.elements import KINDS, Parameters
from kb.network import Node, Ref
from kb.state import State

T = TypeVar("T")


class Readable(Protocol):
    """What views read from: a knowledge base, or a situation that supposes other facts."""

    @property
    def now(self) -> float:
        """The time by the clock [s]."""

    def reading(self) -> AbstractContextManager[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with`."""

    def situation(self) -> "Readable":
        """Return a copy that nothing changes."""


@dataclass(frozen=True, repr=False)
class ElementView:
    """What all views have in common; the fields of the element are read through it too.

    Attributes:
        base: the knowledge base or situation that the view reads from.
        element: the element of the model that this view shows, e.g. to change it there.
    """

    __slots__ = ("base", "element")

    base: Readable
    element: Any

    @property
    def node(self) -> Node:
        """The node of the element in the network of the base."""
        with self.base.reading() as state:
            return state.network.find(self.element)

    @property
    def name(self) -> str:
        """The element's name, unique within its kind; the name of a constraint is its text."""
        return self.node.name

    def __getattr__(self, field: str) -> Any:  # noqa: ANN401  # of the element
        return getattr(self.element, field)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a view as that of the present situation; a knowledge base cannot be pickled."""
        return _restored, (type(self), self.base.situation(), self.node.ref)

    def __repr__(self) -> str:
        return f"<{KINDS[type(self.element)]} {self.name!r}>"


def _restored(view: type[ElementView], base: Readable, ref: Ref) -> ElementView:
    with base.reading() as state:
        return view(base, state.network.referred(ref).element)


class Known(Generic[T]):
    """A property that reads what the state knows of an element."""

    def __init__(self, read: Callable[[State, Node], T]) -> None:
        self._read = read

    def __get__(self, view: ElementView, _: type) -> T:
        with view.base.reading() as state:
            return self._read(state, state.network.find(view.element))


def _parts(_: State, node: Node) -> tuple[str, ...]:
    """Return the names of an element's parts, in order of declaration."""
    return tuple(part.name for part in node.requires)


class _StatusView(ElementView):
    __slots__ = ()

    status = Known(lambda state, node: state.status[node])


class ConstraintView(_StatusView):
    """A constraint: `attribute operator value`; the value is in the attribute's unit."""

    __slots__ = ()


class _ConstrainableView(_StatusView):
    __slots__ = ()

    @property
    def constraints(self) -> tuple[ConstraintView, ...]:
        """The constraints on this element itself, not on its parts."""
        return tuple(ConstraintView(self.base, node.element) for node in self.node.constraints)


class _RequirableView(_ConstrainableView):
    __slots__ = ()

    is_required = Known(State.is_required)


class ActionView(_RequirableView):
    """An action and whether it is feasible now; an action is required while the mission does it."""

    __slots__ = ()


class FunctionView(_RequirableView):
    """A function and whether it is realised now.

    A function is required while a required action needs it.
    """

    __slots__ = ()

    designs = Known(_parts)


class ComponentView(_RequirableView):
    """A component: whether it is required, whether it is running, and with which parameters."""

    __slots__ = ()

    is_active = Known(lambda state, node: node in state.active)
    configurations = Known(_parts)

    selected_configuration = Known(
        lambda state, node: next(
            (part.name for part in node.requires if part in state.selected), None
        )
    )
    """Name of the selected configuration; None if none is selected."""
    parameters_in_force = Known[Parameters](
        lambda state, node: state.parameters.get(node) or MappingProxyType({})
    )
    """The parameters that were set last; empty before the first time."""


class _SelectableView(_ConstrainableView):
    __slots__ = ()

    is_selected = Known(lambda state, node: node in state.selected)
    reason = Known(lambda state, node: state.reason("selected", node).text)
    """The reason that was given with its selection; empty without one."""


class DesignView(_SelectableView):
    """A function design, a set of components that realises a function; maybe selected."""

    __slots__ = ()


class ConfigurationView(_SelectableView):
    """A component configuration, one set of parameter values, and whether it is selected."""

    __slots__ = ()


class AttributeView(ElementView):
    """A measured attribute: its latest value and time [s], None before the first; its history.

    It is stale when the latest measurement is older than `max_age` [s].
    """

    __slots__ = ()

    value = Known(lambda state, node: state.value.get(node))
    time = Known(lambda state, node: state.time.get(node))
    is_stale = Known(lambda state, node: node in state.stale)

    history = Known(
        lambda state, node: tuple(row[:2] for row in tuple(state.histories.get(node, ())))
    )
    """The newest measurements as (time [s], value), in order of time."""


ViewT = TypeVar("ViewT", bound=ElementView)


class Views(Mapping[str, ViewT]):
    """Views of all elements of one kind by name, in order of declaration.

    An unknown name raises UnknownName.
    """

    def __init__(self, base: Readable, kind: str, view: type[ViewT]) -> None:
        self._base = base
        self._kind = kind
        self._view = view

    def _nodes(self) -> Mapping[str, Node]:
        with self._base.reading() as state:
            nodes: Mapping[str, Node] = getattr(state.network, self._kind)
            return nodes

    def __getitem__(self, name: str) -> ViewT:
        return self._view(self._base, self._nodes()[name].element)

    def __contains__(self, name: object) -> bool:
        return name in self._nodes()

    def __len__(self) -> int:
        return len(self._nodes())

    def __iter__(self) -> Iterator[str]:
        return iter(self._nodes())


class ViewsOf(Generic[ViewT]):
    """A property of a situation: the views of one kind, made anew so that nothing refers to itself.

    So a situation is freed at once when nobody needs it.
    """

    def __init__(self, view: type[ViewT]) -> None:
        self._view = view

    def __set_name__(self, owner: type, name: str) -> None:
        self._kind = name

    def __get__(self, base: Readable, owner: type) -> Views[ViewT]:
        return Views(base, self._kind, self._view)
