"""Least-squares fit of a slow and a fast damped ellipse: terms, normal equations, search for spectral lines.

The model is given in `modes`.
"""

import math
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats, Ints, Vector
from processing.kernel import kernel


@kernel
def line(rate: float, time_s: Vector, value: Vector, weight: Vector) -> tuple[float, float, float]:
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
    return _line_of_sums(cc, cs, ss, c_value, s_value)


@kernel
def _line_of_sums(
    cc: float, cs: float, ss: float, c_value: float, s_value: float
) -> tuple[float, float, float]:
    """The result of `line` from the weighted sums of products of cosine, sine and value."""
    determinant = cc * ss - cs * cs
    if not determinant > 1e-6 * cc * ss:
        return 0.0, 0.0, 0.0
    cosine = (ss * c_value - cs * s_value) / determinant
    sine = (cc * s_value - cs * c_value) / determinant
    return cosine * c_value + sine * s_value, cosine, sine


TERMS = 18
SLOW_RATE, SLOW_DAMPING, FAST_RATE, FAST_DAMPING, TURNING, WIDENING = range(6)
"""Indices of the terms shared by both coordinates: angular frequency and damping of each mode, Re k, Im k."""

X, Y = 6, 12
"""Index of the first of the six linear terms of each coordinate ..."""

REST, DRIFT, SLOW_COSINE, SLOW_SINE, FAST_COSINE, FAST_SINE = range(6)
"""... and their order."""

_FAST_TERMS = (
    FAST_RATE,
    FAST_DAMPING,
    X + FAST_COSINE,
    X + FAST_SINE,
    Y + FAST_COSINE,
    Y + FAST_SINE,
)
_COLUMNS = Y
"""Number of terms on which one coordinate depends: those that both share, and its own."""

EVERY = list(range(TERMS))
SLOW_ONLY = [k for k in EVERY if k not in _FAST_TERMS]
_DIAGONAL = np.diag_indices(TERMS)
_MAX_STEPS = 8
_MIN_INFORMATION = 1e-8
"""Smallest fraction of a term's information, beside the terms before it, that is free of rounding errors."""
_MAX_NOISE_CHI2 = 4.0
"""Chi-square per sample up to which residuals may be noise whose stated uncertainty is half of the true."""
_FALSE_ALARM = 1e-7
"""Probability with which one search takes noise for a fast mode. A run makes some hundred searches, each
through all frequencies: see `bench_modes` for false detections in a thousand runs."""

_HIGHEST_FAST_RATE = 25.0
_LOWEST_FAST_RATE = 2.2
"""Range in which a fast mode is searched, in multiples of the slow mode's frequency."""


class ModeSamples(NamedTuple):
    """Times in s from the middle of the samples, coordinates, and their weights (inverse variances)."""

    t: Floats
    x: Floats
    y: Floats
    weights_x: Floats
    weights_y: Floats

    @property
    def span_s(self) -> float:
        return float(self.t[-1] - self.t[0])

    @property
    def variation(self) -> float:
        """Chi-square of a model without motion."""
        chi2_x = (self.x - self.x.mean()) ** 2 * self.weights_x
        return float((chi2_x + (self.y - self.y.mean()) ** 2 * self.weights_y).sum())

    def rescaled(self, x_factor: float, y_factor: float) -> "ModeSamples":
        """Copy with the variances of the coordinates multiplied by these factors."""
        return self._replace(weights_x=self.weights_x / x_factor, weights_y=self.weights_y / y_factor)


class ModeFit(NamedTuple):
    """Terms `p` (TERMS,) with their covariance, chi-square and the residuals of both coordinates (n,)."""

    p: Floats
    covariance: Floats
    active: list[int]
    chi2: float
    residual_x: Floats
    residual_y: Floats

    def explains(self, samples: ModeSamples) -> bool:
        """Whether the fit explains more than half of the variation, and nearly all that is not noise.

        The second condition rejects a record that is at rest for one part and swings for the other.
        """
        noise, variation = _MAX_NOISE_CHI2 * 2 * len(samples.t), samples.variation
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
    fit = fit_terms(start, SLOW_ONLY, samples, rate)
    return fit if fit.explains(samples) else None


def with_fast_mode(slow: ModeFit, samples: ModeSamples) -> tuple[ModeFit, float]:
    """Fit with a fast mode and 0.0 if one is significant; otherwise the slow fit and a limit.

    The limit is the amplitude in x of the strongest spectral line in the residuals; NaN if the samples
    cannot show one.
    """
    slow_rate = float(slow.p[SLOW_RATE])
    top = min(_HIGHEST_FAST_RATE * slow_rate, 0.8 * math.pi * len(samples.t) / samples.span_s)
    lowest, spacing = _LOWEST_FAST_RATE * slow_rate, math.pi / samples.span_s
    count = math.ceil((top - lowest) / spacing)
    if count < 1:
        return slow, math.nan
    residuals = samples._replace(x=slow.residual_x, y=slow.residual_y)
    rate, limit = _strongest(*residuals, lowest, spacing, count)
    start = slow.p.copy()
    start[FAST_RATE] = rate
    fit = fit_terms(start, EVERY, samples, slow_rate)
    if fast_mode_seen(fit, count) and fit.p[FAST_RATE] > 1.5 * fit.p[SLOW_RATE]:
        return fit, 0.0
    return slow, limit


def fast_mode_seen(fit: ModeFit, frequencies: int = 1) -> bool:
    """Whether the fast mode's four amplitudes together differ significantly from zero (Wald test).

    `frequencies` is the number of frequencies searched: the strongest of many lines is strong by chance.
    """
    limit = 2.0 * math.log(frequencies / _FALSE_ALARM)
    # chi-square of four degrees of freedom: its tail exp(-w/2) (1 + w/2) is solved for w by iteration
    for _ in range(20):
        limit = 2.0 * math.log((1.0 + 0.5 * limit) * frequencies / _FALSE_ALARM)
    places = [X + FAST_COSINE, X + FAST_SINE, Y + FAST_COSINE, Y + FAST_SINE]
    part = fit.p[places]
    scale = fit.chi2 / max(2 * len(fit.residual_x) - TERMS, 1)
    covariance = fit.covariance[np.ix_(places, places)] * max(scale, 1.0)
    try:
        return bool(part @ np.linalg.solve(covariance, part) > limit)
    except np.linalg.LinAlgError:
        return False


def fit_terms(p: Floats, active: list[int], samples: ModeSamples, slow_rate: float) -> ModeFit:
    """Fit the `active` terms by Gauss-Newton, starting from `p` (TERMS,); `slow_rate` in rad/s."""
    places = np.array(active)
    p = p.copy()
    ridge = np.zeros(TERMS)
    # a weak prior excludes oscillations damped out within a period, and ellipses that turn as fast
    ridge[[SLOW_DAMPING, FAST_DAMPING, TURNING, WIDENING]] = 1.0 / (0.2 * slow_rate) ** 2
    covariance = np.zeros((TERMS, TERMS))
    limit = 0.5 * math.pi / samples.span_s
    for step in range(_MAX_STEPS):
        information, score, _, _, _ = _equations(p, *samples)
        information[_DIAGONAL] += ridge
        score -= ridge * p
        change, covariance = _step(information, score, places)
        for place in (SLOW_RATE, FAST_RATE):
            change[place] = min(max(change[place], -limit), limit)
        p += change
        for place in (SLOW_DAMPING, FAST_DAMPING, TURNING, WIDENING):
            p[place] = min(max(p[place], -6.0 * limit), 6.0 * limit)
        # The error left by a step of the rates is proportional to its square. The first steps find the
        # amplitudes only, so that convergence is not judged by them.
        u_slow, u_fast = (
            math.sqrt(covariance[SLOW_RATE, SLOW_RATE]),
            math.sqrt(covariance[FAST_RATE, FAST_RATE]),
        )
        if step > 1 and abs(change[SLOW_RATE]) <= 0.01 * u_slow and abs(change[FAST_RATE]) <= 0.01 * u_fast:
            break
    _, _, chi2, residual_x, residual_y = _equations(p, *samples)
    return ModeFit(p, covariance, active, chi2, residual_x, residual_y)


def _step(information: Floats, score: Floats, places: Ints) -> tuple[Floats, Floats]:
    """Change of the terms at `places` and their covariance.

    Terms without any information do not change, nor do combinations of terms that nothing determines.
    """
    known = places[information[places, places] > 0.0]
    scale = information[known, known] ** -0.5
    part = information[np.ix_(known, known)] * np.outer(scale, scale)
    try:
        inverse_root = np.linalg.inv(np.linalg.cholesky(part))
        small = inverse_root.T @ inverse_root
        determined = bool(inverse_root.diagonal().max() ** -2 > _MIN_INFORMATION)
    except np.linalg.LinAlgError:
        determined = False
    if not determined:
        small = np.linalg.pinv(part, rcond=1e-12, hermitian=True)
    change, covariance = np.zeros(TERMS), np.zeros((TERMS, TERMS))
    covariance[np.ix_(known, known)] = small * np.outer(scale, scale)
    change[known] = covariance[np.ix_(known, known)] @ score[known]
    return change, covariance


@kernel
def _equations(
    p: Floats, t: Floats, x: Floats, y: Floats, weights_x: Floats, weights_y: Floats
) -> tuple[Floats, Floats, float, Floats, Floats]:
    """Information matrix and score in all terms, chi-square, residuals in x and y.

    The coupling k mixes the slow parts of the coordinates: x has X + k t Y, y has Y - k t X (see `modes`).
    """
    information, score = np.zeros((TERMS, TERMS)), np.zeros(TERMS)
    # sums of each coordinate, whose terms are side by side: the innermost loop takes several at once
    sums, scores = np.zeros((2, _COLUMNS, _COLUMNS)), np.zeros((2, _COLUMNS))
    left_x, left_y = np.empty(len(t)), np.empty(len(t))
    row = np.empty(_COLUMNS)
    chi2 = 0.0
    for i in range(len(t)):
        time_s = t[i]
        slow, fast = math.exp(-p[SLOW_DAMPING] * time_s), math.exp(-p[FAST_DAMPING] * time_s)
        slow_c, slow_s = slow * math.cos(p[SLOW_RATE] * time_s), slow * math.sin(p[SLOW_RATE] * time_s)
        fast_c, fast_s = fast * math.cos(p[FAST_RATE] * time_s), fast * math.sin(p[FAST_RATE] * time_s)
        # derivatives with respect to a coordinate's own linear terms, in their order
        row[X + REST], row[X + DRIFT] = 1.0, time_s
        row[X + SLOW_COSINE], row[X + SLOW_SINE] = slow_c, slow_s
        row[X + FAST_COSINE], row[X + FAST_SINE] = fast_c, fast_s
        for coordinate in range(2):
            first = X if coordinate == 0 else Y
            other = Y if coordinate == 0 else X
            signed_time_s = time_s if coordinate == 0 else -time_s
            # the other coordinate's slow motion, and the same a quarter of a period later
            in_phase = p[other + SLOW_COSINE] * slow_c + p[other + SLOW_SINE] * slow_s
            in_quadrature = p[other + SLOW_SINE] * slow_c - p[other + SLOW_COSINE] * slow_s
            cosine = p[first + SLOW_COSINE] + signed_time_s * (
                p[TURNING] * p[other + SLOW_COSINE] + p[WIDENING] * p[other + SLOW_SINE]
            )
            sine = p[first + SLOW_SINE] + signed_time_s * (
                p[TURNING] * p[other + SLOW_SINE] - p[WIDENING] * p[other + SLOW_COSINE]
            )
            slow_part = cosine * slow_c + sine * slow_s
            fast_part = p[first + FAST_COSINE] * fast_c + p[first + FAST_SINE] * fast_s
            row[SLOW_RATE] = time_s * (sine * slow_c - cosine * slow_s)
            row[SLOW_DAMPING] = -time_s * slow_part
            row[FAST_RATE] = time_s * (p[first + FAST_SINE] * fast_c - p[first + FAST_COSINE] * fast_s)
            row[FAST_DAMPING] = -time_s * fast_part
            row[TURNING] = signed_time_s * in_phase
            row[WIDENING] = signed_time_s * in_quadrature
            model = p[first + REST] + p[first + DRIFT] * time_s + slow_part + fast_part
            if coordinate == 0:
                left, weight = x[i] - model, weights_x[i]
                left_x[i] = left
            else:
                left, weight = y[i] - model, weights_y[i]
                left_y[i] = left
            chi2 += weight * left * left
            for j in range(_COLUMNS):
                weighted = weight * row[j]
                scores[coordinate, j] += weighted * left
                for k in range(_COLUMNS):
                    sums[coordinate, j, k] += weighted * row[k]
    for coordinate in range(2):
        shift = 0 if coordinate == 0 else Y - X
        for j in range(_COLUMNS):
            at = j if j < X else j + shift
            score[at] += scores[coordinate, j]
            for k in range(_COLUMNS):
                information[at, k if k < X else k + shift] += sums[coordinate, j, k]
    return information, score, chi2, left_x, left_y


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
    """Angular frequency of the strongest line, by its power in both coordinates, and its amplitude in x.

    The search takes `count` frequencies from `first` on; a sample's phase turns equally between neighbours.
    """
    turn_c, turn_s = np.cos(spacing * t), np.sin(spacing * t)
    phase_c, phase_s = np.cos(first * t), np.sin(first * t)
    best_power, best, best_x = -1.0, 0, 0.0
    for at in range(count):
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
        power_x, cosine, sine = _line_of_sums(cc_x, cs_x, ss_x, c_x, s_x)
        power_y, _, _ = _line_of_sums(cc_y, cs_y, ss_y, c_y, s_y)
        if power_x + power_y > best_power:
            best_power, best, best_x = power_x + power_y, at, math.hypot(cosine, sine)
    return first + best * spacing, best_x
