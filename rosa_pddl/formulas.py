"""Conditions written as text, such as `(and (lit hall) (not (broken hall)))`, in the words of a domain."""

from collections.abc import Mapping
from dataclasses import dataclass

from rosa_pddl.domain import Domain, UpThing
from rosa_pddl.exceptions import PddlError, UnknownNameError, UnsupportedPddlError, nearest
from rosa_pddl.reading.syntax import Node, parse

__all__ = ["Condition", "conditions"]

_NUMERIC = ("<", ">", "<=", ">=", "+", "-", "*", "/")


@dataclass(frozen=True)
class Condition:
    """A condition that is no conjunction.

    Args:
        text: as the files spell it, with single spaces.
        expression: the same as unified-planning's expression.
    """

    text: str
    expression: UpThing

    def __str__(self) -> str:
        return self.text


def conditions(domain: Domain, text: str) -> tuple[Condition, ...]:
    """Read a condition; a conjunction gives its parts.

    Raises:
        PddlError: the text is no PDDL.
        UnknownNameError: it mentions what the domain does not have.
        UnsupportedPddlError: it computes with numbers.
    """
    where = f"condition {text.strip()!r}"
    root = parse(text, where, "(predicate object)").root
    return tuple(Condition(*_Reader(domain, where).read(node, {})) for node in _conjuncts(root))


def _conjuncts(node: Node) -> tuple[Node, ...]:
    if node.head != "and":
        return (node,)
    return tuple(part for child in node.children[1:] for part in _conjuncts(child))


class _Reader:
    def __init__(self, domain: Domain, where: str) -> None:
        self._domain, self._where = domain, where
        self._manager = domain.up_problem.environment.expression_manager

    def read(self, node: Node, scope: Mapping[str, UpThing]) -> tuple[str, UpThing]:
        head, rest = node.head, node.children[1:]
        if not head:
            raise PddlError(f"found {node}, expected a list such as '(predicate object)'", self._where)
        if head in _NUMERIC:
            raise UnsupportedPddlError(f"{node} computes with numbers; a goal is about what is true", self._where)
        if head in ("forall", "exists"):
            return self._quantified(node, scope)
        if head == "=":
            return self._equality(node, scope)
        makers = {"and": self._manager.And, "or": self._manager.Or}
        if head in makers:
            parts = [self.read(child, scope) for child in rest]
            return _written(head, [text for text, _ in parts]), makers[head]([made for _, made in parts])
        fixed = {"not": (self._manager.Not, 1), "imply": (self._manager.Implies, 2)}
        if head in fixed:
            make, count = fixed[head]
            self._expect(node, count)
            parts = [self.read(child, scope) for child in rest]
            return _written(head, [text for text, _ in parts]), make(*[made for _, made in parts])
        return self._atom(node, scope)

    def _expect(self, node: Node, count: int) -> None:
        if len(node.children) != count + 1:
            given = len(node.children) - 1
            raise PddlError(f"found {given} parts in {node}, expected {count}", self._where)

    def _quantified(self, node: Node, scope: Mapping[str, UpThing]) -> tuple[str, UpThing]:
        self._expect(node, 2)
        declared, body = node.children[1:]
        inner, waiting = dict(scope), []
        words = [child.lower for child in declared.children]
        while words:
            word = words.pop(0)
            if word != "-":
                waiting.append(word)
                continue
            type_ = self._type(words.pop(0) if words else "", node)
            inner |= {name: self._variable(name, type_) for name in waiting}
            waiting = []
        inner |= {name: self._variable(name, self._type("object", node)) for name in waiting}
        text, made = self.read(body, inner)
        make = self._manager.Forall if node.head == "forall" else self._manager.Exists
        variables = [inner[word] for word in dict.fromkeys(child.lower for child in declared.children) if word in inner]
        return f"({node.head} {declared} {text})", make(made, *variables)

    def _variable(self, name: str, type_: UpThing) -> UpThing:
        from unified_planning.model import Variable

        return Variable(name.removeprefix("?"), type_, self._domain.up_problem.environment)

    def _type(self, word: str, node: Node) -> UpThing:
        types = {self._domain.outside[type_.name].lower(): type_ for type_ in self._domain.up_problem.user_types}
        if word not in types:
            raise UnknownNameError(f"{self._domain.file} has no type {word!r} (in {node}); {nearest(word, types)}")
        return types[word]

    def _equality(self, node: Node, scope: Mapping[str, UpThing]) -> tuple[str, UpThing]:
        self._expect(node, 2)
        parts = [self._term(child, scope, node) for child in node.children[1:]]
        return _written("=", [text for text, _ in parts]), self._manager.Equals(*[made for _, made in parts])

    def _atom(self, node: Node, scope: Mapping[str, UpThing]) -> tuple[str, UpThing]:
        if not scope:
            text = self._domain.atom(str(node))
            return text, self._domain.expression(text)
        from unified_planning.exceptions import UPException

        predicate = self._domain.spelling("predicate", node.head, str(node))
        parts = [self._term(child, scope, node) for child in node.children[1:]]
        fluent = self._domain.up_problem.fluent(self._domain.inside["predicate", node.head])
        try:
            made = fluent(*[made for _, made in parts])
        except (UPException, AssertionError) as error:
            wanted = " ".join(self._domain.outside[parameter.type.name] for parameter in fluent.signature)
            raise UnknownNameError(f"{node} does not fit, expected ({predicate} {wanted})") from error
        return _written(predicate, [text for text, _ in parts]), made

    def _term(self, node: Node, scope: Mapping[str, UpThing], within: Node) -> tuple[str, UpThing]:
        if node.is_list:
            raise UnsupportedPddlError(f"{node} in {within} is no object; a goal is about what is true", self._where)
        if node.lower in scope:
            return node.lower, self._manager.VariableExp(scope[node.lower])
        if node.lower.startswith("?"):
            raise UnknownNameError(f"{within} mentions {node} without (forall ...); {nearest(node.lower, scope)}")
        name = self._domain.spelling("object", node.lower, str(within))
        return name, self._manager.ObjectExp(self._domain.up_problem.object(self._domain.inside["object", node.lower]))


def _written(head: str, parts: list[str]) -> str:
    return "(" + " ".join([head, *parts]) + ")"
