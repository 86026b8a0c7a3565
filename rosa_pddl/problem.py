"""From what the knowledge base says and the mission senses to the problem that a planner gets."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from threading import RLock
from typing import TypeAlias
from weakref import WeakKeyDictionary

from rosa_pddl.domain import Domain, Feasibility, State, Step, UpThing, head_of
from rosa_pddl.exceptions import UnknownNameError, UnsupportedPddlError, nearest
from rosa_pddl.validate import text_of

Exact: TypeAlias = int | Fraction
"""A number that is added up and compared without rounding."""

# Below this a float that is whole is the whole number that is written.
_ALL_WHOLE = 2**53
_LOCKS: "WeakKeyDictionary[UpThing, UpThing]" = WeakKeyDictionary()


@dataclass(frozen=True)
class Problem:
    """What to plan: a goal from a state.

    Args:
        domain: what `load_domain` returned.
        state: the atoms that are true now, feasibility included.
        goals: what shall hold, as unified-planning expressions; by default the goal of the problem file.
        costs: values of numeric facts that costs, uses and limits of resources are made of, such as
            `{"(travel_cost a b)": 3.5}`, and of resources what was used up before, such as `{"(energy_used)": 120.0}`;
            the others are those of the problem file.
        weights: how many times its cost a step counts, such as one that has failed; 0 leaves it out.

    Raises:
        UnknownNameError: the costs name what the domain does not know, or what is no numeric fact.
    """

    domain: Domain
    state: State
    goals: tuple[UpThing, ...] | None = None
    costs: Mapping[str, float] = field(default_factory=dict, hash=False)
    weights: Mapping[Step, int] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        numeric = self.domain.numeric if self.costs else frozenset()
        for text in self.costs:
            head = head_of(self.domain.atom(text))
            if head not in numeric:
                raise UnknownNameError(f"{text!r} is no numeric fact of {self.domain.file}; {nearest(head, numeric)}")

    @property
    def wanted(self) -> tuple[UpThing, ...]:
        """The goals: its own, or else those of the domain's problem file."""
        return tuple(self.domain.up_problem.goals) if self.goals is None else self.goals

    def build(self) -> UpThing:
        """Make the same for unified-planning, with every action instantaneous; refuse a metric that this breaks."""
        problem = _sequential(self.domain)
        true = problem.environment.expression_manager.TRUE()
        for atom in sorted(self.state):
            problem.set_initial_value(self.domain.expression(atom), true)
        for text, value in sorted(self.costs.items()):
            expression = self.domain.expression(self.domain.atom(text))
            if problem.has_fluent(expression.fluent().name):
                problem.set_initial_value(expression, exact(value))
        for goal in (*self.wanted, *limits_of(self.domain)):
            problem.add_goal(goal)
        return problem


def exact(value: float | Fraction) -> Exact:
    """Return a number as it is written in decimals, so that sums are exact: 0.1 is a tenth."""
    if isinstance(value, int):
        return value
    if isinstance(value, float) and value.is_integer() and abs(value) < _ALL_WHOLE:
        return int(value)
    written = value if isinstance(value, Fraction) else Fraction(str(float(value)))
    return written.numerator if written.denominator == 1 else written


def lock_of(domain: Domain) -> UpThing:
    """Return the lock of a domain's environment: unified-planning's are not made for several threads at once."""
    return _LOCKS.setdefault(domain.up_problem.environment, RLock())


def unlock(domain: Domain) -> None:
    """Unlock what an interrupt may have left locked by this thread."""
    lock = lock_of(domain)
    with suppress(RuntimeError):  # so it is not locked by this one
        while True:
            lock.release()


def limits_of(domain: Domain) -> Iterator[UpThing]:
    manager = domain.up_problem.environment.expression_manager
    for resource in domain.limited:
        for limit in resource.limits:
            compare = manager.LT if limit.is_strict else manager.LE
            yield compare(resource.fluent, limit.amount)


def unlimited(domain: Domain) -> Domain:
    return replace(domain, resources=tuple(replace(one, limits=()) for one in domain.resources))


def initial_state(domain: Domain) -> State:
    """Return the facts that the problem file begins with, as it states feasibility itself."""
    values = domain.up_problem.explicit_initial_values.items()
    return frozenset(text_of(domain, expression, {}) for expression, value in values if value.is_true())


def feasible_atoms(domain: Domain, kb: Feasibility) -> State:
    """Return the facts `(action_feasible ?a)` as the knowledge base has them now."""
    if not domain.tracks_feasibility:
        return frozenset()
    return frozenset(domain.feasible_atom(action) for action in domain.rosa_actions if kb.is_feasible(action))


def without_feasibility(domain: Domain, state: State) -> State:
    """Return a state less its facts `(action_feasible ?a)`: those are the knowledge base's to say, never a plan's."""
    return frozenset(atom for atom in state if not domain.is_feasibility(atom))


def _sequential(domain: Domain) -> UpThing:
    """Make the problem without initial facts, its actions instantaneous."""
    from unified_planning.model import Problem as UpProblem

    read = domain.up_problem
    false = read.environment.expression_manager.FALSE()
    defaults = {read.environment.type_manager.BoolType(): false}
    problem = UpProblem(read.name, read.environment, initial_defaults=defaults)
    problem.add_objects(read.all_objects)
    has_numbers = action_costs(domain) is not None or bool(domain.limited)
    for fluent in read.fluents:
        # numbers that nothing needs would only keep engines from taking the problem
        if fluent.type.is_bool_type() or has_numbers:
            problem.add_fluent(fluent)
    for expression, value in read.explicit_initial_values.items():
        if not value.is_bool_constant() and has_numbers:
            problem.set_initial_value(expression, value)
    problem.add_actions([_instantaneous(action, domain) for action in read.actions])
    with_costs(domain, problem)
    return problem


def action_costs(domain: Domain) -> UpThing:
    """Return the action costs to minimise; None for the number of steps, which stands in for a makespan too."""
    metrics = domain.up_problem.quality_metrics
    if not metrics or metrics[0].is_minimize_makespan() or metrics[0].is_minimize_sequential_plan_length():
        return None
    if metrics[0].is_minimize_action_costs():
        return metrics[0]
    message = f"the metric '{metrics[0]}' cannot be planned for; expected none, (total-cost) or (total-time)"
    file, line = domain.places.get(("section", ":metric"), (domain.problem_file, None))
    raise UnsupportedPddlError(message, file, line)


def with_costs(domain: Domain, problem: UpThing) -> None:
    """Give a problem with actions of the same names the costs of a domain; unified-planning keeps them by action."""
    from unified_planning.model.metrics import MinimizeActionCosts

    given = action_costs(domain)
    if given is not None:
        costs = {problem.action(action.name): cost for action, cost in given.costs.items()}
        problem.clear_quality_metrics()
        problem.add_quality_metric(MinimizeActionCosts(costs, given.default, problem.environment))


def _instantaneous(action: UpThing, domain: Domain) -> UpThing:
    from unified_planning.exceptions import UPException
    from unified_planning.model import InstantaneousAction

    schema = domain.schema_of[domain.outside[action.name]]
    parameters = {parameter.name: parameter.type for parameter in action.parameters}
    made = InstantaneousAction(action.name, parameters, action.environment)
    # what its own effects at start make true is no condition; what those at end overwrite is no effect
    brought = {(one.fluent, one.value.is_true()) for one in schema.start_effects if _is_certain(one)}
    overwritten = {one.fluent for one in schema.end_effects if _is_certain(one)}
    later = (one for one in schema.over_all + schema.end if _literal(one) not in brought)
    lasting = (one for one in schema.start_effects if one.fluent not in overwritten)
    for condition in (*schema.start, *later):
        made.add_precondition(condition)
    try:
        for effect in (*lasting, *schema.end_effects):
            made.add_effect(effect.fluent, effect.value, effect.condition, effect.forall)
    except UPException as error:
        message = f"the effects of {schema.name} contradict one another when it is made instantaneous: {error}"
        file, line = domain.places.get(("action", schema.name), (domain.file, None))
        raise UnsupportedPddlError(message, file, line) from error
    for resource in domain.limited:
        if schema.name in resource.uses:
            made.add_increase_effect(resource.fluent, resource.uses[schema.name])
    return made


def _is_certain(effect: UpThing) -> bool:
    return bool(effect.condition.is_true()) and not effect.forall


def _literal(formula: UpThing) -> tuple[UpThing, bool]:
    return (formula.arg(0), False) if formula.is_not() else (formula, True)
