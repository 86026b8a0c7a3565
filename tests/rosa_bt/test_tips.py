"""What py_trees users do with a whole tree goes through every node: setup, shutdown and tip."""

from typing import ClassVar

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Success
from py_trees.common import Status
from xml_leaves import wrapped

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, ForAction, TreeRunner, load_xml, switch_safely
from rosa_bt.composites import DoUntilUnfeasible
from rosa_bt.decorators import UntilSuccess
from rosa_bt.xml.controls import NODES


class Device(Behaviour):
    """Runs for ever, and says what is done with it besides ticks."""

    said: ClassVar[list[tuple[str, object]]] = []

    def update(self):
        return Status.RUNNING

    def setup(self, **given):
        self.said.append(("setup", given["node"]))

    def shutdown(self):
        self.said.append(("shutdown", self.name))


def within_every_node(leaf, kb):
    """Return trees with a leaf below each kind of node that there is."""
    registry = BehaviourRegistry(kb=kb)
    registry.register("leaf", leaf)
    registry.register("under", lambda name, child: ForAction(name, kb, "scan", child))
    ports = {
        "Repeat": "num_cycles",
        "RetryUntilSuccessful": "num_attempts",
        "Delay": "delay_msec",
        "Timeout": "msec",
        "PersistentSequence": "current_child_idx",
    }
    needed = {
        **{tag: f'{port}="{0 if tag[0] == "P" else 3}"' for tag, port in ports.items()},
        "Precondition": 'if="true"',
    }
    needed |= dict.fromkeys(("SkipUnlessUpdated", "WaitValueUpdate"), 'entry="x"')
    needed |= dict.fromkeys(("LoopInt", "LoopDouble", "LoopBool", "LoopString"), 'queue="1;1"')
    for tag, kind in [one for one in NODES.items() if one[1].CHILDREN[1]]:
        count = max(kind.CHILDREN[0], 2 if kind.CHILDREN[1] > 1 else 1)
        tree = f"<{tag} {needed.get(tag, '')}>{'<leaf/>' * count}</{tag}>"
        yield count, load_xml(wrapped(f"<under>{tree}</under>"), registry)
    yield 1, UntilSuccess("until", leaf("leaf"))
    yield 2, DoUntilUnfeasible("do", leaf("leaf"), leaf("leaf"))
    yield (
        2,
        switch_safely(
            ForAction("scan", kb, "scan", leaf("leaf")), {("scan", "scan"): leaf("leaf")}
        ),
    )


def test_every_node_passes_on_setup_and_shutdown_and_its_tip_is_what_is_running():
    model = Model("rover")
    model.action("scan")
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    tips = 0
    for count, root in within_every_node(Device, kb):
        Device.said.clear()
        runner = TreeRunner(root, clock=lambda: 0.0)
        runner.tree.setup(node="the node")
        assert Device.said == [("setup", "the node")] * count
        assert root.tip() is None
        runner.tick()
        running = [
            one
            for one in root.iterate()
            if isinstance(one, Device) and one.status is Status.RUNNING
        ]
        if running:
            assert root.tip() in running, root.name
            tips += 1
        runner.shutdown()
        assert Device.said[count:] == [("shutdown", "leaf")] * count
        assert root.tip() is None
    assert tips > 30


@pytest.mark.parametrize(
    ("content", "tip"),
    [
        ("<Sequence><yes/><no/><yes/></Sequence>", "no"),
        ("<Fallback><no/><Inverter><no name='last'/></Inverter><yes/></Fallback>", "last"),
        ("<ReactiveSequence><yes/><yes name='last'/></ReactiveSequence>", "last"),
        ("<Parallel success_count='1'><no/><no name='bad'/><yes/></Parallel>", "no"),
        ("<Parallel success_count='1' failure_count='3'><no/><yes/><no/></Parallel>", "yes"),
        ("<IfThenElse><no/><yes/><yes name='else'/></IfThenElse>", "else"),
        ("<TryCatch><no/><yes/></TryCatch>", "no"),
        ("<Inverter><Fallback><yes/></Fallback></Inverter>", "yes"),
    ],
)
def test_tip_is_what_decided_last(content, tip):
    registry = BehaviourRegistry()
    registry.register("yes", lambda name: Success(name))
    registry.register("no", lambda name: Failure(name))
    tree = load_xml(wrapped(content), registry)
    tree.tick_once()
    assert tree.tip().name == tip
