"""A plain twin of BehaviorTree.CPP's scripts: read by binding powers, evaluated from the outside in.

Entries are values of a dict: bool, int and float as they were made, None for one that has no value yet.
"""

import math
import operator
import re

TOKEN = re.compile(
    r"'[^']*'|0[xX][0-9a-fA-F]+|\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|@?\w+|[-+*/:]=|[=!<>]=|&&|\|\||\.\.|\S"
)
EXCLUDED = {"<": operator.ge, ">": operator.le, "<=": operator.gt, ">=": operator.lt}
BITS = {"&": operator.and_, "|": operator.or_, "^": operator.xor}
BINDS = {"||": 1, "&&": 2, **dict.fromkeys((*EXCLUDED, "==", "!="), 3), "|": 4, "^": 4, "&": 5}
BINDS |= {"+": 6, "-": 6, "..": 6, "*": 7, "/": 7}


class Thrown(Exception):
    """What BehaviorTree.CPP would throw in the middle of a tick."""


def run(code, board, enums):
    """Run a script on entries; return the value of its last statement."""
    tokens, result = TOKEN.findall(code), None
    while tokens:
        statement = assignment(tokens)
        while tokens[:1] == [";"]:
            tokens.pop(0)
        result = value(statement, board, enums)
    return result


def assignment(tokens):
    left = choice(tokens)
    if tokens and tokens[0] in (":=", "=", "+=", "-=", "*=", "/="):
        return (tokens.pop(0), left, assignment(tokens))
    return left


def choice(tokens):
    asked = binary(tokens, 1)
    if tokens[:1] != ["?"]:
        return asked
    tokens.pop(0)
    yes = assignment(tokens)
    assert tokens.pop(0) == ":"
    return ("?", asked, yes, choice(tokens))


def binary(tokens, least):
    left, chain = prefix(tokens), []
    while tokens and BINDS.get(tokens[0], 0) >= least:
        sign = tokens.pop(0)
        right = binary(tokens, BINDS[sign] + 1)
        if BINDS[sign] != 3:
            left = (sign, left, right)
        elif chain:
            chain += [sign, right]
        else:
            chain = [left, sign, right]
            left = ("chain", chain)
    return left


def prefix(tokens):
    token = tokens.pop(0)
    if token in "!-~":
        return ("prefix", token, prefix(tokens))
    if token == "(":
        inner = assignment(tokens)
        assert tokens.pop(0) == ")"
        return ("inner", inner)
    return ("leaf", token)


def value(node, board, enums):
    kind, *parts = node

    def of(part):
        return value(part, board, enums)

    if kind == "inner":
        return of(parts[0])
    if kind == "leaf":
        return leaf(parts[0], board, enums)
    if kind == "prefix":
        return prefixed(parts[0], of(parts[1]))
    if kind == "?":
        asked = of(parts[0])
        asked = number_of(asked, {}) if isinstance(asked, str) else asked
        return of(parts[1] if double(asked) else parts[2])
    if kind == "chain":
        values, one = parts[0], of(parts[0][0])
        for sign, right in zip(values[1::2], values[2::2], strict=True):
            other = of(right)
            if not compared(sign, one, other, enums):
                return 0.0
            one = other
        return 1.0
    if kind in BINDS:
        return joined(kind, of(parts[0]), of(parts[1]))
    return assigned(kind, parts[0], lambda: of(parts[1]), board, enums)


def leaf(token, board, enums):
    if token[0] == "'":
        return token[1:-1]
    if token in ("true", "false"):
        return float(token == "true")
    if token[:2] in ("0x", "0X"):
        return int(token, 16)
    if token[0].isdigit():
        return float(token) if not token.isdigit() else int(token) if int(token) < 2**63 else 0
    if token in enums:
        return float(enums[token])
    if token not in board:
        raise Thrown
    return board[token]


def double(one):
    if not isinstance(one, int | float) or (isinstance(one, int) and abs(one) >= 2**53):
        raise Thrown
    return float(one)


def whole(one):
    if not isinstance(one, int | float) or one != one or abs(one) >= 2**63 or one != int(one):
        raise Thrown
    return int(one)


def truth(one):
    if isinstance(one, float):
        return one != 0
    if one is None or isinstance(one, str) or one not in (0, 1):
        raise Thrown
    return one == 1


def number_of(text, enums):
    if text in enums:
        return float(enums[text])
    try:
        return float(text)
    except ValueError:
        raise Thrown from None


def prefixed(sign, one):
    if sign == "~":
        return double(~whole(math.trunc(one) if math.isfinite(one) else one))
    return -double(one) if sign == "-" else float(double(one) == 0)


def joined(sign, one, other):
    if one is None or other is None:
        raise Thrown
    texts = isinstance(one, str) + isinstance(other, str)
    if texts:
        if not (sign == ".." or (sign == "+" and texts == 2)):
            raise Thrown
        return "".join(
            side
            if isinstance(side, str)
            else f"{side:f}"
            if isinstance(side, float)
            else f"{side:d}"
            for side in (one, other)
        )
    if sign in BITS:
        return double(BITS[sign](whole(one), whole(other)))
    if sign in ("&&", "||"):
        sides = (truth(one), truth(other))
        return float(all(sides) if sign == "&&" else any(sides))
    one, other = double(one), double(other)
    if sign == "/" and other == 0:
        is_negative = (one < 0) != (math.copysign(1, other) < 0)
        return math.nan if one == 0 or one != one else -math.inf if is_negative else math.inf
    if sign == "..":
        raise Thrown
    return {"+": one + other, "-": one - other, "*": one * other, "/": other and one / other}[sign]


def compared(sign, one, other, enums):
    if not (isinstance(one, str) and isinstance(other, str)):
        named = {**enums, "true": 1, "false": 0}
        one, other = (
            double(number_of(side, named) if isinstance(side, str) else side)
            for side in (one, other)
        )
    if sign in EXCLUDED:
        return not EXCLUDED[sign](one, other)
    is_equal = one == other if isinstance(one, str) else abs(one - other) < 2**-23
    return is_equal == (sign == "==")


def assigned(sign, target, given, board, enums):
    while target[0] == "inner":
        target = target[1]
    if (
        target[0] != "leaf"
        or not re.match(r"[@A-Za-z_]", target[1])
        or target[1] in ("true", "false")
    ):
        raise Thrown
    name = target[1]
    if name not in board:
        if sign != ":=":
            raise Thrown
        board[name] = None
    new = given()
    held = board[name]
    if new is None:
        raise Thrown
    if sign not in (":=", "="):
        if (
            held is None
            or isinstance(held, str) != isinstance(new, str)
            or (isinstance(held, str) and sign != "+=")
        ):
            raise Thrown
        new = joined(sign[0], held, new)
    if isinstance(held, int | float) and isinstance(new, str):
        held = new = number_of(new, {**enums, "true": 1, "false": 0})
    if isinstance(held, str) and not isinstance(new, str):
        raise Thrown
    if isinstance(held, float):
        new = double(new)
    elif isinstance(held, int):
        new = whole(new)
        new = bool(new) if isinstance(held, bool) and new in (0, 1) else new
    board[name] = new
    return new
