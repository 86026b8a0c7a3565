"""The joint plan of corridors and configurations, judged by exhaustive search and the engine."""

from itertools import product

import pytest
from agv_worlds import asked_of, building_from, generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv import PAPER, WEIGHTS
from missions.agv.joint import GOALS, JointPlanner, Place, Question, crossing, switching
from missions.agv.model import agv_model
from missions.engine.mission import MissionError
from rosa_pddl import Planner


def planner_without(*failed, building=PAPER):
    kb = KnowledgeBase(agv_model(), clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    return JointPlanner(building, kb)


def simple_paths(building, place, visited=()):
    """Yield every path of corridors to the goal that visits no place twice."""
    if place == building.goal:
        yield ()
    for corridor in building.exits[place]:
        to = corridor.other(place)
        if to not in (*visited, place):
            for rest in simple_paths(building, to, (*visited, place)):
                yield (corridor, *rest)


def drives(building, task):
    """Yield every way to the goal as (conditions, metres, obstacles) of each part of it.

    From within a corridor the first part is the rest of it, or the way back without obstacles.
    """
    place = task.start[0]
    starts = [(place.name, ())]
    if place.corridor:
        inside = building.corridors[place.corridor]
        demands = task.demands(inside)
        ahead_m = inside.length_m - place.driven_m
        ahead = (demands, ahead_m, inside.obstacles * ahead_m)
        back = ({**demands, "obstacles": 0.0}, place.driven_m, 0.0)
        starts = [(inside.other(place.name), (ahead,)), (place.name, (back,))]
    for name, first in starts:
        for path in simple_paths(building, name):
            corridors = [
                (task.demands(part), part.length_m, part.obstacles * part.length_m) for part in path
            ]
            yield (*first, *corridors)


def least_cost(building, task):
    """Try every path in every sequence of modes; None if none keeps the limits."""
    best = None
    for parts in drives(building, task):
        options = [task.modes.under(conditions) for conditions, _, _ in parts]
        for modes in product(*options):
            total = [0, 0, 0]
            cost = 0
            for before, mode, part in zip((task.start[1], *modes), modes, parts, strict=False):
                for takes in (switching(before, mode), crossing(mode, *part[1:])):
                    weights = task.question.weights
                    scaled = zip(GOALS.items(), takes, strict=True)
                    cost += round(
                        sum(weights.get(name, 0.0) * (1e3 / n) * x for (name, n), x in scaled)
                    )
                    total = [a + b for a, b in zip(total, takes, strict=True)]
            amounts = dict(zip(GOALS, total, strict=True))
            limits = zip(task.limited, task.limits, strict=True)
            if all(amounts[name] <= limit for name, limit in limits):
                best = cost if best is None else min(best, cost)
    return best


@settings(max_examples=25)
@given(
    st.integers(0, 10_000),
    st.sampled_from([{"time": 1.0}, {"energy": 0.1}, {"time": 1.0, "energy": 0.01}]),
    st.floats(0.5, 2.0),
    st.sampled_from([*GOALS]),
    st.sampled_from([("kinect", "mrpt"), ("camera", "mrpt"), ("amcl", "kinect")]),
    st.sampled_from([None, 0.0, 0.4, 0.9]),
)
def test_plan_is_optimal_also_within_limits(seed, weights, share, limited, failed, inside):
    building = generated_building(default_rng(seed), 4, 4)
    planner = planner_without(*failed, building=building)
    corridor = building.corridors["c1"]
    start = Place(corridor.ends[0], "c1", inside * corridor.length_m) if inside else None
    free = Question(start, weights=weights)
    answer = planner.plan(free)
    assert (answer.cost if answer.is_solved else None) == least_cost(building, planner.task(free))
    if answer.is_solved:
        limits = {limited: answer.takes.in_units[limited] * share}
        tight = Question(start, weights=weights, limits=limits)
        within = planner.plan(tight)
        best = least_cost(building, planner.task(tight))
        assert (within.cost if within.is_solved else None) == best


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(2, 6), st.sampled_from([None, 0.0, 0.3, 1.0]))
def test_bounds_are_consistent(seed, places, share):
    building = generated_building(default_rng(seed), places, places - 1)
    inside = building.corridors["c1"]
    start = None if share is None else Place(inside.ends[0], "c1", share * inside.length_m)
    question = Question(start, weights=WEIGHTS, limits={"energy": 1e6})
    task = planner_without(building=building).task(question)
    states = [task.start]
    for state in states[:30]:
        cost, (energy,) = task.least(state)
        for move in task.moves(state):
            next_cost, (next_energy,) = task.least(move.to)
            assert cost <= move.cost + next_cost
            assert energy <= move.uses[0] + next_energy
            states.append(move.to)


@pytest.mark.parametrize("failed", ["kinect", "lidar"])
@pytest.mark.parametrize(
    ("start", "limits"), [(None, {}), (Place("a", "c1", 5.0), {}), (None, {"energy": 2000.0})]
)
def test_engine_finds_the_same_cost_in_pddl(failed, start, limits):
    planner = planner_without(failed, "mrpt", "aruco")
    question = Question(start, weights=WEIGHTS, limits=limits)
    answer = planner.plan(question)
    result = asked_of(Planner(timeout_s=60.0), planner.task(question))
    assert result.outcome.is_solved is answer.is_solved
    assert result.cost == (answer.cost if answer.is_solved else None)


@pytest.mark.parametrize(
    ("failed", "question", "route"),
    [
        ("", Question(weights=WEIGHTS), "c1 amcl_kinect fast"),
        ("kinect", Question(weights=WEIGHTS), "c4 c3 c2"),
        ("", Question(weights={"time": 1.0, "collisions": 10_000.0}), "c4 c3 c2"),
        ("", Question(Place("a", "c1", 15.0), weights=WEIGHTS), "c1"),
        ("kinect", Question(Place("a", "c1", 15.0), weights=WEIGHTS), "c4 c3 c2"),
        ("", Question(Place("a", "c1", 20.0), "a", {"collisions": 1e3, "time": 1.0}), "c1"),
        (
            "kinect lidar",
            Question(weights={"energy": 1.0}, light={"c3": 0.1}),
            "c4 c3 aruco_camera_lamp c2",
        ),
        ("", Question(Place("b")), ""),
        ("", Question(Place("b", "", 3.0)), ""),
    ],
)
def test_route_and_modes_are_chosen_together(failed, question, route):
    answer = planner_without(*failed.split()).plan(question)
    assert answer.is_solved
    words = [word for leg in answer.legs for word in (leg.corridor, *leg.mode.name.split())]
    remaining = iter(words)
    assert all(word in remaining for word in route.split())
    assert len(answer.legs) == sum(word in PAPER.corridors for word in route.split())
    if not route:
        assert answer.reason == "already at b"


@pytest.mark.parametrize(
    ("failed", "limits", "words"),
    [
        (
            "kinect lidar camera",
            {},
            "b cannot be reached from a; c1, .*c4 cannot be crossed: navigate is unfeasible",
        ),
        ("", {"energy": 700.0, "collisions": 0.01}, r"limits: energy 700 \(alone .*\(alone 0 or"),
    ],
)
def test_question_without_a_plan_is_answered_with_the_reason(failed, limits, words):
    answer = planner_without(*failed.split()).plan(Question(limits=limits))
    assert not answer.is_solved
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(answer.reason)


def test_limit_that_is_too_low_is_named_with_the_least():
    planner = planner_without()
    least = planner.plan(Question(weights={"energy": 1.0})).takes.in_units["energy"]
    reason = planner.plan(Question(limits={"energy": least - 0.001})).reason
    assert reason.endswith(f"(alone {least:.6g} or more)")
    assert planner.plan(Question(limits={"energy": least})).is_solved


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"weights": {"speed": 1.0}}, "no weight 'speed'; there are time, energy, collisions"),
        ({"weights": {"time": -1.0}}, "must be a number from 0"),
        ({"weights": {}}, "nothing is minimised"),
        ({"limits": {"energy": float("nan")}}, "the limit of energy is nan"),
        ({"goal": "z"}, "goal names the place 'z'"),
        ({"light": {"c9": 0.1}}, "names the corridor 'c9', which map paper lacks"),
        ({"start": Place("a", "c9", 1.0)}, "names the corridor 'c9', which map paper lacks"),
    ],
)
def test_question_without_meaning_is_refused(fields, words):
    with pytest.raises(MissionError, match=words):
        planner_without().plan(Question(**fields))


parts = st.sampled_from(["kinect", "lidar", "camera", "amcl", "lamp"])
events = st.one_of(
    st.tuples(st.sampled_from(["component_failed", "component_recovered"]), parts),
    st.tuples(st.just("measure"), st.just("heat"), st.sampled_from([20.0, 45.0, 55.0])),
    st.tuples(st.just("component_active"), parts, st.booleans()),
)


@settings(max_examples=25)
@given(st.lists(events, min_size=1, max_size=6))
def test_planner_answers_as_a_new_one_after_any_events(script):
    model = agv_model()
    heat = model.environmental_attribute("heat")
    model.designs["amcl_kinect"].constrain((heat <= 50.0).steady(hysteresis=10.0))
    kb = KnowledgeBase(model, clock=lambda: 0.0)
    planner = JointPlanner(PAPER, kb)
    question = Question(weights=WEIGHTS, limits={"energy": 1500.0})
    for verb, *arguments in script:
        getattr(kb, verb)(*arguments)
        revision = kb.revision
        answer = planner.plan(question)
        fresh = JointPlanner(PAPER, kb).plan(question)
        assert (answer.reason, answer.cost) == (fresh.reason, fresh.cost)
        assert kb.revision == revision


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"length_m": -2.0}, "length_m of corridor c1 is -2.0; it must be a number from 0.001 to"),
        ({"light": 1.5}, "from 0 to 1"),
        ({"to": "d"}, "names the place 'd', which map small lacks"),
        ({"to": "a"}, "leads from a to itself"),
        ({"to": "z"}, "disconnected: no way from a to b; add a corridor"),
    ],
)
def test_map_without_meaning_is_refused(fields, words):
    data = {
        "name": "small",
        "start": "a",
        "goal": "z",
        "places": {"a": [0, 0], "b": [3, 4], "z": [9, 9]},
        "corridors": {"c1": {"from": "a", "to": "b", **fields}},
    }
    with pytest.raises(MissionError, match=words):
        building_from(data)


def test_generated_building_is_connected_and_repeatable():
    building = generated_building(default_rng(0))
    assert building == generated_building(default_rng(0))
    assert (len(building.places), len(building.corridors)) == (58, 70)
    answer = planner_without("kinect", building=building).plan(Question())
    assert answer.is_solved or "cannot be reached from p0" in answer.reason
