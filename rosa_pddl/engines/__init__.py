"""Planners by others, each run in a process of its own: Fast Downward, and the engines of unified-planning.

Fast Downward's search is run as a program; it is licensed under the GPL-3, so nothing of it is imported here. Its
documentation, "translator output format" and "exit codes", describes the formats and exit codes.
"""

import json
import os
import pickle
import re
import sys
from dataclasses import replace
from functools import cache, cached_property
from importlib.util import find_spec
from pathlib import Path
from shutil import which

from rosa_pddl.domain import Domain, Outcome, PlanningResult, TimedStep, Trouble, UpThing
from rosa_pddl.engines.processes import INSTALL_ADVICE, ProcessHandle
from rosa_pddl.exceptions import nearest
from rosa_pddl.problem import Problem, lock_of

SEARCHES = ("fast-downward-opt", "fast-downward")
"""The engines that are Fast Downward: for an optimal plan, and for any plan."""
LABEL_SETTING = "label-setting"
"""The engine that is the exact search, which keeps limits."""
NUMERIC = "enhsp"
"""The engine for numbers that rise and fall, if the exact search reaches its cap."""
TRANSLATED = (*SEARCHES, LABEL_SETTING)
"""The engines that search a grounded task."""

_STEP = re.compile(rb"^(\d+) \(\d+\)$", re.MULTILINE)
_EXIT_CODES = {
    10: Outcome.UNSOLVABLE_PROVEN,
    11: Outcome.UNSOLVABLE_PROVEN,
    12: Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    20: Outcome.OUT_OF_MEMORY,
    21: Outcome.OUT_OF_TIME,
    22: Outcome.OUT_OF_MEMORY,
    23: Outcome.OUT_OF_TIME,
    34: Outcome.UNSUPPORTED,
}
OUTCOMES = {
    "SOLVED_SATISFICING": Outcome.SOLVED,
    "SOLVED_OPTIMALLY": Outcome.SOLVED_OPTIMALLY,
    "UNSOLVABLE_PROVEN": Outcome.UNSOLVABLE_PROVEN,
    "UNSOLVABLE_INCOMPLETELY": Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN,
    "TIMEOUT": Outcome.OUT_OF_TIME,
    "MEMOUT": Outcome.OUT_OF_MEMORY,
    "UNSUPPORTED_PROBLEM": Outcome.UNSUPPORTED,
}
"""The outcomes by unified-planning's names for them."""
_NEVER_UNSOLVABLE = (
    "it may be that there is no plan, which engines of overlapping steps hardly ever find out: Planner(), whose steps "
    "follow one another, may say what is out of reach"
)


def fast_downward(
    text: str, strategy: str, process: ProcessHandle, *, limit_s: float
) -> tuple[int, ...] | Outcome:
    """Search for a plan with Fast Downward within `limit_s` of wall-clock time [s]; raises Trouble or Cancelled.

    Returns the names of the plan's operators, which must be numbers, or an outcome if there is no plan.
    """
    command = [
        str(fast_downward_program()),
        "--search",
        strategy,
        "--internal-plan-file",
        "/dev/null",
    ]
    ended = process.ask(command, given=text.encode(), limit_s=limit_s)
    if ended.code in (0, 1, 2, 3):
        if b"Plan length:" not in ended.output:
            raise Trouble(
                Outcome.ENGINE_CRASHED,
                f"the search promised a plan but showed none: {ended.last_words}",
            )
        return tuple(int(number) for number in _STEP.findall(ended.output))
    outcome = _EXIT_CODES.get(ended.code, Outcome.ENGINE_CRASHED)
    if not outcome.is_trouble:
        return outcome
    raise Trouble(
        outcome,
        f"it ended with exit code {ended.code}; {INSTALL_ADVICE}. It said: {ended.last_words}",
    )


@cache
def fast_downward_program() -> Path | None:
    """Return the path of Fast Downward's search; None if it is not installed."""
    found = find_spec("up_fast_downward")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "downward" / "builds" / "release" / "bin" / "downward"
    return path if path.exists() else None


def late_environment() -> UpThing:
    """Return an environment for unified-planning's problems that makes its factory of engines on first use.

    unified-planning 1.3 imports every engine with the environment, and with them libraries to tune parameters, which
    takes longer than the rest of a mission's start. This environment also prints nothing.
    """
    from unified_planning import model
    from unified_planning.environment import Environment
    from unified_planning.model import walkers
    from unified_planning.model.type_manager import TypeManager

    class LateEnvironment(Environment):  # type: ignore[misc]  # unified-planning ships no types
        def __init__(self) -> None:
            self._type_manager = TypeManager()
            self._tc = walkers.TypeChecker(self)
            self._expression_manager = model.ExpressionManager(self)
            self._free_vars_oracle = model.FreeVarsOracle()
            self._simplifier = walkers.Simplifier(self)
            self._substituter = walkers.Substituter(self)
            self._free_vars_extractor = walkers.FreeVarsExtractor()
            self._names_extractor = walkers.NamesExtractor()
            self._credits_stream = None
            self._error_used_name = True

        @cached_property
        def _factory(self) -> UpThing:
            from unified_planning.engines import Factory

            return Factory(self)

        def __reduce__(self) -> tuple[UpThing, ...]:
            """Pickle as an ordinary environment, as the process of an engine does not import this package."""
            return object.__new__, (Environment,), {**self.__dict__, "_factory": self._factory}

    return LateEnvironment()


def register_engine(environment: UpThing = None) -> None:
    """Register `label-setting` with unified-planning, for `OneshotPlanner(name="label-setting")`.

    Args:
        environment: the environment of the problems to plan; by default unified-planning's global one.
    """
    from unified_planning.environment import get_environment

    factory = get_environment(environment).factory
    if LABEL_SETTING not in factory.engines:
        factory.add_engine(LABEL_SETTING, "rosa_pddl.engines.label_setting", "LabelSetting")


def missing(engine: str, domain: Domain) -> str | None:
    """Return what to install if an engine is missing, else None."""
    environment = (
        domain.up_problem.environment
    )  # its factory is slow to make, so it is made only if needed
    if engine in TRANSLATED:
        return None if fast_downward_program() else _missing(engine)
    if engine == NUMERIC and which("java") is None:
        return "the planning engine 'enhsp' needs Java, which is not installed; try 'apt install default-jre-headless'"
    return None if engine in environment.factory.engines else _missing(engine)


def _missing(engine: str) -> str:
    from unified_planning.engines.factory import DEFAULT_ENGINES

    if engine not in DEFAULT_ENGINES:
        return f"the planning engine {engine!r} is not one of unified-planning; {nearest(engine, DEFAULT_ENGINES)}"
    package = DEFAULT_ENGINES[engine][0].split(".")[0].replace("_", "-")
    package = "rosa-taca[numeric]" if engine == NUMERIC else package
    return f"the planning engine {engine!r} is not installed; try 'pip install {package}'"


def asked(
    engine: str, problem: Problem, process: ProcessHandle, *, limit_s: float, overlapping: bool
) -> PlanningResult:
    """Ask an engine for a plan within a wall-clock time [s]; raises Trouble, UnsupportedPddlError or Cancelled.

    If steps may overlap, they keep their durations, else all are instantaneous.
    """
    with lock_of(problem.domain):
        supported = problem.domain.up_problem.environment.factory.engine(engine).supported_kind()
        # an engine without timed effects plans without forecasts; its plan is checked against them later
        known = problem if "TIMED_EFFECTS" in supported.features else replace(problem, until={})
        up_problem = known.build(overlapping=overlapping)
        unsupported = up_problem.kind.features - supported.features
        if unsupported:
            message = f"{engine} does not support {', '.join(sorted(unsupported)).lower()} ({problem.domain.file})"
            raise Trouble(Outcome.UNSUPPORTED, message)
        given = pickle.dumps({"engine": engine, "problem": up_problem})
    command = [sys.executable, "-P", str(Path(__file__).with_name("worker.py"))]
    paths = {"PYTHONPATH": os.pathsep.join(sys.path)}
    try:
        ended = process.ask(command, given=given, limit_s=limit_s, environment=paths)
    except Trouble as trouble:
        if overlapping and trouble.outcome is Outcome.OUT_OF_TIME:
            raise Trouble(trouble.outcome, f"{trouble}; {_NEVER_UNSOLVABLE}") from trouble
        raise
    try:
        answer = json.loads(ended.output)
        outcome = OUTCOMES.get(answer["status"], Outcome.ENGINE_CRASHED)
        if (engine == NUMERIC or known.until) and outcome is Outcome.UNSOLVABLE_PROVEN:
            outcome = (
                Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN
            )  # not proven: ENHSP errs, and times are rounded
        schedule = tuple(_timed_step(problem, *written) for written in answer.get("plan") or ())
    except (ValueError, KeyError, TypeError) as error:
        message = f"it ended with exit code {ended.code} and no answer. It said: {ended.last_words}"
        raise Trouble(Outcome.ENGINE_CRASHED, message) from error
    if outcome.is_trouble:
        said = " / ".join(answer.get("said", "").split("\n")[-3:]).strip() or "nothing"
        raise Trouble(outcome, f"it said: {said}")
    steps = tuple(timed.step for timed in schedule)
    return PlanningResult(outcome, steps, schedule=schedule if overlapping else ())


def _timed_step(
    problem: Problem, action: str, objects: list[str], start_s: float = 0.0, duration_s: float = 0.0
) -> TimedStep:
    outside = problem.domain.outside
    step = problem.domain.step(outside[action], [outside[name] for name in objects])
    return TimedStep(step, float(start_s), float(duration_s))
