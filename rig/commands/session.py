"""Commands around a measurement: balancing the rig, looking it over."""

from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[Path, typer.Argument(help="Configuration, a TOML file.", show_default=False)]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Any key of the configuration by its dotted path."),
]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("balance")(balance)
    app.command("doctor")(doctor)


def balance(
    config: Config,
    history: Annotated[
        Path | None, typer.Option(help="File of looks and turns; what was learned is taken from it.")
    ] = None,
    follow: Annotated[
        int, typer.Option(help="Simulated rig: follow the advice by itself, at most so many turns.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="Simulated rig: of its weights.")] = 1,
    view: Annotated[bool, typer.Option("--view", help="Open the balancing view in a window.")] = False,
    rrd: Annotated[Path | None, typer.Option(help="Draw all looks into a Rerun file.")] = None,
    set_: Set = None,
) -> None:
    """Balance the pendulum: what is wrong, which weight to turn, which way and how far."""
    from rig.balance import balance_rig
    from rig.settings import load_configuration

    overrides = [*(set_ or []), *(['view.mode="spawn"'] if view else [])]
    raise typer.Exit(balance_rig(load_configuration(config, overrides), history, follow, seed, rrd))


def doctor(
    config: Config,
    json_lines: Annotated[bool, typer.Option("--json", help="One JSON object a line on stdout.")] = False,
    set_: Set = None,
) -> None:
    """Look the whole rig over: every device, disk, clock and processor, with a remedy for each no."""
    from rig.devices import examine
    from rig.settings import load_configuration

    raise typer.Exit(examine(load_configuration(config, set_ or []), json_lines=json_lines))
