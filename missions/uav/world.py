"""How the field is opened as a world of missions, and how one there has ended; MuJoCo is imported only then."""

from collections.abc import Mapping

from numpy.random import Generator

from kb import KnowledgeBase
from missions.engine.mission import Percepts, Setting, Verdict, World, WorldKind
from missions.engine.settings import declared
from missions.uav.settings import Settings
from missions.uav.tree import analysed, is_all_analysed


class _SkyKind(WorldKind):
    def settings(self) -> tuple[Setting, ...]:
        return declared(Settings)

    def open(self, values: Mapping[str, str], rng: Generator) -> World:
        from missions.uav.nodes import UavWorld

        return UavWorld(Settings.read(values), rng)

    def verdict(self, percepts: Percepts, results: Mapping[str, float | None], kb: KnowledgeBase) -> Verdict:
        """Judge by the goal: every sample that is wanted is analysed, and the battery never ran empty."""
        done, wanted = analysed(percepts), results.get("wanted_samples") or 0
        if percepts.holds("battery_empty"):
            return Verdict("aborted", f"the battery ran empty, {done} of {wanted:g} samples were analysed")
        if is_all_analysed(percepts):
            return Verdict("analysed_all", f"all {wanted:g} samples are analysed")
        return Verdict("aborted", f"time ran out, {done} of {wanted:g} samples were analysed")


SKY = _SkyKind()
