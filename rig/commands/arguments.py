"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from rig.commands.inputs import configuration, recorded
from rig.commands.outputs import folder_without, new_file, output_option

Config = Annotated[
    Path, typer.Argument(help="Configuration (TOML file).", show_default=False, callback=configuration)
]
Record = Annotated[
    Path,
    typer.Argument(help="Record (MCAP file), or a folder with one.", show_default=False, callback=recorded),
]
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
ResultsFolder = Annotated[
    Path | None,
    output_option("Folder for results.json; must not hold one yet.", folder_without("results.json")),
]
NewRecord = Annotated[
    Path,
    output_option("Record to write (MCAP file).", new_file(".mcap", makes_folders=True), show_default=False),
]
JsonLines = Annotated[bool, typer.Option("--json", help="Write one JSON object per line to stdout.")]
Where = Annotated[str, typer.Option(help="Only runs that meet a condition, as in rig archive list.")]
