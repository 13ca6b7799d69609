"""Laser drivers, one file a family, and the table by which a configuration names them."""

from collections.abc import Callable

from processing.errors import ConfigurationError
from rig.control.lasers.cobolt import Cobolt
from rig.control.lasers.laser import Laser, LaserIdentity, LaserRefused, LaserState
from rig.control.lasers.ldc500 import Ldc500
from rig.control.lasers.obis import Obis
from rig.control.lasers.thorlabs4000 import Thorlabs4000
from rig.control.settings import LaserSettings

LASERS: dict[str, Callable[[LaserSettings], Laser]] = {
    "thorlabs4000": Thorlabs4000,
    "obis": Obis,
    "ldc500": Ldc500,
    "cobolt": Cobolt,
}


def make_laser(settings: LaserSettings) -> Laser | None:
    """The laser with a port of its own; None for kind none and controller, which have no driver here."""
    if settings.kind in ("none", "controller"):
        return None
    if settings.kind not in LASERS:
        raise ConfigurationError(
            f"laser.kind {settings.kind!r} is unknown; one of {', '.join(sorted(LASERS))}"
        )
    return LASERS[settings.kind](settings)


__all__ = ["LASERS", "Laser", "LaserIdentity", "LaserRefused", "LaserState", "make_laser"]
