"""Oscillation of a pendulum at rest, which the ground drives, and its auxiliary seismometer."""

from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np

from processing.arrays import Complexes, Flags, Floats
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit import GROUND_SEEN, LEAST_UNEXPLAINED, Seismogram, Signals, density_of_step, plain_signals

_MIN_PERIODS = 8
_PERIODS_S = (1.5, 15.0)
"""Range in which the period is searched for."""
_MIN_SAMPLES = 8
"""Smallest number of samples in a period."""
_BIN_S = 0.1
"""Time over which the deflections are averaged; no motion of a pendulum at rest is faster."""


class RestOscillation(NamedTuple):
    """Oscillation of a pendulum that only the ground moves, in means over `_BIN_S`, arrays (n,)."""

    time_s: Floats
    deflection: Floats
    period_s: float
    periods: int
    """Number of whole periods in the record."""


def rest_oscillation(time_s: Floats, deflection: Floats) -> RestOscillation:
    """Find the period in deflections of a pendulum at rest (n,), NaN without a spot.

    Raises DataError for fewer than eight periods.
    """
    has_spot = np.isfinite(deflection)
    time_s, deflection = time_s[has_spot], deflection[has_spot]
    _, start, count = np.unique(np.floor(time_s / _BIN_S), return_index=True, return_counts=True)
    time_s, deflection = (np.add.reduceat(values, start) / count for values in (time_s, deflection))
    span_s = float(np.ptp(time_s)) if len(time_s) else 0.0
    if span_s < _MIN_PERIODS * _PERIODS_S[0]:
        raise DataError(f"{span_s:.3g} s of the pendulum at rest are too short to see the ground")
    period_s = _period(time_s, deflection, span_s)
    periods = int(span_s / period_s)
    if periods < _MIN_PERIODS:
        raise DataError(
            f"the spot at rest moves mostly with a period of {period_s:.3g} s; {span_s:.3g} s contain "
            f"{periods} periods, and the ground needs {_MIN_PERIODS}"
        )
    return RestOscillation(time_s, deflection, period_s, periods)


def _period(time_s: Floats, deflection: Floats, span_s: float) -> float:
    """Period at which the changes of the deflections have most power, to a twentieth of the resolution. In
    the deflections themselves pointing and air would look like a long period."""
    frequency_hz = np.arange(1 / _PERIODS_S[1], 1 / _PERIODS_S[0], 0.05 / span_s)
    change, middle_s = np.diff(deflection), 0.5 * (time_s[1:] + time_s[:-1])
    change -= np.mean(change)
    amplitude = [abs(np.exp(2j * np.pi * frequency * middle_s) @ change) for frequency in frequency_hz]
    return float(1 / frequency_hz[np.argmax(amplitude)])


def quadratures_of(rest: RestOscillation, deflections: Floats) -> tuple[Complexes, float]:
    """Complex amplitudes (cosine + i sine) in each period (periods, series) of deflections (times, series).

    They are fitted together with an offset and a slope. The second result is the variance of either amplitude
    of the first series, from the residuals of neighbouring samples. Raises DataError for too few samples.
    """
    time_s, period_s = rest.time_s - rest.time_s[0], rest.period_s
    quadratures = np.empty((rest.periods, deflections.shape[1]), dtype=np.complex128)
    variance = np.empty(rest.periods)
    phase = 2 * np.pi * time_s / period_s
    design = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), phase])
    for k in range(rest.periods):
        inside = (time_s >= k * period_s) & (time_s < (k + 1) * period_s)
        samples = np.count_nonzero(inside)
        if samples < _MIN_SAMPLES:
            raise DataError(f"{samples} samples in a period of {period_s:.3g} s at rest are too few")
        fitted = np.linalg.lstsq(design[inside], deflections[inside], rcond=None)[0]
        quadratures[k] = fitted[0] + 1j * fitted[1]
        residual_step = np.diff(deflections[inside, 0] - design[inside] @ fitted[:, 0])
        variance[k] = np.mean(residual_step**2) / (samples - 4)
    return quadratures, float(np.median(variance))


def _driven_steps(step: Complexes, middle: Complexes) -> Complexes:
    """Steps of the quadratures without the part in proportion to their middles, from decay and wrong
    period."""
    return np.asarray(step - middle * (np.vdot(middle, step) / np.vdot(middle, middle)))


_RISE_OF_U, _RISE_OF_BOUND = 1.0, 2.706
"""Rises of -2 ln L for a standard uncertainty, and for a one-sided bound of 95 %."""
_MIN_OSCILLATION_RATIO = 5.0
"""Smallest mean square of the oscillation, relative to that of the reading noise, that shows a drive."""
_U_LOG_READING_VARIANCE = 0.5
"""Standard uncertainty of the logarithm of the reading's variance, which neighbouring samples show too small
where the air moves slowly.
"""
_GRID = 10.0 ** np.arange(-6.0, 2.01, 0.05)
"""Variances that are tried, relative to the mean square of the steps."""


class GroundDrive(NamedTuple):
    """Amplitude spectral density with which the ground drives a pendulum at rest."""

    density: Estimate
    """In rad/s^2/sqrt(Hz), or in the deflections' unit in place of rad."""
    upper_95: float
    """Upper bound of 95 % of the density."""
    period_s: float


def drive_at_rest(time_s: Floats, deflection: Floats) -> GroundDrive:
    """Density of the drive, from the deflections of a free pendulum at rest along its slow mode.

    The oscillation that the ground sustains wanders in both quadratures. It is fitted again in every period.
    The steps from period to period contain the drive and the reading noise, which neighbouring steps share
    with opposite signs: their likelihood separates the two variances.

    Parameters
    ----------
    time_s, deflection
        (n,) evenly spaced except for gaps; NaN without a spot.

    Raises
    ------
    DataError
        Too few periods, or too few samples in one.

    Notes
    -----
    For fits over whole periods of a random walk with the variance S per period, the differences of neighbours
    have the covariance ``2 S/3 + 2 r, S/6 - r, 0, ...``, r from the reading. Sines diagonalise it.
    """
    from scipy.fft import dst

    rest = rest_oscillation(time_s, deflection)
    period_s, periods = rest.period_s, rest.periods
    quadratures, expected = quadratures_of(rest, rest.deflection[:, None])
    series = quadratures[:, 0]
    driven = _driven_steps(np.diff(series), 0.5 * (series[1:] + series[:-1]))
    # the part in proportion to the quadratures takes one degree of freedom
    driven *= np.sqrt(len(driven) / (len(driven) - 1))
    steps = np.column_stack([driven.real, driven.imag])
    power = np.sum(dst(steps, type=1, axis=0, norm="ortho") ** 2, axis=1)
    cosine = np.cos(np.pi * np.arange(1, periods) / periods)
    unit = float(np.mean(power)) / 2
    drive_variance, reading_variance = unit * _GRID[:, None, None], unit * _GRID[None, :, None]
    variance = drive_variance * (2 / 3 + cosine / 3) + reading_variance * (2 - 2 * cosine)
    deviance = np.sum(2 * np.log(variance) + power / variance, axis=2)
    deviance += (np.log(reading_variance[:, :, 0] / expected) / _U_LOG_READING_VARIANCE) ** 2
    deviance = np.min(deviance, axis=1)
    best = int(np.argmin(deviance))
    rise = deviance - deviance[best]
    low, high = (_crossing(rise, best, side, _RISE_OF_U) for side in (-1, 1))
    to_density = density_of_step(1.0, 0.5 * period_s)

    def density(variance_a_period: float) -> float:
        return to_density * float(np.sqrt(0.5 * unit * variance_a_period))

    is_driven = float(np.mean(np.abs(quadratures) ** 2)) > _MIN_OSCILLATION_RATIO * 2 * expected
    value = density(_GRID[best]) if is_driven and rise[0] > GROUND_SEEN else 0.0
    u = 0.5 * (density(high) - density(low)) if value else density(high)
    upper = _crossing(rise, best, 1, _RISE_OF_BOUND)
    return GroundDrive(Estimate(value, u), density(upper), period_s)


def _crossing(rise: Floats, best: int, side: int, target: float) -> float:
    """Value of the grid at which the rise reaches the target; the grid's end if it never does."""
    k = best
    while 0 <= k + side < len(_GRID) and rise[k] < target:
        k += side
    return float(_GRID[k])


_INTERVALS_PER_PERIOD = 80
"""Intervals per period over which the seismometer's record is integrated."""
_DELAYS = np.linspace(-0.25, 0.25, 11)
"""Delays of the seismometer that are tried, in periods: a serial line or network delivers samples late."""
_DELAY_DOF = 0.5
"""Complex degrees of freedom that the choice of the delay uses."""
_STEPS_PER_INDEPENDENT = 1.125
"""Number of steps that count as one independent step: neighbours correlate by 1/4 in both records."""
_MIN_FREE_STEPS = 5
_PERIOD_ITERATIONS = 3
_CHANCE_LEVEL = 0.95
_NORMAL_95 = 1.96
_MAX_FACTOR = 1 / LEAST_UNEXPLAINED


@dataclass(frozen=True, slots=True, kw_only=True)
class SeismometerAtRest:
    """Comparison of an auxiliary seismometer with the oscillation of a pendulum at rest."""

    steps: int
    """Number of changes of the oscillation from period to period that were compared."""
    coherence: float
    """Squared coherence of the changes with those predicted from all components of the seismometer."""
    chance_coherence: float
    """Squared coherence that one in twenty unrelated records exceeds."""
    factor: float
    """Factor by which the amplitude of the changes would fall; by more without noise and air."""
    lower_95: float
    upper_95: float
    """Bounds of 95 % of the factor, at most that between two seismometers at one place."""

    @property
    def related(self) -> bool:
        """Whether this record shows that the seismometer senses the motion that drives the pendulum."""
        return self.coherence > self.chance_coherence


def seismometer_at_rest(time_s: Floats, deflection: Floats, seismometer: Seismogram) -> SeismometerAtRest:
    """Compare an auxiliary seismometer with a free pendulum at rest, along its slow mode.

    Parameters
    ----------
    time_s, deflection
        (n,) NaN without a spot.
    seismometer
        Record of the seismometer, on the same clock within a quarter of a period.

    Raises
    ------
    DataError
        One of the records is too short, or the seismometer's values do not change at all.
    """
    from scipy.special import betaincinv

    rest = rest_oscillation(time_s, deflection)
    signals = plain_signals(seismometer, rest.period_s)
    if not np.all(np.ptp(signals.value, axis=0) > 0):
        raise DataError("its values do not change")
    steps, coherence, period_s = _compare_steps(rest, signals)
    for _ in range(_PERIOD_ITERATIONS):
        # a wandering oscillation shows its period only roughly; with the seismometer it is better known
        rest = rest._replace(period_s=period_s, periods=int(np.ptp(rest.time_s) / period_s))
        steps, coherence, period_s = _compare_steps(rest, signals)
    components = signals.value.shape[1]
    # the decay takes one degree of freedom, each component's gain another
    dof = steps - 1 - components - _DELAY_DOF
    if dof < _MIN_FREE_STEPS - 1:
        raise DataError(
            f"seismometer and pendulum at rest have {steps} periods in common; at least "
            f"{_MIN_FREE_STEPS + 1 + components} are needed"
        )
    fitted_dof = components + _DELAY_DOF
    unexplained = min(1.0, (1 - coherence) * (dof + fitted_dof) / dof)
    fisher, u = np.arctanh(np.sqrt(1 - unexplained)), np.sqrt(_STEPS_PER_INDEPENDENT / (2 * (dof - 1)))
    low, high = np.cosh(max(0.0, fisher - _NORMAL_95 * u)), np.cosh(fisher + _NORMAL_95 * u)
    return SeismometerAtRest(
        steps=steps,
        coherence=coherence,
        chance_coherence=float(betaincinv(fitted_dof, dof / _STEPS_PER_INDEPENDENT, _CHANCE_LEVEL)),
        factor=float(min(np.cosh(fisher), _MAX_FACTOR)),
        lower_95=float(min(low, _MAX_FACTOR)),
        upper_95=float(min(high, _MAX_FACTOR)),
    )


def _compare_steps(rest: RestOscillation, signals: Signals) -> tuple[int, float, float]:
    """Number of steps, their squared coherence with those predicted, and the fitted period in s."""
    quadratures = quadratures_of(rest, rest.deflection[:, None])[0][:, 0]
    use = _are_covered(rest, signals)
    step, middle = np.diff(quadratures)[use], (0.5 * (quadratures[1:] + quadratures[:-1]))[use]
    driven = _driven_steps(step, middle)
    power = float(np.vdot(driven, driven).real)
    predictions = _predicted_steps(rest, signals)[:, :, use]
    fits = []
    for prediction in predictions:
        design = np.column_stack([middle, *prediction])
        gains = np.linalg.lstsq(design, step, rcond=None)[0]
        residual = step - design @ gains
        fits.append((float(np.vdot(residual, residual).real), float(gains[0].imag)))
    smallest, phase_error = min(fits)
    period_s = rest.period_s / (1 - phase_error / (2 * np.pi))
    return len(step), 1 - smallest / power, period_s


def _predicted_steps(rest: RestOscillation, signals: Signals) -> Complexes:
    """Steps (delays, components, periods - 1) of an undamped pendulum that a component drives."""
    # at the record's own times and between them, so that each sample has the same weight
    points = ceil(_INTERVALS_PER_PERIOD * signals.longest_step_s / rest.period_s)
    number = np.arange(len(signals.time_s))
    time_s = np.interp(np.arange(0, number[-1] + 0.5 / points, 1 / points), number, signals.time_s)
    phasor = np.exp(2j * np.pi * time_s / rest.period_s)
    series = []
    for component in signals.value.T:
        drive = np.interp(time_s, signals.time_s, component) * phasor.conj()
        integral = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time_s) * (drive[1:] + drive[:-1]))])
        angle = (phasor * integral).imag
        angle /= np.std(angle)
        series += [np.interp(rest.time_s + delay * rest.period_s, time_s, angle) for delay in _DELAYS]
    quadratures = quadratures_of(rest, np.column_stack(series))[0]
    steps = np.diff(quadratures, axis=0).T
    return np.swapaxes(steps.reshape(signals.value.shape[1], len(_DELAYS), -1), 0, 1)


def _are_covered(rest: RestOscillation, signals: Signals) -> Flags:
    """Whether the seismometer's record covers each step from period to period."""
    edges = rest.time_s[0] + rest.period_s * np.arange(rest.periods + 1)
    pause = np.flatnonzero(np.diff(signals.time_s) > signals.longest_step_s)
    # the largest delay beyond the record's ends is no gap: mostly both records begin and end together
    max_delay_s = rest.period_s * float(np.max(np.abs(_DELAYS)))
    begins = np.concatenate([[-np.inf], signals.time_s[pause], [signals.time_s[-1] + max_delay_s]])
    ends = np.concatenate([[signals.time_s[0] - max_delay_s], signals.time_s[pause + 1], [np.inf]])
    return np.asarray(~np.any((edges[:-2, None] < ends) & (edges[2:, None] > begins), axis=1))
