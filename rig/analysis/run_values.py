"""Parts of a run's results: turning points, position errors, beam and clock, place in a table.

Field names are keys of results.json; see `rig.analysis.results`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from math import isfinite, nan
from typing import Annotated, Self

import numpy as np

from processing.deflections import DeflectionUnit
from processing.position_map import PositionMap
from processing.quantity import IN_UNIT, Quantity
from processing.spot import MAX_CHOICE_FRAMES, BeamUse, SpotFlag, SpotModel
from processing.swing import HalfCycle, TurningPoints
from processing.units import seconds
from rig.analysis.encoding import Floats, Integers


class TableUnit(StrEnum):
    """Unit of a table's amplitudes where it is no angle."""

    OWN = "own"
    """The `amplitude_unit` of the results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTurningPoints:
    """Turning points of the fit, and half-cycles that were left out of it."""

    first_ns: int = 0
    """The record's time of the first turning point."""
    unit: DeflectionUnit | TableUnit = DeflectionUnit.RAD
    """Unit of the amplitudes."""
    index: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """Numbers of the half-cycles."""
    time_s: Floats = field(default_factory=lambda: np.empty(0))
    """Times in true seconds since `first_ns`."""
    u_time_s: Floats = field(default_factory=lambda: np.empty(0))
    amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    u_amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    left_out_time_s: Floats = field(default_factory=lambda: np.empty(0))
    left_out_amplitude: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    left_out_flags: Integers = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """Flags, those of `processing.swing.HalfCycleFlag`."""

    def __post_init__(self) -> None:
        fitted = (self.index, self.time_s, self.u_time_s, self.amplitude, self.u_amplitude)
        left_out = (self.left_out_time_s, self.left_out_amplitude, self.left_out_flags)
        if len(set(map(len, fitted))) > 1 or len(set(map(len, left_out))) > 1:
            raise ValueError("columns of equal length are needed")

    @classmethod
    def of(
        cls,
        points: TurningPoints,
        half_cycles: Sequence[HalfCycle],
        unit: DeflectionUnit | TableUnit,
        clock_rate: float,
    ) -> "StoredTurningPoints":
        """The `points` of the half-cycles, and those left out; `clock_rate` is true seconds a second."""
        left_out = [h for h in half_cycles if h.flags]
        first = next((h for h in half_cycles if not h.flags), left_out[0] if left_out else None)
        first_ns = 0 if first is None else first.turn_time_ns
        return cls(
            first_ns=first_ns,
            unit=unit,
            **{item.name: getattr(points, item.name) for item in fields(points)},
            left_out_time_s=np.array([seconds(h.turn_time_ns - first_ns) * clock_rate for h in left_out]),
            left_out_amplitude=np.array([h.amplitude for h in left_out]),
            left_out_flags=np.array([h.flags for h in left_out], dtype=np.int64),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionErrors:
    """Fixed-pattern position errors of the sensor, by the run itself; they are subtracted before the fits."""

    unit: DeflectionUnit = DeflectionUnit.RAD
    place: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    """True deflections along the slow axis."""
    error: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    """Measured less true deflections."""
    u_error: Annotated[Floats, IN_UNIT] = field(default_factory=lambda: np.empty(0))
    """Standard uncertainty of `error` apart from a constant and a scale, which no swing shows."""
    correlation_length: Annotated[float, IN_UNIT] = nan
    """Distance over which the error changes."""
    significance: float = nan
    """Score of the error in standard deviations."""
    cycles: int = 0
    """Number of whole cycles that were used."""
    noise_scale: float = nan
    """Scatter of the residuals over the uncertainties of the samples."""

    def __post_init__(self) -> None:
        if len({len(self.place), len(self.error), len(self.u_error)}) > 1:
            raise ValueError("columns of equal length are needed")

    @classmethod
    def of(cls, position_map: PositionMap, unit: DeflectionUnit) -> "PositionErrors":
        """The errors at the knots of the map."""
        place = position_map.splines.centres[1:-1]
        return cls(
            unit=unit,
            place=place,
            error=position_map.error(place),
            u_error=position_map.u_error(place),
            correlation_length=position_map.correlation_length,
            significance=position_map.significance,
            cycles=position_map.cycles,
            noise_scale=position_map.noise_scale,
        )

    @property
    def text(self) -> str:
        """One line for the notes."""
        size, unit = self.unit.shown_size, self.unit.shown
        return (
            f"errors of position that are fixed on the sensor, {float(np.std(self.error)) / size:.2g} {unit} "
            f"r.m.s. over {self.correlation_length / size:.2g} {unit}, were found in {self.cycles} cycles "
            "and subtracted before the fits; the budget has a line for what remains"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDecay:
    """Place of a decay in a table."""

    began_s: float = nan
    """Time of the first turning point since the table's first row."""
    ended_s: float = nan
    """Time of the last turning point since the table's first row."""
    run: str = ""
    """Name of the run, if the file contains several."""
    columns: tuple[str, ...] = ()
    """Columns of the positions."""
    session: Mapping[str, str] = field(default_factory=dict)
    """Sample, its history, operator and notes, by the configuration."""

    def overlaps(self, other: "TableDecay") -> bool:
        """Whether both decays of one file have a stretch of one run and a column in common."""
        overlap = self.began_s < other.ended_s and other.began_s < self.ended_s
        disjoint = self.columns and other.columns and set(self.columns).isdisjoint(other.columns)
        return overlap and self.run == other.run and not disjoint


_MODEL_FLAGS = SpotFlag.MULTIPLE | SpotFlag.LEARNED
"""Flags that name the model of a spot and no fault of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """The beam of a run, by the models and flags of its spots."""

    model: str = ""
    """The model of the spot in use at the end."""
    since_frame: int = -1
    """Number of the first frame that was fitted with this model."""
    changes: int = 0
    """Number of changes of the model after the first choice."""
    flags: Mapping[str, int] = field(default_factory=dict)
    """Number of spots with each flag, without zeros."""
    choosing_frames: int = 0
    """Number of frames at the beginning from which the profile was learned."""
    judged_frames: int = 0
    """Number of later spots, on which POOR_FIT is judged."""
    poor_fit_frames: int = 0
    """Number of these with POOR_FIT."""
    poor_fit_fraction: float = nan
    likely_cause: str = ""
    """The most likely reason of POOR_FIT."""
    remedy: str = ""

    @classmethod
    def of(cls, use: BeamUse, *, noise_is_known: bool) -> Self:
        """The beam by counts of flags; `noise_is_known` is whether the sensor's noise is stated."""
        cause, remedy = _cause(use, noise_is_known=noise_is_known) if use.poor_frames else ("", "")
        return cls(
            model=use.model or "",
            since_frame=use.since_frame,
            changes=use.changes,
            flags={flag.name or "": count for flag, count in use.flags.items() if count},
            choosing_frames=use.choosing_frames,
            judged_frames=use.judged_frames,
            poor_fit_frames=use.poor_frames,
            poor_fit_fraction=use.poor_frames / use.judged_frames if use.judged_frames else nan,
            likely_cause=cause,
            remedy=remedy,
        )

    @property
    def sentence(self) -> str:
        """A sentence such as `Beam: learned profile since frame 147; spots with POOR_FIT 12.`"""
        if not self.model:
            return "Beam: no spot was found."
        only_at_first = self.choosing_frames > 0 and not self.poor_fit_frames
        counts = [
            f"{name} {count}" + (" (while it was learned)" if name == "POOR_FIT" and only_at_first else "")
            for name, count in self.flags.items()
            if not SpotFlag[name] & _MODEL_FLAGS
        ]
        changes = f", after {self.changes} changes" if self.changes else ""
        flags = f"spots with {', '.join(counts)}" if counts else "no spot is flagged as faulty"
        return f"Beam: {self.model} since frame {self.since_frame}{changes}; {flags}."


def _cause(use: BeamUse, *, noise_is_known: bool) -> tuple[str, str]:
    """The most likely reason of POOR_FIT, and its remedy."""
    majority = 0.5 * use.poor_frames
    if use.poor_with[SpotFlag.EDGE] > majority:
        return "the edge of the sensor cuts the spot", "move the spot to the middle: rig camera align"
    if use.poor_with[SpotFlag.CUT] > majority:
        return "something cuts the spot", "centre the beam in lens, mirrors and window; free its path"
    if use.poor_with[SpotFlag.SATURATED] > majority:
        return (
            "it is saturated, and only its flanks are fitted",
            "lower the exposure (exposure_us) or the laser's power",
        )
    if use.changes:
        return "it changed during the run", "let the laser warm up; fix the optics; look for what moved"
    if use.model is SpotModel.LEARNED:
        return (
            "it changes with position (something cuts it, dust or fringes on the window) or with time",
            "free the beam's path, clean the window; then rig camera align",
        )
    if use.judged_frames < MAX_CHOICE_FRAMES:
        return "the run was too short to learn its profile", "measure longer, or clean the optics"
    if not noise_is_known:
        return "the noise of the sensor is assumed, not measured", "rig calibrate sensor"
    return (
        "no constant profile fits it: it flickers, or the sensor's noise is not as stated",
        "let the laser warm up, shield the beam from air; rig calibrate sensor",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunClock:
    """The clock of a run."""

    drift_ppm: Annotated[float, Quantity("clock drift", "rate of the camera's clock against the computer's")]
    """Rate of the camera's clock against the computer's, less 1; NaN if unknown."""
    u_drift_ppm: float
    u_rate: Annotated[float, Quantity("u(clock)", "standard uncertainty of the run's second, relative")]
    """Relative standard uncertainty of the run's second, as in the budget: that of the calibrated rate or,
    without a calibration, of the assumed ideal one. It includes `u_steps_s`."""
    steps: int = 0
    """Number of steps that were subtracted from the times."""
    largest_step_s: Annotated[float, Quantity("step", "largest step of the camera's clock")] = 0.0
    u_steps_s: float = 0.0
    """Standard uncertainty of all steps together."""
    synchronised: bool = False

    @property
    def text(self) -> str:
        """The clock in one line."""
        from rig.instrument import rate_text

        is_known = isfinite(self.drift_ppm)
        rate = rate_text(self.drift_ppm, self.u_drift_ppm) if is_known else "rate unknown"
        times = "once" if self.steps == 1 else f"{self.steps} times, at most"
        steps = f", stepped {times} by {self.largest_step_s:+.4g} s" if self.steps else ""
        return f"{rate}, second within {1e6 * self.u_rate:.2g} ppm{steps}"
