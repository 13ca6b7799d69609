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
_Item = TypeVar("_Item")
_IN_AMPLITUDE_UNIT = Quantity("", "in `amplitude_unit`", unit=STATED + "amplitude_unit")


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation matrix of a fit's parameters, row by row."""

    names: tuple[str, ...] = ()
    matrix: tuple[tuple[float, ...], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Fit(FitQuality):
    """One fit of one decay: parameters by name, and the quality of the fit.

    `ground` and `whiteness` are None for the asymptotic fit.
    """

    law: str = ""
    """Name of the fitted law in `processing.contact.laws`."""
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
    """The best fit of one law."""

    title: str
    source: str
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    bic_above_best: float = inf
    """Distance from the best law in Schwarz's criterion."""
    ground_rad_per_s2_rthz: float = inf
    """Drive of the ground that the law needs."""
    residuals_are_noise: bool = False
    excluded: bool = True
    problem: str = ""
    """The reason why there is no fit; empty if there is one."""


@dataclass(frozen=True, slots=True)
class LawMoments:
    """Both moments of a fitted law, as in `ModelFreeMoments`."""

    friction_n_m: Floats
    elastic_n_m: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFreeMoments:
    """Moments at the angles `phi_rad`, as splines of the angle.

    An elastic moment proportional to the angle cannot be distinguished from gravity's, whose part of the
    stiffness follows from T0 of the exact fit.
    """

    phi_rad: Floats = field(default_factory=lambda: np.empty(0))
    friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    """Friction against the motion."""
    u_friction_n_m: Floats = field(default_factory=lambda: np.empty(0))
    elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    """Elastic moment, less the part proportional to the angle that makes it 0 at `reference_rad`."""
    u_elastic_n_m: Floats = field(default_factory=lambda: np.empty(0))
    reference_rad: float = nan
    ground_rad_per_s2_rthz: float = nan
    """Drive of the ground with which the splines fit."""
    laws: Mapping[str, LawMoments] = field(default_factory=dict)
    """Moments of the fitted laws."""


@dataclass(frozen=True, slots=True)
class ComparedLaws:
    """Comparison of laws by fits to one run."""

    laws: Mapping[str, LawFit]
    """Fits by name of the law, the best first."""
    verdict: str
    without_law: ModelFreeMoments | None = None
    """Moments without a law; None if their splines could not be fitted."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class RunResults(RowsByName):
    """Results of one run, or of one decay of a table; `pendulum` to `notes` are empty without a fit."""

    record: str
    """Path of the record, relative to the folder of the results file if the record is inside."""
    sha256: str = ""
    """Hash of the record."""
    simulated: bool | None = None
    """Whether the frames are those of the simulated rig; None for a table."""
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)
    """Hashes of the configuration, the calibrations and the pixels that belong to the record."""
    frames: int = 0
    dropped_frames: int = 0
    losses: FrameLosses | None = None
    """Numbers of missing frames by cause; None if the record does not state them."""
    beam: Beam | None = None
    half_cycles: int = 0
    measured_again_on: KnownMotion | None = None
    """Motion of the second measurement of the turning points (see `processing.fit.refinement`); None if they
    are as detected."""
    amplitude_unit: str | None = None
    """Unit of the amplitudes: arcsec, px for a record without a lever, or the unit of a table."""
    table: tuple[ResultRow, ...] = ()
    """A row for every number that is reported: those of the exact fit and the apparatus, then those of any
    decay: mean period, mean decrement, quality factor (none where the decrement changes, does not differ from
    zero, or is larger than pi), first and last amplitude."""
    fits: Mapping[str, Annotated[Fit, MergedField("parameters")]] = field(default_factory=dict)
    problem: str = ""
    """The reason why a fit is missing, in one line."""
    warnings: tuple[str, ...] = ()
    settings: JsonObject = field(default_factory=dict)
    calibration: JsonObject = field(default_factory=dict)
    pendulum: PendulumOnBall | None = None
    adhesion: str = ""
    """Name of the theory that the Tabor parameter selects for the contact spot, if c is determined and the
    spot's radius is Hertz's; the rows have the spot by every theory."""
    drag: Drag | None = None
    budget: Mapping[str, Budget] = field(default_factory=dict)
    work_per_cycle: tuple[Work, ...] = ()
    notes: tuple[str, ...] = ()
    instrument: InstrumentResults | None = None
    turning_points: StoredTurningPoints | None = None
    conditions: tuple[Verdict, ...] = ()
    """Verdicts on the conditions of the run."""
    position_errors: PositionErrors | None = None
    """Errors that were subtracted from the deflections before the second measurement; None if the run shows
    none."""
    laws: ComparedLaws | None = None
    """Comparison of several laws, if requested."""
    ended: str | None = None
    """The reason of the run's end, by its record."""
    ambient: AmbientConditions | None = None
    """The air, and the history of the contact."""
    clock: RunClock | None = None
    """The camera's clock against the computer's; None for frames made on demand."""
    seismometer: SeismometerUse | None = None
    """The use of an auxiliary seismometer, if there was one."""
    damping: Annotated[AmplitudeDamping | None, _IN_AMPLITUDE_UNIT] = None
    """Damping as a function of the amplitude; None for fewer than twelve half-cycles, and for amplitudes that
    do not fall."""
    decay: TableDecay | None = None
    """Place of the decay in its table; None for a record."""

    @property
    def stored(self) -> StoredTurningPoints:
        """The stored turning points; empty arrays where there are none."""
        return self.turning_points or StoredTurningPoints()

    @property
    def points(self) -> TurningPoints:
        """The turning points that were fitted."""
        return TurningPoints(*(getattr(self.stored, item.name) for item in fields(TurningPoints)))

    @property
    def amplitudes(self) -> tuple[float, float]:
        """First and last amplitude in `amplitude_unit`; NaN where there is none."""
        return self.number("initial_amplitude").value, self.number("final_amplitude").value

    def half_cycles_text(self, separator: str = ", ") -> str:
        """Text such as `33 half-cycles, 123.24 to 101.09 arcsec`, or `no half-cycles`."""
        first, last = self.amplitudes
        count = f"{self.half_cycles or 'no'} half-cycles"
        if not self.half_cycles or not isfinite(first + last):
            return count
        # a pendulum of another kind swings by degrees
        if self.instrument is not None and self.amplitude_unit == "arcsec":
            return f"{count}{separator}{first / 3600:.4f} to {last / 3600:.4f} deg"
        return f"{count}{separator}{first:.2f} to {last:.2f} {self.amplitude_unit or ''}"

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
        problem = self.problem and f"; {self.problem}"
        return self._summary(f"run {self.record}: {self.half_cycles_text()}{problem}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Series(RowsByName):
    """Results of several runs together."""

    runs: int = 0
    combined_runs: tuple[int, ...] = ()
    """Numbers, from 1, of the fitted runs in the order of the lists `runs` of `fits`; empty for another kind
    of pendulum, of which all runs are combined."""
    table: tuple[ResultRow, ...] = ()
    fits: Annotated[Mapping[str, Mapping[str, CombinedValue]], Entries] = field(default_factory=dict)
    """Combined parameters by the name of the fit."""
    budget: Mapping[str, Budget] = field(default_factory=dict)
    disagreements: tuple[Disagreement, ...] = ()
    problems: tuple[str, ...] = ()
    """Reasons why fits could not be combined."""
    instrument: InstrumentSeries | None = None

    def combined(self, items: Sequence[_Item]) -> Sequence[_Item]:
        """Those of `items`, which has one for each run, that belong to a combined run."""
        return [items[number - 1] for number in self.combined_runs] or items


class RunIdentity(NamedTuple):
    """Name and hash of a run: those of its record.

    A later decay of a table, and a run of a table of several, has both derived from the table's.
    """

    name: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SessionResults(RowsByName):
    """results.json of one or more records, or of the decays of a table of positions of any instrument.

    ``results["b"]`` is a row of its series, or of its first run with a fit.
    """

    schema: int = SCHEMA
    trajectory: str = ""
    """File of a table or a film; empty for records."""
    unit: str = ""
    """Unit of the positions of a table."""
    understood: tuple[str, ...] = ()
    """Lines on how a table was read, and which of its rows were left out."""
    runs: tuple[RunResults, ...]
    series: Annotated[Series, MergedField("fits")] | None = None

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the runs: those in the names of their records, else their places from 1."""
        matches = [_RECORD_NAME.fullmatch(Path(run.record).name) for run in self.runs]
        numbers = tuple(int(match[1]) for match in matches if match is not None)
        are_distinct = len(set(numbers)) == len(self.runs)
        return numbers if are_distinct else tuple(range(1, len(self.runs) + 1))

    @property
    def identities(self) -> tuple[RunIdentity, ...]:
        """Name and hash of each run, which differ from those of all other runs."""
        identities, decays = [], 0
        for run in self.runs:
            decays += run.decay is not None
            later = f"decay-{decays}" if decays > 1 and run.decay is not None else ""
            run_name = f"run {run.decay.run}" if run.decay is not None and run.decay.run else ""
            suffix = "".join(f" {part}" for part in (run_name, later.replace("-", " ")) if part)
            derived = hashlib.sha256(f"{run.sha256}{suffix}".encode()).hexdigest()
            name = "-".join(filter(None, (run.source_name, later)))
            identities.append(RunIdentity(name, derived if suffix else run.sha256))
        return tuple(identities)

    @property
    def table(self) -> Sequence[ResultRow]:
        """The rows of its series, or of its first run with a fit."""
        if self.series is not None and self.series.table:
            return self.series.table
        return next((run.table for run in self.runs if run.contact), self.runs[0].table if self.runs else ())

    def __repr__(self) -> str:
        return self._summary("\n".join(repr(run).partition("\n")[0] for run in self.runs))
