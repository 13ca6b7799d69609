"""The analysing layout of a record: curves of fits and the report's text, plotted in Rerun.

Its XY plots are in Spatial2DViews with axes of their own.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
import rerun as rr

from acquisition.record.digest import sha256_of
from processing.arrays import Floats
from processing.deflections import DeflectionUnit
from processing.fit import FitMethod
from rig.analysis import (
    RunResults,
    analyse_record,
    curves_of,
    instrument_table,
    parameter_table,
    quality_table,
    recorded_results,
    remarks,
)
from rig.terminal import Table, palette
from rig.view import layout
from rig.view.graticule import Graticule, faded, graticule_marks

Panel = Literal["decay", "residuals", "period", "period_residuals"]
PANEL_TITLES: Final[dict[Panel, tuple[str, str]]] = {
    "decay": ("time / s", "amplitude / {unit}"),
    "residuals": ("time / s", "residual / {unit}"),
    "period": ("amplitude / {unit}", "period / s"),
    "period_residuals": ("amplitude / {unit}", "residual / ms"),
}
TRIMMED_PANELS: Final = frozenset({"period", "period_residuals"})
"""Panels whose values become very uncertain at small amplitudes, so that the axes ignore a few points."""
LOWER_LEGEND_PANEL: Final = "period"
"""The panel whose curves rise to the right: its legend is in the lower right corner, others' in the upper."""
COVERED_PANELS: Final = frozenset({"decay", "period"})
"""Panels in which a good fit covers its data: curves plotted first are wider, so that they remain visible."""
MAX_BARS: Final = 400
"""Largest number of error bars of one curve."""


class AnalysisCurve(NamedTuple):
    """One curve of the analysing layout; arrays (n,)."""

    panel: Panel
    name: str
    x: Floats
    y: Floats
    """x and y in the units of `PANEL_TITLES`; NaN interrupts a line."""
    u_y: Floats | None = None
    """Standard uncertainty of y, plotted as error bars."""
    style: Literal["points", "line"] = "line"


def run_analysis(record: Path) -> RunResults:
    """The results next to the record if they were made from this file, else a new fit."""
    _, stored = recorded_results(record, sha256_of(record))
    return analyse_record(record) if stored is None else stored


def analysis_curves(run: RunResults) -> list[AnalysisCurve]:
    """Curves of the decay and of T(alpha) with both fits and their residuals; without a fit only data."""
    # a record has a `DeflectionUnit`; only a table may have another unit
    points, size = run.points, DeflectionUnit(run.stored.unit).shown_size
    amplitude, u = points.amplitude / size, points.u_amplitude / size
    result = [AnalysisCurve("decay", "measured", points.time_s, amplitude, u, "points")]
    curves = curves_of(run)
    if curves is None:
        return result
    period_amplitude, u_period_s = curves.period_rad / size, curves.u_period_s
    result.append(
        AnalysisCurve("period", "measured", period_amplitude, curves.period_s, u_period_s, "points")
    )
    models = {
        FitMethod.ASYMPTOTIC: (curves.asymptotic.model_amplitude_rad / size, curves.asymptotic_period_s),
        FitMethod.EXACT: (curves.exact.model_amplitude_rad / size, curves.exact_period_s),
    }
    for method, (decay, period_s) in models.items():
        fit = f"{method} fit"
        u_bars, u_bars_ms = (u, 1e3 * u_period_s) if method is FitMethod.EXACT else (None, None)
        residual_ms = 1e3 * (curves.period_s - period_s)
        result += [
            AnalysisCurve("decay", fit, points.time_s, decay),
            AnalysisCurve("period", fit, period_amplitude, period_s),
            AnalysisCurve("residuals", fit, points.time_s, amplitude - decay, u_bars, "points"),
            AnalysisCurve("period_residuals", fit, period_amplitude, residual_ms, u_bars_ms, "points"),
        ]
    return result


def report_text(results: RunResults) -> str:
    """Results of the fits in Markdown."""
    paragraphs = [f"## {Path(results.record).stem}", results.half_cycles_text()]
    if results.problem:
        paragraphs.append(f"no fit: {results.problem}")
    if results.fits:
        paragraphs.append(_markdown(parameter_table(results, full=False)))
        paragraphs.append(_markdown(quality_table(results)))
    instrument = instrument_table(results)
    if instrument.shown:
        paragraphs.append(_markdown(instrument))
    return "\n\n".join([*paragraphs, *(f"- {line}" for line in (*remarks(results), *results.warnings))])


def _markdown(table: Table) -> str:
    """The table in Markdown; units are appended to the names."""
    head, rows = list(table.head), [list(row) for row in table.shown]
    if "unit" in head:
        column = head.index("unit")
        del head[column]
        for row in rows:
            if unit := row.pop(column):
                row[0] = f"{row[0]} / {unit}"

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cells)} |"

    return "\n".join([line(head), line(["---"] * len(head)), *map(line, rows)])


def plot_fits(stream: rr.RecordingStream, all_curves: Sequence[AnalysisCurve], text: str, unit: str) -> None:
    """Plot axes and curves of each panel, and the report's text (Markdown), as entities without a time."""
    for panel, (x_title, y_title) in PANEL_TITLES.items():
        curves = [curve for curve in all_curves if curve.panel == panel]
        if not curves:
            continue
        graticule = Graticule.boxed(
            np.concatenate([curve.x for curve in curves]),
            np.concatenate([curve.y for curve in curves]),
            x_title.format(unit=unit),
            y_title.format(unit=unit),
            trims_y=panel in TRIMMED_PANELS,
        )
        root = f"{layout.ANALYSIS_ROOT}/{panel}"
        for name, archetype in graticule_marks(graticule).items():
            stream.log(f"{root}/axes/{name}", archetype, static=True)
        entries = []
        for number, curve in enumerate(curves):
            colour = palette.curve_colour(curve.name, number)
            later = curves[number + 1 :] if panel in COVERED_PANELS else []
            lines_above = sum(other.style == "line" for other in later)
            count = _plot_curve(stream, root, curve, graticule, colour, lines_above)
            entries.append((f"{curve.name} ({count} outside)" if count else curve.name, colour))
        legend = _legend(entries, graticule, is_low=panel == LOWER_LEGEND_PANEL)
        stream.log(f"{root}/legend", legend, static=True)
    if text:
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        stream.log(layout.REPORT, document, static=True)


def _plot_curve(
    stream: rr.RecordingStream,
    root: str,
    curve: AnalysisCurve,
    graticule: Graticule,
    colour: str,
    lines_above: int,
) -> int:
    """Plot the part of a curve within the axes; return the number of points outside (0 for lines).

    `lines_above` is the number of lines that are plotted over this curve, which is made wider for them.
    """
    path = f"{root}/{rr.escape_entity_path_part(curve.name)}"
    points = graticule.to_plane(curve.x, curve.y)
    is_inside = graticule.inside(curve.x, curve.y)
    if curve.style == "points":
        radius = rr.Radius.ui_points(1.2 + 0.7 * lines_above)
        dots = rr.Points2D(points[is_inside], colors=palette.rgba(colour), radii=radius, draw_order=5.0)
        stream.log(path, dots, static=True)
    else:
        edges = np.flatnonzero(np.diff(np.concatenate(([False], is_inside, [False])).astype(np.int8)))
        strips = [points[start:stop] for start, stop in edges.reshape(-1, 2)]
        radius = rr.Radius.ui_points(0.8 + 0.8 * lines_above)
        order = 20.0 - lines_above
        line = rr.LineStrips2D(strips, colors=palette.rgba(colour), radii=radius, draw_order=order)
        stream.log(path, line, static=True)
    if curve.u_y is not None:
        rows = np.flatnonzero(is_inside)[:: max(1, int(is_inside.sum()) // MAX_BARS)]
        low = np.maximum(curve.y[rows] - curve.u_y[rows], graticule.y_low)
        high = np.minimum(curve.y[rows] + curve.u_y[rows], graticule.y_high)
        ends = graticule.to_plane(curve.x[rows], low), graticule.to_plane(curve.x[rows], high)
        bars = rr.LineStrips2D(
            np.stack(ends, axis=1),
            colors=faded(colour, 0.45),
            radii=rr.Radius.ui_points(0.4),
            draw_order=-5.0,
        )
        stream.log(f"{path}/u", bars, static=True)
    return (
        int(np.count_nonzero(np.isfinite(curve.x + curve.y) & ~is_inside)) if curve.style == "points" else 0
    )


def _legend(entries: list[tuple[str, str]], graticule: Graticule, *, is_low: bool) -> rr.Points2D:
    """The names of the curves in their colours, in the upper right corner, or the lower right if `is_low`."""
    width, height = graticule.size
    corner = graticule.to_plane(np.array([graticule.x_high]), np.array([graticule.y_high]))[0]
    first = 1.0 - 0.08 * len(entries) - 0.03 if is_low else 0.03
    x = corner[0] - 0.2 * width
    return rr.Points2D(
        [(x, corner[1] + (first + 0.08 * row) * height) for row in range(len(entries))],
        labels=[name for name, _ in entries],
        show_labels=True,
        colors=[palette.rgba(colour) for _, colour in entries],
        radii=rr.Radius.ui_points(0.0),
    )
