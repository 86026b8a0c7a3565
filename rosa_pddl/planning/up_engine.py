"""The engine `label-setting` for those who plan with unified-planning itself; `register_engine` makes it known.

Imported late, as unified-planning is slow to import.
"""

from typing import IO, Any

from unified_planning.engines import Credits, Engine, OptimalityGuarantee
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.engines.results import (
    LogLevel,
    LogMessage,
    PlanGenerationResult,
    PlanGenerationResultStatus,
)
from unified_planning.model import ProblemKind
from unified_planning.plans import ActionInstance, SequentialPlan

from rosa_pddl.domain import UpThing
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.planning.labelling import LABEL_SETTING
from rosa_pddl.planning.outcomes import Outcome, PlanningResult
from rosa_pddl.planning.planner import Planner
from rosa_pddl.planning.up_domain import domain_of
from rosa_pddl.problem import Problem, initial_state

__all__ = ["LabelSetting"]

_FEATURES = (
    *("ACTION_BASED", "SIMPLE_NUMERIC_PLANNING", "GENERAL_NUMERIC_PLANNING", "FLAT_TYPING", "HIERARCHICAL_TYPING"),
    *("NEGATIVE_CONDITIONS", "DISJUNCTIVE_CONDITIONS", "EQUALITIES", "EXISTENTIAL_CONDITIONS"),
    *("UNIVERSAL_CONDITIONS", "CONDITIONAL_EFFECTS", "FORALL_EFFECTS", "INCREASE_EFFECTS"),
    *("STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS", "FLUENTS_IN_BOOLEAN_ASSIGNMENTS"),
    *("STATIC_FLUENTS_IN_NUMERIC_ASSIGNMENTS", "FLUENTS_IN_NUMERIC_ASSIGNMENTS"),
    *("INT_FLUENTS", "REAL_FLUENTS", "ACTIONS_COST", "PLAN_LENGTH", "STATIC_FLUENTS_IN_ACTIONS_COST"),
    *("FLUENTS_IN_ACTIONS_COST", "INT_NUMBERS_IN_ACTIONS_COST", "REAL_NUMBERS_IN_ACTIONS_COST"),
)
_STATUS = {
    Outcome.SOLVED_OPTIMALLY: PlanGenerationResultStatus.SOLVED_OPTIMALLY,
    Outcome.UNSOLVABLE_PROVEN: PlanGenerationResultStatus.UNSOLVABLE_PROVEN,
    Outcome.OUT_OF_TIME: PlanGenerationResultStatus.TIMEOUT,
    Outcome.OUT_OF_MEMORY: PlanGenerationResultStatus.MEMOUT,
    Outcome.UNSUPPORTED: PlanGenerationResultStatus.UNSUPPORTED_PROBLEM,
}
_LONG_S = 1e6


class LabelSetting(Engine, OneshotPlannerMixin):  # type: ignore[misc]  # unified-planning ships no types
    """Plans of least cost within limits of resources, exactly.

    A resource is a numeric fluent without parameters that actions only increase, by sums of constants and of fluents
    that no action changes; the goal limits it by `LE(resource, limit)` or `LT`. Other numbers may be costs only.

    Args:
        memory_mb: how much data the search may hold [MB].
    """

    def __init__(self, memory_mb: int = 4096) -> None:
        Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)
        self._memory_mb = memory_mb

    @property
    def name(self) -> str:
        """Its name in unified-planning's factory."""
        return LABEL_SETTING

    @staticmethod
    def supported_kind() -> ProblemKind:
        """Return the features that problems may have."""
        return ProblemKind(_FEATURES, version=2)

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Whether problems of a kind may be asked; of numbers only those named above are planned with."""
        return bool(problem_kind <= LabelSetting.supported_kind())

    @staticmethod
    def satisfies(optimality_guarantee: OptimalityGuarantee) -> bool:
        """Whether it gives plans of least cost: it does."""
        return True

    @staticmethod
    def get_credits(**_: object) -> Credits:
        """Return who made it."""
        return Credits(
            LABEL_SETTING,
            "rosa-taca",
            "",
            "",
            "Apache-2.0",
            "Plans of least cost within limits of resources, by label setting.",
            "Plans of least cost within limits of resources, by label setting, on tasks that Fast Downward translates.",
        )

    def _solve(
        self,
        problem: UpThing,
        heuristic: Any = None,  # noqa: ANN401  # the signature is unified-planning's
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
    ) -> PlanGenerationResult:
        planner = Planner(
            LABEL_SETTING,
            timeout_s=_LONG_S if timeout is None else timeout,
            warm=False,
            memory_mb=self._memory_mb,
            cached=0,
        )
        try:
            domain = domain_of(problem)
            result = planner.plan(Problem(domain, initial_state(domain)))
        except UnsupportedPddlError as error:
            result = PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        status = _STATUS.get(result.outcome, PlanGenerationResultStatus.INTERNAL_ERROR)
        plan = _plan(problem, result) if result.outcome.is_solved else None
        level = LogLevel.ERROR if result.outcome.is_trouble else LogLevel.INFO
        logs = [LogMessage(level, result.message)] if result.message else []
        if output_stream is not None:
            output_stream.write(f"{result.message or result.outcome}\n")
        return PlanGenerationResult(status, plan, self.name, log_messages=logs)


def _plan(problem: UpThing, result: PlanningResult) -> SequentialPlan:
    manager = problem.environment.expression_manager
    instances = [
        ActionInstance(
            problem.action(step.schema), tuple(manager.ObjectExp(problem.object(name)) for name in step.arguments)
        )
        for step in result.steps
    ]
    return SequentialPlan(instances, problem.environment)
