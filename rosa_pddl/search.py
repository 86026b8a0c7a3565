"""The exact search: finds a plan of least cost over explicit states, in this process.

Label setting after Desrochers and Soumis, "A generalized permanent labelling algorithm for the
shortest path problem with time windows", INFOR 26, 1988. Without limits it is A*. All amounts are
exact, so sums and comparisons with a limit are exact. A cap on the number of moves ends the search,
never the clock, so the same task always has the same answer.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from heapq import heapify, heappop, heappush
from itertools import chain
from math import inf
from operator import add, gt, le
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from rosa_pddl.domain import (
    TRUE,
    Binding,
    Domain,
    Exact,
    Formula,
    Number,
    Schema,
    State,
    Step,
    UnsupportedPddlError,
    atom_text,
    bound,
    conjuncts,
    head_of,
    names_in,
    parts_of,
    text_of,
)
from rosa_pddl.grounding import (
    Join,
    Literal,
    Rule,
    UnsearchableError,
    binding_of,
    cost_of,
    substituted,
    with_types,
)
from rosa_pddl.problem import Problem
from rosa_pddl.validate import (
    Values,
    affected_atoms,
    ended,
    goal_holds,
    missing_at_start,
    started,
)

T = TypeVar("T")
S = TypeVar("S")


class CapReached(Exception):
    """The search looked at as many moves as the cap allows and found no answer."""


class Move(NamedTuple, Generic[S, T]):
    """One step: the state after it, its cost, and its use of each limited resource.

    Not negative.
    """

    to: S
    cost: Any
    uses: tuple[Any, ...]
    what: T


class Graph(Protocol[S, T]):
    """The graph that is searched."""

    def moves(self, state: S) -> Iterable[Move[S, T]]: ...

    def is_goal(self, state: S) -> bool: ...

    def least(self, state: S) -> tuple[float, Sequence[float]]:
        """Return lower bounds of cost and usage from a state to a goal; infinite if out of reach.

        The bounds are consistent: no move lowers them by more than the move costs or uses.
        """


class Path(NamedTuple, Generic[S, T]):
    """A cheapest path with its cost."""

    moves: tuple[Move[S, T], ...]
    cost: Any


class _Label(NamedTuple, Generic[S, T]):
    """A path to a state: its cost, followed by its usage."""

    before: "_Label[S, T] | None"
    move: Move[S, T] | None
    state: S
    spent: tuple[Any, ...]


def cheapest(
    graph: Graph[S, T],
    start: S,
    limits: Sequence[Any] = (),
    cap: float = inf,
    go_on: Callable[[], None] = lambda: None,
) -> Path[S, T] | None:
    """Find a path of least cost that uses no more than the limits; None proves that there is none.

    CapReached is raised if the search has looked at `cap` moves without an answer. `go_on` is
    called for each label that is expanded, and may raise to stop the search.

    Labels leave the queue in order of their cost plus its lower bound to a goal. So the labels of
    a state leave it in order of cost, and a label is expanded only if it uses less of something
    than each earlier one; the first label at a goal is optimal.
    """
    if any(limit < 0 for limit in limits):
        return None
    first: _Label[S, T] = _Label(None, None, start, (0,) * (1 + len(limits)))
    queue = [(graph.least(start)[0], first.spent[1:], 0, first)]
    expanded: dict[S, list[tuple[Any, ...]]] = {}
    latest: dict[S, tuple[Any, ...]] = {}
    looked_at = pushed = 0
    while queue:
        _, uses, _, label = heappop(queue)
        front = expanded.setdefault(label.state, [])
        if _is_dominated(uses, front):
            continue
        if graph.is_goal(label.state):
            return Path(_moves(label), label.spent[0])
        front[:] = [uses, *(other for other in front if not _is_dominated(other, [uses]))]
        go_on()
        for move in graph.moves(label.state):
            looked_at += 1
            spent = (label.spent[0] + move.cost, *map(add, uses, move.uses))
            if any(map(gt, spent[1:], limits)):
                continue
            if move.to in latest and all(map(le, latest[move.to], spent)):
                continue
            if _is_dominated(spent[1:], expanded.get(move.to, ())):
                continue
            least, lacking = graph.least(move.to)
            if least == inf or any(map(gt, map(add, spent[1:], lacking), limits)):
                continue
            latest[move.to] = spent
            pushed += 1
            new = _Label(label, move, move.to, spent)
            heappush(queue, (spent[0] + least, spent[1:], pushed, new))
        if looked_at > cap:
            raise CapReached
    return None


def distances(arcs: Iterable[tuple[S, S, float]], goals: Iterable[S]) -> dict[S, float]:
    """Return each state's distance to its nearest goal along arcs (from, to, length)."""
    into: dict[S, list[tuple[S, float]]] = {}
    for before, after, length in arcs:
        into.setdefault(after, []).append((before, length))
    order = {state: number for number, state in enumerate(into)}
    nearest: dict[S, float] = {}
    # 0, not 0.0, so that sums of whole lengths stay exact however large they are
    queue: list[tuple[float, int, S]] = [(0, order.get(goal, -1), goal) for goal in goals]
    heapify(queue)
    while queue:
        far, _, state = heappop(queue)
        if state in nearest:
            continue
        nearest[state] = far
        for before, length in into.get(state, ()):
            if before not in nearest:
                heappush(queue, (far + length, order.setdefault(before, len(order)), before))
    return nearest


def _is_dominated(uses: tuple[Any, ...], front: Iterable[tuple[Any, ...]]) -> bool:
    for other in front:  # noqa: SIM110  # a loop is quicker: few others
        if all(map(le, other, uses)):
            return True
    return False


def _moves(label: _Label[S, T]) -> tuple[Move[S, T], ...]:
    moves: list[Move[S, T]] = []
    at: _Label[S, T] | None = label
    while at is not None and at.move is not None:
        moves.append(at.move)
        at = at.before
    return tuple(moves[::-1])


# ---------------------------------------------------------------- steps as moves


class GroundStep(NamedTuple):
    """A step with the atoms that it surely needs, and those that it may add and delete."""

    step: Step
    needs: frozenset[str]
    adds: frozenset[str]
    deletes: frozenset[str]


class Grounded:
    """The steps that can be reached from any state whose atoms are in, or follow from, a base.

    Args:
        domain: what `load_domain` returned.
        base: the atoms that may be true initially, in any of the states.
        go_on: called with the number of instances; an error that it raises stops the grounding.

    Raises:
        UnsearchableError: the domain has something of which the search has no notion.
    """

    def __init__(self, domain: Domain, base: State, go_on: Callable[[int], None]) -> None:
        if domain.only_planned:
            raise UnsearchableError("facts change by themselves")
        self.base = frozenset(atom for atom in base if not atom.startswith("(= "))
        self._domain = domain  # kept, as a planner knows domains by the identity of their caches
        rules = {schema: self._rule(domain, schema) for schema in domain.schema_of.values()}
        further = chain.from_iterable(_further_rules(domain, *each) for each in rules.items())
        join = Join([*rules.values(), *further])
        rows: dict[Rule, dict[tuple[str, ...], None]] = {rule: {} for rule in rules.values()}
        instances = 0

        def accept(rule: Rule, binding: Binding) -> bool:
            nonlocal instances
            instances += 1
            go_on(instances)
            if rule in rows:
                rows[rule][tuple(binding[name] for name, _ in rule.variables)] = None
            return True

        reached = join.close(join.facts(domain, sorted(self.base)), accept)
        atoms = [atom_text(name, row) for name, each in reached.items() for row in each]
        self._possible = self.base.union(atoms)
        order = {name: number for number, name in enumerate(domain.types)}
        self.steps = list[GroundStep]()
        for schema, rule in rules.items():
            for row in sorted(rows[rule], key=lambda row: [order[word] for word in row]):
                go_on(0)
                self.steps.append(self._ground(domain, schema, row))
        self.moving = frozenset(chain(*[each.adds | each.deletes for each in self.steps]))
        self._names = join.names.union(map(head_of, self.moving))

    def covers(self, state: State) -> bool:
        """Whether the steps are all that matter for a state."""
        strange = [atom for atom in state - self._possible if not atom.startswith("(= ")]
        return not any(head_of(atom) in self._names for atom in strange)

    def _rule(self, domain: Domain, schema: Schema) -> Rule:
        """Return the rule of an action as if nothing were deleted, and without numbers."""
        needed = self._needed(schema)
        heads = [(e.name, e.terms) for e in schema.effects if e.kind == "add" and not e.variables]
        literals = with_types(domain, schema.variables, needed)
        return Rule(schema.variables, literals, heads=heads)

    def _needed(self, schema: Schema) -> list[Literal]:
        """Return the atoms that must be true at the start, derived ones aside."""
        late = [*schema.over_all, *schema.end]
        provided = {effect.name for effect in schema.start_effects}
        parts = [*schema.start, *(part for part in late if part[1] not in provided)]
        needed = [(part[1], part[2]) for part in conjuncts(parts) if part[0] == "atom"]
        return [literal for literal in needed if literal[0] not in self._domain.derived]

    def _ground(self, domain: Domain, schema: Schema, row: tuple[str, ...]) -> GroundStep:
        step = domain.step(schema.name, row)
        binding = binding_of(domain, step)
        adds = [effect for effect in schema.effects if effect.kind == "add"]
        deletes = [effect for effect in schema.effects if effect.kind == "delete"]
        needs = [atom_text(name, bound(terms, binding)) for name, terms in self._needed(schema)]
        changed = [frozenset(affected_atoms(domain, each, binding)) for each in (adds, deletes)]
        return GroundStep(step, frozenset(needs), *changed)

    def plan(
        self, problem: Problem, cap: float, go_on: Callable[[], None]
    ) -> tuple[Step, ...] | None:
        """Return a plan of least cost; None proves that there is none. Raises as `cheapest`."""
        graph = TaskGraph(self, problem)
        limits = tuple(graph.limits.values())
        path = cheapest(graph, graph.start, limits, cap, go_on)
        return None if path is None else tuple(move.what for move in path.moves)


def _further_rules(domain: Domain, schema: Schema, rule: Rule) -> Iterator[Rule]:
    """Yield the rules of the effects of an action on further variables."""
    for effect in schema.effects:
        if effect.kind == "add" and effect.variables:
            variables = schema.variables + effect.variables
            literals = with_types(domain, effect.variables, rule.literals)
            yield Rule(variables, literals, heads=[(effect.name, effect.terms)])


class TaskGraph:
    """The states that steps lead to from that of a problem, by the semantics of `validate`.

    A number that steps only raise, and that the goal limits, is no part of a state: it is a use of
    the moves. The lower bounds are the shortest paths to a goal atom in a relaxed graph of atoms:
    of the atoms that a step needs, it keeps only one.
    """

    def __init__(self, task: Grounded, problem: Problem) -> None:
        self._problem = problem
        self._domain = domain = problem.domain.with_numbers(problem.costs)
        self._moving = task.moving
        self._values = Values(domain, problem.state, problem.costs)
        goals = list(conjuncts(problem.wanted))
        raised = _raised(domain)
        bounds = [goal for goal in goals if goal[0] == "<=" and names_in([goal[1]]) & raised]
        self._goals = [goal for goal in goals if goal not in bounds]
        raised -= names_in([*self._goals, *(bound for _, _, bound in bounds)])
        self.limits: dict[str, Exact] = {}
        for goal in bounds:
            _, left, right = goal
            text = text_of(left)
            if left[0] != "n" or left[1] not in raised or text in self.limits:
                raise UnsearchableError(f"{text} is limited by more than a number")
            self.limits[text] = self._value(right) - self._value(left)
        for goal in self._goals:
            if goal[0] in ("<", "<=", "="):
                self._value(("+", *goal[1:]))
        self._read = _read_by_steps(domain) | names_in(self._goals)
        heads = self._read - raised
        self.start = frozenset(fact for fact in problem.state if head_of(fact) in heads)
        self._least: dict[State, tuple[float, Sequence[float]]] = {}
        self._steps = list(self._priced(task))
        # what never changes and is only needed has been looked at
        schemas = {name: self._slim(schema) for name, schema in domain.schema_of.items()}
        self._domain = domain.with_schemas(schemas)
        atoms = [text_of(goal) for goal in self._goals if goal[0] == "atom"]
        self._atoms = [atom for atom in atoms if head_of(atom) not in domain.derived]
        self._distances = list[list[dict[str | None, float]]]()
        for amount in range(1 + len(self.limits)):
            arcs = list(self._arcs(amount))
            self._distances.append([distances(arcs, [atom]) for atom in sorted(self._atoms)])

    def _slim(self, schema: Schema) -> Schema:
        """Return an action without the conditions that hold throughout."""

        def open_parts(formulas: Iterable[Formula]) -> tuple[Formula, ...]:
            parts = conjuncts(formulas)
            return tuple(part for part in parts if part[0] != "atom" or part[1] in self._read)

        start, over_all, end = map(open_parts, (schema.start, schema.over_all, schema.end))
        return replace(schema, start=start, over_all=over_all, end=end)

    def _priced(self, task: Grounded) -> Iterator[tuple[GroundStep, Number, tuple[Exact, ...]]]:
        """Yield the steps that the lasting facts allow, with their costs and uses."""
        for each in task.steps:
            step = each.step
            weight = self._problem.weights.get(step, 1)
            if not weight or not each.needs - self._moving <= self._problem.state:
                continue
            cost = cost_of(self._domain, step)
            if not names_in([cost]) & self._domain.computed:
                cost = self._value(cost)
            binding = binding_of(self._domain, step)
            uses: dict[str, Exact] = dict.fromkeys(self.limits, 0)
            for effect in self._domain.schema_of[step.schema].effects:
                text = atom_text(effect.name, bound(effect.terms, binding))
                if effect.is_numeric and text in uses:
                    uses[text] += self._value(substituted(effect.amount, binding))
            if min(0 if isinstance(cost, tuple) else cost, *uses.values(), 0) < 0:
                raise UnsearchableError(f"{step} costs less than nothing")
            moving = each._replace(needs=each.needs & self._moving)
            yield moving, cost if weight == 1 else ("*", weight, cost), tuple(uses.values())

    def _value(self, number: Number) -> Exact:
        value = self._values.number(number, {})
        if value is None:
            texts = [text_of(part) for part in parts_of(number) if part[0] == "n"]
            unknown = next(text for text in texts if self._values.value_of(text) is None)
            message = f"{unknown} is needed but has no value; state '(= {unknown} NUMBER)' in"
            file = self._domain.problem_file
            raise UnsupportedPddlError(f"{message} :init, or hand it in with the problem", file)
        return value

    def is_goal(self, state: State) -> bool:
        """Whether the goal holds."""
        return goal_holds(self._domain, state, self._goals)

    def moves(self, state: State) -> Iterator[Move[State, Step]]:
        """Yield the moves that are possible in a state and change it."""
        domain = self._domain
        for (step, needs, _, _), cost, uses in self._steps:
            if not needs <= state or missing_at_start(domain, step, state) is not None:
                continue
            after = ended(domain, step, started(domain, step, state))
            price = Values(domain, state, self._problem.costs).number(cost, {})
            if after != state and price is not None:
                if price < 0:
                    raise UnsearchableError(f"{step} costs less than nothing")
                yield Move(after, price, uses, step)

    def least(self, state: State) -> tuple[float, Sequence[float]]:
        """Return lower bounds: the distances of the farthest goal atom."""
        atoms = state & self._moving
        if atoms not in self._least:
            bounds = list[float]()
            for by_goal in self._distances:
                nearest = [min(far.get(a, inf) for a in (None, *atoms)) for far in by_goal]
                bounds.append(max(nearest, default=0))
            self._least[atoms] = bounds[0], bounds[1:]
        return self._least[atoms]

    def _arcs(self, amount: int) -> Iterator[tuple[str | None, str, Any]]:
        """Yield the arcs of the relaxed graph: from an atom, or None for anywhere."""
        for (_, needs, adds, deletes), cost, uses in self._steps:
            before = min(needs & deletes or needs, default=None)
            length = (0 if isinstance(cost, tuple) else cost, *uses)[amount]
            for after in sorted(adds):
                yield before, after, length


def _read_by_steps(domain: Domain) -> set[str]:
    """Return the predicates and numbers that steps change, or do not simply need."""
    names = set[str]()
    for schema in domain.schema_of.values():
        names |= names_in(part for part in conjuncts(schema.conditions) if part[0] != "atom")
        for effect in schema.effects:
            names |= {effect.name} | names_in([effect.condition, effect.amount])
    for axioms in domain.axioms.values():
        names |= names_in(axiom.condition for axiom in axioms)
    return names | domain.derived


def _raised(domain: Domain) -> set[str]:
    """Return the numbers that steps only raise, by fixed amounts, and that no step reads."""
    raised = set(domain.computed)
    for schema in domain.schema_of.values():
        raised -= names_in([*schema.conditions, *(schema.duration or ())])
        for effect in schema.effects:
            raised -= names_in([effect.condition, effect.amount])
            if (
                effect.kind != "increase"
                or effect.condition != TRUE
                or effect.variables
                or names_in([effect.amount]) & domain.computed
            ):
                raised.discard(effect.name)
    for axioms in domain.axioms.values():
        raised -= names_in(axiom.condition for axiom in axioms)
    return raised
