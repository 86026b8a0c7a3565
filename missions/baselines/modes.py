"""Modes of functions in the manner of ROS 2 System Modes, and SUAVE's two baselines that only ask for modes."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from missions.baselines.manager import Manager, Robot
from missions.engine.mission import MissionError

UNGROUND = "fd_unground"


@dataclass(frozen=True, slots=True)
class Mode:
    """What a mode means: whether the component is active in it, and the values of its parameters."""

    active: bool
    parameters: Mapping[str, float] = field(default_factory=dict)


_ON, _OFF = Mode(True), Mode(False)
_LOW, _MEDIUM, _HIGH = (Mode(True, {"spiral_altitude": metres}) for metres in (1.0, 2.0, 3.0))

FUNCTIONS: Final[Mapping[str, tuple[str, Mapping[str, Mode]]]] = {
    "f_generate_search_path": (
        "spiral_search",
        {"__DEFAULT__": _LOW, "fd_spiral_high": _HIGH, "fd_spiral_medium": _MEDIUM, "fd_spiral_low": _LOW}
        | {UNGROUND: _OFF},
    ),
    "f_follow_pipeline": ("follow_pipeline", {"__DEFAULT__": _OFF, "fd_follow_pipeline": _ON, UNGROUND: _OFF}),
    "f_maintain_motion": (
        "recover_thrusters",
        {"__DEFAULT__": _ON, "fd_all_thrusters": _OFF, "fd_recover_thrusters": _ON, UNGROUND: _OFF},
    ),
    "f_generate_recharge_path": ("recharge", {"__DEFAULT__": _OFF, "normal": _ON, "inactive": _OFF, UNGROUND: _OFF}),
}
"""The component and the modes of each function; kas-lab/suave v1.3.0, System Modes."""


class SystemModes:
    """Switches components by the modes of their functions."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._requested: dict[str, str] = {}

    def of(self, function: str) -> tuple[str, ...]:
        return tuple(_known(function)[1])

    def request(self, function: str, mode: str) -> None:
        """Ask for a mode; one that was asked for last already is ignored."""
        component, modes = _known(function)
        if mode not in modes:
            raise MissionError(f"function {function} has no mode {mode!r}; there are {', '.join(modes)}")
        before = self._requested.get(function)
        if mode == before:
            return
        self._requested[function] = mode
        self._switch(component, modes.get(before or ""), modes[mode])

    def unground(self, function: str) -> None:
        """Ask for the mode in which the function's component is inactive."""
        self.request(function, UNGROUND)

    def is_in(self, function: str, mode: str) -> bool:
        """Tell whether what is in force is what a mode means; several modes may mean the same."""
        component, modes = _known(function)
        wanted = modes[mode]
        parameters = self._robot.parameters(component)
        return wanted.active == self._robot.is_active(component) and all(
            parameters.get(key) == value for key, value in wanted.parameters.items()
        )

    def _switch(self, component: str, before: Mode | None, mode: Mode) -> None:
        if mode.parameters and (before is None or before.parameters != mode.parameters):
            self._robot.set_parameters(component, mode.parameters)
        if mode.active and (before is None or not before.active):
            self._robot.activate(component)
        elif not mode.active and before is not None and before.active:
            self._robot.deactivate(component)


def _known(function: str) -> tuple[str, Mapping[str, Mode]]:
    if function not in FUNCTIONS:
        raise MissionError(f"there is no function {function!r}; there are {', '.join(FUNCTIONS)}")
    return FUNCTIONS[function]


MODES = {
    "search_pipeline": ("f_generate_search_path", "fd_spiral_low"),
    "inspect_pipeline": ("f_follow_pipeline", "fd_follow_pipeline"),
}
"""Function and mode of each task; kas-lab/suave v1.3.0."""


class NoManager(Manager):
    """Searches at 1 m whatever the water is like, inspects, and never recovers a thruster."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._modes = SystemModes(robot)

    def begin(self, task: str) -> None:
        self._modes.request(*MODES[task])

    def end(self, task: str) -> None:
        self._modes.unground(MODES[task][0])


PERIODS_S = {"2024": 15.0, "2025": 30.0}
"""From one choice to the next [s], by the rules. 30 s were meant from the first; v1.3.0 reads another parameter."""


class RandomManager(Manager):
    """Every 15 or 30 s asks for any mode of the function that the task needs, also for the one that stops it."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.period_s = PERIODS_S[robot.settings.rules]
        self._modes = SystemModes(robot)

    def update(self) -> None:
        if self.robot.task is not None:
            function, _ = MODES[self.robot.task]
            modes = self._modes.of(function)
            self._modes.request(function, modes[self.robot.rng.integers(len(modes))])

    def end(self, task: str) -> None:
        self._modes.unground(MODES[task][0])
