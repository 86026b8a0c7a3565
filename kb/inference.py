"""Incremental inference: what depends on a changed fact is consulted again, and nothing else.

The network says what depends on what and never changes while facts come in; a state holds the facts and the statuses
inferred from them. An overlay is a state that answers from its own changes first and from the state below otherwise,
so that "what if" costs what it changes and copies nothing.

Inference has two directions. Being required flows down: action to functions, selected design to components. Status
flows up, in levels: constraint, configuration, component, design, function, action.
"""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, TypeVar

from kb.elements import Action, Attribute, Component, Configuration, Constraint, Element, Function, FunctionDesign
from kb.exceptions import UnknownName
from kb.status import (
    Status,
    action_status,
    component_status,
    configuration_status,
    constraint_status,
    design_status,
    function_status,
)

if TYPE_CHECKING:
    from kb.model import Model

__all__ = ["Change", "Network", "Node", "Overlay", "State", "is_adaptable", "settle"]

T = TypeVar("T")

LEVELS: Final = {
    "constraint": 0,
    "configuration": 1,
    "component": 2,
    "function design": 3,
    "function": 4,
    "action": 5,
    "attribute": 6,
}


class Node:
    """An element's place in the network.

    Attributes:
        index: its position in every array of a state.
        constraints: the constraints on it (of an attribute: those that compare it).
        parts: what its status is inferred from, one level or more below: a component's configurations, a design's
            components, a function's designs, an action's functions, a constraint's attribute.
        wholes: what is inferred from its status.
    """

    __slots__ = ("constraints", "element", "index", "kind", "level", "parts", "wholes")

    def __init__(self, index: int, kind: str, element: Element | Constraint) -> None:
        self.index = index
        self.kind = kind
        self.level = LEVELS[kind]
        self.element = element
        self.constraints: list[Node] = []
        self.parts: list[Node] = []
        self.wholes: list[Node] = []

    @property
    def name(self) -> str:
        """The element's name; a constraint is called by its text."""
        return self.element.name if isinstance(self.element, Element) else str(self.element)

    def __repr__(self) -> str:
        return f"<{self.kind} {self.name!r}>"


class Network:
    """What depends on what in a model; one node per element, by name within its kind."""

    def __init__(self, model: "Model") -> None:
        self.model = model
        self.nodes: list[Node] = []
        self.attributes = {name: self._node("attribute", element) for name, element in model.attributes.items()}
        self.components = {name: self._node("component", element) for name, element in model.components.items()}
        self.configurations = {
            name: self._node("configuration", element, wholes=[self.components[element.component]])
            for name, element in model.configurations.items()
        }
        self.functions = {name: self._node("function", element) for name, element in model.functions.items()}
        self.designs = {
            name: self._node(
                "function design",
                element,
                parts=[self.components[part] for part in element.components],
                wholes=[self.functions[element.function]],
            )
            for name, element in model.designs.items()
        }
        self.actions = {
            name: self._node("action", element, parts=[self.functions[part] for part in element.functions])
            for name, element in model.actions.items()
        }
        for constraint in model.constraints:
            node = self._node("constraint", constraint, parts=[self.attributes[constraint.attribute]])
            self.attributes[constraint.attribute].constraints.append(node)
            for element in constraint.constrained:
                target = self.find(element)
                target.constraints.append(node)
                node.wholes.append(target)

    def find(self, element: Element) -> Node:
        """Return the node of an element of this model.

        Raises:
            UnknownName: it was declared after the network was made.
        """
        tables: dict[type[Element], dict[str, Node]] = {
            Action: self.actions,
            Attribute: self.attributes,
            Component: self.components,
            Configuration: self.configurations,
            Function: self.functions,
            FunctionDesign: self.designs,
        }
        table = tables[type(element)]
        if element.name not in table:
            raise UnknownName(type(element).__name__.lower(), element.name, table)
        return table[element.name]

    def _node(
        self, kind: str, element: Element | Constraint, *, parts: Iterable[Node] = (), wholes: Iterable[Node] = ()
    ) -> Node:
        node = Node(len(self.nodes), kind, element)
        self.nodes.append(node)
        for part in dict.fromkeys(parts):
            node.parts.append(part)
            if part.kind != "attribute":
                part.wholes.append(node)
        for whole in wholes:
            node.wholes.append(whole)
            whole.parts.append(node)
        return node


class _Layer(dict[int, T], Generic[T]):
    """An array seen through a few replaced entries."""

    __slots__ = ("below",)

    def __init__(self, below: "list[T] | _Layer[T]") -> None:
        self.below = below

    def __missing__(self, index: int) -> T:
        return self.below[index]


class State:
    """Base facts, and what is inferred from them; every array is indexed by `Node.index`.

    Attributes:
        value: latest measurement of an attribute, or None.
        time: when that was measured [s].
        stale: the latest measurement of an attribute is older than it may be.
        failed: a component is reported failed.
        active: a component is running.
        selected: a design or configuration is chosen.
        requested: an action has an open required-action.
        asserted: a status that stands in place of the inferred one, or None.
        asserted_required: required by assertion, whatever is inferred.
        required: inferred: an open required action, a function of one, a component of a selected design.
        status: inferred, exactly one for each element.
        watched: the nodes that a planner may have to look at: adaptable, active or selected once.
    """

    def __init__(self, network: Network) -> None:
        size = len(network.nodes)
        self.network = network
        self.value: list[float | None] | _Layer[float | None] = [None] * size
        self.time: list[float | None] | _Layer[float | None] = [None] * size
        self.stale: list[bool] | _Layer[bool] = [False] * size
        self.failed: list[bool] | _Layer[bool] = [False] * size
        self.active: list[bool] | _Layer[bool] = [False] * size
        self.selected: list[bool] | _Layer[bool] = [False] * size
        self.requested: list[bool] | _Layer[bool] = [False] * size
        self.asserted: list[Status | None] | _Layer[Status | None] = [None] * size
        self.asserted_required: list[bool] | _Layer[bool] = [False] * size
        self.required: list[bool] | _Layer[bool] = [False] * size
        self.status: list[Status] | _Layer[Status] = [Status.FEASIBLE] * size
        self.watched: dict[int, Node] = {}
        settle(self, network.nodes)

    def watch(self) -> Iterator[Node]:
        """Yield the watched nodes in order of declaration."""
        for index in sorted(self.watched):
            yield self.watched[index]


class Overlay(State):
    """A state on top of another: changes made here leave the one below as it is."""

    def __init__(self, below: State) -> None:
        self.network = below.network
        self.value = _Layer(below.value)
        self.time = _Layer(below.time)
        self.stale = _Layer(below.stale)
        self.failed = _Layer(below.failed)
        self.active = _Layer(below.active)
        self.selected = _Layer(below.selected)
        self.requested = _Layer(below.requested)
        self.asserted = _Layer(below.asserted)
        self.asserted_required = _Layer(below.asserted_required)
        self.required = _Layer(below.required)
        self.status = _Layer(below.status)
        self.watched = {}
        self.below = below

    def watch(self) -> Iterator[Node]:
        """Yield the watched nodes of both states in order of declaration."""
        merged = {node.index: node for node in self.below.watch()} | self.watched
        for index in sorted(merged):
            yield merged[index]


class Change(NamedTuple):
    """A status that is not what it was."""

    node: Node
    old: Status
    new: Status


def settle(state: State, touched: Iterable[Node]) -> list[Change]:
    """Infer again whatever depends on the touched nodes, whose facts have changed.

    Returns:
        The statuses that changed, in the order in which they were inferred.
    """
    agenda: list[dict[Node, None]] = [{} for _ in LEVELS]
    for node in touched:
        _require(state, node, agenda)
    changes = []
    for node in agenda[LEVELS["attribute"]]:
        agenda[0].update(dict.fromkeys(node.constraints))
    for level in range(LEVELS["attribute"]):
        for node in agenda[level]:
            old, new = state.status[node.index], infer(state, node)
            if new is old:
                continue
            state.status[node.index] = new
            changes.append(Change(node, old, new))
            if is_adaptable(state, node):
                state.watched[node.index] = node
            for whole in node.wholes:
                agenda[whole.level][whole] = None
    return changes


def _require(state: State, node: Node, agenda: list[dict[Node, None]]) -> None:
    """Put a node on the agenda after bringing up to date who is required through it."""
    agenda[node.level][node] = None
    if state.active[node.index] or state.selected[node.index]:
        state.watched[node.index] = node
    if node.kind == "action":
        required = state.requested[node.index] or state.asserted_required[node.index]
    elif node.kind == "function":
        required = state.asserted_required[node.index] or any(state.required[whole.index] for whole in node.wholes)
    elif node.kind == "component":
        required = state.asserted_required[node.index] or any(state.selected[whole.index] for whole in node.wholes)
    else:
        for whole in node.wholes:  # whether this one is selected matters to what it is selected for
            agenda[whole.level][whole] = None
        if node.kind == "function design":
            for component in node.parts:
                _require(state, component, agenda)
        return
    if required == state.required[node.index]:
        return
    state.required[node.index] = required
    if node.kind == "action":
        for function in node.parts:
            _require(state, function, agenda)


def is_adaptable(state: State, node: Node) -> bool:
    """Tell whether a function or component has to be chosen for, or may be chosen for better."""
    status = state.status[node.index]
    if status is Status.SOLVED:
        return isinstance(node.element, Function | Component) and node.element.always_improve
    return status in (Status.UNSOLVED, Status.CONFIGURATION_ERROR) and node.kind in ("function", "component")


def infer(state: State, node: Node) -> Status:
    """Return the status of one node by its table, from the facts and the statuses below it."""
    asserted = state.asserted[node.index]
    if asserted is not None:
        return asserted
    status, selected = state.status, state.selected
    element = node.element
    if isinstance(element, Constraint):
        return constraint_status(state.value[node.parts[0].index], element.operator, element.value)
    constraints = [status[constraint.index] for constraint in node.constraints]
    if node.kind == "configuration":
        return configuration_status(constraints)
    if node.kind == "component":
        return component_status(
            failed=state.failed[node.index],
            constraints=constraints,
            configurations=[(status[part.index], selected[part.index]) for part in node.parts],
            required=state.required[node.index],
            active=state.active[node.index],
        )
    if node.kind == "function design":
        components = [status[part.index] for part in node.parts]
        return design_status(constraints=constraints, components=components, selected=selected[node.index])
    if node.kind == "function":
        designs = [(status[part.index], selected[part.index]) for part in node.parts]
        return function_status(designs=designs, required=state.required[node.index])
    functions = [status[part.index] for part in node.parts]
    return action_status(constraints=constraints, functions=functions, required=state.required[node.index])
