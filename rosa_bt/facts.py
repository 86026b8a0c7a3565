"""What a knowledge base was told and what it answered, written down as plain data, and told again."""

import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from kb import Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status
from rosa_bt.exceptions import TraceError

__all__ = ["Decision", "Fact", "Listener", "tell"]

_REASON: Final = r"(?: \((?P<reason>.*)\))?"
_STATUS: Final = "|".join(sorted(Status, key=len, reverse=True))
_SAID: Final = tuple(
    (verb, re.compile(pattern, re.DOTALL))
    for verb, pattern in (
        ("component_failed", f" has failed{_REASON}"),
        ("component_recovered", " is recovered"),
        ("component_active", f" is (?P<inactive>in)?active{_REASON}"),
        ("assert_selected", f" is (?P<not>not )?selected{_REASON}"),
        ("assert_required", " is (?P<not>no longer )?asserted required"),
        ("assert_status", f" is asserted (?P<status>{_STATUS})(?: until (?P<until>[0-9.]+) s)?{_REASON}"),
        ("retract_status", " is no longer asserted"),
    )
)
"""What a knowledge base says of an element that something else than a measurement was told of."""
_ARGUMENTS: Final[Mapping[str, Callable[[re.Match[str]], tuple[Any, ...]]]] = {
    "component_failed": lambda said: (said["reason"] or "",),
    "component_recovered": lambda said: (),
    "component_active": lambda said: (not said["inactive"], said["reason"] or ""),
    "assert_selected": lambda said: (not said["not"], said["reason"] or ""),
    "assert_required": lambda said: (None if said["not"] else True,),
    "assert_status": lambda said: (
        said["status"],
        said["reason"] or "",
        float(said["until"]) if said["until"] else None,
    ),
    "retract_status": lambda said: (),
}


class Fact(NamedTuple):
    """Something that a knowledge base was told.

    Attributes:
        time: when [s].
        verb: what kind of fact: the name of the method of the knowledge base.
        arguments: what it was called with, e.g. ("light", 0.3); a plan is its number.
    """

    time: float
    verb: str
    arguments: tuple[Any, ...]


class Decision(NamedTuple):
    """What became of an action.

    Attributes:
        action: its name.
        what: "requested", "completed", "failed", "abandoned", "unfeasible" or "feasible".
        reason: why, in the words of the knowledge base; empty where none was given.
    """

    action: str
    what: str
    reason: str


class Listener:
    """Hears of everything that a knowledge base is told, and keeps it until it is asked for.

    What the knowledge base knows already comes as the first facts.

    Attributes:
        is_deaf: what is told now is not kept as a fact: the tree tells it, and would tell it again.
        decisions: what became of actions since they were taken last.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self.is_deaf = False
        self.decisions: list[Decision] = []
        self._facts: list[Fact] = []
        self._planned = len(kb.plans)
        self._open: list[tuple[int, ReconfigurationPlan]] = []
        self._begin(kb)
        self.stop = kb.subscribe(self._hear)

    def _begin(self, kb: KnowledgeBase) -> None:
        """Take what is known as the first facts."""
        for name, attribute in kb.attributes.items():
            if attribute.time is not None:
                self._keep(attribute.time, "measure", name, attribute.value)
        for name, component in kb.components.items():
            if component.status is Status.FAILURE:
                self._keep(kb.now, "component_failed", name, "")
            if component.is_active:
                self._keep(kb.now, "component_active", name, True, "")
        if any(view.is_selected for views in (kb.designs, kb.configurations) for view in views.values()):
            self._keep(kb.now, "select", *_selection(kb))

    def take_facts(self) -> tuple[Fact, ...]:
        """Return the facts since the last time."""
        if self._open:
            self._look_at_plans()
        if not self._facts:
            return ()
        facts, self._facts = tuple(self._facts), []
        return facts

    def take_decisions(self) -> tuple[Decision, ...]:
        """Return the decisions since the last time."""
        if not self.decisions:
            return ()
        decisions, self.decisions = tuple(self.decisions), []
        return decisions

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.ACTION_UPDATE:
            what, _, reason = event.text.removeprefix(f"{event.subject} is ").partition(": ")
            self.decisions.append(Decision(event.subject, what, reason))
        elif event.plan is not None:
            self._open.append((self._planned, event.plan))
            self._planned += 1
            self._keep(event.time, "select", *_selection(self._kb))
        else:
            self._hear_fact(event)
        for change in event.changes:
            is_unfeasible = change.new is Status.UNFEASIBLE
            if change.kind == "action" and is_unfeasible != (change.old is Status.UNFEASIBLE):
                reason = self._kb.why(self._kb.actions[change.name]) if is_unfeasible else ""
                self.decisions.append(Decision(change.name, "unfeasible" if is_unfeasible else "feasible", reason))

    def _hear_fact(self, event: Event) -> None:
        said = event.text.removeprefix(event.subject)
        for verb, pattern in _SAID:
            found = pattern.fullmatch(said)
            if found is not None:
                self._keep(event.time, verb, event.subject, *_ARGUMENTS[verb](found))
                return
        if not event.subject and said.endswith(" selected"):  # several at once
            self._keep(event.time, "select", *_selection(self._kb))
        elif event.subject in self._kb.attributes and self._kb.attributes[event.subject].time == event.time:
            self._keep(event.time, "measure", event.subject, self._kb.attributes[event.subject].value)

    def _keep(self, time: float, verb: str, *arguments: object) -> None:
        if not self.is_deaf:
            self._facts.append(Fact(time, verb, arguments))

    def _look_at_plans(self) -> None:
        open_before, self._open = self._open, []
        for number, plan in open_before:
            if plan.end is None:
                self._open.append((number, plan))
            else:
                self._keep(plan.end, "finish_plan", number, plan.result)
        self._facts.sort(key=lambda fact: fact.time)  # no event tells that a plan has ended; it may have been long ago


def tell(kb: KnowledgeBase, fact: Fact) -> None:
    """Tell a fact again; the clock of the knowledge base shows its time.

    Raises:
        TraceError: no such kind of fact, or not with such arguments.
    """
    try:
        verb = _VERBS[fact.verb]
    except KeyError:
        raise TraceError(f"{fact.verb!r} is no fact; facts are {', '.join(_VERBS)}") from None
    try:
        verb(kb, *fact.arguments)
    except (IndexError, TypeError) as error:
        raise TraceError(f"{fact.verb}{fact.arguments!r} cannot be told again: {error}") from error


def _select(kb: KnowledgeBase, designs: Mapping[str, str], configurations: Mapping[str, str]) -> None:
    kb.select(designs=designs, configurations=configurations)


def _finish(kb: KnowledgeBase, number: int, result: str) -> None:
    kb.finish_plan(kb.plans[number], result)


_VERBS: Final[Mapping[str, Callable[..., object]]] = {
    "measure": KnowledgeBase.measure,
    "component_failed": KnowledgeBase.component_failed,
    "component_recovered": KnowledgeBase.component_recovered,
    "component_active": KnowledgeBase.component_active,
    "assert_selected": KnowledgeBase.assert_selected,
    "assert_required": KnowledgeBase.assert_required,
    "assert_status": KnowledgeBase.assert_status,
    "retract_status": KnowledgeBase.retract_status,
    "select": _select,
    "finish_plan": _finish,
}


def _selection(kb: KnowledgeBase) -> tuple[dict[str, str], dict[str, str]]:
    designs = {view.function: name for name, view in kb.designs.items() if view.is_selected}
    configurations = {view.component: name for name, view in kb.configurations.items() if view.is_selected}
    return designs, configurations
