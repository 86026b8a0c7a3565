"""Choices of designs and configurations: by priority, and the criterion and result of the best choice."""

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
    """The chosen design of each function and configuration of each component, by name; and the reason."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]
    reason: str = ""

    def __repr__(self) -> str:
        why = f", reason={self.reason!r}" if self.reason else ""
        return f"Choice(designs={dict(self.designs)}, configurations={dict(self.configurations)}{why})"


@dataclass(frozen=True, slots=True)
class Criterion:
    """What makes one choice better than another, and the budgets that no choice may exceed.

    Attributes:
        weights: how much a unit of each attribute is worth, by name; less than 0 if less of it is better.
        switching_cost: the cost of activating or deactivating a component or changing its configuration, the same for
            all or by name of the component; in the unit of value times weight.
        budgets: the most that the estimations of what is chosen or active may sum up to, by name of attribute.
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
        """Raise `UnknownName` if a named attribute or component is not in the model."""
        for name in (*self.weights, *self.budgets):
            network.attributes[name]
        for name in self.switching_cost if isinstance(self.switching_cost, Mapping) else ():
            network.components[name]

    @property
    def goal(self) -> str:
        """The weights in words, e.g. "accuracy - 0.03 power"; empty if there are none."""
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
        """The budgets in words, e.g. "power 40"; empty if there are none."""
        return " and ".join(f"{name} {number(limit)}" for name, limit in self.budgets.items())


@dataclass(frozen=True, slots=True)
class Optimum:
    """The best joint choice, or the best one that was found within the effort.

    Attributes:
        choice: what to select; None if no choice keeps within the budgets, or none was found.
        value: the worth of the choice by its criterion, without switching costs; None without a choice.
        switching: the switching costs, so that value + switching is what is estimated; None without a choice.
        bound: an upper bound of the value of any choice; None without a choice.
        resolution: choices whose values differ by no more than this count as equally good; 0 if all is exact.
        is_proven: no choice is better by more than the resolution, and no equally good one comes first in order.
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
        """The worth of the choice in words, with and without switching costs; empty without a choice."""
        if self.value is None or self.switching is None:
            return ""
        worth = number(self.value)
        if not self.switching:
            return worth
        return f"{worth} ({number(self.value + self.switching)} less {number(self.switching)} for switching)"


def number(value: float) -> str:
    """Write a number with at most 12 significant digits."""
    return f"{value:.12g}"


def summed_weights(preferences: Iterable[str | Mapping[str, float] | None]) -> dict[str, float]:
    """Return the sum of all weights by attribute; a preference for one attribute has the weight 1."""
    weights: dict[str, float] = {}
    for preference in preferences:
        weighed = {preference: 1.0} if isinstance(preference, str) else preference or {}
        for attribute, weight in weighed.items():
            weights[attribute] = weights.get(attribute, 0.0) + weight
    return {name: weight for name, weight in weights.items() if weight}


def by_priority(candidate: FunctionDesign | Configuration | DesignView | ConfigurationView) -> tuple[bool, float, str]:
    """Return a key for sorting: the lowest priority number first, no priority last, ties by name."""
    return candidate.priority is None, candidate.priority or 0, candidate.name


def ranked(state: State, whole: Node) -> list[Node]:
    """Return the parts of a function or component that are not unfeasible, sorted by priority."""
    possible = (part for part in whole.parts if state.status[part.index] is not Status.UNFEASIBLE)
    return sorted(possible, key=lambda part: by_priority(part.element))


def choice_by_priority(state: State) -> Choice | None:
    """Choose by priority for each adaptable function, then for each component that is adaptable with these designs.

    Returns None if there is nothing to do; an empty choice means that only what is obsolete is given up.
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
    """Return the first of `ranked` for each function or component that has any."""
    possible = (ranked(state, node) for node in wholes)
    return [parts[0] for parts in possible if parts]
