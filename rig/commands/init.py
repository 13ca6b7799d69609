"""`rig init`: a first configuration."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from processing.errors import ConfigurationError, RigError
from rig.commands.arguments import in_json

if TYPE_CHECKING:
    from acquisition.camera import PluggedCamera


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
    from rig.control import list_serial_ports
    from rig.settings import refuse_existing, write_configuration
    from rig.terminal import answer, say

    refuse_existing(file)
    # nothing is printed before the first question
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
    from rig.terminal import answer, print_line

    answer(instruments={each.kind: each.sentence for each in INSTRUMENTS.values()})
    for description in INSTRUMENTS.values():
        print_line(f"{description.kind:<15} {description.sentence}")


def _write_example(name: str, file: Path | None) -> None:
    from rig.settings import copy_shipped, refuse_existing, shipped
    from rig.terminal import answer, say

    shipped(name)
    file = file or Path(f"{name}.toml")
    refuse_existing(file)
    for path in copy_shipped(name, file):
        print(path)
        answer(written=[path])
    say("next:")
    say(f"  rig run {file} -o runs/{file.stem}: measure")


def _next_steps(file: Path, stated: Mapping[str, Any], *, lit: bool) -> list[str]:
    """The next steps with a new configuration."""
    simulated = stated["camera.driver"] == "simulated"
    edited = "[pendulum] (mass, radius, materials)" + (" and the limits of [laser]" if lit else "")
    steps = [f"edit {file}: {edited}", f"rig doctor {file}: is everything there"]
    if not simulated:
        steps.append(f"rig camera expose {file}, then rig camera align {file}: the light on the sensor")
        if "lever.arm_m" not in stated:
            steps.append("rig calibrate lever geometry.toml: px to radians (docs/calibrate.md)")
    return [*steps, f"rig run {file} -o runs/{file.stem}: measure"]


Keys = Mapping[str, Any]
"""Values by dotted key of the configuration."""
_FRAMES = {"camera.exposure_us": 100.0, "camera.frame_rate_hz": 100.0, "camera.pixel_format": "mono8"}
"""First settings of a camera; Video4Linux cameras keep theirs, because most lack such rates and exposures."""
_LATER = {
    "usb3vision": "a USB3 Vision camera, plugged in later",
    "pylon": "a Basler camera through the vendor's pypylon, plugged in later",
    "aravis": "a GigE Vision camera through libaravis, plugged in later",
    "v4l2": "a UVC or other Video4Linux camera, plugged in later",
    "simulated": "no camera: a simulated rig, to try the program",
}


@dataclass(frozen=True)
class Question:
    """One prompt of `rig init`.

    Parameters
    ----------
    text
        The prompt, one line.
    read
        The keys that an answer states; raises a RigError, one line, for one that cannot be.
    suggested
        The answer that Enter gives; None: one must be typed.
    choices
        Answers and what each of them is, where there are some to choose from, by name or number.
    open_choice
        Other answers than the choices are taken, too.
    """

    text: str
    read: Callable[[str], Keys]
    suggested: str | None = None
    choices: tuple[tuple[str, str], ...] = ()
    open_choice: bool = False


def ask(cameras: Sequence["PluggedCamera"], ports: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Ask all questions at the terminal; returns the stated keys.

    A wrong answer is asked for again; where lines come from a file or pipe, it ends the questions.

    Parameters
    ----------
    cameras
        The cameras that were found.
    ports
        Name and description of each serial port that was found.

    Raises
    ------
    ConfigurationError
        The input ends too early, or an answer cannot be and nobody sits at the keyboard.
    KeyboardInterrupt
        After Ctrl-C.
    """
    from rig.terminal import say

    say("A configuration for your rig. Enter accepts the value in brackets, Ctrl-C ends and writes nothing.")
    stated: dict[str, Any] = {}
    for question in questions(cameras, ports, stated):
        while True:
            text = _typed(question)
            try:
                stated |= question.read(_chosen(question, text))
            except RigError as error:
                if not sys.stdin.isatty():
                    raise ConfigurationError(f"{question.text} {error}") from None
                say(f"  {error}")
            else:
                break
    return stated


def questions(
    cameras: Sequence["PluggedCamera"], ports: Sequence[tuple[str, str]], stated: Keys
) -> Iterator[Question]:
    """The questions in their order; `stated` grows by the keys of each answer before the next is asked."""
    yield _camera(cameras)
    simulated = stated["camera.driver"] == "simulated"
    if not simulated:
        yield from _ports(ports, stated)
        yield from _lever(stated)
    yield Question(
        "Ball and flat (steel ball on K8 glass, cleaned with ethanol):", _text("session.sample"), ""
    )
    yield Question("Folder to record in:", _text("session.output"), "runs")


def _camera(cameras: Sequence["PluggedCamera"]) -> Question:
    """The choice of a camera; plugged-in cameras are chosen by number, several may have one driver."""
    from acquisition.cameras.drivers import DRIVERS

    choices, keys = [], {}
    drivers = [camera.driver for camera in cameras]
    for place, camera in enumerate(cameras, 1):
        several = drivers.count(camera.driver) > 1
        answer = f"{camera.driver} {camera.serial or camera.place}" if several else camera.driver
        answer = answer if answer not in keys else f"{answer} {place}"
        keys[answer] = _identity(camera, several=several)
        words = [camera.name, camera.serial and f"serial {camera.serial}", camera.place, camera.problem]
        choices.append((answer, ", ".join(part for part in words if part)))
    for driver, text in _LATER.items():
        if driver in DRIVERS and driver not in drivers:
            keys[driver] = {"camera.driver": driver}
            choices.append((driver, text))
    for answer, found in keys.items():
        if found["camera.driver"] != "v4l2":
            keys[answer] = found | _FRAMES
    suggested = choices[0][0] if cameras else "simulated"
    return Question("Which camera:", lambda answer: _checked(keys[answer]), suggested, tuple(choices))


def _identity(camera: "PluggedCamera", *, several: bool) -> dict[str, Any]:
    keys: dict[str, Any] = {"camera.driver": camera.driver}
    if several and camera.serial:
        keys["camera.serial"] = camera.serial
    elif several and camera.driver == "v4l2":
        keys["camera.v4l2.device"] = camera.place
    return keys


def _ports(ports: Sequence[tuple[str, str]], stated: Keys) -> Iterator[Question]:
    """Questions on controller and laser: which of them this program switches, and their ports."""
    from rig.control import LASERS

    yield Question(
        "Serial port of the controller, a Pico with this program's firmware (another board: none):",
        lambda text: (
            {}
            if text == "none"
            else _checked({"controller.kind": "serial", "controller.port": text}, whole="controller")
        ),
        "none",
        (("none", "everything is switched by hand"), *ports),
        open_choice=True,
    )
    kinds = {"none": "it is not switched by this program"}
    if "controller.kind" in stated:
        kinds["controller"] = "a diode that the controller feeds"
    kinds |= dict.fromkeys(LASERS, "has a serial port of its own")
    yield Question(
        "The laser:",
        lambda text: {} if text == "none" else _checked({"laser.kind": text}),
        "none",
        tuple(kinds.items()),
    )
    if stated.get("laser.kind") in LASERS:
        yield Question(
            "Serial port of the laser:", _text("laser.port"), choices=tuple(ports), open_choice=True
        )


def _lever(stated: Keys) -> Iterator[Question]:
    """Questions on both lengths of the light lever; without them amplitudes are in px."""
    yield Question(
        "Distance from mirror to sensor along the beam, in m (1 m ± 1 mm; Enter: not measured yet):",
        _length("lever.arm_m"),
        "",
    )
    if "lever.arm_m" in stated:
        yield Question(
            "Distance of neighbouring pixels, in m (from the sensor's data sheet: 4.8 um):",
            _length("lever.pixel_pitch_m"),
        )


def _length(key: str) -> Callable[[str], Keys]:
    """A reader of a number with its standard uncertainty, which has its own key; no keys for no answer."""
    from processing.units import unit_of_name
    from rig.settings import quantity

    def read(text: str) -> Keys:
        if not text:
            return {}
        section, _, name = key.rpartition(".")
        value, u = quantity(text, unit_of_name(name))
        return _checked({key: value} | ({} if u is None else {f"{section}.u_{name}": u}))

    return read


def _text(key: str) -> Callable[[str], Keys]:
    return lambda text: _checked({key: text}) if text else {}


def _checked(keys: Keys, *, whole: str = "") -> Keys:
    """The keys, if the models accept them; raises ConfigurationError with the models' message if not.

    `whole` names a section of which all is stated, so that what holds between its keys is checked, too.
    """
    from rig.settings import keys_with_faults

    if lines := keys_with_faults(keys, whole):
        raise ConfigurationError("; ".join(lines))
    return keys


def _chosen(question: Question, text: str) -> str:
    if not text:
        if question.suggested is None:
            raise ConfigurationError("an answer is needed here")
        text = question.suggested
    answers = [answer for answer, _ in question.choices]
    if answers and text not in answers:
        if text.isdecimal() and 1 <= int(text) <= len(answers):
            return answers[int(text) - 1]
        if not question.open_choice:
            raise ConfigurationError(f"{text!r}: choose one of {', '.join(answers)}, or its number")
    return text


def _typed(question: Question) -> str:
    from rig.terminal import say

    for number, (answer, what) in enumerate(question.choices, 1):
        say(f"  {number}  {answer}{f': {what}' if what else ''}")
    prompt = f"{question.text}{f' [{question.suggested}]' if question.suggested else ''} "
    if not sys.stdin.isatty():
        say(prompt)
        prompt = ""
    try:
        return input(prompt).strip()
    except EOFError:
        raise ConfigurationError(f"the answers end at: {question.text}") from None
