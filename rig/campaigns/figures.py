"""Figures of a campaign: over covariates, shrinkage, residuals by run, what limits the answer."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from processing.arrays import Floats
from processing.series import ORDER, POSITIVE, CompressedRun, Effect, Form, Level
from rig.campaigns.answer import Campaign
from rig.campaigns.results import CampaignResults
from rig.campaigns.tables import covariate_words, scaled, source_words
from rig.presentation import palette, quantity
from rig.report import INK, ReportFigure, canvas

_POINTS = 60
_BAD = 0.5
_BANDS = (0.025, 0.16, 0.5, 0.84, 0.975)


def _title(axes: Axes, name: str, reference_arcsec: float) -> None:
    """What the axis of a coordinate shows: of b, c and gamma the change as a fraction."""
    label = scaled(name)[0]
    if name in POSITIVE:
        at = f" at {reference_arcsec:g} arcsec" if name in ("b", "gamma_pa") else ""
        label = f"{label}{at}, from its middle"
    axes.set_title(label, fontsize=7.5)


def _shown(name: str, values: Floats, middle: float) -> Floats:
    return values - middle if name in POSITIVE else values * quantity(name).factor


def _grid(panels: int, height_in: float) -> tuple[Figure, list[Axes]]:
    columns = min(panels, 3)
    rows = (panels + columns - 1) // columns
    whole_in = 0.6 + height_in * rows
    figure = canvas(whole_in)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    figure.subplots_adjust(
        left=0.1, right=0.985, bottom=0.5 / whole_in, top=1 - 0.35 / whole_in, wspace=0.42, hspace=0.5
    )
    for spare in axes[panels:]:
        spare.set_visible(False)
    return figure, axes[:panels]


def _colours(contacts: Sequence[str]) -> dict[str, str]:
    return {name: palette.SEQUENCE[place % len(palette.SEQUENCE)] for place, name in enumerate(contacts)}


def _covariate_figure(campaign: Campaign) -> ReportFigure | None:
    """Each coordinate with an effect over its covariate: runs, and the model's 68 and 95 % bands."""
    found, results = campaign.posterior, campaign.results
    wanted = [
        (effect, name)
        for effect in found.model.effects
        if effect.form is not Form.DURING
        for name in effect.moves()
        if name in found.model.names
    ]
    if not wanted:
        return None
    figure, panels = _grid(len(wanted), 2.3)
    contacts = list(results.contacts)
    colours = _colours(contacts)
    for axes, (effect, name) in zip(panels, wanted, strict=True):
        place = found.model.names.index(name)
        label, factor = covariate_words(effect.covariate)[1:]
        known = [
            run for run in found.runs if _covariate(run, found.runs, effect) is not None and name in run.names
        ]
        at = np.array([_covariate(run, found.runs, effect) for run in known])
        middle = float(np.median([run.values[run.names.index(name)] for run in known]))
        grid = np.linspace(float(at.min()), float(at.max()), _POINTS)
        for contact in contacts:
            if effect.contact not in ("", contact):
                continue
            slope = found.draws(Level("effect", effect.label))
            lines = found.level_draws(contact)[:, place, None] + slope[:, None] * effect.value(grid)
            bands = np.array([found.quantiles(line, _BANDS) for line in lines.T])
            shown = _shown(name, bands, middle)
            colour = colours[contact]
            axes.fill_between(grid * factor, shown[:, 0], shown[:, 4], color=colour, alpha=0.15, lw=0)
            axes.fill_between(grid * factor, shown[:, 1], shown[:, 3], color=colour, alpha=0.3, lw=0)
            axes.plot(grid * factor, shown[:, 2], color=colour, label=contact)
            own = [i for i, run in enumerate(known) if run.contact == contact]
            values = np.array([known[i].values[known[i].names.index(name)] for i in own])
            u = scaled(name)[1] * np.array([known[i].u(name) for i in own])
            axes.errorbar(
                at[own] * factor, _shown(name, values, middle), u, fmt="o", ms=3, color=colour,
                elinewidth=0.7, mec=INK, mew=0.3,
            )  # fmt: skip
        if effect.form is Form.LOGARITHM:
            axes.set_xscale("log")
        axes.set_xlabel(label)
        _title(axes, name, results.reference_arcsec)
    figure.subplots_adjust(top=1 - 0.6 / figure.get_figheight())
    figure.legend(*panels[0].get_legend_handles_labels(), loc="upper center", ncols=4)
    return ReportFigure(
        "covariates",
        "Parameters over what the runs were measured under",
        "Points: each run alone with its standard uncertainty. Lines and bands: the campaign's median, 68 "
        "and 95 %, without the scatter between runs.",
        figure,
    )


def _covariate(run: CompressedRun, runs: Sequence[CompressedRun], effect: Effect) -> float | None:
    if effect.covariate == ORDER:
        return float([other is run for other in runs].index(True))
    found = run.covariates.get(effect.covariate)
    return None if found is None else found.value


def _shrinkage_figure(campaign: Campaign) -> ReportFigure:
    """Each run alone beside what the campaign says of it."""
    found, results = campaign.posterior, campaign.results
    names = found.model.names
    figure, panels = _grid(len(names), 2.0)
    together, u_together = found.of_runs
    colours = _colours(list(results.contacts))
    for place, (axes, name) in enumerate(zip(panels, names, strict=True)):
        own = [row for row, run in enumerate(found.runs) if name in run.names]
        if not own:
            axes.set_visible(False)
            continue
        values = np.array([found.runs[row].values[found.runs[row].names.index(name)] for row in own])
        middle = float(np.median(values))
        scale = scaled(name)[1]
        for row, value in zip(own, values.tolist(), strict=True):
            x = row + 1
            colour = colours[found.runs[row].contact]
            pair = _shown(name, np.array([value, together[row, place]]), middle)
            axes.errorbar(
                x - 0.17, pair[0], scale * found.runs[row].u(name), fmt="o", ms=2.5, mfc="white",
                color=colour, elinewidth=0.6,
            )  # fmt: skip
            axes.errorbar(
                x + 0.17, pair[1], scale * u_together[row, place], fmt="o", ms=2.5, color=colour,
                elinewidth=1.2,
            )  # fmt: skip
            axes.plot([x - 0.17, x + 0.17], pair, color=colour, lw=0.5)
        axes.set_xlim(0.4, len(found.runs) + 0.6)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        _title(axes, name, results.reference_arcsec)
        axes.set_xlabel("run")
    return ReportFigure(
        "shrinkage", "Each run alone and in the campaign",
        "Open: the run alone. Filled: with all that the other runs say. Colours are contacts.", figure,
    )  # fmt: skip


def _residual_figure(campaign: Campaign) -> ReportFigure:
    """Deviations of the runs from the model, by run; bad runs are ringed."""
    results = campaign.results
    names = results.parameters
    figure = canvas(2.6)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.08, right=0.86, bottom=0.17, top=0.96)
    x = np.arange(1, len(results.runs) + 1)
    for band, alpha in ((2, 0.1), (1, 0.15)):
        axes.axhspan(-band, band, color=palette.GREY, alpha=alpha, lw=0)
    for place, name in enumerate(names):
        z = np.array([run.residuals.get(name, np.nan) for run in results.runs])
        axes.plot(
            x + 0.08 * (place - 0.5 * len(names)), z, "o", ms=3.2, label=quantity(name).symbol,
            color=palette.SEQUENCE[place % len(palette.SEQUENCE)],
        )  # fmt: skip
    for at, run in zip(x.tolist(), results.runs, strict=True):
        if run.bad > _BAD:
            axes.axvspan(at - 0.4, at + 0.4, color=palette.VERMILLION, alpha=0.25, lw=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("run")
    axes.set_ylabel("deviation / u")
    axes.set_yscale("symlog", linthresh=4)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ReportFigure(
        "residuals", "Residuals by run",
        "Deviation from the model over its uncertainty from run and scatter between runs; red: bad runs.",
        figure,
    )  # fmt: skip


def _budget_figure(results: CampaignResults) -> ReportFigure:
    """Shares of the variance of each level of the first contact."""
    contact, budgets = next(iter(results.budgets.items()))
    sources = sorted(
        {one.source for parts in budgets.values() for one in parts if one.share > 0.01},
        key=lambda source: (
            -sum(one.share for parts in budgets.values() for one in parts if one.source == source)
        ),
    )
    figure = canvas(0.9 + 0.28 * len(budgets))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.08, right=0.66, bottom=0.2, top=0.97)
    left = np.zeros(len(budgets))
    for place, source in enumerate(sources):
        share = np.array(
            [sum(one.share for one in parts if one.source == source) for parts in budgets.values()]
        )
        axes.barh(
            np.arange(len(budgets)), share, left=left, label=source_words(source),
            color=palette.SEQUENCE[place % len(palette.SEQUENCE)],
        )  # fmt: skip
        left += share
    axes.set_yticks(range(len(budgets)), [quantity(name).symbol for name in budgets])
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    axes.set_xlabel("share of the variance")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=7)
    return ReportFigure(
        "budget", f"What limits {contact} now", "Shares of the variance of each level.", figure
    )


def figures_of(campaign: Campaign) -> list[ReportFigure]:
    """All of them, in the page's order."""
    over = _covariate_figure(campaign)
    return [
        *([] if over is None else [over]), _shrinkage_figure(campaign), _residual_figure(campaign),
        _budget_figure(campaign.results),
    ]  # fmt: skip
