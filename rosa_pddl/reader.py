"""Reads PDDL; an error says the file, the line, the column, what was found and what would do."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from rosa_pddl.domain import (
    ACTION_TYPE,
    DURATION,
    FEASIBLE,
    TIME,
    TRUE,
    Axiom,
    Domain,
    Effect,
    Exact,
    Formula,
    Number,
    Schema,
    Signature,
    TimedFact,
    Variables,
    arguments_of,
    conjuncts,
    exact,
    head_of,
    is_name,
    names_in,
    parts_of,
    text_of,
)
from rosa_pddl.exceptions import PddlError, UnknownNameError, UnsupportedPddlError, nearest

# a type may follow the hyphen without a space
_TOKEN = re.compile(r";[^\n]*|\s+|[()]|-(?=[A-Za-z])|[^\s();]+")
NUMBER: Final = re.compile(r"[-+]?([0-9]+(/[0-9]+)?|[0-9]+\.[0-9]*|\.[0-9]+)(e[-+]?[0-9]{1,3})?")
_COMPARISONS = {"<": "<", "<=": "<=", ">": "<", ">=": "<="}
_CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
_CONNECTIVES = ("and", "or", "not", "imply", "when", "forall", "exists")
_MOST_NESTED = 100
_BODY: Mapping[str, tuple[str, ...]] = {
    ":action": (":parameters", ":precondition", ":effect"),
    ":durative-action": (":parameters", ":duration", ":condition", ":effect"),
}
_TIMES = {("at", "start"): "start", ("at", "end"): "end", ("over", "all"): "over_all"}
_DOMAIN: tuple[str, ...] = (
    "domain",
    ":requirements",
    ":types",
    ":constants",
    ":predicates",
    ":functions",
)
_DOMAIN = (*_DOMAIN, ":derived", ":process", ":event", ":constraints", *_BODY)
_PROBLEM: tuple[str, ...] = (
    "problem",
    ":domain",
    ":requirements",
    ":objects",
    ":init",
    ":goal",
    ":metric",
)
_PROBLEM = (*_PROBLEM, ":constraints")
# Kairos plans with these, the executor has no notion of them.
_ONLY_PLANNED = {
    ":process": "processes change numbers by themselves",
    ":event": "events happen by themselves",
    ":constraints": "constraints say what shall hold on the way",
    "preference": "preferences may be given up; add a soft goal: goals.add(TEXT, worth=COST)",
    "#t": "numbers change while time passes",
}
_HIERARCHY = (":task", ":method", ":htn")


# ---------------------------------------------------------------- lists with their places


@dataclass(frozen=True)
class Node:
    """A word, or a list in parentheses, which has no word; line and column are 0 outside files."""

    word: str | None
    children: tuple["Node", ...] = ()
    line: int = 0
    column: int = 0

    @property
    def is_list(self) -> bool:
        """Whether it is a list."""
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


ANY: Final = Node("object")
"""The type of a name without one."""
_EMPTY = Node(None)


@dataclass(frozen=True)
class Source:
    """A PDDL file: its name for messages, its single outermost list, and its text."""

    file: str
    root: Node
    text: str = ""

    def error(self, node: Node, message: str) -> PddlError:
        """Return an error at a node."""
        return PddlError(message, self.file, node.line or None, node.column or None)

    def unsupported(self, node: Node, message: str) -> UnsupportedPddlError:
        """Return an error about correct PDDL that is not supported."""
        return UnsupportedPddlError(message, self.file, node.line or None, node.column or None)


def nodes_of(node: Node) -> Iterator[Node]:
    """Yield a node and all nodes in it."""
    yield node
    for child in node.children:
        yield from nodes_of(child)


def start_of(node: Node) -> str:
    """Return the first 40 characters of a node."""
    text = str(node)
    return text if len(text) <= 40 else text[:37] + "..."


def read_source(path: str | Path) -> Source:
    """Read a PDDL file."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise PddlError(f"cannot read this PDDL file: {reason}", path) from error
    return parse(text, str(path))


def parse(text: str, file: str, expected: str = "(define ...)") -> Source:
    """Parse PDDL text into its single outermost list."""
    stack: list[tuple[int, int, list[Node]]] = []
    root: Node | None = None
    for token, line, column in _tokens(text.removeprefix("\ufeff")):
        if root is not None:
            message = f"found {token!r} after the end of {expected}, expected nothing more"
            raise PddlError(message, file, line, column)
        if token == "(":
            if len(stack) == _MOST_NESTED:
                message = f"more than {_MOST_NESTED} lists in one another"
                raise PddlError(message, file, line, column)
            stack.append((line, column, []))
        elif not stack:
            raise PddlError(f"found {token!r}, expected '{expected}'", file, line, column)
        elif token == ")":
            opened, at, children = stack.pop()
            node = Node(None, tuple(children), opened, at)
            if stack:
                stack[-1][2].append(node)
            else:
                root = node
        else:
            if token.startswith(":") and not stack[-1][2] and len(stack) > 2:
                # a section inside another one: it shows which parenthesis was left open
                raise _unclosed(stack[-2], file, f"({token} on line {stack[-1][0]}")
            stack[-1][2].append(Node(token, (), line, column))
    if stack:
        raise _unclosed(stack[-1], file, "the end of the file")
    if root is None:
        raise PddlError(f"it is empty, expected '{expected}'", file)
    return Source(file, root, text)


def _tokens(text: str) -> Iterator[tuple[str, int, int]]:
    line = 1
    line_start = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if not token[0].isspace() and token[0] != ";":
            yield token, line, match.start() - line_start + 1
        if "\n" in token:
            line += token.count("\n")
            line_start = match.start() + token.rindex("\n") + 1


def _unclosed(opened: tuple[int, int, list[Node]], file: str, before: str) -> PddlError:
    line, column, children = opened
    opening = "(" + (str(children[0]) if children else "")
    message = f"unbalanced parentheses: {opening!r} opened here is not closed, expected ')' before"
    return PddlError(f"{message} {before}", file, line, column)


def section(source: Source, head: str) -> list[Node]:
    """Return what is in all sections with a head, in the order of the file."""
    sections = [node for node in source.root.children[2:] if node.head == head]
    return [child for node in sections for child in node.children[1:]]


def typed(
    source: Source, nodes: Iterable[Node], *, are_variables: bool = False
) -> list[tuple[Node, Node | None]]:
    """Read a typed list such as `a b - t c`; return each name with its type, or with None."""
    names: list[tuple[Node, Node | None]] = []
    waiting: list[Node] = []
    before = ""
    last = ANY
    for node in nodes:
        expects_type = before == "-"
        before, last = str(node), node
        is_either = expects_type and node.head == "either" and len(node.children) > 1
        if is_either and not are_variables:
            message = "found '(either ...)': an object has one type, and a type one above it;"
            advice = "only variables may have several. Declare a type above them"
            raise source.unsupported(node, f"{message} {advice}")
        if node.is_list and not is_either:
            expected = "a type" if expects_type else "a name"
            raise source.error(node, f"found {start_of(node)!r}, expected {expected}")
        if expects_type:
            names += [(name, node) for name in waiting]
            waiting = []
        elif node.word != "-":
            if are_variables and not node.lower.startswith("?"):
                message = f"found {node.word!r}, expected a variable such as '?{node.word}'"
                raise source.error(node, message)
            waiting.append(node)
    if before == "-":
        raise source.error(last, "found '-' at the end, expected a type after it")
    return names + [(name, None) for name in waiting]


# ---------------------------------------------------------------- formulas


@dataclass(frozen=True)
class Goal:
    """A condition that is not a conjunction, such as one goal of a mission.

    Args:
        text: the condition as PDDL text, in the names of the files.
        expression: the condition as a formula.
        worth: how much more a plan may cost to reach it; None if it must be reached.
    """

    text: str
    expression: Formula
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
    formulas = Formulas(
        source,
        domain.kinds,
        domain.signatures,
        domain.types,
        frozenset(domain.axioms),
        lambda _, message: UnknownNameError(f"{where}: {message}"),
    )
    goals = list[Goal]()
    for part in conjuncts([formulas.condition(source.root, {})]):
        known = domain.computed | domain.compared
        strange = names_in([part]) & (domain.numeric - known)
        if strange:
            compared = ", ".join(sorted(known)) or "none"
            message = f"compares {min(strange)}, which no condition of the files does"
            raise UnsupportedPddlError(f"{message}; compared are {compared}", where)
        goals.append(Goal(text_of(part), part, worth))
    return tuple(goals)


Scope = Mapping[str, str]
"""The type of each variable, in lower case."""


@dataclass(frozen=True)
class Formulas:
    """Reads formulas, with the declared names."""

    source: Source
    kinds: Mapping[str, tuple[str, tuple[str, ...]]]
    signatures: Mapping[str, Signature]
    types: Mapping[str, tuple[str, ...]]
    derived: Collection[str] = ()
    unknown: Callable[[Node, str], Exception] | None = None

    def condition(self, node: Node, scope: Scope) -> Formula:
        """Read a condition."""
        head = node.head
        parts = node.children[1:]
        if node.is_list and not node.children:
            return TRUE
        if head in _COMPARISONS or (head == "=" and any(self._is_number(part) for part in parts)):
            self._expect(node, 2)
            numbers = [self.number(part, scope) for part in parts]
            left, right = reversed(numbers) if head[0] == ">" else numbers
            return _COMPARISONS.get(head, "="), left, right
        if head == "=":
            self._expect(node, 2)
            return "same", self._term(parts[0], scope), self._term(parts[1], scope)
        if head in ("forall", "exists"):
            variables, within, body = self.quantified(node, scope)
            if not variables:
                message = f"found {start_of(node)!r}, expected a variable such as '?x' in it"
                raise self.source.error(node, message)
            inner = self.condition(body, {**scope, **dict(variables)})
            if within != TRUE and head == "forall":
                inner = "or", ("not", within), inner
            elif within != TRUE:
                inner = "and", within, inner
            return head, variables, inner
        if head in ("and", "or"):
            return head, *(self.condition(part, scope) for part in parts)
        if head == "not":
            self._expect(node, 1)
            return "not", self.condition(parts[0], scope)
        if head == "imply":
            self._expect(node, 2)
            given, then = (self.condition(part, scope) for part in parts)
            return "or", ("not", given), then
        return self.atom(node, scope)

    def quantified(self, node: Node, outer: Scope) -> tuple[Variables, Formula, Node]:
        """Return the variables of a quantifier, a check of their types, and the formula in it."""
        if len(node.children) != 3 or not node.children[1].is_list:
            message = f"found {start_of(node)!r}, expected '({node.head} (?x - type) (...))'"
            raise self.source.error(node, message)
        names = node.children[1].children
        return self.variables(names), self.within(names), node.children[2]

    def variables(self, nodes: Iterable[Node]) -> Variables:
        """Read variables with their types; one of several types has what is above all of them."""
        types = dict[str, str]()
        for name, kind in typed(self.source, nodes, are_variables=True):
            if name.lower in types:
                message = f"found the parameter {name.word!r} again, expected another name"
                raise self.source.error(name, message)
            lineages = [self.lineage(each) for each in _types_in(kind)]
            shared = [each for each in lineages[0] if all(each in other for other in lineages)]
            types[name.lower] = self.kinds[shared[0]][0]
        return tuple(types.items())

    def within(self, nodes: Iterable[Node]) -> Formula:
        """Return the condition that checks variables of a type `(either ...)`."""
        checks = list[Formula]()
        for name, kind in typed(self.source, nodes, are_variables=True):
            if kind is not None and kind.is_list:
                checks.append(("in", name.lower, tuple(part.lower for part in _types_in(kind))))
        return "and", *checks

    def lineage(self, node: Node) -> tuple[str, ...]:
        """Return a type and its ancestors, in lower case."""
        if node.lower not in self.kinds:
            raise self._unknown_name("type", node, [name for name, _ in self.kinds.values()])
        return self.kinds[node.lower][1]

    def atom(self, node: Node, scope: Scope, *, changes: bool = False) -> Formula:
        """Read an atom; with `changes`, one that is stated or changed, so that is not derived."""
        signature = self._signature(node, changes)
        if signature.is_number:
            expected = "expected a predicate; compare it, as in (> (x) 0)"
            message = f"found {start_of(node)!r}, which is a number, {expected}"
            raise self.source.error(node, message)
        return "atom", signature.name, self._arguments(node, signature, scope)

    def number_atom(self, node: Node, scope: Scope) -> Formula:
        """Read a number such as `(fuel ?r)`."""
        signature = self._signature(node, False)
        if not signature.is_number:
            message = f"found {start_of(node)!r}, which is a predicate, expected a number"
            raise self.source.error(node, message)
        return "n", signature.name, self._arguments(node, signature, scope)

    def number(self, node: Node, scope: Scope) -> Number:
        """Read a constant, a number of the domain, or an operator with its parts."""
        if node.lower in (DURATION, TIME):
            return "n", node.lower, ()
        if not node.is_list:
            return self.constant(node)
        if node.head not in ("+", "-", "*", "/"):
            return ("n", TIME, ()) if node.head == TIME else self.number_atom(node, scope)
        parts = [self.number(part, scope) for part in node.children[1:]]
        if node.head == "-" and len(parts) == 1:
            parts.insert(0, 0)
        if node.head in ("-", "/"):
            self._expect(node, len(node.children) - 1 if len(parts) == 2 else 2)
        if not parts:
            self._expect(node, 2)
        if all(not isinstance(part, tuple) for part in parts):
            try:
                return computed(node.head, parts)
            except ZeroDivisionError:
                raise self._no_number(node) from None
        return node.head, *parts

    def constant(self, node: Node) -> Exact:
        """Read a number that is written in digits."""
        try:
            value = Fraction(node.lower if NUMBER.fullmatch(node.lower) else "")
            float(value)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise self._no_number(node) from None
        return exact(value)

    def _is_number(self, node: Node) -> bool:
        return node.is_list or node.lower == DURATION or bool(NUMBER.fullmatch(node.lower))

    def _no_number(self, node: Node) -> PddlError:
        message = f"found {start_of(node)!r}, expected a number of at most 1e308"
        return self.source.error(node, message)

    def _signature(self, node: Node, changes: bool) -> Signature:
        if not node.head:
            message = f"found {start_of(node)!r}, expected a list such as '(predicate object)'"
            raise self.source.error(node, message)
        if changes and node.head in self.derived:
            message = f"found {start_of(node)!r}, which is derived: it is neither stated nor"
            raise self.source.error(node, f"{message} changed")
        if node.head not in self.signatures:
            names = [each.name for each in self.signatures.values()]
            names += [*_CONNECTIVES, *_CHANGES]
            raise self._unknown_name("predicate", node.children[0], names)
        return self.signatures[node.head]

    def _arguments(self, node: Node, signature: Signature, scope: Scope) -> tuple[str, ...]:
        terms = [self._term(part, scope) for part in node.children[1:]]
        if len(terms) != len(signature.types):
            message = f"found {len(terms)} arguments of {signature.name!r}, expected"
            raise self._error(node.children[0], f"{message} {len(signature.types)}")
        for term, expected in zip(terms, signature.types, strict=True):
            lineage = self.types.get(term)
            if lineage is None:
                lineage = self.kinds[scope[term].lower()][1]
            if expected.lower() not in lineage:
                message = f"the arguments of {signature.name!r} are of other types than declared:"
                raise self._error(node, f"{message} {signature}")
        return tuple(terms)

    def _term(self, node: Node, scope: Scope) -> str:
        if node.is_list:
            message = f"{start_of(node)} is no object; a formula is about what is true"
            raise self.source.unsupported(node, message)
        if node.lower.startswith("?"):
            if node.lower not in scope:
                message = f"found the variable {node.word!r}, expected a parameter"
                raise self._error(node, f"{message}; {nearest(node.lower, scope)}")
            return node.lower
        for name in (node.word or "",) if node.word in self.types else self.types:
            if name.lower() == node.lower:
                return name
        raise self._unknown_name("object", node, self.types)

    def _expect(self, node: Node, count: int) -> None:
        if len(node.children) != count + 1:
            message = f"found {len(node.children) - 1} parts in {start_of(node)}"
            raise self.source.error(node, f"{message}, expected {count}")

    def _error(self, node: Node, message: str) -> Exception:
        return (self.unknown or self.source.error)(node, message)

    def _unknown_name(self, kind: str, node: Node, names: Iterable[str]) -> Exception:
        message = f"found the unknown {kind} {node.word!r}, expected a declared one"
        return self._error(node, f"{message}; {nearest(node.lower, names)}")


def _types_in(node: Node | None) -> tuple[Node, ...]:
    if node is None:
        return (ANY,)
    return node.children[1:] if node.is_list else (node,)


def computed(operator: str, parts: Iterable[Exact]) -> Exact:
    """Return the exact result of an operator on numbers."""
    result, *others = parts
    for other in others:
        if operator == "+":
            result += other
        elif operator == "-":
            result -= other
        elif operator == "*":
            result *= other
        else:
            result = exact(Fraction(result) / other)
    return result


# ---------------------------------------------------------------- domains and problems


def load_domain(
    domain: Any,  # noqa: ANN401  # a path, or a problem of unified-planning, which ships no types
    problem: str | Path | None = None,
    *,
    actions: Mapping[str, str] | None = None,
) -> Domain:
    """Read a PDDL domain and problem.

    Names keep the spelling of the files; an object, an action, a predicate and a type may have the
    same name. If the files do not say which ROSA action a PDDL action does, `actions` says it:
    an action in it gets the condition `(over all (action_feasible ...))` if it lacks that.

    Args:
        domain: path of the domain file, or a `Problem` of unified-planning.
        problem: path of the problem file; None if objects, facts and goals come from Python.
        actions: for each PDDL action, the ROSA action that it does: its name, or the parameter
            for it, such as `?a`.

    Raises:
        PddlError: a file cannot be read or is not correct PDDL; the message gives the place.
        UnknownNameError: `actions` names a PDDL action or a parameter that is not in the files.
        UnsupportedPddlError: correct PDDL that cannot be planned here.
    """
    if hasattr(domain, "fluents"):
        from unified_planning.io import PDDLWriter

        writer = PDDLWriter(domain)
        return parse_domain(writer.get_domain(), writer.get_problem(), actions=actions)
    source = read_source(domain)
    return _read(source, None if problem is None else read_source(problem), actions)


def parse_domain(
    domain: str, problem: str | None = None, *, actions: Mapping[str, str] | None = None
) -> Domain:
    """Read a PDDL domain and problem from texts, as `load_domain` does from files."""
    source = parse(domain, "domain.pddl")
    return _read(source, None if problem is None else parse(problem, "problem.pddl"), actions)


def _read(domain: Source, problem: Source | None, actions: Mapping[str, str] | None) -> Domain:
    _check_frame(domain, "domain", _DOMAIN)
    name = str(domain.root.children[1].children[1])
    if problem is None:
        goal = Node(None, (Node(":goal"), Node(None, (Node("and"),))))
        root = Node(None, (Node("define"), Node(None, (Node("problem"), Node(name))), goal))
        problem = Source("no problem file", root)
    else:
        _check_frame(problem, "problem", _PROBLEM)
    _check_problem(problem, name, domain.file)
    return _Reader(domain, problem, actions or {}).domain()


def _check_frame(source: Source, what: str, sections: Collection[str]) -> None:
    root = source.root
    if root.head != "define" or len(root.children) < 2:
        message = f"found {start_of(root)!r}, expected '(define ({what} ...) ...)'"
        raise source.error(root, message)
    title = root.children[1]
    if title.head != what or len(title.children) != 2:
        message = f"found {start_of(title)!r}, expected '({what} NAME)'; is this the {what} file?"
        raise source.error(title, message)
    for node in root.children[2:]:
        if node.head in _HIERARCHY:
            message = f"found '({node.head}': hierarchies are not executed here"
            raise source.unsupported(node, f"{message}; Aries (up-aries) by itself would do")
        if node.head not in sections:
            message = f"found {start_of(node)!r}, expected a section"
            raise source.error(node, f"{message}; {nearest(node.head, sections)}")


def _check_problem(source: Source, domain: str, file: str) -> None:
    places = {node.head: node for node in source.root.children}
    named = [node.lower for node in section(source, ":domain")]
    if named not in ([], [domain.lower()]):
        node = places[":domain"]
        expected = f"expected '(:domain {domain})', as {file} is called"
        raise source.error(node, f"found {start_of(node)!r}, {expected}")
    goals = section(source, ":goal")
    if len(goals) != 1:
        message = f"found {len(goals)} conditions in (:goal ...), expected one"
        node = places.get(":goal", source.root)
        raise source.error(node, f"{message}; join them with (and ...)")
    metric = section(source, ":metric")
    if metric and (len(metric) != 2 or metric[0].lower not in ("minimize", "maximize")):
        node = places[":metric"]
        message = f"found {start_of(node)!r}, expected '(:metric minimize (NAME))'"
        raise source.error(node, message)


class _Reader:
    """Reads a domain and its problem, section by section."""

    def __init__(self, domain: Source, problem: Source, actions: Mapping[str, str]) -> None:
        self._domain = domain
        self._problem = problem
        self._actions = actions
        self._kinds: dict[str, tuple[str, tuple[str, ...]]] = {"object": ("object", ("object",))}
        self._signatures: dict[str, Signature] = {}
        self._types: dict[str, tuple[str, ...]] = {}
        self._places: dict[tuple[str, str], tuple[str, int]] = {}
        self._notes: list[str] = []
        self._only_planned = ""
        self._schemas: dict[str, Schema] = {}
        self._rules = self._derivations()
        tables = self._kinds, self._signatures, self._types, frozenset(self._rules)
        self._in_domain = Formulas(domain, *tables)
        self._in_problem = Formulas(problem, *tables)

    def domain(self) -> Domain:
        """Read all sections."""
        domain, problem = self._domain, self._problem
        for source in (domain, problem):
            self._note_glued_types(source)
            self._find_only_planned(source)
        self._read_types()
        for node in section(domain, ":predicates"):
            self._declare_signature(node, is_number=False)
        for head, rules in self._rules.items():
            if head not in self._signatures:
                self._declare_signature(rules[0].children[1], is_number=False)
        if self._actions and FEASIBLE not in self._signatures:
            self._signatures[FEASIBLE] = Signature(FEASIBLE, (("?a", ACTION_TYPE),), False)
        self._read_functions()
        self._read_objects(self._in_domain, ":constants")
        constants = frozenset(self._types)
        self._read_objects(self._in_problem, ":objects")
        self._read_rosa_actions()
        for node in domain.root.children[2:]:
            if node.head in _BODY:
                self._read_action(node)
        facts, numbers, timed = self._read_init()
        axioms = {} if self._only_planned else self._read_axioms()
        goal = () if self._only_planned else self._read_goal()
        metric = None if self._only_planned else self._read_metric()
        numbers_read = self._read_numbers(goal, axioms)
        changed = self._changed_numbers
        return Domain(
            name=str(domain.root.children[1].children[1]),
            file=domain.file,
            problem_file=problem.file,
            schema_of=self._schemas,
            signatures=self._signatures,
            kinds=self._kinds,
            types=self._types,
            constants=constants,
            places=self._places,
            facts=frozenset(facts),
            numbers=numbers,
            timed=tuple(timed),
            goal=goal,
            metric=metric,
            computed=numbers_read & changed,
            compared=numbers_read - changed,
            axioms=axioms,
            oversights=tuple(self._notes),
            texts=(domain.text, problem.text),
            only_planned=self._only_planned,
        )

    def _note_glued_types(self, source: Source) -> None:
        for node in nodes_of(source.root):
            for mark, kind in pairwise(node.children):
                is_glued = (mark.line, mark.column + 1) == (kind.line, kind.column)
                if mark.word == "-" and is_glued and not kind.is_list:
                    place = f"{source.file}:{mark.line}"
                    note = f"{place}: '-{kind}' is read as '- {kind}'; write it with the space"
                    self._notes.append(note)

    def _find_only_planned(self, source: Source) -> None:
        for node in nodes_of(source.root):
            word = node.lower or node.head
            if word in _ONLY_PLANNED and not self._only_planned:
                self._forbid_execution(source, node, _ONLY_PLANNED[word])

    def _forbid_execution(self, source: Source, node: Node, why: str) -> None:
        self._only_planned = self._only_planned or f"{source.file}:{node.line}: {why}"

    # ------------------------------------------------------------ names

    def _declare(self, source: Source, kind: str, node: Node, names: Iterable[str]) -> None:
        if not is_name(str(node)):
            message = f"found the {kind} {str(node)!r}, expected a name"
            raise source.error(node, f"{message}: a letter, then letters, digits, '_' or '-'")
        for name in names:
            if name.lower() == node.lower:
                file, line = self._places.get((kind, name), ("", 0))
                where = f", in line {line} of {file}" if line else ""
                raise source.error(node, f"the {kind} {node.word!r} was declared before{where}")
        self._places[kind, str(node)] = (source.file, node.line)

    def _read_types(self) -> None:
        source = self._domain
        pairs = typed(source, section(source, ":types"))
        names = {parent.lower: parent for _, parent in pairs if parent is not None}
        parents = dict[str, str]()
        for name, parent in pairs:
            if name.lower == "object":
                continue
            if name.lower in parents:
                message = f"the type {name.word!r} was declared before, expected one type above it"
                raise source.error(name, message)
            names[name.lower] = name
            is_root = parent is None or parent.lower == name.lower
            parents[name.lower] = "object" if parent is None or is_root else parent.lower
        if self._actions and ACTION_TYPE not in names:
            names[ACTION_TYPE] = Node(ACTION_TYPE)
        names.pop("object", None)
        above = {name: [parents.get(name, "object")] for name in names}
        try:
            in_order = list(TopologicalSorter(above).static_order())
        except CycleError as error:
            cycle = error.args[1]
            message = f"the types {', '.join(sorted({*cycle}))} are above one another"
            raise source.error(names[cycle[0]], f"{message}, expected one on top") from error
        for kind in in_order:
            if kind != "object":
                self._declare(source, "type", names[kind], ())
                lineage = self._kinds[above[kind][0]][1]
                self._kinds[kind] = (str(names[kind]), (kind, *lineage))

    def _declare_signature(self, node: Node, *, is_number: bool) -> None:
        source = self._domain
        if not node.head:
            expected = f"a list such as '({node.word or 'name'} ?x)'"
            raise source.error(node, f"found {start_of(node)!r}, expected {expected}")
        variables = self._in_domain.variables(node.children[1:])
        names = [each.name for each in self._signatures.values()]
        self._declare(source, "predicate", node.children[0], names)
        self._signatures[node.head] = Signature(str(node.children[0]), variables, is_number)

    def _read_functions(self) -> None:
        before = ""
        for node in section(self._domain, ":functions"):
            expects_type, before = before == "-", str(node)
            if node.is_list:
                self._declare_signature(node, is_number=True)
            elif expects_type and node.lower != "number":
                why = f"the value of a function is a {node.word}; write a predicate with one more"
                self._forbid_execution(self._domain, node, f"{why} argument")
            elif node.lower not in ("-", "number"):
                expected = f"a list such as '({node.word} ?x)'"
                raise self._domain.error(node, f"found {node.word!r}, expected {expected}")

    def _read_objects(self, formulas: Formulas, head: str) -> None:
        source = formulas.source
        for node, kind in typed(source, section(source, head)):
            lineage = formulas.lineage(kind or ANY)
            same = [name for name in self._types if name.lower() == node.lower]
            if same and self._types[same[0]] == lineage:
                place = f"{source.file}:{node.line}"
                if self._places["object", same[0]][0] == source.file:
                    self._notes.append(f"{place}: the object {node.word!r} is declared twice")
                continue
            self._declare(source, "object", node, self._types)
            self._types[str(node)] = lineage

    def _read_rosa_actions(self) -> None:
        """Apply `actions`, which says which ROSA actions PDDL actions do."""
        nodes = [node for node in self._domain.root.children[2:] if node.head in _BODY]
        names = [str(node.children[1]) for node in nodes if node.children[1:]]
        for name, action in self._actions.items():
            if name not in names:
                message = f"{self._domain.file} has no PDDL action {name!r}"
                raise UnknownNameError(f"{message}; {nearest(name, names)}")
            if action.startswith("?"):
                continue
            same = [other for other in self._types if other.lower() == action.lower()]
            if not same:
                self._types[action] = self._kinds[ACTION_TYPE][1]
                self._places["object", action] = (self._domain.file, 0)
            elif ACTION_TYPE not in self._types[same[0]]:
                message = f"the object {action!r} of {self._domain.file} is not of type"
                raise UnknownNameError(f"{message} {ACTION_TYPE!r}")

    # ------------------------------------------------------------ actions

    def _read_action(self, node: Node) -> None:
        source = self._domain
        parts = _body_of(source, node)
        name = str(node.children[1])
        variables = parts.get(":parameters", _EMPTY).children
        parameters = self._in_domain.variables(variables)
        self._declare(source, "action", node.children[1], self._schemas)
        schema = Schema(name, tuple((word[1:], kind) for word, kind in parameters))
        if not self._only_planned:
            reader = _ActionReader(self._in_domain, dict(parameters), node)
            schema = reader.read(schema, parts, self._in_domain.within(variables))
        does = self._actions.get(name)
        if does is not None:
            schema = self._requiring(schema, does)
        action = does.removeprefix("?") if does else self._rosa_action_of(schema)
        self._schemas[name] = replace(schema, action=action)

    def _requiring(self, schema: Schema, does: str) -> Schema:
        """Return an action that requires the ROSA action which it does."""
        parameters = [f"?{name}" for name, _ in schema.parameters]
        if does.startswith("?") and does not in parameters:
            message = f"the PDDL action {schema.name!r} has no parameter {does!r}"
            raise UnknownNameError(f"{message}; {nearest(does, parameters)}")
        if FEASIBLE in {name.lower() for name in names_in(schema.conditions)}:
            return schema
        needed: Formula = ("atom", self._signatures[FEASIBLE].name, (does,))
        if schema.duration is None:
            return replace(schema, start=(*schema.start, needed))
        return replace(schema, over_all=(*schema.over_all, needed))

    def _rosa_action_of(self, schema: Schema) -> str | None:
        """Return the parameter (without `?`) or the constant that is the ROSA action, or None."""
        by_predicate = dict[str, str]()
        for formula in schema.conditions:
            if formula[0] == "atom" and len(formula[2]) == 1:
                by_predicate[formula[1].lower()] = formula[2][0]
        for predicate in (f"{schema.name.lower()}_action", FEASIBLE):
            if predicate in by_predicate:
                return by_predicate[predicate].removeprefix("?")
        actions = [name for name, kind in schema.parameters if kind.lower() == ACTION_TYPE]
        return actions[0] if len(actions) == 1 else None

    # ------------------------------------------------------------ derived predicates

    def _derivations(self) -> dict[str, list[Node]]:
        rules: dict[str, list[Node]] = {}
        for node in self._domain.root.children[2:]:
            if node.head == ":derived":
                if len(node.children) != 3 or not node.children[1].head:
                    expected = "'(:derived (NAME ?x - type) CONDITION)'"
                    message = f"found {start_of(node)!r}, expected {expected}"
                    raise self._domain.error(node, message)
                rules.setdefault(node.children[1].head, []).append(node)
        return rules

    def _read_axioms(self) -> dict[str, tuple[Axiom, ...]]:
        """Read the rules of derived predicates, each with its layer."""
        formulas = self._in_domain
        read = dict[str, list[tuple[Variables, Formula]]]()
        for head, rules in self._rules.items():
            for rule in rules:
                target = rule.children[1]
                variables = formulas.variables(target.children[1:])
                signature = self._signatures[head]
                if len(variables) != len(signature.types):
                    message = f"found {len(variables)} arguments of {signature.name!r}, expected"
                    raise self._domain.error(target, f"{message} {len(signature.types)}")
                condition = formulas.condition(rule.children[2], dict(variables))
                within = formulas.within(target.children[1:])
                read.setdefault(head, []).append((variables, ("and", within, condition)))
        layers = self._layers(read)
        axioms = dict[str, tuple[Axiom, ...]]()
        for head, each in read.items():
            axioms[head] = tuple(Axiom(*rule, layers[head]) for rule in each)
        return axioms

    def _layers(self, rules: Mapping[str, list[tuple[Variables, Formula]]]) -> dict[str, int]:
        """Return the layer of each derived predicate: above all that it needs to be false."""
        layers = dict.fromkeys(rules, 1)
        for _ in range(len(rules) + 1):
            before = dict(layers)
            for head, each in rules.items():
                for _, condition in each:
                    for name, truth in _polarities(condition, True):
                        layer = before.get(name.lower(), 0) + (not truth)
                        if name.lower() in rules:
                            layers[head] = max(layers[head], layer)
            if layers == before:
                return layers
        head = max(layers, key=lambda name: layers[name])
        message = f"{head!r} is derived from its own negation, which means nothing. Sense it, or"
        raise self._domain.unsupported(self._rules[head][0], f"{message} make it an effect")

    # ------------------------------------------------------------ the problem

    def _read_init(self) -> tuple[set[str], dict[str, Exact], list[TimedFact]]:
        formulas, source = self._in_problem, self._problem
        facts = set[str]()
        numbers = dict[str, Exact]()
        timed = list[TimedFact]()
        for node in _conjuncts(section(source, ":init")):
            parts = node.children
            if self._only_planned:
                continue
            if node.head == "at" and len(parts) == 3 and NUMBER.fullmatch(parts[1].lower):
                negated = parts[2].head == "not" and len(parts[2].children) == 2
                inner = parts[2].children[1] if negated else parts[2]
                if inner.head == "=":
                    self._forbid_execution(source, node, "numbers change by themselves")
                    continue
                atom = text_of(formulas.atom(inner, {}, changes=True))
                at_s = float(formulas.constant(parts[1]))
                timed.append(TimedFact(at_s, atom, not negated))
            elif node.head == "=" and len(parts) == 3:
                text = text_of(formulas.number_atom(parts[1], {}))
                if text in numbers:
                    message = f"found a second value of {text}, expected one"
                    raise source.error(node, message)
                numbers[text] = formulas.constant(parts[2])
            elif node.head == "not" and len(parts) == 2:
                formulas.atom(parts[1], {}, changes=True)
            else:
                facts.add(text_of(formulas.atom(node, {}, changes=True)))
        return facts, numbers, sorted(timed)

    def _read_goal(self) -> tuple[Formula, ...]:
        goals = list[Formula]()
        for node in _conjuncts(section(self._problem, ":goal")):
            goals += conjuncts([self._in_problem.condition(node, {})])
        return tuple(goals)

    def _read_metric(self) -> Number:
        metric = section(self._problem, ":metric")
        if not metric:
            return None
        kind, node = metric
        if not node.is_list and node.lower in self._signatures:
            node = Node(None, (node,), node.line, node.column)  # `minimize c` is `(c)`
        number = self._in_problem.number(node, {})
        return ("-", 0, number) if kind.lower == "maximize" else number

    def _read_numbers(
        self, goal: Iterable[Formula], axioms: Mapping[str, tuple[Axiom, ...]]
    ) -> frozenset[str]:
        """Return the numbers on which conditions depend, and effects on such numbers."""
        schemas = self._schemas.values()
        effects = [effect for schema in schemas for effect in schema.effects]
        formulas = [*goal, *(formula for schema in schemas for formula in schema.conditions)]
        formulas += [effect.condition for effect in effects]
        formulas += [axiom.condition for each in axioms.values() for axiom in each]
        numbers = {each.name for each in self._signatures.values() if each.is_number}
        read = names_in(formulas) & numbers
        # numbers that change, and on which costs or durations depend
        changes = [effect for effect in effects if effect.is_numeric]
        changed = {effect.name for effect in changes}
        amounts = [effect.amount for effect in changes]
        amounts += [bound for schema in schemas for bound in schema.duration or ()]
        read |= names_in(amounts) & changed
        read |= {effect.name for effect in changes if effect.kind in ("assign", "decrease")}
        for _ in numbers:
            for effect in changes:
                if effect.name in read:
                    read |= names_in([effect.amount]) & numbers
        return frozenset(read)

    @property
    def _changed_numbers(self) -> frozenset[str]:
        effects = [effect for schema in self._schemas.values() for effect in schema.effects]
        return frozenset(effect.name for effect in effects if effect.is_numeric)


class _ActionReader:
    """Reads the conditions, effects and duration of an action."""

    def __init__(self, formulas: Formulas, scope: Scope, node: Node) -> None:
        self._formulas = formulas
        self._source = formulas.source
        self._scope = scope
        self._node = node
        self._conditions: dict[str, list[Formula]] = {"start": [], "over_all": [], "end": []}
        self._effects: dict[str, list[Effect]] = {"start": [], "end": []}

    def read(self, schema: Schema, parts: Mapping[str, Node], within: Formula) -> Schema:
        """Return the action with what its parts say."""
        duration = None
        if ":duration" in parts:
            duration = self._duration(parts[":duration"])
        needed = parts.get(":condition", parts.get(":precondition", _EMPTY))
        for time, node in self._timed(needed, is_effect=False):
            condition = self._formulas.condition(node, self._scope)
            self._conditions[time] += conjuncts([condition])
        self._conditions["start"] += conjuncts([within])
        for time, node in self._timed(parts.get(":effect", _EMPTY), is_effect=True):
            self._read_effect(node, _Where(time, self._scope))
        schema = replace(
            schema,
            start=tuple(self._conditions["start"]),
            over_all=tuple(self._conditions["over_all"]),
            end=tuple(self._conditions["end"]),
            start_effects=tuple(self._effects["start"]),
            end_effects=tuple(self._effects["end"]),
            duration=duration,
        )
        return self._without_duration(schema)

    def _duration(self, node: Node) -> tuple[Number, Number]:
        """Return the shortest and the longest duration; a bound on one side only is both."""
        formulas, source = self._formulas, self._source
        if not node.children:
            return 1, 1
        if self._time_of(node) is not None or (node.head == "and" and len(node.children) == 2):
            return self._duration(node.children[-1])
        if node.head == "and" and len(node.children) == 3:
            bounds = {part.head[:1]: part for part in node.children[1:]}
            if bounds.keys() == {"<", ">"}:
                return self._duration(bounds[">"])[0], self._duration(bounds["<"])[0]
        elif node.head in ("=", *_COMPARISONS) and len(node.children) == 3:
            if node.children[1].lower == DURATION:
                value = formulas.number(node.children[2], self._scope)
                if isinstance(value, tuple) or value >= 0:
                    return value, value
                message = f"found {start_of(node)!r}, expected a duration of 0 s or more"
                raise source.error(node, message)
        expected = "a duration such as '(= ?duration 5)', or a least and a greatest one"
        raise source.error(node, f"found {start_of(node)!r}, expected {expected}")

    def _without_duration(self, schema: Schema) -> Schema:
        """Put the duration in the place of `?duration` in effects."""
        duration = schema.duration
        if duration is None:
            return schema
        effects = list[tuple[Effect, ...]]()
        for each in (schema.start_effects, schema.end_effects):
            changed = list[Effect]()
            for effect in each:
                amount = effect.amount
                if isinstance(amount, tuple) and DURATION in names_in([amount]):
                    if duration[0] != duration[1]:
                        message = f"{schema.name} has an effect of ?duration, which is not fixed"
                        advice = "write (= ?duration ...)"
                        raise self._source.unsupported(self._node, f"{message}; {advice}")
                    amount = _substituted(amount, duration[0])
                changed.append(effect._replace(amount=amount))
            effects.append(tuple(changed))
        return replace(schema, start_effects=effects[0], end_effects=effects[1])

    def _read_effect(self, node: Node, where: "_Where") -> None:
        formulas = self._formulas
        head = node.head
        parts = node.children[1:]
        if head == "and":
            for part in parts:
                self._read_effect(part, where)
        elif head == "forall":
            variables, within, body = formulas.quantified(node, where.scope)
            scope = {**where.scope, **dict(variables)}
            inner = replace(where, scope=scope, variables=(*where.variables, *variables))
            self._read_effect(body, inner.on(within))
        elif head == "when" and len(parts) == 2:
            self._read_effect(parts[1], where.on(formulas.condition(parts[0], where.scope)))
        elif head in _CHANGES:
            self._read_change(node, where)
        elif node.children or not node.is_list:
            is_deleted = head == "not" and len(parts) == 1 and parts[0].is_list
            target = parts[0] if is_deleted else node
            atom = formulas.atom(target, where.scope, changes=True)
            self._add("delete" if is_deleted else "add", atom, where)

    def _read_change(self, node: Node, where: "_Where") -> None:
        formulas = self._formulas
        if len(node.children) != 3 or not node.children[1].head:
            message = f"found {start_of(node)!r}, expected ({node.head} (NAME) AMOUNT)"
            raise self._source.error(node, message)
        kind = node.head
        target = formulas.number_atom(node.children[1], where.scope)
        amount = formulas.number(node.children[2], where.scope)
        if kind.startswith("scale"):
            amount = ("*" if kind == "scale-up" else "/", target, amount)
            kind = "assign"
        self._add(kind, target, where, amount)

    def _add(self, kind: str, atom: Formula, where: "_Where", amount: Number = None) -> None:
        effect = Effect(kind, atom[1], atom[2], where.condition, where.variables, amount)
        self._effects[where.time].append(effect)

    def _time_of(self, node: Node) -> str | None:
        if len(node.children) != 3 or not node.children[2].is_list:
            return None
        return _TIMES.get((node.head, node.children[1].lower))

    def _timed(self, node: Node, *, is_effect: bool) -> Iterator[tuple[str, Node]]:
        """Yield conditions or effects, each with its time, which durative actions state."""
        if self._node.head == ":action":
            yield ("end" if is_effect else "start"), node
            return
        time = self._time_of(node)
        if time is not None and not (is_effect and time == "over_all"):
            yield time, node.children[2]
        elif node.head == "and" or not node.children:
            for child in node.children[1:]:
                yield from self._timed(child, is_effect=is_effect)
        elif node.head == "forall" and len(node.children) == 3:
            for when, inner in self._timed(node.children[2], is_effect=is_effect):
                yield when, replace(node, children=(*node.children[:2], inner))
        elif node.head == "when" and is_effect and len(node.children) == 3:
            condition, effect = node.children[1:]
            at = self._time_of(effect)
            if at is None or at != self._time_of(condition):
                message = f"found {start_of(node)!r}: an effect at one time that depends on another"
                advice = "is not supported. Write (when (at end ...) (at end ...)), or two actions"
                raise self._source.unsupported(node, f"{message} {advice}")
            children = (node.children[0], condition.children[2], effect.children[2])
            yield at, replace(node, children=children)
        else:
            times = [time for time in _TIMES if not is_effect or time[0] == "at"]
            expected = " or ".join(f"'({' '.join(time)} ...)'" for time in times)
            place = f"(:durative-action {self._node.children[1]}"
            message = f"found {start_of(node)!r} in {place}, expected {expected} around it"
            raise self._source.error(node, message)


@dataclass(frozen=True)
class _Where:
    """The context of an effect: its end of the action, the variables in scope, the condition."""

    time: str
    scope: Scope
    condition: Formula = TRUE
    variables: Variables = ()

    def on(self, condition: Formula) -> "_Where":
        if condition == TRUE:
            return self
        parts = tuple(conjuncts([self.condition, condition]))
        return replace(self, condition=parts[0] if len(parts) == 1 else ("and", *parts))


def _body_of(source: Source, schema: Node) -> dict[str, Node]:
    """Return the parts of an action's description by their keywords."""
    title = schema.children[1] if schema.children[1:] else _EMPTY
    if title.is_list or title.lower.startswith(":"):
        message = f"found {start_of(schema)!r}, expected '({schema.head} NAME ...)'"
        raise source.error(schema, message)
    allowed = _BODY[schema.head]
    parts: dict[str, Node] = {}
    words = list(schema.children[2:])
    while words:
        keyword = words.pop(0)
        if keyword.lower not in allowed:
            message = f"found {start_of(keyword)!r} in {schema.head} {title}, expected one of"
            hint = nearest(keyword.lower, allowed)
            raise source.error(keyword, f"{message} {' '.join(allowed)}; {hint}")
        if not words or not words[0].is_list:
            raise source.error(keyword, f"expected '(' after {keyword.word}")
        if keyword.lower in parts:
            message = f"found {keyword.word!r} again in {schema.head} {title}"
            raise source.error(keyword, f"{message}; join the two with (and ...)")
        parts[keyword.lower] = words.pop(0)
    if schema.head == ":durative-action" and ":duration" not in parts:
        raise source.error(schema, f"(:durative-action {title} has no ':duration'")
    return parts


def _conjuncts(nodes: Iterable[Node]) -> Iterator[Node]:
    for node in nodes:
        if node.head == "and":
            yield from _conjuncts(node.children[1:])
        elif node.children or not node.is_list:
            yield node


def _polarities(formula: Formula, truth: bool) -> Iterator[tuple[str, bool]]:
    """Yield the predicates of a formula, each with whether it must be true or false."""
    head = formula[0]
    if head == "atom":
        yield formula[1], truth
    elif head == "not":
        yield from _polarities(formula[1], not truth)
    elif head in ("and", "or"):
        for part in formula[1:]:
            yield from _polarities(part, truth)
    elif head in ("forall", "exists"):
        yield from _polarities(formula[2], truth)
        if head == "forall":  # it is computed as the negation of `exists`
            yield from _polarities(formula[2], not truth)


def _substituted(number: Number, duration: Number) -> Number:
    if not isinstance(number, tuple):
        return number
    if number[0] == "n":
        return duration if number[1] == DURATION else number
    return number[0], *(_substituted(part, duration) for part in number[1:])


__all__ = [
    "Formulas",
    "Goal",
    "Node",
    "Source",
    "arguments_of",
    "conditions",
    "head_of",
    "load_domain",
    "parse",
    "parse_domain",
    "parts_of",
    "read_source",
    "section",
    "typed",
]
