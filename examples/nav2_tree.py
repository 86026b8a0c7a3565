"""A tree in Nav2's form that uses another planner or controller when one is unfeasible."""

from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_bt import BehaviourRegistry, RosaAction, TreeRunner, load_xml

# The nodes are Nav2's; only IsActionFeasible is not. What makes an action unfeasible is in the
# model.
TREE = """
<root BTCPP_format="4" main_tree_to_execute="NavigateWithReplanning">
  <BehaviorTree ID="NavigateWithReplanning">
    <RecoveryNode number_of_retries="2" name="NavigateRecovery">
      <PipelineSequence name="NavigateWithReplanning">
        <RateController hz="1.0">
          <ComputePathToPose action="compute_path"/>
        </RateController>
        <ReactiveFallback>
          <ReactiveSequence>
            <IsActionFeasible action="follow_path"/>
            <FollowPath action="follow_path"/>
          </ReactiveSequence>
          <ReactiveSequence>
            <IsActionFeasible action="creep_along"/>
            <CreepAlong action="creep_along"/>
          </ReactiveSequence>
        </ReactiveFallback>
      </PipelineSequence>
      <Wait action="wait"/>
    </RecoveryNode>
  </BehaviorTree>
</root>
"""

model = Model("courier")
lidar = model.component("lidar")
bumper = model.component("bumper")
see = model.function("see_obstacles")
touch = model.function("touch_obstacles")
see.design("by_lidar", [lidar])
touch.design("by_bumper", [bumper])
model.action("compute_path")
model.action("follow_path", requires=[see])
model.action("creep_along", requires=[touch])
model.action("wait")

now = 0.0
kb = KnowledgeBase(model, clock=lambda: now)
registry = BehaviourRegistry(kb=kb)


@registry.register("ComputePathToPose")
@registry.register("Wait")
class AtOnce(RosaAction):
    """Stands for an action server of Nav2 that has answered."""

    def update(self) -> Status:
        """Look whether it is done."""
        return Status.SUCCESS


@registry.register("FollowPath")
@registry.register("CreepAlong")
class Driving(RosaAction):
    """Stands for the controller server, which drives until the goal is reached.

    Halting it cancels the goal.
    """

    def update(self) -> Status:
        """Look whether it is there."""
        return Status.RUNNING


runner = TreeRunner(load_xml(TREE, registry), clock=lambda: now)
for what in ("all is well", "the lidar fails", "the bumper fails too", "the lidar is repaired"):
    if "fail" in what:
        kb.component_failed(what.split()[1])
    if "repaired" in what:
        kb.component_recovered("lidar")
    runner.tick()
    print(f"{what}: {', '.join(action.action for action in kb.required_actions) or 'nothing'}")
    now += 0.2
print(kb.explain("creep_along"))
runner.shutdown()
