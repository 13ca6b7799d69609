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
    main_result,
    main_sources,
    named,
    remarks,
    results_path,
)
from rig.intake import write_positions
from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.drawing import ReportFigure
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
    figures = target.parent / target.stem
    with translated_file_errors(target):
        series = [] if source.series is None else _series(source, source.series, figures)
        is_single = len(source.runs) == 1
        runs = [_run(run, figures / f"run-{k}", is_single=is_single) for k, run in enumerate(source.runs, 1)]
        # the first decay is shown at the top beside the verdict, every other with its run
        body = [*_summary_of(source, runs[0].pop("fig12-decay", "")), *series]
        for parts in runs:
            body += parts.values()
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
        name = source if isinstance(source, Path) else "results"
        raise RecordError(f"{name}: run {number} is not there; it has runs 1 to {len(runs)}")
    run = runs[number - 1]
    return _drawings(run, curves_of(run.results))


def _series(source: ReportSource, series: Series, folder: Path) -> list[str]:
    tables = [table for table in series_tables(series) if table.shown]
    sentences = [
        f"{source.runs[item.run - 1].title} disagrees with the others in {quantity(item.name).symbol}: "
        f"{item.deviation:+.1f} standard uncertainties."
        for item in series.disagreements
    ]
    if FitMethod.EXACT in series.fits and not sentences:
        sentences = ["No run disagrees with the others."]
    sentences += series.problems
    if series.instrument is not None:
        sentences += series.instrument.lines
    if not (tables or sentences):
        return []
    first, others = [html.table(table) for table in tables[:1]], [html.table(table) for table in tables[1:]]
    drawings = html.save_figures(
        folder, lambda: [figures_contact.series_figure(series)] if series.fits else []
    )
    return [html.heading("Series"), *first, html.remark_list(sentences), *drawings.values(), *others]


_ORDER = (
    "kind-damping", "kind-decrement", "kind-period", "kind-plane", "instrument",
    "parameters", "decay",
    ("quality", "adhesion"),
    "conditions", "fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory", "fig12-decay", "damping",
    "fig13-period", "residuals", "position-errors",
    "table4-loops", "work", "losses", "laws", "moments", "correlation", "budget",
)  # fmt: skip
"""Order of the tables and figures of a run; small tables in a tuple stand side by side."""


def _run(run: RunData, folder: Path, *, is_single: bool) -> dict[str, str]:
    """The parts of a run in their order, figures and tables by their names."""
    curves = curves_of(run.results)
    tables = {table.name: html.table(table) for table in run_tables(run.results)}
    figures = html.save_figures(folder, lambda: _drawings(run, curves))
    body = {"heading": html.heading(run.title)}
    if not is_single:
        body["remarks"] = html.paragraph(_run_sentence(run)) + html.remark_list(_notes_of(run))
    if run.results.instrument is not None:
        body["instrument-remarks"] = html.remark_list(run.results.instrument.text)
    for name in _ORDER:
        if isinstance(name, tuple):
            # small tables next to each other where the page is wide enough
            contents = (_pop(one_name, tables, figures) for one_name in name)
            cells = "".join(f"<div>{content}</div>" for content in contents if content)
            body["+".join(name)] = f'<div class="side">{cells}</div>' if cells else ""
        else:
            body[name] = _pop(name, tables, figures)
    return {name: text for name, text in {**body, **tables, **figures}.items() if text}


def _pop(name: str, tables: dict[str, str], figures: dict[str, str]) -> str:
    """Remove and return the HTML of the table and the figure of this name, as far as they exist."""
    return "\n".join(parts.pop(name) for parts in (tables, figures) if name in parts)


def _drawings(run: RunData, curves: Curves | None) -> list[ReportFigure]:
    motion, points = run.motion, run.results.points
    fit = run.results.fits.get(FitMethod.EXACT)
    # for the length of the detail views
    period_s = mean_period(points) if len(points) > 1 else _DEFAULT_PERIOD_S
    drawings = [figures_motion.frame_figure(run.picture)] if run.picture else []
    if len(motion.time_s) > 1:
        drawings += figures_motion.motion_figures(motion, period_s)
    if len(points) >= 3:
        drawings.append(figures_laws.decay_figure(points, curves, motion.unit))
    if run.results.damping is not None and len(points) and not run.results.fits:
        drawings.append(figures_motion.damped_figure(run.results, motion.unit))
    if run.results.position_errors is not None:
        drawings.append(figures_motion.position_error_figure(run.results.position_errors))
    if run.results.instrument is not None or run.is_table:
        # numbers of the paper's figures mean nothing for other pendulums
        drawings = [
            replace(figure, title=re.sub(r"^Fig\. \d+: (.)", lambda match: match[1].upper(), figure.title))
            for figure in drawings
        ]
    if run.results.instrument is not None:
        drawings += figures_contact.instrument_figures(run.results, points)
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
    body = [html.heading("Provenance"), html.two_columns([(f"sha256 of {name}", sha256)])]
    for run in source.runs:
        rows = list(run.provenance["file"].items())
        for section in ("calibration", "record", "session", "environment", "camera", "frame", "versions"):
            rows += [
                (f"{section}: {key}", text) for key, text in run.provenance.get(section, {}).items() if text
            ]
        suffix = "" if len(source.runs) == 1 else f", {run.title}"
        title = f"The record and its circumstances{suffix}"
        body.append(html.folded_section(title, [html.two_columns(rows)]))
    configuration = source.runs[0].provenance.get("configuration")
    if configuration:
        columns = f'<div class="columns">{html.two_columns(list(configuration.items()))}</div>'
        body.append(html.folded_section("Configuration and calibration", [columns]))
    return body


def make_table_report(table: AnalysedTable, folder: Path) -> Sequence[tuple[str, Path]]:
    """Write positions.csv and the report of the results in a folder; returns the files with their names."""
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
    noun = "decay" if first.is_table else "run"
    texts = [f"{len(source.runs)} {noun}{'s' if len(source.runs) > 1 else ''}"]
    if session.get("operator"):
        texts.append(f"operator {session['operator']}")
    texts += filter(None, (session.get("contact_history"), session.get("notes")))
    if any(run.results.simulated for run in source.runs):
        title = f"SIMULATED: {title}"
    results = first.results
    subject = "Free decay of a pendulum on one ball" if results.fits else "Free decay of a pendulum"
    if results.instrument is not None:
        subject = INSTRUMENTS[results.instrument.kind].title
    return title, f"{subject}: " + ", ".join(texts)


def _summary_of(source: ReportSource, decay: str) -> list[str]:
    """The verdict with the parameters beside the first decay; below it the circumstances."""
    run, series = source.runs[0].results, source.series
    quoted, quoted_runs = _quoted_results(source)
    body = []
    if any(data.results.simulated for data in source.runs):
        body = [html.warning("SIMULATED: every number comes from the simulated rig; nothing was measured.")]
    first = [html.verdict_list(_verdict(source))]
    if quoted.contact:
        origin = "combined over the runs" if quoted is series else f"of {quoted_runs[0].title}"
        note = (
            f"Exact fit {origin}, value ± standard uncertainty: of swings and apparatus together where "
            "the main sources are named, otherwise of the swings alone."
        )
        first += [html.headline_values(_headlines(quoted, quoted.budget)), html.paragraph(note, "note")]
    if run.instrument is not None:
        values = headline(run, None if series is None else series.instrument)
        note = "Value ± standard uncertainty of the swings."
        first += [html.headline_values(values), html.paragraph(note, "note")]
    # seen without scrolling: two columns, verdict and decay
    body.append(f'<div class="first"><div>{"".join(first)}</div><div>{decay}</div></div>')
    body += [html.heading("Summary"), html.two_columns(_circumstances(source))]
    for data in source.runs:
        body.append(html.paragraph(_run_sentence(data)))
        if data.results.problem:
            problem = html.warning(f"No fit: {data.results.problem}")
            body += [problem, html.remark_list(decay_lines(data.results))]
    if len(source.runs) == 1:
        body.append(html.remark_list(_notes_of(source.runs[0])))
    return body + (_text_to_copy(source, quoted, quoted_runs) if quoted.contact else [])


def _quoted_results(source: ReportSource) -> tuple[Series | RunResults, Sequence[RunData]]:
    """The results that the page quotes, and their runs: the series, else the first run with a fit."""
    if source.series is not None and source.series.table:
        return source.series, source.series.combined(source.runs)
    run = next((run for run in source.runs if run.results.contact), source.runs[0])
    return run.results, [run]


def _verdict(source: ReportSource) -> list[tuple[str, str]]:
    """The result, its largest uncertainties, the next step, and whether conditions were met, as lines."""
    result = main_result(_quoted_results(source)[1][0].results, source.series)
    lines = [(result.text or "Nothing was fitted", "")]
    if result.limits:
        limits = ", ".join(map(str, result.limits[:2]))
        lines.append((f"Its uncertainty: {limits}. Next: {'; '.join(result.next_steps)}.", ""))
    conditions = [condition for run in source.runs for condition in run.results.conditions]
    failures = dict.fromkeys(condition.name for condition in conditions if not condition.ok)
    if failures:
        lines.append((f"Conditions NOT met: {', '.join(failures)}", "bad"))
    elif names := ", ".join(dict.fromkeys(condition.name for condition in conditions if condition.remedy)):
        lines.append((f"Conditions met, with a warning of {names}", "good"))
    elif conditions:
        lines.append(("All conditions met", "good"))
    return lines


def _circumstances(source: ReportSource) -> list[tuple[str, str]]:
    """Operator, begin and duration of each run, ambient conditions, and source of the positions."""
    first = source.runs[0]
    rows = []
    if first.results.instrument is not None:
        description = INSTRUMENTS[first.results.instrument.kind]
        rows.append(("instrument", f"{description.sentence.rstrip('.')} ({description.kind})"))
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
        origin = "a film or a folder of images" if driver == "files" else "a camera"
        rows.append(("frames from", "the simulated rig" if first.results.simulated else origin))
    rows += [("laws of the contact", _PAPER)] if first.results.fits else []
    return [(name, text) for name, text in rows if text]


def _duration_text(run: RunData) -> str:
    time_s = run.motion.time_s if len(run.motion.time_s) else run.results.points.time_s
    length_s = time_s[-1] - time_s[0] if len(time_s) else 0.0
    return f"{length_s / 60:.1f} min"


def _ambient_conditions(run: RunData) -> str:
    """The ambient conditions of a run, in words."""
    known = {} if run.results.ambient is None else run.results.ambient.known()
    shown = [(quantity(name), value) for name, value in known.items()]
    return ", ".join(f"{form.name} {plain(value * form.factor, 4)} {form.unit}" for form, value in shown)


def _headlines(results: RowsByName, budget: Mapping[str, Budget]) -> list[tuple[str, str]]:
    """Labels and values; a label names the dominant source if the apparatus contributes to u."""
    names = (SURFACE_ENERGY, *DEFAULT_LAW.names(drag=True))
    rows = [results.rows[name] for name in names if name in results.rows]
    sources = [main_sources(row, budget) for row in rows]
    labels = [named(row.quantity) + (u and f" (u: {u})") for row, u in zip(rows, sources, strict=True)]
    return [(label, row.text) for label, row in zip(labels, rows, strict=True)]


def _text_to_copy(source: ReportSource, results: RowsByName, runs: Sequence[RunData]) -> list[str]:
    """A sentence with the results of `runs` and the reference to cite, and a row for LaTeX."""
    rows = [results.rows[name] for name in (*DEFAULT_LAW.names(), SURFACE_ENERGY) if name in results.rows]
    count = f"{len(runs)} runs" if len(runs) > 1 else "one run"
    half_cycles = sum(run.results.half_cycles for run in runs)
    program = "optical-pendulum-rig"
    version = source.runs[0].provenance.get("versions", {}).get(program, "")
    simulated = "SIMULATED: " if any(run.results.simulated for run in runs) else ""
    text = (
        f"{simulated}From {count} with {half_cycles} half-cycles: {', '.join(row.equation for row in rows)} "
        "(standard uncertainties of swings and apparatus together, as far as they are stated, or 95 % "
        f"limits; exact fit by {f'{program} {version}'.rstrip()} of the laws of {_PAPER})."
    )
    head = [quantity(row.quantity).label for row in rows]
    return [
        html.heading("To copy", 3),
        html.paragraph(text),
        f"<pre>{html.escape(latex_rows(head, [row.text for row in rows], _title_of(source)[0]))}</pre>",
    ]


def _run_sentence(run: RunData) -> str:
    """A sentence on the extent of a run: half-cycles, duration, frames, flags."""
    results = run.results
    left_out = len(results.stored.left_out_flags)
    dropped = " rows" if run.is_table else f" frames, {results.dropped_frames} dropped"
    return (
        f"{run.title}: {results.half_cycles_text(' from ')} in {_duration_text(run)}; "
        f"{results.frames}{dropped}; {left_out} half-cycle{'s' if left_out != 1 else ''} flagged and left "
        "out."
    )


def _notes_of(run: RunData) -> list[str]:
    """Remarks, warnings and notes of a run."""
    return [*remarks(run.results), *run.results.warnings, *run.notes]
