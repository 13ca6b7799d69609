"""What a campaign leaves in its folder: campaign.json, page, figures, CSV, LaTeX."""

import json
from math import isfinite
from pathlib import Path
from typing import Final

from acquisition import atomic_write
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from processing.estimate import Estimate
from rig.analysis import encoded
from rig.campaigns.answer import Campaign
from rig.campaigns.figures import figures_of
from rig.campaigns.results import CampaignResults
from rig.campaigns.tables import Beliefs, tables_of
from rig.presentation import Table, plain_values, quantity, rounded
from rig.report import html, save_figures, save_tables, styled

NAME = "campaign.json"
PAGE = "campaign.html"
FOLDER = "campaign"


def campaign_tables(campaign: Campaign) -> list[Table]:
    """The tables, as terminal and page have them."""
    model = campaign.posterior.model
    levels = {name: Estimate(one.value, one.u) for name, one in campaign.stated.prior.items()}
    return tables_of(campaign.results, Beliefs({name: model.size(name) for name in model.names}, levels))


def save_campaign(campaign: Campaign, folder: Path) -> list[Path]:
    """Write all files of a campaign into a folder, which is made; returns the first ones to look at.

    Raises RecordError where one exists or cannot be written.
    """
    files = folder / FOLDER
    path, target = folder / NAME, folder / PAGE
    try:
        files.mkdir(parents=True, exist_ok=True)
        text = json.dumps(plain_values(encoded(campaign.results)), indent=1, allow_nan=False) + "\n"
        atomic_write.write_new(path, text.encode())
        tables = campaign_tables(campaign)
        save_tables(tables, files)
        atomic_write.replace(files / "contacts.tex", latex_table(campaign.results).encode())
        with styled():
            figures = save_figures(figures_of(campaign), files)
        atomic_write.write_new(target, _page(campaign, tables, figures, sha256_of(path)).encode())
    except FileExistsError as error:
        raise RecordError(
            f"{error.filename or path}: exists already and is not overwritten; choose another folder"
        ) from None
    except OSError as error:
        raise RecordError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return [path, target]


def _method(results: CampaignResults) -> str:
    if results.sampler is None:
        return "Laplace's method over the scatters;"
    found = results.sampler
    return (
        f"Sampled by emcee (worst R-hat {found.worst_r_hat:.3f}, at least {found.fewest_draws:.0f} "
        "independent draws);"
    )


def _page(campaign: Campaign, tables: list[Table], figures: list[str], sha256: str) -> str:
    results = campaign.results
    count = len(results.runs)
    words = f"{count} run{'s' if count != 1 else ''} of {', '.join(results.contacts)}"
    body = []
    if results.simulated:
        body.append(
            '<div class="warn">SIMULATED: runs come from the simulated rig; nothing was measured.</div>'
        )
    body += [f'<div class="warn">{html.escape(line)}</div>' for line in results.warnings]
    body.append(html.notes(results.left_out))
    shown = [html.table(content) for content in tables]
    body += [shown[0], *figures, *shown[1:]]
    body.append(
        html.paragraph(
            f"{_method(results)} {results.draws_that_count:.0f} of {results.draws} draws count. Runs of the "
            f"model scatter as much as the real ones with p = {results.predictive_p:.2g}. "
            f"sha256 of {NAME}: {sha256}.",
            "note",
        )
    )
    title = "SIMULATED: Campaign" if results.simulated else "Campaign"
    return html.page(title, words, body, results_sha256=sha256)


_SYMBOLS: Final = {
    "b": "b", "p": "p", "c": "c", "n": "n", "period0_s": "T_0", "gamma_pa": r"\gamma", "drag_s": r"d",
    "surface_energy_table2_j_per_m2": r"\sigma",
}  # fmt: skip
_UNITS: Final = {
    "MPa": r"\mega\pascal", "s": r"\second", "ms": r"\milli\second",
    "mJ/m²": r"\milli\joule\per\square\metre",
}  # fmt: skip


def latex_table(results: CampaignResults) -> str:
    """A `tabular` whose numbers are siunitx's, with uncertainties in the digits of the value."""
    names = list(dict.fromkeys(name for values in results.contacts.values() for name in values))
    head = ["contact"]
    for name in names:
        of = quantity(name)
        unit = f" / \\unit{{{_UNITS[of.unit]}}}" if of.unit in _UNITS else ""
        head.append(f"${_SYMBOLS.get(name, of.symbol)}${unit}")
    lines = [
        "% \\usepackage{siunitx, booktabs}; value and standard uncertainty",
        "\\begin{tabular}{l" + "c" * len(names) + "}",
        "\\toprule",
        " & ".join(head) + r" \\",
        "\\midrule",
    ]
    for contact, values in results.contacts.items():
        cells = [_escaped(contact)]
        for name in names:
            found = values.get(name)
            factor = quantity(name).factor
            cells.append(
                "" if found is None else _number(found.value * factor, found.standard_uncertainty * factor)
            )
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""])


def _number(value: float, u: float) -> str:
    """`\\num{3.733(10)e-3}`."""
    if not isfinite(value) or not isfinite(u) or u <= 0:
        return "{--}"
    found = rounded(value, u)
    digits = found.u.replace(".", "").lstrip("0")
    exponent = f"e{found.exponent}" if found.exponent else ""
    return f"\\num{{{found.value.replace('−', '-')}({digits}){exponent}}}"


def _escaped(text: str) -> str:
    return "".join(f"\\{sign}" if sign in "&%$#_{}" else sign for sign in text)
