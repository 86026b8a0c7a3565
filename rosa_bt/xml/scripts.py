"""The scripts that are read: assignments and comparisons of keys and constants; `a := 1; b == 'x' && !(c < 2)`."""

import operator
import re
from collections.abc import Callable, Mapping, MutableMapping
from functools import partial
from typing import Any, Final

from kb.status import OPERATORS
from rosa_bt.exceptions import RosaBtError

Board = MutableMapping[str, Any]
Script = Callable[[Board], Any]
"""What a script does to a blackboard; returns the value of its last statement."""


class ScriptError(RosaBtError, ValueError):
    """A script is not one of those that are read, or fails when it is run."""


def truth(value: object) -> bool:
    """Return what a value means where a condition is expected; a port's text "true" or "false" is what it says."""
    value = _WORDS.get(value, value) if isinstance(value, str) else value
    if isinstance(value, int | float):
        return bool(value)
    raise ScriptError(f"{value!r} is neither true nor false; compare it with something")


def parse_script(code: str) -> Script:
    """Read a script.

    Raises:
        ScriptError: it holds more than assignments (`:=`, `=`), comparisons, `&&`, `||`, `!` and parentheses.
    """
    return _Parser(code).script()


def _compared(compare: Callable[[Any, Any], bool], one: object, other: object) -> bool:
    """Compare as numbers what is not text on both sides."""
    both_text = isinstance(one, str) and isinstance(other, str)
    return compare(one, other) if both_text else compare(_number(one), _number(other))


def _number(value: object) -> float:
    try:
        return float(_WORDS.get(value, value) if isinstance(value, str) else value)  # type: ignore[arg-type]  # what has no number is refused below
    except (TypeError, ValueError):
        raise ScriptError(f"{value!r} cannot be compared with a number") from None


_WORDS: Final = {"true": True, "false": False}
_SIGNS: Final[tuple[Mapping[str, Callable[[Any, Any], bool]], ...]] = (
    {"||": lambda one, other: truth(one) | truth(other)},
    {"&&": lambda one, other: truth(one) & truth(other)},
    {
        sign: partial(_compared, compare)
        for sign, compare in {**OPERATORS, "==": operator.eq, "!=": operator.ne}.items()
    },
)
"""Signs between two values, those that bind least first; both sides are always evaluated, as in BehaviorTree.CPP."""
_MAX_NESTED: Final = 50
_TOKEN: Final = re.compile(
    r"""\s*(?:
    (?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?)
  | (?P<string>'[^']*'|"[^"]*")
  | (?P<name>@?[A-Za-z_]\w*)
  | (?P<sign>:=|==|!=|<=|>=|&&|\|\||[<>=!();-])
  | (?P<other>\+=|-=|\*=|/=|\.\.|\S)
)""",
    re.VERBOSE,
)


class _Parser:
    def __init__(self, code: str) -> None:
        self._code = code
        found = [match for match in _TOKEN.finditer(code) if match.lastgroup]
        self._tokens = [(str(match.lastgroup), match.group(str(match.lastgroup))) for match in found]
        self._at = 0
        if sum(text in ("(", "!") for _, text in self._tokens) > _MAX_NESTED:
            raise ScriptError(f"a script has at most {_MAX_NESTED} parentheses and negations; ask a condition instead")
        for kind, text in self._tokens:
            if kind == "other":
                raise self._refused(text)

    def script(self) -> Script:
        statements = []
        while self._at < len(self._tokens):
            statements.append(self._statement())
            if self._at < len(self._tokens) and not self._took(";"):
                raise self._refused(self._next()[1])
        if not statements:
            raise ScriptError("the script is empty")
        return lambda board: [statement(board) for statement in statements][-1]

    def _refused(self, text: str) -> ScriptError:
        return ScriptError(
            f"{text!r} in the script {self._code!r} is not read; scripts here are assignments (:=, =) and comparisons "
            "(== != < <= > >=) of keys and constants, joined by && || ! and parentheses; compute in a behaviour"
        )

    def _next(self, ahead: int = 0) -> tuple[str, str]:
        at = self._at + ahead
        return self._tokens[at] if at < len(self._tokens) else ("end", "the end")

    def _took(self, *signs: str) -> str:
        kind, text = self._next()
        if kind != "sign" or text not in signs:
            return ""
        self._at += 1
        return text

    def _statement(self) -> Script:
        kind, name = self._next()
        if kind == "name" and self._next(1) in (("sign", ":="), ("sign", "=")):
            self._at += 1
            is_new = self._took(":=", "=") == ":="
            return partial(_assign, name, self._value(), is_new)
        return self._value()

    def _value(self, level: int = 0) -> Script:
        """Read what binds at least as much as the signs of a level; comparisons, the last level, are not chained."""
        if level == len(_SIGNS):
            return self._operand()
        value = self._value(level + 1)
        while sign := self._took(*_SIGNS[level]):
            value = partial(_join, _SIGNS[level][sign], value, self._value(level + 1))
            if level == len(_SIGNS) - 1:
                break
        return value

    def _operand(self) -> Script:
        if self._took("!"):
            inner = self._operand()
            return lambda board: not truth(inner(board))
        if self._took("("):
            inner = self._value()
            if not self._took(")"):
                raise self._refused(self._next()[1])
            return inner
        minus = self._took("-")
        kind, text = self._next()
        self._at += 1
        if minus and kind != "number":
            raise self._refused(minus)
        if kind == "number":
            constant: object = int(minus + text) if text.isdigit() else float(minus + text)
        elif kind == "string":
            constant = text[1:-1]
        elif text in _WORDS:
            constant = _WORDS[text]
        elif kind == "name":
            return partial(_read, text)
        else:
            raise self._refused(text)
        return lambda board: constant


def _join(join: Callable[[Any, Any], bool], left: Script, right: Script, board: Board) -> bool:
    return join(left(board), right(board))


def _read(name: str, board: Board) -> Any:  # noqa: ANN401  # a value of any type
    if name not in board:
        raise ScriptError(f"there is no {name!r} on the blackboard (yet)")
    return board[name]


def _assign(name: str, value: Script, is_new: bool, board: Board) -> Any:  # noqa: ANN401  # a value of any type
    result = value(board)
    if not is_new and name not in board:
        raise ScriptError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
    board[name] = result
    return result
