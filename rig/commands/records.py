"""Commands that look after records."""

from pathlib import Path
from typing import Annotated

import typer

Record = Annotated[Path, typer.Argument(help="A record, an MCAP file.", show_default=False)]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("info")(info)
    app.command("check")(check)
    app.command("recover")(recover)


def info(record: Record) -> None:
    """Print what is in a record: times, counts, who, what, with which settings."""
    from rig.commands.record_screen import print_info

    print_info(record)


def check(
    record: Record,
    results: Annotated[
        Path | None, typer.Option(help="results.json whose hash of the record is compared.")
    ] = None,
) -> None:
    """Verify a record: checksums, sequence, gaps, times, schemas, hash."""
    from rig.commands.record_screen import print_check

    raise typer.Exit(print_check(record, results))


def recover(
    record: Record,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Whole file to make; NAME-recovered.mcap without.")
    ] = None,
) -> None:
    """Make a whole file of one that was cut short; the cut one stays as it is."""
    from rig.commands.record_screen import recover_record

    recover_record(record, output)
