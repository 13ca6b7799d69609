"""Uncertainty of the reported quantities: their GUM budgets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, isfinite, nan, sqrt
from typing import Annotated, Literal

import numpy as np

from processing.arrays import Floats
from processing.contact.laws import DRAG
from processing.fit.evidence import AIR
from processing.fit.reported import OUTPUTS, InputQuantity, RigQuantities, reported_quantities
from processing.fit.result import MEASUREMENT, FitResult
from processing.quantity import OF, OWN, PART, PER, Quantity

GROUND = "ground"
"""Name of the part of a fit's uncertainty that no term explains: that by the drive of the ground."""


@dataclass(frozen=True, slots=True)
class BudgetSource:
    """Contribution of one source to the uncertainty of one quantity.

    `type` is A for a source estimated from the data, B for a stated one. `sensitivity` is the derivative of
    the quantity by the source (NaN for the fit, which has several parameters), `contribution` the resulting
    standard uncertainty in the quantity's unit, and `share` its fraction of the combined variance.
    """

    source: str
    type: Literal["A", "B"]
    u_source: Annotated[float, Quantity("", "of the source", unit=OF + "source")]
    sensitivity: Annotated[
        float, Quantity("", "derivative with respect to the source", unit=OWN + PER + OF + "source")
    ]
    contribution: Annotated[float, PART]
    share: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """GUM budget of one quantity, largest contribution first.

    `unit` is that of the value. `degrees_of_freedom` are the effective ones (Welch-Satterthwaite; infinite
    for what is stated).
    """

    unit: str = ""
    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    degrees_of_freedom: float = nan
    sources: Annotated[tuple[BudgetSource, ...], PART] = ()

    @property
    def coverage_factor_95(self) -> float:
        """Student's t of the degrees of freedom, for 95 %; of 1e9 where they are infinite or NaN."""
        from scipy.special import stdtrit

        return float(stdtrit(self.degrees_of_freedom if self.degrees_of_freedom < 1e9 else 1e9, 0.975))

    @property
    def apparatus_u(self) -> float:
        """Standard uncertainty by the stated sources without the air, which counts with the decay."""
        return hypot(*(one.contribution for one in self.sources if one.type == "B" and one.source != AIR))

    def shares_only(self) -> "Budget":
        """The budget with its sources' shares, and without the numbers from which its value would follow."""
        sources = tuple(replace(one, contribution=nan) for one in self.sources)
        return replace(self, value=nan, standard_uncertainty=nan, sources=sources)


Model = Callable[[Mapping[str, Floats]], Mapping[str, Floats]]
"""Quantities (n,) of input quantities (n,), fitted values among them, by name."""


def sensitivities(model: Model, inputs: Mapping[str, InputQuantity]) -> dict[str, dict[str, float]]:
    """Derivative of each quantity of a model with respect to each input that is uncertain, at the inputs'
    values.

    Central differences over a thousandth of each input's standard uncertainty.
    """
    found: dict[str, dict[str, float]] = {}
    for source, quantity in inputs.items():
        if quantity.u == 0:
            continue
        step = 1e-3 * quantity.u
        both = {name: np.full(2, other.value) for name, other in inputs.items()}
        both[source] = quantity.value + np.array([-step, step])
        for name, out in model(both).items():
            found.setdefault(name, {})[source] = float(out[1] - out[0]) / (2 * step)
    return found


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
    per_dof = sum(part**4 / dof for part, dof in estimated)
    dof = combined**4 / per_dof if per_dof > 0 and isfinite(combined) else inf
    sources = tuple(
        BudgetSource(
            source, kind, u, slope, part, (part / combined) ** 2 if isfinite(combined) else float(part == inf)
        )
        for source, kind, u, slope, part in sorted(parts, key=lambda part: -part[4])
    )
    return Budget(
        unit=unit,
        value=value,
        standard_uncertainty=combined,
        degrees_of_freedom=dof,
        sources=sources,
    )


def _quantities(found: FitResult) -> dict[str, str]:
    return {**OUTPUTS, **({DRAG.key: "s"} if found.has_drag else {})}


def budgets(found: FitResult, rig: RigQuantities) -> dict[str, Budget]:
    """A budget for every reported quantity.

    Derivatives are central differences over a thousandth of each source's uncertainty, with a relative error
    of 1e-6 for quantities that are nearly linear over the uncertainty.
    """
    known = {name: np.full(1, one.value) for name, one in {**_fitted(found), **rig.inputs()}.items()}
    value = {name: float(out[0]) for name, out in reported_quantities(found, known, rig).items()}
    by_value, by_input = _slopes(found, rig, lambda known: reported_quantities(found, known, rig))
    return {
        name: _budget(name, unit, value[name], found, rig, by_value[name], by_input.get(name, {}))
        for name, unit in _quantities(found).items()
    }


def _fitted(found: FitResult) -> dict[str, InputQuantity]:
    """The fitted values by name; a value that nothing determines has a small `u`, for its derivatives."""
    u = np.sqrt(np.diag(found.covariance)).tolist()
    return {
        name: InputQuantity(value, size if 0 < size < inf else 1e-3 * abs(value) or 1e-9)
        for name, value, size in zip(found.names, found.values.tolist(), u, strict=True)
    }


def _slopes(
    found: FitResult, rig: RigQuantities, model: Model
) -> tuple[dict[str, Floats], dict[str, dict[str, float]]]:
    """Derivatives of each quantity with respect to the fitted values and each other uncertain input."""
    slopes = sensitivities(model, {**_fitted(found), **rig.inputs()})
    by_value = {name: np.array([by.pop(one) for one in found.names]) for name, by in slopes.items()}
    return by_value, slopes


def standard_uncertainties(found: FitResult, rig: RigQuantities, model: Model) -> dict[str, float]:
    """Standard uncertainties of the quantities of a model by the fit and the other inputs, to first order."""
    by_value, by_input = _slopes(found, rig, model)
    inputs = rig.inputs()
    return {
        name: hypot(
            _type_a(found, slopes),
            *(slope * inputs[source].u for source, slope in by_input.get(name, {}).items()),
        )
        for name, slopes in by_value.items()
    }


def _budget(
    name: str,
    unit: str,
    value: float,
    found: FitResult,
    rig: RigQuantities,
    by_value: Floats,
    by_input: Mapping[str, float],
) -> Budget:
    type_a = _type_a(found, by_value)
    parts: list[tuple[str, Literal["A", "B"], float, float, float]] = []
    if type_a > 0:
        own = found.names.index(name) if name in found.names else None
        u_own = sqrt(found.covariance[own, own]) if own is not None else float("nan")
        of_terms, air = _by_term(found, by_value, type_a)
        of_data = sqrt(1 - (air / type_a) ** 2) if isfinite(type_a) else 1.0
        for source, part in of_terms.items():
            if part * of_data > 0:
                share = part * of_data / type_a if isfinite(type_a) else 1.0
                parts.append((source, "A", u_own * share, float("nan"), part * of_data))
        if air > 0 and isfinite(type_a):
            parts.append((AIR, "B", u_own * air / type_a, float("nan"), air))
            type_a *= of_data
    inputs = rig.inputs()
    for source, slope in by_input.items():
        u = inputs[source].u
        if slope != 0:
            parts.append((source, "B", u, slope, abs(slope) * u))
    estimated = [(type_a, float(found.dof))] if 0 < type_a < inf else []
    estimated += [(part, inputs[source].dof) for source, _, _, _, part in parts if source in inputs]
    return budget_of(unit, value, parts, estimated)


def _by_term(found: FitResult, by_value: Floats, type_a: float) -> tuple[dict[str, float], float]:
    """Type A uncertainty by the terms of the fit, and that by the air; the parts never exceed the whole."""
    if not isfinite(type_a):
        return {MEASUREMENT: type_a}, 0.0
    parts, left = {}, type_a**2
    for name in found.terms:
        if name not in (MEASUREMENT, AIR):
            parts[name] = min(_u_by(found.covariance_by(name), by_value), sqrt(left))
            left = max(left - parts[name] ** 2, 0.0)
    described = sqrt(left)
    reading = _u_by(found.covariance_by(MEASUREMENT), by_value) if MEASUREMENT in found.terms else described
    # equal but for rounding, which must not become a part of the ground
    reading = reading if reading < 0.999 * described else described
    ground = sqrt(max(left - reading**2, 0.0))
    air = min(_u_by(found.covariance_by(AIR), by_value), described)
    return {MEASUREMENT: reading, GROUND: ground, **parts}, air


def _type_a(found: FitResult, by_value: Floats) -> float:
    """Standard uncertainty by the fit; infinite where the quantity depends on an undetermined parameter."""
    blind = ~np.isfinite(np.diag(found.covariance))
    return inf if np.any(by_value[blind] != 0) else _u_by(found.covariance, by_value)


def _u_by(covariance: Floats, by_value: Floats) -> float:
    """Standard uncertainty by the finite elements of a covariance of the values."""
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    return sqrt(max(float(by_value @ known @ by_value), 0.0))
