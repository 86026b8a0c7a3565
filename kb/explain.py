"""Explains why an element has its status, and why one design or configuration is selected and not another one.

A status is explained by a chain down to the facts, as data and as a sentence.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from itertools import chain
from typing import Final, NamedTuple

from kb.debounce import turning_point
from kb.elements import Action, Attribute, exact, table
from kb.network import Node
from kb.planning import choice_by_priority, ranked
from kb.remedies import Remedy, remedies
from kb.state import Reason, State
from kb.status import IMPOSSIBLE, OPERATORS, Status

_MOST: Final = 4
"""The most causes of one status that a sentence names; it only counts the others."""
_MOST_REMEDIES: Final = 3
_IN: Final = (Status.FAILURE, Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_ERRORS: Final = (Status.CONFIGURATION_ERROR, Status.IMPLICIT_CONFIGURATION_ERROR)
_POSSIBLE: Final = {
    "action": "none of its constraints is violated and none of its functions is unfeasible",
    "function": "it has a design that is not unfeasible",
    "function design": "none of its constraints is violated and none of its components has failed or is unfeasible",
    "component": "it has not failed, and no constraint rules it out",
    "configuration": "none of its constraints is violated",
}


class Comparison(NamedTuple):
    """What a constraint compares.

    Attributes:
        attribute: name of the measured attribute.
        operator: one of `>=`, `>`, `<=`, `<`.
        threshold: the value it is compared with, in the attribute's unit.
        value: the latest measurement, None before the first.
        time: when it was measured [s]; None before the first, and where the value is only supposed.
        is_stale: the measurement is too old, so it is not compared.
        unit: the unit of threshold and value; may be empty.
    """

    attribute: str
    operator: str
    threshold: float
    value: float | None
    time: float | None
    is_stale: bool
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Explanation:
    """A status and its causes.

    Attributes:
        kind: the element's kind, e.g. "action".
        name: the element's name.
        status: the status explained; None for an attribute, which has none.
        fact: why, in words; the sentence ends with it, instead of the causes, if it is not empty.
        reasons: each alone suffices for the status (or for a worse one); the causes in one count together.
        measurement: for a constraint, what it compares.
        possible_only: it explains only that the element is not unfeasible, not which status it has.
        remedies: for an element that is unfeasible or in failure, the smallest sets of facts that would make it
            feasible; given only for the element that was asked about, not for its causes.
        has_all_remedies: there are no other remedies.
        reason: why, in the words given with the asserted status or the reported failure; may be empty.
        choice: for a selected design or configuration, why, in the words given with the selection; may be empty.
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
        """All causes of the status, each with its own explanation down to the facts."""
        return tuple(cause for reason in self.reasons for cause in reason)

    def is_restored_by(self, action: Action) -> bool:
        """Tell whether an action that succeeds can make this element feasible again.

        It can if some remedy consists of attributes and components that the action restores.
        """
        return any(remedy.is_restored_by(action) for remedy in self.remedies)

    @property
    def sentence(self) -> str:
        """Why, in short: only a few causes are named, and remedies are left out."""
        return self.text(self.name)

    def __str__(self) -> str:
        selected = f"; why it was selected: {self.choice}" if self.choice else ""
        return f"{self.sentence}{self._what_would_help()}{selected}"

    def _repr_html_(self) -> str:
        def unfolding(one: Explanation) -> str:
            below, said = (
                "".join(f"<li>{unfolding(cause)}</li>" for cause in one.causes),
                escape(one.sentence),
            )
            return (
                f"<details><summary>{said}</summary><ul>{below}</ul></details>" if below else said
            )

        return f"{unfolding(self)}<p>{escape(self._what_would_help().lstrip('; '))}</p>"

    def text(self, subject: str) -> str:
        """Return the sentence, with the given words for the element."""
        if self.kind in ("constraint", "attribute"):
            return self.fact
        if self.status is Status.FAILURE and not self.fact:
            return (
                f"{subject} has failed ({self.reason})" if self.reason else f"{subject} has failed"
            )
        verb = "is in" if self.status in _IN else "is"
        statement = (
            f"{subject} is not unfeasible"
            if self.possible_only
            else f"{subject} {verb} {self.status}"
        )
        why = self.fact or self._causes_in_words()
        return f"{statement} because {why}" if why else statement

    def _what_would_help(self) -> str:
        if self.kind == "constraint" or self.status not in IMPOSSIBLE:
            return ""
        if not self.remedies:
            return (
                "; nothing that can be measured or repaired would make it feasible"
                if self.has_all_remedies
                else ""
            )
        texts = [str(remedy) for remedy in self.remedies[:_MOST_REMEDIES]]
        left = len(self.remedies) - len(texts)
        if left:
            texts.append(f"{left} more" if self.has_all_remedies else f"at least {left} more")
        joined = ", or " if any(len(remedy.facts) > 1 for remedy in self.remedies) else " or "
        return f"; it would be feasible with {joined.join(texts)}"

    def _causes_in_words(self) -> str:
        count = len(self.causes)
        left = _MOST if count <= _MOST else _MOST - 1
        reasons = []
        for reason in self.reasons:
            texts = list(
                dict.fromkeys(cause.text(f"{cause.kind} {cause.name}") for cause in reason[:left])
            )
            left -= len(texts)
            if texts:
                reasons.append(" and ".join(texts))
        if count > _MOST:
            rest = f"{count - _MOST + 1} more"
            reasons = [f"{reasons[0]} and {rest}"] if len(self.reasons) == 1 else [*reasons, rest]
        return "; also ".join(dict.fromkeys(reasons))


Reasons = tuple[tuple[Explanation, ...], ...]


def explain(state: State, node: Node, now: float) -> Explanation:
    """Explain the status of one element in a state; `now` [s] gives the age of measurements."""
    explained = _Explainer(state, now).status(node)
    if explained.status not in IMPOSSIBLE:
        return explained
    found, complete = remedies(state, node)
    return replace(explained, remedies=found, has_all_remedies=complete)


def why(state: State, node: Node, now: float) -> str:
    """Return one sentence on why an element has its status, without remedies; see `explain`."""
    return _Explainer(state, now).status(node).sentence


class _Explainer:
    """Explains elements of one state; a cause that several share is explained once."""

    def __init__(self, state: State, now: float) -> None:
        self._state = state
        self._now = now
        self._known: dict[tuple[int, bool], Explanation] = {}

    def status(self, node: Node, *, possible_only: bool = False) -> Explanation:
        key = node.index, possible_only
        if key not in self._known:
            self._known[key] = self._explain(node, possible_only)
        return self._known[key]

    def _explain(self, node: Node, possible_only: bool) -> Explanation:
        if node.kind == "attribute":
            return self._attribute(node)
        state, status = self._state, self._state.status[node]
        reason, measurement, reasons = "", None, Reasons()
        if node.kind == "constraint":
            measurement = _comparison(state, node)
        if state.asserted.get(node) is not None:
            said = state.reason("asserted", node)
            reason = said.text
            fact = (
                f"{node.name} is asserted {status}{said}"
                if measurement
                else f"it is asserted so{said}"
            )
        elif measurement:
            fact = _compared(measurement, node, self._now, state.verdict(node))
            if measurement.time is None and (
                forecast := state.reason("forecast", node.requires[0]).text
            ):
                fact = (
                    f"{forecast}; that makes {node.name} {status}"
                    if status is Status.VIOLATED
                    else forecast
                )
        elif possible_only or status is Status.FEASIBLE:
            fact, reasons = _POSSIBLE[node.kind], _together(self._support(node))
        else:
            fact, reasons = self._causes(node, status)
            reason = state.reason("failed", node).text if status is Status.FAILURE else ""
        choice = state.reason("selected", node).text if node in state.selected else ""
        possible_only = possible_only and state.asserted.get(node) is None
        what = node.kind, node.name, status, fact, reasons, measurement, possible_only
        return Explanation(*what, (), True, reason, choice)

    def _attribute(self, node: Node) -> Explanation:
        users = [
            f"{whole} needs {one.name}: {self._state.status[one]}"
            for one in node.constraints
            for whole in one.used_by
        ]
        if len(users) > _MOST:
            users = [*users[: _MOST - 1], f"{len(users) - _MOST + 1} more constraints"]
        fact = "; ".join(
            [_reading(self._state, node, self._now), *(users or ["no constraint compares it"])]
        )
        return Explanation(node.kind, node.name, None, fact, self._each(node.constraints))

    def _causes(self, node: Node, status: Status) -> tuple[str, Reasons]:
        """Return the fact and the reasons of a status that is inferred and not "feasible"."""
        selected = [part for part in node.requires if part in self._state.selected]
        if status is Status.UNFEASIBLE:
            return (
                "" if node.requires or node.kind != "function" else "it has no design",
                self._violations(node),
            )
        if status is Status.CONFIGURATION_ERROR:
            return "", self._each(part for part in selected if self._is(part, Status.UNFEASIBLE))
        if status is Status.IMPLICIT_CONFIGURATION_ERROR:
            choices = selected if node.kind == "function" else node.requires
            return "", self._each(part for part in choices if self._is(part, *_ERRORS))
        if status is Status.SOLVED:
            parts = selected if node.kind in ("function", "component") else node.requires
            return "it is required, and all that it needs is in place", self._all(
                (*node.constraints, *parts)
            )
        if status is Status.UNSOLVED and node.kind == "component":
            if node in self._state.active:
                return f"none of its configurations is selected{self._why_none(node)}", ()
            return f"it is required and not active{self._state.reason('active', node)}", ()
        if status is Status.UNSOLVED and node.kind == "function":
            without = f"none of its designs is selected{self._why_none(node)}"
            return "" if selected else without, self._all(selected)
        if status is Status.UNSOLVED:
            return "", self._each(
                part for part in node.requires if not self._is(part, Status.SOLVED)
            )
        return "", ()  # a failure needs no further reason

    def _why_none(self, node: Node) -> Reason:
        """Return why nothing is selected: the reason given when it was unselected, or when nothing could be chosen."""
        taken_back = self._state.reason("unselected", node)
        return taken_back if taken_back.text else self._state.reason("selected", node)

    def _violations(self, node: Node) -> Reasons:
        violated = self._each(one for one in node.constraints if self._is(one, Status.VIOLATED))
        impossible = [part for part in node.requires if self._is(part, *IMPOSSIBLE)]
        if node.kind in ("action", "function design"):
            return *violated, *self._each(impossible)
        return *violated, *(self._all(impossible) if len(impossible) == len(node.requires) else ())

    def _support(self, node: Node) -> list[Explanation]:
        parts = node.requires
        if node.kind in ("function", "component"):
            possible = [part for part in parts if not self._is(part, *IMPOSSIBLE)]
            selected = [part for part in possible if part in self._state.selected]
            parts = (selected or possible)[:1]
        feasible = [
            self.status(part, possible_only=not self._is(part, Status.FEASIBLE)) for part in parts
        ]
        return [*map(self.status, node.constraints), *feasible]

    def _each(self, nodes: Iterable[Node]) -> Reasons:
        return tuple((self.status(node),) for node in nodes)

    def _all(self, nodes: Iterable[Node]) -> Reasons:
        return _together(map(self.status, nodes))

    def _is(self, node: Node, *statuses: Status) -> bool:
        return self._state.status[node] in statuses


def _together(causes: Iterable[Explanation]) -> Reasons:
    reason = tuple(causes)
    return (reason,) if reason else ()


def _comparison(state: State, node: Node) -> Comparison:
    constraint, attribute = node.element, node.requires[0]
    value, time, is_stale = (
        state.value.get(attribute),
        state.time.get(attribute),
        attribute in state.stale,
    )
    bound = constraint.attribute, constraint.operator, constraint.value
    return Comparison(*bound, value, time, is_stale, attribute.element.unit)


def _compared(one: Comparison, node: Node, now: float, verdict: Status | None) -> str:
    name, operator, threshold, value, time, is_stale, _ = one
    attribute: Attribute = node.requires[0].element
    near = "" if value is None else shortest(value, (threshold,))
    bound = f"{operator} {attribute.amount(exact(threshold))}"
    if value is None:
        return f"{name} is not measured (wanted {bound})"
    shown = f"{name} {attribute.amount(near)}"
    if is_stale:
        return f"{shown} {staleness(time, node.requires[0], now)}"
    if verdict is Status.NOT_EVALUATED:
        return f"{shown} is not confirmed: {_votes(attribute)} have to agree"
    holds = OPERATORS[operator](value, threshold)
    fact = f"{shown} {'satisfies' if holds else 'violates'} {bound} ({_age(time, now)})"
    if verdict is None or holds == (verdict is Status.SATISFIED):
        return fact
    return f"{fact}, but {bound} stays {verdict} {_hold(value, node, verdict)}"


def _hold(value: float, node: Node, verdict: Status) -> str:
    """Say how long a constraint with hysteresis, dwell or agreement keeps its status against the measurement."""
    constraint, attribute = node.constraint, node.attribute
    turn = turning_point(constraint, verdict)
    beyond = f"{constraint.operator} {attribute.amount(exact(turn))}"
    is_beyond = verdict is Status.SATISFIED or OPERATORS[constraint.operator](value, turn)
    held = [f"for {exact(constraint.dwell)} s at least"] if constraint.dwell else []
    if attribute.agreement != (1, 1):
        held.append(
            f"until {_votes(attribute)} {'say otherwise' if is_beyond else f'are {beyond}'}"
        )
    elif not is_beyond:
        held.append(f"until {attribute.name} {beyond}")
    return ", and ".join(held)


def _reading(state: State, attribute: Node, now: float) -> str:
    value, time = state.value.get(attribute), state.time.get(attribute)
    if value is None:
        return f"{attribute.name} is not measured"
    thresholds = [constraint.element.value for constraint in attribute.constraints]
    shown = reading(value, thresholds, attribute)
    if attribute in state.stale:
        return f"{attribute.name} {shown} {staleness(time, attribute, now)}"
    return f"{attribute.name} is {shown} ({_age(time, now)})"


def reading(value: float, thresholds: Iterable[float], attribute: Node) -> str:
    """Write a value with its unit, with as few digits as `shortest` does."""
    element: Attribute = attribute.element
    return element.amount(shortest(value, thresholds))


def shortest(value: float, thresholds: Iterable[float]) -> str:
    """Write a number with few digits, but on its side of every threshold; very close to one, in words."""
    bounds = tuple(thresholds)
    for digits in (3, 6, 9):
        text = f"{value:.{digits}g}"
        near = float(text)
        if near == value or all(
            (near < one, near > one) == (value < one, value > one) for one in bounds
        ):
            return text
    nearest = min(bounds, key=lambda bound: abs(bound - value))
    if nearest == value:
        return exact(value)
    return f"just {'below' if value < nearest else 'above'} {exact(nearest)}"


def _age(time: float | None, now: float) -> str:
    return "supposed" if time is None else f"measured {max(0.0, now - time):.1f} s ago"


def staleness(time: float | None, attribute: Node, now: float) -> str:
    """Say that a measurement is stale, and why."""
    most = attribute.element.max_age
    is_over = time is not None and now - time > most  # otherwise it was told to be stale
    return (
        f"is stale: {_age(time, now)}, {f'at most {exact(most)} s' if is_over else 'and no more'}"
    )


def _votes(attribute: Attribute) -> str:
    return "{} of the last {} measurements".format(*attribute.agreement)


def why_selected(
    state: State, chosen: Sequence[Node], now: float, said: str = "", ended: Iterable[str] = ()
) -> str:
    """Return, in words, why designs and configurations are about to be selected in a state.

    `said` is the reason given with the selection, if any; `ended` are sentences about requests that have ended.
    """
    users: dict[Node, list[Node]] = {}
    for design in chosen:
        if design.kind == "function design":
            for part in design.requires:
                users.setdefault(part, []).append(design)
    reasons = []
    for node in chosen:
        whole = node.used_by[0]
        before = next((part for part in whole.requires if part in state.selected), None)
        if before is node:
            continue
        if before is None:
            reasons.append(f"{whole} is needed by {_needed_by(state, whole, users.get(whole, ()))}")
        elif state.status[before] is Status.UNFEASIBLE:
            reasons.append(why(state, before, now))
        elif not said:
            reasons.append(f"{node.name} is feasible and preferred to {before.name}")
    reasons += [said] if said else []
    reasons += _why_lacking(state, chosen, only_explained=bool(reasons))
    return "; ".join(
        dict.fromkeys(reasons or [*ended, "what was active or selected is no longer needed"])
    )


def _why_lacking(state: State, chosen: Sequence[Node], *, only_explained: bool) -> list[str]:
    """Return why components of designs that stay selected must be activated; all, or only those with a known reason."""
    anew = {node.used_by[0] for node in chosen} if state.inactive_required() else set()
    sentences, others = [], []
    for component in state.inactive_required():
        stay = (
            one for one in state.users(component) if one in chosen or one.used_by[0] not in anew
        )
        if any(state.is_required(one.used_by[0]) for one in stay):
            needed = f"needed by {_needed_by(state, component, ())}"
            text = state.reason("active", component).text
            if text:
                sentences.append(f"{text}; {component.name} is {needed}")
            else:
                others.append((component.name, needed))
    if only_explained or not others:
        return sentences
    names = [name for name, _ in others[:_MOST]] + (
        [f"{len(others) - _MOST} more"] if len(others) > _MOST else []
    )
    are = "is" if len(names) == 1 else "are"
    return [*sentences, f"{' and '.join(names)} {are} not active, and {are} {others[0][1]}"]


def _needed_by(state: State, node: Node, about: Iterable[Node]) -> str:
    """Name the required actions that need a function or component, now or through designs about to be selected."""
    functions: Iterable[Node] = (node,)
    if node.kind == "component":
        functions = (design.used_by[0] for design in chain(state.users(node), about))
    named: dict[str, None] = {}
    for action in chain.from_iterable(state.users(function) for function in functions):
        named["others" if len(named) == _MOST and action.name not in named else action.name] = None
        if len(named) > _MOST:
            break
    return ", ".join(named) or "something asserted"


# -------------------------------------------------------------------- why it is this one, and not another one

_PARTS: Final = {"function": "design", "component": "configuration"}


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
            start = (
                f"{self.chosen} {verb} selected for {self.kind} {self.name} because {self.reason}"
            )
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
    required = [node for node in state.network.functions.values() if state.is_required(node)]
    concerned = {
        *required,
        *(part for node in required for design in node.requires for part in design.requires),
    }
    for node in (*state.network.functions.values(), *state.network.components.values()):
        state.give_reason("selected", node, reason if node in concerned else "")


class _Choosing:
    """The choice for one function or component, and the sentences about it."""

    def __init__(self, state: State, node: Node, now: float) -> None:
        self.state, self.node, self.now = state, node, now
        self.nothing = state.reason("selected", node).text
        self.possible = ranked(state, node)
        self.selected = next((part for part in node.requires if part in state.selected), None)
        self.said = state.reason("selected", self.selected).text if self.selected else ""
        preferred = (
            self.possible[:1]
            if not self.said
            else [one for one in self.possible if one is self.selected]
        )
        self.first = next(
            iter(() if self.nothing else preferred), None
        )  # with a reason, priority does not count
        self.chosen = self.selected or self.first

    def explanation(self) -> ChoiceExplanation:
        others = tuple(
            Alternative(
                part.name, self.state.status[part], part.element.priority, self._why_not(part)
            )
            for part in self.node.requires
            if part is not self.chosen
        )
        name, is_selected = self.chosen.name if self.chosen else None, self.selected is not None
        return ChoiceExplanation(
            self.node.kind, self.node.name, name, is_selected, self._why_chosen(), others
        )

    def _why_chosen(self) -> str:
        chosen, what, node = self.chosen, _PARTS[self.node.kind], self.node
        if chosen is None:
            return self.nothing or (
                f"each {what} of it is unfeasible" if node.requires else f"it has no {what}"
            )
        if chosen not in self.possible:
            return f"it was possible before; now {why(self.state, chosen, self.now)}"
        advantage = self._advantage(chosen)
        return (
            advantage
            if self.state.is_required(node)
            else f"{advantage}; nothing requires the {node.kind} now"
        )

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
        if any(
            other.element.priority == priority for other in self.possible if other is not chosen
        ):
            return f"of those with {_in_words(priority)} it comes first by name"
        return f"{_in_words(priority)} is the lowest of those that are feasible"

    def _why_not(self, part: Node) -> str:
        if part not in self.possible:
            return f"it{why(self.state, part, self.now).removeprefix(part.name)}"
        if self.nothing:
            return "no choice with it would work either"
        if part is self.first:
            return self._why_not_yet(part)
        if self.said:
            return (
                "it is not part of that choice"
                if self.first
                else "it is possible, but not selected yet"
            )
        assert self.first is not None  # `part` is possible and not the first
        mine, best = part.element.priority, self.first.element.priority
        if mine == best:
            return f"it has {_in_words(mine)} too, and comes after {self.first.name} by name"
        return f"it has {_in_words(mine)}, which comes after {best}"

    def _why_not_yet(self, part: Node) -> str:
        node, due = self.node, choice_by_priority(self.state)
        if due is not None and part.name in (
            due.designs.get(node.name),
            due.configurations.get(node.name),
        ):
            return "it is to be selected next"
        return f"nothing new is selected for the {node.kind}, whose status is {self.state.status[node]}"


def _in_words(priority: float | None) -> str:
    return "no priority number" if priority is None else f"priority number {priority}"
