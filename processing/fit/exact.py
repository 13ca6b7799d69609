"""Joint fit of the exact half-swing map to the amplitudes and times of all turning points."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall
from processing.contact.laws import PAPER, Law
from processing.errors import DataError
from processing.estimate import WELL_DETERMINED
from processing.fit.checks import OUTLIER, check_turning_points, data_warnings
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.least_squares import Loss, Solution, propagate, solve
from processing.periods import full_periods, mean_period_estimate
from processing.swing import TurningPoints

_GOOD_CHI2 = 1.5
"""Reduced chi-square above which a minimum may be a local one; other start values are tried then."""


def solve_exact(model: ExactModel, loss: Loss) -> Solution:
    """Best converged minimum over the start values; the first one is accepted if it fits the data."""
    starts = model.starts()
    if not starts:
        raise DataError("no start from which the half-swing map reaches the last half-cycle")
    best: Solution | None = None
    message = ""
    for start in starts:
        solution = solve(model, start, lower=model.lower, upper=model.upper, loss=loss)
        message = solution.message
        if solution.converged and (best is None or solution.cost < best.cost):
            best = solution
        if best is not None and 2 * best.cost / best.dof < _GOOD_CHI2:
            break
    if best is None:
        raise DataError(f"the exact fit did not converge from {len(starts)} starts ({message})")
    return best


def fit_exact(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    *,
    law: Law = PAPER,
    drag: bool = False,
    loss: Loss = "linear",
) -> FitResult:
    """Fit the exact half-swing map to amplitudes and times of the turning points, jointly.

    Parameters
    ----------
    points
        Turning points in rad; at least ten. Half-cycles may be missing (gaps in `index`); the map is applied
        to them as well.
    pendulum
        None if the amplitudes are not calibrated (pixels, volts). R/a, whose effect is a few per mille, is
        then set to zero, ``kappa`` replaces ``gamma_pa``, and the result contains a warning.
    law
        A law of the registry, or another one.
    drag
        Also fit a linear drag, moment ``-m g R drag_s phi'``.
    loss
        ``linear``, or a robust loss that reduces the influence of outliers.

    Raises
    ------
    DataError
        Turning points that cannot be fitted (see `check_turning_points`), or no convergence.

    Notes
    -----
    Only b is forced to be positive. c, gamma and the drag may become negative, so that the estimate of a
    coefficient near zero is unbiased and its interval covers the true value. See `identifiability`.
    """
    check_turning_points(points)
    model = ExactModel(points, pendulum, law=law, drag=drag)
    solution = solve_exact(model, loss)
    amplitude, time, _, _ = model.curve(solution.values)
    amplitude_model = amplitude * model.reference
    values, to_physical = model.columns.physical(solution.values)
    chi2_per_dof = solution.chi2 / solution.dof
    scatter = solution.covariance * (max(1.0, chi2_per_dof) if loss == "linear" else 1.0)
    covariance = propagate(to_physical, scatter)

    count = len(points)
    normalised = np.abs(solution.residuals)
    outlying = (normalised[:count] > OUTLIER) | (normalised[count:] > OUTLIER)
    periods = full_periods(points)
    period_model = time[periods.where + 1] - time[periods.where - 1]
    period_residual = periods.period_s - period_model
    return FitResult(
        method=FitMethod.EXACT,
        law=law,
        names=model.names,
        values=values,
        covariance=covariance,
        chi2=solution.chi2,
        dof=solution.dof,
        arae_decay=float(np.mean(np.abs(points.amplitude - amplitude_model) / points.amplitude)),
        arae_period=(
            float(np.mean(np.abs(period_residual) / periods.period_s)) if len(periods.where) else float("nan")
        ),
        reference_rad=model.reference,
        by_log_rho=to_physical @ model.by_log_rho(solution.values, solution.jacobian),
        mean_period_s=mean_period_estimate(points, chi2_per_dof),
        loss=loss,
        cost=solution.cost,
        outliers=tuple(int(i) for i in points.index[outlying]),
        warnings=(
            *data_warnings(points, pendulum, chi2_per_dof),
            *_doubts(model, solution),
            *_poorly_determined(model.names, values, covariance),
        ),
    )


def _poorly_determined(
    names: tuple[str, ...], values: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[str, ...]:
    """Parameters with a large relative uncertainty; the last two names (amplitude, time) are not tested."""
    found = []
    for name, value, variance in zip(names[:-2], values, np.diag(covariance), strict=False):
        u = float(np.sqrt(variance))
        if u > WELL_DETERMINED * abs(value):
            known = f"u = {u / abs(value):.0%} of it" if value and np.isfinite(u) else "u without limit"
            found.append(f"{name} is poorly determined ({known}): take its interval, not its value")
    return tuple(found)


def _doubts(model: ExactModel, solution: Solution) -> tuple[str, ...]:
    """Warnings about parameters at a limit of the range of search."""
    return tuple(
        f"{name} stands at the limit of its range: the data do not determine it"
        for name in model.columns.at_limit(solution.values)
    )
