"""A translated task that any state, goal and costs of its domain can be put into."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rosa_pddl.domain import Domain, State, Step, UpThing
from rosa_pddl.exceptions import RosaPddlError, UnsupportedPddlError
from rosa_pddl.planning.costs import Costs
from rosa_pddl.planning.sas import Axiom, Effect, Fact, Operator, SasTask
from rosa_pddl.planning.sums import Numbers, Sum
from rosa_pddl.planning.uses import Uses
from rosa_pddl.planning.writing import ADDED
from rosa_pddl.problem import Problem
from rosa_pddl.validate import literals

__all__ = ["Fitted", "Grounded", "NotRepresentableError", "Patched", "Ready", "UnreachableGoalError"]

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
class Ready:
    """An operator as a search reads it: what it needs of the frozen variables is asked before.

    Args:
        number: by which `Grounded.step` knows it.
        step: what it does.
        needs: what it needs of the frozen variables.
        prevail: what it needs of the others, and leaves so.
        effects: as those of an `Operator`, on the others.
        cost: what it costs.
        uses: what it uses up of each limited resource.
        text: as Fast Downward reads it, but for its cost.
    """

    number: int
    step: Step
    needs: tuple[Fact, ...]
    prevail: tuple[Fact, ...]
    effects: tuple[Effect, ...]
    cost: Sum
    uses: tuple[Sum, ...]
    text: str


@dataclass(frozen=True)
class Fitted:
    """A translated task with a state and a goal put in; variables that no operator changes are left out.

    Args:
        sizes: how many values each variable has.
        state: the value of each variable.
        goal: the facts that shall hold.
        ready: the operators that the left out variables allow.
        axioms: the rules that derive variables, by layer.
        layers: of each variable the layer of axioms that derives it; -1 if none does.
    """

    sizes: tuple[int, ...]
    state: tuple[int, ...]
    goal: tuple[Fact, ...]
    ready: tuple[Ready, ...]
    axioms: tuple[Axiom, ...]
    layers: tuple[int, ...]


class Grounded:
    """A translated task. Variables that no operator changes are frozen: they are not written but looked at here.

    Args:
        domain: what `load_domain` returned.
        task: what the translator wrote.
        costs: what steps cost.
        uses: what they use up.
        base: the state that was translated.
        is_patchable: whether the task was translated to fit other states than `base`.
    """

    def __init__(
        self, domain: Domain, task: SasTask, costs: Costs, uses: Uses, base: State, is_patchable: bool
    ) -> None:
        self._domain, self._task, self._costs, self._uses = domain, task, costs, uses
        self.has_axioms = task.has_axioms
        self.is_patchable = is_patchable and not task.has_axioms
        operators = [operator for operator in task.operators if not _is_added(operator)]
        written = _changing(operators) if self.is_patchable else range(len(task.variables))
        self._number = {variable: number for number, variable in enumerate(written)}
        self._sizes = tuple([len(task.variables[variable].values) for variable in written])
        # a task with axioms fits one state only, so all its variables are written, under their own numbers
        self._axioms = task.rules() if self.has_axioms and not self.is_patchable else ()
        self._layers = tuple([task.variables[variable].layer for variable in written])
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
        fitted = self.fitted(problem)
        costs = self._whole_costs([one.cost for one in fitted.ready], numbers)
        text = [self._head, "begin_state\n", *(f"{value}\n" for value in fitted.state), "end_state\nbegin_goal\n"]
        text += [f"{len(fitted.goal)}\n", *(f"{variable} {value}\n" for variable, value in fitted.goal)]
        text += ["end_goal\n", f"{len(fitted.ready)}\n"]
        text += [one.text + cost for one, cost in zip(fitted.ready, costs, strict=True)]
        text.append(self._task.axioms if self.has_axioms else "0\n")
        states = math.prod(map(float, fitted.sizes))
        return Patched("".join(text).encode(), not fitted.goal, states, self.is_conditional, self.has_axioms)

    def fitted(self, problem: Problem) -> Fitted:
        """Put the state and the goal of a problem in.

        Raises:
            NotRepresentableError: the task does not fit.
            UnreachableGoalError: a fact of the goal cannot become true.
        """
        values = self._values(problem.state) if self.is_patchable else list(self._task.initial)
        goal = self._goal(problem, values) if self.is_patchable else self._task.goal
        ready = [one for one in self._ready if all(values[variable] == value for variable, value in one.needs)]
        state = tuple([values[variable] for variable in self._number])
        inside = tuple([(self._number[variable], value) for variable, value in goal])
        return Fitted(self._sizes, state, inside, tuple(ready), self._axioms, self._layers)

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

    def _whole_costs(self, sums: Sequence[Sum], numbers: Numbers) -> list[str]:
        try:
            costs = [one.value(numbers) if one.terms else float(one.constant) for one in sums]
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

    def _operator(self, index: int, operator: Operator) -> Ready:
        head, *words = operator.name.split()
        outside, number = self._domain.outside, self._number
        step = self._domain.step(outside[head], [outside[word] for word in words])
        needs = tuple([fact for fact in operator.prevail if fact[0] not in number])
        prevail = tuple([(number[variable], value) for variable, value in operator.prevail if variable in number])
        effects = tuple(
            [
                (tuple([(number[one], value) for one, value in given]), number[variable], before, after)
                for given, variable, before, after in operator.effects
            ]
        )
        cost, uses = self._costs.of(step), self._uses.of(step)
        return Ready(index, step, needs, prevail, effects, cost, uses, _written(index, prevail, effects))


def _written(number: int, prevail: Sequence[Fact], effects: Sequence[Effect]) -> str:
    """Write an operator for Fast Downward, but for its cost."""
    kept = [f"{variable} {value}" for variable, value in prevail]
    lines = ["begin_operator", str(number), str(len(kept)), *kept, str(len(effects))]
    for given, variable, before, after in effects:
        conditions = [f"{one} {value}" for one, value in given]
        lines.append(" ".join([str(len(given)), *conditions, f"{variable} {before} {after}"]))
    return "\n".join([*lines, ""])


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
