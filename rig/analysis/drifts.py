"""What may drift during a run: how much of it is believed, and what one decay cannot tell of it."""

from collections.abc import Mapping
from math import isfinite

from processing.arrays import Floats
from processing.fit import FitResult, InputQuantity
from processing.surroundings import Surroundings
from rig.presentation import percent, quantity
from rig.settings import Configuration

_DRAG_PER_K = 2.7e-3
"""Relative growth of the air's viscosity per kelvin."""
_SAID = {"ageing": "friction b", "adhesion_ageing": "c", "drag_drift": "the drag"}


def believed_drifts(config: Configuration, air: Surroundings) -> dict[str, InputQuantity]:
    """Relative changes over a run by the names of `RigQuantities`, as [fit] has them.

    Period and drag follow the temperature, as it was read: the one with the body's expansion, the other with
    the viscosity of the air.
    """
    fit, change_k = config.fit, config.fit.u_temperature_change_k
    if isfinite(air.temperature_change_k):
        change_k = abs(air.temperature_change_k)
    expansion = 0.0 if config.pendulum is None else config.pendulum.expansion_per_k
    u = {
        "ageing": fit.u_ageing,
        "adhesion_ageing": fit.u_ageing if fit.u_adhesion_ageing is None else fit.u_adhesion_ageing,
        "drag_drift": _DRAG_PER_K * change_k if fit.u_drag_drift is None else fit.u_drag_drift,
        "period_drift": expansion * change_k,
    }
    return {name: InputQuantity(0.0, one) for name, one in u.items()}


def limit_sentence(drifts: Mapping[str, Floats], u_drifts: Mapping[str, float], fit: FitResult) -> str:
    """What a decay alone cannot tell of its contact's age and of its air; empty where it hardly matters."""
    said = []
    for source, what in _SAID.items():
        moved = []
        for name, slope in zip(fit.contact_names, drifts[source].tolist(), strict=True):
            by = abs(slope) * u_drifts[source]
            if by > (u := fit.estimate(name).standard_uncertainty):
                moved.append(f"{quantity(name).symbol} by {by / u:.2g} u")
        if moved:
            said.append(f"{percent(u_drifts[source])} of {what} over the run would move {', '.join(moved)}")
    if not said:
        return ""
    return (
        f"A single decay cannot reveal ageing of the contact, or a drag that drifts: {'; '.join(said)} of "
        "the swings; the budget includes it (fit.u_ageing, u_adhesion_ageing, u_drag_drift). Runs from other "
        "first amplitudes, and after waiting, can reveal it."
    )
