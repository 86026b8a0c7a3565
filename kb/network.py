"""The network of a model: one node for each element, linked to those that its status needs."""

from collections.abc import Iterator, Mapping
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
    shown,
)
from kb.exceptions import InvalidValue, UnknownName

Ref = tuple[str, str] | tuple[str, str, int]
"""A reference to a node as plain data: (kind, name); for a constraint (kind, name, position) by an
element it is on."""

_UPWARDS: Final = (
    "constraint",
    "configuration",
    "component",
    "function design",
    "function",
    "action",
    "attribute",
)
LEVELS: Final = {kind: level for level, kind in enumerate(_UPWARDS)}
"""The order in which the kinds are inferred; attributes come last because they have no status."""


class Node:
    """An element in the network.

    Its status is inferred from what it requires: a component's configurations, a design's
    components, a function's designs, an action's functions, a constraint's attribute. It is used
    by the nodes that require it; a constraint by the elements that it is on.
    """

    __slots__ = (
        "attribute",
        "constraint",
        "constraints",
        "debounced",
        "element",
        "index",
        "kind",
        "level",
        "name",
        "network",
        "requires",
        "used_by",
    )

    element: Any  # the element of the model; `kind` says of which class
    attribute: Attribute  # that of this node, or the one that this constraint compares
    constraint: Constraint  # that of this node
    name: str
    constraints: list["Node"]  # those on this element; for an attribute those that compare it
    debounced: list["Node"]  # for an attribute those whose status depends on earlier measurements
    requires: list["Node"]
    used_by: list["Node"]

    def __init__(
        self, network: "Network", index: int, kind: str, element: Element | Constraint
    ) -> None:
        self.network = network
        self.index = index  # the order of declaration
        self.kind = kind
        self.name = element.name if isinstance(element, Element) else str(element)
        self.constraints = []
        self.debounced = []
        self.requires = []
        self.used_by = []
        self.level = LEVELS[kind]
        self.element = element
        if isinstance(element, Constraint):
            self.constraint = element
        elif isinstance(element, Attribute):
            self.attribute = element

    @property
    def ref(self) -> Ref:
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
        self._tables: dict[type, ByName[Node]] = {}
        count = 0
        for cls, kind in KINDS.items():
            if kind not in LEVELS:
                continue
            self._tables[cls] = nodes = ByName(kind, siblings=self._tables)
            for key, element in model.tables[cls].items():
                nodes[key] = Node(self, count, kind, element)
                count += 1
        self.attributes: Mapping[str, Node] = self._tables[Attribute]
        self.components: Mapping[str, Node] = self._tables[Component]
        self.configurations: Mapping[str, Node] = self._tables[Configuration]
        self.functions: Mapping[str, Node] = self._tables[Function]
        self.designs: Mapping[str, Node] = self._tables[FunctionDesign]
        self.actions: Mapping[str, Node] = self._tables[Action]
        self.constraints: Mapping[Constraint, Node] = self._tables[Constraint]
        tables = {KINDS[cls]: table for cls, table in self._tables.items() if cls is not Constraint}
        self.kinds: Mapping[str, Mapping[str, Node]] = ByName("kind of element", tables)
        self._link_all()

    def __reduce__(self) -> tuple[Any, ...]:
        return Network, (self.model,)

    def present(self) -> Iterator[Node]:
        """Yield the node of every element that is in the model."""
        for table in self._tables.values():
            yield from table.values()

    def find(self, element: Element | Constraint) -> Node:
        """Return the node of an element of this model.

        UnknownName if it is not, or no longer, in the model.
        """
        table = self._tables[type(element)]
        key = element.name if isinstance(element, Element) else element
        node = table.get(key)
        if node is None or node.element is not element:
            raise UnknownName(KINDS[type(element)], str(key), map(str, table))
        return node

    def referred(self, ref: Ref) -> Node:
        """Return the node that a reference stands for."""
        match ref:
            case str(kind), str(name):
                return self.kinds[kind][name]
            case str(kind), str(name), int(position):
                constraints = self.kinds[kind][name].constraints
                if 0 <= position < len(constraints):
                    return constraints[position]
                positions = map(str, range(len(constraints)))
                raise UnknownName(f"constraint on {kind} {name!r}", position, positions)
        raise InvalidValue(
            f"{shown(ref)} stands for nothing; an element is (kind, name), a constraint "
            "(kind, name, position) by what it is on"
        )

    def _link_all(self) -> None:
        for node in self.configurations.values():
            _link(self.components[node.element.component], node)
        for node in self.designs.values():
            for name in node.element.components:
                _link(node, self.components[name])
            _link(self.functions[node.element.function], node)
        for node in self.actions.values():
            for name in dict.fromkeys(node.element.functions):
                _link(node, self.functions[name])
        for constraint, node in self.constraints.items():
            attribute = self.attributes[constraint.attribute]
            node.attribute = attribute.element
            node.requires.append(attribute)
            attribute.constraints.append(node)
            if constraint.hysteresis or constraint.dwell or node.attribute.agreement != (1, 1):
                attribute.debounced.append(node)
            for element in dict.fromkeys(constraint.constrained):
                owner = self._tables[type(element)][element.name]
                node.used_by.append(owner)
                owner.constraints.append(node)


def _link(user: Node, part: Node) -> None:
    """Link two nodes: the status of the user is inferred from that of the part."""
    user.requires.append(part)
    part.used_by.append(user)
