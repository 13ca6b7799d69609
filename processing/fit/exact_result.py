"""The result of an exact fit: physical values, their uncertainties, and what is to be said of them.

A chi-square near its number of degrees of freedom says nothing of the order in which the residuals come. A
model that does not describe the data leaves neighbours alike: that is tested, and widens uncertainties.
"""

from dataclasses import replace
from math import nan

import numpy as np

from processing.arrays import Floats
from processing.contact.laws import AMPLITUDE, DRAG, TIME
from processing.decay_summary import full_periods, mean_period_estimate
from processing.estimate import FitMethod
from processing.fit.checks import (
    OUTLIER,
    correlation_warnings,
    data_warnings,
    ground_warnings,
    limit_warnings,
    overstated_u_warnings,
)
from processing.fit.evidence import AIR, WAVEFORM
from processing.fit.exact_model import ExactModel
from processing.fit.ground import AT_REST, GroundFit
from processing.fit.result import READING, FitResult, Whiteness, changes_of
from processing.least_squares import FactoredJacobian, Loss, Solution, covariance_of, propagate

_LAGS = 20
"""Box and Jenkins' usual number; of a short run a fifth of its length, since far lags have few pairs."""


def result_of(
    model: ExactModel,
    solution: Solution,
    ground: GroundFit,
    loss: Loss,
    likeliest: Floats | None = None,
    averaged: Floats | None = None,
) -> FitResult:
    """Physical values, their uncertainties and what is to be said of them.

    `averaged` over the noise that the data allow and at the `likeliest` are covariances of the columns;
    their ratio enlarges the uncertainties.
    """
    points, pendulum = model.points, model.pendulum
    amplitude, time, _, _ = model.curve(solution.values)
    deviation = np.abs(points.amplitude - amplitude * model.reference) / points.amplitude
    values, to_physical = model.columns.physical(solution.values)
    chi2_per_dof = solution.chi2 / solution.dof
    scatter = solution.covariance * (max(1.0, chi2_per_dof) if loss == "linear" else 1.0)
    covariance = propagate(to_physical, scatter)
    widened = np.ones(len(covariance))
    if likeliest is not None and averaged is not None:
        # never smaller: a drive that was seen may still be larger than the likeliest one
        widened *= np.maximum(1.0, _factor(to_physical, averaged, likeliest))
    of_points = solution.residuals[: 2 * len(points)]
    white = whiteness(of_points / np.sqrt(max(1.0, chi2_per_dof)))
    if np.all(np.isfinite(covariance)):
        factor = _by_correlation(to_physical, solution, white, len(points))
        white = replace(white, widened=float(factor.max()))
        widened *= factor
    covariance = covariance * np.outer(widened, widened)
    terms = {READING: changes_of(propagate(to_physical, _measurement_covariance(model, solution)))}
    by_air = _by_air(model, solution)
    if by_air is not None:
        scale = max(1.0, chi2_per_dof) ** 0.5 if loss == "linear" else 1.0
        terms[AIR] = (widened * scale * (to_physical @ by_air))[:, None]

    count = len(points)
    normalised = np.abs(of_points)
    outlying = (normalised[:count] > OUTLIER) | (normalised[count:] > OUTLIER)
    periods = full_periods(points)
    period_model = time[periods.where + 1] - time[periods.where - 1]
    period_deviation = np.abs(periods.period_s - period_model) / periods.period_s
    return FitResult(
        method=FitMethod.EXACT,
        law=model.law,
        names=model.names,
        values=values,
        covariance=covariance,
        chi2_per_dof=chi2_per_dof,
        degrees_of_freedom=solution.dof,
        arae_decay=_mean_of_finite(deviation),
        arae_period=_mean_of_finite(period_deviation),
        reference_rad=model.reference,
        by_log_rho=to_physical @ _by_log_rho(model, solution.values),
        mean_period_s=mean_period_estimate(points, chi2_per_dof),
        loss=loss,
        cost=solution.cost,
        outliers=tuple(int(i) for i in points.index[outlying]),
        warnings=(
            *data_warnings(points, pendulum, {"amplitudes and times": chi2_per_dof}, ground.noise.step),
            *overstated_u_warnings(chi2_per_dof, solution.dof),
            *ground_warnings(ground, points),
            *correlation_warnings(white),
            *limit_warnings(model.columns.at_limit(solution.values)),
        ),
        half_cycles=count,
        ground=ground,
        widened=widened,
        terms=terms,
        whiteness=white,
        evidence=model.evidence_at(solution.values, scatter),
        worth=_worth(model, solution, to_physical),
    )


def _rows_beside(model: ExactModel) -> dict[str, slice]:
    """Rows of the residuals in which each part of the evidence stands."""
    first, count = 2 * len(model.points), len(model.beside(np.zeros(len(model.lower)))[0])
    last = first + count - (model.evidence.drag_s is not None and DRAG.key in model.names)
    rows = {WAVEFORM: slice(first, last), AIR: slice(last, first + count)}
    return {name: part for name, part in rows.items() if part.start < part.stop}


def _by_air(model: ExactModel, solution: Solution) -> Floats | None:
    """Change of the columns for one standard uncertainty of what is known of the drag; None without."""
    rows = _rows_beside(model).get(AIR)
    if rows is None or not np.all(np.isfinite(solution.covariance)):
        return None
    return np.asarray(solution.covariance @ solution.jacobian[rows][0])


def _by_log_rho(model: ExactModel, columns: Floats) -> Floats:
    """Derivative of the fitted columns by ln(R/a)."""
    both = model.filtered_here(columns, with_rho=True).jacobian
    beside = model.beside_here(columns)[1]
    both = np.concatenate([both, np.column_stack([beside, np.zeros(len(beside))])])
    return -FactoredJacobian(both[:, :-1]).coefficients(both[:, -1])


def _worth(model: ExactModel, solution: Solution, to_physical: Floats) -> dict[str, dict[str, float]]:
    """By how many times larger uncertainties would be without a part of the evidence."""
    worth = {}
    whole = covariance_of(solution.jacobian)
    for part, rows in _rows_beside(model).items():
        without = covariance_of(np.delete(solution.jacobian, rows, axis=0))
        factor = _factor(to_physical, without, whole)
        blind = ~np.isfinite(np.einsum("ij,jk,ik->i", to_physical, without, to_physical))
        factor = np.where(blind, np.inf, factor)
        kept = (name not in (AMPLITUDE.key, TIME.key) for name in model.names)
        worth[part] = {
            name: float(one) for name, one, stays in zip(model.names, factor, kept, strict=True) if stays
        }
    return worth


def _factor(to_physical: Floats, wider: Floats, covariance: Floats) -> Floats:
    """Ratio of the standard uncertainties by two covariances of the columns."""
    above, below = (np.einsum("ij,jk,ik->i", to_physical, one, to_physical) for one in (wider, covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(above / below, nan=1.0, posinf=1.0)
        return np.asarray(np.sqrt(np.maximum(ratio, 0.0)))


def _measurement_covariance(model: ExactModel, solution: Solution) -> Floats:
    """Covariance of the columns if only the measurement of the turning points were uncertain."""
    residuals, jacobian = model.on_ground(solution.values, AT_REST, model.scale)(solution.values)
    reached = np.isfinite(residuals)
    return np.asarray(covariance_of(jacobian[reached]) * max(1.0, solution.chi2 / solution.dof))


def _mean_of_finite(values: Floats) -> float:
    """The free decay may end before a driven one does."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if len(finite) else float("nan")


def _by_correlation(to_physical: Floats, solution: Solution, white: Whiteness, count: int) -> Floats:
    """By how many times correlated residuals enlarge every standard uncertainty."""
    of_points = slice(2 * count)
    jacobian, covariance = solution.jacobian[of_points], solution.covariance
    factor = _factor(to_physical, neighbours_covariance(white, jacobian, covariance), covariance)
    if white.correlated:
        residuals = solution.residuals[of_points] / np.sqrt(solution.chi2 / solution.dof)
        wider = correlated_covariance(residuals, jacobian, covariance, white.lags)
        factor = np.maximum(factor, _factor(to_physical, wider, covariance))
    return np.asarray(np.maximum(1.0, factor))


def whiteness(residuals: Floats) -> Whiteness:
    """Test whitened residuals, those of the amplitudes first and then as many of the times."""
    count = len(residuals) // 2
    lags = min(_LAGS, count // 5)
    p_amplitude, first_amplitude = _ljung_box(residuals[:count], lags)
    p_time, first_time = _ljung_box(residuals[count:], lags)
    return Whiteness(lags, p_amplitude, p_time, first_amplitude, first_time)


def _ljung_box(z: Floats, lags: int) -> tuple[float, float]:
    from scipy.special import chdtrc

    count = len(z)
    z = np.clip(z, -5.0, 5.0)  # an outlier is listed as such; it must not hide or feign a correlation
    power = float(z @ z)
    if lags < 1 or not power > 0:
        return nan, nan
    lag = np.arange(1, lags + 1)
    correlation = np.array([float(z[k:] @ z[:-k]) for k in lag.tolist()]) / power
    return float(chdtrc(lags, count * (count + 2) * np.sum(correlation**2 / (count - lag)))), float(
        correlation[0]
    )


def correlated_covariance(residuals: Floats, jacobian: Floats, covariance: Floats, lags: int) -> Floats:
    """Covariance of fitted columns if neighbouring residuals are correlated (Newey and West, 1987).

    Parameters
    ----------
    residuals, jacobian
        Whitened, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance; it takes the place of the estimate at lag 0.
    """
    count = len(residuals) // 2
    score = (jacobian * residuals[:, None]).reshape(2, count, -1).sum(axis=0)
    both = np.zeros_like(covariance)
    for k in range(1, lags + 1):
        part = np.einsum("ij,ik->jk", score[k:], score[:-k]) * (1 - k / (lags + 1))
        both += part + part.T
    return np.asarray(covariance + covariance @ both @ covariance)


def neighbours_covariance(found: Whiteness, jacobian: Floats, covariance: Floats) -> Floats:
    """Covariance of fitted columns if next neighbours are as alike as they were found, and no others.

    Slow noise, as of air, makes times of neighbours alike by 0.2. That makes sums of them a fifth more
    uncertain, and the test misses it in a few hundred half-cycles. Correlations count less by what chance
    makes of them (the positive part of James and Stein, 1961); none makes uncertainties smaller.

    Parameters
    ----------
    jacobian
        Of whitened residuals, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance.
    """
    count = len(jacobian) // 2
    both = np.zeros_like(covariance)
    for first, rows in (
        (found.first_amplitude, jacobian[:count]),
        (found.first_time, jacobian[count : 2 * count]),
    ):
        if first > 0.0:
            alike = first * max(0.0, 1.0 - 1.0 / (count * first**2))
            part = rows[1:].T @ rows[:-1]
            both += alike * (part + part.T)
    return np.asarray(covariance + covariance @ both @ covariance)
