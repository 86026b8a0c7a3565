"""A translated task that any state, goal and costs of its domain can be put into."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rosa_pddl.domain import Domain, State, Step, UpThing
from rosa_pddl.exceptions import RosaPddlError, UnsupportedPddlError
from rosa_pddl.planning.costs import Costs, CostSum, Numbers
from rosa_pddl.planning.sas import Fact, Operator, SasTask
from rosa_pddl.planning.writing import ADDED
from rosa_pddl.problem import Problem
from rosa_pddl.validate import literals

__all__ = ["Grounded", "NotRepresentableError", "Patched", "UnreachableGoalError"]

# Fast Downward adds up costs in 32 bits; this leaves room for plans of a thousand of the dearest steps.
_MOST_COST = 2_000_000
# Costs that are no whole numbers are told in thousandths, as Fast Downward knows whole numbers only.
_FINENESS = 1000


class NotRepresentableError(RosaPddlError):
    """A translated task does not fit this state or goal; the message says why."""


class UnreachableGoalError(RosaPddlError):
    """A fact of the goal cannot become true from any state that the translated task fits; the message names it."""


@dataclass(frozen=True)
class Patched:
    """What the search reads.

    Args:
        text: the task.
        is_done: whether the goal holds already, so that there is nothing to search.
        states: how many states there are at most.
        is_conditional: whether an operator has conditional effects.
        has_axioms: whether anything is derived by axioms.
    """

    text: bytes
    is_done: bool
    states: float
    is_conditional: bool
    has_axioms: bool = False


@dataclass(frozen=True)
class _Ready:
    """An operator as the search reads it, but for its cost: what it needs of the frozen variables is asked before."""

    step: Step
    needs: tuple[Fact, ...]
    text: str
    cost: CostSum


class Grounded:
    """A translated task. Variables that no operator changes are frozen: they are not written but looked at here.

    Args:
        domain: what `load_domain` returned.
        task: what the translator wrote.
        costs: what steps cost.
        base: the state that was translated.
        is_patchable: whether the task was translated to fit other states than `base`.
    """

    def __init__(self, domain: Domain, task: SasTask, costs: Costs, base: State, is_patchable: bool) -> None:
        self._domain, self._task, self._costs = domain, task, costs
        self.is_patchable = is_patchable and not task.has_axioms
        operators = [operator for operator in task.operators if not _is_added(operator)]
        written = _changing(operators) if self.is_patchable else range(len(task.variables))
        self._number = {variable: number for number, variable in enumerate(written)}
        self._sizes = [len(task.variables[variable].values) for variable in written]
        self.is_conditional = any(given for operator in operators for given, *_ in operator.effects)
        self._facts = dict(_named_facts(domain, task))
        self._none = [_none_of(variable.values) for variable in task.variables]
        self._mutexes = [group for group in task.mutexes if len({variable for variable, _ in group}) > 1]
        self._constants = base - self._facts.keys()
        self._head = self._written_head(written)
        self._ready = [self._operator(index, operator) for index, operator in enumerate(operators)]

    def step(self, number: int) -> Step:
        """Return the step of a number that the search names."""
        return self._ready[number].step

    def patched(self, problem: Problem, numbers: Numbers) -> Patched:
        """Write the task with the state and the goal of a problem, and the values that its costs are made of.

        Raises:
            NotRepresentableError: the task does not fit.
            UnreachableGoalError: a fact of the goal cannot become true.
            UnsupportedPddlError: a cost has no value, or one that Fast Downward cannot be told.
        """
        task = self._task
        values = self._values(problem.state) if self.is_patchable else list(task.initial)
        goal = self._goal(problem, values) if self.is_patchable else task.goal
        ready = [one for one in self._ready if all(values[variable] == value for variable, value in one.needs)]
        costs = self._whole_costs([one.cost for one in ready], numbers)
        state = "\n".join([str(values[variable]) for variable in self._number])
        text = [self._head, "begin_state\n", state, "\nend_state\nbegin_goal\n", str(len(goal)), "\n"]
        text += [f"{self._number[variable]} {value}\n" for variable, value in goal]
        text += ["end_goal\n", str(len(ready)), "\n"]
        text += [one.text + cost for one, cost in zip(ready, costs, strict=True)]
        text.append(task.axioms if not self.is_patchable else "0\n")
        states = math.prod(map(float, self._sizes))
        return Patched("".join(text).encode(), not goal, states, self.is_conditional, task.has_axioms)

    def _values(self, state: State) -> list[int]:
        """Return the value of each variable in a state."""
        constants = state - self._facts.keys()
        if constants != self._constants:
            odd = min(constants ^ self._constants)
            was = "true for good" if odd in self._constants else "out of reach"
            raise NotRepresentableError(f"{odd} was found to be {was}")
        values = [-1] * len(self._none)
        for atom in state - constants:
            variable, value = self._facts[atom]
            if values[variable] >= 0:
                raise NotRepresentableError(f"{atom} holds together with another fact that was found to exclude it")
            values[variable] = value
        for variable, value in enumerate(values):
            if value < 0:
                values[variable] = self._none[variable]
                if values[variable] < 0:
                    raise NotRepresentableError(f"none of {', '.join(self._task.variables[variable].values)} holds")
        for group in self._mutexes:
            if sum(values[variable] == value for variable, value in group) > 1:
                names = ", ".join(self._task.variables[variable].values[value] for variable, value in group)
                raise NotRepresentableError(f"several of {names} hold, which were found to exclude one another")
        return values

    def _goal(self, problem: Problem, values: Sequence[int]) -> list[Fact]:
        goal: dict[int, int] = {}
        for atom, wanted in _literals(self._domain, problem.wanted):
            if atom not in self._facts:
                if (atom in self._constants) != wanted:
                    raise UnreachableGoalError(f"nothing that can be done makes {_literal(atom, wanted)} so")
                continue
            variable, value = self._facts[atom]
            if not wanted:
                if self._sizes_of(variable) != 2:
                    raise NotRepresentableError(f"the goal {_literal(atom, wanted)} leaves several ways open")
                value = 1 - value
            if goal.setdefault(variable, value) != value:
                raise UnreachableGoalError(f"{_literal(atom, wanted)} excludes another fact of the goal")
            if variable not in self._number and values[variable] != value:
                raise UnreachableGoalError(f"nothing that can be done makes {_literal(atom, wanted)} so")
        return [(variable, value) for variable, value in sorted(goal.items()) if variable in self._number]

    def _sizes_of(self, variable: int) -> int:
        return len(self._task.variables[variable].values)

    def _whole_costs(self, sums: Sequence[CostSum], numbers: Numbers) -> list[str]:
        try:
            costs = [one.value(numbers) if one.terms else one.constant for one in sums]
        except KeyError as error:
            raise self._costs.missing(error, numbers) from error
        if min(costs, default=0.0) < 0.0 or not math.isfinite(sum(costs)):
            worst = next(cost for cost in costs if not 0.0 <= cost < math.inf)
            raise UnsupportedPddlError(f"a step costs {worst:g}; costs are 0 or more", self._domain.problem_file)
        if not all(cost.is_integer() for cost in costs):
            costs = [round(cost * _FINENESS) for cost in costs]
        if max(costs, default=0.0) > _MOST_COST:
            message = f"a step costs {max(costs):g} (in thousandths if not all are whole), more than {_MOST_COST:g}"
            raise UnsupportedPddlError(f"{message}, which Fast Downward adds up wrongly", self._domain.problem_file)
        return [f"{cost:.0f}\nend_operator\n" for cost in costs]

    def _written_head(self, written: Iterable[int]) -> str:
        # unit costs are told as costs of 1
        lines = ["begin_version", "3", "end_version", "begin_metric", "1", "end_metric", str(len(self._number))]
        for variable in written:
            told = self._task.variables[variable]
            lines += ["begin_variable", f"var{self._number[variable]}", str(told.layer), str(len(told.values))]
            lines += [*told.values, "end_variable"]
        return "\n".join([*lines, "0", ""])

    def _operator(self, index: int, operator: Operator) -> _Ready:
        head, *words = operator.name.split()
        outside, number = self._domain.outside, self._number
        step = self._domain.step(outside[head], [outside[word] for word in words])
        kept = [f"{number[variable]} {value}" for variable, value in operator.prevail if variable in number]
        lines = ["begin_operator", str(index), str(len(kept)), *kept, str(len(operator.effects))]
        for given, variable, before, after in operator.effects:
            conditions = [f"{number[one]} {value}" for one, value in given]
            lines.append(" ".join([str(len(given)), *conditions, f"{number[variable]} {before} {after}"]))
        needs = tuple(fact for fact in operator.prevail if fact[0] not in number)
        return _Ready(step, needs, "\n".join([*lines, ""]), self._costs.of(step))


def _is_added(operator: Operator) -> bool:
    return operator.name.startswith(ADDED)


def _changing(operators: Iterable[Operator]) -> list[int]:
    """Return the variables that an operator changes, or that it looks at to see what to change."""
    found: set[int] = set()
    for operator in operators:
        for conditions, variable, _, _ in operator.effects:
            found.add(variable)
            found.update(one for one, _ in conditions)
    return sorted(found)


def _named_facts(domain: Domain, task: SasTask) -> Iterable[tuple[str, Fact]]:
    for number, variable in enumerate(task.variables):
        for value, text in enumerate(variable.values):
            if text.startswith("Atom "):
                head, _, arguments = text.removeprefix("Atom ").removesuffix(")").partition("(")
                words = [head, *(word.strip() for word in arguments.split(",") if word.strip())]
                if all(word in domain.outside for word in words):
                    yield f"({' '.join(domain.outside[word] for word in words)})", (number, value)


def _none_of(values: Sequence[str]) -> int:
    """Return the value that says that no other atom of the variable holds; -1 if one always does."""
    for value, text in enumerate(values):
        if not text.startswith("Atom "):
            return value
    return -1


def _literals(domain: Domain, goals: Iterable[UpThing]) -> Iterable[tuple[str, bool]]:
    """Return the atoms that a conjunction asks for, and whether they shall be true.

    Raises:
        NotRepresentableError: it is no conjunction.
    """
    for goal in goals:
        found = literals(domain, goal)
        if found is None:
            raise NotRepresentableError(f"the goal {goal} leaves several ways open")
        yield from found


def _literal(atom: str, wanted: bool) -> str:
    return atom if wanted else f"(not {atom})"
