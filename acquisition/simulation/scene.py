"""One simulated run: position, time and brightness of the spot in each frame, and the image."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.camera import Image
from acquisition.simulation import randomness, sensor
from acquisition.simulation.disturbances import (
    CLOCK,
    POWER,
    FrameNoise,
    Pointing,
    add_draught,
    laser_factor,
    vibration_rad,
)
from acquisition.simulation.ground import ground_of
from acquisition.simulation.inputs import FaultSettings, RigInputs, RigState
from acquisition.simulation.motion import motions
from acquisition.simulation.optics import RollingReadout, ShearedBeams, spot_position_px
from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings
from acquisition.simulation.smooth_series import SmoothSeries
from acquisition.simulation.true_path import axes_motion
from processing.units import NS_PER_S


class PlannedFrames(NamedTuple):
    """Consecutive frames before they are drawn; arrays of one length.

    `first` is the number of the first frame, `true_time_s` the true time of the exposure, `device_time_ns`
    the timestamp by the camera's clock; with a rolling shutter, both of the first row. `x_px`, `y_px` is the
    true centre of the spot on the sensor (when its own rows are exposed), `power` the relative laser power.
    `slope` (n, 2) is the motion of the spot in x and y from one row to the next, in px, 0 with a global
    shutter. `dropped` frames are lost by the camera. `beam_px` (n, 2) is the part of the spot's motion that
    the beam itself makes, which moves a reference spot, too.
    """

    first: int
    true_time_s: NDArray[np.float64]
    device_time_ns: NDArray[np.int64]
    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    power: NDArray[np.float64]
    slope: NDArray[np.float64]
    dropped: NDArray[np.bool_]
    beam_px: NDArray[np.float64]


class SensorSettings(NamedTuple):
    """Settings of the simulated sensor, named as in CameraSettings.

    Motion during an exposure is neglected. With `binning`, offset and size of the region are in pixels of the
    image, each the mean of that many pixels of the sensor in each direction, which are read one by one.
    """

    offset_x_px: int
    offset_y_px: int
    width_px: int
    height_px: int
    bit_depth: int
    exposure_us: float
    gain_db: float
    frame_rate_hz: float
    binning: int = 1


class Scene:
    """The simulated rig from the start of a run on, frame by frame.

    Frames are planned in order and earlier plans are discarded, so that memory does not grow with the
    duration of the run. The same settings, sensor settings and run give identical frames.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        faults: FaultSettings,
        camera: SensorSettings,
        run: int,
        inputs: RigInputs | None = None,
    ) -> None:
        truth = settings.sensor
        state = truth.at(camera.bit_depth, camera.gain_db).binned(camera.binning)
        area = camera.binning**2
        self._settings = settings
        self._faults = faults
        self._sensor_settings = camera
        self._run = run
        self._fast, self._slow = motions(settings, run)
        add_draught(faults, self._fast, self._slow)
        self._noise = FrameNoise(settings.seed, run)
        self._base_rad: Sequence[SmoothSeries] = ()
        if settings.reference.relative > 0 and settings.ground.base_tilts:
            ground = ground_of(settings, run)
            assert ground is not None
            self._base_rad = ground.tilt_rad
        self._pointing = Pointing(settings, self._noise, run, 1 / camera.frame_rate_hz)
        self._next = 0
        self._inputs = inputs
        self._outputs = RigState(laser_w=settings.optics.laser_w)
        if inputs is not None:
            self._command(inputs.begin(), 0.0)
        brightness = camera.exposure_us / truth.exposure_us
        self._peak_e = settings.optics.peak_dn * truth.gain_e_per_dn * brightness * area
        ambient_e = truth.ambient_dn * truth.gain_e_per_dn * brightness * area
        self._readout = state._replace(ambient_e=ambient_e)
        self._dark = sensor.dark_table(state)
        region_px = (camera.offset_x_px, camera.offset_y_px, camera.width_px, camera.height_px)
        self._pixels = sensor.pixels(truth, settings.seed, *region_px, camera.binning)
        self._edges = randomness.ziggurat()
        self._light_e = np.zeros((camera.height_px, camera.width_px))
        self._dtype = np.uint8 if camera.bit_depth == 8 else np.uint16
        self._rolling: RollingReadout | None = None
        if truth.row_time_s:
            top, rows = camera.offset_y_px * camera.binning, camera.height_px * camera.binning
            self._rolling = RollingReadout(truth, top, rows, camera.frame_rate_hz)

    def plan(self, count: int) -> PlannedFrames:
        """Calculate the next `count` frames, without their images."""
        settings = self._settings
        first = self._next
        if self._inputs is not None:
            for state in self._inputs.take():
                self._command(state, first / self._sensor_settings.frame_rate_hz)
        self._next += count
        period_s = 1 / self._sensor_settings.frame_rate_hz
        times_s = np.arange(first, first + count, dtype=np.float64) * period_s
        pulsed = self._outputs.pulse_us > 0
        offset_px = self._pointing.offset_px(first, count)
        if self._rolling is None or pulsed:
            position_px, slope = (
                self._spot_px(times_s + self._light_delay_s) + offset_px,
                np.zeros((count, 2)),
            )
        else:
            moving_px = self._spot_px(self._rolling.times_s(times_s)).reshape(count, -1, 2)
            position_px, slope = self._rolling.seen(moving_px + offset_px[:, None, :])
        power = laser_factor(self._faults, times_s) * (self._outputs.laser_w / settings.optics.laser_w)
        if pulsed:
            power = power * self._pulse_fraction(position_px[:, 1])
        if settings.optics.power_noise > 0:
            relative = 1 + settings.optics.power_noise * self._noise.normals(POWER, first, count)[:, 0]
            power = power * np.maximum(relative, 0)
        return PlannedFrames(
            first=first,
            true_time_s=times_s,
            device_time_ns=self._device_time_ns(first, times_s, period_s),
            x_px=position_px[:, 0],
            y_px=position_px[:, 1],
            power=power,
            slope=slope,
            dropped=self._noise.dropped(first, count, settings.disturbances.dropped_fraction),
            beam_px=self._pointing.reference_px(first, count) + self._base_px(times_s),
        )

    def _base_px(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Motion of a reference spot by tilts of the base, over the pendulum's arm, (n, 2), px."""
        if not self._base_rad:
            return np.zeros((len(times_s), 2))
        settings = self._settings
        slow, fast = (series.at(times_s) for series in self._base_rad)
        zeros = np.zeros_like(times_s)
        tilted, level = (
            np.column_stack(
                spot_position_px(*tilts, times_s, settings.axes, settings.optics, settings.sensor)
            )
            for tilts in ((fast, slow), (zeros, zeros))
        )
        return np.asarray(tilted - level)

    @property
    def _light_delay_s(self) -> float:
        """Time in s from the middle of the first row's exposure to the middle of the light's pulse."""
        state = self._outputs
        if not state.pulse_us:
            return 0.0
        return 1e-6 * (state.pulse_delay_us + 0.5 * (state.pulse_us - self._sensor_settings.exposure_us))

    def _pulse_fraction(self, y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Light that the row under the spot collects from a pulse, relative to that without pulses."""
        state, exposure_us = self._outputs, self._sensor_settings.exposure_us
        opens_us = np.zeros_like(y_px) if self._rolling is None else 1e6 * self._rolling.row_begins_s(y_px)
        ends_us = np.minimum(state.pulse_delay_us + state.pulse_us, opens_us + exposure_us)
        lit_us = ends_us - np.maximum(state.pulse_delay_us, opens_us)
        relative: NDArray[np.float64] = np.maximum(lit_us, 0.0) / exposure_us
        return relative

    def _spot_px(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Centre of the spot (n, 2), px, without the beam's motion, at times that must not decrease."""
        settings = self._settings
        x_rad, y_rad = axes_motion(settings, self._fast, self._slow, times_s)
        shake_rad = vibration_rad(self._faults, times_s)
        return np.column_stack(
            spot_position_px(
                x_rad + shake_rad, y_rad + shake_rad, times_s, settings.axes, settings.optics, settings.sensor
            )
        )

    @property
    def image_bytes(self) -> int:
        return self._light_e.size * np.dtype(self._dtype).itemsize

    def draw(self, plan: PlannedFrames, rows: slice) -> Image:
        """Images (n, ny, nx) of consecutive planned frames; each is the same whichever are drawn with it."""
        camera = self._sensor_settings
        optics = self._settings.optics
        peak_e = self._peak_e * plan.power[rows]
        binning = camera.binning
        # the centre of the image's first pixel is the mean of the centres of the pixels that it combines
        x = (plan.x_px[rows] - 0.5 * (binning - 1)) / binning - camera.offset_x_px
        y = (plan.y_px[rows] - 0.5 * (binning - 1)) / binning - camera.offset_y_px
        main = np.column_stack((x, y, peak_e))
        sheared = ShearedBeams(optics, plan.slope[rows])
        ghost = np.column_stack(
            (
                x + sheared.ghost_dx_px / binning,
                y + sheared.ghost_dy_px / binning,
                peak_e * optics.ghost_relative,
            )
        )
        reference = self._settings.reference
        if reference.relative > 0:
            place = np.array([reference.x_px, reference.y_px]) + plan.beam_px[rows] / reference.gain
            place = (place - 0.5 * (binning - 1)) / binning - (camera.offset_x_px, camera.offset_y_px)
            ghost = np.column_stack((place, peak_e * reference.relative))
        images = np.empty((len(x), camera.height_px, camera.width_px), dtype=self._dtype)
        sensor.expose_frames(
            images,
            self._light_e,
            sheared.shapes / (binning, binning, 1),
            main,
            ghost,
            self._readout,
            self._dark,
            self._pixels,
            self._edges,
            self._settings.seed,
            self._run,
            plan.first + rows.start,
        )
        return images

    def _command(self, state: RigState, time_s: float) -> None:
        """Apply the controller's outputs from `time_s` on."""
        before, self._outputs = self._outputs, state
        release = self._settings.release
        if (state.starter, state.brake) != (before.starter, before.brake):
            drag_s = release.brake_drag_s if state.brake else 0.0
            push_rad = release.starter_arcsec * ARCSEC_RAD if state.starter else 0.0
            self._slow.load(time_s, push_rad, self._settings.contact.whole_drag_s + drag_s)
            # the fast mode's amplitude is at most twice this shift, however long the starter pushes
            shift_rad = 0.5 * self._settings.fast.amplitude_arcsec * ARCSEC_RAD if state.starter else 0.0
            self._fast.load(time_s, shift_rad, self._settings.fast.drag_s + drag_s)
        if (state.magnet, state.clamp) != (before.magnet, before.clamp):
            for motion, amplitude_arcsec in (
                (self._slow, release.amplitude_arcsec),
                (self._fast, self._settings.fast.amplitude_arcsec),
            ):
                if state.clamp:
                    motion.hold(time_s, 0.0)
                elif state.magnet:
                    motion.hold(time_s, amplitude_arcsec * ARCSEC_RAD)
                else:
                    motion.let_go(time_s)

    def _device_time_ns(self, first: int, times_s: NDArray[np.float64], period_s: float) -> NDArray[np.int64]:
        clock = self._settings.clock
        exact_ns = np.rint((clock.start_s + times_s * (1 + 1e-6 * clock.drift_ppm)) * NS_PER_S)
        if clock.jitter_s > 0:
            jitter_s = clock.jitter_s * self._noise.normals(CLOCK, first, len(times_s))[:, 0]
            exact_ns += np.rint(np.clip(jitter_s, -0.4 * period_s, 0.4 * period_s) * NS_PER_S)
        return np.maximum(exact_ns, 0).astype(np.int64)


def block_frames(frame_rate_hz: float, commanded: bool) -> int:
    """Frames to be planned at once: many for speed, but at most 20 ms where a controller may interfere."""
    return max(1, math.floor(0.02 * frame_rate_hz)) if commanded else 64
