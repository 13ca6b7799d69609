"""`rig report`, `rig paper`, `rig export` and `rig compare`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import (
    Where,
    folder_without,
    in_json,
    new_file,
    new_page,
    output_option,
    page_or_campaign,
    there,
    with_results,
)


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for command in (report, paper, export, compare):
        app.command()(in_json(command))


def report(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder of a session, or a results file.", show_default=False, callback=with_results
        ),
    ],
    output: Annotated[
        Path | None,
        output_option("HTML file to write; default: report.html in the folder, overwritten.", new_page),
    ] = None,
) -> None:
    """Write a report: HTML page, figures, tables.

    Figures as SVG and PNG, tables as CSV.

    \b
    Example:
      rig report runs/first
    """
    from rig.report import make_report
    from rig.terminal import answer

    page = make_report(folder, output)
    answer(written=[page])
    print(page)


def paper(
    output: Annotated[
        Path | None,
        output_option(
            "Folder for paper.html with figures and tables.", folder_without("paper.html", "paper")
        ),
    ] = None,
) -> None:
    """Simulate the paper's runs and compare with its tables."""
    from rig.report import reproduce_paper

    reproduce_paper(output)


def export(
    source: Annotated[
        Path,
        typer.Argument(
            help="Folder of a session, or one record (.mcap).",
            show_default=False,
            callback=with_results,
        ),
    ],
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
    from rig.terminal import answer

    (new_file(makes_folders=True) if format_ == "hdf5" else folder_without())(output)
    for path in export_session(source, format_, output):
        print(path)
        answer(written=[path])


def compare(
    folders: Annotated[
        list[Path] | None,
        typer.Argument(help="Folders of sessions.", show_default=False, callback=with_results),
    ] = None,
    output: Annotated[
        Path | None,
        output_option("HTML file to write, with a figure; with --model: folder.", page_or_campaign),
    ] = None,
    against: Annotated[
        str, typer.Option(help="Also over temperature, humidity, pressure, dwell or age of every run.")
    ] = "",
    model: Annotated[
        str,
        typer.Option(
            metavar="FILE|default",
            help="One model over all runs: its parameters, effects, priors (campaign.toml); each folder is a "
            "contact, in the order of measurement.",
        ),
    ] = "",
    archive: Annotated[
        Path | None,
        typer.Option(help="With --model: take the runs of an archive; each sample is a contact."),
    ] = None,
    where: Where = "",
    by_sample: Annotated[
        bool,
        typer.Option(
            "--by-sample", help="With --model: folders with the same session.sample are one contact."
        ),
    ] = False,
    sample: Annotated[
        bool,
        typer.Option("--sample", help="With --model: sample the full posterior (emcee), with its R-hat."),
    ] = False,
) -> None:
    """Compare the parameters of series, or model many runs.

    In a model what runs share (air, lever, masses) counts once; contacts depend on humidity, temperature, age
    as stated; bad runs are named.

    \b
    Examples:
      rig compare runs/glass runs/silicon -o comparison.html
      rig compare runs/glass runs/silicon --against humidity -o humidity.html
      rig compare runs/monday runs/tuesday --model campaign.toml -o campaigns/glass
      rig compare --model default --archive archive.duckdb --where "sample = 'K8'" -o campaigns/k8
    """
    if model:
        if against:
            raise ConfigurationError(
                f"--against {against}: has no effect with --model, whose file states effects"
            )
        model_runs(model, folders or [], output, archive, where, by_sample=by_sample, sample=sample)
        return
    of_models = {"--archive": archive, "--where": where, "--by-sample": by_sample, "--sample": sample}
    if stated := next((name for name, value in of_models.items() if value), ""):
        raise ConfigurationError(f"{stated}: has no effect without --model")
    if output is not None and output.suffix.lower() not in (".html", ".htm"):
        raise ConfigurationError(f"{output}: name a file that ends in .html or .htm")
    if not folders:
        raise typer.BadParameter("Missing argument 'FOLDERS'.")
    if len(folders) < 2 and not against:
        raise ConfigurationError(f"{folders[0]}: a comparison needs two sessions or more; name another")

    from rig.report import compare as compare_sessions
    from rig.terminal import answer, print_tables

    print_tables(compare_sessions(folders, output, against))
    if output is not None:
        answer(written=[output])
        print(f"page         {output}, figure and tables in {output.with_suffix('')}")


DEFAULT = "default"
"""Word in place of a file for the default model."""


def model_runs(
    model: str,
    folders: Sequence[Path],
    output: Path | None,
    archive: Path | None,
    where: str,
    *,
    by_sample: bool,
    sample: bool,
) -> None:
    """Fit the model to the runs, print its tables and save the results in `output`."""
    if archive is None and not folders:
        raise ConfigurationError("rig compare --model needs runs: name folders of sessions, or --archive")
    if archive is not None and folders:
        raise ConfigurationError(f"{folders[0]}: folders and --archive exclude each other; leave one out")
    if where and archive is None:
        raise ConfigurationError(f"--where {where!r}: has no effect without --archive")
    if by_sample and archive is not None:
        raise ConfigurationError("--by-sample: has no effect with --archive, where each sample is a contact")
    from rig.analysis import encoded
    from rig.report import (
        StatedCampaign,
        campaign_tables,
        fit_model,
        read_campaign,
        runs_of_archive,
        runs_of_folders,
        save_campaign,
    )
    from rig.terminal import answer, print_tables, say

    stated = StatedCampaign() if model == DEFAULT else read_campaign(there(Path(model)))
    if archive is None:
        runs = runs_of_folders(folders, by_sample=by_sample)
    else:
        from rig.archive import ordered_runs

        runs = runs_of_archive(ordered_runs(archive, where))
    found = fit_model(runs, stated, sample=sample)
    answer(campaign=encoded(found.results))
    print_tables(campaign_tables(found))
    for line in (*found.results.left_out, *found.results.warnings):
        say(line)
    if output is not None:
        for path in save_campaign(found, output):
            answer(written=[path])
            print(f"{'campaign':<12} {path}")
