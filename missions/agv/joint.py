"""Plans the corridors and the configuration in each together: a proven optimum, within limits.

The exact search of `rosa_pddl` finds the plan. Situations of the knowledge base say which
configurations are possible in a corridor; nothing here knows what a camera is. All amounts are
whole numbers, rounded once for each corridor and mode, so limits are exact.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from itertools import product
from math import floor, inf, nan
from operator import add, mul
from typing import Any, Final, NamedTuple

from kb import Choice, KnowledgeBase
from missions.agv.model import NAVIGATE, Building, Corridor, checked
from missions.engine.settings import MissionError
from rosa_pddl.search import Move, cheapest, distances

GOALS: Final = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
"""What can be minimised: [s], [J] and expected collisions; and how many whole amounts make one."""

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

    time: int = 0
    energy: int = 0
    collisions: int = 0

    def plus(self, other: "Amounts") -> "Amounts":
        return Amounts(*map(add, self, other))

    @property
    def in_units(self) -> Mapping[str, float]:
        """The amounts by goal, in [s], [J] and expected collisions."""
        return {name: amount / GOALS[name] for name, amount in zip(GOALS, self, strict=True)}


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to configure the robot; `Modes` has one object of each, until a fact changes.

    Attributes:
        name: names of the designs and configurations; empty for `Modes.running`.
        choice: a design for each function and a configuration for each component with some.
        components: the components that run.
        speed: the speed that the configurations set [m/s].
        energy: the power that it draws by the estimations [W].
        safety: how many collisions are expected for each obstacle that is passed.
    """

    name: str
    choice: Choice = field(repr=False)
    components: frozenset[str] = field(repr=False)
    speed: float = field(default=nan, repr=False)
    energy: float = field(default=nan, repr=False)
    safety: float = field(default=nan, repr=False)

    @property
    def setup(self) -> tuple[object, ...]:
        """What is equal for two modes if nothing has to be switched between them."""
        return self.components, self.choice.configurations


class Modes:
    """Returns which modes of a function are possible under which conditions, by situations.

    Raises:
        UnknownName: no such function.
    """

    def __init__(self, kb: KnowledgeBase, function: str) -> None:
        self._kb = kb
        self._function = kb.functions[function].name
        self._revision = -1
        self._all: list[Mode] = []
        self._by_conditions: dict[tuple[float, ...], list[Mode]] = {}

    def __getstate__(self) -> None:
        """Return nothing: the modes follow from the knowledge base."""

    @property
    def running(self) -> Mode:
        """How the robot is configured now: the active components of the function's designs."""
        kb = self._kb
        designs = [kb.designs[name] for name in kb.functions[self._function].designs]
        used = {name for design in designs for name in design.components}
        active = [name for name, view in kb.components.items() if name in used and view.is_active]
        selected = {name: kb.components[name].selected_configuration for name in active}
        configurations = {name: value for name, value in selected.items() if value}
        return Mode("", Choice({}, configurations), frozenset(active))

    def under(self, conditions: Mapping[str, float]) -> list[Mode]:
        """Return the modes that are possible while attributes have these values."""
        if self._revision != self._kb.revision:
            self._revision = self._kb.revision
            self._by_conditions = {}
            self._all = list(self._read())
        key = tuple(conditions.values())
        if key not in self._by_conditions:
            situation = self._kb.situation(conditions)
            selectable = set(situation.selectable_designs(self._function))
            for component in {name for mode in self._all for name in mode.components}:
                selectable.update(situation.selectable_configurations(component))
            self._by_conditions[key] = [
                mode for mode in self._all if selectable.issuperset(_names(mode.choice))
            ]
        return self._by_conditions[key]

    def _read(self) -> Iterator[Mode]:
        """Yield all modes of the model, possible or not."""
        kb = self._kb
        for design in kb.functions[self._function].designs:
            components = kb.designs[design].components
            configured = [name for name in components if kb.components[name].configurations]
            options = [kb.components[name].configurations for name in configured]
            for names in product(*options):
                choice = Choice({self._function: design}, dict(zip(configured, names, strict=True)))
                yield self._mode(choice, components)

    def _mode(self, choice: Choice, components: tuple[str, ...]) -> Mode:
        model = self._kb.model
        configurations = [model.configurations[part] for part in choice.configurations.values()]
        parts = [*(model.designs[part] for part in choice.designs.values()), *configurations]
        causers = [*parts, *(model.components[component] for component in components)]
        speeds: list[Any] = [
            part.parameters["speed"] for part in configurations if "speed" in part.parameters
        ]
        amounts = {"energy": 0.0, "safety": 0.0}
        for estimation in model.estimations:
            if estimation.attribute in amounts and estimation.causer in causers:
                amounts[estimation.attribute] -= estimation.adds
        name = " ".join(part.name for part in parts)
        return Mode(name, choice, frozenset(components), float(speeds[0]), **amounts)


def _names(choice: Choice) -> list[str]:
    return [*choice.designs.values(), *choice.configurations.values()]


@lru_cache(maxsize=10_000)  # each question asks again for the same corridors
def crossing(mode: Mode, length_m: float, passed: float) -> Amounts:
    """Return what it takes to drive a length [m] past a number of obstacles.

    A collision stops the robot for a while; this time counts as often as a collision is expected.
    """
    collisions = passed * mode.safety
    time_s = length_m / mode.speed + collisions * COLLISION_S
    return Amounts(round(time_s * 1e3), round(time_s * mode.energy * 1e3), round(collisions * 1e6))


def switching(before: Mode, after: Mode) -> Amounts:
    """Return what a change of modes takes: the robot stands, and switches one by one."""
    configurations = before.choice.configurations
    changes = after.choice.configurations.items()
    time_s = SWITCH_S * len(before.components ^ after.components)
    time_s += SET_S * sum(configurations.get(component) != name for component, name in changes)
    return Amounts(round(time_s * 1e3), round(time_s * STANDING_W * 1e3), 0)


class Place(NamedTuple):
    """Where the robot is: at a place, or so far from it in a corridor [m]."""

    name: str
    corridor: str = ""
    driven_m: float = 0.0


@dataclass(frozen=True)
class Question:
    """What to plan.

    Attributes:
        start, goal: where the plan starts and ends; by default those of the building.
        weights: cost of a second, a joule and a collision ("time", "energy", "collisions").
        limits: how much of each may be used at most, in [s], [J] and expected collisions.
        light: light of the corridors where it differs from the map, 0 to 1, by name.
    """

    start: Place | None = None
    goal: str | None = None
    weights: Mapping[str, float] = field(default_factory=lambda: {"time": 1.0})
    limits: Mapping[str, float] = field(default_factory=dict)
    light: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for kind, values in (("weight", self.weights), ("limit", self.limits)):
            for name, value in values.items():
                if name not in GOALS:
                    raise MissionError(f"there is no {kind} {name!r}; there are {', '.join(GOALS)}")
                checked(f"the {kind} of {name}", value)
        if not any(self.weights.values()):
            goals = ", ".join(GOALS)
            raise MissionError(f"nothing is minimised; give one of {goals} a weight above 0")


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
    """A corridor in one direction, or a part of it, and the conditions there.

    `back_m` is what is driven back before, to the place where the corridor begins [m].
    """

    corridor: str
    origin: str
    to: str
    length_m: float
    passed: float  # obstacles
    conditions: Mapping[str, float]
    back_m: float = 0.0

    def takes(self, mode: Mode) -> Amounts:
        """Return what the way takes in a mode."""
        there = crossing(mode, self.length_m, self.passed)
        return there.plus(crossing(mode, self.back_m, 0.0)) if self.back_m else there


class Task:
    """One question as a graph of places and modes, for the exact search and for PDDL."""

    def __init__(self, building: Building, modes: Modes, question: Question) -> None:
        self.building = building
        self.question = question
        self.modes = modes
        place = question.start or Place(building.start)
        self.start: State = (place if place.corridor else Place(place.name), modes.running)
        self.goal = question.goal or building.goal
        building.check("place", place.name, "start")
        building.check("place", self.goal, "goal")
        for corridor in (*question.light, *filter(None, [place.corridor])):
            building.check("corridor", corridor, "the question")
        self.limited = tuple(name for name in GOALS if name in question.limits)
        # a hair more, as amounts are rounded
        amounts = [question.limits[name] * GOALS[name] + 1e-6 for name in self.limited]
        self.limits = tuple(floor(amount) for amount in amounts)
        self._indices = [list(GOALS).index(name) for name in self.limited]
        scales = GOALS.items()
        self._weights = [question.weights.get(name, 0.0) * (1e3 / scale) for name, scale in scales]
        self.crossings = cache(self._crossings)
        self.switching = cache(self._switching)

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
        """Return lower bounds of cost and uses from a state to the goal."""
        bounds = [0.0] * (1 + len(self.limits))
        if not state[0].corridor:  # from within one, the start, 0 always holds
            bounds = [bound.get(state[0].name, inf) for bound in self._bounds]
        return bounds[0], tuple(bounds[1:])

    @cached_property
    def _bounds(self) -> list[Mapping[str, float]]:
        """The least cost, and the least use of what is limited, from each place to the goal."""
        arcs: list[tuple[str, str, list[int]]] = []
        for place in self.building.places:
            by_way: dict[tuple[str, str], list[list[int]]] = {}
            for leg, cost in self.crossings(Place(place)):
                amounts = [cost, *[leg.takes[number] for number in self._indices]]
                by_way.setdefault((leg.corridor, leg.to), []).append(amounts)
            for (_, to), rows in by_way.items():
                arcs.append((place, to, [min(column) for column in zip(*rows, strict=True)]))
        bounds: list[Mapping[str, float]] = []
        for number in range(1 + len(self.limits)):
            lengths = [(origin, to, least[number]) for origin, to, least in arcs]
            bounds.append(distances(lengths, [self.goal]))
        return bounds

    def demands(self, corridor: Corridor) -> Mapping[str, float]:
        """Return what a corridor demands: light from 0 to 1, and obstacles [1/m]."""
        light = self.question.light.get(corridor.name, corridor.light)
        return {"light": light, "obstacles": corridor.obstacles}

    def _crossings(self, place: Place) -> list[tuple[Leg, int]]:
        """Return a leg and its cost for each way and possible mode, without the switching."""
        legs = []
        for way in self._ways(place):
            for mode in self.modes.under(way.conditions):
                takes = way.takes(mode)
                leg = Leg(way.corridor, way.origin, way.to, mode, way.conditions, takes)
                legs.append((leg, self._cost(takes)))
        return legs

    def _switching(self, before: Mode, after: Mode) -> tuple[Amounts, int]:
        takes = switching(before, after)
        return takes, self._cost(takes)

    def _cost(self, takes: Amounts) -> int:
        """Return the weighted sum of amounts [thousandths]."""
        total: float = sum(map(mul, self._weights, takes))
        return round(total)

    def _ways(self, place: Place) -> Iterator[_Way]:
        """Yield the corridors at a place; within one: on to its end, back, or into another.

        The robot knows the obstacles that it has passed, so none count on the way back. From one
        corridor into another it can drive in one mode; then the tree does both as one action.
        """
        exits = self.building.exits[place.name]
        if not place.corridor:
            for corridor in exits:
                yield self._way(corridor, place.name, corridor.length_m)
            return
        inside = self.building.corridors[place.corridor]
        back_m = min(max(place.driven_m, 0.0), inside.length_m)
        ahead = self._way(inside, place.name, inside.length_m - back_m)
        light = ahead.conditions["light"]
        yield ahead
        for other in exits:
            if other is not inside:
                way = self._way(other, place.name, other.length_m)
                both = {**way.conditions, "light": min(light, way.conditions["light"])}
                yield way._replace(back_m=back_m, conditions=both)
        conditions = {"light": light, "obstacles": 0.0}
        yield _Way(inside.name, ahead.to, place.name, back_m, 0.0, conditions)

    def _way(self, corridor: Corridor, origin: str, length_m: float) -> _Way:
        """Return the last part of a corridor, of that length [m], on the way from one end."""
        passed = corridor.obstacles * length_m
        to = corridor.other(origin)
        return _Way(corridor.name, origin, to, length_m, passed, self.demands(corridor))


class JointPlanner:
    """Plans corridors and configurations together.

    Args:
        kb: its facts decide what is possible, except for measurements of what corridors demand.

    Raises:
        UnknownName: the model has no function to navigate, or no attribute for a demand.
    """

    def __init__(self, building: Building, kb: KnowledgeBase) -> None:
        self._building = building
        self._kb = kb
        self._modes = Modes(kb, NAVIGATE)

    def task(self, question: Question) -> Task:
        """Return a question as a graph.

        Raises:
            MissionError: it names a place or corridor that there is not.
        """
        return Task(self._building, self._modes, question)

    def plan(self, question: Question) -> Answer:
        """Return the best plan, proven, or a proof that there is none with the reason."""
        task = self.task(question)
        path = cheapest(task, task.start, task.limits)
        if path is None:
            return Answer((), False, 0, Amounts(), self._why_not(task))
        mode = task.start[1]
        legs = []
        total = Amounts()
        for move in path.moves:
            takes = task.switching(mode, move.what.mode)[0].plus(move.what.takes)
            total = total.plus(takes)
            legs.append(replace(move.what, takes=takes, why=self._why_mode(move.what)))
            mode = move.what.mode
        return Answer(tuple(legs), True, path.cost, total, _why(task, legs, total))

    def _why_mode(self, leg: Leg) -> str:
        possible = self._modes.under(leg.conditions)
        designs = {tuple(mode.choice.designs.values()) for mode in possible}
        choice = "the only design that is" if len(designs) == 1 else f"of {len(possible)} that are"
        light, obstacles = leg.conditions.values()
        return f"{choice} feasible with light {light:g} and {obstacles:g} obstacles/m"

    def _why_not(self, task: Task) -> str:
        alone = {}
        for name in task.limited:
            alone[name] = self.plan(replace(task.question, weights={name: 1e3}, limits={}))
        if alone and all(answer.is_solved for answer in alone.values()):
            limits = [
                f"{name} {task.question.limits[name]:g} "
                f"(alone {answer.takes.in_units[name]:.6g} or more)"
                for name, answer in alone.items()
            ]
            return f"no way keeps within all limits: {', '.join(limits)}"
        reason = f"{task.goal} cannot be reached from {task.start[0].name}"
        corridors = self._building.corridors.values()
        blocked = [part for part in corridors if not self._modes.under(task.demands(part))]
        if not blocked:
            return reason
        situation = self._kb.situation(task.demands(blocked[0]))
        why = situation.why(situation.functions[NAVIGATE])
        names = ", ".join(corridor.name for corridor in blocked[:5])
        return f"{reason}; {names} cannot be crossed: {why}"


def _why(task: Task, legs: list[Leg], takes: Amounts) -> str:
    if not legs:
        return f"already at {task.goal}"
    route = ", ".join(leg.corridor for leg in legs)
    weights = [(name, weight) for name, weight in task.question.weights.items() if weight]
    goal = " + ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights)
    limits = [f"{name} {task.question.limits[name]:g}" for name in task.limited]
    within = f" within {' and '.join(limits)}" if limits else ""
    time_s, energy_j, collisions = takes.in_units.values()
    amounts = f"{time_s:.1f} s, {energy_j:.0f} J, {collisions:.3f} collisions expected"
    return f"{route}: of all ways the best for {goal}{within} ({amounts})"
