"""Which corridors, and which configuration in each: planned together, to a proven optimum, within limits.

What the corridors allow, and what that takes, is asked of the knowledge base; nothing here knows what a camera is.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from operator import add
from typing import NamedTuple

from kb import KnowledgeBase
from missions.agv.building import Building, Corridor, check_number
from missions.agv.model import NAVIGATE
from missions.agv.modes import GOALS, Amounts, Mode, Modes, crossing, switching, weighing
from missions.engine.mission import MissionError
from rosa_pddl.search import Move, cheapest, distances


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
        for what, given in (("weight", self.weights), ("limit", self.limits)):
            for name, value in given.items():
                if name not in GOALS:
                    raise MissionError(f"there is no {what} {name!r}; there are {', '.join(GOALS)}")
                check_number(f"the {what} of {name}", value)
        for name, light in self.light.items():
            check_number(f"light of corridor {name}", light, most=1.0)
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
    why: str = ""

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
    """

    legs: tuple[Leg, ...]
    is_solved: bool
    cost: int
    takes: Amounts
    reason: str


State = tuple[Place, Mode]
_Way = tuple[Corridor, str, str, float, float, Mapping[str, float]]  # from, to, how far, past how many, under what


class Task:
    """One question as a graph of places and modes, for the exact search; and for those who judge the planner."""

    def __init__(self, planner: "JointPlanner", question: Question) -> None:
        self.building = building = planner.building
        self.question, self.modes = question, planner.modes
        place = question.start or Place(building.start)
        self.start: State = (place if place.corridor else Place(place.name), planner.modes.running)
        self.goal = question.goal or building.goal
        building.check_place(place.name, "start")
        building.check_place(self.goal, "goal")
        for corridor in (*question.light, *filter(None, [place.corridor])):
            building.check_corridor(corridor)
        if place.corridor and place.name not in building.corridors[place.corridor].ends:
            raise MissionError(f"corridor {place.corridor} does not begin at {place.name}, from where the robot came")
        check_number("driven_m", place.driven_m, -math.inf)
        self.limited = tuple(name for name in GOALS if name in question.limits)
        # a hair more, as amounts are rounded
        self.limits = tuple(math.floor(question.limits[name] * GOALS[name] + 1e-6) for name in self.limited)
        self._indices = tuple(list(GOALS).index(name) for name in self.limited)
        self._crossing, self._weighed = planner.crossing, weighing(question.weights)
        self._whole = {name: self._priced(*self._way(one, one.ends[0])[3:]) for name, one in building.corridors.items()}
        self._steps: dict[Place, list[tuple[Leg, int]]] = {}
        self._switching: dict[tuple[Mode, Mode], tuple[Amounts, int]] = {}

    def moves(self, state: State) -> Iterator[Move[State, Leg]]:
        """Yield each corridor from here in each mode that is possible in it."""
        place, before = state
        if place not in self._steps:
            self._steps[place] = self.crossings(place)
        for leg, cost in self._steps[place]:
            switched, more = self.switching(before, leg.mode)
            uses = tuple([switched[number] + leg.takes[number] for number in self._indices])
            yield Move((Place(leg.to), leg.mode), cost + more, uses, leg)

    def is_goal(self, state: State) -> bool:
        return state[0] == Place(self.goal)

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        if state[0].corridor:  # only at the start, from where anything may still be far
            return 0, (0,) * len(self.limited)
        return self._least.get(state[0].name, (math.inf, (math.inf,) * len(self.limited)))

    def crossings(self, place: Place) -> list[tuple[Leg, int]]:
        """Return each way from a place, in each mode that is possible, without switching to it, and what it costs."""
        return [
            (Leg(corridor.name, origin, to, mode, conditions, takes), cost)
            for corridor, origin, to, length_m, passed, conditions in self._ways(place)
            for mode, takes, cost in (
                self._priced(length_m, passed, conditions) if place.corridor else self._whole[corridor.name]
            )
        ]

    def switching(self, before: Mode, after: Mode) -> tuple[Amounts, int]:
        """Return what it takes, and costs, to change modes."""
        if (before, after) not in self._switching:
            takes = switching(before, after)
            self._switching[before, after] = takes, self._weighed(takes)
        return self._switching[before, after]

    def demands(self, corridor: Corridor) -> Mapping[str, float]:
        """Return what a corridor demands, as values of attributes: light from 0 to 1, and obstacles [1/m]."""
        return {"light": self.question.light.get(corridor.name, corridor.light), "obstacles": corridor.obstacles}

    def _ways(self, place: Place) -> Iterator[_Way]:
        """Yield the corridors at a place; from within one, on to its end, or back and into another."""
        if not place.corridor:
            yield from (self._way(corridor, place.name) for corridor in self.building.exits[place.name])
            return
        inside = self.building.corridors[place.corridor]
        back_m = min(max(place.driven_m, 0.0), inside.length_m)
        ahead, light = self._way(inside, place.name, inside.length_m - back_m), self.demands(inside)["light"]
        yield ahead
        if place.name == self.goal:
            yield inside, ahead[2], place.name, back_m, 0.0, {"light": light, "obstacles": 0.0}
        for other in self.building.exits[place.name]:
            if other is not inside:  # what was passed on the way here is known, so the way back is free
                _, origin, to, length_m, passed, conditions = self._way(other, place.name)
                both = {**conditions, "light": min(light, conditions["light"])}
                yield other, origin, to, length_m + back_m, passed, both

    def _way(self, corridor: Corridor, origin: str, length_m: float | None = None) -> _Way:
        """Return a corridor from one of its ends: all of it, or what is left of it."""
        left_m = corridor.length_m if length_m is None else length_m
        return corridor, origin, corridor.other(origin), left_m, corridor.obstacles * left_m, self.demands(corridor)

    def _priced(
        self, length_m: float, passed: float, conditions: Mapping[str, float]
    ) -> list[tuple[Mode, Amounts, int]]:
        taken = [(mode, self._crossing(mode, length_m, passed)) for mode in self.modes.under(conditions)]
        return [(mode, takes, self._weighed(takes)) for mode, takes in taken]

    @cached_property
    def _least(self) -> dict[str, tuple[float, tuple[float, ...]]]:
        """What it costs at least, and uses, from each place to the goal, whatever the modes."""
        arcs: list[tuple[str, str, list[int]]] = []
        for name, priced in self._whole.items():
            if priced:
                counted = [[cost, *[takes[number] for number in self._indices]] for _, takes, cost in priced]
                (one, two), least = self.building.corridors[name].ends, list(map(min, *counted, counted[0]))
                arcs += [(one, two, least), (two, one, least)]
        numbers = range(1 + len(self.limited))
        far = [distances([(one, two, least[n]) for one, two, least in arcs], [self.goal]) for n in numbers]
        return {name: (cost, tuple([use[name] for use in far[1:]])) for name, cost in far[0].items()}


class JointPlanner:
    """Plans corridors and configurations together.

    Args:
        kb: what to ask for configurations; its facts count, except for measurements of the demands.

    Raises:
        UnknownName: the model has no function to navigate; when asked, no attribute for what corridors demand.
    """

    def __init__(self, building: Building, kb: KnowledgeBase) -> None:
        self.building, self._kb, self.modes = building, kb, Modes(kb, NAVIGATE)
        # what whole corridors take is asked again and again, and what is left of one never again
        self.crossing = lru_cache(maxsize=100_000)(crossing)

    def task(self, question: Question) -> Task:
        """Return a question as a graph; raises MissionError if it names a place or corridor that there is not."""
        return Task(self, question)

    def plan(self, question: Question) -> Answer:
        """Return the best plan, proven, or a proof that there is none with the reason; raises as `task`."""
        task = self.task(question)
        found = cheapest(task, task.start, task.limits)
        if found is None:
            return Answer((), False, 0, Amounts(0, 0, 0), self._why_not(task))
        modes = [task.start[1], *(move.to[1] for move in found.moves)]
        legs = tuple(self._leg(task, before, move.what) for before, move in zip(modes, found.moves, strict=False))
        takes = Amounts(*map(sum, zip(*(leg.takes for leg in legs), strict=True))) if legs else Amounts(0, 0, 0)
        return Answer(legs, True, found.cost, takes, self._why(task, legs, takes))

    def _leg(self, task: Task, before: Mode, leg: Leg) -> Leg:
        takes = Amounts(*map(add, task.switching(before, leg.mode)[0], leg.takes))
        possible = self.modes.under(leg.conditions)
        designs = {tuple(one.choice.designs.values()) for one in possible}
        demands = f"light {leg.conditions['light']:g} and {leg.conditions['obstacles']:g} obstacles/m"
        choice = "the only design that is" if len(designs) == 1 else f"of {len(possible)} that are"
        return replace(leg, takes=takes, why=f"{choice} feasible with {demands}")

    def _why(self, task: Task, legs: tuple[Leg, ...], takes: Amounts) -> str:
        if not legs:
            return f"already at {task.goal}"
        route = ", ".join(leg.corridor for leg in legs)
        weights = [(name, weight) for name, weight in task.question.weights.items() if weight]
        goal = " + ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights)
        within = [f"{name} {task.question.limits[name]:g}" for name in task.limited]
        limits = f" within {' and '.join(within)}" if within else ""
        time_s, energy_j, collisions = takes.in_units.values()
        amounts = f"{time_s:.1f} s, {energy_j:.0f} J, {collisions:.3f} collisions expected"
        return f"{route}: of all ways the best for {goal}{limits} ({amounts})"

    def _why_not(self, task: Task) -> str:
        blocked = [one for one in self.building.corridors.values() if not self.modes.under(task.demands(one))]
        why = self.modes.why_none(task.demands(blocked[0])) if blocked else ""
        if len(blocked) == len(self.building.corridors):
            wrong = [f"{one.message}, {one.advice}; " for one in self._kb.model.check() if one.severity == "error"]
            faults = "".join(wrong[:1])
            return f"no corridor can be crossed in any configuration; {faults}in {blocked[0].name}, {why}"
        alone = {name: self.plan(replace(task.question, weights={name: 1e3}, limits={})) for name in task.limited}
        if not task.limited or not all(one.is_solved for one in alone.values()):
            named = ", ".join(one.name for one in blocked[:5])
            because = f"{named} cannot be crossed: {why}" if blocked else "no way"
            return f"{task.goal} cannot be reached from {task.start[0].name}; {because}"
        limits = [
            f"{name} {task.question.limits[name]:g} (alone {one.takes.in_units[name]:.6g} or more)"
            for name, one in alone.items()
        ]
        return f"no way keeps within all limits: {', '.join(limits)}"
