"""Measure: begin a session, watch it at arm's length, brake, stop; what it gave, and what comes next."""

import html
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import run, ui

from processing.errors import RigError
from processing.estimate import Estimate
from rig.alarms import AlarmKey
from rig.control import STALE_S, DevicesNow
from rig.desk import charts, tables
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.panels.live_picture import LivePicture, no_frame_yet
from rig.desk.panels.run_charts import FIRST_FIT, RunCharts
from rig.desk.panels.run_result import NEXT_RUN, RunResult
from rig.desk.panels.start_form import build_form
from rig.desk.run_reader import newest_first
from rig.desk.tab import Tab
from rig.instrument import Phase
from rig.measure import estimate_texts
from rig.presentation import quantity

_SIZE = (420, 300)
_OF_DISK = (AlarmKey.OUTPUT, AlarmKey.DISK_FULL, AlarmKey.DISK_HANGS, AlarmKey.DISK_FORECAST)
_IF_SOUND = "Stop the session? The record is closed and fitted; nothing is lost."
_IF_FROZEN = (
    "The session does not answer. End its process? The laser is switched off; the record stays, at worst "
    "without its last second, and is fitted by Fit again; Resume makes the missing runs."
)


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    stretched = False

    async def stop() -> None:
        asked.set_text(_IF_FROZEN if desk.following.frozen else _IF_SOUND)
        if desk.following.running and await sure:
            ui.notify(await run.io_bound(desk.stop_session))

    async def brake() -> None:
        status = desk.following.devices.status
        is_on = status is not None and status.brake_on
        ui.notify(await run.io_bound(desk.following.order, "brake off" if is_on else "brake on"))

    async def note() -> None:
        text = str(noting.value or "").strip()
        if not text:
            raise RigError("an empty note: type some text")
        said = await run.io_bound(desk.following.order, f"note {text}")
        # only what is on the session's disk leaves the field
        noting.set_value("")
        ui.notify(said)

    def stretch() -> None:
        nonlocal stretched
        stretched = not stretched
        stretching.set_text("to scale" if stretched else "stretch X")
        draw()

    with ui.dialog().props('aria-label="stop the session"') as sure, ui.card():
        asked = ui.label(_IF_SOUND)
        with ui.row():
            ui.button("Stop it", on_click=lambda: sure.submit(True)).props('color="negative"')
            ui.button("Go on", on_click=lambda: sure.submit(False)).props("outline")
    with ui.column().classes("full-width") as before:
        RunResult(desk, tab)
        build_form(desk, tab).props(f'id="{NEXT_RUN}"').style("scroll-margin-top: 120px")
    with ui.element("div").classes("grid measure fills live") as during:
        with ui.column().classes("stack"):
            with ui.column().classes("box"):
                with ui.row().classes("items-baseline"):
                    ui.html("amplitude", tag="h3", sanitize=False).classes("title")
                    before_it = ui.label().classes("caution").props('role="status" aria-live="polite"')
                with ui.element("div").classes("huge"):
                    amplitude = (
                        ui.label()
                        .props('role="status" aria-live="off" id="amplitude"')
                        .style("display: inline")
                    )
                    unit_of = ui.label().classes("unit").style("display: inline; margin-left: .3em")
                with ui.row().classes("items-baseline"):
                    ui.label("time left").classes("title")
                    left = ui.label().classes("middle")
                progress = ui.linear_progress(value=0.0, show_value=False).props(
                    'aria-label="part of the run done"'
                )
                laser = ui.label().classes("middle").props('aria-label="laser and interlock"')
                with ui.row():
                    tab.button("Stop", stop).props('color="negative" size="lg" aria-label="Stop the session"')
                    brakes = tab.button("Brake", brake).props(
                        'outline size="lg" aria-label="Brake on or off"'
                    )
            with ui.column().classes("box"):
                LivePicture(tab, _SIZE, lambda: desk.following.running, lambda: no_frame_yet(desk.following))
        with ui.column().classes("box"):
            way = charts.Chart("trajectory", "deflection_x", charts.WAY, square=True)
            way.element.style("width: min(100%, max(240px, 32vh))")
            with way.beside:
                stretching = ui.button("stretch X", on_click=stretch).props("dense outline no-caps")
            RunCharts(desk, tab)
        with ui.column().classes("stack"):
            told = ui.column().classes("box shrinks")
            with told.props('role="region" aria-label="state of the run" tabindex="0"'):
                ui.html("state of the run", tag="h3", sanitize=False).classes("title")
                learned = ui.html(sanitize=False).classes("full-width")
                state = ui.html(sanitize=False).classes("full-width")
            with ui.column().classes("box grows"):
                ui.html("events", tag="h3", sanitize=False).classes("title")
                with ui.row().classes("full-width no-wrap items-center"):
                    noting = ui.input("note").props('dense outlined data-key="note" maxlength=2000')
                    noting.classes("full-width").on("keydown.enter", tab.act(note))
                    tab.button("Note", note).props('outline aria-label="note it in the record"')
                events = (
                    ui.html(sanitize=False)
                    .classes("events")
                    .props('role="log" aria-label="events" tabindex="0"')
                )

    def refresh() -> None:
        news = desk.following.news
        running = desk.following.running
        before.set_visibility(not running)
        during.set_visibility(running)
        if not running:
            return
        run_state = news.get("state") or {}
        unit = str(news.get("unit") or "")
        measuring = run_state.get("phase") == Phase.MEASURING
        frames_age_s = desk.following.frames_age_s
        is_dark = bool(news.get("darkness"))
        blind = frames_age_s > STALE_S or is_dark
        before_it.set_text(
            "it is dark: values are from before"
            if is_dark
            else f"no frame for {frames_age_s:.0f} s: values are from before"
            if blind
            else ""
            if measuring
            else f"nothing recorded yet: {doing(run_state) or 'preparing'}"
        )
        during.classes(add="blind") if blind else during.classes(remove="blind")
        value = run_state.get("amplitude")
        amplitude.set_text("?" if value is None else f"{float(value):.2f}")
        amplitude.classes(add="dim") if value is None else amplitude.classes(remove="dim")
        unit_of.set_text(unit)
        left.set_text(_left(run_state))
        progress.set_value(_done(news))
        devices = desk.following.devices
        if old := time.monotonic() - desk.following.heard_s > STALE_S:
            laser.set_text("unknown: the session does not answer")
        else:
            laser.set_text(str(news.get("darkness") or "") or _light(devices))
        laser.classes(remove="go no", add="no" if old or news.get("darkness") else "go")
        brakes.set_visibility(devices.controller is not None)
        learned.set_content(tables.table(_estimates(run_state), "parameters so far"))
        crying = {row.key: row.cause for row in desk.alarming.alarms.rows() if row.cleared_s is None}
        rows = as_alarmed(
            news.get("rows") or [],
            crying,
            frames_age_s,
            spot_lost_s=float(news.get("spot_lost_s") or 0.0),
            is_dark=is_dark,
        )
        state.set_content(tables.table(rows, "state of the run"))
        events.set_content(
            "".join(_event(at_s, event) for at_s, event in newest_first(news, tuple(desk.following.events)))
        )

    def draw() -> None:
        if desk.following.running:
            path = desk.following.news.get("path") or {"x": [], "y": []}
            unit = str(desk.following.news.get("unit") or "")
            charts.trajectory(way, path["x"], path["y"], unit, stretched=stretched)

    tab.every(0.25, refresh)
    tab.every(0.5, draw)
    refresh()


def _left(run_state: Mapping[str, Any]) -> str:
    seconds, u, at_most = (run_state.get(key) for key in ("remaining_s", "u_remaining_s", "at_most_s"))
    if seconds is None:
        return "too early to say" if at_most is None else f"at most {_minutes(at_most)}"
    return _minutes(seconds) + (f" ± {float(u):.0f} s" if u else "")


def _minutes(seconds: float) -> str:
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    return f"{minutes}:{rest:02d} min"


def _done(news: Mapping[str, Any]) -> float:
    """The part of the run that is over."""
    rows = (news.get("state") or {}).get("done")
    return 0.0 if rows is None else round(float(rows), 3)


def _light(devices: DevicesNow) -> str:
    if devices.controller is not None:
        return devices.text
    return "no laser is controlled" if devices.laser is None else f"laser {devices.laser.text}"


def _estimates(run_state: Mapping[str, Any]) -> list[list[str]]:
    rows = []
    for key, one in (run_state.get("estimates") or {}).items():
        value, u = one["value"], one["standard_uncertainty"]
        if value is not None and u is not None:
            rows.append([quantity(key).label, *estimate_texts(key, Estimate(value, u))])
    return rows or [["parameters", f"nothing yet: {FIRST_FIT}"]]


def _event(at_s: float, event: Mapping[str, Any]) -> str:
    grave = {"trip": "no", "alarm": "no", "warning": "caution"}.get(str(event["level"]), "")
    when = str(event["at"]) if math.isnan(at_s) else f"{at_s:.1f} s"
    # some have said all with their kind
    text = html.escape(": ".join(str(event[part]) for part in ("kind", "text") if event[part]))
    return f"<div class='{grave}'><span class='dim'>{when}</span> {text}</div>"


def as_alarmed(
    rows: Sequence[Sequence[str]],
    causes: Mapping[AlarmKey, str],
    no_frame_s: float,
    *,
    spot_lost_s: float = 0.0,
    is_dark: bool = False,
) -> list[list[str]]:
    """The rows (name, text) beside alarms: what one contradicts says so instead of its last value.

    `causes` are those of the alarms that hold now. Losses are counted where they can be: the row says first
    what is being lost at this moment.
    """
    instead: dict[str, str] = {}
    losing = ""
    if AlarmKey.CAMERA in causes:
        instead |= {"camera": f"no frame for {no_frame_s:.0f} s", "beam": "not seen: no frames"}
        losing = "frames that do not come are counted when they come again"
    elif is_dark:
        instead["beam"] = "not seen: the laser is dark"
        losing = "no spot: the laser is dark"
    elif AlarmKey.SPOT in causes:
        instead["beam"] = "no spot now"
        losing = f"no spot for {spot_lost_s:.0f} s"
    for key in _OF_DISK:
        if key in causes:
            instead["disk"] = causes[key]
            break
    told = [[name, instead.get(name, text)] for name, text, *_ in rows]
    return [
        [name, f"{losing}; {text}"] if losing and name == "losses" else [name, text] for name, text in told
    ]
