"""Why an element has the status it has: a chain from the status down to the facts, as data and as a sentence."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Final

from kb.elements import Constraint
from kb.explanation.comparison import Comparison, compared, reading, shortest, told
from kb.explanation.remedies import Remedy, remedies
from kb.inference.network import Node
from kb.inference.state import Reason, State
from kb.status import Status

__all__ = ["Comparison", "Explanation", "explain", "shortest", "why", "why_selected"]

_MOST: Final = 4
"""How many causes of one status a sentence tells before it only counts the rest."""
_MOST_REMEDIES: Final = 3
_IN: Final = (Status.FAILURE, Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_ERRORS: Final = (Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_IMPOSSIBLE: Final = (Status.UNFEASIBLE, Status.FAILURE)
_POSSIBLE: Final = {
    "action": "none of its constraints is violated and none of its functions is unfeasible",
    "function": "it has a design that is not unfeasible",
    "function design": "none of its constraints is violated and none of its components has failed or is unfeasible",
    "component": "it has not failed, and no constraint rules it out",
    "configuration": "none of its constraints is violated",
}


@dataclass(frozen=True, slots=True)
class Explanation:
    """A status and what it follows from.

    Attributes:
        kind: the element's kind, e.g. "action".
        name: the element's name.
        status: the status explained; None for an attribute, which has none.
        fact: why, in words; the sentence ends with it even where there are causes.
        reasons: each suffices for the status by itself (or for a worse one); the causes within one count together.
        measurement: of a constraint, what it compares.
        possible_only: it explains that the element is not unfeasible, and not which status it has instead.
        remedies: of an element that is unfeasible or in failure, the smallest sets of facts that would make it
            feasible; only of the one that was asked about, not of its causes.
        has_all_remedies: the remedies are all there are.
        reason: why, in the words of whoever asserted the status or reported the failure; may be empty.
        choice: of a design or configuration that is selected, why, in the words of whoever selected it; may be empty.
    """

    kind: str
    name: str
    status: Status | None
    fact: str = ""
    reasons: tuple[tuple["Explanation", ...], ...] = field(default=(), repr=False)
    measurement: Comparison | None = None
    possible_only: bool = False
    remedies: tuple[Remedy, ...] = ()
    has_all_remedies: bool = True
    reason: str = ""
    choice: str = ""

    @property
    def causes(self) -> tuple["Explanation", ...]:
        """All that the status follows from, each explained in turn down to the facts."""
        return tuple(cause for reason in self.reasons for cause in reason)

    @property
    def sentence(self) -> str:
        """Why, in short: what are too many causes to tell are counted, and no remedy is told."""
        return self._sentence(self.name)

    def __str__(self) -> str:
        selected = f"; why it was selected: {self.choice}" if self.choice else ""
        return f"{self.sentence}{self._outlook()}{selected}"

    def _outlook(self) -> str:
        if self.kind == "constraint" or self.status not in _IMPOSSIBLE:
            return ""
        if not self.remedies:
            return "; nothing that can be measured or repaired would make it feasible" if self.has_all_remedies else ""
        told = [str(remedy) for remedy in self.remedies[:_MOST_REMEDIES]]
        untold = len(self.remedies) - len(told)
        if untold:
            told.append(f"{untold} more" if self.has_all_remedies else f"at least {untold} more")
        joined = ", or " if any(len(remedy.facts) > 1 for remedy in self.remedies) else " or "
        return f"; it would be feasible with {joined.join(told)}"

    def _sentence(self, subject: str) -> str:
        if self.kind in ("constraint", "attribute"):
            return self.fact
        if self.status is Status.FAILURE and not self.fact:
            return f"{subject} has failed ({self.reason})" if self.reason else f"{subject} has failed"
        verb = "is in" if self.status in _IN else "is"
        statement = f"{subject} is not unfeasible" if self.possible_only else f"{subject} {verb} {self.status}"
        why = self.fact or self._told_causes()
        return f"{statement} because {why}" if why else statement

    def _told_causes(self) -> str:
        count = len(self.causes)
        left = _MOST if count <= _MOST else _MOST - 1
        told = []
        for reason in self.reasons:
            texts = list(dict.fromkeys(cause._sentence(f"{cause.kind} {cause.name}") for cause in reason[:left]))
            left -= len(texts)
            if texts:
                told.append(" and ".join(texts))
        if count > _MOST:
            rest = f"{count - _MOST + 1} more"
            told = [f"{told[0]} and {rest}"] if len(self.reasons) == 1 else [*told, rest]
        return "; also ".join(dict.fromkeys(told))


def explain(state: State, node: Node, now: float) -> Explanation:
    """Explain the status of one element in one state.

    Args:
        state: the facts and statuses.
        node: the element.
        now: the present time [s], for the age of measurements.
    """
    explained = _Explainer(state, now).status(node)
    if explained.status not in _IMPOSSIBLE:
        return explained
    found, complete = remedies(state, node)
    return replace(explained, remedies=found, has_all_remedies=complete)


def why(state: State, node: Node, now: float) -> str:
    """Say in a sentence why an element has its status, without what would change it; see `explain`."""
    return _Explainer(state, now).status(node).sentence


class _Explainer:
    """Explains the elements of one state; what several share is explained once."""

    def __init__(self, state: State, now: float) -> None:
        self._state = state
        self._now = now
        self._known: dict[tuple[int, bool], Explanation] = {}

    def status(self, node: Node) -> Explanation:
        """Explain which status an element has."""
        return self._explained(node, possible_only=False)

    def possible(self, node: Node) -> Explanation:
        """Explain that an element is not unfeasible, whichever status it has."""
        return self._explained(node, possible_only=self._state.status[node.index] is not Status.FEASIBLE)

    def _explained(self, node: Node, possible_only: bool) -> Explanation:
        found = self._known.get((node.index, possible_only))
        if found is None:
            found = self._known[node.index, possible_only] = self._explain(node, possible_only)
        return found

    def _explain(self, node: Node, possible_only: bool) -> Explanation:
        if node.kind == "attribute":
            return self._attribute(node)
        status = self._state.status[node.index]
        if isinstance(node.element, Constraint):
            return self._constraint(node, status)
        choice = self._state.reason("selected", node).text if self._state.selected[node.index] else ""
        if self._state.asserted[node.index] is not None:
            said = self._state.reason("asserted", node)
            fact = f"it is asserted so{said}"
            return Explanation(node.kind, node.name, status, fact, reason=said.text, choice=choice)
        if possible_only or status is Status.FEASIBLE:
            fact, reasons = _POSSIBLE[node.kind], _together(self._witnesses(node))
        else:
            fact, reasons = self._grounds(node, status)
        reported = self._state.reason("failed", node).text if status is Status.FAILURE else ""
        return Explanation(
            node.kind,
            node.name,
            status,
            fact,
            reasons,
            possible_only=possible_only,
            reason=reported,
            choice=choice,
        )

    def _constraint(self, node: Node, status: Status) -> Explanation:
        found = compared(self._state, node)
        if self._state.asserted[node.index] is not None:
            said = self._state.reason("asserted", node)
            fact = f"{node.name} is asserted {status}{said}"
            return Explanation(node.kind, node.name, status, fact, measurement=found, reason=said.text)
        fact = told(found, node, self._now, self._state.verdict[node.index])
        return Explanation(node.kind, node.name, status, fact, measurement=found)

    def _attribute(self, node: Node) -> Explanation:
        """Say what is known of an attribute, and what depends on it."""
        users = [
            f"{whole.kind} {whole.name} needs {one.name}: {self._state.status[one.index]}"
            for one in node.constraints
            for whole in one.wholes
        ]
        if len(users) > _MOST:
            users = [*users[: _MOST - 1], f"{len(users) - _MOST + 1} more constraints"]
        fact = "; ".join([reading(self._state, node, self._now), *(users or ["no constraint compares it"])])
        return Explanation(node.kind, node.name, None, fact, self._each(node.constraints))

    def _grounds(self, node: Node, status: Status) -> tuple[str, "Reasons"]:
        """Return the fact and the reasons of a status that is inferred and not "feasible"."""
        selected = [part for part in node.parts if self._state.selected[part.index]]
        if status is Status.UNFEASIBLE:
            return "" if node.parts or node.kind != "function" else "it has no design", self._faults(node)
        if status is Status.CONFIGURATION_ERROR:
            return "", self._each(part for part in selected if self._is(part, Status.UNFEASIBLE))
        if status is Status.IMPLICIT_CONFIGURATION_ERROR:
            choices = selected if node.kind == "function" else node.parts
            return "", self._each(part for part in choices if self._is(part, *_ERRORS))
        if status is Status.SOLVED:
            parts = selected if node.kind in ("function", "component") else node.parts
            needed = [self.status(one) for one in (*node.constraints, *parts)]
            return "it is required, and all that it needs is in place", _together(needed)
        if status is Status.UNSOLVED and node.kind == "component":
            if self._state.active[node.index]:
                return f"none of its configurations is selected{self._why_none(node)}", ()
            return f"it is required and not active{self._state.reason('active', node)}", ()
        if status is Status.UNSOLVED and node.kind == "function":
            without = f"none of its designs is selected{self._why_none(node)}"
            return "" if selected else without, _together(map(self.status, selected))
        if status is Status.UNSOLVED:
            return "", self._each(part for part in node.parts if not self._is(part, Status.SOLVED))
        return "", ()  # a failure says it all

    def _why_none(self, node: Node) -> Reason:
        """Return what was said of nothing being selected: by whoever took it back, or whoever was to choose."""
        taken_back = self._state.reason("unselected", node)
        return taken_back if taken_back.text else self._state.reason("selected", node)

    def _faults(self, node: Node) -> "Reasons":
        """Return why an element is unfeasible."""
        violated = self._each(one for one in node.constraints if self._is(one, Status.VIOLATED))
        impossible = [part for part in node.parts if self._is(part, *_IMPOSSIBLE)]
        if node.kind in ("action", "function design"):
            return *violated, *self._each(impossible)
        if len(impossible) < len(node.parts):
            return violated
        return *violated, *_together(map(self.status, impossible))

    def _witnesses(self, node: Node) -> list[Explanation]:
        """Return what suffices for an element not to be unfeasible."""
        parts = node.parts
        if node.kind in ("function", "component"):
            possible = [part for part in parts if not self._is(part, *_IMPOSSIBLE)]
            selected = [part for part in possible if self._state.selected[part.index]]
            parts = (selected or possible)[:1]
        return [*map(self.status, node.constraints), *map(self.possible, parts)]

    def _each(self, nodes: Iterable[Node]) -> "Reasons":
        return tuple((self.status(node),) for node in nodes)

    def _is(self, node: Node, *statuses: Status) -> bool:
        return self._state.status[node.index] in statuses


Reasons = tuple[tuple[Explanation, ...], ...]


def _together(causes: Iterable[Explanation]) -> Reasons:
    reason = tuple(causes)
    return (reason,) if reason else ()


def why_selected(state: State, chosen: Sequence[Node], now: float, said: str = "", ended: Iterable[str] = ()) -> str:
    """Say why designs and configurations are about to be selected.

    Args:
        state: the one before.
        chosen: what is selected.
        now: the present time [s], for the age of measurements.
        said: why whoever selects them prefers them, in words; by default they are said to be preferred.
        ended: which requests have ended, and why, in words.
    """
    users: dict[Node, list[Node]] = {}
    for design in chosen:
        if design.kind == "function design":
            for part in design.parts:
                users.setdefault(part, []).append(design)
    reasons = []
    for node in chosen:
        whole = node.wholes[0]
        before = next((rival for rival in whole.parts if state.selected[rival.index]), None)
        if before is node:
            continue
        if before is None:
            reasons.append(f"{whole.kind} {whole.name} is needed by {_needed_by(state, whole, users.get(whole, ()))}")
        elif state.status[before.index] is Status.UNFEASIBLE:
            reasons.append(why(state, before, now))
        elif not said:
            reasons.append(f"{node.name} is feasible and preferred to {before.name}")
    reasons += [said] if said else []
    reasons += _why_lacking(state, chosen, only_told=bool(reasons))
    return "; ".join(dict.fromkeys(reasons or [*ended, "what was active or selected is no longer needed"]))


def _why_lacking(state: State, chosen: Sequence[Node], *, only_told: bool) -> list[str]:
    """Say why components of designs that stay selected are to be activated: all of them, or where that was told."""
    if not state.lacking:
        return []
    anew = {node.wholes[0] for node in chosen}
    untold: list[Node] = []
    sentences = []
    for component in state.lacking.nodes():
        stay = (one for one in state.users[component.index] if one in chosen or one.wholes[0] not in anew)
        if not any(state.required[one.wholes[0].index] for one in stay):
            continue
        text = state.reason("active", component).text
        if text:
            sentences.append(f"{text}; {component.name} is needed by {_needed_by(state, component, ())}")
        else:
            untold.append(component)
    if only_told or not untold:
        return sentences
    names = [component.name for component in untold[:_MOST]]
    if len(untold) > _MOST:
        names.append(f"{len(untold) - _MOST} more")
    are = "is" if len(names) == 1 else "are"
    needed = _needed_by(state, untold[0], ())
    return [*sentences, f"{' and '.join(names)} {are} not active, and {are} needed by {needed}"]


def _needed_by(state: State, node: Node, about: Iterable[Node]) -> str:
    """Name the required actions for which a function or component is wanted, now or by designs about to be chosen."""
    functions: Iterable[Node] = (node,)
    if node.kind == "component":
        functions = (design.wholes[0] for design in chain(state.users[node.index], about))
    named: dict[str, None] = {}
    for function in functions:
        for action in state.users[function.index]:
            named["others" if len(named) == _MOST and action.name not in named else action.name] = None
            if len(named) > _MOST:
                return ", ".join(named)
    return ", ".join(named) or "something asserted"
