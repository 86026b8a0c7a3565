"""A PDDL domain with its problem, in the names of the files, and the errors of this package.

A formula is a tuple. Its first item says what it is:
`("atom", name, terms)`, `("same", term, term)`, `("not", formula)`, `("and" | "or", formula, ...)`,
`("forall" | "exists", variables, formula)`, and comparisons `("<" | "<=" | "=", number, number)`. A
number is exact, or `("n", name, terms)`, or an operator with its parts, such as `("+", 1, 2)`. A
term is an object, or a variable such as `?x`.
"""

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from fractions import Fraction
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

ACTION_TYPE = "action"
FEASIBLE = "action_feasible"
DURATION = "?duration"
TIME = "total-time"

State = frozenset[str]
"""The true atoms, as text: `frozenset({"(lit room)", "(action_feasible scan)"})`.

A number in `Domain.computed` has its value as an atom too: `(= (fuel rover) 80.5)`.
"""
Exact: TypeAlias = int | Fraction
"""A number that is added and compared without rounding."""
Formula: TypeAlias = tuple[Any, ...]
Number: TypeAlias = Any
"""An exact number, `("n", name, terms)`, or an operator with its parts; None if it is unknown."""
Binding: TypeAlias = Mapping[str, str]
"""Objects by variable, such as `{"?x": "room"}`."""
Variables: TypeAlias = tuple[tuple[str, str], ...]
"""Variables with their types."""

TRUE: Formula = ("and",)

_NAME = re.compile(r"[A-Za-z][\w.-]*", re.ASCII)

# Below this, a float without a fraction is exactly the whole number that was written.
_ALL_WHOLE = 2**53


OPERATORS: Mapping[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": lambda left, right: exact(Fraction(left) / right),
    "<": operator.lt,
    "<=": operator.le,
    "=": operator.eq,
}


class Feasibility(Protocol):
    """What this package needs from a knowledge base."""

    @property
    def actions(self) -> Mapping[str, object]:
        """The ROSA actions by name."""

    def is_feasible(self, action: str) -> bool:
        """Return whether an action can be done now."""


class Effect(NamedTuple):
    """An effect of an action.

    Args:
        kind: `add`, `delete`, `assign`, `increase` or `decrease`.
        name: the predicate or the number.
        terms: its arguments.
        condition: when the effect happens.
        variables: it happens for every choice of objects for these.
        amount: the new value of a number, or by how much it changes.
    """

    kind: str
    name: str
    terms: tuple[str, ...]
    condition: Formula = TRUE
    variables: Variables = ()
    amount: Number = None

    @property
    def is_numeric(self) -> bool:
        """Whether it changes a number."""
        return self.kind not in ("add", "delete")


class Axiom(NamedTuple):
    """A rule that derives an atom: its variables with types, its condition, and its layer.

    Axioms of lower layers are applied first.
    """

    variables: Variables
    condition: Formula
    layer: int


class Signature(NamedTuple):
    """A declared predicate or number: its name as the file spells it, and its arguments."""

    name: str
    variables: Variables
    is_number: bool

    @property
    def types(self) -> tuple[str, ...]:
        """The types of its arguments."""
        return tuple(kind for _, kind in self.variables)

    def __str__(self) -> str:
        return atom_text(self.name, filter(None, [variables_text(self.variables)]))


@dataclass(frozen=True)
class Schema:
    """A PDDL action. An instantaneous one has its conditions in `start`, effects in `end_effects`.

    Args:
        name: as the file spells it.
        parameters: name (without `?`) and type of each parameter, in order.
        start, over_all, end: conditions at the start, throughout and at the end.
        start_effects, end_effects: effects at the start and at the end.
        action: the parameter (without `?`) or constant that is the ROSA action; None if none is.
        duration: its shortest and longest duration [s], as numbers; None if it is instantaneous.
    """

    name: str
    parameters: Variables
    start: tuple[Formula, ...] = ()
    over_all: tuple[Formula, ...] = ()
    end: tuple[Formula, ...] = ()
    start_effects: tuple[Effect, ...] = ()
    end_effects: tuple[Effect, ...] = ()
    action: str | None = None
    duration: tuple[Number, Number] | None = None

    @property
    def variables(self) -> Variables:
        """The parameters as variables: with `?`."""
        return tuple((f"?{name}", kind) for name, kind in self.parameters)

    def with_effects(self, change: Callable[[Effect], Effect | None]) -> "Schema":
        """Return the action with each effect changed, or left out."""
        starts = tuple(filter(None, map(change, self.start_effects)))
        ends = tuple(filter(None, map(change, self.end_effects)))
        return replace(self, start_effects=starts, end_effects=ends)

    def effects_at(self, is_end: bool) -> tuple[Effect, ...]:
        """Return the effects at the start or at the end."""
        return self.end_effects if is_end else self.start_effects

    @property
    def conditions(self) -> tuple[Formula, ...]:
        """All conditions."""
        return self.start + self.over_all + self.end

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All effects."""
        return self.start_effects + self.end_effects


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


@dataclass(frozen=True, eq=False)
class Domain:
    """What `load_domain` returns; never changes.

    Args:
        name: as the domain file gives it.
        file: the domain file.
        problem_file: the problem file.
        schema_of: the PDDL actions by name, in the order of the file.
        signatures: the predicates and numbers by their names in lower case.
        kinds: for each type, in lower case, its name in the file and its lineage, itself first.
        types: for each object its type and the ancestors of this type, in lower case.
        places: file and line of each object's declaration.
        facts: the initial facts of the problem file.
        numbers: the initial values of numbers, by their text.
        goal: the goal conditions of the problem file.
        metric: what a plan costs, as a number; None for the number of its steps.
        computed: the numbers that actions change and that plans depend on; part of a state.
        compared: the numbers that plans depend on, but no action changes; beside the state.
        axioms: the rules of derived predicates, by their names in lower case.
        oversights: likely mistakes in the files, in sentences.
        texts: the two files as they are, for engines that read them.
        only_planned: why the files can be planned for but not executed; empty if they can.
    """

    name: str
    file: str
    problem_file: str
    schema_of: Mapping[str, Schema] = field(repr=False)
    signatures: Mapping[str, Signature] = field(repr=False)
    kinds: Mapping[str, tuple[str, tuple[str, ...]]] = field(repr=False)
    types: Mapping[str, tuple[str, ...]] = field(repr=False)
    places: Mapping[str, tuple[str, int]] = field(default_factory=dict, repr=False)
    facts: State = field(default=frozenset(), repr=False)
    numbers: Mapping[str, Exact] = field(default_factory=dict, repr=False)
    goal: tuple[Formula, ...] = ()
    metric: Number = None
    computed: frozenset[str] = frozenset()
    compared: frozenset[str] = frozenset()
    axioms: Mapping[str, tuple[Axiom, ...]] = field(default_factory=dict, repr=False)
    oversights: tuple[str, ...] = ()
    texts: tuple[str, str] = field(default=("", ""), repr=False)
    only_planned: str = ""
    cache: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)

    def with_numbers(self, numbers: Mapping[str, float]) -> "Domain":
        """Return the domain with other values of the numbers on which plans depend."""
        changed = dict[str, Exact]()
        for text, value in numbers.items():
            if head_of(text) in self.compared:
                changed[text] = exact(value)
        if all(self.numbers.get(text) == value for text, value in changed.items()):
            return self
        return self._sharing(replace(self, numbers={**self.numbers, **changed}))

    def with_schemas(self, schemas: Mapping[str, Schema]) -> "Domain":
        """Return the domain with other conditions of its actions."""
        return self._sharing(replace(self, schema_of=schemas))

    def _sharing(self, domain: "Domain") -> "Domain":
        object.__setattr__(domain, "cache", self.cache)  # what is in it depends on neither
        return domain

    def check(self, kb: Feasibility) -> tuple[str, ...]:
        """Check that the knowledge base has every ROSA action of the files.

        Returns:
            Likely mistakes, in sentences, such as actions of the knowledge base that the files
            lack, and ROSA actions of the files that no PDDL action does.

        Raises:
            PddlError: an action is unknown; the message points at its object and names the nearest.
        """
        if self.rosa_actions and not self.feasibility:
            text = "there are objects of type action but no predicate"
            raise PddlError(f"{text} ({FEASIBLE} ?a - action) to ask for", self.file, 1)
        findings = list(self.oversights)
        for name in kb.actions:
            if name not in self.rosa_actions:
                text = f"the action {name!r} of the knowledge base is never planned"
                findings.append(f"{text}: {self.file}")
        for action in self.rosa_actions:
            if action not in kb.actions:
                file, line = self.places.get(action, (self.file, 0))
                message = f"the knowledge base does not know the action {action!r}"
                hint = nearest(action, kb.actions)
                raise PddlError(f"{message}; {hint}", file, line or None)
            if not any(self.may_do(schema, action) for schema in self.schema_of.values()):
                findings.append(f"no PDDL action of {self.file} does the ROSA action {action!r}")
        return tuple(findings)

    def may_do(self, schema: Schema, action: str) -> bool:
        """Whether a PDDL action may do a ROSA action, by the facts of the problem file, if any."""
        if schema.action is None or schema.action not in dict(schema.parameters):
            return schema.action == action
        kind = self.signatures.get(f"{schema.name.lower()}_action")
        if kind is None or len(kind.types) != 1:
            return True
        return not self.facts or f"({kind.name} {action})" in self.facts

    @cached_property
    def rosa_actions(self) -> tuple[str, ...]:
        """The objects of type `action`, in the order of the files."""
        return self.objects_of(ACTION_TYPE)

    @property
    def goals(self) -> tuple[str, ...]:
        """The goal conditions of the problem file, as text."""
        return tuple(text_of(goal) for goal in self.goal)

    @property
    def schemas(self) -> tuple[str, ...]:
        """Names of the PDDL actions, in the order of the file."""
        return tuple(self.schema_of)

    @cached_property
    def derived(self) -> frozenset[str]:
        """The names of the derived predicates, as the files spell them."""
        return frozenset(self.signatures[name].name for name in self.axioms)

    @cached_property
    def numeric(self) -> frozenset[str]:
        """The names of the numeric facts, as the files spell them."""
        return frozenset(each.name for each in self.signatures.values() if each.is_number)

    def feasible_atom(self, action: str) -> str:
        """Return the atom that says that a ROSA action is feasible."""
        signature = self.signatures.get(FEASIBLE)
        return f"({FEASIBLE if signature is None else signature.name} {action})"

    @cached_property
    def feasibility(self) -> Mapping[str, str]:
        """Each ROSA action by the atom that says that it is feasible.

        Empty without the predicate.
        """
        if FEASIBLE not in self.signatures:
            return {}
        return {self.feasible_atom(action): action for action in self.rosa_actions}

    def is_feasibility(self, atom: str) -> bool:
        """Whether an atom says that a ROSA action is feasible."""
        return head_of(atom).lower() == FEASIBLE

    def objects_of(self, type_name: str) -> tuple[str, ...]:
        """Return the objects of a type or of its subtypes, in the order of the files."""
        kind = type_name.lower()
        by_type: dict[str, tuple[str, ...]] = self.cache.setdefault("objects", {})
        if kind not in by_type:
            objects = [name for name, lineage in self.types.items() if kind in lineage]
            by_type[kind] = tuple(objects)
        return by_type[kind]

    def bindings(self, variables: Variables, outer: Binding) -> Iterator[Binding]:
        """Yield the outer binding, extended by each choice of objects for variables."""
        names = [name for name, _ in variables]
        for chosen in product(*[self.objects_of(kind) for _, kind in variables]):
            yield {**outer, **dict(zip(names, chosen, strict=True))}

    def step(self, schema: str, arguments: Iterable[str]) -> Step:
        """Return a step, with the ROSA action that it does."""
        listed = tuple(arguments)
        definition = self.schema_of[schema]
        names = [name for name, _ in definition.parameters]
        by_name: dict[str | None, str] = dict(zip(names, listed, strict=True))
        return Step(schema, listed, by_name.get(definition.action, definition.action))

    def spelling(self, kind: str, word: str) -> str:
        """Return an object, or a type, as the files spell it."""
        names = list(self.types)
        if kind == "type":
            names = [name for name, _ in self.kinds.values()]
        spelled = {name.lower(): name for name in names}
        if word.lower() not in spelled:
            hint = nearest(word, names)
            raise UnknownNameError(f"{self.file} has no {kind} {word!r}; {hint}")
        return spelled[word.lower()]


def with_object(domain: Domain, name: str, type_name: str) -> Domain:
    """Return a domain with one more object, about which it has no facts.

    Raises:
        UnknownNameError: there is no such type, or the name is taken or no PDDL name.
    """
    spelled = domain.spelling("type", type_name)
    lineage = domain.kinds[spelled.lower()][1]
    taken = {other.lower() for other in domain.types}
    if not _NAME.fullmatch(name) or name.lower() in taken:
        message = f"{name!r} cannot be added, expected a name that no object has"
        raise UnknownNameError(f"{message}: a letter, then letters, digits, '_', '-' or '.'")
    return replace(domain, types={**domain.types, name: lineage})


def without_object(domain: Domain, name: str) -> Domain:
    """Return a domain without an object, and without the goals that name it.

    Raises:
        UnknownNameError: there is no such object, or it is a ROSA action.
    """
    spelled = domain.spelling("object", name)
    if ACTION_TYPE in domain.types[spelled]:
        raise UnknownNameError(f"{spelled!r} is a ROSA action, which stays")
    types = {other: lineage for other, lineage in domain.types.items() if other != spelled}
    facts = frozenset(fact for fact in domain.facts if spelled not in arguments_of(fact))
    goal = tuple(each for each in domain.goal if spelled not in constants_in(each))
    return replace(domain, types=types, facts=facts, goal=goal)


def initial_state(domain: Domain) -> State:
    """Return the initial facts of the problem file, with what the file states about feasibility."""
    stated = set(domain.facts)
    for text, value in domain.numbers.items():
        if head_of(text) in domain.computed:
            stated.add(number_fact(text, value))
    return frozenset(stated)


def feasible_atoms(domain: Domain, kb: Feasibility) -> State:
    """Return the facts `(action_feasible ?a)` that are true now by the knowledge base."""
    atoms = [atom for atom, action in domain.feasibility.items() if kb.is_feasible(action)]
    return frozenset(atoms)


def without_feasibility(domain: Domain, state: State) -> State:
    """Return a state without `(action_feasible ?a)`, which the knowledge base decides."""
    return state.difference(domain.feasibility)


# ---------------------------------------------------------------- errors


class RosaPddlError(Exception):
    """Base of every error that this package raises."""


class PddlError(RosaPddlError):
    """A PDDL file cannot be used; the message says where, what was found and what was expected.

    Line and column are counted from 1; None when unknown.
    """

    def __init__(
        self, message: str, file: str | Path, line: int | None = None, column: int | None = None
    ) -> None:
        self.message = message
        self.file = str(file)
        self.line = line
        self.column = column
        place = ":".join(str(part) for part in (file, line, column) if part is not None)
        super().__init__(f"{place}: {message}")


class UnsupportedPddlError(PddlError):
    """PDDL that is correct, but that the executor or its planner cannot handle."""


class UnknownNameError(RosaPddlError):
    """A name that the domain does not know; the message lists the nearest known ones."""


class MissingBehaviourError(RosaPddlError):
    """A PDDL action has no factory that makes its behaviour."""


class GoalError(RosaPddlError):
    """A goal that cannot be added or dropped."""


class SensingError(RosaPddlError):
    """A value that is sensed or forecast cannot be used."""


class PlannerSettingError(RosaPddlError):
    """A setting of a planner makes no sense."""


class PlanningBudgetError(RosaPddlError):
    """In lock-step simulation, planning took more wall-clock time than its budget.

    Going on would make the run depend on the speed of the machine, so the run ends instead.
    """


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the names nearest to a misspelt one for a message, or else the first ten."""
    names = sorted(set(known))
    if not names:
        return "there are none"
    by_lower = {candidate.lower(): candidate for candidate in names}
    close = [by_lower[match] for match in get_close_matches(name.lower(), by_lower, n=3)]
    if close:
        return "nearest: " + ", ".join(close)
    shown = ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")
    return "known: " + shown


# ---------------------------------------------------------------- atoms and numbers as text


def atom_text(name: str, arguments: Iterable[str]) -> str:
    """Return an atom, or a number, as text: `(at rover hall)`."""
    return "(" + " ".join((name, *arguments)) + ")"


def variables_text(variables: Variables) -> str:
    """Return variables with their types as text: `?a - room ?b - robot`."""
    return " ".join(f"{name} - {kind}" for name, kind in variables)


def exact(value: float | Fraction) -> Exact:
    """Return the exact value of a number as it is written in decimals: 0.1 is one tenth."""
    if isinstance(value, int):
        return value
    if isinstance(value, float) and value.is_integer() and abs(value) < _ALL_WHOLE:
        return int(value)
    written = value if isinstance(value, Fraction) else Fraction(str(float(value)))
    return written.numerator if written.denominator == 1 else written


def number_text(value: Exact) -> str:
    """Return a number in decimals if they are exact, else as a fraction such as `1/3`."""
    value = exact(value)
    if isinstance(value, Fraction) and Fraction(str(float(value))) == value:
        return str(float(value))
    return str(value)


def number_fact(text: str, value: Exact) -> str:
    """Return the fact that a number has a value: `(= (fuel rover) 80.5)`."""
    return f"(= {text} {number_text(value)})"


def numbers_in(facts: Iterable[str]) -> dict[str, Exact]:
    """Return the numbers of a state by their text."""
    values = dict[str, Exact]()
    for fact in facts:
        if fact.startswith("(= "):
            text, _, value = fact[3:-1].rpartition(" ")
            values[text] = exact(Fraction(value))
    return values


def subject_of(fact: str) -> str:
    """Return what a fact is about: an atom itself, or the number whose value is stated."""
    return fact[3:-1].rpartition(" ")[0] if fact.startswith("(= ") else fact


def head_of(fact: str) -> str:
    """Return the predicate of an atom, or the name in a numeric fact: `lit` for `(lit room)`."""
    return subject_of(fact)[1:-1].split(" ", 1)[0]


def arguments_of(fact: str) -> list[str]:
    """Return the arguments of an atom, or of a number: `["room"]` for `(lit room)`."""
    return subject_of(fact)[1:-1].split()[1:]


# ---------------------------------------------------------------- formulas


def conjuncts(formulas: Iterable[Formula]) -> Iterator[Formula]:
    """Yield the parts of formulas, with conjunctions split."""
    for formula in formulas:
        if formula[0] == "and":
            yield from conjuncts(formula[1:])
        else:
            yield formula


def parts_of(formula: Formula) -> Iterator[Formula]:
    """Yield a formula or number and all formulas and numbers in it."""
    yield formula
    head = formula[0]
    if head in ("forall", "exists"):
        yield from parts_of(formula[2])
    elif head not in ("atom", "n", "same"):
        for part in formula[1:]:
            if isinstance(part, tuple):
                yield from parts_of(part)


def names_in(formulas: Iterable[Formula]) -> set[str]:
    """Return the predicates and numbers that formulas mention."""
    names = set[str]()
    for formula in formulas:
        if isinstance(formula, tuple):
            names.update(part[1] for part in parts_of(formula) if part[0] in ("atom", "n"))
    return names


def constants_in(formula: Formula) -> set[str]:
    """Return the objects that a formula names."""
    words = set[str]()
    for part in parts_of(formula):
        if part[0] in ("atom", "n"):
            words.update(part[2])
        elif part[0] == "same":
            words.update(part[1:])
    return {word for word in words if not word.startswith("?")}


def bound(terms: Iterable[str], binding: Binding) -> list[str]:
    """Return terms with their variables replaced by objects."""
    return [binding.get(term, term) for term in terms]


def text_of(formula: Any, binding: Binding | None = None) -> str:  # noqa: ANN401  # also numbers
    """Return a formula or a number as PDDL text, with its variables replaced by objects."""
    scope = binding or {}
    if not isinstance(formula, tuple):
        # a fraction that decimals do not write exactly, as PDDL writes it
        numerator, *denominator = number_text(formula).split("/")
        return f"(/ {numerator} {denominator[0]})" if denominator else numerator
    head, *parts = formula
    if head in ("atom", "n"):
        return atom_text(parts[0], bound(parts[1], scope))
    if head == "same":
        return atom_text("=", bound(parts, scope))
    if head in ("forall", "exists"):
        variables, inner = parts
        names = {name for name, _ in variables}
        visible = {name: thing for name, thing in scope.items() if name not in names}
        return f"({head} ({variables_text(variables)}) {text_of(inner, visible)})"
    if head == "or" and len(parts) == 2 and parts[0][0] == "not":
        head = "imply"
        parts = [parts[0][1], parts[1]]
    return atom_text(head, [text_of(part, scope) for part in parts])
