"""`rig light`: whether the laser may be lit, and the acknowledgement after it was darkened."""

from pathlib import Path
from typing import Annotated

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import Config, Set, in_json, there


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    light = typer.Typer(help="Show and acknowledge why the laser went dark.", no_args_is_help=True)
    for command in (show, acknowledge, audit):
        light.command()(in_json(command))
    app.add_typer(light, name="light")


def show(config: Config, set_: Set = None) -> None:
    """Print laser, interlock and any unacknowledged trip; lights nothing.

    \b
    Example:
      rig light show mine.toml
    """
    from rig.measure import show_light
    from rig.settings import load_configuration

    raise typer.Exit(show_light(load_configuration(config, set_ or [])))


def whole_number(text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise ConfigurationError(f"trip {text!r}: should be its number; rig light show CONFIG names it")
    return int(text)


def acknowledge(
    config: Config,
    number: Annotated[
        int, typer.Argument(help="Number of the trip.", parser=whole_number, show_default=False)
    ],
    set_: Set = None,
) -> None:
    """Confirm that nobody is in the beam path, after a trip; lights nothing.

    \b
    Example:
      rig light acknowledge mine.toml 5
    """
    from rig.measure import acknowledge_trip
    from rig.settings import load_configuration

    raise typer.Exit(acknowledge_trip(load_configuration(config, set_ or []), number))


def audit(
    folder: Annotated[
        Path, typer.Argument(help="Folder with audit.jsonl.", show_default=False, callback=there)
    ],
    config: Annotated[
        Path | None,
        typer.Option(help="Configuration of the rig, to verify the end of the log.", callback=there),
    ] = None,
) -> None:
    """Check that no line of an audit log is missing or altered.

    \b
    Example:
      rig light audit runs/glass
    """
    from rig.measure import check_audit
    from rig.settings import load_configuration

    raise typer.Exit(check_audit(folder, None if config is None else load_configuration(config, [])))
