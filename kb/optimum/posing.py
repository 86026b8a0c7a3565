"""From the state of a robot to the problem of how it is best configured."""

from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal, localcontext

from kb.elements import Component, ComponentKind, Configuration, EstimationKind, FunctionDesign
from kb.exceptions import UnknownName
from kb.inference.network import Network, Node
from kb.inference.state import State
from kb.optimum.problem import (
    EXACTLY,
    ComponentOptions,
    Effect,
    FunctionOptions,
    Option,
    Problem,
    decimal,
    whole,
)
from kb.selection import Criterion, by_priority
from kb.status import Status

__all__ = ["check_names", "pose"]


def pose(
    state: State, criterion: Criterion, functions: Iterable[Node] | None = None, forced: Node | None = None
) -> Problem:
    """Return what is to be chosen in a state.

    Args:
        state: the facts and statuses.
        criterion: what makes a choice better.
        functions: to choose for these alone, as if nothing ran yet; by default for all that are required, from what
            runs and is selected now.
        forced: a design or configuration that must be in the choice.

    Raises:
        UnknownName: the criterion names an attribute or a component that the model does not have.
    """
    check_names(state.network, criterion)
    with localcontext(EXACTLY):
        return whole(_Posing(state, criterion, functions, forced).problem())


def check_names(network: Network, criterion: Criterion) -> None:
    """Raise `UnknownName` unless the model has all that a criterion names."""
    costs = criterion.switching_cost
    for kind, table, names in (
        ("attribute", network.attributes, (*criterion.weights, *criterion.budgets)),
        ("component", network.components, costs if isinstance(costs, Mapping) else ()),
    ):
        for name in names:
            if name not in table:
                raise UnknownName(kind, name, table)


class _Posing:
    """Poses one problem, in decimal numbers."""

    def __init__(
        self, state: State, criterion: Criterion, functions: Iterable[Node] | None, forced: Node | None
    ) -> None:
        self._state = state
        self._criterion = criterion
        self._forced = forced
        self._afresh = functions is not None
        if functions is None:
            functions = (node for node in state.network.functions.values() if state.required[node.index])
        self._designs = {node: self._ranked(node) for node in functions}
        stuck = [node for node, designs in self._designs.items() if not designs]
        self._kept = [design for node in stuck for design in node.parts if self._is_selected(design)]
        self._nothing = Effect(Decimal(), (Decimal(),) * len(criterion.budgets))
        self._estimated: dict[Node, Effect] = {}
        self._estimate()

    def problem(self) -> Problem:
        parts = dict.fromkeys(part for node in self._designs for design in node.parts for part in design.parts)
        components = [self._component(node) for node in sorted(parts, key=lambda node: node.index)]
        places = {one.node: place for place, one in enumerate(components) if not one.is_silent}
        concerned = [*parts, *(part for node in parts for part in node.parts), *self._kept]
        concerned += [design for designs in self._designs.values() for design in designs]
        return Problem(
            functions=tuple(
                FunctionOptions(node, _undominated([self._design(design, places) for design in designs]))
                for node, designs in self._designs.items()
                if designs
            ),
            components=tuple(components),
            fixed=self._fixed(),
            budgets=tuple(self._criterion.budgets),
            limits=tuple(decimal(limit) for limit in self._criterion.budgets.values()),
            is_touched=any(node in self._estimated for node in concerned),
            goal=self._criterion.goal,
            within=self._criterion.limits,
        )

    def _estimate(self) -> None:
        """Sum up what is estimated of each causer."""
        weights = {name: decimal(weight) for name, weight in self._criterion.weights.items() if weight}
        budgets, network = self._criterion.budgets, self._state.network
        for estimation in network.model.estimations:
            name = estimation.attribute
            if name not in weights and name not in budgets:
                continue
            value = decimal(estimation.value)
            if estimation.kind is EstimationKind.NEGATIVE:
                value = -value
            effect = Effect(
                weights.get(name, Decimal()) * value, tuple(value if name == one else Decimal() for one in budgets)
            )
            if estimation.kind is EstimationKind.ABSOLUTE and name in weights:
                effect = effect._replace(gain=Decimal(), levels=((name, effect.gain),))
            causer = network.find(estimation.causer)
            self._estimated[causer] = self._effect(causer).plus(effect)

    def _effect(self, *nodes: Node) -> Effect:
        """Return what is estimated of nodes together."""
        effect = self._nothing
        for node in nodes:
            if node in self._estimated:
                effect = effect.plus(self._estimated[node])
        return effect

    def _ranked(self, whole: Node) -> list[Node]:
        """Return what can be chosen of a function or component, the first by priority first."""
        if self._forced in whole.parts:
            return [self._forced]
        possible = [part for part in whole.parts if self._state.status[part.index] is not Status.UNFEASIBLE]
        return sorted(possible, key=_rank)

    def _is_selected(self, node: Node) -> bool:
        return not self._afresh and self._state.selected[node.index]

    def _cost(self, component: Node) -> Decimal:
        return Decimal() if self._afresh else decimal(self._criterion.cost_of(component.name))

    def _cost_to_switch(self, component: Node) -> Decimal:
        """Return what it costs to activate or deactivate a component; one that nobody switches is only booked."""
        assert isinstance(component.element, Component)
        return Decimal() if component.element.kind is ComponentKind.PLAIN else self._cost(component)

    def _design(self, design: Node, places: Mapping[Node, int]) -> Option:
        needs = frozenset(places[part] for part in design.parts if part in places)
        return Option(design, self._effect(design), self._is_selected(design), needs)

    def _component(self, node: Node) -> ComponentOptions:
        cost, to_switch, nodes = self._cost(node), self._cost_to_switch(node), self._ranked(node)
        active = not self._afresh and self._state.active[node.index]
        asserted = not self._afresh and self._state.asserted_required[node.index]
        selected = [one for one in node.parts if self._is_selected(one)]
        given_up = any(self._designs.get(design.wholes[0]) for design in self._state.users[node.index])
        stays = active and not given_up  # even if nothing needs it: a plan stops what it replaces, and what is obsolete
        running = self._effect(node) if active else self._effect(node).costing(to_switch)
        options = [Option(one, running.plus(self._configured(one, cost)), one in selected) for one in nodes]
        idle, idle_node = self._nothing.costing(to_switch if active else Decimal()), None
        if stays:
            idle = self._effect(node, *selected)
        elif asserted and nodes:
            idle_node = next((one for one in nodes if cost and one in selected), nodes[0])
            idle = idle.costing(Decimal() if idle_node in selected else cost)
        return ComponentOptions(
            node,
            _undominated(options or [Option(None, running.plus(self._effect(*selected)))]),
            idle,
            idle_node,
            is_needed=any(node in design.parts for design in self._kept)
            or self._forced in nodes
            or (stays and asserted),
        )

    def _configured(self, configuration: Node, cost: Decimal) -> Effect:
        effect = self._effect(configuration)
        return effect if self._is_selected(configuration) else effect.costing(cost)

    def _fixed(self) -> Effect:
        """Return what stays selected without a choice, at the cost of stopping what is obsolete."""
        obsolete = [] if self._afresh else self._state.obsolete.nodes()
        costs = (self._cost_to_switch(node) for node in obsolete if node.kind == "component")
        return self._effect(*self._kept).costing(sum(costs, Decimal()))


def _undominated(options: Sequence[Option]) -> tuple[Option, ...]:
    """Leave out each option for which another is as good wherever they stand, and better or earlier.

    What is selected now and what is first by priority stay, to be compared with.
    """
    return tuple(
        option
        for place, option in enumerate(options)
        if option.is_now
        or place == 0
        or not any(
            rival.needs == option.needs
            and rival.effect.is_no_worse_than(option.effect)
            and (rival.effect.gain > option.effect.gain or number < place)
            for number, rival in enumerate(options)
        )
    )


def _rank(node: Node) -> tuple[bool, int, str]:
    assert isinstance(node.element, FunctionDesign | Configuration)
    return by_priority(node.element)
