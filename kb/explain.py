"""Explains statuses and choices: why an element has its status, and why this design is selected.

A status is explained by a chain down to the facts, as data and as a sentence.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Final, NamedTuple

from kb.elements import Action, exact
from kb.network import Node
from kb.planning import ranked
from kb.remedies import Conjunction, remedies
from kb.state import State
from kb.status import IMPOSSIBLE, OPERATORS, Status

_MOST: Final = 4
"""The most causes of one status that a sentence names; it only counts the others."""
_ERRORS: Final = (Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_CAUSING: Final = {
    Status.UNFEASIBLE: IMPOSSIBLE,
    Status.CONFIGURATION_ERROR: {Status.UNFEASIBLE},
    Status.IMPLICIT_CONFIGURATION_ERROR: _ERRORS,
    Status.UNSOLVED: set(Status) - {Status.SOLVED},
}
"""The statuses of parts that lead to a status."""
_POSSIBLE: Final = {
    "action": "none of its constraints is violated and none of its functions is unfeasible",
    "function": "it has a design that is not unfeasible",
    "function design": "none of its constraints is violated and none of its components has failed "
    "or is unfeasible",
    "component": "it has not failed, and no constraint rules it out",
    "configuration": "none of its constraints is violated",
}


@dataclass(frozen=True, slots=True)
class Explanation:
    """A status and its causes.

    Attributes:
        kind: the element's kind, e.g. "action".
        name: the element's name.
        status: the status explained; None for an attribute, which has none.
        fact: why, in words; the sentence ends with it, instead of the causes, if it is not empty.
        reasons: each alone suffices for the status (or for a worse one); the causes in one count
            together.
        reason: why, in the words given with the asserted status or the reported failure; may be
            empty.
        remedies: for an element that is unfeasible or in failure, the smallest sets of facts that
            would make it feasible; only for the element that was asked about, not for its causes.
        has_all_remedies: there are no other remedies.
    """

    kind: str
    name: str
    status: Status | None
    fact: str = ""
    reasons: "Reasons" = field(default=(), repr=False)
    reason: str = ""
    remedies: tuple[Conjunction, ...] = ()
    has_all_remedies: bool = True

    @property
    def causes(self) -> tuple["Explanation", ...]:
        """All causes of the status, each with its own explanation down to the facts."""
        return tuple(cause for reason in self.reasons for cause in reason)

    def is_restored_by(self, action: Action) -> bool:
        """Return whether an action that succeeds can make this element feasible again.

        It can if some remedy consists of attributes and components that the action restores.
        """
        return any(remedy.is_restored_by(action) for remedy in self.remedies)

    @property
    def sentence(self) -> str:
        """Why, in short: only a few causes are named, and remedies are left out."""
        return self.text(self.name)

    def __str__(self) -> str:
        return self.sentence + self._help()

    def _repr_html_(self) -> str:
        return f"{_unfolding(self)}<p>{escape(self._help()[2:])}</p>"

    def text(self, subject: str) -> str:
        """Return the sentence, with the given words for the element."""
        if self.kind in ("constraint", "attribute"):
            return self.fact
        if self.status is Status.FAILURE and not self.fact:
            return f"{subject} has failed" + (f" ({self.reason})" if self.reason else "")
        verb = "is in" if self.status in (Status.FAILURE, *_ERRORS) else "is"
        return f"{subject} {verb} {self.status} because {self.fact or self._causes_in_words()}"

    def _help(self) -> str:
        if self.status not in IMPOSSIBLE or self.kind == "constraint":
            return ""
        if self.remedies:
            return f"; it would be feasible with {', or '.join(_first(map(str, self.remedies)))}"
        nothing = "; nothing that can be measured or repaired would make it feasible"
        return nothing if self.has_all_remedies else ""

    def _causes_in_words(self) -> str:
        reasons = []
        for reason in self.reasons:
            texts = _first(cause.text(f"{cause.kind} {cause.name}") for cause in reason)
            reasons.append(" and ".join(texts))
        return "; also ".join(_first(reasons))


Reasons = tuple[tuple[Explanation, ...], ...]


def _unfolding(explanation: Explanation) -> str:
    """Return a sentence in HTML that unfolds to its causes."""
    words = escape(explanation.sentence)
    if not explanation.causes:
        return words
    items = "".join(f"<li>{_unfolding(cause)}</li>" for cause in explanation.causes)
    return f"<details><summary>{words}</summary><ul>{items}</ul></details>"


def explain(state: State, node: Node, now: float) -> Explanation:
    """Explain the status of an element in a state; `now` [s] gives the age of measurements."""
    explanation = _Explainer(state, now).status(node)
    if explanation.status is None:
        return explanation
    smallest, are_all = remedies(state, node)
    return replace(explanation, remedies=smallest, has_all_remedies=are_all)


def why(state: State, node: Node, now: float) -> str:
    """Return one sentence on why an element has its status, without remedies; see `explain`."""
    return _Explainer(state, now).status(node).sentence


class _Explainer:
    """Explains elements of one state; a cause that several share is explained once."""

    def __init__(self, state: State, now: float) -> None:
        self._state = state
        self._now = now
        self._explanations: dict[Node, Explanation] = {}

    def status(self, node: Node) -> Explanation:
        if node not in self._explanations:
            self._explanations[node] = self._explain(node)
        return self._explanations[node]

    def _explain(self, node: Node) -> Explanation:
        state = self._state
        status = state.status.get(node)
        reason = ""
        groups: list[list[Node]] = []
        if node in state.asserted:
            assertion = state.reason("asserted", node)
            reason = assertion.text
            is_constraint = node.kind == "constraint"
            subject = f"{node.name} is asserted {status}" if is_constraint else "it is asserted so"
            fact = f"{subject}{assertion}"
        elif node.kind in ("attribute", "constraint"):
            fact = self._measurement(node, status)
        else:
            fact, groups = self._causes(node, state.status[node])
            reason = state.reason("failed", node).text if status is Status.FAILURE else ""
        reasons = tuple(tuple(map(self.status, group)) for group in groups)
        return Explanation(node.kind, node.name, status, fact, reasons, reason)

    def _causes(self, node: Node, status: Status) -> tuple[str, list[list[Node]]]:
        """Return the fact, and the nodes of each reason, of an inferred status."""
        state = self._state
        causing = _CAUSING.get(status, ())
        has_choices = node.kind in ("function", "component")
        parts = node.requires
        if has_choices and status is not Status.UNFEASIBLE:
            parts = [part for part in parts if part in state.selected]
        is_inactive = node.kind == "component" and node not in state.active
        if status is Status.UNSOLVED and is_inactive:
            return f"it is required and not active{state.reason('active', node)}", []
        if status is Status.UNSOLVED and has_choices and not parts:
            kind = "configurations" if node.kind == "component" else "designs"
            return f"none of its {kind} is selected", []
        if status is Status.SOLVED:
            return "it is required, and all that it needs is in place", []
        if status is Status.FEASIBLE:
            return _POSSIBLE[node.kind], []
        groups = [[part] for part in node.constraints if state.status[part] in causing]
        bad = [part for part in parts if state.status[part] in causing]
        if not has_choices:
            groups += [[part] for part in bad]
        elif bad and len(bad) == len(parts):
            groups.append(bad)
        is_without = status is Status.UNFEASIBLE and not groups
        return "it has no design" if is_without else "", groups

    def _measurement(self, node: Node, status: Status | None) -> str:
        """Say what an attribute is, or whether that satisfies a constraint."""
        state = self._state
        attribute = node if status is None else node.requires[0]
        constraints = attribute.constraints if status is None else [node]
        value = state.value.get(attribute)
        if value is None:
            return f"{attribute.name} is not measured"
        time = state.time.get(attribute)
        shown = reading(value, [each.constraint.value for each in constraints], attribute)
        if attribute in state.stale:
            return f"{attribute.name} {shown} {staleness(time, attribute, self._now)}"
        age = _age(time, self._now)
        if status is None:
            return f"{attribute.name} is {shown} ({age})"
        constraint = node.constraint
        bound = f"{constraint.operator} {attribute.attribute.amount(exact(constraint.value))}"
        holds = OPERATORS[constraint.operator](value, constraint.value)
        fact = f"{attribute.name} {shown} {'satisfies' if holds else 'violates'} {bound} ({age})"
        if status is (Status.SATISFIED if holds else Status.VIOLATED):
            return fact
        return f"{fact}, but it is debounced, and {status} so far"


def reading(value: float, thresholds: Iterable[float], attribute: Node) -> str:
    """Write a value with its unit, with as few digits as `shortest` does."""
    return attribute.attribute.amount(shortest(value, thresholds))


def shortest(value: float, thresholds: Iterable[float]) -> str:
    """Write a number with few digits, but on its side of every threshold."""
    bounds = tuple(thresholds)
    for digits in (3, 6, 9):
        text = f"{value:.{digits}g}"
        near = float(text)
        if all((near < bound, near > bound) == (value < bound, value > bound) for bound in bounds):
            return text
    nearest = min(bounds, key=lambda bound: abs(bound - value))
    if nearest == value:
        return exact(value)
    return f"just {'below' if value < nearest else 'above'} {exact(nearest)}"


def _age(time: float | None, now: float) -> str:
    return "supposed" if time is None else f"measured {max(0.0, now - time):.1f} s ago"


def staleness(time: float | None, attribute: Node, now: float) -> str:
    """Say that a measurement is stale, and why."""
    most = attribute.attribute.max_age
    is_over = time is not None and now - time > most  # otherwise it was reported to be stale
    limit = f"at most {exact(most)} s" if is_over else "and no more"
    return f"is stale: {_age(time, now)}, {limit}"


def _first(texts: Iterable[str]) -> list[str]:
    """Return the first different texts, and the number of the others."""
    unique = list(dict.fromkeys(texts))
    if len(unique) <= _MOST:
        return unique
    return [*unique[: _MOST - 1], f"{len(unique) - _MOST + 1} more"]


# -------------------------------------------------------------------- why a plan is made


def why_selected(state: State, chosen: Sequence[Node], now: float, given: str = "") -> str:
    """Return, in words, why designs and configurations are about to be selected in a state.

    `given` is the reason given with the selection, if any.
    """
    reasons = []
    for node in chosen:
        owner = node.used_by[0]
        before = [part for part in owner.requires if part in state.selected][:1]
        if not before:
            reasons.append(f"{owner} is needed by {_needed_by(state, owner, chosen)}")
        elif before == [node]:
            continue
        elif state.status[before[0]] is Status.UNFEASIBLE:
            reasons.append(why(state, before[0], now))
        elif not given:
            reasons.append(f"{node.name} is feasible and preferred to {before[0].name}")
    if given:
        reasons.append(given)
    is_explained = bool(reasons)
    for component in state.inactive_required():
        text = state.reason("active", component).text
        if not text and is_explained:
            continue
        if any(_stays(state, design, chosen) for design in state.users(component)):
            start = f"{text}; {component.name}" if text else f"{component.name} is not active, and"
            reasons.append(f"{start} is needed by {_needed_by(state, component)}")
    reasons = reasons or ["what was active or selected is no longer needed"]
    return "; ".join(_first(reasons) if len(reasons) > 1 else reasons)


def _stays(state: State, design: Node, chosen: Sequence[Node]) -> bool:
    """Return whether a selected design is still needed, and not replaced by a chosen one."""
    is_replaced = any(node.used_by[0] is design.used_by[0] for node in chosen)
    return state.is_required(design.used_by[0]) and (design in chosen or not is_replaced)


def _needed_by(state: State, node: Node, chosen: Iterable[Node] = ()) -> str:
    """Name the required actions of a function or component, also through chosen designs."""
    functions = [node]
    if node.kind == "component":
        designs = [design for design in chosen if node in design.requires]
        functions = [design.used_by[0] for design in (*state.users(node), *designs)]
    names = [action.name for function in functions for action in state.users(function)]
    return ", ".join(_first(names)) or "something asserted"


# -------------------------------------------------------------------- why it is this one


class Alternative(NamedTuple):
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


class ChoiceExplanation(NamedTuple):
    """What is chosen for a function or a component, and why not the others.

    Attributes:
        kind: "function" or "component".
        name: the name of the function or component.
        chosen: name of the design or configuration that is selected, else that would be; None if
            none can be.
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
        verb = "is" if self.is_selected else "can be" if self.chosen is None else "would be"
        choice = f"{self.chosen or 'nothing'} {verb} selected for {self.kind} {self.name}"
        others = [f"not {other.name}: {other.reason}" for other in self.alternatives]
        return "; ".join([f"{choice} because {self.reason}", *others])


def explain_choice(state: State, node: Node, now: float) -> ChoiceExplanation:
    """Explain what is selected for a function or component, or would be, and why not the others.

    The reason is the one given with the selection, else the priority.
    """
    possible = ranked(state, node)
    selected = next((part for part in node.requires if part in state.selected), None)
    chosen = selected or next(iter(possible), None)
    given = "" if selected is None else state.reason("selected", selected).text

    def reason(part: Node) -> str:
        if part not in possible:
            return f"it{why(state, part, now).removeprefix(part.name)}"
        if given:
            return given if part is chosen else "it is possible, but not part of that choice"
        place = possible.index(part)
        priority = part.element.priority
        words = "no priority number" if priority is None else f"priority number {priority}"
        if place:
            return f"it has {words}, and comes after {possible[place - 1].name}"
        if len(possible) == 1:
            return "nothing else is feasible"
        return f"it comes first, with {words}"

    alternatives = [
        Alternative(part.name, state.status[part], part.element.priority, reason(part))
        for part in node.requires
        if part is not chosen
    ]
    words = "all is unfeasible" if chosen is None else reason(chosen)
    if not state.is_required(node):
        words += f"; nothing requires the {node.kind} now"
    name = None if chosen is None else chosen.name
    return ChoiceExplanation(
        node.kind, node.name, name, selected is not None, words, tuple(alternatives)
    )
