"""What must hold in every situation, and how a situation in which it does not is found."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from py_trees.behaviour import Behaviour
from py_trees.composites import Sequence as SequenceNode

from kb.elements import AttributeKind
from missions.proof.environment import STALE
from missions.proof.exploration import Exploration, Wrong
from missions.proof.rig import Predicate, Step
from rosa_bt import ForAction, RosaAction


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
    trail: tuple[Step, ...] | None = None
    advice: str = ""


@dataclass(frozen=True)
class Property:
    """A property of a user, made by `always`, `never`, `eventually` or `leads_to`."""

    name: str
    predicates: tuple[Predicate, ...]
    check: Callable[[Exploration], Wrong | None]


def always(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after every tick."""

    def check(explored: Exploration) -> Wrong | None:
        return explored.first(
            set(explored.every) - explored.holds[predicate], "it does not hold then"
        )

    return Property(name, (predicate,), check)


def never(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after no tick."""

    def check(explored: Exploration) -> Wrong | None:
        return explored.first(explored.holds[predicate], "it is so then")

    return Property(name, (predicate,), check)


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

    def check(explored: Exploration) -> Wrong | None:
        met = explored.holds[then]
        begun = sorted(explored.holds[first] & explored.caused())
        if within is None:
            good = explored.reaching(met.union(explored.unexplored))
            return explored.first(set(begun) - good, "it cannot come about any more")
        for number in begun:
            trail = explored.avoiding(number, met, within)
            if trail is not None:
                return "it has not come about in time", [*explored.path(number), *trail]
        return None

    return Property(name, (first, then), check)


def check(
    explored: Exploration,
    *,
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    wanted: Iterable[Property] = (),
) -> list[Finding]:
    """Check the properties that every mission must have, then those wanted; see `verify` for the arguments."""
    ticks = "a tick" if reaction == 1 else f"{reaction} ticks"
    groups = [set(group) for group in exclusive]
    goals = explored.goals & explored.caused()
    checked: list[tuple[str, Wrong | None]] = [
        (
            f"nothing is requested while unfeasible for longer than {ticks}",
            _unfeasible(explored, reaction),
        ),
        ("every request is released once, when what does it ends", _unreleased(explored)),
        ("actions that exclude each other are not required together", _together(explored, groups)),
        ("the goal is reached if all goes well", None if goals else ("it is never reached", None)),
        ("the mission ends with its goal only", _ends_without(explored)),
        (
            "wherever the goal can be reached as facts are, the mission is not stuck",
            _stuck(explored),
        ),
        ("it never stands still for good while an action of it is feasible", _dead(explored)),
        ("while nothing happens, the mission does not waver", _wavering(explored)),
        ("every node of the tree can be reached", _unreached(explored)),
        ("every adaptation of the model can occur", _missing(explored)),
        ("the manager keeps to the model, and ends its plans", _shortest(explored.faults.items())),
    ]
    checked += [(each.name, each.check(explored)) for each in wanted]
    return [_finding(name, bad, is_finished=explored.is_finished) for name, bad in checked]


def notes(explored: Exploration) -> tuple[str, ...]:
    """Return what is no mistake, but good to know."""
    rig = explored.rig
    done = _actions(explored)
    requesting = {leaf.name for leaf in rig.requesting}
    found = [f"{name} is not done by this tree" for name in rig.kb.actions if name not in done]
    found += [
        f"{name} requests actions by itself: its requests are followed"
        for name in sorted(requesting)
    ]
    return tuple(found if not requesting else found[-len(requesting) :])


def _finding(name: str, bad: Wrong | None, *, is_finished: bool) -> Finding:
    if bad is None or (bad[1] is None and not is_finished):
        return Finding(name, True if is_finished else None)
    what, trail = bad
    return Finding(name, False, what, None if trail is None else tuple(trail))


def _shortest(bad: Iterable[tuple[str, Sequence[Step]]]) -> Wrong | None:
    return min(bad, key=lambda each: len(each[1]), default=None)


def _actions(explored: Exploration) -> set[str]:
    return {node.action for node in explored.rig.doing}


def _unfeasible(explored: Exploration, reaction: int) -> Wrong | None:
    """Find a request that stays unfeasible during `reaction` consecutive ticks."""
    layer: dict[tuple[str, int], list[Step]] = {}
    for count in range(reaction):
        following: dict[tuple[str, int], list[Step]] = {}
        for number in explored.every if count == 0 else dict.fromkeys(place for _, place in layer):
            for each in explored.following(number):
                still = set(each.before.unfeasible) & set(explored.known[each.after].unfeasible)
                for action in sorted(still):
                    if count == 0 or (action, number) in layer:
                        trail = layer[action, number] if count else explored.path(number)
                        following.setdefault((action, each.after), [*trail, each.step])
        layer = following
    return _shortest(
        (f"{action} is still requested", trail) for (action, _), trail in layer.items()
    )


def _unreleased(explored: Exploration) -> Wrong | None:
    for number in explored.every:
        running = explored.doing[number].running
        for action in sorted(running ^ set(explored.known[number].required)):
            what = f"{action} is still requested, and nothing that does it runs"
            if action in running:
                what = f"{action} is not requested any more, and what does it still runs"
            return explored.first([number], what)
    return None


def _together(explored: Exploration, groups: Iterable[set[str]]) -> Wrong | None:
    for number in explored.every:
        for group in groups:
            both = group.intersection(explored.known[number].required)
            if len(both) > 1:
                return explored.first([number], f"{' and '.join(sorted(both))} are required")
    return None


def _ends_without(explored: Exploration) -> Wrong | None:
    """Find an end of the mission that is not its goal, by deeds that bring about what succeeds."""
    reached: dict[int, list[Step]] = {0: []}
    pending = [0]
    for number in pending:
        what = explored.misses(number) if number in explored.ended else ""
        if what:
            return what, reached[number]
        for each in explored.following(number):
            if each.is_caused and each.after not in reached:
                reached[each.after] = [*reached[number], each.step]
                pending.append(each.after)
    return None


def _stuck(explored: Exploration) -> Wrong | None:
    """Find a situation that leads to no end while facts stay, though another of its stage with equal facts does."""
    ended = {number for number in explored.every if explored.doing[number].is_over}
    good = explored.reaching((explored.goals | ended).union(explored.unexplored), still=True)
    here = [
        (explored.doing[number].stage, each.deeds, each.facts.failed, each.facts.values)
        for number, each in enumerate(explored.situations)
    ]
    reaching = explored.reaching(explored.goals, still=True) - explored.goals
    possible = {here[number] for number in reaching}
    bad = (number for number in explored.every if number not in good and here[number] in possible)
    return explored.first(bad, "it is not then, but elsewhere in this stage with the same facts")


def _dead(explored: Exploration) -> Wrong | None:
    """Find a situation in which nothing is ever required unless a fact changes that only the robot changes."""
    alive = {
        number
        for number in explored.every
        if explored.known[number].required or explored.doing[number].is_over
    }
    before: dict[int, list[int]] = {}
    for number in explored.every:
        for each in explored.following(number):
            if each.is_still:
                before.setdefault(each.after, []).append(number)
    pending = [*alive, *explored.unexplored]
    alive.update(pending)
    while pending:
        new = [number for number in before.get(pending.pop(), ()) if number not in alive]
        alive.update(new)
        pending += new
    for number in explored.every:
        able = _able(explored, explored.known[number].feasible)
        if number not in alive and able and not _waits(explored, number, alive):
            what = f"nothing is required, though {' and '.join(sorted(able))} could be done"
            return explored.first([number], what)
    return None


def _able(explored: Exploration, feasible: frozenset[str]) -> set[str]:
    """Return the feasible actions of the tree that are not behind an unfeasible one in a sequence."""
    able = set()
    for node in explored.rig.doing:
        before = [*_before(node)]
        if node.action in feasible and all(action in feasible for action in before):
            able.add(node.action)
    return able


def _before(node: Behaviour) -> Iterator[str]:
    """Yield the actions that stand before a node in sequences."""
    while (parent := node.parent) is not None:
        if isinstance(parent, SequenceNode):
            for child in parent.children[: parent.children.index(node)]:
                yield from (
                    each.action
                    for each in child.iterate()
                    if isinstance(each, RosaAction | ForAction)
                )
        node = parent


def _waits(explored: Exploration, number: int, alive: set[int]) -> bool:
    """Tell whether it goes on when a part recovers or a fact changes that changes by itself."""
    rig = explored.rig
    if {None, STALE}.intersection(explored.situations[number].facts.values):
        return True
    by_itself = set()
    for name, attribute in rig.kb.model.attributes.items():
        is_outside = attribute.kind is AttributeKind.ENVIRONMENTAL
        if is_outside or any(not rate.while_ for rate in attribute.rates):
            by_itself.add(name)
    for each in explored.following(number):
        changes = each.step.changes
        is_outside = all(change.to is False or change.name in by_itself for change in changes)
        if changes and is_outside and each.after in alive:
            return True
    return False


def _wavering(explored: Exploration) -> Wrong | None:
    """Find a cycle of different requests while all conditions keep their answer and every action keeps running."""
    for kept in "FS":
        onward: dict[int, tuple[Step, int]] = {}
        for number in explored.every:
            for each in explored.following(number):
                if each.is_still and all(
                    letter == ("R" if "R" in explored.rig.letters[name] else kept)
                    for name, letter in each.step.answers
                ):
                    onward.setdefault(number, (each.step, each.after))
        visited: set[int] = set()
        for number in onward:
            trail, cycle = _cycle(onward, number, visited)
            done = {", ".join(explored.known[place].required) or "nothing" for place in cycle}
            if len(done) > 1:
                what = f"it goes to and fro between {' and '.join(sorted(done))}"
                return what, [*explored.path(number), *trail]
    return None


def _cycle(
    onward: dict[int, tuple[Step, int]], start: int, visited: set[int]
) -> tuple[list[Step], list[int]]:
    """Return the rounds until a situation comes again, and the situations between the two."""
    trail: dict[int, Step] = {}
    place = start
    while place in onward and place not in visited:
        visited.add(place)
        trail[place], place = onward[place]
    places = list(trail)
    cycle = places[places.index(place) :] if place in trail else []
    return list(trail.values()), cycle


def _unreached(explored: Exploration) -> Wrong | None:
    rig = explored.rig
    names = dict.fromkeys(node.name for node in rig.nodes if node not in rig.ticked)
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(explored: Exploration) -> Wrong | None:
    names = list(_never(explored))
    return (f"never: {', '.join(names)}", None) if names else None


def _never(explored: Exploration) -> Iterator[str]:
    """Yield the actions of the tree, the designs and the configurations that never occur."""
    kb = explored.rig.kb
    before = [each.before for rounds in explored.rounds for each in rounds]
    occurring = frozenset().union(*(known.occurring for known in (*before, *explored.known)))
    for name in kb.actions:
        if name in _actions(explored) and ("action", name) not in occurring:
            yield f"action {name}"
    if explored.rig.environment.failures:  # without failures, what is there for them cannot occur
        for kind, table in (("function design", kb.designs), ("configuration", kb.configurations)):
            for name in table:
                if (kind, name) not in occurring:
                    yield f"{kind} {name}"
