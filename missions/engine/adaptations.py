"""The table of adaptations: which events of a run were adaptations, by their causes, and which the ordinary course."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from kb import ComponentKind, Event, EventKind, KnowledgeBase, ReconfigurationPlan, Status

if TYPE_CHECKING:
    from rosa_pddl import PlanRecord, Step

_REMEMBERED: Final = (
    256  # how many ticks with news, and how much news, are kept until the plan for them is there
)


def plans_after(last: "PlanRecord | None", plans: Sequence["PlanRecord"]) -> Sequence["PlanRecord"]:
    """Return the task plans after one of them; all if it is not among them, as the oldest may be forgotten."""
    number = len(plans)
    while number and plans[number - 1] is not last:
        number -= 1
    return plans[number:]


@dataclass(frozen=True, slots=True)
class _News:
    """News: its time [s], its text, its events, and the reason if it alone calls for another action."""

    time: float
    text: str
    events: tuple[int, ...] = ()
    reason: str = ""


class _Ended(NamedTuple):
    """An action that has ended, with the event; cause: the news for which it was given up, None if there was none."""

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
        trigger: the news that caused it.
        reason: why the news called for a change.
        change: what was changed.
        reaction_s: time from the news until the change was in force [s]; None if it never was.
        news_s: the time of the news [s].
        before, action: of a task adaptation, the action that was given up or has ended, and the one that follows it.
        events: the numbers of the events of the news; empty if only the task layer perceived it.
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

    def is_over(self, kb: KnowledgeBase, last_tick: float) -> bool:
        """Whether the robot is configured for it, or nothing more will be done about it."""
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
        """Update `change` by how the plans have ended so far, and `reaction_s` by the last plan; return itself."""
        if not self.plans:
            self.reaction_s = self.at_s - self.news_s
        elif (last := self.plans[-1][1]).result == "completed" and last.end is not None:
            self.reaction_s = max(self.at_s, last.end) - self.news_s
        parts = [f"{self.before} -> {self.action}"] if self.action else []
        for words, plan in self.plans:
            parts.append(
                words if plan.result in (None, "completed") else f"{words} ({plan.result})"
            )
        self.change = "; ".join(parts) or self.change
        return self


class AdaptationLog:
    """Computes the table of adaptations from the log of a knowledge base, by the causes in its records.

    A reconfiguration plan is an adaptation if news from the robot caused it. A new action is a task adaptation if

    - the action before it became unfeasible, failed, or was given up after other news,
    - or it had been given up itself, and is begun again because it is feasible again.

    The reconfiguration plans for the new action belong to that adaptation. An action that was given up and that no
    other follows until the end of the run is one, too. So is a new task plan with steps that the one before did not
    have, unless the action that begins with it was reported already.

    Not an adaptation: the first action, the next one after a completed action, the next step of a plan, the same
    action again, and anything that no news caused.

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
        # news: since the last tick, and whether it changed a status; what the tick reacted to; what earlier ones did
        self._heard: list[tuple[_News, bool]] = []
        self._led: list[_News] = []
        self._turns: deque[tuple[float, list[_News]]] = deque(maxlen=_REMEMBERED)
        self._last_tick = self._this_tick = -inf
        # by action: the news that made it unfeasible, or feasible again; then news to which no plan has reacted yet
        self._lost: dict[str, _News] = {}
        self._regained: dict[str, _News] = {}
        self._to_answer: deque[_News] = deque(maxlen=_REMEMBERED)
        # decisions: the action that ended last, until another begins; plans whose cause is not assigned yet
        self._before: _Ended | None = None
        self._made: list[ReconfigurationPlan] = []
        self._open: list[Adaptation] = []
        self._settled = kb.log.last
        self._plan_settled: PlanRecord | None = None
        self._steps: frozenset[Step] = frozenset()
        kb.log.witnesses += (
            self._hear,
        )  # before any subscriber, in order, on the thread that told

    def news(self, stamp: float | None) -> None:
        """Declare that the next events are news of this time [s]; None: they are our own doing.

        Infinity: every event from the robot is news of its own time, for callers that cannot say which are.
        """
        self._stamp = stamp

    def sensed(self, text: str) -> None:
        """Note a change that only the task layer perceives; ignored unless `news` has declared a time."""
        if self._stamp is not None:
            self._heard.append((_News(self._stamp, text), True))

    def ticking(self, time: float) -> None:
        """Note that a tick begins at this time [s]; it can react to all news until now."""
        with self._kb.reading():  # facts may be told by other threads than the one that ticks
            self._last_tick, self._this_tick = self._this_tick, time
            heard, self._heard = self._heard, []
            turns = [news for news, is_turn in heard if is_turn]
            self._led = turns or [news for news, _ in heard]
            if turns:
                self._turns.append((time, turns))

    def settle(self) -> None:
        """Assign decisions to causes, and report adaptations that are over; called after each turn of the manager."""
        with self._kb.reading():
            self._settle_task_plans(is_reported=self._settle_actions())
            self._put_down_plans()
            self._settled = self._kb.log.last
            over = [one for one in self._open if one.is_over(self._kb, self._last_tick)]
            self._close(sorted(over, key=lambda one: not one.action))

    def finish(self) -> None:
        """Report an action that was given up and that no other followed; called when a run ends without its goal."""
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
                self._lost[change.name] = replace(
                    news, reason=self._kb.why(self._kb.actions[change.name])
                )
            elif change.kind == "action" and change.old is Status.UNFEASIBLE:
                self._lost.pop(change.name, None)
                self._regained[change.name] = replace(
                    news, reason=f"{change.name} is feasible again"
                )
        self._heard.append((news, bool(event.changes)))
        if event.changes:
            self._to_answer.append(news)

    def _hear_end(self, event: Event, action: str, result: str, reason: str) -> None:
        """Note which action has ended and why; a tree may begin the next action before it ends this one."""
        record = next(one for one in reversed(self._kb.history.actions) if one.action == action)
        if record.number <= self._settled:  # else it ended in the tick in which it began
            cause = (
                None if result == "completed" else self._why_given_up(event, action, result, reason)
            )
            self._before = _Ended(action, event.time, event.number, cause)
        if result != "completed":
            self._regained.pop(action, None)

    def _why_given_up(self, event: Event, action: str, result: str, reason: str) -> _News | None:
        if action in self._lost:
            return self._lost[action]
        if result == "failed":
            return _News(
                event.time,
                f"{action} has failed",
                (event.number,),
                reason or f"{action} gave no reason",
            )
        if event.cause is not None:  # an assertion by the task layer itself
            own = next(self._kb.log.since(event.cause - 1), event)
            return _News(own.time, own.text, (own.number,), self._kb.why(self._kb.actions[action]))
        plan = self._new_plan()
        return _together(self._led) if plan is None else self._cause_of_plan(plan)

    def _new_plan(self) -> "PlanRecord | None":
        """Return the task plan that was found in this tick; None if there is none."""
        plans = plans_after(self._plan_settled, self._plans())
        return plans[-1] if plans and plans[-1].outcome.is_solved else None

    def _cause_of_plan(self, plan: "PlanRecord") -> _News:
        """Return the news when a plan was asked for, or else the reason of the plan."""
        led = next((led for tick, led in reversed(self._turns) if tick <= plan.at_s), [])
        return replace(_together(led) or _News(plan.at_s, plan.reason), reason=plan.reason)

    # ---------------------------------------------------------------- what comes of it

    def _settle_actions(self) -> bool:
        """Enter a task adaptation if the action that was begun replaces another due to news; return whether it does."""
        began = [one for one in self._kb.required_actions if one.number > self._settled]
        if not began:
            return False
        before, self._before = self._before, None
        cause = (
            None if before is None else self._why_begun(before, began[-1].action, began[-1].start)
        )
        if before is None or cause is None:
            return False
        plan = self._new_plan()
        if plan is not None and not cause.reason:
            cause = replace(cause, reason=plan.reason)
        self._close([one for one in self._open if one.action])
        self._change(before, began[-1].action, began[-1].start, cause)
        return True

    def _why_begun(self, before: _Ended, action: str, time: float) -> _News | None:
        """Return the news for which an action replaces another; None for the ordinary course."""
        cause = before.cause if before.action != action else None
        regained = self._regained.get(action)
        if regained is None or (cause is None and not self._was_given_up(action)):
            return cause
        if cause is not None:
            return (
                regained if regained.time > cause.time else cause
            )  # nothing was feasible in between
        plan = self._new_plan()
        if plan is None and self._plans():
            return None  # it is the next step of the plan
        if regained.time >= self._last_tick:
            return regained
        # it was feasible for a while, but had to wait until something else ended
        if plan is not None and not self._steps.issuperset(plan.steps):
            return self._cause_of_plan(plan)
        since = f"{regained.reason} (since {regained.time:.1f} s: {regained.text})"
        return _News(time, f"{before.action} is over", regained.events, since)

    def _was_given_up(self, action: str) -> bool:
        ended = (
            one
            for one in reversed(self._kb.history.actions)
            if one.action == action and one.end is not None
        )
        return next((one.result != "completed" for one in ended), False)

    def _change(self, before: _Ended, action: str, time: float, cause: _News) -> None:
        reason = cause.reason or f"{action} is chosen, though {before.action} is still feasible"
        self._enter(
            time, "task", cause, reason, f"{before.action} -> {action}", before.action, action
        )

    def _enter(
        self,
        at_s: float,
        kind: str,
        cause: _News,
        reason: str,
        change: str,
        before: str = "",
        action: str = "",
    ) -> Adaptation:
        made = Adaptation(
            at_s, kind, cause.text, reason, change, None, cause.time, before, action, cause.events
        )
        self.adaptations.append(made)
        self._open.append(made)
        return made

    def _close(self, over: Sequence[Adaptation]) -> None:
        for one in over:
            self._open.remove(one)
            self._report(one.close())

    def _settle_task_plans(self, *, is_reported: bool) -> None:
        """Report a task plan with new steps, unless the action that it begins with was reported."""
        for plan in plans_after(self._plan_settled, self._plans()):
            self._plan_settled = plan
            if not plan.outcome.is_solved:
                continue
            added = [self._step_in_words(step) for step in plan.steps if step not in self._steps]
            if added and self._steps and not is_reported:
                change = f"plan anew, with {', '.join(dict.fromkeys(added))}"
                cause = self._cause_of_plan(plan)
                self._close([self._enter(self._this_tick, "task", cause, cause.reason, change)])
            self._steps = frozenset(plan.steps)

    def _put_down_plans(self) -> None:
        """Assign reconfiguration plans to the news that caused them, or to the change of action that they serve."""
        waiting = []
        for plan in self._made:
            change = next((one for one in self._open if one.action), None)
            cause = next((one for one in self._to_answer if plan.cause in one.events), None)
            if cause is not None:
                self._to_answer.remove(cause)
            if cause is not None and (
                change is None or not set(cause.events) <= set(change.events)
            ):
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
        """Return what a plan switches and sets, in words, without plain components, which nobody commands."""
        steps = []
        for verb, names in (("stop", plan.deactivate), ("start", plan.activate)):
            switched = [
                name for name in names if self._kb.components[name].kind is not ComponentKind.PLAIN
            ]
            steps += [f"{verb} {', '.join(switched)}"] if switched else []
        for name in plan.parameters:
            configuration = self._kb.configurations[name]
            values = ", ".join(
                f"{key} = {value}" for key, value in configuration.parameters.items()
            )
            steps.append(f"set {configuration.component} to {name} ({values})")
        return "; ".join(steps) or str(plan)


def is_news(kb: KnowledgeBase, event: Event) -> bool:
    """Return whether an event is news from the robot, and not the effect of a plan that is being executed."""
    # a component that stops by itself comes with a reason
    is_switched = event.verb == "component_active" and not event.arguments[2]
    return event.kind is EventKind.MONITORING_DATA and not (is_switched and kb.history.open_plans)


def _together(news: Sequence[_News]) -> _News | None:
    if not news:
        return None
    events = tuple(dict.fromkeys(number for one in news for number in one.events))
    return _News(news[0].time, " and ".join(dict.fromkeys(one.text for one in news)), events)
