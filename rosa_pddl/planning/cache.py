"""Remembers answers by state, goal and costs."""

from collections import OrderedDict
from threading import Lock
from typing import TypeAlias

from rosa_pddl.planning.outcomes import PlanningResult
from rosa_pddl.problem import Problem

__all__ = ["PlanCache"]

# A state of a large domain has tens of thousands of atoms: their number counts too.
_MOST_ATOMS = 1_000_000

_Key: TypeAlias = tuple[object, ...]


class PlanCache:
    """The answers that were last asked for. May be used by several threads.

    Args:
        size: how many are kept at most.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._results: OrderedDict[_Key, PlanningResult] = OrderedDict()
        self._weights: dict[_Key, int] = {}
        self._weight = 0
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._results)

    def get(self, problem: Problem, found_with: object = None) -> PlanningResult | None:
        """Return the answer to a problem; None if it is not remembered.

        Args:
            problem: what is asked.
            found_with: what else the answer depends on.
        """
        key = _key(problem, found_with)
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
            return self._results.get(key)

    def put(self, problem: Problem, result: PlanningResult, found_with: object = None) -> None:
        """Remember an answer, and forget what was not asked for the longest."""
        key, weight = _key(problem, found_with), len(problem.state) + len(problem.costs) + 1
        with self._lock:
            if key in self._results:
                return
            self._results[key], self._weights[key] = result, weight
            self._weight += weight
            while len(self._results) > self._size or self._weight > _MOST_ATOMS:
                oldest, _ = self._results.popitem(last=False)
                self._weight -= self._weights.pop(oldest)


def _key(problem: Problem, found_with: object) -> _Key:
    return found_with, problem.domain, problem.state, problem.wanted, frozenset(problem.costs.items())
