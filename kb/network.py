"""The network of a model: one node for each element, linked to those that its status needs."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final

from kb.elements import (
    KINDS,
    Action,
    Attribute,
    ByName,
    Component,
    Configuration,
    Constraint,
    Element,
    Function,
    FunctionDesign,
    Owner,
)
from kb.exceptions import UnknownName

Ref = tuple[str, str] | tuple[str, str, int]
"""A reference to a node as plain data: (kind, name); for a constraint (kind, name, position) by an
element it is on."""

_UPWARDS: Final = (
    Attribute,
    Constraint,
    Configuration,
    Component,
    FunctionDesign,
    Function,
    Action,
)
"""The classes of elements in the order in which their statuses are inferred."""


@dataclass(slots=True, eq=False, repr=False)
class Node:
    """An element in the network.

    Its status is inferred from what it requires: a component's configurations, a design's
    components, a function's designs, an action's functions, a constraint's attribute. It is used
    by the nodes that require it; a constraint by the elements that it is on.

    Attributes:
        network: the network that it is in.
        index: the place in the order of inference, and of declaration within a kind.
        kind: what its class of elements is called.
        name: of the element; for a constraint its text.
        element: the element of the model; `kind` says of which class.
        constraints: those on this element; for an attribute those that compare it.
        debounced: for an attribute those whose status depends on earlier measurements.
        requires: the nodes from which its status is inferred.
        used_by: the nodes whose status is inferred from it.
        attribute: that of this node, or the one that this constraint compares.
        constraint: that of this node.
    """

    network: "Network"
    index: int
    kind: str
    name: str
    element: Any
    constraints: list["Node"] = field(default_factory=list)
    debounced: list["Node"] = field(default_factory=list)
    requires: list["Node"] = field(default_factory=list)
    used_by: list["Node"] = field(default_factory=list)

    attribute: Attribute = field(init=False)
    constraint: Constraint = field(init=False)

    def __post_init__(self) -> None:
        self.attribute = self.element
        self.constraint = self.element

    @property
    def ref(self) -> Ref:
        """What stands for it in events."""
        if self.kind != "constraint":
            return self.kind, self.name
        owner = self.used_by[0]
        return owner.kind, owner.name, owner.constraints.index(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return Network.referred, (self.network, self.ref)

    def __repr__(self) -> str:
        return f"<{self.kind} {self.name!r}>"

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class Network:
    """One node for each element of a model as it is now, found by name within its kind.

    A constraint by itself. When the model changes, a new network is made.
    """

    def __init__(self, model: Owner) -> None:
        self.model = model
        self.kinds: ByName[ByName[Node]] = ByName("kind of element")
        numbers = count()
        for cls in _UPWARDS:
            kind = KINDS[cls]
            self.kinds[kind] = nodes = ByName(kind, siblings=self.kinds)
            for key, element in model.tables[cls].items():
                nodes[key] = Node(self, next(numbers), kind, str(key), element)
        self.attributes = self.kinds["attribute"]
        self.components = self.kinds["component"]
        self.configurations = self.kinds["configuration"]
        self.functions = self.kinds["function"]
        self.designs = self.kinds["function design"]
        self.actions = self.kinds["action"]
        for node in self.configurations.values():
            _link(self.components[node.element.component], node)
        for node in self.designs.values():
            for name in node.element.components:
                _link(node, self.components[name])
            _link(self.functions[node.element.function], node)
        for node in self.actions.values():
            for name in dict.fromkeys(node.element.functions):
                _link(node, self.functions[name])
        for node in self.kinds["constraint"].values():
            constraint = node.element
            attribute = self.attributes[constraint.attribute]
            node.attribute = attribute.element
            node.requires.append(attribute)
            attribute.constraints.append(node)
            if constraint.hysteresis or constraint.dwell or node.attribute.agreement != (1, 1):
                attribute.debounced.append(node)
            for element in dict.fromkeys(constraint.constrained):
                owner = self.find(element)
                node.used_by.append(owner)
                owner.constraints.append(node)

    def __reduce__(self) -> tuple[Any, ...]:
        return Network, (self.model,)

    def present(self) -> Iterator[Node]:
        """Yield the node of every element that is in the model."""
        for nodes in self.kinds.values():
            yield from nodes.values()

    def find(self, element: Element | Constraint) -> Node:
        """Return the node of an element of this model.

        UnknownName if it is not, or no longer, in the model.
        """
        nodes = self.kinds[KINDS[type(element)]]
        key = element if isinstance(element, Constraint) else element.name
        node = nodes.get(key)
        if node is None or node.element is not element:
            raise UnknownName(nodes.kind, str(key), map(str, nodes))
        return node

    def referred(self, ref: Ref) -> Node:
        """Return the node that a reference stands for."""
        kind, name, *position = ref
        node = self.kinds[kind][name]
        return node.constraints[position[0]] if position else node


def _link(user: Node, part: Node) -> None:
    """Link two nodes: the status of the user is inferred from that of the part."""
    user.requires.append(part)
    part.used_by.append(user)
