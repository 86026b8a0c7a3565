"""A domain instantiated once, such that any state, goal and numbers can be put in."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from operator import mul
from threading import Lock
from typing import Any, TypeAlias

from rosa_pddl.domain import Domain, Exact, State, Step, UpThing, exact, head_of, numbers_in
from rosa_pddl.engines.processes import ProcessHandle
from rosa_pddl.exceptions import RosaPddlError, UnsupportedPddlError
from rosa_pddl.instances import (
    ActionPattern,
    Node,
    Row,
    Swap,
    axioms_of,
    bound,
    bound_number,
    compiled,
    conjuncts_of,
    groups,
    joined,
    numeric_facts,
    patterns_of,
    reach,
    row_of,
    text_of_row,
)
from rosa_pddl.outcomes import Outcome, Trouble
from rosa_pddl.problem import Problem, lock_of
from rosa_pddl.resource_usage import Numbers, usage_of, whole
from rosa_pddl.search import Change, Fact, Number, Operation, Rule, Task, TaskGraph, Test

# Fast Downward adds up costs in 32 bits; this leaves room for plans of a thousand of the dearest steps.
_MOST_COST = 2_000_000
# Looking at every state is quicker than estimating while they are this few; beyond, estimates pay.
_FEW_STATES = 1e6
# In this process estimates pay earlier.
_FEWEST_STATES = 500
_MOST_INSTANCES = 1_000_000
_RULES_FOR_A_MOVE = 20
_MOST_DOMAINS, _MOST_STATES = 8, 8
_TRUTHS = ("add", "delete")
_FOR_EVER: Any = math.inf  # no exact number, but it is compared with them
_LOOKS_S = 0.05


class NotRepresentableError(RosaPddlError):
    """A task does not fit an engine; the message says why."""


class UnreachableGoalError(RosaPddlError):
    """A fact of the goal cannot become true from any state that the task fits; the message names it."""


@dataclass(frozen=True, eq=False)
class _Ready:
    """An operator, or a rule of a layer: what it needs of facts that nothing changes is asked before the search."""

    number: int
    step: Step
    needed: frozenset[str]
    lasting: frozenset[str]
    missing: frozenset[str]
    operation: Operation
    layer: int
    cost: Number = 0
    uses: tuple[Number, ...] = ()

    @cached_property
    def text(self) -> str:
        """As Fast Downward reads it, but for its cost."""
        kept = [f"{variable} {value}" for variable, value in self.operation.needs]
        effects = self.operation.effects
        lines = ["begin_operator", str(self.number), str(len(kept)), *kept, str(len(effects))]
        for given, variable, after in effects:
            conditions = [f"{one} {value}" for one, value in given]
            lines.append(" ".join([str(len(given)), *conditions, f"{variable} -1 {after}"]))
        return "\n".join([*lines, ""])


@dataclass(frozen=True)
class _Fitted:
    """A state and a goal put in: values, what shall hold, what of it is derived, and the facts that nothing changes."""

    state: tuple[int, ...]
    goal: tuple[Fact, ...]
    tests: tuple[Test, ...]
    rules: tuple[Rule, ...]
    frozen: State


class _Variables:
    """Which variable, and which of its values, says that an atom holds; the last value says that none does.

    The variables of derived atoms have layers.
    """

    def __init__(self) -> None:
        self.sizes: list[int] = []
        self.places: dict[str, Fact] = {}
        self.layers: dict[int, int] = {}

    def add(self, atoms: Sequence[str]) -> None:
        self.places.update({atom: (len(self.sizes), value) for value, atom in enumerate(atoms)})
        self.sizes.append(len(atoms) + 1)

    def fact(self, atom: str, truth: bool) -> Fact | None:
        """Return the fact that an atom holds, or does not; None if several values say so."""
        variable, value = self.places[atom]
        return (variable, value) if truth else (variable, 1) if self.sizes[variable] == 2 else None


class _Rules:
    """Makes facts of conditions: what is no conjunction is derived by rules, numbers are compared."""

    def __init__(self, variables: _Variables, first: int, number: Callable[[object], Number]) -> None:
        self._variables, self._next, self._number = variables, first, number
        self._known: dict[Node, tuple[int, int]] = {}
        self.rules: list[Rule] = []

    @property
    def derived(self) -> int:
        return len(self._known)

    def taken(self, node: Node) -> tuple[list[Fact], list[Test]]:
        """Return the facts and the comparisons that a condition, which is not plainly false, asks for."""
        facts, tests = list[Fact](), list[Test]()
        for part in conjuncts_of(node):
            if part[0] == "atom":
                fact = self._variables.fact(part[2], part[1])
                facts.append(fact or (self._derived(part)[0], 0))
            elif part[0] == "or":
                facts.append((self._derived(part)[0], 0))
            else:
                kind, one, other = part
                tests.append((str(kind), self._number(one), self._number(other)))
        return facts, tests

    def _derived(self, node: tuple[Any, ...]) -> tuple[int, int]:
        """Return the variable that is 0 if a disjunction holds, or an atom that several values deny; and its layer."""
        if node not in self._known:
            ways: list[tuple[list[Fact], list[Test]]]
            if node[0] == "atom":
                variable, value = self._variables.places[str(node[2])]
                others = (other for other in range(self._variables.sizes[variable]) if other != value)
                ways = [([(variable, other)], []) for other in others]
            else:
                ways = [self.taken(part) for part in node[1:]]
            layers = {**self._variables.layers, **dict(self._known.values())}
            # what holds because something is not derived comes after that
            layer = max((layers[one] + value for facts, _ in ways for one, value in facts if one in layers), default=0)
            self._known[node] = self._next, layer
            self.rules += [Rule(layer, tuple(facts), self._next, tuple(tests)) for facts, tests in ways]
            self._next += 1
        return self._known[node]


class Grounded:
    """A grounded task. Facts that no operator changes are frozen: they are looked at before the search.

    It fits all states whose atoms are within reach of the base, and that break none of the exclusions that were found;
    `covers` says so. A fact of the goal that cannot become true raises UnreachableGoalError, an amount that has no
    value, or one that is not counted with, UnsupportedPddlError.

    Args:
        base: atoms that may hold at first; those of all states that it has to fit, of which some are given.
        go_on: called every now and then; what it raises ends the making.
    """

    def __init__(self, domain: Domain, base: State, states: Sequence[State], go_on: Callable[[int], None]) -> None:
        self.domain, self.base, self.states = domain, base, tuple(states)
        self._usage, patterns = usage_of(domain), _instantaneous(domain)
        rows, found = reach(patterns, [row_of(atom) for atom in sorted(base)], go_on)
        self._asked = frozenset(name for pattern in patterns for name in _names(pattern))
        self._possible = frozenset(text_of_row(name, row) for name, known in rows.items() for row in known)
        instances = [
            one for pattern, each in zip(patterns, found, strict=True) for one in self._instances(pattern, each)
        ]
        self._numbers = {
            text: -1 - k
            for k, text in enumerate(
                dict.fromkeys(one[2] for instance in instances for one in instance.effects if one[1] not in _TRUTHS)
            )
        }
        self._variables = self._encoded(instances)
        self._known, self._constants = numbers_in(self.states[-1]), dict[str, Exact | None]()
        self._rules = _Rules(self._variables, len(self._variables.sizes), self._number)
        ready = [self._operator(number, one) for number, one in enumerate(instances)]  # rules come last
        self._operators, self._axioms = ([one for one in ready if bool(one.layer) is axiom] for axiom in (False, True))
        self._all_sizes = (*self._variables.sizes, *[2] * self._rules.derived)
        self._frozen_atoms = self._possible - self._variables.places.keys()
        self._is_conditional = any(given for one in self._operators for given, *_ in one.operation.effects)
        amounts = [amount for one in self._operators for amount in (one.cost, *one.uses)]
        self._mentioned = tuple(dict.fromkeys(text for amount in amounts for text in numeric_facts(amount)))
        self._ready = lru_cache(maxsize=64)(self._ready_with)
        self._graph = lru_cache(maxsize=4)(self._graph_of)
        self._wanted = lru_cache(maxsize=64)(self._compiled_goal)

    @property
    def size(self) -> int:
        return len(self._operators)

    @property
    def work(self) -> int:
        """How many times the work of other tasks a move takes, as atoms are derived in each state."""
        return 1 + len(self._axioms) // _RULES_FOR_A_MOVE

    def step(self, number: int) -> Step:
        return self._operators[number].step

    def covers(self, state: State) -> bool:
        strange = (atom for atom in state - self._possible if head_of(atom) in self._asked)
        if next(strange, None) is not None or self._values(state) is None:
            return False
        known = numbers_in(state) if self._constants else {}
        return all(known.get(text) == value for text, value in self._constants.items())

    def search_task(self, problem: Problem, numbers: Numbers) -> tuple[TaskGraph, Task]:
        """Put the state and the goal of a problem in, and the values that its costs and limits are made of."""
        fitted = self._fitted(problem)
        mentioned = tuple([self._usage.known(text, numbers) if text in numbers else None for text in self._mentioned])
        graph, task, scales = self._graph(replace(fitted, state=()), mentioned, frozenset(problem.weights.items()))
        left = self._usage.remaining(numbers)
        limits = tuple([one.whole(scale) for one, scale in zip(left, scales, strict=True)])
        task = Task(task.sizes, fitted.state, task.goal, task.operations, limits, *task[5:])
        if problem.until:
            task = self._timed(task, problem, numbers)
            graph = TaskGraph(task)
        return graph, task

    def _timed(self, task: Task, problem: Problem, numbers: Numbers) -> Task:
        """Return a task with how much longer facts hold, as numbers that fall with each step that takes time.

        Another is 1 until the first step: what is done of a step that runs counts for a plan that begins with it.
        """
        steps, first = [self.step(one.number) for one in task.operations], -1 - task.numbers
        if any(not self._numbers.keys().isdisjoint(numeric_facts(self._usage.duration_of(one))) for one in steps):
            raise NotRepresentableError("how long steps take changes, which is not planned with what is forecast")
        takes = [self._usage.takes_s(step, numbers) for step in steps]
        shares = [1 - exact(problem.shares[step]) if step in problem.shares else 0 for step in steps]
        saved = map(mul, takes, shares)
        times, _ = whole([*takes, *saved, *map(exact, problem.until.values())])
        pairs, left = zip(times, times[len(steps) :], strict=False), [1, *times[2 * len(steps) :]]
        places = {atom: first - number for number, atom in enumerate(problem.until, 1)}
        made_by = {self._variables.places.get(atom): place for atom, place in places.items()}
        operations = list[Operation]()
        for one, (whole_s, done_s) in zip(task.operations, pairs, strict=False):
            takes_s: Number = ("-", whole_s, ("*", done_s, ("n", first))) if done_s else whole_s
            tests = [
                ("<=", takes_s, ("n", places[atom])) for atom in places if atom in self._operators[one.number].needed
            ]
            changes = [Change((), (), place, True, ("-", 0, takes_s)) for place in places.values()]
            made = [(given, made_by.get((variable, value))) for given, variable, value in one.effects]
            changes += [Change(given, (), place, False, _FOR_EVER) for given, place in made if place is not None]
            changes.append(Change((), (), first, False, 0))
            operations.append(Operation(*one[:5], (*one.tests, *tests), (*one.changes, *changes), one.more))
        behind = len(task.start) - task.numbers
        start = (*task.start[:behind], *reversed(left), *task.start[behind:])
        return Task(task.sizes, start, task.goal, tuple(operations), *task[4:6], task.numbers + len(left), task.tests)

    def written(self, problem: Problem, numbers: Numbers) -> tuple[str, str, Fraction] | None:
        """Write the task for Fast Downward, and how to search it optimally; None if the goal holds already.

        Last comes by how much each step costs less there at most: costs may have to be rounded down.
        """
        fitted = self._fitted(problem)
        if fitted.tests or any(one.operation.tests or one.operation.changes for one in self._operators):
            raise NotRepresentableError("Fast Downward plans without numbers that rise and fall")
        ready = self._weighed(fitted.frozen, frozenset(problem.weights.items()))
        exact = self._values_of([one.cost for one in ready], "costs", numbers)
        costs, _ = whole(exact)
        dearest, lost = max(costs, default=0), Fraction()
        if dearest > _MOST_COST:
            costs, lost = [cost * _MOST_COST // dearest for cost in costs], Fraction(max(exact)) / _MOST_COST
        if not fitted.goal:
            return None
        rules = self._rules_of(fitted)
        layers = {rule.variable: rule.layer for rule in rules}
        sizes = [*self._all_sizes, *[2] * (len(fitted.state) - len(self._all_sizes))]
        # unit costs are written as costs of 1
        text = ["begin_version\n3\nend_version\nbegin_metric\n1\nend_metric\n", f"{len(sizes)}\n"]
        for number, size in enumerate(sizes):
            values = [f"Atom v{number}({value})\n" for value in range(size)]
            text += [f"begin_variable\nvar{number}\n{layers.get(number, -1)}\n{size}\n", *values, "end_variable\n"]
        text += ["0\nbegin_state\n", *(f"{value}\n" for value in fitted.state), "end_state\nbegin_goal\n"]
        text += [f"{len(fitted.goal)}\n", *(f"{variable} {value}\n" for variable, value in fitted.goal)]
        text += ["end_goal\n", f"{len(ready)}\n"]
        text += [f"{one.text}{cost}\nend_operator\n" for one, cost in zip(ready, costs, strict=True)]
        text.append(f"{len(rules)}\n")
        for rule in rules:
            needs = [f"{variable} {value}\n" for variable, value in rule.needs]
            text += [f"begin_rule\n{len(needs)}\n", *needs, f"{rule.variable} 1 0\nend_rule\n"]
        is_blind = math.prod(map(float, sizes)) <= _FEW_STATES or self._is_conditional or rules
        return "".join(text), "blind" if is_blind else "lmcut", lost

    def _instances(self, pattern: ActionPattern, rows: Iterable[Row]) -> Iterator["_Instance"]:
        order = {name: number for number, name in enumerate(self.domain.types)}
        for row in sorted(rows, key=lambda one: [order[word] for word in one]):
            needs = self._bound(pattern.needs, row)
            made = None if needs is False else self._instance(pattern, row, needs)
            if made is not None and (made.effects or not made.layer):
                yield made

    def _instance(self, pattern: ActionPattern, row: Sequence[str], node: Node) -> "_Instance":
        parts = conjuncts_of(node)
        needs = frozenset([str(one[2]) for one in parts if one[0] == "atom" and one[1]])
        denies = frozenset([str(one[2]) for one in parts if one[0] == "atom" and not one[1]])
        effects = list[_Effect]()
        for effect in pattern.effects:
            condition, text = self._bound(effect.condition, row), text_of_row(effect.name, bound(effect.words, row))
            if condition is not False and (effect.kind != "delete" or text in self._possible):
                effects.append((condition, effect.kind, text, bound_number(effect.amount, row)))
        made = {text for condition, kind, text, _ in effects if kind == "add" and condition is True}
        deleted = {text for _, kind, text, _ in effects if kind == "delete"} - made
        kept = [
            one
            for one in effects
            if not (one[1] == "delete" and one[2] in made)
            and (one[1] != "add" or one[2] not in needs - deleted or self.domain.is_feasibility(one[2]))
        ]
        others = joined(True, [one for one in parts if one[0] != "atom"])
        step = Step(pattern.name, tuple(row)) if pattern.layer else self.domain.step(pattern.name, row)
        return _Instance(step, needs, denies, others, kept, pattern.layer)

    def _bound(self, node: Node, row: Sequence[str], state: State | None = None) -> Node:
        """Return a condition of what it is bound to; what is out of reach never holds.

        Given a state, what no operator changes or looks at is as it is there.
        """
        if isinstance(node, bool):
            return node
        head, *parts = node
        if head == "atom":
            truth, name, words = parts
            text = text_of_row(name, bound(words, row))
            is_kept = text in (self._possible if state is None else self._variables.places)
            return ("atom", truth, text) if is_kept else (text in (state or ())) is truth
        if head == "same":
            one, other = bound(tuple(parts[1:]), row)
            return (one == other) is parts[0]
        if head in ("and", "or"):
            return joined(head == "and", [self._bound(part, row, state) for part in parts])
        return head, *(bound_number(part, row) for part in parts)

    def _encoded(self, instances: Sequence["_Instance"]) -> _Variables:
        variables = _Variables()
        looked_at = dict[str, bool]()  # by atom, whether it is denied
        for one in instances:
            looked_at.update(dict.fromkeys(sorted(one.denies), True))
            for node in (one.others, *(condition for condition, *_ in one.effects)):
                for text, truth in _literals(node):
                    looked_at[text] = looked_at.get(text, False) or not truth
        changed = dict.fromkeys(text for one in instances for _, kind, text, _ in one.effects if kind in _TRUTHS)
        atoms = {text: (row_of(text)[0], *row_of(text)[1]) for text in changed}
        texts = {atom: text for text, atom in atoms.items()}
        states = [[atoms[text] for text in sorted(state & atoms.keys())] for state in self.states]
        # what is denied has a variable of its own, so that one value says so
        grouped = [atom for text, atom in atoms.items() if not looked_at.get(text)]
        for group in groups([one.swap(atoms) for one in instances], states, grouped):
            variables.add([texts[atom] for atom in group])
        for text in (*changed, *looked_at):
            if text not in variables.places:
                variables.add([text])
        variables.layers = {variables.places[one.effects[0][2]][0]: one.layer for one in instances if one.layer}
        return variables

    def _operator(self, number: int, one: "_Instance") -> _Ready:
        variables, rules, places = self._variables, self._rules, self._variables.places
        facts, tests = rules.taken(one.others)
        facts += [fact for text in one.needs if text in places and (fact := variables.fact(text, True))]
        facts += [fact for text in one.denies if text in places and (fact := variables.fact(text, False))]
        made = {places[text][0] for given, kind, text, _ in one.effects if kind == "add" and given is True}
        effects = list[tuple[tuple[Fact, ...], int, int]]()
        changes = list[Change]()
        for condition, kind, text, amount in sorted(one.effects, key=lambda effect: effect[1] != "delete"):
            given, compared = rules.taken(condition)
            if kind not in _TRUTHS:
                value = self._number(amount)
                value = ("-", 0, value) if kind == "decrease" else value
                changes.append(Change(tuple(given), tuple(compared), self._numbers[text], kind != "assign", value))
                continue
            if compared:
                given, _ = rules.taken(("or", condition))
            variable, value = places[text]
            if kind == "add":
                effects.append((tuple(given), variable, value))
            elif variable not in made:
                is_so = variables.sizes[variable] == 2 or (condition is True and text in one.needs)
                own = () if is_so else (places[text],)
                effects.append(((*given, *own), variable, variables.sizes[variable] - 1))
        operation = Operation(number, tuple(sorted(set(facts))), tuple(effects), 0, (), tuple(tests), tuple(changes))
        lasting, missing = one.needs - places.keys(), one.denies - places.keys()
        amounts = () if one.layer else (self._usage.cost_of(one.step), self._usage.uses_of(one.step))
        return _Ready(number, one.step, one.needs, lasting, missing, operation, one.layer, *amounts)

    def _number(self, number: object, known: Mapping[str, Exact] | None = None) -> Number:
        """Return a number as the search reads it; one that nothing changes is what it is."""
        if not isinstance(number, tuple):
            return number  # type: ignore[return-value]  # it is exact
        head, *parts = number
        if head == "n" and parts[0] in self._numbers:
            return "n", self._numbers[parts[0]]
        if head == "n" and known is None:
            self._constants[parts[0]] = self._known.get(parts[0])
        if head == "n":
            return (self._known if known is None else known).get(parts[0])
        return head, *(self._number(part, known) for part in parts)

    def _values(self, state: State) -> tuple[int, ...] | None:
        """Return the values of the variables; None if more than one value of one says what holds."""
        values = [size - 1 for size in self._all_sizes]
        held = [self._variables.places[atom] for atom in state & self._variables.places.keys()]
        for variable, value in held:
            values[variable] = value
        return tuple(values) if len({variable for variable, _ in held}) == len(held) else None

    def _fitted(self, problem: Problem) -> _Fitted:
        state, known = problem.state, numbers_in(problem.state)
        values = self._values(state)
        if values is None or not self.covers(state):
            raise NotRepresentableError("the state is none that the task was made for")
        wanted = self._bound(self._wanted(problem.wanted), (), state)
        if wanted is False:
            raise UnreachableGoalError("nothing that can be done makes the goal so")
        rules = _Rules(self._variables, len(self._all_sizes), partial(self._number, known=known))
        taken, tests = rules.taken(wanted)
        goal = dict(taken)
        if len(goal) < len(set(taken)):
            raise UnreachableGoalError("facts of the goal exclude one another")
        tail = [known.get(text) for text in reversed(self._numbers)]
        whole_state: Any = (*values, *[1] * rules.derived, *tail)
        frozen = state & self._frozen_atoms
        return _Fitted(whole_state, tuple(sorted(goal.items())), tuple(tests), tuple(rules.rules), frozen)

    def _compiled_goal(self, goals: tuple[UpThing, ...]) -> Node:
        with lock_of(self.domain):
            return joined(True, [compiled(self.domain, goal, {}) for goal in goals])

    def _graph_of(
        self, fitted: _Fitted, mentioned: Sequence[Exact | None], weights: frozenset[tuple[Step, int]]
    ) -> tuple[TaskGraph, Task, tuple[int, ...]]:
        """Return a task without its start and limits, and what the amounts of each resource were scaled by.

        What its graph has worked out is kept.
        """
        numbers = {text: value for text, value in zip(self._mentioned, mentioned, strict=True) if value is not None}
        ready = self._weighed(fitted.frozen, weights)
        changed = self._numbers.keys()
        varying = [one.cost if changed and changed & set(numeric_facts(one.cost)) else 0 for one in ready]
        fixed = [0 if more else one.cost for one, more in zip(ready, varying, strict=True)]
        amounts = [self._values_of(fixed, "costs", numbers)]
        for index, name in enumerate(self.domain.limited):
            amounts.append(self._values_of([one.uses[index] for one in ready], f"uses of {name}", numbers))
        columns, (scale, *scales) = zip(*map(whole, amounts), strict=True)
        more = [number and ("*", scale, self._number(number, numbers)) for number in varying]
        operations = [
            Operation(*one.operation[:3], cost, tuple(uses), *one.operation[5:7], varied)
            for one, varied, (cost, *uses) in zip(ready, more, zip(*columns, strict=True), strict=True)
        ]
        derived = len({rule.variable for rule in fitted.rules})
        sizes, tail = (*self._all_sizes, *[2] * derived), len(self._numbers)
        rules = tuple(sorted(self._rules_of(fitted), key=lambda rule: rule.layer))
        task = Task(sizes, (), fitted.goal, tuple(operations), (0,) * len(scales), rules, tail, fitted.tests)
        is_guided = math.prod(map(float, sizes)) > _FEWEST_STATES
        return TaskGraph(task, is_guided=is_guided), task, tuple(scales)

    def _rules_of(self, fitted: _Fitted) -> tuple[Rule, ...]:
        own = [one for one in self._axioms if one.lasting <= fitted.frozen and one.missing.isdisjoint(fitted.frozen)]
        made = [Rule(one.layer, one.operation.needs, one.operation.effects[0][1], one.operation.tests) for one in own]
        return (*self._rules.rules, *made, *fitted.rules)

    def _values_of(self, made_of: Sequence[Number], what: str, numbers: Numbers) -> list[Exact]:
        amounts = [self._usage.value(one, numbers) for one in made_of]
        least = min(amounts, default=0)
        if least < 0:
            terms = " + ".join(numeric_facts(made_of[amounts.index(least)]))
            message = f"{terms} comes to {float(least):g}; {what} are 0 or more"
            raise UnsupportedPddlError(message, self.domain.problem_file)
        return amounts

    def _ready_with(self, frozen: State) -> tuple[_Ready, ...]:
        return tuple([one for one in self._operators if one.lasting <= frozen and one.missing.isdisjoint(frozen)])

    def _weighed(self, frozen: State, weights: frozenset[tuple[Step, int]]) -> tuple[_Ready, ...]:
        possible, times = self._ready(frozen), dict(weights)
        if not times:
            return possible
        left = [one for one in possible if times.get(one.step, 1)]
        return tuple(
            [replace(one, cost=("*", times[one.step], one.cost)) if one.step in times else one for one in left]
        )


_Effect: TypeAlias = tuple[Node, str, str, object]


@dataclass(frozen=True)
class _Instance:
    """An action with its arguments: the atoms it needs and denies, what else it needs, and its effects."""

    step: Step
    needs: frozenset[str]
    denies: frozenset[str]
    others: Node
    effects: list[_Effect]
    layer: int

    def swap(self, atoms: Mapping[str, tuple[str, ...]]) -> Swap:
        """Return what it does to some atoms, which are given by their texts."""
        deleted = [atoms[text] for given, kind, text, _ in self.effects if kind == "delete" and given is True]
        added = tuple([atoms[text] for _, kind, text, _ in self.effects if kind == "add"])
        return Swap(frozenset([atoms[text] for text in self.needs if text in atoms]), added, frozenset(deleted))


def _names(pattern: ActionPattern) -> Iterator[str]:
    nodes = (pattern.needs, *(effect.condition for effect in pattern.effects))
    yield from (name for node in nodes for name, _ in _literals(node))
    yield from (effect.name for effect in pattern.effects if effect.kind in _TRUTHS)


def _literals(node: Node) -> Iterator[tuple[str, bool]]:
    if isinstance(node, tuple) and node[0] == "atom":
        yield str(node[2]), bool(node[1])
    elif isinstance(node, tuple) and node[0] in ("and", "or"):
        for part in node[1:]:
            yield from _literals(part)


@lru_cache(_MOST_DOMAINS)
def _instantaneous(domain: Domain) -> tuple[ActionPattern, ...]:
    """Return the actions of steps that follow one another; UnsupportedPddlError says that they cannot."""
    with lock_of(domain):
        return *patterns_of(domain, Problem(domain, frozenset()).build().actions), *axioms_of(domain)


def _grown(before: Grounded | None, problem: Problem, named: State, go_on: Callable[[int], None]) -> Grounded:
    """Ground a domain for a state and what fitted before; what is named, and what may be feasible, may hold too."""
    domain = problem.domain
    feasible = map(domain.feasible_atom, domain.rosa_actions if domain.tracks_feasibility else ())
    base, states = (before.base, before.states) if before else (frozenset[str](), ())
    may_hold = base.union(feasible, named, (atom for atom in problem.state if not atom.startswith("(= ")))
    return Grounded(domain, may_hold, (*states, problem.state)[-_MOST_STATES:], go_on)


class Groundings:
    """The grounded task of each domain, made when first asked for, and anew when it must grow.

    All that may be feasible, and what was named, may hold from the beginning; other things that nothing makes true,
    once they did. What a task fits depends on what was asked for and named before, never on how long anything takes.
    """

    def __init__(self) -> None:
        self._made: dict[Domain, Grounded] = {}
        self._making = Lock()

    def made(self, problem: Problem) -> Grounded | None:
        """Return the task if there is one that fits. Never waits."""
        known = self._made.get(problem.domain)
        return known if known is not None and known.covers(problem.state) else None

    def ask(self, problem: Problem, process: ProcessHandle, limit_s: float, changing: Iterable[str] = ()) -> Grounded:
        """Return a task that fits, made in so much wall-clock time [s] if need be; raises Trouble, or Cancelled."""
        deadline, domain = time.monotonic() + limit_s, problem.domain

        def go_on(instances: int = 0) -> None:
            process.check()
            if time.monotonic() > deadline:
                message = f"the task of {domain.name} was not grounded in {limit_s:.3g} s; allow more or ask for less"
                raise Trouble(Outcome.OUT_OF_TIME, message)
            if instances > _MOST_INSTANCES:
                message = f"{domain.name} has more than {_MOST_INSTANCES} actions with their arguments"
                raise Trouble(Outcome.OUT_OF_MEMORY, f"{message}; name fewer objects")

        go_on()
        while not self._making.acquire(timeout=_LOOKS_S):
            go_on()
        try:
            named, known = frozenset(changing), self._made.get(domain)
            if known is None or not known.covers(problem.state) or not named <= known.base:
                known = _grown(known, problem, named, go_on)
            self._made.pop(domain, None)
            if len(self._made) >= _MOST_DOMAINS:
                self._made.pop(next(iter(self._made)))
            self._made[domain] = known
            return known
        finally:
            self._making.release()

    def close(self) -> None:
        self._made.clear()
