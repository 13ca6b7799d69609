"""`rig init`: a first configuration."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from rig.commands.json_answers import in_json


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
) -> None:
    """Write a configuration for your rig.

    Finds the camera and the serial ports and asks for what must be known; a film or table recorded earlier
    can take the camera's place. Nothing is written before the last answer. Lines from a file or pipe are
    accepted as answers.

    \b
    Examples:
      rig init my-rig.toml
      rig init --example basement
    """
    if example is not None:
        _write_example(example, file)
        return
    file = file or Path("my-rig.toml")
    from acquisition.cameras.drivers import find_cameras
    from rig.control import list_serial_ports
    from rig.presentation import answer, say
    from rig.wizards import (
        FirstConfiguration,
        ask_in_terminal,
        progress,
        refuse_existing,
        stated_keys,
        steps_of_file,
        write_configuration,
    )

    refuse_existing(file)
    # the first thing that is said is the first question
    cameras, _ = find_cameras()
    ports = [(port.device, port.description) for port in list_serial_ports()]
    wizard = FirstConfiguration(cameras, ports)
    answers = ask_in_terminal(wizard)
    config = write_configuration(file, stated_keys(progress(wizard, answers).values))
    sys.stderr.flush()
    print(file)
    answer(written=[file])
    steps = steps_of_file(file, config, answers)
    steps = steps or next_steps(file, lever=config.lever is not None, simulated=config.simulated)
    for line in ("next:", *(f"  {step}" for step in steps)):
        say(line)


def _write_example(name: str, file: Path | None) -> None:
    from rig.presentation import answer, say
    from rig.wizards import copy_shipped, refuse_existing

    file = file or Path(f"{name}.toml")
    refuse_existing(file)
    for path in copy_shipped(name, file):
        print(path)
        answer(written=[path])
    say("next:")
    say(f"  rig run {file} -o runs/{file.stem}: measure")


def next_steps(file: Path, *, lever: bool, simulated: bool) -> list[str]:
    """What to do with a new configuration."""
    steps = [f"rig doctor {file}: is everything there"]
    if not simulated:
        steps.append(f"rig camera expose {file}, then rig camera align {file}: the light on the sensor")
        if not lever:
            steps.append(f"rig calibrate lever --config {file}: px to radians, asked step by step")
    return [*steps, f"rig run {file} -o runs/{file.stem}: measure"]
