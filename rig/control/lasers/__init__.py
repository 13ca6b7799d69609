"""Laser drivers, one file per family."""

import importlib
from typing import cast

from rig.control.lasers.serial_laser import LaserIdentity, LaserRefused, LaserState, SerialLaser
from rig.control.lasers.settings import LASERS, LaserSettings


def make_laser(settings: LaserSettings) -> SerialLaser | None:
    """The driver of a laser with a serial port, not opened yet; None for "none" and "controller"."""
    return _driver(settings.kind)(settings) if settings.kind in LASERS else None


def off_bytes(settings: LaserSettings) -> bytes | None:
    """The bytes that switch a laser with a port of its own off; None for "none" and "controller"."""
    if settings.kind not in LASERS:
        return None
    driver = _driver(settings.kind)
    return driver.off_command.encode("ascii") + driver.terminator


def _driver(kind: str) -> type[SerialLaser]:
    module, _, name = LASERS[kind].partition(":")
    return cast(type[SerialLaser], getattr(importlib.import_module(module), name))
