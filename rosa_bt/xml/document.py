"""The files of trees: their elements, what they define and include, and version 3."""

import logging
import os
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError, ParserCreate

from rosa_bt.exceptions import XmlError, hint
from rosa_bt.xml.nodes import RULES

MAX_SIZE = 1_000_000
"""Greatest size of a file or text [bytes]."""
MAX_DEPTH = 100
"""Most levels of nodes in a tree with all its subtrees, and of files that include each other."""
EXPLICIT = ("Action", "Condition", "Control", "Decorator")
"""Tags of elements whose ID is the name of the node."""

_VALUE = re.compile(r"""=\s*("[^"]*"|'[^']*')""")
_IGNORED = re.compile(r"<!--.*?-->|\A\s*<\?xml.*?\?>", re.DOTALL)
_BARE = re.compile(r"&(?!#\d+;|#x[0-9a-fA-F]+;|(?:amp|lt|gt|quot|apos);)")

Note = Callable[[str, str], None]
"""Called with a place (file and line) and a warning."""


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

    def descendants(self, tag: str) -> list["Element"]:
        return list(self.iter(tag))  # type: ignore[arg-type]  # as for children

    @property
    def ports(self) -> dict[str, str]:
        names = [name for name in self.keys() if name not in ("name", "ID") and name[:1] != "_"]
        return {name: self.attrib[name] for name in names}

    def needed(self, attribute: str) -> str:
        if not self.get(attribute):
            raise self.error(f"<{self.tag}> has no {attribute}; write {attribute}=... in it")
        return self.attrib[attribute]

    def error(self, problem: str) -> XmlError:
        return XmlError(self.where, problem)


def read_file(path: Path, where: str) -> bytes:
    """Return the content of a file; `where` is what asks for it."""
    try:
        with path.open("rb") as file:
            return file.read(MAX_SIZE + 1)
    except (OSError, ValueError) as error:
        problem = f"there is no file {str(path)[:200]!r} that can be read"
        advice = "give the path of one, or the XML itself as text"
        raise XmlError(where, f"{problem}; {advice}") from error


def parse(text: str | bytes, file: str, note: Note) -> Element:
    """Return the outermost element.

    A text that BehaviorTree.CPP reads, though it is no XML, is read with a note: raw `&&` and `<`
    in attributes, `--` in comments, and blanks before the declaration.
    """
    if len(text) > MAX_SIZE:
        raise XmlError(file, f"it has more than {MAX_SIZE} bytes; divide it and include the parts")
    try:
        return _parse_strictly(text, file)
    except XmlError as error:
        written = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
        plain = _IGNORED.sub(lambda match: "\n" * match[0].count("\n"), written)
        escaped = _VALUE.sub(lambda match: _BARE.sub("&amp;", match[0]).replace("<", "&lt;"), plain)
        if escaped == written:
            raise
        try:
            root = _parse_strictly(escaped, file)
        except XmlError:
            raise error from None
        reason = "-- in a comment, or a late declaration"
        if escaped != plain:
            reason = "& and < in attributes, which XML wants as &amp; and &lt;"
        note(file, f"read as it stands, though it is no XML: {reason}")
        return root


def _parse_strictly(text: str | bytes, file: str) -> Element:
    parser = ParserCreate()
    builder = ElementTree.TreeBuilder(element_factory=Element)

    def where() -> str:
        return f"{file}:{parser.CurrentLineNumber}"

    def start(tag: str, attributes: dict[str, str]) -> None:
        builder.start(tag, attributes).where = where()  # type: ignore[attr-defined]  # made by its factory

    def refuse(*declaration: object) -> None:  # entities are declared in document types only
        raise XmlError(where(), "a document type or entity is not read; write values out")

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except XmlError:
        raise
    except (ExpatError, ValueError, LookupError) as error:
        raise XmlError(where(), f"it is no XML: {error}") from None
    return builder.close()  # type: ignore[return-value]  # made by its factory


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
}
_CHECKS = tuple(f"BlackboardCheck{kind}" for kind in ("Bool", "Double", "Int", "String"))
_NO_COUNTERPART = ("ConsumeQueue", "ManualSelector", "PopFromQueue", "QueueSize")
MARKS = frozenset({*_NODES, *_CHECKS})
"""Nodes by which a file without BTCPP_format is known to be of version 3."""


def is_version_3(root: Element) -> bool:
    """Tell whether a file is of version 3: it says so, or has its nodes and says nothing."""
    version = root.get("BTCPP_format")
    if version is not None:
        return version.split(".")[0] == "3"
    for element in root.descendants("*"):
        if element.tag in MARKS or element.get("ID") in MARKS or _SHARED in element.attrib:
            return True
    return False


def convert(root: Element, note: Note) -> None:
    """Convert the trees of a file in place.

    Raises:
        XmlError: a node has no counterpart in version 4.
    """
    trees = [tree.get("ID") for tree in root.children if tree.tag == "BehaviorTree"]
    for tree in root.children:
        for element in tree.descendants("*") if tree.tag == "BehaviorTree" else ():
            if element is not tree:
                for before, after in _converted(element, trees):
                    note(element.where, f"version 3 is converted: {before} is {after}")


_SHARED = "__shared_blackboard"


def _converted(element: Element, trees: list[str | None]) -> Iterator[tuple[str, str]]:
    """Convert an element; yield what was written, and what it is now."""
    is_explicit = element.tag in EXPLICIT
    name = element.get("ID", "") if is_explicit else element.tag
    if name in _NO_COUNTERPART:
        raise element.error(f"<{name}> of version 3 has no counterpart in version 4; register it")
    if name in trees and not is_explicit:
        element.tag = "SubTree"
        element.set("ID", name)
        yield f"<{name}>", f'<SubTree ID="{name}">'
    elif name in _NODES:
        if is_explicit:
            element.set("ID", _NODES[name])
        else:
            element.tag = _NODES[name]
        yield f"<{name}>", f"<{_NODES[name]}>"
    is_subtree = name == "SubTree" or name in trees
    for attribute, text in list(element.items()):
        renamed = _PORTS.get(f"{element.node} {attribute}")
        if renamed:
            element.attrib[renamed] = element.attrib.pop(attribute)
            yield attribute, renamed
        elif attribute == _SHARED:
            del element.attrib[_SHARED]
            if text.lower() in ("1", "true"):
                element.set("_autoremap", "true")
                yield _SHARED, "_autoremap, which shares no key that begins with _"
        elif is_subtree and attribute in element.ports and text[:1] != "{":
            element.set(attribute, f"{{{text}}}")
            yield f'{attribute}="{text}"', f'{attribute}="{{{text}}}"'
    key = element.get("output_key", "")
    if name == "SetBlackboard" and key[:1] == "{":
        element.set("output_key", key[1:-1])
        yield f'output_key="{key}"', f'output_key="{key[1:-1]}"'
    if name in _CHECKS:
        _convert_check(element, is_text=name.endswith("String"))
        yield f"<{name}>", f'<Precondition if="{element.get("if")}">'


def _convert_check(element: Element, *, is_text: bool) -> None:
    """Make a Precondition of a decorator that compares two values when its child starts."""
    sides = []
    for port in ("value_A", "value_B"):
        text = element.needed(port)
        key = re.fullmatch(r"{(\w+)}", text)
        literal = f"'{text}'" if is_text else text
        sides.append(key[1] if key else literal)
        del element.attrib[port]
    element.set("if", " == ".join(sides))
    element.set("else", element.attrib.pop("return_on_mismatch", "FAILURE"))
    element.tag = "Precondition"
    element.attrib.pop("ID", None)


_log = logging.getLogger(__name__)
_FORBIDDEN = re.compile(r"[\s./\\:*?|<>&\"'\x00-\x1f]")
MODELS = (*EXPLICIT, "SubTree")


class Document:
    """The trees and models that are defined in files, or texts, and in the files that they include.

    Attributes:
        root: the outermost element of the file; of several files, of the one that names the main
            tree.
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
        self._files: dict[str, Element] = {}
        roots = [self._open(source) for source in sources]
        if not roots:
            raise XmlError("<text>", "there is no text and no file; give at least one")
        mains = [root for root in roots if "main_tree_to_execute" in root.attrib]
        self.root = [*mains, *roots][0]

    def note(self, where: str, text: str) -> None:
        """Log a warning, and keep it."""
        self.notes.append(f"{where}: {text}")
        _log.warning("%s: %s", where, text)

    def main(self, name: str | None) -> str:
        """Return the ID of the tree to make: this name, the main tree, or the only one."""
        name = name or self.root.get("main_tree_to_execute")
        if name is None:
            if len(self.trees) != 1:
                names = ", ".join(self.trees) or "none"
                advice = "say load_xml(..., tree=...) or write main_tree_to_execute in <root>"
                raise self.root.error(f"which tree? There are: {names}; {advice}")
            (name,) = self.trees
        self.tree(name, self.root)
        return name

    def tree(self, name: str, asked_by: Element) -> Element:
        if name not in self.trees:
            raise asked_by.error(f"no tree has the ID {name!r}; {hint(name, self.trees, 'trees')}")
        return self.trees[name]

    def _open(self, source: str | Path) -> Element:
        text = source.lstrip("\ufeff \t\r\n") if isinstance(source, str) else ""
        if text.startswith("<"):
            return self._collect(parse(text, "<text>", self.note), Path.cwd(), [])
        return self._file(Path(source), "<text>", [])

    def _file(self, path: Path, where: str, chain: list[str]) -> Element:
        """Return the outermost element of a file.

        A file is read once, even if it is included several times.
        """
        content = read_file(path, where)
        real = os.path.realpath(path)
        if real in chain:
            names = [Path(file).name for file in (*chain, real)]
            raise XmlError(where, f"files include each other: {' -> '.join(names)}")
        if real not in self._files:
            root = parse(content, str(path), self.note)
            self._files[real] = self._collect(root, path.parent, [*chain, real])
        return self._files[real]

    def _collect(self, root: Element, folder: Path, chain: list[str]) -> Element:
        """Add what a file defines and includes; return `root`, its outermost element."""
        if root.tag != "root":
            raise root.error(f"the outermost element is <root>, not <{root.tag}>")
        self._check_version(root)
        tags = [element.tag for element in root.children]
        if tags.count("TreeNodesModel") > 1:
            raise root.error("a file has one TreeNodesModel; put all its elements into the first")
        for element in root.children:
            if element.tag == "BehaviorTree":
                if len(element) != 1:
                    count = f"not {len(element)}"
                    raise element.error(f"a tree has one child, {count}; put a Sequence around")
                if tags.count("BehaviorTree") == 1:
                    element.attrib.setdefault("ID", "BehaviorTree")
                self._add(self.trees, element)
            elif element.tag == "TreeNodesModel":
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
                text = "it has no BTCPP_format; read as version 3, whose nodes it has"
                self.note(root.where, text)
            convert(root, self.note)
        elif version is None:
            text = "it has no BTCPP_format; read as version 4, in which ports of SubTree are texts"
            self.note(root.where, f'{text}: write BTCPP_format="4"')
        elif version != "4":
            self.note(root.where, f"it has BTCPP_format {version!r}; read as version 4")

    def _add_model(self, model: Element) -> None:
        if model.tag not in MODELS:
            self.note(model.where, f"<{model.tag}> means nothing in <TreeNodesModel>")
            return
        for port in model.children:
            name = port.get("name", "_")
            if name[:1].isdigit() or name in (*RULES, "name", "ID", "_autoremap"):
                raise port.error(f"a port cannot be called {name!r}; write p_{name.lstrip('_')}")
        self._add(self.models, model)

    def _add(self, table: dict[str, Element], element: Element) -> None:
        name = element.needed("ID")
        if not name.isprintable():
            raise element.error(f"{name!r} cannot be printed; write another ID")
        if name in table:
            first = table[name].where
            raise element.error(f"{name!r} is defined twice, first in {first}; write another ID")
        if problem := wrong_id(name):
            self.note(element.where, f"{problem}, as BehaviorTree.CPP wants it since 4.8.4")
        table[name] = element

    def _include(self, element: Element, folder: Path, chain: list[str]) -> None:
        if "ros_pkg" in element.attrib:
            package = element.needed("ros_pkg")
            prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
            shares = [Path(prefix, "share", package) for prefix in prefixes]
            shares = [share for share in shares if share.is_dir()]
            if not shares:
                advice = "source the workspace that has it, or write the path alone"
                raise element.error(
                    f"the ROS package {package!r} is not below AMENT_PREFIX_PATH; {advice}"
                )
            folder = shares[0]
        self._file(folder / element.needed("path"), element.where, chain)


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
