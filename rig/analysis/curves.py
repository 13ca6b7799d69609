"""Fitted laws at the turning points of a run, from results alone: nothing is fitted here."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.arrays import Floats, Ints
from processing.contact import (
    AMPLITUDE,
    TIME,
    PendulumOnBall,
    StatedLaw,
    decay_path,
    period,
    turning_points_of,
)
from processing.contact.laws import LAWS
from processing.decay_summary import Periods, full_periods
from processing.errors import DataError
from processing.fit import FitMethod
from processing.swing import TurningPoints
from rig.analysis.contact_results import Fit
from rig.analysis.results import RunResults

Array = NDArray[np.float64]
_FEWEST = 8
"""Periods for a smooth curve."""


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
        smooth_s=_smooth(amplitude, periods),
    )


def _smooth(amplitude: Array, periods: Periods) -> Array:
    """A cubic smoothing spline of the periods over ln A by generalised cross-validation."""
    # not at import: most commands draw no curves
    from scipy.interpolate import make_smoothing_spline

    x, first = np.unique(np.log(amplitude), return_index=True)
    if len(x) < _FEWEST:
        return np.full(len(amplitude), np.nan)
    spline = make_smoothing_spline(x, periods.period_s[first], 1.0 / periods.u_period_s[first] ** 2)
    return np.asarray(spline(np.log(amplitude)))


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


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelCurve:
    """What was measured at every turning point of a run, and what a fitted law says of it.

    Arrays (n,). The model is one free decay: on ground that moves the measured amplitudes and times wander
    about it by more than their uncertainties, which the fit allows for. NaN where a law has no value: Eqs. 5
    and 6 have no times. `index` is the number of the half-cycle.
    """

    index: Ints
    time_s: Floats
    u_time_s: Floats
    amplitude_rad: Floats
    u_amplitude_rad: Floats
    model_time_s: Floats
    model_amplitude_rad: Floats

    @property
    def amplitude_residual_rad(self) -> Floats:
        """Measured less model."""
        return self.amplitude_rad - self.model_amplitude_rad

    @property
    def time_residual_s(self) -> Floats:
        """Measured less model."""
        return self.time_s - self.model_time_s


def model_curves(run: RunResults, stated: StatedLaw | None = None) -> Mapping[str, ModelCurve]:
    """The curves of both fits, and of the laws that were compared; of a `stated` one under its name.

    Raises
    ------
    DataError
        The run was not fitted, or not with the law that is stated.
    """
    stored = run.turning_points
    curves = None if stored is None else curves_of(stored.points(), run)
    if stored is None or curves is None or run.pendulum is None:
        raise DataError(
            f"{run.record}: has no fit of the contact's laws: {run.problem or 'no pendulum is stated'}"
        )
    points = stored.points()
    unknown = np.full(len(points.index), np.nan)

    def curve(amplitude_rad: Floats, time_s: Floats) -> ModelCurve:
        return ModelCurve(
            index=points.index,
            time_s=points.time_s,
            u_time_s=points.u_time_s,
            amplitude_rad=points.amplitude,
            u_amplitude_rad=points.u_amplitude,
            model_time_s=time_s,
            model_amplitude_rad=amplitude_rad,
        )

    found = {
        FitMethod.EXACT.value: curve(curves.exact_rad, curves.exact_time_s),
        FitMethod.ASYMPTOTIC.value: curve(curves.asymptotic_rad, unknown),
    }
    compared = {} if run.laws is None else run.laws.laws
    if stated is not None and stated.name not in compared:
        raise DataError(
            f"{run.record}: was not fitted with the law {stated.name}; rig.fit(record, law=...) does"
        )
    like = {name: estimate.value for name, estimate in run.fits[FitMethod.EXACT].parameters.items()}
    for name, fit in compared.items():
        own = stated is not None and name == stated.name
        law = stated.of(points, run.pendulum, like) if own and stated is not None else LAWS.get(name)
        if law is None or not fit.parameters:
            continue
        values = {key: estimate.value for key, estimate in fit.parameters.items()}
        columns = law.columns(points, run.pendulum, tuple(values))
        parameters, _ = columns.map_parameters(columns.from_physical(values))
        swung = law.half_swing_map(parameters[:-2], points.index - points.index[0])
        period_s, first_s = parameters[-2:].tolist()
        found[name] = curve(swung.amplitude * columns.reference, first_s + period_s * swung.time)
    return found
