"""Metacontrol: adaptation by an ontology of functions, their designs and objectives, as SUAVE comes with it.

Every 1.5 s it reasons about its objectives by the rules of TOMASys, as pure functions, and asks for modes.
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
    """A way to realise a function, named as a mode of it; a better one has more performance.

    It needs components, and qualities: (attribute, value it has to have at least), both in order of name.
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
"""All there are, the best first, then in order of name; kas-lab/suave v1.3.0, ontology."""

ALWAYS_IMPROVED: Final = frozenset({SEARCH})
"""The functions that are improved though all is well; of the same source."""


def designs_of(function: str) -> tuple[Design, ...]:
    """Return the designs of a function, the best first."""
    return tuple(design for design in DESIGNS if design.function == function)


class Standing(StrEnum):
    """How an objective stands: by the first of these that holds, in their order."""

    UNGROUNDED = "UNGROUNDED"  # no design serves it
    COMPONENT_ERROR = "IN_ERROR_COMPONENT"  # its design needs a component that has failed
    FUNCTION_ERROR = "IN_ERROR_FR"  # the mode of its design is not in force though it was asked for
    QUALITY_ERROR = "IN_ERROR_NFR"  # a quality that its design needs is measured to be less
    UPDATABLE = "UPDATABLE"  # a component has recovered: something better may be possible
    SATISFIED = "SATISFIED"


@dataclass(frozen=True, slots=True)
class Situation:
    """What Metacontrol has heard, and what it inferred in the pass before.

    Attributes:
        unrealisable: names of designs that need one of these, as inferred by the pass before.
        grounded: names of the designs that serve objectives, by function.
        not_in_force: functions whose mode is not in force though it was asked for.
        errors: names of designs that could not be brought into force.
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
    """Return the names of the designs that need a component which has failed."""
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
    """Return the design of a function that performs best of those that are possible now; None if none is."""
    barred = situation.unrealisable | situation.errors
    possible = (one for one in designs_of(function) if one.name not in barred and _suffices(one, situation))
    return next(possible, None)


def _suffices(design: Design, situation: Situation) -> bool:
    """Tell whether no quality that a design needs is measured to be less; what is not measured suffices."""
    measured = situation.measured
    return all(not measured[name] < value for name, value in design.qualities if name in measured)


OBJECTIVES: Final = {"search_pipeline": (MOTION, SEARCH), "inspect_pipeline": (MOTION, FOLLOW)}
"""Functions that each task asks for; kas-lab/suave v1.3.0, task bridge."""


class Metacontrol(ModesManager):
    """Grounds the objectives of a task in function designs, and changes the designs of those that are in error.

    One pass of reasoning sees what was heard; what follows from an inference of the pass is seen by the next one. So a
    component that fails makes designs unrealisable in one pass and puts an objective in error in a second one, which
    follows at once.
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
        """Ask for what was found, then reason again if an inference may have further consequences."""
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
