"""Leaves with a script, as a user would write them, that say what is done with them."""

from itertools import cycle

from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_bt import BehaviourRegistry

STATUS = {"S": Status.SUCCESS, "F": Status.FAILURE, "R": Status.RUNNING}


class Condition(Behaviour):
    """Says what is next in its script."""

    def __init__(self, name, script, said):
        super().__init__(name)
        self.script = script
        self.said = said

    def update(self):
        result = next(self.script)
        self.said.append(f"{self.name}:c:{result}")
        return STATUS[result]


class Action(Behaviour):
    """Does what is next in its script; says how it begins, goes on and is halted."""

    def __init__(self, name, script, said):
        super().__init__(name)
        self.script = script
        self.said = said
        self.hook = ""

    def initialise(self):
        assert not self.hook
        self.hook = "s"

    def update(self):
        assert self.hook
        result = next(self.script)
        self.said.append(f"{self.name}:{self.hook}:{result}")
        self.hook = "r"
        return STATUS[result]

    def terminate(self, new_status):
        if (
            new_status is Status.INVALID and self.status is Status.RUNNING
        ):  # py_trees stops what has finished, too
            self.said.append(f"{self.name}:halt")
        self.hook = ""


class Exact(Action):
    """Is never stopped but while it is running."""

    def terminate(self, new_status):
        assert new_status is not Status.INVALID or self.status is Status.RUNNING
        super().terminate(new_status)


def registry_of(leaves, said):
    """Return a registry of leaves, given as {tag: (kind, script)}.

    A leaf in several places has one script for all.
    """
    registry = BehaviourRegistry()
    for tag, (kind, script) in leaves.items():
        cls = Exact if kind == "A" else Condition
        steps = cycle(script)
        registry.register(tag, lambda name, cls=cls, tag=tag, steps=steps: cls(tag, steps, said))
    return registry


def trace(tick, root, said, ticks):
    """Return what is said in each tick and its outcome, as in the recorded traces."""
    lines = []
    for number in range(ticks):
        said.clear()
        tick()
        outcome = "SKIPPED" if root.status is Status.INVALID else root.status.name
        lines.append(f"{number}| {' '.join([*said, ''])}=> {outcome}")
    return lines


def wrapped(content, **trees):
    """Return a file with a main tree, and others by ID."""
    others = "".join(
        f'<BehaviorTree ID="{name}">{text}</BehaviorTree>' for name, text in trees.items()
    )
    main = f'<BehaviorTree ID="Main">{content}</BehaviorTree>'
    return f'<root BTCPP_format="4" main_tree_to_execute="Main">{main}{others}</root>'
