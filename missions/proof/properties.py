"""Check properties of all that was explored; one that is broken comes with the fewest rounds that lead there."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

from missions.proof.exploration import Exploration, Wrong
from missions.proof.planned import nodes
from missions.proof.rig import Predicate
from missions.proof.rounds import Step


@dataclass(frozen=True)
class Finding:
    """Whether something holds.

    Attributes:
        name: what should hold.
        holds: None if it holds in all that was explored, but that was not everything.
        what: what is wrong, in words; empty if it holds.
        trail: the rounds that lead there; None if no single story shows it.
    """

    name: str
    holds: bool | None
    what: str = ""
    trail: tuple[Step, ...] | None = None


@dataclass(frozen=True)
class Property:
    """A property of a user, made by `always`, `never`, `eventually` or `leads_to`."""

    name: str
    predicates: tuple[Predicate, ...]
    check: Callable[[Exploration], Wrong | None]


def always(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after every tick."""

    def check(found: Exploration) -> Wrong | None:
        return found.first(set(found.every) - found.holds[predicate], "it does not hold then")

    return Property(name, (predicate,), check)


def never(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after no tick."""
    return Property(name, (predicate,), lambda found: found.first(found.holds[predicate], "it is so then"))


def eventually(name: str, predicate: Predicate) -> Property:
    """Require that a predicate can still come to hold from every situation."""
    return leads_to(name, lambda rig: True, predicate)


def leads_to(name: str, first: Predicate, then: Predicate, within: int | None = None) -> Property:
    """Require that `then` follows whenever `first` holds.

    Args:
        name: in words.
        first: the predicate that it follows.
        then: the predicate that has to follow.
        within: after this many ticks at most, whatever happens; None: it only has to be possible.
    """

    def check(found: Exploration) -> Wrong | None:
        met, begun = found.holds[then], sorted(found.holds[first])
        if within is None:
            good = found.reaching(met.union(found.unexplored))
            return found.first(set(begun) - good, "it cannot come about any more")
        trails = ((number, found.avoiding(number, met, within)) for number in begun)
        late = next(((number, trail) for number, trail in trails if trail is not None), None)
        return None if late is None else ("it has not come about in time", [*found.path(late[0]), *late[1]])

    return Property(name, (first, then), check)


def check(
    found: Exploration,
    *,
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    wanted: Iterable[Property] = (),
) -> list[Finding]:
    """Check the properties that every mission must have, then those wanted; see `verify` for the arguments."""
    ticks = "a tick" if reaction == 1 else f"{reaction} ticks"
    wrong: list[tuple[str, Wrong | None]] = [
        (f"nothing is requested while unfeasible for longer than {ticks}", _unfeasible(found, reaction)),
        ("every request is released once, when what does it ends", _unreleased(found)),
        ("actions that exclude each other are not required together", _together(found, [*map(set, exclusive)])),
        ("the goal is reached if all goes well", None if found.goals else ("it is never reached", None)),
        ("wherever the goal can be reached as facts are, the mission is not stuck", _stuck(found)),
        ("while nothing happens, the mission does not waver", _wavering(found)),
        ("every node of the tree can be reached", _unreached(found)),
        ("every adaptation of the model can occur", _missing(found)),
        ("the manager keeps to the model and its budgets, and ends its plans", _shortest(found.faults.items())),
        *((one.name, one.check(found)) for one in wanted),
    ]
    return [_finding(name, bad, is_finished=found.is_finished) for name, bad in wrong]


def _finding(name: str, bad: Wrong | None, *, is_finished: bool) -> Finding:
    if bad is None or (bad[1] is None and not is_finished):
        return Finding(name, True if is_finished else None)
    return Finding(name, False, bad[0], None if bad[1] is None else tuple(bad[1]))


def _shortest(bad: Iterable[tuple[str, Sequence[Step]]]) -> Wrong | None:
    return min(bad, key=lambda one: len(one[1]), default=None)


def _unfeasible(found: Exploration, reaction: int) -> Wrong | None:
    """Find a request that stays unfeasible during `reaction` consecutive ticks."""
    layer: dict[tuple[str, int], list[Step]] = {}
    for count in range(reaction):
        following: dict[tuple[str, int], list[Step]] = {}
        for number in found.every if not count else dict.fromkeys(number for _, number in layer):
            for step, facts, after in found.following(number):
                both = facts.unfeasible
                for action in both and set(both).intersection(found.states[after].facts.unfeasible):
                    if not count or (action, number) in layer:
                        way = layer[action, number] if count else found.path(number)
                        following.setdefault((action, after), [*way, step])
        layer = following
    return _shortest((f"{action} is still requested", trail) for (action, _), trail in layer.items())


def _unreleased(found: Exploration) -> Wrong | None:
    for number, (doing, known, _) in enumerate(found.states):
        for action in sorted(doing.running ^ set(known.required)):
            is_running = "is not requested any more, and what does it still runs"
            is_left = "is still requested, and nothing that does it runs"
            return found.first([number], f"{action} {is_running if action in doing.running else is_left}")
    return None


def _together(found: Exploration, groups: Iterable[set[str]]) -> Wrong | None:
    for number, (_, known, _) in enumerate(found.states):
        for both in (group.intersection(known.required) for group in groups):
            if len(both) > 1:
                return found.first([number], f"{' and '.join(sorted(both))} are required")
    return None


def _stuck(found: Exploration) -> Wrong | None:
    """Find a situation that leads to no end while facts stay, though another of its stage with equal facts does."""
    ended = {one for one in found.every if found.states[one].doing.is_over}
    good = found.reaching((found.goals | ended).union(found.unexplored), still=True)
    here = [(doing.stage, known.failed, known.values, known.feasible) for doing, known, _ in found.states]
    possible = {here[number] for number in found.reaching(found.goals, still=True).difference(found.goals)}
    bad = (one for one in found.every if one not in good and here[one] in possible)
    return found.first(bad, "it is not then, but elsewhere in this stage with the same facts")


def _wavering(found: Exploration) -> Wrong | None:
    """Find a cycle of different requests while all conditions keep their answer and every action keeps running."""
    for held in "FS":
        onward: dict[int, tuple[Step, int]] = {}
        for number in found.every:
            for step, _, after in found.following(number, still=True):
                if all(letter == ("R" if "R" in found.rig.letters[name] else held) for name, letter in step.answers):
                    onward.setdefault(number, (step, after))
        for number in onward:
            at, trail, places = number, list[Step](), {number: 0}
            while at in onward:
                step, at = onward[at]
                trail.append(step)
                if places.setdefault(at, len(trail)) < len(trail):
                    break
            cycle = [one for one, place in places.items() if at in onward and place >= places[at]]
            done = {", ".join(found.states[one].facts.required) or "nothing" for one in cycle}
            if len(done) > 1:
                return f"it goes to and fro between {' and '.join(sorted(done))}", [*found.path(number), *trail]
    return None


def _unreached(found: Exploration) -> Wrong | None:
    missing = [one.name for one in found.rig.root.iterate() if one not in found.rig.ticked]
    ticked = {one.name for one in found.rig.ticked}  # of the steps of plans, one of each name is enough
    names = dict.fromkeys([*missing, *(one.name for one in nodes(found.rig.root) if one.name not in ticked)])
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(found: Exploration) -> Wrong | None:
    kb, occurring = found.rig.kb, found.occurring
    tables: dict[str, Iterable[str]] = {"action": kb.actions}
    if found.rig.surroundings.failures:  # without failures, what is there for them cannot occur
        tables |= {"function design": kb.designs, "configuration": kb.configurations}
    names = [f"{kind} {name}" for kind, table in tables.items() for name in table if (kind, name) not in occurring]
    return (f"never: {', '.join(names)}", None) if names else None
