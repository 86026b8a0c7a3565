"""Verify a mission: explore it, check what must hold, and report with stories."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.composites import Parallel, Selector
from py_trees.composites import Sequence as SequenceNode
from py_trees.decorators import Decorator

from kb import KnowledgeBase, Model
from missions.proof.exploration import Exploration
from missions.proof.properties import Finding, check, notes
from missions.proof.rig import Rig, Step, acting
from missions.proof.setup import Fact, Senses, Setup, failed
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

    def story(self, trail: Sequence[Step] | None) -> list[str]:
        """Run the rounds of a finding with the real parts, and say what happens."""
        return [] if trail is None else _replayed(Rig(self.explored.rig.setup), trail)

    def report(self, page: Path) -> None:
        """Write a page of the first story, or else of how the goal is reached."""
        from missions.views.recorder import Recorder

        goals = self.explored.goals
        trails = [finding.trail for finding in self.broken if finding.trail is not None]
        trails += [each.path for each in self.explored.caused() if each in goals]
        rig = Rig(self.explored.rig.setup)
        recorder = Recorder(rig.kb, rig.runner)
        _replayed(rig, next(iter(trails), ()))
        recorder.close()
        recorder.report(str(page))

    @property
    def count(self) -> str:
        """How much was explored, and the time for it, as text."""
        explored = self.explored
        count = f"{len(explored.situations)} situations, {explored.transitions} transitions"
        count += f", {explored.seconds:.1f} s"
        return f"up to {count}, not finished" if explored.unexplored else count

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
        return {
            "finished": not self.explored.unexplored,
            "count": self.count,
            "findings": [
                {**vars(finding), "trail": self.story(finding.trail)} for finding in self.findings
            ],
            "consequences": [consequence._asdict() for consequence in self.consequences],
            "notes": self.notes,
        }


def _replayed(rig: Rig, trail: Sequence[Step]) -> list[str]:
    """Return in words what happens in some rounds."""
    lines = []
    rig.begin()
    for number, step in enumerate(trail, start=1):
        rig.clock.advance(1.0)
        last = rig.kb.log.last
        lines.append(f"  {number}. {step}")
        if step.change is not None:
            step.change.apply(rig.kb)
        rig.settle()
        rig.tick(step.answers)
        rig.settle()
        for event in rig.kb.log.since(last):
            if event.verb in ("request_action", "cancel_action") or event.plan:
                lines.append(f"      {event.text}")
    return lines


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


def prove(setup: Setup, *, suggest: bool = False) -> Proof:
    """Explore a setup and check it; with `suggest`, look for what mends a broken tree."""
    explored = Exploration(setup).explore()
    findings = check(explored)
    is_broken = any(finding.holds is False for finding in findings)
    for text, mended in _mends(setup) if suggest and is_broken else ():
        if all(finding.holds for finding in check(Exploration(mended).explore())):
            findings = [replace(each, advice="" if each.holds else text) for each in findings]
            break
    table = [_consequence(explored, bad) for bad in explored.rig.environment.bad]
    return Proof(explored, findings, table, notes(explored))


def _consequence(explored: Exploration, bad: Fact) -> Consequence:
    """Return what is reached with this fact; a quality that a deed restores need not last."""
    alone = {each for each in explored.caused() if failed(each.facts) == failed((bad,))}
    within = {each for each in alone if bad in each.facts}
    rounds = explored.situations[0].rounds
    first = {each.after for each in rounds if each.step.change == bad and each.is_caused}
    reached = explored.reaching(explored.goals & within, within=within)
    reaches = "nothing"
    if not within or (explored.unexplored and not reached):
        reaches = "not explored"
    elif reached & (first or within):
        reaches = "the goal"
        restoring = explored.reaching(explored.goals & alone, within=alone, changes=[None])
        for lowest in explored.rig.environment.bad:
            low = {each for each in alone if lowest in each.facts}
            is_quality = lowest.name in explored.rig.environment.qualities
            if is_quality and lowest != bad and low and not low & restoring:
                reaches = f"the goal as long as {lowest.name} lasts"
    elif reached:
        reaches = "the goal if it happens later"
    actions = {action for each in within for action in each.required}
    return Consequence(str(bad), reaches, sorted(actions))


# -------------------------------------------------------------------- idioms that mend a tree

Mend = Callable[[], Behaviour]
"""Changes a node; returns it, or what comes in its place."""


def _mends(setup: Setup) -> Iterator[tuple[str, Setup]]:
    """Yield what could be written instead, in words, with the setup of the mended tree."""
    for place, node in enumerate(Rig(setup).nodes):
        for number, (text, _) in enumerate(_idioms(node)):

            def build(
                kb: KnowledgeBase, senses: Senses, place: int = place, number: int = number
            ) -> Behaviour:
                nodes = [*setup.build(kb, senses).iterate()]
                old = nodes[place]
                parent = old.parent
                _, mend = [*_idioms(old)][number]
                new = mend()
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
        text = f"drop even_if_unfeasible=True of {node.name}"
        yield text, partial(_changed, node, even_if_unfeasible=False)
    if isinstance(node, HasStatus) and node.element.name in node.kb.actions:
        text = f"write IsActionFeasible for {node.name}"
        yield text, partial(IsActionFeasible, node.name, node.kb, node.element.name)
    if isinstance(node, Selector | Parallel) and len(node.children) == 2:
        parts = [acting(child.iterate()) for child in node.children]
        if all(parts):
            task, other = (part[0] for part in parts)
            text = f"write do_until_unfeasible({task.name}, {other.name}) in place of {node.name}"
            yield text, partial(_do_until_unfeasible, task, other, node.name)
    if isinstance(node, Selector | SequenceNode) and node.memory:
        yield f"write memory=False in {node.name}", partial(_changed, node, memory=False)


def _changed(node: Behaviour, **attributes: bool) -> Behaviour:
    vars(node).update(attributes)
    return node


def _do_until_unfeasible(task: Behaviour, other: Behaviour, name: str) -> Behaviour:
    task.parent = None
    other.parent = None
    return do_until_unfeasible(task, other, name=name)
