"""Which laws describe a run: fits of several to its turning points, and the table for the terminal."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from processing.angle import ARCSEC_RAD
from processing.contact import PendulumOnBall, StatedLaw
from processing.contact.laws import DEFAULT_LAW, LAWS, Law
from processing.errors import ConfigurationError, DataError
from processing.fit import FitMethod, FitResult, LawComparison, compare_laws, fit_without_law
from processing.swing import TurningPoints
from rig.analysis.analysed_run import AnalysedRun
from rig.analysis.law_results import ComparedLaws, LawFit, LawMoments, MomentsWithoutLaw
from rig.analysis.waveform_results import with_waveform
from rig.presentation import Cell, Table, decimals, plain

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
    values = _values(compared)
    if free is not None and len(remaining) > 1:
        values = replace(values, verdict=compared.text(_remedy(free, remaining[0], remaining[1])))
    return with_waveform(replace(values, without_law=free), run, pendulum, compared)


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


def _values(compared: LawComparison) -> ComparedLaws:
    found = {}
    for trial in compared.trials:
        fit = trial.fit
        head = LawFit(title=trial.law.title, source=trial.law.source, problem=trial.problem)
        if fit is not None and fit.ground is not None and fit.whiteness is not None:
            head = LawFit(
                title=trial.law.title,
                source=trial.law.source,
                parameters={name: fit.estimate(name) for name in fit.names},
                bic_above_best=compared.above_best(trial),
                aic_above_best=trial.aic - min(one.aic for one in compared.trials),
                log_odds_against=compared.odds_against(trial),
                ground_rad_per_s2_rthz=fit.ground.density_rad_per_s2_rthz.value,
                residuals_are_noise=not fit.whiteness.correlated,
                excluded=trial not in compared.remaining,
            )
        found[trial.law.name] = head
    return ComparedLaws(found, compared.text())


def law_table(compared: ComparedLaws) -> Table:
    """The laws, how far each lies from the best, and what it needs to describe the run."""
    rows: list[list[Cell]] = []
    shown = []
    for name, law in compared.laws.items():
        measures = (law.bic_above_best, law.aic_above_best, law.log_odds_against)
        waveform = plain(law.waveform_chance, 2)
        rows.append([name, *measures, law.ground_rad_per_s2_rthz, law.waveform_chance, law.problem])
        if law.problem:
            shown.append([name, law.title, *[""] * 5, law.problem.partition(";")[0]])
            continue
        left = "as noise" if law.residuals_are_noise else "more than noise"
        verdict = "excluded" if law.excluded else "remains"
        ground = plain(law.ground_rad_per_s2_rthz, 2)
        shown.append(
            [
                name,
                law.title,
                *(decimals(one, 1) for one in measures),
                ground,
                waveform,
                f"{left}; {verdict}",
            ]
        )
    return Table(
        "laws",
        "Laws of the contact",
        (
            "law",
            "bic_above_best",
            "aic_above_best",
            "log_odds_against",
            "ground_rad_per_s2_rthz",
            "waveform_chance",
            "problem",
        ),
        rows,
        ("law", "", "BIC", "AIC", "ln odds", "drive", "waveform", "residuals; verdict"),
        shown,
        "BIC and AIC: distance from the best law; ln odds against the law, by the evidence. BIC above 10 "
        "with ln odds above 5 excludes a law. Drive of the ground that the law needs, in rad/s²/√Hz; what a "
        "law fails to describe appears as a stronger drive. Waveform: probability of a third harmonic this "
        "far from the law's. Residuals: whether they exceed the noise.",
    )


def moments_table(compared: ComparedLaws) -> Table:
    """The contact's moments without a law and those of the fitted laws, for a file."""
    free = compared.without_law
    columns = ["phi_rad", "friction_n_m", "u_friction_n_m", "elastic_n_m", "u_elastic_n_m"]
    rows: list[list[Cell]] = []
    if free is not None:
        parts = [getattr(free, name) for name in columns]
        for name, law in free.laws.items():
            columns += [f"{name}_friction_n_m", f"{name}_elastic_n_m"]
            parts += [law.friction_n_m, law.elastic_n_m]
        rows = [list(row) for row in zip(*(part.tolist() for part in parts), strict=True)]
    return Table("moments", "Moments of the contact without a law", columns, rows)
