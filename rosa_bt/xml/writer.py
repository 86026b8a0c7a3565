"""Writes trees as XML.

`export_xml` writes trees that can be read again exactly, and refuses others; a `NumberedTree` shows
any.
"""

from collections.abc import Container, Mapping
from math import inf
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Success
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator, FailureIsSuccess, Inverter, SuccessIsFailure

from rosa_bt.behaviours import ActionBehaviour, RosaAction
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import Delay, ForAction, Retry, Timeout, Timer, UntilSuccess
from rosa_bt.exceptions import ExportError, XmlError
from rosa_bt.xml.blackboard import ports_of
from rosa_bt.xml.document import Document, wrong_id
from rosa_bt.xml.nodes import Branch, Slot, XmlNode, is_plain
from rosa_bt.xml.reader import SubTree
from rosa_bt.xml.registry import BUILT_IN, BehaviourRegistry, Entry

_TAGS: Mapping[type[Behaviour], str] = {
    Inverter: "Inverter",
    FailureIsSuccess: "ForceSuccess",
    SuccessIsFailure: "ForceFailure",
    Success: "AlwaysSuccess",
    Failure: "AlwaysFailure",
    Sequence: "Sequence",
    Selector: "Fallback",
    Timer: "Sleep",
    **{kind: kind.__name__ for kind in (Timeout, Delay, ForAction, UntilSuccess, Retry)},
    **{kind: kind.__name__ for kind in (DoUntilUnfeasible, SafeSwitch)},
}
"""The tags of behaviours that mean exactly the same; before those of composites without memory,
`Reactive`."""
Source = tuple[str, dict[str, str]]
"""The tag and the attributes of an element."""
_DURATIONS = {Timer: "msec", Timeout: "msec", Delay: "delay_msec"}
_ARGUMENTS = (
    *("action", "preference", "wait", "timeout", "exclusive"),
    *("halting_timeout", "memory", "after", "num_failures", "pause"),
)
"""Parameters of our behaviours that are attributes, of the element as of the behaviour."""
_DEFAULTS = (None, False, inf, RosaAction.halting_timeout)


def export_xml(behaviour: Behaviour, registry: BehaviourRegistry | None = None) -> str:
    """Write a tree as XML of BehaviorTree.CPP 4.

    It writes trees from `load_xml`, also changed ones, and trees of behaviours that mean the same:
    Sequence and Selector (with and without memory), Inverter, FailureIsSuccess, SuccessIsFailure,
    Success, Failure, our Timer, Timeout and Delay, and leaves that need no arguments but a name, a
    knowledge base and the action. The idioms are written as the nodes that they consist of;
    ForAction, UntilSuccess, Retry, DoUntilUnfeasible and SafeSwitch are in every registry with a
    knowledge base. The contents of blackboards are not written.

    Args:
        behaviour: the root of the tree.
        registry: gives leaves that are not from a file their tags; without it, the name of the
            class.

    Raises:
        ExportError: a behaviour has no exact counterpart; the message names it.
    """
    writer = _Exporter(registry)
    main = writer.tree(behaviour)
    root = Element("root", BTCPP_format="4", main_tree_to_execute=main)
    for name, content in sorted(writer.trees.items(), key=lambda tree: tree[0] != main):
        SubElement(root, "BehaviorTree", ID=name).append(content)
    if writer.models:
        SubElement(root, "TreeNodesModel").extend(writer.models.values())
    indent(root)
    text = tostring(root, encoding="unicode") + "\n"
    try:
        problems = Document([text]).notes
    except XmlError as error:
        problems = [str(error)]
    if problems:
        problem = f"{behaviour.name!r} cannot be written so that it can be read again"
        raise ExportError(f"{problem}: {problems[0]}")
    return text


def slot_of(behaviour: Behaviour) -> Slot:
    for slot in behaviour.parent.slots if isinstance(behaviour.parent, XmlNode) else ():
        if slot.node is behaviour:
            return slot
    return Slot(behaviour)


def _content(root: Behaviour) -> tuple[str, Slot]:
    """Return the ID of a tree, and the slot of its first node."""
    if isinstance(root, SubTree):
        return root.tree, root.child
    return "MainTree", slot_of(root)


def _free_name(name: str, taken: Container[str]) -> str:
    """Return a name, or the first of Dock_2, Dock_3, ... that is not taken."""
    free = name
    number = 1
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def _tag(node: Behaviour) -> str:
    """Return the tag of a behaviour of py_trees."""
    kind = type(node)
    if kind in (Sequence, Selector) and not node.memory:  # type: ignore[attr-defined]  # both have it
        return f"Reactive{_TAGS[kind]}"
    return _TAGS.get(kind, kind.__name__)


def _attributes(node: Behaviour, parameters: Container[str] = _ARGUMENTS) -> dict[str, str]:
    """Return the arguments of a behaviour of ours that are parameters."""
    kind = type(node)
    if kind in _DURATIONS:
        milliseconds = node.duration * 1000  # type: ignore[attr-defined]  # all three have it
        return {_DURATIONS[kind]: f"{milliseconds:.12g}"}
    attributes = {}
    for name in _ARGUMENTS:
        value: Any = getattr(node, name, None)
        is_in_tag = name == "memory" and kind in (Sequence, Selector)
        if name in parameters and value not in _DEFAULTS and not is_in_tag:
            text = ";".join(value) if isinstance(value, tuple) else str(value)
            attributes[name] = "true" if value is True else text
    return attributes


class _Writer:
    """Makes an element of each node; base class."""

    def element(self, slot: Slot) -> Element:
        node = slot.node
        if type(node) is Branch:
            return self.element(node.child)  # it is not in the file
        tag, attributes = slot.source or self.source(node)
        element = Element(tag, dict(attributes))
        self.take(node, element)
        if isinstance(node, SubTree):
            element.set("ID", self.tree(node))
        elif isinstance(node, XmlNode):
            element.extend([self.element(child) for child in node.slots])
        else:
            for child in node.children:  # a decorator of the user may have others than in the file
                if type(child) is Branch or slot.source is None:
                    element.append(self.element(slot_of(child)))
        return element

    def source(self, node: Behaviour) -> Source:
        """Return tag and attributes of a behaviour that is not from a file."""
        raise NotImplementedError

    def take(self, node: Behaviour, element: Element) -> None:
        """Note an element that was made."""

    def tree(self, root: Behaviour) -> str:
        """Write a tree; return its ID."""
        raise NotImplementedError


class _Exporter(_Writer):
    def __init__(self, registry: BehaviourRegistry | None) -> None:
        self._registry = registry
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}

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

    def source(self, node: Behaviour) -> Source:
        kind = type(node)
        if kind in _TAGS and (node.children or not isinstance(node, Composite)):
            tag = _tag(node)
            attributes = _attributes(node)
            if kind in _DURATIONS and not attributes[_DURATIONS[kind]].isdigit():
                raise ExportError(
                    f"{node.name!r} does not take whole milliseconds, as XML has them"
                )
        elif node.children or isinstance(node, Composite):
            what = f"{kind.__name__} {node.name!r}{'' if node.children else ' without children'}"
            written = ", ".join(sorted(same.__name__ for same in _TAGS))
            problem = f"{what} has no exact counterpart in BehaviorTree.CPP"
            raise ExportError(f"{problem}; written are {written}")
        else:
            tag, attributes = self._leaf(node)
        return tag, {"name": node.name, **attributes}

    def _leaf(self, leaf: Behaviour) -> Source:
        kind = type(leaf)
        registry = self._registry
        what = f"{kind.__name__} {leaf.name!r}"
        tag = registry.name_of(leaf) if registry else kind.__name__
        if tag is None:
            raise ExportError(f"{what} is not registered; register its class")
        if tag in BUILT_IN or wrong_id(tag):
            problem = wrong_id(tag) or f"{tag!r} is a node of BehaviorTree.CPP itself"
            raise ExportError(f"{what} is registered under a name that is refused: {problem}")
        entry = registry.entries[tag] if registry else Entry(kind, None, {"kb": None})
        names = {*entry.arguments, *ports_of(leaf)[0]}
        attributes = {}
        if isinstance(leaf, ActionBehaviour):
            if leaf.named_action is None:
                raise ExportError(f"{what} names no action; make it with one")
            attributes = _attributes(leaf, names)
            names -= {name for name in _ARGUMENTS if hasattr(leaf, name)}
        if entry.factory is kind and names:
            advice = "register a function under the name of the leaf that makes it"
            made_with = ", ".join(sorted(names))
            raise ExportError(
                f"{what} was made with {made_with}, which cannot be written; {advice}"
            )
        return tag, attributes


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
        self._root = root
        self._children = [(node, list(node.children)) for node in root.iterate() if node.children]
        self.numbers: dict[Behaviour, int] = {}
        self.subtrees: dict[str, SubTree | None] = {}
        self._kinds: dict[str, str] = {}
        self._path = ""
        main, _ = _content(root)
        self._whole = Element("root", BTCPP_format="4", main_tree_to_execute=main)
        self.tree(root)
        models = SubElement(self._whole, "TreeNodesModel")
        for tag, kind in sorted(self._kinds.items()):
            SubElement(models, kind, ID=tag)
        self.xml = tostring(self._whole, encoding="unicode")

    def shows(self, root: Behaviour) -> bool:
        """Tell whether it still shows the tree: no child was added, removed or moved."""
        same = all(node.children == children for node, children in self._children)
        return root is self._root and same

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

    def source(self, node: Behaviour) -> Source:
        is_ours = type(node) in _TAGS
        if isinstance(node, ActionBehaviour):
            is_ours = node.named_action is not None
        return _tag(node), _attributes(node, _ARGUMENTS if is_ours else ())

    def take(self, node: Behaviour, element: Element) -> None:
        number = self.numbers.setdefault(node, len(self.numbers) + 1)
        element.attrib.update(name=node.name, _uid=str(number))
        if element.tag not in BUILT_IN:
            kind = "Condition" if is_plain(node) else "Action"
            if node.children:
                kind = "Decorator" if isinstance(node, Decorator) else "Control"
            self._kinds[element.get("ID", element.tag)] = kind
