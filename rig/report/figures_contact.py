"""Figures of the contact's moments (Table 4), of series, and of quantities of other pendulums."""

from collections.abc import Mapping
from dataclasses import asdict
from math import isnan

import numpy as np
from matplotlib.axes import Axes

from processing.arrays import Floats
from processing.contact import ContactParameters, PendulumOnBall, moment_loop, weight_moment
from processing.fit import FitMethod, Work
from processing.instruments import DEGREE_RAD
from processing.swing import TurningPoints
from processing.units import ARCSEC_RAD
from rig.analysis import TABLE4_AMPLITUDE_ARCSEC, ResultRow, RunResults, Series
from rig.report.drawing import DATA, EXACT, INK, SMOOTH, ReportFigure, canvas, one_axes, three_columns
from rig.terminal import palette, plain, quantity


def loop_figure(parameters: ContactParameters, pendulum: PendulumOnBall, work: Work) -> ReportFigure:
    """The three loops of Table 4 at a measured amplitude; with the work of adhesion if c is determined."""
    amplitude_arcsec, has_c = work.amplitude_arcsec, not isnan(work.adhesive_4at_j.value)
    amplitude_rad, is_paper = (amplitude_arcsec * ARCSEC_RAD, amplitude_arcsec == TABLE4_AMPLITUDE_ARCSEC)
    loop = moment_loop(amplitude_rad, asdict(parameters), pendulum)
    phi = loop.phi_rad / ARCSEC_RAD
    closed = np.append(phi, phi[0])
    figure = canvas(2.75)
    panels = figure.subplots(1, 3)
    for axes, values, title in zip(
        panels,
        (loop.friction_n_m, loop.elastic_n_m, loop.total_n_m),
        ("dissipative, Eq. 1", "elastic, Eq. 3", "total, Eq. 7"),
        strict=True,
    ):
        moment = np.append(values, values[0]) * 1e9
        axes.plot(closed, moment, color=EXACT, lw=1.2)
        if axes is panels[0]:
            axes.fill(closed, moment, color=palette.SKY_BLUE, alpha=0.25, lw=0)
        axes.axhline(0, color=INK, lw=0.5)
        axes.axvline(0, color=INK, lw=0.5)
        axes.set(title=title, xlabel="φ / arcsec")
    texts = [(0.96, f"4A = {plain(work.dissipated_4a_j.value * 1e15)} fJ")]
    if has_c:
        adhesive = weight_moment(pendulum) * parameters.c * 1e9
        panels[0].plot(
            np.array([-1, 1, 1, -1, -1]) * amplitude_arcsec,
            np.array([-1, -1, 1, 1, -1]) * adhesive,
            ls=(0, (4, 2)), color=INK, lw=0.9,
        )  # fmt: skip
        texts.append((0.11, f"4Aₜ = {plain(work.adhesive_4at_j.value * 1e15)} fJ"))
    for height, text in texts:
        panels[0].text(0.5, height, text, transform=panels[0].transAxes, ha="center", va="top", fontsize=7.5)
    panels[0].set_ylabel("M / nN m")
    return ReportFigure(
        "table4-loops",
        f"Moments over one cycle at {amplitude_arcsec:.4g} arcsec" + (" (Table 4)" if is_paper else ""),
        "Shaded: 4A, the work lost in a cycle. "
        + ("Dashed: 4Aₜ, the part of adhesion (c). " if has_c else "")
        + "The elastic moment is the skeletal curve about which the total makes its loop.",
        figure,
    )


def series_figure(series: Series) -> ReportFigure:
    """Figure of every parameter of every run, with the combined value and its 95 % interval."""
    method = FitMethod.EXACT if FitMethod.EXACT in series.fits else next(iter(series.fits))
    combined = series.fits[method]
    names = list(combined)
    figure, panels = three_columns(len(names), lambda rows: 0.35 + 1.55 * rows)
    for axes, name in zip(panels, names, strict=True):
        scale = quantity(name).factor
        item = combined[name]
        x = np.arange(1, len(item.runs) + 1)
        values, u = np.array([tuple(run) for run in item.runs]).T * scale
        row = series.rows.get(name)
        if row is not None:
            axes.axhspan(row.lower * scale, row.upper * scale, color=EXACT, alpha=0.15, lw=0)
        axes.axhline(item.value * scale, color=EXACT, lw=1.0)
        axes.errorbar(x, values, u, fmt="o", color=DATA, ms=3.5, elinewidth=0.8, capsize=2)
        axes.set_xlim(0.5, len(item.runs) + 0.5)
        axes.set_xticks(x, [str(number) for number in series.combined_runs])
        axes.set_title(quantity(name).label)
        axes.ticklabel_format(axis="y", useOffset=False, scilimits=(-3, 4))
        axes.tick_params(axis="y", labelsize=7)
    return ReportFigure(
        "series",
        "Runs of the series",
        f"{method.capitalize()} fit of each run with its standard uncertainty; line and band: combined "
        "value, 95 % interval.",
        figure,
    )


_MIN_VISIBLE_BAR = 0.01
"""Minimum length of a bar, as a fraction of the plotted range, that extends beyond its point."""


def instrument_figures(results: RunResults, points: TurningPoints) -> list[ReportFigure]:
    """The figures of the quantities of another pendulum that a run has."""
    rows, curves = results.rows, {} if results.instrument is None else results.instrument.curves
    drawings = []
    if "damping_time_s" in rows:
        drawings.append(_damping_figure(rows, points))
    figures = (("decrement", _decrement_figure), ("period", _period_figure), ("plane", _plane_figure))
    for name, draw in figures:
        if name in curves:
            drawings.append(draw(curves[name]))
    return drawings


def _damping_figure(rows: Mapping[str, ResultRow], points: TurningPoints) -> ReportFigure:
    figure, axes = one_axes(3.0, "t / s", "amplitude / degrees")
    amplitude = points.amplitude / DEGREE_RAD
    time, swings = rows["damping_time_s"], rows["damping_swings"]
    start_deg, end_deg = rows["damping_start_deg"].value, rows["damping_end_deg"].value
    is_inside = (amplitude <= start_deg) & (amplitude >= end_deg)
    axes.plot(
        points.time_s[~is_inside], amplitude[~is_inside], "o", mfc="none", mec=DATA, label="turning points"
    )
    axes.plot(points.time_s[is_inside], amplitude[is_inside], "o", color=DATA, label="those that count")
    for level in (start_deg, end_deg):
        axes.axhline(level, color=EXACT, lw=0.9)
        xycoords = ("axes fraction", "data")
        axes.annotate(f"{level:g}°", (0.995, level), xycoords=xycoords, ha="right", va="bottom", color=EXACT)
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


def _decrement_figure(table: Mapping[str, Floats]) -> ReportFigure:
    figure, axes = one_axes(2.8, "amplitude / degrees", "log decrement of a whole swing")
    bars = _plot_points(axes, table["amplitude_deg"], table["log_decrement"], table["u_log_decrement"])
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:.2g}")
    return ReportFigure(
        "kind-decrement",
        "Log decrement against amplitude",
        "Decrement of a whole swing, from turning points some swings apart. " + bars,
        figure,
    )


def _period_figure(table: Mapping[str, Floats]) -> ReportFigure:
    figure, axes = one_axes(3.2, "amplitude / degrees", "period / s")
    amplitude = table["amplitude_deg"]
    order = np.argsort(amplitude)
    bars = _plot_points(axes, amplitude, table["period_s"], table["u_period_s"], label="measured")
    axes.plot(amplitude[order], table["circular_law_s"][order], color=EXACT, label="ideal pendulum")
    squared = table["alpha_squared_over_16_s"][order]
    axes.plot(amplitude[order], squared, "--", color=SMOOTH, label="1 + alpha²/16")
    axes.legend()
    return ReportFigure(
        "kind-period",
        "Period against amplitude",
        "Full periods beside the circular-error law with the fitted period at vanishing amplitude. " + bars,
        figure,
    )


def _plane_figure(table: Mapping[str, Floats]) -> ReportFigure:
    figure, axes = one_axes(2.6, "time / s", "direction / degrees")
    axes.plot(table["time_s"], table["direction_deg"], "o", color=DATA)
    return ReportFigure(
        "kind-plane",
        "Turning of the swing plane",
        "Direction of the swing plane from the slow axis, period by period.",
        figure,
    )


def _plot_points(axes: Axes, x: Floats, y: Floats, u: Floats, label: str | None = None) -> str:
    """Draw points with their standard uncertainties; returns the sentence of the caption on the bars."""
    is_hidden = bool(np.max(u) < _MIN_VISIBLE_BAR * np.ptp(y))
    caps = 0 if is_hidden else 2.5
    axes.errorbar(x, y, u, fmt=".", ms=3, color=DATA, ecolor=INK, elinewidth=0.8, capsize=caps, label=label)
    return "Bars: one standard uncertainty" + (", shorter than the points are large." if is_hidden else ".")
