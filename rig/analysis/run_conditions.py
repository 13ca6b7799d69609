"""Conditions of a run by its record, each with a verdict: beam, clock, light, losses, steps."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan
from typing import Annotated, Self

import numpy as np

from acquisition.record.digest import RecordedCamera
from acquisition.record.events import Event, EventKind, end_of
from acquisition.record.reader import RecordReader
from acquisition.record.topics import CLOCK, ENVIRONMENT, RecordedClockStep
from calibration import relate_clocks
from processing.errors import DataError
from processing.fit import Ground
from processing.quantity import Quantity
from processing.spot import LONGEST_CHOICE_FRAMES, BeamUse, SpotFlag, SpotModel
from processing.units import seconds
from rig.instrument import U_FREE_RUNNING, U_QUARTZ, U_SYNCHRONISED, rate_text
from rig.presentation import Verdict, percent
from rig.settings import Configuration, PreflightSettings

_MODEL_FLAGS = SpotFlag.MULTIPLE | SpotFlag.LEARNED
"""Flags that name the model of a spot and are no fault."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """The beam of a run, by the models and flags of its spots.

    `model` is the model in use at the end, `since_frame` the number of the first frame fitted with it,
    `changes` how often the model changed after the first choice. `flags` are the numbers of spots with each
    flag, without zeros. The profile is learned from the first `choosing_frames` spots. POOR_FIT is judged on
    the `judged_frames` spots after them: `poor_fit_frames` have it, most likely for the reason
    `likely_cause`.
    """

    model: str = ""
    since_frame: int = -1
    changes: int = 0
    flags: Mapping[str, int] = field(default_factory=dict)
    choosing_frames: int = 0
    judged_frames: int = 0
    poor_fit_frames: int = 0
    poor_fit_fraction: float = nan
    likely_cause: str = ""
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
        """`Beam: learned profile since frame 147; spots with POOR_FIT 147 (while it was learned).`"""
        if not self.model:
            return "Beam: no spot was found."
        only_at_first = self.choosing_frames > 0 and not self.poor_fit_frames
        flagged = [
            f"{name} {count}" + (" (while it was learned)" if name == "POOR_FIT" and only_at_first else "")
            for name, count in self.flags.items()
            if not SpotFlag[name] & _MODEL_FLAGS
        ]
        changed = f", after {self.changes} changes" if self.changes else ""
        flags = f"spots with {', '.join(flagged)}" if flagged else "no spot is flagged as faulty"
        return f"Beam: {self.model} since frame {self.since_frame}{changed}; {flags}."

    def verdict(self, most: float) -> Verdict:
        """A warning where more than the fraction `most` of the judged spots have the flag POOR_FIT."""
        why = f"the model does not fit it, and uncertainties are only widened for that: {self.likely_cause}"
        part = percent(self.poor_fit_frames / max(self.judged_frames, 1))
        measured = f"{self.model or 'no spot'}, POOR_FIT in {self.poor_fit_frames} of {self.judged_frames}"
        good = not self.poor_fit_fraction > most
        found = _condition("beam", good, why, self.remedy, f"{measured} ({part})", f"{100 * most:g} %")
        return replace(found, ok=True)


def _condition(name: str, ok: bool, reason: str, remedy: str, measured: str, limit: str) -> Verdict:
    """A condition, with reason and remedy where it is not met."""
    return Verdict(name, ok, "" if ok else reason, "" if ok else remedy, measured=measured, limit=limit)


def _cause(use: BeamUse, *, noise_is_known: bool) -> tuple[str, str]:
    """The most likely reason of POOR_FIT, and its remedy."""
    half = 0.5 * use.poor_frames
    if use.poor_with[SpotFlag.EDGE] > half:
        return "the edge of the sensor cuts the spot", "move the spot to the middle: rig camera align"
    if use.poor_with[SpotFlag.CUT] > half:
        return "something cuts the spot", "centre the beam in lens, mirrors and window; free its path"
    if use.poor_with[SpotFlag.SATURATED] > half:
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
    if use.judged_frames < LONGEST_CHOICE_FRAMES:
        return "the run was too short to learn its profile", "measure longer, or clean the optics"
    if not noise_is_known:
        return "the noise of the sensor is assumed, not measured", "rig calibrate sensor"
    return (
        "no constant profile fits it: it flickers, or the sensor's noise is not as stated",
        "let the laser warm up, shield the beam from air; rig calibrate sensor",
    )


_MOST_FRAMES = 20_000
"""Most frames to which the rate of the clock is fitted: more would not make it better known."""
_U_UNKNOWN = 100e-6 / math.sqrt(3.0)
"""Relative standard uncertainty of an unknown rate: a quartz within its usual tolerance, 100 ppm."""
_MOST_STEP_S = 1e-3
"""Largest uncertainty of a step that is no fault: turning points are timed to some 0.1 ms."""
_LIMIT = f"steps known to {_MOST_STEP_S:g} s"
_FIELDS = ("sequence", "device_time_ns", "host_time_ns")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunClock:
    """The clock of a run.

    `drift_ppm` is the camera's rate against the computer's, less 1; NaN if unknown. `u_rate` is the relative
    uncertainty of the run's second, as in the budget: by the calibration or, without one, by the deviation
    from the assumed ideal rate. It includes `u_steps_s`, the uncertainty of all steps together. `steps` is
    the number of steps that were subtracted from the times, `largest_step_s` the largest.
    """

    drift_ppm: Annotated[float, Quantity("clock drift", "rate of the camera's clock against the computer's")]
    u_drift_ppm: float
    u_rate: Annotated[float, Quantity("u(clock)", "standard uncertainty of the run's second, relative")]
    steps: int = 0
    largest_step_s: Annotated[float, Quantity("step", "largest step of the camera's clock")] = 0.0
    u_steps_s: float = 0.0
    synchronised: bool = False

    @property
    def text(self) -> str:
        """The clock in one line."""
        known = math.isfinite(self.drift_ppm)
        rate = rate_text(self.drift_ppm, self.u_drift_ppm) if known else "rate unknown"
        times = "once" if self.steps == 1 else f"{self.steps} times, at most"
        stepped = f", stepped {times} by {self.largest_step_s:+.4g} s" if self.steps else ""
        return f"{rate}, second within {1e6 * self.u_rate:.2g} ppm{stepped}"


def run_clock(reader: RecordReader, config: Configuration) -> RunClock | None:
    """The clock of a record; None for frames made on demand, which have times of their own."""
    if config.on_demand:
        return None
    anchors = reader.table(CLOCK.topic)
    synchronised = len(anchors) > 0 and bool(np.all(anchors["synchronised"]))
    u_host = U_SYNCHRONISED if synchronised else U_FREE_RUNNING
    blocks = [block[list(_FIELDS)] for block in reader.spot_blocks(fields=_FIELDS)]
    if RecordedCamera.from_metadata(reader.metadata).has_clock is False or not blocks:
        return RunClock(drift_ppm=math.nan, u_drift_ppm=math.nan, u_rate=u_host, synchronised=synchronised)
    table = np.concatenate(blocks)
    sequence, device_ns, host_ns = (table[name].astype(np.int64) for name in _FIELDS)
    steps = reader.values(RecordedClockStep)
    u_steps_s = seconds(math.sqrt(sum(float(step.u_step_ns) ** 2 for step in steps)))
    every = max(1, len(sequence) // _MOST_FRAMES)
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


def clock_verdict(clock: RunClock) -> Verdict:
    """Verdict on the steps that were subtracted: a warning if known to `_MOST_STEP_S`, else a fault."""
    if not clock.steps:
        return Verdict("camera's clock", True, measured=clock.text, limit=_LIMIT)
    known = f"it was taken off its times, known to {clock.u_steps_s:.1g} s"
    remedy = "network clock, supply, cable of the camera; rig calibrate clock"
    ok = clock.u_steps_s <= _MOST_STEP_S
    return Verdict("camera's clock", ok, known, remedy, measured=clock.text, limit=_LIMIT)


_MOST_KELVIN = 1.0
"""Largest change of the air's temperature in a run: the paper's arm, 1 m of steel, grows by 12 um, 2 arcsec,
with each kelvin."""
_MOST_LEFT_OUT = 0.2
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
    frames: int,
    lost_spots: int,
    dropped_frames: int,
    limits: PreflightSettings,
    ground: Ground | None = None,
    half_cycles: int = 0,
    beam: Beam | None = None,
    clock: RunClock | None = None,
    balance: Sequence[Verdict] = (),
) -> tuple[Verdict, ...]:
    """One verdict for each condition of a run.

    A dropped frame costs as much as a lost spot: the limit of both is that of the preflight for lost spots.
    """
    return (
        _end(end_of(reader.events())),
        _fraction("lost spots", lost_spots, frames, limits.max_lost_fraction, "see laser, beam and exposure"),
        _fraction(
            "dropped frames",
            dropped_frames,
            frames + dropped_frames,
            limits.max_lost_fraction,
            "find out where they were lost: camera, bus or computer",
        ),
        *([] if beam is None else [beam.verdict(limits.max_poor_fit_fraction)]),
        *([] if beam is None else [_saturation(beam, frames, limits.max_saturated_fraction)]),
        *_forbidden_events(reader.events()),
        *([] if clock is None else [clock_verdict(clock)]),
        *_watcher_failures(reader.events()),
        *_temperature(reader),
        *_ground(ground, half_cycles),
        *balance,
    )


def _end(end: Event | None) -> Verdict:
    """Whether the run reached its end; a run that a person ended early is no fault."""
    if end is None or end.kind == EventKind.FAILED:
        reason = "the record has no end event" if end is None else "an error ended it"
        remedy = "remove the cause, then measure again: rig run --resume"
        measured = "none" if end is None else end.text
        return Verdict("end", False, reason, remedy, measured=measured, limit="its own")
    early = "ended early" if end.kind == EventKind.ENDED_EARLY else ""
    return Verdict("end", True, early, measured=end.text, limit="its own")


def _fraction(name: str, count: int, total: int, most: float, remedy: str) -> Verdict:
    part = count / total if total else 0.0
    measured = f"{count} of {total} ({percent(part)})"
    return _condition(name, part <= most, "too many", remedy, measured, f"{100 * most:g} %")


def _saturation(beam: Beam, frames: int, most: float) -> Verdict:
    """A warning of saturated spots: their flanks alone are fitted, which is right only for Gaussian beams."""
    found = _fraction(
        "saturation",
        beam.flags.get(SpotFlag.SATURATED.name or "", 0),
        frames,
        most,
        "lower the exposure (exposure_us) or the laser's power",
    )
    return replace(found, ok=True, reason="" if found.ok else "pixels at full scale are lost to the fit")


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
    ok = float(np.ptp(read_c)) <= _MOST_KELVIN
    return [_condition("temperature", ok, reason, remedy, measured, f"within {_MOST_KELVIN:g} K")]


def _ground(ground: Ground | None, half_cycles: int) -> list[Verdict]:
    """Whether the ground, by the exact fit, left most of the half-cycles to be fitted."""
    if ground is None or not half_cycles:
        return []
    part = ground.left_out_half_cycles / (half_cycles + ground.left_out_half_cycles)
    widest = max((value for value in ground.widening.values() if np.isfinite(value)), default=1.0)
    reason = "it drove the pendulum more than friction braked it"
    remedy = "measure at a quieter time or place; end at a larger amplitude"
    measured = f"{percent(part)} of the half-cycles left out, uncertainties × {widest:.2g}"
    limit = f"{100 * _MOST_LEFT_OUT:g} % left out"
    return [_condition("ground", part <= _MOST_LEFT_OUT, reason, remedy, measured, limit)]
