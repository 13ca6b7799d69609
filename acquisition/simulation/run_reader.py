"""Frames of one simulated run as a camera delivers them: in real time or on demand, with losses."""

import logging
import math
import threading
from collections.abc import Callable

from acquisition.camera import CameraLost, CameraStatus, Frame, FrameTimeout, Image
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.scene import PlannedFrames, Scene
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError
from processing.units import nanoseconds, seconds

_log = logging.getLogger(__name__)
CAMERA_NAME = "simulated camera"
_AHEAD_BYTES = 16 * 1024 * 1024
"""Memory of this size comes in large pages, whose first use costs little."""


class SimulatedFrames:
    """Delivers the frames of a run; `stop` may be called by another thread.

    Parameters
    ----------
    scene
        The run.
    block
        Number of frames that are calculated at once, before they are drawn.
    rate_hz
        Frame rate.
    clock_ns
        The host's monotonic clock.
    """

    def __init__(
        self,
        scene: Scene,
        block: int,
        settings: SimulationSettings,
        faults: FaultSettings,
        rate_hz: float,
        clock_ns: Callable[[], int],
    ) -> None:
        self._scene = scene
        self._settings = settings
        self._faults = faults
        self._rate_hz = rate_hz
        self._clock_ns = clock_ns
        self._block = block
        self._plan: PlannedFrames = scene.plan(block)
        self._ahead = 1 if settings.real_time else max(1, _AHEAD_BYTES // scene.image_bytes)
        self._drawn: dict[int, Image] = {}
        # the first drawing compiles: before the run's clock starts, and where no reader waits for a frame
        self._draw(0, 0)
        self._stopped = threading.Event()
        self._next = 0
        self._numbered_from = 0
        self._begin_ns = clock_ns()
        self._last_host_ns = 0
        self._delivered = 0
        self._dropped_by_camera = 0
        self._dropped_by_host = 0
        self._reconnects = 0
        self._unplug_at: float = _frame_at(faults.camera_unplugged_at_s, self._rate_hz)
        self._stall_at: float = _frame_at(faults.frames_stalled_at_s, self._rate_hz)
        self._stall_end: float = self._stall_at + math.ceil(faults.frames_stalled_duration_s * self._rate_hz)
        self._end: float = _frame_at(settings.max_duration_s, self._rate_hz)
        self.lost = False

    @property
    def running(self) -> bool:
        """Whether the run is neither stopped nor lost."""
        return not self._stopped.is_set() and not self.lost

    @property
    def stalled(self) -> bool:
        """Whether no frames come although the cable is plugged in; opening the camera again does not help."""
        return self._stall_at <= self._next < self._stall_end

    @property
    def status(self) -> CameraStatus:
        return CameraStatus(
            delivered=self._delivered,
            dropped_by_camera=self._dropped_by_camera,
            dropped_by_host=self._dropped_by_host,
            reconnects=self._reconnects,
        )

    def stop(self) -> None:
        self._stopped.set()

    def read(self, timeout_s: float) -> Frame | None:
        deadline_ns = self._clock_ns() + nanoseconds(timeout_s)
        stepped_s = 0.0
        while not self._stopped.is_set():
            if self.lost:
                raise CameraLost(f"{CAMERA_NAME}: is unplugged; plug it in, then open it again")
            frame = self._next
            if frame >= self._end:
                return None
            if frame >= self._unplug_at:
                self._lose()
                continue
            if self._settings.real_time:
                if not self._wait_for(frame, deadline_ns):
                    if self._stopped.is_set():
                        return None
                    raise FrameTimeout(f"{CAMERA_NAME}: no frame within {timeout_s:g} s")
                frame = self._skip_overrun(frame)
            if self._stall_at <= frame < self._stall_end:
                if self._settings.real_time:
                    self._pass_over(1)
                    continue
                silent_s = (self._stall_end - frame) / self._rate_hz
                if silent_s > timeout_s - stepped_s:
                    self._pass_over(math.ceil((timeout_s - stepped_s) * self._rate_hz))
                    raise FrameTimeout(f"{CAMERA_NAME}: no frame within {timeout_s:g} s")
                stepped_s += silent_s
                self._pass_over(int(self._stall_end) - frame)
                continue
            row = self._row(frame)
            if self._plan.dropped[row]:
                self._pass_over(1)
                continue
            return self._deliver(frame, row)
        return None

    def replug(self) -> None:
        """Allow that the camera is opened again; DeviceError if the cable is still unplugged."""
        back_s = self._faults.camera_replugged_at_s
        if back_s is None:
            raise DeviceError(f"{CAMERA_NAME}: is unplugged; plug it in")
        back = math.ceil(back_s * self._rate_hz)
        now = self._due(self._clock_ns()) if self._settings.real_time else max(back, self._next)
        if now < back:
            raise DeviceError(f"{CAMERA_NAME}: is unplugged; plug it in")
        self._unplug_at = math.inf
        self._next = max(self._next, now)

    def resume(self) -> None:
        """Continue the run; frames are numbered from 0 again."""
        if self._settings.real_time:
            self._next = max(self._next, self._due(self._clock_ns()))
        self._numbered_from = self._next
        self._reconnects += 1
        self.lost = False
        self._stopped.clear()

    def _lose(self) -> None:
        self.lost = True
        _log.warning("%s: unplugged at frame %d", CAMERA_NAME, self._next)

    def _due(self, now_ns: int) -> int:
        """Number of frames that the simulated camera has exposed by now."""
        return math.floor(seconds(now_ns - self._begin_ns) * self._rate_hz) + 1

    def _wait_for(self, frame: int, deadline_ns: int) -> bool:
        due_ns = self._begin_ns + nanoseconds(frame / self._rate_hz)
        while True:
            now_ns = self._clock_ns()
            if now_ns >= due_ns:
                return True
            if now_ns >= deadline_ns or self._stopped.wait(seconds(min(due_ns, deadline_ns) - now_ns)):
                return False

    def _skip_overrun(self, frame: int) -> int:
        """Lose the oldest frames if the reader is late by more than the buffer holds; the next frame."""
        late = self._due(self._clock_ns()) - frame - self._settings.buffer_frames
        if late > 0:
            self._next += late
            self._dropped_by_host += late
        return self._next

    def _pass_over(self, count: int) -> None:
        self._next += count
        self._dropped_by_camera += count

    def _row(self, frame: int) -> int:
        while frame >= self._plan.first + self._block:
            self._plan = self._scene.plan(self._block)
            self._drawn.clear()
        return frame - self._plan.first

    def _draw(self, frame: int, row: int) -> None:
        """Draw the image of a row of the plan, and on demand the next ones with it."""
        plan = self._plan
        rows = slice(row, row + self._ahead)
        images = self._scene.draw_frames(
            frame, plan.x_px[rows], plan.y_px[rows], plan.power[rows], plan.slope[rows], plan.beam_px[rows]
        )
        self._drawn = dict(enumerate(images, start=row))

    def _image(self, frame: int, row: int) -> Image:
        if row not in self._drawn:
            self._draw(frame, row)
        return self._drawn.pop(row)

    def _deliver(self, frame: int, row: int) -> Frame:
        plan = self._plan
        image = self._image(frame, row)
        host_ns = self._clock_ns()
        if self._settings.real_time:
            # a frame in the buffer arrived at its exposure, before it was read
            arrived_ns = self._begin_ns + nanoseconds(frame / self._rate_hz)
            host_ns = max(arrived_ns, self._last_host_ns + 1)
        self._last_host_ns = host_ns
        self._next = frame + 1
        self._delivered += 1
        device_ns = int(plan.device_time_ns[row])
        if self._settings.real_time:
            device_ns = self._by_faulty_clock(frame, device_ns)
        return Frame(image, frame - self._numbered_from, device_ns, host_ns)

    def _by_faulty_clock(self, frame: int, device_ns: int) -> int:
        faults = self._faults
        if frame >= _frame_at(faults.clock_steps_at_s, self._rate_hz):
            device_ns += nanoseconds(faults.clock_step_s)
        if faults.clock_bits is not None:
            device_ns %= 1 << faults.clock_bits
        return 0 if frame == _frame_at(faults.clock_zero_at_s, self._rate_hz) else device_ns


def _frame_at(time_s: float | None, rate_hz: float) -> float:
    """Number of the first frame at or after a time; inf for None (never)."""
    return math.inf if time_s is None else float(math.ceil(time_s * rate_hz - 1e-9))
