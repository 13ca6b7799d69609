"""The direction of a swing in two positions, and whether it stays that."""

from math import atan2, cos, degrees, pi

import numpy as np
from numpy.typing import NDArray

from processing.errors import DataError

Array = NDArray[np.float64]
_FAR = 5.0
"""Distances from rest, in the median one, beyond which a position counts by its direction alone."""
_ROUNDS = 3
_DEGREE = 3
"""Of the drift of the rest position in time that is taken off."""
_SHORTENED = 1e-3
"""Of the amplitude, from which on another direction is said."""
_CLEARLY = 5.0
"""Standard uncertainties of a direction."""


def along_and_across(positions: tuple[Array, ...]) -> tuple[Array, Array]:
    """Positions (n,) along the motion and across it; a single one unchanged, and NaN.

    Raises DataError if there is no sample with both positions.
    """
    if len(positions) == 1:
        return positions[0], np.full(len(positions[0]), np.nan)
    both = np.column_stack(positions)
    good = np.isfinite(both).all(axis=1)
    if not good.any():
        raise DataError("no row of the table has both positions; name other columns with --position")
    centred = both - both[good].mean(axis=0)
    along, across = _directions(both[good])[0]
    return centred @ along, centred @ across


def direction_warning(positions: tuple[Array, ...], inside: NDArray[np.bool_]) -> str:
    """What is to be said of the direction in which the samples `inside` one decay swing; empty: nothing.

    Those of their first and of their last third are compared with that of all positions, along which
    amplitudes are measured.
    """
    both = np.column_stack(positions)
    good = np.isfinite(both).all(axis=1)
    third = np.count_nonzero(good & inside) // 3
    if both.shape[1] < 2 or third < 2 * _DEGREE:
        return ""
    used, _ = _angle(both[good])
    of_decay = both[good & inside]
    off = []
    for part in (of_decay[:third], of_decay[-third:]):
        angle, u = _angle(part)
        # a direction is defined modulo pi
        away = (angle - used + 0.5 * pi) % pi - 0.5 * pi
        off.append(away if abs(away) > _CLEARLY * u else 0.0)
    shortened = 1.0 - cos(max(map(abs, off)))
    if shortened < _SHORTENED:
        return ""
    first, last = (f"{degrees(one):.2g}".replace("-", "−") for one in off)
    return (
        f"the swing deviates from the direction in which amplitudes are measured by {first} degrees in the "
        f"first third of this decay and {last} degrees in the last: amplitudes are too small by up to "
        f"{100 * shortened:.1g} %. This biases decrement, damping and all parameters, and no uncertainty "
        "includes it. Fit a shorter stretch (--from, --to)"
    )


def _angle(both: Array) -> tuple[float, float]:
    """Direction of the motion and its standard uncertainty by the scatter across it, rad."""
    (along, _), sizes = _directions(both)
    return atan2(along[0], along[1]), float(sizes[1] / sizes[0]) / len(both) ** 0.5


def _directions(both: Array) -> tuple[Array, Array]:
    """Unit vectors along and across the motion (n, 2), and the root mean squares in them.

    A filter of time leaves the direction of a swing as it is; a drift of the rest position goes. A value that
    stands for none, or a wrong one, is far from the rest, and counts as one sample.
    """
    time = np.linspace(-1.0, 1.0, len(both))
    trend = np.polynomial.legendre.legvander(time, min(_DEGREE, max(len(both) // 8, 0)))
    middle, weights = np.median(both, axis=0), np.ones(len(both))
    moved = both - middle
    for _ in range(_ROUNDS):
        distance = np.hypot(*moved.T)
        usual = float(np.median(distance)) or 1.0
        weights = np.minimum(1.0, _FAR * usual / np.maximum(distance, 1e-300))
        fit, *_ = np.linalg.lstsq(weights[:, None] * trend, weights[:, None] * (both - middle), rcond=None)
        moved = both - middle - trend @ fit
    _, sizes, axes = np.linalg.svd(weights[:, None] * moved, full_matrices=False)
    return axes, sizes / len(both) ** 0.5
