"""The linear drag of the air: in one decay by its data alone, and from runs with vanes on the pendulum.

Vanes add to the drag in proportion to their area: ``drag = d0 + k area``. The contact is the same in all
runs, the period is not: vanes have inertia. All runs are fitted together, each with noise and waveform of its
own fit, and with its own period, first amplitude and time. Contact and drag of a single run may lie far along
a curved valley; what the runs share is where the valleys meet.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, isnan, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.arrays import Floats
from processing.contact import ExpectedDrag, PendulumOnBall
from processing.contact.laws import AMPLITUDE, DRAG, PAPER, TIME
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate, FitMethod
from processing.fit.determination import profile_likelihood
from processing.fit.exact import fit_exact, fit_exact_with, start_near
from processing.fit.exact_model import ExactModel
from processing.fit.result import SIGNIFICANT_CHANCE, FitResult
from processing.fit.terms import Term
from processing.fit.terms import solve as solve_terms
from processing.least_squares import FactoredJacobian, covariance_of, differenced, propagate, solve
from processing.number_text import plain, with_uncertainty
from processing.swing import TurningPoints

_FIT_BELOW_CHANCE = 0.05
"""Probability by chance of the linear step's F below which a fit with a drag is made, whatever u(b) is."""
_MAX_TEST_DIFFERENCE = 0.2
"""Difference of the drag's two tests, by curvature and by likelihood, up to which chi2 is a parabola."""


class DragFinding(StrEnum):
    """Finding on a linear drag by the data alone, without prior knowledge."""

    SEEN = "a linear drag is in the data"
    NEGATIVE = "the data ask for a negative drag"
    """It would drive the pendulum: something else is missing from the model."""
    UNSEEN = "no linear drag is seen"
    """The bound is below the drag that would move b by its uncertainty."""
    OPEN = "the data do not tell a drag from friction"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drag:
    """Whether a linear drag is in the data, and what it does to b and c."""

    drag_s: Estimate = NOT_DETERMINED
    """Drag of the reported fit, with prior knowledge; for a fit in vacuum, from the data."""
    of_data_s: Estimate = NOT_DETERMINED
    """Drag from decay and waveform alone; not determined where a drag could be all of the friction. Where
    chi2 is not a parabola, the uncertainty agrees with the test: infinite if the decay is described equally
    well without a drag."""
    known_s: Estimate | None = None
    """Prior knowledge: the estimate for air, or a measured value; None if left open."""
    upper_95_s: float = inf
    """Bound of 95 % from the data alone; infinite if they set none."""
    f_statistic: float = nan
    """Rise of chi2 without the drag, over the scatter."""
    p_value: float = nan
    """Probability of such a rise if there is no drag."""
    relative_shift_b: float = nan
    """Relative change of b from a fit without drag to one with it."""
    relative_shift_c: float = nan
    """The same of c."""
    finding: DragFinding = DragFinding.OPEN
    of_air: ExpectedDrag | None = None
    """The drag expected of the air; None if not requested."""

    @property
    def significant(self) -> bool:
        """Whether a drag is seen."""
        return self.finding is DragFinding.SEEN

    @property
    def text(self) -> str:
        """Finding, value and test in one line."""
        value, u = self.drag_s
        return (
            f"{self.finding}: drag {with_uncertainty(value, u)} s, F = {plain(self.f_statistic, 3)} "
            f"(p = {plain(self.p_value, 2)})"
        )


def drag_verdict(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> Drag:
    """The linear drag by the data of an exact fit; a fit without drag is repeated with one.

    Where a drag could be all of the friction, no such fit is made: it would end anywhere along a valley.
    Value, bound and shifts are not determined then. Raises DataError for another method,
    or where a fit does not converge.
    """
    if fit.method is not FitMethod.EXACT:
        raise DataError("the drag verdict is of an exact fit")
    if not fit.has_drag and (inseparable := _inseparable(points, pendulum, fit)) is not None:
        return inseparable
    without_prior, known_s = replace(fit.evidence, drag_s=None), fit.evidence.drag_s
    if fit.has_drag:
        like = replace(fit, evidence=without_prior)
        by_data = fit if known_s is None else fit_exact_with(points, pendulum, like, drag=True)
        dragless = without = fit_exact_with(points, pendulum, like, drag=False)
        with_drag = fit
    else:
        # the noise of a fit without drag may hold the drag that it lacks
        by_data = fit_exact(points, pendulum, drag=True, evidence=without_prior, loss=fit.loss, near=fit)
        dragless, with_drag = fit, by_data
        without = fit_exact_with(points, pendulum, by_data, drag=False)
    test, is_parabolic = _test(points, pendulum, _at_least_as_uncertain(by_data, fit), without)
    return replace(
        test,
        drag_s=test.of_data_s if with_drag.evidence.drag_s is None else with_drag.estimate(DRAG.key),
        known_s=known_s if fit.has_drag else None,
        relative_shift_b=_relative_shift(dragless.parameters.b, with_drag.parameters.b),
        relative_shift_c=_relative_shift(dragless.parameters.c, with_drag.parameters.c),
        finding=_finding(by_data, fit, test, is_parabolic),
    )


def _inseparable(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> Drag | None:
    """The verdict where one linear step from the fit without a drag leaves b as uncertain as it is large,
    with an F that is likely by chance: the decay cannot tell a drag from friction. None elsewhere."""
    from scipy.special import fdtrc

    model = ExactModel(points.first(fit.half_cycles), pendulum, law=fit.law, drag=True, evidence=fit.evidence)
    start = next(start_near(model, fit), None)
    if start is None:
        return None
    weighted = model.on_ground(start, model.noise_of(fit), fit.ground_fit.measurement_scale)
    residuals, jacobian = weighted.linearised_at(start)(start)
    step, to_physical = FactoredJacobian(jacobian), model.parametrisation.physical(start)[1]
    unexplained = step.residual(residuals)
    f_statistic = max(0.0, float(residuals @ residuals - unexplained @ unexplained)) / fit.scatter2
    p_value = float(fdtrc(1, fit.dof - 1, f_statistic))
    b = model.names.index(fit.contact_names[0])
    u_b = sqrt(propagate(to_physical, step.covariance())[b, b] * fit.scatter2)
    if p_value < _FIT_BELOW_CHANCE or u_b < abs(fit.estimate(fit.contact_names[0]).value):
        return None
    return Drag(f_statistic=f_statistic, p_value=p_value)


def _test(
    points: TurningPoints, pendulum: PendulumOnBall, by_data: FitResult, without: FitResult
) -> tuple[Drag, bool]:
    """The test by the rise of chi2 where the drag is left out, and whether chi2 is a parabola.

    Friction and drag can replace each other along a curved valley, whose length does not follow from the
    curvature at its bottom. There the profile likelihood bounds it, and the uncertainty agrees with the test.
    """
    from scipy.special import fdtrc, stdtrit

    value, u = by_data.estimate(DRAG.key)
    scale = by_data.scatter2 * float(by_data.inflation[by_data.names.index(DRAG.key)]) ** 2
    f_statistic = max(0.0, 2 * (without.cost - by_data.cost)) / scale
    p_value = float(fdtrc(1, by_data.dof, f_statistic))
    upper_95 = max(0.0, value) + float(stdtrit(by_data.dof, 0.95)) * u if u < inf else inf
    by_curvature = abs(value) / u if u > 0 else inf
    is_parabolic = abs(sqrt(f_statistic) - by_curvature) <= _MAX_TEST_DIFFERENCE * max(1.0, by_curvature)
    if not is_parabolic:
        u = max(u, abs(value) / sqrt(f_statistic)) if f_statistic > 0 else inf
        # the upper end of an interval of 90 % is a bound of 95 %
        profile = profile_likelihood(points, pendulum, by_data, DRAG.key, coverage=0.9)
        upper_95 = inf if isnan(profile.upper) else profile.upper
    drag = Drag(of_data_s=Estimate(value, u), upper_95_s=upper_95, f_statistic=f_statistic, p_value=p_value)
    return drag, is_parabolic


def _at_least_as_uncertain(by_data: FitResult, fit: FitResult) -> FitResult:
    """The fit of the data alone, its uncertainties enlarged at least as much as those of the reported fit."""
    if by_data is fit or fit.u_inflation is None or len(fit.u_inflation) != len(by_data.names):
        return by_data
    u_inflation = np.maximum(fit.u_inflation, by_data.inflation)
    more = u_inflation / by_data.inflation
    return replace(by_data, u_inflation=u_inflation, covariance=by_data.covariance * np.outer(more, more))


def _relative_shift(value: float, shifted: float) -> float:
    return shifted / value - 1 if value else nan


def _finding(by_data: FitResult, reported: FitResult, test: Drag, is_parabolic: bool) -> DragFinding:
    """The finding by the reported uncertainty of b, which in vacuum is that of a fit without a drag."""
    if test.p_value < SIGNIFICANT_CHANCE:
        return DragFinding.SEEN if test.of_data_s.value > 0 else DragFinding.NEGATIVE
    fit = reported if reported.has_drag else by_data
    b, drag = fit.names.index(fit.contact_names[0]), fit.names.index(DRAG.key)
    shift_b = test.upper_95_s * abs(fit.covariance[b, drag] / fit.covariance[drag, drag])
    u_b = reported.estimate(reported.contact_names[0]).standard_uncertainty
    # along a curved valley b moves by more than the slope at its bottom predicts
    return DragFinding.UNSEEN if is_parabolic and shift_b < u_b else DragFinding.OPEN


_OWN = ("period0_s", AMPLITUDE.key, TIME.key)
"""Parameters that each run with vanes has for itself."""
_COMMON = tuple(name for name in PAPER.names() if name not in _OWN)
"""Parameters of the contact, which the runs share."""
_AIR = len(_COMMON)
"""Place of d0 among the shared parameters; k follows."""
_DISAGREEMENT_CHANCE = 0.01
"""Chance of the runs' scatter below which they do not share a contact and a line."""


@dataclass(frozen=True, slots=True)
class VanedRun:
    """A run with its exact fit, and the area of its vanes.

    Points and fit are those of the second measurement (`refinement`). As detected, the first twenty
    half-cycles share an error of time, which no uncertainty of a turning point states: even on ground at rest
    n, gamma and the period would scatter 1.2 to 1.5 times as much as stated.
    """

    points: TurningPoints
    fit: FitResult
    area_m2: float


@dataclass(frozen=True, slots=True)
class MeasuredAir:
    """The drag without vanes, from runs with several areas."""

    drag_s: Estimate
    """d0."""
    drag_per_area_s_per_m2: Estimate
    """k."""
    contact: Mapping[str, Estimate]
    """The contact's parameters from all runs together."""
    run_drags_s: tuple[Estimate, ...]
    """The drag of each run with the contact of all."""
    residuals_s: tuple[float, ...]
    """These minus the line."""
    chi2: float
    """Rise of chi2 by one contact and one line over separate fits of the runs."""
    dof: int
    p_value: float
    """Probability of so large a rise if the runs share one contact and one line."""
    u_inflation: float
    """Factor by which the uncertainties are larger for that rise: the root of chi2/dof, at least 1. A run
    estimates a weak drive of the ground only to a factor of two, and its u in proportion; the rise shows this
    for all runs together. Over 42 sets of runs on weak ground the rms error is then 0.9 u of d0 and 1.05 u of
    k, but still 1.4 u of n and gamma."""

    @property
    def disagree(self) -> bool:
        """Whether the runs do not share one contact and one line."""
        return self.p_value < _DISAGREEMENT_CHANCE


class _RunModel(NamedTuple):
    """A run, its model with its noise, and the coordinates of its own fit."""

    run: VanedRun
    model: ExactModel
    coordinates: Floats
    scale: float
    """Factor on the residuals' scatter with which the drag has the uncertainty of the run's own fit."""

    @classmethod
    def of(cls, run: VanedRun, pendulum: PendulumOnBall) -> "_RunModel":
        model, coordinates = ExactModel.of(run.points, pendulum, run.fit)
        scale = max(1.0, run.fit.chi2_per_dof) ** 0.5
        scale *= float(run.fit.inflation[run.fit.names.index(DRAG.key)])
        return cls(run, model, coordinates, scale)


class _SharedParameters:
    """The parameters of all runs in units in which each is of the order of 1: those of the contact, `_COMMON`
    (ln b and gamma at the reference amplitude), d0 and k, then those of each run, `_OWN`."""

    def __init__(self, runs: Sequence[_RunModel]) -> None:
        self.runs, self.count = runs, _AIR + 2
        fits = [run.run.fit for run in runs]
        self.log_r = float(np.mean([np.log(fit.reference_rad) for fit in fits]))
        start = np.median([self._at_reference(fit) for fit in fits], axis=0).tolist()
        lines = np.array([_line(run.run.area_m2) for run in runs])
        drags = np.array([fit.estimate(DRAG.key).value for fit in fits])
        start += FactoredJacobian(lines).coefficients(drags).tolist()
        self.unit = np.abs(np.array(start))
        self.unit[self.unit == 0] = 1.0
        self.own = [np.array([tuple(fit.estimate(name)) for name in _OWN]).T for fit in fits]
        self.start = np.concatenate([np.array(start) / self.unit, np.zeros(len(_OWN) * len(runs))])

    def _at_reference(self, fit: FitResult) -> list[float]:
        known = fit.named_values
        known["b"] = float(np.log(known["b"]) + (known["p"] - 1) * self.log_r)
        known["gamma_pa"] *= float(np.exp(known["n"] * self.log_r))
        return [known[name] for name in _COMMON]

    def physical(self, shared: Floats) -> Floats:
        """SI values of the contact, then d0 and k."""
        values = shared * self.unit
        known = dict(zip(_COMMON, values[:_AIR].tolist(), strict=True))
        known["b"] = float(np.exp(known["b"] + (1 - known["p"]) * self.log_r))
        known["gamma_pa"] *= float(np.exp(-known["n"] * self.log_r))
        return np.array([*(known[name] for name in _COMMON), *values[_AIR:]])

    def __call__(self, values: Floats) -> tuple[Floats, Floats]:
        """Residuals of all runs, and their derivatives; NaN residuals where no pendulum would swing."""
        try:
            residuals, jacobians, _ = zip(
                *(self.of_run(values, k) for k in range(len(self.runs))), strict=True
            )
        except (DataError, np.linalg.LinAlgError):
            if values is self.start:
                raise
            residuals_at_start, jacobian = self(self.start)
            return np.full_like(residuals_at_start, np.nan), jacobian
        return np.concatenate(residuals), np.concatenate(jacobians)

    def own_places(self, number: int) -> slice:
        """Places of the parameters of one run alone."""
        first = self.count + len(_OWN) * number
        return slice(first, first + len(_OWN))

    def of_run(self, values: Floats, number: int) -> tuple[Floats, Floats, Floats]:
        """Residuals of one run, their derivatives, and those with respect to its own drag."""
        run, own = self.runs[number], self.own_places(number)
        shared, by_shared = differenced(self.physical)(values[: self.count])
        line = _line(run.run.area_m2)
        centre, size = self.own[number]
        known = dict(zip(_COMMON, shared[:_AIR].tolist(), strict=True))
        known[DRAG.key] = float(line @ shared[_AIR:])
        known |= dict(zip(_OWN, (centre + size * values[own]).tolist(), strict=True))
        coordinates = run.model.parametrisation.from_physical(known)
        residuals, jacobian = run.model.linearised_at(coordinates)(coordinates)
        by_physical = jacobian @ np.linalg.inv(run.model.parametrisation.physical(coordinates)[1])
        by_common, by_own, by_drag = (
            by_physical[:, [run.model.names.index(name) for name in names]]
            for names in (_COMMON, _OWN, (DRAG.key,))
        )
        by_values = np.zeros((len(residuals), len(values)))
        by_values[:, : self.count] = np.column_stack([by_common, by_drag * line]) @ by_shared
        by_values[:, own] = by_own * size
        return residuals / run.scale, by_values / run.scale, by_drag[:, 0] / run.scale


def _line(area_m2: float) -> Floats:
    """Derivatives of the drag with respect to d0 and k at an area."""
    return np.array([1.0, area_m2])


def air_of_vanes(runs: Sequence[VanedRun], pendulum: PendulumOnBall) -> MeasuredAir:
    """The drag of the pendulum itself, from runs with different vanes.

    Raises DataError for fewer than two areas, a fit that is not exact, has no drag or a prior of it, or no
    convergence.
    """
    from scipy.special import chdtrc

    _check(runs)
    models = [_RunModel.of(run, pendulum) for run in runs]
    shared = _SharedParameters(models)
    solution = solve(shared, shared.start, cost_tolerance=1e-9)
    if not solution.converged:
        raise DataError("no fit with one contact common to all runs converges; check which run differs")
    separate = sum(float(np.sum((run.model(run.coordinates)[0] / run.scale) ** 2)) for run in models)
    chi2 = max(0.0, 2 * solution.cost - separate)
    dof = len(runs) * (_AIR + 1) - shared.count
    u_inflation = max(1.0, float(np.sqrt(chi2 / dof)))
    covariance = covariance_of(solution.jacobian) * u_inflation**2
    values, by_shared = differenced(shared.physical)(solution.values[: shared.count])
    u = np.sqrt(np.diag(by_shared @ covariance[: shared.count, : shared.count] @ by_shared.T))
    estimates = [Estimate(*value_and_u) for value_and_u in zip(values.tolist(), u.tolist(), strict=True)]
    drags = [_drag_of(shared, solution.values, number) for number in range(len(runs))]
    return MeasuredAir(
        drag_s=estimates[_AIR],
        drag_per_area_s_per_m2=estimates[-1],
        contact=dict(zip(_COMMON, estimates[:_AIR], strict=True)),
        run_drags_s=tuple(drag for drag, _ in drags),
        residuals_s=tuple(residual for _, residual in drags),
        chi2=chi2,
        dof=dof,
        p_value=float(chdtrc(dof, chi2)),
        u_inflation=u_inflation,
    )


def _check(runs: Sequence[VanedRun]) -> None:
    if len({run.area_m2 for run in runs}) < 2:
        raise DataError("the drag is measured at two areas of vanes at least; make runs at three")
    for number, run in enumerate(runs, 1):
        if run.fit.method is not FitMethod.EXACT or not run.fit.has_drag:
            raise DataError(f"run {number} was fitted without a drag")
        if run.fit.evidence.drag_s is not None:
            raise DataError(
                f"run {number} was fitted with prior knowledge of the air and so measures no drag"
            )
        if not np.all(np.isfinite(np.diag(run.fit.covariance))):
            raise DataError(f"run {number} does not determine contact and drag; start higher, or shield it")


def _drag_of(shared: _SharedParameters, values: Floats, number: int) -> tuple[Estimate, float]:
    """The drag of one run with the contact of all, and how far it is off the line, by one linear step."""
    residuals, by_values, by_drag = shared.of_run(values, number)
    air = shared.physical(values[: shared.count])[_AIR:]
    on_line = float(_line(shared.runs[number].run.area_m2) @ air)
    solution = solve_terms(residuals, by_values[:, shared.own_places(number)], [Term("drag", by_drag)])
    residual = float(solution.values[0])
    return Estimate(on_line + residual, float(np.sqrt(solution.covariance[0, 0]))), residual
