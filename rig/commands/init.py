"""`rig init`: a first configuration; `rig service`: a desk, or a night, that systemd runs."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.inputs import there
from rig.commands.json_answers import in_json
from rig.commands.outputs import folder_without, output_option


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("init")(in_json(init))
    app.command("service")(in_json(service))


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
    cameras, notes = find_cameras()
    for note in notes:
        say(f"note: {note}")
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


def service(
    what: Annotated[Literal["desk", "night"], typer.Argument(help="desk: rig desk; night: rig run --plan.")],
    file: Annotated[
        Path, typer.Argument(help="The desk's configuration, or the night's plan (TOML).", callback=there)
    ],
    output: Annotated[
        Path | None,
        output_option(
            "Folder for the unit; default: the user's unit folder.", folder_without(), show_default=False
        ),
    ] = None,
    port: Annotated[int, typer.Option(help="Port of the desk.", min=1, max=65535)] = 8642,
) -> None:
    """Write a systemd unit for a desk or a night.

    The unit runs without a terminal, as the user, in the current folder, even if nobody is logged in.

    \b
    Examples:
      rig service desk mine.toml
      rig service night night.toml
    """
    if sys.platform != "linux":
        raise ConfigurationError("rig service: systemd is a part of Linux; take what this system has")
    from rig.presentation import answer, say
    from rig.wizards import units_folder, write_unit

    path = write_unit(what, file, output or units_folder(), port)
    print(path)
    answer(written=[path])
    say("next:")
    say("  loginctl enable-linger: services go on when nobody is logged in")
    # groups, because nobody sits there to whom systemd would grant the devices
    say("  sudo usermod -aG dialout,plugdev,video $USER: the devices, after the next login")
    say("  systemctl --user daemon-reload")
    name = path.name.replace("@", "@tonight")
    say(f"  systemctl --user {'enable --now' if what == 'desk' else 'start'} {name}")


def next_steps(file: Path, *, lever: bool, simulated: bool) -> list[str]:
    """What to do with a new configuration."""
    steps = [f"rig doctor {file}: is everything there"]
    if not simulated:
        steps.append(f"rig camera expose {file}, then rig camera align {file}: the light on the sensor")
        if not lever:
            steps.append(f"rig calibrate lever --config {file}: px to radians, asked step by step")
    return [*steps, f"rig run {file} -o runs/{file.stem}: measure"]
