"""Joins rules with facts, and grounds what steps cost and how long they take.

A rule says which atoms follow from others. Each new fact is looked at once (semi-naive
evaluation). A type is a fact about each of its objects, such as `@room` of the hall.
"""

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count, product
from typing import Any, NamedTuple, TypeAlias

from rosa_pddl.domain import (
    TIME,
    TRUE,
    Axiom,
    Binding,
    Domain,
    Formula,
    Number,
    Step,
    Variables,
    atom_text,
    bound,
    text_of,
)

Row: TypeAlias = tuple[str, ...]
Literal: TypeAlias = tuple[str, Row]
"""A predicate with its terms, some of which may be variables."""
Rows: TypeAlias = dict[str, dict[Row, None]]

_ALWAYS: Literal = ("@", ())
_FRESH = count()


class UnsearchableError(Exception):
    """The search has no notion of something in a domain; the message says of what."""


# ---------------------------------------------------------------- rules


@dataclass(eq=False)
class Rule:
    """The heads follow for all objects for which the literals and the checks hold."""

    variables: Variables
    literals: Sequence[Literal]
    checks: Sequence[Formula] = ()
    heads: list[Literal] = field(default_factory=list)


class _Look(NamedTuple):
    """A lookup of a literal, with the places of the terms that are known by then."""

    name: str
    terms: Row
    places: tuple[int, ...]


class Join:
    """Rules, prepared to be joined with facts."""

    def __init__(self, rules: Iterable[Rule]) -> None:
        self.names = set[str]()
        self._triggers: dict[str, list[tuple[Rule, list[_Look]]]] = {}
        self._places: dict[str, set[tuple[int, ...]]] = {}
        for rule in rules:
            for first in range(len(rule.literals)):
                looks = _looks(rule.literals, first)
                self.names.add(looks[0].name)
                self._triggers.setdefault(looks[0].name, []).append((rule, looks))
                for look in looks[1:]:
                    self._places.setdefault(look.name, set()).add(look.places)

    def close(
        self, facts: Iterable[tuple[str, Row]], accept: Callable[[Rule, Binding], bool]
    ) -> Rows:
        """Return all rows that follow, by their predicates.

        `accept` is called with each instance of a rule, and tells whether its heads follow.
        """
        rows: Rows = {}
        waiting = list[tuple[str, Row]]()
        index: dict[tuple[str, tuple[int, ...]], dict[Row, list[Row]]] = {}

        def push(name: str, row: Row) -> None:
            if row not in rows.setdefault(name, {}):
                rows[name][row] = None
                waiting.append((name, row))

        def extend(rule: Rule, looks: Sequence[_Look], number: int, binding: Binding) -> None:
            if number == len(looks):
                if accept(rule, binding):
                    for name, terms in rule.heads:
                        push(name, tuple(bound(terms, binding)))
                return
            look = looks[number]
            key = tuple(bound([look.terms[place] for place in look.places], binding))
            for row in index.get((look.name, look.places), {}).get(key, ()):
                wider = _matched(look.terms, row, binding)
                if wider is not None:
                    extend(rule, looks, number + 1, wider)

        for name, row in facts:
            push(name, row)
        for name, row in waiting:  # it grows meanwhile
            for places in self._places.get(name, ()):
                key = tuple([row[place] for place in places])
                index.setdefault((name, places), {}).setdefault(key, []).append(row)
            for rule, looks in self._triggers.get(name, ()):
                binding = _matched(looks[0].terms, row, {})
                if binding is not None:
                    extend(rule, looks, 1, binding)
        return rows

    def facts(self, domain: Domain, atoms: Iterable[str]) -> Iterator[tuple[str, Row]]:
        """Yield what the rules may read: atoms, and types as facts about objects."""
        yield _ALWAYS
        for name in sorted(self.names):
            if name.startswith("@"):
                for thing in domain.objects_of(name[1:]):
                    yield name, (thing,)
        for atom in atoms:
            name, *terms = atom[1:-1].split(" ")
            if name in self.names:
                yield name, tuple(terms)


def _looks(literals: Sequence[Literal], first: int) -> list[_Look]:
    """Order literals, from a given first one, so that each lookup has many known places."""
    left = list(range(len(literals)))
    known = set[str]()
    looks = list[_Look]()

    def unknown(number: int) -> tuple[bool, int, int]:
        terms = literals[number][1]
        free = {term for term in terms if term.startswith("?")} - known
        return number != first, len(free), -len(terms)

    while left:
        number = min(left, key=unknown)
        left.remove(number)
        name, terms = literals[number]
        places = [n for n, term in enumerate(terms) if term in known or not term.startswith("?")]
        known.update(terms)
        looks.append(_Look(name, terms, tuple(places)))
    return looks


def _matched(terms: Row, row: Row, binding: Binding) -> Binding | None:
    """Return the binding extended by a row; None if the two contradict each other."""
    wider = dict(binding)
    for term, thing in zip(terms, row, strict=True):
        if wider.setdefault(term, thing if term.startswith("?") else term) != thing:
            return None
    return wider


def with_types(domain: Domain, variables: Variables, literals: Iterable[Literal]) -> list[Literal]:
    """Return literals, and one more for each variable whose type they do not imply."""
    listed = list(literals)
    implied = set[tuple[str, str]]()
    for name, terms in listed:
        signature = domain.signatures.get(name.lower())  # none for a type
        for term, kind in zip(terms, signature.types if signature else (), strict=False):
            implied.update((term, above) for above in domain.kinds[kind.lower()][1])
    for variable, kind in variables:
        if (variable, kind.lower()) not in implied:
            listed.append((f"@{kind.lower()}", (variable,)))
    return listed or [_ALWAYS]


# ---------------------------------------------------------------- derived predicates


class _Case(NamedTuple):
    """One way in which a formula may hold: literals and checks over further variables."""

    variables: Variables = ()
    literals: tuple[Literal, ...] = ()
    checks: tuple[Formula, ...] = ()


def _cases(formula: Formula, truth: bool) -> list[_Case]:
    """Return the cases in which a formula, or its negation, holds."""
    head, *parts = formula
    if head == "not":
        return _cases(parts[0], not truth)
    if head in ("and", "or"):
        each = [_cases(part, truth) for part in parts]
        if (head == "or") is truth:
            return [case for cases in each for case in cases]
        return [_joined(chosen) for chosen in product(*each)]
    if head == ("exists" if truth else "forall"):
        fresh = {name: f"{name}.{next(_FRESH)}" for name, _ in parts[0]}
        variables = tuple((fresh[name], kind) for name, kind in parts[0])
        inner = _cases(substituted(parts[1], fresh), truth)
        return [case._replace(variables=variables + case.variables) for case in inner]
    if head == "atom" and truth:
        return [_Case(literals=((parts[0], parts[1]),))]
    return [_Case(checks=(formula if truth else ("not", formula),))]


def _joined(cases: Iterable[_Case]) -> _Case:
    joined = _Case()
    for case in cases:
        joined = _Case(*map(operator.add, joined, case))
    return joined


def _rules_of(domain: Domain, name: str, axiom: Axiom) -> Iterator[Rule]:
    head = (name, tuple(variable for variable, _ in axiom.variables))
    for case in _cases(axiom.condition, True):
        variables = axiom.variables + case.variables
        literals = with_types(domain, variables, case.literals)
        yield Rule(variables, literals, case.checks, [head])


def layers_of(domain: Domain) -> list[Join]:
    """Return the rules of derived predicates, layer by layer."""
    if "layers" not in domain.cache:
        layers: dict[int, list[Rule]] = {}
        for name, axioms in domain.axioms.items():
            for axiom in axioms:
                rules = _rules_of(domain, domain.signatures[name].name, axiom)
                layers.setdefault(axiom.layer, []).extend(rules)
        domain.cache["layers"] = [Join(layers[layer]) for layer in sorted(layers)]
    joins: list[Join] = domain.cache["layers"]
    return joins


# ---------------------------------------------------------------- formulas with objects


def substituted(formula: Any, binding: Binding) -> Any:  # noqa: ANN401  # a formula or a number
    """Return a formula, or a number, with terms in the place of its free variables."""
    if not isinstance(formula, tuple) or not binding:
        return formula
    head, *parts = formula
    if head in ("atom", "n"):
        return head, parts[0], tuple(bound(parts[1], binding))
    if head == "same":
        return head, *bound(parts, binding)
    if head in ("forall", "exists"):
        hidden = {name for name, _ in parts[0]}
        visible = {name: thing for name, thing in binding.items() if name not in hidden}
        return head, parts[0], substituted(parts[1], visible)
    return head, *(substituted(part, binding) for part in parts)


def binding_of(domain: Domain, step: Step) -> Binding:
    """Return the arguments of a step by its variables."""
    names = [name for name, _ in domain.schema_of[step.schema].variables]
    return dict(zip(names, step.arguments, strict=True))


# ---------------------------------------------------------------- what steps cost and take


def duration_of(domain: Domain, step: Step) -> Number:
    """Return the shortest duration of a step [s], as a ground number."""
    duration = domain.schema_of[step.schema].duration
    return 0 if duration is None else substituted(duration[0], binding_of(domain, step))


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
    """Return by how much a step raises a metric."""
    if not isinstance(metric, tuple):
        return 0
    head, *parts = metric
    if head == "n":
        return duration_of(domain, step) if parts[0] == TIME else _rise_of(domain, parts, step)
    rises = [_rise(domain, part, step) for part in parts]
    if head in ("+", "-"):
        return rises[0] if all(rise == 0 for rise in rises[1:]) else (head, *rises)
    factors = [part for part in parts if not isinstance(part, tuple)]
    if len(factors) < len(parts) - 1 or (head == "/" and isinstance(parts[1], tuple)):
        raise UnsearchableError(f"the metric {text_of(metric)} is no sum of numbers")
    changed = next((rise for rise in rises if rise != 0), 0)
    return changed and (head, changed, *factors)


def _rise_of(domain: Domain, number: Sequence[Any], step: Step) -> Number:
    name, terms = number
    schema = domain.schema_of[step.schema]
    binding = binding_of(domain, step)
    text = atom_text(name, terms)
    rises = list[Number]()
    for effect in schema.effects:
        if not effect.is_numeric or effect.name != name:
            continue
        is_target = atom_text(name, bound(effect.terms, binding)) == text
        is_sure = effect.condition == TRUE and effect.kind == "increase"
        if effect.variables or (is_target and not is_sure):
            raise UnsearchableError(f"{schema.name} changes {text} on conditions, or lowers it")
        if is_target:
            rises.append(substituted(effect.amount, binding))
    if len(rises) < 2:
        return rises[0] if rises else 0
    return "+", *rises
