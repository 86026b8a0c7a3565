"""What holds in everything that was explored, and if it does not, the fewest rounds that lead to where it does not."""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from py_trees.common import Status

from missions.proof.exploration import Exploration, Predicate, Rig, Step


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
    check: "Callable[[Graph], tuple[str, Sequence[Step]] | None]"


def always(name: str, predicate: Predicate) -> Property:
    """Want something to hold after every tick."""

    def check(graph: "Graph") -> tuple[str, Sequence[Step]] | None:
        holds = graph.found.holds[predicate]
        bad = next((one for one in range(len(graph.found.situations)) if one not in holds), None)
        return None if bad is None else ("it does not hold then", graph.found.path(bad))

    return Property(name, (predicate,), check)


def never(name: str, predicate: Predicate) -> Property:
    """Want something not to hold after any tick."""

    def check(graph: "Graph") -> tuple[str, Sequence[Step]] | None:
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

    def check(graph: "Graph") -> tuple[str, Sequence[Step]] | None:
        found = graph.found
        begun, met = sorted(found.holds[first]), found.holds[then]
        if within is None:
            bad = next((one for one in begun if one not in graph.reaching(met)), None)
            return None if bad is None else ("it cannot come about any more", found.path(bad))
        for number in begun:
            trail = graph.avoiding(number, met, within)
            if trail is not None:
                return f"it has not come about {within} ticks later", [*found.path(number), *trail]
        return None

    return Property(name, (first, then), check)


class Graph:
    """What was explored, with the questions that properties ask of it."""

    def __init__(self, found: Exploration, goal: Predicate | None = None) -> None:
        self.found = found
        ended = (place for place, one in enumerate(found.situations) if found.doing[one.tree].status is Status.SUCCESS)
        self.goals = set(ended) if goal is None else found.holds[goal]

    def following(self, number: int, *, still: bool = False) -> Iterator[tuple[Step, int]]:
        """Yield each round that may follow a situation, and where it leads; if still, none in which facts change."""
        for moment, changes, was_late in self.found.happening[number]:
            if not (still and (changes or was_late)):
                for after, answers, is_late in self.found.ticks[moment]:
                    if not (still and is_late):
                        yield Step(number, changes, answers, (was_late, is_late)), after

    def reaching(
        self, wanted: Collection[int], *, still: bool = False, within: Collection[int] | None = None
    ) -> set[int]:
        """Return the situations from which one of those that are wanted can be reached, those included."""
        before: defaultdict[int, list[int]] = defaultdict(list)
        for number in range(len(self.found.situations)) if within is None else within:
            for _, after in self.following(number, still=still):
                if within is None or after in within:
                    before[after].append(number)
        reached, pending = set(wanted), list(wanted)
        while pending:
            for one in before[pending.pop()]:
                if one not in reached:
                    reached.add(one)
                    pending.append(one)
        return reached

    def avoiding(self, number: int, wanted: Collection[int], rounds: int) -> list[Step] | None:
        """Return rounds after which nothing that is wanted was reached; None if there are no such."""
        if number in wanted:
            return None
        layer: dict[int, list[Step]] = {number: []}
        for _ in range(rounds):
            layer = {
                after: [*trail, step]
                for one, trail in layer.items()
                for step, after in self.following(one)
                if after not in wanted
            }
        return next(iter(layer.values()), None)


def check(
    found: Exploration,
    *,
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    wanted: Iterable[Property] = (),
) -> list[Finding]:
    """Return what holds of an exploration, what everybody wants first."""
    graph = Graph(found, goal)
    ticks = "a tick" if reaction == 1 else f"{reaction} ticks"
    checks: list[tuple[str, Callable[[], tuple[str, Sequence[Step] | None] | None]]] = [
        (f"nothing is requested while unfeasible for longer than {ticks}", lambda: _unfeasible(graph, reaction)),
        ("every request is released once, when what does it ends", lambda: _unreleased(found)),
        ("actions that exclude each other are not required together", lambda: _together(found, exclusive)),
        ("the goal is reached if all goes well", lambda: None if graph.goals else ("it is never reached", None)),
        ("wherever the goal can be reached as facts are, the mission is not stuck", lambda: _stuck(graph)),
        ("while nothing happens, the mission does not waver", lambda: _wavering(graph)),
        ("every node of the tree can be reached", lambda: _unreached(found)),
        ("every adaptation of the model can occur", lambda: _missing(found)),
        ("the manager keeps to the model and its budgets, and ends its plans", lambda: _first(found.faults.items())),
        *((one.name, lambda one=one: one.check(graph)) for one in wanted),  # type: ignore[misc]
    ]
    return [_finding(found, name, ask()) for name, ask in checks]


_ONLY_AT_THE_END = ("the goal is", "every node", "every adaptation", "wherever")


def _finding(found: Exploration, name: str, bad: tuple[str, Sequence[Step] | None] | None) -> Finding:
    if bad is None:
        return Finding(name, True if found.is_finished else None)
    if not found.is_finished and bad[1] is None:
        return Finding(name, None, f"not so far: {bad[0]}")
    return Finding(name, False, bad[0], None if bad[1] is None else tuple(bad[1]))


def _first(bad: Iterable[tuple[str, Sequence[Step]]]) -> tuple[str, Sequence[Step]] | None:
    return min(bad, key=lambda one: len(one[1]), default=None)


def _unfeasible(graph: Graph, reaction: int) -> tuple[str, Sequence[Step]] | None:
    found = graph.found
    layer: dict[tuple[int, str], list[Step]] = {}
    for rounds in range(reaction):
        following: dict[tuple[int, str], list[Step]] = {}
        for moment, (_, known) in enumerate(found.moments):
            for action in found.known[known].unfeasible:
                before = [found.path(found.origins[moment].before)] if not rounds else []
                before += [trail for (number, name), trail in layer.items() if name == action and moment in
                           {one[0] for one in found.happening[number]}] if rounds else []
                for after, answers, is_late in found.ticks[moment] if before else ():
                    if action in found.known[found.situations[after].known].unfeasible:
                        _, changes, _, (was_late, _) = found.origins[moment]
                        step = Step(found.origins[moment].before, changes, answers, (was_late, is_late))
                        following.setdefault((after, action), [*min(before, key=len), step])
        layer = following
    return _first((f"{action} is still requested", trail) for (_, action), trail in layer.items())


def _unreleased(found: Exploration) -> tuple[str, Sequence[Step]] | None:
    for number, (tree, known) in enumerate(found.situations):
        required, running = set(found.known[known].required), found.doing[tree].running
        for action in sorted(required ^ running):
            what = "is still requested, and nothing that does it runs"
            if action in running:
                what = "is not requested any more, and what does it still runs"
            return f"{action} {what}", found.path(number)
    return None


def _together(found: Exploration, exclusive: Iterable[Collection[str]]) -> tuple[str, Sequence[Step]] | None:
    groups = [set(one) for one in exclusive]
    for number, (_, known) in enumerate(found.situations):
        for group in groups:
            both = group.intersection(found.known[known].required)
            if len(both) > 1:
                return f"{' and '.join(sorted(both))} are required", found.path(number)
    return None


def _stuck(graph: Graph) -> tuple[str, Sequence[Step]] | None:
    """Compare situations in which the same facts hold: from one the goal is reached while they do, from another not."""
    found = graph.found
    good = graph.reaching(graph.goals, still=True)
    facts = [found.known[one.known].facts for one in found.situations]
    possible = {facts[number] for number in good}
    for number, of in enumerate(facts):
        if number not in good and of in possible:
            return "from here it is not, but with the same facts elsewhere it is", found.path(number)
    return None


def _wavering(graph: Graph) -> tuple[str, Sequence[Step]] | None:
    found = graph.found
    for held in "FS":
        onward: dict[int, tuple[Step, int]] = {}
        for number in range(len(found.situations)):
            for step, after in graph.following(number, still=True):
                if all(letter == ("R" if "R" in found.rig.letters[name] else held) for name, letter in step.answers):
                    onward.setdefault(number, (step, after))
        for number in onward:
            seen, at = {number: 0}, number
            trail: list[Step] = []
            while at in onward:
                step, at = onward[at]
                trail.append(step)
                if at in seen:
                    break
                seen[at] = len(trail)
            cycle = [one for one, place in seen.items() if at in onward and place >= seen.get(at, 0)]
            required = {found.known[found.situations[one].known].required for one in cycle}
            if len(required) > 1:
                words = " and ".join(sorted(", ".join(one) or "nothing" for one in required))
                return f"it goes to and fro between {words}", [*found.path(number), *trail]
    return None


def _unreached(found: Exploration) -> tuple[str, None] | None:
    names = [one.name for one in found.rig.root.iterate() if one not in found.rig.ticked]
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(found: Exploration) -> tuple[str, None] | None:
    kb = found.rig.kb
    occurring = {pair for one in found.known.values() for pair in one.occurring}
    every = [(kind, name) for kind, table in _adaptable(found.rig) for name in table]
    names = [f"{kind} {name}" for kind, name in every if (kind, name) not in occurring]
    return (f"never: {', '.join(names)}", None) if names and kb else None


def _adaptable(rig: Rig) -> list[tuple[str, Iterable[str]]]:
    kb = rig.kb
    return [("action", kb.actions), ("function design", kb.designs), ("configuration", kb.configurations)]
