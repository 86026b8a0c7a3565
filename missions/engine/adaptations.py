"""The table of adaptations: what of a run's events was an adaptation, by its cause, and what the ordinary course."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from kb import ComponentKind, Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

_REMEMBERED: Final = 256  # news, until the plan that it led to is there


@dataclass(frozen=True, slots=True)
class _News:
    """What became known, when it was so [s], why it calls for another action by itself, and in which events it came."""

    time: float
    text: str
    reason: str = ""
    events: tuple[int, ...] = ()


class _Ended(NamedTuple):
    """An action that has ended; cause: why it was given up, None if it was not, or not because of any news."""

    action: str
    at_s: float
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
        if all(one.action != self.action for one in kb.required_actions):
            return True
        latest = kb.latest_plan
        acted = self.at_s if latest is None or latest.end is None else max(self.at_s, latest.end)
        return kb.actions[self.action].status is Status.SOLVED or last_tick >= acted

    def add(self, words: str, plan: ReconfigurationPlan) -> None:
        self.plans.append((words, plan))
        self.close()

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
    """Listens to a knowledge base and separates adaptations from the ordinary course of a mission.

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
        # what was news: since the last tick, with whether it made a difference; before it; and what did, by its tick
        self._heard: list[tuple[_News, bool]] = []
        self._before_tick: list[_News] = []
        self._turns: deque[tuple[float, _News]] = deque(maxlen=_REMEMBERED)
        self._last_tick = self._this_tick = float("-inf")
        # what it made of actions: why each is unfeasible, by its name or by the event; what made it feasible again
        self._lost: dict[str | int, _News] = {}
        self._regained: dict[str, _News] = {}
        # what the task layer decided
        self._plans_before = self._plans_seen = 0
        self._steps: frozenset[Step] = frozenset()
        self._given_up: set[str] = set()
        self._began: dict[str, float] = {}
        self._ended: list[_Ended] = []
        self._before: _Ended | None = None
        # what the manager decided
        self._to_answer: list[_News] = []
        self._made: list[ReconfigurationPlan] = []
        self._prelude: list[ReconfigurationPlan] = []
        self._is_switching = False
        self._task: Adaptation | None = None
        self._under_way: list[Adaptation] = []
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
            self._plans_before = len(self._plans())
            heard, self._heard = self._heard, []
            turns = [news for news, is_turn in heard if is_turn]
            self._before_tick = turns or [news for news, _ in heard]
            self._turns.extend((time, news) for news in turns)

    def passed_over(self, time: float) -> None:
        """Say that a tick was left out [s], in which there was nothing to do; nothing if it was told already."""
        if time > self._this_tick:
            self.ticking(time)

    def settle(self) -> None:
        """Put together what was decided, and complete what has ended; called after each turn of the manager."""
        with self._kb.reading():
            self._settle_task_plans(is_reported=self._settle_actions())
            while self._made:
                self._put_down(self._made.pop(0))
            if self._kb.pending_plan is None:  # the manager has answered all news, with a plan or without
                self._to_answer.clear()
                if self._task is not None and self._task.is_over(self._kb, self._last_tick):
                    self._end_task()
                if self._kb.required_actions:  # a change of action that needed no plan is over
                    self._is_switching = False
            for one in [one for one in self._under_way if one.is_over(self._kb, self._last_tick)]:
                self._under_way.remove(one)
                self._report(one.close())

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing is under way that the next tick or turn of the manager may end."""
        decided = self._task or self._under_way or self._ended or self._began or self._made or self._to_answer
        return not decided and len(self._plans()) == self._plans_seen

    def finish(self) -> None:
        """Tell of an action that was given up and that none has followed; called when a run ends short of its goal."""
        last, self._before = self._before, None
        if last is None or last.cause is None or self._kb.required_actions:
            return
        given_up = self._change(last, "nothing", last.at_s, last.cause)
        self.adaptations.sort(key=lambda one: one.at_s)
        self._report(given_up.close())

    # ---------------------------------------------------------------- what is heard

    def _hear(self, event: Event) -> None:
        if event.plan is not None:
            self._made.append(event.plan)
        elif event.verb == "request_action":
            self._is_switching = True
            self._began[event.subject] = event.time
            self._lost.pop(event.subject, None)
        elif event.verb == "cancel_action":
            self._hear_end(event, *event.arguments)
        elif event.kind is EventKind.MONITORING_DATA and (self._stamp != inf or is_news(self._kb, event)):
            self._hear_news(event)

    def _hear_news(self, event: Event) -> None:
        """Take in what was measured; without a stamp it is the task layer's own word, which is no news to it."""
        time = event.time if self._stamp in (None, inf) else self._stamp
        news, is_from_robot = _News(time, event.text, "", (event.number,)), self._stamp is not None
        for change in event.changes:
            if change.kind == "action" and change.new is Status.UNFEASIBLE:
                why = self._kb.why(self._kb.actions[change.name])
                self._lost[change.name if is_from_robot else event.number] = replace(news, reason=why)
            elif change.kind == "action" and change.old is Status.UNFEASIBLE and is_from_robot:
                self._lost.pop(change.name, None)
                self._regained[change.name] = replace(news, reason=f"{change.name} is feasible again")
        if is_from_robot:
            self._heard.append((news, bool(event.changes)))
            self._to_answer += [news] if event.changes else []

    def _hear_end(self, event: Event, action: str, result: str, reason: str) -> None:
        """Note what has ended and why; a tree may begin the next one before it ends this one."""
        self._is_switching = True
        if self._began.pop(action, None) is None:  # else it ended in the tick in which it began
            cause = None if result == "completed" else self._why_given_up(event, action, result, reason)
            self._ended.append(_Ended(action, event.time, cause))
        if result != "completed":
            self._given_up.add(action)
            self._regained.pop(action, None)

    def _why_given_up(self, event: Event, action: str, result: str, reason: str) -> _News | None:
        if action in self._lost:
            return self._lost[action]
        if result == "failed":
            said = reason or f"{action} gave no reason"
            return _News(event.time, f"{action} has failed", said, (event.number,))
        if event.cause in self._lost:
            return self._lost[event.cause]
        plan = self._new_plan()
        return _together(self._before_tick) if plan is None else self._cause_of_plan(plan)

    def _new_plan(self) -> "PlanRecord | None":
        """Return the task plan that was found in this tick, if one was."""
        plans = self._plans()
        return plans[-1] if len(plans) > self._plans_before and plans[-1].outcome.is_solved else None

    def _cause_of_plan(self, plan: "PlanRecord") -> _News:
        """Return what was news when a plan was asked for, or else why it was."""
        until = max((tick for tick, _ in self._turns if tick <= plan.at_s), default=None)
        led = _together([news for tick, news in self._turns if tick == until])
        return replace(led or _News(plan.at_s, plan.reason), reason=plan.reason)

    # ---------------------------------------------------------------- what comes of it

    def _settle_actions(self) -> bool:
        """Return whether the action that was begun stands in for another because of news; note so if it does."""
        ended, self._ended = self._ended, []
        began, self._began = self._began, {}
        self._before = ended[-1] if ended else self._before
        if not began:
            return False
        before, self._before = self._before, None
        action, time = list(began.items())[-1]
        cause = None if before is None else self._why_begun(before, action, time)
        self._given_up.difference_update(began)
        if before is not None and cause is not None:
            self._end_task()
            plan = self._new_plan()
            if plan is not None and not cause.reason:
                cause = replace(cause, reason=plan.reason)
            self._task = self._change(before, action, time, cause)
        self._prelude.clear()
        return cause is not None

    def _why_begun(self, before: _Ended, action: str, time: float) -> _News | None:
        """Return what made an action take the place of another; None for the ordinary course."""
        cause = before.cause if before.action != action else None
        regained = self._regained.get(action)
        if regained is None or (cause is None and action not in self._given_up):
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
        return _News(time, f"{before.action} is over", since, regained.events)

    def _change(self, before: _Ended, action: str, time: float, cause: _News) -> Adaptation:
        """Enter a change of action, with the plans that were made for it already."""
        reason = cause.reason or f"{action} is chosen, though {before.action} is still feasible"
        change = self._enter(time, "task", cause, reason, f"{before.action} -> {action}")
        change.before, change.action = before.action, action
        for made in self._prelude:
            change.add(self._in_words(made), made)
        return change

    def _enter(self, at_s: float, kind: str, cause: _News, reason: str, change: str = "") -> Adaptation:
        made = Adaptation(at_s, kind, cause.text, reason, change, None, cause.time, events=cause.events)
        self.adaptations.append(made)
        return made

    def _end_task(self) -> None:
        if self._task is not None:
            self._report(self._task.close())
            self._task = None

    def _settle_task_plans(self, *, is_reported: bool) -> None:
        """Report a task plan with steps that are new, unless the action that it begins with was reported."""
        for plan in self._plans()[self._plans_seen :]:
            self._plans_seen += 1
            if not plan.outcome.is_solved:
                continue
            added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
            if added and self._steps and not is_reported:
                change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
                cause = self._cause_of_plan(plan)
                self._report(self._enter(self._this_tick, "task", cause, cause.reason, change).close())
            self._steps = frozenset(plan.steps)

    def _put_down(self, plan: ReconfigurationPlan) -> None:
        """Put a plan down to the change of action that it belongs to, or else to the news that led to it."""
        cause, self._to_answer = _together(self._to_answer), []
        if self._task is not None:
            self._task.add(self._in_words(plan), plan)
            self._is_switching = False
        elif self._is_switching:
            self._is_switching = not self._kb.required_actions  # given up, and nothing new yet: more is to come
            if self._is_switching:
                self._prelude.append(plan)
        elif cause is not None:
            kind = "structural" if plan.activate or plan.deactivate else "parameter"
            self._under_way.append(self._enter(plan.start, kind, cause, plan.reason))
            self._under_way[-1].add(self._in_words(plan), plan)

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
    return event.kind is EventKind.MONITORING_DATA and not (event.verb == "component_active" and kb.history.open_plans)


def _together(news: Sequence[_News]) -> _News | None:
    if not news:
        return None
    events = tuple(dict.fromkeys(number for one in news for number in one.events))
    return _News(news[0].time, " and ".join(dict.fromkeys(one.text for one in news)), "", events)
