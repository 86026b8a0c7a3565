"""Which atoms exclude one another: groups of which at most one holds, found by what operators do to them.

A group is made of one predicate: all of its arguments but one, which is counted, or all of them, name the group. It is
kept if no operator adds an atom to a group without taking one away (Helmert, "Concise finite-domain representations for
PDDL planning tasks", AIJ 173, 2009; here on what is grounded, and without groups of several predicates).
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple, TypeAlias

Atom: TypeAlias = tuple[str, ...]
"""A predicate and its arguments."""


class Change(NamedTuple):
    """What an operator needs, what it may add, and what it deletes for certain."""

    needs: frozenset[Atom]
    adds: tuple[Atom, ...]
    deletes: frozenset[Atom]


def groups(changes: Sequence[Change], states: Sequence[Iterable[Atom]], atoms: Iterable[Atom]) -> list[list[Atom]]:
    """Return groups of atoms of which at most one holds in each of some states and all that follow; largest first."""
    by_name: dict[str, list[Atom]] = {}
    for atom in atoms:
        by_name.setdefault(atom[0], []).append(atom)
    possible: list[list[Atom]] = []
    for name, members in by_name.items():
        for counted in range(1, len(members[0])):
            if all(_is_balanced(name, counted, change) for change in changes):
                of_key: dict[Atom, list[Atom]] = {}
                for atom in members:
                    of_key.setdefault(_key(counted, atom), []).append(atom)
                held = [Counter(_key(counted, atom) for atom in state if atom[0] == name) for state in states]
                several = {key for keys in held for key, count in keys.items() if count > 1}
                possible += [group for key, group in of_key.items() if key not in several]
    return _chosen(possible)


def _is_balanced(name: str, counted: int, change: Change) -> bool:
    """Whether an operator adds at most one atom to each group, and only in place of one that it needs and deletes."""
    kept = change.needs - change.deletes
    added = [_key(counted, atom) for atom in change.adds if atom[0] == name and atom not in kept]
    if not added:
        return True
    freed = {_key(counted, atom) for atom in change.needs & change.deletes if atom[0] == name}
    return len(set(added)) == len(added) and freed.issuperset(added)


def _key(counted: int, atom: Atom) -> Atom:
    return atom[:counted] + atom[counted + 1 :]


def _chosen(possible: Sequence[list[Atom]]) -> list[list[Atom]]:
    """Choose groups, the largest first, until no two atoms are left that one of them holds."""
    chosen, taken = list[list[Atom]](), set[Atom]()
    queue = [(-len(group), number) for number, group in enumerate(possible)]
    heapify(queue)
    while queue:
        size, number = heappop(queue)
        group = [atom for atom in possible[number] if atom not in taken]
        if len(group) > 1 and len(group) < -size:  # others took some of it
            heappush(queue, (-len(group), number))
        elif len(group) > 1:
            chosen.append(group)
            taken.update(group)
    return chosen
