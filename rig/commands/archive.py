"""`rig archive`: the runs of many sessions as rows of one file."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import JsonLines, Set, Where, group, input_argument, new_file, output_option

Archive = Annotated[
    Path,
    typer.Option("--archive", envvar="RIG_ARCHIVE", help="The archive: a DuckDB file; or RIG_ARCHIVE."),
]
DEFAULT_ARCHIVE = Path("archive.duckdb")
Names = Annotated[
    list[str] | None,
    typer.Argument(help="First characters of a run's or a session's hash.", show_default=False),
]
Read = Annotated[bool, typer.Option("--read", help="Also read files that look unchanged, to find damage.")]


def add(
    folders: Annotated[list[Path], input_argument("Folders with sessions in or below them.")],
    read: Read = False,
    archive: Archive = DEFAULT_ARCHIVE,
) -> None:
    """Remember folders and read the sessions in them that are new or have changed."""
    from rig.archive import add_folders

    print(add_folders(archive, folders, read=read))


def update(read: Read = False, archive: Archive = DEFAULT_ARCHIVE) -> None:
    """Read the sessions that are new or have changed in all folders that were added."""
    from rig.archive import update_archive

    print(update_archive(archive, read=read))


def list_(
    condition: Annotated[str, typer.Argument(help="Condition in SQL: \"sample = 'K8' order by c\".")] = "",
    columns: Annotated[
        str, typer.Option(help="Columns to show, separated by commas; docs/reference/archive.md lists all.")
    ] = "",
    output: Annotated[Path | None, output_option("CSV file to write.", new_file(".csv"))] = None,
    json: JsonLines = False,
    archive: Archive = DEFAULT_ARCHIVE,
) -> None:
    """List the runs that meet a condition."""
    from rig.archive import list_runs

    if json and output is not None:
        raise ConfigurationError("--json writes to stdout, and -o a CSV file; leave out one")
    list_runs(archive, condition, columns, output, json_lines=json)


def show(
    names: Annotated[
        list[str], typer.Argument(help="First characters of a run's or a session's hash.", show_default=False)
    ],
    archive: Archive = DEFAULT_ARCHIVE,
) -> None:
    """Show everything known about runs."""
    from rig.archive import show_runs

    show_runs(archive, names)


def check(archive: Archive = DEFAULT_ARCHIVE) -> None:
    """Read all records and results again and compare their hashes."""
    from rig.archive import check_archive

    raise typer.Exit(check_archive(archive))


def refit(
    names: Names = None,
    where: Where = "",
    level: Annotated[
        Literal["swings", "spots", "pixels"],
        typer.Option(help="From the recorded half-cycles, the recorded spots, or the recorded pixels."),
    ] = "swings",
    law: Annotated[
        list[str] | None,
        typer.Option(help="Compare the paper's law with another one, or all; may be repeated."),
    ] = None,
    set_: Set = None,
    cluster: Annotated[str, typer.Option(help="Dask cluster to use: tcp://HOST:PORT.")] = "",
    processes: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine; default: one per processor.")
    ] = None,
    archive: Archive = DEFAULT_ARCHIVE,
) -> None:
    """Fit many sessions again; each gets a new results file, and keeps the earlier ones."""
    from rig.archive import refit_runs

    raise typer.Exit(
        refit_runs(
            archive,
            names or [],
            where,
            level,
            laws=law or [],
            settings=set_ or [],
            cluster=cluster,
            processes=processes,
        )
    )


commands = group("archive", "The runs of many sessions in one list.", list_, add, update, show, check, refit)
