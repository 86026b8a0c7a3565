"""Which corridors, and which configuration in each: planned together, to a proven optimum, within limits.

What the corridors allow, and what that takes, is asked of the knowledge base; nothing here knows what a camera is.
"""

import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from operator import add
from typing import Final, NamedTuple

from kb import KnowledgeBase
from missions.agv.building import Building, Corridor
from missions.agv.modes import GOALS, Amounts, Costs, Mode, Modes, check_number, running_mode, weighing
from missions.engine.mission import MissionError
from rosa_pddl.search import Move, cheapest, distances

DEMANDS: Final = ("light", "obstacles")
"""What corridors demand, as attributes: light from 0 to 1, and obstacles [1/m]."""

_UNITS: Final = {"time": (" s", 1e3), "energy": (" J", 1e3), "collisions": ("", 1e6)}  # and how many are counted as one


class Place(NamedTuple):
    """Where the robot is: at a place, or on the way from it along a corridor, so far [m]; beyond an end is there."""

    name: str
    corridor: str = ""
    driven_m: float = 0.0


@dataclass(frozen=True)
class Question:
    """What to plan.

    Attributes:
        start, goal: from where to which place; by default those of the building.
        weights: what a second, a joule and a collision ("time", "energy", "collisions") are worth.
        limits: at most how much of each may be used, by the same names, in [s], [J] and expected collisions.
        light: of corridors in which it is not as the map says, by name.
    """

    start: Place | None = None
    goal: str | None = None
    weights: Mapping[str, float] = field(default_factory=lambda: {"time": 1.0})
    limits: Mapping[str, float] = field(default_factory=dict)
    light: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.start, Place | None):
            raise MissionError(f"the start is {self.start!r}; it must be a Place, such as Place('hall')")
        for what, given in (("weight", self.weights), ("limit", self.limits)):
            for name, value in given.items():
                if name not in GOALS:
                    raise MissionError(f"there is no {what} {name!r}; there are {', '.join(GOALS)}")
                check_number(f"the {what} of {name}", value)
        if not any(self.weights.values()):
            raise MissionError(f"nothing is to be minimised; give one of {', '.join(GOALS)} a weight above 0")


@dataclass(frozen=True)
class Leg:
    """One corridor of a plan: from which end to which, how configured and why, under which conditions.

    What it takes counts what switching to the mode takes.
    """

    corridor: str
    origin: str
    to: str
    mode: Mode
    conditions: Mapping[str, float]
    takes: Amounts
    why: str

    def __str__(self) -> str:
        return f"{self.corridor} from {self.origin} to {self.to}: {self.mode.name} ({self.why})"


@dataclass(frozen=True)
class Answer:
    """A plan of least cost, or why there is none; either is proven.

    Attributes:
        legs: none if there is no plan, or the robot is there already.
        cost: the weighted sum [thousandths].
        takes: in all.
        reason: what was chosen and why, or why there is no plan.
        expanded: how many labels the proof took.
    """

    legs: tuple[Leg, ...]
    is_solved: bool
    cost: int
    takes: Amounts
    reason: str
    expanded: int = 0


class _Way(NamedTuple):
    """A corridor as it can be driven: where it leads, how far, past how many obstacles, under which conditions."""

    corridor: Corridor
    origin: str
    to: str
    length_m: float
    passed: float
    conditions: Mapping[str, float]


State = tuple[Place, Mode]
_Priced = tuple[Mode, Amounts, int]
_Crossing = tuple[_Way, Mode, Amounts, int]
_Taken = tuple[_Way, Amounts, Amounts]  # a way, what switching to the mode for it takes, and what driving it takes


class Task:
    """One question as a graph of places and modes, for the exact search; and for those who judge the planner."""

    def __init__(self, planner: "JointPlanner", question: Question) -> None:
        self.building = building = planner.building
        self.question, self.modes = question, planner.modes
        place = question.start or Place(building.start)
        self.start: State = (place if place.corridor else Place(place.name), planner.running)
        self.goal = question.goal or building.goal
        building.check_place(place.name, "start")
        building.check_place(self.goal, "goal")
        for corridor in (*question.light, *([place.corridor] if place.corridor else [])):
            building.check_corridor(corridor)
        for name, light in question.light.items():
            check_number(f"light of corridor {name}", light, most=1.0)
        if place.corridor and place.name not in building.corridors[place.corridor].ends:
            raise MissionError(f"corridor {place.corridor} does not begin at {place.name}, from where the robot came")
        if place.corridor and not math.isfinite(place.driven_m):
            raise MissionError(f"driven_m is {place.driven_m!r}; a finite number of metres is needed")
        self.limited = tuple(name for name in GOALS if name in question.limits)
        self.limits = tuple(
            # a hair more, as amounts are rounded
            math.floor(min(question.limits[name] * _UNITS[name][1] + 1e-6, sys.float_info.max))
            for name in self.limited
        )
        self._indices = tuple(GOALS.index(name) for name in self.limited)
        self._crossing, self._costs, self._weighed = planner.crossing, planner.costs, weighing(question.weights)
        self._whole = {one.name: self._priced(self.way(one, one.ends[0])) for one in building.corridors.values()}
        self._steps: dict[Place, list[_Crossing]] = {}
        self._switching: dict[tuple[Mode, Mode], tuple[Amounts, int]] = {}

    def moves(self, state: State) -> Iterator[Move[State, _Taken]]:
        """Yield each corridor from here in each mode that is possible in it."""
        place, before = state
        if place not in self._steps:
            self._steps[place] = self.crossings(place)
        for way, mode, crossing, cost in self._steps[place]:
            switching, more = self.switching(before, mode)
            uses = tuple([switching[number] + crossing[number] for number in self._indices])
            yield Move((Place(way.to), mode), cost + more, uses, (way, switching, crossing))

    def is_goal(self, state: State) -> bool:
        return state[0] == Place(self.goal)

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        return self._least.get(state[0], (math.inf, (math.inf,) * len(self.limited)))

    def crossings(self, place: Place) -> list[_Crossing]:
        """Return each way from a place, in each mode that is possible, with what that takes and costs."""
        return [
            (way, *priced)
            for way in self.ways(place)
            for priced in (self._priced(way) if place.corridor else self._whole[way.corridor.name])
        ]

    def switching(self, before: Mode, after: Mode) -> tuple[Amounts, int]:
        """Return what it takes, and costs, to change modes."""
        if (before, after) not in self._switching:
            takes = self._costs.switching(before, after)
            self._switching[before, after] = takes, self._weighed(takes)
        return self._switching[before, after]

    def ways(self, place: Place) -> Iterator[_Way]:
        """Yield the corridors at a place; from within one, on to its end, or back and into another."""
        if not place.corridor:
            yield from (self.way(corridor, place.name) for corridor in self.building.exits[place.name])
            return
        inside = self.building.corridors[place.corridor]
        back_m = min(max(place.driven_m, 0.0), inside.length_m)
        ahead, light = self.way(inside, place.name, inside.length_m - back_m), self._light(inside)
        yield ahead
        if place.name == self.goal:
            yield _Way(inside, ahead.to, place.name, back_m, 0.0, {"light": light, "obstacles": 0.0})
        for other in self.building.exits[place.name]:
            if other is not inside:  # what was passed on the way here is known, so the way back is free
                way = self.way(other, place.name)
                both = {**way.conditions, "light": min(light, way.conditions["light"])}
                yield _Way(other, way.origin, way.to, way.length_m + back_m, way.passed, both)

    def way(self, corridor: Corridor, origin: str, length_m: float | None = None) -> _Way:
        """Return a corridor from one of its ends: all of it, or what is left of it."""
        left_m = corridor.length_m if length_m is None else length_m
        demands = {"light": self._light(corridor), "obstacles": corridor.obstacles}
        return _Way(corridor, origin, corridor.other(origin), left_m, corridor.obstacles * left_m, demands)

    def _light(self, corridor: Corridor) -> float:
        return self.question.light.get(corridor.name, corridor.light)

    def _priced(self, way: _Way) -> list[_Priced]:
        crossed = [(mode, self._crossing(mode, way.length_m, way.passed)) for mode in self.modes.under(way.conditions)]
        return [(mode, takes, self._weighed(takes)) for mode, takes in crossed]

    @cached_property
    def _least(self) -> dict[Place, tuple[float, tuple[float, ...]]]:
        """What it costs at least, and uses, from each place to the goal, whatever the modes."""
        arcs: list[tuple[str, str, list[int]]] = []
        for name, priced in self._whole.items():
            if priced:
                counted = [self._counted(takes, cost) for _, takes, cost in priced]
                (one, two), least = self.building.corridors[name].ends, list(map(min, *counted, counted[0]))
                arcs += [(one, two, least), (two, one, least)]
        numbers = range(1 + len(self.limited))
        far = [distances([(one, two, least[n]) for one, two, least in arcs], [self.goal]) for n in numbers]
        found = {Place(name): (cost, tuple([use[name] for use in far[1:]])) for name, cost in far[0].items()}
        if self.start[0].corridor:
            ways = [
                [amount + each[way.to] for amount, each in zip(self._counted(takes, cost), far, strict=True)]
                for way, _, takes, cost in self.crossings(self.start[0])
                if way.to in far[0]
            ]
            costs, *uses = map(min, *ways, ways[0]) if ways else [math.inf] * len(far)
            found[self.start[0]] = (costs, tuple(uses))
        return found

    def _counted(self, takes: Amounts, cost: int) -> list[int]:
        return [cost, *[takes[number] for number in self._indices]]


class JointPlanner:
    """Plans corridors and configurations together.

    Args:
        kb: what to ask for configurations; its facts count, except for measurements of the demands.

    Raises:
        MissionError: the model has no attributes for what corridors demand.
        UnknownName: it has no such function.
    """

    def __init__(
        self, building: Building, kb: KnowledgeBase, function: str = "navigate", costs: Costs | None = None
    ) -> None:
        if lacking := [name for name in DEMANDS if name not in kb.attributes]:
            raise MissionError(
                f"corridors demand {' and '.join(DEMANDS)}, but model {kb.model.name} has no attribute "
                f"{' nor '.join(lacking)}; declare it as environmental, even if nothing is constrained by it"
            )
        self.building, self._kb, self._function = building, kb, function
        self.modes, self.costs = Modes(kb, function), costs or Costs()
        # what whole corridors take is asked again and again, and what is left of one never again
        self.crossing = lru_cache(maxsize=100_000)(self.costs.crossing)

    @property
    def running(self) -> Mode:
        """How the robot is configured now."""
        return running_mode(self._kb, self._function)

    def task(self, question: Question) -> Task:
        """Return a question as a graph; raises BuildingError if it names a place or corridor that there is not."""
        return Task(self, question)

    def plan(self, question: Question) -> Answer:
        """Return the best plan, proven, or a proof that there is none with the reason; raises as `task`."""
        task = self.task(question)
        found = cheapest(task, task.start, task.limits)
        if found is None:
            return Answer((), False, 0, Amounts(0, 0, 0), self._why_not(task))
        legs = tuple(self._leg(task, move) for move in found.moves)
        takes = Amounts(*(sum(leg.takes[number] for leg in legs) for number in range(len(GOALS))))
        return Answer(legs, True, found.cost, takes, self._why(task, legs, takes), found.expanded)

    def _leg(self, task: Task, move: Move[State, _Taken]) -> Leg:
        way, switching, crossing = move.what
        takes = Amounts(*map(add, switching, crossing))
        possible = self.modes.under(way.conditions)
        designs = {tuple(one.choice.designs.values()) for one in possible}
        demands = f"light {way.conditions['light']:g} and {way.conditions['obstacles']:g} obstacles/m"
        choice = "the only design that is" if len(designs) == 1 else f"of {len(possible)} that are"
        why = f"{choice} feasible with {demands}"
        return Leg(way.corridor.name, way.origin, way.to, move.to[1], way.conditions, takes, why)

    def _why(self, task: Task, legs: tuple[Leg, ...], takes: Amounts) -> str:
        if not legs:
            return f"already at {task.goal}"
        route = ", ".join(leg.corridor for leg in legs)
        weights = [(name, weight) for name, weight in task.question.weights.items() if weight]
        goal = " + ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights)
        within = [f"{name} {task.question.limits[name]:g}" for name in task.limited]
        limits = f" within {' and '.join(within)}" if within else ""
        amounts = f"{takes.time_s:.1f} s, {takes.energy_j:.0f} J, {takes.expected_collisions:.3f} collisions expected"
        return f"{route}: of all ways the best for {goal}{limits} ({amounts})"

    def _why_not(self, task: Task) -> str:
        ways = [task.way(corridor, corridor.ends[0]) for corridor in self.building.corridors.values()]
        blocked = [way for way in ways if not self.modes.under(way.conditions)]
        if len(blocked) == len(ways):
            why = self.modes.why_none(blocked[0].conditions)
            wrong = [f"{one.message}, {one.advice}; " for one in self._kb.model.check() if one.severity == "error"]
            faults = "".join(wrong[:1])
            return f"no corridor can be crossed in any configuration; {faults}in {blocked[0].corridor.name}, {why}"
        if not task.limited or task.least(task.start)[0] == math.inf:
            named = ", ".join(way.corridor.name for way in blocked[:5])
            why = f"{named} cannot be crossed: {self.modes.why_none(blocked[0].conditions)}" if blocked else "no way"
            return f"{task.goal} cannot be reached from {task.start[0].name}; {why}"
        return self._broken_limits(task)

    def _broken_limits(self, task: Task) -> str:
        """Say which limits are less than the least that there is of each alone."""
        least_of_each, broken = [], []
        for name, limit in zip(task.limited, task.limits, strict=True):
            unit, scale = _UNITS[name]
            alone = self.plan(replace(task.question, weights={name: 1e3}, limits={}))
            least = alone.takes[GOALS.index(name)]
            said = f"{name} would be {least / scale:.6g}{unit} at least"
            least_of_each.append(said)
            broken += [f"{said}, the limit is {task.question.limits[name]:g}{unit}"] if least > limit else []
        together = f"each alone can be kept, but not all together ({'; '.join(least_of_each)})"
        return f"no way keeps within the limits: {'; '.join(broken) or together}"
