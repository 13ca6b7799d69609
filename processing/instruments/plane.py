"""Plane of swing of a pendulum on a single point: its direction, its rotation, and the deflection in it."""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.ticks import seconds

_FEWEST = 3  # a line for the rotation, and one degree of freedom for its scatter


class PlaneRotation(NamedTuple):
    """Angle of the plane from the slow axis Y towards X, period by period.

    `rate_rad_per_s` is the slope of a straight line, with the uncertainty from the scatter about it.
    `turned_rad` is the rotation from the first to the last period. `width_ratio` is the largest ratio of
    minor to major axis of the ellipse.
    """

    time_s: Floats
    direction_rad: Floats
    rate_rad_per_s: Estimate
    turned_rad: Estimate
    width_ratio: float


def swing_plane(times_ns: Ints, x_rad: Floats, y_rad: Floats, period_s: float) -> PlaneRotation:
    """Principal direction of (X, Y), period by period.

    Parameters
    ----------
    times_ns, x_rad, y_rad
        (n,) samples; NaN where the spot was lost. A period with more than a tenth of its samples missing is
        left out.
    period_s
        Period of the swing.

    Raises
    ------
    DataError
        Fewer than three whole periods.
    """
    time_s = seconds(times_ns - times_ns[0])
    number = np.floor(time_s / period_s).astype(np.int64)
    seen = np.isfinite(x_rad) & np.isfinite(y_rad)
    usual = float(np.median(np.bincount(number)[:-1])) if number[-1] else 0.0
    middles, directions, widths = [], [], []
    for k in range(int(number[-1])):
        rows = np.nonzero(seen & (number == k))[0]
        if len(rows) < max(8.0, 0.9 * usual):
            continue
        both = np.column_stack([x_rad[rows], y_rad[rows]])
        both -= both.mean(axis=0)
        _, sizes, axes = np.linalg.svd(both, full_matrices=False)
        # The direction is determined mainly by samples with a large deflection. Their mean time varies
        # relative to the period, because `period_s` is not exact.
        middles.append(float(np.average(time_s[rows], weights=np.sum(both**2, axis=1))))
        directions.append(math.atan2(axes[0, 0], axes[0, 1]))
        widths.append(float(sizes[1] / sizes[0]))
    if len(middles) < _FEWEST:
        raise DataError(
            f"{len(middles)} whole periods with both axes; at least {_FEWEST} are needed for the swing plane"
        )
    at = np.array(middles)
    # the direction of a plane is defined modulo pi
    direction = 0.5 * np.unwrap(2 * np.array(directions))
    direction -= math.pi * round(direction[0] / math.pi)
    centred = at - at.mean()
    spread = float(centred @ centred)
    rate = float(centred @ direction) / spread
    residual = direction - direction.mean() - rate * centred
    u_rate = math.sqrt(float(residual @ residual) / (len(at) - 2) / spread)
    length_s = float(at[-1] - at[0])
    return PlaneRotation(
        at,
        direction,
        Estimate(rate, u_rate),
        Estimate(rate * length_s, u_rate * length_s),
        max(widths),
    )


def along_plane(
    plane: PlaneRotation, times_ns: Ints, x_rad: Floats, y_rad: Floats, u_x_rad: Floats, u_y_rad: Floats
) -> tuple[Floats, Floats]:
    """Deflection in the rotating plane and its standard uncertainty in rad, from those along both axes.

    All arrays are (n,); NaN where the spot was lost. The direction of the plane is given by the straight line
    fitted to the directions of the periods.
    """
    time_s = seconds(times_ns - times_ns[0])
    middle = float(plane.time_s.mean())
    angle = float(plane.direction_rad.mean()) + plane.rate_rad_per_s.value * (time_s - middle)
    sine, cosine = np.sin(angle), np.cos(angle)
    return x_rad * sine + y_rad * cosine, np.hypot(u_x_rad * sine, u_y_rad * cosine)
