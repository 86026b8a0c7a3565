"""A planning problem, what came of planning, and the PDDL text that engines read."""

import re
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
    SensingError,
    Signature,
    State,
    Step,
    UnknownNameError,
    atom_text,
    exact,
    head_of,
    names_in,
    nearest,
    number_text,
    numbers_in,
    text_of,
    variables_text,
)
from rosa_pddl.grounding import UnsearchableError, binding_of, cost_of
from rosa_pddl.reader import Goal, atom_of
from rosa_pddl.validate import TimedStep, Values

_FREE = "rosa-free"
_FIRST = "rosa-first"


class Outcome(Enum):
    """How planning ended."""

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
class PlanningResult:
    """The answer of a planner.

    Args:
        outcome: how it ended.
        steps: the plan, in the order of their starts; empty unless solved.
        engine: who answered: `search`, or the name of an engine.
        message: without a plan, what went wrong and what to do about it.
        cost: what the plan adds to the metric, or the number of its steps without a metric.
        schedule: when each step starts and how long it takes, if steps may overlap.
        assumptions: what the plan relies on and nobody knows, in sentences.
    """

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    engine: str = ""
    message: str = ""
    cost: float | None = None
    schedule: tuple[TimedStep, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    def attempts(self) -> tuple[str, ...]:
        """Who was asked, with the outcome."""
        return (f"{self.engine}: {self.outcome}",)


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
        UnknownNameError: a key of `costs` is no numeric fact.
        SensingError: a value of `costs` is no finite number.
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
        costs = {atom_of(self.domain, text): value for text, value in self.costs.items()}
        for text, value in costs.items():
            if not (isinstance(value, Real) and isfinite(value)):
                raise SensingError(f"{text} is {value!r}, expected a finite number")
            if head_of(text) not in self.domain.numeric:
                message = f"{text!r} is no numeric fact of {self.domain.file}"
                raise UnknownNameError(f"{message}; {nearest(head_of(text), self.domain.numeric)}")
        object.__setattr__(self, "costs", costs)  # in the spelling of the files

    @property
    def wanted(self) -> tuple[Formula, ...]:
        """The goals: its own, or else those of the domain's problem file."""
        return self.domain.goal if self.goals is None else self.goals

    def write(self, style: str) -> "PddlText":
        """Write the problem as PDDL text.

        Args:
            style: `overlapping` for the actions as they are; `timed` for actions that take time
                but follow one another; `instant` for instantaneous actions; `costs` for
                instantaneous actions with whole costs, as Fast Downward reads them.

        Raises:
            UnsearchableError: the style does not allow what is in the domain.
        """
        return _Writer(self, style).write()


class PddlText(NamedTuple):
    """A problem as PDDL text.

    Args:
        domain, problem: the two texts.
        names: the PDDL action for each action in the text.
    """

    domain: str
    problem: str
    names: Mapping[str, str]

    def step(self, domain: Domain, name: str, arguments: Sequence[str]) -> Step:
        """Return the step for an action in the text."""
        words = [domain.spelling("object", word) for word in arguments]
        return domain.step(self.names[name.lower()], words)


class _Writer:
    """Writes a problem in the form that an engine can read."""

    def __init__(self, problem: Problem, style: str) -> None:
        self._problem = problem
        self._domain = problem.domain.with_numbers(problem.costs)
        self._style = style
        self._is_timed = style in ("overlapping", "timed")
        self._cost = "total-cost" if style == "costs" else "rosa-cost"
        self._values = Values(problem.domain, problem.state, problem.costs)
        self._names: dict[str, str] = {}
        self._scale = self._scale_of_costs() if style == "costs" else 1

    def write(self) -> PddlText:
        """Return the two texts."""
        domain = self._domain
        if domain.only_planned:
            names = {name.lower(): name for name in domain.schema_of}
            text, problem = domain.texts
            init = " ".join(["(:init", *sorted(self._problem.state)])
            return PddlText(text, re.sub(r"\(:init", init, problem, flags=re.I), names)
        actions = list[str]()
        for schema in domain.schema_of.values():
            actions += [_action_text(each) for each in self._versions(schema)]
        return PddlText(self._domain_text(actions), self._problem_text(), self._names)

    # ------------------------------------------------------------ actions

    def _versions(self, schema: Schema) -> Iterator[Schema]:
        """Yield an action without the steps that have weights, and each of these by itself."""
        excluded = list[Formula]()
        for step, weight in self._problem.weights.items():
            if step.schema == schema.name:
                same = self._same(step)
                excluded.append(("not", ("and", *same)))
                if weight:
                    yield self._styled(schema, step, weight, same)
        for step, share in self._problem.shares.items():
            if self._style == "timed" and step.schema == schema.name and schema.duration:
                least, most = (("*", exact(share), bound_s) for bound_s in schema.duration)
                rest = replace(schema, duration=(least, most))
                yield self._styled(rest, step, 1, [*self._same(step), ("atom", _FIRST, ())])
        arguments = tuple(name for name, _ in schema.variables)
        yield self._styled(schema, Step(schema.name, arguments), 1, excluded)

    def _same(self, step: Step) -> list[Formula]:
        return [("same", *pair) for pair in binding_of(self._domain, step).items()]

    def _styled(
        self, schema: Schema, step: Step, weight: int, further: Iterable[Formula]
    ) -> Schema:
        """Return an action in the style, with its cost and further conditions."""
        # a name that nothing else in the text has, as unified-planning wants it
        name = f"{schema.name}-action-{len(self._names)}"
        self._names[name.lower()] = schema.name
        schema = replace(schema, start=(*schema.start, *further))
        metric = self._domain.metric
        amount: Number = weight
        if self._style == "costs":
            schema = schema.with_effects(lambda effect: None if effect.is_numeric else effect)
            amount = self._whole_cost(step, weight)
        elif metric is not None:
            # a step that has failed costs as much again for each try that is expected
            amount = weight - 1 and ("*", weight - 1, cost_of(self._domain, step))
        elif self._style == "overlapping":
            amount = weight - 1
        if not self._is_timed:
            at_once = merged(schema, has_axioms=bool(self._domain.axioms))
            if at_once is None:
                raise UnsearchableError(f"{schema.name} is no change at once")
            schema = at_once
        ends = schema.end_effects
        if amount != 0:
            ends = (*ends, Effect("increase", self._cost, (), amount=amount))
        if self._style == "timed":
            ends = (*ends, Effect("delete", _FIRST, ()))
        schema = replace(schema, name=name, end_effects=ends)
        return schema if self._style == "overlapping" else _exclusive(schema)

    def _whole_cost(self, step: Step, weight: int) -> Number:
        cost = cost_of(self._domain, step)
        is_open = any(word.startswith("?") for word in step.arguments)
        if isinstance(cost, tuple) and is_open:
            if cost[0] != "n":
                raise UnsearchableError(f"the cost of {step.schema} is computed")
            return cost
        value = self._values.number(cost, {})
        if value is None or value < 0:
            raise UnsearchableError(f"the cost of {step} is unknown, or less than nothing")
        return exact(Fraction(value) * self._scale * weight)

    def _scale_of_costs(self) -> int:
        """Return a factor that makes all costs whole; raise if the engine needs other numbers."""
        domain = self._domain
        if domain.computed or domain.compared:
            raise UnsearchableError("Fast Downward plans without numbers that rise and fall")
        costs = list(self._numbers().values())
        for schema in domain.schema_of.values():
            cost = cost_of(domain, Step(schema.name, tuple(name for name, _ in schema.variables)))
            if not isinstance(cost, tuple):
                costs.append(cost)
        return lcm(*(Fraction(cost).denominator for cost in costs))

    # ------------------------------------------------------------ the texts

    def _domain_text(self, actions: Iterable[str]) -> str:
        domain = self._domain
        kinds = sorted(domain.kinds.values(), key=lambda kind: len(kind[1]))
        # all objects, as conditions name steps that have failed
        constants = [
            f"{name} - {domain.kinds[above[0]][0]}" for name, above in domain.types.items()
        ]
        types = [f"{name} - {domain.kinds[above[1]][0]}" for name, above in kinds if above[1:]]
        signatures = [each for each in domain.signatures.values() if each.name != self._cost]
        predicates = [str(each) for each in signatures if not each.is_number]
        numbers = [str(each) for each in signatures if each.is_number]
        axioms = list[str]()
        for name, each in domain.axioms.items():
            for axiom in each:
                head = Signature(domain.signatures[name].name, axiom.variables, False)
                axioms.append(f"(:derived {head} {text_of(axiom.condition)})")
        requirements = ":typing :adl :action-costs"
        if self._is_timed:
            requirements += " :durative-actions :duration-inequalities :timed-initial-literals"
        if axioms:  # unified-planning refuses a file that says so
            requirements += " :derived-predicates"
        parts = [
            "(define (domain rosa)",
            f"(:requirements {requirements})",
            f"(:types {' '.join(types)})" if types else "",
            f"(:constants {' '.join(constants)})" if constants else "",
            f"(:predicates ({_FREE}) ({_FIRST}) {' '.join(predicates)})",
            f"(:functions {' '.join(numbers)} ({self._cost}))",
            *axioms,
            *actions,
            ")",
        ]
        return "\n".join(parts)

    def _problem_text(self) -> str:
        problem = self._problem
        facts = [fact for fact in sorted(problem.state) if not fact.startswith("(= ")]
        numbers = self._numbers()
        if self._style == "costs":
            numbers = {text: exact(Fraction(n) * self._scale) for text, n in numbers.items()}
        else:
            numbers |= numbers_in(problem.state)
        numbers[f"({self._cost})"] = 0
        for text, value in numbers.items():
            facts.append(f"(= {text} {value if isinstance(value, int) else float(value)})")
        facts += [f"({_FREE})", f"({_FIRST})", *self._timed_facts()]
        goals = [f"({_FREE})", *(text_of(goal) for goal in problem.wanted)]
        for number, goal in enumerate(problem.soft):
            goals.append(f"(preference rosa-soft-{number} {goal.text})")
        parts = [
            "(define (problem rosa) (:domain rosa)",
            "(:init " + "\n  ".join(facts) + ")",
            f"(:goal (and {' '.join(goals)}))",
            f"(:metric minimize {self._metric()})",
            ")",
        ]
        return "\n".join(parts)

    def _timed_facts(self) -> Iterator[str]:
        if self._is_timed:
            for atom, left_s in self._problem.until.items():
                yield f"(at {max(left_s, 0.001)} (not {atom}))"

    def _metric(self) -> str:
        metric = self._domain.metric
        terms = [f"({self._cost})"]
        if metric is not None and self._style != "costs":
            terms.append(text_of(metric))
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


def merged(schema: Schema, *, has_axioms: bool) -> Schema | None:
    """Return a step beside which nothing else happens as one change; None if it is two."""
    early = schema.start_effects
    if early and has_axioms:
        return None
    added = {(effect.name, effect.terms) for effect in early if effect.kind == "add"}
    late = list[Formula]()
    for formula in schema.over_all + schema.end:
        if formula[0] != "atom" or formula[1:] not in added:
            late.append(formula)
    read = names_in(late)
    for effect in schema.end_effects:
        read |= names_in([effect.condition, effect.amount])
    lasting = list[Effect]()
    for effect in early:
        if effect.condition != TRUE or effect.variables or effect.name in read:
            return None
        others = [other for other in schema.end_effects if other.name == effect.name]
        if effect.is_numeric and others:
            return None
        undone = [other for other in others if effect.kind == "add" and other.kind == "delete"]
        if any(o.terms != effect.terms or o.condition != TRUE or o.variables for o in undone):
            return None
        if not undone:
            lasting.append(effect)
    effects = (*lasting, *schema.end_effects)
    return Schema(schema.name, schema.parameters, (*schema.start, *late), end_effects=effects)


def _exclusive(schema: Schema) -> Schema:
    """Return an action beside which nothing else happens."""
    schema = replace(schema, start=(*schema.start, ("atom", _FREE, ())))
    if schema.duration is None:
        return schema
    starts = (*schema.start_effects, Effect("delete", _FREE, ()))
    ends = (*schema.end_effects, Effect("add", _FREE, ()))
    return replace(schema, start_effects=starts, end_effects=ends)


def _timed_text(text: str, time: str) -> str:
    return f"({time} {text})" if time else text


def _effect_text(effect: Effect, time: str) -> str:
    text = atom_text(effect.name, effect.terms)
    if effect.kind == "delete":
        text = f"(not {text})"
    elif effect.is_numeric:
        text = f"({effect.kind} {text} {text_of(effect.amount)})"
    text = _timed_text(text, time)
    if effect.condition != TRUE:
        text = f"(when {_timed_text(text_of(effect.condition), time)} {text})"
    if effect.variables:
        text = f"(forall ({variables_text(effect.variables)}) {text})"
    return text


def _action_text(schema: Schema) -> str:
    times = ("", "", "")
    head = ":action"
    needed = ":precondition"
    if schema.duration is not None:
        least, most = (text_of(bound_s) for bound_s in schema.duration)
        times = ("at start", "over all", "at end")
        duration = f"(and (>= ?duration {least}) (<= ?duration {most}))"
        if least == most:
            duration = f"(= ?duration {least})"
        head = ":durative-action"
        needed = f":duration {duration} :condition"
    conditions = list[str]()
    for time, formulas in zip(times, (schema.start, schema.over_all, schema.end), strict=True):
        conditions += [_timed_text(text_of(formula), time) for formula in formulas]
    effects = [_effect_text(effect, times[0]) for effect in schema.start_effects]
    effects += [_effect_text(effect, times[2]) for effect in schema.end_effects]
    body = f"{needed} (and {' '.join(conditions)}) :effect (and {' '.join(effects)})"
    return f"({head} {schema.name} :parameters ({variables_text(schema.variables)}) {body})"
