"""Least-squares fit of a slow and a fast damped ellipse: terms, normal equations, search for spectral lines.

The model is given in `modes`.
"""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints, Vector
from processing.kernel import kernel


@kernel
def fit_sinusoid(rate: float, time_s: Vector, value: Vector, weight: Vector) -> tuple[float, float, float]:
    """Fit ``c cos(rate t) + s sin(rate t)``.

    Returns the reduction of chi-square, c and s; zeros if the samples do not determine them.
    """
    cc = cs = ss = c_value = s_value = 0.0
    for i in range(len(time_s)):
        c, s = math.cos(rate * time_s[i]), math.sin(rate * time_s[i])
        cc += weight[i] * c * c
        cs += weight[i] * c * s
        ss += weight[i] * s * s
        c_value += weight[i] * c * value[i]
        s_value += weight[i] * s * value[i]
    return _sinusoid_of_sums(cc, cs, ss, c_value, s_value)


@kernel
def _sinusoid_of_sums(
    cc: float, cs: float, ss: float, c_value: float, s_value: float
) -> tuple[float, float, float]:
    """The result of `fit_sinusoid` from the weighted sums of products of cosine, sine and value."""
    determinant = cc * ss - cs * cs
    if not determinant > 1e-6 * cc * ss:
        return 0.0, 0.0, 0.0
    cosine = (ss * c_value - cs * s_value) / determinant
    sine = (cc * s_value - cs * c_value) / determinant
    return cosine * c_value + sine * s_value, cosine, sine


TERMS = 18
SLOW_RATE, SLOW_DAMPING, FAST_RATE, FAST_DAMPING, ROTATION, BROADENING = range(6)
"""Indices of the terms shared by both coordinates: angular frequency and damping of each mode, and the real
and the imaginary part of the coupling k (see `modes`)."""
FIRST_X_TERM, FIRST_Y_TERM = 6, 12
"""Indices of the first of the six linear terms of each coordinate."""
REST, DRIFT, SLOW_COSINE, SLOW_SINE, FAST_COSINE, FAST_SINE = range(6)
"""Order of the linear terms of a coordinate, counted from its first."""
FAST_AMPLITUDES = [
    first + term for first in (FIRST_X_TERM, FIRST_Y_TERM) for term in (FAST_COSINE, FAST_SINE)
]
_TERMS_PER_COORDINATE = 12
"""Number of terms on which a coordinate depends: those that both share, and its linear ones."""
ALL_TERMS = list(range(TERMS))
SLOW_TERMS = [k for k in ALL_TERMS if k not in (FAST_RATE, FAST_DAMPING, *FAST_AMPLITUDES)]
_DIAGONAL = np.diag_indices(TERMS)
_MAX_STEPS = 8
_MIN_INFORMATION = 1e-8
"""Smallest squared diagonal of the Cholesky factor of the scaled information; below it rounding errors
dominate."""
_MAX_NOISE_CHI2 = 4.0
"""Chi-square per sample of pure noise whose uncertainty is understated by a factor of two."""
_FALSE_ALARM_PROBABILITY = 1e-7
"""Probability that a search takes noise for a fast mode. A run makes some hundred searches, each
through all frequencies: see `bench_modes` for false detections in a thousand runs."""
MIN_FAST_RATE_RATIO, MAX_FAST_RATE_RATIO = 2.2, 25.0
"""Range in which a fast mode is searched for, in multiples of the slow mode's frequency."""
_MIN_FITTED_RATE_RATIO = 1.5
"""Smallest such multiple of a fitted fast mode, which may leave the range of the search."""


class ModeSamples(NamedTuple):
    """Samples of both coordinates."""

    t: Floats
    """Times in s from the middle of the samples."""
    x: Floats
    y: Floats
    weights_x: Floats
    weights_y: Floats
    """Inverse variances of the coordinates."""

    @property
    def span_s(self) -> float:
        return float(self.t[-1] - self.t[0])


class ModeFit(NamedTuple):
    """Fit of the `active` terms."""

    p: Floats
    """(TERMS,) fitted terms."""
    covariance: Floats
    """(TERMS, TERMS) covariance of the terms."""
    active: list[int]
    """Indices of the free terms."""
    chi2: float
    residual_x: Floats
    residual_y: Floats
    """(n,) residuals of each coordinate."""

    def explains(self, samples: ModeSamples) -> bool:
        """Whether the fit explains more than half of the variation, and nearly all that is not noise.

        The second condition rejects a record in which the pendulum rests for a part of the time.
        """
        _, x, y, weights_x, weights_y = samples
        variation = float(((x - x.mean()) ** 2 * weights_x + (y - y.mean()) ** 2 * weights_y).sum())
        noise = _MAX_NOISE_CHI2 * 2 * len(x)
        return self.chi2 < 0.5 * variation and (self.chi2 < noise or self.chi2 < 0.05 * variation)


def slow_fit(samples: ModeSamples, slow_period_s: float) -> ModeFit | None:
    """Fit of the slow mode alone; None if it does not explain the samples.

    If `slow_period_s` is NaN, the fit starts from the strongest spectral line.
    """
    if math.isnan(slow_period_s):
        spacing = 0.5 * math.pi / samples.span_s
        highest = min(0.8 * math.pi * len(samples.t) / samples.span_s, 400.0 * spacing)
        lowest = 1.6 * math.pi / samples.span_s
        count = math.ceil((highest - lowest) / spacing)
        if count < 1:
            return None
        centred = samples._replace(x=samples.x - samples.x.mean(), y=samples.y - samples.y.mean())
        rate = _strongest(*centred, lowest, spacing, count)[0]
    else:
        rate = 2.0 * math.pi / slow_period_s
    start = np.zeros(TERMS)
    start[SLOW_RATE] = rate
    fit = fit_terms(start, SLOW_TERMS, samples, rate)
    return fit if fit.explains(samples) else None


def with_fast_mode(slow: ModeFit, samples: ModeSamples) -> tuple[ModeFit, float]:
    """Fit with a fast mode if one is significant, else the slow fit; and the amplitude in x it could have.

    That amplitude is 0.0 with a fast mode. Without one it is that of the strongest spectral line in the
    residuals, NaN if the samples cannot show one.
    """
    slow_rate = float(slow.p[SLOW_RATE])
    highest = min(MAX_FAST_RATE_RATIO * slow_rate, 0.8 * math.pi * len(samples.t) / samples.span_s)
    lowest, spacing = MIN_FAST_RATE_RATIO * slow_rate, math.pi / samples.span_s
    count = math.ceil((highest - lowest) / spacing)
    if count < 1:
        return slow, math.nan
    residuals = samples._replace(x=slow.residual_x, y=slow.residual_y)
    rate, limit = _strongest(*residuals, lowest, spacing, count)
    start = slow.p.copy()
    start[FAST_RATE] = rate
    fit = fit_terms(start, ALL_TERMS, samples, slow_rate)
    is_fast = fit.p[FAST_RATE] > _MIN_FITTED_RATE_RATIO * fit.p[SLOW_RATE]
    if is_fast and fast_mode_is_significant(fit, count):
        return fit, 0.0
    return slow, limit


def fast_mode_is_significant(fit: ModeFit, frequencies: int = 1) -> bool:
    """Whether the fast mode's four amplitudes together differ significantly from zero (Wald test).

    `frequencies` is the number of frequencies of the search, the strongest of which is strong by chance.
    """
    limit = 2.0 * math.log(frequencies / _FALSE_ALARM_PROBABILITY)
    # chi-square of four degrees of freedom: its tail exp(-w/2) (1 + w/2) is solved for w by iteration
    for _ in range(20):
        limit = 2.0 * math.log((1.0 + 0.5 * limit) * frequencies / _FALSE_ALARM_PROBABILITY)
    amplitudes = fit.p[FAST_AMPLITUDES]
    scale = fit.chi2 / max(2 * len(fit.residual_x) - TERMS, 1)
    covariance = fit.covariance[np.ix_(FAST_AMPLITUDES, FAST_AMPLITUDES)] * max(scale, 1.0)
    try:
        return bool(amplitudes @ np.linalg.solve(covariance, amplitudes) > limit)
    except np.linalg.LinAlgError:
        return False


def fit_terms(p: Floats, active: list[int], samples: ModeSamples, slow_rate: float) -> ModeFit:
    """Fit the `active` terms by Gauss-Newton, starting from `p` (TERMS,); `slow_rate` in rad/s."""
    indices = np.array(active)
    p = p.copy()
    rates, slow_changes = [SLOW_RATE, FAST_RATE], [SLOW_DAMPING, FAST_DAMPING, ROTATION, BROADENING]
    ridge = np.zeros(TERMS)
    # a weak prior excludes oscillations damped out within a period, and ellipses that rotate as fast
    ridge[slow_changes] = 1.0 / (0.2 * slow_rate) ** 2
    covariance = np.zeros((TERMS, TERMS))
    max_rate_step = 0.5 * math.pi / samples.span_s
    max_slow_change = 6.0 * max_rate_step
    for step in range(_MAX_STEPS):
        information, score, _, _, _ = _equations(p, *samples)
        information[_DIAGONAL] += ridge
        score -= ridge * p
        change, covariance = _step(information, score, indices)
        change[rates] = np.clip(change[rates], -max_rate_step, max_rate_step)
        p += change
        p[slow_changes] = np.clip(p[slow_changes], -max_slow_change, max_slow_change)
        # The error left by a step of the rates is proportional to its square. The first steps find the
        # amplitudes only, so that convergence is not judged by them.
        if step > 1 and (np.abs(change[rates]) <= 0.01 * np.sqrt(covariance[rates, rates])).all():
            break
    _, _, chi2, residual_x, residual_y = _equations(p, *samples)
    return ModeFit(p, covariance, active, chi2, residual_x, residual_y)


def _step(information: Floats, score: Floats, indices: Ints) -> tuple[Floats, Floats]:
    """Change of the terms with these indices, and their covariance. Terms without any information do not
    change, nor do combinations of terms that nothing determines."""
    informed = indices[information[indices, indices] > 0.0]
    block = np.ix_(informed, informed)
    scale = information[informed, informed] ** -0.5
    scaled = information[block] * np.outer(scale, scale)
    try:
        inverse_root = np.linalg.inv(np.linalg.cholesky(scaled))
        inverse = inverse_root.T @ inverse_root
        is_determined = bool(inverse_root.diagonal().max() ** -2 > _MIN_INFORMATION)
    except np.linalg.LinAlgError:
        is_determined = False
    if not is_determined:
        inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    change, covariance = np.zeros(TERMS), np.zeros((TERMS, TERMS))
    covariance[block] = inverse * np.outer(scale, scale)
    change[informed] = covariance[block] @ score[informed]
    return change, covariance


@kernel
def _equations(
    p: Floats, t: Floats, x: Floats, y: Floats, weights_x: Floats, weights_y: Floats
) -> tuple[Floats, Floats, float, Floats, Floats]:
    """Information matrix and score in all terms, chi-square, residuals in x and y. The coupling k makes the
    slow motion X + k t Y in x, and Y - k t X in y (see `modes`)."""
    information, score = np.zeros((TERMS, TERMS)), np.zeros(TERMS)
    # sums of each coordinate, whose terms are side by side: the innermost loop takes several at once
    size = _TERMS_PER_COORDINATE
    sums, scores = np.zeros((2, size, size)), np.zeros((2, size))
    residual_x, residual_y = np.empty(len(t)), np.empty(len(t))
    row = np.empty(size)
    chi2 = 0.0
    for i in range(len(t)):
        time_s = t[i]
        slow, fast = math.exp(-p[SLOW_DAMPING] * time_s), math.exp(-p[FAST_DAMPING] * time_s)
        slow_c, slow_s = slow * math.cos(p[SLOW_RATE] * time_s), slow * math.sin(p[SLOW_RATE] * time_s)
        fast_c, fast_s = fast * math.cos(p[FAST_RATE] * time_s), fast * math.sin(p[FAST_RATE] * time_s)
        # derivatives with respect to the linear terms of a coordinate, in their order
        row[FIRST_X_TERM + REST], row[FIRST_X_TERM + DRIFT] = 1.0, time_s
        row[FIRST_X_TERM + SLOW_COSINE], row[FIRST_X_TERM + SLOW_SINE] = slow_c, slow_s
        row[FIRST_X_TERM + FAST_COSINE], row[FIRST_X_TERM + FAST_SINE] = fast_c, fast_s
        for coordinate in range(2):
            first = FIRST_X_TERM if coordinate == 0 else FIRST_Y_TERM
            other = FIRST_Y_TERM if coordinate == 0 else FIRST_X_TERM
            signed_time_s = time_s if coordinate == 0 else -time_s
            # the other coordinate's slow motion, and the same a quarter of a period later
            in_phase = p[other + SLOW_COSINE] * slow_c + p[other + SLOW_SINE] * slow_s
            in_quadrature = p[other + SLOW_SINE] * slow_c - p[other + SLOW_COSINE] * slow_s
            cosine = p[first + SLOW_COSINE] + signed_time_s * (
                p[ROTATION] * p[other + SLOW_COSINE] + p[BROADENING] * p[other + SLOW_SINE]
            )
            sine = p[first + SLOW_SINE] + signed_time_s * (
                p[ROTATION] * p[other + SLOW_SINE] - p[BROADENING] * p[other + SLOW_COSINE]
            )
            slow_part = cosine * slow_c + sine * slow_s
            fast_part = p[first + FAST_COSINE] * fast_c + p[first + FAST_SINE] * fast_s
            row[SLOW_RATE] = time_s * (sine * slow_c - cosine * slow_s)
            row[SLOW_DAMPING] = -time_s * slow_part
            row[FAST_RATE] = time_s * (p[first + FAST_SINE] * fast_c - p[first + FAST_COSINE] * fast_s)
            row[FAST_DAMPING] = -time_s * fast_part
            row[ROTATION] = signed_time_s * in_phase
            row[BROADENING] = signed_time_s * in_quadrature
            model = p[first + REST] + p[first + DRIFT] * time_s + slow_part + fast_part
            if coordinate == 0:
                residual, weight = x[i] - model, weights_x[i]
                residual_x[i] = residual
            else:
                residual, weight = y[i] - model, weights_y[i]
                residual_y[i] = residual
            chi2 += weight * residual * residual
            for j in range(_TERMS_PER_COORDINATE):
                weighted = weight * row[j]
                scores[coordinate, j] += weighted * residual
                for k in range(_TERMS_PER_COORDINATE):
                    sums[coordinate, j, k] += weighted * row[k]
    for coordinate in range(2):
        shift = 0 if coordinate == 0 else FIRST_Y_TERM - FIRST_X_TERM
        for j in range(size):
            index = j if j < FIRST_X_TERM else j + shift
            score[index] += scores[coordinate, j]
            for k in range(size):
                information[index, k if k < FIRST_X_TERM else k + shift] += sums[coordinate, j, k]
    return information, score, chi2, residual_x, residual_y


@kernel
def _strongest(
    t: Floats,
    x: Floats,
    y: Floats,
    weights_x: Floats,
    weights_y: Floats,
    first: float,
    spacing: float,
    count: int,
) -> tuple[float, float]:
    """Angular frequency of the strongest line, by its power in both coordinates, and its amplitude in x. The
    `count` frequencies from `first` on are evenly spaced: a recursion replaces the cosines."""
    turn_c, turn_s = np.cos(spacing * t), np.sin(spacing * t)
    phase_c, phase_s = np.cos(first * t), np.sin(first * t)
    best_power, best_index, best_x = -1.0, 0, 0.0
    for index in range(count):
        cc_x = cs_x = ss_x = c_x = s_x = 0.0
        cc_y = cs_y = ss_y = c_y = s_y = 0.0
        for i in range(len(t)):
            c, s = phase_c[i], phase_s[i]
            c_weight, s_weight = weights_x[i] * c, weights_x[i] * s
            cc_x += c_weight * c
            cs_x += c_weight * s
            ss_x += s_weight * s
            c_x += c_weight * x[i]
            s_x += s_weight * x[i]
            c_weight, s_weight = weights_y[i] * c, weights_y[i] * s
            cc_y += c_weight * c
            cs_y += c_weight * s
            ss_y += s_weight * s
            c_y += c_weight * y[i]
            s_y += s_weight * y[i]
            phase_c[i] = c * turn_c[i] - s * turn_s[i]
            phase_s[i] = s * turn_c[i] + c * turn_s[i]
        power_x, cosine, sine = _sinusoid_of_sums(cc_x, cs_x, ss_x, c_x, s_x)
        power_y, _, _ = _sinusoid_of_sums(cc_y, cs_y, ss_y, c_y, s_y)
        if power_x + power_y > best_power:
            best_power, best_index, best_x = power_x + power_y, index, math.hypot(cosine, sine)
    return first + best_index * spacing, best_x
