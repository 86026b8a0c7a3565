"""The files of trees: their elements, what they define and include, and version 3."""

import logging
import os
import re
from collections.abc import Container, Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError, ParserCreate

from rosa_bt.exceptions import XmlError
from rosa_bt.xml.nodes import CHECKS, RULES

EXPLICIT = ("Action", "Condition", "Control", "Decorator")
"""Tags of elements whose ID is the name of the node."""
MODELS = (*EXPLICIT, "SubTree")
_OF_EDITORS = ("_collapsed", "_description", "_fullpath", "_uid")
"""Attributes, in small letters, that are no rules of a node and that editors write."""
_SCRIPTS = ("Script code", "ScriptCondition code", "Precondition if")
_QUOTED = re.compile(r"""'[^']*'|"([^"']*)\"""")
_VALUE = re.compile(r"""=\s*("[^"]*"|'[^']*')""")
_IGNORED = re.compile(r"<!--.*?-->|\A\s*<\?xml.*?\?>", re.DOTALL)
_BARE = re.compile(r"&(?!#\d+;|#x[0-9a-fA-F]+;|(?:amp|lt|gt|quot|apos);)")
_FORBIDDEN = re.compile(r"[\s./\\:*?|<>&\"'\x00-\x1f]")

_NODES = {
    "SubTreePlus": "SubTree",
    "SubtreePlus": "SubTree",
    "SequenceStar": "SequenceWithMemory",
    "FallbackStar": "Fallback",
    "RetryUntilSuccesful": "RetryUntilSuccessful",
}
"""Nodes of version 3 that have another name in version 4."""
_PORTS = {
    "Parallel threshold": "success_count",
    "Parallel success_threshold": "success_count",
    "Parallel failure_threshold": "failure_count",
    "SubTree __autoremap": "_autoremap",
    "SubTree __shared_blackboard": "_autoremap",
}
NO_COUNTERPART = ("ConsumeQueue", "ManualSelector", "PopFromQueue", "QueueSize")
"""Nodes of version 3 that are not read."""
MARKS = frozenset({*_NODES, *_PORTS, *CHECKS, *NO_COUNTERPART})
"""Nodes, and ports of nodes, by which a file without BTCPP_format is known to be of version 3."""
_OPPOSITE = "_skipIf (with the opposite condition)"
_MEANT = {
    **{rule.lower(): rule for rule in (*RULES, "_autoremap")},
    "__shared_blackboard": "_autoremap",
    "_onlyif": _OPPOSITE,
    "_precondition": _OPPOSITE,
    "_postcondition": "_post",
}
"""The rules that users mean, by what they may write, in small letters."""

_log = logging.getLogger(__name__)


class Element(ElementTree.Element):
    """An element of a file; text in it is ignored, as in BehaviorTree.CPP."""

    where = ""
    """File and line where it starts; the file is `<text>` if the XML was given as a text."""

    @property
    def node(self) -> str:
        """The name of the node: the ID of `<Action ID=...>` and the like, or the tag."""
        return self.needed("ID") if self.tag in EXPLICIT else self.tag

    @property
    def children(self) -> list["Element"]:
        return list(self)  # type: ignore[arg-type]  # the builder makes elements of this class

    @property
    def descendants(self) -> list["Element"]:
        return list(self.iter())[1:]  # type: ignore[return-value]  # as for children

    @property
    def ports(self) -> dict[str, str]:
        others = ("name", "ID") if self.tag in MODELS else ("name",)
        return {
            name: text
            for name, text in self.items()
            if name not in others and not name.startswith("_")
        }

    def needed(self, attribute: str) -> str:
        if not self.get(attribute):
            raise self.error(f"<{self.tag}> has no {attribute}; write {attribute}=... in it")
        return self.attrib[attribute]

    def error(self, problem: str) -> XmlError:
        return XmlError(self.where, problem)


def _parse(text: str | bytes, file: str) -> Element:
    """Return the outermost element of an XML text."""
    parser = ParserCreate()
    builder = ElementTree.TreeBuilder(element_factory=Element)

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = builder.start(tag, attributes)
        element.where = f"{file}:{parser.CurrentLineNumber}"  # type: ignore[attr-defined]  # made by its factory

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(text, True)
    except (ExpatError, ValueError, LookupError) as error:
        raise XmlError(f"{file}:{parser.CurrentLineNumber}", f"it is no XML: {error}") from None
    return builder.close()  # type: ignore[return-value]  # made by its factory


def _convert(element: Element, trees: Container[str | None]) -> Iterator[str]:
    """Convert an element of version 3 in place; yield what was written, and what it is now."""
    name = element.node
    if name in MARKS and element.tag in EXPLICIT:
        element.tag = element.attrib.pop("ID")
    if element.tag in trees:
        element.tag = "SubTree"
        element.set("ID", name)
        yield f'<{name}> is <SubTree ID="{name}">'
    elif element.tag in _NODES:
        element.tag = _NODES[name]
        yield f"<{name}> is <{element.tag}>"
    is_plain = element.tag == "SubTree" and name not in _NODES  # a SubTreePlus has literals
    for attribute, text in list(element.items()):
        renamed = _PORTS.get(f"{element.tag} {attribute}")
        if renamed:
            element.set(renamed, element.attrib.pop(attribute))
            limit = ", without keys that begin with _" if renamed == "_autoremap" else ""
            yield f"{attribute} is {renamed}{limit}"
        elif is_plain and attribute in element.ports and text[:1] != "{":
            element.set(attribute, f"{{{text}}}")
            yield f'{attribute}="{text}" is {attribute}="{{{text}}}"'
    key = element.get("output_key", "")
    if name == "SetBlackboard" and key[:1] == "{":
        element.set("output_key", key[1:-1])
        yield f'output_key="{key}" is output_key="{key[1:-1]}"'


class Document:
    """The trees and models that are defined in files, or texts, and in the files that they include.

    Attributes:
        root: the outermost element of the file; of several files, of the one that names the main
            tree.
        trees: the `BehaviorTree` elements, by ID.
        models: the elements of the TreeNodesModels, by ID.
        notes: what was read otherwise than it stands, or means nothing.

    Raises:
        XmlError: a file is not of BehaviorTree.CPP.
    """

    def __init__(self, sources: Iterable[str | Path]) -> None:
        self.notes: list[str] = []
        self.trees: dict[str, Element] = {}
        self.models: dict[str, Element] = {}
        self._files: dict[str, Element] = {}
        roots = []
        for source in sources:
            text = str(source).lstrip("\ufeff \t\r\n")
            if not text or text.startswith("<"):
                roots.append(self._collect(self._parse(text, "<text>"), Path()))
            else:
                roots.append(self._file(Path(source), "<text>"))
        self.root = max(roots, key=lambda root: "main_tree_to_execute" in root.attrib)

    def note(self, where: str, text: str) -> None:
        """Log a warning, and keep it."""
        self.notes.append(f"{where}: {text}")
        _log.warning("%s: %s", where, text)

    def _parse(self, text: str | bytes, file: str) -> Element:
        """Return the outermost element.

        A text that BehaviorTree.CPP reads, though it is no XML, is read with a note: raw `&&` and
        `<` in attributes, `--` in comments, and blanks before the declaration.
        """
        try:
            return _parse(text, file)
        except XmlError:
            written = text if isinstance(text, str) else text.decode("utf-8", "replace")
            plain = _IGNORED.sub(lambda match: "\n" * match[0].count("\n"), written)
            escaped = _VALUE.sub(
                lambda match: _BARE.sub("&amp;", match[0]).replace("<", "&lt;"), plain
            )
            if escaped == written:
                raise
            reasons = "& or < in attributes, -- in a comment, or a late declaration"
            self.note(file, f"read as it stands, though it is no XML: {reasons}")
            return _parse(escaped, file)

    def _file(self, path: Path, where: str) -> Element:
        """Return the outermost element of a file.

        A file is read once, even if it is included several times.
        """
        try:
            content = path.read_bytes()
        except (OSError, ValueError) as error:
            problem = f"there is no file {str(path)[:200]!r} that can be read"
            advice = "give the path of one, or the XML itself as text"
            raise XmlError(where, f"{problem}; {advice}") from error
        real = os.path.realpath(path)
        if real not in self._files:
            self._files[real] = self._parse(content, str(path))
            self._collect(self._files[real], path.parent)
        return self._files[real]

    def _collect(self, root: Element, folder: Path) -> Element:
        """Add what a file defines and includes; return its outermost element."""
        if root.tag != "root":
            raise root.error(f"the outermost element is <root>, not <{root.tag}>")
        if len(root.findall("TreeNodesModel")) > 1:
            raise root.error("a file has one TreeNodesModel; put all its elements into the first")
        trees = root.findall("BehaviorTree")
        if len(trees) == 1:
            trees[0].attrib.setdefault("ID", "BehaviorTree")
        names = [tree.get("ID") for tree in trees]
        is_old = self._is_version_3(root, names)
        for element in root.children:
            if element.tag == "BehaviorTree":
                if len(element) != 1:
                    raise element.error(
                        f"a tree has one child, not {len(element)}; put a Sequence around"
                    )
                self._add(self.trees, element)
                for node in element.descendants:
                    if is_old:
                        for change in _convert(node, {*names, *self.trees}):
                            self.note(node.where, f"version 3 is converted: {change}")
                    elif "BTCPP_format" not in root.attrib:
                        for change in _convert(Element(node.tag, node.attrib), names):
                            self.note(node.where, f"read as it stands; in version 3, {change}")
                    if node.node in CHECKS:
                        self.note(node.where, f"<{node.node}> is not in version 4; read as in 3")
                    self._read_rules(node)
            elif element.tag == "TreeNodesModel":
                for model in element.children:
                    if model.tag in MODELS:
                        self._add(self.models, model)
            elif element.tag == "include":
                self._include(element, folder)
        return root

    def _is_version_3(self, root: Element, names: Iterable[str | None]) -> bool:
        """Tell whether a file is of version 3: it says so, or has its words and says nothing."""
        version = root.get("BTCPP_format", "")
        is_old = version[:1] == "3"
        marks = {*MARKS, *names} - {"BehaviorTree"}
        for element in root.descendants if not version else ():
            ports = [f"{element.node} {attribute}" for attribute in element.attrib]
            is_old |= not marks.isdisjoint([element.node, *ports])
        if version not in ("3", "4"):
            given = f"BTCPP_format {version!r}" if version else "no BTCPP_format"
            self.note(root.where, f"it has {given}; read as version {3 if is_old else 4}")
        return is_old

    def _read_rules(self, element: Element) -> None:
        """Note attributes that look like rules; write the texts of scripts in single quotes."""
        for name, before in list(element.items()):
            if name in RULES or f"{element.node} {name}" in _SCRIPTS:
                after = _QUOTED.sub(lambda match: f"'{match[1]}'" if match[1] else match[0], before)
                if after != before:
                    element.set(name, after)
                    self.note(element.where, f"{name}: texts stand in single quotes: {after}")
            elif name[:1] == "_" and name.lower() not in _OF_EDITORS and name != "_autoremap":
                advice = f"the rules are {', '.join(RULES)}"
                for near in get_close_matches(name.lower(), _MEANT, 1):
                    advice = f"did you mean {_MEANT[near]}?"
                del element.attrib[name]
                self.note(element.where, f"{name} means nothing; {advice}")

    def _add(self, table: dict[str, Element], element: Element) -> None:
        name = element.needed("ID")
        if name in table:
            first = table[name].where
            raise element.error(f"{name!r} is defined twice, first in {first}; write another ID")
        if problem := wrong_id(name):
            self.note(element.where, f"{problem}, as BehaviorTree.CPP wants it since 4.8.4")
        table[name] = element

    def _include(self, element: Element, folder: Path) -> None:
        if package := element.get("ros_pkg"):
            prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
            shares = [Path(prefix, "share", package) for prefix in prefixes]
            folder = max(shares, key=Path.is_dir)  # the first that exists
            if not folder.is_dir():
                raise element.error(
                    f"the ROS package {package!r} is not below AMENT_PREFIX_PATH; "
                    "source the workspace that has it, or write the path alone"
                )
        self._file(folder / element.needed("path"), element.where)


def wrong_id(name: str) -> str:
    """Return why BehaviorTree.CPP refuses an ID, and what to write instead.

    Empty if it accepts it.
    """
    match = _FORBIDDEN.search(name)
    if match:
        better = _FORBIDDEN.sub("_", name)
        return f"{name!r}: {match[0]!r} cannot stand in an ID; write {better!r} instead"
    if name == "Root":
        return "'Root': the ID is taken by the library itself; write 'Main' instead"
    return ""
