"""A behaviour tree: a drone that photographs what the wind lets it reach."""

from py_trees.behaviours import Running

from kb import KnowledgeBase, Model
from rosa_bt import ForAction, TreeRunner, first_feasible
from rosa_bt.display import ascii_tree

model = Model("drone")
wind = model.environmental_attribute("wind_m_s")
model.action("photograph_facade", constraints=[wind <= 8.0])  # close to the wall
model.action("photograph_roof", constraints=[wind <= 12.0])
model.action("stand_by")

kb = KnowledgeBase(model, clock=lambda: 0.0)

# ForAction puts any py_trees behaviour under an action: it runs only while the action is feasible,
# and the knowledge base is told that it does. Of the three, the first that is feasible is done.
tree = first_feasible(
    "survey",
    [
        ForAction("facade", kb, "photograph_facade", Running("fly along the wall")),
        ForAction("roof", kb, "photograph_roof", Running("fly over the roof")),
        ForAction("stand by", kb, "stand_by", Running("wait on the ground")),
    ],
)
runner = TreeRunner(tree, clock=lambda: 0.0)

for speed in (3.0, 9.5, 14.0):
    kb.measure("wind_m_s", speed)
    runner.tick()
    print(f"wind {speed:4} m/s:", *(required.action for required in kb.required_actions))

# The last tick as a picture, with what cannot be done and why.
print(ascii_tree(tree), end="")

# Whatever is running is stopped, and its request released.
runner.shutdown()
print("in the end:", kb.required_actions)
