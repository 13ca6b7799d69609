"""Choice of the model of the motion: damping alone, friction and anharmonic stiffness, a fast mode."""

import math
from collections.abc import Sequence

import numpy as np

from processing.arrays import Ints, Matrix, Vector
from processing.kernel import kernel
from processing.swing.arc import Arc, HalfCycleSamples, fit_arc, gain_of_more
from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    FAST_COSINE,
    FAST_DAMPING,
    FAST_RATE,
    FAST_SINE,
    RATE,
    SHAPE,
    STATES,
    TIME,
    linearise,
    tabulated,
)
from processing.swing.mode_fit import MAX_FAST_RATE_RATIO, MIN_FAST_RATE_RATIO, fit_sinusoid
from processing.swing.prediction import KnownMotion
from processing.swing.sample_buffer import Pivot
from processing.swing.waveform import BEND, DAMPING, DRY, RISE, SHAPES, STIFF, N, P
from processing.units import seconds

_KNOWN_MOTION_TERMS: tuple[int, ...] = (AMPLITUDE, TIME, CENTRE, DRIFT)
_LINEAR: tuple[int, ...] = (AMPLITUDE, TIME, RATE, SHAPE + DAMPING, CENTRE, DRIFT)
ANHARMONIC: tuple[int, ...] = tuple(range(SHAPE + 1, SHAPE + SHAPES))
_ANHARMONIC_WITHOUT_EXPONENTS: tuple[int, ...] = (SHAPE + DRY, SHAPE + RISE, SHAPE + STIFF, SHAPE + BEND)
FAST_MODE: tuple[int, ...] = (FAST_COSINE, FAST_SINE, FAST_RATE, FAST_DAMPING)
_MIN_GAIN_PER_TERM = 3.5
"""Reduction of chi-square that each additional term must achieve to be accepted."""
_MIN_FAST_MODE_GAIN = 20.0
"""Further reduction of chi-square required of a fast mode, because many frequencies are tried."""
_MIN_LINE_PROMINENCE = 15.0
"""Smallest power of a fast mode's line, relative to the median power of its neighbourhood."""
_NEIGHBOURHOOD_FACTOR = 1.6
"""Largest ratio of the frequencies of a line and of its neighbourhood, above and below."""
_MAX_RESIDUAL_FRACTION = 0.25
"""Fraction of the variance that a damped sinusoid leaves, above which no further term is tried."""
_MAX_CHI2_WITHOUT_FAST_MODE = 1.2
"""Reduced chi-square above which a fast mode is searched for."""


def rough_state(pivots: Sequence[Pivot]) -> Vector:
    """State at the first of the rough turning points: amplitude, frequency, damping and centre."""
    times = seconds(np.array([p.time_ns - pivots[0].time_ns for p in pivots]))
    values = np.array([p.deflection for p in pivots])
    ranges = np.abs(np.diff(values))
    loss = max(0.0, 1.0 - float(ranges[-1] / ranges[0]) ** (1.0 / max(len(ranges) - 1, 1)))
    state = np.zeros(STATES)
    state[AMPLITUDE] = 0.5 * ranges[0] * (1.0 + 0.5 * loss)
    state[RATE] = math.pi * (len(pivots) - 1) / times[-1]
    state[SHAPE + DAMPING] = loss / math.pi
    state[CENTRE] = float(np.mean(0.5 * (values[1:] + values[:-1])))
    return state


def prior(start: Vector, anharmonic: bool) -> tuple[Vector, Vector]:
    """Mean and standard deviation of a state's normal prior, given a rough state `start`.

    The prior is wide enough for any pendulum. It only stabilises terms that a few half-cycles cannot
    distinguish (dry friction from damping, the exponents).
    """
    mean, sigma = start.copy(), np.full(STATES, math.inf)
    mean[SHAPE : SHAPE + SHAPES] = 0.0
    mean[[DRIFT, FAST_COSINE, FAST_SINE, FAST_DAMPING]] = 0.0
    sigma[[AMPLITUDE, CENTRE]] = 3.0 * start[AMPLITUDE]
    sigma[TIME], sigma[RATE] = 1.0 / start[RATE], 0.3 * start[RATE]
    sigma[[FAST_COSINE, FAST_SINE]] = 3.0 * start[AMPLITUDE]
    sigma[DRIFT] = 0.2 * start[AMPLITUDE] * start[RATE] / math.pi
    sigma[FAST_RATE] = 0.2 * start[RATE]
    sigma[FAST_DAMPING] = 0.05 * start[RATE]
    sigma[SHAPE + DAMPING] = 0.2
    if anharmonic:
        loss = relative_loss(start) + 1e-4
        sigma[SHAPE + DAMPING] = 0.5 * loss
        mean[[SHAPE + DRY, SHAPE + RISE]] = 0.5 * loss
        sigma[[SHAPE + DRY, SHAPE + RISE]] = loss
        sigma[[SHAPE + STIFF, SHAPE + BEND]] = 0.1, 0.05
        mean[[SHAPE + P, SHAPE + N]] = 0.9, 0.4
        sigma[[SHAPE + P, SHAPE + N]] = 0.3, 0.3
    return mean, sigma


def friction_start(linear: Vector) -> Vector:
    """Start values of the anharmonic fit from the linear fit: most of the loss is ascribed to friction."""
    start = linear.copy()
    start[[SHAPE + P, SHAPE + N]] = 0.9, 0.4
    start[SHAPE + DRY] = 0.95 * relative_loss(linear)
    start[SHAPE + RISE] = 0.9 * start[SHAPE + DRY]
    start[SHAPE + DAMPING] = 0.0
    return start


def relative_loss(x: Vector) -> float:
    """Relative loss of amplitude in one half-cycle at the amplitude of `x`."""
    _, transition = tabulated(x, x, float(x[AMPLITUDE]), np.empty(0, dtype=np.int64))
    return abs(1.0 - float(transition[1, 0]))


def select(start: Vector, halves: Sequence[HalfCycleSamples], known: KnownMotion | None = None) -> Arc | None:
    """Fit the four models (anharmonic or not, with a fast mode or not) and choose one by its chi-square.

    Each additional term must reduce chi-square enough; fast modes are tried only where the fit without them
    is poor. If the motion is `known`, only amplitude, time, centre, drift and fast mode are free. None if no
    fit succeeds.
    """
    if known is not None:
        expected = prior(start, anharmonic=False)
        arc = fit_arc(known.put_into(start), expected, halves, known.reference, _KNOWN_MOTION_TERMS)
        return None if arc is None else _best_with_fast_mode([arc], halves)
    reference = float(start[AMPLITUDE])
    linear = fit_arc(start, prior(start, anharmonic=False), halves, reference, _LINEAR)
    if linear is None:
        return None
    base = linear.states[0]
    deflection = np.concatenate([half.deflection for half in halves])
    u_deflection = np.concatenate([half.u_deflection for half in halves])
    is_finite = np.isfinite(deflection)
    variance = float(np.median(u_deflection[is_finite]) ** 2)
    if linear.reduced_chi2 * variance > _MAX_RESIDUAL_FRACTION * np.std(deflection[is_finite]) ** 2:
        return linear
    candidates = [linear]
    anharmonic_prior = prior(base, anharmonic=True)
    anharmonic = fit_arc(friction_start(base), anharmonic_prior, halves, reference, _LINEAR + ANHARMONIC)
    if anharmonic is not None:
        candidates.append(anharmonic)
    return _best_with_fast_mode(candidates, halves)


def _best_with_fast_mode(arcs: list[Arc], halves: Sequence[HalfCycleSamples]) -> Arc:
    """Best of these arcs and, where they fit poorly, of those with a fast mode added."""
    candidates = list(arcs)
    for arc in arcs:
        is_poor = arc.chi2 > _MAX_CHI2_WITHOUT_FAST_MODE * arc.samples
        guess = guess_fast_mode(arc, halves) if is_poor else None
        if guess is not None:
            start = arc.states[0].copy()
            start[FAST_RATE], start[FAST_COSINE], start[FAST_SINE] = guess
            expected = prior(start, anharmonic=len(arc.active) > len(_LINEAR))
            terms = (*arc.active.tolist(), *FAST_MODE)
            extended = fit_arc(start, expected, halves, arc.reference, terms)
            candidates += [] if extended is None else [extended]
    return best_arc(candidates)


def extend(first: Vector, halves: Sequence[HalfCycleSamples], reference: float, active: Ints) -> Arc | None:
    """Fit a longer arc, starting from the first state of a shorter one.

    The anharmonic terms are added if they reduce chi-square enough. None if the fit fails.
    """
    terms = tuple(active.tolist())
    anharmonic = SHAPE + RISE in terms
    plain = fit_arc(first, prior(first, anharmonic), halves, reference, terms)
    if anharmonic or plain is None:
        return plain
    base = plain.states[0].copy()
    mean, sigma = prior(base, anharmonic=True)
    sigma[SHAPE + DAMPING] = math.inf
    mean[[SHAPE + DRY, SHAPE + RISE]] = 0.0
    base[[SHAPE + P, SHAPE + N]] = mean[[SHAPE + P, SHAPE + N]]
    gain = gain_of_more(plain, base, (mean, sigma), halves, terms + _ANHARMONIC_WITHOUT_EXPONENTS)
    if gain < _MIN_GAIN_PER_TERM * len(ANHARMONIC):
        return plain
    full = fit_arc(friction_start(base), prior(base, anharmonic=True), halves, reference, terms + ANHARMONIC)
    return plain if full is None else best_arc((plain, full))


def best_arc(arcs: Sequence[Arc]) -> Arc:
    """The arc with the lowest chi-square after a penalty for each term (like an information criterion)."""
    # chi-square is scaled: if the samples' uncertainties are too small, it would favour every term
    scale = max(1.0, min(arc.chi2 / max(arc.samples - len(arc.active), 1) for arc in arcs))

    def cost(arc: Arc) -> float:
        penalty = _MIN_GAIN_PER_TERM * len(arc.active) + _MIN_FAST_MODE_GAIN * (FAST_COSINE in arc.active)
        return arc.chi2 / scale + penalty

    return min(arcs, key=cost)


@kernel
def _lines(time_s: Vector, residual: Vector, weight: Vector, rates: Vector) -> Matrix:
    """Power, cosine and sine amplitude at each of the rates, (n, 3)."""
    lines = np.empty((len(rates), 3))
    for k in range(len(rates)):
        # element by element: the assignment of a row would compile an error message, which takes 4 s
        lines[k, 0], lines[k, 1], lines[k, 2] = fit_sinusoid(rates[k], time_s, residual, weight)
    return lines


def _prominent_line(rates: Vector, power: Vector) -> int | None:
    """Index of the strongest line if it is prominent, else of the most prominent line; None without any."""

    def prominence(k: int) -> float:
        neighbours = (rates > rates[k] / _NEIGHBOURHOOD_FACTOR) & (rates < rates[k] * _NEIGHBOURHOOD_FACTOR)
        return float(power[k] / np.median(power[neighbours]))

    strongest = int(np.argmax(power))
    if prominence(strongest) > _MIN_LINE_PROMINENCE:
        return strongest
    prominences = [prominence(k) for k in range(len(rates))]
    index = int(np.argmax(prominences))
    return index if prominences[index] > _MIN_LINE_PROMINENCE else None


def guess_fast_mode(arc: Arc, halves: Sequence[HalfCycleSamples]) -> tuple[float, float, float] | None:
    """Most prominent spectral line in the residuals: angular frequency in rad/s, cosine and sine amplitude.

    None if the samples are too short or too sparse for a fast mode, or no line is prominent: noise of air or
    ground has no lines, but is strong at low frequencies.
    """
    times, residuals, weights = [], [], []
    for x, half in zip(arc.states, halves, strict=True):
        table, _ = tabulated(x, x, arc.reference, arc.active)
        residual, jacobian = np.empty(len(half.tau_s)), np.empty((len(half.tau_s), len(arc.active)))
        side = float(half.side)
        linearise(x, side, arc.active, table, half.tau_s, half.deflection, residual, jacobian)
        times.append(half.tau_s + seconds(half.reference_ns - halves[0].reference_ns))
        residuals.append(residual)
        weights.append(np.where(np.isfinite(residual), 1.0 / half.u_deflection**2, 0.0))
    time_s, residual, weight = np.concatenate(times), np.concatenate(residuals), np.concatenate(weights)
    span = float(time_s[-1] - time_s[0])
    rate = float(arc.states[0][RATE])
    nyquist = math.pi * len(time_s) / span
    highest = min(MAX_FAST_RATE_RATIO * rate, 0.9 * nyquist)
    rates = np.arange(MIN_FAST_RATE_RATIO * rate, highest, 0.5 * math.pi / span)
    if len(rates) == 0:
        return None
    lines = _lines(time_s, np.nan_to_num(residual), weight, rates)
    index = _prominent_line(rates, lines[:, 0])
    return None if index is None else (float(rates[index]), float(lines[index, 1]), float(lines[index, 2]))
