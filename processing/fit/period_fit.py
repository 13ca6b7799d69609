"""Fit of Eq. 6 to full periods, its covariance and its dependence on R/a."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import PeriodStart, frequency_drop, period_start
from processing.least_squares import Loss, Solution, solve
from processing.periods import Periods
from processing.swing import TurningPoints


def fit_period(
    points: TurningPoints,
    periods: Periods,
    reference: float,
    rho: float,
    printed_curvature: bool,
    loss: Loss,
) -> tuple[Solution, NDArray[np.float64], list[PeriodStart]]:
    """Fit with the columns T0 (s), n and kappa; the last for amplitudes in units of the reference."""
    x = points.amplitude[periods.where] / reference
    starts = period_start(x, periods.period_s, periods.u_period_s, rho)

    def curve(values: NDArray[np.float64]) -> NDArray[np.float64]:
        drop = frequency_drop(x, values[1], values[2], rho, printed_curvature=printed_curvature)
        return np.asarray(values[0] / (1 - drop), dtype=np.float64)

    def model(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        t0, n, kappa = values
        drop = frequency_drop(x, n, kappa, rho, printed_curvature=printed_curvature)
        step = 1e-5
        by_n = (
            frequency_drop(x, n + step, kappa, rho, printed_curvature=printed_curvature)
            - frequency_drop(x, n - step, kappa, rho, printed_curvature=printed_curvature)
        ) / (2 * step)
        by_kappa = frequency_drop(x, n, 1.0, rho, printed_curvature=printed_curvature)
        fitted = t0 / (1 - drop)
        by_drop = fitted / (1 - drop)
        jacobian = np.column_stack([fitted / t0, by_drop * by_n, by_drop * by_kappa])
        return (fitted - periods.period_s) / periods.u_period_s, jacobian / periods.u_period_s[:, None]

    lower = np.array([0.2 * periods.period_s.min(), -0.9, -10.0])
    upper = np.array([2 * periods.period_s.max(), 5.0, 10.0])
    first = np.clip(np.array(starts[0]), lower + 1e-9, upper - 1e-9)
    solution = solve(model, first, lower=lower, upper=upper, loss=loss)
    return solution, curve(solution.values), starts


def by_turning_time(solution: Solution, points: TurningPoints, periods: Periods) -> NDArray[np.float64]:
    """Derivatives of the fit's score by the turning times; the covariance makes them those of the values."""
    weighted = solution.jacobian / periods.u_period_s[:, None]
    by_time = np.zeros((len(points), 3))
    np.add.at(by_time, periods.where + 1, weighted)
    np.add.at(by_time, periods.where - 1, -weighted)
    return by_time


def period_covariance(solution: Solution, points: TurningPoints, periods: Periods) -> NDArray[np.float64]:
    """Covariance of the fitted values from the uncertainties of the turning times.

    Overlapping full periods share turning points and are correlated; the turning times are independent.
    """
    by_time = by_turning_time(solution, points, periods)
    spread = (by_time * points.u_time_s[:, None] ** 2).T @ by_time
    with np.errstate(invalid="ignore"):
        return np.asarray(solution.covariance @ spread @ solution.covariance)


def period_by_log_rho(
    solution: Solution,
    points: TurningPoints,
    periods: Periods,
    reference: float,
    rho: float,
    printed_curvature: bool,
) -> NDArray[np.float64]:
    """Derivatives of T0, n and kappa by ln(R/a), by linearised least squares."""
    x = points.amplitude[periods.where] / reference
    t0, n, kappa = solution.values
    drop = frequency_drop(x, n, kappa, rho, printed_curvature=printed_curvature)
    by_rho = drop - frequency_drop(x, n, kappa, 0.0, printed_curvature=printed_curvature)
    change = t0 / (1 - drop) ** 2 * by_rho / periods.u_period_s
    return np.asarray(-np.linalg.lstsq(solution.jacobian, change, rcond=1e-12)[0], dtype=np.float64)
