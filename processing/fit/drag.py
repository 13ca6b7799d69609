"""Test for a linear drag: comparison of the fits with and without it."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from scipy.special import fdtrc

from processing.contact import PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import Estimate
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

    SEEN = "seen"
    NEGATIVE = "negative"
    """The data ask for one that would drive the pendulum: the model lacks something else."""
    UNSEEN = "unseen"

    @classmethod
    def of(cls, drag_s: Estimate, p_value: float, *, significant: bool) -> Self:
        """From the numbers, which results of every version hold."""
        if significant:
            return cls("seen")
        return cls("negative" if drag_s.value < 0 and p_value < SIGNIFICANT else "unseen")

    @property
    def text(self) -> str:
        """The finding in words."""
        return {
            DragFinding.SEEN: "a linear drag is in the data",
            DragFinding.NEGATIVE: "the data ask for a negative drag",
            DragFinding.UNSEEN: "no linear drag is seen",
        }[self]


@dataclass(frozen=True)
class DragVerdict:
    """Both fits and the tests that compare them.

    Attributes
    ----------
    f_statistic, p_value
        Reduction of chi2 by the additional parameter divided by chi2/dof of the fit with drag, and its
        probability if there is no drag (F-test).
    aic_difference
        AIC with drag minus AIC without; negative values favour a drag.
    shift_b, shift_c
        Relative change of b and c when the drag is added.
    significant
        Both tests favour a drag, and its sign is dissipative.
    """

    without: FitResult
    with_drag: FitResult
    drag_s: Estimate
    f_statistic: float
    p_value: float
    aic_difference: float
    shift_b: float
    shift_c: float
    significant: bool

    @property
    def preferred(self) -> FitResult:
        return self.with_drag if self.significant else self.without

    @property
    def finding(self) -> DragFinding:
        return DragFinding.of(self.drag_s, self.p_value, significant=self.significant)

    @property
    def text(self) -> str:
        numbers = (
            f"drag {self.drag_s.value:.3g} +- {self.drag_s.standard_uncertainty:.2g} s, "
            f"F = {self.f_statistic:.3g} (p = {self.p_value:.2g}), AIC {self.aic_difference:+.3g}"
        )
        match self.finding:
            case DragFinding.SEEN:
                numbers += f"; with it b moves by {self.shift_b:+.2%} and c by {self.shift_c:+.2%}"
            case DragFinding.NEGATIVE:
                numbers = f"the model lacks something else: {numbers}"
        return f"{self.finding.text}: {numbers}"


def drag_verdict(
    points: TurningPoints,
    pendulum: PendulumOnBall | None,
    *,
    loss: Loss = "linear",
    without: FitResult | None = None,
) -> DragVerdict:
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
    return DragVerdict(
        without=without,
        with_drag=with_drag,
        drag_s=drag_s,
        f_statistic=f_statistic,
        p_value=p_value,
        aic_difference=aic_difference,
        shift_b=after.b / before.b - 1 if before.b else float("nan"),
        shift_c=after.c / before.c - 1 if before.c else float("nan"),
        significant=p_value < SIGNIFICANT and aic_difference < 0 and drag_s.value > 0,
    )


def _noise(fit: FitResult) -> Noise | None:
    return None if fit.ground is None else fit.ground.noise
