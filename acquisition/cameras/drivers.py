"""Registry of the camera drivers: name, settings, class of the camera, search for cameras.

To add a driver, add one entry. It determines the values of ``camera.driver``, the section ``[camera.NAME]``
of the configuration, and what ``rig doctor`` lists. Modules with settings are imported with the
configuration, all others when the driver is used.
"""

import importlib
import math
from typing import Any, Literal, NamedTuple, cast

from pydantic import BaseModel, Field

from acquisition.camera import Camera, PluggedCamera
from processing.errors import ConfigurationError, DeviceError


class Driver(NamedTuple):
    """Locations of the parts of a driver, each as ``module:name``."""

    camera: str
    """Class that implements `acquisition.camera.Camera`, called with its settings."""
    settings: tuple[str, ...]
    """Frozen pydantic models in modules that are cheap to import; `camera.serial` fills a field `serial`."""
    find: str = ""
    """Function that returns the connected cameras as `PluggedCamera`, and raises DeviceError if it cannot
    search; empty for a driver without hardware."""
    sections: tuple[str, ...] = ()
    """Sections of the configuration with the settings; empty: the single section ``[camera.NAME]``."""
    on_demand: bool = False
    """Whether frames are made or read when requested, so that none are lost."""


DRIVERS: dict[str, Driver] = {
    # the simulated rig
    "simulated": Driver(
        camera="acquisition.cameras.simulated:SimulatedCamera",
        settings=(
            "acquisition.simulation.settings:SimulationSettings",
            "acquisition.simulation.inputs:FaultSettings",
        ),
        sections=("simulation", "faults"),
        on_demand=True,
    ),
    # images, a film or a .npy stack that another program recorded
    "files": Driver(
        camera="acquisition.cameras.files.camera:FilesCamera",
        settings=("acquisition.cameras.files.frame_source:FilesSettings",),
        on_demand=True,
    ),
    # any USB3 Vision camera, through pyusb
    "usb3vision": Driver(
        camera="acquisition.cameras.usb3vision.camera:Usb3VisionCamera",
        settings=("acquisition.cameras.drivers:Usb3VisionSettings",),
        find="acquisition.cameras.usb3vision.link:list_cameras",
    ),
    # UVC and other Video4Linux cameras, on Linux
    "v4l2": Driver(
        camera="acquisition.cameras.v4l2.camera:V4l2Camera",
        settings=("acquisition.cameras.drivers:V4l2Settings",),
        find="acquisition.cameras.v4l2.devices:list_cameras",
    ),
    # Basler cameras through the vendor's pypylon, an optional package
    "pylon": Driver(
        camera="acquisition.cameras.pylon:PylonCamera",
        settings=("acquisition.cameras.drivers:PylonSettings",),
        find="acquisition.cameras.pylon:list_cameras",
    ),
    # GigE Vision and USB3 Vision cameras through libaravis and PyGObject, which are optional
    "aravis": Driver(
        camera="acquisition.cameras.aravis.camera:AravisCamera",
        settings=("acquisition.cameras.drivers:AravisSettings",),
        find="acquisition.cameras.aravis.library:list_cameras",
    ),
}


def find_driver(name: str) -> Driver:
    """Entry of the registry; raises ConfigurationError, which lists the drivers, for an unknown name."""
    if name not in DRIVERS:
        raise ConfigurationError(f"camera.driver = {name!r}: {unknown_driver()}")
    return DRIVERS[name]


def unknown_driver() -> str:
    """Error message for a name that is not in the registry."""
    return f"no such driver; there are {', '.join(sorted(DRIVERS))}"


def settings_models(name: str) -> tuple[type[BaseModel], ...]:
    """Classes of the settings of a driver."""
    return tuple(cast(type[BaseModel], _load(location)) for location in find_driver(name).settings)


def default_settings(model: type[BaseModel]) -> BaseModel | None:
    """Settings with default values; None if a field has no default."""
    return None if any(field.is_required() for field in model.model_fields.values()) else model()


def make_camera(name: str, *settings: BaseModel) -> Camera:
    """A camera of a driver of `DRIVERS` that is not opened yet.

    `settings` are instances of the driver's settings classes, in their order; missing ones have default
    values. Raises ConfigurationError for an unknown driver, and for settings that are missing or belong to
    another driver.
    """
    models = settings_models(name)
    complete = [*settings, *(default_settings(model) for model in models[len(settings) :])]
    if len(complete) > len(models) or not all(map(isinstance, complete, models)):
        needed = ", ".join(model.__name__ for model in models)
        given = ", ".join(type(value).__name__ for value in settings) or "nothing"
        raise ConfigurationError(f"camera driver {name!r} takes {needed}; {given} was given")
    return cast(Camera, _load(find_driver(name).camera)(*complete))


def find_cameras() -> tuple[list[PluggedCamera], list[str]]:
    """Connected cameras, and one line for each driver that cannot search for them."""
    cameras: list[PluggedCamera] = []
    notes: list[str] = []
    for name, driver in DRIVERS.items():
        if driver.find:
            try:
                cameras += _load(driver.find)()
            except DeviceError as error:
                notes.append(f"{name} cameras were not looked for: {error}")
    return cameras, notes


def _load(location: str) -> Any:
    module, _, name = location.partition(":")
    return getattr(importlib.import_module(module), name)


BUFFERED_S = 0.1
"""Pauses of Python are shorter than this, in garbage collection or on a busy processor."""
_MAX_BYTES = 256 * 1024 * 1024


def buffer_count(rate_hz: float | None, frame_bytes: int, minimum: int, maximum: int) -> int:
    """Number of buffers, `minimum` to `maximum`: as many as `rate_hz` (None: unknown) fills in `BUFFERED_S`.

    All together take at most 256 MiB.
    """
    needed = max(minimum, math.ceil(BUFFERED_S * (rate_hz or 0.0)) + 1)
    return max(2, min(needed, maximum, _MAX_BYTES // max(frame_bytes, 1)))


def frames_ahead(rate_hz: float | None, frame_bytes: int) -> int:
    """Number of frames of this size for which reads of a USB3 Vision camera are queued."""
    return buffer_count(rate_hz, frame_bytes, 4, 1024)


class Usb3VisionSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of the communication with it."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")
    reading: Literal["auto", "blocking"] = Field(
        default="auto", description="auto queues reads ahead if libusb 1.0 is available; blocking never does"
    )


class V4l2Settings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera, and options of this driver."""

    device: str | None = Field(
        default=None, description="/dev/video2, or its number; needed only where there are several"
    )
    serial: str | None = Field(default=None, description="instead of the device, where the camera has one")
    gain: int | None = Field(default=None, description="in the camera's own steps, which are not decibels")


class PylonSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera."""

    serial: str | None = Field(default=None, description="needed only where several are plugged in")


class AravisSettings(BaseModel, frozen=True, extra="forbid"):
    """Choice of the camera and options of the communication."""

    serial: str | None = Field(
        default=None, description="serial number or libaravis's id; needed only where there are several"
    )
    packet_bytes: int | None = Field(
        default=None, ge=576, le=16114, description="GigE packets; left out: the largest that passes"
    )
