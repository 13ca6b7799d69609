"""Laser drivers, one file a family, and the registry by which a configuration names them."""

import importlib
from typing import cast

from rig.control.lasers.drivers import LASERS
from rig.control.lasers.laser import Laser, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.settings import LaserSettings


def make_laser(settings: LaserSettings) -> Laser | None:
    """The laser with a port of its own, not opened yet; None for the kinds that have no driver here."""
    if settings.kind not in LASERS:
        return None
    module, _, name = LASERS[settings.kind].partition(":")
    return cast(Laser, getattr(importlib.import_module(module), name)(settings))


__all__ = ["LASERS", "Laser", "LaserIdentity", "LaserRefused", "LaserSettings", "LaserState", "make_laser"]
