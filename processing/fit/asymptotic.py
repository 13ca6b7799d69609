"""The paper's own analysis: Eq. 5 fitted to alpha(t), Eq. 6 to T(alpha), one after the other.

Both equations are approximations, and their parameters come out biased by some per cent (which
neither chi2 nor the relative errors of Eqs. 8 and 9 show); the exact fit is not. These are kept
because the paper's numbers were made so, and because they start the exact fit.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall, decay_path, path_nodes, relative_curvature, stiffness_ratio
from processing.errors import DataError
from processing.fit.checks import OUTLIER, check_turning_points, data_warnings
from processing.fit.period_fit import fit_period, period_by_log_rho, period_covariance
from processing.fit.result import AMPLITUDE_NAME, CONTACT_NAMES, DRAG_NAME, UNCALIBRATED_NAMES, FitResult
from processing.fit.start import DecayStart, PeriodStart, decay_start, period_start
from processing.fit.straight import from_straight, to_straight
from processing.least_squares import Loss, Solution, propagate, solve
from processing.periods import (
    full_periods,
    mean_period,
    mean_period_estimate,
    reference_amplitude,
)
from processing.swing import TurningPoints

FEWEST_PERIODS = 5


class AsymptoticScaled(NamedTuple):
    """Both fits in units of the reference amplitude: where the exact fit starts."""

    decay: DecayStart
    periods: list[PeriodStart]
    mean_period_s: float


def _fit_decay(
    points: TurningPoints, reference: float, mean_period: float, drag: bool, loss: Loss
) -> tuple[Solution, NDArray[np.float64]]:
    """Columns b, p, c, (d,) start, in units of the reference and of T/4."""
    x = points.amplitude / reference
    u = points.u_amplitude / reference
    s = (points.time_s - points.time_s[0]) * (4 / mean_period)
    first = decay_start(s, x, u, drag=drag)
    nodes = path_nodes()

    def natural(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """b, p, c, (d,) start, and their derivatives by the solver's columns."""
        out, matrix = values.copy(), np.eye(len(values))
        if drag:
            coordinates = [0, 1, 3]
            out[1], out[3], by = from_straight(*values[coordinates].tolist())
            matrix[1, coordinates], matrix[3, coordinates] = by
            out[0] = matrix[0, 0] = np.exp(values[0])
        return out, matrix

    def curve(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        known, matrix = natural(values)
        b, p, c = known[:3]
        if not -0.6 < p < 6.0:
            return np.full_like(x, np.nan), np.full((len(x), len(values)), np.nan)
        d = known[3] if drag else 0.0
        path, gradient = decay_path(s, known[-1], b / (p + 1), p, c, d, *nodes)
        jacobian = np.empty((len(s), len(values)))
        jacobian[:, 0] = gradient[:, 1] / (p + 1)
        jacobian[:, 1] = gradient[:, 2] - gradient[:, 1] * b / (p + 1) ** 2
        jacobian[:, 2] = gradient[:, 3]
        if drag:
            jacobian[:, 3] = gradient[:, 4]
        jacobian[:, -1] = gradient[:, 0]
        return path, jacobian @ matrix

    def model(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        path, jacobian = curve(values)
        return (path - x) / u, jacobian / u[:, None]

    rate = (x[0] - x[-1]) / (s[-1] - s[0])
    # A rate of exactly zero has no derivative by its exponent.
    b0 = max(first.b * (first.p + 1), 1e-3 * rate)
    lower = np.full(5 if drag else 4, -np.inf)
    upper = np.full(5 if drag else 4, np.inf)
    lower[-1] = 0.1 * x.max()
    if drag:
        # as in the exact fit: beyond several times the loss, b and drag only cancel
        lower[0], upper[0] = -30.0, np.log(6 * abs(np.log(x[0] / x[-1])) / (s[-1] - s[0]))
    else:
        lower[1], upper[1] = -0.5, 5.0
    # Noise can make the grid's best start end before the data do; a slower decay does not.
    for slower in (1.0, 0.9, 0.7, 0.5, 0.3, 0.1):
        b, c = b0 * slower, first.c * slower
        start = np.array([b, first.p, c, *([first.d * slower] if drag else []), first.start])
        if drag:
            start[0] = np.log(b)
            start[1], start[3] = to_straight(float(start[0]), first.p, first.d * slower)
        start = np.clip(start, lower + 1e-9, upper - 1e-9)
        if np.all(np.isfinite(model(start)[0])):
            break
    else:
        raise DataError("the decay has no start from which Eq. 5 reaches the last half-cycle")
    solution = solve(model, start, lower=lower, upper=upper, loss=loss)
    known, matrix = natural(solution.values)
    return (
        replace(solution, values=known, covariance=propagate(matrix, solution.covariance)),
        curve(solution.values)[0] * reference,
    )


def scaled_start(points: TurningPoints, rho: float, *, drag: bool) -> AsymptoticScaled:
    """Start values for the exact fit, without the asymptotic fits' last digits."""
    reference = reference_amplitude(points)
    mean = mean_period(points)
    decay, _ = _fit_decay(points, reference, mean, drag, "soft_l1")
    periods = full_periods(points)
    if len(periods.where) >= FEWEST_PERIODS:
        starts = period_start(
            points.amplitude[periods.where] / reference, periods.period_s, periods.u_period_s, rho
        )
    else:
        starts = [PeriodStart(mean, 0.3, 1e-3)]
    b, p, c, *rest = decay.values.tolist()
    return AsymptoticScaled(DecayStart(rest[-1], b, p, c, rest[0] if drag else 0.0), starts, mean)


def fit_asymptotic(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    *,
    drag: bool = False,
    loss: Loss = "linear",
    printed_curvature: bool = False,
) -> FitResult:
    """Eq. 5 to the amplitudes, then Eq. 6 to the full periods, each weighted by its uncertainty.

    Parameters
    ----------
    points
        Turning points in rad; at least ten, gaps allowed.
    pendulum
        None where the amplitudes are not calibrated, see `fit_exact`.
    drag
        Adds a linear term to the decay (moment ``-m g R drag_s phi'``).
    loss
        ``linear``, or a robust one that holds outlying half-cycles down.
    printed_curvature
        0.55 in Eq. 6 as printed, instead of its value for the fitted n.

    Raises
    ------
    DataError
        Turning points that cannot be fitted (see `check_turning_points`), fewer than five full
        periods, or no convergence.

    Notes
    -----
    T of Eq. 5 is the mean period of the run. `covariance` has no terms between the two fits,
    since they are made apart.
    """
    check_turning_points(points)
    reference = reference_amplitude(points)
    rho = relative_curvature(pendulum) * reference
    mean = mean_period(points)
    periods = full_periods(points)
    if len(periods.where) < FEWEST_PERIODS:
        raise DataError(
            f"{len(periods.where)} full periods between the gaps, and Eq. 6 needs at least {FEWEST_PERIODS}"
        )
    decay, amplitude_model = _fit_decay(points, reference, mean, drag, loss)
    period, period_model, _ = fit_period(points, periods, reference, rho, printed_curvature, loss)
    for name, solution in (("Eq. 5", decay), ("Eq. 6", period)):
        if not solution.converged:
            raise DataError(f"the fit of {name} did not converge ({solution.message})")

    b, p, c, *rest = decay.values.tolist()
    t0, n, kappa = period.values.tolist()
    log_r = np.log(reference)
    per_kappa = 1.0 if pendulum is None else 1 / stiffness_ratio(1.0, pendulum)
    b_factor, gamma_factor = reference ** (1 - p), reference**-n * per_kappa
    contact_names = UNCALIBRATED_NAMES if pendulum is None else CONTACT_NAMES
    names = [*contact_names, *([DRAG_NAME] if drag else []), AMPLITUDE_NAME]
    values = [b * b_factor, p, c * reference, n, t0, kappa * gamma_factor]
    drag_factor = 2 * mean / np.pi**2
    if drag:
        values.append(rest[0] * drag_factor)
    values.append(rest[-1] * reference)

    size, k = len(names), len(decay.values)
    to_physical = np.zeros((size, k + 3))  # columns: decay fit, then period fit
    to_physical[0, 0], to_physical[0, 1] = b_factor, -log_r * values[0]
    to_physical[1, 1] = 1.0
    to_physical[2, 2] = reference
    to_physical[3, k + 1] = 1.0
    to_physical[4, k] = 1.0
    to_physical[5, k + 2], to_physical[5, k + 1] = gamma_factor, -log_r * values[5]
    if drag:
        to_physical[6, 3] = drag_factor
    to_physical[-1, k - 1] = reference
    scatter = np.zeros((k + 3, k + 3))
    scatter[:k, :k] = decay.covariance * max(1.0, decay.chi2 / decay.dof)
    scatter[k:, k:] = period_covariance(period, points, periods) * max(1.0, period.chi2 / period.dof)

    moved = period_by_log_rho(period, points, periods, reference, rho, printed_curvature)
    by_log_rho = to_physical @ np.concatenate([np.zeros(k), moved])

    outlying = np.abs(decay.residuals) > OUTLIER
    outlying[periods.where] |= np.abs(period.residuals) > OUTLIER
    amplitude_residual = points.amplitude - amplitude_model
    period_residual = periods.period_s - period_model
    return FitResult(
        model="asymptotic",
        names=tuple(names),
        values=np.array(values),
        covariance=propagate(to_physical, scatter),
        chi2=decay.chi2 + period.chi2,
        dof=decay.dof + period.dof,
        arae_decay=float(np.mean(np.abs(amplitude_residual) / points.amplitude)),
        arae_period=float(np.mean(np.abs(period_residual) / periods.period_s)),
        reference_rad=reference,
        by_log_rho=by_log_rho,
        mean_period_s=mean_period_estimate(points, period.chi2 / period.dof),
        loss=loss,
        cost=decay.cost + period.cost,
        outliers=tuple(int(i) for i in points.index[outlying]),
        warnings=data_warnings(points, pendulum, decay.chi2 / decay.dof, period.chi2 / period.dof),
    )
