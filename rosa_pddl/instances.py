"""What can be done and can become true at all from some facts, with deletions and numbers left aside.

Actions are instantiated by joining what they need with what is within reach, each new fact once (semi-naive evaluation
of a logic program: Helmert, "Concise finite-domain representations for PDDL planning tasks", AIJ 173, 2009).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple, TypeAlias

from rosa_pddl.domain import Domain, UpThing, exact
from rosa_pddl.search import Number

Node: TypeAlias = bool | tuple[Any, ...]
"""A condition in negation normal form: `("atom", truth, name, words)`, `("same", truth, one, other)`,
`("and" | "or", part, ...)` or `("<" | "<=" | "=" | "!=", number, number)`; a word that is a variable is its number."""
Word: TypeAlias = str | int
Row: TypeAlias = tuple[str, ...]

# So many instantiations lie between two looks at whether to go on.
_BETWEEN_LOOKS = 500
_NEGATED = {"<": "<=", "<=": "<", "=": "!=", "!=": "="}
_ARITHMETIC = {"PLUS": "+", "MINUS": "-", "TIMES": "*", "DIV": "/"}


class Effect(NamedTuple):
    """What becomes so under a condition: an atom true or false, or a number changed by or to an amount."""

    condition: Node
    kind: str
    name: str
    words: tuple[Word, ...]
    amount: Number = None


@dataclass(frozen=True, eq=False)
class ActionPattern:
    """An instantaneous action: how many of its variables are parameters, the types of all, what it needs and does.

    A rule by which an atom is derived is one, of a layer above 0.
    """

    name: str
    parameters: int
    choices: tuple[tuple[str, ...], ...]
    needs: Node
    effects: tuple[tuple[Effect, tuple[tuple[int, tuple[str, ...]], ...]], ...]
    layer: int = 0


# ---------------------------------------------------------------- conditions without unified-planning


def compiled(domain: Domain, formula: UpThing, scope: Mapping[str, Word], truth: bool = True) -> Node:
    """Return a formula, or its negation, with quantifiers replaced by what they range over."""
    if formula.is_bool_constant():
        return bool(formula.constant_value()) is truth
    if formula.is_fluent_exp():
        return "atom", truth, domain.outside[formula.fluent().name], _words(domain, formula, scope)
    if formula.is_not():
        return compiled(domain, formula.arg(0), scope, not truth)
    if formula.is_and() or formula.is_or():
        return joined(formula.is_and() is truth, [compiled(domain, one, scope, truth) for one in formula.args])
    if formula.is_implies():
        parts = compiled(domain, formula.arg(0), scope, not truth), compiled(domain, formula.arg(1), scope, truth)
        return joined(not truth, parts)
    if formula.is_iff():
        both = [[compiled(domain, one, scope, value) for value in (True, False)] for one in formula.args]
        (first, not_first), (second, not_second) = both if truth else (both[0], both[1][::-1])
        return joined(False, [joined(True, [first, second]), joined(True, [not_first, not_second])])
    if formula.is_exists() or formula.is_forall():
        variables = {one.name: domain.objects_of(domain.outside[one.type.name]) for one in formula.variables()}
        scopes = [{**scope, **dict(zip(variables, words, strict=True))} for words in product(*variables.values())]
        return joined(formula.is_forall() is truth, [compiled(domain, formula.arg(0), one, truth) for one in scopes])
    if formula.is_equals() and formula.arg(0).type.is_user_type():
        one, other = _words(domain, formula, scope)
        return (
            (one == other) is truth if isinstance(one, str) and isinstance(other, str) else ("same", truth, one, other)
        )
    kind = "<" if formula.is_lt() else "<=" if formula.is_le() else "="
    left, right = (compiled_number(domain, one, scope) for one in formula.args)
    if truth:
        return kind, left, right
    return (_NEGATED[kind], right, left) if kind != "=" else ("!=", left, right)


def compiled_number(domain: Domain, number: UpThing, scope: Mapping[str, Word]) -> Number:
    """Return a number as itself, `("n", name, words)`, or an operator with its parts."""
    if number.is_constant():
        return exact(Fraction(number.constant_value()))
    if number.is_fluent_exp():
        return "n", domain.outside[number.fluent().name], _words(domain, number, scope)
    return _ARITHMETIC[number.node_type.name], *(compiled_number(domain, one, scope) for one in number.args)


def joined(is_and: bool, parts: Iterable[Node]) -> Node:
    """Return a conjunction, or a disjunction, without parts that decide nothing."""
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
    """Return the parts of a condition that is not plainly false."""
    if isinstance(node, bool):
        return ()
    return node[1:] if node[0] == "and" else (node,)


def _words(domain: Domain, thing: UpThing, scope: Mapping[str, Word]) -> tuple[Word, ...]:
    found: list[Word] = []
    for one in thing.args:
        if one.is_object_exp():
            found.append(domain.outside[one.object().name])
        else:
            found.append(scope[(one.parameter() if one.is_parameter_exp() else one.variable()).name])
    return tuple(found)


def bound(words: tuple[Word, ...], row: Sequence[str]) -> Row:
    return tuple([word if isinstance(word, str) else row[word] for word in words])


def bound_number(number: Number, row: Sequence[str]) -> Number:
    """Return a number with its variables replaced by what they are bound to: of numeric facts `("n", text)`."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return head, text_of_row(parts[0], bound(parts[1], row))
    return head, *(bound_number(part, row) for part in parts)


def numeric_facts(number: Number) -> Iterator[str]:
    """Yield the numeric facts that a number is made of: their texts, or their names if it is not bound."""
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
    return tuple([_pattern(domain, domain.outside[one.name], one.preconditions, one.effects) for one in actions])


def axioms_of(domain: Domain) -> tuple[ActionPattern, ...]:
    """Return the rules of predicates that are derived from themselves, as what makes an atom so."""
    found = []
    for name, one in domain.axioms.items():
        spelled = domain.outside[domain.inside["predicate", name]]
        scope: dict[str, Word] = {each.variable().name: place for place, each in enumerate(one.variables)}
        choices = tuple(domain.objects_of(domain.outside[each.type.name]) for each in one.variables)
        effect = Effect(True, "add", spelled, tuple(scope.values())), ()
        for way in one.condition.args if one.condition.is_or() else (one.condition,):
            needs = compiled(domain, way, scope)
            found.append(ActionPattern(spelled, len(choices), choices, needs, (effect,), one.layer))
    return tuple(found)


def is_out_of_reach(domain: Domain, state: Iterable[str], goals: Iterable[UpThing]) -> bool:
    """Whether no plan can reach a goal, also not one of steps that overlap: even if nothing ever became false."""
    patterns = []
    for schema in domain.schema_of.values():
        lasting = (*schema.start, *schema.over_all, *schema.end)
        patterns.append(_pattern(domain, schema.name, schema.start, schema.start_effects))
        patterns.append(_pattern(domain, schema.name, lasting, schema.end_effects))
    rows = reach(
        [*patterns, *axioms_of(domain)],
        map(row_of, (one for one in state if not one.startswith("(= "))),
        lambda _: None,
    ).rows
    return not all(_may_hold(compiled(domain, goal, {}), rows) for goal in goals)


def _may_hold(node: Node, rows: Mapping[str, Mapping[Row, None]]) -> bool:
    if isinstance(node, bool):
        return node
    if node[0] == "atom":
        return not node[1] or node[3] in rows.get(node[2], {})
    parts = (_may_hold(part, rows) for part in node[1:] if node[0] in ("and", "or"))
    return any(parts) if node[0] == "or" else all(parts)


def _pattern(domain: Domain, schema: str, conditions: Iterable[UpThing], changes: Iterable[UpThing]) -> ActionPattern:
    parameters = domain.schema_of[schema].parameters
    scope: dict[str, Word] = {name: number for number, (name, _) in enumerate(parameters)}
    choices = [domain.objects_of(kind) for _, kind in parameters]
    needs = joined(True, [compiled(domain, one, scope) for one in conditions])
    effects = []
    for effect in changes:
        more = [(one.name, domain.objects_of(domain.outside[one.type.name])) for one in effect.forall]
        inner = {**scope, **{name: len(choices) + number for number, (name, _) in enumerate(more)}}
        condition = compiled(domain, effect.condition, inner)
        name, words = domain.outside[effect.fluent.fluent().name], _words(domain, effect.fluent, inner)
        if effect.fluent.type.is_bool_type():
            kind, amount = "add" if effect.value.is_true() else "delete", None
        else:
            if name not in domain.computed:  # what is only used up counts when a plan is found
                continue
            kind, amount = effect.kind.name.lower(), compiled_number(domain, effect.value, inner)
        ranges = tuple((len(choices) + number, things) for number, (_, things) in enumerate(more))
        effects.append((Effect(condition, kind, name, words, amount), ranges))
    return ActionPattern(schema, len(choices), tuple(choices), needs, tuple(effects))


# ---------------------------------------------------------------- what is within reach


@dataclass(eq=False)
class _Rule:
    """What follows once every atom of its body is within reach."""

    body: list[tuple[str, tuple[Word, ...]]]
    heads: list[tuple[str, tuple[Word, ...]]]
    choices: list[frozenset[str]]
    order: list[tuple[str, ...]]
    apart: list[tuple[bool, Word, Word]]
    instances: dict[Row, None] | None


class _Look(NamedTuple):
    """One atom of a body, looked up by what is bound: which of its places are, and which bind what."""

    name: str
    known: tuple[int, ...]
    words: tuple[Word, ...]
    binds: tuple[tuple[int, int], ...]
    tests: tuple[tuple[bool, Word, Word], ...]


@dataclass
class Reach:
    """What is within reach: the rows of each predicate, and the arguments with which each action can be done."""

    rows: dict[str, dict[Row, None]] = field(default_factory=dict)
    instances: list[dict[Row, None]] = field(default_factory=list)


def reach(patterns: Sequence[ActionPattern], facts: Iterable[tuple[str, Row]], go_on: Callable[[int], None]) -> Reach:
    """Find what is within reach of facts; `go_on` is called every now and then, and may raise."""
    found = Reach(instances=[{} for _ in patterns])
    rules = [rule for one, known in zip(patterns, found.instances, strict=True) for rule in _rules(one, known)]
    return _Join(rules, found, go_on).closed(list(facts))


def _rules(pattern: ActionPattern, instances: dict[Row, None]) -> Iterator[_Rule]:
    heads = [
        (one.name, one.words)
        for one, ranges in pattern.effects
        if one.kind == "add" and one.condition is True and not ranges
    ]
    if pattern.needs is False:
        return
    yield _rule(pattern.needs, heads, pattern.choices, instances)
    for effect, ranges in pattern.effects:
        if effect.kind == "add" and not (effect.condition is True and not ranges):
            needs = joined(True, [pattern.needs, effect.condition])
            if needs is not False:
                choices = (*pattern.choices, *(things for _, things in ranges))
                yield _rule(needs, [(effect.name, effect.words)], choices, None)


def _rule(
    needs: Node,
    heads: list[tuple[str, tuple[Word, ...]]],
    choices: tuple[tuple[str, ...], ...],
    instances: dict[Row, None] | None,
) -> _Rule:
    parts = conjuncts_of(needs)
    body = [(name, words) for kind, truth, name, words in (one for one in parts if one[0] == "atom") if truth]
    apart = [one[1:] for one in parts if one[0] == "same"]
    return _Rule(body, heads, [frozenset(one) for one in choices], list(choices), apart, instances)


class _Join:
    def __init__(self, rules: Sequence[_Rule], found: Reach, go_on: Callable[[int], None]) -> None:
        self._found, self._go_on, self._work = found, go_on, 0
        self._index: dict[tuple[str, tuple[int, ...]], dict[Row, list[Row]]] = {}
        self._of: dict[str, list[tuple[int, ...]]] = {}
        self._waiting: list[tuple[str, Row]] = []
        self._grown = {name for rule in rules for name, _ in rule.heads}
        self._at_once: list[tuple[_Rule, list[_Look]]] = []
        self._triggers: dict[str, list[tuple[_Rule, _Look, list[_Look]]]] = {}
        for rule in rules:
            fluent = [number for number, (name, _) in enumerate(rule.body) if name in self._grown]
            for number in fluent:
                first, *rest = self._looks(rule, number)
                self._triggers.setdefault(rule.body[number][0], []).append((rule, first, rest))
            if not fluent:
                self._at_once.append((rule, self._looks(rule, None)))

    def closed(self, facts: list[tuple[str, Row]]) -> Reach:
        for name, row in facts:
            if name in self._grown:
                self._push(name, row)
            elif row not in self._found.rows.setdefault(name, {}):
                self._take_in(name, row)
        for rule, looks in self._at_once:
            self._join(rule, looks, [None] * len(rule.order), 0)
        for name, row in self._waiting:
            self._take_in(name, row)
            for rule, first, rest in self._triggers.get(name, ()):
                binding: list[str | None] = [None] * len(rule.order)
                is_match = all(word == row[place] for place, word in zip(first.known, first.words, strict=True))
                if is_match and self._bind(rule, first, row, binding):
                    self._join(rule, rest, binding, 0)
        return self._found

    def _push(self, name: str, row: Row) -> None:
        rows = self._found.rows.setdefault(name, {})
        if row not in rows:
            rows[row] = None
            self._waiting.append((name, row))

    def _take_in(self, name: str, row: Row) -> None:
        self._found.rows[name][row] = None
        for known in self._of.get(name, ()):
            self._index[name, known].setdefault(tuple([row[place] for place in known]), []).append(row)

    def _join(self, rule: _Rule, looks: list[_Look], binding: list[str | None], at: int) -> None:
        if at == len(looks):
            self._complete(rule, binding)
            return
        look = looks[at]
        if not look.name:  # a variable that no atom binds
            rows: Iterable[Row] = [(thing,) for thing in rule.order[look.binds[0][1]]]
        else:
            key = tuple([word if isinstance(word, str) else binding[word] for word in look.words])
            rows = self._index[look.name, look.known].get(key, ())  # type: ignore[arg-type]  # what is known is bound
        for row in rows:
            inner = binding.copy()
            if self._bind(rule, look, row, inner):
                self._join(rule, looks, inner, at + 1)

    def _bind(self, rule: _Rule, look: _Look, row: Row, binding: list[str | None]) -> bool:
        for place, variable in look.binds:
            thing, before = row[place], binding[variable]
            if before is None:
                if thing not in rule.choices[variable]:
                    return False
                binding[variable] = thing
            elif before != thing:
                return False
        for truth, one, other in look.tests:
            left = one if isinstance(one, str) else binding[one]
            if (left == (other if isinstance(other, str) else binding[other])) is not truth:
                return False
        return True

    def _complete(self, rule: _Rule, binding: list[str | None]) -> None:
        self._work += 1
        if self._work % _BETWEEN_LOOKS == 0:
            self._go_on(self._work)
        row: Row = tuple(binding)  # type: ignore[arg-type]  # all are bound by now
        if rule.instances is not None:
            if row in rule.instances:
                return
            rule.instances[row] = None
        for name, words in rule.heads:
            self._push(name, bound(words, row))

    def _looks(self, rule: _Rule, first: int | None) -> list[_Look]:
        """Order the atoms of a body such that each is looked up by as much as is known; the first one is given."""
        left, known, looks = list(range(len(rule.body))), set[Word](), list[_Look]()
        apart = list(rule.apart)

        def take(number: int, is_first: bool) -> None:
            name, words = rule.body[number]
            places = tuple(
                p for p, word in enumerate(words) if isinstance(word, str) or (word in known and not is_first)
            )
            binds = tuple((p, word) for p, word in enumerate(words) if not isinstance(word, str) and p not in places)
            known.update(word for word in words if not isinstance(word, str))
            if not is_first:
                self._index.setdefault((name, places), {})
                self._of.setdefault(name, [])
                if places not in self._of[name]:
                    self._of[name].append(places)
            looks.append(_Look(name, places, tuple(words[p] for p in places), binds, tests()))

        def tests() -> tuple[tuple[bool, Word, Word], ...]:
            ready = [one for one in apart if all(isinstance(word, str) or word in known for word in one[1:])]
            apart[:] = [one for one in apart if one not in ready]
            return tuple(ready)

        if first is not None:
            left.remove(first)
            take(first, True)
        while left:

            def unknown(number: int) -> tuple[int, int]:
                words = [word for word in rule.body[number][1] if not isinstance(word, str)]
                return len([word for word in words if word not in known]), -len(words)

            best = min(left, key=unknown)
            left.remove(best)
            take(best, False)
        for variable in range(len(rule.order)):
            if variable not in known:
                known.add(variable)
                looks.append(_Look("", (), (), ((0, variable),), tests()))
        return looks
