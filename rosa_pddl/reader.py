"""Reads PDDL into unified-planning's model; errors name the place of what cannot be read or planned for."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

from rosa_pddl.domain import (
    ACTION_TYPE,
    FEASIBLE,
    Derived,
    Domain,
    Schema,
    UpThing,
    conjuncts,
    lineage_of,
)
from rosa_pddl.engines import late_environment
from rosa_pddl.exceptions import PddlError, UnknownNameError, nearest
from rosa_pddl.problem import Problem
from rosa_pddl.resource_usage import NumberUses
from rosa_pddl.syntax import (
    ANY,
    BODY,
    CHANGES,
    COMPARISONS,
    NAME,
    NUMBER,
    Formulas,
    Node,
    Scope,
    Source,
    body_of,
    check_frames,
    glued_types,
    listed,
    nodes_of,
    parse,
    read_source,
    section,
    start_of,
    typed,
)

_TIMES = {("at", "start"): "start", ("at", "end"): "end", ("over", "all"): "over_all"}
_COST = "total-cost"


def load_domain(
    domain: str | Path, problem: str | Path, *, actions: Mapping[str, str] | None = None
) -> Domain:
    """Read a PDDL domain and problem.

    Names keep the spelling of the files; an object, an action, a predicate and a type may have the same name. If the
    files do not say which ROSA action a PDDL action does, see docs/pddl.md, `actions` says it: an action in it gets the
    condition `(over all (action_feasible ...))` if it lacks that.

    Args:
        domain: path of the domain file.
        problem: path of the problem file.
        actions: for each PDDL action, the ROSA action that it does: its name, or the parameter for it, such as `?a`.

    Raises:
        PddlError: a file cannot be read or is not correct PDDL; the message gives the place.
        UnknownNameError: `actions` names a PDDL action or a parameter that is not in the files.
        UnsupportedPddlError: correct PDDL that cannot be planned or executed here.
    """
    return build_domain(read_source(domain), read_source(problem), actions or {})


def parse_domain(domain: str, problem: str, *, actions: Mapping[str, str] | None = None) -> Domain:
    """Read a PDDL domain and problem from texts, as `load_domain` does from files."""
    return build_domain(parse(domain, "domain.pddl"), parse(problem, "problem.pddl"), actions or {})


def build_domain(
    domain: Source, problem: Source, actions: Mapping[str, str] | None = None
) -> Domain:
    check_frames(domain, problem)
    read = _Reader(domain, problem, actions or {}).domain()
    # raises errors of what cannot be planned here, not at the first planning
    Problem(read, frozenset()).build()
    return read


def _rosa_action_of(
    name: str,
    conditions: Iterable[UpThing],
    parameters: Mapping[str, UpThing],
    outside: Mapping[str, str],
) -> str | None:
    """Return the parameter (without `?`) or the constant that is the ROSA action; None if there is none."""
    said = {
        outside[one.fluent().name].lower(): one
        for one in conditions
        if one.is_fluent_exp() and len(one.args) == 1
    }
    for predicate in (f"{name.lower()}_action", FEASIBLE):
        if predicate in said:
            argument = said[predicate].arg(0)
            return (
                str(argument.parameter().name)
                if argument.is_parameter_exp()
                else outside[argument.object().name]
            )
    actions = [one for one, kind in parameters.items() if outside[kind.name].lower() == ACTION_TYPE]
    return actions[0] if len(actions) == 1 else None


class _Reader:
    """Builds unified-planning's problem, with unique names, as unified-planning requires."""

    def __init__(self, domain: Source, problem: Source, actions: Mapping[str, str]) -> None:
        from unified_planning.model import Problem as UpProblem

        environment = late_environment()
        self._types = environment.type_manager
        defaults = {self._types.BoolType(): environment.expression_manager.FALSE()}
        self._up_problem = UpProblem(
            str(problem.root.children[1].children[1]), environment, initial_defaults=defaults
        )
        self._actions = actions
        self._inside = {("type", "object"): "object"}
        self._outside = {"object": "object"}
        self._places: dict[tuple[str, str], tuple[str, int]] = {}
        self._lineages: dict[str, tuple[str, ...]] = {}
        self._schemas: dict[str, Schema] = {}
        self._costs: dict[str, UpThing] = {}
        self._draft = Domain(
            computed=frozenset(
                str(one.children[0]) for one in section(domain, ":functions") if one.head
            ),
            name=str(domain.root.children[1].children[1]),
            file=domain.file,
            problem_file=problem.file,
            up_problem=self._up_problem,
            schema_of=self._schemas,
            outside=self._outside,
            inside=self._inside,
            places=self._places,
            types=self._lineages,
        )
        self._domain, self._problem = Formulas(self._draft, domain), Formulas(self._draft, problem)
        self._has_cost = any(node.head == _COST for node in section(domain, ":functions"))

    def domain(self) -> Domain:
        domain, problem = self._domain.source, self._problem.source
        self._read_types(domain)
        rules = _rules(domain)
        made_of = _closures(rules)
        undeclared = {head: each[0].children[1] for head, each in rules.items()}
        for node in _signatures(domain, ":predicates"):
            undeclared.pop(node.head, None)
            self._read_fluent(node, self._types.BoolType())
        for node in undeclared.values():
            self._read_fluent(node, self._types.BoolType())
        if self._actions and ("predicate", FEASIBLE) not in self._inside:
            self._read_fluent(listed(FEASIBLE, "?a", "-", ACTION_TYPE), self._types.BoolType())
        for node in _signatures(domain, ":functions"):
            if node.head != _COST:
                self._read_fluent(node, self._types.RealType())
        self._read_objects(self._domain, ":constants")
        self._read_objects(self._problem, ":objects")
        self._read_rosa_actions()
        for head in rules:  # a rule may use a predicate that is derived later
            self._draft.axioms[head] = Derived((), None, len(made_of[head]))
        for head, each in rules.items():
            self._draft.axioms[head] = self._domain.derived(each, len(made_of[head]))
            for part in (
                part for rule in each for part in nodes_of(rule) if part.head in ("not", "imply")
            ):
                if any(made_of[head] == made_of.get(one.head) for one in nodes_of(part)):
                    message = f"{head!r} is derived from its own negation, which means nothing. Sense it, or make it"
                    raise domain.unsupported(part, f"{message} an effect of actions")
        for node in domain.root.children[2:]:
            if node.head in BODY:
                with _located(
                    domain, node, f"in {start_of(node.children[1])}: " if node.children[1:] else ""
                ):
                    self._read_action(node)
        for fact in (part for node in section(problem, ":init") for part in _parts_of(node)):
            with _located(problem, fact):
                self._read_fact(fact)
        goals = list[tuple[str, UpThing]]()
        for goal in (part for node in section(problem, ":goal") for part in _parts_of(node)):
            with _located(problem, goal):
                goals.append((str(goal), self._problem.condition(goal, {}, "the goal")))
        uses = self._sort_numbers([goal for _, goal in goals])
        metric = self._read_metric(
            {self._outside[one.name].lower(): rises for one, rises in uses.rises.items()}
        )
        return replace(
            self._draft,
            rosa_actions=tuple(
                name for name, lineage in self._lineages.items() if ACTION_TYPE in lineage
            ),
            goals=tuple(text for text, goal in goals if goal not in uses.limits),
            computed=frozenset(self._outside[one.name] for one in uses.computed),
            metric=metric,
            oversights=tuple(note for one in (domain, problem) for note in glued_types(one)),
            limits=tuple(uses.limits),
        )

    def _declare(self, source: Source, kind: str, node: Node) -> str:
        """Register a name of the files, and return its unique name in the model."""
        if not NAME.fullmatch(str(node)):
            message = f"found the {kind} {str(node)!r}, expected a name: a letter, then letters, digits, '_' or '-'"
            raise source.error(node, message)
        if (kind, node.lower) in self._inside:
            file, line = self._places[kind, self._outside[self._inside[kind, node.lower]]]
            where = f", in line {line} of {file}" if line else ""
            raise source.error(node, f"the {kind} {node.word!r} was declared before{where}")
        name = node.lower
        while name in self._outside:
            name += f"_{'schema' if kind == 'action' else kind}"
        self._inside[kind, node.lower], self._outside[name] = name, str(node)
        self._places[kind, str(node)] = (source.file, node.line)
        return name

    def _read_types(self, source: Source) -> None:
        pairs = typed(source, section(source, ":types"))
        if self._actions and ACTION_TYPE not in [name.lower for name, _ in pairs]:
            pairs.append((replace(ANY, word=ACTION_TYPE), None))
        names = {up.lower: up for _, up in pairs if up is not None} | {
            name.lower: name for name, _ in pairs
        }
        above = {
            name.lower: up.lower for name, up in pairs if up is not None and up.lower != name.lower
        }
        below = {word: (above.get(word, "object"),) for word in names if word != "object"}
        try:
            in_order = tuple(TopologicalSorter(below).static_order())
        except CycleError as error:
            cycle = error.args[1]
            message = f"the types {', '.join(sorted({*cycle}))} are above one another, expected one on top"
            raise source.error(names[cycle[0]], message) from error
        kinds = {"object": self._types.UserType("object")}
        for word in (one for one in in_order if one != "object"):
            kinds[word] = self._types.UserType(
                self._declare(source, "type", names[word]), kinds[below[word][0]]
            )
        self._up_problem.user_types.extend(kinds.values())

    def _variables(self, nodes: Iterable[Node]) -> dict[str, UpThing]:
        """Return the types of variables by their names without `?`."""
        found: dict[str, UpThing] = {}
        for name, kind in typed(self._domain.source, nodes, are_variables=True):
            if name.lower[1:] in found:
                raise self._domain.source.error(
                    name, f"found the parameter {name.word!r} again, expected another name"
                )
            found[name.lower[1:]] = self._domain.type_of(kind or ANY)
        return found

    def _read_fluent(self, node: Node, type_: UpThing) -> None:
        from unified_planning.model import Fluent

        parameters = self._variables(node.children[1:])
        name = self._declare(self._domain.source, "predicate", node.children[0])
        self._up_problem.add_fluent(
            Fluent(name, type_, environment=self._up_problem.environment, **parameters)
        )

    def _read_objects(self, formulas: Formulas, head: str) -> None:
        for node, kind in typed(formulas.source, section(formulas.source, head)):
            self._read_object(formulas, node, kind or ANY)

    def _read_object(self, formulas: Formulas, node: Node, kind: Node) -> None:
        type_, known = formulas.type_of(kind), self._inside.get(("object", node.lower))
        if known is not None and formulas is self._problem:
            is_constant = (
                self._places["object", self._outside[known]][0] == self._domain.source.file
            )
            if is_constant and self._up_problem.object(known).type == type_:
                return
        self._up_problem.add_object(self._declare(formulas.source, "object", node), type_)
        self._lineages[str(node)] = lineage_of(type_, self._outside)

    def _read_rosa_actions(self) -> None:
        """Apply `actions`, which says which ROSA actions PDDL actions do."""
        domain = self._domain.source
        actions = (node for node in domain.root.children[2:] if node.head in BODY)
        schemas = [str(node.children[1]) for node in actions if node.children[1:]]
        for name, action in self._actions.items():
            if name not in schemas:
                raise UnknownNameError(
                    f"{domain.file} has no PDDL action {name!r}; {nearest(name, schemas)}"
                )
            known = self._inside.get(("object", action.lower()))
            if not action.startswith("?") and known is None:
                self._read_object(
                    self._domain, replace(ANY, word=action), replace(ANY, word=ACTION_TYPE)
                )
            elif known is not None and ACTION_TYPE not in self._lineages[self._outside[known]]:
                raise UnknownNameError(
                    f"the object {action!r} of {domain.file} is not of type {ACTION_TYPE!r}"
                )

    def _read_action(self, node: Node) -> None:
        source, name = self._domain.source, str(node.children[1])
        parts = body_of(source, node)
        parameters = self._variables(
            parts[":parameters"].children if ":parameters" in parts else ()
        )
        self._declare(source, "action", node.children[1])
        reader = _ActionReader(self._domain, parameters, name, self._has_cost)
        reader.read(node, parts)
        if reader.cost is not None:
            self._costs[name] = reader.cost
        does = self._actions.get(name)
        if does is not None:
            if does.startswith("?") and does[1:] not in parameters:
                hint = nearest(does, [f"?{word}" for word in parameters])
                raise UnknownNameError(
                    f"the PDDL action {name!r} has no parameter {does!r}; {hint}"
                )
            conditions = [one for one in reader.conditions if one.is_fluent_exp()]
            if FEASIBLE not in [self._outside[one.fluent().name].lower() for one in conditions]:
                needed = listed(FEASIBLE, does)
                reader.require(
                    listed("over", "all", needed) if node.head == ":durative-action" else needed,
                    node,
                )
        action = (
            does.removeprefix("?")
            if does
            else _rosa_action_of(name, reader.conditions, parameters, self._outside)
        )
        self._schemas[name] = Schema(
            name=name,
            parameters=tuple((one, self._outside[kind.name]) for one, kind in parameters.items()),
            action=action,
            uses={},
            duration=reader.duration,
            **{when: tuple(found) for when, found in reader.parts.items()},
        )

    def _read_fact(self, node: Node) -> None:
        formulas, source = self._problem, self._problem.source
        if (
            node.head == "at"
            and len(node.children) == 3
            and NUMBER.fullmatch(node.children[1].lower)
        ):
            message = f"found {start_of(node)!r}: facts that become true at a time are not supported; Aries (up-aries) "
            raise source.unsupported(node, message + "by itself would do. Sense the fact instead")
        if node.head == "=" and len(node.children) == 3:
            _, target, value = node.children
            if target.head != _COST or not self._has_cost:
                fluent = formulas.atom(target, {}, is_number=True)
                self._up_problem.set_initial_value(fluent, formulas.constant(value))
        elif node.head == "not" and len(node.children) == 2:
            formulas.atom(node.children[1], {})
        else:
            self._up_problem.set_initial_value(formulas.atom(node, {}), True)

    def _sort_numbers(self, goals: Sequence[UpThing]) -> NumberUses:
        """Sort numbers by their uses; move resources and their limits out of the effects and goals."""
        derived = (one.condition for one in self._draft.axioms.values())
        uses = NumberUses(self._schemas.values(), self._costs.values(), derived, goals)
        for goal in goals:
            if goal not in uses.limits:
                self._up_problem.add_goal(goal)
        for name, schema in self._schemas.items():
            start, end = (
                tuple(one for one in effects if one.fluent.fluent() not in uses.resources)
                for effects in (schema.start_effects, schema.end_effects)
            )
            used = {
                self._outside[one.name]: uses.rises[one][name]
                for one in uses.resources
                if name in uses.rises[one]
            }
            self._schemas[name] = replace(schema, start_effects=start, end_effects=end, uses=used)
        return uses

    def _read_metric(self, rising: Mapping[str, Mapping[str, UpThing]]) -> str:
        for word in section(self._problem.source, ":metric")[1:]:
            node = (
                word if word.is_list else replace(word, word=None, children=(word,))
            )  # `minimize c` is `(c)`
            if node.head == "total-time":
                return "makespan"
            costs = dict[str, UpThing]()
            for name, amount in self._minimized(
                node, {**rising, **({_COST: self._costs} if self._has_cost else {})}
            ):
                costs[name] = costs[name] + amount if name in costs else amount
            for name, cost in costs.items():
                self._schemas[name] = replace(self._schemas[name], cost=cost)
            return "cost"
        return ""

    def _minimized(
        self, node: Node, rising: Mapping[str, Mapping[str, UpThing]]
    ) -> Iterator[tuple[str, UpThing]]:
        """Yield what each action adds to a metric, which is a sum of numbers that only rise, with constant factors."""
        head, parts = node.head, node.children[1:]
        constants = [part for part in parts if NUMBER.fullmatch(part.lower)]
        if head in rising:
            yield from rising[head].items()
        elif head == "+":
            for part in parts:
                yield from self._minimized(part, rising)
        elif head == "*" and len(parts) == 2 and len(constants) == 1:
            factor, other = self._problem.constant(constants[0]), parts[parts[0] is constants[0]]
            yield from (
                (action, factor * amount) for action, amount in self._minimized(other, rising)
            )
        else:
            names = ", ".join(sorted(f"({one})" for one in rising)) or "none"
            message = f"found {start_of(node)!r}, expected (total-cost), (total-time), or a sum of numbers that actions"
            message += f" only increase, by what none changes; here: {names}"
            raise self._problem.source.unsupported(node, message)


class _ActionReader:
    """Reads the conditions, effects, duration and cost of an action."""

    def __init__(
        self, formulas: Formulas, parameters: Mapping[str, UpThing], name: str, has_cost: bool
    ) -> None:
        from unified_planning.model import Parameter

        self._formulas, self._source, self._name, self._has_cost = (
            formulas,
            formulas.source,
            name,
            has_cost,
        )
        manager, environment = formulas.manager, formulas.manager.environment
        self._scope = {
            f"?{one}": manager.ParameterExp(Parameter(one, kind, environment))
            for one, kind in parameters.items()
        }
        self.parts: dict[str, list[UpThing]] = {
            one: [] for one in ("start", "over_all", "end", "start_effects", "end_effects")
        }
        self.duration: UpThing = None
        self.cost: UpThing = None

    @property
    def conditions(self) -> list[UpThing]:
        return [*self.parts["start"], *self.parts["over_all"], *self.parts["end"]]

    def read(self, schema: Node, parts: Mapping[str, Node]) -> None:
        if ":duration" in parts:
            self._read_duration(parts[":duration"])
        self.require(parts.get(":condition", parts.get(":precondition", listed())), schema)
        within = self._formulas.within(
            parts[":parameters"].children if ":parameters" in parts else (), self._scope
        )
        self.parts["start"] += conjuncts([within])
        for time, effect in _timed(
            self._source, schema, parts.get(":effect", listed()), is_effect=True
        ):
            self._read_effect(effect, _Where(time, self._scope))

    def require(self, node: Node, schema: Node) -> None:
        for time, condition in _timed(self._source, schema, node, is_effect=False):
            self.parts[time] += conjuncts(
                [self._formulas.condition(condition, self._scope, self._name)]
            )

    def _read_duration(self, node: Node) -> None:
        """Set the duration; for a bound on one side only, it is the bound."""
        from unified_planning.model import DurationInterval, FixedDuration

        if not node.children:
            self.duration = FixedDuration(self._formulas.manager.Int(1))
        elif _time_of(node) is not None or (node.head == "and" and len(node.children) == 2):
            self._read_duration(node.children[-1])
        elif node.head == "and":
            bounds = {part.head[:1]: part for part in node.children[1:] if len(part.children) == 3}
            if bounds.keys() != {"<", ">"} or len(node.children) != 3:
                raise self._source.error(
                    node, f"found {start_of(node)!r}, expected a least and a greatest duration"
                )
            lower, upper = bounds[">"], bounds["<"]
            least, most = (
                self._formulas.number(part.children[2], self._scope) for part in (lower, upper)
            )
            self.duration = DurationInterval(least, most, lower.head == ">", upper.head == "<")
        elif (
            node.head in ("=", *COMPARISONS)
            and len(node.children) == 3
            and node.children[1].lower == "?duration"
        ):
            self.duration = FixedDuration(
                self._formulas.number(node.children[2], self._scope).simplify()
            )
            if self.duration.lower.is_constant() and self.duration.lower.constant_value() < 0:
                raise self._source.error(
                    node, f"found {start_of(node)!r}, expected a duration of 0 s or more"
                )
        else:
            raise self._source.error(
                node, f"found {start_of(node)!r}, expected a duration such as '(= ?duration 5)'"
            )

    def _read_effect(self, node: Node, where: "_Where") -> None:
        formulas, head, parts = self._formulas, node.head, node.children[1:]
        if head == "and":
            for part in parts:
                self._read_effect(part, where)
        elif head == "forall":
            bound, within, body = formulas.quantified(node, where.scope)
            variables = (*where.variables, *(one.variable() for one in bound.values()))
            self._read_effect(
                body, where.on(within)._replace(scope={**where.scope, **bound}, variables=variables)
            )
        elif head == "when" and len(parts) == 2:
            needed = formulas.condition(parts[0], where.scope, self._name).simplify()
            if not needed.is_false():
                self._read_effect(parts[1], where.on(needed))
        elif head in CHANGES:
            self._read_change(node, where)
        elif node.children or not node.is_list:
            is_deleted = head == "not" and len(parts) == 1 and parts[0].is_list
            fluent = formulas.atom(parts[0] if is_deleted else node, where.scope)
            self._add(fluent, formulas.manager.Bool(not is_deleted), "ASSIGN", where)

    def _read_change(self, node: Node, where: "_Where") -> None:
        """Read the cost of an action, which may have several parts, or its effect on a number."""
        formulas, manager = self._formulas, self._formulas.manager
        if len(node.children) != 3 or not node.children[1].head:
            raise self._source.error(
                node, f"found {start_of(node)!r}, expected ({node.head} (NAME) AMOUNT)"
            )
        head, target, amount = node.head, *node.children[1:]
        is_cost = target.head == _COST and self._has_cost
        if is_cost and amount.lower.startswith("-"):
            message = (
                f"{start_of(node)!r} in {self._name} is less than nothing; costs are 0 or more"
            )
            raise self._source.unsupported(node, message)
        if is_cost and (head != "increase" or where.conditions or where.variables):
            message = "makes the cost of a step depend on conditions; write an action for each"
            raise formulas.numeric(node, self._name, message)
        value = formulas.number(amount, where.scope)
        if is_cost:
            self.cost = value if self.cost is None else manager.Plus(self.cost, value)
            return
        fluent = formulas.atom(target, where.scope, is_number=True)
        if head.startswith("scale"):
            head, value = (
                "assign",
                (manager.Times if head == "scale-up" else manager.Div)(fluent, value),
            )
        self._add(fluent, value, head.upper(), where)

    def _add(self, fluent: UpThing, value: UpThing, kind: str, where: "_Where") -> None:
        from unified_planning.model import Effect, EffectKind

        condition = self._formulas.manager.And(where.conditions)
        effect = Effect(fluent, value, condition, EffectKind[kind], where.variables)
        self.parts[f"{where.time}_effects"].append(effect)


class _Where(NamedTuple):
    """The context of an effect: the end of the action, the variables in scope, and the conditions."""

    time: str
    scope: Scope
    conditions: tuple[UpThing, ...] = ()
    variables: tuple[UpThing, ...] = ()

    def on(self, condition: UpThing) -> "_Where":
        return self._replace(conditions=(*self.conditions, *conjuncts([condition])))


def _parts_of(node: Node) -> Iterator[Node]:
    if node.head == "and":
        for part in node.children[1:]:
            yield from _parts_of(part)
    elif node.children or not node.is_list:
        yield node


def _rules(source: Source) -> Mapping[str, list[Node]]:
    """Return the rules of each derived predicate by its name; each rule is an atom and its condition."""
    found: dict[str, list[Node]] = {}
    for node in source.root.children[2:]:
        if node.head == ":derived":
            if len(node.children) != 3 or not node.children[1].head:
                raise source.error(
                    node,
                    f"found {start_of(node)!r}, expected '(:derived (NAME ?x - type) CONDITION)'",
                )
            found.setdefault(node.children[1].head, []).append(node)
    return found


def _closures(rules: Mapping[str, list[Node]]) -> dict[str, set[str]]:
    """Return for each derived predicate all derived predicates that it depends on, itself included."""
    found = {
        head: {
            head,
            *(
                part.head
                for rule in each
                for part in nodes_of(rule.children[2])
                if part.head in rules
            ),
        }
        for head, each in rules.items()
    }
    for _ in rules:
        for below in found.values():
            below.update(*(found[other] for other in below))
    return found


def _signatures(source: Source, head: str) -> Iterator[Node]:
    before = ""
    for node in section(source, head):
        expects_type, before = before == "-", str(node)
        if node.is_list:
            if not node.head:
                raise source.error(node, f"found {start_of(node)!r}, expected a name")
            yield node
        elif expects_type and node.lower != "number":
            message = f"found '- {node.word}': a function that is an object is not supported; Aries (up-aries) by "
            raise source.unsupported(
                node, message + "itself would do. Write a predicate with one more argument"
            )
        elif node.lower not in ("-", "number"):
            raise source.error(
                node, f"found {node.word!r}, expected a list such as '({node.word} ?x)'"
            )


@contextmanager
def _located(source: Source, node: Node, place: str = "") -> Iterator[None]:
    """Give errors of unified-planning the place of a node, and errors without a line the text `place`."""
    from unified_planning.exceptions import UPException

    try:
        yield
    except PddlError as error:
        raise error if error.line else type(error)(place + error.message, error.file) from error
    except (UPException, AssertionError) as error:
        text = " ".join(str(error).split()) or repr(error)
        raise source.error(node, f"unified-planning cannot take this: {text}") from error


def _time_of(node: Node) -> str | None:
    if len(node.children) != 3 or not node.children[2].is_list:
        return None
    return _TIMES.get((node.head, node.children[1].lower))


def _timed(
    source: Source, schema: Node, node: Node, *, is_effect: bool
) -> Iterator[tuple[str, Node]]:
    """Yield the conditions or effects of an action, each with its time, which durative actions state."""
    if schema.head == ":action":
        yield ("end" if is_effect else "start"), node
        return
    time = _time_of(node)
    if time is not None and not (is_effect and time == "over_all"):
        yield time, node.children[2]
    elif node.head == "and" or not node.children:
        for child in node.children[1:]:
            yield from _timed(source, schema, child, is_effect=is_effect)
    elif node.head == "forall" and len(node.children) == 3:
        for when, inner in _timed(source, schema, node.children[2], is_effect=is_effect):
            yield when, listed(*node.children[:2], inner)
    elif node.head == "when" and is_effect and len(node.children) == 3:
        condition, effect = node.children[1:]
        at = _time_of(effect)
        if at is None or at != _time_of(condition):
            message = f"found {start_of(node)!r}: an effect at one time that depends on another is not supported by "
            message += "any engine of unified-planning. Write (when (at end ...) (at end ...)), or two actions"
            raise source.unsupported(node, message)
        yield at, listed(node.children[0], condition.children[2], effect.children[2])
    else:
        expected = " or ".join(
            f"'({' '.join(time)} ...)'" for time in _TIMES if not is_effect or time[0] == "at"
        )
        message = f"found {start_of(node)!r} in (:durative-action {schema.children[1]}, expected {expected} around it"
        raise source.error(node, message)
