"""Formulas and numbers written as PDDL, such as `(and (lit hall) (not (broken hall)))`, in the names of a domain."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from rosa_pddl.domain import Derived, Domain, UpThing, conjuncts
from rosa_pddl.exceptions import PddlError, UnknownNameError, nearest
from rosa_pddl.syntax import ANY, Node, Source, nodes_of, parse, start_of, typed
from rosa_pddl.validate import text_of

COMPARISONS: Final = ("<", ">", "<=", ">=")
CHANGES: Final = ("assign", "increase", "decrease", "scale-up", "scale-down")
_CONNECTIVES = ("and", "or", "not", "imply", "when", "forall", "exists")

Scope = Mapping[str, UpThing]
"""Variables, such as `?x`, and what they are as unified-planning's expressions."""


@dataclass(frozen=True)
class Goal:
    """A condition that is no conjunction, such as one thing that shall hold in the end.

    Args:
        text: the condition as PDDL, as the files spell it.
        expression: the same as unified-planning's expression.
        worth: how much a plan may cost more for it; None if it must be reached.
    """

    text: str
    expression: UpThing
    worth: float | None = None

    @property
    def is_soft(self) -> bool:
        """Whether it may be given up when it costs more than it is worth."""
        return self.worth is not None

    def __str__(self) -> str:
        return self.text if self.worth is None else f"{self.text} worth {self.worth:g}"


def conditions(domain: Domain, text: str, worth: float | None = None) -> tuple[Goal, ...]:
    """Read a condition; a conjunction gives its parts."""
    where = f"condition {text.strip()!r}"
    source = parse(text, where, "(predicate object)")
    if not source.root.children:
        raise PddlError("found (), expected a list such as '(predicate object)'", where)
    formulas = Formulas(domain, source, lambda _, message: UnknownNameError(f"{where}: {message}"))
    parts = conjuncts([formulas.condition(source.root, {}, "a goal")])
    return tuple(Goal(text_of(domain, part, {}), part, worth) for part in parts)


class Formulas:
    """Makes unified-planning's expressions of formulas."""

    def __init__(self, domain: Domain, source: Source, unknown: Callable[[Node, str], Exception] | None = None) -> None:
        self._domain, self.source, self._unknown = domain, source, unknown or source.error
        self._problem = domain.up_problem
        self.manager = domain.up_problem.environment.expression_manager

    def condition(self, node: Node, scope: Scope, place: str) -> UpThing:
        head, rest = node.head, node.children[1:]
        if node.is_list and not node.children:
            return self.manager.TRUE()
        if head in COMPARISONS or (head == "=" and any(part.is_list for part in rest)):
            return self._comparison(node, scope, place)
        if head == "preference":
            message = f"found {start_of(node)!r}: no installed engine takes preferences; LPG (up-lpg) by itself would "
            message += "do. Leave it out and add it as a soft goal: goals.add(TEXT, worth=COST)"
            raise self.source.unsupported(node, message)
        if head in ("forall", "exists"):
            inner, within, body = self.quantified(node)
            if not inner:
                raise self.source.error(node, f"found {start_of(node)!r}, expected a variable such as '?x' in it")
            variables = [variable.variable() for variable in inner.values()]
            held = self.condition(body, {**scope, **inner}, place)
            if not within.is_true():
                held = (self.manager.Implies if head == "forall" else self.manager.And)(within, held)
            return (self.manager.Forall if head == "forall" else self.manager.Exists)(held, *variables)
        if head == "=":
            self._expect(node, 2)
            return self.manager.Equals(*(self._term(part, scope) for part in rest))
        if head in ("and", "or", "not", "imply"):
            parts = [self.condition(part, scope, place) for part in rest]
            if head in ("and", "or"):
                return (self.manager.And if head == "and" else self.manager.Or)(parts)
            self._expect(node, 1 if head == "not" else 2)
            return (self.manager.Not if head == "not" else self.manager.Implies)(*parts)
        return self.atom(node, scope, is_condition=True)

    def derived(self, rules: Sequence[Node], layer: int) -> Derived:
        """Return what a derived predicate stands for, by all of its rules."""
        variables, conditions = tuple[UpThing, ...](), list[UpThing]()
        for _, target, body in [rule.children for rule in rules]:
            scope = self._variables(target.children[1:])
            kinds = [one.variable().type for one in scope.values()]
            # numbers, as a variable of one rule may be called as one in the condition of another
            variables = variables or tuple(self._variable(str(number), kind) for number, kind in enumerate(kinds))
            if [one.type for one in variables] != kinds:
                raise self.source.error(target, f"found {start_of(target)!r}, expected the types of the rule before")
            renamed = dict(zip(scope, variables, strict=True))
            within = self.within(target.children[1:], renamed)
            place = f"what {target.head} is derived from"
            conditions.append(self.manager.And(within, self.condition(body, renamed, place)))
        return Derived(variables, self.manager.Or(conditions), layer)

    def quantified(self, node: Node) -> tuple[Scope, UpThing, Node]:
        """Return the variables, the condition that keeps them within their types, and what is said of them."""
        if len(node.children) != 3 or not node.children[1].is_list:
            raise self.source.error(node, f"found {start_of(node)!r}, expected '({node.head} (?x - type) (...))'")
        names = node.children[1].children
        scope = self._variables(names)
        return scope, self.within(names, scope), node.children[2]

    def within(self, names: Sequence[Node], scope: Scope) -> UpThing:
        """Return the condition that keeps variables of type `(either ...)` to that; just true for all others."""
        manager, parts = self.manager, list[UpThing]()
        for name, kind in typed(self.source, names, are_variables=True):
            if kind is not None and kind.head == "either":
                ways = [self._variable("either.", self.type_of(part)) for part in kind.children[1:]]
                same = [manager.Exists(manager.Equals(scope[name.lower], one), one.variable()) for one in ways]
                parts.append(manager.Or(same))
        return manager.And(parts)

    def _variables(self, names: Sequence[Node]) -> Scope:
        pairs = typed(self.source, names, are_variables=True)
        return {name.lower: self._variable(name.lower[1:], self.type_of(kind or ANY)) for name, kind in pairs}

    def _variable(self, name: str, kind: UpThing) -> UpThing:
        from unified_planning.model import Variable

        return self.manager.VariableExp(Variable(name, kind, self._problem.environment))

    def type_of(self, node: Node) -> UpThing:
        """Return a type; of several, as in `(either a b)`, the least one above them."""
        if node.is_list:
            first, *others = [self.type_of(part) for part in node.children[1:]]
            above = (kind for kind in first.ancestors if all(kind in other.ancestors for other in others))
            return next(above, None) or self.type_of(ANY)
        name = self._domain.inside.get(("type", node.lower), node.lower)
        kinds = {kind.name: kind for kind in self._problem.user_types}
        if name not in kinds:
            raise self._unknown_name("type", node, ())
        return kinds[name]

    def atom(self, node: Node, scope: Scope, *, is_condition: bool = False, is_number: bool = False) -> UpThing:
        if not node.head:
            raise self.source.error(node, f"found {start_of(node)!r}, expected a list such as '(predicate object)'")
        inside = self._domain.inside.get(("predicate", node.head))
        if node.head in self._domain.axioms and not is_condition:
            message = f"found {start_of(node)!r}, which is derived: it is neither stated nor changed"
            raise self.source.error(node, message)
        if inside is None:
            raise self._unknown_name("predicate", node.children[0], (*_CONNECTIVES, *CHANGES))
        fluent = self._problem.fluent(inside)
        if fluent.type.is_bool_type() is is_number:
            found, hint = ("predicate", "number") if is_number else ("number", "predicate; compare it, as in (> (x) 0)")
            raise self.source.error(node, f"found {start_of(node)!r}, which is a {found}, expected a {hint}")
        arguments = [self._term(part, scope) for part in node.children[1:]]
        name, signature = self._domain.outside[inside], fluent.signature
        if len(arguments) != len(signature):
            file, line = self._domain.places.get(("predicate", name), (self._domain.file, None))
            message = f"found {len(arguments)} arguments of {str(node.children[0])!r}, expected {len(signature)}"
            place = f" as declared in line {line} of {file}" if line else ""
            raise self._unknown(node.children[0], message + place)
        if not all(one.type.is_compatible(given.type) for one, given in zip(signature, arguments, strict=True)):
            typed_as = (f"?{one.name} - {self._domain.outside[one.type.name]}" for one in signature)
            message = f"the arguments of {name!r} are of other types than declared: ({' '.join([name, *typed_as])})"
            raise self._unknown(node, message)
        return fluent(*arguments)

    def _comparison(self, node: Node, scope: Scope, place: str) -> UpThing:
        self._expect(node, 2)
        known = self._domain.computed
        heads = {one.head for one in nodes_of(node)}
        if "total-cost" in heads:
            raise self.numeric(node, place, "compares (total-cost), which is for the metric; add a number of its own")
        for name in sorted(heads.intersection(one.lower() for one in self._domain.numeric - known)):
            others = f"; compared are {', '.join(sorted(known))}" if known else ""
            raise self.numeric(node, place, f"compares {name}, which no condition of the files does{others}")
        manager, (one, other) = self.manager, (self.number(part, scope) for part in node.children[1:])
        kinds = {"<": manager.LT, "<=": manager.LE, ">": manager.GT, ">=": manager.GE, "=": manager.Equals}
        return kinds[node.head](one, other)

    def number(self, node: Node, scope: Scope) -> UpThing:
        manager = self.manager
        operators = {"+": manager.Plus, "-": manager.Minus, "*": manager.Times, "/": manager.Div}
        if node.head in operators:
            parts = [self.number(part, scope) for part in node.children[1:]]
            if node.head == "-" and len(parts) == 1:
                return manager.Times(-1, *parts)
            if node.head in ("-", "/"):
                self._expect(node, 2)
            try:
                return operators[node.head](*parts)
            except (ZeroDivisionError, OverflowError):
                raise self._no_number(node) from None
        return self.atom(node, scope, is_number=True) if node.is_list else self.constant(node)

    def constant(self, node: Node) -> UpThing:
        try:
            value = Fraction(node.lower)
            float(value)
        except (ValueError, OverflowError, ZeroDivisionError):
            raise self._no_number(node) from None
        return self.manager.Int(value.numerator) if value.denominator == 1 else self.manager.Real(value)

    def _no_number(self, node: Node) -> PddlError:
        return self.source.error(node, f"found {start_of(node)!r}, expected a number of at most 1e308")

    def numeric(self, node: Node, place: str, why: str) -> PddlError:
        return self.source.unsupported(node, f"{start_of(node)!r} in {place} {why}")

    def _term(self, node: Node, scope: Scope) -> UpThing:
        if node.is_list:
            raise self.source.unsupported(node, f"{start_of(node)} is no object; a formula is about what is true")
        if node.lower.startswith("?"):
            if node.lower not in scope:
                message = f"found the variable {node.word!r}, expected a parameter; {nearest(node.lower, scope)}"
                raise self._unknown(node, message)
            return scope[node.lower]
        inside = self._domain.inside.get(("object", node.lower))
        if inside is None:
            raise self._unknown_name("object", node, ())
        return self.manager.ObjectExp(self._problem.object(inside))

    def _expect(self, node: Node, count: int) -> None:
        if len(node.children) != count + 1:
            raise self.source.error(node, f"found {len(node.children) - 1} parts in {start_of(node)}, expected {count}")

    def _unknown_name(self, kind: str, node: Node, others: tuple[str, ...]) -> Exception:
        known = [self._domain.outside[inside] for (other, _), inside in self._domain.inside.items() if other == kind]
        message = f"found the unknown {kind} {node.word!r}, expected a declared one; "
        return self._unknown(node, message + nearest(node.lower, [*known, *others]))
