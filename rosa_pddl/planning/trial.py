"""One planning: the ways in order, each within its budget, and what is reported of all of them."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

from rosa_pddl.domain import Domain, Schema, Step, TimedStep, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.downward import SEARCHES, Answer, Trouble, search
from rosa_pddl.planning.engines import asked, missing
from rosa_pddl.planning.grounded import Grounded, NotRepresentableError, UnreachableGoalError
from rosa_pddl.planning.grounding import Grounding, Instantaneous, instantaneous, translated
from rosa_pddl.planning.labelling import LABEL_SETTING, label_search
from rosa_pddl.planning.outcomes import Attempt, Outcome, PlanningResult
from rosa_pddl.planning.processes import Cut, Leash
from rosa_pddl.planning.sums import Numbers
from rosa_pddl.problem import Problem
from rosa_pddl.validate import flaw, missing_at_start, schedule_flaw

__all__ = ["Settings", "Trial"]

_OVERLAP = "steps may overlap with Planner('aries', overlapping=True), pip install 'rosa-taca[temporal]'"
# Of several troubles, the first of these that was met is the outcome of all.
_TELLING_FIRST = (
    Outcome.OUT_OF_TIME,
    Outcome.OUT_OF_MEMORY,
    Outcome.ENGINE_CRASHED,
    Outcome.UNSUPPORTED,
    Outcome.ENGINE_MISSING,
)


@dataclass(frozen=True)
class Settings:
    """How to plan; the arguments are those of `Planner`, and the ways in order."""

    engine: str
    ways: tuple[str, ...]
    timeout_s: float
    budgets_s: Mapping[str, float]
    overlapping: bool
    memory_bytes: int


@dataclass(frozen=True)
class _Found:
    """What one way gave."""

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    schedule: tuple[TimedStep, ...] = ()
    why: str = ""


class Trial:
    """One planning.

    Args:
        settings: how.
        problem: what.
        grounding: the translated task of the domain, or what will be it; None if there is no warm way.
        leash: runs the programs.
        safe_step: what to do if there is no plan.
    """

    def __init__(
        self,
        settings: Settings,
        problem: Problem,
        grounding: Grounding | None,
        leash: Leash,
        safe_step: Step | None,
    ) -> None:
        self._settings, self._problem = settings, problem
        self._grounding, self._leash, self._safe_step = grounding, leash, safe_step

    def result(self) -> PlanningResult:
        """Try one way after the other until there is a plan, or none is possible.

        Raises:
            Cut: the leash was cut.
        """
        attempts: list[Attempt] = []
        for way, budget_s in self._budgeted():
            began = time.monotonic()
            found, message = self._tried(way, budget_s)
            attempts.append(Attempt(way, found.outcome, message, time.monotonic() - began))
            if found.outcome.is_solved or found.outcome is Outcome.UNSOLVABLE_PROVEN:
                return self._report(found, way, attempts)
        return self._report(_Found(_outcome_of(attempts)), self._settings.engine, attempts)

    def _budgeted(self) -> Iterator[tuple[str, float]]:
        """Yield each way with the wall-clock time that it may take [s]."""
        settings = self._settings
        deadline = time.monotonic() + settings.timeout_s
        # without a translation to wait for, what keeps the warm way keeps the cold one, which says so
        ways = [way for way in settings.ways if way != "warm" or self._grounding is not None]
        for number, way in enumerate(ways, start=1):
            left_s = max(deadline - time.monotonic(), 0.0)
            yield way, min(settings.budgets_s.get(way, left_s if number == len(ways) else left_s / 2), left_s)

    def _tried(self, way: str, budget_s: float) -> tuple[_Found, str]:
        """Return what a way gave, and what to say if that is no plan."""
        engine = self._engine_of(way)
        missed = missing(engine, self._problem.domain)
        if missed is not None:
            return _Found(Outcome.ENGINE_MISSING), missed
        if budget_s <= 0.0:
            return _Found(Outcome.OUT_OF_TIME), f"of {self._settings.timeout_s:g} s no time was left for it"
        try:
            found = self._found(way, time.monotonic() + budget_s)
            wrong = self._wrong(found)
        except Trouble as trouble:
            return _Found(trouble.outcome), trouble.message
        except UnsupportedPddlError as error:
            return _Found(Outcome.UNSUPPORTED), str(error)
        except Cut:
            raise
        except Exception as error:  # whatever goes wrong here must not stop the tree; it is told by name
            return _Found(Outcome.ENGINE_CRASHED), f"{type(error).__name__}: {error}"
        if wrong is not None:
            return _Found(Outcome.ENGINE_CRASHED), f"{engine} returned a plan that does not work: {wrong}"
        return found, ""

    def _engine_of(self, way: str) -> str:
        return self._settings.engine if way in ("warm", "cold") else way

    def _found(self, way: str, deadline: float) -> _Found:
        limited = ", ".join(resource.name for resource in self._problem.domain.limited)
        if limited and self._engine_of(way) in SEARCHES:
            message = f"Fast Downward keeps no limits (of {limited}); Planner({LABEL_SETTING!r}) does"
            raise Trouble(Outcome.UNSUPPORTED, message)
        if way == "warm":
            return self._warm(deadline)
        if way in ("cold", LABEL_SETTING):
            memory_bytes = self._settings.memory_bytes
            task = translated(self._problem, None, self._leash, _left_s(deadline), memory_bytes)
            return self._searched(task, deadline, self._engine_of(way))
        outcome, schedule = asked(
            way,
            self._problem,
            self._leash,
            limit_s=_left_s(deadline),
            memory_bytes=self._settings.memory_bytes,
            overlapping=self._settings.overlapping,
        )
        steps = tuple(timed.step for timed in schedule)
        return _Found(outcome, steps, schedule if self._settings.overlapping else ())

    def _warm(self, deadline: float) -> _Found:
        assert self._grounding is not None
        try:
            task = self._leash.wait(self._grounding, _left_s(deadline))
        except TimeoutError as error:
            message = f"the task of {self._problem.domain.name} was not translated in time; allow more or ask for less"
            raise Trouble(Outcome.OUT_OF_TIME, message) from error
        if isinstance(task, Trouble):
            raise Trouble(task.outcome, task.message)
        if not task.is_patchable:
            raise Trouble(Outcome.UNSUPPORTED, "the translated task has axioms, which hold for one state only")
        try:
            return self._searched(task, deadline, self._settings.engine)
        except NotRepresentableError as error:
            raise Trouble(Outcome.UNSUPPORTED, f"the translated task does not fit: {error}") from error

    def _searched(self, task: Grounded, deadline: float, engine: str) -> _Found:
        try:
            answer = self._answer(task, deadline, engine)
        except UnreachableGoalError:
            return _Found(Outcome.UNSOLVABLE_PROVEN)
        try:
            steps = tuple(task.step(number) for number in answer.numbers)
        except IndexError as error:
            raise Trouble(Outcome.ENGINE_CRASHED, "the search named steps that the task does not have") from error
        return _Found(answer.outcome, steps, why=answer.why)

    def _answer(self, task: Grounded, deadline: float, engine: str) -> Answer:
        leash, memory_bytes = self._leash, self._settings.memory_bytes
        if engine == LABEL_SETTING:
            limit_s = _left_s(deadline)
            return label_search(
                task, self._problem, self._sequence.uses, leash, limit_s=limit_s, memory_bytes=memory_bytes
            )
        patched = task.patched(self._problem, self._numbers)
        if patched.is_done:
            return Answer(Outcome.SOLVED_OPTIMALLY)
        return search(patched, engine, leash, limit_s=_left_s(deadline), memory_bytes=memory_bytes)

    def _wrong(self, found: _Found) -> str | None:
        if not found.outcome.is_solved:
            return None
        problem = self._problem
        if found.schedule:
            wrong = schedule_flaw(problem.domain, found.schedule, problem.state, problem.wanted)
        else:
            wrong = flaw(problem.domain, found.steps, problem.state, problem.wanted)
        if wrong is None and problem.domain.limited:
            wrong = self._sequence.uses.overspent(problem, found.steps)
        return wrong

    def _report(self, found: _Found, way: str, attempts: list[Attempt]) -> PlanningResult:
        engine, domain = self._engine_of(way), self._problem.domain
        if found.outcome.is_solved:
            cost = self._cost(found)
            return PlanningResult(found.outcome, found.steps, engine, "", cost, found.schedule, tuple(attempts))
        outcome, message = found.outcome, f"{engine}: {found.outcome}" + (f": {found.why}" if found.why else "")
        if outcome is Outcome.UNSOLVABLE_PROVEN and not self._settings.overlapping and _may_have_to_overlap(domain):
            outcome = Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
            message = f"{engine}: {outcome}: there is no plan of one step after the other; {_OVERLAP}"
        if outcome.is_trouble:
            message = "; ".join(
                f"{engine}, {attempt}" if engine != attempt.way else str(attempt) for attempt in attempts
            )
        safe = self._safe_step
        if safe is not None and missing_at_start(domain, safe, self._problem.state) is not None:
            safe = None
        return PlanningResult(outcome, (), engine, message, attempts=tuple(attempts), safe_step=safe)

    @property
    def _sequence(self) -> Instantaneous:
        return instantaneous(self._problem.domain)

    @cached_property
    def _numbers(self) -> Numbers:
        return self._sequence.costs.numbers(self._problem)

    def _cost(self, found: _Found) -> float | None:
        try:
            return self._sequence.costs.total(found.steps, self._numbers)
        except UnsupportedPddlError:
            return None


def _may_have_to_overlap(domain: Domain) -> bool:
    """Whether a step provides something only while it lasts, and others need that."""
    return any(
        start.fluent.fluent() in _needed(other)
        for schema in domain.schema_of.values()
        for start, end in product(schema.start_effects, schema.end_effects)
        if start.fluent == end.fluent and start.value.is_true() and end.value.is_false()
        for other in domain.schema_of.values()
        if other is not schema
    )


def _needed(schema: Schema) -> set[UpThing]:
    """Return the predicates that the conditions of an action mention."""
    left, found = [*schema.start, *schema.over_all, *schema.end], set()
    while left:
        formula = left.pop()
        left += formula.args
        if formula.is_fluent_exp():
            found.add(formula.fluent())
    return found


def _left_s(deadline: float) -> float:
    return max(deadline - time.monotonic(), 0.0)


def _outcome_of(attempts: list[Attempt]) -> Outcome:
    outcomes = [attempt.outcome for attempt in attempts]
    if Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN in outcomes:
        return Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
    return next(outcome for outcome in _TELLING_FIRST if outcome in outcomes)
