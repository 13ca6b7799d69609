"""The one dictionary of camera drivers. A driver is imported when it is asked for, not before."""

import importlib
from typing import Any, NamedTuple, cast

from pydantic import BaseModel

from acquisition.camera import Camera
from processing.errors import ConfigurationError


class Driver(NamedTuple):
    """Where a driver is found, as ``module:name``.

    `settings` are the models that the factory takes, in this order; those beyond `required` may be
    left out.
    """

    factory: str
    settings: tuple[str, ...]
    required: int
    summary: str


DRIVERS: dict[str, Driver] = {
    "simulated": Driver(
        "acquisition.cameras.simulated:SimulatedCamera",
        ("acquisition.simulation.settings:SimulationSettings", "acquisition.simulation.faults:FaultSettings"),
        1,
        "the simulated rig",
    ),
    "files": Driver(
        "acquisition.cameras.files.camera:FilesCamera",
        ("acquisition.cameras.files:FilesSettings",),
        1,
        "images, a lossless video or a .npy stack that another program recorded",
    ),
    "usb3vision": Driver(
        "acquisition.cameras.usb3vision.camera:Usb3VisionCamera",
        ("acquisition.cameras.usb3vision.camera:Usb3VisionSettings",),
        0,
        "any USB3 Vision camera, through pyusb",
    ),
    "pylon": Driver(
        "acquisition.cameras.pylon:PylonCamera",
        ("acquisition.cameras.pylon:PylonSettings",),
        0,
        "Basler cameras through the vendor's pypylon, an optional package",
    ),
    "aravis": Driver(
        "acquisition.cameras.aravis.camera:AravisCamera",
        ("acquisition.cameras.aravis.library:AravisSettings",),
        0,
        "GigE Vision and USB3 Vision cameras through libaravis and PyGObject, which are optional",
    ),
    "v4l2": Driver(
        "acquisition.cameras.v4l2.camera:V4l2Camera",
        ("acquisition.cameras.v4l2.source:V4l2Settings",),
        0,
        "UVC and other Video4Linux cameras; on Windows and macOS what OpenCV offers",
    ),
}


def make_camera(driver: str, *settings: BaseModel) -> Camera:
    """A camera that is not opened yet.

    Parameters
    ----------
    driver
        A key of `DRIVERS`.
    settings
        The driver's own settings, instances of the models that `Driver.settings` names.

    Raises
    ------
    ConfigurationError
        Unknown driver, or settings that are another driver's.
    """
    entry = find_driver(driver)
    models = settings_models(driver)
    if not entry.required <= len(settings) <= len(models) or not all(
        isinstance(value, model) for value, model in zip(settings, models, strict=False)
    ):
        wanted = ", ".join(model.__name__ for model in models)
        given = ", ".join(type(value).__name__ for value in settings) or "nothing"
        raise ConfigurationError(f"camera driver {driver!r} takes {wanted}; {given} was given")
    return cast(Camera, _load(entry.factory)(*settings))


def settings_models(driver: str) -> tuple[type[BaseModel], ...]:
    """Models of the settings that a driver takes."""
    return tuple(cast(type[BaseModel], _load(name)) for name in find_driver(driver).settings)


def find_driver(driver: str) -> Driver:
    """Entry of the dictionary; ConfigurationError lists those there are."""
    if driver not in DRIVERS:
        raise ConfigurationError(
            f"camera.driver = {driver!r}: no such driver; there are {', '.join(sorted(DRIVERS))}"
        )
    return DRIVERS[driver]


def _load(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)
