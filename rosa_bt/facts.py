"""What a knowledge base was told and what it answered, written down as plain data, and told again."""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from kb import Event, KnowledgeBase, ReconfigurationPlan, Status
from kb.elements import Constraint, Element
from kb.facts import PlanFact
from kb.views import FunctionView
from rosa_bt.behaviours import StatusView
from rosa_bt.exceptions import TraceError

__all__ = ["Decision", "Fact", "Listener", "tell"]


class Fact(NamedTuple):
    """Something that a knowledge base was told.

    Attributes:
        time: when [s].
        verb: what kind of fact: the name of the method of the knowledge base.
        arguments: what it was called with, e.g. ("light", 0.3); a plan is its number. An element that shares its name
            with others is [kind, name], and a constraint [kind, name, number] by what it constrains.
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

    What the knowledge base knows already comes as the first facts: what is measured, required, has failed, runs and is
    selected; not an asserted status, nor a plan that is open.

    Attributes:
        is_deaf: what is told now is not kept as a fact: the tree tells it, and would tell it again.
        decisions: what became of actions since they were taken last.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self.is_deaf = False
        self.decisions: list[Decision] = []
        self._facts: list[Fact] = []
        self._planned = sum(isinstance(fact, PlanFact) for fact in kb.model.facts)
        self._open: list[tuple[int, ReconfigurationPlan]] = []
        self._begin(kb)
        self.stop = kb.subscribe(self._hear)

    def _begin(self, kb: KnowledgeBase) -> None:
        """Take what is known as the first facts."""
        for name, attribute in kb.attributes.items():
            if attribute.time is not None:
                self._keep(attribute.time, "measure", name, attribute.value)
        for required in kb.required_actions:
            self._keep(required.start, "request_action", required.action, required.preference)
        self._facts.sort(key=lambda fact: fact.time)
        for name, component in kb.components.items():
            if component.status is Status.FAILURE:
                self._keep(kb.now, "component_failed", name, kb.explain(component).reason)
            if component.is_active:
                self._keep(kb.now, "component_active", name, True, "")
        for view in (*kb.designs.values(), *kb.configurations.values()):
            if view.is_selected:
                self._keep(kb.now, "assert_selected", view.element, True, view.reason)

    def take_facts(self) -> tuple[Fact, ...]:
        """Return the facts since the last time."""
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
        if not self.is_deaf:
            self._look_at_plans()  # no event tells that a plan has ended; whatever did so came before this one
        verb, arguments = event.verb, event.arguments
        if verb in _VERBS and verb != "finish_plan":
            if verb == "request_action":
                self.decisions.append(Decision(event.subject, "requested", ""))
            elif verb == "cancel_action":
                _, result, reason = arguments
                self.decisions.append(Decision(event.subject, result, reason))
            self._keep(event.time, verb, *arguments)
        if event.plan is not None:
            self._open.append((self._planned, event.plan))
            self._planned += 1
        for change in event.changes:
            is_unfeasible = change.new is Status.UNFEASIBLE
            if change.kind == "action" and is_unfeasible != (change.old is Status.UNFEASIBLE):
                reason = self._kb.why(self._kb.actions[change.name]) if is_unfeasible else ""
                self.decisions.append(Decision(change.name, "unfeasible" if is_unfeasible else "feasible", reason))

    def _keep(self, time: float, verb: str, *arguments: object) -> None:
        if not self.is_deaf:
            self._facts.append(Fact(time, verb, tuple(_plain(self._kb, one) for one in arguments)))

    def _look_at_plans(self) -> None:
        if not self._open:
            return
        open_before, self._open = self._open, []
        for number, plan in open_before:
            if plan.end is None:
                self._open.append((number, plan))
            else:
                self._keep(plan.end, "finish_plan", number, plan.result)


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
        verb(kb, *(_meant(kb, one) for one in fact.arguments))
    except (IndexError, TypeError) as error:
        raise TraceError(f"{fact.verb}{fact.arguments!r} cannot be told again: {error}") from error


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
    "request_action": KnowledgeBase.request_action,
    "cancel_action": KnowledgeBase.cancel_action,
    "select": KnowledgeBase.select,
    "finish_plan": _finish,
}


def _tables(kb: KnowledgeBase) -> dict[str, Mapping[str, StatusView]]:
    return {
        "action": kb.actions,
        "function": kb.functions,
        "component": kb.components,
        "function design": kb.designs,
        "configuration": kb.configurations,
    }


def _plain(kb: KnowledgeBase, argument: object) -> object:
    """Return an argument as it is written; an element by name, with its kind only if others have that name."""
    if isinstance(argument, Mapping):
        return dict(argument)
    if isinstance(argument, tuple):
        kind, name, *position = argument
        is_unique = not position and sum(name in table for table in _tables(kb).values()) == 1
        return name if is_unique else list(argument)
    if not isinstance(argument, Element | Constraint):
        return argument
    owner = argument if isinstance(argument, Element) else argument.constrained[0]
    namesakes = {kind: table[owner.name] for kind, table in _tables(kb).items() if owner.name in table}
    kind, view = next(found for found in namesakes.items() if found[1].element is owner)
    if isinstance(argument, Constraint):
        assert not isinstance(view, FunctionView)
        return [kind, owner.name, [one.element for one in view.constraints].index(argument)]
    return owner.name if len(namesakes) == 1 else [kind, owner.name]


def _meant(kb: KnowledgeBase, written: object) -> object:
    """Return an argument as the knowledge base takes it."""
    if not isinstance(written, list):
        return written
    match written:
        case [str(kind), str(name), *number] if kind in _tables(kb):
            view = _tables(kb)[kind][name]
            return view.constraints[number[0]] if number and not isinstance(view, FunctionView) else view
    raise TypeError(f"{written!r} is no element; one is [kind, name], kinds are {', '.join(_tables(kb))}")
