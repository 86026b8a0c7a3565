"""Reads PDDL that Kairos has checked: its messages say the file, the line and the column.

A list of a file is a tuple of words and lists. What Kairos lets pass and cannot be read here is
refused where it stands.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar

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
    PddlError,
    Schema,
    Signature,
    UnknownNameError,
    UnsupportedPddlError,
    Variables,
    atom_text,
    conjuncts,
    exact,
    names_in,
    nearest,
    text_of,
)

# a type may follow the hyphen without a space
_TOKEN = re.compile(r";[^\n]*|\s+|[()]|-(?=[A-Za-z])|[^\s();]+")
_NUMBER: Final = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]{1,3})?")
_COMPARISONS = ("<", "<=", ">", ">=")
_CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
_CONNECTIVES = ("and", "or", "not", "imply", "when", "forall", "exists")
_BODIES = (":action", ":durative-action")
_TIMES = {("at", "start"): "start", ("at", "end"): "end", ("over", "all"): "over_all"}
# Kairos plans with these, the executor has no notion of them.
_ONLY_PLANNED = frozenset(
    [
        "continuous-effects",
        "events",
        "global-constraints",
        "object-fluents",
        "preferences",
        "processes",
        "timed-initial-fluents",
        "timed-initial-literals",
        "trajectory-constraints",
    ]
)

T = TypeVar("T")
Tree: TypeAlias = Any
"""A word, or a tuple of trees."""
Scope: TypeAlias = Mapping[str, str]
"""The type of each variable."""


# ---------------------------------------------------------------- lists with their places


class Word(str):
    """A word of a file, with its place."""

    file = ""
    line: int | None = None
    column: int | None = None


def parse(text: str, file: str) -> Tree:
    """Parse PDDL text into its outermost list."""
    stack = list[list[Tree]]([[]])
    line = 1
    line_start = 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token == "(":
            stack.append([])
        elif token == ")" and len(stack) > 1:
            inner = tuple(stack.pop())
            stack[-1].append(inner)
        elif not token[0].isspace() and token[0] != ";":
            word = Word(token)
            word.file = file
            word.line = line
            word.column = match.start() - line_start + 1
            stack[-1].append(word)
        if "\n" in token:
            line += token.count("\n")
            line_start = match.start() + token.rindex("\n") + 1
    if len(stack) != 1 or len(stack[0]) != 1 or not isinstance(stack[0][0], tuple):
        message = "unbalanced parentheses, expected one list such as '(predicate object)'"
        stray = next((each for each in stack[0] if isinstance(each, Word)), Word())
        raise PddlError(message, file, stray.line, stray.column)
    return stack[0][0]


def words_in(tree: Tree) -> Iterator[Word]:
    """Yield the words of a tree."""
    if isinstance(tree, Word):
        yield tree
    for part in tree if isinstance(tree, tuple) else ():
        yield from words_in(part)


def _head(tree: Tree) -> str:
    """Return the first word of a list, in lower case; empty if there is none."""
    is_headed = isinstance(tree, tuple) and tree and isinstance(tree[0], str)
    return tree[0].lower() if is_headed else ""


def _text(tree: Tree) -> str:
    return f"({' '.join(map(_text, tree))})" if isinstance(tree, tuple) else str(tree)


def _error(tree: Tree, message: str, kind: type[PddlError] = PddlError) -> PddlError:
    """Return an error that says what was found, and where."""
    word = next(words_in(tree), Word())
    return kind(f"found {_text(tree)[:60]!r}, {message}", word.file, word.line, word.column)


def section(root: Tree, head: str) -> list[Tree]:
    """Return what is in all sections with a head, in the order of the file."""
    return [part for tree in root[2:] if _head(tree) == head for part in tree[1:]]


def typed(trees: Iterable[Tree]) -> Iterator[tuple[Word, Tree]]:
    """Yield each name of a typed list such as `a b - t c` with its type."""
    waiting = list[Word]()
    is_type = False
    for tree in trees:
        if is_type:
            yield from ((name, tree) for name in waiting)
            waiting.clear()
        elif tree != "-":
            waiting.append(tree)
        is_type = tree == "-"
    yield from ((name, Word("object")) for name in waiting)


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
    tree = parse(text, where)
    if not tree:
        raise PddlError("found (), expected a list such as '(predicate object)'", where)
    with _guarded(where):
        condition = _formulas_of(domain, where).condition(tree, {})
    goals = list[Goal]()
    for part in conjuncts([condition]):
        read = domain.computed | domain.compared
        strange = names_in([part]) & (domain.numeric - read)
        if strange:
            compared = ", ".join(sorted(read)) or "none"
            message = f"compares {min(strange)}, which no condition of the files does"
            raise UnsupportedPddlError(f"{message}; compared are {compared}", where)
        goals.append(Goal(text_of(part), part, worth))
    return tuple(goals)


def atom_of(domain: Domain, text: str) -> str:
    """Return an atom or a number as the files spell it, e.g. `(lit room)` for `lit ROOM`.

    Raises:
        UnknownNameError: a name is unknown, or the predicate is derived.
    """
    atoms: dict[str, str] = domain.cache.setdefault("atoms", {})
    if text not in atoms:
        tree = parse(f"({text.strip().removeprefix('(').removesuffix(')')})", repr(text))
        if _head(tree) in domain.axioms:
            raise UnknownNameError(f"{text!r} is derived: it is neither stated nor sensed")
        atoms[text] = atom_text(*_formulas_of(domain, domain.file).application(tree, {}))
    return atoms[text]


def _formulas_of(domain: Domain, where: str) -> "Formulas":
    def unknown(tree: Tree, message: str) -> Exception:
        return UnknownNameError(f"{where}: found {_text(tree)!r}, {message}")

    return Formulas(domain.kinds, domain.signatures, domain.types, unknown)


@contextmanager
def _guarded(file: str) -> Iterator[None]:
    """Refuse what cannot be read although it was not looked for."""
    try:
        yield
    except (LookupError, ValueError, TypeError, AttributeError) as error:
        raise PddlError(f"it cannot be read ({error}); is it PDDL?", file) from error


@dataclass(frozen=True)
class Formulas:
    """Reads formulas, with the declared names; `duration` stands for `?duration` in effects."""

    kinds: Mapping[str, tuple[str, tuple[str, ...]]]
    signatures: Mapping[str, Signature]
    types: Mapping[str, tuple[str, ...]]
    unknown: Callable[[Tree, str], Exception] = _error
    duration: Number = None

    def condition(self, tree: Tree, scope: Scope) -> Formula:
        """Read a condition."""
        if tree == ():
            return TRUE
        head = _head(tree)
        parts = tree[1:]
        if head in ("and", "or"):
            return head, *(self.condition(part, scope) for part in parts)
        if head == "not":
            (inner,) = parts
            return head, self.condition(inner, scope)
        if head == "imply":
            premise, conclusion = (self.condition(part, scope) for part in parts)
            return "or", ("not", premise), conclusion
        if head in ("forall", "exists"):
            variables, within = self.variables(parts[0])
            inner = self.condition(parts[1], {**scope, **dict(variables)})
            if within != TRUE:
                inner = (
                    ("and", within, inner) if head == "exists" else ("or", ("not", within), inner)
                )
            return head, variables, inner
        if head not in ("=", *_COMPARISONS):
            return self.atom(tree, scope)
        is_about_numbers = any(isinstance(p, tuple) or _NUMBER.fullmatch(p.lower()) for p in parts)
        if head == "=" and not is_about_numbers:
            return "same", *(self._term(part, scope) for part in parts)
        left, right = (self.number(part, scope) for part in parts)
        return ("<" + head[1:], right, left) if head[0] == ">" else (head, left, right)

    def variables(self, trees: Iterable[Tree]) -> tuple[Variables, Formula]:
        """Read variables with their types, and return a check of types `(either ...)`.

        A variable of one of several types has what is above all of them.
        """
        variables = list[tuple[str, str]]()
        checks = list[Formula]()
        for name, kind in typed(trees):
            kinds = kind[1:] if isinstance(kind, tuple) else (kind,)
            lineages = [self.lineage(each) for each in kinds]
            shared = [each for each in lineages[0] if all(each in other for other in lineages)]
            variables.append((name.lower(), self.kinds[shared[0]][0]))
            if len(kinds) > 1:
                same: Formula = ("same", name.lower(), "?either")
                cases = [("exists", (("?either", each.lower()),), same) for each in kinds]
                checks.append(("or", *cases))
        return tuple(variables), ("and", *checks)

    def lineage(self, kind: Word) -> tuple[str, ...]:
        """Return a type and its ancestors, in lower case."""
        return self._known(kind, "type", self.kinds)[1]

    def atom(self, tree: Tree, scope: Scope) -> Formula:
        """Read an atom."""
        return "atom", *self.application(tree, scope, is_number=False)

    def number(self, tree: Tree, scope: Scope) -> Number:
        """Read a constant, a number of the domain, or an operator with its parts."""
        if isinstance(tree, str):
            if tree.lower() == TIME:
                return "n", TIME, ()
            if tree.lower() == DURATION and self.duration is not None:
                return self.duration
            if not _NUMBER.fullmatch(tree.lower()):
                raise _error(tree, "expected a number")
            return exact(Fraction(tree.lower()))
        head = _head(tree)
        if head == TIME:
            return "n", TIME, ()
        if head not in ("+", "-", "*", "/"):
            return "n", *self.application(tree, scope, is_number=True)
        parts = [self.number(part, scope) for part in tree[1:]]
        return head, *([0] if head == "-" and len(parts) == 1 else []), *parts

    def application(
        self, tree: Tree, scope: Scope, *, is_number: bool | None = None
    ) -> tuple[str, tuple[str, ...]]:
        """Return the name and the terms of an atom, or of a number."""
        if not _head(tree):
            raise _error(tree, "expected a list such as '(predicate object)'")
        signature = self._known(tree[0], "predicate", self.signatures)
        if is_number not in (None, signature.is_number):
            expected = "a predicate, expected a number"
            if signature.is_number:
                expected = "a number, expected a predicate; compare it, as in (> (x) 0)"
            raise _error(tree, f"which is {expected}")
        terms = tuple(self._term(part, scope) for part in tree[1:])
        if len(terms) != len(signature.types):
            raise self.unknown(tree, f"expected {len(signature.types)} arguments: {signature}")
        for term, expected in zip(terms, signature.types, strict=True):
            lineage = self.types.get(term) or self.kinds[scope[term].lower()][1]
            # in files, Kairos has looked at the types
            if self.unknown is not _error and expected.lower() not in lineage:
                raise self.unknown(tree, f"whose arguments are of other types than {signature}")
        return signature.name, terms

    def _term(self, word: Tree, scope: Scope) -> str:
        if isinstance(word, tuple):
            raise _error(word, "expected an object", UnsupportedPddlError)
        if word.startswith("?"):
            self._known(word, "variable", scope)
            return str(word.lower())
        if word in self.types:
            return str(word)
        return self._known(word, "object", {name.lower(): name for name in self.types})

    def _known(self, word: Word, kind: str, names: Mapping[str, T]) -> T:
        """Return what a name stands for."""
        if word.lower() not in names:
            spelled = [*names, *(_CONNECTIVES if kind == "predicate" else ())]
            hint = nearest(word.lower(), spelled)
            raise self.unknown(word, f"which is no declared {kind}; {hint}")
        return names[word.lower()]


# ---------------------------------------------------------------- domains and problems


def load_domain(
    domain: Any,  # noqa: ANN401  # a path, or a problem of unified-planning, which ships no types
    problem: str | Path | None = None,
    *,
    actions: Mapping[str, str] | None = None,
) -> Domain:
    """Read a PDDL domain and problem.

    Names keep the spelling of the files; an object, an action, a predicate and a type may have the
    same name.

    Args:
        domain: path of the domain file, or a `Problem` of unified-planning.
        problem: path of the problem file; None if objects, facts and goals come from Python.
        actions: for PDDL actions of a domain without ROSA's predicates, the ROSA actions that they
            do; they get the condition `(over all (action_feasible ...))`.

    Raises:
        PddlError: a file cannot be read or is not correct PDDL; the message gives the place.
        UnknownNameError: `actions` names a PDDL action that there is not.
        UnsupportedPddlError: correct PDDL that cannot be planned here.
    """
    if hasattr(domain, "fluents"):
        from unified_planning.io import PDDLWriter

        writer = PDDLWriter(domain)
        return parse_domain(writer.get_domain(), writer.get_problem(), actions=actions)
    texts = list[str]()
    paths = [path for path in (domain, problem) if path is not None]
    for path in paths:
        try:
            texts.append(Path(path).read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
            raise PddlError(f"cannot read this PDDL file: {reason}", path) from error
    files = str(domain), str(problem)
    return _read(texts[0], texts[1] if problem else None, *files, actions or {})


def parse_domain(
    domain: str, problem: str | None = None, *, actions: Mapping[str, str] | None = None
) -> Domain:
    """Read a PDDL domain and problem from texts, as `load_domain` does from files."""
    return _read(domain, problem, "domain.pddl", "problem.pddl", actions or {})


def _read(
    domain: str, problem: str | None, file: str, problem_file: str, actions: Mapping[str, str]
) -> Domain:
    import kairos

    domain = domain.removeprefix("\ufeff")
    features = set[str]()
    try:
        checked = kairos.parse_domain(domain, file)
        features.update(checked.features())
        if problem is not None:
            task = kairos.parse_problem(problem.removeprefix("\ufeff"), checked, problem_file)
            features.update(task.features())
    except kairos.PddlError as error:
        errors = [each for each in error.diagnostics if each.severity is kairos.Severity.ERROR]
        wrong = errors[0]
        if wrong.code != "semantic.type_cycle":  # a type above itself has no other one above it
            place = wrong.location
            raise PddlError(wrong.message, place.file, place.line, place.column) from None
    root = parse(domain, file)
    if problem is None:
        problem = f"(define (problem {root[1][1]}) (:goal ()))"
        problem_file = "no problem file"
    tasks = parse(problem.removeprefix("\ufeff"), problem_file)
    only_planned = ", ".join(sorted(features & _ONLY_PLANNED))
    named = section(tasks, ":domain")
    if named and named[0].lower() != root[1][1].lower():
        raise _error(named[0], f"expected {root[1][1]!r}, as {file} is called")
    with _guarded(file):
        read = _Reader(root, tasks, actions, only_planned).domain()
    return replace(read, texts=(domain, problem))


@dataclass
class _Reader:
    """Reads a domain and its problem, section by section."""

    root: Tree
    problem: Tree
    does: Mapping[str, str]
    only_planned: str
    kinds: dict[str, tuple[str, tuple[str, ...]]] = field(
        default_factory=lambda: {"object": ("object", ("object",))}
    )
    signatures: dict[str, Signature] = field(default_factory=dict)
    types: dict[str, tuple[str, ...]] = field(default_factory=dict)
    places: dict[str, tuple[str, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def domain(self) -> Domain:
        """Read all sections."""
        file, problem_file = (next(words_in(root)).file for root in (self.root, self.problem))
        rules: dict[str, list[Tree]] = {}
        for tree in self.root[2:]:
            if _head(tree) == ":derived":
                rules.setdefault(_head(tree[1]), []).append(tree)
        self._formulas = Formulas(self.kinds, self.signatures, self.types)
        self._read_types()
        for tree in (*section(self.root, ":predicates"), *(each[0][1] for each in rules.values())):
            self._declare_signature(tree, is_number=False)
        for tree in section(self.root, ":functions"):
            if isinstance(tree, tuple):
                self._declare_signature(tree, is_number=True)
        self._read_objects(section(self.root, ":constants"))
        self._read_objects(section(self.problem, ":objects"))
        bodies = [tree for tree in self.root[2:] if _head(tree) in _BODIES]
        self._declare_rosa_actions([str(tree[1]) for tree in bodies])
        domain = Domain(
            name=str(self.root[1][1]),
            file=file,
            problem_file=problem_file,
            schema_of={str(tree[1]): self._schema(tree) for tree in bodies},
            signatures=self.signatures,
            kinds=self.kinds,
            types=self.types,
            places=self.places,
            oversights=tuple(self.notes),
        )
        if not section(self.problem, ":goal"):
            raise PddlError("there is no (:goal ...)", problem_file, 1, 1)
        domain = domain if self.only_planned else self._with_formulas(domain, rules)
        return replace(domain, only_planned=self.only_planned)

    def _with_formulas(self, domain: Domain, rules: Mapping[str, list[Tree]]) -> Domain:
        facts = set[str]()
        numbers = dict[str, Exact]()
        for tree in section(self.problem, ":init"):
            self._read_fact(tree, facts, numbers)
        goal = [self._formulas.condition(tree, {}) for tree in section(self.problem, ":goal")]
        domain = replace(
            domain,
            facts=frozenset(facts),
            numbers=numbers,
            goal=tuple(conjuncts(goal)),
            metric=self._metric(),
            axioms=self._axioms(rules),
        )
        read = _numbers_read(domain)
        effects = [effect for schema in domain.schema_of.values() for effect in schema.effects]
        changed = {effect.name for effect in effects if effect.is_numeric}
        return replace(domain, computed=read & changed, compared=read - changed)

    # ------------------------------------------------------------ names

    def _read_types(self) -> None:
        names = dict[str, Word]()
        above: dict[str, list[str]] = {}
        for name, parent in typed(section(self.root, ":types")):
            if isinstance(parent, tuple):
                raise _error(parent, "expected one type above it", UnsupportedPddlError)
            if name.lower() in above:
                raise _error(name, "which was declared before, expected one type above it")
            names.setdefault(parent.lower(), parent)
            names[name.lower()] = name
            is_root = parent.lower() == name.lower()
            above[name.lower()] = ["object" if is_root else parent.lower()]
        names.pop("object", None)
        above.pop("object", None)
        for kind in names:
            above.setdefault(kind, ["object"])
        for kind in TopologicalSorter(above).static_order():
            if kind in above:
                self.kinds[kind] = (str(names[kind]), (kind, *self.kinds[above[kind][0]][1]))

    def _declare_signature(self, tree: Tree, *, is_number: bool) -> None:
        variables, _ = self._formulas.variables(tree[1:])
        signature = Signature(str(tree[0]), variables, is_number)
        self.signatures.setdefault(_head(tree), signature)

    def _read_objects(self, trees: Iterable[Tree]) -> None:
        for name, kind in typed(trees):
            if isinstance(kind, tuple):
                message = "but an object has one type; declare a type above them"
                raise _error(kind, message, UnsupportedPddlError)
            lineage = self._formulas.lineage(kind)
            same = next((each for each in self.types if each.lower() == name.lower()), None)
            if same is None:
                self.types[str(name)] = lineage
                self.places[str(name)] = (name.file, name.line or 0)
                continue
            file, line = self.places[same]
            if self.types[same] != lineage:
                raise _error(name, f"which was declared before, in line {line} of {file}")
            if file == name.file:
                self.notes.append(f"{file}:{name.line}: the object {str(name)!r} is declared twice")

    def _declare_rosa_actions(self, schemas: list[str]) -> None:
        """Declare the ROSA actions that PDDL actions are said to do."""
        for schema, action in self.does.items():
            if schema not in schemas:
                raise UnknownNameError(f"no PDDL action {schema!r}; {nearest(schema, schemas)}")
            self.kinds.setdefault(ACTION_TYPE, (ACTION_TYPE, (ACTION_TYPE, "object")))
            signature = Signature(FEASIBLE, (("?a", ACTION_TYPE),), False)
            self.signatures.setdefault(FEASIBLE, signature)
            if ACTION_TYPE not in self.types.setdefault(action, (ACTION_TYPE, "object")):
                raise UnknownNameError(f"the object {action!r} is not of type {ACTION_TYPE!r}")

    # ------------------------------------------------------------ actions

    def _schema(self, tree: Tree) -> Schema:
        parts = {key.lower(): part for key, part in zip(tree[2::2], tree[3::2], strict=True)}
        variables, within = self._formulas.variables(parts.get(":parameters", ()))
        schema = Schema(str(tree[1]), tuple((word[1:], kind) for word, kind in variables))
        if not self.only_planned:
            reader = _ActionReader(self._formulas, dict(variables), _head(tree) != ":action")
            schema = reader.read(schema, parts, within)
        does = self.does.get(schema.name)
        if does is None:
            return replace(schema, action=_rosa_action_of(schema))
        feasible: Formula = ("atom", FEASIBLE, (does,))
        if schema.duration is None:
            return replace(schema, start=(*schema.start, feasible), action=does)
        return replace(schema, over_all=(*schema.over_all, feasible), action=does)

    # ------------------------------------------------------------ derived predicates

    def _axioms(self, rules: Mapping[str, list[Tree]]) -> dict[str, tuple[Axiom, ...]]:
        """Read the rules of derived predicates, each with its layer."""
        read = dict[str, list[tuple[Variables, Formula]]]()
        for head, each in rules.items():
            for _, target, condition in each:
                variables, within = self._formulas.variables(target[1:])
                formula = self._formulas.condition(condition, dict(variables))
                read.setdefault(head, []).append((variables, ("and", within, formula)))
        layers = dict.fromkeys(read, 1)
        for _ in range(len(read) + 1):
            before = dict(layers)
            for head, cases in read.items():
                for _, formula in cases:
                    for name, truth in _polarities(formula, True):
                        if name.lower() in read:
                            layers[head] = max(layers[head], before[name.lower()] + (not truth))
        axioms = dict[str, tuple[Axiom, ...]]()
        for head, cases in read.items():
            axioms[head] = tuple(Axiom(*case, layers[head]) for case in cases)
        return axioms

    # ------------------------------------------------------------ the problem

    def _read_fact(self, tree: Tree, facts: set[str], numbers: dict[str, Exact]) -> None:
        """Add what one part of `:init` states."""
        formulas = self._formulas
        head = _head(tree)
        if head == "and":
            for part in tree[1:]:
                self._read_fact(part, facts, numbers)
        elif head == "=":
            text = text_of(formulas.number(tree[1], {}))
            if text in numbers:
                raise _error(tree, "which is a second value, expected one")
            numbers[text] = formulas.number(tree[2], {})
        elif head == "not":
            formulas.atom(tree[1], {})
        else:
            facts.add(text_of(formulas.atom(tree, {})))

    def _metric(self) -> Number:
        metric = section(self.problem, ":metric")
        if not metric:
            return None
        kind, tree = metric
        if isinstance(tree, str) and tree.lower() in self.signatures:
            tree = (tree,)  # `minimize c` is `(c)`
        number = self._formulas.number(tree, {})
        return ("-", 0, number) if kind.lower() == "maximize" else number


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


def _polarities(formula: Formula, truth: bool) -> Iterator[tuple[str, bool]]:
    """Yield the predicates of a formula, each with whether it must be true or false."""
    head, *parts = formula
    if head == "atom":
        yield parts[0], truth
    elif head == "not":
        yield from _polarities(parts[0], not truth)
    elif head in ("and", "or"):
        for part in parts:
            yield from _polarities(part, truth)
    elif head in ("forall", "exists"):
        yield from _polarities(parts[1], truth)
        if head == "forall":  # it is checked, so what is in it must be known before
            yield from _polarities(parts[1], not truth)


@dataclass(frozen=True)
class _Where:
    """The context of an effect: the variables in scope, its time, and when it happens."""

    scope: Scope
    time: str = ""
    condition: Formula = TRUE
    variables: Variables = ()

    def on(self, condition: Formula) -> "_Where":
        """Return the context under a further condition."""
        parts = tuple(conjuncts([self.condition, condition]))
        return replace(self, condition=parts[0] if len(parts) == 1 else ("and", *parts))


@dataclass
class _ActionReader:
    """Reads the conditions, effects and duration of an action."""

    formulas: Formulas
    scope: Scope
    is_timed: bool

    def read(self, schema: Schema, parts: Mapping[str, Tree], within: Formula) -> Schema:
        """Return the action with what its parts say."""
        if self.is_timed:
            schema = replace(schema, duration=self._duration(parts[":duration"]))
        conditions: dict[str, list[Formula]] = {"start": [], "over_all": [], "end": []}
        needed = parts.get(":condition", parts.get(":precondition", ()))
        for time, tree in self._timed(needed):
            conditions[time] += conjuncts([self.formulas.condition(tree, self.scope)])
        conditions["start"] += conjuncts([within])
        effects = list(self._effects(parts.get(":effect", ()), _Where(self.scope)))
        return replace(
            schema,
            start=tuple(conditions["start"]),
            over_all=tuple(conditions["over_all"]),
            end=tuple(conditions["end"]),
            start_effects=tuple(effect for time, effect in effects if time == "start"),
            end_effects=tuple(effect for time, effect in effects if time != "start"),
        )

    def _duration(self, tree: Tree) -> tuple[Number, Number]:
        """Return the shortest and the longest duration; a bound on one side only is both."""
        bounds = dict(self._bounds(tree))
        fixed = bounds.get("=", 1 if not bounds else None)
        least = bounds.get(">", bounds.get("<", fixed))
        most = bounds.get("<", least)
        if least == most:
            self.formulas = replace(self.formulas, duration=least)
        return least, most

    def _bounds(self, tree: Tree) -> Iterator[tuple[str, Number]]:
        """Yield the first sign of each comparison, and the number."""
        if _head(tree) in ("=", *_COMPARISONS):
            yield tree[0][0], self.formulas.number(tree[2], self.scope)
            return
        for part in tree:
            if isinstance(part, tuple):
                yield from self._bounds(part)

    def _effects(self, tree: Tree, where: _Where) -> Iterator[tuple[str, Effect]]:
        """Yield the effects, each with its time."""
        head = _head(tree)
        parts = tree[1:]
        time = self._time_of(tree)
        if head == "and" or not tree:
            for part in parts:
                yield from self._effects(part, where)
        elif head == "forall":
            variables, within = self.formulas.variables(parts[0])
            scope = {**where.scope, **dict(variables)}
            where = replace(where, scope=scope, variables=where.variables + variables)
            yield from self._effects(parts[1], where.on(within))
        elif head == "when":
            condition = parts[0]
            if self.is_timed and not where.time:
                if self._time_of(condition) != self._time_of(parts[1]):
                    message = "an effect at one time that depends on another is not supported;"
                    advice = "write (when (at end ...) (at end ...)), or two actions"
                    raise _error(tree, f"{message} {advice}", UnsupportedPddlError)
                condition = condition[2]
            given = self.formulas.condition(condition, where.scope)
            yield from self._effects(parts[1], where.on(given))
        elif time and not where.time:
            yield from self._effects(parts[1], replace(where, time=time))
        else:
            yield where.time, self._effect(tree, where)

    def _effect(self, tree: Tree, where: _Where) -> Effect:
        formulas = self.formulas
        kind = _head(tree)
        amount: Number = None
        if kind in _CHANGES:
            if formulas.duration is None and DURATION in map(str.lower, words_in(tree)):
                message = "which is not fixed; write (= ?duration ...)"
                raise _error(tree, message, UnsupportedPddlError)
            atom = formulas.number(tree[1], where.scope)
            amount = formulas.number(tree[2], where.scope)
            if kind.startswith("scale"):
                amount = ("*" if kind == "scale-up" else "/", atom, amount)
                kind = "assign"
        else:
            is_deleted = kind == "not"
            kind = "delete" if is_deleted else "add"
            atom = formulas.atom(tree[1] if is_deleted else tree, where.scope)
        return Effect(kind, atom[1], atom[2], where.condition, where.variables, amount)

    def _time_of(self, tree: Tree) -> str | None:
        if not self.is_timed or len(tree) != 3 or not isinstance(tree[1], str):
            return None
        return _TIMES.get((_head(tree), tree[1].lower()))

    def _timed(self, tree: Tree) -> Iterator[tuple[str, Tree]]:
        """Yield conditions, each with its time, which durative actions state."""
        time = self._time_of(tree)
        if not self.is_timed:
            yield "start", tree
        elif time is not None:
            yield time, tree[2]
        elif _head(tree) == "forall":
            for when, inner in self._timed(tree[2]):
                yield when, (*tree[:2], inner)
        elif _head(tree) not in ("and", ""):
            raise _error(tree, "expected '(at start ...)', '(over all ...)' or '(at end ...)'")
        else:
            for part in tree[1:]:
                yield from self._timed(part)
