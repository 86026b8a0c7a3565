"""Two designs: an arm that grasps with its fingers when the vacuum pump fails."""

from kb import ConfigurationManager, KnowledgeBase, ManagedObjects, Model

# A function can be had in more than one way. The pump is plain hardware: it may fail, but nobody switches it.
model = Model("arm")
pump = model.component("pump")
suction = model.component("suction_node", kind="lifecycle")
fingers = model.component("fingers_node", kind="lifecycle")
grasp = model.function("grasp", always_improve=True)
grasp.design("by_suction", [suction, pump], priority=1)
grasp.design("by_fingers", [fingers], priority=2)
model.action("sort_parcels", requires=[grasp])


class Node:
    """A component within this program; those of yours may be ROS nodes, processes or drivers."""

    def __init__(self, name: str) -> None:
        self.name = name

    def activate(self) -> None:
        """Begin to work."""
        print("  start", self.name)

    def deactivate(self) -> None:
        """Cease to work."""
        print("  stop", self.name)

    def set_parameters(self, parameters: object) -> None:
        """Take parameters; these nodes have none."""


kb = KnowledgeBase(model, clock=lambda: 0.0)
nodes = ManagedObjects({name: Node(name) for name in ("suction_node", "fingers_node")})
manager = ConfigurationManager(kb, nodes)

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
