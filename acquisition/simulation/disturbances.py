"""Simulated disturbances and faults: jitter, drift, fading laser, bursts of vibration, lost frames.

They depend only on the seed, the run and the number of the frame; frames are requested in order.
"""

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation import randomness
from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.motion import Motion
from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings
from acquisition.simulation.smooth_series import KNOTS_PER_PERIOD, BandNoise, SmoothSeries

JITTER, WALK, CLOCK, POWER, _DROP = 4, 5, 6, 7, 8
"""Purposes of the random numbers of a frame; each purpose has numbers of its own."""
_AIR, _PHASE, _OWN_AIR = (17, 18), 19, (20, 21)


class FrameNoise(NamedTuple):
    """Random numbers of one run, for consecutive frames from the number `first` on."""

    seed: int
    run: int

    def normals(self, purpose: int, first: int, count: int, columns: int = 1) -> NDArray[np.float64]:
        """Standard normal numbers (count, columns) for one purpose."""
        return randomness.normals(self.seed, self.run, purpose, first, (count, columns))

    def dropped(self, first: int, count: int, fraction: float) -> NDArray[np.bool_]:
        """Whether the camera loses each frame, (count,), with the probability `fraction`."""
        if fraction == 0.0:
            return np.zeros(count, dtype=np.bool_)
        # normal numbers are compared with their quantile, so that one generator suffices for all purposes
        return self.normals(_DROP, first, count)[:, 0] < NormalDist().inv_cdf(fraction)


class Pointing:
    """Slow and random motion of the beam on the sensor; frames must be requested in order, without gaps."""

    def __init__(
        self, settings: SimulationSettings, noise: FrameNoise, run: int, frame_period_s: float
    ) -> None:
        self._truth = settings.disturbances
        self._noise = noise
        self._period_s = frame_period_s
        self._walk_px = np.zeros(2)
        self._air_px = air_px(settings, run) if self._truth.air_arcsec > 0 else ()
        self._common = settings.reference.air_common
        self._own_air_px = air_px(settings, run, _OWN_AIR) if self._air_px and self._common < 1 else ()
        self._gain = settings.reference.gain
        self._offset = self._air = self._camera = np.zeros((0, 2))
        # phases are drawn in the order of the frequencies, so that a further one leaves the others unchanged
        phases = np.random.Generator(np.random.PCG64([settings.seed, run, _PHASE]))
        self._phases = phases.uniform(0, 2 * np.pi, (len(self._truth.microphonics), 2))

    def offset_px(self, first: int, count: int) -> NDArray[np.float64]:
        """Offset of the spot in x and y, (count, 2), px."""
        truth = self._truth
        minutes = np.arange(first, first + count) * (self._period_s / 60.0)
        drift = np.array([truth.pointing_drift_x_px_per_min, truth.pointing_drift_y_px_per_min])
        offset: NDArray[np.float64] = minutes[:, None] * drift
        if truth.pointing_jitter_px > 0:
            offset += truth.pointing_jitter_px * self._noise.normals(JITTER, first, count, 2)
        if truth.pointing_walk_px_per_sqrt_s > 0:
            step_px = truth.pointing_walk_px_per_sqrt_s * math.sqrt(self._period_s)
            # the sum continues from the last position, so that the lengths of blocks have no effect
            steps = np.vstack([self._walk_px, step_px * self._noise.normals(WALK, first, count, 2)])
            path = np.cumsum(steps, axis=0)[1:]
            self._walk_px = path[-1]
            offset += path
        times_s = np.arange(first, first + count, dtype=np.float64) * self._period_s
        if truth.air_arcsec > 0:
            self._air = np.column_stack([series.at(times_s) for series in self._air_px])
            offset += self._air
        for shaking, phases in zip(truth.microphonics, self._phases, strict=True):
            cycle = 2 * np.pi * shaking.frequency_hz * times_s
            offset += shaking.amplitude_px * np.sin(cycle[:, None] + phases)
        self._camera = self._camera_px(times_s)
        offset += self._camera
        self._offset = offset
        return offset

    def _camera_px(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Motion of all spots that the camera's own motion causes, (n, 2), px."""
        truth = self._truth
        creep = np.array([truth.camera_creep_x_px_per_min, truth.camera_creep_y_px_per_min])
        motion_px = times_s[:, None] * (creep / 60.0)
        if truth.camera_slips_at_s is not None:
            slip = np.array([truth.camera_slip_x_px, truth.camera_slip_y_px])
            motion_px = motion_px + np.where(times_s[:, None] >= truth.camera_slips_at_s, slip, 0.0)
        return np.asarray(motion_px)

    def reference_px(self, first: int, count: int) -> NDArray[np.float64]:
        """Offset of the reference spot times the gain, (count, 2), px, for frames of the last `offset_px`.

        Its beam passes through other air, whose effect is correlated with the pendulum's by `air_common`;
        the camera moves both spots equally.
        """
        offset = self._offset + (self._gain - 1) * self._camera
        if not self._own_air_px:
            return offset
        times_s = np.arange(first, first + count, dtype=np.float64) * self._period_s
        own = np.column_stack([series.at(times_s) for series in self._own_air_px])
        part = math.sqrt(1 - self._common**2)
        return np.asarray(offset + (self._common - 1) * self._air + part * own)


def air_px(
    settings: SimulationSettings, run: int, keys: tuple[int, int] = _AIR
) -> tuple[SmoothSeries, SmoothSeries]:
    """Motion of the spot due to air in the beam, in x and in y, in px, as functions of time."""
    truth = settings.disturbances
    rms_px = truth.air_arcsec * ARCSEC_RAD * 2 * settings.optics.arm_m / settings.sensor.pixel_pitch_m
    span = math.log(truth.air_to_hz / truth.air_from_hz)

    def density(frequencies_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = (frequencies_hz >= truth.air_from_hz) & (frequencies_hz <= truth.air_to_hz)
        return np.where(inside, rms_px / np.sqrt(frequencies_hz * span), 0.0)

    rate_hz = KNOTS_PER_PERIOD * truth.air_to_hz
    x, y = (
        SmoothSeries(
            rate_hz, [(1.0, BandNoise(density, rate_hz, truth.air_to_hz, (settings.seed, run, key)))]
        )
        for key in keys
    )
    return x, y


def laser_factor(faults: FaultSettings, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative power of the laser at `times_s` (n,).

    It falls to `laser_fade_to` in the first quarter of the fade, stays there for half of it, and rises again.
    """
    if faults.laser_fades_at_s is None:
        return np.ones(len(times_s))
    fraction = (times_s - faults.laser_fades_at_s) / faults.laser_fade_duration_s
    depth = np.clip(np.minimum(4 * fraction, 4 * (1 - fraction)), 0, 1)
    loss: NDArray[np.float64] = 0.5 * (1 - np.cos(np.pi * depth))
    return 1 - (1 - faults.laser_fade_to) * loss


def vibration_rad(faults: FaultSettings, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vibration of the base as a tilt of both axes in rad, (n,), with a smooth envelope."""
    if faults.vibration_burst_at_s is None:
        return np.zeros(len(times_s))
    since_s = times_s - faults.vibration_burst_at_s
    envelope = np.sin(np.pi * np.clip(since_s / faults.vibration_burst_duration_s, 0, 1)) ** 2
    phase = 2 * np.pi * faults.vibration_burst_hz * since_s
    shake: NDArray[np.float64] = faults.vibration_burst_arcsec * ARCSEC_RAD * envelope * np.sin(phase)
    return shake


def add_draught(faults: FaultSettings, fast: Motion, slow: Motion) -> None:
    """Add a draught's impulse, which would make the resting pendulum swing to `draught_arcsec`."""
    if faults.draught_at_s is not None:
        for motion in (fast, slow):
            motion.kick(faults.draught_at_s, faults.draught_arcsec * ARCSEC_RAD * motion.w0_rad_per_s)
