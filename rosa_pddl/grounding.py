"""A domain translated once, in the background, such that any state, goal and numbers can be put in."""

import math
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from itertools import count, product
from typing import TypeAlias
from weakref import WeakKeyDictionary

from rosa_pddl.domain import FEASIBLE, Domain, State, Step, UpThing, head_of
from rosa_pddl.engines import fast_downward
from rosa_pddl.engines.fast_downward import Effect, Operator, SasTask
from rosa_pddl.engines.processes import Cancelled, ProcessHandle
from rosa_pddl.exceptions import RosaPddlError, UnsupportedPddlError
from rosa_pddl.outcomes import Outcome, Trouble, trouble_of
from rosa_pddl.problem import Exact, Problem, lock_of
from rosa_pddl.resource_usage import Numbers, ResourceUsage, Sum, whole
from rosa_pddl.search import Fact, Operation, Task, TaskGraph
from rosa_pddl.validate import literals

# Fast Downward adds up costs in 32 bits; this leaves room for plans of a thousand of the dearest steps.
_MOST_COST = 2_000_000
# Looking at every state is quicker than estimating while they are this few; beyond, estimates pay.
_FEW_STATES = 1e6
# In this process estimates pay earlier.
_FEWEST_STATES = 500
# Beyond this many, only the atoms of a predicate that held or were named are kept alive.
_MOST_ATOMS = 5000
_MOST_DOMAINS = 8
# unified-planning's problem of steps that follow one another, and what steps cost and use up
_INSTANTANEOUS: "WeakKeyDictionary[Domain, tuple[UpThing, ResourceUsage]]" = WeakKeyDictionary()


class NotRepresentableError(RosaPddlError):
    """A translated task does not fit this state or goal; the message says why."""


class UnreachableGoalError(RosaPddlError):
    """A fact of the goal cannot become true from any state that the translated task fits; the message names it."""


# ---------------------------------------------------------------- the translated task


@dataclass(frozen=True, eq=False)
class _Ready:
    """An operator: what it needs of the frozen variables is asked before the search; the rest is on the others."""

    number: int
    step: Step
    needs: tuple[Fact, ...]
    prevail: tuple[Fact, ...]
    effects: tuple[Effect, ...]
    cost: Sum
    uses: tuple[Sum, ...]

    @cached_property
    def operation(self) -> Operation:
        """As the exact search reads it, but for its cost and uses."""
        before = [(variable, value) for _, variable, value, _ in self.effects if value >= 0]
        effects = tuple([(given, variable, after) for given, variable, _, after in self.effects])
        return Operation(self.number, tuple(sorted({*self.prevail, *before})), effects, 0, ())

    @cached_property
    def text(self) -> str:
        """As Fast Downward reads it, but for its cost."""
        kept = [f"{variable} {value}" for variable, value in self.prevail]
        lines = ["begin_operator", str(self.number), str(len(kept)), *kept, str(len(self.effects))]
        for given, variable, before, after in self.effects:
            conditions = [f"{one} {value}" for one, value in given]
            lines.append(" ".join([str(len(given)), *conditions, f"{variable} {before} {after}"]))
        return "\n".join([*lines, ""])


SearchTask: TypeAlias = tuple[TaskGraph, Task, tuple[int, ...]]
"""What the exact search is asked: a graph, the same as a task, and what the amounts of each resource were scaled by."""


class Grounded:
    """A translated task. Variables that no operator changes are frozen: they are looked at before the search.

    It fits other states than `base`, which was translated, if it is patchable. What does not fit raises
    NotRepresentableError, a fact of the goal that cannot become true UnreachableGoalError, and an amount that has no
    value, or one that is not counted with, UnsupportedPddlError.
    """

    def __init__(self, domain: Domain, task: SasTask, usage: ResourceUsage, base: State, is_patchable: bool) -> None:
        self._domain, self._task, self._usage = domain, task, usage
        self.is_patchable = is_patchable and not task.rules
        operators = [operator for operator in task.operators if not operator.name.startswith(fast_downward.ADDED)]
        # a task with axioms fits one state only, so all its variables are written, under their own numbers
        written = _changing(operators) if self.is_patchable else range(len(task.variables))
        self._number = {variable: number for number, variable in enumerate(written)}
        self._frozen = [variable for variable in range(len(task.variables)) if variable not in self._number]
        self._sizes = tuple([len(task.variables[variable].values) for variable in written])
        self._is_conditional = any(given for operator in operators for given, *_ in operator.effects)
        self._facts = dict(_named_facts(domain, task))
        # the value that says that no other atom of the variable holds; -1 if one always does
        self._none = [
            next((value for value, text in enumerate(variable.values) if not text.startswith("Atom ")), -1)
            for variable in task.variables
        ]
        self._mutexes = [group for group in task.mutexes if len({variable for variable, _ in group}) > 1]
        self._constants = base - self._facts.keys()
        self._operators = [self._operator(index, operator) for index, operator in enumerate(operators)]
        amounts = [amount for one in self._operators for amount in (one.cost, *one.uses)]
        self._mentioned = tuple(dict.fromkeys(text for amount in amounts for _, text in amount.terms))
        self._possible = lru_cache(maxsize=64)(self._possible_with)
        self._graph = lru_cache(maxsize=4)(self._graph_of)

    @property
    def size(self) -> int:
        return len(self._operators)

    def step(self, number: int) -> Step:
        return self._operators[number].step

    def search_task(self, problem: Problem, numbers: Numbers) -> SearchTask:
        """Put the state and the goal of a problem in, and the values that its costs and limits are made of."""
        state, goal, frozen = self._fitted(problem)
        mentioned = tuple([numbers.get(text) for text in self._mentioned])
        weights = frozenset(problem.weights.items())
        graph, task, scales = self._graph(frozen, goal, mentioned, state if self._task.rules else (), weights)
        left = self._usage.remaining(numbers)
        limits = tuple([one.whole(scale) for one, scale in zip(left, scales, strict=True)])
        return graph, Task(task.sizes, state, goal, task.operations, limits, task.rules), scales

    def written(self, problem: Problem, numbers: Numbers) -> tuple[str, str, Mapping[int, Exact]] | None:
        """Write the task for Fast Downward, and how to search it optimally; None if the goal holds already.

        Last comes what each step costs more than was written, where costs had to be rounded down.
        """
        state, goal, frozen = self._fitted(problem)
        ready = self._weighed(frozen, frozenset(problem.weights.items()))
        costs, rounded_off = self._whole_costs([one.cost for one in ready], numbers)
        if not goal:
            return None
        text = [self._head, "begin_state\n", *(f"{value}\n" for value in state), "end_state\nbegin_goal\n"]
        text += [f"{len(goal)}\n", *(f"{variable} {value}\n" for variable, value in goal)]
        text += ["end_goal\n", f"{len(ready)}\n"]
        text += [f"{one.text}{cost}\nend_operator\n" for one, cost in zip(ready, costs, strict=True)]
        text.append(self._task.axioms)
        is_blind = math.prod(map(float, self._sizes)) <= _FEW_STATES or self._is_conditional or self._task.rules
        lost = {one.number: amount for one, amount in zip(ready, rounded_off, strict=True) if amount}
        return "".join(text), "blind" if is_blind else "lmcut", lost

    def _graph_of(
        self,
        frozen: tuple[int, ...],
        goal: tuple[Fact, ...],
        mentioned: Sequence[Exact | None],
        start: tuple[int, ...],
        weights: frozenset[tuple[Step, int]],
    ) -> SearchTask:
        """Return a task without its start (but for axioms) and limits; what its graph has worked out is kept."""
        numbers = {text: value for text, value in zip(self._mentioned, mentioned, strict=True) if value is not None}
        ready = self._weighed(frozen, weights)
        amounts = [self._values_of([one.cost for one in ready], "costs", numbers)]
        for index, resource in enumerate(self._domain.limited):
            uses = [one.uses[index] for one in ready]
            amounts.append(self._values_of(uses, f"uses of {resource.name}", numbers))
        columns, (_, *scales) = zip(*map(whole, amounts), strict=True)
        operations = [
            Operation(one.number, one.operation.needs, one.operation.effects, cost, tuple(more))
            for one, (cost, *more) in zip(ready, zip(*columns, strict=True), strict=True)
        ]
        task = Task(self._sizes, start, goal, tuple(operations), (0,) * len(scales), self._task.rules)
        is_guided = math.prod(map(float, self._sizes)) > _FEWEST_STATES
        return TaskGraph(task, is_guided=is_guided), task, tuple(scales)

    def _values_of(self, sums: Sequence[Sum], what: str, numbers: Numbers) -> list[Exact]:
        amounts = [self._usage.value(one, numbers) if one.terms else one.constant for one in sums]
        least = min(amounts, default=0)
        if least < 0:
            terms = " + ".join(text for _, text in sums[amounts.index(least)].terms)
            message = f"{terms} comes to {float(least):g}; {what} are 0 or more"
            raise UnsupportedPddlError(message, self._domain.problem_file)
        return amounts

    def _possible_with(self, frozen: tuple[int, ...]) -> tuple[_Ready, ...]:
        values = dict(zip(self._frozen, frozen, strict=True))
        return tuple([one for one in self._operators if all(values[fact[0]] == fact[1] for fact in one.needs)])

    def _weighed(self, frozen: tuple[int, ...], weights: frozenset[tuple[Step, int]]) -> tuple[_Ready, ...]:
        possible, times = self._possible(frozen), dict(weights)
        if not times:
            return possible
        left = [one for one in possible if times.get(one.step, 1)]
        return tuple([replace(one, cost=one.cost.times(times[one.step])) if one.step in times else one for one in left])

    def _fitted(self, problem: Problem) -> tuple[tuple[int, ...], tuple[Fact, ...], tuple[int, ...]]:
        """Put a state and a goal in: the value of each variable, what shall hold, the values of frozen variables."""
        values = self._values(problem.state) if self.is_patchable else list(self._task.initial)
        goal = self._goal(problem, values) if self.is_patchable else self._task.goal
        state = tuple([values[variable] for variable in self._number])
        inside = tuple([(self._number[variable], value) for variable, value in goal])
        return state, inside, tuple([values[variable] for variable in self._frozen])

    def _values(self, state: State) -> list[int]:
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
            if sum([values[variable] == value for variable, value in group]) > 1:
                names = ", ".join(self._task.variables[variable].values[value] for variable, value in group)
                raise NotRepresentableError(f"several of {names} hold, which were found to exclude one another")
        return values

    def _goal(self, problem: Problem, values: Sequence[int]) -> list[Fact]:
        goal: dict[int, int] = {}
        for atom, wanted in self._literals(problem.wanted):
            text = atom if wanted else f"(not {atom})"
            if atom not in self._facts:
                if (atom in self._constants) != wanted:
                    raise UnreachableGoalError(f"nothing that can be done makes {text} so")
                continue
            variable, value = self._facts[atom]
            if not wanted:
                if len(self._task.variables[variable].values) != 2:
                    raise NotRepresentableError(f"the goal {text} leaves several ways open")
                value = 1 - value
            if goal.setdefault(variable, value) != value:
                raise UnreachableGoalError(f"{text} excludes another fact of the goal")
            if variable not in self._number and values[variable] != value:
                raise UnreachableGoalError(f"nothing that can be done makes {text} so")
        return [(variable, value) for variable, value in sorted(goal.items()) if variable in self._number]

    def _literals(self, goals: Iterable[UpThing]) -> Iterator[tuple[str, bool]]:
        for goal in goals:
            found = literals(self._domain, goal)
            if found is None:
                raise NotRepresentableError(f"the goal {goal} leaves several ways open")
            yield from found

    def _whole_costs(self, sums: Sequence[Sum], numbers: Numbers) -> tuple[list[int], list[Exact]]:
        """Return costs as whole numbers for Fast Downward, and what is lost if they must be rounded down for that."""
        costs = self._values_of(sums, "costs", numbers)
        written, _ = whole(costs)
        if max(written, default=0) <= _MOST_COST:
            return written, [0] * len(costs)
        scale = Fraction(_MOST_COST) / max(costs)
        written = [math.floor(cost * scale) for cost in costs]
        return written, [cost - one / scale for cost, one in zip(costs, written, strict=True)]

    @cached_property
    def _head(self) -> str:
        # unit costs are written as costs of 1
        lines = ["begin_version", "3", "end_version", "begin_metric", "1", "end_metric", str(len(self._number))]
        for variable, number in self._number.items():
            known = self._task.variables[variable]
            lines += ["begin_variable", f"var{number}", str(known.layer), str(len(known.values))]
            lines += [*known.values, "end_variable"]
        return "\n".join([*lines, "0", ""])

    def _operator(self, index: int, operator: Operator) -> _Ready:
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
        return _Ready(index, step, needs, prevail, effects, self._usage.cost_of(step), self._usage.uses_of(step))


def _changing(operators: Iterable[Operator]) -> list[int]:
    """Return the variables that an operator changes, or that it looks at to see what to change."""
    effects = [effect for operator in operators for effect in operator.effects]
    looked_at = {variable for conditions, *_ in effects for variable, _ in conditions}
    return sorted({variable for _, variable, _, _ in effects} | looked_at)


def _named_facts(domain: Domain, task: SasTask) -> Iterable[tuple[str, Fact]]:
    for number, variable in enumerate(task.variables):
        for value, text in enumerate(variable.values):
            if text.startswith("Atom "):
                head, _, arguments = text.removeprefix("Atom ").removesuffix(")").partition("(")
                words = [head, *(word.strip() for word in arguments.split(",") if word.strip())]
                if all(word in domain.outside for word in words):
                    yield f"({' '.join(domain.outside[word] for word in words)})", (number, value)


# ---------------------------------------------------------------- translation

Grounding: TypeAlias = Future[Grounded | Trouble]
"""The translated task, or why there is none: a value, as an exception that many raise would keep their frames."""


def _instantaneous(domain: Domain) -> tuple[UpThing, ResourceUsage]:
    with lock_of(domain):
        if domain not in _INSTANTANEOUS:
            _INSTANTANEOUS[domain] = Problem(domain, frozenset()).build(), ResourceUsage(domain)
        return _INSTANTANEOUS[domain]


def usage_of(domain: Domain) -> ResourceUsage:
    """Return what steps cost and use up; UnsupportedPddlError says that they cannot follow one another."""
    return _instantaneous(domain)[1]


def translated(
    problem: Problem, alive: Mapping[str, tuple[str, ...]] | None, process: ProcessHandle, limit_s: float
) -> Grounded:
    """Translate a problem, starting from its state, in so much wall-clock time [s].

    Atoms are kept alive by the predicate in the names of unified-planning; None is for this problem only. Raises
    UnsupportedPddlError for what the translator does not read, else as `translate`.
    """
    domain = problem.domain
    up_problem, usage = _instantaneous(domain)
    kept = [atom for atoms in (alive or {}).values() for atom in atoms]
    task = fast_downward.translate(
        fast_downward.written_domain(up_problem, alive),
        fast_downward.written_problem(problem, problem.wanted if alive is None else None, kept),
        process,
        limit_s=limit_s,
        for_any_state=alive is not None,
    )
    return Grounded(domain, task, usage, problem.state, is_patchable=alive is not None)


@dataclass(frozen=True)
class _Begun:
    base: Problem
    changing: frozenset[str]
    tries: int = 1
    future: Grounding = field(default_factory=Future)
    asked: Iterator[int] = field(default_factory=partial(count, 1))

    @property
    def is_worth_another_try(self) -> bool:
        """Whether it failed for what may pass; then it is made again after 2, 4, 8, ... questions."""
        made = self.future.result(0) if self.future.done() else None
        is_passing = isinstance(made, Trouble) and made.outcome.is_passing
        return is_passing and next(self.asked) >= 2**self.tries


class Groundings:
    """The translated task of each domain, made in a thread of its own when first asked for.

    Which atoms are kept alive depends on what was asked for and named so far, never on how long anything takes. What
    the translator finds reachable from the first state is alive anyway. Atoms of predicates that the actions only make
    true, only make false, or that say what is feasible are kept alive by themselves; atoms of predicates that no action
    changes are so once they were named, or were found to have changed.
    """

    def __init__(self, limit_s: float, memory_bytes: int | None) -> None:
        self._limit_s = limit_s
        self._memory_bytes = memory_bytes
        self._begun: dict[Domain, _Begun] = {}
        self._processes: set[ProcessHandle] = set()

    def ask(self, problem: Problem, changing: Iterable[str] = ()) -> Grounding:
        """Begin to translate if that is needed, without waiting; atoms that are sensed, for one, may be changing."""
        begun, named = self._begun.get(problem.domain), frozenset(changing)
        if begun is not None:
            named |= _untouched(problem.domain, (problem.state ^ begun.base.state) - begun.changing)
            is_again = begun.is_worth_another_try
            if named <= begun.changing and not is_again:
                return begun.future
            named |= begun.changing
            problem = begun.base
        tries = begun.tries + 1 if begun is not None and is_again else 1
        self._begun.pop(problem.domain, None)
        begun = self._begun[problem.domain] = _Begun(problem, named, tries)
        if len(self._begun) > _MOST_DOMAINS:
            del self._begun[next(iter(self._begun))]
        name = f"translator of {problem.domain.name}"
        threading.Thread(target=self._work, args=(begun,), name=name, daemon=True).start()
        return begun.future

    def close(self) -> None:
        """Stop what is being translated, and forget the rest."""
        self._begun.clear()
        for process in tuple(self._processes):
            process.cancel()

    def _work(self, begun: _Begun) -> None:
        process = ProcessHandle(self._memory_bytes)
        self._processes.add(process)
        try:
            alive = _alive(begun.base, begun.changing)
            begun.future.set_result(translated(begun.base, alive, process, self._limit_s))
        except Cancelled:
            begun.future.set_result(Trouble(Outcome.ENGINE_CRASHED, "the planner was closed"))
        except Exception as error:  # whatever it is, it belongs to those who wait for the task
            begun.future.set_result(trouble_of(error))
        finally:
            self._processes.discard(process)


def _untouched(domain: Domain, atoms: frozenset[str]) -> frozenset[str]:
    """Return the atoms of predicates that no action changes."""
    if not atoms:
        return atoms  # quickly, as every planning asks
    added, deleted = _directions(domain)
    touched = {domain.outside[name] for name in added | deleted}
    return frozenset(atom for atom in atoms if head_of(atom) not in touched)


def _alive(problem: Problem, changing: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the atoms to keep alive, by predicate."""
    domain = problem.domain
    added, deleted = _directions(domain)
    alive: dict[str, set[str]] = {}
    for fluent in domain.up_problem.fluents:
        is_one_way = (fluent.name in added) != (fluent.name in deleted)
        if fluent.type.is_bool_type() and (domain.outside[fluent.name].lower() == FEASIBLE or is_one_way):
            alive[fluent.name] = set(_instances(problem, fluent))
    for atom in changing:
        name = domain.inside["predicate", head_of(atom).lower()]
        if not (name in added and name in deleted):
            alive.setdefault(name, set()).add(atom)
    return {name: tuple(sorted(atoms)) for name, atoms in alive.items()}


def _directions(domain: Domain) -> tuple[set[str], set[str]]:
    """Return the predicates that actions make true, and those that they make false."""
    effects = [one for schema in domain.schema_of.values() for one in schema.start_effects + schema.end_effects]
    added = {one.fluent.fluent().name for one in effects if not one.value.is_false()}
    return added, {one.fluent.fluent().name for one in effects if not one.value.is_true()}


def _instances(problem: Problem, fluent: UpThing) -> Iterator[str]:
    domain = problem.domain
    head = domain.outside[fluent.name]
    choices = [domain.objects_of(domain.outside[parameter.type.name]) for parameter in fluent.signature]
    if math.prod(map(len, choices)) > _MOST_ATOMS:
        yield from (atom for atom in problem.state if head_of(atom) == head)
        return
    yield from (f"({' '.join((head, *words))})" for words in product(*choices))
