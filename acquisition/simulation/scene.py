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
from acquisition.simulation.inputs import MAX_REACTION_S, ControllerOutputs, FaultSettings, RigInputs
from acquisition.simulation.motion import motions
from acquisition.simulation.optics import RollingReadout, sheared_beams, spot_position_px
from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings
from acquisition.simulation.smooth_series import SmoothSeries
from acquisition.simulation.true_path import axes_motion
from processing.units import NS_PER_S

_BLOCK_FRAMES = 64


class PlannedFrames(NamedTuple):
    """Consecutive frames before they are drawn; arrays of one length n."""

    first: int
    """Number of the first frame."""
    true_time_s: NDArray[np.float64]
    """True time of the exposure, with a rolling shutter of the first row."""
    device_time_ns: NDArray[np.int64]
    """Timestamp by the camera's clock, for the same moment."""
    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    """True centre of the spot on the sensor, when its own rows are exposed."""
    power: NDArray[np.float64]
    """Relative laser power."""
    slope: NDArray[np.float64]
    """Motion of the spot in x and y from one row to the next, (n, 2), in px; 0 with a global shutter."""
    dropped: NDArray[np.bool_]
    """Whether the camera loses the frame."""
    beam_px: NDArray[np.float64]
    """Part of the spot's motion that the beam itself makes, (n, 2), which moves a reference spot, too."""


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

    Attributes
    ----------
    block_frames
        Frames to be planned at once: many for speed, but few where a controller's outputs act on the rig.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        faults: FaultSettings,
        camera_settings: SensorSettings,
        run: int,
        inputs: RigInputs | None = None,
    ) -> None:
        truth, camera = settings.sensor, camera_settings
        readout = truth.at(camera.bit_depth, camera.gain_db).binned(camera.binning)
        area = camera.binning**2
        self._settings = settings
        self._faults = faults
        self._camera_settings = camera
        self._run = run
        self._fast, self._slow = motions(settings, run)
        add_draught(faults, self._fast, self._slow)
        self._noise = FrameNoise(settings.seed, run)
        self._base_tilts_rad: Sequence[SmoothSeries] = ()
        if settings.reference.relative > 0 and settings.ground.base_tilts:
            ground = ground_of(settings, run)
            assert ground is not None
            self._base_tilts_rad = ground.tilt_rad
        self._pointing = Pointing(settings, self._noise, run, 1 / camera.frame_rate_hz)
        self._next = 0
        self._inputs = inputs
        self.block_frames = _BLOCK_FRAMES
        self._outputs = ControllerOutputs(laser_w=settings.optics.laser_w)
        if inputs is not None:
            self.block_frames = max(1, math.floor(MAX_REACTION_S * camera.frame_rate_hz))
            self._apply(inputs.start_run(), 0.0)
        brightness = camera.exposure_us / truth.exposure_us
        self._peak_e = settings.optics.peak_dn * truth.gain_e_per_dn * brightness * area
        ambient_e = truth.ambient_dn * truth.gain_e_per_dn * brightness * area
        self._readout = readout._replace(ambient_e=ambient_e)
        self._dark = sensor.dark_table(readout)
        region_px = (camera.offset_x_px, camera.offset_y_px, camera.width_px, camera.height_px)
        self._pixels = sensor.pixels(truth, settings.seed, *region_px, camera.binning)
        self._layer_edges = randomness.ziggurat()
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
            for outputs in self._inputs.take_changes():
                self._apply(outputs, first / self._camera_settings.frame_rate_hz)
        self._next += count
        period_s = 1 / self._camera_settings.frame_rate_hz
        times_s = np.arange(first, first + count, dtype=np.float64) * period_s
        is_pulsed = self._outputs.pulse_us > 0
        offset_px = self._pointing.offset_px(first, count)
        if self._rolling is None or is_pulsed:
            # a pulse lights all rows at one time, its middle so long after that of the first row's exposure
            beyond_us = 0.5 * (self._outputs.pulse_us - self._camera_settings.exposure_us)
            delay_s = 1e-6 * (self._outputs.pulse_delay_us + beyond_us) if is_pulsed else 0.0
            position_px = self._spot_px(times_s + delay_s) + offset_px
            slope = np.zeros((count, 2))
        else:
            moving_px = self._spot_px(self._rolling.times_s(times_s)).reshape(count, -1, 2)
            position_px, slope = self._rolling.at_exposure(moving_px + offset_px[:, None, :])
        power = laser_factor(self._faults, times_s) * (self._outputs.laser_w / settings.optics.laser_w)
        if is_pulsed:
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
        if not self._base_tilts_rad:
            return np.zeros((len(times_s), 2))
        slow_rad, fast_rad = (series.at(times_s) for series in self._base_tilts_rad)
        zeros = np.zeros_like(times_s)
        return self._position_px(fast_rad, slow_rad, times_s) - self._position_px(zeros, zeros, times_s)

    def _pulse_fraction(self, y_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Light that the row under the spot collects from a pulse, relative to that without pulses."""
        outputs, exposure_us = self._outputs, self._camera_settings.exposure_us
        begin_us = np.zeros_like(y_px) if self._rolling is None else 1e6 * self._rolling.row_begins_s(y_px)
        end_us = np.minimum(outputs.pulse_delay_us + outputs.pulse_us, begin_us + exposure_us)
        lit_us = end_us - np.maximum(outputs.pulse_delay_us, begin_us)
        relative: NDArray[np.float64] = np.maximum(lit_us, 0.0) / exposure_us
        return relative

    def _spot_px(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Centre of the spot (n, 2), px, without the beam's motion, at times that must not decrease."""
        fast_rad, slow_rad = axes_motion(self._settings, self._fast, self._slow, times_s)
        shake_rad = vibration_rad(self._faults, times_s)
        return self._position_px(fast_rad + shake_rad, slow_rad + shake_rad, times_s)

    def _position_px(
        self, fast_rad: NDArray[np.float64], slow_rad: NDArray[np.float64], times_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Centre of the spot (n, 2), px, for tilts of the two modes."""
        settings = self._settings
        return np.column_stack(
            spot_position_px(fast_rad, slow_rad, times_s, settings.axes, settings.optics, settings.sensor)
        )

    @property
    def image_bytes(self) -> int:
        """Number of bytes of one image."""
        return self._light_e.size * np.dtype(self._dtype).itemsize

    def draw(self, plan: PlannedFrames, frames: slice) -> Image:
        """Images (n, ny, nx) of planned frames; none depends on which others are drawn with it."""
        camera = self._camera_settings
        optics = self._settings.optics
        peak_e = self._peak_e * plan.power[frames]
        binning = camera.binning
        # the centre of the image's first pixel is the mean of the centres of the pixels that it combines
        x = (plan.x_px[frames] - 0.5 * (binning - 1)) / binning - camera.offset_x_px
        y = (plan.y_px[frames] - 0.5 * (binning - 1)) / binning - camera.offset_y_px
        main = np.column_stack((x, y, peak_e))
        shapes, ghost_px = sheared_beams(optics, plan.slope[frames])
        reference = self._settings.reference
        # the settings allow either a reference spot or a ghost
        if reference.relative > 0:
            position = np.array([reference.x_px, reference.y_px]) + plan.beam_px[frames] / reference.gain
            position = (position - 0.5 * (binning - 1)) / binning - (camera.offset_x_px, camera.offset_y_px)
            second = np.column_stack((position, peak_e * reference.relative))
        else:
            position = np.column_stack((x, y)) + ghost_px / binning
            second = np.column_stack((position, peak_e * optics.ghost_relative))
        images = np.empty((len(x), camera.height_px, camera.width_px), dtype=self._dtype)
        sensor.expose_frames(
            images,
            self._light_e,
            shapes / (binning, binning, 1),
            main,
            second,
            self._readout,
            self._dark,
            self._pixels,
            self._layer_edges,
            self._settings.seed,
            self._run,
            plan.first + frames.start,
        )
        return images

    def _apply(self, outputs: ControllerOutputs, time_s: float) -> None:
        """Apply the controller's outputs from `time_s` on."""
        old, self._outputs = self._outputs, outputs
        release = self._settings.release
        if (outputs.starter, outputs.brake) != (old.starter, old.brake):
            drag_s = release.brake_drag_s if outputs.brake else 0.0
            slow_shift_rad = release.starter_arcsec * ARCSEC_RAD if outputs.starter else 0.0
            self._slow.set_load(time_s, slow_shift_rad, self._settings.contact.whole_drag_s + drag_s)
            # the fast mode's amplitude is at most twice this shift, however long the starter pushes
            shift_arcsec = 0.5 * self._settings.fast.amplitude_arcsec if outputs.starter else 0.0
            self._fast.set_load(time_s, shift_arcsec * ARCSEC_RAD, self._settings.fast.drag_s + drag_s)
        if (outputs.magnet, outputs.clamp) != (old.magnet, old.clamp):
            for motion, amplitude_arcsec in (
                (self._slow, release.amplitude_arcsec),
                (self._fast, self._settings.fast.amplitude_arcsec),
            ):
                if outputs.clamp or outputs.magnet:
                    motion.hold(time_s, 0.0 if outputs.clamp else amplitude_arcsec * ARCSEC_RAD)
                else:
                    motion.release(time_s)

    def _device_time_ns(self, first: int, times_s: NDArray[np.float64], period_s: float) -> NDArray[np.int64]:
        clock = self._settings.clock
        exact_ns = np.rint((clock.start_s + times_s * (1 + 1e-6 * clock.drift_ppm)) * NS_PER_S)
        if clock.jitter_s > 0:
            jitter_s = clock.jitter_s * self._noise.normals(CLOCK, first, len(times_s))[:, 0]
            exact_ns += np.rint(np.clip(jitter_s, -0.4 * period_s, 0.4 * period_s) * NS_PER_S)
        return np.maximum(exact_ns, 0).astype(np.int64)
