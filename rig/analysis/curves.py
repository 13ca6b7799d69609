"""The fitted curves, drawn again from the parameters in results.json: nothing is fitted here."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.contact import (
    AMPLITUDE,
    TIME,
    PendulumOnBall,
    decay_path,
    period,
    turning_points_of,
)
from processing.errors import DataError
from processing.fit import FitMethod, super_smooth
from processing.periods import full_periods
from processing.swing import TurningPoints
from rig.analysis.contact_results import Fit
from rig.analysis.results import RunResults

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curves:
    """Model values at the turning points of a run, in rad and s; NaN where a model has none.

    `period_rad` are the amplitudes at which a full period was measured, `period_s` and
    `u_period_s` the periods; the models' periods stand beside them, `smooth_s` is the
    model-free one.
    """

    asymptotic_rad: Array
    exact_rad: Array
    exact_time_s: Array
    period_rad: Array
    period_time_s: Array
    period_s: Array
    u_period_s: Array
    asymptotic_period_s: Array
    exact_period_s: Array
    smooth_s: Array


def curves_of(points: TurningPoints, run: RunResults) -> Curves | None:
    """The curves of one run; None where it was not fitted."""
    pendulum, fits = run.pendulum, run.fits
    if pendulum is None or not set(FitMethod) <= set(fits):
        return None
    exact_rad, exact_time_s = _exact(points, fits[FitMethod.EXACT], pendulum)
    periods = full_periods(points)
    at = periods.where
    asymptotic = fits[FitMethod.ASYMPTOTIC].contact()
    amplitude = points.amplitude[at]
    printed = bool(run.settings.get("printed_055"))
    try:
        smooth = super_smooth(amplitude, periods.period_s, periods.u_period_s)
    except DataError:
        smooth = np.full(len(at), np.nan)
    return Curves(
        asymptotic_rad=_asymptotic(points, fits[FitMethod.ASYMPTOTIC]),
        exact_rad=exact_rad,
        exact_time_s=exact_time_s,
        period_rad=amplitude,
        period_time_s=points.time_s[at],
        period_s=periods.period_s,
        u_period_s=periods.u_period_s,
        asymptotic_period_s=period(amplitude, asymptotic, pendulum, printed_curvature=printed),
        exact_period_s=exact_time_s[at + 1] - exact_time_s[at - 1],
        smooth_s=smooth,
    )


def _exact(points: TurningPoints, fit: Fit, pendulum: PendulumOnBall) -> tuple[Array, Array]:
    """Amplitude and time of the half-swing map at the half-cycles of the data."""
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time = turning_points_of(fit.contact(), pendulum, start, int(index[-1]))
    return amplitude[index], time[index] + fit.estimate(TIME.key).value


def _asymptotic(points: TurningPoints, fit: Fit) -> Array:
    """Eq. 5 (with its linear term where one was fitted) at the times of the data."""
    known = fit.contact()
    mean = fit.mean_period_s.value
    s = (points.time_s - points.time_s[0]) * (4 / mean)
    # Eq. 5 in units of T/4: a linear drag enters its rate as this much of the amplitude
    linear = known.drag_s * math.pi**2 / (2 * mean)
    start = fit.estimate(AMPLITUDE.key).value
    path, _ = decay_path(s, start, known.b / (known.p + 1), known.p, known.c, linear)
    return np.asarray(path, dtype=np.float64)
