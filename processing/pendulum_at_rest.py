"""The swing of a pendulum at rest, which the ground keeps up, and how strongly the ground drives it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import GROUND_SEEN, density_of_step

_FEWEST_PERIODS = 8
_PERIODS_S = (1.5, 15.0)
"""Range in which the period is looked for."""
_FEWEST_SAMPLES = 8
"""In a period."""
_BIN_S = 0.1


class SwingAtRest(NamedTuple):
    """Times and deflections in tenths of a second, the period in s, and how many whole ones there are."""

    time_s: Floats
    deflection: Floats
    period_s: float
    periods: int

    def with_period(self, period_s: float) -> "SwingAtRest":
        """The same, of another period."""
        return self._replace(period_s=period_s, periods=int(np.ptp(self.time_s) / period_s))


def swing_at_rest(time_s: Floats, deflection: Floats) -> SwingAtRest:
    """The deflections of a pendulum at rest (NaN where there is no spot), and its period.

    Raises DataError for fewer than eight periods.
    """
    seen = np.isfinite(deflection)
    time_s, deflection = _binned(time_s[seen], deflection[seen])
    span_s = float(np.ptp(time_s)) if len(time_s) else 0.0
    if span_s < _FEWEST_PERIODS * _PERIODS_S[0]:
        raise DataError(f"{span_s:.3g} s of the pendulum at rest are too short to see the ground")
    period_s = _period(time_s, deflection, span_s)
    periods = int(span_s / period_s)
    if periods < _FEWEST_PERIODS:
        raise DataError(
            f"the spot at rest moves mostly with a period of {period_s:.3g} s; {span_s:.3g} s contain "
            f"{periods} periods, and the ground needs {_FEWEST_PERIODS}"
        )
    return SwingAtRest(time_s, deflection, period_s, periods)


def _binned(time_s: Floats, deflection: Floats) -> tuple[Floats, Floats]:
    """Means over tenths of a second: nothing here is faster."""
    if not len(time_s):
        return time_s, deflection
    _, start, count = np.unique(np.floor(time_s / _BIN_S), return_index=True, return_counts=True)
    return np.add.reduceat(time_s, start) / count, np.add.reduceat(deflection, start) / count


def _period(time_s: Floats, deflection: Floats, span_s: float) -> float:
    """Where the changes of the deflections hold most power, to a twentieth of the resolution.

    Of their changes, because pointing and air wander the more the slower, and would be taken for a long
    period.
    """
    frequency_hz = np.arange(1 / _PERIODS_S[1], 1 / _PERIODS_S[0], 0.05 / span_s)
    change, middle_s = np.diff(deflection), 0.5 * (time_s[1:] + time_s[:-1])
    change -= np.mean(change)
    found = [abs(np.exp(2j * np.pi * one * middle_s) @ change) for one in frequency_hz]
    return float(1 / frequency_hz[np.argmax(found)])


def quadratures_of(rest: SwingAtRest, deflections: Floats) -> tuple[NDArray[np.complex128], float]:
    """Amplitudes of cosine and, times i, of sine in each period (periods, series), of (times, series).

    Beside an offset and a slope; and the variance of either amplitude of the first series, by what these
    leave of neighbouring samples.
    """
    time_s, period_s = rest.time_s - rest.time_s[0], rest.period_s
    out = np.empty((rest.periods, deflections.shape[1]), dtype=np.complex128)
    variance = np.empty(rest.periods)
    phase = 2 * np.pi * time_s / period_s
    columns = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), phase])
    for k in range(rest.periods):
        inside = (time_s >= k * period_s) & (time_s < (k + 1) * period_s)
        if np.count_nonzero(inside) < _FEWEST_SAMPLES:
            raise DataError(
                f"{np.count_nonzero(inside)} samples in a period of {period_s:.3g} s at rest are too few"
            )
        fitted = np.linalg.lstsq(columns[inside], deflections[inside], rcond=None)[0]
        out[k] = fitted[0] + 1j * fitted[1]
        left = np.diff(deflections[inside, 0] - columns[inside] @ fitted[:, 0])
        variance[k] = np.mean(left**2) / (np.count_nonzero(inside) - 4)
    return out, float(np.median(variance))


def without_decay(turning: NDArray[np.complex128]) -> Floats:
    """(periods - 1, 2) steps less what goes with the oscillation: its decay, a period a little off."""
    step, middle = np.diff(turning), 0.5 * (turning[1:] + turning[:-1])
    left = step - middle * np.vdot(middle, step) / np.vdot(middle, middle)
    left *= np.sqrt(len(step) / (len(step) - 1))
    return np.column_stack([left.real, left.imag])


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
