"""The task layer: the behaviour tree follows the joint plan, and replans when facts change.

until arrived └── follow route             one child for each corridor; the one that is planned next
is ticked ├── cross c1 if feasible └── ...

The question of the joint planner is also written as PDDL, for planners that know nothing of
corridors. There, switching the mode and crossing are steps of their own; both cost the same as in
the joint planner, in whole thousandths.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Composite

from kb import Choice, KnowledgeBase, ReconfigurationPlan
from kb import Status as ElementStatus
from missions.agv.joint import (
    Amounts,
    Answer,
    JointPlanner,
    Leg,
    Mode,
    Modes,
    Place,
    Question,
    Task,
)
from missions.agv.model import FOLLOW, NAVIGATE, NAVIGATOR, Building, heading, headings
from missions.engine.mission import Percepts
from rosa_bt import RosaAction, feasible_then_act
from rosa_bt.decorators import UntilSuccess
from rosa_pddl import Outcome, PlanRecord, Step

RESERVE: Final = 0.1
"""Share of the energy that plans do not use, because driving round obstacles takes more; own
choice."""


class Route:
    """Knows where the robot is, what has failed and where the light has changed.

    Replans when one of these changes.
    """

    def __init__(
        self,
        building: Building,
        kb: KnowledgeBase,
        percepts: Percepts,
        weights: Mapping[str, float],
    ) -> None:
        self.building = building
        self.kb = kb
        self._percepts = percepts
        self._weights = weights
        self._planner = JointPlanner(building, kb)
        self._believed: tuple[object, ...] = ()
        self._answer: Answer | None = None

    def __getstate__(self) -> None:
        """Return nothing: the plan that is kept here follows from the facts."""

    @property
    def at(self) -> str:
        """The place where the robot is; within a corridor, the place that it came from."""
        reported = (place for place in self.building.places if self._percepts.holds(f"at {place}"))
        return next(reported, self.building.start)

    @property
    def is_there(self) -> bool:
        return self.at == self.building.goal and not self.inside

    @property
    def answer(self) -> Answer:
        """The plan for where the robot is, what has failed and where the light has changed."""
        failed = [
            name
            for name in self.kb.components
            if self.kb.components[name].status is ElementStatus.FAILURE
        ]
        believed = (self.at, self.inside, *failed, *self._light.items())
        if self._answer is None or believed != self._believed:
            self._believed = believed
            self._answer = self._planner.plan(self.question)
        return self._answer

    @property
    def leg(self) -> Leg | None:
        """The next corridor of the plan; None if there is no plan, or the robot is at the goal."""
        return next(iter(self.answer.legs), None)

    @property
    def task(self) -> Task:
        return self._planner.task(self.question)

    @property
    def question(self) -> Question:
        """What to plan from here; the limit of the energy is what is left, less the reserve."""
        energy_j, driven_m = (self.kb.attributes[name].value for name in ("energy", "driven"))
        limits = {} if energy_j is None else {"energy": (1.0 - RESERVE) * max(0.0, energy_j)}
        place = Place(self.at, self.inside, driven_m or 0.0) if self.inside else Place(self.at)
        return Question(place, None, self._weights, limits, self._light)

    @property
    def inside(self) -> str:
        """The corridor that the robot is in; empty at a place."""
        return next(
            (
                corridor.name
                for corridor in self.building.exits[self.at]
                if self._percepts.holds(f"in {corridor.name}")
            ),
            "",
        )

    @property
    def standing(self) -> Mapping[str, float]:
        """The demands where the robot stands: no obstacles, and the light of the corridor.

        Places are fully lit.
        """
        corridor = self.building.corridors.get(self.inside)
        light = 1.0 if corridor is None else self._light.get(corridor.name, corridor.light)
        return {"obstacles": 0.0, "light": light}

    def measure(self, demands: Mapping[str, float]) -> None:
        """Tell the knowledge base the demands, as measurements of attributes."""
        for attribute, value in demands.items():
            self.kb.measure(attribute, value)

    @property
    def revision(self) -> tuple[object, ...]:
        """Changes with every fact and percept, but not as the robot drives on or draws energy."""
        return self.kb.revision, self._percepts.revision, self.kb.attributes["energy"].value is None

    @property
    def _light(self) -> Mapping[str, float]:
        """The light of the corridors for which it was reported."""
        reported = {
            name: self._percepts.value(f"light in {name}") for name in self.building.corridors
        }
        return {name: light for name, light in reported.items() if light is not None}


class Cross(RosaAction):
    """Cross a corridor in the configuration that is planned for it.

    `choose` returns the leg that is planned now.
    """

    measures = ("light", "obstacles", "way")  # the demands of the corridor, as planned

    def brings(self) -> frozenset[str]:
        """Return the percepts that hold when it has succeeded, for `rosa verify`."""
        leg = self._choose()
        return frozenset() if leg is None else frozenset({f"at {leg.to}"})

    def __init__(self, route: Route, corridor: str, choose: Callable[[], Leg | None]) -> None:
        super().__init__(f"cross {corridor}", route.kb, f"cross_{corridor}")
        self.corridor = corridor
        self._route = route
        self._choose = choose
        self._leg: Leg | None = None

    @property
    def is_crossed(self) -> bool:
        return self._leg is not None and self._route.at == self._leg.to and not self._route.inside

    def initialise(self) -> None:
        """Measure what the corridor demands, and select the planned configuration."""
        self._leg = self._choose()
        if self._leg is not None:
            request = next(each for each in self.kb.required_actions if each.action == self.action)
            self._face(self._leg, request.number)

    def update(self) -> Status:
        """Check whether the other end is reached; take over a new plan for the same corridor."""
        leg = self._leg
        if leg is None:
            self.feedback_message = f"{self.corridor} does not lead from {self._route.at}"
            return Status.FAILURE
        if self.is_crossed:
            return Status.SUCCESS
        self._leg = anew = self._choose() or leg
        if anew.to != leg.to:
            self._face(anew)
        elif not self._is_selected(anew):
            self._select(anew)  # the plan is new, or a plan was pending at the beginning
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Set the demands back to those where it stands: this corridor lies ahead no more."""
        self._route.measure(self._route.standing)

    def _face(self, leg: Leg, cause: int | None = None) -> None:
        way = headings(self._route.building).index((leg.corridor, leg.origin)) + 1.0
        self._route.measure({**leg.conditions, "way": way})
        self._select(leg, cause)  # the action is the cause, not the measurements just made

    def _is_selected(self, leg: Leg) -> bool:
        choice = _choice(leg)
        designs = [self.kb.designs[name] for name in choice.designs.values()]
        configurations = [self.kb.configurations[name] for name in choice.configurations.values()]
        return all(view.is_selected for view in (*designs, *configurations))

    def _select(self, leg: Leg, cause: int | None = None) -> None:
        if self.kb.pending_plan is None:  # else both would be abandoned together
            choice = _choice(leg)
            why = f"{leg.mode.name} is the best to cross {leg.corridor}, {leg.why}"
            self.kb.select(choice.designs, choice.configurations, why, cause=cause)


def _choice(leg: Leg) -> Choice:
    mode = leg.mode.choice
    navigator = {NAVIGATOR: heading(leg.corridor, leg.origin)}
    return Choice({**mode.designs, FOLLOW: "by_navigator"}, {**mode.configurations, **navigator})


class FollowRoute(Composite):
    """Ticks the child for the corridor that is planned next; stops any other that runs.

    SUCCESS at the goal; FAILURE when a corridor is crossed, and while there is no plan, with the
    reason as feedback. `plans` holds the last joint plans, without those that are only the rest of
    the one before.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self._crossings = {
            name: Cross(route, name, lambda: route.leg) for name in route.building.corridors
        }
        self._by_corridor = {
            name: feasible_then_act(crossing) for name, crossing in self._crossings.items()
        }
        self.plans: tuple[PlanRecord, ...] = ()
        self._planned: Answer | None = None
        super().__init__("follow route", list(self._by_corridor.values()))

    def tick(self) -> Iterator[Behaviour]:
        route = self._route
        is_there = self._route.is_there
        self._note(route.answer)
        planned = None if is_there or route.leg is None else self._by_corridor[route.leg.corridor]
        for name, child in self._by_corridor.items():
            if child is not planned and child.status is Status.RUNNING:
                if self._crossings[name].is_crossed:
                    yield from child.tick()
                else:
                    self._give_up(name)
        self.current_child = planned
        self.feedback_message = "" if is_there else route.answer.reason
        if planned is not None:
            yield from planned.tick()
        if planned is not None and planned.status is Status.RUNNING:
            self.status = Status.RUNNING
        else:
            self.stop(Status.SUCCESS if is_there else Status.FAILURE)
        yield self

    def _note(self, answer: Answer) -> None:
        """Record a plan, unless it is the rest of the one before."""
        before = self._planned
        self._planned = answer
        if answer is before or (before is not None and _is_rest(answer, before)):
            return
        first = f"; {answer.legs[0]}" if answer.legs else ""
        steps = [
            Step(
                "cross",
                (leg.corridor, leg.origin, leg.to, leg.mode.name),
                self._crossings[leg.corridor].action,
            )
            for leg in answer.legs
        ]
        outcome = Outcome.SOLVED_OPTIMALLY if answer.is_solved else Outcome.UNSOLVABLE_PROVEN
        plan = PlanRecord(
            self._route.kb.now, answer.reason + first, outcome, tuple(steps), "joint plan"
        )
        self.plans = plan.added_to(self.plans)

    def _give_up(self, corridor: str) -> None:
        """Stop a crossing, and say why.

        The reason is asked for first, because the end resets the demands.
        """
        crossing = self._crossings[corridor]
        kb = self._route.kb
        feasible = kb.is_feasible(crossing.action)
        why = self._route.answer.reason if feasible else kb.why(kb.actions[crossing.action])
        kb.cancel_action(crossing.action, "abandoned", why)
        self._by_corridor[corridor].stop(Status.INVALID)


def _is_rest(answer: Answer, before: Answer) -> bool:
    ways, others = (
        [(leg.corridor, leg.to, leg.mode.name) for leg in plan.legs] for plan in (answer, before)
    )
    return answer.is_solved is before.is_solved and ways == others[len(others) - len(ways) :]


def agv_tree(
    building: Building, weights: Mapping[str, float], kb: KnowledgeBase, percepts: Percepts
) -> Behaviour:
    """Build the tree; it runs until the goal is reached."""
    return UntilSuccess("until arrived", FollowRoute(Route(building, kb, percepts, weights)))


# -------------------------------------------------------------------- the same question as PDDL

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


class Via(NamedTuple):
    """A corridor in one direction; the origin is empty if the robot starts within a corridor."""

    corridor: str
    origin: str
    to: str


class PddlNames:
    """The PDDL names of places, ways and modes, all different, and the facts about them.

    `modes` are all modes there can be; `limited` names the resources with a limit. The place with
    the empty name is where the robot is within a corridor, and `now` is its configuration if that
    is none of the modes.
    """

    def __init__(self, building: Building, modes: Iterable[Mode], limited: Iterable[str]) -> None:
        self.building = building
        self.limited = tuple(limited)
        self._taken = {SWITCH}
        corridors = building.corridors.values()
        self.actions = {name: self._distinct(f"cross_{name}") for name in building.corridors}
        self.places = {name: self._distinct(name) for name in building.places} | {
            "": self._distinct("here")
        }
        self.now = self._distinct("now")
        self.by_mode = {
            self._distinct(re.sub(r"\W", "_", mode.name.lower())): mode for mode in modes
        }
        self.modes = {mode.name: word for word, mode in self.by_mode.items()}
        ends = [(corridor, to) for corridor in corridors for to in corridor.ends]
        vias = [
            *(Via(corridor.name, corridor.other(to), to) for corridor, to in ends),
            *(Via(corridor.name, "", to) for corridor, to in ends),
        ]
        self.vias = {
            via: self._distinct(f"{via.corridor}_{self.places[via.origin]}_{via.to}")
            for via in vias
        }
        # The way to where the robot is within a corridor. No plan uses it, but planners that work
        # out which facts are reachable would conclude without it that the robot is never there.
        self.vias[Via(vias[0].corridor, vias[0].to, "")] = self._distinct("entering")
        self.by_way = {word: via for via, word in self.vias.items()}

    @property
    def problem(self) -> str:
        """The problem file: the objects, the facts that never change, and the goal."""
        things = {"action": [SWITCH, *self.actions.values()], "place": self.places.values()}
        things |= {"mode": self.by_mode, "setup": [self.now], "way": self.by_way}
        objects = [f"{' '.join(names)} - {kind}" for kind, names in things.items()]
        facts = [f"(switch_action {SWITCH})"]
        for via, way in self.vias.items():
            facts.append(f"(leads {way} {self.places[via.origin]} {self.places[via.to]})")
            facts.append(f"(crosses {self.actions[via.corridor]} {way})")
        goals = [f"(at {self.places[self.building.goal]})"]
        for name in self.limited:
            facts.append(f"(= ({used(name)}) 0)")
            goals.append(f"(<= ({used(name)}) ({left_of(name)}))")
        return f"""(define (problem drive) (:domain agv)
            (:objects {" ".join(objects)})
            (:init {" ".join(facts)})
            (:goal (and {" ".join(goals)}))
            (:metric minimize (total-cost)))"""

    def facts(self, task: Task) -> dict[str, bool | float]:
        """Return the facts that may change: place, configuration, what is possible, costs.

        Costs are whole thousandths, uses are whole amounts (see `Amounts`); it also says what is
        left of the limited.
        """
        place, now = task.start
        at = self.places["" if place.corridor else place.name]
        configured = next(
            (word for word, mode in self.by_mode.items() if mode.setup == now.setup), self.now
        )
        facts: dict[str, bool | float] = {
            **{f"(at {place})": place == at for place in self.places.values()},
            **{f"(configured {mode})": mode == configured for mode in (*self.by_mode, self.now)},
            **{f"(possible {way} {mode})": False for way in self.by_way for mode in self.by_mode},
        }
        for via, leg, cost in self._crossings(task):
            things = f"{self.vias[via]} {self.modes[leg.mode.name]}"
            facts |= {
                f"(possible {things})": True,
                **self._numbers("crossing", things, leg.takes, cost),
            }
        for corridor in () if place.corridor else self.building.exits[place.name]:
            way = self.vias[Via(corridor.name, "", place.name)]  # that led back here ends now
            facts |= {f"(possible {way} {mode})": True for mode in self.by_mode}
        for before, mode in {**self.by_mode, self.now: now}.items():
            for after, other in self.by_mode.items():
                costs = task.switching(mode, other)
                facts |= self._numbers("switching", f"{before} {after}", *costs)
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
                if (
                    leg.mode.name in self.modes
                ):  # else it was added to the model after the problem was made
                    yield Via(leg.corridor, "" if place.corridor else leg.origin, leg.to), leg, cost
                    if not start.corridor:  # a step begun within a corridor goes on at its end
                        yield Via(leg.corridor, "", leg.to), leg, cost

    def _distinct(self, wanted: str) -> str:
        while wanted in self._taken:
            wanted += "_"
        self._taken.add(wanted)
        return wanted


class Switch(RosaAction):
    """Change to a mode, where the robot stands."""

    def __init__(self, route: Route, mode: Mode) -> None:
        super().__init__(f"switch to {mode.name}", route.kb, SWITCH)
        self._route = route
        self._mode = mode
        self._plan: ReconfigurationPlan | None = None

    def initialise(self) -> None:
        self._plan = None
        self._route.measure(self._route.standing)

    def update(self) -> Status:
        """Select the mode, and succeed when it is in force."""
        if self.kb.pending_plan is not None:
            return Status.RUNNING
        if self._plan is not None and self._plan.result == "failed":
            self.feedback_message = f"the robot cannot be configured so: {self._plan} failed"
            return Status.FAILURE
        if Modes(self.kb, NAVIGATE).running.setup == self._mode.setup:
            return Status.SUCCESS
        choice = self._mode.choice
        why = f"{self._mode.name} is planned for what comes next"
        self._plan = self.kb.select(choice.designs, choice.configurations, why)
        return Status.RUNNING


class PlanningState:
    """What the plan executor knows: the names and the facts of the PDDL problem."""

    def __init__(self, route: Route, pddl: PddlNames) -> None:
        self.route = route
        self.pddl = pddl
        self._revision: tuple[object, ...] = ()
        self._facts: Mapping[str, bool | float] = {}

    @property
    def facts(self) -> Mapping[str, bool | float]:
        """What holds now and what it costs.

        Updated with `Route.revision`, not with every metre and joule.
        """
        if self._revision != self.route.revision:
            self._revision = self.route.revision
            self._facts = self.pddl.facts(self.route.task)
        return self._facts

    def cross(self, step: Step) -> Cross:
        """Return the behaviour of a step that drives a way in a mode.

        It fails if that is not possible from here.
        """
        _, way, _, _, mode = step.arguments
        via = self.pddl.by_way[way]
        task = self.route.task
        legs = [
            replace(leg, why="planned together with all that comes after it")
            for leg, _ in task.crossings(task.start[0])
            if (leg.corridor, leg.to, self.pddl.modes[leg.mode.name])
            == (via.corridor, via.to, mode)
        ]
        return Cross(self.route, via.corridor, lambda: next(iter(legs), None))

    def switch(self, step: Step) -> Switch:
        """Return the behaviour of a step that changes to a mode."""
        return Switch(self.route, self.pddl.by_mode[step.arguments[-1]])
