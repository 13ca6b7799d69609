"""Whether the data ask for a drag that grows with the 3/2 power of the speed, as a boundary layer's does.

Beside the parameters of a fit one more is varied, by one step from where the fit is: in the decay such a drag
takes ``I A^1.5`` from the amplitude in a half-swing, I the integral of ``sin^2.5``, and within the swing it
makes a small third harmonic, which the exact path of the moment gives.
"""

from dataclasses import replace
from math import gamma, inf, nan, pi, sqrt

import numpy as np
from scipy.special import fdtrc

from processing.contact import STEEPER_DRAG, PendulumOnBall
from processing.estimate import Estimate
from processing.fit.exact_model import ExactModel
from processing.fit.exact_sensitivities import by_loss
from processing.fit.result import FitResult
from processing.fit.steeper import SteeperDrag
from processing.least_squares import covariance_of
from processing.number_text import plain
from processing.swing import TurningPoints

_UNIT = 1e-3
"""Size of the step over the weight's moment at the reference amplitude: that of air and friction."""
_LOST = sqrt(pi) * gamma(1.75) / gamma(2.25)
"""The integral of ``sin^2.5`` over half a swing."""


def steeper_drag(points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult) -> SteeperDrag:
    """What an exact fit with a linear drag leaves of a steeper one.

    Raises DataError where the law predicts no waveform.
    """
    model, columns = ExactModel.of(points, pendulum, fit)
    period0_s, period_s = fit.estimate("period0_s").value, fit.mean_period_s.value
    rate = 2 * pi / period0_s
    per_unit = _UNIT / (model.reference**0.5 * rate**1.5)
    # a softer pendulum is slower by the root of its stiffness
    lost = _UNIT * _LOST * sqrt(period_s / period0_s)
    more = by_loss(
        model, columns, lambda x: np.asarray(lost * np.maximum(x, 0.0) ** 1.5), {STEEPER_DRAG: per_unit}
    )
    residuals, jacobian = model(columns)
    both = np.column_stack([jacobian, more])
    covariance = covariance_of(both)
    step = -covariance @ (both.T @ residuals)
    scale = max(1.0, fit.chi2_per_dof) if fit.loss == "linear" else 1.0
    widened = 1.0 if fit.widened is None else float(np.max(fit.widened))
    u = sqrt(covariance[-1, -1] * scale) * widened
    if not 0 < u < inf:
        return SteeperDrag()
    moved = model.columns.physical(columns)[1] @ step[:-1]
    value, drag_s = float(step[-1]), fit.estimate("drag_s").value
    first = float(points.amplitude[0]) * rate
    return SteeperDrag(
        steeper=Estimate(value * per_unit, u * per_unit),
        p_value=float(fdtrc(1, fit.dof, (value / u) ** 2)),
        share=_share(value * per_unit * first**0.5, drag_s),
        relative_shift_b=float(moved[0] / fit.values[0]),
        shift_drag_s=float(moved[fit.names.index("drag_s")]),
        shift=tuple(moved.tolist()),
    )


def with_steeper_drag(fit: FitResult, found: SteeperDrag) -> FitResult:
    """The fit with what it was found to leave; where that is seen, uncertainties hold its effect.

    The values stay, and curves with them: the step is right to some tenths of itself.
    """
    if not found.seen:
        return replace(fit, steeper=found)
    shift = np.array(found.shift)
    widened = fit.covariance + np.outer(shift, shift)
    reading = fit.reading_covariance
    percent = float(f"{100 * found.relative_shift_b:.3g}")
    said = (
        f"a drag with the 3/2 power of the speed is in the data (chance without: {plain(found.p_value, 1)}); "
        f"with it b changes by {percent:+g} %, which its uncertainty covers"
    )
    ratio = np.sqrt(np.diag(widened) / np.diag(fit.covariance))
    return replace(
        fit,
        steeper=found,
        covariance=widened,
        widened=ratio if fit.widened is None else fit.widened * ratio,
        reading_covariance=None if reading is None else reading + np.outer(shift, shift),
        warnings=(*fit.warnings, said),
    )


def _share(steeper_s: float, drag_s: float) -> float:
    """Ratio of the works in a swing: the integrals of ``sin^2.5`` and ``sin^2`` over half of one."""
    return _LOST * steeper_s / (0.5 * pi * drag_s) if drag_s else nan
