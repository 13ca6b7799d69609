"""Reported quantities, computed from the fitted parameters and the rig's input quantities (GUM type B)."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, pi
from typing import Annotated

import numpy as np

from processing.arrays import Floats
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material, PendulumOnBall, contact_radius
from processing.contact.laws import DRAG, PAPER
from processing.estimate import Estimate
from processing.fit.result import FitResult
from processing.quantity import DerivedQuantity, Quantity, quantities_of
from processing.units import in_ascii

OUTPUTS: Mapping[str, str] = {
    **{parameter.key: in_ascii(parameter.unit) for parameter in PAPER.parameters},
    **{name: declared.unit for name, declared in quantities_of(DerivedQuantity).items()},
}
"""Reported quantities and their units; `drag_s` (s) is added if it was fitted."""


@dataclass(frozen=True, slots=True)
class InputQuantity:
    """An input quantity that the fit takes as known: value and standard uncertainty.

    A rectangular distribution of half-width h has the standard uncertainty h/sqrt(3). `dof` are the degrees
    of freedom of an uncertainty that was itself estimated from some readings.
    """

    value: float
    u: float = 0.0
    dof: float = inf


@dataclass(frozen=True)
class RigQuantities:
    """All input quantities of the results other than the half-cycles (GUM type B).

    `arm_m` and `pitch_m` are the values with which pixels were converted into angles; they contribute by
    their relative uncertainties, as does `clock`, true seconds per second of the camera's clock.
    `slow_angle_rad` and `non_orthogonality_rad` are the directions of the pendulum's axes on the sensor.
    `fast_ratio` is the ratio of the fast to the slow mode's amplitude; if the directions are wrong, the fast
    mode contributes to the slow deflection. `skew` is that of the lever: a wrong one changes the scale where
    the pendulum rests, at the tilt `rest_rad` from the lever's reference. `balls` is the number of balls that
    carry the weight, 1 or 2. `row_time_s` is that of a rolling shutter, 0 of a global one.
    `ageing`, `adhesion_ageing`, `drag_drift` and `period_drift` are the relative growth over a run of the
    friction b, of c, of the drag and of the period, which the fit takes as zero. `common_amplitude_rad` is an
    amount by which all amplitudes are too small, zero as well: the compression of a film takes as much from
    each. `plane_of_swing_rad` is the error of the angle by which a decay was turned back whose plane of swing
    turned, zero as well. `contact_radius_m` is a stated radius of the contact in the place of Hertz's: the
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

    def inputs(self) -> dict[str, InputQuantity]:
        """All inputs by name; if both bodies are of the same material, it is listed once."""
        found: dict[str, InputQuantity] = {}
        by_materials = self.contact_radius_m is None
        for name in (one.name for one in fields(self)):
            value = getattr(self, name)
            if isinstance(value, InputQuantity):
                found[name] = value
            elif by_materials and (name == "flat" or (name == "ball" and self.ball != self.flat)):
                found |= _elastic(name, value)
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
        slow axis and r A along the fast axis is measured along the assumed slow axis as ``A (cos d + sin d
        tan q) - r A sin(d + e) / cos q``, with the assumed non-orthogonality q. The sign of the fast mode's
        contribution varies from one turning point to another; using one sign gives an upper limit.
        """
        assumed = self.non_orthogonality_rad.value
        slow_error = slow_angle_rad - self.slow_angle_rad.value
        angle_error = non_orthogonality_rad - assumed
        cross_talk = self.fast_ratio * np.sin(slow_error + angle_error) / np.cos(assumed)
        return np.asarray(
            np.cos(slow_error) + np.sin(slow_error) * np.tan(assumed) - cross_talk, dtype=np.float64
        )

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


@dataclass(frozen=True, slots=True)
class Work:
    """Work of one cycle: all of it (4A), the part of adhesion (4A_t), that of a linear drag."""

    amplitude_arcsec: float
    dissipated_4a_j: Annotated[Estimate, Quantity("4A", "work lost in a cycle", "fJ")]
    adhesive_4at_j: Annotated[Estimate, Quantity("4Aₜ", "work lost in a cycle by adhesion", "fJ")]
    drag_j: float = 0.0


def reported_quantities(
    fit: FitResult, inputs: Mapping[str, Floats], rig: RigQuantities
) -> dict[str, Floats]:
    """The reported quantities for given fitted values and inputs.

    Parameters
    ----------
    inputs
        Arrays of shape ``(draws,)`` by the names of the fitted parameters and of `RigQuantities.inputs`.

    Notes
    -----
    The fit is made with the assumed angular scale and clock. If true angles are s times the assumed ones, c
    is proportional to s, b to s^(1-p) and gamma to s^-n; T0 and the drag are proportional to the true
    second. The period determines gamma only in the combination ``2 gamma a^2/(m g)``. The small additional
    effect of R/a in Eq. 3 is taken from the fit's derivative with respect to ln(R/a).
    """
    nominal = rig.pendulum()
    mass = inputs["mass_kg"] / rig.balls
    radius, gravity = inputs["ball_radius_m"], inputs["gravity_m_per_s2"]
    force = mass * gravity
    if rig.contact_radius_m is not None:
        a = inputs["contact_radius_m"]
    else:
        flat = (1 - inputs["flat_poisson_ratio"] ** 2) / inputs["flat_youngs_modulus_pa"]
        ball = flat
        if rig.ball != rig.flat:
            ball = (1 - inputs["ball_poisson_ratio"] ** 2) / inputs["ball_youngs_modulus_pa"]
        a = (0.75 * force * radius * (flat + ball)) ** (1 / 3)
    scale = (inputs["pitch_m"] / rig.pitch_m.value) / (inputs["arm_m"] / rig.arm_m.value)
    scale = scale / rig.seen_slow_tilt(inputs["slow_angle_rad"], inputs["non_orthogonality_rad"])
    scale = scale * rig.skewed_scale(inputs["skew"])
    second = inputs["clock"] / rig.clock.value

    nominal_rho = nominal.ball_radius_m / nominal.contact_radius_m
    log_rho_shift = np.log(radius / a / nominal_rho * scale)
    moved = np.array([inputs[name] for name in fit.names]) + fit.by_log_rho[:, None] * log_rho_shift
    assumed = rig.inputs()
    for name, slope in fit.by_inputs.items():
        moved[: len(slope)] += slope[:, None] * (inputs[name] - assumed[name].value)
    b, p, c, n, period0, gamma = moved[:6]
    nominal_force = nominal.mass_kg * nominal.gravity_m_per_s2
    out = {
        "b": b * scale ** (1 - p),
        "p": p,
        "c": c * scale,
        "n": n,
        "period0_s": period0 * second,
        "gamma_pa": gamma * (nominal.contact_radius_m / a) ** 2 * (force / nominal_force) * scale**-n,
        **derived_quantities(c, scale, force, radius, a),
    }
    if fit.has_drag:
        out[DRAG.key] = moved[fit.names.index(DRAG.key)] * second
    return out


def derived_quantities(
    c: Floats, scale: Floats, force_n: Floats, ball_radius_m: Floats, contact_radius_m: Floats
) -> dict[str, Floats]:
    """The fields of `DerivedQuantity` by name, for arrays of equal shape; `scale` is true over assumed
    angle."""
    a = contact_radius_m
    return {
        "surface_energy_table2_j_per_m2": force_n * ball_radius_m * c * scale / (2 * a**2),
        "surface_energy_eq2_j_per_m2": force_n * c * scale / (2 * a),
        "contact_radius_m": a,
        "contact_depth_m": a**2 / ball_radius_m,
        "contact_angle_rad": a / ball_radius_m,
    }


def rolling_moment_nm(inputs: Mapping[str, Floats], rig: RigQuantities) -> Floats:
    """m g R (n,) of one ball with its part of the weight, to which Eqs. 1 and 3 are relative."""
    load_n = inputs["mass_kg"] / rig.balls * inputs["gravity_m_per_s2"]
    return np.asarray(load_n * inputs["ball_radius_m"])


def works_per_cycle_j(
    amplitude_rad: float, reported: Mapping[str, Floats], moment_nm: Floats
) -> dict[str, Floats]:
    """Works of one cycle in J for values (n,) of reported parameters and m g R.

    `dissipated` is 4A = 4 m g R (c alpha + b alpha^(p+1)/(p+1)), the area of the loop, `adhesive` 4A_t, its
    part by c (the dashed rectangle of Table 4), `drag` the work of a linear drag, which 4A does not contain.
    """
    b, p, c = reported["b"], reported["p"], reported["c"]
    adhesive = 4 * moment_nm * c * amplitude_rad
    internal = 4 * moment_nm * b * amplitude_rad ** (p + 1) / (p + 1)
    per_s = 2 * pi**2 / reported["period0_s"] * amplitude_rad**2
    drag = moment_nm * reported.get(DRAG.key, np.zeros(())) * per_s
    return {"dissipated": adhesive + internal, "adhesive": adhesive, "drag": drag}
