"""A choice of designs and configurations: what makes one better than another, how good one is, and that by priority."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from kb.elements import Configuration, FunctionDesign, finite_number
from kb.exceptions import InvalidValue
from kb.network import Network, Node
from kb.reconfiguration import by_whole, reselect
from kb.state import Overlay, State
from kb.status import Status
from kb.views import ConfigurationView, DesignView


class Choice(NamedTuple):
    """A design for each function and a configuration for each component that has some, by name; and why these."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]
    reason: str = ""

    def __repr__(self) -> str:
        why = f", reason={self.reason!r}" if self.reason else ""
        return f"Choice(designs={dict(self.designs)}, configurations={dict(self.configurations)}{why})"


@dataclass(frozen=True, slots=True)
class Criterion:
    """What makes one choice better than another, and what no choice may exceed.

    Attributes:
        weights: how much a unit of each attribute is worth, by name; less than 0 if less of it is better.
        switching_cost: what it costs to activate or deactivate a component or to change its configuration, the same
            for all or by name of the component; in the unit of what is gained.
        budgets: the most that all estimations of what is chosen or active may sum up to, by name of attribute.
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
        costs = self.switching_cost
        return costs.get(component, 0.0) if isinstance(costs, Mapping) else costs

    def check(self, network: Network) -> None:
        """Raise `UnknownName` unless a model has all that is named."""
        for name in (*self.weights, *self.budgets):
            network.attributes[name]
        for name in self.switching_cost if isinstance(self.switching_cost, Mapping) else ():
            network.components[name]

    @property
    def goal(self) -> str:
        """What is preferred, in words, e.g. "accuracy - 0.03 power"; empty if nothing is."""
        weights = {name: weight for name, weight in self.weights.items() if weight}
        if list(weights.values()) == [-1.0]:
            return f"little {next(iter(weights))}"
        words = ""
        for name, weight in weights.items():
            sign = (" - " if words else "-") if weight < 0.0 else (" + " if words else "")
            words += f"{sign}{name}" if abs(weight) == 1.0 else f"{sign}{number(abs(weight))} {name}"
        return words

    @property
    def limits(self) -> str:
        """What the budgets are, in words, e.g. "power 40"; empty if there are none."""
        return " and ".join(f"{name} {number(limit)}" for name, limit in self.budgets.items())


@dataclass(frozen=True, slots=True)
class Optimum:
    """The best joint choice, or the best that was found with the effort allowed.

    Attributes:
        choice: what to select; None if no choice keeps within the budgets, or none was found.
        value: what the choice is worth by its criterion, switching costs taken off; None without a choice.
        switching: the costs that are taken off: value + switching is what is estimated; None without a choice.
        bound: what no choice can be worth more than; None without a choice.
        resolution: two choices that differ by no more than this were taken for equally good; 0 where all was exact.
        is_proven: no choice is better by more than the resolution, and none that is as good comes first.
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
        """How much better an unknown choice can be at most; None without a choice."""
        return None if self.value is None or self.bound is None else self.bound - self.value

    @property
    def worth(self) -> str:
        """What the choice is worth, in words, with and without what switching costs; empty without a choice."""
        if self.value is None or self.switching is None:
            return ""
        worth = number(self.value)
        if not self.switching:
            return worth
        return f"{worth} ({number(self.value + self.switching)} less {number(self.switching)} for switching)"


def number(value: float) -> str:
    """Write a number that comes from few decimals with these."""
    return f"{value:.12g}"


def summed_weights(preferences: Iterable[str | Mapping[str, float] | None]) -> dict[str, float]:
    """Return how much a unit of each attribute is worth to all who prefer one, or weigh several."""
    weights: dict[str, float] = {}
    for preference in preferences:
        weighed = {preference: 1.0} if isinstance(preference, str) else preference or {}
        for attribute, weight in weighed.items():
            weights[attribute] = weights.get(attribute, 0.0) + weight
    return {name: weight for name, weight in weights.items() if weight}


def by_priority(candidate: FunctionDesign | Configuration | DesignView | ConfigurationView) -> tuple[bool, float, str]:
    """Return the key that sorts: the lowest priority number first, no priority last, ties by name."""
    return candidate.priority is None, candidate.priority or 0, candidate.name


def ranked(state: State, whole: Node) -> list[Node]:
    """Return what can be chosen for a function or component, the first by priority first."""
    possible = (part for part in whole.parts if state.status[part.index] is not Status.UNFEASIBLE)
    return sorted(possible, key=lambda part: by_priority(part.element))


def choice_by_priority(state: State) -> Choice | None:
    """Return what is chosen in a state: for each adaptable function, then for each component adaptable given that.

    None if there is nothing to be done; a choice of nothing has what is obsolete given up.
    """
    adaptable, is_obsolete = state.adaptable.nodes(), bool(state.obsolete)
    designs = firsts_by_priority(state, (node for node in adaptable if node.kind == "function"))
    if is_obsolete or not all(state.selected[design.index] for design in designs):
        following = Overlay(state)
        reselect(following, designs, ())
        adaptable = following.adaptable.nodes()
    configurations = firsts_by_priority(state, (node for node in adaptable if node.kind == "component"))
    if not (designs or configurations or is_obsolete):
        return None
    return Choice(by_whole(designs), by_whole(configurations))


def firsts_by_priority(state: State, wholes: Iterable[Node]) -> list[Node]:
    """Return the first that can be chosen for each function or component that has some."""
    possible = (ranked(state, node) for node in wholes)
    return [parts[0] for parts in possible if parts]
