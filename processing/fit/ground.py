"""The ground as a source of scatter: the noise of turning points, its likeliest size, and the Kalman filter.

State: amplitude (in units of the reference) and time (s) of the turning point. Transition: one half-swing
of the law (`HalfCycleLosses`, interpolated by cubics) and the drive. White angular acceleration moves the two
quadratures of the oscillation independently, each by a step of standard deviation s a half-swing. To first
order in s/a one of them changes the amplitude and the other, divided by w a, the time. The second order
raises the amplitude on average by s^2/(2 a), as the length of a vector grows to which another is added.

A turning point measured on the samples of its half-cycle, from zero crossing to zero crossing, averages the
motion over it. The drive within the half-cycle enters the measured time in part: kicks in the quarter before
the turning point do not enter wholly, those in the quarter after it enter already. The motion responds to a
kick at the phase theta_0 by sin(theta - theta_0). For a least-squares fit of cosine and sine over the
half-cycle the error of the time has in either quarter the variance `SMEARED_VARIANCE` of a half-swing's step,
and the covariance `SMEARED_COVARIANCE` with it, negative in the quarter before and positive in the one after.
The effect on the amplitude is small and left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, nan
from typing import Annotated, NamedTuple

import numpy as np

from processing.arrays import Flags, Floats, Ints
from processing.estimate import NOT_DETERMINED, Estimate
from processing.kernel import kernel
from processing.quantity import PLAIN, Quantity

GROUND_SEEN = 6.63
"""Difference of -2 ln L from ground at rest above which a drive is stated and not bounded: chance 0.5 %."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of turning points, by the drive of the ground and by their measurement."""

    step: float = 0.0
    """Standard deviation by which the ground moves either quadrature of the oscillation in one half-swing, in
    the unit of the amplitudes that are fitted."""
    scale: float = 1.0
    """Factor on the stated uncertainties of the turning points."""
    averaged: bool = True
    """Whether they were measured on the samples of their half-cycles, and not at the instant of turning."""
    limit: float = inf
    """Turning points farther from their prediction, in standard uncertainties, do not move the next one."""

    @property
    def at_rest(self) -> bool:
        return self.step == 0

    @property
    def as_weights(self) -> "Noise":
        """The noise over `scale`, with which chi2/dof of weighted residuals is the square of the scale."""
        return AT_REST if self.at_rest else replace(self, step=self.step / self.scale, scale=1.0)


AT_REST = Noise()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """Drive of the pendulum by the ground during a run, by the turning points."""

    density_rad_per_s2_rthz: Estimate = NOT_DETERMINED
    """One-sided spectral density of the angular acceleration at the pendulum's frequency; without a
    calibration in the unit of the amplitudes instead of rad."""
    upper_95: Annotated[float, Quantity("", "bound of 95 %", unit="rad/s^2/sqrt(Hz)")] = nan
    seen: bool = False
    """False where the run sets no more than that bound."""
    measurement_scale: float = 1.0
    """Factor by which turning points scatter more than their stated uncertainties."""
    left_out_half_cycles: int = 0
    """Number of half-cycles at the end that were not fitted: the ground moves the pendulum in one half-swing
    by more than a tenth of its amplitude there, and amplitude and phase do not describe its motion."""
    widening: Annotated[Mapping[str, float], PLAIN] = field(default_factory=dict)
    """Ratio of the uncertainty of each parameter to that on ground at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundFit(Ground):
    """The ground's drive, and the likelihood from which it was estimated."""

    noise: Noise
    """The likeliest noise, its step in the unit of the amplitudes."""
    deviance: float = nan
    """-2 ln L of the turning points with this noise, restricted to the residuals of the fitted parameters, up
    to a constant that depends on their number and the law."""
    unrestricted: float = nan
    """Least -2 ln L of the turning points themselves over all noises, up to a constant that depends on their
    number; laws are compared by it."""


def density_of_step(step: float, half_period_s: float) -> float:
    """q for which either quadrature moves by `step` in a half-swing: ``2 w step / sqrt(T/2)``, w = 2 pi/T."""
    return float(2 * np.pi * step / half_period_s**1.5)


def step_of_density(density: float, half_period_s: float) -> float:
    """Inverse of `density_of_step`."""
    return float(density * half_period_s**1.5 / (2 * np.pi))


GAINS = 7
"""Numbers that the filter computes for a half-cycle and uses again where its gains are held."""

SMEARED_VARIANCE, SMEARED_COVARIANCE = 0.0670, 0.1757
"""Variance of an averaged time's error in either quarter, and its covariance with a half-swing's step, over
the variance of the step."""


class Predictions(NamedTuple):
    """A law's predictions of half-swings, for the filter."""

    nodes: Floats
    """(5, nodes) falling amplitude, loss, its slope, duration in s, its slope."""
    loss_by: Floats
    """(nodes, columns) derivatives of the loss with respect to the solver's columns at fixed amplitude."""
    duration_by: Floats
    start: Floats
    """(2,) amplitude and time of the first turning point."""
    start_by: Floats
    """(2, columns) their derivatives."""


class MeasuredTurningPoints(NamedTuple):
    """Turning points as measured, for the filter."""

    numbers: Ints
    """Numbers (half-cycles,) of the half-cycles, rising."""
    points: Floats
    """(2, half-cycles) amplitudes and times."""
    variance: Floats
    """(2, half-cycles) of their measurement."""
    rate: float
    """Angular frequency of the pendulum in rad/s."""
    averaged: bool
    """As in `Noise`."""


class KnownSteps(NamedTuple):
    """The known part of the drive, for the filter, in units of the reference."""

    steps: Floats
    """(2, half-swings + 1): change of the amplitude, and of the time times the amplitude, with the half-swing
    that ends at each turning point; empty where nothing is known."""
    by: Floats
    """(2, half-swings + 1, columns) derivatives of the steps."""
    unknown: Floats
    """(half-swings + 1,) variance of each amplitude by a drive that is not known, beyond the noise's step."""
    knocked: Flags
    """(half-swings + 1,) whether a knock fell into the half-swing: earlier turning points tell nothing of the
    state after it."""


NOTHING_KNOWN = KnownSteps(np.empty((2, 0)), np.empty((2, 0, 0)), np.empty(0), np.empty(0, np.bool_))
KNOCK = 0.3
"""Standard deviation of a knock's step, as a share of the amplitude; the fit takes larger ones as well."""


@kernel
def drive_filter(
    law: Predictions,
    measured: MeasuredTurningPoints,
    step: float,
    drive: KnownSteps,
    gains: Floats,
    held: bool,
    limit: float,
) -> tuple[Floats, Floats, float]:
    """Whitened innovations, their derivatives, and ln det of their covariance.

    Parameters
    ----------
    step
        Standard deviation of the drive's step, in units of the reference.
    gains
        (half-cycles, GAINS): the Kalman gain K (K_aa, K_at, K_ta, K_tt) and the whitening of
        the innovations (1/sd of the amplitude's, regression of the time's on it, 1/sd of the
        remainder). Written unless `held`.
    held
        Whether the gains are used as given: the innovations then depend on the columns by the predictions
        alone, and their derivatives are exact.
    limit
        Turning points with a larger innovation, in standard deviations, do not change the state.

    Returns
    -------
    innovations
        (2, half-cycles): those of the amplitudes, and those of the times less their regression on them.
        NaN if the law cannot be evaluated at a state.
    jacobian
        (2, half-cycles, columns), at fixed gains.
    log_det
        Over all half-cycles; 0 if `held`.
    """
    nodes, loss_by, duration_by, start, start_by = law
    index, points, variance, rate, averaged = measured
    known, known_by, unknown, knocked = drive
    count, columns = len(index), loss_by.shape[1]
    last = nodes.shape[1] - 1
    innovations = np.full((2, count), np.nan)
    jacobian = np.full((2, count, columns), np.nan)
    log_det = 0.0
    a, t = start[0], start[1]
    a_by, t_by = start_by[0].copy(), start_by[1].copy()
    p_aa, p_at, p_tt = 0.0, 0.0, 0.0
    s2 = step * step
    is_driven = known.shape[1] > 0
    k = 0
    if last < 1:
        return innovations, jacobian, log_det
    for i in range(count):
        halves = index[i] - index[i - 1] if i > 0 else 0
        if i == 0 and is_driven:
            a += known[0, 0]
            t += known[1, 0] / a
            for j in range(columns):
                a_by[j] += known_by[0, 0, j]
                t_by[j] += (known_by[1, 0, j] - known[1, 0] / a * a_by[j]) / a
        for half in range(halves):
            if not a > 0.0:
                return innovations, jacobian, log_det
            number = index[i] - halves + 1 + half
            if is_driven:
                s2 = step * step + unknown[number]
            # the interval of the nodes that holds the amplitude, or the outermost one
            while k > 0 and a > nodes[0, k]:
                k -= 1
            while k < last - 1 and a < nodes[0, k + 1]:
                k += 1
            width = nodes[0, k + 1] - nodes[0, k]
            u = min(max((a - nodes[0, k]) / width, 0.0), 1.0)
            beyond = a - (nodes[0, k] + u * width)
            h00, h01 = (1 + 2 * u) * (1 - u) * (1 - u), u * u * (3 - 2 * u)
            h10, h11 = u * (1 - u) * (1 - u) * width, u * u * (u - 1) * width
            d00 = 6 * u * (u - 1) / width
            d10, d11 = (1 - u) * (1 - 3 * u), u * (3 * u - 2)
            loss = h00 * nodes[1, k] + h01 * nodes[1, k + 1] + h10 * nodes[2, k] + h11 * nodes[2, k + 1]
            loss_slope = d00 * (nodes[1, k] - nodes[1, k + 1]) + d10 * nodes[2, k] + d11 * nodes[2, k + 1]
            time = h00 * nodes[3, k] + h01 * nodes[3, k + 1] + h10 * nodes[4, k] + h11 * nodes[4, k + 1]
            time_slope = d00 * (nodes[3, k] - nodes[3, k + 1]) + d10 * nodes[4, k] + d11 * nodes[4, k + 1]
            keep = 1.0 - loss_slope - 0.5 * s2 / (a * a)
            for j in range(columns):
                t_by[j] += time_slope * a_by[j] + (1 - u) * duration_by[k, j] + u * duration_by[k + 1, j]
                a_by[j] = keep * a_by[j] - (1 - u) * loss_by[k, j] - u * loss_by[k + 1, j]
            t += time + time_slope * beyond
            p_tt += time_slope * (2 * p_at + time_slope * p_aa)
            if not (averaged and half == 0):
                p_tt += s2 / (rate * rate * a * a)
            p_at = keep * (p_at + time_slope * p_aa)
            p_aa = keep * keep * p_aa + s2
            if is_driven and knocked[number]:
                p_aa += KNOCK * KNOCK * a * a
                p_tt += KNOCK * KNOCK / (rate * rate)
            a += 0.5 * s2 / a - loss - loss_slope * beyond
            if is_driven:
                # the amplitude changes while the half-swing lasts, on average in its middle
                t += 0.5 * time_slope * known[0, number]
                for j in range(columns):
                    t_by[j] += 0.5 * time_slope * known_by[0, number, j]
                # counted from the phase in the middle of the half-swing, which has no second order
                a += 0.5 * known[0, number]
                t += known[1, number] / a
                for j in range(columns):
                    a_by[j] += 0.5 * known_by[0, number, j]
                    t_by[j] += (known_by[1, number, j] - known[1, number] / a * a_by[j]) / a
                    a_by[j] += 0.5 * known_by[0, number, j]
                a += 0.5 * known[0, number]
        gain = gains[i]
        v_a, v_t = points[0, i] - a, points[1, i] - t
        if not held:
            s_aa, s_tt = p_aa + variance[0, i], p_tt + variance[1, i]
            g_tt = p_tt  # covariance of the measured time with the state that goes on
            step_of_time = s2 / (rate * rate * a * a)
            following = step_of_time
            if is_driven:
                to_come = unknown[index[i] + 1] if index[i] + 1 < len(unknown) else 0.0
                following = (step * step + to_come) / (rate * rate * a * a)
            if averaged:
                # what the time tells of the half-swing to come is put into the state at once
                s_tt += SMEARED_VARIANCE * (step_of_time + following)
                g_tt += SMEARED_COVARIANCE * following
                p_tt += following
                if i > 0:
                    s_tt -= 2 * SMEARED_COVARIANCE * step_of_time
                    g_tt -= SMEARED_COVARIANCE * step_of_time
            det = s_aa * s_tt - p_at * p_at
            gain[0] = (p_aa * s_tt - p_at * p_at) / det
            gain[1] = p_at * (s_aa - p_aa) / det
            gain[2] = p_at * (s_tt - g_tt) / det
            gain[3] = (g_tt * s_aa - p_at * p_at) / det
            gain[4] = 1.0 / np.sqrt(s_aa)
            gain[5] = p_at / s_aa
            gain[6] = np.sqrt(s_aa / det)
            log_det += np.log(det)
            far = abs(v_a) * gain[4] > limit or abs(v_t - gain[5] * v_a) * gain[6] > limit
            if far:
                gain[:4] = 0.0
            p_tt -= gain[2] * p_at + gain[3] * g_tt
            p_aa, p_at = (
                p_aa - gain[0] * p_aa - gain[1] * p_at,
                p_at - gain[0] * p_at - gain[1] * g_tt,
            )
        innovations[0, i] = -v_a * gain[4]
        innovations[1, i] = -(v_t - gain[5] * v_a) * gain[6]
        a += gain[0] * v_a + gain[1] * v_t
        t += gain[2] * v_a + gain[3] * v_t
        for j in range(columns):
            jacobian[0, i, j] = a_by[j] * gain[4]
            jacobian[1, i, j] = (t_by[j] - gain[5] * a_by[j]) * gain[6]
            by_a, by_t = a_by[j], t_by[j]
            a_by[j] = by_a - gain[0] * by_a - gain[1] * by_t
            t_by[j] = by_t - gain[2] * by_a - gain[3] * by_t
    return innovations, jacobian, log_det
