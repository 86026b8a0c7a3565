"""What predicates are about, found from how formulas use them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from rosa_pddl.exceptions import PddlError, nearest
from rosa_pddl.reading.syntax import Node, parse

__all__ = ["Signatures", "Uses", "parsed", "typed_names"]

_CONNECTIVES: Final = frozenset({"and", "or", "not", "imply", "when"})
_QUANTIFIERS: Final = frozenset({"forall", "exists"})
_NUMERIC: Final = frozenset({"<", ">", "<=", ">=", "assign", "increase", "decrease", "scale-up", "scale-down"})
_TIMED: Final = frozenset({("at", "start"), ("at", "end"), ("over", "all")})

Kinds = tuple[str, ...]


@dataclass(frozen=True)
class Uses:
    """What is used.

    Attributes:
        predicates: the types of the arguments of each predicate, by its name in lower case.
        numbers: the same of each numeric fact.
        constants: objects that formulas name, in lower case.
        connectives: what formulas are joined by.
    """

    predicates: Mapping[str, Kinds]
    numbers: Mapping[str, Kinds]
    constants: frozenset[str]
    connectives: frozenset[str]


def parsed(text: str, place: str) -> Node:
    """Return a formula as what it is made of.

    Raises:
        PddlError: it is none.
    """
    if not text.strip().startswith("("):
        raise PddlError(f"found {text!r}, expected a formula such as '({text.strip() or 'lit ?room'})'", place)
    root = parse(text, f"{place}, in {text!r}").root
    if not root.head and root.children:
        raise PddlError(f"found {text!r}, expected the name of a predicate first", place)
    return root


def typed_names(texts: Iterable[str], place: str) -> Iterator[tuple[str, str]]:
    """Yield name and type of each variable of texts such as `?x - place` and `?x ?y - place`."""
    for text in texts:
        words = text.split()
        is_typed = len(words) > 2 and words[-2] == "-" and all(word.startswith("?") for word in words[:-2])
        if not is_typed or words[-1].startswith("?"):
            raise PddlError(f"found the parameter {text!r}, expected one with its type such as '?x - place'", place)
        yield from ((word, words[-1]) for word in words[:-2])


class Signatures:
    """Reads formulas, and keeps of each predicate the least type that fits all its uses.

    Args:
        objects: the type of each object.
        above: for each subtype the type above it.
        predicates: those that are known beforehand, with the types of their arguments.
    """

    def __init__(self, objects: Mapping[str, str], above: Mapping[str, str], predicates: Mapping[str, Kinds]) -> None:
        self._objects = {name.lower(): kind for name, kind in objects.items()}
        self._spelled = tuple(objects)
        self._above = {kind.lower(): parent.lower() for kind, parent in above.items()}
        self._predicates = dict(predicates)
        self._numbers: dict[str, Kinds] = {}
        self._constants: set[str] = set()
        self._connectives: set[str] = set()

    def uses(self) -> Uses:
        """Return what was used up to now."""
        constants, connectives = frozenset(self._constants), frozenset(self._connectives)
        return Uses(dict(self._predicates), dict(self._numbers), constants, connectives)

    def read(self, text: str, scope: Mapping[str, str], place: str, *, is_effect: bool = False) -> None:
        """Take in a condition or an effect whose variables have the types of the scope.

        Raises:
            PddlError: it is no formula, or uses a predicate otherwise than another one does.
        """
        for atom, kinds in self._atoms(parsed(text, place), scope, place, is_effect):
            self._join(self._predicates, atom, kinds, place)

    def read_number(self, text: str, scope: Mapping[str, str], place: str) -> None:
        """Take in a numeric fact."""
        node = parsed(text, place)
        self._join(self._numbers, node, self._kinds(node, scope, place), place)

    def check(self, text: str, uses: Uses, place: str, *, is_number: bool = False) -> None:
        """Raise unless a formula of the problem uses only what actions use, and in that way."""
        known = uses.numbers if is_number else uses.predicates
        node = parsed(text, place)
        atoms = [(node, self._kinds(node, {}, place))] if is_number else self._atoms(node, {}, place, True)
        for atom, kinds in atoms:
            if atom.head not in known:
                what = "numeric fact" if is_number else "predicate"
                raise PddlError(
                    f"{atom}: no action mentions the {what} {atom.head!r}; {nearest(atom.head, known)}", place
                )
            expected = known[atom.head]
            if self._joined(expected, kinds) != expected:
                raise PddlError(f"{atom} is about {_spoken(kinds)}, expected {_spoken(expected)}", place)

    def _atoms(self, node: Node, scope: Mapping[str, str], place: str, is_effect: bool) -> Iterator[tuple[Node, Kinds]]:
        """Yield each atom of a formula with the types of what it is about."""
        _refuse(node, place)
        head, rest = node.head, node.children[1:]
        if head in _CONNECTIVES:
            if not (head == "not" and is_effect):
                self._connectives.add(head)
            for number, child in enumerate(rest):
                is_condition = head == "when" and number == 0
                yield from self._atoms(child, scope, place, is_effect and not is_condition)
        elif head in _QUANTIFIERS:
            self._connectives.add(head)
            inner, body = _quantified(node, place)
            yield from self._atoms(body, {**scope, **inner}, place, is_effect)
        elif head == "=":
            self._connectives.add(head)
            self._kinds(node, scope, place)
        elif head:
            yield node, self._kinds(node, scope, place)

    def _kinds(self, atom: Node, scope: Mapping[str, str], place: str) -> Kinds:
        """Return the types of what an atom is about."""
        kinds = []
        for argument in atom.children[1:]:
            is_variable = argument.lower.startswith("?")
            known = {name.lower(): kind for name, kind in scope.items()} if is_variable else self._objects
            kind = known.get(argument.lower)
            if kind is None:
                what, names = ("parameter", tuple(scope)) if is_variable else ("object", self._spelled)
                raise PddlError(f"{atom}: unknown {what} {str(argument)!r}; {nearest(str(argument), names)}", place)
            if not is_variable:
                self._constants.add(argument.lower)
            kinds.append(kind.lower())
        return tuple(kinds)

    def _join(self, known: dict[str, Kinds], atom: Node, kinds: Kinds, place: str) -> None:
        before = known.setdefault(atom.head, kinds)
        joined = self._joined(before, kinds)
        if joined is None:
            message = f"{atom} is about {_spoken(kinds)}, but elsewhere {atom.head!r} is about {_spoken(before)}"
            raise PddlError(f"{message}; declare a type above both in types={{...}}", place)
        known[atom.head] = joined

    def _joined(self, one: Kinds, other: Kinds) -> Kinds | None:
        """Return the least types above both; None if there are none."""
        if len(one) != len(other):
            return None
        joined = [self._least(left, right) for left, right in zip(one, other, strict=True)]
        return None if None in joined else tuple(kind for kind in joined if kind is not None)

    def _least(self, one: str, other: str) -> str | None:
        if "object" in (one, other):
            return "object"
        others = list(self._lineage(other))
        return next((kind for kind in self._lineage(one) if kind in others), None)

    def _lineage(self, kind: str) -> Iterator[str]:
        seen: set[str] = set()
        while kind not in seen:
            seen.add(kind)
            yield kind
            kind = self._above.get(kind, kind)


def _refuse(node: Node, place: str) -> None:
    """Raise for what is written elsewhere in a declaration."""
    if not node.is_list:
        raise PddlError(f"found {node.word!r}, expected a list such as '({node.word})'", place)
    rest = node.children[1:]
    if len(rest) == 2 and rest[1].is_list and (node.head, rest[0].lower) in _TIMED:
        raise PddlError(f"found {node}; say only {rest[1]}, where it belongs (start, over_all, end)", place)
    if node.head in _NUMERIC:
        raise PddlError(f"found {node}, which computes with numbers; state a cost as cost=...", place)


def _quantified(node: Node, place: str) -> tuple[Mapping[str, str], Node]:
    """Return the variables of a quantifier with their types, and what it is about."""
    if len(node.children) != 3 or not node.children[1].is_list:
        raise PddlError(f"found {node}, expected '({node.head} (?x - type) (...))'", place)
    declared, body = node.children[1:]
    return dict(typed_names([" ".join(map(str, declared.children))], place)), body


def _spoken(kinds: Kinds) -> str:
    return f"({' '.join(kinds)})" if kinds else "nothing"
