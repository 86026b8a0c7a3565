"""The engine `label-setting` for those who plan with unified-planning itself; `register_engine` makes it known.

Imported late, as unified-planning is slow to import.
"""

import re
from collections.abc import Iterator, Mapping
from typing import IO, Any

from unified_planning import engines
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.exceptions import UPException
from unified_planning.model import ProblemKind
from unified_planning.plans import ActionInstance, SequentialPlan

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.engines.unified_planning import LABEL_SETTING
from rosa_pddl.exceptions import UnsupportedPddlError
from rosa_pddl.formulas import NUMBERS
from rosa_pddl.outcomes import Outcome, PlanningResult
from rosa_pddl.planner import Planner
from rosa_pddl.problem import Problem, initial_state
from rosa_pddl.reader import lineage_of, resources_of, schema_of
from rosa_pddl.resource_usage import sum_of

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
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


class LabelSetting(engines.Engine, OneshotPlannerMixin):  # type: ignore[misc]  # unified-planning ships no types
    """Plans of least cost within limits of resources, exactly.

    A resource is a numeric fluent without parameters that actions only increase, by sums of constants and of fluents
    that no action changes; the goal limits it by `LE(resource, limit)` or `LT`. Other numbers may be costs only.

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
        """Whether problems of a kind may be asked; of numbers only those named above are planned with."""
        return bool(problem_kind <= LabelSetting.supported_kind())

    @staticmethod
    def satisfies(optimality_guarantee: engines.OptimalityGuarantee) -> bool:
        return True

    @staticmethod
    def get_credits(**_: object) -> engines.Credits:
        summary = "Plans of least cost within limits of resources, by label setting"
        details = f"{summary}, on tasks that Fast Downward translates."
        return engines.Credits(LABEL_SETTING, "rosa-taca", "", "", "Apache-2.0", f"{summary}.", details)

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
        except UnsupportedPddlError as error:
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


def _domain_of(up_problem: UpThing) -> Domain:
    """Return a problem with instantaneous actions as a domain; the problem stays as it is."""
    where = f"problem {up_problem.name or 'without a name'}"
    read = up_problem.clone()
    inside, outside = _names(read, where)
    _fill_in_numbers(read, where)
    _check_numbers(read, where)
    schemas = {action.name: schema_of(action, outside, where) for action in read.actions}
    domain = Domain(
        name=str(up_problem.name),
        file=where,
        problem_file=where,
        rosa_actions=(),
        schemas=tuple(schemas),
        up_problem=read,
        schema_of=schemas,
        outside=outside,
        inside=inside,
        goals=(),
        places={},
        types={thing.name: tuple(lineage_of(thing.type, outside)) for thing in read.all_objects},
        resources=resources_of(read, outside),
    )
    _check_amounts(domain)
    return domain


def _names(read: UpThing, where: str) -> tuple[Mapping[tuple[str, str], str], Mapping[str, str]]:
    """Return the names by kind and what they are in lower case, and the names by themselves and in lower case."""
    kinds = {"predicate": read.fluents, "object": read.all_objects, "action": read.actions, "type": read.user_types}
    inside: dict[tuple[str, str], str] = {}
    outside = {thing.name: thing.name for things in kinds.values() for thing in things} | {"object": "object"}
    lower: dict[str, str] = {}
    for kind, things in kinds.items():
        for thing in things:
            name = thing.name
            if not _NAME.fullmatch(name):
                message = f"the {kind} {name!r} has no name of PDDL: a letter first, then letters, digits, '_' or '-'"
                raise UnsupportedPddlError(f"{message}; rename it", where)
            if kind != "type" and lower.setdefault(name.lower(), name) != name:
                message = f"{name!r} and {lower[name.lower()]!r} are the same to PDDL, which ignores case"
                raise UnsupportedPddlError(f"{message}; rename one", where)
            inside[kind, name.lower()] = name
    return inside, {**outside, **lower}


def _fill_in_numbers(read: UpThing, where: str) -> None:
    """State the numbers that are there by default."""
    try:
        values = read.initial_values
    except UPException as error:
        raise UnsupportedPddlError(f"a fluent has no value in the beginning: {error}", where) from error
    for expression, value in values.items():
        if not expression.type.is_bool_type():
            read.set_initial_value(expression, value)


def _check_numbers(read: UpThing, where: str) -> None:
    """Assure that what actions do with numbers is to add to such without arguments, and that no condition has any."""
    for action in read.actions:
        _refuse_numbers(action.preconditions, action.name, where)
        for effect in action.effects:
            if effect.fluent.type.is_bool_type():
                _refuse_numbers([effect.condition, effect.value], action.name, where)
            elif not effect.is_increase() or effect.fluent.args or effect.is_conditional() or effect.forall:
                message = f"the effect '{effect}' of {action.name} is not planned for; {NUMBERS}"
                raise UnsupportedPddlError(message, where)


def _refuse_numbers(formulas: list[UpThing], name: str, where: str) -> None:
    for formula in formulas:
        if any(_is_number(part) for part in _parts(formula)):
            raise UnsupportedPddlError(f"the condition '{formula}' of {name} computes with numbers; {NUMBERS}", where)


def _check_amounts(domain: Domain) -> None:
    """Assure that what is limited is used up, and that no amount depends on what actions change."""
    changed = {resource.fluent for resource in domain.resources}
    amounts = [amount for resource in domain.resources for amount in resource.uses.values()]
    amounts += [limit.amount for resource in domain.resources for limit in resource.limits]
    for metric in domain.up_problem.quality_metrics:
        if metric.is_minimize_action_costs():
            amounts += [cost for cost in map(metric.get_action_cost, domain.up_problem.actions) if cost is not None]
    for amount in amounts:
        sum_of(domain, amount)
        if changed & amount.environment.free_vars_extractor.get(amount):
            message = f"the amount '{amount}' depends on what actions change; {NUMBERS}"
            raise UnsupportedPddlError(message, domain.file)
    for goal in domain.up_problem.goals:
        _refuse_numbers([goal], "the goal", domain.file)


def _parts(formula: UpThing) -> Iterator[UpThing]:
    yield formula
    for part in formula.args:
        yield from _parts(part)


def _is_number(part: UpThing) -> bool:
    return bool(part.type.is_int_type() or part.type.is_real_type())
