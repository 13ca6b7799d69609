"""Tables of a campaign, for terminal, page, CSV and LaTeX."""

from collections.abc import Mapping
from math import isfinite
from typing import Final, NamedTuple

from processing.angle import ARCSEC_RAD
from processing.campaign import ALIKE, POSITIVE
from processing.estimate import Estimate
from rig.campaigns.results import CampaignEffect, CampaignResults
from rig.presentation import SOURCES, Cell, Table, plain, quantity, with_uncertainty

_LARGEST = 4
_OTHERS: Final = {
    "order": ("order of the runs", "run", 1.0),
    "first_amplitude_rad": ("first amplitude", "first amplitude / arcsec", 1 / ARCSEC_RAD),
    "load_n": ("load", "load / N", 1.0),
}
"""Covariates that are no quantities of the surroundings: words, label, factor."""


def contacts_table(results: CampaignResults) -> Table:
    """One row a quantity of a contact, with the answer without priors beside it."""
    rows: list[list[Cell]] = []
    shown = []
    for contact, values in results.contacts.items():
        for place, (name, found) in enumerate(values.items()):
            rows.append(
                [contact, name, *found.estimate, found.lower_95, found.upper_95, *found.without_priors]
            )
            of = quantity(name)
            band = f"{plain(found.lower_95 * of.factor, 4)} … {plain(found.upper_95 * of.factor, 4)}"
            shown.append(
                [
                    contact if not place else "",
                    of.label,
                    of.text(*found.estimate),
                    band,
                    of.text(*found.without_priors),
                ]
            )
    return Table(
        "contacts",
        "Contacts",
        ("contact", "quantity", "value", "u", "lower_95", "upper_95", "without_priors", "u_without_priors"),
        rows,
        ("contact", "", "value", "95 %", "without priors"),
        shown,
        f"{len(results.runs)} run{'' if len(results.runs) == 1 else 's'}. Median and half of the 68 % band, "
        "at the reference of all effects; includes the inputs that runs share, counted once.",
    )


def effects_table(results: CampaignResults) -> Table | None:
    """One row an effect or a form that was tried; None where there is none."""
    both = [*((one, "model") for one in results.effects), *((one, "tried") for one in results.candidates)]
    if not both:
        return None
    rows: list[list[Cell]] = []
    shown = []
    for one, kind in both:
        rows.append(
            [
                one.label, kind, *one.slope, one.lower_95, one.upper_95, *one.over_span, one.chance,
                "seen" if one.seen else "not seen", one.log_bayes_factor, one.probability,
                one.equivalent, *one.slope_without_priors,
            ]
        )  # fmt: skip
        shown.append(
            [
                effect_words(one), with_uncertainty(*one.over_span, signed=True),
                f"{'< ' if one.chance_is_limit else ''}{plain(one.chance, 2)}",
                _judged(one), plain(one.probability, 2), with_uncertainty(*one.slope_without_priors),
            ]
        )  # fmt: skip
    tried = len(both)
    note = (
        f"Change over the campaign's span; of b, c and γ relative. Chance: the probability of an effect this "
        f"large if there is none; the 5 % level is shared by the {tried} that were tried."
    )
    if results.candidates:
        note += (
            f" Probability: posterior, of each form tried alone; of no effect: "
            f"{plain(results.nothing, 2)}, with a prior of one half."
        )
    return Table(
        "effects", "Effects",
        (
            "effect", "kind", "slope", "u_slope", "lower_95", "upper_95", "over_span", "u_over_span",
            "chance", "verdict", "log_bayes_factor", "probability", "equivalent",
            "slope_without_priors", "u_slope_without_priors",
        ),
        rows, ("", "over the span", "chance", "judged", "probability", "slope without priors"), shown, note,
    )  # fmt: skip


def _judged(one: CampaignEffect) -> str:
    if one.seen:
        return "seen"
    if isfinite(one.equivalent) and one.equivalent >= ALIKE:
        return f"none within ± {one.margin:g}"
    return "not seen"


def effect_words(one: CampaignEffect) -> str:
    """What depends on what, with symbols."""
    symbol = "friction" if one.parameter == "friction" else quantity(one.parameter).symbol
    if one.form == "during":
        return f"{symbol}, growing during every run"
    return f"{symbol} over {covariate_words(one.covariate)[0]} ({one.form})"


def covariate_words(name: str) -> tuple[str, str, float]:
    """A covariate in words, the label of its axis, and the factor from its stored value to the one shown."""
    if name in _OTHERS:
        return _OTHERS[name]
    of = quantity(name)
    return of.name, of.label, of.factor


def runs_table(results: CampaignResults) -> Table:
    """One row a run: how far it lies off, and how likely it is a bad one; its values in the file."""
    names = results.parameters
    columns: list[str] = ["run", "contact", "sha256", "results_sha256", "bad"]
    for name in names:
        columns += [name, f"u_{name}", f"together_{name}", f"u_together_{name}", f"residual_{name}"]
    rows: list[list[Cell]] = []
    shown = []
    nan = float("nan")
    for run in results.runs:
        cells: list[Cell] = [run.label, run.contact, run.sha256, run.results_sha256, run.bad]
        for name in names:
            cells += [
                *run.alone.get(name, (nan, nan)), *run.together.get(name, (nan, nan)),
                run.residuals.get(name, nan),
            ]  # fmt: skip
        rows.append(cells)
        off = [plain(run.residuals.get(name, nan), 2) for name in names]
        shown.append([run.label, run.contact, *off, f"{100 * run.bad:.0f} %" if run.bad > 0.05 else ""])
    return Table(
        "runs", "Residuals by run", columns, rows,
        ("run", "contact", *(quantity(name).symbol for name in names), "bad"), shown,
        "Deviation from the model over its uncertainty from the run and the scatter between runs.",
    )  # fmt: skip


def scatter_table(results: CampaignResults) -> Table:
    """How runs and contacts scatter."""
    rows: list[list[Cell]] = []
    shown = []
    for what, found in (
        ("between runs", results.between_runs),
        ("between contacts", results.between_contacts),
    ):
        for name, one in found.items():
            rows.append([what, name, *one])
            symbol = quantity(name).symbol
            label = f"ln {symbol}" if name in POSITIVE else quantity(name).label
            factor = 1.0 if name in POSITIVE else quantity(name).factor
            shown.append(
                [what, label, with_uncertainty(one.value * factor, one.standard_uncertainty * factor)]
            )
    return Table(
        "scatter", "Scatter", ("between", "quantity", "standard_deviation", "u"), rows,
        ("", "", "deviation"), shown,
        f"Standard deviations, of b and γ at {results.reference_arcsec:g} arcsec.",
    )  # fmt: skip


def budget_table(results: CampaignResults) -> Table:
    """What limits every level now: the largest parts of its variance."""
    rows: list[list[Cell]] = []
    shown = []
    for contact, budgets in results.budgets.items():
        for place, (name, parts) in enumerate(budgets.items()):
            rows += [[contact, name, one.source, one.contribution, one.share] for one in parts]
            words = [
                f"{source_words(one.source)} {100 * one.share:.0f} %"
                for one in parts[:_LARGEST]
                if one.share > 0.005
            ]
            shown.append([contact if not place else "", quantity(name).symbol, "; ".join(words)])
    return Table(
        "budget", "What limits the answer now", ("contact", "quantity", "source", "contribution", "share"),
        rows, ("contact", "", "verdict"), shown,
        "Shares of the variance of each level, in its coordinate. Shared inputs do not shrink with the "
        "number of runs; scatter and swings do.",
    )  # fmt: skip


def source_words(source: str) -> str:
    """A source of a budget, or an effect, in words."""
    if source.startswith("misfit of "):
        return f"law against decay ({quantity(source.removeprefix('misfit of ')).symbol})"
    return {"between runs": "scatter between runs", **SOURCES}.get(source, source)


def changes_table(results: CampaignResults) -> Table | None:
    """Changes that were looked for; None where nobody asked."""
    if not results.changes:
        return None
    rows: list[list[Cell]] = []
    shown = []
    for one in results.changes:
        labels = [run.label for run in results.runs]
        rows.append([one.parameter, one.probability, one.first_run, one.at_least, one.at_most])
        place = f"from {labels[one.first_run]} on ({labels[one.at_least]} to {labels[one.at_most]})"
        shown.append(
            [
                quantity(one.parameter).symbol,
                plain(one.probability, 2),
                place if one.probability > 0.5 else "none seen",
            ]
        )
    return Table(
        "changes", "Changes", ("quantity", "probability", "first_run", "at_least", "at_most"), rows,
        ("", "probability", "where"), shown,
        "Probability of a change at some run, against none, allowing for the choice of the run. Runs count "
        "from 0.",
    )  # fmt: skip


class Beliefs(NamedTuple):
    """What is supposed beforehand: usual sizes by coordinate, levels by parameter where they are stated."""

    sizes: Mapping[str, float]
    levels: Mapping[str, Estimate]


def priors_table(results: CampaignResults, beliefs: Beliefs) -> Table:
    """What was believed beforehand beside what is believed now."""
    rows: list[list[Cell]] = []
    shown = []
    for name, size in beliefs.sizes.items():
        now = results.between_runs.get(name)
        rows.append([name, size, *(now or (float("nan"), float("nan")))])
        label = f"ln {quantity(name).symbol}" if name in POSITIVE else quantity(name).label
        factor = 1.0 if name in POSITIVE else quantity(name).factor
        after = "" if now is None else with_uncertainty(now.value * factor, now.standard_uncertainty * factor)
        shown.append([f"scatter of {label}", f"half-normal, {plain(size * factor, 2)}", after])
    for source, found in results.shared.items():
        rows.append([source, 1.0, *found])
        shown.append([source_words(source), "0 ± 1 of its u", with_uncertainty(*found)])
    for key, (value, u) in beliefs.levels.items():
        rows.append([key, value, u, float("nan")])
        shown.append([quantity(key).label, quantity(key).text(value, u), "see Contacts"])
    return Table(
        "priors", "Prior and posterior", ("what", "before", "now", "u_now"), rows,
        ("", "prior", "posterior"), shown,
        "The prior of an effect: it changes a quantity by about its size over the campaign, up or down.",
    )  # fmt: skip


def tables_of(results: CampaignResults, beliefs: Beliefs) -> list[Table]:
    """All of them, in the page's order."""
    found = [
        contacts_table(results), effects_table(results), changes_table(results), scatter_table(results),
        budget_table(results), runs_table(results), priors_table(results, beliefs),
    ]  # fmt: skip
    return [one for one in found if one is not None]
