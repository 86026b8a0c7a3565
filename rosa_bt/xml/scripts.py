"""Scripts of BehaviorTree.CPP 4.10: `a := 1; b = a > 2 ? 'x' .. a : 'y'`.

All arithmetic and logic give doubles.
"""

import math
import operator
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from py_trees.common import Status

from rosa_bt.xml.blackboard import (
    CASTS,
    Blackboard,
    NodeError,
    Value,
    as_text,
    begun,
    convert,
    double,
    is_number,
    truth,
    whole,
)

ParsedScript = Callable[[], Value]
"""Runs a script on a blackboard, and returns the value of its last statement; None if empty."""

_EPSILON = 2.0**-23  # numbers that differ by less are equal; `<` and `>` are exact


def _quotient(left: float, right: float) -> float:
    return left / right if right else left * math.copysign(math.inf, right)


def is_equal(left: Value, right: Value) -> bool:
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
    "==": is_equal,
    "!=": lambda left, right: not is_equal(left, right),
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}


def _operate(sign: str, left: Value, right: Value) -> Value:
    sides = (left, right)
    if sign in _OPERATORS and all(map(is_number, sides)):
        read, operate = _OPERATORS[sign]
        return double(operate(read(left), read(right)))
    texts = sum(isinstance(side, str) for side in sides)
    is_joined = sign == ".." and texts and None not in sides
    if is_joined or (sign == "+" and texts == 2):
        return as_text(left) + as_text(right)
    raise NodeError(f"{sign!r} does not work with {left!r} and {right!r}")


def _fit(value: Value, before: Value) -> Value:
    """Return a value as the kind of value that an entry had before."""
    kind = type(before)
    if is_number(before) and is_number(value):
        if kind is bool and value not in (0, 1):
            kind = int
        return CASTS[kind](value)
    if before is None or kind is type(value):
        return value
    raise NodeError(f"{value!r} does not fit an entry that holds {before!r}")


class _Run:
    """Evaluates trees and tokens of lark; methods have the names of rules and terminals."""

    def __init__(self, board: Blackboard) -> None:
        self._board = board
        self._enums = {"true": 1, "false": 0, **board.root.enums}

    def value(self, part: Any) -> Value:  # noqa: ANN401  # a tree or token of lark
        if isinstance(part, str):
            return getattr(self, part.type)(str(part))  # type: ignore[attr-defined]  # it is a token
        return getattr(self, part.data)(*part.children)

    def TEXT(self, text: str) -> str:  # as in the grammar
        return text[1:-1]

    def NUMBER(self, text: str) -> int | float:  # as in the grammar
        if text.isdigit() or "x" in text.lower():
            number = int(text, 10 if text.isdigit() else 16)
            return number if number < 2**63 else 0
        return float(text)

    def NAME(self, text: str) -> Value:  # as in the grammar
        if text in self._enums:
            return float(self._enums[text])
        entry = self._board.entry(text)
        if entry is None:
            raise NodeError(f"there is no {text!r} on the blackboard (yet)")
        return entry.value

    def assign(self, target: Any, sign: str, expression: Any) -> Value:  # noqa: ANN401  # a node of the grammar
        board = self._board
        name = str(target)
        if getattr(target, "type", "") != "NAME":
            raise NodeError("the left side of an assignment has to be a name")
        if sign != ":=" and board.entry(name) is None:
            raise NodeError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
        entry = board.make(name)
        value = self.value(expression)
        before = entry.value
        if sign not in (":=", "="):
            value = _operate(sign[0], before, value)
        elif isinstance(value, str) and not isinstance(before, str):
            if before is not None and entry.declared is None:
                value = self._number(value)
            elif entry.declared is Status:
                raise NodeError(f"a script cannot write {value!r} to an entry for an outcome")
            value = convert(value, entry.declared)
            before = None
        entry.put(_fit(value, before))
        return entry.value

    def choose(self, condition: Any, yes: Any, no: Any) -> Value:  # noqa: ANN401  # a node of the grammar
        return self.value(yes if self._number(self.value(condition)) else no)

    def binary(self, left: Any, sign: str, right: Any) -> Value:  # noqa: ANN401  # nodes of the grammar
        return _operate(sign, self.value(left), self.value(right))

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
        number = double(self.value(operand))
        if sign == "~":
            return double(~whole(number))
        return -number if sign == "-" else float(not number)

    def _number(self, value: Value) -> float:
        """Return the number that a value means; `true`, `false` and enums are numbers."""
        if isinstance(value, str):
            value = self._enums[value] if value in self._enums else begun(value)
        return double(value)


@cache
def _parser() -> Any:  # noqa: ANN401  # lark is imported late
    from lark import Lark

    return Lark.open("scripts.lark", rel_to=__file__, parser="lalr", lexer="basic")


def parse_script(code: str, board: Blackboard) -> ParsedScript:
    """Parse a script that runs on a blackboard.

    Raises:
        NodeError: the script cannot be read; the message says where.
    """
    from lark.exceptions import UnexpectedInput

    try:
        statements = _parser().parse(code).children
    except UnexpectedInput as error:
        place = code[error.pos_in_stream or 0 :]
        problem = f"cannot be read from {place!r} on; texts stand in single quotes"
        raise NodeError(f"the script {code!r} {problem}") from None
    run = _Run(board)
    return lambda: [None, *map(run.value, statements)][-1]
