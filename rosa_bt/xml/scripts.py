"""Scripts of BehaviorTree.CPP 4.10: `a := 1; b = a > 2 ? 'x' .. a : 'y'`; all arithmetic and logic give doubles."""

import math
import operator
import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

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

Script = Callable[[Blackboard], Any]
"""What a script does to a blackboard; returns the value of its last statement."""


_EPSILON: Final = 2.0**-23  # numbers that are nearer than this are equal, but not less or more
_MAX_NESTED: Final = 50


def _quotient(one: float, other: float) -> float:
    if other:
        return one / other
    return math.nan if one == 0 or math.isnan(one) else math.copysign(math.inf, one) * math.copysign(1, other)


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
    "<": lambda one, other: not one >= other,  # nan is less than all, and more
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
    if (all(texts) and sign == "+") or (sign == ".." and texts != (False, False) and sum(numbers) + sum(texts) == 2):
        return as_text(one) + as_text(other)
    raise ScriptError(f"{sign!r} is not for {one!r} and {other!r}")


def _is_so(sign: str, one: Any, other: Any, board: Blackboard) -> bool:  # noqa: ANN401  # values of any kind
    if isinstance(one, str) and isinstance(other, str):
        return _COMPARED[sign](one, other)
    sides = [number_in(side, board) if isinstance(side, str) else side for side in (one, other)]
    if not all(map(is_number, sides)):
        raise ScriptError(f"{one!r} and {other!r} cannot be compared")
    return _COMPARED[sign](*map(double, sides))


def _assign(target: Script, sign: str, value: Script, board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    if not isinstance(target, _Name):
        raise ScriptError("what is assigned to is no entry")
    name = target.name
    if sign != ":=" and board.entry(name) is None:
        raise ScriptError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
    entry, given = board.make(name), value(board)
    if given is EMPTY:
        raise ScriptError(f"what is assigned to {name!r} has no value")
    held = entry.value
    if sign in ("+=", "-=", "*=", "/="):
        if held is EMPTY or isinstance(held, str) != isinstance(given, str) or (isinstance(held, str) and sign != "+="):
            raise ScriptError(f"{sign!r} is not for {held!r} and {given!r}")
        new = fit(entry, _joined(sign[0], held, given))
    elif isinstance(given, str) and not isinstance(held, str) and not (held is EMPTY and entry.declared is None):
        new = number_in(given, board) if entry.declared is None else entry.read(given)
    else:
        new = fit(entry, given)
    entry.put(new)
    return new


@dataclass(frozen=True, slots=True)
class _Name:
    """Reads an enum, or else an entry; what is assigned to is one."""

    name: str

    def __call__(self, board: Blackboard) -> Any:  # noqa: ANN401  # a value of any kind
        if self.name in board.enums:
            return float(board.enums[self.name])
        entry = board.entry(self.name)
        if entry is None:
            raise ScriptError(f"there is no {self.name!r} on the blackboard (yet)")
        return entry.value


# -------------------------------------------------------------------- reading


_TOKEN: Final = re.compile(
    r"""[ \t\r\n]*(?:
    (?P<number>0[xX][0-9a-fA-F]+|\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)(?![\w]|\.(?!\.))
  | (?P<text>'[^']*')
  | (?P<name>@?[A-Za-z_]\w*|@\w+)
  | (?P<sign>:=|\+=|-=|\*=|/=|==|!=|<=|>=|&&|\|\||\.\.|[-<>=!();?:|^&+*/~])
  | (?P<other>\S)
)""",
    re.VERBOSE | re.ASCII,
)
_ASSIGNING: Final = (":=", "=", "+=", "-=", "*=", "/=")
_LEVELS: Final = (("||",), ("&&",), tuple(_COMPARED), ("|", "^"), ("&",), ("+", "-", ".."), ("*", "/"))
"""Signs between two values, those that bind least first."""


def parse_script(code: str) -> Script:
    """Read a script.

    Raises:
        ScriptError: it cannot be read; says where.
    """
    parser, statements = _Parser(code), []
    while not parser.is_at_end():
        statements.append(parser.expression())
        while parser.took(";"):
            pass
    if not statements:
        raise ScriptError("the script is empty")
    return lambda board: [statement(board) for statement in statements][-1]


class _Parser:
    """Reads expressions by descending from what binds least to what binds most."""

    def __init__(self, code: str) -> None:
        self._code = code
        found = [(str(match.lastgroup), match[match.lastgroup]) for match in _TOKEN.finditer(code) if match.lastgroup]
        self._left = deque([*found, ("end", "the end")])
        self._depth = 0
        for kind, text in found:
            if kind == "other":
                raise self._refused(text)

    def is_at_end(self) -> bool:
        return len(self._left) == 1

    def took(self, *signs: str) -> str:
        kind, text = self._left[0]
        return self._left.popleft()[1] if kind == "sign" and text in signs else ""

    def expression(self) -> Script:
        left = self._choice()
        sign = self.took(*_ASSIGNING)
        return partial(_assign, left, sign, self._deeper(self.expression)) if sign else left

    def _refused(self, text: str) -> ScriptError:
        return ScriptError(f"the script {self._code!r} cannot be read at {text!r}; texts stand in single quotes")

    def _deeper(self, read: Callable[[], Script], closing: str = "") -> Script:
        self._depth += 1
        if self._depth > _MAX_NESTED:
            raise ScriptError(f"a script has at most {_MAX_NESTED} parentheses and signs in each other")
        inner = read()
        self._depth -= 1
        if closing and not self.took(closing):
            raise self._refused(self._left[0][1])
        return inner

    def _choice(self) -> Script:
        asked = self._level(0)
        if not self.took("?"):
            return asked
        return partial(_choose, asked, self._deeper(self.expression, ":"), self._deeper(self._choice))

    def _level(self, level: int) -> Script:
        """Read what binds at least as much as the signs of a level."""
        if level == len(_LEVELS):
            return self._operand()
        left, chain = self._level(level + 1), []
        while sign := self.took(*_LEVELS[level]):
            chain.append((sign, self._level(level + 1)))
        return partial(_compare if _LEVELS[level] == tuple(_COMPARED) else _fold, left, chain) if chain else left

    def _operand(self) -> Script:
        if sign := self.took("!", "-", "~"):
            return partial(_prefixed, sign, self._deeper(self._operand))
        if self.took("("):
            return self._deeper(self.expression, ")")
        kind, text = self._left.popleft()
        if kind == "name" and text not in ("true", "false"):
            return _Name(text)
        if kind not in ("number", "text", "name"):
            raise self._refused(text)
        constant = text[1:-1] if kind == "text" else _number(text) if kind == "number" else float(text == "true")
        return lambda board: constant


def _number(text: str) -> int | float:
    if text.isdigit() or text[:2] in ("0x", "0X"):
        number = int(text, 10 if text.isdigit() else 16)
        return number if number < 2**63 else 0
    return float(text)


def _fold(left: Script, chain: list[tuple[str, Script]], board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    value = left(board)
    for sign, right in chain:
        value = _joined(sign, value, right(board))
    return value


def _compare(left: Script, chain: list[tuple[str, Script]], board: Blackboard) -> float:
    one = left(board)
    for sign, right in chain:
        other = right(board)
        if not _is_so(sign, one, other, board):
            return 0.0
        one = other
    return 1.0


def _choose(asked: Script, yes: Script, no: Script, board: Blackboard) -> Any:  # noqa: ANN401  # of any kind
    value = asked(board)
    if isinstance(value, str):
        value = begun(value)
    if not is_number(value):
        raise ScriptError(f"{value!r} is neither true nor false")
    return yes(board) if double(value) else no(board)


def _prefixed(sign: str, operand: Script, board: Blackboard) -> float:
    value = operand(board)
    if not is_number(value):
        raise ScriptError(f"{sign!r} is not for {value!r}")
    if sign == "~":  # of what is not whole, the whole part
        return double(~whole(math.trunc(value) if math.isfinite(value) else value))
    return -double(value) if sign == "-" else float(not double(value))
