"""The simulated pendulum without a camera: its exact turning points, and tilts with a given noise."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation import randomness
from acquisition.simulation.motion import Motion, motions
from acquisition.simulation.settings import ARCSEC_RAD, SimulationSettings
from processing.units import nanoseconds

_PATH_NOISE = 11


class TruePoints(NamedTuple):
    """Turning points of the slow mode without noise, arrays (n,); angles have the sign of their side."""

    time_s: NDArray[np.float64]
    angle_rad: NDArray[np.float64]


class TruePath(NamedTuple):
    """Tilts of the pendulum along its own axes, as an ideal tracker would measure them, arrays (n,)."""

    times_ns: NDArray[np.int64]
    x_rad: NDArray[np.float64]
    y_rad: NDArray[np.float64]


def true_turning_points(
    settings: SimulationSettings,
    final_amplitude_arcsec: float = 2.0,
    max_duration_s: float = 86_400.0,
    run: int = 0,
) -> TruePoints:
    """Turning points of the slow mode from the release down to an amplitude.

    If the pendulum is released at its amplitude, the release is the first point. Points from the first below
    `final_amplitude_arcsec` on, or after `max_duration_s`, are left out. `run` decides the ground.
    """
    slow = motions(settings, run)[1]
    found = []
    if settings.release.way == "let go":
        found.append([[settings.release.at_s, settings.release.amplitude_arcsec * ARCSEC_RAD]])
    final_rad = final_amplitude_arcsec * ARCSEC_RAD
    while slow.reached_s < max_duration_s and not slow.at_rest:
        turns = slow.step(max_duration_s)
        found.append(turns.tolist())
        if len(turns) and abs(turns[-1, 1]) < final_rad:
            break
    points = np.array([point for chunk in found for point in chunk]).reshape(-1, 2)
    below = np.abs(points[:, 1]) < final_rad
    if below.any():
        points = points[: np.argmax(below)]
    return TruePoints(points[:, 0].copy(), points[:, 1].copy())


def axes_motion(
    settings: SimulationSettings, fast: Motion, slow: Motion, times_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tilts (X, Y) in rad at `times_s` (n,): modes, leakage, rest position and its drift."""
    axes = settings.axes
    minutes = times_s / 60.0
    fast_rad, _ = fast.tilt(times_s)
    slow_rad, slow_rate = slow.tilt(times_s)
    w0 = 2 * math.pi / settings.contact.period0_s
    rest_fast = (axes.rest_fast_arcsec + axes.rest_drift_fast_arcsec_per_min * minutes) * ARCSEC_RAD
    rest_slow = (axes.rest_slow_arcsec + axes.rest_drift_slow_arcsec_per_min * minutes) * ARCSEC_RAD
    leak = axes.leakage * slow_rad + axes.leakage_quadrature * slow_rate / w0
    return fast_rad + leak + rest_fast, slow_rad + rest_slow


def true_path(
    settings: SimulationSettings, duration_s: float, frame_rate_hz: float | None = None, run: int = 0
) -> TruePath:
    """Tilts without noise at evenly spaced times from 0 on; by default at the camera's frame rate."""
    rate_hz = settings.clock.frame_rate_hz if frame_rate_hz is None else frame_rate_hz
    times_s = np.arange(math.floor(duration_s * rate_hz) + 1) / rate_hz
    fast, slow = motions(settings, run)
    x_rad, y_rad = axes_motion(settings, fast, slow, times_s)
    return TruePath(nanoseconds(times_s), x_rad, y_rad)


def noisy(truth: TruePath, u_x_rad: float, u_y_rad: float, seed: int) -> TruePath:
    """The same tilts with white normal noise of these standard deviations, which depends on `seed`."""
    noise = np.empty((len(truth.times_ns), 2))
    randomness.frame_normals(seed, 0, _PATH_NOISE, 0, randomness.ziggurat(), noise)
    return truth._replace(
        x_rad=truth.x_rad + u_x_rad * noise[:, 0], y_rad=truth.y_rad + u_y_rad * noise[:, 1]
    )
