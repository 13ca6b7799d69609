"""Table of the pendulum instruments. To add one, add an entry.

The numbers are those of the published instruments. A number that the source does not state is None;
disagreements of sources are given in `note`. Every number can be overridden by the configuration.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from processing.angle import ARCSEC_RAD

DEGREE_RAD = math.pi / 180.0

Report = Literal["contact", "damping", "hardness", "decay", "rolling", "circular"]
"""Kinds of evaluation: contact laws, damping between two amplitudes, Herbert's hardness numbers, Kuznetsov's
decay, Tomlinson's rolling friction, period as a function of the amplitude."""


@dataclass(frozen=True, slots=True)
class Limits:
    """A value required by a standard and its tolerance; with an infinite tolerance the value is a minimum."""

    value: float
    tolerance: float

    @property
    def lowest(self) -> float:
        return self.value if math.isinf(self.tolerance) else self.value - self.tolerance

    @property
    def highest(self) -> float:
        return self.value + self.tolerance


@dataclass(frozen=True, slots=True)
class Description:
    """One kind of pendulum.

    `support_radius_m` is the radius of ball, roller or axis; `lever_m` the distance of the centre of mass
    from the point about which the pendulum turns, needed to report moments. The amplitudes are those between
    which the decay is evaluated.
    """

    kind: str
    title: str
    tells: str
    support: str
    supports: int
    report: Report
    start_amplitude_rad: float
    end_amplitude_rad: float
    mass_kg: float | None = None
    mass_tolerance_kg: float | None = None
    support_radius_m: float | None = None
    support_distance_m: float | None = None
    lever_m: float | None = None
    period_s: Limits | None = None
    glass_time_s: Limits | None = None
    temperature_c: Limits | None = None
    humidity_percent: Limits | None = None
    turning_plane: bool = False
    note: str = ""

    @property
    def sentence(self) -> str:
        """The pendulum, and what its decay tells."""
        return f"{self.title}: {self.tells}"


_AIR = Limits(23.0, 2.0), Limits(50.0, 5.0)

_TABLE = (
    Description(
        kind="single_ball",
        title="Pendulum on one ball, swinging within the contact spot",
        tells="friction, adhesion, period.",
        support="one ball, 12.1 mm, on a flat",
        supports=1,
        report="contact",
        start_amplitude_rad=124 * ARCSEC_RAD,
        end_amplitude_rad=2 * ARCSEC_RAD,
        mass_kg=0.406,
        support_radius_m=6.05e-3,
    ),
    Description(
        kind="two_ball",
        title="Pendulum on two equal balls that share the weight",
        tells="the same laws, 300 to 2 arcsec.",
        support="two balls, 10 mm, polycrystalline sapphire",
        supports=2,
        report="contact",
        start_amplitude_rad=300 * ARCSEC_RAD,
        end_amplitude_rad=2 * ARCSEC_RAD,
        mass_kg=1.2,
        support_radius_m=5e-3,
    ),
    Description(
        kind="herbert",
        title="Herbert's hardness pendulum",
        tells="time of ten single swings, scale after the first swing.",
        support="one ball, 1 mm, steel or ruby",
        supports=1,
        report="hardness",
        start_amplitude_rad=5 * DEGREE_RAD,
        end_amplitude_rad=0.5 * DEGREE_RAD,
        mass_kg=4.0,
        support_radius_m=0.5e-3,
        lever_m=0.1e-3,
        note="mass centre 0.1 mm below the ball's centre, above the fulcrum",
    ),
    Description(
        kind="herbert_roller",
        title="Herbert's pendulum on a roller, whose swing plane is stable",
        tells="the same two hardnesses.",
        support="one roller, 2 mm diameter, 12 mm long",
        supports=1,
        report="hardness",
        start_amplitude_rad=5 * DEGREE_RAD,
        end_amplitude_rad=0.5 * DEGREE_RAD,
        support_radius_m=1e-3,
    ),
    Description(
        kind="kuznetsov_one",
        title="Kuznetsov's pendulum on one needle or ball",
        tells="decay, relative hardness, turning plane.",
        support="one needle (90 degree cone) or 0.5 mm ball",
        supports=1,
        report="decay",
        start_amplitude_rad=5 * DEGREE_RAD,
        end_amplitude_rad=2.5 * DEGREE_RAD,
        support_radius_m=0.25e-3,
        turning_plane=True,
    ),
    Description(
        kind="kuznetsov_two",
        title="Kuznetsov's pendulum on two needles or balls",
        tells="decay with swing number, hardness.",
        support="two needles (90 degree cone) or 0.5 mm balls",
        supports=2,
        report="decay",
        start_amplitude_rad=5 * DEGREE_RAD,
        end_amplitude_rad=2.5 * DEGREE_RAD,
        support_radius_m=0.25e-3,
    ),
    Description(
        kind="koenig",
        title="Koenig's pendulum (ISO 1522, ASTM D4366)",
        tells="damping from 6 to 3 degrees against glass.",
        support="two balls, 5 mm, 30 mm apart",
        supports=2,
        report="damping",
        start_amplitude_rad=6 * DEGREE_RAD,
        end_amplitude_rad=3 * DEGREE_RAD,
        mass_kg=0.200,
        mass_tolerance_kg=0.2e-3,
        support_radius_m=2.5e-3,
        support_distance_m=0.030,
        period_s=Limits(1.40, 0.02),
        glass_time_s=Limits(250.0, 10.0),
        temperature_c=_AIR[0],
        humidity_percent=_AIR[1],
    ),
    Description(
        kind="persoz",
        title="Persoz's pendulum (ISO 1522, ASTM D4366)",
        tells="damping from 12 to 4 degrees against glass.",
        support="two balls, 8 mm, 50 mm apart",
        supports=2,
        report="damping",
        start_amplitude_rad=12 * DEGREE_RAD,
        end_amplitude_rad=4 * DEGREE_RAD,
        mass_kg=0.500,
        mass_tolerance_kg=0.1e-3,
        support_radius_m=4e-3,
        support_distance_m=0.050,
        period_s=Limits(1.00, 0.02),
        glass_time_s=Limits(430.0, 10.0),
        temperature_c=_AIR[0],
        humidity_percent=_AIR[1],
        note="sources disagree on the time on glass: at least 420 s, or 430 s +- 10 s (assumed here); "
        "they give the period as about 1 s, its tolerance is assumed",
    ),
    Description(
        kind="tomlinson",
        title="Tomlinson's disc on an axis",
        tells="log decrement and coefficient of rolling friction.",
        support="cylindrical axis of a disc on two cylinders or balls",
        supports=2,
        report="rolling",
        start_amplitude_rad=221 * 60 * ARCSEC_RAD,
        end_amplitude_rad=6 * 60 * ARCSEC_RAD,
        mass_kg=0.600,
    ),
    Description(
        kind="knife_edge",
        title="Pendulum on a knife edge",
        tells="period against amplitude beside the circular-error law.",
        support="edge of a prism",
        supports=1,
        report="circular",
        start_amplitude_rad=5 * DEGREE_RAD,
        end_amplitude_rad=0.5 * DEGREE_RAD,
    ),
)

INSTRUMENTS: Mapping[str, Description] = MappingProxyType(
    {description.kind: description for description in _TABLE}
)
"""All instruments by name."""
