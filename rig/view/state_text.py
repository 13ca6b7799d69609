"""The state of a run as the view's State panel shows it."""

import math

from processing.deflections import DeflectionUnit
from rig.instrument import Snapshot


def state_text(snapshot: Snapshot, unit: DeflectionUnit) -> str:
    """Phase, amplitude, frames and losses, in Markdown."""
    dropped, lost = snapshot.dropped_frames, snapshot.lost_spots
    lines = [f"time {snapshot.elapsed_s:.1f} s"]
    if not math.isnan(snapshot.amplitude):
        lines.append(f"amplitude {snapshot.amplitude:.2f} {unit.shown}")
    if not math.isnan(snapshot.period_s):
        lines.append(f"period {snapshot.period_s:.4f} s")
    lines.append(f"{snapshot.frames} frames, {dropped} dropped, {lost} spots lost")
    if snapshot.beam:
        lines.append(f"beam: {snapshot.beam}")
    if not math.isnan(snapshot.frame_age_s):
        lines.append(f"frames are {snapshot.frame_age_s * 1e3:.0f} ms old")
    if snapshot.losses.total:
        lines.append(f"lost: {snapshot.losses}")
    lines.append(f"{snapshot.half_cycles} half-cycles")
    alarm = f"# {snapshot.alarm.upper()}\n\n" if snapshot.alarm else ""
    reason = f": {snapshot.reason}" if snapshot.reason else ""
    return f"{alarm}**{snapshot.doing}**{reason}\n\n" + "\n".join(f"- {line}" for line in lines) + "\n"
