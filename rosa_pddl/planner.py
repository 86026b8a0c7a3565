"""The planner: the exact search, or else an engine; every result has a named outcome."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass, field, replace
from itertools import chain, combinations
from math import comb, inf

from rosa_pddl.domain import (
    Domain,
    PlannerSettingError,
    PlanningBudgetError,
    State,
    UnsupportedPddlError,
    names_in,
)
from rosa_pddl.engines import (
    DOWNWARD,
    KAIROS,
    OPTIMAL,
    Cancelled,
    EngineProcess,
    check_name,
    missing_package,
)
from rosa_pddl.grounding import UnsearchableError
from rosa_pddl.problem import (
    Outcome,
    PddlText,
    PlanningFailed,
    PlanningResult,
    Problem,
)
from rosa_pddl.search import CapReached, Grounded
from rosa_pddl.validate import TimedStep, flaw, plan_cost, takes_s

_LOG = logging.getLogger(__name__)

SEARCH = "search"
"""The strategy that is the exact search in this process."""

_MOVES_FOR_AN_OPERATION = 5
_MOST_DOMAINS = 8
_MOST_ENTRIES = 1 << 14


class Planner:
    """Plans with the exact search in this process and, beyond its cap, with engines.

    Every plan is replayed before it is returned.

    Args:
        engine: `fast-downward-opt` (a plan of least cost), `fast-downward` (any plan, soon),
            `kairos` (numbers, time, preferences), or a name of unified-planning's factory.
            Where Fast Downward has no notion of numbers or time, Kairos answers.
        timeout_s: wall-clock time for search and engine together [s]; an engine is killed then.
        overlapping: whether steps may overlap; the plan is a schedule, by Kairos.
        moves: how many moves the search in this process may look at; 0 to leave it out.

    Raises:
        PlannerSettingError: a setting that makes no sense, or an unknown engine.
    """

    def __init__(
        self,
        engine: str | None = None,
        timeout_s: float = 10.0,
        *,
        overlapping: bool = False,
        moves: int = 20_000,
    ) -> None:
        if engine is None:
            engine = KAIROS if overlapping else OPTIMAL
        self.engine = engine
        self.timeout_s = timeout_s
        self.overlapping = overlapping
        self.moves = moves
        wrong = check_name(engine)
        if overlapping and engine != KAIROS:
            wrong = f"{engine} plans one step after the other; overlapping steps are for 'kairos'"
        if wrong is not None:
            raise PlannerSettingError(wrong)
        if not (isinstance(timeout_s, int | float) and 0.0 < timeout_s < inf):
            message = f"timeout_s is {timeout_s!r}, expected seconds: more than 0, and finite"
            raise PlannerSettingError(message)
        self.process = EngineProcess()
        self.cancelled = set[threading.Event]()
        # by the caches of domains, which domains share that differ in numbers only
        self._grounded: dict[int, Grounded] = {}

    def missing(self) -> str | None:
        """Return what to install if the engine is missing, else None."""
        return missing_package(self.engine)

    def plan(self, problem: Problem) -> PlanningResult:
        """Plan now and wait for the answer; trouble is an outcome, never an exception."""
        return _Planning(self, problem).result()

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Plan in a new thread. Cancelling the future ends the engine."""
        future: Future[PlanningResult] = Future()
        planning = _Planning(self, problem)

        def work() -> None:
            result = planning.result()
            # not set to running before now, because a running future cannot be cancelled
            if future.set_running_or_notify_cancel():
                future.set_result(result)

        future.add_done_callback(lambda _: planning.cancelled.set())
        threading.Thread(target=work, name=f"planner {self.engine}", daemon=True).start()
        return future

    def close(self) -> None:
        """End all plannings and the process of the engines."""
        for cancelled in tuple(self.cancelled):
            cancelled.set()
        self.process.close()

    def ground(self, domain: Domain, state: State, go_on: Callable[[int], None]) -> Grounded:
        """Return grounded steps that cover a state, made now if need be.

        They cover all feasibility facts, and other atoms as soon as a question had them. So what
        they cover depends on the questions before, never on how long anything takes.
        """
        task = self._grounded.get(id(domain.cache))
        if task is None or not task.covers(state):
            before = self._grounded.pop(id(domain.cache), None)
            base = state.union(domain.feasibility, before.base if before else ())
            task = Grounded(domain, base, go_on)
            if len(self._grounded) >= _MOST_DOMAINS:
                self._grounded.clear()
            self._grounded[id(domain.cache)] = task
        return task


def wait_for_plan(future: "Future[PlanningResult]", budget_s: float) -> PlanningResult:
    """Wait for an answer that is due, in lock-step simulation; call it between ticks.

    Args:
        future: what `Planner.start` returned.
        budget_s: longest wall-clock time to wait [s]; then the planning is cancelled.

    Raises:
        PlanningBudgetError: the answer was not there in time, or the planner ran out of wall-clock
            time, so that a faster machine might have given another answer.
    """
    depends = "would make the run depend on the machine"
    if not wait([future], timeout=budget_s).done:
        future.cancel()
        message = f"no plan after {budget_s:g} s of waiting, and going on without {depends}"
        raise PlanningBudgetError(f"{message}; allow more time or ask for less")
    result = future.result()
    if result.outcome is Outcome.OUT_OF_TIME:
        message = f"planning ran out of wall-clock time, and going on {depends}"
        raise PlanningBudgetError(f"{message}: {result.message}")
    return result


class _Planning:
    """One planning: by the search, or else by an engine."""

    def __init__(self, planner: Planner, problem: Problem) -> None:
        self._planner = planner
        self._problem = problem
        self._domain = problem.domain.with_numbers(problem.costs)
        self.cancelled = threading.Event()
        planner.cancelled.add(self.cancelled)

    def result(self) -> PlanningResult:
        """Ask the search for at most half of the time, and the engine if it gives up."""
        timeout_s = self._planner.timeout_s
        began_s = time.monotonic()
        try:
            found = self._try(SEARCH, began_s + timeout_s / 2) if self._may_search else None
            if found is None or found.outcome is Outcome.UNSUPPORTED:
                # where a number has no value, Kairos leaves out the steps that need it
                engine = KAIROS if found else self._main_engine
                answer = self._try(engine, began_s + timeout_s)
                if self.cancelled.is_set():  # so the engine was killed while it was asked
                    raise Cancelled
                if found is None or (answer and answer.outcome.is_solved):
                    return self._report(answer or PlanningResult(Outcome.OUT_OF_TIME), engine)
            return self._report(found, SEARCH)
        except Cancelled:
            engine = self._planner.engine
            return PlanningResult(Outcome.ENGINE_CRASHED, (), engine, "the planner was closed")
        finally:
            self._planner.cancelled.discard(self.cancelled)

    # ------------------------------------------------------------ strategies

    @property
    def _may_search(self) -> bool:
        """Whether the search in this process may answer."""
        planner = self._planner
        problem = self._problem
        is_plain = not (problem.soft or problem.until or planner.overlapping)
        return is_plain and planner.engine == OPTIMAL and planner.moves > 0

    @property
    def _main_engine(self) -> str:
        """The engine that plans beyond the search: Fast Downward only without numbers and time."""
        engine = self._planner.engine
        problem = self._problem
        if engine not in DOWNWARD:
            return engine
        if self._domain.only_planned or problem.soft or problem.until:
            return KAIROS
        try:
            problem.write("costs")
        except UnsearchableError:
            return KAIROS
        return engine

    def _try(self, strategy: str, deadline: float) -> PlanningResult | None:
        """Return the answer of a strategy; None if the search gave up, as engines will do."""
        try:
            is_search = strategy == SEARCH
            answer = self._search(deadline) if is_search else self._ask(strategy, deadline)
            return self._checked(strategy, answer)
        except Cancelled:
            raise
        except CapReached:
            return None
        except PlanningFailed as failure:
            return PlanningResult(failure.outcome, message=str(failure))
        except UnsearchableError as error:
            if strategy == SEARCH:
                return None
            return PlanningResult(Outcome.UNSUPPORTED, message=f"{error} ({self._domain.file})")
        except UnsupportedPddlError as error:
            return PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        except Exception as error:  # no error here may stop the tree; it is reported by name
            if strategy == SEARCH:
                _LOG.exception("the search failed, so an engine is asked")
                return None
            message = f"{type(error).__name__}: {error}"
            return PlanningResult(Outcome.ENGINE_CRASHED, message=message)

    def _ask(self, engine: str, deadline: float) -> PlanningResult:
        """Ask an engine for a plan."""
        domain = self._domain
        missing = missing_package(engine)
        if missing is not None:
            raise PlanningFailed(Outcome.ENGINE_MISSING, missing)
        text = self._text(engine)
        left_s = deadline - time.monotonic()
        outcome, plan = self._planner.process.ask(engine, text, self.cancelled, left_s)
        timed = list[TimedStep]()
        for name, arguments, *times in plan:
            timed.append(TimedStep(text.step(domain, name, arguments), *(times or (0.0, 0.0))))
        is_schedule = self._planner.overlapping or domain.only_planned
        steps = tuple(each.step for each in timed)
        return PlanningResult(outcome, steps, schedule=tuple(timed) if is_schedule else ())

    def _text(self, engine: str) -> PddlText:
        domain = self._domain
        problem = self._problem
        if self._planner.overlapping:
            return problem.write("overlapping")
        if engine in DOWNWARD:
            return problem.write("costs")
        if problem.until or "total-time" in names_in([domain.metric]):
            return problem.write("timed")
        has_numbers = engine == KAIROS or domain.computed or domain.compared
        try:
            return problem.write("instant" if has_numbers else "costs")
        except UnsearchableError:
            return problem.write("timed")

    # ------------------------------------------------------------ the search

    def _search(self, deadline: float) -> PlanningResult:
        """Search; raise CapReached where an engine is quicker."""
        moves = self._planner.moves

        def go_on(instances: int = 0) -> None:
            if self.cancelled.is_set():
                raise Cancelled
            if instances > moves or time.monotonic() > deadline:
                raise CapReached

        task = self._planner.ground(self._domain, self._problem.state, go_on)
        # putting numbers into many operations takes longer than an engine
        go_on(len(task.steps) * _MOVES_FOR_AN_OPERATION)
        steps = task.plan(self._problem, moves, go_on)
        if steps is None:
            return PlanningResult(Outcome.UNSOLVABLE_PROVEN)
        return PlanningResult(Outcome.SOLVED_OPTIMALLY, steps)

    # ------------------------------------------------------------ checks and reports

    def _checked(self, strategy: str, answer: PlanningResult) -> PlanningResult:
        """Replay a plan; raise PlanningFailed if it does not work."""
        if not answer.outcome.is_solved or self._domain.only_planned:
            return answer
        problem = self._problem
        plan = answer.schedule or answer.steps
        domain = self._domain
        passed_s = 0.0  # of a first step that is running already
        for step in answer.steps[:1]:
            whole_s = takes_s(domain, step, problem.state, problem.costs)
            passed_s = whole_s * (1.0 - problem.shares.get(step, 1.0))
        until = {atom: left_s + passed_s for atom, left_s in problem.until.items()}
        wrong = flaw(domain, plan, problem.state, problem.wanted, until, problem.costs)
        if wrong is not None:
            message = f"{strategy} returned a plan that does not work: {wrong}"
            raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
        return answer

    def _report(self, answer: PlanningResult, strategy: str) -> PlanningResult:
        domain = self._domain
        problem = self._problem
        outcome = answer.outcome
        if outcome.is_solved:
            cost = None
            if not domain.only_planned:
                cost = plan_cost(domain, answer.steps, problem.state, problem.costs)
            return replace(answer, engine=strategy, cost=cost, message="")
        note = f" ({answer.message})" if outcome.is_trouble else ""
        if outcome is Outcome.UNSOLVABLE_PROVEN:
            if not self._planner.overlapping and _may_have_to_overlap(domain):
                note = ": there is no plan of one step after the other"
                note += "; steps may overlap with Planner(overlapping=True)"
            if 0 in problem.weights.values():
                note = ": there is no plan without the steps that are left out"
            if note:
                outcome = Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
        if outcome is Outcome.OUT_OF_TIME:
            note += "; another engine may be quicker: 'fast-downward' (any plan) or 'kairos'"
        return PlanningResult(outcome, (), strategy, f"{strategy}: {outcome}{note}")


def _may_have_to_overlap(domain: Domain) -> bool:
    """Whether an action makes something true only while it runs, and another needs that."""
    for schema in domain.schema_of.values():
        ends = {effect.name for effect in schema.end_effects if effect.kind == "delete"}
        lent = {effect.name for effect in schema.start_effects if effect.kind == "add"} & ends
        for other in domain.schema_of.values():
            if other is not schema and not lent.isdisjoint(names_in(other.conditions)):
                return True
    return False


# ---------------------------------------------------------------- certificates


@dataclass(frozen=True)
class Certificate:
    """The planner's answer for each combination of unfeasible actions, small combinations first.

    Args:
        entries: the answers by the names of the unfeasible ROSA actions, in the domain's order.
        causes: the answers by single causes, such as `camera fails`.
    """

    entries: Mapping[tuple[str, ...], PlanningResult]
    causes: Mapping[str, PlanningResult] = field(default_factory=dict)

    @property
    def fatal(self) -> tuple[str, ...]:
        """The actions and causes each of which alone makes a possible mission impossible."""
        if not self.entries[()].outcome.is_solved:
            return ()
        alone = {names[0]: each for names, each in self.entries.items() if len(names) == 1}
        alone |= self.causes
        return tuple(name for name, result in alone.items() if result.outcome.is_unsolvable)


def certificate(
    domain: Domain,
    supposing: Callable[[Iterable[str]], Problem],
    planner: Planner,
    failures: int | None = None,
) -> Certificate:
    """Plan for every combination of unfeasible actions.

    Args:
        domain: what `load_domain` returned.
        supposing: returns the problem in which exactly these ROSA actions are unfeasible.
        planner: makes the plans.
        failures: the largest number of unfeasible actions in a combination; None for all.

    Raises:
        PlannerSettingError: there are too many combinations.
    """
    actions = domain.rosa_actions
    most = len(actions) if failures is None else max(failures, 0)
    total = sum(comb(len(actions), count) for count in range(most + 1))
    if total > _MOST_ENTRIES:
        message = f"{total} combinations of {len(actions)} actions are too many"
        advice = "look at fewer failures at once, such as failures=2"
        raise PlannerSettingError(f"{message} (at most {_MOST_ENTRIES}); {advice}")
    chosen = chain.from_iterable(combinations(actions, count) for count in range(most + 1))
    return Certificate({names: planner.plan(supposing(names)) for names in chosen})
