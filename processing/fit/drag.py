"""Test for a linear drag: comparison of the fits with and without it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import nan

from scipy.special import fdtrc

from processing.contact import ExpectedDrag, PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.exact import fit_exact, fit_exact_with
from processing.fit.ground import Noise
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.least_squares import Loss
from processing.swing import TurningPoints

SIGNIFICANT = 0.003
"""Significance level of the test: the two-sided probability of three standard deviations."""


class DragFinding(StrEnum):
    """What the comparison of the fits says of a linear drag."""

    SEEN = "a linear drag is in the data"
    NEGATIVE = "the data ask for a negative drag"
    """It would drive the pendulum: the model lacks something else."""
    UNSEEN = "no linear drag is seen"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drag:
    """Whether a linear drag is in the data: the exact fit with it against that without.

    Attributes
    ----------
    f_statistic, p_value
        Reduction of chi2 by the additional parameter divided by chi2/dof of the fit with drag, and its
        probability if there is no drag (F-test).
    aic_difference
        AIC with drag minus AIC without; negative values favour a drag.
    relative_shift_b, relative_shift_c
        Relative change of b and c when the drag is added.
    significant
        Both tests favour a drag, and its sign is dissipative.
    with_drag
        Parameters of the fit with drag.
    of_air
        What the air is expected to exert; None where nobody asked.
    """

    drag_s: Estimate = NOT_DETERMINED
    f_statistic: float = nan
    p_value: float = nan
    aic_difference: float = nan
    relative_shift_b: float = nan
    relative_shift_c: float = nan
    significant: bool = False
    text: str = ""
    with_drag: Mapping[str, Estimate] = field(default_factory=dict)
    of_air: ExpectedDrag | None = None

    @property
    def finding(self) -> DragFinding:
        """What the numbers say of it, which results of every version hold."""
        if self.significant:
            return DragFinding.SEEN
        is_negative = self.drag_s.value < 0 and self.p_value < SIGNIFICANT
        return DragFinding.NEGATIVE if is_negative else DragFinding.UNSEEN


def drag_verdict(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    *,
    loss: Loss = "linear",
    without: FitResult | None = None,
) -> Drag:
    """Fit with and without drag and compare; `without` is the fit without drag, if already made."""
    if without is None:
        without = fit_exact(points, pendulum, loss=loss)
    elif without.has_drag or without.method is not FitMethod.EXACT:
        raise DataError("the drag verdict compares with an exact fit without drag")
    with_drag = fit_exact(points, pendulum, drag=True, loss=loss, near=without)
    cost = without.cost
    if _noise(with_drag) != _noise(without):
        cost = fit_exact_with(points, pendulum, with_drag, drag=False).cost
    gain = 2 * (cost - with_drag.cost)
    f_statistic = max(gain, 0.0) / (2 * with_drag.cost / with_drag.dof)
    p_value = float(fdtrc(1, with_drag.dof, f_statistic))
    scale = max(1.0, 2 * with_drag.cost / with_drag.dof)
    aic_difference = 2.0 - gain / scale
    drag_s = with_drag.estimate(DRAG.key)
    before, after = without.parameters, with_drag.parameters
    found = Drag(
        drag_s=drag_s,
        f_statistic=f_statistic,
        p_value=p_value,
        aic_difference=aic_difference,
        relative_shift_b=after.b / before.b - 1 if before.b else nan,
        relative_shift_c=after.c / before.c - 1 if before.c else nan,
        significant=p_value < SIGNIFICANT and aic_difference < 0 and drag_s.value > 0,
        with_drag=with_drag.estimates(),
    )
    return replace(found, text=_text(found))


def _text(found: Drag) -> str:
    numbers = (
        f"drag {found.drag_s.value:.3g} +- {found.drag_s.standard_uncertainty:.2g} s, "
        f"F = {found.f_statistic:.3g} (p = {found.p_value:.2g}), AIC {found.aic_difference:+.3g}"
    )
    match found.finding:
        case DragFinding.SEEN:
            moved = f"b moves by {found.relative_shift_b:+.2%} and c by {found.relative_shift_c:+.2%}"
            numbers += f"; with it {moved}"
        case DragFinding.NEGATIVE:
            numbers = f"the model lacks something else: {numbers}"
    return f"{found.finding}: {numbers}"


def _noise(fit: FitResult) -> Noise | None:
    return None if fit.ground is None else fit.ground.noise
