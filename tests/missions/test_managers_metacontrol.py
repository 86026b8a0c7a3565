"""Metacontrol: what it knows, what it infers and chooses, and its cycle."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.baselines import open_run
from missions.baselines.modes import (
    ALWAYS_IMPROVED,
    DESIGNS,
    Metacontrol,
    Situation,
    Standing,
    best_design,
    designs_of,
    standing,
    unrealisable,
)
from missions.baselines.modes import FUNCTIONS as FUNCTIONS_AND_MODES
from missions.engine.mission import find_mission

SEARCH, MOTION, FOLLOW = "f_generate_search_path", "f_maintain_motion", "f_follow_pipeline"
FUNCTIONS = st.sampled_from([SEARCH, MOTION, FOLLOW])
SITUATIONS = st.builds(
    Situation,
    measured=st.one_of(st.just({}), st.floats(0, 5).map(lambda value: {"water_visibility": value})),
    failed=st.frozensets(st.sampled_from([f"c_thruster_{number}" for number in range(1, 7)])),
    unrealisable=st.frozensets(st.sampled_from([one.name for one in DESIGNS])),
    grounded=st.dictionaries(FUNCTIONS, st.sampled_from([one.name for one in DESIGNS])),
    not_in_force=st.frozensets(FUNCTIONS),
    errors=st.frozensets(st.sampled_from([one.name for one in DESIGNS])),
    recovered=st.booleans(),
)


def test_knowledge_says_of_the_vehicle_what_suave_says():
    assert [(one.name, one.performance, one.qualities) for one in designs_of(SEARCH)] == [
        ("fd_spiral_high", 1.0, (("water_visibility", 3.25),)),
        ("fd_spiral_medium", 0.5, (("water_visibility", 2.25),)),
        ("fd_spiral_low", 0.25, (("water_visibility", 1.25),)),
    ]
    assert [(one.name, one.performance, len(one.components)) for one in designs_of(MOTION)] == [
        ("fd_all_thrusters", 1.0, 6),
        ("fd_recover_thrusters", 0.75, 0),
    ]
    assert {SEARCH} == ALWAYS_IMPROVED


def test_every_design_is_a_mode_of_its_function():
    assert len(DESIGNS) == 6
    for design in DESIGNS:
        assert design.name in FUNCTIONS_AND_MODES[design.function][1]


@given(SITUATIONS, FUNCTIONS)
def test_best_design_is_possible_and_nothing_possible_performs_better(situation, function):
    def is_possible(design):
        value = situation.measured.get("water_visibility")
        return design.name not in situation.unrealisable | situation.errors and not (
            value is not None and any(value < least for _, least in design.qualities)
        )

    possible = [one for one in designs_of(function) if is_possible(one)]
    best = best_design(situation, function)
    assert (best is None) == (not possible)
    if best is not None:
        assert best in possible
        assert best.performance == max(one.performance for one in possible)


@given(SITUATIONS, FUNCTIONS)
def test_objective_served_by_what_is_best_is_in_no_error(situation, function):
    best = best_design(situation, function)
    if best is None:
        return
    served = Situation(
        situation.measured, unrealisable=situation.unrealisable, grounded={function: best.name}
    )
    assert standing(served, function) is Standing.SATISFIED


@given(SITUATIONS)
def test_design_is_unrealisable_exactly_if_it_needs_what_has_failed(situation):
    inferred = unrealisable(situation)
    assert inferred == ({"fd_all_thrusters"} if situation.failed else set())


@pytest.mark.parametrize(
    ("situation", "expected"),
    [
        (Situation(), Standing.UNGROUNDED),
        (Situation(grounded={SEARCH: "fd_all_thrusters"}), Standing.UNGROUNDED),
        (
            Situation(
                {"water_visibility": 3.0},
                unrealisable=frozenset({"fd_spiral_high"}),
                grounded={SEARCH: "fd_spiral_high"},
                not_in_force=frozenset({SEARCH}),
            ),
            Standing.COMPONENT_ERROR,
        ),
        (
            Situation(
                {"water_visibility": 3.0},
                grounded={SEARCH: "fd_spiral_high"},
                not_in_force=frozenset({SEARCH}),
            ),
            Standing.FUNCTION_ERROR,
        ),
        (
            Situation(
                {"water_visibility": 3.0}, grounded={SEARCH: "fd_spiral_high"}, recovered=True
            ),
            Standing.QUALITY_ERROR,
        ),
        (Situation(grounded={SEARCH: "fd_spiral_high"}, recovered=True), Standing.UPDATABLE),
        (
            Situation({"water_visibility": 3.25}, grounded={SEARCH: "fd_spiral_high"}),
            Standing.SATISFIED,
        ),
    ],
)
def test_objective_stands_as_the_first_line_that_holds_says(situation, expected):
    assert standing(situation, SEARCH) is expected


def changes_of(component, run):
    return [change for change in run.world.history if change.component == component]


def test_reasoner_sees_a_failure_in_one_pass_acts_in_the_next_and_returns_to_all_thrusters():
    run = open_run(
        find_mission("suave"), manager="metacontrol", seed=2, settings={"duration_s": "60"}
    )
    run.run()
    reaction = next(one for one in run.world.reactions() if one.uncertainty == "U1")
    assert 2 * 0.3 < reaction.delay_s < 1.5 + 2 * 0.3 + 0.1
    started, stopped = changes_of("recover_thrusters", run)
    assert (started.active, stopped.active) == (True, False)
    assert 10.0 < stopped.time - started.time < 10.0 + 1.5 + 2 * 0.3 + 0.1


def test_search_begins_with_a_cycle_and_takes_the_altitude_that_the_water_allows():
    run = open_run(
        find_mission("suave"), manager="metacontrol", seed=2, settings={"duration_s": "20"}
    )
    run.run()
    begun = run.robot.tasks[0].start
    first = next(change for change in changes_of("spiral_search", run) if change.active)
    assert 0.3 < first.time - begun < 1.5 + 0.3 + 0.1
    assert first.parameters["spiral_altitude"] == 3.0


class Deaf(Metacontrol):
    """Metacontrol of a vehicle whose spiral cannot be set to 3 m."""

    def __init__(self, robot):
        super().__init__(robot)
        setting = robot.set_parameters

        def set_parameters(component, parameters):
            if parameters != {"spiral_altitude": 3.0}:
                setting(component, parameters)

        robot.set_parameters = set_parameters


def test_design_whose_mode_does_not_come_into_force_gives_way_to_the_next_best():
    run = open_run(
        find_mission("suave"), manager=f"{__name__}:Deaf", seed=2, settings={"duration_s": "10"}
    )
    run.run()
    last = changes_of("spiral_search", run)[-1]
    assert last.active
    assert last.parameters["spiral_altitude"] == 2.0
