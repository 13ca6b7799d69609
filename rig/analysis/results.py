"""The values of results.json. Field names are its keys, fixed so that other programs can rely on them.

Every field has a default: files of earlier versions, which lack some of them, are read as well.
`rig.analysis.encoding` says how estimates, arrays and "not determined" are spelled in the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite, nan
from typing import Annotated

from acquisition.frame_losses import FrameLosses
from processing.swing import KnownMotion
from rig.analysis.beam import Beam
from rig.analysis.contact_results import (
    NOT_DETERMINED,
    Adhesion,
    Budget,
    Determination,
    Drag,
    Fit,
    Hertz,
    MonteCarlo,
    SurfaceEnergies,
    SurfaceEnergy,
    Work,
)
from rig.analysis.encoding import (
    AsObject,
    Beside,
    Entries,
    JsonObject,
    LeftOut,
    Number,
    Pendulum,
    Section,
    Value,
)
from rig.analysis.instrument_results import InstrumentResults, InstrumentSeries
from rig.analysis.law_results import ComparedLaws
from rig.analysis.stored_position_errors import PositionErrors
from rig.analysis.stored_turning_points import StoredTurningPoints
from rig.analysis.surroundings import Surroundings
from rig.presentation import Verdict

SCHEMA = 2
"""Version of the file. 1, the first, has no `amplitude_unit`, `record_bytes` and `turning_points`, and px
under the names in arcsec of a record without a lever."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResults:
    """What is reported of one run; `problem` says in one line why a fit is missing.

    `record` is relative to the folder of the file where it can be; `sha256` is its hash, `inputs_sha256` are
    those of the configuration and the calibrations in it. `simulated`: its frames are those of the simulated
    rig; None where an older file does not say, and of a table. `losses` says who lost the frames that
    are missing; None where an older record does not. `beam` says which model was fitted to the spots, and
    counts their flags. `measured_again_on` is the motion on which the fitted
    turning points were measured again (see `processing.fit.remeasure`); None: they are as detected.
    `position_errors` were taken off the deflections before that; None where the run shows none.
    `laws` compares several, where that was asked for. `adhesion` is the contact spot with adhesion, where c
    is seen and the spot's radius calculated after Hertz.
    `initial_amplitude` and `final_amplitude` are in `amplitude_unit`: arcsec, or px of a record without a
    lever; those in arcsec are not determined then. `ended` is why the run ended, as its record says.
    `surroundings` are the air and the contact's history, which `conditions` judges beside light, losses and
    what else the record shows. What follows from a
    fit (`pendulum` to `notes`) is empty where there is none.
    """

    record: str
    sha256: str = ""
    simulated: Annotated[bool | None, LeftOut] = None
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)
    record_bytes: int | None = None
    frames: int = 0
    dropped_frames: int = 0
    losses: Annotated[FrameLosses, AsObject] | None = None
    beam: Annotated[Beam | None, LeftOut] = None
    half_cycles: int = 0
    measured_again_on: KnownMotion | None = None
    amplitude_unit: str | None = None
    initial_amplitude: Number = nan
    final_amplitude: Number = nan
    initial_amplitude_arcsec: Number = nan
    final_amplitude_arcsec: Number = nan
    fits: Mapping[str, Annotated[Fit, Beside("parameters")]] = field(default_factory=dict)
    surface_energy_j_per_m2: Annotated[Annotated[SurfaceEnergies, Beside("others")] | None, Section] = None
    problem: str = ""
    warnings: tuple[str, ...] = ()
    settings: JsonObject = field(default_factory=dict)
    calibration: JsonObject = field(default_factory=dict)
    pendulum: Pendulum | None = None
    hertz: Annotated[Hertz | None, Section] = None
    adhesion: Annotated[Adhesion | None, LeftOut] = None
    drag: Annotated[Drag | None, Section] = None
    identifiability: tuple[Determination, ...] = ()
    strong_correlations: tuple[tuple[str, str, Number], ...] = ()
    budget: Mapping[str, Budget] = field(default_factory=dict)
    monte_carlo: Annotated[MonteCarlo | None, Section] = None
    work_per_cycle: tuple[Work, ...] = ()
    notes: tuple[str, ...] = ()
    instrument: Annotated[InstrumentResults | None, LeftOut] = None
    turning_points: StoredTurningPoints | None = None
    conditions: tuple[Verdict, ...] = ()
    position_errors: PositionErrors | None = None
    laws: Annotated[ComparedLaws | None, LeftOut] = None
    ended: Annotated[str | None, LeftOut] = None
    surroundings: Annotated[Surroundings | None, LeftOut] = None

    def half_cycles_text(self, unit: str, before_amplitudes: str = ", ") -> str:
        """`33 half-cycles, 123.24 to 101.09 arcsec`, or that there are none.

        `unit` is that of the record's deflections as shown, which files of schema 1 do not name. A pendulum
        that swings by degrees has its amplitudes in them.
        """
        if not self.half_cycles or not isfinite(self.initial_amplitude + self.final_amplitude):
            return f"{self.half_cycles or 'no'} half-cycles"
        first, last = self.initial_amplitude, self.final_amplitude
        if self.instrument is not None and self.amplitude_unit == "arcsec":
            text = f"{first / 3600:.4f} to {last / 3600:.4f} deg"
            return f"{self.half_cycles} half-cycles{before_amplitudes}{text}"
        return f"{self.half_cycles} half-cycles{before_amplitudes}{first:.2f} to {last:.2f} {unit}"

    def verdicts(self) -> dict[str, Determination]:
        """By parameter, whether the data determine it."""
        return {item.name: item for item in self.identifiability}


@dataclass(frozen=True, slots=True, kw_only=True)
class CombinedParameter:
    """One parameter over the runs of a series: see `processing.fit.series.Combined`."""

    value: Number
    standard_uncertainty: Number
    expanded_uncertainty_95: Number = nan
    degrees_of_freedom: int = 0
    within_runs: Number = nan
    between_runs: Number = nan
    p_homogeneous: Number = nan
    runs: tuple[Value, ...] = ()


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A run (counted from 1) that lies `deviation` standard uncertainties from what the others say."""

    run: int
    name: str
    deviation: Number


@dataclass(frozen=True, slots=True)
class AveragedCurves:
    """The paper's way: the runs' curves averaged, then Eqs. 5 and 6 fitted."""

    parameters: Annotated[Mapping[str, Value], Entries] = field(default_factory=dict)
    arae_decay: Number = nan
    arae_period: Number = nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """A series of runs: each fit's parameters combined, in `fits` by the fit's name."""

    runs: int = 0
    fits: Annotated[Mapping[str, Mapping[str, CombinedParameter]], Entries] = field(default_factory=dict)
    surface_energy_j_per_m2: Annotated[SurfaceEnergy | None, Section] = None
    budget: Mapping[str, Budget] = field(default_factory=dict)
    disagreements: tuple[Disagreement, ...] = ()
    averaged_curves: Annotated[Annotated[AveragedCurves, Beside("parameters")] | None, Section] = None
    problems: tuple[str, ...] = ()
    instrument: Annotated[InstrumentSeries | None, LeftOut] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionResults:
    """results.json of one or more records."""

    schema: int = SCHEMA
    runs: tuple[RunResults, ...]
    series: Annotated[Annotated[Series, Beside("fits")] | None, Section] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDecay(RunResults):
    """One decay of a table: what a run of the rig reports, and mean period and logarithmic decrement.

    `initial_amplitude` and `final_amplitude` are in the table's own unit, `amplitude_unit`; `began_s` and
    `ended_s` are the first and the last turning point since the table's first row.
    """

    began_s: Number = nan
    ended_s: Number = nan
    period_s: Value = NOT_DETERMINED
    log_decrement: Value = NOT_DETERMINED


@dataclass(frozen=True, slots=True, kw_only=True)
class TableResults(TableDecay):
    """results.json of a table of positions of any instrument.

    `decays` are all that were found, the values beside them those of the longest one.
    """

    schema: int = SCHEMA
    trajectory: str
    unit: str
    decays: tuple[TableDecay, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class EnvelopeResults:
    """results.json of an envelope: see `processing.envelope.EnvelopeDecay`."""

    schema: int = SCHEMA
    envelope: str
    unit: str
    samples: int
    time_constant_s: Value
    first_half_s: Number = nan
    last_half_s: Number = nan
    chi2_per_dof: Number = nan
    noise_floor: Number = nan
    quality_factor: Annotated[Value | None, Section] = None
    warnings: tuple[str, ...] = ()
