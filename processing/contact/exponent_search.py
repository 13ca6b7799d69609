"""Start values of the fits: linear parameters by linear least squares, the exponent by a grid search.

For a given exponent p the integrated decay (Eq. 5)

    alpha(0) - alpha(t) = (4/T) [ c t + b/(p+1) integral alpha^p dt + d integral alpha dt ]

is linear in c, b, d, and for a given n the frequency of Eq. 6 is linear in 1/T0 and kappa/T0.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact.period_law import frequency_drop

_EXPONENTS_P = np.array([0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 1.0, 1.15, 1.35, 1.6, 2.0, 2.5, 3.0])
_EXPONENTS_N = np.array([0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0])
"""Start values, which the fit varies; the paper's pairs have p from 0.82 to 0.94 and n from 0.09 to 0.55."""


class DecayStart(NamedTuple):
    """Rate of the decay per s = 4 t/T: ``c + b x^p + d x`` (b stands for b/(p+1))."""

    start: float
    b: float
    p: float
    c: float
    d: float


class PeriodStart(NamedTuple):
    period0_s: float
    n: float
    kappa: float


def decay_start(
    s: NDArray[np.float64], x: NDArray[np.float64], u: NDArray[np.float64], *, drag: bool
) -> DecayStart:
    """Best fit over a grid of exponents p, by linear least squares with non-negative rates."""
    from scipy.optimize import nnls

    best, best_cost = DecayStart(float(x[0]), 0.0, 1.0, float((x[0] - x[-1]) / s[-1]), 0.0), np.inf
    step = np.diff(s, prepend=s[0])

    def integral(values: NDArray[np.float64]) -> NDArray[np.float64]:
        mean = np.concatenate(([0.0], 0.5 * (values[1:] + values[:-1])))
        return np.cumsum(mean * step)

    for p in _EXPONENTS_P:
        if drag and abs(p - 1) < 0.01:
            continue
        columns = [np.ones_like(s), -integral(x**p), -(s - s[0])]
        if drag:
            columns.append(-integral(x))
        solution, rest = nnls(np.column_stack(columns) / u[:, None], x / u)
        if rest < best_cost:
            d = float(solution[3]) if drag else 0.0
            best, best_cost = (
                DecayStart(float(solution[0]), float(solution[1]), float(p), float(solution[2]), d),
                rest,
            )
    return best


def period_start(
    x: NDArray[np.float64],
    period_s: NDArray[np.float64],
    u_period_s: NDArray[np.float64],
    rho: float,
) -> list[PeriodStart]:
    """T0 and kappa for every exponent n of a grid, in order of rising chi-square."""
    frequency = 1 / period_s
    weight = period_s**2 / u_period_s
    found: list[tuple[float, PeriodStart]] = []
    for n in _EXPONENTS_N:
        columns = np.column_stack([np.ones_like(x), -frequency_drop(x, float(n), 1.0, rho)])
        solution, *_ = np.linalg.lstsq(columns * weight[:, None], frequency * weight, rcond=None)
        rest = float(np.sum(((columns @ solution - frequency) * weight) ** 2))
        if solution[0] > 0:
            found.append(
                (rest, PeriodStart(1 / float(solution[0]), float(n), float(solution[1] / solution[0])))
            )
    found.sort(key=lambda item: item[0])
    return [start for _, start in found]
