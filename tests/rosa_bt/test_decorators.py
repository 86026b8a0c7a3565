"""What the decorators do that py_trees' own do not."""

from py_trees.behaviours import StatusQueue
from py_trees.common import Status
from py_trees.composites import Selector
from py_trees.decorators import SuccessIsFailure

from kb import KnowledgeBase, Model
from rosa_bt import RosaAction, TreeRunner
from rosa_bt.decorators import UntilSuccess


def statuses(*queue):
    return StatusQueue("child", queue=list(queue), eventually=None)


def test_child_that_fails_is_tried_once_more_in_the_same_tick():
    child = statuses(Status.FAILURE, Status.RUNNING, Status.FAILURE, Status.FAILURE, Status.SUCCESS)
    root = UntilSuccess("until success", child)
    seen = []
    for _ in range(3):
        root.tick_once()
        seen.append((root.status, child.status))
    assert seen == [
        (Status.RUNNING, Status.RUNNING),
        (Status.RUNNING, Status.FAILURE),
        (Status.SUCCESS, Status.SUCCESS),
    ]


def test_something_is_required_at_the_end_of_every_tick_of_a_mission_that_alternates():
    model = Model("rover")
    energy = model.quality_attribute("energy")
    model.action("explore", constraints=[energy >= 0.2])
    model.action("charge")
    kb = KnowledgeBase(model, clock=lambda: 0.0)

    class Explore(RosaAction):
        def update(self):
            return Status.RUNNING if kb.is_feasible("explore") else Status.FAILURE

    class Charge(RosaAction):
        def update(self):
            return Status.SUCCESS if kb.is_feasible("explore") else Status.RUNNING

    mission = Selector("mission", memory=True)
    mission.add_children(
        [
            Explore("explore", kb, "explore"),
            SuccessIsFailure("go on", Charge("charge", kb, "charge")),
        ]
    )
    runner = TreeRunner(UntilSuccess("until done", mission), clock=lambda: 0.0)
    doing = []
    for level in (1.0, 0.1, 0.1, 1.0, 1.0):
        kb.measure("energy", level)
        runner.tick()
        doing.append([one.action for one in kb.required_actions])
    assert doing == [["explore"], ["charge"], ["charge"], ["explore"], ["explore"]]
