"""The exact search: finds a plan of least cost within the limits of resources, over explicit states, in this process.

Label setting for resource-constrained shortest paths, after Desrochers and Soumis, "A generalized permanent labelling
algorithm for the shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All costs and
amounts are whole numbers, so sums and comparisons with a limit are exact. A cap on the number of moves ends the search,
never the clock, so the same task always has the same answer. Run as a program, this file solves one task from its
standard input; it imports nothing but the standard library.
"""

import marshal
import operator
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import reduce
from heapq import heapify, heappop, heappush
from itertools import chain, groupby
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
    "/": lambda one, other: Fraction(one) / other,
}
# A graph that has stored more moves than this forgets them.
_MOST_KNOWN = 200_000


class NegativeCostError(Exception):
    """A step has a negative cost in some state."""


class CapReached(Exception):
    """The search looked at as many moves as the cap allows and found no answer."""


class Move(NamedTuple, Generic[S, T]):
    """One step: the state after it, its cost, and how much it uses of each limited resource; none is negative."""

    to: S
    cost: int
    uses: tuple[int, ...]
    what: T


class Graph(Protocol[S, T]):
    """The graph that is searched."""

    def moves(self, state: S) -> Iterable[Move[S, T]]: ...

    def is_goal(self, state: S) -> bool: ...

    def least(self, state: S) -> tuple[float, Sequence[float]]:
        """Return lower bounds of the cost and of the usage from a state to a goal; infinite if out of reach.

        The bounds are consistent: no move lowers them by more than the move costs or uses.
        """


class Found(NamedTuple, Generic[S, T]):
    """A cheapest path with its cost and usage; `expanded` is the number of labels that it took to prove it."""

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
    graph: Graph[S, T], start: S, limits: Sequence[float] = (), cap: float = inf
) -> Found[S, T] | None:
    """Find a path of least cost that uses no more than the limits; None proves that there is none.

    CapReached is raised if the search has looked at `cap` moves without an answer.

    Labels leave the queue in order of their cost plus its lower bound to a goal. So the labels of a state leave it in
    order of cost, and a label is expanded only if it uses less of something than each earlier one; the first label at
    a goal is optimal.
    """
    if any(limit < 0 for limit in limits):
        return None
    ranked = getattr(
        graph, "ranked", None
    )  # splits a state: numbers by which states dominate others
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
            if any(map(gt, used, limits)) or (
                key in latest and all(map(le, latest[key], compared))
            ):
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
    """Return the distance of each state to its nearest goal along arcs (from, to, length), if there is a path."""
    into: dict[S, list[tuple[S, float]]] = {}
    for one, two, length in arcs:
        into.setdefault(two, []).append((one, length))
    order = {state: number for number, state in enumerate(into)}
    found: dict[S, float] = {}
    # 0, not 0.0, so that sums of whole lengths stay exact however large they are
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
"""An exact number, `("n", place)` for the number at this place, an operator with its parts, or None: unknown."""
Test: TypeAlias = tuple[str, Number, Number]
"""A comparison: `<`, `<=`, `=` or `!=`, and the two numbers; it is false if a number is unknown."""


class State(NamedTuple):
    """The atoms that are true, and the values of the numbers that rise and fall."""

    atoms: frozenset[str]
    numbers: tuple[Any, ...] = ()


class Condition(NamedTuple):
    """The atoms that must be true, those that must be false, and comparisons that must hold."""

    needs: frozenset[str] = frozenset()
    denies: frozenset[str] = frozenset()
    tests: tuple[Test, ...] = ()


class Change(NamedTuple):
    """A change of a number: its condition, the place of the number, and the increase or the new value."""

    condition: Condition
    place: int
    is_rise: bool
    amount: Number


class Operation(NamedTuple):
    """A grounded action, identified by its number: its condition, deletes, adds, conditional effects and changes."""

    number: int
    condition: Condition
    deletes: frozenset[str] = frozenset()
    adds: frozenset[str] = frozenset()
    effects: tuple[tuple[Condition, str, bool], ...] = ()
    changes: tuple[Change, ...] = ()

    def extended(self, tests: Sequence[Test], changes: Sequence[Change]) -> "Operation":
        """Return the operation with more comparisons in its condition, and more changes."""
        needs, denies, before = self.condition
        return self._replace(
            condition=Condition(needs, denies, (*before, *tests)), changes=(*self.changes, *changes)
        )


class Rule(NamedTuple):
    """An axiom: it makes an atom true that is false otherwise; lower layers are applied first."""

    layer: int
    condition: Condition
    atom: str


class Task(NamedTuple):
    """A grounded task; `limits` say how much of each resource may be used up.

    `amounts` are the cost of each operation and its usage of each resource, in whole numbers. `more` is the cost of
    each operation beyond that, which depends on numbers that rise and fall; it is empty if no cost does.
    """

    start: State
    goal: Condition
    operations: tuple[Operation, ...]
    amounts: tuple[tuple[int, ...], ...]
    limits: tuple[int, ...]
    rules: tuple[Rule, ...] = ()
    more: tuple[Number, ...] = ()


class TaskGraph:
    """A task as a graph, for any start and limits; the moves and bounds that it computes are kept for the next search.

    The lower bound is the shortest path to a goal atom in a relaxed graph of atoms: of the atoms that an operation
    needs, it keeps only one.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._known = 0
        self._moves: dict[State, tuple[Move[State, int], ...]] = {}
        self._least: dict[State, tuple[float, tuple[float, ...]]] = {}
        self._by_need = _by_need(task)
        self._layers = [
            list(rules) for _, rules in groupby(task.rules, key=lambda rule: rule.layer)
        ]
        self._derived = frozenset(rule.atom for rule in task.rules)
        self._directions = _directions(task)
        # derived atoms are left out, as no operation adds them
        goals = sorted(task.goal.needs - self._derived)
        arcs = [_arcs(task, column, self._derived) for column in zip(*task.amounts, strict=True)]
        self._left = [
            [distances(each, [goal]) for goal in goals]
            for each in arcs or [[]] * (1 + len(task.limits))
        ]

    def plan(
        self, start: State, limits: Sequence[int], cap: float = inf
    ) -> Found[State, int] | None:
        """Return a plan of least cost within the limits; each move has the number of its operation. See `cheapest`."""
        if self._known > _MOST_KNOWN:
            self._moves, self._least, self._known = {}, {}, 0
        return cheapest(self, self._closed(start.atoms, start.numbers), limits, cap)

    def is_goal(self, state: State) -> bool:
        return _holds(self._task.goal, state)

    def ranked(self, state: State) -> tuple[State, tuple[float, ...]]:
        """Return a state without the numbers by which it may dominate others, and these numbers: smaller is better."""
        if not self._directions:
            return state, ()
        known = [(sign, state.numbers[place]) for place, sign in self._directions.items()]
        ranks = [inf if value is None else sign * value for sign, value in known if sign]
        kept = [value for place, value in enumerate(state.numbers) if place not in self._directions]
        return State(state.atoms, tuple(kept)), tuple(ranks)

    def moves(self, state: State) -> Sequence[Move[State, int]]:
        """Return the moves that are possible in a state and change it."""
        moves = self._moves.get(state)
        if moves is None:
            moves = self._moves[state] = tuple(self._possible(state))
            self._known += 1 + len(moves)
        return moves

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        """Return lower bounds of cost and usage: those of the farthest goal atom."""
        least = self._least.get(state)
        if least is None:
            near = (None, *state.atoms)
            found = [
                max([min([left.get(one, inf) for one in near]) for left in each], default=0)
                for each in self._left
            ]
            least = self._least[state] = found[0], tuple(found[1:])
        return least

    def _possible(self, state: State) -> Iterator[Move[State, int]]:
        operations, amounts, varying = self._task.operations, self._task.amounts, self._task.more
        candidates = [rank for atom in (None, *state.atoms) for rank in self._by_need.get(atom, ())]
        for rank in sorted(
            [rank for rank in candidates if _holds(operations[rank].condition, state)]
        ):
            operation = operations[rank]
            deletes, adds = operation.deletes, operation.adds
            if operation.effects:
                made = [
                    (atom, truth)
                    for condition, atom, truth in operation.effects
                    if _holds(condition, state)
                ]
                deletes = deletes.union([atom for atom, truth in made if not truth])
                adds = adds.union([atom for atom, truth in made if truth])
            numbers = _changed(operation.changes, state) if operation.changes else state.numbers
            if numbers is None:
                continue
            to = self._closed((state.atoms - deletes) | adds, numbers)
            more = value_of(varying[rank], state.numbers) if varying else 0
            if more is not None and more < 0:
                raise NegativeCostError
            if to != state and more is not None:
                cost, *uses = amounts[rank]
                yield Move(to, cost + more, tuple(uses), operation.number)

    def _closed(self, atoms: frozenset[str], numbers: tuple[Any, ...]) -> State:
        """Return a state with all atoms that the axioms derive."""
        state = State(atoms - self._derived, numbers)
        for rules in self._layers:
            waiting = rules
            while fired := {rule.atom for rule in waiting if _holds(rule.condition, state)}:
                state = State(state.atoms | fired, numbers)
                waiting = [rule for rule in waiting if rule.atom not in fired]
        return state


def _holds(condition: Condition, state: State) -> bool:
    needs, denies, tests = condition
    atoms = state.atoms
    return (
        needs <= atoms and denies.isdisjoint(atoms) and (not tests or passes(tests, state.numbers))
    )


def passes(tests: Sequence[Test], numbers: Sequence[Any]) -> bool:
    for kind, one, other in tests:
        left, right = value_of(one, numbers), value_of(other, numbers)
        if left is None or right is None or not _COMPARED[kind](left, right):
            return False
    return True


def _changed(changes: Sequence[Change], state: State) -> tuple[Any, ...] | None:
    """Return the new values of the numbers; None if a number that must change is unknown."""
    after = list(state.numbers)
    for condition, place, is_rise, amount in changes:
        if _holds(condition, state):
            value = value_of(amount, state.numbers)
            if value is None or (is_rise and after[place] is None):
                return None
            after[place] = after[place] + value if is_rise else value
    return tuple(after)


def value_of(number: Number, state: Any) -> Any:  # noqa: ANN401  # whole, a fraction, or unknown
    """Return the value of a number, given the values at the places; None if it is unknown."""
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
    """Return the numbers by which one state may dominate another, with the better direction.

    By place: 1 if less is as good or better, -1 if more is as good or better, 0 if nothing depends on it.
    """
    changes = [change for operation in task.operations for change in operation.changes]
    if not changes:
        return {}
    signs: dict[int, set[int]] = {change.place: set() for change in changes}
    for number in task.more:
        _note_signs(number, 1, signs)
    for asked in (
        task.goal,
        *(one.condition for one in task.operations),
        *(rule.condition for rule in task.rules),
    ):
        for kind, one, other in asked.tests:
            for number, sign in ((one, 1), (other, -1)):
                _note_signs(number, sign if kind in ("<", "<=") else 0, signs)
    given = [condition for operation in task.operations for condition, *_ in operation.effects]
    for change in changes:
        # a number that changes another one, or decides whether there is a change, is not analysed further
        _note_signs(change.amount, 0, signs)
        given.append(change.condition)
    for condition in given:
        for _, one, other in condition.tests:
            _note_signs(("+", one, other), 0, signs)
    derived = {rule.atom for rule in task.rules}
    if any(not derived.isdisjoint(one.needs | one.denies) for one in given):
        return {}
    return {
        place: min(found, default=0)
        for place, found in signs.items()
        if len(found) < 2 and 0 not in found
    }


def _note_signs(number: Number, sign: int, signs: Mapping[Any, set[int]]) -> None:
    """Note for each part of a number whether it increases the number (1), decreases it (-1), or may do either (0)."""
    if isinstance(number, tuple):
        head, *parts = number
        if head == "n":
            signs.get(parts[0], set()).add(sign)
            return
        is_scaled = (
            head == "*"
            and len([one for one in parts if isinstance(one, tuple) or one is None or one < 0]) < 2
        )
        for at, part in enumerate(parts):
            kept = (
                sign
                if head == "+" or is_scaled
                else -sign
                if head == "-" and at
                else sign
                if head == "-"
                else 0
            )
            _note_signs(part, kept, signs)


def _by_need(task: Task) -> dict[str | None, list[int]]:
    """Return the ranks of the operations by that atom of their condition that the fewest others need."""
    found: dict[str | None, list[int]] = {}
    needed = Counter(
        chain.from_iterable(operation.condition.needs for operation in task.operations)
    )
    for rank, operation in enumerate(task.operations):
        rarest = min(operation.condition.needs, key=needed.__getitem__, default=None)
        found.setdefault(rarest, []).append(rank)
    return found


def _arcs(
    task: Task, amounts: Sequence[float], derived: frozenset[str]
) -> list[tuple[str | None, str, float]]:
    """Return the arcs of the relaxed graph: from an atom, or None for anywhere, to an atom, and the amount."""
    found = []
    for one, takes in zip(task.operations, amounts, strict=True):
        needs = one.condition.needs - derived
        before = min(needs & one.deletes or needs, default=None)
        for after in one.adds:
            found.append((before, after, takes))
        for _, after, truth in one.effects:
            if truth:
                found.append((before, after, takes))
    return found


# ---------------------------------------------------------------- as a program


def written(task: Task) -> bytes:
    """Return a task in the form that this program reads."""
    return marshal.dumps(_plain(task))


def _plain(thing: Any) -> Any:  # noqa: ANN401  # what tasks are made of
    return tuple(map(_plain, thing)) if isinstance(thing, tuple) else thing


def _main() -> None:
    start, goal, operations, amounts, limits, rules, _ = marshal.load(sys.stdin.buffer)
    made = [
        Operation(
            number,
            Condition(*needed),
            deletes,
            adds,
            tuple((Condition(*one[0]), *one[1:]) for one in effects),
        )
        for number, needed, deletes, adds, effects, _ in operations
    ]
    derived = [Rule(layer, Condition(*needed), atom) for layer, needed, atom in rules]
    task = Task(State(*start), Condition(*goal), tuple(made), amounts, limits, tuple(derived))
    found = TaskGraph(task).plan(task.start, limits)
    print(*(["none"] if found is None else ["plan", *(move.what for move in found.moves)]))


if __name__ == "__main__":
    _main()
