"""The contact's moments from one decay without any law, as splines, and a law's discrepancy from a decay.

Moments of fitted laws are described by the same splines, so that both can be compared.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, MomentSplines, PendulumOnBall, spline_law, weight_moment
from processing.estimate import Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact, start_near, starts_of
from processing.fit.exact_model import ExactModel, LawErrors
from processing.fit.result import DISCREPANCY, DISCREPANCY_SEEN, DiscrepancySize, FitResult
from processing.fit.terms import DrivenRows, LinearisedFit, RestrictedLikelihood
from processing.least_squares import FactoredJacobian, solve
from processing.swing import TurningPoints

_HELD_U = 1e-4
"""Relative uncertainty of a drag that is held fixed."""
_MARGIN = 1.1
"""Factor by which the angles of `ModelFreeFit.moments` stay inside the range of the amplitudes."""


@dataclass(frozen=True, slots=True)
class FreeMoments:
    """Friction against the motion, and elastic moment in the direction of phi, at angles `phi_rad` > 0.

    The elastic moment is the departure from proportionality: it vanishes at `reference_rad`, where the period
    is that of gravity alone by definition. `u_` are standard uncertainties; bands of 1 u cover 68 %.
    """

    phi_rad: Floats
    friction_n_m: Floats
    u_friction_n_m: Floats
    elastic_n_m: Floats
    u_elastic_n_m: Floats
    reference_rad: float


@dataclass(frozen=True, slots=True)
class ModelFreeFit:
    """The fit of splines to one decay, and the moments by it."""

    points: TurningPoints
    pendulum: PendulumOnBall
    splines: MomentSplines
    fit: FitResult

    def moments(self, phi_rad: Floats | None = None) -> FreeMoments:
        """Moments with bands; by default at 41 angles between the lowest and the highest amplitude."""
        if phi_rad is None:
            low, high = self.points.amplitude.min() * _MARGIN, self.points.amplitude.max() / _MARGIN
            phi_rad = np.geomspace(low, high, 41)
        return self._of(phi_rad, self.fit.values, self.fit.covariance)

    def _of(self, phi_rad: Floats, values: Floats, covariance: Floats) -> FreeMoments:
        unit_rad, weight = self.splines.unit_rad, weight_moment(self.pendulum)
        x = phi_rad / unit_rad
        friction, elastic = weight * self.splines.friction(x), weight * unit_rad * self.splines.elastic(x)
        of_friction = slice(0, self.splines.friction_count)
        of_elastic = slice(of_friction.stop, of_friction.stop + self.splines.elastic_count)
        return FreeMoments(
            phi_rad,
            friction @ values[of_friction],
            _uncertainty(friction, covariance[of_friction, of_friction]),
            elastic @ values[of_elastic],
            _uncertainty(elastic, covariance[of_elastic, of_elastic]),
            unit_rad,
        )

    def moments_of_law(self, fit: FitResult, phi_rad: Floats) -> FreeMoments:
        """Moments of a fitted law, as the splines that fit its own turning points; uncertainties are 0."""
        law, columns = ExactModel.of(self.points, self.pendulum, fit)
        amplitude, time_s, _, _ = law.curve(columns)
        predicted = replace(law.points, amplitude=amplitude * law.reference, time_s=time_s)
        count = int(np.count_nonzero(np.isfinite(time_s)))
        drag = self.fit.has_drag
        # the drag is held at the law's value, so that the splines describe the law's friction alone
        known_s = fit.estimate(DRAG.key).value if fit.has_drag else 0.0
        known_s *= _drag_ratio(fit, self.fit.estimate("period0_s").value)
        held = Evidence(drag_s=_held_at(known_s)) if drag else NO_EVIDENCE
        model = ExactModel(predicted.first(count), self.pendulum, law=self.fit.law, drag=drag, evidence=held)
        start = next(chain(start_near(model, self.fit), starts_of(model)))
        model = model.linearised_at(start)
        solution = solve(model, start, lower=model.lower, upper=model.upper)
        values, _ = model.columns.physical(solution.values)
        return self._of(phi_rad, values, np.zeros_like(self.fit.covariance))


def _drag_ratio(fit: FitResult, period_s: float) -> float:
    """Ratio of a drag in the splines' terms to the same drag in a law's.

    A drag is stated over the stiffness, which the splines take as gravity's alone at the period `period_s`.
    """
    return (period_s / fit.estimate("period0_s").value) ** 2


def _held_at(drag_s: float) -> Estimate:
    return Estimate(drag_s, _HELD_U * max(abs(drag_s), 1e-6))


def _uncertainty(basis: Floats, covariance: Floats) -> Floats:
    variance = np.einsum("ij,jk,ik->i", basis, covariance, basis)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_model_free(
    points: TurningPoints, pendulum: PendulumOnBall, *, like: FitResult | None = None
) -> ModelFreeFit:
    """Friction and elastic moment of one decay as splines, fitted with the drive of the ground.

    `like` is an exact fit of these points, whose evidence is used for the splines as well. A drag is fitted
    if `like` has a drag and evidence: without evidence the splines would take the drag for friction.

    Raises
    ------
    DataError
        As `fit_exact`.
    """
    law, splines = spline_law(points)
    evidence = NO_EVIDENCE if like is None else like.evidence
    if like is not None and evidence.drag_s is not None:
        factor = _drag_ratio(like, like.mean_period_s.value)
        evidence = replace(evidence, drag_s=Estimate(*(factor * number for number in evidence.drag_s)))
    drag = like is not None and like.has_drag and evidence != NO_EVIDENCE
    fit = fit_exact(points, pendulum, law=law, drag=drag, evidence=evidence)
    return ModelFreeFit(points.first(fit.half_cycles), pendulum, splines, fit)


_SPACING = 0.4
"""Largest distance of an error's nodes, in ln A."""
_CORRELATION_LENGTH = 2.0
"""Distance in ln A over which errors are correlated: a wrong exponent or a missing term bends slowly."""
_SIZES_TRIED = 10.0 ** np.arange(-5.0, 0.51, 0.25)
"""Relative errors of losses and harmonics that are tried; for durations times `_DURATION_SHARE`."""
_DURATION_SHARE = 1e-3
_STEPS = np.arange(0.0, -3.01, -0.25)
"""Decimal logarithms of the drives that are tried, relative to the likeliest one for a law without errors."""
_DIAGONAL = 1e-9
"""Added to the diagonal of a correlation matrix, so that rounding leaves it a root."""


class _Sizes(NamedTuple):
    """Sizes (3,) of the errors of losses, durations and harmonics; `deviance` is -2 ln L of the likeliest.

    `averaged` is the rms over the sizes that the data allow.
    """

    likeliest: Floats
    averaged: Floats
    deviance: float


def with_discrepancy(at: LinearisedFit, fit: FitResult | None = None) -> FitResult:
    """The fit with uncertainties that contain its law's discrepancy from the data.

    `fit` is the fit that receives the term; None: `at.fit`. It may have terms that `at.fit` does not have.
    """
    fit = at.fit if fit is None else fit
    misfit, by = _discrepancy(at)
    if by is None:
        return replace(fit, misfit=misfit)
    wider = fit.with_term(DISCREPANCY, by)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(wider.standard_uncertainty / fit.standard_uncertainty, nan=1.0)
    misfit = replace(misfit, widened=dict(zip(fit.names, factor.tolist(), strict=True)))
    return replace(wider, misfit=misfit, warnings=(*fit.warnings, *_warnings(misfit, factor)))


def _warnings(misfit: DiscrepancySize, factor: Floats) -> tuple[str, ...]:
    parts = [
        f"its {name} by {float(f'{100 * size:.2g}'):g} %"
        for name, size in (
            ("losses", misfit.loss), ("durations", misfit.duration), ("harmonics", misfit.waveform),
        )
        if size
    ]  # fmt: skip
    text = (
        f"the law does not describe this decay (chi2 {misfit.against_law:.0f} against it): it misses "
        f"{', '.join(parts)}; uncertainties are widened for it by up to {factor.max():.2g}"
    )
    return (text,)


def _discrepancy(at: LinearisedFit) -> tuple[DiscrepancySize, Floats | None]:
    """The discrepancy, and changes of the values by errors of its size; None where it is not seen."""
    if at.fit.loss != "linear":
        return DiscrepancySize(against_law=nan), None
    model = at.model
    nodes = _HatFunctions(at.points.amplitude / model.reference)
    waveform_errors = _by_harmonics(at, nodes)
    own = model.noise_of(at.fit)
    errors = LawErrors(nodes, nodes)

    def driven(step: float) -> DrivenRows | None:
        found = at.driven(replace(own, step=step), errors)
        if not np.all(np.isfinite(found.residuals)):
            return None
        padded = np.zeros((len(found.residuals), nodes.count))
        padded[found.points :] = waveform_errors
        return found._replace(by_errors=np.column_stack([found.by_errors, padded]))

    steps = _drives(own.step, float(np.median(model.u_amplitude)))
    tried = [here for here in map(driven, steps) if here is not None]
    if not tried:
        return DiscrepancySize(against_law=nan), None
    best = min((_scaled(here, _likeliest_sizes, 0.01) for here in tried), key=lambda one: one.deviance)
    # without errors the scatter may be larger instead
    against = min(_scaled(here, _without_errors, 0.001).deviance for here in tried) - best.deviance
    if not against > DISCREPANCY_SEEN:
        return DiscrepancySize(against_law=max(against, 0.0)), None
    loss, duration, waveform = best.averaged.tolist()
    misfit = DiscrepancySize(loss=loss, duration=duration, waveform=waveform, against_law=float(against))
    # the values were fitted with the drive of the law alone, so that the effect of the errors is, too
    here = driven(own.step)
    assert here is not None
    here = here.in_scatter(at.scale)
    by = FactoredJacobian(here.jacobian).coefficients(here.by_errors * np.repeat(best.averaged, nodes.count))
    return misfit, at.to_physical @ by


class _HatFunctions:
    """Smooth functions of ln A: linear interpolation between even nodes, with correlated values at them."""

    def __init__(self, amplitude: Floats) -> None:
        x = np.log(amplitude)
        count = max(3, int(np.ceil(np.ptp(x) / _SPACING)) + 1)
        self._at = np.linspace(x.min(), x.max(), count)
        apart = np.abs(self._at[:, None] - self._at) / _CORRELATION_LENGTH
        correlation = np.exp(-0.5 * apart**2) + _DIAGONAL * np.eye(count)
        self._root = np.linalg.cholesky(correlation)
        self.count = count

    def __call__(self, amplitude: Floats, _: Floats | None = None) -> Floats:
        """Values (n, m) of the m functions, with independent coefficients of standard deviation 1."""
        x = np.clip(np.log(amplitude), self._at[0], self._at[-1])
        width = self._at[1] - self._at[0]
        hats = np.maximum(0.0, 1.0 - np.abs(x[:, None] - self._at) / width)
        return np.asarray(hats @ self._root)


def _drives(own: float, unit: float) -> list[float]:
    """Steps of the drive that are tried, the last one zero."""
    largest = own if own > 0 else 1e-3 * unit
    return [*(largest * 10.0**_STEPS).tolist(), 0.0]


def _by_harmonics(at: LinearisedFit, nodes: _HatFunctions) -> Floats:
    """Derivatives of the residuals of the evidence by relative errors of the law's harmonics."""
    model, waveform = at.model, at.model.evidence.waveform
    out = np.zeros((len(model.evidence_residuals(at.coordinates)), nodes.count))
    if waveform is None or model.pendulum is None:
        return out
    predicted = waveform.predicted_rad(model.law, at.values, model.pendulum)
    for column, shape in enumerate(nodes(waveform.amplitude_rad / model.reference).T):
        moved = waveform.reduced(shape[:, None] * predicted)
        out[: len(moved), column] = moved
    return out


def _scaled(here: DrivenRows, sizes_of: Callable[[RestrictedLikelihood], _Sizes], tolerance: float) -> _Sizes:
    """Sizes by `sizes_of`, at the scale of the turning points' scatter that their residuals then have."""
    scale2 = 1.0
    for _ in range(3):
        rows = here.in_scatter(sqrt(scale2))
        restricted = RestrictedLikelihood(rows.residuals, rows.jacobian, np.split(rows.by_errors, 3, axis=1))
        found = sizes_of(restricted)
        rest = restricted.unexplained(found.likeliest)[: rows.points]
        before = scale2
        scale2 = max(1.0, float(rest @ rest) * before / (rows.points - restricted.law.directions.shape[1]))
        if abs(scale2 - before) < tolerance * scale2:
            break
    return found._replace(deviance=found.deviance + rows.log_det)


def _without_errors(here: RestrictedLikelihood) -> _Sizes:
    none = np.zeros(3)
    return _Sizes(none, none, here.deviance(none))


def _likeliest_sizes(here: RestrictedLikelihood) -> _Sizes:
    """The likeliest sizes, each sought in turn, and their means."""
    grids = [_SIZES_TRIED, _DURATION_SHARE * _SIZES_TRIED, _SIZES_TRIED]
    sizes, deviance = np.zeros(3), inf
    tried: list[Floats] = []
    for _ in range(2):
        tried = []
        for kind, grid in enumerate(grids):
            found = here.deviances(sizes, kind, np.append(0.0, grid))
            least = int(np.argmin(found))
            sizes[kind] = 0.0 if least == 0 else grid[least - 1]
            deviance = float(found[least])
            tried.append(found[1:])
    # the mean square over the sizes that the data allow: with few nodes the likeliest is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (tried[kind] - tried[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    return _Sizes(sizes, averaged, deviance)
