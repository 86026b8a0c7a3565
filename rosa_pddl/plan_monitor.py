"""How far a plan is executed, in which order its steps may start, and whether the rest works."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from typing import Any, NamedTuple

from rosa_pddl.belief import Belief, ExpectedEffects
from rosa_pddl.domain import Domain, Effect, Feasibility, State, Step
from rosa_pddl.grounding import binding_of
from rosa_pddl.problem import PlanningResult, Problem
from rosa_pddl.reader import Goal
from rosa_pddl.validate import (
    Clash,
    StepEvent,
    TimedStep,
    affected_atoms,
    goal_holds,
    mentioned_atoms,
    moments,
    one_after_the_other,
    replay,
    step_costs,
    takes_s,
)

# Costs are sums of floats; a difference below this counts as none.
_SAME_COST = 1e-9
# A new plan is made only if actions stay feasible this many times as long as the plan needs them.
_LONGER = 1.1

_Touched = tuple[frozenset[str], frozenset[str]]
_Forecasts = Callable[[], Mapping[str, Any]]


def shared_components(kb: Feasibility) -> Clash:
    """Return a function: whether two steps may need the same component, in any design."""

    @cache
    def components(action: str | None) -> frozenset[str]:
        functions, designs = (getattr(kb, kind, {}) for kind in ("functions", "designs"))
        required = getattr(kb.actions[action], "functions", ()) if action is not None else ()
        names = set[str]()
        for function in required:
            for design in functions[function].designs:
                names.update(designs[design].components)
        return frozenset(names)

    def clash(step: Step, other: Step) -> bool:
        is_same = step.action is not None and step.action == other.action
        return is_same or bool(components(step.action) & components(other.action))

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
        """Order a plan: a schedule by what its steps need, others one step after the other.

        If `clash` is given, a step of an unscheduled plan waits only for the earlier steps with
        which it clashes or interferes: one of the two changes what the other needs or changes.
        All orders that this allows have the same result.
        """
        if result.schedule:
            return _scheduled(domain, result.schedule, goals)
        steps = result.steps
        touched = [_touched(domain, step) for step in steps] if clash else []
        after = list[frozenset[StepEvent]]()
        for number, step in enumerate(steps):
            waits = set[StepEvent]()
            for before in range(number):
                if clash is None:
                    must_wait = before == number - 1
                else:
                    must_wait = _interfere(touched[before], touched[number])
                    must_wait = must_wait or clash(steps[before], step)
                if must_wait:
                    waits.add(StepEvent(before, True))
            after.append(frozenset(waits))
        return cls(steps, one_after_the_other(len(steps)), tuple(after), goals)

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
        return tuple(n for n in self.remaining if self.after[n] <= self.happened)

    @property
    def remaining(self) -> tuple[int, ...]:
        """The steps that have not started."""
        numbers = range(len(self.steps))
        return tuple(n for n in numbers if StepEvent(n, False) not in self.happened)

    @property
    def running(self) -> tuple[int, ...]:
        """The steps that have started and not ended."""
        started = sorted({event.number for event in self.happened})
        return tuple(n for n in started if StepEvent(n, True) not in self.happened)

    @property
    def unfinished_steps(self) -> tuple[Step, ...]:
        """The steps that have not ended, those that run first."""
        return tuple(self.steps[number] for number in (*self.running, *self.remaining))

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


def _scheduled(
    domain: Domain, schedule: Sequence[TimedStep], goals: tuple[Goal, ...]
) -> PlanExecution:
    timed = sorted(schedule, key=lambda each: each.start_s)

    def rank(event: StepEvent) -> tuple[int, StepEvent]:
        """Order the events of a moment: ends, then starts, then ends of instantaneous steps."""
        if not event.is_end:
            return 1, event
        return (0 if timed[event.number].duration_s > 0.0 else 2), event

    in_time = list[tuple[StepEvent, ...]]()
    for moment in moments(timed):
        in_time.append(tuple(_in_turn(domain, timed, sorted(moment, key=rank))))
    events = tuple(chain.from_iterable(in_time))
    touched = [_touched(domain, each.step) for each in timed]
    at_event = dict[StepEvent, _Touched]()
    for event in events:
        at_event[event] = _touched(domain, timed[event.number].step, [event.is_end])
    after = list[frozenset[StepEvent]]()
    for number in range(len(timed)):
        earlier = events[: events.index(StepEvent(number, False))]
        others = [event for event in earlier if event.number != number]
        waits = [event for event in others if _interfere(at_event[event], touched[number])]
        after.append(frozenset(waits))
    steps = tuple(each.step for each in timed)
    waits_for = _not_too_early(domain, timed, touched, after)
    return PlanExecution(steps, tuple(in_time), waits_for, goals)


def _not_too_early(
    domain: Domain,
    timed: Sequence[TimedStep],
    touched: Sequence[_Touched],
    after: Sequence[frozenset[StepEvent]],
) -> tuple[frozenset[StepEvent], ...]:
    """Let a step that lends something, such as light, wait for what its first user waits for.

    Otherwise it might end before it is used, as it is not known how long steps really take.
    """
    waits = list(after)
    for number, each in enumerate(timed):
        lent = _lent(domain, each.step)
        start = StepEvent(number, False)
        users = [n for n in range(len(timed)) if lent & touched[n][0] and start in after[n]]
        if users and each.duration_s > 0.0:
            waiting = _waiting_for(waits, number)
            waits[number] |= {event for event in after[users[0]] if event.number not in waiting}
    return tuple(waits)


def _lent(domain: Domain, step: Step) -> frozenset[str]:
    schema = domain.schema_of[step.schema]
    binding = binding_of(domain, step)
    lent = [effect for effect in schema.start_effects if effect.kind != "delete"]
    taken = [effect for effect in schema.end_effects if effect.kind != "add"]
    atoms = frozenset(affected_atoms(domain, lent, binding))
    return atoms.intersection(affected_atoms(domain, taken, binding))


def _waiting_for(waits: Sequence[frozenset[StepEvent]], number: int) -> set[int]:
    waiting, more = set[int](), {number}
    while more:
        waiting |= more
        rest = [other for other in range(len(waits)) if other not in waiting]
        more = {n for n in rest if any(event.number in waiting for event in waits[n])}
    return waiting


def _in_turn(
    domain: Domain, timed: Sequence[TimedStep], together: Sequence[StepEvent]
) -> Iterator[StepEvent]:
    """Yield the events of a moment; a step starts after what provides its `over all` conditions."""
    left = list(together)

    def is_early(event: StepEvent) -> bool:
        if event.is_end:
            return StepEvent(event.number, False) in left
        step = timed[event.number].step
        over_all = domain.schema_of[step.schema].over_all
        needed = set(mentioned_atoms(domain, over_all, (), binding_of(domain, step)))
        for other in left:
            provides = not other.is_end or timed[other.number].duration_s == 0.0
            if other.number != event.number and provides:
                if needed & _touched(domain, timed[other.number].step, [other.is_end])[1]:
                    return True
        return False

    while left:
        event = next((each for each in left if not is_early(each)), left[0])
        left.remove(event)
        yield event


def _touched(domain: Domain, step: Step, ends: Iterable[bool] = (False, True)) -> _Touched:
    """Return the atoms that a step, or one of its ends, needs, and those that it may change."""
    schema = domain.schema_of[step.schema]
    binding = binding_of(domain, step)
    needed, changed = set[str](), set[str]()
    for is_end in ends:
        conditions = schema.over_all + (schema.end if is_end else schema.start)
        effects: tuple[Effect, ...] = schema.end_effects if is_end else schema.start_effects
        needed |= set(mentioned_atoms(domain, conditions, effects, binding))
        changed |= set(affected_atoms(domain, effects, binding))
    return frozenset(needed), frozenset(changed)


def _interfere(one: _Touched, other: _Touched) -> bool:
    return bool(one[1] & (other[0] | other[1]) or one[0] & other[1])


class PlanMonitor:
    """Checks whether the plan that is executed still works."""

    def __init__(self, effects: ExpectedEffects, belief: Belief, forecasts: _Forecasts) -> None:
        self.effects = effects
        self.belief = belief
        self._forecasts = forecasts

    @property
    def is_forecast(self) -> bool:
        """Whether there are forecasts, so that what is late depends on the time."""
        return bool(self._forecasts())

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
        if not left or not plan.goals:  # a safe step, which has no goals, is never too late
            return None
        domain, numbers = self.effects.domain, self.belief.numbers

        def takes(step: Step) -> float:
            return takes_s(domain, step, state, numbers)

        ends_s = plan.ends_s(takes, shares)
        if max((0.0, *ends_s)) <= min(left.values()):
            return None
        flaw = plan.prediction(domain, state, left, ends_s).flaw
        if flaw is None:
            return None
        reasons = list[str]()
        for atom, forecast in forecasts.items():
            alone = {atom: left[atom]} if atom in left else {}
            if alone and plan.prediction(domain, state, alone, ends_s).flaw == flaw:
                reasons.append(f"{forecast.action} is {forecast}")
        if not reasons:
            reasons = [f"{forecasts[atom].action} is {forecasts[atom]}" for atom in left]
        return f"{flaw}, as {' and '.join(reasons)}"

    def aimed(
        self, plan: PlanExecution, state: State, hard: tuple[Goal, ...], soft: tuple[Goal, ...]
    ) -> PlanExecution:
        """Return the plan with other goals: all hard ones, and the soft ones that it reaches."""
        facts = plan.prediction(self.effects.domain, state).facts
        return replace(plan, goals=hard + self.holding(soft, facts))

    def is_better(
        self,
        new: tuple[PlanExecution, State],
        old: tuple[PlanExecution, State],
        soft: tuple[Goal, ...],
        shares: Mapping[Step, float],
        weights: Mapping[Step, int],
        margin: float,
    ) -> bool:
        """Whether the new plan works and costs less than the rest of the old, by a margin.

        Each plan comes with the state that it begins in.
        """
        plan, after = new
        if plan.prediction(self.effects.domain, after).flaw is not None:
            return False
        mine, theirs = (self._price(*each, soft, shares, weights) for each in (new, old))
        if mine is None or theirs is None:  # a number that costs depend on is unknown now
            return False
        return mine * (1.0 + margin) < theirs - _SAME_COST

    def _price(
        self,
        plan: PlanExecution,
        state: State,
        soft: tuple[Goal, ...],
        shares: Mapping[Step, float],
        weights: Mapping[Step, int],
    ) -> float | None:
        """Return the cost of the steps that have not ended, and of the soft goals given up."""
        domain = self.effects.domain
        reached = self.holding(soft, plan.prediction(domain, state).facts)
        price = sum(goal.worth or 0.0 for goal in soft if goal not in reached)
        steps = plan.unfinished_steps
        costs = step_costs(domain, steps, state, self.belief.numbers, len(plan.running))
        for step, cost in zip(steps, costs, strict=True):
            if cost is None:
                return None
            price += cost * shares.get(step, 1.0) * weights.get(step, 1)
        return price

    def holding(self, goals: Iterable[Goal], facts: State) -> tuple[Goal, ...]:
        """Return the goals that hold."""
        domain = self.effects.domain
        return tuple(goal for goal in goals if goal_holds(domain, facts, [goal.expression]))
