"""`rig record info`, `check` and `recover`."""

from pathlib import Path
from typing import Annotated

import typer

from acquisition.record import records_in
from rig.commands.arguments import Record, in_json, new_file, one_record, output_option, there


def register(app: typer.Typer) -> None:
    """Add `rig record`."""
    record = typer.Typer(help="Describe, verify and recover records.", no_args_is_help=True)
    for command in (info, check, recover):
        record.command()(in_json(command))
    app.add_typer(record, name="record")


def info(record: Record) -> None:
    """Print what a record contains, and how it was made.

    \b
    Example:
      rig record info runs/first
    """
    from rig.commands.record_screen import print_info

    for each in records_in(record):
        print_info(each)


def check(
    record: Record,
    results: Annotated[
        Path | None,
        typer.Option(
            help="results.json that names the record's hash; default: the one beside the record.",
            callback=there,
        ),
    ] = None,
) -> None:
    """Verify a record: checksums, gaps, times, hash.

    \b
    Example:
      rig record check runs/first
    """
    from rig.commands.record_screen import print_check

    raise typer.Exit(max([print_check(each, results) for each in records_in(record)]))


def recover(
    record: Record,
    output: Annotated[
        Path | None, output_option("File to write; default: NAME-recovered.mcap.", new_file(".mcap"))
    ] = None,
) -> None:
    """Save what is readable of a record that was cut short.

    \b
    Example:
      rig record recover runs/first/run-1.mcap
    """
    from rig.commands.record_screen import recover_record

    recover_record(one_record(record), output)
