"""The joint plan as PDDL: the same question for planners that know nothing of corridors, step by step.

Switching and crossing are actions of their own; both cost what the search counts, in whole thousandths.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from missions.agv.building import Building
from missions.agv.costs import GOALS, Amounts
from missions.agv.joint import Place, Task
from missions.agv.modes import Mode
from rosa_pddl.domain import FEASIBLE
from rosa_pddl.generation import ActionSchema, DeclaredProblem

__all__ = [
    "CROSS",
    "SWITCH",
    "Via",
    "PddlNames",
    "cross_schema",
    "facts_of",
    "left_of",
    "numbers_of",
    "problem_of",
    "switch_schema",
    "switching_of",
    "used",
]

SWITCH: Final = "switch"
"""The PDDL action, and the ROSA action, of changing from one mode to another where the robot stands."""

CROSS: Final = "cross"
"""The PDDL action of driving a way in a mode; its ROSA action is that of the corridor."""

_UNITS: Final = {"time": "ms", "energy": "mj", "collisions": "millionths"}
_PLENTY: Final = 1e15  # what is left of something of which it is not known how much is left


def used(name: str) -> str:
    """Return the numeric fact for how much of something was used up, with its unit."""
    return f"{name}_used_{_UNITS[name]}"


def left_of(name: str) -> str:
    """Return the numeric fact for how much of something may be used up at most, with its unit."""
    return f"{name}_left_{_UNITS[name]}"


def switch_schema(limited: Iterable[str] = ()) -> ActionSchema:
    """Declare how modes are switched; of what is limited (see `Question`) it is told how much that uses up."""
    return ActionSchema(
        SWITCH,
        parameters=("?now - setup", "?next - mode"),
        start=("(configured ?now)",),
        end_effects=("(not (configured ?now))", "(configured ?next)"),
        duration_s=1,
        cost="(switching ?now ?next)",
        uses={used(name): f"(switching_{name} ?now ?next)" for name in limited},
    )


def cross_schema(limited: Iterable[str] = ()) -> ActionSchema:
    """Declare how ways are driven; of what is limited it is told how much that uses up."""
    return ActionSchema(
        CROSS,
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
    """A corridor as it is driven to one of its ends, all of it or from where the robot is within a corridor."""

    corridor: str
    to: str
    is_whole: bool


class PddlNames:
    """What is called what in PDDL, where no two things of any kind have the same name.

    Args:
        building: the map.
        modes: all that there can be.
        has_inside: whether the robot may be within a corridor.

    Attributes:
        actions: the ROSA action of each corridor.
        places: by name; where the robot is within a corridor, by the empty name.
        modes: by name.
        vias: the ways.
        entering: the way to where the robot is within a corridor, which is never planned; without it planners that
            look ahead what can happen at all take it that the robot never is there. None if it never is.
        now: the object for how the robot is configured if that is none of the modes.
    """

    def __init__(self, building: Building, modes: Iterable[Mode], *, has_inside: bool = True) -> None:
        self._taken = {SWITCH}
        self.actions = {name: self._distinct(f"cross_{name}") for name in building.corridors}
        self.places = {name: self._distinct(name) for name in building.places}
        self.places |= {"": self._distinct("here")} if has_inside else {}
        self.now = self._distinct("now")
        self.by_mode = {self._distinct(re.sub(r"\W", "_", mode.name.lower())): mode for mode in modes}
        self.modes = {mode.name: word for word, mode in self.by_mode.items()}
        self.vias = {
            Via(one.name, to, is_whole): self._distinct(
                f"{one.name}_{self.places[one.other(to) if is_whole else '']}_{to}"
            )
            for is_whole in ((True, False) if has_inside else (True,))
            for one in building.corridors.values()
            for to in one.ends
        }
        self.entering = self._distinct("entering") if has_inside else None
        self.by_way = {word: via for via, word in self.vias.items()}
        self.building = building

    @property
    def objects(self) -> dict[str, str]:
        """The type of each."""
        return {
            **dict.fromkeys(self.actions.values(), "action"),
            **dict.fromkeys(self.places.values(), "place"),
            **dict.fromkeys(self.modes.values(), "mode"),
            self.now: "setup",
            **dict.fromkeys(self.ways, "way"),
        }

    @property
    def ways(self) -> list[str]:
        """The objects for the ways, also for that which is never planned."""
        return [*self.vias.values(), *([self.entering] if self.entering else [])]

    @property
    def fixed(self) -> Iterator[str]:
        """What is so for good."""
        for via, way in self.vias.items():
            origin = self.building.corridors[via.corridor].other(via.to) if via.is_whole else ""
            yield f"(leads {way} {self.places[origin]} {self.places[via.to]})"
            yield f"(crosses {self.actions[via.corridor]} {way})"
        if self.entering:
            one = next(iter(self.building.corridors.values()))
            yield f"(leads {self.entering} {self.places[one.ends[0]]} {self.places['']})"
            yield f"(crosses {self.actions[one.name]} {self.entering})"

    def place(self, place: Place) -> str:
        """Return the object for where the robot is."""
        return self.places["" if place.corridor else place.name]

    def mode(self, mode: Mode) -> str:
        """Return the object for how the robot is configured."""
        for word, one in self.by_mode.items():
            if (one.components, one.choice.configurations) == (mode.components, mode.choice.configurations):
                return word
        return self.now

    def _distinct(self, wanted: str) -> str:
        while wanted in self._taken:
            wanted += "_"
        self._taken.add(wanted)
        return wanted


def facts_of(pddl: PddlNames, task: Task) -> dict[str, bool]:
    """Return everything that may change, and whether it is so: where the robot is, how configured, what is possible."""
    possible = {(way, mode) for way, mode, *_ in _crossings(pddl, task)}
    at, configured = pddl.place(task.start[0]), pddl.mode(task.start[1])
    return {
        **{f"(at {place})": place == at for place in pddl.places.values()},
        **{f"(configured {mode})": mode == configured for mode in (*pddl.by_mode, pddl.now)},
        **{f"(possible {way} {mode})": (way, mode) in possible for way in pddl.ways for mode in pddl.modes.values()},
    }


def numbers_of(pddl: PddlNames, task: Task, limited: Iterable[str] = ()) -> dict[str, float]:
    """Return what it costs and uses up to drive where it is possible now and to switch, and what may be used up."""
    numbers: dict[str, float] = {}
    for way, mode, takes, cost in _crossings(pddl, task):
        numbers |= _told("crossing", f"{way} {mode}", takes, cost, limited)
    numbers |= switching_of(pddl, task, {pddl.now: task.start[1]}, limited)
    left = dict(zip(task.limited, task.limits, strict=True))
    for name in limited:  # what was used up is left no more
        numbers |= {f"({used(name)})": 0.0, f"({left_of(name)})": left.get(name, _PLENTY)}
    return numbers


def switching_of(
    pddl: PddlNames, task: Task, setups: Mapping[str, Mode], limited: Iterable[str] = ()
) -> dict[str, float]:
    """Return what it costs and uses up, in whole thousandths, to switch from setups to each mode; that stays so."""
    numbers: dict[str, float] = {}
    for now, one in setups.items():
        for mode, other in pddl.by_mode.items():
            numbers |= _told("switching", f"{now} {mode}", *task.switching(one, other), limited)
    return numbers


def problem_of(pddl: PddlNames, limited: Iterable[str] = ()) -> DeclaredProblem:
    """Return the problem of a building, without what may change."""
    goal = (f"(at {pddl.places[pddl.building.goal]})",)
    limits = {used(name): f"({left_of(name)})" for name in limited}
    return DeclaredProblem(goal, pddl.objects, tuple(pddl.fixed), types={"mode": "setup"}, limits=limits)


def _told(kind: str, things: str, takes: Amounts, cost: int, limited: Iterable[str]) -> dict[str, float]:
    uses = {f"({kind}_{name} {things})": float(takes[GOALS.index(name)]) for name in limited}
    return {f"({kind} {things})": cost, **uses}


def _crossings(pddl: PddlNames, task: Task) -> Iterator[tuple[str, str, Amounts, int]]:
    for place in _places(task):
        for way, mode, takes, cost in task.crossings(place):
            via = Via(way.corridor.name, way.to, not place.corridor)
            if mode.name not in pddl.modes:
                continue  # the model has got it since the problem was made
            yield pddl.vias[via], pddl.modes[mode.name], takes, cost
            part = via._replace(is_whole=False)
            if part in pddl.vias and not task.start[0].corridor:
                # what was begun within a corridor goes on when the robot is in none any more, as it soon will be again
                yield pddl.vias[part], pddl.modes[mode.name], takes, cost


def _places(task: Task) -> list[Place]:
    start = task.start[0]
    return [*map(Place, task.building.places), *([start] if start.corridor else [])]
