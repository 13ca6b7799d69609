"""The clock by which a run was timed: the camera's against the computer's over the whole run."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.recorded_camera import RecordedCamera
from acquisition.record.topics import CAMERA_STEP, CLOCK, RecordedClockStep
from calibration import relate_clocks
from processing.errors import DataError
from processing.quantity import Quantity
from processing.ticks import seconds
from rig.devices import U_FREE_RUNNING, U_QUARTZ, U_SYNCHRONISED
from rig.instrument import rate_text
from rig.presentation import Verdict
from rig.settings import Configuration

_MOST_FRAMES = 20_000
"""A line through so many shows the rate as well as all."""
_U_UNKNOWN = 100e-6 / math.sqrt(3.0)
"""Of a quartz within its usual tolerance, 100 ppm, whose rate nothing shows."""
_MOST_STEP_S = 1e-3
"""Turning points are timed to some 0.1 ms: a step that is known less well is seen in them."""
_LIMIT = f"steps known to {_MOST_STEP_S:g} s"
_FIELDS = ("sequence", "device_time_ns", "host_time_ns")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunClock:
    """The clock of a run.

    `drift_ppm` is the camera's rate against the computer's, less 1; NaN if unknown. `u_rate` is the relative
    uncertainty of the run's second, as in the budget: that of the calibration or, without one, of the assumed
    ideal rate; it includes `u_steps_s`, that of all steps together. `steps` were subtracted from the times,
    the largest is `largest_step_s`.
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
    """What the record shows of its clock; None of frames made on demand, whose times are their own."""
    if config.on_demand:
        return None
    anchors = reader.table(CLOCK.topic)
    synchronised = len(anchors) > 0 and bool(np.all(anchors["synchronised"]))
    u_host = U_SYNCHRONISED if synchronised else U_FREE_RUNNING
    blocks = [block[list(_FIELDS)] for block in reader.spot_blocks(fields=_FIELDS)]
    if RecordedCamera.of(reader.metadata).has_clock is False or not blocks:
        return RunClock(drift_ppm=math.nan, u_drift_ppm=math.nan, u_rate=u_host, synchronised=synchronised)
    table = np.concatenate(blocks)
    sequence, device_ns, host_ns = (table[name].astype(np.int64) for name in _FIELDS)
    steps = reader.values(CAMERA_STEP.topic, RecordedClockStep)
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
    """Relative standard uncertainty of the rate by which the run's times were taken.

    A calibrated rate that the run contradicts, and one that was assumed, are wrong by what the run shows.
    """
    u_seen = math.hypot(u_rate, u_host, U_QUARTZ)
    if config.timebase is None:
        return _U_UNKNOWN if math.isnan(u_rate) else math.hypot(rate - 1.0, u_seen)
    off, u_known = rate - config.timebase.camera_rate, config.timebase.u_camera_rate
    contradicted = math.isfinite(u_rate) and abs(off) > 3.0 * math.hypot(u_known, u_seen)
    return math.hypot(off, u_seen) if contradicted else u_known


def clock_verdict(clock: RunClock) -> Verdict:
    """Steps that were taken off are a warning while they are known to a part of what turning points are."""
    if not clock.steps:
        return Verdict("camera's clock", True, measured=clock.text, limit=_LIMIT)
    known = f"it was taken off its times, known to {clock.u_steps_s:.1g} s"
    remedy = "network clock, supply, cable of the camera; rig calibrate clock"
    ok = clock.u_steps_s <= _MOST_STEP_S
    return Verdict("camera's clock", ok, known, remedy, measured=clock.text, limit=_LIMIT)
