"""The simulated rig as a `Camera`: in simulated time, with frames on demand, or in real time."""

import time
from collections.abc import Callable

from acquisition.camera import (
    BITS_OF_FORMAT,
    FORMAT_OF_BITS,
    CameraInfo,
    CameraSettings,
    CameraStatus,
    Frame,
    without_features,
)
from acquisition.simulation.inputs import FaultSettings, RigInputs
from acquisition.simulation.run_reader import CAMERA_NAME, SimulatedFrames
from acquisition.simulation.scene import Readings, Scene, block_frames
from acquisition.simulation.settings import SimulationSettings
from processing.errors import DeviceError

_NAMES = {"x0_px": "offset_x_px", "y0_px": "offset_y_px"}
"""Names in the settings of what is called otherwise in the readings."""


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
    monotonic_ns
        The host's clock; tests replace it.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        faults: FaultSettings | None = None,
        inputs: RigInputs | None = None,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._settings = settings
        self._faults = FaultSettings() if faults is None else faults
        self._inputs = inputs
        self._clock_ns = monotonic_ns
        self._opened = False
        self._reader: SimulatedFrames | None = None
        self._runs = settings.first_run
        sensor = settings.sensor
        self._readings = Readings(
            x0_px=0,
            y0_px=0,
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
        self._opened = True
        sensor = self._settings.sensor
        return CameraInfo(
            driver="simulated",
            vendor="optical-pendulum-rig",
            model="simulated rig",
            serial=f"seed-{self._settings.seed}",
            width_px=sensor.width_px,
            height_px=sensor.height_px,
            full_scale_dn=2**self._readings.bit_depth - 1,
            has_clock=True,
            stamped="middle",
            shutter="Rolling" if sensor.row_time_s else "Global",
        )

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; None keeps a value. Raises DeviceError for values the sensor does not support."""
        self._must_be_open()
        if self._reader is not None and self._reader.running:
            raise DeviceError(f"{CAMERA_NAME}: cannot be configured while frames are running; stop it first")
        without_features(settings.model_copy(update={"binning": None}), CAMERA_NAME)
        binning = settings.binning or self._readings.binning
        sensor = self._settings.sensor
        width_px, height_px = sensor.width_px // binning, sensor.height_px // binning
        if binning != self._readings.binning:
            self._readings = self._readings._replace(
                binning=binning, x0_px=0, y0_px=0, width_px=width_px, height_px=height_px
            )
        asked = {
            name: value
            for name in Readings._fields
            if (value := getattr(settings, _NAMES.get(name, name), None)) is not None
        }
        if settings.pixel_format is not None:
            asked["bit_depth"] = BITS_OF_FORMAT[settings.pixel_format]
        new = self._readings._replace(**asked)
        if settings.width_px is not None and settings.offset_x_px is None:
            new = new._replace(x0_px=min(new.x0_px, max(width_px - new.width_px, 0)))
        if settings.height_px is not None and settings.offset_y_px is None:
            new = new._replace(y0_px=min(new.y0_px, max(height_px - new.height_px, 0)))
        _check_range("width_px", new.x0_px + new.width_px, width_px)
        _check_range("height_px", new.y0_px + new.height_px, height_px)
        if not 0 <= new.gain_db <= 48:
            raise DeviceError(
                f"{CAMERA_NAME}: gain_db = {new.gain_db:g} is out of range; 0 to 48 dB are possible"
            )
        if new.frame_rate_hz > 100_000:
            raise DeviceError(
                f"{CAMERA_NAME}: frame_rate_hz = {new.frame_rate_hz:g} is out of range; "
                "at most 100000 are possible"
            )
        if new.exposure_us * new.frame_rate_hz > 1e6:
            raise DeviceError(
                f"{CAMERA_NAME}: exposure_us = {new.exposure_us:g} is longer than a frame at "
                f"frame_rate_hz = {new.frame_rate_hz:g}; at most {1e6 / new.frame_rate_hz:.6g} fit"
            )
        self._readings = new
        return CameraSettings(
            pixel_format=FORMAT_OF_BITS[new.bit_depth],
            **{_NAMES.get(name, name): value for name, value in new._asdict().items() if name != "bit_depth"},
        )

    def start(self) -> None:
        """Begin a run, or continue the run in which the camera was lost or silent."""
        self._must_be_open()
        if self._reader is not None:
            if self._reader.running:
                raise DeviceError(f"{CAMERA_NAME}: is running already; stop it first")
            if self._reader.lost or self._reader.stalled:
                self._reader.resume()
                return
        scene = Scene(self._settings, self._faults, self._readings, self._runs, self._inputs)
        self._runs += 1
        block = block_frames(self._readings.frame_rate_hz, self._inputs is not None)
        self._reader = SimulatedFrames(
            scene, block, self._settings, self._faults, self._readings.frame_rate_hz, self._clock_ns
        )

    def read(self, timeout_s: float) -> Frame | None:
        reader = self._reader
        if reader is None:
            self._must_be_open()
            raise DeviceError(f"{CAMERA_NAME}: is not started; call start before read")
        return reader.read(timeout_s)

    def stop(self) -> None:
        if self._reader is not None:
            self._reader.stop()

    def close(self) -> None:
        self.stop()
        self._opened = False

    @property
    def run(self) -> int:
        """Number of the run whose frames come, or came last."""
        return max(self._runs - 1, self._settings.first_run)

    @property
    def status(self) -> CameraStatus:
        """Counts since `start`, continued after a reconnection."""
        return CameraStatus() if self._reader is None else self._reader.status

    def _must_be_open(self) -> None:
        if not self._opened:
            raise DeviceError(f"{CAMERA_NAME}: is not open; call open first")


def _check_range(name: str, end_px: int, size_px: int) -> None:
    if end_px > size_px:
        raise DeviceError(
            f"{CAMERA_NAME}: {name} with its offset reaches {end_px}; the sensor has {size_px}. Ask for less"
        )
