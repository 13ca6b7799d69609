"""`rig report`: a session's HTML page, and its figures as SVG."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from acquisition import atomic_write
from processing.contact.laws import DEFAULT_LAW
from processing.decay_summary import mean_period
from processing.errors import RecordError
from processing.fit import Budget, FitMethod
from processing.instruments import INSTRUMENTS
from rig.analysis import (
    SURFACE_ENERGY,
    AnalysedTable,
    Curves,
    RowsByName,
    RunResults,
    Series,
    SessionResults,
    curves_of,
    decay_lines,
    main_sources,
    named,
    remarks,
    results_path,
    whole_result,
)
from rig.intake import write_positions
from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.drawing import ReportFigure
from rig.report.figures_contact import instrument_figures
from rig.report.figures_motion import damped_figure, position_error_figure
from rig.report.source import ReportSource, RunData, read_source
from rig.report.tables import headline, run_tables, series_tables
from rig.terminal import latex_rows, plain, quantity, translated_file_errors

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
    with translated_file_errors(target):
        series = [] if source.series is None else _series(source, source.series, files)
        single = len(source.runs) == 1
        runs = [_run(run, files / f"run-{k}", single=single) for k, run in enumerate(source.runs, start=1)]
        # the first decay is shown at the top beside the verdict, every other with its run
        body = [*_summary_of(source, runs[0].pop("fig12-decay", "")), *series]
        for each in runs:
            body += each.values()
        body += _provenance(source)
        title, subtitle = _title_of(source)
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
    tables = [table for table in series_tables(series) if table.shown]
    disagreements = [
        f"{source.runs[item.run - 1].title} disagrees with the others in {quantity(item.name).symbol}: "
        f"{item.deviation:+.1f} standard uncertainties."
        for item in series.disagreements
    ]
    if FitMethod.EXACT in series.fits and not disagreements:
        disagreements = ["No run disagrees with the others."]
    disagreements += series.problems
    if series.instrument is not None:
        disagreements += series.instrument.lines
    if not (tables or disagreements):
        return []
    body = [html.heading("Series")]
    if tables:
        body.append(html.table(tables[0]))
    body.append(html.notes(disagreements))
    drawings = html.save_figures(
        files, lambda: [figures_contact.series_figure(series)] if series.fits else []
    )
    return [*body, *drawings.values(), *(html.table(table) for table in tables[1:])]


_ORDER = (
    "kind-damping", "kind-decrement", "kind-period", "kind-plane", "instrument",
    "parameters", "decay",
    ("quality", "adhesion"),
    "conditions", "fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory", "fig12-decay", "damping",
    "fig13-period", "residuals", "position-errors",
    "table4-loops", "work", "losses", "laws", "moments", "correlation", "budget",
)  # fmt: skip
"""Order of the tables and figures of a run; small tables in a tuple stand side by side."""


def _run(run: RunData, files: Path, *, single: bool) -> dict[str, str]:
    """The parts of a run in their order, figures and tables by their names."""
    curves = curves_of(run.results)
    tables = {table.name: html.table(table) for table in run_tables(run.results)}
    figures = html.save_figures(files, lambda: _drawings(run, curves))
    body = {"heading": html.heading(run.title)}
    if not single:
        body["said"] = html.paragraph(_run_sentence(run)) + html.notes(_notes_of(run))
    if run.results.instrument is not None:
        body["instrument-said"] = html.notes(run.results.instrument.text)
    for part in _ORDER:
        if isinstance(part, tuple):
            # small tables next to each other where the page is wide enough
            popped = (_pop(name, tables, figures) for name in part)
            inside = "".join(f"<div>{content}</div>" for content in popped if content)
            body["+".join(part)] = f'<div class="side">{inside}</div>' if inside else ""
        else:
            body[part] = _pop(part, tables, figures)
    return {name: text for name, text in {**body, **tables, **figures}.items() if text}


def _pop(name: str, tables: dict[str, str], figures: dict[str, str]) -> str:
    """Remove and return the HTML of the table and the figure of this name, as far as they exist."""
    return "\n".join(found.pop(name) for found in (tables, figures) if name in found)


def _drawings(run: RunData, curves: Curves | None) -> list[ReportFigure]:
    motion, points = run.motion, run.results.points
    fit = run.results.fits.get(FitMethod.EXACT)
    # for the length of the detail views
    period_s = mean_period(points) if len(points) > 1 else _DEFAULT_PERIOD_S
    period_s = period_s if fit is None else fit.mean_period_s.value
    drawings = [figures_motion.frame_figure(run.picture)] if run.picture else []
    if len(motion.time_s) > 1:
        drawings += figures_motion.motion_figures(motion, period_s)
    if len(points) >= 3:
        drawings.append(figures_laws.decay_figure(points, curves, motion.unit))
    if run.results.damping is not None and len(points) and not run.results.fits:
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
            drawings.append(figures_contact.loop_figure(exact, pendulum, work))
    return drawings


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
    return [("positions", write_positions(table.positions, folder)), ("report", make_report(folder))]


_NOT_STATED = "not stated"
_PAPER = "I. Gilavdary, S. Mekid, N. Riznookaya, Lubricants 2023, 11(2), 88, doi:10.3390/lubricants11020088"


def _title_of(source: ReportSource) -> tuple[str, str]:
    """Title and subtitle of the page."""
    first = source.runs[0]
    session = first.provenance.get("session", {})
    name = source.folder.resolve().name
    if first.results.decay is not None:
        run = first.results.decay.run
        name = Path(first.results.record).name + (f", run {run}" if run else "")
    title = session.get("sample") or name
    counted = "decay" if first.is_table else "run"
    words = [f"{len(source.runs)} {counted}{'s' if len(source.runs) > 1 else ''}"]
    if session.get("operator"):
        words.append(f"operator {session['operator']}")
    words += [word for word in (session.get("contact_history"), session.get("notes")) if word]
    if any(run.results.simulated for run in source.runs):
        title = f"SIMULATED: {title}"
    results = first.results
    what = "Free decay of a pendulum on one ball" if results.fits else "Free decay of a pendulum"
    if results.instrument is not None:
        what = INSTRUMENTS[results.instrument.kind].title
    return title, f"{what}: " + ", ".join(words)


def _summary_of(source: ReportSource, decay: str) -> list[str]:
    """The verdict with the parameters beside the first decay; below it the circumstances."""
    run, series = source.runs[0].results, source.series
    found, quoted = _quoted_results(source)
    body = []
    if any(data.results.simulated for data in source.runs):
        body.append(
            html.warning("SIMULATED: every number comes from the simulated rig; nothing was measured.")
        )
    first = [html.verdict(_verdict(source))]
    if found.contact:
        first.append(html.key_values(_key_results(found, found.budget)))
        what = "combined over the runs" if found is series else f"of {quoted[0].title}"
        first.append(
            html.paragraph(
                f"Exact fit {what}, value ± standard uncertainty: of swings and apparatus together where the "
                "main sources are named, otherwise of the swings alone.",
                "note",
            )
        )
    if run.instrument is not None:
        values = headline(run, None if series is None else series.instrument)
        first.append(html.key_values(values))
        first.append(html.paragraph("Value ± standard uncertainty of the swings.", "note"))
    # seen without scrolling: two columns, verdict and decay
    body.append(f'<div class="first"><div>{"".join(first)}</div><div>{decay}</div></div>')
    body.append(html.heading("Summary"))
    body.append(html.facts(_circumstances(source)))
    for data in source.runs:
        body.append(html.paragraph(_run_sentence(data)))
        if data.results.problem:
            body.append(html.warning(f"No fit: {data.results.problem}"))
            body.append(html.notes(decay_lines(data.results)))
    if len(source.runs) == 1:
        body.append(html.notes(_notes_of(source.runs[0])))
    return body + (_text_to_copy(source, found, quoted) if found.contact else [])


def _quoted_results(source: ReportSource) -> tuple[Series | RunResults, Sequence[RunData]]:
    """The results that the page quotes, and their runs: the series, else the first run with a fit."""
    if source.series is not None and source.series.table:
        return source.series, source.series.combined(source.runs)
    run = next((one for one in source.runs if one.results.contact), source.runs[0])
    return run.results, [run]


def _verdict(source: ReportSource) -> list[tuple[str, str]]:
    """The result, its largest uncertainties, the next step, and whether conditions were met, as lines."""
    found = whole_result(_quoted_results(source)[1][0].results, source.series)
    lines = [(found.text or "Nothing was fitted", "")]
    if found.limits:
        limited = ", ".join(map(str, found.limits[:2]))
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
            (f"Conditions met, with a warning of {names}" if names else "All conditions met", "good")
        )
    return lines


def _circumstances(source: ReportSource) -> list[tuple[str, str]]:
    """Operator, begin and duration of each run, ambient conditions, and source of the positions."""
    first = source.runs[0]
    rows = []
    if first.results.instrument is not None:
        kind = INSTRUMENTS[first.results.instrument.kind]
        rows.append(("instrument", f"{kind.sentence.rstrip('.')} ({kind.kind})"))
    rows.append(("operator", first.provenance.get("session", {}).get("operator", "") or _NOT_STATED))
    ambient = [_ambient_conditions(run) for run in source.runs]
    is_common = len(set(ambient)) == 1
    for run, conditions in zip(source.runs, ambient, strict=True):
        began = run.provenance["file"].get("began", "")
        text = f"{began and f'began {began}, '}lasted {_duration_text(run)}"
        rows.append((run.title, text if is_common else f"{text}; {conditions or f'air {_NOT_STATED}'}"))
    if is_common:
        rows.append(("ambient conditions", ambient[0] or _NOT_STATED))
    if first.is_table:
        rows.append(("positions from", first.results.record))
    else:
        driver = first.provenance.get("camera", {}).get("driver", "")
        stored = "a film or a folder of images" if driver == "files" else "a camera"
        rows.append(("frames from", "the simulated rig" if first.results.simulated else stored))
    rows += [("laws of the contact", _PAPER)] if first.results.fits else []
    return [(name, text) for name, text in rows if text]


def _duration_text(run: RunData) -> str:
    time_s = run.motion.time_s if len(run.motion.time_s) else run.results.points.time_s
    length_s = time_s[-1] - time_s[0] if len(time_s) else 0.0
    return f"{length_s / 60:.1f} min"


def _ambient_conditions(run: RunData) -> str:
    """The ambient conditions of a run, in words."""
    found = run.results.ambient
    texts = []
    for name, value in ({} if found is None else found.known()).items():
        shown = quantity(name)
        texts.append(f"{shown.name} {plain(value * shown.factor, 4)} {shown.unit}")
    return ", ".join(texts)


def _key_results(found: RowsByName, budget: Mapping[str, Budget]) -> list[tuple[str, str]]:
    """Labels and values; the label names the dominant source if the apparatus contributes to u."""
    names = [SURFACE_ENERGY, *DEFAULT_LAW.names(drag=True)]
    shown = []
    for row in (found.rows[name] for name in names if name in found.rows):
        sources = main_sources(row, budget)
        shown.append((named(row.quantity) + (f" (u: {sources})" if sources else ""), row.text))
    return shown


def _text_to_copy(source: ReportSource, found: RowsByName, quoted: Sequence[RunData]) -> list[str]:
    """A sentence with the values of the `quoted` runs and the reference to cite, and a row for LaTeX."""
    rows = [found.rows[name] for name in (*DEFAULT_LAW.names(), SURFACE_ENERGY) if name in found.rows]
    first = source.runs[0]
    several = f"{len(quoted)} runs" if len(quoted) > 1 else "one run"
    half_cycles = sum(data.results.half_cycles for data in quoted)
    version = first.provenance.get("versions", {}).get("optical-pendulum-rig", "")
    simulated = "SIMULATED: " if any(data.results.simulated for data in quoted) else ""
    values = ", ".join(row.equation for row in rows)
    text = (
        f"{simulated}From {several} with {half_cycles} half-cycles: {values} (standard uncertainties of "
        "swings and apparatus together, as far as they are stated, or 95 % limits; exact fit by "
        f"optical-pendulum-rig{f' {version}' if version else ''} of the laws of {_PAPER})."
    )
    head = [quantity(row.quantity).label for row in rows]
    return [
        html.heading("To copy", 3),
        html.paragraph(text),
        f"<pre>{html.escape(latex_rows(head, [row.text for row in rows], _title_of(source)[0]))}</pre>",
    ]


def _run_sentence(run: RunData) -> str:
    """A sentence on the extent of a run: half-cycles, duration, frames, flags."""
    results, unit = run.results, run.motion.unit.shown
    left_out = len(run.results.stored.left_out_flags)
    taken = (
        f"{results.frames} rows"
        if run.is_table
        else f"{results.frames} frames, {results.dropped_frames} dropped"
    )
    return (
        f"{run.title}: {results.half_cycles_text(unit, ' from ')} in {_duration_text(run)}; {taken}; "
        f"{left_out} half-cycle{'s' if left_out != 1 else ''} flagged and left out."
    )


def _notes_of(run: RunData) -> list[str]:
    """Remarks, warnings and notes of a run."""
    return [*remarks(run.results), *run.results.warnings, *run.notes]
