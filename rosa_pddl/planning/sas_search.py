"""The exact search over the states of a translated task: least cost, within limits of what its operators use up."""

from collections.abc import Iterator, Sequence
from math import inf
from typing import NamedTuple, TypeAlias

from rosa_pddl.planning.labels import Found, Graph, Move, cheapest, distances

__all__ = ["Operation", "SasGraph", "Task", "found_in"]

Fact: TypeAlias = tuple[int, int]
State: TypeAlias = tuple[int, ...]


class Operation(NamedTuple):
    """An operator.

    Attributes:
        number: names it in the answer.
        needs: what must hold.
        effects: what it depends on, the variable, and the value that it gets.
        cost: from 0.
        uses: of each resource, from 0.
    """

    number: int
    needs: tuple[Fact, ...]
    effects: tuple[tuple[tuple[Fact, ...], int, int], ...]
    cost: int
    uses: tuple[int, ...]


class Task(NamedTuple):
    """What is searched; all numbers are whole.

    Attributes:
        sizes: how many values each variable has.
        start: the value of each variable.
        goal: the facts that shall hold.
        operations: what can be done.
        limits: at most how much of each resource may be used up from here on.
    """

    sizes: tuple[int, ...]
    start: State
    goal: tuple[Fact, ...]
    operations: tuple[Operation, ...]
    limits: tuple[int, ...]


def found_in(task: Task) -> Found[State, int] | None:
    """Return a plan of least cost within the limits, its moves named by operators; None is a proof of there is none."""
    if any(limit < 0 for limit in task.limits):
        return None
    return cheapest(SasGraph(task).graph, task.start, task.limits)


class SasGraph:
    """A task as a graph.

    Args:
        task: what is searched.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._moves: dict[State, tuple[Move[State, int], ...]] = {}
        self._least: dict[State, tuple[float, tuple[float, ...]]] = {}
        self._by_need = _by_need(task)
        spent = [(one.cost, *one.uses) for one in task.operations]
        arcs = [(variable, value, _arcs(task, variable)) for variable, value in task.goal]
        self._left = [
            [
                (variable, _left(each, value, task.sizes[variable], [one[number] for one in spent]))
                for variable, value, each in arcs
            ]
            for number in range(1 + len(task.limits))
        ]

    @property
    def graph(self) -> Graph[State, int]:
        """What is searched."""
        return Graph(self.moves, self.is_goal, self.least)

    def is_goal(self, state: State) -> bool:
        """Whether the goal holds."""
        return all(state[variable] == value for variable, value in self._task.goal)

    def moves(self, state: State) -> Sequence[Move[State, int]]:
        """Return what can be done in a state, but for what leaves it as it is."""
        if state not in self._moves:
            self._moves[state] = tuple(self._possible(state))
        return self._moves[state]

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        """Return at least what it costs, and uses, to make the goal fact that is farthest."""
        if state not in self._least:
            costs, *uses = [max((left[state[one]] for one, left in each), default=0) for each in self._left]
            self._least[state] = costs, tuple(uses)
        return self._least[state]

    def _possible(self, state: State) -> Iterator[Move[State, int]]:
        for fact in (None, *enumerate(state)):
            for operation in self._by_need.get(fact, ()):
                if all(state[variable] == value for variable, value in operation.needs):
                    after = list(state)
                    for given, variable, value in operation.effects:
                        if all(state[one] == needed for one, needed in given):
                            after[variable] = value
                    to = tuple(after)
                    if to != state:
                        yield Move(to, operation.cost, operation.uses, operation.number)


def _by_need(task: Task) -> dict[Fact | None, list[Operation]]:
    """Return the operations by the rarest fact that they need."""
    found: dict[Fact | None, list[Operation]] = {}
    for operation in task.operations:
        rarest = max(operation.needs, key=lambda fact: task.sizes[fact[0]], default=None)
        found.setdefault(rarest, []).append(operation)
    return found


def _arcs(task: Task, variable: int) -> list[tuple[int, int, int]]:
    """Return the changes of a variable, all else being left aside: from, to, and the index of the operation."""
    found = []
    for index, operation in enumerate(task.operations):
        values = {after for _, changed, after in operation.effects if changed == variable}
        if values:
            needed = [value for one, value in operation.needs if one == variable]
            found += [(one, two, index) for one in needed or range(task.sizes[variable]) for two in sorted(values)]
    return found


def _left(arcs: Sequence[tuple[int, int, int]], wanted: int, size: int, amounts: Sequence[int]) -> list[float]:
    """Return, for each value of a variable, at least what it takes to give it the one that is wanted."""
    least: dict[tuple[int, int], int] = {}
    for one, two, index in arcs:
        least[one, two] = min(amounts[index], least.get((one, two), amounts[index]))
    far = distances([(one, two, takes) for (one, two), takes in least.items()], [wanted])
    return [far.get(value, inf) for value in range(size)]
