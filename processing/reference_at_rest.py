"""What a reference spot would take off, from a short piece of a pendulum at rest."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.estimate import Estimate
from processing.reference_beam import common_motion, fitted_gain
from processing.ticks import seconds

_KNOT_PERIODS = 3.0
"""In so many periods the swing of a pendulum at rest changes its amplitude little."""
_BLOCKS = 10


class ReferenceAtRest(NamedTuple):
    """Of one axis of the sensor, the swing of the pendulum left out.

    Attributes
    ----------
    before_px
        Standard deviation of the pendulum's spot.
    factor
        By which it falls with the reference taken off at the stated gain, or at that of the piece;
        uncertainty by parts of the piece.
    gain
        That the piece itself shows.
    share
        Part of the reference's variance that is motion, and not its own noise.
    """

    before_px: float
    factor: Estimate
    gain: Estimate
    share: float


def reference_at_rest(
    times_ns: Ints,
    spot_px: Floats,
    u_spot_px: Floats,
    reference_px: Floats,
    u_px: Floats,
    *,
    gain: float | None,
    period_s: float,
) -> ReferenceAtRest:
    """Compare the spots of a pendulum at rest and of its reference (n,), NaN where lost.

    Raises DataError for too few frames with both.
    """
    common = common_motion(times_ns, reference_px, u_px)
    use = common.known & np.isfinite(spot_px) & np.isfinite(u_spot_px)
    time_s = seconds(times_ns - times_ns[0])
    cleaned = (
        _without_swing(time_s[use], np.column_stack([spot_px[use], common.value[use]]), period_s)
        if np.any(use)
        else np.empty((0, 2))
    )
    spot, motion = np.full(len(use), np.nan), np.zeros(len(use))
    spot[use], motion[use] = cleaned.T
    if not common.share > 0:
        return ReferenceAtRest(float(np.nanstd(spot)), Estimate(1.0, 0.0), Estimate(np.nan, np.inf), 0.0)
    fitted = fitted_gain(spot, u_spot_px, replace(common, value=motion), use)
    left = spot[use] - (fitted.value if gain is None else gain) * motion[use]
    parts = np.array_split(np.arange(len(left)), _BLOCKS)
    powers = np.array([[np.mean(spot[use][part] ** 2), np.mean(left[part] ** 2)] for part in parts])
    factor = _ratio(powers)
    without = np.array([_ratio(np.delete(powers, k, axis=0)) for k in range(_BLOCKS)])
    u = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((without - without.mean()) ** 2)))
    return ReferenceAtRest(float(np.std(spot[use])), Estimate(factor, u), fitted, common.share)


def _ratio(powers: Floats) -> float:
    before, after = powers.mean(axis=0)
    return float(np.sqrt(before / after))


def _without_swing(time_s: Floats, values: Floats, period_s: float) -> Floats:
    """(n, series) less their means and an oscillation of the pendulum's period whose amplitude wanders."""
    knots = np.arange(0.0, time_s[-1] + _KNOT_PERIODS * period_s, _KNOT_PERIODS * period_s)
    hats = np.maximum(1 - np.abs(time_s[:, None] - knots) / (_KNOT_PERIODS * period_s), 0.0)
    phase = 2 * np.pi * time_s[:, None] / period_s
    columns = np.column_stack([np.ones_like(time_s), hats * np.cos(phase), hats * np.sin(phase)])
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])
