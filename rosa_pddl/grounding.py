"""Grounds a domain: joins conditions with facts, to derive atoms and to make the task of the search.

Conditions become rules as in a logic program; each new fact is looked at once (semi-naive
evaluation). A disjunction, and what exists, becomes a derived atom of its own with its own rules.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from threading import Lock
from typing import Any, NamedTuple, TypeAlias

from rosa_pddl.domain import (
    FALSE,
    TIME,
    TRUE,
    Axiom,
    Binding,
    Domain,
    Effect,
    Exact,
    Formula,
    Number,
    Schema,
    State,
    Step,
    Variables,
    atom_text,
    bound,
    exact,
    head_of,
    numbers_in,
    parts_of,
    text_of,
)
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.search import ALWAYS, Change, Condition, Operation, Phase, Rule, Task, TaskGraph
from rosa_pddl.search import State as SearchState

Row: TypeAlias = tuple[str, ...]
Word: TypeAlias = str | int
"""An object, or the place of a variable."""
Rows: TypeAlias = dict[str, dict[Row, None]]
GoOn: TypeAlias = Callable[[int], None]
"""Called now and then with the number of instances; may raise to stop the work."""

_BETWEEN_LOOKS = 500
_MOST_INSTANCES = 1_000_000
_MOST_DOMAINS = 8
_NEGATED = {"<": "<=", "<=": "<", "=": "!=", "!=": "="}
_RULES_FOR_A_MOVE = 20
_LOOKS_S = 0.05
_FOR_EVER: Any = float("inf")


class TooManyInstances(Exception):
    """A domain has more actions with their arguments than can be looked at."""


class UnsearchableError(Exception):
    """The search has no notion of something in a domain; the message says of what."""


# ---------------------------------------------------------------- joining rules with facts


class Literal(NamedTuple):
    """An atom that must be true, or false."""

    truth: bool
    name: str
    words: tuple[Word, ...]


@dataclass(eq=False)
class Clause:
    """A conjunction over variables, and the atoms that follow from it.

    Args:
        choices: the objects that each variable may be.
        heads: the atoms that follow.
        literals: the atoms that must be true or false.
        same: pairs that must be equal, or unequal.
        tests: comparisons of numbers.
        layer: the layer of a derived atom, 0 otherwise.
    """

    choices: list[dict[str, None]]
    heads: list[tuple[str, tuple[Word, ...]]] = field(default_factory=list)
    literals: list[Literal] = field(default_factory=list)
    same: list[tuple[bool, Word, Word]] = field(default_factory=list)
    tests: list[Formula] = field(default_factory=list)
    layer: int = 0


class _Look(NamedTuple):
    """A lookup of an atom, with the places whose objects are known at that time."""

    name: str
    words: tuple[Word, ...]
    places: tuple[int, ...]


class Program:
    """Clauses, prepared to be joined with facts."""

    def __init__(self, clauses: Iterable[Clause]) -> None:
        self.bodiless = list[Clause]()
        self.triggers: dict[str, list[tuple[Clause, _Look, list[_Look]]]] = {}
        self.indices: dict[str, set[tuple[int, ...]]] = {}
        self.names = set[str]()
        for clause in clauses:
            body = [literal for literal in clause.literals if literal.truth]
            self.names.update(literal.name for literal in clause.literals)
            if not body:
                self.bodiless.append(clause)
            for number in range(len(body)):
                first, *rest = _looks(body, number)
                self.triggers.setdefault(first.name, []).append((clause, first, rest))
                for look in rest:
                    self.indices.setdefault(look.name, set()).add(look.places)


def _looks(body: Sequence[Literal], first: int) -> list[_Look]:
    """Order atoms, from a given first one, so that each lookup has many known places."""
    left = list(range(len(body)))
    bound_words = set[Word]()
    looks = list[_Look]()

    def unknown(number: int) -> tuple[bool, int, int]:
        variables = [word for word in body[number].words if not isinstance(word, str)]
        free = [word for word in variables if word not in bound_words]
        return number != first, len(free), -len(variables)

    while left:
        number = min(left, key=unknown)
        left.remove(number)
        words = body[number].words
        places = list[int]()
        for place, word in enumerate(words):
            if isinstance(word, str) or word in bound_words:
                places.append(place)
        bound_words.update(word for word in words if not isinstance(word, str))
        looks.append(_Look(body[number].name, words, tuple(places)))
    return looks


class Join:
    """Joins a program with facts, until nothing more follows.

    Args:
        program: the clauses.
        accept: called with a clause and its complete row; whether the heads follow.
    """

    def __init__(self, program: Program, accept: Callable[[Clause, Row], bool]) -> None:
        self._program = program
        self._accept = accept
        self.rows: Rows = {}
        self._waiting: list[tuple[str, Row]] = []
        self._index: dict[tuple[str, tuple[int, ...]], dict[Row, list[Row]]] = {}

    def close(self, facts: Iterable[tuple[str, Row]]) -> Rows:
        """Return all rows that follow, by their predicates."""
        for name, row in facts:
            self._push(name, row)
        for clause in self._program.bodiless:
            self._complete(clause, [None] * len(clause.choices))
        for name, row in self._waiting:  # it grows meanwhile
            for places in self._program.indices.get(name, ()):
                key = tuple([row[place] for place in places])
                self._index.setdefault((name, places), {}).setdefault(key, []).append(row)
            for clause, look, rest in self._program.triggers.get(name, ()):
                binding = _matched(clause, look, row, [None] * len(clause.choices))
                if binding is not None:
                    self._join(clause, rest, binding)
        return self.rows

    def _push(self, name: str, row: Row) -> None:
        rows = self.rows.setdefault(name, {})
        if row not in rows:
            rows[row] = None
            self._waiting.append((name, row))

    def _join(self, clause: Clause, looks: Sequence[_Look], binding: list[str | None]) -> None:
        if not looks:
            self._complete(clause, binding)
            return
        look = looks[0]
        words = [look.words[place] for place in look.places]
        key: Any = tuple([word if isinstance(word, str) else binding[word] for word in words])
        for row in self._index.get((look.name, look.places), {}).get(key, ()):
            inner = _matched(clause, look, row, binding)
            if inner is not None:
                self._join(clause, looks[1:], inner)

    def _complete(self, clause: Clause, binding: list[str | None]) -> None:
        """Add what follows from a binding, for every choice of objects for free variables."""
        choices = list[Iterable[str]]()
        for place, thing in enumerate(binding):
            choices.append(clause.choices[place] if thing is None else (thing,))
        for row in product(*choices):
            same = [truth is (_at(one, row) == _at(two, row)) for truth, one, two in clause.same]
            if all(same) and self._accept(clause, row):
                for name, words in clause.heads:
                    self._push(name, tuple([_at(word, row) for word in words]))


def _at(word: Word, row: Sequence[str]) -> str:
    return word if isinstance(word, str) else row[word]


def _matched(
    clause: Clause, look: _Look, row: Row, binding: list[str | None]
) -> list[str | None] | None:
    """Return the binding extended by a row; None if the two contradict each other."""
    inner = binding.copy()
    for word, thing in zip(look.words, row, strict=True):
        if isinstance(word, str):
            if word != thing:
                return None
        elif inner[word] is None:
            if thing not in clause.choices[word]:
                return None
            inner[word] = thing
        elif inner[word] != thing:
            return None
    return inner


def row_of(atom: str) -> tuple[str, Row]:
    """Return the predicate and the arguments of an atom."""
    name, *words = atom[1:-1].split(" ")
    return name, tuple(words)


# ---------------------------------------------------------------- formulas as clauses


class Clauses:
    """Makes clauses of formulas; disjunctions and what exists get derived atoms of their own."""

    def __init__(self, domain: Domain) -> None:
        self._domain = domain
        self.derived = list[Clause]()
        self._layers = {name: rules[0].layer for name, rules in domain.axioms.items()}
        for name, rules in domain.axioms.items():
            for axiom in rules:
                self._add_axiom(domain.signatures[name].name, axiom)

    def _add_axiom(self, name: str, axiom: Axiom) -> None:
        words = range(len(axiom.variables))
        for part in _disjuncts(axiom.condition):
            # what exists is joined: its variables become variables of the clause
            variables, formula = _lifted(part, axiom.variables)
            clause = self.clause(variables, formula)
            if clause is not None:
                clause.heads.append((name, tuple(words)))
                clause.layer = axiom.layer
                self.derived.append(clause)

    def clause(self, variables: Variables, formula: Formula) -> Clause | None:
        """Return a condition as a clause; None if it can never hold."""
        objects = [dict.fromkeys(self._domain.objects_of(kind)) for _, kind in variables]
        clause = Clause(objects)
        places = {name: place for place, (name, _) in enumerate(variables)}
        return clause if self._fill(clause, formula, places, variables, True) else None

    def layer_of(self, name: str) -> int:
        """Return the layer of a predicate; 0 if it is not derived."""
        return self._layers.get(name.lower(), 0)

    def _fill(
        self,
        clause: Clause,
        formula: Formula,
        places: Mapping[str, int],
        variables: Variables,
        truth: bool,
    ) -> bool:
        """Add a condition, or its negation, to a clause; return whether it may hold."""
        head, *parts = formula
        if head == "not":
            return self._fill(clause, parts[0], places, variables, not truth)
        if head in ("and", "or") and (head == "and") is truth:
            fills = [self._fill(clause, part, places, variables, truth) for part in parts]
            return all(fills)
        if head in ("and", "or"):
            if not parts:
                return False
            if len(parts) == 1:
                return self._fill(clause, parts[0], places, variables, truth)
        if head in ("and", "or", "forall", "exists"):
            self._fill_derived(clause, formula, places, variables, truth)
        elif head == "atom":
            words = tuple([places.get(term, term) for term in parts[1]])
            clause.literals.append(Literal(truth, parts[0], words))
        elif head == "same":
            clause.same.append(
                (truth, places.get(parts[0], parts[0]), places.get(parts[1], parts[1]))
            )
        elif head == "in":
            return self._fill_type(clause, parts[0], parts[1], places, truth)
        else:
            kind = head if truth else _NEGATED[head]
            numbers = [placed(number, places) for number in parts]
            if not truth and head != "=":
                numbers.reverse()
            clause.tests.append((kind, *numbers))
        return True

    def _fill_type(
        self,
        clause: Clause,
        term: str,
        kinds: Iterable[str],
        places: Mapping[str, int],
        truth: bool,
    ) -> bool:
        fitting = set(chain.from_iterable(map(self._domain.objects_of, kinds)))
        if term not in places:
            return (term in fitting) is truth
        choices = clause.choices[places[term]]
        kept = [name for name in choices if (name in fitting) is truth]
        clause.choices[places[term]] = dict.fromkeys(kept)
        return True

    def _fill_derived(
        self,
        clause: Clause,
        formula: Formula,
        places: Mapping[str, int],
        variables: Variables,
        truth: bool,
    ) -> None:
        """Replace a disjunction, or what exists, by an atom that is derived from its parts."""
        kept = "or" if truth else "and"
        is_disjunction = formula[0] == kept or formula[0] == ("exists" if truth else "forall")
        # what holds for all is what does not exist otherwise
        wanted = truth if is_disjunction else not truth
        inner = formula if wanted else ("not", formula)
        free = [each for each in variables if each[0] in _terms_in(formula)]
        name = f"@{len(self._layers)}"
        self._layers[name] = 1
        layer = 1
        heads = [(name, tuple(range(len(free))))]
        for part in _disjuncts(inner):
            wider, body = _lifted(part, tuple(free))
            rule = self.clause(wider, body)
            if rule is not None:
                rule.heads = list(heads)
                self.derived.append(rule)
                for literal in rule.literals:
                    layer = max(layer, self.layer_of(literal.name) + (not literal.truth))
        for rule in self.derived:
            if rule.heads == heads:
                rule.layer = layer
        self._layers[name] = layer
        words = tuple([places[each] for each, _ in free])
        clause.literals.append(Literal(is_disjunction, name, words))


def _disjuncts(formula: Formula, truth: bool = True) -> Iterator[Formula]:
    """Yield formulas one of which holds if and only if a formula, or its negation, holds."""
    head = formula[0]
    if head == "not":
        yield from _disjuncts(formula[1], not truth)
    elif head == ("or" if truth else "and"):
        for part in formula[1:]:
            yield from _disjuncts(part, truth)
    elif head in ("and", "or") and len(formula) == 2:
        yield from _disjuncts(formula[1], truth)
    elif head == ("exists" if truth else "forall"):
        for part in _disjuncts(formula[2], truth):
            yield "exists", formula[1], part
    else:
        yield formula if truth else ("not", formula)


def _lifted(formula: Formula, outer: Variables) -> tuple[Variables, Formula]:
    """Return a formula whose outermost quantifiers are variables beside the outer ones."""
    variables = outer
    while formula[0] == "exists":
        taken = {name for name, _ in variables}
        renamed = dict[str, str]()
        for name, _ in formula[1]:
            fresh = name
            while fresh in taken:
                fresh += "_"
            renamed[name] = fresh
            taken.add(fresh)
        variables += tuple((renamed[name], kind) for name, kind in formula[1])
        formula = substituted(formula[2], renamed)
    if formula[0] == "and":
        parts = list[Formula]()
        for part in formula[1:]:
            variables, inner = _lifted(part, variables)
            parts.append(inner)
        formula = ("and", *parts)
    return variables, formula


def substituted(formula: Any, binding: Binding) -> Any:  # noqa: ANN401  # a formula or a number
    """Return a formula, or a number, with terms in the place of its free variables."""
    if not isinstance(formula, tuple) or not binding:
        return formula
    head, *parts = formula
    if head in ("atom", "n"):
        return head, parts[0], tuple(bound(parts[1], binding))
    if head == "same":
        return head, *bound(parts, binding)
    if head == "in":
        return head, binding.get(parts[0], parts[0]), parts[1]
    if head in ("forall", "exists"):
        hidden = {name for name, _ in parts[0]}
        visible = {name: thing for name, thing in binding.items() if name not in hidden}
        return head, parts[0], substituted(parts[1], visible)
    return head, *(substituted(part, binding) for part in parts)


def _terms_in(formula: Formula) -> set[str]:
    terms = set[str]()
    for part in parts_of(formula):
        if part[0] in ("atom", "n"):
            terms.update(part[2])
        elif part[0] == "same":
            terms.update(part[1:])
        elif part[0] == "in":
            terms.add(part[1])
    return terms


def placed(number: Number, places: Mapping[str, int]) -> Number:
    """Return a number with places in the place of its variables."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return head, parts[0], tuple([places.get(term, term) for term in parts[1]])
    return head, *(placed(part, places) for part in parts)


def ground_number(number: Number, row: Sequence[str]) -> Number:
    """Return a number with objects in the place of its places: numbers become `("n", text)`."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return head, atom_text(parts[0], [_at(word, row) for word in parts[1]])
    return head, *(ground_number(part, row) for part in parts)


def texts_in(number: Number) -> Iterator[str]:
    """Yield the texts of the numbers in a ground number."""
    if isinstance(number, tuple):
        if number[0] == "n":
            yield number[1]
        else:
            for part in number[1:]:
                yield from texts_in(part)


def derive(
    domain: Domain, facts: Iterable[str], passes: Callable[[Formula], bool]
) -> frozenset[str]:
    """Return the derived atoms that follow from facts, layer by layer.

    `passes` tells whether a comparison of ground numbers holds.
    """
    if "axioms" not in domain.cache:
        clauses = Clauses(domain).derived
        layers = sorted({clause.layer for clause in clauses})
        programs = [Program(c for c in clauses if c.layer == layer) for layer in layers]
        domain.cache["axioms"] = programs
    rows: Rows = {}
    prepared: list[Program] = domain.cache["axioms"]
    for fact in facts:
        if not fact.startswith("(= "):
            name, row = row_of(fact)
            rows.setdefault(name, {})[row] = None

    def accept(clause: Clause, row: Row) -> bool:
        for literal in clause.literals:
            words = tuple([_at(word, row) for word in literal.words])
            if not literal.truth and words in rows.get(literal.name, ()):
                return False
        tests = [(test[0], *[ground_number(n, row) for n in test[1:]]) for test in clause.tests]
        return all(passes(test) for test in tests)

    derived = set[str]()
    for program in prepared:
        known = [(name, row) for name in sorted(program.names & rows.keys()) for row in rows[name]]
        result = Join(program, accept).close(known)
        for name, each in result.items():
            for row in each:
                if row not in rows.get(name, ()):
                    rows.setdefault(name, {})[row] = None
                    derived.add(atom_text(name, row))
    return frozenset(derived)


# ---------------------------------------------------------------- what steps cost and take


def cost_of(domain: Domain, step: Step) -> Number:
    """Return what a step adds to the metric, as a ground number; 1 if there is no metric.

    Raises:
        UnsearchableError: that cannot be added up step by step.
    """
    if domain.metric is None:
        return 1
    costs: dict[Step, Number] = domain.cache.setdefault("costs", {})
    if step not in costs:
        costs[step] = _rise(domain, domain.metric, step)
    return costs[step]


def _rise(domain: Domain, metric: Number, step: Step) -> Number:
    if not isinstance(metric, tuple):
        return 0
    head, *parts = metric
    if head == "n":
        return duration_of(domain, step) if parts[0] == TIME else _rise_of(domain, parts, step)
    changes = [_rise(domain, part, step) for part in parts]
    if head in ("+", "-"):
        return sum_of(head, changes)
    constants = [part for part in parts if not isinstance(part, tuple)]
    if len(constants) < len(parts) - 1 or (head == "/" and isinstance(parts[1], tuple)):
        raise UnsearchableError(f"the metric {text_of(metric)} is no sum of numbers")
    if head == "/":
        return changes[0] and ("/", changes[0], parts[1])
    factor = constants[0]
    return sum_of("+", [change and ("*", factor, change) for change in changes])


def sum_of(head: str, parts: Sequence[Number]) -> Number:
    """Return a sum or a difference, without what is 0."""
    if all(part == 0 for part in parts[1:]):
        return parts[0]
    return (head, *parts)


def _rise_of(domain: Domain, number: Sequence[Any], step: Step) -> Number:
    name, terms = number
    schema = domain.schema_of[step.schema]
    binding = binding_of(domain, step)
    text = atom_text(name, terms)
    rises = list[Number]([0])
    for effect in schema.effects:
        if not effect.is_numeric or effect.name != name:
            continue
        target = atom_text(name, bound(effect.terms, binding))
        if effect.variables or effect.condition != TRUE or effect.kind != "increase":
            if effect.variables or target == text:
                raise UnsearchableError(f"{schema.name} changes {text} on conditions, or lowers it")
        elif target == text:
            rises.append(ground_number(substituted(effect.amount, binding), ()))
    rises = [rise for rise in rises if rise != 0] or [0]
    return rises[0] if len(rises) == 1 else ("+", *rises)


def duration_of(domain: Domain, step: Step) -> Number:
    """Return the shortest duration of a step [s], as a ground number."""
    duration = domain.schema_of[step.schema].duration
    if duration is None:
        return 0
    return ground_number(substituted(duration[0], binding_of(domain, step)), ())


def binding_of(domain: Domain, step: Step) -> Binding:
    """Return the arguments of a step by its variables."""
    names = [f"?{name}" for name, _ in domain.schema_of[step.schema].parameters]
    return dict(zip(names, step.arguments, strict=True))


# ---------------------------------------------------------------- the grounded task


@dataclass(eq=False)
class _Pattern:
    """An action as clauses: its conditions, and each effect with its condition."""

    schema: Schema
    whole: Clause
    start: Clause | None
    late: Clause | None
    effects: list[tuple[bool, Effect, Clause]]
    rows: dict[Row, None] = field(default_factory=dict)
    effect_rows: list[dict[Row, dict[Row, None]]] = field(default_factory=list)


class _Ready(NamedTuple):
    """An operation with its step; `lasting` are the facts it needs that never change."""

    step: Step
    needs: frozenset[str]
    lasting: frozenset[str]
    operation: Operation
    cost: Number


class Grounded:
    """A grounded task. Facts that no operation changes are frozen: they are checked first.

    It covers all states whose atoms are reachable from the base, see `covers`.

    Args:
        domain: what `load_domain` returned.
        base: the atoms that may be true initially, in any of the states to cover.
        go_on: called now and then during grounding; an error that it raises stops the grounding.

    Raises:
        UnsearchableError: the domain has something of which the search has no notion.
    """

    def __init__(self, domain: Domain, base: State, go_on: GoOn) -> None:
        if domain.only_planned or domain.timed:
            raise UnsearchableError(domain.only_planned or "facts change by themselves")
        self.domain = domain
        self.base = base
        self._clauses = Clauses(domain)
        self._patterns = [self._pattern(schema) for schema in domain.schema_of.values()]
        self._axiom_rows: dict[int, dict[Row, None]] = {}
        self._reach(base, go_on)
        self._numbers: dict[str, int] = {}
        self._mentioned = dict[str, None]()
        self._changing = frozenset(self._changing_atoms())
        self._operations = list[_Ready]()
        for pattern in self._patterns:
            for row in self._sorted(pattern):
                self._add_operation(pattern, row)
        self._rules = self._ground_rules()
        self._frozen = self._possible - self._changing
        self._costs = [self._number(ready.cost) for ready in self._operations]
        self._graphs: dict[Any, tuple[TaskGraph, Task]] = {}

    @property
    def size(self) -> int:
        """How many operations there are."""
        return len(self._operations)

    @property
    def work(self) -> int:
        """The work of a move relative to a task without axioms."""
        return 1 + len(self._rules) // _RULES_FOR_A_MOVE

    def step(self, number: int) -> Step:
        """Return the step of an operation."""
        return self._operations[number].step

    def covers(self, state: State) -> bool:
        """Whether the task is right for a state."""
        strange = [atom for atom in state - self._possible if not atom.startswith("(= ")]
        return not any(head_of(atom) in self._names for atom in strange)

    # ------------------------------------------------------------ reachable instances

    def _pattern(self, schema: Schema) -> _Pattern:
        variables = tuple((f"?{name}", kind) for name, kind in schema.parameters)
        clause = self._clauses.clause
        early = ("and", *schema.start)
        late = ("and", *schema.over_all, *schema.end)
        whole = clause(variables, ("and", early, late)) or self._impossible(variables)
        start = clause(variables, early) if schema.start_effects else None
        later = clause(variables, late) if schema.start_effects else None
        effects = list[tuple[bool, Effect, Clause]]()
        for is_late, each in ((False, schema.start_effects), (True, schema.end_effects)):
            for effect in each:
                condition = clause(variables + effect.variables, effect.condition)
                is_read = not effect.is_numeric or effect.name in self.domain.computed
                if condition is not None and is_read:
                    effects.append((is_late, effect, condition))
        return _Pattern(schema, whole, start, later, effects)

    def _impossible(self, variables: Variables) -> Clause:
        clause = Clause([{} for _ in variables])
        clause.same.append((False, "", ""))
        return clause

    def _reach(self, base: State, go_on: GoOn) -> None:
        """Find what is reachable as if nothing were ever deleted, and without numbers."""
        recorded: dict[int, dict[Row, None]] = {}
        clauses = list(self._clauses.derived)
        for clause in clauses:
            recorded[id(clause)] = self._axiom_rows[id(clause)] = {}
        for pattern in self._patterns:
            recorded[id(pattern.whole)] = pattern.rows
            clauses.append(pattern.whole)
            if pattern.start is not None:
                clauses.append(pattern.start)
            for is_late, effect, condition in pattern.effects:
                clauses += self._effect_clauses(pattern, is_late, effect, condition, recorded)
        work = 0

        def accept(clause: Clause, row: Row) -> bool:
            nonlocal work
            work += 1
            if work % _BETWEEN_LOOKS == 0:
                go_on(work)
            if work > _MOST_INSTANCES:
                raise TooManyInstances
            rows = recorded.get(id(clause))
            if rows is not None:
                if row in rows:
                    return False
                rows[row] = None
            return True

        program = Program(clauses)
        changed = [effect.name for each in self._patterns for _, effect, _ in each.effects]
        self._names = frozenset(program.names.union(changed))
        facts = [row_of(atom) for atom in sorted(base) if not atom.startswith("(= ")]
        rows = Join(program, accept).close(facts)
        possible = [atom_text(name, row) for name, each in rows.items() for row in each]
        self._possible = frozenset(possible)

    def _effect_clauses(
        self,
        pattern: _Pattern,
        is_late: bool,
        effect: Effect,
        condition: Clause,
        recorded: dict[int, dict[Row, None]],
    ) -> Iterator[Clause]:
        """Yield the clause that finds the instances of an effect, unless its action does."""
        before = pattern.whole if is_late or pattern.start is None else pattern.start
        variables = [f"?{name}" for name, _ in pattern.schema.parameters]
        variables += [name for name, _ in effect.variables]
        places = {name: place for place, name in enumerate(variables)}
        words = tuple([places.get(term, term) for term in effect.terms])
        is_simple = not effect.variables and effect.condition == TRUE
        if is_simple:
            pattern.effect_rows.append({})
            if effect.kind == "add":
                before.heads.append((effect.name, words))
            return
        choices = [dict(each) for each in condition.choices]
        for place, allowed in enumerate(before.choices):
            choices[place] = {name: None for name in choices[place] if name in allowed}
        clause = replace(
            condition,
            choices=choices,
            heads=[(effect.name, words)] if effect.kind == "add" else [],
            literals=[*before.literals, *condition.literals],
            same=[*before.same, *condition.same],
        )
        if effect.kind == "delete":
            clause.literals.append(Literal(True, effect.name, words))
        rows: dict[Row, None] = {}
        recorded[id(clause)] = rows
        pattern.effect_rows.append(_Grouped(rows, len(pattern.schema.parameters)))
        yield clause

    def _sorted(self, pattern: _Pattern) -> list[Row]:
        order = {name: number for number, name in enumerate(self.domain.types)}
        return sorted(pattern.rows, key=lambda row: [order[word] for word in row])

    def _changing_atoms(self) -> Iterator[str]:
        """Yield the atoms that operations change, or that must be false, and derived atoms."""
        for pattern in self._patterns:
            numbered = enumerate(pattern.effects)
            for number, (_, effect, condition) in numbered:
                rows = self._effect_rows(pattern, number)
                for row in rows:
                    if not effect.is_numeric:
                        yield self._target(pattern, effect, row)
                    yield from self._literals(condition, row)
            for row in pattern.rows:
                for literal in pattern.whole.literals:
                    if not literal.truth:
                        yield _literal_text(literal, row)
        for clause in self._clauses.derived:
            for row in self._axiom_rows[id(clause)]:
                yield from self._literals(clause, row)
                for name, words in clause.heads:
                    yield atom_text(name, [_at(word, row) for word in words])

    def _literals(self, clause: Clause, row: Row) -> Iterator[str]:
        for literal in clause.literals:
            yield _literal_text(literal, row)

    def _effect_rows(self, pattern: _Pattern, number: int) -> Iterable[Row]:
        grouped = pattern.effect_rows[number]
        return grouped.rows if isinstance(grouped, _Grouped) else pattern.rows

    def _target(self, pattern: _Pattern, effect: Effect, row: Row) -> str:
        variables = [f"?{name}" for name, _ in pattern.schema.parameters]
        variables += [name for name, _ in effect.variables]
        return atom_text(effect.name, bound(effect.terms, dict(zip(variables, row, strict=True))))

    # ------------------------------------------------------------ operations and rules

    def _add_operation(self, pattern: _Pattern, row: Row) -> None:
        schema = pattern.schema
        whole = self._condition(pattern.whole, row)
        if whole is None:
            return
        phases = list[Phase]()
        if pattern.start is None:
            phases.append(self._phase(pattern, row, whole, None))
        else:
            start = self._condition(pattern.start, row)
            late = None if pattern.late is None else self._condition(pattern.late, row)
            if start is None or late is None:
                return
            phases.append(self._phase(pattern, row, start, False))
            phases.append(self._phase(pattern, row, late, True))
        if not any(phase.changes_something for phase in phases):
            return
        step = self.domain.step(schema.name, row)
        needs = {_literal_text(each, row) for each in pattern.whole.literals if each.truth}
        lasting = frozenset(needs - self._changing)
        operation = Operation(len(self._operations), tuple(phases))
        cost = cost_of(self.domain, step)
        self._operations.append(_Ready(step, frozenset(needs), lasting, operation, cost))

    def _phase(
        self, pattern: _Pattern, row: Row, condition: Condition, is_late: bool | None
    ) -> Phase:
        adds, deletes = set[str](), set[str]()
        effects = list[tuple[Condition, str, bool]]()
        changes = list[Change]()
        for number, (late, effect, clause) in enumerate(pattern.effects):
            if is_late is not None and late is not is_late:
                continue
            grouped = pattern.effect_rows[number]
            rows = grouped.of(row) if isinstance(grouped, _Grouped) else [row]
            for inner in rows:
                given = self._condition(clause, inner)
                text = self._target(pattern, effect, inner)
                if given is None:
                    continue
                if effect.is_numeric:
                    changes.append(self._change(pattern, effect, text, given, inner))
                elif given == ALWAYS:
                    (adds if effect.kind == "add" else deletes).add(text)
                elif effect.kind == "add" or text in self._possible:
                    effects.append((given, text, effect.kind == "add"))
        deletes = {text for text in deletes - adds if text in self._possible}
        return Phase(condition, frozenset(deletes), frozenset(adds), tuple(effects), tuple(changes))

    def _change(
        self, pattern: _Pattern, effect: Effect, text: str, given: Condition, row: Row
    ) -> Change:
        place = self._numbers.setdefault(text, len(self._numbers))
        variables = [f"?{name}" for name, _ in pattern.schema.parameters]
        variables += [name for name, _ in effect.variables]
        places = {name: at for at, name in enumerate(variables)}
        amount = ground_number(placed(effect.amount, places), row)
        if effect.kind == "decrease":
            amount = ("-", 0, amount)
        return Change(given, place, effect.kind != "assign", self._number(amount))

    def _condition(self, clause: Clause, row: Row) -> Condition | None:
        """Return a clause for a row as a condition of the search; None if it cannot hold."""
        needs, denies = set[str](), set[str]()
        for literal in clause.literals:
            text = _literal_text(literal, row)
            if text not in self._possible:
                if literal.truth:
                    return None
            elif not literal.truth:
                denies.add(text)
            elif text in self._changing:
                needs.add(text)
        for truth, one, two in clause.same:
            if truth is not (_at(one, row) == _at(two, row)):
                return None
        tests = list[tuple[str, Number, Number]]()
        for kind, left, right in clause.tests:
            numbers = [self._number(ground_number(each, row)) for each in (left, right)]
            tests.append((kind, *numbers))
        return Condition(frozenset(needs), frozenset(denies), tuple(tests))

    def _number(self, number: Number) -> Number:
        """Return a number with places for numbers that change, and texts for all others."""
        if not isinstance(number, tuple):
            return number
        head, *parts = number
        if head != "n":
            return head, *(self._number(part) for part in parts)
        if parts[0] in self._changed_numbers:
            return "n", self._numbers.setdefault(parts[0], len(self._numbers))
        self._mentioned[parts[0]] = None
        return number

    @property
    def _changed_numbers(self) -> frozenset[str]:
        if not hasattr(self, "_changed"):
            changed = set[str]()
            for pattern in self._patterns:
                for number, (_, effect, _) in enumerate(pattern.effects):
                    if effect.is_numeric:
                        rows = self._effect_rows(pattern, number)
                        changed.update(self._target(pattern, effect, row) for row in rows)
            self._changed = frozenset(changed)
        return self._changed

    def _ground_rules(self) -> list[tuple[frozenset[str], Rule]]:
        """Return the rules of derived atoms, each with the frozen facts that it needs."""
        rules = list[tuple[frozenset[str], Rule]]()
        for clause in sorted(self._clauses.derived, key=lambda clause: clause.layer):
            for row in self._axiom_rows[id(clause)]:
                condition = self._condition(clause, row)
                if condition is None:
                    continue
                needs = {_literal_text(each, row) for each in clause.literals if each.truth}
                for name, words in clause.heads:
                    text = atom_text(name, [_at(word, row) for word in words])
                    rule = Rule(clause.layer, condition, text)
                    rules.append((frozenset(needs - self._changing), rule))
        return rules

    # ------------------------------------------------------------ tasks for the search

    def search_task(
        self,
        state: State,
        goals: Sequence[Formula],
        costs: Mapping[str, float],
        weights: Mapping[Step, int],
    ) -> tuple[TaskGraph, Task] | None:
        """Return the task for a state, goals and costs; None if a goal can never hold."""
        rules = list[Rule]()
        goal = self._goal(("and", *goals), state, rules)
        if goal is None:
            return None
        values = numbers_in(state)
        frozen = state & self._frozen
        static = {text: self._value_of(text, costs) for text in self._mentioned}
        for test in goal.tests:
            self._check_known(test, static)
        key = (goal, tuple(rules), frozen, tuple(static.values()), frozenset(weights.items()))
        if key not in self._graphs:
            if len(self._graphs) >= 4:
                self._graphs.pop(next(iter(self._graphs)))
            self._graphs[key] = self._graph(goal, rules, frozen, static, weights)
        graph, task = self._graphs[key]
        numbers = tuple([values.get(text) for text in self._numbers])
        return graph, task._replace(start=SearchState(state & self._changing, numbers))

    def _value_of(self, text: str, costs: Mapping[str, float]) -> Exact | None:
        value = costs.get(text, self.domain.numbers.get(text))
        return None if value is None else exact(value)

    def _graph(
        self,
        goal: Condition,
        goal_rules: Sequence[Rule],
        frozen: State,
        values: Mapping[str, Exact | None],
        weights: Mapping[Step, int],
    ) -> tuple[TaskGraph, Task]:
        costs = list[Number]()
        operations = list[Operation]()
        for ready, cost in zip(self._operations, self._costs, strict=True):
            weight = weights.get(ready.step, 1)
            if weight and ready.lasting <= frozen:
                filled_cost = filled(cost, values)
                self._check_known(cost, values)
                costs.append(filled_cost if weight == 1 else ("*", weight, filled_cost))
                operations.append(filled(ready.operation, values) if values else ready.operation)
        rules = [rule for lasting, rule in self._rules if lasting <= frozen]
        rules = sorted([*rules, *goal_rules], key=lambda rule: rule.layer)
        if values:
            goal = filled(goal, values)
            rules = [filled(rule, values) for rule in rules]
        start = SearchState(frozenset())
        task = Task(start, goal, tuple(operations), tuple(costs), tuple(rules))
        return TaskGraph(task), task

    def _check_known(self, cost: Number, values: Mapping[str, Exact | None]) -> None:
        for text in texts_in(cost):
            if isinstance(text, str) and values[text] is None:
                message = f"{text} is needed but has no value; state '(= {text} NUMBER)' in :init,"
                file = self.domain.problem_file
                raise UnsupportedPddlError(f"{message} or hand it in with the problem", file)

    def _goal(self, goal: Formula, state: State, rules: list[Rule]) -> Condition | None:
        """Return a goal as a condition, with rules for its disjunctions; None if it cannot hold."""
        simple = self._simplified(goal, {}, True, state)
        if simple == FALSE:
            return None
        return self._taken(simple, rules)

    def _taken(self, formula: Formula, rules: list[Rule]) -> Condition | None:
        needs, denies = set[str](), set[str]()
        tests = list[tuple[str, Number, Number]]()
        for part in formula[1:] if formula[0] == "and" else (formula,):
            if part[0] == "atom":
                (needs if part[1] else denies).add(part[2])
            elif part[0] == "or":
                needs.add(self._goal_atom(part, rules))
            else:
                numbers = [self._number(each) for each in part[1:]]
                tests.append((part[0], *numbers))
        if needs & denies:
            return None
        return Condition(frozenset(needs), frozenset(denies), tuple(tests))

    def _goal_atom(self, formula: Formula, rules: list[Rule]) -> str:
        """Return an atom that is derived if one part of a disjunction holds."""
        atom = f"(goal {len(rules)})"
        for part in formula[1:]:
            condition = self._taken(part, rules)
            if condition is not None:
                rules.append(Rule(len(self._rules) + len(rules) + 1, condition, atom))
        return atom

    def _simplified(self, formula: Formula, binding: Binding, truth: bool, state: State) -> Formula:
        """Return a condition, or its negation, with objects, without what is certain."""
        head, *parts = formula
        if head == "not":
            return self._simplified(parts[0], binding, not truth, state)
        if head == "atom":
            text = atom_text(parts[0], bound(parts[1], binding))
            if text in self._changing and text in self._possible:
                return "atom", truth, text
            return TRUE if (text in state) is truth else FALSE
        if head == "same":
            one, two = bound(parts, binding)
            return TRUE if (one == two) is truth else FALSE
        if head == "in":
            lineage = self.domain.types[binding.get(parts[0], parts[0])]
            return TRUE if any(kind in lineage for kind in parts[1]) is truth else FALSE
        if head in ("and", "or"):
            each = [self._simplified(part, binding, truth, state) for part in parts]
            return _joined((head == "and") is truth, each)
        if head in ("forall", "exists"):
            inner = [
                self._simplified(parts[1], wider, truth, state)
                for wider in self.domain.bindings(parts[0], binding)
            ]
            return _joined((head == "forall") is truth, inner)
        numbers = [ground_number(substituted(part, binding), ()) for part in parts]
        if truth:
            return head, *numbers
        return _NEGATED[head], *(numbers if head == "=" else reversed(numbers))

    # ------------------------------------------------------------ forecasts

    def with_forecasts(
        self,
        task: Task,
        until: Mapping[str, Exact],
        takes: Callable[[Step], Exact],
        shares: Mapping[Step, float],
    ) -> tuple[TaskGraph, Task]:
        """Add how much longer facts hold, as numbers that each step decreases by its duration.

        One more number is 1 until the first step: of a running step, only what is left counts.
        """
        first = len(task.start.numbers)
        places = {atom: first + 1 + number for number, atom in enumerate(until)}
        operations = list[Operation]()
        for operation in task.operations:
            ready = self._operations[operation.number]
            takes_s: Number = takes(ready.step)
            if ready.step in shares and takes_s:
                done_s = takes_s * (1 - exact(shares[ready.step]))
                takes_s = ("-", takes_s, ("*", done_s, ("n", first)))
            tests = list[tuple[str, Number, Number]]()
            changes = [Change(ALWAYS, first, False, 0)]
            for atom, place in places.items():
                if atom in ready.needs:
                    tests.append(("<=", takes_s, ("n", place)))
                changes.append(Change(ALWAYS, place, True, ("-", 0, takes_s)))
            early, *late = operation.phases
            last = operation.phases[-1]
            for atom in last.adds & places.keys():
                changes.append(Change(ALWAYS, places[atom], False, _FOR_EVER))
            for given, atom, truth in last.effects:
                if truth and atom in places:
                    changes.append(Change(given, places[atom], False, _FOR_EVER))
            condition = early.condition
            condition = condition._replace(tests=(*condition.tests, *tests))
            early = early._replace(condition=condition, changes=(*early.changes, *changes))
            operations.append(operation._replace(phases=(early, *late)))
        start = SearchState(task.start.atoms, (*task.start.numbers, 1, *until.values()))
        timed = task._replace(start=start, operations=tuple(operations))
        return TaskGraph(timed), timed


def filled(thing: Any, values: Mapping[str, Exact | None]) -> Any:  # noqa: ANN401  # any tuple
    """Return an operation, a condition or a number with values in the place of texts."""
    if not isinstance(thing, tuple):
        return thing
    if len(thing) == 2 and thing[0] == "n":
        return values[thing[1]] if isinstance(thing[1], str) else thing
    parts = [filled(part, values) for part in thing]
    return type(thing)(*parts) if hasattr(thing, "_fields") else tuple(parts)


class _Grouped(dict[Row, dict[Row, None]]):
    """The rows of an effect with variables, grouped by the row of its action."""

    def __init__(self, rows: dict[Row, None], count: int) -> None:
        super().__init__()
        self.rows = rows
        self._count = count

    def of(self, row: Row) -> list[Row]:
        """Return the rows of the effect for an action."""
        if not self:
            for each in self.rows:
                self.setdefault(each[: self._count], {})[each] = None
        return list(self.get(row, ()))


def _literal_text(literal: Literal, row: Row) -> str:
    return atom_text(literal.name, [_at(word, row) for word in literal.words])


def _joined(is_and: bool, parts: Iterable[Formula]) -> Formula:
    """Return a conjunction, or a disjunction, simplified."""
    certain, deciding = (TRUE, FALSE) if is_and else (FALSE, TRUE)
    kept = dict[Formula, None]()
    for part in parts:
        if part == deciding:
            return deciding
        if part[0] == certain[0]:
            kept.update(dict.fromkeys(part[1:]))
        elif part != certain:
            kept[part] = None
    return next(iter(kept)) if len(kept) == 1 else (certain[0], *kept)


class Groundings:
    """The grounded task of each domain, made on the first request, and again to cover more states.

    A task covers all feasibility facts and all named atoms from the beginning, and other atoms
    that no action adds as soon as a request had them. So what it covers depends on the requests
    before, never on how long anything takes.
    """

    def __init__(self) -> None:
        # by the caches of domains, which domains share that differ in numbers only
        self._tasks: dict[int, Grounded] = {}
        self._lock = Lock()

    def ready(self, domain: Domain, state: State) -> Grounded | None:
        """Return the task if there is one that covers a state, else None. Never waits."""
        task = self._tasks.get(id(domain.cache))
        return task if task is not None and task.covers(state) else None

    def ask(
        self, domain: Domain, state: State, go_on: GoOn, changing: Iterable[str] = ()
    ) -> Grounded:
        """Return a task that covers a state and the atoms named, made now if need be."""
        while not self._lock.acquire(timeout=_LOOKS_S):
            go_on(0)
        try:
            named = frozenset(changing)
            task = self._tasks.get(id(domain.cache))
            if task is None or not task.covers(state) or not named <= task.base:
                atoms = frozenset(atom for atom in state if not atom.startswith("(= "))
                base = frozenset() if task is None else task.base
                task = Grounded(domain, base.union(domain.feasibility, named, atoms), go_on)
            self._tasks.pop(id(domain.cache), None)
            if len(self._tasks) >= _MOST_DOMAINS:
                self._tasks.pop(next(iter(self._tasks)))
            self._tasks[id(domain.cache)] = task
            return task
        finally:
            self._lock.release()

    def close(self) -> None:
        """Forget all tasks."""
        self._tasks.clear()
