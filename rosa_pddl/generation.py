"""From declarations in Python to PDDL: what an action needs and does is said once, beside the behaviour that does it.

What is generated follows ROSA's convention: a type `action` with one object for each ROSA action, a predicate
`(NAME_action ?a)` that tells which object is which, and `(action_feasible ?a)`, which the knowledge base answers.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Final

from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, Domain
from rosa_pddl.exceptions import PddlError, nearest
from rosa_pddl.reader import parse_domain
from rosa_pddl.reading.signatures import Signatures, Uses, typed_names

__all__ = ["ActionSchema", "Declarations", "DeclaredProblem"]

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_SIMPLE: Final = frozenset({"and"})


@dataclass(frozen=True)
class ActionSchema:
    """A PDDL action as it is declared: `schema = ActionSchema(...)` in the class of the behaviour that does it.

    Formulas are texts of PDDL such as `"(found ?x)"` or `"(not (lit ?room))"`. That the ROSA action is feasible is a
    condition by itself; in formulas it is `?a`.

    Args:
        name: of the PDDL action.
        parameters: each as `"?x - type"`.
        start: conditions that hold when it starts.
        over_all: conditions that hold throughout; only of an action with a duration, as the next two.
        end: conditions that hold when it ends.
        start_effects: what becomes so when it starts.
        end_effects: what becomes so when it ends.
        duration_s: how long it takes [s]; None for an instantaneous action.
        cost: what it costs: a number, or the text of a numeric fact such as `"(travel_cost ?x ?y)"`; None for nothing.
            If no action has a cost, plans with the fewest steps are the best.
        uses: what it uses up of resources, by their names, as numbers or the texts of numeric facts: such as
            `{"energy_used": "(takes ?way ?mode)"}`. Where the problem limits one, plan with `Planner("label-setting")`.
        action: name of the ROSA action that is done; empty if it is called `name` too, None if there is none.
        makes_feasible: names of ROSA actions that are expected to be feasible afterwards; this serves planning only.
    """

    name: str
    parameters: tuple[str, ...] = ()
    start: tuple[str, ...] = ()
    over_all: tuple[str, ...] = ()
    end: tuple[str, ...] = ()
    start_effects: tuple[str, ...] = ()
    end_effects: tuple[str, ...] = ()
    duration_s: float | None = None
    cost: float | str | None = None
    uses: Mapping[str, float | str] = field(default_factory=dict, hash=False)
    action: str | None = ""
    makes_feasible: tuple[str, ...] = ()

    @property
    def rosa_action(self) -> str | None:
        """Name of the ROSA action that is done; None if there is none."""
        return self.name if self.action == "" else self.action


@dataclass(frozen=True)
class DeclaredProblem:
    """What there is, what is so in the beginning, and what shall be so in the end.

    Args:
        goal: formulas that shall all hold, such as `"(found treasure)"`.
        objects: the type of each object by its name; ROSA actions are objects by themselves.
        facts: the atoms that are true in the beginning; that of which ROSA action is which is added.
        numbers: values of numeric facts that costs, uses and limits are made of, such as `{"(travel_cost a b)": 3.5}`;
            and of resources what was used up before, such as `{"(energy_used)": 120.0}`, if that is not 0.
        types: for each subtype the type above it.
        limits: how much of resources may be used up, by their names, with what was used up before: a number, or the
            text of a numeric fact that may be sensed, such as `{"energy_used": "(energy_full)"}`.
    """

    goal: tuple[str, ...]
    objects: Mapping[str, str] = field(default_factory=dict)
    facts: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, float | str] = field(default_factory=dict)


class Declarations:
    """A domain with its problem, made of declarations.

    Args:
        name: of both.
        schemas: the PDDL actions.
        problem: the rest.

    Raises:
        PddlError: something is declared in a way that has no meaning; the message names the declaration.
    """

    def __init__(self, name: str, schemas: Iterable[ActionSchema], problem: DeclaredProblem) -> None:
        self.name = name
        self.schemas = tuple(schemas)
        self.problem = problem
        self._place = f"declarations of {name}"
        for one in self.schemas:
            _check(one)
        self._check_names()
        self._uses = self._used()

    @property
    def rosa_actions(self) -> tuple[str, ...]:
        """The ROSA actions that are done, or made feasible."""
        done = [one.rosa_action for one in self.schemas if one.rosa_action is not None]
        return tuple(dict.fromkeys([*done, *(name for one in self.schemas for name in one.makes_feasible)]))

    @property
    def domain_pddl(self) -> str:
        """The text of the domain file."""
        constants = [name for name in self.problem.objects if name.lower() in self._uses.constants]
        functions = list(self._functions())
        parts = [
            f"; Generated from the {self._place}.",
            f"(define (domain {self.name})",
            f"  (:requirements {' '.join(self._requirements())})",
            f"  (:types {' '.join(self._types())})",
            *([f"  (:constants {self._typed_objects(constants)})"] if constants else []),
            "  (:predicates",
            *(f"    {_signature(name, kinds)}" for name, kinds in self._uses.predicates.items()),
            "  )",
            *([f"  (:functions {' '.join(functions)})"] if functions else []),
            *(_action(one, self._has_costs) for one in self.schemas),
            ")",
        ]
        return "\n".join([*parts, ""])

    @property
    def problem_pddl(self) -> str:
        """The text of the problem file."""
        problem = self.problem
        objects = [name for name in problem.objects if name.lower() not in self._uses.constants]
        facts = [f"({action}_action {action})" for action in self.rosa_actions]
        told = {**{f"({name})": 0.0 for name in self._resources}, **problem.numbers}
        numbers = [f"(= {atom} {_number(value)})" for atom, value in told.items()]
        if self._has_costs:
            numbers.append("(= (total-cost) 0)")
        limits = [f"(<= ({name}) {_number(limit)})" for name, limit in problem.limits.items()]
        actions = f"{' '.join(self.rosa_actions)} - {ACTION_TYPE} " if self.rosa_actions else ""
        parts = [
            f"; Generated from the {self._place}.",
            f"(define (problem {self.name})",
            f"  (:domain {self.name})",
            f"  (:objects {actions}{self._typed_objects(objects)})",
            "  (:init",
            *(f"    {fact}" for fact in (*facts, *problem.facts, *numbers)),
            "  )",
            f"  (:goal (and {' '.join([*problem.goal, *limits])}))",
            *(["  (:metric minimize (total-cost))"] if self._has_costs else []),
            ")",
        ]
        return "\n".join([*parts, ""])

    def load(self) -> Domain:
        """Read what is generated, as `load_domain` reads files.

        Raises:
            PddlError: it is no PDDL, or none that can be planned here; the place is that in the generated text.
        """
        domain, problem = (f"{kind}.pddl generated from the {self._place}" for kind in ("domain", "problem"))
        return parse_domain(self.domain_pddl, self.problem_pddl, names=(domain, problem))

    # ---------------------------------------------------------------- checks

    def _check_names(self) -> None:
        problem = self.problem
        names = (self.name, *problem.objects, *problem.objects.values(), *problem.types, *problem.types.values())
        for name in names:
            _check_name(name, self._place)
        if not self.schemas:
            raise PddlError("no action is declared", self._place)
        if not problem.goal:
            raise PddlError("there is no goal; state what shall be so, such as goal=('(found treasure)',)", self._place)
        for name in problem.limits:
            if name not in self._resources:
                hint = nearest(name, self._resources)
                raise PddlError(f"{name!r} is limited, but no action uses it up; {hint}", self._place)
        known = [each.rosa_action for each in self.schemas if each.rosa_action is not None]
        taken: set[str] = set()
        for one in self.schemas:
            if one.name.lower() in taken:
                raise PddlError(f"the action {one.name!r} is declared twice (PDDL ignores case)", self._place)
            taken.add(one.name.lower())
            for action in one.makes_feasible:
                if action not in known:
                    raise PddlError(
                        f"makes {action!r} feasible, which no action does; {nearest(action, known)}", _of(one)
                    )

    def _used(self) -> Uses:
        """Find out what the predicates and numeric facts are about, from how they are used."""
        objects = {**self.problem.objects, **dict.fromkeys(self.rosa_actions, ACTION_TYPE)}
        own = (FEASIBLE, *(f"{action}_action".lower() for action in self.rosa_actions))
        signatures = Signatures(objects, self.problem.types, dict.fromkeys(own, (ACTION_TYPE,)))
        for one in self.schemas:
            scope = _scope(one)
            for condition in (*one.start, *one.over_all, *one.end):
                signatures.read(condition, scope, _of(one))
            for effect in (*one.start_effects, *one.end_effects):
                signatures.read(effect, scope, _of(one), is_effect=True)
            for amount in (one.cost, *one.uses.values()):
                if isinstance(amount, str):
                    signatures.read_number(amount, scope, _of(one))
            for name in one.uses:
                signatures.read_number(f"({name})", {}, _of(one))
        for amount in self.problem.limits.values():
            if isinstance(amount, str):
                signatures.read_number(amount, {}, self._place)
        uses = signatures.uses()
        for text in (*self.problem.goal, *self.problem.facts):
            signatures.check(text, uses, self._place)
        for text in self.problem.numbers:
            signatures.check(text, uses, self._place, is_number=True)
        return uses

    # ---------------------------------------------------------------- parts of the text

    @property
    def _has_costs(self) -> bool:
        return any(one.cost is not None for one in self.schemas)

    @property
    def _resources(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for one in self.schemas for name in one.uses))

    def _requirements(self) -> Iterator[str]:
        yield from (":strips", ":typing")
        if self._uses.connectives - _SIMPLE:
            yield ":adl"
        if any(one.duration_s is not None for one in self.schemas):
            yield ":durative-actions"
        if self._has_costs:
            yield ":action-costs"
        if self._resources:
            yield ":numeric-fluents"

    def _types(self) -> Iterator[str]:
        above = self.problem.types
        used = [ACTION_TYPE, *(kind for one in self.schemas for kind in _scope(one).values())]
        used += [*self.problem.objects.values(), *above.values()]
        roots = [kind for kind in dict.fromkeys(used) if kind not in above and kind != "object"]
        yield " ".join(roots) + (" - object" if above else "")
        yield from (f"{kind} - {parent}" for kind, parent in above.items())

    def _typed_objects(self, names: Iterable[str]) -> str:
        return " ".join(f"{name} - {self.problem.objects[name]}" for name in names)

    def _functions(self) -> Iterator[str]:
        yield from (_signature(name, kinds) for name, kinds in self._uses.numbers.items())
        if self._has_costs:
            yield "(total-cost)"


def _signature(name: str, kinds: Iterable[str]) -> str:
    return " ".join([f"({name}", *(f"?x{number} - {kind}" for number, kind in enumerate(kinds, start=1))]) + ")"


def _of(schema: ActionSchema) -> str:
    return f"schema {schema.name}"


def _check_name(name: str, place: str) -> None:
    if not _NAME.fullmatch(name):
        message = f"{name!r} is no name in PDDL; expected a letter first, then letters, digits, '_' or '-'"
        raise PddlError(message, place)


def _check(schema: ActionSchema) -> None:
    place = _of(schema)
    for key in ("parameters", "start", "over_all", "end", "start_effects", "end_effects", "makes_feasible"):
        if isinstance(getattr(schema, key), str):
            raise PddlError(f"{key} is one text, expected several; write ({getattr(schema, key)!r},)", place)
    for name in (schema.name, *schema.makes_feasible, *([] if schema.rosa_action is None else [schema.rosa_action])):
        _check_name(name, place)
    for name, kind in typed_names(schema.parameters, place):
        _check_name(kind, place)
        if name.lower() in _reserved(schema):
            raise PddlError(f"the parameter {name} is taken: it stands for a ROSA action; choose another name", place)
    for name in schema.uses:
        _check_name(name, place)
    amounts = {f"uses[{name!r}]": value for name, value in schema.uses.items()}
    for key, value in {"duration_s": schema.duration_s, "cost": schema.cost, **amounts}.items():
        if isinstance(value, int | float) and not 0.0 <= value < float("inf"):
            raise PddlError(f"{key} is {value:g}, expected a number that is not negative", place)
    if schema.duration_s is None and (schema.over_all or schema.end or schema.start_effects):
        message = "over_all, end and start_effects are for an action that takes time; state duration_s"
        raise PddlError(message, place)


def _reserved(schema: ActionSchema) -> list[str]:
    """Return the parameters that stand for ROSA actions."""
    own = ["?a"] if schema.rosa_action is not None else []
    return own + [f"?a{number}" for number in range(1, len(schema.makes_feasible) + 1)]


def _scope(schema: ActionSchema) -> dict[str, str]:
    """Return the types of the parameters, those for ROSA actions first."""
    return {**dict.fromkeys(_reserved(schema), ACTION_TYPE), **dict(typed_names(schema.parameters, _of(schema)))}


def _action(schema: ActionSchema, has_costs: bool) -> str:
    own = [f"({schema.rosa_action}_action ?a)", f"({FEASIBLE} ?a)"] if schema.rosa_action is not None else []
    expected = [
        (f"({action}_action ?a{number})", f"?a{number}") for number, action in enumerate(schema.makes_feasible, start=1)
    ]
    start = [*schema.start, *(condition for condition, _ in expected)]
    effects = [*schema.end_effects, *(f"({FEASIBLE} {parameter})" for _, parameter in expected)]
    if has_costs:
        effects.append(f"(increase (total-cost) {_number(schema.cost or 0)})")
    effects += [f"(increase ({name}) {_number(amount)})" for name, amount in schema.uses.items()]
    parameters = " ".join(f"{name} - {kind}" for name, kind in _scope(schema).items())
    if schema.duration_s is None:
        lines = [
            f"  (:action {schema.name}",
            f"    :parameters ({parameters})",
            *_block(":precondition", [*own, *start]),
            *_block(":effect", effects),
        ]
        return "\n".join([*lines, "  )"])
    conditions = [*_timed("at start", start), *_timed("over all", [*own, *schema.over_all])]
    lines = [
        f"  (:durative-action {schema.name}",
        f"    :parameters ({parameters})",
        f"    :duration (= ?duration {_number(schema.duration_s)})",
        *_block(":condition", [*conditions, *_timed("at end", schema.end)]),
        *_block(":effect", [*_timed("at start", schema.start_effects), *_timed("at end", effects)]),
    ]
    return "\n".join([*lines, "  )"])


def _timed(when: str, formulas: Iterable[str]) -> list[str]:
    return [f"({when} {formula})" for formula in formulas]


def _block(keyword: str, formulas: Iterable[str]) -> list[str]:
    return [f"    {keyword} (and", *(f"      {formula}" for formula in formulas), "    )"]


def _number(value: float | str) -> str:
    if isinstance(value, str):
        return value
    short = f"{value:.12g}"
    return short if float(short) == value else format(Decimal(str(value)), "f")
