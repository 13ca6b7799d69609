"""`rig desk`, `rig balance`, `rig preflight`, `rig doctor`: preparing a measurement, the page for all."""

from pathlib import Path
from typing import Annotated

import typer

from processing.errors import MissingPackage
from rig.commands.arguments import MODES, Config, JsonLines, Set, View
from rig.commands.outputs import appended_file, new_file


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for command in (desk, balance, preflight, doctor):
        app.command()(command)


def balance(
    config: Config,
    history: Annotated[
        bool, typer.Option("--history", help="Show what was learned from earlier turns, and end.")
    ] = False,
    forget_last: Annotated[
        bool, typer.Option("--forget-last", help="Take the last turn out of the history, show it, and end.")
    ] = False,
    history_file: Annotated[
        Path | None,
        typer.Option(
            help="File in which looks and turns are kept; earlier ones in it are used.",
            callback=appended_file,
        ),
    ] = None,
    follow: Annotated[
        int,
        typer.Option(
            help="Simulated rig: follow the advice automatically, for at most this many turns.", min=0
        ),
    ] = 0,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Simulated rig, where what is stated as turned is turned: random seed of its imbalance (1)."
        ),
    ] = None,
    json_lines: JsonLines = False,
    view: View = None,
    rrd: Annotated[
        Path | None, typer.Option(help="Write all looks into a Rerun file.", callback=new_file(".rrd"))
    ] = None,
    set_: Set = None,
) -> None:
    """Balance: which weight to turn, which way and how far.

    \b
    Examples:
      rig balance mine.toml --view
      rig balance configs/demo.toml --follow 6
    """
    from rig.balance import InJsonLines, balance_rig, show_history
    from rig.settings import load_configuration

    overrides = [*(set_ or []), *([f'view.mode="{MODES[view]}"'] if view else [])]
    loaded = load_configuration(config, overrides)
    if history or forget_last:
        raise typer.Exit(show_history(loaded, history_file, forget=forget_last))
    raise typer.Exit(
        balance_rig(loaded, history_file, follow, seed, rrd, reporter=InJsonLines() if json_lines else None)
    )


def desk(
    config: Config,
    port: Annotated[
        int, typer.Option(help="Port of 127.0.0.1; 0: 8642, or any that is free.", min=0, max=65535)
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    set_: Set = None,
) -> None:
    """Open a page in the browser to run the rig from.

    \b
    Example:
      rig desk mine.toml
    """
    try:
        from rig.desk import open_desk
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("nicegui", "fastapi", "starlette", "uvicorn"):
            raise
        raise MissingPackage("rig desk", "nicegui") from None
    raise typer.Exit(open_desk(config, tuple(set_ or ()), port=port, browser=browser))


def preflight(
    config: Config,
    json_lines: JsonLines = False,
    set_: Set = None,
) -> None:
    """Make the checks that precede a run, without a run.

    Lights the laser; moves nothing and records nothing.

    \b
    Example:
      rig preflight mine.toml
    """
    from rig.measure import preflight_rig
    from rig.settings import load_configuration

    raise typer.Exit(preflight_rig(load_configuration(config, set_ or []), json_lines=json_lines))


def doctor(
    config: Config,
    json_lines: JsonLines = False,
    set_: Set = None,
) -> None:
    """Check devices, disk, clock and processor; suggest remedies.

    \b
    Example:
      rig doctor mine.toml
    """
    from rig.devices import examine
    from rig.settings import load_configuration

    raise typer.Exit(examine(load_configuration(config, set_ or []), json_lines=json_lines))
