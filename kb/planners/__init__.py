"""Choices of designs and configurations: by priority, what makes one the best, and the plan that carries it out."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

from kb.elements import ComponentKind, Configuration, FunctionDesign, finite_number
from kb.events import StatusChange
from kb.exceptions import InvalidValue
from kb.network import Network, Node
from kb.records import ReconfigurationPlan
from kb.state import Overlay, State, propagate
from kb.status import Status
from kb.views import ConfigurationView, DesignView


class Choice(NamedTuple):
    """The chosen design of each function and configuration of each component, by name; and the reason."""

    designs: Mapping[str, str]
    configurations: Mapping[str, str]
    reason: str = ""

    def __repr__(self) -> str:
        why = f", reason={self.reason!r}" if self.reason else ""
        return (
            f"Choice(designs={dict(self.designs)}, configurations={dict(self.configurations)}{why})"
        )


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
            words += (
                f"{sign}{name}" if abs(weight) == 1.0 else f"{sign}{number(abs(weight))} {name}"
            )
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


def by_priority(
    candidate: FunctionDesign | Configuration | DesignView | ConfigurationView,
) -> tuple[bool, float, str]:
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
    configurations = firsts_by_priority(
        state, (node for node in adaptable if node.kind == "component")
    )
    if not (designs or configurations or is_obsolete):
        return None
    return Choice(by_whole(designs), by_whole(configurations))


def firsts_by_priority(state: State, wholes: Iterable[Node]) -> list[Node]:
    """Return the first of `ranked` for each function or component that has any."""
    possible = (ranked(state, node) for node in wholes)
    return [parts[0] for parts in possible if parts]


# -------------------------------------------------------------------- the plan that carries out a choice


class Obsolete(NamedTuple):
    """Names of active components and selected designs and configurations that nothing required needs any more."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]

    def __bool__(self) -> bool:
        return any(self)


class Selection(NamedTuple):
    """What the managed system has to do after a selection, by name, and the nodes whose selection changed."""

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]
    parameters: tuple[str, ...]
    changes: tuple[StatusChange, ...]
    reselected: tuple[Node, ...]

    def __bool__(self) -> bool:
        return bool(self.activate or self.deactivate or self.parameters)


def obsolete(state: State) -> Obsolete:
    """Return what is obsolete: selected or active for no required function (an asserted `required` does not count)."""
    nodes = state.obsolete.nodes()
    kinds = "component", "function design", "configuration"
    return Obsolete(*(_names(node for node in nodes if node.kind == kind) for kind in kinds))


def reselect(state: State, designs: Iterable[Node], configurations: Iterable[Node]) -> Selection:
    """Select designs and configurations instead of the present ones, and unselect what is obsolete."""
    replaced, changed = _choose(state, designs)
    _, newly_configured = _choose(state, configurations)
    changes = propagate(state, [*changed, *newly_configured])
    unneeded = state.obsolete.nodes()
    idle = [node for node in unneeded if node.kind == "component"]
    unselected = [node for node in unneeded if node.kind != "component"]
    for node in unselected:
        state.put(state.selected, node.index, False)
    if unselected:
        changes += propagate(state, unselected)
    given_up = [
        part
        for design in replaced
        for part in design.parts
        if not any(state.required[user.wholes[0].index] for user in state.users[part.index])
    ]
    return Selection(
        activate=_names(_lacking(state)),
        deactivate=_names(
            node for node in dict.fromkeys([*given_up, *idle]) if state.active[node.index]
        ),
        parameters=_names(node for node in newly_configured if state.selected[node.index]),
        changes=tuple(changes),
        reselected=(*changed, *newly_configured, *unselected),
    )


def by_whole(chosen: Iterable[Node]) -> Mapping[str, str]:
    return MappingProxyType({node.wholes[0].name: node.name for node in chosen})


def planned(
    state: State,
    selection: Selection,
    reason: str,
    now: float,
    cause: int | None = None,
    number: int = 0,
) -> ReconfigurationPlan:
    activate, deactivate, *_ = selection
    elements = (state.network.components[name].element for name in (*activate, *deactivate))
    plain = frozenset(one.name for one in elements if one.kind is ComponentKind.PLAIN)
    return ReconfigurationPlan(*selection[:3], reason, now, plain=plain, cause=cause, number=number)


def _choose(state: State, chosen: Iterable[Node]) -> tuple[list[Node], list[Node]]:
    """Select each node and unselect the others of its whole; return what was unselected, and all that changed."""
    replaced, changed = [], []
    for node in chosen:
        for rival in node.wholes[0].parts:
            wanted = rival is node
            if state.selected[rival.index] == wanted:
                continue
            state.put(state.selected, rival.index, wanted)
            changed.append(rival)
            if not wanted:
                replaced.append(rival)
    return replaced, changed


def _lacking(state: State) -> list[Node]:
    lacking = state.lacking.nodes()
    users = {user.index: user for component in lacking for user in state.users[component.index]}
    designs = [
        users[index] for index in sorted(users) if state.required[users[index].wholes[0].index]
    ]
    inactive = (part for design in designs for part in design.parts if not state.active[part.index])
    return list(dict.fromkeys(inactive))


def _names(nodes: Iterable[Node]) -> tuple[str, ...]:
    return tuple(node.name for node in nodes)
