"""A planning problem, what came of planning, and the PDDL text that engines read."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from fractions import Fraction
from math import isfinite, lcm
from numbers import Real
from typing import NamedTuple

from rosa_pddl.domain import (
    TIME,
    TRUE,
    Domain,
    Effect,
    Exact,
    Formula,
    Number,
    Schema,
    State,
    Step,
    Variables,
    atom_text,
    exact,
    head_of,
    names_in,
    number_text,
    numbers_in,
    text_of,
)
from rosa_pddl.exceptions import SensingError, UnknownNameError, nearest
from rosa_pddl.grounding import UnsearchableError, binding_of, cost_of, substituted
from rosa_pddl.reader import Goal
from rosa_pddl.validate import TimedStep, Values

_FREE = "rosa-free"
_LATE = "-rosa-end"
_AGAIN = "-rosa-again-"
_ACTION = "-rosa-action"


class Outcome(Enum):
    """How planning ended; if all attempts fail, the first of these that one had is reported."""

    SOLVED = "solved"
    SOLVED_OPTIMALLY = "solved optimally"
    UNSOLVABLE_PROVEN = "unsolvable proven"
    UNSOLVABLE_AS_FAR_AS_KNOWN = "unsolvable as far as known"
    OUT_OF_TIME = "out of time"
    OUT_OF_MEMORY = "out of memory"
    ENGINE_CRASHED = "engine crashed"
    UNSUPPORTED = "unsupported"
    ENGINE_MISSING = "engine missing"

    @property
    def is_solved(self) -> bool:
        """Whether there is a plan."""
        return self in (Outcome.SOLVED, Outcome.SOLVED_OPTIMALLY)

    @property
    def is_unsolvable(self) -> bool:
        """Whether there is no plan because the problem has none."""
        return self in (Outcome.UNSOLVABLE_PROVEN, Outcome.UNSOLVABLE_AS_FAR_AS_KNOWN)

    @property
    def is_trouble(self) -> bool:
        """Whether there is no plan because of the engine, not because of the problem."""
        return not self.is_solved and not self.is_unsolvable

    @property
    def is_passing(self) -> bool:
        """Whether the trouble may be temporary, so that the same request may succeed later."""
        return self in (Outcome.OUT_OF_TIME, Outcome.OUT_OF_MEMORY, Outcome.ENGINE_CRASHED)

    def __str__(self) -> str:
        return self.value


class PlanningFailed(Exception):
    """Raised where planning ends without a plan; it carries the outcome to the planner."""

    def __init__(self, outcome: Outcome, message: str = "") -> None:
        super().__init__(message)
        self.outcome = outcome


@dataclass(frozen=True)
class Attempt:
    """One strategy of planning that was tried.

    Args:
        strategy: `search`, `cache`, `certificate`, or the name of an engine.
        outcome: how it ended.
        message: what went wrong and what to do about it; empty when solved.
    """

    strategy: str
    outcome: Outcome
    message: str = ""

    def __str__(self) -> str:
        reason = f" ({self.message})" if self.message else ""
        return f"{self.strategy}: {self.outcome}{reason}"


@dataclass(frozen=True)
class PlanningResult:
    """The answer of a planner.

    Args:
        outcome: how it ended.
        steps: the plan, in the order of their starts; empty unless solved.
        engine: the strategy that answered, or the engine that should have answered.
        message: without a plan, what was tried and what to do about it.
        cost: what the plan adds to the metric, or the number of its steps without a metric.
        schedule: when each step starts and how long it takes, if steps may overlap.
        attempts: what was tried, in order.
        safe_step: the step to do while there is no plan, if one is set and can start.
        assumptions: what the plan relies on and nobody knows, in sentences.
    """

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    engine: str = ""
    message: str = ""
    cost: float | None = None
    schedule: tuple[TimedStep, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    safe_step: Step | None = None
    assumptions: tuple[str, ...] = ()

    @property
    def hangs_on_the_clock(self) -> bool:
        """Whether an attempt ran out of time, so that a faster machine might answer otherwise."""
        outcomes = {self.outcome, *(attempt.outcome for attempt in self.attempts)}
        return Outcome.OUT_OF_TIME in outcomes


@dataclass(frozen=True)
class Problem:
    """A planning problem: the state to start from and the goals to reach.

    Args:
        domain: what `load_domain` returned.
        state: the atoms that are true now, feasibility included.
        goals: the goals, as formulas; by default the goal of the problem file.
        costs: values of numeric facts that costs and durations depend on, such as
            `{"(travel_cost a b)": 3.5}`; other values are those of the problem file.
        weights: factors on the costs of steps, such as steps that failed; 0 leaves a step out.
        until: how much longer facts `(action_feasible ?a)` will hold by the forecasts [s]; no
            step that needs such a fact may end later, unless a step makes it true again.
        shares: which share of its duration is left of each running step, if a plan begins with it.
        soft: goals that a plan may give up, at the cost of their worth.

    Raises:
        UnknownNameError: a key of `costs` is no numeric fact, or one of `until` no feasibility.
        SensingError: a value of `costs` is no number, or a time in `until` is not a finite one.
    """

    domain: Domain
    state: State
    goals: tuple[Formula, ...] | None = None
    costs: Mapping[str, float] = field(default_factory=dict, hash=False)
    weights: Mapping[Step, int] = field(default_factory=dict, hash=False)
    until: Mapping[str, float] = field(default_factory=dict, hash=False)
    shares: Mapping[Step, float] = field(default_factory=dict, hash=False)
    soft: tuple[Goal, ...] = ()

    def __post_init__(self) -> None:
        costs = dict[str, float]()
        numeric = self.domain.numeric if self.costs else frozenset()
        for text, value in self.costs.items():
            if not isinstance(value, Real):
                raise SensingError(f"{text} is {value!r}, expected a number")
            if not isfinite(value):
                raise SensingError(f"{text} is {value!r}, expected a finite number")
            atom = self.domain.atom(text)
            costs[atom] = value
            if head_of(atom) not in numeric:
                message = f"{text!r} is no numeric fact of {self.domain.file}"
                raise UnknownNameError(f"{message}; {nearest(head_of(atom), numeric)}")
        if costs.keys() != self.costs.keys():
            object.__setattr__(self, "costs", costs)  # in the spelling of the files
        for text, left_s in self.until.items():
            if text not in self.domain.feasibility:
                message = f"{text!r} does not say that an action is feasible"
                hint = nearest(text, self.domain.feasibility)
                raise UnknownNameError(f"{message}; {hint}")
            if not (isinstance(left_s, Real) and isfinite(left_s)):
                message = f"{text} is forecast to hold for {left_s!r} s, expected a finite number"
                raise SensingError(f"{message}; leave out what is not forecast to end")

    @property
    def wanted(self) -> tuple[Formula, ...]:
        """The goals: its own, or else those of the domain's problem file."""
        return self.domain.goal if self.goals is None else self.goals

    def write(self, style: str = "") -> "PddlText":
        """Write the problem as PDDL text.

        Args:
            style: `overlapping` for the actions as they are; `timed` for actions that take time
                but follow one another; empty for instantaneous actions; `costs` for instantaneous
                actions with whole costs, as Fast Downward reads them.

        Raises:
            UnsearchableError: the style does not allow what is in the domain.
        """
        return _Writer(self, style).write()


class PddlText(NamedTuple):
    """A problem as PDDL text.

    Args:
        domain, problem: the two texts.
        names: the PDDL action for each action in the text, with its arguments if they are fixed.
    """

    domain: str
    problem: str
    names: Mapping[str, tuple[str, tuple[str, ...] | None]]

    def step(self, domain: Domain, name: str, arguments: Sequence[str]) -> Step | None:
        """Return the step for an action in the text; None if it belongs to the one before."""
        if name.lower() not in self.names:
            return None
        schema, fixed = self.names[name.lower()]
        words = [domain.spelling("object", word, word) for word in arguments]
        return domain.step(schema, words if fixed is None else fixed)


class _Writer:
    """Writes a problem in the form that an engine can read."""

    def __init__(self, problem: Problem, style: str) -> None:
        self._problem = problem
        self._domain = problem.domain.with_numbers(problem.costs)
        self._style = style
        self._cost = "total-cost" if style == "costs" else "rosa-cost"
        self._values = Values(problem.domain, problem.state, problem.costs)
        self._names: dict[str, tuple[str, tuple[str, ...] | None]] = {}
        self._halves: list[str] = []
        self._scale = self._scale_of_costs() if style == "costs" else 1

    def write(self) -> PddlText:
        """Return the two texts."""
        if self._domain.only_planned:
            names = {name.lower(): (name, None) for name in self._domain.schema_of}
            return PddlText(*self._domain.texts, names)
        actions = list[str]()
        for schema in self._domain.schema_of.values():
            actions += [_action_text(each) for each in self._versions(schema)]
        return PddlText(self._domain_text(actions), self._problem_text(), self._names)

    @property
    def _is_timed(self) -> bool:
        return self._style in ("overlapping", "timed")

    # ------------------------------------------------------------ actions

    def _versions(self, schema: Schema) -> Iterator[Schema]:
        """Yield an action without the steps that have weights, and each of these by itself."""
        steps = [step for step in self._problem.weights if step.schema == schema.name]
        excluded = list[Formula]()
        for step in steps:
            pairs = [("same", *each) for each in binding_of(self._domain, step).items()]
            excluded.append(("not", ("and", *pairs)))
        parameters = tuple(f"?{name}" for name, _ in schema.parameters)
        name = schema.name
        taken = [*self._domain.types, *self._domain.signatures, *self._domain.kinds]
        if name.lower() in {other.lower() for other in taken}:
            name += _ACTION  # unified-planning wants different names
        general = replace(schema, name=name, start=(*schema.start, *excluded))
        yield from self._styled(general, Step(schema.name, parameters), None, 1)
        for number, step in enumerate(steps):
            weight = self._problem.weights[step]
            if weight:
                name = f"{schema.name}{_AGAIN}{number}"
                fixed = _fixed(schema, binding_of(self._domain, step), name)
                yield from self._styled(fixed, step, step.arguments, weight)

    def _styled(
        self, schema: Schema, step: Step, arguments: tuple[str, ...] | None, weight: int
    ) -> Iterator[Schema]:
        self._names[schema.name.lower()] = step.schema, arguments
        schema = self._priced(schema, step, weight)
        if self._style == "timed":
            yield _exclusive(schema)
        elif self._is_timed:
            yield schema
        else:
            merged = _merged(schema, has_axioms=bool(self._domain.axioms))
            if merged is None:
                first, second = _in_two(schema)
                self._halves.append(_head(second.name, _variables(schema)))
                yield from (first, second)
            else:
                yield _exclusive(merged)

    def _priced(self, schema: Schema, step: Step, weight: int) -> Schema:
        """Return an action that raises the cost in the text, if there is one."""
        metric = self._domain.metric
        amount: Number = weight
        if self._style == "costs":
            schema = _without_numbers(schema)
            if metric is not None:
                amount = self._whole_cost(step, weight)
        elif metric is None and self._style == "overlapping":
            amount = weight - 1
        elif metric is not None:
            # a step that has failed costs as much again for each try that is expected
            amount = weight - 1 and ("*", weight - 1, _lifted(cost_of(self._domain, step)))
        if amount == 0:
            return schema
        effect = Effect("increase", self._cost, (), amount=amount)
        return replace(schema, end_effects=(*schema.end_effects, effect))

    def _whole_cost(self, step: Step, weight: int) -> Number:
        cost = cost_of(self._domain, step)
        is_open = any(word.startswith("?") for word in step.arguments)
        if isinstance(cost, tuple) and is_open:
            if cost[0] != "n":
                raise UnsearchableError(f"the cost of {step.schema} is computed")
            return _lifted(cost)
        value = self._values.number(cost, {})
        if value is None or value < 0:
            raise UnsearchableError(f"the cost of {step} is unknown, or less than nothing")
        return exact(Fraction(value) * self._scale * weight)

    def _scale_of_costs(self) -> int:
        """Return a factor that makes all costs whole; raise if the engine needs other numbers."""
        domain = self._domain
        if domain.computed or domain.compared or domain.timed:
            raise UnsearchableError("Fast Downward plans without numbers that rise and fall")
        denominators = {Fraction(value).denominator for value in self._numbers().values()}
        for schema in domain.schema_of.values():
            parameters = tuple(f"?{name}" for name, _ in schema.parameters)
            cost = cost_of(domain, Step(schema.name, parameters))
            if not isinstance(cost, tuple):
                denominators.add(Fraction(cost).denominator)
        return lcm(*denominators)

    # ------------------------------------------------------------ the texts

    def _domain_text(self, actions: Iterable[str]) -> str:
        domain = self._domain
        kinds = sorted(domain.kinds.values(), key=lambda kind: len(kind[1]))
        types = [f"{name} - {domain.kinds[above[1]][0]}" for name, above in kinds if above[1:]]
        constants = [name for name in domain.types if name in domain.constants]
        signatures = domain.signatures.values()
        predicates = [str(each) for each in signatures if not each.is_number]
        numbers = [str(each) for each in signatures if each.is_number]
        numbers = [text for text in numbers if text.lower() != f"({self._cost})"]
        axioms = list[str]()
        for name, each in domain.axioms.items():
            for axiom in each:
                head = _head(domain.signatures[name].name, axiom.variables)
                axioms.append(f"(:derived {head} {text_of(axiom.condition)})")
        parts = [
            "(define (domain rosa)",
            f"(:requirements {' '.join(self._requirements())})",
            f"(:types {' '.join(types)})" if types else "",
            f"(:constants {' '.join(self._typed(constants))})" if constants else "",
            f"(:predicates ({_FREE}) {' '.join(predicates + self._halves)})",
            f"(:functions {' '.join(numbers)} ({self._cost}))",
            *axioms,
            *actions,
            ")",
        ]
        return "\n".join(part for part in parts if part)

    def _requirements(self) -> Iterator[str]:
        yield from (":typing", ":adl")
        if self._is_timed:
            yield from (":durative-actions", ":duration-inequalities", ":timed-initial-literals")
        if self._domain.axioms:
            yield ":derived-predicates"
        if self._problem.soft:
            yield ":preferences"
        yield ":action-costs" if self._style == "costs" else ":numeric-fluents"

    def _problem_text(self) -> str:
        problem, domain = self._problem, self._domain
        objects = [name for name in domain.types if name not in domain.constants]
        facts = [fact for fact in sorted(problem.state) if not fact.startswith("(= ")]
        numbers = self._numbers()
        if self._style == "costs":
            numbers = {text: exact(Fraction(n) * self._scale) for text, n in numbers.items()}
        else:
            numbers |= numbers_in(problem.state)
        numbers[f"({self._cost})"] = 0
        facts += [f"(= {text} {number_text(value)})" for text, value in numbers.items()]
        facts += [f"({_FREE})", *self._timed_facts()]
        goals = [f"({_FREE})", *(text_of(goal) for goal in problem.wanted)]
        for number, goal in enumerate(problem.soft):
            goals.append(f"(preference rosa-soft-{number} {goal.text})")
        parts = [
            "(define (problem rosa) (:domain rosa)",
            f"(:objects {' '.join(self._typed(objects))})",
            "(:init " + "\n  ".join(facts) + ")",
            f"(:goal (and {' '.join(goals)}))",
            f"(:metric minimize {self._metric()})",
            ")",
        ]
        return "\n".join(parts)

    def _timed_facts(self) -> Iterator[str]:
        if not self._is_timed:
            return
        for at_s, atom, is_true in self._domain.timed:
            yield f"(at {at_s} {atom if is_true else f'(not {atom})'})"
        for atom, left_s in self._problem.until.items():
            yield f"(at {max(left_s, 0.001)} (not {atom}))"

    def _metric(self) -> str:
        metric = self._domain.metric
        terms = [f"({self._cost})"]
        if metric is not None and self._style != "costs":
            terms.append(_metric_text(metric))
        elif metric is None and self._style == "overlapping":
            terms.append(f"({TIME})")
        for number, goal in enumerate(self._problem.soft):
            worth = number_text(exact(goal.worth or 0))
            terms.append(f"(* {worth} (is-violated rosa-soft-{number}))")
        return terms[0] if len(terms) == 1 else f"(+ {' '.join(terms)})"

    def _numbers(self) -> dict[str, Exact]:
        """Return the values of the numbers that are not part of the state."""
        values = {**self._domain.numbers, **self._problem.costs}
        computed = self._domain.computed
        return {text: exact(n) for text, n in values.items() if head_of(text) not in computed}

    def _typed(self, names: Iterable[str]) -> list[str]:
        kinds = self._domain.kinds
        return [f"{name} - {kinds[self._domain.types[name][0]][0]}" for name in names]


def _head(name: str, variables: Variables) -> str:
    return atom_text(name, [f"{variable} - {kind}" for variable, kind in variables])


def _variables(schema: Schema) -> Variables:
    return tuple((f"?{name}", kind) for name, kind in schema.parameters)


def _metric_text(number: Number) -> str:
    if not isinstance(number, tuple):
        return number_text(number)
    head, *parts = number
    if head == "n":
        return atom_text(parts[0], parts[1])
    return atom_text(head, [_metric_text(part) for part in parts])


def _lifted(amount: Number) -> Number:
    """Return a ground number in the form of a formula."""
    if not isinstance(amount, tuple):
        return amount
    if amount[0] == "n":
        name, *words = amount[1][1:-1].split()
        return "n", name, tuple(words)
    return amount[0], *(_lifted(part) for part in amount[1:])


def _without_numbers(schema: Schema) -> Schema:
    starts = tuple(effect for effect in schema.start_effects if not effect.is_numeric)
    ends = tuple(effect for effect in schema.end_effects if not effect.is_numeric)
    return replace(schema, start_effects=starts, end_effects=ends)


def _fixed(schema: Schema, binding: Mapping[str, str], name: str) -> Schema:
    """Return an action with fixed arguments."""

    def with_objects(effect: Effect) -> Effect:
        hidden = {variable for variable, _ in effect.variables}
        inner = {term: thing for term, thing in binding.items() if term not in hidden}
        return effect._replace(
            terms=tuple(inner.get(term, term) for term in effect.terms),
            condition=substituted(effect.condition, inner),
            amount=substituted(effect.amount, inner),
        )

    duration = schema.duration
    if duration is not None:
        duration = substituted(duration[0], binding), substituted(duration[1], binding)
    fixed = replace(
        schema,
        name=name,
        parameters=(),
        start=tuple(substituted(each, binding) for each in schema.start),
        over_all=tuple(substituted(each, binding) for each in schema.over_all),
        end=tuple(substituted(each, binding) for each in schema.end),
        duration=duration,
    )
    return fixed.with_effects(with_objects)


def _is_sure(effect: Effect) -> bool:
    return effect.condition == TRUE and not effect.variables and not effect.is_numeric


def _merged(schema: Schema, *, has_axioms: bool) -> Schema | None:
    """Return a step beside which nothing else happens as one action; None if it must be two."""
    sure = set[tuple[str, tuple[str, ...]]]()
    for effect in schema.start_effects:
        if has_axioms or not _is_sure(effect):
            return None
        if effect.kind == "add":
            sure.add((effect.name, effect.terms))
    late = list[Formula]()
    for formula in schema.over_all + schema.end:
        if formula[0] != "atom" or formula[1:] not in sure:
            late.append(formula)
    read = names_in(late)
    for effect in schema.end_effects:
        read |= names_in([effect.condition, effect.amount])
    if read & {effect.name for effect in schema.start_effects}:
        return None
    kept = list[Effect]()
    for effect in schema.start_effects:
        others = [other for other in schema.end_effects if other.name == effect.name]
        if any(_is_sure(other) and other.terms == effect.terms for other in others):
            continue
        if effect.kind == "add" and any(other.kind == "delete" for other in others):
            return None
        kept.append(effect)
    return _instant(schema, (*schema.start, *late), (*kept, *schema.end_effects))


def _instant(
    schema: Schema, conditions: tuple[Formula, ...], effects: tuple[Effect, ...]
) -> Schema:
    return Schema(schema.name, schema.parameters, conditions, (), (), (), effects)


def _exclusive(schema: Schema) -> Schema:
    """Return an action beside which nothing else happens."""
    schema = replace(schema, start=(*schema.start, ("atom", _FREE, ())))
    if schema.duration is None:
        return schema
    begin, end = Effect("delete", _FREE, ()), Effect("add", _FREE, ())
    starts, ends = (*schema.start_effects, begin), (*schema.end_effects, end)
    return replace(schema, start_effects=starts, end_effects=ends)


def _in_two(schema: Schema) -> tuple[Schema, Schema]:
    """Return the start and the end of an action; between them nothing else happens."""
    free: Formula = ("atom", _FREE, ())
    terms = tuple(f"?{name}" for name, _ in schema.parameters)
    late = f"{schema.name}{_LATE}"
    begin = Effect("delete", _FREE, ()), Effect("add", late, terms)
    end = Effect("add", _FREE, ()), Effect("delete", late, terms)
    first = _instant(schema, (*schema.start, free), (*schema.start_effects, *begin))
    conditions = (*schema.over_all, *schema.end, ("atom", late, terms))
    second = _instant(schema, conditions, (*schema.end_effects, *end))
    return first, replace(second, name=late)


def _effect_text(effect: Effect, when: str = "") -> str:
    text = atom_text(effect.name, effect.terms)
    if effect.kind == "delete":
        text = f"(not {text})"
    elif effect.is_numeric:
        text = f"({effect.kind} {text} {text_of(effect.amount)})"
    text = f"({when} {text})" if when else text
    if effect.condition != TRUE:
        condition = text_of(effect.condition)
        condition = f"({when} {condition})" if when else condition
        text = f"(when {condition} {text})"
    if effect.variables:
        variables = " ".join(f"{name} - {kind}" for name, kind in effect.variables)
        text = f"(forall ({variables}) {text})"
    return text


def _action_text(schema: Schema) -> str:
    variables = " ".join(f"{name} - {kind}" for name, kind in _variables(schema))
    if schema.duration is None:
        conditions = [text_of(formula) for formula in schema.conditions]
        effects = [_effect_text(effect) for effect in schema.effects]
        body = f":precondition (and {' '.join(conditions)}) :effect (and {' '.join(effects)})"
        return f"(:action {schema.name} :parameters ({variables}) {body})"
    least, most = (text_of(bound_s) for bound_s in schema.duration)
    duration = f"(and (>= ?duration {least}) (<= ?duration {most}))"
    if least == most:
        duration = f"(= ?duration {least})"
    conditions = [f"(at start {text_of(formula)})" for formula in schema.start]
    conditions += [f"(over all {text_of(formula)})" for formula in schema.over_all]
    conditions += [f"(at end {text_of(formula)})" for formula in schema.end]
    effects = [_effect_text(effect, "at start") for effect in schema.start_effects]
    effects += [_effect_text(effect, "at end") for effect in schema.end_effects]
    body = f":condition (and {' '.join(conditions)}) :effect (and {' '.join(effects)})"
    return f"(:durative-action {schema.name} :parameters ({variables}) :duration {duration} {body})"
