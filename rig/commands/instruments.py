"""`rig instruments`: the kinds of pendulum."""

import typer


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("instruments")(instruments)


def instruments() -> None:
    """List the kinds of pendulum, for instrument.kind."""
    from processing.instruments import INSTRUMENTS

    for description in INSTRUMENTS.values():
        typer.echo(f"{description.kind:<15} {description.sentence}")
