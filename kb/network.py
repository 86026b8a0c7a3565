"""The network of a model: one node for each element, connected to the nodes that its status depends on."""

import math
from bisect import bisect_right
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
    shown,
)
from kb.exceptions import InvalidValue, UnknownName
from kb.facts import Contents

Ref = tuple[str, str] | tuple[str, str, int]
"""A reference to a node as plain data: (kind, name); for a constraint (kind, name, position) by an element it is on."""

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

    __slots__ = ("constraints", "element", "index", "kind", "level", "name", "requires", "used_by")

    element: Any  # the element of the model; `kind` says of which class
    name: str
    constraints: list["Node"]  # those on this element; for an attribute those that compare it
    requires: list["Node"]
    used_by: list["Node"]

    def __init__(self, index: int, kind: str, element: Element | Constraint) -> None:
        self.index = index  # the order of declaration
        self.kind, self.level = kind, LEVELS[kind]
        self.element = element

    @property
    def attribute(self) -> Attribute:
        """The attribute of this node, or the one that this constraint compares."""
        found: Attribute = self.requires[0].element if self.kind == "constraint" else self.element
        return found

    @property
    def constraint(self) -> Constraint:
        found: Constraint = self.element
        return found

    @property
    def ref(self) -> Ref:
        if self.kind != "constraint":
            return self.kind, self.name
        owner = self.used_by[0]
        return owner.kind, owner.name, owner.constraints.index(self)

    def __repr__(self) -> str:
        return f"<{self.kind} {self.name!r}>"

    def __str__(self) -> str:
        return f"{self.kind} {self.name}"


class Thresholds:
    """The constraints on one attribute, in the order of the values at which their status changes.

    Each of the four comparisons changes at one value t: it has one status below t and the other one from t on. For
    `>` and `<=`, t is the next floating-point number above the written one.
    """

    def __init__(self, attribute: Node) -> None:
        # their status depends on earlier measurements too
        self.debounced = [node for node in attribute.constraints if is_debounced(node)]
        self._nodes = sorted(
            (node for node in attribute.constraints if not is_debounced(node)), key=_turn
        )
        self._turns = [_turn(node) for node in self._nodes]

    def crossed(self, old: float, new: float) -> list[Node]:
        """Return the constraints whose status differs between the old and the new value."""
        before, after = bisect_right(self._turns, old), bisect_right(self._turns, new)
        return self._nodes[before:after] if before < after else self._nodes[after:before]

    def around(self, value: float) -> list[float]:
        place = bisect_right(self._turns, value)
        return [node.constraint.value for node in self._nodes[max(0, place - 1) : place + 1]]


def is_debounced(node: Node) -> bool:
    """Tell whether the status of a constraint depends on earlier measurements too; see `kb.debounce`."""
    return (
        node.constraint.hysteresis > 0
        or node.constraint.dwell > 0
        or node.attribute.agreement != (1, 1)
    )


def _turn(node: Node) -> float:
    value = node.constraint.value
    return value if node.constraint.operator in (">=", "<") else math.nextafter(value, math.inf)


class Network:
    """One node for each element of a model, found by name within its kind; a constraint is found by itself."""

    def __init__(self, model: Contents) -> None:
        self.model = model
        self.revision = 0  # grows at each `renew`
        self.nodes: list[Node] = []
        self._thresholds: dict[Node, Thresholds] = {}
        self._tables: dict[type, ByName[Node]] = {
            cls: ByName(kind) for cls, kind in KINDS.items() if kind in LEVELS
        }
        self.attributes: Mapping[str, Node] = self._tables[Attribute]
        self.components: Mapping[str, Node] = self._tables[Component]
        self.configurations: Mapping[str, Node] = self._tables[Configuration]
        self.functions: Mapping[str, Node] = self._tables[Function]
        self.designs: Mapping[str, Node] = self._tables[FunctionDesign]
        self.actions: Mapping[str, Node] = self._tables[Action]
        self.constraints: Mapping[Constraint, Node] = self._tables[Constraint]
        tables = {
            kind: self._tables[cls] for cls, kind in KINDS.items() if issubclass(cls, Element)
        }
        self.kinds: Mapping[str, Mapping[str, Node]] = ByName("kind of element", tables)
        self.renew()

    def thresholds(self, attribute: Node) -> Thresholds:
        """Return the constraints on an attribute in the order of their thresholds."""
        thresholds = self._thresholds.get(attribute)
        if thresholds is None:
            thresholds = self._thresholds[attribute] = Thresholds(attribute)
        return thresholds

    def find(self, element: Element | Constraint) -> Node:
        """Return the node of an element of this model; UnknownName if it is not, or no longer, in the model."""
        table = self._tables[type(element)]
        node = table.get(element if isinstance(element, Constraint) else element.name)
        if node is None or node.element is not element:
            name = str(element) if isinstance(element, Constraint) else element.name
            raise UnknownName(KINDS[type(element)], name, [str(one) for one in table])
        return node

    def present(self) -> Iterator[Node]:
        """Yield every node that has not been removed."""
        for table in self._tables.values():
            yield from tuple(table.values())

    def referred(self, ref: Ref) -> Node:
        kind, name, position = (
            ref if len(ref) == 3 else (*ref, 0) if len(ref) == 2 else (None, None, None)
        )
        if not (isinstance(kind, str) and isinstance(name, str) and type(position) is int):
            what = (
                "an element is (kind, name), a constraint (kind, name, position) by what it is on"
            )
            raise InvalidValue(f"{shown(ref)} stands for nothing; {what}")
        node = self.kinds[kind][name]
        if len(ref) == 2:
            return node
        if not 0 <= position < len(node.constraints):
            raise UnknownName(
                f"constraint on {kind} {name!r}", position, map(str, range(len(node.constraints)))
            )
        return node.constraints[position]

    def renew(self) -> None:
        """Connect the nodes of all elements that are in the model now; it can be called again after an interrupt.

        An element keeps its node. The index of a removed element is not used again.
        """
        self.revision += 1
        self._thresholds = {}
        for cls, known in self._tables.items():
            kind, table = KINDS[cls], self.model.tables[cls]
            for key, element in table.items():
                node = known.get(key)
                if node is None or node.element is not element:
                    node = Node(len(self.nodes), kind, element)
                    self.nodes.append(node)
                node.name, known[key] = str(key), node  # last: what is found by name is complete
            for key in (
                [key for key in known if key not in table] if len(known) > len(table) else ()
            ):
                known.pop(key, None)
        for node in self.nodes:
            node.constraints, node.requires, node.used_by = [], [], []
        for node in self.configurations.values():
            link(self.components[node.element.component], node)
        for node in self.designs.values():
            for name in node.element.components:
                link(node, self.components[name])
            link(self.functions[node.element.function], node)
        for node in self.actions.values():
            for name in dict.fromkeys(node.element.functions):
                link(node, self.functions[name])
        for node in self.constraints.values():
            self._link_constraint(node)

    def _link_constraint(self, node: Node) -> None:
        attribute = self.attributes[node.element.attribute]
        node.requires.append(attribute)
        attribute.constraints.append(node)
        for element in dict.fromkeys(node.element.constrained):
            owner = self._tables[type(element)][element.name]
            node.used_by.append(owner)
            owner.constraints.append(node)


def link(user: Node, part: Node) -> None:
    """Connect two nodes: the status of the user is inferred from that of the part."""
    user.requires.append(part)
    part.used_by.append(user)
