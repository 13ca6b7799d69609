"""What a campaign leaves in its folder: campaign.json, page, figures, CSV, LaTeX."""

import json
from pathlib import Path

from acquisition import atomic_write
from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.analysis import encoded
from rig.campaigns.answer import Campaign
from rig.campaigns.figures import figures_of
from rig.campaigns.tables import contacts_table, tables_of
from rig.presentation import Table, latex_table, plain_values
from rig.report import html, save_figures, save_tables, styled

_NAME = "campaign.json"


def campaign_tables(campaign: Campaign) -> list[Table]:
    """The tables, as terminal and page have them."""
    return tables_of(campaign.results, campaign.posterior.model, campaign.stated.prior)


def save_campaign(campaign: Campaign, folder: Path) -> list[Path]:
    """Write all files of a campaign into a folder, which is made; returns the first ones to look at.

    Raises RecordError where one exists or cannot be written.
    """
    files, path, target = folder / "campaign", folder / _NAME, folder / "campaign.html"
    try:
        files.mkdir(parents=True, exist_ok=True)
        text = json.dumps(plain_values(encoded(campaign.results)), indent=1, allow_nan=False) + "\n"
        atomic_write.write_new(path, text.encode())
        tables = campaign_tables(campaign)
        save_tables(tables, files)
        atomic_write.replace(files / "contacts.tex", latex_table(contacts_table(campaign.results)).encode())
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


def _page(campaign: Campaign, tables: list[Table], figures: list[str], sha256: str) -> str:
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
    body += [html.notes(results.left_out), first, *figures, *others, html.paragraph(note, "note")]
    title = "SIMULATED: Campaign" if results.simulated else "Campaign"
    return html.page(title, words, body, results_sha256=sha256)
