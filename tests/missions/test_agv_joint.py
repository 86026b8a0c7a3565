"""The joint plan of corridors and configurations: judged by an exhaustive search and by Fast Downward."""

from collections.abc import Callable
from itertools import product
from math import inf
from typing import NamedTuple

import pytest
from agv_worlds import asked_of, building_from, generated_building
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import default_rng

from kb import KnowledgeBase
from missions.agv import PAPER, WEIGHTS
from missions.agv.joint import GOALS, JointPlanner, Place, Question, crossing, switching, weighing
from missions.agv.model import agv_model
from missions.engine.mission import MissionError
from rosa_pddl import Outcome, Planner
from rosa_pddl.search import Move, cheapest, distances

MODEL = agv_model()


class Graph(NamedTuple):
    """A graph made of functions."""

    moves: Callable[[int], list[Move]]
    is_goal: Callable[[int], bool]
    least: Callable[[int], tuple[float, tuple[float, ...]]] = lambda state: (0.0, ())


def known(*failed):
    kb = KnowledgeBase(MODEL, clock=lambda: 0.0)
    for name in failed:
        kb.component_failed(name)
    return kb


def paper(*failed):
    return JointPlanner(PAPER, known(*failed))


def simple_ways(building, start, goal):
    """Return every way as corridors and places that visits no place twice."""
    found, waiting = [], [((), (start,))]
    while waiting:
        corridors, places = waiting.pop()
        if places[-1] == goal:
            found.append((corridors, places))
            continue
        for one in building.exits[places[-1]]:
            if one.other(places[-1]) not in places:
                waiting.append(((*corridors, one), (*places, one.other(places[-1]))))
    return found


def by_exhaustion(building, kb, question):
    """Try every way in every sequence of modes; knows nothing of the planner but what crossing and switching take."""
    running = JointPlanner(building, kb).task(question).start[1]
    best = None
    modes = JointPlanner(building, kb).task(question).modes
    scales = {"time": 1e3, "energy": 1e3, "collisions": 1e6}
    for corridors, _ in simple_ways(building, building.start, building.goal):
        demands = [{"light": one.light, "obstacles": one.obstacles} for one in corridors]
        for chosen in product(*(modes.under(each) for each in demands)):
            total, cost = [0, 0, 0], 0
            for before, mode, one in zip((running, *chosen), chosen, corridors, strict=False):
                parts = (
                    switching(before, mode),
                    crossing(mode, one.length_m, one.obstacles * one.length_m),
                )
                cost += sum(map(weighing(question.weights), parts))
                total = [a + b + c for a, b, c in zip(total, *parts, strict=True)]
            used = dict(zip(GOALS, total, strict=True))
            if all(used[name] / scales[name] <= limit for name, limit in question.limits.items()):
                best = cost if best is None else min(best, cost)
    return best


weights = st.fixed_dictionaries(
    {"time": st.sampled_from([0.0, 1.0]), "energy": st.sampled_from([0.01, 0.1])}
)


@settings(max_examples=40)
@given(
    st.integers(0, 10_000),
    weights,
    st.floats(0.5, 2.0),
    st.sampled_from(["energy", "collisions", "time"]),
    st.data(),
)
def test_exhaustive_search_agrees_also_within_limits(seed, weighed_by, part, limited, data):
    building = generated_building(default_rng(seed), 4, data.draw(st.integers(3, 4)))
    kb = known(
        *data.draw(
            st.sampled_from(
                [("kinect", "mrpt"), ("lidar", "mrpt"), ("camera", "mrpt"), ("amcl", "kinect")]
            )
        )
    )
    planner = JointPlanner(building, kb)
    free = Question(weights=weighed_by)
    answer = planner.plan(free)
    assert (answer.cost if answer.is_solved else None) == by_exhaustion(building, kb, free)
    if not answer.is_solved:
        return
    takes = answer.takes.in_units
    tight = Question(weights=weighed_by, limits={limited: takes[limited] * part})
    within = planner.plan(tight)
    assert (within.cost if within.is_solved else None) == by_exhaustion(building, kb, tight)


@settings(max_examples=60)
@given(
    st.integers(0, 10_000),
    st.integers(2, 12),
    st.integers(0, 2),
    st.sampled_from([None, 0.0, 0.3, 1.0]),
)
def test_least_is_never_more_than_what_is_left(seed, places, more, part):
    try:
        building = generated_building(default_rng(seed), places, places - 1 + more)
    except MissionError:
        return
    inside = building.corridors["c1"]
    start = None if part is None else Place(inside.ends[0], "c1", part * inside.length_m)
    task = JointPlanner(building, known()).task(
        Question(start, weights=WEIGHTS, limits={"energy": 1e6})
    )
    states = [task.start]
    for state in states[:40]:
        here, (here_j,) = task.least(state)
        for move in task.moves(state):
            there, (there_j,) = task.least(move.to)
            assert here <= move.cost + there
            assert here_j <= move.uses[0] + there_j
            states.append(move.to)


@given(
    st.dictionaries(
        st.integers(0, 5),
        st.lists(st.tuples(st.integers(0, 5), st.integers(0, 9), st.integers(0, 9))),
    )
)
def test_search_without_bounds_finds_what_all_short_ways_give(arcs):
    def ways(state, seen, cost, used):
        if state == 5:
            yield cost, used
        for to, more, use in arcs.get(state, ()):
            if to not in seen:
                yield from ways(to, {*seen, to}, cost + more, used + use)

    graph = Graph(
        lambda state: [Move(to, cost, (use,), to) for to, cost, use in arcs.get(state, ())],
        lambda s: s == 5,
    )
    best = min((cost for cost, used in ways(0, {0}, 0, 0) if used <= 7), default=None)
    found = cheapest(graph, 0, [7])
    assert (None if found is None else found.cost) == best


weighted = st.tuples(
    st.integers(0, 6), st.integers(0, 9), st.tuples(st.integers(0, 5), st.integers(0, 5))
)


@settings(max_examples=150)
@given(
    st.dictionaries(st.integers(0, 6), st.lists(weighted, max_size=5)),
    st.tuples(st.integers(0, 9), st.integers(0, 9)),
)
def test_bounds_do_not_change_what_is_found(arcs, limits):
    def moves(state):
        return [Move(to, cost, uses, None) for to, cost, uses in arcs.get(state, ())]

    far = [
        distances(
            [(one, to, (cost, *uses)[part]) for one in arcs for to, cost, uses in arcs[one]], [6]
        )
        for part in range(3)
    ]

    def least(state):
        cost, *uses = (each.get(state, inf) for each in far)
        return cost, tuple(uses)

    plain = cheapest(Graph(moves, lambda state: state == 6), 0, limits)
    bounded = cheapest(Graph(moves, lambda state: state == 6, least), 0, limits)
    assert (plain is None) == (bounded is None)
    if plain is not None and bounded is not None:
        assert plain.cost == bounded.cost
        for found in (plain, bounded):
            assert found.cost == sum(move.cost for move in found.moves)
            assert found.uses == tuple(
                sum(move.uses[part] for move in found.moves) for part in range(2)
            )
            assert all(used <= limit for used, limit in zip(found.uses, limits, strict=True))


@pytest.mark.parametrize("failed", [("kinect", "mrpt", "aruco"), ("lidar", "mrpt", "aruco")])
@pytest.mark.parametrize("start", [None, Place("a", "c1", 5.0)])
def test_fast_downward_proves_the_same_cost(failed, start):
    planner = paper(*failed)
    question = Question(start=start, weights=WEIGHTS)
    answer = planner.plan(question)
    result = asked_of(Planner(timeout_s=60.0), planner.task(question))
    assert result.outcome is Outcome.SOLVED_OPTIMALLY
    assert result.cost == answer.cost


def test_straight_way_with_the_kinect_and_round_without_it():
    assert [
        (leg.corridor, leg.mode.name) for leg in paper().plan(Question(weights=WEIGHTS)).legs
    ] == [("c1", "amcl_kinect fast")]
    without = paper("kinect").plan(Question(weights=WEIGHTS))
    assert [leg.corridor for leg in without.legs] == ["c4", "c3", "c2"]
    assert all("kinect" not in leg.mode.name for leg in without.legs)


def test_collisions_that_are_expected_can_decide_the_way():
    weights = {"time": 1.0, "collisions": 10_000.0}
    assert [leg.corridor for leg in paper().plan(Question(weights=weights)).legs] == [
        "c4",
        "c3",
        "c2",
    ]


def test_robot_within_a_corridor_goes_back_only_if_it_must():
    inside = Question(start=Place("a", "c1", 15.0), weights=WEIGHTS)
    assert [leg.corridor for leg in paper().plan(inside).legs] == ["c1"]
    assert [leg.corridor for leg in paper("kinect").plan(inside).legs] == ["c4", "c3", "c2"]
    longer = paper("kinect").plan(inside).takes.in_units["time"]
    assert (
        longer
        > paper("kinect")
        .plan(Question(start=Place("a", "c1", 1.0), weights=WEIGHTS))
        .takes.in_units["time"]
    )


def test_way_back_past_known_obstacles_is_not_taken_for_the_whole_corridor():
    planner = paper()
    weights = {"collisions": 1000.0, "time": 1.0}
    there = planner.plan(Question(Place("a"), "b", {"time": 1.0}))
    back = planner.plan(Question(Place("a", "c1", 20.0), "a", weights))
    again = planner.plan(Question(Place("a"), "b", {"time": 1.0}))
    assert [(leg.corridor, leg.to) for leg in back.legs] == [("c1", "a")]
    assert back.takes.collisions == 0
    assert there.takes == again.takes
    assert there.takes.collisions > 0


def test_camera_needs_the_lamp_where_it_is_dark():
    weights = {"energy": 1.0}
    light = paper("kinect", "lidar").plan(Question(weights=weights)).legs
    dark = paper("kinect", "lidar").plan(Question(weights=weights, light={"c3": 0.1})).legs
    assert ["lamp" in leg.mode.name for leg in light] == [False, False, False]
    assert "lamp" in dark[1].mode.name


def test_switching_is_counted_so_a_short_dark_corridor_keeps_the_lamp_on():
    corridors = {
        f"c{n}": {"from": f"p{n}", "to": f"p{n + 1}", "light": 0.1 if n % 2 else 1.0}
        for n in range(5)
    }
    data = {
        "start": "p0",
        "goal": "p5",
        "places": {f"p{n}": [n, 0] for n in range(6)},
        "corridors": corridors,
    }
    planner = JointPlanner(building_from(data), known("kinect", "lidar"))
    lit = ["lamp" in leg.mode.name for leg in planner.plan(Question()).legs]
    assert lit[1:4] == [True, True, True]


def test_nothing_is_planned_where_no_configuration_is_possible_and_the_reason_says_why():
    answer = paper("kinect", "lidar", "camera").plan(Question())
    assert not answer.is_solved
    assert answer.legs == ()
    assert "no corridor can be crossed in any configuration" in answer.reason
    assert "navigate is unfeasible" in answer.reason


def test_goal_behind_a_corridor_that_cannot_be_crossed_is_said_to_be_out_of_reach():
    data = {
        "start": "a",
        "goal": "c",
        "places": {"a": [0, 0], "b": [5, 0], "c": [9, 0]},
        "corridors": {
            "free": {"from": "a", "to": "b"},
            "full": {"from": "b", "to": "c", "obstacles": 1.0},
        },
    }
    answer = JointPlanner(building_from(data), known("kinect")).plan(Question())
    assert not answer.is_solved
    assert "c cannot be reached from a; full cannot be crossed" in answer.reason


def test_limits_that_contradict_each_other_are_named_with_what_is_possible():
    answer = paper().plan(Question(limits={"energy": 700.0, "collisions": 0.01}))
    assert not answer.is_solved
    assert "no way keeps within all limits: energy 700 (alone " in answer.reason
    assert "collisions 0.01 (alone 0 or more)" in answer.reason  # these can be kept to


def test_limit_that_is_too_low_is_told_with_the_least_that_would_do():
    planner = paper()
    least = planner.plan(Question(weights={"energy": 1.0})).takes.in_units["energy"]
    reason = planner.plan(Question(limits={"energy": least - 0.001})).reason
    assert reason.startswith("no way keeps within all limits: energy ")
    assert reason.endswith(f"(alone {least:.6g} or more)")
    assert planner.plan(Question(limits={"energy": least})).is_solved


def test_battery_limit_makes_the_robot_take_a_thriftier_way():
    planner = paper("kinect")
    free, least = planner.plan(Question()), planner.plan(Question(weights={"energy": 1.0}))
    limit = (free.takes.in_units["energy"] + least.takes.in_units["energy"]) / 2
    thrifty = planner.plan(Question(limits={"energy": limit}))
    assert thrifty.is_solved
    assert (
        least.takes.in_units["energy"]
        <= thrifty.takes.in_units["energy"]
        <= limit
        < free.takes.in_units["energy"]
    )
    assert thrifty.takes.in_units["time"] > free.takes.in_units["time"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"weights": {"speed": 1.0}}, "no weight 'speed'; there are time, energy, collisions"),
        ({"weights": {"time": -1.0}}, "must be a number from 0"),
        ({"weights": {}}, "nothing is minimised"),
        ({"limits": {"energy": float("nan")}}, "the limit of energy is nan"),
        ({"goal": "z"}, "goal names the place 'z'"),
        ({"light": {"c9": 0.1}}, "names the corridor 'c9', which map paper lacks"),
        ({"start": Place("a", "c9", 1.0)}, "names the corridor 'c9', which map paper lacks"),
        ({"start": Place("d", "c1", 1.0)}, "c1 does not begin at d"),
        ({"start": Place("a", "c1", float("nan"))}, "driven_m is nan"),
    ],
)
def test_bad_question_is_refused(changes, words):
    with pytest.raises(MissionError, match=words):
        paper().plan(Question(**changes))


def test_start_at_the_goal_needs_no_leg():
    answer = paper().plan(Question(start=Place("b")))
    assert answer.is_solved
    assert answer.legs == ()
    assert answer.cost == 0


def test_asking_tells_the_knowledge_base_nothing():
    kb = known()
    before = kb.revision
    JointPlanner(generated_building(default_rng(0)), kb).plan(Question())
    assert kb.revision == before
    assert kb.attributes["light"].value is None
