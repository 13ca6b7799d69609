"""Table of the pendulum instruments. To add one, add an entry.

The numbers are those of the published instruments. A number that the source does not state is None;
disagreements of sources are given in `note`. Every number can be overridden by the configuration.

Acceptance test of an instrument: measured values compared with the limits of a standard.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Literal

from processing.estimate import Estimate
from processing.quantity import IN_UNIT
from processing.units import ARCSEC_RAD

DEGREE_RAD = math.pi / 180.0

Report = Literal["contact", "damping", "hardness", "decay", "rolling", "circular"]
"""Kinds of evaluation: contact laws, damping between two amplitudes, Herbert's hardness numbers, Kuznetsov's
decay, Tomlinson's rolling friction, period as a function of the amplitude.
"""


@dataclass(frozen=True, slots=True)
class Limits:
    """A value required by a standard and its tolerance; with an infinite tolerance the value is a minimum."""

    value: float
    tolerance: float


@dataclass(frozen=True, slots=True)
class Description:
    """One kind of pendulum."""

    kind: str
    title: str
    results: str
    """Quantities that follow from the decay."""
    support: str
    supports: int
    """Number of supports."""
    report: Report
    start_amplitude_rad: float
    end_amplitude_rad: float
    """Amplitudes between which the decay is evaluated."""
    mass_kg: float | None = None
    mass_tolerance_kg: float | None = None
    support_radius_m: float | None = None
    """Radius of ball, roller or axis."""
    support_distance_m: float | None = None
    lever_m: float | None = None
    """Distance of the centre of mass from the point about which the pendulum turns, for moments."""
    period_s: Limits | None = None
    glass_time_s: Limits | None = None
    temperature_c: Limits | None = None
    humidity_percent: Limits | None = None
    turning_plane: bool = False
    note: str = ""

    @property
    def sentence(self) -> str:
        """The pendulum and the quantities that it gives."""
        return f"{self.title}: {self.results}"


_AIR = Limits(23.0, 2.0), Limits(50.0, 5.0)

# kind, title, results, support, number of supports, report, amplitudes at the start and the end
_TABLE = (
    Description(
        "single_ball", "Pendulum on one ball, swinging within the contact spot",
        "friction, adhesion, period.", "one ball, 12.1 mm, on a flat", 1,
        "contact", 124 * ARCSEC_RAD, 2 * ARCSEC_RAD, mass_kg=0.406, support_radius_m=6.05e-3,
    ),
    Description(
        "two_ball", "Pendulum on two equal balls that share the weight",
        "the same laws, 300 to 2 arcsec.", "two balls, 10 mm, polycrystalline sapphire", 2,
        "contact", 300 * ARCSEC_RAD, 2 * ARCSEC_RAD, mass_kg=1.2, support_radius_m=5e-3,
    ),
    Description(
        "herbert", "Herbert's hardness pendulum",
        "time of ten single swings, scale after the first swing.", "one ball, 1 mm, steel or ruby", 1,
        "hardness", 5 * DEGREE_RAD, 0.5 * DEGREE_RAD, mass_kg=4.0, support_radius_m=0.5e-3, lever_m=0.1e-3,
        note="mass centre 0.1 mm below the ball's centre, above the fulcrum",
    ),
    Description(
        "herbert_roller", "Herbert's pendulum on a roller, whose swing plane is stable",
        "the same two hardnesses.", "one roller, 2 mm diameter, 12 mm long", 1,
        "hardness", 5 * DEGREE_RAD, 0.5 * DEGREE_RAD, support_radius_m=1e-3,
    ),
    Description(
        "kuznetsov_one", "Kuznetsov's pendulum on one needle or ball",
        "decay, relative hardness, turning plane.", "one needle (90 degree cone) or 0.5 mm ball", 1,
        "decay", 5 * DEGREE_RAD, 2.5 * DEGREE_RAD, support_radius_m=0.25e-3, turning_plane=True,
    ),
    Description(
        "kuznetsov_two", "Kuznetsov's pendulum on two needles or balls",
        "decay with swing number, hardness.", "two needles (90 degree cone) or 0.5 mm balls", 2,
        "decay", 5 * DEGREE_RAD, 2.5 * DEGREE_RAD, support_radius_m=0.25e-3,
    ),
    Description(
        "koenig", "Koenig's pendulum (ISO 1522, ASTM D4366)",
        "damping from 6 to 3 degrees against glass.", "two balls, 5 mm, 30 mm apart", 2,
        "damping", 6 * DEGREE_RAD, 3 * DEGREE_RAD, mass_kg=0.200, mass_tolerance_kg=0.2e-3,
        support_radius_m=2.5e-3, support_distance_m=0.030, period_s=Limits(1.40, 0.02),
        glass_time_s=Limits(250.0, 10.0), temperature_c=_AIR[0], humidity_percent=_AIR[1],
    ),
    Description(
        "persoz", "Persoz's pendulum (ISO 1522, ASTM D4366)",
        "damping from 12 to 4 degrees against glass.", "two balls, 8 mm, 50 mm apart", 2,
        "damping", 12 * DEGREE_RAD, 4 * DEGREE_RAD, mass_kg=0.500, mass_tolerance_kg=0.1e-3,
        support_radius_m=4e-3, support_distance_m=0.050, period_s=Limits(1.00, 0.02),
        glass_time_s=Limits(430.0, 10.0), temperature_c=_AIR[0], humidity_percent=_AIR[1],
        note="sources disagree on the time on glass: at least 420 s, or 430 s ± 10 s (assumed here); "
        "they give the period as about 1 s, its tolerance is assumed",
    ),
    Description(
        "tomlinson", "Tomlinson's disc on an axis",
        "log decrement and coefficient of rolling friction.",
        "cylindrical axis of a disc on two cylinders or balls", 2,
        "rolling", 221 * 60 * ARCSEC_RAD, 6 * 60 * ARCSEC_RAD, mass_kg=0.600,
    ),
    Description(
        "knife_edge", "Pendulum on a knife edge",
        "period against amplitude beside the circular-error law.", "edge of a prism", 1,
        "circular", 5 * DEGREE_RAD, 0.5 * DEGREE_RAD,
    ),
)  # fmt: skip

INSTRUMENTS: Mapping[str, Description] = MappingProxyType(
    {description.kind: description for description in _TABLE}
)
"""All instruments by name."""


class Compliance(StrEnum):
    """Verdict on a value against its limits; undecided if one is within two standard uncertainties of it."""

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
    high = limits.value + limits.tolerance
    low = limits.value if math.isinf(limits.tolerance) else limits.value - limits.tolerance
    is_within = low <= value <= high
    distance = min(abs(value - low), abs(value - high))
    verdict = Compliance.WITHIN if is_within else Compliance.OUTSIDE
    verdict_text: str = verdict
    if distance < 2 * u:
        verdict, verdict_text = Compliance.UNDECIDED, "too close to the limit to decide"
    if math.isinf(high):
        limits_text = f"at least {low:g} {unit}"
    else:
        limits_text = f"{limits.value:g} ± {limits.tolerance:g} {unit}"
    text = f"{name} {value:.5g} {unit}, {limits_text} wanted: {verdict_text}"
    return Check(name, value, u, low, high, unit, verdict, text)
