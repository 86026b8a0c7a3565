"""How much an author writes: statements and lines of Python, TypeQL and PDDL."""

import ast
import inspect
import io
import re
import sys
import tokenize
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from types import FunctionType, ModuleType
from typing import Final, NamedTuple, TypeVar

from py_trees.behaviour import Behaviour
from py_trees.composites import Composite
from py_trees.decorators import Decorator

from kb import KnowledgeBaseError
from missions.engine.mission import MissionError

__all__ = ["Module", "Written", "built", "code_lines", "python_written", "typeql_written"]

T = TypeVar("T")

_NO_CODE: Final = frozenset(
    {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
)
_TYPEQL_ASIDE: Final = re.compile(r"""#[^\n]*|"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*'""", re.DOTALL)
"""A comment or a text."""
_IMPORTS: Final = (ast.Import, ast.ImportFrom)
_NAMED: Final = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class Written(NamedTuple):
    """How much is written.

    Attributes:
        statements: in Python each statement, however many lines it takes; in TypeQL what ends with a semicolon.
        lines: those that have code on them.
    """

    statements: int
    lines: int

    def __str__(self) -> str:
        return f"{self.statements} / {self.lines}"

    def plus(self, other: "Written") -> "Written":
        """Return both together."""
        return Written(self.statements + other.statements, self.lines + other.lines)


@dataclass(frozen=True)
class Module:
    """The source of a Python module.

    Attributes:
        module: itself.
        definitions: the statements at its top that give names, by name.
        code: numbers of the lines with code: none that are blank, comment, docstring or import only.
    """

    module: ModuleType
    definitions: dict[str, ast.stmt]
    code: frozenset[int]

    @classmethod
    def of(cls, name: str) -> "Module | None":
        """Return a module that is loaded; None if its source is not to be had."""
        module = sys.modules.get(name)
        try:
            text = inspect.getsource(module) if module else ""
            tree = ast.parse(text)
        except (OSError, TypeError, SyntaxError):
            return None
        if not module or not text:
            return None
        definitions = {name: node for node in tree.body for name in _given(node)}
        aside = {line for node in ast.walk(tree) if _is_aside(node) for line in _span(node)}
        return cls(module, definitions, frozenset(_lines_of_code(text) - aside))

    def measure(self, name: str) -> Written:
        """Return how much the definition of a name takes."""
        node = self.definitions[name]
        statements = sum(isinstance(one, ast.stmt) and not _is_aside(one) for one in ast.walk(node))
        return Written(statements, len(self.code & set(_span(node))))

    def used(self, name: str) -> Iterator[tuple[str, object]]:
        """Yield the names that the definition of another takes from its module, with what they mean there."""
        inside = list(ast.walk(self.definitions[name]))
        own = {one.arg for one in inside if isinstance(one, ast.arg)}
        own |= {one.id for one in inside if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}
        for node in inside:
            if isinstance(node, ast.Name) and node.id not in own:
                yield node.id, vars(self.module).get(node.id)
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                owner = vars(self.module).get(node.value.id)
                if isinstance(owner, ModuleType):
                    yield "", getattr(owner, node.attr, None)


def python_written(build: Callable[..., object]) -> Written | None:
    """Measure the function that builds a model or a tree, with what it is made of; None if its source is not to be had.

    That is: the functions of the same package that it calls, and the constants and other definitions in the same files
    that these name. No part of it are the behaviours at the leaves of a tree, which say how a thing is done, and
    whatever comes from other packages.
    """
    while isinstance(build, partial):
        build = build.func
    modules: dict[str, Module | None] = {}
    package = str(getattr(build, "__module__", "")).partition(".")[0]
    waiting, seen, total = [_place(build)], set(), Written(0, 0)
    while waiting:
        place = waiting.pop()
        if place in seen:
            continue
        seen.add(place)
        where, name = place
        if where not in modules:
            modules[where] = Module.of(where)
        module = modules[where]
        if module is None or name not in module.definitions:
            continue
        total = total.plus(module.measure(name))
        waiting += _parts(module, name, package)
    return total if total.statements else None


def built(title: str, kind: type[T], build: Callable[..., object], *given: object) -> T:
    """Call what an author wrote.

    Args:
        title: what it builds, for messages.
        kind: what has to come of it.
        build: the author's function.
        given: its arguments.

    Raises:
        MissionError: it raises something, or returns something else; what the knowledge base raises stays as it is.
    """
    try:
        made = build(*given)
    except KnowledgeBaseError:
        raise
    except Exception as error:  # whatever the author's code may raise
        raise MissionError(f"cannot build {title}: {type(error).__name__}: {error}") from error
    if not isinstance(made, kind):
        raise MissionError(f"{title} is {made!r}, not a {kind.__name__}")
    return made


def typeql_written(text: str) -> Written:
    """Measure the text of a TypeQL file."""
    bare = _TYPEQL_ASIDE.sub(lambda found: "" if found[0].startswith("#") else "''", text)
    return Written(bare.count(";"), code_lines(text, "#"))


def code_lines(text: str, comment: str) -> int:
    """Return how many lines are neither blank nor a comment, which begins with the given sign."""
    return sum(bool(line.strip()) and not line.lstrip().startswith(comment) for line in text.splitlines())


def _parts(module: Module, name: str, package: str) -> Iterator[tuple[str, str]]:
    """Yield where what a definition is made of stands."""
    for used, meaning in module.used(name):
        if isinstance(meaning, FunctionType) and meaning.__module__.partition(".")[0] == package:
            yield _place(meaning)
        elif used in module.definitions and not _is_leaf(meaning):
            yield module.module.__name__, used


def _place(build: Callable[..., object]) -> tuple[str, str]:
    named = inspect.unwrap(build) if hasattr(build, "__qualname__") else type(build)
    return named.__module__, named.__qualname__.partition(".")[0]


def _is_leaf(meaning: object) -> bool:
    return (
        isinstance(meaning, type) and issubclass(meaning, Behaviour) and not issubclass(meaning, Composite | Decorator)
    )


def _given(node: ast.stmt) -> Iterable[str]:
    """Return the names that a statement gives."""
    if isinstance(node, _NAMED):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _is_aside(node: ast.AST) -> bool:
    """Tell whether something is an import or a docstring, which a string by itself is taken for."""
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    return isinstance(node, _IMPORTS) or is_text


def _span(node: ast.AST) -> range:
    """Return the numbers of the lines of a statement, with its decorators."""
    if not isinstance(node, ast.stmt):
        return range(0)
    decorators = node.decorator_list if isinstance(node, _NAMED) else []
    return range(min([node.lineno, *(one.lineno for one in decorators)]), (node.end_lineno or node.lineno) + 1)


def _lines_of_code(text: str) -> set[int]:
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return {line for one in tokens if one.type not in _NO_CODE for line in range(one.start[0], one.end[0] + 1)}
