"""The files of a campaign: campaign.json, page, figures, CSV, LaTeX."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from acquisition import atomic_write
from acquisition.record.digest import sha256_of
from processing.arrays import Floats
from processing.series import ORDER, POSITIVE, CompressedRun, Effect, Form, LatentNumber
from rig.analysis import encoded
from rig.campaigns.answer import Campaign
from rig.campaigns.tables import campaign_tables, contacts_table, covariate_words, scaled
from rig.presentation import Table, latex_table, palette, plain_values, quantity, written
from rig.report import INK, ReportFigure, canvas, html, save_figures, save_tables, styled, three_columns

_POINTS = 60
_MIN_BAD_PROBABILITY = 0.5
_BANDS = (0.025, 0.16, 0.5, 0.84, 0.975)


def _title(axes: Axes, name: str, reference_arcsec: float) -> None:
    """Set the title of a coordinate's axis; b, c and gamma are shown as relative changes."""
    label = scaled(name)[0]
    if name in POSITIVE:
        at = f" at {reference_arcsec:g} arcsec" if name in ("b", "gamma_pa") else ""
        label = f"{label}{at}, from its middle"
    axes.set_title(label, fontsize=7.5)


def _shown(name: str, values: Floats, middle: float) -> Floats:
    return values - middle if name in POSITIVE else values * quantity(name).factor


def _covariate_figure(campaign: Campaign) -> ReportFigure | None:
    """Figure of each coordinate with an effect against its covariate: runs, and 68 and 95 % bands."""
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
    margins = {"left": 0.1, "wspace": 0.42, "hspace": 0.5}
    figure, panels = three_columns(len(wanted), lambda rows: 0.6 + 2.3 * rows, **margins)
    contacts = list(results.contacts)
    colours = dict(zip(contacts, palette.SEQUENCE * len(contacts), strict=False))
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
            slope = found.draws(LatentNumber("effect", effect.label))
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
    whole_in = figure.get_figheight()
    figure.subplots_adjust(bottom=0.5 / whole_in, top=1 - 0.6 / whole_in)
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


def _residual_figure(campaign: Campaign) -> ReportFigure:
    """Figure of the deviations of the runs from the model; bad runs are shaded."""
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
        if run.bad > _MIN_BAD_PROBABILITY:
            axes.axvspan(at - 0.4, at + 0.4, color=palette.VERMILLION, alpha=0.25, lw=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="run", ylabel="deviation / u")
    axes.set_yscale("symlog", linthresh=4)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ReportFigure(
        "residuals", "Residuals by run",
        "Deviation from the model over its uncertainty from run and scatter between runs; red: bad runs.",
        figure,
    )  # fmt: skip


_NAME = "campaign.json"


def save_campaign(campaign: Campaign, folder: Path) -> list[Path]:
    """Write all files of a campaign into a folder, which is made; returns campaign.json and the page.

    Raises ConfigurationError if a file exists, RecordError if one cannot be written.
    """
    files, path, target = folder / "campaign", folder / _NAME, folder / "campaign.html"
    with written(folder):
        files.mkdir(parents=True, exist_ok=True)
        text = json.dumps(plain_values(encoded(campaign.results)), indent=1, allow_nan=False) + "\n"
        atomic_write.write_new(path, text.encode())
        tables = campaign_tables(campaign)
        save_tables(tables, files)
        atomic_write.replace(files / "contacts.tex", latex_table(contacts_table(campaign.results)).encode())
        with styled():
            over, residuals = _covariate_figure(campaign), _residual_figure(campaign)
            figures = save_figures([residuals] if over is None else [over, residuals], files)
        atomic_write.write_new(target, _page(campaign, tables, figures, sha256_of(path)).encode())
    return [path, target]


def _page(campaign: Campaign, tables: list[Table], figures: Mapping[str, str], sha256: str) -> str:
    results, sampler = campaign.results, campaign.results.sampler
    count = len(results.runs)
    words = f"{count} run{'s' if count != 1 else ''} of {', '.join(results.contacts)}"
    warnings = list(results.warnings)
    if results.simulated:
        warnings.insert(0, "SIMULATED: runs come from the simulated rig; nothing was measured.")
    method = "Laplace's method over the scatters;"
    if sampler is not None:
        method = (
            f"Sampled by emcee (worst R-hat {sampler.worst_r_hat:.3f}, at least {sampler.fewest_draws:.0f} "
            "independent draws);"
        )
    first, *others = [html.table(content) for content in tables]
    note = (
        f"{method} {results.draws_that_count:.0f} of {results.draws} draws count. Runs of the "
        f"model scatter as much as the real ones with p = {results.predictive_p:.2g}. "
        f"sha256 of {_NAME}: {sha256}."
    )
    body = [f'<div class="warn">{html.escape(line)}</div>' for line in warnings]
    body += [html.notes(results.left_out), first, *figures.values(), *others, html.paragraph(note, "note")]
    title = "SIMULATED: Campaign" if results.simulated else "Campaign"
    return html.page(title, words, body, results_sha256=sha256)
