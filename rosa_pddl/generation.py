"""From declarations in Python to PDDL: what an action needs and does is said once, beside the behaviour that does it.

What is made follows ROSA's convention: a type `action` with one object for each ROSA action, a predicate
`(NAME_action ?a)` that tells which object is which, and `(action_feasible ?a)`, which the knowledge base answers.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Final

from rosa_pddl.domain import ACTION_TYPE, FEASIBLE, Domain
from rosa_pddl.exceptions import PddlError, nearest
from rosa_pddl.reader import build_domain
from rosa_pddl.syntax import BODY, Node, Source, formula, listed, typed

_CONNECTIVES: Final = frozenset({"and", "or", "not", "imply", "when"})
_NUMERIC: Final = frozenset({"<", ">", "<=", ">=", "assign", "increase", "decrease", "scale-up", "scale-down"})
_TIMED: Final = frozenset({("at", "start"), ("at", "end"), ("over", "all")})

_Kinds = tuple[str, ...]
_Scope = Mapping[str, str]


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
        self._check_problem()
        self._signatures = self._used()

    @property
    def rosa_actions(self) -> tuple[str, ...]:
        """The ROSA actions that are done, or made feasible."""
        done = [one.rosa_action for one in self.schemas if one.rosa_action is not None]
        return tuple(dict.fromkeys([*done, *(name for one in self.schemas for name in one.makes_feasible)]))

    @property
    def domain_pddl(self) -> str:
        """The text of the domain file."""
        return self._written(self._domain_lists())

    @property
    def problem_pddl(self) -> str:
        """The text of the problem file."""
        return self._written(self._problem_lists())

    def load(self) -> Domain:
        """Make the domain, as `load_domain` makes that of files.

        Raises:
            PddlError: it has no meaning in PDDL, or none that can be planned here.
        """
        file = "{}.pddl generated from the " + self._place
        domain = Source(file.format("domain"), self._domain_lists())
        return build_domain(domain, Source(file.format("problem"), self._problem_lists()))

    def _check_problem(self) -> None:
        problem = self.problem
        if not self.schemas:
            raise PddlError("no action is declared", self._place)
        if not problem.goal:
            raise PddlError("there is no goal; state what shall be so, such as goal=('(found treasure)',)", self._place)
        for name in problem.limits:
            if name not in self._resources:
                hint = nearest(name, self._resources)
                raise PddlError(f"{name!r} is limited, but no action uses it up; {hint}", self._place)
        known = [each.rosa_action for each in self.schemas if each.rosa_action is not None]
        for one in self.schemas:
            for action in one.makes_feasible:
                if action not in known:
                    message = f"makes {action!r} feasible, which no action does; {nearest(action, known)}"
                    raise PddlError(message, _of(one))

    def _used(self) -> "_Signatures":
        """Find out what the predicates and numeric facts are about, from how they are used."""
        objects = {**self.problem.objects, **dict.fromkeys(self.rosa_actions, ACTION_TYPE)}
        own = (FEASIBLE, *(f"{action}_action".lower() for action in self.rosa_actions))
        used = _Signatures(objects, self.problem.types, dict.fromkeys(own, (ACTION_TYPE,)))
        for one in self.schemas:
            scope, place = _scope(one), _of(one)
            for text in (*one.start, *one.over_all, *one.end, *one.start_effects, *one.end_effects):
                used.read(_parsed(text, place), scope, place)
            for amount in (one.cost, *one.uses.values(), *(f"({name})" for name in one.uses)):
                if isinstance(amount, str):
                    used.join(used.numbers, _parsed(amount, place), scope, place)
        for amount in self.problem.limits.values():
            if isinstance(amount, str):
                used.join(used.numbers, _parsed(amount, self._place), {}, self._place)
        return used

    @property
    def _has_costs(self) -> bool:
        return any(one.cost is not None for one in self.schemas)

    @property
    def _resources(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for one in self.schemas for name in one.uses))

    def _domain_lists(self) -> Node:
        used = self._signatures
        functions = [_signature(name, kinds) for name, kinds in used.numbers.items()]
        return listed(
            "define",
            listed("domain", self.name),
            listed(":requirements", ":typing", ":adl", *self._requirements()),
            listed(":types", *self._types()),
            listed(":constants", *(word for one in self._objects(constant=True) for word in one)),
            listed(":predicates", *(_signature(name, kinds) for name, kinds in used.predicates.items())),
            listed(":functions", *functions, *([listed("total-cost")] if self._has_costs else [])),
            *(_action(one, self._has_costs) for one in self.schemas),
        )

    def _problem_lists(self) -> Node:
        problem = self.problem
        facts = [listed(f"{action}_action", action) for action in self.rosa_actions]
        numbers = {**{f"({name})": 0.0 for name in self._resources}, **problem.numbers}
        facts += [_parsed(fact, self._place) for fact in problem.facts]
        facts += [listed("=", _parsed(atom, self._place), _number(value)) for atom, value in numbers.items()]
        goals = [_parsed(text, self._place) for text in problem.goal]
        goals += [listed("<=", listed(name), _number(limit)) for name, limit in problem.limits.items()]
        return listed(
            "define",
            listed("problem", self.name),
            listed(":domain", self.name),
            listed(":objects", *(word for one in self._objects(constant=False) for word in one)),
            listed(":init", *facts),
            listed(":goal", listed("and", *goals)),
            *([listed(":metric", "minimize", listed("total-cost"))] if self._has_costs else []),
        )

    def _requirements(self) -> Iterator[str]:
        if any(one.duration_s is not None for one in self.schemas):
            yield ":durative-actions"
        if self._signatures.numbers or self._has_costs:
            yield ":numeric-fluents"

    def _objects(self, *, constant: bool) -> Iterator[tuple[str, str, str]]:
        """Yield the objects with their types: those that formulas name are constants of the domain."""
        for name, kind in (*dict.fromkeys(self.rosa_actions, ACTION_TYPE).items(), *self.problem.objects.items()):
            if (name.lower() in self._signatures.constants) is constant:
                yield name, "-", kind

    def _written(self, lists: Node) -> str:
        self.load()  # what is not correct PDDL is not written
        lines = [f"; Generated from the {self._place}.", f"(define {lists.children[1]}"]
        for node in lists.children[2:]:
            if node.head in BODY:
                lines.append(f" ({node.head} {node.children[1]}")
                parts = node.children[2:]
                for word, value in zip(parts[::2], parts[1::2], strict=True):
                    lines += _in_lines(value, f"  {word} ") if value.head == "and" else [f"  {word} {value}"]
                lines.append(" )")
            elif node.children[1:]:  # some readers refuse a section that is empty
                lines += _in_lines(node) if any(one.is_list for one in node.children) else [f" {node}"]
        return "\n".join([*lines, ")\n"])

    def _types(self) -> Iterator[str]:
        above = self.problem.types
        used = [ACTION_TYPE, *(kind for one in self.schemas for kind in _scope(one).values())]
        used += [*self.problem.objects.values(), *above.values()]
        yield from (kind for kind in dict.fromkeys(used) if kind not in above and kind != "object")
        yield from ["-", "object"]
        yield from (word for kind, parent in above.items() for word in (kind, "-", parent))


class _Signatures:
    """Keeps of each predicate and number the least types that fit all its uses; names are in lower case."""

    def __init__(self, objects: Mapping[str, str], above: Mapping[str, str], predicates: Mapping[str, _Kinds]) -> None:
        self._objects = {name.lower(): kind.lower() for name, kind in objects.items()}
        self._spelled = tuple(objects)
        self._above = {kind.lower(): parent.lower() for kind, parent in above.items()}
        self.predicates = dict(predicates)
        self.numbers: dict[str, _Kinds] = {}
        self.constants: set[str] = set()

    def read(self, node: Node, scope: _Scope, place: str) -> None:
        """Take in a condition or an effect whose variables have the types of the scope."""
        for atom, inner in _atoms(node, scope, place):
            if atom.head == "=":
                self._kinds(atom, inner, place)
            else:
                self.join(self.predicates, atom, inner, place)

    def join(self, known: dict[str, _Kinds], atom: Node, scope: _Scope, place: str) -> None:
        kinds = self._kinds(atom, scope, place)
        before = known.setdefault(atom.head, kinds)
        joined = self._joined(before, kinds)
        if joined is None:
            message = f"{atom} is about {_in_words(kinds)}, but elsewhere {atom.head!r} is about {_in_words(before)}"
            raise PddlError(f"{message}; declare a type above both in types={{...}}", place)
        known[atom.head] = joined

    def _kinds(self, atom: Node, scope: _Scope, place: str) -> _Kinds:
        kinds = []
        for argument in atom.children[1:]:
            is_variable = argument.lower.startswith("?")
            kind = (scope if is_variable else self._objects).get(argument.lower)
            if kind is None:
                what, names = ("parameter", tuple(scope)) if is_variable else ("object", self._spelled)
                raise PddlError(f"{atom}: unknown {what} {str(argument)!r}; {nearest(str(argument), names)}", place)
            if not is_variable:
                self.constants.add(argument.lower)
            kinds.append(kind)
        return tuple(kinds)

    def _joined(self, one: _Kinds, other: _Kinds) -> _Kinds | None:
        joined = tuple(filter(None, map(self._least, one, other)))
        return joined if len(joined) == len(one) == len(other) else None

    def _least(self, one: str, other: str) -> str | None:
        if "object" in (one, other):
            return "object"
        others = self._lineage(other)
        return next((kind for kind in self._lineage(one) if kind in others), None)

    def _lineage(self, kind: str) -> list[str]:
        lineage = [kind]
        while (kind := self._above.get(kind, kind)) not in lineage:
            lineage.append(kind)
        return lineage


def _atoms(node: Node, scope: _Scope, place: str) -> Iterator[tuple[Node, _Scope]]:
    """Yield each atom of a formula with the types of the variables there; refuse what is declared elsewhere."""
    head, rest = node.head, node.children[1:]
    if not node.is_list:
        raise PddlError(f"found {node.word!r}, expected a list such as '({node.word})'", place)
    if len(rest) == 2 and rest[1].is_list and (head, rest[0].lower) in _TIMED:
        raise PddlError(f"found {node}; say only {rest[1]}, where it belongs (start, over_all, end)", place)
    if head in _NUMERIC:
        raise PddlError(f"found {node}, which computes with numbers; state a cost as cost=...", place)
    if head in _CONNECTIVES:
        for child in rest:
            yield from _atoms(child, scope, place)
    elif head in ("forall", "exists"):
        if len(rest) != 2 or not rest[0].is_list:
            raise PddlError(f"found {node}, expected '({head} (?x - type) (...))'", place)
        yield from _atoms(rest[1], {**scope, **_typed(rest[0], place)}, place)
    elif head:
        yield node, scope


def _parsed(text: str, place: str) -> Node:
    """Return a formula, which stands at no line of a file."""
    if not text.strip().startswith("("):
        raise PddlError(f"found {text!r}, expected a formula such as '({text.strip() or 'lit ?room'})'", place)
    return formula(text, f"{place}, in {text!r}")


def _typed(node: Node, place: str) -> _Scope:
    found = typed(Source(place, node), node.children, are_variables=True)
    missing = next((name for name, kind in found if kind is None), None)
    if missing is not None:
        raise PddlError(f"found the parameter {missing}, expected one with its type such as '?x - place'", place)
    return {name.lower: kind.lower for name, kind in found if kind is not None}


def _in_words(kinds: _Kinds) -> str:
    return f"({' '.join(kinds)})" if kinds else "nothing"


def _of(schema: ActionSchema) -> str:
    return f"schema {schema.name}"


def _check(schema: ActionSchema) -> None:
    place = _of(schema)
    for key in ("parameters", "start", "over_all", "end", "start_effects", "end_effects", "makes_feasible"):
        if isinstance(getattr(schema, key), str):
            raise PddlError(f"{key} is one text, expected several; write ({getattr(schema, key)!r},)", place)
    for name in _parameters(schema):
        if name in _reserved(schema):
            raise PddlError(f"the parameter {name} is taken: it stands for a ROSA action; choose another name", place)
    amounts = {f"uses[{name!r}]": value for name, value in schema.uses.items()}
    for key, value in {"duration_s": schema.duration_s, "cost": schema.cost, **amounts}.items():
        if isinstance(value, int | float) and not 0.0 <= value < float("inf"):
            raise PddlError(f"{key} is {value:g}, expected a number that is not negative", place)
    if schema.duration_s is None and (schema.over_all or schema.end or schema.start_effects):
        message = "over_all, end and start_effects are for an action that takes time; state duration_s"
        raise PddlError(message, place)


def _reserved(schema: ActionSchema) -> list[str]:
    own = ["?a"] if schema.rosa_action is not None else []
    return own + [f"?a{number}" for number in range(1, len(schema.makes_feasible) + 1)]


def _parameters(schema: ActionSchema) -> _Scope:
    return {
        name: kind
        for text in schema.parameters
        for name, kind in _typed(_parsed(f"({text})", _of(schema)), _of(schema)).items()
    }


def _scope(schema: ActionSchema) -> _Scope:
    """Return the types of the parameters, those for ROSA actions first."""
    return {**dict.fromkeys(_reserved(schema), ACTION_TYPE), **_parameters(schema)}


def _signature(name: str, kinds: Iterable[str]) -> Node:
    return listed(name, *(word for number, kind in enumerate(kinds, 1) for word in (f"?x{number}", "-", kind)))


def _action(schema: ActionSchema, has_costs: bool) -> Node:
    def formulas(*texts: str) -> list[Node]:
        return [_parsed(text, _of(schema)) for text in texts]

    own = formulas(f"({schema.rosa_action}_action ?a)", f"({FEASIBLE} ?a)") if schema.rosa_action is not None else []
    start, effects = formulas(*schema.start), formulas(*schema.end_effects)
    for number, action in enumerate(schema.makes_feasible, start=1):
        start += formulas(f"({action}_action ?a{number})")
        effects += formulas(f"({FEASIBLE} ?a{number})")
    amounts = {**({"total-cost": schema.cost or 0} if has_costs else {}), **schema.uses}
    effects += [listed("increase", listed(name), _number(amount)) for name, amount in amounts.items()]
    parameters = listed(*(word for name, kind in _scope(schema).items() for word in (name, "-", kind)))
    if schema.duration_s is None:
        parts = (":precondition", listed("and", *own, *start), ":effect", listed("and", *effects))
        return listed(":action", schema.name, ":parameters", parameters, *parts)
    over_all, end = (*own, *formulas(*schema.over_all)), formulas(*schema.end)
    conditions = (*_at("at start", start), *_at("over all", over_all), *_at("at end", end))
    changes = (*_at("at start", formulas(*schema.start_effects)), *_at("at end", effects))
    duration = listed("=", "?duration", _number(schema.duration_s))
    parts = (":condition", listed("and", *conditions), ":effect", listed("and", *changes))
    return listed(":durative-action", schema.name, ":parameters", parameters, ":duration", duration, *parts)


def _in_lines(node: Node, before: str = " ") -> list[str]:
    return [f"{before}({node.head}", *(f"    {one}" for one in node.children[1:]), "  )"]


def _at(when: str, formulas: Iterable[Node]) -> list[Node]:
    return [listed(*when.split(), formula) for formula in formulas]


def _number(value: float | str) -> Node | str:
    if isinstance(value, str):
        return _parsed(value, value)
    short = f"{value:.12g}"
    return short if float(short) == value else format(Decimal(str(value)), "f")
