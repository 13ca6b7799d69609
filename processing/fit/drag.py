"""The linear drag of the air in a decay, by its data alone."""

from dataclasses import dataclass, replace
from enum import StrEnum
from math import hypot, inf, isnan, nan, sqrt
from typing import NamedTuple

import numpy as np

from processing.contact import ExpectedDrag, PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate, FitMethod
from processing.fit.determination import profile_likelihood
from processing.fit.evidence import Evidence
from processing.fit.exact import fit_exact, fit_exact_with, start_near, starts_of
from processing.fit.exact_model import ExactModel
from processing.fit.result import FitResult
from processing.least_squares import FactoredJacobian, Loss, propagate
from processing.number_text import plain, with_uncertainty
from processing.swing import TurningPoints

SIGNIFICANT = 0.003
"""Significance level of the test: the two-sided probability of three standard deviations."""
_FIT_BELOW_CHANCE = 0.05
"""Probability by chance of the linear step's F below which a fit with a drag is made, whatever u(b) is."""
_MAX_TEST_DIFFERENCE = 0.2
"""Difference of the drag's two tests, by curvature and by likelihood, up to which chi2 is a parabola."""
_TWO_SIDED = 0.90
"""Coverage of an interval whose upper end is a bound of 95 %."""
_CONTRADICTS_U = 5.0
"""Distance of a drag above what is known of it, in standard uncertainties, that contradicts this."""


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
    """Whether a linear drag is in the data, and what it does to b and c.

    Attributes
    ----------
    drag_s
        Drag of the reported fit, with prior knowledge; for a fit in vacuum, from the data.
    of_data_s
        Drag from decay and waveform alone; not determined where a drag could be all of the friction.
        Where chi2 is not a parabola, the uncertainty agrees with the test:
        infinite if the decay is described equally well without a drag.
    known_s
        Prior knowledge: the estimate for air, or a measured value; None if left open.
    upper_95_s
        Bound of 95 % from the data alone; infinite if they set none.
    f_statistic, p_value
        Rise of chi2 without the drag, over the scatter, and its probability if there is no drag.
    relative_shift_b, relative_shift_c
        Relative change of b and c from a fit without drag to one with it.
    of_air
        The drag expected of the air; None if not requested.
    """

    drag_s: Estimate = NOT_DETERMINED
    of_data_s: Estimate = NOT_DETERMINED
    known_s: Estimate | None = None
    upper_95_s: float = inf
    f_statistic: float = nan
    p_value: float = nan
    relative_shift_b: float = nan
    relative_shift_c: float = nan
    finding: DragFinding = DragFinding.OPEN
    of_air: ExpectedDrag | None = None

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


class ContradictedDrag(NamedTuple):
    """What is known of the drag, and the fit by the data alone that contradicts it."""

    known_s: Estimate
    fit: FitResult

    @property
    def text(self) -> str:
        """Warning in one line."""
        known, found = (with_uncertainty(*one) for one in (self.known_s, self.fit.estimate(DRAG.key)))
        return (
            f"the data contradict what is known of the drag, {known} s: alone they give {found} s, and are "
            "fitted alone; state fit.drag = 'open', or look for what else takes energy as a drag does"
        )


def contradicted_drag(
    points: TurningPoints,
    pendulum: PendulumOnBall,
    evidence: Evidence,
    *,
    loss: Loss,
    averaged: bool,
    near: FitResult | None,
) -> ContradictedDrag | None:
    """The fit by the data alone where they show a far larger drag than is known; None elsewhere.

    Held near a drag that is far too small, a fit takes the rest of the loss for a drive of the ground, or
    ends nowhere. That the data ask for less is no evidence against what is known: a law that is wrong does
    so. `near` is an earlier fit of nearly the same points, else the start values tell whether to look.
    """
    known_s = evidence.drag_s
    if known_s is None:
        return None
    evidence = replace(evidence, drag_s=None)
    try:
        if near is not None and near.evidence.drag_s is None:
            return ContradictedDrag(known_s, near)
        if near is not None:
            drag_s = near.estimate(DRAG.key).value
        else:
            model = ExactModel(points, pendulum, drag=True, evidence=evidence)
            drag_s = model.values(next(starts_of(model)))[DRAG.key]
        if drag_s - known_s.value < _CONTRADICTS_U * known_s.standard_uncertainty:
            return None
        fit = fit_exact(
            points, pendulum, drag=True, evidence=evidence, loss=loss, averaged=averaged, near=near
        )
    except DataError:
        return None
    value, u = fit.estimate(DRAG.key)
    contradicts = value - known_s.value > _CONTRADICTS_U * hypot(u, known_s.standard_uncertainty)
    return ContradictedDrag(known_s, fit) if contradicts else None


def drag_verdict(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> Drag:
    """The linear drag by the data of an exact fit; a fit without drag is repeated with one.

    Where a drag could be all of the friction, no such fit is made: it would end anywhere along a valley.
    Value, bound and shifts are not determined then.

    Raises DataError for another method, or where a fit does not converge.
    """
    if fit.method is not FitMethod.EXACT:
        raise DataError("the drag verdict is of an exact fit")
    if not fit.has_drag and (inseparable := _inseparable(points, pendulum, fit)) is not None:
        return inseparable
    of_waveform, known_s = replace(fit.evidence, drag_s=None), fit.evidence.drag_s
    if fit.has_drag:
        like = replace(fit, evidence=of_waveform)
        alone = fit if known_s is None else fit_exact_with(points, pendulum, like, drag=True)
        before, after = fit_exact_with(points, pendulum, like, drag=False), fit
    else:
        # the noise of a fit without drag may hold the drag that it lacks
        alone = fit_exact(points, pendulum, drag=True, evidence=of_waveform, loss=fit.loss, near=fit)
        before, after, like = fit, alone, alone
    without = before if fit.has_drag else fit_exact_with(points, pendulum, like, drag=False)
    test = _test(points, pendulum, _at_least_as_uncertain(alone, fit), without)
    after_s = after.estimate(DRAG.key)
    return Drag(
        drag_s=test.of_data_s if after.evidence.drag_s is None else after_s,
        of_data_s=test.of_data_s,
        known_s=known_s if fit.has_drag else None,
        upper_95_s=test.upper_95_s,
        f_statistic=test.f_statistic,
        p_value=test.p_value,
        relative_shift_b=_shift(before.parameters.b, after.parameters.b),
        relative_shift_c=_shift(before.parameters.c, after.parameters.c),
        finding=_finding(alone, fit, test),
    )


def _inseparable(points: TurningPoints, pendulum: PendulumOnBall, fit: FitResult) -> Drag | None:
    """The verdict on a decay that cannot tell a drag from friction at all; None where fits must decide.

    By one linear step from the fit without a drag: F is likely by chance, and with a drag b is as uncertain
    as it is large.
    """
    from scipy.special import fdtrc

    model = ExactModel(points.first(fit.half_cycles), pendulum, law=fit.law, drag=True, evidence=fit.evidence)
    start = next(start_near(model, fit), None)
    if start is None or fit.ground is None:
        return None
    here = model.on_ground(start, model.noise_of(fit), fit.ground.measurement_scale).linearised_at(start)
    residuals, jacobian = here(start)
    step, by = FactoredJacobian(jacobian), model.columns.physical(start)[1]
    scale = max(1.0, fit.chi2_per_dof) if fit.loss == "linear" else 1.0
    left = step.left(residuals)
    f_statistic = max(0.0, float(residuals @ residuals - left @ left)) / scale
    p_value = float(fdtrc(1, fit.dof - 1, f_statistic))
    b = model.names.index(fit.contact_names[0])
    u_b = sqrt(propagate(by, step.covariance())[b, b] * scale)
    if p_value < _FIT_BELOW_CHANCE or u_b < abs(fit.estimate(fit.contact_names[0]).value):
        return None
    return Drag(f_statistic=f_statistic, p_value=p_value)


class _Test(NamedTuple):
    """The drag by the data alone: value and uncertainty, a bound, and the test against no drag."""

    of_data_s: Estimate
    upper_95_s: float
    f_statistic: float
    p_value: float
    parabolic: bool


def _test(points: TurningPoints, pendulum: PendulumOnBall, alone: FitResult, without: FitResult) -> _Test:
    """The test by the rise of chi2 where the drag is left out, and an uncertainty that agrees with it.

    Friction and drag can replace each other along a curved valley, whose length does not follow from the
    curvature at its bottom. There the bound is the profile likelihood's.
    """
    from scipy.special import fdtrc, stdtrit

    value, u = alone.estimate(DRAG.key)
    scale = max(1.0, alone.chi2_per_dof) if alone.loss == "linear" else 1.0
    if alone.u_inflation is not None:
        scale *= float(alone.u_inflation[alone.names.index(DRAG.key)]) ** 2
    f_statistic = max(0.0, 2 * (without.cost - alone.cost)) / scale
    p_value = float(fdtrc(1, alone.dof, f_statistic))
    upper_95 = max(0.0, value) + float(stdtrit(alone.dof, 0.95)) * u if u < inf else inf
    by_curvature = abs(value) / u if u > 0 else inf
    parabolic = abs(sqrt(f_statistic) - by_curvature) <= _MAX_TEST_DIFFERENCE * max(1.0, by_curvature)
    if not parabolic:
        u = max(u, abs(value) / sqrt(f_statistic)) if f_statistic > 0 else inf
        found = profile_likelihood(points, pendulum, alone, DRAG.key, coverage=_TWO_SIDED)
        upper_95 = inf if isnan(found.upper) else found.upper
    return _Test(Estimate(value, u), upper_95, f_statistic, p_value, parabolic)


def _at_least_as_uncertain(alone: FitResult, fit: FitResult) -> FitResult:
    """The fit of the data alone, its uncertainties enlarged at least as much as those of the reported fit."""
    if alone is fit or fit.u_inflation is None or len(fit.u_inflation) != len(alone.names):
        return alone
    u_inflation = (
        fit.u_inflation if alone.u_inflation is None else np.maximum(fit.u_inflation, alone.u_inflation)
    )
    before = np.ones_like(u_inflation) if alone.u_inflation is None else alone.u_inflation
    more = np.outer(u_inflation / before, u_inflation / before)
    return replace(alone, u_inflation=u_inflation, covariance=alone.covariance * more)


def _shift(before: float, after: float) -> float:
    return after / before - 1 if before else nan


def _finding(alone: FitResult, reported: FitResult, test: _Test) -> DragFinding:
    """The finding by the reported uncertainty of b, which in vacuum is that of a fit without a drag."""
    if test.p_value < SIGNIFICANT:
        return DragFinding.SEEN if test.of_data_s.value > 0 else DragFinding.NEGATIVE
    fit = reported if reported.has_drag else alone
    b, drag = fit.names.index(fit.contact_names[0]), fit.names.index(DRAG.key)
    moved = test.upper_95_s * abs(fit.covariance[b, drag] / fit.covariance[drag, drag])
    u_b = reported.estimate(reported.contact_names[0]).standard_uncertainty
    # along a curved valley b moves by more than the slope at its bottom predicts
    return DragFinding.UNSEEN if test.parabolic and moved < u_b else DragFinding.OPEN
