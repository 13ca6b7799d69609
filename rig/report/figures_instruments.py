"""What users of other pendulums expect: damping, ten swings, decrement and period, the plane that turns."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from processing.instruments import DEGREE_RAD
from processing.swing import TurningPoints
from rig.analysis import ResultRow, RunResults
from rig.report.drawing import DATA, EXACT, INK, SMOOTH, Array, ReportFigure, one_axes

_SEEN = 0.01
"""Share of the drawn range from which on a bar is longer than its point."""


def instrument_figures(results: RunResults, points: TurningPoints) -> list[ReportFigure]:
    """Figures of what a run reports; those whose numbers are there."""
    rows, curves = results.rows, {} if results.instrument is None else results.instrument.curves
    drawings = []
    if "damping_time_s" in rows:
        drawings.append(_damping(rows, points))
    if "scale_hardness" in rows and len(points) > 1:
        drawings.append(_ten_swings(rows.get("time_hardness_s"), points))
    for name, draw in (("decrement", _decrement), ("period", _period), ("plane", _plane)):
        if name in curves:
            drawings.append(draw(curves[name]))
    return drawings


def _damping(rows: Mapping[str, ResultRow], points: TurningPoints) -> ReportFigure:
    figure, axes = one_axes(3.0, "t / s", "amplitude / degrees", bottom=0.16)
    amplitude = points.amplitude / DEGREE_RAD
    time, swings = rows["damping_time_s"], rows["damping_swings"]
    start_deg, end_deg = rows["damping_start_deg"].value, rows["damping_end_deg"].value
    inside = (amplitude <= start_deg) & (amplitude >= end_deg)
    axes.plot(points.time_s[~inside], amplitude[~inside], "o", mfc="none", mec=DATA, label="turning points")
    axes.plot(points.time_s[inside], amplitude[inside], "o", color=DATA, label="those that count")
    for level in (start_deg, end_deg):
        axes.axhline(level, color=EXACT, lw=0.9)
        axes.annotate(
            f"{level:g}°",
            (0.995, level),
            xycoords=("axes fraction", "data"),
            ha="right",
            va="bottom",
            color=EXACT,
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}")
    axes.legend(loc="lower left")
    return ReportFigure(
        "kind-damping",
        "Damping",
        f"Amplitude on a logarithmic scale. From {start_deg:g} to {end_deg:g} degrees: {time.text} s, "
        f"{swings.text} swings.",
        figure,
    )


def _ten_swings(hardness: ResultRow | None, points: TurningPoints) -> ReportFigure:
    figure, axes = one_axes(3.0, "t / s", "turning angle / degrees", bottom=0.16)
    number = points.index - points.index[0]
    angle = points.amplitude / DEGREE_RAD * np.where(number % 2, -1.0, 1.0)
    axes.plot(points.time_s, angle, color=INK, lw=0.5)
    axes.plot(points.time_s, angle, "o", color=DATA, ms=3.5)
    if hardness is not None:
        end = float(points.time_s[int(np.searchsorted(number, 10))])
        axes.axvspan(float(points.time_s[0]), end, color=EXACT, alpha=0.12, lw=0)
    axes.axhline(0, color=INK, lw=0.5)
    ten = "" if hardness is None else f"; shaded: ten single swings, {hardness.value:.4f} s"
    return ReportFigure(
        "kind-hardness", "Single swings", f"Turning points from the release on, on both sides{ten}.", figure
    )


def _decrement(table: Mapping[str, Array]) -> ReportFigure:
    figure, axes = one_axes(2.8, "amplitude / degrees", "log decrement of a whole swing", bottom=0.17)
    bars = _dots(axes, table["amplitude_deg"], table["log_decrement"], table["u_log_decrement"])
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:.2g}")
    return ReportFigure(
        "kind-decrement",
        "Log decrement against amplitude",
        "Decrement of a whole swing, from turning points some swings apart. " + bars,
        figure,
    )


def _period(table: Mapping[str, Array]) -> ReportFigure:
    figure, axes = one_axes(3.2, "amplitude / degrees", "period / s", bottom=0.15)
    amplitude = table["amplitude_deg"]
    order = np.argsort(amplitude)
    bars = _dots(axes, amplitude, table["period_s"], table["u_period_s"], label="measured")
    axes.plot(amplitude[order], table["circular_law_s"][order], color=EXACT, label="ideal pendulum")
    axes.plot(
        amplitude[order],
        table["alpha_squared_over_16_s"][order],
        "--",
        color=SMOOTH,
        label="1 + alpha²/16",
    )
    axes.legend()
    return ReportFigure(
        "kind-period",
        "Period against amplitude",
        "Full periods beside the circular-error law with the fitted period at vanishing amplitude. " + bars,
        figure,
    )


def _plane(table: Mapping[str, Array]) -> ReportFigure:
    figure, axes = one_axes(2.6, "time / s", "direction / degrees", bottom=0.18)
    axes.plot(table["time_s"], table["direction_deg"], "o", color=DATA)
    return ReportFigure(
        "kind-plane",
        "Turning of the swing plane",
        "Direction of the swing plane from the slow axis, period by period.",
        figure,
    )


def _dots(axes: Axes, x: Array, y: Array, u: Array, label: str | None = None) -> str:
    """Draw points with their standard uncertainties; returns what is said of the bars."""
    hidden = bool(np.max(u) < _SEEN * np.ptp(y))
    caps = 0 if hidden else 2.5
    axes.errorbar(x, y, u, fmt=".", ms=3, color=DATA, ecolor=INK, elinewidth=0.8, capsize=caps, label=label)
    return "Bars: one standard uncertainty" + (", shorter than the points are large." if hidden else ".")
