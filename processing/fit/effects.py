"""Effects on a fit that has ended, each a term: drifts, a boundary layer's drag, errors of the sensor.

A friction that ages evenly is not seen in one decay: amplitude and time fall together, and an exponent takes
up the effect of the age. Rows that are exposed in turn delay a spot by its place: times of turning points on
either side alternate in proportion to the amplitude, which no motion of the pendulum does. Those of a
pendulum that rests beside the middle of its contact alternate more, the smaller the amplitude. Either
alternation is taken off the times.
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
from processing.fit.result import (
    BOUNDARY_LAYER,
    FITTED_DRIFTS,
    FIXED_PATTERN,
    REST_POSITION,
    BoundaryLayerDrag,
    FitResult,
)
from processing.fit.terms import DrivenRows, LinearisedFit, Term, TermSolution, solve
from processing.fit.uncertainty import RigQuantities
from processing.number_text import plain, with_uncertainty
from processing.quantity import Quantity
from processing.swing import ORDERS, PieceHarmonics, TurningPoints
from processing.units import ARCSEC_RAD

_GROWTH_STEP = 1e-3
"""Relative growth of a friction by which the derivatives of its harmonics are taken."""
DRIFTS = ("ageing", "adhesion_ageing", "drag_drift", "period_drift")
"""Names, in `RigQuantities`, of the relative growth of b, c, drag and period over a run.

They have different causes, and one of them alone moves parameters that all together would leave in place."""


def loss_shares(model: ExactModel, coordinates: Floats) -> Callable[[Floats], Floats]:
    """Shares of a half-swing's loss, as a function of amplitudes (n,) in units of the reference.

    The rows (2, n) are the contact's share and that of its constant friction. The drag takes
    ``A w0 drag pi / 2`` in a half-swing, the constant friction ``2 c`` at any amplitude.
    """
    values = model.values(coordinates)
    amplitude, loss = model.losses(coordinates)
    of_air = pi**2 * values.get(DRAG.key, 0.0) / values["period0_s"] * amplitude / loss
    of_adhesion = 2.0 * values.get("c", 0.0) / model.reference / loss
    shares = np.clip([1.0 - of_air, of_adhesion], 0.0, 1.0)[:, ::-1]
    log_amplitude = np.log(amplitude[::-1])
    return lambda x: np.array([np.interp(np.log(x), log_amplitude, share) for share in shares])


def drift_effects(linearised: LinearisedFit) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters, those of mid-run, of an exact fit by `DRIFTS`."""
    return dict(zip(DRIFTS, linearised.parameter_changes(-drift_term(linearised).columns).T, strict=True))


def drift_term(linearised: LinearisedFit, u_drifts: Mapping[str, float] | None = None) -> Term:
    """The term of `DRIFTS` about zero; without `u_drifts` they have no prior."""
    model, coordinates = linearised.model, linearised.coordinates
    shares = loss_shares(model, coordinates)
    duration_s = float(model.points.time_s[-1] - model.points.time_s[0])

    def loss_errors(amplitude: Floats, time_s: Floats) -> Floats:
        of_contact, of_adhesion = shares(amplitude)
        by_source = np.column_stack([of_contact - of_adhesion, of_adhesion, 1.0 - of_contact])
        return np.asarray(by_source * _since_middle(time_s, duration_s)[:, None])

    def duration_errors(_: Floats, time_s: Floats) -> Floats:
        return _since_middle(time_s, duration_s)[:, None]

    of_waveform = np.zeros((len(model.evidence_rows(coordinates)[0]), len(DRIFTS)))
    waveform = model.evidence.waveform
    if waveform is not None:
        amplitude, values = waveform.amplitude_rad / model.reference, model.values(coordinates)
        piece_s = np.interp(-amplitude, -model.points.amplitude / model.reference, model.points.time_s)
        since = _since_middle(piece_s - model.points.time_s[0], duration_s)[:, None]
        predicted_rad = waveform.predicted_rad(model.law, values, model.pendulum)
        for column, name in enumerate(("b", "c")):
            grown = values | {name: (1 + _GROWTH_STEP) * values.get(name, 0.0)}
            grown_rad = waveform.predicted_rad(model.law, grown, model.pendulum)
            reduced = waveform.reduced(since * ((grown_rad - predicted_rad) / _GROWTH_STEP))
            of_waveform[: len(reduced), column] = reduced
    errors = DiscrepancyColumns(loss_errors, duration_errors)
    rows = DrivenRows.of(model, coordinates, linearised.noise, errors, of_waveform)
    prior = np.inf if u_drifts is None else np.array([u_drifts.get(name, 0.0) for name in DRIFTS])
    return Term(FITTED_DRIFTS, rows.in_scatter(linearised.scale).by_errors, prior)


def _since_middle(time_s: Floats, duration_s: float) -> Floats:
    """Time from the middle of the run over its duration, -1/2 to 1/2."""
    return time_s / duration_s - 0.5


_UNIT_DRAG_RATIO = 1e-3
"""Size of the drag over the weight's moment at the reference amplitude for which derivatives are taken."""
_BOUNDARY_LAYER_INTEGRAL = sqrt(pi) * gamma(1.75) / gamma(2.25)
"""The integral of ``sin^2.5`` over half a swing."""


def boundary_layer_drag(linearised: LinearisedFit) -> BoundaryLayerDrag:
    """A boundary layer's drag in addition to the linear drag of an exact fit, by one linear step.

    It takes ``I A^1.5`` from the amplitude in a half-swing, I the integral of ``sin^2.5``, and makes a small
    third harmonic within the swing. Raises DataError where the law predicts no waveform.
    """
    from scipy.special import fdtrc

    fit = linearised.fit
    period0_s, period_s = fit.estimate("period0_s").value, fit.mean_period_s.value
    rate = 2 * pi / period0_s
    per_unit = _UNIT_DRAG_RATIO / (linearised.model.reference**0.5 * rate**1.5)
    # a softer pendulum is slower by the root of its stiffness
    unit_loss = _UNIT_DRAG_RATIO * _BOUNDARY_LAYER_INTEGRAL * sqrt(period_s / period0_s)
    derivatives = linearised.loss_derivatives(
        lambda x: np.asarray(unit_loss * np.maximum(x, 0.0) ** 1.5), {BOUNDARY_LAYER_DRAG: per_unit}
    )
    solution = linearised.solve_terms(Term(BOUNDARY_LAYER, derivatives))
    # enlarged as the parameters of the fit are: by the scatter, and by the factors of their uncertainties
    u = sqrt(solution.covariance[0, 0] * fit.scatter2) * float(np.max(fit.inflation)) / linearised.scale
    if not 0 < u < inf:
        return BoundaryLayerDrag()
    shift = linearised.to_physical @ solution.law_shift
    value, drag_s = float(solution.values[0]), fit.estimate(DRAG.key).value
    first_rad_per_s = float(linearised.points.amplitude[0]) * rate
    # works of both drags in a half-swing, by the integrals of sin^2.5 and sin^2
    boundary_layer_work = _BOUNDARY_LAYER_INTEGRAL * (value * per_unit * first_rad_per_s**0.5)
    return BoundaryLayerDrag(
        coefficient=Estimate(value * per_unit, u * per_unit),
        p_value=float(fdtrc(1, fit.dof, (value / u) ** 2)),
        share=boundary_layer_work / (0.5 * pi * drag_s) if drag_s else nan,
        relative_shift_b=float(shift[0] / fit.values[0]),
        shift_drag_s=float(shift[fit.names.index(DRAG.key)]),
        shift=tuple(shift.tolist()),
    )


def with_boundary_layer_drag(fit: FitResult, drag: BoundaryLayerDrag) -> FitResult:
    """The fit with its boundary layer's drag; where that is seen, uncertainties hold its effect.

    The values and their curves stay: the linear step is right only to some tenths of itself.
    """
    if not drag.seen:
        return replace(fit, boundary_layer=drag)
    percent = float(f"{100 * drag.relative_shift_b:.3g}")
    warning = (
        f"a drag with the 3/2 power of the speed is in the data (chance without: {plain(drag.p_value, 1)}); "
        f"with it b changes by {percent:+g} %, which its uncertainty covers"
    )
    return fit.with_term(BOUNDARY_LAYER, np.array(drag.shift)[:, None], warning, boundary_layer=drag)


_MAX_NEGLIGIBLE_ERROR_U = 1e-3
"""Largest error of an amplitude, in its uncertainties, below which a coordinate keeps its prior."""
_MIN_FELT_U = 0.01
"""Change of a parameter, in its uncertainties, above which the rest position contributes to them."""
_CHANCE_U = 2.0
"""Distance of the rest position, in its uncertainties, up to which it is taken for chance."""
_SECOND = ORDERS.index(2)
_MIN_PIECES = 8
"""Fewest pieces of a swing whose second harmonics show a delay."""
_MIN_SHARE = 1e-9
"""Least share of the contact in a loss, so that it has a logarithm."""
_SEEN_CHANCE = 1e-6
"""Chance of so large an alternation below which it is seen."""


class PositionErrorFit(NamedTuple):
    """Position errors that amplitudes share, by a fit."""

    values: Floats
    """Values (m,) of the coordinates, whose prior is 0 with the variance 1."""
    covariance: Floats
    of_parameters: Floats
    """Changes (values, m) of the fit's values, see `FitResult.terms`."""


def fit_position_errors(linearised: LinearisedFit, errors: Floats) -> PositionErrorFit:
    """Errors and parameters that together describe the turning points best, near an exact fit.

    `errors` (points, m) are those of the amplitudes for each of m independent coordinates of variance 1: the
    part of a position error that looks like a motion, of which the law shows what no decay could produce.
    """
    errors = errors[: len(linearised.points)]
    felt = np.max(np.abs(errors) / linearised.points.u_amplitude[:, None], axis=0) > _MAX_NEGLIGIBLE_ERROR_U
    by_errors = -linearised.residual_changes(amplitude=errors[:, felt])
    noise = 1.0
    for _ in range(2):
        # the scatter that position errors do not explain is noise
        term = Term(FIXED_PATTERN, by_errors / noise, 1.0)
        solution = solve(linearised.residuals / noise, linearised.jacobian / noise, [term])
        noise *= solution.scatter(linearised.fit.dof)
    values, covariance = np.zeros(len(felt)), np.eye(len(felt))
    values[felt], covariance[np.ix_(felt, felt)] = solution.values, solution.covariance
    return PositionErrorFit(
        values, covariance, linearised.to_physical @ solution.law_by_terms @ solution.root
    )


def sensor_derivatives(linearised: LinearisedFit, rig: RigQuantities) -> dict[str, Floats]:
    """Derivatives (parameters,) of the contact parameters by row time and common amplitude, if uncertain.

    Turning points at the two ends of the swing lie on rows above and below that of rest: a row time wrong by
    d delays those at one end by d times their distance in rows, and advances the others as much. Full periods
    keep their lengths but for friction. The sign is not known, as which end comes first is not. An error that
    all amplitudes share makes each too small by the same amount.
    """
    points, by_source = linearised.points, dict[str, Floats]()
    if rig.row_time_s.u > 0:
        rows = np.tan(2.0 * points.amplitude) * rig.arm_m.value / rig.pitch_m.value
        rows *= np.cos(rig.slow_angle_rad.value) * sides(points)
        by_source["row_time_s"] = linearised.residual_changes(time_s=rows[:, None])
    if rig.common_amplitude_rad.u > 0:
        by_source["common_amplitude_rad"] = linearised.residual_changes(amplitude=np.ones((len(points), 1)))
    return {name: linearised.parameter_changes(changes)[:, 0] for name, changes in by_source.items()}


def amplitude_error_effects(linearised: LinearisedFit, errors: Floats) -> Floats:
    """Changes (parameters,) of the contact parameters by one standard uncertainty of errors as a whole.

    `errors` are those of `fit_position_errors`. Signs are those of the coordinate with the largest effect.
    """
    of_errors = linearised.residual_changes(amplitude=errors[: len(linearised.points)])
    changes = linearised.parameter_changes(of_errors)
    u = np.linalg.norm(changes, axis=1)
    main = np.linalg.svd(changes / np.where(u > 0, u, 1.0)[:, None], full_matrices=False)[0][:, 0]
    return np.asarray(np.copysign(u, main))


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternation:
    """Delay of turning points on one side over their amplitude; those on the other side are as much early."""

    delay_s_per_rad: Annotated[float, Quantity("", "delay over the amplitude", unit="s/rad")] = nan
    u_delay_s_per_rad: Annotated[float, Quantity("", "its standard uncertainty", unit="s/rad")] = inf
    chance: float = nan
    """Chance of an alternation at least so large where there is none."""

    @property
    def seen(self) -> bool:
        return self.chance < _SEEN_CHANCE

    def text(self, rad_per_px: float) -> str:
        """Remark, in one line, on a second harmonic; `rad_per_px` is the tilt that moves the spot by 1 px."""
        size, u = (1e6 * abs(value) * rad_per_px for value in (self.delay_s_per_rad, self.u_delay_s_per_rad))
        return (
            f"the swing's second harmonic is that of rows exposed in turn, {with_uncertainty(size, u)} µs "
            "a row along the swing, beyond what shutter.row_time_s states: rig calibrate shutter measures it"
        )


class TimeAlternation(NamedTuple):
    """Causes by which turning times alternate: rows that are exposed in turn, and the rest position."""

    rows: Alternation
    rest_rad: Estimate
    """Distance of the rest position from the middle of the contact."""
    late_by_rest_s: Floats
    """Delays (points,) by the rest position."""

    @property
    def rest_seen(self) -> bool:
        return self.rest_rad.standard_uncertainty > 0.0 and _chance(*self.rest_rad) < _SEEN_CHANCE

    @property
    def taken_off_texts(self) -> tuple[str, ...]:
        """Remarks, one line each, on turning times that were corrected."""
        begin, texts = "turning times at the two ends alternate as", []
        if self.rows.seen:
            delay = with_uncertainty(abs(self.rows.delay_s_per_rad), self.rows.u_delay_s_per_rad)
            texts.append(
                f"{begin} with a rolling shutter, but none is stated ({delay} s/rad): this was "
                "subtracted; state shutter.row_time_s"
            )
        if self.rest_seen:
            rest = with_uncertainty(*(angle_rad / ARCSEC_RAD for angle_rad in self.rest_rad))
            texts.append(
                f"{begin} where the pendulum rests {rest} arcsec beside the middle of its contact: this was "
                "subtracted, and uncertainties hold what it changes of the losses"
            )
        return tuple(texts)


def _chance(value: float, u: float) -> float:
    """Chance of a value at least so far from zero where zero is true."""
    return erfc(abs(value) / u / sqrt(2.0))


def row_delay(harmonics: PieceHarmonics, period_s: float) -> Alternation:
    """Delay in proportion to the place of the spot, from the swing's second harmonic.

    A delay by k phi makes ``-(k w A^2 / 2) sin(2 w t)`` of A cos(w t). A friction that differs between both
    directions makes a second harmonic proportional to the friction, A^p, and one about another middle than
    that of the contact makes one proportional to its derivative, nearly constant: both are fitted as well.
    """
    amplitude, sine = harmonics.amplitude, harmonics.sine[:, _SECOND]
    if len(amplitude) < _MIN_PIECES:
        return Alternation()
    u = np.sqrt(harmonics.covariance_sine[:, _SECOND, _SECOND])
    friction, delay = np.column_stack([amplitude, np.ones_like(u)]), np.pi / period_s * amplitude**2 / u
    # the scatter of the pieces contains the ground's part
    return _alternation(solve(sine / u, friction / u[:, None], [Term("delay", delay)]), len(sine) - 3)


def sides(points: TurningPoints) -> Floats:
    """1 for the half-cycles at one end of the swing, -1 for those at the other."""
    return np.asarray(1.0 - 2.0 * (points.index % 2))


def time_alternation(linearised: LinearisedFit) -> TimeAlternation:
    """Alternation of the turning times, estimated together with the parameters of an exact fit."""
    points = linearised.points
    late_s = np.column_stack([points.amplitude, _late_per_rest(linearised)]) * sides(points)[:, None]
    derivatives = -linearised.residual_changes(time_s=late_s)
    # a pendulum rests within its swing, which is all that a law of constant friction says of it
    rest = Term("rest", derivatives[:, 1:], float(points.amplitude.min()))
    solution = linearised.solve_terms(Term("delay", derivatives[:, :1]), rest)
    # the scatter is that without the alternation, which the fit may have taken for noise
    dof = len(solution.residuals) - linearised.jacobian.shape[1] - 2
    u_rest_rad = sqrt(solution.covariance[1, 1]) * solution.scatter(dof)
    rest_rad = Estimate(abs(float(solution.values[1])), u_rest_rad)
    return TimeAlternation(_alternation(solution, dof), rest_rad, late_s[:, 1] * solution.values[1])


def _alternation(solution: TermSolution, dof: int) -> Alternation:
    delay = float(solution.values[0])
    u = sqrt(solution.covariance[0, 0]) * solution.scatter(dof)
    if not u < inf:
        return Alternation()
    return Alternation(delay_s_per_rad=delay, u_delay_s_per_rad=u, chance=_chance(delay, u))


def _late_per_rest(linearised: LinearisedFit) -> Floats:
    """Delays (points,) of measured turning points by the rest position, in s/rad; they alternate.

    A friction b |x + r|^p makes the second harmonic ``(8/3 pi) p b r A^(p-1) / (p + 1) sin(2 w t)``. Fits of
    a swing without it are late by ``4/(3 pi)`` of its shift of the turning points themselves.
    """
    amplitude, loss = linearised.model.losses(linearised.coordinates)
    power, of_contact = _contact_power(linearised, amplitude, loss)
    harmonic = 4.0 / (3.0 * pi) * power * of_contact * loss / amplitude / linearised.model.reference
    late_s = linearised.fit.mean_period_s.value / (2.0 * pi) * 4.0 / (3.0 * pi) * 2.0 * harmonic / amplitude
    return np.interp(-linearised.points.amplitude / linearised.model.reference, -amplitude, late_s)


def _contact_power(linearised: LinearisedFit, amplitude: Floats, loss: Floats) -> tuple[Floats, Floats]:
    """The power of the amplitude with which the contact's loss grows, and its share of the loss."""
    of_contact = loss_shares(linearised.model, linearised.coordinates)(amplitude)[0]
    return _slopes(amplitude, np.log(np.maximum(of_contact, _MIN_SHARE) * loss))[0], of_contact


def _slopes(amplitude: Floats, values: Floats) -> tuple[Floats, Floats]:
    """First and second derivative of smooth values by ln A."""
    x = np.log(amplitude)
    smooth = np.polynomial.Polynomial.fit(x, values, 3)
    return np.asarray(smooth.deriv()(x)), np.asarray(smooth.deriv(2)(x))


def with_rest_position(linearised: LinearisedFit, alternation: TimeAlternation, fit: FitResult) -> FitResult:
    """The fit with uncertainties that contain the effect of a rest position beside the contact's middle.

    A distance that chance may make changes nothing. Over both directions, friction with the power p of the
    angle loses ``p (p + 1) / 2 (r / A)^2`` more; an elastic moment with this power, which the period shows,
    is larger by the same share in the mean over the swing. The values stay: the series in r/A is right only
    to some tenths of itself.
    """
    value, u = alternation.rest_rad
    rest = sqrt(max(value**2 - (_CHANCE_U * u) ** 2, 0.0)) / linearised.model.reference
    if rest == 0.0:
        return fit

    def loss_errors(amplitude: Floats, _: Floats) -> Floats:
        power, of_contact = _contact_power(linearised, amplitude, np.interp(-amplitude, -nodes, loss))
        return np.asarray((0.5 * power * (power + 1.0) * of_contact * (rest / amplitude) ** 2)[:, None])

    def duration_errors(amplitude: Floats, node_s: Floats) -> Floats:
        slope, bend = _slopes(amplitude, np.log(np.gradient(node_s)))
        return np.asarray((0.5 * (bend + 2.0 * slope) * (rest / amplitude) ** 2)[:, None])

    nodes, loss = linearised.model.losses(linearised.coordinates)
    errors = DiscrepancyColumns(loss_errors, duration_errors)
    rows = DrivenRows.of(linearised.model, linearised.coordinates, linearised.noise, errors).in_scatter(
        linearised.scale
    )
    changes = -linearised.value_changes(rows.by_errors.sum(axis=1, keepdims=True))
    felt = np.abs(changes[:, 0]) > _MIN_FELT_U * fit.standard_uncertainty
    return fit.with_term(REST_POSITION, changes) if np.any(felt) else fit


def without_alternation(points: TurningPoints, alternation: TimeAlternation) -> TurningPoints:
    """The turning points with times from which a seen alternation is subtracted."""
    late_s = np.zeros(len(points))
    if alternation.rows.seen:
        late_s += alternation.rows.delay_s_per_rad * sides(points) * points.amplitude
    if alternation.rest_seen:
        late_s += alternation.late_by_rest_s
    return replace(points, time_s=points.time_s - late_s)
