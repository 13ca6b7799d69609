"""`rig archive`: a catalogue of the runs of many sessions."""

import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import JsonLines, Set, Where
from rig.commands.inputs import there
from rig.commands.outputs import new_file, new_folder, output_option

Archive = Annotated[
    str,
    typer.Option(
        "--archive", envvar="RIG_ARCHIVE", help="The archive: a folder, or s3://...; or RIG_ARCHIVE."
    ),
]
PLACE = "archive"
Names = Annotated[
    list[str] | None,
    typer.Argument(help="First characters of a run's or a session's hash.", show_default=False),
]

Refits = Annotated[
    bool, typer.Option("--refits", help="Use all versions of results made by rig archive refit.")
]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    archive = typer.Typer(help="A catalogue of the runs of many sessions.", no_args_is_help=True)
    archive.command("add")(add)
    archive.command("list")(list_)
    for command in (check, plot, show, tag, note, refit, diff, compare, blind, unblind, view, publish):
        archive.command()(command)
    app.add_typer(archive, name="archive")


def add(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="Folders with sessions in or below them, or .eln files.", show_default=False, callback=there
        ),
    ],
    read: Annotated[
        bool, typer.Option("--read", help="Also read files that look unchanged, to find damage.")
    ] = False,
    archive: Archive = PLACE,
) -> None:
    """Add sessions; those already known stay unchanged."""
    from rig.archive import add_sessions, opened

    with opened(archive) as folder:
        print(add_sessions(folder, folders, read=read))


def list_(
    condition: Annotated[str, typer.Argument(help="Condition in SQL: \"sample = 'K8' order by c\".")] = "",
    columns: Annotated[
        str, typer.Option(help="Columns to show, separated by commas; docs/reference/archive.md lists all.")
    ] = "",
    format_: Annotated[Literal["table", "csv", "json", "parquet"], typer.Option("--format")] = "table",
    output: Annotated[Path | None, output_option("File to write.", new_file())] = None,
    refits: Refits = False,
    json: JsonLines = False,
    archive: Archive = PLACE,
) -> None:
    """List the runs that meet a condition."""
    from rig.archive import list_runs, opened

    if json and (format_ != "table" or output is not None):
        raise ConfigurationError("--json writes to stdout; into a file: --format json -o FILE")
    kind = "lines" if json else format_
    with opened(archive) as folder:
        list_runs(folder, condition, [columns] if columns.strip() else [], kind, output, refits=refits)


def check(
    records: Annotated[
        bool,
        typer.Option("--records", help="Also read the records on this computer and compare their hashes."),
    ] = False,
    repair: Annotated[
        bool, typer.Option("--repair", help="Rebuild what follows from other files, or from the other copy.")
    ] = False,
    archive: Archive = PLACE,
) -> None:
    """Verify every file of the archive."""
    from rig.archive import check_archive, is_remote, opened

    if is_remote(archive):
        with opened(archive, believed=False) as folder:
            raise typer.Exit(check_archive(folder, records=records, repair=repair, url=archive))
    raise typer.Exit(check_archive(Path(archive), records=records, repair=repair))


def plot(
    x: Annotated[str, typer.Argument(help="Column: humidity, began_utc, ...", show_default=False)],
    y: Annotated[str, typer.Argument(help="Column: c, period0_s, ...", show_default=False)],
    output: Annotated[
        Path, output_option("SVG or PNG to write.", new_file(".svg", ".png"), show_default=False)
    ],
    by: Annotated[str, typer.Option(help="Column that sets the colours.")] = "",
    where: Where = "",
    refits: Refits = False,
    archive: Archive = PLACE,
) -> None:
    """Draw one column against another, with standard uncertainties."""
    from rig.archive import opened, plot_runs

    with opened(archive) as folder:
        print(plot_runs(folder, x, y, by, where, output, refits=refits))


def show(
    names: Annotated[
        list[str], typer.Argument(help="First characters of a run's or a session's hash.", show_default=False)
    ],
    archive: Archive = PLACE,
) -> None:
    """Show everything known about runs."""
    from rig.archive import opened, show_runs

    with opened(archive) as folder:
        show_runs(folder, names)


def tag(
    text: Annotated[str, typer.Argument(help="The tag.", show_default=False)],
    names: Names = None,
    where: Where = "",
    remove: Annotated[bool, typer.Option("--remove", help="Remove the tag.")] = False,
    archive: Archive = PLACE,
) -> None:
    """Tag runs."""
    from rig.archive import opened, remark

    if names and re.fullmatch(r"[0-9a-f]{8,64}", text):
        raise ConfigurationError(f"{text}: the tag comes first: rig archive tag {names[0]} {text}")
    with opened(archive) as folder:
        said = {"remove" if remove else "add": text}
        print(remark(folder, names or [], where, **said))


def note(
    text: Annotated[str, typer.Argument(help="The note.", show_default=False)],
    names: Names = None,
    where: Where = "",
    archive: Archive = PLACE,
) -> None:
    """Write a note on runs."""
    from rig.archive import opened, remark

    with opened(archive) as folder:
        print(remark(folder, names or [], where, note=text))


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
    archive: Archive = PLACE,
) -> None:
    """Fit many records again; existing refits are kept."""
    from rig.archive import is_remote, opened, refit_runs

    with opened(archive) as folder:
        raise typer.Exit(
            refit_runs(
                folder,
                names or [],
                where,
                level,
                laws=law or [],
                settings=set_ or [],
                sent_to=archive if is_remote(archive) else "",
                cluster=cluster,
                processes=processes,
            )
        )


def diff(
    names: Names = None,
    where: Where = "",
    least_u: Annotated[
        float,
        typer.Option("--least-u", min=0.0, help="List changes larger than this many standard uncertainties."),
    ] = 1.0,
    archive: Archive = PLACE,
) -> None:
    """List what changed between the last two versions of results, and why."""
    from rig.archive import opened, print_differences

    with opened(archive) as folder:
        print_differences(folder, names or [], where, least_u)


def compare(
    column: Annotated[str, typer.Argument(help="Column: c, b, ...", show_default=False)],
    by: Annotated[str, typer.Option(help="Column that identifies the rig or laboratory.")] = "host",
    where: Where = "",
    output: Annotated[Path | None, output_option("SVG or PNG to write.", new_file(".svg", ".png"))] = None,
    refits: Refits = False,
    archive: Archive = PLACE,
) -> None:
    """Compare the values of a parameter from rigs or laboratories."""
    from rig.archive import compare_groups, opened

    with opened(archive) as folder:
        compare_groups(folder, column, by, where, output, refits=refits)


def blind(
    columns: Annotated[
        list[str] | None, typer.Argument(help="Columns; default: the laws' parameters.", show_default=False)
    ] = None,
    of: Annotated[
        list[Path] | None,
        typer.Option("--of", help="Folder: fits of records in or below it are sealed; may be repeated."),
    ] = None,
    archive: Archive = PLACE,
) -> None:
    """Hide values behind offsets until the analysis is frozen."""
    from rig.archive import blind_runs, opened

    with opened(archive) as folder:
        print(blind_runs(folder, columns or [], of or []))


def unblind(
    frozen: Annotated[
        str, typer.Argument(help="The frozen analysis: commit, cuts, law.", show_default=False)
    ],
    archive: Archive = PLACE,
) -> None:
    """Show true values again, and record who asked for it."""
    from rig.archive import opened, unseal

    with opened(archive) as folder:
        print(unseal(folder, frozen))


def view(
    names: Names = None,
    where: Where = "",
    mode: Annotated[
        Literal["spawn", "web"], typer.Option(help="A window, or a page for a browser.")
    ] = "spawn",
    rrd: Annotated[
        Path | None,
        typer.Option(help="Rerun file to write instead of opening a viewer.", callback=new_file(".rrd")),
    ] = None,
    archive: Archive = PLACE,
) -> None:
    """Show runs overlaid in the viewer."""
    from rig.archive import opened, view_runs

    with opened(archive) as folder:
        view_runs(folder, names or [], where, mode, rrd)


def publish(
    output: Annotated[Path, output_option("Folder, or file .eln, to make.", new_folder, show_default=False)],
    title: Annotated[str, typer.Option(help="Title of the publication.", show_default=False)],
    author: Annotated[
        list[str],
        typer.Option(help="Name, followed by an ORCID address; may be repeated.", show_default=False),
    ],
    names: Names = None,
    where: Where = "",
    licence: Annotated[str, typer.Option(help="SPDX identifier of the licence.")] = "CC-BY-4.0",
    citation: Annotated[str, typer.Option(help="What to cite; default: authors and title.")] = "",
    archive: Archive = PLACE,
) -> None:
    """Write runs with results and inputs as an RO-Crate: a folder, or a file .eln for notebooks."""
    from rig.archive import Statement, opened, publish_runs

    with opened(archive) as folder:
        statement = Statement(title, licence, author, citation)
        print(publish_runs(folder, names or [], where, output, statement))
