"""`rig report`: a session's HTML page, its figures as SVG, its tables as CSV."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition import atomic_write
from processing.errors import RecordError
from processing.fit import FitMethod
from rig.analysis import AnalysedTable, Curves, Series, SessionResults, curves_of, results_path
from rig.intake import write_positions
from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.drawing import ReportFigure, png, styled, svg
from rig.report.figures_contact import instrument_figures
from rig.report.figures_motion import damped_figure, position_error_figure, witness_figure
from rig.report.source import ReportSource, RunData, read_source
from rig.report.summary import notes_of, run_sentence, summary_of, title_of
from rig.report.tables import run_tables, series_tables
from rig.terminal import Table, latex_table, quantity, written

_DEFAULT_PERIOD_S = 4.0


def make_report(folder: Path, output: Path | None = None) -> Path:
    """Write the report of a session folder (or of one results file in it); returns the HTML file.

    Figures and tables go into a folder of the same name next to the HTML file. An earlier report is replaced,
    because all it contains is in results and records.

    Raises RecordError for a folder without results.json, a missing record, a file that cannot be
    written.
    """
    source = read_source(folder)
    # results-2.json is reported in report-2.html
    name = results_path(folder).stem.replace("results", "report", 1)
    target = output or source.folder / f"{name}.html"
    files = target.parent / target.stem
    with written(target):
        files.mkdir(parents=True, exist_ok=True)
        series = [] if source.series is None else _series(source, source.series, files)
        single = len(source.runs) == 1
        runs = [_run(run, files / f"run-{k}", single=single) for k, run in enumerate(source.runs, start=1)]
        # the first decay is shown at the top beside the verdict, every other with its run
        body = [*summary_of(source, runs[0].pop("fig12-decay", "")), *series]
        for each in runs:
            body += each.values()
        body += _provenance(source)
        title, subtitle = title_of(source)
        atomic_write.replace(
            target, html.page(title, subtitle, body, results_sha256=source.results[1]).encode()
        )
    return target


def draw_run(source: Path | SessionResults, number: int) -> list[ReportFigure]:
    """The figures of one run, counted from 1, of a session's folder, a results file, or results in memory.

    Raises RecordError if results, run or record do not exist.
    """
    runs = read_source(source).runs
    if not 1 <= number <= len(runs):
        named = source if isinstance(source, Path) else "results"
        raise RecordError(f"{named}: run {number} is not there; it has runs 1 to {len(runs)}")
    run = runs[number - 1]
    return _drawings(run, curves_of(run.results))


def _series(source: ReportSource, series: Series, files: Path) -> list[str]:
    tables = [table for table in series_tables(series) if table.rows]
    disagreements = [
        f"{source.runs[item.run - 1].title} disagrees with the others in {quantity(item.name).symbol}: "
        f"{item.deviation:+.1f} standard uncertainties."
        for item in series.disagreements
    ]
    if FitMethod.EXACT in series.fits and not disagreements:
        disagreements = ["No run disagrees with the others."]
    disagreements += series.problems
    if series.instrument is not None:
        disagreements += series.instrument.text
    if not (tables or disagreements):
        return []
    body = [html.heading("Series")]
    if tables:
        body.append(html.table(tables[0]))
    body.append(html.notes(disagreements))
    if series.fits:
        with styled():
            body += save_figures([figures_contact.series_figure(series)], files).values()
    body += [html.table(table) for table in tables[1:]]
    save_tables(tables, files)
    return body


_ORDER = (
    "kind-damping", "kind-hardness", "kind-decrement", "kind-period", "kind-plane", "instrument",
    "parameters",
    ("quality", "adhesion"),
    "conditions", "fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory", "fig12-decay", "damping",
    "fig13-period", "residuals", "position-errors",
    "spectrum", "witness", "table4-loops", "work", "losses", "laws", "waveform", "moments",
 "correlation", "budget",
)  # fmt: skip
"""Order of the tables and figures of a run; small tables in a tuple stand side by side."""


def _run(run: RunData, files: Path, *, single: bool) -> dict[str, str]:
    """The parts of a run in their order, figures and tables by their names."""
    files.mkdir(parents=True, exist_ok=True)
    curves = curves_of(run.results)
    tables = run_tables(run, curves)
    save_tables(tables, files)
    tables_shown = {table.name: html.table(table) for table in tables if table.shown}
    with styled():
        figures = save_figures(_drawings(run, curves), files)
    body = {"heading": html.heading(run.title)}
    if not single:
        body["said"] = html.paragraph(run_sentence(run)) + html.notes(notes_of(run))
    if run.results.instrument is not None:
        body["instrument-said"] = html.notes(run.results.instrument.text)
    for part in _ORDER:
        if isinstance(part, tuple):
            body["+".join(part)] = html.side_by_side([_pop(name, tables_shown, figures) for name in part])
        else:
            body[part] = _pop(part, tables_shown, figures)
    return {name: text for name, text in {**body, **tables_shown, **figures}.items() if text}


def _pop(name: str, tables: dict[str, str], figures: dict[str, str]) -> str:
    """Remove and return the HTML of the table and the figure of this name, as far as they exist."""
    return "\n".join(found.pop(name) for found in (tables, figures) if name in found)


def _drawings(run: RunData, curves: Curves | None) -> list[ReportFigure]:
    motion, points = run.motion, run.results.points
    fit = run.results.fits.get(FitMethod.EXACT)
    period_s = _period(run) if fit is None else fit.mean_period_s.value
    drawings = [figures_motion.frame_figure(run.picture)] if run.picture else []
    if len(motion.time_s) > 1:
        drawings.append(figures_motion.slow_figure(motion, period_s))
        if np.isfinite(motion.x).any():
            drawings += [
                figures_motion.fast_figure(motion, period_s),
                figures_motion.trajectory_figure(motion, period_s),
            ]
    if len(points) >= 3:
        drawings.append(figures_laws.decay_figure(points, curves, motion.unit))
    if run.results.damping is not None and not run.results.fits:
        drawings.append(damped_figure(run.results, motion.unit))
    if run.results.position_errors is not None:
        drawings.append(position_error_figure(run.results.position_errors))
    if run.results.instrument is not None or run.is_table:
        # numbers of the paper's figures mean nothing for other pendulums
        drawings = [
            replace(each, title=re.sub(r"^Fig\. \d+: (.)", lambda found: found[1].upper(), each.title))
            for each in drawings
        ]
    if run.results.instrument is not None:
        drawings += instrument_figures(run.results, points)
    if run.results.laws is not None and run.results.laws.without_law is not None:
        drawings.append(figures_laws.moments_figure(run.results.laws, run.results.laws.without_law))
    pendulum = run.results.pendulum
    if curves is not None and pendulum is not None and fit is not None:
        exact = fit.contact()
        drawings += [
            figures_laws.period_figure(curves),
            figures_laws.residual_figure(points, curves, fit.outliers),
            figures_laws.loss_figure(points, exact, pendulum),
        ]
        # with a negative power there is no friction moment at rest, and no closed loop
        for work in run.results.work_per_cycle[:1] if exact.p >= 0 else ():
            known = not math.isnan(work.adhesive_4at_j.value)
            drawings.append(figures_contact.loop_figure(exact, pendulum, work.amplitude_arcsec, has_c=known))
        if run.spectrum is not None:
            unit = motion.unit
            drawings.append(
                figures_motion.spectrum_figure(run.spectrum, unit.shown, unit.shown_size, fit.ground)
            )
        witness = run.results.witness
        if witness is not None and witness.spectra is not None:
            drawings.append(witness_figure(witness.spectra))
    return drawings


def _period(run: RunData) -> float:
    """Mean period of the turning points, for the length of the detail views."""
    points = run.results.points
    if len(points) < 2:
        return _DEFAULT_PERIOD_S
    return float(2 * (points.time_s[-1] - points.time_s[0]) / (points.index[-1] - points.index[0]))


def save_figures(drawings: Sequence[ReportFigure], files: Path) -> dict[str, str]:
    """Write every figure as a file, frames as PNG, others as SVG; returns the HTML of each by name."""
    atomic_write.take_away_leftovers(files)
    found = {}
    for drawing in drawings:
        is_frame = drawing.name.endswith("frame")
        data = png(drawing) if is_frame else svg(drawing)
        atomic_write.replace(files / f"{drawing.name}.{'png' if is_frame else 'svg'}", data)
        found[drawing.name] = html.picture(drawing, data, "image/png" if is_frame else "image/svg+xml")
    return found


def save_tables(tables: Sequence[Table], files: Path) -> None:
    """Write every table as CSV."""
    atomic_write.take_away_leftovers(files)
    for table in tables:
        atomic_write.replace(files / f"{table.name}.csv", table.csv().encode())


def _provenance(source: ReportSource) -> list[str]:
    name, sha256 = source.results
    body = [html.heading("Provenance"), html.facts([(f"sha256 of {name}", sha256)])]
    for run in source.runs:
        rows = list(run.provenance["file"].items())
        for section in ("calibration", "record", "session", "environment", "camera", "frame", "versions"):
            rows += [
                (f"{section}: {key}", text) for key, text in run.provenance.get(section, {}).items() if text
            ]
        what = "The record and its circumstances"
        title = what if len(source.runs) == 1 else f"{what}, {run.title}"
        body.append(html.folded_section(title, [html.facts(rows)]))
    configuration = source.runs[0].provenance.get("configuration")
    if configuration:
        columns = f'<div class="columns">{html.facts(list(configuration.items()))}</div>'
        body.append(html.folded_section("Configuration and calibration", [columns]))
    return body


def make_table_report(table: AnalysedTable, folder: Path) -> Sequence[tuple[str, Path]]:
    """Write positions.csv and the report of the results in a folder; returns the files with their names.

    Raises RecordError if a file cannot be written.
    """
    return [("positions", write_positions(table.trajectory, folder)), ("report", make_report(folder))]


def latex_tables(folder: Path) -> Mapping[str, str]:
    """LaTeX of every table of the report and of the series, by file name (`run-1-parameters.tex`).

    Raises RecordError for a folder without results, or whose record is missing.
    """
    source = read_source(folder)
    found = dict[str, Table]()
    for number, run in enumerate(source.runs, start=1):
        found |= {f"run-{number}-{each.name}.tex": each for each in run_tables(run, None)}
    if source.series is not None:
        found |= {f"{each.name}.tex": each for each in series_tables(source.series)}
    return {name: latex_table(each, Path(name).stem) for name, each in found.items() if each.shown}
