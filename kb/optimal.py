"""Chooses the best joint configuration, proven by CP-SAT of OR-tools.

One worker, a fixed seed and an effort that is counted in work instead of seconds make the answer
the same on every machine. All amounts are whole numbers of a unit, so comparing choices is exact.
"""

import math
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

from kb.elements import ComponentKind, Estimation, EstimationKind, finite_number
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.knowledge_base import KnowledgeBase
from kb.network import Node
from kb.planning import Choice, choice_by_priority, ranked
from kb.records import ReconfigurationPlan
from kb.state import State, in_order

DIGITS: Final = 12
"""The digits to which the sum of all amounts is known."""
_SETTINGS: Final = {
    "num_workers": 1,
    "random_seed": 0,
    "linearization_level": 2,  # the relaxation proves these problems almost alone
    "cp_model_probing_level": 0,
    "max_presolve_iterations": 1,
    "cut_level": 0,  # cuts cost more than they save here
    "symmetry_level": 0,
    "catch_sigint_signal": False,
}

Untyped = Any  # an object of OR-tools: a variable, an expression, a status


def load_cp_model() -> Untyped:
    """Import OR-tools, which is slow, so not in a tick; it may be missing."""
    try:
        from ortools.sat.python import cp_model
    except ImportError as error:
        raise KnowledgeBaseError(
            "the best configuration is proven with OR-tools, which is not installed; "
            "pip install 'rosa-taca[optimal]' brings it"
        ) from error
    return cp_model


class Optimum(NamedTuple):
    """The best joint choice, or the best one that was found within the effort.

    Attributes:
        choice: what to select.
        value: the worth of the choice, less switching costs; at least that if it is not proven.
        bound: an upper bound of the value of any choice.
        is_proven: no choice is better, and no equal one comes before it.
    """

    choice: Choice
    value: float
    bound: float
    is_proven: bool


class OptimalPlanner:
    """Chooses the best joint configuration of all that is required.

    It chooses again for all that is required when something is adaptable, or the preferences
    changed since the last choice. Without estimations of a preferred attribute it chooses as
    `PriorityPlanner` does.

    Args:
        switching_cost: the cost of activating or deactivating a component or changing its
            configuration; for a smaller gain nothing is switched. Plain components are activated
            and deactivated at no cost, because they are not switched.
        effort: the most work for one choice, in CP-SAT's deterministic time; 0.3 is about a
            second.

    Attributes:
        latest: the latest result; None before the first, and after a choice by priority.
    """

    def __init__(self, *, switching_cost: float = 0.0, effort: float = 0.3) -> None:
        load_cp_model()
        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        if finite_number(switching_cost) < 0.0:
            raise InvalidValue(f"a switching cost is 0 or more, not {switching_cost!r}")
        self._switching_cost = switching_cost
        self._effort = effort
        self._weights: Mapping[str, float] | None = None
        self.latest: Optimum | None = None

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Return what `plan` would select now; None if there is nothing to do.

        Priority decides where nothing is estimated, and where no choice was found within the
        effort.
        """
        weights = summed_weights(kb)
        optimum = None
        is_adaptable = kb.adaptable_functions() or kb.adaptable_components()
        if is_adaptable or self._weights not in (None, weights):
            optimum = self.latest = self.optimum(kb)
        if optimum is not None:
            return optimum.choice
        with kb.reading() as state:
            return choice_by_priority(state)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Select for all that is required if it is due; see `Planner`."""
        weights = summed_weights(kb)
        choice = self.choose(kb)
        plan = None if choice is None else kb.select(*choice)
        self._weights = weights  # last, so that an interrupted choice is repeated
        return plan

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for the present state; None if priority is to decide."""
        with kb.reading() as state:
            problem = Problem(state, summed_weights(kb), self._switching_cost)
        return problem.solve(self._effort) if problem.is_weighed else None


def summed_weights(kb: KnowledgeBase) -> dict[str, float]:
    """Return the weights of the preferences of all required actions; a name alone weighs 1."""
    weights: dict[str, float] = {}
    for request in kb.required_actions:
        preference = request.preference or {}
        weighed = {preference: 1.0} if isinstance(preference, str) else preference
        for attribute, weight in weighed.items():
            weights[attribute] = weights.get(attribute, 0.0) + weight
    return {name: weight for name, weight in weights.items() if weight}


class Problem:
    """The problem of choosing for all that is required in a state; solved once.

    One design is chosen for each function, and one configuration for each component that a chosen
    design needs. The estimations of what is chosen or active add up; of absolute ones of an
    attribute the worst counts. The state may change while the problem is solved.

    Args:
        state: the present facts.
        weights: how much a unit of each attribute is worth.
        switching_cost: see `OptimalPlanner`.

    Attributes:
        is_weighed: an estimation concerns what takes part; if not, priority decides.
    """

    def __init__(
        self, state: State, weights: Mapping[str, float], switching_cost: float = 0.0
    ) -> None:
        network = state.network
        self._weights = weights
        self._gains: dict[Node, list[tuple[Estimation, float]]] = {}
        total = 1.0 + switching_cost * len(network.components)
        for estimation in network.model.estimations:
            weight = weights.get(estimation.attribute)
            if weight:
                gain = weight * estimation.adds
                gains = self._gains.setdefault(network.find(estimation.causer), [])
                gains.append((estimation, gain))
                total += abs(gain)
        self._scale = 10.0 ** (DIGITS - math.ceil(math.log10(total)))
        self._cost = round(switching_cost * self._scale)
        self._cp = load_cp_model()
        self._model: Untyped = self._cp.CpModel()
        self._worth: list[Untyped] = []
        self._levels: dict[str, list[tuple[Untyped, int]]] = {}
        self._options: dict[Node, Mapping[Node | None, Untyped]] = {}
        self.is_weighed = False
        self._encode(state)

    def solve(self, effort: float = 0.3) -> Optimum | None:
        """Return the best choice found within an effort, None if none was found.

        Of equally good ones it is one of those whose parts come first by priority and name: the sum
        of their ranks is lowest.
        """
        cp = self._cp
        solver: Untyped = cp.CpSolver()
        for name, value in _SETTINGS.items():
            setattr(solver.parameters, name, value)
        solver.parameters.max_deterministic_time = effort
        tables = self._options.values()
        ranks = [literal * rank for table in tables for rank, literal in enumerate(table.values())]
        more_than_ranks = 1 + sum(map(len, tables))
        worth = sum(self._worth)
        self._model.maximize(worth * more_than_ranks - sum(ranks))
        status = solver.solve(self._model)
        if status not in (cp.OPTIMAL, cp.FEASIBLE):
            return None
        value = solver.value(worth)
        bound = value
        if status == cp.FEASIBLE:
            bound = math.floor(solver.best_objective_bound / more_than_ranks) + 1
        is_proven = status == cp.OPTIMAL
        best = "the best" if is_proven else f"the best found with an effort of {effort:g}"
        goal = ", ".join(
            name if weight == 1.0 else f"{weight:g} {name}"
            for name, weight in self._weights.items()
        )
        reason = f"of all choices this is {best} for {goal}, worth {value / self._scale:.12g}"
        choice = Choice({}, {}, reason)
        for owner, options in self._options.items():
            for node, literal in options.items():
                if node is not None and solver.value(literal):
                    is_design = node.kind == "function design"
                    names: Any = choice.designs if is_design else choice.configurations
                    names[owner.name] = node.name
        return Optimum(choice, value / self._scale, bound / self._scale, is_proven)

    def _encode(self, state: State) -> None:
        kept = []  # designs of functions that are stuck with what they have
        components: set[Node] = set()
        for node in state.obsolete():
            if node.kind == "component":
                self._add(1, (), self._cost_to_switch(node))
        for node in state.network.functions.values():
            if not state.is_required(node):
                continue
            designs = ranked(state, node)
            if designs:
                self._options[node] = {design: self._literal([design]) for design in designs}
                self._model.add_exactly_one(self._options[node].values())
            else:
                kept += [design for design in node.requires if design in state.selected]
            components.update(part for design in node.requires for part in design.requires)
        self._add(1, kept)
        for node in in_order(components):
            is_kept = any(node in design.requires for design in kept)
            self._component(state, node, is_kept)
        self._worth += [self._worst(levels) for levels in self._levels.values()]

    def _component(self, state: State, node: Node, is_kept: bool) -> None:
        """Encode that one configuration is chosen if the component is needed, else none."""
        to_switch = self._cost_to_switch(node)
        is_active = node in state.active
        to_start = 0 if is_active else to_switch
        selected = [part for part in node.requires if part in state.selected]
        options: dict[Node | None, Untyped] = {}
        for part in ranked(state, node):
            to_configure = 0 if part in selected else self._cost
            options[part] = self._literal([node, part], to_start + to_configure)
        if not options:
            options[None] = self._literal([node, *selected], to_start)
        needed = self._model.new_bool_var("")
        self._model.add(sum(options.values()) == needed)
        users = []
        for function in dict.fromkeys(design.used_by[0] for design in node.used_by):
            designs = self._options.get(function, {})
            literals = [literal for design, literal in designs.items() if design in node.used_by]
            self._model.add(sum(literals) <= needed)  # at most one of them is chosen
            users += literals
        is_replaceable = any(design.used_by[0] in self._options for design in state.users(node))
        self._options[node] = options
        stays = is_active and not is_replaceable
        if is_kept or (stays and node in state.asserted_required):
            self._model.add(needed == 1)
        else:
            self._model.add_bool_or([*users, ~needed])
        if stays:  # a plan stops only what it replaces or what is obsolete
            self._add(1 - needed, [node, *selected])
        elif is_active:
            self._add(1 - needed, (), to_switch)

    def _cost_to_switch(self, component: Node) -> int:
        """Return the cost of starting or stopping a component; a plain one is not switched."""
        is_plain = component.element.kind is ComponentKind.PLAIN
        return 0 if is_plain else self._cost

    def _literal(self, nodes: list[Node], cost: int = 0) -> Untyped:
        """Return a variable for a choice."""
        literal = self._model.new_bool_var("")
        self._add(literal, nodes, cost)
        return literal

    def _add(self, literal: Untyped, nodes: Iterable[Node], cost: int = 0) -> None:
        """Add estimations, less a switching cost, to the worth where a literal is true."""
        worth = -cost
        for estimation, gain in [pair for node in nodes for pair in self._gains.get(node, ())]:
            self.is_weighed = True
            amount = round(gain * self._scale)
            if estimation.kind is EstimationKind.ABSOLUTE:
                self._levels.setdefault(estimation.attribute, []).append((literal, amount))
            else:
                worth += amount
        self._worth.append(literal * worth)

    def _worst(self, levels: list[tuple[Untyped, int]]) -> Untyped:
        """Return a variable that is at most the worst chosen level, or 0 if none is chosen."""
        amounts = [0, *(amount for _, amount in levels)]
        high = max(amounts)
        worst = self._model.new_int_var(min(amounts), high, "")
        is_unset = self._model.new_bool_var("")
        for literal, amount in (*levels, (is_unset, 0)):
            self._model.add(worst <= high - (high - amount) * literal)
        self._model.add(sum(literal for literal, _ in levels) + is_unset >= 1)
        return worst
