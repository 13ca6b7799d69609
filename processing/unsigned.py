"""Test for deflections without a sign."""

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.units import seconds

_FEWEST_CYCLES: Final = 8
"""Fewest cycles, and fewest samples per cycle, from which a shape is judged."""
_MOST_CYCLES: Final = 16
_PHASES: Final = np.arange(72) / 72
"""Phases of a cycle that are tried, in periods."""
_LARGEST_SQUARES_RATIO: Final = 0.2
"""Largest ratio of the squares that a rectified sinusoid and a sinusoid leave, if the first fits better."""
_LARGEST_SCATTER: Final = 0.04
"""Largest scatter about the rectified shape, relative to the range of a cycle."""
_MAX_ZERO_VALUE: Final = 0.1
"""Values, relative to the largest, that count as zero because of the sampling."""
_MAX_RANGE_RATIO: Final = 0.75
"""Largest ratio of last to first range that counts as a decay."""
_LARGEST_MOVE: Final = 0.1
"""Largest move of constant turning points, relative to the fall of the other side."""
_LARGEST_ZERO_FRACTION: Final = 0.35
"""Largest fraction of samples near zero; a sensor that is blind for one side of the motion has half."""


def unsigned_period_s(times_ns: NDArray[np.int64], values: NDArray[np.float64]) -> float:
    """Period of an oscillation x if the values are |x|, x² or another even function of x; otherwise NaN.

    |x| has cusps at zero. In an even function the turning points of one side stay, the others approach them.
    """
    good = np.isfinite(values)
    times_s, values = seconds(times_ns[good]), values[good]
    if len(values) < _FEWEST_CYCLES**2:
        return np.nan
    times_s = times_s - times_s[0]
    even_s = np.linspace(0.0, times_s[-1], len(times_s))
    steps = np.diff(np.interp(even_s, times_s, values))
    spectrum = np.abs(np.fft.rfft(steps * np.hanning(len(steps))))
    at = int(np.argmax(spectrum[1:-1])) + 1
    before, here, after = spectrum[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    cycles = at + (0.5 * (before - after) / bend if bend else 0.0)
    if not _FEWEST_CYCLES <= cycles <= len(values) / _FEWEST_CYCLES:
        return np.nan
    period_s = float(times_s[-1] / cycles)
    edges = np.searchsorted(times_s, period_s * np.arange(int(cycles) + 1))
    parts = [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a >= _FEWEST_CYCLES]
    if len(parts) < _FEWEST_CYCLES:
        return np.nan
    each = [values[part] for part in parts]
    is_unsigned = (
        _returns_to_zero(each)
        or _one_side_is_constant(each)
        or _has_cusps([(times_s[part] / period_s, values[part]) for part in parts])
    )
    return 2.0 * period_s if is_unsigned else np.nan


def _returns_to_zero(parts: list[NDArray[np.float64]]) -> bool:
    """Whether the values of a decay return to zero in every cycle and never cross it."""
    ends = np.array([(part.min(), part.max()) for part in parts])
    if np.abs(ends[:, 0]).max() > np.abs(ends[:, 1]).max():
        ends = -ends[:, ::-1]
    third = len(ends) // 3
    (first_low, first), (last_low, last) = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    stands = (
        abs(first_low) < _MAX_ZERO_VALUE * first
        and abs(last_low) < _MAX_ZERO_VALUE * last
        and 0 < last < _MAX_RANGE_RATIO * first
    )
    at_zero = np.mean(
        [np.mean(np.abs(part) < _MAX_ZERO_VALUE * np.abs(part).max()) for part in parts[:third]]
    )
    return bool(stands and at_zero < _LARGEST_ZERO_FRACTION)


def _one_side_is_constant(parts: list[NDArray[np.float64]]) -> bool:
    """Whether the turning points of one side are constant while those of the other approach them.

    This is so for the cosine of an angle, a distance to a point beside the swing, and light behind a slit.
    """
    ends = np.array([(part.min(), part.max()) for part in parts])
    third = len(ends) // 3
    first, last = np.median(ends[:third], axis=0), np.median(ends[-third:], axis=0)
    span, fell = np.ptp(first), np.ptp(first) - np.ptp(last)
    if not fell > (1.0 - _MAX_RANGE_RATIO) * span:
        return False
    moved = np.abs(last - first)
    side = int(np.argmin(moved))
    near = np.mean([np.mean(np.abs(part - first[side]) < _MAX_ZERO_VALUE * span) for part in parts[:third]])
    return bool(moved[side] < _LARGEST_MOVE * fell and near < _LARGEST_ZERO_FRACTION)


def _has_cusps(parts: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> bool:
    """Whether a rectified sinusoid fits the cycles (times in periods, values) better than a sinusoid."""
    largest = sorted(parts, key=lambda part: -float(np.ptp(part[1])))[:_MOST_CYCLES]
    left = np.array(
        [
            [_mean_square(cycles, values, shape) / np.ptp(values) ** 2 for shape in (_rectify, _sinusoid)]
            for cycles, values in largest
            if np.ptp(values) > 0
        ]
    )
    if len(left) < _FEWEST_CYCLES:
        return False
    rectified, sinusoid = np.median(left, axis=0)
    return bool(rectified < min(_LARGEST_SQUARES_RATIO * sinusoid, _LARGEST_SCATTER**2))


def _rectify(cycles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.abs(np.sin(np.pi * cycles))


def _sinusoid(cycles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.cos(2.0 * np.pi * cycles)


def _mean_square(
    cycles: NDArray[np.float64], values: NDArray[np.float64], shape: Callable[..., NDArray[np.float64]]
) -> float:
    """Mean square residual from a shape at its best phase, with a straight line added to it."""
    columns = np.stack(
        [
            np.broadcast_to(column, (len(_PHASES), len(cycles)))
            for column in (1.0, cycles - cycles[0], shape(cycles - _PHASES[:, None]))
        ],
        axis=-1,
    )
    rest = values - (columns @ (np.linalg.pinv(columns) @ values)[..., None])[..., 0]
    return float(np.min(np.mean(rest**2, axis=-1)))
