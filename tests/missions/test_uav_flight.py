"""The quadrotor by itself: where it is told to be, there it is, and it takes the power that it must."""

import math

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.engine.mission import MissionError
from missions.uav.vehicle import (
    ARM_M,
    ON_GROUND_M,
    REACTION_M,
    SUBSTEPS,
    Quadrotor,
    Settings,
    attitude,
    mixed,
    velocity_wanted,
)
from missions.uav.world import UavWorld

PLACES = st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(0.5, 6))
SMALL = st.floats(-0.05, 0.05)


def flown(vehicle, seconds):
    for _ in range(round(seconds / (SUBSTEPS * Settings().physics_step_s))):
        vehicle.step()
    return vehicle


@given(
    place=PLACES, bearing=st.floats(0, 2 * math.pi), load=st.floats(0, 0.5), folded=st.booleans()
)
@settings(max_examples=8)
def test_vehicle_arrives_and_stays_with_any_wind_load_and_arm(place, bearing, load, folded):
    vehicle = Quadrotor(Settings(), (4 * math.cos(bearing), 4 * math.sin(bearing)))
    vehicle.fold(folded)
    vehicle.carry(load)
    vehicle.go_to(place)
    flown(vehicle, 25)
    assert vehicle.is_near(place, 0.15)
    assert not vehicle.is_landed
    assert vehicle.arm_rad == pytest.approx(0 if folded else math.pi / 2, abs=0.15)


def test_hovering_takes_the_power_of_momentum_theory():
    constants = Settings()
    vehicle = Quadrotor(constants, (0.0, 0.0))
    vehicle.go_to((0.0, 0.0, 3.0))
    flown(vehicle, 15)
    weight = 1.5 * constants.gravity_m_s2
    area = 4 * math.pi * constants.rotor_radius_m**2
    ideal = weight**1.5 / math.sqrt(2 * constants.air_kg_m3 * area)
    assert vehicle.rotor_w == pytest.approx(ideal / constants.figure_of_merit, rel=0.01)


def test_loaded_vehicle_takes_more_power_until_the_load_is_gone():
    vehicle = Quadrotor(Settings(), (0.0, 0.0))
    vehicle.go_to((0.0, 0.0, 3.0))
    empty = flown(vehicle, 15).rotor_w
    vehicle.carry(0.3)
    assert flown(vehicle, 15).rotor_w == pytest.approx(empty * (1.8 / 1.5) ** 1.5, rel=0.01)
    vehicle.carry(0.0)
    assert flown(vehicle, 15).rotor_w == pytest.approx(empty, rel=0.01)


def test_vehicle_lands_where_it_is_and_takes_off_again():
    vehicle = Quadrotor(Settings(), (2.0, -1.0))
    vehicle.go_to((4.0, 3.0, 5.0))
    flown(vehicle, 12)
    vehicle.land()
    flown(vehicle, 10)
    assert vehicle.is_landed
    assert vehicle.rotor_w == 0
    assert vehicle.position == pytest.approx((4.0, 3.0, ON_GROUND_M), abs=0.3)
    vehicle.hold()
    assert flown(vehicle, 2).is_landed
    vehicle.go_to((4.0, 3.0, 2.0))
    assert flown(vehicle, 8).is_near((4.0, 3.0, 2.0), 0.2)


def test_vehicle_without_power_falls_and_stays_down():
    vehicle = Quadrotor(Settings(), (0.0, 0.0))
    vehicle.go_to((0.0, 0.0, 4.0))
    flown(vehicle, 10)
    vehicle.has_power = False
    flown(vehicle, 5)
    assert 0 <= vehicle.position[2] < 0.5
    assert vehicle.rotor_w == 0


@given(thrust=st.floats(8, 20), torques=st.tuples(SMALL, SMALL, SMALL))
def test_mixed_thrusts_give_back_thrust_and_torques(thrust, torques):
    one, two, three, four = mixed(thrust, torques, limit=8.0)
    assert one + two + three + four == pytest.approx(thrust)
    assert ARM_M * (one + two - three - four) == pytest.approx(torques[0], abs=1e-9)
    assert ARM_M * (-one + two + three - four) == pytest.approx(torques[1], abs=1e-9)
    assert REACTION_M * (one - two + three - four) == pytest.approx(torques[2], abs=1e-9)


@given(
    thrust=st.floats(-100, 100),
    torques=st.tuples(*[st.floats(-50, 50)] * 3),
    limit=st.floats(1, 20),
)
def test_no_rotor_is_asked_for_more_than_it_can_give_nor_to_pull_down(thrust, torques, limit):
    assert all(0 <= one <= limit for one in mixed(thrust, torques, limit))


@given(thrust=st.floats(-100, 100), torques=st.tuples(SMALL, SMALL, SMALL))
def test_lift_gives_way_before_the_vehicle_loses_its_balance(thrust, torques):
    one, two, three, four = mixed(thrust, torques, limit=8.0)
    assert ARM_M * (one + two - three - four) == pytest.approx(torques[0], abs=1e-9)
    assert ARM_M * (-one + two + three - four) == pytest.approx(torques[1], abs=1e-9)


def test_strongest_push_of_the_wind_that_can_be_set_is_flown_in():
    vehicle = Quadrotor(Settings(drag=1.1), (0.0, 4.0))
    vehicle.go_to((0.0, -6.0, 3.0))
    assert flown(vehicle, 40).is_near((0.0, -6.0, 3.0), 0.3)


@given(angle=st.floats(-3, 3), axis=st.sampled_from([0, 1]))
def test_torque_turns_the_mast_back_up(angle, axis):
    quaternion = [math.cos(angle / 2), 0.0, 0.0, 0.0]
    quaternion[1 + axis] = math.sin(angle / 2)
    thrust, torques = attitude(quaternion, (0.0, 0.0, 0.0), (0.0, 0.0, 10.0))
    assert thrust == pytest.approx(10.0 * math.cos(angle))
    assert torques[axis] * angle <= 1e-12
    assert abs(angle) < 1e-6 or torques[axis] != 0


@given(at=PLACES, to=PLACES, speed=st.floats(0.1, 5), climb=st.floats(0.1, 5))
def test_wanted_velocity_keeps_its_limits_and_points_to_the_target(at, to, speed, climb):
    x, y, z = velocity_wanted(at, to, speed, climb)
    assert math.hypot(x, y) <= speed * (1 + 1e-9)
    assert abs(z) <= climb
    assert x * (to[0] - at[0]) >= 0
    assert y * (to[1] - at[1]) >= 0
    assert z * (to[2] - at[2]) >= 0


def test_component_that_does_not_exist_is_refused_with_those_that_do():
    world = UavWorld(Settings(), numpy.random.default_rng(0))
    with pytest.raises(MissionError, match=r"'griper' with .* is unknown; there are .*, gripper, "):
        world.managed.activate("griper")
    with pytest.raises(
        MissionError, match=r"'gripper' with .*force.* is unknown; .* have no parameters"
    ):
        world.managed.set_parameters("gripper", {"force": 1.0})


def test_switching_takes_its_time_and_is_done_then():
    world = UavWorld(Settings(activation_s=0.5), numpy.random.default_rng(0))
    operation = world.managed.activate("search_planner")
    while world.now < 0.49:
        world.advance(0.49)
    assert not operation.done()
    assert not world.managed.is_active("search_planner")
    while world.now < 0.5:
        world.advance(0.5)
    assert operation.done()
    assert operation.exception() is None
    assert world.managed.is_active("search_planner")
