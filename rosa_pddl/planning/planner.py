"""The planner: several ways tried in order, each with its own budget; whatever happens, the outcome has a name."""

import threading
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

from rosa_pddl.domain import Domain, Step
from rosa_pddl.exceptions import PlannerSettingError, UnknownNameError, nearest
from rosa_pddl.planning.cache import PlanCache
from rosa_pddl.planning.engines import missing
from rosa_pddl.planning.grounding import Grounding, Groundings
from rosa_pddl.planning.labelling import TRANSLATED
from rosa_pddl.planning.outcomes import Attempt, Outcome, PlanningResult
from rosa_pddl.planning.processes import Cut, Leash
from rosa_pddl.planning.trial import Settings, Trial
from rosa_pddl.problem import Problem

__all__ = ["Planner"]

_MEGABYTE = 1 << 20


class Planner:
    """Plans with Fast Downward, within limits with `label-setting`, and with engines of unified-planning.

    Tried in order, until one says that there is a plan, or proves that there is none:

    - `warm` (not other engines): the task was translated once, only state, goal and numbers are put in and searched;
    - `cold` (not other engines): the task is translated and searched;
    - each engine of unified-planning that is named, in a process of its own.

    `fast-downward-opt` is A*: the plan has the least cost, or the fewest steps if there is no metric. `fast-downward`
    is quicker on large tasks and gives some plan. `label-setting` gives the plan of least cost that keeps to the limits
    of the domain's resources; it is exact. Every plan is replayed before it is returned.

    Args:
        engine: `fast-downward-opt`, `fast-downward`, `label-setting`, or a name of unified-planning's factory, such as
            `aries`.
        timeout_s: wall-clock time for everything that is tried [s]; then what runs is killed. Each way may take half
            of what is left, the last all of it, unless `budgets_s` says otherwise.
        fallback: engines of unified-planning to try afterwards; those that are not installed are passed over.
        budgets_s: wall-clock time for single ways [s], by their names.
        overlapping: whether steps may overlap: the engine gets durations, and the plan is a schedule. It must be a
            temporal engine of unified-planning, such as `aries`.
        safe_step: what to do while there is no plan, such as `(surface)`.
        warm: whether Fast Downward is tried on a task that was translated before.
        memory_mb: how much data each program may hold [MB].
        translate_s: wall-clock time for the translation that the warm way needs once [s]. It goes on beside everything
            else when a planning that waited for it is out of time.
        cached: how many answers are remembered; 0 for none.

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
        memory_mb: int = 4096,
        translate_s: float = 60.0,
        cached: int = 256,
    ) -> None:
        self.engine = engine
        self.timeout_s = timeout_s
        own = (("warm",) if warm else ()) + ("cold",) if engine in TRANSLATED else (engine,)
        memory_bytes = memory_mb * _MEGABYTE
        self._settings = Settings(
            engine, (*own, *fallback), timeout_s, dict(budgets_s or {}), overlapping, memory_bytes
        )
        _check(self._settings)
        self._safe_step = safe_step
        self._groundings = Groundings(translate_s, memory_bytes)
        self._cache = PlanCache(cached)
        self._leashes: set[Leash] = set()

    def missing(self, domain: Domain) -> str | None:
        """Return what to install if the engine is not there, None if it is; asked before a mission begins."""
        return missing(self.engine, domain)

    def prepare(self, problem: Problem, changing: Iterable[str] = ()) -> None:
        """Begin to translate, beside everything else; without this it begins with the first planning.

        Args:
            problem: the state that the mission begins with.
            changing: atoms that may change though no action changes them, such as those that are sensed.

        Raises:
            UnknownNameError: an atom is not one of the domain.
        """
        if "warm" in self._settings.ways and self.missing(problem.domain) is None:
            self._groundings.ask(problem, [problem.domain.atom(text) for text in changing])

    def plan(self, problem: Problem) -> PlanningResult:
        """Plan now and wait for the answer; trouble with an engine is an outcome, never an exception."""
        grounding, safe = self._ask(problem), self._safe(problem.domain)
        return self._planned(problem, grounding, Leash(), safe)

    def start(self, problem: Problem) -> "Future[PlanningResult]":
        """Plan in a thread of its own. Cancelling the future kills the engine's processes."""
        future: Future[PlanningResult] = Future()
        leash = Leash()
        future.add_done_callback(lambda done: leash.cut() if done.cancelled() else None)
        # what is translated must depend on the order of questions only, so it is asked for here and now
        grounding, safe = self._ask(problem), self._safe(problem.domain)

        def work() -> None:
            result = self._planned(problem, grounding, leash, safe)
            # the future counts as running only now, as a running one could not be cancelled
            if future.set_running_or_notify_cancel():
                future.set_result(result)

        threading.Thread(target=work, name=f"planner {self.engine}", daemon=True).start()
        return future

    def close(self) -> None:
        """End every program that still runs for this planner, and forget what was prepared."""
        self._groundings.close()
        for leash in tuple(self._leashes):
            leash.cut()

    def _ask(self, problem: Problem) -> Grounding | None:
        if "warm" not in self._settings.ways or self.missing(problem.domain) is not None:
            return None
        return self._groundings.ask(problem)

    def _safe(self, domain: Domain) -> Step | None:
        if self._safe_step is None:
            return None
        words = self._safe_step.strip().removeprefix("(").removesuffix(")").split()
        schemas = {name.lower(): name for name in domain.schemas}
        if not words or words[0].lower() not in schemas:
            hint = nearest(words[0] if words else "", domain.schemas)
            raise UnknownNameError(f"the safe step {self._safe_step!r} is no action of {domain.file}; {hint}")
        schema = domain.schema_of[schemas[words[0].lower()]]
        if len(words) - 1 != len(schema.parameters):
            expected = " ".join(f"?{name}" for name, _ in schema.parameters)
            raise UnknownNameError(f"the safe step {self._safe_step!r} is not of the form ({schema.name} {expected})")
        return domain.step(schema.name, [_object(domain, word) for word in words[1:]])

    def _planned(
        self, problem: Problem, grounding: Grounding | None, leash: Leash, safe: Step | None
    ) -> PlanningResult:
        # of equally good plans another may be found once the task is translated anew
        known = self._cache.get(problem, grounding)
        if known is not None:
            return replace(known, attempts=(Attempt("cache", known.outcome),))
        self._leashes.add(leash)
        try:
            result = Trial(self._settings, problem, grounding, leash, safe).result()
        except Cut:
            return PlanningResult(Outcome.ENGINE_CRASHED, engine=self.engine, message="the planner was closed")
        finally:
            self._leashes.discard(leash)
        if not result.outcome.is_trouble and not result.hangs_on_the_clock:
            self._cache.put(problem, result, grounding)
        return result


def _object(domain: Domain, word: str) -> str:
    if ("object", word.lower()) not in domain.inside:
        raise UnknownNameError(f"{domain.file} has no object {word!r}; {nearest(word, domain.types)}")
    return domain.outside[domain.inside["object", word.lower()]]


def _check(settings: Settings) -> None:
    sequential = [name for name in (settings.engine, *settings.ways) if name in TRANSLATED]
    if settings.overlapping and sequential:
        message = f"{sequential[0]} plans one step after the other; for overlapping steps use a temporal engine"
        raise PlannerSettingError(f"{message} such as 'aries' (pip install 'rosa-taca[temporal]')")
    for way, budget_s in settings.budgets_s.items():
        if way not in settings.ways:
            hint = nearest(way, settings.ways)
            raise PlannerSettingError(f"a budget is given for {way!r}, which is not among what is tried; {hint}")
        if not budget_s > 0.0:
            raise PlannerSettingError(f"the budget of {way!r} is {budget_s:g} s, expected more than 0")
    if not settings.timeout_s > 0.0:
        raise PlannerSettingError(f"timeout_s is {settings.timeout_s:g}, expected more than 0")
