"""Scripts of BehaviorTree.CPP 4.10: `a := 1; b = a > 2 ? 'x' .. a : 'y'`.

All arithmetic and logic give doubles.
"""

import math
import operator
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

from py_trees.common import Status

from rosa_bt.xml.blackboard import Blackboard
from rosa_bt.xml.values import (
    EMPTY,
    ScriptError,
    Value,
    as_text,
    begun,
    converted,
    double,
    fit,
    is_number,
    truth,
    whole,
)

if TYPE_CHECKING:
    from lark import Lark

ParsedScript = Callable[[Blackboard], Value]
"""Runs a script on a blackboard, and returns the value of its last statement."""

_EPSILON = 2.0**-23  # numbers that differ by less are equal; `<` and `>` are exact


def _quotient(left: float, right: float) -> float:
    if right:
        return left / right
    if left == 0 or math.isnan(left):
        return math.nan
    return math.copysign(math.inf, left) * math.copysign(1, right)


def _is_equal(left: Value, right: Value) -> bool:
    return bool(left == right) if isinstance(left, str) else abs(left - right) < _EPSILON


_OPERATORS: Mapping[str, tuple[Callable[[Value], Any], Callable[[Any, Any], Any]]] = {
    "+": (double, operator.add),
    "-": (double, operator.sub),
    "*": (double, operator.mul),
    "/": (double, _quotient),
    "&": (whole, operator.and_),
    "|": (whole, operator.or_),
    "^": (whole, operator.xor),
    "&&": (truth, operator.and_),
    "||": (truth, operator.or_),
}
"""How each operator reads its two numbers, and what it does with them."""
_COMPARISONS: Mapping[str, Callable[[Value, Value], bool]] = {
    "==": _is_equal,
    "!=": lambda left, right: not _is_equal(left, right),
    "<": lambda left, right: not left >= right,  # nan is both less and greater than any number
    ">": lambda left, right: not left <= right,
    "<=": lambda left, right: not left > right,
    ">=": lambda left, right: not left < right,
}


def _operate(sign: str, left: Value, right: Value) -> Value:
    sides = (left, right)
    if sign in _OPERATORS and all(map(is_number, sides)):
        read, operate = _OPERATORS[sign]
        return double(operate(read(left), read(right)))
    texts = sum(isinstance(side, str) for side in sides)
    others = sum(map(is_number, sides))
    if (sign in ("+", "..") and texts == 2) or (sign == ".." and texts == others == 1):
        return as_text(left) + as_text(right)
    raise ScriptError(f"{sign!r} does not work with {left!r} and {right!r}")


class _Run:
    """Evaluates the trees and tokens of lark on a blackboard; methods have the names of rules."""

    def __init__(self, board: Blackboard) -> None:
        self._board = board

    def value(self, part: Any) -> Value:  # noqa: ANN401  # a tree or token of lark
        if not isinstance(part, str):
            return getattr(self, part.data, self.fold)(*part.children)
        text = str(part)
        if text[0] in "'\"":
            return text[1:-1]
        if text[0].isdigit():
            return _read_number(text)
        if text in ("true", "false"):
            return float(text == "true")
        if text in self._board.root.enums:
            return float(self._board.root.enums[text])
        entry = self._board.entry(text)
        if entry is None:
            raise ScriptError(f"there is no {text!r} on the blackboard (yet)")
        return entry.value

    def assign(self, target: Any, sign: str, expression: Any) -> Value:  # noqa: ANN401  # a node of the grammar
        board = self._board
        name = str(target)
        if getattr(target, "type", "") != "NAME" or name in ("true", "false"):
            raise ScriptError("the left side of an assignment has to be a name")
        if sign != ":=" and board.entry(name) is None:
            raise ScriptError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
        entry = board.make(name)
        value = self.value(expression)
        if value is EMPTY:
            raise ScriptError(f"the value that is assigned to {name!r} is empty")
        before = entry.value
        is_untyped = before is EMPTY and entry.declared is None
        if sign not in (":=", "="):
            if isinstance(before, str) != isinstance(value, str):
                raise ScriptError(f"{sign!r} does not work with {before!r} and {value!r}")
            value = fit(_operate(sign[0], before, value), before)
        elif isinstance(before, str) or not isinstance(value, str) or is_untyped:
            value = fit(value, before)
        elif entry.declared is None:
            value = self._number(value)
        elif entry.declared is Status:
            raise ScriptError(f"a script cannot write {value!r} to an entry for an outcome")
        else:
            value = converted(value, entry.declared)
        entry.put(value)
        return value

    def choose(self, condition: Any, yes: Any, no: Any) -> Value:  # noqa: ANN401  # a node of the grammar
        value = self.value(condition)
        if isinstance(value, str):
            value = begun(value)
        return self.value(yes if double(value) else no)

    def fold(self, first: Any, *rest: Any) -> Value:  # noqa: ANN401  # a node of the grammar
        value = self.value(first)
        for sign, right in zip(rest[::2], rest[1::2], strict=True):
            value = _operate(sign, value, self.value(right))
        return value

    def compare(self, first: Any, *rest: Any) -> float:  # noqa: ANN401  # a node of the grammar
        left = self.value(first)
        for sign, part in zip(rest[::2], rest[1::2], strict=True):
            right = self.value(part)
            sides = [left, right]
            if not all(isinstance(side, str) for side in sides):
                sides = [self._number(side) for side in sides]
            if not _COMPARISONS[sign](*sides):
                return 0.0
            left = right
        return 1.0

    def prefixed(self, sign: str, operand: Any) -> float:  # noqa: ANN401  # a node of the grammar
        value = self.value(operand)
        if sign == "~":  # of the whole part of a number
            is_finite = is_number(value) and math.isfinite(value)
            return double(~whole(math.trunc(value) if is_finite else value))
        return -double(value) if sign == "-" else float(not double(value))

    def _number(self, value: Value) -> float:
        """Return the number that a value means; `true`, `false` and enums are numbers."""
        if isinstance(value, str):
            named = {**self._board.root.enums, "true": 1.0, "false": 0.0}
            value = named[value] if value in named else begun(value)
        return double(value)


def _read_number(text: str) -> int | float:
    if text.isdigit() or text[:2] in ("0x", "0X"):
        number = int(text, 10 if text.isdigit() else 16)
        return number if number < 2**63 else 0
    return float(text)


@cache
def _parser() -> "Lark":
    from lark import Lark

    return Lark.open("scripts.lark", rel_to=__file__, parser="lalr", lexer="basic")


def parse_script(code: str) -> ParsedScript:
    """Parse a script.

    Raises:
        ScriptError: the script cannot be read; the message says where.
    """
    from lark.exceptions import UnexpectedCharacters, UnexpectedToken

    if not code.strip(" \t\r\n"):
        raise ScriptError("the script is empty")
    try:
        statements = _parser().parse(code).children
    except UnexpectedCharacters as error:
        place = code[error.pos_in_stream or 0]
    except UnexpectedToken as error:
        place = str(error.token) or "the end"
    else:
        return lambda board: [_Run(board).value(statement) for statement in statements][-1]
    problem = f"cannot be read at {place!r}; texts stand in single quotes"
    raise ScriptError(f"the script {code!r} {problem}")
