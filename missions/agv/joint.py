"""Plans the corridors and the configuration in each together: a proven optimum, within a limit.

The exact search of `rosa_pddl` finds the plan. Situations of the knowledge base say which
configurations are possible in a corridor; nothing here knows what a camera is. All amounts are
whole numbers, rounded once for each corridor and mode, so the limit is exact.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise, product
from math import inf
from typing import Any, Final, NamedTuple

from kb import KnowledgeBase, Model
from missions.agv.model import BASE, DRAW_W, NAVIGATE, Building, Corridor
from rosa_pddl.search import Move, cheapest, distances

COLLISION_S: Final = 30.0
"""How long a collision stops the robot [s]; this and the next three are our own choice."""
SWITCH_S: Final = 0.5
"""Time to start or stop a component [s]."""
SET_S: Final = 0.1
"""Time to give a component another configuration [s]."""
STANDING_W: Final = 10.0
"""Power that the robot draws while it switches [W]."""


class Weights(NamedTuple):
    """What is minimised: the cost of a second, a joule, and an expected collision."""

    time: float = 0.0
    energy: float = 0.0
    collisions: float = 0.0

    def __str__(self) -> str:
        weights = self._asdict().items()
        terms = [f"{weight:g} {name}".removeprefix("1 ") for name, weight in weights if weight]
        return " + ".join(terms)


class Amounts(NamedTuple):
    """Time [ms], energy [mJ], expected collisions [millionths]."""

    time: int = 0
    energy: int = 0
    collisions: int = 0


class Setup(NamedTuple):
    """What is switched: the components that run, and the configuration of the base."""

    components: frozenset[str]
    speed: str


@dataclass(frozen=True, eq=False)
class Mode:
    """One way to configure the robot: a design with a speed.

    Attributes:
        metres_per_second: the speed that the base is set to.
        watts: the power that it draws by the estimations.
        mishaps: how many collisions are expected for each obstacle that is passed.
    """

    design: str
    setup: Setup
    metres_per_second: float
    watts: float
    mishaps: float

    @property
    def name(self) -> str:
        return f"{self.design} {self.setup.speed}"


def modes_of(model: Model) -> list[Mode]:
    """Return all modes that a model has, possible or not."""
    estimated = {(each.causer.name, each.attribute): -each.adds for each in model.estimations}
    designs = [each for each in model.designs.values() if each.function == NAVIGATE]
    speeds = [each for each in model.configurations.values() if each.component == BASE]
    modes = []
    for design, speed in product(designs, speeds):
        setup = Setup(frozenset(design.components), speed.name)
        metres_per_second: Any = speed.parameters["speed"]
        watts, mishaps = (
            estimated[speed.name, attribute] + estimated[design.name, attribute]
            for attribute in ("energy", "safety")
        )
        modes.append(Mode(design.name, setup, metres_per_second, watts, mishaps))
    return modes


class Modes:
    """The modes of a robot, and which of them are possible; its knowledge base says it."""

    def __init__(self, kb: KnowledgeBase) -> None:
        self.kb = kb
        self.all = modes_of(kb.model)
        self._possible = lru_cache(maxsize=1000)(self._read)

    @property
    def running(self) -> Setup:
        """How the robot is configured now."""
        components = self.kb.components
        active = frozenset(name for name in (*DRAW_W, BASE) if components[name].is_active)
        speed = components[BASE].selected_configuration if BASE in active else None
        return Setup(active, speed or "")

    def under(self, light: float, obstacles: float) -> list[Mode]:
        """Return the modes that are possible in a light [0 to 1] among obstacles [1/m]."""
        return self._possible(self.kb.revision, light, obstacles)

    def _read(self, _: int, light: float, obstacles: float) -> list[Mode]:
        situation = self.kb.situation(light=light, obstacles=obstacles)
        designs = situation.selectable_designs(NAVIGATE)
        speeds = situation.selectable_configurations(BASE)
        return [mode for mode in self.all if mode.design in designs and mode.setup.speed in speeds]


@lru_cache(maxsize=10_000)  # each question asks again for the same corridors
def crossing(mode: Mode, length_m: float, obstacles: float) -> Amounts:
    """Return what it takes to drive a length [m] among obstacles [1/m].

    A collision stops the robot for a while; this time counts as often as a collision is expected.
    """
    collisions = obstacles * length_m * mode.mishaps
    time_s = length_m / mode.metres_per_second + collisions * COLLISION_S
    return Amounts(round(time_s * 1e3), round(time_s * mode.watts * 1e3), round(collisions * 1e6))


@cache
def switching(before: Setup, after: Setup) -> Amounts:
    """Return what a change takes: the robot stands, and switches one by one."""
    time_s = SWITCH_S * len(before.components ^ after.components)
    time_s += SET_S * (before.speed != after.speed)
    return Amounts(round(time_s * 1e3), round(time_s * STANDING_W * 1e3), 0)


class Place(NamedTuple):
    """Where the robot is: at a place, or so far from it in a corridor [m]."""

    name: str
    corridor: str = ""
    driven_m: float = 0.0

    def __str__(self) -> str:
        return f"within {self.corridor}" if self.corridor else self.name


class Leg(NamedTuple):
    """One corridor of a plan: its direction, the mode in it, and the conditions there.

    Attributes:
        possible: the modes that are possible there.
        cost: the weighted sum of what it takes, without the switching [thousandths].
    """

    corridor: str
    origin: str
    to: str
    light: float
    obstacles: float
    possible: list[Mode]
    mode: Mode
    takes: Amounts
    cost: int

    @property
    def why(self) -> str:
        """Why this mode was chosen."""
        is_only = len({mode.design for mode in self.possible}) == 1
        choice = "the only design that is" if is_only else f"of {len(self.possible)} that are"
        conditions = f"light {self.light:g} and {self.obstacles:g} obstacles/m"
        return f"{choice} feasible with {conditions}"

    def __str__(self) -> str:
        return f"{self.corridor} from {self.origin} to {self.to}: {self.mode.name} ({self.why})"


class Answer(NamedTuple):
    """A plan of least cost, or the reason why there is none; both are proven.

    Attributes:
        legs: empty if there is no plan, or if the robot is at the goal already.
        cost: the weighted sum [thousandths]; None if there is no plan.
        reason: what was chosen and why, or why there is no plan.
    """

    legs: tuple[Leg, ...]
    cost: int | None
    reason: str


State = tuple[str, Setup]
"""The place where the robot is, empty if it is within a corridor; and how it is configured."""


class Task:
    """One question as a graph of places and modes, for the exact search and for PDDL.

    Args:
        building: with the light that there is now.
        place: where the robot is; it drives to the goal of the building.
        energy_j: how much energy it may use [J]; infinite if that is not known.
    """

    def __init__(
        self,
        building: Building,
        modes: Modes,
        weights: Weights,
        place: Place,
        energy_j: float = inf,
    ) -> None:
        self.building = building
        self.place = place
        self.energy_j = energy_j
        self.start: State = ("" if place.corridor else place.name, modes.running)
        self._modes = modes
        self._weights = weights
        self.legs = cache(self._legs)

    def plan(self) -> Answer:
        """Return the best plan, proven, or a proof that there is none with the reason."""
        limit_mj = self.energy_j * 1e3 + 1e-6  # a hair more, as amounts are rounded
        path = cheapest(self, self.start, [limit_mj])
        goal = self.building.goal
        if path is None:
            return Answer((), None, self._why_not())
        if not path.moves:
            return Answer((), 0, f"already at {goal}")
        legs = tuple(move.what for move in path.moves)
        setups = [self.start[1], *(leg.mode.setup for leg in legs)]
        parts = [leg.takes for leg in legs] + [switching(*pair) for pair in pairwise(setups)]
        time, energy, collisions = map(sum, zip(*parts, strict=True))
        route = ", ".join(leg.corridor for leg in legs)
        best = f"of all ways the best for {self._weights}"
        if self.energy_j < inf:
            best += f" within energy {self.energy_j:g}"
        amounts = f"{time / 1e3:.1f} s, {energy / 1e3:.0f} J"
        expected = f"{collisions / 1e6:.3f} collisions expected"
        return Answer(legs, path.cost, f"{route}: {best} ({amounts}, {expected})")

    def cost(self, takes: Amounts) -> int:
        """Return the weighted sum of amounts [thousandths]."""
        weights = self._weights
        timely = weights.time * takes.time + weights.energy * takes.energy
        return round(timely + weights.collisions * 1e-3 * takes.collisions)

    def stretch(self, corridor: Corridor, to: str) -> tuple[float, float]:
        """Return what lies ahead on the way to an end: its length [m], and obstacles [1/m].

        The robot knows the obstacles that it has passed, so none count on the way back.
        """
        place = self.place
        if corridor.name != place.corridor:
            return corridor.length_m, corridor.obstacles
        if to == place.name:
            return place.driven_m, 0.0
        return max(0.0, corridor.length_m - place.driven_m), corridor.obstacles

    # ---------------------------------------------------------------- the graph

    def moves(self, state: State) -> Iterator[Move[State, Leg]]:
        """Yield a move for each corridor from here and each mode that is possible in it."""
        at, before = state
        for leg in self.legs(at):
            setup = leg.mode.setup
            switched = switching(before, setup)
            energy_mj = leg.takes.energy + switched.energy
            yield Move((leg.to, setup), leg.cost + self.cost(switched), (energy_mj,), leg)

    def is_goal(self, state: State) -> bool:
        return state[0] == self.building.goal

    def least(self, state: State) -> tuple[float, tuple[float]]:
        """Return lower bounds of cost and energy from a state to the goal."""
        costs, energies = self._bounds
        return costs.get(state[0], inf), (energies.get(state[0], inf),)

    @cached_property
    def _bounds(self) -> tuple[dict[str, float], dict[str, float]]:
        """The least cost and energy from each place, without switching; 0 within a corridor."""
        legs = [leg for place in self.building.places for leg in self.legs(place)]
        goals = [self.building.goal]
        costs = distances([(leg.origin, leg.to, leg.cost) for leg in legs], goals)
        energies = distances([(leg.origin, leg.to, leg.takes.energy) for leg in legs], goals)
        return {"": 0, **costs}, {"": 0, **energies}

    def _legs(self, at: str) -> list[Leg]:
        """Return a leg for each way and possible mode; within a corridor also back and on.

        What can be driven in one mode from within a corridor into another is one leg.
        """
        place = self.place
        if at:
            exits = self.building.exits(at)
            return [leg for part in exits for leg in self._along(part, part.other(at))]
        inside = self.building.corridors[place.corridor]
        back = self._along(inside, place.name)
        by_mode = {leg.mode: leg for leg in back}
        turning = []
        for leg in self.legs(place.name):
            first = by_mode.get(leg.mode)
            if first is not None and leg.corridor != inside.name:
                takes = Amounts(*map(sum, zip(first.takes, leg.takes, strict=True)))
                light = min(first.light, leg.light)
                cost = first.cost + leg.cost
                turning.append(leg._replace(light=light, takes=takes, cost=cost))
        return [*self._along(inside, inside.other(place.name)), *turning, *back]

    def _along(self, corridor: Corridor, to: str) -> list[Leg]:
        """Return a leg to an end of a corridor for each possible mode."""
        length_m, obstacles = self.stretch(corridor, to)
        possible = self._modes.under(corridor.light, obstacles)
        way = corridor.name, corridor.other(to), to, corridor.light, obstacles, possible
        legs = []
        for mode in possible:
            takes = crossing(mode, length_m, obstacles)
            legs.append(Leg(*way, mode, takes, self.cost(takes)))
        return legs

    def _why_not(self) -> str:
        """Return why there is no plan."""
        goal = self.building.goal
        path = cheapest(self, self.start, [inf])
        if path is not None:
            least_j = sum(move.uses[0] for move in path.moves) / 1e3
            return f"no way takes at most {self.energy_j:.0f} J; the best takes {least_j:.0f} J"
        reason = f"{goal} cannot be reached from {self.place}"
        corridors = self.building.corridors.values()
        blocked = [part for part in corridors if not self._modes.under(part.light, part.obstacles)]
        if not blocked:
            return reason
        names = ", ".join(corridor.name for corridor in blocked)
        kb = self._modes.kb
        situation = kb.situation(light=blocked[0].light, obstacles=blocked[0].obstacles)
        why = situation.why(situation.functions[NAVIGATE])
        return f"{reason}; {names} cannot be crossed: {why}"
