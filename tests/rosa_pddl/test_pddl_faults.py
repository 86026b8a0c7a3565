"""Whatever goes wrong for a while, afterwards exactly what can be reached is reached.

The long part is a benchmark.
"""

from faulty_worlds import Ground, episode


def test_after_much_has_gone_wrong_exactly_what_can_be_reached_is_reached():
    ended = [episode(ground, seed) for ground in (Ground(3), Ground(4)) for seed in range(6)]
    assert sum(plans for plans, _ in ended) > 150
    assert {can for _, can in ended} == {True, False}
