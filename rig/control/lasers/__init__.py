"""Laser drivers, one file per family, and the registry with their names in the configuration."""

import importlib
from collections.abc import Callable
from typing import Literal, cast

from rig.control.lasers.drivers import LASERS
from rig.control.lasers.laser import Laser, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.settings import LaserSettings


def make_laser(settings: LaserSettings) -> Laser | None:
    """The driver of a laser with a serial port, not opened yet; None for "none" and "controller"."""
    if settings.kind not in LASERS:
        return None
    return _driver(settings.kind)(settings)


def off_line(settings: LaserSettings) -> bytes | None:
    """The bytes that switch a laser with a port of its own off; None for "none" and "controller"."""
    if settings.kind not in LASERS:
        return None
    driver = _driver(settings.kind)
    return cast(bytes, driver.off_command.encode("ascii") + driver.terminator)  # type: ignore[attr-defined]


def laser_unit(kind: str) -> Literal["w", "a"]:
    """Whether a laser is set in watts or in amperes; one that the controller feeds in watts."""
    return cast(Literal["w", "a"], getattr(_driver(kind), "unit", "w")) if kind in LASERS else "w"


def _driver(kind: str) -> Callable[[LaserSettings], Laser]:
    module, _, name = LASERS[kind].partition(":")
    return cast(Callable[[LaserSettings], Laser], getattr(importlib.import_module(module), name))
