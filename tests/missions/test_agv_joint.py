"""The joint plan of corridors and configurations, judged by exhaustive search."""

from dataclasses import replace
from itertools import product
from math import inf

import pytest
from agv_worlds import generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng

from kb import KnowledgeBase, UnknownName
from missions.agv import PAPER, WEIGHTS, Weights
from missions.agv.joint import Modes, Place, Task, crossing, switching
from missions.agv.model import Building, Corridor, agv_model

CHEAP = Weights(energy=1.0)


def modes_without(*failed):
    kb = KnowledgeBase(agv_model(), clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    return Modes(kb)


def task_of(failed="", building=PAPER, weights=WEIGHTS, place=None, energy_j=inf):
    modes = modes_without(*failed.split())
    return Task(building, modes, weights, place or Place(building.start), energy_j)


def simple_paths(building, place, visited=()):
    """Yield every path of corridors to the goal that visits no place twice."""
    if place == building.goal:
        yield ()
    for corridor in building.exits(place):
        to = corridor.other(place)
        if to not in (*visited, place):
            for rest in simple_paths(building, to, (*visited, place)):
                yield (corridor, *rest)


def drives(building, place):
    """Yield every way to the goal as (light, obstacles [1/m], metres) of each part of it.

    From within a corridor the first part is the rest of it, or the way back without obstacles.
    """
    starts = [(place.name, ())]
    if place.corridor:
        inside = building.corridors[place.corridor]
        ahead = (inside.light, inside.obstacles, inside.length_m - place.driven_m)
        back = (inside.light, 0.0, place.driven_m)
        starts = [(inside.other(place.name), (ahead,)), (place.name, (back,))]
    for name, first in starts:
        for path in simple_paths(building, name):
            yield (*first, *((part.light, part.obstacles, part.length_m) for part in path))


def least_cost(building, modes, weights, place, energy_j):
    """Try every path in every sequence of modes; None if none keeps the limit."""
    best = None
    for parts in drives(building, place):
        options = [modes.under(light, obstacles) for light, obstacles, _ in parts]
        for chosen in product(*options):
            energy = cost = 0
            setups = [modes.running, *(mode.setup for mode in chosen)]
            for before, mode, (_, obstacles, metres) in zip(setups, chosen, parts, strict=False):
                for takes in (switching(before, mode.setup), crossing(mode, metres, obstacles)):
                    scaled = zip(weights, takes, (1.0, 1.0, 1e-3), strict=True)
                    cost += round(sum(weight * amount * unit for weight, amount, unit in scaled))
                    energy += takes.energy
            if energy <= energy_j * 1e3 + 1e-6:
                best = cost if best is None else min(best, cost)
    return best


@settings(max_examples=25)
@given(
    st.integers(0, 10_000),
    st.sampled_from([Weights(time=1.0), Weights(energy=0.1), Weights(1.0, 0.01, 10.0)]),
    st.floats(0.0, 1.2),
    st.sampled_from([("kinect", "mrpt"), ("camera", "mrpt"), ("amcl", "kinect")]),
    st.sampled_from([None, 0.0, 0.4, 0.9]),
)
def test_plan_is_optimal_also_within_a_limit(seed, weights, share, failed, inside):
    building = generated_building(default_rng(seed), 4, 4)
    modes = modes_without(*failed)
    corridor = building.corridors["c1"]
    place = Place(building.start)
    if inside is not None:
        place = Place(corridor.ends[0], "c1", inside * corridor.length_m)
    free = Task(building, modes, weights, place).plan()
    assert free.cost == least_cost(building, modes, weights, place, inf)
    cheapest = Task(building, modes, CHEAP, place).plan()
    if free.cost is not None:
        # between the least energy that a way takes and what the best takes, when not limited
        energy_j = cheapest.cost / 1e3 * (1.0 + share)
        tight = Task(building, modes, weights, place, energy_j).plan()
        assert tight.cost == least_cost(building, modes, weights, place, energy_j)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(2, 6), st.sampled_from([None, 0.0, 0.3, 1.0]))
def test_bounds_are_consistent(seed, places, share):
    building = generated_building(default_rng(seed), places, places - 1)
    inside = building.corridors["c1"]
    place = None if share is None else Place(inside.ends[0], "c1", share * inside.length_m)
    task = task_of(building=building, place=place)
    states = [task.start]
    for state in states[:30]:
        cost, (energy,) = task.least(state)
        for move in task.moves(state):
            next_cost, (next_energy,) = task.least(move.to)
            assert cost <= move.cost + next_cost
            assert energy <= move.uses[0] + next_energy
            states.append(move.to)


DARK = replace(PAPER, corridors={**PAPER.corridors, "c3": Corridor(("d", "e"), light=0.1)})


@pytest.mark.parametrize(
    ("question", "route"),
    [
        ({}, "c1 amcl_kinect fast"),
        ({"failed": "kinect"}, "c4 c3 c2"),
        ({"weights": Weights(time=1.0, collisions=1e4)}, "c4 c3 c2"),
        ({"place": Place("a", "c1", 15.0)}, "c1"),
        ({"failed": "kinect", "place": Place("a", "c1", 15.0)}, "c4 c3 c2"),
        ({"building": replace(PAPER, goal="a"), "place": Place("a", "c1", 20.0)}, "c1"),
        (
            {"failed": "kinect lidar", "weights": CHEAP, "building": DARK},
            "c4 c3 aruco_camera_lamp c2",
        ),
        ({"place": Place("b")}, ""),
    ],
)
def test_route_and_modes_are_chosen_together(question, route):
    answer = task_of(**question).plan()
    assert answer.cost is not None
    words = [word for leg in answer.legs for word in (leg.corridor, *leg.mode.name.split())]
    remaining = iter(words)
    assert all(word in remaining for word in route.split())
    assert len(answer.legs) == sum(word in PAPER.corridors for word in route.split())
    if not route:
        assert answer.reason == "already at b"


def test_question_without_a_plan_is_answered_with_the_reason():
    answer = task_of("kinect lidar camera").plan()
    assert answer.cost is None
    start = "b cannot be reached from a; c1, c2, c3, c4 cannot be crossed: navigate is unfeasible"
    assert answer.reason.startswith(start)


def test_limit_that_is_too_low_is_named_with_the_least():
    least_j = task_of(weights=CHEAP).plan().cost / 1e3
    reason = task_of(weights=CHEAP, energy_j=least_j - 0.001).plan().reason
    assert reason.startswith("no way takes at most ")
    assert reason.endswith(f"; the best takes {least_j:.0f} J")
    assert task_of(weights=CHEAP, energy_j=least_j).plan().cost is not None


parts = st.sampled_from(["kinect", "lidar", "camera", "amcl", "lamp"])
events = st.one_of(
    st.tuples(st.sampled_from(["component_failed", "component_recovered"]), parts),
    st.tuples(st.just("measure"), st.just("heat"), st.sampled_from([20.0, 45.0, 55.0])),
    st.tuples(st.just("component_active"), parts, st.booleans()),
)


@settings(max_examples=25)
@given(st.lists(events, min_size=1, max_size=6))
def test_modes_are_those_of_a_new_reader_after_any_events(script):
    model = agv_model()
    heat = model.environmental_attribute("heat")
    model.designs["amcl_kinect"].constrain((heat <= 50.0).steady(hysteresis=10.0))
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    modes = Modes(kb)
    for verb, *arguments in script:
        getattr(kb, verb)(*arguments)
        revision = kb.revision
        answers = [
            Task(PAPER, each, WEIGHTS, Place("a"), 1500.0).plan() for each in (modes, Modes(kb))
        ]
        assert answers[0][1:] == answers[1][1:]
        assert kb.revision == revision


@pytest.mark.parametrize(
    ("end", "goal", "name"), [("hal", "desk", "hal"), ("hall", "ball", "ball")]
)
def test_place_that_there_is_not_is_refused(end, goal, name):
    places = {"hall": (0.0, 0.0), "desk": (3.0, 4.0)}
    with pytest.raises(UnknownName, match=f"unknown place '{name}'; did you mean 'hall'"):
        Building(places, {"c1": Corridor((end, "desk"))}, "hall", goal)


def test_generated_building_is_connected_and_repeatable():
    building = generated_building(default_rng(0))
    assert building == generated_building(default_rng(0))
    assert (len(building.places), len(building.corridors)) == (58, 70)
    assert task_of(building=building).plan().cost is not None
