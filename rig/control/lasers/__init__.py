"""Laser drivers, one file per family, and the registry with their names in the configuration."""

import importlib
from typing import cast

from rig.control.lasers.drivers import LASERS
from rig.control.lasers.laser import Laser, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.settings import LaserSettings


def make_laser(settings: LaserSettings) -> Laser | None:
    """The driver of a laser with a serial port, not opened yet; None for "none" and "controller"."""
    if settings.kind not in LASERS:
        return None
    module, _, name = LASERS[settings.kind].partition(":")
    return cast(Laser, getattr(importlib.import_module(module), name)(settings))


__all__ = ["LASERS", "Laser", "LaserIdentity", "LaserRefused", "LaserSettings", "LaserState", "make_laser"]
