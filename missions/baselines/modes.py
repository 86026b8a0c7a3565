"""Modes of functions in the manner of ROS 2 System Modes, and SUAVE's two baselines that only ask for modes."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from missions.baselines.manager import Manager, Robot
from missions.engine.mission import MissionError

UNGROUND = "fd_unground"
MODES_FILE = Path(__file__).with_name("modes.toml")


@dataclass(frozen=True, slots=True)
class Mode:
    """What a mode means: whether the component is active in it, and the values of its parameters."""

    active: bool
    parameters: Mapping[str, float]


class SystemModes:
    """Switches components by the modes of their functions.

    Read from a TOML file: a table for each function with its `component` and its `modes`; MissionError if it is not.
    """

    def __init__(self, robot: Robot, path: Path = MODES_FILE) -> None:
        self._robot = robot
        self._components, self._modes = _read(path)
        self._requested: dict[str, str] = {}

    def of(self, function: str) -> tuple[str, ...]:
        return tuple(self._known(function))

    def request(self, function: str, mode: str) -> None:
        """Ask for a mode; one that was asked for last already is ignored."""
        modes = self._known(function)
        if mode not in modes:
            raise MissionError(f"function {function} has no mode {mode!r}; there are {', '.join(modes)}")
        before = self._requested.get(function)
        if mode == before:
            return
        self._requested[function] = mode
        self._switch(self._components[function], modes.get(before or ""), modes[mode])

    def unground(self, function: str) -> None:
        """Ask for the mode in which the function's component is inactive."""
        self.request(function, UNGROUND)

    def is_in(self, function: str, mode: str) -> bool:
        """Tell whether what is in force is what a mode means; several modes may mean the same."""
        component, wanted = self._components[function], self._known(function)[mode]
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

    def _known(self, function: str) -> Mapping[str, Mode]:
        if function not in self._modes:
            raise MissionError(f"there is no function {function!r}; there are {', '.join(self._modes)}")
        return self._modes[function]


def _read(path: Path) -> tuple[dict[str, str], dict[str, dict[str, Mode]]]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        components = {function: str(table["component"]) for function, table in content.items()}
        modes = {
            function: {name: _mode(dict(values)) for name, values in table["modes"].items()}
            for function, table in content.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise MissionError(
            f"cannot read the modes in {path}: {type(error).__name__}: {error}; expected is, for each function, a "
            "component and modes such as fd_high = { active = true, altitude = 3.0 }"
        ) from error
    return components, modes


def _mode(values: dict[str, float]) -> Mode:
    active = values.pop("active")
    if not isinstance(active, bool):
        raise TypeError(f"active is {active!r}, not true or false")
    return Mode(active, {name: float(value) for name, value in values.items()})


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
