"""What must hold in every situation, and how a situation in which it does not is found."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.composites import Sequence as SequenceNode

from missions.proof.exploration import Exploration, Round, Wrong
from missions.proof.rig import Step, acting
from missions.proof.setup import Predicate


@dataclass(frozen=True)
class Finding:
    """Whether something holds.

    Attributes:
        name: what should hold.
        holds: None if it holds in all that was explored, but that was not everything.
        what: what is wrong, in words; empty if it holds.
        trail: the rounds that lead there; None if no single story shows it.
        advice: what to write instead, if that was tried and verifies.
    """

    name: str
    holds: bool | None
    what: str = ""
    trail: Sequence[Step] | None = None
    advice: str = ""


class Property(NamedTuple):
    """A property of a user, made by `always`, `never`, `eventually` or `leads_to`."""

    name: str
    check: Callable[[Exploration], Wrong | None]
    predicates: tuple[Predicate, ...]


def always(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after every tick."""
    return never(name, lambda rig: not predicate(rig))


def never(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after no tick."""

    def check(explored: Exploration) -> Wrong | None:
        return explored.first(explored.holds[predicate], "it is violated then")

    return Property(name, check, (predicate,))


def eventually(name: str, predicate: Predicate) -> Property:
    """Require that a predicate can still come to hold from every situation."""
    return leads_to(name, lambda rig: True, predicate)


def leads_to(name: str, first: Predicate, then: Predicate) -> Property:
    """Require that `then` can still come to hold whenever `first` holds."""

    def check(explored: Exploration) -> Wrong | None:
        good = explored.reaching(explored.holds[then].union(explored.unexplored))
        begun = explored.holds[first].intersection(explored.caused())
        return explored.first(begun - good, "it cannot come about any more")

    return Property(name, check, (first, then))


def check(explored: Exploration) -> list[Finding]:
    """Check the properties that every mission must have, then those wanted."""
    findings = []
    own = {each.name: each.check for each in explored.rig.setup.wanted}
    for name, find in {**CHECKS, **own}.items():
        what, trail = find(explored) or ("", None)
        holds = None if trail is None and not explored.is_finished else not what
        findings.append(Finding(name, holds, what if holds is False else "", trail))
    return findings


def notes(explored: Exploration) -> list[str]:
    """Return what is no mistake, but good to know."""
    rig = explored.rig
    requesting = sorted({leaf.name for leaf in rig.requesting})
    if requesting:
        return [
            f"{name} requests actions by itself: its requests are followed" for name in requesting
        ]
    done = {node.action for node in rig.doing}
    return [f"{name} is not done by this tree" for name in rig.kb.actions if name not in done]


def _unfeasible(explored: Exploration) -> Wrong | None:
    for number, rounds in enumerate(explored.rounds):
        for each in rounds:
            for action in sorted({*each.late} & {*explored.seen[each.after].unfeasible}):
                return f"{action} is still requested", [*explored.path(number), each.step]
    return None


def _unreleased(explored: Exploration) -> Wrong | None:
    for number, seen in enumerate(explored.seen):
        for action in sorted(seen.running ^ {*seen.required}):
            what = f"{action} is still requested, and nothing that does it runs"
            if action in seen.running:
                what = f"{action} is not requested any more, and what does it still runs"
            return what, explored.path(number)
    return None


def _unachieved(explored: Exploration) -> Wrong | None:
    return None if explored.goals.intersection(explored.caused()) else ("it is never reached", None)


def _ends_without(explored: Exploration) -> Wrong | None:
    """Find an end of the mission that is not its goal, by deeds that bring about what succeeds."""
    for number in explored.caused():
        if explored.seen[number].has_succeeded and (what := explored.misses(number)):
            return what, explored.path(number)
    return None


def _stuck(explored: Exploration) -> Wrong | None:
    """Find a situation without an end while facts stay, though its stage has an end."""
    ended = {number for number, seen in enumerate(explored.seen) if seen.has_succeeded}
    good = explored.reaching(ended.union(explored.goals, explored.unexplored), still=True)
    here = [
        (seen.stage, each.deeds, each.facts.failed, each.facts.values)
        for seen, each in zip(explored.seen, explored.situations, strict=True)
    ]
    reaching = explored.reaching(explored.goals, still=True) - explored.goals
    possible = {here[number] for number in reaching}
    bad = {number for number, each in enumerate(here) if each in possible}
    return explored.first(
        bad - good, "it is not then, but elsewhere in this stage with the same facts"
    )


def _dead(explored: Exploration) -> Wrong | None:
    """Find a situation in which nothing is required until the robot itself acts."""
    active = {n for n, seen in enumerate(explored.seen) if seen.required or seen.has_succeeded}
    alive = explored.reaching(active.union(explored.unexplored), still=True)
    for number, seen in enumerate(explored.seen):
        able = sorted(_able(explored, seen.feasible))
        if number not in alive and able and not _waits(explored, number, alive):
            what = f"nothing is required, though {' and '.join(able)} could be done"
            return what, explored.path(number)
    return None


def _able(explored: Exploration, feasible: frozenset[str]) -> set[str]:
    """Return the feasible actions that are not behind an unfeasible one in a sequence."""
    doing = explored.rig.doing
    return {node.action for node in doing if feasible.issuperset([node.action, *_before(node)])}


def _before(node: Behaviour) -> Iterator[str]:
    """Yield the actions that stand before a node in sequences."""
    while (parent := node.parent) is not None:
        if isinstance(parent, SequenceNode):
            for child in parent.children[: parent.children.index(node)]:
                yield from (each.action for each in acting(child.iterate()))
        node = parent


def _waits(explored: Exploration, number: int, alive: set[int]) -> bool:
    """Tell whether it goes on when a part recovers or a fact changes that changes by itself."""
    if None in dict(explored.situations[number].facts.values).values():
        return True
    rig = explored.rig
    for each in explored.rounds[number]:
        changes = each.step.changes
        is_outside = all(to is False or not rig.is_kept(name) for name, to in changes)
        if changes and is_outside and each.after in alive:
            return True
    return False


def _wavering(explored: Exploration) -> Wrong | None:
    """Find a cycle of different requests while no answer changes."""
    letters = explored.rig.letters
    for kept in "FS":
        onward: dict[int, Round] = {}
        for number, rounds in enumerate(explored.rounds):
            for each in rounds:
                answers = each.step.answers
                usual = ["R" if "R" in letters[name] else kept for name, _ in answers]
                if not each.step.changes and [letter for _, letter in answers] == usual:
                    onward.setdefault(number, each)
        visited: set[int] = set()
        for number in onward:
            trail: dict[int, Step] = {}
            place = number
            while place in onward and place not in visited:
                visited.add(place)
                trail[place] = onward[place].step
                place = onward[place].after
            places = [*trail]
            cycle = places[places.index(place) :] if place in trail else []
            done = {", ".join(explored.seen[each].required) or "nothing" for each in cycle}
            if len(done) > 1:
                what = f"it goes to and fro between {' and '.join(sorted(done))}"
                return what, [*explored.path(number), *trail.values()]
    return None


def _unreached(explored: Exploration) -> Wrong | None:
    rig = explored.rig
    names = dict.fromkeys(node.name for node in rig.nodes if node not in rig.ticked)
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(explored: Exploration) -> Wrong | None:
    """Find the actions of the tree, the designs and the configurations that never occur."""
    rig = explored.rig
    occurring = explored.occurring
    expected = [("action", node.action) for node in rig.doing]
    # without failures, what is there for them cannot occur; what leaves measure and choose neither
    if rig.setup.failures and not rig.environment.told:
        expected += [("function design", name) for name in rig.kb.designs]
        expected += [("configuration", name) for name in rig.kb.configurations]
    missing = [f"{kind} {name}" for kind, name in expected if (kind, name) not in occurring]
    return (f"never: {', '.join(dict.fromkeys(missing))}", None) if missing else None


def _mismanaged(explored: Exploration) -> Wrong | None:
    return min(explored.faults.items(), key=lambda fault: len(fault[1]), default=None)


CHECKS: Final[dict[str, Callable[[Exploration], Wrong | None]]] = {
    "nothing is requested while unfeasible for longer than a tick": _unfeasible,
    "every request is released once, when what does it ends": _unreleased,
    "the goal is reached if all goes well": _unachieved,
    "the mission ends with its goal only": _ends_without,
    "wherever the goal can be reached as facts are, the mission is not stuck": _stuck,
    "it never stands still for good while an action of it is feasible": _dead,
    "while nothing happens, the mission does not waver": _wavering,
    "every node of the tree can be reached": _unreached,
    "every adaptation of the model can occur": _missing,
    "the manager keeps to the model, and ends its plans": _mismanaged,
}
"""What every mission must keep, and how a violation is found."""
