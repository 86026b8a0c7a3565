"""Generates PDDL from declarations in Python, so that an action is declared once, beside the behaviour that does it.

The PDDL follows ROSA's convention: a type `action` with one object for each ROSA action, a predicate `(NAME_action ?a)`
that is true for this object only, and `(action_feasible ?a)`, whose value comes from the knowledge base.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from decimal import Decimal
from itertools import chain, starmap
from typing import Final

from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, Domain
from rosa_pddl.exceptions import PddlError, nearest
from rosa_pddl.reader import build_domain
from rosa_pddl.syntax import (
    ANY,
    CHANGES,
    COMPARISONS,
    Node,
    Source,
    formula,
    listed,
    nodes_of,
    typed,
)

_CONNECTIVES: Final = ("and", "or", "not", "imply", "when")
_COMPUTING: Final = (*COMPARISONS, *CHANGES, "=", "+", "-", "*", "/")

_Scope = Mapping[str, str]


@dataclass(frozen=True)
class ActionSchema:
    """Declares a PDDL action: `schema = ActionSchema(...)` in the class of the behaviour that does it.

    Formulas are PDDL texts such as `"(found ?x)"` or `"(not (lit ?room))"`. The condition that the ROSA action is
    feasible is added automatically; formulas refer to the ROSA action as `?a`.

    Args:
        name: name of the PDDL action.
        parameters: each as `"?x - type"`.
        start: conditions that hold when it starts.
        over_all: conditions that hold throughout; like `end` and `start_effects`, only for an action with a duration.
        end: conditions that hold when it ends.
        start_effects: effects when it starts.
        end_effects: effects when it ends.
        duration_s: how long it takes [s]; None for an instantaneous action.
        cost: what it costs: a number, or the text of a numeric fact such as `"(travel_cost ?x ?y)"`; None for nothing.
            If no action has a cost, plans with the fewest steps are the best.
        uses: how much it uses of each resource, by name, as a number or the text of a numeric fact, such as
            `{"energy_used": "(takes ?way ?mode)"}`. If the problem limits one, plan with `Planner("label-setting")`.
        action: name of the ROSA action that it does; empty if this is `name` too, None if there is none.
        makes_feasible: names of ROSA actions that are expected to be feasible afterwards; used for planning only.
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
        """Name of the ROSA action that it does; None if there is none."""
        return self.name if self.action == "" else self.action


@dataclass(frozen=True)
class DeclaredProblem:
    """Declares a problem: its objects, initial facts and numbers, goals and limits.

    Args:
        goal: formulas that must all hold in the end, such as `"(found treasure)"`.
        objects: the type of each object by its name; the objects of ROSA actions are added automatically.
        facts: the atoms that are true initially; the facts `(NAME_action ...)` are added automatically.
        numbers: values of numeric facts that costs, uses and limits depend on, such as `{"(travel_cost a b)": 3.5}`,
            and how much of a resource was used up before, such as `{"(energy_used)": 120.0}`, if that is not 0.
        types: for each subtype its parent type.
        limits: how much of each resource may be used up in all, with what was used up before, by name: a number, or
            the text of a numeric fact, which may be sensed, such as `{"energy_used": "(energy_full)"}`.
    """

    goal: tuple[str, ...]
    objects: Mapping[str, str] = field(default_factory=dict)
    facts: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[str, float | str] = field(default_factory=dict)


class Declarations:
    """A PDDL domain with its problem, made from declarations.

    Args:
        name: name of the domain and of the problem.
        schemas: the PDDL actions.
        problem: the declared problem.

    Raises:
        PddlError: a declaration makes no sense; the message names it.
    """

    def __init__(
        self, name: str, schemas: Iterable[ActionSchema], problem: DeclaredProblem
    ) -> None:
        self.name = name
        self.schemas = tuple(schemas)
        self.problem = problem
        self._place = f"declarations of {name}"
        self._title = re.sub(
            r"[^A-Za-z0-9_-]+", "_", name
        )  # a mission may have any name, a domain of PDDL may not
        _check_texts(problem, self._place)
        for one in self.schemas:
            _check(one)
        if not self.schemas:
            raise PddlError("no action is declared", self._place)
        for name in problem.limits:
            if name not in self._resources:
                hint = nearest(name, self._resources)
                raise PddlError(
                    f"{name!r} is limited, but no action uses it up; {hint}", self._place
                )
        if not problem.goal:
            raise PddlError(
                "there is no goal; state what shall be so, such as goal=('(found treasure)',)",
                self._place,
            )

    @property
    def rosa_actions(self) -> tuple[str, ...]:
        """The ROSA actions that a PDDL action does or makes feasible."""
        done = [one.rosa_action for one in self.schemas if one.rosa_action is not None]
        return tuple(
            dict.fromkeys([*done, *(name for one in self.schemas for name in one.makes_feasible)])
        )

    @property
    def domain_pddl(self) -> str:
        """The text of the domain file."""
        return self._written(self._domain_lists())

    @property
    def problem_pddl(self) -> str:
        """The text of the problem file."""
        return self._written(self._problem_lists())

    def load(self) -> Domain:
        """Build the domain from the declarations, as `load_domain` does from files.

        Raises:
            PddlError: the declarations are not correct PDDL, or cannot be planned here.
        """
        file = "{}.pddl generated from the " + self._place
        domain = Source(file.format("domain"), self._domain_lists())
        return build_domain(domain, Source(file.format("problem"), self._problem_lists()))

    @property
    def _has_costs(self) -> bool:
        return any(one.cost is not None for one in self.schemas)

    @property
    def _resources(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for one in self.schemas for name in one.uses))

    @property
    def _objects(self) -> Iterable[tuple[str, str]]:
        return *dict.fromkeys(self.rosa_actions, ACTION_TYPE).items(), *self.problem.objects.items()

    def _listed_objects(self, *, constant: bool) -> Iterator[str]:
        """Yield objects with their types: either the constants, which actions name, or all others."""
        words = {
            word.lower
            for one in self.schemas
            for formula in _formulas(one)
            for word in nodes_of(formula)
        }
        for name, kind in self._objects:
            yield from (name, "-", kind) if (name.lower() in words) is constant else ()

    def _domain_lists(self) -> Node:
        predicates, numbers = self._signatures()
        has_durations = any(one.duration_s is not None for one in self.schemas)
        requirements = [":typing", ":adl", *[":durative-actions"] * has_durations]
        return listed(
            "define",
            listed("domain", self._title),
            listed(
                ":requirements",
                *requirements,
                *[":numeric-fluents"] * bool(numbers or self._has_costs),
            ),
            listed(":types", *self._types()),
            listed(":constants", *self._listed_objects(constant=True)),
            listed(":predicates", *predicates),
            listed(":functions", *numbers, *[listed("total-cost")] * self._has_costs),
            *(_action(one, self._has_costs) for one in self.schemas),
        )

    def _problem_lists(self) -> Node:
        problem = self.problem
        facts = [listed(f"{action}_action", action) for action in self.rosa_actions]
        numbers = {**{f"({name})": 0.0 for name in self._resources}, **problem.numbers}
        facts += [_parsed(fact, self._place) for fact in problem.facts]
        facts += [
            listed("=", _parsed(atom, self._place), _number(value))
            for atom, value in numbers.items()
        ]
        goals = [_parsed(text, self._place) for text in problem.goal]
        goals += [
            listed("<=", listed(name), _number(limit)) for name, limit in problem.limits.items()
        ]
        return listed(
            "define",
            listed("problem", self._title),
            listed(":domain", self._title),
            listed(":objects", *self._listed_objects(constant=False)),
            listed(":init", *facts),
            listed(":goal", listed("and", *goals)),
            *[listed(":metric", "minimize", listed("total-cost"))] * self._has_costs,
        )

    def _signatures(self) -> list[list[Node]]:
        """Return the predicates and the numbers with the types of their arguments, `object` where their uses differ."""
        objects = {name.lower(): kind for name, kind in self._objects}
        own = (FEASIBLE, *(f"{action}_action" for action in self.rosa_actions))
        predicates: dict[str, list[list[str]]] = {name.lower(): [[ACTION_TYPE]] for name in own}
        numbers: dict[str, list[list[str]]] = {}
        for scope, formulas in ((_scope(one), _formulas(one)) for one in self.schemas):
            for atom, kinds, is_number in chain.from_iterable(
                _atoms(one, {**objects, **scope}) for one in formulas
            ):
                (numbers if is_number else predicates).setdefault(atom.head, []).append(kinds)
        for amount in self.problem.limits.values():
            numbers |= {_parsed(amount, self._place).head: [[]]} if isinstance(amount, str) else {}
        numbers.pop("total-cost", None)
        return [list(starmap(_declared, used.items())) for used in (predicates, numbers)]

    def _types(self) -> Iterator[str]:
        above = self.problem.types
        used = [ACTION_TYPE, *(kind for one in self.schemas for kind in _scope(one).values())]
        used += [*self.problem.objects.values(), *above.values()]
        yield from (kind for kind in dict.fromkeys(used) if kind not in above and kind != "object")
        yield from ["-", "object"]
        yield from (word for kind, parent in above.items() for word in (kind, "-", parent))

    def _written(self, lists: Node) -> str:
        self.load()  # raises PddlError if it is not correct PDDL
        sections = [
            str(node).replace(" :", "\n    :") for node in lists.children[2:] if node.children[1:]
        ]
        return (
            "\n ".join(
                [f"; Generated from the {self._place}.\n(define {lists.children[1]}", *sections]
            )
            + ")\n"
        )


def _declared(name: str, uses: Sequence[Sequence[str]]) -> Node:
    """Declare a predicate or number, given the types of the arguments in each of its uses."""
    kinds = (kinds[0] if len({*kinds}) == 1 else "object" for kinds in zip(*uses, strict=False))
    return listed(
        name,
        *chain.from_iterable((f"?x{number}", "-", kind) for number, kind in enumerate(kinds, 1)),
    )


def _formulas(schema: ActionSchema) -> Iterator[Node]:
    texts = (
        *schema.start,
        *schema.over_all,
        *schema.end,
        *schema.start_effects,
        *schema.end_effects,
    )
    yield from (_parsed(text, _of(schema)) for text in texts)
    amounts = [one for one in (schema.cost, *schema.uses.values()) if isinstance(one, str)]
    yield from (listed("+", _parsed(one, _of(schema))) for one in amounts)
    yield from (listed("+", listed(name)) for name in schema.uses)


def _atoms(
    node: Node, scope: _Scope, is_number: bool = False
) -> Iterator[tuple[Node, list[str], bool]]:
    """Yield each atom and each number of a formula, with the types of its arguments, and whether it is a number."""
    head, rest = node.head, node.children[1:]
    if head in ("forall", "exists") and rest:
        scope, rest = {**scope, **_typed(rest[0].children)}, rest[1:]
    elif head and head not in _CONNECTIVES + _COMPUTING:
        yield node, [scope.get(one.lower, "object") for one in rest], is_number
        return
    for child in (one for one in rest if one.is_list):
        # the parts of a comparison, of a computation and of an effect on a number are numbers
        yield from _atoms(child, scope, is_number=head in _COMPUTING)


def _parsed(text: str, place: str) -> Node:
    if not text.strip().startswith("("):
        raise PddlError(
            f"found {text!r}, expected a formula such as '({text.strip() or 'lit ?room'})'", place
        )
    return formula(text, f"{place}, in {text!r}")


def _typed(nodes: Iterable[Node]) -> _Scope:
    found = typed(Source("parameters", ANY), nodes)
    return {
        name.lower: "object" if kind is None or kind.is_list else str(kind) for name, kind in found
    }


def _of(schema: ActionSchema) -> str:
    return f"schema {schema.name}"


def _check_texts(declared: ActionSchema | DeclaredProblem, place: str) -> None:
    for one in fields(declared):
        value = getattr(declared, one.name)
        if isinstance(value, str) and str(one.type).startswith("tuple"):
            raise PddlError(f"{one.name} is one text, expected several; write ({value!r},)", place)


def _check(schema: ActionSchema) -> None:
    place = _of(schema)
    _check_texts(schema, place)
    amounts = {f"uses[{name!r}]": value for name, value in schema.uses.items()}
    for key, value in {"duration_s": schema.duration_s, "cost": schema.cost, **amounts}.items():
        if isinstance(value, int | float) and not 0.0 <= value < float("inf"):
            raise PddlError(f"{key} is {value:g}, expected a number that is not negative", place)
    if schema.duration_s is None and (schema.over_all or schema.end or schema.start_effects):
        message = (
            "over_all, end and start_effects are for an action that takes time; state duration_s"
        )
        raise PddlError(message, place)


def _parameters(schema: ActionSchema) -> Node:
    """Return the parameters with their types, those for ROSA actions first."""
    own = ["?a"] if schema.rosa_action is not None else []
    own += [f"?a{number}" for number in range(1, len(schema.makes_feasible) + 1)]
    given = (_parsed(f"({text})", _of(schema)).children for text in schema.parameters)
    return listed(
        *(word for one in own for word in (one, "-", ACTION_TYPE)), *chain.from_iterable(given)
    )


def _scope(schema: ActionSchema) -> _Scope:
    return _typed(_parameters(schema).children)


def _action(schema: ActionSchema, has_costs: bool) -> Node:
    def formulas(*texts: str) -> list[Node]:
        return [_parsed(text, _of(schema)) for text in texts]

    own = (
        formulas(f"({schema.rosa_action}_action ?a)", f"({FEASIBLE} ?a)")
        if schema.rosa_action is not None
        else []
    )
    start, effects = formulas(*schema.start), formulas(*schema.end_effects)
    for number, action in enumerate(schema.makes_feasible, start=1):
        start += formulas(f"({action}_action ?a{number})")
        effects += formulas(f"({FEASIBLE} ?a{number})")
    amounts = {**({"total-cost": schema.cost or 0} if has_costs else {}), **schema.uses}
    effects += [
        listed("increase", listed(name), _number(amount)) for name, amount in amounts.items()
    ]
    parameters = _parameters(schema)
    if schema.duration_s is None:
        parts = (":precondition", listed("and", *own, *start), ":effect", listed("and", *effects))
        return listed(":action", schema.name, ":parameters", parameters, *parts)
    over_all, end = (*own, *formulas(*schema.over_all)), formulas(*schema.end)
    conditions = (*_at("at start", start), *_at("over all", over_all), *_at("at end", end))
    changes = (*_at("at start", formulas(*schema.start_effects)), *_at("at end", effects))
    duration = listed("=", "?duration", _number(schema.duration_s))
    parts = (":condition", listed("and", *conditions), ":effect", listed("and", *changes))
    return listed(
        ":durative-action", schema.name, ":parameters", parameters, ":duration", duration, *parts
    )


def _at(when: str, formulas: Iterable[Node]) -> list[Node]:
    return [listed(*when.split(), formula) for formula in formulas]


def _number(value: float | str) -> Node | str:
    if isinstance(value, str):
        return _parsed(value, value)
    short = f"{value:.12g}"
    return short if float(short) == value else format(Decimal(str(value)), "f")
