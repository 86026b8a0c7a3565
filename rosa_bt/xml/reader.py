"""Makes behaviours of the elements of a file."""

import re
import time
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from pathlib import Path

from py_trees.behaviour import Behaviour

from rosa_bt.decorators import Clock, ClockFollower
from rosa_bt.exceptions import RosaBtError, XmlError, hint, in_words
from rosa_bt.xml.blackboard import Blackboard, Ports
from rosa_bt.xml.document import EXPLICIT, MARKS, MAX_DEPTH, MODELS, Document, Element
from rosa_bt.xml.nodes import MAX_NODES, NODES, RULES, Branch, Rules, Slot, is_plain
from rosa_bt.xml.registry import BehaviourRegistry, Entry
from rosa_bt.xml.values import BOOLS

_QUOTED = re.compile(r"""'[^']*'|"[^"]*\"""")
_OF_EDITORS = ("_autoremap", "_collapsed", "_description", "_fullpath", "_uid")
"""Attributes, in small letters, that are no rules of a node and that editors write."""
_SCRIPT_PORTS = {"Script": "code", "ScriptCondition": "code", "Precondition": "if"}


class SubTree(Branch, ClockFollower, is_node=False):
    """A tree of a file: below another tree, or as the root that is ticked.

    Attributes:
        blackboard: the blackboard of its nodes; a mapping.
        tree: the ID of the tree.
        models: the elements of the TreeNodesModels of the file, by ID.
        notes: what was read otherwise than it stands in the files; each was logged as a warning.
    """

    def __init__(
        self, name: str, slot: Slot, board: Blackboard, tree: str, document: Document
    ) -> None:
        super().__init__(name, [slot])
        self.blackboard = board
        self.tree = tree
        self.models = document.models
        self.notes = tuple(document.notes)

    def follow(self, clock: Clock) -> None:
        self.blackboard.root.follow(clock)


def load_xml(
    text_or_path: str | Path | Iterable[str | Path],
    registry: BehaviourRegistry,
    tree: str | None = None,
    *,
    clock: Clock | None = None,
    enums: Mapping[str, int] | None = None,
) -> SubTree:
    """Make a tree from the XML of BehaviorTree.CPP 4, with its semantics.

    Args:
        text_or_path: the XML as a text, or the path of a file; or several of these, whose trees use
            one another.
        registry: the behaviours for the leaves.
        tree: ID of the tree to make; without it, the `main_tree_to_execute` of the file, or its
            only tree.
        clock: gives the time [s] to Delay, Timeout and Sleep; without it, the clock of the
            `TreeRunner`, or of the knowledge base that the registry is bound to, or else the
            monotonic clock of this computer.
        enums: names that scripts can use, with their numbers, e.g. `{"RED": 1}`.

    Returns:
        A behaviour of py_trees. INVALID after a tick means that it was skipped.

    Raises:
        XmlError: the XML cannot be read, or the tree cannot be made; the message begins with file
            and line.
    """
    sources = [text_or_path] if isinstance(text_or_path, str | Path) else text_or_path
    document = Document(sources)
    for name, element in document.trees.items():
        if name in NODES or name in registry.entries or name == "SubTree":
            raise element.error(f"{name!r} is the name of a node; rename the tree")
    kb = registry.bound.get("kb")
    default = time.monotonic if kb is None else lambda: float(kb.now)
    board = Blackboard(clock or default, enums=enums)
    board.has_own_clock = clock is not None
    return _Builder(document, registry).tree(document.main(tree), document.root, None, board)


class _Builder:
    def __init__(self, document: Document, registry: BehaviourRegistry) -> None:
        self._document = document
        self._registry = registry
        self._count = 0
        self._depth = 0
        self._path: list[str] = []  # IDs of the trees around the node that is being made
        self._named: set[tuple[int, str | None]] = set()

    def tree(self, tree: str, asked_by: Element, name: str | None, board: Blackboard) -> SubTree:
        if tree in self._path:
            raise asked_by.error(f"a tree contains itself: {' -> '.join([*self._path, tree])}")
        self._path.append(tree)
        slot = self._slot(self._document.tree(tree, asked_by).children[0], board)
        self._path.pop()
        return SubTree(name or tree, slot, board, tree, self._document)

    def _slot(self, element: Element, board: Blackboard) -> Slot:
        self._count += 1
        self._depth += 1
        if self._count > MAX_NODES:
            raise element.error(f"the tree has more than {MAX_NODES} nodes, subtrees included")
        if self._depth > MAX_DEPTH:
            raise element.error(f"the tree is more than {MAX_DEPTH} levels deep, subtrees included")
        try:
            rules = self._rules(element)
            slot = self._made(element, board)
            if rules:
                slot.rules = Rules(board, rules)
        except XmlError:
            raise
        except Exception as error:  # constructors of the user may raise anything
            problem = str(error) if isinstance(error, RosaBtError) else in_words(error)
            raise element.error(f"<{element.node}> cannot be made: {problem}") from error
        self._depth -= 1
        slot.source = (element.tag, element.attrib)
        return slot

    def _made(self, element: Element, board: Blackboard) -> Slot:
        tag = element.node
        name = element.get("name") or tag
        entry = self._registry.entries.get(tag)
        if tag == "SubTree":
            return Slot(self._subtree(element, board))
        if entry is None and tag not in NODES:
            raise element.error(self._unknown(tag))
        if "ID" in element.attrib and element.tag not in MODELS:
            advice = "only <Action ID=...> and such have one; write name=..."
            raise element.error(f"<{element.tag}> has an ID; {advice}")
        _check_children(element, *(entry.children if entry else NODES[tag].CHILDREN))
        slots = [self._slot(child, board) for child in element.children]
        if entry is not None:
            branches = [Branch(slot.node.name, [slot]) for slot in slots]

            def note(text: str) -> None:
                self._document.note(element.where, text)

            node = entry.make(name, element.ports, branches, board, note)
            return Slot(node, not slots and self._is_condition(element, entry, node))
        built_in = NODES[tag](name, slots)
        ports = Ports(built_in.PORTS, element.ports, board)
        ports.check_required()
        built_in.prepare(ports)
        return Slot(built_in, is_plain(built_in))

    def _is_condition(self, element: Element, entry: Entry, leaf: Behaviour) -> bool:
        model = self._document.models.get(element.node, element)
        kinds = [entry.kind, *(tag.lower() for tag in (element.tag, model.tag) if tag in EXPLICIT)]
        stated = [kind for kind in kinds if kind]
        return stated[0] == "condition" if stated else is_plain(leaf)

    def _subtree(self, element: Element, around: Blackboard) -> SubTree:
        tree = element.needed("ID")
        _check_children(element, 0, 0)
        autoremap = element.get("_autoremap", "false")
        if autoremap not in BOOLS:
            raise element.error(f"_autoremap is true or false, not {autoremap!r}")
        name = element.get("name")
        if name and (id(around), name) in self._named:
            raise element.error(f"two SubTrees are named {name!r}; give one another name")
        self._named.add((id(around), name))
        defaults = {} if BOOLS[autoremap] else self._defaults(element, tree)
        ports = {**defaults, **element.ports}
        board = Blackboard(around.clock, around, ports, autoremap=BOOLS[autoremap])
        return self.tree(tree, element, name, board)

    def _defaults(self, element: Element, tree: str) -> dict[str, str]:
        model = self._document.models.get(tree, element)
        defaults = {}
        for port in model.children:
            if port.tag.endswith("_port"):  # editors write other elements, too
                name = port.needed("name")
                if default := port.get("default"):
                    defaults[name] = default
                elif name not in element.ports:
                    says = f"its model ({port.where}) says"
                    raise element.error(f"the tree {tree!r} needs {name}=..., {says}")
        return defaults

    def _unknown(self, tag: str) -> str:
        if tag in MARKS:
            return f'<{tag}> is of version 3; write BTCPP_format="3", or its name in version 4'
        if tag in self._document.trees:
            return f'<{tag}> is a tree; write <SubTree ID="{tag}"/>'
        near = get_close_matches(tag, [*NODES, "SubTree"], 1)
        guess = f"did you mean the node {near[0]!r}? " if near else ""
        known = hint(tag, self._registry.entries, "registered behaviours")
        return f"<{tag}> is unknown; {guess}{known}"

    def _rules(self, element: Element) -> dict[str, str]:
        """Return the rules of an element.

        Note attributes that look like rules, and double quotes.
        """
        rules = {}
        for name in list(element.attrib):
            if name in RULES or name == _SCRIPT_PORTS.get(element.node):
                self._convert_quotes(element, name)
            if name in RULES:
                rules[name] = element.attrib[name]
            elif name.startswith("_") and name.lower() not in _OF_EDITORS:
                (near,) = get_close_matches(name, (*RULES, "_autoremap"), 1, 0.0)
                if name == "__shared_blackboard":
                    near = "_autoremap"
                self._document.note(element.where, f"{name} means nothing; did you mean {near}?")
        return rules

    def _convert_quotes(self, element: Element, name: str) -> None:
        """Write the texts of a script in single quotes, as is wanted since 4.9."""
        before = element.attrib[name]
        after = _QUOTED.sub(_single_quoted, before)
        if after != before:
            element.set(name, after)
            self._document.note(element.where, f"{name}: texts stand in single quotes: {after}")


def _single_quoted(match: re.Match[str]) -> str:
    return match[0] if "'" in match[0] else f"'{match[0][1:-1]}'"


def _check_children(element: Element, least: int, most: int) -> None:
    tags = [child.node for child in element.children]
    if element.node == "ReactiveSequence" and tags.count("AsyncSequence") > 1:
        problem = "a ReactiveSequence has at most one asynchronous child; use Sequence in it"
        raise element.error(problem)
    if not least <= len(tags) <= most:
        numbers = {MAX_NODES: f"at least {least}", least: str(least)}
        number = numbers.get(most, f"{least} to {most}")
        advice = "; put a Sequence around them" if most == 1 and tags else ""
        raise element.error(f"children of <{element.node}>: {len(tags)}; it takes {number}{advice}")
