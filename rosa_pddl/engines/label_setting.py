"""The engine `label-setting` for direct use with unified-planning, once `register_engine` has registered it.

This module is imported late, as unified-planning is slow to import.
"""

from typing import IO, Any

from unified_planning import engines
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.exceptions import UPException
from unified_planning.model import ProblemKind
from unified_planning.plans import SequentialPlan

from rosa_pddl.domain import Domain, Outcome, PlanningResult, Schema, UpThing, conjuncts, lineage_of
from rosa_pddl.engines import LABEL_SETTING, OUTCOMES
from rosa_pddl.exceptions import PddlError
from rosa_pddl.planner import Planner
from rosa_pddl.problem import Problem, initial_state
from rosa_pddl.syntax import NAME

_FEATURES = (
    *(
        "ACTION_BASED",
        "SIMPLE_NUMERIC_PLANNING",
        "GENERAL_NUMERIC_PLANNING",
        "FLAT_TYPING",
        "HIERARCHICAL_TYPING",
    ),
    *("NEGATIVE_CONDITIONS", "DISJUNCTIVE_CONDITIONS", "EQUALITIES", "EXISTENTIAL_CONDITIONS"),
    *("UNIVERSAL_CONDITIONS", "CONDITIONAL_EFFECTS", "FORALL_EFFECTS", "INCREASE_EFFECTS"),
    *("STATIC_FLUENTS_IN_NUMERIC_ASSIGNMENTS", "FLUENTS_IN_NUMERIC_ASSIGNMENTS"),
    *(
        "INT_FLUENTS",
        "REAL_FLUENTS",
        "ACTIONS_COST",
        "PLAN_LENGTH",
        "STATIC_FLUENTS_IN_ACTIONS_COST",
    ),
    *("FLUENTS_IN_ACTIONS_COST", "INT_NUMBERS_IN_ACTIONS_COST", "REAL_NUMBERS_IN_ACTIONS_COST"),
)
_STATUS = {outcome: engines.PlanGenerationResultStatus[name] for name, outcome in OUTCOMES.items()}
_LONG_S = 1e6


class LabelSetting(engines.Engine, OneshotPlannerMixin):  # type: ignore[misc]  # unified-planning ships no types
    """Finds plans of least cost; the goal may limit the resources, and numbers may rise and fall."""

    def __init__(self) -> None:
        engines.Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)

    @property
    def name(self) -> str:
        return LABEL_SETTING

    @staticmethod
    def supported_kind() -> ProblemKind:
        return ProblemKind(_FEATURES, version=2)

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        return bool(problem_kind <= LabelSetting.supported_kind())

    @staticmethod
    def satisfies(optimality_guarantee: engines.OptimalityGuarantee) -> bool:
        return True

    def _solve(
        self,
        problem: UpThing,
        heuristic: Any = None,  # noqa: ANN401  # the signature is unified-planning's
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
    ) -> engines.PlanGenerationResult:
        planner = Planner(
            LABEL_SETTING, _LONG_S if timeout is None else timeout, warm=False, cached=0
        )
        try:
            # unified-planning itself may only warn
            unsupported = ", ".join(
                sorted(problem.kind.features - self.supported_kind().features)
            ).lower()
            if unsupported:
                raise UPException(f"{LABEL_SETTING} does not support {unsupported}")
            domain = _domain_of(problem)
            result = planner.plan(Problem(domain, initial_state(domain)))
        except (PddlError, UPException) as error:
            result = PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        status = _STATUS.get(result.outcome, engines.PlanGenerationResultStatus.INTERNAL_ERROR)
        steps = [
            problem.action(one.schema)(*map(problem.object, one.arguments)) for one in result.steps
        ]
        plan = SequentialPlan(steps, problem.environment) if result.outcome.is_solved else None
        level = engines.LogLevel.ERROR if result.outcome.is_trouble else engines.LogLevel.INFO
        logs = [engines.LogMessage(level, result.message)] if result.message else []
        return engines.PlanGenerationResult(status, plan, self.name, log_messages=logs)


def _domain_of(problem: UpThing) -> Domain:
    """Convert a problem with instantaneous actions into a domain, without changing the problem."""
    where, stated = f"problem {problem.name or 'without a name'}", problem.clone()
    for one, value in problem.initial_values.items():
        stated.set_initial_value(one, value)
    kinds = ("type", "object", "predicate", "action")
    things = problem.user_types, problem.all_objects, problem.fluents, problem.actions
    names = [(kind, one.name) for kind, ones in zip(kinds, things, strict=True) for one in ones]
    inside = {("type", "object"): "object", **{(kind, name.lower()): name for kind, name in names}}
    for kind, name in names:
        if not NAME.fullmatch(name) or inside[kind, name.lower()] != name:
            message = f"found the {kind} {name!r}, expected a name of letters, digits, '_' and '-'"
            raise PddlError(f"{message}, and of no other in other capitals", where)
    costs = next((one for one in problem.quality_metrics if one.is_minimize_action_costs()), None)
    schemas = {}
    for one in problem.actions:
        parameters = tuple((each.name, each.type.name) for each in one.parameters)
        needs, cost = tuple(conjuncts(one.preconditions)), costs and costs.get_action_cost(one)
        schemas[one.name] = Schema(
            one.name, parameters, needs, (), (), (), tuple(one.effects), None, cost=cost
        )
    outside = {"object": "object", **{name: name for _, name in names}}
    return Domain(
        name="d",
        file=where,
        problem_file=where,
        up_problem=stated,
        schema_of=schemas,
        outside=outside,
        inside=inside,
        types={one.name: lineage_of(one.type, outside) for one in problem.all_objects},
        computed=frozenset(one.name for one in problem.fluents if not one.type.is_bool_type()),
        metric="" if costs is None else "cost",
    )
