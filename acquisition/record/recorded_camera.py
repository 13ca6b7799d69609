"""The camera in a record's metadata, whose values are texts: written here, and read back here alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from acquisition.camera import CameraInfo, ShutterKind

_SECTION = "camera"
_SIMULATED = "simulated"
"""Driver of the simulated rig (`acquisition.cameras.drivers`)."""


def camera_metadata(info: CameraInfo) -> dict[str, dict[str, str]]:
    """The section of the metadata that says what was measured with."""
    names = ("driver", "vendor", "model", "serial", "width_px", "height_px", "full_scale_dn", "has_clock")
    return {_SECTION: {name: str(getattr(info, name)) for name in (*names, "shutter")}}


@dataclass(frozen=True, slots=True)
class RecordedCamera:
    """What a record says of its camera; `has_clock` is None where it does not."""

    simulated: bool
    has_clock: bool | None
    shutter: ShutterKind

    @classmethod
    def of(cls, metadata: Mapping[str, Mapping[str, str]]) -> Self:
        """From the metadata of a record of any version or program."""
        camera = metadata.get(_SECTION, {})
        return cls(
            camera.get("driver") == _SIMULATED,
            {str(known): known for known in (True, False)}.get(camera.get("has_clock", "")),
            ShutterKind.of(camera.get("shutter", "")),
        )
