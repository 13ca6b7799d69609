"""From a closed record to its results: those of its half-cycles, and the conditions of its run."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.record.digest import RecordedCamera
from acquisition.record.events import Event, EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import DEFLECTION_FIELDS, ENVIRONMENT, RecordedClockStep
from calibration import relate_clocks
from processing.balance import Balance, balance_of_run
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError, RecordError
from processing.fit import FitMethod, Ground
from processing.spot import BeamUse
from processing.swing import HalfCycle, half_cycles_of_blocks
from processing.units import seconds
from rig.analysis.ambient import ambient_warnings, recorded_ambient, recorded_seismometer
from rig.analysis.decay_values import decay_rows, decay_values
from rig.analysis.half_cycle_fits import analyse_swings, u_second
from rig.analysis.passing_deflections import (
    ChangedDeflections,
    PassingDeflections,
    without_beam_motion,
    without_fixed_light,
)
from rig.analysis.results import RunResults
from rig.analysis.run_values import Beam, RunClock
from rig.analysis.series import AnalysedRun
from rig.analysis.turning_plane import balances_for_plane, follow_plane
from rig.instrument import (
    U_QUARTZ,
    inputs_sha256,
    judge_calibration,
    recorded_configuration,
    run_balance_verdicts,
    u_of_host_rate,
)
from rig.intake import SeismometerRecord
from rig.settings import FITTED, Configuration, PreflightSettings, refuse_without_effect
from rig.terminal import Verdict, percent

_KEPT_PIECES = 128
"""Chunks of numbers, of a quarter of a megabyte each, that stay in memory: spots are read three times."""


def analyse_record(
    path: Path,
    overrides: Sequence[str] = (),
    *,
    air_known: bool = True,
    seismometer: SeismometerRecord | None = None,
) -> AnalysedRun:
    """Results of one closed record; `overrides` change its configuration (fit settings, pendulum) for them.

    Without `air_known` the drag has no prior, whatever the record's own configuration states. `seismometer`
    is an auxiliary seismometer's record; None: that in the run's own record is used, if there is one.
    """
    with RecordReader(path, _KEPT_PIECES) as reader:
        config = recorded_configuration(reader, overrides)
        if not air_known:
            config = config.model_copy(update={"fit": config.fit.with_free_drag})
        refuse_without_effect(overrides, FITTED, "rig replay takes the recorded motion again")
        blocks, balances = _RecordedDeflections(reader), list[Balance]()
        # balances that cannot be read, as those of another version, are made again
        with suppress(RecordError):
            balances = reader.balances()
        return analyse_run(
            reader,
            config,
            reader.half_cycles(),
            blocks,
            reader.deflection_unit,
            blocks.beam,
            lambda frames: blocks.next_sequence - frames,
            balances=balances,
            seismometer=seismometer,
        )


class _RecordedDeflections:
    """The deflections of a record, read anew at every iteration."""

    def __init__(self, reader: RecordReader) -> None:
        self.next_sequence = 0
        """The number after that of the last frame that was read."""
        self.beam = BeamUse()
        """Counts of flags and models of the spots, each spot counted once."""
        self._reader = reader

    def __iter__(self) -> Iterator[Deflections]:
        fields = ("sequence", "flags", *DEFLECTION_FIELDS[self._reader.deflection_unit])
        for spots in self._reader.spot_blocks(fields=fields):
            if int(spots["sequence"][0]) >= self.next_sequence:
                self.beam.take(spots["sequence"], spots["flags"])
                self.next_sequence = int(spots["sequence"][-1]) + 1
            yield self._reader.deflections(spots)


def analyse_run(
    reader: RecordReader,
    config: Configuration,
    half_cycles: Sequence[HalfCycle],
    blocks: Iterable[Deflections],
    unit: DeflectionUnit,
    beam: BeamUse,
    dropped: Callable[[int], int],
    *,
    balances: Sequence[Balance] = (),
    seismometer: SeismometerRecord | None = None,
) -> AnalysedRun:
    """Results of half-cycles and deflections of a record, as recorded or by a replay.

    `blocks` are the deflections of consecutive frames, in `unit`. Once they have passed, `beam` has the
    counts of their spots, and `dropped` gives the number of missing frames from that of the frames present.
    The motion of the beam by a reference spot, and fixed light, are taken off. `balances` are those that were
    made of the same deflections; after such a correction, or where they lack, they are made again.
    """
    beam_motion, fixed_light = without_beam_motion(reader, config), without_fixed_light(reader, config)
    for correction in (beam_motion, fixed_light):
        if correction is not None and correction.used:
            blocks = ChangedDeflections(blocks, correction.correct)
            half_cycles, balances = half_cycles_of_blocks(blocks), ()
    deflections, ambient = PassingDeflections(blocks, unit), recorded_ambient(reader, config)
    clock = run_clock(reader, config)
    u_clock = 0.0 if clock is None else clock.u_rate

    kind = config.instrument.description()
    followed = follow_plane(
        half_cycles,
        deflections,
        config.axes,
        along_line=kind.turning_plane,
        balances=balances_for_plane(balances, half_cycles, config.axes),
    )
    if seismometer is None:
        seismometer = recorded_seismometer(reader, config)
    else:
        utc_ns = reader.epoch_offset_ns
        deflections.pass_first()
        seismometer = replace(seismometer, to_file_ns=-deflections.first_ns, to_utc_ns=utc_ns)
    run = analyse_swings(reader.path, followed, config, ambient, u_clock, seismometer)
    began, ended = reader.utc(deflections.first_ns), reader.utc(deflections.last_ns)
    calibration, doubts = judge_calibration(config, reader.attachments, began, ended)
    warnings = [*run.warnings, *doubts, *reader.doubts(), *ambient_warnings(ambient)]
    end = end_of(reader.events())
    beam_results = Beam.of(beam, noise_is_known=config.sensor is not None)
    light = None if fixed_light is None else fixed_light.verdict
    if light is not None and beam_results.poor_fit_frames:
        beam_results = replace(beam_results, likely_cause=light.reason, remedy=light.remedy)
    verdicts = [] if light is None else [light]
    if kind.report == "contact":
        verdicts += run_balance_verdicts(balance_of_run(followed.balances, followed.plane), config.balance)
    points, values = run.points, None
    with suppress(DataError):
        if run.reduction is None:
            values = decay_values(points, unit.shown_size, u_clock=u_second(config, u_clock))
    run = replace(
        run,
        table=(*run.table, *decay_rows(points, values, unit.shown, unit.shown_size, reader.path.stem)),
        damping=None if values is None else values.damping,
        frames=deflections.frames,
        dropped_frames=dropped(deflections.frames),
        simulated=RecordedCamera.from_metadata(reader.metadata).simulated,
        losses=reader.losses(),
        beam=beam_results,
        warnings=tuple(warnings),
        notes=(*run.notes, *([] if beam_motion is None else [beam_motion.note])),
        calibration=calibration,
        ended=None if end is None else end.text,
        inputs_sha256={**inputs_sha256(reader), **run.inputs_sha256},
        ambient=ambient,
        clock=clock,
    )
    conditions = run_conditions(reader, run, deflections.lost_spots, config.preflight, verdicts)
    return replace(run, conditions=conditions)


_MAX_CLOCK_FRAMES = 20_000
"""Number of frames for the rate of the clock: of twice as many only every second is used, and so on."""
_U_UNKNOWN = 100e-6 / math.sqrt(3.0)
"""Relative standard uncertainty of an unknown rate: a quartz within its usual tolerance, 100 ppm."""
_MAX_U_STEP_S = 1e-3
"""Largest uncertainty of a step that is no fault: turning points are timed to some 0.1 ms."""
_FIELDS = ("sequence", "device_time_ns", "host_time_ns")


def run_clock(reader: RecordReader, config: Configuration) -> RunClock | None:
    """The clock of a record; None for frames made on demand, which have times of their own."""
    if config.on_demand:
        return None
    u_host, synchronised = u_of_host_rate(reader)
    blocks = [block[list(_FIELDS)] for block in reader.spot_blocks(fields=_FIELDS)]
    if RecordedCamera.from_metadata(reader.metadata).has_clock is False or not blocks:
        return RunClock(drift_ppm=math.nan, u_drift_ppm=math.nan, u_rate=u_host, synchronised=synchronised)
    table = np.concatenate(blocks)
    sequence, device_ns, host_ns = (table[name].astype(np.int64) for name in _FIELDS)
    steps = reader.values(RecordedClockStep)
    u_steps_s = seconds(math.sqrt(sum(float(step.u_step_ns) ** 2 for step in steps)))
    stride = max(1, len(sequence) // _MAX_CLOCK_FRAMES)
    rate, u_rate, drift_ppm, u_drift_ppm = 1.0, math.nan, math.nan, math.nan
    with suppress(DataError):
        relation = relate_clocks(device_ns[::stride], host_ns[::stride], sequence[::stride])
        rate, u_rate = relation.rate, relation.u_rate
        drift_ppm, u_drift_ppm = relation.drift_ppm, relation.u_drift_ppm
    duration_s = max(seconds(int(device_ns[-1] - device_ns[0])), 1e-9)
    return RunClock(
        drift_ppm=drift_ppm,
        u_drift_ppm=u_drift_ppm,
        u_rate=math.hypot(_u_of_rate(config, rate, u_rate, u_host), u_steps_s / duration_s),
        steps=len(steps),
        largest_step_s=seconds(max((step.step_ns for step in steps), key=abs, default=0)),
        u_steps_s=u_steps_s,
        synchronised=synchronised,
    )


def _u_of_rate(config: Configuration, rate: float, u_rate: float, u_host: float) -> float:
    """Relative standard uncertainty of the rate with which the run's times were computed."""
    # that of the calibration, or, where that is contradicted or lacks, the deviation from the run's own rate
    u_measured = math.hypot(u_rate, u_host, U_QUARTZ)
    if config.timebase is None:
        return _U_UNKNOWN if math.isnan(u_rate) else math.hypot(rate - 1.0, u_measured)
    deviation, u_calibrated = rate - config.timebase.camera_rate, config.timebase.u_camera_rate
    is_contradicted = math.isfinite(u_rate) and abs(deviation) > 3.0 * math.hypot(u_calibrated, u_measured)
    return math.hypot(deviation, u_measured) if is_contradicted else u_calibrated


_MAX_TEMPERATURE_CHANGE_K = 1.0
"""Largest change of the air's temperature in a run: the paper's arm, 1 m of steel, grows by 12 um, 2 arcsec,
with each kelvin."""
_MAX_LEFT_OUT_FRACTION = 0.2
"""Largest fraction of half-cycles that the ground moves too much to be fitted."""
_FORBIDDEN_EVENTS = {
    EventKind.LASER_DARK: (
        "light",
        "nothing confirmed that the laser was lit",
        "see the events; interlock, controller, cable",
    ),
    EventKind.REST_STEP: ("rest position", "it stepped", "find what touched the rig; measure again"),
    EventKind.PUSH: ("draught", "the swing was pushed", "shield the rig from air; keep away from it"),
    EventKind.LIGHT_STEP: ("ambient light", "it stepped", "keep the room dark; shield the sensor"),
}


def run_conditions(
    reader: RecordReader,
    run: RunResults,
    lost_spots: int,
    limits: PreflightSettings,
    others: Sequence[Verdict] = (),
) -> tuple[Verdict, ...]:
    """One verdict for each condition of a run with its fits, before `others`.

    A dropped frame costs as much as a lost spot: the limit of both is that of the preflight for lost spots.
    """
    frames, dropped, max_lost = run.frames, run.dropped_frames, limits.max_lost_fraction
    exact, events = run.fits.get(FitMethod.EXACT), reader.events()
    remedy = "find out where they were lost: camera, bus or computer"
    return (
        _end(end_of(events)),
        _fraction("lost spots", lost_spots, frames, max_lost, "see laser, beam and exposure"),
        _fraction("dropped frames", dropped, frames + dropped, max_lost, remedy),
        *([] if run.beam is None else [_beam(run.beam, limits.max_poor_fit_fraction)]),
        *([] if run.beam is None else [_saturation(run.beam, frames, limits.max_saturated_fraction)]),
        *_forbidden_events(events),
        *([] if run.clock is None else [_clock(run.clock)]),
        *_watcher_failures(events),
        *_temperature(reader),
        *_ground(None if exact is None else exact.ground, run.half_cycles),
        *others,
    )


def _condition(
    name: str, ok: bool, reason: str, remedy: str, measured: str, limit: str, *, warns: bool = False
) -> Verdict:
    """A condition, with reason and remedy where it is not met: then a warning if `warns`, else a fault."""
    texts = ("", "") if ok else (reason, remedy)
    return Verdict(name, ok or warns, *texts, measured=measured, limit=limit)


def _end(end: Event | None) -> Verdict:
    """Whether the run reached its end; a run that a person ended early is no fault."""
    measured = "none" if end is None else end.text
    if end is None or end.kind == EventKind.FAILED:
        reason = "the record has no end event" if end is None else "an error ended it"
        remedy = "remove the cause, then measure again: rig run --resume"
        return Verdict("end", False, reason, remedy, measured, "its own")
    early = "ended early" if end.kind == EventKind.ENDED_EARLY else ""
    return Verdict("end", True, early, measured=measured, limit="its own")


def _fraction(
    name: str,
    count: int,
    total: int,
    max_fraction: float,
    remedy: str,
    reason: str = "too many",
    *,
    warns: bool = False,
) -> Verdict:
    fraction, limit = count / total if total else 0.0, f"{100 * max_fraction:g} %"
    measured = f"{count} of {total} ({percent(fraction)})"
    return _condition(name, fraction <= max_fraction, reason, remedy, measured, limit, warns=warns)


def _beam(beam: Beam, max_fraction: float) -> Verdict:
    """A warning where more than a fraction of the judged spots have the flag POOR_FIT."""
    reason = f"the model does not fit it, and uncertainties are only widened for that: {beam.likely_cause}"
    fraction = percent(beam.poor_fit_frames / max(beam.judged_frames, 1))
    counts = f"POOR_FIT in {beam.poor_fit_frames} of {beam.judged_frames}"
    measured = f"{beam.model or 'no spot'}, {counts} ({fraction})"
    ok, limit = not beam.poor_fit_fraction > max_fraction, f"{100 * max_fraction:g} %"
    return _condition("beam", ok, reason, beam.remedy, measured, limit, warns=True)


def _saturation(beam: Beam, frames: int, max_fraction: float) -> Verdict:
    """A warning: the flanks of saturated spots alone are fitted, which is right only for Gaussian beams."""
    reason = "pixels at full scale are lost to the fit"
    remedy = "lower the exposure (exposure_us) or the laser's power"
    count = beam.flags.get("SATURATED", 0)
    return _fraction("saturation", count, frames, max_fraction, remedy, reason, warns=True)


def _forbidden_events(events: Sequence[Event]) -> list[Verdict]:
    # a laser of unknown state counts as dark
    kinds = [EventKind.LASER_DARK if e.kind == EventKind.LASER_UNKNOWN else e.kind for e in events]
    texts = dict(zip(reversed(kinds), (event.text for event in reversed(events)), strict=True))
    verdicts = []
    for kind, (name, reason, remedy) in _FORBIDDEN_EVENTS.items():
        count = kinds.count(kind)
        measured = {0: "never", 1: "once"}.get(count, f"{count} times")
        reason = f"{reason}: {texts.get(kind, '')}"
        verdicts.append(_condition(name, not count, reason, remedy, measured, "never"))
    return verdicts


def _clock(clock: RunClock) -> Verdict:
    """Verdict on the steps that were taken off: a warning if known to `_MAX_U_STEP_S`, else a fault."""
    reason = f"it was taken off its times, known to {clock.u_steps_s:.1g} s"
    remedy = "network clock, supply, cable of the camera; rig calibrate clock"
    texts = (reason, remedy) if clock.steps else ("", "")
    ok, limit = clock.u_steps_s <= _MAX_U_STEP_S, f"steps known to {_MAX_U_STEP_S:g} s"
    return Verdict("camera's clock", ok, *texts, clock.text, limit)


def _watcher_failures(events: Sequence[Event]) -> list[Verdict]:
    """A warning where a part that only watches the run failed, which does not harm the record."""
    texts = [event.text for event in events if event.kind == EventKind.WATCHER_FAILED]
    remedy = "the record is whole; report this with the program's log"
    return [
        Verdict("watching", True, "what only watches failed", remedy, text, "never") for text in texts[-1:]
    ]


def _temperature(reader: RecordReader) -> list[Verdict]:
    table = reader.table(ENVIRONMENT.topic)
    readings_c = table["temperature_c"][np.isfinite(table["temperature_c"])] if len(table) else np.empty(0)
    if not len(readings_c):
        return []
    measured = f"{np.min(readings_c):.2f} to {np.max(readings_c):.2f} °C"
    limit = f"within {_MAX_TEMPERATURE_CHANGE_K:g} K"
    reason, remedy = "it changed during the run", "wait until the room is steady; shield the rig"
    ok = float(np.ptp(readings_c)) <= _MAX_TEMPERATURE_CHANGE_K
    return [_condition("temperature", ok, reason, remedy, measured, limit)]


def _ground(ground: Ground | None, half_cycles: int) -> list[Verdict]:
    """Whether the ground, by the exact fit, left most of the half-cycles to be fitted."""
    if ground is None or not half_cycles:
        return []
    fraction = ground.left_out_half_cycles / (half_cycles + ground.left_out_half_cycles)
    u_inflation = max((value for value in ground.widening.values() if np.isfinite(value)), default=1.0)
    reason = "it drove the pendulum more than friction braked it"
    remedy = "measure at a quieter time or place; end at a larger amplitude"
    measured = f"{percent(fraction)} of the half-cycles left out, uncertainties × {u_inflation:.2g}"
    limit = f"{100 * _MAX_LEFT_OUT_FRACTION:g} % left out"
    return [_condition("ground", fraction <= _MAX_LEFT_OUT_FRACTION, reason, remedy, measured, limit)]
