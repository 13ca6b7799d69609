"""Tables of a campaign, for terminal, page, CSV and LaTeX."""

from math import isfinite, nan
from typing import Final

from processing.estimate import Estimate
from processing.series import ABSENT, POSITIVE
from processing.units import ARCSEC_RAD
from rig.campaigns.answer import Campaign
from rig.campaigns.likelihoods import CampaignEffect, CampaignResults
from rig.presentation import SOURCES, Cell, Table, TableRow, plain, quantity, with_uncertainty

_MAX_SHOWN_SOURCES = 4
_OTHER_COVARIATES: Final = {
    "order": ("order of the runs", "run", 1.0),
    "first_amplitude_rad": ("first amplitude", "first amplitude / arcsec", 1 / ARCSEC_RAD),
    "load_n": ("load", "load / N", 1.0),
}
"""Covariates that are not ambient conditions: words, label, factor."""


def scaled(name: str) -> tuple[str, float]:
    """Label and display factor of a coordinate's changes; those of b, c and gamma are relative."""
    of = quantity(name)
    return (f"ln {of.symbol}", 1.0) if name in POSITIVE else (of.label, of.factor)


def _text(found: Estimate, factor: float = 1.0) -> str:
    return with_uncertainty(found.value * factor, found.standard_uncertainty * factor)


def contacts_table(results: CampaignResults) -> Table:
    """Table with a row for each quantity of a contact, with and without priors."""
    rows = []
    for contact, values in results.contacts.items():
        for place, (name, found) in enumerate(values.items()):
            of, ends = quantity(name), (found.lower_95, found.upper_95)
            band = " … ".join(plain(end * of.factor, 4) for end in ends)
            rows.append(
                TableRow(
                    [contact, name, *found.estimate, *ends, *found.without_priors],
                    [
                        contact if not place else "", of.label, of.text(*found.estimate), band,
                        of.text(*found.without_priors),
                    ],
                )
            )  # fmt: skip
    return Table.of(
        "contacts", "Contacts",
        "contact quantity value u lower_95 upper_95 without_priors u_without_priors",
        ("contact", "", "value", "95 %", "without priors"), rows,
        f"{len(results.runs)} run{'' if len(results.runs) == 1 else 's'}. Median and half of the 68 % band, "
        "at the reference of all effects; includes the inputs that runs share, counted once.",
    )  # fmt: skip


def _differences_table(results: CampaignResults) -> Table | None:
    """Table of pairs of contacts that differ, all pairs in the CSV; None for a single contact."""
    if not results.differences:
        return None
    rows = []
    for one in results.differences:
        label, factor = scaled(one.parameter)
        rows.append(
            TableRow(
                [
                    one.first, one.second, one.parameter, *one.difference, one.lower_95, one.upper_95,
                    one.chance, "differ" if one.seen else "no difference seen",
                ],
                [f"{one.first} − {one.second}", label, _text(one.difference, factor), plain(one.chance, 2)]
                if one.seen
                else (),
            )
        )  # fmt: skip
    seen = sum(one.seen for one in results.differences)
    return Table.of(
        "differences", "Differences of contacts",
        "first second quantity difference u lower_95 upper_95 chance verdict",
        ("", "", "difference", "chance"), rows,
        f"{seen} of {len(rows)} differ, the others are in the CSV; the 5 % level is shared by all. What runs "
        f"share cancels. b and γ at {results.reference_arcsec:g} arcsec.",
    )  # fmt: skip


def effects_table(results: CampaignResults) -> Table | None:
    """Table with a row for each effect and each tried form; None without any."""
    both = [*((one, "model") for one in results.effects), *((one, "tried") for one in results.candidates)]
    if not both:
        return None
    rows = [
        TableRow(
            [
                one.label, kind, *one.slope, one.lower_95, one.upper_95, *one.over_span, one.chance,
                "seen" if one.seen else "not seen", one.log_bayes_factor, one.probability,
                one.equivalent, *one.slope_without_priors,
            ],
            [
                _effect_words(one), with_uncertainty(*one.over_span, signed=True),
                f"{'< ' if one.chance_is_limit else ''}{plain(one.chance, 2)}",
                _verdict_text(one), plain(one.probability, 2), _text(one.slope_without_priors),
            ],
        )
        for one, kind in both
    ]  # fmt: skip
    note = (
        f"Change over the campaign's span; of b, c and γ relative. Chance: the probability of an effect this "
        f"large if there is none; the 5 % level is shared by the {len(both)} that were tried."
    )
    if results.candidates:
        note += (
            f" Probability: posterior, of each form tried alone; of no effect: "
            f"{plain(results.nothing, 2)}, with a prior of one half."
        )
    return Table.of(
        "effects", "Effects",
        "effect kind slope u_slope lower_95 upper_95 over_span u_over_span chance verdict log_bayes_factor "
        "probability equivalent slope_without_priors u_slope_without_priors",
        ("", "over the span", "chance", "judged", "probability", "slope without priors"), rows, note,
    )  # fmt: skip


def _verdict_text(one: CampaignEffect) -> str:
    if one.seen:
        return "seen"
    if isfinite(one.equivalent) and one.equivalent >= ABSENT:
        return f"none within ± {one.margin:g}"
    return "not seen"


def _effect_words(one: CampaignEffect) -> str:
    """The parameter, the covariate and the form of an effect, in words."""
    symbol = "friction" if one.parameter == "friction" else quantity(one.parameter).symbol
    if one.form == "during":
        return f"{symbol}, growing during every run"
    return f"{symbol} over {covariate_words(one.covariate)[0]} ({one.form})"


def covariate_words(name: str) -> tuple[str, str, float]:
    """Name of a covariate, label of its axis, and factor from stored to shown values."""
    if name in _OTHER_COVARIATES:
        return _OTHER_COVARIATES[name]
    of = quantity(name)
    return of.name, of.label, of.factor


def _runs_table(results: CampaignResults) -> Table:
    """Table with a row for each run: residuals and probability of being bad; values in the CSV."""
    names, none, rows = results.parameters, (nan, nan), []
    columns = "run contact sha256 results_sha256 bad"
    for name in names:
        columns += f" {name} u_{name} together_{name} u_together_{name} residual_{name}"
    for run in results.runs:
        cells: list[Cell] = [run.label, run.contact, run.sha256, run.results_sha256, run.bad]
        off = [run.residuals.get(name, nan) for name in names]
        for name, one in zip(names, off, strict=True):
            cells += [*run.alone.get(name, none), *run.together.get(name, none), one]
        bad = f"{100 * run.bad:.0f} %" if run.bad > 0.05 else ""
        rows.append(TableRow(cells, [run.label, run.contact, *(plain(one, 2) for one in off), bad]))
    return Table.of(
        "runs", "Residuals by run", columns,
        ("run", "contact", *(quantity(name).symbol for name in names), "bad"), rows,
        "Deviation from the model over its uncertainty from the run and the scatter between runs.",
    )  # fmt: skip


def _budget_table(results: CampaignResults) -> Table:
    """Table of the largest parts of the variance of every level."""
    rows = []
    for contact, budgets in results.budgets.items():
        for place, (name, parts) in enumerate(budgets.items()):
            words = "; ".join(
                f"{source_words(one.source)} {100 * one.share:.0f} %"
                for one in parts[:_MAX_SHOWN_SOURCES]
                if one.share > 0.005
            )
            shown = [contact if not place else "", quantity(name).symbol, words]
            for rank, one in enumerate(parts):
                cells: list[Cell] = [contact, name, one.source, one.contribution, one.share]
                rows.append(TableRow(cells, () if rank else shown))
    return Table.of(
        "budget", "What limits the answer now", "contact quantity source contribution share",
        ("contact", "", "verdict"), rows,
        "Shares of the variance of each level, in its coordinate. Shared inputs do not shrink with the "
        "number of runs; scatter and swings do.",
    )  # fmt: skip


def source_words(source: str) -> str:
    """A source of a budget, or an effect, in words."""
    if source.startswith("misfit of "):
        return f"model discrepancy ({quantity(source.removeprefix('misfit of ')).symbol})"
    return {"between runs": "scatter between runs", **SOURCES}.get(source, source)


def _changes_table(results: CampaignResults) -> Table | None:
    """Table of the change points that were looked for; None if none were stated."""
    if not results.changes:
        return None
    rows, labels = [], [run.label for run in results.runs]
    for one in results.changes:
        place = f"from {labels[one.first_run]} on ({labels[one.at_least]} to {labels[one.at_most]})"
        seen = place if one.probability > 0.5 else "none seen"
        rows.append(
            TableRow(
                [one.parameter, one.probability, one.first_run, one.at_least, one.at_most],
                [quantity(one.parameter).symbol, plain(one.probability, 2), seen],
            )
        )
    return Table.of(
        "changes", "Changes", "quantity probability first_run at_least at_most",
        ("", "probability", "where"), rows,
        "Probability of a change at some run, against none, allowing for the choice of the run. Runs count "
        "from 0.",
    )  # fmt: skip


def _priors_table(campaign: Campaign) -> Table:
    """Table of prior and posterior."""
    results, model, rows = campaign.results, campaign.posterior.model, []
    for name in model.names:
        size, now = model.size(name), results.between_runs.get(name)
        label, factor = scaled(name)
        after = "" if now is None else _text(now, factor)
        before = f"half-normal, {plain(size * factor, 2)}"
        rows.append(TableRow([name, size, *(now or (nan, nan))], [f"scatter of {label}", before, after]))
    for source, found in results.shared.items():
        rows.append(TableRow([source, 1.0, *found], [source_words(source), "0 ± 1 of its u", _text(found)]))
    for key, one in campaign.stated.prior.items():
        shown = [quantity(key).label, quantity(key).text(one.value, one.u), "see Contacts"]
        rows.append(TableRow([key, one.value, one.u, nan], shown))
    return Table.of(
        "priors", "Prior and posterior", "what before now u_now", ("", "prior", "posterior"), rows,
        "The prior of an effect: it changes a quantity by about its size over the campaign, up or down.",
    )  # fmt: skip


def campaign_tables(campaign: Campaign) -> list[Table]:
    """All tables of a campaign, in order."""
    results = campaign.results
    found = [
        contacts_table(results), _differences_table(results), effects_table(results), _changes_table(results),
        _budget_table(results), _runs_table(results), _priors_table(campaign),
    ]  # fmt: skip
    return [one for one in found if one is not None]
