"""The question of the joint plan as PDDL, for planners that know nothing of corridors.

There, switching the mode and crossing are steps of their own; both cost the same as in the joint
plan, in whole thousandths. A way is a corridor with one of its ends; where the robot is within a
corridor, two ways lead from there to its ends, and the rest of it is what these take.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from py_trees.common import Status

from missions.agv.joint import Mode, crossing, modes_of, switching
from missions.agv.model import BASE, NAVIGATE, Building, building_model
from missions.agv.tree import Cross, Route
from rosa_bt import RosaAction
from rosa_pddl import Step

_PLENTY_J: Final = 1e9  # stands for energy without a limit


def pddl_name(mode: Mode) -> str:
    return mode.name.replace(" ", "-")


def problem(building: Building) -> str:
    """Return the problem file: the objects, the facts that never change, and the goal."""
    modes = map(pddl_name, modes_of(building_model(building)))
    objects = [f"{' '.join(building.places)} - place", f"{' '.join(modes)} - mode"]
    facts = []
    for name, corridor in building.corridors.items():
        objects.append(f"cross_{name} - action")
        for to in corridor.ends:
            objects.append(f"{name}-{to} - way")
            facts.append(f"(crosses cross_{name} {name}-{to})")
            facts.append(f"(leads {name}-{to} {corridor.other(to)} {to})")
    return f"""(define (problem drive) (:domain agv)
        (:objects {" ".join(objects)})
        (:init (switch_action switch) (= (energy_used_mj) 0) {" ".join(facts)})
        (:goal (and (at {building.goal}) (<= (energy_used_mj) (energy_left_mj))))
        (:metric minimize (total-cost)))"""


class Switch(RosaAction):
    """Change to a mode, where the robot stands."""

    def __init__(self, route: Route, mode: Mode) -> None:
        super().__init__(f"switch to {mode.name}", route.kb, "switch")
        self._modes = route.modes
        self._mode = mode

    def update(self) -> Status:
        """Select the mode, and succeed when it is in force."""
        if self.kb.pending_plan is not None:
            return Status.RUNNING
        mode = self._mode
        if self._modes.running == mode.setup:
            return Status.SUCCESS
        why = f"{mode.name} is planned for what comes next"
        self.kb.select({NAVIGATE: mode.design}, {BASE: mode.setup.speed}, why)
        return Status.RUNNING


def facts(route: Route) -> Mapping[str, bool | float]:
    """Return what holds now and what it costs.

    Updated with every fact and percept, but not as the robot drives on or draws energy.
    """
    return _facts(route, route.kb.revision, route.percepts.revision)


@lru_cache(maxsize=8)
def _facts(route: Route, *_: int) -> Mapping[str, bool | float]:
    task = route.task
    at, running = task.start
    # each question counts from what is left now
    facts = {"(energy_used_mj)": 0.0, "(energy_left_mj)": 1e3 * min(task.energy_j, _PLENTY_J)}
    for name in ("", *task.building.places):
        facts[f"(at {name or 'within'})"] = name == at
    setups = {pddl_name(mode): mode.setup for mode in route.modes.all}
    configured = next((word for word in setups if setups[word] == running), "now")
    for before, setup in {**setups, "now": running}.items():
        facts[f"(configured {before})"] = before == configured
        for after in setups:
            takes = switching(setup, setups[after])
            facts[f"(switching {before} {after})"] = task.cost(takes)
            facts[f"(switching_energy {before} {after})"] = takes.energy
    for corridor in task.building.corridors.values():
        for to in corridor.ends:
            way = f"{corridor.name}-{to}"
            facts[f"(leads {way} within {to})"] = corridor.name == task.place.corridor
            length_m, obstacles = task.stretch(corridor, to)
            possible = route.modes.under(corridor.light, obstacles)
            for mode in route.modes.all:
                driving = f"{way} {pddl_name(mode)}"
                # a way that led back to here ends now, whatever is possible further on
                facts[f"(possible {driving})"] = mode in possible or to == at
                takes = crossing(mode, length_m, obstacles)
                facts[f"(crossing {driving})"] = task.cost(takes)
                facts[f"(crossing_energy {driving})"] = takes.energy
    return facts


def cross(route: Route, step: Step) -> Cross:
    """Return the behaviour of a step that drives a way in a mode."""
    _, way, _, _, word = step.arguments
    task = route.task
    for leg in task.legs(task.start[0]):
        if (f"{leg.corridor}-{leg.to}", pddl_name(leg.mode)) == (way, word):
            break
    return Cross(route, leg.corridor, lambda: leg)


def switch(route: Route, step: Step) -> Switch:
    """Return the behaviour of a step that changes to a mode."""
    modes = [mode for mode in route.modes.all if pddl_name(mode) == step.arguments[-1]]
    return Switch(route, modes[0])
