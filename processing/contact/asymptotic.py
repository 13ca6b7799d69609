"""The asymptotic theory of a decay, its fit, and start values of an exact fit.

Amplitude in first approximation (Eq. 5), period in second (Eq. 6):

    d alpha/dt = -(4/T) (c + b alpha^p/(p+1) + d alpha)                      (5, with a linear term d)
    T0/T = 1 - 2 kappa alpha^n J(n) (1 - curvature(n) rho alpha)             (6)
"""

from dataclasses import replace
from functools import lru_cache
from math import log, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.contact.law import ContactParameters, PendulumOnBall, relative_curvature, stiffness_ratio
from processing.decay_summary import FEWEST_PERIODS, full_periods, mean_period, reference_amplitude
from processing.errors import DataError
from processing.estimate import Estimate
from processing.least_squares import FactoredJacobian, Loss, Solution, propagate, solve
from processing.swing import TurningPoints

_PIECE, _PIECES = 0.1, 400
"""Length and number of the pieces of ln x, 8 nodes each, of an integration: to 1e-13, down to e^-40."""
_NEWTON_TOLERANCE = 1e-9
"""Change of ln x at which Newton's iteration ends; the next change would be its square."""
_EXPONENTS_P = np.array([0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0, 1.15, 1.35, 1.6, 2.0, 2.5, 3.0])
_EXPONENTS_N = np.array([0.003, 0.01, 0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0])
"""Start values, which the fit varies; the paper's pairs have p from 0.82 to 0.94 and n from 0.09 to 0.55."""
_B, _P, _C, _D = range(4)
"""Columns of the fit of Eq. 5; the last column, whatever their number, is the first amplitude."""


def decay_path(
    rate_time: Floats, start: float, b: float, p: float, c: float, d: float
) -> tuple[Floats, Floats]:
    """Solve ``dx/ds = -(c + b x^p + d x)`` at rising s >= s_0, with derivatives.

    The variables are separated, s = integral dx/(c + b x^p + d x), and the integral is computed over pieces
    of ln x. `b` stands for b/(p+1). Returns x and its derivatives with respect to (start, b, p, c, d, s),
    shape (len, 6); NaN after x has reached zero.
    """
    path, gradient = np.full(len(rate_time), np.nan), np.full((len(rate_time), 6), np.nan)
    if not start > 0:
        return path, gradient

    nodes, weights = _path_nodes()

    def powers(log_x: Floats) -> tuple[Floats, Floats, Floats]:
        """x, x^p and the rate of the decay."""
        x, power = np.exp(log_x), np.exp(p * log_x)
        return x, power, c + b * power + d * x

    def nodes_of(low: Floats, high: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """ln x, x and x^p at the nodes between two ln x, weights over the rate (NaN where x stops), rate."""
        half = 0.5 * (high - low)[:, None]
        log_x = low[:, None] + half * (1 + nodes)
        x, power, rate = powers(log_x)
        moves = np.all(rate > 0, axis=1, keepdims=True)
        return log_x, x, power, np.where(moves, weights * half * x / rate, np.nan), rate

    def integrals(low: Floats, high: Floats) -> Floats:
        """Integrals over x of 1/rate and its derivatives with respect to b, p, c and d; one row a piece."""
        log_x, x, power, weight, rate = nodes_of(low, high)
        slope = -weight / rate
        integrands = (weight, slope * power, b * slope * power * log_x, slope, slope * x)
        return np.array([integrand.sum(axis=1) for integrand in integrands]).T

    with np.errstate(all="ignore"):  # a search tries values for which terms overflow
        edges: Floats = np.linspace(log(start), log(start) - _PIECE * _PIECES, _PIECES + 1)
        cumulated = np.concatenate([np.zeros((1, 5)), np.cumsum(integrals(edges[1:], edges[:-1]), axis=0)])
        last = int(np.count_nonzero(np.isfinite(cumulated[:, 0]))) - 1
        s = rate_time - rate_time[0]
        is_reached = s <= cumulated[last, 0]
        s = s[is_reached]
        k = np.searchsorted(cumulated[: last + 1, 0], s, side="right") - 1
        k_next = np.minimum(k + 1, last)
        width = np.where(k_next > k, cumulated[k_next, 0] - cumulated[k, 0], 1.0)
        log_x = edges[k] - _PIECE * (s - cumulated[k, 0]) / width
        for _ in range(20):
            x, _power, rate = powers(log_x)
            excess = cumulated[k, 0] + nodes_of(log_x, edges[k])[3].sum(axis=1) - s
            last_log_x, log_x = log_x, np.clip(log_x + excess * rate / x, edges[k_next], edges[k])
            if not np.any(np.abs(log_x - last_log_x) > _NEWTON_TOLERANCE):
                break
        x, _power, rate = powers(log_x)
        total = cumulated[k] + integrals(log_x, edges[k])
        path[is_reached] = x
        start_rate = powers(np.log(np.array(start)))[2]
        gradient[is_reached] = np.column_stack([rate / start_rate, rate[:, None] * total[:, 1:], -rate])
    return path, gradient


@lru_cache(maxsize=1)
def _path_nodes() -> tuple[Floats, Floats]:
    return np.polynomial.legendre.leggauss(8)


def cosine_moment(exponent: Any) -> Any:
    """integral_0^(pi/2) cos(theta)^exponent dtheta, for real or complex exponents above -1."""
    from scipy.special import loggamma  # here, because it would slow down every command

    return sqrt(pi) / 2 * np.exp(loggamma((exponent + 1) / 2) - loggamma(exponent / 2 + 1))


def curvature(n: float) -> float:
    """Factor for which Eq. 6 prints 0.55; averaging Eq. 3 gives 0.540 at n = 0, 0.583 at n = 1."""
    return float(2 / pi * cosine_moment(n + 3) / cosine_moment(n + 2))


def frequency_drop(amplitude: ArrayLike, n: float, kappa: float, rho: float) -> Floats:
    """Relative decrease of the frequency with the amplitude, which Eq. 6 subtracts from 1.

    `amplitude` has any shape; `kappa` is 2 gamma a^2/(m g) and `rho` is R/a, both for the unit of
    `amplitude`.
    """
    alpha = np.asarray(amplitude, dtype=np.float64)
    drop = kappa * cosine_moment(n + 2) * alpha**n * (1 - curvature(n) * rho * alpha)
    return np.asarray(drop, dtype=np.float64)


def period(amplitude_rad: ArrayLike, parameters: ContactParameters, pendulum: PendulumOnBall) -> Floats:
    """T(alpha) of Eq. 6 in seconds; the period rises with the amplitude."""
    drop = frequency_drop(
        amplitude_rad,
        parameters.n,
        stiffness_ratio(parameters.gamma_pa, pendulum),
        relative_curvature(pendulum),
    )
    return parameters.period0_s / (1 - drop)


# Start values of the fits: linear parameters by linear least squares, the exponent by a grid search.
#
# For a given exponent p the integrated decay (Eq. 5)
#
#     alpha(0) - alpha(t) = (4/T) [ c t + b/(p+1) integral alpha^p dt + d integral alpha dt ]
#
# is linear in c, b, d, and for a given n the frequency of Eq. 6 is linear in 1/T0 and kappa/T0.


class DecayStart(NamedTuple):
    """First amplitude, and rate of the decay per s = 4 t/T: ``c + b x^p + d x`` (b stands for b/(p+1))."""

    start: float
    b: float
    p: float
    c: float
    d: float


class PeriodStart(NamedTuple):
    """Parameters of Eq. 6, kappa in units of the reference amplitude."""

    period0_s: float
    n: float
    kappa: float


def decay_start(s: Floats, x: Floats, u: Floats, *, drag: bool) -> DecayStart:
    """Best fit over a grid of exponents p, by linear least squares with non-negative rates."""
    from scipy.optimize import nnls

    best, best_cost = DecayStart(float(x[0]), 0.0, 1.0, float((x[0] - x[-1]) / s[-1]), 0.0), np.inf
    step = np.diff(s, prepend=s[0])

    def integral(values: Floats) -> Floats:
        mean = np.concatenate(([0.0], 0.5 * (values[1:] + values[:-1])))
        return np.cumsum(mean * step)

    for p in _EXPONENTS_P:
        if drag and abs(p - 1) < 0.01:
            continue
        columns = [np.ones_like(s), -integral(x**p), -(s - s[0])]
        if drag:
            columns.append(-integral(x))
        solution, cost = nnls(np.column_stack(columns) / u[:, None], x / u)
        if cost < best_cost:
            start, b, c, *d = solution.tolist()
            best, best_cost = DecayStart(start, b, float(p), c, d[0] if drag else 0.0), cost
    return best


def period_start(x: Floats, period_s: Floats, u_period_s: Floats, rho: float) -> list[PeriodStart]:
    """T0 and kappa for every exponent n of a grid, in order of rising chi-square."""
    frequency = 1 / period_s
    weight = period_s**2 / u_period_s
    starts: list[tuple[float, PeriodStart]] = []
    for n in _EXPONENTS_N.tolist():
        columns = np.column_stack([np.ones_like(x), -frequency_drop(x, n, 1.0, rho)])
        solution = FactoredJacobian(columns * weight[:, None]).coefficients(frequency * weight)
        chi2 = float(np.sum(((columns @ solution - frequency) * weight) ** 2))
        if solution[0] > 0:
            starts.append((chi2, PeriodStart(1 / float(solution[0]), n, float(solution[1] / solution[0]))))
    return [start for _, start in sorted(starts)]


class StartValues(NamedTuple):
    """Start values in units of the reference amplitude; `periods` in order of rising chi-square."""

    decay: DecayStart
    periods: list[PeriodStart]
    mean_period_s: float


def start_values(points: TurningPoints, rho: float, *, drag: bool) -> StartValues:
    """Start values of an exact fit; `rho` is R/a times the reference amplitude."""
    reference = reference_amplitude(points)
    mean = mean_period(points)
    decay, _ = fit_decay(points, reference, mean, drag, "soft_l1")
    periods = full_periods(points)
    if len(periods.points) >= FEWEST_PERIODS:
        starts = period_start(
            points.amplitude[periods.points] / reference, periods.period_s, periods.u_period_s, rho
        )
    else:
        starts = [PeriodStart(mean, 0.3, 1e-3)]
    b, p, c, *rest = decay.values.tolist()
    return StartValues(DecayStart(rest[-1], b, p, c, rest[0] if drag else 0.0), starts, mean)


def fit_decay(
    points: TurningPoints,
    reference: float,
    mean_period: float,
    drag: bool,
    loss: Loss,
    prior_drag: Estimate | None = None,
) -> tuple[Solution, Floats]:
    """Fit ``dx/ds = -(c + b x^p/(p+1) + d x)`` to the amplitudes, with a prior of d if one is given.

    Returns the solution with columns b, p, c, (d,) first amplitude, in units of the reference and of
    s = 4 t/T, and the fitted amplitudes in the unit of the points. With d the search runs in the
    coordinates of `to_valley_coordinates`.
    """
    x = points.amplitude / reference
    u = points.u_amplitude / reference
    s = (points.time_s - points.time_s[0]) * (4 / mean_period)
    first = decay_start(s, x, u, drag=drag)

    def parameters_of(columns: Floats) -> tuple[Floats, Floats]:
        """b, p, c, (d,) start, and their derivatives with respect to the solver's columns."""
        out, matrix = columns.copy(), np.eye(len(columns))
        if drag:
            stepped = np.column_stack([columns, columns[:, None] + 1e-30j * matrix])
            b = np.exp(stepped[_B])
            natural = np.array([b, *from_valley_coordinates(b, stepped[_P], stepped[_D])])
            out[[_B, _P, _D]], matrix[[_B, _P, _D]] = natural[:, 0].real, natural[:, 1:].imag / 1e-30
        return out, matrix

    def curve(columns: Floats) -> tuple[Floats, Floats]:
        parameters, matrix = parameters_of(columns)
        b, p, c = parameters[:3]
        if not -0.6 < p < 6.0:
            return np.full_like(x, np.nan), np.full((len(x), len(columns)), np.nan)
        d = parameters[_D] if drag else 0.0
        path, gradient = decay_path(s, parameters[-1], b / (p + 1), p, c, d)
        jacobian = np.empty((len(s), len(columns)))
        jacobian[:, _B] = gradient[:, 1] / (p + 1)
        jacobian[:, _P] = gradient[:, 2] - gradient[:, 1] * b / (p + 1) ** 2
        jacobian[:, _C] = gradient[:, 3]
        if drag:
            jacobian[:, _D] = gradient[:, 4]
        jacobian[:, -1] = gradient[:, 0]
        return path, jacobian @ matrix

    def model(columns: Floats) -> tuple[Floats, Floats]:
        path, jacobian = curve(columns)
        residuals, jacobian = (path - x) / u, jacobian / u[:, None]
        if prior_drag is None:
            return residuals, jacobian
        parameters, matrix = parameters_of(columns)
        u_drag = prior_drag.standard_uncertainty
        residuals = np.append(residuals, (parameters[_D] - prior_drag.value) / u_drag)
        return residuals, np.vstack([jacobian, matrix[_D] / u_drag])

    rate = (x[0] - x[-1]) / (s[-1] - s[0])
    # with a rate of exactly zero the derivative with respect to its exponent would vanish
    b0 = max(first.b * (first.p + 1), 1e-3 * rate)
    upper = np.full(5 if drag else 4, np.inf)
    lower = -upper
    lower[-1] = 0.1 * x.max()
    if drag:
        # as in the exact fit: if b accounts for several times the whole loss, b and drag merely cancel
        lower[_B], upper[_B] = -30.0, np.log(6 * abs(np.log(x[0] / x[-1])) / (s[-1] - s[0]))
    else:
        lower[_P], upper[_P] = -0.5, 5.0
    # because of noise the best start of the grid may reach zero before the data end: try slower decays
    for factor in (1.0, 0.9, 0.7, 0.5, 0.3, 0.1):
        b, c = b0 * factor, first.c * factor
        start = np.array([b, first.p, c, *([0.0] if drag else []), first.start])
        if drag:
            start[_B] = np.log(b)
            start[_P], start[_D] = to_valley_coordinates(float(b), first.p, first.d * factor)
        start = np.clip(start, lower + 1e-9, upper - 1e-9)
        if np.all(np.isfinite(model(start)[0])):
            break
    else:
        raise DataError("the decay has no start from which Eq. 5 reaches the last half-cycle")
    solution = solve(model, start, lower=lower, upper=upper, loss=loss)
    parameters, matrix = parameters_of(solution.values)
    return (
        replace(
            solution,
            values=parameters,
            covariance=propagate(matrix, solution.covariance),
            residuals=solution.residuals[: len(x)],
            jacobian=solution.jacobian[: len(x)] @ np.linalg.inv(matrix),
        ),
        curve(solution.values)[0] * reference,
    )


# Coordinates that separate friction from a linear drag.
#
# For p near 1, b x^p = b x [1 + (p-1) ln x + ...] is nearly linear in x, and b is strongly correlated with a
# drag. The data then determine the factor of the logarithm, ``omega = b (p-1)/(p+1)``, and the total linear
# loss, ``linear = b/(p+1) + drag``. In the coordinates ln b, omega, linear the valley of chi-square is
# straight and runs along ln b.


def from_valley_coordinates(b: Any, omega: Any, linear: Any) -> tuple[Any, Any]:
    """p and drag (in the unit of the linear loss), of real or complex coordinates.

    NaN if no p corresponds to the coordinates.
    """
    difference = np.where(np.abs(b - omega) > 1e-12 * np.abs(b), b - omega, np.nan)
    return (b + omega) / difference, linear - difference / 2


def to_valley_coordinates(b: float, p: float, drag: float) -> tuple[float, float]:
    """The coordinates omega and linear; the inverse of `from_valley_coordinates`."""
    return b * (p - 1) / (p + 1), b / (p + 1) + drag
