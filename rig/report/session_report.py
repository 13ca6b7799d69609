"""`rig report`: a session's HTML page, its figures as SVG and PNG, its tables as CSV."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.record import whole_file
from processing.contact import SurfaceEnergy
from processing.contact.laws import DEFAULT_LAW
from processing.errors import RecordError
from processing.estimate import Estimate
from processing.fit import Budget, Determination, FitMethod
from processing.instruments import INSTRUMENTS
from rig.analysis import (
    Curves,
    RunResults,
    Series,
    TableDecay,
    budget_of,
    curves_of,
    decay_lines,
    determined_text,
    dominant_text,
    remarks,
    results_path,
    series_verdicts,
    whole_result,
)
from rig.presentation import Table, plain, quantity
from rig.report import figures_contact, figures_ground, figures_laws, figures_motion, html
from rig.report.drawing import ReportFigure, png, styled, svg
from rig.report.figures_damping import damped_figure
from rig.report.figures_instruments import instrument_figures
from rig.report.figures_motion import place_figure
from rig.report.figures_witness import witness_figure
from rig.report.run_data import ReportSource, RunData
from rig.report.source import read_source
from rig.report.tables import run_tables
from rig.report.tables_instruments import headline
from rig.report.tables_uncertainty import budget_table, series_table

_DEFAULT_PERIOD_S = 4.0
_NOT_STATED = "not stated"


def make_report(folder: Path, output: Path | None = None) -> Path:
    """Write the report of a session folder (or of one results file in it); returns the HTML file.

    Figures and tables go into a folder of the same name beside the HTML file. A report made before is
    replaced: it holds nothing that is not in results and records.

    Raises RecordError for a folder without results.json, a missing record, a file that cannot be
    written.
    """
    source = read_source(folder)
    # results-2.json is reported in report-2.html
    name = results_path(folder).stem.replace("results", "report", 1)
    target = output or source.folder / f"{name}.html"
    files = target.parent / target.stem
    try:
        files.mkdir(parents=True, exist_ok=True)
        whole_file.take_away_leftovers(target.parent, target.name)
        series = [] if source.series is None else _series(source.series, files)
        alone = len(source.runs) == 1
        runs = [_run(run, files / f"run-{k}", alone=alone) for k, run in enumerate(source.runs, start=1)]
        # the first decay is seen at once, beside the verdict; each of the others with its run
        body = [*_summary(source, runs[0].pop("fig12-decay", "")), *series]
        for each in runs:
            body += each.values()
        body += _provenance(source)
        title, subtitle = _title(source)
        whole_file.replace(
            target, html.page(title, subtitle, body, results_sha256=source.results[1]).encode()
        )
    except OSError as error:
        raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target


def draw_run(source: Path, number: int) -> list[ReportFigure]:
    """The figures of one run, counted from 1, of a session's folder or a results file.

    Raises RecordError where there are no results, no such run, or no record.
    """
    runs = read_source(source).runs
    if not 1 <= number <= len(runs):
        raise RecordError(f"{source}: run {number} is not there; it has runs 1 to {len(runs)}")
    run = runs[number - 1]
    return _drawings(run, _curves(run))


def _title(source: ReportSource) -> tuple[str, str]:
    first = source.runs[0]
    session = first.provenance.get("session", {})
    name = source.folder.resolve().name
    if isinstance(first.results, TableDecay):
        name = Path(first.results.record).name + (f", run {first.results.run}" if first.results.run else "")
    title = session.get("sample") or name
    counted = "decay" if first.of_table else "run"
    words = [f"{len(source.runs)} {counted}{'s' if len(source.runs) > 1 else ''}"]
    if session.get("operator"):
        words.append(f"operator {session['operator']}")
    words += [word for word in (session.get("contact_history"), session.get("notes")) if word]
    if any(run.simulated for run in source.runs):
        title = f"SIMULATED: {title}"
    results = first.results
    what = "Free decay of a pendulum on one ball" if results.fits else "Free decay of a pendulum"
    if results.instrument is not None:
        what = INSTRUMENTS[results.instrument.kind].title
    return title, f"{what}: " + ", ".join(words)


def _summary(source: ReportSource, decay: str) -> list[str]:
    """The verdict with the parameters beside the first decay; below it how all this was measured."""
    run, series = source.runs[0].results, source.series
    body = []
    if any(data.simulated for data in source.runs):
        body.append(
            '<div class="warn">SIMULATED: every number comes from the simulated rig; '
            "nothing was measured.</div>"
        )
    first = [html.verdict(_verdict(source))]
    exact, energy, verdicts = _headline(run, series)
    if exact:
        budget = run.budget if series is None else series.budget
        first.append(html.key_values(_key_results(exact, energy, verdicts, budget)))
        what = "combined over the runs" if series is not None else "of the run"
        first.append(
            html.paragraph(
                f"Exact fit {what}, value ± standard uncertainty: of the whole budget where it is named "
                "what dominates it, else of the swings alone.",
                "note",
            )
        )
    if run.instrument is not None:
        found = headline(run.instrument, None if series is None else series.instrument)
        first.append(html.key_values(found))
        first.append(html.paragraph("Value ± standard uncertainty of the swings.", "note"))
    body.append(html.first_screen(first, [decay]))
    body.append(html.heading("Summary"))
    body.append(html.facts(_circumstances(source)))
    for data in source.runs:
        body.append(html.paragraph(_sentence(data)))
        if data.results.problem:
            body.append(f'<div class="warn">{html.escape("No fit: " + data.results.problem)}</div>')
            body.append(html.notes(decay_lines(data.results)))
    if len(source.runs) == 1:
        body.append(html.notes(_notes(source.runs[0])))
    return body


def _verdict(source: ReportSource) -> list[tuple[str, str]]:
    """The result, what limits it and what to do, and whether the conditions of the runs held."""
    first = source.runs[0].results
    found = whole_result(first, None if source.series is None else source.series.budget)
    lines = [(found.text or "Nothing was fitted", "")]
    if found.limits:
        limited = ", ".join(f"{one.name} {100 * one.share:.0f} %" for one in found.limits[:2])
        lines.append((f"Its uncertainty: {limited}. Next: {'; '.join(found.next_steps)}.", ""))
    judged = [item for run in source.runs for item in run.results.conditions]
    broken = [item for item in judged if not item.ok]
    doubtful = [item for item in judged if item.ok and item.remedy]
    if broken:
        names = ", ".join(dict.fromkeys(item.name for item in broken))
        lines.append((f"Conditions NOT met: {names}", "bad"))
    elif judged:
        names = ", ".join(dict.fromkeys(item.name for item in doubtful))
        lines.append(
            ("Conditions met" + (f", with a warning of {names}" if names else " in all respects"), "good")
        )
    return lines


def _circumstances(source: ReportSource) -> list[tuple[str, str]]:
    """Who measured, when each run began and how long it lasted, what surrounded it, and with what."""
    first = source.runs[0]
    rows = []
    if first.results.instrument is not None:
        kind = INSTRUMENTS[first.results.instrument.kind]
        rows.append(("instrument", f"{kind.sentence.rstrip('.')} ({kind.kind})"))
    rows.append(("operator", first.provenance.get("session", {}).get("operator", "") or _NOT_STATED))
    around = [_surroundings(run) for run in source.runs]
    alike = len(set(around)) == 1
    for run, surroundings in zip(source.runs, around, strict=True):
        began = run.provenance["file"].get("began", "")
        text = f"{began and f'began {began}, '}lasted {_lasted(run)}"
        rows.append((run.title, text if alike else f"{text}; {surroundings or f'air {_NOT_STATED}'}"))
    if alike:
        rows.append(("surroundings", around[0] or _NOT_STATED))
    if first.of_table:
        rows.append(("positions from", first.results.record))
    else:
        driver = first.provenance.get("camera", {}).get("driver", "")
        stored = "a film or a folder of images" if driver == "files" else "a camera"
        rows.append(("frames from", "the simulated rig" if first.simulated else stored))
    return [(name, text) for name, text in rows if text]


def _lasted(run: RunData) -> str:
    time_s = run.motion.time_s if len(run.motion.time_s) else run.points.time_s
    length_s = time_s[-1] - time_s[0] if len(time_s) else 0.0
    return f"{length_s / 60:.1f} min"


def _surroundings(run: RunData) -> str:
    """Air and history of the contact as results have them; of older ones the air as stated."""
    found = run.results.surroundings
    stated = {name: float(text) for name, text in run.provenance.get("environment", {}).items()}
    known = stated if found is None else found.known()
    said = []
    for name, value in known.items():
        shown = quantity(name)
        said.append(f"{shown.name} {plain(value * shown.factor, 4)} {shown.unit}")
    return ", ".join(said)


def _headline(
    run: RunResults, series: Series | None
) -> tuple[Mapping[str, Estimate], SurfaceEnergy | None, Mapping[str, Determination]]:
    """Parameters, surface energy and verdicts that are reported first: those of the series, or of the run."""
    combined = {} if series is None else series.fits.get(FitMethod.EXACT, {})
    if series is not None and combined:
        parameters = {n: Estimate(item.value, item.standard_uncertainty) for n, item in combined.items()}
        return parameters, series.surface_energy_j_per_m2, series_verdicts(combined)
    fit = run.fits.get(FitMethod.EXACT)
    return {} if fit is None else fit.parameters, run.surface_energy_j_per_m2, run.verdicts()


def _key_results(
    exact: Mapping[str, Estimate],
    energy: SurfaceEnergy | None,
    verdicts: Mapping[str, Determination],
    budget: Mapping[str, Budget],
) -> list[tuple[str, str]]:
    """Labels and values; with the whole budget and what dominates it where the apparatus has a part."""
    items = [(name, exact[name]) for name in DEFAULT_LAW.names(drag=True) if name in exact]
    if energy is not None:
        items.insert(0, ("surface_energy_table2_j_per_m2", energy.table2))
    shown = []
    for name, value in items:
        item, label = budget_of(name, budget, verdicts), quantity(name).label
        if item is None:
            shown.append((label, determined_text(name, value, verdicts)))
        else:
            text = quantity(name).text(item.value, item.standard_uncertainty)
            shown.append((f"{label} (u: {dominant_text(item)})", text))
    return shown


def _sentence(run: RunData) -> str:
    results, unit = run.results, run.motion.unit.shown
    left_out = len(run.stored.left_out_flags)
    taken = (
        f"{results.frames} rows"
        if run.of_table
        else f"{results.frames} frames, {results.dropped_frames} dropped"
    )
    return (
        f"{run.title}: {results.half_cycles_text(unit, ' from ')} in {_lasted(run)}; {taken}; "
        f"{left_out} half-cycle{'s' if left_out != 1 else ''} flagged and left out."
    )


def _notes(run: RunData) -> list[str]:
    return [*remarks(run.results), *run.results.warnings, *run.notes]


def _series(series: Series, files: Path) -> list[str]:
    tables = [series_table(series), budget_table(series.budget, "series-budget")]
    tables = [table for table in tables if table.rows]
    apart = [
        f"Run {item.run} disagrees with the others in {quantity(item.name).symbol}: "
        f"{item.deviation:+.1f} standard uncertainties."
        for item in series.disagreements
    ]
    if FitMethod.EXACT in series.fits and not apart:
        apart = ["No run disagrees with the others."]
    apart += series.problems
    if series.instrument is not None:
        apart += series.instrument.text
    if not (tables or apart):
        return []
    body = [html.heading("Series", new_page=True)]
    if tables:
        body.append(html.table(tables[0]))
    body.append(html.notes(apart))
    if series.fits:
        with styled():
            body += save_figures([figures_contact.series_figure(series)], files)
    body += [html.table(table) for table in tables[1:]]
    save_tables(tables, files)
    return body


_ORDER = (
    "kind-damping", "kind-hardness", "kind-decrement", "kind-period", "kind-plane", "instrument",
    "parameters",
    ("quality", "hertz"),
    "conditions", "fig12-decay", "damping", "fig13-period", "fig14-smoother", "residuals", "position-errors",
    "spectrum", "witness", "table4-loops", "work", "losses", "laws", "waveform", "moments",
    ("drag", "identifiability"),
    "correlation", "budget", "monte-carlo", "fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory",
)  # fmt: skip
"""Tables and figures of a run as they follow one another; small tables stand side by side."""


def _run(run: RunData, files: Path, *, alone: bool) -> dict[str, str]:
    """The parts of a run in their order, figures and tables by their names."""
    files.mkdir(parents=True, exist_ok=True)
    curves = _curves(run)
    tables = run_tables(run, curves)
    save_tables(tables, files)
    tables_shown = {table.name: html.table(table) for table in tables if table.shown}
    with styled():
        figures = {d.name: text for d, text in _pictures(_drawings(run, curves), files)}
    body = {"heading": html.heading(run.title, new_page=not alone)}
    if not alone:
        body["said"] = html.paragraph(_sentence(run)) + html.notes(_notes(run))
    if run.results.instrument is not None:
        body["instrument-said"] = html.notes(run.results.instrument.text)
    for part in _ORDER:
        if isinstance(part, tuple):
            body["+".join(part)] = html.side_by_side([_taken(name, tables_shown, figures) for name in part])
        else:
            body[part] = _taken(part, tables_shown, figures)
    return {name: text for name, text in {**body, **tables_shown, **figures}.items() if text}


def _taken(name: str, tables: dict[str, str], figures: dict[str, str]) -> str:
    """What has this name, a table before a figure, and both where both have it."""
    return "\n".join(found.pop(name) for found in (tables, figures) if name in found)


def _curves(run: RunData) -> Curves | None:
    return curves_of(run.points, run.results) if len(run.points) >= 3 else None


def _drawings(run: RunData, curves: Curves | None) -> list[ReportFigure]:
    motion, points = run.motion, run.points
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
        drawings.append(damped_figure(run.stored, run.results, motion.unit, "damping"))
    if run.results.position_errors is not None:
        drawings.append(place_figure(run.results.position_errors))
    if run.results.instrument is not None or run.of_table:
        # figures of the paper have its numbers, which mean nothing here
        drawings = [
            replace(each, title=re.sub(r"^Fig\. \d+: (.)", lambda found: found[1].upper(), each.title))
            for each in drawings
        ]
    if run.results.instrument is not None:
        drawings += instrument_figures(run.results.instrument, points)
    if run.results.laws is not None and run.results.laws.without_law is not None:
        drawings.append(figures_laws.moments_figure(run.results.laws, run.results.laws.without_law))
    pendulum = run.results.pendulum
    if curves is not None and pendulum is not None and fit is not None:
        exact = fit.contact()
        drawings += [
            figures_laws.period_figure(curves),
            figures_laws.smooth_figure(curves),
            figures_laws.residual_figure(points, curves, fit.outliers),
            figures_laws.loss_figure(points, exact, pendulum),
            figures_contact.correlation_figure(fit.correlation),
        ]
        for work in run.results.work_per_cycle[:1]:
            known = not math.isnan(work.adhesive_4at_j.value)
            drawings.append(figures_contact.loop_figure(exact, pendulum, work.amplitude_arcsec, sees_c=known))
        if run.spectrum is not None:
            unit = motion.unit
            drawings.append(
                figures_ground.spectrum_figure(run.spectrum, unit.shown, unit.shown_size, fit.ground)
            )
        witness = run.results.witness
        if witness is not None and witness.spectra is not None:
            drawings.append(witness_figure(witness.spectra))
    return drawings


def _period(run: RunData) -> float:
    """Mean period of the turning points, for the length of the detail views."""
    points = run.points
    if len(points) < 2:
        return _DEFAULT_PERIOD_S
    return float(2 * (points.time_s[-1] - points.time_s[0]) / (points.index[-1] - points.index[0]))


def _pictures(drawings: Sequence[ReportFigure], files: Path) -> list[tuple[ReportFigure, str]]:
    """Write SVG and PNG of every figure; each with its HTML.

    A frame is pixels, and goes into the page as PNG; everything else is lines, as SVG.
    """
    whole_file.take_away_leftovers(files)
    found = []
    for drawing in drawings:
        vector, pixels = svg(drawing), png(drawing)
        whole_file.replace(files / f"{drawing.name}.svg", vector)
        whole_file.replace(files / f"{drawing.name}.png", pixels)
        inside = (pixels, "image/png") if drawing.name.endswith("frame") else (vector, "image/svg+xml")
        found.append((drawing, html.picture(drawing, *inside)))
    return found


def save_figures(drawings: Sequence[ReportFigure], files: Path) -> list[str]:
    """Write figures as SVG and PNG; returns their HTML in order."""
    return [text for _, text in _pictures(drawings, files)]


def save_tables(tables: Sequence[Table], files: Path) -> None:
    """Write every table as CSV."""
    whole_file.take_away_leftovers(files)
    for table in tables:
        whole_file.replace(files / f"{table.name}.csv", table.csv().encode())


def _provenance(source: ReportSource) -> list[str]:
    name, sha256 = source.results
    body = [html.heading("Provenance", new_page=True), html.facts([(f"sha256 of {name}", sha256)])]
    for run in source.runs:
        rows = list(run.provenance["file"].items())
        for section in ("calibration", "record", "session", "environment", "camera", "frame", "versions"):
            rows += [
                (f"{section}: {key}", text) for key, text in run.provenance.get(section, {}).items() if text
            ]
        what = "The record and its circumstances"
        title = what if len(source.runs) == 1 else f"{what}, {run.title}"
        body.append(html.folded(title, [html.facts(rows)]))
    configuration = source.runs[0].provenance.get("configuration")
    if configuration:
        columns = f'<div class="columns">{html.facts(list(configuration.items()))}</div>'
        body.append(html.folded("Configuration and calibration", [columns]))
    return body
