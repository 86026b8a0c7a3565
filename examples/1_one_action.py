"""One action, one constraint: a lawn mower that does not cut wet grass."""

from kb import KnowledgeBase, Model

# The model: what the robot can do, and what has to hold for that.
model = Model("mower")
moisture = model.environmental_attribute("moisture")  # of the grass, from 0 to 1
model.action("mow", constraints=[moisture <= 0.3])

# The knowledge base: facts go in, answers follow from them. It is handed its clock; here, time
# stands still.
kb = KnowledgeBase(model, clock=lambda: 0.0)
print("nothing is measured yet:", kb.is_feasible("mow"))  # unknown is not false

kb.measure("moisture", 0.8)
print("after the rain:", kb.is_feasible("mow"))
print(kb.explain("mow"))

# What if? A situation answers the same questions, and the facts stay as they are.
print("if the grass were dry:", kb.situation(moisture=0.1).is_feasible("mow"))
print("but it is not:", kb.is_feasible("mow"))
