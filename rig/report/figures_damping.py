"""How the damping of a decay depends on its amplitude, whether or not a law is fitted."""

from typing import Any

import numpy as np

from processing.damping import amplitude_at
from rig.analysis import RunResults, StoredTurningPoints
from rig.report.drawing import DATA, EXACT, INK, ReportFigure, canvas
from rig.report.run_data import ShownUnit

_WIDE = 0.11


def damped_figure(
    stored: StoredTurningPoints, results: RunResults, unit: ShownUnit, name: str
) -> ReportFigure:
    """Amplitude against time with its residuals and what was left out, period, and time constant against
    amplitude.
    """
    points = stored.points()
    amplitude, u_amplitude = points.amplitude / unit.shown_size, points.u_amplitude / unit.shown_size
    figure = canvas(4.6)
    ((top, tau), (below, period)) = figure.subplots(2, 2, height_ratios=[1.5, 1.0])
    figure.subplots_adjust(left=_WIDE, right=0.985, bottom=0.1, top=0.98, hspace=0.28, wspace=0.32)
    bars: dict[str, Any] = {"color": DATA, "ecolor": DATA, "elinewidth": 0.7}
    top.errorbar(
        points.time_s, amplitude, u_amplitude, fmt="o", mfc="none", mec=DATA, ecolor=DATA, ms=3.5, lw=0.7
    )
    if len(stored.left_out_time_s):
        left_out = np.abs(stored.left_out_amplitude) / unit.shown_size
        top.plot(stored.left_out_time_s, left_out, "x", color=INK, ms=4, lw=0, label="flagged, left out")
        top.legend(loc="upper right")
    top.set_yscale("log")
    top.set_ylabel(f"amplitude / {unit.shown}")
    found = results.damping
    if found is not None and found.curve:
        parts = [part.value for part in (found.constant, found.linear, found.quadratic)]
        since_s = points.time_s - points.time_s[0]
        first = found.curve[0].amplitude
        top.plot(points.time_s, amplitude_at(since_s, first, *parts), color=EXACT)
        left = amplitude - amplitude_at(since_s, first, *parts)
        below.errorbar(points.time_s, left, u_amplitude, fmt=".", **bars)
        at = np.array([where.amplitude for where in found.curve])
        value = np.array([where.time_constant_s.value for where in found.curve])
        u = np.array([where.time_constant_s.standard_uncertainty for where in found.curve])
        tau.fill_between(at, value - u, value + u, color=EXACT, alpha=0.3, lw=0)
        tau.plot(at, value, color=EXACT)
    below.axhline(0.0, color=INK, lw=0.6)
    below.set_xlabel("t / s")
    below.set_ylabel(f"data − fit / {unit.shown}")
    tau.set_xlabel(f"amplitude / {unit.shown}")
    tau.set_ylabel("time constant / s")
    steps = np.diff(points.index)
    half_s = np.diff(points.time_s) / steps
    period.plot(points.time_s[1:], 2.0 * half_s, ".", color=DATA)
    period.set_xlabel("t / s")
    period.set_ylabel("2 × half-period / s")
    return ReportFigure(
        name,
        name.capitalize().replace("-", " "),
        "Amplitude of every half-cycle with the damping that was fitted, its residuals, the time constant "
        "against the amplitude with its standard uncertainty, and twice the time between turning points.",
        figure,
    )
