"""The best joint choice of designs and configurations, proven by CP-SAT of OR-tools.

One worker, a fixed seed and an effort that is counted in work instead of seconds make the answer
the same on every machine. All numbers are whole, so that comparing two choices is exact.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal, localcontext
from typing import Any, Final, NamedTuple
from weakref import WeakKeyDictionary

from kb.elements import ComponentKind, EstimationKind, finite_number
from kb.exceptions import InvalidValue, KnowledgeBaseError
from kb.knowledge_base import KnowledgeBase
from kb.network import Node
from kb.planning import (
    Choice,
    Criterion,
    Optimum,
    choice_by_priority,
    number,
    ranked,
    summed_weights,
)
from kb.records import ReconfigurationPlan
from kb.state import State

_log = logging.getLogger(__name__)

DIGITS: Final = 12
"""The most digits of a sum of whole amounts; beyond that they are rounded."""

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


class OptimalPlanner:
    """Chooses the best joint configuration of all that is required.

    It chooses again for all that is required when something is adaptable, or the preferences
    changed since the last choice. Without budgets, and without estimations of a preferred
    attribute, it chooses as `PriorityPlanner` does.

    Args:
        switching_cost: the cost of activating or deactivating a component or changing its
            configuration, the same for all or by name of the component; for a smaller gain nothing
            is switched. Plain components are activated and deactivated at no cost, because they
            are not switched.
        budgets: the most that the estimations of what is chosen or active may sum up to, by
            attribute.
        effort: the most work for one choice, in CP-SAT's deterministic time; 0.3 is about a
            second.

    Attributes:
        latest: the latest result; None before the first, and after a choice by priority.
    """

    def __init__(
        self,
        *,
        switching_cost: float | Mapping[str, float] = 0.0,
        budgets: Mapping[str, float] | None = None,
        effort: float = 0.3,
    ) -> None:
        load_cp_model()
        if finite_number(effort) <= 0.0:
            raise InvalidValue(f"an effort is more than 0, not {effort!r}")
        if not isinstance(budgets, Mapping | None):
            raise InvalidValue(
                f"budgets are given as the most by name of attribute, not as {budgets!r}"
            )
        self._settings = Criterion({}, switching_cost, dict(budgets or {}))
        self._effort = effort
        self._last = WeakKeyDictionary[KnowledgeBase, tuple[Mapping[str, float], str]]()
        """The weights of the last choice, and why there was none, by knowledge base."""
        self.latest: Optimum | None = None

    @property
    def budgets(self) -> Mapping[str, float]:
        """The most that estimations may sum up to, by name of attribute."""
        return self._settings.budgets

    def criterion(self, kb: KnowledgeBase) -> Criterion:
        """Return the criterion by the preferences of the actions that are required now."""
        weights = summed_weights(request.preference for request in kb.required_actions)
        return replace(self._settings, weights=weights)

    def choose(self, kb: KnowledgeBase) -> Choice | None:
        """Return what `plan` would select now; None if there is nothing to do."""
        return _choice(kb, self.optimum(kb) if self._is_due(kb) else None)

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Select for all that is required if it is due; see `Planner`."""
        if kb not in self._last:  # a wrong name is an error at the first update
            with kb.reading() as state:
                self._settings.check(state.network)
        weights = self.criterion(kb).weights
        optimum = None
        if self._is_due(kb):
            optimum = self.latest = self.optimum(kb)
        why_none = optimum.reason if optimum is not None and optimum.choice is None else ""
        if why_none and why_none != self._last.get(kb, ({}, ""))[1]:
            _log.warning("nothing can be selected: %s", why_none)
        choice = _choice(kb, optimum)
        plan = None if choice is None else kb.select(*choice)
        self._last[kb] = weights, why_none  # last, so that an interrupted choice is repeated
        return plan

    def optimum(self, kb: KnowledgeBase) -> Optimum | None:
        """Return the best choice for the present state; None if priority is to decide.

        Priority decides where nothing is estimated or limited, and where no choice was found
        within the effort.
        """
        criterion = self.criterion(kb)
        with kb.reading() as state:
            problem = Problem(state, criterion)
        if not problem.is_weighed:
            return None
        optimum = problem.solve(self._effort)
        if optimum.choice is None and not optimum.is_proven and not criterion.budgets:
            return None
        return optimum

    def _is_due(self, kb: KnowledgeBase) -> bool:
        if kb.adaptable_functions() or kb.adaptable_components():
            return True
        return kb in self._last and self._last[kb][0] != self.criterion(kb).weights


def _choice(kb: KnowledgeBase, optimum: Optimum | None) -> Choice | None:
    """Return what to select; an empty choice only gives up what is obsolete."""
    with kb.reading() as state:
        if optimum is None:
            return choice_by_priority(state)
        choice = optimum.choice
        if choice is None or not (choice.designs or choice.configurations):
            return Choice({}, {}) if state.obsolete() else None
        network = state.network
        chosen = [network.designs[name] for name in choice.designs.values()]
        chosen += [network.configurations[name] for name in choice.configurations.values()]
        if all(node in state.selected for node in chosen):
            return Choice({}, {})  # `kb.select` says why the plan is needed all the same
        return Choice(choice.designs, choice.configurations, optimum.reason)


class Estimated(NamedTuple):
    """The whole amounts that one estimation adds if its causer is chosen."""

    attribute: str
    gain: int
    is_level: bool  # it is absolute: only the worst of its attribute counts
    loads: tuple[int, ...]  # one for each budget


@dataclass(frozen=True, slots=True)
class Slot:
    """A function, or a component of a design, and a literal for each option, in order of priority.

    The only option of a component without configurations is None.
    """

    node: Node
    options: Mapping[Node | None, Untyped]
    if_idle: Node | None = (
        None  # the configuration to select if no chosen design needs the component
    )


class Problem:
    """The problem of choosing for all that is required in a state; solved once.

    A slot is a function, for which one design is chosen, or a component, for which one
    configuration is chosen if a chosen design needs it. The estimations of what is chosen add up.
    The problem copies what it needs from the state, so the state may change while the problem is
    solved.

    Attributes:
        is_weighed: an estimation or a budget concerns what takes part; if not, priority decides.

    Raises:
        UnknownName: the criterion names an attribute or a component that the model does not have.
    """

    def __init__(self, state: State, criterion: Criterion) -> None:
        criterion.check(state.network)
        self._criterion = criterion
        functions = [node for node in state.network.functions.values() if state.is_required(node)]
        self._designs = {node: ranked(state, node) for node in functions}
        self._kept = [  # of functions that are stuck with what they have
            design
            for node, designs in self._designs.items()
            for design in node.requires
            if not designs and design in state.selected
        ]
        components = {
            part for node in functions for design in node.requires for part in design.requires
        }
        in_order = sorted(components, key=lambda node: node.index)
        self._components = {node: ranked(state, node) for node in in_order}
        self._obsolete = [node for node in state.obsolete() if node.kind == "component"]
        choices = [part for node in (*functions, *in_order) for part in node.requires]
        self._selected = {node for node in choices if node in state.selected}
        self._active = {node for node in components if node in state.active}
        self._asserted = {node for node in components if node in state.asserted_required}
        self._replaceable = {  # a plan stops only what it replaces or what is obsolete
            node
            for node in components
            if any(
                design in state.selected and self._designs.get(design.used_by[0])
                for design in node.used_by
            )
        }
        names = {name for name, weight in criterion.weights.items() if weight}
        names.update(criterion.budgets)
        self._causers = {
            estimation: state.network.find(estimation.causer)
            for estimation in state.network.model.estimations
            if estimation.attribute in names
        }
        concerned = {*in_order, *self._kept}
        for possible in (*self._designs.values(), *(node.requires for node in in_order)):
            concerned.update(possible)
        is_estimated = not concerned.isdisjoint(self._causers.values())
        self.is_weighed = bool(criterion.budgets) or is_estimated

    def solve(self, effort: float = 0.3) -> Optimum:
        """Return the best choice found within an effort; of equally good ones the first.

        The order of choices is by priority and name of the design of the function declared first,
        then of the next function, and so on, and then by the configurations of the components in
        the same way.
        """
        self._cp = load_cp_model()
        with localcontext(Context(prec=60)):
            self._estimate()
        self._encode()
        self._effort = self._left = effort
        self._solver: Untyped = self._cp.CpSolver()
        for name, value in _SETTINGS.items():
            setattr(self._solver.parameters, name, value)
        model = self._model
        unlimited = model.clone() if self._limits else model
        for load, limit in zip(self._loads, self._limits, strict=True):
            model.add(self._sum(load) <= limit)
        model.maximize(self._gain)
        status = self._run(model)
        if status == self._cp.INFEASIBLE:
            return Optimum(is_proven=True, reason=self._why_nothing_fits(unlimited))
        if not self._is_solved(status):
            within = f" that keeps within {self._criterion.limits}" if self._limits else ""
            reason = f"no choice{within} was found with an effort of {effort:g}"
            return Optimum(resolution=self._resolution, reason=reason)
        gain = round(self._solver.objective_value)
        bound = round(self._solver.best_objective_bound)
        choice = self._read_choice()
        cost = self._solver.value(self._cost)
        is_proven = status == self._cp.OPTIMAL and self._is_solved(self._run_for_first(gain))
        if is_proven:
            choice = self._read_choice()
            cost = self._solver.value(self._cost)
        optimum = Optimum(
            choice,
            float(gain * self._unit),
            float(cost * self._unit),
            float(bound * self._unit),
            self._resolution,
            is_proven,
        )
        return replace(optimum, reason=self._reason(optimum))

    # ---------------------------------------------------------------- amounts as whole numbers

    def _estimate(self) -> None:
        """Find the units in which all amounts are whole, and the amounts of each causer."""
        criterion = self._criterion
        weights = {name: _decimal(weight) for name, weight in criterion.weights.items() if weight}
        values = {estimation: _decimal(estimation.adds) for estimation in self._causers}
        gains = {
            estimation: weights.get(estimation.attribute, Decimal()) * value
            for estimation, value in values.items()
        }
        costs = {
            node: _decimal(criterion.cost_of(node.name))
            for node in (*self._components, *self._obsolete)
        }
        amounts = [*gains.values(), *costs.values()]
        self._unit, is_exact = _unit(amounts)  # the worth of a gain of 1
        self._resolution = 0.0 if is_exact else float(self._unit * len(amounts))
        self._costs = {node: _whole(cost, self._unit) for node, cost in costs.items()}
        self._load_units: dict[str, Decimal] = {}
        self._limits = []
        for name, limit in criterion.budgets.items():
            loads = [value for estimation, value in values.items() if estimation.attribute == name]
            unit, _ = _unit([_decimal(limit), *loads])
            self._load_units[name] = unit
            self._limits.append(_whole(_decimal(limit), unit, ROUND_FLOOR))
        self._estimated: dict[Node, list[Estimated]] = {}
        for estimation, causer in self._causers.items():
            attribute = estimation.attribute
            loads_by_budget = tuple(
                _whole(values[estimation], unit, ROUND_CEILING) if name == attribute else 0
                for name, unit in self._load_units.items()
            )
            is_level = estimation.kind is EstimationKind.ABSOLUTE and attribute in weights
            gain = _whole(gains[estimation], self._unit)
            estimated = Estimated(attribute, gain, is_level, loads_by_budget)
            self._estimated.setdefault(causer, []).append(estimated)

    # ---------------------------------------------------------------- the model

    def _encode(self) -> None:
        self._model: Untyped = self._cp.CpModel()
        self._sum = self._cp.LinearExpr.sum
        self._gains: list[Untyped] = []
        self._switching: list[Untyped] = []
        self._loads: list[list[Untyped]] = [[] for _ in self._limits]
        self._levels: dict[str, list[tuple[Untyped, int]]] = {}
        self._users: dict[Node, list[list[Untyped]]] = {node: [] for node in self._components}
        self._add(1, *self._kept, cost=sum(self._cost_to_switch(node) for node in self._obsolete))
        self._slots = []
        for node, designs in self._designs.items():
            if designs:
                self._slots.append(self._function(node, designs))
        for node, configurations in self._components.items():
            self._slots.append(self._component(node, configurations))
        worst_levels = [self._worst(levels) for levels in self._levels.values()]
        self._gain = self._sum([*self._gains, *worst_levels])
        self._cost = self._sum(self._switching)

    def _cost_to_switch(self, component: Node) -> int:
        """Return the cost of starting or stopping a component; a plain one is not switched."""
        return 0 if component.element.kind is ComponentKind.PLAIN else self._costs[component]

    def _add(self, literal: Untyped, *nodes: Node, cost: int = 0) -> None:
        """Add estimations, less a switching cost, to the sums where a literal is true."""
        gain = -cost
        loads = [0] * len(self._loads)
        for estimated in (one for node in nodes for one in self._estimated.get(node, ())):
            if estimated.is_level:
                self._levels.setdefault(estimated.attribute, []).append((literal, estimated.gain))
            else:
                gain += estimated.gain
            loads = [load + more for load, more in zip(loads, estimated.loads, strict=True)]
        sums = (self._gains, self._switching, *self._loads)
        for terms, amount in zip(sums, (gain, cost, *loads), strict=True):
            if amount:
                terms.append(literal * amount)

    def _literal(self, *nodes: Node, is_now: bool, cost: int = 0) -> Untyped:
        literal = self._model.new_bool_var("")
        self._model.add_hint(literal, is_now)
        self._add(literal, *nodes, cost=cost)
        return literal

    def _function(self, node: Node, designs: Sequence[Node]) -> Slot:
        """Encode that exactly one design is chosen, and note which options need which component."""
        options: dict[Node | None, Untyped] = {
            design: self._literal(design, is_now=design in self._selected) for design in designs
        }
        self._model.add_exactly_one(options.values())
        for part in dict.fromkeys(part for design in designs for part in design.requires):
            users = [options[design] for design in designs if part in design.requires]
            self._users[part].append(users)
        return Slot(node, options)

    def _component(self, node: Node, configurations: Sequence[Node]) -> Slot:
        """Encode that one configuration is chosen if the component is needed, else none."""
        cost = self._costs[node]
        to_switch = self._cost_to_switch(node)
        is_active = node in self._active
        is_asserted = node in self._asserted
        selected = [part for part in node.requires if part in self._selected]
        stays = is_active and node not in self._replaceable
        to_start = 0 if is_active else to_switch
        options: dict[Node | None, Untyped] = {}
        for part in configurations:
            is_now = part in selected
            change = to_start + (0 if is_now else cost)
            options[part] = self._literal(node, part, is_now=is_now, cost=change)
        if not options:
            options[None] = self._literal(node, *selected, is_now=False, cost=to_start)

        needed = self._model.new_bool_var("")
        users = self._users[node]
        for users_of_function in users:  # at most one of them is chosen
            self._model.add(self._sum(users_of_function) <= needed)
        if (stays and is_asserted) or any(node in design.requires for design in self._kept):
            self._model.add(needed == 1)
        else:
            every = [literal for users_of_function in users for literal in users_of_function]
            self._model.add_bool_or([*every, ~needed])
        self._model.add(self._sum([*options.values()]) == needed)

        if stays:
            self._add(1 - needed, node, *selected)
            return Slot(node, options)
        if is_active:  # not needed, it is given up, and a configuration is never chosen for it
            self._add(1 - needed, cost=to_switch)
            return Slot(node, options)
        if_idle = None
        if is_asserted and configurations:
            unchanged = [part for part in configurations if cost and part in selected]
            if_idle = (unchanged or configurations)[0]
        to_configure = cost if if_idle and if_idle not in selected else 0
        self._add(1 - needed, cost=to_configure)
        return Slot(node, options, if_idle)

    def _worst(self, levels: Sequence[tuple[Untyped, int]]) -> Untyped:
        """Return a variable that is at most the worst chosen level, or 0 if none is chosen."""
        amounts = [amount for _, amount in levels]
        low = min(0, *amounts)
        high = max(0, *amounts)
        worst = self._model.new_int_var(low, high, "")
        is_unset = self._model.new_bool_var("")
        for literal, amount in levels:
            self._model.add(worst <= high - (high - amount) * literal)
        self._model.add(worst <= high - high * is_unset)
        self._model.add(self._sum([literal for literal, _ in levels]) + is_unset >= 1)
        return worst

    # ---------------------------------------------------------------- the search

    def _run(self, model: Untyped) -> Untyped:
        self._solver.parameters.max_deterministic_time = max(self._left, 0.0)
        status = self._solver.solve(model)
        self._left -= self._solver.response_proto.deterministic_time
        return status

    def _is_solved(self, status: Untyped) -> bool:
        return status in (self._cp.OPTIMAL, self._cp.FEASIBLE)

    def _run_for_first(self, gain: int) -> Untyped:
        """Find the first choice of that gain; presolving would change the order."""
        self._model.add(self._gain >= gain)
        self._model.clear_objective()
        self._model.clear_hints()
        for slot in self._slots:
            literals = [*slot.options.values()]
            order = (self._cp.CHOOSE_FIRST, self._cp.SELECT_MAX_VALUE)
            self._model.add_decision_strategy(literals, *order)
        self._solver.parameters.search_branching = self._cp.FIXED_SEARCH
        self._solver.parameters.cp_model_presolve = False
        return self._run(self._model)

    def _read_choice(self) -> Choice:
        designs: dict[str, str] = {}
        configurations: dict[str, str] = {}
        for slot in self._slots:
            chosen = [node for node, literal in slot.options.items() if self._solver.value(literal)]
            node = chosen[0] if chosen else slot.if_idle
            if node is not None:
                names = designs if slot.node.kind == "function" else configurations
                names[slot.node.name] = node.name
        return Choice(designs, configurations)

    # ---------------------------------------------------------------- in words

    def _reason(self, optimum: Optimum) -> str:
        """Say why the choice is the best, what it is worth, and how sure that is."""
        criterion = self._criterion
        effort = f"an effort of {self._effort:g}"
        within = f" within {criterion.limits}" if criterion.limits else ""
        worth = f", worth {optimum.worth}" if criterion.goal else ""
        best = "the first by priority"
        if criterion.goal:
            best = f"the best for {criterion.goal}"
        elif optimum.switching:
            cost = number(optimum.switching)
            best = f"the one that is cheapest to switch to ({cost}), and then the first by priority"
        rounded = ""
        if optimum.resolution:
            resolution = number(optimum.resolution)
            rounded = f" by more than {resolution}, to which its worth was rounded"
        if optimum.is_proven and not rounded:
            return f"of all choices{within} this is {best}{worth}"
        if not optimum.gap:
            unsure = "" if optimum.is_proven else f"; {effort} did not prove that it comes first"
            return f"no choice{within} is better than this one{rounded}{worth}{unsure}"
        assert optimum.bound is not None
        gap = f"none is worth more than {number(optimum.bound)} (a gap of {number(optimum.gap)})"
        return f"this is {best}{within} that {effort} found{worth}; {gap}"

    def _why_nothing_fits(self, unlimited: Untyped) -> str:
        """Return which budgets are too small for any choice, as far as the effort allows."""
        reasons = []
        units = self._load_units.items()
        for load, limit, (name, unit) in zip(self._loads, self._limits, units, strict=True):
            unlimited.minimize(self._sum(load))
            if self._run(unlimited) != self._cp.OPTIMAL:
                continue
            least = round(self._solver.objective_value)
            if least > limit:
                at_least = f"{name} would be {number(float(least * unit))} at least"
                reasons.append(f"{at_least}, more than {number(float(limit * unit))}")
        return " and ".join(reasons) or f"no choice keeps within {self._criterion.limits}"


def _decimal(value: float) -> Decimal:
    return Decimal(repr(float(value)))


def _unit(amounts: Iterable[Decimal]) -> tuple[Decimal, bool]:
    """Return the unit in which amounts are written as whole numbers, and whether that is exact."""
    decimals = 0
    total = Decimal()
    for amount in amounts:
        if amount:
            decimals = max(decimals, -int(amount.normalize().as_tuple().exponent))
            total += abs(amount)
    most = DIGITS - 1 - total.adjusted() if total else decimals
    return Decimal(1).scaleb(-min(decimals, most)), decimals <= most


def _whole(amount: Decimal, unit: Decimal, rounding: str = ROUND_HALF_EVEN) -> int:
    return int((amount / unit).to_integral_value(rounding))
