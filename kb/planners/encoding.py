"""The joint choice of designs and configurations as numbers: what each possibility adds, and what it needs.

What is left of a model is small: slots with options. A slot is a function, of which one design is chosen, or a
component, of which one configuration is chosen if a chosen design needs it; the effects of what is chosen add up. All
numbers are whole, so that of two choices one is better or they are exactly as good.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context, Decimal, localcontext
from functools import reduce
from typing import Final, NamedTuple

from kb.elements import ComponentKind, EstimationKind
from kb.network import Network, Node
from kb.planners.choice import Choice, Criterion, ranked
from kb.state import State

DIGITS: Final = 12
"""All amounts of a kind together have no more digits than this as whole numbers; else they are rounded."""

Picks = tuple[int, ...]
"""Position of what is chosen among the options of each slot."""


class Effect(NamedTuple):
    """What something adds."""

    gain: int  # to the value of the choice; the cost is taken off already
    loads: tuple[int, ...]  # to what each budget limits
    levels: tuple[tuple[str, int], ...] = ()  # weighted absolute estimations by attribute; only the worst counts
    cost: int = 0  # of switching

    def plus(self, other: "Effect") -> "Effect":
        loads = tuple(mine + its for mine, its in zip(self.loads, other.loads, strict=True))
        return Effect(self.gain + other.gain, loads, self.levels + other.levels, self.cost + other.cost)

    def costing(self, cost: int) -> "Effect":
        return self._replace(gain=self.gain - cost, cost=self.cost + cost)


class Option(NamedTuple):
    """One possibility: a design or configuration, or None for a component that has nothing to be chosen."""

    node: Node | None
    effect: Effect  # that of a configuration includes that its component runs
    is_now: bool = False  # it is selected now
    needs: frozenset[int] = frozenset()  # positions of the slots of a design's components


class Slot(NamedTuple):
    """A function, or a component of some design."""

    node: Node
    options: tuple[Option, ...]  # one of these is chosen if it is needed; the first by priority first
    idle: Effect  # what it adds if nothing needs it
    idle_node: Node | None = None  # the configuration to select even then, if any
    is_needed: bool = True  # it is needed whatever is chosen; a function always is

    @property
    def is_function(self) -> bool:
        return self.node.kind == "function"


@dataclass(frozen=True, slots=True)
class Problem:
    """What is to be chosen."""

    criterion: Criterion
    slots: tuple[Slot, ...]  # in order of declaration; functions before components
    fixed: Effect  # what is added whatever is chosen
    limits: tuple[int, ...]  # what the load of each budget must not exceed
    is_by_priority: bool  # nothing is estimated of what takes part, and nothing limited
    unit: Decimal  # what a gain of 1 stands for
    load_units: tuple[Decimal, ...]  # what a load of 1 stands for, for each budget
    resolution: float  # choices that differ by no more than this can seem equally good; 0 if all numbers are exact

    def choice(self, picks: Picks) -> Choice:
        """Return a choice by name; configurations that use more of a budget than now come after the others."""
        chosen = list(zip(self.slots, picks, strict=True))
        picked = ((slot.node, slot.options[pick].node) for slot, pick in chosen if slot.is_function)
        designs = {function: design for function, design in picked if design is not None}
        running = {part for design in designs.values() for part in design.parts}
        configurations = {}
        for slot, pick in sorted((one for one in chosen if not one[0].is_function), key=lambda one: _uses_more(*one)):
            node = slot.options[pick].node if slot.is_needed or slot.node in running else slot.idle_node
            if node is not None:
                configurations[slot.node.name] = node.name
        return Choice({node.name: design.name for node, design in designs.items()}, configurations)


def encode(state: State, criterion: Criterion) -> Problem:
    """Return what is to be chosen in a state for all that is required, from what runs and is selected now.

    Raises:
        UnknownName: the criterion names an attribute or a component that the model does not have.
    """
    check_names(state.network, criterion)
    with localcontext(Context(prec=60)):
        return _Encoder(state, criterion).problem()


def check_names(network: Network, criterion: Criterion) -> None:
    """Raise `UnknownName` unless the model has all that a criterion names."""
    costs = criterion.switching_cost
    for name in (*criterion.weights, *criterion.budgets):
        network.attributes[name]
    for name in costs if isinstance(costs, Mapping) else ():
        network.components[name]


class _Encoder:
    """Encodes one problem; see `encode`."""

    def __init__(self, state: State, criterion: Criterion) -> None:
        self._state = state
        self._criterion = criterion
        required = (node for node in state.network.functions.values() if state.required[node.index])
        self._designs = {node: ranked(state, node) for node in required}
        stuck = [node for node, designs in self._designs.items() if not designs]
        self._kept = [design for node in stuck for design in node.parts if state.selected[design.index]]
        all_designs = [design for node in self._designs for design in node.parts]
        self._parts = list(dict.fromkeys(part for design in all_designs for part in design.parts))
        self._obsolete = [one for one in state.obsolete.nodes() if one.kind == "component"]
        self._nothing = Effect(0, (0,) * len(criterion.budgets))
        self._estimated: dict[Node, Effect] = {}
        self._costs: dict[Node, int] = {}
        self._estimate()

    def problem(self) -> Problem:
        components = [self._component(node) for node in sorted(self._parts, key=lambda node: node.index)]
        functions = {node: designs for node, designs in self._designs.items() if designs}
        places = {one.node: place for place, one in enumerate(components, len(functions))}
        concerned = [*self._parts, *(one for node in self._parts for one in node.parts), *self._kept]
        concerned += [design for designs in self._designs.values() for design in designs]
        stopping = sum(self._cost_to_switch(node) for node in self._obsolete)
        return Problem(
            self._criterion,
            (*(self._function(node, designs, places) for node, designs in functions.items()), *components),
            self._effect(*self._kept).costing(stopping),
            self._limits,
            not self._criterion.budgets and not any(node in self._estimated for node in concerned),
            self._unit,
            self._load_units,
            self._resolution,
        )

    def _estimate(self) -> None:
        """Find the units in which all amounts are whole, and sum up what is estimated of each causer."""
        criterion, network = self._criterion, self._state.network
        weights = {name: _decimal(weight) for name, weight in criterion.weights.items() if weight}
        limits = {name: _decimal(limit) for name, limit in criterion.budgets.items()}
        estimations = [one for one in network.model.estimations if one.attribute in weights or one.attribute in limits]
        values = [_decimal(one.value) * (-1 if one.kind is EstimationKind.NEGATIVE else 1) for one in estimations]
        gains = [weights.get(one.attribute, 0) * value for one, value in zip(estimations, values, strict=True)]
        costs = {node: _decimal(criterion.cost_of(node.name)) for node in (*self._parts, *self._obsolete)}
        amounts = [*gains, *costs.values()]
        self._unit, is_exact = _unit(amounts)
        self._resolution = 0.0 if is_exact else float(self._unit * len(amounts))
        loads = {name: [limit] for name, limit in limits.items()}
        for one, value in zip(estimations, values, strict=True):
            loads.get(one.attribute, []).append(value)
        self._load_units = tuple(_unit(amounts)[0] for amounts in loads.values())
        units = list(zip(limits, self._load_units, strict=True))
        self._limits = tuple(_whole(limits[name], unit, ROUND_FLOOR) for name, unit in units)
        self._costs = {node: _whole(cost, self._unit) for node, cost in costs.items()}
        for one, value, amount in zip(estimations, values, gains, strict=True):
            gain = _whole(amount, self._unit)
            load = tuple(_whole(value, unit, ROUND_CEILING) if one.attribute == name else 0 for name, unit in units)
            is_level = one.kind is EstimationKind.ABSOLUTE and one.attribute in weights
            effect = Effect(0, load, ((one.attribute, gain),)) if is_level else Effect(gain, load)
            causer = network.find(one.causer)
            self._estimated[causer] = self._effect(causer).plus(effect)

    def _effect(self, *nodes: Node) -> Effect:
        """Return what is estimated of nodes together."""
        return reduce(Effect.plus, (self._estimated[node] for node in nodes if node in self._estimated), self._nothing)

    def _cost_to_switch(self, component: Node) -> int:
        """Return what it costs to start or stop a component; a plain one is only booked."""
        return 0 if component.element.kind is ComponentKind.PLAIN else self._costs[component]

    def _function(self, node: Node, designs: Iterable[Node], places: Mapping[Node, int]) -> Slot:
        options = (
            Option(
                one, self._effect(one), self._state.selected[one.index], frozenset(map(places.__getitem__, one.parts))
            )
            for one in designs
        )
        return Slot(node, tuple(options), self._nothing)

    def _component(self, node: Node) -> Slot:
        state, nodes = self._state, ranked(self._state, node)
        cost, to_switch = self._costs[node], self._cost_to_switch(node)
        active, asserted = state.active[node.index], state.asserted_required[node.index]
        selected = [one for one in node.parts if state.selected[one.index]]
        given_up = any(self._designs.get(design.wholes[0]) for design in state.users[node.index])
        stays = active and not given_up  # even if nothing needs it: a plan stops what it replaces, and what is obsolete
        running = self._effect(node) if active else self._effect(node).costing(to_switch)
        options = [
            Option(one, running.plus(self._effect(one).costing(0 if one in selected else cost)), one in selected)
            for one in nodes
        ]
        idle, idle_node = self._nothing.costing(to_switch if active else 0), None
        if stays:
            idle = self._effect(node, *selected)
        elif asserted and nodes:
            idle_node = next((one for one in nodes if cost and one in selected), nodes[0])
            idle = idle.costing(0 if idle_node in selected else cost)
        is_kept = any(node in design.parts for design in self._kept)
        return Slot(
            node,
            tuple(options or [Option(None, running.plus(self._effect(*selected)))]),
            idle,
            idle_node,
            is_kept or (stays and asserted),
        )


def _uses_more(component: Slot, pick: int) -> bool:
    now = next((option.effect.loads for option in component.options if option.is_now), None)
    loads = component.options[pick].effect.loads
    return any(loads) if now is None else any(new > old for new, old in zip(loads, now, strict=True))


def _decimal(number: float) -> Decimal:
    return Decimal(repr(float(number)))


def _unit(amounts: Iterable[Decimal]) -> tuple[Decimal, bool]:
    """Return what 1 stands for when amounts are written as whole numbers, and whether they are exact so."""
    decimals, total = 0, Decimal()
    for amount in amounts:
        if amount:
            decimals = max(decimals, -int(amount.normalize().as_tuple().exponent))
            total += abs(amount)
    most = DIGITS - 1 - total.adjusted() if total else decimals
    return Decimal(1).scaleb(-min(decimals, most)), decimals <= most


def _whole(amount: Decimal | int, unit: Decimal, rounding: str = ROUND_HALF_EVEN) -> int:
    return int((amount / unit).to_integral_value(rounding))
