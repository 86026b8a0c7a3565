"""The joint plan as PDDL: the same question for planners that know nothing of corridors, step by step.

Switching and crossing are actions of their own; both cost what the search counts, in whole thousandths.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from missions.agv.building import Building
from missions.agv.joint import Amounts, Leg, Mode, Place, Task
from rosa_pddl.domain import FEASIBLE
from rosa_pddl.generation import ActionSchema, DeclaredProblem

SWITCH: Final = "switch"
"""The PDDL action, and the ROSA action, of changing from one mode to another where the robot stands."""

_UNITS: Final = {"time": "ms", "energy": "mj", "collisions": "millionths"}
_PLENTY: Final = 1e15  # what is left of something of which it is not known how much is left


def used(name: str) -> str:
    """Return the numeric fact for how much of something was used up, with its unit."""
    return f"{name}_used_{_UNITS[name]}"


def left_of(name: str) -> str:
    """Return the numeric fact for how much of something may be used up at most, with its unit."""
    return f"{name}_left_{_UNITS[name]}"


def switch_schema(limited: Iterable[str]) -> ActionSchema:
    """Declare how modes are switched; of what is limited (see `Question`) it says how much that uses up."""
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
    """Declare how ways are driven, each as the ROSA action of its corridor."""
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
    """A corridor as it is driven to one of its ends; from where the robot is within a corridor, the origin is empty."""

    corridor: str
    origin: str
    to: str


class PddlNames:
    """What is called what in PDDL, where no two things of any kind have the same name, and what is so of them.

    Modes are all that there can be; `limited` is what no more may be used up of than there is. Where the robot is in
    a corridor is the place with the empty name, and `now` is how it is configured if that is no mode.
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
        # The way to where the robot is within a corridor. It is never planned, but without it planners that look ahead
        # what can happen at all take it that the robot never is there.
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
        """Return all that may change: where the robot is, how configured, what is possible, and what that costs.

        Driving and switching cost and use up whole thousandths; of what is limited it is said how much is left.
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
        for name in self.limited:  # what was used up is left no more
            facts |= {f"({used(name)})": 0.0, f"({left_of(name)})": left.get(name, _PLENTY)}
        return facts

    def _numbers(self, kind: str, things: str, takes: Amounts, cost: int) -> dict[str, float]:
        uses = {f"({kind}_{name} {things})": float(getattr(takes, name)) for name in self.limited}
        return {f"({kind} {things})": cost, **uses}

    def _crossings(self, task: Task) -> Iterator[tuple[Via, Leg, int]]:
        start = task.start[0]
        for place in [*map(Place, task.building.places), *([start] if start.corridor else [])]:
            for leg, cost in task.crossings(place):
                if leg.mode.name in self.modes:  # else the model has got it since the problem was made
                    yield Via(leg.corridor, "" if place.corridor else leg.origin, leg.to), leg, cost
                    if not start.corridor:  # what was begun within one goes on when the robot soon is in none any more
                        yield Via(leg.corridor, "", leg.to), leg, cost

    def _distinct(self, wanted: str) -> str:
        while wanted in self._taken:
            wanted += "_"
        self._taken.add(wanted)
        return wanted
