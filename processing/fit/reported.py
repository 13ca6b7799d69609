"""Reported quantities, computed from the fitted parameters and the rig's input quantities."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi
from typing import Annotated

import numpy as np

from processing.arrays import Floats
from processing.contact.laws import DRAG, PAPER
from processing.derived import Derived
from processing.errors import DataError
from processing.estimate import Estimate
from processing.fit.apparatus import RigQuantities
from processing.fit.result import FitResult
from processing.quantity import Quantity, quantities_of
from processing.units import in_ascii

OUTPUTS: Mapping[str, str] = {
    **{parameter.key: in_ascii(parameter.unit) for parameter in PAPER.parameters},
    **{name: declared.unit for name, declared in quantities_of(Derived).items()},
}
"""Reported quantities and their units; `drag_s` (s) is added if it was fitted."""


@dataclass(frozen=True, slots=True)
class Work:
    """Work of one cycle: all of it (4A), the part of adhesion (4A_t), that of a linear drag."""

    amplitude_arcsec: float
    dissipated_4a_j: Annotated[Estimate, Quantity("4A", "work lost in a cycle", "fJ")]
    adhesive_4at_j: Annotated[Estimate, Quantity("4Aₜ", "work lost in a cycle by adhesion", "fJ")]
    drag_j: float = 0.0


@dataclass(frozen=True)
class FittedContact:
    """Fitted contact parameters with their type A covariance, from one fit or from a series.

    `names` are the six contact parameters and, if fitted, the drag. `dof` is the number of degrees of
    freedom of the covariance. `reading_covariance` is the part of it that remains on ground at rest,
    `place_covariance` the part of both that errors of position leave, `misfit_covariance` the part of it that
    the distance between law and data leaves, `change_covariance` that of a step during the run; None where
    they are not known.
    `by_air` is the change of the values for one standard uncertainty of what is known of the air, None where
    nothing is. `by_row_time` and `by_common_amplitude` are derivatives by the shutter's row time and by an
    error of all amplitudes; None where they are not known or not needed; `by_drifts` those by what drifts
    over a run, by the names of `RigQuantities`.
    """

    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    dof: float
    by_log_rho: Floats
    reference_rad: float
    reading_covariance: Floats | None = None
    by_row_time: Floats | None = None
    place_covariance: Floats | None = None
    misfit_covariance: Floats | None = None
    change_covariance: Floats | None = None
    by_drifts: Mapping[str, Floats] = field(default_factory=dict)
    by_air: Floats | None = None
    by_common_amplitude: Floats | None = None


def fitted_contact(result: FitResult) -> FittedContact:
    """The contact parameters of one fit, without the initial amplitude and time."""
    if not result.calibrated:
        raise DataError(
            "the amplitudes were not calibrated: nothing can be reported in SI units; calibrate the record"
        )
    names = result.contact_names
    at = [result.names.index(name) for name in names]
    within = np.ix_(at, at)
    return FittedContact(
        names,
        result.values[at],
        result.covariance[within],
        float(result.dof),
        result.by_log_rho[at],
        result.reference_rad,
        None if result.reading_covariance is None else result.reading_covariance[within],
        place_covariance=None if result.place_covariance is None else result.place_covariance[within],
        misfit_covariance=None if result.misfit_covariance is None else result.misfit_covariance[within],
        change_covariance=None if result.change_covariance is None else result.change_covariance[within],
        by_air=None if result.by_air is None else result.by_air[at],
    )


def reported_quantities(
    found: FittedContact, values: Floats, inputs: Mapping[str, Floats], rig: RigQuantities
) -> dict[str, Floats]:
    """The reported quantities for given fitted values and inputs.

    Parameters
    ----------
    values
        Fitted parameters, shape ``(names, draws)``.
    inputs
        Arrays of shape ``(draws,)`` by the names of `RigQuantities.inputs`.

    Notes
    -----
    The fit is made with the assumed angular scale and clock. If true angles are s times the assumed ones, c
    is proportional to s, b to s^(1-p) and gamma to s^-n; T0 and the drag are proportional to the true
    second. The period determines gamma only in the combination ``2 gamma a^2/(m g)``. The small additional
    effect of R/a in Eq. 3 is taken from the fit's derivative by ln(R/a).
    """
    if found.names[:6] != PAPER.names():
        raise DataError(f"expected the parameters {PAPER.names()} first, got {found.names}")
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
    bent = np.log(radius / a / nominal_rho * scale)
    moved = values + found.by_log_rho[:, None] * bent
    if found.by_row_time is not None:
        moved = moved + found.by_row_time[:, None] * (inputs["row_time_s"] - rig.row_time_s.value)
    if found.by_common_amplitude is not None:
        moved = moved + found.by_common_amplitude[:, None] * inputs["common_amplitude_rad"]
    for name, slope in found.by_drifts.items():
        moved = moved + slope[:, None] * inputs[name]
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
    if DRAG.key in found.names:
        out[DRAG.key] = moved[found.names.index(DRAG.key)] * second
    return out


def derived_quantities(
    c: Floats, scale: Floats, force_n: Floats, ball_radius_m: Floats, contact_radius_m: Floats
) -> dict[str, Floats]:
    """The fields of `Derived` by name, for arrays of equal shape; `scale` is true over assumed angle."""
    a = contact_radius_m
    return {
        "surface_energy_table2_j_per_m2": force_n * ball_radius_m * c * scale / (2 * a**2),
        "surface_energy_eq2_j_per_m2": force_n * c * scale / (2 * a),
        "contact_radius_m": a,
        "contact_depth_m": a**2 / ball_radius_m,
        "contact_angle_rad": a / ball_radius_m,
    }


def work_per_cycle_j(
    amplitude_rad: float, reported: Mapping[str, Floats], inputs: Mapping[str, Floats]
) -> Floats:
    """Work per cycle 4A in J for random draws (n,) of reported parameters and inputs, to obtain its
    uncertainty.
    """
    moment = inputs["mass_kg"] * inputs["gravity_m_per_s2"] * inputs["ball_radius_m"]
    b, p, c = reported["b"], reported["p"], reported["c"]
    dissipated = 4 * moment * (c * amplitude_rad + b * amplitude_rad ** (p + 1) / (p + 1))
    if DRAG.key in reported:
        per_s = moment * reported[DRAG.key]
        dissipated = dissipated + per_s * 2 * pi**2 / reported["period0_s"] * amplitude_rad**2
    return np.asarray(dissipated, dtype=np.float64)
