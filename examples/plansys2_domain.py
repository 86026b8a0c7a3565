"""A domain for PlanSys2 that knows nothing of ROSA; its actions follow what is feasible."""

from pathlib import Path

from py_trees.common import Status

from kb import KnowledgeBase, Model
from rosa_bt import RosaAction
from rosa_pddl import PlanExecutor, Step, load_domain

HERE = Path(__file__).with_name("plansys2_domain")

# Which action of the model each PDDL action does is said when loading; the files stay untouched.
domain = load_domain(
    HERE / "domain.pddl", HERE / "problem.pddl", actions={"move": "drive", "recharge": "dock"}
)

model = Model("patrol_robot")
model.quality_attribute("battery", low=0.0, high=1.0)
move = model.function("move", always_improve=True)
move.design("on_wheels", [model.component("wheels")], priority=1)
move.design("on_tracks", [model.component("tracks")], priority=2)
model.action("drive", requires=[move])
model.action("dock")

now = 0.0
kb = KnowledgeBase(model, clock=lambda: now)
holds = {"(robot_at r2d2 hall)": True}  # what the problem expert of PlanSys2 would know


def sense() -> dict[str, bool]:
    """Return the facts; that of the battery is the knowledge base's, so no node has to keep it."""
    return {**holds, "(battery_full r2d2)": (kb.attributes["battery"].value or 0.0) >= 0.3}


class Move(RosaAction):
    """What an ActionExecutorClient does: three ticks of driving."""

    def __init__(self, step: Step) -> None:
        super().__init__(str(step), kb, "drive")
        self.step = step

    def initialise(self) -> None:
        """Begin; called once."""
        self.ticks = 0

    def update(self) -> Status:
        """Drive on; called at each tick."""
        self.ticks += 1
        if self.ticks < 3:
            return Status.RUNNING
        robot, origin, to = self.step.arguments
        holds.update({f"(robot_at {robot} {origin})": False, f"(robot_at {robot} {to})": True})
        holds[f"(patrolled {to})"] = True
        return Status.SUCCESS


class Recharge(RosaAction):
    """Stands at the charger until the battery is full."""

    def __init__(self, step: Step) -> None:
        super().__init__(str(step), kb, "dock")

    def update(self) -> Status:
        """Charge on."""
        kb.measure("battery", 1.0)
        return Status.SUCCESS


executor = PlanExecutor(
    "patrol",
    kb=kb,
    domain=domain,
    behaviours={"move": Move, "recharge": Recharge},
    sense=sense,
    clock=lambda: now,
)
kb.measure("battery", 0.9)
shown = 0
while executor.status is not Status.SUCCESS:
    executor.catch_up()  # wait for the answer that is due by now, on a slow computer too
    executor.tick_once()
    for plan in executor.plans[shown:]:
        print(
            f"{now:4.1f} s  {plan.reason}: {', then '.join(map(str, plan.steps)) or plan.outcome}"
        )
    shown = len(executor.plans)
    now += 1.0
    if now == 3.0:
        kb.component_failed("wheels")  # the plan stays: it can still drive
        print(f"{now:4.1f} s  the wheels fail; drive is feasible: {kb.is_feasible('drive')}")
    if now == 7.0:
        kb.measure("battery", 0.2)
        print(f"{now:4.1f} s  the battery drops")
print("patrolled:", *sorted(fact for fact, is_so in holds.items() if is_so and "patrolled" in fact))
