"""`rig desk`, `rig balance`, `rig doctor`: preparing a measurement."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from processing.errors import ConfigurationError, MissingPackage
from rig.commands.archive import PLACE, Archive
from rig.commands.arguments import (
    MODES,
    Config,
    JsonLines,
    Set,
    View,
    appended_file,
    new_file,
    old_folder,
    there,
)


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for command in (desk, balance, doctor):
        app.command()(command)


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
        typer.Option(
            help="File of measurements and turns; earlier ones in it are used.",
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
            help="Simulated rig, which makes the turns you state: random seed of its imbalance (1)."
        ),
    ] = None,
    json_lines: JsonLines = False,
    view: View = None,
    rrd: Annotated[
        Path | None, typer.Option(help="Write all measurements to a Rerun file.", callback=new_file(".rrd"))
    ] = None,
    set_: Set = None,
) -> None:
    """Balance: which weight to turn, which way and how far.

    \b
    Examples:
      rig balance mine.toml --view
      rig balance configs/demo.toml --follow 6
    """
    from rig.prepare import InJsonLines, balance_rig, show_history
    from rig.settings import load_configuration
    from rig.terminal import one_json_object

    overrides = [*(set_ or []), *([f'view.mode="{MODES[view]}"'] if view else [])]
    loaded = load_configuration(config, overrides)
    if history or forget_last:
        with one_json_object() if json_lines else nullcontext():
            show_history(loaded, history_file, forget=forget_last)
        return
    raise typer.Exit(
        balance_rig(loaded, history_file, follow, seed, rrd, reporter=InJsonLines() if json_lines else None)
    )


def desk(
    config: Config,
    port: Annotated[
        int, typer.Option(help="Port; 0: the last one, 8642, or any that is free.", min=0, max=65535)
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    archive: Archive = PLACE,
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
        raise MissingPackage("rig desk", "nicegui", "desk") from None
    raise typer.Exit(open_desk(config, tuple(set_ or ()), port, browser=browser, archive=Path(archive)))


def doctor(
    config: Annotated[
        Path | None,
        typer.Argument(help="Configuration (TOML file).", show_default=False, callback=there),
    ] = None,
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
        typer.Option(
            help="Folder for those rules, instead of /etc/udev/rules.d.",
            show_default=False,
            callback=old_folder,
        ),
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
    from rig.settings import load_configuration
    from rig.terminal import print_json_line, say

    if install_udev or udev_folder is not None:
        path, then = install_rules(udev_folder or RULES_FOLDER)
        if json_lines:
            print_json_line("udev", {"written": str(path), "next": then})
        else:
            print(path)
            say(f"next: {then}")
        if config is None:
            return
    if config is None:
        if preflight or set_:
            raise ConfigurationError("rig doctor: --preflight and --set need the configuration to check")
        _list_devices(json_lines=json_lines)
        return
    loaded = load_configuration(config, set_ or [])
    if preflight:
        from rig.measure import preflight_rig

        raise typer.Exit(preflight_rig(loaded, json_lines=json_lines))
    raise typer.Exit(examine(loaded, json_lines=json_lines))


def _list_devices(*, json_lines: bool) -> None:
    from dataclasses import asdict

    from acquisition.cameras.drivers import find_cameras
    from rig.control import list_serial_ports
    from rig.terminal import print_json_line, print_line

    cameras, notes = find_cameras()
    ports = list_serial_ports()
    if json_lines:
        listed = {"cameras": [one._asdict() for one in cameras], "serial_ports": list(map(asdict, ports))}
        print_json_line("devices", {**listed, "notes": list(notes)})
        return
    for camera in cameras:
        words = [camera.driver, camera.name, camera.serial and f"serial {camera.serial}", camera.place]
        print_line("camera  " + "  ".join(word for word in words if word))
        for mode in camera.modes:
            print_line(f"          {mode}")
        if camera.problem:
            print_line(f"          {camera.problem}")
    if not cameras:
        print_line("no camera is plugged in; camera.driver = 'simulated' and 'files' need none")
    for port in ports:
        usb = f"USB {port.vendor:04x}:{port.product:04x}" if port.vendor >= 0 else ""
        words = [port.device, port.description, usb, port.serial and f"serial {port.serial}"]
        print_line("serial  " + "  ".join(word for word in words if word))
    for note in notes:
        print_line(f"note    {note}")
