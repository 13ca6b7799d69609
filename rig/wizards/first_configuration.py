"""The wizard of `rig init`: finds the devices, asks what must be known, and writes a configuration."""

import getpass
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from acquisition.camera import PluggedCamera
from acquisition.cameras.drivers import DRIVERS
from processing.contact import MATERIALS
from processing.errors import ConfigurationError
from rig.control import LASERS, laser_unit
from rig.settings import number, optional
from rig.wizards.keys import Keys, KeysOf
from rig.wizards.question import Choice, Question
from rig.wizards.recorded_files import (
    CHOICES,
    FILM,
    TABLE,
    direction_question,
    film_questions,
    table_questions,
)

_PERIODS = 3.44
"""Length of a look of `rig balance` in periods, as its default is in those of the paper's pendulum."""
_FRAMES = {"camera.exposure_us": 100.0, "camera.frame_rate_hz": 100.0, "camera.pixel_format": "mono8"}
"""To begin with; a Video4Linux camera keeps its own, as most know neither such rates nor such exposures."""
_KEYS = KeysOf()
_LATER = {
    "usb3vision": "a USB3 Vision camera, plugged in later",
    "pylon": "a Basler camera through the vendor's pypylon, plugged in later",
    "aravis": "a GigE Vision camera through libaravis, plugged in later",
    "v4l2": "a UVC or other Video4Linux camera, plugged in later",
    "simulated": "no camera: a simulated rig, to try the program",
}


@dataclass(frozen=True)
class FirstConfiguration:
    """Questions about a rig, whose cameras and serial ports (names, what they are) were looked for."""

    cameras: Sequence[PluggedCamera] = ()
    ports: Sequence[tuple[str, str]] = ()
    title: str = "A configuration for your rig"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`; the value of each answer is a mapping from keys of the configuration to values."""
        yield self._camera()
        driver = values["camera"].get("camera.driver", TABLE)
        simulated, film = driver == "simulated", driver == FILM
        if driver == TABLE:
            yield from table_questions(values)
            yield from _pendulum(values)
            return
        if film:
            yield from film_questions(values)
        yield from _pendulum(values, needed=not film)
        if film:
            yield from _lever(values)
            if values["arm"]:
                yield direction_question()
            return
        yield Question(
            "period",
            "Period of the slow swing, in s (Enter: not known):",
            _period,
            suggested="",
            says_enter=True,
        )
        if not simulated:
            yield from _lever(values)
        yield Question(
            "sample",
            "Ball and flat (steel ball on K8 glass, cleaned with ethanol):",
            _KEYS.text("session.sample"),
            do="The session. All of it can be changed for one call with --set.",
            suggested="",
        )
        yield Question("operator", "Who measures:", _KEYS.text("session.operator"), suggested=_user())
        yield Question("folder", "Folder for the sessions:", _KEYS.text("session.output"), suggested="runs")
        if not simulated:
            yield from self._controller_and_laser(values)
            yield from _region_and_start(controlled=bool(values["controller"]))

    def _camera(self) -> Question:
        """Cameras that are there are chosen by their number; of one driver there may be several."""
        choices, keys = [], {}
        drivers = [camera.driver for camera in self.cameras]
        for place, camera in enumerate(self.cameras, 1):
            several = drivers.count(camera.driver) > 1
            answer = f"{camera.driver} {camera.serial or camera.place}" if several else camera.driver
            answer = answer if answer not in keys else f"{answer} {place}"
            keys[answer] = _identity(camera, several=several)
            words = [camera.name, camera.serial and f"serial {camera.serial}", camera.place, camera.problem]
            choices.append(Choice(answer, ", ".join(part for part in words if part)))
        for driver, text in _LATER.items():
            if driver in DRIVERS and driver not in drivers:
                keys[driver] = {"camera.driver": driver}
                choices.append(Choice(driver, text))
        for answer, stated in keys.items():
            if stated["camera.driver"] != "v4l2":
                keys[answer] = stated | _FRAMES
        keys |= {FILM: {"camera.driver": FILM}, TABLE: {}}
        choices += [Choice(answer, text) for answer, text in CHOICES.items()]
        return Question(
            "camera",
            "Which camera:",
            # a film is asked for next
            lambda answer: _known(answer, keys) if answer == FILM else _KEYS.checked(_known(answer, keys)),
            do=f"The camera. {len(self.cameras) or 'None'} found; rig devices says where none was sought.",
            suggested=choices[0].answer if self.cameras else "simulated",
            choices=tuple(choices),
        )

    def _controller_and_laser(self, values: Mapping[str, Any]) -> Iterator[Question]:
        ports = tuple(Choice(*port) for port in self.ports)
        yield Question(
            "controller",
            "Serial port of the rig's controller (docs/controller.md), or none:",
            lambda text: (
                {}
                if text == "none"
                else _KEYS.checked({"controller.kind": "serial", "controller.port": text}, whole="controller")
            ),
            do="What the program switches. A controller has laser, magnet, starter, brake and interlock: a "
            "Raspberry Pi Pico with this program's firmware. With another board, such as an Arduino: none.",
            suggested="none",
            choices=(Choice("none", "everything is switched by hand"), *ports),
            open_choice=True,
        )
        controlled = bool(values["controller"])
        kinds = {"none": "it is not switched by this program"}
        if controlled:
            kinds["controller"] = "a diode that the controller feeds"
        kinds |= dict.fromkeys(LASERS, "has a serial port of its own")
        yield Question(
            "laser",
            "The laser:",
            lambda text: (
                {} if text == "none" else _KEYS.checked({"laser.kind": _known(text, kinds, value=True)})
            ),
            suggested="none",
            choices=tuple(Choice(kind, text) for kind, text in kinds.items()),
        )
        kind = values["laser"].get("laser.kind")
        if kind is None:
            return
        if kind in LASERS:
            yield Question(
                "laser port",
                "Its serial port:",
                _KEYS.text("laser.port"),
                choices=ports,
                open_choice=True,
            )
        unit, name, what = (
            ("A", "current_a", "current") if laser_unit(kind) == "a" else ("W", "power_w", "power")
        )
        example = "60 mA" if unit == "A" else "1 mW"
        yield Question(
            "laser limit",
            f"Largest {what} that may ever be set, in {unit} ({example}):",
            _KEYS.alone(f"laser.max_{name}"),
            do="The limit applies whatever is requested later; above 1 mW a laser is no longer class 2.",
        )
        limit = values["laser limit"]
        yield Question(
            "laser setting",
            f"The {what} to measure with, in {unit}:",
            lambda text: _only(
                f"laser.{name}",
                _KEYS.alone(f"laser.{name}", {"laser.kind": "controller", **limit}, whole="laser")(text),
            ),
        )
        if kind in LASERS and controlled:
            yield Question(
                "interlock",
                "What opens the laser's interlock:",
                lambda text: _KEYS.checked({"laser.interlock": text}),
                suggested="controller",
                choices=(
                    Choice("controller", "it is wired through the controller's enable relay"),
                    Choice("own", "it has one of its own; it stays lit if this program is killed"),
                ),
            )


def _region_and_start(*, controlled: bool) -> Iterator[Question]:
    yield Question(
        "region",
        "Image region, as 640 x 320, or 640 x 320 at 100, 80 for its first column and row (Enter: the whole "
        "sensor):",
        _region,
        do="What the camera reads, and how a run starts. A small region is read faster and recorded in less "
        "space; the swing must fit into it. `rig camera align` shows the spot.",
        suggested="",
        says_enter=True,
    )
    ways = {
        "at once": "it is recorded from the first frame: start the pendulum, then the program",
        "by hand": "the program waits for rest, checks, and asks you to release the pendulum",
    }
    if controlled:
        ways["magnet"] = "the controller's magnet holds the pendulum and lets it go"
        ways["starter"] = "the controller's starter pushes it"
    yield Question(
        "start",
        "The start of a run:",
        lambda text: {"start.way": _known(text, ways, value=True)},
        suggested="at once",
        choices=tuple(Choice(way, text) for way, text in ways.items()),
    )


def _pendulum(values: Mapping[str, Any], *, needed: bool = True) -> Iterator[Question]:
    """Mass, radius and materials; without them nothing but the laws of the contact is lacking."""
    more = "" if needed else "; Enter: not known"
    yield _KEYS.measured(
        "mass",
        "Mass of the pendulum with its ball",
        "pendulum.mass_kg",
        f"0.406 ± 0.0001, 406 g ± 0.1 g{more}",
        do="The pendulum. Give each measured value with its standard uncertainty after ±; without one "
        "it is taken as exact.",
        suggested=None if needed else "",
    )
    if not values["mass"]:
        return
    yield _KEYS.measured("ball radius", "Radius of the ball", "pendulum.ball_radius_m", "6.05 mm ± 1 um")
    for body in ("ball", "flat"):
        yield from _material(body, values)


def _lever(values: Mapping[str, Any]) -> Iterator[Question]:
    yield _KEYS.measured(
        "arm",
        "Distance from mirror to sensor along the beam",
        "lever.arm_m",
        "1 m ± 1 mm; Enter: not measured yet",
        do="The light lever. Without it deflections and amplitudes are in px, and nothing can be "
        "fitted. `rig calibrate lever` measures it.",
        suggested="",
    )
    if values["arm"]:
        yield _KEYS.measured(
            "pixel pitch",
            "Distance of neighbouring pixels of the sensor",
            "lever.pixel_pitch_m",
            "from its data sheet: 4.8 um",
        )


def _identity(camera: PluggedCamera, *, several: bool) -> dict[str, Any]:
    keys: dict[str, Any] = {"camera.driver": camera.driver}
    if several and camera.serial:
        keys["camera.serial"] = camera.serial
    elif several and camera.driver == "v4l2":
        keys["camera.v4l2.device"] = camera.place
    return keys


def _material(body: str, values: Mapping[str, Any]) -> Iterator[Question]:
    """The material of ball or flat; one that is not known brings its elastic constants."""
    key = f"pendulum.{body}_material"
    yield Question(
        f"{body} material",
        f"Material of the {body} (for another name you are asked for its elastic constants):",
        lambda text: _KEYS.checked({key: _bare(text)}),
        suggested="steel" if body == "ball" else "glass_k8",
        choices=tuple(
            Choice(name, f"E = {known.youngs_modulus_pa / 1e9:g} GPa, ν = {known.poisson_ratio:g}")
            for name, known in MATERIALS.items()
        ),
        open_choice=True,
    )
    name = values[f"{body} material"][key]
    if name in MATERIALS or f"modulus of {name}" in values:
        return
    for asked, what, constant, example in (
        ("modulus", "Young's modulus", "youngs_modulus_pa", "211 GPa ± 3 GPa"),
        ("ratio", "Poisson's ratio", "poisson_ratio", "0.28 ± 0.01"),
    ):
        yield _KEYS.measured(
            f"{asked} of {name}", f"{what} of {name}", f"materials.{name}.{constant}", example
        )


def _only(key: str, keys: Keys) -> Keys:
    return {key: keys[key]}


def _region(text: str) -> Keys:
    found = re.fullmatch(r"(\d+) *[x×*] *(\d+)(?: *at *(\d+) *[,; ] *(\d+))?", text)
    if text and found is None:
        raise ConfigurationError(f"{text!r}: should be width x height in px, such as 640 x 320")
    names = ("width_px", "height_px", "offset_x_px", "offset_y_px")
    given = zip(names, () if found is None else found.groups(), strict=False)
    return _KEYS.checked({f"camera.{name}": int(value) for name, value in given if value is not None})


def _period(text: str) -> Keys:
    period_s = optional(number("s", least=0.1))(text)
    return {} if period_s is None else _KEYS.checked({"balance.seconds": round(_PERIODS * period_s, 1)})


def _bare(name: str) -> str:
    if not name.replace("_", "").replace("-", "").isalnum() or not name.isascii():
        raise ConfigurationError(f"{name!r}: a name of letters, digits and _ is needed, such as my_steel")
    return name


def _known(answer: str, known: Mapping[str, Any], *, value: bool = False) -> Any:
    if answer not in known:
        raise ConfigurationError(f"{answer!r}: is not available; choose one of {', '.join(known)}")
    return answer if value else known[answer]


def _user() -> str:
    with suppress(KeyError, OSError, ImportError):
        return getpass.getuser()
    return ""
