"""Verify a mission: explore it, check what must hold, and say what was found, with the stories that show it."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from itertools import combinations
from pathlib import Path
from pprint import pformat
from typing import Any, Final

from py_trees.behaviour import Behaviour

from kb import Event, KnowledgeBase, Model
from kb import Planner as ConfigurationPlanner
from missions.engine.mission import Mission, MissionError
from missions.engine.task_layer import build_task
from missions.proof.advice import mends
from missions.proof.causes import Senses, causes_of
from missions.proof.environment import Change, is_debounced
from missions.proof.exploration import Exploration
from missions.proof.properties import Finding, Property, check, notes
from missions.proof.rig import Leaf, Predicate, Rig, Setup, Step
from missions.testing.scripted import LETTERS
from rosa_bt import Trace, TraceVisitor

_SHOWN: Final = ("request_action", "cancel_action")


@dataclass(frozen=True)
class Story:
    """What happened when the rounds of a counterexample were run.

    Attributes:
        lines: in words.
        trace: of the ticks; a round takes a second.
        wrong: what is wrong at the end, in words, if the last situation alone shows it.
        rig: the parts of the mission, as they are at the end.
    """

    lines: tuple[str, ...]
    trace: Trace
    wrong: tuple[str, ...]
    rig: Rig

    def __str__(self) -> str:
        return "\n".join(self.lines)


def play(setup: Setup, trail: Sequence[Any], page: str | Path | None = None) -> Story:
    """Run the rounds of a story with the real parts; if `page` is given, write a page of it there."""
    rig = Rig(setup)
    recorder = None
    if page is not None:
        from missions.views.recorder import Recorder

        recorder = Recorder(rig.kb, rig.runner)
    lines: list[str] = []

    def on_event(event: Event) -> None:
        if event.verb in _SHOWN or event.plan:
            lines.append(f"      {event.text}")

    rig.kb.subscribe(on_event)
    late: set[str] = set()
    with TraceVisitor(rig.kb) as visitor:
        faults = list(rig.begin())
        rig.runner.tree.add_visitor(visitor)
        for number, (changes, answers, is_late) in enumerate(trail, start=1):
            rig.clock = float(number)
            step = Step(tuple(Change(*change) for change in changes), answers, is_late)
            lines.append(f"  {number}. {_in_words(step)}")
            for change in step.changes:
                change.apply(rig.kb)
            faults += () if is_late[0] else rig.settle()
            before = set(rig.unfeasible)
            rig.tick(tuple(answers))
            faults += () if is_late[1] else rig.settle()
            late = before & set(rig.unfeasible)
        trace = visitor.trace
    if recorder is not None:
        recorder.close()
        recorder.report(str(page))
    wrong = [*faults, *(f"{name} is requested while it is unfeasible" for name in sorted(late))]
    unbalanced = sorted(rig.running ^ set(rig.required))
    wrong += [f"{name} is requested or runs, not both" for name in unbalanced]
    return Story(tuple(lines), trace, tuple(wrong), rig)


def _in_words(step: Step) -> str:
    happens = "; ".join(map(str, step.changes)) or "nothing happens"
    late = " (the manager is late)" if step.late[0] else ""
    answers = ", ".join(f"{name} {LETTERS[letter].name}" for name, letter in step.answers)
    return f"{happens}{late}; {answers or 'no leaf is asked'}"


def as_test(setup: str, finding: Finding) -> str:
    """Return a test for pytest that plays the story of a finding, and fails as long as the story can happen.

    Args:
        setup: an expression that makes the `Setup`, with the imports that it needs as lines before it.
        finding: one that has a story.
    """
    *imports, expression = setup.splitlines()
    trail = [(tuple(map(tuple, step.changes)), *step[1:]) for step in finding.trail or ()]
    function = "".join(letter if letter.isalnum() else "_" for letter in finding.name.lower())
    imported = "\n".join([*imports, "from missions.proof.verification import play"])
    return f'''"""A story that `rosa verify` has found."""

{imported}

SETUP = {expression}
ROUNDS = {pformat(trail, width=100)}


def test_{function}():
    story = play(SETUP, ROUNDS)  # {finding.what}
    assert not story.wrong, story
'''


@dataclass(frozen=True)
class Consequence:
    """What a mission still reaches if some facts are at their worst from the beginning, for good.

    Attributes:
        facts: the bad facts, in words.
        reaches: "the goal", "the goal as long as X lasts" if nothing that is possible then restores the quality X,
            "the goal if it happens later", "nothing", or "not explored" if it never occurred.
        actions: the actions that are required meanwhile.
        alike: further components of which the same holds.
    """

    facts: tuple[str, ...]
    reaches: str
    actions: tuple[str, ...] = ()
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Proof:
    """The result of a verification.

    Attributes:
        setup: what was verified.
        explored: the situations, which can be asked further questions.
        findings: for each property, whether it holds.
        consequences: of single failures, and of pairs of those that do not end the mission alone.
        notes: what is no mistake, but good to know.
    """

    setup: Setup
    explored: Exploration
    findings: tuple[Finding, ...]
    consequences: tuple[Consequence, ...]
    notes: tuple[str, ...] = ()

    @property
    def broken(self) -> tuple[Finding, ...]:
        """The findings that do not hold."""
        return tuple(finding for finding in self.findings if finding.holds is False)

    @property
    def shown(self) -> Finding | None:
        """The first broken finding that a story shows."""
        return next((finding for finding in self.broken if finding.trail is not None), None)

    def story(self, finding: Finding) -> Story | None:
        """Return the story that shows that a finding does not hold; None if there is none."""
        return None if finding.trail is None else play(self.setup, finding.trail)

    def report(self, path: str | Path) -> None:
        """Write a page of the first story of a broken finding, or else of how the goal is reached."""
        shown = self.shown
        goal = min(self.explored.goals & self.explored.caused(), default=0)
        trail = self.explored.path(goal) if shown is None else shown.trail
        play(self.setup, trail or (), path)

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
            story = self.story(finding)
            lines += story.lines if story is not None else ()
            lines += [f"     instead: {finding.advice}"] if finding.advice else []
        return "\n".join([*lines, *(f"note {note}" for note in self.notes)])

    def as_data(self) -> dict[str, Any]:
        """Return all of it as plain data for JSON."""
        findings = []
        for finding in self.findings:
            story = self.story(finding)
            lines = [line.strip() for line in story.lines] if story is not None else []
            said = {"name": finding.name, "holds": finding.holds, "what": finding.what}
            findings.append({**said, "advice": finding.advice, "story": lines})
        explored = self.explored
        return {
            "finished": explored.is_finished,
            "situations": len(explored.situations),
            "transitions": explored.transitions,
            "seconds": round(explored.seconds, 3),
            "findings": findings,
            "consequences": [vars(consequence) for consequence in self.consequences],
            "notes": self.notes,
        }


def verify(
    build_tree: Callable[..., Behaviour],
    model: Model | Callable[[], Model],
    *,
    wanted: Iterable[Property] = (),
    reaction: int = 1,
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    leaves: Mapping[str, Leaf] | None = None,
    planner: Callable[[], ConfigurationPlanner] | None = None,
    start: Mapping[str, float] | None = None,
    slow: bool = False,
    most: int = 100_000,
    seconds: float = 60.0,
    suggest: bool = False,
    **environment: Any,  # noqa: ANN401  # of Environment
) -> Proof:
    """Explore a tree with its knowledge base and the manager, and check what holds in all that can happen.

    Args:
        build_tree: makes the tree, given the knowledge base, and percepts if it takes two arguments.
        model: of the robot, or a function that makes one.
        wanted: further properties; see `always`, `never`, `eventually` and `leads_to`.
        reaction: after this many ticks an action that became unfeasible must not be requested any more.
        exclusive: groups of actions; at most one of each may be required at a time.
        goal: holds where the mission has reached its goal; by default where its root succeeds, unless what succeeded
            only makes other actions feasible.
        leaves: by name, what leaves may return.
        planner: makes the planner that chooses configurations; None: by priority.
        start: attributes that are measured before the first tick, with their values.
        slow: whether the manager may miss its turn, as while commands take time.
        most: explore about this many situations at most.
        seconds: explore for about this time at most [s].
        suggest: look for what mends a broken tree, see `Finding.advice`.
        environment: `failures`, `at_once`, `values`, `failing` and `symmetric` of `Environment`.

    Raises:
        MissionError: the model has debouncing, which would be changed, and is no function.
    """
    parameters = signature(build_tree).parameters.values()
    needed = [each for each in parameters if each.default is each.empty]
    takes_percepts = len([each for each in needed if each.kind is each.POSITIONAL_OR_KEYWORD]) > 1

    def build(kb: KnowledgeBase, senses: Senses) -> Behaviour:
        return build_tree(kb, senses) if takes_percepts else build_tree(kb)

    if not callable(model) and is_debounced(model):
        raise MissionError("give a function that makes the model: verify changes its debouncing")
    setup = Setup(
        model if callable(model) else lambda: model,
        build,
        leaves or {},
        planner,
        start or {},
        environment,
        slow,
    )
    return prove(
        setup,
        lambda explored: explored.explore(most, seconds),
        wanted=tuple(wanted),
        reaction=reaction,
        exclusive=exclusive,
        goal=goal,
        suggest=suggest,
    )


def setup_of(mission: Mission, *, slow: bool = False, **environment: Any) -> Setup:  # noqa: ANN401  # of Environment
    """Return the setup that explores the tree of a mission; MissionError if it has none."""
    if mission.tree is None:
        raise MissionError(f"mission {mission.name} has no tree to verify; give it tree=...")

    def build(kb: KnowledgeBase, senses: Senses) -> Behaviour:
        return build_task("bt", mission, kb, senses).root

    causes = causes_of(mission)
    return Setup(mission.model, build, environment=environment, slow=slow, causes=causes)


def prove(
    setup: Setup,
    explore: Callable[[Exploration], object] = Exploration.explore,
    *,
    wanted: Sequence[Property] = (),
    exclusive: Iterable[Collection[str]] = (),
    goal: Predicate | None = None,
    reaction: int = 1,
    suggest: bool = False,
) -> Proof:
    """Explore a setup and check it; see `verify` for the arguments."""
    exclusive = [*exclusive]

    def tried(setup: Setup) -> tuple[Exploration, list[Finding]]:
        predicates = [predicate for each in wanted for predicate in each.predicates]
        explored = Exploration(setup, predicates, goal)
        actions = explored.rig.kb.actions
        groups = [[actions[name].name for name in group] for group in exclusive]
        explore(explored)
        return explored, check(explored, reaction=reaction, exclusive=groups, wanted=wanted)

    explored, findings = tried(setup)
    if suggest and any(finding.holds is False for finding in findings):
        for text, mended in mends(setup):
            if all(finding.holds for finding in tried(mended)[1]):
                findings = [
                    replace(each, advice=text) if each.holds is False else each for each in findings
                ]
                break
    return Proof(setup, explored, tuple(findings), tuple(consequences(explored)), notes(explored))


def consequences(explored: Exploration) -> list[Consequence]:
    """Return the consequence of each single bad fact, and of each pair that ends the mission though neither does."""
    environment = explored.rig.environment
    single = {}
    for group in environment.alike:
        single[Change(group[0], True)] = group[1:]
    for name, value in environment.worst.items():
        single[Change(name, value)] = ()
    found = {bad: _consequence(explored, (bad,), alike) for bad, alike in single.items()}
    lasting = [bad for bad in single if found[bad].reaches == "the goal"]
    pairs = [_consequence(explored, pair) for pair in combinations(lasting, 2)]
    return [*found.values(), *(pair for pair in pairs if pair.reaches == "nothing")]


def _consequence(
    explored: Exploration, bad: Sequence[Change], alike: Sequence[str] = ()
) -> Consequence:
    """Return what is reached with these facts; a quality that a deed restores need not last."""
    failed = {change.name for change in bad if change.to is True}
    worst = {change.name: change.to for change in bad if change.to is not True}
    values = explored.values
    alone = {n for n in explored.caused() if explored.situations[n].facts.failed == failed}
    within = {n for n in alone if worst.items() <= values(n).items()}
    rounds = [each for each in explored.following(0) if each.is_caused]
    first = {each.after for each in rounds if {*each.step.changes} == {*bad}}
    reached = explored.reaching(explored.goals & within, within=within)
    reaches = "nothing"
    if reached:
        is_from_start = reached & (first or within)
        reaches = "the goal" if is_from_start else "the goal if it happens later"
    if reaches == "the goal":
        restoring = explored.reaching(explored.goals & alone, within=alone, still=True)
        for name in explored.rig.qualities - worst.keys():
            low = {n for n in alone if values(n)[name] == explored.rig.environment.worst[name]}
            if low and not low & restoring:
                reaches = f"the goal as long as {name} lasts"
    if not within or not (reached or explored.is_finished):
        reaches = "not explored"
    actions = {name for number in within for name in explored.known[number].required}
    return Consequence(tuple(map(str, bad)), reaches, tuple(sorted(actions)), tuple(alike))
