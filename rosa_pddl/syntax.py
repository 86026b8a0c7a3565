"""Parses the lists, sections and formulas of PDDL, and keeps the place of each word for error messages."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from rosa_pddl.domain import Derived, Domain, UpThing, conjuncts
from rosa_pddl.exceptions import PddlError, UnknownNameError, UnsupportedPddlError, nearest
from rosa_pddl.validate import text_of

NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
NUMBER: Final = re.compile(r"[-+]?([0-9]+(/[0-9]+)?|[0-9]+\.[0-9]*|\.[0-9]+)(e[-+]?[0-9]{1,3})?")
# a type may follow the hyphen without a space
_TOKEN = re.compile(r";[^\n]*|\s+|[()]|-(?=[A-Za-z])|[^\s();]+")

COMPARISONS: Final = ("<", ">", "<=", ">=")
CHANGES: Final = ("assign", "increase", "decrease", "scale-up", "scale-down")
_CONNECTIVES = ("and", "or", "not", "imply", "when", "forall", "exists")
_MOST_NESTED = 100
BODY: Final[Mapping[str, tuple[str, ...]]] = {
    ":action": (":parameters", ":precondition", ":effect"),
    ":durative-action": (":parameters", ":duration", ":condition", ":effect"),
}
"""The parts of an action's description, by the section."""

# In the order that unified-planning's reader requires.
_DOMAIN = (
    "domain",
    ":requirements",
    ":types",
    ":constants",
    ":predicates",
    ":functions",
    ":derived",
    *BODY,
)
_PROBLEM = ("problem", ":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
# What unified-planning or the executor does not support, with advice.
_UNSUPPORTED = {
    ":process": "it changes numbers while time passes; ENHSP (up-enhsp) would do",
    ":event": "it happens by itself; ENHSP (up-enhsp) would do",
    **dict.fromkeys(
        (":task", ":method", ":htn"),
        "hierarchies are not executed here; Aries (up-aries) by itself would do",
    ),
    ":utility": "no installed engine takes utilities. Leave them out and add soft goals: goals.add(TEXT, worth=COST)",
    ":constraints": "what shall hold on the way is not planned for; SymK (up-symk) after compilation would do",
}


@dataclass(frozen=True)
class Node:
    """A word, or a list in parentheses, which has no word; line and column are 0 if it is not from a file."""

    word: str | None
    children: tuple["Node", ...]
    line: int
    column: int

    @property
    def is_list(self) -> bool:
        return self.word is None

    @property
    def lower(self) -> str:
        """The word in lower case, as PDDL compares words; empty for a list."""
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
    """A PDDL file: its name for messages, and its single outermost list."""

    file: str
    root: Node

    def error(self, node: Node, message: str) -> PddlError:
        return PddlError(message, self.file, node.line or None, node.column or None)

    def unsupported(self, node: Node, message: str) -> UnsupportedPddlError:
        return UnsupportedPddlError(message, self.file, node.line or None, node.column or None)


def listed(*parts: Node | str) -> Node:
    """Make a list with the place of its first part that is a node, or with no place."""
    place = next((part for part in parts if isinstance(part, Node)), ANY)
    children = tuple(
        replace(place, word=part, children=()) if isinstance(part, str) else part for part in parts
    )
    return replace(place, word=None, children=children)


def start_of(node: Node) -> str:
    text = str(node)
    return text if len(text) <= 40 else text[:37] + "..."


def typed(
    source: Source, nodes: Iterable[Node], *, are_variables: bool = False
) -> list[tuple[Node, Node | None]]:
    """Read a typed list such as `a b - t c`; return each name with its type, or with None."""
    found: list[tuple[Node, Node | None]] = []
    waiting: list[Node] = []
    before, last = "", ANY
    for node in nodes:
        expects_type, before, last = before == "-", str(node), node
        is_either = expects_type and node.head == "either" and len(node.children) > 1
        if is_either and not are_variables:
            message = "found '(either ...)': an object has one type, and a type one above it; only variables may have"
            raise source.unsupported(node, f"{message} several. Declare a type above them")
        if node.is_list and not is_either:
            raise source.error(
                node, f"found {start_of(node)!r}, expected {'a type' if expects_type else 'a name'}"
            )
        if expects_type:
            found += [(name, node) for name in waiting]
            waiting = []
        elif node.word != "-":
            if are_variables and not node.lower.startswith("?"):
                raise source.error(
                    node, f"found {node.word!r}, expected a variable such as '?{node.word}'"
                )
            waiting.append(node)
    if before == "-":
        raise source.error(last, "found '-' at the end, expected a type after it")
    return found + [(name, None) for name in waiting]


def glued_types(source: Source) -> Iterator[str]:
    """Yield a sentence for each place where a type follows the hyphen without a space, as in `?r -robot`."""
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
    """Parse PDDL text into its single outermost list; error messages name `file` and what was `expected`."""
    stack: list[_Open] = []
    root: Node | None = None
    for token, line, column in _tokens(text):
        if root is not None:
            raise PddlError(
                f"found {token!r} after the end of {expected}, expected nothing more",
                file,
                line,
                column,
            )
        if token == "(":
            if len(stack) == _MOST_NESTED:
                raise PddlError(
                    f"more than {_MOST_NESTED} lists in one another", file, line, column
                )
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
    """Parse a text that is not a line of a file."""
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
    """Refuse a section that is not directly in (define ...): it shows which parenthesis was left open."""
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
    return [
        child
        for head in heads
        for node in sections
        if node.head == head
        for child in node.children[1:]
    ]


def body_of(source: Source, schema: Node) -> dict[str, Node]:
    if (
        len(schema.children) < 2
        or schema.children[1].is_list
        or schema.children[1].lower.startswith(":")
    ):
        raise source.error(
            schema, f"found {start_of(schema)!r}, expected '({schema.head} NAME ...)'"
        )
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
        if keyword.lower in parts:
            raise source.error(
                keyword,
                f"found {keyword.word!r} again in {schema.head} {name}; join the two with (and ...)",
            )
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
        raise source.error(
            title, f"found {start_of(title)!r}, expected '({what} NAME)'; is this the {what} file?"
        )
    for node in root.children[2:]:
        if node.head in _UNSUPPORTED:
            raise source.unsupported(node, f"found '({node.head}': {_UNSUPPORTED[node.head]}")
        if node.head not in sections:
            raise source.error(
                node,
                f"found {start_of(node)!r}, expected a section; {nearest(node.head, sections)}",
            )


def _check_problem(source: Source, domain: str, file: str) -> None:
    places = {node.head: node for node in source.root.children}
    named = [one.lower for one in section(source, ":domain")]
    if named not in ([], [domain.lower()]):
        message = f"found {start_of(places[':domain'])!r}, expected '(:domain {domain})', as {file} is called"
        raise source.error(places[":domain"], message)
    goals, metric = section(source, ":goal"), section(source, ":metric")
    if len(goals) != 1:
        message = (
            f"found {len(goals)} conditions in (:goal ...), expected one; join them with (and ...)"
        )
        raise source.error(places.get(":goal", source.root), message)
    if metric and (len(metric) != 2 or metric[0].lower != "minimize"):
        message = f"found {start_of(places[':metric'])!r}, expected '(:metric minimize (NAME))'"
        raise source.unsupported(
            places[":metric"], f"{message}; instead of maximizing, minimize what is lost"
        )


# ---------------------------------------------------------------- formulas as unified-planning's expressions


Scope = Mapping[str, UpThing]
"""Variables, such as `?x`, with their unified-planning expressions."""


@dataclass(frozen=True)
class Goal:
    """A condition that is not a conjunction, such as one goal of a mission.

    Args:
        text: the condition as PDDL text, in the names of the files.
        expression: the condition as a unified-planning expression.
        worth: how much more a plan may cost to reach it; None if it must be reached.
    """

    text: str
    expression: UpThing
    worth: float | None = None

    @property
    def is_soft(self) -> bool:
        """Whether a plan may give it up if it costs more than it is worth."""
        return self.worth is not None

    def __str__(self) -> str:
        return self.text if self.worth is None else f"{self.text} worth {self.worth:g}"


def conditions(domain: Domain, text: str, worth: float | None = None) -> tuple[Goal, ...]:
    """Read a condition; a conjunction is split into its parts."""
    where = f"condition {text.strip()!r}"
    source = parse(text, where, "(predicate object)")
    if not source.root.children:
        raise PddlError("found (), expected a list such as '(predicate object)'", where)
    formulas = Formulas(domain, source, lambda _, message: UnknownNameError(f"{where}: {message}"))
    parts = conjuncts([formulas.condition(source.root, {}, "a goal")])
    return tuple(Goal(text_of(domain, part, {}), part, worth) for part in parts)


class Formulas:
    """Converts formulas into unified-planning expressions."""

    def __init__(
        self,
        domain: Domain,
        source: Source,
        unknown: Callable[[Node, str], Exception] | None = None,
    ) -> None:
        self._domain, self.source, self._unknown = domain, source, unknown or source.error
        self._problem = domain.up_problem
        self.manager = domain.up_problem.environment.expression_manager

    def condition(self, node: Node, scope: Scope, place: str) -> UpThing:
        head, rest = node.head, node.children[1:]
        if node.is_list and not node.children:
            return self.manager.TRUE()
        if head in COMPARISONS or (head == "=" and any(part.is_list for part in rest)):
            return self._comparison(node, scope, place)
        if head == "preference":
            message = f"found {start_of(node)!r}: no installed engine takes preferences; LPG (up-lpg) by itself would "
            message += "do. Leave it out and add it as a soft goal: goals.add(TEXT, worth=COST)"
            raise self.source.unsupported(node, message)
        if head in ("forall", "exists"):
            inner, within, body = self.quantified(node, scope)
            if not inner:
                raise self.source.error(
                    node, f"found {start_of(node)!r}, expected a variable such as '?x' in it"
                )
            variables = [variable.variable() for variable in inner.values()]
            held = self.condition(body, {**scope, **inner}, place)
            if not within.is_true():
                held = (self.manager.Implies if head == "forall" else self.manager.And)(
                    within, held
                )
            return (self.manager.Forall if head == "forall" else self.manager.Exists)(
                held, *variables
            )
        if head == "=":
            self._expect(node, 2)
            return self.manager.Equals(*(self._term(part, scope) for part in rest))
        if head in ("and", "or", "not", "imply"):
            parts = [self.condition(part, scope, place) for part in rest]
            if head in ("and", "or"):
                return (self.manager.And if head == "and" else self.manager.Or)(parts)
            self._expect(node, 1 if head == "not" else 2)
            return (self.manager.Not if head == "not" else self.manager.Implies)(*parts)
        return self.atom(node, scope, is_condition=True)

    def derived(self, rules: Sequence[Node], layer: int) -> Derived:
        """Return the definition of a derived predicate, made from all of its rules."""
        variables, conditions = tuple[UpThing, ...](), list[UpThing]()
        for _, target, body in [rule.children for rule in rules]:
            scope = self._variables(target.children[1:], {})
            kinds = [one.variable().type for one in scope.values()]
            # named by numbers, as rules may use the same names for different variables
            variables = variables or tuple(
                self._variable(str(number), kind) for number, kind in enumerate(kinds)
            )
            if [one.type for one in variables] != kinds:
                raise self.source.error(
                    target, f"found {start_of(target)!r}, expected the types of the rule before"
                )
            renamed = dict(zip(scope, variables, strict=True))
            within = self.within(target.children[1:], renamed)
            place = f"what {target.head} is derived from"
            conditions.append(self.manager.And(within, self.condition(body, renamed, place)))
        return Derived(variables, self.manager.Or(conditions), layer)

    def quantified(self, node: Node, outer: Scope) -> tuple[Scope, UpThing, Node]:
        """Return the variables of a quantifier, the condition that checks their types, and the formula in it."""
        if len(node.children) != 3 or not node.children[1].is_list:
            raise self.source.error(
                node, f"found {start_of(node)!r}, expected '({node.head} (?x - type) (...))'"
            )
        names = node.children[1].children
        scope = self._variables(names, outer)
        return scope, self.within(names, scope), node.children[2]

    def within(self, names: Sequence[Node], scope: Scope) -> UpThing:
        """Return the condition that checks variables of a type `(either ...)`; true if there are none."""
        manager, parts = self.manager, list[UpThing]()
        for name, kind in typed(self.source, names, are_variables=True):
            if kind is not None and kind.head == "either":
                ways = [self._variable("either.", self.type_of(part)) for part in kind.children[1:]]
                same = [
                    manager.Exists(manager.Equals(scope[name.lower], one), one.variable())
                    for one in ways
                ]
                parts.append(manager.Or(same))
        return manager.And(parts)

    def _variables(self, names: Sequence[Node], outer: Scope) -> Scope:
        """Return new variables; one that hides a variable or a parameter of the scope around it gets another name."""
        found, taken = dict[str, UpThing](), set(map(str, outer.values()))
        for name, kind in typed(self.source, names, are_variables=True):
            word = name.lower[1:]
            while word in taken:
                word += "_"
            taken.add(word)
            found[name.lower] = self._variable(word, self.type_of(kind or ANY))
        return found

    def _variable(self, name: str, kind: UpThing) -> UpThing:
        from unified_planning.model import Variable

        return self.manager.VariableExp(Variable(name, kind, self._problem.environment))

    def type_of(self, node: Node) -> UpThing:
        """Return a type; for several, as in `(either a b)`, their nearest common ancestor."""
        if node.is_list:
            first, *others = [self.type_of(part) for part in node.children[1:]]
            above = (
                kind for kind in first.ancestors if all(kind in other.ancestors for other in others)
            )
            return next(above, None) or self.type_of(ANY)
        name = self._domain.inside.get(("type", node.lower))
        if name is None:
            raise self._unknown_name("type", node, ())
        return self._problem.user_type(name)

    def atom(
        self, node: Node, scope: Scope, *, is_condition: bool = False, is_number: bool = False
    ) -> UpThing:
        if not node.head:
            raise self.source.error(
                node, f"found {start_of(node)!r}, expected a list such as '(predicate object)'"
            )
        inside = self._domain.inside.get(("predicate", node.head))
        if node.head in self._domain.axioms and not is_condition:
            message = (
                f"found {start_of(node)!r}, which is derived: it is neither stated nor changed"
            )
            raise self.source.error(node, message)
        if inside is None:
            raise self._unknown_name("predicate", node.children[0], (*_CONNECTIVES, *CHANGES))
        fluent = self._problem.fluent(inside)
        if fluent.type.is_bool_type() is is_number:
            found, hint = (
                ("predicate", "number")
                if is_number
                else ("number", "predicate; compare it, as in (> (x) 0)")
            )
            raise self.source.error(
                node, f"found {start_of(node)!r}, which is a {found}, expected a {hint}"
            )
        arguments = [self._term(part, scope) for part in node.children[1:]]
        name, signature = self._domain.outside[inside], fluent.signature
        if len(arguments) != len(signature):
            file, line = self._domain.places.get(("predicate", name), (self._domain.file, None))
            message = f"found {len(arguments)} arguments of {str(node.children[0])!r}, expected {len(signature)}"
            place = f" as declared in line {line} of {file}" if line else ""
            raise self._unknown(node.children[0], message + place)
        if not all(
            one.type.is_compatible(given.type)
            for one, given in zip(signature, arguments, strict=True)
        ):
            typed_as = (f"?{one.name} - {self._domain.outside[one.type.name]}" for one in signature)
            message = f"the arguments of {name!r} are of other types than declared: ({' '.join([name, *typed_as])})"
            raise self._unknown(node, message)
        return fluent(*arguments)

    def _comparison(self, node: Node, scope: Scope, place: str) -> UpThing:
        self._expect(node, 2)
        known = self._domain.computed
        heads = {one.head for one in nodes_of(node)}
        if "total-cost" in heads:
            raise self.numeric(
                node,
                place,
                "compares (total-cost), which is for the metric; add a number of its own",
            )
        for name in sorted(heads.intersection(one.lower() for one in self._domain.numeric - known)):
            others = f"; compared are {', '.join(sorted(known))}" if known else ""
            raise self.numeric(
                node, place, f"compares {name}, which no condition of the files does{others}"
            )
        manager, (one, other) = (
            self.manager,
            (self.number(part, scope) for part in node.children[1:]),
        )
        kinds = {
            "<": manager.LT,
            "<=": manager.LE,
            ">": manager.GT,
            ">=": manager.GE,
            "=": manager.Equals,
        }
        return kinds[node.head](one, other)

    def number(self, node: Node, scope: Scope) -> UpThing:
        manager = self.manager
        operators = {"+": manager.Plus, "-": manager.Minus, "*": manager.Times, "/": manager.Div}
        if node.head in operators:
            parts = [self.number(part, scope) for part in node.children[1:]]
            if node.head == "-" and len(parts) == 1:
                return manager.Times(-1, *parts)
            if node.head in ("-", "/"):
                self._expect(node, 2)
            try:
                return operators[node.head](*parts)
            except (ZeroDivisionError, OverflowError):
                raise self._no_number(node) from None
        return self.atom(node, scope, is_number=True) if node.is_list else self.constant(node)

    def constant(self, node: Node) -> UpThing:
        try:
            value = Fraction(node.lower if NUMBER.fullmatch(node.lower) else "")
            float(value)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise self._no_number(node) from None
        return (
            self.manager.Int(value.numerator)
            if value.denominator == 1
            else self.manager.Real(value)
        )

    def _no_number(self, node: Node) -> PddlError:
        return self.source.error(
            node, f"found {start_of(node)!r}, expected a number of at most 1e308"
        )

    def numeric(self, node: Node, place: str, why: str) -> PddlError:
        return self.source.unsupported(node, f"{start_of(node)!r} in {place} {why}")

    def _term(self, node: Node, scope: Scope) -> UpThing:
        if node.is_list:
            raise self.source.unsupported(
                node, f"{start_of(node)} is no object; a formula is about what is true"
            )
        if node.lower.startswith("?"):
            if node.lower not in scope:
                message = f"found the variable {node.word!r}, expected a parameter; {nearest(node.lower, scope)}"
                raise self._unknown(node, message)
            return scope[node.lower]
        inside = self._domain.inside.get(("object", node.lower))
        if inside is None:
            raise self._unknown_name("object", node, ())
        return self.manager.ObjectExp(self._problem.object(inside))

    def _expect(self, node: Node, count: int) -> None:
        if len(node.children) != count + 1:
            raise self.source.error(
                node, f"found {len(node.children) - 1} parts in {start_of(node)}, expected {count}"
            )

    def _unknown_name(self, kind: str, node: Node, others: tuple[str, ...]) -> Exception:
        known = [
            self._domain.outside[inside]
            for (other, _), inside in self._domain.inside.items()
            if other == kind
        ]
        message = f"found the unknown {kind} {node.word!r}, expected a declared one; "
        return self._unknown(node, message + nearest(node.lower, [*known, *others]))
