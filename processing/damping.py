"""Damping that depends on the amplitude: fit of its constant, linear and quadratic parts to any decay.

    dA/dt = -(c + g A + q A^2)

The constant c is friction that does not depend on speed (Coulomb), the linear g is viscous or structural
damping, which a decay at one frequency cannot distinguish, the quadratic q is drag that grows with the square
of the speed. tau(A) = -A / (dA/dt) is the time constant at an amplitude. A = x/y solves it with
x' = -g x/2 - c y, y' = q x + g y/2, whose matrix squared is (g^2/4 - q c) times the unit matrix.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import exp, inf, log, sqrt
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.least_squares import Solution, differenced, solve

PARTS: Final = ("constant", "linear", "quadratic")
_MIN_AMPLITUDES: Final = 12
"""Smallest number of amplitudes: four parameters leave eight degrees of freedom."""
_MIN_RELATIVE_AMPLITUDE: Final = 1e-9
"""Smallest amplitude in units of the largest one; smaller ones count as this."""
_MIN_EXCESS: Final = 4.0
"""Mean square of residuals, in their variances, above which they are more than noise."""
_STRETCHES, _MIN_STRETCHES, _MIN_STRETCH_AMPLITUDES = 12, 4, 5
"""Number of equal stretches of a decay whose own rates are compared with the fitted one, and the smallest
numbers of them and of their amplitudes.
"""


class DampingTerm(NamedTuple):
    """Part of the damping with its standard uncertainty, and the probability that the decay needs it."""

    value: float
    u: float
    probability: float


@dataclass(frozen=True, slots=True)
class DampingTerms:
    """Parts of dA/dt = -(constant + linear A + quadratic A^2), in the amplitude's unit and s.

    The probability of a part weighs all combinations of parts by their likelihood (Schwarz).
    """

    samples: int
    constant: DampingTerm
    linear: DampingTerm
    quadratic: DampingTerm
    covariance: Floats
    """Covariance (3, 3) of the parts, enlarged by `chi2_per_dof` above 1, and where the parts do not describe
    the loss, by the square of the deviations of the rates of stretches of the decay.
    """
    first: float
    last: float
    """Fitted amplitudes at both ends."""
    chi2_per_dof: float

    @property
    def needed(self) -> tuple[str, ...]:
        """Parts that are needed with a probability of more than 95 %; without any, the likeliest."""
        probabilities = {name: getattr(self, name).probability for name in PARTS}
        probable = tuple(name for name in PARTS if probabilities[name] > 0.95)
        return probable or (max(PARTS, key=lambda name: probabilities[name]),)

    def time_constant_s(self, amplitude: Floats) -> tuple[Floats, Floats]:
        """Time constant tau at these amplitudes (n,) with standard uncertainties, s."""
        powers = np.stack([1.0 / amplitude, np.ones_like(amplitude), amplitude])
        rate = np.array([self.constant.value, self.linear.value, self.quadratic.value]) @ powers
        u_rate = np.sqrt(np.einsum("ik,ij,jk->k", powers, self.covariance, powers))
        return 1.0 / rate, u_rate / rate**2

    def amplitudes(self, count: int = 25) -> Floats:
        """Amplitudes (count,) from the first to the last, evenly in their logarithm."""
        return np.geomspace(self.first, max(self.last, 0.02 * self.first), count)


def amplitude_at(times_s: Floats, first: float, constant: float, linear: float, quadratic: float) -> Floats:
    """Amplitude A at times (n,) since it was `first`; not less than zero."""
    square = 0.25 * linear**2 - quadratic * constant
    rate = sqrt(abs(square))
    x = rate * times_s
    if square > 0 and x[-1] > 1e-6:
        # both are multiplied by exp(-x), which cancels in the quotient, so that nothing overflows
        cosine, sine = 0.5 * (1.0 + np.exp(-2.0 * x)), -0.5 * np.expm1(-2.0 * x) / rate
    elif square < 0 and x[-1] > 1e-6:
        # beyond a quarter of the period the amplitude has reached zero
        x = np.minimum(x, 0.5 * np.pi)
        cosine, sine = np.cos(x), np.sin(x) / rate
    else:
        cosine, sine = np.ones_like(times_s), times_s
    numerator = first * (cosine - 0.5 * linear * sine) - constant * sine
    denominator = quadratic * first * sine + cosine + 0.5 * linear * sine
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(denominator > 0, numerator / denominator, inf)
    return np.asarray(np.clip(amplitude, 0.0, 1e6 * abs(first) + 1.0))


def fit_damping(times_s: Floats, amplitudes: Floats, u_amplitudes: Floats) -> DampingTerms:
    """Fit all parts of the damping to amplitudes.

    Parameters
    ----------
    times_s : (n,) ascending
    amplitudes, u_amplitudes : (n,) in any unit, with standard uncertainties

    Raises
    ------
    DataError
        Too few values, uncertainties or amplitudes that are not positive, or values that do not fall.
    """
    valid = np.isfinite(amplitudes) & np.isfinite(u_amplitudes)
    t, y, u = times_s[valid] - times_s[valid][:1], amplitudes[valid], u_amplitudes[valid]
    if len(y) < _MIN_AMPLITUDES:
        raise DataError(f"the decay has {len(y)} amplitudes; at least {_MIN_AMPLITUDES} are needed")
    if not np.min(u) > 0:
        raise DataError(
            f"the standard uncertainty of an amplitude is {np.min(u):g}: it must be positive; state the noise"
        )
    lowest = float(np.min(y[: len(y) // 2]))  # noise may take the end of a decay below zero
    if not lowest > 0:
        raise DataError(f"amplitudes are positive, but one is {lowest:g}: are they the deflection itself?")
    scale, span_s = float(np.max(np.abs(y))), float(t[-1])
    fit = _Fit(t / span_s, y / scale, u / scale)
    start = fit.start()
    subsets = [subset for size in (1, 2, 3) for subset in combinations(PARTS, size)]
    fits = {subset: fit.parts(subset, start) for subset in subsets}
    full, dof = fits[PARTS], len(y) - 4
    chi2_per_dof = full.chi2 / dof
    # if all parts together leave more than the stated noise, the noise is taken from their residuals
    excess = max(1.0, chi2_per_dof)
    criteria = {
        subset: solution.chi2 / excess + (len(subset) + 1) * log(len(y)) for subset, solution in fits.items()
    }
    smallest = min(criteria.values())
    weights = {subset: exp(-0.5 * (criterion - smallest)) for subset, criterion in criteria.items()}
    total = sum(weights.values())
    # amplitude in `scale`, time in spans: constant scale/span, linear 1/span, quadratic 1/(scale span)
    sizes = np.array([scale, 1.0, 1.0 / scale]) / span_s
    covariance = full.covariance[1:4, 1:4] * np.outer(sizes, sizes) * excess
    decay = amplitude_at(t / span_s, *full.values)
    if chi2_per_dof > _MIN_EXCESS:
        is_used = decay > _MIN_RELATIVE_AMPLITUDE
        fitted = decay[is_used]
        residual, u_residual = y[is_used] / scale / fitted - 1.0, u[is_used] / scale / fitted
        covariance *= _rate_excess(t[is_used], residual, u_residual, fitted * scale, covariance)
    terms = {
        name: DampingTerm(
            float(full.values[k + 1] * sizes[k]),
            sqrt(covariance[k, k]),
            float(sum(weight for subset, weight in weights.items() if name in subset) / total),
        )
        for k, name in enumerate(PARTS)
    }
    single = fits[("linear",)]
    u_rate = sqrt(single.covariance[2, 2] * max(1.0, single.chi2 / (dof + 2)))
    if not single.values[2] > 3.0 * u_rate:
        raise DataError("the amplitude does not fall: this is not a ring-down, or too short a part of one")
    return DampingTerms(
        samples=len(y),
        **terms,
        covariance=covariance,
        first=float(decay[0] * scale),
        last=float(decay[-1] * scale),
        chi2_per_dof=chi2_per_dof,
    )


def _rate_excess(t_s: Floats, residual: Floats, u: Floats, amplitude: Floats, covariance: Floats) -> float:
    """Mean square deviation of the rates of stretches from the fitted one, in its variances; at least 1.
    `residual` (n,) is that of ln(amplitude), with `u`, `covariance` (3, 3) that of the parts."""
    count = min(_STRETCHES, len(t_s) // _MIN_STRETCH_AMPLITUDES)
    if count < _MIN_STRETCHES:
        return 1.0
    slopes2, u2, fitted2 = np.empty((3, count))
    for k, rows in enumerate(np.array_split(np.arange(len(t_s)), count)):
        weight = 1.0 / u[rows] ** 2
        x = t_s[rows] - np.average(t_s[rows], weights=weight)
        y = residual[rows] - np.average(residual[rows], weights=weight)
        spread = float(np.sum(weight * x**2))
        slope = float(np.sum(weight * x * y)) / spread
        scatter = float(np.sum(weight * (y - slope * x) ** 2)) / (len(rows) - 2)
        mean_amplitude = float(np.mean(amplitude[rows]))
        powers = np.array([1.0 / mean_amplitude, 1.0, mean_amplitude])
        slopes2[k], u2[k] = slope**2, max(1.0, scatter) / spread
        fitted2[k] = powers @ covariance @ powers
    if not np.mean(slopes2 / u2) > _MIN_EXCESS:
        return 1.0
    return max(1.0, float(np.mean((slopes2 - u2) / fitted2)))


class _Fit:
    """Least-squares fits with amplitudes of about one and times from zero to one."""

    def __init__(self, t: Floats, y: Floats, u: Floats) -> None:
        self._t, self._y, self._u = t, y, u

    def start(self) -> Floats:
        """Start values: first amplitude, and a linear part from the time in which the amplitude halves."""
        first = float(np.median(self._y[: max(len(self._y) // 50, 1)]))
        below_half = np.flatnonzero(self._y < 0.5 * first)
        half_time = float(self._t[below_half[0]]) if len(below_half) and below_half[0] > 0 else 1.0
        return np.array([first, 0.0, max(log(2.0) / half_time, 0.05), 0.0])

    def parts(self, subset: Sequence[str], start: Floats) -> Solution:
        """Fit the parts in `subset`: the values (4,) are the first amplitude and all parts."""
        free = np.array([True, *(name in subset for name in PARTS)])
        begin = start.copy()
        if "linear" not in subset:
            # another part gives the same initial rate of the fall
            rate, begin[2] = begin[2], 0.0
            begin[1 if "constant" in subset else 3] = 0.5 * rate / (1.0 if "constant" in subset else begin[0])

        def residual(p: Floats) -> Floats:
            values = np.zeros(4)
            values[free] = p
            return np.asarray((amplitude_at(self._t, *values) - self._y) / self._u)

        solution = solve(differenced(residual), begin[free])
        values, covariance = np.zeros(4), np.zeros((4, 4))
        values[free] = solution.values
        covariance[np.ix_(free, free)] = solution.covariance
        return replace(solution, values=values, covariance=covariance)
