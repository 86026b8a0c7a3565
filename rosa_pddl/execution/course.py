"""A plan on its way: in which order its steps may start, how far it has come, and whether the rest still works."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from typing import NamedTuple

from rosa_pddl.domain import Domain, State, Step
from rosa_pddl.execution.goals import Goal
from rosa_pddl.planning import PlanningResult, TimedStep
from rosa_pddl.validate import affected_atoms, because, binding_of, changes, goal_holds, mentioned_atoms, missing_of

__all__ = ["Course", "Event", "Replay"]

_SAME_TIME_S = 1e-6

_Touched = tuple[frozenset[str], frozenset[str]]


class Event(NamedTuple):
    """The start or the end of a step, by its number in the plan."""

    number: int
    is_end: bool


@dataclass(frozen=True)
class Replay:
    """What the rest of a plan leads to, if nothing comes between.

    Args:
        flaw: why it does not reach the goals, in words; None if it does.
        facts: the true atoms in the end, or where it broke off.
    """

    flaw: str | None
    facts: State


@dataclass(frozen=True)
class Course:
    """A plan, the order of its steps, and what of it has happened.

    Args:
        domain: what `load_domain` returned.
        steps: of the plan, in the order of their starts.
        events: every start and end, in the order that was planned.
        after: for each step, what has to have happened before it may start.
        goals: what the plan shall reach.
        happened: what has happened.
    """

    domain: Domain
    steps: tuple[Step, ...]
    events: tuple[Event, ...]
    after: tuple[frozenset[Event], ...]
    goals: tuple[Goal, ...]
    happened: frozenset[Event] = frozenset()

    @classmethod
    def of(cls, domain: Domain, result: PlanningResult, goals: tuple[Goal, ...]) -> "Course":
        """Order a plan: a schedule by what its steps need of one another, other plans one step after the other."""
        if result.schedule:
            return _scheduled(domain, result.schedule, goals)
        steps = result.steps
        events = tuple(Event(number, is_end) for number in range(len(steps)) for is_end in (False, True))
        after = tuple(frozenset({Event(number - 1, True)} if number else ()) for number in range(len(steps)))
        return cls(domain, steps, events, after, goals)

    def with_event(self, *events: Event) -> "Course":
        """Return the course after something has happened."""
        return replace(self, happened=self.happened.union(events))

    def with_domain(self, domain: Domain) -> "Course":
        """Return the course as it is in a domain that differs in what steps bring about."""
        return replace(self, domain=domain)

    def with_goals(self, goals: tuple[Goal, ...]) -> "Course":
        """Return the course with other goals to reach."""
        return replace(self, goals=goals)

    @property
    def is_finished(self) -> bool:
        """Whether everything has happened."""
        return len(self.happened) == len(self.events)

    @property
    def startable(self) -> tuple[int, ...]:
        """Numbers of the steps that may start now."""
        return tuple(number for number in self.remaining if self.after[number] <= self.happened)

    @property
    def remaining(self) -> tuple[int, ...]:
        """Numbers of the steps that have not started."""
        return tuple(number for number in range(len(self.steps)) if Event(number, False) not in self.happened)

    @property
    def unfinished_steps(self) -> tuple[Step, ...]:
        """The steps that have not ended."""
        return tuple(step for number, step in enumerate(self.steps) if Event(number, True) not in self.happened)

    def starts_with(self, step: Step) -> int | None:
        """Return the number of an equal step that may start now, None if there is none."""
        return next((number for number in self.startable if self.steps[number] == step), None)

    def replay(self, state: State) -> Replay:
        """Suppose that the rest happens as planned.

        Conditions at the end of steps that run already are passed over: the world may bring them about until then.

        Args:
            state: the true atoms now.
        """
        facts = set(state)
        running = [e.number for e in self.events if e in self.happened and Event(e.number, True) not in self.happened]
        begun = frozenset(running)
        for event in self.events:
            if event in self.happened:
                continue
            flaw = self._happen(event, facts, is_checked=not (event.is_end and event.number in begun))
            if event.is_end:
                running.remove(event.number)
            else:
                running.append(event.number)
            flaw = flaw or next(filter(None, (self._missing(number, facts) for number in running)), None)
            if flaw is not None:
                return Replay(flaw, frozenset(facts))
        return Replay(self._unreached(facts), frozenset(facts))

    def _happen(self, event: Event, facts: set[str], *, is_checked: bool) -> str | None:
        step = self.steps[event.number]
        schema, binding = self.domain.schema_of[step.schema], binding_of(self.domain, step)
        if is_checked:
            needed = schema.end if event.is_end else schema.start
            missing = missing_of(self.domain, needed, binding, facts)
            if missing is not None:
                return because(self.domain, step, missing)
        effects = schema.end_effects if event.is_end else schema.start_effects
        deleted, added = changes(self.domain, effects, binding, facts)
        facts -= deleted
        facts |= added
        return None

    def _missing(self, number: int, facts: set[str]) -> str | None:
        step = self.steps[number]
        missing = missing_of(
            self.domain, self.domain.schema_of[step.schema].over_all, binding_of(self.domain, step), facts
        )
        return None if missing is None else because(self.domain, step, missing)

    def _unreached(self, facts: set[str]) -> str | None:
        for goal in self.goals:
            if not goal_holds(self.domain, facts, [goal.expression]):
                return f"the rest of the plan does not reach {goal.text}"
        return None


def _scheduled(domain: Domain, schedule: Sequence[TimedStep], goals: tuple[Goal, ...]) -> Course:
    timed = sorted(schedule, key=lambda one: one.start_s)
    events = _in_time(domain, timed)
    touched = [_touched(domain, one.step) for one in timed]
    at_events = {event: _touched(domain, timed[event.number].step, [event.is_end]) for event in events}
    after = tuple(
        frozenset(
            event
            for event in events[: events.index(Event(number, False))]
            if event.number != number and _interfere(at_events[event], touched[number])
        )
        for number in range(len(timed))
    )
    return Course(
        domain, tuple(one.step for one in timed), events, _not_too_early(domain, timed, touched, after), goals
    )


def _not_too_early(
    domain: Domain, timed: Sequence[TimedStep], touched: Sequence[_Touched], after: Sequence[frozenset[Event]]
) -> tuple[frozenset[Event], ...]:
    """Let a step that provides something only while it lasts, such as light, wait for what its first user waits for.

    Otherwise it might be over before it is of use, as nothing tells how long the others take.
    """
    waits = list(after)
    for number, one in enumerate(timed):
        lent = _lent(domain, one.step)
        users = [user for user in range(len(timed)) if lent & touched[user][0] and Event(number, False) in after[user]]
        if users and one.duration_s > 0.0:
            waiting = _waiting_for(waits, number)
            waits[number] |= {event for event in after[users[0]] if event.number not in waiting}
    return tuple(waits)


def _lent(domain: Domain, step: Step) -> frozenset[str]:
    """Return the atoms that a step makes true when it starts, and false when it ends."""
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    given = [effect for effect in schema.start_effects if not effect.value.is_false()]
    taken = [effect for effect in schema.end_effects if not effect.value.is_true()]
    return frozenset(affected_atoms(domain, given, binding)) & frozenset(affected_atoms(domain, taken, binding))


def _waiting_for(waits: Sequence[frozenset[Event]], number: int) -> set[int]:
    """Return a step and those that have to wait for it."""
    found, more = set[int](), {number}
    while more:
        found |= more
        rest = [other for other in range(len(waits)) if other not in found]
        more = {other for other in rest if any(event.number in found for event in waits[other])}
    return found


def _in_time(domain: Domain, timed: Sequence[TimedStep]) -> tuple[Event, ...]:
    """Order starts and ends; at one moment first what ends, then what starts, then what is over at once."""
    dated: list[tuple[int, int, Event]] = []
    for number, one in enumerate(timed):
        dated.append((round(one.start_s / _SAME_TIME_S), 1, Event(number, False)))
        dated.append((round(one.end_s / _SAME_TIME_S), 0 if one.duration_s > 0.0 else 2, Event(number, True)))
    moments = groupby(sorted(dated), key=lambda one: one[0])
    return tuple(chain.from_iterable(_in_turn(domain, timed, [event for *_, event in moment]) for _, moment in moments))


def _in_turn(domain: Domain, timed: Sequence[TimedStep], together: list[Event]) -> Iterator[Event]:
    """Yield what happens at one moment in an order that keeps what holds over all.

    A step needs that from just after its start until just before its end: it starts after what brings it about, and
    ends before what takes it away.
    """
    left = list(together)
    while left:
        free = (one for one in left if not any(_precedes(domain, timed, other, one) for other in left))
        event = next(free, left[0])
        left.remove(event)
        yield event


def _precedes(domain: Domain, timed: Sequence[TimedStep], one: Event, other: Event) -> bool:
    if one.number == other.number:
        return other.is_end and not one.is_end
    if one.is_end and timed[one.number].duration_s > 0.0:
        return bool(_held(domain, timed[one.number].step) & _changed(domain, timed, other))
    return not other.is_end and bool(_held(domain, timed[other.number].step) & _changed(domain, timed, one))


def _held(domain: Domain, step: Step) -> frozenset[str]:
    """Return the atoms that a step looks at all the while."""
    over_all = domain.schema_of[step.schema].over_all
    return frozenset(mentioned_atoms(domain, over_all, (), binding_of(domain, step)))


def _changed(domain: Domain, timed: Sequence[TimedStep], event: Event) -> frozenset[str]:
    return _touched(domain, timed[event.number].step, [event.is_end])[1]


def _touched(domain: Domain, step: Step, ends: Iterable[bool] = (False, True)) -> _Touched:
    """Return the atoms that a step, or only its start or its end, needs, and those that it changes."""
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    needed: set[str] = set()
    changed: set[str] = set()
    for is_end in ends:
        conditions = schema.over_all + (schema.end if is_end else schema.start)
        effects = schema.end_effects if is_end else schema.start_effects
        needed |= set(mentioned_atoms(domain, conditions, effects, binding))
        changed |= set(affected_atoms(domain, effects, binding))
    return frozenset(needed), frozenset(changed)


def _interfere(one: _Touched, other: _Touched) -> bool:
    return bool(one[1] & (other[0] | other[1]) or one[0] & other[1])
