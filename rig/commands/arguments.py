"""Arguments and options that several commands share."""

import re
from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError

Config = Annotated[Path, typer.Argument(help="Configuration (TOML file).", show_default=False)]
Record = Annotated[Path, typer.Argument(help="Record (MCAP file), or a folder with one.", show_default=False)]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change one key of the configuration for this call, by its dotted path; may be repeated.",
    ),
]
View = Annotated[
    Literal["window", "web"] | None,
    typer.Option(
        "--view",
        help="Show it live: in a window (also --view alone), or as a web page on this machine.",
        show_default=False,
    ),
]
MODES: dict[str | None, Literal["none", "spawn", "web"]] = {None: "none", "window": "spawn", "web": "web"}
"""Values of view.mode."""
JsonLines = Annotated[bool, typer.Option("--json", help="Write one JSON object per line to stdout.")]


def records_in(path: Path) -> list[Path]:
    """The record itself, or those of a session's folder in their order; a repaired copy for its original.

    Raises ConfigurationError for a folder without records.
    """
    if not path.is_dir():
        return [path]
    runs = sorted(
        (int(found[1]), file)
        for file in path.glob("run-*.mcap")
        if (found := re.fullmatch(r"run-(\d+)", file.stem))
    )
    repaired = [file.with_name(f"{file.stem}-recovered{file.suffix}") for _, file in runs]
    records = [copy if copy.exists() else file for (_, file), copy in zip(runs, repaired, strict=True)]
    records = records or sorted(path.glob("*.mcap"))
    if records:
        return records
    raise ConfigurationError(f"{path}: holds no record (run-1.mcap, ...); name one, or a session's folder")


def one_record(path: Path) -> Path:
    """The record itself, or the only one of a folder; raises ConfigurationError for none or several."""
    records = records_in(path)
    if len(records) > 1:
        names = ", ".join(record.name for record in records)
        raise ConfigurationError(f"{path}: holds {len(records)} records; name one of them: {names}")
    return records[0]
