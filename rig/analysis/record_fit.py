"""From a closed record to its results: those of its half-cycles, and the conditions of its run."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.record.digest import RecordedCamera
from acquisition.record.events import end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import DEFLECTION_FIELDS
from processing.balance import balance_of_run
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import BeamUse
from processing.swing import HalfCycle, swings_of_blocks
from rig.analysis.air import ambient_warnings, recorded_surroundings
from rig.analysis.decay_values import decay_rows, values_of_points
from rig.analysis.half_cycle_fits import analyse_swings, u_second
from rig.analysis.passing_deflections import (
    ChangedDeflections,
    PassingDeflections,
    without_beam_motion,
    without_fixed_light,
)
from rig.analysis.run_conditions import run_clock, run_conditions
from rig.analysis.run_values import Beam
from rig.analysis.seismometer import recorded_witness
from rig.analysis.seismometer_file import SeismometerRecord, TimedSeismometer
from rig.analysis.series import AnalysedRun
from rig.analysis.turning_plane import follow_plane
from rig.instrument import (
    inputs_sha256,
    judge_calibration,
    optics_of,
    recorded_configuration,
    run_balance_verdicts,
)
from rig.settings import Configuration, KeyUseMonitor


def analyse_record(
    path: Path,
    overrides: Sequence[str] = (),
    *,
    air_known: bool = True,
    witness: SeismometerRecord | None = None,
) -> AnalysedRun:
    """Results of one closed record; `overrides` change its configuration (fit settings, pendulum) for them.

    Without `air_known` the drag has no prior, whatever the record's own configuration states. `witness` is an
    auxiliary seismometer; without it the one in the record is used, if there is one.
    """
    with RecordReader(path) as reader:
        config = recorded_configuration(reader, overrides)
        if not air_known:
            config = config.model_copy(update={"fit": config.fit.with_free_drag})
        watched = KeyUseMonitor(config, overrides, "rig replay takes the recorded motion again")
        # keys that this reads cannot be changed: the recorded deflections were made with them
        optics_of(watched.config, full_scale_dn=1.0).deflector((1, 1))(np.zeros(0, np.int64), [])
        watched.refuse_read()
        blocks = _RecordedDeflections(reader)
        return analyse_run(
            reader,
            watched.config,
            reader.swings(),
            blocks,
            reader.deflection_unit,
            blocks.beam,
            lambda frames: blocks.following - frames,
            witness=witness,
            watched=watched,
        )


class _RecordedDeflections:
    """The deflections of a record, read anew at every iteration.

    `following` is the number after the last frame's, `beam` counts flags and models of the spots, each once.
    """

    def __init__(self, reader: RecordReader) -> None:
        self.following = 0
        self.beam = BeamUse()
        self._reader = reader

    def __iter__(self) -> Iterator[Deflections]:
        fields = ("sequence", "flags", *DEFLECTION_FIELDS[self._reader.deflection_unit])
        for spots in self._reader.spot_blocks(fields=fields):
            if int(spots["sequence"][0]) >= self.following:
                self.beam.take(spots["sequence"], spots["flags"])
                self.following = int(spots["sequence"][-1]) + 1
            yield self._reader.deflections(spots)


def analyse_run(
    reader: RecordReader,
    config: Configuration,
    swings: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    beam: BeamUse,
    dropped: Callable[[int], int],
    *,
    witness: SeismometerRecord | None = None,
    watched: KeyUseMonitor | None = None,
) -> AnalysedRun:
    """Results of half-cycles and deflections of a record, as recorded or by a replay.

    `blocks` are the deflections of consecutive frames, in `unit`. Once they have passed, `beam` has the
    counts of their spots, and `dropped` gives the number of missing frames from that of the frames present.
    The motion of the beam by a reference spot, and fixed light, are taken off.
    """
    less, pulled = without_beam_motion(reader, config), without_fixed_light(reader, config)
    for one in (less, pulled):
        if one is not None and one.used:
            blocks = ChangedDeflections(blocks, one.change)
            swings = swings_of_blocks(blocks)
    deflections, surroundings = PassingDeflections(blocks, unit), recorded_surroundings(reader, config)
    clock = run_clock(reader, config)
    u_clock = 0.0 if clock is None else clock.u_rate

    kind = config.instrument.description()
    followed = follow_plane(swings, deflections, config.axes, along_line=kind.turning_plane)
    own = recorded_witness(reader, config) if witness is None else None
    beside = None if own is None else TimedSeismometer(own)
    if witness is not None:
        beside = TimedSeismometer(witness, -deflections.first_ns, reader.epoch_offset_ns)
    run = analyse_swings(reader.path, followed, config, surroundings, u_clock, beside)
    began, ended = reader.utc(deflections.first_ns), reader.utc(deflections.last_ns)
    calibration, doubts = judge_calibration(config, reader.attachments, began, ended)
    warnings = [*run.warnings, *doubts, *reader.doubts(), *ambient_warnings(surroundings)]
    end = end_of(reader.events())
    judged = Beam.of(beam, noise_is_known=config.sensor is not None)
    if pulled is not None and judged.poor_fit_frames:
        judged = replace(judged, likely_cause=pulled.verdict.reason, remedy=pulled.verdict.remedy)
    verdicts = [] if pulled is None else [pulled.verdict]
    if kind.report == "contact":
        verdicts += run_balance_verdicts(balance_of_run(followed.balances, followed.plane), config.balance)
    points, values = run.points, None
    if run.reduction is None:
        values = values_of_points(points, unit.shown_size, u_second(config, u_clock))
    run = replace(
        run,
        table=(*run.table, *decay_rows(points, values, unit.shown, unit.shown_size, reader.path.stem)),
        damping=None if values is None else values.damping,
        frames=deflections.frames,
        dropped_frames=dropped(deflections.frames),
        simulated=RecordedCamera.from_metadata(reader.metadata).simulated,
        losses=reader.losses(),
        beam=judged,
        warnings=tuple(warnings),
        notes=(*run.notes, *([] if less is None else [less.text])),
        calibration=calibration,
        ended=None if end is None else end.text,
        inputs_sha256={**inputs_sha256(reader), **run.inputs_sha256},
        surroundings=surroundings,
        clock=clock,
        watched=watched,
    )
    conditions = run_conditions(reader, run, deflections.lost_spots, config.preflight, verdicts)
    return replace(run, conditions=conditions)
