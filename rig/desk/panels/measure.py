"""Measure: begin a session, watch it at arm's length, brake, stop; what has happened."""

import html
import time
from collections.abc import Mapping
from typing import Any

from nicegui import run, ui

from processing.errors import ConfigurationError
from processing.estimate import Estimate
from rig.control import STALE_S, DevicesNow
from rig.desk import drawings
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.panels.fields import number_field, stated, text_field
from rig.desk.panels.live_picture import LivePicture, no_frame_yet
from rig.desk.tab import DELIBERATE, Tab
from rig.instrument import Phase
from rig.measure import estimate_texts
from rig.presentation import quantity
from rig.settings import SessionSettings

_SIZE = (420, 240)
_RELEASE = {
    "at once": "recorded from the first frame on, whether it moves or not",
    "by hand": "comes to rest, is checked; then you are asked to release it by hand",
    "magnet": "held by the magnet, released by it once at rest",
    "starter": "comes to rest, is checked; then the starter pushes it",
}


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    session = desk.config.session

    def judged() -> dict[str, object]:
        for field, _ in fields.values():
            if field.value and not field.validate():
                raise ConfigurationError(str(field.error))
        return stated(fields)

    def ask() -> None:
        values = judged()
        desk.checked(values)
        # what was allowed for one session holds for that one
        force.set_value(False)
        what.set_text(_asked(desk.checked(values).session))
        begin.open()

    async def start() -> None:
        begin.close()
        folder = await run.io_bound(desk.start_session, judged(), force=bool(force.value))
        ui.notify(f"the session begins in {folder}")

    async def stop() -> None:
        if desk.following.running and await sure:
            ui.notify(await run.io_bound(desk.following.order, "stop"))

    async def brake() -> None:
        status = desk.following.devices.status
        is_on = status is not None and status.brake_on
        ui.notify(await run.io_bound(desk.following.order, "brake off" if is_on else "brake on"))

    with ui.dialog().props('aria-label="stop the session"') as sure, ui.card():
        ui.label("Stop the session? The record is closed and fitted; nothing is lost.")
        with ui.row():
            ui.button("Stop it", on_click=lambda: sure.submit(True)).props('color="negative"')
            ui.button("Go on", on_click=lambda: sure.submit(False)).props("outline")
    with ui.dialog().props('aria-label="start the session"') as begin, ui.card():
        what = ui.label().classes("middle")
        ui.label("The laser will be lit. Look that nobody is in the beam's way.")
        force = ui.checkbox("measure even if preflight says no-go, this session only")
        with ui.row():
            ui.button("Start the session", on_click=tab.act(start)).props(f'color="positive" {DELIBERATE}')
            ui.button("Not now", on_click=begin.close).props("outline")
    with ui.column().classes("full-width box") as before:
        with ui.row().classes("full-width no-wrap"):
            sample = text_field(desk, "session.sample", "sample", session.sample)
            operator = text_field(desk, "session.operator", "operator", session.operator)
        with ui.row().classes("full-width no-wrap"):
            notes = text_field(desk, "session.notes", "notes", session.notes)
            history = text_field(desk, "session.contact_history", "contact history", session.contact_history)
        with ui.row().classes("full-width items-center"):
            runs = number_field(desk, "session.runs", "runs", session.runs)
            first = number_field(
                desk, "session.initial_amplitude_arcsec", "from / arcsec", session.initial_amplitude_arcsec
            )
            last = number_field(
                desk, "session.final_amplitude_arcsec", "to / arcsec", session.final_amplitude_arcsec
            )
            longest = number_field(desk, "session.max_duration_s", "at most / s", session.max_duration_s)
        with ui.row().classes("items-center"):
            ui.button("Start …", on_click=tab.act(ask)).props(
                'color="positive" size="lg" aria-label="start a session"'
            )
            ui.label(f"release: {_RELEASE[desk.config.start.way]}").classes("dim")
        words = ui.html(sanitize=False).classes("full-width dim")
    fields = {
        "session.sample": (sample, False),
        "session.operator": (operator, False),
        "session.notes": (notes, False),
        "session.contact_history": (history, False),
        "session.runs": (runs, True),
        "session.initial_amplitude_arcsec": (first, True),
        "session.final_amplitude_arcsec": (last, True),
        "session.max_duration_s": (longest, True),
    }
    with ui.column().classes("full-width") as during:
        with ui.element("div").classes("three"):
            with ui.column().classes("box"):
                with ui.row().classes("items-baseline"):
                    ui.label("amplitude").classes("title")
                    before_it = ui.label().classes("caution").props('role="status" aria-live="polite"')
                amplitude = ui.label().classes("large").props('role="status" aria-live="off" id="amplitude"')
                ui.label("time left").classes("title")
                left = ui.label().classes("middle")
                progress = ui.linear_progress(value=0.0, show_value=False)
                ui.label("laser and interlock").classes("title")
                laser = ui.label().classes("middle")
                with ui.row():
                    ui.button("Stop", on_click=tab.act(stop)).props(
                        'color="negative" size="lg" aria-label="stop the session"'
                    )
                    brakes = ui.button("Brake", on_click=tab.act(brake)).props(
                        'outline size="lg" aria-label="brake on or off"'
                    )
            with ui.column().classes("box"):
                ui.label("what the run has told").classes("title")
                learned = ui.html(sanitize=False).classes("full-width")
                ui.label("decay").classes("title")
                decay = ui.html(sanitize=False).classes("full-width")
            with ui.column().classes("box"):
                ui.label("trajectory").classes("title")
                way = ui.html(sanitize=False).classes("full-width")
        with ui.element("div").classes("three"):
            with ui.column().classes("box"):
                LivePicture(tab, _SIZE, lambda: desk.following.running, lambda: no_frame_yet(desk.following))
            with ui.column().classes("box"):
                state = ui.html(sanitize=False).classes("full-width")
            with ui.column().classes("box"):
                ui.label("events").classes("title")
                events = ui.html(sanitize=False).classes("events").props('role="log" aria-label="events"')

    def refresh() -> None:
        news = desk.following.news
        running = desk.following.running
        before.set_visibility(not running)
        during.set_visibility(running)
        if not running:
            lines = "<br>".join(map(html.escape, desk.last_words()))
            words.set_content(lines)
            return
        run_state = news.get("state") or {}
        unit = str(news.get("unit") or "")
        measuring = run_state.get("phase") == Phase.MEASURING
        before_it.set_text("" if measuring else f"nothing is recorded yet: {doing(run_state) or 'preparing'}")
        amplitude.set_text(_number(run_state.get("amplitude"), ".2f", unit))
        left.set_text(_left(run_state))
        progress.set_value(_done(news))
        devices = desk.following.devices
        if old := time.monotonic() - desk.following.heard_s > STALE_S:
            laser.set_text("unknown: the session does not answer")
        else:
            laser.set_text(str(news.get("darkness") or "") or _light(devices))
        laser.classes(remove="go no", add="no" if old or news.get("darkness") else "go")
        brakes.set_visibility(devices.controller is not None)
        learned.set_content(drawings.table(_estimates(run_state), "parameters so far"))
        swings = [(float(t), float(a)) for t, a in news.get("swings") or []]
        decay.set_content(drawings.curve(swings, (420, 130), "amplitude over time", "s", unit))
        path = news.get("path") or {"x": [], "y": []}
        way.set_content(drawings.trajectory(path["x"], path["y"], unit, (300, 270)))
        state.set_content(drawings.table([list(row) for row in news.get("rows") or []], "state of the run"))
        events.set_content("".join(map(_event, reversed(desk.following.events))))

    tab.every(0.25, refresh)
    refresh()


def _asked(session: SessionSettings) -> str:
    runs = "one run" if session.runs == 1 else f"{session.runs} runs"
    return f"Start {runs} of {session.sample or 'a sample that is not named'}?"


def _number(value: Any, shape: str, unit: str) -> str:
    return f"– {unit}" if value is None else f"{float(value):{shape}} {unit}"


def _left(run_state: Mapping[str, Any]) -> str:
    seconds, u, at_most = (run_state.get(key) for key in ("remaining_s", "u_remaining_s", "at_most_s"))
    if seconds is None:
        return "too early to say" + ("" if at_most is None else f", at most {_minutes(at_most)}")
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
    return rows or [["", "nothing yet: the first fit comes after some swings"]]


def _event(event: Mapping[str, Any]) -> str:
    grave = {"error": "no", "warning": "caution"}.get(str(event["level"]), "")
    at = event["elapsed_s"]
    when = str(event["at"]) if at is None else f"{float(at):.1f} s"
    text = html.escape(f"{event['kind']}: {event['text']}")
    return f"<div class='{grave}'><span class='dim'>{when}</span> {text}</div>"
