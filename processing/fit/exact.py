"""The joint fit of the exact half-swing map to amplitudes and times of all turning points."""

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall, cosine_moment
from processing.errors import DataError
from processing.estimate import WELL_DETERMINED
from processing.fit.asymptotic import AsymptoticScaled, scaled_start
from processing.fit.checks import OUTLIER, check_turning_points, data_warnings
from processing.fit.exact_model import STIFFEST, ExactModel
from processing.fit.result import FitResult
from processing.fit.start import PeriodStart
from processing.least_squares import Loss, Solution, propagate, solve
from processing.periods import full_periods, mean_period_estimate
from processing.swing import TurningPoints

_GOOD_CHI2 = 1.5
"""Above this a minimum may be a local one: other starts are tried."""


def _natural_start(model: ExactModel, scaled: AsymptoticScaled, period: PeriodStart) -> NDArray[np.float64]:
    """A start: Eq. 5's rate, taken back to the moment it stands for in the exact map.

    Eq. 5 knows neither that adhesion softens the restoring moment nor that T is not T0.
    """
    decay = scaled.decay
    stiffness = (period.period0_s / scaled.mean_period_s) ** 2
    factor = stiffness if 0.3 < stiffness < 3 else 1.0
    drag = [decay.d * 4 / np.pi] if model.drag else []
    return np.array(
        [
            np.log(max(decay.b * factor, 1e-9)),
            decay.p,
            decay.c * factor,
            np.clip(period.n, 0.01, 4.9),
            np.clip(period.kappa, -0.5, 0.5),
            *drag,
            decay.start,
            period.period0_s,
            model.points.time_s[0],
        ]
    )


def _starts(model: ExactModel, scaled: AsymptoticScaled) -> list[NDArray[np.float64]]:
    """The likeliest start first, then others, each one the map can run from."""
    flat = PeriodStart(scaled.mean_period_s, 0.5, 0.0)
    wanted = [_natural_start(model, scaled, period) for period in [*scaled.periods[:3], flat]]
    usable = []
    for natural in wanted:
        for slower in (1.0, 0.9, 0.7, 0.4):
            trial = natural.copy()
            trial[0] += np.log(slower)
            trial[2] *= slower
            if model.drag:
                trial[5] *= slower
            columns = np.clip(model.columns(trial), model.lower + 1e-9, model.upper - 1e-9)
            if np.all(np.isfinite(model(columns)[0])):
                usable.append(columns)
                break
    return usable


def solve_exact(model: ExactModel, loss: Loss) -> Solution:
    """Best converged minimum over the starts; the first one suffices where it fits the data."""
    starts = _starts(model, scaled_start(model.points, model.rho, drag=model.drag))
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
    drag: bool = False,
    loss: Loss = "linear",
) -> FitResult:
    """Fit the exact half-swing map to amplitudes and times of the turning points, jointly.

    Parameters
    ----------
    points
        Turning points in rad; at least ten. Missing half-cycles (gaps in `index`) cost nothing
        but their information: the map runs over them.
    pendulum
        None where the amplitudes are not calibrated (pixels, volts): R/a, whose effect is a few
        per mille, then counts as zero, ``kappa`` takes the place of ``gamma_pa``, and a warning
        says so.
    drag
        Also fit a linear drag, moment ``-m g R drag_s phi'``.
    loss
        ``linear``, or a robust one that holds outlying half-cycles down.

    Raises
    ------
    DataError
        Turning points that cannot be fitted (see `check_turning_points`), or no convergence.

    Notes
    -----
    Only b is forced to be positive. c, gamma and the drag are not: a coefficient that the data
    cannot tell from zero scatters about its true value and its interval covers it. See
    `identifiability`.
    """
    check_turning_points(points)
    model = ExactModel(points, pendulum, drag=drag)
    solution = solve_exact(model, loss)
    amplitude, time, _, _ = model.curve(solution.values)
    amplitude_model = amplitude * model.reference
    names, values, to_physical = model.physical(solution.values)
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
        model="exact",
        names=names,
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
            *_poorly_determined(names, values, covariance),
        ),
    )


def _poorly_determined(
    names: tuple[str, ...], values: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[str, ...]:
    """Parameters of which the interval says more than the value; the last two names are nuisance."""
    found = []
    for name, value, variance in zip(names[:-2], values, np.diag(covariance), strict=False):
        u = float(np.sqrt(variance))
        if u > WELL_DETERMINED * abs(value):
            known = f"u = {u / abs(value):.0%} of it" if value and np.isfinite(u) else "u without limit"
            found.append(f"{name} is poorly determined ({known}): take its interval, not its value")
    return tuple(found)


def _doubts(model: ExactModel, solution: Solution) -> tuple[str, ...]:
    """Values that stand where the search was not let any further."""
    natural, _ = model.natural(solution.values)
    stiffness = 1 - 2 * natural[4] * cosine_moment(natural[3] + 2)
    limited = {
        "b": (natural[0], model.lower[0], model.upper[0]),
        "p": (natural[1], -0.5, 5.0),
        "n": (natural[3], model.lower[3], model.upper[3]),
        model.names[5]: (np.log(stiffness), -np.log(0.9 * STIFFEST), np.log(0.9 * STIFFEST)),
    }
    return tuple(
        f"{name} stands at the limit of its range: the data do not determine it"
        for name, (value, low, high) in limited.items()
        if value - low < 1e-4 or high - value < 1e-4
    )
