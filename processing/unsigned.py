"""Test for deflections without a sign."""

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np

from processing.arrays import Floats, Ints
from processing.units import seconds

_MIN_CYCLES: Final = 8
"""Smallest number of cycles, and of samples per cycle, from which a shape is judged."""
_MAX_FITTED_CYCLES: Final = 16
_PHASES: Final = np.arange(72) / 72
"""Phases of a cycle that are tried, in periods."""
_MAX_RESIDUAL_RATIO: Final = 0.2
"""Largest ratio of the squared residuals from a rectified sinusoid and from a sinusoid, if the first fits."""
_MAX_SCATTER: Final = 0.04
"""Largest scatter about the rectified shape, relative to the range of a cycle."""
_MAX_ZERO_VALUE: Final = 0.1
"""Values, relative to the largest, that count as zero because of the sampling."""
_MAX_RANGE_RATIO: Final = 0.75
"""Largest ratio of last to first range that counts as a decay."""
_MAX_CHANGE: Final = 0.1
"""Largest change of constant turning points, relative to the fall of the other side."""
_MAX_ZERO_FRACTION: Final = 0.35
"""Largest fraction of samples near zero; a sensor that is blind for one side of the motion has half."""


def unsigned_period_s(times_ns: Ints, values: Floats) -> float:
    """Period of an oscillation x if the values are |x|, x² or another even function of x; otherwise NaN.

    |x| has cusps at zero. In an even function the turning points of one side stay, the others approach them.
    """
    good = np.isfinite(values)
    times_s, values = seconds(times_ns[good]), values[good]
    if len(values) < _MIN_CYCLES**2:
        return np.nan
    times_s = times_s - times_s[0]
    even_s = np.linspace(0.0, times_s[-1], len(times_s))
    steps = np.diff(np.interp(even_s, times_s, values))
    spectrum = np.abs(np.fft.rfft(steps * np.hanning(len(steps))))
    peak = int(np.argmax(spectrum[1:-1])) + 1
    left, middle, right = spectrum[peak - 1 : peak + 2]
    curvature = left - 2.0 * middle + right
    cycles = peak + (0.5 * (left - right) / curvature if curvature else 0.0)
    if not _MIN_CYCLES <= cycles <= len(values) / _MIN_CYCLES:
        return np.nan
    period_s = float(times_s[-1] / cycles)
    edges = np.searchsorted(times_s, period_s * np.arange(int(cycles) + 1))
    slices = [slice(begin, end) for begin, end in pairwise(edges.tolist()) if end - begin >= _MIN_CYCLES]
    if len(slices) < _MIN_CYCLES:
        return np.nan
    cycle_values = [values[part] for part in slices]
    is_unsigned = (
        _returns_to_zero(cycle_values)
        or _one_side_is_constant(cycle_values)
        or _has_cusps([(times_s[part] / period_s, values[part]) for part in slices])
    )
    return 2.0 * period_s if is_unsigned else np.nan


def _returns_to_zero(cycles: list[Floats]) -> bool:
    """Whether the values of a decay return to zero in every cycle and never cross it."""
    ends = np.array([(values.min(), values.max()) for values in cycles])
    if np.abs(ends[:, 0]).max() > np.abs(ends[:, 1]).max():
        ends = -ends[:, ::-1]
    third = len(ends) // 3
    (first_low, first), (last_low, last) = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    low_is_zero = abs(first_low) < _MAX_ZERO_VALUE * first and abs(last_low) < _MAX_ZERO_VALUE * last
    zero_fraction = np.mean(
        [np.mean(np.abs(values) < _MAX_ZERO_VALUE * np.abs(values).max()) for values in cycles[:third]]
    )
    decays = 0 < last < _MAX_RANGE_RATIO * first
    return bool(low_is_zero and decays and zero_fraction < _MAX_ZERO_FRACTION)


def _one_side_is_constant(cycles: list[Floats]) -> bool:
    """Whether the turning points of one side stay while the others approach them, as with the cosine of an
    angle, a distance to a point outside the swing, and light behind a slit."""
    ends = np.array([(values.min(), values.max()) for values in cycles])
    third = len(ends) // 3
    first, last = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    span, fall = np.ptp(first), np.ptp(first) - np.ptp(last)
    if not fall > (1.0 - _MAX_RANGE_RATIO) * span:
        return False
    changes = np.abs(last - first)
    side = int(np.argmin(changes))
    near_fraction = np.mean(
        [np.mean(np.abs(values - first[side]) < _MAX_ZERO_VALUE * span) for values in cycles[:third]]
    )
    return bool(changes[side] < _MAX_CHANGE * fall and near_fraction < _MAX_ZERO_FRACTION)


def _has_cusps(cycles: list[tuple[Floats, Floats]]) -> bool:
    """Whether a rectified sinusoid fits the cycles (times in periods, values) better than a sinusoid."""
    shapes = (lambda periods: np.abs(np.sin(np.pi * periods)), lambda periods: np.cos(2.0 * np.pi * periods))
    largest = sorted(cycles, key=lambda cycle: -float(np.ptp(cycle[1])))[:_MAX_FITTED_CYCLES]
    residuals = np.array(
        [
            [_mean_square(periods, values, shape) / np.ptp(values) ** 2 for shape in shapes]
            for periods, values in largest
            if np.ptp(values) > 0
        ]
    )
    if len(residuals) < _MIN_CYCLES:
        return False
    rectified, sinusoid = np.median(residuals, axis=0)
    return bool(rectified < min(_MAX_RESIDUAL_RATIO * sinusoid, _MAX_SCATTER**2))


def _mean_square(periods: Floats, values: Floats, shape: Callable[[Floats], Floats]) -> float:
    """Mean square residual from a shape at its best phase, with a straight line added to it."""
    columns = np.stack(
        [
            np.broadcast_to(column, (len(_PHASES), len(periods)))
            for column in (1.0, periods - periods[0], shape(periods - _PHASES[:, None]))
        ],
        axis=-1,
    )
    residuals = values - (columns @ (np.linalg.pinv(columns) @ values)[..., None])[..., 0]
    return float(np.min(np.mean(residuals**2, axis=-1)))
