"""Writes trees as XML.

`export_xml` writes trees that can be read again exactly, and refuses others; a `NumberedTree` shows any.
"""

import inspect
from collections.abc import Callable, Mapping
from itertools import count
from math import inf
from typing import Any, Final
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
from rosa_bt.xml.nodes import Branch, Slot, XmlNode, is_plain
from rosa_bt.xml.reader import Document, SubTree, wrong_id
from rosa_bt.xml.registry import BUILT_IN, BehaviourRegistry, Entry

_SAME: Final[Mapping[type[Behaviour], tuple[str, ...]]] = {
    Inverter: ("Inverter",),
    FailureIsSuccess: ("ForceSuccess",),
    SuccessIsFailure: ("ForceFailure",),
    Success: ("AlwaysSuccess",),
    Failure: ("AlwaysFailure",),
    Sequence: ("ReactiveSequence", "Sequence"),
    Selector: ("ReactiveFallback", "Fallback"),
    Timer: ("Sleep",),
    Timeout: ("Timeout",),
    Delay: ("Delay",),
}
"""The tags of behaviours that mean exactly the same; of composites without memory, and with it."""
_DURATIONS: Final = {Timer: "msec", Timeout: "msec", Delay: "delay_msec"}
_IDIOMS: Final = (ForAction, UntilSuccess, DoUntilUnfeasible, SafeSwitch, Retry)
MAIN: Final = "MainTree"
MOST_NODES: Final = 2**16 - 1
"""Most nodes of a NumberedTree: a number has 16 bits."""
_TYPES: Final = {int: "int", float: "double", bool: "bool", str: "std::string"}

_ARGUMENTS: Final = (
    *("action", "preference", "wait", "timeout", "even_if_unfeasible", "exclusive"),
    *("halting_timeout", "during", "memory", "after", "num_failures", "pause"),
)
"""Parameters of our behaviours that are attributes, of the element as of the behaviour."""
_DEFAULTS: Final = (None, False, inf, RosaAction.halting_timeout)


def _attributes(node: Behaviour, maker: Callable[..., Behaviour]) -> dict[str, str]:
    """Return the arguments of a behaviour of ours beside its name, as far as `maker` takes them."""
    kind = type(node)
    if kind in _DURATIONS:
        milliseconds = node.duration * 1000  # type: ignore[attr-defined]  # all three have it
        return {_DURATIONS[kind]: f"{milliseconds:.12g}"}
    names: tuple[str, ...] = _ARGUMENTS if kind in _IDIOMS else ()
    if isinstance(node, ActionBehaviour) and node.named_action is not None:
        taken = {"action", *inspect.signature(maker).parameters, *node.input_ports()}
        names = tuple(name for name in _ARGUMENTS if name in taken)
    attributes = {}
    for name in names:
        value: Any = getattr(node, name, None)
        if value not in _DEFAULTS:
            text = ";".join(value) if isinstance(value, tuple) else str(value)
            attributes[name] = "true" if value is True else text
    return attributes


def export_xml(
    behaviour: Behaviour, registry: BehaviourRegistry | None = None, *, models: bool = False
) -> str:
    """Write a tree as XML of BehaviorTree.CPP 4.

    It writes trees from `load_xml`, also changed ones, and trees of behaviours that mean exactly the
    same: Sequence and Selector (with and without memory), Inverter, FailureIsSuccess,
    SuccessIsFailure, Success, Failure, our Timer, Timeout and Delay, and leaves that need no arguments
    but a name, a knowledge base and the action. The idioms are written as the nodes that they consist
    of; ForAction, UntilSuccess, Retry, DoUntilUnfeasible and SafeSwitch are in every registry with a
    knowledge base. The contents of blackboards are not written.

    Args:
        behaviour: the root of the tree.
        registry: gives leaves that are not from a file their tags; without it, the name of the class.
        models: add a TreeNodesModel of all registered behaviours, with their ports, for Groot2.

    Raises:
        ExportError: a behaviour has no exact counterpart; the message names it.
    """
    writer = _Writer(registry)
    main = writer.tree(behaviour if isinstance(behaviour, SubTree) else None, slot_of(behaviour))
    root = Element("root", BTCPP_format="4", main_tree_to_execute=main)
    for name, content in sorted(writer.trees.items(), key=lambda tree: tree[0] != main):
        SubElement(root, "BehaviorTree", ID=name).append(content)
    for tag, entry in registry.entries.items() if registry is not None and models else ():
        if tag not in writer.models:
            writer.models[tag] = _model(tag, entry, writer.conditions.get(tag))
    if writer.models:
        SubElement(root, "TreeNodesModel").extend(writer.models.values())
    indent(root)
    text = tostring(root, encoding="unicode") + "\n"
    try:
        notes = Document([text]).notes
    except XmlError as error:
        notes = [str(error)]
    if notes:
        raise ExportError(
            f"{behaviour.name!r} cannot be written so that it can be read again: {notes[0]}"
        )
    return text


def _free_name(name: str, taken: Callable[[str], bool]) -> str:
    """Return a name, or the first of Dock_2, Dock_3, ... that is not taken."""
    names = (f"{name}_{number}" for number in count(2))
    while taken(name):
        name = next(names)
    return name


class _Writer:
    def __init__(self, registry: BehaviourRegistry | None) -> None:
        self._registry = registry
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self.conditions: dict[str, bool] = {}
        """Whether the written leaves are conditions, by tag."""

    def tree(self, subtree: SubTree | None, slot: Slot) -> str:
        """Write a tree; return its ID, which is new if its own belongs to a tree with other content."""
        if subtree is not None:
            self.models.update({model.attrib["ID"]: model for model in subtree.models})
            slot = subtree.child
        content = self.element(slot)
        text = tostring(content)

        def is_taken(name: str) -> bool:
            return name in self.trees and tostring(self.trees[name]) != text

        name = _free_name(MAIN if subtree is None else subtree.tree, is_taken)
        self.trees.setdefault(name, content)
        return name

    def element(self, slot: Slot) -> Element:
        node = slot.node
        if type(node) is Branch:
            return self.element(node.child)
        tag, attributes = slot.source or self._of_py_trees(slot)
        element = Element(tag, dict(attributes))
        is_condition = slot.is_condition if slot.source else is_plain(node)
        self.conditions[attributes.get("ID", tag)] = is_condition
        if isinstance(node, SubTree):
            if tag == "SubTree":
                element.set("ID", self.tree(node, slot))
            return element
        written = slots_of(node)  # a decorator of the user may have more children than in the file
        if slot.source is not None and not isinstance(node, XmlNode):
            written = [child for child in written if type(child.node) is Branch]
        element.extend([self.element(child) for child in written])
        return element

    def _of_py_trees(self, slot: Slot) -> tuple[str, dict[str, str]]:
        """Return tag and attributes of a behaviour that is not from a file."""
        node = slot.node
        kind = type(node)
        is_empty = kind in (Sequence, Selector) and not node.children
        if kind in (*_SAME, *_IDIOMS) and not is_empty:
            tag, attributes = tag_of(node), _attributes(node, kind)
            if kind in _DURATIONS and not attributes[_DURATIONS[kind]].isdigit():
                raise ExportError(
                    f"{node.name!r} does not take whole milliseconds, as XML has them"
                )
        elif node.children or is_empty or isinstance(node, XmlNode):
            written = ", ".join(sorted(same.__name__ for same in _SAME))
            what = f"{kind.__name__} {node.name!r}{'' if node.children else ' without children'}"
            raise ExportError(
                f"{what} has no exact counterpart in BehaviorTree.CPP; written are {written}"
            )
        else:
            tag, attributes = self._leaf(node)
        rules = slot.rules.written if slot.rules else {}
        return tag, {"name": node.name, **attributes, **rules}

    def _leaf(self, leaf: Behaviour) -> tuple[str, dict[str, str]]:
        kind = type(leaf)
        tag = kind.__name__ if self._registry is None else self._registry.name_of(leaf)
        if tag is None:
            problem = f"{kind.__name__} {leaf.name!r} is not registered; register its class"
        elif wrong := wrong_id(tag):
            problem = f"{leaf.name!r} is registered under a name that is refused: {wrong}"
        elif tag in BUILT_IN:
            problem = f"{tag!r} is a node of BehaviorTree.CPP itself; register another name"
        elif isinstance(leaf, ActionBehaviour) and leaf.named_action is None:
            problem = f"{leaf.name!r} names no action; make it with one"
        else:
            maker = kind if self._registry is None else self._registry.entries[tag].factory
            if maker is kind:
                self._check_arguments(leaf)
            return tag, _attributes(leaf, maker)
        raise ExportError(problem)

    def _check_arguments(self, leaf: Behaviour) -> None:
        """Raise if the constructor has parameters that are neither written nor bound."""
        bound = {"kb"} if self._registry is None else {*self._registry.bound}
        writable = {"name", "behaviour_class_name", *bound}
        if isinstance(leaf, ActionBehaviour):
            writable |= {name for name in _ARGUMENTS if hasattr(leaf, name)}
        if not ports_of(leaf)[0].keys() <= writable:
            raise ExportError(
                f"{leaf.name!r} has ports on py_trees' own blackboard, which cannot be written"
            )
        unknown = [
            parameter.name
            for parameter in inspect.signature(type(leaf)).parameters.values()
            if parameter.name not in writable and parameter.kind not in (2, 4)
        ]
        if unknown:
            kind = type(leaf).__name__
            raise ExportError(
                f"{kind} {leaf.name!r} was made with {', '.join(unknown)}, which cannot be written; "
                "register a function under the name of the leaf that makes it, and hand the registry "
                "to export_xml"
            )


def slot_of(behaviour: Behaviour) -> Slot:
    parent = behaviour.parent
    if isinstance(parent, XmlNode):
        return next(slot for slot in parent.slots if slot.node is behaviour)
    return Slot(behaviour)


def slots_of(node: Behaviour) -> list[Slot]:
    """Return the slots of the children of a node."""
    return node.slots if isinstance(node, XmlNode) else [slot_of(child) for child in node.children]


def tag_of(node: Behaviour) -> str:
    """Return the tag of a behaviour of py_trees."""
    tags = _SAME.get(type(node), (type(node).__name__.lstrip("_"),))
    return tags[-1] if getattr(node, "memory", False) else tags[0]


def _model(tag: str, entry: Entry, is_condition: bool | None) -> Element:
    """Return the model of a registered behaviour; `is_condition` is None if no leaf was written."""
    most = entry.children()[1]
    if is_condition is None and entry.made is not None:
        is_condition = is_plain(entry.made)
    is_asked = entry.kind == "condition" or (is_condition and entry.kind is None)
    kinds = {0: "Condition" if is_asked else "Action", 1: "Decorator"}
    element = Element(kinds.get(most, "Control"), ID=tag)
    ports, outputs = ports_of(entry.made)
    for name, port in {**ports, **entry.arguments}.items():
        facts = {
            "name": name,
            "type": _TYPES.get(port.data_type),
            "default": port.default_value if port.has_default else None,
        }
        direction = "output_port" if name in outputs else "input_port"
        SubElement(element, direction, {key: str(fact) for key, fact in facts.items() if fact})
    return element


class NumberedTree:
    """A tree as XML with numbered nodes, for programs that watch it; make a new one when it changed.

    Args:
        root: the root of any tree of py_trees.

    Attributes:
        xml: the text. The number of a node is its attribute `_uid`; each subtree is a `BehaviorTree`
            element of its own, with its place in `_fullpath`.
        numbers: the numbers by behaviour, from 1, in the order of the text.
        subtrees: the subtrees by the name of their blackboard; None for one that is not from XML.

    Raises:
        ExportError: the tree has more than 65,535 nodes.
    """

    def __init__(self, root: Behaviour) -> None:
        self._root = root
        self._children = [(node, list(node.children)) for node in root.iterate() if node.children]
        self.numbers: dict[Behaviour, int] = {}
        self.subtrees: dict[str, SubTree | None] = {}
        self._kinds: dict[str, str] = {}
        subtree = root if isinstance(root, SubTree) else None
        main = MAIN if subtree is None else subtree.tree
        self._whole = Element("root", BTCPP_format="4", main_tree_to_execute=main)
        self._tree(main, "", slot_of(root) if subtree is None else subtree.child, subtree)
        models = SubElement(self._whole, "TreeNodesModel")
        for tag, kind in sorted(self._kinds.items()):
            SubElement(models, kind, ID=tag)
        self.xml: Final = tostring(self._whole, encoding="unicode")

    def shows(self, root: Behaviour) -> bool:
        """Tell whether it still shows the tree below `root`: no child was added, removed or moved."""
        return root is self._root and all(
            node.children == children for node, children in self._children
        )

    def _tree(self, tree: str, path: str, slot: Slot, subtree: SubTree | None) -> None:
        self.subtrees[_free_name(path or tree, self.subtrees.__contains__)] = subtree
        element = SubElement(self._whole, "BehaviorTree", ID=tree, _fullpath=path)
        element.append(self._element(slot, path))

    def _element(self, slot: Slot, path: str) -> Element:
        node = slot.node
        if type(node) is Branch:
            return self._element(node.child, path)  # not in the file
        tag, attributes = slot.source or (tag_of(node), _attributes(node, type(node)))
        number = self.numbers.setdefault(node, len(self.numbers) + 1)
        if number > MOST_NODES:
            raise ExportError(f"the tree has more than {MOST_NODES} nodes, with numbers of 16 bits")
        element = Element(tag, {**attributes, "name": node.name, "_uid": str(number)})
        if isinstance(node, SubTree):
            element.set("ID", node.tree)
            self._tree(node.tree, f"{path}/{node.name}" if path else node.name, node.child, node)
            return element
        if tag not in BUILT_IN:
            self._kinds[attributes.get("ID", tag)] = _kind_of(node)
        element.extend([self._element(child, path) for child in slots_of(node)])
        return element


def _kind_of(node: Behaviour) -> str:
    if isinstance(node, Decorator):
        return "Decorator"
    if isinstance(node, Composite) or node.children:
        return "Control"
    return "Condition" if is_plain(node) else "Action"
