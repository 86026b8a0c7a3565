"""The lists and sections of PDDL files, with the place of each word, so that an error can point at it."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from rosa_pddl.exceptions import PddlError, UnsupportedPddlError, nearest

NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
# a type may follow its mark without a space
_TOKEN = re.compile(r";[^\n]*|\s+|[()]|-(?=[A-Za-z])|[^\s();]+")

BODY: Final[Mapping[str, tuple[str, ...]]] = {
    ":action": (":parameters", ":precondition", ":effect"),
    ":durative-action": (":parameters", ":duration", ":condition", ":effect"),
}
"""What describes an action, by the section."""

# In the order that unified-planning's reader insists on.
_DOMAIN = ("domain", ":requirements", ":types", ":constants", ":predicates", ":functions", ":derived", *BODY)
_PROBLEM = ("problem", ":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
# What unified-planning or the executor cannot take, and which engine would do.
_UNSUPPORTED = {
    ":process": "it changes numbers while time passes; ENHSP (up-enhsp) would do",
    ":event": "it happens by itself; ENHSP (up-enhsp) would do",
    **dict.fromkeys(
        (":task", ":method", ":htn"), "hierarchies are not executed here; Aries (up-aries) by itself would do"
    ),
    ":utility": "no installed engine takes utilities. Leave them out and add soft goals: goals.add(TEXT, worth=COST)",
    ":constraints": "what shall hold on the way is not planned for; SymK (up-symk) after compilation would do",
}


@dataclass(frozen=True)
class Node:
    """A word, or a list in parentheses, which has no word; line and column are 0 if it stands in no file."""

    word: str | None
    children: tuple["Node", ...]
    line: int
    column: int

    @property
    def is_list(self) -> bool:
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


ANY: Final = Node("object", (), 0, 0)
"""The type of a name without one."""


@dataclass(frozen=True)
class Source:
    """A PDDL file: what to call it in messages, and its one outermost list."""

    file: str
    root: Node

    def error(self, node: Node, message: str) -> PddlError:
        return PddlError(message, self.file, node.line or None, node.column or None)

    def unsupported(self, node: Node, message: str) -> UnsupportedPddlError:
        return UnsupportedPddlError(message, self.file, node.line or None, node.column or None)


def listed(*parts: Node | str) -> Node:
    """Make a list that stands where the first part that is a node does, or at the beginning."""
    place = next((part for part in parts if isinstance(part, Node)), ANY)
    children = tuple(replace(place, word=part, children=()) if isinstance(part, str) else part for part in parts)
    return replace(place, word=None, children=children)


def start_of(node: Node) -> str:
    text = str(node)
    return text if len(text) <= 40 else text[:37] + "..."


def typed(source: Source, nodes: Iterable[Node], *, are_variables: bool = False) -> list[tuple[Node, Node | None]]:
    """Read a typed list such as `a b - t c`; return each name with its type, None if it has none."""
    found: list[tuple[Node, Node | None]] = []
    waiting: list[Node] = []
    before = ""
    for node in nodes:
        expects_type, before = before == "-", str(node)
        is_either = expects_type and node.head == "either" and len(node.children) > 1
        if is_either and not are_variables:
            message = "found '(either ...)': an object has one type, and a type one above it; only variables may have"
            raise source.unsupported(node, f"{message} several. Declare a type above them")
        if node.is_list and not is_either:
            raise source.error(node, f"found {start_of(node)!r}, expected {'a type' if expects_type else 'a name'}")
        if expects_type:
            found += [(name, node) for name in waiting]
            waiting = []
        elif node.word != "-":
            if are_variables and not node.lower.startswith("?"):
                raise source.error(node, f"found {node.word!r}, expected a variable such as '?{node.word}'")
            waiting.append(node)
    return found + [(name, None) for name in waiting]


def glued_types(source: Source) -> Iterator[str]:
    """Yield in sentences where a type follows its mark without a space, as in `?r -robot`."""
    for node in nodes_of(source.root):
        for mark, kind in pairwise(node.children):
            is_glued = (mark.line, mark.column + 1) == (kind.line, kind.column)
            if mark.word == "-" and is_glued and kind.word is not None:
                yield f"{source.file}:{mark.line}: '-{kind}' is read as '- {kind}'; write it with the space"


def nodes_of(node: Node) -> Iterator[Node]:
    yield node
    for child in node.children:
        yield from nodes_of(child)


class _Open(NamedTuple):
    line: int
    column: int
    children: list[Node]


def read_source(path: str | Path) -> Source:
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise PddlError(f"cannot read this PDDL file: {reason}", path) from error
    return parse(text, str(path))


def parse(text: str, file: str, expected: str = "(define ...)") -> Source:
    """Parse PDDL text into its one outermost list; messages call it by `file`, and say what was `expected`."""
    stack: list[_Open] = []
    root: Node | None = None
    for token, line, column in _tokens(text):
        if root is not None:
            raise PddlError(f"found {token!r} after the end of {expected}, expected nothing more", file, line, column)
        if token == "(":
            stack.append(_Open(line, column, []))
        elif not stack:
            raise PddlError(f"found {token!r}, expected '{expected}'", file, line, column)
        elif token == ")":
            closed = stack.pop()
            node = Node(None, tuple(closed.children), closed.line, closed.column)
            if stack:
                stack[-1].children.append(node)
            else:
                root = node
        else:
            _refuse_buried_section(token, stack, file)
            stack[-1].children.append(Node(token, (), line, column))
    if stack:
        raise _unclosed(stack[-1], file, "the end of the file")
    if root is None:
        raise PddlError(f"it is empty, expected '{expected}'", file)
    return Source(file, root)


def formula(text: str, file: str) -> Node:
    """Parse a text that stands at no line of a file."""
    return _unplaced(parse(text, file).root)


def _unplaced(node: Node) -> Node:
    return replace(node, children=tuple(map(_unplaced, node.children)), line=0, column=0)


def _tokens(text: str) -> Iterator[tuple[str, int, int]]:
    line, line_start = 1, 0
    for match in _TOKEN.finditer(text):
        token, start = match.group(), match.start()
        if not token[0].isspace() and token[0] != ";":
            yield token, line, start - line_start + 1
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


def check_frames(domain: Source, problem: Source) -> None:
    _check_frame(domain, "domain", _DOMAIN)
    _check_frame(problem, "problem", _PROBLEM)
    _check_problem(problem, str(domain.root.children[1].children[1]), domain.file)


def section(source: Source, *heads: str) -> list[Node]:
    sections = source.root.children[2:]
    return [child for head in heads for node in sections if node.head == head for child in node.children[1:]]


def body_of(source: Source, schema: Node) -> dict[str, Node]:
    if len(schema.children) < 2 or schema.children[1].is_list or schema.children[1].lower.startswith(":"):
        raise source.error(schema, f"found {start_of(schema)!r}, expected '({schema.head} NAME ...)'")
    allowed, name = BODY[schema.head], schema.children[1]
    parts: dict[str, Node] = {}
    words = list(schema.children[2:])
    while words:
        keyword = words.pop(0)
        if keyword.lower not in allowed:
            message = f"found {start_of(keyword)!r} in {schema.head} {name}, expected one of {' '.join(allowed)}; "
            raise source.error(keyword, message + nearest(keyword.lower, allowed))
        if not words or not words[0].is_list:
            raise source.error(keyword, f"expected '(' after {keyword.word}")
        parts[keyword.lower] = words.pop(0)
    if schema.head == ":durative-action" and ":duration" not in parts:
        raise source.error(schema, f"(:durative-action {name} has no ':duration'")
    return parts


def _check_frame(source: Source, what: str, sections: Collection[str]) -> None:
    root = source.root
    if root.head != "define" or len(root.children) < 2:
        raise source.error(root, f"found {start_of(root)!r}, expected '(define ({what} ...) ...)'")
    title = root.children[1]
    if title.head != what or len(title.children) != 2:
        raise source.error(title, f"found {start_of(title)!r}, expected '({what} NAME)'; is this the {what} file?")
    for node in root.children[2:]:
        if node.head in _UNSUPPORTED:
            raise source.unsupported(node, f"found '({node.head}': {_UNSUPPORTED[node.head]}")
        if node.head not in sections:
            raise source.error(node, f"found {start_of(node)!r}, expected a section; {nearest(node.head, sections)}")


def _check_problem(source: Source, domain: str, file: str) -> None:
    places = {node.head: node for node in source.root.children}
    named = [one.lower for one in section(source, ":domain")]
    if named not in ([], [domain.lower()]):
        message = f"found {start_of(places[':domain'])!r}, expected '(:domain {domain})', as {file} is called"
        raise source.error(places[":domain"], message)
    goals, metric = section(source, ":goal"), section(source, ":metric")
    if len(goals) != 1:
        message = f"found {len(goals)} conditions in (:goal ...), expected one; join them with (and ...)"
        raise source.error(places.get(":goal", source.root), message)
    if metric and (len(metric) != 2 or metric[0].lower != "minimize"):
        message = f"found {start_of(places[':metric'])!r}, expected '(:metric minimize (NAME))'"
        raise source.unsupported(places[":metric"], f"{message}; instead of maximizing, minimize what is lost")
