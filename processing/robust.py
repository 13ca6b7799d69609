"""Scatter of values among which a few are wild."""

import numpy as np
from numpy.typing import NDArray

MAD_TO_SIGMA = 1.482602218505602
"""Standard deviation of a normal distribution over its median absolute deviation, 1 / 0.67449."""


def robust_scatter(values: NDArray[np.float64], middle: float | None = None) -> float:
    """Standard deviation from the median absolute deviation about `middle`, by default the median.

    Up to half of the values may be wild without doing more than moderate harm. NaN and infinite values
    do not count; 0 where no others are left.
    """
    good = values[np.isfinite(values)]
    if len(good) == 0:
        return 0.0
    return MAD_TO_SIGMA * float(np.median(np.abs(good - (np.median(good) if middle is None else middle))))
