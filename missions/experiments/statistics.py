"""The statistics of a report, on plain samples; every function is pure, and chance is handed in."""

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
MOST_RESAMPLED = 10_000  # of more values, means and deviations are as good as normally distributed
LEVEL = 0.95


class Interval(NamedTuple):
    """An estimate, from the sample itself, and the ends of the interval that holds the true value with 95 %."""

    estimate: float
    low: float
    high: float

    def shown(self, format_: str) -> str:
        """Return it as text, with its numbers in a format such as ".2f"."""
        return f"{self.estimate:{format_}} [{self.low:{format_}}, {self.high:{format_}}]"


class Contrast(NamedTuple):
    """How two samples differ.

    Attributes:
        p: of the two-sided Mann-Whitney test: how likely ranks as different as these are if both samples come from the
            same distribution.
        superiority: how often a value of the first is larger than one of the second, ties counted half: 0.5 for no
            difference (Vargha and Delaney's A).
    """

    p: float
    superiority: float


class Clusters(NamedTuple):
    """A sample cut in two where that leaves the least variance within the parts.

    Attributes:
        cut: between the two.
        low: mean of the part below the cut.
        high: mean of the part above it.
        share_low: which part of the sample is below the cut.
        separation: between the means, in units of the spread within the parts (the root of the mean of their
            variances; infinite if there is none). The halves of an even spread have 3.5, those of a bell curve 2.6:
            what is above that is two clusters.
    """

    cut: float
    low: float
    high: float
    share_low: float
    separation: float


def interval_of_mean(values: Values, rng: Generator) -> Interval:
    """Return the mean of at least one value and its interval by the bootstrap (percentiles of 10,000 resamples).

    Of more than 10,000 values it is that of a normal distribution, which differs by less than what chance leaves.
    """
    sample = _sample(values)
    mean = float(sample.mean())
    if sample.size > MOST_RESAMPLED:
        return _normal(mean, float(sample.var()) / sample.size)
    return Interval(mean, *_percentiles(sample, rng, lambda drawn: drawn.mean(axis=1)))


def interval_of_sd(values: Values, rng: Generator) -> Interval:
    """Return the standard deviation (divisor n - 1) and its interval as that of a mean; NaN for a single value."""
    sample = _sample(values)
    if sample.size < 2:
        return Interval(math.nan, math.nan, math.nan)
    sd = float(sample.std(ddof=1))
    if sample.size > MOST_RESAMPLED:
        squares = np.square(sample - sample.mean())
        return _normal(sd, float(squares.var()) / sample.size / (2.0 * sd) ** 2 if sd else 0.0)
    return Interval(sd, *_percentiles(sample, rng, lambda drawn: drawn.std(axis=1, ddof=1)))


def contrast(first: Values, second: Values) -> Contrast:
    """Compare two independent samples by their ranks; exact if one has 8 values at most and there are no ties."""
    from scipy.stats import mannwhitneyu

    one, other = _sample(first), _sample(second)
    if np.ptp(np.concatenate([one, other])) == 0:
        return Contrast(1.0, 0.5)
    found = mannwhitneyu(one, other, alternative="two-sided", method="auto")
    return Contrast(float(found.pvalue), float(found.statistic) / (one.size * other.size))


def holm(ps: Sequence[float]) -> list[float]:
    """Correct p-values for how many tests there were (Holm 1979); the order is kept."""
    order = sorted(range(len(ps)), key=lambda index: ps[index])
    corrected, least = [0.0] * len(ps), 0.0
    for rank, index in enumerate(order):
        least = max(least, min(1.0, ps[index] * (len(ps) - rank)))
        corrected[index] = least
    return corrected


def two_clusters(values: Values) -> Clusters | None:
    """Cut a sample in two so that the variance within the parts is least; None if all values are the same."""
    sample = np.sort(np.asarray(values, dtype=float))
    if sample.size < 2 or sample[0] == sample[-1]:
        return None
    cuts = np.flatnonzero(np.diff(sample)) + 1
    within = [sample[:cut].var() * cut + sample[cut:].var() * (sample.size - cut) for cut in cuts]
    best = int(np.argmin(within))
    low, high = sample[: cuts[best]], sample[cuts[best] :]
    spread, apart = math.sqrt((low.var() + high.var()) / 2), float(high.mean() - low.mean())
    return Clusters(
        (float(low[-1]) + float(high[0])) / 2,
        float(low.mean()),
        float(high.mean()),
        low.size / sample.size,
        apart / spread if spread else math.inf,
    )


def _sample(values: Values) -> Array:
    sample = np.asarray(values, dtype=float)
    if not sample.size:
        raise ValueError("a sample needs one value or more")
    return sample


def _normal(estimate: float, variance: float) -> Interval:
    """Return an estimate with the interval of one that is normally distributed, with this variance."""
    off = NormalDist().inv_cdf((1 + LEVEL) / 2) * math.sqrt(variance)
    return Interval(estimate, estimate - off, estimate + off)


def _percentiles(sample: Array, rng: Generator, statistic: Callable[[Array], Array]) -> tuple[float, float]:
    """Return the ends of the interval of a statistic, which maps resamples (k, n) to estimates (k,)."""
    at_once = max(1, MOST_DRAWN // sample.size)
    counts = [min(at_once, DRAWS - start) for start in range(0, DRAWS, at_once)]
    estimates = [statistic(sample[rng.integers(sample.size, size=(count, sample.size))]) for count in counts]
    low, high = np.percentile(np.concatenate(estimates), [50 * (1 - LEVEL), 50 * (1 + LEVEL)])
    return float(low), float(high)
