"""The other side: what it takes to adapt the vehicle by a behaviour tree and modes, counted of the manager `bt`."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from py_trees.behaviour import Behaviour

from kb import KnowledgeBase, Model
from missions.baselines import modes as modes_module
from missions.baselines.bt import TreeManager
from missions.baselines.controller import BaselineController
from missions.baselines.manager import Manager
from missions.baselines.opening import open_run
from missions.engine.mission import Mission, MissionError, Percepts
from missions.experiments.effort_source import Module, Written, built, code_lines
from missions.suave.world import SEA

__all__ = ["ByHand", "TreeCount", "by_hand", "count_tree", "is_managed_by_tree"]

MODES_FILE = Path(modes_module.__file__).with_name("modes.toml")


@dataclass(frozen=True, slots=True)
class TreeCount:
    """How large the tree that manages is.

    Attributes:
        nodes: of the whole tree, task and adaptation.
        task_nodes: of the mission's own tree, which has the task only.
        modes: modes and the values in them, of the functions whose component the mission has.
    """

    nodes: int
    task_nodes: int
    modes: int

    @property
    def adaptation_nodes(self) -> int:
        """Nodes without those of the task."""
        return self.nodes - self.task_nodes

    @property
    def total(self) -> int:
        """What is there for the sake of adaptation."""
        return self.adaptation_nodes + self.modes


@dataclass(frozen=True, slots=True)
class ByHand:
    """What was written for the tree that manages.

    Attributes:
        tree: the functions that build it.
        kinds: the kinds of nodes that it needs beside those of py_trees.
        rest: the manager that ticks it, and constants.
        modes: the file with the modes [lines].
    """

    tree: Written
    kinds: Written
    rest: Written
    modes: int


def is_managed_by_tree(mission: Mission) -> bool:
    """Tell whether the manager `bt` can run a mission: those in the sea."""
    return mission.world is SEA


def count_tree(mission: Mission) -> TreeCount:
    """Count the nodes of the tree that the manager `bt` builds for a mission in the sea, and its modes.

    Raises:
        MissionError: the mission cannot be opened under that manager.
    """
    run = open_run(mission, manager=TreeManager)
    assert isinstance(run.controller, BaselineController)
    try:
        tree = _tree_of(TreeManager(run.controller.robot))
    finally:
        run.world.close()
    model = mission.model()
    given = KnowledgeBase(model), Percepts()
    task = built(f"the tree of {mission.name}", Behaviour, mission.tree, *given)  # type: ignore[type-abstract]  # only asked about
    return TreeCount(_nodes(tree), _nodes(task), _modes(model))


def by_hand() -> ByHand:
    """Measure the source of the manager `bt` and its modes.

    Raises:
        MissionError: the source is not there.
    """
    module = Module.of(TreeManager.__module__)
    if module is None:
        raise MissionError("the source of the manager bt is not installed; its lines cannot be counted")
    sizes = {"tree": Written(0, 0), "kinds": Written(0, 0), "rest": Written(0, 0)}
    for name in module.definitions:
        meaning = getattr(module.module, name)
        is_kind = isinstance(meaning, type) and issubclass(meaning, Behaviour)
        part = "kinds" if is_kind else "rest" if isinstance(meaning, type) or not callable(meaning) else "tree"
        if name != "__all__":
            sizes[part] = sizes[part].plus(module.measure(name))
    return ByHand(**sizes, modes=code_lines(MODES_FILE.read_text(encoding="utf-8"), "#"))


def _tree_of(manager: Manager) -> Behaviour:
    return next(value for value in vars(manager).values() if isinstance(value, Behaviour))


def _nodes(root: Behaviour) -> int:
    return sum(1 for _ in root.iterate())


def _modes(model: Model) -> int:
    functions = tomllib.loads(MODES_FILE.read_text(encoding="utf-8")).values()
    needed = [one for one in functions if one["component"] in model.components]
    return sum(1 + len(values) for one in needed for values in one["modes"].values())
