"""Which deeds bring about what a mission senses: by the effects in its PDDL file, or as leaves declare."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from kb import KnowledgeBase
from missions.engine.mission import Mission, Percepts

Predicates = frozenset[str]
_FEASIBLE: Final = "action_feasible"


class Senses(Percepts):
    """Percepts of which some hold, and that note which ones are asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.holding: frozenset[str] = frozenset()
        self.asked: set[str] = set()

    def holds(self, key: str) -> bool:
        """Return whether a key holds now."""
        self.asked.add(key)
        return key in self.holding


@dataclass(frozen=True)
class Causes:
    """What the actions of a mission bring about.

    Attributes:
        effects: by PDDL action, the predicates that it makes true.
        enables: by PDDL action, the actions that it makes feasible.
        goal: the predicates of the goal that some action makes true.
        facts: returns what is sensed, as facts of the PDDL problem.
        classes: by PDDL action, what does it.
    """

    effects: Mapping[str, Predicates] = field(default_factory=dict)
    enables: Mapping[str, frozenset[str]] = field(default_factory=dict)
    goal: Predicates = frozenset()
    facts: Callable[[KnowledgeBase, Percepts], Mapping[str, bool | float]] | None = None
    classes: Mapping[str, Any] = field(default_factory=dict)

    def schema_of(self, leaf: Behaviour) -> str:
        """Return the name of the PDDL action that a leaf does; empty if there is none."""
        for name, does in self.classes.items():
            if type(leaf) is does or getattr(leaf, "action", None) == name:
                return name
        return ""

    def needed(self, leaf: Behaviour, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates of which one has to be brought about before a condition can succeed.

        Empty if it may succeed before anything is done, or if that is not known.
        """
        if self.facts is None:
            return frozenset()
        keys: set[str] = set()
        while True:
            senses.asked, senses.holding = set(), frozenset(keys)
            succeeds = leaf.update() is Status.SUCCESS
            if senses.asked <= keys:
                break
            keys |= senses.asked
        made = {key: self._predicates(key, kb, senses) for key in keys}
        senses.holding = frozenset(key for key in keys if not made[key])
        is_free = leaf.update() is Status.SUCCESS
        senses.holding = frozenset()
        return frozenset().union(*made.values()) if succeeds and not is_free else frozenset()

    def _predicates(self, key: str, kb: KnowledgeBase, senses: Senses) -> Predicates:
        """Return the predicates that a percept makes true and that some action brings about."""
        assert self.facts is not None
        senses.holding = frozenset()
        before = self.facts(kb, senses)
        senses.holding = frozenset({key})
        after = self.facts(kb, senses)
        new = {fact for fact, is_so in after.items() if is_so is True and not before.get(fact)}
        brought = frozenset().union(*self.effects.values())
        return frozenset(fact.strip("()").split()[0].lower() for fact in new) & brought


def causes_of(mission: Mission) -> Causes:
    """Return what the actions of a mission bring about, as its PDDL says; nothing if it has none."""
    texts = _texts(mission)
    effects: dict[str, Predicates] = {}
    enables: dict[str, frozenset[str]] = {}
    goals: list[list[str]] = []
    for kind, *fields in [part for text in texts for part in _read(text)]:
        if kind in (":action", ":durative-action"):
            parts = dict(zip(fields[1::2], fields[2::2], strict=False))
            atoms = [*_atoms(parts.get(":effect") or [])]
            effects[fields[0]] = frozenset(atom[0] for atom in atoms) - {_FEASIBLE}
            conditions = _atoms(parts.get(":condition") or parts.get(":precondition") or [])
            names = {atom[-1]: atom[0].removesuffix("_action") for atom in conditions}
            targets = [atom[1] for atom in atoms if atom[0] == _FEASIBLE]
            enables[fields[0]] = frozenset(names.get(target, target) for target in targets)
        elif kind == ":goal":
            goals = [*_atoms(fields)]
    brought = frozenset().union(*effects.values())
    goal = frozenset(atom[0] for atom in goals) & brought
    return Causes(effects, enables, goal, mission.facts if texts else None, mission.actions)


def _texts(mission: Mission) -> tuple[str, ...]:
    """Return the texts of the domain and the problem of a mission, as far as it has them."""
    texts = list[str]()
    for source in (mission.domain, mission.problem):
        if source is not None:
            texts.append(source.read_text() if isinstance(source, Path) else source())
    return tuple(texts)


def _read(text: str) -> list[Any]:
    """Return the parts of a PDDL text as nested lists of words."""
    stack: list[list[Any]] = [[]]
    for word in re.findall(r"[()]|[^\s()]+", re.sub(r";.*", "", text.lower())):
        if word == "(":
            stack.append([])
        elif word == ")":
            closed = stack.pop()
            stack[-1].append(closed)
        else:
            stack[-1].append(word)
    return [part for part in stack[0][0] if isinstance(part, list) and part]


def _atoms(formula: list[Any]) -> Iterable[list[str]]:
    """Yield the atoms of a formula that are not negated."""
    if not formula or formula[0] == "not":
        return
    parts = [part for part in formula if isinstance(part, list)]
    if not parts:
        yield formula
    for part in parts:
        yield from _atoms(part)
