"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[Path, typer.Argument(help="Configuration (TOML file).", show_default=False)]
Record = Annotated[Path, typer.Argument(help="Record (MCAP file).", show_default=False)]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one key of the configuration for this call, by its dotted path; may be repeated.",
    ),
]
JsonLines = Annotated[bool, typer.Option("--json", help="Write one JSON object per line to stdout.")]
