"""`rig init`: the questions of a first configuration, and copies of shipped ones."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from processing.errors import ConfigurationError, RigError
from rig.commands.arguments import in_json, print_written

if TYPE_CHECKING:
    from acquisition.camera import PluggedCamera


@in_json
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
    from rig.control import list_serial_ports
    from rig.settings import refuse_existing, write_configuration
    from rig.terminal import say

    refuse_existing(file)
    # nothing is printed before the first question
    cameras, _ = find_cameras()
    keys = ask(cameras, [(port.device, port.description) for port in list_serial_ports()])
    config = write_configuration(file, keys)
    sys.stderr.flush()
    print_written(file)
    has_laser = config.laser.kind != "none"
    for line in ("next:", *(f"  {step}" for step in _next_steps(file, keys, has_laser=has_laser))):
        say(line)


def _list_instruments() -> None:
    from processing.instruments import INSTRUMENTS
    from rig.terminal import answer, print_line

    answer(instruments={kind: description.sentence for kind, description in INSTRUMENTS.items()})
    for description in INSTRUMENTS.values():
        print_line(f"{description.kind:<15} {description.sentence}")


def _write_example(name: str, file: Path | None) -> None:
    from rig.settings import copy_shipped, refuse_existing, shipped
    from rig.terminal import say

    shipped(name)
    file = file or Path(f"{name}.toml")
    refuse_existing(file)
    print_written(*copy_shipped(name, file))
    say("next:")
    say(f"  rig run {file} -o runs/{file.stem}: measure")


def _next_steps(file: Path, keys: Mapping[str, Any], *, has_laser: bool) -> list[str]:
    """The next steps with a new configuration."""
    sections = "[pendulum] (mass, radius, materials)" + (" and the limits of [laser]" if has_laser else "")
    steps = [f"edit {file}: {sections}", f"rig doctor {file}: is everything there"]
    if keys["camera.driver"] != "simulated":
        steps.append(f"rig camera expose {file}, then rig camera align {file}: the light on the sensor")
        if "lever.arm_m" not in keys:
            steps.append("rig calibrate lever geometry.toml: px to radians (docs/calibrate.md)")
    return [*steps, f"rig run {file} -o runs/{file.stem}: measure"]


Keys = Mapping[str, Any]
"""Values by dotted key of the configuration."""
_FRAME_KEYS = {"camera.exposure_us": 100.0, "camera.frame_rate_hz": 100.0, "camera.pixel_format": "mono8"}
"""First settings of a camera; Video4Linux cameras keep theirs, because most lack such rates and exposures."""
_UNPLUGGED = {
    "usb3vision": "a USB3 Vision camera, plugged in later",
    "pylon": "a Basler camera through the vendor's pypylon, plugged in later",
    "aravis": "a GigE Vision camera through libaravis, plugged in later",
    "v4l2": "a UVC or other Video4Linux camera, plugged in later",
    "simulated": "no camera: a simulated rig, to try the program",
}


def ask(cameras: Sequence["PluggedCamera"], ports: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Ask all questions at the terminal; returns the stated keys.

    `cameras` are the plugged-in ones, `ports` name and description of each serial port. Raises
    ConfigurationError if the input ends too early, or if a line from a file or pipe is a wrong answer.
    """
    from rig.terminal import say

    say("A configuration for your rig. Enter accepts the value in brackets, Ctrl-C ends and writes nothing.")
    keys = dict(_camera(cameras))
    if keys["camera.driver"] != "simulated":
        keys |= _devices(ports)
        keys |= _lever()
    keys |= _ask_keys(
        "Ball and flat (steel ball on K8 glass, cleaned with ethanol):", _text("session.sample"), ""
    )
    keys |= _ask_keys("Folder to record in:", _text("session.output"), "runs")
    return keys


def _ask_keys(
    question: str,
    read: Callable[[str], Keys],
    suggested: str | None = None,
    choices: Sequence[tuple[str, str]] = (),
    *,
    is_open: bool = False,
) -> Keys:
    """Ask a question; returns the keys that `read` makes of the answer.

    After a wrong answer the question is asked again; if lines come from a file or pipe, a wrong answer ends
    the questions. Enter gives the answer `suggested`, if there is one. `choices` are answers with their
    descriptions, to be chosen by name or number; if the choice `is_open`, other answers are accepted, too.
    """
    from rig.terminal import say

    at_terminal = sys.stdin.isatty()
    prompt = f"{question}{f' [{suggested}]' if suggested else ''} "
    answers = [answer for answer, _ in choices]
    while True:
        for number, (answer, description) in enumerate(choices, 1):
            say(f"  {number}  {answer}{f': {description}' if description else ''}")
        if not at_terminal:
            say(prompt)
        try:
            text = input(prompt if at_terminal else "").strip() or suggested
        except EOFError:
            raise ConfigurationError(f"the answers end at: {question}") from None
        try:
            if text is None:
                raise ConfigurationError("an answer is needed here")
            if answers and text not in answers:
                if text.isdecimal() and 1 <= int(text) <= len(answers):
                    text = answers[int(text) - 1]
                elif not is_open:
                    raise ConfigurationError(f"{text!r}: choose one of {', '.join(answers)}, or its number")
            return read(text)
        except RigError as error:
            if not at_terminal:
                raise ConfigurationError(f"{question} {error}") from None
            say(f"  {error}")


def _camera(cameras: Sequence["PluggedCamera"]) -> Keys:
    """The choice of a camera; plugged-in cameras are chosen by number, several may have one driver."""
    from acquisition.cameras.drivers import DRIVERS

    choices: list[tuple[str, str]] = []
    keys: dict[str, dict[str, Any]] = {}
    drivers = [camera.driver for camera in cameras]
    for number, camera in enumerate(cameras, 1):
        is_ambiguous = drivers.count(camera.driver) > 1
        answer = f"{camera.driver} {camera.serial or camera.connection}" if is_ambiguous else camera.driver
        answer = answer if answer not in keys else f"{answer} {number}"
        keys[answer] = {"camera.driver": camera.driver}
        if is_ambiguous and camera.serial:
            keys[answer]["camera.serial"] = camera.serial
        elif is_ambiguous and camera.driver == "v4l2":
            keys[answer]["camera.v4l2.device"] = camera.connection
        details = [
            camera.name,
            camera.serial and f"serial {camera.serial}",
            camera.connection,
            camera.problem,
        ]
        choices.append((answer, ", ".join(filter(None, details))))
    for driver, text in _UNPLUGGED.items():
        if driver in DRIVERS and driver not in drivers:
            keys[driver] = {"camera.driver": driver}
            choices.append((driver, text))
    for answer, values in keys.items():
        if values["camera.driver"] != "v4l2":
            keys[answer] = values | _FRAME_KEYS
    suggested = choices[0][0] if cameras else "simulated"
    return _ask_keys("Which camera:", lambda answer: _check_keys(keys[answer]), suggested, choices)


def _devices(ports: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Keys of the controller and of the laser that this program switches."""
    from rig.control import LASERS

    keys = dict(
        _ask_keys(
            "Serial port of the controller, a Pico with this program's firmware (another board: none):",
            lambda text: (
                {}
                if text == "none"
                else _check_keys(
                    {"controller.kind": "serial", "controller.port": text}, complete_section="controller"
                )
            ),
            "none",
            (("none", "everything is switched by hand"), *ports),
            is_open=True,
        )
    )
    kinds = {"none": "it is not switched by this program"}
    if keys:
        kinds["controller"] = "a diode that the controller feeds"
    kinds |= dict.fromkeys(LASERS, "has a serial port of its own")
    keys |= _ask_keys(
        "The laser:",
        lambda text: {} if text == "none" else _check_keys({"laser.kind": text}),
        "none",
        tuple(kinds.items()),
    )
    if keys.get("laser.kind") in LASERS:
        keys |= _ask_keys("Serial port of the laser:", _text("laser.port"), choices=ports, is_open=True)
    return keys


def _lever() -> dict[str, Any]:
    """Keys of the light lever's arm and pixel pitch; without them amplitudes are in px."""
    arm = _ask_keys(
        "Distance from mirror to sensor along the beam, in m (1 m ± 1 mm; Enter: not measured yet):",
        _length("lever.arm_m"),
        "",
    )
    if not arm:
        return {}
    pitch = _ask_keys(
        "Distance of neighbouring pixels, in m (from the sensor's data sheet: 4.8 um):",
        _length("lever.pixel_pitch_m"),
    )
    return {**arm, **pitch}


def _length(key: str) -> Callable[[str], Keys]:
    """A function that makes keys of a length and its standard uncertainty; no keys of an empty answer."""
    from processing.units import unit_of_name
    from rig.settings import read_quantity

    def read(text: str) -> Keys:
        if not text:
            return {}
        section, _, name = key.rpartition(".")
        value, u = read_quantity(text, unit_of_name(name))
        return _check_keys({key: value} | ({} if u is None else {f"{section}.u_{name}": u}))

    return read


def _text(key: str) -> Callable[[str], Keys]:
    return lambda text: _check_keys({key: text}) if text else {}


def _check_keys(keys: Keys, *, complete_section: str = "") -> Keys:
    """The keys, if the models accept them; raises ConfigurationError with the models' message if not.

    `complete_section` has all of its keys, so that relations between them are checked, too.
    """
    from rig.settings import key_faults

    if lines := key_faults(keys, complete_section):
        raise ConfigurationError("; ".join(lines))
    return keys
