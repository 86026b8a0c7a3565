"""A tree as other programs watch it: as XML of BehaviorTree.CPP 4 in which each node has a number of its own.

`export_xml` writes what can be read again, exactly, and refuses the rest; this shows any tree of py_trees.
"""

from typing import Final
from xml.etree.ElementTree import Element, SubElement, tostring

from py_trees.behaviour import Behaviour
from py_trees.composites import Composite, Selector, Sequence
from py_trees.decorators import Decorator

from rosa_bt.behaviours import ActionBehaviour
from rosa_bt.exceptions import ExportError
from rosa_bt.xml.nodes import Branch, Slot, XmlNode, is_plain
from rosa_bt.xml.reader import SubTree
from rosa_bt.xml.registry import BUILT_IN
from rosa_bt.xml.writer import BY_MEMORY, SAME, slot_of

MAIN: Final = "MainTree"
MOST_NODES: Final = 2**16 - 1
"""A number has 16 bits."""


class NumberedTree:
    """What a tree consists of at this moment; made anew when it has changed.

    Args:
        root: of any tree of py_trees.

    Attributes:
        xml: the text. Each node has its number as `_uid`; each tree in a tree is a `BehaviorTree` of its own, whose
            place is its `_fullpath`.
        numbers: by behaviour, from 1, in the order in which they are written.
        subtrees: by the name under which their blackboards are asked for; None for a tree that was not read from XML.

    Raises:
        ExportError: it has more nodes than there are numbers.
    """

    def __init__(self, root: Behaviour) -> None:
        self._root = root
        self._children = [(node, list(node.children)) for node in root.iterate() if node.children]
        self.numbers: dict[Behaviour, int] = {}
        self.subtrees: dict[str, SubTree | None] = {}
        self._trees: list[Element] = []
        self._kinds: dict[str, str] = {}
        whole = Element("root", BTCPP_format="4")
        if isinstance(root, SubTree):
            whole.set("main_tree_to_execute", root.tree)
            self._tree(root, "")
        else:
            whole.set("main_tree_to_execute", MAIN)
            self.subtrees[MAIN] = None
            tree = self._begin(MAIN, "")
            tree.append(self._element(slot_of(root), ""))
        whole.extend(self._trees)
        models = SubElement(whole, "TreeNodesModel")
        for tag, kind in sorted(self._kinds.items()):
            SubElement(models, kind, ID=tag)
        self.xml: Final = tostring(whole, encoding="unicode")

    def shows(self, root: Behaviour) -> bool:
        """Tell whether it still shows the tree below that root: no child has come, gone or moved."""
        return root is self._root and all(node.children == children for node, children in self._children)

    def _begin(self, name: str, path: str) -> Element:
        tree = Element("BehaviorTree", ID=name, _fullpath=path)
        self._trees.append(tree)
        return tree

    def _tree(self, subtree: SubTree, path: str) -> None:
        name, number = path or subtree.tree, 1
        while name in self.subtrees:
            number += 1
            name = f"{path or subtree.tree}_{number}"
        self.subtrees[name] = subtree
        self._begin(subtree.tree, path).append(self._element(subtree.child, path))

    def _element(self, slot: Slot, path: str) -> Element:
        node = slot.node
        if isinstance(node, Branch) and not isinstance(node, SubTree):
            return self._element(node.child, path)  # it is there for py_trees only
        tag, attributes = slot.source or (_tag_of(node), {})
        element = Element(tag, {**attributes, "name": node.name, "_uid": str(self._number(node))})
        if isinstance(node, ActionBehaviour) and node.port_arguments["action"] is not None:
            element.set("action", node.action)
        if isinstance(node, SubTree):
            element.set("ID", node.tree)
            self._tree(node, f"{path}/{node.name}" if path else node.name)
            return element
        if tag not in BUILT_IN:
            self._kinds[attributes.get("ID", tag)] = _kind_of(node)
        slots = node.slots if isinstance(node, XmlNode) else [slot_of(child) for child in node.children]
        element.extend([self._element(child, path) for child in slots])
        return element

    def _number(self, node: Behaviour) -> int:
        number = len(self.numbers) + 1
        if number > MOST_NODES:
            raise ExportError(f"the tree has more than {MOST_NODES} nodes; their numbers have 16 bits")
        return self.numbers.setdefault(node, number)


def _tag_of(node: Behaviour) -> str:
    if isinstance(node, Sequence | Selector) and type(node) in BY_MEMORY:
        return BY_MEMORY[type(node)][node.memory]
    return SAME.get(type(node), type(node).__name__.lstrip("_"))


def _kind_of(node: Behaviour) -> str:
    if isinstance(node, Decorator):
        return "Decorator"
    if isinstance(node, Composite) or node.children:
        return "Control"
    return "Condition" if is_plain(node) else "Action"
