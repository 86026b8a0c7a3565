"""Writes trees as XML.

`export_xml` writes trees that can be read again exactly, and refuses others; a `NumberedTree` shows
any.
"""

from collections.abc import Container, Mapping
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Success
from py_trees.composites import Selector, Sequence
from py_trees.decorators import Decorator, FailureIsSuccess, Inverter, SuccessIsFailure

from rosa_bt.decorators import Delay, Timeout, Timer
from rosa_bt.exceptions import ExportError, XmlError
from rosa_bt.xml.document import Document, wrong_id
from rosa_bt.xml.nodes import NODES, OneChild, Slot, XmlNode, is_plain
from rosa_bt.xml.reader import BehaviourRegistry, Registration, SubTree, ports_of

_TAGS: Mapping[type[Behaviour], str] = {
    Inverter: "Inverter",
    FailureIsSuccess: "ForceSuccess",
    SuccessIsFailure: "ForceFailure",
    Success: "AlwaysSuccess",
    Failure: "AlwaysFailure",
    Sequence: "Sequence",
    Selector: "Fallback",
    Timer: "Sleep",
    Timeout: "Timeout",
    Delay: "Delay",
}
"""The tags of behaviours that mean exactly the same; before those of composites without memory,
`Reactive`."""


def export_xml(behaviour: Behaviour, registry: BehaviourRegistry | None = None) -> str:
    """Write a tree as XML of BehaviorTree.CPP 4.

    It writes trees from `load_xml`, also changed ones, and trees of behaviours that mean the same:
    Sequence and Selector (with and without memory), Inverter, FailureIsSuccess, SuccessIsFailure,
    Success, Failure, our Timer, Timeout and Delay; and those that the registry has, if each of
    their arguments is an attribute of the same name. The idioms are written as the nodes that they
    consist of. The contents of blackboards are not written.

    Args:
        behaviour: the root of the tree.
        registry: gives leaves that are not from a file their tags; without it, the name of the
            class.

    Raises:
        ExportError: a behaviour has no exact counterpart; the message names it.
    """
    writer = _Writer(registry)
    main = writer.tree(behaviour)
    root = Element("root", BTCPP_format="4", main_tree_to_execute=main)
    for name, content in sorted(writer.trees.items(), key=lambda tree: tree[0] != main):
        SubElement(root, "BehaviorTree", ID=name).append(content)
    if writer.models:
        SubElement(root, "TreeNodesModel").extend(writer.models.values())
    indent(root)
    text = tostring(root, encoding="unicode") + "\n"
    try:
        notes = Document([text]).notes
    except XmlError as error:
        notes = [str(error)]
    again = f"{behaviour.name!r} cannot be written so that it can be read again"
    problems = [*writer.problems, *(f"{again}: {note}" for note in notes)]
    if problems:
        raise ExportError(problems[0])
    return text


def _content(root: Behaviour) -> tuple[str, Slot]:
    """Return the ID of a tree, and the slot of its first node."""
    if isinstance(root, SubTree):
        return root.tree, root.child
    return "MainTree", Slot(root)


def _free_name(name: str, taken: Container[str]) -> str:
    """Return a name, or the first of Dock_2, Dock_3, ... that is not taken."""
    free = name
    number = 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


class _Writer:
    """Makes the elements of trees.

    Attributes:
        trees: the first elements of the trees, by ID.
        models: the elements of the TreeNodesModels of their files, by ID.
        problems: why behaviours cannot be written exactly.
    """

    def __init__(self, registry: BehaviourRegistry | None = None) -> None:
        self._registry = registry
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self.problems: list[str] = []

    def tree(self, root: Behaviour) -> str:
        """Write a tree; return its ID, a new one if another tree has its own."""
        if isinstance(root, SubTree):
            self.models.update(root.models)
        name, slot = _content(root)
        content = self.element(slot)
        text = tostring(content)
        others = [name for name, tree in self.trees.items() if tostring(tree) != text]
        name = _free_name(name, others)
        self.trees.setdefault(name, content)
        return name

    def element(self, slot: Slot) -> Element:
        node = slot.node
        element = Element(*(slot.source or self._source(node)))  # type: ignore[arg-type]  # it is copied
        if isinstance(node, SubTree):
            element.set("ID", self.tree(node))
            return element
        if isinstance(node, XmlNode):
            slots = node.slots
        else:  # a OneChild is not in the file
            children = node.children
            slots = [child.child if type(child) is OneChild else Slot(child) for child in children]
        element.extend([self.element(child) for child in slots])
        return element

    def _source(self, node: Behaviour) -> tuple[str, dict[str, str]]:
        """Return tag and attributes of a behaviour that is not from a file."""
        kind = type(node)
        attributes = {"name": node.name}
        source = self._known_source if kind in _TAGS else self._own_source
        tag, problem = source(node, attributes)
        if problem:
            self.problems.append(f"{kind.__name__} {node.name!r} cannot be written: {problem}")
        return tag, attributes

    def _known_source(self, node: Behaviour, attributes: dict[str, str]) -> tuple[str, str]:
        """Return tag and problem of a behaviour that XML has, and add its attributes."""
        tag = _TAGS[type(node)]
        problem = ""
        if isinstance(node, Sequence | Selector):
            tag = tag if node.memory else f"Reactive{tag}"
            problem = "" if node.children else "it has no children"
        elif isinstance(node, Timer | Timeout | Delay):
            milliseconds = f"{node.duration * 1000:.12g}"
            problem = "" if milliseconds.isdigit() else "XML has whole milliseconds"
            attributes.update(dict.fromkeys(NODES[tag].PORTS, milliseconds))
        return tag, problem

    def _own_source(self, node: Behaviour, attributes: dict[str, str]) -> tuple[str, str]:
        """Return tag and problem of a behaviour of the user, and add its attributes."""
        kind = type(node)
        known = self._registry or BehaviourRegistry(kb=None)
        name = known.name_of(node)
        tag = name or kind.__name__
        if not name and (self._registry or node.children or tag in NODES):
            return tag, "it is not registered, and has no exact counterpart in BehaviorTree.CPP"
        registration = known.entries.get(tag) or Registration(kind, {"kb": None})
        problem = wrong_id(tag)
        for argument in {**registration.arguments, **ports_of(node)}:
            parameter = registration.parameters.get(argument)
            try:
                value = getattr(node, argument)
            except (AttributeError, RuntimeError):  # the latter: a port that is not connected
                if registration.factory is kind:
                    problem = f"it has no attribute {argument!r}, with which it was made"
                continue
            if value is None or (parameter is not None and value == parameter.default):
                continue
            text = str(value)
            attributes[argument] = text.lower() if isinstance(value, bool) else text
            if not isinstance(value, bool | int | float | str):
                problem = f"its attribute {argument!r} is neither a number nor a text"
        return tag, problem


def _places(root: Behaviour) -> list[tuple[Behaviour, Behaviour | None]]:
    return [(node, node.parent) for node in root.iterate()]


class NumberedTree(_Writer):
    """A tree as XML with numbered nodes, for programs that watch it.

    Make a new one when it changed.

    Args:
        root: the root of any tree of py_trees.

    Attributes:
        xml: the text. The number of a node is its attribute `_uid`; each subtree is a
            `BehaviorTree` element of its own, with its place in `_fullpath`.
        numbers: the numbers by behaviour, from 1, in the order of the text.
        subtrees: the subtrees by the name of their blackboard; None for one that is not from XML.
    """

    def __init__(self, root: Behaviour) -> None:
        super().__init__()
        self._places = _places(root)
        self.numbers: dict[Behaviour, int] = {}
        self.subtrees: dict[str, SubTree | None] = {}
        self._path = ""
        main, _ = _content(root)
        self._whole = Element("root", BTCPP_format="4", main_tree_to_execute=main)
        self.tree(root)
        models = SubElement(self._whole, "TreeNodesModel")
        models.extend([self.models[tag] for tag in sorted(self.models)])
        self.xml = tostring(self._whole, encoding="unicode")

    def shows(self, root: Behaviour) -> bool:
        """Tell whether it still shows the tree: no child was added, removed or moved."""
        return _places(root) == self._places

    def tree(self, root: Behaviour) -> str:
        name, slot = _content(root)
        around = self._path
        if self.numbers:  # it is not the main tree
            self._path = f"{around}/{root.name}".lstrip("/")
        place = _free_name(self._path or name, self.subtrees)
        self.subtrees[place] = root if isinstance(root, SubTree) else None
        element = SubElement(self._whole, "BehaviorTree", ID=name, _fullpath=self._path)
        element.append(self.element(slot))
        self._path = around
        return name

    def element(self, slot: Slot) -> Element:
        node = slot.node
        number = self.numbers.setdefault(node, len(self.numbers) + 1)
        element = super().element(slot)
        element.attrib.update(name=node.name, _uid=str(number))
        kind = "Condition" if is_plain(node) else "Action"
        if node.children:
            kind = "Decorator" if isinstance(node, Decorator | OneChild) else "Control"
        tag = element.get("ID", element.tag)
        if not isinstance(node, SubTree):
            self.models[tag] = Element(kind, ID=tag)
        return element
