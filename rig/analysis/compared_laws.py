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
from processing.fit import (
    FitMethod,
    FitResult,
    LawComparison,
    compare_laws,
    fit_model_free,
)
from processing.swing import TurningPoints
from processing.units import ARCSEC_RAD
from rig.analysis.results import (
    ComparedLaws,
    Fit,
    LawFit,
    LawMoments,
    ModelFreeMoments,
    RunResults,
)
from rig.analysis.series import AnalysedRun

NO_LAW: Final = "none"
_DISTINCT_LAWS_U, _MAX_PROPOSED_RUNS = 3.0, 100
"""Standard uncertainties by which two laws have to differ, and the most runs that are proposed for it."""


def chosen_laws(names: Sequence[str]) -> tuple[Law, ...]:
    """The default law and others of the registry by name; "all" stands for all laws, "none" for no further.

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
    made = [law.of(run.points, pendulum, like) if isinstance(law, StatedLaw) else law for law in laws]
    compared = compare_laws(run.points, pendulum, made, like=exact)
    free = _model_free_moments(run.points, pendulum, compared, exact)
    remaining = [trial.law.name for trial in compared.remaining]
    verdict = compared.text()
    if free is not None and len(remaining) > 1 and set(remaining[:2]) <= set(free.laws):
        verdict = compared.text(_remedy(free, remaining[0], remaining[1]))
    return replace(run, laws=ComparedLaws(_law_fits(compared), verdict, free))


def _remedy(free: ModelFreeMoments, one: str, other: str) -> str:
    """Largest difference of two laws in uncertainties of a run, and the number of runs that separate them."""
    by_moment = {
        "friction": np.abs(free.laws[one].friction_n_m - free.laws[other].friction_n_m) / free.u_friction_n_m,
        "elastic moment": np.abs(free.laws[one].elastic_n_m - free.laws[other].elastic_n_m)
        / free.u_elastic_n_m,
    }
    name, apart = max(by_moment.items(), key=lambda item: float(item[1].max()))
    most = float(apart.max())
    runs = np.ceil((_DISTINCT_LAWS_U / most) ** 2)
    where = f"they differ most in {name} at {free.phi_rad[int(apart.argmax())] / ARCSEC_RAD:.2g} arcsec"
    if not 2 <= runs <= _MAX_PROPOSED_RUNS:
        return f"{where}; a larger first amplitude or more runs may decide"
    return (
        f"{where}, by {most:.1f} u of one run: {runs:.0f} such runs, or a larger first amplitude, may decide"
    )


def _model_free_moments(
    points: TurningPoints, pendulum: PendulumOnBall, compared: LawComparison, exact: FitResult
) -> ModelFreeMoments | None:
    """Moments as splines, and those of the fitted laws in the same terms; None where splines have no fit."""
    try:
        free = fit_model_free(points, pendulum, like=exact)
    except DataError:
        return None
    assert free.fit.ground is not None  # of every exact fit
    found = free.moments()
    same = {}
    for trial in compared.trials:
        if trial.fit is not None:
            # none where splines cannot follow a law that does not fit
            with suppress(DataError):
                moments = free.moments_of_law(trial.fit, found.phi_rad)
                same[trial.law.name] = LawMoments(moments.friction_n_m, moments.elastic_n_m)
    return ModelFreeMoments(
        **{column.name: getattr(found, column.name) for column in fields(found)},
        ground_rad_per_s2_rthz=free.fit.ground.density_rad_per_s2_rthz.value,
        laws=same,
    )


def _law_fits(compared: LawComparison) -> dict[str, LawFit]:
    """The best fit of every law."""
    found = {}
    for trial in compared.trials:
        fit, law = trial.fit, trial.law
        one = LawFit(title=law.title, source=law.source, problem=trial.problem)
        if fit is not None and fit.ground is not None and fit.whiteness is not None:
            one = replace(
                one,
                parameters={name: fit.estimate(name) for name in fit.names},
                bic_above_best=compared.above_best(trial),
                ground_rad_per_s2_rthz=fit.ground.density_rad_per_s2_rthz.value,
                residuals_are_noise=not fit.whiteness.correlated,
                excluded=trial not in compared.remaining,
            )
        found[law.name] = one
    return found


_MIN_PERIODS = 8
"""Fewest periods for a smooth curve."""
_MIN_POINTS = 3


@dataclass(frozen=True, slots=True)
class ModelCurve:
    """Measured turning points of a run, and those of a fitted law, as arrays (n,).

    The model is one free decay: on ground that moves the measured amplitudes and times wander about it by
    more than their uncertainties, which the fit allows for. NaN where a law has no value: Eqs. 5 and 6 have
    no times. `index` is the number of the half-cycle.
    """

    index: Ints
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
    """The curves of both fits of a run, and its periods against the amplitude.

    `period_rad` are the amplitudes at which a full period was measured, `period_s` and `u_period_s` the
    measured periods; `asymptotic_period_s` and `exact_period_s` are those of the models there, `smooth_s`
    those of a smooth curve without a model.
    """

    asymptotic: ModelCurve
    exact: ModelCurve
    period_rad: Floats
    period_s: Floats
    u_period_s: Floats
    asymptotic_period_s: Floats
    exact_period_s: Floats
    smooth_s: Floats


def curves_of(run: RunResults) -> Curves | None:
    """The curves of one run; None where it was not fitted."""
    pendulum, fits, points = run.pendulum, run.fits, run.points
    if pendulum is None or not set(FitMethod) <= set(fits) or len(points) < _MIN_POINTS:
        return None
    exact = ModelCurve.of(points, *_exact(points, fits[FitMethod.EXACT], pendulum))
    unknown = np.full(len(points), np.nan)
    periods = full_periods(points)
    at = periods.points
    asymptotic = fits[FitMethod.ASYMPTOTIC].contact()
    amplitude = points.amplitude[at]
    return Curves(
        asymptotic=ModelCurve.of(points, _asymptotic(points, fits[FitMethod.ASYMPTOTIC]), unknown),
        exact=exact,
        period_rad=amplitude,
        period_s=periods.period_s,
        u_period_s=periods.u_period_s,
        asymptotic_period_s=period(amplitude, asymptotic, pendulum),
        exact_period_s=exact.model_time_s[at + 1] - exact.model_time_s[at - 1],
        smooth_s=_smooth(amplitude, periods),
    )


def _smooth(amplitude: Floats, periods: Periods) -> Floats:
    """A cubic smoothing spline of the periods over ln A by generalised cross-validation."""
    # not at import: most commands plot no curves
    from scipy.interpolate import make_smoothing_spline

    x, first = np.unique(np.log(amplitude), return_index=True)
    if len(x) < _MIN_PERIODS:
        return np.full(len(amplitude), np.nan)
    spline = make_smoothing_spline(x, periods.period_s[first], 1.0 / periods.u_period_s[first] ** 2)
    return np.asarray(spline(np.log(amplitude)))


def _exact(points: TurningPoints, fit: Fit, pendulum: PendulumOnBall) -> tuple[Floats, Floats]:
    """Amplitude and time of the half-swing map at the half-cycles of the data."""
    index = points.index - points.index[0]
    start = fit.estimate(AMPLITUDE.key).value
    amplitude, time = turning_points_of(fit.contact(), pendulum, start, int(index[-1]))
    return amplitude[index], time[index] + fit.estimate(TIME.key).value


def _asymptotic(points: TurningPoints, fit: Fit) -> Floats:
    """Eq. 5 (with its linear term where one was fitted) at the times of the data."""
    known = fit.contact()
    mean = fit.mean_period_s.value
    s = (points.time_s - points.time_s[0]) * (4 / mean)
    # coefficient of a linear drag in the rate of Eq. 5, in units of T/4
    linear = known.drag_s * math.pi**2 / (2 * mean)
    start = fit.estimate(AMPLITUDE.key).value
    path, _ = decay_path(s, start, known.b / (known.p + 1), known.p, known.c, linear)
    return np.asarray(path, dtype=np.float64)


def model_curves(run: RunResults, stated: StatedLaw | None = None) -> Mapping[str, ModelCurve]:
    """The curves of both fits and of the compared laws, by name; a `stated` law has its own name.

    Raises DataError for a run that was not fitted, or not with the stated law.
    """
    curves, points = curves_of(run), run.points
    if curves is None or run.pendulum is None:
        raise DataError(
            f"{run.record}: has no fit of the contact's laws: {run.problem or 'no pendulum is stated'}"
        )
    found = {FitMethod.EXACT.value: curves.exact, FitMethod.ASYMPTOTIC.value: curves.asymptotic}
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
        columns = law.coordinates(points, run.pendulum, tuple(values))
        parameters, _ = columns.map_parameters(columns.from_physical(values))
        swung = law.turning_points(parameters[:-2], points.index - points.index[0])
        period_s, first_s = parameters[-2:].tolist()
        found[name] = ModelCurve.of(
            points, swung.amplitude * columns.reference, first_s + period_s * swung.time
        )
    return found
