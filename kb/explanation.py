"""Why an element has the status it has: a chain from the status down to the facts, as data and as a sentence."""

from collections.abc import Iterable
from dataclasses import dataclass

from kb.elements import Constraint, exact
from kb.inference import Node, State
from kb.status import OPERATORS, Status

__all__ = ["Explanation", "explain", "shortest", "why_selected"]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A status and what it follows from.

    Attributes:
        kind: the element's kind, e.g. "action".
        name: the element's name.
        status: the status explained.
        fact: the fact at the end of a chain, in words; empty where there are causes.
        causes: all that the status follows from, each explained in turn; the sentence counts what are too many to tell.
        every: the status follows from the causes together rather than from each by itself.
    """

    kind: str
    name: str
    status: Status
    fact: str = ""
    causes: tuple["Explanation", ...] = ()
    every: bool = False

    def __str__(self) -> str:
        return self._sentence(self.name)

    def _sentence(self, subject: str) -> str:
        if self.kind == "constraint":
            return self.fact
        if self.status is Status.FAILURE and not self.fact:
            return f"{subject} has failed"
        verb = "is in" if self.status in _IN else "is"
        statement = f"{subject} {verb} {self.status}"
        if not self.causes:
            return f"{statement} because {self.fact}" if self.fact else statement
        told = self.causes if len(self.causes) <= _MOST else self.causes[: _MOST - 1]
        reasons = [cause._sentence(f"{cause.kind} {cause.name}") for cause in told]
        if len(told) < len(self.causes):
            reasons.append(f"{len(self.causes) - len(told)} more")
        return f"{statement} because {(' and ' if self.every else '; also ').join(reasons)}"


_MOST = 4
"""How many causes of one status a sentence tells before it only counts the rest."""
_IN = (Status.FAILURE, Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_FEASIBLE = {
    "action": "none of its constraints is violated and none of its functions is unfeasible",
    "function": "it has a design that is not unfeasible",
    "function design": "none of its constraints is violated and none of its components has failed or is unfeasible",
    "component": "it has not failed, and no constraint rules it out",
    "configuration": "none of its constraints is violated",
}
_ERRORS = (Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)


def explain(state: State, node: Node, now: float) -> Explanation:
    """Explain the status of one element in one state.

    Args:
        state: the facts and statuses.
        node: the element.
        now: the present time [s], for the age of measurements.
    """
    status = state.status[node.index]

    def because(causes: Iterable[Node] = (), fact: str = "", every: bool = False) -> Explanation:
        explained = tuple(explain(state, cause, now) for cause in causes)
        return Explanation(node.kind, node.name, status, fact, explained, every)

    if state.asserted[node.index] is not None:
        return because(fact="it is asserted so")
    if isinstance(node.element, Constraint):
        return because(fact=_comparison(state, node.element, node.parts[0], now))
    violated = [one for one in node.constraints if state.status[one.index] is Status.VIOLATED]
    parts = [(part, state.status[part.index]) for part in node.parts]

    def parts_in(*statuses: Status) -> list[Node]:
        return [part for part, one in parts if one in statuses]

    selected = [part for part in node.parts if state.selected[part.index]]
    if status is Status.FAILURE:
        return because()
    if status is Status.UNFEASIBLE:
        if violated:
            alone = node.kind in ("action", "function design")  # a part by itself makes these unfeasible too
            return because([*violated, *(parts_in(Status.UNFEASIBLE, Status.FAILURE) if alone else [])])
        if node.kind == "function" and not parts:
            return because(fact="it has no design")
        return because(parts_in(Status.UNFEASIBLE, Status.FAILURE), every=node.kind in ("function", "component"))
    if status is Status.FEASIBLE:
        return because(fact=_FEASIBLE[node.kind])
    if status is Status.CONFIGURATION_ERROR:
        return because([part for part in selected if state.status[part.index] is Status.UNFEASIBLE])
    if status is Status.IMPLICIT_CONFIGURATION_ERROR:
        return because(parts_in(*_ERRORS))
    if status is Status.UNSOLVED and node.kind == "component":
        inactive = not state.active[node.index]
        return because(fact="it is required and not active" if inactive else "none of its configurations is selected")
    if status is Status.UNSOLVED and node.kind == "function":
        return because(selected, fact="" if selected else "none of its designs is selected")
    if status is Status.UNSOLVED:
        return because([part for part, one in parts if one is not Status.SOLVED])
    return because(fact="it is required, and all that it needs is in place")


def why_selected(state: State, chosen: Iterable[Node], now: float) -> str:
    """Say why designs and configurations are about to be selected; the state is the one before."""
    reasons = []
    for node in chosen:
        whole = node.wholes[0]
        before = next((rival for rival in whole.parts if state.selected[rival.index]), None)
        if before is node:
            continue
        if before is None:
            reasons.append(f"{whole.kind} {whole.name} is needed by {_needed_by(state, whole)}")
        elif state.status[before.index] is Status.UNFEASIBLE:
            reasons.append(str(explain(state, before, now)))
        else:
            reasons.append(f"{node.name} is feasible and preferred to {before.name}")
    return "; ".join(dict.fromkeys(reasons)) or "what was active or selected is no longer needed"


def _needed_by(state: State, node: Node) -> str:
    """Name the required actions for which a function or component is wanted."""
    actions: dict[str, None] = {}
    waiting = list(node.wholes)
    while waiting:
        whole = waiting.pop(0)
        if whole.kind != "action":
            waiting.extend(whole.wholes)
        elif state.required[whole.index]:
            actions[whole.name] = None
    return ", ".join(actions) or "something asserted"


def _comparison(state: State, constraint: Constraint, attribute: Node, now: float) -> str:
    value, time = state.value[attribute.index], state.time[attribute.index]
    bound = f"{constraint.operator} {exact(constraint.value)}"
    if value is None:
        return f"{constraint.attribute} is not measured (wanted {bound})"
    holds = OPERATORS[constraint.operator](value, constraint.value)
    age = f" (measured {max(0.0, now - time):.1f} s ago)" if time is not None else ""
    shown = shortest(value, [constraint.value])
    return f"{constraint.attribute} {shown} {'satisfies' if holds else 'violates'} {bound}{age}"


def shortest(value: float, thresholds: Iterable[float]) -> str:
    """Write a number with as few digits as leave it on its side of every threshold."""
    bounds = tuple(thresholds)
    for digits in (3, 6, 9, 12, 15):
        text = f"{value:.{digits}g}"
        if all((float(text) < bound, float(text) > bound) == (value < bound, value > bound) for bound in bounds):
            return text
    return repr(value)
