"""The causal order of a plan: which step makes so what another one needs, and which must not come before another."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from rosa_pddl import Domain, State, Step
from rosa_pddl.domain import UpThing
from rosa_pddl.validate import binding_of, changes, mentioned_atoms

__all__ = ["CausalOrder", "Link", "causal_order"]


@dataclass(frozen=True)
class Link:
    """One step makes so what another one, or the goal, needs.

    Attributes:
        source: number of the step that makes it so, from 0.
        target: number of the one that needs it; the goal comes after the last step.
        needs: what is needed: atoms, or `(not ATOM)` for those that are false then.
    """

    source: int
    target: int
    needs: tuple[str, ...]


@dataclass(frozen=True)
class CausalOrder:
    """Why the steps of a plan come in their order; what it leaves open could come the other way round.

    Attributes:
        steps: the plan; the number after the last stands for the goal.
        links: which step needs which.
        orders: pairs (earlier, later) where the later step would spoil what the earlier one needs or does, as far as
            the links do not say so already.
    """

    steps: tuple[Step, ...]
    links: tuple[Link, ...]
    orders: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class _Part:
    """What a step, or the goal, looks at and really changes, and what is true before it."""

    needed: frozenset[str]
    changed: frozenset[str]
    before: State


def causal_order(domain: Domain, steps: Sequence[Step], state: State, goals: Iterable[UpThing]) -> CausalOrder:
    """Find out why the steps of a plan come in their order.

    Args:
        domain: what `load_domain` returned.
        steps: a plan that leads to the goal.
        state: the true atoms before it.
        goals: what shall hold, as unified-planning expressions.
    """
    facts = set(state)
    parts = [_replayed(domain, step, facts) for step in steps]
    parts.append(_Part(frozenset(mentioned_atoms(domain, goals, (), {})), frozenset(), frozenset(facts)))
    changer: dict[str, int] = {}
    touched: defaultdict[str, set[int]] = defaultdict(set)
    links: list[Link] = []
    threats: set[tuple[int, int]] = set()
    for number, part in enumerate(parts):
        causes: defaultdict[int, list[str]] = defaultdict(list)
        for atom in sorted(part.needed & changer.keys()):
            causes[changer[atom]].append(atom if atom in part.before else f"(not {atom})")
        links += [Link(source, number, tuple(atoms)) for source, atoms in sorted(causes.items())]
        threats |= {(earlier, number) for atom in part.changed for earlier in touched[atom]}
        changer |= dict.fromkeys(part.changed, number)
        for atom in part.needed | part.changed:
            touched[atom].add(number)
    return CausalOrder(tuple(steps), tuple(links), _told_only_here(links, threats, len(parts)))


def _replayed(domain: Domain, step: Step, facts: set[str]) -> _Part:
    """Let a step change the facts; returns what it looked at and changed."""
    before = frozenset(facts)
    schema, binding = domain.schema_of[step.schema], binding_of(domain, step)
    needed = set(mentioned_atoms(domain, schema.start, schema.start_effects, binding))
    changed = _changed(domain, schema.start_effects, binding, facts)
    later = set(mentioned_atoms(domain, schema.over_all + schema.end, schema.end_effects, binding))
    needed |= later - changed
    changed |= _changed(domain, schema.end_effects, binding, facts)
    return _Part(frozenset(needed), frozenset(changed), before)


def _changed(domain: Domain, effects: Iterable[UpThing], binding: Mapping[str, str], facts: set[str]) -> set[str]:
    gone, come = changes(domain, effects, binding, facts)
    changed = {atom for atom in gone - come if atom in facts} | {atom for atom in come if atom not in facts}
    facts -= gone
    facts |= come
    return changed


def _told_only_here(
    links: Iterable[Link], threats: Iterable[tuple[int, int]], count: int
) -> tuple[tuple[int, int], ...]:
    """Return the orders that no chain of links and other orders says already."""
    linked = {(link.source, link.target) for link in links}
    before: list[set[int]] = [set() for _ in range(count)]
    told: list[tuple[int, int]] = []
    for later in range(count):
        for source in {source for source, target in linked if target == later}:
            before[later] |= {source, *before[source]}
        # the latest first: what comes before it is then said already
        for earlier in sorted((one for one, other in threats if other == later), reverse=True):
            if earlier not in before[later]:
                told.append((earlier, later))
                before[later] |= {earlier, *before[earlier]}
    return tuple(sorted(told))
