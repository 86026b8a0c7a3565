"""The simulated sea as a world of missions.

The simulator is imported only when a mission runs in it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from kb import KnowledgeBase
from missions.engine.components import VERBS, SimulatedComponents
from missions.engine.mission import (
    SEA_MANAGERS,
    Message,
    MissionError,
    Percepts,
    Sample,
    Setting,
    Verdict,
    World,
    WorldKind,
)
from missions.engine.settings import declared, read_values

if TYPE_CHECKING:
    from numpy.random import Generator

    from suave_env import Change, Settings, SuaveEnv


class Sea(World):
    """Adapts the simulator to the interface of a mission's world."""

    def __init__(self, env: "SuaveEnv") -> None:
        self._env = env
        settings = env.settings
        takes = settings.activation_s, settings.deactivation_s, settings.parameter_s
        self._nodes = SimulatedComponents(
            lambda: env.now, env.components, dict(zip(VERBS, takes, strict=True))
        )

    @property
    def now(self) -> float:
        return self._env.now

    @property
    def managed(self) -> SimulatedComponents:
        return self._nodes

    @property
    def history(self) -> Sequence["Change"]:
        return self._env.components.history

    @property
    def settings(self) -> "Settings":
        return self._env.settings

    def advance(self, until: float) -> list[Message]:
        env = self._env
        nodes = self._nodes
        while True:
            end = nodes.next_event()
            messages = env.advance(until if end >= until else max(env.now, end), pause=True)
            if nodes.catch_up() or messages or env.now >= until:
                return list(messages)

    def results(self) -> Mapping[str, float | None]:
        from suave_env.monitors import mean_reactions

        return {**asdict(self._env.metrics), **mean_reactions(self._env.reactions)}

    def reactions(self) -> Sequence[Any]:
        return self._env.reactions

    def sample(self) -> Sample:
        seen = self._env.observe()
        signals = {
            "water visibility [m]": seen.water_visibility,
            "battery level [-]": seen.battery_level,
            "altitude [m]": seen.altitude,
            "search altitude [m]": seen.spiral_altitude
            if "spiral_search" in seen.active
            else float("nan"),
        }
        return Sample(seen.time, (seen.x, seen.y, seen.z), signals)

    def way_m(self) -> float:
        """Return how far the vehicle is from the station [m]."""
        seen = self._env.observe()
        return math.dist((seen.x, seen.y), self._env.station)

    def disturbances(self) -> list[tuple[float, str]]:
        return self._env.disturbances

    def scenery(self) -> Mapping[str, Any]:
        return {"pipeline": self._env.pipeline.points, "recharge station": [self._env.station]}


class _SeaKind(WorldKind):
    managers = SEA_MANAGERS

    def settings(self) -> tuple[Setting, ...]:
        from suave_env import Settings

        return declared(Settings)

    def open(self, values: Mapping[str, Any], rng: "Generator") -> Sea:
        from suave_env import Settings, SuaveEnv, SuaveEnvError

        try:
            return Sea(SuaveEnv(Settings().replace(**read_values(declared(Settings), values)), rng))
        except SuaveEnvError as error:
            raise MissionError(str(error)) from error

    def verdict(
        self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase
    ) -> Verdict:
        return self.judge(
            percepts, results, any(action.action == "recharge" for action in kb.history.actions)
        )

    def judge(
        self, percepts: Percepts, results: Mapping[str, float | None], needed_recharge: bool
    ) -> Verdict:
        """Judge by the goal; `needed_recharge`: the battery ran low or a recharge began."""
        if percepts.holds("pipeline_inspected"):
            return Verdict("inspected_all", "the whole pipeline is inspected")
        if not percepts.holds("pipeline_found"):
            return Verdict("not_found", "the pipeline was not found in time")
        if not results.get("total_inspected_m"):
            return Verdict("aborted", "time ran out before any of the pipeline was inspected")
        if needed_recharge and not percepts.count("battery_recharged"):
            return Verdict(
                "aborted", "the battery ran low, and time ran out before it was recharged"
            )
        return Verdict("time_limit", "the pipeline was found and inspected up to the time limit")


SEA = _SeaKind()
