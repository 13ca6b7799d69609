"""Herbert's hardness numbers, from the first swings of a record."""

import math
from typing import NamedTuple

import numpy as np

from processing.errors import DataError
from processing.estimate import Estimate
from processing.swing import TurningPoints


class HerbertHardness(NamedTuple):
    """Time of ten single swings, ten times that of the first one, and the scale reading after the first.

    A single swing is the motion from one turning point to the next. `ten_swings_s` is None if the record
    contains fewer than ten in a row; `missing` states this.
    """

    ten_swings_s: Estimate | None
    first_swing_times_ten_s: Estimate
    scale_hardness: Estimate
    first_amplitude_rad: float
    missing: str


def herbert_hardness(points: TurningPoints, divisions: float = 100.0) -> HerbertHardness:
    """Hardness numbers from the first swings that were recorded completely.

    Parameters
    ----------
    divisions
        Number of scale divisions between the angle of release and the same angle on the other side, the
        reading after a swing without loss. The scale's zero is the turning point at which the first swing
        starts.

    Raises
    ------
    DataError
        No two successive turning points at the beginning.
    """
    if len(points) < 2 or points.index[1] - points.index[0] != 1:
        raise DataError("the first swing was not seen whole: two successive turning points are needed")
    swing = _since_the_first(points, 1)
    kept = float(points.amplitude[1] / points.amplitude[0])
    u_kept = kept * math.hypot(
        points.u_amplitude[0] / points.amplitude[0],
        points.u_amplitude[1] / points.amplitude[1],
    )
    tenth = np.nonzero(points.index == points.index[0] + 10)[0]
    ten, missing = None, ""
    if len(tenth):
        ten = _since_the_first(points, int(tenth[0]))
    else:
        seen = int(points.index[-1] - points.index[0])
        missing = f"no time of ten single swings: the record holds {seen}, or the tenth is disturbed"
    return HerbertHardness(
        ten,
        Estimate(10 * swing.value, 10 * swing.standard_uncertainty),
        Estimate(0.5 * divisions * (1 + kept), 0.5 * divisions * u_kept),
        float(points.amplitude[0]),
        missing,
    )


def _since_the_first(points: TurningPoints, last: int) -> Estimate:
    lasts_s = float(points.time_s[last] - points.time_s[0])
    return Estimate(lasts_s, math.hypot(points.u_time_s[0], points.u_time_s[last]))
