from numpy.random import default_rng
from whole_worlds import episode

from rosa_pddl import Planner


def test_the_executor_reaches_what_can_be_reached_in_worlds_that_change():
    planner = Planner()
    ended = [episode(default_rng(seed), planner) for seed in range(25)]
    assert [(reached, could) for reached, could in ended if reached != could] == []
    assert {reached for reached, _ in ended} == {True, False}
