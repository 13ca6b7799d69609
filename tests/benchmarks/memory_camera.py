"""A camera that delivers drawn frames in real time from a ring of buffers, and loses what finds it full."""

import threading
import time
from collections import deque
from typing import Any

import numpy as np

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus, Frame, FrameTimeout
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.settings import OpticsTruth, SensorTruth, SimulationSettings

FULL_SCALE_DN = 255
RING_S = 0.1
"""What the buffers of a driver hold by default, at the rate of the frames."""


class MemoryCamera:
    """Frames that were drawn beforehand, due at a fixed rate by the host's clock.

    As with a driver, a frame that is due while all `buffers` hold frames which nobody has taken is lost, and
    counted. A frame's camera time is when it was due, its host time when it was taken.
    """

    def __init__(self, frames: list[np.ndarray[Any, Any]], rate_hz: float, duration_s: float) -> None:
        self._frames = frames
        self._period_ns = round(1e9 / rate_hz)
        self._count = round(duration_s * rate_hz)
        self._buffers = max(4, round(RING_S * rate_hz))
        self._filled: deque[int] = deque()
        self._next = 0
        self._lost = 0
        self._delivered = 0
        self._start_ns = 0
        self._stopped = threading.Event()
        self.late_ns: list[int] = []
        """Of each frame, how long it lay in its buffer."""

    def open(self) -> CameraInfo:
        ny, nx = self._frames[0].shape
        return CameraInfo("memory", "", "", "", nx, ny, FULL_SCALE_DN, True)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def start(self) -> None:
        self._start_ns = time.monotonic_ns()
        self._next = 0

    def read(self, timeout_s: float) -> Frame | None:
        deadline_ns = time.monotonic_ns() + round(timeout_s * 1e9)
        while not self._stopped.is_set():
            now_ns = time.monotonic_ns()
            self._expose(now_ns)
            if self._filled:
                return self._taken(self._filled.popleft(), now_ns)
            if self._next >= self._count:
                return None
            due_ns = self._start_ns + self._next * self._period_ns
            if due_ns > deadline_ns:
                raise FrameTimeout(f"memory camera: no frame within {timeout_s:g} s")
            time.sleep((due_ns - now_ns) * 1e-9)
        return None

    def _expose(self, now_ns: int) -> None:
        """Fill the buffers with what came until now; nobody has taken a frame meanwhile."""
        until = min((now_ns - self._start_ns) // self._period_ns + 1, self._count)
        kept = min(until - self._next, self._buffers - len(self._filled))
        self._filled.extend(range(self._next, self._next + kept))
        self._lost += until - self._next - kept
        self._next = until

    def _taken(self, number: int, now_ns: int) -> Frame:
        # there and back through the drawn swing, so that the spot never jumps
        turn = 2 * len(self._frames) - 2
        place = number % turn
        image = self._frames[place if place < len(self._frames) else turn - place]
        due_ns = self._start_ns + number * self._period_ns
        self._delivered += 1
        self.late_ns.append(now_ns - due_ns)
        return Frame(image, number, due_ns, now_ns)

    def stop(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        self._stopped.set()

    @property
    def status(self) -> CameraStatus:
        return CameraStatus(delivered=self._delivered, dropped_by_host=self._lost)


def drawn_frames(width: int, height: int, rate_hz: float, count: int) -> list[np.ndarray[Any, Any]]:
    """Half a swing across the sensor, drawn by the simulated rig."""
    settings = SimulationSettings(
        sensor=SensorTruth(width_px=width, height_px=height, bit_depth=8),
        optics=OpticsTruth(arm_m=1.0 * height / 640),
    )
    settings = settings.model_copy(
        update={"clock": settings.clock.model_copy(update={"frame_rate_hz": rate_hz})}
    )
    camera = SimulatedCamera(settings)
    camera.open()
    camera.start()
    frames = []
    for _ in range(count):
        frame = camera.read(5.0)
        assert frame is not None
        frames.append(frame.image)
    camera.close()
    return frames
