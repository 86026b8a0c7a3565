"""Runs a unified-planning engine beside the ticks; whatever happens, the outcome has a name."""

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum

from rosa_pddl.domain import Domain, Step, UpThing
from rosa_pddl.exceptions import UnsupportedPddlError, nearest
from rosa_pddl.problem import Problem
from rosa_pddl.validate import flaw

_POLL_S = 0.02
_CRITICAL_ERROR = 35


class Outcome(Enum):
    """How a planning ended."""

    SOLVED = "solved"
    SOLVED_OPTIMALLY = "solved optimally"
    UNSOLVABLE_PROVEN = "unsolvable proven"
    UNSOLVABLE_AS_FAR_AS_KNOWN = "unsolvable as far as known"
    OUT_OF_TIME = "out of time"
    OUT_OF_MEMORY = "out of memory"
    UNSUPPORTED = "unsupported"
    ENGINE_MISSING = "engine missing"
    ENGINE_CRASHED = "engine crashed"

    @property
    def is_solved(self) -> bool:
        """Whether there is a plan."""
        return self in (Outcome.SOLVED, Outcome.SOLVED_OPTIMALLY)

    @property
    def is_trouble(self) -> bool:
        """Whether the engine, not the problem, is why there is no plan."""
        unsolvable = (Outcome.UNSOLVABLE_PROVEN, Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN)
        return not self.is_solved and self not in unsolvable

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True)
class PlanningResult:
    """The answer of a planner.

    Args:
        outcome: how it ended.
        steps: the plan; empty unless solved.
        engine: the engine that was asked.
        message: what was tried and what to do about it; empty when solved.
    """

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    engine: str = ""
    message: str = ""


class Planner:
    """Plans with an engine of unified-planning, one process per planning.

    `fast-downward-opt` is A* with the LM-Cut heuristic, or without one where LM-Cut does not apply (conditional
    effects, quantified or disjunctive conditions); the plan has the least cost, or the fewest steps if there are none.

    Args:
        engine: a name of unified-planning's factory, such as `fast-downward-opt` or `fast-downward`.
        timeout_s: after this long the engine's processes are killed [s].
    """

    def __init__(self, engine: str = "fast-downward-opt", timeout_s: float = 10.0) -> None:
        self.engine = engine
        self.timeout_s = timeout_s
        self._name = "fast-downward" if engine.startswith("fast-downward") else engine

    def missing(self, domain: Domain) -> str | None:
        """Return what to install if the engine is not there, None if it is; asked before a mission begins."""
        factory = domain.up_problem.environment.factory
        return None if {self.engine, self._name} <= set(factory.engines) else self._missing(factory)

    def plan(self, problem: Problem) -> PlanningResult:
        """Plan now and wait for the answer; trouble with the engine is an outcome, never an exception."""
        return self._plan(problem, _Watch(self.timeout_s))

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Plan in a thread of its own. Cancelling the future kills the engine's processes."""
        future: Future[PlanningResult] = Future()
        watch = _Watch(self.timeout_s)
        future.add_done_callback(lambda done: watch.cancel() if done.cancelled() else None)

        def work() -> None:
            result = self._plan(problem, watch)
            # the future counts as running only now, as a running one could not be cancelled
            if future.set_running_or_notify_cancel():
                future.set_result(result)

        threading.Thread(target=work, name=f"planner {self.engine}", daemon=True).start()
        return future

    def _plan(self, problem: Problem, watch: "_Watch") -> PlanningResult:
        try:
            # unified-planning's environments are not made for several threads at once
            with _lock_of(problem):
                return self._solve(problem, watch)
        except UnsupportedPddlError as error:
            return self._result(Outcome.UNSUPPORTED, str(error))
        except OSError as error:
            message = f"{self.engine} cannot be started ({error}); try 'pip install --force-reinstall up-fast-downward'"
            return self._result(Outcome.ENGINE_MISSING, message)
        except Exception as error:  # an engine may raise anything; its name and text are the outcome's message
            return self._result(Outcome.ENGINE_CRASHED, f"{self.engine} raised {type(error).__name__}: {error}")

    def _solve(self, problem: Problem, watch: "_Watch") -> PlanningResult:
        missing = self.missing(problem.domain)
        if missing is not None:
            return self._result(Outcome.ENGINE_MISSING, missing)
        up_problem = problem.build()
        engine = self._make(problem.domain.up_problem.environment.factory.engine(self._name), up_problem)
        unsupported = up_problem.kind.features - type(engine).supported_kind().features
        if unsupported:
            message = f"{self.engine} does not support {', '.join(sorted(unsupported)).lower()} ({problem.domain.file})"
            return self._result(Outcome.UNSUPPORTED, message)
        engine.skip_checks = True
        with watch.over(engine):
            answer = engine.solve(up_problem)
        if watch.expired:
            message = f"{self.engine} had no plan after {self.timeout_s:g} s; allow more time or ask for less"
            return self._result(Outcome.OUT_OF_TIME, message)
        return self._judged(problem, answer)

    def _make(self, engine_class: UpThing, up_problem: UpThing) -> UpThing:
        if self.engine == "fast-downward-opt":
            # the factory's own class of that name fails outside the global environment (unified-planning 1.3)
            heuristic = "blind()" if up_problem.kind.features & _BEYOND_LM_CUT else "lmcut()"
            return _in_own_folder(engine_class)(fast_downward_search_config=f"astar({heuristic})")
        if self.engine == "fast-downward":
            return _in_own_folder(engine_class)()
        return engine_class()

    def _judged(self, problem: Problem, answer: UpThing) -> PlanningResult:
        outcome = _OUTCOMES.get(answer.status.name, Outcome.ENGINE_CRASHED)
        if answer.plan is None or not outcome.is_solved:
            if outcome.is_solved:
                outcome = Outcome.ENGINE_CRASHED
            return self._result(outcome, self._explained(outcome, answer))
        steps = tuple(_step(problem, instance) for instance in answer.plan.actions)
        wrong = flaw(problem.domain, steps, problem.state)
        if wrong is not None:
            return self._result(Outcome.ENGINE_CRASHED, f"{self.engine} returned a plan that does not work: {wrong}")
        if self.engine == "fast-downward-opt":
            outcome = Outcome.SOLVED_OPTIMALLY
        return PlanningResult(outcome, steps, self.engine)

    def _explained(self, outcome: Outcome, answer: UpThing) -> str:
        if outcome is not Outcome.ENGINE_CRASHED:
            return f"{self.engine}: {outcome}"
        output = "\n".join(log.message for log in answer.log_messages or ()).strip()
        last = output.splitlines()[-3:]
        return (
            f"{self.engine} crashed; try 'pip install --force-reinstall up-fast-downward'. It said: {' / '.join(last)}"
        )

    def _missing(self, factory: UpThing) -> str:
        from unified_planning.engines.factory import DEFAULT_ENGINES

        usable = sorted(name for name in factory.engines if factory.engine(name).is_oneshot_planner())
        if self.engine in DEFAULT_ENGINES:
            package = DEFAULT_ENGINES[self.engine][0].split(".")[0].replace("_", "-")
            advice = f"is not installed; try 'pip install {package}'"
        else:
            advice = f"is not one of unified-planning; {nearest(self.engine, DEFAULT_ENGINES)}"
        return f"the planning engine {self.engine!r} {advice}; installed planners: {', '.join(usable) or 'none'}"

    def _result(self, outcome: Outcome, message: str) -> PlanningResult:
        return PlanningResult(outcome, (), self.engine, message)


_BEYOND_LM_CUT = {
    "CONDITIONAL_EFFECTS",
    "DISJUNCTIVE_CONDITIONS",
    "EXISTENTIAL_CONDITIONS",
    "UNIVERSAL_CONDITIONS",
}
_OUTCOMES = {
    "SOLVED_SATISFICING": Outcome.SOLVED,
    "SOLVED_OPTIMALLY": Outcome.SOLVED_OPTIMALLY,
    "UNSOLVABLE_PROVEN": Outcome.UNSOLVABLE_PROVEN,
    "UNSOLVABLE_INCOMPLETELY": Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    "TIMEOUT": Outcome.OUT_OF_TIME,
    "MEMOUT": Outcome.OUT_OF_MEMORY,
    "UNSUPPORTED_PROBLEM": Outcome.UNSUPPORTED,
}


def _lock_of(problem: Problem) -> threading.Lock:
    environment = problem.domain.up_problem.environment
    lock: threading.Lock = environment.__dict__.setdefault("_rosa_pddl_lock", threading.Lock())
    return lock


def _step(problem: Problem, instance: UpThing) -> Step:
    outside = problem.domain.outside
    arguments = (outside[argument.object().name] for argument in instance.actual_parameters)
    return problem.domain.step(outside[instance.action.name], arguments)


def _in_own_folder(engine_class: UpThing) -> UpThing:
    """Fast Downward writes its translated task to the working directory, where two at once would collide."""

    class InOwnFolder(engine_class):  # type: ignore[misc]  # the class is known at run time only
        def _get_cmd(self, domain_filename: str, problem_filename: str, plan_filename: str) -> list[str]:
            command = list(super()._get_cmd(domain_filename, problem_filename, plan_filename))
            at = command.index("--plan-file")
            return [*command[:at], "--sas-file", plan_filename + ".sas", *command[at:]]

        def _result_status(
            self, problem: UpThing, plan: UpThing, retval: int | None = None, log_messages: UpThing = None
        ) -> UpThing:
            # exit codes 0 to 3 promise a plan; without one they are those of an interpreter that failed
            exit_code = _CRITICAL_ERROR if plan is None and retval in (0, 1, 2, 3) else retval
            return super()._result_status(problem, plan, exit_code, log_messages)

    return InOwnFolder


class _Watch:
    """Kills the processes of an engine when its time is over or its answer no longer wanted."""

    def __init__(self, timeout_s: float) -> None:
        self.expired = False
        self._timeout_s = timeout_s
        self._wake = threading.Event()
        self._done = threading.Event()

    def cancel(self) -> None:
        """Stop the engine, as its answer is no longer wanted."""
        self._wake.set()

    @contextmanager
    def over(self, engine: UpThing) -> Iterator[None]:
        """Watch the engine in a context."""
        thread = threading.Thread(target=self._watch, args=(engine,), name="planner watch", daemon=True)
        thread.start()
        try:
            yield
        finally:
            self._done.set()
            self._wake.set()
            thread.join()

    def _watch(self, engine: UpThing) -> None:
        if not self._wake.wait(self._timeout_s):
            self.expired = True
        # again and again, as the engine may not have started its process yet
        while not self._done.wait(_POLL_S):
            _kill(getattr(engine, "_process", None))


def _kill(process: UpThing) -> None:
    if process is None or process.returncode is not None:
        return
    # each engine process leads a group of its own, so that what it started ends with it
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
