"""`rig fit`."""

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.arguments import Set


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("fit")(fit)


def fit(
    files: Annotated[
        list[Path],
        typer.Argument(help="Records (.mcap), or one table of positions (CSV).", show_default=False),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for results.json; must not hold one yet.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="CSV: configuration with [pendulum] and [fit].")] = None,
    time: Annotated[
        str | None, typer.Option(help="CSV: name or number of the column with the time in s.")
    ] = None,
    position: Annotated[
        list[str] | None,
        typer.Option(help="CSV: name or number of the column with the position; twice for two axes."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(help="CSV: unit of the position: rad, mrad, urad, arcsec, arcmin, deg, or any word."),
    ] = "",
    set_: Set = None,
) -> None:
    """Fit the contact laws to records, or to a CSV table."""
    if len(files) == 1 and files[0].suffix.lower() != ".mcap":
        from rig.analysis import fit_trajectory

        raise typer.Exit(
            fit_trajectory(files[0], output, config, time, position or [], unit, overrides=set_ or [])
        )
    from rig.analysis import fit_records

    raise typer.Exit(fit_records(files, output, overrides=set_ or []))
