"""The sections of PDDL files: which there are, in which order, and what they promise."""

from collections.abc import Collection, Iterator, Mapping

from rosa_pddl.exceptions import nearest
from rosa_pddl.reading.syntax import Node, Source

__all__ = ["BODY", "check_frames", "doubtful_requirements", "in_order", "start_of"]

BODY: Mapping[str, tuple[str, ...]] = {
    ":action": (":parameters", ":precondition", ":effect"),
    ":durative-action": (":parameters", ":duration", ":condition", ":effect"),
}
"""What describes an action, by the section."""

# In the order that unified-planning's reader insists on.
_DOMAIN = ("domain", ":requirements", ":types", ":constants", ":predicates", ":functions", *BODY)
_PROBLEM = ("problem", ":domain", ":requirements", ":objects", ":init", ":goal", ":metric")
# What unified-planning or the executor cannot take, and which engine would do.
_UNSUPPORTED = {
    ":derived": "unified-planning has no derived predicates; Fast Downward by itself would do. Sense the predicate, or "
    "make it an effect of actions",
    ":process": "it changes numbers while time passes; ENHSP (up-enhsp) would do",
    ":event": "it happens by itself; ENHSP (up-enhsp) would do",
    ":task": "hierarchies are not executed here; Aries (up-aries) by itself would do",
    ":method": "hierarchies are not executed here; Aries (up-aries) by itself would do",
    ":htn": "hierarchies are not executed here; Aries (up-aries) by itself would do",
    ":constraints": "what shall hold on the way is not planned for; SymK (up-symk) after compilation would do",
}
_METRICS = ("minimize (total-cost)", "minimize (total-time)")
# Those of PDDL 2.1 to 3.1, and of its extensions for hierarchies and chance.
_REQUIREMENTS = (
    *(":strips", ":typing", ":equality", ":adl", ":fluents", ":numeric-fluents", ":object-fluents", ":action-costs"),
    *(":negative-preconditions", ":disjunctive-preconditions", ":existential-preconditions", ":time", ":constraints"),
    *(":universal-preconditions", ":quantified-preconditions", ":conditional-effects", ":derived-predicates", ":htn"),
    *(":durative-actions", ":duration-inequalities", ":continuous-effects", ":timed-initial-literals", ":preferences"),
    *(":goal-utilities", ":hierarchy", ":method-preconditions", ":multi-agent", ":non-deterministic", ":rewards"),
    *(":probabilistic-effects", ":contingent", ":partial-observability", ":processes", ":events", ":timed-effects"),
)


def check_frames(domain: Source, problem: Source) -> None:
    """Assure that both files have the sections that they need, no others, and belong together.

    Raises:
        PddlError: a section is missing, misspelt, there twice, or of another domain.
        UnsupportedPddlError: a section that cannot be planned for or executed.
    """
    _check_frame(domain, "domain", _DOMAIN)
    _check_frame(problem, "problem", _PROBLEM)
    _check_problem(problem)
    _check_belongs(domain, problem)


def in_order(source: Source) -> list[Node]:
    """Return the sections in the order of PDDL's grammar, those of one kind as they stand."""
    order = {name: number for number, name in enumerate(_PROBLEM + _DOMAIN)}
    last = len(order)
    return sorted(source.root.children[2:], key=lambda node: last if node.head in BODY else order[node.head])


def doubtful_requirements(source: Source) -> Iterator[str]:
    """Yield sentences about requirements that PDDL does not have; they do no harm, but may be misspelt."""
    for section in source.root.children[2:]:
        if section.head == ":requirements":
            for node in section.children[1:]:
                if str(node).lower() not in _REQUIREMENTS:
                    place = f"{source.file}:{node.line}:{node.column}"
                    yield f"{place}: PDDL has no requirement {str(node)!r}; {nearest(str(node), _REQUIREMENTS)}"


def start_of(node: Node) -> str:
    """Return the text of a node, shortened."""
    text = str(node)
    return text if len(text) <= 40 else text[:37] + "..."


def _check_frame(source: Source, what: str, sections: Collection[str]) -> None:
    root = source.root
    if root.head != "define" or len(root.children) < 2:
        raise source.error(root, f"found {start_of(root)!r}, expected '(define ({what} ...) ...)'")
    title = root.children[1]
    if title.head != what or len(title.children) != 2:
        raise source.error(title, f"found {start_of(title)!r}, expected '({what} NAME)'; is this the {what} file?")
    first: dict[str, Node] = {}
    for node in root.children[2:]:
        if node.head in _UNSUPPORTED:
            raise source.unsupported(node, f"found '({node.head}': {_UNSUPPORTED[node.head]}")
        if node.head not in sections:
            raise source.error(node, f"found {start_of(node)!r}, expected a section; {nearest(node.head, sections)}")
        if node.head not in (*BODY, ":requirements") and first.setdefault(node.head, node) is not node:
            message = f"found a second '({node.head}', expected one; put both together, the first is in line"
            raise source.error(node, f"{message} {first[node.head].line}")


def _check_problem(source: Source) -> None:
    root = source.root
    for needed in (":domain", ":init", ":goal"):
        if all(node.head != needed for node in root.children):
            raise source.error(root, f"the problem has no '({needed} ...)'")
    for node in root.children[2:]:
        parts = node.children[1:]
        if node.head == ":goal" and len(parts) != 1:
            message = f"found {len(parts)} conditions in (:goal ...), expected one; join them with (and ...)"
            raise source.error(node, message)
        if node.head == ":metric" and " ".join(str(part).lower() for part in parts) not in _METRICS:
            message = f"found {start_of(node)!r}, which is not planned for; expected none, or one of "
            raise source.unsupported(node, message + " and ".join(f"'(:metric {one})'" for one in _METRICS))


def _check_belongs(domain: Source, problem: Source) -> None:
    """Assure that the problem names this domain."""
    title = domain.root.children[1].children[1]
    for node in problem.root.children[2:]:
        if node.head == ":domain" and [child.lower for child in node.children[1:]] != [title.lower]:
            raise problem.error(
                node, f"found {start_of(node)!r}, expected '(:domain {title})', as {domain.file} is called"
            )
