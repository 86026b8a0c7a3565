"""The idioms are written as the nodes that they are made of, and do the same when they are read again."""

from random import Random
from xml.etree import ElementTree

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import PortInformation, PortsMixin
from xml_leaves import wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    ExportError,
    ForAction,
    RosaAction,
    TreeRunner,
    XmlError,
    do_until_unfeasible,
    export_xml,
    feasible_then_act,
    first_feasible,
    load_xml,
    switch_safely,
)
from rosa_bt.decorators import UntilSuccess

ACTIONS = ("scan", "drive", "charge")


class Work(RosaAction):
    """Takes three ticks; each third time it fails."""

    rounds = 0

    def initialise(self):
        self.left = 3
        self.rounds += 1

    def update(self):
        self.left -= 1
        return (
            Status.RUNNING
            if self.left
            else Status.FAILURE
            if self.rounds % 3 == 0
            else Status.SUCCESS
        )


class Turn(Behaviour):
    """Takes two ticks."""

    def initialise(self):
        self.left = 2

    def update(self):
        self.left -= 1
        return Status.RUNNING if self.left else Status.SUCCESS


def rover(now):
    model = Model("rover")
    for name in ACTIONS:
        model.action(name, constraints=[model.environmental_attribute(f"for_{name}") >= 0.5])
    return KnowledgeBase(model, clock=lambda: now[0])


def work(kb, name):
    return Work(name, kb, name)


IDIOMS = {
    "feasible": lambda kb: feasible_then_act(work(kb, "scan")),
    "first": lambda kb: first_feasible("first", [work(kb, name) for name in ACTIONS]),
    "first that goes on": lambda kb: first_feasible(
        "first", [work(kb, name) for name in ACTIONS], memory=True
    ),
    "until": lambda kb: do_until_unfeasible(work(kb, "scan"), work(kb, "charge")),
    "until, to the end": lambda kb: do_until_unfeasible(
        work(kb, "scan"), work(kb, "charge"), memory=True
    ),
    "subtree": lambda kb: do_until_unfeasible(
        UntilSuccess("again", first_feasible("either", [work(kb, "scan"), work(kb, "drive")])),
        work(kb, "charge"),
    ),
    "under an action": lambda kb: ForAction(
        "for", kb, "scan", Turn("turn"), preference="for_scan", wait=True, timeout=3
    ),
    "switching": lambda kb: switch_safely(
        do_until_unfeasible(
            work(kb, "scan"), first_feasible("or", [work(kb, "drive"), work(kb, "charge")])
        ),
        {
            ("scan", "charge"): Turn("down"),
            ("charge", "scan"): Turn("up"),
            ("drive", "scan"): Turn("back"),
        },
    ),
}


def lived(build, seed):
    """Return what a tree did and what the knowledge base came to know, tick by tick."""
    now, random = [0.0], Random(seed)
    kb = rover(now)
    runner = TreeRunner(build(kb), clock=lambda: now[0])
    told = []
    for _ in range(60):
        now[0] += 1.0
        for name in ACTIONS:
            if random.random() < 0.3:
                kb.measure(f"for_{name}", random.choice((0.0, 1.0)))
        runner.tick()
        running = sorted(
            one.name
            for one in runner.tree.root.iterate()
            if isinstance(one, Turn | Work) and one.status is Status.RUNNING
        )
        told.append(
            (runner.status, running, [(one.verb, one.arguments) for one in kb.log.since(0)][-6:])
        )
    runner.shutdown()
    return told


def registered(kb):
    registry = BehaviourRegistry(kb=kb)
    registry.register("Work", Work)
    registry.register("Turn", Turn)
    return registry


@pytest.mark.parametrize("name", IDIOMS)
def test_idiom_that_was_written_and_read_again_does_the_same(name):
    build = IDIOMS[name]
    for seed in range(5):
        before = lived(build, seed)
        again = lived(
            lambda kb: load_xml(export_xml(build(kb), registered(kb)), registered(kb)), seed
        )
        assert again == before
    assert len({status for status, _, _ in before}) > 1 or any(running for _, running, _ in before)


def test_what_is_written_of_an_idiom_is_its_nodes():
    kb = rover([0.0])
    text = export_xml(IDIOMS["switching"](kb), registered(kb))
    tags = [one.tag for one in ElementTree.fromstring(text).iter()]
    assert tags[2:7] == [
        "DoUntilUnfeasible",
        "ReactiveSequence",
        "IsActionFeasible",
        "SafeSwitch",
        "Turn",
    ]
    assert '<SafeSwitch name="switch to scan" action="scan" after="charge;drive">' in text
    assert '<DoUntilUnfeasible name="scan, or else charge" memory="true">' in export_xml(
        IDIOMS["until, to the end"](kb)
    )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (
            "<DoUntilUnfeasible><Turn/></DoUntilUnfeasible>",
            "has 1 children; it takes 2: the task, and what is done",
        ),
        (
            '<SafeSwitch action="scan" after="drive"><Turn/></SafeSwitch>',
            "one for each action in `after`",
        ),
        ('<ForAction action="scann"><Turn/></ForAction>', "scann"),
    ],
)
def test_idiom_that_is_written_wrongly_is_refused(content, problem):
    with pytest.raises(XmlError, match=problem):
        load_xml(wrapped(content), registered(rover([0.0])))


class Ported(PortsMixin, Behaviour):
    """Has ports."""

    INPUT_PORTS = {"metres": PortInformation(float, required=False, default_value=2.5)}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {"driven": PortInformation(bool)}  # noqa: RUF012  # as py_trees has it

    def update(self):
        return Status.SUCCESS


def test_models_of_what_is_registered_are_written_with_their_ports():
    registry = BehaviourRegistry()
    registry.register("Turn", Turn)
    registry.register("Ported", Ported)
    registry.register("asked", lambda name, where: Ported(name), kind="condition")

    @registry.register
    def guarded(name: str, child: Behaviour, times: int, said: str) -> Behaviour:
        return UntilSuccess(name, child)

    @registry.register
    def made(name: str) -> Behaviour:
        return Ported(name)

    text = export_xml(
        load_xml(wrapped("<Sequence><Turn/><made/></Sequence>"), registry), registry, models=True
    )
    root = ElementTree.fromstring(text)
    models = {
        one.get("ID"): (one.tag, [(port.tag, *port.attrib.values()) for port in one])
        for one in root[-1]
    }
    assert root[-1].tag == "TreeNodesModel"
    assert models == {
        "Retry": (
            "Decorator",
            [("input_port", "num_failures", "int"), ("input_port", "pause", "double")],
        ),
        "UntilSuccess": ("Decorator", []),
        "Turn": ("Action", []),
        "Ported": (
            "Condition",
            [("input_port", "metres", "double", "2.5"), ("output_port", "driven", "bool")],
        ),
        "asked": ("Condition", [("input_port", "where")]),
        "guarded": (
            "Decorator",
            [("input_port", "times", "int"), ("input_port", "said", "std::string")],
        ),
        "made": ("Condition", []),
    }
    again = load_xml(text, registry)
    assert export_xml(again, registry, models=True) == text
    assert [slot.is_condition for slot in again.child.node.slots] == [False, True]


@pytest.mark.parametrize(
    ("name", "instead"), [("look around", "look_around"), ("a/b", "a_b"), ("Root", "Main")]
)
def test_name_that_the_library_refuses_is_refused_with_what_to_write(name, instead):
    registry = BehaviourRegistry()
    registry.register(name, Turn)
    with pytest.raises(ExportError, match=f"{name!r}.*write '{instead}' instead"):
        export_xml(Turn("turn"), registry)
