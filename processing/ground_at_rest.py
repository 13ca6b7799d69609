"""How strongly the ground drives a pendulum at rest: from the wander of what is left of its swing."""

from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.estimate import Estimate
from processing.fit import GROUND_SEEN, density_of_step
from processing.swing_at_rest import quadratures_of, swing_at_rest, without_decay

_ONE_SIGMA, _ONE_SIDED = 1.0, 2.706
"""Rises of -2 ln L: a standard uncertainty, and a bound of 95 %."""
_SWINGING = 5.0
"""Smallest mean square of the oscillation, in that of its reading, that is not taken for reading."""
_KNOWN_TO = 0.5
"""Uncertainty of ln(variance of the reading), which neighbouring samples show; slow air has more."""
_GRID = 10.0 ** np.arange(-6.0, 2.01, 0.05)


class GroundAtRest(NamedTuple):
    """Density q of the drive in rad/s^2/sqrt(Hz) (or the deflections' unit), bound of 95 %, period."""

    density: Estimate
    upper_95: float
    period_s: float


def ground_at_rest(time_s: Floats, deflection: Floats) -> GroundAtRest:
    """The drive from the deflections of a free pendulum at rest along its slow mode.

    The oscillation that the ground keeps up wanders in both quadratures. It is fitted again in every period;
    the steps from period to period have the variance of the drive and that of the reading, which neighbouring
    steps share with opposite signs: their likelihood tells the two apart.

    Parameters
    ----------
    time_s, deflection
        (n,) even but for gaps; NaN where there is no spot.

    Raises
    ------
    DataError
        Less than eight periods, or too few samples in one.

    Notes
    -----
    For fits over whole periods T of a random walk with variance S a period, neighbouring differences have the
    covariance ``2 S/3 + 2 r, S/6 - r, 0, ...``, r the variance of the reading. Sines diagonalise it.
    """
    from scipy.fft import dst

    rest = swing_at_rest(time_s, deflection)
    period_s, periods = rest.period_s, rest.periods
    turning, expected = quadratures_of(rest, rest.deflection[:, None])
    steps = without_decay(turning[:, 0])
    power = np.sum(dst(steps, type=1, axis=0, norm="ortho") ** 2, axis=1)
    turn = np.cos(np.pi * np.arange(1, periods) / periods)
    unit = float(np.mean(power)) / 2
    drive, reading = unit * _GRID[:, None, None], unit * _GRID[None, :, None]
    variance = drive * (2 / 3 + turn / 3) + reading * (2 - 2 * turn)
    deviance = np.sum(2 * np.log(variance) + power / variance, axis=2)
    deviance += (np.log(reading[:, :, 0] / expected) / _KNOWN_TO) ** 2
    deviance = np.min(deviance, axis=1)
    best = int(np.argmin(deviance))
    rise = deviance - deviance[best]
    low, high = (_crossing(rise, best, side, _ONE_SIGMA) for side in (-1, 1))
    to_density = density_of_step(1.0, 0.5 * period_s)

    def density(variance_a_period: float) -> float:
        return to_density * float(np.sqrt(0.5 * unit * variance_a_period))

    swings = float(np.mean(np.abs(turning) ** 2)) > _SWINGING * 2 * expected
    value = density(_GRID[best]) if swings and rise[0] > GROUND_SEEN else 0.0
    u = 0.5 * (density(high) - density(low)) if value else density(high)
    upper = _crossing(rise, best, 1, _ONE_SIDED)
    return GroundAtRest(Estimate(value, u), density(upper), period_s)


def _crossing(rise: Floats, best: int, side: int, target: float) -> float:
    """Value of the grid at which the rise reaches the target; the grid's end where it never does."""
    k = best
    while 0 <= k + side < len(_GRID) and rise[k] < target:
        k += side
    return float(_GRID[k])
