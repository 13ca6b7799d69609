"""The report of decays in their own unit: amplitude, residuals, time constant against amplitude; of a table
or a film.
"""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.record import whole_file
from processing.damping import amplitude_at
from processing.errors import RecordError
from processing.swing import TurningPoints, turning_points
from processing.ticks import seconds
from rig.analysis import AnalysedTable, FoundDecay, RunResults, along_motion, with_positions
from rig.presentation import with_uncertainty
from rig.report import html
from rig.report.drawing import DATA, EXACT, INK, ReportFigure, canvas, envelope, png, styled, svg
from rig.report.run_data import ShownUnit

_WIDE = 0.09


def make_decay_report(table: AnalysedTable, folder: Path) -> Sequence[tuple[str, Path]]:
    """Write report.html, its figures and positions.csv into a folder; what was made, by names.

    Raises RecordError where a file cannot be written.
    """
    target, files, positions = folder / "report.html", folder / "report", folder / "positions.csv"
    body = [
        html.heading("What was read"),
        html.notes(table.trajectory.understood),
    ]
    with styled():
        figures = [motion_figure(table)]
        for number, decay in enumerate(table.decays, start=1):
            points = turning_points(decay.swings)
            # amplitudes of an angle are in rad, those of another unit as they are
            unit = ShownUnit(table.trajectory.unit, table.trajectory.scale_rad or 1.0)
            figures.append(damped_figure(points, decay.results, unit, f"decay-{number}"))
    body += [html.picture(figures[0], svg(figures[0]), "image/svg+xml")]
    for number, (decay, figure) in enumerate(zip(table.decays, figures[1:], strict=True), start=1):
        body += [
            html.heading(f"Decay {number}"),
            html.facts(_facts(decay)),
            html.picture(figure, svg(figure), "image/svg+xml"),
            html.notes(decay.results.warnings),
        ]
    rows = io.StringIO()
    csv.writer(rows, lineterminator="\n").writerows(with_positions(table.trajectory))
    try:
        files.mkdir(parents=True, exist_ok=True)
        for figure in figures:
            whole_file.replace(files / f"{figure.name}.svg", svg(figure))
            whole_file.replace(files / f"{figure.name}.png", png(figure))
        whole_file.replace(positions, rows.getvalue().encode())
        title = Path(table.results.trajectory).name
        subtitle = f"Free decay: {len(table.decays)} {'decay' if len(table.decays) == 1 else 'decays'}"
        whole_file.replace(target, html.page(title, subtitle, body).encode())
    except OSError as error:
        raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return [("positions", positions), ("report", target)]


def motion_figure(table: AnalysedTable) -> ReportFigure:
    """The position along the motion, with the stretches that are decays."""
    trajectory = table.trajectory
    figure = canvas(2.4)
    axes = figure.subplots()
    figure.subplots_adjust(left=_WIDE, right=0.985, bottom=0.18, top=0.97)
    along = along_motion(trajectory.positions)
    middle = float(np.nanmedian(along))
    time_s = seconds(trajectory.times_ns)
    x, low, high = envelope(time_s, along - middle)
    axes.fill_between(x, low, high, color=DATA, lw=0.6)
    for decay in table.decays:
        axes.axvspan(decay.results.began_s, decay.results.ended_s, color=EXACT, alpha=0.12, lw=0)
    axes.set_xlabel("t / s")
    axes.set_ylabel(f"position / {trajectory.unit}")
    axes.set_xlim(time_s[0], time_s[-1])
    return ReportFigure(
        "motion", "Motion", "Position along the motion; the decays found in it are shaded.", figure
    )


def damped_figure(points: TurningPoints, results: RunResults, unit: ShownUnit, name: str) -> ReportFigure:
    """Amplitude against time with its residuals, period, and time constant against amplitude."""
    amplitude, u_amplitude = points.amplitude / unit.shown_size, points.u_amplitude / unit.shown_size
    figure = canvas(4.6)
    ((top, tau), (below, period)) = figure.subplots(2, 2, height_ratios=[1.5, 1.0])
    figure.subplots_adjust(left=_WIDE, right=0.985, bottom=0.1, top=0.98, hspace=0.28, wspace=0.24)
    bars: dict[str, Any] = {"color": DATA, "ecolor": DATA, "elinewidth": 0.7}
    top.errorbar(
        points.time_s, amplitude, u_amplitude, fmt="o", mfc="none", mec=DATA, ecolor=DATA, ms=3.5, lw=0.7
    )
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


def _facts(decay: FoundDecay) -> list[tuple[str, str]]:
    results = decay.results
    rows = [
        ("from, to", f"{results.began_s:.4g} to {results.ended_s:.4g} s"),
        ("half-cycles", str(decay.summary.half_cycles)),
        (
            "amplitude",
            f"{results.initial_amplitude:.4g} to {results.final_amplitude:.4g} {results.amplitude_unit}",
        ),
        ("period", f"{with_uncertainty(*results.period_s)} s"),
        ("logarithmic decrement", with_uncertainty(*results.log_decrement)),
    ]
    if results.quality_factor is not None:
        rows.append(("quality factor", with_uncertainty(*results.quality_factor)))
    found = results.damping
    if found is not None and found.curve:
        for where in (found.curve[0], found.curve[-1]):
            quality = where.quality_factor
            more = "" if quality is None else f", Q {with_uncertainty(*quality)}"
            value = f"{with_uncertainty(*where.time_constant_s)} s{more}"
            rows.append((f"time constant at {where.amplitude:.4g} {results.amplitude_unit}", value))
        rows.append(("damping needs", " and ".join(found.needed)))
    return rows
