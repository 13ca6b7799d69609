"""From a closed record to its results: those of its half-cycles, and the conditions of its run."""

import math
from collections import Counter
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
from processing.balance import balance_of_run
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
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
from rig.analysis.turning_plane import follow_plane
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


def analyse_record(
    path: Path,
    overrides: Sequence[str] = (),
    *,
    air_known: bool = True,
    seismometer: SeismometerRecord | None = None,
) -> AnalysedRun:
    """Results of one closed record; `overrides` change its configuration (fit settings, pendulum) for them.

    Without `air_known` the drag has no prior, whatever the record's own configuration states. `seismometer`
    is the record of one; without it the one in the run's own record is used, if there is one.
    """
    with RecordReader(path) as reader:
        config = recorded_configuration(reader, overrides)
        if not air_known:
            config = config.model_copy(update={"fit": config.fit.with_free_drag})
        refuse_without_effect(overrides, FITTED, "rig replay takes the recorded motion again")
        blocks = _RecordedDeflections(reader)
        return analyse_run(
            reader,
            config,
            reader.swings(),
            blocks,
            reader.deflection_unit,
            blocks.beam,
            lambda frames: blocks.following - frames,
            seismometer=seismometer,
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
    seismometer: SeismometerRecord | None = None,
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
            swings = half_cycles_of_blocks(blocks)
    deflections, ambient = PassingDeflections(blocks, unit), recorded_ambient(reader, config)
    clock = run_clock(reader, config)
    u_clock = 0.0 if clock is None else clock.u_rate

    kind = config.instrument.description()
    followed = follow_plane(swings, deflections, config.axes, along_line=kind.turning_plane)
    if seismometer is None:
        seismometer = recorded_seismometer(reader, config)
    else:
        utc_ns = reader.epoch_offset_ns
        seismometer = replace(seismometer, to_file_ns=-deflections.first_ns, to_utc_ns=utc_ns)
    run = analyse_swings(reader.path, followed, config, ambient, u_clock, seismometer)
    began, ended = reader.utc(deflections.first_ns), reader.utc(deflections.last_ns)
    calibration, doubts = judge_calibration(config, reader.attachments, began, ended)
    warnings = [*run.warnings, *doubts, *reader.doubts(), *ambient_warnings(ambient)]
    end = end_of(reader.events())
    judged = Beam.of(beam, noise_is_known=config.sensor is not None)
    light = None if pulled is None else pulled.verdict
    if light is not None and judged.poor_fit_frames:
        judged = replace(judged, likely_cause=light.reason, remedy=light.remedy)
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
        beam=judged,
        warnings=tuple(warnings),
        notes=(*run.notes, *([] if less is None else [less.note])),
        calibration=calibration,
        ended=None if end is None else end.text,
        inputs_sha256={**inputs_sha256(reader), **run.inputs_sha256},
        ambient=ambient,
        clock=clock,
    )
    conditions = run_conditions(reader, run, deflections.lost_spots, config.preflight, verdicts)
    return replace(run, conditions=conditions)


_MAX_CLOCK_FRAMES = 20_000
"""Number of frames from twice which on only every second, third, ... one is fitted for the rate of the clock:
more would not make it better known."""
_U_UNKNOWN = 100e-6 / math.sqrt(3.0)
"""Relative standard uncertainty of an unknown rate: a quartz within its usual tolerance, 100 ppm."""
_MAX_U_STEP_S = 1e-3
"""Largest uncertainty of a step that is no fault: turning points are timed to some 0.1 ms."""
_CLOCK_LIMIT_TEXT = f"steps known to {_MAX_U_STEP_S:g} s"
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
    every = max(1, len(sequence) // _MAX_CLOCK_FRAMES)
    try:
        relation = relate_clocks(device_ns[::every], host_ns[::every], sequence[::every])
        rate, u_rate, drift_ppm, u_drift_ppm = (
            relation.rate, relation.u_rate, relation.drift_ppm, relation.u_drift_ppm,
        )  # fmt: skip
    except DataError:
        rate, u_rate, drift_ppm, u_drift_ppm = 1.0, math.nan, math.nan, math.nan
    over_s = max(seconds(int(device_ns[-1] - device_ns[0])), 1e-9)
    return RunClock(
        drift_ppm=drift_ppm,
        u_drift_ppm=u_drift_ppm,
        u_rate=math.hypot(_u_of_rate(config, rate, u_rate, u_host), u_steps_s / over_s),
        steps=len(steps),
        largest_step_s=seconds(max((step.step_ns for step in steps), key=abs, default=0)),
        u_steps_s=u_steps_s,
        synchronised=synchronised,
    )


def _u_of_rate(config: Configuration, rate: float, u_rate: float, u_host: float) -> float:
    """Relative standard uncertainty of the rate with which the run's times were computed.

    It is that of the calibration; for a calibrated rate that the run contradicts, and for an assumed rate, it
    is the deviation from the run's own rate.
    """
    u_measured = math.hypot(u_rate, u_host, U_QUARTZ)
    if config.timebase is None:
        return _U_UNKNOWN if math.isnan(u_rate) else math.hypot(rate - 1.0, u_measured)
    deviation, u_known = rate - config.timebase.camera_rate, config.timebase.u_camera_rate
    contradicted = math.isfinite(u_rate) and abs(deviation) > 3.0 * math.hypot(u_known, u_measured)
    return math.hypot(deviation, u_measured) if contradicted else u_known


_MAX_TEMPERATURE_CHANGE_K = 1.0
"""Largest change of the air's temperature in a run: the paper's arm, 1 m of steel, grows by 12 um, 2 arcsec,
with each kelvin."""
_MAX_LEFT_OUT_SHARE = 0.2
"""Largest share of half-cycles that the ground moves too much to be fitted."""
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
    frames, dropped, most = run.frames, run.dropped_frames, limits.max_lost_fraction
    exact = run.fits.get(FitMethod.EXACT)
    remedy = "find out where they were lost: camera, bus or computer"
    of_beam = []
    if run.beam is not None:
        of_beam.append(_beam(run.beam, limits.max_poor_fit_fraction))
        # the flanks of saturated spots alone are fitted, which is right only for Gaussian beams
        saturated, most_saturated = run.beam.flags.get("SATURATED", 0), limits.max_saturated_fraction
        reason = "pixels at full scale are lost to the fit"
        lower = "lower the exposure (exposure_us) or the laser's power"
        of_beam.append(_fraction("saturation", saturated, frames, most_saturated, lower, reason, warns=True))
    return (
        _end(end_of(reader.events())),
        _fraction("lost spots", lost_spots, frames, most, "see laser, beam and exposure"),
        _fraction("dropped frames", dropped, frames + dropped, most, remedy),
        *of_beam,
        *_forbidden_events(reader.events()),
        *([] if run.clock is None else [_clock(run.clock)]),
        *_watcher_failures(reader.events()),
        *_temperature(reader),
        *_ground(None if exact is None else exact.ground, run.half_cycles),
        *others,
    )


def _condition(
    name: str, ok: bool, reason: str, remedy: str, measured: str, limit: str, *, warns: bool = False
) -> Verdict:
    """A condition, with reason and remedy where it is not met; not met it `warns`, or else is a fault."""
    why, do = ("", "") if ok else (reason, remedy)
    return Verdict(name, ok or warns, why, do, measured=measured, limit=limit)


def _end(end: Event | None) -> Verdict:
    """Whether the run reached its end; a run that a person ended early is no fault."""
    if end is None or end.kind == EventKind.FAILED:
        reason = "the record has no end event" if end is None else "an error ended it"
        remedy = "remove the cause, then measure again: rig run --resume"
        measured = "none" if end is None else end.text
        return Verdict("end", False, reason, remedy, measured=measured, limit="its own")
    early = "ended early" if end.kind == EventKind.ENDED_EARLY else ""
    return Verdict("end", True, early, measured=end.text, limit="its own")


def _fraction(
    name: str,
    count: int,
    total: int,
    most: float,
    remedy: str,
    reason: str = "too many",
    *,
    warns: bool = False,
) -> Verdict:
    part = count / total if total else 0.0
    measured = f"{count} of {total} ({percent(part)})"
    return _condition(name, part <= most, reason, remedy, measured, f"{100 * most:g} %", warns=warns)


def _beam(beam: Beam, most: float) -> Verdict:
    """A warning where more than the fraction `most` of the judged spots have the flag POOR_FIT."""
    why = f"the model does not fit it, and uncertainties are only widened for that: {beam.likely_cause}"
    part = percent(beam.poor_fit_frames / max(beam.judged_frames, 1))
    measured = f"{beam.model or 'no spot'}, POOR_FIT in {beam.poor_fit_frames} of {beam.judged_frames}"
    good = not beam.poor_fit_fraction > most
    limit = f"{100 * most:g} %"
    return _condition("beam", good, why, beam.remedy, f"{measured} ({part})", limit, warns=True)


def _forbidden_events(events: Sequence[Event]) -> list[Verdict]:
    unlit = EventKind.LASER_DARK
    events = [one._replace(kind=unlit) if one.kind == EventKind.LASER_UNKNOWN else one for one in events]
    happened = Counter(event.kind for event in events)
    texts = {event.kind: event.text for event in reversed(events)}
    times = {0: "never", 1: "once"}
    return [
        _condition(
            name, not happened[kind], f"{reason}: {texts.get(kind, '')}", remedy,
            times.get(happened[kind], f"{happened[kind]} times"), "never",
        )
        for kind, (name, reason, remedy) in _FORBIDDEN_EVENTS.items()
    ]  # fmt: skip


def _clock(clock: RunClock) -> Verdict:
    """Verdict on the steps that were taken off: a warning if known to `_MAX_U_STEP_S`, else a fault."""
    if not clock.steps:
        return Verdict("camera's clock", True, measured=clock.text, limit=_CLOCK_LIMIT_TEXT)
    known = f"it was taken off its times, known to {clock.u_steps_s:.1g} s"
    remedy = "network clock, supply, cable of the camera; rig calibrate clock"
    ok = clock.u_steps_s <= _MAX_U_STEP_S
    return Verdict("camera's clock", ok, known, remedy, measured=clock.text, limit=_CLOCK_LIMIT_TEXT)


def _watcher_failures(events: Sequence[Event]) -> list[Verdict]:
    """A warning where a part that only watches the run failed, which leaves the record whole."""
    texts = [event.text for event in events if event.kind == EventKind.WATCHER_FAILED]
    if not texts:
        return []
    remedy = "the record is whole; report this with the program's log"
    return [Verdict("watching", True, "what only watches failed", remedy, measured=texts[-1], limit="never")]


def _temperature(reader: RecordReader) -> list[Verdict]:
    table = reader.table(ENVIRONMENT.topic)
    read_c = table["temperature_c"][np.isfinite(table["temperature_c"])] if len(table) else np.empty(0)
    if not len(read_c):
        return []
    measured = f"{np.min(read_c):.2f} to {np.max(read_c):.2f} °C"
    reason, remedy = "it changed during the run", "wait until the room is steady; shield the rig"
    ok = float(np.ptp(read_c)) <= _MAX_TEMPERATURE_CHANGE_K
    return [
        _condition("temperature", ok, reason, remedy, measured, f"within {_MAX_TEMPERATURE_CHANGE_K:g} K")
    ]


def _ground(ground: Ground | None, half_cycles: int) -> list[Verdict]:
    """Whether the ground, by the exact fit, left most of the half-cycles to be fitted."""
    if ground is None or not half_cycles:
        return []
    part = ground.left_out_half_cycles / (half_cycles + ground.left_out_half_cycles)
    widest = max((value for value in ground.widening.values() if np.isfinite(value)), default=1.0)
    reason = "it drove the pendulum more than friction braked it"
    remedy = "measure at a quieter time or place; end at a larger amplitude"
    measured = f"{percent(part)} of the half-cycles left out, uncertainties × {widest:.2g}"
    limit = f"{100 * _MAX_LEFT_OUT_SHARE:g} % left out"
    return [_condition("ground", part <= _MAX_LEFT_OUT_SHARE, reason, remedy, measured, limit)]
