"""The exact search: least cost within limits of what is used up, in this process, over states that are compared whole.

Label setting for resource-constrained shortest paths, after Desrochers and Soumis, "A generalized permanent labelling
algorithm for the shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All numbers are
whole, so sums are exact and so are comparisons with a limit. Work is capped by how many moves are looked at, never by
the clock, so the same question always has the same answer. Run as a program it answers one task from its standard
input; it imports nothing but the standard library.
"""

import marshal
import sys
from collections.abc import Iterable, Iterator, Sequence
from heapq import heapify, heappop, heappush
from itertools import groupby
from math import inf
from operator import add, gt, le
from typing import Generic, NamedTuple, Protocol, TypeAlias, TypeVar

T = TypeVar("T")
S = TypeVar("S")
Fact: TypeAlias = tuple[int, int]
"""A variable and one of its values, both counted from 0."""
State: TypeAlias = tuple[int, ...]
"""The value of each variable."""

# Beyond this many moves a graph forgets what it has worked out.
_MOST_KNOWN = 200_000


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
    first: _Label[S, T] = _Label(None, None, start, (0,) * (1 + len(limits)))
    queue = [(graph.least(start)[0], first.spent[1:], 0, first)]
    followed: dict[S, list[tuple[int, ...]]] = {}
    latest: dict[S, tuple[int, ...]] = {}
    looked_at = pushed = expanded = 0
    while queue:
        _, uses, _, label = heappop(queue)
        _, _, state, spent = label
        front = followed.get(state, ())
        if _is_dominated(uses, front):
            continue
        if graph.is_goal(state):
            return Found(_moves(label), spent[0], uses, expanded)
        followed[state] = [uses, *(other for other in front if not _is_dominated(other, (uses,)))]
        expanded += 1
        for move in graph.moves(state):
            looked_at += 1
            to, cost, more, _ = move
            cost += spent[0]
            used = tuple([a + b for a, b in zip(uses, more, strict=True)]) if limits else ()
            reached = (cost, *used)
            if any(map(gt, used, limits)) or (to in latest and all(map(le, latest[to], reached))):
                continue
            if _is_dominated(used, followed.get(to, ())):
                continue
            least, lacking = graph.least(to)
            if least == inf or any(map(gt, map(add, used, lacking), limits)):
                continue
            latest[to] = reached
            pushed += 1
            heappush(queue, (cost + least, used, pushed, _Label(label, move, to, reached)))
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


def _is_dominated(weight: tuple[int, ...], front: Iterable[tuple[int, ...]]) -> bool:
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


class Operation(NamedTuple):
    """A grounded action, which its number names; an effect is what it depends on, the variable, and its new value."""

    number: int
    needs: tuple[Fact, ...]
    effects: tuple[tuple[tuple[Fact, ...], int, int], ...]
    cost: int
    uses: tuple[int, ...]


class Rule(NamedTuple):
    """An axiom: it derives the value of a variable that has its value of the start otherwise; low layers come first."""

    layer: int
    needs: tuple[Fact, ...]
    variable: int
    value: int


class Task(NamedTuple):
    """A grounded task; all numbers are whole.

    Sizes say how many values each variable has, limits how much of each resource may be used up from here on.
    """

    sizes: tuple[int, ...]
    start: State
    goal: tuple[Fact, ...]
    operations: tuple[Operation, ...]
    limits: tuple[int, ...]
    rules: tuple[Rule, ...] = ()


class TaskGraph:
    """A task as a graph. Without axioms it serves any start and limits; what it works out is kept for the next one.

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
        self._derived = {rule.variable: task.start[rule.variable] for rule in task.rules}
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

    def least_uses(self, start: State) -> tuple[float, ...]:
        """Return a lower bound of what reaching the goal uses of each resource; infinite if it is out of reach."""
        return self.least(self._closed(list(start)))[1]

    def is_goal(self, state: State) -> bool:
        return _hold(self._task.goal, state)

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
            after = list(state)
            for given, variable, value in operation.effects:
                if not given or _hold(given, state):
                    after[variable] = value
            to = self._closed(after)
            if to != state:
                yield Move(to, operation.cost, operation.uses, operation.number)

    def _closed(self, state: list[int]) -> State:
        """Return a state with everything derived that the axioms derive."""
        for variable, value in self._derived.items():
            state[variable] = value
        for rules in self._layers:
            waiting = rules
            while fired := [rule for rule in waiting if _hold(rule.needs, state)]:
                for rule in fired:
                    state[rule.variable] = rule.value
                waiting = [rule for rule in waiting if state[rule.variable] != rule.value]
        return tuple(state)


def _hold(facts: Sequence[Fact], state: Sequence[int]) -> bool:
    return all([state[variable] == value for variable, value in facts])  # noqa: C419  # a list is quicker: few facts


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
