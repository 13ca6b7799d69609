"""What a decay says of a linear drag, beside what is known of the air."""

from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, nan

from scipy.special import fdtrc, stdtrit

from processing.contact import ExpectedDrag, PendulumOnBall
from processing.contact.laws import DRAG
from processing.errors import DataError
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit.exact import fit_exact, fit_exact_with
from processing.fit.result import FitResult
from processing.fit_method import FitMethod
from processing.swing import TurningPoints

SIGNIFICANT = 0.003
"""Significance level of the test: the two-sided probability of three standard deviations."""
_LEAST = 1e-3
"""Information of the data over that of what is known, below which the data say nothing."""


class DragFinding(StrEnum):
    """What the data say of a linear drag, whatever is known of it beside them."""

    SEEN = "a linear drag is in the data"
    NEGATIVE = "the data ask for a negative drag"
    """It would drive the pendulum: the model lacks something else."""
    UNSEEN = "no linear drag is seen"
    """Its bound is below what would move b by its uncertainty."""
    OPEN = "the data do not tell a drag from friction"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drag:
    """Whether a linear drag is in the data, and what it does to b and c.

    Attributes
    ----------
    drag_s
        As the reported fit has it, with what is known of it; of a fit in vacuum, what the data say.
    of_data_s
        What decay and waveform say alone; not determined where they say nothing.
    known_s
        What was known of it otherwise: the air's estimate, or a measured value; None where it was left open.
    upper_95_s
        Bound of 95 % by the data alone; infinite where they set none.
    f_statistic, p_value
        Square of `of_data_s` over its uncertainty, and its probability if there is no drag.
    relative_shift_b, relative_shift_c
        Relative change of b and c from a fit without drag to one with it.
    of_air
        What the air is expected to exert; None where nobody asked.
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
        """In one line."""
        value, u = self.drag_s
        return (
            f"{self.finding}: drag {value:.3g} +- {u:.2g} s, F = {self.f_statistic:.3g} "
            f"(p = {self.p_value:.2g})"
        )


def drag_verdict(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> Drag:
    """What the data of an exact fit say of a drag; without one in the fit, it is fitted with it.

    Raises DataError for another method, or where a fit does not converge.
    """
    if fit.method is not FitMethod.EXACT:
        raise DataError("the drag verdict is of an exact fit")
    if fit.has_drag:
        with_drag, without = fit, fit_exact_with(points, pendulum, fit, drag=False)
    else:
        of_waveform = replace(fit.evidence, drag_s=None)
        with_drag = fit_exact(points, pendulum, drag=True, evidence=of_waveform, loss=fit.loss, near=fit)
        without = fit
    drag_s, known_s = with_drag.estimate(DRAG.key), with_drag.evidence.drag_s
    of_data = _without(drag_s, known_s)
    value, u = of_data
    f_statistic = (value / u) ** 2 if u < inf else 0.0
    p_value = float(fdtrc(1, with_drag.dof, f_statistic))
    upper_95 = max(0.0, value) + float(stdtrit(with_drag.dof, 0.95)) * u if u < inf else inf
    before, after = without.parameters, with_drag.parameters
    return Drag(
        drag_s=drag_s,
        of_data_s=of_data,
        known_s=known_s,
        upper_95_s=upper_95,
        f_statistic=f_statistic,
        p_value=p_value,
        relative_shift_b=after.b / before.b - 1 if before.b else nan,
        relative_shift_c=after.c / before.c - 1 if before.c else nan,
        finding=_finding(with_drag, value, p_value, upper_95),
    )


def _without(both: Estimate, known: Estimate | None) -> Estimate:
    """What the data say alone, of an estimate in which something was known beside them."""
    if known is None:
        return both
    weight, of_known = both.standard_uncertainty**-2, known.standard_uncertainty**-2
    own = weight - of_known
    if not own > _LEAST * of_known:
        return Estimate(nan, inf)
    return Estimate((weight * both.value - of_known * known.value) / own, own**-0.5)


def _finding(fit: FitResult, value: float, p_value: float, upper_95: float) -> DragFinding:
    if p_value < SIGNIFICANT:
        return DragFinding.SEEN if value > 0 else DragFinding.NEGATIVE
    b, drag = fit.names.index(fit.contact_names[0]), fit.names.index(DRAG.key)
    moved = upper_95 * abs(fit.covariance[b, drag] / fit.covariance[drag, drag])
    return DragFinding.UNSEEN if moved < fit.standard_uncertainty[b] else DragFinding.OPEN
