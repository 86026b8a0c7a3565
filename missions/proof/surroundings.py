"""What can happen: values that can be measured, components that can fail, and answers of leaves.

The composites and decorators above the leaves, and the leaves that ask the knowledge base, are the real ones.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, pairwise
from math import inf
from typing import Any, Final, NamedTuple

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import Event, KnowledgeBase, UnknownName
from kb.elements import Attribute, Constraint
from kb.status import OPERATORS
from missions.engine.mission import Condition
from missions.proof.planned import nodes
from missions.testing.scripted import LETTERS, replace_work
from rosa_bt import RosaAction
from rosa_bt.behaviours import HasStatus, KbBehaviour, Measurement
from rosa_pddl import PlanExecutor

STALE = "stale"


class Change(NamedTuple):
    """One change of a fact: an attribute is measured or goes stale, a component fails (True) or recovers (False)."""

    name: str
    to: float | bool | str

    def __str__(self) -> str:
        if isinstance(self.to, bool):
            return f"{self.name} {'fails' if self.to else 'recovers'}"
        return f"{self.name} is stale" if self.to == STALE else f"{self.name} is measured {self.to:g}"

    def tell(self, kb: KnowledgeBase) -> None:
        if isinstance(self.to, bool):
            (kb.component_failed if self.to else kb.component_recovered)(self.name)
        elif isinstance(self.to, float):
            kb.measure(self.name, self.to)
        else:
            kb.tell(Event(kb.log.last + 1, kb.now, STALE, (self.name,)))


class Surroundings:
    """All facts of a model that can change, with one value for each difference that values make.

    Args:
        kb: of the robot.
        root: of the tree, whose own conditions on measurements count too.
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, further thresholds that the tree or a property compares with.
        failing: the components that can fail; None for all.
        symmetric: of several components that the model does not distinguish, let only the first fail.

    Attributes:
        failures: how many components are failed at once at most.
        at_once: how many facts change between two ticks at most.
        values: by attribute, one value for each difference.
        alike: the components that can fail, in groups that the model does not distinguish.
        worst: by attribute, the value that satisfies the fewest constraints.
    """

    def __init__(
        self,
        kb: KnowledgeBase,
        root: Behaviour,
        *,
        failures: int = 1,
        at_once: int = 1,
        values: Mapping[str, Iterable[float]] | None = None,
        failing: Iterable[str] | None = None,
        symmetric: bool = True,
    ) -> None:
        self._kb, self.failures, self.at_once = kb, failures, at_once
        asked = _thresholds(kb, root)
        for name, more in (values or {}).items():
            asked[kb.attributes[name].name] |= {(">=", float(one)) for one in more}
        known = kb.model.attributes
        self.values = {name: _distinct(asked[name], known[name]) for name in kb.attributes if asked[name]}
        self.worst = {name: min(found, key=partial(_satisfied, asked[name])) for name, found in self.values.items()}
        names = list(kb.components) if failing is None else [kb.components[one].name for one in failing]
        named = {one.element.name for one in nodes(root) if isinstance(one, HasStatus)}
        self.alike = _alike(kb, names, named) if symmetric else [(one,) for one in names]
        self._ageing = [name for name in self.values if kb.model.attributes[name].max_age != inf]

    def failed(self) -> tuple[str, ...]:
        """Return the components that are reported failed now."""
        return tuple(name for name, one in self._kb.components.items() if one.status == "failure")

    def changes(self) -> Iterator[tuple[Change, ...]]:
        """Yield the sets of changes that can happen next, beginning with the empty one."""
        single = [one for name in self.values for one in self._measured(name)]
        down = self.failed()
        single += [Change(broken[-1], False) for alike in self.alike if (broken := [o for o in alike if o in down])]
        single += [Change(working[0], True) for alike in self.alike if (working := [o for o in alike if o not in down])]
        for count in range(self.at_once + 1):
            for chosen in combinations(single, count):
                more = sum(1 if one.to else -1 for one in chosen if isinstance(one.to, bool))
                if len({one.name for one in chosen}) == count and (more <= 0 or len(down) + more <= self.failures):
                    yield chosen

    def _measured(self, name: str) -> Iterator[Change]:
        view = self._kb.attributes[name]
        repeats = self._kb.model.attributes[name].agreement != (1, 1)
        for value in self.values[name]:
            if repeats or view.is_stale or value != view.value:
                yield Change(name, value)
        if name in self._ageing and view.value is not None and not view.is_stale:
            yield Change(name, STALE)


def _satisfied(asked: Iterable[tuple[str, float]], value: float) -> int:
    """Return how many comparisons (operator, threshold) a value satisfies."""
    return sum(OPERATORS[sign](value, of) for sign, of in asked)


def _thresholds(kb: KnowledgeBase, root: Behaviour) -> defaultdict[str, set[tuple[str, float]]]:
    """Return the comparisons of each attribute in the model and in the conditions of the tree."""
    found: defaultdict[str, set[tuple[str, float]]] = defaultdict(set)
    for elements in (kb.actions, kb.designs, kb.components, kb.configurations):
        for element in elements.values():
            for one in (view.element for view in element.constraints):
                assert isinstance(one, Constraint)
                found[one.attribute] |= {(one.operator, one.value + side * one.hysteresis) for side in (1, 0, -1)}
    for leaf in nodes(root):
        if isinstance(leaf, Measurement):
            found[leaf.attribute.name].add((leaf.operator, leaf.value))
    return found


def _distinct(asked: set[tuple[str, float]], attribute: Attribute) -> tuple[float, ...]:
    """Return values of an attribute, one for each possible combination of results of the comparisons."""
    low, high = attribute.low, attribute.high
    known = sorted({value for _, value in asked})
    below = (low + known[0]) / 2 if low > -inf else known[0] - 1.0
    above = (known[-1] + high) / 2 if high < inf else known[-1] + 1.0
    between = [(one + other) / 2 for one, other in pairwise(known)]
    found: dict[tuple[bool, ...], float] = {}
    for value in (below, *between, above, *known):
        if low <= value <= high:
            found.setdefault(tuple(OPERATORS[sign](value, of) for sign, of in sorted(asked)), value)
    return tuple(sorted(found.values()))


def _alike(kb: KnowledgeBase, names: Iterable[str], named: set[str]) -> list[tuple[str, ...]]:
    """Group components that nothing distinguishes; one that the tree asks for by name is alone."""
    groups: defaultdict[object, list[str]] = defaultdict(list)
    for name in names:
        view = kb.components[name]
        users = frozenset(design for design, one in kb.designs.items() if name in one.components)
        is_plain = not view.configurations and not view.constraints and name not in named
        groups[(users, view.kind, view.always_improve) if is_plain else name].append(name)
    return [tuple(group) for group in groups.values()]


Answer = tuple[str, str]
"""The name of a leaf, and the letter of what it returned: R, S or F."""

Values = Mapping[str, tuple[float, ...]]
"""By attribute, what can be measured."""

_CHANCE: Final = (py_trees.timers.Timer, py_trees.behaviours.ProbabilisticBehaviour)
"""Leaves of py_trees that decide by the wall clock or by chance; all others are deterministic."""


@dataclass(frozen=True)
class Leaf:
    """What a leaf may return, and what it does to facts.

    Attributes:
        answers: letters of "R", "S" and "F"; empty: the leaf works as it is.
        effects: by letter, the attributes that are measured when it returns that, such as
            {"S": {"battery_level": 1.0}}.
    """

    answers: str = "RSF"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        wrong = [one for one in (*self.answers, *self.effects) if one not in LETTERS]
        if wrong:
            raise ValueError(f"a leaf answers with letters of R, S and F, not with {wrong[0]!r}")


class Choice(NamedTuple):
    """A question to a leaf: its name, and the letters that it may return."""

    name: str
    letters: str


class Choices:
    """Decides what leaves answer in a tick: first by a script, then the first letter; a leaf asked again says the same.

    Attributes:
        taken: the answers since `begin`.
        others: scripts for the answers that were possible but not taken, each once.
        said: all questions with their answers: to leaves, and to the knowledge base (see `Tape`).
    """

    def __init__(self) -> None:
        self.taken: list[Answer] = []
        self.said: list[tuple[Any, object]] = []
        self._script: tuple[Answer, ...] = ()
        self.others: list[tuple[Answer, ...]] = []
        self._said: dict[Behaviour, str] = {}

    def begin(self, script: tuple[Answer, ...]) -> None:
        self.taken, self.said, self._script, self.others, self._said = [], [], script, [], {}

    def choose(self, leaf: Behaviour, letters: str) -> str:
        if leaf not in self._said:
            asked = Choice(leaf.name, letters)
            self._said[leaf] = letter = self.take(asked)
            self.said.append((asked, letter))
        return self._said[leaf]

    def take(self, asked: Choice) -> str:
        """Return the next answer, and note the other possible ones in `others`."""
        name, letters = asked
        place = len(self.taken)
        letter = self._script[place][1] if place < len(self._script) else letters[0]
        if place >= len(self._script):
            before = tuple(self.taken)
            self.others += [(*before, (name, other)) for other in letters[1:]]
        self.taken.append((name, letter))
        return letter


def usual(leaf: Behaviour, kb: KnowledgeBase, values: Values) -> Leaf:
    """Return what an undeclared leaf may return; on success, what its schema makes feasible becomes so."""
    is_ours = isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction)
    is_known = type(leaf).__module__.startswith(("py_trees.", "rosa_bt.")) and not isinstance(leaf, RosaAction)
    if is_ours or (is_known and not isinstance(leaf, _CHANCE)):
        return Leaf("")
    promised = getattr(getattr(leaf, "schema", None), "makes_feasible", ())
    asked = defaultdict[str, list[tuple[str, float]]](list)
    for one in (needed for action in promised for needed in kb.actions[action].constraints):
        asked[one.attribute].append((one.operator, one.value))
    met = {name: max(values[name], key=partial(_satisfied, those)) for name, those in asked.items()}
    return Leaf("FS") if isinstance(leaf, Condition) else Leaf(effects={"S": met} if met else {})


def take_over(
    root: Behaviour, kb: KnowledgeBase, declared: Mapping[str, Leaf], values: Values, choices: Choices
) -> dict[str, str]:
    """Replace the work of leaves by chosen answers; return their letters by name. Actions are still requested.

    Raises:
        UnknownName: a declaration names a leaf that the tree does not have.
    """
    leaves = [one for one in nodes(root) if not one.children and not isinstance(one, PlanExecutor)]
    for name in declared:
        if name not in {leaf.name for leaf in leaves}:
            raise UnknownName("leaf", name, dict.fromkeys(leaf.name for leaf in leaves))
    letters: dict[str, str] = {}
    for leaf in leaves:
        said = declared.get(leaf.name) or usual(leaf, kb, values)
        if said.answers:
            replace_work(leaf, partial(_answered, leaf, said, kb, choices))
            letters[leaf.name] = said.answers
    return letters


def _answered(leaf: Behaviour, said: Leaf, kb: KnowledgeBase, choices: Choices) -> Status:
    letter = choices.choose(leaf, said.answers)
    for attribute, value in said.effects.get(letter, {}).items():
        kb.measure(attribute, value)
    return LETTERS[letter]
