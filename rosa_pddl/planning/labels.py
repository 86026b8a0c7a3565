"""The cheapest way through a graph when some of what is used up on the way is limited: exact, by labels.

All numbers are whole, so sums are exact and so are comparisons with a limit.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from math import inf
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


@dataclass(frozen=True)
class Graph(Generic[S, T]):
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
    before: "_Label[S, T] | None"
    move: Move[S, T] | None
    state: S
    cost: int
    uses: tuple[int, ...]


def cheapest(graph: Graph[S, T], start: S, limits: Sequence[float] = ()) -> Found[S, T] | None:
    """Find a way of least cost that uses up no more than the limits; None is a proof that there is none.

    Labels leave the queue by cost plus what is lacking at least. So those of a state leave it in order of cost, and a
    label is worth following only if it uses less of something than every one before it; the first at a goal is
    optimal. `least` has to be consistent: no move lowers it by more than the move costs.
    """
    first: _Label[S, T] = _Label(None, None, start, 0, (0,) * len(limits))
    queue = [(graph.least(start)[0], first.uses, 0, first)]
    best: dict[S, list[tuple[int, ...]]] = {}
    pushed, expanded = 0, 0
    while queue:
        _, uses, _, label = heappop(queue)
        state = label.state
        if graph.is_goal(state):
            return Found(tuple(_moves(label)), label.cost, uses, expanded)
        front = best.setdefault(state, [])
        if _is_dominated(uses, front):
            continue
        front.append(uses)
        expanded += 1
        for move in graph.moves(state):
            used = tuple(a + b for a, b in zip(uses, move.uses, strict=False)) if limits else ()
            if move.to in best and _is_dominated(used, best[move.to]):
                continue
            least, lacking = graph.least(move.to)
            if least == inf or any(a + b > limit for a, b, limit in zip(used, lacking, limits, strict=False)):
                continue
            if any(a > limit for a, limit in zip(used, limits, strict=True)):
                continue
            pushed += 1
            cost = label.cost + move.cost
            heappush(queue, (cost + least, used, pushed, _Label(label, move, move.to, cost, used)))
    return None


def distances(arcs: Iterable[tuple[S, S, float]], goals: Iterable[S]) -> dict[S, float]:
    """Return how far each state is from the nearest goal, along arcs (from, to, length); others are left out."""
    into: dict[S, list[tuple[S, float]]] = {}
    for one, two, length in arcs:
        into.setdefault(two, []).append((one, length))
    order = {state: number for number, state in enumerate(into)}
    found: dict[S, float] = {}
    queue = [(0.0, order.get(goal, -1), goal) for goal in goals]
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


def _is_dominated(uses: tuple[int, ...], front: list[tuple[int, ...]]) -> bool:
    return any(all(a <= b for a, b in zip(other, uses, strict=True)) for other in front)


def _moves(label: _Label[S, T]) -> list[Move[S, T]]:
    moves: list[Move[S, T]] = []
    at: _Label[S, T] | None = label
    while at is not None and at.move is not None:
        moves.append(at.move)
        at = at.before
    return moves[::-1]
