"""How well laws describe a decay: the discrepancy of one, the comparison of several, and a fit without any.

A law that lacks an effect needs a stronger drive of the ground, which makes its likelihood smaller. Laws are
compared by the likelihood of turning points and waveform, with Schwarz's penalty for each parameter. An
effect that no drive can take up leaves the residuals correlated, or shows as smooth errors of the law.
Where no law is to be assumed, splines describe the contact's moments.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from math import inf, log, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import DRAG, MomentSplines, PendulumOnBall, spline_law, weight_moment
from processing.contact.laws import Law
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.evidence import NO_EVIDENCE, Evidence
from processing.fit.exact import fit_exact, start_near, starts_of
from processing.fit.exact_model import DiscrepancyColumns, ExactModel
from processing.fit.ground import Noise
from processing.fit.result import DISCREPANCY, DISCREPANCY_SEEN, DiscrepancySize, FitResult
from processing.fit.terms import DrivenRows, LinearisedFit, RestrictedLikelihood
from processing.least_squares import FactoredJacobian, solve
from processing.swing import TurningPoints

_MAX_NODE_SPACING = 0.4
"""Largest distance of an error's nodes, in ln A."""
_CORRELATION_LENGTH = 2.0
"""Distance in ln A over which errors are correlated: a wrong exponent or a missing term bends slowly."""
_SIZES_TRIED = 10.0 ** np.arange(-5.0, 0.51, 0.25)
"""Relative errors of losses and harmonics that are tried; those of durations are smaller by
`_DURATION_SHARE`."""
_DURATION_SHARE = 1e-3
_ERROR_DRIVE_FACTORS = (*10.0 ** np.arange(0.0, -3.01, -0.25), 0.0)
"""Drives of the ground that are tried, over the likeliest one of the law without errors."""
_DIAGONAL_EXCESS = 1e-9
"""Added to the diagonal of a correlation matrix, so that rounding leaves it a root."""


class _Sizes(NamedTuple):
    """Sizes (3,) of the errors of losses, durations and harmonics."""

    likeliest: Floats
    averaged: Floats
    """Rms over the sizes that the data allow."""
    deviance: float
    """-2 ln L of the likeliest sizes."""


def with_discrepancy(linearised: LinearisedFit, fit: FitResult | None = None) -> FitResult:
    """The fit with uncertainties that contain its law's discrepancy from the data.

    `fit` is the fit that receives the term, where it has terms that `linearised.fit` has not.
    """
    fit = linearised.fit if fit is None else fit
    discrepancy, changes = _discrepancy(linearised)
    if changes is None:
        return replace(fit, discrepancy=discrepancy)
    wider = fit.with_term(DISCREPANCY, changes)
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nan_to_num(wider.standard_uncertainty / fit.standard_uncertainty, nan=1.0)
    discrepancy = replace(discrepancy, u_inflation=dict(zip(fit.names, factor.tolist(), strict=True)))
    sizes = {"losses": discrepancy.loss, "durations": discrepancy.duration, "harmonics": discrepancy.waveform}
    errors = [f"its {name} by {float(f'{100 * size:.2g}'):g} %" for name, size in sizes.items() if size]
    warning = (
        f"the law does not describe this decay (chi2 {discrepancy.against_law:.0f} against it): it misses "
        f"{', '.join(errors)}; uncertainties are widened for it by up to {factor.max():.2g}"
    )
    return replace(wider, discrepancy=discrepancy, warnings=(*fit.warnings, warning))


def _discrepancy(linearised: LinearisedFit) -> tuple[DiscrepancySize, Floats | None]:
    """The discrepancy, and changes of the values by errors of its size; None where it is not seen."""
    if linearised.fit.loss != "linear":
        return DiscrepancySize(against_law=nan), None
    model = linearised.model
    nodes = _HatFunctions(linearised.points.amplitude / model.reference)
    of_waveform = _by_harmonics(linearised, nodes)
    errors = DiscrepancyColumns(nodes, nodes)

    def driven(noise: Noise) -> DrivenRows:
        return DrivenRows.of(model, linearised.coordinates, noise, errors, of_waveform)

    all_rows = map(driven, linearised.noises(_ERROR_DRIVE_FACTORS))
    trials = [rows for rows in all_rows if np.all(np.isfinite(rows.residuals))]
    if not trials:
        return DiscrepancySize(against_law=nan), None
    best = min((_scaled(rows, _likeliest_sizes, 0.01) for rows in trials), key=lambda sizes: sizes.deviance)
    # without errors the scatter may be larger instead
    against = min(_scaled(rows, _without_errors, 0.001).deviance for rows in trials) - best.deviance
    if not against > DISCREPANCY_SEEN:
        return DiscrepancySize(against_law=max(against, 0.0)), None
    loss, duration, waveform = best.averaged.tolist()
    discrepancy = DiscrepancySize(loss=loss, duration=duration, waveform=waveform, against_law=float(against))
    # the effect of errors of these sizes on the values, which were fitted with the law's own weights
    rows = driven(linearised.noise).in_scatter(linearised.scale)
    law, sizes = FactoredJacobian(rows.jacobian), np.repeat(best.averaged, nodes.count)
    return discrepancy, linearised.to_physical @ law.coefficients(rows.by_errors * sizes)


class _HatFunctions:
    """Smooth functions of ln A: linear interpolation between even nodes, with correlated values at them."""

    def __init__(self, amplitude: Floats) -> None:
        x = np.log(amplitude)
        count = max(3, int(np.ceil(np.ptp(x) / _MAX_NODE_SPACING)) + 1)
        self._nodes = np.linspace(x.min(), x.max(), count)
        distance = np.abs(self._nodes[:, None] - self._nodes) / _CORRELATION_LENGTH
        correlation = np.exp(-0.5 * distance**2) + _DIAGONAL_EXCESS * np.eye(count)
        self._root = np.linalg.cholesky(correlation)
        self.count = count

    def __call__(self, amplitude: Floats, _: Floats | None = None) -> Floats:
        """Values (n, m) of m independent unit errors."""
        x = np.clip(np.log(amplitude), self._nodes[0], self._nodes[-1])
        width = self._nodes[1] - self._nodes[0]
        hats = np.maximum(0.0, 1.0 - np.abs(x[:, None] - self._nodes) / width)
        return np.asarray(hats @ self._root)


def _by_harmonics(linearised: LinearisedFit, nodes: _HatFunctions) -> Floats:
    """The evidence's derivatives with respect to relative errors of losses, durations (0) and harmonics."""
    model, waveform = linearised.model, linearised.model.evidence.waveform
    derivatives = np.zeros((len(model.evidence_residuals(linearised.coordinates)), 3 * nodes.count))
    if waveform is None:
        return derivatives
    predicted = waveform.predicted_rad(model.law, model.values(linearised.coordinates), model.pendulum)
    for column, shape in enumerate(nodes(waveform.amplitude_rad / model.reference).T, 2 * nodes.count):
        reduced = waveform.reduced(shape[:, None] * predicted)
        derivatives[: len(reduced), column] = reduced
    return derivatives


def _scaled(
    stated: DrivenRows, estimate: Callable[[RestrictedLikelihood], _Sizes], tolerance: float
) -> _Sizes:
    """Sizes by `estimate`, for turning points that scatter as much as their residuals with these sizes do."""
    scale2 = 1.0
    for _ in range(3):
        rows = stated.in_scatter(sqrt(scale2))
        restricted = RestrictedLikelihood(rows.residuals, rows.jacobian, np.split(rows.by_errors, 3, axis=1))
        sizes = estimate(restricted)
        unexplained = restricted.unexplained(sizes.likeliest)[: rows.points]
        dof, last_scale2 = rows.points - restricted.law.directions.shape[1], scale2
        scale2 = max(1.0, float(unexplained @ unexplained) * last_scale2 / dof)
        if abs(scale2 - last_scale2) < tolerance * scale2:
            break
    return sizes._replace(deviance=sizes.deviance + rows.log_det)


def _without_errors(restricted: RestrictedLikelihood) -> _Sizes:
    zero = np.zeros(3)
    return _Sizes(zero, zero, restricted.deviance(zero))


def _likeliest_sizes(restricted: RestrictedLikelihood) -> _Sizes:
    """The likeliest sizes, each sought in turn, and their means."""
    grids = [_SIZES_TRIED, _DURATION_SHARE * _SIZES_TRIED, _SIZES_TRIED]
    sizes, deviance = np.zeros(3), inf
    grid_deviances: list[Floats] = []
    for _ in range(2):
        grid_deviances = []
        for kind, grid in enumerate(grids):
            deviances = restricted.deviances(sizes, kind, np.append(0.0, grid))
            least = int(np.argmin(deviances))
            sizes[kind] = 0.0 if least == 0 else grid[least - 1]
            deviance = float(deviances[least])
            grid_deviances.append(deviances[1:])
    # the mean square over the sizes that the data allow: with few nodes the likeliest is often too small
    averaged = sizes.copy()
    for kind, grid in enumerate(grids):
        if sizes[kind] > 0:
            weights = np.exp(-0.5 * (grid_deviances[kind] - grid_deviances[kind].min()))
            averaged[kind] = np.sqrt(np.sum(weights * grid**2) / np.sum(weights))
    return _Sizes(sizes, averaged, deviance)


EXCLUDED_BIC = 10.0
"""Distance in BIC above which a law is excluded: odds of 150 to 1 (Kass & Raftery 1995)."""


@dataclass(frozen=True, slots=True)
class LawTrial:
    """The best fit of one law, or the reason why there is none."""

    law: Law
    fit: FitResult | None
    bic: float = inf
    """``-2 ln L + k ln N`` for k parameters and N numbers, an amplitude and a time of each half-cycle;
    infinite without a fit."""
    problem: str = ""
    """Reason why there is no fit."""


@dataclass(frozen=True, slots=True)
class LawComparison:
    """The laws in the order of their BIC, the best first."""

    trials: tuple[LawTrial, ...]

    def above_best(self, trial: LawTrial) -> float:
        """A law's BIC minus the best one's; infinite for a law without a fit."""
        return trial.bic - self.trials[0].bic if trial.fit is not None else inf

    @property
    def remaining(self) -> tuple[LawTrial, ...]:
        """The laws that the data do not exclude."""
        return tuple(trial for trial in self.trials if self.above_best(trial) <= EXCLUDED_BIC)

    @property
    def describes(self) -> bool:
        """Whether the best law's residuals are noise and nothing else."""
        best = self.trials[0].fit
        if best is None or best.whiteness is None or best.whiteness.correlated:
            return False
        return best.discrepancy is None or not best.discrepancy.seen

    def text(self, remedy: str = "a higher start or more runs may") -> str:
        """The verdict in words; `remedy` says what would tell the remaining laws apart."""
        names = [trial.law.name for trial in self.remaining]
        if not names:
            return "none of these laws can be fitted to this decay"
        excluded = [trial.law.name for trial in self.trials if trial.law.name not in names]
        without = f"; excluded: {', '.join(excluded)}" if excluded else ""
        if len(names) > 1:
            conclusion = f"this decay cannot tell {' and '.join(names)} apart; {remedy}"
        else:
            conclusion = f"of these laws, {names[0]} describes this decay best"
        if self.describes:
            return conclusion + without
        doubt = "but the residuals are not noise: something else moves the spot, or no law is right"
        return f"{conclusion}{without}; {doubt}"


def compare_laws(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    laws: Iterable[Law],
    *,
    like: FitResult | None = None,
) -> LawComparison:
    """Fit every law to the same turning points.

    Parameters
    ----------
    like
        An exact fit of these points. Each law has the same evidence, and a linear drag if this fit has one;
        without it, neither.
    """
    known_fits = {} if like is None else {like.law.name: like}
    drag, evidence = (False, NO_EVIDENCE) if like is None else (like.has_drag, like.evidence)
    trials = []
    for law in laws:
        try:
            fit = known_fits.get(law.name) or _fit(points, pendulum, law, drag, evidence)
        except DataError as error:
            trials.append(LawTrial(law, None, problem=str(error)))
            continue
        lost = len(points) - fit.half_cycles
        if lost:
            problem = f"the drive that it needs would drown {lost} half-cycles"
            trials.append(LawTrial(law, None, problem=problem))
            continue
        bic = fit.ground_fit.unrestricted + len(fit.names) * log(2 * len(points))
        trials.append(LawTrial(law, fit, bic))
    first, *others = sorted(trials, key=lambda trial: trial.bic)
    if first.fit is not None and first.fit.discrepancy is None:
        discrepancy = with_discrepancy(LinearisedFit.of(points, pendulum, first.fit)).discrepancy
        first = replace(first, fit=replace(first.fit, discrepancy=discrepancy))
    return LawComparison((first, *others))


def _fit(
    points: TurningPoints, pendulum: PendulumOnBall, law: Law, drag: bool, evidence: Evidence
) -> FitResult:
    """The exact fit of a law, also searched from its fit to the turning points alone: where the waveform
    contradicts a law, its own start values may lie in the valley of a far worse minimum."""
    near: FitResult | None = None
    if evidence.waveform is not None:
        with suppress(DataError):
            near = fit_exact(points, pendulum, law=law, drag=drag, evidence=replace(evidence, waveform=None))
    try:
        return fit_exact(points, pendulum, law=law, drag=drag, evidence=evidence, near=near)
    except DataError:
        if near is None:
            raise
        raise DataError(
            "the fit to turning points and waveform together did not converge; to turning points alone it did"
        ) from None


_FIXED_DRAG_U = 1e-4
"""Relative uncertainty of a drag that is held fixed."""
_MARGIN = 1.1
"""Factor by which the angles of moments stay inside both ends of the amplitudes."""
_ALL_GRAVITY = Estimate(1.0, 0.0)


@dataclass(frozen=True, slots=True)
class FreeMoments:
    """Friction and elastic moment of the contact at angles `phi_rad` > 0."""

    phi_rad: Floats
    friction_n_m: Floats
    """Moment against the motion."""
    u_friction_n_m: Floats
    elastic_n_m: Floats
    """Departure from proportionality, in the direction of phi; it vanishes at `reference_rad`."""
    u_elastic_n_m: Floats
    reference_rad: float


@dataclass(frozen=True, slots=True)
class ModelFreeFit:
    """The fit of splines to one decay, and the moments by it."""

    points: TurningPoints
    pendulum: PendulumOnBall
    splines: MomentSplines
    fit: FitResult
    gravity: Estimate = _ALL_GRAVITY
    """Share of gravity in the stiffness at the reference, by the T0 of a law. Splines cannot tell gravity
    from an elastic moment of the contact; where the share is not known it counts as 1."""

    def moments(self, phi_rad: Floats | None = None) -> FreeMoments:
        """Moments with bands; by default at 41 angles between the lowest and the highest amplitude."""
        if phi_rad is None:
            low, high = self.points.amplitude.min() * _MARGIN, self.points.amplitude.max() / _MARGIN
            phi_rad = np.geomspace(low, high, 41)
        return self._of(phi_rad, self.fit.values, self.fit.covariance)

    def _of(self, phi_rad: Floats, values: Floats, covariance: Floats) -> FreeMoments:
        unit_rad, weight = self.splines.unit_rad, weight_moment(self.pendulum) * self.gravity.value
        x, count = phi_rad / unit_rad, self.splines.friction_count

        def moment(basis: Floats, own: slice) -> tuple[Floats, Floats]:
            """Moment by a basis of splines with their coefficients, and its standard uncertainty."""
            value = basis @ values[own]
            variance = np.einsum("ij,jk,ik->i", basis, covariance[own, own], basis)
            of_gravity = self.gravity.standard_uncertainty / self.gravity.value * value
            return value, np.hypot(np.sqrt(np.maximum(variance, 0.0)), of_gravity)

        friction = moment(weight * self.splines.friction(x), slice(0, count))
        elastic_rows = slice(count, count + self.splines.elastic_count)
        elastic = moment(weight * unit_rad * self.splines.elastic(x), elastic_rows)
        return FreeMoments(phi_rad, *friction, *elastic, unit_rad)

    def moments_of_law(self, fit: FitResult, phi_rad: Floats) -> FreeMoments:
        """Moments of splines with the turning points of a fitted law; their uncertainties are 0."""
        # at the values of a law that does not fit, its waveform may have no derivatives
        of_points = replace(fit, evidence=replace(fit.evidence, waveform=None))
        law, coordinates = ExactModel.of(self.points, self.pendulum, of_points)
        amplitude, time_s, _, _ = law.curve(coordinates)
        free_decay = replace(law.points, amplitude=amplitude * law.reference, time_s=time_s)
        free_decay = free_decay.first(int(np.count_nonzero(np.isfinite(time_s))))
        drag, evidence = self.fit.has_drag, NO_EVIDENCE
        if drag:
            # the drag is the law's, so that the splines hold its friction alone
            drag_s = fit.estimate(DRAG.key).value if fit.has_drag else 0.0
            drag_s *= _drag_ratio(fit, self.fit.estimate("period0_s").value)
            evidence = Evidence(drag_s=Estimate(drag_s, _FIXED_DRAG_U * max(abs(drag_s), 1e-6)))
        model = ExactModel(free_decay, self.pendulum, law=self.fit.law, drag=drag, evidence=evidence)
        start = next(chain(start_near(model, self.fit), starts_of(model)))
        model = model.linearised_at(start)
        solution = solve(model, start, lower=model.lower, upper=model.upper)
        values, _ = model.parametrisation.physical(solution.values)
        return self._of(phi_rad, values, np.zeros_like(self.fit.covariance))


def _drag_ratio(fit: FitResult, period_s: float) -> float:
    """Ratio of a drag in the splines' terms to the same drag in a law's: it is stated over the stiffness,
    which the splines take as gravity's alone at the period `period_s`."""
    return (period_s / fit.estimate("period0_s").value) ** 2


def fit_model_free(
    points: TurningPoints, pendulum: PendulumOnBall, *, like: FitResult | None = None
) -> ModelFreeFit:
    """Friction and elastic moment of one decay as splines, with the drive of the ground that they leave.

    `like` is an exact fit of these points. The splines have its evidence, and its drag if it has both:
    without evidence they would take a drag for friction. Gravity's share of the moments follows from its T0
    (see `ModelFreeFit.gravity`). Raises DataError as `fit_exact`.
    """
    law, splines = spline_law(points)
    evidence = NO_EVIDENCE if like is None else like.evidence
    if like is not None and evidence.drag_s is not None:
        factor = _drag_ratio(like, like.mean_period_s.value)
        evidence = replace(evidence, drag_s=Estimate(*(factor * drag_s for drag_s in evidence.drag_s)))
    drag = like is not None and like.has_drag and evidence != NO_EVIDENCE
    fit = fit_exact(points, pendulum, law=law, drag=drag, evidence=evidence)
    gravity = _ALL_GRAVITY
    if like is not None:
        period0_s, u_period0_s = like.estimate("period0_s")
        share = 1 / _drag_ratio(like, fit.estimate("period0_s").value)
        gravity = Estimate(share, 2 * share * u_period0_s / period0_s)
    return ModelFreeFit(points.first(fit.half_cycles), pendulum, splines, fit, gravity)
