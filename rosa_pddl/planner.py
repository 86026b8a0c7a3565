"""The planner: tries several strategies in order; every result has a named outcome."""

import json
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, chain, combinations, product
from math import comb, inf
from pathlib import Path

from rosa_pddl.domain import Domain, Exact, Step, exact, names_in
from rosa_pddl.engines import (
    DOWNWARD,
    FAST,
    KAIROS,
    OPTIMAL,
    Cancelled,
    EngineAnswer,
    KairosWorker,
    ProcessHandle,
    check_name,
    fast_downward,
    missing_package,
    solve_with_engine,
)
from rosa_pddl.exceptions import (
    PlannerSettingError,
    PlanningBudgetError,
    UnknownNameError,
    UnsupportedPddlError,
)
from rosa_pddl.grounding import Grounded, Groundings, TooManyInstances, UnsearchableError
from rosa_pddl.problem import Attempt, Outcome, PlanningFailed, PlanningResult, Problem
from rosa_pddl.search import CapReached, NegativeCostError
from rosa_pddl.validate import (
    TimedStep,
    flaw,
    missing_at_start,
    schedule_flaw,
    step_costs,
    takes_s,
)

SEARCH = "search"
"""The strategy that is the exact search in this process."""
CERTIFIED = "certificate"
"""The strategy of an answer that a certificate gives, made before the mission."""

# Within a tick, the search looks at most at this many moves; some milliseconds.
_MOVES_IN_A_TICK = 1000
_MOVES_FOR_AN_OPERATION = 5
# The cache holds at most this many atoms in all.
_MOST_ATOMS = 1_000_000
_PREPARED_S = 60.0
_MOST_ENTRIES = 1 << 14


@dataclass(frozen=True)
class Certificate:
    """The planner's answer for each combination of unfeasible actions, small combinations first.

    Args:
        entries: the answers by the names of the unfeasible ROSA actions, in the domain's order.
        causes: the answers by single causes, such as `camera fails`.
    """

    entries: dict[tuple[str, ...], PlanningResult]
    causes: dict[str, PlanningResult] = field(default_factory=dict)

    @classmethod
    def load(cls, path: str | Path, domain: Domain) -> "Certificate":
        """Read a file of `rosa plan --certificate --json`; PlannerSettingError if it does not fit."""
        try:
            entries = dict[tuple[str, ...], PlanningResult]()
            for entry in json.loads(Path(path).read_text())["entries"]:
                written = entry["steps"]
                steps = tuple(domain.step(each["action"], each["arguments"]) for each in written)
                outcome = Outcome(entry["outcome"])
                result = PlanningResult(outcome, steps, entry["engine"], cost=entry["cost"])
                entries[tuple(entry["unfeasible"])] = result
            return cls(entries)
        except (OSError, ValueError, KeyError, TypeError) as error:
            reason = f"{type(error).__name__}: {error}"
            message = f"{path} is no certificate of {domain.file} ({reason})"
            advice = "write one with rosa plan --certificate --json"
            raise PlannerSettingError(f"{message}; {advice}") from error

    def prepared(self, problem: Problem) -> PlanningResult | None:
        """Return the plan for the unfeasible actions, or its shortest end that works, or None.

        If none works, actions that are forecast to become unfeasible count as unfeasible already.
        """
        domain, state, until = problem.domain, problem.state, problem.until
        left_out = {step for step, weight in problem.weights.items() if not weight}
        for lasting in (state, state - until.keys()) if until else (state,):
            actions = [name for atom, name in domain.feasibility.items() if atom not in lasting]
            entry = self.entries.get(tuple(actions))
            steps = () if entry is None else entry.steps
            for count in range(1, 1 + len(steps)):
                rest = steps[-count:]
                if not left_out.isdisjoint(rest):
                    continue
                if entry is not None and flaw(domain, rest, state, problem.wanted, until) is None:
                    return replace(entry, outcome=Outcome.SOLVED, steps=rest, schedule=())
        return None

    @property
    def fatal(self) -> tuple[str, ...]:
        """The actions and causes each of which alone makes a possible mission impossible."""
        if not self.entries[()].outcome.is_solved:
            return ()
        fatal = list[str]()
        for unfeasible, result in self.entries.items():
            if len(unfeasible) == 1 and result.outcome.is_unsolvable:
                fatal.append(unfeasible[0])
        for cause, result in self.causes.items():
            if result.outcome.is_unsolvable:
                fatal.append(cause)
        return tuple(fatal)


class Planner:
    """Plans with the exact search in this process and, beyond its cap, with engines.

    Every plan is replayed before it is returned.

    Args:
        engine: `fast-downward-opt` (a plan of least cost), `fast-downward` (any plan, soon),
            `kairos` (numbers, time, preferences), or a name of unified-planning's factory.
            Where Fast Downward has no notion of numbers or time, Kairos answers.
        timeout_s: wall-clock time for all strategies together [s]; an engine is killed then.
        fallback: engines to try afterwards; each strategy may take half of the time that is left.
        overlapping: whether steps may overlap; the plan is a schedule. The engine is `kairos`, or
            a temporal one of unified-planning.
        safe_step: the step to do while there is no plan, such as `(surface)`.
        moves: how many moves the search in this process may look at; 0 to leave it out.
        memory_mb: how much data each program may hold [MB].
        cached: how many answers are remembered; a full cache is emptied. 0 for none.
        certificate: plans made before the mission; `start` answers at once with one that works.

    Raises:
        PlannerSettingError: a setting that makes no sense, or an unknown engine.
    """

    def __init__(
        self,
        engine: str | None = None,
        timeout_s: float = 10.0,
        *,
        fallback: Sequence[str] = (),
        overlapping: bool = False,
        safe_step: str | None = None,
        moves: int = 20_000,
        memory_mb: int = 4096,
        cached: int = 256,
        certificate: Certificate | None = None,
    ) -> None:
        self.engine = engine or (KAIROS if overlapping else OPTIMAL)
        self.fallback = tuple(fallback)
        self.timeout_s = timeout_s
        self.overlapping = overlapping
        self.safe_step = safe_step
        self.moves = moves
        self.memory_bytes = memory_mb << 20
        self.certificate = certificate
        self._check()
        self.groundings = Groundings()
        self.kairos = KairosWorker(memory_mb)
        self.cache: dict[Hashable, PlanningResult] = {}
        self.cached = cached
        self.processes: set[ProcessHandle] = set()

    def _check(self) -> None:
        for name in (self.engine, *self.fallback):
            wrong = check_name(name)
            if wrong is not None:
                raise PlannerSettingError(wrong)
            if self.overlapping and name in DOWNWARD:
                message = f"{name} plans one step after the other; for overlapping steps use"
                raise PlannerSettingError(f"{message} a temporal engine such as 'kairos'")
        if not 0.0 < self.timeout_s < inf:
            message = f"timeout_s is {self.timeout_s:g}, expected more than 0, and finite"
            raise PlannerSettingError(message)

    def missing(self, domain: Domain) -> str | None:
        """Return what to install if the engine is missing, else None."""
        return missing_package(self.engine)

    def prepare(self, problem: Problem, changing: Iterable[str] = ()) -> None:
        """Start to ground the task in the background; otherwise the first planning does it.

        Args:
            problem: the problem in the state in which the mission begins.
            changing: atoms that may change although no action changes them, as those sensed.

        Raises:
            UnknownNameError: the domain does not have an atom.
        """
        named = [problem.domain.atom(text) for text in changing]
        process = ProcessHandle()
        self.processes.add(process)
        portfolio = _Portfolio(self, problem, process)

        def work() -> None:
            with suppress(Cancelled, PlanningFailed, UnsearchableError, TooManyInstances):
                if portfolio.main_engine == KAIROS:
                    self.kairos.start()
                if self.moves and self.engine == OPTIMAL:
                    portfolio.ground(time.monotonic() + _PREPARED_S, named)
            self.processes.discard(process)

        name = f"grounding of {problem.domain.name}"
        threading.Thread(target=work, name=name, daemon=True).start()

    def prepared(self, problem: Problem) -> PlanningResult | None:
        """Return the certificate's plan for a problem, or an end of it, if it works. Never waits."""
        if self.certificate is None:
            return None
        result = self.certificate.prepared(problem)
        return None if result is None else _Portfolio(self, problem).confirmed(result)

    def plan(self, problem: Problem) -> PlanningResult:
        """Plan now and wait for the answer; trouble is an outcome, never an exception."""
        return _Portfolio(self, problem).result()

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Plan in a new thread, or at once if that fits into a tick. Cancelling ends the engine."""
        future: Future[PlanningResult] = Future()
        portfolio = _Portfolio(self, problem)
        at_once = self.prepared(problem) or portfolio.at_once()
        if at_once is not None:
            future.set_result(at_once)
            return future

        def on_done(done: "Future[PlanningResult]") -> None:
            if done.cancelled():
                portfolio.process.cancel()

        def work() -> None:
            result = portfolio.result()
            # not set to running before now, because a running future cannot be cancelled
            if future.set_running_or_notify_cancel():
                future.set_result(result)

        future.add_done_callback(on_done)
        threading.Thread(target=work, name=f"planner {self.engine}", daemon=True).start()
        return future

    def close(self) -> None:
        """End all programs that run for this planner, and forget the grounded tasks."""
        for process in tuple(self.processes):
            process.cancel()
        self.kairos.close()
        self.groundings.close()


def wait_for_plan(future: "Future[PlanningResult]", budget_s: float) -> PlanningResult:
    """Wait for an answer that is due, in lock-step simulation; call it between ticks.

    Args:
        future: what `Planner.start` returned.
        budget_s: longest wall-clock time to wait [s]; then the planning is cancelled.

    Raises:
        PlanningBudgetError: the answer was not there in time, or an attempt ran out of wall-clock
            time, so that a faster machine might have given another answer.
    """
    finished, _ = wait([future], timeout=budget_s)
    depends = "would make the run depend on the machine"
    if not finished:
        future.cancel()
        message = f"no plan after {budget_s:g} s of waiting, and going on without {depends}"
        raise PlanningBudgetError(f"{message}; allow more time or ask for less")
    result = future.result()
    if result.hangs_on_the_clock:
        tried = "; ".join(map(str, result.attempts)) or result.message
        message = f"planning ran out of wall-clock time, and going on {depends}"
        raise PlanningBudgetError(f"{message}: {tried}")
    return result


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
        PlannerSettingError: `failures` is out of range, or there are too many combinations.
    """
    actions = domain.rosa_actions
    most = len(actions) if failures is None else failures
    if not 0 <= most <= len(actions):
        message = f"failures is {most}, expected 0 to {len(actions)}"
        raise PlannerSettingError(f"{message}, as so many actions there are")
    total = sum(comb(len(actions), count) for count in range(most + 1))
    if total > _MOST_ENTRIES:
        message = f"{total} combinations of {len(actions)} actions are too many"
        advice = "look at fewer failures at once, such as failures=2"
        raise PlannerSettingError(f"{message} (at most {_MOST_ENTRIES}); {advice}")
    chosen = chain.from_iterable(combinations(actions, count) for count in range(most + 1))
    return Certificate({names: planner.plan(supposing(names)) for names in chosen})


class _Portfolio:
    """One planning: tries the strategies in order, and reports on all of them."""

    def __init__(
        self, planner: Planner, problem: Problem, process: ProcessHandle | None = None
    ) -> None:
        self._planner = planner
        self._problem = problem
        self._domain = problem.domain.with_numbers(problem.costs)
        self._safe_step = None
        if planner.safe_step is not None:
            self._safe_step = _step(problem.domain, planner.safe_step)
        self.process = process or ProcessHandle(planner.memory_bytes)

    # ------------------------------------------------------------ answers

    def at_once(self) -> PlanningResult | None:
        """Return the answer if it is remembered or can be found within a tick, else None."""
        remembered = self._remembered()
        if remembered is not None or not self._may_search:
            return remembered
        try:
            task = self._planner.groundings.ready(self._domain, self._problem.state)
            if task is None or task.size * task.work > _MOVES_IN_A_TICK:
                return None
            answer = self._checked(SEARCH, self._search(task, _MOVES_IN_A_TICK, inf))
        except Exception:  # `result` meets the same error and reports it
            return None
        attempt = Attempt(SEARCH, answer.outcome)
        return self._remember(self._report(answer, SEARCH, [attempt]))

    def confirmed(self, prepared: PlanningResult) -> PlanningResult | None:
        """Return a plan that was made before, if it works, else None."""
        try:
            answer = self._checked(CERTIFIED, prepared)
        except (PlanningFailed, UnsupportedPddlError):
            return None
        return self._report(answer, CERTIFIED, [Attempt(CERTIFIED, answer.outcome)])

    def result(self) -> PlanningResult:
        """Try one strategy after the other until there is a plan, or a proof that there is none."""
        remembered = self._remembered()
        if remembered is not None:
            return remembered
        self._planner.processes.add(self.process)
        try:
            return self._remember(self._try_in_order())
        except Cancelled:
            message = "the planner was closed"
            return PlanningResult(Outcome.ENGINE_CRASHED, (), self._planner.engine, message)
        finally:
            self._planner.processes.discard(self.process)

    def _remembered(self) -> PlanningResult | None:
        result = self._planner.cache.get(self._key)
        if result is None:
            return None
        return replace(result, attempts=(Attempt("cache", result.outcome),))

    def _remember(self, result: PlanningResult) -> PlanningResult:
        if not result.outcome.is_trouble and not result.hangs_on_the_clock:
            cache = self._planner.cache
            size = 1 + len(self._problem.state) + len(self._problem.costs)
            most = min(self._planner.cached, _MOST_ATOMS // size)
            if len(cache) >= most:
                cache.clear()
            if most:
                cache[self._key] = result
        return result

    @cached_property
    def _key(self) -> Hashable:
        problem = self._problem
        mappings = (problem.costs, problem.weights, problem.until, problem.shares)
        contents = [frozenset(mapping.items()) for mapping in mappings]
        return (problem.domain, problem.state, problem.wanted, problem.soft, *contents)

    # ------------------------------------------------------------ strategies

    @property
    def _may_search(self) -> bool:
        planner, problem = self._planner, self._problem
        is_exact = planner.engine == OPTIMAL or bool(problem.until and planner.engine == FAST)
        is_plain = not (problem.soft or planner.overlapping or self._domain.timed)
        return is_exact and is_plain and planner.moves > 0 and not self._domain.only_planned

    @property
    def main_engine(self) -> str:
        """The engine that plans beyond the search: Fast Downward only without numbers and time."""
        planner, domain, problem = self._planner, self._domain, self._problem
        if planner.engine not in DOWNWARD:
            return planner.engine
        has_numbers = domain.computed or domain.compared
        is_beyond = has_numbers or domain.timed or domain.only_planned
        if is_beyond or problem.soft or problem.until:
            return KAIROS
        try:
            problem.write("costs")
        except UnsearchableError:
            return KAIROS
        return planner.engine

    def _try_in_order(self) -> PlanningResult:
        deadline = time.monotonic() + self._planner.timeout_s
        strategies = [SEARCH] if self._may_search else []
        strategies += ["", *self._planner.fallback]
        attempts: list[Attempt] = []
        for number, name in enumerate(strategies, start=1):
            strategy = name or self.main_engine
            left_s = _left_s(deadline)
            if number < len(strategies):
                left_s /= 2
            answer = self._try(strategy, time.monotonic() + left_s)
            if answer is None:
                continue
            message = answer.message if answer.outcome.is_trouble else ""
            attempts.append(Attempt(strategy, answer.outcome, message))
            is_final = answer.outcome.is_solved or answer.outcome is Outcome.UNSOLVABLE_PROVEN
            # what the search finds to be missing, an engine would take for false
            if is_final or (strategy == SEARCH and answer.outcome is Outcome.UNSUPPORTED):
                return self._report(answer, strategy, attempts)
        outcomes = [attempt.outcome for attempt in attempts]
        worst = next(outcome for outcome in Outcome if outcome in outcomes)
        return self._report(PlanningResult(worst), attempts[0].strategy, attempts)

    def _try(self, strategy: str, deadline: float) -> PlanningResult | None:
        """Return the answer of a strategy; None if the search gave up, as engines will do."""
        try:
            if strategy == SEARCH:
                return self._checked(strategy, self._search_here(deadline))
            missing = missing_package(strategy)
            if missing is not None:
                raise PlanningFailed(Outcome.ENGINE_MISSING, missing)
            if _left_s(deadline) <= 0.0:
                message = f"of {self._planner.timeout_s:g} s no time was left for it"
                raise PlanningFailed(Outcome.OUT_OF_TIME, message)
            return self._checked(strategy, self._ask(strategy, deadline))
        except Cancelled:
            raise
        except (CapReached, UnsearchableError, TooManyInstances, NegativeCostError):
            return None
        except PlanningFailed as failure:
            if strategy == SEARCH and failure.outcome.is_passing:
                return None
            return PlanningResult(failure.outcome, message=str(failure))
        except UnsupportedPddlError as error:
            return PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        except Exception as error:  # no error here may stop the tree; it is reported by name
            message = f"{type(error).__name__}: {error}"
            return PlanningResult(Outcome.ENGINE_CRASHED, message=message)

    def _ask(self, engine: str, deadline: float) -> PlanningResult:
        """Ask an engine for a plan."""
        problem, overlapping = self._problem, self._planner.overlapping
        if self._domain.only_planned or self._domain.timed:
            overlapping = True
        try:
            text = problem.write(self._style(engine))
        except UnsearchableError as error:
            raise PlanningFailed(Outcome.UNSUPPORTED, f"{error} ({self._domain.file})") from None
        left_s = _left_s(deadline)
        if engine in DOWNWARD:
            answer = fast_downward(text, engine, self.process, left_s)
        elif engine == KAIROS:
            answer = self._planner.kairos.ask(text, self.process, left_s, anytime=True)
        elif self._domain.axioms:
            names = ", ".join(self._domain.axioms)
            message = f"{names} is derived, which {engine} does not know; Planner() does"
            raise PlanningFailed(Outcome.UNSUPPORTED, message)
        else:
            answer = solve_with_engine(engine, text, self.process, left_s)
        if answer.outcome is Outcome.UNSUPPORTED:
            raise PlanningFailed(answer.outcome, answer.message)
        return self._result_of(answer, text.step, overlapping)

    def _style(self, engine: str) -> str:
        if self._planner.overlapping:
            return "overlapping"
        if engine in DOWNWARD:
            return "costs"
        has_times = self._problem.until or self._domain.timed or self._mentions_time
        if engine == KAIROS and has_times and self._domain.is_temporal:
            return "timed"
        return "" if engine == KAIROS or self._domain.computed or self._domain.compared else "costs"

    @property
    def _mentions_time(self) -> bool:
        return "total-time" in names_in([self._domain.metric])

    def _result_of(
        self,
        answer: EngineAnswer,
        step_of: Callable[[Domain, str, Sequence[str]], Step | None],
        overlapping: bool,
    ) -> PlanningResult:
        timed = list[TimedStep]()
        for action, arguments, start_s, duration_s in answer.steps:
            step = step_of(self._domain, action, arguments)
            if step is not None:
                timed.append(TimedStep(step, start_s, duration_s))
        steps = tuple(each.step for each in timed)
        schedule = tuple(timed) if overlapping else ()
        return PlanningResult(answer.outcome, steps, message=answer.message, schedule=schedule)

    # ------------------------------------------------------------ the search

    def ground(self, deadline: float, changing: Iterable[str] = ()) -> Grounded:
        """Return the grounded task, made now if need be."""

        def go_on(_: int) -> None:
            self.process.check()
            if time.monotonic() > deadline:
                message = f"the task of {self._domain.name} was not grounded in time"
                raise PlanningFailed(Outcome.OUT_OF_TIME, f"{message}; allow more or ask for less")

        groundings = self._planner.groundings
        return groundings.ask(self._domain, self._problem.state, go_on, changing)

    def _search_here(self, deadline: float) -> PlanningResult:
        task = self.ground(deadline)
        if task.size * _MOVES_FOR_AN_OPERATION > self._planner.moves:
            raise CapReached  # putting numbers into many operations takes longer than an engine
        return self._search(task, self._planner.moves, deadline)

    def _search(self, grounded: Grounded, cap: int, deadline: float) -> PlanningResult:
        problem = self._problem
        made = grounded.search_task(problem.state, problem.wanted, problem.costs, problem.weights)
        if made is None:
            return PlanningResult(Outcome.UNSOLVABLE_PROVEN)
        graph, task = made
        if problem.until:
            until = {atom: exact(left_s) for atom, left_s in problem.until.items()}
            graph, task = grounded.with_forecasts(task, until, self._takes, problem.shares)

        def go_on() -> None:
            self.process.check()
            if time.monotonic() > deadline:
                raise CapReached

        found = graph.plan(task.start, cap // grounded.work, go_on)
        if found is None:
            return PlanningResult(Outcome.UNSOLVABLE_PROVEN)
        steps = tuple(grounded.step(move.what) for move in found.moves)
        return PlanningResult(Outcome.SOLVED_OPTIMALLY, steps)

    def _takes(self, step: Step) -> Exact:
        return exact(takes_s(self._domain, step, self._problem.state, self._problem.costs))

    # ------------------------------------------------------------ checks and reports

    def _checked(self, strategy: str, answer: PlanningResult) -> PlanningResult:
        """Replay a plan; raise PlanningFailed if it does not work."""
        if not answer.outcome.is_solved or self._domain.only_planned:
            return answer
        wrong = self._flaw(answer, {})
        if wrong is not None:
            message = f"{strategy} returned a plan that does not work: {wrong}"
            raise PlanningFailed(Outcome.ENGINE_CRASHED, message)
        late = self._flaw(answer, self._problem.until) if self._problem.until else None
        if late is not None:
            message = f"what is forecast was not planned with, and {late}"
            raise PlanningFailed(Outcome.UNSUPPORTED, f"{message}; allow more moves")
        return answer

    def _flaw(self, answer: PlanningResult, until: Mapping[str, float]) -> str | None:
        problem, domain = self._problem, self._domain
        state, costs = problem.state, problem.costs
        if answer.schedule:
            return schedule_flaw(domain, answer.schedule, state, problem.wanted, until, costs)
        takes = [takes_s(domain, step, state, costs) for step in answer.steps]
        if takes:
            takes[0] *= problem.shares.get(answer.steps[0], 1.0)
        ends_s = tuple(accumulate(takes))
        return flaw(domain, answer.steps, state, problem.wanted, until, ends_s)

    def _report(
        self, answer: PlanningResult, strategy: str, attempts: list[Attempt]
    ) -> PlanningResult:
        domain, outcome = self._domain, answer.outcome
        if outcome.is_solved:
            cost = self._cost(answer.steps)
            tried = tuple(attempts)
            return replace(answer, engine=strategy, cost=cost, attempts=tried, message="")
        message = f"{strategy}: {outcome}" + (f": {answer.message}" if answer.message else "")
        is_sequential = not self._planner.overlapping
        if outcome is Outcome.UNSOLVABLE_PROVEN and is_sequential and _may_have_to_overlap(domain):
            outcome = Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
            message = f"{strategy}: {outcome}: there is no plan of one step after the other"
            message += "; steps may overlap with Planner(overlapping=True)"
        if outcome.is_trouble:
            message = "; ".join(map(str, attempts))
        safe = self._safe_step
        if safe is not None and missing_at_start(domain, safe, self._problem.state) is not None:
            safe = None
        tried = tuple(attempts)
        return PlanningResult(outcome, (), strategy, message, attempts=tried, safe_step=safe)

    def _cost(self, steps: Sequence[Step]) -> float | None:
        if self._domain.only_planned:
            return None
        total = 0.0
        for cost in step_costs(self._domain, steps, self._problem.state, self._problem.costs):
            if cost is None:
                return None
            total += cost
        return total


def _may_have_to_overlap(domain: Domain) -> bool:
    """Whether an action makes something true only while it runs, and another needs that."""
    for schema in domain.schema_of.values():
        for start, end in product(schema.start_effects, schema.end_effects):
            is_lent = start.name == end.name and start.terms == end.terms
            if is_lent and start.kind == "add" and end.kind == "delete":
                for other in domain.schema_of.values():
                    if other is not schema and start.name in names_in(other.conditions):
                        return True
    return False


def _left_s(deadline: float) -> float:
    return max(deadline - time.monotonic(), 0.0)


def _step(domain: Domain, text: str) -> Step:
    head, *words = text.strip().removeprefix("(").removesuffix(")").split() or [""]
    schema = domain.schema_of[domain.spelling("action", head, text)]
    if len(words) != len(schema.parameters):
        expected = " ".join(f"?{name}" for name, _ in schema.parameters)
        message = f"the safe step {text!r} is not of the form ({schema.name} {expected})"
        raise UnknownNameError(message)
    return domain.step(schema.name, [domain.spelling("object", word, text) for word in words])
