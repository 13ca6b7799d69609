"""What may drift during a run: how much of it is believed, and what one decay cannot tell of it."""

from math import isfinite
from typing import NamedTuple

from processing.fit import Drifts, FitResult, InputQuantity
from processing.surroundings import Surroundings
from rig.presentation import percent, quantity
from rig.settings import Configuration


class BelievedDrifts(NamedTuple):
    """Relative changes of the contact's friction and of the period over a run."""

    ageing: InputQuantity
    period: InputQuantity


def believed_drifts(config: Configuration, air: Surroundings) -> BelievedDrifts:
    """As [fit] has them; the period follows the temperature, as it was read, with the body's expansion."""
    change_k = config.fit.u_temperature_change_k
    if isfinite(air.temperature_change_k):
        change_k = abs(air.temperature_change_k)
    expansion = 0.0 if config.pendulum is None else config.pendulum.expansion_per_k
    return BelievedDrifts(InputQuantity(0.0, config.fit.u_ageing), InputQuantity(0.0, expansion * change_k))


def limit_sentence(drifts: Drifts, believed: BelievedDrifts, fit: FitResult) -> str:
    """What a decay alone cannot tell of its contact's age; empty where none is believed."""
    if not believed.ageing.u > 0:
        return ""
    share = believed.ageing.u
    moved = []
    for name, slope in zip(fit.contact_names, drifts.by_ageing.tolist(), strict=True):
        u = fit.estimate(name).standard_uncertainty
        if abs(slope) * share > u:
            shown = quantity(name)
            moved.append(f"{shown.symbol} by {abs(slope) * share / u:.2g} u")
    if not moved:
        return ""
    return (
        f"A single decay cannot reveal ageing of the contact: {percent(share)} over the run would move "
        f"{', '.join(moved)} of the swings; the budget includes it (fit.u_ageing). Runs from other first "
        "amplitudes, and after waiting, can reveal it."
    )
