"""Where positions tear off from those around them, as no swing does: damage of a picture, or a push."""

from typing import Final

import numpy as np

from processing.arrays import Floats

_BESIDE: Final = 3
"""Neighbours on each side that foretell a position."""
_AROUND: Final = 100
"""Neighbours on each side that say how well they foretell it."""
_USUAL: Final = 0.95
"""Part of them that is taken for usual: compression, which stores nothing where little moves, has tails."""
_TORN: Final = 4.0
"""Times the usual: of noise alone nearly eight standard deviations."""
_LEAST_PX: Final = 0.1
"""A tear that matters nowhere."""


def torn_positions(time_s: Floats, positions: Floats) -> list[int]:
    """First indices of stretches at which one of the coordinates (n, m), in px, tears off.

    Each position is foretold by a cubic through three neighbours on each side. How far off that usually is
    (noise, and what a cubic lacks of a swing) is told by a hundred on each side. Where a neighbour
    is lost nothing is said.
    """
    count = len(time_s)
    if count < 4 * _BESIDE:
        return []
    middle = np.arange(_BESIDE, count - _BESIDE)
    beside = middle[:, None] + np.array([k for k in range(-_BESIDE, _BESIDE + 1) if k])
    since = time_s[beside] - time_s[middle][:, None]
    since /= np.abs(since).max(axis=1, keepdims=True)
    weights = np.linalg.pinv(since[:, :, None] ** np.arange(4))[:, 0, :]
    torn = np.zeros(count, dtype=bool)
    for column in positions.T:
        off = np.abs(column[middle] - np.sum(weights * column[beside], axis=1))
        padded = np.pad(off, _AROUND, constant_values=np.nan)
        around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1)
        known = np.isfinite(off)
        if not known.any():
            continue
        usual = np.full(len(off), np.nan)
        usual[known] = np.nanquantile(around[known], _USUAL, axis=1)
        with np.errstate(invalid="ignore"):
            torn[middle] |= off > np.maximum(_TORN * usual, _LEAST_PX)
    places = np.flatnonzero(torn)
    # one tear is felt by its neighbours' forecasts
    return [int(one) for k, one in enumerate(places) if k == 0 or one > places[k - 1] + 2 * _BESIDE]
