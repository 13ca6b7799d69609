"""A decay seen through a rolling shutter and through a global one, with the same noise of the spot."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import (
    AxesTruth,
    FastModeTruth,
    OpticsTruth,
    ReleaseTruth,
    SensorTruth,
    SimulationSettings,
)
from acquisition.simulation.true_path import true_turning_points
from calibration.axes_fit import Axes
from calibration.light_lever import Lever
from calibration.shutter import GLOBAL, Shutter, ShutterFit, fit_row_time
from processing.contact import PendulumOnBall
from processing.deflections import slow_deflections
from processing.fit import points_in_true_time
from processing.fit.exact import fit_exact
from processing.spot import Spot
from processing.swing import TurningPoints, swings_of_blocks
from processing.units import ARCSEC_RAD
from rig.analysis import refined_half_cycles
from rig.instrument import Deflector, complete, pendulum_on_ball
from rig.settings import Configuration, FitSettings

RATE_HZ = 50.0
U_PX = 0.02
AMPLITUDE_ARCSEC, FINAL_ARCSEC = 124.0, 4.0
PERIODS_AT_ARCSEC = (100.0, 40.0, 10.0)


class Seen(NamedTuple):
    """What one shutter made of the decay.

    `values` and `u` are by parameter of the exact fit, `period_error` and `u_period` the mean error of the
    full periods around some amplitudes against the true ones, in s.
    """

    values: dict[str, float]
    u: dict[str, float]
    chi2_per_dof: float
    period_error: dict[str, float]
    u_period: dict[str, float]


def settings_of(row_time_s: float, *, along_rows: bool, seed: int) -> SimulationSettings:
    """The demonstration's rig; with `along_rows` the camera is turned by a right angle."""
    width_px, height_px = (640, 320) if along_rows else (320, 640)
    return SimulationSettings(
        seed=seed,
        release=ReleaseTruth(amplitude_arcsec=AMPLITUDE_ARCSEC),
        fast=FastModeTruth(amplitude_arcsec=0.3),
        axes=AxesTruth(slow_angle_rad=0.5 * math.pi if along_rows else 0.0),
        optics=OpticsTruth(arm_m=1.0),
        sensor=SensorTruth(width_px=width_px, height_px=height_px, row_time_s=row_time_s),
    )


def spots_of(settings: SimulationSettings, duration_s: float) -> tuple[NDArray[np.int64], list[Spot]]:
    """Times of the frames, and the spots in them."""
    sensor = settings.sensor
    readings = SensorSettings(0, 0, sensor.width_px, sensor.height_px, 8, 100.0, 0.0, RATE_HZ)
    plan = Scene(settings, FaultSettings(), readings, 0).plan(round(duration_s * RATE_HZ))
    noise = U_PX * np.random.default_rng(settings.seed).standard_normal((2, len(plan.x_px)))
    empty = Spot(*[0.0] * (len(Spot._fields) - 1), 0)  # type: ignore[arg-type]
    spots = [
        empty._replace(x_px=x, y_px=y, u_x_px=U_PX, u_y_px=U_PX)
        for x, y in zip((plan.x_px + noise[0]).tolist(), (plan.y_px + noise[1]).tolist(), strict=True)
    ]
    return plan.device_time_ns, spots


def measure(
    settings: SimulationSettings, frame_ns: NDArray[np.int64], spots: list[Spot], shutter: Shutter
) -> Seen:
    """Deflections, half-cycles and the exact fit, with this shutter taken for the camera's."""
    config = complete(
        Configuration.model_validate({"camera": {"driver": "simulated"}, "simulation": settings.model_dump()})
    )
    pendulum = pendulum_on_ball(config)
    assert pendulum is not None
    lever = Lever(arm_m=settings.optics.arm_m, pixel_pitch_m=settings.sensor.pixel_pitch_m)
    axes = Axes(slow_angle_rad=settings.axes.slow_angle_rad)
    shape = (settings.sensor.height_px, settings.sensor.width_px)
    at = Deflector(lever, axes, shape, shutter)(frame_ns, spots)
    swings = swings_of_blocks([at])
    swings = [swing for swing in swings if swing.amplitude > FINAL_ARCSEC * ARCSEC_RAD]
    slow = slow_deflections(at.times_ns, at.y, at.u_y)
    points = points_in_true_time(
        refined_half_cycles(swings, [slow], slow.unit, pendulum, FitSettings()).swings, 1.0
    )
    return _seen(settings, points, pendulum)


def _seen(settings: SimulationSettings, points: TurningPoints, pendulum: PendulumOnBall) -> Seen:
    found = fit_exact(points, pendulum)
    truth = true_turning_points(settings, FINAL_ARCSEC)
    period_s = points.time_s[2:] - points.time_s[:-2]
    u_period_s = np.hypot(points.u_time_s[2:], points.u_time_s[:-2])
    amplitude_arcsec = points.amplitude[1:-1] / ARCSEC_RAD
    true_s = np.interp(
        amplitude_arcsec,
        np.abs(truth.angle_rad[1:-1])[::-1] / ARCSEC_RAD,
        (truth.time_s[2:] - truth.time_s[:-2])[::-1],
    )
    errors, u_errors = {}, {}
    for at_arcsec in PERIODS_AT_ARCSEC:
        near = np.abs(np.log(amplitude_arcsec / at_arcsec)) < 0.15
        if not near.any():
            continue
        errors[f"T({at_arcsec:g} arcsec)"] = float(np.mean(period_s[near] - true_s[near]))
        # each turning time is in two periods, with opposite signs: only those at the ends remain
        u_errors[f"T({at_arcsec:g} arcsec)"] = float(2.0 * np.mean(u_period_s[near]) / near.sum())
    return Seen(
        dict(zip(found.names, found.values.tolist(), strict=True)),
        dict(zip(found.names, found.standard_uncertainty.tolist(), strict=True)),
        float(found.chi2_per_dof),
        errors,
        u_errors,
    )


class Comparison(NamedTuple):
    """Shifts in standard uncertainties against a global shutter with the same noise, by quantity."""

    fitted: ShutterFit | None
    corrected: dict[str, float]
    uncorrected: dict[str, float]
    chi2_corrected: float
    chi2_uncorrected: float


def compare(row_time_s: float, *, along_rows: bool, seed: int, duration_s: float) -> Comparison:
    """One decay with both shutters; the correction uses the row time that the run itself gives.

    With the slow axis along the rows the run cannot give it, and the true one is used.
    """
    plain = settings_of(0.0, along_rows=along_rows, seed=seed)
    rolling = settings_of(row_time_s, along_rows=along_rows, seed=seed)
    reference = measure(plain, *spots_of(plain, duration_s), GLOBAL)
    frame_ns, spots = spots_of(rolling, duration_s)
    fitted = None
    if not along_rows:
        fitted = fit_row_time(1e-9 * (frame_ns - frame_ns[0]), np.array([spot.y_px for spot in spots]))
    shutter = Shutter(row_time_s if fitted is None else fitted.row_time_s)
    corrected = measure(rolling, frame_ns, spots, shutter)
    uncorrected = measure(rolling, frame_ns, spots, GLOBAL)
    return Comparison(
        fitted,
        _shifts(corrected, reference),
        _shifts(uncorrected, reference),
        corrected.chi2_per_dof,
        uncorrected.chi2_per_dof,
    )


def _shifts(one: Seen, reference: Seen) -> dict[str, float]:
    shifts = {
        name: (one.values[name] - value) / reference.u[name] for name, value in reference.values.items()
    }
    del shifts["start_time_s"]  # another row is the one whose time is the frame's
    for name, error in reference.period_error.items():
        shifts[name] = (one.period_error[name] - error) / reference.u_period[name]
    return shifts
