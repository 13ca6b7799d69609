"""What results.json holds of pendulums that are not described by the contact's laws."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final

from processing.estimate import Estimate
from processing.instruments import Check
from processing.quantity import PART
from rig.analysis.encoding import Floats

INSTRUMENT: Final = "instrument"
"""Of a row that another kind of pendulum reports; behind a comma follows the part of the decay."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentResults:
    """One run of another kind of pendulum, whose numbers are rows of the table of results.

    `checks` compare environment and apparatus with the standard. `curves` are columns of equal length: of
    `period` full periods against amplitude beside the law of circular error and its first term, `decrement`
    the log decrement of a whole swing against amplitude, `plane` the direction of the swing plane in time.
    """

    kind: str
    curves: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
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
