"""Grounds a domain once, into a task that can be used with any state, goal and numbers."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache, partial
from itertools import chain, groupby
from operator import itemgetter, mul
from threading import Lock
from typing import Any, TypeAlias

from rosa_pddl.domain import (
    Domain,
    Exact,
    Outcome,
    State,
    Step,
    Trouble,
    UpThing,
    exact,
    head_of,
    numbers_in,
)
from rosa_pddl.engines.processes import ProcessHandle
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.instances import (
    ActionPattern,
    Node,
    Row,
    axioms_of,
    bound,
    bound_number,
    compiled,
    conjuncts_of,
    joined,
    numeric_facts,
    patterns_of,
    reach,
    row_of,
    text_of_row,
)
from rosa_pddl.problem import Problem, lock_of, with_starts
from rosa_pddl.resource_usage import Numbers, usage_of, whole
from rosa_pddl.search import Change, Condition, Number, Operation, Rule, Task, TaskGraph
from rosa_pddl.search import State as SearchState

# Fast Downward adds costs in 32 bits; this allows plans of a thousand of the most expensive steps.
_MOST_COST = 2_000_000
# Blind search is faster than a heuristic if states can be encoded in this many bits or fewer.
_FEW_BITS = 20
_MOST_INSTANCES = 1_000_000
_RULES_FOR_A_MOVE = 20
_MOST_DOMAINS = 8
_TRUTHS = ("add", "delete")
_ALWAYS, _NO_STATE = Condition(), SearchState(frozenset())
_FOR_EVER: Any = math.inf  # a float, but it is only compared with exact numbers
_LOOKS_S = 0.05


@dataclass(frozen=True, eq=False)
class _Ready:
    """An operator, or a rule of a layer above 0; `lasting` are the facts it needs that never change."""

    step: Step
    needed: frozenset[str]
    lasting: frozenset[str]
    operation: Operation
    layer: int
    cost: Number = 0
    uses: tuple[Number, ...] = ()


class _Rules:
    """Makes conditions for the search: rules derive an atom for each disjunction, and numbers are compared."""

    def __init__(
        self, layers: Mapping[str, int], name: str, number: Callable[[object], Number]
    ) -> None:
        self._layers, self._name, self._number = layers, name, number
        self._known: dict[Node, str] = {}
        self.rules: list[Rule] = []

    def taken(self, node: Node) -> Condition:
        """Convert a condition that is not the constant False."""
        parts = conjuncts_of(node)
        needs = [part[2] for part in parts if part[0] == "atom" and part[1]]
        needs += [self._derived(part) for part in parts if part[0] == "or"]
        denies = [part[2] for part in parts if part[0] == "atom" and not part[1]]
        tests = [
            (kind, *map(self._number, numbers))
            for kind, *numbers in parts
            if kind not in ("atom", "or")
        ]
        return Condition(frozenset(needs), frozenset(denies), tuple(tests))

    def _derived(self, node: tuple[Any, ...]) -> str:
        """Return the atom that holds if a disjunction does."""
        if node not in self._known:
            ways = [self.taken(part) for part in node[1:]]
            layers = {**self._layers, **{rule.atom: rule.layer for rule in self.rules}}
            # a rule that needs a derived atom to be false belongs to a later layer than this atom
            after = [layers.get(atom, 0) for way in ways for atom in way.needs]
            after += [layers[atom] + 1 for way in ways for atom in way.denies if atom in layers]
            atom = self._known[node] = f"({self._name} {len(self._known)})"
            self.rules += [Rule(max(after, default=0), way, atom) for way in ways]
        return self._known[node]


class Grounded:
    """A grounded task. Facts that no operator changes are frozen: they are checked before the search.

    It covers all states whose atoms are reachable from the base, see `covers`. Trouble is raised if the goal cannot
    become true or the task does not fit an engine, UnsupportedPddlError if an amount has no value that is supported.

    Args:
        base: the atoms that may be true initially, in any of the states to cover.
        state: one of these states; numbers that no action changes have the values that they have there.
        go_on: called now and then during grounding; an error that it raises stops the grounding.
    """

    def __init__(
        self, domain: Domain, base: State, state: State, go_on: Callable[[int], None]
    ) -> None:
        self.domain, self.base = domain, base
        self._usage, patterns = usage_of(domain), _instantaneous(domain)
        rows, found = reach(patterns, [row_of(atom) for atom in sorted(base)], go_on)
        self._asked = frozenset(name for pattern in patterns for name in _names(pattern))
        self._possible = frozenset(
            text_of_row(name, row) for name, known in rows.items() for row in known
        )
        instances = [
            one
            for pattern, each in zip(patterns, found, strict=True)
            for one in self._instances(pattern, each)
        ]
        self._numbers = {
            text: k
            for k, text in enumerate(
                dict.fromkeys(
                    one[2]
                    for instance in instances
                    for one in instance.effects
                    if one[1] not in _TRUTHS
                )
            )
        }
        in_order = _changing(instances)
        self._changing = frozenset(in_order)
        self._layers = {one.effects[0][2]: one.layer for one in instances if one.layer}
        self._known, self._constants = numbers_in(state), dict[str, Exact | None]()
        self._rules = _Rules(self._layers, "or", self._number)
        ready = [
            self._operator(number, one) for number, one in enumerate(instances)
        ]  # rules come last
        self._operators, self._axioms = (
            [one for one in ready if bool(one.layer) is axiom] for axiom in (False, True)
        )
        self._frozen_atoms = self._possible - self._changing
        self._growing = {head for one in instances for head, more in one.growth.items() if more > 0}
        operations = [one.operation for one in self._operators]
        self._is_conditional = any(one.effects for one in operations)
        conditions = [one.condition for one in operations] + [
            rule.condition for rule in self._rules.rules
        ]
        conditions += [given for one in operations for given, *_ in one.effects]
        self._is_numeric = any(one.tests for one in conditions) or any(
            one.changes for one in operations
        )
        atoms = dict.fromkeys((*in_order, *(rule.atom for rule in self._rules.rules)))
        self._index = {atom: number for number, atom in enumerate(atoms)}
        self._text = lru_cache(maxsize=None)(self._text_of)
        amounts = [amount for one in self._operators for amount in (one.cost, *one.uses)]
        self._mentioned = tuple(
            dict.fromkeys(text for amount in amounts for text in numeric_facts(amount))
        )
        self._graph = lru_cache(maxsize=4)(self._graph_of)
        self._wanted = lru_cache(maxsize=64)(self._compiled_goal)

    @property
    def size(self) -> int:
        return len(self._operators)

    @property
    def work(self) -> int:
        """The work of a move relative to a task without axioms, as atoms are derived in each state."""
        return 1 + len(self._axioms) // _RULES_FOR_A_MOVE

    def step(self, number: int) -> Step:
        return self._operators[number].step

    def covers(self, state: State) -> bool:
        strange = (atom for atom in state - self._possible if head_of(atom) in self._asked)
        if next(strange, None) is not None:
            return False
        known = numbers_in(state) if self._constants else {}
        return all(known.get(text) == value for text, value in self._constants.items())

    def search_task(self, problem: Problem, numbers: Numbers) -> tuple[TaskGraph, Task]:
        """Return the graph and the task for a problem's state, goal and limits, with the given numbers."""
        start, goal, rules, frozen = self._fitted(problem)
        mentioned = tuple(
            [
                self._usage.known(text, numbers) if text in numbers else None
                for text in self._mentioned
            ]
        )
        weights = frozenset(problem.weights.items())
        graph, task, scales = self._graph(goal, rules, frozen, mentioned, weights)
        left = self._usage.remaining(numbers)
        limits = tuple([one.whole(scale) for one, scale in zip(left, scales, strict=True)])
        task = Task(start, goal, task.operations, task.amounts, limits, task.rules, task.more)
        if problem.until:
            task = self._timed(task, problem, numbers)
            graph = TaskGraph(task)
        return graph, task

    def _timed(self, task: Task, problem: Problem, numbers: Numbers) -> Task:
        """Add to a task how much longer facts hold, as numbers that each step decreases by its duration.

        One more number is 1 until the first step: if a running step is the first one, only its remaining time counts.
        """
        steps, first = [self.step(one.number) for one in task.operations], len(task.start.numbers)
        if any(
            not self._numbers.keys().isdisjoint(numeric_facts(self._usage.duration_of(one)))
            for one in steps
        ):
            raise Trouble(
                Outcome.UNSUPPORTED,
                "how long steps take changes, which is not planned with what is forecast",
            )
        takes = [self._usage.takes_s(step, numbers) for step in steps]
        shares = [
            1 - exact(problem.shares[step]) if step in problem.shares else 0 for step in steps
        ]
        saved = map(mul, takes, shares)
        times, _ = whole([*takes, *saved, *map(exact, problem.until.values())])
        pairs, left = zip(times, times[len(steps) :], strict=False), [1, *times[2 * len(steps) :]]
        places = {atom: first + number for number, atom in enumerate(problem.until, 1)}
        operations = list[Operation]()
        for one, (whole_s, done_s) in zip(task.operations, pairs, strict=False):
            takes_s: Number = ("-", whole_s, ("*", done_s, ("n", first))) if done_s else whole_s
            tests = [
                ("<=", takes_s, ("n", places[atom]))
                for atom in places
                if atom in self._operators[one.number].needed
            ]
            made = [(_ALWAYS, atom) for atom in one.adds] + [
                (given, atom) for given, atom, truth in one.effects if truth
            ]
            changes = [Change(_ALWAYS, place, True, ("-", 0, takes_s)) for place in places.values()]
            changes += [
                Change(given, places[atom], False, _FOR_EVER)
                for given, atom in made
                if atom in places
            ]
            changes.append(Change(_ALWAYS, first, False, 0))
            operations.append(one.extended(tests, changes))
        start = SearchState(task.start.atoms, (*task.start.numbers, *left))
        return Task(
            start, task.goal, tuple(operations), task.amounts, task.limits, task.rules, task.more
        )

    def written(self, problem: Problem, numbers: Numbers) -> tuple[str, str, Fraction] | None:
        """Return the task as text for Fast Downward, and the heuristic for optimal search; None if the goal holds.

        The third value is the largest rounding error of a step's cost, as costs may have to be rounded down.
        """
        start, goal, made, frozen = self._fitted(problem)
        if self._is_numeric or any(one.tests for one in (goal, *(rule.condition for rule in made))):
            raise Trouble(
                Outcome.UNSUPPORTED, "Fast Downward plans without numbers that rise and fall"
            )
        ready = self._weighed(frozen, problem.weights)
        exact = self._values_of([one.cost for one in ready], "costs", numbers)
        costs, _ = whole(exact)
        dearest, lost = max(costs, default=0), Fraction()
        if dearest > _MOST_COST:
            costs, lost = (
                [cost * _MOST_COST // dearest for cost in costs],
                Fraction(max(exact)) / _MOST_COST,
            )
        if not (goal.needs or goal.denies):
            return None
        rules = self._rules_of(made, frozen)
        layers = {rule.atom: rule.layer for rule in rules}
        index = {atom: number for number, atom in enumerate(dict.fromkeys((*self._index, *layers)))}
        # the metric is always used; a step of a domain without costs costs 1
        text = ["begin_version\n3\nend_version\nbegin_metric\n1\nend_metric\n", f"{len(index)}\n"]
        for atom, number in index.items():
            values = f"2\nAtom v{number}\nNegatedAtom v{number}\n"
            text.append(
                f"begin_variable\nvar{number}\n{layers.get(atom, -1)}\n{values}end_variable\n"
            )
        text += [
            "0\nbegin_state\n",
            *("01"[atom not in start.atoms] + "\n" for atom in index),
            "end_state\n",
        ]
        text += [f"begin_goal\n{_facts(goal, index)}\nend_goal\n{len(ready)}\n"]
        text += [
            f"{self._text(one.operation.number)}{cost}\nend_operator\n"
            for one, cost in zip(ready, costs, strict=True)
        ]
        text.append(f"{len(rules)}\n")
        text += [
            f"begin_rule\n{_facts(one.condition, index)}\n{index[one.atom]} 1 0\nend_rule\n"
            for one in rules
        ]
        is_blind = self._bits(problem.state) <= _FEW_BITS or self._is_conditional or rules
        return "".join(text), "blind" if is_blind else "lmcut", lost

    def _text_of(self, number: int) -> str:
        """Return an operator in Fast Downward's format, without its cost."""
        one, index = self._operators[number].operation, self._index
        sure = [(_ALWAYS, atom, atom in one.adds) for atom in sorted(one.deletes | one.adds)]
        # adds come last, so that they win over deletes
        effects = sorted((*sure, *one.effects), key=itemgetter(2))
        lines = [f"begin_operator\n{number}\n{_facts(one.condition, index)}\n{len(effects)}\n"]
        for given, atom, truth in effects:
            lines.append(
                f"{_facts(given, index)} {index[atom]} -1 {0 if truth else 1}".replace("\n", " ")
                + "\n"
            )
        return "".join(lines)

    def _bits(self, state: State) -> float:
        """Estimate how many bits encode a state: fewer for predicates that never get more true atoms than now."""
        bits = 0.0
        for name, atoms in groupby(sorted(self._changing, key=head_of), head_of):
            listed = tuple(atoms)
            chosen = len(state.intersection(listed)) * math.log2(len(listed))
            bits += len(listed) if name in self._growing else min(len(listed), chosen)
        return bits

    def _instances(self, pattern: ActionPattern, rows: Iterable[Row]) -> Iterator["_Instance"]:
        order = {name: number for number, name in enumerate(self.domain.types)}
        for row in sorted(rows, key=lambda one: [order[word] for word in one]):
            needs = self._bound(pattern.needs, row)
            made = None if needs is False else self._instance(pattern, row, needs)
            if made is not None and made.effects:  # Fast Downward refuses operators that do nothing
                yield made

    def _instance(self, pattern: ActionPattern, row: Sequence[str], node: Node) -> "_Instance":
        parts = conjuncts_of(node)
        needs = frozenset([str(one[2]) for one in parts if one[0] == "atom" and one[1]])
        denies = frozenset([str(one[2]) for one in parts if one[0] == "atom" and not one[1]])
        effects = list[_Effect]()
        for effect in pattern.effects:
            condition, text = (
                self._bound(effect.condition, row),
                text_of_row(effect.name, bound(effect.words, row)),
            )
            if condition is not False and (effect.kind != "delete" or text in self._possible):
                effects.append((condition, effect.kind, text, bound_number(effect.amount, row)))
        made = {text for condition, kind, text, _ in effects if kind == "add" and condition is True}
        deleted = {text for _, kind, text, _ in effects if kind == "delete"} - made
        kept = [
            one
            for one in effects
            if not (one[1] == "delete" and one[2] in made)
            and (
                one[1] != "add"
                or one[2] not in needs - deleted
                or self.domain.is_feasibility(one[2])
            )
        ]
        others = joined(True, [one for one in parts if one[0] != "atom"])
        step = (
            Step(pattern.name, tuple(row)) if pattern.layer else self.domain.step(pattern.name, row)
        )
        return _Instance(step, needs, denies, others, kept, pattern.layer)

    def _bound(self, node: Node, row: Sequence[str], state: State | None = None) -> Node:
        """Return a condition with its variables bound; unreachable atoms count as false.

        If a state is given, atoms that no operator changes or needs have their value in this state.
        """
        if isinstance(node, bool):
            return node
        head, *parts = node
        if head == "atom":
            truth, name, words = parts
            text = text_of_row(name, bound(words, row))
            is_kept = text in (self._possible if state is None else self._changing)
            return ("atom", truth, text) if is_kept else (text in (state or ())) is truth
        if head == "same":
            one, other = bound(tuple(parts[1:]), row)
            return (one == other) is parts[0]
        if head in ("and", "or"):
            return joined(head == "and", [self._bound(part, row, state) for part in parts])
        return head, *(bound_number(part, row) for part in parts)

    def _operator(self, number: int, one: "_Instance") -> _Ready:
        taken = self._rules.taken
        others = taken(one.others)
        needs, denies = others.needs | (one.needs & self._changing), others.denies | one.denies
        deletes, adds, effects, changes = (
            set[str](),
            set[str](),
            list[tuple[Condition, str, bool]](),
            list[Change](),
        )
        for given, kind, text, amount in one.effects:
            if kind not in _TRUTHS:
                value = self._number(amount)
                value = ("-", 0, value) if kind == "decrease" else value
                changes.append(Change(taken(given), self._numbers[text], kind != "assign", value))
            elif given is True:
                (adds if kind == "add" else deletes).add(text)
            else:
                effects.append((taken(given), text, kind == "add"))
        condition = Condition(needs, denies, others.tests)
        done = frozenset(deletes), frozenset(adds), tuple(effects), tuple(changes)
        amounts = (
            () if one.layer else (self._usage.cost_of(one.step), self._usage.uses_of(one.step))
        )
        operation, lasting = Operation(number, condition, *done), one.needs - self._changing
        return _Ready(one.step, one.needs, lasting, operation, one.layer, *amounts)

    def _number(self, number: object, known: Mapping[str, Exact] | None = None) -> Number:
        """Return a number in the form of the search; a number that nothing changes is replaced by its value."""
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

    def _fitted(self, problem: Problem) -> tuple[SearchState, Condition, tuple[Rule, ...], State]:
        """Return the start of the search, its goal with the rules that derive it, and the true frozen facts."""
        state, known = problem.state, numbers_in(problem.state)
        wanted = self._bound(self._wanted(problem.wanted), (), state)
        if wanted is False:
            raise Trouble(Outcome.UNSOLVABLE_PROVEN)
        rules = _Rules(self._layers, "goal", partial(self._number, known=known))
        goal = rules.taken(wanted)
        if goal.needs & goal.denies:
            raise Trouble(Outcome.UNSOLVABLE_PROVEN)
        start = SearchState(
            state & self._changing, tuple([known.get(text) for text in self._numbers])
        )
        return start, goal, tuple(rules.rules), state & self._frozen_atoms

    def _compiled_goal(self, goals: tuple[UpThing, ...]) -> Node:
        with lock_of(self.domain):
            return joined(True, [compiled(self.domain, goal, {}) for goal in goals])

    def _graph_of(
        self,
        goal: Condition,
        rules: tuple[Rule, ...],
        frozen: State,
        mentioned: Sequence[Exact | None],
        weights: frozenset[tuple[Step, int]],
    ) -> tuple[TaskGraph, Task, tuple[int, ...]]:
        """Return a task without its start and limits, and the scale of the amounts of each resource.

        Its graph is returned too, and kept with all that it has computed.
        """
        numbers = {
            text: value
            for text, value in zip(self._mentioned, mentioned, strict=True)
            if value is not None
        }
        ready = self._weighed(frozen, dict(weights))
        changed = self._numbers.keys()
        varying = [
            one.cost if changed and changed & set(numeric_facts(one.cost)) else 0 for one in ready
        ]
        fixed = [0 if more else one.cost for one, more in zip(ready, varying, strict=True)]
        amounts = [self._values_of(fixed, "costs", numbers)]
        for index, name in enumerate(self.domain.limited):
            amounts.append(
                self._values_of([one.uses[index] for one in ready], f"uses of {name}", numbers)
            )
        columns, (scale, *scales) = zip(*map(whole, amounts), strict=True)
        more = [number and ("*", scale, self._number(number, numbers)) for number in varying]
        operations, limits = tuple([one.operation for one in ready]), (0,) * len(scales)
        each, rules = tuple(zip(*columns, strict=True)), self._rules_of(rules, frozen)
        task = Task(
            _NO_STATE, goal, operations, each, limits, rules, tuple(more) if any(more) else ()
        )
        return TaskGraph(task), task, tuple(scales)

    def _rules_of(self, rules: Iterable[Rule], frozen: State) -> tuple[Rule, ...]:
        own = [one for one in self._axioms if one.lasting <= frozen]
        made = [
            Rule(one.layer, one.operation.condition, atom)
            for one in own
            for atom in one.operation.adds
        ]
        return tuple(sorted((*self._rules.rules, *made, *rules), key=lambda rule: rule.layer))

    def _values_of(self, made_of: Sequence[Number], what: str, numbers: Numbers) -> list[Exact]:
        amounts = [self._usage.value(one, numbers) for one in made_of]
        least = min(amounts, default=0)
        if least < 0:
            terms = " + ".join(numeric_facts(made_of[amounts.index(least)]))
            message = f"{terms} comes to {float(least):g}; {what} are 0 or more"
            raise UnsupportedPddlError(message, self.domain.problem_file)
        return amounts

    def _weighed(self, frozen: State, weights: Mapping[Step, int]) -> list[_Ready]:
        """Return the operators that the frozen facts allow, with weighted costs, without those of weight 0."""
        possible = [one for one in self._operators if one.lasting <= frozen]
        if not weights:
            return possible
        left = [one for one in possible if weights.get(one.step, 1)]
        return [
            replace(one, cost=("*", weights[one.step], one.cost)) if one.step in weights else one
            for one in left
        ]


_Effect: TypeAlias = tuple[Node, str, str, object]


@dataclass(frozen=True)
class _Instance:
    """An action with its arguments: atoms that must be true or false, its other conditions, and its effects."""

    step: Step
    needs: frozenset[str]
    denies: frozenset[str]
    others: Node
    effects: list[_Effect]
    layer: int

    @property
    def growth(self) -> Counter[str]:
        """For each predicate, by how much the action may increase the number of true atoms."""
        made = Counter(head_of(text) for _, kind, text, _ in self.effects if kind == "add")
        made.subtract(
            head_of(text)
            for given, kind, text, _ in self.effects
            if kind == "delete" and given is True
        )
        return made


def _changing(instances: Iterable[_Instance]) -> list[str]:
    """Return the atoms that operators change or need to be false, and those in other conditions than conjunctions."""
    found = [text for one in instances for _, kind, text, _ in one.effects if kind in _TRUTHS]
    for one in instances:
        nodes = (one.others, *(condition for condition, *_ in one.effects))
        found += [*sorted(one.denies), *chain.from_iterable(map(_atoms, nodes))]
    return found


def _facts(condition: Condition, index: Mapping[str, int]) -> str:
    """Return a condition in Fast Downward's format."""
    facts = [f"{index[atom]} 0" for atom in condition.needs] + [
        f"{index[atom]} 1" for atom in condition.denies
    ]
    return "\n".join([str(len(facts)), *sorted(facts)])


def _names(pattern: ActionPattern) -> Iterator[str]:
    nodes = (pattern.needs, *(effect.condition for effect in pattern.effects))
    yield from chain.from_iterable(map(_atoms, nodes))
    yield from (effect.name for effect in pattern.effects if effect.kind in _TRUTHS)


def _atoms(node: Node) -> Iterator[str]:
    """Yield the atoms of a condition, or their predicates if the condition is not bound."""
    if isinstance(node, tuple) and node[0] == "atom":
        yield str(node[2])
    elif isinstance(node, tuple) and node[0] in ("and", "or"):
        for part in node[1:]:
            yield from _atoms(part)


@lru_cache(_MOST_DOMAINS)
def _instantaneous(domain: Domain) -> tuple[ActionPattern, ...]:
    """Return the actions as instantaneous ones, and the axioms; UnsupportedPddlError if that is impossible."""
    with lock_of(domain):
        built = Problem(domain, frozenset()).build()
        known = with_starts(domain, built)
        return *patterns_of(known, built.actions), *axioms_of(known)


class Groundings:
    """The grounded task of each domain, made on the first request, and made again when it must cover more states.

    A task covers all feasibility facts and all named atoms from the beginning, and other atoms that no action adds as
    soon as one request had them. So what it covers depends on the requests before, never on how long anything takes.
    """

    def __init__(self) -> None:
        self._made: dict[Domain, Grounded] = {}
        self._making = Lock()

    def made(self, problem: Problem) -> Grounded | None:
        """Return the task if there is one that covers the problem, else None. Never waits."""
        known = self._made.get(problem.domain)
        return known if known is not None and known.covers(problem.state) else None

    def ask(
        self, problem: Problem, process: ProcessHandle, limit_s: float, changing: Iterable[str] = ()
    ) -> Grounded:
        """Return a task that covers the problem, made within `limit_s` [s] if need be; raises Trouble or Cancelled."""
        deadline, domain = time.monotonic() + limit_s, problem.domain

        def go_on(instances: int = 0) -> None:
            process.check()
            if time.monotonic() > deadline:
                message = f"the task of {domain.name} was not grounded in {limit_s:.3g} s; allow more or ask for less"
                raise Trouble(Outcome.OUT_OF_TIME, message)
            if instances > _MOST_INSTANCES:
                message = (
                    f"{domain.name} has more than {_MOST_INSTANCES} actions with their arguments"
                )
                raise Trouble(Outcome.OUT_OF_MEMORY, f"{message}; name fewer objects")

        go_on()
        while not self._making.acquire(timeout=_LOOKS_S):
            go_on()
        try:
            named, known = frozenset(changing), self._made.get(domain)
            if known is None or not known.covers(problem.state) or not named <= known.base:
                base, atoms = (
                    known.base if known else State(),
                    [one for one in problem.state if one[:3] != "(= "],
                )
                known = Grounded(
                    domain, base.union(domain.feasibility, named, atoms), problem.state, go_on
                )
            self._made.pop(domain, None)
            if len(self._made) >= _MOST_DOMAINS:
                self._made.pop(next(iter(self._made)))
            self._made[domain] = known
            return known
        finally:
            self._making.release()

    def close(self) -> None:
        self._made.clear()
