"""What a handful of seeds says: medians, means with Student's interval, and one-sided paired tests.

A few trainings are a small sample: the factor of a 95 % interval of five of them is 2.776, not the 1.96 of many. One
training has no interval at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Summary:
    """A sample in a few numbers.

    Attributes
    ----------
    count : int
    median, mean : float
        Minus infinity where a value of the sample is (the mean), or half of them are (the median).
    half_width : float or None
        Of the 95 % interval of the mean, ``t(0.975, count - 1) s / sqrt(count)``; None for one value, and where a
        value is infinite.
    """

    count: int
    median: float
    mean: float
    half_width: float | None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Ends of the 95 % interval of the mean."""
        return None if self.half_width is None else (self.mean - self.half_width, self.mean + self.half_width)


@dataclass(frozen=True)
class PairedTest:
    """Whether the first of two trainings is better, seed by seed.

    Attributes
    ----------
    higher, lower, equal : int
        Seeds on which the first one is.
    median_difference : float
        First minus second.
    wilcoxon, sign : float
        p values of "the first one is not better": the signed-rank test, exact with ties, and the sign test. Seeds on
        which both are equal take no part; without any other both are 1.
    """

    higher: int
    lower: int
    equal: int
    median_difference: float
    wilcoxon: float
    sign: float


def summary(sample: Sequence[float] | Array) -> Summary:
    """Median, mean and Student's 95 % interval.

    Parameters
    ----------
    sample : sequence of float
        At least one; not NaN.

    Returns
    -------
    Summary
    """
    from scipy.stats import t

    values = np.asarray(sample, dtype=np.float64)
    if values.size == 0 or np.isnan(values).any():
        raise ValueError(f"a sample of numbers is required, received {values.tolist()}")
    half_width = None
    if values.size > 1 and np.isfinite(values).all():
        factor = float(t.ppf(0.5 + CONFIDENCE / 2.0, values.size - 1))
        half_width = factor * float(values.std(ddof=1)) / float(np.sqrt(values.size))
    return Summary(values.size, float(np.median(values)), float(values.mean()), half_width)


def paired_test(first: Sequence[float] | Array, second: Sequence[float] | Array) -> PairedTest:
    """Test whether the first is higher than the second, pair by pair.

    Parameters
    ----------
    first, second : sequence of float
        One value per seed, in the same order. Minus infinity on both sides is equal.

    Returns
    -------
    PairedTest
    """
    from scipy.stats import binomtest

    one, two = (np.asarray(values, dtype=np.float64) for values in (first, second))
    if one.shape != two.shape or one.ndim != 1 or one.size == 0:
        raise ValueError(f"as many values on both sides are required, received {one.shape} and {two.shape}")
    with np.errstate(invalid="ignore"):
        differences = np.where(one == two, 0.0, one - two)
    higher, lower = int((differences > 0.0).sum()), int((differences < 0.0).sum())
    sign = float(binomtest(higher, higher + lower, alternative="greater").pvalue) if higher + lower else 1.0
    return PairedTest(
        higher,
        lower,
        int((differences == 0.0).sum()),
        float(np.median(differences)),
        _signed_rank(differences[differences != 0.0]),
        sign,
    )


def _signed_rank(differences: Array) -> float:
    """p value ``P(W >= w)`` of the signed-rank statistic, by counting all 2^n patterns of signs."""
    from scipy.stats import rankdata

    ranks = np.rint(2.0 * rankdata(np.abs(differences))).astype(int)  # ties share a rank, which may be a half
    counts = np.zeros(int(ranks.sum()) + 1)
    counts[0] = 1.0
    for rank in ranks.tolist():
        shifted = np.zeros_like(counts)
        shifted[rank:] = counts[: counts.size - rank]
        counts = 0.5 * (counts + shifted)
    return float(min(1.0, counts[int(ranks[differences > 0.0].sum()) :].sum()))
