"""Which names a PDDL domain and problem declare and use, and whether each used one is declared."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain, pairwise

from rosa_pddl.exceptions import nearest
from rosa_pddl.reading.resources import check_condition, check_effect, check_goal, used_up
from rosa_pddl.reading.sections import BODY, check_frames, start_of
from rosa_pddl.reading.syntax import Node, Source
from rosa_pddl.reading.timing import check_times, is_timed


class Kind(Enum):
    """What a name stands for."""

    TYPE = "type"
    PREDICATE = "predicate"
    OBJECT = "object"
    SCHEMA = "action"


@dataclass(frozen=True)
class Mention:
    """One place where a name is declared or used.

    Args:
        kind: what the name stands for.
        node: the word itself.
        source: the file it stands in.
        declares: whether this place declares it.
        arity: number of arguments, for predicates and functions.
    """

    kind: Kind
    node: Node
    source: Source
    declares: bool = False
    arity: int | None = None


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?")
_CONNECTIVES = ("and", "or", "not", "imply", "when")
_QUANTIFIERS = ("forall", "exists")
_COMPARISONS = ("<", ">", "<=", ">=")
_CHANGES = ("assign", "increase", "decrease", "scale-up", "scale-down")
_WORDS = _CONNECTIVES + _QUANTIFIERS + _CHANGES


def mentions(domain: Source, problem: Source) -> tuple[Mention, ...]:
    """Every declaration and use of a name in both files, checked.

    Raises:
        PddlError: something is misspelt, undeclared or misplaced.
        UnsupportedPddlError: a construct that cannot be planned or executed here.
    """
    check_frames(domain, problem)
    used = used_up(domain)
    found_in_domain = tuple(chain.from_iterable(_section(domain, node, used) for node in domain.root.children[2:]))
    found_in_problem = tuple(chain.from_iterable(_section(problem, node, used) for node in problem.root.children[2:]))
    _check(found_in_domain, _declared(found_in_domain))
    _check_lineage(domain)
    _check(found_in_problem, _declared(found_in_domain + found_in_problem))
    return found_in_domain + found_in_problem


def _section(source: Source, node: Node, resources: frozenset[str]) -> Iterator[Mention]:
    body = node.children[1:]
    if node.head == ":types":
        yield from _typed(source, body, Kind.TYPE)
    elif node.head in (":constants", ":objects"):
        yield from _typed(source, body, Kind.OBJECT)
    elif node.head in (":predicates", ":functions"):
        yield from _signatures(source, body)
    elif node.head in BODY:
        yield from _schema(source, node, resources)
    elif node.head == ":init":
        yield from chain.from_iterable(_fact(source, fact) for fact in body)
    elif node.head == ":goal":
        for goal in body:
            check_goal(source, goal, resources)
            yield from _formula(source, goal, frozenset())


def _typed(source: Source, nodes: Iterable[Node], kind: Kind | None) -> Iterator[Mention]:
    """Read a typed list such as `a b - t c`; `kind` is what it declares, None for variables."""
    expects_type = False
    for node in nodes:
        if node.is_list:
            if expects_type and node.head == "either":
                message = (
                    "found '(either ...)': no engine of unified-planning takes a type of several; Fast Downward by "
                )
                raise source.unsupported(node, message + "itself would do. Declare a type above them")
            raise source.error(node, f"found {start_of(node)!r}, expected {'a type' if expects_type else 'a name'}")
        if node.word == "-":
            expects_type = True
        elif expects_type:
            yield Mention(Kind.TYPE, node, source, declares=kind is Kind.TYPE)
            expects_type = False
        elif kind is None:
            if not node.lower.startswith("?"):
                raise source.error(node, f"found {node.word!r}, expected a variable such as '?{node.word}'")
        else:
            yield Mention(kind, node, source, declares=True)


def _variables(nodes: Iterable[Node]) -> frozenset[str]:
    return frozenset(node.lower for node in nodes if node.lower.startswith("?"))


def _signatures(source: Source, nodes: Sequence[Node]) -> Iterator[Mention]:
    for before, node in zip(("", *(str(node) for node in nodes)), nodes, strict=False):
        expects_type = before == "-"
        if not node.is_list:
            if node.lower in ("-", "number"):
                continue
            if expects_type:
                message = f"found '- {node.word}': a function that is an object is not supported; Aries (up-aries) by "
                raise source.unsupported(node, message + "itself would do. Write a predicate with one more argument")
            raise source.error(node, f"found {node.word!r}, expected a list such as '({node.word} ?x)'")
        if not node.head:
            raise source.error(node, f"found {start_of(node)!r}, expected a name")
        arguments = node.children[1:]
        yield from _typed(source, arguments, None)
        yield Mention(Kind.PREDICATE, node.children[0], source, declares=True, arity=len(_variables(arguments)))


def _schema(source: Source, node: Node, resources: frozenset[str]) -> Iterator[Mention]:
    if len(node.children) < 2 or node.children[1].is_list or node.children[1].lower.startswith(":"):
        raise source.error(node, f"found {start_of(node)!r}, expected '({node.head} NAME ...)'")
    name = node.children[1]
    yield Mention(Kind.SCHEMA, name, source, declares=True)
    parts = _parts(source, node)
    parameters = parts[":parameters"].children if ":parameters" in parts else ()
    yield from _typed(source, parameters, None)
    scope = _variables(parameters)
    _check_once(source, parameters)
    for keyword in (":precondition", ":condition", ":effect"):
        if keyword in parts:
            is_effect = keyword == ":effect"
            if is_effect:
                check_effect(source, parts[keyword], str(name), resources)
            else:
                check_condition(source, parts[keyword], str(name))
            check_times(source, node, parts[keyword], is_effect=is_effect)
            yield from _formula(source, parts[keyword], scope)
    if ":duration" in parts:
        yield from _term(source, parts[":duration"], scope)
    elif node.head == ":durative-action":
        raise source.error(node, f"(:durative-action {name} has no ':duration'")


def _parts(source: Source, schema: Node) -> dict[str, Node]:
    allowed = BODY[schema.head]
    parts: dict[str, Node] = {}
    words = list(schema.children[2:])
    while words:
        keyword = words.pop(0)
        if keyword.lower not in allowed:
            message = f"found {start_of(keyword)!r} in {schema.head} {schema.children[1]}, expected one of "
            message += f"{' '.join(allowed)}; {nearest(keyword.lower, allowed)}"
            raise source.error(keyword, message)
        if not words or not words[0].is_list:
            raise source.error(keyword, f"expected '(' after {keyword.word}")
        parts[keyword.lower] = words.pop(0)
    return parts


def _check_once(source: Source, parameters: Iterable[Node]) -> None:
    seen: set[str] = set()
    for node in parameters:
        if node.lower.startswith("?") and node.lower in seen:
            raise source.error(node, f"found the parameter {node.word!r} again, expected another name")
        seen.add(node.lower)


def _formula(source: Source, node: Node, scope: frozenset[str]) -> Iterator[Mention]:
    if not node.is_list:
        raise source.error(node, f"found {node.word!r}, expected a list such as '({node.word})'")
    if not node.children:
        return
    head, rest = node.head, node.children[1:]
    if head in _CONNECTIVES:
        yield from chain.from_iterable(_formula(source, child, scope) for child in rest)
    elif head in _QUANTIFIERS:
        yield from _quantified(source, node, scope)
    elif head == "preference":
        message = f"found {start_of(node)!r}: no installed engine takes preferences; LPG (up-lpg) by itself would do. "
        raise source.unsupported(node, message + "Leave it out and add it as a soft goal: goals.add(TEXT, worth=COST)")
    elif is_timed(node):
        yield from _formula(source, rest[1], scope)
    elif head in ("=", *_COMPARISONS, *_CHANGES):
        yield from chain.from_iterable(_term(source, child, scope) for child in rest)
    else:
        yield from _atom(source, node, scope)


def _quantified(source: Source, node: Node, scope: frozenset[str]) -> Iterator[Mention]:
    if len(node.children) != 3 or not node.children[1].is_list:
        raise source.error(node, f"found {start_of(node)!r}, expected '({node.head} (?x - type) (...))'")
    variables = node.children[1].children
    yield from _typed(source, variables, None)
    yield from _formula(source, node.children[2], scope | _variables(variables))


def _atom(source: Source, node: Node, scope: frozenset[str]) -> Iterator[Mention]:
    if not node.head:
        raise source.error(node, f"found {start_of(node)!r}, expected the name of a predicate first")
    yield Mention(Kind.PREDICATE, node.children[0], source, arity=len(node.children) - 1)
    yield from chain.from_iterable(_term(source, child, scope) for child in node.children[1:])


def _term(source: Source, node: Node, scope: frozenset[str]) -> Iterator[Mention]:
    if node.is_list:
        if is_timed(node):
            yield from _term(source, node.children[2], scope)
        elif node.head in ("+", "-", "*", "/", "=", "and", *_COMPARISONS):
            yield from chain.from_iterable(_term(source, child, scope) for child in node.children[1:])
        elif node.children:
            yield from _atom(source, node, scope)
    elif node.lower.startswith("?"):
        if node.lower not in scope and node.lower != "?duration":
            raise source.error(
                node, f"found the variable {node.word!r}, expected a parameter; {nearest(node.lower, scope)}"
            )
    elif not _is_number(node.lower) and node.lower != "#t":
        yield Mention(Kind.OBJECT, node, source)


def _is_number(word: str) -> bool:
    return _NUMBER.fullmatch(word) is not None


def _fact(source: Source, node: Node) -> Iterator[Mention]:
    if node.head == "at" and len(node.children) == 3 and _is_number(node.children[1].lower):
        message = (
            f"found {start_of(node)!r}: facts that become true at a time are not supported; Aries (up-aries) by itself "
        )
        raise source.unsupported(node, message + "would do. Sense the fact instead")
    yield from _formula(source, node, frozenset())


Declared = Mapping[tuple[Kind, str], Mention]


def _declared(found: Iterable[Mention]) -> Declared:
    declared: dict[tuple[Kind, str], Mention] = {}
    for mention in found:
        key = (mention.kind, mention.node.lower)
        if mention.declares:
            first = declared.setdefault(key, mention)
            if first is not mention and mention.kind is not Kind.TYPE:
                message = (
                    f"the {mention.kind.value} {mention.node.word!r} was declared before, in line {first.node.line}"
                )
                raise mention.source.error(mention.node, f"{message} of {first.source.file}")
    return declared


def declared_types(section: Node) -> Iterator[tuple[Node, Node | None]]:
    """Yield each type of a section `:types` and the type above it."""
    waiting: list[Node] = []
    words = section.children
    for before, node in pairwise(words):
        if before.word == "-":
            yield from ((name, node) for name in waiting)
            waiting = []
        elif node.word != "-":
            waiting.append(node)
    yield from ((name, None) for name in waiting)


def _check_lineage(domain: Source) -> None:
    """Refuse types that are above one another."""
    sections = [section for section in domain.root.children[2:] if section.head == ":types"]
    above = {name.lower: up for section in sections for name, up in declared_types(section) if up is not None}
    for name in above:
        seen, now = {name}, above.get(name)
        while now is not None and now.lower != name and now.lower not in seen:
            seen.add(now.lower)
            now = above.get(now.lower)
        if now is not None and now.lower == name and len(seen) > 1:
            raise domain.error(now, f"the types {', '.join(sorted(seen))} are above one another, expected one on top")


def _check(found: Iterable[Mention], declared: Declared) -> None:
    for mention in found:
        kind, node, source = mention.kind, mention.node, mention.source
        if mention.declares and not _NAME.fullmatch(str(node)):
            message = (
                f"found the {kind.value} {str(node)!r}, expected a name: a letter, then letters, digits, '_' or '-'"
            )
            raise source.error(node, message)
        if (kind is Kind.TYPE and node.lower in ("object", "number")) or mention.declares:
            continue
        known = declared.get((kind, node.lower))
        if known is None:
            names = [str(first.node) for (other, _), first in declared.items() if other is kind]
            hints = names + list(_WORDS) if kind is Kind.PREDICATE else names
            message = f"found the unknown {kind.value} {node.word!r}, expected a declared one; "
            raise source.error(node, message + nearest(node.lower, hints))
        if mention.arity != known.arity:
            message = f"found {mention.arity} arguments of {node.word!r}, expected {known.arity}"
            raise source.error(node, f"{message} as declared in line {known.node.line} of {known.source.file}")
