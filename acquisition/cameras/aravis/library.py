"""The library libaravis through PyGObject, its cameras' features, and its buffers as frames."""

import time
import warnings
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from acquisition.camera import FeatureValue, Frame, PluggedCamera
from acquisition.cameras.genicam import GenicamFeatures
from acquisition.cameras.genicam_access import NumericFeature
from acquisition.cameras.pixel_formats import ExpectedFrames
from acquisition.cameras.reading import check_range, only_camera
from acquisition.frames.losses import BlockNumbers, LossCause
from processing.errors import DeviceError


class Library(NamedTuple):
    """The module of libaravis and the class of its errors, from PyGObject."""

    aravis: Any
    error: type[Exception]


def load_library() -> Library:
    """Load libaravis 0.8 through PyGObject. Raises DeviceError, which names the missing part."""
    try:
        with warnings.catch_warnings():
            # PyGObject's importer uses a deprecated interface, about which Python warns
            warnings.simplefilter("ignore")
            import gi

            gi.require_version("Aravis", "0.8")
            from gi.repository import Aravis, GLib
    except (ImportError, ValueError) as error:
        raise DeviceError(
            "camera.driver = 'aravis' needs libaravis 0.8 and PyGObject (Debian: apt install "
            "gir1.2-aravis-0.8 python3-gi, and an environment made with --system-site-packages); "
            f"here: {error}"
        ) from None
    return Library(Aravis, GLib.Error)


def find_cameras() -> dict[str, PluggedCamera]:
    """All cameras that libaravis finds, by its ids; the search takes about a second."""
    aravis = load_library().aravis
    aravis.update_device_list()
    return {
        aravis.get_device_id(index): PluggedCamera(
            "aravis",
            f"{aravis.get_device_vendor(index) or ''} {aravis.get_device_model(index) or ''}".strip(),
            aravis.get_device_serial_nbr(index) or "",
            aravis.get_device_address(index) or aravis.get_device_physical_id(index) or "",
        )
        for index in range(aravis.get_n_devices())
    }


def list_cameras() -> list[PluggedCamera]:
    """All cameras found by libaravis, for ``rig doctor``."""
    return list(find_cameras().values())


def find_camera(serial: str | None) -> tuple[str, str]:
    """Id, and name in messages, of the camera with this serial number or id; None: the only one connected."""
    cameras = [
        (f"aravis camera {camera.name} (serial {camera.serial or 'unknown'})", camera.serial, identity)
        for identity, camera in find_cameras().items()
    ]
    names = {identity: name for name, _, identity in cameras}
    identity = serial if serial in names else only_camera("aravis", cameras, serial)
    return identity, names[identity]


_FUNCTION_NAMES: Final[dict[NumericFeature, str]] = {
    "exposure_us": "exposure_time",
    "gain_db": "gain",
    "frame_rate_hz": "frame_rate",
}
"""Names of the quantities in the names of libaravis's functions."""


class AravisFeatures(GenicamFeatures):
    """Features of an open camera; `camera` is libaravis's object."""

    def __init__(self, camera: Any, aravis: Any, name: str) -> None:
        super().__init__(name)
        self.camera = camera
        self._aravis = aravis

    def release(self) -> list[Any]:
        """Hand over libaravis's camera in a list, because dropping the last reference to it may block."""
        camera, self.camera = self.camera, None
        return [camera]

    # ---- the methods of GenicamFeatures

    def has(self, feature: str) -> bool:
        return self._node(feature) is not None

    def writable(self, feature: str) -> bool:
        if not self.camera.is_feature_available(feature):
            return False
        node = self._node(feature)
        read_only = node.get_actual_access_mode() == self._aravis.GcAccessMode.RO
        return not (read_only or node.is_locked())

    def choices(self, feature: str) -> tuple[str, ...]:
        node = self._node(feature)
        if not isinstance(node, self._aravis.GcEnumeration) or not node.is_available():
            return ()
        return tuple(self.camera.dup_available_enumerations_as_strings(feature))

    def limits(self, feature: str) -> tuple[float | None, float | None]:
        node = self._node(feature)
        numbers = self._aravis.GcInteger, self._aravis.GcFloat
        return (node.get_min(), node.get_max()) if isinstance(node, numbers) else (None, None)

    def read(self, feature: str) -> FeatureValue | None:
        available = self.camera.is_feature_available(feature)
        return str(self._node(feature).get_value_as_string()) if available else None

    def write(self, feature: str, value: FeatureValue) -> None:
        if isinstance(self._node(feature), self._aravis.GcCommand):
            self.camera.execute_command(feature)
            return
        text = str(value).lower() if isinstance(value, bool) else str(value)
        self.camera.get_device().set_features_from_string(f"{feature}={text}")

    # libaravis knows the makers' own names of these quantities, and how their cameras want them to be set

    def number(self, key: NumericFeature) -> float | None:
        if not getattr(self.camera, f"is_{_FUNCTION_NAMES[key]}_available")():
            return None
        return float(getattr(self.camera, f"get_{_FUNCTION_NAMES[key]}")())

    def set_number(self, key: NumericFeature, value: float) -> None:
        if not getattr(self.camera, f"is_{_FUNCTION_NAMES[key]}_available")():
            raise DeviceError(f"{self.name}: does not allow it to be set; leave camera.{key} out")
        # libaravis clips values out of range without an error
        bounds = getattr(self.camera, f"get_{_FUNCTION_NAMES[key]}_bounds")()
        check_range(self.name, key, value, *bounds)
        getattr(self.camera, f"set_{_FUNCTION_NAMES[key]}")(value)

    def values(self, error: type[Exception]) -> dict[str, FeatureValue]:
        values: dict[str, FeatureValue] = {}
        names = ["Root"]
        genicam = self.camera.get_device().get_genicam()
        while names:
            name = names.pop()
            node = genicam.get_node(name)
            if isinstance(node, self._aravis.GcCategory):
                names += node.get_features()
                continue
            with suppress(error, AttributeError):
                if not isinstance(node, self._aravis.GcCommand) and node.is_available():
                    values[name] = str(node.get_value_as_string())
        return values

    def _node(self, feature: str) -> Any:
        """libaravis's node of a feature; None if the camera does not have it."""
        return self.camera.get_device().get_feature(feature)


class Underruns:
    """Detects that libaravis lacked free buffers, by its count of such events, which may run ahead."""

    def __init__(self) -> None:
        self._last_arrived_ns = -1
        # (time of fetching a frame, libaravis's count at that time)
        self._samples = deque([(-1, 0)])

    def occurred(self, arrived_ns: int, fetched_ns: int, count: int) -> bool:
        """Whether buffers lacked since the last frame, by libaravis's count when this one was fetched."""
        samples = self._samples
        while len(samples) > 1 and samples[1][0] <= self._last_arrived_ns:
            samples.popleft()
        lacked_buffers = count > samples[0][1]
        samples.append((fetched_ns, count))
        self._last_arrived_ns = arrived_ns
        return lacked_buffers


@dataclass(slots=True)
class BufferReader:
    """Converts the buffers of one acquisition into frames.

    Damaged frames count as incomplete, other missing ones as lost by the host if libaravis lacked free
    buffers at that time, otherwise as lost on the bus: cameras do not report those that they lost themselves.
    """

    aravis: Any
    """The library's module."""
    name: str
    expected: ExpectedFrames
    numbers: BlockNumbers
    _host_time_ns: int = field(default=0, init=False)
    _underruns: Underruns = field(default_factory=Underruns, init=False)

    def frame(self, buffer: Any, underruns: int) -> Frame | None:
        """The frame in a buffer; None if it is damaged or was delivered before.

        Raises DeviceError if the payload is not an image, or has padding that cannot be removed.
        """
        if buffer.get_status() != self.aravis.BufferStatus.SUCCESS:
            self.numbers.lost_parts += 1
            return None
        kinds = self.aravis.BufferPayloadType
        if buffer.get_payload_type() not in (kinds.IMAGE, kinds.EXTENDED_CHUNK_DATA):
            payload = buffer.get_payload_type().value_nick
            raise DeviceError(
                f"{self.name}: sends payload of type {payload}, not images; switch that off in the camera"
            )
        x_padding, _ = buffer.get_image_padding()
        expected = self.expected
        expected.refuse_padding(self.name, x_padding)
        data = buffer.get_data()
        if len(data) < expected.image_bytes(x_padding):
            self.numbers.lost_parts += 1
            return None
        now_ns = time.monotonic_ns()
        # libaravis states the arrival on the wall clock
        age_ns = min(max(time.time_ns() - buffer.get_system_timestamp(), 0), now_ns)
        arrived_ns = self._host_time_ns = max(self._host_time_ns, now_ns - age_ns)
        lacked_buffers = self._underruns.occurred(arrived_ns, now_ns, underruns)
        lost: LossCause = "dropped_by_host" if lacked_buffers else "dropped_by_bus"
        number = self.numbers.number(buffer.get_frame_id(), lost)
        if number is None:
            return None
        image = expected.image(np.frombuffer(data, np.uint8), x_padding)
        device_time_ns = buffer.get_timestamp() if expected.has_clock else -1
        return Frame(image, number, device_time_ns, arrived_ns)
