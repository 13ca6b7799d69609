"""`rig balance` and `rig doctor`: preparing a measurement."""

from pathlib import Path
from typing import Annotated

import typer

from rig.commands.arguments import MODES, Config, JsonLines, Set, View


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("balance")(balance)
    app.command("doctor")(doctor)


def balance(
    config: Config,
    history: Annotated[
        bool, typer.Option("--history", help="Show what was learned from earlier turns, and end.")
    ] = False,
    forget_last: Annotated[
        bool, typer.Option("--forget-last", help="Take the last turn out of the history, show it, and end.")
    ] = False,
    history_file: Annotated[
        Path | None, typer.Option(help="File in which looks and turns are kept; earlier ones in it are used.")
    ] = None,
    follow: Annotated[
        int,
        typer.Option(
            help="Simulated rig: follow the advice automatically, for at most this many turns.", min=0
        ),
    ] = 0,
    seed: Annotated[int, typer.Option(help="Simulated rig: random seed of its imbalance.")] = 1,
    view: View = None,
    rrd: Annotated[Path | None, typer.Option(help="Write all looks into a Rerun file.")] = None,
    set_: Set = None,
) -> None:
    """Balance: which weight to turn, which way and how far.

    \b
    Examples:
      rig balance mine.toml --view
      rig balance configs/demo.toml --follow 6
    """
    from rig.balance import balance_rig, show_history
    from rig.settings import load_configuration

    overrides = [*(set_ or []), *([f'view.mode="{MODES[view]}"'] if view else [])]
    loaded = load_configuration(config, overrides)
    if history or forget_last:
        raise typer.Exit(show_history(loaded, history_file, forget=forget_last))
    raise typer.Exit(balance_rig(loaded, history_file, follow, seed, rrd))


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
