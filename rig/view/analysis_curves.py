"""Content of the analysing layout for a record: its fits as curves, and the report's numbers as text."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from acquisition.record.digest import sha256_of
from processing.deflections import DeflectionUnit
from processing.fit import FitMethod
from processing.swing import TurningPoints
from rig.analysis import (
    RunResults,
    StoredTurningPoints,
    analyse_record,
    curves_of,
    parameter_table,
    quality_table,
    recorded_results,
    remarks,
)
from rig.presentation import Table
from rig.view.values import Curve


class RunAnalysis(NamedTuple):
    """The results of one record, and the turning points that were fitted."""

    record: Path
    results: RunResults
    points: TurningPoints
    unit: DeflectionUnit


def run_analysis(record: Path) -> RunAnalysis:
    """The results next to the record if they were made from this file, else a new fit."""
    _, known = recorded_results(record, sha256_of(record))
    results = analyse_record(record).results if known is None else known
    stored = results.turning_points or StoredTurningPoints()
    # of a record, so never a table's
    return RunAnalysis(record, results, stored.points(), DeflectionUnit(stored.unit))


def analysis_curves(runs: Mapping[str, RunAnalysis]) -> list[Curve]:
    """Decay and T(alpha) with both fits and their residuals; only the data of a run without fits.

    Of several runs, in common axes, the data and the exact fit's residuals, named by the run.
    """
    drawn: list[Curve] = []
    alone = len(runs) == 1
    for name, run in runs.items():
        points, size = run.points, run.unit.shown_size
        amplitude, u = points.amplitude / size, points.u_amplitude / size
        data = "measured" if alone else name
        drawn.append(Curve("decay", data, points.time_s, amplitude, u if alone else None, "points"))
        curves = curves_of(points, run.results)
        if curves is None:
            continue
        at, u_period_s = curves.period_rad / size, curves.u_period_s
        drawn.append(Curve("period", data, at, curves.period_s, u_period_s if alone else None, "points"))
        models = {
            FitMethod.ASYMPTOTIC: (curves.asymptotic_rad / size, curves.asymptotic_period_s),
            FitMethod.EXACT: (curves.exact_rad / size, curves.exact_period_s),
        }
        for method, (decay, period_s) in models.items():
            exact = method is FitMethod.EXACT
            if not (alone or exact):
                continue
            fit = f"{method} fit" if alone else name
            if alone:
                drawn += [Curve("decay", fit, points.time_s, decay), Curve("period", fit, at, period_s)]
            u_bars, u_bars_ms = (u, 1e3 * u_period_s) if alone and exact else (None, None)
            off_ms = 1e3 * (curves.period_s - period_s)
            drawn += [
                Curve("residuals", fit, points.time_s, amplitude - decay, u_bars, "points"),
                Curve("period_residuals", fit, at, off_ms, u_bars_ms, "points"),
            ]
    return drawn


def report_text(runs: Mapping[str, RunAnalysis]) -> str:
    """Results of the fits in Markdown, one run after another."""
    from rig.report import instrument_table

    parts: list[str] = []
    for run in runs.values():
        results = run.results
        parts.append(f"## {run.record.stem}")
        parts.append(results.half_cycles_text(run.unit.shown))
        if results.problem:
            parts.append(f"no fit: {results.problem}")
        if results.fits:
            parts.append(_markdown(parameter_table(results, full=False)))
            parts.append(_markdown(quality_table(results.fits)))
        instrument = instrument_table(results)
        if instrument.rows:
            parts.append(_markdown(instrument))
        parts += [f"- {line}" for line in (*remarks(results), *results.warnings)]
    return "\n\n".join(parts)


def _markdown(table: Table) -> str:
    """The table in Markdown; units are appended to the names."""
    head, rows = list(table.head), [list(row) for row in table.shown]
    if "unit" in head:
        place = head.index("unit")
        del head[place]
        units = [row.pop(place) for row in rows]
        rows = [
            [f"{row[0]} / {unit}" if unit else row[0], *row[1:]]
            for row, unit in zip(rows, units, strict=True)
        ]

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cells)} |"

    return "\n".join([line(head), line(["---"] * len(head)), *map(line, rows)])
