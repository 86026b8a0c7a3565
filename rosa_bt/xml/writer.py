"""Writes trees as XML.

`export_xml` writes trees that can be read again exactly, and refuses others; a `NumberedTree` shows any tree.
"""

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import count
from math import inf
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Success
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator, FailureIsSuccess, Inverter, SuccessIsFailure

from rosa_bt.behaviours import ActionBehaviour, RosaAction
from rosa_bt.composites import DoUntilUnfeasible, SafeSwitch
from rosa_bt.decorators import ForAction, UntilSuccess
from rosa_bt.exceptions import ExportError, XmlError
from rosa_bt.xml.blackboard import ports_of
from rosa_bt.xml.nodes import Branch, Slot, XmlNode, is_plain
from rosa_bt.xml.reader import Document, SubTree, wrong_id
from rosa_bt.xml.registry import BUILT_IN, BehaviourRegistry, Entry

_SAME: Final[
    Mapping[type[Behaviour], tuple[str, ...]]
] = {  # of composites: the tag without memory, and with it
    Inverter: ("Inverter",),
    FailureIsSuccess: ("ForceSuccess",),
    SuccessIsFailure: ("ForceFailure",),
    Success: ("AlwaysSuccess",),
    Failure: ("AlwaysFailure",),
    Sequence: ("ReactiveSequence", "Sequence"),
    Selector: ("ReactiveFallback", "Fallback"),
}
_IDIOMS: Final = (ForAction, UntilSuccess, DoUntilUnfeasible, SafeSwitch)
MAIN: Final = "MainTree"
MOST_NODES: Final = 2**16 - 1
"""Most nodes of a NumberedTree: a number has 16 bits."""
_TYPES: Final = {int: "int", float: "double", bool: "bool", str: "std::string"}

_NAMES: Final = (
    "action",
    "preference",
    "wait",
    "timeout",
    "even_if_unfeasible",
    "exclusive",
    "halting_timeout",
    "during",
    "memory",
    "after",
)
"""Parameters of our behaviours that are written as attributes; the behaviours have attributes of these names."""
_UNSAID: Final = (None, False, inf, RosaAction.halting_timeout)


def _said(node: Behaviour, maker: Callable[..., Behaviour]) -> dict[str, str]:
    """Return the arguments of a behaviour of ours beside its name, as far as `maker` takes them."""
    names: Iterable[str] = _NAMES if type(node) in _IDIOMS else ()
    if isinstance(node, ActionBehaviour) and node.named_action is not None:
        taken = {*inspect.signature(maker).parameters, *node.input_ports()}
        names = ("action", *(name for name in _NAMES[1:] if name in taken))
    said = {name: getattr(node, name, None) for name in names}
    said = {name: ";".join(one) if isinstance(one, tuple) else one for name, one in said.items()}
    return {
        name: "true" if one is True else str(one)
        for name, one in said.items()
        if one not in _UNSAID
    }


def export_xml(
    behaviour: Behaviour, registry: BehaviourRegistry | None = None, *, models: bool = False
) -> str:
    """Write a tree as XML of BehaviorTree.CPP 4.

    It writes trees from `load_xml`, also changed ones, and trees of those behaviours of py_trees that mean exactly the
    same: Sequence and Selector (with and without memory), Inverter, FailureIsSuccess, SuccessIsFailure, Success,
    Failure, and leaves that need no arguments but a name, a knowledge base and the action. The idioms are written as
    the nodes that they consist of; ForAction, UntilSuccess, DoUntilUnfeasible and SafeSwitch are in every registry with
    a knowledge base. The contents of blackboards are not written.

    Args:
        behaviour: the root of the tree.
        registry: gives leaves that are not from a file their tags; without it, the tag is the name of the class.
        models: add a TreeNodesModel of all registered behaviours, with their ports, as Groot2 needs it.

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
        Document([text])
    except XmlError as error:
        raise ExportError(
            f"{behaviour.name!r} cannot be written so that it can be read again: {error}"
        ) from error
    return text


def _names(wanted: str) -> Iterator[str]:
    """Yield a name, and then what to use if it is taken: Dock, Dock_2, Dock_3."""
    yield wanted
    yield from (f"{wanted}_{number}" for number in count(2))


class _Writer:
    def __init__(self, registry: BehaviourRegistry | None) -> None:
        self._registry = registry
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self.conditions: dict[str, bool] = {}
        """Whether the written leaves are conditions, by tag."""

    def tree(self, subtree: SubTree | None, slot: Slot) -> str:
        """Write a tree; return its ID, which is a new one if the ID belongs to a tree with other content."""
        if subtree is not None:
            self.models.update({model.attrib["ID"]: model for model in subtree.models})
            slot = subtree.child
        content = self.element(slot)
        for name in _names(MAIN if subtree is None else subtree.tree):
            if tostring(self.trees.setdefault(name, content)) == tostring(content):
                break
        return name

    def element(self, slot: Slot) -> Element:
        node = slot.node
        if type(node) is Branch:
            return self.element(node.child)
        tag, attributes = slot.source or self._of_py_trees(slot)
        element = Element(tag, dict(attributes))
        self.conditions[attributes.get("ID", tag)] = (
            slot.is_condition if slot.source else is_plain(node)
        )
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
        node, maker = slot.node, type(slot.node)
        is_empty = maker in (Sequence, Selector) and not node.children
        is_same = maker in (*_SAME, *_IDIOMS) and not is_empty
        if not is_same and (node.children or is_empty or isinstance(node, XmlNode)):
            known = ", ".join(sorted(one.__name__ for one in _SAME))
            what = f"{maker.__name__} {node.name!r}{'' if node.children else ' without children'}"
            raise ExportError(
                f"{what} has no exact counterpart in BehaviorTree.CPP; of py_trees, written are {known}"
            )
        tag, said = (_tag_of(node), _said(node, maker)) if is_same else self._leaf(node)
        return tag, {"name": node.name, **said, **(slot.rules.written if slot.rules else {})}

    def _leaf(self, leaf: Behaviour) -> tuple[str, dict[str, str]]:
        kind = type(leaf)
        tag = kind.__name__ if self._registry is None else self._registry.name_of(leaf)
        if tag is None:
            raise ExportError(
                f"{kind.__name__} {leaf.name!r} is not registered; register its class"
            )
        if problem := wrong_id(tag):
            raise ExportError(
                f"{leaf.name!r} is registered under a name that is refused: {problem}"
            )
        if tag in BUILT_IN:
            raise ExportError(
                f"{tag!r} is a node of BehaviorTree.CPP itself; register the class under another name"
            )
        if isinstance(leaf, ActionBehaviour) and leaf.named_action is None:
            raise ExportError(f"{leaf.name!r} names no action; make it with one")
        maker = kind if self._registry is None else self._registry.entries[tag].factory
        if maker is kind:
            self._check_arguments(leaf)
        return tag, _said(leaf, maker)

    def _check_arguments(self, leaf: Behaviour) -> None:
        """Raise if the constructor has parameters that are neither written nor bound in the registry."""
        known = {
            "name",
            "behaviour_class_name",
            *({"kb"} if self._registry is None else self._registry.bound),
        }
        known |= (
            {name for name in _NAMES if hasattr(leaf, name)}
            if isinstance(leaf, ActionBehaviour)
            else set()
        )
        if not ports_of(leaf)[0].keys() <= known:
            raise ExportError(
                f"{leaf.name!r} has ports on py_trees' own blackboard, which cannot be written"
            )
        parameters = inspect.signature(type(leaf)).parameters.values()
        unknown = ", ".join(
            one.name for one in parameters if one.name not in known and one.kind not in (2, 4)
        )
        if unknown:
            raise ExportError(
                f"{type(leaf).__name__} {leaf.name!r} was made with {unknown}, which cannot be written; "
                "register a function under the name of the leaf that makes it, and hand the registry to export_xml"
            )


def slot_of(behaviour: Behaviour) -> Slot:
    parent = behaviour.parent
    if isinstance(parent, XmlNode):
        return next(slot for slot in parent.slots if slot.node is behaviour)
    return Slot(behaviour)


def slots_of(node: Behaviour) -> list[Slot]:
    """Return the slots of the children of a node."""
    return node.slots if isinstance(node, XmlNode) else [slot_of(child) for child in node.children]


def _tag_of(node: Behaviour) -> str:
    tags = _SAME.get(type(node), (type(node).__name__.lstrip("_"),))
    return tags[getattr(node, "memory", False) if len(tags) > 1 else 0]


def _model(tag: str, entry: Entry, is_condition: bool | None) -> Element:
    """Return the model of a registered behaviour for Groot2; `is_condition` is None if no leaf of it was written."""
    most = entry.children()[1]
    if is_condition is None and entry.made is not None:
        is_condition = is_plain(entry.made)
    leaf = (
        "Condition"
        if entry.kind == "condition" or (is_condition and entry.kind is None)
        else "Action"
    )
    element = Element(leaf if most == 0 else "Decorator" if most == 1 else "Control", ID=tag)
    known, outputs = ports_of(entry.made)
    for name, port in {**known, **entry.arguments}.items():
        direction = "output_port" if name in outputs else "input_port"
        said = {
            "type": _TYPES.get(port.data_type),
            "default": port.default_value if port.has_default else None,
        }
        SubElement(
            element,
            direction,
            {"name": name, **{key: str(one) for key, one in said.items() if one}},
        )
    return element


class NumberedTree:
    """A tree as XML with numbered nodes, for programs that watch it; make a new one when the tree has changed.

    Args:
        root: the root of any tree of py_trees.

    Attributes:
        xml: the text. The number of a node is its attribute `_uid`; each subtree is a `BehaviorTree` element of its
            own, with its place in `_fullpath`.
        numbers: the numbers by behaviour, from 1, in the order of the text.
        subtrees: the subtrees by the name of their blackboard; None for a tree that was not read from XML.

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
        self.subtrees[next(one for one in _names(path or tree) if one not in self.subtrees)] = (
            subtree
        )
        SubElement(self._whole, "BehaviorTree", ID=tree, _fullpath=path).append(
            self._element(slot, path)
        )

    def _element(self, slot: Slot, path: str) -> Element:
        node = slot.node
        if type(node) is Branch:
            return self._element(node.child, path)  # not in the file
        tag, attributes = slot.source or (_tag_of(node), _said(node, type(node)))
        number = self.numbers.setdefault(node, len(self.numbers) + 1)
        if number > MOST_NODES:
            raise ExportError(
                f"the tree has more than {MOST_NODES} nodes; their numbers have 16 bits"
            )
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
