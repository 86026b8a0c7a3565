"""The exact search: least cost within limits of what is used up, in this process, over states that are compared whole.

Label setting for resource-constrained shortest paths, after Desrochers and Soumis, "A generalized permanent labelling
algorithm for the shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All numbers are
whole, so sums are exact and so are comparisons with a limit. Work is capped by how many moves are looked at, never by
the clock, so the same question always has the same answer. Run as a program it answers one task from its standard
input; it imports nothing but the standard library.
"""

import marshal
import operator
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from heapq import heapify, heappop, heappush
from itertools import groupby
from math import inf
from operator import add, gt, le
from typing import Any, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

T = TypeVar("T")
S = TypeVar("S")
Fact: TypeAlias = tuple[int, int]
"""A variable and one of its values, both counted from 0."""
State: TypeAlias = "tuple[int, ...]"
"""The value of each variable, and behind them exact numbers."""

_COMPARED = {"<": operator.lt, "<=": operator.le, "=": operator.eq, "!=": operator.ne}
_COMPUTED = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda one, other: Fraction(one) / other,
}
# Beyond this many moves a graph forgets what it has worked out.
_MOST_KNOWN = 200_000


class NegativeCostError(Exception):
    """A step costs less than nothing in some state."""


class CapReached(Exception):
    """The search looked at as many moves as it may, without an answer."""


class Move(NamedTuple, Generic[S, T]):
    """One step: to which state, at what cost, using up how much of each limited thing; none is negative."""

    to: S
    cost: int
    uses: tuple[int, ...]
    what: T


class Graph(Protocol[S, T]):
    """What is searched."""

    def moves(self, state: S) -> Iterable[Move[S, T]]: ...

    def is_goal(self, state: S) -> bool: ...

    def least(self, state: S) -> tuple[float, Sequence[float]]:
        """Return at least what it costs from a state to a goal, and at least what it uses; infinite if out of reach.

        No move lowers it by more than the move costs or uses.
        """


class Found(NamedTuple, Generic[S, T]):
    """A cheapest way, with what it costs and uses; expanded: how many labels it took to prove it."""

    moves: tuple[Move[S, T], ...]
    cost: int
    uses: tuple[int, ...]
    expanded: int


class _Label(NamedTuple, Generic[S, T]):
    """A way to a state: what it costs, followed by what it uses up."""

    before: "_Label[S, T] | None"
    move: Move[S, T] | None
    state: S
    spent: tuple[int, ...]


def cheapest(graph: Graph[S, T], start: S, limits: Sequence[float] = (), cap: float = inf) -> Found[S, T] | None:
    """Find a way of least cost that uses up no more than the limits; None is a proof that there is none.

    CapReached is raised where looking at as many moves as the cap gives no answer.

    Labels leave the queue by cost plus what is lacking at least. So those of a state leave it in order of cost, and a
    label is worth following only if it uses less of something than every one before it; the first at a goal is
    optimal.
    """
    if any(limit < 0 for limit in limits):
        return None
    ranked = getattr(graph, "ranked", None)  # of numbers that rise and fall, which states compare by
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
            if any(map(gt, used, limits)) or (key in latest and all(map(le, latest[key], compared))):
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
    """Return how far each state is from the nearest goal, along arcs (from, to, length); others are left out."""
    into: dict[S, list[tuple[S, float]]] = {}
    for one, two, length in arcs:
        into.setdefault(two, []).append((one, length))
    order = {state: number for number, state in enumerate(into)}
    found: dict[S, float] = {}
    # whole lengths have whole sums, however large: no 0.0 here
    queue: list[tuple[float, int, S]] = [(0, order.get(goal, -1), goal) for goal in goals]
    heapify(queue)
    while queue:
        far, _, state = heappop(queue)
        if state in found:
            continue
        found[state] = far
        for before, length in into.get(state, ()):
            if before not in found:
                heappush(queue, (far + length, order.setdefault(before, len(order)), before))
    return found


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


Number: TypeAlias = "int | Fraction | tuple[Any, ...] | None"
"""An exact number, `("n", place)` for the one at that place of a state, an operator with its parts, or unknown."""
Test: TypeAlias = tuple[str, Number, Number]
"""A comparison: `<`, `<=`, `=` or `!=`, and what is compared; nothing is so of what is unknown."""


class Change(NamedTuple):
    """What becomes of a number: the facts and comparisons it depends on, its place, and its new value, or the rise."""

    needs: tuple[Fact, ...]
    tests: tuple[Test, ...]
    place: int
    is_rise: bool
    amount: Number


class Operation(NamedTuple):
    """A grounded action, which its number names; an effect is what it depends on, the variable, and its new value.

    Besides its cost it may cost more, which depends on numbers that rise and fall.
    """

    number: int
    needs: tuple[Fact, ...]
    effects: tuple[tuple[tuple[Fact, ...], int, int], ...]
    cost: int
    uses: tuple[int, ...]
    tests: tuple[Test, ...] = ()
    changes: tuple[Change, ...] = ()
    more: Number = 0


class Rule(NamedTuple):
    """An axiom: it makes a variable 0 that is 1 otherwise; low layers come first."""

    layer: int
    needs: tuple[Fact, ...]
    variable: int
    tests: tuple[Test, ...] = ()


class Task(NamedTuple):
    """A grounded task; costs and what is used up are whole.

    Sizes say how many values each variable has, limits how much of each resource may be used up from here on. Numbers
    that rise and fall, so many, stand behind the variables; their places count from the end, as -1, -2, ...
    """

    sizes: tuple[int, ...]
    start: State
    goal: tuple[Fact, ...]
    operations: tuple[Operation, ...]
    limits: tuple[int, ...]
    rules: tuple[Rule, ...] = ()
    numbers: int = 0
    tests: tuple[Test, ...] = ()


class TaskGraph:
    """A task as a graph. It serves any start and limits; what it works out is kept for the next one.

    What a fact of the goal takes at least, all variables but its own being left aside, guides the search. Unguided, it
    finds of equally good plans the one that Fast Downward's blind A* finds: operations are tried in the order of what
    they need.
    """

    def __init__(self, task: Task, *, is_guided: bool = True) -> None:
        self._task, self._is_guided = task, is_guided
        self._known = 0
        self._moves: dict[State, tuple[Move[State, int], ...]] = {}
        self._least: dict[State, tuple[float, tuple[float, ...]]] = {}
        self._by_need = _by_need(task)
        self._layers = [list(rules) for _, rules in groupby(task.rules, key=lambda rule: rule.layer)]
        self._derived = dict.fromkeys((rule.variable for rule in task.rules), 1)
        self._directions = _directions(task)
        spent = [(one.cost, *one.uses) for one in task.operations]
        # what axioms derive is left out, as no operation shows what that takes
        goal = [(variable, value) for variable, value in task.goal if variable not in self._derived]
        arcs = [(variable, value, _arcs(task, variable)) for variable, value in goal]
        self._left = [
            [
                (variable, _left(each, value, task.sizes[variable], [one[number] for one in spent]))
                for variable, value, each in arcs
            ]
            for number in range(1 + len(task.limits))
        ]

    def plan(self, start: State, limits: Sequence[int], cap: float = inf) -> Found[State, int] | None:
        """Return a plan of least cost within the limits, its moves named by operations; the rest is as `cheapest`."""
        if self._known > _MOST_KNOWN:
            self._moves, self._least, self._known = {}, {}, 0
        return cheapest(self, self._closed(list(start)), limits, cap)

    def is_goal(self, state: State) -> bool:
        return _hold(self._task.goal, state) and _pass(self._task.tests, state)

    def ranked(self, state: State) -> tuple[State, tuple[float, ...]]:
        """Return a state less the numbers of which more, or less, is as good or better, and those: less is better."""
        if not self._directions:
            return state, ()
        known = [(sign, state[place]) for place, sign in self._directions.items()]
        ranks = [inf if value is None else sign * value for sign, value in known if sign]
        kept = [state[-place] for place in range(self._task.numbers, 0, -1) if -place not in self._directions]
        return (*state[: len(self._task.sizes)], *kept), tuple(ranks)

    def moves(self, state: State) -> Sequence[Move[State, int]]:
        """Return what can be done in a state, but for what leaves it as it is."""
        moves = self._moves.get(state)
        if moves is None:
            moves = self._moves[state] = tuple(self._possible(state))
            self._known += 1 + len(moves)
        return moves

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        """Return at least what it costs, and uses, to make the goal fact that is farthest."""
        least = self._least.get(state)
        if least is None:
            costs, *uses = [max([left[state[one]] for one, left in each], default=0) for each in self._left]
            least = self._least[state] = (costs if self._is_guided or costs == inf else 0), tuple(uses)
        return least

    def _possible(self, state: State) -> Iterator[Move[State, int]]:
        candidates = [one for fact in (None, *enumerate(state)) for one in self._by_need.get(fact, ())]
        for _, operation in sorted([one for one in candidates if _hold(one[1].needs, state)]):
            if not _pass(operation.tests, state):
                continue
            after = list(state)
            for given, variable, value in operation.effects:
                if not given or _hold(given, state):
                    after[variable] = value
            if operation.changes and not _change(operation.changes, state, after):
                continue
            to = self._closed(after)
            more = value_of(operation.more, state)
            if more is not None and more < 0:
                raise NegativeCostError
            if to != state and more is not None:
                yield Move(to, operation.cost + more, operation.uses, operation.number)

    def _closed(self, state: list[int]) -> State:
        """Return a state with everything derived that the axioms derive."""
        for variable, value in self._derived.items():
            state[variable] = value
        for rules in self._layers:
            waiting = rules
            while fired := [rule for rule in waiting if _hold(rule.needs, state) and _pass(rule.tests, state)]:
                for rule in fired:
                    state[rule.variable] = 0
                waiting = [rule for rule in waiting if state[rule.variable]]
        return tuple(state)


def _hold(facts: Sequence[Fact], state: Sequence[int]) -> bool:
    return all([state[variable] == value for variable, value in facts])  # noqa: C419  # a list is quicker: few facts


def _pass(tests: Sequence[Test], state: Sequence[int]) -> bool:
    for kind, one, other in tests:
        left, right = value_of(one, state), value_of(other, state)
        if left is None or right is None or not _COMPARED[kind](left, right):
            return False
    return True


def _change(changes: Sequence[Change], state: State, after: list[int]) -> bool:
    """Put the new values of numbers in; return whether all that is to be changed is known."""
    for needs, tests, place, is_rise, amount in changes:
        if _hold(needs, state) and _pass(tests, state):
            value = value_of(amount, state)
            if value is None or (is_rise and after[place] is None):
                return False
            after[place] = after[place] + value if is_rise else value
    return True


def value_of(number: Number, state: Any) -> Any:  # noqa: ANN401  # whole, a fraction, or unknown
    """Return a number as it is in a state, or by the values of the places; None if it is unknown."""
    if not isinstance(number, tuple):
        return number
    head, *parts = number
    if head == "n":
        return state[parts[0]]
    values = [value_of(part, state) for part in parts]
    if None in values or (head == "/" and 0 in values[1:]):
        return None
    return reduce(_COMPUTED[head], values)


def _directions(task: Task) -> dict[int, int]:
    """Return the numbers that need not be the same for one state to be as good as another.

    By their place: 1 if less is as good or better, -1 if more is, 0 if nothing asks for it.
    """
    asked = [*task.tests, *(test for one in task.operations for test in one.tests)]
    asked += [test for rule in task.rules for test in rule.tests]
    changes = [change for operation in task.operations for change in operation.changes]
    signs: dict[int, set[int]] = {-1 - place: set() for place in range(task.numbers)}
    for operation in task.operations:
        _note_signs(operation.more, 1, signs)
    for kind, one, other in asked:
        for number, sign in ((one, 1), (other, -1)):
            _note_signs(number, sign if kind in ("<", "<=") else 0, signs)
    given = {variable for one in task.operations for needs, variable, _ in one.effects for variable, _ in needs}
    derived = {rule.variable for rule in task.rules}
    for change in changes:
        # what one number does to another, or whether anything changes, is not looked into
        _note_signs(change.amount, 0, signs)
        given |= {variable for variable, _ in change.needs}
        for _, one, other in change.tests:
            _note_signs(("+", one, other), 0, signs)
    if given & derived:
        return {}
    return {place: min(found, default=0) for place, found in signs.items() if len(found) < 2 and 0 not in found}


def _note_signs(number: Number, sign: int, signs: Mapping[Any, set[int]]) -> None:
    """Note whether what a number is made of makes it greater (1) or smaller (-1), or may do either (0)."""
    if isinstance(number, tuple):
        head, *parts = number
        if head == "n":
            signs[parts[0]].add(sign)
            return
        is_scaled = head == "*" and len([one for one in parts if isinstance(one, tuple) or one is None or one < 0]) < 2
        for at, part in enumerate(parts):
            kept = sign if head == "+" or is_scaled else -sign if head == "-" and at else sign if head == "-" else 0
            _note_signs(part, kept, signs)


def _by_need(task: Task) -> dict[Fact | None, list[tuple[int, Operation]]]:
    """Return the operations with their rank by the rarest fact that they need."""
    found: dict[Fact | None, list[tuple[int, Operation]]] = {}
    for rank, operation in enumerate(sorted(task.operations, key=lambda one: one.needs)):
        rarest = max(operation.needs, key=lambda fact: task.sizes[fact[0]], default=None)
        found.setdefault(rarest, []).append((rank, operation))
    return found


def _arcs(task: Task, variable: int) -> list[tuple[int, int, int]]:
    """Return the changes of a variable, all else being left aside: from, to, and the index of the operation."""
    found = []
    for index, operation in enumerate(task.operations):
        for _, changed, after in operation.effects:
            if changed == variable:
                needed = [value for one, value in operation.needs if one == variable]
                found += [(before, after, index) for before in needed or range(task.sizes[variable])]
    return found


def _left(arcs: Sequence[tuple[int, int, int]], wanted: int, size: int, amounts: Sequence[int]) -> list[float]:
    """Return, for each value of a variable, at least what it takes to give it the one that is wanted."""
    least: dict[tuple[int, int], int] = {}
    for one, two, index in arcs:
        least[one, two] = min(amounts[index], least.get((one, two), amounts[index]))
    far = distances([(one, two, takes) for (one, two), takes in least.items()], [wanted])
    return [far.get(value, inf) for value in range(size)]


# ---------------------------------------------------------------- as a program


def written(task: Task) -> bytes:
    """Return a task as this program reads it."""
    operations, rules = [tuple(one) for one in task.operations], [tuple(one) for one in task.rules]
    return marshal.dumps((task.sizes, task.start, task.goal, operations, task.limits, rules))


def _main() -> None:
    sizes, start, goal, operations, limits, rules = marshal.load(sys.stdin.buffer)
    operations = tuple([Operation(*one) for one in operations])
    graph = TaskGraph(Task(sizes, start, goal, operations, limits, tuple([Rule(*one) for one in rules])))
    found = graph.plan(start, limits)
    print(*(["none"] if found is None else ["plan", *(move.what for move in found.moves)]))


if __name__ == "__main__":
    _main()
