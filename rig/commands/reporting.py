"""Commands that put results on paper."""

from pathlib import Path
from typing import Annotated, Literal

import typer


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("report")(report)
    app.command("paper")(paper)
    app.command("export")(export)
    app.command("compare")(compare)


def report(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a session, with results.json.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="HTML file to make; report.html in the folder without."),
    ] = None,
) -> None:
    """Write the report of a session: one HTML file, figures as SVG and PNG, tables as CSV."""
    from rig.report import make_report

    print(make_report(folder, output))


def paper(
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for paper.html with figures and tables.")
    ] = None,
    b_exponent: Annotated[
        int, typer.Option(help="Power of ten of b, which the paper's Table 2 leaves out.", min=-6, max=-3)
    ] = -4,
) -> None:
    """Simulate the paper's three contact pairs and print its Tables 1 to 4 beside the printed numbers."""
    from rig.paper import reproduce_paper

    reproduce_paper(output, b_exponent)


def export(
    source: Annotated[
        Path, typer.Argument(help="Folder of a session, or one record (.mcap).", show_default=False)
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder to make; for hdf5 the file.", show_default=False)
    ],
    format_: Annotated[
        Literal["csv", "parquet", "hdf5"], typer.Option("--format", help="hdf5 is laid out as NeXus.")
    ] = "csv",
) -> None:
    """Write spots, half-cycles and results for other programs, with the provenance inside."""
    from rig.export import export_session

    for path in export_session(source, format_, output):
        print(path)


def compare(
    folders: Annotated[list[Path], typer.Argument(help="Folders of sessions.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="HTML file to make, with the plot.")
    ] = None,
) -> None:
    """Compare series (samples, days, humidities): parameters beside each other, and their differences."""
    from rig.presentation import print_tables
    from rig.report import compare as compare_sessions

    print_tables(compare_sessions(folders, output))
