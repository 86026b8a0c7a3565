"""Which corridors, and which configuration in each: planned together, to a proven optimum, within limits.

It poses the question to the exact search of `rosa_pddl`. What the corridors allow, and what that takes, is asked of the
knowledge base by situations; nothing here knows what a camera is. All amounts are whole: milliseconds, millijoules and
millionths of a collision, rounded once for each corridor and mode (by at most half of one). From there on nothing is
rounded, so that limits are kept to the unit.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from itertools import product
from operator import add
from typing import Final, NamedTuple

from kb import Choice, KnowledgeBase, Model
from kb.status import OPERATORS
from missions.agv.building import Building, Corridor, checked
from missions.agv.model import NAVIGATE
from missions.engine.mission import MissionError
from rosa_pddl.search import Move, cheapest, distances

GOALS: Final = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
"""What can be weighed: seconds, joules, and collisions expected; and how many of its amounts each is."""

COLLISION_S: Final = 30.0
"""For how long a collision keeps the robot [s]; as the next three own choice."""
SWITCH_S: Final = 0.5
"""To start or stop a component [s]."""
SET_S: Final = 0.1
"""To give a component another configuration [s]."""
STANDING_W: Final = 10.0
"""What the robot draws while it switches [W]."""


class Amounts(NamedTuple):
    """Time [ms], energy [mJ], expected collisions [millionths]."""

    time: int
    energy: int
    collisions: int

    @property
    def in_units(self) -> Mapping[str, float]:
        """By goal: [s], [J], and how many collisions are expected."""
        return {name: amount / GOALS[name] for name, amount in zip(GOALS, self, strict=True)}


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to be configured; the same one is the same object, for one `Modes` until a fact changes.

    Attributes:
        name: of designs and configurations, such as "amcl_kinect fast"; empty if nothing runs.
        choice: a design for each function and a configuration for each component that has some.
        components: that run.
        speed: that its configurations set [m/s].
        energy: what it is estimated to draw [W].
        safety: how many collisions are expected for each obstacle that is passed.
    """

    name: str
    choice: Choice = field(repr=False)
    components: frozenset[str] = field(repr=False)
    speed: float = field(default=math.nan, repr=False)
    energy: float = field(default=math.nan, repr=False)
    safety: float = field(default=math.nan, repr=False)

    @property
    def setup(self) -> tuple[object, ...]:
        """What two modes have in common if nothing has to be switched from one to the other."""
        return self.components, self.choice.configurations


class Modes:
    """Asks a knowledge base, by situations, which modes of a function are possible under which conditions.

    Conditions that violate the same constraints allow the same modes, so one situation serves them all. All answers are
    forgotten, modes included, as soon as a fact or the model changes.

    Raises:
        UnknownName: no such function.
    """

    BOOKKEEPING = "_revision _all _found"

    def __init__(self, kb: KnowledgeBase, function: str) -> None:
        self._kb, self._function = kb, kb.functions[function].name
        self._revision = -1
        self._all: list[Mode] = []
        self._found: dict[tuple[object, ...], list[Mode]] = {}

    @property
    def running(self) -> Mode:
        """How the robot is configured now: the components of the function's designs that are active."""
        kb = self._kb
        parts = {part for name in kb.functions[self._function].designs for part in kb.designs[name].components}
        active = [part for part in kb.model.components if part in parts and kb.components[part].is_active]
        selected = {part: kb.components[part].selected_configuration for part in active}
        return Mode("", Choice({}, {part: name for part, name in selected.items() if name}), frozenset(active))

    def under(self, conditions: Mapping[str, float]) -> list[Mode]:
        """Return the modes that are possible while attributes have these values; none if the function is unfeasible.

        Raises:
            MissionError: the model does not say of a mode how fast it is, or what it takes.
        """
        if self._revision != self._kb.revision:
            self._revision, self._found, self._all = self._kb.revision, {}, list(self._read())
        key = self._key(conditions)
        if key not in self._found:
            situation = self._kb.situation(conditions)
            designs = {*situation.selectable_designs(self._function)}
            parts = {part for mode in self._all for part in mode.components}
            settings = {name for part in parts for name in situation.selectable_configurations(part)}
            self._found[key] = [
                mode
                for mode in self._all
                if designs.issuperset(mode.choice.designs.values())
                and settings.issuperset(mode.choice.configurations.values())
            ]
        return self._found[key]

    def _key(self, conditions: Mapping[str, float]) -> tuple[float, ...]:
        """Return which constraints hold; for one with hysteresis, which depends on more than the value, the value."""
        concerned = [
            (one, conditions[one.attribute]) for one in self._kb.model.constraints if one.attribute in conditions
        ]
        return tuple(
            [value if one.hysteresis else OPERATORS[one.operator](value, one.value) for one, value in concerned]
        )

    def _read(self) -> Iterator[Mode]:
        """Yield all modes of the model, whether they are possible or not."""
        kb = self._kb
        for design in kb.functions[self._function].designs:
            configured = {part: kb.components[part].configurations for part in kb.designs[design].components}
            parts = {part: names for part, names in configured.items() if names}
            for chosen in product(*parts.values()):
                choice = Choice({self._function: design}, dict(zip(parts, chosen, strict=True)))
                yield _mode(kb.model, choice, frozenset(configured))


def _mode(model: Model, choice: Choice, components: frozenset[str]) -> Mode:
    chosen = [model.designs[one] for one in choice.designs.values()]
    configurations = [model.configurations[one] for one in choice.configurations.values()]
    name = " ".join(one.name for one in (*chosen, *configurations))
    given = next((one.parameters["speed"] for one in configurations if "speed" in one.parameters), None)
    speed = checked(f"speed [m/s], a parameter of the configurations of {name},", given, 1e-6)
    causers = {id(one) for one in (*chosen, *configurations, *(model.components[one] for one in components))}
    taken = []
    for attribute in ("energy", "safety"):
        some = [one for one in model.estimations if one.attribute == attribute and id(one.causer) in causers]
        takes = 0.0 - sum([one.adds for one in some])
        what = f"what {name} takes from {attribute}, by estimations of the kind 'negative',"
        taken.append(checked(what, takes if some else None))
    return Mode(name, choice, components, float(speed), *taken)


@lru_cache(maxsize=10_000)
def crossing(mode: Mode, length_m: float, passed: float) -> Amounts:
    """Return what it takes to drive a length [m] past obstacles.

    A collision is a matter of chance; what it costs, it costs as often as it is expected: the robot stands for a while.
    """
    collisions = passed * mode.safety
    time_s = length_m / mode.speed + collisions * COLLISION_S
    return Amounts(round(time_s * 1e3), round(time_s * mode.energy * 1e3), round(collisions * 1e6))


def switching(before: Mode, after: Mode) -> Amounts:
    """Return what it takes to change from one mode to another: one thing after the other, while the robot stands."""
    had, has = before.choice.configurations, after.choice.configurations
    time_s = SWITCH_S * len(before.components ^ after.components)
    time_s += SET_S * sum(had.get(part) != name for part, name in has.items())
    return Amounts(round(time_s * 1e3), round(time_s * STANDING_W * 1e3), 0)


def weighing(weights: Mapping[str, float]) -> Callable[[Amounts], int]:
    """Return what makes a weighted sum of amounts, in whole thousandths."""
    per_ms, per_mj, per_millionth = (weights.get(one, 0.0) * (1e3 / scale) for one, scale in GOALS.items())
    return lambda takes: round(per_ms * takes.time + per_mj * takes.energy + per_millionth * takes.collisions)


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
                checked(f"the {what} of {name}", value)
        for name, light in self.light.items():
            checked(f"light of corridor {name}", light, most=1.0)
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


class _Way(NamedTuple):
    """A corridor as it is driven: between which places, how far [m], past how many obstacles, under what conditions."""

    corridor: Corridor
    origin: str
    to: str
    length_m: float
    passed: float
    conditions: Mapping[str, float]


class Task:
    """One question as a graph of places and modes, for the exact search; and for those who judge the planner."""

    def __init__(self, planner: "JointPlanner", question: Question) -> None:
        self.building = building = planner.building
        self.question, self.modes = question, planner.modes
        place = question.start or Place(building.start)
        self.start: State = (place if place.corridor else Place(place.name), planner.modes.running)
        self.goal = question.goal or building.goal
        building.check("place", place.name, "start")
        building.check("place", self.goal, "goal")
        for corridor in (*question.light, *filter(None, [place.corridor])):
            building.check("corridor", corridor, "the question")
        if place.corridor and place.name not in building.corridors[place.corridor].ends:
            raise MissionError(f"corridor {place.corridor} does not begin at {place.name}, from where the robot came")
        checked("driven_m", place.driven_m, -math.inf)
        self.limited = tuple(name for name in GOALS if name in question.limits)
        # a hair more, as amounts are rounded
        self.limits = tuple(math.floor(question.limits[name] * GOALS[name] + 1e-6) for name in self.limited)
        self._indices = tuple(list(GOALS).index(name) for name in self.limited)
        self._weighed = weighing(question.weights)
        self._whole = {name: self._priced(self._way(one, one.ends[0])) for name, one in building.corridors.items()}
        self.crossings, self.switching = cache(self._crossings), cache(self._switching)

    def moves(self, state: State) -> Iterator[Move[State, Leg]]:
        """Yield each corridor from here in each mode that is possible in it."""
        place, before = state
        for leg, cost in self.crossings(place):
            switched, more = self.switching(before, leg.mode)
            uses = tuple([switched[number] + leg.takes[number] for number in self._indices])
            yield Move((Place(leg.to), leg.mode), cost + more, uses, leg)

    def is_goal(self, state: State) -> bool:
        return state[0] == Place(self.goal)

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        if state[0].corridor:  # only at the start, from where anything may still be far
            return 0, (0,) * len(self.limited)
        return self._least.get(state[0].name, (math.inf, (math.inf,) * len(self.limited)))

    def demands(self, corridor: Corridor) -> Mapping[str, float]:
        """Return what a corridor demands, as values of attributes: light from 0 to 1, and obstacles [1/m]."""
        return {"light": self.question.light.get(corridor.name, corridor.light), "obstacles": corridor.obstacles}

    def _crossings(self, place: Place) -> list[tuple[Leg, int]]:
        """Return each way from a place, in each mode that is possible, without switching to it, and what it costs."""
        return [
            (Leg(way.corridor.name, way.origin, way.to, mode, way.conditions, takes), cost)
            for way in self._ways(place)
            for mode, takes, cost in (self._priced(way) if place.corridor else self._whole[way.corridor.name])
        ]

    def _switching(self, before: Mode, after: Mode) -> tuple[Amounts, int]:
        """Return what it takes, and costs, to change modes."""
        takes = switching(before, after)
        return takes, self._weighed(takes)

    def _ways(self, place: Place) -> Iterator[_Way]:
        """Yield the corridors at a place; from within one, on to its end, or back and into another."""
        if not place.corridor:
            yield from (self._way(corridor, place.name) for corridor in self.building.exits[place.name])
            return
        inside = self.building.corridors[place.corridor]
        back_m = min(max(place.driven_m, 0.0), inside.length_m)
        ahead = self._way(inside, place.name, inside.length_m - back_m)
        light = ahead.conditions["light"]
        yield ahead
        if place.name == self.goal:
            yield _Way(inside, ahead.to, place.name, back_m, 0.0, {"light": light, "obstacles": 0.0})
        for other in self.building.exits[place.name]:
            if other is not inside:  # what was passed on the way here is known, so the way back is free
                way = self._way(other, place.name)
                both = {**way.conditions, "light": min(light, way.conditions["light"])}
                yield _Way(other, way.origin, way.to, way.length_m + back_m, way.passed, both)

    def _way(self, corridor: Corridor, origin: str, length_m: float | None = None) -> _Way:
        """Return a corridor from one of its ends: all of it, or what is left of it."""
        left_m = corridor.length_m if length_m is None else length_m
        return _Way(
            corridor, origin, corridor.other(origin), left_m, corridor.obstacles * left_m, self.demands(corridor)
        )

    def _priced(self, way: _Way) -> list[tuple[Mode, Amounts, int]]:
        """Return the modes that are possible on a way, what it takes in each, and what that costs."""
        taken = [(mode, crossing(mode, way.length_m, way.passed)) for mode in self.modes.under(way.conditions)]
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
        situations = [self._kb.situation(task.demands(one)) for one in blocked[:1]]
        why = "".join(one.why(one.functions[NAVIGATE]) for one in situations)
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
