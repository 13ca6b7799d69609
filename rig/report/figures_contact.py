"""Moments of the contact (Table 4), runs of a series beside each other."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from processing.contact import ContactParameters, PendulumOnBall, cycle_work, moment_loop, weight_moment
from processing.fit import FitMethod
from processing.units import ARCSEC_RAD
from rig.analysis import TABLE4_AMPLITUDE_ARCSEC, ResultRow, Series
from rig.presentation import palette, plain, quantity
from rig.report.drawing import ASYMPTOTIC, DATA, EXACT, INK, ReportFigure, canvas, three_columns


def loop_figure(
    parameters: ContactParameters, pendulum: PendulumOnBall, amplitude_arcsec: float, *, sees_c: bool
) -> ReportFigure:
    """The three loops of Table 4 at an amplitude that was measured, with the rectangle of the adhesive work.

    Where the data do not determine c there is no such rectangle.
    """
    amplitude_rad, of_paper = amplitude_arcsec * ARCSEC_RAD, amplitude_arcsec == TABLE4_AMPLITUDE_ARCSEC
    loop = moment_loop(amplitude_rad, asdict(parameters), pendulum)
    work = cycle_work(amplitude_rad, parameters, pendulum)
    phi = loop.phi_rad / ARCSEC_RAD
    closed = np.append(phi, phi[0])
    figure = canvas(2.75)
    panels = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.075, right=0.99, bottom=0.165, top=0.9, wspace=0.3)
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
        axes.set_title(title)
        axes.set_xlabel("φ / arcsec")
    said = [(0.96, f"4A = {plain(work.dissipated_j * 1e15)} fJ")]
    if sees_c:
        adhesive = weight_moment(pendulum) * parameters.c * 1e9
        panels[0].plot(
            np.array([-1, 1, 1, -1, -1]) * amplitude_arcsec,
            np.array([-1, -1, 1, 1, -1]) * adhesive,
            ls=(0, (4, 2)), color=INK, lw=0.9,
        )  # fmt: skip
        said.append((0.11, f"4Aₜ = {plain(work.adhesive_j * 1e15)} fJ"))
    for place, text in said:
        panels[0].text(0.5, place, text, transform=panels[0].transAxes, ha="center", va="top", fontsize=7.5)
    panels[0].set_ylabel("M / nN m")
    return ReportFigure(
        "table4-loops",
        f"Moments over one cycle at {amplitude_arcsec:.4g} arcsec" + (" (Table 4)" if of_paper else ""),
        "Shaded: 4A, the work lost in a cycle. "
        + ("Dashed: 4Aₜ, the part of adhesion (c). " if sees_c else "")
        + "The elastic moment is the skeletal curve about which the total makes its loop.",
        figure,
    )


def series_figure(series: Series) -> ReportFigure:
    """Every parameter of every run, and the combined value with its 95 % interval."""
    method = FitMethod.EXACT if FitMethod.EXACT in series.fits else next(iter(series.fits))
    combined = series.fits[method]
    names = list(combined)
    figure, panels = three_columns(
        len(names),
        lambda rows: 0.35 + 1.55 * rows,
        left=0.115,
        bottom=0.11,
        top=0.93,
        wspace=0.55,
        hspace=0.5,
    )
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
        "Exact fit of each run with its standard uncertainty; line and band: combined value, 95 % interval.",
        figure,
    )


def comparison_figure(names: Sequence[str], series: Mapping[str, Mapping[str, ResultRow]]) -> ReportFigure:
    """One panel a parameter, one bar a series: its 95 % interval, and the value where there is one."""
    figure, panels = three_columns(
        len(names), lambda rows: 0.5 + 1.9 * rows, left=0.1, bottom=0.16, top=0.93, wspace=0.5, hspace=0.75
    )
    x = np.arange(len(series))
    for axes, name in zip(panels, names, strict=True):
        scale = quantity(name).factor
        for position, (values, colour) in enumerate(
            zip(series.values(), (DATA, EXACT, ASYMPTOTIC, *palette.SEQUENCE) * len(series), strict=False)
        ):
            if (row := values.get(name)) is None:
                continue
            axes.plot(position, row.value * scale, "o", color=colour, ms=4)
            ends = [row.lower * scale, row.upper * scale]
            axes.plot([position, position], ends, "_-", color=colour, lw=0.9, ms=5)
        axes.set_xticks(x, list(series), rotation=25, ha="right")
        axes.set_xlim(-0.5, len(series) - 0.5)
        axes.set_title(quantity(name).label)
        axes.tick_params(axis="y", labelsize=7)
    return ReportFigure("comparison", "Series compared", "Bars are 95 % intervals of each series.", figure)
