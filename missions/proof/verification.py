"""Verify a tree: explore it, check the properties that must hold, and say what was found.

A property that is broken comes with the fewest rounds that lead there.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from inspect import signature
from itertools import combinations
from pathlib import Path
from typing import Any

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from missions.engine.mission import Mission, Percepts
from missions.engine.task_layer import build_task, check_task
from missions.proof.exploration import Exploration, Wrong
from missions.proof.rig import Change, Predicate, Setup, nodes, planned
from missions.proof.rounds import Step
from missions.proof.story import Story, play


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
    return Property(
        name, (predicate,), lambda found: found.first(found.holds[predicate], "it is so then")
    )


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
        return (
            None
            if late is None
            else ("it has not come about in time", [*found.path(late[0]), *late[1]])
        )

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
        (
            f"nothing is requested while unfeasible for longer than {ticks}",
            _unfeasible(found, reaction),
        ),
        ("every request is released once, when what does it ends", _unreleased(found)),
        (
            "actions that exclude each other are not required together",
            _together(found, [*map(set, exclusive)]),
        ),
        (
            "the goal is reached if all goes well",
            None if found.goals else ("it is never reached", None),
        ),
        ("wherever the goal can be reached as facts are, the mission is not stuck", _stuck(found)),
        ("while nothing happens, the mission does not waver", _wavering(found)),
        ("every node of the tree can be reached", _unreached(found)),
        ("every adaptation of the model can occur", _missing(found)),
        (
            "the manager keeps to the model and its budgets, and ends its plans",
            _shortest(found.faults.items()),
        ),
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
    return _shortest(
        (f"{action} is still requested", trail) for (action, _), trail in layer.items()
    )


def _unreleased(found: Exploration) -> Wrong | None:
    for number, (doing, known, _) in enumerate(found.states):
        for action in sorted(doing.running ^ set(known.required)):
            is_running = "is not requested any more, and what does it still runs"
            is_left = "is still requested, and nothing that does it runs"
            return found.first(
                [number], f"{action} {is_running if action in doing.running else is_left}"
            )
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
    here = [
        (doing.stage, known.failed, known.values, known.feasible)
        for doing, known, _ in found.states
    ]
    possible = {
        here[number] for number in found.reaching(found.goals, still=True).difference(found.goals)
    }
    bad = (one for one in found.every if one not in good and here[one] in possible)
    return found.first(bad, "it is not then, but elsewhere in this stage with the same facts")


def _wavering(found: Exploration) -> Wrong | None:
    """Find a cycle of different requests while all conditions keep their answer and every action keeps running."""
    for held in "FS":
        onward: dict[int, tuple[Step, int]] = {}
        for number in found.every:
            for step, _, after in found.following(number, still=True):
                if all(
                    letter == ("R" if "R" in found.rig.letters[name] else held)
                    for name, letter in step.answers
                ):
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
                return f"it goes to and fro between {' and '.join(sorted(done))}", [
                    *found.path(number),
                    *trail,
                ]
    return None


def _unreached(found: Exploration) -> Wrong | None:
    missing = [one.name for one in found.rig.root.iterate() if one not in found.rig.ticked]
    ticked = {
        one.name for one in found.rig.ticked
    }  # of the steps of plans, one of each name is enough
    names = dict.fromkeys(
        [*missing, *(one.name for one in nodes(found.rig.root) if one.name not in ticked)]
    )
    return (f"never ticked: {', '.join(names)}", None) if names else None


def _missing(found: Exploration) -> Wrong | None:
    kb, occurring = found.rig.kb, found.occurring
    tables: dict[str, Iterable[str]] = {"action": kb.actions}
    if found.rig.surroundings.failures:  # without failures, what is there for them cannot occur
        tables |= {"function design": kb.designs, "configuration": kb.configurations}
    names = [
        f"{kind} {name}"
        for kind, table in tables.items()
        for name in table
        if (kind, name) not in occurring
    ]
    return (f"never: {', '.join(names)}", None) if names else None


@dataclass(frozen=True)
class Consequence:
    """What a mission still reaches while some facts stay at their worst, and nothing else has failed.

    Attributes:
        facts: the bad facts, in words.
        reaches: "the goal", "the goal from some situations", "nothing", or "not explored" if it never occurred.
        actions: the actions that are required meanwhile.
    """

    facts: tuple[str, ...]
    reaches: str
    actions: tuple[str, ...] = ()


@dataclass(frozen=True)
class Proof:
    """The result of a verification.

    Attributes:
        setup: what was verified.
        found: the exploration, which can be asked further questions.
        findings: for each property, whether it holds.
        consequences: of single failures, and of pairs of those that do not end the mission alone.
    """

    setup: Setup
    found: Exploration
    findings: tuple[Finding, ...]
    consequences: tuple[Consequence, ...]

    @property
    def broken(self) -> tuple[Finding, ...]:
        """The findings that do not hold."""
        return tuple(one for one in self.findings if one.holds is False)

    @property
    def shown(self) -> Finding | None:
        """The first broken finding that a story shows."""
        return next((one for one in self.broken if one.trail is not None), None)

    def story(self, finding: Finding) -> Story | None:
        """Return the story that shows that a finding does not hold; None if there is none."""
        return None if finding.trail is None else play(self.setup, finding.trail)

    def report(self, path: str | Path) -> None:
        """Write a page with all findings, and the first story of a broken one, or else how the goal is reached."""
        way = (
            self.shown.trail
            if self.shown is not None
            else self.found.path(min(self.found.goals, default=0))
        )
        outcome = (
            "something is broken"
            if self.broken
            else "all holds"
            if self.found.is_finished
            else "not finished"
        )
        figures = [["if for good", "", "it reaches"]]
        for one in self.consequences:
            does = f"; does {', '.join(one.actions)}" if one.actions else ""
            figures.append([" and ".join(one.facts), "", f"{one.reaches}{does}"])
        result = {
            "outcome": outcome,
            "success": outcome == "all holds",
            "reason": self.count,
            "figures": figures,
        }
        rows = [
            ("problem", number, f"{one.name}: {one.what}") for number, one in enumerate(self.broken)
        ]
        play(self.setup, way or (), path, [("result", 0, result), *rows])

    @property
    def count(self) -> str:
        """How much was explored, and the time and memory for it, as text."""
        found = self.found
        count = f"{len(found.situations)} situations, {found.transitions} transitions, {found.seconds:.1f} s"
        count += f", {found.megabytes:.0f} MB"
        return count if found.is_finished else f"up to {count}, not finished"

    def __str__(self) -> str:
        lines = [self.count]
        for one in self.findings:
            verdict = {True: "yes ", False: "NO  ", None: "open"}[one.holds]
            lines.append(f"{verdict} {one.name}{f': {one.what}' if one.what else ''}")
            lines += self._lines_of(one)
        return "\n".join(lines)

    def _lines_of(self, finding: Finding) -> tuple[str, ...]:
        story = self.story(finding)
        return story.lines if story is not None else ()

    def as_data(self) -> dict[str, Any]:
        """Return all of it as plain data for JSON."""
        findings = [
            {
                "name": one.name,
                "holds": one.holds,
                "what": one.what,
                "story": [*map(str.strip, self._lines_of(one))],
            }
            for one in self.findings
        ]
        return {
            "finished": self.found.is_finished,
            "situations": len(self.found.situations),
            "transitions": self.found.transitions,
            "seconds": round(self.found.seconds, 3),
            "megabytes": round(self.found.megabytes),
            "findings": findings,
            "consequences": [vars(one) for one in self.consequences],
        }


def verify(
    build_tree: Callable[..., Behaviour],
    model: Model | Callable[[], Model],
    *,
    wanted: Iterable[Property] = (),
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    most: int = 100_000,
    seconds: float = 60.0,
    cores: int | None = None,
    **given: Any,  # noqa: ANN401  # of Setup and Surroundings
) -> Proof:
    """Explore a tree with its knowledge base and the manager, and check what holds in all that can happen.

    Args:
        build_tree: makes the tree, given the knowledge base, and percepts if it takes two arguments.
        model: of the robot, or a function that makes one.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        reaction: after this many ticks an action that became unfeasible must not be requested any more.
        exclusive: groups of actions; at most one of each may be required at a time.
        goal: holds where the mission has reached its goal; by default where its root succeeds.
        most: explore about this many situations at most.
        seconds: explore for about this time at most [s].
        cores: see `Exploration.explore`.
        given: `leaves`, `planner`, `start` and `slow` of `Setup`; `failures`, `at_once`, `values`, `failing` and
            `symmetric` of `Surroundings`.
    """
    of_setup = {
        name: given.pop(name) for name in ("leaves", "planner", "start", "slow") if name in given
    }
    parameters = signature(build_tree).parameters.values()
    takes_percepts = (
        sum(
            one.default is one.empty and one.kind is one.POSITIONAL_OR_KEYWORD for one in parameters
        )
        > 1
    )

    def build(kb: KnowledgeBase) -> Behaviour:
        return build_tree(kb, Percepts()) if takes_percepts else build_tree(kb)

    make = model if callable(model) else lambda: model
    return prove(
        Setup(make, build, surroundings=given, **of_setup),
        lambda found: found.explore(most, seconds, cores),
        wanted=tuple(wanted),
        reaction=reaction,
        exclusive=exclusive,
        goal=goal,
    )


def setup_of(mission: Mission, task: str = "bt", *, slow: bool = False, **given: Any) -> Setup:  # noqa: ANN401  # of Surroundings
    """Return the setup that explores a mission: its tree, or its plan executor."""
    check_task(task)
    if task == "pddl":
        return Setup(mission.model, planned(mission), surroundings=given, slow=slow)

    def build(kb: KnowledgeBase) -> Behaviour:
        return build_task(task, mission, kb, Percepts()).root

    return Setup(mission.model, build, surroundings=given, slow=slow)


def prove(
    setup: Setup,
    explore: Callable[[Exploration], object] = Exploration.explore,
    *,
    wanted: Sequence[Property] = (),
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    reaction: int = 1,
) -> Proof:
    """Explore a setup and check it; see `verify` for the arguments."""
    found = Exploration(setup, [one for each in wanted for one in each.predicates], goal)
    actions = found.rig.kb.actions
    groups = [[actions[name].name for name in group] for group in exclusive]
    explore(found)
    findings = check(found, reaction=reaction, exclusive=groups, wanted=wanted)
    return Proof(setup, found, tuple(findings), tuple(consequences(found)))


def consequences(found: Exploration) -> list[Consequence]:
    """Return the consequence of each single bad fact, and of each pair that ends the mission though neither does."""
    surroundings = found.rig.surroundings
    bad = [Change(alike[0], True) for alike in surroundings.alike]
    bad += [Change(name, value) for name, value in surroundings.worst.items()]
    single = {one: _consequence(found, (one,)) for one in bad}
    lasting = [one for one in bad if single[one].reaches.startswith("the goal")]
    pairs = [
        _consequence(found, pair)
        for pair in combinations(lasting, 2)
        if pair[0].name != pair[1].name
    ]
    return [*single.values(), *(one for one in pairs if one.reaches == "nothing")]


def _consequence(found: Exploration, facts: Sequence[Change]) -> Consequence:
    failed = sorted(one.name for one in facts if one.to is True)
    measured = {(one.name, one.to) for one in facts if one.to is not True}
    within = {
        number
        for number, (_, known, _) in enumerate(found.states)
        if sorted(known.failed) == failed and measured <= set(known.values)
    }
    reached = found.reaching(found.goals & within, within=within)
    actions = sorted({one for number in within for one in found.states[number].facts.required})
    reaches = (
        "nothing"
        if not reached
        else "the goal"
        if reached >= within
        else "the goal from some situations"
    )
    is_known = within and (reached or found.is_finished)
    return Consequence(
        tuple(map(str, facts)), reaches if is_known else "not explored", tuple(actions)
    )
