"""The engine `label-setting` for those who plan with unified-planning itself; `register_engine` makes it known.

Imported late, as unified-planning is slow to import. A problem is put into the words of PDDL and read as files are, so
what may be planned for, and what is refused, is the same.
"""

from collections.abc import Iterable, Iterator
from typing import IO, Any

from unified_planning import engines
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.exceptions import UPException
from unified_planning.model import ProblemKind
from unified_planning.plans import ActionInstance, SequentialPlan

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.engines.unified_planning import LABEL_SETTING
from rosa_pddl.exceptions import PddlError
from rosa_pddl.outcomes import Outcome, PlanningResult
from rosa_pddl.planner import Planner
from rosa_pddl.problem import Problem, initial_state
from rosa_pddl.reader import build_domain
from rosa_pddl.syntax import Node, Source, formula, listed
from rosa_pddl.validate import text_of

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
    Outcome.SOLVED_OPTIMALLY: engines.PlanGenerationResultStatus.SOLVED_OPTIMALLY,
    Outcome.UNSOLVABLE_PROVEN: engines.PlanGenerationResultStatus.UNSOLVABLE_PROVEN,
    Outcome.OUT_OF_TIME: engines.PlanGenerationResultStatus.TIMEOUT,
    Outcome.OUT_OF_MEMORY: engines.PlanGenerationResultStatus.MEMOUT,
    Outcome.UNSUPPORTED: engines.PlanGenerationResultStatus.UNSUPPORTED_PROBLEM,
}
_LONG_S = 1e6


class LabelSetting(engines.Engine, OneshotPlannerMixin):  # type: ignore[misc]  # unified-planning ships no types
    """Plans of least cost, exactly; what actions use up may be limited by the goal, and numbers may rise and fall.

    Args:
        memory_mb: how much data the search may hold [MB].
    """

    def __init__(self, memory_mb: int = 4096) -> None:
        engines.Engine.__init__(self)
        OneshotPlannerMixin.__init__(self)
        self._memory_mb = memory_mb

    @property
    def name(self) -> str:
        return LABEL_SETTING

    @staticmethod
    def supported_kind() -> ProblemKind:
        return ProblemKind(_FEATURES, version=2)

    @staticmethod
    def supports(problem_kind: ProblemKind) -> bool:
        """Whether problems of a kind may be asked."""
        return bool(problem_kind <= LabelSetting.supported_kind())

    @staticmethod
    def satisfies(optimality_guarantee: engines.OptimalityGuarantee) -> bool:
        return True

    @staticmethod
    def get_credits(**_: object) -> engines.Credits:
        summary = "Plans of least cost within limits of resources, by label setting."
        return engines.Credits(LABEL_SETTING, "rosa-taca", "", "", "Apache-2.0", summary, summary)

    def _solve(
        self,
        problem: UpThing,
        heuristic: Any = None,  # noqa: ANN401  # the signature is unified-planning's
        timeout: float | None = None,
        output_stream: IO[str] | None = None,
    ) -> engines.PlanGenerationResult:
        timeout_s = _LONG_S if timeout is None else timeout
        planner = Planner(LABEL_SETTING, timeout_s, warm=False, memory_mb=self._memory_mb, cached=0)
        try:
            domain = _domain_of(problem)
            result = planner.plan(Problem(domain, initial_state(domain)))
        except (PddlError, UPException) as error:
            result = PlanningResult(Outcome.UNSUPPORTED, message=str(error))
        status = _STATUS.get(result.outcome, engines.PlanGenerationResultStatus.INTERNAL_ERROR)
        plan = _plan(problem, result) if result.outcome.is_solved else None
        level = engines.LogLevel.ERROR if result.outcome.is_trouble else engines.LogLevel.INFO
        logs = [engines.LogMessage(level, result.message)] if result.message else []
        if output_stream is not None:
            output_stream.write(f"{result.message or result.outcome}\n")
        return engines.PlanGenerationResult(status, plan, self.name, log_messages=logs)


def _plan(problem: UpThing, result: PlanningResult) -> SequentialPlan:
    manager = problem.environment.expression_manager
    instances = []
    for step in result.steps:
        arguments = tuple(manager.ObjectExp(problem.object(name)) for name in step.arguments)
        instances.append(ActionInstance(problem.action(step.schema), arguments))
    return SequentialPlan(instances, problem.environment)


def _domain_of(problem: UpThing) -> Domain:
    """Return a problem with instantaneous actions as a domain; the problem stays as it is."""
    where = f"problem {problem.name or 'without a name'}"
    costs = next((one for one in problem.quality_metrics if one.is_minimize_action_costs()), None)
    predicates = [one for one in problem.fluents if one.type.is_bool_type()]
    numbers = [one for one in problem.fluents if not one.type.is_bool_type()]
    values = [(_node(one), value) for one, value in problem.initial_values.items()]
    domain = listed(
        "define",
        listed("domain", "d"),
        listed(":types", *(word for one in problem.user_types for word in (one.name, "-", _above(one)))),
        listed(":constants", *_typed(problem.all_objects)),
        listed(":predicates", *(listed(one.name, *_typed(one.signature, "?")) for one in predicates)),
        listed(":functions", *(listed(one.name, *_typed(one.signature, "?")) for one in numbers), listed("total-cost")),
        *(_action(one, costs and costs.get_action_cost(one)) for one in problem.actions),
    )
    stated = listed(
        "define",
        listed("problem", str(problem.name)),
        listed(":domain", "d"),
        listed(":init", *(atom for atom, value in values if value.is_true()), *_numbers(values)),
        listed(":goal", listed("and", *map(_node, problem.goals))),
        *([listed(":metric", "minimize", listed("total-cost"))] if costs else []),
    )
    return build_domain(Source(where, domain), Source(where, stated))


def _above(kind: UpThing) -> str:
    return str(kind.father.name) if kind.father else "object"


def _numbers(values: Iterable[tuple[Node | str, UpThing]]) -> Iterator[Node]:
    yield from (listed("=", atom, _node(value)) for atom, value in values if not value.is_bool_constant())


def _typed(things: Iterable[UpThing], mark: str = "") -> Iterator[str]:
    for one in things:
        yield from (mark + one.name, "-", one.type.name)


def _action(action: UpThing, cost: UpThing) -> Node:
    numeric = [effect for effect in action.effects if not effect.fluent.type.is_bool_type()]
    effects = [formula(text, action.name) for effect in action.effects for text in _literals_of(effect)]
    for effect in numeric:
        change = listed(effect.kind.name.lower(), _node(effect.fluent), _node(effect.value))
        change = change if effect.condition.is_true() else listed("when", _node(effect.condition), change)
        effects.append(listed("forall", listed(*_typed(effect.forall, "?")), change) if effect.forall else change)
    if cost is not None:
        effects.append(listed("increase", listed("total-cost"), _node(cost)))
    needed = listed("and", *map(_node, action.preconditions))
    parameters = listed(*_typed(action.parameters, "?"))
    parts = (":parameters", parameters, ":precondition", needed, ":effect", listed("and", *effects))
    return listed(":action", action.name, *parts)


def _node(expression: UpThing) -> Node | str:
    text = _formula_of(expression)
    return formula(text, text) if text.startswith("(") else text


def _literals_of(effect: UpThing) -> Iterator[str]:
    """Write what an effect makes true and what it makes false, on their conditions; nothing for a number."""
    if not effect.fluent.type.is_bool_type():
        return
    atom, value = _formula_of(effect.fluent), effect.value
    for truth, literal in ((True, atom), (False, f"(not {atom})")):
        needed = [] if effect.condition.is_true() else [_formula_of(effect.condition)]
        if value.is_bool_constant():
            if bool(value.constant_value()) is not truth:
                continue
        else:
            needed.append(_formula_of(value) if truth else f"(not {_formula_of(value)})")
        text = f"(when (and {' '.join(needed)}) {literal})" if needed else literal
        yield f"(forall ({' '.join(_typed(effect.forall, '?'))}) {text})" if effect.forall else text


def _formula_of(formula: UpThing) -> str:
    """Write a formula in the names of unified-planning's problem."""
    return text_of(None, formula, {})
