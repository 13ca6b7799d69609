"""What results.json holds of pendulums that are not described by the contact's laws."""

from dataclasses import dataclass
from typing import Annotated

from processing.estimate import Estimate
from processing.instruments import Check
from processing.quantity import PART
from rig.analysis.encoding import Floats


@dataclass(frozen=True, slots=True)
class PeriodTable:
    """Full periods against amplitude, beside the law of circular error and its first term."""

    amplitude_deg: Floats
    period_s: Floats
    u_period_s: Floats
    circular_law_s: Floats
    alpha_squared_over_16_s: Floats


@dataclass(frozen=True, slots=True)
class DampingResults:
    """Time and number of swings from one amplitude to another."""

    start_amplitude_deg: float
    end_amplitude_deg: float
    time_s: Estimate
    swings: Estimate
    missing_half_cycles: int


@dataclass(frozen=True, slots=True)
class FrictionLawResults:
    """Mean frictional moment at the reference amplitude, and the exponent of its dependence on amplitude."""

    reference_amplitude_deg: float
    moment: Estimate
    exponent: Estimate
    chi2_per_dof: float


@dataclass(frozen=True, slots=True)
class DecrementTable:
    """Log decrement of a whole swing against amplitude."""

    amplitude_deg: Floats
    log_decrement: Floats
    u_log_decrement: Floats


@dataclass(frozen=True, slots=True)
class SwingPlane:
    """The plane of the swing, period by period, and how it turned."""

    direction_deg: Floats
    time_s: Floats
    rate_deg_per_min: Estimate
    turned_deg: Estimate
    width_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentResults:
    """One run of another kind of pendulum; each kind has some of these.

    `amplitude_deg` (first and last) and `mean_period_s` are given if the requested quantity was not
    available.
    """

    kind: str
    swing_plane: SwingPlane | None = None
    inferred_half_cycles: int | None = None
    first_amplitude_deg: float | None = None
    time_hardness_first_swing_s: Estimate | None = None
    scale_hardness: Estimate | None = None
    time_hardness_s: Estimate | None = None
    period0_s: Estimate | None = None
    circular_factor: Estimate | None = None
    chi2_per_dof: float | None = None
    table: PeriodTable | None = None
    friction_law: FrictionLawResults | None = None
    log_decrement: Estimate | None = None
    constant_decrement: bool | None = None
    independent_of_speed: bool | None = None
    rolling_friction_coefficient: Estimate | None = None
    problem: str | None = None
    decrement_against_amplitude: DecrementTable | None = None
    damping: DampingResults | None = None
    amplitude_deg: tuple[float, float] | None = None
    mean_period_s: float | None = None
    environment: tuple[Check, ...] | None = None
    apparatus: tuple[Check, ...] | None = None
    text: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OverPlaces:
    """Mean over the places of a sample; `u_shared` is the part of its uncertainty that all places share."""

    value: Annotated[float, PART]
    standard_uncertainty: Annotated[float, PART]
    places: int
    spread: Annotated[float, PART]
    expanded_uncertainty_95: Annotated[float, PART]
    u_shared: Annotated[float, PART] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentSeries:
    """Places on a sample against the glass plate or reference sample of the same series."""

    kind: str
    time_s: OverPlaces | None = None
    swings: OverPlaces | None = None
    problem: str | None = None
    reference_time_s: Estimate | None = None
    acceptance: tuple[Check, ...] | None = None
    ratio: Estimate | None = None
    ratio_of_swings: Estimate | None = None
    text: tuple[str, ...] = ()
