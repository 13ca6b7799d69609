"""Arguments and options that several commands share."""

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

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


_AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, everything else on stderr.")
]


def in_json(command: Callable[..., None]) -> Callable[..., None]:
    """The command with ``--json``, which prints what it hands to `rig.presentation.answer`."""

    @functools.wraps(command)
    def with_option(*words: Any, as_json: bool = False, **named: Any) -> None:
        if not as_json:
            command(*words, **named)
            return
        from rig.presentation import one_json_object

        status = 0
        with one_json_object():
            try:
                command(*words, **named)
            except typer.Exit as end:
                status = end.exit_code
        raise typer.Exit(status)

    stated = inspect.signature(command)
    option = inspect.Parameter("as_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_AsJson)
    vars(with_option)["__signature__"] = stated.replace(parameters=[*stated.parameters.values(), option])
    return with_option
