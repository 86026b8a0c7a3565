"""Plans the corridors and the configuration in each together: a proven optimum, within limits.

The exact search of `rosa_pddl` finds the plan. Situations of the knowledge base say which configurations are possible
in a corridor; nothing here knows what a camera is. All amounts are whole numbers: milliseconds, millijoules and
millionths of a collision. They are rounded once, for each corridor and mode; nothing is rounded after that, so limits
are kept exactly.
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
from missions.agv.model import NAVIGATE, Building, Corridor, checked
from missions.engine.mission import MissionError
from rosa_pddl.search import Move, cheapest, distances

GOALS: Final = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
"""What can be minimised: seconds, joules and expected collisions; and how many whole amounts make one of each."""

COLLISION_S: Final = 30.0
"""How long a collision stops the robot [s]; this and the next three are our own choice."""
SWITCH_S: Final = 0.5
"""Time to start or stop a component [s]."""
SET_S: Final = 0.1
"""Time to give a component another configuration [s]."""
STANDING_W: Final = 10.0
"""Power that the robot draws while it switches [W]."""


class Amounts(NamedTuple):
    """Time [ms], energy [mJ], expected collisions [millionths]."""

    time: int
    energy: int
    collisions: int

    @property
    def in_units(self) -> Mapping[str, float]:
        """The amounts by goal, in [s], [J] and expected collisions."""
        return {name: amount / GOALS[name] for name, amount in zip(GOALS, self, strict=True)}


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to configure the robot; `Modes` makes one object of each, until a fact or the model changes.

    Attributes:
        name: names of the designs and configurations, such as "amcl_kinect fast"; empty for `Modes.running`.
        choice: a design for each function and a configuration for each component that has some.
        components: the components that run.
        speed: the speed that the configurations set [m/s].
        energy: the power that it draws by the estimations [W].
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
        """What is equal for two modes if nothing has to be switched between them."""
        return self.components, self.choice.configurations


class Modes:
    """Asks a knowledge base, by situations, which modes of a function are possible under which conditions.

    Conditions that violate the same constraints allow the same modes, so one situation serves them all. All answers and
    modes are forgotten as soon as a fact or the model changes.

    Raises:
        UnknownName: no such function.
    """

    def __getstate__(self) -> None:
        """Return nothing: what is kept here follows from the knowledge base."""

    def __init__(self, kb: KnowledgeBase, function: str) -> None:
        self._kb, self._function = kb, kb.functions[function].name
        self._revision = -1
        self._all: list[Mode] = []
        self._found: dict[tuple[object, ...], list[Mode]] = {}

    @property
    def running(self) -> Mode:
        """How the robot is configured now: the active ones among the components of the function's designs."""
        kb = self._kb
        parts = {
            part
            for name in kb.functions[self._function].designs
            for part in kb.designs[name].components
        }
        active = [
            part for part in kb.model.components if part in parts and kb.components[part].is_active
        ]
        selected = {part: kb.components[part].selected_configuration for part in active}
        return Mode(
            "",
            Choice({}, {part: name for part, name in selected.items() if name}),
            frozenset(active),
        )

    def under(self, conditions: Mapping[str, float]) -> list[Mode]:
        """Return the modes that are possible while attributes have these values; none if the function is unfeasible.

        Raises:
            MissionError: the model lacks the speed, the energy or the collisions of a mode.
        """
        if self._revision != self._kb.revision:
            self._revision, self._found, self._all = self._kb.revision, {}, list(self._read())
        key = self._key(conditions)
        if key not in self._found:
            situation = self._kb.situation(conditions)
            designs = {*situation.selectable_designs(self._function)}
            parts = {part for mode in self._all for part in mode.components}
            settings = {
                name for part in parts for name in situation.selectable_configurations(part)
            }
            self._found[key] = [
                mode
                for mode in self._all
                if designs.issuperset(mode.choice.designs.values())
                and settings.issuperset(mode.choice.configurations.values())
            ]
        return self._found[key]

    def _key(self, conditions: Mapping[str, float]) -> tuple[float, ...]:
        """Return whether each constraint holds; with hysteresis, which depends on more than the value, the value."""
        concerned = [
            (one, conditions[one.attribute])
            for one in self._kb.model.constraints
            if one.attribute in conditions
        ]
        return tuple(
            [
                value if one.hysteresis else OPERATORS[one.operator](value, one.value)
                for one, value in concerned
            ]
        )

    def _read(self) -> Iterator[Mode]:
        """Yield all modes of the model, possible or not."""
        kb = self._kb
        for design in kb.functions[self._function].designs:
            configured = {
                part: kb.components[part].configurations for part in kb.designs[design].components
            }
            parts = {part: names for part, names in configured.items() if names}
            for chosen in product(*parts.values()):
                choice = Choice({self._function: design}, dict(zip(parts, chosen, strict=True)))
                yield _mode(kb.model, choice, frozenset(configured))


def _mode(model: Model, choice: Choice, components: frozenset[str]) -> Mode:
    chosen = [model.designs[one] for one in choice.designs.values()]
    configurations = [model.configurations[one] for one in choice.configurations.values()]
    name = " ".join(one.name for one in (*chosen, *configurations))
    given = next(
        (one.parameters["speed"] for one in configurations if "speed" in one.parameters), None
    )
    speed = checked(f"speed [m/s], a parameter of the configurations of {name},", given, 1e-6)
    causers = {
        id(one)
        for one in (*chosen, *configurations, *(model.components[one] for one in components))
    }
    taken = []
    for attribute in ("energy", "safety"):
        some = [
            one
            for one in model.estimations
            if one.attribute == attribute and id(one.causer) in causers
        ]
        takes = 0.0 - sum([one.adds for one in some])
        what = f"what {name} takes from {attribute}, by estimations of the kind 'negative',"
        taken.append(checked(what, takes if some else None))
    return Mode(name, choice, components, float(speed), *taken)


@lru_cache(maxsize=10_000)  # each question asks again for the same whole corridors
def crossing(mode: Mode, length_m: float, passed: float) -> Amounts:
    """Return what it takes to drive a length [m] past a number of obstacles.

    A collision stops the robot for a while; this time counts as often as a collision is expected.
    """
    collisions = passed * mode.safety
    time_s = length_m / mode.speed + collisions * COLLISION_S
    return Amounts(round(time_s * 1e3), round(time_s * mode.energy * 1e3), round(collisions * 1e6))


def switching(before: Mode, after: Mode) -> Amounts:
    """Return what it takes to change from one mode to another: the robot stands, and switches one by one."""
    had, has = before.choice.configurations, after.choice.configurations
    time_s = SWITCH_S * len(before.components ^ after.components)
    time_s += SET_S * sum(had.get(part) != name for part, name in has.items())
    return Amounts(round(time_s * 1e3), round(time_s * STANDING_W * 1e3), 0)


def weighing(weights: Mapping[str, float]) -> Callable[[Amounts], int]:
    """Return the function that makes the weighted sum of amounts, in whole thousandths."""
    per_ms, per_mj, per_millionth = (
        weights.get(one, 0.0) * (1e3 / scale) for one, scale in GOALS.items()
    )
    return lambda takes: round(
        per_ms * takes.time + per_mj * takes.energy + per_millionth * takes.collisions
    )


class Place(NamedTuple):
    """Where the robot is: at a place, or so far from it in a corridor [m]; beyond an end counts as at the end."""

    name: str
    corridor: str = ""
    driven_m: float = 0.0


@dataclass(frozen=True)
class Question:
    """What to plan.

    Attributes:
        start, goal: where the plan starts and ends; by default those of the building.
        weights: cost of a second, a joule and a collision ("time", "energy", "collisions").
        limits: how much of each may be used at most, by the same names, in [s], [J] and expected collisions.
        light: light of the corridors where it differs from the map, 0 to 1, by name.
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
            raise MissionError(
                f"nothing is minimised; give one of {', '.join(GOALS)} a weight above 0"
            )


@dataclass(frozen=True)
class Leg:
    """One corridor of a plan: its direction, the mode in it and why, and the conditions there.

    `takes` includes what switching to the mode takes.
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
    """A plan of least cost, or the reason why there is none; both are proven.

    Attributes:
        legs: empty if there is no plan, or if the robot is at the goal already.
        cost: the weighted sum [thousandths].
        takes: the amounts of the whole plan.
        reason: what was chosen and why, or why there is no plan.
    """

    legs: tuple[Leg, ...]
    is_solved: bool
    cost: int
    takes: Amounts
    reason: str


State = tuple[Place, Mode]


class _Way(NamedTuple):
    """A corridor in one direction, or a part of it: its length [m], how many obstacles it has, and the conditions."""

    corridor: Corridor
    origin: str
    to: str
    length_m: float
    passed: float
    conditions: Mapping[str, float]


class Task:
    """One question as a graph of places and modes: for the exact search, the PDDL, and tests of the planner."""

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
            raise MissionError(
                f"corridor {place.corridor} does not begin at {place.name}, from where the robot came"
            )
        checked("driven_m", place.driven_m, -math.inf)
        self.limited = tuple(name for name in GOALS if name in question.limits)
        # a hair more, as amounts are rounded
        self.limits = tuple(
            math.floor(question.limits[name] * GOALS[name] + 1e-6) for name in self.limited
        )
        self._indices = tuple(list(GOALS).index(name) for name in self.limited)
        self._weighed = weighing(question.weights)
        self._whole = {
            name: self._priced(self._way(one, one.ends[0]))
            for name, one in building.corridors.items()
        }
        self.crossings, self.switching = cache(self._crossings), cache(self._switching)

    def moves(self, state: State) -> Iterator[Move[State, Leg]]:
        """Yield a move for each corridor from here and each mode that is possible in it."""
        place, before = state
        for leg, cost in self.crossings(place):
            switched, more = self.switching(before, leg.mode)
            uses = tuple([switched[number] + leg.takes[number] for number in self._indices])
            yield Move((Place(leg.to), leg.mode), cost + more, uses, leg)

    def is_goal(self, state: State) -> bool:
        return state[0] == Place(self.goal)

    def least(self, state: State) -> tuple[float, tuple[float, ...]]:
        if state[0].corridor:  # only the start; 0 is a bound that always holds
            return 0, (0,) * len(self.limited)
        return self._least.get(state[0].name, (math.inf, (math.inf,) * len(self.limited)))

    def demands(self, corridor: Corridor) -> Mapping[str, float]:
        """Return what a corridor demands, as values of attributes: light from 0 to 1, and obstacles [1/m]."""
        return {
            "light": self.question.light.get(corridor.name, corridor.light),
            "obstacles": corridor.obstacles,
        }

    def _crossings(self, place: Place) -> list[tuple[Leg, int]]:
        """Return a leg and its cost for each way from a place and each possible mode, without the switching."""
        return [
            (Leg(way.corridor.name, way.origin, way.to, mode, way.conditions, takes), cost)
            for way in self._ways(place)
            for mode, takes, cost in (
                self._priced(way) if place.corridor else self._whole[way.corridor.name]
            )
        ]

    def _switching(self, before: Mode, after: Mode) -> tuple[Amounts, int]:
        """Return what a change of modes takes, and its cost."""
        takes = switching(before, after)
        return takes, self._weighed(takes)

    def _ways(self, place: Place) -> Iterator[_Way]:
        """Yield the corridors at a place; from within a corridor: on to its end, or back and into another one."""
        if not place.corridor:
            yield from (
                self._way(corridor, place.name) for corridor in self.building.exits[place.name]
            )
            return
        inside = self.building.corridors[place.corridor]
        back_m = min(max(place.driven_m, 0.0), inside.length_m)
        ahead = self._way(inside, place.name, inside.length_m - back_m)
        light = ahead.conditions["light"]
        yield ahead
        if place.name == self.goal:
            yield _Way(
                inside, ahead.to, place.name, back_m, 0.0, {"light": light, "obstacles": 0.0}
            )
        for other in self.building.exits[place.name]:
            if (
                other is not inside
            ):  # the robot knows the obstacles that it has passed, so none count on the way back
                way = self._way(other, place.name)
                both = {**way.conditions, "light": min(light, way.conditions["light"])}
                yield _Way(other, way.origin, way.to, way.length_m + back_m, way.passed, both)

    def _way(self, corridor: Corridor, origin: str, length_m: float | None = None) -> _Way:
        """Return the way along a corridor from one of its ends; with a length [m], the rest of it."""
        left_m = corridor.length_m if length_m is None else length_m
        return _Way(
            corridor,
            origin,
            corridor.other(origin),
            left_m,
            corridor.obstacles * left_m,
            self.demands(corridor),
        )

    def _priced(self, way: _Way) -> list[tuple[Mode, Amounts, int]]:
        """Return each mode that is possible on a way, with what the way takes in it and its cost."""
        taken = [
            (mode, crossing(mode, way.length_m, way.passed))
            for mode in self.modes.under(way.conditions)
        ]
        return [(mode, takes, self._weighed(takes)) for mode, takes in taken]

    @cached_property
    def _least(self) -> dict[str, tuple[float, tuple[float, ...]]]:
        """The least cost, and the least use of what is limited, from each place to the goal, in any modes."""
        arcs: list[tuple[str, str, list[int]]] = []
        for name, priced in self._whole.items():
            if priced:
                counted = [
                    [cost, *[takes[number] for number in self._indices]]
                    for _, takes, cost in priced
                ]
                (one, two), least = (
                    self.building.corridors[name].ends,
                    list(map(min, *counted, counted[0])),
                )
                arcs += [(one, two, least), (two, one, least)]
        numbers = range(1 + len(self.limited))
        far = [
            distances([(one, two, least[n]) for one, two, least in arcs], [self.goal])
            for n in numbers
        ]
        return {
            name: (cost, tuple([use[name] for use in far[1:]])) for name, cost in far[0].items()
        }


class JointPlanner:
    """Plans corridors and configurations together.

    Args:
        kb: its facts decide what is possible, except for measurements of what corridors demand.

    Raises:
        UnknownName: the model has no function to navigate; when a plan is asked for: no attribute for a demand.
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
        legs = tuple(
            self._leg(task, before, move.what)
            for before, move in zip(modes, found.moves, strict=False)
        )
        takes = (
            Amounts(*map(sum, zip(*(leg.takes for leg in legs), strict=True)))
            if legs
            else Amounts(0, 0, 0)
        )
        return Answer(legs, True, found.cost, takes, self._why(task, legs, takes))

    def _leg(self, task: Task, before: Mode, leg: Leg) -> Leg:
        takes = Amounts(*map(add, task.switching(before, leg.mode)[0], leg.takes))
        possible = self.modes.under(leg.conditions)
        designs = {tuple(one.choice.designs.values()) for one in possible}
        demands = (
            f"light {leg.conditions['light']:g} and {leg.conditions['obstacles']:g} obstacles/m"
        )
        choice = "the only design that is" if len(designs) == 1 else f"of {len(possible)} that are"
        return replace(leg, takes=takes, why=f"{choice} feasible with {demands}")

    def _why(self, task: Task, legs: tuple[Leg, ...], takes: Amounts) -> str:
        if not legs:
            return f"already at {task.goal}"
        route = ", ".join(leg.corridor for leg in legs)
        weights = [(name, weight) for name, weight in task.question.weights.items() if weight]
        goal = " + ".join(
            name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights
        )
        within = [f"{name} {task.question.limits[name]:g}" for name in task.limited]
        limits = f" within {' and '.join(within)}" if within else ""
        time_s, energy_j, collisions = takes.in_units.values()
        amounts = f"{time_s:.1f} s, {energy_j:.0f} J, {collisions:.3f} collisions expected"
        return f"{route}: of all ways the best for {goal}{limits} ({amounts})"

    def _why_not(self, task: Task) -> str:
        blocked = [
            one
            for one in self.building.corridors.values()
            if not self.modes.under(task.demands(one))
        ]
        situations = [self._kb.situation(task.demands(one)) for one in blocked[:1]]
        why = "".join(one.why(one.functions[NAVIGATE]) for one in situations)
        if len(blocked) == len(self.building.corridors):
            wrong = [
                f"{one.message}, {one.advice}; "
                for one in self._kb.model.check()
                if one.severity == "error"
            ]
            faults = "".join(wrong[:1])
            return f"no corridor can be crossed in any configuration; {faults}in {blocked[0].name}, {why}"
        alone = {
            name: self.plan(replace(task.question, weights={name: 1e3}, limits={}))
            for name in task.limited
        }
        if not task.limited or not all(one.is_solved for one in alone.values()):
            named = ", ".join(one.name for one in blocked[:5])
            because = f"{named} cannot be crossed: {why}" if blocked else "no way"
            return f"{task.goal} cannot be reached from {task.start[0].name}; {because}"
        limits = [
            f"{name} {task.question.limits[name]:g} (alone {one.takes.in_units[name]:.6g} or more)"
            for name, one in alone.items()
        ]
        return f"no way keeps within all limits: {', '.join(limits)}"
