"""The swing of a pendulum at rest, which the ground keeps up, and how strongly the ground drives it."""

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Flags, Floats
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import GROUND_SEEN, LEAST_UNEXPLAINED, Seismogram, Signals, density_of_step, plain_signals

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


_STEPS_A_PERIOD = 80
"""In which the record's drive is summed."""
_DELAYS = np.linspace(-0.25, 0.25, 11)
"""Lateness that is tried, in periods: lines of text and packets come late, by what the fit finds later."""
_OF_DELAY = 0.5
"""What the choice of the delay takes, in complex numbers."""
_ALIKE = 1.125
"""Steps follow one another with a correlation of 1/4, of pendulum and witness: so many are worth one."""
_FEWEST = 5
_REFINED = 3
_CHANCE = 0.95
_NORMAL_95 = 1.96
_MOST = 1 / LEAST_UNEXPLAINED


@dataclass(frozen=True, slots=True, kw_only=True)
class SeismometerAtRest:
    """How a witness goes with the swing of a pendulum at rest.

    Attributes
    ----------
    steps
        Changes of the swing from period to period that were compared.
    coherence
        Their squared coherence with what the witness predicts, all its components together.
    by_chance
        A squared coherence that one in twenty unrelated records exceeds.
    factor
        By which the amplitude of the changes would fall. Reading, air and pointing are in them: the ground's
        part falls by more.
    least, most
        Bounds of 95 %. No fit counts on more than what two seismometers at one place show.
    """

    steps: int
    coherence: float
    by_chance: float
    factor: float
    least: float
    most: float

    @property
    def related(self) -> bool:
        """Whether the witness feels what moves the pendulum, as far as this piece shows."""
        return self.coherence > self.by_chance


def witness_at_rest(time_s: Floats, deflection: Floats, witness: Seismogram) -> SeismometerAtRest:
    """Compare a witness with a free pendulum at rest, along its slow mode.

    Parameters
    ----------
    time_s, deflection
        (n,) NaN where there is no spot.
    witness
        On the same clock, up to a quarter of a period.

    Raises
    ------
    DataError
        The pendulum or the witness was seen for too short a time; or the witness does not change at all.
    """
    from scipy.special import betaincinv

    rest = swing_at_rest(time_s, deflection)
    signals = plain_signals(witness, rest.period_s)
    if not np.all(np.ptp(signals.value, axis=0) > 0):
        raise DataError("its values do not change")
    compared = _compared(rest, signals)
    for _ in range(_REFINED):
        # a swing that wanders shows its period but roughly; where the witness explains why, it is known
        rest = rest.with_period(compared.period_s)
        compared = _compared(rest, signals)
    coherence, components = compared.coherence, signals.value.shape[1]
    # a step for the decay, and those that the gains take
    free = compared.steps - 1 - components - _OF_DELAY
    if free < _FEWEST - 1:
        raise DataError(
            f"witness and pendulum at rest have {compared.steps} periods in common; at least "
            f"{_FEWEST + 1 + components} are needed"
        )
    taken = components + _OF_DELAY
    of_chance = min(1.0, (1 - coherence) * (free + taken) / free)
    fisher, u = np.arctanh(np.sqrt(1 - of_chance)), np.sqrt(_ALIKE / (2 * (free - 1)))
    low, high = np.cosh(max(0.0, fisher - _NORMAL_95 * u)), np.cosh(fisher + _NORMAL_95 * u)
    return SeismometerAtRest(
        steps=compared.steps,
        coherence=coherence,
        by_chance=float(betaincinv(taken, free / _ALIKE, _CHANCE)),
        factor=float(min(np.cosh(fisher), _MOST)),
        least=float(min(low, _MOST)),
        most=float(min(high, _MOST)),
    )


class _StepComparison(NamedTuple):
    """How many steps, their squared coherence with those predicted, and the period that the fit prefers."""

    steps: int
    coherence: float
    period_s: float


def _compared(rest: SwingAtRest, signals: Signals) -> _StepComparison:
    turning = quadratures_of(rest, rest.deflection[:, None])[0][:, 0]
    use = _covered(rest, signals)
    step, middle = np.diff(turning)[use], (0.5 * (turning[1:] + turning[:-1]))[use]
    alone = step - middle * (np.vdot(middle, step) / np.vdot(middle, middle))
    power = float(np.vdot(alone, alone).real)
    predicted = _predicted_steps(rest, signals)[:, :, use]
    found = []
    for columns in predicted:
        every = np.column_stack([middle, *columns])
        gains = np.linalg.lstsq(every, step, rcond=None)[0]
        after = step - every @ gains
        found.append((float(np.vdot(after, after).real), float(gains[0].imag)))
    least, turned = min(found)
    period_s = rest.period_s / (1 - turned / (2 * np.pi))
    return _StepComparison(len(step), 1 - least / power, period_s)


def _predicted_steps(rest: SwingAtRest, signals: Signals) -> NDArray[np.complex128]:
    """(delays, components, periods - 1) steps of an undamped pendulum that a component drives."""
    # at its own times and between them, so that each sample counts alike
    parts = ceil(_STEPS_A_PERIOD * signals.longest_step_s / rest.period_s)
    number = np.arange(len(signals.time_s))
    time_s = np.interp(np.arange(0, number[-1] + 0.5 / parts, 1 / parts), number, signals.time_s)
    turn = np.exp(2j * np.pi * time_s / rest.period_s)
    series = []
    for one in signals.value.T:
        drive = np.interp(time_s, signals.time_s, one) * turn.conj()
        summed = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (drive[1:] + drive[:-1]))])
        angle = (turn * summed).imag
        angle /= np.std(angle)
        series += [np.interp(rest.time_s + delay * rest.period_s, time_s, angle) for delay in _DELAYS]
    turning = quadratures_of(rest, np.column_stack(series))[0]
    steps = np.diff(turning, axis=0).T
    return np.swapaxes(steps.reshape(signals.value.shape[1], len(_DELAYS), -1), 0, 1)


def _covered(rest: SwingAtRest, signals: Signals) -> Flags:
    """Which steps from period to period the witness was there for."""
    edges = rest.time_s[0] + rest.period_s * np.arange(rest.periods + 1)
    pause = np.flatnonzero(np.diff(signals.time_s) > signals.longest_step_s)
    # what lies a little beyond its ends is no gap: mostly it begins and ends with the pendulum's piece
    little_s = rest.period_s * float(np.max(np.abs(_DELAYS)))
    begins = np.concatenate([[-np.inf], signals.time_s[pause], [signals.time_s[-1] + little_s]])
    ends = np.concatenate([[signals.time_s[0] - little_s], signals.time_s[pause + 1], [np.inf]])
    return np.asarray(~np.any((edges[:-2, None] < ends) & (edges[2:, None] > begins), axis=1))
