"""What a run looks like at one moment, for terminal, view and programs."""

import math
from dataclasses import dataclass, field

from acquisition.frame_losses import FrameLosses


@dataclass(frozen=True, slots=True)
class Snapshot:
    """State of a run at one moment, frozen. The amplitude is in arcsec (px without calibration).

    `frame_age_s` is how long ago the oldest of the frames processed last arrived, when their processing
    began: it grows while we fall behind. `losses` are the dropped frames by who lost them, as the camera
    counts them now. `instruction` is what the operator is asked to do; `controller` says how the
    controller stands.
    """

    phase: str = "waiting for the first frame"
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
    reason: str = ""
    temperature_c: float = math.nan
    humidity_percent: float = math.nan
    pressure_pa: float = math.nan
    controller: str = ""
    instruction: str = ""
