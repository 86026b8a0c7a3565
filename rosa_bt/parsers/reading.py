"""From XML text to elements that know their file and line, and to the trees that a file and its includes define."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Protocol, cast

from rosa_bt.parsers.exceptions import XmlError, hint

__all__ = ["Document", "Element", "MAX_DEPTH", "MAX_SIZE", "read_document"]

MAX_SIZE: Final = 1_000_000
"""Of one file or text [bytes]."""
MAX_DEPTH: Final = 100
"""Levels of elements in a file, and of nodes in a tree with all its subtrees."""

_MODELS: Final = ("Action", "Condition", "Control", "Decorator", "SubTree")


@dataclass(frozen=True)
class Element:
    """One element of a file.

    Attributes:
        tag: e.g. `Sequence`.
        attributes: as written.
        children: the elements in it; text is passed over, as BehaviorTree.CPP does.
        file: where it was read; `<text>` for a text that was handed in.
        line: of its start.
    """

    tag: str
    attributes: Mapping[str, str]
    children: tuple["Element", ...]
    file: str
    line: int

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.file}:{self.line}"

    def get(self, attribute: str) -> str:
        """Return an attribute that has to be there."""
        if not self.attributes.get(attribute):
            raise XmlError(self.where, f"<{self.tag}> has no {attribute}; write {attribute}=... in it")
        return self.attributes[attribute]


@dataclass
class Document:
    """What a file and those that it includes define.

    Attributes:
        root: the outermost element of the file itself.
        trees: by ID.
        models: elements of the TreeNodesModels, by ID.
    """

    root: Element
    trees: dict[str, Element] = field(default_factory=dict)
    models: dict[str, Element] = field(default_factory=dict)

    def main(self, wanted: str | None) -> str:
        """Return the ID of the tree to make: the one that is asked for, the file's main tree, or the only one."""
        chosen = wanted or self.root.attributes.get("main_tree_to_execute")
        if chosen is not None:
            self.tree(chosen, self.root)
            return chosen
        if len(self.trees) != 1:
            known = ", ".join(self.trees) or "none"
            raise XmlError(
                self.root.where,
                f"which tree? There are: {known}; say load_xml(..., tree=...) or write main_tree_to_execute in <root>",
            )
        return next(iter(self.trees))

    def tree(self, name: str, asked_by: Element) -> Element:
        """Return a tree by its ID."""
        if name not in self.trees:
            raise XmlError(asked_by.where, f"no tree has the ID {name!r}; {hint(name, self.trees, 'trees')}")
        return self.trees[name]


def read_document(text_or_path: str | Path) -> Document:
    """Read a text, or a file with what it includes.

    Raises:
        XmlError: it is no file of BehaviorTree.CPP 4, or a limit is exceeded.
    """
    if isinstance(text_or_path, str) and text_or_path.lstrip("\ufeff \t\r\n").startswith("<"):
        document = Document(_parse(text_or_path.lstrip("\ufeff \t\r\n"), "<text>"))
        _collect(document, document.root, Path.cwd(), [], set())
        return document
    if isinstance(text_or_path, str) and not text_or_path.strip("\ufeff \t\r\n"):
        raise XmlError("<text>", "the text is empty; give the XML itself, or the path of a file")
    path = Path(text_or_path)
    document = Document(_read(path, str(path)))
    _collect(document, document.root, path.parent, [path.resolve()], {path.resolve()})
    return document


def _read(path: Path, where: str) -> Element:
    if not path.is_file():
        raise XmlError(where, f"there is no file {str(path)!r}; give the path of one, or the XML itself as text")
    if path.stat().st_size > MAX_SIZE:
        raise XmlError(where, f"{path} has more than {MAX_SIZE} bytes; divide it and include the parts")
    return _parse(path.read_bytes(), str(path))


def _collect(document: Document, root: Element, folder: Path, chain: list[Path], seen: set[Path]) -> None:
    _check_root(root)
    unnamed = [one for one in root.children if one.tag == "BehaviorTree" and "ID" not in one.attributes]
    for element in root.children:
        if element.tag == "BehaviorTree":
            alone = element in unnamed and sum(one.tag == "BehaviorTree" for one in root.children) == 1
            _add(document.trees, "BehaviorTree" if alone else element.get("ID"), element)
        elif element.tag == "TreeNodesModel":
            for model in element.children:
                if model.tag not in _MODELS:
                    raise XmlError(model.where, f"a model is one of {', '.join(_MODELS)}, not <{model.tag}>")
                _add(document.models, model.get("ID"), model)
        elif element.tag == "include":
            _include(document, element, folder, chain, seen)
        else:
            known = ["BehaviorTree", "TreeNodesModel", "include"]
            raise XmlError(
                element.where, f"<{element.tag}> cannot stand in <root>; {hint(element.tag, known, 'known')}"
            )


def _add(table: dict[str, Element], name: str, element: Element) -> None:
    if name in table:
        first = table[name].where
        raise XmlError(element.where, f"{name!r} is defined twice, first in {first}; give one of them another ID")
    table[name] = element


def _include(document: Document, element: Element, folder: Path, chain: list[Path], seen: set[Path]) -> None:
    if "ros_pkg" in element.attributes:
        raise XmlError(element.where, "ros_pkg needs a ROS installation, which is not asked for; write the path alone")
    written = Path(element.get("path"))
    path = (folder / written).resolve()
    if path in chain:
        circle = " -> ".join(one.name for one in [*chain[chain.index(path) :], path])
        raise XmlError(element.where, f"files include each other: {circle}")
    if path in seen:
        return
    if len(chain) > MAX_DEPTH:
        raise XmlError(element.where, f"more than {MAX_DEPTH} files include each other in a row")
    seen.add(path)
    root = _read(path, element.where)
    _collect(document, root, path.parent, [*chain, path], seen)


def _check_root(root: Element) -> None:
    if root.tag != "root":
        raise XmlError(root.where, f"the outermost element is <root>, not <{root.tag}>")
    version = root.attributes.get("BTCPP_format", "4")
    if version == "3":
        advice = "convert the file with convert_v3_to_v4.py, which comes with BehaviorTree.CPP"
        raise XmlError(root.where, f'BTCPP_format="3" gives some names another meaning; {advice}')
    if version != "4":
        raise XmlError(root.where, f'BTCPP_format={version!r} is not known; this reads BTCPP_format="4"')


class _Expat(Protocol):
    CurrentLineNumber: int


class _Target:
    """Takes what the parser finds; makes elements of it."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.expat: _Expat | None = None
        self._open: list[tuple[str, dict[str, str], int, list[Element]]] = []
        self._root: list[Element] = []

    @property
    def line(self) -> int:
        return self.expat.CurrentLineNumber if self.expat else 1

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        if len(self._open) >= MAX_DEPTH + 3:  # the root, the tree and what a model has in it are not nodes
            raise XmlError(f"{self.file}:{self.line}", f"more than {MAX_DEPTH} elements in each other; use SubTree")
        self._open.append((tag, dict(attributes), self.line, []))

    def end(self, tag: str) -> None:
        _, attributes, line, children = self._open.pop()
        element = Element(tag, attributes, tuple(children), self.file, line)
        (self._open[-1][3] if self._open else self._root).append(element)

    def data(self, text: str) -> None:
        pass

    def close(self) -> Element:
        return self._root[0]


def _parse(text: str | bytes, file: str) -> Element:
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, XMLParser

    if len(text) > MAX_SIZE:
        raise XmlError(file, f"it has more than {MAX_SIZE} bytes; divide it and include the parts")
    target = _Target(file)
    parser = XMLParser(target=target, forbid_dtd=True)
    target.expat = cast(_Expat, parser.parser)
    try:
        parser.feed(text)
        return cast(Element, parser.close())
    except DefusedXmlException:
        raise XmlError(f"{file}:{target.line}", "a document type or entity is not read; write values out") from None
    except ParseError as error:
        raise XmlError(f"{file}:{error.position[0]}", f"it is no XML: {error}") from None
    except (ValueError, LookupError) as error:
        if isinstance(error, XmlError):
            raise
        raise XmlError(f"{file}:{target.line}", f"it cannot be decoded: {error}") from None
