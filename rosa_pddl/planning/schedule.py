"""The judge of plans whose steps overlap: replays starts and ends in the order of their times."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rosa_pddl.domain import Domain, Schema, State, UpThing
from rosa_pddl.planning.outcomes import TimedStep
from rosa_pddl.validate import Binding, because, binding_of, changes, goal_holds, mentioned_atoms, missing_of

__all__ = ["schedule_flaw"]

# Times that differ by less are the same: those of an engine are decimal numbers, and are added up here [s].
_SAME_TIME_S = 1e-6


@dataclass(frozen=True)
class _Happening:
    """The start or the end of a step; an instantaneous step only ends."""

    at_s: float
    is_end: bool
    timed: TimedStep
    schema: Schema
    binding: Binding

    @property
    def conditions(self) -> tuple[UpThing, ...]:
        if self.timed.duration_s == 0.0:
            return self.schema.start + self.schema.over_all + self.schema.end
        return self.schema.end if self.is_end else self.schema.start

    @property
    def effects(self) -> tuple[UpThing, ...]:
        return self.schema.end_effects if self.is_end else self.schema.start_effects


def schedule_flaw(
    domain: Domain, schedule: Sequence[TimedStep], state: State, goals: Iterable[UpThing] | None = None
) -> str | None:
    """Why a schedule does not lead from a state to the goal, in words; None if it does.

    The meaning is that of PDDL 2.1: conditions at the start or at the end hold just before; what holds over all does so
    from just after the start until just before the end; of two things that happen at once, none may change what the
    other needs or changes.

    Args:
        domain: what `load_domain` returned.
        schedule: the plan.
        state: the true atoms.
        goals: what shall hold in the end, as unified-planning expressions; by default the goal of the problem file.
    """
    for timed in schedule:
        if not _lasts_as_declared(domain, timed):
            return f"{timed.step} takes {timed.duration_s:g} s, which is not its duration"
    facts = set(state)
    running: list[_Happening] = []
    for together in _moments(domain, schedule):
        wrong = _happen(domain, together, facts)
        if wrong is not None:
            return wrong
        ended = [id(one.timed) for one in together if one.is_end]
        running = [one for one in (*running, *together) if not one.is_end and id(one.timed) not in ended]
        for one in running:
            missing = missing_of(domain, one.schema.over_all, one.binding, facts)
            if missing is not None:
                return because(domain, one.timed.step, missing)
    return None if goal_holds(domain, facts, goals) else "the plan does not reach the goal"


def _lasts_as_declared(domain: Domain, timed: TimedStep) -> bool:
    """Whether a step lasts as its action says; durations that are computed from numeric facts are not looked at."""
    action = domain.up_problem.action(domain.inside["action", timed.step.schema.lower()])
    if not hasattr(action, "duration"):
        return timed.duration_s == 0.0
    lower, upper = action.duration.lower, action.duration.upper
    least = float(lower.constant_value()) if lower.is_constant() else 0.0
    most = float(upper.constant_value()) if upper.is_constant() else timed.duration_s
    return least - _SAME_TIME_S <= timed.duration_s <= most + _SAME_TIME_S and timed.duration_s > 0.0


def _moments(domain: Domain, schedule: Sequence[TimedStep]) -> Iterator[list[_Happening]]:
    """Yield what happens at once, in the order of time."""
    happenings: list[_Happening] = []
    for timed in schedule:
        schema, binding = domain.schema_of[timed.step.schema], binding_of(domain, timed.step)
        if timed.duration_s > 0.0:
            happenings.append(_Happening(timed.start_s, False, timed, schema, binding))
        happenings.append(_Happening(timed.end_s, True, timed, schema, binding))
    together: list[_Happening] = []
    for one in sorted(happenings, key=lambda happening: happening.at_s):
        if together and one.at_s - together[0].at_s > _SAME_TIME_S:
            yield together
            together = []
        together.append(one)
    if together:
        yield together


def _happen(domain: Domain, together: Sequence[_Happening], facts: set[str]) -> str | None:
    """Change the facts by what happens at once, or return why it cannot."""
    deleted: set[str] = set()
    added: set[str] = set()
    touched: list[tuple[_Happening, set[str], set[str]]] = []
    for one in together:
        missing = missing_of(domain, one.conditions, one.binding, facts)
        if missing is not None:
            return because(domain, one.timed.step, missing)
        gone, come = changes(domain, one.effects, one.binding, facts)
        needed = set(mentioned_atoms(domain, one.conditions, one.effects, one.binding))
        touched.append((one, needed, {*gone, *come}))
        deleted |= gone
        added |= come
    for one, needed, changed in touched:
        for other, _, changed_too in touched:
            if one is not other and changed_too & (needed | changed):
                atom = min(changed_too & (needed | changed))
                return f"{one.timed.step} and {other.timed.step} get in each other's way over {atom} at {one.at_s:g} s"
    facts -= deleted
    facts |= added
    return None
