"""Replace one stage of the manager's loop: a planner that takes turns instead of taking the best.

The stages talk only through the knowledge base, so a planner is one method: it asks what is
adaptable and selectable, and answers what `kb.select` returns. Monitors (`observe`) and executors
(`execute`) are replaced in the same way.
"""

from kb import ConfigurationManager, KnowledgeBase, Model, ReconfigurationPlan


class LeastUsed:
    """Chooses the design that was chosen least often so far, to spread wear; ties go by name."""

    def __init__(self) -> None:
        self.uses: dict[str, int] = {}

    def plan(self, kb: KnowledgeBase) -> ReconfigurationPlan | None:
        """Choose for every function that needs a design."""
        chosen = {}
        for function in kb.adaptable_functions():
            designs = kb.selectable_designs(function)
            if designs:
                chosen[function] = min(designs, key=lambda name: (self.uses.get(name, 0), name))
                self.uses[chosen[function]] = self.uses.get(chosen[function], 0) + 1
        return kb.select(designs=chosen)


class Robot:
    """Does at once what is commanded."""

    def activate(self, component: str) -> None:
        """Print it."""
        print("  activate", component)

    def deactivate(self, component: str) -> None:
        """Print it."""
        print("  deactivate", component)

    def set_parameters(self, component: str, parameters: object) -> None:
        """Print it."""
        print("  set", component, parameters)


model = Model("pumps")
pump = model.function("pump")
for name in ("left", "right"):
    pump.design(f"{name} pump", [model.component(f"{name}_pump_node", kind="process")])
model.action("water_plants", requires=[pump])

kb = KnowledgeBase(model, clock=lambda: 0.0)
manager = ConfigurationManager(kb, Robot(), planner=LeastUsed())
for morning in range(1, 4):
    print("morning", morning)
    kb.request_action("water_plants")
    manager.update()
    kb.cancel_action("water_plants", "completed")
    manager.update()
