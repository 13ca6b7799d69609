"""Texts on a running session: its steps, the time left, its parameters, its events."""

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
_STEPS_AT_ONCE = (Phase.WAITING, Phase.PREFLIGHT, Phase.MEASURING, Phase.CLOSING)


def step_bar(run_state: Mapping[str, Any], start_way: str) -> str:
    """The steps from the start to the record, the present step with its value against its limit."""
    phase = run_state.get("phase") or Phase.WAITING
    progress = str(run_state.get("progress") or "")
    # a run in another phase was not started at once, whatever its configuration states
    is_at_once = start_way == "at once" and phase in _STEPS_AT_ONCE
    items = []
    for step in _STEPS_AT_ONCE if is_at_once else _STEPS:
        text, attribute = _STEPS[step], ""
        if step == phase:
            text, attribute = f"{text}: {progress}" if progress else text, " aria-current=step"
        items.append(f"<li{attribute}>{html.escape(text)}</li>")
    return f"<ol class='steps' aria-label='from the start to the record'>{''.join(items)}</ol>"


def time_left(run_state: Mapping[str, Any]) -> str:
    """The time to the end; an upper bound if its uncertainty is larger than the time itself."""
    remaining_s, u_s, limit_s = (run_state.get(key) for key in ("remaining_s", "u_remaining_s", "at_most_s"))
    bounds_s = [float(limit_s)] if limit_s is not None and math.isfinite(limit_s) else []
    if remaining_s is not None and (not u_s or u_s <= remaining_s):
        return _minutes(remaining_s) + (f" ± {float(u_s):.0f} s" if u_s else "")
    if remaining_s is not None and u_s is not None:
        bounds_s.append(float(remaining_s) + 2.0 * float(u_s))
    return f"at most {_minutes(min(bounds_s))}" if bounds_s else "too early to say"


def _minutes(duration_s: float) -> str:
    """A duration as minutes and seconds, such as `1:11 min`."""
    minutes, seconds = divmod(round(max(duration_s, 0.0)), 60)
    return f"{minutes}:{seconds:02d} min"


def first_fit(run_state: Mapping[str, Any]) -> str:
    """Text instead of parameters before the first fit."""
    count = int(run_state.get("half_cycles") or 0)
    if count >= FIRST_HALF_CYCLES:
        return f"the first fit of {count} half-cycles is being made"
    return f"the first fit is made from {FIRST_HALF_CYCLES} half-cycles on; {count} so far"


def estimate_rows(run_state: Mapping[str, Any]) -> list[list[str]]:
    """Parameters so far, or why there are none."""
    rows = []
    for key, estimate in (run_state.get("estimates") or {}).items():
        value, u = estimate["value"], estimate["standard_uncertainty"]
        if value is not None and u is not None:
            rows.append([quantity(key).label, *estimate_texts(key, Estimate(value, u))])
    return rows or [["parameters", f"nothing yet: {first_fit(run_state)}"]]


def sorted_events(events: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Events sorted by time, because a record need not contain them in this order.

    The text of a trip is removed from later events that repeat it.
    """
    result, trip_text = list[Mapping[str, Any]](), ""
    for event in sorted(events, key=itemgetter("time_s")):
        text = str(event["text"])
        if event["level"] == Severity.TRIP:
            trip_text = text
        elif trip_text and text.endswith(trip_text):
            event = {**event, "text": text.removesuffix(trip_text).removesuffix(": ")}
        result.append(event)
    return result


def event_line(event: Mapping[str, Any]) -> str:
    """An event with its time of day."""
    css_class = {"trip": "no", "alarm": "no", "warning": "caution"}.get(str(event["level"]), "")
    # the text of some events is empty
    text = html.escape(": ".join(str(event[part]) for part in ("kind", "text") if event[part]))
    return f"<div class='{css_class}'><span class='dim'>{clock(event['time_s'])}</span> {text}</div>"
