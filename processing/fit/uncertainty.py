"""Reported quantities, by the fitted parameters and the rig's input quantities, and their GUM budgets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import hypot, inf, isfinite, nan, pi, sqrt
from typing import Annotated, Literal

import numpy as np

from processing.arrays import Floats
from processing.contact import STANDARD_GRAVITY_M_PER_S2, Material, PendulumOnBall, contact_radius
from processing.contact.laws import DRAG, PAPER
from processing.estimate import Estimate
from processing.fit.evidence import AIR
from processing.fit.result import MEASUREMENT, FitResult
from processing.quantity import OF, OWN, PART, PER, DerivedQuantity, Quantity, quantities_of
from processing.units import in_ascii

OUTPUTS: Mapping[str, str] = {
    **{parameter.key: in_ascii(parameter.unit) for parameter in PAPER.parameters},
    **{name: declared.unit for name, declared in quantities_of(DerivedQuantity).items()},
}
"""Reported quantities and their units; `drag_s` (s) is added if it was fitted."""


@dataclass(frozen=True, slots=True)
class InputQuantity:
    """An input quantity that the fit takes as known: value and standard uncertainty."""

    value: float
    u: float = 0.0
    dof: float = inf
    """Degrees of freedom of an uncertainty that was itself estimated from some readings."""


@dataclass(frozen=True)
class RigQuantities:
    """All input quantities of the results other than the half-cycles (GUM type B)."""

    mass_kg: InputQuantity
    ball_radius_m: InputQuantity
    ball: Material
    flat: Material
    arm_m: InputQuantity
    """Arm, and pixel pitch, of the conversion of pixels into angles; relative uncertainties contribute."""
    pitch_m: InputQuantity
    gravity_m_per_s2: InputQuantity = InputQuantity(STANDARD_GRAVITY_M_PER_S2)
    clock: InputQuantity = InputQuantity(1.0)
    """True seconds per second of the camera's clock."""
    slow_angle_rad: InputQuantity = InputQuantity(0.0)
    """Direction of the pendulum's slow axis on the sensor."""
    non_orthogonality_rad: InputQuantity = InputQuantity(0.0)
    """Angle between the pendulum's axes on the sensor, less a right angle."""
    fast_ratio: float = 0.0
    """Ratio of the fast to the slow mode's amplitude, for the cross-talk of wrong directions."""
    skew: InputQuantity = InputQuantity(0.0)
    """Skew of the lever; a wrong one changes the scale where the pendulum rests."""
    rest_rad: float = 0.0
    """Tilt of the rest position from the lever's reference."""
    contact_radius_m: InputQuantity | None = None
    """Stated radius of the contact in place of Hertz's, which no material and no load changes."""
    balls: int = 1
    """Number of balls that carry the weight, 1 or 2."""
    row_time_s: InputQuantity = InputQuantity(0.0)
    """Row time of a rolling shutter; 0 for a global one."""
    ageing: InputQuantity = InputQuantity(0.0)
    """Relative growth of b over a run, which the fit takes as zero, and so that of c, drag and period."""
    adhesion_ageing: InputQuantity = InputQuantity(0.0)
    drag_drift: InputQuantity = InputQuantity(0.0)
    period_drift: InputQuantity = InputQuantity(0.0)
    common_amplitude_rad: InputQuantity = InputQuantity(0.0)
    """Amount by which all amplitudes are too small: the compression of a film takes as much from each."""
    plane_of_swing_rad: InputQuantity = InputQuantity(0.0)
    """Error of the angle by which a decay was rotated whose plane of swing turned."""

    def inputs(self) -> dict[str, InputQuantity]:
        """All inputs by name; if both bodies are of the same material, it is listed once."""
        inputs: dict[str, InputQuantity] = {}
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if isinstance(value, InputQuantity):
                inputs[name] = value
            elif self.contact_radius_m is None and (
                name == "flat" or (name == "ball" and value != self.flat)
            ):
                for constant in ("youngs_modulus_pa", "poisson_ratio"):
                    known = InputQuantity(getattr(value, constant), getattr(value, f"u_{constant}"))
                    inputs[f"{name}_{constant}"] = known
        return inputs

    def skewed_scale(self, skew: Floats) -> Floats:
        """Ratio of true tilts about the rest position to the measured ones, for true skews (n,).

        The spot moves by ``t + skew t^2`` for a tilt with the tangent t of its double; its derivative at rest
        is ``1 + 2 skew t``. The second harmonic that a skew adds to a swing moves the fitted centre and
        neither its amplitude nor its turning points.
        """
        tangent = np.tan(2.0 * self.rest_rad)
        return np.asarray((1 + 2 * self.skew.value * tangent) / (1 + 2 * skew * tangent), dtype=np.float64)

    def seen_slow_tilt(self, slow_angle_rad: Floats, non_orthogonality_rad: Floats) -> Floats:
        """Ratio of the slow tilt, measured with assumed axes, to the true one, for true directions (n,).

        If the slow axis is wrong by d and the angle between the axes by e, a motion of amplitude A along the
        slow axis and r A along the fast axis is measured along the assumed slow axis as ``A (cos d + sin d
        tan q) - r A sin(d + e) / cos q``, with the assumed non-orthogonality q. The sign of the fast mode's
        contribution varies from one turning point to another; using one sign gives an upper limit.
        """
        assumed = self.non_orthogonality_rad.value
        slow_error = slow_angle_rad - self.slow_angle_rad.value
        angle_error = non_orthogonality_rad - assumed
        cross_talk = self.fast_ratio * np.sin(slow_error + angle_error) / np.cos(assumed)
        along_slow = np.cos(slow_error) + np.sin(slow_error) * np.tan(assumed)
        return np.asarray(along_slow - cross_talk, dtype=np.float64)

    def pendulum(self) -> PendulumOnBall:
        """The pendulum for the fits, from the values; with two balls, half of the mass."""
        mass = self.mass_kg.value / self.balls
        force = mass * self.gravity_m_per_s2.value
        if self.contact_radius_m is not None:
            radius = self.contact_radius_m.value
        else:
            radius = contact_radius(force, self.ball_radius_m.value, self.ball, self.flat)
        return PendulumOnBall(mass, self.ball_radius_m.value, radius, self.gravity_m_per_s2.value)


@dataclass(frozen=True, slots=True)
class Work:
    """Works of one cycle: that of friction (4A), the part of it by adhesion (4A_t), that of a linear drag."""

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
    values = np.array([inputs[name] for name in fit.names]) + fit.by_log_rho[:, None] * log_rho_shift
    assumed = rig.inputs()
    for name, slope in fit.by_inputs.items():
        values[: len(slope)] += slope[:, None] * (inputs[name] - assumed[name].value)
    b, p, c, n, period0, gamma = values[:6]
    nominal_force = nominal.mass_kg * nominal.gravity_m_per_s2
    reported = {
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
    if fit.has_drag:
        reported[DRAG.key] = values[fit.names.index(DRAG.key)] * second
    return reported


def rolling_moment_nm(inputs: Mapping[str, Floats], rig: RigQuantities) -> Floats:
    """m g R (n,) of one ball with its share of the weight, to which Eqs. 1 and 3 are relative."""
    load_n = inputs["mass_kg"] / rig.balls * inputs["gravity_m_per_s2"]
    return np.asarray(load_n * inputs["ball_radius_m"])


def works_per_cycle_j(
    amplitude_rad: float, reported: Mapping[str, Floats], moment_nm: Floats
) -> dict[str, Floats]:
    """Works of one cycle in J for values (n,) of reported parameters and m g R.

    `dissipated` is 4A = 4 m g R (c alpha + b alpha^(p+1)/(p+1)), the area of the loop; `adhesive` is 4A_t,
    its part by c (the dashed rectangle of Table 4); `drag` is that of a linear drag, not contained in 4A.
    """
    b, p, c = reported["b"], reported["p"], reported["c"]
    adhesive = 4 * moment_nm * c * amplitude_rad
    internal = 4 * moment_nm * b * amplitude_rad ** (p + 1) / (p + 1)
    per_s = 2 * pi**2 / reported["period0_s"] * amplitude_rad**2
    drag = moment_nm * reported.get(DRAG.key, np.zeros(())) * per_s
    return {"dissipated": adhesive + internal, "adhesive": adhesive, "drag": drag}


GROUND = "ground"
"""Name of the part of a fit's uncertainty that no term explains: that by the drive of the ground."""


@dataclass(frozen=True, slots=True)
class BudgetSource:
    """Contribution of one source to the uncertainty of one quantity."""

    source: str
    type: Literal["A", "B"]
    """A for a source estimated from the data, B for a stated one."""
    u_source: Annotated[float, Quantity("", "of the source", unit=OF + "source")]
    sensitivity: Annotated[
        float, Quantity("", "derivative with respect to the source", unit=OWN + PER + OF + "source")
    ]
    """Derivative with respect to the source; NaN for the fit, which has several parameters."""
    contribution: Annotated[float, PART]
    """Resulting standard uncertainty in the quantity's unit."""
    share: float
    """Fraction of the combined variance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """GUM budget of one quantity, largest contribution first."""

    unit: str = ""
    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    degrees_of_freedom: float = nan
    """Effective ones (Welch-Satterthwaite), infinite where all sources are stated."""
    sources: Annotated[tuple[BudgetSource, ...], PART] = ()

    @property
    def coverage_factor_95(self) -> float:
        """Student's t for 95 %, with 1e9 degrees of freedom where they are infinite or NaN."""
        from scipy.special import stdtrit

        return float(stdtrit(self.degrees_of_freedom if self.degrees_of_freedom < 1e9 else 1e9, 0.975))

    @property
    def apparatus_u(self) -> float:
        """Standard uncertainty by the stated sources without the air, which counts with the decay."""
        stated = (source for source in self.sources if source.type == "B" and source.source != AIR)
        return hypot(*(source.contribution for source in stated))

    def shares_only(self) -> "Budget":
        """The budget with its sources' shares, and without the numbers from which its value would follow."""
        sources = tuple(replace(source, contribution=nan) for source in self.sources)
        return replace(self, value=nan, standard_uncertainty=nan, sources=sources)


Model = Callable[[Mapping[str, Floats]], Mapping[str, Floats]]
"""Quantities (n,) of input quantities (n,), fitted values among them, by name."""


def sensitivities(model: Model, inputs: Mapping[str, InputQuantity]) -> dict[str, dict[str, float]]:
    """Derivatives of each quantity of a model with respect to each uncertain input, at the inputs' values.

    They are central differences over a thousandth of each standard uncertainty, with a relative error of 1e-6
    for quantities that are nearly linear over the uncertainty.
    """
    derivatives: dict[str, dict[str, float]] = {}
    for source, quantity in inputs.items():
        if quantity.u == 0:
            continue
        step = 1e-3 * quantity.u
        shifted = {name: np.full(2, other.value) for name, other in inputs.items()}
        shifted[source] = quantity.value + np.array([-step, step])
        for name, values in model(shifted).items():
            derivatives.setdefault(name, {})[source] = float(values[1] - values[0]) / (2 * step)
    return derivatives


def budget_of(
    unit: str,
    value: float,
    parts: Sequence[tuple[str, Literal["A", "B"], float, float, float]],
    estimated: Sequence[tuple[float, float]] = (),
) -> Budget:
    """The budget of one quantity by its parts: root of the sum of squares, Welch-Satterthwaite.

    Parameters
    ----------
    parts
        The fields of `BudgetSource` but the share.
    estimated
        Contributions whose uncertainty is an estimate, with its degrees of freedom; parts that were
        estimated together count as one.
    """
    combined = sqrt(sum(part[4] ** 2 for part in parts))
    per_dof = sum(contribution**4 / dof for contribution, dof in estimated)
    dof = combined**4 / per_dof if per_dof > 0 and isfinite(combined) else inf
    sources = []
    for source, kind, u, sensitivity, contribution in sorted(parts, key=lambda part: -part[4]):
        share = (contribution / combined) ** 2 if isfinite(combined) else float(contribution == inf)
        sources.append(BudgetSource(source, kind, u, sensitivity, contribution, share))
    return Budget(
        unit=unit, value=value, standard_uncertainty=combined, degrees_of_freedom=dof, sources=tuple(sources)
    )


def budgets(fit: FitResult, rig: RigQuantities) -> dict[str, Budget]:
    """A budget for every reported quantity."""
    inputs = {name: np.full(1, known.value) for name, known in {**_fitted(fit), **rig.inputs()}.items()}
    reported = reported_quantities(fit, inputs, rig)
    by_value, by_input = _derivatives(fit, rig, lambda inputs: reported_quantities(fit, inputs, rig))
    units = {**OUTPUTS, **({DRAG.key: "s"} if fit.has_drag else {})}
    return {
        name: _budget(name, unit, float(reported[name][0]), fit, rig, by_value[name], by_input.get(name, {}))
        for name, unit in units.items()
    }


def _fitted(fit: FitResult) -> dict[str, InputQuantity]:
    """The fitted values by name; a value that nothing determines has a small `u`, for its derivatives."""
    return {
        name: InputQuantity(value, u if 0 < u < inf else 1e-3 * abs(value) or 1e-9)
        for name, (value, u) in fit.estimates().items()
    }


def _derivatives(
    fit: FitResult, rig: RigQuantities, model: Model
) -> tuple[dict[str, Floats], dict[str, dict[str, float]]]:
    """Derivatives of each quantity with respect to the fitted values and each other uncertain input."""
    by_input = sensitivities(model, {**_fitted(fit), **rig.inputs()})
    by_value = {
        quantity: np.array([derivatives.pop(name) for name in fit.names])
        for quantity, derivatives in by_input.items()
    }
    return by_value, by_input


def standard_uncertainties(fit: FitResult, rig: RigQuantities, model: Model) -> dict[str, float]:
    """Standard uncertainties of the quantities of a model by the fit and the other inputs, to first order."""
    by_value, by_input = _derivatives(fit, rig, model)
    inputs = rig.inputs()
    return {
        name: hypot(
            _type_a(fit, derivatives),
            *(slope * inputs[source].u for source, slope in by_input.get(name, {}).items()),
        )
        for name, derivatives in by_value.items()
    }


def _budget(
    name: str,
    unit: str,
    value: float,
    fit: FitResult,
    rig: RigQuantities,
    by_value: Floats,
    by_input: Mapping[str, float],
) -> Budget:
    type_a = _type_a(fit, by_value)
    parts: list[tuple[str, Literal["A", "B"], float, float, float]] = []
    if type_a > 0:
        u_own = fit.estimate(name).standard_uncertainty if name in fit.names else nan
        u_by_term, air = _by_term(fit, by_value, type_a)
        of_data = sqrt(1 - (air / type_a) ** 2) if isfinite(type_a) else 1.0
        for source, u in u_by_term.items():
            contribution = u * of_data
            if contribution > 0:
                share = contribution / type_a if isfinite(type_a) else 1.0
                parts.append((source, "A", u_own * share, nan, contribution))
        if air > 0 and isfinite(type_a):
            parts.append((AIR, "B", u_own * air / type_a, nan, air))
            type_a *= of_data
    inputs = rig.inputs()
    for source, slope in by_input.items():
        u = inputs[source].u
        if slope != 0:
            parts.append((source, "B", u, slope, abs(slope) * u))
    estimated = [(type_a, float(fit.dof))] if 0 < type_a < inf else []
    estimated += [(part[4], inputs[part[0]].dof) for part in parts if part[0] in inputs]
    return budget_of(unit, value, parts, estimated)


def _by_term(fit: FitResult, by_value: Floats, type_a: float) -> tuple[dict[str, float], float]:
    """Type A uncertainty by the terms of the fit, and that by the air; the parts never exceed the whole."""
    if not isfinite(type_a):
        return {MEASUREMENT: type_a}, 0.0
    u_by_term, variance = {}, type_a**2
    for name in fit.terms:
        if name not in (MEASUREMENT, AIR):
            u_by_term[name] = min(_u_by(fit.covariance_by(name), by_value), sqrt(variance))
            variance = max(variance - u_by_term[name] ** 2, 0.0)
    remaining = sqrt(variance)
    measurement = _u_by(fit.covariance_by(MEASUREMENT), by_value) if MEASUREMENT in fit.terms else remaining
    # equal but for rounding, which must not become a part of the ground
    measurement = measurement if measurement < 0.999 * remaining else remaining
    ground = sqrt(max(variance - measurement**2, 0.0))
    air = min(_u_by(fit.covariance_by(AIR), by_value), remaining)
    return {MEASUREMENT: measurement, GROUND: ground, **u_by_term}, air


def _type_a(fit: FitResult, by_value: Floats) -> float:
    """Standard uncertainty by the fit; infinite where the quantity depends on an undetermined parameter."""
    blind = ~np.isfinite(np.diag(fit.covariance))
    return inf if np.any(by_value[blind] != 0) else _u_by(fit.covariance, by_value)


def _u_by(covariance: Floats, by_value: Floats) -> float:
    """Standard uncertainty by the finite elements of a covariance of the values."""
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    return sqrt(max(float(by_value @ known @ by_value), 0.0))
