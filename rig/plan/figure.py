"""Uncertainty against the last amplitude and the time of a run."""

import numpy as np
from matplotlib.lines import Line2D

from processing.angle import ARCSEC_RAD
from rig.plan.plan import Plan
from rig.presentation import palette, quantity
from rig.report import INK, ReportFigure, canvas

_LINES = ("-", "--", ":", "-.")


def plan_figure(plan: Plan) -> ReportFigure:
    """Two panels with the same curves, a colour for each parameter and a line for each first amplitude."""
    figure = canvas(3.4)
    by_amplitude, by_time = figure.subplots(1, 2, sharey=True)
    starts = sorted({run.first_rad for run in plan.runs}, reverse=True)
    names = list(plan.runs[0].u)
    for line, first in zip(_LINES, starts, strict=False):
        runs = sorted((run for run in plan.runs if run.first_rad == first), key=lambda run: run.duration_s)
        for colour, name in zip(palette.SEQUENCE, names, strict=False):
            u_percent = np.array([100 * plan.relative(run)[name] for run in runs])
            if not np.all(np.isfinite(u_percent)):
                continue
            label = quantity(name).symbol if first == starts[0] else None
            last = np.array([run.last_rad for run in runs]) / ARCSEC_RAD
            by_amplitude.plot(last, u_percent, line, color=colour, marker=".", label=label)
            for rank, count in enumerate(plan.counts):
                minutes = [count * run.duration_s / 60 for run in runs]
                faint = 1.0 if rank == 0 else 0.45
                by_time.plot(minutes, u_percent / np.sqrt(count), line, color=colour, marker=".", alpha=faint)
    by_amplitude.set_xscale("log")
    by_amplitude.set_yscale("log")
    by_amplitude.invert_xaxis()
    lasts = sorted({run.last_rad / ARCSEC_RAD for run in plan.runs})
    by_amplitude.set_xticks(lasts, [f"{last:g}" for last in lasts])
    by_amplitude.set_xticks([], minor=True)
    by_amplitude.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    by_amplitude.set_xlabel("last amplitude / arcsec")
    by_time.set_xlabel("time of all runs / min")
    by_amplitude.set_ylabel("u / value, %")
    by_amplitude.legend(ncols=2)
    styles = [Line2D([], [], color=INK, ls=line) for line in _LINES[: len(starts)]]
    from_words = [f"from {first / ARCSEC_RAD:g}″" for first in starts]
    by_time.legend(styles, from_words)
    figure.subplots_adjust(left=0.09, right=0.985, bottom=0.14, top=0.97, wspace=0.05)
    more = ", ".join(str(count) for count in plan.counts[1:])
    words = f"Relative standard uncertainty of every parameter after {plan.counts[0]} run" + (
        f"; on the right, faint: {more} runs." if more else "."
    )
    return ReportFigure("plan", "Expected uncertainties", words, figure)
