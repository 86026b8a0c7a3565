"""Ports, blackboards and the registry: what leaves are told, and what they tell each other."""

import re

import pytest
from acting import Act, Clock
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running
from py_trees.blackboard import Blackboard as ProcessBlackboard
from py_trees.common import Status
from py_trees.decorators import Decorator
from py_trees.ports import PortInformation, PortsMixin
from xml_leaves import registry_of, trace, wrapped

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, RegistryError, TreeRunner, XmlError, load_xml


class Add(PortsMixin, Behaviour, register=False):
    """Adds two numbers."""

    INPUT_PORTS = {  # noqa: RUF012  # py_trees declares it so
        "one": PortInformation(float),
        "other": PortInformation(float, default_value=10.0),
    }
    OUTPUT_PORTS = {"total": PortInformation(float, required=False)}  # noqa: RUF012  # as py_trees has it

    def update(self):
        self._set_output("total", self.get_input("one") + self.get_input("other"))
        return Status.SUCCESS


class Say(PortsMixin, Behaviour, register=False):
    """Keeps what it is told."""

    INPUT_PORTS = {"what": PortInformation(object)}  # noqa: RUF012  # as py_trees has it
    OUTPUT_PORTS = {}  # noqa: RUF012  # as py_trees has it

    def __init__(self, name, heard, times: int = 1, loud: bool = False):
        super().__init__(name)
        self.heard = heard
        self.times = times
        self.loud = loud

    def update(self):
        self.heard.append((self.get_input("what"), self.times, self.loud))
        return Status.SUCCESS


def load(content, heard=None, **trees):
    registry = BehaviourRegistry(heard=[] if heard is None else heard)
    registry.register("Add", Add)
    registry.register("Say", Say)
    return load_xml(wrapped(content, **trees), registry)


@pytest.mark.parametrize(
    ("content", "inner", "expected"),
    [
        ('<SubTree ID="Sub" x="3" total="{=}"/>',
         '<Sequence><Add one="2" total="{s}"/><Say what="{s}" times="3" loud="true"/></Sequence>',
         (12.0, 3, True)),
        ('<SubTree ID="Sub" x="3.0"/>',
         '<Sequence><SetBlackboard value="4.5" output_key="t"/>'
         '<Add one="{t}" other="{x}" total="{=}"/><Say what="{total}"/></Sequence>',
         (7.5, 1, False)),
        ('<SubTree ID="Sub" y="{x}"/>', '<Say what="{y}"/>', (1, 1, False)),
        ('<SubTree ID="Sub" y="text"/>', '<Say what="{y}"/>', ("text", 1, False)),
        ('<SubTree ID="Sub" x="7" _autoremap="true"/>', '<Say what="{x}"/>', (7, 1, False)),
        ('<SubTree ID="Sub"/>', '<Say what="{@x}"/>', (1, 1, False)),
        ('<Sequence><SubTree ID="Sub" out="{z}"/><Say what="{z}"/></Sequence>',
         '<Script code="out := 3"/>', (3, 1, False)),
    ],
)  # fmt: skip
def test_leaf_gets_literals_keys_and_defaults(content, inner, expected):
    heard = []
    tree = load(content, heard, Sub=inner)
    tree.blackboard["x"] = 1
    tree.tick_once()
    assert heard == [expected]


def test_key_is_read_when_the_leaf_asks():
    heard = []
    tree = load('<Say what="{now}"/>', heard)
    for value in (1, 2):
        tree.blackboard["now"] = value
        tree.tick_once()
    assert [what for what, _, _ in heard] == [1, 2]


def test_subtrees_and_trees_share_no_entries():
    before = dict(ProcessBlackboard.storage)
    content = '<Sequence><SubTree ID="Sub" v="1"/><SubTree ID="Sub" v="2"/></Sequence>'
    tree, other = (load(content, Sub='<Script code="seen := v"/>') for _ in range(2))
    tree.tick_once()
    assert [node.blackboard["seen"] for node in tree.child.node.children] == [1, 2]
    assert dict(other.blackboard) == {}
    assert ProcessBlackboard.storage == before


def test_model_of_a_tree_gives_defaults_and_says_what_is_needed():
    model = '<SubTree ID="Sub"><input_port name="v" default="4"/><input_port name="w"/></SubTree>'
    text = wrapped('<SubTree ID="Sub" {0}/>', Sub='<Sequence><Say what="{v}"/></Sequence>')
    text = text.replace("</root>", f"<TreeNodesModel>{model}</TreeNodesModel></root>")
    heard = []
    registry = BehaviourRegistry(heard=heard)
    registry.register("Say", Say)
    load_xml(text.replace("{0}", 'w="5"'), registry).tick_once()
    assert heard == [(4, 1, False)]


def test_function_makes_leaves_and_takes_the_blackboard():
    registry = BehaviourRegistry()

    @registry.register("count")
    def count(name, blackboard, start: int, by: int = 1):
        blackboard["count"] = start + by
        return Running(name)

    content = wrapped('<SubTree ID="Sub" count="{total}"/>', Sub='<count start="4"/>')
    assert dict(load_xml(content, registry).blackboard) == {"total": 5}


def test_decorator_of_the_user_decorates_its_child():
    class EveryOther(Decorator):
        """Ticks its child at every other tick, as a controller of rates does."""

        count = 0

        def tick(self):
            self.count += 1
            if self.count % 2:
                yield from super().tick()
            else:
                self.status = Status.RUNNING
                yield self

        def update(self):
            return self.decorated.status

    said = []
    registry = registry_of({"a": ("A", "RRS"), "c": ("C", "SSSF")}, said)
    registry.register("EveryOther", EveryOther)
    content = "<ReactiveSequence><c/><EveryOther><a/></EveryOther></ReactiveSequence>"
    tree = load_xml(wrapped(content), registry)
    assert trace(tree.tick_once, tree, said, 4) == [
        "0| c:c:S a:s:R => RUNNING",
        "1| c:c:S => RUNNING",
        "2| c:c:S a:r:R => RUNNING",
        "3| c:c:F a:halt => FAILURE",
    ]


class Finished(Behaviour):
    """Succeeds, and counts how often it was asked."""

    def __init__(self, name, asked):
        super().__init__(name)
        self.asked = asked

    def update(self):
        self.asked.append(self.name)
        return Status.SUCCESS


class Prepared(Finished):
    """The same, but it prepares something."""

    def initialise(self):
        pass


@pytest.mark.parametrize(
    ("factory", "element", "model", "is_condition"),
    [
        (Finished, "<leaf/>", "", True),
        (Prepared, "<leaf/>", "", False),
        (Prepared, '<Condition ID="leaf"/>', "", True),
        (Finished, "<leaf/>", '<Action ID="leaf"><input_port name="x"/></Action>', False),
    ],
)
def test_only_condition_is_asked_again(factory, element, model, is_condition):
    asked = []
    registry = registry_of({"b": ("A", "R")}, [])
    registry.register("leaf", lambda name: factory(name, asked))
    text = wrapped(f"<WhileDoElse>{element}<b/></WhileDoElse>")
    text = text.replace("</root>", f"<TreeNodesModel>{model}</TreeNodesModel></root>")
    tree = load_xml(text, registry)
    for _ in range(3):
        tree.tick_once()
    assert len(asked) == (3 if is_condition else 1)


def test_name_that_is_registered_twice_is_refused():
    registry = BehaviourRegistry()
    registry.register("taken", Finished)
    with pytest.raises(RegistryError, match="'taken' is registered already"):
        registry.register("taken", Finished)


def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("scan", constraints=[light >= 0.5])
    kb = KnowledgeBase(model, clock=Clock())
    registry = BehaviourRegistry(kb=kb, heard=[])
    registry.register("scan", lambda name, kb, action: Act(kb, action))
    registry.register("water", Water)
    registry.register("fixed", Fixed)
    registry.register("Add", Add)
    registry.register("Say", Say)
    return kb, registry


class Water(Act):
    """Has the action in its constructor, as a behaviour that is made by hand has."""

    def __init__(self, name, kb, action, plants: int = 3):
        if plants < 0:
            raise OSError("no can")
        super().__init__(kb, action)
        self.plants = plants


class Fixed(Act):
    """Is about one action, whatever is written."""

    def __init__(self, name, kb):
        super().__init__(kb, "scan")


PATTERN = '<ReactiveSequence><IsActionFeasible action="{a}"/><fixed/></ReactiveSequence>'


def test_our_leaves_ask_and_tell_the_bound_knowledge_base():
    kb, registry = rover()
    tree = load_xml(wrapped('<SubTree ID="Sub" a="scan"/>', Sub=PATTERN), registry)
    runner = TreeRunner(tree, clock=Clock())
    runner.tick()
    assert [request.action for request in kb.required_actions] == ["scan"]
    kb.measure("light", 0.1)
    runner.tick()
    assert list(kb.required_actions) == []
    assert tree.status is Status.FAILURE


def test_leaves_of_ours_can_be_written():
    kb, registry = rover()
    kb.measure("light", 0.7)
    leaves = (
        '<IsActionFeasible action="scan"/><HasStatus element="scan" status="feasible"/>'
        '<Measurement attribute="light" operator=">=" value="0.6"/>'
        '<water action="scan" plants="4"/>'
    )
    tree = load_xml(wrapped(f"<Sequence>{leaves}</Sequence>"), registry)
    tree.tick_once()
    assert tree.status is Status.RUNNING
    assert tree.tip().plants == 4


def test_measurement_takes_its_status_from_a_key():
    _, registry = rover()
    text = '<Measurement attribute="light" operator=">=" value="0.6" unknown="{status}"/>'
    tree = load_xml(wrapped(text), registry)
    tree.blackboard["status"] = Status.RUNNING
    tree.tick_once()
    assert tree.status is Status.RUNNING


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ("<Add/>", "it needs a value for 'one' when it is made; write one=..."),
        ('<Add one="x"/>', "the port 'one': 'x' is no float"),
        ('<Add one="1" twoo="1"/>', "it has no port 'twoo'; known: 'one', 'other', 'total'"),
        ('<Say what="1" loud="maybe"/>', "the port 'loud': 'maybe' is no bool"),
        ('<water plants="4"/>', "it needs a value for 'action' when it is made; write action=..."),
        (
            '<water action="{a}"/>',
            "it needs a value for 'action' when it is made; write action=...",
        ),
        ('<water action="scann"/>', "did you mean 'scan'"),
        ('<water action="scan" plant="4"/>', "no port 'plant'; did you mean 'plants'?"),
        ('<water action="scan" plants="-1"/>', "cannot be made: OSError: no can"),
        ("<IsActionFeasible/>", "Input port 'action'"),
        ('<HasStatus element="scan" status="tired"/>', "is never tired"),
        ('<Measurement attribute="light" operator="=>" value="1"/>', "'=>' is not an operator"),
        ('<Measurement attribute="light" value="1"/>', "it needs a value for 'operator'"),
        ('<fixed action="drive"/>', "leave action=... out"),
    ],
)
def test_leaf_that_cannot_be_made_is_refused_with_its_place(element, message):
    _, registry = rover()
    with pytest.raises(XmlError, match=f"<text>:1: .*{re.escape(message)}"):
        load_xml(wrapped(element), registry)


def test_parameter_with_a_default_may_be_a_key():
    heard = []
    tree = load('<Say what="1" times="{n}"/>', heard)
    for value in (None, 3, "4"):
        if value is not None:
            tree.blackboard["n"] = value
        tree.tick_once()
    assert [times for _, times, _ in heard] == [1, 3, 4]
    assert tree.notes == ()


def test_key_that_no_attribute_takes_is_refused():
    registry = BehaviourRegistry()
    registry.register("Stand", lambda name, place="here": Running(name))
    problem = "place='{p}': Running has no attribute 'place' to read it into; write self.place ="
    with pytest.raises(XmlError, match=re.escape(problem)):
        load_xml(wrapped('<Stand place="{p}"/>'), registry)


@pytest.mark.parametrize(
    ("subtree", "expected"),
    [
        ('<SubTreePlus ID="Talk" what="World"/>', "World"),
        ('<SubTreePlus ID="Talk" what="{World}"/>', "earth"),
        ('<SubTree ID="Talk" what="World" __shared_blackboard="false"/>', "earth"),
        ('<SubTree ID="Talk" what="World"/>', "World"),
        ('<Talk what="World"/>', "earth"),
    ],
)
def test_attribute_of_a_subtree_means_what_it_meant_in_version_3(subtree, expected):
    heard = []
    content = f'<Sequence><SetBlackboard value="earth" output_key="World"/>{subtree}</Sequence>'
    text = wrapped(content, Talk='<Say what="{what}"/>').replace('BTCPP_format="4" ', "")
    registry = BehaviourRegistry(heard=heard)
    registry.register("Say", Say)
    tree = load_xml(text, registry)
    tree.tick_once()
    assert heard[0][0] == expected
    unsure = 'read as it stands; in version 3, what="World" is what="{World}"'
    is_unsure = subtree == '<SubTree ID="Talk" what="World"/>'
    assert any(unsure in note for note in tree.notes) == is_unsure


@pytest.mark.parametrize(
    ("writer", "expected"),
    [
        ('<SetBlackboard value="dock 3" output_key="what"/>', "dock 3"),
        ("<Script code=\"what := 'dock'\"/>", "dock"),
        ('<Add one="1" other="2" total="{what}"/>', 3.0),
    ],
)
def test_port_without_a_type_gets_whatever_was_written(writer, expected):
    heard = []
    tree = load(f'<Sequence>{writer}<Say what="{{what}}"/></Sequence>', heard)
    for _ in range(2):
        tree.tick_once()
        assert tree.status is Status.SUCCESS, tree.tip().feedback_message
    assert [what for what, _, _ in heard] == [expected, expected]
