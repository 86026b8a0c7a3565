"""Choices of designs and configurations, by priority or a criterion, and what they change."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, Protocol

from kb.elements import ComponentKind, Configuration, FunctionDesign, finite_number
from kb.exceptions import InvalidValue
from kb.network import Network, Node
from kb.records import ReconfigurationPlan
from kb.state import State, in_order
from kb.status import Status
from kb.views import ConfigurationView, DesignView, Readable


class Choice(NamedTuple):
    """The chosen design of each function and configuration of each component, and why."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]
    reason: str = ""

    def __repr__(self) -> str:
        choice = f"designs={dict(self.designs)}, configurations={dict(self.configurations)}"
        reason = f", reason={self.reason!r}" if self.reason else ""
        return f"Choice({choice}{reason})"


@dataclass(frozen=True, slots=True)
class Criterion:
    """What makes one choice better than another, and the budgets that no choice may exceed.

    Attributes:
        weights: how much a unit of each attribute is worth, by name; less than 0 if less of it is
            better.
        switching_cost: the cost of activating or deactivating a component or changing its
            configuration, the same for all or by name of the component; in the unit of value times
            weight.
        budgets: the most that the estimations of what is chosen or active may sum up to, by
            attribute.
    """

    weights: Mapping[str, float]
    switching_cost: float | Mapping[str, float] = 0.0
    budgets: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        costs = self.switching_cost
        for number in (*self.weights.values(), *self.budgets.values()):
            finite_number(number)
        for cost in costs.values() if isinstance(costs, Mapping) else (costs,):
            if finite_number(cost) < 0.0:
                raise InvalidValue(f"a switching cost is 0 or more, not {cost!r}")

    def cost_of(self, component: str) -> float:
        """Return what it costs to switch a component."""
        if isinstance(self.switching_cost, Mapping):
            return self.switching_cost.get(component, 0.0)
        return self.switching_cost

    def check(self, network: Network) -> None:
        """Raise `UnknownName` if a named attribute or component is not in the model."""
        for name in (*self.weights, *self.budgets):
            network.attributes[name]
        if isinstance(self.switching_cost, Mapping):
            for name in self.switching_cost:
                network.components[name]

    @property
    def goal(self) -> str:
        """The weights in words, e.g. "accuracy - 0.03 power"; empty if there are none."""
        weights = {name: weight for name, weight in self.weights.items() if weight}
        if list(weights.values()) == [-1.0]:
            return f"little {next(iter(weights))}"
        words = ""
        for name, weight in weights.items():
            sign = "-" if weight < 0.0 else ""
            if words:
                sign = " - " if weight < 0.0 else " + "
            factor = "" if abs(weight) == 1.0 else f"{number(abs(weight))} "
            words += f"{sign}{factor}{name}"
        return words

    @property
    def limits(self) -> str:
        """The budgets in words, e.g. "power 40"; empty if there are none."""
        return " and ".join(f"{name} {number(limit)}" for name, limit in self.budgets.items())


@dataclass(frozen=True, slots=True)
class Optimum:
    """The best joint choice, or the best one that was found within the effort.

    Attributes:
        choice: what to select; None if no choice keeps within the budgets, or none was found.
        value: the worth of the choice by its criterion, without switching costs; None without a
            choice.
        switching: the switching costs; value + switching is what is estimated; None without a
            choice.
        bound: an upper bound of the value of any choice; None without a choice.
        resolution: choices whose values differ by no more than this count as equally good; 0 if
            exact.
        is_proven: no choice is better by more than the resolution, and no equal one comes first in
            order.
        reason: how sure that is, or why there is no choice, in words.
    """

    choice: Choice | None = None
    value: float | None = None
    switching: float | None = None
    bound: float | None = None
    resolution: float = 0.0
    is_proven: bool = False
    reason: str = ""

    @property
    def gap(self) -> float | None:
        """How much better another choice can be at most; None without a choice."""
        return None if self.value is None or self.bound is None else self.bound - self.value

    @property
    def worth(self) -> str:
        """The worth of the choice in words, with its switching costs; empty without one."""
        if self.value is None or self.switching is None:
            return ""
        worth = number(self.value)
        if not self.switching:
            return worth
        estimated = number(self.value + self.switching)
        return f"{worth} ({estimated} less {number(self.switching)} for switching)"


def number(value: float) -> str:
    """Write a number with at most 12 significant digits."""
    return f"{value:.12g}"


def summed_weights(preferences: Iterable[str | Mapping[str, float] | None]) -> dict[str, float]:
    """Return the sum of all weights by attribute; a name alone has the weight 1."""
    weights: dict[str, float] = {}
    for preference in preferences:
        weighed = {preference: 1.0} if isinstance(preference, str) else preference or {}
        for attribute, weight in weighed.items():
            weights[attribute] = weights.get(attribute, 0.0) + weight
    return {name: weight for name, weight in weights.items() if weight}


# -------------------------------------------------------------------- by priority


def by_priority(
    candidate: FunctionDesign | Configuration | DesignView | ConfigurationView,
) -> tuple[bool, float, str]:
    """Return a key for sorting: the lowest number first, none last, ties by name."""
    return candidate.priority is None, candidate.priority or 0, candidate.name


def ranked(state: State, owner: Node) -> list[Node]:
    """Return the parts of a function or component that are not unfeasible, sorted by priority."""
    possible = [part for part in owner.requires if state.status[part] is not Status.UNFEASIBLE]
    possible.sort(key=lambda part: by_priority(part.element))
    return possible


def firsts_by_priority(state: State, owners: Iterable[Node]) -> list[Node]:
    """Return the first of `ranked` for each function or component that has any."""
    firsts = []
    for owner in owners:
        firsts += ranked(state, owner)[:1]
    return firsts


def choice_by_priority(state: State) -> Choice | None:
    """Choose by priority for each adaptable function, and each component adaptable then.

    Returns None if there is nothing to do; an empty choice means that only what is obsolete is
    given up.
    """
    adaptable = in_order(state.adaptable)
    functions = [node for node in adaptable if node.kind == "function"]
    designs = firsts_by_priority(state, functions)
    selection = decide(state, designs)
    if selection.flips:
        following = state.copy()
        apply_selection(following, selection)
        adaptable = in_order(following.adaptable)
    given_up = selection.deactivate
    components = [
        node for node in adaptable if node.kind == "component" and node.name not in given_up
    ]
    configurations = firsts_by_priority(state, components)
    if not (designs or configurations or state.obsolete()):
        return None
    return Choice(by_owner(designs), by_owner(configurations))


class Selecting(Readable, Protocol):
    """A knowledge base, as far as a planner needs it."""

    def select(
        self,
        designs: Mapping[str, str] | None = None,
        configurations: Mapping[str, str] | None = None,
        reason: str = "",
    ) -> ReconfigurationPlan | None: ...


class PriorityPlanner:
    """Chooses the lowest priority number of what is feasible; none last, ties by name."""

    def choose(self, kb: Selecting) -> Choice | None:
        """Choose for each adaptable function, then for each component adaptable with that."""
        with kb.reading() as state:
            return choice_by_priority(state)

    def plan(self, kb: Selecting) -> ReconfigurationPlan | None:
        """Select by priority and return the plan; None if there is nothing to choose."""
        choice = self.choose(kb)
        return None if choice is None else kb.select(*choice)


# -------------------------------------------------------------------- what follows from a choice


class Obsolete(NamedTuple):
    """Names of what is active or selected and nothing required needs any more."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]

    def __bool__(self) -> bool:
        return any(self)


class Selection(NamedTuple):
    """What a choice changes.

    Attributes:
        flips: the designs and configurations that are selected and were not, or the other way
            round.
        activate, deactivate, parameters: what the managed system has to do then, by name.
    """

    flips: tuple[Node, ...]
    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.activate or self.deactivate or self.parameters)

    def plan(
        self, state: State, reason: str, time: float, cause: int | None = None, number: int = 0
    ) -> ReconfigurationPlan:
        """Return the plan that carries it out."""
        components = state.network.components
        plain = tuple(
            name
            for name in (*self.activate, *self.deactivate)
            if components[name].element.kind is ComponentKind.PLAIN
        )
        steps = (self.activate, self.deactivate, self.parameters)
        return ReconfigurationPlan(*steps, reason, time, plain=plain, cause=cause, number=number)


def obsolete(state: State) -> Obsolete:
    """Return what is selected or active for no required function."""
    nodes = state.obsolete()
    kinds = "component", "function design", "configuration"
    return Obsolete(*(_names(node for node in nodes if node.kind == kind) for kind in kinds))


def decide(state: State, chosen: Sequence[Node]) -> Selection:
    """Decide what a choice changes; what is obsolete is given up. Nothing changes yet."""
    unneeded = state.obsolete()
    flips = _flips(state, chosen)
    flipped = set(flips)
    flips += [node for node in unneeded if node.kind != "component" and node not in flipped]
    flipped.update(flips)

    def is_used(design: Node) -> bool:
        is_selected = (design in state.selected) != (design in flipped)
        return is_selected and state.is_required(design.used_by[0])

    owners = {node.used_by[0] for node in chosen}
    replaced = [
        node
        for node in flips
        if node.kind == "function design" and node in state.selected and node.used_by[0] in owners
    ]
    stopped = [
        part
        for design in replaced
        for part in design.requires
        if not any(map(is_used, part.used_by))
    ]
    stopped += [node for node in unneeded if node.kind == "component"]
    waiting = {design for component in state.inactive_required() for design in component.used_by}
    waiting.update(node for node in flips if node.kind == "function design")
    started = [
        part
        for design in sorted(filter(is_used, waiting), key=lambda design: design.index)
        for part in design.requires
    ]
    return Selection(
        flips=tuple(flips),
        activate=_names(part for part in started if part not in state.active),
        deactivate=_names(part for part in stopped if part in state.active),
        parameters=_names(
            node for node in flips if node.kind == "configuration" and node not in state.selected
        ),
    )


def apply_selection(state: State, selection: Selection) -> None:
    """Select and unselect in a copy of a state."""
    state.touch(selection.flips)
    state.selected = state.selected.symmetric_difference(selection.flips)
    state.infer()


def by_owner(chosen: Iterable[Node]) -> Mapping[str, str]:
    """Return the names of what is chosen by what it is chosen for."""
    return MappingProxyType({node.used_by[0].name: node.name for node in chosen})


def _flips(state: State, chosen: Sequence[Node]) -> list[Node]:
    """Return what a choice selects and unselects; what would be obsolete is not selected."""
    flips = []
    for node in chosen:
        owner = node.used_by[0]
        is_needed = state.is_required(owner) if owner.kind == "function" else state.serves(owner)
        for part in owner.requires:
            is_wanted = part is node and bool(is_needed)
            if (part in state.selected) != is_wanted:
                flips.append(part)
    return flips


def _names(nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(node.name for node in nodes))
