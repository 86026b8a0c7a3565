"""What the task layer believes, and the joint plan for that: made anew when what is believed changes."""

from collections.abc import Mapping
from typing import Final

from kb import KnowledgeBase, Status
from missions.agv.building import Building
from missions.agv.joint import Answer, JointPlanner, Leg, Place, Question, Task
from missions.engine.mission import Percepts

_DAYLIGHT: Final = 1.0

RESERVE: Final = 0.1
"""Part of the energy that is not planned with, as driving round what stands in the way takes more; own choice."""


class Route:
    """Knows where the robot is, what has failed and where the light has changed; plans when one of these changes."""

    def __init__(self, building: Building, kb: KnowledgeBase, percepts: Percepts, weights: Mapping[str, float]) -> None:
        self.building, self.kb = building, kb
        self._percepts, self._weights = percepts, weights
        self._planner = JointPlanner(building, kb)
        self._believed: tuple[object, ...] = ()
        self._answer: Answer | None = None

    @property
    def at(self) -> str:
        """The place where the robot is, or the one that it came from."""
        reported = (place for place in self.building.places if self._percepts.holds(f"at {place}"))
        return next(reported, self.building.start)

    @property
    def is_there(self) -> bool:
        """Whether the robot has arrived."""
        return self.at == self.building.goal and not self.inside

    @property
    def answer(self) -> Answer:
        """The best plan from here, or why there is none."""
        believed = self._believes()
        if self._answer is None or believed != self._believed:
            self._believed, self._answer = believed, self._planner.plan(self.question)
        return self._answer

    @property
    def leg(self) -> Leg | None:
        """What to do now; None if there is no plan, or nothing left to do."""
        legs = self.answer.legs
        return legs[0] if legs else None

    @property
    def task(self) -> Task:
        """What is to be planned from here, as a graph."""
        return self._planner.task(self.question)

    @property
    def question(self) -> Question:
        """What is to be planned from here; no more energy than there is, less the reserve."""
        energy_j, driven_m = (self.kb.attributes[name].value for name in ("energy", "driven"))
        limits = {} if energy_j is None else {"energy": (1.0 - RESERVE) * max(0.0, energy_j)}
        place = Place(self.at, self.inside, driven_m or 0.0) if self.inside else Place(self.at)
        return Question(place, None, self._weights, limits, self._light)

    @property
    def inside(self) -> str:
        """The corridor that the robot is in; empty at a place."""
        return next((one.name for one in self.building.exits[self.at] if self._percepts.holds(f"in {one.name}")), "")

    @property
    def standing(self) -> Mapping[str, float]:
        """What the robot demands where it stands: it passes nothing, and places are light."""
        corridor = self.building.corridors.get(self.inside)
        if corridor is None:
            return {"obstacles": 0.0, "light": _DAYLIGHT}
        return {"obstacles": 0.0, "light": self._light.get(corridor.name, corridor.light)}

    @property
    def revision(self) -> tuple[object, ...]:
        """Differs when anything has happened; that it drives on and draws energy is nothing."""
        return self.kb.revision, self._percepts.revision, self.kb.attributes["energy"].value is None

    def _believes(self) -> tuple[object, ...]:
        """Return where the robot is, what has failed and where the light has changed: what plans depend on."""
        failed = [name for name in self.kb.components if self.kb.components[name].status is Status.FAILURE]
        return (self.at, self.inside, *failed, *self._light.items())

    @property
    def _light(self) -> Mapping[str, float]:
        """How light it was found to be in corridors, where that was reported."""
        reported = {name: self._percepts.value(f"light in {name}") for name in self.building.corridors}
        return {name: light for name, light in reported.items() if light is not None}
