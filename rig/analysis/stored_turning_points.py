"""The fitted turning points as they stand in results.json, so that a report need not find them again."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated

import numpy as np

from processing.deflections import DeflectionUnit
from processing.position_map import PositionMap
from processing.quantity import IN_UNIT
from processing.swing import Swing, TurningPoints
from processing.ticks import seconds
from rig.analysis.encoding import Floats, Integers


class TableUnit(StrEnum):
    """Unit of the amplitudes of a table that is no angle."""

    OWN = "own"
    """The one that its results name, `amplitude_unit`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTurningPoints:
    """The turning points that were fitted, and the half-cycles that were left out.

    Times are in true seconds from `first_ns`, the record's time of the first turning point. Amplitudes are
    in `unit`; for a table without an angle, in its `amplitude_unit`. `left_out_flags` are those of
    `processing.swing.SwingFlag`.
    """

    first_ns: int = 0
    unit: DeflectionUnit | TableUnit = DeflectionUnit.RAD
    index: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    time_s: Floats = field(default_factory=lambda: np.empty(0))
    u_time_s: Floats = field(default_factory=lambda: np.empty(0))
    amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    u_amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    left_out_time_s: Floats = field(default_factory=lambda: np.empty(0))
    left_out_amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    left_out_flags: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __post_init__(self) -> None:
        fitted = (self.index, self.time_s, self.u_time_s, self.amplitude, self.u_amplitude)
        left_out = (self.left_out_time_s, self.left_out_amplitude, self.left_out_flags)
        if len(set(map(len, fitted))) > 1 or len(set(map(len, left_out))) > 1:
            raise ValueError("columns of equal length")

    @classmethod
    def of(
        cls,
        points: TurningPoints,
        swings: Sequence[Swing],
        unit: DeflectionUnit | TableUnit,
        clock_rate: float,
    ) -> "StoredTurningPoints":
        """`points` were made of `swings`, of whose seconds each takes `clock_rate` true ones."""
        first_ns = next((swing.turn_time_ns for swing in swings if swing.flags == 0), None)
        if first_ns is None:
            first_ns = swings[0].turn_time_ns if swings else 0
        left_out = [swing for swing in swings if swing.flags]
        return cls(
            first_ns=first_ns,
            unit=unit,
            index=points.index,
            time_s=points.time_s,
            u_time_s=points.u_time_s,
            amplitude=points.amplitude,
            u_amplitude=points.u_amplitude,
            left_out_time_s=np.array(
                [seconds(swing.turn_time_ns - first_ns) * clock_rate for swing in left_out]
            ),
            left_out_amplitude=np.array([swing.amplitude for swing in left_out]),
            left_out_flags=np.array([swing.flags for swing in left_out], dtype=np.int64),
        )

    def points(self) -> TurningPoints:
        """As the fits take them."""
        return TurningPoints(self.index, self.time_s, self.u_time_s, self.amplitude, self.u_amplitude)


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
