"""The paper's analysis: fit of Eq. 5 to alpha(t), then of Eq. 6 to T(alpha).

Both equations are approximations. Their parameters are biased by some per cent, which neither chi2 nor the
relative errors of Eqs. 8 and 9 reveal; those of the exact fit are not biased. These fits are kept for
comparison with the paper's results.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from processing.arrays import Floats
from processing.contact import (
    PendulumOnBall,
    fit_decay,
    frequency_drop,
    period_start,
    relative_curvature,
    stiffness_ratio,
)
from processing.contact.laws import AMPLITUDE, DRAG, PAPER
from processing.decay_summary import (
    FEWEST_PERIODS,
    Periods,
    full_periods,
    mean_period,
    mean_period_estimate,
    reference_amplitude,
)
from processing.errors import DataError
from processing.estimate import Estimate, FitMethod
from processing.fit.exact_model import ExactModel
from processing.fit.exact_result import OUTLIER, check_turning_points, data_warnings
from processing.fit.result import FitResult
from processing.least_squares import Loss, Solution, differenced, propagate, solve
from processing.swing import TurningPoints


def fit_asymptotic(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    *,
    drag: bool = False,
    loss: Loss = "linear",
    exact: FitResult | None = None,
    known_drag: Estimate | None = None,
) -> FitResult:
    """Eq. 5 to the amplitudes, then Eq. 6 to the full periods, each weighted by its uncertainty.

    Parameters
    ----------
    points
        Turning points in rad; at least ten, gaps allowed.
    drag
        Adds a linear term to the decay (moment ``-m g R drag_s phi'``).
    loss
        ``linear``, or a robust loss that reduces the influence of outliers.
    exact
        The exact fit of the same points. Its turning points are fitted, the bias is stated by it and, if it
        found a drive of the ground, the uncertainties contain that (`_driven_covariance`).
    known_drag
        Value and standard uncertainty of the drag in s; by default that of `exact`.

    Raises
    ------
    DataError
        Turning points that cannot be fitted (see `check_turning_points`), or fewer than five full periods.

    Notes
    -----
    The parameters of an equation whose search does not converge have infinite variances, with a warning.

    T of Eq. 5 is the mean period of the run. The elements of `covariance` between the parameters of the two
    fits are zero, because the fits are independent; a drive makes them dependent.
    """
    check_turning_points(points)
    if exact is not None:
        points = points.first(exact.half_cycles)
    reference = reference_amplitude(points)
    rho = relative_curvature(pendulum) * reference
    mean_period_s = mean_period(points)
    drag_factor = 2 * mean_period_s / np.pi**2
    if known_drag is None and exact is not None and exact.has_drag:
        known_drag = exact.estimate(DRAG.key)
    known = None
    if drag and known_drag is not None:
        known = Estimate(*(drag_s / drag_factor for drag_s in known_drag))
    periods = full_periods(points)
    if len(periods.points) < FEWEST_PERIODS:
        raise DataError(
            f"{len(periods.points)} full periods between the gaps, and Eq. 6 needs at least {FEWEST_PERIODS}"
        )
    decay, amplitude_model = fit_decay(points, reference, mean_period_s, drag, loss, known)
    period, period_model = _fit_period(points, periods, reference, rho, loss)
    per_kappa = 1 / stiffness_ratio(1.0, pendulum)
    names = (*PAPER.names(drag=drag), AMPLITUDE.key)
    k = len(decay.values)

    def physical(fitted: Floats) -> Floats:
        b, p, c, *rest = fitted[:k].tolist()
        t0, n, kappa = fitted[k:].tolist()
        values = [b * reference ** (1 - p), p, c * reference, n, t0, kappa * reference**-n * per_kappa]
        return np.array([*values, *([rest[0] * drag_factor] if drag else []), rest[-1] * reference])

    values, to_physical = differenced(physical)(np.concatenate([decay.values, period.values]))
    scatter = np.zeros((k + 3, k + 3))
    if exact is None or exact.ground_fit.noise.at_rest:
        scatter[:k, :k] = decay.covariance * max(1.0, decay.chi2 / decay.dof)
        # overlapping full periods share turning points and are correlated; the turning times are independent
        by_time = _by_turning_time(period, points, periods)
        score_covariance = (by_time * points.u_time_s[:, None] ** 2).T @ by_time
        with np.errstate(invalid="ignore"):
            of_period = period.covariance @ score_covariance @ period.covariance
        scatter[k:, k:] = of_period * max(1.0, period.chi2 / period.dof)
    else:
        by_amplitude, by_time = np.zeros((len(points), k + 3)), np.zeros((len(points), k + 3))
        by_amplitude[:, :k] = decay.jacobian / points.u_amplitude[:, None] @ decay.covariance
        by_time[:, k:] = _by_turning_time(period, points, periods) @ period.covariance
        scatter = _driven_covariance(by_amplitude, by_time, points, pendulum, exact)
        if known is not None:
            of_known = decay.covariance[:, 3] / known.standard_uncertainty
            scatter[:k, :k] += np.outer(of_known, of_known)

    unconverged = []
    for name, solution, own in (("Eq. 5", decay, slice(k)), ("Eq. 6", period, slice(k, None))):
        if not solution.converged:
            np.fill_diagonal(scatter[own, own], np.inf)
            unconverged.append(f"the fit of {name} did not converge: its parameters are not determined")

    is_outlier = np.abs(decay.residuals) > OUTLIER
    is_outlier[periods.points] |= np.abs(period.residuals) > OUTLIER
    amplitude_residual = points.amplitude - amplitude_model
    period_residual = periods.period_s - period_model
    return FitResult(
        method=FitMethod.ASYMPTOTIC,
        law=PAPER,
        names=names,
        values=values,
        covariance=propagate(to_physical, scatter),
        chi2_per_dof=(decay.chi2 + period.chi2) / (decay.dof + period.dof),
        degrees_of_freedom=decay.dof + period.dof,
        arae_decay=float(np.mean(np.abs(amplitude_residual) / points.amplitude)),
        arae_period=float(np.mean(np.abs(period_residual) / periods.period_s)),
        reference_rad=reference,
        by_log_rho=np.full(len(values), np.nan),
        mean_period_s=mean_period_estimate(points, period.chi2 / period.dof),
        loss=loss,
        cost=decay.cost + period.cost,
        outliers=tuple(int(i) for i in points.index[is_outlier]),
        warnings=(
            *unconverged,
            *data_warnings(
                points,
                {
                    "the amplitudes (Eq. 5)": decay.chi2 / decay.dof,
                    "the periods (Eq. 6)": period.chi2 / period.dof,
                },
            ),
        ),
        half_cycles=len(points),
        bias=None if exact is None else _bias(exact, points, pendulum),
    )


def _bias(exact: FitResult, points: TurningPoints, pendulum: PendulumOnBall) -> dict[str, float] | None:
    """Parameters of both equations for the exact fit's free decay at the half-cycles of `points`, less those
    of the exact fit; None if the equations cannot be fitted to it."""
    model, coordinates = ExactModel.of(points, pendulum, exact)
    amplitude, time_s, _, _ = model.curve(coordinates)
    # a driven pendulum swings for longer than the free one would
    reached = int(np.count_nonzero(np.isfinite(amplitude) & np.isfinite(time_s)))
    free_decay = replace(points, amplitude=amplitude * model.reference, time_s=time_s).first(reached)
    known_drag = exact.estimate(DRAG.key) if exact.has_drag else None
    try:
        fit = fit_asymptotic(free_decay, pendulum, drag=exact.has_drag, known_drag=known_drag)
    except DataError:
        return None
    return {name: fit.estimate(name).value - exact.estimate(name).value for name in fit.contact_names}


def _fit_period(
    points: TurningPoints, periods: Periods, reference: float, rho: float, loss: Loss
) -> tuple[Solution, Floats]:
    """Solution of Eq. 6 (T0 in s, n, kappa for amplitudes in units of the reference), and its periods (s)."""
    x = points.amplitude[periods.points] / reference
    drop_of = partial(frequency_drop, x, rho=rho)

    def model(values: Floats) -> tuple[Floats, Floats]:
        t0, n, kappa = values
        drop, step = drop_of(n, kappa), 1e-5
        by_n = (drop_of(n + step, kappa) - drop_of(n - step, kappa)) / (2 * step)
        fitted = t0 / (1 - drop)
        by_drop = fitted / (1 - drop)
        jacobian = np.column_stack([fitted / t0, by_drop * by_n, by_drop * drop_of(n, 1.0)])
        return (fitted - periods.period_s) / periods.u_period_s, jacobian / periods.u_period_s[:, None]

    lower = np.array([0.2 * periods.period_s.min(), -0.9, -10.0])
    upper = np.array([2 * periods.period_s.max(), 5.0, 10.0])
    first = np.array(period_start(x, periods.period_s, periods.u_period_s, rho)[0])
    first = np.clip(first, lower + 1e-9, upper - 1e-9)
    solution = solve(model, first, lower=lower, upper=upper, loss=loss)
    t0, n, kappa = solution.values
    return solution, t0 / (1 - drop_of(n, kappa))


def _by_turning_time(solution: Solution, points: TurningPoints, periods: Periods) -> Floats:
    """Derivatives (half-cycles, 3) of the score of the period's fit with respect to the turning times."""
    weighted = solution.jacobian / periods.u_period_s[:, None]
    by_time = np.zeros((len(points), 3))
    np.add.at(by_time, periods.points + 1, weighted)
    np.add.at(by_time, periods.points - 1, -weighted)
    return by_time


def _driven_covariance(
    by_amplitude: Floats,
    by_time: Floats,
    points: TurningPoints,
    pendulum: PendulumOnBall,
    exact: FitResult,
) -> Floats:
    """Covariance of values with the derivatives (half-cycles, values) by the measured amplitudes and times.

    A least-squares fit takes the errors of turning points as independent, but a step of the drive moves all
    later ones.
    """
    noise, rate = exact.ground_fit.noise, 2 * np.pi / exact.mean_period_s.value
    model, coordinates = ExactModel.of(points, pendulum, exact)
    _, _, amplitude_jacobian, time_jacobian = model.curve(coordinates)
    # derivatives of all amplitudes and times with respect to the first amplitude
    amplitude_slope = _to_the_end(amplitude_jacobian[:, -3])
    time_slope = _to_the_end(time_jacobian[:, -3] / model.reference)

    def sums_to_end(values: Floats) -> Floats:
        return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])

    by_time_step = sums_to_end(by_time)
    by_first = sums_to_end(by_amplitude * amplitude_slope[:, None]) + sums_to_end(
        by_time * time_slope[:, None]
    )
    by_amplitude_step = (by_first - by_time_step * time_slope[:, None]) / amplitude_slope[:, None]
    steps = noise.step * np.sqrt(np.diff(points.index, prepend=points.index[0]))
    changes_by_source = (
        by_amplitude * (noise.scale * points.u_amplitude)[:, None],
        by_time * (noise.scale * points.u_time_s)[:, None],
        by_amplitude_step * steps[:, None],
        by_time_step * (steps / (rate * points.amplitude))[:, None],
    )
    return np.asarray(sum(np.einsum("ij,ik->jk", changes, changes) for changes in changes_by_source))


def _to_the_end(values: Floats) -> Floats:
    """Values with the last finite one repeated to the end: a free decay may end before a driven one."""
    reached = int(np.count_nonzero(np.isfinite(values)))
    return np.concatenate([values[:reached], np.full(len(values) - reached, values[reached - 1])])
