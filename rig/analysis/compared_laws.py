"""Comparison of laws by fits to the turning points of a run, and the model curves of its fits."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Final, Self

import numpy as np

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
from processing.contact.laws import DEFAULT_LAW, LAWS, Law
from processing.decay_summary import Periods, full_periods
from processing.errors import ConfigurationError, DataError
from processing.fit import FitMethod, FitResult, LawComparison, compare_laws, fit_model_free
from processing.swing import TurningPoints
from processing.units import ARCSEC_RAD
from rig.analysis.results import ComparedLaws, LawFit, LawMoments, ModelFreeMoments, RunResults
from rig.analysis.series import AnalysedRun

NO_LAW: Final = "none"
"""Name that stands for no law beside the default one."""
_DISTINCT_LAWS_U, _MAX_PROPOSED_RUNS = 3.0, 100
"""Standard uncertainties by which two laws have to differ, and the most runs that are proposed for it."""


def chosen_laws(names: Sequence[str]) -> tuple[Law, ...]:
    """The default law and named laws of the registry; "all" stands for all laws, "none" for no other law.

    Raises ConfigurationError for a name that no law has.
    """
    for name in names:
        if name not in ("all", NO_LAW, *LAWS):
            raise ConfigurationError(
                f"--law {name}: no such law; there are {', '.join(LAWS)}, {NO_LAW} and all"
            )
    return tuple(law for law in LAWS.values() if law is DEFAULT_LAW or {law.name, "all"} & set(names))


def with_laws(run: AnalysedRun, laws: Iterable[Law | StatedLaw]) -> AnalysedRun:
    """The run with these laws fitted to its turning points and compared; unchanged where it has no fit."""
    exact, pendulum = run.fitted.get(FitMethod.EXACT), run.pendulum
    if exact is None or pendulum is None:
        return run
    like = dict(zip(exact.names, exact.values.tolist(), strict=True))
    started = [law.of(run.points, pendulum, like) if isinstance(law, StatedLaw) else law for law in laws]
    compared = compare_laws(run.points, pendulum, started, like=exact)
    free = _model_free_moments(run.points, pendulum, compared, exact)
    best = [trial.law.name for trial in compared.remaining][:2]
    verdict = compared.text()
    if free is not None and len(best) > 1 and set(best) <= set(free.laws):
        verdict = compared.text(_remedy(free, *best))
    return replace(run, laws=ComparedLaws(_law_fits(compared), verdict, free))


def _remedy(free: ModelFreeMoments, first_law: str, second_law: str) -> str:
    """Largest difference of two laws in uncertainties of a run, and the number of runs that separate them."""
    first, second = free.laws[first_law], free.laws[second_law]
    distances_u = {
        "friction": np.abs(first.friction_n_m - second.friction_n_m) / free.u_friction_n_m,
        "elastic moment": np.abs(first.elastic_n_m - second.elastic_n_m) / free.u_elastic_n_m,
    }
    name, distance_u = max(distances_u.items(), key=lambda item: float(item[1].max()))
    largest_u = float(distance_u.max())
    difference = f"they differ most in {name} at {free.phi_rad[distance_u.argmax()] / ARCSEC_RAD:.2g} arcsec"
    runs = math.ceil((_DISTINCT_LAWS_U / largest_u) ** 2) if largest_u > 0 else 0
    if not 2 <= runs <= _MAX_PROPOSED_RUNS:
        return f"{difference}; a larger first amplitude or more runs may decide"
    return (
        f"{difference}, by {largest_u:.1f} u of one run: {runs} such runs, or a larger first amplitude, "
        "may decide"
    )


def _model_free_moments(
    points: TurningPoints, pendulum: PendulumOnBall, compared: LawComparison, exact: FitResult
) -> ModelFreeMoments | None:
    """Moments as splines, and those of the fitted laws; None where splines have no fit."""
    try:
        free = fit_model_free(points, pendulum, like=exact)
    except DataError:
        return None
    assert free.fit.ground is not None  # of every exact fit
    spline_moments = free.moments()
    laws = {}
    for trial in compared.trials:
        if trial.fit is not None:
            # splines may not be able to follow a law that does not fit
            with suppress(DataError):
                moments = free.moments_of_law(trial.fit, spline_moments.phi_rad)
                laws[trial.law.name] = LawMoments(moments.friction_n_m, moments.elastic_n_m)
    return ModelFreeMoments(
        **{item.name: getattr(spline_moments, item.name) for item in fields(spline_moments)},
        ground_rad_per_s2_rthz=free.fit.ground.density_rad_per_s2_rthz.value,
        laws=laws,
    )


def _law_fits(compared: LawComparison) -> dict[str, LawFit]:
    """The best fit of every law."""
    fits = {}
    for trial in compared.trials:
        fit, law = trial.fit, trial.law
        fits[law.name] = LawFit(title=law.title, source=law.source, problem=trial.problem)
        if fit is not None and fit.ground is not None and fit.whiteness is not None:
            fits[law.name] = replace(
                fits[law.name],
                parameters=fit.estimates(),
                bic_above_best=compared.above_best(trial),
                ground_rad_per_s2_rthz=fit.ground.density_rad_per_s2_rthz.value,
                residuals_are_noise=not fit.whiteness.correlated,
                excluded=trial not in compared.remaining,
            )
    return fits


_MIN_PERIODS = 8
"""Fewest periods for a smooth curve."""
_MAX_WEIGHT = 1e4
"""Weight of the best period, with which the smoothing lies well within the bounds of its search."""
_MIN_POINTS = 3
"""Fewest turning points of a run with curves."""


@dataclass(frozen=True, slots=True)
class ModelCurve:
    """Measured turning points of a run, and those of a fitted law, as arrays (n,).

    The model is one free decay: on ground that moves the measured amplitudes and times wander about it by
    more than their uncertainties, which the fit allows for. NaN where a law has no value: Eqs. 5 and 6 have
    no times.
    """

    index: Ints
    """Numbers of the half-cycles."""
    time_s: Floats
    u_time_s: Floats
    amplitude_rad: Floats
    u_amplitude_rad: Floats
    model_time_s: Floats
    model_amplitude_rad: Floats

    @classmethod
    def of(cls, points: TurningPoints, amplitude_rad: Floats, time_s: Floats) -> Self:
        """Turning points, and a model's amplitudes and times of them."""
        measured = points.index, points.time_s, points.u_time_s, points.amplitude, points.u_amplitude
        return cls(*measured, time_s, amplitude_rad)

    @property
    def amplitude_residual_rad(self) -> Floats:
        """Measured less model."""
        return self.amplitude_rad - self.model_amplitude_rad

    @property
    def time_residual_s(self) -> Floats:
        """Measured less model."""
        return self.time_s - self.model_time_s


@dataclass(frozen=True)
class Curves:
    """The curves of both fits of a run, and its periods against the amplitude, as arrays (n,)."""

    asymptotic: ModelCurve
    exact: ModelCurve
    period_rad: Floats
    """Amplitudes at which a full period was measured."""
    period_s: Floats
    """The measured periods."""
    u_period_s: Floats
    asymptotic_period_s: Floats
    """Periods of the asymptotic model at these amplitudes."""
    exact_period_s: Floats
    """Periods of the exact model at these amplitudes."""
    smooth_s: Floats
    """Periods of a smooth curve without a model."""


def curves_of(run: RunResults) -> Curves | None:
    """The curves of one run; None where it was not fitted."""
    pendulum, fits, points = run.pendulum, run.fits, run.points
    if pendulum is None or not set(FitMethod) <= set(fits) or len(points) < _MIN_POINTS:
        return None
    asymptotic, exact = fits[FitMethod.ASYMPTOTIC], fits[FitMethod.EXACT]
    # the half-swing map at the half-cycles of the data
    index, start_rad = points.index - points.index[0], exact.estimate(AMPLITUDE.key).value
    path_rad, path_s = turning_points_of(exact.contact(), pendulum, start_rad, int(index[-1]))
    exact_s = path_s[index] + exact.estimate(TIME.key).value
    # Eq. 5, with its linear term where one was fitted, at the times of the data
    contact, period_s = asymptotic.contact(), asymptotic.mean_period_s.value
    quarters = (points.time_s - points.time_s[0]) * (4 / period_s)
    linear = contact.drag_s * math.pi**2 / (2 * period_s)
    start_rad, friction = asymptotic.estimate(AMPLITUDE.key).value, contact.b / (contact.p + 1)
    asymptotic_rad, _ = decay_path(quarters, start_rad, friction, contact.p, contact.c, linear)
    periods = full_periods(points)
    amplitude = points.amplitude[periods.points]
    return Curves(
        asymptotic=ModelCurve.of(points, np.asarray(asymptotic_rad), np.full(len(points), np.nan)),
        exact=ModelCurve.of(points, path_rad[index], exact_s),
        period_rad=amplitude,
        period_s=periods.period_s,
        u_period_s=periods.u_period_s,
        asymptotic_period_s=period(amplitude, contact, pendulum),
        exact_period_s=exact_s[periods.points + 1] - exact_s[periods.points - 1],
        smooth_s=_smooth(amplitude, periods),
    )


def _smooth(amplitude: Floats, periods: Periods) -> Floats:
    """A cubic smoothing spline of the periods over ln A by generalised cross-validation."""
    # not at import: most commands plot no curves
    from scipy.interpolate import make_smoothing_spline

    x, first = np.unique(np.log(amplitude), return_index=True)
    if len(x) < _MIN_PERIODS:
        return np.full(len(amplitude), np.nan)
    u_s = periods.u_period_s[first]
    # scipy's search ends at fixed bounds: with weights of 1e10 per s² it smooths nothing
    spline = make_smoothing_spline(x, periods.period_s[first], _MAX_WEIGHT * (u_s.min() / u_s) ** 2)
    return np.asarray(spline(np.log(amplitude)))


def model_curves(run: RunResults, stated: StatedLaw | None = None) -> Mapping[str, ModelCurve]:
    """The curves of both fits and of the compared laws, by name; a `stated` law has its own name.

    Raises DataError for a run that was not fitted at all, or not with the stated law.
    """
    curves, points = curves_of(run), run.points
    if curves is None or run.pendulum is None:
        raise DataError(
            f"{run.record}: has no fit of the contact's laws: {run.problem or 'no pendulum is stated'}"
        )
    by_name = {FitMethod.EXACT.value: curves.exact, FitMethod.ASYMPTOTIC.value: curves.asymptotic}
    compared = {} if run.laws is None else run.laws.laws
    if stated is not None and stated.name not in compared:
        raise DataError(
            f"{run.record}: was not fitted with the law {stated.name}; rig.fit(record, law=...) does"
        )
    like = {name: estimate.value for name, estimate in run.fits[FitMethod.EXACT].parameters.items()}
    for name, fit in compared.items():
        law = LAWS.get(name)
        if stated is not None and name == stated.name:
            law = stated.of(points, run.pendulum, like)
        if law is None or not fit.parameters:
            continue
        values = {key: estimate.value for key, estimate in fit.parameters.items()}
        coordinates = law.coordinates(points, run.pendulum, tuple(values))
        parameters, _ = coordinates.map_parameters(coordinates.from_physical(values))
        path = law.turning_points(parameters[:-2], points.index - points.index[0])
        period_s, first_s = parameters[-2:].tolist()
        by_name[name] = ModelCurve.of(
            points, path.amplitude * coordinates.reference, first_s + period_s * path.time
        )
    return by_name
