"""Tells adaptations from the ordinary course of a mission."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from kb import ComponentKind, Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

__all__ = ["Adaptation", "AdaptationLog", "TaskChange"]

REMEMBERED: Final = 256
"""How much news is remembered until the plan that it led to is there."""


@dataclass(frozen=True, slots=True)
class News:
    """Something that was told.

    Attributes:
        time: when it was so [s].
        text: what, in words.
        reason: why it calls for another action, in words; empty if it does not by itself.
    """

    time: float
    text: str
    reason: str = ""


class Headlines:
    """What was news, from one tick of the task layer to the next, and what it did to the actions.

    Attributes:
        lost: why an action is unfeasible, by name.
        regained: what made an action feasible again, by name.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.lost: dict[str, News] = {}
        self.regained: dict[str, News] = {}
        self._kb = kb
        self._since_tick: list[tuple[News, bool]] = []
        self._turns: deque[tuple[float, News]] = deque(maxlen=REMEMBERED)
        self._before_tick: list[News] = []
        self._own: list[tuple[str, News | None]] = []

    def hear(self, event: Event, stamp: float | None) -> None:
        """Take in what was measured; without a stamp it is the task layer's own word, and counts from its next tick."""
        for change in event.changes:
            if change.kind != "action" or Status.UNFEASIBLE not in (change.old, change.new):
                continue
            time = event.time if stamp is None else stamp
            is_lost = change.new is Status.UNFEASIBLE
            why = self._kb.why(self._kb.actions[change.name]) if is_lost else f"{change.name} is feasible again"
            news = News(time, event.text, why)
            if stamp is None:
                self._own.append((change.name, news if is_lost else None))
            elif is_lost:
                self.lost[change.name] = news
            else:
                self.lost.pop(change.name, None)
                self.regained[change.name] = news
        if stamp is not None:
            self.note(News(stamp, event.text), is_turn=bool(event.changes))

    def note(self, news: News, *, is_turn: bool) -> None:
        """Take in news; a turn has made a difference, other news is of no more than a number."""
        self._since_tick.append((news, is_turn))

    def ticking(self, time: float) -> None:
        """Close what a tick can have been led to by."""
        for name, lost in self._own:
            if lost is None:
                self.lost.pop(name, None)
            else:
                self.lost[name] = lost
        self._own.clear()
        heard, self._since_tick = self._since_tick, []
        turns = [news for news, is_turn in heard if is_turn]
        self._before_tick = turns or [news for news, _ in heard]
        self._turns.extend((time, news) for news in turns)

    def of_tick(self) -> News | None:
        """Return what was news before this tick: what made a difference, or else what was measured; None for none."""
        return _together(self._before_tick)

    def of_plan(self, plan: "PlanRecord") -> News:
        """Return what was news when a plan was asked for, or else why it was."""
        until = max((tick for tick, _ in self._turns if tick <= plan.at_s), default=None)
        led = _together([news for tick, news in self._turns if tick == until])
        return News(plan.at_s, plan.reason, plan.reason) if led is None else News(led.time, led.text, plan.reason)


def _together(news: Sequence[News]) -> News | None:
    return News(news[0].time, " and ".join(dict.fromkeys(one.text for one in news))) if news else None


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
        before, action: of a task adaptation, the action that was given up or has ended, and the one in its place.
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

    @property
    def in_force_s(self) -> float:
        """When it was in force [s]; infinity if it never was."""
        return inf if self.reaction_s is None else self.news_s + self.reaction_s

    @property
    def why(self) -> str:
        """The reason, and the news where the reason does not speak of it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"


class TaskChange:
    """A change of action, until the robot is configured for the new one.

    Attributes:
        adaptation: what is told of it.
    """

    def __init__(self, cause: News, before: str, action: str, time: float) -> None:
        self._action, self._begun = action, time
        self._change = f"{before} -> {action}"
        self._plans: list[tuple[str, ReconfigurationPlan]] = []
        reason = cause.reason or f"{action} is chosen, though {before} is still feasible"
        self.adaptation = Adaptation(time, "task", cause.text, reason, self._change, None, cause.time, before, action)

    def add(self, words: str, plan: ReconfigurationPlan) -> None:
        """Take in a plan that belongs to it."""
        self._plans.append((words, plan))
        self._write()

    def is_over(self, kb: KnowledgeBase, last_tick: float) -> bool:
        """Whether the robot is configured for the action, or nobody does anything about it any more."""
        if all(one.action != self._action for one in kb.required_actions):
            return True
        latest = kb.latest_plan
        acted = self._begun if latest is None or latest.end is None else max(self._begun, latest.end)
        return kb.actions[self._action].status is Status.SOLVED or last_tick >= acted

    def close(self) -> None:
        """Note when it was in force, if it was."""
        last = self._plans[-1][1] if self._plans else None
        if last is None:
            self.adaptation.reaction_s = self._begun - self.adaptation.news_s
        elif last.result == "completed" and last.end is not None:
            self.adaptation.reaction_s = max(self._begun, last.end) - self.adaptation.news_s
        self._write()

    def _write(self) -> None:
        told = [
            words + ("" if plan.result in (None, "completed") else f" ({plan.result})") for words, plan in self._plans
        ]
        self.adaptation.change = "; ".join([self._change, *told])


class _Ended(NamedTuple):
    """An action that has ended; cause: why it was given up, None if it was not, or not because of any news."""

    action: str
    at_s: float
    cause: News | None


class AdaptationLog:
    """Listens to a knowledge base and tells adaptations from the ordinary course of a mission.

    A new plan of reconfiguration is an adaptation if news from the robot led to it. A new action is one if the action
    before it

    - was given up, or failed, because it had become unfeasible, or failed at all, or was given up after other news,
    - or was taken up when it was feasible again, after it had been given up itself.

    The plans that configure the robot for it belong to it. If none follows by the end of the run, that is told, too. A
    task plan that was made anew, and has steps that the one before had not, is one too, unless the action that is begun
    for it tells as much.

    Not an adaptation: the first action, the next one after one that is completed, the same one again, and whatever no
    news has led to.

    Args:
        kb: the knowledge base to listen to.
        tell: called with each adaptation once it is in force or has failed.
        plans: returns the task plans made so far.

    Attributes:
        adaptations: all so far, in the order in which they were decided.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        tell: Callable[[Adaptation], None] = lambda adaptation: None,
        plans: Callable[[], Sequence["PlanRecord"]] = tuple,
    ) -> None:
        self.adaptations: list[Adaptation] = []
        self._kb, self._tell, self._plans = kb, tell, plans
        self._headlines = Headlines(kb)
        self._news: list[News] = []
        self._stamp: float | None = None
        self._last_tick = self._this_tick = float("-inf")
        self._plans_before = self._plans_settled = 0
        self._steps: frozenset[Step] = frozenset()
        self._given_up: dict[str, None] = {}
        self._began: dict[str, float] = {}
        self._ended: list[_Ended] = []
        self._before: _Ended | None = None
        self._task: TaskChange | None = None
        self._switching = False
        self._made: list[ReconfigurationPlan] = []
        self._prelude: list[ReconfigurationPlan] = []
        self._under_way: list[tuple[Adaptation, ReconfigurationPlan]] = []
        kb.subscribe(self._hear)

    def news(self, stamp: float | None) -> None:
        """Say that what the knowledge base hears next is news of that time [s]; None: it is our own doing."""
        self._stamp = stamp

    def sensed(self, text: str) -> None:
        """Say that the task layer was told of something that is not as before, while there is news."""
        if self._stamp is not None:
            self._headlines.note(News(self._stamp, text), is_turn=True)

    def ticking(self, time: float) -> None:
        """Say that the task layer is about to be ticked [s]."""
        self._last_tick, self._this_tick = self._this_tick, time
        self._plans_before = len(self._plans())
        self._headlines.ticking(time)

    def settle(self) -> None:
        """Put together what was decided, and complete what has ended; called after each turn of the manager."""
        self._settle_task_plans(is_told=self._settle_actions())
        made, self._made = self._made, []
        for plan in made:
            self._put_down(plan)
        if self._kb.pending_plan is None:  # the manager has answered all news, with a plan or without
            self._news.clear()
            if self._task is not None and self._task.is_over(self._kb, self._last_tick):
                self._end_task()
            if self._kb.required_actions:  # a change of action that needed no plan is over
                self._switching = False
        self._settle_plans()

    def finish(self) -> None:
        """Tell of an action that was given up and that none has followed; called when a run ends short of its goal."""
        last, self._before = self._before, None
        if last is None or last.cause is None or self._kb.required_actions:
            return
        change = TaskChange(last.cause, last.action, "nothing", last.at_s)
        for made in self._prelude:
            change.add(self._in_words(made), made)
        change.close()
        self.adaptations.append(change.adaptation)
        self.adaptations.sort(key=lambda one: one.at_s)
        self._tell(change.adaptation)

    # ---------------------------------------------------------------- what is heard

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.MONITORING_DATA:
            self._headlines.hear(event, self._stamp)
            if self._stamp is not None and event.changes:
                self._news.append(News(self._stamp, event.text))
        elif event.kind is EventKind.ACTION_UPDATE:
            self._hear_action(event)
        elif event.plan is not None:
            self._made.append(event.plan)

    def _hear_action(self, event: Event) -> None:
        """Note what begins and ends; a tree may begin the one before it ends the other."""
        action = event.subject
        record = next(one for one in reversed(self._kb.action_history) if one.action == action)
        self._switching = True
        if record.end is None:
            self._began[action] = event.time
            return
        if action not in self._began:  # else it ended in the tick in which it began
            self._ended.append(_Ended(action, record.end, self._why_given_up(action, record.result, record.reason)))
        self._began.pop(action, None)
        if record.result != "completed":
            self._given_up[action] = None
            self._headlines.regained.pop(action, None)

    def _why_given_up(self, action: str, result: str | None, reason: str) -> News | None:
        if result == "completed":
            return None
        if action in self._headlines.lost:
            return self._headlines.lost[action]
        if result == "failed":
            return News(self._kb.now, f"{action} has failed", reason or f"{action} told no reason")
        plan = self._new_plan()
        return self._headlines.of_tick() if plan is None else self._headlines.of_plan(plan)

    def _new_plan(self) -> "PlanRecord | None":
        """Return the task plan that was found in this tick, if one was."""
        plans = self._plans()
        return plans[-1] if len(plans) > self._plans_before and plans[-1].outcome.is_solved else None

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
        cause = None
        if before is not None:
            cause = before.cause if before.action != action else None
            regained = self._headlines.regained.get(action)
            if cause is None and action in self._given_up and regained is not None:
                waited = regained.time < self._last_tick  # for something else to end
                cause = self._why_now(time, before.action, regained) if waited else regained
            elif cause is not None and regained is not None and regained.time > cause.time:
                cause = regained  # there was nothing else to be done before
        for one in began:
            self._given_up.pop(one, None)
        prelude, self._prelude = self._prelude, []
        if cause is None or before is None:
            return False
        self._end_task()
        plan = self._new_plan()
        if plan is not None and not cause.reason:
            cause = replace(cause, reason=plan.reason)
        self._task = TaskChange(cause, before.action, action, time)
        for made in prelude:
            self._task.add(self._in_words(made), made)
        self.adaptations.append(self._task.adaptation)
        return True

    def _why_now(self, time: float, before: str, regained: News) -> News:
        """Say why an action that has been feasible again for a while is taken up only now."""
        plan = self._new_plan()
        if plan is not None and not self._steps.issuperset(plan.steps):
            return self._headlines.of_plan(plan)
        return News(time, f"{before} is over", f"{regained.reason} (since {regained.time:.1f} s: {regained.text})")

    def _end_task(self) -> None:
        if self._task is not None:
            self._task.close()
            self._tell(self._task.adaptation)
            self._task = None

    def _settle_task_plans(self, *, is_told: bool) -> None:
        """Tell of a task plan with steps that are new, unless the action that it begins with tells of it."""
        for plan in self._plans()[self._plans_settled :]:
            self._plans_settled += 1
            if not plan.outcome.is_solved:
                continue
            added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
            if added and self._steps and not is_told:
                cause = self._headlines.of_plan(plan)
                change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
                reaction_s = self._this_tick - cause.time
                told = Adaptation(self._this_tick, "task", cause.text, cause.reason, change, reaction_s, cause.time)
                self.adaptations.append(told)
                self._tell(told)
            self._steps = frozenset(plan.steps)

    def _put_down(self, plan: ReconfigurationPlan) -> None:
        """Put a plan down to the change of action that it belongs to, or else to the news that led to it."""
        news, self._news = self._news, []
        if self._task is not None:
            self._task.add(self._in_words(plan), plan)
            self._switching = False
        elif self._switching:
            self._switching = not self._kb.required_actions  # given up, and nothing new yet: more is to come
            if self._switching:
                self._prelude.append(plan)
        elif news:
            kind = "structural" if plan.activate or plan.deactivate else "parameter"
            texts = " and ".join(dict.fromkeys(one.text for one in news))
            adaptation = Adaptation(plan.start, kind, texts, plan.reason, self._in_words(plan), None, news[0].time)
            self.adaptations.append(adaptation)
            self._under_way.append((adaptation, plan))

    def _settle_plans(self) -> None:
        waiting = []
        for adaptation, plan in self._under_way:
            if plan.end is None:
                waiting.append((adaptation, plan))
                continue
            if plan.result == "completed":
                adaptation.reaction_s = plan.end - adaptation.news_s
            else:
                adaptation.change += f" ({plan.result})"
            self._tell(adaptation)
        self._under_way = waiting

    def _step_in_words(self, step: "Step") -> str:
        return f"{step.schema}({', '.join(one for one in step.arguments if one not in self._kb.actions)})"

    def _in_words(self, plan: ReconfigurationPlan) -> str:
        """Say what a plan switches and sets; plain components are only booked, so they are left out."""

        def switched(names: tuple[str, ...]) -> str:
            return ", ".join(name for name in names if self._kb.components[name].kind is not ComponentKind.PLAIN)

        steps = [
            f"{verb} {names}"
            for verb, names in (("stop", switched(plan.deactivate)), ("start", switched(plan.activate)))
            if names
        ]
        for name in plan.parameters:
            configuration = self._kb.configurations[name]
            values = ", ".join(f"{key} = {value}" for key, value in configuration.parameters.items())
            steps.append(f"set {configuration.component} to {name} ({values})")
        return "; ".join(steps) or str(plan)
