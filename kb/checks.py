"""Checks of a model: names, what can never be feasible, and what is never selected."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from itertools import groupby, pairwise
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import Final

from kb.elements import KINDS, Attribute, Owner, RequiredActionFact, called, listed, text
from kb.exceptions import UnknownName
from kb.network import Network, Node
from kb.remedies import Interval, Requirements, bounds

QUICK: Final = 4
"""How many alternatives suffice to see that an element is possible."""
PREFERRED: Final = 32
"""The most preferred alternatives with which each one is compared."""


class Severity(StrEnum):
    """How bad a finding is: an error can never work, a warning is likely a mistake."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True, slots=True)
class Rule:
    """One check: the severity of its findings, what they mean, and what to do about them."""

    severity: Severity
    meaning: str
    advice: str


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a model that its author should look at.

    Attributes:
        code: the word for the rule, one of `rules()`.
        severity: how bad it is.
        element: kind and name, e.g. "function see"; for something that is not in the model, the
            given name.
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
        return f"{self.severity}: {self.where_and_what} [{self.code}]; {self.advice}"


@cache
def rules() -> Mapping[str, Rule]:
    """Return all rules by code, errors first."""
    import tomllib  # slow to import

    read = tomllib.loads(Path(__file__).with_name("checks.toml").read_text(encoding="utf-8"))
    return MappingProxyType(
        {
            code: Rule(Severity(row["severity"]), row["meaning"], row["advice"])
            for code, row in read.items()
        }
    )


def finding_of(code: str, element: object, message: str) -> Finding:
    rule = rules()[code]
    return Finding(code, rule.severity, str(element), message, rule.advice)


def listing(names: Iterable[str], most: int = 4) -> str:
    """Write names as a list with a limit, e.g. "a, b and c" or "a, b, c and 7 more"."""
    known = list(names)
    if len(known) > most:
        known = [*known[: most - 1], f"{len(known) - most + 1} more"]
    return " and ".join([", ".join(known[:-1]), known[-1]] if len(known) > 1 else known)


# ---------------------------------------------------------------- what is looked for


def check_model(model: Owner, names: Iterable[str] | None = None) -> tuple[Finding, ...]:
    """Check a model; see `Model.check`.

    Errors come first; the findings of a rule are in the order of the model.
    """
    network = Network(model)
    findings = [
        *(() if names is None else _mismatches(model.actions, listed("names", names))),
        *_contradictions(network),
        *_incomplete(network),
        *_unused(model, network),
        *_doubtful_choices(model, network),
        *_restored_twice(network),
        *(finding_of("file-note", f"model {model.name}", note) for note in model.notes),
    ]
    places = {
        f"{KINDS[type(element)]} {called(element)}": place
        for element, place in model.places.items()
    }
    placed = [replace(each, place=places.get(each.element, "")) for each in findings]
    return tuple(sorted(placed, key=lambda finding: finding.severity is not Severity.ERROR))


def _mismatches(actions: Collection[str], names: Iterable[str]) -> Iterator[Finding]:
    mentioned = dict.fromkeys(text("an action's name", name) for name in names)
    for name in mentioned:
        if name not in actions:
            yield finding_of("unknown-action", name, str(UnknownName("action", name, actions)))
    for name in actions:
        if name not in mentioned:
            what = f"action {name}"
            yield finding_of("unmentioned-action", what, f"{what} is mentioned nowhere")


def _incomplete(network: Network) -> Iterator[Finding]:
    for node in network.actions.values():
        if not node.requires:
            yield finding_of("action-without-functions", node, f"{node} requires no function")
    for node in network.designs.values():
        if not node.requires:
            message = f"{node} of {node.used_by[0]} has no component"
            yield finding_of("design-without-components", node, message)
    for node in network.attributes.values():
        for rate in node.attribute.rates:
            if rate.while_ and rate.while_ not in network.actions:
                unknown = UnknownName("action", rate.while_, network.actions)
                yield finding_of("unknown-action", node.name, f"a rate of {node.name}: {unknown}")


def _unused(model: Owner, network: Network) -> Iterator[Finding]:
    used = {estimation.attribute for estimation in model.estimations}
    for fact in model.facts:
        if isinstance(fact, RequiredActionFact):
            used.update(fact.preference or ())
    for node in network.attributes.values():
        if not node.constraints and node.name not in used:
            yield finding_of("unused-attribute", node, f"nothing depends on {node}")
    for table, nobody in (
        (network.functions, "no action requires"),
        (network.components, "no design uses"),
    ):
        for node in table.values():
            if not node.used_by:
                yield finding_of(f"unused-{node.kind}", node, f"{nobody} {node}")


def _restored_twice(network: Network) -> Iterator[Finding]:
    for node in (*network.attributes.values(), *network.components.values()):
        actions = [
            action.name
            for action in network.actions.values()
            if node.element in action.element.restores
        ]
        if len(actions) > 1:
            message = f"{node} is restored by actions {listing(actions)}"
            yield finding_of("restored-twice", node, message)


# ---------------------------------------------------------------- what is never possible


def _contradictions(network: Network) -> Iterator[Finding]:
    """Yield the elements that no measurement makes feasible, but only the roots.

    A finding names the actions that its root makes impossible; what is between has no findings.
    """
    quick = Requirements(limit=QUICK)
    impossible: dict[Node, None] = {}
    for node in network.present():
        is_element = node.kind not in ("attribute", "constraint")
        if is_element and not quick.of(node):
            requirements = Requirements()
            if not requirements.of(node) and requirements.are_all:
                impossible[node] = None
    for node in impossible:
        broken = [part in impossible for part in node.requires]
        is_consequence = any(broken) and (all(broken) or node.kind != "component")
        contradictions = list(_contradiction(node))
        for contradiction in contradictions:
            message = f"{node} is constrained by {contradiction}{_consequence(node, impossible)}"
            yield finding_of("contradictory-constraints", node, message)
        if node.kind == "function" and not broken:
            message = f"{node} has no design{_consequence(node, impossible)}"
            yield finding_of("function-without-designs", node, message)
        elif not contradictions and not is_consequence and node.kind != "function":
            conflict = f"{_conflict(node)}{_consequence(node, impossible)}"
            yield finding_of("never-feasible", node, f"{node} can never be feasible: {conflict}")


def _contradiction(node: Node) -> Iterator[str]:
    """Yield the own constraints of an element that leave no value of an attribute."""
    for attribute, interval in bounds(node).items():
        if interval.is_empty:
            own = [each.constraint for each in node.constraints]
            texts = [str(constraint) for constraint in own if constraint.attribute == attribute]
            yield f"{listing(texts)}, which no value satisfies"


def _consequence(node: Node, impossible: Collection[Node]) -> str:
    """Name the actions that can never be feasible because of an element."""
    actions: dict[str, None] = {}
    owners = {node: None}
    while owners:
        users = [user for owner in owners for user in owner.used_by if user in impossible]
        owners = dict.fromkeys(users)
        actions |= {user.name: None for user in owners if user.kind == "action"}
    return f", so action {listing(actions)} can never be feasible" if actions else ""


def _conflict(node: Node) -> str:
    """Name the needs of an element, with their intervals if there is only one way to meet them."""
    needs = [f"its own constraint {constraint.name}" for constraint in node.constraints]
    if node.kind == "component":
        needs.append("each of its configurations")
    for part in node.requires if node.kind != "component" else ():
        ways = Requirements().of(part)
        only = ways[0] if len(ways) == 1 else {}
        bounded = [only[what].text(what.name) for what in only if isinstance(what, Attribute)]
        needs.append(f"{part} ({' and '.join(bounded)})" if bounded else str(part))
    return f"{listing(needs, 8)} cannot be met together, whatever is measured"


# ---------------------------------------------------------------- what is never chosen


def _doubtful_choices(model: Owner, network: Network) -> Iterator[Finding]:
    """Yield ties, and what is never selected."""
    causers = {network.find(estimation.causer) for estimation in model.estimations}

    def is_estimated(node: Node) -> bool:
        return node in causers or any(map(is_estimated, node.requires))

    for owner in (*network.functions.values(), *network.components.values()):
        yield from _ties(owner)
        if not any(map(is_estimated, owner.requires)):  # else a preference may select it
            yield from _dominated(owner)


def _priority(node: Node) -> float:
    priority: float | None = node.element.priority
    return inf if priority is None else priority


def _bounds_in_use(part: Node) -> dict[str, Interval]:
    """Return the intervals that satisfy a choice and its components, by attribute."""
    return bounds(part, *(part.used_by if part.kind == "configuration" else part.requires))


def _ties(owner: Node) -> Iterator[Finding]:
    for priority, group in groupby(sorted(owner.requires, key=_priority), key=_priority):
        tied = list(group)
        alternatives = [_bounds_in_use(part) for part in tied]
        if len(tied) > 1 and not _exclude_one_another(alternatives):
            which = "no priority" if priority == inf else f"the same priority, {priority}"
            names = sorted(part.name for part in tied)
            what = f"{tied[0].kind}s {listing(names)} of {owner} have {which}"
            yield finding_of("tied-priorities", owner, f"{what}; {names[0]} comes first")


def _exclude_one_another(alternatives: Sequence[Mapping[str, Interval]]) -> bool:
    """Return whether an attribute allows only one of them at a time, so that a tie is harmless."""
    for attribute in alternatives[0]:
        intervals = sorted(each[attribute] for each in alternatives if attribute in each)
        overlaps = [not low.meet(high).is_empty for low, high in pairwise(intervals)]
        if len(intervals) == len(alternatives) and not any(overlaps):
            return True
    return False


def _dominated(owner: Node) -> Iterator[Finding]:
    """Yield the choices for which a preferred one is feasible whenever they are."""
    ranked = sorted(owner.requires, key=_priority)
    for part in ranked:
        needed = _bounds_in_use(part)
        is_possible = not any(interval.is_empty for interval in needed.values())
        for rival in ranked[:PREFERRED] if is_possible else ():
            # a failure must not rule out only the preferred one
            is_within = part.kind == "configuration" or set(rival.requires) <= set(part.requires)
            is_easier = all(
                name in needed and interval.covers(needed[name])
                for name, interval in bounds(rival).items()
            )
            if _priority(rival) < _priority(part) and is_within and is_easier:
                why = f"whenever it is feasible, so is {rival.name}, which is preferred"
                yield finding_of(
                    "never-selected", part, f"{part} of {owner} is never chosen: {why}"
                )
                break
