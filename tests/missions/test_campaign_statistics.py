"""The statistics of a report: laws, and naive twins that count everything."""

from itertools import combinations
from math import inf
from statistics import fmean

import numpy
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missions.experiments import comparison
from missions.experiments.comparison import (
    holm,
    interval_of_mean,
    interval_of_sd,
    paired,
    two_clusters,
)

NUMBERS = st.integers(-1000, 1000).map(lambda number: number / 8)
SAMPLES = st.lists(NUMBERS, min_size=1, max_size=20)
PS = st.lists(st.floats(0, 1), min_size=1, max_size=12)


def seeded():
    return numpy.random.default_rng(0)


@settings(max_examples=25)
@given(SAMPLES, NUMBERS)
def test_interval_of_the_mean_lies_within_the_sample_and_moves_with_it(values, shift):
    found = interval_of_mean(values, seeded())
    assert min(values) - 1e-9 <= found.low <= found.high <= max(values) + 1e-9
    assert found.estimate == pytest.approx(fmean(values))
    moved = interval_of_mean([value + shift for value in values], seeded())
    assert (moved.low, moved.high) == pytest.approx((found.low + shift, found.high + shift))


@settings(max_examples=25)
@given(st.lists(NUMBERS, min_size=2, max_size=20), NUMBERS, st.sampled_from([0.5, 2.0]))
def test_standard_deviation_knows_no_shift_and_scales(values, shift, factor):
    found = interval_of_sd(values, seeded())
    other = interval_of_sd([factor * value + shift for value in values], seeded())
    assert other.estimate == pytest.approx(factor * found.estimate, abs=1e-9)
    assert (other.low, other.high) == pytest.approx(
        (factor * found.low, factor * found.high), abs=1e-9
    )


@pytest.mark.parametrize(
    "draw", [lambda rng: rng.exponential(size=2001), lambda rng: rng.integers(4, size=2001) // 3]
)
@pytest.mark.parametrize("interval", [interval_of_mean, interval_of_sd])
def test_intervals_of_many_values_are_those_of_resamples_without_any(monkeypatch, draw, interval):
    values = draw(seeded())
    resampled = interval(values, seeded())
    monkeypatch.setattr(comparison, "MOST_RESAMPLED", 2000)
    found = interval(values, None)
    assert found.estimate == resampled.estimate
    assert found[1:] == pytest.approx(resampled[1:], abs=0.06 * (resampled.high - resampled.low))
    assert len({*interval([7] * 2001, None)}) == 1


def test_intervals_hold_the_true_mean_about_as_often_as_they_say():
    rng = numpy.random.default_rng(1)
    hits = 0
    for _ in range(200):
        found = interval_of_mean(rng.normal(3.0, 2.0, 40), rng)
        hits += found.low <= 3.0 <= found.high
    assert 180 <= hits <= 198


def test_paired_interval_holds_the_true_difference_as_often_as_it_says():
    rng = numpy.random.default_rng(2)
    hits = 0
    for _ in range(200):
        world = rng.normal(50.0, 20.0, 8)
        first = world + rng.normal(1.0, 1.0, 8)
        difference, p = paired(first, world)
        hits += difference.low <= 1.0 <= difference.high
        assert (p < 0.05) is not (difference.low <= 0.0 <= difference.high)
        assert paired(world, first)[1] == pytest.approx(p)
    assert 180 <= hits <= 198
    assert paired([1.0, 2.0], [1.0, 2.0]) == ((0.0, 0.0, 0.0), 1.0)


@given(PS)
def test_holm_never_lowers_never_leaves_0_to_1_and_keeps_the_order(ps):
    corrected = holm(ps)
    assert all(p <= one <= 1 for p, one in zip(ps, corrected, strict=True))
    ranked = [one for _, one in sorted(zip(ps, corrected, strict=True))]
    assert ranked == sorted(ranked)
    assert min(corrected) == pytest.approx(min(1, len(ps) * min(ps)))
    assert sorted(holm(ps[::-1])) == sorted(corrected)


def test_holm_corrects_as_in_a_worked_example():
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([]) == []


@given(st.lists(st.integers(-50, 50), min_size=2, max_size=7))
def test_two_clusters_are_the_best_of_all_ways_to_part_a_sample(values):
    found = two_clusters(values)
    if len(set(values)) == 1:
        assert found is None
        return

    def within(part):
        return sum((value - fmean(part)) ** 2 for value in part) if part else 0.0

    parts = [
        (one, [value for i, value in enumerate(values) if i not in indices])
        for size in range(1, len(values))
        for indices in combinations(range(len(values)), size)
        for one in [[values[i] for i in indices]]
    ]
    least = min(within(one) + within(other) for one, other in parts)
    below, above = ([v for v in values if v < found.cut], [v for v in values if v > found.cut])
    assert within(below) + within(above) == pytest.approx(least, abs=1e-6)
    assert found.share_low == len(below) / len(values)
    assert found.low == pytest.approx(fmean(below))


def test_clusters_that_are_there_are_told_from_those_that_are_not():
    rng = numpy.random.default_rng(2)
    two = [*rng.normal(50, 5, 60), *rng.normal(120, 5, 40)]
    found = two_clusters(two)
    assert found.separation > 10
    assert found.share_low == 0.6
    assert two_clusters(rng.normal(50, 5, 4000)).separation == pytest.approx(2.65, abs=0.1)
    assert two_clusters(rng.uniform(0, 9, 4000)).separation == pytest.approx(3.46, abs=0.1)
    assert two_clusters([1, 1, 2, 2, 2]).separation == inf


def test_no_values_are_no_sample():
    for ask in (
        lambda: interval_of_mean([], seeded()),
        lambda: paired([], []),
        lambda: interval_of_sd([], None),
    ):
        with pytest.raises(ValueError, match="a sample needs one value or more"):
            ask()
