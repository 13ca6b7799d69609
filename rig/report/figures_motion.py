"""Figures of the motion: frame, X(t), Y(t), trajectory, damping, fixed-pattern position errors."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from processing.arrays import Floats
from processing.damping import amplitude_at
from rig.analysis import PositionErrors, RunResults
from rig.report.drawing import (
    DATA,
    EXACT,
    INK,
    ReportFigure,
    break_at_gaps,
    canvas,
    envelope,
    one_axes,
    plot_dots,
    thinned_indices,
)
from rig.report.source import DisplayUnit, RecordedPicture, ReportTrajectory
from rig.terminal import palette


def position_error_figure(errors: PositionErrors) -> ReportFigure:
    """The map of position errors that was subtracted, with its standard uncertainty."""
    size, unit = errors.unit.shown_size, errors.unit.shown
    position, error, u_error = errors.place / size, errors.error / size, errors.u_error / size
    figure, axes = one_axes(2.3, f"deflection / {unit}", f"error / {unit}")
    axes.axhline(0.0, color=INK, lw=0.6, ls=":")
    axes.fill_between(position, error - u_error, error + u_error, color=DATA, alpha=0.3, lw=0)
    axes.plot(position, error, color=DATA, lw=0.9)
    axes.set_xlim(position[0], position[-1])
    caption = (
        "Error of the measured position across the sensor, with its standard uncertainty, from the "
        f"residuals of {errors.cycles} whole cycles, each of which passes every position twice. It was "
        "subtracted before the turning points were measured again. A constant offset and an error of scale "
        "do not show in a free swing; the budget includes them."
    )
    return ReportFigure("position-errors", "Errors of position on the sensor", caption, figure)


_ZOOM_CYCLES = 6.0
"""Cycles of a detail at the beginning and the end of a run."""
_MAX_LINE_POINTS = 1500
_MAX_COLUMNS = 2600
"""Largest number of intervals of time for which extremes are drawn."""


def frame_figure(picture: RecordedPicture) -> ReportFigure:
    """A whole frame, and the spot in it enlarged with the fitted centre."""
    image = picture.frame.image
    rows, columns = image.shape[:2]
    figure = canvas(3.3)
    left_width = columns / rows if rows > columns else 1.4
    left, right = figure.subplots(1, 2, width_ratios=[left_width, 1.0])
    max_dn = float(np.max(image)) or 1.0
    step = max(1, max(rows, columns) // 640)
    # the square root of the grey values makes the foot of the beam and the background visible
    brightness = np.sqrt(np.clip(image / max_dn, 0.0, 1.0))
    left.imshow(
        brightness[::step, ::step],
        cmap="gray",
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        vmin=0,
        vmax=1,
        interpolation="nearest",
    )
    half_px = max(12, round(4.5 * picture.sigma_px))
    x0, y0 = round(picture.x_px), round(picture.y_px)
    low_x, low_y = max(0, x0 - half_px), max(0, y0 - half_px)
    window = image[low_y : y0 + half_px + 1, low_x : x0 + half_px + 1]
    extent = (low_x - 0.5, low_x + window.shape[1] - 0.5, low_y + window.shape[0] - 0.5, low_y - 0.5)
    image_artist = right.imshow(window, cmap="gray", extent=extent, interpolation="nearest", vmin=0)
    right.axhline(picture.y_px, color=palette.ORANGE, lw=0.7)
    right.axvline(picture.x_px, color=palette.ORANGE, lw=0.7)
    if np.isfinite(picture.sigma_px):
        right.add_patch(
            Circle((picture.x_px, picture.y_px), 2 * picture.sigma_px, fill=False, ec=palette.ORANGE, lw=0.8)
        )
    left.add_patch(Circle((picture.x_px, picture.y_px), half_px, fill=False, ec=palette.ORANGE, lw=0.9))
    bar = figure.colorbar(image_artist, ax=right, fraction=0.046, pad=0.03)
    bar.set_label("grey value / DN")
    left.set_title(f"frame {picture.frame.sequence}")
    right.set_title(f"spot at ({picture.x_px:.3f}, {picture.y_px:.3f}) px; circle 2σ")
    for axes in (left, right):
        axes.set(xlabel="x / px", ylabel="y / px")
        axes.tick_params(color="white", labelcolor=INK)
    return ReportFigure(
        "fig00-frame",
        "Camera frame",
        f"One whole frame, {columns} × {rows} px, on a square-root scale of grey, and the laser "
        "spot in it with the fitted centre.",
        figure,
        is_raster=True,
    )


def motion_figures(motion: ReportTrajectory, period_s: float) -> list[ReportFigure]:
    """Y(t), X(t) and the trajectory (the paper's Figs. 9 to 11); Y(t) alone if X was not measured."""
    time_s, unit = motion.time_s, motion.unit.shown
    slow = ReportFigure(
        "fig09-y",
        "Fig. 9: Y(t)",
        "Slow mode. Above, the whole run as the band between the extremes; below, its beginning and its end.",
        _motion_figure(time_s, motion.y, "Y", unit, palette.BLUE, period_s),
    )
    if not np.isfinite(motion.x).any():
        return [slow]
    fast = ReportFigure(
        "fig10-x",
        "Fig. 10: X(t)",
        "Fast mode, and the part of the slow one that appears in X; drawn like Y(t), on its own scale.",
        _motion_figure(time_s, motion.x, "X", unit, palette.VERMILLION, period_s),
    )
    return [slow, fast, _trajectory_figure(motion, period_s)]


def _motion_figure(
    time_s: Floats, values: Floats, name: str, unit: str, colour: str, period_s: float
) -> Figure:
    figure = canvas(3.5)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.25, 1.0])
    whole_axes = figure.add_subplot(grid[0, :])
    cycles = float(time_s[-1] - time_s[0]) / period_s
    # either every oscillation is resolved or none: anything between draws beats that do not exist
    columns = round(8 * cycles) if 8 * cycles <= _MAX_COLUMNS else round(min(cycles, _MAX_COLUMNS))
    x, low, high = break_at_gaps(*envelope(time_s, values, max(columns, 300)))
    whole_axes.fill_between(x, low, high, color=colour, lw=0.3)
    whole_axes.set_xlim(time_s[0], time_s[-1])
    zoom_s = min(_ZOOM_CYCLES * period_s, float(time_s[-1] - time_s[0]))
    first_axes = figure.add_subplot(grid[1, 0])
    last_axes = figure.add_subplot(grid[1, 1])
    _zoom(first_axes, time_s, values, float(time_s[0]), zoom_s, colour)
    _zoom(last_axes, time_s, values, float(time_s[-1]) - zoom_s, zoom_s, colour)
    for axes in (whole_axes, first_axes, last_axes):
        axes.set_xlabel("t / s")
    for axes in (whole_axes, first_axes):
        axes.set_ylabel(f"{name} / {unit}")
    figure.align_ylabels([whole_axes, first_axes])
    return figure


def _zoom(axes: Axes, time_s: Floats, values: Floats, start_s: float, duration_s: float, colour: str) -> None:
    indices = np.nonzero((time_s >= start_s) & (time_s <= start_s + duration_s))[0]
    indices = indices[thinned_indices(len(indices), _MAX_LINE_POINTS)]
    axes.plot(*break_at_gaps(time_s[indices], values[indices]), color=colour, lw=0.8)
    axes.set_xlim(start_s, start_s + duration_s)


def _trajectory_figure(motion: ReportTrajectory, period_s: float) -> ReportFigure:
    """(X, Y) at equal scales, and with X stretched."""
    figure = canvas(3.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
    begin_s, end_s, window_s = motion.time_s[0], motion.time_s[-1], 3 * period_s
    windows = {
        "first three periods": (begin_s, palette.BLUE),
        "middle of the run": (0.5 * (begin_s + end_s), palette.ORANGE),
        "last three periods": (end_s - window_s, palette.VERMILLION),
    }
    for label, (start_s, colour) in windows.items():
        indices = np.nonzero((motion.time_s >= start_s) & (motion.time_s <= start_s + window_s))[0]
        indices = indices[thinned_indices(len(indices), _MAX_LINE_POINTS)]
        _, x, y = break_at_gaps(motion.time_s[indices], motion.x[indices], motion.y[indices])
        for axes in (left, right):
            axes.plot(x, y, color=colour, lw=0.6, label=label)
    left.set_aspect("equal", adjustable="datalim")
    left.set_title("one scale")
    right.set_title("X stretched")
    for axes in (left, right):
        axes.set(xlabel=f"X / {motion.unit.shown}", ylabel=f"Y / {motion.unit.shown}")
    right.legend(loc="lower right", handlelength=1.2)
    return ReportFigure(
        "fig11-trajectory",
        "Fig. 11: trajectory",
        "A well balanced pendulum draws a line; its tilt, width and drift show what balance is left to do.",
        figure,
    )


def damped_figure(results: RunResults, unit: DisplayUnit) -> ReportFigure:
    """Amplitude with residuals, and period, against time; time constant against amplitude."""
    points, half_cycles = results.points, results.stored
    amplitude, u_amplitude = points.amplitude / unit.shown_size, points.u_amplitude / unit.shown_size
    figure = canvas(4.6)
    ((amplitude_axes, tau_axes), (residual_axes, period_axes)) = figure.subplots(
        2, 2, height_ratios=[1.5, 1.0]
    )
    bars: dict[str, Any] = {"color": DATA, "ecolor": DATA, "elinewidth": 0.7}
    amplitude_axes.errorbar(
        points.time_s, amplitude, u_amplitude, fmt="o", mfc="none", mec=DATA, ecolor=DATA, ms=3.5, lw=0.7
    )
    if len(half_cycles.left_out_time_s):
        left_out = np.abs(half_cycles.left_out_amplitude) / unit.shown_size
        amplitude_axes.plot(
            half_cycles.left_out_time_s, left_out, "x", color=INK, ms=4, lw=0, label="flagged, left out"
        )
        amplitude_axes.legend(loc="upper right")
    amplitude_axes.set(yscale="log", ylabel=f"amplitude / {unit.shown}")
    damping = results.damping
    if damping is not None and damping.curve:
        coefficients = [term.value for term in (damping.constant, damping.linear, damping.quadratic)]
        # the amplitudes of the curve are stored in the displayed unit
        model = amplitude_at(points.time_s - points.time_s[0], damping.curve[0].amplitude, *coefficients)
        amplitude_axes.plot(points.time_s, model, color=EXACT)
        residual_axes.errorbar(points.time_s, amplitude - model, u_amplitude, fmt=".", **bars)
        curve_amplitude = np.array([point.amplitude for point in damping.curve])
        tau_s, u_tau_s = np.array([tuple(point.time_constant_s) for point in damping.curve]).T
        tau_axes.fill_between(curve_amplitude, tau_s - u_tau_s, tau_s + u_tau_s, color=EXACT, alpha=0.3, lw=0)
        tau_axes.plot(curve_amplitude, tau_s, color=EXACT)
    residual_axes.axhline(0.0, color=INK, lw=0.6)
    residual_axes.set(xlabel="t / s", ylabel=f"data − fit / {unit.shown}")
    tau_axes.set(xlabel=f"amplitude / {unit.shown}", ylabel="time constant / s")
    half_period_s = np.diff(points.time_s) / np.diff(points.index)
    plot_dots(period_axes, points.time_s[1:], 2.0 * half_period_s, DATA)
    period_axes.set(xlabel="t / s", ylabel="2 × half-period / s")
    return ReportFigure(
        "damping",
        "Damping",
        "Amplitude of every half-cycle with the damping that was fitted, its residuals, the time constant "
        "against the amplitude with its standard uncertainty, and twice the time between turning points.",
        figure,
    )
