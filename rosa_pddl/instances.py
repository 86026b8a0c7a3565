"""Finds the facts and the action instances that are reachable from some facts, without looking at numbers.

Actions are instantiated by joining their conditions with the reachable facts, as if nothing were ever deleted; each new
fact is processed once (semi-naive evaluation of a logic program).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple, TypeAlias

from rosa_pddl.domain import Domain, UpThing, exact
from rosa_pddl.search import Number

Node: TypeAlias = bool | tuple[Any, ...]
"""A condition in negation normal form: `("atom", truth, name, words)`, `("same", truth, one, other)`,
`("and" | "or", part, ...)` or `("<" | "<=" | "=" | "!=", number, number)`; a variable is given by its number."""
Word: TypeAlias = str | int
Row: TypeAlias = tuple[str, ...]

# The number of instantiations between two calls of `go_on`.
_BETWEEN_LOOKS = 500
_NEGATED = {"<": "<=", "<=": "<", "=": "!=", "!=": "="}
_ARITHMETIC = {"PLUS": "+", "MINUS": "-", "TIMES": "*", "DIV": "/"}


class Effect(NamedTuple):
    """An effect with its condition: it makes an atom true or false, or changes a number by or to an amount."""

    condition: Node
    kind: str
    name: str
    words: tuple[Word, ...]
    amount: Number = None


@dataclass(frozen=True, eq=False)
class ActionPattern:
    """An instantaneous action: the choices for its parameters, its condition and its effects.

    A rule that derives an atom is one too; its layer is above 0.
    """

    name: str
    choices: tuple[tuple[str, ...], ...]
    needs: Node
    effects: tuple[Effect, ...]
    layer: int = 0


# ---------------------------------------------------------------- conditions without unified-planning


def compiled(
    domain: Domain, formula: UpThing, scope: Mapping[str, Word], truth: bool = True
) -> Node:
    """Return a formula, or its negation, with quantifiers expanded over their objects."""
    if formula.is_bool_constant():
        return bool(formula.constant_value()) is truth
    if formula.is_fluent_exp():
        return "atom", truth, domain.outside[formula.fluent().name], _words(domain, formula, scope)
    if formula.is_not():
        return compiled(domain, formula.arg(0), scope, not truth)
    if formula.is_and() or formula.is_or():
        return joined(
            formula.is_and() is truth, [compiled(domain, one, scope, truth) for one in formula.args]
        )
    if formula.is_implies():
        parts = (
            compiled(domain, formula.arg(0), scope, not truth),
            compiled(domain, formula.arg(1), scope, truth),
        )
        return joined(not truth, parts)
    if formula.is_iff():
        both = [
            [compiled(domain, one, scope, value) for value in (True, False)] for one in formula.args
        ]
        (first, not_first), (second, not_second) = both if truth else (both[0], both[1][::-1])
        return joined(False, [joined(True, [first, second]), joined(True, [not_first, not_second])])
    if formula.is_exists() or formula.is_forall():
        scopes = domain.bindings(formula.variables(), scope)
        return joined(
            formula.is_forall() is truth,
            [compiled(domain, formula.arg(0), one, truth) for one in scopes],
        )
    if formula.is_equals() and formula.arg(0).type.is_user_type():
        one, other = _words(domain, formula, scope)
        return (
            (one == other) is truth
            if isinstance(one, str) and isinstance(other, str)
            else ("same", truth, one, other)
        )
    kind = "<" if formula.is_lt() else "<=" if formula.is_le() else "="
    left, right = (compiled_number(domain, one, scope) for one in formula.args)
    if truth:
        return kind, left, right
    return (_NEGATED[kind], right, left) if kind != "=" else ("!=", left, right)


def compiled_number(domain: Domain, number: UpThing, scope: Mapping[str, Word]) -> Number:
    """Return a number as a constant, as `("n", name, words)`, or as an operator with its parts."""
    if number.is_constant():
        return exact(Fraction(number.constant_value()))
    if number.is_fluent_exp():
        return "n", domain.outside[number.fluent().name], _words(domain, number, scope)
    return _ARITHMETIC[number.node_type.name], *(
        compiled_number(domain, one, scope) for one in number.args
    )


def joined(is_and: bool, parts: Iterable[Node]) -> Node:
    """Return a conjunction, or a disjunction, simplified: without parts that are constant."""
    head, found = "and" if is_and else "or", list[Node]()
    for part in parts:
        if isinstance(part, bool):
            if part is not is_and:
                return part
        elif part[0] == head:
            found += part[1:]
        else:
            found.append(part)
    return is_and if not found else found[0] if len(found) == 1 else (head, *dict.fromkeys(found))


def conjuncts_of(node: Node) -> Sequence[tuple[Any, ...]]:
    """Return the parts of a conjunction, or another condition as its only part; it must not be the constant False."""
    if isinstance(node, bool):
        return ()
    return node[1:] if node[0] == "and" else (node,)


def _words(domain: Domain, thing: UpThing, scope: Mapping[str, Word]) -> tuple[Word, ...]:
    found: list[Word] = []
    for one in thing.args:
        if one.is_object_exp():
            found.append(domain.outside[one.object().name])
        else:
            found.append(
                scope[(one.parameter() if one.is_parameter_exp() else one.variable()).name]
            )
    return tuple(found)


def bound(words: tuple[Word, ...], row: Sequence[str]) -> Row:
    return tuple([word if isinstance(word, str) else row[word] for word in words])


def bound_number(number: Number, row: Sequence[str]) -> Number:
    """Return a number with its variables replaced by their objects; numeric facts become `("n", text)`."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return head, text_of_row(parts[0], bound(parts[1], row))
    return head, *(bound_number(part, row) for part in parts)


def numeric_facts(number: Number) -> Iterator[str]:
    """Yield the numeric facts in a number: their texts, or their names if the number is not bound."""
    if isinstance(number, tuple):
        head, *parts = number
        if head == "n":
            yield parts[0]
        for part in parts if head != "n" else ():
            yield from numeric_facts(part)


def row_of(atom: str) -> tuple[str, Row]:
    name, *words = atom[1:-1].split(" ")
    return name, tuple(words)


def text_of_row(name: str, row: Row) -> str:
    return f"({name} {' '.join(row)})" if row else f"({name})"


def patterns_of(domain: Domain, actions: Iterable[UpThing]) -> tuple[ActionPattern, ...]:
    """Return instantaneous actions of unified-planning as patterns."""
    return tuple(
        [
            _pattern(domain, domain.outside[one.name], one.preconditions, one.effects)
            for one in actions
        ]
    )


def axioms_of(domain: Domain) -> tuple[ActionPattern, ...]:
    """Return the rules of derived predicates as patterns that add the derived atom."""
    found = []
    for name, one in domain.axioms.items():
        spelled = domain.outside[domain.inside["predicate", name]]
        scope: dict[str, Word] = {
            each.variable().name: place for place, each in enumerate(one.variables)
        }
        choices = tuple(domain.objects_of(domain.outside[each.type.name]) for each in one.variables)
        effect = Effect(True, "add", spelled, tuple(scope.values()))
        for way in one.condition.args if one.condition.is_or() else (one.condition,):
            needs = compiled(domain, way, scope)
            found.append(ActionPattern(spelled, choices, needs, (effect,), one.layer))
    return tuple(found)


def is_out_of_reach(domain: Domain, state: Iterable[str], goals: Iterable[UpThing]) -> bool:
    """Whether no plan, even with overlapping steps, can reach the goals, even if no fact ever became false."""
    patterns = []
    for schema in domain.schema_of.values():
        lasting = (*schema.start, *schema.over_all, *schema.end)
        patterns.append(_pattern(domain, schema.name, schema.start, schema.start_effects))
        patterns.append(_pattern(domain, schema.name, lasting, schema.end_effects))
    facts = (row_of(one) for one in state if not one.startswith("(= "))
    rows, _ = reach([*patterns, *axioms_of(domain)], facts, lambda _: None)
    return not all(_may_hold(compiled(domain, goal, {}), rows) for goal in goals)


def _may_hold(node: Node, rows: Mapping[str, Mapping[Row, None]]) -> bool:
    if isinstance(node, bool):
        return node
    if node[0] == "atom":
        return not node[1] or node[3] in rows.get(node[2], {})
    parts = (_may_hold(part, rows) for part in node[1:] if node[0] in ("and", "or"))
    return any(parts) if node[0] == "or" else all(parts)


def _pattern(
    domain: Domain, schema: str, conditions: Iterable[UpThing], changes: Iterable[UpThing]
) -> ActionPattern:
    parameters = domain.schema_of[schema].parameters
    scope: dict[str, Word] = {name: number for number, (name, _) in enumerate(parameters)}
    needs = joined(True, [compiled(domain, one, scope) for one in conditions])
    effects = [made for one in changes for made in _effects(domain, one, scope)]
    return ActionPattern(
        schema, tuple(domain.objects_of(kind) for _, kind in parameters), needs, tuple(effects)
    )


def _effects(domain: Domain, effect: UpThing, scope: Mapping[str, Word]) -> Iterator[Effect]:
    """Yield the effect for each choice of objects for its variables; effects on resources are left out."""
    name = domain.outside[effect.fluent.fluent().name]
    for inner in domain.bindings(effect.forall, scope):
        condition, words = (
            compiled(domain, effect.condition, inner),
            _words(domain, effect.fluent, inner),
        )
        if effect.fluent.type.is_bool_type():
            yield Effect(condition, "add" if effect.value.is_true() else "delete", name, words)
        elif name in domain.computed:
            amount = compiled_number(domain, effect.value, inner)
            yield Effect(condition, effect.kind.name.lower(), name, words, amount)


# ---------------------------------------------------------------- reachable facts and instances


@dataclass(eq=False)
class _Rule:
    """A rule: its heads are reachable when all atoms of its body are, for objects of the right types."""

    body: list[tuple[str, tuple[Word, ...]]]
    heads: list[tuple[str, tuple[Word, ...]]]
    choices: list[dict[str, None]]
    apart: list[tuple[bool, Word, Word]]
    instances: dict[Row, None] | None


class _Look(NamedTuple):
    """A lookup of an atom of a body, with the places whose objects are known at that time."""

    name: str
    words: tuple[Word, ...]
    known: tuple[int, ...]


_Binding: TypeAlias = list[str | None]
_Rows: TypeAlias = dict[str, dict[Row, None]]


def reach(
    patterns: Sequence[ActionPattern],
    facts: Iterable[tuple[str, Row]],
    go_on: Callable[[int], None],
) -> tuple[_Rows, list[dict[Row, None]]]:
    """Return the rows of each predicate that are reachable from facts, and the possible arguments of each action.

    `go_on` is called now and then with the number of instantiations, and may raise to stop the work.
    """
    instances = [dict[Row, None]() for _ in patterns]
    rules = [
        rule for one, known in zip(patterns, instances, strict=True) for rule in _rules(one, known)
    ]
    return _Join(rules, go_on).closed(facts), instances


def _rules(pattern: ActionPattern, instances: dict[Row, None]) -> Iterator[_Rule]:
    added = [one for one in pattern.effects if one.kind == "add"]
    sure = [(one.name, one.words) for one in added if one.condition is True]
    others = [one for one in added if one.condition is not True]
    follows = [
        (joined(True, [pattern.needs, one.condition]), [(one.name, one.words)], None)
        for one in others
    ]
    choices = [dict.fromkeys(one) for one in pattern.choices]
    for needs, heads, known in ((pattern.needs, sure, instances), *follows):
        parts = conjuncts_of(needs)
        body = [(one[2], one[3]) for one in parts if one[0] == "atom" and one[1]]
        apart = [one[1:] for one in parts if one[0] == "same"]
        if needs is not False:
            yield _Rule(body, heads, choices, apart, known)


class _Join:
    def __init__(self, rules: Sequence[_Rule], go_on: Callable[[int], None]) -> None:
        self._go_on, self._work = go_on, 0
        self._rows: _Rows = {}
        self._index: dict[str, dict[tuple[int, ...], dict[Row, list[Row]]]] = {}
        self._waiting: list[tuple[str, Row]] = []
        self._bare = [rule for rule in rules if not rule.body]
        self._triggers: dict[str, list[tuple[_Rule, _Look, list[_Look]]]] = {}
        for rule in rules:
            for number in range(len(rule.body)):
                first, *rest = self._looks(rule, number)
                self._triggers.setdefault(first.name, []).append((rule, first, rest))

    def closed(self, facts: Iterable[tuple[str, Row]]) -> _Rows:
        for name, row in facts:
            self._push(name, row)
        for rule in self._bare:
            self._complete(rule, [None] * len(rule.choices))
        for name, row in self._waiting:
            for known, rows in self._index.get(name, {}).items():
                rows.setdefault(tuple([row[place] for place in known]), []).append(row)
            for rule, first, rest in self._triggers.get(name, ()):
                binding = _matched(rule, first, row, [None] * len(rule.choices))
                if binding is not None:
                    self._join(rule, rest, binding)
        return self._rows

    def _push(self, name: str, row: Row) -> None:
        rows = self._rows.setdefault(name, {})
        if row not in rows:
            rows[row] = None
            self._waiting.append((name, row))

    def _join(self, rule: _Rule, looks: Sequence[_Look], binding: _Binding, at: int = 0) -> None:
        if at == len(looks):
            self._complete(rule, binding)
            return
        look = looks[at]
        words = [look.words[place] for place in look.known]
        key: Any = tuple(
            [word if isinstance(word, str) else binding[word] for word in words]
        )  # all are known
        for row in self._index[look.name][look.known].get(key, ()):
            inner = _matched(rule, look, row, binding)
            if inner is not None:
                self._join(rule, looks, inner, at + 1)

    def _complete(self, rule: _Rule, binding: _Binding) -> None:
        """Add what follows from a binding, for every choice of objects for its unbound variables."""
        choices = [
            rule.choices[place] if thing is None else (thing,)
            for place, thing in enumerate(binding)
        ]
        for row in product(*choices):
            self._work += 1
            if self._work % _BETWEEN_LOOKS == 0:
                self._go_on(self._work)
            are_apart = [
                truth is (one == other)
                for truth, *words in rule.apart
                for one, other in [bound((*words,), row)]
            ]
            if all(are_apart) and (rule.instances is None or row not in rule.instances):
                if rule.instances is not None:
                    rule.instances[row] = None
                for name, words in rule.heads:
                    self._push(name, bound(words, row))

    def _looks(self, rule: _Rule, first: int) -> list[_Look]:
        """Order the atoms of a body, from a given first one, so that each lookup knows as many places as possible."""
        left, known, looks = list(range(len(rule.body))), set[Word](), list[_Look]()

        def unknown(number: int) -> tuple[bool, int, int]:
            words = [word for word in rule.body[number][1] if not isinstance(word, str)]
            return number != first, len([word for word in words if word not in known]), -len(words)

        while left:
            number = min(left, key=unknown)
            left.remove(number)
            name, words = rule.body[number]
            places = tuple(
                [
                    place
                    for place, word in enumerate(words)
                    if isinstance(word, str) or word in known
                ]
            )
            known.update(word for word in words if not isinstance(word, str))
            looks.append(_Look(name, words, places))
            if number != first:
                self._index.setdefault(name, {}).setdefault(places, {})
        return looks


def _matched(rule: _Rule, look: _Look, row: Row, binding: _Binding) -> _Binding | None:
    """Return the binding extended by a row of a lookup; None if the two contradict each other."""
    inner = binding.copy()
    for word, thing in zip(look.words, row, strict=True):
        known = word if isinstance(word, str) else inner[word]
        if known is None and thing in rule.choices[word]:  # type: ignore[index]  # only variables are not known
            inner[word] = thing  # type: ignore[index]  # as before
        elif known != thing:
            return None
    return inner
