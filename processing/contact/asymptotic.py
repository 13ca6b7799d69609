"""The asymptotic theory of a decay: amplitude in first approximation (Eq. 5), period in second (Eq. 6).

    d alpha/dt = -(4/T) (c + b alpha^p/(p+1) + d alpha)                      (5, with a linear term d)
    T0/T = 1 - 2 kappa alpha^n J(n) (1 - curvature(n) rho alpha)             (6)

Without the linear term a closed form exists, with which the tests compare.
"""

from functools import lru_cache
from math import log, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from processing.arrays import Floats
from processing.contact.parameters import ContactParameters, PendulumOnBall, stiffness_ratio

_PIECE, _PIECES = 0.1, 400
"""Pieces of ln x over which a decay is integrated, 8 nodes each: to 1e-13, and to e^-40 of the start."""
_SETTLED = 1e-9
"""Last change of ln x; each squares it."""

PRINTED_CURVATURE = 0.55
"""The number printed in Eq. 6; averaging Eq. 3 gives `curvature(n)` instead."""


def decay_path(
    rate_time: Floats, start: float, b: float, p: float, c: float, d: float
) -> tuple[Floats, Floats]:
    """Solve ``dx/ds = -(c + b x^p + d x)`` at rising s >= s_0, with derivatives.

    The variables are separated, s = integral dx/(c + b x^p + d x), and the integral is taken over pieces of
    ln x. `b` stands for b/(p+1). Returns x and its derivatives by (start, b, p, c, d, s), shape (len, 6);
    NaN after x has reached zero.
    """
    path, gradient = np.full(len(rate_time), np.nan), np.full((len(rate_time), 6), np.nan)
    if not start > 0:
        return path, gradient

    nodes, weights = _path_nodes()

    def powers(y: Floats) -> tuple[Floats, Floats, Floats]:
        """x and x^p where ln x is y, and the rate."""
        x, power = np.exp(y), np.exp(p * y)
        return x, power, c + b * power + d * x

    def nodes_of(low: Floats, high: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """ln x, x and x^p at the nodes between two ln x, weights over the rate (NaN where x stops), rate."""
        half = 0.5 * (high - low)[:, None]
        y = low[:, None] + half * (1 + nodes)
        x, power, r = powers(y)
        return y, x, power, np.where(np.all(r > 0, axis=1, keepdims=True), weights * half * x / r, np.nan), r

    def integrals(low: Floats, high: Floats) -> Floats:
        """Of 1/r, and of its derivatives by b, p, c and d."""
        y, x, power, over, r = nodes_of(low, high)
        by = -over / r
        return np.array([part.sum(axis=1) for part in (over, by * power, b * by * power * y, by, by * x)]).T

    with np.errstate(all="ignore"):  # a search tries anything
        y: Floats = np.linspace(log(start), log(start) - _PIECE * _PIECES, _PIECES + 1)
        passed = np.concatenate([np.zeros((1, 5)), np.cumsum(integrals(y[1:], y[:-1]), axis=0)])
        ends = int(np.count_nonzero(np.isfinite(passed[:, 0]))) - 1
        wanted = rate_time - rate_time[0]
        reached = wanted <= passed[ends, 0]
        wanted = wanted[reached]
        k = np.searchsorted(passed[: ends + 1, 0], wanted, side="right") - 1
        following = np.minimum(k + 1, ends)
        width = np.where(following > k, passed[following, 0] - passed[k, 0], 1.0)
        at = y[k] - _PIECE * (wanted - passed[k, 0]) / width
        for _ in range(20):
            x, _power, r = powers(at)
            late = passed[k, 0] + nodes_of(at, y[k])[3].sum(axis=1) - wanted
            before, at = at, np.clip(at + late * r / x, y[following], y[k])
            if not np.any(np.abs(at - before) > _SETTLED):
                break
        x, _power, r = powers(at)
        total = passed[k] + integrals(at, y[k])
        path[reached] = x
        of_start = powers(np.log(np.array(start)))[2]
        gradient[reached] = np.column_stack([r / of_start, r[:, None] * total[:, 1:], -r])
    return path, gradient


@lru_cache(maxsize=1)
def _path_nodes() -> tuple[Floats, Floats]:
    return np.polynomial.legendre.leggauss(8)


def cosine_moment(exponent: Any) -> Any:
    """integral_0^(pi/2) cos(theta)^exponent dtheta, for real or complex exponents above -1."""
    from scipy.special import loggamma  # here, because it would slow down every command

    return sqrt(pi) / 2 * np.exp(loggamma((exponent + 1) / 2) - loggamma(exponent / 2 + 1))


def curvature(n: float) -> float:
    """Factor for which Eq. 6 prints 0.55: 0.540 at n = 0, 0.583 at n = 1."""
    return float(2 / pi * cosine_moment(n + 3) / cosine_moment(n + 2))


def frequency_drop(
    amplitude: ArrayLike, n: float, kappa: float, rho: float, *, printed_curvature: bool = False
) -> Floats:
    """Relative decrease of the frequency with the amplitude, which Eq. 6 subtracts from 1.

    `amplitude` has any shape; `kappa` is 2 gamma a^2/(m g) and `rho` is R/a, both for the unit of
    `amplitude`.
    """
    alpha = np.asarray(amplitude, dtype=np.float64)
    factor = PRINTED_CURVATURE if printed_curvature else curvature(n)
    drop = kappa * cosine_moment(n + 2) * alpha**n * (1 - factor * rho * alpha)
    return np.asarray(drop, dtype=np.float64)


def period(
    amplitude_rad: ArrayLike,
    parameters: ContactParameters,
    pendulum: PendulumOnBall,
    *,
    printed_curvature: bool = False,
) -> Floats:
    """T(alpha) of Eq. 6 in seconds; the period rises with the amplitude.

    `printed_curvature` uses 0.55 as printed instead of `curvature(n)`.
    """
    drop = frequency_drop(
        amplitude_rad,
        parameters.n,
        stiffness_ratio(parameters.gamma_pa, pendulum),
        pendulum.ball_radius_m / pendulum.contact_radius_m,
        printed_curvature=printed_curvature,
    )
    return parameters.period0_s / (1 - drop)
