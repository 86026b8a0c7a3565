"""Scripts of BehaviorTree.CPP 4.10: `a := 1; b = a > 2 ? 'x' .. a : 'y'`; all arithmetic and logic give doubles."""

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final

from rosa_bt.xml.blackboard import (
    EMPTY,
    Blackboard,
    ScriptError,
    as_text,
    begun,
    double,
    fit,
    is_number,
    number_in,
    truth,
    whole,
)

if TYPE_CHECKING:
    from lark import Lark

ParsedScript = Callable[[Blackboard], Any]
"""Runs a script on a blackboard, and returns the value of its last statement."""
_Parts = list[Any]
"""The parts of an expression: operands, with the operators between them."""


_EPSILON: Final = 2.0**-23  # numbers that differ by less are equal; `<` and `>` are exact
_MAX_NESTED: Final = 50


def _quotient(one: float, other: float) -> float:
    if other:
        return one / other
    return (
        math.nan
        if one == 0 or math.isnan(one)
        else math.copysign(math.inf, one) * math.copysign(1, other)
    )


def _equal(one: Any, other: Any) -> bool:  # noqa: ANN401  # two texts or two numbers
    return bool(one == other) if isinstance(one, str) else abs(one - other) < _EPSILON


_ARITHMETIC: Final[Mapping[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": _quotient,
}
_BITS: Final = {"&": operator.and_, "|": operator.or_, "^": operator.xor}
_COMPARED: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    "==": _equal,
    "!=": lambda one, other: not _equal(one, other),
    "<": lambda one, other: not one >= other,  # nan is both less and greater than any number
    ">": lambda one, other: not one <= other,
    "<=": lambda one, other: not one > other,
    ">=": lambda one, other: not one < other,
}


def _joined(sign: str, one: Any, other: Any) -> Any:  # noqa: ANN401  # values of any kind
    if one is EMPTY or other is EMPTY:
        raise ScriptError(f"an operand of {sign!r} has no value")
    numbers = is_number(one), is_number(other)
    texts = isinstance(one, str), isinstance(other, str)
    if all(numbers) and sign in _ARITHMETIC:
        return _ARITHMETIC[sign](double(one), double(other))
    if all(numbers) and sign in _BITS:
        return double(_BITS[sign](whole(one), whole(other)))
    if all(numbers) and sign in ("&&", "||"):
        left, right = truth(one), truth(other)
        return float(left and right if sign == "&&" else left or right)
    if (all(texts) and sign == "+") or (
        sign == ".." and texts != (False, False) and sum(numbers) + sum(texts) == 2
    ):
        return as_text(one) + as_text(other)
    raise ScriptError(f"{sign!r} does not work with {one!r} and {other!r}")


def _is_so(sign: str, one: Any, other: Any, board: Blackboard) -> bool:  # noqa: ANN401  # values of any kind
    if isinstance(one, str) and isinstance(other, str):
        return _COMPARED[sign](one, other)
    sides = [number_in(side, board) if isinstance(side, str) else side for side in (one, other)]
    if not all(map(is_number, sides)):
        raise ScriptError(f"{one!r} and {other!r} cannot be compared")
    return _COMPARED[sign](*map(double, sides))


def _assign(parts: _Parts, board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    target, sign, value = parts
    if not isinstance(target, _Name):
        raise ScriptError("the left side of an assignment has to be a name")
    name = target.name
    if sign != ":=" and board.entry(name) is None:
        raise ScriptError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
    entry, given = board.make(name), value(board)
    if given is EMPTY:
        raise ScriptError(f"the value that is assigned to {name!r} is empty")
    held = entry.value
    if sign in ("+=", "-=", "*=", "/="):
        if (
            held is EMPTY
            or isinstance(held, str) != isinstance(given, str)
            or (isinstance(held, str) and sign != "+=")
        ):
            raise ScriptError(f"{sign!r} does not work with {held!r} and {given!r}")
        new = fit(entry, _joined(sign[0], held, given))
    elif (
        isinstance(given, str)
        and not isinstance(held, str)
        and not (held is EMPTY and entry.declared is None)
    ):
        new = number_in(given, board) if entry.declared is None else entry.read(given)
    else:
        new = fit(entry, given)
    entry.put(new)
    return new


def _fold(parts: _Parts, board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    value = parts[0](board)
    for sign, right in zip(parts[1::2], parts[2::2], strict=True):
        value = _joined(sign, value, right(board))
    return value


def _compare(parts: _Parts, board: Blackboard) -> float:
    one = parts[0](board)
    for sign, right in zip(parts[1::2], parts[2::2], strict=True):
        other = right(board)
        if not _is_so(sign, one, other, board):
            return 0.0
        one = other
    return 1.0


def _choose(parts: _Parts, board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    asked, yes, no = parts
    value = asked(board)
    if isinstance(value, str):
        value = begun(value)
    if not is_number(value):
        raise ScriptError(f"{value!r} is neither true nor false")
    return yes(board) if double(value) else no(board)


def _prefixed(parts: _Parts, board: Blackboard) -> float:
    sign, operand = parts
    value = operand(board)
    if not is_number(value):
        raise ScriptError(f"{sign!r} does not work with {value!r}")
    if sign == "~":  # of the whole part of a number
        return double(~whole(math.trunc(value) if math.isfinite(value) else value))
    return -double(value) if sign == "-" else float(not double(value))


@dataclass(frozen=True, slots=True)
class _Name:
    """Reads an enum, or else an entry; also the target of an assignment."""

    name: str

    def __call__(self, board: Blackboard) -> Any:  # noqa: ANN401  # a value of any kind
        if self.name in board.enums:
            return float(board.enums[self.name])
        entry = board.entry(self.name)
        if entry is None:
            raise ScriptError(f"there is no {self.name!r} on the blackboard (yet)")
        return entry.value


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
        statements = [_made(one, 0) for one in _parser().parse(code).children]
    except (UnexpectedCharacters, UnexpectedToken) as error:
        there = (
            code[error.pos_in_stream or 0]
            if isinstance(error, UnexpectedCharacters)
            else error.token
        )
        problem = f"cannot be read at {str(there) or 'the end'!r}; texts stand in single quotes"
        raise ScriptError(f"the script {code!r} {problem}") from None
    return lambda board: [statement(board) for statement in statements][-1]


def _made(part: Any, depth: int) -> Any:  # noqa: ANN401  # a tree or a token of lark, which is not typed
    """Return a function that evaluates a part of a script; an operator is returned as its text."""
    if depth > _MAX_NESTED:
        raise ScriptError(f"a script has at most {_MAX_NESTED} nested operators")
    if not isinstance(part, str):
        return partial(
            _DOES.get(part.data, _fold), [_made(one, depth + 1) for one in part.children]
        )
    kind, text = getattr(part, "type", ""), str(part)
    if kind == "NAME" and text not in ("true", "false"):
        return _Name(text)
    if kind not in ("NUMBER", "TEXT", "NAME"):
        return text
    constant = (
        text[1:-1]
        if kind == "TEXT"
        else _number(text)
        if kind == "NUMBER"
        else float(text == "true")
    )
    return lambda board: constant


_DOES: Final = {"assign": _assign, "choose": _choose, "compare": _compare, "prefixed": _prefixed}


def _number(text: str) -> int | float:
    if text.isdigit() or text[:2] in ("0x", "0X"):
        number = int(text, 10 if text.isdigit() else 16)
        return number if number < 2**63 else 0
    return float(text)
