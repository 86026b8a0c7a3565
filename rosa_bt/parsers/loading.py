"""From elements to behaviours."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from py_trees.behaviour import Behaviour

from rosa_bt.exceptions import RosaBtError
from rosa_bt.parsers.blackboard import Blackboard, key_of
from rosa_bt.parsers.controls import CONTROLS
from rosa_bt.parsers.exceptions import XmlError, hint
from rosa_bt.parsers.leaves import LEAVES, Scripted, Sleep, XmlLeaf
from rosa_bt.parsers.making import make_registered
from rosa_bt.parsers.nav2 import NAV2
from rosa_bt.parsers.nodes import Branch, Control, OneChild, Rules, Slot, Source, is_plain
from rosa_bt.parsers.ports import Ports
from rosa_bt.parsers.reading import MAX_DEPTH, Document, Element, read_document
from rosa_bt.parsers.registry import BehaviourRegistry, Entry
from rosa_bt.parsers.scripts import Script, parse_script
from rosa_bt.parsers.wrappers import DECORATORS, Clock, Precondition, SubTree, Timed

__all__ = ["MAX_NODES", "load_xml"]

MAX_NODES: Final = 10_000
"""In one tree with all its subtrees."""

_NODES: Final[Mapping[str, type[Control] | type[OneChild]]] = {**CONTROLS, **NAV2, **DECORATORS}
_EXPLICIT: Final = ("Action", "Condition", "Control", "Decorator")
_OWN: Final = "it is BehaviorTree.CPP's, but not read here; register a behaviour of your own under another name"
_NOT_READ: Final = {
    "SubTreePlus": 'version 4 writes <SubTree ID="..." _autoremap="true"/> instead',
    **dict.fromkeys(("ConsumeQueue", "EntryUpdated", "LoopBool", "LoopDouble", "LoopInt", "LoopString"), _OWN),
    **dict.fromkeys(("ManualSelector", "SkipUnlessUpdated", "TestNode", "WaitValueUpdate", "WasEntryUpdated"), _OWN),
}
_ELSEWHERE: Final = ("_autoremap", "_description")
"""Attributes with an underscore that are no rules; editors write others, which mean nothing."""


def load_xml(
    text_or_path: str | Path,
    registry: BehaviourRegistry,
    tree: str | None = None,
    *,
    clock: Clock | None = None,
) -> SubTree:
    """Make a tree that is written in the XML of BehaviorTree.CPP 4, with its semantics.

    Args:
        text_or_path: the XML itself, or the file that it is in.
        registry: the behaviours that the leaves are.
        tree: ID of the tree to make; without it, the file's `main_tree_to_execute`, or its only one.
        clock: gives the time [s] to Delay, Timeout and Sleep; without it, the clock of the knowledge base that the
            registry is bound to, or else the monotonic one of this computer.

    Returns:
        A py_trees behaviour, to be ticked like any other. INVALID after a tick means that it was skipped.

    Raises:
        XmlError: the file cannot be read, or a tree not be made of it; the message begins with file and line.
    """
    document = read_document(text_or_path)
    builder = _Builder(document, registry, clock or _clock_of(registry))
    return builder.tree(document.main(tree), document.root, None, _Place(Blackboard()))


def _clock_of(registry: BehaviourRegistry) -> Clock:
    kb = registry.bound.get("kb")
    return time.monotonic if kb is None else lambda: float(kb.now)


@dataclass(frozen=True)
class _Place:
    """Where a node is: what it reads and writes, in which trees, and how deep."""

    board: Blackboard
    trees: tuple[str, ...] = ()
    depth: int = 0


class _Builder:
    def __init__(self, document: Document, registry: BehaviourRegistry, clock: Clock) -> None:
        self._document = document
        self._registry = registry
        self._clock = clock
        self._count = 0

    def tree(self, tree: str, asked_by: Element, name: str | None, place: _Place) -> SubTree:
        """Make a tree with all that is in it."""
        if tree in place.trees:
            raise XmlError(asked_by.where, f"a tree is in itself: {' -> '.join([*place.trees, tree])}")
        element = self._document.tree(tree, asked_by)
        if len(element.children) != 1:
            raise XmlError(element.where, f"a tree has one child, not {len(element.children)}; put a Sequence around")
        slot = self._slot(element.children[0], replace(place, trees=(*place.trees, tree)))
        return SubTree(name or tree, slot, place.board, tree, tuple(self._document.models.values()))

    def _slot(self, element: Element, place: _Place) -> Slot:
        self._count += 1
        if self._count > MAX_NODES:
            raise XmlError(element.where, f"the tree has more than {MAX_NODES} nodes, subtrees included")
        if place.depth >= MAX_DEPTH:
            raise XmlError(element.where, f"the tree is more than {MAX_DEPTH} levels deep, subtrees included")
        try:
            rules = _rules(element, place.board)
            node, is_condition = self._node(element, replace(place, depth=place.depth + 1))
        except XmlError:
            raise
        except Exception as error:  # whatever behaviours of the user raise when they are made
            told = str(error) if isinstance(error, RosaBtError) else f"{type(error).__name__}: {error}"
            raise XmlError(element.where, f"<{_tag(element)}> cannot be made: {told}") from error
        return Slot(node, is_condition, Source(element.tag, element.attributes), rules)

    def _node(self, element: Element, place: _Place) -> tuple[Behaviour, bool]:
        """Return the node, and whether it is a condition."""
        tag, written = _tag(element), _written(element)
        name = element.attributes.get("name") or tag
        if tag == "SubTree":
            return self._subtree(element, written, place), False
        if tag in self._registry:
            return self._registered(element, tag, name, place)
        if tag in LEAVES:
            _check_children(element, 0, 0)
            leaf = self._leaf(LEAVES[tag], name, _ports(LEAVES[tag], written, place), place)
            return leaf, not isinstance(leaf, Sleep)
        kind = _NODES.get(tag)
        if kind is None:
            raise XmlError(element.where, self._unknown(tag))
        _check_children(element, *kind.CHILDREN)
        _check_reactive(element, tag)
        ports = _ports(kind, written, place)
        node = kind(name, [self._slot(child, place) for child in element.children], ports)
        if isinstance(node, Timed):
            node.clock = self._clock
        if isinstance(node, Precondition):
            node.blackboard, node.condition = place.board, _script(ports, "if")
        return node, False

    def _leaf(self, kind: type[XmlLeaf], name: str, ports: Ports, place: _Place) -> XmlLeaf:
        leaf = kind(name, ports, place.board)
        if isinstance(leaf, Scripted):
            leaf.script = _script(ports, "code")
        if isinstance(leaf, Sleep):
            leaf.clock = self._clock
        return leaf

    def _registered(self, element: Element, tag: str, name: str, place: _Place) -> tuple[Behaviour, bool]:
        entry = self._registry[tag]
        _check_children(element, *entry.children())
        slots = [self._slot(child, place) for child in element.children]
        branches = [Branch(slot.node.name, slot, place.board) for slot in slots]
        node = make_registered(entry, name, _written(element), place.board, branches)
        return node, not slots and self._is_condition(entry, element, tag, node)

    def _is_condition(self, entry: Entry, element: Element, tag: str, leaf: Behaviour) -> bool:
        if entry.kind is not None:
            return entry.kind == "condition"
        model = self._document.models.get(tag)
        said = element.tag if element.tag in _EXPLICIT else model.tag if model is not None else ""
        return said == "Condition" or (said != "Action" and is_plain(leaf))

    def _subtree(self, element: Element, written: dict[str, str], place: _Place) -> SubTree:
        tree = element.get("ID")
        _check_children(element, 0, 0)
        autoremap = element.attributes.get("_autoremap", "false").lower()
        if autoremap not in ("true", "false", "1", "0"):
            raise XmlError(element.where, f"_autoremap is true or false, not {autoremap!r}")
        written = {**self._defaults(element, tree, written), **written}
        keys = {name: key for name, text in written.items() if (key := key_of(text, name)) is not None}
        constants = {name: text for name, text in written.items() if name not in keys}
        board = Blackboard(place.board, keys, constants, autoremap=autoremap in ("true", "1"))
        return self.tree(tree, element, element.attributes.get("name"), replace(place, board=board))

    def _defaults(self, element: Element, tree: str, written: Mapping[str, str]) -> dict[str, str]:
        """Return what the model of a tree says of ports that are not written."""
        model = self._document.models.get(tree)
        found = {}
        for port in model.children if model is not None and model.tag == "SubTree" else ():
            if port.tag not in ("input_port", "output_port", "inout_port"):  # editors write other things, too
                continue
            name = port.get("name")
            if "default" in port.attributes:
                found[name] = port.attributes["default"]
            elif name not in written:
                raise XmlError(element.where, f"the tree {tree!r} needs {name}=..., its model ({port.where}) says")
        return found

    def _unknown(self, tag: str) -> str:
        if tag in _NOT_READ:
            return f"<{tag}> is not read: {_NOT_READ[tag]}"
        if tag in self._document.trees:
            return f'<{tag}> is a tree; write <SubTree ID="{tag}"/>'
        own = hint(tag, [*_NODES, *LEAVES, "SubTree"], "nodes")
        guess = f"did you mean the node {own.split('?')[0].removeprefix('did you mean ')}? " if "?" in own else ""
        return f"<{tag}> is unknown; {guess}{hint(tag, self._registry, 'registered behaviours')}"


def _tag(element: Element) -> str:
    return element.get("ID") if element.tag in _EXPLICIT else element.tag


def _written(element: Element) -> dict[str, str]:
    """Return the attributes that are ports."""
    own = ("name", "ID")
    return {key: text for key, text in element.attributes.items() if key not in own and not key.startswith("_")}


def _ports(kind: type[Control] | type[OneChild] | type[XmlLeaf], written: Mapping[str, str], place: _Place) -> Ports:
    ports = Ports(kind.PORTS, written, place.board)
    ports.check_required()
    return ports


def _script(ports: Ports, name: str) -> Script:
    return parse_script(str(ports.get(name)))


def _rules(element: Element, board: Blackboard) -> Rules | None:
    scripts = {}
    for name, text in element.attributes.items():
        if name in Rules.NAMES:
            scripts[name] = parse_script(text)
        elif name == "__shared_blackboard":
            raise XmlError(element.where, f"{name} is of version 3; write _autoremap in the SubTree")
        elif name.startswith("_") and name not in _ELSEWHERE:
            guess = hint(name, (*Rules.NAMES, *_ELSEWHERE), "known")
            if guess.startswith("did you mean"):
                raise XmlError(element.where, f"<{element.tag}> has an attribute {name!r}; {guess}")
    return Rules(board, scripts) if scripts else None


def _check_children(element: Element, least: int, most: int) -> None:
    count = len(element.children)
    if least <= count <= most:
        return
    wanted = f"{least}" if least == most else f"at least {least}" if most >= MAX_NODES else f"{least} to {most}"
    advice = "; put a Sequence around them" if most == 1 and count > 1 else ""
    raise XmlError(
        element.where,
        f"<{_tag(element)}> has {count} {'child' if count == 1 else 'children'}; it takes {wanted}{advice}",
    )


def _check_reactive(element: Element, tag: str) -> None:
    several = [child for child in element.children if _tag(child) == "AsyncSequence"]
    if tag == "ReactiveSequence" and len(several) > 1:
        raise XmlError(several[1].where, "a ReactiveSequence has at most one asynchronous child; use Sequence in it")
