"""The table of adaptations: what of a run's events was an adaptation, by its cause, and what the ordinary course."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from kb import ComponentKind, Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

_REMEMBERED: Final = 256  # ticks that news has led, and news, until the plan that they asked for is there


@dataclass(frozen=True, slots=True)
class _News:
    """What became known, when it was so [s], in which events it came, and why it calls for another action by itself."""

    time: float
    text: str
    events: tuple[int, ...] = ()
    reason: str = ""


class _Ended(NamedTuple):
    """An action that has ended, in which event; cause: why it was given up, None if it was not or not for any news."""

    action: str
    at_s: float
    event: int
    cause: _News | None


@dataclass(slots=True)
class Adaptation:
    """One change of the robot or of what it does, made because of something that was measured.

    Attributes:
        at_s: when it was decided [s].
        kind: "parameter", "structural" (components switched) or "task" (another action, and what that needs).
        trigger: the news that set it off.
        reason: why that called for a change.
        change: what was changed.
        reaction_s: from the news to the change being in force [s]; None if it never was.
        news_s: when the news was so [s].
        before, action: of a task adaptation, the action that was given up or has ended, and the one in its place.
        events: numbers of the events that were the news; none if the task layer alone perceived it.
        plans: the plans that belong to it, each with what it changes, in words.
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
        """The reason, and the news where the reason does not speak of it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"

    def is_over(self, kb: KnowledgeBase, last_tick: float) -> bool:
        """Whether the robot is configured as it is to be, or nobody does anything about it any more."""
        if not self.action:
            return self.plans[-1][1].end is not None
        if kb.pending_plan is not None:
            return False
        if all(one.action != self.action for one in kb.required_actions):
            return True
        latest = kb.latest_plan
        acted = self.at_s if latest is None or latest.end is None else max(self.at_s, latest.end)
        return kb.actions[self.action].status is Status.SOLVED or last_tick >= acted

    def close(self) -> Self:
        """Say how the plans have ended up to now, and when the last was in force, if it was."""
        if not self.plans:
            self.reaction_s = self.at_s - self.news_s
        elif (last := self.plans[-1][1]).result == "completed" and last.end is not None:
            self.reaction_s = max(self.at_s, last.end) - self.news_s
        parts = [f"{self.before} -> {self.action}"] if self.action else []
        for words, plan in self.plans:
            parts.append(words if plan.result in (None, "completed") else f"{words} ({plan.result})")
        self.change = "; ".join(parts) or self.change
        return self


class AdaptationLog:
    """The table of adaptations: a fold over the log of a knowledge base, by the causes that its records carry.

    A new plan of reconfiguration is an adaptation if news from the robot led to it. A new action is one if the action
    before it

    - was given up, or failed, because it had become unfeasible, or failed at all, or was given up after other news,
    - or was taken up when it was feasible again, after it had been given up itself.

    The plans that configure the robot for it belong to it. If none follows by the end of the run, that is one, too. A
    task plan that was made anew, and has steps that the one before had not, is one too, unless the action that is begun
    for it says as much.

    Not an adaptation: the first action, the next one after one that is completed, the next step of a plan, the same
    action again, and whatever no news has led to.

    Args:
        report: called with each adaptation once it is in force or has failed.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        report: Callable[[Adaptation], None] = lambda adaptation: None,
        plans: Callable[[], Sequence["PlanRecord"]] = tuple,
    ) -> None:
        self.adaptations: list[Adaptation] = []
        self._kb, self._report, self._plans = kb, report, plans
        self._stamp: float | None = None
        # news: since the last tick, with whether it made a difference; what led the tick; what led earlier ones
        self._heard: list[tuple[_News, bool]] = []
        self._led: list[_News] = []
        self._turns: deque[tuple[float, list[_News]]] = deque(maxlen=_REMEMBERED)
        self._last_tick = self._this_tick = -inf
        # by action: what made it unfeasible, or feasible again; by event: what the manager has not answered, maybe yet
        self._lost: dict[str, _News] = {}
        self._regained: dict[str, _News] = {}
        self._to_answer: deque[_News] = deque(maxlen=_REMEMBERED)
        # what was decided: the action that ended last, until another begins; plans that are put down to nothing yet
        self._before: _Ended | None = None
        self._made: list[ReconfigurationPlan] = []
        self._open: list[Adaptation] = []
        self._settled, self._plans_settled = kb.log.last, 0
        self._steps: frozenset[Step] = frozenset()
        kb.log.witnesses += (self._hear,)  # at once and in order, whichever thread calls the subscribers, and when

    def news(self, stamp: float | None) -> None:
        """Say that what the knowledge base hears next is news of that time [s]; None: it is our own doing.

        Infinity: whatever comes is news of the time at which it comes, as where nobody says what is.
        """
        self._stamp = stamp

    def sensed(self, text: str) -> None:
        """Say that something the task layer alone perceives is not as before, while there is news."""
        if self._stamp is not None:
            self._heard.append((_News(self._stamp, text), True))

    def ticking(self, time: float) -> None:
        """Say that the task layer is about to be ticked [s]: it can be led by what was heard until now."""
        with self._kb.reading():  # facts may be told by other threads than the one that ticks
            self._last_tick, self._this_tick = self._this_tick, time
            heard, self._heard = self._heard, []
            turns = [news for news, is_turn in heard if is_turn]
            self._led = turns or [news for news, _ in heard]
            if turns:
                self._turns.append((time, turns))

    def passed_over(self, time: float) -> None:
        """Say that a tick was left out [s], in which there was nothing to do; nothing if it was told already."""
        if time > self._this_tick:
            self.ticking(time)

    def settle(self) -> None:
        """Put together what was decided, and complete what has ended; called after each turn of the manager."""
        with self._kb.reading():
            self._settle_task_plans(is_reported=self._settle_actions())
            self._put_down_plans()
            self._settled = self._kb.log.last
            over = [one for one in self._open if one.is_over(self._kb, self._last_tick)]
            self._close(sorted(over, key=lambda one: not one.action))

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing is under way that the next tick or turn of the manager may end."""
        return not self._open and len(self._plans()) == self._plans_settled

    def finish(self) -> None:
        """Tell of an action that was given up and that none has followed; called when a run ends short of its goal."""
        last, self._before = self._before, None
        if last is None or last.cause is None or self._kb.required_actions:
            return
        self._change(last, "nothing", last.at_s, last.cause)
        self._put_down_plans()
        self.adaptations.sort(key=lambda one: one.at_s)
        self._close(self._open[-1:])

    # ---------------------------------------------------------------- what is heard

    def _hear(self, event: Event) -> None:
        if event.plan is not None:
            self._made.append(event.plan)
        elif event.verb == "request_action":
            self._lost.pop(event.subject, None)
        elif event.verb == "cancel_action":
            self._hear_end(event, *event.arguments)
        elif self._stamp == inf and is_news(self._kb, event):
            self._hear_news(event, event.time)
        elif self._stamp not in (None, inf) and event.kind is EventKind.MONITORING_DATA:
            self._hear_news(event, self._stamp)

    def _hear_news(self, event: Event, time: float) -> None:
        news = _News(time, event.text, (event.number,))
        for change in event.changes:
            if change.kind == "action" and change.new is Status.UNFEASIBLE:
                self._lost[change.name] = replace(news, reason=self._kb.why(self._kb.actions[change.name]))
            elif change.kind == "action" and change.old is Status.UNFEASIBLE:
                self._lost.pop(change.name, None)
                self._regained[change.name] = replace(news, reason=f"{change.name} is feasible again")
        self._heard.append((news, bool(event.changes)))
        if event.changes:
            self._to_answer.append(news)

    def _hear_end(self, event: Event, action: str, result: str, reason: str) -> None:
        """Note what has ended and why; a tree may begin the next one before it ends this one."""
        record = next(one for one in reversed(self._kb.history.actions) if one.action == action)
        if record.number <= self._settled:  # else it ended in the tick in which it began
            cause = None if result == "completed" else self._why_given_up(event, action, result, reason)
            self._before = _Ended(action, event.time, event.number, cause)
        if result != "completed":
            self._regained.pop(action, None)

    def _why_given_up(self, event: Event, action: str, result: str, reason: str) -> _News | None:
        if action in self._lost:
            return self._lost[action]
        if result == "failed":
            return _News(event.time, f"{action} has failed", (event.number,), reason or f"{action} gave no reason")
        if event.cause is not None:  # a word of the task layer itself
            own = next(self._kb.log.since(event.cause - 1), event)
            return _News(own.time, own.text, (own.number,), self._kb.why(self._kb.actions[action]))
        plan = self._new_plan()
        return _together(self._led) if plan is None else self._cause_of_plan(plan)

    def _new_plan(self) -> "PlanRecord | None":
        """Return the task plan that was found in this tick, if one was."""
        plans = self._plans()
        return plans[-1] if len(plans) > self._plans_settled and plans[-1].outcome.is_solved else None

    def _cause_of_plan(self, plan: "PlanRecord") -> _News:
        """Return what was news when a plan was asked for, or else why it was."""
        led = next((led for tick, led in reversed(self._turns) if tick <= plan.at_s), [])
        return replace(_together(led) or _News(plan.at_s, plan.reason), reason=plan.reason)

    # ---------------------------------------------------------------- what comes of it

    def _settle_actions(self) -> bool:
        """Return whether the action that was begun stands in for another because of news; note so if it does."""
        began = [one for one in self._kb.required_actions if one.number > self._settled]
        if not began:
            return False
        before, self._before = self._before, None
        cause = None if before is None else self._why_begun(before, began[-1].action, began[-1].start)
        if before is None or cause is None:
            return False
        plan = self._new_plan()
        if plan is not None and not cause.reason:
            cause = replace(cause, reason=plan.reason)
        self._close([one for one in self._open if one.action])
        self._change(before, began[-1].action, began[-1].start, cause)
        return True

    def _why_begun(self, before: _Ended, action: str, time: float) -> _News | None:
        """Return what made an action take the place of another; None for the ordinary course."""
        cause = before.cause if before.action != action else None
        regained = self._regained.get(action)
        if regained is None or (cause is None and not self._was_given_up(action)):
            return cause
        if cause is not None:
            return regained if regained.time > cause.time else cause  # there was nothing else to be done before
        plan = self._new_plan()
        if plan is None and self._plans():
            return None  # it is the next step of the plan
        if regained.time >= self._last_tick:
            return regained
        # it has been feasible for a while, and waited for something else to end
        if plan is not None and not self._steps.issuperset(plan.steps):
            return self._cause_of_plan(plan)
        since = f"{regained.reason} (since {regained.time:.1f} s: {regained.text})"
        return _News(time, f"{before.action} is over", regained.events, since)

    def _was_given_up(self, action: str) -> bool:
        ended = (one for one in reversed(self._kb.history.actions) if one.action == action and one.end is not None)
        return next((one.result != "completed" for one in ended), False)

    def _change(self, before: _Ended, action: str, time: float, cause: _News) -> None:
        reason = cause.reason or f"{action} is chosen, though {before.action} is still feasible"
        self._enter(time, "task", cause, reason, f"{before.action} -> {action}", before.action, action)

    def _enter(
        self, at_s: float, kind: str, cause: _News, reason: str, change: str, before: str = "", action: str = ""
    ) -> Adaptation:
        made = Adaptation(at_s, kind, cause.text, reason, change, None, cause.time, before, action, cause.events)
        self.adaptations.append(made)
        self._open.append(made)
        return made

    def _close(self, over: Sequence[Adaptation]) -> None:
        for one in over:
            self._open.remove(one)
            self._report(one.close())

    def _settle_task_plans(self, *, is_reported: bool) -> None:
        """Report a task plan with steps that are new, unless the action that it begins with was reported."""
        for plan in self._plans()[self._plans_settled :]:
            self._plans_settled += 1
            if not plan.outcome.is_solved:
                continue
            added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
            if added and self._steps and not is_reported:
                change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
                cause = self._cause_of_plan(plan)
                self._close([self._enter(self._this_tick, "task", cause, cause.reason, change)])
            self._steps = frozenset(plan.steps)

    def _put_down_plans(self) -> None:
        """Put plans down to the news that caused them, or else to the change of action that they belong to."""
        waiting = []
        for plan in self._made:
            change = next((one for one in self._open if one.action), None)
            cause = next((one for one in self._to_answer if plan.cause in one.events), None)
            if cause is not None:
                self._to_answer.remove(cause)
            if cause is not None and (change is None or not set(cause.events) <= set(change.events)):
                kind = "structural" if plan.activate or plan.deactivate else "parameter"
                change = self._enter(plan.start, kind, cause, plan.reason, "")
            if change is not None:
                change.plans.append((self._in_words(plan), plan))
                change.close()
            elif self._before is not None and plan.cause == self._before.event:
                waiting.append(plan)  # for the action that comes next
        self._made = waiting

    def _step_in_words(self, step: "Step") -> str:
        return f"{step.schema}({', '.join(one for one in step.arguments if one not in self._kb.actions)})"

    def _in_words(self, plan: ReconfigurationPlan) -> str:
        """Say what a plan switches and sets; plain components are only booked, so they are left out."""
        steps = []
        for verb, names in (("stop", plan.deactivate), ("start", plan.activate)):
            switched = [name for name in names if self._kb.components[name].kind is not ComponentKind.PLAIN]
            steps += [f"{verb} {', '.join(switched)}"] if switched else []
        for name in plan.parameters:
            configuration = self._kb.configurations[name]
            values = ", ".join(f"{key} = {value}" for key, value in configuration.parameters.items())
            steps.append(f"set {configuration.component} to {name} ({values})")
        return "; ".join(steps) or str(plan)


def is_news(kb: KnowledgeBase, event: Event) -> bool:
    """Tell whether an event is news from the robot, and not what a plan that is being executed has brought about."""
    is_switched = event.verb == "component_active" and not event.arguments[2]  # of one that ends by itself why is told
    return event.kind is EventKind.MONITORING_DATA and not (is_switched and kb.history.open_plans)


def _together(news: Sequence[_News]) -> _News | None:
    if not news:
        return None
    events = tuple(dict.fromkeys(number for one in news for number in one.events))
    return _News(news[0].time, " and ".join(dict.fromkeys(one.text for one in news)), events)
