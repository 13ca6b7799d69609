"""Camera features used by the rig, through pylon's nodes."""

from contextlib import suppress
from typing import Any, Final

from acquisition.camera import CameraSettings, FeatureValue
from acquisition.cameras import wiring
from acquisition.cameras.preparation import GenicamFeatures, Quantity
from processing.errors import DeviceError
from processing.ticks import NS_PER_S

_NAMES: Final[dict[Quantity, tuple[str, ...]]] = {
    "exposure_us": ("ExposureTime", "ExposureTimeAbs"),
    "gain_db": ("Gain",),
    "frame_rate_hz": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
}
_TICKS_PER_S: Final = "GevTimestampTickFrequency"


class PylonFeatures(GenicamFeatures):
    """Features of an open camera; `camera` is pylon's object, `name` the camera's in messages."""

    def __init__(self, camera: Any, name: str) -> None:
        super().__init__(name)
        self._camera = camera
        self._nodes = camera.GetNodeMap()

    # ---- as GenicamFeatures

    def writable(self, feature: str) -> bool:
        node = self.node(feature)
        return node is not None and bool(node.IsWritable())

    def choices(self, feature: str) -> tuple[str, ...]:
        return tuple(getattr(self.node(feature), "Symbolics", ()))

    def read(self, feature: str) -> FeatureValue | None:
        node = self.node(feature)
        if node is None or not node.IsReadable():
            return None
        value: FeatureValue = node.Value
        return value

    def write(self, feature: str, value: FeatureValue) -> None:
        node = self.node(feature)
        if hasattr(node, "Execute"):
            node.Execute()
        else:
            node.FromString(str(value).lower() if isinstance(value, bool) else str(value))

    def set_feature(self, name: str, value: FeatureValue) -> None:
        if self.node(name) is None:
            raise DeviceError(f"{self.name}: has no feature {name}; leave camera.features.{name} out")
        self.write(name, value)

    def shown(self, name: str) -> FeatureValue:
        return str(self.node(name).ToString())

    def number(self, key: Quantity) -> float | None:
        node = self.node(*_NAMES[key])
        return None if node is None or not node.IsReadable() else float(node.Value)

    def set_number(self, key: Quantity, wanted: float) -> None:
        node = self.node(*_NAMES[key])
        if key == "frame_rate_hz" and self.node(self.rate_switch) is not None:
            self.write(self.rate_switch, True)
        if node is None:
            raise DeviceError(f"{self.name}: has no {_NAMES[key][0]}; leave camera.{key} out")
        self._check(key, wanted, node.Min, node.Max)
        node.Value = wanted

    def region(self) -> tuple[int, int, int, int]:
        camera = self._camera
        x, y, width_px, height_px = camera.OffsetX, camera.OffsetY, camera.Width, camera.Height
        return int(x.Value), int(y.Value), int(width_px.Value), int(height_px.Value)

    def set_region(self, asked: CameraSettings) -> None:
        camera = self._camera
        for key, start, length, offset, size in (
            ("width_px", asked.offset_x_px, asked.width_px, camera.OffsetX, camera.Width),
            ("height_px", asked.offset_y_px, asked.height_px, camera.OffsetY, camera.Height),
        ):
            if start is None and length is None:
                continue
            start = int(offset.Value) if start is None else start
            length = int(size.Value) if length is None else length
            self._check_end(key, start + length, int(size.Max) + int(offset.Value))
            offset.Value = offset.Min
            size.Value = length
            offset.Value = start

    def format_name(self) -> str:
        return str(self._camera.PixelFormat.Value)

    def offered_formats(self) -> list[str]:
        # pylon makes arrays of whole words only
        return [name for name in self._camera.PixelFormat.Symbolics if not name.endswith(("p", "Packed"))]

    def set_format_name(self, name: str) -> None:
        self._camera.PixelFormat.Value = name

    # ---- for the driver

    def node(self, *names: str) -> Any:
        """The first of these features that the camera has, as pylon's node; None if it has none of them."""
        for name in names:
            node = self._nodes.GetNode(name)
            # newer versions return something that stands for a missing feature
            if node is not None and node.IsValid():
                return node
        return None

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        """All features that can be read now; `error` is raised by pylon for those that cannot."""
        wiring.latch_clock_state(self)
        found: dict[str, FeatureValue] = {}
        for node in self._nodes.GetNodes():
            if node.IsReadable() and hasattr(node, "ToString") and not hasattr(node, "Features"):
                # some features say that they can be read, and fail
                with suppress(error):
                    found[node.GetNode().GetName()] = str(node.ToString())
        return found

    def tick_ns(self) -> float:
        """Length of a tick in ns: USB cameras count nanoseconds, GigE cameras report their tick frequency,
        which another clock changes.
        """
        per_s = self.read(_TICKS_PER_S)
        return NS_PER_S / float(per_s) if per_s else 1.0
