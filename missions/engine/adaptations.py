"""The table of adaptations: the decisions of a run that news caused."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final

from kb import Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

_MEMORY: Final = 256  # news that may have caused a decision
_TASK: Final = "task"


def plans_after(last: "PlanRecord | None", plans: Sequence["PlanRecord"]) -> Sequence["PlanRecord"]:
    """Return the task plans after one of them; all if it is not among them any more."""
    number = len(plans)
    while number and plans[number - 1] is not last:
        number -= 1
    return plans[number:]


def is_news(kb: KnowledgeBase, event: Event) -> bool:
    """Return whether an event is news from the robot, and no effect of a plan being executed."""
    # a component that stops by itself comes with a reason
    is_switched = event.verb == "component_active" and not event.arguments[2]
    return event.kind is EventKind.MONITORING_DATA and not (is_switched and kb.history.open_plans)


@dataclass(frozen=True, slots=True)
class News:
    """News that changed a status or a percept, or several at once.

    Attributes:
        time: [s].
        text: the news in words.
        events: their numbers; none for what only the task layer perceives.
        reason: why the news calls for a change, if the news alone says so.
    """

    time: float
    text: str
    events: tuple[int, ...] = ()
    reason: str = ""


@dataclass(slots=True)
class Adaptation:
    """One change of the robot or of what it does, because of something that was measured.

    Attributes:
        at_s: when it was decided [s].
        kind: "parameter", "structural" (components switched) or "task" (another action).
        news: what caused it, and why that called for a change.
        decision: a task adaptation in words.
        before, action: of a task adaptation, the action that has ended and the one that follows.
        plans: its reconfiguration plans, each with what it changes, in words.
    """

    at_s: float
    kind: str
    news: News
    decision: str = ""
    before: str = ""
    action: str = ""
    plans: list[tuple[str, ReconfigurationPlan]] = field(default_factory=list)

    @property
    def trigger(self) -> str:
        return self.news.text

    @property
    def reason(self) -> str:
        return self.news.reason

    @property
    def change(self) -> str:
        """What was changed, in words, and which plans did not succeed."""
        parts = [self.decision] if self.decision else []
        for words, plan in self.plans:
            is_whole = plan.result in (None, "completed")
            parts.append(words if is_whole else f"{words} ({plan.result})")
        return "; ".join(parts)

    @property
    def in_force_s(self) -> float:
        """When it was in force [s]; infinity if it never was."""
        if not self.plans:
            return self.at_s
        last = self.plans[-1][1]
        if last.end is None or last.result != "completed":
            return inf
        return max(self.at_s, last.end)

    @property
    def reaction_s(self) -> float | None:
        """Time from the news until the change was in force [s]; None if it never was."""
        return None if self.in_force_s == inf else self.in_force_s - self.news.time

    @property
    def why(self) -> str:
        """The reason, with the news in front if the reason does not mention it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"


class AdaptationLog:
    """Enters adaptations from the causes that the records of a knowledge base carry.

    A reconfiguration plan is an adaptation if news from the robot caused it. A new action is a task
    adaptation if the action before it became unfeasible, failed, or was given up after news; or if
    it had been given up itself, and is feasible again. The reconfiguration plans for the new action
    belong to it. An action that was given up and that no other follows is one, too; so is a new
    task plan with steps that the one before did not have, unless its first action was reported.

    Not an adaptation: the first action, the next one after a completed action, the next step of a
    plan, the same action again, and anything that no news caused.

    Args:
        report: called with each adaptation once it is in force or has failed.

    Attributes:
        is_listening: whether the next events may be news; else the task layer itself records them.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        report: Callable[[Adaptation], None],
    ) -> None:
        self.adaptations: list[Adaptation] = []
        self.is_listening = True
        self._kb = kb
        self._report = report
        self._heard: deque[News] = deque(maxlen=_MEMORY)
        self._latest: News | None = None  # the last of these, until a tick can react to it
        self._answered: News | None = None  # the one that this tick can react to
        self._last_tick = -inf
        self._this_tick = -inf
        self._lost: dict[str, News] = {}  # by action: what made it unfeasible
        self._regained: dict[str, News] = {}  # by action: what made it feasible again
        self._unanswered: dict[int, News] = {}  # by event: news that no plan was made for
        self._results: dict[str, str] = {}  # by action: how it has ended the last time
        self._begun: Event | None = None  # the last request, and the last end, until settled
        self._ended: Event | None = None
        self._past: tuple[Event, News | None] | None = None  # an end that no request followed
        self._new_plans: list[ReconfigurationPlan] = []  # which belong to no adaptation yet
        self._open: list[Adaptation] = []
        self._steps: frozenset[Step] = frozenset()  # of the last task plan
        kb.log.witnesses += (self._on_event,)  # before subscribers, on the thread that records

    def sensed(self, text: str) -> None:
        """Note a change that only the task layer perceives."""
        self._note(News(self._kb.now, text))

    def _note(self, news: News) -> None:
        """Note news, as one with other news to which no tick could react yet."""
        latest = self._latest
        if latest is not None:
            self._heard.pop()
            text = latest.text if news.text in latest.text else f"{latest.text} and {news.text}"
            news = News(latest.time, text, latest.events + news.events)
        self._heard.append(news)
        self._latest = news

    def ticking(self, time: float) -> None:
        """Note that a tick begins at this time [s]; it can react to all news until now."""
        self._last_tick = self._this_tick
        self._this_tick = time
        self._answered = self._latest
        self._latest = None

    def settle(self, task_plans: Sequence["PlanRecord"] = ()) -> None:
        """Assign decisions to causes, and report what is over; call it after the manager.

        Args:
            task_plans: those that were made since the last time.
        """
        with self._kb.reading():
            solved = [plan for plan in task_plans if plan.outcome.is_solved]
            plan = solved[-1] if solved else None
            if self._ended is not None:
                self._past = self._ended, self._cause_of_end(self._ended, plan)
                self._ended = None
            is_entered = self._settle_action(plan)
            if plan is not None:
                self._settle_steps(plan, is_entered=is_entered)
            self._settle_plans()
            if self._kb.pending_plan is None:
                self._close([entry for entry in self._open if self._is_over(entry)])

    def finish(self) -> None:
        """Report an action that was given up and that no other followed; call it at the end."""
        ended, cause = self._past or (None, None)
        if ended and cause and not self._kb.required_actions:
            self._past = None
            self._enter_change(ended, cause, "nothing", ended.time)
            self._settle_plans()
            self.adaptations.sort(key=lambda entry: entry.at_s)
            self._close(self._open[-1:])

    def _on_event(self, event: Event) -> None:
        if event.plan is not None:
            self._new_plans.append(event.plan)
        elif event.verb == "request_action":
            self._begun = event
            self._lost.pop(event.subject, None)
        elif event.verb == "cancel_action":
            self._ended = event
            if self._begun and self._begun.subject == event.subject:
                self._begun = None
        elif self.is_listening and event.changes and is_news(self._kb, event):
            self._on_news(event)

    def _on_news(self, event: Event) -> None:
        news = News(event.time, event.text, (event.number,))
        self._note(news)
        self._unanswered[event.number] = news
        if len(self._unanswered) > _MEMORY:
            del self._unanswered[min(self._unanswered)]
        for kind, action, old, new in event.changes:
            if kind == "action" and new is Status.UNFEASIBLE:
                reason = self._kb.why(self._kb.actions[action])
                self._lost[action] = replace(news, reason=reason)
            elif kind == "action" and old is Status.UNFEASIBLE:
                self._lost.pop(action, None)
                self._regained[action] = replace(news, reason=f"{action} is feasible again")

    # ---------------------------------------------------------------- causes

    def _cause_of_end(self, event: Event, plan: "PlanRecord | None") -> News | None:
        """Return the news for which an action was given up, with the task plan that followed."""
        action, result, reason = event.arguments
        self._results[action] = result
        self._regained.pop(action, None)
        if result == "completed":
            return None
        if action in self._lost:
            return self._lost[action]
        if result == "failed":
            reason = reason or f"{action} gave no reason"
            return News(event.time, f"{action} has failed", (event.number,), reason)
        if plan is not None:
            return self._cause_of_task_plan(plan)
        return self._answered

    def _cause_of_task_plan(self, plan: "PlanRecord") -> News:
        """Return the news when a plan was requested, else the reason of the plan."""
        heard = [news for news in self._heard if news.time <= plan.at_s]
        last = heard[-1] if heard else News(plan.at_s, plan.reason)
        return replace(last, reason=plan.reason)

    def _cause_of_change(
        self, before: str, given_up: News | None, begun: Event, plan: "PlanRecord | None"
    ) -> News | None:
        """Return the news for which an action replaces another; None for the ordinary course."""
        action = begun.subject
        cause = given_up if before != action else None
        regained = self._regained.get(action)
        if regained is None:
            return cause
        if cause is not None:  # perhaps nothing was feasible in between
            return max(cause, regained, key=lambda news: news.time)
        is_step = plan is None and self._steps
        if is_step or self._results.get(action, "completed") == "completed":
            return None
        if regained.time >= self._last_tick:
            return regained
        # it was feasible for a while, but had to wait until something else ended
        since = f"{regained.reason} (since {regained.time:.1f} s: {regained.text})"
        return News(begun.time, f"{before} is over", regained.events, since)

    # ---------------------------------------------------------------- decisions

    def _settle_action(self, plan: "PlanRecord | None") -> bool:
        """Enter an action that replaces another because of news; return whether there is one."""
        begun = self._begun
        self._begun = None
        if begun is None or self._past is None:
            return False
        ended, given_up = self._past
        self._past = None
        cause = self._cause_of_change(ended.subject, given_up, begun, plan)
        if cause is None:
            return False
        if plan is not None and not cause.reason:
            cause = replace(cause, reason=plan.reason)
        self._enter_change(ended, cause, begun.subject, begun.time)
        return True

    def _settle_steps(self, plan: "PlanRecord", *, is_entered: bool) -> None:
        """Enter a task plan with new steps, unless its first action was entered."""
        added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
        if added and self._steps and not is_entered:
            change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
            cause = self._cause_of_task_plan(plan)
            self._enter(Adaptation(self._this_tick, _TASK, cause, change))
        self._steps = frozenset(plan.steps)

    def _settle_plans(self) -> None:
        """Assign reconfiguration plans to their news, or to the change of action they serve."""
        waiting = []
        for plan in self._new_plans:
            changes = [entry for entry in self._open if entry.action]
            entry = changes[-1] if changes else None
            news = self._unanswered.pop(plan.cause or 0, None)
            if news is not None and (entry is None or plan.cause not in entry.news.events):
                kind = "structural" if plan.activate or plan.deactivate else "parameter"
                entry = self._enter(Adaptation(plan.start, kind, replace(news, reason=plan.reason)))
            if entry is not None:
                entry.plans.append((self._plan_in_words(plan), plan))
            elif self._past is not None and plan.cause == self._past[0].number:
                waiting.append(plan)  # for the action that comes next
        self._new_plans = waiting

    def _enter_change(self, ended: Event, cause: News, action: str, time: float) -> None:
        before = ended.subject
        reason = cause.reason or f"{action} is chosen, though {before} is still feasible"
        news = replace(cause, reason=reason)
        self._enter(Adaptation(time, _TASK, news, f"{before} -> {action}", before, action))

    def _enter(self, entry: Adaptation) -> Adaptation:
        self.adaptations.append(entry)
        self._open.append(entry)
        return entry

    def _is_over(self, entry: Adaptation) -> bool:
        """Return whether the robot is configured for it, or a tick has passed since it was."""
        acted_s = max([entry.at_s, *(plan.end or inf for _, plan in entry.plans)])
        action = self._kb.actions.get(entry.action)
        is_solved = action is None or action.status is Status.SOLVED
        return is_solved or self._last_tick >= acted_s

    def _close(self, entries: Sequence[Adaptation]) -> None:
        for entry in entries:
            self._open.remove(entry)
            self._report(entry)

    def _step_in_words(self, step: "Step") -> str:
        objects = [name for name in step.arguments if name not in self._kb.actions]
        return f"{step.schema}({', '.join(objects)})"

    def _plan_in_words(self, plan: ReconfigurationPlan) -> str:
        """Return what a plan commands, in words: plain components take no commands."""
        parts = []
        for verb, names in (("stop", plan.deactivate), ("start", plan.activate)):
            commanded = [name for name in names if name not in plan.plain]
            if commanded:
                parts.append(f"{verb} {', '.join(commanded)}")
        for name in plan.parameters:
            configuration = self._kb.configurations[name]
            pairs = [f"{key} = {value}" for key, value in configuration.parameters.items()]
            parts.append(f"set {configuration.component} to {name} ({', '.join(pairs)})")
        return "; ".join(parts) or str(plan)
