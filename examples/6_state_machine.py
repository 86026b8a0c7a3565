"""Without a tree: the state machine of a feeding robot uses the same knowledge base."""

from collections.abc import Callable

from kb import KnowledgeBase, Model

model = Model("feeder")
feed = model.quality_attribute("feed_kg")  # in its hopper
door = model.component("barn_door")
enter = model.function("enter_barn")
enter.design("through_the_door", [door])
model.action("feed_cows", requires=[enter], constraints=[feed >= 5.0])
model.action("refill")
model.action("wait_outside")

kb = KnowledgeBase(model, clock=lambda: 0.0)


def successor(state: str) -> str:
    """Return the state that follows. What feeding takes is the model's to know."""
    is_full = (kb.attributes["feed_kg"].value or 0.0) >= 30.0
    if state == "refill" and not is_full:
        return "refill"
    if kb.is_feasible("feed_cows"):
        return "feed_cows"
    return "wait_outside" if is_full else "refill"


def switch(state: str, following: str) -> None:
    """Tell how one action ends, and that another begins."""
    if kb.is_feasible(state):
        kb.cancel_action(state, "completed")
    else:
        kb.cancel_action(state, "abandoned", kb.why(state))
    kb.request_action(following)


happenings: dict[str, Callable[[], None]] = {
    "9 kg in the hopper": lambda: kb.measure("feed_kg", 9.0),
    "4 kg": lambda: kb.measure("feed_kg", 4.0),
    "17 kg": lambda: kb.measure("feed_kg", 17.0),
    "30 kg": lambda: kb.measure("feed_kg", 30.0),
    "the door jams": lambda: kb.component_failed("barn_door"),
    "the door is repaired": lambda: kb.component_recovered("barn_door"),
}
state = "wait_outside"
kb.request_action(state)
for what, tell in happenings.items():
    tell()
    following = successor(state)
    if following != state:
        switch(state, following)
    state = following
    print(f"{what}: {state}")

print("and the record says:")
for action in kb.history.actions:
    print(f"  {action.action}: {action.result or 'goes on'} {action.reason}".rstrip())
