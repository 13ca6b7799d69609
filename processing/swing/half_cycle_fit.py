"""Fit of one half-cycle to its samples, with the prediction from earlier half-cycles as a prior.

The same linearised equations give two solutions. The *local* solution is reported: amplitude and time
come from this half-cycle's own samples, and the prior covers only shape, frequency, centre and fast
mode. Errors of neighbouring half-cycles thus remain nearly independent. The *full* solution also uses the
predicted amplitude and time; it is the Kalman filter's updated state, carried on to the next half-cycle.

With the derivatives J of the model at the present state x0, the samples' weights W and residuals r,
H = J^T W J and g = J^T W r, a prior of mean m and precision S gives

    x = x0 + (H + S)^-1 [g + S (m - x0)]

For the full solution S is the inverse of the predicted covariance. For the local solution the rows and
columns of amplitude and time in S are zero (no prior), and the remaining block is the inverse of the
corresponding block of the covariance.
"""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Ints, Matrix, Vector
from processing.kernel import kernel
from processing.noise_models import MAD_TO_SIGMA
from processing.swing.half_cycle import (
    AMPLITUDE,
    CENTRE,
    DRIFT,
    RATE,
    SHAPE,
    TIME,
    invert,
    linearise,
    normal_equations,
    tabulate_state,
)
from processing.swing.small_matrices import add, dot, quadratic, sort, times
from processing.swing.waveform import NODES, SHAPES, N, P

SEGMENTS = 8
"""Number of parts of the half-cycle in which a short disturbance is looked for."""
SLOW_ORDERS = (4, 5, 6)
"""Orders of a cosine series over the half-cycle that show slow noise: 4 to 6 times the pendulum's frequency.
Lower orders are mostly fitted by amplitude, time, centre and drift."""
_MIN_SLOW_SAMPLES = 24
"""Fewest samples that show slow noise."""
OUTLIER_U = 6.0
"""Standard deviations beyond which a sample is an outlier: of noise alone 2e-9 of the samples."""
_MAX_ITERATIONS = 4
_MIN_DRIFT_SIGNIFICANCE = 2.5
"""Significance of the drift, in standard uncertainties, above which it is used."""
_MAX_LINEARISATION_ERROR = 0.02
"""Allowed error of the linearisation, as a fraction of the amplitude's uncertainty."""


class HalfCycleFit(NamedTuple):
    """Local amplitude and time with uncertainties, the full solution, and the quality of the fit."""

    valid: bool
    """Whether there is a solution; without one every float but `gap_s` is NaN."""
    amplitude: float
    time_s: float
    """Time of the turning point since the reference time."""
    u_amplitude: float
    u_time_s: float
    centre: float
    """Rest position at the turning point, unit of the deflection."""
    resolution: float
    """Uncertainty that the amplitude would have if all else were known, unit of the deflection."""
    chi2: float
    """Chi-square of the samples at the local solution, with their uncertainties as given (no noise scale)."""
    samples: int
    outliers: int
    worst_segment: float
    """Largest chi-square per sample of one of SEGMENTS parts of the half-cycle, without noise scale too."""
    slow_power: float
    """Mean power of the residuals in the bands of `SLOW_ORDERS`, in units of white noise of the samples'
    uncertainties as given; NaN with fewer than `_MIN_SLOW_SAMPLES` samples."""
    normalised_innovation: float
    """Chi-square (two degrees of freedom) of the local amplitude and time against the prediction."""
    gap_s: float
    """Longest gap between samples within the window, s."""
    state: Vector
    """Full solution (STATES,)."""
    covariance: Matrix
    """(STATES, STATES) covariance of the full solution."""


@kernel
def excess(chi2: float, degrees: float) -> float:
    """Chi-square converted to a standard normal deviate (Wilson and Hilferty 1931)."""
    if degrees < 1.0:
        return 0.0
    variance = 2.0 / (9.0 * degrees)
    return float(((chi2 / degrees) ** (1.0 / 3.0) - 1.0 + variance) / math.sqrt(variance))


@kernel
def _longest_gap(tau: Vector, deflection: Vector, start: float, end: float) -> float:
    """Longest gap between samples within the window, s."""
    gap, last = 0.0, start
    for i in range(len(tau)):
        if deflection[i] == deflection[i]:
            gap = max(gap, tau[i] - last)
            last = tau[i]
    return max(gap, end - last)


@kernel
def segment_size(count: int) -> int:
    """Number of samples in each of SEGMENTS parts."""
    return max(count // SEGMENTS, 4)


@kernel
def _worst_segment(residual: Vector, weight: Vector, count: int) -> float:
    """Largest chi-square per sample of SEGMENTS parts: the chi-square of all hides a short disturbance."""
    size = segment_size(count)
    worst, total, n = 0.0, 0.0, 0
    for i in range(len(residual)):
        if weight[i] > 0.0 and residual[i] == residual[i]:
            total += weight[i] * residual[i] * residual[i]
            n += 1
            if n == size:
                worst = max(worst, total / n)
                total, n = 0.0, 0
    return worst


@kernel
def _slow_power(tau: Vector, residual: Vector, weight: Vector, count: int, start: float, end: float) -> float:
    """Mean of the residuals' squared projections on `SLOW_ORDERS`; 1 for white noise of the weights."""
    if count < _MIN_SLOW_SAMPLES:
        return math.nan
    power = 0.0
    for order in SLOW_ORDERS:
        projection, norm = 0.0, 0.0
        for i in range(len(tau)):
            if weight[i] > 0.0 and residual[i] == residual[i]:
                cosine = math.cos(math.pi * order * (tau[i] - start) / (end - start))
                projection += weight[i] * residual[i] * cosine
                norm += weight[i] * cosine * cosine
        power += projection * projection / norm
    return power / len(SLOW_ORDERS)


@kernel
def _reject_outliers(residual: Vector, jacobian: Matrix, step: Vector, weight: Vector) -> int:
    """Set the weight of outliers to 0; returns the number of new ones. The robust scatter is a limit, too: a
    single outlier shifts the fit, so that residuals of good samples are large."""
    n = len(residual)
    size, count, largest = np.empty(n), 0, 0.0
    for i in range(n):
        if weight[i] > 0.0 and residual[i] == residual[i]:
            remainder = residual[i]
            for k in range(len(step)):
                remainder -= jacobian[i, k] * step[k]
            size[count] = abs(remainder) * math.sqrt(weight[i])
            largest = max(largest, size[count])
            count += 1
    if largest <= OUTLIER_U:
        return 0
    ordered = size[:count].copy()
    sort(ordered, count)
    median = 0.5 * (ordered[(count - 1) // 2] + ordered[count // 2])
    threshold = OUTLIER_U * max(1.0, MAD_TO_SIGMA * median)
    outliers, k = 0, 0
    for i in range(n):
        if weight[i] > 0.0 and residual[i] == residual[i]:
            if size[k] > threshold:
                weight[i] = 0.0
                outliers += 1
            k += 1
    return outliers


@kernel
def _forget_drift(mean: Vector, covariance: Matrix, active: Ints) -> None:
    """Condition the prior on drift = 0 if the drift is not significant, with its variance v and column c:
    mean <- mean - c drift/v, C <- C - c c^T/v. The centre then scatters four times less."""
    for d in range(len(active)):
        if active[d] != DRIFT:
            continue
        variance = covariance[d, d]
        if not mean[DRIFT] ** 2 < _MIN_DRIFT_SIGNIFICANCE**2 * variance:
            return
        column = np.empty(len(active))
        for i in range(len(active)):
            column[i] = covariance[i, d]
        for i in range(len(active)):
            mean[active[i]] -= column[i] * mean[DRIFT] / variance if i != d else 0.0
            for j in range(len(active)):
                covariance[i, j] -= column[i] * column[j] / variance
        mean[DRIFT] = 0.0
        for i in range(len(active)):
            covariance[i, d] = covariance[d, i] = 0.0
        covariance[d, d] = 1e-6 * variance


@kernel
def fit_half_cycle(
    x: Vector,
    covariance: Matrix,
    anchor: Vector,
    side: float,
    reference: float,
    active: Ints,
    noise_scale: float,
    calm: bool,
    start: float,
    end: float,
    tau: Vector,
    deflection: Vector,
    u_deflection: Vector,
) -> HalfCycleFit:
    """Fit one half-cycle by Gauss-Newton, with rejection of outliers.

    Parameters
    ----------
    x, covariance : predicted state and its covariance (see `half_cycle`)
    anchor : state about whose shape terms the waveform is expanded (see `tabulate_state`)
    side : +1.0 or -1.0, sign of the deflection at the turning point
    reference : amplitude to which the shape terms in `x` refer
    active : free entries of the state, ascending; AMPLITUDE and TIME must be the first two
    noise_scale : factor on every standard uncertainty
    calm : whether an insignificant drift may be set to zero
    start, end : window of the half-cycle, s after the reference time
    tau, deflection, u_deflection : (n,) samples in the window; NaN deflections are ignored
    """
    k = len(active)
    n = len(tau)
    gap = _longest_gap(tau, deflection, start, end)
    table = np.zeros((2 + SHAPES, NODES, 2))
    turn = np.zeros((2, 2 + SHAPES))
    residual, jacobian = np.empty(n), np.empty((n, k))
    information, score = np.empty((k, k)), np.empty(k)
    full_prior, local_prior = np.zeros((k, k)), np.zeros((k, k))
    prior_covariance, precision = np.empty((k, k)), np.empty((k, k))
    for i in range(k):
        for j in range(k):
            prior_covariance[i, j] = covariance[active[i], active[j]]
    valid = invert(prior_covariance, full_prior)
    mean = x.copy()
    if calm:
        _forget_drift(mean, prior_covariance, active)
    # prior of the local solution: the inverse of the covariance without amplitude and time, which are free
    block, inverse_block = np.empty((k - 2, k - 2)), np.empty((k - 2, k - 2))
    for i in range(k - 2):
        for j in range(k - 2):
            block[i, j] = prior_covariance[2 + i, 2 + j]
    valid = invert(block, inverse_block) and valid
    for i in range(k - 2):
        for j in range(k - 2):
            local_prior[2 + i, 2 + j] = inverse_block[i, j]
    weight = np.empty(n)
    for i in range(n):
        usable = deflection[i] == deflection[i] and u_deflection[i] > 0.0
        weight[i] = 1.0 / (noise_scale * u_deflection[i]) ** 2 if usable else 0.0
    current, local = x.copy(), np.zeros(k)
    local_covariance = np.empty((k, k))
    outliers, count, chi2 = 0, 0, math.nan
    for iteration in range(_MAX_ITERATIONS):
        if not valid:
            break
        tabulate_state(current, anchor, reference, active, table, turn)
        linearise(current, side, active, table, tau, deflection, residual, jacobian)
        while True:
            chi2, count = normal_equations(residual, jacobian, weight, information, score)
            add(information, local_prior, precision)
            valid = count > 4 and invert(precision, local_covariance)
            if not valid:
                break
            right = score.copy()
            for i in range(k):
                for j in range(2, k):
                    right[i] += local_prior[i, j] * (mean[active[j]] - current[active[j]])
            times(local_covariance, right, local)
            new_outliers = _reject_outliers(residual, jacobian, local, weight)
            outliers += new_outliers
            if new_outliers == 0:
                break
        if not valid:
            break
        # amplitude and time are always active and come first. The relative error of the linearisation is
        # about the square of the step.
        phase = abs(local[TIME] * current[RATE])
        u_amplitude = math.sqrt(local_covariance[AMPLITUDE, AMPLITUDE])
        step = phase + abs(local[AMPLITUDE] / current[AMPLITUDE])
        for i in range(k):
            entry = active[i]
            if SHAPE <= entry < SHAPE + SHAPES:
                # the exponents change terms that are themselves small
                is_exponent = entry == SHAPE + P or entry == SHAPE + N
                step += abs(local[i]) * (0.05 if is_exponent else 1.0)
            elif entry == RATE:
                step += abs(local[i] / current[RATE])
        if phase > 1.0:
            valid = False
            break
        is_linear = abs(current[AMPLITUDE]) * step * step < _MAX_LINEARISATION_ERROR * u_amplitude
        if is_linear or iteration == _MAX_ITERATIONS - 1:
            break
        for i in range(k):
            current[active[i]] += local[i]
        valid = current[AMPLITUDE] > 0.0
    state, posterior = current.copy(), covariance.copy()
    if not valid:
        return HalfCycleFit(
            False, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, count, outliers,
            math.nan, math.nan, math.nan, gap, state, posterior,
        )  # fmt: skip
    full_covariance, full = np.empty((k, k)), np.zeros(k)
    add(information, full_prior, precision)
    valid = invert(precision, full_covariance)
    right, offset, away = np.empty(k), np.empty(k), np.empty(k)
    for j in range(k):
        offset[j] = x[active[j]] - current[active[j]]
    times(full_prior, offset, right)
    for j in range(k):
        right[j] += score[j]
    times(full_covariance, right, full)
    # The cost of a step d is chi2 - 2 d.g + d.H d from the samples and (d - e).S (d - e) from the prior, with
    # e = m - x0. The difference of the two solutions' costs is the chi-square of amplitude and time against
    # their prediction.
    for j in range(k):
        away[j] = full[j] - offset[j]
    cost_full = chi2 - 2.0 * dot(full, score) + quadratic(information, full) + quadratic(full_prior, away)
    for j in range(k):
        away[j] = local[j] - (mean[active[j]] - current[active[j]])
    chi2_local = chi2 - 2.0 * dot(local, score) + quadratic(information, local)
    cost_local = chi2_local + quadratic(local_prior, away)
    for i in range(k):
        state[active[i]] += full[i]
        for j in range(k):
            posterior[active[i], active[j]] = full_covariance[i, j]
    total_weight = 0.0
    for i in range(n):
        residual[i] -= dot(jacobian[i], local)
        total_weight += weight[i]
    local_state = current.copy()
    for i in range(k):
        local_state[active[i]] += local[i]
    u_amplitude = math.sqrt(local_covariance[AMPLITUDE, AMPLITUDE])
    u_time = math.sqrt(local_covariance[TIME, TIME])
    centre = local_state[CENTRE] + local_state[DRIFT] * local_state[TIME]
    worst_segment = _worst_segment(residual, weight, count) * noise_scale * noise_scale
    slow_power = _slow_power(tau, residual, weight, count, start, end) * noise_scale * noise_scale
    return HalfCycleFit(
        valid, local_state[AMPLITUDE], local_state[TIME], u_amplitude, u_time, centre,
        math.sqrt(2.0 / total_weight), chi2_local * noise_scale * noise_scale, count, outliers, worst_segment,
        slow_power, cost_full - cost_local, gap, state, posterior,
    )  # fmt: skip
