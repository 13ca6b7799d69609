"""`rig init`: a first configuration."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from rig.commands.arguments import in_json


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("init")(in_json(init))


def init(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="Configuration to write (TOML file); default: my-rig.toml, or the example's own name.",
            show_default=False,
        ),
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Ask nothing; write a configuration that comes with the program: demo, basement, live, ...",
            show_default=False,
        ),
    ] = None,
    instruments: Annotated[
        bool, typer.Option("--instruments", help="List the kinds of pendulum, for instrument.kind, and end.")
    ] = False,
) -> None:
    """Write a configuration for your rig.

    Finds the camera and the serial ports, asks five questions (camera, ports, light lever, sample, folder)
    and writes a file in which every other key stands commented out. Nothing is written before the last
    answer. Lines from a file or pipe are accepted as answers.

    \b
    Examples:
      rig init my-rig.toml
      rig init --example basement
    """
    if instruments:
        _list_instruments()
        return
    if example is not None:
        _write_example(example, file)
        return
    file = file or Path("my-rig.toml")
    from acquisition.cameras.drivers import find_cameras
    from rig.commands.first_configuration import ask
    from rig.control import list_serial_ports
    from rig.presentation import answer, say
    from rig.settings import refuse_existing, write_configuration

    refuse_existing(file)
    # the first thing that is said is the first question
    cameras, _ = find_cameras()
    stated = ask(cameras, [(port.device, port.description) for port in list_serial_ports()])
    config = write_configuration(file, stated)
    sys.stderr.flush()
    print(file)
    answer(written=[file])
    lit = config.laser.kind != "none"
    for line in ("next:", *(f"  {step}" for step in _next_steps(file, stated, lit=lit))):
        say(line)


def _list_instruments() -> None:
    from processing.instruments import INSTRUMENTS
    from rig.presentation import answer, print_line

    answer(instruments={each.kind: each.sentence for each in INSTRUMENTS.values()})
    for description in INSTRUMENTS.values():
        print_line(f"{description.kind:<15} {description.sentence}")


def _write_example(name: str, file: Path | None) -> None:
    from rig.presentation import answer, say
    from rig.settings import copy_shipped, refuse_existing

    file = file or Path(f"{name}.toml")
    refuse_existing(file)
    for path in copy_shipped(name, file):
        print(path)
        answer(written=[path])
    say("next:")
    say(f"  rig run {file} -o runs/{file.stem}: measure")


def _next_steps(file: Path, stated: Mapping[str, Any], *, lit: bool) -> list[str]:
    """What to do with a new configuration."""
    simulated = stated["camera.driver"] == "simulated"
    edited = "[pendulum] (mass, radius, materials)" + (" and the limits of [laser]" if lit else "")
    steps = [f"edit {file}: {edited}", f"rig doctor {file}: is everything there"]
    if not simulated:
        steps.append(f"rig camera expose {file}, then rig camera align {file}: the light on the sensor")
        if "lever.arm_m" not in stated:
            steps.append("rig calibrate lever geometry.toml: px to radians (docs/calibrate.md)")
    return [*steps, f"rig run {file} -o runs/{file.stem}: measure"]
