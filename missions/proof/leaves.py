"""What leaves may answer: each in turn, while all that stands above them, and what asks the knowledge base, is real."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import nan
from typing import Any, Final, NamedTuple

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase, UnknownName
from kb.status import OPERATORS
from kb.views import ConstraintView
from missions.engine.mission import Condition
from missions.proof.planned import nodes
from missions.testing.scripted import LETTERS
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


class Played(Choices):
    """Answers as in a story, of which each tick has its own time."""

    def __init__(self, scripts: Mapping[float, tuple[Answer, ...]], clock: Callable[[], float]) -> None:
        super().__init__()
        self._scripts, self._clock, self._at = scripts, clock, nan

    def choose(self, leaf: Behaviour, letters: str) -> str:
        if self._clock() != self._at:
            self._at = self._clock()
            self.begin(self._scripts.get(self._at, ()))
        return super().choose(leaf, letters)


def usual(leaf: Behaviour, kb: KnowledgeBase, values: Values) -> Leaf:
    """Return what a leaf may return that nothing is declared of; what its schema promises comes true."""
    is_ours = isinstance(leaf, KbBehaviour) and not isinstance(leaf, RosaAction)
    is_known = type(leaf).__module__.startswith(("py_trees.", "rosa_bt.")) and not isinstance(leaf, RosaAction)
    if is_ours or (is_known and not isinstance(leaf, _CHANCE)):
        return Leaf("")
    promised = getattr(getattr(leaf, "schema", None), "makes_feasible", ())
    needed = [one for action in promised for one in kb.actions[action].constraints]
    met = {one.attribute: max(values[one.attribute], key=partial(_met, needed, one.attribute)) for one in needed}
    return Leaf("FS") if isinstance(leaf, Condition) else Leaf(effects={"S": met} if met else {})


def _met(needed: Iterable[ConstraintView], name: str, value: float) -> int:
    return sum(OPERATORS[one.operator](value, one.value) for one in needed if one.attribute == name)


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
            vars(leaf).update(_own(leaf, said, kb, choices))
            letters[leaf.name] = said.answers
    return letters


def _own(leaf: Behaviour, said: Leaf, kb: KnowledgeBase, choices: Choices) -> dict[str, Callable[..., object]]:
    def update() -> Status:
        letter = choices.choose(leaf, said.answers)
        for attribute, value in said.effects.get(letter, {}).items():
            kb.measure(attribute, value)
        return LETTERS[letter]

    own: dict[str, Callable[..., object]] = {
        "update": update,
        "initialise": lambda: None,
        "terminate": lambda new_status: None,
    }
    if isinstance(leaf, RosaAction):
        own |= {"save_progress": lambda: None, "restore_progress": lambda progress: None}
    return own
