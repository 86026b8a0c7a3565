"""How far a plan is executed, in which order its steps may start, and whether the rest still works."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from math import inf
from typing import NamedTuple

from kb.forecast import FeasibleUntil
from rosa_pddl.belief import Belief, ExpectedEffects
from rosa_pddl.domain import Domain, Feasibility, PlanningResult, State, Step, TimedStep
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.goals import Goals
from rosa_pddl.problem import Problem
from rosa_pddl.resource_usage import usage_of
from rosa_pddl.syntax import Goal
from rosa_pddl.validate import (
    StepEvent,
    affected_atoms,
    binding_of,
    goal_holds,
    mentioned_atoms,
    moments,
    one_after_the_other,
    replay,
)

# Costs are sums of floats; a difference below this counts as none.
_SAME_COST = 1e-9
# A new plan is made only if actions stay feasible this many times as long as the plan needs them.
_LONGER = 1.1

_Touched = tuple[frozenset[str], frozenset[str]]
_Forecasts = Callable[[], Mapping[str, FeasibleUntil]]
Clash = Callable[[Step, Step], bool]
"""Tells whether two steps must not run at the same time, whatever their conditions and effects are."""


def shared_components(kb: Feasibility) -> Clash:
    """Return a function that tells whether two steps may need the same component, in any design of their functions."""

    @cache
    def components(action: str | None) -> frozenset[str]:
        functions, designs = (getattr(kb, kind, {}) for kind in ("functions", "designs"))
        required = getattr(kb.actions[action], "functions", ()) if action is not None else ()
        chosen = (designs[design] for name in required for design in functions[name].designs)
        return frozenset(component for design in chosen for component in design.components)

    def clash(one: Step, other: Step) -> bool:
        is_same = one.action is not None and one.action == other.action
        return is_same or bool(components(one.action) & components(other.action))

    return clash


class Prediction(NamedTuple):
    """The predicted result of the rest of a plan, if nothing unexpected happens."""

    flaw: str | None
    facts: State


@dataclass(frozen=True)
class PlanExecution:
    """A plan, the order of its steps, and the events of it that have happened.

    A step may start when all events in `after`, at the step's index, have happened.
    """

    steps: tuple[Step, ...]
    moments: tuple[tuple[StepEvent, ...], ...]
    after: tuple[frozenset[StepEvent], ...]
    goals: tuple[Goal, ...]
    happened: frozenset[StepEvent] = frozenset()

    @classmethod
    def of(
        cls,
        domain: Domain,
        result: PlanningResult,
        goals: tuple[Goal, ...],
        clash: Clash | None = None,
    ) -> "PlanExecution":
        """Order a plan: a schedule by what its steps need from one another, other plans one step after the other.

        If `clash` is given, a step of an unscheduled plan waits only for the earlier steps with which it clashes or
        interferes, which means that one of the two changes what the other needs or changes. All orders that this
        allows have the same result.
        """
        if result.schedule:
            return _scheduled(domain, result.schedule, goals)
        steps = result.steps
        touched = [_touched(domain, step) for step in steps] if clash else []
        after = []
        for number, step in enumerate(steps):
            before = range(max(number - 1, 0), number) if clash is None else range(number)
            waits = [
                one
                for one in before
                if clash is None
                or clash(steps[one], step)
                or _interfere(touched[one], touched[number])
            ]
            after.append(frozenset(StepEvent(one, True) for one in waits))
        return cls(steps, one_after_the_other(len(steps)), tuple(after), goals)

    @property
    def events(self) -> tuple[StepEvent, ...]:
        """The starts and ends of the steps, in the order of the plan."""
        return tuple(chain.from_iterable(self.moments))

    def with_event(self, *events: StepEvent) -> "PlanExecution":
        return replace(self, happened=self.happened.union(events))

    @property
    def is_finished(self) -> bool:
        return len(self.happened) == 2 * len(self.steps)

    @property
    def startable(self) -> tuple[int, ...]:
        return tuple(number for number in self.remaining if self.after[number] <= self.happened)

    @property
    def remaining(self) -> tuple[int, ...]:
        return tuple(
            number
            for number in range(len(self.steps))
            if StepEvent(number, False) not in self.happened
        )

    @property
    def running(self) -> tuple[int, ...]:
        started = {one.number for one in self.happened}
        return tuple(
            number for number in sorted(started) if StepEvent(number, True) not in self.happened
        )

    @property
    def unfinished_steps(self) -> tuple[Step, ...]:
        return tuple(self.steps[number] for number in (*self.running, *self.remaining))

    def starts_with(self, step: Step) -> int | None:
        """Return the number of an equal step that may start now, or None."""
        return next((number for number in self.startable if self.steps[number] == step), None)

    def ends_s(
        self, takes_s: Callable[[Step], float], shares: Mapping[Step, float]
    ) -> tuple[float, ...]:
        """Return the time from now to the earliest end of each step [s], given the shares left of running steps."""
        at = dict[StepEvent, float]()
        for event in self.events:
            number, before = event.number, StepEvent(event.number, False)
            if event in self.happened:
                at[event] = 0.0
            elif event.is_end:
                share = shares.get(self.steps[number], 1.0) if before in self.happened else 1.0
                at[event] = at[before] + takes_s(self.steps[number]) * share
            else:
                at[event] = max((at.get(one, 0.0) for one in self.after[number]), default=0.0)
        return tuple(at[StepEvent(number, True)] for number in range(len(self.steps)))

    def prediction(
        self,
        domain: Domain,
        state: State,
        until: Mapping[str, float] | None = None,
        ends_s: Sequence[float] = (),
    ) -> Prediction:
        """Predict the rest of the plan from the current state; `until` and `ends_s` are as in `replay`."""
        left = (
            [event for event in moment if event not in self.happened] for moment in self.moments
        )
        flaw, facts = replay(
            domain, self.steps, filter(None, left), state, self.running, until, ends_s
        )
        missed = (
            goal.text for goal in self.goals if not goal_holds(domain, facts, [goal.expression])
        )
        unreached = None if flaw else next(missed, None)
        return Prediction(
            flaw or (unreached and f"the rest of the plan does not reach {unreached}"), facts
        )


def _scheduled(
    domain: Domain, schedule: Sequence[TimedStep], goals: tuple[Goal, ...]
) -> PlanExecution:
    timed = sorted(schedule, key=lambda one: one.start_s)

    def rank(event: StepEvent) -> tuple[int, StepEvent]:
        """Order the events of one moment: first ends, then starts, then the ends of instantaneous steps."""
        return (1 if not event.is_end else 0 if timed[event.number].duration_s > 0.0 else 2), event

    in_time = tuple(
        tuple(_in_turn(domain, timed, sorted(moment, key=rank))) for moment in moments(timed)
    )
    events = tuple(chain.from_iterable(in_time))
    touched = [_touched(domain, one.step) for one in timed]
    at_events = {
        event: _touched(domain, timed[event.number].step, [event.is_end]) for event in events
    }
    after = tuple(
        frozenset(
            event
            for event in events[: events.index(StepEvent(number, False))]
            if event.number != number and _interfere(at_events[event], touched[number])
        )
        for number in range(len(timed))
    )
    return PlanExecution(
        tuple(one.step for one in timed),
        in_time,
        _not_too_early(domain, timed, touched, after),
        goals,
    )


def _not_too_early(
    domain: Domain,
    timed: Sequence[TimedStep],
    touched: Sequence[_Touched],
    after: Sequence[frozenset[StepEvent]],
) -> tuple[frozenset[StepEvent], ...]:
    """Let a step that provides something only while it runs, such as light, wait for what its first user waits for.

    Otherwise it might end before it is used, as it is not known how long the other steps really take.
    """
    waits = list(after)
    for number, one in enumerate(timed):
        lent = _lent(domain, one.step)
        users = [
            user
            for user in range(len(timed))
            if lent & touched[user][0] and StepEvent(number, False) in after[user]
        ]
        if users and one.duration_s > 0.0:
            waiting = _waiting_for(waits, number)
            waits[number] |= {event for event in after[users[0]] if event.number not in waiting}
    return tuple(waits)


def _lent(domain: Domain, step: Step) -> frozenset[str]:
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    given = [effect for effect in schema.start_effects if not effect.value.is_false()]
    taken = [effect for effect in schema.end_effects if not effect.value.is_true()]
    return frozenset(affected_atoms(domain, given, binding)) & frozenset(
        affected_atoms(domain, taken, binding)
    )


def _waiting_for(waits: Sequence[frozenset[StepEvent]], number: int) -> set[int]:
    found, more = set[int](), {number}
    while more:
        found |= more
        rest = [other for other in range(len(waits)) if other not in found]
        more = {other for other in rest if any(event.number in found for event in waits[other])}
    return found


def _in_turn(
    domain: Domain, timed: Sequence[TimedStep], together: Sequence[StepEvent]
) -> Iterator[StepEvent]:
    """Yield the events of one moment; a step starts after the events that provide its `over all` conditions."""
    left = list(together)

    def provides(event: StepEvent) -> bool:
        return not event.is_end or timed[event.number].duration_s == 0.0

    def is_early(event: StepEvent) -> bool:
        if event.is_end:
            return StepEvent(event.number, False) in left
        step = timed[event.number].step
        held = set(
            mentioned_atoms(
                domain, domain.schema_of[step.schema].over_all, (), binding_of(domain, step)
            )
        )
        others = [one for one in left if one.number != event.number and provides(one)]
        return any(
            held & _touched(domain, timed[one.number].step, [one.is_end])[1] for one in others
        )

    while left:
        event = next((one for one in left if not is_early(one)), left[0])
        left.remove(event)
        yield event


def _touched(domain: Domain, step: Step, ends: Iterable[bool] = (False, True)) -> _Touched:
    """Return the atoms that a step, or one of its ends only, needs, and the atoms that it may change."""
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    needed, changed = set[str](), set[str]()
    for is_end in ends:
        conditions = schema.over_all + (schema.end if is_end else schema.start)
        effects = schema.end_effects if is_end else schema.start_effects
        needed |= set(mentioned_atoms(domain, conditions, effects, binding))
        changed |= set(affected_atoms(domain, effects, binding))
    return frozenset(needed), frozenset(changed)


def _interfere(one: _Touched, other: _Touched) -> bool:
    return bool(one[1] & (other[0] | other[1]) or one[0] & other[1])


class PlanMonitor:
    """Checks whether the plan that is executed still works."""

    def __init__(self, effects: ExpectedEffects, belief: Belief, forecasts: _Forecasts) -> None:
        self.effects, self.belief, self._forecasts = effects, belief, forecasts

    @property
    def is_forecast(self) -> bool:
        """Whether there are forecasts, so that what is late depends on the time."""
        return bool(self._forecasts())

    def until(self) -> dict[str, float]:
        """Return how much longer facts hold for a new plan [s]: the earliest time forecast, with a margin."""
        ends = {atom: (one.earliest, one.now) for atom, one in self._forecasts().items()}
        return {atom: (end - now) / _LONGER for atom, (end, now) in ends.items() if end is not None}

    def is_no_easier(self, then: Problem) -> bool:
        """Whether a problem without a plan has none now either, as no limit and no forecast leaves more."""
        now = self.until() if then.until else {}
        lasts_longer = any(
            now.get(atom, inf) > left_s * _LONGER for atom, left_s in then.until.items()
        )
        return not lasts_longer and usage_of(self.effects.domain).leave_no_more(
            self.belief.numbers, then.costs
        )

    def too_late(
        self, plan: PlanExecution, state: State, shares: Mapping[Step, float]
    ) -> str | None:
        """Return in words which step of a working plan would end too late by the expected times; None if none."""
        forecasts = self._forecasts()
        found = {atom: one.at - one.now for atom, one in forecasts.items() if one.at is not None}
        if not found or not plan.goals:  # a safe step, which has no goals, is never too late
            return None
        domain, usage = self.effects.domain, usage_of(self.effects.domain)
        numbers = usage.numbers(self.belief.numbers, state)
        ends_s = plan.ends_s(lambda step: float(usage.takes_s(step, numbers)), shares)
        flaw = (
            plan.prediction(domain, state, found, ends_s).flaw
            if max((0.0, *ends_s)) > min(found.values())
            else None
        )
        if flaw is None:
            return None
        alone = [
            one
            for one in found
            if plan.prediction(domain, state, {one: found[one]}, ends_s).flaw == flaw
        ]
        return f"{flaw}, as " + " and ".join(
            f"{forecasts[one].action} is {forecasts[one]}" for one in alone or found
        )

    def overspent(self, plan: PlanExecution) -> str | None:
        """Return in words which limit the steps that have not started break; None if they keep all limits.

        Running steps are left out, as the sensed numbers may already include part of what they use.
        """
        with suppress(UnsupportedPddlError):  # a safe step may run though a number is unknown
            steps = (plan.steps[number] for number in plan.remaining)
            over = usage_of(self.effects.domain).overspent(self.belief.numbers, steps)
            return None if over is None else f"the rest of the plan is too much: {over}"
        return None

    def aimed(self, plan: PlanExecution, state: State, goals: Goals) -> PlanExecution:
        """Return the plan with the current goals as its goals: all hard ones, and the soft ones that it reaches."""
        facts = plan.prediction(self.effects.domain, state).facts
        return replace(plan, goals=goals.hard + self._holding(goals.soft, facts))

    def is_over(self, state: State, goals: Goals, plan: PlanExecution | None) -> bool:
        """Whether nothing is left to do: all goals hold, or the plan is finished and gave up only soft goals."""
        wanted = goals.hard if plan is not None and plan.is_finished else tuple(goals)
        return self._holding(wanted, state) == wanted

    def is_better(
        self,
        new: tuple[PlanExecution, State],
        old: tuple[PlanExecution, State],
        goals: Goals,
        shares: Mapping[Step, float],
        weights: Mapping[Step, int],
        margin: float,
    ) -> bool:
        """Whether the new plan works and, even with its cost raised by the margin, costs less than the rest of the old.

        Each plan comes with the state that it begins in; shares are left of running steps, weights multiply costs.
        """
        plan, after = new
        if (
            plan.prediction(self.effects.domain, after).flaw is not None
            or self.overspent(plan) is not None
        ):
            return False
        try:
            mine, others = (self._price(*one, goals, shares, weights) for one in (new, old))
        except UnsupportedPddlError:  # a number that costs depend on is unknown now
            return False
        return mine * (1.0 + margin) < others - _SAME_COST

    def _price(
        self,
        plan: PlanExecution,
        state: State,
        goals: Goals,
        shares: Mapping[Step, float],
        weights: Mapping[Step, int],
    ) -> float:
        """Return the cost of the steps that have not ended plus the worth of the soft goals that are given up."""
        domain, usage = self.effects.domain, usage_of(self.effects.domain)
        held = self._holding(goals.soft, plan.prediction(domain, state).facts)
        price = sum(goal.worth or 0.0 for goal in goals.soft if goal not in held)
        steps, begun = plan.unfinished_steps, len(plan.running)
        for step, numbers in usage.in_turn(self.belief.numbers, state, steps, begun):
            cost = float(usage.value(usage.cost_of(step), numbers))
            price += cost * shares.get(step, 1.0) * weights.get(step, 1)
        return price

    def _holding(self, goals: Iterable[Goal], facts: State) -> tuple[Goal, ...]:
        return tuple(
            goal for goal in goals if goal_holds(self.effects.domain, facts, [goal.expression])
        )
