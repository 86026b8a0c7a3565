"""Scripts of BehaviorTree.CPP 4.10: `a := 1; b = a > 2 ? 'x' .. a : 'y'`, with its kinds of values and their rules.

A whole number is an int, a double a float, a text a str; what the program or a port made a bool stays one. All
arithmetic, comparisons and logic give doubles.
"""

import math
import operator
import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from rosa_bt.exceptions import RosaBtError

if TYPE_CHECKING:
    from rosa_bt.xml.ports import Blackboard, Entry

Script = Callable[["Blackboard"], Any]
"""What a script does to a blackboard; returns the value of its last statement."""


class ScriptError(RosaBtError, ValueError):
    """A script cannot be read, or fails when it is run."""


class _Empty:
    """The value of an entry that has none yet."""

    def __repr__(self) -> str:
        return "nothing"


EMPTY: Final = _Empty()
_EXACT: Final = 2**53
"""From here on, whole numbers are no doubles any more."""
_EPSILON: Final = 2.0**-23
"""Numbers that are nearer than this are equal, but not less or more."""
_NUMBER: Final = re.compile(
    r"\s*[-+]?(?:0x[0-9a-f]+|inf|nan|(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)", re.IGNORECASE | re.ASCII
)
_MAX_NESTED: Final = 50


# -------------------------------------------------------------------- values


def is_number(value: object) -> bool:
    return isinstance(value, int | float)


def double(value: Any) -> float:  # noqa: ANN401  # a number of any kind
    if isinstance(value, int) and abs(value) >= _EXACT:
        raise ScriptError(f"{value} is too large for a double to hold exactly")
    return float(value)


def whole(value: Any) -> int:  # noqa: ANN401  # a number of any kind
    if isinstance(value, float) and not value.is_integer():
        raise ScriptError(f"{value:g} is not whole, and a whole number is needed")
    return int(value)


def truth(value: object) -> bool:
    """Return what a value means where a condition is expected: a double not 0, a whole number 0 or 1, never a text."""
    if isinstance(value, float) or value in (0, 1):
        return bool(value)
    raise ScriptError(f"{_shown(value)} is neither true nor false; compare it with something")


def _shown(value: object) -> str:
    return "what has no value" if value is EMPTY else repr(value)


def number_in(text: str, board: "Blackboard") -> float:
    """Return the number that a text says, or `true`, `false` or an enum."""
    named = {**board.enums, "true": 1.0, "false": 0.0}
    return float(named[text]) if text in named else _begun(text)


def _begun(text: str) -> float:
    """Return the number that a text begins with, as the C library reads it."""
    found = _NUMBER.match(text)
    if found is None:
        raise ScriptError(f"{text!r} is no number")
    return float(int(found[0], 16)) if "x" in found[0].lower() else float(found[0])


def as_text(value: object) -> str:
    """Write a value as `..` does: a double with six digits."""
    return f"{value:.6f}" if isinstance(value, float) else str(int(value) if isinstance(value, bool) else value)


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
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
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
    raise ScriptError(f"{sign!r} is not for {_shown(one)} and {_shown(other)}")


def _is_so(sign: str, one: Any, other: Any, board: "Blackboard") -> bool:  # noqa: ANN401  # values of any kind
    if isinstance(one, str) and isinstance(other, str):
        return _COMPARED[sign](one, other)
    sides = [number_in(side, board) if isinstance(side, str) else side for side in (one, other)]
    if not all(map(is_number, sides)):
        raise ScriptError(f"{_shown(one)} and {_shown(other)} cannot be compared")
    return _COMPARED[sign](*map(double, sides))


# -------------------------------------------------------------------- entries


def fit(entry: "Entry", value: Any) -> Any:  # noqa: ANN401  # a value of any kind
    """Return a value as the entry takes it, of the kind that it holds.

    Raises:
        ScriptError: it cannot be of that kind.
    """
    held = entry.value
    if held is EMPTY or (isinstance(held, str) and isinstance(value, str)):
        return value
    if is_number(held) and is_number(value):
        if isinstance(held, float):
            return double(value)
        number = whole(value)
        return bool(number) if isinstance(held, bool) and number in (0, 1) else number
    if type(held) is type(value) and not is_number(held):
        return value
    raise ScriptError(f"{_shown(value)} does not fit an entry that holds {_shown(held)}")


def _assign(target: Script | str, sign: str, value: Script, board: "Blackboard") -> Any:  # noqa: ANN401  # any kind
    if not isinstance(target, str):
        raise ScriptError("what is assigned to is no entry")
    entry = board.entry(target)
    if entry is None:
        if sign != ":=":
            raise ScriptError(f"there is no {target!r} on the blackboard; `{target} := ...` makes it")
        entry = board.make(target)
    given = value(board)
    if given is EMPTY:
        raise ScriptError(f"what is assigned to {target!r} has no value")
    held = entry.value
    if sign in ("+=", "-=", "*=", "/="):
        if held is EMPTY or isinstance(held, str) != isinstance(given, str) or (isinstance(held, str) and sign != "+="):
            raise ScriptError(f"{sign!r} is not for {_shown(held)} and {_shown(given)}")
        new = fit(entry, _joined(sign[0], held, given))
    elif isinstance(given, str) and not isinstance(held, str) and not (held is EMPTY and entry.declared is None):
        new = number_in(given, board) if entry.declared is None else entry.read(given)
    else:
        new = fit(entry, given)
    entry.put(new)
    return new


def _read(name: str, board: "Blackboard") -> Any:  # noqa: ANN401  # a value of any kind
    if name in board.enums:
        return float(board.enums[name])
    entry = board.entry(name)
    if entry is None:
        raise ScriptError(f"there is no {name!r} on the blackboard (yet)")
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
    parser = _Parser(code)
    return parser.script()


class _Parser:
    def __init__(self, code: str) -> None:
        self._code = code
        found = [match for match in _TOKEN.finditer(code) if match.lastgroup]
        self._tokens = [(str(match.lastgroup), match.group(str(match.lastgroup))) for match in found]
        self._at = 0
        self._depth = 0
        for kind, text in self._tokens:
            if kind == "other":
                raise self._refused(text)

    def script(self) -> Script:
        statements = []
        while self._at < len(self._tokens):
            statements.append(self._value(self._expression()))
            while self._took(";"):
                pass
        if not statements:
            raise ScriptError("the script is empty")
        return lambda board: [statement(board) for statement in statements][-1]

    def _refused(self, text: str) -> ScriptError:
        return ScriptError(f"the script {self._code!r} cannot be read at {text!r}; texts stand in single quotes")

    def _next(self) -> tuple[str, str]:
        return self._tokens[self._at] if self._at < len(self._tokens) else ("end", "the end")

    def _took(self, *signs: str) -> str:
        kind, text = self._next()
        if kind != "sign" or text not in signs:
            return ""
        self._at += 1
        return text

    def _need(self, sign: str) -> None:
        if not self._took(sign):
            raise self._refused(self._next()[1])

    @staticmethod
    def _value(read: Script | str) -> Script:
        """Return what evaluates an expression; a name by itself is a str until it is read or assigned to."""
        return partial(_read, read) if isinstance(read, str) else read

    def _expression(self) -> Script | str:
        left = self._choice()
        sign = self._took(*_ASSIGNING)
        return partial(_assign, left, sign, self._value(self._deeper(self._expression))) if sign else left

    def _deeper(self, read: Callable[[], Script | str]) -> Script | str:
        self._depth += 1
        if self._depth > _MAX_NESTED:
            raise ScriptError(f"a script has at most {_MAX_NESTED} parentheses and signs in each other")
        inner = read()
        self._depth -= 1
        return inner

    def _choice(self) -> Script | str:
        asked = self._level(0)
        if not self._took("?"):
            return asked
        yes = self._value(self._deeper(self._expression))
        self._need(":")
        return partial(_choose, self._value(asked), yes, self._value(self._deeper(self._choice)))

    def _level(self, level: int) -> Script | str:
        """Read what binds at least as much as the signs of a level."""
        if level == len(_LEVELS):
            return self._operand()
        left = self._level(level + 1)
        chain: list[tuple[str, Script]] = []
        while sign := self._took(*_LEVELS[level]):
            chain.append((sign, self._value(self._level(level + 1))))
        if not chain:
            return left
        return partial(_compare if level == _LEVELS.index(tuple(_COMPARED)) else _fold, self._value(left), chain)

    def _operand(self) -> Script | str:
        if sign := self._took("!", "-", "~"):
            return partial(_prefixed, sign, self._value(self._deeper(self._operand)))
        if self._took("("):
            inner = self._deeper(self._expression)
            self._need(")")
            return inner
        kind, text = self._next()
        self._at += 1
        if kind == "name" and text not in ("true", "false"):
            return text
        if kind not in ("number", "text", "name"):
            raise self._refused(text)
        constant = text[1:-1] if kind == "text" else _number(text) if kind == "number" else float(text == "true")
        return lambda board: constant


def _number(text: str) -> int | float:
    if text.isdigit() or text[:2] in ("0x", "0X"):
        number = int(text, 10 if text.isdigit() else 16)
        return number if number < 2**63 else 0
    return float(text)


def _fold(left: Script, chain: list[tuple[str, Script]], board: "Blackboard") -> Any:  # noqa: ANN401  # any kind
    value = left(board)
    for sign, right in chain:
        value = _joined(sign, value, right(board))
    return value


def _compare(left: Script, chain: list[tuple[str, Script]], board: "Blackboard") -> float:
    one = left(board)
    for sign, right in chain:
        other = right(board)
        if not _is_so(sign, one, other, board):
            return 0.0
        one = other
    return 1.0


def _choose(asked: Script, yes: Script, no: Script, board: "Blackboard") -> Any:  # noqa: ANN401  # any kind
    value = asked(board)
    if isinstance(value, str):
        value = _begun(value)
    if not is_number(value):
        raise ScriptError(f"{_shown(value)} is neither true nor false")
    return yes(board) if double(value) else no(board)


def _prefixed(sign: str, operand: Script, board: "Blackboard") -> float:
    value = operand(board)
    if not is_number(value):
        raise ScriptError(f"{sign!r} is not for {_shown(value)}")
    if sign == "~":
        return double(~whole(value))
    return -double(value) if sign == "-" else float(not double(value))
