"""What the mission does: it crosses corridors. Tree and plan executor run the same behaviours."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from py_trees.common import Status

from kb import KnowledgeBase
from missions.agv.building import Building, Corridor
from missions.agv.joint import Leg
from missions.agv.model import FOLLOW, NAVIGATE, NAVIGATOR, heading, headings
from missions.agv.modes import Modes
from missions.agv.route import DARK, Route
from missions.senses import Senses
from rosa_bt import RosaAction
from rosa_pddl.generation import ActionSchema, DeclaredProblem

__all__ = ["Cross", "Crossing", "facts_of", "problem_of"]


class Cross(RosaAction):
    """Cross a corridor, in the configuration that was planned for it.

    Args:
        route: what is believed.
        corridor: its name.
        choose: returns what is planned for it now.
    """

    def __init__(self, route: Route, corridor: str, choose: Callable[[], Leg | None]) -> None:
        super().__init__(f"cross {corridor}", route.kb, f"cross_{corridor}")
        self.corridor = corridor
        self._route = route
        self._choose = choose
        self._leg: Leg | None = None

    @property
    def is_crossed(self) -> bool:
        """Whether the robot has come to the other end."""
        return self._leg is not None and self._route.at == self._leg.to and not self._route.inside

    def initialise(self) -> None:
        """Tell what the corridor demands, and select what was planned."""
        self._leg = self._choose()
        if self._leg is not None:
            way = headings(self._route.building).index((self._leg.corridor, self._leg.origin)) + 1.0
            for attribute, value in {**self._leg.conditions, "way": way}.items():
                self.kb.measure(attribute, value)
            if self.kb.pending_plan is None:  # else it would be abandoned together with that one
                self._select(self._leg)

    def update(self) -> Status:
        """Look whether the other end is reached; take over what was planned anew for the same corridor."""
        leg = self._leg
        if leg is None:
            self.feedback_message = f"{self.corridor} does not lead from {self._route.at}"
            return Status.FAILURE
        if self.is_crossed:
            return Status.SUCCESS
        anew = self._choose()
        if anew is not None and anew.to == leg.to:
            self._leg = leg = anew
        if self.kb.pending_plan is None and not self._is_selected(
            leg
        ):  # it was planned anew, or the manager had to choose before it was
            self._select(leg)
        return Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        """Demand nothing more: what is behind or given up does not lie ahead."""
        self.kb.measure("obstacles", 0.0)

    def _select(self, leg: Leg) -> None:
        why = f"{leg.mode.name} is the best to cross {leg.corridor}, {leg.why}"
        self.kb.select(_designs(leg), _configurations(leg), why)

    def _is_selected(self, leg: Leg) -> bool:
        designs = (self.kb.designs[name] for name in _designs(leg).values())
        configurations = (self.kb.configurations[name] for name in _configurations(leg).values())
        return all(one.is_selected for one in (*designs, *configurations))


def _designs(leg: Leg) -> dict[str, str]:
    return {**leg.mode.choice.designs, FOLLOW: "by_navigator"}


def _configurations(leg: Leg) -> dict[str, str]:
    return {**leg.mode.choice.configurations, NAVIGATOR: heading(leg.corridor, leg.origin)}


@dataclass(frozen=True)
class Crossing:
    """Makes the behaviour that crosses a corridor for the plan executor, and declares it."""

    building: Building
    corridor: Corridor
    weights: Mapping[str, float]

    @property
    def schema(self) -> ActionSchema:
        """Cost is the length, so the plan is the shortest way that can be driven."""
        name = self.corridor.name
        return ActionSchema(
            f"cross_{name}",
            parameters=("?from - place", "?to - place"),
            start=("(at ?from)", f"(leads_{name} ?from ?to)"),
            over_all=(f"(passable_{name})",),
            end_effects=("(at ?to)", "(not (at ?from))"),
            duration_s=self.corridor.length_m,
            cost=self.corridor.length_m,
        )

    def __call__(self, kb: KnowledgeBase, senses: Senses) -> Cross:
        """Make it."""
        route = Route(self.building, kb, senses, self.weights)
        return Cross(route, self.corridor.name, partial(route.leg_through, self.corridor.name))


def problem_of(building: Building) -> DeclaredProblem:
    """Return the problem: to be at the goal."""
    leads = [
        f"(leads_{one.name} {origin} {one.other(origin)})" for one in building.corridors.values() for origin in one.ends
    ]
    passable = [f"(passable_{name})" for name in building.corridors]
    objects = dict.fromkeys(building.places, "place")
    return DeclaredProblem((f"(at {building.goal})",), objects, (f"(at {building.start})", *leads, *passable))


def facts_of(building: Building, kb: KnowledgeBase, senses: Senses) -> Mapping[str, bool]:
    """Return where the robot is, and which corridors can be crossed in some configuration.

    Args:
        building: the map.
        kb: what is known of the vehicle; asked by situations, nothing is told to it.
        senses: what was told.
    """
    failed = [name for name in kb.components if senses.holds(f"{name} failed")]
    modes = Modes(kb, NAVIGATE, failed)
    at = [place for place in building.places if senses.holds(f"at {place}")] or [building.start]
    facts = {f"(at {place})": place in at for place in building.places}
    for one in building.corridors.values():
        light = DARK if senses.holds(f"dark {one.name}") else one.light
        possible = modes.under({"light": light, "obstacles": one.obstacles})
        facts[f"(passable_{one.name})"] = bool(possible)
    return facts
