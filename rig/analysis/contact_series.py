"""A series of runs of one contact pair: every fit combined, and the paper's way beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall, surface_energy
from processing.errors import DataError
from processing.fit import (
    DRIFTS,
    FitMethod,
    FitResult,
    RigQuantities,
    SeriesResult,
    average_curves,
    budgets,
    combine_runs,
    drifts_of,
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
    measured = None if default is None else default.measured
    if measured is not None:
        try:
            measured = replace(measured, by_drifts=_by_drifts(points, pendulum, fits[FitMethod.EXACT]))
        except DataError as error:
            problems.append(f"the budget has no lines for drifts: {error}")
    return Series(
        runs=len(points),
        fits={method: found.parameters for method, found in combined.items()},
        surface_energy_j_per_m2=surface_energy(default.parameters["c"].estimate, pendulum)
        if default
        else None,
        budget=budgets(measured, rig) if measured and rig else {},
        disagreements=default.disagreements if default else (),
        averaged_curves=averaged,
        problems=tuple(problems),
    )


def _by_drifts(
    points: Sequence[TurningPoints], pendulum: PendulumOnBall, fits: Sequence[FitResult]
) -> dict[str, Floats]:
    """What drifts that every run has alike do to the mean."""
    found = [drifts_of(one, pendulum, fit) for one, fit in zip(points, fits, strict=True)]
    return {name: np.mean([drifts[name] for drifts in found], axis=0) for name in DRIFTS}
