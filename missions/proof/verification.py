"""Verify a mission: explore it, check what must hold, and report with stories."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.composites import Parallel, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator

from kb import Event, KnowledgeBase, Model
from missions.engine.mission import Mission, MissionError
from missions.engine.task_layer import build_task
from missions.proof.exploration import Exploration
from missions.proof.properties import Finding, check, notes
from missions.proof.rig import Rig, Step, acting
from missions.proof.setup import Change, Senses, Setup, causes_of
from rosa_bt import HasStatus, IsActionFeasible, RosaAction, do_until_unfeasible


class Consequence(NamedTuple):
    """What a mission still reaches if a fact is at its worst from the beginning, for good.

    Attributes:
        fact: the bad fact, in words.
        reaches: "the goal", "the goal as long as X lasts" if nothing that is possible then restores
            the quality X, "the goal if it happens later", "nothing", or "not explored" if it never
            occurred.
        actions: the actions that are required meanwhile.
    """

    fact: str
    reaches: str
    actions: list[str]


@dataclass(frozen=True)
class Proof:
    """The result of a verification.

    Attributes:
        explored: the situations, which can be asked further questions.
        findings: for each property, whether it holds.
        consequences: of each single bad fact.
        notes: what is no mistake, but good to know.
    """

    explored: Exploration
    findings: Sequence[Finding]
    consequences: Sequence[Consequence]
    notes: Sequence[str]

    @property
    def broken(self) -> list[Finding]:
        """The findings that do not hold."""
        return [finding for finding in self.findings if finding.holds is False]

    def story(self, trail: Iterable[Step] | None, page: Path | None = None) -> list[str]:
        """Run the rounds of a finding with the real parts, and say what happens.

        With `page`, write a page of it.
        """
        if trail is None:
            return []
        rig = Rig(self.explored.rig.setup)
        lines: list[str] = []

        def on_event(event: Event) -> None:
            if event.verb in ("request_action", "cancel_action") or event.plan:
                lines.append(f"      {event.text}")

        recorder = None
        if page is not None:
            from missions.views.recorder import Recorder

            recorder = Recorder(rig.kb, rig.runner)
        rig.kb.subscribe(on_event)
        rig.begin()
        for number, step in enumerate(trail, start=1):
            rig.clock = float(number)
            lines.append(f"  {number}. {step}")
            for change in step.changes:
                change.apply(rig.kb)
            rig.settle()
            rig.tick(step.answers)
            rig.settle()
        if recorder is not None:
            recorder.close()
            recorder.report(str(page))
        return lines

    def report(self, page: Path) -> None:
        """Write a page of the first story, or else of how the goal is reached."""
        goal = min(self.explored.goals.intersection(self.explored.caused()), default=0)
        trails = [finding.trail for finding in self.broken if finding.trail is not None]
        self.story(trails[0] if trails else self.explored.path(goal), page)

    @property
    def count(self) -> str:
        """How much was explored, and the time for it, as text."""
        explored = self.explored
        count = f"{len(explored.situations)} situations, {explored.transitions} transitions"
        count += f", {explored.seconds:.1f} s"
        return count if explored.is_finished else f"up to {count}, not finished"

    def __str__(self) -> str:
        lines = [self.count]
        for finding in self.findings:
            verdict = {True: "yes ", False: "NO  ", None: "open"}[finding.holds]
            lines.append(f"{verdict} {finding.name}{f': {finding.what}' if finding.what else ''}")
            lines += self.story(finding.trail)
            lines += [f"     instead: {finding.advice}"] if finding.advice else []
        return "\n".join([*lines, *(f"note {note}" for note in self.notes)])

    def as_data(self) -> dict[str, Any]:
        """Return all of it as plain data for JSON."""
        findings = []
        for finding in self.findings:
            lines = [line.strip() for line in self.story(finding.trail)]
            findings.append({**vars(finding), "trail": lines})
        return {
            "finished": self.explored.is_finished,
            "count": self.count,
            "findings": findings,
            "consequences": [consequence._asdict() for consequence in self.consequences],
            "notes": self.notes,
        }


def verify(
    build_tree: Callable[[KnowledgeBase], Behaviour],
    model: Callable[[], Model],
    *,
    suggest: bool = False,
    **options: Any,  # noqa: ANN401  # arguments of Setup
) -> Proof:
    """Explore a tree with its knowledge base and the manager, and check what holds.

    Args:
        build_tree: makes the tree, given the knowledge base.
        model: makes the model of the robot.
        suggest: look for what mends a broken tree, see `Finding.advice`.
        options: of `Setup`.
    """
    return prove(Setup(lambda kb, senses: build_tree(kb), model, **options), suggest=suggest)


def setup_of(mission: Mission, **options: Any) -> Setup:  # noqa: ANN401  # arguments of Setup
    """Return the setup that explores the tree of a mission; MissionError if it has none."""
    if mission.tree is None:
        raise MissionError(f"mission {mission.name} has no tree to verify; give it tree=...")

    def build(kb: KnowledgeBase, senses: Senses) -> Behaviour:
        return build_task("bt", mission, kb, senses).root

    return Setup(build, mission.model, causes=causes_of(mission), **options)


def prove(setup: Setup, *, suggest: bool = False) -> Proof:
    """Explore a setup and check it; with `suggest`, look for what mends a broken tree."""
    explored = Exploration(setup).explore()
    findings = check(explored)
    is_broken = any(finding.holds is False for finding in findings)
    for text, mended in _mends(setup) if suggest and is_broken else ():
        if all(finding.holds for finding in check(Exploration(mended).explore())):
            advice = {True: "", False: text, None: ""}
            findings = [replace(each, advice=advice[each.holds]) for each in findings]
            break
    return Proof(explored, findings, consequences(explored), notes(explored))


def consequences(explored: Exploration) -> list[Consequence]:
    """Return the consequence of each single bad fact."""
    environment = explored.rig.environment
    failures = [Change(group[0], True) for group in environment.alike]
    caused = set(explored.caused())
    worst = [Change(name, value) for name, value in environment.worst.items()]
    return [_consequence(explored, bad, caused) for bad in [*failures, *worst]]


def _consequence(explored: Exploration, bad: Change, caused: set[int]) -> Consequence:
    """Return what is reached with this fact; a quality that a deed restores need not last."""
    is_failure = bad.to is True
    failed = {bad.name} if is_failure else set()
    facts = {number: explored.situations[number].facts for number in caused}
    alone = {number for number in caused if facts[number].failed == failed}
    within = {number for number in alone if is_failure or (*bad,) in facts[number].values}
    rounds = [each for each in explored.rounds[0] if each.is_caused]
    first = {each.after for each in rounds if each.step.changes == (bad,)}
    reached = explored.reaching(explored.goals & within, within=within)
    reaches = "nothing"
    if not within or not (reached or explored.is_finished):
        reaches = "not explored"
    elif reached & (first or within):
        reaches = "the goal"
        restoring = explored.reaching(explored.goals & alone, within=alone, still=True)
        for name, lowest in explored.rig.environment.worst.items():
            low = {number for number in alone if (name, lowest) in facts[number].values}
            is_other = name != bad.name and explored.rig.is_quality(name)
            if is_other and low and not low & restoring:
                reaches = f"the goal as long as {name} lasts"
    elif reached:
        reaches = "the goal if it happens later"
    actions = {name for number in within for name in explored.seen[number].required}
    return Consequence(str(bad), reaches, sorted(actions))


# -------------------------------------------------------------------- idioms that mend a tree

Mend = Callable[[Behaviour], Behaviour]
"""Changes a node; returns it, or what comes in its place."""


def _mends(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could be written instead, in words, with the setup of the mended tree."""
    for place, node in enumerate(Rig(setup).nodes):
        for text, mend in _idioms(node):

            def build(
                kb: KnowledgeBase, senses: Senses, place: int = place, mend: Mend = mend
            ) -> Behaviour:
                nodes = [*setup.build(kb, senses).iterate()]
                old = nodes[place]
                parent = old.parent
                new = mend(old)
                new.parent = parent
                if parent is None:
                    return new
                parent.children[parent.children.index(old)] = new
                if isinstance(parent, Decorator):
                    parent.decorated = new
                return nodes[-1]

            yield text, replace(setup, build=build)


def _idioms(node: Behaviour) -> Iterator[tuple[str, Mend]]:
    """Yield the idioms that can be applied to a node."""
    if isinstance(node, RosaAction) and node.even_if_unfeasible:
        yield f"drop even_if_unfeasible=True of {node.name}", _changed(even_if_unfeasible=False)
    if isinstance(node, HasStatus) and node.element.name in node.kb.actions:
        yield f"write IsActionFeasible for {node.name}", _ask
    if isinstance(node, Selector | Parallel) and len(node.children) == 2:
        parts = [acting(child.iterate()) for child in node.children]
        if all(parts):
            task, other = (part[0].name for part in parts)
            text = f"write do_until_unfeasible({task}, {other}) in place of {node.name}"
            yield text, _do_until_unfeasible
    if isinstance(node, Selector | SequenceNode) and node.memory:
        yield f"write memory=False in {node.name}", _changed(memory=False)


def _changed(**attributes: bool) -> Mend:
    def mend(node: Behaviour) -> Behaviour:
        vars(node).update(attributes)
        return node

    return mend


def _ask(node: Behaviour) -> Behaviour:
    assert isinstance(node, HasStatus)
    return IsActionFeasible(node.name, node.kb, node.element.name)


def _do_until_unfeasible(node: Behaviour) -> Behaviour:
    task, other = (acting(child.iterate())[0] for child in node.children)
    task.parent = None
    other.parent = None
    return do_until_unfeasible(task, other, name=node.name)
