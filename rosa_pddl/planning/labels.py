"""The cheapest way through a graph when some of what is used up on the way is limited: exact, by labels.

All numbers are whole, so sums are exact and so are comparisons with a limit.
"""

from collections.abc import Callable, Iterable, Sequence
from heapq import heapify, heappop, heappush
from math import inf
from operator import add, gt, le
from typing import Generic, NamedTuple, TypeVar

__all__ = ["Found", "Graph", "Move", "cheapest", "distances"]

T = TypeVar("T")
S = TypeVar("S")


class Move(NamedTuple, Generic[S, T]):
    """One step: to which state, at what cost, using up how much of each limited thing; none is negative."""

    to: S
    cost: int
    uses: tuple[int, ...]
    what: T


class Graph(NamedTuple, Generic[S, T]):
    """What is searched.

    Attributes:
        moves: the moves from a state.
        is_goal: whether a state is one to end in.
        least: at least what it costs from a state to a goal, and at least what it uses; infinite if none is in reach.
    """

    moves: Callable[[S], Iterable[Move[S, T]]]
    is_goal: Callable[[S], bool]
    least: Callable[[S], tuple[float, tuple[float, ...]]] = lambda state: (0.0, ())


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


def cheapest(graph: Graph[S, T], start: S, limits: Sequence[float] = ()) -> Found[S, T] | None:
    """Find a way of least cost that uses up no more than the limits; None is a proof that there is none.

    Labels leave the queue by cost plus what is lacking at least. So those of a state leave it in order of cost, and a
    label is worth following only if it uses less of something than every one before it; the first at a goal is
    optimal. `least` has to be consistent: no move lowers it by more than the move costs.
    """
    first: _Label[S, T] = _Label(None, None, start, (0,) * (1 + len(limits)))
    queue = [(graph.least(start)[0], first.spent[1:], 0, first)]
    followed: dict[S, list[tuple[int, ...]]] = {}
    latest: dict[S, tuple[int, ...]] = {}
    pushed, expanded = 0, 0
    while queue:
        _, uses, _, label = heappop(queue)
        _, _, state, spent = label
        front = followed.get(state, ())
        if _is_dominated(uses, front):
            continue
        if graph.is_goal(state):
            return Found(tuple(_moves(label)), spent[0], uses, expanded)
        followed[state] = [uses, *(other for other in front if not _is_dominated(other, (uses,)))]
        expanded += 1
        for move in graph.moves(state):
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
    for other in front:
        for one, two in zip(other, weight, strict=True):
            if one > two:
                break
        else:
            return True
    return False


def _moves(label: _Label[S, T]) -> list[Move[S, T]]:
    moves: list[Move[S, T]] = []
    at: _Label[S, T] | None = label
    while at is not None and at.move is not None:
        moves.append(at.move)
        at = at.before
    return moves[::-1]
