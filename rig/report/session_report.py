"""`rig report`: a session's HTML page, its figures as SVG and PNG, its tables as CSV."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from processing.contact.laws import PAPER
from processing.errors import RecordError
from processing.fit import FitMethod
from rig.analysis import (
    Curves,
    ReportSource,
    RunData,
    curves_of,
    parameters_of,
    pendulum_of,
    read_source,
    results_path,
)
from rig.presentation import Table, determined_text, number, plain, quantity, series_verdicts
from rig.report import figures_contact, figures_laws, figures_motion, html
from rig.report.drawing import Drawing, png, styled, svg
from rig.report.figures_instruments import instrument_figures
from rig.report.tables import run_tables
from rig.report.tables_uncertainty import budget_table, series_table

_DEFAULT_PERIOD_S = 4.0


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
    body = [*_summary(source)]
    try:
        files.mkdir(parents=True, exist_ok=True)
        if source.series:
            body += _series(source.series, files)
        for number_, run in enumerate(source.runs, start=1):
            body += _run(run, files / f"run-{number_}", alone=len(source.runs) == 1)
        body += _provenance(source)
        title, subtitle = _title(source)
        target.write_text(html.page(title, subtitle, body), encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return target


def _title(source: ReportSource) -> tuple[str, str]:
    session = source.runs[0].provenance.get("session", {})
    title = session.get("sample") or source.folder.resolve().name
    words = [f"{len(source.runs)} run{'s' if len(source.runs) > 1 else ''}"]
    if session.get("operator"):
        words.append(f"operator {session['operator']}")
    words += [word for word in (session.get("contact_history"), session.get("notes")) if word]
    what = "a pendulum on one ball" if source.runs[0].results.get("fits") else "a pendulum"
    return title, f"Free decay of {what}: " + ", ".join(words)


def _summary(source: ReportSource) -> list[str]:
    run = source.runs[0].results
    series, body = source.series, [html.heading("Summary")]
    exact = series.get(FitMethod.EXACT) or (run.get("fits") or {}).get(FitMethod.EXACT) or {}
    energy = series.get("surface_energy_j_per_m2") or run.get("surface_energy_j_per_m2") or {}
    if exact:
        verdicts = {item["name"]: item for item in run.get("identifiability") or []}
        if series.get(FitMethod.EXACT):
            verdicts = series_verdicts(exact)
        body.append(html.key_values(_key_results(exact, energy, verdicts)))
        what = "combined over the runs" if series else "of the run"
        body.append(
            html.paragraph(
                f"Exact fit {what}, value ± standard uncertainty of the swings; "
                "the budget adds the apparatus.",
                "note",
            )
        )
    for data in source.runs:
        body.append(html.paragraph(_sentence(data)))
        if data.results.get("problem"):
            body.append(f'<div class="warn">{html.escape("No fit: " + data.results["problem"])}</div>')
    if len(source.runs) == 1:
        body.append(html.notes(_doubts(source.runs[0])))
    return body


def _key_results(
    exact: Mapping[str, Any], energy: Mapping[str, Any], verdicts: Mapping[str, Any]
) -> list[tuple[str, str]]:
    items = []
    if energy:
        name = "surface_energy_table2_j_per_m2"
        value, u = number(energy["table2"], "value"), number(energy["table2"], "standard_uncertainty")
        items.append((quantity(name).label, determined_text(name, value, u, verdicts)))
    for name in PAPER.names():
        if name not in exact:
            continue
        value, u = number(exact, name), number(exact, name, "standard_uncertainty")
        items.append((quantity(name).label, determined_text(name, value, u, verdicts)))
    return items


def _sentence(run: RunData) -> str:
    results, unit = run.results, run.motion.unit
    first, last = number(results, "initial_amplitude_arcsec"), number(results, "final_amplitude_arcsec")
    length = run.motion.time_s[-1] - run.motion.time_s[0] if len(run.motion.time_s) else 0.0
    return (
        f"{run.title}: {results['half_cycles']} half-cycles from {first:.2f} to {last:.2f} {unit} in "
        f"{length / 60:.1f} min; {results['frames']} frames, {results['dropped_frames']} dropped; "
        f"{len(run.flagged)} half-cycle{'s' if len(run.flagged) != 1 else ''} flagged and left out."
    )


def _doubts(run: RunData) -> list[str]:
    results = run.results
    lines = [_drag_sentence(results["drag"])] if results.get("drag") else []
    pairs = results.get("strong_correlations") or []
    if pairs:
        names = ", ".join(f"{quantity(a).symbol} and {quantity(b).symbol} ({r:+.3f})" for a, b, r in pairs)
        lines.append(f"Hardly told apart by the data (correlation): {names}.")
    lines += [
        f"{item['text']}." for item in results.get("identifiability") or [] if item["verdict"] != "determined"
    ]
    return [*lines, *(results.get("notes") or []), *(results.get("warnings") or []), *run.notes]


def _drag_sentence(drag: Mapping[str, Any]) -> str:
    value, u = number(drag["drag_s"], "value"), number(drag["drag_s"], "standard_uncertainty")
    b, c = (100 * number(drag, f"relative_shift_{name}") for name in ("b", "c"))
    head = "A linear drag is in the data" if drag["significant"] else drag["text"].split(":")[0].capitalize()
    numbers = (
        f"{head}: {quantity('drag_s').text(value, u)} s, F = {plain(number(drag, 'f_statistic'), 3)} (chance "
        f"{plain(number(drag, 'p_value'), 2)}), AIC {number(drag, 'aic_difference'):+.1f}; "
        f"fitted with it, b moves by {b:+.2f} % and c by {c:+.2f} %."
    )
    return numbers.replace("-", "−")


def _series(series: Mapping[str, Any], files: Path) -> list[str]:
    body = [html.heading("Series", new_page=True)]
    tables = [series_table(series), budget_table(series.get("budget") or {}, "series-budget")]
    tables = [table for table in tables if table.rows]
    apart = [
        f"Run {item['run']} disagrees with the others in {quantity(item['name']).symbol}: "
        f"{number(item, 'deviation'):+.1f} standard uncertainties."
        for item in series.get("disagreements") or []
    ]
    if FitMethod.EXACT in series and not apart:
        apart = ["No run disagrees with the others."]
    apart += series.get("problems") or []
    if tables:
        body.append(html.table(tables[0]))
    body.append(html.notes(apart))
    if FitMethod.EXACT in series or FitMethod.ASYMPTOTIC in series:
        with styled():
            body += save_figures([figures_contact.series_figure(series)], files)
    body += [html.table(table) for table in tables[1:]]
    save_tables(tables, files)
    return body


def _run(run: RunData, files: Path, *, alone: bool) -> list[str]:
    files.mkdir(parents=True, exist_ok=True)
    curves = curves_of(run.points, run.results) if len(run.points) >= 3 else None
    tables = run_tables(run, curves)
    save_tables(tables, files)
    shown = {table.name: html.table(table) for table in tables if table.shown}
    with styled():
        figures = {d.name: text for d, text in _pictures(_drawings(run, curves), files)}

    def take(*names: str) -> list[str]:
        return [found.pop(name) for name in names for found in (shown, figures) if name in found]

    body = [html.heading(run.title, new_page=not alone)]
    if not alone:
        body.append(html.paragraph(_sentence(run)))
        body.append(html.notes(_doubts(run)))
    instrument = run.results.get("instrument") or {}
    body.append(html.notes(list(instrument.get("text") or [])))
    body += take("kind-decrement", "kind-period", "kind-plane")
    body += take("instrument", "parameters")
    body.append(html.side_by_side(take("quality", "hertz")))
    body += take("fig12-decay", "fig13-period", "fig14-smoother", "residuals")
    body += take("table4-loops", "work", "losses")
    body.append(html.side_by_side(take("drag", "identifiability")))
    body += take("correlation", "budget", "monte-carlo")
    body += take("fig00-frame", "fig09-y", "fig10-x", "fig11-trajectory")
    return [*body, *shown.values(), *figures.values()]


def _drawings(run: RunData, curves: Curves | None) -> list[Drawing]:
    fits, motion, points = run.results.get("fits") or {}, run.motion, run.points
    period_s = number(fits[FitMethod.EXACT], "mean_period_s") if fits else _period(run)
    drawings = [figures_motion.frame_figure(run.picture)] if run.picture else []
    if len(motion.time_s) > 1:
        drawings += [
            figures_motion.slow_figure(motion, period_s),
            figures_motion.fast_figure(motion, period_s),
            figures_motion.trajectory_figure(motion, period_s),
        ]
    if len(points) >= 3:
        drawings.append(figures_laws.decay_figure(points, curves, motion.unit, run.unit_rad))
    drawings += instrument_figures(run.results.get("instrument") or {})
    pendulum = pendulum_of(run.results)
    if curves is not None and pendulum is not None:
        exact = parameters_of(fits[FitMethod.EXACT])
        drawings += [
            figures_laws.period_figure(curves),
            figures_laws.smooth_figure(curves),
            figures_laws.residual_figure(points, curves, fits[FitMethod.EXACT].get("outliers") or []),
            figures_contact.loop_figure(exact, pendulum),
            figures_laws.loss_figure(points, exact, pendulum),
            figures_contact.correlation_figure(fits[FitMethod.EXACT]["correlation"]),
        ]
    return drawings


def _period(run: RunData) -> float:
    """Mean period of the turning points, for the length of the detail views."""
    points = run.points
    if len(points) < 2:
        return _DEFAULT_PERIOD_S
    return float(2 * (points.time_s[-1] - points.time_s[0]) / (points.index[-1] - points.index[0]))


def _pictures(drawings: Sequence[Drawing], files: Path) -> list[tuple[Drawing, str]]:
    """Write SVG and PNG of every figure; each with its HTML.

    A frame is pixels, and goes into the page as PNG; everything else is lines, as SVG.
    """
    found = []
    for drawing in drawings:
        vector, pixels = svg(drawing), png(drawing)
        (files / f"{drawing.name}.svg").write_bytes(vector)
        (files / f"{drawing.name}.png").write_bytes(pixels)
        inside = (pixels, "image/png") if drawing.name.endswith("frame") else (vector, "image/svg+xml")
        found.append((drawing, html.picture(drawing, *inside)))
    return found


def save_figures(drawings: Sequence[Drawing], files: Path) -> list[str]:
    """Write figures as SVG and PNG; returns their HTML in order."""
    return [text for _, text in _pictures(drawings, files)]


def save_tables(tables: Sequence[Table], files: Path) -> None:
    """Write every table as CSV."""
    for table in tables:
        (files / f"{table.name}.csv").write_text(table.csv(), encoding="utf-8")


def _provenance(source: ReportSource) -> list[str]:
    body = [html.heading("Provenance", new_page=True)]
    for run in source.runs:
        if len(source.runs) > 1:
            body.append(html.heading(run.title, 3))
        rows = list(run.provenance["file"].items())
        for section in ("calibration", "record", "session", "environment", "camera", "frame", "versions"):
            rows += [
                (f"{section}: {key}", text) for key, text in run.provenance.get(section, {}).items() if text
            ]
        body.append(html.facts(rows))
    configuration = source.runs[0].provenance.get("configuration")
    if configuration:
        body.append(html.heading("Configuration and calibration", 3))
        body.append(f'<div class="columns">{html.facts(list(configuration.items()))}</div>')
    return body
