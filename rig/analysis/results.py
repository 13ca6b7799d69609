"""The values of results.json. Field names are its keys, fixed so that other programs can rely on them.

`rig.analysis.encoding` defines how estimates, arrays and "not determined" are written in the file.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import StrEnum
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np

from acquisition.frames.losses import FrameLosses
from processing.ambient import AmbientConditions
from processing.contact import PendulumOnBall
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.fit import Budget, Drag, SeismometerUse, Work
from processing.position_map import PositionMap
from processing.quantity import IN_UNIT, STATED, Quantity
from processing.series import CombinedValue, Disagreement
from processing.swing import HalfCycle, KnownMotion, TurningPoints
from processing.units import seconds
from rig.analysis.contact_results import ComparedLaws, Fit
from rig.analysis.decay_values import AmplitudeDamping, InstrumentResults, InstrumentSeries
from rig.analysis.encoding import Entries, Floats, Integers, JsonObject, MergedField
from rig.analysis.result_rows import ResultRow, RowsByName
from rig.analysis.run_conditions import Beam, RunClock
from rig.terminal import Verdict

SCHEMA = 1
_RECORD_NAME = re.compile(r"run-(\d+)(-recovered)?\.mcap")
_Run = TypeVar("_Run")
_IN_AMPLITUDE_UNIT = Quantity("", "in `amplitude_unit`", unit=STATED + "amplitude_unit")


class TableUnit(StrEnum):
    """Unit of a table's amplitudes where it is no angle."""

    OWN = "own"
    """The `amplitude_unit` of the results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTurningPoints:
    """The turning points that were fitted, and the half-cycles that were left out.

    Times are in true seconds from `first_ns`, the record's time of the first turning point. Amplitudes are
    in `unit`; for a table without an angle, in its `amplitude_unit`. `left_out_flags` are those of
    `processing.swing.HalfCycleFlag`.
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
        swings: Sequence[HalfCycle],
        unit: DeflectionUnit | TableUnit,
        clock_rate: float,
    ) -> "StoredTurningPoints":
        """The `points` of `swings`, and the half-cycles left out; `clock_rate` is true seconds a second."""
        first_ns = next((swing.turn_time_ns for swing in swings if swing.flags == 0), None)
        if first_ns is None:
            first_ns = swings[0].turn_time_ns if swings else 0
        left_out = [swing for swing in swings if swing.flags]
        return cls(
            first_ns=first_ns,
            unit=unit,
            **{column.name: getattr(points, column.name) for column in fields(points)},
            left_out_time_s=np.array(
                [seconds(swing.turn_time_ns - first_ns) * clock_rate for swing in left_out]
            ),
            left_out_amplitude=np.array([swing.amplitude for swing in left_out]),
            left_out_flags=np.array([swing.flags for swing in left_out], dtype=np.int64),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionErrors:
    """Fixed-pattern position errors of the sensor, by the run itself; they were subtracted before the fits.

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
        """The errors at the knots of the map."""
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
        """Rms of the error about its mean, in `unit`."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDecay:
    """Place of a decay in a table: times of its first and last turning point, from the table's first row.

    `run` is the name of its run, if the file contains several. `session` are sample, its history, operator
    and notes by the configuration.
    """

    began_s: float = nan
    ended_s: float = nan
    run: str = ""
    session: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RunResults(RowsByName):
    """Results of one run, or of one decay of a table; `problem` says in one line why a fit is missing.

    `record` is relative to the folder of the file where possible. `sha256` is its hash, `inputs_sha256` those
    of the configuration, the calibrations and the pixels that belong to it. `simulated`: its frames are those
    of the simulated rig; None for a table. `losses` counts the missing frames by cause; None if the record
    does not say. `beam` names the model fitted to the spots and counts their flags. `table` has a row for
    every number that is reported: those of the exact fit and the apparatus, then those of any decay, with or
    without a law: period and decrement (means over the decay), quality factor (none where the decrement
    changes, does not differ from zero, or is larger than pi), first and last amplitude, in arcsec, or in px
    for a record without a lever, or in the unit of a table. `measured_again_on` is the motion of the second
    measurement of the turning points (see `processing.fit.refinement`); None: they are as detected.
    `position_errors` were subtracted from the deflections before that; None if the run shows none. `laws`
    compares several laws, if requested. `adhesion` names the theory that the Tabor parameter selects for the
    contact spot, if c is determined and the spot's radius is Hertz's; the rows have the spot by every theory.
    `ended` is the reason of the run's end in its record. `clock` compares the camera's clock with the
    computer's; None for frames made on demand. `surroundings` are the air and the history of the contact;
    `conditions` are verdicts on the conditions of the run. `witness` is the use of an auxiliary seismometer,
    if there was one. Results of a fit (`pendulum` to `notes`) are empty without one. `damping` is the damping
    as a function of the amplitude, in `amplitude_unit`; None for fewer than twelve half-cycles, and for
    amplitudes that do not fall. `decay` is None for a record.
    """

    record: str
    sha256: str = ""
    simulated: bool | None = None
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)
    frames: int = 0
    dropped_frames: int = 0
    losses: FrameLosses | None = None
    beam: Beam | None = None
    half_cycles: int = 0
    measured_again_on: KnownMotion | None = None
    amplitude_unit: str | None = None
    table: tuple[ResultRow, ...] = ()
    fits: Mapping[str, Annotated[Fit, MergedField("parameters")]] = field(default_factory=dict)
    problem: str = ""
    warnings: tuple[str, ...] = ()
    settings: JsonObject = field(default_factory=dict)
    calibration: JsonObject = field(default_factory=dict)
    pendulum: PendulumOnBall | None = None
    adhesion: str = ""
    drag: Drag | None = None
    budget: Mapping[str, Budget] = field(default_factory=dict)
    work_per_cycle: tuple[Work, ...] = ()
    notes: tuple[str, ...] = ()
    instrument: InstrumentResults | None = None
    turning_points: StoredTurningPoints | None = None
    conditions: tuple[Verdict, ...] = ()
    position_errors: PositionErrors | None = None
    laws: ComparedLaws | None = None
    ended: str | None = None
    surroundings: AmbientConditions | None = None
    clock: RunClock | None = None
    witness: SeismometerUse | None = None
    damping: Annotated[AmplitudeDamping | None, _IN_AMPLITUDE_UNIT] = None
    decay: TableDecay | None = None

    @property
    def stored(self) -> StoredTurningPoints:
        """The stored turning points; empty columns where there are none."""
        return self.turning_points or StoredTurningPoints()

    @property
    def points(self) -> TurningPoints:
        """The turning points that were fitted."""
        return TurningPoints(*(getattr(self.stored, column.name) for column in fields(TurningPoints)))

    @property
    def amplitudes(self) -> tuple[float, float]:
        """First and last amplitude in `amplitude_unit`; NaN where there is none."""
        return self.number("initial_amplitude").value, self.number("final_amplitude").value

    def half_cycles_text(self, unit: str, before_amplitudes: str = ", ") -> str:
        """`33 half-cycles, 123.24 to 101.09 arcsec`, or `no half-cycles`.

        `unit` is that of the record's deflections as shown; amplitudes of a pendulum that swings by degrees
        are in degrees.
        """
        first, last = self.amplitudes
        if not self.half_cycles or not isfinite(first + last):
            return f"{self.half_cycles or 'no'} half-cycles"
        if self.instrument is not None and self.amplitude_unit == "arcsec":
            text = f"{first / 3600:.4f} to {last / 3600:.4f} deg"
            return f"{self.half_cycles} half-cycles{before_amplitudes}{text}"
        return f"{self.half_cycles} half-cycles{before_amplitudes}{first:.2f} to {last:.2f} {unit}"

    @property
    def source_name(self) -> str:
        """Name of the file without its ending, and of the run in it."""
        run = "" if self.decay is None else self.decay.run
        return f"{Path(self.record).stem}{f'-run-{run}' if run else ''}"

    def __repr__(self) -> str:
        unit = self.amplitude_unit or ""
        return self._summary(
            f"run {self.record}: {self.half_cycles_text(unit)}{self.problem and '; '}{self.problem}"
        )


@dataclass(frozen=True, slots=True)
class AveragedCurves:
    """The paper's procedure: Eqs. 5 and 6 fitted to the average of the runs' curves."""

    parameters: Annotated[Mapping[str, Estimate], Entries] = field(default_factory=dict)
    arae_decay: float = nan
    arae_period: float = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Series(RowsByName):
    """A series of runs: each fit's parameters combined, in `fits` by the fit's name.

    `combined_runs` are the numbers of the runs that could be fitted, counted from 1 among all, in the order
    of the lists `runs` of `fits`; empty for another instrument, of which all are combined.
    """

    runs: int = 0
    combined_runs: tuple[int, ...] = ()
    table: tuple[ResultRow, ...] = ()
    fits: Annotated[Mapping[str, Mapping[str, CombinedValue]], Entries] = field(default_factory=dict)
    budget: Mapping[str, Budget] = field(default_factory=dict)
    disagreements: tuple[Disagreement, ...] = ()
    averaged_curves: Annotated[AveragedCurves, MergedField("parameters")] | None = None
    problems: tuple[str, ...] = ()
    instrument: InstrumentSeries | None = None

    def combined(self, runs: Sequence[_Run]) -> Sequence[_Run]:
        """The elements, one for each run, of the runs that are combined."""
        return [runs[number - 1] for number in self.combined_runs] or runs


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SessionResults(RowsByName):
    """results.json of one or more records, or of the decays of a table of positions of any instrument.

    By name it has the rows of its series, or of its first run with a fit: ``results["b"]``. For a table
    `trajectory` is the file, `unit` that of its positions, and `understood` are lines on how the file was
    read, and which of its rows were left out.
    """

    schema: int = SCHEMA
    trajectory: str = ""
    unit: str = ""
    understood: tuple[str, ...] = ()
    runs: tuple[RunResults, ...]
    series: Annotated[Series, MergedField("fits")] | None = None

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the runs: those in the names of their records, else their places from 1."""
        named = [_RECORD_NAME.fullmatch(Path(run.record).name) for run in self.runs]
        numbers = tuple(int(found[1]) for found in named if found is not None)
        is_whole = len(set(numbers)) == len(self.runs)
        return numbers if is_whole else tuple(range(1, len(self.runs) + 1))

    @property
    def table(self) -> Sequence[ResultRow]:
        """The rows of its series, or of its first run with a fit."""
        if self.series is not None and self.series.table:
            return self.series.table
        return next((run.table for run in self.runs if run.contact), self.runs[0].table if self.runs else ())

    def __repr__(self) -> str:
        return self._summary("\n".join(repr(run).partition("\n")[0] for run in self.runs))


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvelopeResults:
    """results.json of an envelope: see `processing.envelope.EnvelopeDecay`."""

    schema: int = SCHEMA
    envelope: str
    unit: str
    understood: tuple[str, ...] = ()
    samples: int
    time_constant_s: Estimate
    first_half_s: float = nan
    last_half_s: float = nan
    chi2_per_dof: float = nan
    noise_floor: float = nan
    damping: AmplitudeDamping | None = None
    quality_factor: Estimate | None = None
    warnings: tuple[str, ...] = ()
