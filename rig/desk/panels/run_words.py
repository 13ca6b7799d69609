"""Texts on a running session: its steps, its end, its fits, its events."""

import html
import math
from collections.abc import Iterable, Mapping
from operator import itemgetter
from typing import Any

from acquisition.record.events import Severity
from processing.estimate import Estimate
from rig.desk.run_reader import clock
from rig.instrument import Phase
from rig.measure import FIRST_HALF_CYCLES, estimate_texts
from rig.terminal import quantity

_STEPS: Mapping[str, str] = {
    Phase.WAITING: "devices",
    Phase.REST: "rest",
    Phase.WARM_UP: "warm-up",
    Phase.PREFLIGHT: "preflight",
    Phase.RELEASE: "release",
    Phase.MEASURING: "recording",
    Phase.CLOSING: "closing",
}
_AT_ONCE = (Phase.WAITING, Phase.PREFLIGHT, Phase.MEASURING, Phase.CLOSING)


def strip(run_state: Mapping[str, Any], start_way: str) -> str:
    """The steps from the start to the record, the present one with its value against its limit."""
    now = run_state.get("phase") or Phase.WAITING
    progress = str(run_state.get("progress") or "")
    # what a run does counts, whatever its configuration says
    steps = _AT_ONCE if start_way == "at once" and now in _AT_ONCE else tuple(_STEPS)
    lines = []
    for step in steps:
        current = step == now
        text = f"{_STEPS[step]}: {progress}" if current and progress else _STEPS[step]
        lines.append(f"<li{' aria-current=step' * current}>{html.escape(text)}</li>")
    return f"<ol class='steps' aria-label='from the start to the record'>{''.join(lines)}</ol>"


def time_left(run_state: Mapping[str, Any]) -> str:
    """The time to the end; what is less certain than it is long is a bound."""
    seconds, u, at_most = (run_state.get(key) for key in ("remaining_s", "u_remaining_s", "at_most_s"))
    bounds = [float(at_most)] if at_most is not None and math.isfinite(at_most) else []
    if seconds is not None and (not u or u <= seconds):
        return minutes(seconds) + (f" ± {float(u):.0f} s" if u else "")
    if seconds is not None and u is not None:
        bounds.append(float(seconds) + 2.0 * float(u))
    return f"at most {minutes(min(bounds))}" if bounds else "too early to say"


def minutes(seconds: float) -> str:
    """`1:11 min`."""
    whole, rest = divmod(round(max(seconds, 0.0)), 60)
    return f"{whole}:{rest:02d} min"


def first_fit(run_state: Mapping[str, Any]) -> str:
    """Text in the place of parameters before the first fit."""
    count = int(run_state.get("half_cycles") or 0)
    if count >= FIRST_HALF_CYCLES:
        return f"the first fit of {count} half-cycles is being made"
    return f"the first fit is made from {FIRST_HALF_CYCLES} half-cycles on; {count} so far"


def estimate_rows(run_state: Mapping[str, Any]) -> list[list[str]]:
    """Parameters so far, and why there are none."""
    rows = []
    for key, one in (run_state.get("estimates") or {}).items():
        value, u = one["value"], one["standard_uncertainty"]
        if value is not None and u is not None:
            rows.append([quantity(key).label, *estimate_texts(key, Estimate(value, u))])
    return rows or [["parameters", f"nothing yet: {first_fit(run_state)}"]]


def listed(events: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Events in the order of time, in which no record must have them; what a trip says stands there once."""
    found, trip = list[Mapping[str, Any]](), ""
    for one in sorted(events, key=itemgetter("at_s")):
        text = str(one["text"])
        if one["level"] == Severity.TRIP:
            trip = text
        elif trip and text.endswith(trip):
            one = {**one, "text": text.removesuffix(trip).removesuffix(": ")}
        found.append(one)
    return found


def event_line(event: Mapping[str, Any]) -> str:
    """An event with its time of the day."""
    grave = {"trip": "no", "alarm": "no", "warning": "caution"}.get(str(event["level"]), "")
    # some have said all with their kind
    text = html.escape(": ".join(str(event[part]) for part in ("kind", "text") if event[part]))
    return f"<div class='{grave}'><span class='dim'>{clock(event['at_s'])}</span> {text}</div>"
