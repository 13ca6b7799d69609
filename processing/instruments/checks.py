"""Acceptance of an apparatus: measured values against a standard's limits, with a verdict."""

import math
from typing import Literal, NamedTuple

from processing.estimate import Estimate
from processing.instruments.descriptions import Limits

Verdict = Literal["within", "outside", "undecided"]


class Check(NamedTuple):
    """One value against its limits. `undecided`: a limit lies within two standard uncertainties."""

    name: str
    measured: Estimate
    lowest: float
    highest: float
    unit: str
    verdict: Verdict
    text: str


def check(name: str, measured: Estimate, limits: Limits, unit: str) -> Check:
    """Hold a value against limits; a value of unknown uncertainty (0) is taken as it stands."""
    value, u = measured
    low, high = limits.lowest, limits.highest
    inside = low <= value <= high
    near = min(abs(value - low), abs(value - high) if math.isfinite(high) else math.inf)
    verdict: Verdict = "undecided" if near < 2 * u else "within" if inside else "outside"
    if math.isinf(high):
        wanted = f"at least {low:g} {unit}"
    else:
        wanted = f"{limits.value:g} ± {limits.tolerance:g} {unit}"
    word = "too close to the limit to decide" if verdict == "undecided" else verdict
    return Check(
        name, measured, low, high, unit, verdict, f"{name} {value:.5g} {unit}, {wanted} wanted: {word}"
    )
