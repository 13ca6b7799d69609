"""Exact effect of a known angular acceleration on turning points, and the signals of a seismometer.

Between two turning points an acceleration f(t) moves the pendulum by the response of an oscillator. To first
order, with s the side of the later turning point k, w the frequency and theta = w (t - t_k):

    change of the amplitude            -(s/w) int f sin(theta) dt
    delay, times the amplitude         (s/w^2) int f cos(theta) dt         both over the half-swing

A turning point that is measured on the samples of its half-cycle, between its zero crossings, is that of the
oscillation that fits them best. Relative to the motion through the true turning point, f adds to the samples
the response that begins there, forwards and backwards. Its least-squares fit has, with x = pi/2 - |theta|:

    amplitude, equilibrium known  (s/w) int f p dt / pi,      p = cos(theta) - x sin|theta|
    amplitude, equilibrium free   (s/w) int f (pi p/2 - 2 r) dt / (pi^2/2 - 4),  r = 1 - sin|theta|
    time, times the amplitude     (s/w^2) int f x cos(theta) sign(theta) dt / pi
    equilibrium position          (1/w) int f (pi r/2 - p) dt / (pi^2/2 - 4)

The equilibrium position is known from earlier half-cycles, which f has moved too: its error moves the
amplitude by -(4/pi) s of it. This is the only term that depends on earlier f alone; without it the fitted
delay of a seismometer would be 0.1 s too long at a period of 4 s.

f is linear between its samples, and all integrals have closed forms.

Friction that grows nearly in proportion to the deflection acts as a softer spring before the zero crossing
and a stiffer one after it: with a relative loss e of amplitude in a half-swing the quarters have the
frequencies w (1 - e/2) and w (1 + e/2). The factor s/w of the amplitude takes that of the second quarter, the
factor s/w^2 of the delay the product of the second's and the quarter's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from processing.arrays import Flags, Floats
from processing.errors import DataError
from processing.fit.ground import KnownSteps
from processing.kernel import kernel
from processing.swing import TurningPoints

_FREQUENCY_NEIGHBOURS = 4
"""Half-swings on either side over which the frequency is averaged: the ground makes single ones uneven."""
_LOSS_NEIGHBOURS = 15
"""Half-swings on either side over which the loss is averaged; an error of a tenth has no visible effect."""
_INTEGRALS = 5
"""Integrals of f: times cos and sin of theta, times theta cos and theta sin, and f alone."""
FREE_REST_WEIGHT, U_FREE_REST_WEIGHT = 1 / 3, 0.3
"""Weight of a half-cycle's own samples, against the earlier ones, in the swing detector's equilibrium
position, and its standard uncertainty.

The detector adapts it to how much the equilibrium position wanders. It does not follow from the turning
points: their uncertainties imply 0.12, too small because they hold the drive's part, too. On a white drive of
1e-7 rad/s^2/sqrt(Hz) it was 0.35 in long runs and 0.7 in runs of 100 half-cycles. An error of it moves the
fitted delay, at a period of 4 s by -0.026 s for each 0.1: with 0.2, 1/3 and 0.5 a seismometer without delay
got 0.067, 0.024 and -0.012 s (each 0.016, of four long runs). At one frequency a delay is a phase, which the
response takes up."""
_REST_DENOMINATOR = np.pi**2 / 2 - 4
"""Denominator of the fits with a free equilibrium position, see above."""


@kernel
def moments_of(
    time: Floats, value: Floats, origin: Floats, rate: Floats, low: Floats, high: Floats, longest: float
) -> Floats:
    """Integrals (n, terms, 5) of f, linear between samples, over intervals; see `_INTEGRALS`.

    Parameters
    ----------
    time, value
        Rising times (samples,) and values (samples, terms). A value that is NaN is missing.
    origin, rate, low, high
        Of each interval (n,): time at which theta is 0, its rate in rad/s, and the limits.
    longest
        Largest time in s between two samples; a longer one is a gap. Integrals over a gap, or beyond the
        samples, are NaN.
    """
    count, terms, samples = len(origin), value.shape[1], len(time)
    integrals = np.zeros((count, terms, _INTEGRALS))
    for i in range(count):
        a = np.searchsorted(time, low[i], side="right") - 1
        if a < 0 or high[i] > time[samples - 1]:
            integrals[i] = np.nan
            continue
        w = rate[i]
        while a < samples - 1 and time[a] < high[i]:
            step = time[a + 1] - time[a]
            if step > longest:
                integrals[i] = np.nan
                break
            x0 = w * (max(low[i], time[a]) - origin[i])
            x1 = w * (min(high[i], time[a + 1]) - origin[i])
            c0, s0, c1, s1 = np.cos(x0), np.sin(x0), np.cos(x1), np.sin(x1)
            for j in range(terms):
                slope = (value[a + 1, j] - value[a, j]) / (step * w)
                f0 = value[a, j] + slope * (x0 - w * (time[a] - origin[i]))
                f1 = f0 + slope * (x1 - x0)
                # antiderivatives by parts: of f e^(i x) and of x f e^(i x)
                integrals[i, j, 0] += (f1 * s1 + slope * c1 - f0 * s0 - slope * c0) / w
                integrals[i, j, 1] += (slope * s1 - f1 * c1 - slope * s0 + f0 * c0) / w
                p0, p1, d0, d1 = x0 * f0, x1 * f1, f0 + slope * x0, f1 + slope * x1
                integrals[i, j, 2] += ((p1 - 2 * slope) * s1 + d1 * c1 - (p0 - 2 * slope) * s0 - d0 * c0) / w
                integrals[i, j, 3] += (d1 * s1 - (p1 - 2 * slope) * c1 - d0 * s0 + (p0 - 2 * slope) * c0) / w
                integrals[i, j, 4] += 0.5 * (f0 + f1) * (x1 - x0) / w
            a += 1
    return integrals


@dataclass(frozen=True, eq=False)
class Signals:
    """Samples of signals that may drive a pendulum, each up to a gain."""

    time_s: Floats
    value: Floats
    """Values (samples, terms), one column for each signal."""
    longest_step_s: float
    """A longer time between two samples is a gap."""

    def select(self, terms: list[int]) -> "Signals":
        return replace(self, value=np.ascontiguousarray(self.value[:, terms]))


@dataclass(frozen=True, eq=False)
class KnownDrive:
    """Effect of each of some signals, at unit gain, on the turning points of a run."""

    steps: Floats
    """(2, half-swings + 1, terms): change of the amplitude, and of the time (s) times the amplitude, with the
    half-swing that ends at each turning point, counted from the first one, which has only the part of its own
    measurement. 0 where `missing`."""
    missing: Flags
    """(half-swings + 1,) whether the drive of a half-swing is not known."""
    gains: Floats
    """Gains (terms,) in rad/s^2 per unit of the signals: the start of a search, or its result."""
    covariance: Floats | None = None
    """Covariance (terms, terms) of fitted gains; None before a fit."""

    @property
    def terms(self) -> int:
        return int(self.steps.shape[2])

    def select(self, terms: list[int]) -> "KnownDrive":
        return KnownDrive(self.steps[:, :, terms], self.missing, self.gains[terms])

    def with_gains(self, gains: Floats, covariance: Floats | None = None) -> "KnownDrive":
        """The same drive with other gains."""
        return replace(self, gains=gains, covariance=covariance)

    def unknown_variance(self, gains: Floats) -> Floats:
        """Variance of each half-swing's unknown step (half-swings + 1,), in the squared unit of `steps`: the
        mean square of the known ones, and 0 where the drive is known."""
        known_steps = self.steps[0][~self.missing] @ gains
        mean = float(np.mean(known_steps**2)) if len(known_steps) else 0.0
        return np.where(self.missing, mean, 0.0)


def known_drive(
    points: TurningPoints, signals: Signals, *, averaged: bool = True, rest_weight: float = FREE_REST_WEIGHT
) -> KnownDrive:
    """The drive of turning points by signals, its gains 0; `averaged` is that of `fit_exact`.

    The first turning point's side counts as positive. `rest_weight` is used only if `averaged`.
    """
    number = points.index - points.index[0]
    count, terms = int(number[-1]) + 1, signals.value.shape[1]
    time = np.interp(np.arange(count), number, points.time_s)
    amplitude = np.interp(np.arange(count), number, points.amplitude)
    rate, side = _rates(time), np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    steps = np.zeros((2, count, terms))
    steps[:, 1:] = _half_cycle_response(signals, time, side, rate, _losses(amplitude))
    if averaged:
        measured = _measurement_response(signals, time, side, rate, rest_weight)
        # a step ends at the measured turning point and begins at the measured one before it
        steps += measured
        steps[:, 1:] -= measured[:, :-1]
    missing = ~np.all(np.isfinite(steps), axis=(0, 2))
    steps[:, missing] = 0.0
    return KnownDrive(steps, missing, np.zeros(terms))


def _rates(time: Floats) -> Floats:
    """Angular frequency at each turning point, rad/s."""
    last = np.minimum(np.arange(len(time)) + _FREQUENCY_NEIGHBOURS, len(time) - 1)
    first = np.maximum(np.arange(len(time)) - _FREQUENCY_NEIGHBOURS, 0)
    return np.asarray(np.pi * (last - first) / (time[last] - time[first]))


def _losses(amplitude: Floats) -> Floats:
    """Relative loss of amplitude in each half-swing, averaged over neighbours."""
    index = np.arange(len(amplitude))
    last = np.minimum(index + _LOSS_NEIGHBOURS, len(index) - 1)
    first = np.maximum(index - _LOSS_NEIGHBOURS, 0)
    loss = (amplitude[first] - amplitude[last]) / ((last - first) * amplitude)
    return np.asarray(0.5 * (loss[1:] + loss[:-1]))


def _half_cycle_response(signals: Signals, time: Floats, side: Floats, rate: Floats, loss: Floats) -> Floats:
    """Steps (2, half-swings, terms) of the motion itself, by the integrals over both quarters."""
    w, s = 0.5 * (rate[1:] + rate[:-1]), side[1:, None]
    first_quarter, second_quarter = w * (1 - 0.5 * loss), w * (1 + 0.5 * loss)
    # counted from the middle: counted from either end, the phase would hold half of the effect
    crossing = 0.5 * (time[1:] + time[:-1]) + 0.25 * np.pi * loss / w
    response = np.zeros((2, len(w), signals.value.shape[1]))
    for frequency, low, high in ((first_quarter, time[:-1], crossing), (second_quarter, crossing, time[1:])):
        moments = _moments(signals, crossing + 0.5 * np.pi / frequency, frequency, low, high)
        response[0] -= s / second_quarter[:, None] * moments[:, :, 1]
        response[1] += s / (frequency * second_quarter)[:, None] * moments[:, :, 0]
    return response


def _measurement_response(
    signals: Signals, time: Floats, side: Floats, rate: Floats, weight: float
) -> Floats:
    """Errors (2, turning points, terms) of turning points that are measured on the samples."""
    w, s, quarter_s = rate[:, None], side[:, None], 0.5 * np.pi / rate
    response = np.zeros((2, len(time), signals.value.shape[1]))
    rest = np.zeros(response.shape[1:])
    for sign, low, high in ((-1.0, time - quarter_s, time), (1.0, time, time + quarter_s)):
        cosine, sine, x_cosine, x_sine, plain = np.moveaxis(_moments(signals, time, rate, low, high), 2, 0)
        # pi/2 - |theta| = pi/2 - sign theta, sin|theta| = sign sin(theta)
        p = cosine - 0.5 * np.pi * sign * sine + x_sine
        r = plain - sign * sine
        free = (0.5 * np.pi * p - 2 * r) / _REST_DENOMINATOR
        response[0] += s / w * ((1 - weight) * p / np.pi + weight * free)
        rest += (0.5 * np.pi * r - p) / (w * _REST_DENOMINATOR)
        response[1] += s / w**2 * sign * (0.5 * np.pi * cosine - sign * x_cosine) / np.pi
    response[0, 1:] -= s[1:] * 4 / np.pi * (1 - weight) * _detector_rest(rest, weight)[:-1]
    return response


def _detector_rest(rest: Floats, weight: float) -> Floats:
    """The equilibrium position (half-swings, terms) that the detector has after each half-cycle."""
    # its change in a gap is not known, and taken as zero
    position = np.nan_to_num(rest) * weight
    for k in range(1, len(position)):
        position[k] += (1 - weight) * position[k - 1]
    return position


def _moments(signals: Signals, origin: Floats, rate: Floats, low: Floats, high: Floats) -> Floats:
    values = signals.time_s, signals.value
    return np.asarray(moments_of(*values, origin, rate, low, high, signals.longest_step_s))


LEAST_UNEXPLAINED = 0.022
"""Share of a drive that a seismometer leaves unexplained at best.

Two of different make at one location differ by it, at 0.2 to 0.28 Hz. In one half-swing it is below the noise
of a turning point, but it adds up."""


class DriveGains:
    """The gains of a known drive, the first coordinates of a fit, in units that move amplitudes by the
    reference (rms)."""

    def __init__(self, drive: KnownDrive, reference: float) -> None:
        self._drive, self._reference = drive, reference
        self.terms = drive.terms
        size = np.sqrt(np.mean(drive.steps[0] ** 2, axis=0))
        self.unit = reference / np.where(size > 0.0, size, 1.0)
        self.start = drive.gains / self.unit

    def gains(self, coordinates: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Gains (terms,) in rad/s^2 per unit of the signals, and their covariance."""
        own = slice(self.terms)
        return coordinates[own] * self.unit, covariance[own, own] * np.outer(self.unit, self.unit)

    def known(self, coordinates: Floats, width: int) -> KnownSteps:
        """The known part of the drive for the filter, with derivatives for a Jacobian of `width` columns."""
        steps = self._drive.steps * (self.unit / self._reference)
        gains = coordinates[: self.terms]
        derivative = np.zeros((*steps.shape[:2], width))
        derivative[:, :, : self.terms] = steps
        unknown = self._drive.unknown_variance(gains * self.unit) / self._reference**2
        known, knocked = np.ascontiguousarray(steps @ gains), np.zeros(len(unknown), np.bool_)
        return KnownSteps(known, derivative, unknown, knocked)

    def least_unexplained(self, coordinates: Floats) -> float:
        """The least step of the drive that remains unexplained, in units of the reference."""
        steps = self.known(coordinates, self.terms).steps[0][~self._drive.missing]
        return LEAST_UNEXPLAINED * float(np.sqrt(np.mean(steps**2))) if len(steps) else 0.0


_MAX_STEP_PERIODS = 0.25
"""Longest step between samples, in periods: a parabola through three of them still follows a swing."""
_MIN_STEP_PERIODS = 1 / 80
"""Step, in periods, to which finer samples are averaged, which reduces the gain by 3e-4."""
_MIN_GAP_STEPS = 1.6
"""Distance of two samples, in median steps, above which samples are missing between them."""
_GUARD_PERIODS = 0.5
"""Periods on either side of a gap that are not used, since the interpolation in the gap changes them."""
_MAX_DRIFT_FREQUENCY = 1 / 8
"""Frequency over the pendulum's below which a record is taken as its instrument's drift."""
_PADDED_PERIODS = 16
"""Periods by which a record is mirrored at its ends."""


@dataclass(frozen=True, eq=False)
class Seismogram:
    """Samples of an auxiliary seismometer, in the rig's room or far from it."""

    time_s: Floats
    """Times (n,) on the clock of the turning points, rising."""
    value: Floats
    """Values (n, components) in any unit, NaN where missing."""
    names: tuple[str, ...]
    """Names of the components."""

    def delayed(self, delay_s: float, drift: float = 0.0, origin_s: float = 0.0) -> "Seismogram":
        """The same with times later by `delay_s`, and by further `drift` for each second after `origin_s`."""
        return replace(self, time_s=self.time_s + delay_s + drift * (self.time_s - origin_s))

    def between(self, first_s: float, last_s: float) -> "Seismogram":
        """The samples within these times."""
        low, high = np.searchsorted(self.time_s, (first_s, last_s)).tolist()
        return replace(self, time_s=self.time_s[low:high], value=self.value[low:high])


SIGNALS = 4
"""Number of signals made of a component: for gain, quadrature, and the slopes of both over the frequency.

The response of a seismometer is not known. Near the pendulum's frequency gain and quadrature describe it;
slopes are needed where they change within the band over which a half-swing responds to the ground."""
PAIR, SLOPES = (0, 1), (2, 3)
"""Gain and quadrature, and their slopes, among the signals of a component."""


def columns_of(component: int, kinds: Sequence[int]) -> list[int]:
    """Columns of some of a component's signals among those of all components."""
    return [component * SIGNALS + kind for kind in kinds]


def signals_of(seismometer: Seismogram, period_s: float) -> Signals:
    """Every component's signals; raises DataError for samples that are too few or too far apart."""
    from scipy.ndimage import binary_dilation  # here, because it would slow down every command

    time, value, step_s = _even(seismometer, period_s)
    good = np.all(np.isfinite(value), axis=1)
    if np.count_nonzero(good) * step_s < 4 * period_s:
        raise DataError(
            f"the seismometer has {np.count_nonzero(good) * step_s:.3g} s of samples beside the run; at "
            f"least four periods ({4 * period_s:.3g} s) are needed"
        )
    filled = np.column_stack([np.interp(time, time[good], component[good]) for component in value.T])
    padding = min(ceil(_PADDED_PERIODS * period_s / step_s), len(time) - 1)
    filled -= filled.mean(axis=0)
    padded = np.pad(filled, ((padding, padding), (0, 0)), mode="reflect", reflect_type="odd")
    padded -= np.linspace(padded[0], padded[-1], len(padded))
    spectrum = np.fft.rfft(padded, axis=0)
    nu = np.fft.rfftfreq(len(padded), step_s)[:, None] * period_s
    spectrum *= 1.0 - np.exp(-((nu / _MAX_DRIFT_FREQUENCY) ** 2))
    slope = np.clip(nu - 1.0, -1.0, 1.0)
    turned = -1j * spectrum
    kinds = np.stack([spectrum, turned, slope * spectrum, slope * turned], axis=2)
    signals = np.fft.irfft(kinds.reshape(len(nu), -1), len(padded), axis=0)
    signals = signals[padding : padding + len(time)]
    guard = ceil(_GUARD_PERIODS * period_s / step_s)
    usable = ~binary_dilation(~good, np.ones(2 * guard + 1, dtype=np.bool_))
    return Signals(time[usable], np.ascontiguousarray(signals[usable]), _MIN_GAP_STEPS * step_s)


def plain_signals(seismometer: Seismogram, period_s: float) -> Signals:
    """Every component unchanged but for its drift, which is removed."""
    gains = [component * SIGNALS for component in range(len(seismometer.names))]
    return signals_of(seismometer, period_s).select(gains)


def _even(seismometer: Seismogram, period_s: float) -> tuple[Floats, Floats, float]:
    """Times, values (NaN where missing) and step in s of the samples at an even rate."""
    time, value = seismometer.time_s, seismometer.value
    if len(time) < 3:
        raise DataError(f"the seismometer has {len(time)} samples beside the run: their times do not overlap")
    steps = np.diff(time)
    step_s = float(np.median(steps))
    if step_s > _MAX_STEP_PERIODS * period_s:
        raise DataError(
            f"the seismometer has a sample every {step_s:.3g} s; the pendulum's period of {period_s:.3g} s "
            f"needs one every {_MAX_STEP_PERIODS * period_s:.2g} s at least"
        )
    count = round((time[-1] - time[0]) / step_s) + 1
    even = time[0] + step_s * np.arange(count)
    preceding = np.clip(np.searchsorted(time, even, side="right") - 1, 0, len(time) - 2)
    values = np.column_stack([np.interp(even, time, component) for component in value.T])
    values[steps[preceding] > _MIN_GAP_STEPS * step_s] = np.nan
    block = int(_MIN_STEP_PERIODS * period_s / step_s)
    if block < 2:
        return even, values, step_s
    used = count // block * block
    even = even[:used].reshape(-1, block).mean(axis=1)
    return even, values[:used].reshape(len(even), block, -1).mean(axis=1), step_s * block
