"""The loop of Metacontrol: every 1.5 s it reasons about its objectives, and asks for modes."""

from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Final

from missions.managers.manager import Manager, Robot
from missions.managers.metacontrol.ontology import read_knowledge
from missions.managers.metacontrol.reasoning import Situation, Standing, best_design, standing, unrealisable
from missions.managers.modes import SystemModes
from missions.managers.options import Option

__all__ = ["Metacontrol"]

ONTOLOGY: Final = Path(__file__).with_name("suave.owl")
OBJECTIVES: Final = {
    "search_pipeline": ("f_maintain_motion", "f_generate_search_path"),
    "inspect_pipeline": ("f_maintain_motion", "f_follow_pipeline"),
}
"""Functions that each task asks for; kas-lab/suave v1.3.0, task bridge."""


class Metacontrol(Manager):
    """Grounds the objectives of a task in function designs, and changes the designs of those that are in error.

    One pass of reasoning sees what was told; what follows from an inference of the pass is seen by the next one. So a
    component that fails makes designs unrealisable in one pass and puts an objective in error in a second one, which
    follows at once.
    """

    options: ClassVar = (
        Option("reasoning_period_s", 1.5, "s", "from one cycle of Metacontrol to the next", "mros2_reasoner"),
        Option("reasoning_s", 0.3, "s", "time that one pass of its reasoner takes", "own choice: a few tenths"),
    )

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.period_s = robot.options["reasoning_period_s"]
        self._modes = SystemModes(robot)
        self._knowledge = read_knowledge(ONTOLOGY)
        self._situation = Situation()
        self._objectives: tuple[str, ...] = ()
        self._is_reasoning = False

    def begin(self, task: str) -> None:
        """Take on the objectives of a task; they are grounded in the next cycle."""
        self._objectives = OBJECTIVES[task]

    def end(self, task: str) -> None:
        """Drop the objectives and unground their functions."""
        self._objectives = ()
        self._situation = replace(self._situation, grounded={})
        for function in OBJECTIVES[task]:
            self._modes.unground(function)

    def update(self) -> None:
        """Reason about what has been told by now; what is then asked for follows when the reasoner is done."""
        if not self._is_reasoning:
            self._is_reasoning = True
            self._reason()

    def _reason(self) -> None:
        before = self._situation
        failed = frozenset(name for name, word in self.robot.told.items() if word in ("FALSE", "ERROR"))
        situation = self._situation = replace(
            before,
            measured=dict(self.robot.measured),
            failed=failed,
            not_in_force=frozenset(
                function for function, mode in before.grounded.items() if not self._modes.is_in(function, mode)
            ),
            recovered=before.recovered or not before.failed <= failed,
        )
        self.robot.later(self.robot.options["reasoning_s"], lambda: self._act(situation))

    def _act(self, seen: Situation) -> None:
        """Ask for what was found, then reason again if an inference may have further consequences."""
        knowledge = self._knowledge
        inferred = unrealisable(knowledge, seen)
        for function in self._objectives:
            stands = standing(knowledge, seen, function)
            if stands is not Standing.SATISFIED or function in knowledge.always_improved:
                self._ground(function, stands, seen)
        if inferred == seen.unrealisable:
            self._situation = replace(self._situation, recovered=False)
            self._is_reasoning = False
        else:
            self._situation = replace(self._situation, unrealisable=inferred)
            self._reason()

    def _ground(self, function: str, stands: Standing, seen: Situation) -> None:
        errors = seen.errors
        if stands is Standing.FUNCTION_ERROR:
            errors |= {seen.grounded[function]}
            self._situation = replace(self._situation, errors=self._situation.errors | errors)
        design = best_design(self._knowledge, replace(seen, errors=errors), function)
        if design is not None:
            self._modes.request(function, design.name)
            self._situation = replace(self._situation, grounded={**self._situation.grounded, function: design.name})
