"""The state of a run as the view's State panel shows it."""

import math
from collections.abc import Mapping

from processing.deflections import DeflectionUnit
from rig.instrument import Phase, Snapshot
from rig.presentation import Shown
from rig.rerun import is_drawn

_BEFORE = (Phase.WAITING, Phase.REST, Phase.WARM_UP, Phase.PREFLIGHT, Phase.RELEASE)


def state_text(snapshot: Snapshot, unit: DeflectionUnit, at: str, empty: list[str]) -> str:
    """Phase, amplitude, frames and losses, in Markdown.

    `at` is the time of the day, by which a page shows how far it is behind; `empty` says of each panel in
    which there is nothing why.
    """
    dropped, lost = snapshot.dropped_frames, snapshot.lost_spots
    lines = [f"state of {at}", f"time {snapshot.elapsed_s:.1f} s"]
    if not math.isnan(snapshot.amplitude):
        lines.append(f"amplitude {snapshot.amplitude:.2f} {unit.shown}")
    if not math.isnan(snapshot.period_s):
        lines.append(f"period {snapshot.period_s:.4f} s")
    lines.append(f"{snapshot.frames} frames, {dropped} dropped, {lost} spots lost")
    if clock := snapshot.clock.text:
        lines.append(f"camera's clock {clock}")
    if snapshot.beam:
        lines.append(f"beam: {snapshot.beam}")
    if not math.isnan(snapshot.frame_age_s):
        lines.append(f"frames were {snapshot.frame_age_s * 1e3:.0f} ms old when they were processed")
    if snapshot.losses.total:
        lines.append(f"lost: {snapshot.losses}")
    lines.append(f"{snapshot.half_cycles} half-cycles")
    lines += empty
    alarm = f"# {snapshot.alarm.upper()}\n\n" if snapshot.alarm else ""
    reason = f": {snapshot.reason}" if snapshot.reason else ""
    return f"{alarm}**{snapshot.doing}**{reason}\n\n" + "\n".join(f"- {line}" for line in lines) + "\n"


def empty_panels(
    snapshot: Snapshot, parameters: Mapping[str, Shown], *, balanced: bool, with_lever: bool
) -> list[str]:
    """Why there is nothing in panels of the measuring layout, a line for each kind of them.

    `parameters` are those that have panels, `balanced` says whether a balance was estimated.
    """
    found = []
    if not snapshot.half_cycles:
        when = "the record begins" if snapshot.phase in _BEFORE else "a half-cycle has been measured"
        found.append(f"amplitude and period are empty until {when}")
    if not snapshot.clock.known:
        found.append("the clock is empty until the rate of the camera's is known; frames on demand have none")
    if not balanced:
        found.append("the balance is empty until some periods of swing have been seen")
    if parameters and not snapshot.estimates:
        found.append("the parameters are empty until there are enough half-cycles for a first fit")
    elif parameters:
        known = {key: snapshot.estimates.get(key) for key in parameters}
        vague = [
            parameters[key].symbol
            for key, one in known.items()
            if one is None or not is_drawn(one.value, one.standard_uncertainty)
        ]
        if vague:
            found.append(f"not known to a half of their values yet, hence not drawn: {', '.join(vague)}")
    elif not with_lever:
        found.append("no parameters are fitted: without [lever] pixels are not angles")
    return found
