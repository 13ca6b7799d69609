"""The simulated rig as a `Camera`, in real time, or in simulated time with frames on demand."""

import logging
import math
import threading
import time

from acquisition.camera import (
    BITS_OF_FORMAT,
    FORMAT_OF_BITS,
    CameraInfo,
    CameraLost,
    CameraSettings,
    CameraStatus,
    Frame,
    FrameTimeout,
    Image,
    refuse_unsupported,
)
from acquisition.cameras.reading import check_end, check_range
from acquisition.simulation.inputs import FaultSettings, RigInputs
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError
from processing.units import nanoseconds, seconds

_log = logging.getLogger(__name__)
_NAME = "simulated camera"
_DRAWN_BYTES = 16 * 1024 * 1024
"""Memory of the images that are drawn at once; the system gives so much in large pages, which is fast."""


class SimulatedCamera:
    """A `Camera` that observes the simulated pendulum.

    Each `start` after a `stop` begins a new run with a new release and new noise. A `start` after a loss of
    the camera (`FaultSettings`) continues the same run. In simulated time, waiting takes no real time;
    during a stall or while the camera is unplugged, simulated time passes.

    Parameters
    ----------
    settings, faults
        True values of the rig, and the faults to simulate.
    inputs
        Outputs of a controller that act on the rig; None: the laser is on, release as in the settings.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        faults: FaultSettings | None = None,
        inputs: RigInputs | None = None,
    ) -> None:
        self._settings = settings
        self._faults = FaultSettings() if faults is None else faults
        self._inputs = inputs
        self._opened = False
        self._reader: _SimulatedFrames | None = None
        self._runs = settings.first_run
        sensor = settings.sensor
        self._sensor_settings = SensorSettings(
            offset_x_px=0,
            offset_y_px=0,
            width_px=sensor.width_px,
            height_px=sensor.height_px,
            bit_depth=sensor.bit_depth,
            exposure_us=sensor.exposure_us,
            gain_db=0.0,
            frame_rate_hz=settings.clock.frame_rate_hz,
        )

    def open(self) -> CameraInfo:
        """Ready immediately. Raises DeviceError while the simulated camera is unplugged."""
        if self._reader is not None and self._reader.lost:
            self._reader.replug()
        if self._settings.real_time and self._reader is None:
            # the first frame compiles kernels, which takes longer than a watchdog waits once the light is on
            self._frames(None)
        self._opened = True
        sensor = self._settings.sensor
        return CameraInfo(
            driver="simulated",
            vendor="optical-pendulum-rig",
            model="simulated rig",
            serial=f"seed-{self._settings.seed}",
            width_px=sensor.width_px,
            height_px=sensor.height_px,
            full_scale_dn=2**self._sensor_settings.bit_depth - 1,
            has_clock=True,
            stamped="middle",
            shutter="Rolling" if sensor.row_time_s else "Global",
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; None keeps a value. Raises DeviceError for values the sensor does not support."""
        self._must_be_open()
        if self._reader is not None and self._reader.running:
            raise DeviceError(f"{_NAME}: cannot be configured while frames are running; stop it first")
        refuse_unsupported(settings, _NAME, supported=("binning",))
        binning = settings.binning or self._sensor_settings.binning
        sensor = self._settings.sensor
        width_px, height_px = sensor.width_px // binning, sensor.height_px // binning
        if binning != self._sensor_settings.binning:
            self._sensor_settings = self._sensor_settings._replace(
                binning=binning, offset_x_px=0, offset_y_px=0, width_px=width_px, height_px=height_px
            )
        requested = {
            name: value
            for name in SensorSettings._fields
            if (value := getattr(settings, name, None)) is not None
        }
        if settings.pixel_format is not None:
            requested["bit_depth"] = BITS_OF_FORMAT[settings.pixel_format]
        new = self._sensor_settings._replace(**requested)
        if settings.width_px is not None and settings.offset_x_px is None:
            new = new._replace(offset_x_px=min(new.offset_x_px, max(width_px - new.width_px, 0)))
        if settings.height_px is not None and settings.offset_y_px is None:
            new = new._replace(offset_y_px=min(new.offset_y_px, max(height_px - new.height_px, 0)))
        check_end(_NAME, "width_px", new.offset_x_px, new.width_px, width_px)
        check_end(_NAME, "height_px", new.offset_y_px, new.height_px, height_px)
        check_range(_NAME, "gain_db", new.gain_db, 0, 48)
        check_range(_NAME, "frame_rate_hz", new.frame_rate_hz, 0, 100_000)
        if new.exposure_us * new.frame_rate_hz > 1e6:
            raise DeviceError(
                f"{_NAME}: exposure_us = {new.exposure_us:g} is longer than a frame at "
                f"frame_rate_hz = {new.frame_rate_hz:g}; at most {1e6 / new.frame_rate_hz:.6g} fit"
            )
        self._sensor_settings = new
        return CameraSettings(
            pixel_format=FORMAT_OF_BITS[new.bit_depth],
            **{name: value for name, value in new._asdict().items() if name != "bit_depth"},
        )

    def start(self) -> None:
        """Begin a run, or continue the run in which the camera was lost or silent."""
        self._must_be_open()
        if self._reader is not None:
            if self._reader.running:
                raise DeviceError(f"{_NAME}: is running already; stop it first")
            if self._reader.lost or self._reader.stalled:
                self._reader.resume()
                return
        self._reader = self._frames(self._inputs)
        self._runs += 1

    def _frames(self, inputs: RigInputs | None) -> "_SimulatedFrames":
        """The frames of the next run; the first is drawn already."""
        scene = Scene(self._settings, self._faults, self._sensor_settings, self._runs, inputs)
        return _SimulatedFrames(scene, self._settings, self._faults, self._sensor_settings.frame_rate_hz)

    def read(self, timeout_s: float) -> Frame | None:
        reader = self._reader
        if reader is None:
            self._must_be_open()
            raise DeviceError(f"{_NAME}: is not started; call start before read")
        return reader.read(timeout_s)

    def stop(self) -> None:
        if self._reader is not None:
            self._reader.stop()

    def close(self) -> None:
        self.stop()
        self._opened = False

    @property
    def run(self) -> int:
        """Number of the present run, or of the last one."""
        return max(self._runs - 1, self._settings.first_run)

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        return CameraStatus() if self._reader is None else self._reader.status

    def _must_be_open(self) -> None:
        if not self._opened:
            raise DeviceError(f"{_NAME}: is not open; call open first")


class _SimulatedFrames:
    """Delivers the frames of a run; `stop` may be called by another thread."""

    def __init__(
        self, scene: Scene, settings: SimulationSettings, faults: FaultSettings, rate_hz: float
    ) -> None:
        self._scene = scene
        self._settings = settings
        self._faults = faults
        self._rate_hz = rate_hz
        self._plan = scene.plan(scene.block_frames)
        self._draw_count = 1 if settings.real_time else max(1, _DRAWN_BYTES // scene.image_bytes)
        self._drawn: dict[int, Image] = {}
        # the first image compiles kernels, so it is drawn before the run's clock starts and a reader waits
        self._draw(0)
        self._stopped = threading.Event()
        self._next = 0
        self._first_number = 0
        self._begin_ns = time.monotonic_ns()
        self._last_host_ns = 0
        self.status = CameraStatus()
        self._unplug_frame = _frame_at(faults.camera_unplugged_at_s, self._rate_hz)
        self._stall_frame = _frame_at(faults.frames_stalled_at_s, self._rate_hz)
        self._stall_end_frame = self._stall_frame + math.ceil(faults.frames_stalled_duration_s * rate_hz)
        self._end_frame = _frame_at(settings.max_duration_s, self._rate_hz)
        self.lost = False

    @property
    def running(self) -> bool:
        """Whether the run is neither stopped nor lost."""
        return not self._stopped.is_set() and not self.lost

    @property
    def stalled(self) -> bool:
        """Whether no frames come although the camera is plugged in, which opening it again does not cure."""
        return self._stall_frame <= self._next < self._stall_end_frame

    def stop(self) -> None:
        self._stopped.set()

    def read(self, timeout_s: float) -> Frame | None:
        deadline_ns = time.monotonic_ns() + nanoseconds(timeout_s)
        passed_s = 0.0
        while not self._stopped.is_set():
            if self.lost:
                raise CameraLost(f"{_NAME}: is unplugged; plug it in, then open it again")
            frame = self._next
            if frame >= self._end_frame:
                return None
            if frame >= self._unplug_frame:
                self.lost = True
                _log.warning("%s: unplugged at frame %d", _NAME, frame)
                continue
            if self._settings.real_time:
                if not self._wait_for(frame, deadline_ns):
                    if self._stopped.is_set():
                        return None
                    raise FrameTimeout(f"{_NAME}: no frame within {timeout_s:g} s")
                # a reader that is later than the buffer holds loses the oldest frames
                late = self._due(time.monotonic_ns()) - frame - self._settings.buffer_frames
                if late > 0:
                    self._next = frame = frame + late
                    self.status += CameraStatus(dropped_by_host=late)
            if self._stall_frame <= frame < self._stall_end_frame:
                if self._settings.real_time:
                    self._skip(1)
                    continue
                silent_s = (self._stall_end_frame - frame) / self._rate_hz
                if silent_s > timeout_s - passed_s:
                    self._skip(math.ceil((timeout_s - passed_s) * self._rate_hz))
                    raise FrameTimeout(f"{_NAME}: no frame within {timeout_s:g} s")
                passed_s += silent_s
                self._skip(int(self._stall_end_frame) - frame)
                continue
            while frame >= self._plan.first + self._scene.block_frames:
                self._plan = self._scene.plan(self._scene.block_frames)
                self._drawn.clear()
            index = frame - self._plan.first
            if self._plan.dropped[index]:
                self._skip(1)
                continue
            return self._deliver(frame, index)
        return None

    def replug(self) -> None:
        """Allow the camera to be opened again; DeviceError if it is still unplugged."""
        back_s = self._faults.camera_replugged_at_s
        if back_s is None:
            raise DeviceError(f"{_NAME}: is unplugged; plug it in")
        replug_frame = math.ceil(back_s * self._rate_hz)
        due = self._due(time.monotonic_ns()) if self._settings.real_time else max(replug_frame, self._next)
        if due < replug_frame:
            raise DeviceError(f"{_NAME}: is unplugged; plug it in")
        self._unplug_frame = math.inf
        self._next = max(self._next, due)

    def resume(self) -> None:
        """Continue the run; frames are numbered from 0 again."""
        if self._settings.real_time:
            self._next = max(self._next, self._due(time.monotonic_ns()))
        self._first_number = self._next
        self.status += CameraStatus(reconnects=1)
        self.lost = False
        self._stopped.clear()

    def _due(self, now_ns: int) -> int:
        """Number of frames that the simulated camera has exposed by the host's time `now_ns`."""
        return math.floor(seconds(now_ns - self._begin_ns) * self._rate_hz) + 1

    def _wait_for(self, frame: int, deadline_ns: int) -> bool:
        due_ns = self._begin_ns + nanoseconds(frame / self._rate_hz)
        while True:
            now_ns = time.monotonic_ns()
            if now_ns >= due_ns:
                return True
            if now_ns >= deadline_ns or self._stopped.wait(seconds(min(due_ns, deadline_ns) - now_ns)):
                return False

    def _skip(self, count: int) -> None:
        """Lose the next frames in the camera."""
        self._next += count
        self.status += CameraStatus(dropped_by_camera=count)

    def _draw(self, index: int) -> None:
        """Draw the image of a frame of the plan; in simulated time also the following ones."""
        images = self._scene.draw(self._plan, slice(index, index + self._draw_count))
        self._drawn = dict(enumerate(images, start=index))

    def _deliver(self, frame: int, index: int) -> Frame:
        if index not in self._drawn:
            self._draw(index)
        image = self._drawn.pop(index)
        host_ns = time.monotonic_ns()
        if self._settings.real_time:
            # a frame in the buffer arrived at its exposure, before it was read
            arrived_ns = self._begin_ns + nanoseconds(frame / self._rate_hz)
            host_ns = max(arrived_ns, self._last_host_ns + 1)
        self._last_host_ns = host_ns
        self._next = frame + 1
        self.status += CameraStatus(delivered=1)
        device_ns = int(self._plan.device_time_ns[index])
        if self._settings.real_time:
            device_ns = self._faulty_clock_ns(frame, device_ns)
        return Frame(image, frame - self._first_number, device_ns, host_ns)

    def _faulty_clock_ns(self, frame: int, device_ns: int) -> int:
        faults = self._faults
        if frame >= _frame_at(faults.clock_steps_at_s, self._rate_hz):
            device_ns += nanoseconds(faults.clock_step_s)
        if faults.clock_bits is not None:
            device_ns %= 1 << faults.clock_bits
        return 0 if frame == _frame_at(faults.clock_zero_at_s, self._rate_hz) else device_ns


def _frame_at(time_s: float | None, rate_hz: float) -> float:
    """Number of the first frame at or after a time; inf for None (never)."""
    return math.inf if time_s is None else float(math.ceil(time_s * rate_hz - 1e-9))
