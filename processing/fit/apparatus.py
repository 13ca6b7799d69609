"""Input quantities of the results beside the swings (GUM type B): mass, ball, materials, lever arm, clock."""

from dataclasses import dataclass
from math import inf

import numpy as np

from processing.arrays import Floats
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material, PendulumOnBall, contact_radius
from processing.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class InputQuantity:
    """An input quantity that the fit takes as known: value and standard uncertainty.

    A rectangular distribution of half-width h has the standard uncertainty h/sqrt(3). `dof` are the degrees
    of freedom of an uncertainty that was itself estimated from some readings.
    """

    value: float
    u: float = 0.0
    dof: float = inf

    def __post_init__(self) -> None:
        if not self.u >= 0:
            raise ConfigurationError(
                f"standard uncertainty {self.u} of the value {self.value}: it must not be negative"
            )


@dataclass(frozen=True)
class RigQuantities:
    """All input quantities of the results other than the swings (GUM type B).

    `arm_m` and `pitch_m` are the values with which pixels were converted into angles; they contribute by
    their relative uncertainties, as does `clock`, true seconds per second of the camera's clock.
    `slow_angle_rad` and `non_orthogonality_rad` are the directions of the pendulum's axes on the sensor.
    `fast_ratio` is the ratio of the fast to the slow mode's amplitude; if the directions are wrong, the fast
    mode contributes to the slow deflection. `skew` is that of the lever: a wrong one changes the scale where
    the pendulum rests, at the tilt `rest_rad` from the lever's reference. `balls` is the number of balls that
    carry the weight, 1 or 2. `row_time_s` is that of a rolling shutter, 0 if it is not one.
    `ageing`, `adhesion_ageing`, `drag_drift` and `period_drift` are the relative growth over a run of the
    friction b, of c, of the drag and of the period, all nought as the fit has it. `common_amplitude_rad` is
    what all amplitudes are too small by, nought as well: the compression of a film takes as much from each.
    `plane_of_swing_rad` is the error of the angle by which a decay was turned back whose plane of swing
    turned, nought as well. `contact_radius_m` is a stated radius of the contact in the place of Hertz's: the
    materials are then not used, and the load does not change it.
    """

    mass_kg: InputQuantity
    ball_radius_m: InputQuantity
    ball: Material
    flat: Material
    arm_m: InputQuantity
    pitch_m: InputQuantity
    gravity_m_per_s2: InputQuantity = InputQuantity(STANDARD_GRAVITY_M_PER_S2)
    clock: InputQuantity = InputQuantity(1.0)
    slow_angle_rad: InputQuantity = InputQuantity(0.0)
    non_orthogonality_rad: InputQuantity = InputQuantity(0.0)
    fast_ratio: float = 0.0
    skew: InputQuantity = InputQuantity(0.0)
    rest_rad: float = 0.0
    contact_radius_m: InputQuantity | None = None
    balls: int = 1
    row_time_s: InputQuantity = InputQuantity(0.0)
    ageing: InputQuantity = InputQuantity(0.0)
    adhesion_ageing: InputQuantity = InputQuantity(0.0)
    drag_drift: InputQuantity = InputQuantity(0.0)
    period_drift: InputQuantity = InputQuantity(0.0)
    common_amplitude_rad: InputQuantity = InputQuantity(0.0)
    plane_of_swing_rad: InputQuantity = InputQuantity(0.0)

    def __post_init__(self) -> None:
        for name in ("mass_kg", "ball_radius_m", "arm_m", "pitch_m", "gravity_m_per_s2", "clock"):
            value = getattr(self, name).value
            if not value > 0:
                raise ConfigurationError(f"{name} = {value}: it must be positive")
        if self.balls not in (1, 2):
            raise ConfigurationError(f"balls = {self.balls}: a pendulum stands on 1 or 2")

    def inputs(self) -> dict[str, InputQuantity]:
        """All inputs by name; if both bodies are of the same material, it is listed once."""
        found = {
            "mass_kg": self.mass_kg,
            "ball_radius_m": self.ball_radius_m,
            "gravity_m_per_s2": self.gravity_m_per_s2,
            "arm_m": self.arm_m,
            "pitch_m": self.pitch_m,
            "clock": self.clock,
        }
        if self.contact_radius_m is not None:
            found["contact_radius_m"] = self.contact_radius_m
        else:
            found |= _elastic("flat", self.flat)
            if self.ball != self.flat:
                found |= _elastic("ball", self.ball)
        found["slow_angle_rad"] = self.slow_angle_rad
        found["non_orthogonality_rad"] = self.non_orthogonality_rad
        found["skew"] = self.skew
        found["row_time_s"] = self.row_time_s
        found["ageing"] = self.ageing
        found["period_drift"] = self.period_drift
        found["common_amplitude_rad"] = self.common_amplitude_rad
        found["plane_of_swing_rad"] = self.plane_of_swing_rad
        found["adhesion_ageing"] = self.adhesion_ageing
        found["drag_drift"] = self.drag_drift
        return found

    def skewed_scale(self, skew: Floats) -> Floats:
        """Ratio of true tilts about the rest position to the measured ones, for true skews (n,).

        The spot moves by ``t + skew t^2`` for a tilt with the tangent t of its double; its derivative at rest
        is ``1 + 2 skew t``. The second harmonic that a skew adds to a swing moves the fitted centre and
        neither its amplitude nor its turning points.
        """
        tangent = np.tan(2.0 * self.rest_rad)
        return np.asarray((1 + 2 * self.skew.value * tangent) / (1 + 2 * skew * tangent), dtype=np.float64)

    def seen_slow_tilt(self, slow_angle_rad: Floats, non_orthogonality_rad: Floats) -> Floats:
        """Ratio of the slow tilt measured with the assumed axes to the true one, for true axis directions
        (n,).

        If the slow axis is wrong by d and the angle between the axes by e, a motion of amplitude A along the
        slow axis and r A along the fast axis is measured along the assumed slow axis as
        ``A (cos d + sin d tan q) - r A sin(d + e) / cos q``, with the assumed non-orthogonality q. The sign
        of the fast mode's contribution varies from one turning point to another; using one sign gives an
        upper limit.
        """
        assumed = self.non_orthogonality_rad.value
        off = slow_angle_rad - self.slow_angle_rad.value
        apart = non_orthogonality_rad - assumed
        cross_talk = self.fast_ratio * np.sin(off + apart) / np.cos(assumed)
        return np.asarray(np.cos(off) + np.sin(off) * np.tan(assumed) - cross_talk, dtype=np.float64)

    def pendulum(self) -> PendulumOnBall:
        """The pendulum for the fits, from the values; with two balls, half of the mass."""
        mass = self.mass_kg.value / self.balls
        force = mass * self.gravity_m_per_s2.value
        if self.contact_radius_m is not None:
            radius = self.contact_radius_m.value
        else:
            radius = contact_radius(force, self.ball_radius_m.value, self.ball, self.flat)
        return PendulumOnBall(mass, self.ball_radius_m.value, radius, self.gravity_m_per_s2.value)


def _elastic(body: str, material: Material) -> dict[str, InputQuantity]:
    return {
        f"{body}_youngs_modulus_pa": InputQuantity(material.youngs_modulus_pa, material.u_youngs_modulus_pa),
        f"{body}_poisson_ratio": InputQuantity(material.poisson_ratio, material.u_poisson_ratio),
    }
