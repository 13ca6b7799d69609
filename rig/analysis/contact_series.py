"""A series of runs of one contact pair: every fit combined, and the paper's way beside it."""

from collections.abc import Mapping, Sequence

from processing.contact import PendulumOnBall, surface_energy
from processing.errors import DataError
from processing.fit import (
    FitMethod,
    FitResult,
    RigQuantities,
    SeriesResult,
    average_curves,
    budgets,
    combine_runs,
    fit_asymptotic,
)
from processing.swing import TurningPoints
from rig.analysis.results import AveragedCurves, Series


def combined_series(
    fits: Mapping[str, Sequence[FitResult]],
    points: Sequence[TurningPoints],
    pendulum: PendulumOnBall,
    rig: RigQuantities | None,
    *,
    printed_curvature: bool = False,
) -> Series:
    """Parameters over the runs; what cannot be combined is said in `problems`.

    Parameters
    ----------
    fits
        By method, one fit a run.
    points
        The turning points of the same runs, for the averaged curve.
    """
    combined: dict[str, SeriesResult] = {}
    problems: list[str] = []
    for method, results in fits.items():
        try:
            combined[method] = combine_runs(results)
        except DataError as error:
            problems.append(f"{method}: {error}")
    averaged = None
    try:
        average = fit_asymptotic(average_curves(points), pendulum, printed_curvature=printed_curvature)
        averaged = AveragedCurves(average.estimates(), average.arae_decay, average.arae_period)
    except DataError as error:
        problems.append(f"averaged curves: {error}")
    default = combined.get(FitMethod.EXACT)
    return Series(
        runs=len(points),
        fits={method: found.parameters for method, found in combined.items()},
        surface_energy_j_per_m2=surface_energy(default.parameters["c"].estimate, pendulum)
        if default
        else None,
        budget=budgets(default.measured, rig) if default and rig else {},
        disagreements=default.disagreements if default else (),
        averaged_curves=averaged,
        problems=tuple(problems),
    )
