"""The values of results.json. Field names are its keys, fixed so that other programs can rely on them.

`rig.analysis.encoding` defines how estimates, arrays and "not determined" are written in the file.
"""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from math import inf, isfinite, nan
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar

import numpy as np

from acquisition.frames.losses import FrameLosses
from processing.ambient import AmbientConditions
from processing.contact import DRAG, ContactParameters, PendulumOnBall
from processing.contact.laws import DEFAULT_LAW
from processing.estimate import NOT_DETERMINED, Estimate
from processing.fit import Budget, Drag, FitQuality, SeismometerUse, Work
from processing.quantity import STATED, Quantity
from processing.series import CombinedValue, Disagreement
from processing.swing import KnownMotion, TurningPoints
from rig.analysis.decay_values import AmplitudeDamping, InstrumentResults, InstrumentSeries
from rig.analysis.encoding import Entries, Floats, JsonObject, MergedField
from rig.analysis.result_rows import ResultRow, RowsByName
from rig.analysis.run_values import Beam, PositionErrors, RunClock, StoredTurningPoints, TableDecay
from rig.terminal import Verdict

SCHEMA = 1
_RECORD_NAME = re.compile(r"run-(\d+)(-recovered)?\.mcap")
_Run = TypeVar("_Run")
_IN_AMPLITUDE_UNIT = Quantity("", "in `amplitude_unit`", unit=STATED + "amplitude_unit")


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Fit(FitQuality):
    """One fit of one decay: parameters by name, and the quality of the fit.

    `law` names the law of `processing.contact.laws` that was fitted.
    `ground` and `whiteness` are None for the asymptotic fit.
    """

    law: str = ""
    parameters: Annotated[Mapping[str, Estimate], Entries] = field(default_factory=dict)
    correlation: Correlation = field(default_factory=Correlation)

    def estimate(self, name: str) -> Estimate:
        """A parameter; NaN where the fit has none of that name."""
        return self.parameters.get(name, NOT_DETERMINED)

    def contact(self) -> ContactParameters:
        """The contact parameters of the paper's law; NaN where the fit has none."""
        values = {name: self.estimate(name).value for name in DEFAULT_LAW.names()}
        drag = self.parameters.get(DRAG.key)
        return ContactParameters(**values, drag_s=0.0 if drag is None else drag.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class LawFit:
    """The best fit of one law.

    `bic_above_best` is its distance from the best law in Schwarz's criterion, `ground_rad_per_s2_rthz` the
    drive that the law needs; `problem` is the reason where there is no fit.
    """

    title: str
    source: str
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    bic_above_best: float = inf
    ground_rad_per_s2_rthz: float = inf
    residuals_are_noise: bool = False
    excluded: bool = True
    problem: str = ""


@dataclass(frozen=True, slots=True)
class LawMoments:
    """Both moments of a fitted law, in the terms of `ModelFreeMoments`."""

    friction_n_m: Floats
    elastic_n_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFreeMoments:
    """Friction against the motion and elastic moment at the angles `phi_rad`, as splines of the angle.

    `u_friction_n_m` and `u_elastic_n_m` are standard uncertainties: bands that cover 68 %. A moment
    proportional to the angle is not told from gravity's, so the elastic moment vanishes at `reference_rad`;
    gravity's part of the stiffness follows from T0 of the exact fit. `laws` has the fitted laws in the same
    terms. `ground_rad_per_s2_rthz` is the drive with which the splines fit.
    """

    phi_rad: Floats = field(default_factory=lambda: np.empty(0))
    friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    u_friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    u_elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    reference_rad: float = nan
    ground_rad_per_s2_rthz: float = nan
    laws: Mapping[str, LawMoments] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ComparedLaws:
    """Laws by name, the best first, the verdict in words, and the moments without a law (None: no fit)."""

    laws: Mapping[str, LawFit]
    verdict: str
    without_law: ModelFreeMoments | None = None


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
    computer's; None for frames made on demand. `ambient` are the air and the history of the contact;
    `conditions` are verdicts on the conditions of the run. `seismometer` is the use of an auxiliary one, if
    there was one. Results of a fit (`pendulum` to `notes`) are empty without one. `damping` is the damping
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
    ambient: AmbientConditions | None = None
    clock: RunClock | None = None
    seismometer: SeismometerUse | None = None
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

    def is_of_same_motion(self, other: "RunResults") -> bool:
        """Whether both are results of one record, or of one stretch of a table."""
        if not self.sha256 or self.sha256 != other.sha256:
            return False
        return self.decay is None or other.decay is None or self.decay.overlaps(other.decay)

    def __repr__(self) -> str:
        unit = self.amplitude_unit or ""
        return self._summary(
            f"run {self.record}: {self.half_cycles_text(unit)}{self.problem and '; '}{self.problem}"
        )


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
    problems: tuple[str, ...] = ()
    instrument: InstrumentSeries | None = None

    def combined(self, runs: Sequence[_Run]) -> Sequence[_Run]:
        """The elements, one for each run, of the runs that are combined."""
        return [runs[number - 1] for number in self.combined_runs] or runs


class RunIdentity(NamedTuple):
    """Name and hash of a run.

    They are those of its record. A later decay of a table, and a run of a table of several, has both derived
    from the table's.
    """

    name: str
    sha256: str


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
    def identities(self) -> tuple[RunIdentity, ...]:
        """Name and hash of each run, which differ from those of all other runs."""
        found, decays = [], 0
        for run in self.runs:
            decays += run.decay is not None
            later = f"decay-{decays}" if decays > 1 and run.decay is not None else ""
            of_run = f"run {run.decay.run}" if run.decay is not None and run.decay.run else ""
            suffix = "".join(f" {part}" for part in (of_run, later.replace("-", " ")) if part)
            derived = hashlib.sha256(f"{run.sha256}{suffix}".encode()).hexdigest()
            name = "-".join(filter(None, (run.source_name, later)))
            found.append(RunIdentity(name, derived if suffix else run.sha256))
        return tuple(found)

    @property
    def table(self) -> Sequence[ResultRow]:
        """The rows of its series, or of its first run with a fit."""
        if self.series is not None and self.series.table:
            return self.series.table
        return next((run.table for run in self.runs if run.contact), self.runs[0].table if self.runs else ())

    def __repr__(self) -> str:
        return self._summary("\n".join(repr(run).partition("\n")[0] for run in self.runs))
