"""Reads XML into elements that know their file and line, also text that is XML only to BehaviorTree.CPP."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Final
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError, ParserCreate

from rosa_bt.exceptions import XmlError

MAX_SIZE: Final = 1_000_000
"""Greatest size of a file or text [bytes]."""
MAX_DEPTH: Final = 100
"""Most levels of nodes in a tree with all its subtrees, and of files that include each other."""
EXPLICIT: Final = ("Action", "Condition", "Control", "Decorator")
"""Tags of elements whose ID is the name of the node."""

_VALUE: Final = re.compile(r"""=\s*("[^"]*"|'[^']*')""")
_IGNORED: Final = re.compile(r"<!--.*?-->|\A\s*<\?xml.*?\?>", re.DOTALL)
_BARE: Final = re.compile(r"&(?!#\d+;|#x[0-9a-fA-F]+;|(?:amp|lt|gt|quot|apos);)")

Note = Callable[[str, str], None]
"""Called with a place (file and line) and a warning."""


class Element(ElementTree.Element):
    """An element of a file; text in it is ignored, as in BehaviorTree.CPP."""

    where = ""
    """File and line where it starts; the file is `<text>` if the XML was given as a text."""

    @property
    def node(self) -> str:
        """The name of the node: the ID of an explicit element such as `<Action ID=...>`, or the tag."""
        return self.needed("ID") if self.tag in EXPLICIT else self.tag

    @property
    def children(self) -> list["Element"]:
        return list(self)  # type: ignore[arg-type]  # the builder makes elements of this class

    def descendants(self, tag: str) -> list["Element"]:
        return list(self.iter(tag))  # type: ignore[arg-type]  # as above

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
        in
    attributes, `--` in comments, and blanks before the declaration.
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
