"""A PDDL domain with its problem, as ROSA uses them, in the names of the files; and what came of planning."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction
from functools import cached_property
from itertools import product
from math import inf
from typing import Any, NamedTuple, Protocol, TypeAlias

from rosa_pddl.exceptions import PddlError, UnknownNameError, UnknownObjectError, nearest

ACTION_TYPE = "action"
FEASIBLE = "action_feasible"

UpThing: TypeAlias = Any
"""A problem, expression, effect or engine of unified-planning, which ships no types."""

State = frozenset[str]
"""The true atoms, as text: `frozenset({"(lit room)", "(action_feasible scan)"})`.

A number in `Domain.computed` has its value as an atom too: `(= (fuel rover) 80.5)`.
"""

Exact: TypeAlias = int | Fraction
"""A number that is added and compared without rounding."""

# Below this, a float without a fraction is exactly the whole number that was written.
_ALL_WHOLE = 2**53


class Feasibility(Protocol):
    """What this package needs from a knowledge base."""

    @property
    def actions(self) -> Mapping[str, object]:
        """The ROSA actions by name."""

    def is_feasible(self, action: str) -> bool:
        """Return whether an action can be done now."""


@dataclass(frozen=True)
class Schema:
    """A PDDL action. An instantaneous one has its conditions in `start` and its effects in `end_effects`.

    Args:
        name: as the file spells it.
        parameters: name and type of each parameter, in order.
        start, over_all, end: conditions at the start, throughout and at the end, as unified-planning expressions.
        start_effects, end_effects: effects at the start and at the end, as unified-planning effects.
        action: the parameter (`?a` without the mark) or constant that is the ROSA action; None if there is none.
        uses: how much it uses of each resource, as a unified-planning expression, by the resource's name.
        cost: what it adds to the metric, as a unified-planning expression; None for nothing.
        duration: its shortest and longest duration [s], as a unified-planning interval; None if it is instantaneous.
    """

    name: str
    parameters: tuple[tuple[str, str], ...]
    start: tuple[UpThing, ...]
    over_all: tuple[UpThing, ...]
    end: tuple[UpThing, ...]
    start_effects: tuple[UpThing, ...]
    end_effects: tuple[UpThing, ...]
    action: str | None
    uses: Mapping[str, UpThing] = field(default_factory=dict, hash=False)
    cost: UpThing = None
    duration: UpThing = None


@dataclass(frozen=True)
class Step:
    """One step of a plan: a PDDL action with its arguments.

    Args:
        schema: name of the PDDL action.
        arguments: names of the objects, in the order of the parameters.
        action: name of the ROSA action that the step does; None if it does none.
    """

    schema: str
    arguments: tuple[str, ...] = ()
    action: str | None = None

    def __str__(self) -> str:
        return f"{self.schema}({', '.join(self.arguments)})"


@dataclass(frozen=True)
class TimedStep:
    """A step of a plan in which steps overlap.

    Args:
        step: what is done.
        start_s: when it starts, from the start of the plan [s].
        duration_s: how long it takes [s]; 0 for an instantaneous action.
    """

    step: Step
    start_s: float
    duration_s: float

    @property
    def end_s(self) -> float:
        """When it ends, from the start of the plan [s]."""
        return self.start_s + self.duration_s


class Outcome(Enum):
    """How planning ended; if all attempts fail, the first outcome in this list that one of them had is reported."""

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


class Trouble(Exception):
    """Raised where planning ends without a plan; it carries the outcome to the planner, which reports it."""

    def __init__(self, outcome: Outcome, message: str = "") -> None:
        super().__init__(message)
        self.outcome = outcome


@dataclass(frozen=True)
class Attempt:
    """One way of planning that was tried.

    Args:
        way: `warm`, `cold`, `cache`, `certificate`, or the name of an engine of unified-planning.
        outcome: how it ended.
        message: what went wrong and what to do about it; empty when solved.
    """

    way: str
    outcome: Outcome
    message: str = ""

    def __str__(self) -> str:
        return f"{self.way}: {self.outcome}" + (f" ({self.message})" if self.message else "")


@dataclass(frozen=True)
class PlanningResult:
    """The answer of a planner.

    Args:
        outcome: how it ended.
        steps: the plan, in the order of their starts; empty unless solved.
        engine: the engine that answered, or that should have answered.
        message: without a plan, what was tried and what to do about it; with a plan, how much less another may cost at
            most, if costs had to be rounded because they are too far apart, else empty.
        cost: cost of the plan: the sum of its action costs if the problem has a metric, else the number of its steps.
        schedule: when each step starts and how long it takes, if steps may overlap; empty if they follow one another.
        attempts: what was tried, in order.
        safe_step: the step to do while there is no plan; None if there is a plan, or no safe step is set or can start.
    """

    outcome: Outcome
    steps: tuple[Step, ...] = ()
    engine: str = ""
    message: str = ""
    cost: float | None = None
    schedule: tuple[TimedStep, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    safe_step: Step | None = None

    @property
    def hangs_on_the_clock(self) -> bool:
        """Whether an attempt ran out of wall-clock time, so that a faster machine might give another answer."""
        outcomes = {self.outcome, *(attempt.outcome for attempt in self.attempts)}
        return Outcome.OUT_OF_TIME in outcomes


class Derived(NamedTuple):
    """The definition of a derived predicate: a condition on its variables; lower layers are derived first."""

    variables: tuple[UpThing, ...]
    condition: UpThing
    layer: int


@dataclass(frozen=True, eq=False)
class Domain:
    """What `load_domain` returns; never changes.

    Args:
        name: as the domain file gives it.
        file: the domain file.
        problem_file: the problem file.
        up_problem: unified-planning's `Problem` without actions and metric, in the names of `inside`.
        schema_of: the PDDL actions by name, in the order of the file.
        outside: the name in the files for each unique name in unified-planning.
        inside: the reverse, by kind (predicate, object, action) and lower-case name.
        types: for each object its type and the ancestors of this type, in lower case.
        places: file and line of each declaration, by kind (object, action) and name.
        rosa_actions: names of the objects of type `action`, in the order of the files.
        goals: the goal conditions of the problem file, as text.
        oversights: likely mistakes in the files, in sentences.
        axioms: the definitions of the derived predicates, by their names in lower case.
        computed: the names of the numbers that conditions compare and effects change; their values are part of a state.
        metric: `cost`, `makespan`, or empty for the number of steps.
        limits: limits on resources, such as `(<= (energy_used) 5)`; they are not among the goals of `up_problem`.
    """

    name: str
    file: str
    problem_file: str
    up_problem: UpThing = field(repr=False)
    schema_of: Mapping[str, Schema] = field(repr=False)
    outside: Mapping[str, str] = field(repr=False)
    inside: Mapping[tuple[str, str], str] = field(repr=False)
    types: Mapping[str, tuple[str, ...]] = field(repr=False)
    places: Mapping[tuple[str, str], tuple[str, int]] = field(default_factory=dict, repr=False)
    rosa_actions: tuple[str, ...] = ()
    goals: tuple[str, ...] = ()
    oversights: tuple[str, ...] = ()
    metric: str = ""
    limits: tuple[UpThing, ...] = ()
    computed: frozenset[str] = frozenset()
    axioms: dict[str, Derived] = field(default_factory=dict, repr=False)
    _atoms: dict[str, str] = field(default_factory=dict, init=False, repr=False)
    worked_out: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def check(self, kb: Feasibility) -> tuple[str, ...]:
        """Check that the knowledge base knows every ROSA action of the files.

        Returns:
            Likely mistakes, in sentences, such as actions of the knowledge base that the files lack, and ROSA actions
            of the files that no PDDL action does.

        Raises:
            PddlError: an action is unknown; the message points at its object and names the nearest actions.
        """
        if self.rosa_actions and not self.feasibility:
            text = f"there are objects of type action but no predicate ({FEASIBLE} ?a - action) to ask for"
            raise PddlError(text, self.file, 1)
        for action in self.rosa_actions:
            if action not in kb.actions:
                file, line = self.places["object", action]
                hint = nearest(action, kb.actions)
                raise PddlError(
                    f"the knowledge base does not know the action {action!r}; {hint}",
                    file,
                    line or None,
                )
        unplanned = [name for name in kb.actions if name not in self.rosa_actions]
        findings = [
            f"the action {name!r} of the knowledge base is never planned: {self.file}"
            for name in unplanned
        ]
        schemas = self.schema_of.values()
        idle = [
            action
            for action in self.rosa_actions
            if not any(self.may_do(one, action) for one in schemas)
        ]
        return (
            *self.oversights,
            *findings,
            *(f"no PDDL action of {self.file} does the ROSA action {action!r}" for action in idle),
        )

    def may_do(self, schema: Schema, action: str) -> bool:
        """Whether a PDDL action may do a ROSA action, according to the facts of the problem file."""
        if schema.action is None or schema.action not in dict(schema.parameters):
            return schema.action == action
        kind = f"{schema.name.lower()}_action"
        if ("predicate", kind) not in self.inside or self.up_problem.fluent(
            self.inside["predicate", kind]
        ).arity != 1:
            return True
        value = self.up_problem.explicit_initial_values.get(self.expression(f"({kind} {action})"))
        return value is not None and value.is_true()

    def atom(self, text: str) -> str:
        """Return the canonical text of an atom, e.g. `(lit room)` for `lit ROOM`.

        Raises:
            UnknownNameError: the predicate is unknown or derived, or an argument does not fit it.
        """
        if text not in self._atoms:
            self._atoms[text] = self._canonical(text)
        return self._atoms[text]

    @property
    def schemas(self) -> tuple[str, ...]:
        """Names of the PDDL actions, in the order of the file."""
        return tuple(self.schema_of)

    @property
    def limited(self) -> tuple[str, ...]:
        """The names of the numbers that have a limit."""
        return tuple(dict.fromkeys(self.outside[one.arg(0).fluent().name] for one in self.limits))

    def feasible_atom(self, action: str) -> str:
        """Return the atom that says that a ROSA action is feasible."""
        return f"({self.spelling('predicate', FEASIBLE, FEASIBLE)} {action})"

    @cached_property
    def feasibility(self) -> Mapping[str, str]:
        """Each ROSA action by the atom that says that it is feasible; empty if the domain lacks the predicate."""
        actions = self.rosa_actions if ("predicate", FEASIBLE) in self.inside else ()
        return {self.feasible_atom(action): action for action in actions}

    @property
    def numeric(self) -> frozenset[str]:
        """The names of the numeric facts, as the files spell them."""
        fluents = self.up_problem.fluents
        return frozenset(
            self.outside[fluent.name] for fluent in fluents if not fluent.type.is_bool_type()
        )

    def duration_s(self, schema: str) -> float:
        """Return the shortest declared duration of an action [s]: 0 if instantaneous, infinite if not constant."""
        duration = self.schema_of[schema].duration
        is_known = duration is None or duration.lower.is_constant()
        return inf if not is_known else float(duration.lower.constant_value()) if duration else 0.0

    def is_feasibility(self, atom: str) -> bool:
        """Whether an atom says that a ROSA action is feasible."""
        return atom[1:-1].lower().split()[0] == FEASIBLE

    def axiom(self, atom: UpThing) -> Derived | None:
        """Return the definition of an atom, given as a unified-planning expression; None if it is not derived."""
        return self.axioms.get(self.outside[atom.fluent().name].lower()) if self.axioms else None

    def makes_feasible(self, effect: UpThing) -> bool:
        """Whether an effect may make ROSA actions feasible."""
        return (
            self.outside[effect.fluent.fluent().name].lower() == FEASIBLE
            and not effect.value.is_false()
        )

    def objects_of(self, type_name: str) -> tuple[str, ...]:
        """Return the objects of a type or of its subtypes, in the order of the files."""
        return tuple(name for name, types in self.types.items() if type_name.lower() in types)

    def bindings(
        self, variables: Iterable[UpThing], outer: Mapping[str, Any]
    ) -> Iterator[dict[str, Any]]:
        """Yield the outer binding, extended by each choice of objects for the variables of a quantifier."""
        choices = {one.name: self.objects_of(self.outside[one.type.name]) for one in variables}
        for chosen in product(*choices.values()):
            yield {**outer, **dict(zip(choices, chosen, strict=True))}

    def step(self, schema: str, arguments: Iterable[str]) -> Step:
        """Return a step, with the ROSA action that it does."""
        given = tuple(arguments)
        known = self.schema_of[schema]
        names = [name for name, _ in known.parameters]
        action = (
            dict(zip(names, given, strict=True)).get(known.action, known.action)
            if known.action
            else None
        )
        return Step(schema, given, action)

    def stated(self, fact: str) -> tuple[UpThing, UpThing]:
        """Return a fact of a state as a unified-planning expression and its value: true, or a number."""
        manager = self.up_problem.environment.expression_manager
        for text, value in numbers_in([fact]).items():
            return self.expression(text), manager.auto_promote(value)[0]
        return self.expression(fact), manager.TRUE()

    def expression(self, atom: str) -> UpThing:
        """Return an atom as a unified-planning expression."""
        name, *arguments = atom[1:-1].split()
        fluent = self.up_problem.fluent(self.inside["predicate", name.lower()])
        return fluent(
            *(self.up_problem.object(self.inside["object", word.lower()]) for word in arguments)
        )

    def _canonical(self, text: str) -> str:
        words = text.strip().removeprefix("(").removesuffix(")").split()
        if not words:
            raise UnknownNameError(f"{text!r} is not an atom, expected e.g. '(predicate object)'")
        predicate = self.spelling("predicate", words[0], text)
        if words[0].lower() in self.axioms:
            raise UnknownNameError(f"{text!r} is derived: it is neither stated nor sensed")
        arguments = [self.spelling("object", word, text) for word in words[1:]]
        fluent = self.up_problem.fluent(self.inside["predicate", words[0].lower()])
        expected = [self.outside[parameter.type.name] for parameter in fluent.signature]
        if len(expected) != len(arguments):
            raise UnknownNameError(
                f"{text!r} has {len(arguments)} arguments, {predicate!r} takes {len(expected)}"
            )
        for argument, type_name in zip(arguments, expected, strict=True):
            if type_name.lower() not in self.types[argument]:
                known = ", ".join(self.objects_of(type_name)) or "none"
                raise UnknownNameError(
                    f"{argument!r} in {text!r} is not of type {type_name!r}; of that type: {known}"
                )
        return "(" + " ".join([predicate, *arguments]) + ")"

    def spelling(self, kind: str, word: str, text: str) -> str:
        """Return the name of a predicate, object, type or action as the files spell it; errors quote `text`."""
        if (kind, word.lower()) not in self.inside:
            known = [
                self.outside[inner] for (other, _), inner in self.inside.items() if other == kind
            ]
            error = UnknownObjectError if kind == "object" else UnknownNameError
            raise error(f"{self.file} has no {kind} {word!r} (in {text!r}); {nearest(word, known)}")
        return self.outside[self.inside[kind, word.lower()]]


def lineage_of(kind: UpThing, outside: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of a type and its ancestors as in the files, but in lower case."""
    return tuple(outside[one.name].lower() for one in kind.ancestors)


def exact(value: float | Fraction) -> Exact:
    """Return the exact value of a number as it is written in decimals, so that sums are exact: 0.1 is one tenth."""
    if isinstance(value, int):
        return value
    if isinstance(value, float) and value.is_integer() and abs(value) < _ALL_WHOLE:
        return int(value)
    written = value if isinstance(value, Fraction) else Fraction(str(float(value)))
    return written.numerator if written.denominator == 1 else written


def number_fact(text: str, value: Exact) -> str:
    """Return the fact that a number has a value: `(= (fuel rover) 80.5)`; a third is written `1/3`."""
    known = exact(value)
    is_decimal = isinstance(known, Fraction) and Fraction(str(float(known))) == known
    return f"(= {text} {float(known) if is_decimal else known})"


def numbers_in(facts: Iterable[str]) -> dict[str, Exact]:
    """Return the numbers of a state by their text."""
    found = [atom[3:-1].rpartition(" ") for atom in facts if atom.startswith("(= ")]
    return {text: exact(Fraction(value)) for text, _, value in found}


def head_of(atom: str) -> str:
    """Return the predicate of an atom, or the name in a numeric fact: `lit` for `(lit room)`."""
    return subject_of(atom)[1:-1].split(" ", 1)[0]


def atoms_in(formulas: Iterable[UpThing]) -> Iterator[UpThing]:
    """Yield the atoms and numbers in unified-planning expressions; its own extractor is unsafe in several threads."""
    for one in formulas:
        if one.is_fluent_exp():
            yield one
        else:
            yield from atoms_in(one.args)


def subject_of(fact: str) -> str:
    """Return what a fact is about: an atom itself, or the number whose value is stated, `(fuel rover)`."""
    return fact[3:-1].rpartition(" ")[0] if fact.startswith("(= ") else fact


def arguments_of(fact: str) -> list[str]:
    """Return the arguments of an atom, or of a number: `["room"]` for `(lit room)`."""
    return subject_of(fact)[1:-1].split()[1:]


def fluents_in(formulas: Iterable[UpThing]) -> set[UpThing]:
    """Return the predicates and numbers that unified-planning expressions mention, as its fluents."""
    return {atom.fluent() for atom in atoms_in(formulas)}


def conjuncts(formulas: Iterable[UpThing]) -> Iterator[UpThing]:
    """Yield the parts of unified-planning expressions, with conjunctions split, without those that are just true."""
    for formula in formulas:
        if formula.is_and():
            yield from conjuncts(formula.args)
        elif not formula.is_true():
            yield formula
