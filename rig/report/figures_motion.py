"""Figures of the motion: frame, trajectory, damping, fixed-pattern position errors, and what remains."""

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
    broken,
    canvas,
    dots,
    envelope,
    one_axes,
    thinned,
)
from rig.report.source import RecordedPicture, ShownTrajectory, ShownUnit
from rig.terminal import palette


def position_error_figure(found: PositionErrors) -> ReportFigure:
    """The map of position errors that was subtracted, with its standard uncertainty."""
    size, unit = found.unit.shown_size, found.unit.shown
    place, error, u_error = found.place / size, found.error / size, found.u_error / size
    figure, axes = one_axes(2.3, f"deflection / {unit}", f"error / {unit}")
    axes.axhline(0.0, color=INK, lw=0.6, ls=":")
    axes.fill_between(place, error - u_error, error + u_error, color=DATA, alpha=0.3, lw=0)
    axes.plot(place, error, color=DATA, lw=0.9)
    axes.set_xlim(place[0], place[-1])
    words = (
        "Error of the measured position across the sensor, with its standard uncertainty, from the "
        f"residuals of {found.cycles} whole cycles, each of which passes every position twice. It was "
        "subtracted before the turning points were measured again. A constant offset and an error of scale "
        "do not show in a free swing; the budget includes them."
    )
    return ReportFigure("position-errors", "Errors of position on the sensor", words, figure)


_ZOOM_CYCLES = 6.0
_MAX_LINE_POINTS = 1500
_MAX_COLUMNS = 2600


def frame_figure(picture: RecordedPicture) -> ReportFigure:
    """A whole frame, and the spot in it enlarged with the fitted centre."""
    image = picture.frame.image
    rows, columns = image.shape[:2]
    figure = canvas(3.3)
    tall = rows > columns
    left, right = figure.subplots(1, 2, width_ratios=[columns / rows if tall else 1.4, 1.0])
    top = float(np.max(image)) or 1.0
    step = max(1, max(rows, columns) // 640)
    # the square root of the grey values makes the foot of the beam and the background visible
    shown = np.sqrt(np.clip(image / top, 0.0, 1.0))
    left.imshow(
        shown[::step, ::step],
        cmap="gray",
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        vmin=0,
        vmax=1,
        interpolation="nearest",
    )
    half = max(12, round(4.5 * picture.sigma_px))
    x0, y0 = round(picture.x_px), round(picture.y_px)
    low_x, low_y = max(0, x0 - half), max(0, y0 - half)
    part = image[low_y : y0 + half + 1, low_x : x0 + half + 1]
    shape = (low_x - 0.5, low_x + part.shape[1] - 0.5, low_y + part.shape[0] - 0.5, low_y - 0.5)
    drawn = right.imshow(part, cmap="gray", extent=shape, interpolation="nearest", vmin=0)
    right.axhline(picture.y_px, color=palette.ORANGE, lw=0.7)
    right.axvline(picture.x_px, color=palette.ORANGE, lw=0.7)
    if np.isfinite(picture.sigma_px):
        right.add_patch(
            Circle((picture.x_px, picture.y_px), 2 * picture.sigma_px, fill=False, ec=palette.ORANGE, lw=0.8)
        )
    left.add_patch(Circle((picture.x_px, picture.y_px), half, fill=False, ec=palette.ORANGE, lw=0.9))
    bar = figure.colorbar(drawn, ax=right, fraction=0.046, pad=0.03)
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
    )


def motion_figures(motion: ShownTrajectory, period_s: float) -> list[ReportFigure]:
    """Y(t), X(t) and the trajectory (the paper's Figs. 9 to 11), as far as both axes were measured."""
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
    whole = figure.add_subplot(grid[0, :])
    cycles = float(time_s[-1] - time_s[0]) / period_s
    # either every oscillation is resolved or none: anything between draws beats that do not exist
    columns = round(8 * cycles) if 8 * cycles <= _MAX_COLUMNS else round(min(cycles, _MAX_COLUMNS))
    x, low, high = broken(*envelope(time_s, values, max(columns, 300)))
    whole.fill_between(x, low, high, color=colour, lw=0.3)
    whole.set_xlim(time_s[0], time_s[-1])
    zoom_s = min(_ZOOM_CYCLES * period_s, float(time_s[-1] - time_s[0]))
    first = figure.add_subplot(grid[1, 0])
    last = figure.add_subplot(grid[1, 1])
    _zoom(first, time_s, values, float(time_s[0]), zoom_s, colour)
    _zoom(last, time_s, values, float(time_s[-1]) - zoom_s, zoom_s, colour)
    for axes in (whole, first, last):
        axes.set_xlabel("t / s")
    for axes in (whole, first):
        axes.set_ylabel(f"{name} / {unit}")
    figure.align_ylabels([whole, first])
    return figure


def _zoom(axes: Axes, time_s: Floats, values: Floats, start_s: float, length_s: float, colour: str) -> None:
    inside = np.nonzero((time_s >= start_s) & (time_s <= start_s + length_s))[0]
    inside = inside[thinned(len(inside), _MAX_LINE_POINTS)]
    axes.plot(*broken(time_s[inside], values[inside]), color=colour, lw=0.8)
    axes.set_xlim(start_s, start_s + length_s)


def _trajectory_figure(motion: ShownTrajectory, period_s: float) -> ReportFigure:
    """(X, Y) at equal scales, and with X stretched."""
    figure = canvas(3.6)
    left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.6])
    length = motion.time_s[-1] - motion.time_s[0]
    cycles = 3 * period_s
    starts = {
        "first three periods": (motion.time_s[0], palette.BLUE),
        "middle of the run": (motion.time_s[0] + 0.5 * length, palette.ORANGE),
        "last three periods": (motion.time_s[-1] - cycles, palette.VERMILLION),
    }
    for label, (start, colour) in starts.items():
        inside = np.nonzero((motion.time_s >= start) & (motion.time_s <= start + cycles))[0]
        inside = inside[thinned(len(inside), _MAX_LINE_POINTS)]
        _, x, y = broken(motion.time_s[inside], motion.x[inside], motion.y[inside])
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


def damped_figure(results: RunResults, unit: ShownUnit) -> ReportFigure:
    """Amplitude with residuals, and period, against time; time constant against amplitude."""
    points, stored = results.points, results.stored
    amplitude, u_amplitude = points.amplitude / unit.shown_size, points.u_amplitude / unit.shown_size
    figure = canvas(4.6)
    ((top, tau), (below, period)) = figure.subplots(2, 2, height_ratios=[1.5, 1.0])
    bars: dict[str, Any] = {"color": DATA, "ecolor": DATA, "elinewidth": 0.7}
    top.errorbar(
        points.time_s, amplitude, u_amplitude, fmt="o", mfc="none", mec=DATA, ecolor=DATA, ms=3.5, lw=0.7
    )
    if len(stored.left_out_time_s):
        left_out = np.abs(stored.left_out_amplitude) / unit.shown_size
        top.plot(stored.left_out_time_s, left_out, "x", color=INK, ms=4, lw=0, label="flagged, left out")
        top.legend(loc="upper right")
    top.set(yscale="log", ylabel=f"amplitude / {unit.shown}")
    found = results.damping
    if found is not None and found.curve:
        parts = [part.value for part in (found.constant, found.linear, found.quadratic)]
        since_s = points.time_s - points.time_s[0]
        first = found.curve[0].amplitude
        top.plot(points.time_s, amplitude_at(since_s, first, *parts), color=EXACT)
        residual = amplitude - amplitude_at(since_s, first, *parts)
        below.errorbar(points.time_s, residual, u_amplitude, fmt=".", **bars)
        at = np.array([where.amplitude for where in found.curve])
        value = np.array([where.time_constant_s.value for where in found.curve])
        u = np.array([where.time_constant_s.standard_uncertainty for where in found.curve])
        tau.fill_between(at, value - u, value + u, color=EXACT, alpha=0.3, lw=0)
        tau.plot(at, value, color=EXACT)
    below.axhline(0.0, color=INK, lw=0.6)
    below.set(xlabel="t / s", ylabel=f"data − fit / {unit.shown}")
    tau.set(xlabel=f"amplitude / {unit.shown}", ylabel="time constant / s")
    steps = np.diff(points.index)
    half_s = np.diff(points.time_s) / steps
    dots(period, points.time_s[1:], 2.0 * half_s, DATA)
    period.set(xlabel="t / s", ylabel="2 × half-period / s")
    return ReportFigure(
        "damping",
        "Damping",
        "Amplitude of every half-cycle with the damping that was fitted, its residuals, the time constant "
        "against the amplitude with its standard uncertainty, and twice the time between turning points.",
        figure,
    )
