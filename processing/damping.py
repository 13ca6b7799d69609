"""Damping that depends on the amplitude: fit of its constant, linear and quadratic parts to any decay.

    dA/dt = -(c + g A + q A^2)

The constant c is friction that does not depend on speed (Coulomb), the linear g is viscous or structural
damping, which a decay at one frequency cannot distinguish, the quadratic q is drag that grows with the square
of the speed. tau(A) = -A / (dA/dt) is the time constant at an amplitude. A = x/y solves it with
x' = -g x/2 - c y, y' = q x + g y/2, whose matrix squared is (g^2/4 - q c) times the unit matrix.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import exp, inf, log, nan, sqrt
from typing import Final, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.errors import DataError
from processing.estimate import Estimate
from processing.least_squares import differenced, solve

PARTS: Final = ("constant", "linear", "quadratic")
_FEWEST_AMPLITUDES: Final = 12
"""Fewest amplitudes: four parameters leave eight degrees of freedom."""
_DB: Final = 10.0 / log(10.0)
_MIN_RELATIVE_AMPLITUDE: Final = 1e-9
"""Smallest amplitude in units of the largest one; smaller ones count as this."""
_ENDS: Final = np.array([0.0, 1.0])
_MIN_FLOOR_CHI2: Final = 12.0
"""Smallest reduction of chi-square by a noise floor; by chance it occurs once in 2000 decays."""
_MIN_EXCESS: Final = 4.0
"""Mean square, in its variances, from which on a residual is more than noise."""
_STRETCHES, _FEWEST_STRETCHES, _FEWEST_OF_STRETCH = 12, 4, 5
"""Number of equal stretches of a decay whose own rates are compared with the fitted one, and the fewest of
them and of their amplitudes."""
_MIN_FLOOR_RATIO: Final = 3.0
"""Amplitude in noise floors from which on the floor hardly changes the rate."""


class DampingTerm(NamedTuple):
    """Part of the damping with its standard uncertainty, and the probability that the decay needs it."""

    value: float
    u: float
    probability: float


@dataclass(frozen=True, slots=True)
class DampingTerms:
    """Parts of dA/dt = -(constant + linear A + quadratic A^2), in the amplitude's unit and s.

    Uncertainties and `covariance` (3, 3) of the parts are enlarged by `chi2_per_dof` above 1, and where the
    parts do not describe the loss, by as much as the rates of stretches of the decay lie off. `floor` is the
    noise floor of the amplitude, added in power; NaN if the end of the decay shows none. `first` and `last`
    are the fitted amplitudes at both ends, without the floor. `exponential` is the time constant of the
    linear part alone, s; its uncertainty includes the variation of the time constant over the fall. The
    probability of a part weighs all combinations of parts by their likelihood (Schwarz).
    """

    samples: int
    constant: DampingTerm
    linear: DampingTerm
    quadratic: DampingTerm
    covariance: Floats
    first: float
    last: float
    floor: float
    chi2_per_dof: float
    exponential: Estimate
    exponential_chi2_per_dof: float

    @property
    def needed(self) -> tuple[str, ...]:
        """Parts that are needed with a probability of more than 95 %; without any, the likeliest."""
        parts = {name: getattr(self, name).probability for name in PARTS}
        sure = tuple(name for name in PARTS if parts[name] > 0.95)
        return sure or (max(PARTS, key=lambda name: parts[name]),)

    def time_constant_s(self, amplitude: Floats) -> tuple[Floats, Floats]:
        """Time constant tau at these amplitudes (n,) with standard uncertainties, s."""
        powers = np.stack([1.0 / amplitude, np.ones_like(amplitude), amplitude])
        rate = np.array([self.constant.value, self.linear.value, self.quadratic.value]) @ powers
        u_rate = np.sqrt(np.einsum("ik,ij,jk->k", powers, self.covariance, powers))
        return 1.0 / rate, u_rate / rate**2

    def amplitudes(self, count: int = 25) -> Floats:
        """Amplitudes (count,) from the first to the last, evenly in their logarithm."""
        return np.geomspace(self.first, max(self.last, 0.02 * self.first), count)


class _DampingSolution(NamedTuple):
    """First amplitude and the three parts with their covariance, the floor (NaN: none), and chi-square."""

    values: Floats
    covariance: Floats
    floor: float
    chi2: float


def amplitude_at(times_s: Floats, first: float, constant: float, linear: float, quadratic: float) -> Floats:
    """Amplitude A at times (n,) since it was `first`; not less than zero."""
    square = 0.25 * linear**2 - quadratic * constant
    s = sqrt(abs(square))
    x = s * times_s
    if square > 0 and s * times_s[-1] > 1e-6:
        # both are multiplied by exp(-x), which cancels in the quotient, so that nothing overflows
        cosine, sine = 0.5 * (1.0 + np.exp(-2.0 * x)), -0.5 * np.expm1(-2.0 * x) / s
    elif square < 0 and s * times_s[-1] > 1e-6:
        # beyond a quarter of the period the amplitude has reached zero
        x = np.minimum(x, 0.5 * np.pi)
        cosine, sine = np.cos(x), np.sin(x) / s
    else:
        cosine, sine = np.ones_like(times_s), times_s
    numerator = first * (cosine - 0.5 * linear * sine) - constant * sine
    denominator = quadratic * first * sine + cosine + 0.5 * linear * sine
    with np.errstate(divide="ignore", invalid="ignore"):
        amplitude = np.where(denominator > 0, numerator / denominator, inf)
    return np.asarray(np.clip(amplitude, 0.0, 1e6 * abs(first) + 1.0))


def fit_damping(
    times_s: Floats, values: Floats, u_values: Floats, *, decibel: bool = False, floor: bool = False
) -> DampingTerms:
    """Fit all parts of the damping to amplitudes, or to powers in dB.

    Parameters
    ----------
    times_s : (n,) ascending
    values, u_values : (n,) amplitudes in any unit, or powers in dB (`decibel`), with standard uncertainties
    floor
        whether the measurement has a noise floor: it is fitted if the end of the decay shows it

    Raises
    ------
    DataError
        Fewer than 12 values, uncertainties or amplitudes that are not positive, or values that do not fall.
    """
    valid = np.isfinite(values) & np.isfinite(u_values)
    t, y, u = times_s[valid] - times_s[valid][:1], values[valid], u_values[valid]
    if len(y) < _FEWEST_AMPLITUDES:
        raise DataError(f"the decay has {len(y)} amplitudes; at least {_FEWEST_AMPLITUDES} are needed")
    if not np.min(u) > 0:
        raise DataError(
            f"the standard uncertainty of an amplitude is {np.min(u):g}: it must be positive; state the noise"
        )
    lowest = float(np.min(y[: len(y) // 2]))  # noise may take the end of a decay below zero
    if not decibel and not lowest > 0:
        raise DataError(
            f"amplitudes are positive, but one is {lowest:g}: are they the deflection itself "
            "(fit it without --envelope), or a power in dB (--envelope power)?"
        )
    scale = 1.0 if decibel else float(np.max(np.abs(y)))
    span_s = float(t[-1])
    level_db = float(np.max(y)) if decibel else 0.0
    fit = _Fit(t / span_s, (y - level_db) if decibel else y / scale, u if decibel else u / scale, decibel)
    start = fit.start()
    full, level = fit.parts(PARTS, start), nan
    if floor:
        with_floor = fit.parts(PARTS, start, floor=True)
        reaches_floor = amplitude_at(_ENDS, *with_floor.values[:4])[1] < with_floor.floor
        if reaches_floor and full.chi2 - with_floor.chi2 > _MIN_FLOOR_CHI2:
            full, level = with_floor, with_floor.floor
    unit = 10 ** (level_db / 20.0) if decibel else scale
    fits = {
        subset: fit.parts(subset, start, floor=bool(np.isfinite(level)))
        for size in (1, 2)
        for subset in combinations(PARTS, size)
    } | {PARTS: full}
    freedom = len(y) - 4 - (1 if np.isfinite(level) else 0)
    chi2_per_dof = full.chi2 / freedom
    # if all parts together leave more than the stated noise, the noise is taken from their residuals
    excess = max(1.0, chi2_per_dof)
    per_part = log(len(y))
    weights = {names: one.chi2 / excess + (len(names) + 1) * per_part for names, one in fits.items()}
    least = min(weights.values())
    chances = {subset: exp(-0.5 * (weight - least)) for subset, weight in weights.items()}
    total = sum(chances.values())
    # amplitude in `unit`, time in spans: constant unit/span, linear 1/span, quadratic 1/(unit span)
    sizes = np.array([unit, 1.0, 1.0 / unit]) / span_s
    covariance = full.covariance[1:4, 1:4] * np.outer(sizes, sizes) * excess
    ends = amplitude_at(_ENDS, *full.values[:4])
    if chi2_per_dof > _MIN_EXCESS:
        decay = amplitude_at(t / span_s, *full.values[:4])
        observed = np.hypot(decay, level) if np.isfinite(level) else decay
        clear = decay > (_MIN_FLOOR_RATIO * level if np.isfinite(level) else _MIN_RELATIVE_AMPLITUDE)
        with np.errstate(divide="ignore"):
            residual, u_residual = (
                ((y - level_db) / (2.0 * _DB) - np.log(observed), u / (2.0 * _DB))
                if decibel
                else (y / scale / observed - 1.0, u / scale / observed)
            )
        amplitude = decay[clear] * unit
        covariance *= _rate_excess(t[clear], residual[clear], u_residual[clear], amplitude, covariance)
    parts = [
        DampingTerm(
            float(full.values[k + 1] * sizes[k]),
            sqrt(covariance[k, k]),
            float(sum(chance for subset, chance in chances.items() if name in subset) / total),
        )
        for k, name in enumerate(PARTS)
    ]
    single = fits[("linear",)]
    single_chi2 = single.chi2 / (freedom + 2)
    rate, u_rate = float(single.values[2]), sqrt(single.covariance[2, 2] * max(1.0, single_chi2))
    if not rate > 3.0 * u_rate:
        raise DataError("the amplitude does not fall: this is not a ring-down, or too short a part of one")
    tau_s = span_s / rate
    u_tau_s = sqrt((tau_s * u_rate / rate) ** 2 + _tau_variance(fits, chances, ends, rate) * span_s**2)
    return DampingTerms(
        samples=len(y),
        constant=parts[0],
        linear=parts[1],
        quadratic=parts[2],
        covariance=covariance,
        first=float(ends[0] * unit),
        last=float(ends[1] * unit),
        floor=level * unit,
        chi2_per_dof=chi2_per_dof,
        exponential=Estimate(tau_s, u_tau_s),
        exponential_chi2_per_dof=single_chi2,
    )


def _rate_excess(t_s: Floats, residual: Floats, u: Floats, amplitude: Floats, covariance: Floats) -> float:
    """Mean square by which the rates of stretches lie off the fitted one, in its variances; at least 1.

    `residual` (n,) is that of ln(amplitude), with `u`, `covariance` (3, 3) that of the parts. Slopes
    of the residuals that agree with their noise, as each stretch shows it, enlarge nothing.
    """
    count = min(_STRETCHES, len(t_s) // _FEWEST_OF_STRETCH)
    if count < _FEWEST_STRETCHES:
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


def _tau_variance(
    fits: Mapping[tuple[str, ...], _DampingSolution],
    chances: Mapping[tuple[str, ...], float],
    ends: Floats,
    rate: float,
) -> float:
    """Variance of the time constant over the fall, as the mean over all combinations of parts.

    It follows from the values at a quarter and three quarters of the fall in its logarithm. `rate` is that of
    the linear part alone; an eighth of it is the slowest rate allowed of a combination.
    """
    quarters = np.geomspace(ends[0], max(ends[1], 0.02 * ends[0]), 5)[[1, 3]]
    powers = np.stack([1.0 / quarters, np.ones(2), quarters])
    weighted = [
        chances[subset] * np.ptp(1.0 / np.maximum(solution.values[1:] @ powers, rate / 8)) ** 2
        for subset, solution in fits.items()
    ]
    return float(sum(weighted)) / sum(chances.values()) / 3.0


class _Fit:
    """Least-squares fits with amplitudes of about one and times from zero to one."""

    def __init__(self, t: Floats, y: Floats, u: Floats, decibel: bool) -> None:
        self._t, self._y, self._u, self._decibel = t, y, u, decibel
        self._lowest = (
            float(np.min(10 ** (y / 20.0))) if decibel else float(max(np.min(y), _MIN_RELATIVE_AMPLITUDE))
        )

    def start(self) -> Floats:
        """Start values: first amplitude, and a linear part from the time in which the amplitude halves."""
        amplitude = 10 ** (self._y / 20.0) if self._decibel else self._y
        head = max(len(amplitude) // 50, 1)
        first = float(np.median(amplitude[:head]))
        halved = np.nonzero(amplitude < 0.5 * first)[0]
        half_time = float(self._t[halved[0]]) if len(halved) and halved[0] > 0 else 1.0
        return np.array([first, 0.0, max(log(2.0) / half_time, 0.05), 0.0])

    def parts(self, subset: Sequence[str], start: Floats, *, floor: bool = False) -> _DampingSolution:
        """Fit the parts in `subset`, and a noise floor if `floor`."""
        free = np.array([True, *(name in subset for name in PARTS)])
        begin = start.copy()
        if "linear" not in subset:
            # another part gives the same initial rate of the fall
            rate, begin[2] = begin[2], 0.0
            begin[1 if "constant" in subset else 3] = 0.5 * rate / (1.0 if "constant" in subset else begin[0])
        count = int(free.sum())

        def residual(p: Floats) -> Floats:
            values = np.zeros(4)
            values[free] = p[:count]
            return self._residual(values, exp(min(p[count], 5.0)) if floor else nan)

        at_start = (
            np.append(begin[free], log(self._lowest + _MIN_RELATIVE_AMPLITUDE)) if floor else begin[free]
        )
        solution = solve(differenced(residual), at_start)
        values, covariance = np.zeros(4), np.zeros((4, 4))
        values[free] = solution.values[:count]
        covariance[np.ix_(free, free)] = solution.covariance[:count, :count]
        return _DampingSolution(
            values, covariance, exp(min(solution.values[count], 5.0)) if floor else nan, solution.chi2
        )

    def _residual(self, p: Floats, floor: float) -> Floats:
        amplitude = amplitude_at(self._t, *p)
        if np.isfinite(floor):
            amplitude = np.hypot(amplitude, floor)
        if self._decibel:
            amplitude = 2.0 * _DB * np.log(np.maximum(amplitude, _MIN_RELATIVE_AMPLITUDE))
        return np.asarray((amplitude - self._y) / self._u)
