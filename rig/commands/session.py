"""Commands around a measurement: `rig desk`, `rig balance`, `rig doctor` and `rig light`."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from processing.errors import ConfigurationError, optional_module
from rig.commands.archive import DEFAULT_ARCHIVE, Archive
from rig.commands.arguments import (
    MODES,
    Config,
    JsonLines,
    Set,
    View,
    appended_file,
    configuration_of,
    group,
    in_json,
    input_argument,
    new_file,
    output_option,
    present_folder,
)


def balance(
    config: Config,
    history: Annotated[
        bool, typer.Option("--history", help="Show what was learned from earlier turns, then exit.")
    ] = False,
    forget_last: Annotated[
        bool, typer.Option("--forget-last", help="Remove the last turn from the history, show it, then exit.")
    ] = False,
    history_file: Annotated[
        Path | None,
        output_option(
            "File of measurements and turns; earlier ones in it are used.", appended_file, names=()
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
            help="Simulated rig, which makes the turns you state: random seed of its imbalance (1)."
        ),
    ] = None,
    json_lines: JsonLines = False,
    view: View = None,
    rrd: Annotated[
        Path | None, output_option("Write all measurements to a Rerun file.", new_file(".rrd"), names=())
    ] = None,
    set_: Set = None,
) -> None:
    """Balance: which weight to turn, which way and how far.

    \b
    Examples:
      rig balance mine.toml --view
      rig balance configs/demo.toml --follow 6
    """
    from rig.prepare import JsonReporter, Reporter, balance_rig, show_history
    from rig.terminal import one_json_object

    overrides = [*(set_ or []), *([f'view.mode="{MODES[view]}"'] if view else [])]
    configuration = configuration_of(config, overrides)
    if history or forget_last:
        with one_json_object() if json_lines else nullcontext():
            show_history(configuration, history_file, forget=forget_last)
        return
    reporter = JsonReporter() if json_lines else Reporter()
    raise typer.Exit(balance_rig(configuration, history_file, follow, seed, rrd, reporter))


def desk(
    config: Config,
    port: Annotated[
        int, typer.Option(help="Port; 0: the last one, 8642, or any that is free.", min=0, max=65535)
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    archive: Archive = DEFAULT_ARCHIVE,
    set_: Set = None,
) -> None:
    """Open a page in the browser to run the rig from.

    \b
    Example:
      rig desk mine.toml
    """
    optional_module("nicegui", "rig desk", "nicegui", "desk")
    from rig.desk import open_desk

    raise typer.Exit(open_desk(config, tuple(set_ or ()), port, browser=browser, archive=Path(archive)))


def doctor(
    config: Annotated[Path | None, input_argument("Configuration (TOML file).")] = None,
    preflight: Annotated[
        bool,
        typer.Option(
            "--preflight",
            help="Light the laser and make the checks that precede a run, without a run; moves nothing.",
        ),
    ] = False,
    install_udev: Annotated[
        bool,
        typer.Option("--install-udev", help="Linux: write the udev rules that let users open the devices."),
    ] = False,
    udev_folder: Annotated[
        Path | None,
        output_option("Folder for those rules, instead of /etc/udev/rules.d.", present_folder, names=()),
    ] = None,
    json_lines: JsonLines = False,
    set_: Set = None,
) -> None:
    """Check devices, disk, clock and processor; suggest remedies.

    Without a configuration it lists the connected cameras and serial ports.

    \b
    Examples:
      rig doctor
      rig doctor mine.toml
      rig doctor mine.toml --preflight
      sudo .venv/bin/rig doctor --install-udev
    """
    from rig.devices import RULES_FOLDER, examine, install_rules
    from rig.terminal import print_json_line, say

    if install_udev or udev_folder is not None:
        path, next_step = install_rules(udev_folder or RULES_FOLDER)
        if json_lines:
            print_json_line("udev", {"written": str(path), "next": next_step})
        else:
            print(path)
            say(f"next: {next_step}")
        if config is None:
            return
    if config is None:
        if preflight or set_:
            raise ConfigurationError("rig doctor: --preflight and --set need the configuration to check")
        _list_devices(json_lines=json_lines)
        return
    configuration = configuration_of(config, set_)
    if preflight:
        from rig.measure import preflight_rig

        raise typer.Exit(preflight_rig(configuration, json_lines=json_lines))
    raise typer.Exit(examine(configuration, json_lines=json_lines))


def _list_devices(*, json_lines: bool) -> None:
    from dataclasses import asdict

    from acquisition.cameras.drivers import find_cameras
    from rig.control import list_serial_ports
    from rig.terminal import print_json_line, print_line

    cameras, notes = find_cameras()
    ports = list_serial_ports()
    if json_lines:
        camera_values = [camera._asdict() for camera in cameras]
        values = {"cameras": camera_values, "serial_ports": list(map(asdict, ports)), "notes": list(notes)}
        print_json_line("devices", values)
        return
    for camera in cameras:
        details = [camera.driver, camera.name, camera.serial and f"serial {camera.serial}", camera.connection]
        print_line("camera  " + "  ".join(detail for detail in details if detail))
        for mode in camera.modes:
            print_line(f"          {mode}")
        if camera.problem:
            print_line(f"          {camera.problem}")
    if not cameras:
        print_line("no camera is plugged in; camera.driver = 'simulated' and 'files' need none")
    for port in ports:
        usb = f"USB {port.vendor:04x}:{port.product:04x}" if port.vendor >= 0 else ""
        details = [port.device, port.description, usb, port.serial and f"serial {port.serial}"]
        print_line("serial  " + "  ".join(detail for detail in details if detail))
    for note in notes:
        print_line(f"note    {note}")


@in_json
def show(config: Config, set_: Set = None) -> None:
    """Print laser, interlock and any unacknowledged trip; lights nothing.

    \b
    Example:
      rig light show mine.toml
    """
    from rig.measure import show_light

    raise typer.Exit(show_light(configuration_of(config, set_)))


@in_json
def off(config: Config, set_: Set = None) -> None:
    """LIGHT OFF, whichever program has lit the laser; dark until a person acknowledges it.

    \b
    Example:
      rig light off mine.toml
    """
    from rig.control import darken_directly

    configuration = configuration_of(config, set_)
    # before the next imports, which take longer than everything up to here
    darken_directly(configuration.laser, configuration.controller)
    from rig.measure import light_off

    raise typer.Exit(light_off(configuration))


def _trip_number(text: str) -> int:
    """The number of a trip as it was typed."""
    if not (text.isascii() and text.isdecimal()):
        raise ConfigurationError(f"trip {text!r}: should be its number; rig light show CONFIG names it")
    return int(text)


@in_json
def acknowledge(
    config: Config,
    number: Annotated[
        int, typer.Argument(help="Number of the trip.", parser=_trip_number, show_default=False)
    ],
    set_: Set = None,
) -> None:
    """Confirm that nobody is in the beam path, after a trip; lights nothing.

    \b
    Example:
      rig light acknowledge mine.toml 5
    """
    from rig.measure import acknowledge_trip

    raise typer.Exit(acknowledge_trip(configuration_of(config, set_), number))


light = group("light", "Switch the laser off; show and acknowledge why it is dark.", off, show, acknowledge)
