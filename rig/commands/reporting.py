"""`rig report`, `rig paper`, `rig export`, `rig compare` and `rig plan`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import (
    Set,
    Where,
    existing_toml,
    folder_without,
    in_json,
    input_argument,
    input_option,
    is_of_table,
    new_file,
    new_page,
    one_record,
    output_option,
    print_written,
    record_or_results,
    results_folder,
)


@in_json
def report(
    folder: Annotated[Path, input_argument("Folder of a session, or a results file.", results_folder)],
    output: Annotated[
        Path | None,
        output_option("HTML file to write; default: report.html in the folder, overwritten.", new_page),
    ] = None,
) -> None:
    """Write a report: an HTML page, and its figures as SVG and PNG.

    \b
    Example:
      rig report runs/first
    """
    from rig.report import make_report

    print_written(make_report(folder, output))


@in_json
def paper() -> None:
    """Simulate the paper's runs and compare with its tables."""
    from rig.report import reproduce_paper

    reproduce_paper()


@in_json
def export(
    source: Annotated[Path, input_argument("Folder of a session, or one record (.mcap).", results_folder)],
    output: Annotated[Path, output_option("Folder to write; with hdf5: file.", show_default=False)],
    format_: Annotated[
        Literal["csv", "parquet", "hdf5", "latex"],
        typer.Option("--format", help="hdf5: NeXus; latex: the report's tables."),
    ] = "csv",
) -> None:
    """Export spots, half-cycles and results for other programs.

    \b
    Example:
      rig export runs/first --format csv -o runs/csv
    """
    from rig.report import export_session

    (new_file(makes_folders=True) if format_ == "hdf5" else folder_without())(output)
    print_written(*export_session(source, format_, output))


@in_json
def compare(
    folders: Annotated[
        list[Path] | None,
        input_argument(
            "Folders of sessions; each is a contact, in the order of measurement.", results_folder
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option(
            "Folder for campaign.json, page and figures.",
            folder_without("campaign.json", "campaign.html"),
        ),
    ] = None,
    model: Annotated[
        Path | None,
        input_option(
            "What may depend on what, and priors (campaign.toml); default: nothing depends on anything.",
            check=existing_toml("docs/many-runs.md shows such a file"),
        ),
    ] = None,
    archive: Annotated[
        Path | None, typer.Option(help="Take the runs of an archive; each sample is a contact.")
    ] = None,
    where: Where = "",
    sample: Annotated[
        bool, typer.Option("--sample", help="Sample the full posterior (emcee), with its R-hat.")
    ] = False,
) -> None:
    """Compare contacts by one model over all of their runs.

    What runs share (air, lever, masses) counts once; contacts depend on humidity, temperature, age as stated;
    bad runs are named.

    \b
    Examples:
      rig compare runs/glass runs/silicon
      rig compare runs/monday runs/tuesday --model campaign.toml -o campaigns/glass
      rig compare --archive archive.duckdb --where "sample = 'K8'" -o campaigns/k8
    """
    if archive is None and not folders:
        raise ConfigurationError("rig compare needs runs: name folders of sessions, or --archive")
    if archive is not None and folders:
        raise ConfigurationError(f"{folders[0]}: folders and --archive exclude each other; leave one out")
    if where and archive is None:
        raise ConfigurationError(f"--where {where!r}: has no effect without --archive")
    from rig.analysis import encoded
    from rig.report import (
        StatedCampaign,
        campaign_tables,
        decays_table,
        fit_model,
        read_campaign,
        runs_of_archive,
        runs_of_folders,
        save_campaign,
    )
    from rig.terminal import answer, print_tables, say

    stated = StatedCampaign() if model is None else read_campaign(model)
    if archive is None:
        runs = runs_of_folders(folders or [])
    else:
        from rig.archive import ordered_runs

        runs = runs_of_archive(ordered_runs(archive, where))
    if output is None and not any(run.run.fits for run in runs):
        print_tables([decays_table(runs)])
        return
    campaign = fit_model(runs, stated, sample=sample)
    answer(campaign=lambda: encoded(campaign.results))
    print_tables(campaign_tables(campaign))
    for line in (*campaign.results.left_out, *campaign.results.warnings):
        say(line)
    if output is not None:
        for path in save_campaign(campaign, output):
            answer(written=[path])
            print(f"{'campaign':<12} {path}")


@in_json
def plan(
    source: Annotated[
        Path,
        input_argument(
            "A run of this rig (.mcap) or its folder, a fitted table's, or a configuration (TOML).",
            record_or_results,
        ),
    ],
    first: Annotated[
        list[float] | None, typer.Option(min=0.1, help="First amplitude, arcsec; may be repeated.")
    ] = None,
    last: Annotated[
        list[float] | None, typer.Option(min=0.1, help="Last amplitude, arcsec; may be repeated.")
    ] = None,
    ground: Annotated[
        float | None,
        typer.Option(min=0.0, help="Drive of another ground, rad/s2/sqrt(Hz); default: from SOURCE."),
    ] = None,
    set_: Set = None,
    runs: Annotated[
        list[int] | None, typer.Option(min=1, help="Number of runs; may be repeated; default: 1.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(min=0.0, help="Configuration: noise of one frame, arcsec, if known."),
    ] = None,
    contact: Annotated[
        Path | None, input_option("Configuration: results.json with the expected contact.")
    ] = None,
    seismometer: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Noise of a seismometer over the ground it sees, at the swing's frequency: 0.1; "
            "default: that of [seismometer].",
        ),
    ] = None,
) -> None:
    """Predict how well further runs would determine the contact.

    Uncertainties against first and last amplitude, number of runs and rig time, from a run of this rig, a
    fitted table or film, or a configuration.

    \b
    Examples:
      rig plan runs/first/run-1.mcap --first 124 --last 2
      rig plan configs/basement.toml --runs 1 --runs 3
      rig plan fits/decay
      rig plan configs/basement.toml --seismometer 0.05
    """
    firsts, lasts = first or [300.0, 124.0, 60.0], last or [30.0, 15.0, 8.0, 4.0, 2.0]
    counts = runs or [1]
    if min(lasts) >= max(firsts):
        raise ConfigurationError(
            f"--last {min(lasts):g}: should be below the first amplitude, {max(firsts):g} arcsec; name a "
            "smaller one, or a larger --first"
        )

    from rig.report import (
        make_plan,
        plan_table,
        planned_contact_of_file,
        planned_contact_of_run,
        planned_contact_of_table,
    )
    from rig.terminal import answer, print_tables, say

    if source.suffix.lower() == ".toml":
        planned_contact = planned_contact_of_file(source, set_ or [], noise, contact)
    elif is_of_table(source):
        if noise is not None or contact is not None or set_:
            raise ConfigurationError(
                f"{source}: a table's results have their own noise, contact and configuration; leave out "
                "--noise, --contact and --set"
            )
        planned_contact = planned_contact_of_table(source)
        say("without the waveform of the swings, which results do not hold: uncertainties are upper limits")
    else:
        from rig.analysis import analyse_record

        if noise is not None or contact is not None:
            raise ConfigurationError(
                f"{source}: a record has its own noise and contact; leave out --noise and --contact"
            )
        planned_contact = planned_contact_of_run(analyse_record(one_record(source), set_ or []))
    result = make_plan(planned_contact, firsts, lasts, ground, counts, seismometer)
    answer(plan=result.rows)
    print_tables([plan_table(result)])
