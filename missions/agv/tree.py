"""The task layer: the behaviour tree follows the joint plan, and replans when facts change.

until arrived └── follow route             one child for each corridor; the one that is planned next
is ticked ├── cross c1 └── ...

The question of the joint plan is also written as PDDL, for planners that know nothing of corridors.
There, switching the mode and crossing are steps of their own; both cost the same as in the joint
plan, in whole thousandths. A way is a corridor with one of its ends; where the robot is within a
corridor, two ways lead from there to its ends, and the rest of it is what these take.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from math import inf
from typing import Final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite

from kb import KnowledgeBase
from kb import Status as ElementStatus
from missions.agv.joint import (
    Answer,
    Leg,
    Mode,
    Modes,
    Place,
    Task,
    Weights,
    crossing,
    modes_of,
    switching,
)
from missions.agv.model import (
    BASE,
    FOLLOW,
    NAVIGATE,
    NAVIGATOR,
    Building,
    building_model,
    heading,
    headings,
)
from missions.engine.mission import Percepts
from rosa_bt import RosaAction
from rosa_bt.decorators import UntilSuccess
from rosa_pddl import Outcome, PlanRecord, Step

RESERVE: Final = 0.1
"""Share of the energy that plans do not use, because driving round obstacles takes more; own
choice."""
_PLENTY_J: Final = 1e9  # stands for energy without a limit


class Route:
    """Knows where the robot is, what has failed and where the light has changed.

    Replans when one of these changes.
    """

    def __init__(
        self, building: Building, kb: KnowledgeBase, percepts: Percepts, weights: Weights
    ) -> None:
        self.kb = kb
        self.modes = Modes(kb)
        self._map = building
        self.percepts = percepts
        self._weights = weights
        self._believed: tuple[object, ...] = ()
        self._answer: Answer | None = None

    def __getstate__(self) -> None:
        """Return nothing: the plan that is kept here follows from the facts."""

    @property
    def building(self) -> Building:
        """The map, with the light that was reported."""
        corridors = dict(self._map.corridors)
        for name, corridor in corridors.items():
            light = self.percepts.value(f"light in {name}")
            if light is not None:
                corridors[name] = replace(corridor, light=light)
        return replace(self._map, corridors=corridors)

    @property
    def place(self) -> Place:
        """Where the robot is; within a corridor, the place that it came from and how far."""
        holds = self.percepts.holds
        reported = (place for place in self._map.places if holds(f"at {place}"))
        name = next(reported, self._map.start)
        for corridor in self._map.exits(name):
            if holds(f"in {corridor.name}"):
                return Place(name, corridor.name, self.kb.attributes["driven"].value or 0.0)
        return Place(name)

    @property
    def answer(self) -> Answer:
        """The plan for where the robot is, what has failed and where the light has changed."""
        components = self.kb.components.items()
        failed = [name for name, view in components if view.status is ElementStatus.FAILURE]
        believed = (self.place[:2], self.building, failed)
        if self._answer is None or believed != self._believed:
            self._believed = believed
            self._answer = self.task.plan()
        return self._answer

    @property
    def task(self) -> Task:
        """What to plan from here; of the energy that is left, the reserve is not used."""
        energy_j = self.kb.attributes["energy"].value
        limit_j = inf if energy_j is None else (1.0 - RESERVE) * max(0.0, energy_j)
        return Task(self.building, self.modes, self._weights, self.place, limit_j)

    def measure(self, **demands: float) -> None:
        """Tell the knowledge base the demands, as measurements of attributes."""
        for attribute, value in demands.items():
            self.kb.measure(attribute, value)

    def measure_standing(self) -> None:
        """Measure no obstacles, and the light of the corridor; places are fully lit."""
        corridor = self.building.corridors.get(self.place.corridor)
        self.measure(light=corridor.light if corridor else 1.0, obstacles=0.0)


class Cross(RosaAction):
    """Cross a corridor in the configuration that is planned for it.

    `choose` returns the leg that is planned now.
    """

    measures = ("light", "obstacles", "way")  # the demands of the corridor, as planned

    def __init__(self, route: Route, corridor: str, choose: Callable[[], Leg]) -> None:
        super().__init__(f"cross {corridor}", route.kb, f"cross_{corridor}")
        self._route = route
        self._choose = choose
        self._to = ""

    def brings(self) -> frozenset[str]:
        """Return the percepts that hold when it has succeeded, for `rosa verify`."""
        return frozenset({f"at {self._choose().to}"})

    @property
    def is_crossed(self) -> bool:
        return self._route.place == Place(self._to)

    def initialise(self) -> None:
        """Measure what the corridor demands, and select the planned configuration."""
        self._to = ""
        request = next(each for each in self.kb.required_actions if each.action == self.action)
        self._follow(request.number)  # the cause, not the measurements that are made now

    def update(self) -> Status:
        """Check whether the other end is reached; take over a new plan for the same corridor."""
        if self.is_crossed:
            return Status.SUCCESS
        self._follow()
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Set the demands back to those where it stands: this corridor lies ahead no more.

        The reason of an end is asked for first.
        """
        if new_status is Status.INVALID and not self.kb.is_feasible(self.action):
            why = self.kb.why(self.kb.actions[self.action])
            self.kb.cancel_action(self.action, "abandoned", why)
        self._route.measure_standing()

    def _follow(self, cause: int | None = None) -> None:
        leg = self._choose()
        mode = leg.mode
        navigator = heading(leg.corridor, leg.origin)
        if leg.to != self._to:
            self._to = leg.to
            way = [*headings(self._route.building)].index(navigator) + 1.0
            self._route.measure(light=leg.light, obstacles=leg.obstacles, way=way)
        designs = {NAVIGATE: mode.design, FOLLOW: "by_navigator"}
        configurations = {BASE: mode.setup.speed, NAVIGATOR: navigator}
        selected = [self.kb.designs[name].is_selected for name in designs.values()]
        selected += [self.kb.configurations[name].is_selected for name in configurations.values()]
        if not all(selected) and self.kb.pending_plan is None:  # else both would be abandoned
            why = f"{mode.name} is the best to cross {leg.corridor}, {leg.why}"
            self.kb.select(designs, configurations, why, cause=cause)


class FollowRoute(Composite):
    """Ticks the child for the corridor that is planned next; stops any other that runs.

    SUCCESS at the goal, and FAILURE while there is no plan, with the reason as feedback. `plans`
    holds the last joint plans, without those that are only the rest of the one before.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self.plans: tuple[PlanRecord, ...] = ()
        corridors = route.building.corridors
        self._crossings = {
            name: Cross(route, name, lambda: route.answer.legs[0]) for name in corridors
        }
        super().__init__("follow route", list(self._crossings.values()))

    def tick(self) -> Iterator[Behaviour]:
        answer = self._route.answer
        self._note(answer)
        planned = self._crossings[answer.legs[0].corridor] if answer.legs else None
        for child in self._crossings.values():
            if child is not planned and child.status is Status.RUNNING:
                if child.is_crossed:
                    yield from child.tick()
                else:
                    child.stop(Status.INVALID)
        self.current_child = planned
        self.feedback_message = answer.reason
        if planned is not None:
            yield from planned.tick()
            self.status = Status.RUNNING
        else:
            self.stop(Status.FAILURE if answer.cost is None else Status.SUCCESS)
        yield self

    def _note(self, answer: Answer) -> None:
        """Record a plan, unless it is the rest of the one before."""
        steps = []
        for leg in answer.legs:
            arguments = leg.corridor, leg.origin, leg.to, leg.mode.name
            steps.append(Step("cross", arguments, f"cross_{leg.corridor}"))
        solved = answer.cost is not None
        outcome = Outcome.SOLVED_OPTIMALLY if solved else Outcome.UNSOLVABLE_PROVEN
        for plan in self.plans[-1:]:
            if plan.outcome is outcome and [*plan.steps[len(plan.steps) - len(steps) :]] == steps:
                return
        reason = "; ".join([answer.reason, *map(str, answer.legs[:1])])
        record = PlanRecord(self._route.kb.now, reason, outcome, tuple(steps), "joint plan")
        self.plans = record.added_to(self.plans)


def agv_tree(route: Route) -> Behaviour:
    """Build the tree; it runs until the goal is reached."""
    return UntilSuccess("until arrived", FollowRoute(route))


# -------------------------------------------------------------------- the same question as PDDL


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
