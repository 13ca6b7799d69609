"""The map of errors of position as it stands in results.json."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from processing.deflections import DeflectionUnit
from processing.position_map import PositionMap
from processing.quantity import IN_UNIT
from rig.analysis.encoding import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionErrors:
    """Errors of position fixed on the sensor, as the run showed them; they were subtracted before the fits.

    `place` are true deflections along the slow axis, `error` the excess of the measured ones there, `u_error`
    its standard uncertainty apart from a constant and a scale, which no swing shows; all in `unit`.
    `correlation_length` is the distance over which the error changes, `significance` the score for it in
    standard deviations, from `cycles` whole cycles. `noise_scale` is the scatter of the remainder over the
    uncertainties of the samples.
    """

    unit: DeflectionUnit = DeflectionUnit.RAD
    place: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    error: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    u_error: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    correlation_length: Annotated[float, IN_UNIT] = float("nan")
    significance: float = float("nan")
    cycles: int = 0
    noise_scale: float = float("nan")

    def __post_init__(self) -> None:
        if len({len(self.place), len(self.error), len(self.u_error)}) > 1:
            raise ValueError("columns of equal length")

    @classmethod
    def of(cls, found: PositionMap, unit: DeflectionUnit) -> "PositionErrors":
        """At the knots of the map."""
        place = found.splines.centres[1:-1]
        return cls(
            unit=unit,
            place=place,
            error=found.error(place),
            u_error=found.u_error(place),
            correlation_length=found.correlation_length,
            significance=found.significance,
            cycles=found.cycles,
            noise_scale=found.noise_scale,
        )

    @property
    def rms(self) -> float:
        """Of the error about its mean, in `unit`."""
        return float(np.std(self.error))

    @property
    def text(self) -> str:
        """One line for the notes."""
        size, unit = self.unit.shown_size, self.unit.shown
        return (
            f"errors of position that are fixed on the sensor, {self.rms / size:.2g} {unit} r.m.s. over "
            f"{self.correlation_length / size:.2g} {unit}, were found in {self.cycles} cycles and subtracted "
            "before the fits; the budget has a line for what remains"
        )
