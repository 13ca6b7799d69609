"""What results.json holds of pendulums that are not described by the contact's laws."""

from dataclasses import dataclass
from typing import Annotated

from processing.instruments import Check, Compliance
from rig.analysis.encoding import Floats, LeftOut, Number, Value


@dataclass(frozen=True, slots=True)
class CheckedValue:
    """A value against the limits of a standard."""

    name: str
    value: Number
    standard_uncertainty: Number
    lowest: Number
    highest: Number
    unit: str
    verdict: Compliance
    text: str

    @classmethod
    def of(cls, check: Check) -> "CheckedValue":
        """As `processing.instruments` judged it."""
        return cls(
            check.name, *check.measured, check.lowest, check.highest, check.unit, check.verdict, check.text
        )


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

    start_amplitude_deg: Number
    end_amplitude_deg: Number
    time_s: Value
    swings: Value
    missing_half_cycles: int


@dataclass(frozen=True, slots=True)
class FrictionLawResults:
    """Mean frictional moment at the reference amplitude, and the power of the amplitude it goes with."""

    reference_amplitude_deg: Number
    moment: Value
    exponent: Value
    chi2_per_dof: Number


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
    rate_deg_per_min: Value
    turned_deg: Value
    width_ratio: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentResults:
    """One run as its kind of pendulum is reported: of each kind some of these are there.

    `amplitude_deg` (first and last) and `mean_period_s` stand where the quantity asked for could not be had.
    """

    kind: str
    swing_plane: Annotated[SwingPlane | None, LeftOut] = None
    inferred_half_cycles: Annotated[int | None, LeftOut] = None
    first_amplitude_deg: Annotated[Number | None, LeftOut] = None
    time_hardness_first_swing_s: Annotated[Value | None, LeftOut] = None
    scale_hardness: Annotated[Value | None, LeftOut] = None
    time_hardness_s: Annotated[Value | None, LeftOut] = None
    period0_s: Annotated[Value | None, LeftOut] = None
    circular_factor: Annotated[Value | None, LeftOut] = None
    chi2_per_dof: Annotated[Number | None, LeftOut] = None
    table: Annotated[PeriodTable | None, LeftOut] = None
    friction_law: Annotated[FrictionLawResults | None, LeftOut] = None
    log_decrement: Annotated[Value | None, LeftOut] = None
    constant_decrement: Annotated[bool | None, LeftOut] = None
    independent_of_speed: Annotated[bool | None, LeftOut] = None
    rolling_friction_coefficient: Annotated[Value | None, LeftOut] = None
    problem: Annotated[str | None, LeftOut] = None
    decrement_against_amplitude: Annotated[DecrementTable | None, LeftOut] = None
    damping: Annotated[DampingResults | None, LeftOut] = None
    amplitude_deg: Annotated[tuple[Number, Number] | None, LeftOut] = None
    mean_period_s: Annotated[Number | None, LeftOut] = None
    environment: Annotated[tuple[CheckedValue, ...] | None, LeftOut] = None
    apparatus: Annotated[tuple[CheckedValue, ...] | None, LeftOut] = None
    text: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OverPlaces:
    """Mean over the places of a sample."""

    value: Number
    standard_uncertainty: Number
    places: int
    spread: Number
    expanded_uncertainty_95: Number


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentSeries:
    """Places on a sample against the glass plate or reference sample of the same series."""

    kind: str
    time_s: Annotated[OverPlaces | None, LeftOut] = None
    swings: Annotated[OverPlaces | None, LeftOut] = None
    problem: Annotated[str | None, LeftOut] = None
    reference_time_s: Annotated[Value | None, LeftOut] = None
    acceptance: Annotated[tuple[CheckedValue, ...] | None, LeftOut] = None
    ratio: Annotated[Value | None, LeftOut] = None
    ratio_of_swings: Annotated[Value | None, LeftOut] = None
    text: tuple[str, ...] = ()
