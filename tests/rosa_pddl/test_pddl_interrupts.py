"""Whatever instruction an interrupt comes before, what a step owns is released and the next tick goes on."""

import pytest
from interrupts import check, instructions, stop, tick, world_of
from numpy.random import default_rng

from rosa_pddl import Planner, Problem, initial_state

PLANNER = Planner()


@pytest.fixture(scope="module")
def make(extended):
    PLANNER.plan(Problem(extended, initial_state(extended)))
    return lambda: world_of(extended, PLANNER)


@pytest.mark.parametrize(
    ("act", "ticks"), [*((tick, number) for number in (0, 2, 3, 4, 8)), (stop, 2), (stop, 4)]
)
def test_an_interrupt_at_any_instruction_leaves_nothing_owned_and_the_goal_is_reached(
    make, act, ticks
):
    there_are = instructions(make, ticks, act)
    assert there_are > 50
    for instruction in default_rng(ticks).choice(there_are, 40, replace=False) + 1:
        check(make, ticks, act, int(instruction))
