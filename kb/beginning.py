"""How a knowledge base begins: the facts that its model states, as entries of a state and as records."""

from collections.abc import Mapping
from types import MappingProxyType

from kb.facts import (
    ActiveFact,
    Fact,
    PlanFact,
    ProcessFact,
    RequiredActionFact,
    RequiredFact,
    SelectedFact,
    StatusFact,
)
from kb.history import Process
from kb.inference.network import Node
from kb.inference.state import State
from kb.reconfiguration import ReconfigurationPlan
from kb.requests import RequiredAction

__all__ = ["past_plan", "past_process", "past_request", "stated"]


def stated(state: State, fact: Fact) -> Node | None:
    """Enter a fact about one element in a state; returns its node, or None if the fact is a record of something."""
    network = state.network
    if isinstance(fact, StatusFact):
        node = network.find(fact.element)
        state.asserted[node.index] = fact.status
    elif isinstance(fact, RequiredFact):
        node = network.find(fact.element)
        state.asserted_required[node.index] = True
    elif isinstance(fact, SelectedFact):
        node = network.find(fact.element)
        state.selected[node.index] = True
    elif isinstance(fact, ActiveFact):
        node = network.components[fact.component]
        state.active[node.index] = True
    else:
        return None
    return node


def past_request(fact: RequiredActionFact, now: float) -> RequiredAction:
    """Return the record of a request; one that is open began now if nothing else is stated."""
    weights = fact.preference
    preference: str | Mapping[str, float] | None = MappingProxyType(dict(weights)) if weights else None
    if weights and list(weights.values()) == [1.0]:
        (preference,) = weights
    return RequiredAction(fact.action, preference, _start(fact.start, fact.end, now), _end(fact, now), fact.result)


def past_plan(fact: PlanFact, now: float) -> ReconfigurationPlan:
    """Return the record of a plan."""
    start = _start(fact.start, fact.end, now)
    steps = (fact.activate, fact.deactivate, fact.parameters)
    return ReconfigurationPlan(*steps, "stated by the model", start, _end(fact, now), fact.result)


def past_process(fact: ProcessFact, now: float) -> Process:
    """Return the record of a process."""
    return Process(fact.component, fact.pid, _start(fact.start, fact.end, now), fact.end)


def _start(start: float | None, end: float | None, now: float) -> float:
    return start if start is not None else end if end is not None else now


def _end(fact: RequiredActionFact | PlanFact, now: float) -> float | None:
    """Return when something ended; with a result but no time it ended before now."""
    if fact.end is None and fact.result is not None:
        return fact.start if fact.start is not None else now
    return fact.end
