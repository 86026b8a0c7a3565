"""The exact search: finds a plan of least cost over explicit states, in this process.

Label setting after Desrochers and Soumis, "A generalized permanent labelling algorithm for the
shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All amounts are
exact, so sums and comparisons with a limit are exact. A cap on the number of moves ends the search,
never the clock, so the same task always has the same answer.
"""

import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from heapq import heapify, heappop, heappush
from itertools import chain
from math import inf
from operator import add, gt, le
from typing import Any, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

T = TypeVar("T")
S = TypeVar("S")

_COMPARED = {"<": operator.lt, "<=": operator.le, "=": operator.eq, "!=": operator.ne}
_COMPUTED = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda left, right: Fraction(left) / right,
}
# A graph that has stored more moves than this forgets them.
_MOST_KNOWN = 200_000


class NegativeCostError(Exception):
    """A step has a negative cost in some state."""


class CapReached(Exception):
    """The search looked at as many moves as the cap allows and found no answer."""


class Move(NamedTuple, Generic[S, T]):
    """One step: the state after it, its cost, and its use of each limited resource; not negative."""

    to: S
    cost: int
    uses: tuple[int, ...]
    what: T


class Graph(Protocol[S, T]):
    """The graph that is searched."""

    def moves(self, state: S) -> Iterable[Move[S, T]]: ...

    def is_goal(self, state: S) -> bool: ...

    def least(self, state: S) -> tuple[float, Sequence[float]]:
        """Return lower bounds of cost and usage from a state to a goal; infinite if out of reach.

        The bounds are consistent: no move lowers them by more than the move costs or uses.
        """


class Found(NamedTuple, Generic[S, T]):
    """A cheapest path with its cost and usage; `expanded` labels proved it."""

    moves: tuple[Move[S, T], ...]
    cost: int
    uses: tuple[int, ...]
    expanded: int


class _Label(NamedTuple, Generic[S, T]):
    """A path to a state: its cost, followed by its usage."""

    before: "_Label[S, T] | None"
    move: Move[S, T] | None
    state: S
    spent: tuple[int, ...]


def cheapest(
    graph: Graph[S, T],
    start: S,
    limits: Sequence[float] = (),
    cap: float = inf,
    go_on: Callable[[], None] = lambda: None,
) -> Found[S, T] | None:
    """Find a path of least cost that uses no more than the limits; None proves that there is none.

    CapReached is raised if the search has looked at `cap` moves without an answer. `go_on` is
    called for each label that is expanded, and may raise to stop the search.

    Labels leave the queue in order of their cost plus its lower bound to a goal. So the labels of
    a state leave it in order of cost, and a label is expanded only if it uses less of something
    than each earlier one; the first label at a goal is optimal.
    """
    if any(limit < 0 for limit in limits):
        return None
    # splits a state: numbers by which states dominate others
    ranked = getattr(graph, "ranked", None)
    key, ranks = ranked(start) if ranked else (start, ())
    first: _Label[S, T] = _Label(None, None, start, (0,) * (1 + len(limits)))
    queue = [(graph.least(start)[0], (*first.spent[1:], *ranks), 0, first, key)]
    followed: dict[S, list[tuple[float, ...]]] = {}
    latest: dict[S, tuple[float, ...]] = {}
    looked_at = pushed = expanded = 0
    while queue:
        _, weight, _, label, key = heappop(queue)
        _, _, state, spent = label
        front = followed.get(key, ())
        if _is_dominated(weight, front):
            continue
        uses = spent[1:]
        if graph.is_goal(state):
            return Found(_moves(label), spent[0], uses, expanded)
        followed[key] = [weight, *(other for other in front if not _is_dominated(other, (weight,)))]
        expanded += 1
        go_on()
        for move in graph.moves(state):
            looked_at += 1
            to, cost, more, _ = move
            cost += spent[0]
            used = tuple([a + b for a, b in zip(uses, more, strict=True)]) if limits else ()
            reached = (cost, *used)
            key, weight, compared = to, used, reached
            if ranked:
                key, ranks = ranked(to)
                weight, compared = (*used, *ranks), (*reached, *ranks)
            if any(map(gt, used, limits)):
                continue
            if key in latest and all(map(le, latest[key], compared)):
                continue
            if _is_dominated(weight, followed.get(key, ())):
                continue
            least, lacking = graph.least(to)
            if least == inf or any(map(gt, map(add, used, lacking), limits)):
                continue
            latest[key] = compared
            pushed += 1
            heappush(queue, (cost + least, weight, pushed, _Label(label, move, to, reached), key))
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


def _is_dominated(weight: tuple[float, ...], front: Iterable[tuple[float, ...]]) -> bool:
    for other in front:  # noqa: SIM110  # a loop is quicker: few others
        if all(map(le, other, weight)):
            return True
    return False


def _moves(label: _Label[S, T]) -> tuple[Move[S, T], ...]:
    moves: list[Move[S, T]] = []
    at: _Label[S, T] | None = label
    while at is not None and at.move is not None:
        moves.append(at.move)
        at = at.before
    return tuple(moves[::-1])


# ---------------------------------------------------------------- over a grounded task


Number: TypeAlias = Any
"""An exact number, `("n", place)`, an operator with its parts, or None: unknown."""
Test: TypeAlias = tuple[str, Number, Number]
"""A comparison: `<`, `<=`, `=` or `!=`, and the two numbers; false if a number is unknown."""


class State(NamedTuple):
    """The atoms that are true, and the values of the numbers that rise and fall."""

    atoms: frozenset[str]
    numbers: tuple[Any, ...] = ()


class Condition(NamedTuple):
    """The atoms that must be true, those that must be false, and comparisons that must hold."""

    needs: frozenset[str] = frozenset()
    denies: frozenset[str] = frozenset()
    tests: tuple[Test, ...] = ()


ALWAYS = Condition()


class Change(NamedTuple):
    """A change of a number: its condition, the number's place, and the increase or new value."""

    condition: Condition
    place: int
    is_rise: bool
    amount: Number


class Phase(NamedTuple):
    """The start or the end of a step: its condition, deletes, adds, further effects, changes."""

    condition: Condition
    deletes: frozenset[str] = frozenset()
    adds: frozenset[str] = frozenset()
    effects: tuple[tuple[Condition, str, bool], ...] = ()
    changes: tuple[Change, ...] = ()

    @property
    def changes_something(self) -> bool:
        """Whether it has an effect."""
        return bool(self.deletes or self.adds or self.effects or self.changes)


class Operation(NamedTuple):
    """A grounded action, by its number: its phases follow one another."""

    number: int
    phases: tuple[Phase, ...]


class Rule(NamedTuple):
    """An axiom: it makes an atom true that is false otherwise; lower layers are applied first."""

    layer: int
    condition: Condition
    atom: str


class Task(NamedTuple):
    """A grounded task with the cost of each operation, which may depend on numbers."""

    start: State
    goal: Condition
    operations: tuple[Operation, ...]
    costs: tuple[Number, ...]
    rules: tuple[Rule, ...] = ()


class TaskGraph:
    """A task as a graph, for any start; its moves and bounds are kept for the next search.

    The lower bound is the shortest path to a goal atom in a relaxed graph of atoms: of the atoms
    that an operation needs, it keeps only one.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._stored = 0
        self._moves: dict[State, tuple[Move[State, int], ...]] = {}
        self._least: dict[State, float] = {}
        self._by_need = _by_need(task)
        self._derivation = _Derivation(task.rules)
        self._directions = _directions(task)
        self._lasting = _lasting_tests(task, self._directions)
        # derived atoms are left out, as no operation adds them
        goals = sorted(task.goal.needs - self._derivation.atoms)
        arcs = list(_arcs(task, self._derivation.atoms))
        self._distances = [distances(arcs, [goal]) for goal in goals]

    def plan(
        self, start: State, cap: float = inf, go_on: Callable[[], None] = lambda: None
    ) -> Found[State, int] | None:
        """Return a plan of least cost; each move has the number of its operation. See `cheapest`."""
        if self._stored > _MOST_KNOWN:
            self._moves, self._least, self._stored = {}, {}, 0
        return cheapest(self, self._derivation.closed(start), (), cap, go_on)

    def is_goal(self, state: State) -> bool:
        """Whether the goal holds."""
        return holds(self._task.goal, state)

    def ranked(self, state: State) -> tuple[State, tuple[float, ...]]:
        """Split off the numbers by which a state may dominate others: smaller is better."""
        if not self._directions:
            return state, ()
        ranks = list[float]()
        for place, sign in self._directions.items():
            value = state.numbers[place]
            if sign:
                ranks.append(inf if value is None else sign * value)
        numbers = [n for place, n in enumerate(state.numbers) if place not in self._directions]
        return State(state.atoms, tuple(numbers)), tuple(ranks)

    def moves(self, state: State) -> Sequence[Move[State, int]]:
        """Return the moves that are possible in a state and change it."""
        moves = self._moves.get(state)
        if moves is None:
            moves = self._moves[state] = tuple(self._possible(state))
            self._stored += 1 + len(moves)
        return moves

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        """Return a lower bound of the cost: the distance of the farthest goal atom."""
        least = self._least.get(state)
        if least is None:
            atoms = (None, *state.atoms)
            least = 0
            for distance in self._distances:
                least = max(least, min([distance.get(atom, inf) for atom in atoms]))
            self._least[state] = least
        return least, ()

    def _possible(self, state: State) -> Iterator[Move[State, int]]:
        operations, costs = self._task.operations, self._task.costs
        candidates = list(self._by_need.get(None, ()))
        for atom in state.atoms:
            candidates += self._by_need.get(atom, ())
        for rank in sorted(candidates):
            after: State | None = state
            for phase in operations[rank].phases:
                if after is None or not holds(phase.condition, after):
                    after = None
                    break
                after = self._after(phase, after)
            if after is None or after == state or not passes(self._lasting, after.numbers):
                continue
            cost = value_of(costs[rank], state.numbers)
            if cost is not None and cost < 0:
                raise NegativeCostError
            if cost is not None:
                yield Move(after, cost, (), operations[rank].number)

    def _after(self, phase: Phase, state: State) -> State | None:
        deletes, adds = phase.deletes, phase.adds
        if phase.effects:
            happening = [each for each in phase.effects if holds(each[0], state)]
            deletes = deletes.union([atom for _, atom, truth in happening if not truth])
            adds = adds.union([atom for _, atom, truth in happening if truth])
        numbers = _changed(phase.changes, state) if phase.changes else state.numbers
        if numbers is None:
            return None
        return self._derivation.closed(State((state.atoms - deletes) | adds, numbers))


class _Derivation:
    """Derives atoms layer by layer; each new atom is looked at once."""

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.atoms = frozenset(rule.atom for rule in rules)
        self._layers: dict[int, list[Rule]] = {}
        self._by_need: dict[tuple[int, str], list[Rule]] = {}
        for rule in rules:
            self._layers.setdefault(rule.layer, []).append(rule)
            for atom in rule.condition.needs & self.atoms:
                self._by_need.setdefault((rule.layer, atom), []).append(rule)

    def closed(self, state: State) -> State:
        """Return a state with all atoms that the rules derive."""
        if not self._layers:
            return state
        atoms = set(state.atoms - self.atoms)
        growing = State(atoms, state.numbers)  # type: ignore[arg-type]  # it is frozen at the end
        for layer in sorted(self._layers):
            waiting = list(self._layers[layer])
            for rule in waiting:  # it grows meanwhile
                if rule.atom not in atoms and holds(rule.condition, growing):
                    atoms.add(rule.atom)
                    waiting += self._by_need.get((layer, rule.atom), ())
        return State(frozenset(atoms), state.numbers)


def holds(condition: Condition, state: State) -> bool:
    """Whether a condition holds in a state."""
    needs, denies, tests = condition
    atoms = state.atoms
    if not (needs <= atoms and denies.isdisjoint(atoms)):
        return False
    return not tests or passes(tests, state.numbers)


def passes(tests: Sequence[Test], numbers: Sequence[Any]) -> bool:
    """Whether comparisons hold for the values of numbers."""
    for kind, one, other in tests:
        left, right = value_of(one, numbers), value_of(other, numbers)
        if left is None or right is None or not _COMPARED[kind](left, right):
            return False
    return True


def _changed(changes: Sequence[Change], state: State) -> tuple[Any, ...] | None:
    """Return the new values of the numbers; None if a number that must change is unknown."""
    after = list(state.numbers)
    for condition, place, is_rise, amount in changes:
        if holds(condition, state):
            value = value_of(amount, state.numbers)
            if value is None or (is_rise and after[place] is None):
                return None
            after[place] = after[place] + value if is_rise else value
    return tuple(after)


def value_of(number: Number, values: Any) -> Any:  # noqa: ANN401  # whole, a fraction, or unknown
    """Return the value of a number, given the values at the places; None if it is unknown."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return values[parts[0]]
    computed = [value_of(part, values) for part in parts]
    if None in computed or (head == "/" and 0 in computed[1:]):
        return None
    return reduce(_COMPUTED[head], computed)


def _changes_of(task: Task) -> Iterator[Change]:
    for operation in task.operations:
        for phase in operation.phases:
            yield from phase.changes


def _directions(task: Task) -> dict[int, int]:
    """Return the numbers by which one state may dominate another, with the better direction.

    By place: 1 if less is as good or better, -1 if more is, 0 if nothing depends on it.
    """
    changes = list(_changes_of(task))
    if not changes:
        return {}
    signs: dict[int, set[int]] = {change.place: set() for change in changes}
    for cost in task.costs:
        _note_signs(cost, 1, signs)
    phases = [phase for operation in task.operations for phase in operation.phases]
    conditions = [task.goal, *(phase.condition for phase in phases)]
    conditions += [rule.condition for rule in task.rules]
    for condition in conditions:
        for kind, one, other in condition.tests:
            for number, sign in ((one, 1), (other, -1)):
                _note_signs(number, sign if kind in ("<", "<=") else 0, signs)
    given = [effect[0] for phase in phases for effect in phase.effects]
    for change in changes:
        # a number that changes another one, or decides whether there is a change, is left out
        _note_signs(change.amount, 0, signs)
        given.append(change.condition)
    for condition in given:
        for _, one, other in condition.tests:
            _note_signs(("+", one, other), 0, signs)
    derived = {rule.atom for rule in task.rules}
    if any(not derived.isdisjoint(each.needs | each.denies) for each in given):
        return {}
    if any(not derived.isdisjoint(each.denies) for each in conditions):
        return {}
    directions = dict[int, int]()
    for place, each in signs.items():
        if len(each) < 2 and 0 not in each:
            directions[place] = min(each, default=0)
    return directions


def _note_signs(number: Number, sign: int, signs: Mapping[Any, set[int]]) -> None:
    """Note whether each part of a number increases it (1), decreases it (-1), or either (0)."""
    if not isinstance(number, tuple):
        return
    head, *parts = number
    if head == "n":
        signs.get(parts[0], set()).add(sign)
        return
    uncertain = [part for part in parts if isinstance(part, tuple) or part is None or part < 0]
    for at, part in enumerate(parts):
        if head == "+" or (head == "*" and len(uncertain) < 2 and not _is_negative(parts)):
            kept = sign
        elif head == "-":
            kept = -sign if at else sign
        else:
            kept = 0
        _note_signs(part, kept, signs)


def _is_negative(parts: Iterable[Number]) -> bool:
    return any(not isinstance(part, tuple) and (part is None or part < 0) for part in parts)


def _lasting_tests(task: Task, directions: Mapping[int, int]) -> tuple[Test, ...]:
    """Return the tests of the goal that never hold again once they do not: limits that fill up."""
    rising = set(directions)
    for change in _changes_of(task):
        amount = change.amount
        if not change.is_rise or isinstance(amount, tuple) or amount is None or amount < 0:
            rising.discard(change.place)
    tests = list[Test]()
    for kind, one, other in task.goal.tests:
        is_limit = kind in ("<", "<=") and not isinstance(other, tuple)
        if is_limit and isinstance(one, tuple) and one[0] == "n" and one[1] in rising:
            tests.append((kind, one, other))
    return tuple(tests)


def _by_need(task: Task) -> dict[str | None, list[int]]:
    """Return the ranks of the operations by the atom they need that the fewest others need."""
    first = [operation.phases[0].condition.needs for operation in task.operations]
    needed = Counter(chain.from_iterable(first))
    by_need: dict[str | None, list[int]] = {}
    for rank, needs in enumerate(first):
        rarest = min(sorted(needs), key=needed.__getitem__, default=None)
        by_need.setdefault(rarest, []).append(rank)
    return by_need


def _arcs(task: Task, derived: frozenset[str]) -> Iterator[tuple[str | None, str, float]]:
    """Yield the arcs of the relaxed graph: from an atom, or None for anywhere, and the cost."""
    for operation, cost in zip(task.operations, task.costs, strict=True):
        takes = 0 if isinstance(cost, tuple) or cost is None else cost
        first = operation.phases[0]
        needs = first.condition.needs - derived
        deletes = frozenset(chain.from_iterable(phase.deletes for phase in operation.phases))
        before = min(needs & deletes or needs, default=None)
        for phase in operation.phases:
            for after in sorted(phase.adds):
                yield before, after, takes
            for _, after, truth in phase.effects:
                if truth:
                    yield before, after, takes
