"""Reads PDDL; an error says the file, the line, the column, what was found and what would do."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from rosa_pddl.domain import (
    ACTION_TYPE,
    DURATION,
    FEASIBLE,
    OPERATORS,
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
    conjuncts,
    exact,
    is_name,
    names_in,
    text_of,
)
from rosa_pddl.exceptions import PddlError, UnknownNameError, UnsupportedPddlError, nearest

# a type may follow the hyphen without a space
_TOKEN = re.compile(r";[^\n]*|\s+|[()]|-(?=[A-Za-z])|[^\s();]+")
NUMBER: Final = re.compile(r"[-+]?([0-9]+(/[0-9]+)?|[0-9]+\.[0-9]*|\.[0-9]+)(e[-+]?[0-9]{1,3})?")
_COMPARISONS = ("<", "<=", ">", ">=")
_CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
_CONNECTIVES = ("and", "or", "not", "imply", "when", "forall", "exists")
_MOST_NESTED = 100
_BODY: Mapping[str, tuple[str, ...]] = {
    ":action": (":parameters", ":precondition", ":effect"),
    ":durative-action": (":parameters", ":duration", ":condition", ":effect"),
}
_TIMES = {("at", "start"): "start", ("at", "end"): "end", ("over", "all"): "over_all"}
_DOMAIN = "domain :requirements :types :constants :predicates :functions :derived :process :event"
_PROBLEM = "problem :domain :requirements :objects :init :goal :metric :constraints"
_SECTIONS = {
    "domain": (*_DOMAIN.split(), ":constraints", *_BODY),
    "problem": tuple(_PROBLEM.split()),
}
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
    """A word, or a list in parentheses, which has no word, with its place in a file."""

    word: str | None
    children: tuple["Node", ...] = ()
    file: str = ""
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

    @property
    def nodes(self) -> Iterator["Node"]:
        """The node and all nodes in it."""
        yield self
        for child in self.children:
            yield from child.nodes

    def __str__(self) -> str:
        if self.word is not None:
            return self.word
        return "(" + " ".join(str(child) for child in self.children) + ")"

    def error(self, message: str) -> PddlError:
        """Return an error at this place."""
        return PddlError(message, self.file, self.line or None, self.column or None)

    def unsupported(self, message: str) -> UnsupportedPddlError:
        """Return an error about correct PDDL that is not supported."""
        return UnsupportedPddlError(message, self.file, self.line or None, self.column or None)

    def wrong(self, expected: str, where: str = "") -> PddlError:
        """Return an error that says what was found and what was expected."""
        text = str(self)
        shown = text if len(text) <= 40 else text[:37] + "..."
        return self.error(f"found {shown!r}{where}, expected {expected}")


_OBJECT: Final = Node("object")
_EMPTY = Node(None)


def read_file(path: str | Path) -> str:
    """Return the text of a PDDL file."""
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise PddlError(f"cannot read this PDDL file: {reason}", path) from error


def parse(text: str, file: str, expected: str = "(define ...)") -> Node:
    """Parse PDDL text into its single outermost list."""
    stack: list[tuple[Node, list[Node]]] = []
    root: Node | None = None
    for leaf in _leaves(text.removeprefix("\ufeff"), file):
        if root is not None:
            raise leaf.wrong("nothing more", f" after the end of {expected}")
        if leaf.word == "(":
            if len(stack) == _MOST_NESTED:
                raise leaf.error(f"more than {_MOST_NESTED} lists in one another")
            stack.append((replace(leaf, word=None), []))
        elif not stack:
            raise leaf.wrong(f"'{expected}'")
        elif leaf.word == ")":
            opened, children = stack.pop()
            node = replace(opened, children=tuple(children))
            if stack:
                stack[-1][1].append(node)
            else:
                root = node
        else:
            if leaf.lower.startswith(":") and not stack[-1][1] and len(stack) > 2:
                # a section inside another one: it shows which parenthesis was left open
                raise _unclosed(*stack[-2], f"({leaf} on line {stack[-1][0].line}")
            stack[-1][1].append(leaf)
    if stack:
        raise _unclosed(*stack[-1], "the end of the file")
    if root is None:
        raise PddlError(f"it is empty, expected '{expected}'", file)
    return root


def _leaves(text: str, file: str) -> Iterator[Node]:
    line = 1
    line_start = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if not token[0].isspace() and token[0] != ";":
            yield Node(token, (), file, line, match.start() - line_start + 1)
        if "\n" in token:
            line += token.count("\n")
            line_start = match.start() + token.rindex("\n") + 1


def _unclosed(opened: Node, children: list[Node], before: str) -> PddlError:
    opening = "(" + (str(children[0]) if children else "")
    message = f"unbalanced parentheses: {opening!r} opened here is not closed, expected ')' before"
    return opened.error(f"{message} {before}")


def section(root: Node, head: str) -> list[Node]:
    """Return what is in all sections with a head, in the order of the file."""
    sections = [node for node in root.children[2:] if node.head == head]
    return [child for node in sections for child in node.children[1:]]


def typed(nodes: Iterable[Node], *, are_variables: bool = False) -> list[tuple[Node, Node | None]]:
    """Read a typed list such as `a b - t c`; return each name with its type, or with None."""
    names: list[tuple[Node, Node | None]] = []
    waiting: list[Node] = []
    hyphen: Node | None = None
    for node in nodes:
        is_either = hyphen is not None and node.head == "either" and len(node.children) > 1
        if is_either and not are_variables:
            message = "found '(either ...)': an object has one type, and a type one above it;"
            advice = "only variables may have several. Declare a type above them"
            raise node.unsupported(f"{message} {advice}")
        if node.is_list and not is_either:
            raise node.wrong("a name" if hyphen is None else "a type")
        if hyphen is not None:
            names += [(name, node) for name in waiting]
            waiting = []
            hyphen = None
        elif node.word == "-":
            hyphen = node
        elif are_variables and not node.lower.startswith("?"):
            raise node.wrong(f"a variable such as '?{node.word}'")
        else:
            waiting.append(node)
    if hyphen is not None:
        raise hyphen.error("found '-' at the end, expected a type after it")
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
    root = parse(text, where, "(predicate object)")
    if not root.children:
        raise root.wrong("a list such as '(predicate object)'")

    def unknown(_: Node, message: str) -> Exception:
        return UnknownNameError(f"{where}: {message}")

    names = domain.kinds, domain.signatures, domain.types
    formulas = Formulas(*names, domain.axioms.keys(), unknown)
    goals = list[Goal]()
    for part in conjuncts([formulas.condition(root, {})]):
        read = domain.computed | domain.compared
        strange = names_in([part]) & (domain.numeric - read)
        if strange:
            compared = ", ".join(sorted(read)) or "none"
            message = f"compares {min(strange)}, which no condition of the files does"
            raise UnsupportedPddlError(f"{message}; compared are {compared}", where)
        goals.append(Goal(text_of(part), part, worth))
    return tuple(goals)


Scope = Mapping[str, str]
"""The type of each variable."""


@dataclass(frozen=True)
class Formulas:
    """Reads formulas, with the declared names; `duration` stands for `?duration` in effects."""

    kinds: Mapping[str, tuple[str, tuple[str, ...]]]
    signatures: Mapping[str, Signature]
    types: Mapping[str, tuple[str, ...]]
    derived: Collection[str]
    unknown: Callable[[Node, str], Exception] = Node.error
    duration: Number = None

    def condition(self, node: Node, scope: Scope) -> Formula:
        """Read a condition."""
        head = node.head
        parts = node.children[1:]
        if node.is_list and not node.children:
            return TRUE
        if head in ("and", "or"):
            return head, *(self.condition(part, scope) for part in parts)
        if head in ("forall", "exists"):
            variables, within, body = self.quantified(node)
            if not variables:
                raise node.wrong("a variable such as '?x' in it")
            inner = self.condition(body, {**scope, **dict(variables)})
            if within != TRUE and head == "forall":
                return head, variables, ("or", ("not", within), inner)
            return head, variables, ("and", within, inner) if within != TRUE else inner
        if head == "not":
            self._check_count(node, 1)
            return "not", self.condition(parts[0], scope)
        if head == "imply":
            self._check_count(node, 2)
            premise, conclusion = (self.condition(part, scope) for part in parts)
            return "or", ("not", premise), conclusion
        if head not in ("=", *_COMPARISONS):
            return self.atom(node, scope)
        self._check_count(node, 2)
        is_about_numbers = any(part.is_list or NUMBER.fullmatch(part.lower) for part in parts)
        if head == "=" and not is_about_numbers:
            return "same", *(self._term(part, scope) for part in parts)
        left, right = (self.number(part, scope) for part in parts)
        if head[0] == ">":
            return "<" + head[1:], right, left
        return head, left, right

    def quantified(self, node: Node) -> tuple[Variables, Formula, Node]:
        """Return the variables of a quantifier, a check of their types, and the formula in it."""
        if len(node.children) != 3 or not node.children[1].is_list:
            raise node.wrong(f"'({node.head} (?x - type) (...))'")
        return *self.variables(node.children[1].children), node.children[2]

    def variables(self, nodes: Iterable[Node]) -> tuple[Variables, Formula]:
        """Read variables with their types, and return a check of types `(either ...)`.

        A variable of one of several types has what is above all of them.
        """
        types = dict[str, str]()
        checks = list[Formula]()
        for name, kind in typed(nodes, are_variables=True):
            if name.lower in types:
                message = f"found the parameter {name.word!r} again, expected another name"
                raise name.error(message)
            kinds = (kind or _OBJECT,) if kind is None or not kind.is_list else kind.children[1:]
            lineages = [self.lineage(each) for each in kinds]
            shared = [each for each in lineages[0] if all(each in other for other in lineages)]
            types[name.lower] = self.kinds[shared[0]][0]
            if len(kinds) > 1:
                same: Formula = ("same", name.lower, "?either")
                cases = [("exists", (("?either", each.lower),), same) for each in kinds]
                checks.append(("or", *cases))
        return tuple(types.items()), ("and", *checks)

    def lineage(self, node: Node) -> tuple[str, ...]:
        """Return a type and its ancestors, in lower case."""
        if node.lower not in self.kinds:
            raise self._unknown_name("type", node, [name for name, _ in self.kinds.values()])
        return self.kinds[node.lower][1]

    def atom(self, node: Node, scope: Scope, *, changes: bool = False) -> Formula:
        """Read an atom; with `changes`, one that is stated or changed, so that is not derived."""
        signature = self._signature(node)
        if signature.is_number:
            expected = "expected a predicate; compare it, as in (> (x) 0)"
            raise node.error(f"found {str(node)!r}, which is a number, {expected}")
        if changes and node.head in self.derived:
            message = f"found {str(node)!r}, which is derived: it is neither stated nor changed"
            raise node.error(message)
        return "atom", signature.name, self._arguments(node, signature, scope)

    def number_atom(self, node: Node, scope: Scope) -> Formula:
        """Read a number such as `(fuel ?r)`."""
        signature = self._signature(node)
        if not signature.is_number:
            raise node.error(f"found {str(node)!r}, which is a predicate, expected a number")
        return "n", signature.name, self._arguments(node, signature, scope)

    def number(self, node: Node, scope: Scope) -> Number:
        """Read a constant, a number of the domain, or an operator with its parts."""
        if node.lower == DURATION and self.duration is not None:
            return self.duration
        if TIME in (node.lower, node.head):
            return "n", TIME, ()
        if not node.is_list:
            return self.constant(node)
        if node.head not in ("+", "-", "*", "/"):
            return self.number_atom(node, scope)
        parts = [self.number(part, scope) for part in node.children[1:]]
        if node.head == "-" and len(parts) == 1:
            parts.insert(0, 0)
        if len(parts) != 2 and (not parts or node.head in ("-", "/")):
            self._check_count(node, 2)
        if any(isinstance(part, tuple) for part in parts):
            return node.head, *parts
        try:
            return reduce(OPERATORS[node.head], parts)
        except ZeroDivisionError:
            raise node.wrong("a number of at most 1e308") from None

    def constant(self, node: Node) -> Exact:
        """Read a number that is written in digits."""
        try:
            value = Fraction(node.lower if NUMBER.fullmatch(node.lower) else "")
            float(value)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise node.wrong("a number of at most 1e308") from None
        return exact(value)

    def _signature(self, node: Node) -> Signature:
        if not node.head:
            raise node.wrong("a list such as '(predicate object)'")
        if node.head not in self.signatures:
            names = [each.name for each in self.signatures.values()]
            names += [*_CONNECTIVES, *_CHANGES]
            raise self._unknown_name("predicate", node.children[0], names)
        return self.signatures[node.head]

    def _arguments(self, node: Node, signature: Signature, scope: Scope) -> tuple[str, ...]:
        terms = [self._term(part, scope) for part in node.children[1:]]
        if len(terms) != len(signature.types):
            message = f"found {len(terms)} arguments of {signature.name!r}, expected"
            raise self.unknown(node.children[0], f"{message} {len(signature.types)}")
        for term, expected in zip(terms, signature.types, strict=True):
            lineage = self.types[term] if term in self.types else self.kinds[scope[term].lower()][1]
            if expected.lower() not in lineage:
                message = f"the arguments of {signature.name!r} are of other types than declared:"
                raise self.unknown(node, f"{message} {signature}")
        return tuple(terms)

    def _term(self, node: Node, scope: Scope) -> str:
        if node.is_list:
            raise node.unsupported(f"{node} is no object; a formula is about what is true")
        if node.lower.startswith("?"):
            if node.lower not in scope:
                message = f"found the variable {node.word!r}, expected a parameter"
                raise self.unknown(node, f"{message}; {nearest(node.lower, scope)}")
            return node.lower
        for name in (node.word or "",) if node.word in self.types else self.types:
            if name.lower() == node.lower:
                return name
        raise self._unknown_name("object", node, self.types)

    def _check_count(self, node: Node, count: int) -> None:
        if len(node.children) != count + 1:
            message = f"found {len(node.children) - 1} parts in {node}"
            raise node.error(f"{message}, expected {count}")

    def _unknown_name(self, kind: str, node: Node, names: Iterable[str]) -> Exception:
        message = f"found the unknown {kind} {node.word!r}, expected a declared one"
        return self.unknown(node, f"{message}; {nearest(node.lower, names)}")


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
    texts = read_file(domain), None if problem is None else read_file(problem)
    return _read(*texts, str(domain), str(problem), actions)


def parse_domain(
    domain: str, problem: str | None = None, *, actions: Mapping[str, str] | None = None
) -> Domain:
    """Read a PDDL domain and problem from texts, as `load_domain` does from files."""
    return _read(domain, problem, "domain.pddl", "problem.pddl", actions)


def _read(
    domain: str,
    problem: str | None,
    file: str,
    problem_file: str,
    actions: Mapping[str, str] | None,
) -> Domain:
    root = parse(domain, file)
    _check_frame(root, "domain")
    name = root.children[1].children[1]
    if problem is None:
        problem, problem_file = f"(define (problem {name}) (:goal ()))", "no problem file"
    tasks = parse(problem, problem_file)
    _check_frame(tasks, "problem")
    for node in tasks.children:
        if node.head == ":domain" and [each.lower for each in node.children[1:]] != [name.lower]:
            raise node.wrong(f"'(:domain {name})', as {file} is called")
    goals = section(tasks, ":goal")
    if len(goals) != 1:
        message = f"found {len(goals)} conditions in (:goal ...), expected one"
        node = next((node for node in tasks.children if node.head == ":goal"), tasks)
        raise node.error(f"{message}; join them with (and ...)")
    read = _Reader(root, tasks, actions or {}).domain()
    return replace(read, texts=(domain, problem))


def _check_frame(root: Node, what: str) -> None:
    if root.head != "define" or len(root.children) < 2:
        raise root.wrong(f"'(define ({what} ...) ...)'")
    title = root.children[1]
    if title.head != what or len(title.children) != 2:
        raise title.wrong(f"'({what} NAME)'; is this the {what} file?")
    for node in root.children[2:]:
        if node.head in _HIERARCHY:
            message = f"found '({node.head}': hierarchies are not executed here"
            raise node.unsupported(f"{message}; Aries (up-aries) by itself would do")
        if node.head not in _SECTIONS[what]:
            raise node.wrong(f"a section; {nearest(node.head, _SECTIONS[what])}")


class _Reader:
    """Reads a domain and its problem, section by section."""

    def __init__(self, domain: Node, problem: Node, actions: Mapping[str, str]) -> None:
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
        derived = self._rules.keys()
        self._formulas = Formulas(self._kinds, self._signatures, self._types, derived)

    def domain(self) -> Domain:
        """Read all sections."""
        domain, problem = self._domain, self._problem
        for root in (domain, problem):
            self._look_through(root)
        self._read_types()
        for node in section(domain, ":predicates"):
            self._declare_signature(node, is_number=False)
        for head, rules in self._rules.items():
            if head not in self._signatures:
                self._declare_signature(rules[0].children[1], is_number=False)
        if self._actions and FEASIBLE not in self._signatures:
            self._signatures[FEASIBLE] = Signature(FEASIBLE, (("?a", ACTION_TYPE),), False)
        self._read_functions()
        self._read_objects(section(domain, ":constants"))
        constants = frozenset(self._types)
        self._read_objects(section(problem, ":objects"))
        self._read_rosa_actions()
        for node in domain.children[2:]:
            if node.head in _BODY:
                self._read_action(node)
        read = Domain(
            name=str(domain.children[1].children[1]),
            file=domain.file,
            problem_file=problem.file,
            schema_of=self._schemas,
            signatures=self._signatures,
            kinds=self._kinds,
            types=self._types,
            constants=constants,
            places=self._places,
        )
        if not self._only_planned:
            read = self._with_formulas(read)
        notes = tuple(self._notes)
        return replace(read, oversights=notes, only_planned=self._only_planned)

    def _with_formulas(self, domain: Domain) -> Domain:
        facts = set[str]()
        numbers = dict[str, Exact]()
        timed = list[TimedFact]()
        for node in _conjuncts(section(self._problem, ":init")):
            self._read_fact(node, facts, numbers, timed)
        goal = [self._formulas.condition(node, {}) for node in section(self._problem, ":goal")]
        domain = replace(
            domain,
            facts=frozenset(facts),
            numbers=numbers,
            timed=tuple(sorted(timed)),
            goal=tuple(conjuncts(goal)),
            metric=self._metric(),
            axioms=self._read_axioms(),
        )
        read = _numbers_read(domain)
        effects = [effect for schema in self._schemas.values() for effect in schema.effects]
        changed = {effect.name for effect in effects if effect.is_numeric}
        return replace(domain, computed=read & changed, compared=read - changed)

    def _look_through(self, root: Node) -> None:
        """Note types without their space, and find what can only be planned."""
        for node in root.nodes:
            word = node.lower or node.head
            if word in _ONLY_PLANNED:
                self._forbid_execution(node, _ONLY_PLANNED[word])
            for mark, kind in pairwise(node.children):
                is_glued = (mark.line, mark.column + 1) == (kind.line, kind.column)
                if mark.word == "-" and is_glued and not kind.is_list:
                    note = f"'-{kind}' is read as '- {kind}'; write it with the space"
                    self._notes.append(f"{root.file}:{mark.line}: {note}")

    def _forbid_execution(self, node: Node, why: str) -> None:
        self._only_planned = self._only_planned or f"{node.file}:{node.line}: {why}"

    # ------------------------------------------------------------ names

    def _declare(self, kind: str, node: Node, names: Iterable[str]) -> None:
        if not is_name(str(node)):
            message = f"found the {kind} {str(node)!r}, expected a name"
            raise node.error(f"{message}: a letter, then letters, digits, '_' or '-'")
        for name in names:
            if name.lower() == node.lower:
                file, line = self._places.get((kind, name), ("", 0))
                where = f", in line {line} of {file}" if line else ""
                raise node.error(f"the {kind} {node.word!r} was declared before{where}")
        self._places[kind, str(node)] = (node.file, node.line)

    def _read_types(self) -> None:
        names = dict[str, Node]()
        parents = dict[str, str]()
        for name, parent in typed(section(self._domain, ":types")):
            if parent is not None:
                names.setdefault(parent.lower, parent)
            if name.lower == "object":
                continue
            if name.lower in parents:
                message = f"the type {name.word!r} was declared before, expected one type above it"
                raise name.error(message)
            names[name.lower] = name
            is_root = parent is None or parent.lower == name.lower
            parents[name.lower] = "object" if parent is None or is_root else parent.lower
        if self._actions:
            names.setdefault(ACTION_TYPE, Node(ACTION_TYPE))
        names.pop("object", None)
        above = {name: [parents.get(name, "object")] for name in names}
        try:
            in_order = list(TopologicalSorter(above).static_order())
        except CycleError as error:
            cycle = error.args[1]
            message = f"the types {', '.join(sorted({*cycle}))} are above one another"
            raise names[cycle[0]].error(f"{message}, expected one on top") from error
        for kind in in_order:
            if kind != "object":
                self._declare("type", names[kind], ())
                self._kinds[kind] = (str(names[kind]), (kind, *self._kinds[above[kind][0]][1]))

    def _declare_signature(self, node: Node, *, is_number: bool) -> None:
        if not node.head:
            raise node.wrong(f"a list such as '({node.word or 'name'} ?x)'")
        variables, _ = self._formulas.variables(node.children[1:])
        names = [each.name for each in self._signatures.values()]
        self._declare("predicate", node.children[0], names)
        self._signatures[node.head] = Signature(str(node.children[0]), variables, is_number)

    def _read_functions(self) -> None:
        is_type = False
        for node in section(self._domain, ":functions"):
            if is_type and node.lower != "number":
                why = f"the value of a function is a {node.word}; write a predicate with one more"
                self._forbid_execution(node, f"{why} argument")
            elif node.lower not in ("-", "number"):
                self._declare_signature(node, is_number=True)
            is_type = node.word == "-"

    def _read_objects(self, nodes: Iterable[Node]) -> None:
        for node, kind in typed(nodes):
            lineage = self._formulas.lineage(kind or _OBJECT)
            same = [name for name in self._types if name.lower() == node.lower]
            if same and self._types[same[0]] == lineage:
                if self._places["object", same[0]][0] == node.file:
                    note = f"the object {node.word!r} is declared twice"
                    self._notes.append(f"{node.file}:{node.line}: {note}")
                continue
            self._declare("object", node, self._types)
            self._types[str(node)] = lineage

    def _read_rosa_actions(self) -> None:
        """Apply `actions`, which says which ROSA actions PDDL actions do."""
        nodes = [node for node in self._domain.children[2:] if node.head in _BODY]
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
        parts = _body_of(node)
        title = node.children[1]
        variables, within = self._formulas.variables(parts.get(":parameters", _EMPTY).children)
        self._declare("action", title, self._schemas)
        schema = Schema(str(title), tuple((word[1:], kind) for word, kind in variables))
        if not self._only_planned:
            reader = _ActionReader(self._formulas, dict(variables), node)
            schema = reader.read(schema, parts, within)
        does = self._actions.get(schema.name)
        if does is not None:
            schema = self._requiring(schema, does)
        action = does.removeprefix("?") if does else _rosa_action_of(schema)
        self._schemas[schema.name] = replace(schema, action=action)

    def _requiring(self, schema: Schema, does: str) -> Schema:
        """Return an action that requires the ROSA action which it does."""
        parameters = [name for name, _ in schema.variables]
        if does.startswith("?") and does not in parameters:
            message = f"the PDDL action {schema.name!r} has no parameter {does!r}"
            raise UnknownNameError(f"{message}; {nearest(does, parameters)}")
        if FEASIBLE in {name.lower() for name in names_in(schema.conditions)}:
            return schema
        needed: Formula = ("atom", self._signatures[FEASIBLE].name, (does,))
        if schema.duration is None:
            return replace(schema, start=(*schema.start, needed))
        return replace(schema, over_all=(*schema.over_all, needed))

    # ------------------------------------------------------------ derived predicates

    def _derivations(self) -> dict[str, list[Node]]:
        rules: dict[str, list[Node]] = {}
        for node in self._domain.children[2:]:
            if node.head == ":derived":
                if len(node.children) != 3 or not node.children[1].head:
                    raise node.wrong("'(:derived (NAME ?x - type) CONDITION)'")
                rules.setdefault(node.children[1].head, []).append(node)
        return rules

    def _read_axioms(self) -> dict[str, tuple[Axiom, ...]]:
        """Read the rules of derived predicates, each with its layer."""
        read = dict[str, list[tuple[Variables, Formula]]]()
        for head, rules in self._rules.items():
            signature = self._signatures[head]
            for rule in rules:
                target = rule.children[1]
                variables, within = self._formulas.variables(target.children[1:])
                if len(variables) != len(signature.types):
                    message = f"found {len(variables)} arguments of {signature.name!r}, expected"
                    raise target.error(f"{message} {len(signature.types)}")
                condition = self._formulas.condition(rule.children[2], dict(variables))
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
                        if name.lower() in rules:
                            layers[head] = max(layers[head], before[name.lower()] + (not truth))
            if layers == before:
                return layers
        head = max(layers, key=lambda name: layers[name])
        message = f"{head!r} is derived from its own negation, which means nothing. Sense it, or"
        raise self._rules[head][0].unsupported(f"{message} make it an effect")

    # ------------------------------------------------------------ the problem

    def _read_fact(
        self, node: Node, facts: set[str], numbers: dict[str, Exact], timed: list[TimedFact]
    ) -> None:
        """Add what one part of `:init` states."""
        formulas = self._formulas
        parts = node.children
        if node.head == "at" and len(parts) == 3 and NUMBER.fullmatch(parts[1].lower):
            is_true = parts[2].head != "not"
            inner = parts[2] if is_true else parts[2].children[-1]
            if inner.head == "=":
                self._forbid_execution(node, "numbers change by themselves")
                return
            atom = text_of(formulas.atom(inner, {}, changes=True))
            timed.append(TimedFact(float(formulas.constant(parts[1])), atom, is_true))
        elif node.head == "=" and len(parts) == 3:
            text = text_of(formulas.number_atom(parts[1], {}))
            if text in numbers:
                raise node.error(f"found a second value of {text}, expected one")
            numbers[text] = formulas.constant(parts[2])
        elif node.head == "not" and len(parts) == 2:
            formulas.atom(parts[1], {}, changes=True)
        else:
            facts.add(text_of(formulas.atom(node, {}, changes=True)))

    def _metric(self) -> Number:
        for metric in self._problem.children:
            if metric.head != ":metric":
                continue
            parts = metric.children[1:]
            if len(parts) != 2 or parts[0].lower not in ("minimize", "maximize"):
                raise metric.wrong("'(:metric minimize (NAME))'")
            node = parts[1]
            if node.lower in self._signatures:
                node = replace(node, word=None, children=(node,))  # `minimize c` is `(c)`
            number = self._formulas.number(node, {})
            return ("-", 0, number) if parts[0].lower == "maximize" else number
        return None


def _rosa_action_of(schema: Schema) -> str | None:
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


def _numbers_read(domain: Domain) -> frozenset[str]:
    """Return the numbers on which conditions depend, and effects on such numbers."""
    schemas = domain.schema_of.values()
    effects = [effect for schema in schemas for effect in schema.effects]
    formulas = [*domain.goal, *(effect.condition for effect in effects)]
    for schema in schemas:
        formulas += schema.conditions
    for axioms in domain.axioms.values():
        formulas += [axiom.condition for axiom in axioms]
    read = names_in(formulas) & domain.numeric
    # numbers that change, and on which costs or durations depend
    changes = [effect for effect in effects if effect.is_numeric]
    amounts = [effect.amount for effect in changes]
    amounts += [bound for schema in schemas for bound in schema.duration or ()]
    read |= names_in(amounts) & {effect.name for effect in changes}
    read |= {effect.name for effect in changes if effect.kind in ("assign", "decrease")}
    for _ in domain.numeric:
        read |= names_in([effect.amount for effect in changes if effect.name in read])
    return frozenset(read & domain.numeric)


class _ActionReader:
    """Reads the conditions, effects and duration of an action."""

    def __init__(self, formulas: Formulas, scope: Scope, node: Node) -> None:
        self._formulas = formulas
        self._scope = scope
        self._node = node
        self._is_timed = node.head == ":durative-action"

    def read(self, schema: Schema, parts: Mapping[str, Node], within: Formula) -> Schema:
        """Return the action with what its parts say."""
        if self._is_timed:
            schema = replace(schema, duration=self._duration(parts[":duration"]))
        conditions: dict[str, list[Formula]] = {time: [] for time in _TIMES.values()}
        needed = parts.get(":condition", parts.get(":precondition", _EMPTY))
        for time, node in self._timed(needed):
            condition = self._formulas.condition(node, self._scope)
            conditions[time] += conjuncts([condition])
        conditions["start"] += conjuncts([within])
        effects = list(self._effects(parts.get(":effect", _EMPTY), _Where(self._scope)))
        return replace(
            schema,
            start=tuple(conditions["start"]),
            over_all=tuple(conditions["over_all"]),
            end=tuple(conditions["end"]),
            start_effects=tuple(effect for time, effect in effects if time == "start"),
            end_effects=tuple(effect for time, effect in effects if time != "start"),
        )

    def _duration(self, node: Node) -> tuple[Number, Number]:
        """Return the shortest and the longest duration; a bound on one side only is both."""
        bounds = dict(self._bounds(node))
        fixed = bounds.get("=", 1 if not bounds else None)
        least = bounds.get(">", bounds.get("<", fixed))
        most = bounds.get("<", least)
        if least == most:
            self._formulas = replace(self._formulas, duration=least)
        return least, most

    def _bounds(self, node: Node) -> Iterator[tuple[str, Number]]:
        """Yield the first sign of each comparison, and the number."""
        if self._time_of(node) is not None or (node.head == "and" and len(node.children) in (2, 3)):
            for child in node.children[1:]:
                if child.is_list:
                    yield from self._bounds(child)
            return
        is_bound = node.head in ("=", *_COMPARISONS) and len(node.children) == 3
        if is_bound and node.children[1].lower == DURATION:
            value = self._formulas.number(node.children[2], self._scope)
            if not isinstance(value, tuple) and value < 0:
                raise node.wrong("a duration of 0 s or more")
            yield node.head[0], value
        elif node.children:
            expected = "a duration such as '(= ?duration 5)', or a least and a greatest one"
            raise node.wrong(expected)

    def _effects(self, node: Node, where: "_Where") -> Iterator[tuple[str, Effect]]:
        """Yield the effects, each with its time."""
        head = node.head
        parts = node.children[1:]
        if head == "and" or not (node.children or node.word):
            for part in parts:
                yield from self._effects(part, where)
        elif head == "forall":
            variables, within, body = self._formulas.quantified(node)
            yield from self._effects(body, where.inside(variables).on(within))
        elif head == "when" and len(parts) == 2 and (where.time or not self._is_timed):
            condition = self._formulas.condition(parts[0], where.scope)
            yield from self._effects(parts[1], where.on(condition))
        elif head == "when" and len(parts) == 2:
            time = self._time_of(parts[1])
            if time is None or time != self._time_of(parts[0]):
                message = "an effect at one time that depends on another is not supported"
                advice = "Write (when (at end ...) (at end ...)), or two actions"
                raise node.unsupported(f"found {node}: {message}. {advice}")
            condition = self._formulas.condition(parts[0].children[2], where.scope)
            yield from self._effects(parts[1], where.on(condition))
        elif self._is_timed and not where.time:
            time = self._time_of(node)
            if time in (None, "over_all"):
                raise self._untimed(node, ["at start", "at end"])
            yield from self._effects(parts[1], replace(where, time=time))
        else:
            yield where.time, self._effect(node, where)

    def _effect(self, node: Node, where: "_Where") -> Effect:
        formulas = self._formulas
        kind = node.head
        parts = node.children[1:]
        amount: Number = None
        if kind in _CHANGES:
            if len(parts) != 2 or not parts[0].head:
                raise node.wrong(f"({kind} (NAME) AMOUNT)")
            if formulas.duration is None and any(each.lower == DURATION for each in node.nodes):
                message = f"{self._node.children[1]} has an effect of ?duration, which is not fixed"
                raise node.unsupported(f"{message}; write (= ?duration ...)")
            atom = formulas.number_atom(parts[0], where.scope)
            amount = formulas.number(parts[1], where.scope)
            if kind.startswith("scale"):
                amount = ("*" if kind == "scale-up" else "/", atom, amount)
                kind = "assign"
        else:
            is_deleted = kind == "not" and len(parts) == 1 and parts[0].is_list
            kind = "delete" if is_deleted else "add"
            atom = formulas.atom(parts[0] if is_deleted else node, where.scope, changes=True)
        return Effect(kind, atom[1], atom[2], where.condition, where.variables, amount)

    def _time_of(self, node: Node) -> str | None:
        if len(node.children) != 3 or not node.children[2].is_list:
            return None
        return _TIMES.get((node.head, node.children[1].lower))

    def _timed(self, node: Node) -> Iterator[tuple[str, Node]]:
        """Yield conditions, each with its time, which durative actions state."""
        time = self._time_of(node)
        if not self._is_timed:
            yield "start", node
        elif time is not None:
            yield time, node.children[2]
        elif node.head == "and" or not node.children:
            for child in node.children[1:]:
                yield from self._timed(child)
        elif node.head == "forall" and len(node.children) == 3:
            for when, inner in self._timed(node.children[2]):
                yield when, replace(node, children=(*node.children[:2], inner))
        else:
            raise self._untimed(node, [" ".join(time) for time in _TIMES])

    def _untimed(self, node: Node, times: Iterable[str]) -> PddlError:
        expected = " or ".join(f"'({time} ...)'" for time in times)
        place = f" in (:durative-action {self._node.children[1]}"
        return node.wrong(f"{expected} around it", place)


@dataclass(frozen=True)
class _Where:
    """The context of an effect: the variables in scope, its time, and when it happens."""

    scope: Scope
    time: str = ""
    condition: Formula = TRUE
    variables: Variables = ()

    def inside(self, variables: Variables) -> "_Where":
        """Return the context within a quantifier."""
        scope = {**self.scope, **dict(variables)}
        return replace(self, scope=scope, variables=self.variables + variables)

    def on(self, condition: Formula) -> "_Where":
        """Return the context under a further condition."""
        parts = tuple(conjuncts([self.condition, condition]))
        return replace(self, condition=parts[0] if len(parts) == 1 else ("and", *parts))


def _body_of(node: Node) -> dict[str, Node]:
    """Return the parts of an action's description by their keywords."""
    title = node.children[1] if node.children[1:] else _EMPTY
    if title.is_list or title.lower.startswith(":"):
        raise node.wrong(f"'({node.head} NAME ...)'")
    allowed = _BODY[node.head]
    where = f" in {node.head} {title}"
    parts: dict[str, Node] = {}
    words = list(node.children[2:])
    while words:
        keyword = words.pop(0)
        if keyword.lower not in allowed:
            hint = nearest(keyword.lower, allowed)
            raise keyword.wrong(f"one of {' '.join(allowed)}; {hint}", where)
        if not words or not words[0].is_list:
            raise keyword.error(f"expected '(' after {keyword.word}")
        if keyword.lower in parts:
            message = f"found {keyword.word!r} again{where}; join the two with (and ...)"
            raise keyword.error(message)
        parts[keyword.lower] = words.pop(0)
    if node.head == ":durative-action" and ":duration" not in parts:
        raise node.error(f"(:durative-action {title} has no ':duration'")
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
        if head == "forall":  # it is checked, so what is in it must be known before
            yield from _polarities(formula[2], not truth)
