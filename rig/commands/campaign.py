"""`rig campaign`."""

from pathlib import Path
from typing import Annotated

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import Where
from rig.commands.inputs import there, with_results
from rig.commands.json_answers import in_json
from rig.commands.outputs import folder_without, output_option


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(in_json(campaign))


def campaign(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Folders of sessions, in the order in which they were measured; each is a contact.",
            show_default=False,
            callback=with_results,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option(
            "Folder for campaign.json, page, figures and tables.",
            folder_without("campaign.json", "campaign.html"),
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="The model: parameters, effects, priors (campaign.toml).", callback=there),
    ] = None,
    archive: Annotated[
        Path | None, typer.Option(help="Take the runs of an archive; each sample is a contact.")
    ] = None,
    where: Where = "",
    by_sample: Annotated[
        bool, typer.Option("--by-sample", help="Folders with the same session.sample are one contact.")
    ] = False,
    sample: Annotated[
        bool, typer.Option("--sample", help="Sample the full posterior (emcee), with its R-hat.")
    ] = False,
) -> None:
    """Many runs, one answer: a model over all of them.

    What runs share (air, lever, masses) counts once; contacts depend on humidity, temperature, age as stated;
    bad runs are named.

    \b
    Examples:
      rig campaign runs/monday runs/tuesday -o campaigns/glass
      rig campaign --archive archive.duckdb --where "sample = 'K8'" --config campaign.toml -o campaigns/k8
    """
    if archive is None and not folders:
        raise ConfigurationError("rig campaign needs runs: name folders of sessions, or --archive")
    from rig.analysis import encoded
    from rig.campaigns import (
        NamedRuns,
        StatedCampaign,
        answer_of,
        campaign_tables,
        read_campaign,
        save_campaign,
    )
    from rig.presentation import answer, print_tables, say

    stated = StatedCampaign() if config is None else read_campaign(config)
    runs = NamedRuns(folders or [], archive, where, by_sample=by_sample).found()
    found = answer_of(runs, stated, sample=sample)
    answer(campaign=encoded(found.results))
    print_tables(campaign_tables(found))
    for line in (*found.results.left_out, *found.results.warnings):
        say(line)
    if output is not None:
        for path in save_campaign(found, output):
            answer(written=[path])
            print(f"{'campaign':<12} {path}")
