"""Reads files of trees, and makes behaviours of their elements."""

import logging
import os
import re
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from difflib import get_close_matches
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from rosa_bt.decorators import Clock, ClockFollower
from rosa_bt.exceptions import RosaBtError, XmlError, hint, in_words
from rosa_bt.xml.blackboard import BOOLS, Blackboard, Ports, key_of
from rosa_bt.xml.controls import NODES
from rosa_bt.xml.elements import EXPLICIT, MAX_DEPTH, Element, parse, read_file
from rosa_bt.xml.nodes import MAX_NODES, Branch, Rules, Slot, is_plain
from rosa_bt.xml.registry import BehaviourRegistry, Entry
from rosa_bt.xml.scripts import parse_script
from rosa_bt.xml.version_3 import MARKS, convert, is_version_3

_log = logging.getLogger(__name__)
_FORBIDDEN: Final = re.compile(r"[\s./\\:*?|<>&\"'\x00-\x1f]")
_QUOTED: Final = re.compile(r"""'[^']*'|"[^"]*\"""")
_MODELS: Final = (*EXPLICIT, "SubTree")
_OF_EDITORS: Final = ("_autoremap", "_collapsed", "_description", "_fullpath", "_uid")
"""Attributes, in small letters, that are no rules of a node and that editors write."""
_SCRIPT_PORTS: Final = {
    "Script": ("code",),
    "ScriptCondition": ("code",),
    "Precondition": ("if",),
}


class Document:
    """The trees and models that are defined in files, or texts, and in the files that they include.

    Attributes:
        root: the outermost element of the file; of several files, of the one that names the main tree.
        trees: the `BehaviorTree` elements, by ID.
        models: the elements of the TreeNodesModels, by ID.
        notes: what was read otherwise than it stands, or means nothing.

    Raises:
        XmlError: a file is not of BehaviorTree.CPP, or exceeds a limit.
    """

    def __init__(self, sources: Iterable[str | Path]) -> None:
        self.notes: list[str] = []
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self._files: dict[Path, Element] = {}
        roots = [self._open(source) for source in sources]
        if not roots:
            raise XmlError("<text>", "there is no text and no file; give at least one")
        self.root = next((one for one in roots if "main_tree_to_execute" in one.attrib), roots[0])

    def _open(self, text_or_path: str | Path) -> Element:
        if not isinstance(text_or_path, str | Path):
            raise XmlError(
                "<text>",
                f"a tree is given as XML text or as the path of a file, not as {text_or_path!r}",
            )
        text = text_or_path.lstrip("\ufeff \t\r\n") if isinstance(text_or_path, str) else "a path"
        if not text:
            raise XmlError(
                "<text>", "the text is empty; give the XML itself, or the path of a file"
            )
        if not text.startswith("<"):
            return self._file(Path(text_or_path), str(text_or_path), [])
        return self._collect(parse(text, "<text>", self.note), Path.cwd(), [])

    def note(self, where: str, text: str) -> None:
        """Log a warning, and keep it."""
        self.notes.append(f"{where}: {text}")
        _log.warning("%s: %s", where, text)

    def _file(self, path: Path, where: str, chain: list[Path]) -> Element:
        """Return the outermost element of a file; a file is read once, even if it is included several times."""
        real = path
        with suppress(ValueError):  # no file can have this name; reading it reports that
            real = Path(os.path.realpath(path))  # Path.resolve raises if links form a circle
        if real in chain:
            circle = " -> ".join(one.name for one in [*chain[chain.index(real) :], real])
            raise XmlError(where, f"files include each other: {circle}")
        if len(chain) > MAX_DEPTH:
            raise XmlError(where, f"more than {MAX_DEPTH} files include each other in a row")
        if real not in self._files:
            self._files[real] = self._collect(
                parse(read_file(path, where), str(path), self.note), path.parent, [*chain, real]
            )
        return self._files[real]

    def main(self, wanted: str | None) -> str:
        """Return the ID of the tree to make: the wanted one, or the main tree of the file, or the only one."""
        chosen = wanted or self.root.get("main_tree_to_execute")
        if chosen is not None:
            self.tree(chosen, self.root)
            return chosen
        if len(self.trees) != 1:
            known = ", ".join(self.trees) or "none"
            advice = "say load_xml(..., tree=...) or write main_tree_to_execute in <root>"
            raise self.root.error(f"which tree? There are: {known}; {advice}")
        return next(iter(self.trees))

    def tree(self, name: str, asked_by: Element) -> Element:
        if name not in self.trees:
            raise asked_by.error(f"no tree has the ID {name!r}; {hint(name, self.trees, 'trees')}")
        return self.trees[name]

    def _collect(self, root: Element, folder: Path, chain: list[Path]) -> Element:
        """Add what a file defines and includes; return `root`, its outermost element."""
        if root.tag != "root":
            raise root.error(f"the outermost element is <root>, not <{root.tag}>")
        self._check_version(root)
        tags = [one.tag for one in root.children]
        for place, element in enumerate(root.children):
            if element.tag == "BehaviorTree":
                if len(element) != 1:
                    raise element.error(
                        f"a tree has one child, not {len(element)}; put a Sequence around"
                    )
                is_unnamed = tags.count("BehaviorTree") == 1 and "ID" not in element.attrib
                self._add(
                    self.trees, "BehaviorTree" if is_unnamed else element.needed("ID"), element
                )
            elif element.tag == "TreeNodesModel":
                if "TreeNodesModel" in tags[:place]:
                    raise element.error(
                        "a file has one TreeNodesModel; put its elements into the first"
                    )
                for model in element.children:
                    self._add_model(model)
            elif element.tag == "include":
                self._include(element, folder, chain)
            else:
                self.note(element.where, f"<{element.tag}> means nothing in <root>")
        return root

    def _check_version(self, root: Element) -> None:
        version = root.get("BTCPP_format")
        if is_version_3(root):
            if version is None:
                self.note(
                    root.where, "it has no BTCPP_format; read as version 3, whose nodes it has"
                )
            trees = [tree.get("ID", "") for tree in root.children if tree.tag == "BehaviorTree"]
            convert(root, trees, self.note)
        elif version is None:
            self.note(
                root.where, 'it has no BTCPP_format; read as version 4: write BTCPP_format="4"'
            )
            for element in root.iter("SubTree"):
                self._note_texts(element)  # type: ignore[arg-type]  # all are of this class
        elif version != "4":
            self.note(root.where, f"it has BTCPP_format {version!r}; read as version 4")

    def _note_texts(self, element: Element) -> None:
        for name, text in element.ports.items():
            if key_of(text, name) is None:
                self.note(
                    element.where,
                    f"{name}={text!r} is a text; if the file is of version 3, it means {{{text}}}",
                )

    def _add_model(self, model: Element) -> None:
        if model.tag not in _MODELS:
            self.note(model.where, f"<{model.tag}> means nothing in <TreeNodesModel>")
            return
        for port in (one for one in model.children if one.tag.endswith("_port")):
            name = port.get("name") or "_"
            if name[0].isdigit() or name in (*Rules.NAMES, "name", "ID", "_autoremap"):
                raise port.error(f"a port cannot be called {name!r}; write p_{name.lstrip('_')}")
        self._add(self.models, model.needed("ID"), model)

    def _add(self, table: dict[str, Element], name: str, element: Element) -> None:
        if not name.isprintable():
            raise element.error(f"{name!r} cannot be printed; write another ID")
        if name in table:
            first = table[name].where
            raise element.error(
                f"{name!r} is defined twice, first in {first}; give one of them another ID"
            )
        if problem := wrong_id(name):
            self.note(element.where, f"{problem}, as BehaviorTree.CPP wants it since 4.8.4")
        table[name] = element

    def _include(self, element: Element, folder: Path, chain: list[Path]) -> None:
        if "ros_pkg" in element.attrib:
            package, prefixes = (
                element.needed("ros_pkg"),
                os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep),
            )
            shares = [Path(prefix) / "share" / package for prefix in prefixes if prefix]
            found = [share for share in shares if share.is_dir()]
            if not found:
                advice = "source the workspace that has it, or write the path alone"
                raise element.error(
                    f"the ROS package {package!r} is not below AMENT_PREFIX_PATH; {advice}"
                )
            folder = found[0]
        self._file(folder / element.needed("path"), element.where, chain)


def wrong_id(name: str) -> str:
    """Return why BehaviorTree.CPP refuses an ID, and what to write instead; empty if it accepts it."""
    wrong = _FORBIDDEN.search(name)
    if wrong:
        better = _FORBIDDEN.sub("_", name)
        return f"{name!r}: {wrong[0]!r} cannot stand in an ID; write {better!r} instead"
    if name == "Root":
        return "'Root': the ID is taken by the library itself; write 'Main' instead"
    return ""


class SubTree(Branch, ClockFollower):
    """A tree of a file: below another tree, or as the root that is ticked.

    Attributes:
        blackboard: the blackboard of its nodes; a mapping.
        tree: the ID of the tree.
        models: the elements of the TreeNodesModels of the file.
        notes: what was read otherwise than it stands in the files; each was logged as a warning.
    """

    def __init__(
        self, name: str, slot: Slot, board: Blackboard, tree: str, models: tuple[Element, ...]
    ) -> None:
        super().__init__(name, [slot], Ports({}, {}, board))
        self.has_own_clock = False
        self.notes: tuple[str, ...] = ()
        self.blackboard, self.tree, self.models = board, tree, models

    def follow(self, clock: Clock) -> None:
        if not self.has_own_clock:
            self.blackboard.follow(clock)


Substitute = Status | Iterable[Status] | Callable[[str], Behaviour]
"""Replaces a leaf: the status that it returns, or one for each tick, or a function that makes a behaviour by name."""


def load_xml(
    text_or_path: str | Path | Iterable[str | Path],
    registry: BehaviourRegistry,
    tree: str | None = None,
    *,
    clock: Clock | None = None,
    enums: Mapping[str, int] | None = None,
    substitutes: Mapping[str, Substitute] | None = None,
) -> SubTree:
    """Make a tree from the XML of BehaviorTree.CPP 4, with its semantics.

    Args:
        text_or_path: the XML as a text, or the path of a file; or several of these, whose trees use one another.
        registry: the behaviours for the leaves.
        tree: ID of the tree to make; without it, the `main_tree_to_execute` of the file, or its only tree.
        clock: gives the time [s] to Delay, Timeout and Sleep; without it, the clock of the knowledge base that the
            registry is bound to, or else the monotonic clock of this computer.
        enums: names that scripts can use, with their numbers, e.g. `{"RED": 1}`.
        substitutes: replacements of leaves, by name, by tag, or by a pattern of the path (IDs of the trees, then the
            name), e.g. `"Mission/*/drive"`; the first that fits is taken. It is a status; or several, one for each
            tick, the last for all later ticks, e.g. `trace.statuses("drive")`; or a function that makes a behaviour
            from the name. Rules such as `_skipIf` stay; ports are neither read nor written.

    Returns:
        A behaviour of py_trees. INVALID after a tick means that it was skipped.

    Raises:
        XmlError: the XML cannot be read, or the tree cannot be made; the message begins with file and line.
    """
    is_one = isinstance(text_or_path, str | Path) or not isinstance(text_or_path, Iterable)
    document = Document([text_or_path] if is_one else text_or_path)  # type: ignore[list-item,arg-type]  # checked above
    for name, element in document.trees.items():
        if name in (*NODES, "SubTree") or name in registry.entries:
            raise element.error(
                f"{name!r} is the name of a node, so it cannot be that of a tree, too; rename the tree"
            )
    kb = registry.bound.get("kb")
    board = Blackboard(
        clock or (time.monotonic if kb is None else lambda: float(kb.now)), enums=enums
    )
    builder = _Builder(document, registry, substitutes or {})
    made = builder.tree(document.main(tree), document.root, None, board)
    made.has_own_clock = clock is not None
    made.notes = tuple(document.notes)
    for pattern in builder.unused:
        raise document.root.error(
            f"no leaf matches {pattern!r}; {hint(pattern, builder.leaves, 'leaves')}"
        )
    return made


class _Builder:
    def __init__(
        self, document: Document, registry: BehaviourRegistry, substitutes: Mapping[str, Substitute]
    ) -> None:
        self._document = document
        self._registry = registry
        self._substitutes = substitutes
        self.unused: Final = dict.fromkeys(substitutes)
        self.leaves: Final[dict[str, None]] = {}
        self._count = self._depth = 0
        self._trees: list[str] = []  # IDs of the trees around the node that is being made
        self._named: set[tuple[int, str]] = set()

    def tree(self, tree: str, asked_by: Element, name: str | None, board: Blackboard) -> SubTree:
        self._trees.append(tree)
        if tree in self._trees[:-1]:
            raise asked_by.error(f"a tree contains itself: {' -> '.join(self._trees)}")
        slot = self._slot(self._document.tree(tree, asked_by).children[0], board)
        self._trees.pop()
        return SubTree(name or tree, slot, board, tree, tuple(self._document.models.values()))

    def _slot(self, element: Element, board: Blackboard) -> Slot:
        self._count, self._depth = self._count + 1, self._depth + 1
        if self._count > MAX_NODES:
            raise element.error(f"the tree has more than {MAX_NODES} nodes, subtrees included")
        if self._depth > MAX_DEPTH:
            raise element.error(f"the tree is more than {MAX_DEPTH} levels deep, subtrees included")
        try:
            rules = self._rules(element, board)
            node, is_condition = self._node(element, board)
        except XmlError:
            raise
        except Exception as error:  # constructors of the user may raise anything
            problem = str(error) if isinstance(error, RosaBtError) else in_words(error)
            raise element.error(f"<{element.node}> cannot be made: {problem}") from error
        self._depth -= 1
        return Slot(node, is_condition, (element.tag, element.attrib), rules)

    def _node(self, element: Element, board: Blackboard) -> tuple[Behaviour, bool]:
        """Return the node, and whether it is a condition."""
        tag, name = element.node, element.get("name") or element.node
        entry = self._registry.entries.get(tag)
        if "ID" in element.attrib and element.tag not in _MODELS and (tag in NODES or entry):
            raise element.error(
                f"<{element.tag}> has an ID, which only <Action ID=...> and such have; write name=..."
            )
        if tag == "SubTree":
            return self._subtree(element, board), False
        if not element.children and (stand_in := self._stand_in(entry, element, name)) is not None:
            return stand_in
        if entry is not None:
            _check_children(element, *entry.children())
            slots = [self._slot(child, board) for child in element.children]
            branches = [Branch(slot.node.name, [slot], Ports({}, {}, board)) for slot in slots]

            def note(text: str) -> None:
                self._document.note(element.where, text)

            node = entry.make(name, element.ports, branches, board, note)
            return node, not slots and self._is_condition(entry, element, node)
        if tag not in NODES:
            raise element.error(self._unknown(tag))
        kind = NODES[tag]
        _check_children(element, *kind.CHILDREN)
        ports = Ports(kind.PORTS, element.ports, board)
        ports.check_required()
        node = kind(name, [self._slot(child, board) for child in element.children], ports)
        return node, is_plain(node)

    def _is_condition(
        self, entry: Entry | None, element: Element, leaf: Behaviour | type[Behaviour]
    ) -> bool:
        if entry is not None and entry.kind is not None:
            return entry.kind == "condition"
        model = self._document.models.get(element.node)
        said = element.tag if element.tag in EXPLICIT else model.tag if model is not None else ""
        return said == "Condition" or (said != "Action" and is_plain(leaf))

    def _stand_in(
        self, entry: Entry | None, element: Element, name: str
    ) -> tuple[Behaviour, bool] | None:
        path = "/".join([*self._trees, name])
        self.leaves[path] = None
        fits = (
            one
            for one in self._substitutes
            if one in (name, element.node) or fnmatchcase(path, one)
        )
        pattern = next(fits, None)
        if pattern is None:
            return None
        self.unused.pop(pattern, None)
        what = self._substitutes[pattern]
        statuses = () if callable(what) else (what,) if isinstance(what, Status) else tuple(what)
        if not callable(what) and (
            not statuses or not all(isinstance(one, Status) for one in statuses)
        ):
            raise element.error(
                f"{pattern!r} is replaced by statuses of py_trees or by a function, not by {what!r}"
            )
        leaf = (
            what(name) if callable(what) else StatusQueue(name, list(statuses[:-1]), statuses[-1])
        )
        original = (entry.made if entry else None) or (leaf if callable(what) else Behaviour)
        return leaf, Status.RUNNING not in statuses and self._is_condition(entry, element, original)

    def _subtree(self, element: Element, around: Blackboard) -> SubTree:
        tree = element.needed("ID")
        _check_children(element, 0, 0)
        autoremap = BOOLS.get(element.get("_autoremap", "false"))
        if autoremap is None:
            raise element.error(
                f"_autoremap is true or false, not {element.attrib['_autoremap']!r}"
            )
        name = element.get("name")
        if name is not None and (id(around), name) in self._named:
            raise element.error(
                f"two SubTrees of one tree are named {name!r}; give one of them another name"
            )
        self._named.add((id(around), name or ""))
        written = ({} if autoremap else self._defaults(element, tree)) | element.ports
        keys = {
            name: key for name, text in written.items() if (key := key_of(text, name)) is not None
        }
        constants = {name: text for name, text in written.items() if name not in keys}
        board = Blackboard(around.clock, around, keys, constants, autoremap=autoremap)
        return self.tree(tree, element, name, board)

    def _defaults(self, element: Element, tree: str) -> dict[str, str]:
        model = self._document.models.get(tree)
        found = {}
        for port in model.children if model is not None and model.tag == "SubTree" else ():
            if port.tag.endswith("_port"):  # editors write other elements, too
                name = port.needed("name")
                if default := port.get("default"):
                    found[name] = default
                elif name not in element.ports:
                    raise element.error(
                        f"the tree {tree!r} needs {name}=..., its model ({port.where}) says"
                    )
        return found

    def _unknown(self, tag: str) -> str:
        if tag in MARKS:
            return f'<{tag}> is of version 3; write BTCPP_format="3", or its name in version 4'
        if tag in self._document.trees:
            return f'<{tag}> is a tree; write <SubTree ID="{tag}"/>'
        near = get_close_matches(tag, [*NODES, "SubTree"], 1)
        guess = f"did you mean the node {near[0]!r}? " if near else ""
        return f"<{tag}> is unknown; {guess}{hint(tag, self._registry.entries, 'registered behaviours')}"

    def _rules(self, element: Element, board: Blackboard) -> Rules | None:
        """Return the rules of an element; note attributes that look like rules, and double quotes."""
        scripts, written = {}, {}
        for name in (*Rules.NAMES, *_SCRIPT_PORTS.get(element.node, ())):
            if name in element.attrib:
                self._convert_quotes(element, name)
        for name, text in element.items():
            if name in Rules.NAMES:
                scripts[name] = parse_script(text)
                written[name] = text
            elif name.startswith("_") and name.lower() not in _OF_EDITORS:
                near = get_close_matches(name, (*Rules.NAMES, "_autoremap"), 1, 0.0)
                nearest = "_autoremap" if name == "__shared_blackboard" else near[0]
                self._document.note(element.where, f"{name} means nothing; did you mean {nearest}?")
        return Rules(board, scripts, written) if scripts else None

    def _convert_quotes(self, element: Element, name: str) -> None:
        """Write the texts of a script in single quotes, as BehaviorTree.CPP wants them since 4.9."""
        old = element.attrib[name]
        new = _QUOTED.sub(lambda match: match[0] if "'" in match[0] else f"'{match[0][1:-1]}'", old)
        if new != old:
            element.set(name, new)
            self._document.note(element.where, f"{name}: texts stand in single quotes: {new}")


def _check_children(element: Element, least: int, most: int) -> None:
    several = [child for child in element.children if child.node == "AsyncSequence"]
    if element.node == "ReactiveSequence" and len(several) > 1:
        raise several[1].error(
            "a ReactiveSequence has at most one asynchronous child; use Sequence in it"
        )
    count = len(element)
    if least <= count <= most:
        return
    wanted = (
        f"{least}"
        if least == most
        else f"at least {least}"
        if most >= MAX_NODES
        else f"{least} to {most}"
    )
    advice = "; put a Sequence around them" if most == 1 and count > 1 else ""
    has = "1 child" if count == 1 else f"{count} children"
    raise element.error(f"<{element.node}> has {has}; it takes {wanted}{advice}")
