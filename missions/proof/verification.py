"""Verify a tree: explore it, check what must hold, and say what was found."""

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
from missions.proof.exploration import Exploration
from missions.proof.planned import planned
from missions.proof.properties import Finding, Property, check
from missions.proof.rig import Predicate, Setup
from missions.proof.story import Story, play
from missions.proof.surroundings import Change


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
        way = self.shown.trail if self.shown is not None else self.found.path(min(self.found.goals, default=0))
        outcome = "something is broken" if self.broken else "all holds" if self.found.is_finished else "not finished"
        figures = [["if for good", "", "it reaches"]]
        for one in self.consequences:
            does = f"; does {', '.join(one.actions)}" if one.actions else ""
            figures.append([" and ".join(one.facts), "", f"{one.reaches}{does}"])
        result = {"outcome": outcome, "success": outcome == "all holds", "reason": self.count, "figures": figures}
        rows = [("problem", number, f"{one.name}: {one.what}") for number, one in enumerate(self.broken)]
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
            {"name": one.name, "holds": one.holds, "what": one.what, "story": [*map(str.strip, self._lines_of(one))]}
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
    of_setup = {name: given.pop(name) for name in ("leaves", "planner", "start", "slow") if name in given}
    parameters = signature(build_tree).parameters.values()
    takes_percepts = sum(one.default is one.empty and one.kind is one.POSITIONAL_OR_KEYWORD for one in parameters) > 1

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
    pairs = [_consequence(found, pair) for pair in combinations(lasting, 2) if pair[0].name != pair[1].name]
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
    reaches = "nothing" if not reached else "the goal" if reached >= within else "the goal from some situations"
    is_known = within and (reached or found.is_finished)
    return Consequence(tuple(map(str, facts)), reaches if is_known else "not explored", tuple(actions))
