"""Results of several runs: the series of one contact pair, or places on a sample against a reference."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from pathlib import Path
from typing import Any, Final

import numpy as np

from acquisition.record.digest import sha256_of
from processing.arrays import Floats
from processing.errors import ConfigurationError, DataError
from processing.fit import (
    DRIFTS,
    Budget,
    BudgetSource,
    FitMethod,
    FitResult,
    InputQuantity,
    LinearisedFit,
    RigQuantities,
    budgets,
    drift_effects,
)
from processing.instruments import ValueWithSharedErrors, check, over_places, ratio
from processing.series import CombinedValue, SeriesResult, combine_runs
from processing.swing import HalfCycle
from rig.analysis.decay_values import InstrumentSeries
from rig.analysis.other_instruments import Reduction
from rig.analysis.result_rows import ResultRow, series_rows, withheld
from rig.analysis.results import RunResults, Series, SessionResults
from rig.analysis.results_file import relative_record
from rig.settings import InstrumentSettings

_PLANE: Final = "plane_of_swing_rad"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class AnalysedRun(RunResults):
    """The results of one run, with values for a series of runs that are in no file."""

    path: Path
    """The file that was analysed."""
    detected_half_cycles: Sequence[HalfCycle] = ()
    """Half-cycles that were detected in a table."""
    fitted: Mapping[str, FitResult] = field(default_factory=dict)
    """The fits whose numbers are in the results."""
    rig: RigQuantities | None = None
    """The apparatus with its uncertainties; None without [pendulum]."""
    reduction: Reduction | None = None
    """Results of another kind of pendulum, for which no contact law is fitted; else None."""


def fitted_series(runs: Sequence[AnalysedRun]) -> Series | None:
    """The series of the fitted runs; None for fewer than two.

    The apparatus is the first run's. The runs' budget lines for row time, common amplitude error and plane of
    swing become lines of the series.
    """
    numbers = [number for number, run in enumerate(runs, start=1) if run.fitted]
    fitted = [runs[number - 1] for number in numbers]
    pendulum = fitted[0].pendulum if fitted else None
    if len(fitted) < 2 or pendulum is None:
        return None
    combined: dict[str, SeriesResult] = {}
    problems: list[str] = []
    for method in fitted[0].fitted:
        try:
            combined[method] = combine_runs([run.fitted[method] for run in fitted])
        except DataError as error:
            problems.append(f"{method}: {error}")
    exact = combined.get(FitMethod.EXACT)
    measured, rig = None if exact is None else exact.combined, fitted[0].rig
    if measured is not None:
        try:
            fits = [LinearisedFit.of(run.points, pendulum, run.fitted[FitMethod.EXACT]) for run in fitted]
            drifts = [drift_effects(fit) for fit in fits]
            # the effects of drifts are the same for all runs
            by_drifts = {name: np.mean([effects[name] for effects in drifts], axis=0) for name in DRIFTS}
            measured = replace(measured, by_inputs=by_drifts)
        except DataError as error:
            problems.append(f"the budget has no lines for drifts: {error}")
    run_budgets = [run.budget for run in fitted]
    if measured is not None and rig is not None and all(run_budgets):
        measured, rig = _with_run_sources(run_budgets, measured, rig)
    budget = budgets(measured, rig) if measured and rig else {}
    parameters = {} if exact is None else exact.parameters
    rows = {name: [run.rows[name] for run in fitted] for name in parameters}
    table = series_rows(parameters, budget, pendulum, rows) if parameters else ()
    return Series(
        runs=len(fitted),
        combined_runs=tuple(numbers),
        fits={method: _without_limited_means(fit.parameters, table) for method, fit in combined.items()},
        table=table,
        budget=withheld(budget, table),
        disagreements=tuple(
            replace(item, run=numbers[item.run - 1]) for item in (exact.disagreements if exact else ())
        ),
        problems=tuple(problems),
    )


def _without_limited_means(
    combined: Mapping[str, CombinedValue], table: Sequence[ResultRow]
) -> dict[str, CombinedValue]:
    """The combined parameters, in which one that the runs only limit has no mean by any method."""
    no_mean: dict[str, Any] = dict.fromkeys(
        ("value", "standard_uncertainty", "within_runs", "between_runs", "p_homogeneous", "by_air"), nan
    )
    limited = [row.quantity for row in table if row.by_profile and row.quantity in combined]
    return {**combined, **{name: replace(combined[name], **no_mean) for name in limited}}


def _with_run_sources(
    run_budgets: Sequence[Mapping[str, Budget]], measured: FitResult, rig: RigQuantities
) -> tuple[FitResult, RigQuantities]:
    """The series with sources of its runs' budgets: shared row time and amplitude error, plane of swing."""
    by_inputs = dict(measured.by_inputs)
    for source in ("row_time_s", "common_amplitude_rad"):
        if (u := rig.inputs()[source].u) > 0:
            by_inputs[source] = _source_changes(run_budgets, measured.names, source).mean(axis=0) / u
    changes = _source_changes(run_budgets, measured.names, _PLANE)
    # the rotation is independent in each run and averages down; the axes' non-orthogonality is common to all
    magnitude = np.linalg.norm(changes, axis=0) / len(changes)
    if rig.non_orthogonality_rad.u > 0:
        magnitude = np.abs(changes).mean(axis=0)
    if np.any(magnitude > 0):
        first = changes[np.flatnonzero(np.any(changes != 0.0, axis=1))[0]]
        u_rad = max(
            line.u_source for budget in run_budgets for line in _lines(budget, measured.names, _PLANE)
        )
        by_inputs[_PLANE] = np.copysign(magnitude, first) / u_rad
        rig = replace(rig, plane_of_swing_rad=InputQuantity(0.0, u_rad))
    return replace(measured, by_inputs=by_inputs), rig


def _source_changes(run_budgets: Sequence[Mapping[str, Budget]], names: Sequence[str], source: str) -> Floats:
    """Changes (runs, parameters) by one standard uncertainty of a source; 0 where a run has no such line."""
    return np.array(
        [
            [
                sum(line.sensitivity * line.u_source for line in _lines(budget, [name], source))
                for name in names
            ]
            for budget in run_budgets
        ],
        dtype=np.float64,
    )


def _lines(budget: Mapping[str, Budget], names: Sequence[str], source: str) -> list[BudgetSource]:
    sources = (line for name in names if name in budget for line in budget[name].sources)
    return [line for line in sources if line.source == source]


_Reading = Mapping[str, ValueWithSharedErrors]
"""Values of a run that a series compares; empty if it has none."""


def _mean(readings: Sequence[_Reading], name: str) -> ValueWithSharedErrors:
    return over_places([reading[name] for reading in readings])[0]


def _reference_problem(settings: InstrumentSettings, numbered: Sequence[tuple[int, _Reading]]) -> str:
    """Problem of the stated reference; empty if it has none."""
    stated = f"instrument.reference_runs = {list(settings.reference_runs)}"
    numbers = list(dict.fromkeys(number for number, _ in numbered))
    if absent := [number for number in settings.reference_runs if number not in numbers]:
        return f"{stated}: there is no run {absent[0]}, only {', '.join(map(str, numbers))}"
    if failed := [
        number for number, reading in numbered if number in settings.reference_runs and not reading
    ]:
        return f"{stated}: run {failed[0]} has no damping time; see the line of that run"
    if not settings.reference_runs and settings.reference_time_s is None:
        return (
            "no reference was measured: state its runs (instrument.reference_runs) or its damping time "
            "(instrument.reference_time_s)"
        )
    return ""


def session_results(runs: Sequence[AnalysedRun], folder: Path) -> SessionResults:
    """Results of one or more runs for a file; records are named relative to its folder."""
    return SessionResults(
        runs=tuple(replace(run, record=relative_record(run.path, folder)) for run in runs),
        series=instrument_series(runs) if any(run.reduction for run in runs) else fitted_series(runs),
    )


def instrument_series(runs: Sequence[AnalysedRun], numbers: Sequence[int] = ()) -> Series | None:
    """The series of runs of another kind of pendulum: places on the sample compared with the reference.

    It is None where no run is of such a pendulum, or its kind has no such comparison. `numbers` are those by
    which `reference_runs` names the runs, by default 1, 2, ... in the order of `runs`. Several decays of one
    run have its number.
    """
    reduced = [
        (number, run.reduction)
        for number, run in zip(numbers or range(1, len(runs) + 1), runs, strict=True)
        if run.reduction is not None
    ]
    if not reduced or reduced[0][1].description.report not in ("damping", "decay"):
        return None
    numbered = [(number, reduction.readings) for number, reduction in reduced]
    return Series(runs=len(reduced), instrument=_compared_places(reduced[0][1].settings, numbered))


def _compared_places(
    settings: InstrumentSettings, numbered: Sequence[tuple[int, _Reading]]
) -> InstrumentSeries:
    description = settings.description()
    places = [reading for number, reading in numbered if reading and number not in settings.reference_runs]
    glass = [reading for number, reading in numbered if reading and number in settings.reference_runs]
    problem = _reference_problem(settings, numbered)
    values: dict[str, Any] = {"kind": description.kind, "problem": problem or None}
    if places:
        values |= {name: over_places([item[name] for item in places])[1] for name in ("time_s", "swings")}
    if glass:
        reference = _mean(glass, "time_s")
        standard = (
            ("period on glass", "period_s", description.period_s),
            ("damping time on glass", "time_s", description.glass_time_s),
        )
        values["acceptance"] = tuple(
            check(name, _mean(glass, key).estimate, limits, "s")
            for name, key, limits in standard
            if limits is not None
        )
        values["text"] = (f"note: {description.note}",) if description.note else ()
    elif settings.reference_time_s is not None and not settings.reference_runs:
        reference = ValueWithSharedErrors(settings.reference_time_s, settings.u_reference_time_s)
    else:
        return InstrumentSeries(**values | {"problem": f"{problem}: no ratio"})
    if places:
        values["ratio"] = ratio(_mean(places, "time_s"), reference)
    if places and glass:
        values["ratio_of_swings"] = ratio(_mean(places, "swings"), _mean(glass, "swings"))
    return InstrumentSeries(**values, reference_time_s=reference.estimate)


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise ConfigurationError where two records hold the same run, since one was copied."""
    first: dict[str, Path] = {}
    for path in paths if len(paths) > 1 else ():
        if path.is_file() and (other := first.setdefault(sha256_of(path), path)) is not path:
            raise ConfigurationError(
                f"{path}: holds the run of {other} (same hash), which counts once in a series"
            )
