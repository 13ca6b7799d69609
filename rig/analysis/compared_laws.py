"""Which laws describe a run: fits of several to its turning points, and the table for the terminal."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from processing.contact import PendulumOnBall, StatedLaw
from processing.contact.laws import DEFAULT_LAW, LAWS, Law
from processing.errors import ConfigurationError, DataError
from processing.fit import (
    CONTRADICTED,
    FitMethod,
    FitResult,
    LawComparison,
    compare_laws,
    fit_without_law,
    predicted_harmonics,
    waveform_chances,
)
from processing.swing import ORDERS, HarmonicClass, TurningPoints, harmonic_classes
from processing.units import ARCSEC_RAD
from rig.analysis.contact_results import (
    ComparedLaws,
    Harmonics,
    LawFit,
    LawMoments,
    MomentsWithoutLaw,
    WaveformClass,
)
from rig.analysis.series import AnalysedRun

NO_LAW: Final = "none"
_TELLING, _MOST_RUNS = 3.0, 100
"""Distance in standard uncertainties that tells two laws apart, and the most runs that are proposed."""


def chosen_laws(names: Sequence[str]) -> tuple[Law, ...]:
    """The default law and others of the registry by name; "all" means all, "none" none but those beside it.

    Raises
    ------
    ConfigurationError
        There is no law of that name.
    """
    for name in names:
        if name not in ("all", NO_LAW, *LAWS):
            raise ConfigurationError(
                f"--law {name}: no such law; there are {', '.join(LAWS)}, {NO_LAW} and all"
            )
    return tuple(law for law in LAWS.values() if law is DEFAULT_LAW or {law.name, "all"} & set(names))


def laws_of(run: AnalysedRun, laws: Iterable[Law | StatedLaw]) -> ComparedLaws | None:
    """Fit the laws to the turning points of a fitted run; None where it has no fit."""
    exact, pendulum = run.fits.get(FitMethod.EXACT), run.results.pendulum
    if exact is None or pendulum is None:
        return None
    like = dict(zip(exact.names, exact.values.tolist(), strict=True))
    made = [law.of(run.points, pendulum, like) if isinstance(law, StatedLaw) else law for law in laws]
    compared = compare_laws(run.points, pendulum, made, like=exact)
    free = _without_law(run.points, pendulum, compared, exact)
    remaining = [trial.law.name for trial in compared.remaining]
    verdict = compared.text()
    if free is not None and len(remaining) > 1:
        verdict = compared.text(_remedy(free, remaining[0], remaining[1]))
    classes = [] if run.harmonics is None else harmonic_classes(run.harmonics)
    if not classes:
        return ComparedLaws(_law_fits(compared, {}), verdict, free)
    predicted = {
        trial.law.name: predicted_harmonics(classes, trial.fit, pendulum)
        for trial in compared.trials
        if trial.fit is not None
    }
    chances = waveform_chances(classes, predicted)
    verdict = f"{verdict}; {_said(classes, chances)}"
    return ComparedLaws(_law_fits(compared, chances), verdict, free, _stored(classes, predicted))


def with_laws(run: AnalysedRun, laws: Iterable[Law | StatedLaw]) -> AnalysedRun:
    """The run with these laws compared."""
    return replace(run, results=replace(run.results, laws=laws_of(run, laws)))


def _remedy(free: MomentsWithoutLaw, one: str, other: str) -> str:
    """Where two laws differ most in what one run knows, and how many runs make that three uncertainties."""
    by_moment = {
        "friction": np.abs(free.laws[one].friction_n_m - free.laws[other].friction_n_m) / free.u_friction_n_m,
        "elastic moment": np.abs(free.laws[one].elastic_n_m - free.laws[other].elastic_n_m)
        / free.u_elastic_n_m,
    }
    name, apart = max(by_moment.items(), key=lambda item: float(item[1].max()))
    most = float(apart.max())
    runs = np.ceil((_TELLING / most) ** 2)
    where = f"they differ most in {name} at {free.phi_rad[int(apart.argmax())] / ARCSEC_RAD:.2g} arcsec"
    if not 2 <= runs <= _MOST_RUNS:
        return f"{where}; a larger first amplitude or more runs may decide"
    return (
        f"{where}, by {most:.1f} u of one run: {runs:.0f} such runs, or a larger first amplitude, may decide"
    )


def _without_law(
    points: TurningPoints, pendulum: PendulumOnBall, compared: LawComparison, exact: FitResult
) -> MomentsWithoutLaw | None:
    """Moments as splines, and those of the laws that remain in the same terms; None where there is no fit."""
    try:
        free = fit_without_law(points, pendulum, like=exact)
    except DataError:
        return None
    assert free.fit.ground is not None  # of every exact fit
    found = free.moments()
    same = {}
    for trial in compared.trials:
        if trial.fit is not None:
            moments = free.of_law(trial.fit, found.phi_rad)
            same[trial.law.name] = LawMoments(moments.friction_n_m, moments.elastic_n_m)
    return MomentsWithoutLaw(
        phi_rad=found.phi_rad,
        friction_n_m=found.friction_n_m,
        u_friction_n_m=found.u_friction_n_m,
        elastic_n_m=found.elastic_n_m,
        u_elastic_n_m=found.u_elastic_n_m,
        reference_rad=found.reference_rad,
        ground_rad_per_s2_rthz=free.fit.ground.density_rad_per_s2_rthz.value,
        laws=same,
    )


def _law_fits(compared: LawComparison, chances: Mapping[str, float]) -> dict[str, LawFit]:
    """Every law at its best; `chances` are those of its waveform, where the deflections say something."""
    found = {}
    for trial in compared.trials:
        fit, law = trial.fit, trial.law
        one = LawFit(title=law.title, source=law.source, problem=trial.problem)
        if fit is not None and fit.ground is not None and fit.whiteness is not None:
            one = LawFit(
                title=law.title,
                source=law.source,
                parameters={name: fit.estimate(name) for name in fit.names},
                bic_above_best=compared.above_best(trial),
                aic_above_best=trial.aic - min(one.aic for one in compared.trials),
                log_odds_against=compared.odds_against(trial),
                ground_rad_per_s2_rthz=fit.ground.density_rad_per_s2_rthz.value,
                waveform_chance=chances.get(law.name, nan),
                residuals_are_noise=not fit.whiteness.correlated,
                excluded=trial not in compared.remaining,
            )
        found[law.name] = one
    return found


_THIRD = ORDERS.index(3)


def _said(classes: Sequence[HarmonicClass], chances: Mapping[str, float]) -> str:
    """What the third harmonic says of the laws."""
    first = classes[0]
    third_mas, u_mas = np.array([abs(first.harmonics[_THIRD]), first.u[_THIRD]]) / ARCSEC_RAD * 1e3
    measured = f"the waveform (third harmonic {third_mas:.1f} ± {u_mas:.1f} mas at "
    measured += f"{first.amplitude / ARCSEC_RAD:.0f} arcsec)"
    against = [name for name, chance in chances.items() if chance < CONTRADICTED]
    if not against:
        return f"{measured} contradicts none"
    if len(against) == len(chances):
        return f"{measured} contradicts them all: sensor or beam distort it, or none is right"
    return f"{measured} contradicts {', '.join(against)}"


def _stored(
    classes: Sequence[HarmonicClass], predicted: Mapping[str, Sequence[NDArray[np.complex128]]]
) -> tuple[WaveformClass, ...]:
    return tuple(
        WaveformClass(
            amplitude_rad=one.amplitude,
            measured=_harmonics(one.harmonics),
            u_rad=one.u,
            laws={name: _harmonics(laws[place]) for name, laws in predicted.items()},
        )
        for place, one in enumerate(classes)
    )


def _harmonics(values: NDArray[np.complex128]) -> Harmonics:
    return Harmonics(values.real.copy(), -values.imag)
