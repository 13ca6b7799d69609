"""The page: head with state and keys, alarms over everything, one panel at a time."""

import html
import json
import time
from functools import partial

from nicegui import run, ui
from nicegui.events import KeyEventArguments

from rig.alarms import AlarmRow
from rig.control import LatchedTrip
from rig.desk.alarm_bar import AlarmBar, sentence
from rig.desk.at_once import at_once
from rig.desk.desk import Desk, Started
from rig.desk.following import doing
from rig.desk.head import build_head
from rig.desk.panels import PANELS
from rig.desk.resuming import resume_dialog
from rig.desk.safety import lamps, refusal
from rig.desk.sessions import last_state
from rig.desk.tab import DELIBERATE, Tab
from rig.instrument import Phase
from rig.presentation import loud

_LOOK_S = 0.25


def build_page(desk: Desk, off_port: int) -> None:
    """Build the page for one tab of a browser; `off_port` is where LIGHT OFF is heard beside this server."""
    tab = Tab()
    build_head(off_port)
    with ui.header().classes("items-center no-wrap"):
        ui.html("rig desk", tag="h1", sanitize=False).classes("text-weight-bold")
        simulated = ui.label("SIMULATED").classes("no")
        simulated.set_visibility(desk.config.simulated)
        state = ui.label().classes("ellipsis state").props('role="status" aria-live="polite"')
        ui.space()
        keys = ui.button("Keys", on_click=lambda: tab.press("?")).props('dense flat aria-label="Keys, key ?"')
        keys.classes("spare")

    asked: LatchedTrip | None = None

    def ask_leave() -> None:
        nonlocal asked
        # what is acknowledged is what is read, also if another trip comes meanwhile
        asked = desk.safety.trip
        if asked is not None:
            trip_text.set_text(asked.text)
            allow.set_text(f"Acknowledge trip {asked.number}")
            leave.open()

    async def acknowledged() -> None:
        leave.close()
        if (trip := asked) is not None:
            ui.notify(await run.io_bound(desk.lighting.acknowledge, trip.number))

    async def light() -> None:
        ui.notify(await run.io_bound(desk.lighting.again))

    with ui.dialog().props('aria-label="acknowledge a trip"') as leave, ui.card():
        trip_text = ui.label().classes("middle")
        ui.label("Check that nobody is in the beam path. Acknowledging lights nothing.")
        with ui.row():
            allow = tab.button("Acknowledge", acknowledged)
            allow.props(f'color="negative" {DELIBERATE}')
            ui.button("Not now", on_click=leave.close).props("outline")
    resume = resume_dialog(desk, tab)
    with ui.element("div").classes("cries"):
        alarms = AlarmBar(desk.alarming.alarms, tab, ask_leave, desk.resumable, resume)
        with ui.element("div").classes("waits") as waits:
            why_dark = ui.label()
            acknowledge = tab.button("Acknowledge …", ask_leave).props('color="negative"')
            again = tab.button("Light again", light).props(f'color="positive" {DELIBERATE}')
        instruction = ui.label().classes("instruction").props('role="alert"')
        tab.errors = ui.element("div").classes("errors full-width")
    with at_once(ui.tabs()).props("dense align=left").classes("full-width") as tabs:
        for number, panel in enumerate(PANELS, start=1):
            ui.tab(panel.name).props(f'aria-label="{panel.name}, key {number}" data-panel="{panel.name}"')
    shown = PANELS[0].name if not desk.following.running else "Measure"
    tab.shown = shown
    with ui.tab_panels(tabs, value=shown).classes("full-width").props("animated=false keep-alive") as panels:
        for panel in PANELS:
            tab.building = panel.name
            with ui.tab_panel(panel.name):
                ui.html(panel.name, tag="h2", sanitize=False).classes("unseen")
                panel.build(desk, tab)
    tab.building = ""

    def show(name: str) -> None:
        # the browser alone chooses: of two who do, one would show what the other has not
        ui.run_javascript(f"window.rigShow({json.dumps(name)})")

    def seen() -> None:
        tab.shown = str(panels.value)

    panels.on_value_change(seen)
    for number, panel in enumerate(PANELS, start=1):
        tab.key(str(number), partial(show, panel.name))
    tab.key("a", alarms.toggle)
    tab.key("?", _keys().open)

    def pressed(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            tab.press(str(event.key))

    # of what is typed into a field nothing is a key
    ui.keyboard(on_key=pressed, repeating=False, ignore=["input", "select", "textarea"])

    def refresh() -> None:
        news = desk.following.news
        run_state = news.get("state") or {}
        state.set_text(_state(desk))
        safety = desk.safety.now
        refused, waiting = refusal(safety), desk.lighting.waits
        crying = alarms.refresh(refused)
        if safety.trip is not None:
            number = safety.trip.number
            acknowledge.set_text(f"Acknowledge trip {number}{f': {refused}' if refused else ' …'}")
        acknowledge.set_visibility(safety.trip is not None)
        acknowledge.set_enabled(not refused)
        cause = (
            "The laser is dark, and waits for a person" if safety.trip is None else sentence(safety.trip.text)
        )
        why_dark.set_text(f"{cause}. Check that nobody is in the beam path.")
        waits.set_visibility(waiting or safety.trip is not None)
        # it stands where the remedy names it, also before it may be pressed
        again.set_visibility(waiting or (safety.trip is not None and desk.lighting.may_follow))
        again.set_enabled(waiting)
        again.set_text("Light again" if waiting else "Light again: once the trip is acknowledged")
        asked_for = str(run_state.get("instruction") or "")
        instruction.set_text(loud(asked_for))
        instruction.set_visibility(bool(asked_for))
        shown = json.dumps(lamps(desk.safety, _recording(desk)))
        cry = json.dumps(" ".join(_name(row) for row in crying))
        told = json.dumps([_told(row) for row in crying])
        of_session = json.dumps(_session_age(desk))
        ui.run_javascript(f"window.rigSafety({shown}, {cry}); window.rigAlarms({told}, {of_session});")

    refresh()
    ui.timer(_LOOK_S, refresh)


def _name(row: AlarmRow) -> str:
    """One that comes again has another one."""
    return f"{row.key}@{row.raised_s:.2f}"


def _told(row: AlarmRow) -> dict[str, str]:
    """As the browser is told of it."""
    text = f"{row.cause}\n{row.alarm.remedy}"
    return {"name": _name(row), "key": row.key, "title": row.alarm.title, "text": text}


def _session_age(desk: Desk) -> dict[str, object] | None:
    """How old what is shown of the session is; None without one."""
    following = desk.following
    if following.folder is None or not following.news:
        return None
    age_s = time.monotonic() - following.heard_s
    at = time.strftime("%H:%M:%S", time.localtime(time.time() - age_s))
    return {"who": f"session {following.folder.name}", "age_s": round(age_s, 2), "at": at}


def _state(desk: Desk) -> str:
    following = desk.following
    if following.silent:
        return f"{following.folder and following.folder.name}: does not answer at the moment"
    if following.folder is not None:
        phase = doing(following.news.get("state"))
        return f"{following.folder.name} · {following.news.get('run') or 'session'} · {phase or 'preparing'}"
    if desk.session_state is Started.RUNNING:
        folder = desk.session_folder
        how = "" if folder is None else last_state(folder)
        if folder is not None and how in ("complete", "stopped", "failed"):
            return f"last session {how}, its report is being made: {folder.name}"
        return "a session is starting or being fitted"
    if desk.session_state and desk.session_folder is not None:
        how = last_state(desk.session_folder) or str(desk.session_state)
        # complete are its records; what it says of fits and conditions is another matter
        more = ", with problems: see Measure" if desk.session_state is Started.FAILED else ""
        return f"last session {how}{more}: {desk.session_folder.name}"
    if desk.session_folder is not None:
        return f"last session: {desk.session_folder.name}"
    running = [name for name, job in desk.jobs.items() if job.running and "preflight" not in job.newest]
    return f"rig {', '.join(running)} runs" if running else f"ready · {desk.source.name}"


def _recording(desk: Desk) -> str:
    """What is being recorded; empty if nothing is."""
    news = desk.following.news
    if desk.following.running:
        return str(news.get("run") or "") if (news.get("state") or {}).get("phase") == Phase.MEASURING else ""
    return next((name for name, job in desk.jobs.items() if job.running and name.startswith("camera")), "")


def _keys() -> ui.dialog:
    panels = [
        f"<tr><th>{number}</th><td>{panel.name}</td></tr>" for number, panel in enumerate(PANELS, start=1)
    ]
    others = [("a", "the alarms"), ("F9", "LIGHT OFF"), ("?", "this list")]
    others += [entry for panel in PANELS for entry in panel.keys]
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in others]
    with ui.dialog().props('aria-label="keys"') as dialog, ui.card():
        ui.label("Keys").classes("middle")
        ui.html(f"<table class='rows'>{''.join(panels + lines)}</table>", sanitize=False)
    return dialog
