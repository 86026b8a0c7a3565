"""The battery drop: a warehouse robot stops carrying boxes, charges, and continues."""

from py_trees.common import Status
from py_trees.decorators import FailureIsRunning

from kb import ConfigurationManager, EventKind, KnowledgeBase, Model
from missions.testing import FakeClock, ScriptedManaged
from rosa_bt import ForAction, Measurement, RosaAction, TreeRunner, do_until_unfeasible

model = Model("warehouse")
battery = model.quality_attribute("battery")  # from 0 to 1
handle = model.function("handle_boxes")
draw_power = model.function("draw_power")
handle.design("with_lift", [model.component("lift_node", kind="lifecycle")])
draw_power.design("at_dock", [model.component("dock_node", kind="lifecycle")])
model.action("carry", requires=[handle], constraints=[battery >= 0.25])
model.action("charge", requires=[draw_power])


class Carry(RosaAction):
    """Carries eight boxes, one in each tick."""

    def initialise(self) -> None:
        """Begin with the first one; called when the action starts."""
        self.carried = 0

    def update(self) -> Status:
        """Carry one more; called at each tick."""
        self.carried += 1
        print("       carries box", self.carried)
        return Status.SUCCESS if self.carried == 8 else Status.RUNNING

    def save_progress(self) -> int:
        """Say how far it is; called when the action is interrupted."""
        return self.carried

    def restore_progress(self, progress: object) -> None:
        """Go on from there; called after `initialise`."""
        assert isinstance(progress, int)
        self.carried = progress


clock = FakeClock()
kb = KnowledgeBase(model, clock=clock)
kb.subscribe(
    lambda event: (
        None if event.kind is EventKind.RECORD else print(f"{event.time:3.0f} s  {event.text}")
    )
)
robot = ScriptedManaged(clock)  # stands in for the real one
manager = ConfigurationManager(kb, robot)

# The whole task: carry; when that becomes unfeasible, charge until the battery is full, then go on
# carrying.
carry = Carry("carry", kb, "carry", wait=True)  # begins when the robot is configured for it
charge = ForAction(
    "charge", kb, "charge", FailureIsRunning("wait", Measurement("full?", kb, "battery", ">=", 1.0))
)
runner = TreeRunner(do_until_unfeasible(carry, charge, memory=True), clock=clock)

level = 0.75
while runner.status is not Status.SUCCESS:
    kb.measure("battery", level)
    runner.tick()
    manager.update()
    clock.advance(10.0)
    level += 0.5 if "dock_node" in robot.active else -0.125
    level = min(level, 1.0)
