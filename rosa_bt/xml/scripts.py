"""The scripts that are read: assignments and comparisons of keys and constants; `a := 1; b == 'x' && !(c < 2)`."""

import operator
import re
from collections.abc import Callable, MutableMapping
from typing import Any, Final, Protocol

from rosa_bt.exceptions import RosaBtError

__all__ = ["Script", "ScriptError", "parse_script", "truth"]


class ScriptError(RosaBtError, ValueError):
    """A script is not one of those that are read, or fails when it is run."""


class Script(Protocol):
    """What a script does to a blackboard; returns the value of its last statement."""

    def __call__(self, blackboard: MutableMapping[str, Any], /) -> Any:  # noqa: ANN401  # a value of any type
        """Run it."""


MAX_NESTED: Final = 50
"""Parentheses and negations in one script."""

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
_COMPARISONS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


_WORDS: Final = {"true": True, "false": False}


def parse_script(code: str) -> Script:
    """Read a script.

    Raises:
        ScriptError: it holds more than assignments (`:=`, `=`), comparisons, `&&`, `||`, `!` and parentheses.
    """
    return _Parser(code).script()


def truth(value: object) -> bool:
    """Return what a value means where a condition is expected; a port's text "true" or "false" is what it says."""
    value = _WORDS.get(value, value) if isinstance(value, str) else value
    if isinstance(value, bool | int | float):
        return bool(value)
    raise ScriptError(f"{value!r} is neither true nor false; compare it with something")


class _Parser:
    def __init__(self, code: str) -> None:
        self._code = code
        found = [match for match in _TOKEN.finditer(code) if match.lastgroup]
        self._tokens = [(str(match.lastgroup), match.group(str(match.lastgroup))) for match in found]
        self._at = 0
        if sum(text in ("(", "!") for _, text in self._tokens) > MAX_NESTED:
            raise ScriptError(f"a script has at most {MAX_NESTED} parentheses and negations; ask a condition instead")
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

        def run(blackboard: MutableMapping[str, Any]) -> Any:  # noqa: ANN401  # a value of any type
            value = None
            for statement in statements:
                value = statement(blackboard)
            return value

        return run

    def _refused(self, text: str) -> ScriptError:
        return ScriptError(
            f"{text!r} in the script {self._code!r} is not read; scripts here are assignments (:=, =) and comparisons "
            "(== != < <= > >=) of keys and constants, joined by && || ! and parentheses; compute in a behaviour"
        )

    def _next(self) -> tuple[str, str]:
        return self._tokens[self._at] if self._at < len(self._tokens) else ("end", "the end")

    def _took(self, *signs: str) -> str:
        kind, text = self._next()
        if kind != "sign" or text not in signs:
            return ""
        self._at += 1
        return text

    def _statement(self) -> Script:
        kind, name = self._next()
        if kind == "name" and self._at + 1 < len(self._tokens) and self._tokens[self._at + 1][1] in (":=", "="):
            self._at += 1
            is_new = self._took(":=", "=") == ":="
            return _assignment(name, self._either(), is_new)
        return self._either()

    def _either(self) -> Script:
        left = self._both()
        while self._took("||"):
            left = _joined(left, self._both(), any)
        return left

    def _both(self) -> Script:
        left = self._comparison()
        while self._took("&&"):
            left = _joined(left, self._comparison(), all)
        return left

    def _comparison(self) -> Script:
        left = self._operand()
        sign = self._took(*_COMPARISONS)
        return _compared(left, self._operand(), sign) if sign else left

    def _operand(self) -> Script:
        if self._took("!"):
            inner = self._operand()
            return lambda blackboard: not truth(inner(blackboard))
        if self._took("("):
            inner = self._either()
            if not self._took(")"):
                raise self._refused(self._next()[1])
            return inner
        minus = bool(self._took("-"))
        kind, text = self._next()
        self._at += 1
        if kind == "number":
            number = (int(text) if text.isdigit() else float(text)) * (-1 if minus else 1)
            return lambda blackboard: number
        if minus or kind not in ("name", "string"):
            raise self._refused("-" if minus else text)
        return _constant(text[1:-1]) if kind == "string" else _variable(text)


def _constant(value: object) -> Script:
    return lambda blackboard: value


def _variable(name: str) -> Script:
    if name in _WORDS:
        return _constant(_WORDS[name])

    def read(blackboard: MutableMapping[str, Any]) -> Any:  # noqa: ANN401  # a value of any type
        if name not in blackboard:
            raise ScriptError(f"there is no {name!r} on the blackboard (yet)")
        return blackboard[name]

    return read


def _assignment(name: str, value: Script, is_new: bool) -> Script:
    def assign(blackboard: MutableMapping[str, Any]) -> Any:  # noqa: ANN401  # a value of any type
        result = value(blackboard)
        if not is_new and name not in blackboard:
            raise ScriptError(f"there is no {name!r} on the blackboard; `{name} := ...` makes it")
        blackboard[name] = result
        return result

    return assign


def _joined(left: Script, right: Script, how: Callable[[list[bool]], bool]) -> Script:
    return lambda blackboard: how([truth(left(blackboard)), truth(right(blackboard))])


def _compared(left: Script, right: Script, sign: str) -> Script:
    def compare(blackboard: MutableMapping[str, Any]) -> bool:
        one, other = left(blackboard), right(blackboard)
        if not (isinstance(one, str) and isinstance(other, str)):
            one, other = _number(one), _number(other)
        return bool(_COMPARISONS[sign](one, other))

    return compare


def _number(value: object) -> float:
    try:
        return float(_WORDS.get(value, value) if isinstance(value, str) else value)  # type: ignore[arg-type]  # what has no number is refused below
    except (TypeError, ValueError):
        raise ScriptError(f"{value!r} cannot be compared with a number") from None
