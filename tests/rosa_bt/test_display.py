"""A tree as text shows what py_trees shows, and why actions cannot be done."""

from py_trees.behaviours import Running
from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_bt import ForAction, RosaAction, do_until_unfeasible
from rosa_bt.display import ascii_tree

WHY = "explore is unfeasible because energy 0.1 violates >= 0.2 (measured 0.0 s ago)"


class Act(RosaAction):
    def update(self):
        return Status.RUNNING


def test_text_shows_statuses_and_why_actions_are_unfeasible():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    model.action("explore", constraints=[energy >= 0.2])
    model.action("charge")
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    charge = ForAction("charge", kb, "charge", Running("plug in"))
    root = do_until_unfeasible(Act("explore", kb, "explore"), charge)
    kb.measure("energy", 0.1)
    root.tick_once()
    assert ascii_tree(root) == (
        "--> explore, or else charge [*] -- instead of explore if feasible\n"
        f"    [-] explore if feasible [x]\n"
        f"        --> explore feasible? [x] -- {WHY}\n"
        "        --> explore [-]\n"
        "    -^- charge [*] -- running\n"
        "        --> plug in [*] -- running\n"
        f"{WHY}\n"
    )
