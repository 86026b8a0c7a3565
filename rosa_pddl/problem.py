"""Builds the problem for a planner from what the knowledge base says and the mission senses."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import floor, isfinite
from numbers import Real
from threading import RLock
from weakref import WeakKeyDictionary

from rosa_pddl.domain import (
    ACTION_TYPE,
    Domain,
    Feasibility,
    Schema,
    State,
    Step,
    UpThing,
    exact,
    head_of,
    lineage_of,
    number_fact,
)
from rosa_pddl.exceptions import SensingError, UnknownNameError, UnsupportedPddlError, nearest
from rosa_pddl.syntax import NAME
from rosa_pddl.validate import text_of

_LOCKS: "WeakKeyDictionary[UpThing, UpThing]" = WeakKeyDictionary()


@dataclass(frozen=True)
class Problem:
    """A planning problem: the state to start from and the goals to reach.

    Args:
        domain: what `load_domain` returned.
        state: the atoms that are true now, feasibility included.
        goals: the goals, as unified-planning expressions; by default the goal of the problem file.
        costs: values of numeric facts that costs, uses and limits of resources depend on, such as
            `{"(travel_cost a b)": 3.5}`, and how much of a resource was used up before, such as
            `{"(energy_used)": 120.0}`; other values are those of the problem file.
        weights: factors on the costs of steps, such as steps that have failed; 0 leaves a step out.
        until: how much longer facts `(action_feasible ?a)` will hold by the forecasts [s]; no step that needs such a
            fact may end later. A fact that a step of the plan makes true holds from then on.
        shares: which share of its duration is left of each running step, if a plan begins with it.

    Raises:
        UnknownNameError: a key of `costs` is no numeric fact of the domain, or one of `until` no feasibility fact.
        SensingError: a time in `until` is not a finite number.
    """

    domain: Domain
    state: State
    goals: tuple[UpThing, ...] | None = None
    costs: Mapping[str, float] = field(default_factory=dict, hash=False)
    weights: Mapping[Step, int] = field(default_factory=dict, hash=False)
    until: Mapping[str, float] = field(default_factory=dict, hash=False)
    shares: Mapping[Step, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        numeric, costs = self.domain.numeric if self.costs else frozenset(), dict[str, float]()
        for text, value in self.costs.items():
            costs[self.domain.atom(text)] = value
            head = head_of(self.domain.atom(text))
            if head not in numeric:
                raise UnknownNameError(f"{text!r} is no numeric fact of {self.domain.file}; {nearest(head, numeric)}")
        if costs.keys() != self.costs.keys():
            object.__setattr__(self, "costs", costs)  # in the spelling of the files
        feasible = set(map(self.domain.feasible_atom, self.domain.rosa_actions)) if self.until else set()
        for text, left_s in self.until.items():
            if text not in feasible:
                raise UnknownNameError(f"{text!r} does not say that an action is feasible; {nearest(text, feasible)}")
            if not (isinstance(left_s, Real) and isfinite(left_s)):
                message = f"{text} is forecast to hold for {left_s!r} s, expected a finite number"
                raise SensingError(f"{message}; leave out what is not forecast to end")

    @property
    def wanted(self) -> tuple[UpThing, ...]:
        """The goals: its own, or else those of the domain's problem file."""
        return tuple(self.domain.up_problem.goals) if self.goals is None else self.goals

    def build(self, *, overlapping: bool = False) -> UpThing:
        """Build the problem for unified-planning; every action is instantaneous unless steps may overlap."""
        from unified_planning.model import GlobalStartTiming
        from unified_planning.model import Problem as UpProblem
        from unified_planning.model.metrics import MinimizeActionCosts, MinimizeMakespan

        domain, read = self.domain, self.domain.up_problem
        manager, environment = read.environment.expression_manager, read.environment
        defaults = {environment.type_manager.BoolType(): manager.FALSE()}
        problem = UpProblem(read.name, environment, initial_defaults=defaults)
        problem.add_objects([one for one in read.all_objects if domain.outside[one.name] in domain.types])
        # numbers that nothing needs are left out, as some engines refuse problems with numbers
        has_numbers = overlapping or domain.metric == "cost" or bool(domain.limits or domain.computed)
        problem.add_fluents([one for one in read.fluents if one.type.is_bool_type() or has_numbers])
        for expression, value in read.explicit_initial_values.items():
            is_there = all(problem.has_object(one.object().name) for one in expression.args)
            if not value.is_bool_constant() and has_numbers and is_there:
                problem.set_initial_value(expression, value)
        for fact in sorted(self.state):
            problem.set_initial_value(*domain.stated(fact))
        for text, number in sorted(self.costs.items()):
            expression = domain.expression(text)
            if problem.has_fluent(expression.fluent().name):
                problem.set_initial_value(expression, exact(number))
        for atom, left_s in self.until.items() if overlapping else ():
            # Aries counts in tenths of a second, and lets a step end a tenth after its condition has become false
            tenths = floor(10 * exact(left_s)) - 1
            if tenths > 0:
                when = GlobalStartTiming(Fraction(tenths, 10))
                problem.add_timed_effect(when, domain.expression(atom), manager.FALSE())
            else:
                problem.set_initial_value(domain.expression(atom), manager.FALSE())
        for goal in (*self.wanted, *domain.limits):
            problem.add_goal(_without_quantifiers(goal, problem) if overlapping else goal)
        actions = dict[UpThing, UpThing]()
        for one in domain.schema_of.values():
            is_timed = overlapping and one.duration is not None
            actions[_durative(one, domain, problem) if is_timed else _instantaneous(one, domain)] = one.cost
        problem.add_actions(actions)
        if domain.metric == "cost":
            costs = {action: cost for action, cost in actions.items() if cost is not None}
            problem.add_quality_metric(MinimizeActionCosts(costs, manager.Int(0), environment))
        elif domain.metric and overlapping:
            problem.add_quality_metric(MinimizeMakespan(environment))
        return problem


def lock_of(domain: Domain) -> UpThing:
    """Return the lock of a domain's unified-planning environment, which is not safe for several threads at once."""
    return _LOCKS.setdefault(domain.up_problem.environment, RLock())


def unlock(domain: Domain) -> None:
    """Release the lock of a domain if an interrupt has left it locked by this thread."""
    lock = lock_of(domain)
    with suppress(RuntimeError):  # this thread does not hold the lock
        while True:
            lock.release()


def with_object(domain: Domain, name: str, type_name: str) -> Domain:
    """Return a domain with one more object, about which it has no facts.

    Raises:
        UnknownNameError: there is no such type, the name is taken or not a PDDL name, or the object would be a ROSA
            action: only the knowledge base defines those.
    """
    kind = domain.inside.get(("type", type_name.lower()), type_name.lower())
    up_types = {one.name: one for one in domain.up_problem.user_types}
    if kind not in up_types:
        known = [domain.outside[one] for one in up_types]
        raise UnknownNameError(f"{domain.file} has no type {type_name!r} (of {name!r}); {nearest(type_name, known)}")
    lineage = lineage_of(up_types[kind], domain.outside)
    if ACTION_TYPE in lineage:
        raise UnknownNameError(f"{name!r} would be a ROSA action; those are added to the model and to {domain.file}")
    if not NAME.fullmatch(name) or ("object", name.lower()) in domain.inside:
        raise UnknownNameError(
            f"{name!r} cannot be added, expected a name that no object has: a letter, then letters, digits, '_' or '-'"
        )
    inside = name.lower()
    while inside in domain.outside:
        inside += "_object"
    problem = domain.up_problem.clone()
    problem.add_object(inside, up_types[kind])
    return replace(
        domain,
        up_problem=problem,
        inside={**domain.inside, ("object", name.lower()): inside},
        outside={**domain.outside, inside: name},
        types={**domain.types, name: lineage},
    )


def without_object(domain: Domain, name: str) -> Domain:
    """Return a domain without an object; UnknownObjectError if there is none, UnknownNameError for a ROSA action."""
    known = domain.spelling("object", name, name)
    if ACTION_TYPE in domain.types[known]:
        raise UnknownNameError(
            f"{known!r} is a ROSA action, which stays; the knowledge base says whether it is feasible"
        )
    inside = {key: one for key, one in domain.inside.items() if key != ("object", known.lower())}
    return replace(domain, inside=inside, types={one: above for one, above in domain.types.items() if one != known})


def initial_state(domain: Domain) -> State:
    """Return the initial facts of the problem file, with what the file itself states about feasibility."""
    facts = set[str]()
    for expression, value in domain.up_problem.explicit_initial_values.items():
        text = text_of(domain, expression, {})
        if value.is_true():
            facts.add(text)
        elif not value.is_bool_constant() and head_of(text) in domain.computed:
            facts.add(number_fact(text, exact(value.constant_value())))
    return frozenset(facts)


def feasible_atoms(domain: Domain, kb: Feasibility) -> State:
    """Return the facts `(action_feasible ?a)` that are true now by the knowledge base."""
    if not domain.tracks_feasibility:
        return frozenset()
    return frozenset(domain.feasible_atom(action) for action in domain.rosa_actions if kb.is_feasible(action))


def without_feasibility(domain: Domain, state: State) -> State:
    """Return a state without its facts `(action_feasible ?a)`, which the knowledge base decides, never a plan."""
    return frozenset(atom for atom in state if not domain.is_feasibility(atom))


def _without_quantifiers(formula: UpThing, problem: UpThing) -> UpThing:
    from unified_planning.model.walkers import ExpressionQuantifiersRemover

    return ExpressionQuantifiersRemover(problem.environment).remove_quantifiers(formula, problem).simplify()


def parameters_of(domain: Domain, schema: Schema) -> list[UpThing]:
    """Return the parameters of an action as unified-planning expressions."""
    from unified_planning.model import Parameter

    types, environment = {one.name: one for one in domain.up_problem.user_types}, domain.up_problem.environment
    kinds = ((name, types[domain.inside.get(("type", kind.lower()), kind.lower())]) for name, kind in schema.parameters)
    return [environment.expression_manager.ParameterExp(Parameter(name, kind, environment)) for name, kind in kinds]


def _made(kind: type, schema: Schema, domain: Domain) -> UpThing:
    parameters = {one.parameter().name: one.type for one in parameters_of(domain, schema)}
    return kind(domain.inside["action", schema.name.lower()], parameters, domain.up_problem.environment)


def _add_effects(action: UpThing, effects: Iterable[UpThing], *when: UpThing) -> None:
    for one in effects:
        kind = "" if one.is_assignment() else f"{one.kind.name.lower()}_"
        getattr(action, f"add_{kind}effect")(*when, one.fluent, one.value, one.condition, one.forall)


def _durative(schema: Schema, domain: Domain, problem: UpThing) -> UpThing:
    """Build a durative action of unified-planning.

    Few temporal engines know conditional effects, so conditional effects that make ROSA actions feasible are left out.
    """
    from unified_planning.model import DurativeAction, EndTiming, OpenTimeInterval, StartTiming

    made, start, end = _made(DurativeAction, schema, domain), StartTiming(), EndTiming()
    made.set_duration_constraint(schema.duration)
    whole = OpenTimeInterval(start, end)
    for when, conditions in ((start, schema.start), (whole, schema.over_all), (end, schema.end)):
        for condition in conditions:
            made.add_condition(when, _without_quantifiers(condition, problem))
    for when, effects in ((start, schema.start_effects), (end, schema.end_effects)):
        always = (one for one in effects if one.condition.is_true() or not domain.makes_feasible(one))
        _add_effects(made, always, when)
    for name in domain.limited:
        if name in schema.uses:
            made.add_increase_effect(end, domain.expression(f"({name})"), schema.uses[name])
    return made


def _instantaneous(schema: Schema, domain: Domain) -> UpThing:
    from unified_planning.exceptions import UPException
    from unified_planning.model import InstantaneousAction

    made = _made(InstantaneousAction, schema, domain)
    # conditions that the start effects make true are dropped, and start effects that the end effects overwrite
    brought = {(one.fluent, one.value.is_true()) for one in schema.start_effects if _is_certain(one)}
    overwritten = {one.fluent for one in schema.end_effects if _is_certain(one) and one.is_assignment()}
    after = {one.fluent: _after(one) for one in schema.start_effects if not one.fluent.fluent().type.is_bool_type()}
    later = (one.substitute(after) for one in schema.over_all + schema.end if _literal(one) not in brought)
    lasting = (one for one in schema.start_effects if one.fluent not in overwritten)
    for condition in (*schema.start, *later):
        made.add_precondition(condition)
    try:
        _add_effects(made, (*lasting, *schema.end_effects))
    except UPException as error:
        message = f"the effects of {schema.name} contradict one another when it is made instantaneous: {error}"
        file, line = domain.places.get(("action", schema.name), (domain.file, None))
        raise UnsupportedPddlError(message, file, line) from error
    for name in domain.limited:
        if name in schema.uses:
            made.add_increase_effect(domain.expression(f"({name})"), schema.uses[name])
    return made


def _is_certain(effect: UpThing) -> bool:
    return bool(effect.condition.is_true()) and not effect.forall


def _after(effect: UpThing) -> UpThing:
    manager, fluent = effect.environment.expression_manager, effect.fluent
    if effect.is_assignment():
        return effect.value
    return (manager.Plus if effect.is_increase() else manager.Minus)(fluent, effect.value)


def _literal(formula: UpThing) -> tuple[UpThing, bool]:
    return (formula.arg(0), False) if formula.is_not() else (formula, True)
