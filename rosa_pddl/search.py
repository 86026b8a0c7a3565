"""The exact search: finds a plan of least cost over explicit states, in this process.

Label setting after Desrochers and Soumis, "A generalized permanent labelling algorithm for the
shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All amounts are
exact, so sums and comparisons with a limit are exact. A cap on the number of moves ends the search,
never the clock, so the same task always has the same answer.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from heapq import heapify, heappop, heappush
from itertools import chain
from math import inf
from operator import add, gt, le
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from rosa_pddl.domain import (
    FALSE,
    TRUE,
    Binding,
    Domain,
    Exact,
    Formula,
    Number,
    Schema,
    State,
    Step,
    atom_text,
    bound,
    conjuncts,
    head_of,
)
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.grounding import (
    Join,
    Rule,
    UnsearchableError,
    cost_of,
    grounded,
    texts_in,
    with_types,
)
from rosa_pddl.problem import Problem, merged
from rosa_pddl.validate import Values

T = TypeVar("T")
S = TypeVar("S")

# A graph that has stored more moves than this forgets them.
_MOST_STORED = 200_000
_MOST_GRAPHS = 4


class CapReached(Exception):
    """The search looked at as many moves as the cap allows and found no answer."""


class Move(NamedTuple, Generic[S, T]):
    """One step: the state after it, its cost, and its use of each limited resource; not negative."""

    to: S
    cost: Any
    uses: tuple[Any, ...]
    what: T


class Graph(Protocol[S, T]):
    """The graph that is searched."""

    def moves(self, state: S) -> Iterable[Move[S, T]]: ...

    def is_goal(self, state: S) -> bool: ...

    def least(self, state: S) -> tuple[float, Sequence[float]]:
        """Return lower bounds of cost and usage from a state to a goal; infinite if out of reach.

        The bounds are consistent: no move lowers them by more than the move costs or uses.
        """


class Path(NamedTuple, Generic[S, T]):
    """A cheapest path with its cost and usage; `expanded` labels proved it."""

    moves: tuple[Move[S, T], ...]
    cost: Any
    uses: tuple[Any, ...]
    expanded: int


class _Label(NamedTuple, Generic[S, T]):
    """A path to a state: its cost, followed by its usage."""

    before: "_Label[S, T] | None"
    move: Move[S, T] | None
    state: S
    spent: tuple[Any, ...]


def cheapest(
    graph: Graph[S, T],
    start: S,
    limits: Sequence[Any] = (),
    cap: float = inf,
    go_on: Callable[[], None] = lambda: None,
) -> Path[S, T] | None:
    """Find a path of least cost that uses no more than the limits; None proves that there is none.

    CapReached is raised if the search has looked at `cap` moves without an answer. `go_on` is
    called for each label that is expanded, and may raise to stop the search.

    Labels leave the queue in order of their cost plus its lower bound to a goal. So the labels of
    a state leave it in order of cost, and a label is expanded only if it uses less of something
    than each earlier one; the first label at a goal is optimal.
    """
    if any(limit < 0 for limit in limits):
        return None
    first: _Label[S, T] = _Label(None, None, start, (0,) * (1 + len(limits)))
    queue = [(graph.least(start)[0], first.spent[1:], 0, first)]
    expanded: dict[S, list[tuple[Any, ...]]] = {}
    latest: dict[S, tuple[Any, ...]] = {}
    looked_at = pushed = labels = 0
    while queue:
        _, uses, _, label = heappop(queue)
        front = expanded.setdefault(label.state, [])
        if _is_dominated(uses, front):
            continue
        if graph.is_goal(label.state):
            return Path(_moves(label), label.spent[0], uses, labels)
        front[:] = [uses, *(other for other in front if not _is_dominated(other, [uses]))]
        labels += 1
        go_on()
        for move in graph.moves(label.state):
            looked_at += 1
            spent = (label.spent[0] + move.cost, *map(add, uses, move.uses))
            if any(map(gt, spent[1:], limits)):
                continue
            if move.to in latest and all(map(le, latest[move.to], spent)):
                continue
            if _is_dominated(spent[1:], expanded.get(move.to, ())):
                continue
            least, lacking = graph.least(move.to)
            if least == inf or any(map(gt, map(add, spent[1:], lacking), limits)):
                continue
            latest[move.to] = spent
            pushed += 1
            new = _Label(label, move, move.to, spent)
            heappush(queue, (spent[0] + least, spent[1:], pushed, new))
        if looked_at > cap:
            raise CapReached
    return None


def distances(arcs: Iterable[tuple[S, S, float]], goals: Iterable[S]) -> dict[S, float]:
    """Return each state's distance to its nearest goal along arcs (from, to, length)."""
    into: dict[S, list[tuple[S, float]]] = {}
    for before, after, length in arcs:
        into.setdefault(after, []).append((before, length))
    order = {state: number for number, state in enumerate(into)}
    nearest: dict[S, float] = {}
    # 0, not 0.0, so that sums of whole lengths stay exact however large they are
    queue: list[tuple[float, int, S]] = [(0, order.get(goal, -1), goal) for goal in goals]
    heapify(queue)
    while queue:
        far, _, state = heappop(queue)
        if state in nearest:
            continue
        nearest[state] = far
        for before, length in into.get(state, ()):
            if before not in nearest:
                heappush(queue, (far + length, order.setdefault(before, len(order)), before))
    return nearest


def _is_dominated(uses: tuple[Any, ...], front: Iterable[tuple[Any, ...]]) -> bool:
    for other in front:  # noqa: SIM110  # a loop is quicker: few others
        if all(map(le, other, uses)):
            return True
    return False


def _moves(label: _Label[S, T]) -> tuple[Move[S, T], ...]:
    moves: list[Move[S, T]] = []
    at: _Label[S, T] | None = label
    while at is not None and at.move is not None:
        moves.append(at.move)
        at = at.before
    return tuple(moves[::-1])


# ---------------------------------------------------------------- grounded actions


class Condition(NamedTuple):
    """The atoms that must be true, those that must be false, other ground formulas, and tests.

    Tests compare numbers.
    """

    needs: frozenset[str] = frozenset()
    denies: frozenset[str] = frozenset()
    others: tuple[Formula, ...] = ()
    tests: tuple[Formula, ...] = ()

    def holds(self, atoms: State, values: Values) -> bool:
        """Whether it holds."""
        if not (self.needs <= atoms and self.denies.isdisjoint(atoms)):
            return False
        if not all(_holds(formula, atoms) for formula in self.others):
            return False
        return all(values.holds(test, {}) for test in self.tests)

    @property
    def read(self) -> AbstractSet[str]:
        """The atoms that are not simply needed."""
        return self.denies.union(*map(_atoms_in, self.others))


class Change(NamedTuple):
    """A change of a number: when, `increase`, `decrease` or `assign`, which, and the amount."""

    condition: Condition
    kind: str
    text: str
    amount: Number


class Operation(NamedTuple):
    """A step as a change of atoms and numbers, at once."""

    step: Step
    condition: Condition
    deletes: frozenset[str]
    adds: frozenset[str]
    effects: tuple[tuple[Condition, str, bool], ...]
    changes: tuple[Change, ...]
    cost: Number

    @property
    def changed(self) -> AbstractSet[str]:
        """The atoms that it may change."""
        return self.adds.union(self.deletes, [atom for _, atom, _ in self.effects])

    def applied(self, atoms: State, values: Values) -> State:
        """Return the atoms after the step."""
        deletes, adds = self.deletes, self.adds
        for condition, atom, truth in self.effects:
            if condition.holds(atoms, values):
                deletes, adds = (deletes, adds | {atom}) if truth else (deletes | {atom}, adds)
        return (atoms - deletes) | adds

    def numbers(self, atoms: State, values: Values) -> dict[str, Exact] | None:
        """Return the new values of numbers; None if one is unknown."""
        after = dict[str, Exact]()
        for condition, kind, text, amount in self.changes:
            if condition.holds(atoms, values):
                value = values.number(amount, {})
                if kind != "assign" and value is not None:
                    before = after.get(text, values.value_of(text))
                    sign = 1 if kind == "increase" else -1
                    value = None if before is None else before + sign * value
                if value is None:
                    return None
                after[text] = value
        return after


def _holds(formula: Formula, atoms: State) -> bool:
    head, *parts = formula
    if head == "atom":
        return parts[0] in atoms
    if head == "not":
        return not _holds(parts[0], atoms)
    each = (_holds(part, atoms) for part in parts)
    return all(each) if head == "and" else any(each)


def _atoms_in(formula: Formula) -> set[str]:
    if formula[0] == "atom":
        return {formula[1]}
    return set(chain.from_iterable(map(_atoms_in, formula[1:])))


Node = tuple[State, tuple[Any, ...]]
"""The atoms that are true, and the values of the numbers in the order of the graph."""


class TaskGraph:
    """The states that steps lead to, for goals and costs; moves and bounds serve later starts.

    The lower bound is the shortest path to a goal atom in a relaxed graph of atoms: of the atoms
    that an operation needs, it keeps only one.

    Args:
        goal: what is to be reached.
        operations: what can be done, each with its cost and its use of what is limited.
        texts: the numbers that are part of a state.
        values: returns the values of all numbers, given those of a state.
    """

    def __init__(
        self,
        goal: Condition,
        operations: Sequence[tuple[Operation, Sequence[Exact]]],
        texts: Sequence[str],
        values: Callable[[Mapping[str, Exact | None]], Values],
    ) -> None:
        self._goal = goal
        self._operations = operations
        self.texts = texts
        self._values = values
        self._stored = 0
        self._moves: dict[Node, tuple[Move[Node, Step], ...]] = {}
        self._least: dict[State, tuple[float, Sequence[float]]] = {}
        self._by_need: dict[str | None, list[int]] = {}
        needed = Counter(chain.from_iterable(each.condition.needs for each, _ in operations))
        for number, (operation, _) in enumerate(operations):
            needs = sorted(operation.condition.needs)
            rarest = min(needs, key=needed.__getitem__, default=None)
            self._by_need.setdefault(rarest, []).append(number)
        amounts = range(len(operations[0][1]) if operations else 1)
        self._distances = list[list[dict[str | None, float]]]()
        for amount in amounts:
            arcs = list(self._arcs(amount))
            self._distances.append([distances(arcs, [atom]) for atom in sorted(goal.needs)])

    def is_goal(self, state: Node) -> bool:
        """Whether the goal holds."""
        return self._goal.holds(state[0], self._values_in(state))

    def moves(self, state: Node) -> Sequence[Move[Node, Step]]:
        """Return the moves that are possible in a state and change it."""
        if state not in self._moves:
            if self._stored > _MOST_STORED:
                self._moves.clear()
                self._least.clear()
                self._stored = 0
            self._moves[state] = tuple(self._possible(state))
            self._stored += 1 + len(self._moves[state])
        return self._moves[state]

    def _values_in(self, state: Node) -> Values:
        return self._values(dict(zip(self.texts, state[1], strict=True)))

    def least(self, state: Node) -> tuple[float, Sequence[float]]:
        """Return lower bounds: the distances of the farthest goal atom."""
        atoms = state[0]
        if atoms not in self._least:
            bounds = list[float]()
            for by_goal in self._distances:
                nearest = [min(far.get(a, inf) for a in (None, *atoms)) for far in by_goal]
                bounds.append(max(nearest, default=0))
            self._least[atoms] = bounds[0], bounds[1:]
        return self._least[atoms]

    def _possible(self, state: Node) -> Iterator[Move[Node, Step]]:
        atoms, before = state
        values = self._values_in(state)
        numbers = list(self._by_need.get(None, ()))
        for atom in atoms:
            numbers += self._by_need.get(atom, ())
        for number in sorted(numbers):
            operation, amounts = self._operations[number]
            if not operation.condition.holds(atoms, values):
                continue
            changed = operation.numbers(atoms, values)
            if changed is None:
                continue
            after = [changed.get(*pair) for pair in zip(self.texts, before, strict=True)]
            node = operation.applied(atoms, values), tuple(after)
            if node != state:
                yield Move(node, amounts[0], tuple(amounts[1:]), operation.step)

    def _arcs(self, amount: int) -> Iterator[tuple[str | None, str, Any]]:
        """Yield the arcs of the relaxed graph: from an atom, or None for anywhere."""
        for operation, amounts in self._operations:
            needs = operation.condition.needs
            before = min(needs & operation.deletes or needs, default=None)
            added = [atom for _, atom, truth in operation.effects if truth]
            for after in sorted(operation.adds.union(added)):
                yield before, after, amounts[amount]


class Grounded:
    """The grounded actions of a domain, for all states whose atoms are reachable from a base.

    Args:
        domain: what `load_domain` returned.
        base: the atoms that may be true initially, in any of the states.
        go_on: called with the number of instances; an error that it raises stops the grounding.

    Raises:
        UnsearchableError: the domain has something of which the search has no notion.
    """

    def __init__(self, domain: Domain, base: State, go_on: Callable[[int], None]) -> None:
        if domain.only_planned or domain.timed or domain.axioms:
            raise UnsearchableError("facts change by themselves, or follow from others")
        self.domain = domain
        self.base = base
        self._rules: dict[Rule, tuple[Schema, dict[tuple[str, ...], None]]] = {}
        further = list[Rule]()
        for schema in domain.schema_of.values():
            further += self._add_rules(schema)
        join = Join([*self._rules, *further])
        self._possible = self._reach(join, go_on)
        self.operations = tuple(self._operations(go_on))
        changed = [operation.changed for operation in self.operations]
        self._names = join.names.union(map(head_of, chain.from_iterable(changed)))
        read = [operation.condition.read for operation in self.operations]
        for operation in self.operations:
            read += [each.needs | each.read for each, _, _ in operation.effects]
        self._moving = frozenset(chain.from_iterable(changed + read))
        self._needed = frozenset(chain(*[each.condition.needs for each in self.operations]))
        self._sort_numbers()
        self._graphs: dict[Any, TaskGraph] = {}

    def _is_computed(self, text: str) -> bool:
        return head_of(text) in self.domain.computed

    def _sort_numbers(self) -> None:
        """Find the numbers that operations change, those only raised, and all that count."""
        changed, not_only_raised, read = dict[str, None](), set[str](), set[str]()
        fixed = dict[str, None]()
        for operation in self.operations:
            conditions = [operation.condition, *(each for each, _, _ in operation.effects)]
            for condition, kind, text, amount in operation.changes:
                changed[text] = None
                conditions.append(condition)
                read.update(texts_in(amount))
                if kind != "increase" or condition != Condition():
                    not_only_raised.add(text)
            for condition in conditions:
                read.update(chain(*map(texts_in, condition.tests)))
            fixed.update(dict.fromkeys(texts_in(operation.cost)))
        changed |= dict.fromkeys(filter(self._is_computed, sorted(read)))
        self._changed = tuple(changed)
        self._raised = changed.keys() - not_only_raised - read
        self._fixed = tuple(dict.fromkeys([*fixed, *sorted(read)]))
        if not changed.keys().isdisjoint(fixed):
            raise UnsearchableError("what a step costs depends on numbers that change")

    def covers(self, state: State) -> bool:
        """Whether the actions are right for a state."""
        strange = [atom for atom in state - self._possible if not atom.startswith("(= ")]
        return not any(head_of(atom) in self._names for atom in strange)

    # ------------------------------------------------------------ reachable instances

    def _add_rules(self, schema: Schema) -> Iterator[Rule]:
        """Add the rule of an action; yield those of its effects on further variables."""
        action = merged(schema, has_axioms=False)
        if action is None:
            raise UnsearchableError(f"{schema.name} is no change at once")
        parts = list(conjuncts(action.start))
        needed = [(part[1], part[2]) for part in parts if part[0] == "atom"]
        checks = [part for part in parts if "same" in (part[0], part[0] == "not" and part[1][0])]
        rule = Rule(action.variables, with_types(self.domain, action.variables, needed), checks)
        self._rules[rule] = action, {}
        for effect in action.effects:
            head = effect.name, effect.terms
            if effect.kind == "add" and effect.variables:
                variables = action.variables + effect.variables
                literals = with_types(self.domain, variables, needed)
                yield Rule(variables, literals, checks, [head])
            elif effect.kind == "add":
                rule.heads.append(head)

    def _reach(self, join: Join, go_on: Callable[[int], None]) -> State:
        """Find what is reachable as if nothing were ever deleted, and without numbers."""
        instances = 0

        def accept(rule: Rule, binding: Binding) -> bool:
            nonlocal instances
            instances += 1
            go_on(instances)
            if not all(self._ground(check, binding) == TRUE for check in rule.checks):
                return False
            if rule in self._rules:
                _, rows = self._rules[rule]
                rows[tuple(binding[name] for name, _ in rule.variables)] = None
            return True

        atoms = [atom for atom in sorted(self.base) if not atom.startswith("(= ")]
        rows = join.close(join.facts(self.domain, atoms), accept)
        reached = [atom_text(name, row) for name, each in rows.items() for row in each]
        return self.base.union(reached)

    def _operations(self, go_on: Callable[[int], None]) -> Iterator[Operation]:
        order = {name: number for number, name in enumerate(self.domain.types)}
        for action, rows in self._rules.values():
            for row in sorted(rows, key=lambda row: [order[word] for word in row]):
                go_on(0)
                operation = self._operation(action, row)
                if operation is not None:
                    yield operation

    def _operation(self, action: Schema, row: tuple[str, ...]) -> Operation | None:
        binding = dict(zip([name for name, _ in action.variables], row, strict=True))
        condition = self._condition(action.start, binding)
        if condition is None:
            return None
        adds, deletes = set[str](), set[str]()
        effects = list[tuple[Condition, str, bool]]()
        changes = list[Change]()
        for effect in action.effects:
            if effect.is_numeric and effect.name not in self.domain.computed:
                continue
            for inner in self.domain.bindings(effect.variables, binding):
                text = atom_text(effect.name, bound(effect.terms, inner))
                when = self._condition([effect.condition], inner)
                if when is None:
                    continue
                if effect.is_numeric:
                    amount = grounded(effect.amount, inner)
                    changes.append(Change(when, effect.kind, text, amount))
                elif when == Condition():
                    (adds if effect.kind == "add" else deletes).add(text)
                else:
                    effects.append((when, text, effect.kind == "add"))
        step = self.domain.step(action.name, row)
        deletes = (deletes - adds) & self._possible
        cost = cost_of(self.domain, step)
        sets = frozenset(deletes), frozenset(adds)
        return Operation(step, condition, *sets, tuple(effects), tuple(changes), cost)

    def _condition(self, formulas: Iterable[Formula], binding: Binding) -> Condition | None:
        """Return formulas as a condition; None if it never holds."""
        needs, denies = set[str](), set[str]()
        others, tests = list[Formula](), list[Formula]()
        for part in conjuncts(self._ground(formula, binding) for formula in formulas):
            head = part[0]
            if head == "atom":
                needs.add(part[1])
            elif head == "not" and part[1][0] == "atom":
                denies.add(part[1][1])
            elif any(texts_in(part)):
                tests.append(part)
            elif _atoms_in(part):
                others.append(part)
            elif not _holds(part, frozenset()):
                return None
        if not needs <= self._possible:
            return None
        denies &= self._possible
        return Condition(frozenset(needs), frozenset(denies), tuple(others), tuple(tests))

    def _ground(self, formula: Formula, binding: Binding) -> Formula:
        """Return a formula with objects for its variables, and without quantifiers."""
        head, *parts = formula
        if head == "atom":
            return head, atom_text(parts[0], bound(parts[1], binding))
        if head == "same":
            first, second = bound(parts, binding)
            return TRUE if first == second else FALSE
        if head == "not" and parts[0][0] == "same":
            return FALSE if self._ground(parts[0], binding) == TRUE else TRUE
        if head in ("forall", "exists"):
            each = self.domain.bindings(parts[0], binding)
            inner = [self._ground(parts[1], wider) for wider in each]
            return "and" if head == "forall" else "or", *inner
        if head in ("and", "or", "not"):
            return head, *(self._ground(part, binding) for part in parts)
        return head, *(grounded(number, binding) for number in parts)

    # ------------------------------------------------------------ graphs to search

    def plan(
        self, problem: Problem, cap: float, go_on: Callable[[], None] = lambda: None
    ) -> tuple[Step, ...] | None:
        """Return a plan of least cost; None proves that there is none. Raises as `cheapest`."""
        goal = self._condition(problem.wanted, {})
        if goal is None:
            return None
        domain, state = problem.domain, problem.state
        values = Values(domain, state, problem.costs)
        limits = dict[str, Exact]()
        tests = list[Formula]()
        for test in goal.tests:
            raised = [text for text in self._raised if test[:2] == ("<=", ("n", text))]
            if raised and raised[0] not in limits:
                limits[raised[0]] = self._value(values, test[2]) - self._value(values, test[1])
            else:
                tests.append(test)
        moving = self._moving | goal.read
        lasting = state - moving
        if not goal.needs <= lasting | moving:
            return None
        goal = goal._replace(needs=goal.needs & moving, tests=tuple(tests))
        read = set(chain(*map(texts_in, tests)))
        further = sorted(read.difference(self._changed))
        for text in further:
            self._value(values, ("n", text))
        texts = [text for text in self._changed if text not in self._raised or text in read]
        texts += filter(self._is_computed, further)
        fixed = tuple(values.value_of(text) for text in self._fixed if text not in texts)
        weights = frozenset(problem.weights.items())
        key = goal, lasting & self._needed, weights, tuple(limits), tuple(texts), fixed
        if key not in self._graphs:
            if len(self._graphs) >= _MOST_GRAPHS:
                self._graphs.pop(next(iter(self._graphs)))
            possible = list(self._priced(problem, moving, texts, tuple(limits), values))

            def values_of(numbers: Mapping[str, Exact | None]) -> Values:
                return Values(domain, frozenset(), problem.costs, computed=numbers)

            self._graphs[key] = TaskGraph(goal, possible, texts, values_of)
        start = state & moving, tuple(values.value_of(text) for text in texts)
        path = cheapest(self._graphs[key], start, tuple(limits.values()), cap, go_on)
        return None if path is None else tuple(move.what for move in path.moves)

    def _priced(
        self,
        problem: Problem,
        moving: State,
        texts: Sequence[str],
        limited: Sequence[str],
        values: Values,
    ) -> Iterator[tuple[Operation, list[Exact]]]:
        """Yield the operations that the lasting facts allow, with their costs and uses."""
        for operation in self.operations:
            weight = problem.weights.get(operation.step, 1)
            condition = operation.condition
            needs = condition.needs & moving
            if not weight or not condition.needs - needs <= problem.state:
                continue
            amounts = [self._value(values, operation.cost) * weight]
            uses = [each for each in operation.changes if each.text in limited]
            for text in limited:
                rises = [self._value(values, each.amount) for each in uses if each.text == text]
                amounts.append(sum(rises))
            if min(amounts) < 0:
                raise UnsearchableError(f"{operation.step} costs less than nothing")
            changes = tuple(each for each in operation.changes if each.text in texts)
            condition = condition._replace(needs=needs)
            yield operation._replace(condition=condition, changes=changes), amounts

    def _value(self, values: Values, number: Number) -> Exact:
        value = values.number(number, {})
        if value is None:
            unknown = [text for text in texts_in(number) if values.value_of(text) is None]
            message = f"{unknown[0]} is needed but has no value; state '(= {unknown[0]} NUMBER)'"
            file = self.domain.problem_file
            raise UnsupportedPddlError(f"{message} in :init, or hand it in with the problem", file)
        return value
