"""A Markov decision process, solved by value iteration over the situations of a knowledge base.

A rover films a cave of four chambers. Filming drains the battery, and a chamber can break the
camera. What is feasible in a state is asked of the knowledge base: the decider knows neither the
limit of the battery nor what the camera is for.
"""

from functools import cache
from typing import NamedTuple

from kb import KnowledgeBase, Model

model = Model("cave_rover")
battery = model.quality_attribute("battery", low=0.0, high=1.0)
camera = model.component("camera")
film = model.function("film")
film.design("by_camera", [camera], priority=1)
model.action("film_chamber", requires=[film], constraints=[battery >= 0.3])
model.action("recharge")
model.action("repair")
model.action("go_home", constraints=[battery >= 0.1])

CHAMBERS = 4
P_BREAK = 0.2
DISCOUNT = 0.95
REWARDS = {"film_chamber": 10.0, "recharge": -2.0, "repair": -4.0, "go_home": 0.0}


class State(NamedTuple):
    """What is filmed, the battery in tenths, and whether the camera works."""

    filmed: int
    tenths: int
    camera_works: bool
    is_home: bool = False


kb = KnowledgeBase(model, clock=lambda: 0.0)


@cache
def feasible(tenths: int, camera_works: bool) -> tuple[str, ...]:
    """Return the actions that are feasible in a supposed situation."""
    failed = [] if camera_works else ["camera"]
    return kb.situation(battery=tenths / 10, failed=failed).selectable_actions()


def outcomes(state: State, action: str) -> list[tuple[float, State]]:
    """Return the states that may follow, each with its probability."""
    if action == "recharge":
        return [(1.0, state._replace(tenths=10))]
    if action == "repair":
        return [(1.0, state._replace(camera_works=True))]
    if action == "go_home":
        return [(1.0, state._replace(is_home=True))]
    after = state._replace(filmed=min(state.filmed + 1, CHAMBERS), tenths=max(state.tenths - 3, 0))
    return [(1.0 - P_BREAK, after), (P_BREAK, after._replace(camera_works=False))]


def worth(state: State, action: str, values: dict[State, float]) -> float:
    """Return the expected reward of an action and of all that follows."""
    is_useless = action == "film_chamber" and state.filmed == CHAMBERS
    reward = -1.0 if is_useless else REWARDS[action]
    following = sum(chance * values[after] for chance, after in outcomes(state, action))
    return reward + DISCOUNT * following


states = [
    State(filmed, tenths, works, home)
    for filmed in range(CHAMBERS + 1)
    for tenths in range(11)
    for works in (True, False)
    for home in (True, False)
]
values = dict.fromkeys(states, 0.0)
sweeps = 0
change = 1.0
while change > 1e-9:
    sweeps += 1
    change = 0.0
    for state in states:
        if not state.is_home:
            actions = feasible(state.tenths, state.camera_works)
            best = max(worth(state, action, values) for action in actions)
            change = max(change, abs(best - values[state]))
            values[state] = best
print(f"{len(states)} states, {feasible.cache_info().misses} situations, {sweeps} sweeps")


def decide(state: State) -> str:
    """Return the best feasible action."""
    actions = feasible(state.tenths, state.camera_works)
    return max(actions, key=lambda action: worth(state, action, values))


state = State(filmed=0, tenths=7, camera_works=True)
while not state.is_home:
    action = decide(state)
    print(f"{state.filmed} filmed, battery {state.tenths / 10}: {action}")
    breaks = action == "film_chamber" and state.filmed == 1  # the second chamber breaks the camera
    state = outcomes(state, action)[breaks][1]
