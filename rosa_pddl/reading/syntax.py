"""The parentheses of a PDDL file, with the place of each word, so that an error can point at it."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rosa_pddl.exceptions import PddlError, UnsupportedPddlError

_TOKEN = re.compile(r";[^\n]*|\s+|[()]|[^\s();]+")


@dataclass(frozen=True)
class Node:
    """A word, or a list in parentheses, and where it stands.

    Args:
        word: the word as written; None for a list.
        children: what the list holds; empty for a word.
        start: offset of the first character in the file's text.
        end: offset after the last character.
        line: counted from 1.
        column: counted from 1.
    """

    word: str | None
    children: tuple["Node", ...]
    start: int
    end: int
    line: int
    column: int

    @property
    def is_list(self) -> bool:
        """Whether this is a list in parentheses."""
        return self.word is None

    @property
    def lower(self) -> str:
        """The word as PDDL compares it; empty for a list."""
        return (self.word or "").lower()

    @property
    def head(self) -> str:
        """The first word of a list, in lower case; empty if there is none."""
        return self.children[0].lower if self.children else ""

    def __str__(self) -> str:
        if self.word is not None:
            return self.word
        return "(" + " ".join(str(child) for child in self.children) + ")"


@dataclass(frozen=True)
class Source:
    """A PDDL file: its text and its one outermost list."""

    file: str
    text: str
    root: Node

    def error(self, node: Node, message: str) -> PddlError:
        """Make an error that points at a node."""
        return PddlError(message, self.file, node.line, node.column)

    def unsupported(self, node: Node, message: str) -> UnsupportedPddlError:
        """Make an error about correct PDDL that cannot be handled."""
        return UnsupportedPddlError(message, self.file, node.line, node.column)


@dataclass
class _Open:
    start: int
    line: int
    column: int
    children: list[Node]

    def closed(self, end: int) -> Node:
        return Node(None, tuple(self.children), self.start, end, self.line, self.column)


def read_source(path: str | Path) -> Source:
    """Read one PDDL file.

    Raises:
        PddlError: the file cannot be read, or its parentheses do not balance.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise PddlError(f"cannot read this PDDL file: {reason}", path) from error
    return parse(text, str(path))


def parse(text: str, file: str, expected: str = "(define ...)") -> Source:
    """Parse PDDL text into its one outermost list.

    Args:
        text: PDDL.
        file: what to call it in messages.
        expected: what the list should be, for messages.

    Raises:
        PddlError: there is no list, more than one, or its parentheses do not balance.
    """
    stack: list[_Open] = []
    root: Node | None = None
    for token, start, line, column in _tokens(text):
        if root is not None:
            raise PddlError(f"found {token!r} after the end of {expected}, expected nothing more", file, line, column)
        if token == "(":
            stack.append(_Open(start, line, column, []))
        elif not stack:
            raise PddlError(f"found {token!r}, expected '{expected}'", file, line, column)
        elif token == ")":
            node = stack.pop().closed(start + 1)
            if stack:
                stack[-1].children.append(node)
            else:
                root = node
        else:
            _refuse_buried_section(token, stack, file)
            stack[-1].children.append(Node(token, (), start, start + len(token), line, column))
    if stack:
        raise _unclosed(stack[-1], file, "the end of the file")
    if root is None:
        raise PddlError(f"it is empty, expected '{expected}'", file)
    return Source(file, text, root)


def _tokens(text: str) -> Iterator[tuple[str, int, int, int]]:
    line, line_start = 1, 0
    for match in _TOKEN.finditer(text):
        token, start = match.group(), match.start()
        if not token[0].isspace() and token[0] != ";":
            yield token, start, line, start - line_start + 1
        if "\n" in token:
            line += token.count("\n")
            line_start = start + token.rindex("\n") + 1


def _refuse_buried_section(token: str, stack: list[_Open], file: str) -> None:
    """Sections stand directly in (define ...): one that stands deeper shows which parenthesis was left open."""
    if token.startswith(":") and not stack[-1].children and len(stack) > 2:
        raise _unclosed(stack[-2], file, f"({token} on line {stack[-1].line}")


def _unclosed(left_open: _Open, file: str, before: str) -> PddlError:
    opening = "(" + (str(left_open.children[0]) if left_open.children else "")
    message = f"unbalanced parentheses: {opening!r} opened here is not closed, expected ')' before {before}"
    return PddlError(message, file, left_open.line, left_open.column)
