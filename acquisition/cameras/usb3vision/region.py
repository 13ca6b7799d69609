"""Size and offset of a camera's frames on its sensor."""

from typing import Any, Protocol

from acquisition.camera import CameraSettings
from acquisition.cameras.usb3vision.genapi.node_map import NodeMap
from processing.errors import DeviceError


class FeatureAccess(Protocol):
    """What is needed here of `features.Features`."""

    nodes: NodeMap

    def find(self, name: str) -> str | None:
        """The name of the feature in this camera."""
        ...

    def get(self, name: str) -> Any:
        """Value of a feature."""
        ...

    def get_if_readable(self, name: str) -> Any | None:
        """Value of a feature; None if it cannot be read."""
        ...

    def set(self, name: str, value: Any) -> Any:
        """Set a feature."""
        ...


def sensor_size(features: FeatureAccess, size: str) -> int:
    """Number of columns (`size` "Width") or rows ("Height") of the sensor that can be read out."""
    for name in (f"{size}Max", f"Sensor{size}"):
        value = features.get_if_readable(name) if features.find(name) is not None else None
        if value:
            offset = features.get_if_readable("OffsetX" if size == "Width" else "OffsetY") or 0
            return max(int(value), int(features.get(size)) + int(offset))
    largest = features.nodes.node(size).maximum()
    return int(largest if largest is not None else features.get(size))


def _check_region(
    features: FeatureAccess, size: str, offset: str, wanted_size: int | None, wanted_offset: int | None
) -> None:
    end = (wanted_size or features.get(size)) + (wanted_offset or 0)
    sensor = sensor_size(features, size)
    if wanted_offset and end > sensor:
        raise DeviceError(
            f"{features.nodes.name}: {size} {end - wanted_offset} at {offset} {wanted_offset} reaches {end}; "
            f"the sensor has {sensor}. Ask for less"
        )


def set_region(features: FeatureAccess, settings: CameraSettings) -> None:
    """Set size and offset of the region, in the order in which the limits allow it: they limit each
    other.
    """
    for size, offset, wanted_size, wanted_offset in (
        ("Width", "OffsetX", settings.width_px, settings.offset_x_px),
        ("Height", "OffsetY", settings.height_px, settings.offset_y_px),
    ):
        _check_region(features, size, offset, wanted_size, wanted_offset)
        has_offset = features.find(offset) is not None and features.nodes.node(offset).access().writable
        if wanted_size is not None and features.get(size) != wanted_size:
            before = features.get(offset) if has_offset else 0
            if has_offset and before:
                features.set(offset, 0)  # the old offset may not allow a size that fits at the new one
            try:
                features.set(size, wanted_size)
            except DeviceError:
                if has_offset and before:
                    features.set(offset, before)
                raise
            if wanted_offset is None and before:
                features.set(offset, min(before, int(features.nodes.node(offset).maximum() or 0)))
        if wanted_offset is not None and (has_offset or wanted_offset):
            features.set(offset, wanted_offset)
