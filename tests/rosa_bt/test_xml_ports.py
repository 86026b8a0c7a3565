"""Ports, blackboards and the registry: what leaves are told, and what they tell each other."""

import re
from enum import StrEnum
from functools import partial
from itertools import cycle

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running
from py_trees.blackboard import Blackboard as ProcessBlackboard
from py_trees.common import Status
from py_trees.decorators import Decorator
from py_trees.ports import PortInformation, PortsMixin
from xml_leaves import Action, Condition, registry_of, trace, wrapped

from kb import KnowledgeBase, Model
from rosa_bt import (
    BehaviourRegistry,
    IsActionFeasible,
    RegistryError,
    RosaAction,
    TreeRunner,
    XmlError,
    load_xml,
)
from rosa_bt.xml.blackboard import PortError


class Add(PortsMixin, Behaviour, register=False):
    """Adds two numbers."""

    INPUT_PORTS = {  # noqa: RUF012  # py_trees declares it so
        "one": PortInformation(float),
        "other": PortInformation(float, default_value=10.0),
    }
    OUTPUT_PORTS = {"total": PortInformation(float, required=False)}  # noqa: RUF012  # py_trees declares it so

    def update(self):
        self._set_output("total", self.get_input("one") + self.get_input("other"))
        return Status.SUCCESS


class Say(PortsMixin, Behaviour, register=False):
    """Keeps what it is told."""

    INPUT_PORTS = {"what": PortInformation(object)}  # noqa: RUF012  # py_trees declares it so
    OUTPUT_PORTS = {}  # noqa: RUF012  # py_trees declares it so
    heard: list

    def __init__(self, name, heard, times: int = 1, loud: bool = False):
        super().__init__(name)
        self.heard, self.times, self.loud = heard, times, loud

    def update(self):
        self.heard.append((self.get_input("what"), self.times, self.loud))
        return Status.SUCCESS


def load(content, heard=None, **trees):
    registry = BehaviourRegistry(heard=[] if heard is None else heard)
    registry.register("Add", Add)
    registry.register("Say", Say)
    return load_xml(wrapped(content, **trees), registry)


def hear(content, **trees):
    heard = []
    tree = load(content, heard, **trees)
    tree.blackboard["x"] = 1
    tree.tick_once()
    assert tree.status is Status.SUCCESS
    return [what for what, _, _ in heard]


def test_literals_keys_and_defaults_reach_the_leaf_as_the_types_that_it_declares():
    heard = []
    tree = load(
        '<Sequence><Add one="2" total="{sum}"/><Say what="{sum}" times="3" loud="true"/></Sequence>',
        heard,
    )
    tree.tick_once()
    assert heard == [(12.0, 3, True)]
    assert dict(tree.blackboard) == {"sum": 12.0}


def test_key_is_read_when_the_leaf_asks():
    heard = []
    tree = load('<Say what="{now}"/>', heard)
    for value in (1, 2):
        tree.blackboard["now"] = value
        tree.tick_once()
    assert [what for what, _, _ in heard] == [1, 2]
    with pytest.raises(PortError, match="an entry cannot take 'two': 'two' is no number"):
        tree.blackboard["now"] = "two"


def test_text_on_the_blackboard_is_converted_by_the_leaf_that_reads_it():
    assert hear('<Sequence><SetBlackboard value="4.5" output_key="t"/><Add one="{t}" other="{x}" total="{=}"/>'
                '<Say what="{total}"/></Sequence>') == [5.5]  # fmt: skip


SCOPES = {
    '<SubTree ID="Sub" y="{x}"/>': ('<Say what="{y}"/>', [1]),
    '<SubTree ID="Sub" x="{=}"/>': ('<Say what="{x}"/>', [1]),
    '<SubTree ID="Sub" y="text"/>': ('<Say what="{y}"/>', ["text"]),
    '<SubTree ID="Sub" _autoremap="true"/>': ('<Say what="{x}"/>', [1]),
    '<SubTree ID="Sub" x="7" _autoremap="true"/>': ('<Say what="{x}"/>', [7]),
    '<SubTree ID="Sub"/>': (
        '<Sequence><Say what="{@x}"/><Script code="x := 5"/><Say what="{x}"/></Sequence>',
        [1, 5],
    ),
    '<Sequence><SubTree ID="Sub" out="{z}"/><Say what="{z}"/></Sequence>': (
        '<Script code="out := 3"/>',
        [3],
    ),
    '<Sequence><SubTree ID="Sub"/><Say what="{x}"/></Sequence>': ('<Script code="x := 5"/>', [1]),
    '<Sequence><SubTree ID="Sub" _autoremap="1"/><Say what="{x}"/></Sequence>': (
        '<Script code="x := 5; _x := 6"/>',
        [5],
    ),
    '<Sequence><SubTree ID="Sub" x="7"/><Say what="{x}"/></Sequence>': (
        '<Script code="x := 5"/>',
        [1],
    ),
    '<Sequence><SubTree ID="Sub" y="{@x}"/><Say what="{x}"/></Sequence>': (
        '<Script code="@x := 5; y := 6"/>',
        [6],
    ),
}


@pytest.mark.parametrize("content", SCOPES)
def test_subtree_sees_what_it_is_given_and_nothing_else(content):
    inner, heard = SCOPES[content]
    assert hear(content, Sub=inner) == heard


def test_private_keys_are_never_remapped_automatically():
    tree = load('<SubTree ID="Sub" _autoremap="true"/>', Sub='<Script code="_own := 1; all := 2"/>')
    tree.tick_once()
    assert dict(tree.blackboard) == {"all": 2}


def test_keys_reach_through_several_subtrees():
    inner = '<SubTree ID="Deep" b="{a}"/>'
    assert hear('<SubTree ID="Sub" a="{x}"/>', Sub=inner, Deep='<Say what="{b}"/>') == [1]


def test_two_subtrees_of_one_tree_and_two_loaded_trees_share_nothing():
    before = dict(ProcessBlackboard.storage)
    content = '<Sequence><SubTree ID="Sub" v="1"/><SubTree ID="Sub" v="2"/></Sequence>'
    one, other = (load(content, Sub='<Script code="seen := v"/>') for _ in range(2))
    one.tick_once()
    one.blackboard["x"] = 1
    first, second = (node.blackboard["seen"] for node in one.child.node.children)
    assert (first, second) == (1, 2)
    assert dict(other.blackboard) == {}
    assert ProcessBlackboard.storage == before


def test_model_of_a_tree_gives_defaults_and_says_what_is_needed():
    editor = '<MetadataFields><Metadata author="nobody"/></MetadataFields>'
    model = f'<SubTree ID="Sub"><input_port name="v" default="4"/><input_port name="w"/>{editor}</SubTree>'
    text = wrapped(
        '<SubTree ID="Sub" {0}/>', Sub='<Sequence><Say what="{v}"/><Say what="{w}"/></Sequence>'
    )
    text = text.replace("</root>", f"<TreeNodesModel>{model}</TreeNodesModel></root>")
    heard = []
    registry = BehaviourRegistry(heard=heard)
    registry.register("Say", Say)
    load_xml(text.replace("{0}", 'w="5"'), registry).tick_once()
    assert [what for what, _, _ in heard] == [4, 5]
    with pytest.raises(XmlError, match="needs w="):
        load_xml(text.replace("{0}", ""), registry)


BAD_PORTS = {
    "<Add/>": "the port 'one' is missing; write one=...",
    '<Add one="x"/>': "the port 'one' takes a value of type float, not 'x'",
    '<Add one="1" twoo="1"/>': "it has no port 'twoo'; ports: one, other, total",
    "<Say/>": "'what' is missing",
    '<Say what="1" loud="maybe"/>': "the port 'loud' takes a value of type bool, not 'maybe'",
    '<Say what="1" volume="3"/>': "it has no port 'volume'; ports: loud, times, what",
}


@pytest.mark.parametrize("content", BAD_PORTS)
def test_port_that_cannot_be_is_refused_when_the_tree_is_made(content):
    with pytest.raises(XmlError) as caught:
        load(content)
    assert BAD_PORTS[content] in str(caught.value)


def test_key_that_nobody_has_written_is_told_by_name():
    tree = load('<Add one="{nobody}"/>')
    runner = TreeRunner(tree, clock=lambda: 0.0)
    runner.tick()
    assert tree.status is Status.FAILURE
    assert "no data available" in tree.child.node.feedback_message


def test_functions_make_leaves_too_and_take_what_they_declare_and_the_blackboard():
    registry = BehaviourRegistry()

    @registry.register("count")
    def count(name, blackboard, start: int, by: int = 1):
        blackboard["count"] = start + by
        return Finished(name, [])

    tree = load_xml(
        wrapped('<SubTree ID="Sub" count="{total}"/>', Sub='<count start="4"/>'), registry
    )
    assert dict(tree.blackboard) == {"total": 5}


def test_bare_decorator_takes_the_name_of_the_class_or_function():
    registry = BehaviourRegistry(heard=[])

    @registry.register
    class Greet(Say):
        pass

    @registry.register
    def whisper(*_):
        return Finished("whispered", [])

    tree = load_xml(wrapped('<Sequence><Greet what="x"/><whisper/></Sequence>'), registry)
    assert [type(one) for one in tree.child.node.children] == [Greet, Finished]
    assert isinstance(Greet, type)


def test_functions_and_partial_ones_get_the_name_and_the_types_of_what_they_call():
    heard = []
    registry = BehaviourRegistry()
    registry.register("short", lambda name: Finished(name, heard))
    registry.register("half", partial(Say, heard=heard, loud=True))
    registry.register("sum", partial(Add))
    text = '<Sequence><Add one="1" total="{t}"/><half what="{t}" times="2"/></Sequence>'.replace(
        "Add", "sum"
    )
    tree = load_xml(wrapped(text), registry)
    tree.tick_once()
    assert heard == [(11.0, 2, True)]
    assert load_xml(wrapped('<short name="x"/>'), registry).child.node.name == "x"


def test_decorators_of_the_user_decorate_what_is_in_them():
    class EveryOther(Decorator):
        """Ticks its child at every other tick, as a controller of rates does."""

        def __init__(self, name, child, first: int = 0):
            super().__init__(name, child)
            self.count = first

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
    registry.register(
        "EveryOther", EveryOther
    )  # as any other name that BehaviorTree.CPP itself does not have
    tree = load_xml(
        wrapped('<ReactiveSequence><c/><EveryOther first="0"><a/></EveryOther></ReactiveSequence>'),
        registry,
    )
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
    ("factory", "kind", "element", "model", "is_condition"),
    [
        (Finished, None, "<leaf/>", "", True),
        (Prepared, None, "<leaf/>", "", False),
        (Finished, "action", '<Condition ID="leaf"/>', "", False),
        (Prepared, "condition", "<leaf/>", "", True),
        (Prepared, None, '<Condition ID="leaf"/>', "", True),
        (Finished, None, '<Action ID="leaf"/>', "", False),
        (Prepared, None, "<leaf/>", '<Condition ID="leaf"/>', True),
        (Finished, None, "<leaf/>", '<Action ID="leaf"><input_port name="x"/></Action>', False),
    ],
)
def test_only_conditions_are_asked_again_before_they_are_reset(
    factory, kind, element, model, is_condition
):
    asked = []
    registry = registry_of({"b": ("A", "R")}, [])
    registry.register("leaf", lambda name: factory(name, asked), kind=kind)
    text = wrapped(f"<WhileDoElse>{element}<b/></WhileDoElse>")
    text = text.replace("</root>", f"<TreeNodesModel>{model}</TreeNodesModel></root>")
    tree = load_xml(text, registry)
    for _ in range(3):
        tree.tick_once()
    assert len(asked) == (3 if is_condition else 1)


@pytest.mark.parametrize(
    ("name", "factory", "kind", "message"),
    [
        ("Sequence", Finished, None, "'Sequence' is a node of BehaviorTree.CPP itself"),
        ("SubTree", Finished, None, "choose another name"),
        ("taken", Finished, None, "'taken' is registered already"),
        ("new", "Finished", None, "not 'Finished'"),
        ("new", Finished, "leaf", "an 'action' or a 'condition', not 'leaf'"),
    ],
)
def test_registration_that_means_nothing_is_refused(name, factory, kind, message):
    registry = BehaviourRegistry()
    registry.register("taken", Finished)
    with pytest.raises(RegistryError, match=message):
        registry.register(name, factory, kind=kind)


def test_what_a_behaviour_raises_when_it_is_made_is_told_with_file_and_line():
    registry = BehaviourRegistry()

    @registry.register("broken")
    class Broken(Finished):
        def __init__(self, name):
            raise OSError("no camera")

    with pytest.raises(XmlError, match="<text>:1: <broken> cannot be made: OSError: no camera"):
        load_xml(wrapped("<broken/>"), registry)


class Scan(RosaAction):
    """Scans for ever."""

    def update(self):
        return Status.RUNNING


def rover():
    model = Model("rover")
    light = model.environmental_attribute("light")
    model.action("scan", constraints=[light >= 0.5])
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    registry = BehaviourRegistry(kb=kb)
    registry.register("scan", Scan)
    return kb, registry


PATTERN = (
    '<ReactiveSequence><IsActionFeasible action="{a}"/><scan action="{a}"/></ReactiveSequence>'
)


def test_our_leaves_ask_and_tell_the_knowledge_base_that_the_registry_is_bound_to():
    kb, registry = rover()
    tree = load_xml(wrapped('<SubTree ID="Sub" a="scan"/>', Sub=PATTERN), registry)
    runner = TreeRunner(tree, clock=lambda: kb.now)
    runner.tick()
    assert [one.action for one in kb.required_actions] == ["scan"]
    kb.measure("light", 0.1)
    runner.tick()
    assert list(kb.required_actions) == []
    assert tree.status is Status.FAILURE
    condition = next(one for one in tree.iterate() if isinstance(one, IsActionFeasible))
    assert "scan is unfeasible" in condition.feedback_message


def test_action_that_the_model_does_not_have_is_found_when_the_tree_is_made():
    _, registry = rover()
    with pytest.raises(
        XmlError,
        match=r"<text>:1: <scan> cannot be made: .*unknown action 'scann'; did you mean 'scan'",
    ):
        load_xml(wrapped('<scan action="scann"/>'), registry)


def test_times_are_those_of_the_knowledge_base_unless_a_clock_is_handed_in():
    now = 0.0
    kb = KnowledgeBase(Model("rover"), clock=lambda: now)
    tree = load_xml(wrapped('<Sleep msec="1000"/>'), BehaviourRegistry(kb=kb))
    tree.tick_once()
    now = 0.5
    tree.tick_once()
    assert tree.status is Status.RUNNING
    now = 1.0
    tree.tick_once()
    assert tree.status is Status.SUCCESS


def test_all_leaves_of_ours_can_be_written():
    kb, registry = rover()
    kb.measure("light", 0.7)
    leaves = (
        '<IsActionFeasible action="scan"/><HasStatus element="scan" status="feasible"/>'
        '<Measurement attribute="light" operator=">=" value="0.6"/>'
    )
    tree = load_xml(
        wrapped(f'<Sequence>{leaves}<scan action="scan" wait="true" timeout="5"/></Sequence>'),
        registry,
    )
    tree.tick_once()
    assert tree.status is Status.RUNNING
    assert [one.action for one in kb.required_actions] == ["scan"]


class Water(Scan):
    """Has the action in its constructor, as a behaviour that is made by hand has."""

    def __init__(self, name, kb, action, plants: int = 3):
        super().__init__(name, kb, action)
        self.plants = plants


class Fixed(Scan):
    """Is about one action, whatever is written."""

    def __init__(self, name, kb):
        super().__init__(name, kb, "scan")


def test_literal_goes_to_the_constructor_that_asks_for_it():
    _, registry = rover()
    registry.register("water", Water)
    (leaf,) = (
        one
        for one in load_xml(wrapped('<water action="scan" plants="4"/>'), registry).iterate()
        if not one.children
    )
    assert (leaf.action, leaf.plants) == ("scan", 4)


def test_literal_wins_over_the_default_of_the_constructor():
    kb, registry = rover()

    @registry.register("look")
    class Look(IsActionFeasible):
        def __init__(self, name, kb, action="nothing"):
            super().__init__(name, kb, action)

    tree = load_xml(wrapped('<look action="scan"/>'), registry)
    kb.measure("light", 0.7)
    tree.tick_once()
    assert tree.status is Status.SUCCESS


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ('<water plants="4"/>', "'action' is missing; write action=..."),
        ('<water action="{a}"/>', "'action' is needed when the tree is made"),
        ('<water action="scann"/>', "did you mean 'scan'"),
        (
            '<water action="scan" plant="4"/>',
            "no port 'plant'; did you mean 'plants'? ports: action, plants",
        ),
        ("<scan/>", "'action' is missing; write action=..."),
        ("<IsActionFeasible/>", "'action' is missing; write action=..."),
        ('<HasStatus element="scann" status="solved"/>', "did you mean 'scan'"),
        ('<HasStatus element="scan" status="tired"/>', "never 'tired'"),
        ('<HasStatus element="scan"/>', "'status' is missing; write status=..."),
        ('<Measurement attribute="lihgt" operator=">=" value="1"/>', "did you mean 'light'"),
        ('<Measurement attribute="light" operator="=>" value="1"/>', "'=>' is not an operator"),
        ('<Measurement attribute="light" value="1"/>', "'operator' is missing; write operator=..."),
        (
            '<fixed action="{a}"/>',
            "says already that 'action' is 'scan', so '{a}' would never be read",
        ),
        ('<fixed action="drive"/>', "leave action=... out"),
        (
            '<Measurement attribute="{a}" operator=">" value="1"/>',
            "'attribute' is needed when the tree is made",
        ),
    ],
)
def test_what_our_leaves_cannot_mean_is_found_when_the_tree_is_made(element, message):
    _, registry = rover()
    registry.register("water", Water)
    registry.register("fixed", Fixed)
    with pytest.raises(XmlError, match=f"<text>:1: .*{re.escape(message)}"):
        load_xml(wrapped(element), registry)


@pytest.mark.parametrize("element", ["<fixed/>", '<fixed action="scan"/>'])
def test_action_that_the_constructor_says_needs_not_be_written(element):
    kb, registry = rover()
    registry.register("fixed", Fixed)
    kb.measure("light", 0.7)
    load_xml(wrapped(element), registry).tick_once()
    assert [one.action for one in kb.required_actions] == ["scan"]


@pytest.mark.parametrize("text", ["", " \n"])
def test_empty_text_is_told_apart_from_a_path(text):
    with pytest.raises(XmlError, match="<text>: the text is empty"):
        load_xml(text, BehaviourRegistry())


NAVIGATION = """
<root BTCPP_format="4" main_tree_to_execute="Navigate">
  <BehaviorTree ID="Navigate">
    <RecoveryNode number_of_retries="6" name="recover">
      <PipelineSequence name="with replanning">
        <RateController hz="1.0">
          <RecoveryNode number_of_retries="1" name="plan">
            <ComputePath goal="{goal}" path="{path}" planner_id="grid"/>
            <ClearMap name="clear global" service_name="global"/>
          </RecoveryNode>
        </RateController>
        <FollowPath path="{path}" controller_id="local"/>
      </PipelineSequence>
      <ReactiveFallback name="or give up">
        <GoalUpdated/>
        <RoundRobin name="ways out" wrap_around="true">
          <ClearMap name="clear local" service_name="local"/>
          <Spin spin_dist="1.57"/>
        </RoundRobin>
      </ReactiveFallback>
    </RecoveryNode>
  </BehaviorTree>
</root>
"""


def test_tree_in_the_style_of_nav2_plans_follows_and_recovers():
    said, now = [], 0.0
    scripts = {
        "ComputePath": "SSFFS",
        "ClearMap": "S",
        "FollowPath": "RRFR",
        "Spin": "S",
        "GoalUpdated": "F",
    }
    leaves = {
        tag: partial(Condition if tag == "GoalUpdated" else Action, script=cycle(script), said=said)
        for tag, script in scripts.items()
    }
    tree = load_xml(NAVIGATION, BehaviourRegistry(), clock=lambda: now, substitutes=leaves)
    lines = []
    for now in (0.0, 0.5, 1.0, 1.5):  # noqa: B007  # the clock of the tree reads it
        lines += trace(tree.tick_once, tree, said, 1)
    assert [line.removeprefix("0| ") for line in lines] == [
        "ComputePath:s:S FollowPath:s:R => RUNNING",
        "FollowPath:r:R => RUNNING",
        "ComputePath:s:S FollowPath:r:F GoalUpdated:c:F clear local:s:S "
        "ComputePath:s:F clear global:s:S ComputePath:s:F "
        "GoalUpdated:c:F Spin:s:S ComputePath:s:S FollowPath:s:R => RUNNING",
        "FollowPath:r:R => RUNNING",
    ]


class Metres(float):
    """A double of a class of its own, as those of numpy are."""


class Colour(StrEnum):
    RED = "red"


@pytest.mark.parametrize(
    ("held", "code", "expected"),
    [
        (Metres(1.5), "x := 2.5", 2.5),
        (Metres(1.5), "x += 1", 2.5),
        (Colour.RED, "x := 'blue'", "blue"),
    ],
)
def test_script_writes_over_a_value_whose_class_is_derived_from_a_number_or_a_text(
    held, code, expected
):
    tree = load(f'<Script code="{code}"/>')
    tree.blackboard["x"] = held
    tree.tick_once()
    assert tree.blackboard["x"] == expected


def test_parameter_with_a_default_may_be_a_key_that_is_read_at_each_start():
    heard = []
    tree = load('<Say what="1" times="{n}"/>', heard)
    for value in (None, 3, "4"):
        if value is not None:
            tree.blackboard["n"] = value
        tree.tick_once()
    assert [times for _, times, _ in heard] == [1, 3, 4]
    assert tree.notes == ()


def test_key_that_no_attribute_takes_is_noted():
    registry = BehaviourRegistry()
    registry.register("Stand", lambda name, place="here": Running(name))
    tree = load_xml(
        '<root BTCPP_format="4"><BehaviorTree><Stand place="{p}"/></BehaviorTree></root>', registry
    )
    assert "place='{p}' is not read: Running keeps no attribute 'place'" in tree.notes[0]


@pytest.mark.parametrize(
    ("writer", "expected"),
    [
        ('<SetBlackboard value="dock 3" output_key="what"/>', "dock 3"),
        ('<Script code="what := 2"/>', 2),
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
