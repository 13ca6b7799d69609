"""Checks of turning points before a fit, and the result of an exact fit with its warnings.

A chi-square near its number of degrees of freedom does not depend on the order of the residuals. A model that
does not describe the data leaves neighbours correlated: that is tested, and enlarges uncertainties.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import nan

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.contact.laws import AMPLITUDE, DRAG, TIME, Law
from processing.decay_summary import full_periods, mean_period_estimate
from processing.errors import DataError
from processing.estimate import Estimate, FitMethod
from processing.fit.evidence import AIR, WAVEFORM
from processing.fit.exact_model import ExactModel
from processing.fit.ground import AT_REST, Ground, GroundFit
from processing.fit.result import MEASUREMENT, FitResult, Whiteness
from processing.least_squares import FactoredJacobian, Loss, Solution, covariance_of, propagate
from processing.number_text import plain
from processing.swing import TurningPoints

FEWEST_HALF_CYCLES = 10
"""Twenty amplitudes and times, for the eight coordinates of the paper's law and the noise."""
_OVERSTATED_CHI2, _MIN_OVERSTATED_DOF = 0.5, 60
"""Reduced chi-square below which uncertainties are called overstated, and the fewest degrees of freedom for
that: chance makes so small a value with a probability of 4e-4."""
OUTLIER = 5.0
"""Residual in standard uncertainties above which a half-cycle is listed as an outlier."""
_SMALL_RAD = 0.03
"""Amplitude up to which gravity's moment is taken as proportional: A^2/16 of the period is 6e-5 there."""
IMPOSSIBLE_U = 3.0
"""Standard uncertainties below zero beyond which a negative value is no chance."""
_LAGS = 20
"""Box and Jenkins' usual number; of a short run a fifth of its length, since far lags have few pairs."""


def check_turning_points(points: TurningPoints) -> None:
    """Raise `DataError` for turning points that are too few, out of order, not finite or not positive, or
    whose amplitudes do not fall."""
    count = len(points)
    if count < FEWEST_HALF_CYCLES:
        raise DataError(
            f"{count} usable half-cycles, and a fit needs at least {FEWEST_HALF_CYCLES}: "
            "record for longer or see which were flagged"
        )
    for name in ("time_s", "u_time_s", "amplitude", "u_amplitude"):
        values = getattr(points, name)
        not_finite = np.flatnonzero(~np.isfinite(values))
        if len(not_finite):
            where = f"{name} of half-cycle {points.index[not_finite[0]]} is {values[not_finite[0]]}"
            raise DataError(f"{where}: flag it or leave it out")
        bad = np.flatnonzero(values <= 0)
        if name != "time_s" and len(bad):
            where = f"{name} of half-cycle {points.index[bad[0]]} is {values[bad[0]]:g}"
            raise DataError(f"{where}: it must be positive")
    for name, steps in (("index", np.diff(points.index)), ("time_s", np.diff(points.time_s))):
        bad = np.nonzero(steps <= 0)[0]
        if len(bad):
            raise DataError(
                f"half-cycles out of order: {name} does not rise after half-cycle {points.index[bad[0]]}; "
                "sort them by time"
            )
    third = max(count // 3, 3)
    first = float(np.median(points.amplitude[:third]))
    last = float(np.median(points.amplitude[-third:]))
    if last >= first:
        raise DataError(
            f"the amplitude does not fall (median {first:.4g} of the first third, {last:.4g} of the last): "
            "this is not a free decay"
        )


def data_warnings(
    points: TurningPoints, chi2_per_dof: Mapping[str, float], drive_step: float = 0.0
) -> Iterator[str]:
    """Warnings about the data that do not depend on the fitted parameters.

    `chi2_per_dof` has the value of every part of the fit, by the name of its data. `drive_step` is the
    standard deviation by which the ground moves an amplitude in a half-swing.
    """
    step = np.diff(points.amplitude)
    noise = np.hypot(np.hypot(points.u_amplitude[1:], points.u_amplitude[:-1]), drive_step)
    kicked = points.index[1:][(step > 6 * noise) & (step > 0.01 * points.amplitude[:-1])]
    if len(kicked):
        listed = ", ".join(map(str, kicked[:5])) + (", ..." if len(kicked) > 5 else "")
        yield f"the amplitude jumps up at half-cycle {listed}: a kick or a vibration"
    data, worst = max(chi2_per_dof.items(), key=lambda item: item[1])
    if worst > 2:
        yield (
            f"χ²/dof of {data} = {plain(worst, 3)}: the data scatter more than their uncertainties say or "
            "the model does not describe them; uncertainties are scaled up by its root"
        )


def result_of(
    model: ExactModel,
    solution: Solution,
    ground: GroundFit,
    loss: Loss,
    likeliest: Floats | None = None,
    averaged: Floats | None = None,
) -> FitResult:
    """Result of an exact fit: physical values, their uncertainties, and warnings.

    `likeliest` and `averaged` are covariances of the coordinates, with the likeliest noise and averaged over
    the noise that the data allow; their ratio enlarges the uncertainties.
    """
    points = model.points
    amplitude, time, _, _ = model.curve(solution.values)
    deviation = np.abs(points.amplitude - amplitude * model.reference) / points.amplitude
    values, to_physical = model.parametrisation.physical(solution.values)
    chi2_per_dof = solution.chi2 / solution.dof
    scale2 = max(1.0, chi2_per_dof) if loss == "linear" else 1.0
    scatter = solution.covariance * scale2
    covariance = propagate(to_physical, scatter)
    u_inflation = np.ones(len(covariance))
    if likeliest is not None and averaged is not None:
        # never smaller: a drive that was seen may still be larger than the likeliest one
        u_inflation *= np.maximum(1.0, _u_ratio(to_physical, averaged, likeliest))
    of_points = solution.residuals[: 2 * len(points)]
    white = whiteness(of_points / np.sqrt(max(1.0, chi2_per_dof)))
    if np.all(np.isfinite(covariance)):
        factor = _correlation_inflation(to_physical, solution, white, len(points))
        white = replace(white, u_inflation=float(factor.max()))
        u_inflation *= factor
    covariance = covariance * np.outer(u_inflation, u_inflation)
    terms = {MEASUREMENT: _by_measurement(model, solution, to_physical)}
    by_air = _by_air(model, solution)
    if by_air is not None:
        terms[AIR] = (u_inflation * scale2**0.5 * (to_physical @ by_air))[:, None]

    is_outlier = np.any(np.abs(of_points.reshape(2, -1)) > OUTLIER, axis=0)
    periods = full_periods(points)
    period_model = time[periods.points + 1] - time[periods.points - 1]
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
        by_log_rho=to_physical @ model.by_log_rho(solution.values),
        mean_period_s=mean_period_estimate(points, chi2_per_dof),
        loss=loss,
        cost=solution.cost,
        outliers=tuple(int(i) for i in points.index[is_outlier]),
        warnings=(
            *data_warnings(points, {"amplitudes and times": chi2_per_dof}, ground.noise.step),
            *_remarks(points, ground, solution, white),
            *(
                f"{name} is at the limit of its range: the data do not determine it"
                for name in model.parametrisation.at_limit(solution.values)
            ),
        ),
        half_cycles=len(points),
        ground=ground,
        u_inflation=u_inflation,
        terms=terms,
        whiteness=white,
        evidence=model.evidence_at(solution.values, scatter),
        information_gain=_information_gain(model, solution, to_physical),
    )


def _remarks(points: TurningPoints, ground: Ground, solution: Solution, white: Whiteness) -> Iterator[str]:
    """Warnings on the uncertainties, by the residuals and the ground; `points` are those fitted."""
    chi2_per_dof = solution.chi2 / solution.dof
    if solution.dof >= _MIN_OVERSTATED_DOF and 0 < chi2_per_dof < _OVERSTATED_CHI2:
        # overstated uncertainties hide a drive, and enlarge those of all parameters
        yield (
            f"χ²/dof = {plain(chi2_per_dof, 2)}: the uncertainties of the turning points are "
            f"{chi2_per_dof**-0.5:.2g} times too large for their scatter; so are those of the parameters, "
            "and a weaker drive of the ground is not seen: check sensor noise (rig calibrate sensor) and "
            "beam profile"
        )
    if ground.left_out_half_cycles:
        yield (
            f"{ground.left_out_half_cycles} half-cycles at the end are left out: below "
            f"{plain(points.amplitude[-1], 3)} rad the ground moves the pendulum in one "
            "half-swing by more than a tenth of its amplitude"
        )
    if white.correlated:
        wider = f"widened by up to {white.u_inflation:.2g}" if white.u_inflation >= 1.05 else "hardly wider"
        chance = plain(min(white.p_amplitude, white.p_time), 1)
        yield (
            f"the residuals of neighbouring half-cycles are correlated (chance {chance}): "
            "the model does not describe all of the motion, or the "
            f"equilibrium position wanders (pointing of the beam, air); uncertainties are {wider} for it"
        )


def _evidence_parts(model: ExactModel) -> dict[str, slice]:
    """Rows of each part of the evidence among the residuals."""
    first, count = 2 * len(model.points), len(model.evidence_rows(np.zeros(len(model.lower)))[0])
    last = first + count - (model.evidence.drag_s is not None and DRAG.key in model.names)
    rows = {WAVEFORM: slice(first, last), AIR: slice(last, first + count)}
    return {name: own for name, own in rows.items() if own.start < own.stop}


def _by_air(model: ExactModel, solution: Solution) -> Floats | None:
    """Change of the coordinates by one standard uncertainty of the drag's prior; None without a prior."""
    rows = _evidence_parts(model).get(AIR)
    if rows is None or not np.all(np.isfinite(solution.covariance)):
        return None
    return np.asarray(solution.covariance @ solution.jacobian[rows][0])


def _information_gain(
    model: ExactModel, solution: Solution, to_physical: Floats
) -> dict[str, dict[str, float]]:
    """Ratios of uncertainties without a part of the evidence to those with it, by part and parameter."""
    ratios = {}
    covariance = covariance_of(solution.jacobian)
    for source, rows in _evidence_parts(model).items():
        without = covariance_of(np.delete(solution.jacobian, rows, axis=0))
        undetermined = ~np.isfinite(np.diag(propagate(to_physical, without)))
        ratio = np.where(undetermined, np.inf, _u_ratio(to_physical, without, covariance))
        by_name = dict(zip(model.names, ratio.tolist(), strict=True))
        ratios[source] = {name: by_name[name] for name in by_name if name not in (AMPLITUDE.key, TIME.key)}
    return ratios


def _u_ratio(to_physical: Floats, wider: Floats, covariance: Floats) -> Floats:
    """Ratio of the standard uncertainties by two covariances of the coordinates; 1 where there is none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.diag(propagate(to_physical, wider)) / np.diag(propagate(to_physical, covariance))
        return np.asarray(np.sqrt(np.maximum(np.nan_to_num(ratio, nan=1.0, posinf=1.0), 0.0)))


def _by_measurement(model: ExactModel, solution: Solution, to_physical: Floats) -> Floats:
    """Changes (values, m) of the values where only the measurement of the turning points is uncertain."""
    residuals, jacobian = model.on_ground(solution.values, AT_REST, model.scale)(solution.values)
    factored = FactoredJacobian(jacobian[np.isfinite(residuals)])
    changes = to_physical @ factored.root * np.sqrt(max(1.0, solution.chi2 / solution.dof))
    changes[np.any(to_physical[:, factored.blind] != 0, axis=1)] = np.inf
    return np.asarray(changes)


def _mean_of_finite(values: Floats) -> float:
    """Mean of the finite values, NaN without any: a free decay may end before a driven one."""
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if len(finite) else float("nan")


def _correlation_inflation(to_physical: Floats, solution: Solution, white: Whiteness, count: int) -> Floats:
    """The factor by which correlated residuals enlarge every standard uncertainty."""
    of_points = slice(2 * count)
    jacobian, covariance = solution.jacobian[of_points], solution.covariance
    factor = _u_ratio(to_physical, neighbours_covariance(white, jacobian, covariance), covariance)
    if white.correlated:
        residuals = solution.residuals[of_points] / np.sqrt(solution.chi2 / solution.dof)
        wider = correlated_covariance(residuals, jacobian, covariance, white.lags)
        factor = np.maximum(factor, _u_ratio(to_physical, wider, covariance))
    return np.asarray(np.maximum(1.0, factor))


def whiteness(residuals: Floats) -> Whiteness:
    """Test whitened residuals, those of the amplitudes first and then as many of the times."""
    count = len(residuals) // 2
    lags = min(_LAGS, count // 5)
    p_amplitude, first_amplitude = _ljung_box(residuals[:count], lags)
    p_time, first_time = _ljung_box(residuals[count:], lags)
    return Whiteness(lags, p_amplitude, p_time, first_amplitude, first_time)


def _ljung_box(z: Floats, lags: int) -> tuple[float, float]:
    """Chance of the autocorrelations of residuals in white noise, and the correlation of next neighbours."""
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
    """Covariance of fitted coordinates if neighbouring residuals are correlated (Newey and West, 1987).

    Parameters
    ----------
    residuals, jacobian
        Whitened, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance; it takes the place of the estimate at lag 0.
    """
    count = len(residuals) // 2
    score = (jacobian * residuals[:, None]).reshape(2, count, -1).sum(axis=0)
    score_covariance = np.zeros_like(covariance)
    for lag in range(1, lags + 1):
        of_lag = np.einsum("ij,ik->jk", score[lag:], score[:-lag]) * (1 - lag / (lags + 1))
        score_covariance += of_lag + of_lag.T
    return _enlarged(covariance, score_covariance)


def _enlarged(covariance: Floats, score_covariance: Floats) -> Floats:
    """Covariance of coordinates with a further covariance of the scores, by correlated residuals."""
    # a coordinate that is not determined does not contribute to the others
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    return np.asarray(covariance + known @ score_covariance @ known)


def neighbours_covariance(white: Whiteness, jacobian: Floats, covariance: Floats) -> Floats:
    """Covariance of fitted coordinates if next neighbours are correlated as in `white`, and no others.

    Slow noise, as of air, correlates times of neighbours by 0.2. That makes sums of them a fifth more
    uncertain, and the test misses it in a few hundred half-cycles. Correlations are shrunk by the size
    that chance gives them (the positive part of James and Stein, 1961); negative ones change nothing.

    Parameters
    ----------
    jacobian
        Of whitened residuals, amplitudes first, then times.
    covariance
        That of independent residuals of unit variance.
    """
    count = len(jacobian) // 2
    score_covariance = np.zeros_like(covariance)
    for correlation, rows in (
        (white.first_amplitude, jacobian[:count]),
        (white.first_time, jacobian[count : 2 * count]),
    ):
        if correlation > 0.0:
            shrunk = correlation * max(0.0, 1.0 - 1.0 / (count * correlation**2))
            of_neighbours = rows[1:].T @ rows[:-1]
            score_covariance += shrunk * (of_neighbours + of_neighbours.T)
    return _enlarged(covariance, score_covariance)


def domain_warnings(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> Iterator[str]:
    """Warnings on a fit outside the range in which its law has a meaning.

    A ball that rolls by more than the radius of its contact has left the spot on which it stood, which Eqs. 1
    and 3 describe; beyond pi/2 radii the moment of Eq. 3 has the other sign.
    """
    first_rad = float(points.amplitude[0])
    contact_rad = pendulum.contact_radius_m / pendulum.ball_radius_m
    if first_rad > contact_rad:
        yield (
            f"the first amplitude, {plain(first_rad, 3)} rad, is {plain(first_rad / contact_rad, 3)} times "
            f"the contact's angle a/R = {plain(contact_rad, 3)} rad: the laws of the contact hold only below "
            "it; start lower, or check lever and unit of the angles"
        )
    if first_rad > _SMALL_RAD:
        yield (
            f"the first amplitude, {plain(first_rad, 3)} rad, is not a small angle: gravity alone lengthens "
            f"the period by {plain(first_rad**2 / 16, 1)} there, which the laws neglect; start below "
            f"{_SMALL_RAD:g} rad"
        )
    for name, below_u in impossible_signs(fit.law, fit.estimates()).items():
        yield (
            f"{name} = {plain(fit.estimate(name).value, 3)} is negative by {plain(below_u, 2)} u, which it "
            "cannot be: the law is not that of this motion"
        )


def impossible_signs(law: Law, estimates: Mapping[str, Estimate]) -> dict[str, float]:
    """Standard uncertainties by which parameters of a law that cannot be negative are so, beyond chance."""
    parameters = {parameter.key: parameter for parameter in law.parameters}
    return {
        name: -value / u
        for name, (value, u) in estimates.items()
        if name in parameters and parameters[name].lower == 0 and value < -IMPOSSIBLE_U * u
    }
