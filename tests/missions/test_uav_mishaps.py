"""Whatever happens to battery, gripper and goal, at whichever moment: judged by what the world truly is."""

import numpy
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from running import rosa_run

from missions.engine.mission import find_mission
from missions.engine.runner import Listener
from missions.engine.settings import RunSettings
from missions.engine.task_layer import TASK_KINDS
from missions.uav.vehicle import Settings
from missions.uav.world import Sample, UavWorld

FOLDED_DEG = 9
MOVERS = ("search_planner", "pick_up_planner", "hover_planner", "return_planner", "landing_planner")


class Mishaps(UavWorld):
    """A field in which things happen when they are told to: `happens` is a list of (time [s], what, value)."""

    happens: tuple[tuple[float, str, float], ...] = ()

    def advance(self, until):
        due = [one for one in self.happens if one[0] <= self.now]
        self.happens = tuple(one for one in self.happens if one not in due)
        for _, what, value in due:
            getattr(self, what)(value)
        return super().advance(min([until, *(one[0] for one in self.happens)]))

    def drop(self, level):
        self.level = min(level, self.level)

    def jam(self, lasts_s):
        self.is_jammed = True
        self.let_go()
        self.publish("component status", "gripper", "FALSE")
        self.happens += ((self.now + lasts_s, "recover", 0.0),)

    def recover(self, _):
        self.is_jammed = False
        self.publish("component status", "gripper", "recovered")

    def report(self, x):
        number = len(self.samples) + 1
        added = Sample(f"sample_{number}", (x, 3.0), self.now, is_reported=True)
        self.samples.append(added)


class Witness(Listener):
    """Looks at the components themselves, at each tick."""

    def __init__(self):
        self.breaches = []
        self.looked = 0
        self.unfolded = 0

    def tick(self, run):
        is_active, seen = run.world.managed.is_active, run.world.sample()
        movers = [one for one in MOVERS if is_active(one)]
        if len(movers) > 1:
            self.breaches.append(f"{seen.time} s: {movers} move it at once")
        self.looked += is_active("infrared_camera")
        self.unfolded += seen.signals["gripper [deg]"] > FOLDED_DEG
        if is_active("infrared_camera") and (
            seen.signals["gripper [deg]"] > FOLDED_DEG or is_active("gripper")
        ):
            self.breaches.append(f"{seen.time} s: it looks with an unfolded gripper")
        if seen.position[2] < 0.3:
            self.breaches.append(f"{seen.time} s: it is in the ground")


def flown(task, seed, happens, duration_s, **changed):
    mission, witness = find_mission("uav"), Witness()
    world = Mishaps(Settings(**changed), numpy.random.default_rng(seed))
    world.happens = tuple(happens)
    run = rosa_run(mission, task, world, RunSettings(duration_s=duration_s), (witness,))
    return run.run(), run, witness


MOMENTS = st.floats(0, 150)
HAPPENS = st.one_of(
    st.tuples(MOMENTS, st.just("drop"), st.sampled_from([0.54, 0.4, 0.29])),
    st.tuples(MOMENTS, st.just("jam"), st.sampled_from([0.1, 1.0, 10.0, 60.0])),
    st.tuples(MOMENTS, st.just("report"), st.floats(2, 30)),
)


@given(
    happens=st.lists(HAPPENS, max_size=6),
    switching=st.tuples(*[st.sampled_from([0.0, 0.03, 0.5, 3.0])] * 2),
    seed=st.integers(0, 100),
)
@settings(max_examples=4, suppress_health_check=[HealthCheck.too_slow])
def test_whatever_happens_whenever_all_is_analysed_and_nothing_unsafe_is_done(
    happens, switching, seed
):
    reports = [one for one in happens if one[1] == "report"]
    happens = [one for one in happens if one not in reports[3:]]
    takes = dict(zip(("activation_s", "deactivation_s"), switching, strict=True))
    verdict, run, witness = flown(
        "bt", seed, happens, 900, samples=2, added_s=0, gripper_worn_s=0, **takes
    )
    assert witness.breaches == []
    assert verdict.success, verdict
    assert run.world.results()["wanted_samples"] == 2 + len(
        [one for one in reports[:3] if one[0] < run.world.now]
    )


@pytest.mark.parametrize("task", TASK_KINDS)
@pytest.mark.parametrize("jams_s", [5.5, 7.5, 9.0])
def test_gripper_that_fails_while_it_is_still_being_started_unfolds_and_is_folded_before_the_look(
    task, jams_s
):
    happens = [(jams_s, "jam", 400.0)]
    verdict, run, witness = flown(
        task,
        0,
        happens,
        400,
        samples=1,
        added_s=0,
        gripper_worn_s=0,
        activation_s=0.5,
        deactivation_s=3.0,
    )
    assert witness.breaches == []
    assert witness.looked > 0
    assert verdict.success
    order = [one.action for one in run.kb.history.actions][1:]
    if witness.unfolded:
        assert order == ["pick_up_and_analyse", "land_and_fold_gripper", "analyse_on_site"]
    else:
        assert (jams_s, order) == (5.5, ["analyse_on_site"])
