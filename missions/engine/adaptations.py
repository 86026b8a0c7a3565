"""The table of adaptations: the decisions of a run that news caused."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final

from kb import Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

_MEMORY: Final = 256  # news, and ticks with news, that wait for a plan that answers them


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
        reason: why another action is needed, if the news alone says so.
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
        trigger: the news that caused it.
        reason: why the news called for a change.
        change: what was changed.
        reaction_s: time from the news until the change was in force [s]; None if it never was.
        news_s: the time of the news [s].
        before, action: of a task adaptation, the action that has ended and the one that follows.
        events: the numbers of the events of the news.
        plans: its reconfiguration plans, each with what it changes, in words.
    """

    at_s: float
    kind: str
    trigger: str
    reason: str
    change: str
    reaction_s: float | None = None
    news_s: float = field(default=0.0, repr=False)
    before: str = field(default="", repr=False)
    action: str = field(default="", repr=False)
    events: tuple[int, ...] = field(default=(), repr=False)
    plans: list[tuple[str, ReconfigurationPlan]] = field(default_factory=list, repr=False)

    @property
    def in_force_s(self) -> float:
        """When it was in force [s]; infinity if it never was."""
        return inf if self.reaction_s is None else self.news_s + self.reaction_s

    @property
    def why(self) -> str:
        """The reason, with the news in front if the reason does not mention it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"

    def close(self) -> None:
        """Update `change` and `reaction_s` by how the plans have ended so far."""
        if not self.plans:
            self.reaction_s = self.at_s - self.news_s
            return
        last = self.plans[-1][1]
        if last.result == "completed" and last.end is not None:
            self.reaction_s = max(self.at_s, last.end) - self.news_s
        parts = [f"{self.before} -> {self.action}"] if self.action else []
        for words, plan in self.plans:
            is_whole = plan.result in (None, "completed")
            parts.append(words if is_whole else f"{words} ({plan.result})")
        self.change = "; ".join(parts)


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
        plans: returns the task plans so far.

    Attributes:
        is_listening: whether the next events may be news; else they are our own doing.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        report: Callable[[Adaptation], None] = lambda adaptation: None,
        plans: Callable[[], Sequence["PlanRecord"]] = tuple,
    ) -> None:
        self.adaptations: list[Adaptation] = []
        self.is_listening = True
        self._kb = kb
        self._report = report
        self._plans = plans
        self._heard: list[News] = []  # since the last tick
        self._ticks: deque[tuple[float, News]] = deque(maxlen=_MEMORY)  # those with news
        self._last_tick = -inf
        self._this_tick = -inf
        self._lost: dict[str, News] = {}  # by action: what made it unfeasible
        self._regained: dict[str, News] = {}  # by action: what made it feasible again
        self._unanswered: dict[int, News] = {}  # by event
        self._begun: Event | None = None  # the last request
        self._ended: tuple[Event, News | None] | None = None  # the last action's end, and its cause
        self._new_plans: list[ReconfigurationPlan] = []  # which belong to no adaptation yet
        self._open: list[Adaptation] = []
        self._last_plan: PlanRecord | None = None
        self._steps: frozenset[Step] = frozenset()
        kb.log.witnesses += (self._on_event,)  # before subscribers, on the thread that records

    def sensed(self, text: str) -> None:
        """Note a change that only the task layer perceives."""
        self._heard.append(News(self._kb.now, text))

    def ticking(self, time: float) -> None:
        """Note that a tick begins at this time [s]; it can react to all news until now."""
        with self._kb.reading():  # other threads than the one that ticks may record events
            self._last_tick = self._this_tick
            self._this_tick = time
            if self._heard:
                events = dict.fromkeys(number for news in self._heard for number in news.events)
                text = " and ".join(dict.fromkeys(news.text for news in self._heard))
                self._ticks.append((time, News(self._heard[0].time, text, tuple(events))))
                self._heard.clear()

    def settle(self) -> None:
        """Assign decisions to causes, and report what is over; call it after the manager."""
        with self._kb.reading():
            self._settle_task_plans(is_reported=self._settle_actions())
            self._settle_plans()
            if self._kb.pending_plan is None:
                self._close([entry for entry in self._open if self._is_over(entry)])

    def finish(self) -> None:
        """Report an action that was given up and that no other followed; call it at the end."""
        ended, cause = self._ended or (None, None)
        if ended and cause and not self._kb.required_actions:
            self._ended = None
            self._enter_change(ended, cause, "nothing", ended.time)
            self._settle_plans()
            self.adaptations.sort(key=lambda entry: entry.at_s)
            self._close(self._open[-1:])

    # ---------------------------------------------------------------- events

    def _on_event(self, event: Event) -> None:
        if event.plan is not None:
            self._new_plans.append(event.plan)
        elif event.verb == "request_action":
            self._lost.pop(event.subject, None)
            self._begun = event
        elif event.verb == "cancel_action":
            self._on_end(event)
        elif self.is_listening and event.changes and is_news(self._kb, event):
            self._on_news(event)

    def _on_news(self, event: Event) -> None:
        news = News(event.time, event.text, (event.number,))
        self._heard.append(news)
        self._unanswered[event.number] = news
        if len(self._unanswered) > _MEMORY:
            del self._unanswered[min(self._unanswered)]
        for change in event.changes:
            action = change.name
            if change.kind == "action" and change.new is Status.UNFEASIBLE:
                self._lost[action] = replace(news, reason=self._why(action))
            elif change.kind == "action" and change.old is Status.UNFEASIBLE:
                self._lost.pop(action, None)
                self._regained[action] = replace(news, reason=f"{action} is feasible again")

    def _why(self, action: str) -> str:
        return self._kb.why(self._kb.actions[action])

    def _on_end(self, event: Event) -> None:
        """Note which action has ended and why; a tree may begin the next before it ends this."""
        if self._begun and self._begun.subject == event.subject:
            self._begun = None
        cause = None
        if event.arguments[1] != "completed":
            cause = self._cause_of_end(event)
            self._regained.pop(event.subject, None)
        self._ended = event, cause

    def _cause_of_end(self, event: Event) -> News | None:
        action, result, reason = event.arguments
        if action in self._lost:
            return self._lost[action]
        if result == "failed":
            reason = reason or f"{action} gave no reason"
            return News(event.time, f"{action} has failed", (event.number,), reason)
        if event.cause is not None:  # what the manager or the task layer found out by itself
            cause = next(self._kb.log.since(event.cause - 1), event)
            return News(cause.time, cause.text, (cause.number,), self._why(action))
        plan = self._new_task_plan()
        if plan is not None:
            return self._cause_of_task_plan(plan)
        is_now = self._ticks and self._ticks[-1][0] == self._this_tick
        return self._ticks[-1][1] if is_now else None

    def _new_task_plan(self) -> "PlanRecord | None":
        """Return the task plan that was found in this tick, if any."""
        plans = plans_after(self._last_plan, self._plans())
        return plans[-1] if plans and plans[-1].outcome.is_solved else None

    def _cause_of_task_plan(self, plan: "PlanRecord") -> News:
        """Return the news when a plan was requested, else the reason of the plan."""
        news = [news for tick, news in self._ticks if tick <= plan.at_s]
        last = news[-1] if news else News(plan.at_s, plan.reason)
        return replace(last, reason=plan.reason)

    # ---------------------------------------------------------------- decisions

    def _settle_actions(self) -> bool:
        """Enter an action that replaces another because of news; return whether there is one."""
        begun = self._begun
        self._begun = None
        if begun is None or self._ended is None:
            return False
        ended, given_up = self._ended
        self._ended = None
        cause = self._cause_of_change(ended.subject, given_up, begun)
        if cause is None:
            return False
        plan = self._new_task_plan()
        if plan is not None and not cause.reason:
            cause = replace(cause, reason=plan.reason)
        self._close([entry for entry in self._open if entry.action])
        self._enter_change(ended, cause, begun.subject, begun.time)
        return True

    def _cause_of_change(self, before: str, given_up: News | None, begun: Event) -> News | None:
        """Return the news for which an action replaces another; None for the ordinary course."""
        action = begun.subject
        cause = given_up if before != action else None
        regained = self._regained.get(action)
        if regained is None:
            return cause
        if cause is not None:  # perhaps nothing was feasible in between
            return max(cause, regained, key=lambda news: news.time)
        ended = [each for each in self._kb.history.actions if each.action == action and each.end]
        is_step = self._new_task_plan() is None and self._plans()
        if is_step or not ended or ended[-1].result == "completed":
            return None
        if regained.time >= self._last_tick:
            return regained
        # it was feasible for a while, but had to wait until something else ended
        since = f"{regained.reason} (since {regained.time:.1f} s: {regained.text})"
        return News(begun.time, f"{before} is over", regained.events, since)

    def _settle_task_plans(self, *, is_reported: bool) -> None:
        """Enter a task plan with new steps, unless its first action was reported."""
        for plan in plans_after(self._last_plan, self._plans()):
            self._last_plan = plan
            if not plan.outcome.is_solved:
                continue
            added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
            if added and self._steps and not is_reported:
                change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
                cause = self._cause_of_task_plan(plan)
                self._close([self._enter(self._this_tick, "task", cause, change)])
            self._steps = frozenset(plan.steps)

    def _settle_plans(self) -> None:
        """Assign reconfiguration plans to their news, or to the change of action they serve."""
        waiting = []
        for plan in self._new_plans:
            entry = next((entry for entry in self._open if entry.action), None)
            cause = self._unanswered.pop(plan.cause or 0, None)
            if cause is not None and (entry is None or plan.cause not in entry.events):
                kind = "structural" if plan.activate or plan.deactivate else "parameter"
                entry = self._enter(plan.start, kind, replace(cause, reason=plan.reason))
            if entry is not None:
                entry.plans.append((self._plan_in_words(plan), plan))
                entry.close()
            elif self._ended is not None and plan.cause == self._ended[0].number:
                waiting.append(plan)  # for the action that comes next
        self._new_plans = waiting

    def _enter_change(self, ended: Event, cause: News, action: str, time: float) -> None:
        before = ended.subject
        reason = cause.reason or f"{action} is chosen, though {before} is still feasible"
        entry = self._enter(time, "task", replace(cause, reason=reason), f"{before} -> {action}")
        entry.before = before
        entry.action = action

    def _enter(self, time: float, kind: str, cause: News, change: str = "") -> Adaptation:
        entry = Adaptation(time, kind, cause.text, cause.reason, change)
        entry.news_s = cause.time
        entry.events = cause.events
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
            entry.close()
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
