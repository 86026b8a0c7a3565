"""The statistics of a report, on plain samples; all functions are pure, with the random generator as an argument."""

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Sequence[float] | Array

DRAWS = 10_000
MOST_DRAWN = 2_000_000  # values in memory at once
MOST_RESAMPLED = 10_000  # of more values, means and deviations are nearly normally distributed
LEVEL = 0.95


class Interval(NamedTuple):
    """An estimate from a sample, and the ends of its 95 % confidence interval."""

    estimate: float
    low: float
    high: float

    def shown(self, format_: str) -> str:
        """Return it as text, with its numbers in a format such as ".2f"."""
        return f"{self.estimate:{format_}} [{self.low:{format_}}, {self.high:{format_}}]"


class Clusters(NamedTuple):
    """A sample cut in two so that the variance within the parts is least.

    The separation is the distance of the means, divided by the root of the mean variance within the parts (infinite if
    that is 0). The halves of a uniform distribution have 3.5, those of a normal one 2.6; a larger one means clusters.
    """

    cut: float
    low: float
    high: float
    share_low: float
    separation: float


def interval_of_mean(values: Values, rng: Generator) -> Interval:
    """Return the mean of at least one value and its interval by the bootstrap (percentiles of 10,000 resamples).

    For more than 10,000 values it is that of a normal distribution, which differs less than resampling varies.
    """
    sample = _sample(values)
    return _interval(sample, sample.mean(), sample.std(), lambda drawn: drawn.mean(axis=1), rng)


def interval_of_sd(values: Values, rng: Generator) -> Interval:
    """Return the standard deviation (divisor n - 1) and its interval, as for the mean; NaN for a single value."""
    sample = _sample(values)
    if sample.size < 2:
        return Interval(math.nan, math.nan, math.nan)
    sd = sample.std(ddof=1)
    spread = np.square(sample - sample.mean()).std() / (2 * sd) if sd else 0.0  # of the variance, by the delta method
    return _interval(sample, sd, spread, lambda drawn: drawn.std(axis=1, ddof=1), rng)


def contrast(first: Values, second: Values) -> tuple[float, float]:
    """Compare two independent samples by their ranks.

    Returns:
        p of the two-sided Mann-Whitney test, exact if one has 8 values at most and there are no ties: how likely ranks
        as different as these are if both samples come from the same distribution; and how often a value of the first is
        larger than one of the second, ties counted half: 0.5 for no difference (Vargha and Delaney's A).
    """
    from scipy.stats import mannwhitneyu

    one, other = _sample(first), _sample(second)
    if np.ptp(np.concatenate([one, other])) == 0:
        return 1.0, 0.5
    found = mannwhitneyu(one, other, alternative="two-sided", method="auto")
    return float(found.pvalue), float(found.statistic) / (one.size * other.size)


def holm(ps: Sequence[float]) -> list[float]:
    """Correct p-values for multiple tests (Holm 1979); they keep their order."""
    order = np.argsort(ps)
    corrected = np.minimum(np.maximum.accumulate(np.take(ps, order) * np.arange(len(ps), 0, -1)), 1.0)
    return [float(one) for one in corrected[np.argsort(order)]]


def two_clusters(values: Values) -> Clusters | None:
    """Cut a sample in two so that the variance within the parts is least; None if all values are the same."""
    sample = np.sort(np.asarray(values, dtype=float))
    parts = [np.split(sample, [cut]) for cut in np.flatnonzero(np.diff(sample)) + 1]
    if not parts:
        return None
    low, high = min(parts, key=lambda part: part[0].var() * part[0].size + part[1].var() * part[1].size)
    spread, apart = math.sqrt((low.var() + high.var()) / 2), float(high.mean() - low.mean())
    cut = (float(low[-1]) + float(high[0])) / 2
    separation = apart / spread if spread else math.inf
    return Clusters(cut, float(low.mean()), float(high.mean()), low.size / sample.size, separation)


def _sample(values: Values) -> Array:
    sample = np.asarray(values, dtype=float)
    if not sample.size:
        raise ValueError("a sample needs one value or more")
    return sample


def _interval(
    sample: Array, estimate: float, spread: float, statistic: Callable[[Array], Array], rng: Generator
) -> Interval:
    """Return an estimate with its interval; for many values, as the mean of values with this `spread`.

    The statistic maps resamples (k, n) to estimates (k,).
    """
    if sample.size > MOST_RESAMPLED:
        off = NormalDist().inv_cdf((1 + LEVEL) / 2) * spread / math.sqrt(sample.size)
        return Interval(float(estimate), float(estimate - off), float(estimate + off))
    at_once = max(1, MOST_DRAWN // sample.size)
    counts = [min(at_once, DRAWS - start) for start in range(0, DRAWS, at_once)]
    estimates = [statistic(sample[rng.integers(sample.size, size=(count, sample.size))]) for count in counts]
    low, high = np.percentile(np.concatenate(estimates), [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    return Interval(float(estimate), float(low), float(high))
