"""The planner: tries several ways in order, each with its own time budget; every result has a named outcome."""

import json
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, chain, combinations, product
from math import comb, inf
from pathlib import Path

from rosa_pddl import search
from rosa_pddl.domain import Attempt, Domain, Outcome, PlanningResult, Step, Trouble, fluents_in
from rosa_pddl.engines import (
    LABEL_SETTING,
    NUMERIC,
    SEARCHES,
    TRANSLATED,
    asked,
    fast_downward,
    missing,
)
from rosa_pddl.engines.processes import Cancelled, ProcessHandle
from rosa_pddl.exceptions import (
    PlannerSettingError,
    PlanningBudgetError,
    UnknownNameError,
    UnsupportedPddlError,
    nearest,
)
from rosa_pddl.grounding import Grounded, Groundings
from rosa_pddl.instances import is_out_of_reach
from rosa_pddl.problem import Problem, lock_of
from rosa_pddl.resource_usage import Numbers, usage_of
from rosa_pddl.validate import flaw, missing_at_start, schedule_flaw

# Within a tick, the search looks at most at this many moves, in tasks with no more operators; some milliseconds.
_MOVES_IN_A_TICK = 1000
_MOVES_FOR_AN_OPERATOR = 5
# The cache holds at most this many atoms in all, as a state of a large domain has tens of thousands.
_MOST_ATOMS = 1_000_000
_EXACT = ("fast-downward-opt", LABEL_SETTING)
# Time limit for grounding a task in the background, before it is asked for [s].
_PREPARED_S = 60.0
_MOST_ENTRIES = 1 << 14
CERTIFIED = "certificate"
"""The way of an answer that a certificate gives, made before the mission."""
_OVERLAP = (
    "steps may overlap with Planner('aries', overlapping=True), pip install 'rosa-taca[temporal]'"
)


@dataclass(frozen=True)
class Certificate:
    """The planner's answer for each combination of unfeasible actions, small combinations first.

    Args:
        entries: the answers by the names of the unfeasible ROSA actions, in the domain's order; others are feasible.
    """

    entries: dict[tuple[str, ...], PlanningResult]

    @classmethod
    def load(cls, path: str | Path, domain: Domain) -> "Certificate":
        """Read a file of `rosa plan --certificate --json`; PlannerSettingError if it does not fit the domain."""
        try:
            entries = dict[tuple[str, ...], PlanningResult]()
            for one in json.loads(Path(path).read_text())["entries"]:
                steps = tuple(
                    domain.step(step["action"], step["arguments"]) for step in one["steps"]
                )
                result = PlanningResult(
                    Outcome(one["outcome"]), steps, one["engine"], cost=one["cost"]
                )
                entries[tuple(one["unfeasible"])] = result
            return cls(entries)
        except (OSError, ValueError, KeyError, TypeError) as error:
            message = f"{path} is no certificate of {domain.file} ({type(error).__name__}: {error})"
            raise PlannerSettingError(
                f"{message}; write one with rosa plan --certificate --json"
            ) from error

    def prepared(self, problem: Problem) -> PlanningResult | None:
        """Return the plan for the unfeasible actions of a problem, or its shortest end that works; None if none does.

        If none works, actions that are forecast to become unfeasible count as unfeasible already.
        """
        domain, state, until = problem.domain, problem.state, problem.until
        left_out = {step for step, times in problem.weights.items() if not times}
        for lasting in (state, state - until.keys()) if until else (state,):
            actions = tuple(one for atom, one in domain.feasibility.items() if atom not in lasting)
            found = self.entries.get(actions, PlanningResult(Outcome.UNSUPPORTED))
            for count in range(1, 1 + len(found.steps)):
                rest = found.steps[-count:]
                if (
                    left_out.isdisjoint(rest)
                    and flaw(domain, rest, state, problem.wanted, until) is None
                ):
                    return replace(found, outcome=Outcome.SOLVED, steps=rest, schedule=())
        return None

    @property
    def fatal(self) -> tuple[str, ...]:
        """The actions each of which, unfeasible alone, makes a mission impossible that is possible otherwise."""
        if not self.entries[()].outcome.is_solved:
            return ()
        alone = {out[0]: result.outcome for out, result in self.entries.items() if len(out) == 1}
        return tuple(action for action, outcome in alone.items() if outcome.is_unsolvable)


class Planner:
    """Plans with the exact search in this process and, beyond the cap of that, with Fast Downward and other engines.

    docs/planning.md says what is tried in which order. `fast-downward-opt` and `label-setting` give a plan of least
    cost, or with the fewest steps if there is no metric; `fast-downward` gives any plan, and is faster on large tasks.
    Every plan is replayed before it is returned.

    Args:
        engine: `fast-downward-opt`, `fast-downward`, `label-setting`, or a name of unified-planning's factory, such as
            `aries`.
        timeout_s: wall-clock time for all ways together [s]; an engine that still runs then is killed. Each way may
            take half of the time that is left, the last way all of it, unless `budgets_s` says otherwise.
        fallback: engines of unified-planning to try afterwards; those that are not installed are skipped.
        budgets_s: wall-clock time limits of single ways [s], by their names.
        overlapping: whether steps may overlap: the engine gets durations, and the plan is a schedule. The engine must
            be a temporal engine of unified-planning, such as `aries`.
        safe_step: the step to do while there is no plan, such as `(surface)`.
        warm: whether to try first with the task as it was translated before.
        moves: how many moves the search in this process may look at; 0 to plan with other programs only.
        memory_mb: how much data each program may hold [MB].
        cached: how many answers are remembered, fewer if states are large; a full cache is emptied. 0 for none.
        certificate: plans made before the mission. `start` answers at once with such a plan, or an end of one, if it
            works; an executor takes it in the tick of the request.

    Raises:
        PlannerSettingError: a setting that makes no sense.
    """

    def __init__(
        self,
        engine: str = "fast-downward-opt",
        timeout_s: float = 10.0,
        *,
        fallback: Sequence[str] = (),
        budgets_s: Mapping[str, float] | None = None,
        overlapping: bool = False,
        safe_step: str | None = None,
        warm: bool = True,
        moves: int = 50_000,
        memory_mb: int = 4096,
        cached: int = 256,
        certificate: Certificate | None = None,
    ) -> None:
        own = (("warm",) if warm else ()) + ("cold",) if engine in TRANSLATED else (engine,)
        self.engine, self.ways, self.timeout_s = engine, (*own, *fallback), timeout_s
        self.budgets_s, self.overlapping, self.safe_step = (
            dict(budgets_s or {}),
            overlapping,
            safe_step,
        )
        self.moves, self.memory_bytes, self.certificate = moves, memory_mb << 20, certificate
        self._check()
        self.groundings = Groundings()
        self.cache: dict[Hashable, PlanningResult] = {}
        self.cached = cached
        self.processes: set[ProcessHandle] = set()

    def _check(self) -> None:
        sequential = [name for name in (self.engine, *self.ways) if name in TRANSLATED]
        if self.overlapping and sequential:
            message = f"{sequential[0]} plans one step after the other; for overlapping steps use a temporal engine"
            raise PlannerSettingError(
                f"{message} such as 'aries' (pip install 'rosa-taca[temporal]')"
            )
        for way in self.budgets_s:
            if way not in self.ways:
                hint = nearest(way, self.ways)
                raise PlannerSettingError(
                    f"a budget is given for {way!r}, which is not among what is tried; {hint}"
                )
        if not 0.0 < self.timeout_s < inf:
            raise PlannerSettingError(
                f"timeout_s is {self.timeout_s:g}, expected more than 0, and finite"
            )

    def missing(self, domain: Domain) -> str | None:
        """Return what to install if the engine is missing, else None; asked before a mission begins."""
        return missing(self.engine, domain)

    def prepare(self, problem: Problem, changing: Iterable[str] = ()) -> None:
        """Start to translate the task in the background; otherwise the first planning does it.

        Args:
            problem: the problem in the state in which the mission begins.
            changing: atoms that may change although no action changes them, such as those that are sensed.

        Raises:
            UnknownNameError: the domain does not have an atom.
        """
        if "warm" not in self.ways or self.missing(problem.domain) is not None:
            return
        named, process = [problem.domain.atom(text) for text in changing], ProcessHandle()
        self.processes.add(process)

        def work() -> None:
            with suppress(Cancelled, Trouble, UnsupportedPddlError):  # planning reports it
                self.groundings.ask(problem, process, _PREPARED_S, named)
            self.processes.discard(process)

        threading.Thread(
            target=work, name=f"grounding of {problem.domain.name}", daemon=True
        ).start()

    def prepared(self, problem: Problem) -> PlanningResult | None:
        """Return the certificate's plan for a problem, or an end of it, if that works, else None. Never waits."""
        found = None if self.certificate is None else self.certificate.prepared(problem)
        return None if found is None else _Portfolio(self, problem).confirmed(found)

    def plan(self, problem: Problem) -> PlanningResult:
        """Plan now and wait for the answer; trouble with an engine is an outcome, never an exception."""
        return _Portfolio(self, problem).result()

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Plan in a new thread, or at once if that fits into a tick. Cancelling the future kills the engine."""
        future: Future[PlanningResult] = Future()
        portfolio = _Portfolio(self, problem)
        at_once = self.prepared(problem) or portfolio.at_once()
        if at_once is not None:
            future.set_result(at_once)
            return future
        future.add_done_callback(
            lambda done: portfolio.process.cancel() if done.cancelled() else None
        )

        def work() -> None:
            result = portfolio.result()
            # not set to running before now, because a running future cannot be cancelled
            if future.set_running_or_notify_cancel():
                future.set_result(result)

        threading.Thread(target=work, name=f"planner {self.engine}", daemon=True).start()
        return future

    def close(self) -> None:
        """End all programs that still run for this planner, and forget the translated tasks."""
        for process in tuple(self.processes):
            process.cancel()
        self.groundings.close()


def awaited(future: "Future[PlanningResult]", budget_s: float) -> PlanningResult:
    """Wait for an answer that is due, in lock-step simulation; call it between ticks, as a tick never waits.

    Args:
        future: what `Planner.start` returned.
        budget_s: longest wall-clock time to wait [s]; then the planning is cancelled.

    Raises:
        PlanningBudgetError: the answer was not there in time, or an attempt ran out of wall-clock time, so that a
            faster machine might have given another answer.
    """
    finished, _ = wait([future], timeout=budget_s)
    if not finished:
        future.cancel()
        raise PlanningBudgetError(
            f"no plan after {budget_s:g} s of waiting, and going on without would make the run depend on the machine; "
            "allow more time or ask for less"
        )
    result = future.result()
    if result.hangs_on_the_clock:
        tried = "; ".join(str(attempt) for attempt in result.attempts) or result.message
        raise PlanningBudgetError(
            f"planning ran out of wall-clock time, and going on would make the run depend on the machine: {tried}"
        )
    return result


def certificate(
    domain: Domain,
    supposing: Callable[[Iterable[str]], Problem],
    planner: Planner,
    failures: int | None = None,
) -> Certificate:
    """Plan for every combination of unfeasible actions, to find out with which of them the goal can be reached.

    Args:
        domain: what `load_domain` returned.
        supposing: returns the problem in which exactly these ROSA actions are unfeasible.
        planner: makes the plans; a warm one answers most requests within a millisecond.
        failures: the largest number of unfeasible actions in a combination; None for all.

    Raises:
        PlannerSettingError: `failures` is out of range, or there are too many combinations.
    """
    actions = domain.rosa_actions
    most = len(actions) if failures is None else failures
    if not 0 <= most <= len(actions):
        raise PlannerSettingError(
            f"failures is {most}, expected 0 to {len(actions)}, as so many actions there are"
        )
    total = sum(comb(len(actions), count) for count in range(most + 1))
    if total > _MOST_ENTRIES:
        message = (
            f"{total} combinations of {len(actions)} actions are too many (at most {_MOST_ENTRIES})"
        )
        raise PlannerSettingError(f"{message}; look at fewer failures at once, such as failures=2")
    chosen = chain.from_iterable(combinations(actions, count) for count in range(most + 1))
    return Certificate({out: planner.plan(supposing(out)) for out in chosen})


class _Portfolio:
    """One planning: tries the ways in order, each within its budget, and reports on all of them."""

    def __init__(self, planner: Planner, problem: Problem) -> None:
        self._planner, self._problem = planner, problem
        self._safe_step = (
            None if planner.safe_step is None else _step(problem.domain, planner.safe_step)
        )
        self.process = ProcessHandle(planner.memory_bytes)

    def at_once(self) -> PlanningResult | None:
        """Return the answer if it is known or can be found within a tick, else None."""
        known = self._remembered()
        if known is not None:
            return known
        if (
            "warm" not in self._planner.ways
            or self._planner.engine not in _EXACT
            or not self._planner.moves
        ):
            return None
        try:
            task = self._planner.groundings.made(self._problem)
            if task is None or task.size * task.work > _MOVES_IN_A_TICK:
                return None
            answer = self._checked("warm", self._exact(task, _MOVES_IN_A_TICK))
        except Exception:  # `result` meets the same error and reports it
            return None
        return self._kept(self._report(answer, "warm", [Attempt("warm", answer.outcome)]))

    def confirmed(self, prepared: PlanningResult) -> PlanningResult | None:
        """Return a plan that was made before, if it works and keeps all limits, else None."""
        try:
            answer = self._checked(CERTIFIED, prepared)
        except (Trouble, UnsupportedPddlError):
            return None
        return self._report(answer, CERTIFIED, [Attempt(CERTIFIED, answer.outcome)])

    def result(self) -> PlanningResult:
        """Try one way after the other until there is a plan, or a proof that there is none."""
        known = self._remembered()
        if known is not None:
            return known
        self._planner.processes.add(self.process)
        try:
            return self._kept(self._tried_in_order())
        except Cancelled:
            return PlanningResult(
                Outcome.ENGINE_CRASHED, (), self._planner.engine, "the planner was closed"
            )
        finally:
            self._planner.processes.discard(self.process)

    def _remembered(self) -> PlanningResult | None:
        known = self._planner.cache.get(self._key)
        return (
            None if known is None else replace(known, attempts=(Attempt("cache", known.outcome),))
        )

    def _kept(self, result: PlanningResult) -> PlanningResult:
        if not result.outcome.is_trouble and not result.hangs_on_the_clock:
            cache, size = (
                self._planner.cache,
                1 + len(self._problem.state) + len(self._problem.costs),
            )
            most = min(self._planner.cached, _MOST_ATOMS // size)
            if len(cache) >= most:
                cache.clear()
            if most:
                cache[self._key] = result
        return result

    @cached_property
    def _key(self) -> Hashable:
        problem = self._problem
        given = (problem.costs, problem.weights, problem.until, problem.shares)
        return (
            problem.domain,
            problem.state,
            problem.wanted,
            *(frozenset(one.items()) for one in given),
        )

    def _tried_in_order(self) -> PlanningResult:
        attempts: list[Attempt] = []
        for way, budget_s in self._budgeted():
            answer = self._tried(way, budget_s)
            attempts.append(
                Attempt(way, answer.outcome, answer.message if answer.outcome.is_trouble else "")
            )
            if answer.outcome.is_solved or answer.outcome is Outcome.UNSOLVABLE_PROVEN:
                return self._report(answer, way, attempts)
        outcomes = [attempt.outcome for attempt in attempts]
        worst = next(outcome for outcome in Outcome if outcome in outcomes)
        return self._report(PlanningResult(worst), self._planner.engine, attempts)

    def _budgeted(self) -> Iterator[tuple[str, float]]:
        """Yield each way with the wall-clock time that it may take [s]."""
        settings = self._planner
        deadline = time.monotonic() + settings.timeout_s
        ways = list(settings.ways)
        if (
            self._problem.domain.computed and settings.engine in TRANSLATED
        ):  # 'cold' would reach the same cap
            ways = [ways[0], NUMERIC, *(way for way in ways[1:] if way not in ("cold", NUMERIC))]
        for number, way in enumerate(ways, start=1):
            left_s = _left_s(deadline)
            yield (
                way,
                min(
                    settings.budgets_s.get(way, left_s if number == len(ways) else left_s / 2),
                    left_s,
                ),
            )

    def _tried(self, way: str, budget_s: float) -> PlanningResult:
        try:
            missed = missing(self._engine_of(way), self._problem.domain)
            if missed is not None:
                raise Trouble(Outcome.ENGINE_MISSING, missed)
            if budget_s <= 0.0:
                raise Trouble(
                    Outcome.OUT_OF_TIME, f"of {self._planner.timeout_s:g} s no time was left for it"
                )
            return self._checked(way, self._answer(way, time.monotonic() + budget_s))
        except Cancelled:
            raise
        except Trouble as trouble:
            return PlanningResult(trouble.outcome, message=str(trouble))
        except UnsupportedPddlError as error:
            return PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        except Exception as error:  # no error here may stop the tree; it is reported by name
            return PlanningResult(
                Outcome.ENGINE_CRASHED, message=f"{type(error).__name__}: {error}"
            )

    def _engine_of(self, way: str) -> str:
        return self._planner.engine if way in ("warm", "cold") else way

    def _answer(self, way: str, deadline: float) -> PlanningResult:
        limited = ", ".join(self._problem.domain.limited)
        if limited and self._engine_of(way) in SEARCHES:
            message = (
                f"Fast Downward keeps no limits (of {limited}); Planner({LABEL_SETTING!r}) does"
            )
            raise Trouble(Outcome.UNSUPPORTED, message)
        if way in ("warm", "cold", LABEL_SETTING):
            groundings = self._planner.groundings if way == "warm" else Groundings()
            task = groundings.ask(self._problem, self.process, _left_s(deadline))
            return self._searched(task, deadline, self._engine_of(way))
        if self._problem.domain.axioms:
            names = ", ".join(self._problem.domain.axioms)
            message = (
                f"{names} is derived, which {way} does not know; Planner('fast-downward-opt') does"
            )
            raise Trouble(Outcome.UNSUPPORTED, message)
        overlapping = self._planner.overlapping
        if overlapping:
            with lock_of(self._problem.domain):
                if is_out_of_reach(self._problem.domain, self._problem.state, self._problem.wanted):
                    message = "not even if nothing that was made so were ever undone"
                    return PlanningResult(Outcome.UNSOLVABLE_PROVEN, message=message)
        return asked(
            way, self._problem, self.process, limit_s=_left_s(deadline), overlapping=overlapping
        )

    def _searched(self, task: Grounded, deadline: float, engine: str) -> PlanningResult:
        try:
            if self._is_searched_here(task, engine):
                with suppress(search.CapReached):
                    return self._exact(task, self._planner.moves)
            if engine == LABEL_SETTING:
                return self._exact_elsewhere(task, deadline)
            return self._by_fast_downward(task, deadline, engine)
        except search.NegativeCostError:
            message = "a step costs less than nothing in some state; costs are 0 or more"
            raise Trouble(Outcome.UNSUPPORTED, message) from None

    def _is_searched_here(self, task: Grounded, engine: str) -> bool:
        # putting numbers into many operators may take longer than starting another program
        is_small = (
            engine == LABEL_SETTING or task.size * _MOVES_FOR_AN_OPERATOR <= self._planner.moves
        )
        return (
            (engine in _EXACT or bool(self._problem.until)) and is_small and self._planner.moves > 0
        )

    def _exact(self, grounded: Grounded, cap: int) -> PlanningResult:
        graph, task = grounded.search_task(self._problem, self._numbers)
        found = graph.plan(task.start, task.limits, cap // grounded.work)
        if found is None:
            return PlanningResult(Outcome.UNSOLVABLE_PROVEN)
        return PlanningResult(
            Outcome.SOLVED_OPTIMALLY, tuple([grounded.step(move.what) for move in found.moves])
        )

    def _exact_elsewhere(self, grounded: Grounded, deadline: float) -> PlanningResult:
        """Search in a separate process, which delays no tick and can be killed; forecasts are left out."""
        _, task = grounded.search_task(replace(self._problem, until={}), self._numbers)
        if task.start.numbers or task.goal.tests:
            message = (
                f"with numbers that rise and fall it looks at {self._planner.moves} moves only"
            )
            raise Trouble(Outcome.UNSUPPORTED, message)
        command = [sys.executable, "-I", "-S", search.__file__]
        ended = self.process.ask(command, given=search.written(task), limit_s=_left_s(deadline))
        kind, *numbers = ended.output.decode(errors="replace").split() or [""]
        if kind == "plan":
            return PlanningResult(
                Outcome.SOLVED_OPTIMALLY, tuple([grounded.step(int(number)) for number in numbers])
            )
        if kind == "none":
            return PlanningResult(Outcome.UNSOLVABLE_PROVEN)
        if MemoryError.__name__ in ended.last_words:
            raise Trouble(
                Outcome.OUT_OF_MEMORY, "the search ran out of memory; allow more or ask for less"
            )
        message = f"the search ended with exit code {ended.code} and no answer. It said: {ended.last_words}"
        raise Trouble(Outcome.ENGINE_CRASHED, message)

    def _by_fast_downward(self, grounded: Grounded, deadline: float, engine: str) -> PlanningResult:
        written = grounded.written(self._problem, self._numbers)
        if written is None:
            return PlanningResult(Outcome.SOLVED_OPTIMALLY)
        text, estimate, lost = written
        is_optimal = engine == "fast-downward-opt"
        # silent, as each line of output would wake this process up
        how = f"astar({estimate}()" if is_optimal else "lazy_greedy([ff()], preferred=[ff()]"
        strategy = f"{how}, verbosity=silent)"
        found = fast_downward(text, strategy, self.process, limit_s=_left_s(deadline))
        if isinstance(found, Outcome):
            return PlanningResult(found)
        steps = tuple([grounded.step(number) for number in found])
        if is_optimal and lost:  # the plan is optimal for the rounded costs only
            message = f"within {float(len(steps) * lost):.3g} of the least cost, as costs too far apart were rounded"
            return PlanningResult(Outcome.SOLVED, steps, message=message)
        return PlanningResult(Outcome.SOLVED_OPTIMALLY if is_optimal else Outcome.SOLVED, steps)

    def _checked(self, way: str, answer: PlanningResult) -> PlanningResult:
        """Replay a plan; raise Trouble if it does not work."""
        if not answer.outcome.is_solved:
            return answer
        problem, usage = self._problem, usage_of(self._problem.domain)
        wrong = self._flaw(answer, {}) or usage.overspent(
            problem.costs, answer.steps, problem.state
        )
        if wrong is not None:
            message = f"{self._engine_of(way)} returned a plan that does not work: {wrong}"
            raise Trouble(Outcome.ENGINE_CRASHED, message)
        late = self._flaw(answer, problem.until) if problem.until else None
        if late is not None:
            message = f"what is forecast was not planned with, and {late}; allow more moves, or make the task smaller"
            raise Trouble(Outcome.UNSUPPORTED, message)
        return answer

    def _flaw(self, answer: PlanningResult, until: Mapping[str, float]) -> str | None:
        problem, steps, usage = self._problem, answer.steps, usage_of(self._problem.domain)
        if answer.schedule:
            return schedule_flaw(
                problem.domain, answer.schedule, problem.state, problem.wanted, until
            )
        in_turn = usage.in_turn(problem.costs, problem.state, steps) if until else ()
        takes = [float(usage.takes_s(step, numbers)) for step, numbers in in_turn]
        takes[:1] = [
            takes_s * problem.shares.get(step, 1.0)
            for takes_s, step in zip(takes[:1], steps, strict=False)
        ]
        return flaw(
            problem.domain, steps, problem.state, problem.wanted, until, tuple(accumulate(takes))
        )

    def _report(self, answer: PlanningResult, way: str, attempts: list[Attempt]) -> PlanningResult:
        engine, domain, outcome = self._engine_of(way), self._problem.domain, answer.outcome
        if outcome.is_solved:
            cost = self._cost(answer.steps)
            return replace(answer, engine=engine, cost=cost, attempts=tuple(attempts))
        message = f"{engine}: {outcome}" + (f": {answer.message}" if answer.message else "")
        if (
            outcome is Outcome.UNSOLVABLE_PROVEN
            and not self._planner.overlapping
            and _may_have_to_overlap(domain)
        ):
            outcome = Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
            message = (
                f"{engine}: {outcome}: there is no plan of one step after the other; {_OVERLAP}"
            )
        if outcome.is_trouble:
            message = "; ".join(
                f"{engine}, {one}" if engine != one.way else str(one) for one in attempts
            )
        safe = self._safe_step
        if safe is not None and missing_at_start(domain, safe, self._problem.state) is not None:
            safe = None
        return PlanningResult(
            outcome, (), engine, message, attempts=tuple(attempts), safe_step=safe
        )

    def _cost(self, steps: Sequence[Step]) -> float | None:
        problem, usage = self._problem, usage_of(self._problem.domain)
        try:
            in_turn = usage.in_turn(problem.costs, problem.state, steps)
            return float(
                sum(usage.value(usage.cost_of(step), numbers) for step, numbers in in_turn)
            )
        except UnsupportedPddlError:
            return None

    @cached_property
    def _numbers(self) -> Numbers:
        return usage_of(self._problem.domain).numbers(self._problem.costs, self._problem.state)


def _may_have_to_overlap(domain: Domain) -> bool:
    """Whether an action makes something true only while it runs, and another action needs that."""
    return any(
        start.fluent.fluent() in fluents_in((*other.start, *other.over_all, *other.end))
        for schema in domain.schema_of.values()
        for start, end in product(schema.start_effects, schema.end_effects)
        if start.fluent == end.fluent and start.value.is_true() and end.value.is_false()
        for other in domain.schema_of.values()
        if other is not schema
    )


def _left_s(deadline: float) -> float:
    return max(deadline - time.monotonic(), 0.0)


def _step(domain: Domain, text: str) -> Step:
    head, *words = text.strip().removeprefix("(").removesuffix(")").split() or [""]
    schema = domain.schema_of[domain.spelling("action", head, text)]
    if len(words) != len(schema.parameters):
        expected = " ".join(f"?{name}" for name, _ in schema.parameters)
        raise UnknownNameError(
            f"the safe step {text!r} is not of the form ({schema.name} {expected})"
        )
    return domain.step(schema.name, [domain.spelling("object", word, text) for word in words])
