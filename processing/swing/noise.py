"""Estimate of the noise of a record whose samples have no uncertainties."""

import numpy as np
from numpy.typing import ArrayLike

from processing.errors import DataError
from processing.robust import robust_scatter
from processing.ticks import seconds

_ORDER = 5
"""Order of the differences; of a sinusoid sampled 20 times per period they leave less than 1e-3."""


def estimate_noise(times_ns: ArrayLike, deflection: ArrayLike) -> float:
    """Standard uncertainty of a sample, estimated from the part that no smooth motion explains.

    It is the median of the absolute fifth differences, scaled for Gaussian noise. Divided differences are
    used, so that uneven spacing and missing frames do not matter. Slow disturbances do not contribute;
    `SwingDetector` finds them in its residuals. If the values are rounded so coarsely that most
    differences vanish, the result is the uncertainty of rounding, step / sqrt(12).

    Parameters
    ----------
    times_ns : (n,) int64, ns, ascending
    deflection : (n,) any unit, which is also that of the result; NaN where the spot was lost

    Raises
    ------
    DataError
        Lengths differ, there are fewer than seven samples with different times, or all values are equal.
    """
    times = np.asarray(times_ns, dtype=np.int64)
    values = np.asarray(deflection, dtype=np.float64)
    if times.shape != values.shape or times.ndim != 1:
        raise DataError(f"times and deflections must be of one length: got {times.shape} and {values.shape}")
    good = np.isfinite(values)
    times, values = times[good], values[good]
    fresh = np.append(True, np.diff(times) > 0) if len(times) else good[:0]
    times, values = times[fresh], values[fresh]
    if len(values) < _ORDER + 2:
        raise DataError(
            f"{len(values)} samples with a deflection and times of their own are too few to estimate noise: "
            f"at least {_ORDER + 2} are needed"
        )
    steps = np.abs(np.diff(values))
    if not np.any(steps > 0):
        raise DataError(
            f"all {len(values)} samples are {values[0]:g}: nothing moves, and there is no noise either"
        )
    rounding = float(steps[steps > 0].min()) / np.sqrt(12.0)
    windows = np.lib.stride_tricks.sliding_window_view
    t = windows(seconds(times - times[0]), _ORDER + 1)
    y = windows(values, _ORDER + 1)
    apart = t[:, :, None] - t[:, None, :] + np.eye(_ORDER + 1)
    weights = 1.0 / (apart / np.abs(apart).max(axis=(1, 2), keepdims=True)).prod(axis=2)
    left = (weights * y).sum(axis=1) / np.sqrt((weights**2).sum(axis=1))
    noise = robust_scatter(left, middle=0.0)
    return max(noise, float(rounding))
