"""The fitted curves, drawn again from the parameters in results.json: nothing is fitted here."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.contact import (
    ContactParameters,
    PendulumOnBall,
    decay_path,
    path_nodes,
    period,
    turning_points_of,
)
from processing.contact.laws import PAPER
from processing.errors import DataError
from processing.fit import FitMethod, super_smooth
from processing.periods import full_periods
from processing.swing import TurningPoints
from rig.presentation import number

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


def parameters_of(fit: Mapping[str, Any]) -> ContactParameters:
    """The contact parameters of one fit in results.json."""
    drag = number(fit, "drag_s")
    values = {name: number(fit, name) for name in PAPER.names()}
    return ContactParameters(**values, drag_s=0.0 if math.isnan(drag) else drag)


def pendulum_of(run: Mapping[str, Any]) -> PendulumOnBall | None:
    """The pendulum that a run's laws were fitted with; None where there are no laws."""
    tree = run.get("pendulum")
    return PendulumOnBall(**tree) if tree else None


def curves_of(points: TurningPoints, run: Mapping[str, Any]) -> Curves | None:
    """The curves of one run; None where it was not fitted."""
    pendulum, fits = pendulum_of(run), run.get("fits") or {}
    if pendulum is None or not set(FitMethod) <= set(fits):
        return None
    exact_rad, exact_time_s = _exact(points, fits[FitMethod.EXACT], pendulum)
    periods = full_periods(points)
    at = periods.where
    asymptotic = parameters_of(fits[FitMethod.ASYMPTOTIC])
    amplitude = points.amplitude[at]
    printed = bool((run.get("settings") or {}).get("printed_055"))
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


def _exact(points: TurningPoints, fit: Mapping[str, Any], pendulum: PendulumOnBall) -> tuple[Array, Array]:
    """Amplitude and time of the half-swing map at the half-cycles of the data."""
    index = points.index - points.index[0]
    start = number(fit, "initial_amplitude_rad")
    amplitude, time = turning_points_of(parameters_of(fit), pendulum, start, int(index[-1]))
    return amplitude[index], time[index] + number(fit, "start_time_s")


def _asymptotic(points: TurningPoints, fit: Mapping[str, Any]) -> Array:
    """Eq. 5 (with its linear term where one was fitted) at the times of the data."""
    known = parameters_of(fit)
    mean = number(fit, "mean_period_s")
    s = (points.time_s - points.time_s[0]) * (4 / mean)
    # Eq. 5 in units of T/4: a linear drag enters its rate as this much of the amplitude
    linear = known.drag_s * math.pi**2 / (2 * mean)
    start = number(fit, "initial_amplitude_rad")
    path, _ = decay_path(s, start, known.b / (known.p + 1), known.p, known.c, linear, *path_nodes())
    return np.asarray(path, dtype=np.float64)
