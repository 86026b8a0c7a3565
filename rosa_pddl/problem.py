"""Builds the problem for a planner from what the knowledge base says and the mission senses."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import chain, product
from math import floor, isfinite
from numbers import Real
from threading import RLock
from weakref import WeakKeyDictionary

from rosa_pddl.domain import (
    ACTION_TYPE,
    Derived,
    Domain,
    Feasibility,
    Schema,
    State,
    Step,
    UpThing,
    atoms_in,
    exact,
    fluents_in,
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
        SensingError: a value of `costs` is no number, or a time in `until` is not a finite one.
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
            if not isinstance(value, Real):
                raise SensingError(f"{text} is {value!r}, expected a number")
            costs[self.domain.atom(text)] = value
            head = head_of(self.domain.atom(text))
            if head not in numeric:
                raise UnknownNameError(
                    f"{text!r} is no numeric fact of {self.domain.file}; {nearest(head, numeric)}"
                )
        if costs.keys() != self.costs.keys():
            object.__setattr__(self, "costs", costs)  # in the spelling of the files
        feasible = self.domain.feasibility
        for text, left_s in self.until.items():
            if text not in feasible:
                raise UnknownNameError(
                    f"{text!r} does not say that an action is feasible; {nearest(text, feasible)}"
                )
            if not (isinstance(left_s, Real) and isfinite(left_s)):
                message = f"{text} is forecast to hold for {left_s!r} s, expected a finite number"
                raise SensingError(f"{message}; leave out what is not forecast to end")

    @property
    def wanted(self) -> tuple[UpThing, ...]:
        """The goals: its own, or else those of the domain's problem file."""
        return tuple(self.domain.up_problem.goals) if self.goals is None else self.goals

    def build(self, *, overlapping: bool = False) -> UpThing:
        """Build the problem for unified-planning; every action is instantaneous unless steps may overlap."""
        from unified_planning.model import EndTiming, GlobalStartTiming
        from unified_planning.model import Problem as UpProblem
        from unified_planning.model.metrics import MinimizeActionCosts, MinimizeMakespan

        domain, read = self.domain, self.domain.up_problem
        manager, environment = read.environment.expression_manager, read.environment
        defaults = {environment.type_manager.BoolType(): manager.FALSE()}
        problem = UpProblem(read.name, environment, initial_defaults=defaults)
        problem.add_objects(
            [one for one in read.all_objects if domain.outside[one.name] in domain.types]
        )
        # numbers that nothing needs are left out, as some engines refuse problems with numbers
        has_numbers = (
            overlapping or domain.metric == "cost" or bool(domain.limits or domain.computed)
        )
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
            made = (_durative if is_timed else _instantaneous)(one, domain, problem)
            for name in (each for each in domain.limited if each in one.uses):
                made.add_increase_effect(
                    *[EndTiming()] * is_timed, domain.expression(f"({name})"), one.uses[name]
                )
            actions[made] = one.cost
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
    spelled = domain.spelling("type", type_name, f"{name} - {type_name}")
    kind = domain.up_problem.user_type(domain.inside["type", spelled.lower()])
    lineage = lineage_of(kind, domain.outside)
    if ACTION_TYPE in lineage:
        raise UnknownNameError(
            f"{name!r} would be a ROSA action; those are added to the model and to {domain.file}"
        )
    if not NAME.fullmatch(name) or ("object", name.lower()) in domain.inside:
        raise UnknownNameError(
            f"{name!r} cannot be added, expected a name that no object has: a letter, then letters, digits, '_' or '-'"
        )
    inside = name.lower()
    while inside in domain.outside:
        inside += "_object"
    problem = domain.up_problem.clone()
    problem.add_object(inside, kind)
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
    return replace(
        domain,
        inside=inside,
        types={one: above for one, above in domain.types.items() if one != known},
    )


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
    return frozenset(atom for atom, action in domain.feasibility.items() if kb.is_feasible(action))


def without_feasibility(domain: Domain, state: State) -> State:
    """Return a state without its facts `(action_feasible ?a)`, which the knowledge base decides, never a plan."""
    return frozenset(atom for atom in state if not domain.is_feasibility(atom))


def _without_quantifiers(formula: UpThing, problem: UpThing) -> UpThing:
    from unified_planning.model.walkers import ExpressionQuantifiersRemover

    return (
        ExpressionQuantifiersRemover(problem.environment)
        .remove_quantifiers(formula, problem)
        .simplify()
    )


def parameters_of(domain: Domain, schema: Schema) -> list[UpThing]:
    """Return the parameters of an action as unified-planning expressions."""
    from unified_planning.model import Parameter

    environment, type_of = domain.up_problem.environment, domain.up_problem.user_type
    kinds = (
        (name, type_of(domain.inside["type", kind.lower()])) for name, kind in schema.parameters
    )
    return [
        environment.expression_manager.ParameterExp(Parameter(name, kind, environment))
        for name, kind in kinds
    ]


def _made(kind: type, schema: Schema, domain: Domain) -> UpThing:
    parameters = {one.parameter().name: one.type for one in parameters_of(domain, schema)}
    return kind(
        domain.inside["action", schema.name.lower()], parameters, domain.up_problem.environment
    )


def _add_effects(action: UpThing, effects: Iterable[UpThing], *when: UpThing) -> None:
    for one in effects:
        kind = "" if one.is_assignment() else f"{one.kind.name.lower()}_"
        getattr(action, f"add_{kind}effect")(
            *when, one.fluent, one.value, one.condition, one.forall
        )


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
        always = (
            one for one in effects if one.condition.is_true() or not domain.makes_feasible(one)
        )
        _add_effects(made, always, when)
    return made


def _instantaneous(schema: Schema, domain: Domain, problem: UpThing) -> UpThing:
    """Build an action whose conditions and effects are those of a step beside which nothing else happens."""
    from unified_planning.exceptions import UPException
    from unified_planning.model import InstantaneousAction

    made, start = _made(InstantaneousAction, schema, domain), _Start(schema, domain, problem)
    for condition in (*schema.start, *map(start.after, (*schema.over_all, *schema.end))):
        made.add_precondition(condition)
    ends = [effect for one in schema.end_effects for effect in start.effects_after(one)]
    lasting = (kept for one in start.effects for kept in _not_overwritten(one, ends))
    try:
        _add_effects(made, (one for one in (*lasting, *ends) if not one.condition.is_false()))
    except UPException as error:
        message = f"the effects of {schema.name} contradict one another when it is made instantaneous: {error}"
        file, line = domain.places.get(("action", schema.name), (domain.file, None))
        raise UnsupportedPddlError(message, file, line) from error
    return made


def with_starts(domain: Domain, problem: UpThing) -> Domain:
    """Return a domain that also defines the derived predicates by which `build` says what holds after steps' starts."""
    schemas = domain.schema_of.values() if domain.axioms else ()
    late = {
        name: one for schema in schemas for name, one in _Start(schema, domain, problem).axioms()
    }
    return replace(
        domain,
        axioms={**domain.axioms, **late},
        inside={**domain.inside, **{("predicate", name): name for name in late}},
        outside={**domain.outside, **{name: name for name in late}},
    )


class _Start:
    """The start of an action: says what formulas are after it, in terms of the state before it.

    What a derived predicate `bright` is after the start of `light` is a derived predicate too, `bright@light`, which
    also has those parameters of the action on which that depends.
    """

    def __init__(self, schema: Schema, domain: Domain, problem: UpThing) -> None:
        self._schema, self._domain, self._problem = schema, domain, problem
        # what becomes true wins
        self.effects = sorted(schema.start_effects, key=lambda one: bool(one.value.is_true()))
        self._changed = fluents_in(one.fluent for one in self.effects)
        rules = {
            problem.fluent(domain.inside["predicate", name]): one
            for name, one in domain.axioms.items()
        }
        made_of = {fluent: fluents_in([one.condition]) for fluent, one in rules.items()}
        late = [*schema.over_all, *schema.end, *(one.condition for one in schema.end_effects)]
        asked = fluents_in(late if rules else ())
        for _ in rules:
            self._changed |= {
                fluent for fluent, parts in made_of.items() if not parts.isdisjoint(self._changed)
            }
            asked |= {part for fluent in asked & made_of.keys() for part in made_of[fluent]}
        self._derived = {
            fluent: one for fluent, one in rules.items() if fluent in self._changed & asked
        }
        known = [one for one in self.effects if self._derived and one.fluent.fluent() in asked]
        parts = [part for one in known for part in (one.fluent, one.condition, one.value)]
        self._parameters = tuple(dict.fromkeys(chain.from_iterable(map(_parameters_in, parts))))

    def after(self, formula: UpThing) -> UpThing:
        """Return the condition on which a condition holds after the start."""
        if not self._may_change(formula):
            return formula
        manager = self._problem.environment.expression_manager
        return manager.Or([manager.And(*case) for case in self.cases(formula)]).simplify()

    def effects_after(self, effect: UpThing) -> Iterator[UpThing]:
        """Yield what an effect at the end is, in terms of the state before the start: one effect for each case."""
        from unified_planning.model import Effect

        if not (self._may_change(effect.condition) or self._may_change(effect.value)):
            yield effect
            return
        condition, both = (
            self.after(effect.condition),
            self._problem.environment.expression_manager.And,
        )
        for given, value in self.cases(effect.value):
            yield Effect(
                effect.fluent, value, both(condition, given).simplify(), effect.kind, effect.forall
            )

    def cases(self, formula: UpThing) -> Iterator[tuple[UpThing, UpThing]]:
        """Yield what a formula is after the start: the condition for each case first."""
        if not self._may_change(formula):
            yield self._problem.environment.expression_manager.TRUE(), formula
            return
        plain = _without_quantifiers(formula, self._problem)
        atoms = dict.fromkeys(atoms_in([plain]))
        derived = {
            atom: self._derived_after(atom) for atom in atoms if atom.fluent() in self._derived
        }
        cases = [(self._problem.environment.expression_manager.TRUE(), derived)]
        for atom, one in product(atoms, self.effects):
            hit = _hit(one, atom)
            if not hit.is_false():
                cases = [
                    found
                    for given, values in cases
                    for found in _split(one, atom, hit, given, values)
                ]
        for given, values in cases:
            yield given, plain.substitute(values)

    def axioms(self) -> Iterator[tuple[str, Derived]]:
        """Yield the definitions of what derived predicates are after the start; they are derived after all others."""
        from unified_planning.model import Variable

        manager, environment = (
            self._problem.environment.expression_manager,
            self._problem.environment,
        )
        own = {
            one: manager.VariableExp(Variable(f"?{one.parameter().name}", one.type, environment))
            for one in self._parameters
        }
        for fluent, one in self._derived.items():
            variables, layer = (*one.variables, *own.values()), len(self._domain.axioms) + one.layer
            yield (
                self._name_after(fluent),
                Derived(variables, self.after(one.condition).substitute(own), layer),
            )

    def _may_change(self, formula: UpThing) -> bool:
        return bool(self._changed) and not self._changed.isdisjoint(fluents_in([formula]))

    def _derived_after(self, atom: UpThing) -> UpThing:
        from unified_planning.model import Fluent

        kinds = {f"?{one.parameter().name}": one.type for one in self._parameters}
        signature = {**{one.name: one.type for one in atom.fluent().signature}, **kinds}
        fluent = Fluent(
            self._name_after(atom.fluent()), atom.type, environment=atom.environment, **signature
        )
        return fluent(*atom.args, *self._parameters)

    def _name_after(self, fluent: UpThing) -> str:
        return (
            f"{self._domain.outside[fluent.name]}@{self._schema.name}"  # no name of a file has an @
        )


def _parameters_in(formula: UpThing) -> Iterator[UpThing]:
    if formula.is_parameter_exp():
        yield formula
    for part in formula.args:
        yield from _parameters_in(part)


def _split(
    effect: UpThing, atom: UpThing, hit: UpThing, given: UpThing, values: dict[UpThing, UpThing]
) -> Iterator[tuple[UpThing, dict[UpThing, UpThing]]]:
    """Yield the cases into which an effect that may change an atom or a number splits a case."""
    manager, before = atom.environment.expression_manager, values.get(atom, atom)
    if atom.fluent().type.is_bool_type():
        held = (
            manager.Or(before, hit)
            if effect.value.is_true()
            else manager.And(before, manager.Not(hit))
        )
        yield given, {**values, atom: held}
        return
    if not hit.is_true():
        yield manager.And(given, manager.Not(hit)), values
    now = effect.value
    if not effect.is_assignment():
        now = (manager.Plus if effect.is_increase() else manager.Minus)(before, now)
    yield manager.And(given, hit), {**values, atom: now}


def _hit(effect: UpThing, atom: UpThing) -> UpThing:
    """Return the condition on which an effect changes an atom or a number."""
    from unified_planning.model import Variable

    manager = atom.environment.expression_manager
    if effect.fluent.fluent() != atom.fluent():
        return manager.FALSE()
    # the variables of the effect get names that the atom cannot have
    fresh = {one: Variable(f"{one.name}.", one.type, atom.environment) for one in effect.forall}
    fluent, condition = effect.fluent.substitute(fresh), effect.condition.substitute(fresh)
    same = [
        manager.Equals(*pair)
        for pair in zip(fluent.args, atom.args, strict=True)
        if pair[0] != pair[1]
    ]
    hit = manager.And(condition, *same)
    return (manager.Exists(hit, *fresh.values()) if fresh else hit).simplify()


def _not_overwritten(effect: UpThing, later: Iterable[UpThing]) -> Iterator[UpThing]:
    """Yield an effect at the start of a step as far as the effects at its end leave it; true wins in any case."""
    from unified_planning.model import Effect

    manager, condition = effect.environment.expression_manager, effect.condition
    for other in (one for one in later if one.is_assignment()):
        hit = _hit(other, effect.fluent)
        if hit.is_true():
            return
        if effect.value.is_true() and other.value.is_false():
            condition = manager.And(condition, manager.Not(hit)).simplify()
    yield Effect(effect.fluent, effect.value, condition, effect.kind, effect.forall)
