"""From a closed record to its results: fits, verdicts, what other kinds of pendulum report."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquisition.record.digest import known_sha256_of_any
from acquisition.record.events import end_of
from acquisition.record.proof import measured_sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import RecordedCamera
from acquisition.record.topics import DEFLECTION_FIELDS
from processing.deflections import Deflections, DeflectionUnit, joined
from processing.errors import RecordError
from processing.fit import (
    FitMethod,
    FitResult,
    InputQuantity,
    RigQuantities,
    Witness,
    delay_of_rows,
    points_in_true_time,
)
from processing.periods import mean_period
from processing.spot import BeamUse
from processing.surroundings import Surroundings
from processing.swing import Swing, SwingHarmonics, TurningPoints, swings_of_blocks
from rig.analysis.beam import Beam
from rig.analysis.contact_laws import DecayFits, fit_decay
from rig.analysis.contact_series import combined_series
from rig.analysis.contact_verdicts import evaluate, fit_results, rig_quantities
from rig.analysis.decay_values import values_of_points
from rig.analysis.drifts import believed_drifts
from rig.analysis.fitted_drag import OPEN_DRAG, evidence_of, known_drag
from rig.analysis.less_reference import WithoutBeamMotion, less_beam_motion
from rig.analysis.other_instruments import Reduction, reduce_run
from rig.analysis.other_instruments_series import reduce_series
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.recorded_witness import recorded_witness
from rig.analysis.results import RunResults, Series, SessionResults
from rig.analysis.results_file import relative_record
from rig.analysis.run_clock import run_clock
from rig.analysis.run_conditions import run_conditions
from rig.analysis.sealed_results import public_key_over, sealed_results
from rig.analysis.settled import settled_swings
from rig.analysis.stored_position_errors import PositionErrors
from rig.analysis.stored_turning_points import StoredTurningPoints
from rig.analysis.surroundings import doubts_of, recorded_surroundings
from rig.analysis.swing_direction import why_no_half_cycles
from rig.analysis.witness_file import Begin, WitnessRecord
from rig.analysis.witnessed_fits import WitnessAt, WitnessedWith, of_source
from rig.instrument import (
    earlier_schema,
    inputs_sha256,
    judge_calibration,
    optics_of,
    pendulum_on_ball,
    recorded_configuration,
)
from rig.settings import Configuration, Watched


@dataclass(frozen=True)
class AnalysedRun:
    """The results of one run, and what a series of runs needs beyond them.

    `points` are the turning points that were fitted. `reduction` is there for a pendulum that is not
    described by the contact's laws, `rig` where the contact radius is calculated after Hertz,
    `earlier_schema` what `earlier_schema` of `rig.instrument` says of its configuration.
    `watched` is the configuration of which keys were changed.
    """

    record: Path
    results: RunResults
    points: TurningPoints
    fits: Mapping[str, FitResult]
    rig: RigQuantities | None = None
    reduction: Reduction | None = None
    harmonics: SwingHarmonics | None = None
    lost_spots: int = 0
    earlier_schema: str = ""
    watched: Watched | None = None


def analyse_record(
    path: Path,
    overrides: Sequence[str] = (),
    *,
    air_known: bool = True,
    witness: WitnessRecord | None = None,
) -> AnalysedRun:
    """Fit one closed record; `overrides` change its configuration (fit settings, pendulum) for this fit.

    Without `air_known` nothing is known of the drag, whatever the record's own configuration states.
    `witness` is a witness of the ground; without it the one that the record holds, if it does.
    """
    with RecordReader(path) as reader:
        config = recorded_configuration(reader, overrides)
        if not air_known:
            config = config.model_copy(update={"fit": config.fit.opened})
        watched = Watched(config, overrides, "rig replay takes the recorded motion again")
        # what this reads, the recorded deflections were made with
        optics_of(watched.config, full_scale_dn=1.0).deflector((1, 1))(np.zeros(0, np.int64), [])
        watched.refuse_read()
        less = less_beam_motion(reader, config)
        blocks = _RecordedDeflections(reader, less if less is not None and less.used else None)
        swings, unit = reader.swings(), reader.deflection_unit
        if less is not None and less.used:
            swings = swings_of_blocks(blocks)
        run = analyse_run(reader, watched.config, swings, blocks, unit, blocks.beam, witness=witness)
        if less is not None:
            run = replace(run, results=replace(run.results, notes=(*run.results.notes, less.text)))
        run = replace(run, earlier_schema=earlier_schema(reader), watched=watched)
        return with_dropped_frames(run, blocks.following - run.results.frames, reader, watched.config)


class _RecordedDeflections:
    """The deflections of a record, read again each time.

    `following` is the number after the last frame's, `beam` what the spots say, each taken once. `less` takes
    off what a reference spot shares with the pendulum's.
    """

    def __init__(self, reader: RecordReader, less: WithoutBeamMotion | None = None) -> None:
        self._less = less
        self.following = 0
        self.beam = BeamUse()
        self._reader = reader

    def __iter__(self) -> Iterator[Deflections]:
        fields = ("sequence", "flags", *DEFLECTION_FIELDS[self._reader.deflection_unit])
        for spots in self._reader.spot_blocks(fields=fields):
            if int(spots["sequence"][0]) >= self.following:
                self.beam.take(spots["sequence"], spots["flags"])
                self.following = int(spots["sequence"][-1]) + 1
            deflections = self._reader.deflections(spots)
            yield deflections if self._less is None else self._less(deflections)


def analyse_run(
    reader: RecordReader,
    config: Configuration,
    swings: Sequence[Swing],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    beam: BeamUse,
    *,
    replayed: bool = False,
    witness: WitnessRecord | None = None,
) -> AnalysedRun:
    """Fit half-cycles and deflections that came from a record: those in it, or what a replay made of it.

    `blocks` are the deflections of consecutive frames, in `unit`; `beam` is what their spots say once they
    have passed.
    """
    deflections, surroundings = PassingDeflections(blocks, unit), recorded_surroundings(reader, config)
    clock = run_clock(reader, config, replayed=replayed)
    u_clock = 0.0 if clock is None else clock.u_rate

    def beside(turn_time_ns: int) -> tuple[Witness, bool]:
        assert witness is not None
        in_file_ns = turn_time_ns - deflections.first_ns
        return witness.beside(Begin(in_file_ns, turn_time_ns + reader.epoch_offset_ns))

    own = recorded_witness(reader, config) if witness is None else None

    def of_record(turn_time_ns: int) -> tuple[Witness, bool]:
        assert own is not None
        return own.beside(Begin(turn_time_ns))

    at = of_record if own is not None else None if witness is None else beside
    run = analyse_swings(reader.path, swings, config, deflections, surroundings, u_clock, at)
    began, ended = reader.utc(deflections.first_ns), reader.utc(deflections.last_ns)
    calibration, doubts = judge_calibration(config, reader.attachments, began, ended)
    warnings = [*run.results.warnings, *doubts, *reader.doubts(), *doubts_of(surroundings)]
    end = end_of(reader.events())
    results = replace(
        run.results,
        frames=deflections.frames,
        simulated=RecordedCamera.of(reader.metadata).simulated,
        losses=reader.losses(),
        beam=Beam.of(beam, noise_is_known=config.sensor is not None),
        warnings=tuple(warnings),
        calibration=calibration,
        inputs_sha256=inputs_sha256(reader),
        ended=None if end is None else end.text,
        witness=of_source(run.results.witness, own or witness),
        surroundings=surroundings,
        clock=clock,
    )
    return replace(run, results=results, lost_spots=deflections.lost_spots)


def with_dropped_frames(
    run: AnalysedRun, dropped_frames: int, reader: RecordReader, config: Configuration
) -> AnalysedRun:
    """The run with the number of frames missing between its first and its last, and with its conditions."""
    results = replace(run.results, dropped_frames=dropped_frames)
    exact = results.fits.get(FitMethod.EXACT)
    conditions = run_conditions(
        reader,
        results.frames,
        run.lost_spots,
        dropped_frames,
        config.preflight,
        None if exact is None else exact.ground,
        results.half_cycles,
        results.beam,
        results.clock,
    )
    return replace(run, results=replace(results, conditions=conditions))


def analyse_swings(
    path: Path,
    swings: Sequence[Swing],
    config: Configuration,
    deflections: PassingDeflections,
    air: Surroundings,
    u_clock: float = 0.0,
    witness: WitnessAt | None = None,
    *,
    u_common_rad: float = 0.0,
) -> AnalysedRun:
    """Reduce the half-cycles of one run, or of one decay of a table, as its kind of pendulum asks.

    `path` is the file that they come from, `deflections` and `air` what it holds beside them, `u_clock` what
    the second of its times is uncertain by, relative; `witness` tells of the ground. `u_common_rad` is the
    standard uncertainty of an error that all amplitudes share.
    """
    unit = deflections.unit
    if config.instrument.description().report != "contact" and unit is DeflectionUnit.RAD:
        return _reduced(path, swings, config, joined(deflections, unit), air)
    pendulum, clock_rate = pendulum_on_ball(config), clock_rate_of(config)
    drag, of_air = OPEN_DRAG, None
    detected = points_in_true_time(swings, clock_rate)
    if pendulum is not None and len(detected) > 1:
        drag, of_air = known_drag(config, air, pendulum, mean_period(detected))
    settled = settled_swings(swings, deflections, unit, pendulum, config.fit, clock_rate, drag)
    points = points_in_true_time(settled.swings, clock_rate)
    if unit is DeflectionUnit.RAD:
        evidence = evidence_of(drag, settled.harmonics)
        believed = believed_drifts(config, air) if config.fit.drifts else None
        decay = fit_decay(
            points,
            pendulum,
            config.fit,
            settled.exact,
            drag=drag.fitted,
            evidence=evidence,
            drifts=believed,
            witness=_witness_beside(settled.swings, witness),
        )
        points = points if decay.points is None else decay.points
    else:
        decay = DecayFits(
            {}, None, "the record has no calibration (no [lever]): amplitudes are in px, the laws need rad"
        )
    ratio = deflections.fast_ratio()
    across = why_no_half_cycles(path.name, ratio, len(points), config.axes)
    errors = None if settled.position_map is None else PositionErrors.of(settled.position_map, unit)
    u_second = u_clock if config.timebase is None else max(config.timebase.u_camera_rate, u_clock)
    results = replace(
        _head(path, points, unit),
        measured_again_on=settled.motion,
        position_errors=errors,
        fits={name: fit_results(fit, config.pendulum) for name, fit in decay.fits.items()},
        surface_energy_j_per_m2=decay.surface_energy,
        problem=across or decay.problem,
        warnings=tuple(dict.fromkeys([*_fit_warnings(decay.fits), *filter(None, [settled.doubt])])),
        settings=config.fit.model_dump(),
        turning_points=StoredTurningPoints.of(points, settled.swings, unit, clock_rate),
        witness=decay.witness,
        **values_of_points(points, unit.shown_size, u_second),
    )
    rest_rad = float(np.median([swing.centre for swing in settled.swings if not swing.flags] or [0.0]))
    rig = rig_quantities(config, ratio, rest_rad, u_clock)
    believed = believed_drifts(config, air)
    if rig is not None:
        rig = replace(rig, common_amplitude_rad=InputQuantity(0.0, u_common_rad))
    if rig is not None and not config.fit.drifts:
        rig = replace(rig, ageing=believed.ageing, period_drift=believed.period)
    if decay.fits and pendulum is not None:
        seed = int(results.sha256[:12], 16)
        exact = decay.fits[FitMethod.EXACT]
        results = evaluate(results, points, pendulum, exact, rig, seed)
        if results.drag is not None:
            results = replace(results, drag=replace(results.drag, of_air=of_air))
    if errors is not None:
        results = replace(results, notes=(*results.notes, errors.text))
    if settled.harmonics is not None and config.lever is not None and len(points) > 1:
        of_rows = delay_of_rows(settled.harmonics, mean_period(points))
        if of_rows.seen:
            rad_per_px = config.lever.pixel_pitch_m / (2.0 * config.lever.arm_m)
            results = replace(results, warnings=(*results.warnings, of_rows.text(rad_per_px)))
    return AnalysedRun(path, results, points, decay.fits, rig, harmonics=settled.harmonics)


def _witness_beside(swings: Sequence[Swing], witness: WitnessAt | None) -> WitnessedWith | None:
    """A witness on the clock of the turning points of these swings."""
    first_ns = next((swing.turn_time_ns for swing in swings if not swing.flags), None)
    return None if witness is None or first_ns is None else WitnessedWith(*witness(first_ns))


def _reduced(
    path: Path, swings: Sequence[Swing], config: Configuration, deflections: Deflections, air: Surroundings
) -> AnalysedRun:
    """A run of a pendulum that is not described by the contact's laws."""
    u_scale = config.lever.u_scale_relative if config.lever is not None else 0.0
    reduction = reduce_run(config.instrument, swings, deflections, air, u_scale)
    points = reduction.points
    results = replace(
        _head(path, points, deflections.unit),
        problem=reduction.problem,
        settings=config.instrument.model_dump(mode="json"),
        instrument=reduction.values,
        turning_points=StoredTurningPoints.of(points, reduction.swings, deflections.unit, 1.0),
    )
    return AnalysedRun(path, results, points, {}, reduction=reduction)


def _head(path: Path, points: TurningPoints, unit: DeflectionUnit) -> RunResults:
    """Which file the results are of, how many half-cycles were used, and over which amplitudes."""
    found = points.amplitude / unit.shown_size
    initial, final = (float(found[0]), float(found[-1])) if len(found) else (math.nan, math.nan)
    in_arcsec = unit is DeflectionUnit.RAD
    return RunResults(
        record=path.name,
        sha256=_sha256_if_readable(path),
        record_bytes=path.stat().st_size,
        half_cycles=len(points),
        amplitude_unit=unit.shown,
        initial_amplitude=initial,
        final_amplitude=final,
        initial_amplitude_arcsec=initial if in_arcsec else math.nan,
        final_amplitude_arcsec=final if in_arcsec else math.nan,
    )


def _sha256_if_readable(path: Path) -> str:
    """By which results know their record; empty where its disk cannot give all of it."""
    try:
        # a film may be a folder of images
        return known_sha256_of_any(path) if path.is_dir() else measured_sha256_of(path, known=True)
    except RecordError:
        return ""


def clock_rate_of(config: Configuration) -> float:
    """True seconds in one of the camera's clock, as its calibration has it."""
    return config.timebase.camera_rate if config.timebase is not None else 1.0


def _fit_warnings(fits: Mapping[str, FitResult]) -> list[str]:
    """What every fit says once; what only one of them says with its name."""
    found: dict[str, list[str]] = {}
    for name, fit in fits.items():
        for warning in fit.warnings:
            found.setdefault(warning, []).append(name)
    return [
        warning if len(names) == len(fits) else f"{names[0]} fit: {warning}"
        for warning, names in found.items()
    ]


def session_results(runs: Sequence[AnalysedRun], folder: Path, public_key: str = "") -> SessionResults:
    """What is written of one or more runs; records are named relative to the folder of the file.

    They are sealed where a record or the folder is blind, or for the `public_key` of a blind archive.

    Raises ConfigurationError for a key that was changed and that nothing has used.
    """
    results = SessionResults(
        runs=tuple(replace(run.results, record=relative_record(run.record, folder)) for run in runs),
        series=_series(runs),
    )
    refuse_unread(runs)
    public_key = public_key_over(*(run.record for run in runs), folder) or public_key
    return sealed_results(results, public_key) if public_key else results


def refuse_unread(runs: Sequence[AnalysedRun]) -> None:
    """Raise ConfigurationError for a changed key that the fits of none of the runs have used."""
    changed = [run.watched for run in runs if run.watched is not None]
    # where nothing could be fitted, that is what is to be said
    if changed and not any(run.results.problem for run in runs):
        changed[0].refuse_unread(changed)


def _series(runs: Sequence[AnalysedRun]) -> Series | None:
    """Parameters of a series; None for fewer than two fitted runs.

    Of other instruments, what their runs say together: places on the sample, the reference.
    """
    reductions = [run.reduction for run in runs if run.reduction is not None]
    if reductions:
        found = reduce_series(reductions)
        return None if found is None else Series(runs=len(reductions), instrument=found)
    fitted = [run for run in runs if run.fits]
    pendulum = fitted[0].results.pendulum if fitted else None
    if len(fitted) < 2 or pendulum is None:
        return None
    return combined_series(
        {name: [run.fits[name] for run in fitted] for name in fitted[0].fits},
        [run.points for run in fitted],
        pendulum,
        fitted[0].rig,
        printed_curvature=bool(fitted[0].results.settings.get("printed_055")),
    )
