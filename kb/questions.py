"""The questions a knowledge base answers, from whatever state it is in.

"What can the robot do now?", "what needs another configuration?", "which would do?": answered here without changing
anything. A knowledge base adds facts to this.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from threading import RLock
from typing import Any, Final

from kb.declarations import listed
from kb.elements import Constraint, Element, Parameters
from kb.exceptions import AmbiguousName, InvalidValue, UnknownName
from kb.explanation.choice import ChoiceExplanation, explain_choice
from kb.explanation.reasons import Explanation, explain, why
from kb.history import History
from kb.inference.network import Network, Node, Ref
from kb.inference.state import Overlay, State
from kb.planners.priority import ranked
from kb.reconfiguration import Obsolete, by_whole, obsolete, reselect
from kb.selection import Choice, Criterion, summed_weights
from kb.status import Status
from kb.views import (
    ActionView,
    AttributeView,
    ComponentView,
    ConfigurationView,
    DesignView,
    ElementView,
    FunctionView,
    Views,
)

__all__ = ["ELEMENTS", "Questions"]

ELEMENTS: Final = ("action", "function", "component", "function design", "configuration", "constraint")
"""The kinds of elements that have a status; all but constraints have a name too."""
_EXPLAINED: Final = (*ELEMENTS, "attribute")


class Questions(ABC):
    """Everything that can be asked.

    Args:
        network: what depends on what.
        clock: gives the time [s]; for the age of measurements.

    Attributes:
        actions, functions, components, designs, configurations, attributes: views by name.
    """

    def __init__(self, network: Network, clock: Callable[[], float]) -> None:
        self._network = network
        self._clock = clock
        self._lock = RLock()
        self._in_force: dict[str, Parameters] = {}
        self.actions = Views(self, "action", network.actions, ActionView)
        self.functions = Views(self, "function", network.functions, FunctionView)
        self.components = Views(self, "component", network.components, ComponentView)
        self.designs = Views(self, "function design", network.designs, DesignView)
        self.configurations = Views(self, "configuration", network.configurations, ConfigurationView)
        self.attributes = Views(self, "attribute", network.attributes, AttributeView)

    @property
    def now(self) -> float:
        """The time by the clock [s]."""
        return self._clock()

    @property
    @abstractmethod
    def _state(self) -> State:
        """The facts and statuses to answer from."""

    @contextmanager
    def reading(self) -> Iterator[State]:
        """Give the facts and statuses, to be read only; nothing changes within the `with` statement."""
        with self._lock:
            yield self._state

    def is_feasible(self, action: str) -> bool:
        """Tell whether an action can be done now: its status is not "unfeasible"."""
        with self._lock:
            return self._state.status[self.actions.node(action).index] is not Status.UNFEASIBLE

    def selectable_actions(self) -> tuple[str, ...]:
        """Names of the actions that can be done now."""
        with self._lock:
            return self._selectable(self._network.actions.values())

    def selectable_designs(self, function: str) -> tuple[str, ...]:
        """Names of a function's designs that can be selected now, in order of declaration."""
        with self._lock:
            return self._selectable(self.functions.node(function).parts)

    def selectable_configurations(self, component: str) -> tuple[str, ...]:
        """Names of a component's configurations that can be selected now, in order of declaration."""
        with self._lock:
            return self._selectable(self.components.node(component).parts)

    def best_configuration(self, action: str, preference: str | Mapping[str, float] | None = None) -> Choice | None:
        """Return how the robot is best configured for an action by itself; None while it is unfeasible.

        Args:
            action: its name; it need not be required.
            preference: name of the attribute to favour, or the weight of each of several; without one, and where no
                estimation bears on it, the choice is by priority.
        """
        node = self.actions.node(action)
        with self._lock:
            if self._state.status[node.index] is Status.UNFEASIBLE:
                return None
            if preference is not None:
                from kb.planners.solver import best_choice  # the solver takes a while to import

                return best_choice(self._state, Criterion(summed_weights([preference])), node.parts).choice
            designs = [first for function in node.parts for first in ranked(self._state, function)[:1]]
            components = dict.fromkeys(part for design in designs for part in design.parts)
            configurations = [first for component in components for first in ranked(self._state, component)[:1]]
            return Choice(by_whole(designs), by_whole(configurations))

    def adaptable_functions(self) -> tuple[str, ...]:
        """Names of the functions for which a design has to be chosen, or may be chosen better."""
        with self._lock:
            return _adaptable(self._state, "function")

    def adaptable_components(self, designs: Iterable[str] | Mapping[str, str] = ()) -> tuple[str, ...]:
        """Names of the components for which a configuration has to be chosen, or may be chosen better.

        Args:
            designs: names of designs just chosen, or these by function; the answer is what it will be once they are
                selected and what is obsolete is not.
        """
        names = listed("designs", designs.values() if isinstance(designs, Mapping) else designs)
        with self._lock:
            chosen = [self.designs.node(name) for name in names]
            supposed = Overlay(self._state)
            reselect(supposed, chosen, ())
            return _adaptable(supposed, "component")

    def obsolete(self) -> Obsolete:
        """Names of the components, designs and configurations that nothing required needs any more."""
        with self._lock:
            return obsolete(self._state)

    def explain(self, element: ElementView | Element | Constraint | str) -> Explanation:
        """Say why an element has the status that it has, and what would make it feasible if it is not.

        Args:
            element: a view, an element of the model, or a name; a name that several kinds share means the action
                before the function, component, design, configuration and attribute. Of an attribute it is said what
                is known of it, and what depends on it.
        """
        with self._lock:
            return explain(self._state, self._node(element, _EXPLAINED), self._clock())

    def why(self, element: ElementView | Element | Constraint | str) -> str:
        """Say in a sentence why an element has its status; quicker than `explain`, for it looks for no remedies."""
        with self._lock:
            return why(self._state, self._node(element, _EXPLAINED), self._clock())

    def explain_choice(self, element: ElementView | Element | Constraint | str) -> ChoiceExplanation:
        """Say why a function has the design, or a component the configuration, that it has, and not another one.

        Args:
            element: a view, an element of the model, or a name; of a name that both kinds share the function is meant.
        """
        with self._lock:
            return explain_choice(self._state, self._node(element, ("function", "component")), self._clock())

    @abstractmethod
    def _history_of(self, attribute: Node) -> History:
        """Return every measurement of an attribute."""

    def _selectable(self, nodes: Iterable[Node]) -> tuple[str, ...]:
        status = self._state.status
        return tuple(node.name for node in nodes if status[node.index] is not Status.UNFEASIBLE)

    def _node(
        self, element: ElementView | Element | Constraint | Ref | str, kinds: Iterable[str], unique: bool = False
    ) -> Node:
        """Return the node that is meant; a bare name is looked for in the given kinds, in this order."""
        if isinstance(element, tuple):
            return _allowed(self._referred(*element), kinds)
        if isinstance(element, ElementView):
            if element._base is not self:
                raise InvalidValue(f"{element!r} is a view of another knowledge base; take it from this one")
            element = element.element
        if isinstance(element, Element) and self._network.model is not element.model:
            raise InvalidValue(f"{element.name!r} belongs to another model, {element.model.name!r}")
        if isinstance(element, Element | Constraint):
            return _allowed(self._network.find(element), kinds)
        views: dict[str, Views[Any]] = {
            "action": self.actions,
            "function": self.functions,
            "component": self.components,
            "function design": self.designs,
            "configuration": self.configurations,
            "attribute": self.attributes,
        }
        searched = {kind: views[kind] for kind in kinds if kind in views}
        found = [table.node(element) for table in searched.values() if isinstance(element, str) and element in table]
        if not found:
            raise UnknownName(" or ".join(searched), element, [name for table in searched.values() for name in table])
        if unique and len(found) > 1:
            things = ", ".join(f"{'an' if node.kind == 'action' else 'a'} {node.kind}" for node in found)
            example = f"kb.{found[0].kind.removeprefix('function ')}s[{element!r}]"
            raise AmbiguousName(f"{element!r} names several things: {things}; pass the view meant, e.g. {example}")
        return found[0]

    def _referred(self, kind: str, name: str, position: int | None = None) -> Node:
        """Return the node that `Node.ref` tells of."""
        tables = (self.actions, self.functions, self.components, self.designs, self.configurations)
        named = {"action": 0, "function": 1, "component": 2, "function design": 3, "configuration": 4}
        if kind not in named:
            raise UnknownName("kind of element", kind, named)
        node = tables[named[kind]].node(name)
        return node if position is None else node.constraints[position]


def _allowed(node: Node, kinds: Iterable[str]) -> Node:
    if node.kind not in kinds:
        raise InvalidValue(f"{node!r} cannot be meant here; allowed are {', '.join(kinds)}")
    return node


def _adaptable(state: State, kind: str) -> tuple[str, ...]:
    return tuple(node.name for node in state.adaptable.nodes() if node.kind == kind)
