"""Robust estimate of the scatter of values with outliers."""

import numpy as np

from processing.arrays import Floats

MAD_TO_SIGMA = 1.482602218505602
"""Ratio of standard deviation to median absolute deviation of a normal distribution, 1 / 0.67449."""


def robust_scatter(values: Floats, middle: float | None = None) -> float:
    """Standard deviation of `values`, of any shape, from the median absolute deviation about `middle`.

    By default `middle` is the median. Nearly half of the values may be outliers. NaN and infinite values are
    ignored; the result is 0 if no others are left.
    """
    good = values[np.isfinite(values)]
    if len(good) == 0:
        return 0.0
    return MAD_TO_SIGMA * float(np.median(np.abs(good - (np.median(good) if middle is None else middle))))
