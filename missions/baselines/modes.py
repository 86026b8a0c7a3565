"""SUAVE's own managers, which switch components as ROS 2 System Modes does.

`none` and `random` only request modes. `metacontrol` reasons every 1.5 s about an ontology of
functions, their designs and objectives, by the rules of TOMASys, here pure functions, and requests
modes. `bt` is the behaviour tree of kas-lab/suave v1.3.0 (suave_bt) and its extended mission; the
one tree decides about tasks and adapts the vehicle:

mission (reactive) ├── motion: all thrusters ok? -> mode fd_all_thrusters, or else mode
fd_recover_thrusters └── work or recharge ├── work (reactive) │   ├── battery ok?
extended mission only │   ├── find: found?, or else (altitude by visibility -> search) │   └── mode
fd_follow_pipeline -> inspect └── unground search and inspection -> mode normal -> recharge -> mode
inactive
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.composites import Selector, Sequence

from missions.baselines.manager import Manager
from missions.engine.components import SimulatedComponents
from missions.engine.mission import Condition
from missions.engine.settings import Setting

SEARCH, FOLLOW, MOTION = "f_generate_search_path", "f_follow_pipeline", "f_maintain_motion"
RECHARGE = "f_generate_recharge_path"
UNGROUND = "fd_unground"
LOW_LEVEL = np.float32(0.25)


@dataclass(frozen=True, slots=True)
class Mode:
    """What a mode means: whether the component is active, and its parameters."""

    active: bool
    parameters: Mapping[str, float] = field(default_factory=dict)


_ON = Mode(True)
_OFF = Mode(False)
_LOW, _MEDIUM, _HIGH = (Mode(True, {"spiral_altitude": metres}) for metres in (1.0, 2.0, 3.0))

FUNCTIONS: Final[Mapping[str, tuple[str, Mapping[str, Mode]]]] = {
    SEARCH: (
        "spiral_search",
        {
            "__DEFAULT__": _LOW,
            "fd_spiral_high": _HIGH,
            "fd_spiral_medium": _MEDIUM,
            "fd_spiral_low": _LOW,
        }
        | {UNGROUND: _OFF},
    ),
    FOLLOW: ("follow_pipeline", {"__DEFAULT__": _OFF, "fd_follow_pipeline": _ON, UNGROUND: _OFF}),
    MOTION: (
        "recover_thrusters",
        {"__DEFAULT__": _ON, "fd_all_thrusters": _OFF, "fd_recover_thrusters": _ON, UNGROUND: _OFF},
    ),
    RECHARGE: ("recharge", {"__DEFAULT__": _OFF, "normal": _ON, "inactive": _OFF, UNGROUND: _OFF}),
}
"""The component and the modes of each function; kas-lab/suave v1.3.0, System Modes."""


class SystemModes:
    """Switches components by the modes of their functions."""

    def __init__(self, managed: SimulatedComponents) -> None:
        self._managed = managed
        self._requested: dict[str, str] = {}

    def request(self, function: str, mode: str) -> None:
        """Request a mode; ignored if it is the one requested last."""
        before = self._requested.get(function)
        component, modes = FUNCTIONS[function]
        if mode == before:
            return
        had = modes[before] if before else _OFF
        wanted = modes[mode]
        self._requested[function] = mode
        if wanted.parameters and had.parameters != wanted.parameters:
            self._managed.set_parameters(component, wanted.parameters)
        if wanted.active and not had.active:
            self._managed.activate(component)
        elif had.active and not wanted.active:
            self._managed.deactivate(component)

    def is_in(self, function: str, mode: str) -> bool:
        """Tell whether a component is as a mode wants it; several modes may want the same."""
        component, modes = FUNCTIONS[function]
        wanted = modes[mode]
        parameters = self._managed.parameters(component)
        return wanted.active == self._managed.is_active(component) and all(
            parameters.get(key) == value for key, value in wanted.parameters.items()
        )


MODES = {
    "search_pipeline": (SEARCH, "fd_spiral_low"),
    "inspect_pipeline": (FOLLOW, "fd_follow_pipeline"),
}
"""Function and mode of each task; kas-lab/suave v1.3.0."""


class ModesManager(Manager):
    """A manager that requests modes; it ungrounds the function of a task when the task ends."""

    def setup(self) -> None:
        super().setup()
        self.modes = SystemModes(self.managed)

    def end(self, task: str) -> None:
        self.modes.request(MODES[task][0], UNGROUND)


class NoManager(ModesManager):
    """Searches at 1 m in any water, inspects, and never recovers a thruster."""

    def begin(self, task: str) -> None:
        self.modes.request(*MODES[task])


PERIODS_S = {"2024": 15.0, "2025": 30.0}
"""Time between two choices [s], by the rules. 30 s were always intended, but v1.3.0 reads another
parameter."""


class RandomManager(ModesManager):
    """Every 15 or 30 s requests a random mode of the task's function.

    It may be the one that stops it.
    """

    @property
    def period_s(self) -> float:
        return PERIODS_S[self.constants.rules]

    def update(self) -> None:
        if self.doing is not None:
            function, _ = MODES[self.doing]
            modes = list(FUNCTIONS[function][1])
            self.modes.request(function, modes[self.rng.integers(len(modes))])


class TreeManager(ModesManager):
    """Ticks the tree every 0.15 s.

    It sleeps for 100 ms after each tick and for 50 ms in each running action.
    """

    decides_tasks = True

    @property
    def period_s(self) -> float:
        return self.constants.tree_period_s

    def setup(self) -> None:
        super().setup()
        self.root = _tree(self)

    @property
    def is_done(self) -> bool:
        return self.percepts.count("pipeline_inspected") > 0

    def update(self) -> None:
        self.root.tick_once()


class _Request(Behaviour):
    """Requests a mode, unless it is the one requested last; succeeds at once."""

    def __init__(self, modes: SystemModes, function: str, mode: str) -> None:
        super().__init__(f"{function}: {mode}")
        self._modes = modes
        self._function = function
        self._mode = mode

    def update(self) -> Status:
        self._modes.request(self._function, self._mode)
        return Status.SUCCESS


class _Do(Behaviour):
    """Does a task until `until` is published once more; ends it then, or when halted."""

    def __init__(self, manager: ModesManager, task: str, until: str) -> None:
        super().__init__(task)
        self._manager = manager
        self._until = until
        self._before = 0

    def initialise(self) -> None:
        self._manager.begin_task(self.name)
        self._before = self._manager.percepts.count(self._until)

    def update(self) -> Status:
        is_done = self._manager.percepts.count(self._until) > self._before
        return Status.SUCCESS if is_done else Status.RUNNING

    def terminate(self, new_status: Status) -> None:
        if self.status is Status.RUNNING or new_status is Status.SUCCESS:
            self._manager.end_task("completed" if new_status is Status.SUCCESS else "abandoned")
            if self.name in MODES:
                self._manager.end(self.name)


def _tree(manager: ModesManager) -> Behaviour:
    measured = manager.measured

    def request(function: str, mode: str) -> Behaviour:
        return _Request(manager.modes, function, mode)

    def sequence(name: str, *children: Behaviour) -> Behaviour:
        return Sequence(name, memory=False, children=[*children])

    def altitude(mode: str, least_m: float) -> Behaviour:
        def is_clear() -> bool:
            return measured.get("water_visibility", 9.0) >= least_m

        clear = Condition(f"visibility >= {least_m} m?", is_clear)
        return sequence(mode, clear, request(SEARCH, mode))

    def is_charged() -> bool:
        return bool(np.float32(measured.get("battery_level", 1.0)) >= LOW_LEVEL)

    works = Condition(
        "all thrusters ok?", lambda: {"RECOVERED", "OK"}.issuperset(manager.reported.values())
    )
    ways = [
        sequence("thrusters ok", works, request(MOTION, "fd_all_thrusters")),
        request(MOTION, "fd_recover_thrusters"),
    ]
    altitudes = [
        altitude("fd_spiral_high", 3.25),
        altitude("fd_spiral_medium", 2.25),
        altitude("fd_spiral_low", 1.25),
    ]
    find = [
        Condition("found?", lambda: manager.percepts.count("pipeline_found") > 0),
        sequence(
            "search",
            Selector("altitude", memory=False, children=altitudes),
            _Do(manager, "search_pipeline", "pipeline_found"),
        ),
    ]
    inspect = _Do(manager, "inspect_pipeline", "pipeline_inspected")
    recharge = [
        request(SEARCH, UNGROUND),
        request(FOLLOW, UNGROUND),
        request(RECHARGE, "normal"),
        _Do(manager, "recharge", "battery_recharged"),
        request(RECHARGE, "inactive"),
    ]
    either = [
        sequence(
            "work",
            Condition("battery ok?", is_charged),
            Selector("find", memory=True, children=find),
            sequence("inspect", request(FOLLOW, "fd_follow_pipeline"), inspect),
        ),
        Sequence("recharge", memory=True, children=recharge),
    ]
    return sequence(
        "mission",
        Selector("motion", memory=False, children=ways),
        Selector("work or recharge", memory=True, children=either),
    )


# -------------------------------------------------------------------- Metacontrol


@dataclass(frozen=True, slots=True)
class Design:
    """A design of a function, with the name of the mode that it requests.

    It needs the components, and for each of the qualities, (attribute, least value), at least that
    value; one that is not measured counts as good enough.
    """

    name: str
    function: str
    components: tuple[str, ...] = ()
    qualities: tuple[tuple[str, float], ...] = ()

    def suffices(self, measured: Mapping[str, float]) -> bool:
        return all(measured.get(name, least) >= least for name, least in self.qualities)


DESIGNS: Final = (
    Design("fd_all_thrusters", MOTION, tuple(f"c_thruster_{index}" for index in range(1, 7))),
    Design("fd_follow_pipeline", FOLLOW),
    Design("fd_spiral_high", SEARCH, qualities=(("water_visibility", 3.25),)),
    Design("fd_recover_thrusters", MOTION),
    Design("fd_spiral_medium", SEARCH, qualities=(("water_visibility", 2.25),)),
    Design("fd_spiral_low", SEARCH, qualities=(("water_visibility", 1.25),)),
)
"""All designs, those of higher performance first; from the ontology of kas-lab/suave v1.3.0."""


class Metacontrol(ModesManager):
    """Grounds objectives of a task in function designs; replaces those of objectives in error.

    An objective is the function of the task, or the motion. It is in error, first things first, if
    no design serves it, its design needs a failed component, the mode of its design is not in force
    though it was requested, or a quality is below what the design needs. It is updatable if a
    component has recovered, and that of the search always.

    A pass of reasoning uses what was received before it; what it infers is used by the next pass
    only. So a component that fails makes designs unrealisable in one pass, and puts an objective in
    error in a second one, which follows at once.
    """

    options: ClassVar = (
        Setting(
            "reasoning_period_s",
            1.5,
            "s",
            "from one cycle of Metacontrol to the next",
            "mros2_reasoner",
        ),
        Setting(
            "reasoning_s",
            0.3,
            "s",
            "time that one pass of its reasoner takes",
            "own choice: a few tenths",
        ),
    )

    @property
    def period_s(self) -> float:
        return float(self.values["reasoning_period_s"])

    def setup(self) -> None:
        super().setup()
        self._objectives: tuple[str, ...] = ()
        self._grounded: dict[str, Design] = {}
        self._failed: frozenset[str] = frozenset()
        self._unrealisable: frozenset[str] = frozenset()
        self._errors: frozenset[str] = frozenset()
        self._recovered = False
        self._is_reasoning = False

    def begin(self, task: str) -> None:
        self._objectives = MOTION, MODES[task][0]

    def end(self, task: str) -> None:
        for function in self._objectives:
            self.modes.request(function, UNGROUND)
        self._objectives = ()
        self._grounded = {}

    def update(self) -> None:
        if not self._is_reasoning:
            self._is_reasoning = True
            self._reason()

    def _reason(self) -> None:
        reported = self.reported.items()
        failed = frozenset(name for name, word in reported if word in ("FALSE", "ERROR"))
        self._recovered |= not self._failed <= failed
        self._failed = failed
        grounded = self._grounded
        amiss = {name for name, each in grounded.items() if not self.modes.is_in(name, each.name)}
        measured = dict(self.measured)
        self.later(self.values["reasoning_s"], lambda: self._act(measured, grounded, amiss))

    def _act(
        self, measured: Mapping[str, float], grounded: Mapping[str, Design], amiss: set[str]
    ) -> None:
        """Request what the pass has found, then reason again if it has inferred something new.

        Args:
            measured: what was measured when the pass began.
            grounded: the design that served each function then.
            amiss: functions whose mode was requested, but was not in force then.
        """
        for function in self._objectives:
            self._ground(function, grounded.get(function), function in amiss, measured)
        unrealisable = frozenset(
            design.name for design in DESIGNS if not self._failed.isdisjoint(design.components)
        )
        self._is_reasoning = unrealisable != self._unrealisable
        self._unrealisable = unrealisable
        if self._is_reasoning:
            self._reason()
        else:
            self._recovered = False

    def _ground(
        self, function: str, serving: Design | None, is_amiss: bool, measured: Mapping[str, float]
    ) -> None:
        """Request the mode of the best possible design, unless the objective is satisfied."""
        barred = self._unrealisable | self._errors
        if serving is not None and serving.name not in self._unrealisable:
            if is_amiss:
                barred |= {serving.name}
                self._errors |= {serving.name}
            elif function != SEARCH and serving.suffices(measured) and not self._recovered:
                return
        for design in DESIGNS:
            is_possible = design.name not in barred and design.suffices(measured)
            if design.function == function and is_possible:
                self.modes.request(function, design.name)
                self._grounded = {**self._grounded, function: design}
                return
