"""The exact search over the states of a translated task: least cost, within limits of what its operators use up."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from math import inf
from typing import NamedTuple, TypeAlias

from rosa_pddl.planning.labels import Found, Graph, Move, cheapest, distances

__all__ = ["Operation", "Rule", "SasGraph", "Task", "found_in", "least_uses"]

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


class Rule(NamedTuple):
    """An axiom: it derives the value of a variable that has its value of the start otherwise.

    Attributes:
        layer: rules of a lower one come first.
        needs: what must hold.
        variable: what is derived.
        value: what it becomes.
    """

    layer: int
    needs: tuple[Fact, ...]
    variable: int
    value: int


class Task(NamedTuple):
    """What is searched; all numbers are whole.

    Attributes:
        sizes: how many values each variable has.
        start: the value of each variable.
        goal: the facts that shall hold.
        operations: what can be done.
        limits: at most how much of each resource may be used up from here on.
        rules: by layer.
    """

    sizes: tuple[int, ...]
    start: State
    goal: tuple[Fact, ...]
    operations: tuple[Operation, ...]
    limits: tuple[int, ...]
    rules: tuple[Rule, ...] = ()


def found_in(task: Task) -> Found[State, int] | None:
    """Return a plan of least cost within the limits, its moves named by operators; None proves that there is none."""
    if any(limit < 0 for limit in task.limits):
        return None
    graph = SasGraph(task)
    return cheapest(graph.graph, graph.start, task.limits)


def least_uses(task: Task) -> tuple[float, ...]:
    """Return how much of each resource it takes at least to reach the goal; infinite if that is out of reach."""
    graph = SasGraph(task)
    return graph.least(graph.start)[1]


class SasGraph:
    """A task as a graph.

    Args:
        task: what is searched.

    Attributes:
        start: the state to start from, with what is derived.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._moves: dict[State, tuple[Move[State, int], ...]] = {}
        self._least: dict[State, tuple[float, tuple[float, ...]]] = {}
        self._by_need = _by_need(task)
        self._layers = [list(rules) for _, rules in groupby(task.rules, key=lambda rule: rule.layer)]
        self._derived = {rule.variable: task.start[rule.variable] for rule in task.rules}
        self.start = self._closed(list(task.start))
        spent = [(one.cost, *one.uses) for one in task.operations]
        # what axioms derive is left out, as no operator shows what that takes
        goal = [(variable, value) for variable, value in task.goal if variable not in self._derived]
        arcs = [(variable, value, _arcs(task, variable)) for variable, value in goal]
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
        return _hold(self._task.goal, state)

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
                if _hold(operation.needs, state):
                    after = list(state)
                    for given, variable, value in operation.effects:
                        if _hold(given, state):
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
