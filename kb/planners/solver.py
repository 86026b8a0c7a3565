"""The best joint choice of designs and configurations, proven by CP-SAT.

The only file that imports OR-tools; import it late, as that is slow. One worker, a fixed seed and an effort that is
counted in work instead of seconds make the answer the same on every machine.

The problem is a list of slots with options. A slot is a function, for which one design is chosen, or a component, for
which one configuration is chosen if a chosen design needs it; the estimations of what is chosen add up. All numbers
are whole, so that comparing two choices is exact.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal, localcontext
from typing import Any, Final, NamedTuple

from kb.elements import ComponentKind, EstimationKind
from kb.exceptions import KnowledgeBaseError
from kb.network import Node
from kb.planners import Choice, Criterion, Optimum, number, ranked
from kb.state import State

try:
    from ortools.sat.python import cp_model
except ImportError as error:
    missing = "the best configuration is proven with OR-tools, which is not installed"
    raise KnowledgeBaseError(f"{missing}; pip install 'rosa-taca[optimal]' brings it") from error

DIGITS: Final = 12
"""The most digits of the sum of all amounts of a kind as whole numbers; beyond that they are rounded."""

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


class Estimated(NamedTuple):
    """The amounts that one estimation adds if its causer is chosen."""

    attribute: str
    gain: int
    is_level: bool  # it is absolute: only the worst of its attribute counts
    loads: tuple[int, ...]  # one for each budget


class Slot(NamedTuple):
    """A function, or a component of a design, and a literal for each option, in order of priority."""

    node: Node
    options: Mapping[
        Node | None, Untyped
    ]  # the only option of a component without configurations is None
    idle: Node | None = (
        None  # the configuration to select even if nothing needs the component, if any
    )


class Problem:
    """The problem of choosing for all that is required in a state; solved once.

    It copies what it needs from the state, which is quick; the state may change while the problem is solved.

    Attributes:
        is_weighed: an estimation or a budget concerns what takes part; if not, priority decides.

    Raises:
        UnknownName: the criterion names an attribute or a component that the model does not have.
    """

    def __init__(self, state: State, criterion: Criterion) -> None:
        criterion.check(state.network)
        self._criterion = criterion
        required = (node for node in state.network.functions.values() if state.required[node.index])
        self._designs = {node: ranked(state, node) for node in required}
        stuck = [node for node, designs in self._designs.items() if not designs]
        self._kept = [
            design for node in stuck for design in node.parts if state.selected[design.index]
        ]
        parts = {part for node in self._designs for design in node.parts for part in design.parts}
        self._parts = {
            node: ranked(state, node) for node in sorted(parts, key=lambda node: node.index)
        }
        self._obsolete = [one for one in state.obsolete.nodes() if one.kind == "component"]
        choices = (one for node in (*self._designs, *self._parts) for one in node.parts)
        self._selected = {one for one in choices if state.selected[one.index]}
        self._active = {node for node in parts if state.active[node.index]}
        self._asserted = {node for node in parts if state.asserted_required[node.index]}
        self._given_up = {
            node
            for node in parts
            if any(self._designs.get(design.wholes[0]) for design in state.users[node.index])
        }

        names = {
            *criterion.budgets,
            *(name for name, weight in criterion.weights.items() if weight),
        }
        estimations = (one for one in state.network.model.estimations if one.attribute in names)
        self._causers = {one: state.network.find(one.causer) for one in estimations}
        possible = [design for designs in self._designs.values() for design in designs]
        concerned = {
            *self._parts,
            *(one for node in self._parts for one in node.parts),
            *self._kept,
            *possible,
        }
        self.is_weighed = bool(criterion.budgets) or not concerned.isdisjoint(
            self._causers.values()
        )

    # ---------------------------------------------------------------- the model

    def _encode(self) -> None:
        self._model: Any = cp_model.CpModel()
        self._gains, self._switching = list[Untyped](), list[Untyped]()
        self._loads: list[list[Untyped]] = [[] for _ in self._criterion.budgets]
        self._levels: dict[str, list[tuple[Untyped, int]]] = {}
        self._users: dict[Node, list[list[Untyped]]] = {node: [] for node in self._parts}
        self._add(1, *self._kept, cost=sum(self._cost_to_switch(node) for node in self._obsolete))
        self._slots = [
            self._function(node, designs) for node, designs in self._designs.items() if designs
        ]
        self._slots += [self._component(node, possible) for node, possible in self._parts.items()]
        self._gain = cp_model.LinearExpr.sum(
            [*self._gains, *map(self._worst, self._levels.values())]
        )
        self._cost = cp_model.LinearExpr.sum(self._switching)

    def _estimate(self) -> None:
        """Find the units in which all amounts are whole, and the estimated amounts of each causer."""
        criterion = self._criterion
        weights = {name: _decimal(weight) for name, weight in criterion.weights.items() if weight}
        limits = {name: _decimal(limit) for name, limit in criterion.budgets.items()}
        values = [_decimal(one.adds) for one in self._causers]
        gains = [
            weights.get(one.attribute, 0) * value
            for one, value in zip(self._causers, values, strict=True)
        ]
        costs = {
            node: _decimal(criterion.cost_of(node.name)) for node in (*self._parts, *self._obsolete)
        }
        amounts = [*gains, *costs.values()]
        self._unit, is_exact = _unit(amounts)  # the worth of a gain of 1
        self._resolution = 0.0 if is_exact else float(self._unit * len(amounts))
        loads = {name: [limit] for name, limit in limits.items()}
        for one, value in zip(self._causers, values, strict=True):
            loads.get(one.attribute, []).append(value)
        self._load_units = {name: _unit(amounts)[0] for name, amounts in loads.items()}
        self._limits = [
            _whole(limits[name], unit, ROUND_FLOOR) for name, unit in self._load_units.items()
        ]
        self._costs = {node: _whole(cost, self._unit) for node, cost in costs.items()}
        self._estimated: dict[Node, list[Estimated]] = {}
        for (one, causer), value, amount in zip(self._causers.items(), values, gains, strict=True):
            units = self._load_units.items()
            load = tuple(
                _whole(value, unit, ROUND_CEILING) if one.attribute == name else 0
                for name, unit in units
            )
            is_level = one.kind is EstimationKind.ABSOLUTE and one.attribute in weights
            estimated = Estimated(one.attribute, _whole(amount, self._unit), is_level, load)
            self._estimated.setdefault(causer, []).append(estimated)

    def _cost_to_switch(self, component: Node) -> int:
        """Return the cost of starting or stopping a component; a plain one is not switched."""
        return 0 if component.element.kind is ComponentKind.PLAIN else self._costs[component]

    def _add(self, literal: Untyped, *nodes: Node, cost: int = 0) -> None:
        """Add the estimations of nodes, less a switching cost, to the sums that count where a literal is true."""
        estimated = [one for node in nodes for one in self._estimated.get(node, ())]
        for one in estimated:
            if one.is_level:
                self._levels.setdefault(one.attribute, []).append((literal, one.gain))
        gain = sum(one.gain for one in estimated if not one.is_level) - cost
        loads = (sum(one.loads[place] for one in estimated) for place in range(len(self._loads)))
        for terms, amount in zip(
            (self._gains, self._switching, *self._loads), (gain, cost, *loads), strict=True
        ):
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
            one: self._literal(one, is_now=one in self._selected) for one in designs
        }
        self._model.add_exactly_one(options.values())
        for part in dict.fromkeys(part for one in designs for part in one.parts):
            self._users[part].append([options[one] for one in designs if part in one.parts])
        return Slot(node, options)

    def _component(self, node: Node, nodes: Sequence[Node]) -> Slot:
        """Encode that one configuration is chosen if the component is needed, and none otherwise."""
        cost, to_switch = self._costs[node], self._cost_to_switch(node)
        active, asserted = node in self._active, node in self._asserted
        selected = [one for one in node.parts if one in self._selected]
        # a plan stops only what it replaces or what is obsolete; all else stays active
        stays = active and node not in self._given_up
        to_start = 0 if active else to_switch
        options: dict[Node | None, Untyped] = {
            one: self._literal(
                node, one, is_now=one in selected, cost=to_start + (0 if one in selected else cost)
            )
            for one in nodes
        } or {None: self._literal(node, *selected, is_now=False, cost=to_start)}

        model, needed = self._model, self._model.new_bool_var("")
        for users in self._users[node]:  # of one function at most one option is chosen
            model.add(cp_model.LinearExpr.sum(users) <= needed)
        if (stays and asserted) or any(node in design.parts for design in self._kept):
            model.add(needed == 1)
        else:
            model.add_bool_or(
                [*(literal for users in self._users[node] for literal in users), ~needed]
            )
        model.add(cp_model.LinearExpr.sum([*options.values()]) == needed)

        if stays:
            self._add(1 - needed, node, *selected)
            return Slot(node, options)
        idle = (
            next((one for one in nodes if cost and one in selected), nodes[0])
            if asserted and nodes
            else None
        )
        to_stop = (to_switch if active else 0) + (cost if idle and idle not in selected else 0)
        self._add(1 - needed, cost=to_stop)
        return Slot(node, options, idle)

    def _worst(self, levels: Sequence[tuple[Untyped, int]]) -> Untyped:
        """Return a variable that is at most the worst chosen level, or 0 if none is chosen."""
        low, high = min(0, *(level for _, level in levels)), max(0, *(level for _, level in levels))
        worst, unset = self._model.new_int_var(low, high, ""), self._model.new_bool_var("")
        for literal, level in levels:
            self._model.add(worst <= high - (high - level) * literal)
        self._model.add(worst <= high - high * unset)
        self._model.add(cp_model.LinearExpr.sum([literal for literal, _ in levels]) + unset >= 1)
        return worst

    # ---------------------------------------------------------------- the search

    def solve(self, effort: float = 0.3) -> Optimum:
        """Return the best choice found within an effort [CP-SAT's deterministic time]; of equally good ones the first.

        The order of choices is by priority and name of the design of the function declared first, then of the next
        function, and so on, and then by the configurations of the components in the same way.
        """
        with localcontext(Context(prec=60)):
            self._estimate()
        self._encode()
        model, limits = self._model, self._criterion.limits
        self._effort = self._left = effort
        self._solver: Any = cp_model.CpSolver()
        for name, value in _SETTINGS.items():
            setattr(self._solver.parameters, name, value)
        unlimited = model.clone() if self._limits else model
        for load, limit in zip(self._loads, self._limits, strict=True):
            model.add(cp_model.LinearExpr.sum(load) <= limit)
        model.maximize(self._gain)
        status = self._run(model)
        if status == cp_model.INFEASIBLE:
            return Optimum(is_proven=True, reason=self._why_nothing_fits(unlimited))
        if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
            within = f" that keeps within {limits}" if limits else ""
            reason = f"no choice{within} was found with an effort of {effort:g}"
            return Optimum(resolution=self._resolution, reason=reason)
        gains = round(self._solver.objective_value), round(self._solver.best_objective_bound)
        choice, cost, is_proven = self._choice(), self._solver.value(self._cost), False
        if status == cp_model.OPTIMAL and self._run_for_first(gains[0]) in (
            cp_model.OPTIMAL,
            cp_model.FEASIBLE,
        ):
            choice, cost, is_proven = self._choice(), self._solver.value(self._cost), True
        worth, most, switching = (float(amount * self._unit) for amount in (*gains, cost))
        found = Optimum(choice, worth, switching, most, self._resolution, is_proven)
        return replace(found, reason=self._reason(found))

    def _run(self, model: Untyped) -> Untyped:
        self._solver.parameters.max_deterministic_time = max(self._left, 0.0)
        status = self._solver.solve(model)
        self._left -= self._solver.response_proto.deterministic_time
        return status

    def _run_for_first(self, gain: int) -> Untyped:
        """Find the first choice of that gain; the search goes in the order of choices only without presolving."""
        self._model.add(self._gain >= gain)
        self._model.clear_objective()
        self._model.clear_hints()
        for slot in self._slots:
            self._model.add_decision_strategy(
                [*slot.options.values()], cp_model.CHOOSE_FIRST, cp_model.SELECT_MAX_VALUE
            )
        self._solver.parameters.search_branching = cp_model.FIXED_SEARCH
        self._solver.parameters.cp_model_presolve = False
        return self._run(self._model)

    def _choice(self) -> Choice:
        designs, configurations = dict[str, str](), dict[str, str]()
        for slot in self._slots:
            found = (node for node, literal in slot.options.items() if self._solver.value(literal))
            if (node := next(found, slot.idle)) is not None:
                (designs if slot.node.kind == "function" else configurations)[slot.node.name] = (
                    node.name
                )
        return Choice(designs, configurations)

    def _reason(self, found: Optimum) -> str:
        """Say why the choice is the best, what it is worth, and how sure that is."""
        criterion, effort = self._criterion, f"an effort of {self._effort:g}"
        within = f" within {criterion.limits}" if criterion.limits else ""
        best = f"the best for {criterion.goal}" if criterion.goal else "the first by priority"
        if found.switching and not criterion.goal:
            best = f"the one that is cheapest to switch to ({number(found.switching)}), and then the first by priority"
        worth = f", worth {found.worth}" if criterion.goal else ""
        rounded = (
            f" by more than {number(found.resolution)}, to which its worth was rounded"
            if found.resolution
            else ""
        )
        if found.is_proven and not rounded:
            return f"of all choices{within} this is {best}{worth}"
        if not found.gap:
            unsure = "" if found.is_proven else f"; {effort} did not prove that it comes first"
            return f"no choice{within} is better than this one{rounded}{worth}{unsure}"
        assert found.bound is not None
        left = f"none is worth more than {number(found.bound)} (a gap of {number(found.gap)})"
        return f"this is {best}{within} that {effort} found{worth}; {left}"

    def _why_nothing_fits(self, unlimited: Untyped) -> str:
        """Say which budgets are too small for any choice, as far as this is found within the effort that is left."""
        reasons = []
        for load, limit, (name, unit) in zip(
            self._loads, self._limits, self._load_units.items(), strict=True
        ):
            unlimited.minimize(cp_model.LinearExpr.sum(load))
            if (
                self._run(unlimited) == cp_model.OPTIMAL
                and (least := round(self._solver.objective_value)) > limit
            ):
                least_said, limit_said = number(float(least * unit)), number(float(limit * unit))
                reasons.append(f"{name} would be {least_said} at least, more than {limit_said}")
        return " and ".join(reasons) or f"no choice keeps within {self._criterion.limits}"


def _decimal(number: float) -> Decimal:
    return Decimal(repr(float(number)))


def _unit(amounts: Iterable[Decimal]) -> tuple[Decimal, bool]:
    """Return the unit in which amounts are written as whole numbers, and whether that is exact."""
    decimals, total = 0, Decimal()
    for amount in amounts:
        if amount:
            decimals = max(decimals, -int(amount.normalize().as_tuple().exponent))
            total += abs(amount)
    most = DIGITS - 1 - total.adjusted() if total else decimals
    return Decimal(1).scaleb(-min(decimals, most)), decimals <= most


def _whole(amount: Decimal | int, unit: Decimal, rounding: str = ROUND_HALF_EVEN) -> int:
    return int((amount / unit).to_integral_value(rounding))
