"""Which atoms exclude one another: groups of which at most one holds, found by what operators do to them.

A candidate says for some predicates which of their arguments name the group, and which one, if any, is counted; it is
kept if no operator adds an atom to a group without taking one away, and is refined if another predicate would balance
it (Helmert, "Concise finite-domain representations for PDDL planning tasks", AIJ 173, 2009; here on what is grounded).
"""

from collections.abc import Iterable, Mapping, Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple, TypeAlias

Atom: TypeAlias = tuple[str, ...]
"""A predicate and its arguments."""
Part: TypeAlias = tuple[str, tuple[int, ...]]
"""A predicate, and at which places the arguments stand that name the group, in their order."""
_Candidate: TypeAlias = frozenset[Part]

_MOST_CANDIDATES = 200


class Change(NamedTuple):
    """What an operator needs, adds and deletes for certain, and what else it may add."""

    needs: frozenset[Atom]
    adds: tuple[Atom, ...]
    deletes: frozenset[Atom]


def groups(changes: Sequence[Change], states: Sequence[Iterable[Atom]], atoms: Iterable[Atom]) -> list[list[Atom]]:
    """Return groups of atoms of which at most one holds in each of some states and all that follow; largest first."""
    waiting: list[_Candidate] = []
    for name, arity in dict.fromkeys((atom[0], len(atom) - 1) for atom in atoms):
        waiting += [
            frozenset({(name, tuple(place for place in range(arity) if place != counted))})
            for counted in range(-1, arity)
        ]
    found: dict[_Candidate, None] = {}
    seen = set(waiting)
    for candidate in waiting:
        better = _unbalanced(dict(candidate), changes)
        if better is None:
            found[candidate] = None
            continue
        fresh = [one for one in better if one not in seen][: _MOST_CANDIDATES - len(seen)]
        seen.update(fresh)
        waiting += fresh
    return _covered(found, [list(state) for state in states], list(atoms))


def _unbalanced(parts: Mapping[str, tuple[int, ...]], changes: Sequence[Change]) -> list[_Candidate] | None:
    """Return None if every operator keeps the balance, else the candidates that may mend what the first one spoils."""
    for change in changes:
        if all(atom[0] not in parts for atom in change.adds):
            continue
        grown: dict[Atom, Atom] = {}
        for atom in change.adds:
            key = _key(parts, atom)
            if key is not None and atom not in change.needs:
                if key in grown:
                    return []
                grown[key] = atom
        freed = {_key(parts, atom) for atom in change.needs & change.deletes}
        for key in grown:
            if key not in freed:
                return _refined(parts, key, change)
    return None


def _refined(parts: Mapping[str, tuple[int, ...]], key: Atom, change: Change) -> list[_Candidate]:
    found = []
    for atom in sorted(change.needs & change.deletes):
        places = tuple(atom.index(word, 1) - 1 for word in key if word in atom[1:])
        left = len(atom) - 1 - len(set(places))
        if atom[0] not in parts and len(places) == len(key) == len(set(places)) and left <= 1:
            found.append(frozenset({*parts.items(), (atom[0], places)}))
    return found


def _key(parts: Mapping[str, tuple[int, ...]], atom: Atom) -> Atom | None:
    places = parts.get(atom[0])
    return None if places is None else tuple([atom[place + 1] for place in places])


def _covered(found: Iterable[_Candidate], states: Sequence[Sequence[Atom]], atoms: Sequence[Atom]) -> list[list[Atom]]:
    """Choose groups, the largest first, until no two atoms are left that one of them holds."""
    possible: list[list[Atom]] = []
    for candidate in found:
        parts, members = dict(candidate), dict[Atom, list[Atom]]()
        for atom in atoms:
            key = _key(parts, atom)
            if key is not None:
                members.setdefault(key, []).append(atom)
        for state in states:
            held = set[Atom]()
            for atom in state:
                key = _key(parts, atom)
                if key in held and key is not None:
                    members.pop(key, None)
                elif key is not None:
                    held.add(key)
        possible += members.values()
    chosen, left = list[list[Atom]](), set(atoms)
    queue = [(-len(group), number) for number, group in enumerate(possible)]
    heapify(queue)
    while queue:
        size, number = heappop(queue)
        group = [atom for atom in possible[number] if atom in left]
        if len(group) > 1 and len(group) < -size:  # others took some of it
            heappush(queue, (-len(group), number))
        elif len(group) > 1:
            chosen.append(group)
            left -= set(group)
    return chosen
