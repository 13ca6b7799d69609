"""The page: head with state and keys, alarms over everything, one panel at a time."""

import json
import time
from functools import partial
from pathlib import Path

from nicegui import ui
from nicegui.events import KeyEventArguments

from rig.control import STALE_S, LatchedTrip, TripCause
from rig.desk.alarm_bar import AlarmBar, sentence
from rig.desk.alarm_list import AlarmKey, AlarmRow
from rig.desk.desk import Desk, StartState
from rig.desk.dialogs import keys_dialog, trip_dialog
from rig.desk.following import doing
from rig.desk.lighting import lamps, refusal
from rig.desk.panels import PANELS
from rig.desk.sessions import last_state
from rig.desk.tab import DELIBERATE, Tab, apart, at_once
from rig.instrument import Phase
from rig.presentation import loud

_LOOK_S = 0.25


def build_page(desk: Desk, off_port: int) -> None:
    """Build the page for one tab of a browser; `off_port` is where LIGHT OFF is heard beside this server."""
    tab = Tab()
    build_head(off_port)
    with ui.header().classes("items-center no-wrap"):
        ui.html("rig desk", tag="h1", sanitize=False).classes("text-weight-bold")
        ui.label("SIMULATED").classes("no").set_visibility(desk.config.simulated)
        state = ui.label().classes("ellipsis state").props('role="status" aria-live="polite"')
        ui.space()
        keys = ui.button("Keys", on_click=lambda: tab.press("?")).props('dense flat aria-label="Keys, key ?"')
        keys.classes("spare")
    over_all = PageHeader(desk, tab)
    _build_panels(desk, tab)
    tab.key("a", over_all.alarms.toggle)
    tab.key("?", keys_dialog(_keys()).open)

    def pressed(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            tab.press(str(event.key))

    # of what is typed into a field nothing is a key
    ui.keyboard(on_key=pressed, repeating=False, ignore=["input", "select", "textarea"])

    def refresh() -> None:
        state.set_text(_state(desk))
        crying = over_all.refresh()
        shown = json.dumps(lamps(desk.safety, _recording(desk)))
        told = json.dumps([_told(row) for row in crying])
        of_session = json.dumps(_session_age(desk))
        ui.run_javascript(f"window.rigSafety({shown}, {told}); window.rigAlarms({told}, {of_session});")

    refresh()
    ui.timer(_LOOK_S, refresh)


class PageHeader:
    """What stands above every panel: alarms, light that waits for a person, a request, errors."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        ask = trip_dialog(desk, tab)
        with ui.element("div").classes("cries"):
            self.alarms = AlarmBar(desk, tab)
            with ui.element("div").classes("waits") as self._waits:
                self._why_dark = ui.label()
                self._acknowledge = tab.button("Acknowledge …", ask).props('color="negative"')
                self._again = tab.button("Light again", apart(desk.lighting.again))
                self._again.props(f'color="positive" {DELIBERATE}')
            self._instruction = ui.label().classes("instruction").props('role="alert"')
            tab.errors = ui.element("div").classes("errors full-width")

    def refresh(self) -> list[AlarmRow]:
        """Show what holds now; returns the alarms that cry."""
        desk, trip = self._desk, self._desk.safety.trip
        refused, waiting = refusal(desk.safety.now), desk.lighting.waits
        if trip is not None:
            self._acknowledge.set_text(f"Acknowledge trip {trip.number}{f': {refused}' if refused else ' …'}")
        self._acknowledge.set_visibility(trip is not None)
        self._acknowledge.set_enabled(not refused)
        cause = "The laser is dark, and waits for a person" if trip is None else _taken(trip)
        self._why_dark.set_text(f"{cause}. Check that nobody is in the beam path.")
        self._waits.set_visibility(waiting or trip is not None)
        # it stands where the remedy names it, also before it may be pressed
        self._again.set_visibility(waiting or (trip is not None and desk.lighting.may_follow))
        self._again.set_enabled(waiting)
        self._again.set_text("Light again" if waiting else "Light again: once the trip is acknowledged")
        asked_for = str((desk.following.news.get("state") or {}).get("instruction") or "")
        self._instruction.set_text(loud(asked_for))
        self._instruction.set_visibility(bool(asked_for))
        return self.alarms.refresh()


def _build_panels(desk: Desk, tab: Tab) -> None:
    """The names of the panels, and one panel at a time; a number shows one, too."""
    with at_once(ui.tabs()).props("dense align=left").classes("full-width") as tabs:
        for number, panel in enumerate(PANELS, start=1):
            ui.tab(panel.name).props(f'aria-label="{panel.name}, key {number}" data-panel="{panel.name}"')
    tab.shown = PANELS[0].name if not desk.following.running else "Measure"
    panels = ui.tab_panels(tabs, value=tab.shown).classes("full-width").props("animated=false keep-alive")
    with panels:
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


def _taken(trip: LatchedTrip) -> str:
    """Who or what has taken the light; what a person has done needs no number."""
    return sentence(trip.why if trip.cause is TripCause.PERSON else trip.text)


def _told(row: AlarmRow) -> dict[str, str]:
    """As the browser is told of it; one that comes again has another name."""
    name = f"{row.key}@{row.raised_s:.2f}"
    return {"name": name, "title": row.key, "text": f"{row.cause}\n{row.key.remedy}"}


def _session_age(desk: Desk) -> dict[str, object] | None:
    """How old what is shown of the session is; None without one."""
    following = desk.following
    if following.folder is None or not following.news:
        return None
    age_s = time.monotonic() - following.heard_s
    return {"who": f"session {following.folder.name}", "age_s": round(age_s, 2)}


def _state(desk: Desk) -> str:
    following = desk.following
    if following.silent:
        return f"{following.folder and following.folder.name}: does not answer at the moment"
    if following.folder is not None:
        phase = doing(following.news.get("state"))
        return f"{following.folder.name} · {following.news.get('run') or 'session'} · {phase or 'preparing'}"
    if desk.session_state is StartState.RUNNING:
        folder = desk.session_folder
        how = "" if folder is None else last_state(folder)
        if folder is not None and how in ("complete", "stopped", "failed"):
            return f"last session {how}, its report is being made: {folder.name}"
        return "a session is starting or being fitted"
    if desk.session_state and desk.session_folder is not None:
        how = last_state(desk.session_folder) or str(desk.session_state)
        # complete are its records; what it says of fits and conditions is another matter
        more = ", with problems: see Measure" if desk.session_state is StartState.FAILED else ""
        return f"last session {how}{more}: {desk.session_folder.name}"
    if desk.session_folder is not None:
        return f"last session: {desk.session_folder.name}"
    running = [name for name, job in desk.jobs.running(uses_camera=True) if "preflight" not in job.newest]
    return f"rig {', '.join(running)} runs" if running else f"ready · {desk.source.name}"


def _recording(desk: Desk) -> str:
    """What is being recorded; empty if nothing is."""
    news = desk.following.news
    if desk.following.running:
        return str(news.get("run") or "") if (news.get("state") or {}).get("phase") == Phase.MEASURING else ""
    return next((name for name, _ in desk.jobs.running(uses_camera=True) if name.startswith("camera")), "")


def _keys() -> list[tuple[str, str]]:
    panels = [(str(number), panel.name) for number, panel in enumerate(PANELS, start=1)]
    own = [entry for panel in PANELS for entry in panel.keys]
    return [*panels, ("a", "the alarms"), ("F9", "LIGHT OFF"), ("?", "this list"), *own]


DARK = "/dark"
"""Where LIGHT OFF is sent to, at both servers."""
_DEAD_S = 30.0
"""A page that was told nothing for so long is not merely slow."""
_STATIC = Path(__file__).with_name("static")
_STYLES = ("theme.css", "desk.css")
_SCRIPTS = ("page.js", "safety.js", "watchdog.js")
_BARS = """
<div id="watchdog" role="alert" aria-live="assertive" hidden></div>
<div id="safety" role="region" aria-label="safety">
  <button id="light-off" type="button" aria-label="light off, key F9">LIGHT OFF</button>
  <span class="lamp" id="lamp-laser" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-interlock" role="status" aria-live="polite"></span>
  <span class="lamp" id="lamp-recording"></span>
  <span class="lamp" id="lamp-age"></span>
  <span id="off-said" role="status" aria-live="assertive"></span>
  <button id="silence" type="button" hidden>Silence</button>
</div>
"""


def build_head(off_port: int) -> None:
    """Add it to the page that is being built; `off_port` is the server of LIGHT OFF beside the event loop."""
    told = {
        "offPort": off_port,
        "dark": DARK,
        "staleS": STALE_S,
        "deadS": _DEAD_S,
        "lost": {"title": AlarmKey.DESK_LOST, "remedy": AlarmKey.DESK_LOST.remedy},
    }
    styles, scripts = (
        "".join((_STATIC / name).read_text("utf-8") for name in names) for names in (_STYLES, _SCRIPTS)
    )
    ui.add_css(styles)
    ui.add_head_html(f"<script>window.rigDesk = {json.dumps(told)};\n{scripts}</script>")
    ui.add_body_html(_BARS)
