"""Content of the analysing layout for a record: its fits as curves, and the report's numbers as text."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.record.proof import measured_sha256_of
from acquisition.record.reader import RecordReader
from processing.contact import moment_loop
from processing.deflections import DeflectionUnit
from processing.errors import RecordError
from processing.fit import FitMethod
from processing.swing import TurningPoints
from rig.analysis import (
    Curves,
    RunResults,
    analyse_record,
    curves_of,
    parameter_table,
    quality_table,
    recorded_results,
    remarks,
)
from rig.presentation import Table
from rig.rerun import Curve, Floats, Panel


class RunAnalysis(NamedTuple):
    """The results of one record, and the turning points that were fitted."""

    record: Path
    results: RunResults
    points: TurningPoints
    unit: DeflectionUnit


def run_analysis(record: Path) -> RunAnalysis:
    """The results next to the record if they were made from this file, else a new fit."""
    # drawing reports takes a second to import, which must not delay a live view
    from rig.report import turning_points_again

    _, known = recorded_results(record, measured_sha256_of(record))
    results = analyse_record(record).results if known is None else known
    with RecordReader(record) as reader:
        stored = results.turning_points or turning_points_again(reader, results)
    return RunAnalysis(record, results, stored.points(), stored.unit)


def analysis_curves(run: RunAnalysis) -> list[Curve]:
    """Data with both fits, residuals, T(alpha) and moment loops; only the data for a run without fits."""
    points, size = run.points, run.unit.shown_size
    amplitude = points.amplitude / size
    u = points.u_amplitude / size
    drawn = [Curve("decay", "measured", points.time_s, amplitude, u, "points")]
    curves = curves_of(points, run.results)
    if curves is None:
        return drawn
    decay = {FitMethod.ASYMPTOTIC: curves.asymptotic_rad, FitMethod.EXACT: curves.exact_rad}
    period = {
        FitMethod.ASYMPTOTIC: curves.asymptotic_period_s,
        FitMethod.EXACT: curves.exact_period_s,
    }
    at = curves.period_rad / size
    for method, model_rad in decay.items():
        name = f"{method} fit"
        drawn.append(Curve("decay", name, points.time_s, model_rad / size))
        u_bars = u if method is FitMethod.EXACT else None
        drawn.append(Curve("residuals", name, points.time_s, amplitude - model_rad / size, u_bars, "points"))
    drawn.append(Curve("period", "measured", at, curves.period_s, curves.u_period_s, "points"))
    for method, model_s in period.items():
        name = f"{method} fit"
        drawn.append(Curve("period", name, at, model_s))
        u_bars = 1e3 * curves.u_period_s if method is FitMethod.EXACT else None
        residual_ms = 1e3 * (curves.period_s - model_s)
        drawn.append(Curve("period_residuals", name, at, residual_ms, u_bars, "points"))
    return [*drawn, *_loops(run, float(amplitude[0])), *_moments(run)]


def overlaid_curves(runs: Mapping[str, RunAnalysis]) -> list[Curve]:
    """Several runs in common axes: the data, the exact fit's residuals and the largest loop of each."""
    drawn: list[Curve] = []
    for name, run in runs.items():
        points, size = run.points, run.unit.shown_size
        drawn.append(Curve("decay", name, points.time_s, points.amplitude / size, None, "points"))
        curves = curves_of(points, run.results)
        if curves is None:
            continue
        residual = (points.amplitude - curves.exact_rad) / size
        at = curves.period_rad / size
        drawn += [
            Curve("residuals", name, points.time_s, residual, None, "points"),
            Curve("period", name, at, curves.period_s, None, "points"),
            Curve("period_residuals", name, at, _residual_ms(curves), None, "points"),
            _loops(run, float(points.amplitude[0]) / size)[-1]._replace(name=name),
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
            parameters = parameter_table(results.fits, results.surface_energy_j_per_m2, results.verdicts())
            # one fit below the other, because a panel is narrow
            parts += [_markdown(parameters, column) for column in (2, 1)]
            parts.append(_markdown(quality_table(results.fits)))
        instrument = instrument_table(results)
        if instrument.rows:
            parts.append(_markdown(instrument))
        parts += [f"- {line}" for line in (*remarks(results), *results.warnings)]
    return "\n\n".join(parts)


def _loops(run: RunAnalysis, amplitude: float) -> list[Curve]:
    """Moments during one swing: dissipative (Eq. 1), elastic (Eq. 3) and their sum."""
    pendulum, fit = run.results.pendulum, run.results.fits[FitMethod.EXACT]
    if pendulum is None:
        raise RecordError(f"{run.record}: its results contain no pendulum; run rig fit again")
    loop = moment_loop(amplitude * run.unit.shown_size, asdict(fit.contact()), pendulum)
    closed = np.append(np.arange(len(loop.phi_rad)), 0)
    angle = loop.phi_rad[closed] / run.unit.shown_size
    moments = {"dissipative": loop.friction_n_m, "elastic": loop.elastic_n_m, "total": loop.total_n_m}
    return [Curve("loops", name, angle, 1e6 * moment[closed]) for name, moment in moments.items()]


def _moments(run: RunAnalysis) -> list[Curve]:
    """Where laws were compared: moments without a law, and those of the laws that remain."""
    laws = run.results.laws
    if laws is None or laws.without_law is None:
        return []
    free, size = laws.without_law, run.unit.shown_size
    drawn: list[Curve] = []
    at = free.phi_rad / size
    # friction over the angle changes little, so that bands and laws can be seen
    panels: dict[Panel, tuple[str, Floats]] = {
        "friction": ("friction_n_m", 1e9 / at),
        "elastic": ("elastic_n_m", np.full_like(at, 1e9)),
    }
    for panel, (name, scale) in panels.items():
        u = scale * getattr(free, f"u_{name}")
        drawn.append(Curve(panel, "no law", at, scale * getattr(free, name), u, "points"))
        drawn += [
            Curve(panel, law, at, scale * getattr(moments, name))
            for law, moments in free.laws.items()
            if not laws.laws[law].excluded
        ]
    return drawn


def _residual_ms(curves: Curves) -> Floats:
    return 1e3 * (curves.period_s - curves.exact_period_s)


def _markdown(table: Table, column: int | None = None) -> str:
    """The table, or one column of it, in Markdown; units are appended to the names."""
    head, rows = list(table.head), [list(row) for row in table.shown]
    if head[-1] == "unit":
        head = head[:-1]
        rows = [[f"{row[0]} / {row[-1]}" if row[-1] else row[0], *row[1:-1]] for row in rows]
    if column is not None:
        head, rows = [head[0], head[column]], [[row[0], row[column]] for row in rows]

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cells)} |"

    return "\n".join([line(head), line(["---"] * len(head)), *map(line, rows)])
