"""A simulated rig with random geometry, axes, gain, noise and clocks for each seed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.optics import spot_position_px
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import (
    AxesTruth,
    ClockTruth,
    FastModeTruth,
    OpticsTruth,
    ReleaseTruth,
    SensorTruth,
    SimulationSettings,
)
from acquisition.simulation.true_path import true_path
from calibration.axes_fit import AxesFit, fit_axes
from calibration.ladder import LadderSteps
from calibration.lever_fit import LadderFit, fit_ladder
from calibration.pointing import stability
from calibration.sensor import SensorCalibration, photon_transfer
from calibration.timebase import ClockRelation, relate_clocks
from processing.units import ARCSEC_RAD
from tests.calibration.simulated_sensor import random_sensor, transfer_frames

Floats = NDArray[np.float64]
U_TILT_RAD = 0.05 * ARCSEC_RAD
U_SHIFT_M = 0.5e-6
FRAME_RATE_HZ = 50.0


@dataclass(frozen=True)
class Drawn:
    """One rig and the noise of its calibration's records."""

    settings: SimulationSettings
    noise_px: float
    arrival_s: float
    rng: np.random.Generator


def draw_rig(seed: int) -> Drawn:
    """Geometry, axes, gain, noise and clocks of one seed."""
    rng = np.random.default_rng([seed, 808])
    settings = SimulationSettings(
        seed=seed,
        fast=FastModeTruth(
            amplitude_arcsec=rng.uniform(3.0, 30.0), period_ratio=rng.uniform(4.5, 5.5), phase_rad=0.0
        ),
        release=ReleaseTruth(amplitude_arcsec=rng.uniform(60.0, 124.0)),
        axes=AxesTruth(
            slow_angle_rad=rng.uniform(-3.0, 3.0),
            non_orthogonality_rad=rng.uniform(-0.1, 0.1),
            mirrored=bool(rng.integers(2)),
            leakage=0.0,
        ),
        optics=OpticsTruth(
            arm_m=rng.uniform(0.5, 2.0),
            reference_x_px=rng.uniform(100, 200),
            reference_y_px=rng.uniform(200, 400),
        ),
        sensor=random_sensor(rng).model_copy(update={"pixel_pitch_m": rng.uniform(3e-6, 6e-6)}),
        clock=ClockTruth(
            start_s=rng.uniform(0, 1000), drift_ppm=rng.uniform(-100, 100), jitter_s=rng.uniform(1e-6, 2e-5)
        ),
    )
    return Drawn(settings, rng.uniform(0.01, 0.05), rng.uniform(1e-6, 5e-5), rng)


def spots_of(rig: Drawn, x_rad: Floats, y_rad: Floats, times_s: Floats) -> tuple[Floats, Floats]:
    """Spots of tilts in the rig's own axes, with its noise."""
    settings = rig.settings
    x_px, y_px = spot_position_px(x_rad, y_rad, times_s, settings.axes, settings.optics, settings.sensor)
    noise = rig.noise_px * rig.rng.standard_normal((2, len(times_s)))
    return x_px + noise[0], y_px + noise[1]


def climb_tilts(rig: Drawn, hysteresis_rad: float = 0.0) -> LadderFit:
    """Nine tilts to 150 arcsec on either side, up and down, the slow axis alone."""
    up = np.linspace(-150.0, 150.0, 9) * ARCSEC_RAD
    reference = np.concatenate([up, up[::-1]])
    # the topmost tilt, read again, is still reached from below
    way = np.concatenate([np.ones(10), -np.ones(8)])
    true = reference + U_TILT_RAD * rig.rng.standard_normal(18) + 0.5 * hysteresis_rad * way
    x_px, y_px = spots_of(rig, np.zeros(18), true, np.zeros(18))
    ones = np.ones(18)
    return fit_ladder(
        LadderSteps(reference, U_TILT_RAD * ones, x_px, y_px, rig.noise_px * ones, rig.noise_px * ones),
        "tilt",
    )


def climb_shifts(rig: Drawn) -> LadderFit:
    """Seven shifts of the sensor along its own vertical, up to 0.3 mm."""
    reference = np.linspace(-0.3e-3, 0.3e-3, 7)
    true = reference + U_SHIFT_M * rig.rng.standard_normal(7)
    noise = rig.noise_px * rig.rng.standard_normal((2, 7))
    optics, ones = rig.settings.optics, np.ones(7)
    assert optics.reference_x_px is not None
    assert optics.reference_y_px is not None
    x_px = optics.reference_x_px + noise[0]
    y_px = optics.reference_y_px + true / rig.settings.sensor.pixel_pitch_m + noise[1]
    return fit_ladder(
        LadderSteps(reference, U_SHIFT_M * ones, x_px, y_px, rig.noise_px * ones, rig.noise_px * ones),
        "shift",
    )


def swing_for_axes(rig: Drawn, duration_s: float = 60.0) -> AxesFit:
    """A minute in which both modes swing, released to their positive sides."""
    motion = true_path(rig.settings, duration_s, FRAME_RATE_HZ)
    times_s = motion.times_ns * 1e-9
    x_px, y_px = spots_of(rig, motion.x_rad, motion.y_rad, times_s)
    return fit_axes(times_s, x_px, y_px, slow_began="+", fast_began="+")


def stamp_frames(rig: Drawn, frames: int = 3000) -> ClockRelation:
    """Frames stamped by the simulated camera and by a host that now and then is late."""
    sensor = rig.settings.sensor
    readings = SensorSettings(0, 0, sensor.width_px, sensor.height_px, sensor.bit_depth, 100.0, 0.0, 100.0)
    plan = Scene(rig.settings, FaultSettings(), readings, 0).plan(frames)
    late = rig.rng.random(frames) < 0.05
    delay_s = 1e-3 + rig.arrival_s * rig.rng.standard_normal(frames)
    delay_s += late * rig.rng.exponential(1e-3, frames)
    host_ns = np.rint((7.0 + plan.true_time_s + delay_s) * 1e9).astype(np.int64)
    # a frame that is late holds up those behind it
    host_ns = np.maximum.accumulate(host_ns - np.arange(frames)) + np.arange(frames)
    return relate_clocks(plan.device_time_ns, host_ns, np.arange(frames))


def transfer(rig: Drawn) -> SensorCalibration:
    """Photon transfer of the drawn sensor."""
    sensor: SensorTruth = rig.settings.sensor
    pairs, darks, exposures = transfer_frames(sensor, rig.settings.seed)
    return photon_transfer(pairs, darks, 2**sensor.bit_depth - 1, exposures_us=exposures)


def deviations(seed: int) -> dict[str, float]:
    """(found - true) / standard uncertainty of every calibrated quantity of one seed."""
    rig = draw_rig(seed)
    truth = rig.settings
    optics, sensor = truth.optics, truth.sensor
    hysteresis_rad = float(0.3 * ARCSEC_RAD * rig.rng.standard_normal())
    tilts, shifts = climb_tilts(rig, hysteresis_rad), climb_shifts(rig)
    found = swing_for_axes(rig)
    axes = found.axes
    if axes.mirrored != truth.axes.mirrored:
        raise AssertionError(f"seed {seed}: handedness is wrong")
    relation, electrons = stamp_frames(rig), transfer(rig)
    still = rig.noise_px * rig.rng.standard_normal(4000)
    drift = float(1e-3 * rig.rng.standard_normal())
    times_s = np.arange(4000) * 0.01
    pointing = stability(times_s, still + drift * times_s, np.full(4000, rig.noise_px))
    assert optics.reference_x_px is not None
    angle = (tilts.direction_rad - truth.axes.slow_angle_rad + np.pi) % (2 * np.pi) - np.pi
    slow = (axes.slow_angle_rad - truth.axes.slow_angle_rad + np.pi) % (2 * np.pi) - np.pi
    rate = 1.0 / (1.0 + 1e-6 * truth.clock.drift_ppm)
    return {
        "lever scale, tilts": (tilts.scale - optics.arm_m / sensor.pixel_pitch_m) / tilts.u_scale,
        "lever direction": float(angle / tilts.u_direction_rad),
        "lever origin": (tilts.origin_px[0] - optics.reference_x_px) / tilts.u_origin_px[0],
        "lever hysteresis": (tilts.hysteresis - hysteresis_rad) / tilts.u_hysteresis,
        "lever skew": tilts.skew / tilts.u_skew,
        "pixel pitch, shifts": (shifts.scale - 1.0 / sensor.pixel_pitch_m) / shifts.u_scale,
        "slow direction": float(slow / axes.u_slow_angle_rad),
        "non-orthogonality": (axes.non_orthogonality_rad - truth.axes.non_orthogonality_rad)
        / axes.u_non_orthogonality_rad,
        "gain": (electrons.gain_e_per_dn - sensor.gain_e_per_dn) / electrons.u_gain_e_per_dn,
        "read noise": (electrons.read_noise_e - sensor.read_noise_e) / electrons.u_read_noise_e,
        "dark level": (electrons.dark_level_dn - sensor.black_level_dn) / electrons.u_dark_level_dn,
        "prnu": (electrons.prnu - sensor.prnu) / electrons.u_prnu,
        "camera rate": (relation.rate - rate) / relation.u_rate,
        "pointing drift": (pointing.drift_per_s - drift) / pointing.u_drift_per_s,
        "pointing noise": (pointing.noise - rig.noise_px) / (rig.noise_px / np.sqrt(4 / 3 * 4000)),
    }
