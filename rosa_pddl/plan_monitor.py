"""How far a plan is executed, in which order its steps may start, and whether the rest works."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

from rosa_pddl.belief import Belief, ExpectedEffects
from rosa_pddl.domain import Domain, State, Step
from rosa_pddl.grounding import binding_of
from rosa_pddl.problem import PlanningResult, Problem
from rosa_pddl.reader import Goal
from rosa_pddl.validate import (
    StepEvent,
    TimedStep,
    affected_atoms,
    goal_holds,
    mentioned_atoms,
    moments,
    one_after_the_other,
    replay,
    takes_s,
)

# A new plan is made only if actions stay feasible this many times as long as the plan needs them.
_LONGER = 1.1

_Forecasts = Callable[[], Mapping[str, Any]]


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
    def of(cls, domain: Domain, result: PlanningResult, goals: tuple[Goal, ...]) -> "PlanExecution":
        """Order a plan: a step may start when all has happened that is planned before."""
        steps = result.steps
        planned: tuple[tuple[StepEvent, ...], ...] = one_after_the_other(len(steps))
        if result.schedule:
            planned = tuple(_in_turn(domain, result.schedule))
        events = list(chain.from_iterable(planned))
        after = list[frozenset[StepEvent]]()
        for number in range(len(steps)):
            after.append(frozenset(events[: events.index(StepEvent(number, False))]))
        for number in range(len(steps) if result.schedule else 0):
            after[number] |= _ends_before_use(domain, steps, number, after)
        return cls(steps, planned, tuple(after), goals)

    @property
    def events(self) -> tuple[StepEvent, ...]:
        """The starts and ends of the steps, in the order of the plan."""
        return tuple(chain.from_iterable(self.moments))

    def with_event(self, *events: StepEvent) -> "PlanExecution":
        """Return the plan with events that have happened."""
        return replace(self, happened=self.happened.union(events))

    @property
    def is_finished(self) -> bool:
        """Whether all steps have ended."""
        return len(self.happened) == 2 * len(self.steps)

    @property
    def startable(self) -> tuple[int, ...]:
        """The steps that may start now."""
        waiting = enumerate(self.after)
        ready = [number for number, events in waiting if events <= self.happened]
        return tuple(n for n in ready if StepEvent(n, False) not in self.happened)

    @property
    def running(self) -> tuple[int, ...]:
        """The steps that have started and not ended."""
        started = sorted({event.number for event in self.happened})
        return tuple(n for n in started if StepEvent(n, True) not in self.happened)

    def starts_with(self, step: Step) -> int | None:
        """Return the number of an equal step that may start now, or None."""
        return next((number for number in self.startable if self.steps[number] == step), None)

    def ends_s(
        self, takes: Callable[[Step], float], shares: Mapping[Step, float]
    ) -> tuple[float, ...]:
        """Return the time to the earliest end of each step [s], given shares left of running."""
        at = dict[StepEvent, float]()
        for event in self.events:
            step = self.steps[event.number]
            before = StepEvent(event.number, False)
            if event in self.happened:
                at[event] = 0.0
            elif event.is_end:
                share = shares.get(step, 1.0) if before in self.happened else 1.0
                at[event] = at[before] + takes(step) * share
            else:
                waits = [at.get(other, 0.0) for other in self.after[event.number]]
                at[event] = max(waits, default=0.0)
        return tuple(at[StepEvent(number, True)] for number in range(len(self.steps)))

    def prediction(
        self,
        domain: Domain,
        state: State,
        until: Mapping[str, float] | None = None,
        ends_s: Sequence[float] = (),
    ) -> Prediction:
        """Predict the rest of the plan from a state; `until` and `ends_s` are as in `replay`."""
        left = list[list[StepEvent]]()
        for moment in self.moments:
            events = [event for event in moment if event not in self.happened]
            if events:
                left.append(events)
        flaw, facts = replay(domain, self.steps, left, state, self.running, until, ends_s)
        if flaw is None:
            for goal in self.goals:
                if not goal_holds(domain, facts, [goal.expression]):
                    return Prediction(f"the rest of the plan does not reach {goal.text}", facts)
        return Prediction(flaw, facts)


def _in_turn(domain: Domain, schedule: Sequence[TimedStep]) -> Iterator[tuple[StepEvent, ...]]:
    """Yield the events of each moment: ends first, and a step after what it needs while it runs."""

    def rank(event: StepEvent) -> tuple[int, StepEvent]:
        timed = schedule[event.number]
        if timed.duration_s == 0.0:
            return 2, event
        if event.is_end:
            return 0, event
        return (3 if domain.schema_of[timed.step.schema].over_all else 1), event

    for moment in moments(schedule):
        yield tuple(sorted(moment, key=rank))


def _ends_before_use(
    domain: Domain, steps: Sequence[Step], number: int, after: Sequence[frozenset[StepEvent]]
) -> set[StepEvent]:
    """Return the ends of earlier steps that the first user of what a step lends waits for.

    A step lends what it provides only while it runs, such as light. It might end before it is used
    if it did not wait for these, as it is not known how long steps really take.
    """
    schema = domain.schema_of[steps[number].schema]
    binding = binding_of(domain, steps[number])
    given = affected_atoms(domain, schema.start_effects, binding)
    lent = set(given).intersection(affected_atoms(domain, schema.end_effects, binding))
    for user, waits in sorted(enumerate(after), key=lambda pair: len(pair[1])):
        conditions = domain.schema_of[steps[user].schema].conditions
        read = mentioned_atoms(domain, conditions, (), binding_of(domain, steps[user]))
        if StepEvent(number, False) in waits and not lent.isdisjoint(read):
            return {e for e in waits if e.is_end and StepEvent(e.number, False) in after[number]}
    return set()


class PlanMonitor:
    """Checks whether the plan that is executed still works."""

    def __init__(self, effects: ExpectedEffects, belief: Belief, forecasts: _Forecasts) -> None:
        self.effects = effects
        self.belief = belief
        self._forecasts = forecasts

    def until(self) -> dict[str, float]:
        """Return how much longer facts hold for a new plan [s]: the earliest, with a margin."""
        until = dict[str, float]()
        for atom, forecast in self._forecasts().items():
            if forecast.earliest is not None:
                until[atom] = (forecast.earliest - forecast.now) / _LONGER
        return until

    def is_no_easier(self, then: Problem) -> bool:
        """Whether a problem without a plan has none now either."""
        now = self.until() if then.until else {}
        for atom, left_s in then.until.items():
            if now.get(atom, float("inf")) > left_s * _LONGER:
                return False
        return True

    def too_late(
        self, plan: PlanExecution, state: State, shares: Mapping[Step, float]
    ) -> str | None:
        """Return in words which step of a working plan would end too late; None if none would."""
        forecasts = self._forecasts()
        left = {atom: each.at - each.now for atom, each in forecasts.items() if each.at is not None}
        if not left:
            return None
        domain = self.effects.domain
        numbers = self.belief.numbers

        def takes(step: Step) -> float:
            return takes_s(domain, step, state, numbers)

        ends_s = plan.ends_s(takes, shares)
        if max((0.0, *ends_s)) <= min(left.values()):
            return None
        for atom, left_s in left.items():
            flaw = plan.prediction(domain, state, {atom: left_s}, ends_s).flaw
            if flaw is not None:
                return f"{flaw}, as {forecasts[atom].action} is {forecasts[atom]}"
        return None

    def aimed(
        self, plan: PlanExecution, state: State, hard: tuple[Goal, ...], soft: tuple[Goal, ...]
    ) -> PlanExecution:
        """Return the plan with other goals: all hard ones, and the soft ones that it reaches."""
        facts = plan.prediction(self.effects.domain, state).facts
        return replace(plan, goals=hard + self.holding(soft, facts))

    def holding(self, goals: Iterable[Goal], facts: State) -> tuple[Goal, ...]:
        """Return the goals that hold."""
        domain = self.effects.domain
        return tuple(goal for goal in goals if goal_holds(domain, facts, [goal.expression]))
