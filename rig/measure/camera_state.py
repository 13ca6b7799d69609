"""State of the camera for the record: its own features at start and end, its temperature on the way."""

import json
import logging
import threading
from typing import Final

from acquisition.camera import Camera, HasFeatures
from acquisition.record.topics import CameraTemperature
from processing.errors import DeviceError

_log = logging.getLogger(__name__)
_TEMPERATURES: Final = ("DeviceTemperature", "TemperatureAbs")
"""Features with the temperature inside the camera in degrees Celsius, by what different makers call it."""


def features_json(camera: Camera) -> bytes:
    """All features of the camera that can be read now, as JSON; empty for a camera that has none."""
    if not isinstance(camera, HasFeatures):
        return b""
    try:
        return json.dumps(camera.feature_values(), indent=1).encode()
    except DeviceError as refused:
        _log.warning("the camera's features cannot be read for the record: %s", refused)
        return b""


class TemperatureWatch:
    """Reads the camera's temperature every `period_s`, in a thread, because a camera may answer late.

    A camera that does not say its temperature is asked once.
    """

    def __init__(self, camera: Camera, period_s: float = 10.0) -> None:
        self._camera = camera
        self._period_s = period_s
        self._ended = threading.Event()
        self._reading: float | None = None
        self._thread = threading.Thread(target=self._watch, name="camera temperature", daemon=True)
        self._thread.start()

    def take(self, time_ns: int) -> CameraTemperature | None:
        """The reading since the last call, if there is one; never blocks."""
        reading, self._reading = self._reading, None
        return None if reading is None else CameraTemperature(time_ns, reading)

    def close(self) -> None:
        """Read no more; does not wait for a reading that is under way."""
        self._ended.set()

    def _watch(self) -> None:
        names = self._read(_TEMPERATURES)
        while names and not self._ended.wait(self._period_s):
            names = self._read(names)

    def _read(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Read the first of these features that the camera has; returns those to read the next time."""
        if not isinstance(self._camera, HasFeatures):
            return ()
        for name in names:
            try:
                value = self._camera.feature_value(name)
            except DeviceError:
                return names  # unplugged, perhaps for a while
            if value is not None:
                self._reading = float(value)
                return (name,)
        return ()
