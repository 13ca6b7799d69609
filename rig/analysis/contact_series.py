"""A series of runs of one contact pair: every fit combined, and the paper's way beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from processing.arrays import Floats
from processing.contact import PendulumOnBall
from processing.errors import DataError
from processing.fit import (
    DRIFTS,
    Budget,
    BudgetSource,
    FitMethod,
    FitResult,
    FittedContact,
    InputQuantity,
    RigQuantities,
    budgets,
    drifts_of,
    fit_asymptotic,
)
from processing.series import SeriesResult, average_curves, combine_runs
from processing.swing import TurningPoints
from rig.analysis.result_rows import series_rows, withheld
from rig.analysis.results import AveragedCurves, Series

_PLANE: Final = "plane_of_swing_rad"


def combined_series(
    fits: Mapping[str, Sequence[FitResult]],
    points: Sequence[TurningPoints],
    pendulum: PendulumOnBall,
    rig: RigQuantities | None,
    *,
    printed_curvature: bool = False,
    of_runs: Sequence[Mapping[str, Budget]] = (),
) -> Series:
    """Parameters over the runs; what cannot be combined is said in `problems`.

    Parameters
    ----------
    fits
        By method, one fit a run.
    points
        The turning points of the same runs, for the averaged curve.
    rig
        Of the first of them.
    of_runs
        Budgets of the same runs, with lines that a series has because its runs have them.
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
    if measured is not None and rig is not None and of_runs and all(of_runs):
        measured, rig = _with_lines_of(of_runs, measured, rig)
    budget = budgets(measured, rig) if measured and rig else {}
    table = () if default is None else series_rows(default.parameters, budget, pendulum)
    return Series(
        runs=len(points),
        fits={method: found.parameters for method, found in combined.items()},
        table=table,
        budget=withheld(budget, table),
        disagreements=default.disagreements if default else (),
        averaged_curves=averaged,
        problems=tuple(problems),
    )


def _with_lines_of(
    of_runs: Sequence[Mapping[str, Budget]], measured: FittedContact, rig: RigQuantities
) -> tuple[FittedContact, RigQuantities]:
    """What a mean does for row time and film, which its runs share, and for their planes of swing.

    How a plane turned is each run's own, and falls in the mean; the angle between the axes is common to all.
    """
    found: dict[str, Floats | None] = {}
    for source in ("row_time_s", "common_amplitude_rad"):
        moved, u = _moved(of_runs, measured.names, source), rig.inputs()[source].u
        found[source] = moved.mean(axis=0) / u if u > 0 else None
    by_drifts = dict(measured.by_drifts)
    moved = _moved(of_runs, measured.names, _PLANE)
    size = np.linalg.norm(moved, axis=0) / len(moved)
    if rig.non_orthogonality_rad.u > 0:
        size = np.abs(moved).mean(axis=0)
    if np.any(size > 0):
        first = moved[np.flatnonzero(np.any(moved != 0.0, axis=1))[0]]
        u_rad = max(line.u_source for lines in of_runs for line in _lines(lines, measured.names, _PLANE))
        by_drifts[_PLANE] = np.copysign(size, first) / u_rad
        rig = replace(rig, plane_of_swing_rad=InputQuantity(0.0, u_rad))
    return (
        replace(
            measured,
            by_row_time=found["row_time_s"],
            by_common_amplitude=found["common_amplitude_rad"],
            by_drifts=by_drifts,
        ),
        rig,
    )


def _moved(of_runs: Sequence[Mapping[str, Budget]], names: Sequence[str], source: str) -> Floats:
    """Changes (runs, parameters) by one standard uncertainty of a source; 0 where a run has no such line."""
    return np.array(
        [
            [sum(one.sensitivity * one.u_source for one in _lines(lines, [name], source)) for name in names]
            for lines in of_runs
        ],
        dtype=np.float64,
    )


def _lines(lines: Mapping[str, Budget], names: Sequence[str], source: str) -> list[BudgetSource]:
    return [one for name in names if name in lines for one in lines[name].sources if one.source == source]


def _by_drifts(
    points: Sequence[TurningPoints], pendulum: PendulumOnBall, fits: Sequence[FitResult]
) -> dict[str, Floats]:
    """What drifts that every run has alike do to the mean."""
    found = [drifts_of(one, pendulum, fit) for one, fit in zip(points, fits, strict=True)]
    return {name: np.mean([drifts[name] for drifts in found], axis=0) for name in DRIFTS}
