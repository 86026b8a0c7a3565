"""Explains why one design or configuration is selected and not another one."""

from dataclasses import dataclass
from typing import Final

from kb.elements import table
from kb.explanation import why
from kb.network import Node
from kb.planners import choice_by_priority, ranked
from kb.state import State
from kb.status import Status

_PARTS: Final = {"function": "design", "component": "configuration"}
_NOTED: Final = "selected"
"""The reason for the selection of a design or configuration, or for none of a function or component."""


@dataclass(frozen=True, slots=True)
class Alternative:
    """A design or configuration that is not chosen.

    Attributes:
        name: its name.
        status: its status.
        priority: the lowest number is preferred; None comes last.
        reason: why it is not chosen, in words.
    """

    name: str
    status: Status
    priority: float | None
    reason: str


@dataclass(frozen=True, slots=True)
class ChoiceExplanation:
    """What is chosen for a function or a component, and why not the others.

    Attributes:
        kind: "function" or "component".
        name: the name of the function or component.
        chosen: name of the design or configuration that is selected, else that would be; None if none can be.
        is_selected: whether `chosen` is selected, or only would be.
        reason: why it is this one, in words.
        alternatives: the others, in order of declaration.
    """

    kind: str
    name: str
    chosen: str | None
    is_selected: bool
    reason: str
    alternatives: tuple[Alternative, ...]

    def __str__(self) -> str:
        if self.chosen is None:
            start = f"nothing can be selected for {self.kind} {self.name} because {self.reason}"
        else:
            verb = "is" if self.is_selected else "would be"
            start = f"{self.chosen} {verb} selected for {self.kind} {self.name} because {self.reason}"
        return "; ".join([start, *(f"not {one.name}: {one.reason}" for one in self.alternatives)])

    def _repr_html_(self) -> str:
        others = [(one.name, one.status, one.priority, one.reason) for one in self.alternatives]
        title = f"{self.kind} {self.name}: {self.chosen or 'nothing'}, because {self.reason}"
        return table(title, ("not", "status", "priority", "because"), others)


def explain_choice(state: State, node: Node, now: float) -> ChoiceExplanation:
    """Explain what is selected for a function or component, or would be, and why not the others.

    The reason is the one given with the selection, else the priority.
    """
    return _Choosing(state, node, now).explanation()


def note_nothing(state: State, reason: str) -> None:
    """Keep the reason why nothing can be selected for what is required, in words; empty if something can."""
    required = [node for node in state.network.functions.values() if state.required[node.index]]
    concerned = {*required, *(part for node in required for design in node.parts for part in design.parts)}
    for node in (*state.network.functions.values(), *state.network.components.values()):
        state.give_reason(_NOTED, node, reason if node in concerned else "")


class _Choosing:
    """The choice for one function or component, and the sentences about it."""

    def __init__(self, state: State, node: Node, now: float) -> None:
        self.state, self.node, self.now = state, node, now
        self.nothing = state.reason(_NOTED, node).text
        self.possible = ranked(state, node)
        self.selected = next((part for part in node.parts if state.selected[part.index]), None)
        self.said = state.reason("selected", self.selected).text if self.selected else ""
        preferred = self.possible[:1] if not self.said else [one for one in self.possible if one is self.selected]
        self.first = next(iter(() if self.nothing else preferred), None)  # with a reason, priority does not count
        self.chosen = self.selected or self.first

    def explanation(self) -> ChoiceExplanation:
        others = tuple(
            Alternative(part.name, self.state.status[part.index], part.element.priority, self._why_not(part))
            for part in self.node.parts
            if part is not self.chosen
        )
        name, is_selected = self.chosen.name if self.chosen else None, self.selected is not None
        return ChoiceExplanation(self.node.kind, self.node.name, name, is_selected, self._why_chosen(), others)

    def _why_chosen(self) -> str:
        chosen, what, node = self.chosen, _PARTS[self.node.kind], self.node
        if chosen is None:
            return self.nothing or (f"each {what} of it is unfeasible" if node.parts else f"it has no {what}")
        if chosen not in self.possible:
            return f"it was possible before; now {why(self.state, chosen, self.now)}"
        advantage = self._advantage(chosen)
        return advantage if self.state.required[node.index] else f"{advantage}; nothing requires the {node.kind} now"

    def _advantage(self, chosen: Node) -> str:
        what, priority = _PARTS[self.node.kind], chosen.element.priority
        if self.nothing:
            return f"it was preferred before; now nothing would be: {self.nothing}"
        if chosen is not self.first:
            return "it was preferred before"
        if self.said:
            return self.said
        if len(self.possible) == 1:
            return f"no other {what} is feasible"
        if any(other.element.priority == priority for other in self.possible if other is not chosen):
            return f"of those with {_in_words(priority)} it comes first by name"
        return f"{_in_words(priority)} is the lowest of those that are feasible"

    def _why_not(self, part: Node) -> str:
        if part not in self.possible:
            return f"it{why(self.state, part, self.now).removeprefix(part.name)}"
        if self.nothing:
            return "no choice with it would do either"
        if part is self.first:
            return self._why_not_yet(part)
        if self.said:
            return "it is not part of that choice" if self.first else "it is possible, but not selected yet"
        assert self.first is not None  # `part` is possible and not the first
        mine, best = part.element.priority, self.first.element.priority
        if mine == best:
            return f"it has {_in_words(mine)} too, and comes after {self.first.name} by name"
        return f"it has {_in_words(mine)}, which comes after {best}"

    def _why_not_yet(self, part: Node) -> str:
        node, due = self.node, choice_by_priority(self.state)
        if due is not None and part.name in (due.designs.get(node.name), due.configurations.get(node.name)):
            return "it is to be selected next"
        return f"nothing is selected anew for the {node.kind}, whose status is {self.state.status[node.index]}"


def _in_words(priority: float | None) -> str:
    return "no priority number" if priority is None else f"priority number {priority}"
