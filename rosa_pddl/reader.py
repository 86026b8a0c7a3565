"""Reads PDDL files through unified-planning, and tolerates what its reader does not."""

import re
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path

from rosa_pddl.domain import ACTION_TYPE, Domain, Schema, UpThing, conjuncts
from rosa_pddl.exceptions import PddlError, UnsupportedPddlError
from rosa_pddl.problem import Problem
from rosa_pddl.reading.conventions import rosa_action_of, with_told
from rosa_pddl.reading.declarations import Kind, Mention, declared_types, mentions
from rosa_pddl.reading.resources import resources_of, without_limits
from rosa_pddl.reading.sections import BODY, doubtful_requirements, in_order
from rosa_pddl.reading.syntax import Node, Source, parse, read_source
from rosa_pddl.reading.timing import is_timed

__all__ = ["lineage_of", "load_domain", "parse_domain", "schema_of"]

_GLOBAL = threading.Lock()
_LINE = re.compile(r"line:?\s*(\d+)")
# Places in what unified-planning was given, and how its objects look in memory.
_NOISE = re.compile(
    r"<[\w.]+ object at 0x\w+>,? ?|\(at char \d+\),? ?|\(?(found |from |Error from )?line: ?\d+, col:? ?\d+\)?( to )?"
)
_ILL_TYPED = re.compile(r"expression '([\w-]+)\(.*\)' is not well-formed")

Edit = tuple[int, int, str]


def load_domain(domain: str | Path, problem: str | Path, *, actions: Mapping[str, str] | None = None) -> Domain:
    """Read a PDDL domain and problem.

    Names keep the spelling of the files, and an object, an action, a predicate and a type may share one.

    Which ROSA action a PDDL action does is the `?a` of its condition `(NAME_action ?a)`, NAME being its own name, else
    that of its condition `(action_feasible ?a)`, else its only parameter of type `action`. Files that keep no such
    convention are told: the condition `(over all (action_feasible ...))` is added then to an action that lacks it.

    Args:
        domain: path of the domain file.
        problem: path of the problem file.
        actions: for PDDL actions the ROSA action that they do: its name, or the parameter that is it, as `?a`.

    Raises:
        PddlError: a file cannot be read or is not correct PDDL; says the place.
        UnknownNameError: `actions` names a PDDL action or a parameter that is not in the files.
        UnsupportedPddlError: correct PDDL that cannot be planned or executed here.
    """
    return _load(read_source(domain), read_source(problem), actions or {})


def parse_domain(
    domain: str,
    problem: str,
    *,
    names: tuple[str, str] = ("domain.pddl", "problem.pddl"),
    actions: Mapping[str, str] | None = None,
) -> Domain:
    """Read a PDDL domain and problem that are texts, as `load_domain` does files.

    Args:
        domain: text of the domain.
        problem: text of the problem.
        names: what to call them in messages.
        actions: for PDDL actions the ROSA action that they do, as for `load_domain`.

    Raises:
        PddlError, UnknownNameError, UnsupportedPddlError: as `load_domain`.
    """
    return _load(parse(domain, names[0]), parse(problem, names[1]), actions or {})


def _load(domain: Source, problem: Source, actions: Mapping[str, str]) -> Domain:
    found = mentions(domain, problem)
    inside = _unique_names(found)
    up_problem = _read(_rewritten(domain, found, inside), _rewritten(problem, found, inside))
    read = _domain(domain, problem, up_problem, found, inside)
    loaded = with_told(read, actions) if actions else read
    # what cannot be planned for is refused here, not at the first planning
    Problem(loaded, frozenset()).build()
    return loaded


@dataclass(frozen=True)
class _Rewritten:
    """What unified-planning reads: unique names, sections in order, none of what its grammar stumbles over.

    Args:
        source: the file.
        title: such as `(domain rover)`.
        sections: each as it stands in the file, and as it is read; lines within it are kept.
    """

    source: Source
    title: Node
    sections: tuple[tuple[Node, str], ...]

    @property
    def text(self) -> str:
        return "\n".join([f"(define {self.title}", *(text for _, text in self.sections), ")"])

    def line(self, read: int) -> int | None:
        """Return the line of the file that became a line of the text, both counted from 1."""
        lines = [self.title.line]
        for node, text in self.sections:
            lines += range(node.line, node.line + text.count("\n") + 1)
        return lines[read - 1] if 0 < read <= len(lines) else None

    def with_action(self, wanted: Node) -> "_Rewritten":
        """Return the same with one only of the actions."""
        kept = tuple(one for one in self.sections if one[0].head not in BODY or one[0] is wanted)
        return replace(self, sections=kept)


def _unique_names(found: Iterable[Mention]) -> dict[tuple[Kind, str], str]:
    """Return a name for each kind and word such that no two are the same, as unified-planning wants it."""
    inside: dict[tuple[Kind, str], str] = {}
    taken = {"object"}
    for kind in (Kind.TYPE, Kind.PREDICATE, Kind.OBJECT, Kind.SCHEMA):
        for word in _declared_words(found, kind):
            name = word
            while name in taken:
                name += f"_{kind.name.lower()}"
            taken.add(name)
            inside[kind, word] = name
    return inside


def _declared_words(found: Iterable[Mention], kind: Kind) -> list[str]:
    words = dict.fromkeys(m.node.lower for m in found if m.declares and m.kind is kind)
    return [word for word in words if (kind, word) != (Kind.TYPE, "object")]


def _rewritten(source: Source, found: Iterable[Mention], inside: Mapping[tuple[Kind, str], str]) -> _Rewritten:
    edits: dict[int, Edit] = {}
    for mention in found:
        new = inside.get((mention.kind, mention.node.lower))
        if mention.source is source and new is not None and new != mention.node.lower:
            edits[mention.node.start] = (mention.node.start, mention.node.end, new)
    for start, end, new in _tolerated(source):
        edits[start] = (start, end, new + "\n" * source.text.count("\n", start, end))
    texts = [(node, _edited(source.text, node, edits.values())) for node in in_order(source) if not _is_needless(node)]
    return _Rewritten(source, source.root.children[1], tuple(texts))


def _is_needless(node: Node) -> bool:
    """Requirements promise what the sections then show; unified-planning refuses ones it does not know."""
    return node.head == ":requirements" or (len(node.children) == 1 and node.head not in (":init", ":goal"))


def _edited(text: str, node: Node, edits: Iterable[Edit]) -> str:
    parts, at = [], node.start
    for start, end, new in sorted(edit for edit in edits if node.start <= edit[0] < node.end):
        parts += [text[at:start], new]
        at = end
    return "".join([*parts, text[at : node.end]])


def _tolerated(source: Source) -> Iterator[Edit]:
    """Yield what can be said otherwise so that the reader of unified-planning 1.3 understands it."""
    yield from _untyped(source.root)
    for node in source.root.children[2:]:
        if node.head == ":types":
            yield from _above_itself(node)
        elif node.head in BODY:
            yield from _body(node)


def _above_itself(section: Node) -> Iterator[Edit]:
    """Put a type above itself, as in `dock charger - dock`, on top."""
    listed = [(name.lower, up.lower if up is not None else "object") for name, up in declared_types(section)]
    if any(up == name for name, up in listed):
        text = " ".join(f"{name} - {'object' if up == name else up}" for name, up in listed)
        yield section.start, section.end, f"(:types {text})"


def _body(schema: Node) -> Iterator[Edit]:
    if ":parameters" not in [child.lower for child in schema.children]:
        yield schema.children[1].end, schema.children[1].end, " :parameters ()"
    for keyword, part in pairwise(schema.children):
        if keyword.lower in (":precondition", ":condition", ":effect") and not part.children:
            yield part.start, part.end, "(and)"
        elif keyword.lower == ":duration":
            yield from _duration(part)


def _duration(node: Node) -> Iterator[Edit]:
    """Yield a single duration in place of a bound on one side: any that is allowed will do."""
    if not node.children:
        yield node.start, node.end, "(= ?duration 1)"
    elif is_timed(node) or (node.head == "and" and len(node.children) == 2):
        inner = node.children[-1]
        yield node.start, inner.start, ""
        yield from _duration(inner)
        yield inner.end, node.end, ""
    elif node.head in (">=", "<="):
        yield node.children[0].start, node.children[0].end, "="


def _untyped(node: Node) -> Iterator[Edit]:
    """Yield the type that quantified variables without one have."""
    if node.head in ("forall", "exists") and len(node.children) == 3:
        variables = node.children[1]
        if variables.children and (len(variables.children) < 3 or variables.children[-2].word != "-"):
            yield variables.end - 1, variables.end, " - object)"
    for child in node.children:
        yield from _untyped(child)


def _read(domain: _Rewritten, problem: _Rewritten) -> UpThing:
    try:
        return _parsed(domain.text, problem.text)
    except Exception as error:
        raise _located(error, problem if _is_readable(domain) else domain, domain.source) from error


def _is_readable(domain: _Rewritten) -> bool:
    try:
        _parsed(domain.text, None)
    except Exception:
        return False
    return True


def _parsed(domain: str, problem: str | None) -> UpThing:
    from unified_planning.environment import Environment
    from unified_planning.io import PDDLReader

    environment = Environment()
    environment.credits_stream = None
    with _as_global(environment), warnings.catch_warnings():
        # unified-planning 1.3 calls its parser by names that were since deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        return PDDLReader(environment).parse_problem_string(domain, problem)


@contextmanager
def _as_global(environment: UpThing) -> Iterator[None]:
    """unified-planning 1.3 makes the variables of forall effects in the global environment, whatever it was given."""
    import unified_planning.environment as module

    with _GLOBAL:
        before = module.GLOBAL_ENVIRONMENT
        module.GLOBAL_ENVIRONMENT = environment
        try:
            yield
        finally:
            module.GLOBAL_ENVIRONMENT = before


def _located(error: Exception, read: _Rewritten, domain: Source) -> PddlError:
    """Turn what unified-planning says into an error with its line; columns may have moved by renaming."""
    text = " ".join(str(error).split()) or repr(error)
    place, ill = _LINE.search(text), _ILL_TYPED.search(text)
    line = read.line(int(place.group(1))) if place else _culprit(read)
    message = f"unified-planning cannot read this: {' '.join(_NOISE.sub('', text).split())}"
    if ill is not None:
        message = (
            f"the arguments of {ill.group(1)!r} are of other types than declared: {_declaration(domain, ill.group(1))}"
        )
    return PddlError(message, read.source.file, line)


def _declaration(domain: Source, name: str) -> str:
    """Return how a predicate is declared, by the name that unified-planning was given."""
    sections = [node for node in domain.root.children if node.head in (":predicates", ":functions")]
    declared = [node for section in sections for node in section.children[1:] if node.head]
    return " or ".join(str(node) for node in declared if name in (node.head, f"{node.head}_predicate")) or name


def _culprit(read: _Rewritten) -> int | None:
    """Return the line of the first action that cannot be read even without the others."""
    actions = [node for node, _ in read.sections if node.head in BODY]
    return next((node.line for node in actions if not _is_readable(read.with_action(node))), None)


def _domain(domain: Source, problem: Source, up_problem: UpThing, found: Iterable[Mention], inside: UpThing) -> Domain:
    spelled = {(m.kind, m.node.lower): m.node.lower for m in found if m.declares}
    spelled |= {(m.kind, m.node.lower): str(m.node) for m in found if m.declares}
    outside = {name: spelled[key] for key, name in inside.items()} | {"object": "object"}
    types = {outside[thing.name]: tuple(lineage_of(thing.type, outside)) for thing in up_problem.all_objects}
    places = {(m.kind.value, str(m.node)): (m.source.file, m.node.line) for m in found if m.declares}
    places |= {("section", node.head): (problem.file, node.line) for node in problem.root.children[2:]}
    schemas = [schema_of(action, outside, domain.file) for action in up_problem.actions]
    return Domain(
        name=str(domain.root.children[1].children[1]),
        file=domain.file,
        problem_file=problem.file,
        rosa_actions=tuple(name for name, lineage in types.items() if ACTION_TYPE in lineage),
        schemas=tuple(schema.name for schema in schemas),
        up_problem=up_problem,
        schema_of={schema.name: schema for schema in schemas},
        outside=outside,
        inside={(kind.value, word): name for (kind, word), name in inside.items()},
        goals=tuple(str(goal) for goal in _goals(problem)),
        places=places,
        types=types,
        oversights=(*doubtful_requirements(domain), *doubtful_requirements(problem)),
        resources=resources_of(up_problem, outside),
    )


def _goals(problem: Source) -> Iterator[Node]:
    for section in problem.root.children[2:]:
        if section.head == ":goal":
            yield from chain.from_iterable(without_limits(goal) for goal in section.children[1:] if goal.children)


def lineage_of(type_: UpThing, outside: Mapping[str, str]) -> Iterator[str]:
    """Yield the name of a type and of those above it, in lower case."""
    while type_ is not None:
        yield outside[type_.name].lower()
        type_ = type_.father


def schema_of(action: UpThing, outside: Mapping[str, str], file: str) -> Schema:
    """Return an action as unified-planning read it in the view of ROSA.

    Args:
        action: as unified-planning has it.
        outside: the files' spelling by unified-planning's names.
        file: where it stands, for messages.

    Raises:
        UnsupportedPddlError: it changes while it runs, or is of another kind.
    """
    name = outside[action.name]
    if hasattr(action, "conditions"):
        parts = _timed(action, name, file)
    elif hasattr(action, "preconditions"):
        parts = {"start": tuple(conjuncts(action.preconditions)), "end_effects": tuple(action.effects)}
    else:
        raise UnsupportedPddlError(f"the action {name!r} is of an unsupported kind", file)
    complete = {key: parts.get(key, ()) for key in ("start", "over_all", "end", "start_effects", "end_effects")}
    complete |= {key: _true_or_false(complete[key]) for key in ("start_effects", "end_effects")}
    conditions = complete["start"] + complete["over_all"] + complete["end"]
    parameters = tuple((parameter.name, outside[parameter.type.name]) for parameter in action.parameters)
    rosa_action = rosa_action_of(name, conditions, action.parameters, outside)
    return Schema(name=name, parameters=parameters, action=rosa_action, **complete)


def _true_or_false(effects: tuple[UpThing, ...]) -> tuple[UpThing, ...]:
    """Costs are the planner's business: what is assumed after a step are facts."""
    return tuple(effect for effect in effects if effect.fluent.type.is_bool_type())


def _timed(action: UpThing, name: str, file: str) -> dict[str, tuple[UpThing, ...]]:
    parts: dict[str, tuple[UpThing, ...]] = {}
    for interval, conditions in action.conditions.items():
        at_start, at_end = interval.lower.is_from_start(), interval.upper.is_from_end()
        key = "over_all" if at_start and at_end else "start" if at_start else "end"
        parts[key] = parts.get(key, ()) + tuple(conjuncts(conditions))
    for timing, effects in action.effects.items():
        key = "start_effects" if timing.is_from_start() else "end_effects"
        parts[key] = parts.get(key, ()) + tuple(effects)
    if action.continuous_effects:
        raise UnsupportedPddlError(f"the action {name!r} changes numbers continuously", file)
    return parts
