"""The wizard of `rig init`: finds the devices, asks what must be known, and writes a configuration."""

import getpass
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from acquisition.camera import PluggedCamera
from acquisition.cameras.drivers import DRIVERS
from processing.contact import MATERIALS
from processing.errors import ConfigurationError
from rig.control import LASERS, laser_unit
from rig.settings import keys_with_faults, number, optional, quantity, word
from rig.wizards.configuration_file import Keys
from rig.wizards.question import Choice, Question

_PERIODS = 3.44
"""Length of a look of `rig balance` in periods, as its default is in those of the paper's pendulum."""
_FRAMES = {"camera.exposure_us": 100.0, "camera.frame_rate_hz": 100.0, "camera.pixel_format": "mono8"}
"""To begin with; a Video4Linux camera keeps its own, as most know neither such rates nor such exposures."""
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
        simulated = values["camera"]["camera.driver"] == "simulated"
        yield Question(
            "mass",
            "Mass of the pendulum with its ball, in kg (0.406 ± 0.0001, 406 g ± 0.1 g):",
            _measured("pendulum.mass_kg", "kg"),
            do="The pendulum. State what was measured with its standard uncertainty behind ±; without one "
            "it is taken as known.",
        )
        yield Question(
            "ball radius",
            "Radius of the ball, in m (6.05 mm ± 1 um):",
            _measured("pendulum.ball_radius_m", "m"),
        )
        for body in ("ball", "flat"):
            yield from _material(body, values)
        yield Question(
            "period",
            "Period of the slow swing, in s (Enter: not known):",
            _period,
            suggested="",
            says_enter=True,
        )
        if not simulated:
            yield Question(
                "arm",
                "Distance from mirror to sensor along the beam, in m (1 m ± 1 mm; Enter: not measured yet):",
                lambda text: _measured("lever.arm_m", "m")(text) if text else {},
                do="The light lever. Without it deflections and amplitudes are in px, and nothing can be "
                "fitted. `rig calibrate lever` measures it.",
                suggested="",
                says_enter=True,
            )
            if values["arm"]:
                yield Question(
                    "pixel pitch",
                    "Distance of neighbouring pixels of the sensor, in m (its data sheet says it: 4.8 um):",
                    _measured("lever.pixel_pitch_m", "m"),
                )
        yield Question(
            "sample",
            "What stands on what (steel ball on K8 glass, cleaned with ethanol):",
            _text("session.sample"),
            do="The session. All of it can be changed for one call with --set.",
            suggested="",
        )
        yield Question("operator", "Who measures:", _text("session.operator"), suggested=_user())
        yield Question("folder", "Folder for the sessions:", _text("session.output"), suggested="runs")
        if not simulated:
            yield from self._controller_and_laser(values)

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
        return Question(
            "camera",
            "Which camera:",
            lambda answer: _checked(_known(answer, keys)),
            do=f"The camera. {len(self.cameras) or 'None'} found.",
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
                else _checked({"controller.kind": "serial", "controller.port": text}, whole="controller")
            ),
            do="What the program switches. A controller has laser, magnet, starter, brake and interlock.",
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
            lambda text: {} if text == "none" else _checked({"laser.kind": _known(text, kinds, value=True)}),
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
                _text("laser.port"),
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
            _alone(f"laser.max_{name}", unit),
            do="The limit holds whatever is asked for later; above 1 mW a laser is not of class 2 any more.",
        )
        limit = values["laser limit"]
        yield Question(
            "laser setting",
            f"The {what} to measure with, in {unit}:",
            lambda text: _only(
                f"laser.{name}",
                _alone(f"laser.{name}", unit, {"laser.kind": "controller", **limit}, whole="laser")(text),
            ),
        )
        if kind in LASERS and controlled:
            yield Question(
                "interlock",
                "Who opens the laser's interlock:",
                lambda text: _checked({"laser.interlock": text}),
                suggested="controller",
                choices=(
                    Choice("controller", "it is wired through the controller's enable relay"),
                    Choice("own", "it has one of its own; it stays lit if this program is killed"),
                ),
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
        f"Material of the {body} (another name: its elastic constants are asked):",
        lambda text: _checked({key: _bare(text)}),
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
    yield Question(
        f"modulus of {name}",
        f"Young's modulus of {name}, in Pa (211 GPa ± 3 GPa):",
        _measured(f"materials.{name}.youngs_modulus_pa", "Pa"),
    )
    yield Question(
        f"ratio of {name}",
        f"Poisson's ratio of {name} (0.28 ± 0.01):",
        _measured(f"materials.{name}.poisson_ratio", ""),
    )


def _measured(key: str, unit: str) -> Callable[[str], Keys]:
    """Reads a number with its standard uncertainty, which has a key of its own."""

    def read(text: str) -> Keys:
        value, u = quantity(text, unit)
        section, _, name = key.rpartition(".")
        return _checked({key: value} | ({} if u is None else {f"{section}.u_{name}": u}))

    return read


def _alone(
    key: str, unit: str, beside: Keys | None = None, whole: str = ""
) -> Callable[[str], dict[str, Any]]:
    """Reads a number without uncertainty."""
    return lambda text: _checked({**(beside or {}), key: number(unit)(text)}, whole=whole)


def _only(key: str, keys: Keys) -> Keys:
    return {key: keys[key]}


def _text(key: str) -> Callable[[str], Keys]:
    return lambda text: _checked({key: word(text)}) if text else {}


def _period(text: str) -> Keys:
    period_s = optional(number("s", least=0.1))(text)
    return {} if period_s is None else _checked({"balance.seconds": round(_PERIODS * period_s, 1)})


def _bare(name: str) -> str:
    if not name.replace("_", "").replace("-", "").isalnum() or not name.isascii():
        raise ConfigurationError(f"{name!r}: a name of letters, digits and _ is needed, as my_steel")
    return name


def _known(answer: str, known: Mapping[str, Any], *, value: bool = False) -> Any:
    if answer not in known:
        raise ConfigurationError(f"{answer!r}: is not there; there are {', '.join(known)}")
    return answer if value else known[answer]


def _checked(keys: Mapping[str, Any], *, whole: str = "") -> dict[str, Any]:
    """The keys, if the configuration takes them; raises ConfigurationError with its own line if not.

    `whole` names a section of which all is stated, so that what holds between its keys is checked, too.
    """
    for value in keys.values():
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigurationError(f"{value}: should be a finite number")
    lines = keys_with_faults(keys, whole)
    if lines:
        raise ConfigurationError("; ".join(lines))
    return dict(keys)


def _user() -> str:
    with suppress(KeyError, OSError, ImportError):
        return getpass.getuser()
    return ""
