"""Which adaptations there were: what set each off, what was changed, why, and how long that took."""

from collections.abc import Callable
from dataclasses import dataclass, field

from kb import ComponentKind, Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

__all__ = ["Adaptation", "AdaptationLog"]


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
    """

    at_s: float
    kind: str
    trigger: str
    reason: str
    change: str
    reaction_s: float | None = None
    news_s: float = field(default=0.0, repr=False)

    @property
    def why(self) -> str:
        """The reason, and the news where the reason does not speak of it."""
        subject = self.trigger.split(" ")[0]
        return self.reason if subject in self.reason else f"{self.trigger}: {self.reason}"


@dataclass(frozen=True, slots=True)
class _News:
    time: float
    text: str
    reason: str = ""


class AdaptationLog:
    """Listens to a knowledge base and tells adaptations from the ordinary course of a mission.

    A new plan is an adaptation if news from the robot led to it. A new action is one if the action before it was given
    up because it had become unfeasible, or if it had been given up itself before; the plan that follows belongs to it.

    Args:
        kb: the knowledge base to listen to.
        tell: called with each adaptation once it is in force or has failed.

    Attributes:
        adaptations: all so far, in the order in which they were decided.
    """

    def __init__(self, kb: KnowledgeBase, tell: Callable[[Adaptation], None] = lambda adaptation: None) -> None:
        self.adaptations: list[Adaptation] = []
        self._kb = kb
        self._tell = tell
        self._news: list[_News] = []
        self._stamp: float | None = None
        self._last_tick = self._this_tick = float("-inf")
        self._lost: dict[str, _News] = {}
        self._regained: dict[str, _News] = {}
        self._given_up: dict[str, None] = {}
        self._before: str | None = None
        self._task: Adaptation | None = None
        self._switching = False
        self._prelude: list[str] = []
        self._under_way: list[tuple[Adaptation, ReconfigurationPlan]] = []
        kb.subscribe(self._hear)

    def news(self, stamp: float | None) -> None:
        """Say that what the knowledge base hears next is news of that time [s]; None: it is our own doing."""
        self._stamp = stamp

    def ticking(self, time: float) -> None:
        """Say that the task layer is about to be ticked [s]."""
        self._last_tick, self._this_tick = self._this_tick, time

    def settle(self) -> None:
        """Complete the adaptations whose plans have ended; called after each turn of the manager."""
        if self._kb.pending_plan is None:  # the manager has answered all news, with a plan or without
            self._news.clear()
            if self._task is not None:
                self._task.reaction_s = self._task.at_s - self._task.news_s
                self._tell(self._task)
                self._task = None
            if self._kb.required_actions:  # a change of action that needed no plan is over
                self._switching = False
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

    def _hear(self, event: Event) -> None:
        if event.kind is EventKind.MONITORING_DATA:
            self._hear_news(event)
        elif event.kind is EventKind.ACTION_UPDATE:
            self._hear_action(event)
        elif event.plan is not None:
            self._hear_plan(event, event.plan)

    def _hear_news(self, event: Event) -> None:
        if self._stamp is None or not event.changes:
            return
        news = _News(self._stamp, event.text)
        self._news.append(news)
        for change in event.changes:
            if change.kind != "action":
                continue
            if change.new is Status.UNFEASIBLE:
                why = self._kb.why(self._kb.actions[change.name])
                self._lost[change.name] = _News(self._stamp, event.text, why)
            elif change.old is Status.UNFEASIBLE:
                self._regained[change.name] = _News(self._stamp, event.text, f"{change.name} is feasible again")
                self._lost.pop(change.name, None)

    def _hear_action(self, event: Event) -> None:
        action = event.subject
        record = next(one for one in reversed(self._kb.action_history) if one.action == action)
        self._switching = True
        if record.end is not None:
            self._before = action
            if record.result == "abandoned":
                self._given_up[action] = None
            return
        before, self._before = self._before, None
        cause = None
        if before in self._given_up and before in self._lost:
            cause = self._lost[before]
        elif action in self._given_up:
            cause = self._regained.get(action)
            if cause is not None and cause.time < self._last_tick:  # it waited for something else to end
                cause = _News(event.time, f"{before} is over", cause.reason)
        self._given_up.pop(action, None)
        if cause is not None:
            self._task = Adaptation(
                event.time, "task", cause.text, cause.reason, f"{before} -> {action}", None, cause.time
            )
            self.adaptations.append(self._task)

    def _hear_plan(self, event: Event, plan: ReconfigurationPlan) -> None:
        news, self._news = self._news, []
        if self._task is not None:
            self._task.change = "; ".join([self._task.change, *self._prelude, self._in_words(plan)])
            self._prelude.clear()
            self._under_way.append((self._task, plan))
            self._task, self._switching = None, False
        elif self._switching:
            self._switching = not self._kb.required_actions  # given up, and nothing new yet: more is to come
            if self._switching:
                self._prelude.append(self._in_words(plan))
            else:
                self._prelude.clear()
        elif news:
            kind = "structural" if plan.activate or plan.deactivate else "parameter"
            texts = " and ".join(dict.fromkeys(one.text for one in news))
            adaptation = Adaptation(event.time, kind, texts, plan.reason, self._in_words(plan), None, news[0].time)
            self.adaptations.append(adaptation)
            self._under_way.append((adaptation, plan))

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
