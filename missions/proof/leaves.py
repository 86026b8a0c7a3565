"""What leaves may answer: each in turn, while all that stands above them, and what asks the knowledge base, is real."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase, UnknownName
from missions.engine.mission import Condition
from missions.proof.planned import nodes
from missions.proof.surroundings import satisfied
from missions.testing.scripted import LETTERS, replace_work
from rosa_bt import RosaAction
from rosa_bt.behaviours import KbBehaviour
from rosa_pddl import PlanExecutor

Answer = tuple[str, str]
"""The name of a leaf, and the letter of what it returned: R, S or F."""

Values = Mapping[str, tuple[float, ...]]
"""By attribute, what can be measured."""

_CHANCE: Final = (py_trees.timers.Timer, py_trees.behaviours.ProbabilisticBehaviour)
"""Leaves of py_trees that decide by the wall clock or by dice; the others by what they are and remember."""


@dataclass(frozen=True)
class Leaf:
    """What a leaf may return, and what it does to facts.

    Attributes:
        answers: letters of "R", "S" and "F"; empty for a leaf that is left to work as it is.
        effects: attributes that are measured, with their values, when it returns what the letter says, such as
            {"S": {"battery_level": 1.0}}.
    """

    answers: str = "RSF"
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        wrong = [one for one in (*self.answers, *self.effects) if one not in LETTERS]
        if wrong:
            raise ValueError(f"a leaf answers with letters of R, S and F, not with {wrong[0]!r}")


class Choice(NamedTuple):
    """A leaf that is asked: its name, and the letters of what it may return."""

    name: str
    letters: str


class Choices:
    """Says what leaves answer in a tick: as scripted first, then the first letter; the same when asked again.

    Attributes:
        taken: the answers since `begin`.
        others: the beginnings of what could have been answered instead, each once.
        said: what was asked, of leaves and of others who note it here, with the answers.
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
        """Return what is answered next."""
        name, letters = asked
        place = len(self.taken)
        letter = self._script[place][1] if place < len(self._script) else letters[0]
        if place >= len(self._script):
            before = tuple(self.taken)
            self.others += [(*before, (name, other)) for other in letters[1:]]
        self.taken.append((name, letter))
        return letter


def usual(leaf: Behaviour, kb: KnowledgeBase, values: Values) -> Leaf:
    """Return what a leaf may return that nothing is declared of; what its schema promises comes true."""
    is_ours = isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction)
    is_known = type(leaf).__module__.startswith(("py_trees.", "rosa_bt.")) and not isinstance(leaf, RosaAction)
    if is_ours or (is_known and not isinstance(leaf, _CHANCE)):
        return Leaf("")
    promised = getattr(getattr(leaf, "schema", None), "makes_feasible", ())
    asked = defaultdict[str, list[tuple[str, float]]](list)
    for one in (needed for action in promised for needed in kb.actions[action].constraints):
        asked[one.attribute].append((one.operator, one.value))
    met = {name: max(values[name], key=partial(satisfied, those)) for name, those in asked.items()}
    return Leaf("FS") if isinstance(leaf, Condition) else Leaf(effects={"S": met} if met else {})


def take_over(
    root: Behaviour, kb: KnowledgeBase, declared: Mapping[str, Leaf], values: Values, choices: Choices
) -> dict[str, str]:
    """Have the leaves of a tree answer as is chosen, and return with what; an action is still requested and released.

    Raises:
        UnknownName: something is declared of a leaf that the tree does not have.
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
