"""The state of a run at one moment, for the terminal, the view and other programs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from acquisition.frames.losses import FrameLosses
from acquisition.record.topics import RecordedFittedPoint
from processing.estimate import Estimate
from rig.control import DevicesNow
from rig.instrument.camera_clock import CameraClock


class Phase(StrEnum):
    """What a run is doing."""

    WAITING = "waiting for the first frame"
    REST = "rest"
    WARM_UP = "warm-up"
    PREFLIGHT = "preflight"
    RELEASE = "release"
    MEASURING = "measuring"
    CLOSING = "closing the record"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of a run at one moment. The amplitude is in arcsec, or in px without a lever calibration.

    `progress` says how far the phase is. `frame_age_s` is the time between the arrival of the oldest frame of
    the last block and the start of its processing; it grows if processing is too slow. `losses` are the
    dropped frames by cause, as counted by the camera. `instruction` is a request to the operator, `devices`
    the state of laser and controller, `beam` what is fitted to the spot, `clock` the camera's against the
    computer's, `alarm` what is wrong with light or disk, empty if nothing is, `disk_silent_s` how long a
    write has hung that takes longer than usual.
    `estimates` are the contact's parameters by key, from the first `estimated_from` half-cycles; empty before
    there are enough. `fitted` are these half-cycles beside their fit.
    """

    phase: Phase = Phase.WAITING
    progress: str = ""
    elapsed_s: float = 0.0
    frames: int = 0
    dropped_frames: int = 0
    lost_spots: int = 0
    half_cycles: int = 0
    amplitude: float = math.nan
    period_s: float = math.nan
    queue_frames: int = 0
    frame_age_s: float = math.nan
    losses: FrameLosses = field(default_factory=FrameLosses)
    record_bytes: int = 0
    disk_free_bytes: float = math.nan
    reason: str = ""
    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan
    devices: DevicesNow = field(default_factory=DevicesNow)
    instruction: str = ""
    alarm: str = ""
    disk_silent_s: float = 0.0
    beam: str = ""
    clock: CameraClock = field(default_factory=CameraClock)
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    estimated_from: int = 0
    fitted: Sequence[RecordedFittedPoint] = ()

    @property
    def doing(self) -> str:
        """Phase and progress in words."""
        return f"{self.phase}: {self.progress}" if self.progress else self.phase.value
