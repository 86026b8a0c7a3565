"""The traces that BehaviorTree.CPP 4.10 itself gave, tick by tick, and what it did with SUAVE's tree."""

import json
from itertools import cycle
from pathlib import Path

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from rosa_bt.parsers import BehaviourRegistry, load_xml

HERE = Path(__file__).parent
RECORDED = json.loads((HERE / "btcpp_traces.json").read_text())
CASES = RECORDED["cases"]
STATUS = {"S": Status.SUCCESS, "F": Status.FAILURE, "R": Status.RUNNING}
SPOKEN = {Status.INVALID: "SKIPPED"}


class Condition(Behaviour):
    """Says what is next in its script."""

    def __init__(self, name, script, said):
        super().__init__(name)
        self.script, self.said = cycle(script), said

    def update(self):
        result = next(self.script)
        self.said.append(f"{self.name}:c:{result}")
        return STATUS[result]


class Action(Behaviour):
    """Does what is next in its script, and says how it begins, goes on and is halted."""

    def __init__(self, name, script, said):
        super().__init__(name)
        self.script, self.said = cycle(script), said
        self.hook = ""

    def initialise(self):
        assert not self.hook
        self.hook = "s"

    def update(self):
        result = next(self.script)
        self.said.append(f"{self.name}:{self.hook}:{result}")
        self.hook = "r"
        return STATUS[result]

    def terminate(self, new_status):
        if new_status is Status.INVALID:
            assert self.status is Status.RUNNING
            self.said.append(f"{self.name}:halt")
        self.hook = ""


def registry_of(leaves, said):
    registry = BehaviourRegistry()
    for tag, (kind, script) in leaves.items():
        cls = Action if kind == "A" else Condition
        registry.register(tag, lambda name, cls=cls, tag=tag, script=script, **ports: cls(tag, script, said))
    return registry


def trace(tree, said, ticks):
    lines = []
    for number in range(ticks):
        said.clear()
        tree.tick_once()
        outcome = SPOKEN.get(tree.status, tree.status.name)
        lines.append(f"{number}| {' '.join([*said, ''])}=> {outcome}")
    return lines


@pytest.mark.parametrize("case", [case for case in CASES if "xml" in case], ids=range(75))
def test_recorded_trace_is_reproduced(case):
    said = []
    tree = load_xml(case["xml"], registry_of(case["leaves"], said))
    assert trace(tree, said, len(case["trace"])) == case["trace"]
