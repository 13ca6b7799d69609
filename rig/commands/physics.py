"""Commands from swings to physics."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("fit")(fit)


def fit(
    files: Annotated[
        list[Path], typer.Argument(help="Records (.mcap), or one trajectory as CSV.", show_default=False)
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for results.json; must not hold one yet.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="Configuration with [pendulum] and [fit], for a CSV.")
    ] = None,
    time: Annotated[str | None, typer.Option(help="CSV: column of the time in s, name or number.")] = None,
    position: Annotated[
        list[str] | None,
        typer.Option(help="CSV: column of the position, name or number; twice for two axes."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(help="CSV: unit of the position: rad, mrad, urad, arcsec, arcmin, deg, or any word."),
    ] = "",
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Any key of the configuration.")
    ] = None,
) -> None:
    """Fit the contact laws to records, or to a trajectory from another instrument."""
    if len(files) == 1 and files[0].suffix.lower() != ".mcap":
        from rig.analysis import fit_trajectory

        raise typer.Exit(
            fit_trajectory(files[0], output, config, time, position or [], unit, overrides=set_ or [])
        )
    from rig.analysis import fit_records

    raise typer.Exit(fit_records(files, output, overrides=set_ or []))
