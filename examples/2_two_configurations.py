"""Two configurations: a delivery robot that drives slowly where people are."""

from collections.abc import Mapping

from kb import ConfigurationManager, KnowledgeBase, Model

# An action requires functions, a function has designs, a design is made of components, and these
# have configurations.
model = Model("courier")
people = model.environmental_attribute("people")  # within 5 m
drive = model.component(
    "drive_node", kind="lifecycle", always_improve=True
)  # takes the better one when it can
drive.configuration("brisk", {"speed_m_s": 1.5}, priority=1, constraints=[people <= 2])
drive.configuration("careful", {"speed_m_s": 0.4}, priority=2)
move = model.function("move")
move.design("on_wheels", [drive])
model.action("deliver", requires=[move])


class Robot:
    """The managed system: whatever can do these three things."""

    def activate(self, component: str) -> None:
        """Start a component."""
        print("  start", component)

    def deactivate(self, component: str) -> None:
        """Stop a component."""
        print("  stop", component)

    def set_parameters(self, component: str, parameters: Mapping[str, object]) -> None:
        """Configure a component."""
        print("  set", component, dict(parameters))


# The manager keeps the robot configured for what is requested; each update is one look at the
# facts, and never waits.
kb = KnowledgeBase(model, clock=lambda: 0.0)
manager = ConfigurationManager(kb, Robot())

print("a parcel")
kb.request_action("deliver")
manager.update()

for count in (7, 1):
    print(count, "people around")
    kb.measure("people", count)
    if plan := manager.update():
        print("  because", plan.reason)

print("delivered")
kb.cancel_action("deliver", "completed")
manager.update()
