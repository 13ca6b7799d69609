"""The simulated pendulum without a camera: its exact turning points, and tilts with a given noise."""

import math
from typing import Final, NamedTuple

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
    """Tilts of the pendulum along its own axes, as an ideal tracker would measure them; arrays (n,)."""

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
    `final_amplitude_arcsec` on, or after `max_duration_s`, are left out. The ground depends on `run`.
    """
    slow = motions(settings, run)[1]
    blocks = [np.empty((0, 2))]
    if settings.release.way == "let go":
        blocks.append(np.array([[settings.release.at_s, settings.release.amplitude_arcsec * ARCSEC_RAD]]))
    final_rad = final_amplitude_arcsec * ARCSEC_RAD
    while slow.reached_s < max_duration_s and not slow.at_rest:
        blocks.append(slow.advance(max_duration_s))
        if (np.abs(blocks[-1][-1:, 1]) < final_rad).any():
            break
    points = np.concatenate(blocks)
    is_below = np.abs(points[:, 1]) < final_rad
    if is_below.any():
        points = points[: np.argmax(is_below)]
    return TruePoints(points[:, 0].copy(), points[:, 1].copy())


def axes_motion(
    settings: SimulationSettings, fast: Motion, slow: Motion, times_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tilts (X, Y) in rad at `times_s` (n,): the modes, leakage, and the rest position with its drift."""
    axes = settings.axes
    minutes = times_s / 60.0
    fast_rad, _ = fast.sample(times_s)
    slow_rad, slow_rate = slow.sample(times_s)
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
    noise = randomness.normals(seed, 0, _PATH_NOISE, 0, (len(truth.times_ns), 2))
    return truth._replace(
        x_rad=truth.x_rad + u_x_rad * noise[:, 0], y_rad=truth.y_rad + u_y_rad * noise[:, 1]
    )


class TrimWeight(NamedTuple):
    """One weight of a simulated pendulum."""

    mass_kg: float
    pitch_m: float
    """Pitch of its thread."""
    direction: tuple[float, float, float]
    """Direction (X, Y, down) in which a positive turn moves it."""
    backlash_turns: float = 0.0


_U_TURNS: Final = 0.01
"""Standard deviation of the error of a turn by hand, in turns."""


class TrimmedPendulum:
    """A pendulum whose mass centre is displaced, and the weights that trim it.

    Parameters
    ----------
    settings
        Rest position and period here are those of the untrimmed pendulum.
    weights
        By name.
    lower_m
        Depth of the mass centre below the ball's centre, less the ball's radius.
    seed
        Seed of the random errors with which turns are set by hand.
    """

    def __init__(
        self,
        settings: SimulationSettings,
        weights: dict[str, TrimWeight],
        lower_m: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._settings = settings
        self._weights = weights
        self._random = np.random.default_rng(seed)
        radius_m = settings.contact.ball_radius_m
        arm_m = radius_m + lower_m
        self._centre_m = np.array(
            [
                arm_m * math.tan(settings.axes.rest_fast_arcsec * ARCSEC_RAD),
                arm_m * math.tan(settings.axes.rest_slow_arcsec * ARCSEC_RAD),
                lower_m,
            ]
        )
        # the screw's position within the play of its nut is random, as its last turn left it
        self._screw = {
            name: self._random.uniform() * weight.backlash_turns for name, weight in weights.items()
        }
        self._nut = dict.fromkeys(weights, 0.0)

    def turn(self, name: str, turns: float) -> None:
        """Turn a weight, with the play of its screw and a random error of the turn."""
        weight = self._weights[name]
        self._screw[name] += turns + _U_TURNS * self._random.standard_normal()
        screw, old_nut = self._screw[name], self._nut[name]
        self._nut[name] = min(max(old_nut, screw - weight.backlash_turns), screw)
        mass_ratio = weight.mass_kg / self._settings.contact.mass_kg
        shift_m = mass_ratio * weight.pitch_m * (self._nut[name] - old_nut)
        self._centre_m = self._centre_m + shift_m * np.array(weight.direction)

    @property
    def settings(self) -> SimulationSettings:
        """Settings of the simulated rig with the present positions of the weights."""
        x_m, y_m, lower_m = self._centre_m
        contact, axes = self._settings.contact, self._settings.axes
        arm_m = contact.ball_radius_m + lower_m
        rest = {
            "rest_fast_arcsec": math.atan2(x_m, arm_m) / ARCSEC_RAD,
            "rest_slow_arcsec": math.atan2(y_m, arm_m) / ARCSEC_RAD,
        }
        period_s = contact.period0_s * math.sqrt(contact.ball_radius_m / arm_m)
        return self._settings.model_copy(
            update={
                "axes": axes.model_copy(update=rest),
                "contact": contact.model_copy(update={"period0_s": period_s}),
            }
        )


def imperfect_weights(nominal: dict[str, TrimWeight], seed: int) -> dict[str, TrimWeight]:
    """Weights that deviate from the nominal ones at random: up to 15 % of mass, some degrees, backlash."""
    random = np.random.default_rng((seed, 77))
    weights = {}
    for name, weight in nominal.items():
        tilted = np.array(weight.direction) + random.uniform(-0.12, 0.12, 3)
        tilted *= np.linalg.norm(weight.direction) / np.linalg.norm(tilted)
        weights[name] = TrimWeight(
            mass_kg=weight.mass_kg * random.uniform(0.85, 1.15),
            pitch_m=weight.pitch_m,
            direction=(float(tilted[0]), float(tilted[1]), float(tilted[2])),
            backlash_turns=random.uniform(0.0, 0.05),
        )
    return weights
