"""Checks of a model: unknown and unused names, what can never be feasible, and what is never selected."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from itertools import combinations, groupby, pairwise
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Final

from kb.debounce import turning_point
from kb.elements import KINDS, Constraint, Element, listed, text
from kb.exceptions import UnknownName
from kb.facts import Contents, RequiredActionFact
from kb.network import Network, Node
from kb.remedies import FALSE, Conjunction, Interval, Requirements, bounds
from kb.status import Status

QUICK: Final = 4
"""How many alternatives are kept in a first, quick look; only elements that fail it are looked at thoroughly."""
MOST_ACTIONS: Final = 4
PREFERRED: Final = 32
"""The most preferred alternatives with which each one is compared."""

Bounds = Mapping[str, Interval]
_Names = dict[Node, dict[str, None]]


class Severity(StrEnum):
    """How bad a finding is: an error can never work, a warning is likely a mistake."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Rule:
    """One check: the severity of its findings, what they mean in general, and what to do about them."""

    severity: Severity
    meaning: str
    advice: str


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a model that its author should look at.

    Attributes:
        code: the word for the rule, one of `rules()`.
        severity: how bad it is.
        element: kind and name, e.g. "function see"; for something that is not in the model, the given name.
        message: what was found, and where.
        advice: what to do about it.
        place: where the element stands, as file:line:column; empty if it comes from no file.
    """

    code: str
    severity: Severity
    element: str
    message: str
    advice: str
    place: str = ""

    @property
    def where_and_what(self) -> str:
        """The message, after its place if that is known."""
        return f"{self.place}: {self.message}" if self.place else self.message

    def __str__(self) -> str:
        return " ".join(
            f"{self.severity}: {self.where_and_what} [{self.code}]; {self.advice}".split()
        )


@cache
def rules() -> Mapping[str, Rule]:
    """Return all rules by code, errors first."""
    import tomllib  # slow to import

    read = tomllib.loads(Path(__file__).with_name("checks.toml").read_text(encoding="utf-8"))
    made = {
        code: Rule(Severity(one["severity"]), one["meaning"], one["advice"])
        for code, one in read.items()
    }
    return MappingProxyType(made)


def found(code: str, element: object, message: str) -> Finding:
    rule = rules()[code]
    return Finding(code, rule.severity, str(element), message, rule.advice)


def listing(names: Iterable[str], most: int = 4) -> str:
    """Write names as a list with a limit, e.g. "a, b and c" or "a, b, c and 7 more"."""
    known = list(names)
    if len(known) > most:
        known = [*known[: most - 1], f"{len(known) - most + 1} more"]
    return " and ".join([", ".join(known[:-1]), known[-1]] if len(known) > 1 else known)


# -------------------------------------------------------------------- what is looked for


def check_model(model: Contents, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
    """Check a model; see `Model.check`. Errors come first; the findings of a rule are in the order of the model."""
    network = Network(model)
    findings = [
        *(() if names is None else _mismatches(model.actions, listed("names", names))),
        *_contradictions(network),
        *_incomplete(network),
        *_unused(model, network),
        *_out_of_range(model),
        *_doubtful_choices(model, network),
        *_restored_twice(network),
        *(found("file-note", f"model {model.name}", note) for note in model.notes),
    ]
    places = {_described(one): place for one, place in model.places.items()}
    placed = (replace(one, place=places.get(one.element, "")) for one in findings)
    return tuple(sorted(placed, key=lambda one: one.severity is not Severity.ERROR))


def _described(one: Element | Constraint) -> str:
    return f"{KINDS[type(one)]} {one.name if isinstance(one, Element) else one}"


def _mismatches(actions: Collection[str], names: Iterable[str]) -> Iterator[Finding]:
    mentioned = dict.fromkeys(text("an action's name", name) for name in names)
    for name in mentioned:
        if name not in actions:
            yield found("unknown-action", name, str(UnknownName("action", name, actions)))
    for name in actions:
        if name not in mentioned:
            yield found(
                "unmentioned-action", f"action {name}", f"action {name} is mentioned nowhere"
            )


def _incomplete(network: Network) -> Iterator[Finding]:
    for node in network.actions.values():
        if not node.requires:
            yield found("action-without-functions", node, f"{node} requires no function")
    for node in network.designs.values():
        if not node.requires:
            yield found(
                "design-without-components", node, f"{node} of {node.used_by[0]} has no component"
            )
    rates = (
        (one.name, rate.while_)
        for one in network.attributes.values()
        for rate in one.attribute.rates
    )
    for name, action in rates:
        if action and action not in network.actions:
            yield found(
                "unknown-action",
                name,
                f"a rate of {name}: {UnknownName('action', action, network.actions)}",
            )


def _unused(model: Contents, network: Network) -> Iterator[Finding]:
    requests = (fact for fact in model.facts if isinstance(fact, RequiredActionFact))
    used = {one.attribute for one in model.estimations}.union(
        *(fact.preference or () for fact in requests)
    )
    attributes = [
        node
        for node in network.attributes.values()
        if not node.constraints and node.name not in used
    ]
    functions = [node for node in network.functions.values() if not node.used_by]
    components = [node for node in network.components.values() if not node.used_by]
    whats = (
        ("nothing depends on", attributes),
        ("no action requires", functions),
        ("no design uses", components),
    )
    for what, nodes in whats:
        for node in nodes:
            yield found(f"unused-{node.kind}", node, f"{what} {node}")


def _out_of_range(model: Contents) -> Iterator[Finding]:
    """Yield the constraints that the range of their attribute decides for every measurement."""
    for one in model.constraints:
        attribute = model.attributes[one.attribute]
        if attribute.low == -inf and attribute.high == inf:
            continue
        possible, wanted = Interval(attribute.low, attribute.high), Interval.of(one)
        is_never = wanted.meet(possible).is_empty
        is_final = (
            not is_never
            and Interval.of(one, turning_point(one, Status.VIOLATED)).meet(possible).is_empty
        )
        if is_never or is_final or wanted.covers(possible):
            how = (
                "is never satisfied"
                if is_never
                else "stays violated once it is"
                if is_final
                else "is never violated"
            )
            where = listing(each.name for each in one.constrained)
            message = f"{_described(one)} {how}: {one.attribute} is {attribute.range} (on {where})"
            yield found("out-of-range", _described(one), message)


def _restored_twice(network: Network) -> Iterator[Finding]:
    """Yield the elements that several actions restore."""
    restoring: dict[Element, list[str]] = {}
    for node in network.actions.values():
        for element in node.element.restores:
            restoring.setdefault(element, []).append(node.name)
    for element, actions in restoring.items():
        if len(actions) > 1:
            message = f"{_described(element)} is restored by actions {listing(actions)}"
            yield found("restored-twice", _described(element), message)


# -------------------------------------------------------------------- what no measurement makes possible


def _contradictions(network: Network) -> Iterator[Finding]:
    """Yield the elements that can never be feasible once their attributes are measured, but only the roots.

    A finding names the actions that its root makes impossible; the elements between the two have no findings.
    """
    quick, thorough = Requirements(limit=QUICK), Requirements()
    impossible: dict[Node, None] = {}
    for node in network.present():
        if node.kind not in ("attribute", "constraint"):
            ways = quick.of(node)
            if (ways if ways.conjunctions or ways.complete else thorough.of(node)) == FALSE:
                impossible[node] = None
    for node in impossible:
        for code, message in _roots(node, impossible, thorough):
            yield found(code, node, message + _consequence(node, impossible))


def _roots(
    node: Node, impossible: Collection[Node], requirements: Requirements
) -> Iterator[tuple[str, str]]:
    """Yield code and message of each reason why an element is impossible, except consequences of its parts."""
    if node.kind == "function":
        if not node.requires:
            yield "function-without-designs", f"{node} has no design"
        return
    empty = [name for name, interval in bounds(node).items() if interval.is_empty]
    for attribute in empty:
        yield (
            "contradictory-constraints",
            f"{node} is constrained by {_contradiction(node, attribute)}",
        )
    broken = [part in impossible for part in node.requires]
    is_consequence = any(broken) and (all(broken) or node.kind != "component")
    if not empty and not is_consequence:
        yield "never-feasible", f"{node} can never be feasible: {_conflict(node, requirements)}"


def _contradiction(node: Node, attribute: str) -> str:
    """Name two constraints that exclude one another, or one that no number satisfies."""
    own = [one.constraint for one in node.constraints if one.constraint.attribute == attribute]
    for one in own:
        if Interval.of(one).is_empty:
            return f"{one}, which no number satisfies"
    one, other = next(
        two
        for two in combinations(own, 2)
        if Interval.of(two[0]).meet(Interval.of(two[1])).is_empty
    )
    return f"{one} and {other}, which no value satisfies both"  # two bounds make an interval empty, never three


def _consequence(node: Node, impossible: Collection[Node]) -> str:
    waiting = {node: None}
    actions: list[str] = []
    while waiting and len(actions) <= MOST_ACTIONS:
        wholes = dict.fromkeys(
            whole for one in waiting for whole in one.used_by if whole in impossible
        )
        actions += [
            whole.name for whole in wholes if whole.kind == "action" and whole.name not in actions
        ]
        waiting = wholes
    if len(actions) > MOST_ACTIONS:
        return f", so {len(actions)} actions or more can never be feasible, e.g. {actions[0]}"
    return f", so action {listing(actions)} can never be feasible" if actions else ""


def _conflict(node: Node, requirements: Requirements) -> str:
    """Name two needs that exclude one another, with their intervals if there is only one way; else all needs."""
    needs = {
        f"its own constraint {one.name}": requirements.of(one).conjunctions
        for one in node.constraints
    }
    if node.kind == "component":
        needs["each of its configurations"] = tuple(
            conjunction
            for part in node.requires
            for conjunction in requirements.of(part).conjunctions
        )
    else:
        for part in node.requires:
            conjunctions = requirements.of(part).conjunctions
            needs[_needing(part, conjunctions)] = conjunctions
    for (one, mine), (other, theirs) in combinations(needs.items(), 2):
        if not any(conjunction.meet(their) for conjunction in mine for their in theirs):
            return f"{one} and {other} exclude one another, whatever is measured"
    return f"{listing(needs, 8)} cannot be met together, whatever is measured"


def _needing(part: Node, conjunctions: tuple[Conjunction, ...]) -> str:
    asked = (
        " and ".join(one.text(name) for name, one in conjunctions[0].items())
        if len(conjunctions) == 1
        else ""
    )
    return f"{part}" + (f" ({asked})" if asked else "")


# -------------------------------------------------------------------- what is chosen, and what never is


def _doubtful_choices(model: Contents, network: Network) -> Iterator[Finding]:
    directly, estimated = _estimated(model, network)
    for whole in (*network.functions.values(), *network.components.values()):
        if whole.kind == "component":
            yield from _excluded(whole)
        if len(whole.requires) < 2:
            continue
        yield from _ties(whole)
        by_part = {part: estimated.get(part, {}) for part in whole.requires}
        if not any(by_part.values()):  # a preference may select what priority never would
            yield from _dominated(whole)
        yield from _unevenly_estimated(whole, by_part, directly.get(whole, {}))
    requests = [fact for fact in model.facts if isinstance(fact, RequiredActionFact)]
    for action, attribute in dict.fromkeys(
        (one.action, name) for one in requests for name in one.preference or ()
    ):
        if attribute not in estimated.get(network.actions[action], ()):
            message = f"action {action} prefers {attribute}, which is estimated for nothing that it can use"
            yield found("missing-estimation", network.actions[action], message)


def _priority(node: Node) -> float:
    priority: float | None = node.element.priority
    return inf if priority is None else priority


def _bounds_in_use(part: Node) -> dict[str, Interval]:
    """Return the intervals that satisfy a design or configuration and its components, by attribute."""
    components = part.used_by if part.kind == "configuration" else part.requires
    return bounds(part, *components)


def _ties(whole: Node) -> Iterator[Finding]:
    for priority, group in groupby(sorted(whole.requires, key=_priority), key=_priority):
        tied = list(group)
        if len(tied) < 2 or _exclude_one_another([_bounds_in_use(one) for one in tied]):
            continue
        which = "no priority" if priority == inf else f"the same priority, {priority}"
        names = sorted(one.name for one in tied)
        message = (
            f"{tied[0].kind}s {listing(names)} of {whole} have {which}; {names[0]} comes first"
        )
        yield found("tied-priorities", whole, message)


def _exclude_one_another(alternatives: Sequence[Bounds]) -> bool:
    """Return whether an attribute allows only one of them at a time, so that a tie does not matter."""
    for attribute in alternatives[0]:
        known = sorted(one[attribute] for one in alternatives if attribute in one)
        if len(known) == len(alternatives) and all(
            one.meet(after).is_empty for one, after in pairwise(known)
        ):
            return True
    return False


def _excluded(component: Node) -> Iterator[Finding]:
    own = bounds(component)
    parts = {
        part: mine for part in component.requires if not _is_contradictory(mine := bounds(part))
    }
    clashes = {
        part: next(
            (name for name in mine if name in own and mine[name].meet(own[name]).is_empty), None
        )
        for part, mine in parts.items()
    }
    if _is_contradictory(own) or all(clashes.values()):
        return
    for part, name in clashes.items():
        if name:
            needs, allows = parts[part][name].text(name), own[name].text(name)
            yield found(
                "never-selected", part, f"{part} needs {needs}, but its {component} {allows}"
            )


def _is_contradictory(values: Bounds) -> bool:
    return any(interval.is_empty for interval in values.values())


def _dominated(whole: Node) -> Iterator[Finding]:
    """Yield the parts that are never selected: a preferred one is feasible whenever they are."""
    ranked = sorted(whole.requires, key=_priority)
    offered = [(part, bounds(part)) for part in ranked[:PREFERRED]]
    for part in ranked:
        needed = _bounds_in_use(part)
        if _is_contradictory(needed):
            continue
        for one, own in offered:  # else a failure may rule out only the preferred one
            is_within = part.kind == "configuration" or set(one.requires) <= set(part.requires)
            easier = all(
                name in needed and interval.covers(needed[name]) for name, interval in own.items()
            )
            if _priority(one) < _priority(part) and is_within and easier:
                message = (
                    f"{part} of {whole} is never chosen: whenever it is feasible, so is {one.name}"
                )
                yield found("never-selected", part, f"{message}, which is preferred")
                break


def _estimated(model: Contents, network: Network) -> tuple[_Names, _Names]:
    """Return the attributes estimated for each element, alone and together with its parts."""
    directly: _Names = {}
    for one in model.estimations:
        directly.setdefault(network.find(one.causer), {})[one.attribute] = None
    estimated: _Names = {}
    for node in sorted(network.present(), key=lambda node: node.level) if directly else ():
        estimated[node] = dict(directly.get(node, {}))
        for part in node.requires:
            estimated[node] |= estimated.get(part, {})
    return directly, estimated


def _unevenly_estimated(
    whole: Node, by_part: _Names, directly: Mapping[str, None]
) -> Iterator[Finding]:
    for attribute in dict.fromkeys(name for names in by_part.values() for name in names):
        without = [part.name for part, names in by_part.items() if attribute not in names]
        if without and attribute not in directly:
            kind = whole.requires[0].kind
            message = f"{attribute} is estimated for some {kind}s of {whole} but not for {listing(without)}"
            yield found("missing-estimation", whole, message)
