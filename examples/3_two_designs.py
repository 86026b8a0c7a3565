"""Two designs: an arm that grasps with its fingers when the vacuum pump fails."""

from kb import ConfigurationManager, KnowledgeBase, Model

# A function can be had in more than one way. The pump is plain hardware: it may fail, but nobody
# switches it.
model = Model("arm")
pump = model.component("pump")
suction = model.component("suction_node", kind="lifecycle")
fingers = model.component("fingers_node", kind="lifecycle")
grasp = model.function("grasp", always_improve=True)
grasp.design("by_suction", [suction, pump], priority=1)
grasp.design("by_fingers", [fingers], priority=2)
model.action("sort_parcels", requires=[grasp])


class Nodes:
    """The components of this program; those of yours may be ROS nodes, processes or drivers."""

    def activate(self, component: str) -> None:
        """Have a component begin to work."""
        print("  start", component)

    def deactivate(self, component: str) -> None:
        """Have a component cease to work."""
        print("  stop", component)

    def set_parameters(self, component: str, parameters: object) -> None:
        """Give a component its parameters; these have none."""


kb = KnowledgeBase(model, clock=lambda: 0.0)
manager = ConfigurationManager(kb, Nodes())

print("sorting is requested")
kb.request_action("sort_parcels")
manager.update()

print("the pump fails")
kb.component_failed("pump", "no pressure")
manager.update()
print(kb.explain("by_suction"))
print("sorting is still feasible:", kb.is_feasible("sort_parcels"))

print("the pump is repaired")
kb.component_recovered("pump")
manager.update()
