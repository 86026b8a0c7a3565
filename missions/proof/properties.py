"""What holds in everything that was explored, and if it does not, the fewest rounds that lead to where it does not."""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from missions.proof.exploration import Exploration
from missions.proof.planned import nodes
from missions.proof.rig import Predicate
from missions.proof.rounds import Situation, Step

Wrong = tuple[str, Sequence[Step] | None]
"""What is wrong, in words, and the rounds that lead there, if a story shows it."""


@dataclass(frozen=True)
class Finding:
    """Whether something holds.

    Attributes:
        name: what should hold.
        holds: None if it held as far as was explored, which was not everything.
        what: what is wrong, in words; empty if it holds.
        trail: the rounds that lead there; None where no single story shows it.
    """

    name: str
    holds: bool | None
    what: str = ""
    trail: tuple[Step, ...] | None = None


@dataclass(frozen=True)
class Property:
    """What a user wants to hold, made by `always`, `never`, `eventually` or `leads_to`."""

    name: str
    predicates: tuple[Predicate, ...]
    check: "Callable[[Graph], Wrong | None]"


def always(name: str, predicate: Predicate) -> Property:
    """Want something to hold after every tick."""

    def check(graph: "Graph") -> Wrong | None:
        bad = next((one for one in graph.every if one not in graph.found.holds[predicate]), None)
        return None if bad is None else ("it does not hold then", graph.found.path(bad))

    return Property(name, (predicate,), check)


def never(name: str, predicate: Predicate) -> Property:
    """Want something not to hold after any tick."""

    def check(graph: "Graph") -> Wrong | None:
        bad = min(graph.found.holds[predicate], default=None)
        return None if bad is None else ("it is so then", graph.found.path(bad))

    return Property(name, (predicate,), check)


def eventually(name: str, predicate: Predicate) -> Property:
    """Want something to be able to come about still, wherever the mission has got to."""
    return leads_to(name, lambda rig: True, predicate)


def leads_to(name: str, first: Predicate, then: Predicate, within: int | None = None) -> Property:
    """Want something to follow whenever something else holds.

    Args:
        name: in words.
        first: what it follows.
        then: what follows.
        within: in how many ticks at most, whatever happens; None: it can still come about.
    """

    def check(graph: "Graph") -> Wrong | None:
        met, begun = graph.found.holds[then], sorted(graph.found.holds[first])
        if within is None:
            good = graph.reaching(met.union(graph.found.unexplored))
            bad = next((one for one in begun if one not in good), None)
            return None if bad is None else ("it cannot come about any more", graph.found.path(bad))
        trails = ((number, graph.avoiding(number, met, within)) for number in begun)
        late = next(((number, trail) for number, trail in trails if trail is not None), None)
        return None if late is None else ("it has not come about in time", [*graph.found.path(late[0]), *late[1]])

    return Property(name, (first, then), check)


class Graph:
    """What was explored, with the questions that properties ask of it."""

    def __init__(self, found: Exploration, goal: Predicate | None = None) -> None:
        self.goal = goal
        self.found, self.every = found, range(len(found.situations))
        ended = (one for one in self.every if found.doing[found.situations[one].tree].status == "SUCCESS")
        self.goals = set(ended) if goal is None else found.holds[goal]

    def following(self, number: int, *, still: bool = False) -> Iterator[tuple[Step, Situation, int]]:
        """Yield each round that may follow, its moment and where it leads; if still, those in which nothing happens."""
        for one in self.found.following(number):
            if not still or not (one[0].changes or any(one[0].late)):
                yield one

    def reaching(
        self, wanted: Collection[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the situations from which one of those that are wanted can be reached, those included."""
        before: defaultdict[int, list[int]] = defaultdict(list)
        for number in self.every if within is None else within:
            for _, _, after in self.following(number, still=still):
                if within is None or after in within:
                    before[after].append(number)
        reached, pending = set(wanted), list(wanted)
        while pending:
            new = [one for one in before[pending.pop()] if one not in reached]
            reached.update(new)
            pending += new
        return reached

    def avoiding(self, number: int, wanted: Collection[int], rounds: int) -> list[Step] | None:
        """Return rounds after which nothing that is wanted was reached; None if there are no such."""
        layer: dict[int, list[Step]] = {} if number in wanted else {number: []}
        for _ in range(rounds):
            onward = [(trail, *one) for number, trail in layer.items() for one in self.following(number)]
            layer = {after: [*trail, step] for trail, step, _, after in reversed(onward) if after not in wanted}
        return next(iter(layer.values()), None)


def check(
    found: Exploration,
    *,
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    wanted: Iterable[Property] = (),
) -> list[Finding]:
    """Return what holds of an exploration, what everybody wants first; see `verify`."""
    graph = Graph(found, goal)
    ticks = "a tick" if reaction == 1 else f"{reaction} ticks"
    groups = [set(one) for one in exclusive]
    wrong: list[tuple[str, Wrong | None]] = [
        (f"nothing is requested while unfeasible for longer than {ticks}", _unfeasible(graph, reaction)),
        ("every request is released once, when what does it ends", _unreleased(found)),
        ("actions that exclude each other are not required together", _together(found, groups)),
        ("the goal is reached if all goes well", None if graph.goals else ("it is never reached", None)),
        ("wherever the goal can be reached as facts are, the mission is not stuck", _stuck(graph)),
        ("while nothing happens, the mission does not waver", _wavering(graph)),
        ("every node of the tree can be reached", _unreached(found)),
        ("every adaptation of the model can occur", _missing(found)),
        ("the manager keeps to the model and its budgets, and ends its plans", _shortest(found.faults.items())),
        *((one.name, one.check(graph)) for one in wanted),
    ]
    return [_finding(name, bad, is_finished=found.is_finished) for name, bad in wrong]


def _finding(name: str, bad: Wrong | None, *, is_finished: bool) -> Finding:
    if bad is None or (bad[1] is None and not is_finished):
        return Finding(name, True if is_finished else None)
    return Finding(name, False, bad[0], None if bad[1] is None else tuple(bad[1]))


def _shortest(bad: Iterable[tuple[str, Sequence[Step]]]) -> Wrong | None:
    return min(bad, key=lambda one: len(one[1]), default=None)


def _unfeasible(graph: Graph, reaction: int) -> Wrong | None:
    """Look for a request that is unfeasible before and after so many ticks in a row."""
    found = graph.found
    layer: dict[tuple[str, int], list[Step]] = {}
    for count in range(reaction):
        following: dict[tuple[str, int], list[Step]] = {}
        for number in graph.every if not count else dict.fromkeys(number for _, number in layer):
            for step, moment, after in graph.following(number):
                both = found.known[moment.known].unfeasible
                for action in both and set(both).intersection(found.known[found.situations[after].known].unfeasible):
                    if not count or (action, number) in layer:
                        way = layer[action, number] if count else found.path(number)
                        following.setdefault((action, after), [*way, step])
        layer = following
    return _shortest((f"{action} is still requested", trail) for (action, _), trail in layer.items())


def _unreleased(found: Exploration) -> Wrong | None:
    for number, (tree, known) in enumerate(found.situations):
        running = found.doing[tree].running
        for action in sorted(running ^ set(found.known[known].required)):
            is_running = "is not requested any more, and what does it still runs"
            is_left = "is still requested, and nothing that does it runs"
            return f"{action} {is_running if action in running else is_left}", found.path(number)
    return None


def _together(found: Exploration, groups: Iterable[set[str]]) -> Wrong | None:
    for number, (_, known) in enumerate(found.situations):
        for both in (group.intersection(found.known[known].required) for group in groups):
            if len(both) > 1:
                return f"{' and '.join(sorted(both))} are required", found.path(number)
    return None


def _stuck(graph: Graph) -> Wrong | None:
    """Look for a situation that does not lead to the end while facts stand, though another of its stage does."""
    found = graph.found
    ended = {one for one in graph.every if found.doing[found.situations[one].tree].is_over}
    good = graph.reaching((graph.goals | ended).union(found.unexplored), still=True)
    both = [(found.doing[tree], found.known[known]) for tree, known in found.situations]
    here = [(doing.stage, known.failed, known.values, known.feasible) for doing, known in both]
    possible = {here[number] for number in graph.reaching(graph.goals, still=True).difference(graph.goals)}
    bad = next((one for one in graph.every if one not in good and here[one] in possible), None)
    return None if bad is None else ("it is not then, but elsewhere in this stage with the same facts", found.path(bad))


def _wavering(graph: Graph) -> Wrong | None:
    """Follow what happens while conditions stay what they are and every action goes on: requests come to rest."""
    found = graph.found
    for held in "FS":
        onward: dict[int, tuple[Step, int]] = {}
        for number in graph.every:
            for step, _, after in graph.following(number, still=True):
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
            done = {", ".join(found.known[found.situations[one].known].required) or "nothing" for one in cycle}
            if len(done) > 1:
                return f"it goes to and fro between {' and '.join(sorted(done))}", [*found.path(number), *trail]
    return None


def _unreached(found: Exploration) -> Wrong | None:
    missing = [one.name for one in found.rig.root.iterate() if one not in found.rig.ticked]
    ticked = {one.name for one in found.rig.ticked}  # of the steps of plans one of each kind will do
    names = dict.fromkeys([*missing, *(one.name for one in nodes(found.rig.root) if one.name not in ticked)])
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(found: Exploration) -> Wrong | None:
    kb, occurring = found.rig.kb, {pair for one in found.known.values() for pair in one.occurring}
    tables: dict[str, Iterable[str]] = {"action": kb.actions}
    if found.rig.surroundings.failures:  # or what is there for failures would be missing
        tables |= {"function design": kb.designs, "configuration": kb.configurations}
    names = [f"{kind} {name}" for kind, table in tables.items() for name in table if (kind, name) not in occurring]
    return (f"never: {', '.join(names)}", None) if names else None
