"""Which laws describe a run: fits of several to its turning points, and the table for the terminal."""

from collections.abc import Iterable, Sequence

from processing.contact.laws import LAWS, Law
from processing.errors import ConfigurationError
from processing.fit import FitMethod, LawComparison, compare_laws
from rig.analysis.law_results import ComparedLaws, LawFit
from rig.analysis.record_fit import AnalysedRun
from rig.presentation import Cell, Table


def chosen_laws(names: Sequence[str]) -> tuple[Law, ...]:
    """Laws of the registry by name; "all" means all of them.

    Raises
    ------
    ConfigurationError
        There is no law of that name.
    """
    for name in names:
        if name != "all" and name not in LAWS:
            raise ConfigurationError(f"--law {name}: no such law; there are {', '.join(LAWS)}, and all")
    return tuple(law for law in LAWS.values() if law.name in names or "all" in names)


def laws_of(run: AnalysedRun, laws: Iterable[Law]) -> ComparedLaws | None:
    """Fit the laws to the turning points of a fitted run; None where it has no fit."""
    exact, pendulum = run.fits.get(FitMethod.EXACT), run.results.pendulum
    if exact is None or pendulum is None:
        return None
    return _values(compare_laws(run.points, pendulum, laws, drag=exact.has_drag, known=[exact]))


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
                ground_rad_per_s2_rthz=fit.ground.density.value,
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
        rows.append([name, law.bic_above_best, law.ground_rad_per_s2_rthz, law.problem])
        if law.problem:
            shown.append([name, law.title, "", "", law.problem])
            continue
        left = "noise" if law.residuals_are_noise else "no noise"
        verdict = "excluded" if law.excluded else "remains"
        ground = f"{law.ground_rad_per_s2_rthz:.1e}"
        shown.append([name, law.title, f"{law.bic_above_best:.1f}", ground, f"{left}; {verdict}"])
    return Table(
        "laws",
        "Laws of the contact",
        ("law", "bic_above_best", "ground_rad_per_s2_rthz", "problem"),
        rows,
        ("law", "", "BIC", "drive", "leaves"),
        shown,
        "BIC: distance from the best law; more than 10 excludes one. Drive of the ground that the law needs, "
        "in rad/s²/√Hz: what the law lacks, a stronger drive must explain.",
    )
