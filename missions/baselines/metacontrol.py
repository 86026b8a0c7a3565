"""Metacontrol, the manager of SUAVE that adapts by an ontology of functions, their designs and objectives.

Every 1.5 s it reasons about its objectives by the rules of TOMASys, here pure functions, and requests modes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar, Final

from missions.baselines.manager import Robot
from missions.baselines.modes import FOLLOW, MOTION, SEARCH, ModesManager
from missions.engine.settings import Setting


@dataclass(frozen=True, slots=True)
class Design:
    """A design of a function, with the name of the mode that it requests; higher performance is better.

    It needs the components, and for each of the qualities, (attribute, least value), at least that value.
    """

    name: str
    function: str
    performance: float
    components: tuple[str, ...] = ()
    qualities: tuple[tuple[str, float], ...] = ()


DESIGNS: Final = (
    Design("fd_all_thrusters", MOTION, 1.0, tuple(f"c_thruster_{one}" for one in range(1, 7))),
    Design("fd_follow_pipeline", FOLLOW, 1.0),
    Design("fd_spiral_high", SEARCH, 1.0, qualities=(("water_visibility", 3.25),)),
    Design("fd_recover_thrusters", MOTION, 0.75),
    Design("fd_spiral_medium", SEARCH, 0.5, qualities=(("water_visibility", 2.25),)),
    Design("fd_spiral_low", SEARCH, 0.25, qualities=(("water_visibility", 1.25),)),
)
"""All designs, the best first, then by name; from the ontology of kas-lab/suave v1.3.0."""

ALWAYS_IMPROVED: Final = frozenset({SEARCH})
"""Functions whose design is chosen anew even while the objective is satisfied; same source."""


def designs_of(function: str) -> tuple[Design, ...]:
    """Return the designs of a function, the best first."""
    return tuple(design for design in DESIGNS if design.function == function)


class Standing(StrEnum):
    """The status of an objective: the first of these that holds, in this order."""

    UNGROUNDED = "UNGROUNDED"  # no design serves it
    COMPONENT_ERROR = "IN_ERROR_COMPONENT"  # its design needs a component that has failed
    FUNCTION_ERROR = "IN_ERROR_FR"  # the mode of its design was requested, but is not in force
    QUALITY_ERROR = "IN_ERROR_NFR"  # a quality is measured below what its design needs
    UPDATABLE = "UPDATABLE"  # a component has recovered: a better design may be possible
    SATISFIED = "SATISFIED"


@dataclass(frozen=True, slots=True)
class Situation:
    """What Metacontrol has received, and what the pass before has inferred.

    Attributes:
        measured: the last value of each attribute that is measured.
        failed: names of the components that have failed.
        unrealisable: names of designs that need a failed component, as the pass before has inferred.
        grounded: names of the designs that serve objectives, by function.
        not_in_force: functions whose mode was requested, but is not in force.
        errors: names of designs whose mode did not come into force.
        recovered: whether a component has recovered since the last choice.
    """

    measured: Mapping[str, float] = field(default_factory=dict)
    failed: frozenset[str] = frozenset()
    unrealisable: frozenset[str] = frozenset()
    grounded: Mapping[str, str] = field(default_factory=dict)
    not_in_force: frozenset[str] = frozenset()
    errors: frozenset[str] = frozenset()
    recovered: bool = False


def unrealisable(situation: Situation) -> frozenset[str]:
    """Return the names of the designs that need a failed component."""
    return frozenset(one.name for one in DESIGNS if not situation.failed.isdisjoint(one.components))


def standing(situation: Situation, function: str) -> Standing:
    grounded = situation.grounded.get(function)
    design = next((one for one in designs_of(function) if one.name == grounded), None)
    if design is None:
        return Standing.UNGROUNDED
    if design.name in situation.unrealisable:
        return Standing.COMPONENT_ERROR
    if function in situation.not_in_force:
        return Standing.FUNCTION_ERROR
    if not _suffices(design, situation):
        return Standing.QUALITY_ERROR
    return Standing.UPDATABLE if situation.recovered else Standing.SATISFIED


def best_design(situation: Situation, function: str) -> Design | None:
    """Return the best design of a function that is possible now; None if there is none."""
    barred = situation.unrealisable | situation.errors
    possible = (one for one in designs_of(function) if one.name not in barred and _suffices(one, situation))
    return next(possible, None)


def _suffices(design: Design, situation: Situation) -> bool:
    """Tell whether no quality is measured below what a design needs; unmeasured ones count as good enough."""
    measured = situation.measured
    return all(not measured[name] < value for name, value in design.qualities if name in measured)


OBJECTIVES: Final = {"search_pipeline": (MOTION, SEARCH), "inspect_pipeline": (MOTION, FOLLOW)}
"""Functions that each task needs; from the task bridge of kas-lab/suave v1.3.0."""


class Metacontrol(ModesManager):
    """Grounds the objectives of a task in function designs, and replaces the designs of objectives in error.

    A pass of reasoning uses what was received before it; what it infers is used by the next pass only. So a component
    that fails makes designs unrealisable in one pass, and puts an objective in error in a second one, which follows at
    once.
    """

    options: ClassVar = (
        Setting("reasoning_period_s", 1.5, "s", "from one cycle of Metacontrol to the next", "mros2_reasoner"),
        Setting("reasoning_s", 0.3, "s", "time that one pass of its reasoner takes", "own choice: a few tenths"),
    )

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.period_s = robot.options["reasoning_period_s"]
        self._situation = Situation()
        self._objectives: tuple[str, ...] = ()
        self._is_reasoning = False

    def begin(self, task: str) -> None:
        self._objectives = OBJECTIVES[task]

    def end(self, task: str) -> None:
        self._objectives = ()
        self._situation = replace(self._situation, grounded={})
        for function in OBJECTIVES[task]:
            self.modes.unground(function)

    def update(self) -> None:
        if not self._is_reasoning:
            self._is_reasoning = True
            self._reason()

    def _reason(self) -> None:
        before = self._situation
        failed = frozenset(name for name, word in self.robot.reported.items() if word in ("FALSE", "ERROR"))
        amiss = frozenset(name for name, mode in before.grounded.items() if not self.modes.is_in(name, mode))
        situation = self._situation = replace(
            before,
            measured=dict(self.robot.measured),
            failed=failed,
            not_in_force=amiss,
            recovered=before.recovered or not before.failed <= failed,
        )
        self.robot.later(self.robot.options["reasoning_s"], lambda: self._act(situation))

    def _act(self, seen: Situation) -> None:
        """Request what the pass has found, then reason again if it has inferred something new."""
        for function in self._objectives:
            stands = standing(seen, function)
            if stands is not Standing.SATISFIED or function in ALWAYS_IMPROVED:
                self._ground(function, stands, seen)
        inferred = unrealisable(seen)
        self._is_reasoning = inferred != seen.unrealisable
        if self._is_reasoning:
            self._situation = replace(self._situation, unrealisable=inferred)
            self._reason()
        else:
            self._situation = replace(self._situation, recovered=False)

    def _ground(self, function: str, stands: Standing, seen: Situation) -> None:
        errors = seen.errors
        if stands is Standing.FUNCTION_ERROR:
            errors |= {seen.grounded[function]}
            self._situation = replace(self._situation, errors=self._situation.errors | errors)
        design = best_design(replace(seen, errors=errors), function)
        if design is not None:
            self.modes.request(function, design.name)
            self._situation = replace(self._situation, grounded={**self._situation.grounded, function: design.name})
