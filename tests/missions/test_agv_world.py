"""The building by itself, without a mission: wheels move the vehicle, rays steer it, light and components decide."""

import itertools
import math

import numpy
import pytest
from agv_worlds import building_from, generated_building
from running import rosa_run

from missions.agv import agv_mission
from missions.agv.model import NAVIGATOR, SPEEDS
from missions.agv.vehicle import Aim, Vehicle, boxes, check_walls
from missions.agv.world import BuildingWorld, Settings
from missions.engine.mission import MissionError
from missions.engine.settings import RunSettings

AMCL_KINECT = ("amcl", "kinect")


def hall(length_m=8.0, **corridor):
    return building_from(
        {
            "start": "a",
            "goal": "b",
            "places": {"a": [0, 0], "b": [length_m, 0]},
            "corridors": {"c1": {"from": "a", "to": "b", **corridor}},
        }
    )


def started(building, components, seed=0, **values):
    """Return a world in which some components drive the vehicle along c1."""
    told = {"incidents": "", **{name: str(value) for name, value in values.items()}}
    world = BuildingWorld(building, Settings.read(told), numpy.random.default_rng(seed))
    world.managed.set_parameters("base", {"speed": SPEEDS["fast"]})
    world.managed.set_parameters(NAVIGATOR, {"corridor": "c1", "origin": "a"})
    for name in (*components, "base", NAVIGATOR):
        world.managed.activate(name)
    return world


def passed(world, seconds):
    """Let time pass; returns what was said meanwhile: (time [s], key, value)."""
    until, said = world.now + seconds, []
    while world.now < until - 1e-6:
        for message in world.advance(until):
            for status in message["status"]:
                said += [(message["time"], key, value) for key, value in status["values"].items()]
    return said


def driven_m(world):
    return world.results()["driven_m"]


def test_both_wheels_alike_drive_straight_and_one_against_the_other_turn_on_the_spot():
    vehicle = Vehicle(hall(20.0), [], (3.0, 0.0, 0.0), 0.01)
    vehicle.drive(Aim(0.5, 0.0), 400)
    assert vehicle.position == pytest.approx((5.0, 0.0), abs=0.1)
    assert vehicle.yaw == pytest.approx(0.0, abs=0.06)
    stood = vehicle.position
    vehicle.drive(Aim(0.0, 0.5), 200)
    assert 0.6 < vehicle.yaw < 1.0  # less than an ideal one, for wide wheels scrub
    assert math.dist(vehicle.position, stood) < 0.1


@pytest.mark.parametrize(
    ("length_m", "obstacles"), [(6.0, 0.4), (6.0, 1e12), (8.0, 0.6), (20.0, 1.0)]
)
def test_corridor_full_of_boxes_can_be_driven_as_it_is_planned(length_m, obstacles):
    building = hall(length_m, obstacles=obstacles)
    along = sorted(x for x, _, _ in boxes(building, numpy.random.default_rng(0)))
    assert along
    assert all(two - one > 0.8 for one, two in itertools.pairwise(along))
    world = started(building, AMCL_KINECT)
    passed(world, 5.0 * length_m)
    assert driven_m(world) > length_m - 0.5


def test_corridors_that_cross_one_another_are_refused_as_their_walls_would_close_them():
    places = {"a": [0, 0], "b": [6, 0], "c": [0, 6], "d": [6, 6]}
    ends = {"c1": ("a", "d"), "c2": ("d", "b"), "c3": ("b", "c")}
    told = {name: {"from": one, "to": two} for name, (one, two) in ends.items()}
    building = building_from({"start": "a", "goal": "c", "places": places, "corridors": told})
    with pytest.raises(
        MissionError, match=r"corridors c1 and c3 cross one another.*let them meet at a place"
    ):
        started(building, AMCL_KINECT)
    del told["c3"]
    told["c4"] = {"from": "a", "to": "c"}
    started(
        building_from({"start": "a", "goal": "c", "places": places, "corridors": told}), AMCL_KINECT
    )


@pytest.mark.parametrize("places", [2, 58, 200])
def test_corridors_of_generated_buildings_do_not_cross(places):
    for seed in range(10):
        check_walls(
            generated_building(numpy.random.default_rng(seed), places, places - 1 + places // 5)
        )


def test_box_in_the_way_is_seen_from_afar_and_stops_who_does_not_look():
    vehicle = Vehicle(hall(20.0), [(6.0, 0.0, 0.0)], (3.0, 0.0, 0.0), 0.01)
    ahead = [x for x, y in vehicle.look("lidar") if abs(y) < 0.1]
    assert ahead == []  # further than 2 m is of no use yet
    vehicle.drive(Aim(0.6, 0.0), 250)
    ahead = [x for x, y in vehicle.look("lidar") if abs(y) < 0.1]
    assert min(ahead) == pytest.approx(5.8 - vehicle.position[0], abs=0.05)
    assert vehicle.collisions == 0
    vehicle.drive(Aim(0.6, 0.0), 500)
    assert vehicle.position[0] < 5.8 - 0.19
    vehicle.drive(Aim(0.6, 0.0), 1)
    assert vehicle.collisions >= 1


def test_rays_decide_whether_it_passes_the_boxes(monkeypatch):
    building = hall(12.0, obstacles=0.4)
    seeing = started(building, AMCL_KINECT)
    assert any(key == "at b" for _, key, _ in passed(seeing, 60))
    assert seeing.results()["collisions"] == 0
    monkeypatch.setattr(Vehicle, "look", lambda self, sensor: numpy.zeros((0, 2)))
    blind = started(building, AMCL_KINECT)
    passed(blind, 60)
    assert blind.results()["collisions"] > 0


def test_camera_sees_in_the_dark_only_by_the_lamp():
    world = started(hall(light=0.1), ("aruco", "camera"))
    passed(world, 20)
    stood_m = driven_m(world)
    assert 0.9 < stood_m < 2.0  # the place is light, the corridor is not
    passed(world, 10)
    assert driven_m(world) == pytest.approx(stood_m, abs=0.01)
    world.managed.activate("lamp")
    assert any(key == "at b" for _, key, _ in passed(world, 40))


@pytest.mark.parametrize("lost", ["amcl", "kinect", "base", NAVIGATOR])
def test_vehicle_stands_without_a_component_that_it_drives_by_and_drives_on_with_it(lost):
    world = started(hall(), AMCL_KINECT)
    passed(world, 6)
    world.managed.deactivate(lost)
    passed(world, 1.5)
    stood_m = driven_m(world)
    passed(world, 5)
    assert driven_m(world) == pytest.approx(stood_m, abs=0.01)
    world.managed.activate(lost)
    assert any(key == "at b" for _, key, _ in passed(world, 30))


def test_vehicle_without_energy_stands():
    world = started(hall(20.0), AMCL_KINECT, capacity_j=300)
    passed(world, 15)
    stood_m = driven_m(world)
    assert 2.0 < stood_m < 10.0
    passed(world, 5)
    assert driven_m(world) == pytest.approx(stood_m, abs=0.01)
    assert world.results()["energy_used_j"] == 300


@pytest.mark.parametrize("seed", range(8))
def test_what_happens_in_one_corridor_happens_in_the_order_that_is_given(seed):
    incidents = "lidar fails in c1, lidar recovers in c1, dark in c1, light in c1"
    world = started(hall(), AMCL_KINECT, seed, incidents=incidents)
    passed(world, 30)
    happened = [what for _, what in world.disturbances()]
    assert happened == [
        "lidar failed",
        "lidar recovered",
        "light in c1 goes out",
        "light in c1 goes on",
    ]


def test_energy_is_known_before_the_first_plan_so_nobody_sets_out_in_vain():
    mission = agv_mission("hall", "drives", hall())
    world = mission.world.open({"incidents": "", "capacity_j": "100"}, numpy.random.default_rng(0))
    run = rosa_run(mission, "bt", world, RunSettings(duration_s=5.0))
    assert "within all limits: energy " in run.run().reason
    assert world.results()["driven_m"] < 0.01
    assert run.kb.history.actions == ()
