"""Least squares of a slow and a fast damped ellipse: terms, normal equations, search for lines.

See modes for the model.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TERMS = 18
SLOW, FAST, TURN, X, Y = 0, 2, 4, 6, 12
"""Places of rate and damping of each mode, of k, and of the six linear terms of each coordinate:
rest, drift, cosine and sine of the slow mode, cosine and sine of the fast one."""

EVERY = list(range(TERMS))
SLOW_ONLY = [k for k in EVERY if k not in (FAST, FAST + 1, X + 4, X + 5, Y + 4, Y + 5)]
_STEPS = 8
_NOISE_LIKE = 4.0
_SEEN = 4.0
"""Amplitude in standard uncertainties from which on a fast mode is believed."""

_FASTEST = 25.0
_SLOWEST_FAST = 2.2
"""Range of the fast mode's frequency, in slow ones."""


class Samples(NamedTuple):
    """Times from the middle in s, coordinates, and one over their variances."""

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
        """Chi-square of no motion at all."""
        across = (self.x - self.x.mean()) ** 2 * self.weights_x
        return float((across + (self.y - self.y.mean()) ** 2 * self.weights_y).sum())

    def rescaled(self, x_factor: float, y_factor: float) -> "Samples":
        """With variances so many times larger."""
        return self._replace(weights_x=self.weights_x / x_factor, weights_y=self.weights_y / y_factor)


class Fit(NamedTuple):
    """Terms with their covariance, chi-square and residuals."""

    p: Floats
    covariance: Floats
    active: list[int]
    chi2: float
    left_x: Floats
    left_y: Floats

    def explains(self, samples: Samples, alike: bool) -> bool:
        """Whether most of the variation is motion: half of it, and nearly all that the noise is not.

        A stretch half at rest and half swinging is no swing. Uncertainties that are just `alike` tell
        nothing about the noise.
        """
        part = self.chi2 / max(samples.variation, 1e-300)
        noise_like = alike or self.chi2 < _NOISE_LIKE * 2 * len(samples.t)
        return part < 0.5 and (noise_like or part < 0.05)


def slow_fit(samples: Samples, slow_period_s: float, alike: bool) -> Fit | None:
    """The slow mode alone."""
    if math.isnan(slow_period_s):
        spacing = 0.5 * math.pi / samples.span_s
        highest = min(0.8 * math.pi * len(samples.t) / samples.span_s, 400.0 * spacing)
        rates = np.arange(1.6 * math.pi / samples.span_s, highest, spacing)
        if len(rates) == 0:
            return None
        centred = samples._replace(x=samples.x - samples.x.mean(), y=samples.y - samples.y.mean())
        rate = _strongest(*centred, rates)[0]
    else:
        rate = 2.0 * math.pi / slow_period_s
    start = np.zeros(TERMS)
    start[SLOW] = rate
    fit = fit_terms(start, SLOW_ONLY, samples, rate)
    return fit if fit.explains(samples, alike) else None


def with_fast_mode(slow: Fit, samples: Samples, alike: bool) -> tuple[Fit, float]:
    """The fit with a fast mode, where one is seen; else the slow one and the strongest line's size in x."""
    slow_rate = float(slow.p[SLOW])
    top = min(_FASTEST * slow_rate, 0.8 * math.pi * len(samples.t) / samples.span_s)
    rates = np.arange(_SLOWEST_FAST * slow_rate, top, math.pi / samples.span_s)
    if len(rates) == 0:
        return slow, math.nan
    left = samples._replace(x=slow.left_x, y=slow.left_y)
    rate, limit = _strongest(*left, rates)
    start = slow.p.copy()
    start[FAST] = rate
    fit = fit_terms(start, EVERY, samples, slow_rate)
    if fast_mode_seen(fit, alike) and fit.p[FAST] > 1.5 * fit.p[SLOW]:
        return fit, 0.0
    return slow, limit


def fast_mode_seen(fit: Fit, alike: bool) -> bool:
    """Whether the fast mode's four parts, taken together, are far from zero."""
    places = [X + 4, X + 5, Y + 4, Y + 5]
    part = fit.p[places]
    scale = fit.chi2 / max(2 * len(fit.left_x) - TERMS, 1)
    covariance = fit.covariance[np.ix_(places, places)] * (scale if alike else max(scale, 1.0))
    try:
        return bool(part @ np.linalg.solve(covariance, part) > 2.0 * _SEEN**2)
    except np.linalg.LinAlgError:
        return False


def fit_terms(p: Floats, active: list[int], samples: Samples, slow_rate: float) -> Fit:
    """Gauss-Newton from `p` in the `active` terms."""
    places = np.array(active)
    p = p.copy()
    ridge = np.zeros(TERMS)
    # a damping that takes the whole motion within a period is none, nor is a line that turns as fast
    ridge[[SLOW + 1, FAST + 1, TURN, TURN + 1]] = 1.0 / (0.2 * slow_rate) ** 2
    covariance = np.zeros((TERMS, TERMS))
    limit = 0.5 * math.pi / samples.span_s
    for step in range(_STEPS):
        information, score, _, _, _ = _equations(p, *samples)
        information[np.diag_indices(TERMS)] += ridge
        score -= ridge * p
        part = information[np.ix_(places, places)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(part), 1e-300))
        small = np.linalg.pinv(part * np.outer(scale, scale), rcond=1e-12, hermitian=True)
        change = np.zeros(TERMS)
        change[places] = scale * (small @ (scale * score[places]))
        for place in (SLOW, FAST):
            change[place] = min(max(change[place], -limit), limit)
        p = p + change
        for place in (SLOW + 1, FAST + 1, TURN, TURN + 1):
            p[place] = min(max(p[place], -6.0 * limit), 6.0 * limit)
        covariance[np.ix_(places, places)] = small * np.outer(scale, scale)
        # what a step of the rates leaves undone goes with its square; the first only finds the amplitudes
        u_slow, u_fast = math.sqrt(covariance[SLOW, SLOW]), math.sqrt(covariance[FAST, FAST])
        if step > 1 and abs(change[SLOW]) <= 0.01 * u_slow and abs(change[FAST]) <= 0.01 * u_fast:
            break
    _, _, chi2, left_x, left_y = _equations(p, *samples)
    return Fit(p, covariance, active, chi2, left_x, left_y)


@njit(cache=True, nogil=True, error_model="numpy")
def _equations(
    p: Floats, t: Floats, x: Floats, y: Floats, weights_x: Floats, weights_y: Floats
) -> tuple[Floats, Floats, float, Floats, Floats]:
    """Normal equations in all terms, chi-square and residuals."""
    terms, common, columns = len(p), 6, 12
    information, score = np.zeros((terms, terms)), np.zeros(terms)
    left_x, left_y = np.empty(len(t)), np.empty(len(t))
    row, places = np.empty(columns), np.empty(columns, dtype=np.int64)
    chi2 = 0.0
    for i in range(len(t)):
        s = t[i]
        slow, fast = math.exp(-p[1] * s), math.exp(-p[3] * s)
        slow_c, slow_s = slow * math.cos(p[0] * s), slow * math.sin(p[0] * s)
        fast_c, fast_s = fast * math.cos(p[2] * s), fast * math.sin(p[2] * s)
        row[6], row[7], row[8], row[9], row[10], row[11] = 1.0, s, slow_c, slow_s, fast_c, fast_s
        for coordinate in range(2):
            first = common if coordinate == 0 else common + 6
            other = common + 6 if coordinate == 0 else common
            way = s if coordinate == 0 else -s
            # the other coordinate's slow motion, and a quarter period later
            turned = p[other + 2] * slow_c + p[other + 3] * slow_s
            widened = p[other + 3] * slow_c - p[other + 2] * slow_s
            cosine = p[first + 2] + way * (p[4] * p[other + 2] + p[5] * p[other + 3])
            sine = p[first + 3] + way * (p[4] * p[other + 3] - p[5] * p[other + 2])
            slow_part = cosine * slow_c + sine * slow_s
            fast_part = p[first + 4] * fast_c + p[first + 5] * fast_s
            row[0] = s * (sine * slow_c - cosine * slow_s)
            row[1] = -s * slow_part
            row[2] = s * (p[first + 5] * fast_c - p[first + 4] * fast_s)
            row[3] = -s * fast_part
            row[4] = way * turned
            row[5] = way * widened
            for k in range(columns):
                places[k] = k if k < common else first + k - common
            model = p[first] + p[first + 1] * s + slow_part + fast_part
            if coordinate == 0:
                left, weight = x[i] - model, weights_x[i]
                left_x[i] = left
            else:
                left, weight = y[i] - model, weights_y[i]
                left_y[i] = left
            chi2 += weight * left * left
            for j in range(columns):
                weighted = weight * row[j]
                score[places[j]] += weighted * left
                for k in range(j + 1):
                    information[places[j], places[k]] += weighted * row[k]
    for j in range(terms):
        for k in range(j):
            information[k, j] = information[j, k]
    return information, score, chi2, left_x, left_y


@njit(cache=True, nogil=True, error_model="numpy")
def _strongest(
    t: Floats, x: Floats, y: Floats, weights_x: Floats, weights_y: Floats, rates: Floats
) -> tuple[float, float]:
    """Angular frequency of the strongest line of both coordinates, and its amplitude in x."""
    best_power, best_rate, best_x = -1.0, 0.0, 0.0
    for rate in rates:
        power, amplitude_x = 0.0, 0.0
        for coordinate in range(2):
            cc = cs = ss = c_value = s_value = 0.0
            for i in range(len(t)):
                c, s = math.cos(rate * t[i]), math.sin(rate * t[i])
                weight = weights_x[i] if coordinate == 0 else weights_y[i]
                value = x[i] if coordinate == 0 else y[i]
                cc += weight * c * c
                cs += weight * c * s
                ss += weight * s * s
                c_value += weight * c * value
                s_value += weight * s * value
            determinant = cc * ss - cs * cs
            if determinant > 1e-6 * cc * ss:
                cosine = (ss * c_value - cs * s_value) / determinant
                sine = (cc * s_value - cs * c_value) / determinant
                power += cosine * c_value + sine * s_value
                if coordinate == 0:
                    amplitude_x = math.hypot(cosine, sine)
        if power > best_power:
            best_power, best_rate, best_x = power, rate, amplitude_x
    return best_rate, best_x
