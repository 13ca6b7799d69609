"""Figures of decay, period, residuals, losses and moments with the fitted laws (Figs. 12 to 14)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from processing.arrays import Floats
from processing.contact import ContactParameters, PendulumOnBall, measured_losses, model_losses
from processing.errors import DataError
from processing.fit import FitMethod
from processing.swing import TurningPoints
from processing.units import ARCSEC_RAD
from rig.analysis import ComparedLaws, Curves, ModelFreeMoments
from rig.report.drawing import (
    ASYMPTOTIC,
    DATA,
    EXACT,
    INK,
    SMOOTH,
    ReportFigure,
    amplitude_axis,
    canvas,
    nonnegative_limits,
    plot_dots,
    set_y_range,
    thinned_indices,
)
from rig.report.source import DisplayUnit
from rig.terminal import palette

_MAX_DOTS = 700
_MAX_BARS = 150
_MAX_RINGS = 90
"""Largest numbers of points that are drawn in each manner."""


def decay_figure(points: TurningPoints, curves: Curves | None, unit: DisplayUnit) -> ReportFigure:
    """alpha(t), the paper's Fig. 12, with residuals below; only the data without a fit."""
    figure = canvas(4.2 if curves else 2.8)
    plotted = thinned_indices(len(points), _MAX_DOTS)
    time, size = points.time_s[plotted], unit.shown_size
    if curves is None:
        top = figure.subplots()
        top.set_xlabel("t / s")
    else:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
        residual = curves.asymptotic.amplitude_residual_rad / size * 1e3
        exact_residual = curves.exact.amplitude_residual_rad / size * 1e3
        plot_dots(bottom, time, residual[plotted], ASYMPTOTIC)
        plot_dots(bottom, time, exact_residual[plotted], EXACT)
        bottom.axhline(0, color=INK, lw=0.6)
        set_y_range(bottom, np.concatenate([residual, exact_residual]), 0.002, 0.1)
        bottom.set(xlabel="t / s", ylabel=f"data − fit / 10⁻³ {unit.shown}")
    _rings(top, points.time_s, points.amplitude / size, "turning points")
    if curves is not None:
        asymptotic, exact = (c.model_amplitude_rad / size for c in (curves.asymptotic, curves.exact))
        top.plot(points.time_s, asymptotic, color=ASYMPTOTIC, lw=2.0, label="Eq. 5")
        top.plot(points.time_s, exact, color=EXACT, lw=0.9, label=FitMethod.EXACT)
    top.set(
        ylabel=f"α / {unit.shown}",
        xlim=(0, points.time_s[-1] * 1.005),
        ylim=nonnegative_limits(points.amplitude / size, 0.04),
    )
    top.legend(loc="upper right")
    return ReportFigure(
        "fig12-decay",
        "Fig. 12: amplitude against time",
        "Amplitude of every half-cycle"
        + (" with Eq. 5 and the exact half-swing map; residuals below." if curves else "."),
        figure,
    )


def _rings(axes: Axes, x: Floats, y: Floats, label: str) -> None:
    """Draw some of the data as rings over the curves."""
    plotted = thinned_indices(len(x), _MAX_RINGS)
    label += " (some)" if len(x) > _MAX_RINGS else ""
    axes.plot(x[plotted], y[plotted], "o", mfc="none", mec=DATA, mew=0.8, ms=4.0, label=label, zorder=5)


def period_figure(curves: Curves) -> ReportFigure:
    """T(alpha), the paper's Figs. 13 and 14."""
    models = {
        "smoothing spline": (curves.smooth_s, SMOOTH, 3.0),
        "Eq. 6": (curves.asymptotic_period_s, ASYMPTOTIC, 1.8),
        FitMethod.EXACT.value: (curves.exact_period_s, EXACT, 0.9),
    }
    figure = canvas(4.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2.0, 1.0])
    order = np.argsort(curves.period_rad)
    alpha = curves.period_rad[order] / ARCSEC_RAD
    period, u = curves.period_s[order], curves.u_period_s[order]
    plotted = thinned_indices(len(order), _MAX_DOTS)
    bars = thinned_indices(len(order), _MAX_BARS)
    top.errorbar(alpha[bars], period[bars], u[bars], fmt="none", ecolor=palette.SKY_BLUE, elinewidth=0.5)
    _rings(top, alpha, period, "measured")
    # the range is that of the curves, and of data that are not too uncertain
    is_uncertain = u > 4 * np.median(u)
    for label, (values, colour, width) in models.items():
        top.plot(alpha, values[order], color=colour, lw=width, label=label)
        plot_dots(bottom, alpha[plotted], ((period - values[order]) * 1e3)[plotted], colour)
    set_y_range(top, np.concatenate([period[~is_uncertain], *(values for values, _, _ in models.values())]))
    residuals = [(period - values[order])[~is_uncertain] * 1e3 for values, _, _ in models.values()]
    set_y_range(bottom, np.concatenate(residuals), 0.005, 0.25)
    bottom.axhline(0, color=INK, lw=0.6)
    bottom.set(xlabel="α / arcsec", xlim=nonnegative_limits(alpha), ylabel="data − curve / ms")
    top.set_ylabel("T / s")
    top.ticklabel_format(axis="y", useOffset=False)
    top.legend(loc="best")
    return ReportFigure(
        "fig13-period",
        "Figs. 13 and 14: period against amplitude",
        "Full periods about every half-cycle with Eq. 6, the exact map and a smoothing spline, which assumes "
        "no physics: where Eq. 6 follows it, the data support the law. The bars are standard uncertainties, "
        "which grow as the amplitude falls.",
        figure,
    )


def residual_figure(points: TurningPoints, curves: Curves, outliers: Sequence[int]) -> ReportFigure:
    """Residuals of the exact fit in units of their standard uncertainty."""
    figure = canvas(3.6)
    grid = figure.add_gridspec(2, 2, width_ratios=[3.2, 1.0])
    residuals = {
        "amplitude": curves.exact.amplitude_residual_rad / points.u_amplitude,
        "time": curves.exact.time_residual_s / points.u_time_s,
    }
    plotted = thinned_indices(len(points), 1200)
    outlying = np.isin(points.index, outliers)
    z = np.linspace(-4.5, 4.5, 181)
    normal = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    for row, (name, values) in enumerate(residuals.items()):
        left = figure.add_subplot(grid[row, 0])
        right = figure.add_subplot(grid[row, 1], sharey=left)
        plot_dots(left, points.index[plotted], values[plotted], DATA)
        left.plot(points.index[outlying], np.clip(values[outlying], -4.4, 4.4), "x", color=EXACT, ms=4)
        left.axhline(0, color=INK, lw=0.6)
        left.set(ylim=(-4.5, 4.5), ylabel=f"{name}, (data − fit)/u", xlim=(points.index[0], points.index[-1]))
        right.hist(
            np.clip(values, -4.4, 4.4), bins=36, range=(-4.5, 4.5), orientation="horizontal", density=True,
            color=palette.SKY_BLUE,
        )  # fmt: skip
        right.plot(normal, z, color=INK, lw=0.9)
        right.tick_params(labelleft=False)
        right.set_xticks([])
        text = f"rms {np.sqrt(np.mean(values**2)):.2f}"
        right.text(0.95, 0.92, text, transform=right.transAxes, ha="right", va="top")
        if row == 0:
            left.tick_params(labelbottom=False)
            right.set_title("and the normal law")
        else:
            left.set_xlabel("half-cycle")
    return ReportFigure(
        "residuals",
        "Residuals of the exact fit",
        "In units of each half-cycle's own standard uncertainty; crosses are listed as outlying.",
        figure,
    )


def loss_figure(
    points: TurningPoints, parameters: ContactParameters, pendulum: PendulumOnBall
) -> ReportFigure:
    """Logarithmic decrement and quality factor against amplitude, measured and by the exact map."""
    figure = canvas(2.9)
    left, right = figure.subplots(1, 2)
    cycles = max(1, len(points) // 120)
    try:
        losses = measured_losses(points, cycles=cycles)
    except DataError:
        # gaps in the turning points
        cycles = 1
        losses = measured_losses(points)
    alpha = losses.amplitude_rad / ARCSEC_RAD
    left.errorbar(alpha, losses.log_decrement, losses.u_log_decrement, fmt=".", color=DATA, elinewidth=0.5)
    is_known = np.isfinite(losses.quality) & np.isfinite(losses.u_quality)
    right.errorbar(
        alpha[is_known], losses.quality[is_known], losses.u_quality[is_known], fmt=".", color=DATA,
        elinewidth=0.5, label=f"measured, {cycles} cycle{'s' if cycles > 1 else ''} each",
    )  # fmt: skip
    amplitudes = np.geomspace(points.amplitude[-1], points.amplitude[0], 80)
    model = model_losses(amplitudes, parameters, pendulum)
    x = model.amplitude_rad / ARCSEC_RAD
    left.plot(x, model.log_decrement, color=EXACT)
    right.plot(x, model.quality, color=EXACT, label=FitMethod.EXACT)
    set_y_range(left, np.concatenate([losses.log_decrement, model.log_decrement]), 0.01)
    set_y_range(right, np.concatenate([losses.quality[is_known], model.quality]), 0.01)
    left.set_ylabel("logarithmic decrement per cycle")
    right.set_ylabel("quality factor Q")
    for axes in (left, right):
        amplitude_axis(axes, float(alpha.min()), float(alpha.max()))
    right.legend(loc="best")
    return ReportFigure(
        "losses",
        "Losses against amplitude",
        "From turning points whole cycles apart, and of the exact map with the fitted parameters.",
        figure,
    )


_LAW_COLOURS = (EXACT, ASYMPTOTIC, *palette.SEQUENCE)


def moments_figure(laws: ComparedLaws, free: ModelFreeMoments) -> ReportFigure:
    """The contact's model-free moments with their bands, and the moments of the laws not excluded."""
    figure = canvas(4.6)
    panels = figure.subplots(2, 2, sharex=True, height_ratios=[1.6, 1.0])
    phi = free.phi_rad / ARCSEC_RAD
    names = [name for name in free.laws if not laws.laws[name].excluded]
    for column, (title, values, u, law_moments) in enumerate(
        (
            ("friction", free.friction_n_m, free.u_friction_n_m,
             [free.laws[name].friction_n_m for name in names]),
            ("elastic moment", free.elastic_n_m, free.u_elastic_n_m,
             [free.laws[name].elastic_n_m for name in names]),
        )
    ):  # fmt: skip
        top, bottom = panels[:, column]
        top.fill_between(phi, (values - u) * 1e9, (values + u) * 1e9, color=DATA, alpha=0.3, lw=0)
        top.plot(phi, values * 1e9, color=DATA, lw=2.0, label="no law")
        bottom.axhspan(-1, 1, color=DATA, alpha=0.3, lw=0)
        bottom.axhline(0, color=INK, lw=0.6)
        for name, law, colour in zip(names, law_moments, _LAW_COLOURS * len(names), strict=False):
            top.plot(phi, law * 1e9, color=colour, lw=0.9, label=name)
            bottom.plot(phi, (law - values) / u, color=colour, lw=0.9)
        top.set(title=title, ylabel="M / nN m")
        bottom.set_ylabel("(law − no law)/u", fontsize=7.5)
        bottom.set_ylim(-5, 5)
        amplitude_axis(bottom, float(phi[0]), float(phi[-1]))
        bottom.set(xlabel="φ / arcsec", xlim=(phi[0], phi[-1]))
    panels[0, 0].legend(loc="upper left")
    return ReportFigure(
        "moments",
        "Moments of the contact without a law",
        "Splines of the angle, fitted to amplitudes and times; bands cover 68 %. A moment "
        f"proportional to φ is gravity's: the elastic one vanishes at {free.reference_rad / ARCSEC_RAD:.3g} "
        "arcsec. Lines: the laws that the data do not exclude, reduced in the same way.",
        figure,
    )
