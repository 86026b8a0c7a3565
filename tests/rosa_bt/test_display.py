"""Pictures show every behaviour once, with its status, and why an action cannot be done."""

from xml.etree import ElementTree

from py_trees.behaviours import Running
from py_trees.common import Status
from xml_leaves import wrapped

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


def test_unknown_action_is_drawn_as_not_known():
    kb = mission().children[0].children[0].kb
    tree = load_xml(wrapped('<IsActionFeasible action="{a}"/>'), BehaviourRegistry(kb=kb))
    assert "action not known yet: " in svg_tree(tree)
    tree.blackboard["a"] = "explor"
    assert "did you mean 'explore'?" in ascii_tree(tree)
    tree.blackboard["a"] = "charge"
    assert ascii_tree(tree).endswith("(feasible)\n")


def test_svg_is_well_formed_and_shows_every_behaviour():
    root = mission()
    shapes = ElementTree.fromstring(svg_tree(root))
    boxes = [shape for shape in shapes if shape.tag.endswith("rect") and shape.get("x")]
    assert len(boxes) == len(list(root.iterate()))
