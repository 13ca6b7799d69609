"""Several runs: a series of one contact pair, or places on a sample against a reference; their results."""

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
from processing.instruments import (
    Check,
    Description,
    ValueWithSharedErrors,
    check,
    over_places,
    ratio,
)
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
    """The results of one run, with what a series of runs needs in addition and no file holds.

    `path` is the file that was analysed, `swings` are the half-cycles that were detected in a table, `fitted`
    the fits whose numbers are in the results. `reduction` is None unless another pendulum than that of the
    contact's laws, `rig` is None without [pendulum].
    """

    path: Path
    swings: Sequence[HalfCycle] = ()
    fitted: Mapping[str, FitResult] = field(default_factory=dict)
    rig: RigQuantities | None = None
    reduction: Reduction | None = None


def fitted_series(runs: Sequence[AnalysedRun]) -> Series | None:
    """The series of the fitted runs; None for fewer than two. `problems` names what cannot be combined.

    The apparatus is the first run's. Lines of the runs' budgets for row time, film and plane of swing become
    the series' own.
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
    default = combined.get(FitMethod.EXACT)
    measured, rig = None if default is None else default.combined, fitted[0].rig
    if measured is not None:
        try:
            exact = [LinearisedFit.of(run.points, pendulum, run.fitted[FitMethod.EXACT]) for run in fitted]
            drifts = [drift_effects(fit) for fit in exact]
            # all runs have them alike
            by_drifts = {name: np.mean([one[name] for one in drifts], axis=0) for name in DRIFTS}
            measured = replace(measured, by_inputs=by_drifts)
        except DataError as error:
            problems.append(f"the budget has no lines for drifts: {error}")
    of_runs = [run.budget for run in fitted]
    if measured is not None and rig is not None and all(of_runs):
        measured, rig = _with_run_sources(of_runs, measured, rig)
    budget = budgets(measured, rig) if measured and rig else {}
    names = () if default is None else default.parameters
    rows = {name: [run.rows[name] for run in fitted] for name in names}
    table = () if default is None else series_rows(default.parameters, budget, pendulum, rows)
    return Series(
        runs=len(fitted),
        combined_runs=tuple(numbers),
        fits={method: _with_means(found.parameters, table) for method, found in combined.items()},
        table=table,
        budget=withheld(budget, table),
        disagreements=tuple(
            replace(each, run=numbers[each.run - 1]) for each in (default.disagreements if default else ())
        ),
        problems=tuple(problems),
    )


def _with_means(
    combined: Mapping[str, CombinedValue], table: Sequence[ResultRow]
) -> dict[str, CombinedValue]:
    """The parameters over runs; those that the runs only limit have no mean by any method."""
    limited = {row.quantity for row in table if row.by_profile}
    none = CombinedValue(value=nan, standard_uncertainty=nan, by_air=nan)
    return {
        name: replace(none, degrees_of_freedom=item.degrees_of_freedom, runs=item.runs)
        if name in limited
        else item
        for name, item in combined.items()
    }


def _with_run_sources(
    of_runs: Sequence[Mapping[str, Budget]], measured: FitResult, rig: RigQuantities
) -> tuple[FitResult, RigQuantities]:
    """The series with sources of its runs' budgets: row time and film, which runs share, and plane of swing.

    The turning of a plane is each run's own and falls in the mean; the angle between the axes is common to
    all runs and does not.
    """
    by_inputs = dict(measured.by_inputs)
    for source in ("row_time_s", "common_amplitude_rad"):
        if (u := rig.inputs()[source].u) > 0:
            by_inputs[source] = _source_changes(of_runs, measured.names, source).mean(axis=0) / u
    moved = _source_changes(of_runs, measured.names, _PLANE)
    size = np.linalg.norm(moved, axis=0) / len(moved)
    if rig.non_orthogonality_rad.u > 0:
        size = np.abs(moved).mean(axis=0)
    if np.any(size > 0):
        first = moved[np.flatnonzero(np.any(moved != 0.0, axis=1))[0]]
        u_rad = max(line.u_source for lines in of_runs for line in _lines(lines, measured.names, _PLANE))
        by_inputs[_PLANE] = np.copysign(size, first) / u_rad
        rig = replace(rig, plane_of_swing_rad=InputQuantity(0.0, u_rad))
    return replace(measured, by_inputs=by_inputs), rig


def _source_changes(of_runs: Sequence[Mapping[str, Budget]], names: Sequence[str], source: str) -> Floats:
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


_Readings = Sequence[Mapping[str, ValueWithSharedErrors]]
_NumberedReadings = Sequence[tuple[int, Mapping[str, ValueWithSharedErrors]]]


def _mean(readings: _Readings, name: str) -> ValueWithSharedErrors:
    return over_places([one[name] for one in readings])[0]


def _reference(settings: InstrumentSettings, glass: _Readings) -> ValueWithSharedErrors | None:
    if glass:
        return _mean(glass, "time_s")
    if settings.reference_time_s is not None and not settings.reference_runs:
        return ValueWithSharedErrors(settings.reference_time_s, settings.u_reference_time_s)
    return None


def _reference_fault(settings: InstrumentSettings, numbered: _NumberedReadings) -> str:
    """Problem of the stated reference; empty if it has none."""
    stated = f"instrument.reference_runs = {list(settings.reference_runs)}"
    there = list(dict.fromkeys(number for number, _ in numbered))
    if absent := [number for number in settings.reference_runs if number not in there]:
        return f"{stated}: there is no run {absent[0]}, only {', '.join(map(str, there))}"
    if failed := [number for number, one in numbered if number in settings.reference_runs and not one]:
        return f"{stated}: run {failed[0]} has no damping time, as its own line says"
    if not settings.reference_runs and settings.reference_time_s is None:
        return (
            "no reference was measured, which instrument.reference_runs names by its runs, or "
            "instrument.reference_time_s by its time"
        )
    return ""


def _acceptance(description: Description, glass: _Readings) -> tuple[Check, ...]:
    """Checks of the apparatus on glass against the standard."""
    wanted = (
        ("period on glass", "period_s", description.period_s),
        ("damping time on glass", "time_s", description.glass_time_s),
    )
    return tuple(
        check(name, _mean(glass, key).estimate, limits, "s")
        for name, key, limits in wanted
        if limits is not None
    )


def session_results(runs: Sequence[AnalysedRun], folder: Path) -> SessionResults:
    """Results of one or more runs for a file; records are named relative to its folder.

    Raises ConfigurationError for a changed key that no fit has used.
    """
    return SessionResults(
        runs=tuple(replace(run, record=relative_record(run.path, folder)) for run in runs),
        series=instrument_series(runs) if any(run.reduction for run in runs) else fitted_series(runs),
    )


def instrument_series(runs: Sequence[AnalysedRun], numbers: Sequence[int] = ()) -> Series | None:
    """The series of runs of another instrument: places on the sample compared with the reference.

    None where no run is of such an instrument, or its kind has no such comparison. `numbers` are those by
    which `reference_runs` names the runs, by default their places from 1. Several decays of one run have its
    number.
    """
    reduced = [run.reduction for run in runs if run.reduction is not None]
    if not reduced or reduced[0].description.report not in ("damping", "decay"):
        return None
    kept = [number for number, run in zip(numbers, runs, strict=False) if run.reduction is not None]
    numbered = list(zip(kept or range(1, len(reduced) + 1), (run.readings for run in reduced), strict=True))
    compared = _compared_places(reduced[0].settings, numbered)
    return Series(runs=len(reduced), instrument=compared)


def _compared_places(settings: InstrumentSettings, numbered: _NumberedReadings) -> InstrumentSeries:
    description = settings.description()
    places = [one for number, one in numbered if one and number not in settings.reference_runs]
    glass = [one for number, one in numbered if one and number in settings.reference_runs]
    values: dict[str, Any] = {"kind": description.kind}
    if places:
        values |= {name: over_places([one[name] for one in places])[1] for name in ("time_s", "swings")}
    reference, problem = _reference(settings, glass), _reference_fault(settings, numbered)
    if reference is None:
        return InstrumentSeries(**values, problem=f"{problem}: no ratio")
    values |= {"reference_time_s": reference.estimate, "problem": problem or None}
    if glass:
        values["acceptance"] = _acceptance(description, glass)
        values["text"] = (f"note: {description.note}",) if description.note else ()
    if places:
        values["ratio"] = ratio(_mean(places, "time_s"), reference)
    if places and glass:
        values["ratio_of_swings"] = ratio(_mean(places, "swings"), _mean(glass, "swings"))
    return InstrumentSeries(**values)


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise ConfigurationError where two records are the same run: one was copied."""
    first: dict[str, Path] = {}
    for path in paths if len(paths) > 1 else ():
        if path.is_file() and (other := first.setdefault(sha256_of(path), path)) is not path:
            raise ConfigurationError(
                f"{path}: holds the run of {other} (same hash), which counts once in a series"
            )
