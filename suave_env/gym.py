"""The sea as a Gymnasium environment, for managers that learn.

Importing this registers `rosa/SUAVE-v0`.

Needs the extra `gym` (`pip install rosa-taca[gym]`).
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from suave_env.env import SuaveEnv
from suave_env.settings import Settings
from suave_env.vehicle import COUNT

COMPONENTS = ("spiral_search", "follow_pipeline", "recover_thrusters", "recharge")
"""The components, in the order of the action."""

ALTITUDES_M = (1.0, 2.0, 3.0)
"""The altitudes of the spiral search [m] that the last part of an action chooses from."""

OBSERVED = {
    "water_visibility": 0.0,
    "battery_level": 1.0,
    **{f"c_thruster_{number}": 1.0 for number in range(1, COUNT + 1)},
    "pipeline_found": 0.0,
}
"""The parts of an observation, and their values before anything is published."""

_WORDS = {"FALSE": 0.0, "ERROR": 0.0, "RECOVERED": 1.0, "OK": 1.0, "true": 1.0}


class SuaveGym(gymnasium.Env[NDArray[np.float32], NDArray[np.int64]]):
    """The mission of SUAVE, one action per step of simulated time.

    Observation, (9,): the values published last (`OBSERVED`): visibility [m], 0 before the first;
    battery level from 0 to 1; for each thruster 1 if it works and 0 if it has failed; 1 once the
    pipeline is found. Action, (5,): for each of `COMPONENTS` 1 for active and 0 for inactive, then
    an index into `ALTITUDES_M`. Reward: metres of the pipeline inspected in the step, without
    SUAVE's reset. An episode is terminated when all of it is inspected, and truncated when the time
    is up.

    Args:
        duration_s: Time limit of an episode [s].
        step_s: Simulated time of one step [s].
        settings: Values that differ from the default settings of the sea, by name, e.g. {"rules":
            "2025"}.

    Raises:
        SuaveEnvError: If a setting is unknown or its value not allowed.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # Gymnasium wants a plain dictionary

    def __init__(
        self,
        duration_s: float = 300.0,
        step_s: float = 1.0,
        settings: Mapping[str, float | int | bool | str] | None = None,
    ) -> None:
        self._settings = Settings().replace(**(settings or {}))
        most = np.ones(len(OBSERVED), dtype=np.float32)
        most[0] = self._settings.visibility_max_m
        self.observation_space = spaces.Box(np.zeros_like(most), most, dtype=np.float32)
        self.action_space = spaces.MultiDiscrete([2] * len(COMPONENTS) + [len(ALTITUDES_M)])
        self._duration_s = duration_s
        self._step_s = step_s
        self._env: SuaveEnv | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; the same seed gives the same one. There are no options."""
        super().reset(seed=seed)
        self._env = SuaveEnv(self._settings, self.np_random)
        self._values = dict(OBSERVED)
        return self._seen(self._env)

    def step(
        self, action: NDArray[np.int64]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Switch the components as the action says, and simulate one step."""
        env = self._env
        if env is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        *switches, altitude = map(int, action)
        altitude_m = ALTITUDES_M[altitude]
        env.components.set_parameters("spiral_search", {"spiral_altitude": altitude_m})
        for name, is_wanted in zip(COMPONENTS, switches, strict=True):
            (env.components.activate if is_wanted else env.components.deactivate)(name)
        before_m = env.metrics.total_inspected_m
        is_done = False
        for message in env.advance(min(env.now + self._step_s, self._duration_s)):
            for status in message["status"]:
                for key, value in status["values"].items():
                    is_done |= key == "pipeline_inspected"
                    if key in OBSERVED:
                        self._values[key] = _WORDS[value] if value in _WORDS else float(value)
        gained_m = env.metrics.total_inspected_m - before_m
        values, info = self._seen(env)
        return values, gained_m, is_done, env.now >= self._duration_s, info

    def _seen(self, env: SuaveEnv) -> tuple[NDArray[np.float32], dict[str, Any]]:
        values = np.array([*self._values.values()], dtype=np.float32)
        return values, {"time_s": env.now, "search_time_s": env.metrics.search_time_s}


if "rosa/SUAVE-v0" not in gymnasium.registry:
    gymnasium.register("rosa/SUAVE-v0", entry_point="suave_env.gym:SuaveGym")
