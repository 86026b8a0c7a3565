"""How the world of the aerial vehicle is opened; MuJoCo is imported only then."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from numpy.random import Generator

from kb import KnowledgeBase
from missions.engine.mission import Setting, Verdict, WorldKind
from missions.engine.percepts import Percepts
from missions.uav.actions import analysed, is_all_analysed
from missions.uav.settings import Settings

if TYPE_CHECKING:
    from missions.uav.world import UavWorld

__all__ = ["SKY"]


class _SkyKind(WorldKind):
    def settings(self) -> tuple[Setting, ...]:
        """Return every constant."""
        return Settings.describe()

    def open(self, values: Mapping[str, str], rng: Generator) -> "UavWorld":
        """Open a field with a vehicle at its base."""
        settings = Settings.read(values)
        from missions.uav.world import UavWorld

        return UavWorld(settings, rng)

    def verdict(self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase) -> Verdict:
        """Judge by the goal: every sample that is wanted is analysed, and the battery never ran empty."""
        done, wanted = analysed(percepts), results.get("wanted_samples") or 0
        if percepts.holds("battery_empty"):
            return Verdict("aborted", f"the battery ran empty, {done} of {wanted:g} samples were analysed")
        if is_all_analysed(percepts):
            return Verdict("analysed_all", f"all {wanted:g} samples are analysed")
        return Verdict("aborted", f"time ran out, {done} of {wanted:g} samples were analysed")


SKY = _SkyKind()
