"""Choices of designs and configurations, by priority or a criterion, and what they change."""

from collections.abc import Iterable, Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from kb.elements import Configuration, FunctionDesign
from kb.network import Node
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
    adaptable = sorted(state.adaptable, key=attrgetter("index"))
    functions = [node for node in adaptable if node.kind == "function"]
    designs = firsts_by_priority(state, functions)
    flips, plan = state.decide(designs)
    if flips:
        adaptable = in_order(state.after(flips).adaptable)
    given_up = plan.deactivate if plan else ()
    components = [
        node for node in adaptable if node.kind == "component" and node.name not in given_up
    ]
    configurations = firsts_by_priority(state, components)
    if not (designs or configurations or state.obsolete()):
        return None
    return Choice(by_owner(designs), by_owner(configurations))


class PriorityPlanner:
    """Chooses the lowest priority number of what is feasible; none last, ties by name."""

    def choose(self, kb: Readable) -> Choice | None:
        """Choose for each adaptable function, then for each component adaptable with that."""
        with kb.reading() as state:
            return choice_by_priority(state)

    def plan(self, kb: Any) -> ReconfigurationPlan | None:  # noqa: ANN401  # a knowledge base, which imports this module
        """Select by priority and return the plan; None if there is nothing to choose."""
        choice = self.choose(kb)
        plan: ReconfigurationPlan | None = None if choice is None else kb.select(*choice)
        return plan


# -------------------------------------------------------------------- what follows from a choice


class Obsolete(NamedTuple):
    """Names of what is active or selected and nothing required needs any more."""

    components: tuple[str, ...]
    designs: tuple[str, ...]
    configurations: tuple[str, ...]


def by_owner(chosen: Iterable[Node]) -> Mapping[str, str]:
    """Return the names of what is chosen by what it is chosen for."""
    return MappingProxyType({node.used_by[0].name: node.name for node in chosen})
