"""Effects on a fit that has ended, each a term: drifts, a boundary layer's drag, errors of the sensor.

A friction that ages evenly is not seen in one decay: amplitude and time fall together, and an exponent takes
up the effect of the age. The effect of such drifts on the parameters follows from the map, for a budget.

A boundary layer's drag, with the 3/2 power of the speed, takes ``I A^1.5`` from the amplitude in a
half-swing, I the integral of ``sin^2.5``, and makes a small third harmonic within the swing, which the exact
path of the moment gives.

A fixed-pattern position error of the sensor moves the amplitudes of all half-cycles that pass it. Residuals
of whole cycles find it but for the part that looks like a motion (`processing.position_map`); of that part,
the fitted law finds what no decay could be.

Rows that are exposed in turn delay a spot by its place. Turning points lie on rows above and below that of
rest, so their times alternate by an amount that is proportional to the amplitude, which no motion of the
pendulum does. The alternation is taken off the times: the parameters are then those of a stated shutter.
Where the half-cycles were fitted with a shutter's effect, their times do not alternate; the swing then has a
second harmonic in quadrature proportional to the square of the amplitude, which nothing else makes. One that
rests beside the middle of its contact has another: its times alternate more, the smaller the amplitude.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import erfc, gamma, inf, nan, pi, sqrt
from typing import Annotated, NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import BOUNDARY_LAYER_DRAG, DRAG
from processing.estimate import Estimate
from processing.fit.exact_model import DiscrepancyColumns, ExactModel
from processing.fit.reported import RigQuantities
from processing.fit.result import (
    BOUNDARY_LAYER,
    FITTED_DRIFTS,
    FIXED_PATTERN,
    REST_POSITION,
    BoundaryLayerDrag,
    FitResult,
)
from processing.fit.terms import DrivenRows, LinearisedFit, Term, TermSolution, solve
from processing.least_squares import FactoredJacobian
from processing.number_text import plain, with_uncertainty
from processing.quantity import Quantity
from processing.swing import ORDERS, PieceHarmonics, TurningPoints
from processing.units import ARCSEC_RAD

_GROWTH_STEP = 1e-3
"""Relative growth of a friction by which the derivatives of its harmonics are taken."""
DRIFTS = ("ageing", "adhesion_ageing", "drag_drift", "period_drift")
"""What may drift evenly over a run, by the names of `RigQuantities`: the growth of the friction b, of the
constant friction c, of the drag and of the period from the first turning point to the last, relative.

They have different causes, and one of them alone moves parameters that all together would leave in place."""


def loss_shares(model: ExactModel, columns: Floats) -> Callable[[Floats], Floats]:
    """Shares of a half-swing's loss, as a function of amplitudes (n,) in units of the reference.

    The rows (2, n) are the contact's share and that of its constant friction. The drag takes
    ``A w0 drag pi / 2`` in a half-swing, the constant friction ``2 c`` at any amplitude.
    """
    values = model.values(columns)
    amplitude, loss = model.losses(columns)
    of_air = pi**2 * values.get(DRAG.key, 0.0) / values["period0_s"] * amplitude / loss
    of_adhesion = 2.0 * values.get("c", 0.0) / model.reference / loss
    shares = np.clip([1.0 - of_air, of_adhesion], 0.0, 1.0)[:, ::-1]
    log_amplitude = np.log(amplitude[::-1])
    return lambda x: np.array([np.interp(np.log(x), log_amplitude, share) for share in shares])


def drift_effects(at: LinearisedFit) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters of an exact fit by `DRIFTS`.

    The parameters refer to the middle of the run.
    """
    return dict(zip(DRIFTS, at.moved_by(-drift_term(at).columns).T, strict=True))


def drift_term(at: LinearisedFit, u_drifts: Mapping[str, float] | None = None) -> Term:
    """The term of `DRIFTS` about zero; without `u_drifts` they have no prior."""
    model, columns = at.model, at.coordinates
    shares = loss_shares(model, columns)
    lasting_s = float(model.points.time_s[-1] - model.points.time_s[0])

    def loss_errors(amplitude: Floats, time_s: Floats) -> Floats:
        of_contact, of_adhesion = shares(amplitude)
        parts = np.column_stack([of_contact - of_adhesion, of_adhesion, 1.0 - of_contact])
        return np.asarray(parts * _since_middle(time_s, lasting_s)[:, None])

    def duration_errors(_: Floats, time_s: Floats) -> Floats:
        return _since_middle(time_s, lasting_s)[:, None]

    of_waveform = np.zeros((len(model.evidence_rows(columns)[0]), len(DRIFTS)))
    waveform = model.evidence.waveform
    if waveform is not None:
        amplitude, values = waveform.amplitude_rad / model.reference, model.values(columns)
        passed_s = np.interp(-amplitude, -model.points.amplitude / model.reference, model.points.time_s)
        since = _since_middle(passed_s - model.points.time_s[0], lasting_s)[:, None]
        here = waveform.predicted_rad(model.law, values, model.pendulum)
        for column, name in enumerate(("b", "c")):
            grown = values | {name: (1 + _GROWTH_STEP) * values.get(name, 0.0)}
            moved = (waveform.predicted_rad(model.law, grown, model.pendulum) - here) / _GROWTH_STEP
            reduced = waveform.reduced(since * moved)
            of_waveform[: len(reduced), column] = reduced
    errors = DiscrepancyColumns(loss_errors, duration_errors)
    rows = DrivenRows.of(model, columns, at.noise, errors, of_waveform)
    prior = np.inf if u_drifts is None else np.array([u_drifts.get(name, 0.0) for name in DRIFTS])
    return Term(FITTED_DRIFTS, rows.in_scatter(at.scale).by_errors, prior)


def _since_middle(time_s: Floats, lasting_s: float) -> Floats:
    """Time from the middle of the run over its duration, -1/2 to 1/2."""
    return time_s / lasting_s - 0.5


_UNIT_DRAG_RATIO = 1e-3
"""Size of the drag over the weight's moment at the reference amplitude for which derivatives are taken."""
_BOUNDARY_LAYER_INTEGRAL = sqrt(pi) * gamma(1.75) / gamma(2.25)
"""The integral of ``sin^2.5`` over half a swing."""


def boundary_layer_drag(at: LinearisedFit) -> BoundaryLayerDrag:
    """A boundary layer's drag beside the linear drag of an exact fit, by one linear step.

    Raises DataError where the law predicts no waveform.
    """
    from scipy.special import fdtrc

    fit = at.fit
    period0_s, period_s = fit.estimate("period0_s").value, fit.mean_period_s.value
    rate = 2 * pi / period0_s
    per_unit = _UNIT_DRAG_RATIO / (at.model.reference**0.5 * rate**1.5)
    # a softer pendulum is duration_errors by the root of its stiffness
    lost = _UNIT_DRAG_RATIO * _BOUNDARY_LAYER_INTEGRAL * sqrt(period_s / period0_s)
    more = at.by_loss(lambda x: np.asarray(lost * np.maximum(x, 0.0) ** 1.5), {BOUNDARY_LAYER_DRAG: per_unit})
    found = at.solved(Term(BOUNDARY_LAYER, more))
    # enlarged as the parameters of the fit are: by the scatter, and by the factors of their uncertainties
    scatter = sqrt(max(1.0, fit.chi2_per_dof)) if fit.loss == "linear" else 1.0
    u_inflation = 1.0 if fit.u_inflation is None else float(np.max(fit.u_inflation))
    u = sqrt(found.covariance[0, 0]) * u_inflation * scatter / at.scale
    if not 0 < u < inf:
        return BoundaryLayerDrag()
    moved = at.to_physical @ found.moved
    value, drag_s = float(found.values[0]), fit.estimate(DRAG.key).value
    first = float(at.points.amplitude[0]) * rate
    return BoundaryLayerDrag(
        coefficient=Estimate(value * per_unit, u * per_unit),
        p_value=float(fdtrc(1, fit.dof, (value / u) ** 2)),
        share=_share(value * per_unit * first**0.5, drag_s),
        relative_shift_b=float(moved[0] / fit.values[0]),
        shift_drag_s=float(moved[fit.names.index(DRAG.key)]),
        shift=tuple(moved.tolist()),
    )


def with_boundary_layer_drag(fit: FitResult, found: BoundaryLayerDrag) -> FitResult:
    """The fit with its boundary layer's drag; where that is seen, uncertainties hold its effect.

    The values and their curves stay: the linear step is right only to some tenths of itself.
    """
    if not found.seen:
        return replace(fit, boundary_layer=found)
    percent = float(f"{100 * found.relative_shift_b:.3g}")
    said = (
        f"a drag with the 3/2 power of the speed is in the data (chance without: {plain(found.p_value, 1)}); "
        f"with it b changes by {percent:+g} %, which its uncertainty covers"
    )
    return fit.with_term(BOUNDARY_LAYER, np.array(found.shift)[:, None], said, boundary_layer=found)


def _share(coefficient: float, drag_s: float) -> float:
    """Ratio of both drags' work in a half-swing, by the integrals of ``sin^2.5`` and ``sin^2``."""
    return _BOUNDARY_LAYER_INTEGRAL * coefficient / (0.5 * pi * drag_s) if drag_s else nan


_MAX_NEGLIGIBLE_ERROR_U = 1e-3
"""Largest error of an amplitude, in its uncertainties, below which a coordinate keeps its prior."""
_MIN_FELT_U = 0.01
"""Change of a parameter, in its uncertainties, above which a place of rest is part of them."""
_CHANCE_U = 2.0
"""Distance of the rest position, in its uncertainties, up to which it is taken for chance."""
_SECOND = ORDERS.index(2)
_FEWEST = 8
_LEAST_SHARE = 1e-9
"""Least share of the contact in a loss, so that it has a logarithm."""
CERTAIN = 1e-6
"""Chance of so large an alternation, below which it is called a shutter's."""


class PositionErrorFit(NamedTuple):
    """Position errors that amplitudes share, by a fit.

    `values` (m,) and `covariance` (m, m) are those of the coordinates, whose prior is 0 with the variance 1.
    `of_parameters` (values, m) are their changes of the fit's values, see `FitResult.terms`.
    """

    values: Floats
    covariance: Floats
    of_parameters: Floats


def fit_position_errors(at: LinearisedFit, errors: Floats) -> PositionErrorFit:
    """Errors and parameters that describe the turning points best together, near an exact fit.

    `errors` (points, m) are those of the amplitudes for each of m independent coordinates of variance 1.
    """
    errors = errors[: len(at.points)]
    felt = np.max(np.abs(errors) / at.points.u_amplitude[:, None], axis=0) > _MAX_NEGLIGIBLE_ERROR_U
    by_errors = -at.by_points(amplitude=errors[:, felt])
    noise = 1.0
    for _ in range(2):
        # the scatter that position errors do not explain is noise
        found = solve(
            at.residuals / noise, at.jacobian / noise, [Term(FIXED_PATTERN, by_errors / noise, 1.0)]
        )
        noise *= found.scatter(at.fit.dof)
    values, covariance = np.zeros(len(felt)), np.eye(len(felt))
    values[felt], covariance[np.ix_(felt, felt)] = found.values, found.covariance
    return PositionErrorFit(values, covariance, at.to_physical @ found.by @ found.root)


def sensor_derivatives(at: LinearisedFit, rig: RigQuantities) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters by row time and common amplitude, if uncertain.

    Turning points at the two ends of the swing lie on rows above and below that of rest: a row time wrong by
    d delays those at one end by d times their distance in rows, and advances the others as much. Full periods
    keep their lengths but for friction. Which end comes first is not known, and so the sign is not either. An
    error that all amplitudes share makes each as much too small.
    """
    points, out = at.points, {}
    if rig.row_time_s.u > 0:
        rows = np.tan(2.0 * points.amplitude) * rig.arm_m.value / rig.pitch_m.value
        rows *= np.cos(rig.slow_angle_rad.value) * sides(points)
        out["row_time_s"] = at.moved_by(at.by_points(time_s=rows[:, None]))[:, 0]
    if rig.common_amplitude_rad.u > 0:
        ones = np.ones((len(points), 1))
        out["common_amplitude_rad"] = at.moved_by(at.by_points(amplitude=ones))[:, 0]
    return out


def amplitude_error_effects(at: LinearisedFit, errors: Floats) -> Floats:
    """Changes (parameters,) of the contact parameters by one standard uncertainty of errors that amplitudes
    share, all coordinates together.

    `errors` are those of `fit_position_errors`. The signs are those of the coordinate that changes the
    parameters most.
    """
    moved = at.moved_by(at.by_points(amplitude=errors[: len(at.points)]))
    u = np.linalg.norm(moved, axis=1)
    main = np.linalg.svd(moved / np.where(u > 0, u, 1.0)[:, None], full_matrices=False)[0][:, 0]
    return np.asarray(np.copysign(u, main))


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternation:
    """Delay of turning points on one side over their amplitude; those on the other side are as much early.

    `chance` is that of an alternation at least so large where there is none.
    """

    delay_s_per_rad: Annotated[float, Quantity("", "delay over the amplitude", unit="s/rad")] = nan
    u_delay_s_per_rad: Annotated[float, Quantity("", "its standard uncertainty", unit="s/rad")] = inf
    chance: float = nan

    @property
    def seen(self) -> bool:
        return self.chance < CERTAIN

    @property
    def taken_off_text(self) -> str:
        """Remark, in one line, on turning times that were corrected."""
        size, u = abs(self.delay_s_per_rad), self.u_delay_s_per_rad
        return (
            "turning times at the two ends alternate as with a rolling shutter, but none is stated "
            f"({with_uncertainty(size, u)} s/rad): this was subtracted; state shutter.row_time_s"
        )

    def text(self, rad_per_px: float) -> str:
        """Remark, in one line, on a second harmonic; `rad_per_px` is the tilt that moves the spot by 1 px."""
        size, u = (1e6 * abs(value) * rad_per_px for value in (self.delay_s_per_rad, self.u_delay_s_per_rad))
        return (
            f"the swing's second harmonic is that of rows exposed in turn, {with_uncertainty(size, u)} µs "
            "a row along the swing, beyond what shutter.row_time_s states: rig calibrate shutter measures it"
        )


class TimeAlternation(NamedTuple):
    """What makes turning times alternate: rows that are exposed in turn, and the place of rest.

    `rest_rad` is the distance of the rest position from the middle of the contact, `late_by_rest_s` (points,)
    the delays that it makes.
    """

    rows: Alternation
    rest_rad: Estimate
    late_by_rest_s: Floats

    @property
    def rest_seen(self) -> bool:
        value, u = self.rest_rad
        return u > 0.0 and erfc(value / u / sqrt(2.0)) < CERTAIN

    @property
    def taken_off_texts(self) -> tuple[str, ...]:
        """Remarks, one line each, on turning times that were corrected."""
        rest = with_uncertainty(*(number / ARCSEC_RAD for number in self.rest_rad))
        of_rest = (
            f"turning times at the two ends alternate as where the pendulum rests {rest} arcsec beside the "
            "middle of its contact: this was subtracted, and uncertainties hold what it changes of the losses"
        )
        of_rows = [self.rows.taken_off_text] if self.rows.seen else []
        return (*of_rows, *([of_rest] if self.rest_seen else []))


def row_delay(harmonics: PieceHarmonics, period_s: float) -> Alternation:
    """Delay in proportion to the place of the spot, from the swing's second harmonic.

    A delay by k phi makes ``-(k w A^2 / 2) sin(2 w t)`` of A cos(w t). A friction that differs between both
    directions makes a second harmonic proportional to the friction, A^p, and one about another middle than
    that of the contact makes one proportional to its derivative, nearly constant: both are fitted as well.
    """
    amplitude, sine = harmonics.amplitude, harmonics.sine[:, _SECOND]
    if len(amplitude) < _FEWEST:
        return Alternation()
    u = np.sqrt(harmonics.covariance_sine[:, _SECOND, _SECOND])
    friction, delay = np.column_stack([amplitude, np.ones_like(u)]), np.pi / period_s * amplitude**2 / u
    # the scatter of the pieces contains the ground's part
    return _alternation(solve(sine / u, friction / u[:, None], [Term("delay", delay)]), len(sine) - 3)


def sides(points: TurningPoints) -> Floats:
    """1 for the half-cycles at one end of the swing, -1 for those at the other."""
    return np.asarray(1.0 - 2.0 * (points.index % 2))


def time_alternation(at: LinearisedFit) -> TimeAlternation:
    """Alternation of the turning times, estimated together with the parameters of an exact fit."""
    points = at.points
    late_s = np.column_stack([points.amplitude, _late_per_rest(at)]) * sides(points)[:, None]
    by = -at.by_points(time_s=late_s)
    # a pendulum rests within its swing, which is all that a law of constant friction says of it
    rest = Term("rest", by[:, 1:], float(points.amplitude.min()))
    found = at.solved(Term("delay", by[:, :1]), rest)
    # the scatter is that without the alternation, which the fit may have taken for noise
    dof = len(found.left) - at.jacobian.shape[1] - 2
    u_rest = sqrt(found.covariance[1, 1]) * found.scatter(dof)
    at_rest = Estimate(abs(float(found.values[1])), u_rest)
    return TimeAlternation(_alternation(found, dof), at_rest, late_s[:, 1] * found.values[1])


def _alternation(found: TermSolution, dof: int) -> Alternation:
    delay = float(found.values[0])
    u = sqrt(found.covariance[0, 0]) * found.scatter(dof)
    if not u < inf:
        return Alternation()
    return Alternation(delay_s_per_rad=delay, u_delay_s_per_rad=u, chance=erfc(abs(delay) / u / sqrt(2.0)))


def _late_per_rest(at: LinearisedFit) -> Floats:
    """Delays (points,) of measured turning points by the rest position, in s/rad; they alternate.

    A friction M(|x + r|) is larger by r M'(|x|) on one side than on the other. Of b |x|^p that makes the
    second harmonic ``(8/3 pi) p b r A^(p-1) / (p + 1) sin(2 w t)``; half-cycles fitted by a swing without it
    are late by ``4/(3 pi)`` of what it moves the turning points themselves.
    """
    amplitude, loss = at.model.losses(at.coordinates)
    power, of_contact = _contact_power(at, amplitude, loss)
    harmonic = 4.0 / (3.0 * pi) * power * of_contact * loss / amplitude / at.model.reference
    late_s = at.fit.mean_period_s.value / (2.0 * pi) * 4.0 / (3.0 * pi) * 2.0 * harmonic / amplitude
    return np.interp(-at.points.amplitude / at.model.reference, -amplitude, late_s)


def _contact_power(at: LinearisedFit, amplitude: Floats, loss: Floats) -> tuple[Floats, Floats]:
    """The power of the amplitude with which the contact's loss grows, and its share of the loss."""
    of_contact = loss_shares(at.model, at.coordinates)(amplitude)[0]
    return _slopes(amplitude, np.log(np.maximum(of_contact, _LEAST_SHARE) * loss))[0], of_contact


def _slopes(amplitude: Floats, values: Floats) -> tuple[Floats, Floats]:
    """First and second derivative of smooth values by ln A."""
    x = np.log(amplitude)
    smooth = np.polynomial.Polynomial.fit(x, values, 3)
    return np.asarray(smooth.deriv()(x)), np.asarray(smooth.deriv(2)(x))


def with_rest_position(at: LinearisedFit, found: TimeAlternation, fit: FitResult) -> FitResult:
    """The fit with uncertainties that contain what a rest position beside the contact's middle changes.

    A distance that chance may make changes nothing. Over both directions a power p of the angle in the
    friction loses ``p (p + 1) / 2 (r / A)^2`` more, and one in the elastic moment, of which the period tells,
    is as much larger in the mean over the swing. The values stay: the series in r/A is right only to some
    tenths of itself.
    """
    value, u = found.rest_rad
    rest = sqrt(max(value**2 - (_CHANCE_U * u) ** 2, 0.0)) / at.model.reference
    if rest == 0.0:
        return fit

    def loss_errors(amplitude: Floats, _: Floats) -> Floats:
        power, of_contact = _contact_power(at, amplitude, np.interp(-amplitude, -nodes, loss))
        return np.asarray((0.5 * power * (power + 1.0) * of_contact * (rest / amplitude) ** 2)[:, None])

    def duration_errors(amplitude: Floats, node_s: Floats) -> Floats:
        slope, bend = _slopes(amplitude, np.log(np.gradient(node_s)))
        return np.asarray((0.5 * (bend + 2.0 * slope) * (rest / amplitude) ** 2)[:, None])

    nodes, loss = at.model.losses(at.coordinates)
    errors = DiscrepancyColumns(loss_errors, duration_errors)
    rows = DrivenRows.of(at.model, at.coordinates, at.noise, errors).in_scatter(at.scale)
    columns = rows.by_errors.sum(axis=1, keepdims=True)
    good = np.isfinite(at.jacobian).all(axis=1) & np.isfinite(columns).all(axis=1)
    by = at.to_physical @ FactoredJacobian(at.jacobian[good]).coefficients(columns[good])
    felt = np.abs(by[:, 0]) > _MIN_FELT_U * fit.standard_uncertainty
    return fit.with_term(REST_POSITION, by) if np.any(felt) else fit


def without_alternation(points: TurningPoints, found: TimeAlternation) -> TurningPoints:
    """The turning points with the times that they would have without what is seen of an alternation."""
    late_s = np.zeros(len(points))
    if found.rows.seen:
        late_s += found.rows.delay_s_per_rad * sides(points) * points.amplitude
    if found.rest_seen:
        late_s += found.late_by_rest_s
    return replace(points, time_s=points.time_s - late_s)
