"""Pictures show every behaviour once, with its status, and why an action cannot be done."""

from functools import partial
from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Failure, Running, Success
from py_trees.common import ParallelPolicy, Status
from py_trees.composites import Parallel, Selector, Sequence
from py_trees.decorators import Inverter

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, ForAction, RosaAction, do_until_unfeasible, load_xml
from rosa_bt.display import ascii_tree, svg_tree

WHY = "explore is unfeasible because energy 0.1 violates >= 0.2 (measured 0.0 s ago)"


class Act(RosaAction):
    def update(self):
        return Status.RUNNING


def mission():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    model.action("explore", constraints=[energy >= 0.2])
    model.action("charge")
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    root = do_until_unfeasible(
        Act("explore", kb, "explore"), ForAction("charge", kb, "charge", Running("plug in"))
    )
    kb.measure("energy", 0.1)
    root.tick_once()
    return root


def test_text_shows_statuses_feasibility_and_the_reason_once():
    assert ascii_tree(mission()) == (
        "[*] ?! explore, or else charge  (instead of explore if feasible)\n"
        "|-- [x] -> explore if feasible\n"
        f"|   |-- [x] explore feasible?  ({WHY})\n"
        "|   `-- [-] explore  (unfeasible)\n"
        "`-- [*] ^ charge  (feasible; running)\n"
        "    `-- [*] plug in  (running)\n"
    )


class Steps(Behaviour):
    """Returns one outcome after the other."""

    def __init__(self, name, steps):
        super().__init__(name)
        self.steps = iter(steps)

    def update(self):
        return {"S": Status.SUCCESS, "R": Status.RUNNING}[next(self.steps)]


NAMES = st.text(max_size=12)
TREES = st.recursive(
    st.builds(lambda kind, name: kind(name), st.sampled_from([Success, Failure, Running]), NAMES),
    lambda children: st.one_of(
        st.builds(
            lambda name, below: Sequence(name, memory=True, children=below),
            NAMES,
            st.lists(children, max_size=3),
        ),
        st.builds(
            lambda name, below: Selector(name, memory=False, children=below),
            NAMES,
            st.lists(children, max_size=3),
        ),
        st.builds(
            lambda name, below: Parallel(
                name, policy=ParallelPolicy.SuccessOnAll(), children=below
            ),
            NAMES,
            st.lists(children, max_size=3),
        ),
        st.builds(Inverter, NAMES, children),
    ),
    max_leaves=12,
)


@given(TREES)
def test_svg_is_well_formed_and_no_two_boxes_overlap(root):
    picture = ElementTree.fromstring(svg_tree(root))
    boxes = [
        tuple(float(shape.get(side)) for side in ("x", "y", "width", "height"))
        for shape in picture
        if shape.tag.endswith("rect") and shape.get("x")
    ]
    assert len(boxes) == len(list(root.iterate()))
    for number, (x, y, width, height) in enumerate(boxes):
        assert x + width <= float(picture.get("width"))
        assert y + height <= float(picture.get("height"))
        for left, top, wide, high in boxes[number + 1 :]:
            assert x + width <= left or left + wide <= x or y + height <= top or top + high <= y


@given(TREES)
def test_text_and_graph_show_every_behaviour_whatever_its_name(root):
    count = len(list(root.iterate()))
    assert len(ascii_tree(root).splitlines()) == count



def test_action_that_no_port_gives_yet_or_that_is_misspelt_is_drawn_as_not_known():
    kb = mission().children[0].children[0].kb
    registry = BehaviourRegistry(kb=kb)
    text = """<root BTCPP_format="4"><BehaviorTree ID="Main"><IsActionFeasible action="{a}"/></BehaviorTree></root>"""
    tree = load_xml(text, registry)
    for root, key in ((Act("no ports", kb), None), (tree, None), (tree, "explor")):
        if key is not None:
            tree.blackboard["a"] = key
        for picture in (ascii_tree, svg_tree):
            assert "action not known yet: " in picture(root)
        ElementTree.fromstring(svg_tree(root))
    assert "did you mean 'explore'?" in ascii_tree(tree)
    tree.blackboard["a"] = "charge"
    assert ascii_tree(tree).endswith("(feasible)\n")


def statuses_drawn(tree):
    return [line.partition("[")[2].partition("]")[0] for line in ascii_tree(tree).splitlines()]


def test_what_was_reset_before_the_last_tick_is_drawn_as_not_ticked():
    registry = BehaviourRegistry()
    outcomes = {"first": "SSR", "second": "SSS", "third": "RSS"}
    for name, steps in outcomes.items():
        registry.register(name, partial(Steps, steps=steps))
    inner = "<Sequence><second/></Sequence>"
    text = f"""<root BTCPP_format="4"><BehaviorTree ID="Main"><KeepRunningUntilFailure><ReactiveSequence>
        <first/>{inner}<third/></ReactiveSequence></KeepRunningUntilFailure></BehaviorTree></root>"""
    tree = load_xml(text, registry)
    drawn = []
    for _ in range(3):
        tree.tick_once()
        drawn.append("".join(statuses_drawn(tree)[3:]))
    assert drawn == ["ooo*", "oooo", "*---"]
