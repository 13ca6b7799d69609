"""From fitted parameters and the rig's own quantities to what is reported."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material, PendulumOnBall, contact_radius
from processing.contact.laws import DRAG, PAPER
from processing.errors import ConfigurationError, DataError
from processing.fit.result import FitResult

Distribution = Literal["normal", "rectangular"]

OUTPUTS: Mapping[str, str] = {
    "b": "rad^-p",
    "p": "1",
    "c": "1",
    "n": "1",
    "period0_s": "s",
    "gamma_pa": "Pa",
    "surface_energy_table2_j_per_m2": "J/m^2",
    "surface_energy_eq2_j_per_m2": "J/m^2",
    "contact_radius_m": "m",
    "contact_depth_m": "m",
    "contact_angle_rad": "rad",
}
"""Reported quantities and their units; `drag_s` (s) joins where it was fitted."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """An input that the fit takes as known: value, standard uncertainty, kind of knowledge.

    A rectangular distribution of half-width h has the standard uncertainty h/sqrt(3).
    """

    value: float
    u: float = 0.0
    distribution: Distribution = "normal"

    def __post_init__(self) -> None:
        if not self.u >= 0:
            raise ConfigurationError(
                f"standard uncertainty {self.u} of the value {self.value}: it must not be negative"
            )


@dataclass(frozen=True)
class RigQuantities:
    """Everything beside the swings that the results rest on (GUM type B).

    `arm_m` and `pitch_m` are those with which the angles were made: they matter through their
    relative uncertainties, as does `clock`, true seconds per second of the camera's clock.
    `slow_angle_rad` and `non_orthogonality_rad` are the directions of the pendulum's axes on the sensor;
    `fast_ratio` is the fast mode's amplitude over the slow one's, which wrong directions let into the
    slow deflection. `balls` shares the weight: 1, or 2 for the two-ball pendulum.
    """

    mass_kg: Quantity
    ball_radius_m: Quantity
    ball: Material
    flat: Material
    arm_m: Quantity
    pitch_m: Quantity
    gravity_m_per_s2: Quantity = Quantity(STANDARD_GRAVITY_M_PER_S2)
    clock: Quantity = Quantity(1.0)
    slow_angle_rad: Quantity = Quantity(0.0)
    non_orthogonality_rad: Quantity = Quantity(0.0)
    fast_ratio: float = 0.0
    balls: int = 1

    def __post_init__(self) -> None:
        for name in ("mass_kg", "ball_radius_m", "arm_m", "pitch_m", "gravity_m_per_s2", "clock"):
            value = getattr(self, name).value
            if not value > 0:
                raise ConfigurationError(f"{name} = {value}: it must be positive")
        if self.balls not in (1, 2):
            raise ConfigurationError(f"balls = {self.balls}: a pendulum stands on 1 or 2")

    def inputs(self) -> dict[str, Quantity]:
        """All inputs by name; one material on both sides enters once."""
        found = {
            "mass_kg": self.mass_kg,
            "ball_radius_m": self.ball_radius_m,
            "gravity_m_per_s2": self.gravity_m_per_s2,
            "arm_m": self.arm_m,
            "pitch_m": self.pitch_m,
            "clock": self.clock,
            "flat_youngs_modulus_pa": Quantity(self.flat.youngs_modulus_pa, self.flat.u_youngs_modulus_pa),
            "flat_poisson_ratio": Quantity(self.flat.poisson_ratio, self.flat.u_poisson_ratio),
        }
        if self.ball != self.flat:
            found["ball_youngs_modulus_pa"] = Quantity(
                self.ball.youngs_modulus_pa, self.ball.u_youngs_modulus_pa
            )
            found["ball_poisson_ratio"] = Quantity(self.ball.poisson_ratio, self.ball.u_poisson_ratio)
        # last, so that the draws for the others stay those of records made before axes were budgeted
        found["slow_angle_rad"] = self.slow_angle_rad
        found["non_orthogonality_rad"] = self.non_orthogonality_rad
        return found

    def seen_slow_tilt(
        self, slow_angle_rad: NDArray[np.float64], non_orthogonality_rad: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Slow tilt as the assumed axes show it, over the true one, for true directions of the axes.

        With the slow axis off by d and the angle between the axes by e, a motion of the amplitude A
        along the slow axis and r A along the fast one shows ``A (cos d + sin d tan q) - r A
        sin(d + e) / cos q`` along the assumed slow axis, q being the assumed non-orthogonality. The
        fast mode's part changes its sign from one turning point to another; taking it with one sign
        is its upper limit.
        """
        assumed = self.non_orthogonality_rad.value
        off = slow_angle_rad - self.slow_angle_rad.value
        apart = non_orthogonality_rad - assumed
        cross_talk = self.fast_ratio * np.sin(off + apart) / np.cos(assumed)
        return np.asarray(np.cos(off) + np.sin(off) * np.tan(assumed) - cross_talk, dtype=np.float64)

    def pendulum(self) -> PendulumOnBall:
        """What the fits take, from the values; on two balls, the half of it that one carries."""
        mass = self.mass_kg.value / self.balls
        force = mass * self.gravity_m_per_s2.value
        radius = contact_radius(force, self.ball_radius_m.value, self.ball, self.flat)
        return PendulumOnBall(mass, self.ball_radius_m.value, radius, self.gravity_m_per_s2.value)


@dataclass(frozen=True)
class Measured:
    """What the swings say, from one fit or from a series: type A.

    `names` are the six contact parameters and, where fitted, the drag. `dof` are the degrees of
    freedom of the covariance.
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    covariance: NDArray[np.float64]
    dof: float
    by_log_rho: NDArray[np.float64]
    reference_rad: float


def measured(result: FitResult) -> Measured:
    """The contact parameters of one fit, without its amplitude and time of start."""
    if not result.calibrated:
        raise DataError(
            "the amplitudes were not calibrated: nothing can be reported in SI units; calibrate the record"
        )
    names = result.contact_names
    at = [result.names.index(name) for name in names]
    return Measured(
        names,
        result.values[at],
        result.covariance[np.ix_(at, at)],
        float(result.dof),
        result.by_log_rho[at],
        result.reference_rad,
    )


def report(
    found: Measured,
    values: NDArray[np.float64],
    inputs: Mapping[str, NDArray[np.float64]],
    rig: RigQuantities,
) -> dict[str, NDArray[np.float64]]:
    """The reported quantities for fitted values and inputs other than the nominal ones.

    Parameters
    ----------
    values
        Fitted parameters, shape ``(names, draws)``.
    inputs
        Arrays of shape ``(draws,)`` by the names of `RigQuantities.inputs`.

    Notes
    -----
    The decay knows angles in units of the assumed scale and times in units of the assumed second:
    c goes with the scale s, b with s^(1-p), gamma with s^-n, T0 and the drag with the second; what
    the period knows of gamma is ``2 gamma a^2/(m g)``. R/a also bends Eq. 3 a little, which the
    fit's own derivative by it carries over.
    """
    if found.names[:6] != PAPER.names():
        raise DataError(f"expected the parameters {PAPER.names()} first, got {found.names}")
    nominal = rig.pendulum()
    mass = inputs["mass_kg"] / rig.balls
    radius, gravity = inputs["ball_radius_m"], inputs["gravity_m_per_s2"]
    force = mass * gravity
    flat = (1 - inputs["flat_poisson_ratio"] ** 2) / inputs["flat_youngs_modulus_pa"]
    ball = flat
    if rig.ball != rig.flat:
        ball = (1 - inputs["ball_poisson_ratio"] ** 2) / inputs["ball_youngs_modulus_pa"]
    a = (0.75 * force * radius * (flat + ball)) ** (1 / 3)
    scale = (inputs["pitch_m"] / rig.pitch_m.value) / (inputs["arm_m"] / rig.arm_m.value)
    scale = scale / rig.seen_slow_tilt(inputs["slow_angle_rad"], inputs["non_orthogonality_rad"])
    second = inputs["clock"] / rig.clock.value

    nominal_rho = nominal.ball_radius_m / nominal.contact_radius_m
    bent = np.log(radius / a / nominal_rho * scale)
    moved = values + found.by_log_rho[:, None] * bent
    b, p, c, n, period0, gamma = moved[:6]
    nominal_force = nominal.mass_kg * nominal.gravity_m_per_s2
    out = {
        "b": b * scale ** (1 - p),
        "p": p,
        "c": c * scale,
        "n": n,
        "period0_s": period0 * second,
        "gamma_pa": gamma * (nominal.contact_radius_m / a) ** 2 * (force / nominal_force) * scale**-n,
        "surface_energy_table2_j_per_m2": force * radius * c * scale / (2 * a**2),
        "surface_energy_eq2_j_per_m2": force * c * scale / (2 * a),
        "contact_radius_m": a,
        "contact_depth_m": a**2 / radius,
        "contact_angle_rad": a / radius,
    }
    if DRAG.key in found.names:
        out[DRAG.key] = moved[found.names.index(DRAG.key)] * second
    return out


def draw_fitted(found: Measured, rng: np.random.Generator, draws: int) -> NDArray[np.float64]:
    """Fitted parameters that the data allow, shape ``(names, draws)``.

    Multivariate Student t about the fit, in ln b and p, gamma and n taken at the reference
    amplitude: there the scatter is normal, where in b and gamma themselves it is skewed by their
    exponents.
    """
    spread = np.diag(found.covariance)
    if not np.all(np.isfinite(spread)):
        lost = ", ".join(name for name, v in zip(found.names, spread, strict=True) if not np.isfinite(v))
        raise DataError(f"nothing can be drawn for {lost}: the data do not determine it")
    values, log_r = found.values, float(np.log(found.reference_rad))
    to_normal = np.eye(len(values))
    to_normal[0, 0], to_normal[0, 1] = 1 / values[0], log_r  # ln(b r^(p-1))
    gamma_scale = np.exp(values[3] * log_r)
    to_normal[5, 5], to_normal[5, 3] = gamma_scale, values[5] * gamma_scale * log_r
    centre = values.copy()
    centre[0] = np.log(values[0]) + (values[1] - 1) * log_r if values[0] > 0 else np.nan
    centre[5] = values[5] * gamma_scale
    covariance = to_normal @ found.covariance @ to_normal.T
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0] = 1.0
    # correlations come close to 1, where Cholesky's factor fails and the eigenvalues' does not
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    factor = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    z = rng.standard_normal((len(values), draws))
    z *= np.sqrt(found.dof / rng.chisquare(found.dof, draws))
    out = centre[:, None] + scale[:, None] * (factor @ z)
    out[0] = np.exp(out[0] + (1 - out[1]) * log_r)
    out[5] = out[5] * np.exp(-out[3] * log_r)
    return np.asarray(out, dtype=np.float64)


def work_per_cycle_j(
    amplitude_rad: float,
    reported: Mapping[str, NDArray[np.float64]],
    inputs: Mapping[str, NDArray[np.float64]],
) -> NDArray[np.float64]:
    """4A for draws of the reported parameters, so that the work has an uncertainty too."""
    moment = inputs["mass_kg"] * inputs["gravity_m_per_s2"] * inputs["ball_radius_m"]
    b, p, c = reported["b"], reported["p"], reported["c"]
    dissipated = 4 * moment * (c * amplitude_rad + b * amplitude_rad ** (p + 1) / (p + 1))
    if DRAG.key in reported:
        dissipated = (
            dissipated + moment * reported[DRAG.key] * 2 * pi**2 / reported["period0_s"] * amplitude_rad**2
        )
    return np.asarray(dissipated, dtype=np.float64)
