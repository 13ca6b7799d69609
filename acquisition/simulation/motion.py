"""Motion of the two modes of the simulated pendulum, integrated as far as requested, in constant memory."""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation import equation_of_motion
from acquisition.simulation.equation_of_motion import (
    ANGLE,
    COLUMNS,
    DIRECTION,
    LENGTH,
    POLYNOMIAL,
    RATE,
    START,
    TIME,
    ModeConstants,
)
from acquisition.simulation.ground import ground_of
from acquisition.simulation.settings import ARCSEC_RAD, ContactTruth, FastModeTruth, SimulationSettings
from acquisition.simulation.smooth_series import DEGREE, Pieces, SmoothSeries
from processing.errors import ConfigurationError

_MAX_STEPS, _MAX_TURNING_POINTS = 256, 64
"""Steps of the integration, and turning points, for which a block has room."""


def contact_radius_m(contact: ContactTruth) -> float:
    """Radius of the contact: as stated, or by Hertz's theory for a ball under its share of the weight."""
    if contact.contact_radius_m is not None:
        return contact.contact_radius_m
    compliance = (1 - contact.ball_poisson_ratio**2) / contact.ball_youngs_modulus_pa + (
        1 - contact.flat_poisson_ratio**2
    ) / contact.flat_youngs_modulus_pa
    load_n = contact.mass_kg * contact.gravity_m_per_s2 / contact.balls
    return float(np.cbrt(0.75 * load_n * contact.ball_radius_m * compliance))


def slow_mode(contact: ContactTruth) -> ModeConstants:
    """Constants of the slow mode's equation of motion."""
    radius_m = contact_radius_m(contact)
    w0_rad_per_s = 2 * math.pi / contact.period0_s
    return ModeConstants(
        w0_rad_per_s=w0_rad_per_s,
        b=contact.b,
        p=contact.p,
        c=contact.c,
        n=contact.n,
        kappa=2
        * contact.balls
        * contact.gamma_pa
        * radius_m**2
        / (contact.mass_kg * contact.gravity_m_per_s2),
        ball_over_contact_radius=contact.ball_radius_m / radius_m,
        drag_s=contact.whole_drag_s,
        exact=contact.exact_pendulum,
        rolling=contact.ball_radius_m * w0_rad_per_s**2 / contact.gravity_m_per_s2,
    )


def fast_mode(contact: ContactTruth, fast: FastModeTruth) -> ModeConstants:
    """Constants of the fast mode: the same contact with a smaller moment of inertia."""
    slow = slow_mode(contact)
    return slow._replace(
        w0_rad_per_s=slow.w0_rad_per_s * fast.period_ratio,
        b=slow.b * fast.friction_factor,
        c=slow.c * fast.friction_factor,
        drag_s=fast.drag_s,
        exact=False,
    )


class Motion:
    """Motion of one mode, integrated block by block as far as it is asked for.

    Times must not decrease from call to call, because earlier blocks are discarded. Raises
    ConfigurationError where the elastic adhesion exceeds 90 % of gravity's restoring moment.

    Parameters
    ----------
    mode
        Constants of the equation of motion.
    angle_rad, rate_rad_per_s
        Angle and its derivative at `start_s`; before, the pendulum is held at `held_rad`.
    ground
        Angle that the ground adds to the rest position, in rad; None: the ground does not move.
    """

    def __init__(
        self,
        mode: ModeConstants,
        angle_rad: float,
        rate_rad_per_s: float,
        start_s: float,
        held_rad: float,
        ground: SmoothSeries | None = None,
    ) -> None:
        amplitude_rad = math.hypot(angle_rad, rate_rad_per_s / mode.w0_rad_per_s)
        softening = mode.kappa * 0.5 * math.pi * amplitude_rad**mode.n
        if softening > 0.9:
            raise ConfigurationError(
                f"simulation.contact.gamma_pa: the elastic adhesion is {softening:.2f} of gravity's "
                f"restoring moment at {amplitude_rad / ARCSEC_RAD:.4g} arcsec; at most 0.9 "
                "is possible: lower gamma_pa"
            )
        self._mode = mode
        self._ground = ground
        self._still_ground = Pieces(0.0, 1.0, np.empty((0, DEGREE + 1)))
        self._collocation = equation_of_motion.collocation()
        self._steps = np.zeros((_MAX_STEPS, COLUMNS))
        self._turning_points = np.zeros((_MAX_TURNING_POINTS, 2))
        self._state = np.zeros(4)
        self._step_index = 0
        self._n_steps = 0
        self._kicks: list[tuple[float, float]] = []
        self._held = False
        if start_s > 0:
            self._steps[0, : POLYNOMIAL + 1] = 0.0, start_s, held_rad
            self._n_steps = 1
        self._state[:] = start_s, angle_rad, rate_rad_per_s, 0.0
        self._set_direction()

    def kick(self, time_s: float, rate_rad_per_s: float) -> None:
        """Change the rate instantly at `time_s`, which must not be before a time already requested."""
        end_s = self._state[TIME]
        if time_s < end_s:
            self._discard_after(time_s)
        self._kicks = sorted([*self._kicks, (time_s, rate_rad_per_s)])

    def hold(self, time_s: float, angle_rad: float) -> None:
        """Hold the pendulum at this angle from `time_s` until `release`."""
        self._bring_to(time_s)
        self._held = True
        self._state[ANGLE] = angle_rad
        self._state[RATE] = 0.0
        self._set_direction()

    def release(self, time_s: float) -> None:
        """Release the pendulum at `time_s`, at rest at the angle at which it is held."""
        self._bring_to(time_s)
        self._held = False
        self._set_direction()

    def set_load(self, time_s: float, push_rad: float, drag_s: float) -> None:
        """Apply a constant moment (as shift of the rest position) and a linear drag from `time_s` on."""
        self._bring_to(time_s)
        self._mode = self._mode._replace(push_rad=push_rad, drag_s=drag_s)
        self._set_direction()

    def sample(self, times_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Angles in rad and rates in rad/s at `times_s` (n,), which must not decrease."""
        angles = np.empty(len(times_s))
        rates = np.empty(len(times_s))
        sampled = 0
        while True:
            self._step_index, sampled = equation_of_motion.sample(
                self._steps, self._step_index, self._n_steps, times_s, sampled, angles, rates
            )
            if sampled == len(times_s):
                return angles, rates
            self.advance(math.inf)

    def advance(self, until_s: float) -> NDArray[np.float64]:
        """Integrate one block further, at most to `until_s`.

        Returns the turning points passed: (k, 2), time in s and angle in rad.
        """
        while self._kicks and self._kicks[0][0] <= self._state[TIME]:
            self._state[RATE] += 0.0 if self._held else self._kicks[0][1]
            self._kicks.pop(0)
            self._set_direction()
        stop_s = min(until_s, self._kicks[0][0]) if self._kicks else until_s
        if math.isinf(stop_s):
            # while friction holds the pendulum, a single step would never end
            stop_s = self._state[TIME] + 100 * 2 * math.pi / self._mode.w0_rad_per_s
        pieces = self._pieces()
        if len(pieces.coefficients):
            stop_s = min(stop_s, pieces.start_s + len(pieces.coefficients) * pieces.step_s)
        self._step_index = 0
        self._n_steps, n_turning_points = equation_of_motion.advance(
            self._state, stop_s, pieces, self._mode, self._collocation, self._steps, self._turning_points
        )
        return self._turning_points[:n_turning_points].copy()

    @property
    def w0_rad_per_s(self) -> float:
        """Angular frequency at vanishing amplitude without elasticity."""
        return self._mode.w0_rad_per_s

    @property
    def reached_s(self) -> float:
        """Time up to which the motion has been integrated."""
        return float(self._state[TIME])

    @property
    def at_rest(self) -> bool:
        """Whether friction holds the pendulum, and neither an impulse nor the ground moves it later."""
        return bool(self._state[DIRECTION] == 0.0) and not self._kicks and self._ground is None

    def _pieces(self) -> Pieces:
        """Driving angle of the ground from now on; zero while the pendulum is held."""
        if self._ground is None or self._held:
            return self._still_ground
        time_s = float(self._state[TIME])
        if time_s > self._ground.end_s - 1e-6 / self._ground.rate_hz:
            raise ConfigurationError(
                f"simulation.ground.file: the file ends after {self._ground.end_s:.6g} s of a longer "
                "run; use a longer file, a smaller file_offset_s, or simulation.max_duration_s"
            )
        return self._ground.pieces(time_s)

    def _bring_to(self, time_s: float) -> None:
        """Bring the state to `time_s`: integrate up to it, or discard what was integrated after it."""
        if self._state[TIME] > time_s:
            self._discard_after(time_s)
        while self._state[TIME] < time_s:
            self.advance(time_s)

    def _set_direction(self) -> None:
        """Set the direction of the state: that of the motion, or in which it starts from rest."""
        rate = self._state[RATE]
        if self._held:
            self._state[DIRECTION] = 0.0
        elif rate != 0.0:
            self._state[DIRECTION] = math.copysign(1.0, rate)
        else:
            self._state[DIRECTION] = equation_of_motion.direction_at(
                self._state[TIME], self._state[ANGLE], self._pieces(), self._mode
            )

    def _discard_after(self, time_s: float) -> None:
        """Discard the motion that was integrated after `time_s`."""
        angles, rates = np.empty(1), np.empty(1)
        last, _ = equation_of_motion.sample(
            self._steps, self._step_index, self._n_steps, np.array([time_s]), 0, angles, rates
        )
        step, length_s = self._steps[last], time_s - self._steps[last, START]
        # the polynomial is one of the time relative to the step's length
        step[POLYNOMIAL:] *= (length_s / step[LENGTH]) ** np.arange(COLUMNS - POLYNOMIAL)
        step[LENGTH] = length_s
        self._n_steps = last + 1
        self._state[:3] = time_s, angles[0], rates[0]
        self._set_direction()


def motions(settings: SimulationSettings, run: int = 0) -> tuple[Motion, Motion]:
    """Motions of the fast and the slow mode: the release of the settings, the ground of this run."""
    ground = ground_of(settings, run)
    slow_ground, fast_ground = (None, None) if ground is None else ground.drive_rad
    slow = slow_mode(settings.contact)
    fast = fast_mode(settings.contact, settings.fast)
    release, phase_rad = settings.release, settings.fast.phase_rad
    start_s, is_held = release.at_s, release.way == "let go"
    slow_rad, fast_rad = release.amplitude_arcsec * ARCSEC_RAD, settings.fast.amplitude_arcsec * ARCSEC_RAD
    if release.way == "by command":
        start_s = slow_rad = fast_rad = 0.0
    slow_start = (slow_rad, 0.0) if is_held else (0.0, slow_rad * slow.w0_rad_per_s)
    fast_start = fast_rad * math.cos(phase_rad), -fast_rad * fast.w0_rad_per_s * math.sin(phase_rad)
    return (
        Motion(fast, *fast_start, start_s, fast_start[0] if is_held else 0.0, fast_ground),
        Motion(slow, *slow_start, start_s, slow_rad if is_held else 0.0, slow_ground),
    )
