"""The question of the joint planner as PDDL, for planners that know nothing of corridors.

Switching and crossing are separate actions; both cost the same as in the joint planner, in whole thousandths.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from missions.agv.building import Building
from missions.agv.joint import Amounts, Leg, Mode, Place, Task
from rosa_pddl.domain import FEASIBLE
from rosa_pddl.generation import ActionSchema, DeclaredProblem

SWITCH: Final = "switch"
"""Name of the PDDL action, and of the ROSA action, that changes the mode while the robot stands."""

_UNITS: Final = {"time": "ms", "energy": "mj", "collisions": "millionths"}
_PLENTY: Final = 1e15  # stands for an amount that has no limit


def used(name: str) -> str:
    """Return the numeric fact for how much of a resource is used up; its unit is in the name."""
    return f"{name}_used_{_UNITS[name]}"


def left_of(name: str) -> str:
    """Return the numeric fact for how much of a resource is left; its unit is in the name."""
    return f"{name}_left_{_UNITS[name]}"


def switch_schema(limited: Iterable[str]) -> ActionSchema:
    """Declare how modes are switched, and how much of the limited resources (see `Question`) that uses up."""
    return ActionSchema(
        SWITCH,
        parameters=("?now - setup", "?next - mode"),
        start=("(configured ?now)",),
        end_effects=("(not (configured ?now))", "(configured ?next)"),
        duration_s=1,
        cost="(switching ?now ?next)",
        uses={used(name): f"(switching_{name} ?now ?next)" for name in limited},
    )


def cross_schema(limited: Iterable[str]) -> ActionSchema:
    """Declare how ways are driven; each is the ROSA action of its corridor."""
    return ActionSchema(
        "cross",
        parameters=("?a - action", "?w - way", "?from ?to - place", "?m - mode"),
        start=("(at ?from)", "(leads ?w ?from ?to)", "(configured ?m)"),
        over_all=("(crosses ?a ?w)", f"({FEASIBLE} ?a)", "(possible ?w ?m)"),
        end_effects=("(not (at ?from))", "(at ?to)"),
        duration_s=60,
        cost="(crossing ?w ?m)",
        uses={used(name): f"(crossing_{name} ?w ?m)" for name in limited},
        action=None,
    )


class Via(NamedTuple):
    """A corridor in one direction; the origin is empty if the robot starts within a corridor."""

    corridor: str
    origin: str
    to: str


class PddlNames:
    """The PDDL names of places, ways and modes, all different as PDDL needs them, and the facts about them.

    `modes` are all modes there can be; `limited` names the resources with a limit. The place with the empty name is
    where the robot is within a corridor, and `now` is its configuration if that is none of the modes.
    """

    def __init__(self, building: Building, modes: Iterable[Mode], limited: Iterable[str]) -> None:
        self.building, self.limited = building, tuple(limited)
        self._taken = {SWITCH}
        corridors = building.corridors.values()
        self.actions = {name: self._distinct(f"cross_{name}") for name in building.corridors}
        self.places = {name: self._distinct(name) for name in building.places} | {"": self._distinct("here")}
        self.now = self._distinct("now")
        self.by_mode = {self._distinct(re.sub(r"\W", "_", mode.name.lower())): mode for mode in modes}
        self.modes = {mode.name: word for word, mode in self.by_mode.items()}
        ends = [(one, to) for one in corridors for to in one.ends]
        vias = [*(Via(one.name, one.other(to), to) for one, to in ends), *(Via(one.name, "", to) for one, to in ends)]
        self.vias = {via: self._distinct(f"{via.corridor}_{self.places[via.origin]}_{via.to}") for via in vias}
        # The way to where the robot is within a corridor. No plan uses it, but planners that work out which facts are
        # reachable would conclude without it that the robot is never there.
        self.vias[Via(vias[0].corridor, vias[0].to, "")] = self._distinct("entering")
        self.by_way = {word: via for via, word in self.vias.items()}

    @property
    def problem(self) -> DeclaredProblem:
        objects = {
            **dict.fromkeys(self.actions.values(), "action"),
            **dict.fromkeys(self.places.values(), "place"),
            **dict.fromkeys(self.by_mode, "mode"),
            self.now: "setup",
            **dict.fromkeys(self.by_way, "way"),
        }
        fixed = [
            fact
            for via, way in self.vias.items()
            for fact in (
                f"(leads {way} {self.places[via.origin]} {self.places[via.to]})",
                f"(crosses {self.actions[via.corridor]} {way})",
            )
        ]
        goal = (f"(at {self.places[self.building.goal]})",)
        limits = {used(name): f"({left_of(name)})" for name in self.limited}
        return DeclaredProblem(goal, objects, tuple(fixed), types={"mode": "setup"}, limits=limits)

    def facts(self, task: Task) -> dict[str, bool | float]:
        """Return the facts that may change: where the robot is, its configuration, what is possible, and the costs.

        Costs are whole thousandths, uses are whole amounts (see `Amounts`); it also says what is left of the limited.
        """
        place, now = task.start
        at = self.places["" if place.corridor else place.name]
        configured = next((word for word, one in self.by_mode.items() if one.setup == now.setup), self.now)
        facts: dict[str, bool | float] = {
            **{f"(at {one})": one == at for one in self.places.values()},
            **{f"(configured {mode})": mode == configured for mode in (*self.by_mode, self.now)},
            **{f"(possible {way} {mode})": False for way in self.by_way for mode in self.by_mode},
        }
        for via, leg, cost in self._crossings(task):
            things = f"{self.vias[via]} {self.modes[leg.mode.name]}"
            facts |= {f"(possible {things})": True, **self._numbers("crossing", things, leg.takes, cost)}
        for before, one in {**self.by_mode, self.now: now}.items():
            for mode, other in self.by_mode.items():
                facts |= self._numbers("switching", f"{before} {mode}", *task.switching(one, other))
        left = dict(zip(task.limited, task.limits, strict=True))
        for name in self.limited:  # each question counts from what is left now
            facts |= {f"({used(name)})": 0.0, f"({left_of(name)})": left.get(name, _PLENTY)}
        return facts

    def _numbers(self, kind: str, things: str, takes: Amounts, cost: int) -> dict[str, float]:
        uses = {f"({kind}_{name} {things})": float(getattr(takes, name)) for name in self.limited}
        return {f"({kind} {things})": cost, **uses}

    def _crossings(self, task: Task) -> Iterator[tuple[Via, Leg, int]]:
        start = task.start[0]
        for place in [*map(Place, task.building.places), *([start] if start.corridor else [])]:
            for leg, cost in task.crossings(place):
                if leg.mode.name in self.modes:  # else it was added to the model after the problem was made
                    yield Via(leg.corridor, "" if place.corridor else leg.origin, leg.to), leg, cost
                    if not start.corridor:  # a step begun within a corridor goes on at its end
                        yield Via(leg.corridor, "", leg.to), leg, cost

    def _distinct(self, wanted: str) -> str:
        while wanted in self._taken:
            wanted += "_"
        self._taken.add(wanted)
        return wanted
