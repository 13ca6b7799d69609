"""Tables of a campaign for terminal, page and LaTeX, and its files: campaign.json, page, figures."""

import json
from collections.abc import Mapping, Sequence
from math import isfinite, nan
from pathlib import Path

import numpy as np

from acquisition import atomic_write
from acquisition.record.digest import sha256_of
from processing.arrays import Floats
from processing.estimate import Estimate
from processing.series import ABSENT, POSITIVE, Form, LatentNumber
from rig.analysis import encoded
from rig.report import html
from rig.report.campaign import Campaign
from rig.report.campaign_input import CandidateRun
from rig.report.drawing import INK, ReportFigure, three_columns
from rig.report.likelihoods import CampaignEffect, CampaignResults
from rig.terminal import (
    SOURCES,
    Table,
    latex_table,
    palette,
    plain,
    plain_values,
    quantity,
    translated_file_errors,
    with_uncertainty,
)

_MAX_LISTED_SOURCES = 4


def _change_label(name: str) -> tuple[str, float]:
    """Label and display factor of a coordinate's changes; those of b, c and gamma are relative."""
    display = quantity(name)
    return (f"ln {display.symbol}", 1.0) if name in POSITIVE else (display.label, display.factor)


def _text(estimate: Estimate, factor: float = 1.0) -> str:
    return with_uncertainty(estimate.value * factor, estimate.standard_uncertainty * factor)


def _contacts_table(results: CampaignResults) -> Table:
    """Table with a row for each quantity of a contact, with and without priors."""
    rows = []
    for contact, values in results.contacts.items():
        for rank, (name, posterior) in enumerate(values.items()):
            display, ends = quantity(name), (posterior.lower_95, posterior.upper_95)
            band = " … ".join(plain(end * display.factor, 4) for end in ends)
            texts = [display.text(*posterior.estimate), band, display.text(*posterior.without_priors)]
            rows.append([contact if not rank else "", display.label, *texts])
    return Table(
        "contacts", "Contacts",
        ("contact", "", "value", "95 %", "without priors"), rows,
        f"{len(results.runs)} run{'' if len(results.runs) == 1 else 's'}. Median and half of the 68 % band, "
        "at the reference of all effects; includes the inputs that runs share, counted once.",
    )  # fmt: skip


def _differences_table(results: CampaignResults) -> Table | None:
    """Table of pairs of contacts that differ; None for a single contact."""
    if not results.differences:
        return None
    rows = []
    for item in (item for item in results.differences if item.seen):
        label, factor = _change_label(item.parameter)
        pair = f"{item.first} − {item.second}"
        rows.append([pair, label, _text(item.difference, factor), plain(item.chance, 2)])
    note = (
        f"{len(rows)} of {len(results.differences)} differ (all are in campaign.json, -o); the 5 % "
        f"level is shared by all. What runs share cancels. b and γ at {results.reference_arcsec:g} arcsec."
    )
    return Table("differences", "Differences of contacts", ("", "", "difference", "chance"), rows, note)


def effects_table(results: CampaignResults) -> Table | None:
    """Table with a row for each effect; None without any."""
    if not results.effects:
        return None
    rows = [
        [
            _effect_text(effect), with_uncertainty(*effect.over_span, signed=True),
            f"{'< ' if effect.chance_is_limit else ''}{plain(effect.chance, 2)}",
            _verdict_text(effect), _text(effect.slope_without_priors),
        ]
        for effect in results.effects
    ]  # fmt: skip
    note = (
        f"Change over the campaign's span; of b, c and γ relative. Chance: the probability of an effect this "
        f"large if there is none; the 5 % level is shared by the {len(results.effects)} that were tried."
    )
    return Table(
        "effects", "Effects", ("", "over the span", "chance", "judged", "slope without priors"), rows, note,
    )  # fmt: skip


def _verdict_text(effect: CampaignEffect) -> str:
    if effect.seen:
        return "seen"
    if isfinite(effect.equivalent) and effect.equivalent >= ABSENT:
        return f"none within ± {effect.margin:g}"
    return "not seen"


def _effect_text(effect: CampaignEffect) -> str:
    """The parameter, the covariate and the form of an effect, in words."""
    symbol = "friction" if effect.parameter == "friction" else quantity(effect.parameter).symbol
    if effect.form == "during":
        return f"{symbol}, growing during every run"
    return f"{symbol} over {quantity(effect.covariate).name} ({effect.form})"


def _runs_table(results: CampaignResults) -> Table:
    """Table with a row for each run: residuals and probability of being bad."""
    names, rows = results.parameters, []
    for run in results.runs:
        residuals = [plain(run.residuals.get(name, nan), 2) for name in names]
        bad = f"{100 * run.bad:.0f} %" if run.bad > 0.05 else ""
        rows.append([run.label, run.contact, *residuals, bad])
    return Table(
        "runs", "Residuals by run",
        ("run", "contact", *(quantity(name).symbol for name in names), "bad"), rows,
        "Deviation from the model over its uncertainty from the run and the scatter between runs.",
    )  # fmt: skip


def _budget_table(results: CampaignResults) -> Table:
    """Table of the largest shares of the variance of every level."""
    rows = []
    for contact, budgets in results.budgets.items():
        for rank, (name, shares) in enumerate(budgets.items()):
            text = "; ".join(
                f"{_source_text(source)} {100 * share:.0f} %"
                for source, share in list(shares.items())[:_MAX_LISTED_SOURCES]
                if share > 0.005
            )
            rows.append([contact if not rank else "", quantity(name).symbol, text])
    return Table(
        "budget", "What limits the answer now", ("contact", "", "verdict"), rows,
        "Shares of the variance of each level, in its coordinate. Shared inputs do not shrink with the "
        "number of runs; scatter and swings do.",
    )  # fmt: skip


def _source_text(source: str) -> str:
    """A source of a budget, or an effect, in words."""
    if source.startswith("discrepancy of "):
        return f"model discrepancy ({quantity(source.removeprefix('discrepancy of ')).symbol})"
    return {"between runs": "scatter between runs", **SOURCES}.get(source, source)


def _changes_table(results: CampaignResults) -> Table | None:
    """Table of the change points that were looked for; None if none were stated."""
    if not results.changes:
        return None
    rows, labels = [], [run.label for run in results.runs]
    for change in results.changes:
        text = f"from {labels[change.first_run]} on ({labels[change.at_least]} to {labels[change.at_most]})"
        text = text if change.probability > 0.5 else "none seen"
        rows.append([quantity(change.parameter).symbol, plain(change.probability, 2), text])
    note = "Probability of a change at some run, against none, allowing for the choice of the run."
    return Table("changes", "Changes", ("", "probability", "where"), rows, note)


def _priors_table(campaign: Campaign) -> Table:
    """Table of prior and posterior."""
    results, model, rows = campaign.results, campaign.posterior.model, []
    for name in model.names:
        scatter = results.between_runs.get(name)
        label, factor = _change_label(name)
        prior_text = f"half-normal, {plain(model.size(name) * factor, 2)}"
        rows.append([f"scatter of {label}", prior_text, "" if scatter is None else _text(scatter, factor)])
    for source, estimate in results.shared.items():
        rows.append([_source_text(source), "0 ± 1 of its u", _text(estimate)])
    for key, prior in campaign.stated.prior.items():
        rows.append([quantity(key).label, quantity(key).text(prior.value, prior.u), "see Contacts"])
    return Table(
        "priors", "Prior and posterior", ("", "prior", "posterior"), rows,
        "The prior of an effect: it changes a quantity by about its size over the campaign, up or down.",
    )  # fmt: skip


def decays_table(runs: Sequence[CandidateRun]) -> Table:
    """Table of period and decrement of runs without a fit, which no model can compare."""
    names = ("mean_period_s", "log_decrement")
    lines = [[run.label, *(run.run[name].text for name in names)] for run in runs]
    title = "SIMULATED: decays" if any(run.run.simulated for run in runs) else "Decays"
    return Table(
        "decays", title, ("", *(quantity(name).label for name in names)), lines,
        "Value ± standard uncertainty. No run is fitted, and the model is one of the laws of the contact.",
    )  # fmt: skip


def campaign_tables(campaign: Campaign) -> list[Table]:
    """All tables of a campaign, in order."""
    makers = (
        _contacts_table, _differences_table, effects_table, _changes_table, _budget_table, _runs_table,
    )  # fmt: skip
    tables = [*(make(campaign.results) for make in makers), _priors_table(campaign)]
    return [table for table in tables if table is not None]


_CURVE_POINTS = 60
_BAND_QUANTILES = (0.025, 0.16, 0.5, 0.84, 0.975)


def _plotted_values(name: str, values: Floats, middle: float) -> Floats:
    return values - middle if name in POSITIVE else values * quantity(name).factor


def _covariate_figures(campaign: Campaign) -> list[ReportFigure]:
    """Figure of each coordinate with an effect, and with points, against its covariate: runs and bands."""
    posterior, results = campaign.posterior, campaign.results
    plots = []
    for effect in posterior.model.effects:
        for name in effect.moves() if effect.form is not Form.DURING else ():
            known = [
                run for run in posterior.runs if effect.covariate in run.covariates and name in run.names
            ]
            if known and name in posterior.model.names:
                plots.append((effect, name, known))
    if not plots:
        return []
    figure, panels = three_columns(len(plots), lambda rows: 0.6 + 2.3 * rows)
    contacts = list(results.contacts)
    colours = dict(zip(contacts, palette.SEQUENCE * len(contacts), strict=False))
    for axes, (effect, name, known) in zip(panels, plots, strict=True):
        column = posterior.model.names.index(name)
        covariate = quantity(effect.covariate)
        factor = covariate.factor
        x = np.array([run.covariates[effect.covariate] for run in known])
        middle = float(np.median([run.values[run.names.index(name)] for run in known]))
        grid = np.linspace(float(x.min()), float(x.max()), _CURVE_POINTS)
        for contact in contacts:
            if effect.contact not in ("", contact):
                continue
            slope = posterior.draws(LatentNumber("effect", effect.label))
            lines = posterior.level_draws(contact)[:, column, None] + slope[:, None] * effect.value(grid)
            bands = np.array([posterior.quantiles(line, _BAND_QUANTILES) for line in lines.T])
            curves = _plotted_values(name, bands, middle)
            colour = colours[contact]
            axes.fill_between(grid * factor, curves[:, 0], curves[:, 4], color=colour, alpha=0.15, lw=0)
            axes.fill_between(grid * factor, curves[:, 1], curves[:, 3], color=colour, alpha=0.3, lw=0)
            axes.plot(grid * factor, curves[:, 2], color=colour, label=contact)
            members = [i for i, run in enumerate(known) if run.contact == contact]
            values = np.array([known[i].values[known[i].names.index(name)] for i in members])
            u = _change_label(name)[1] * np.array([known[i].u(name) for i in members])
            axes.errorbar(
                x[members] * factor, _plotted_values(name, values, middle), u, fmt="o", ms=3, color=colour,
                elinewidth=0.7, mec=INK, mew=0.3,
            )  # fmt: skip
        if effect.form is Form.LOGARITHM:
            axes.set_xscale("log")
        axes.set_xlabel(covariate.label)
        # b, c and gamma are shown as relative changes
        reference = f" at {results.reference_arcsec:g} arcsec" if name in ("b", "gamma_pa") else ""
        title = _change_label(name)[0]
        axes.set_title(f"{title}{reference}, from its middle" if name in POSITIVE else title, fontsize=7.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    title = "Parameters over what the runs were measured under"
    caption = (
        "Points: each run alone with its standard uncertainty. Lines and bands: the campaign's median, 68 "
        "and 95 %, without the scatter between runs."
    )
    return [ReportFigure("covariates", title, caption, figure)]


_NAME = "campaign.json"


def save_campaign(campaign: Campaign, folder: Path) -> list[Path]:
    """Write all files of a campaign into a folder, which is made; returns campaign.json and the page."""
    figure_folder, path, target = folder / "campaign", folder / _NAME, folder / "campaign.html"
    with translated_file_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(plain_values(encoded(campaign.results)), indent=1, allow_nan=False) + "\n"
        atomic_write.write_new(path, text.encode())
        tables = campaign_tables(campaign)
        figures = html.save_figures(figure_folder, lambda: _covariate_figures(campaign))
        latex = latex_table(_contacts_table(campaign.results))
        atomic_write.replace(figure_folder / "contacts.tex", latex.encode())
        atomic_write.write_new(target, _page(campaign, tables, figures, sha256_of(path)).encode())
    return [path, target]


def _page(campaign: Campaign, tables: list[Table], figures: Mapping[str, str], sha256: str) -> str:
    results = campaign.results
    count = len(results.runs)
    subtitle = f"{count} run{'s' if count != 1 else ''} of {', '.join(results.contacts)}"
    method = "Laplace's method over the scatters;"
    if isfinite(results.worst_r_hat):
        method = (
            f"Sampled by emcee (worst R-hat {results.worst_r_hat:.3f}, at least {results.fewest_draws:.0f} "
            "independent draws);"
        )
    first, *others = [html.table(content) for content in tables]
    count_text = f"{results.draws_that_count:.0f} of {results.draws} draws count."
    note = f"{method} {count_text} sha256 of {_NAME}: {sha256}."
    body = [*map(html.warning, results.warnings)]
    body += [
        html.remark_list(results.left_out),
        first,
        *figures.values(),
        *others,
        html.paragraph(note, "note"),
    ]
    title = "SIMULATED: Campaign" if results.simulated else "Campaign"
    return html.page(title, subtitle, body, results_sha256=sha256)
