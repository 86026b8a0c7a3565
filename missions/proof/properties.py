"""What must hold in every situation, and how a situation in which it does not is found."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.composites import Sequence as SequenceNode

from missions.proof.exploration import Exploration, Round, Situation, Wrong
from missions.proof.rig import Step, acting

Predicate = Callable[[Any], bool]
"""Called with the `Rig` in a situation."""
Check = Callable[[Exploration], Iterator[Wrong]]
"""Yields what is wrong, the worst first."""
Property = tuple[str, Check]
"""What should hold, in words, and how a violation is found."""


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


def always(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after every tick."""
    return never(name, lambda rig: not predicate(rig))


def never(name: str, predicate: Predicate) -> Property:
    """Require that a predicate holds after no tick."""

    def find(explored: Exploration) -> Iterator[Wrong]:
        for situation in _where(explored, predicate):
            yield "it is violated then", situation.path

    return name, find


def eventually(name: str, predicate: Predicate) -> Property:
    """Require that a predicate can still come to hold from every situation."""
    return leads_to(name, lambda rig: True, predicate)


def leads_to(name: str, first: Predicate, then: Predicate) -> Property:
    """Require that `then` can still come to hold whenever `first` holds."""

    def find(explored: Exploration) -> Iterator[Wrong]:
        good = explored.reaching([*_where(explored, then), *explored.unexplored])
        bad = {*explored.caused()} - good
        for situation in _where(explored, first):
            if situation in bad:
                yield "it cannot come about any more", situation.path

    return name, find


def _where(explored: Exploration, predicate: Predicate) -> list[Situation]:
    """Return the situations in which a predicate holds."""
    return [each for each in explored.situations if predicate(explored.load(each.state))]


def check(explored: Exploration) -> list[Finding]:
    """Check the properties that every mission must have, then those wanted."""
    findings = []
    for name, find in (*CHECKS, *explored.rig.setup.wanted):
        what, trail = next(find(explored), ("", None))
        if trail is None and explored.unexplored:
            findings.append(Finding(name, None))
        else:
            findings.append(Finding(name, not what, what, trail))
    return findings


def notes(explored: Exploration) -> list[str]:
    """Return what is no mistake, but good to know."""
    rig = explored.rig
    what = "requests actions by itself: its requests are followed"
    requesting = [f"{leaf.name} {what}" for leaf in rig.requesting]
    done = {node.action for node in rig.doing}
    others = [f"{name} is not done by this tree" for name in rig.kb.actions if name not in done]
    return requesting or others


def _unfeasible(explored: Exploration) -> Iterator[Wrong]:
    for situation in explored.situations:
        for each in situation.rounds:
            for action in each.late:
                if action in each.after.required and action not in each.after.feasible:
                    yield f"{action} is still requested", [*situation.path, each.step]


def _unreleased(explored: Exploration) -> Iterator[Wrong]:
    for situation in explored.situations:
        for action in sorted(situation.running ^ {*situation.required}):
            what = f"{action} is still requested, and nothing that does it runs"
            if action in situation.running:
                what = f"{action} is not requested any more, and what does it still runs"
            yield what, situation.path


def _unachieved(explored: Exploration) -> Iterator[Wrong]:
    if explored.goals.isdisjoint(explored.caused()):
        yield "it is never reached", None


def _ends_without(explored: Exploration) -> Iterator[Wrong]:
    """Find an end of the mission that is not its goal, by deeds that bring about what succeeds."""
    for situation in explored.caused():
        if situation.has_succeeded and (what := explored.misses(situation)):
            yield what, situation.path


def _stuck(explored: Exploration) -> Iterator[Wrong]:
    """Find a situation without an end while facts stay, though its stage has an end."""
    ended = [situation for situation in explored.situations if situation.has_succeeded]
    good = explored.reaching([*ended, *explored.unexplored], changes=[None])
    goals = explored.goals
    possible = {_stage(situation) for situation in explored.reaching(goals, changes=[None]) - goals}
    for situation in explored.situations:
        if situation not in good and _stage(situation) in possible:
            yield "it is not then, but elsewhere in this stage with the same facts", situation.path


def _stage(situation: Situation) -> tuple[object, ...]:
    """Return how far the mission is, and with which facts that the robot does not decide."""
    _, facts, deeds = situation.state
    outside = [fact for fact in facts if fact.kind in ("attribute", "component")]
    return situation.stage, deeds, *outside


def _dead(explored: Exploration) -> Iterator[Wrong]:
    """Find a situation in which nothing is required until the robot itself acts."""
    active = [each for each in explored.situations if each.required or each.has_succeeded]
    outside = explored.rig.environment.outside
    alive = explored.reaching([*active, *explored.unexplored], changes=outside)
    for situation in explored.situations:
        is_known = all(fact.value is not None for fact in situation.facts if fact.kind != "action")
        able = {
            node.action
            for node in explored.rig.doing
            if situation.feasible.issuperset([node.action, *_before(node)])
        }
        if able and is_known and situation not in alive:
            what = f"nothing is required, though {' and '.join(sorted(able))} could be done"
            yield what, situation.path


def _before(node: Behaviour) -> Iterator[str]:
    """Yield the actions that stand before a node in sequences."""
    while (parent := node.parent) is not None:
        if isinstance(parent, SequenceNode):
            for child in parent.children[: parent.children.index(node)]:
                yield from (each.action for each in acting(child.iterate()))
        node = parent


def _wavering(explored: Exploration) -> Iterator[Wrong]:
    """Find a cycle of different requests while no answer changes."""
    letters = explored.rig.letters
    for kept in "FS":
        usual = {name: "R" if "R" in letters[name] else kept for name in letters}
        onward: dict[Situation, Round] = {}
        for situation in explored.situations:
            for each in situation.rounds:
                is_usual = all(usual[name] == letter for name, letter in each.step.answers)
                if each.step.change is None and is_usual:
                    onward.setdefault(situation, each)
        for start in onward:
            situation = start
            trail: dict[Situation, Step] = {}
            while situation in onward and situation not in trail:
                trail[situation] = onward[situation].step
                situation = onward[situation].after
            done = {", ".join(each.required) or "nothing" for each in trail}
            if situation is start and len(done) > 1:
                what = f"it goes to and fro between {' and '.join(sorted(done))}"
                yield what, [*start.path, *trail.values()]


def _unreached(explored: Exploration) -> Iterator[Wrong]:
    rig = explored.rig
    names = dict.fromkeys(node.name for node in rig.nodes if node not in rig.ticked)
    if names:
        yield f"never ticked: {', '.join(names)}", None


def _missing(explored: Exploration) -> Iterator[Wrong]:
    """Find the actions of the tree, the designs and the configurations that never occur."""
    rig = explored.rig
    facts = {fact for facts in explored.settled.values() for fact in facts}
    expected = {("action", node.action) for node in rig.doing}
    # without failures, what is there for them cannot occur; what leaves measure and choose neither
    if rig.setup.failures and not rig.environment.told:
        kinds = ("function design", "configuration")
        expected |= {fact[:2] for fact in facts if fact.kind in kinds}
    occurring = {fact[:2] for fact in facts if fact.value not in (None, False)}
    missing = sorted(f"{kind} {name}" for kind, name in expected - occurring)
    if missing:
        yield f"never: {', '.join(missing)}", None


CHECKS: Final[list[Property]] = [
    ("nothing is requested while unfeasible for longer than a tick", _unfeasible),
    ("every request is released once, when what does it ends", _unreleased),
    ("the goal is reached if all goes well", _unachieved),
    ("the mission ends with its goal only", _ends_without),
    ("wherever the goal can be reached as facts are, the mission is not stuck", _stuck),
    ("it never stands still for good while an action of it is feasible", _dead),
    ("while nothing happens, the mission does not waver", _wavering),
    ("every node of the tree can be reached", _unreached),
    ("every adaptation of the model can occur", _missing),
    (
        "the manager keeps to the model, and ends its plans",
        lambda explored: iter(explored.faults.items()),
    ),
]
"""What every mission must keep, and how a violation is found."""
