"""Acceptance test of an instrument: measured values compared with the limits of a standard."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from processing.estimate import Estimate
from processing.instruments.descriptions import Limits
from processing.quantity import IN_UNIT


class Compliance(StrEnum):
    """Of a value against its limits. `UNDECIDED`: a limit is within two standard uncertainties of it."""

    WITHIN = "within"
    OUTSIDE = "outside"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Check:
    """A value compared with its limits."""

    name: str
    value: Annotated[float, IN_UNIT]
    standard_uncertainty: Annotated[float, IN_UNIT]
    lowest: Annotated[float, IN_UNIT]
    highest: Annotated[float, IN_UNIT]
    unit: str
    verdict: Compliance
    text: str


def check(name: str, measured: Estimate, limits: Limits, unit: str) -> Check:
    """Compare a value with limits; an unknown uncertainty (0) is ignored."""
    value, u = measured
    low, high = limits.lowest, limits.highest
    inside = low <= value <= high
    near = min(abs(value - low), abs(value - high) if math.isfinite(high) else math.inf)
    verdict = Compliance.UNDECIDED if near < 2 * u else Compliance.WITHIN if inside else Compliance.OUTSIDE
    if math.isinf(high):
        wanted = f"at least {low:g} {unit}"
    else:
        wanted = f"{limits.value:g} ± {limits.tolerance:g} {unit}"
    word = "too close to the limit to decide" if verdict is Compliance.UNDECIDED else verdict
    return Check(
        name, value, u, low, high, unit, verdict, f"{name} {value:.5g} {unit}, {wanted} wanted: {word}"
    )
