"""The state of a run at one moment, accumulated from the messages of its record, growing or complete."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeVar

from acquisition.frames.losses import FrameLosses
from acquisition.record.events import Event
from acquisition.record.reader import Piece, RecordReader
from acquisition.record.topics import (
    Environment,
    RecordedClockStep,
    RecordedEstimate,
    RecordedHealth,
    RecordedLight,
    RecordedLosses,
    RecordedNote,
    RecordedPhase,
    TimedMessage,
)
from processing.balance import Balance
from processing.deflections import DeflectionUnit
from processing.estimate import Estimate
from processing.swing import HalfCycle
from processing.units import seconds

_MAX_KNOWN_U_PPM = 100.0
"""Largest u of a known rate: any quartz is right within this, so a rate with a larger u tells nothing."""
_MAX_WAIT_PERIODS = 3.0
"""Periods without a further half-cycle after which an amplitude is old; each comes half a period late."""

U_FREE_RUNNING: Final = 50e-6
"""Relative standard uncertainty of a computer's free-running quartz oscillator."""
U_SYNCHRONISED: Final = 1e-6
"""Relative standard uncertainty of a clock that follows a time server without a stated uncertainty."""
U_QUARTZ: Final = 0.7e-6
"""Relative standard uncertainty of a quartz by room temperature: 1 ppm up and down within an hour."""


def rate_text(drift_ppm: float, u_drift_ppm: float) -> str:
    """Rate and standard uncertainty with two digits of the latter, at most 0.1 ppb fine."""
    digits = min(max(1 - math.floor(math.log10(max(u_drift_ppm, 1e-9))), 0), 4)
    return f"{drift_ppm:+.{digits}f} ± {max(u_drift_ppm, 10.0**-digits):.{digits}f} ppm"


@dataclass(frozen=True, slots=True)
class CameraClock:
    """Rate of the camera's clock against the computer's, and its steps.

    NaN if unknown: a camera without a clock, or frames made on demand.
    """

    drift_ppm: float = math.nan
    """Rate minus 1."""
    u_drift_ppm: float = math.nan
    steps: int = 0
    """Number of steps, which are subtracted from the times."""
    largest_step_s: float = 0.0

    @property
    def is_known(self) -> bool:
        """Whether the rate is known better than that of any quartz."""
        return self.u_drift_ppm <= _MAX_KNOWN_U_PPM

    @property
    def text(self) -> str:
        """Rate and steps in one line; empty where neither is known."""
        parts = []
        if self.is_known:
            parts.append(f"{rate_text(self.drift_ppm, self.u_drift_ppm)} against the computer's")
        if self.steps:
            count = "once" if self.steps == 1 else f"{self.steps} times, at most"
            parts.append(f"stepped {count} by {self.largest_step_s:+.4g} s")
        return ", ".join(parts)


_Value = TypeVar("_Value")
_STATE_KINDS: Final[tuple[type[TimedMessage], ...]] = (
    *(RecordedPhase, RecordedLight, RecordedClockStep, RecordedLosses, Environment),
    *(RecordedHealth, RecordedEstimate),
)
"""Kinds of messages that change the state of a run, in the order in which those of one piece are applied."""


class Phase(StrEnum):
    """Phases of a run."""

    WAITING = "waiting for the first frame"
    REST = "rest"
    WARM_UP = "warm-up"
    PREFLIGHT = "preflight"
    RELEASE = "release"
    MEASURING = "measuring"
    CLOSING = "closing the record"
    DONE = "done"


_PHASES: Final = {phase.value: phase for phase in Phase}


class RecordContents(NamedTuple):
    """One piece of a record: half-cycles, balances, events, and messages of the session."""

    start_ns: int = 0
    """Time of the record's first frame; 0 before it."""
    last_ns: int = 0
    """Time of the last frame so far; 0 before the first."""
    half_cycles: Sequence[HalfCycle] = ()
    balances: Sequence[Balance] = ()
    events: Sequence[Event] = ()
    messages: Sequence[TimedMessage] = ()

    def messages_of_kind(self, kind: type[_Value]) -> list[_Value]:
        """The messages of one kind."""
        return [message for message in self.messages if isinstance(message, kind)]

    @property
    def elapsed_s(self) -> float:
        """Time from the first frame to the last one."""
        return seconds(self.last_ns - self.start_ns)


def piece_contents(reader: RecordReader, piece: Piece, start_ns: int, last_ns: int) -> RecordContents:
    """The contents of a piece of a record; notes are among the events."""
    notes = reader.values(RecordedNote, piece)
    return RecordContents(
        start_ns,
        last_ns,
        reader.half_cycles(piece),
        reader.balances(piece),
        [*reader.events(piece), *(note.event for note in notes)],
        [value for value_class in _STATE_KINDS for value in reader.values(value_class, piece)],
    )


@dataclass(frozen=True, slots=True)
class RunNow:
    """State of a run at one moment. Amplitude and period are those of the last half-cycle without a flag."""

    phase: Phase = Phase.WAITING
    progress: str = ""
    """How far the phase is."""
    elapsed_s: float = 0.0
    frames: int = 0
    dropped_frames: int = 0
    lost_spots: int = 0
    half_cycles: int = 0
    amplitude: float = math.nan
    """Amplitude in arcsec, or in px without a lever calibration."""
    amplitude_s: float = math.nan
    """Time from the first frame to the turning point of that half-cycle."""
    period_s: float = math.nan
    queue_frames: int = 0
    frame_age_s: float = math.nan
    """Time between the arrival of the oldest frame of the last block and the start of its processing."""
    losses: FrameLosses = field(default_factory=FrameLosses)
    """Dropped frames by cause, as counted by the camera."""
    record_bytes: int = 0
    disk_free_bytes: float = math.nan
    reason: str = ""
    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan
    light: str = ""
    interlock: str = ""
    trip: str = ""
    """The trip that waits for an acknowledgement."""
    darkness: str = ""
    controller: str = ""
    """State of laser and controller in words."""
    instruction: str = ""
    """Request to the operator."""
    alarm: str = ""
    """A fault of light or disk; empty without one."""
    disk_silent_s: float = 0.0
    """Time for which a write has hung."""
    beam: str = ""
    """Model that is fitted to the spot."""
    clock: CameraClock = field(default_factory=CameraClock)
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    """Parameters of the contact by key; empty before the first fit."""
    estimated_from: int = 0
    """Number of half-cycles of `estimates`."""
    balance: Balance | None = None

    @property
    def phase_text(self) -> str:
        """Phase and progress in words."""
        return f"{self.phase}: {self.progress}" if self.progress else self.phase.value

    @property
    def precedes_record(self) -> bool:
        """Whether nothing is recorded yet."""
        return self.phase in (Phase.REST, Phase.WARM_UP, Phase.PREFLIGHT, Phase.RELEASE)

    @property
    def no_swing_s(self) -> float:
        """Time since the half-cycle of the amplitude, if others should have followed; else 0."""
        since_s = self.elapsed_s - self.amplitude_s
        return since_s if since_s > _MAX_WAIT_PERIODS * self.period_s else 0.0

    def for_new_record(self) -> "RunNow":
        """The state at the beginning of a record, without values of the record of a rejected start."""
        rig_fields = ("phase", "temperature_c", "humidity_percent", "pressure_pa")
        light_fields = ("light", "interlock", "trip", "darkness", "controller", "alarm")
        return RunNow(**{name: getattr(self, name) for name in (*rig_fields, *light_fields)})

    def with_contents(self, contents: RecordContents, unit: DeflectionUnit) -> "RunNow":
        """The state after a piece of the record; deflections are in `unit`."""
        changes: dict[str, Any] = {}
        for message in contents.messages:
            changes |= self._changed_by(message, changes)
        if contents.last_ns:
            changes["elapsed_s"] = contents.elapsed_s
        if contents.half_cycles:
            changes["half_cycles"] = self.half_cycles + len(contents.half_cycles)
        for half_cycle in contents.half_cycles:
            if not half_cycle.flags:
                changes["amplitude"] = half_cycle.amplitude / unit.shown_size
                changes["amplitude_s"] = seconds(half_cycle.turn_time_ns - contents.start_ns)
                if math.isfinite(half_cycle.half_period_s):
                    changes["period_s"] = 2.0 * half_cycle.half_period_s
        if contents.balances:
            changes["balance"] = contents.balances[-1]
        return replace(self, **changes) if changes else self

    def _changed_by(self, message: TimedMessage, changes: Mapping[str, Any]) -> dict[str, Any]:
        """The changes made by a message of the session, after the `changes` by earlier ones."""
        clock: CameraClock = changes.get("clock", self.clock)
        match message:
            case RecordedPhase():
                values = {name: getattr(message, name) for name in message._fields[3:]}
                phase = _PHASES.get(message.phase, Phase.WAITING)
                return {**values, "phase": phase, "elapsed_s": message.elapsed_s}
            case RecordedLight():
                names = ("light", "interlock", "darkness")
                values = {name: getattr(message, name) for name in names}
                return {**values, "trip": message.trip_text, "controller": message.devices}
            case RecordedHealth():
                values = message._asdict()
                del values["time_ns"], values["half_cycles"]
                drift_ppm, u_ppm = values.pop("clock_drift_ppm"), values.pop("u_clock_drift_ppm")
                values["clock"] = replace(clock, drift_ppm=drift_ppm, u_drift_ppm=u_ppm)
                values["queue_frames"] = values.pop("waiting_frames")
                return values
            case RecordedLosses():
                losses = FrameLosses(*message[1:])
                # frames lost after the last one leave no gap in the numbers
                dropped_frames = max(changes.get("dropped_frames", self.dropped_frames), losses.total)
                return {"losses": losses, "dropped_frames": dropped_frames}
            case Environment():
                return dict(zip(message._fields[1:], message[1:], strict=True))
            case RecordedClockStep():
                largest_s = max(clock.largest_step_s, seconds(message.step_ns), key=abs)
                return {"clock": replace(clock, steps=clock.steps + 1, largest_step_s=largest_s)}
            case RecordedEstimate():
                estimates = {**changes.get("estimates", self.estimates)}
                estimates[message.quantity] = Estimate(message.value, message.u_value)
                return {"estimates": estimates, "estimated_from": message.half_cycles}
        return {}
