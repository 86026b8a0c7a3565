"""Explains statuses and choices: why an element has its status, and why this design is selected.

A status is explained by a chain down to the facts, as data and as a sentence.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Final

from kb.debounce import turning_point
from kb.elements import Action, Attribute, exact
from kb.network import Node
from kb.planning import choice_by_priority, ranked
from kb.remedies import Remedy, remedies
from kb.state import NO_REASON, State
from kb.status import IMPOSSIBLE, OPERATORS, Status

_MOST: Final = 4
"""The most causes of one status that a sentence names; it only counts the others."""
_MOST_REMEDIES: Final = 3
_ERRORS: Final = (Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
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
        choice: for a selected design or configuration, why, in the words given with the selection;
            may be empty.
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
    choice: str = ""
    remedies: tuple[Remedy, ...] = ()
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
        selected = f"; why it was selected: {self.choice}" if self.choice else ""
        return self.sentence + self._help() + selected

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
        if not self.remedies:
            nothing = "; nothing that can be measured or repaired would make it feasible"
            return nothing if self.has_all_remedies else ""
        texts = [str(remedy) for remedy in self.remedies[:_MOST_REMEDIES]]
        rest = len(self.remedies) - len(texts)
        if rest:
            texts.append(f"{rest} more" if self.has_all_remedies else f"at least {rest} more")
        is_long = any(len(remedy.facts) > 1 for remedy in self.remedies)
        return f"; it would be feasible with {(', or ' if is_long else ' or ').join(texts)}"

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
        elif status is None:
            users = [
                f"{user} needs {constraint.name}: {state.status[constraint]}"
                for constraint in node.constraints
                for user in constraint.used_by
            ]
            words = _first(users or ["no constraint compares it"], "more constraints")
            fact = "; ".join([self._measurement(node), *words])
            groups = [[constraint] for constraint in node.constraints]
        elif node.kind == "constraint":
            fact = self._comparison(node, status)
        else:
            fact, groups = self._causes(node, status)
            reason = state.reason("failed", node).text if status is Status.FAILURE else ""
        choice = state.reasons.get(("selected", node), NO_REASON).text
        reasons = tuple(tuple(map(self.status, group)) for group in groups if group)
        return Explanation(node.kind, node.name, status, fact, reasons, reason, choice)

    def _causes(self, node: Node, status: Status) -> tuple[str, list[list[Node]]]:
        """Return the fact, and the nodes of each reason, of an inferred status."""
        state = self._state
        has_choices = node.kind in ("function", "component")
        parts = node.requires
        if has_choices:
            parts = [part for part in parts if part in state.selected]

        def each(nodes: Iterable[Node], *statuses: Status) -> list[list[Node]]:
            return [[part] for part in nodes if state.status[part] in statuses]

        if status is Status.UNFEASIBLE:
            groups = each(node.constraints, Status.VIOLATED)
            impossible = each(node.requires, *IMPOSSIBLE)
            if not has_choices:
                groups += impossible
            elif len(impossible) == len(node.requires):
                groups.append(list(node.requires))
            return "" if groups[0] else "it has no design", groups
        if status is Status.CONFIGURATION_ERROR:
            return "", each(parts, Status.UNFEASIBLE)
        if status is Status.IMPLICIT_CONFIGURATION_ERROR:
            return "", each(parts, *_ERRORS)
        if status is Status.SOLVED:
            return "it is required, and all that it needs is in place", []
        if status is not Status.UNSOLVED:  # a failure needs no further reason
            return _POSSIBLE[node.kind] if status is Status.FEASIBLE else "", []
        if node.kind == "component" and node not in state.active:
            return f"it is required and not active{state.reason('active', node)}", []
        if node.kind == "component" or not parts:
            kind = "configurations" if node.kind == "component" else "designs"
            return f"none of its {kind} is selected", []
        if node.kind == "function":
            return "", [list(parts)]
        return "", [[part] for part in parts if state.status[part] is not Status.SOLVED]

    def _measurement(self, attribute: Node) -> str:
        state = self._state
        value = state.value.get(attribute)
        if value is None:
            return f"{attribute.name} is not measured"
        thresholds = [constraint.element.value for constraint in attribute.constraints]
        shown = reading(value, thresholds, attribute)
        time = state.time.get(attribute)
        if attribute in state.stale:
            return f"{attribute.name} {shown} {staleness(time, attribute, self._now)}"
        return f"{attribute.name} is {shown} ({_age(time, self._now)})"

    def _comparison(self, node: Node, status: Status) -> str:
        state = self._state
        attribute = node.requires[0]
        constraint = node.constraint
        time = state.time.get(attribute)
        forecast = state.reasons.get(("forecast", attribute), NO_REASON).text
        if time is None and forecast:
            is_violated = status is Status.VIOLATED
            return f"{forecast}; that makes {node.name} violated" if is_violated else forecast
        value = state.value.get(attribute)
        bound = f"{constraint.operator} {node.attribute.amount(exact(constraint.value))}"
        if value is None:
            return f"{attribute.name} is not measured (wanted {bound})"
        shown = f"{attribute.name} {reading(value, (constraint.value,), attribute)}"
        if attribute in state.stale:
            return f"{shown} {staleness(time, attribute, self._now)}"
        if status is Status.NOT_EVALUATED:
            return f"{shown} is not confirmed: {_votes(node.attribute)} have to agree"
        holds = OPERATORS[constraint.operator](value, constraint.value)
        verb = "satisfies" if holds else "violates"
        fact = f"{shown} {verb} {bound} ({_age(time, self._now)})"
        if holds == (status is Status.SATISFIED):
            return fact
        return f"{fact}, but {bound} stays {status} {_debouncing(value, node, status)}"


def _debouncing(value: float, node: Node, verdict: Status) -> str:
    """Say how long a debounced constraint keeps its status against the measurement."""
    constraint = node.constraint
    attribute = node.attribute
    turn = turning_point(constraint, verdict)
    beyond = f"{constraint.operator} {attribute.amount(exact(turn))}"
    is_beyond = verdict is Status.SATISFIED or OPERATORS[constraint.operator](value, turn)
    words = [f"for {exact(constraint.dwell)} s at least"] if constraint.dwell else []
    if attribute.agreement != (1, 1):
        change = "say otherwise" if is_beyond else f"are {beyond}"
        words.append(f"until {_votes(attribute)} {change}")
    elif not is_beyond:
        words.append(f"until {attribute.name} {beyond}")
    return ", and ".join(words)


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


def _votes(attribute: Attribute) -> str:
    return "{} of the last {} measurements".format(*attribute.agreement)


def _first(texts: Iterable[str], rest: str = "more") -> list[str]:
    """Return the first different texts, and the number of the others."""
    unique = list(dict.fromkeys(texts))
    if len(unique) <= _MOST:
        return unique
    return [*unique[: _MOST - 1], f"{len(unique) - _MOST + 1} {rest}"]


# -------------------------------------------------------------------- why a plan is made


def why_selected(
    state: State, chosen: Sequence[Node], now: float, given: str = "", ended: Iterable[str] = ()
) -> str:
    """Return, in words, why designs and configurations are about to be selected in a state.

    `given` is the reason given with the selection, if any; `ended` are sentences about requests
    that have ended.
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
    reasons = reasons or [*ended, "what was active or selected is no longer needed"]
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
    kind = "design" if node.kind == "function" else "configuration"
    possible = ranked(state, node)
    selected = next((part for part in node.requires if part in state.selected), None)
    given = "" if selected is None else state.reason("selected", selected).text
    preferred = [part for part in possible if part is selected or not given]
    first = preferred[0] if preferred else None
    chosen = selected or first
    if chosen is None:
        reason = f"each {kind} of it is unfeasible" if node.requires else f"it has no {kind}"
    elif chosen not in possible:
        reason = f"it was possible before; now {why(state, chosen, now)}"
    else:
        reason = "it was preferred before"
        if chosen is first:
            reason = given or _advantage(possible, kind)
        if not state.is_required(node):
            reason += f"; nothing requires the {node.kind} now"
    alternatives = []
    for part in node.requires:
        if part is chosen:
            continue
        if part not in possible:
            why_not = f"it{why(state, part, now).removeprefix(part.name)}"
        elif given:
            is_part = "is not part of that choice" if first else "is possible, but not selected yet"
            why_not = f"it {is_part}"
        else:
            why_not = _disadvantage(state, part, possible[0])
        status = state.status[part]
        alternatives.append(Alternative(part.name, status, part.element.priority, why_not))
    name = chosen.name if chosen else None
    return ChoiceExplanation(
        node.kind, node.name, name, selected is not None, reason, tuple(alternatives)
    )


def _advantage(possible: list[Node], kind: str) -> str:
    """Return why the first of what is possible is chosen."""
    if len(possible) == 1:
        return f"no other {kind} is feasible"
    priority = possible[0].element.priority
    if possible[1].element.priority == priority:
        return f"of those with {_in_words(priority)} it comes first by name"
    return f"{_in_words(priority)} is the lowest of those that are feasible"


def _disadvantage(state: State, part: Node, first: Node) -> str:
    """Return why a possible part is not chosen, although it may be the first by priority."""
    if part is first:
        owner = part.used_by[0]
        due = choice_by_priority(state)
        if due and part.name in (due.designs.get(owner.name), due.configurations.get(owner.name)):
            return "it is to be selected next"
        return (
            f"nothing new is selected for the {owner.kind}, whose status is {state.status[owner]}"
        )
    words = _in_words(part.element.priority)
    if part.element.priority == first.element.priority:
        return f"it has {words} too, and comes after {first.name} by name"
    return f"it has {words}, which comes after {first.element.priority}"


def _in_words(priority: float | None) -> str:
    return "no priority number" if priority is None else f"priority number {priority}"
