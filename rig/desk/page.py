"""The page: head with state and keys, alarms above everything, one panel at a time, the safety bar."""

import html
import json
import time
from functools import partial

from nicegui import ui
from nicegui.events import KeyEventArguments

from rig.control import STALE_S
from rig.desk.alarm_list import AlarmKey
from rig.desk.desk import Desk
from rig.desk.dialogs import keys_dialog
from rig.desk.follower import phase_text
from rig.desk.header import build_header
from rig.desk.lighting import lamps
from rig.desk.panels import PANELS
from rig.desk.panels.runs import rerun_address
from rig.desk.sessions import last_state
from rig.desk.tab import Tab
from rig.desk.tables import static
from rig.instrument import Phase

_BARS_INTERVAL_S = 0.25
DARK = "/dark"
"""Path of LIGHT OFF at both servers."""
DEAD_S = 30.0
"""Time without news after which a page is disconnected, not only slow; the desk keeps it as long."""


def build_page(desk: Desk, off_port: int) -> None:
    """Build the page for one tab of a browser; `off_port` is that of the separate server of LIGHT OFF."""
    tab = Tab()
    _build_bars(off_port)
    with ui.header().classes("items-center no-wrap"):
        ui.html("rig desk", tag="h1", sanitize=False).classes("text-weight-bold")
        ui.label("SIMULATED").classes("no").set_visibility(desk.config.simulated)
        tab.label(lambda: _state(desk), "ellipsis state", 'role="status" aria-live="polite"')
        ui.space()
        keys = ui.button("Keys", on_click=lambda: tab.press("?")).props('dense flat aria-label="Keys, key ?"')
        keys.classes("spare")
    toggle = build_header(desk, tab)
    _build_panels(desk, tab)
    tab.key("a", toggle)
    tab.key("?", keys_dialog(_keys()).open)

    async def on_key(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            await tab.press(str(event.key))

    # characters typed into a field are no keys
    ui.keyboard(on_key=on_key, repeating=False, ignore=["input", "select", "textarea"])

    _refresh_bars(desk)


def build_rerun(desk: Desk, off_port: int) -> None:
    """Build the page around Rerun's own, which does not say when its server has ended."""
    _build_bars(off_port)
    ui.html("Rerun", tag="h1", sanitize=False).classes("unseen")
    address = rerun_address(desk)
    ended = "not connected: rig view has ended"
    Tab().label(lambda: "" if rerun_address(desk) == address != "" else ended, "advice no", 'role="alert"')
    if address:
        # the last picture stays
        ui.html(f"<iframe title='Rerun' src='{html.escape(address)}'></iframe>", sanitize=False)
    _refresh_bars(desk)


def _refresh_bars(desk: Desk) -> None:
    """Send the values of the safety bar and of the watchdog to the browser some times a second."""

    def refresh() -> None:
        lamp_values = json.dumps(lamps(desk.safety, _recording(desk)))
        # an alarm that is raised again has another name
        loud = [f"{row.key}@{row.raised_s:.2f}" for row in desk.alarming.alarms.rows() if row.is_loud]
        alarms, session = json.dumps(" ".join(loud)), json.dumps(_session_age(desk))
        ui.run_javascript(f"window.rigSafety({lamp_values}, {alarms}); window.rigNews({session});")

    refresh()
    ui.timer(_BARS_INTERVAL_S, refresh)


def _build_panels(desk: Desk, tab: Tab) -> None:
    """Build the names of the panels, and one panel at a time; a key of each number shows a panel."""
    with ui.tabs().props("dense align=left").classes("full-width") as tabs:
        for number, panel in enumerate(PANELS, start=1):
            ui.tab(panel.name).props(f'aria-label="{panel.name}, key {number}" data-panel="{panel.name}"')
    tab.panel = "Measure" if desk.follower.running else PANELS[0].name
    panels = ui.tab_panels(tabs, value=tab.panel).classes("full-width").props("animated=false keep-alive")
    with panels:
        for panel in PANELS:
            tab.building = panel.name
            with ui.tab_panel(panel.name):
                ui.html(panel.name, tag="h2", sanitize=False).classes("unseen")
                panel.build(desk, tab)
    tab.building = ""

    def show(name: str) -> None:
        # the browser alone chooses, so that it never shows another panel than it has chosen
        ui.run_javascript(f"window.rigShow({json.dumps(name)})")

    def note_panel() -> None:
        tab.panel = str(panels.value)

    panels.on_value_change(note_panel)
    for number, panel in enumerate(PANELS, start=1):
        tab.key(str(number), partial(show, panel.name))


def _session_age(desk: Desk) -> dict[str, object] | None:
    """Age of the news of the session that the page shows; None without a session."""
    follower = desk.follower
    if follower.folder is None or not follower.news:
        return None
    age_s = time.monotonic() - follower.news_s
    return {"who": f"session {follower.folder.name}", "age_s": round(age_s, 2)}


def _state(desk: Desk) -> str:
    follower = desk.follower
    if follower.frozen:
        return f"{follower.folder and follower.folder.name}: does not answer at the moment"
    if follower.folder is not None:
        phase = phase_text(follower.state) or "preparing"
        return f"{follower.folder.name} · {follower.news.get('run') or 'session'} · {phase}"
    commands = [name for name, job in desk.jobs.running(uses_camera=True) if "preflight" not in job.newest]
    if commands:
        return f"rig {', '.join(commands)} runs"
    if desk.starting:
        return "a session is starting"
    if (folder := desk.session_folder) is not None:
        state = last_state(folder)
        if desk.follower.is_fitting_last:
            if state not in ("complete", "stopped", "failed"):
                return "a session is starting or being fitted"
            return f"last session {state}, its report is being made: {folder.name}"
        # all records may be complete, and a fit or a condition have failed
        problems = ", with problems: see Measure" if desk.start_failed else ""
        return f"{f'last session {state}'.rstrip()}{problems}: {folder.name}"
    return f"ready · {desk.source.name}"


def _recording(desk: Desk) -> str:
    """Name of the run that is being recorded; empty without one."""
    follower = desk.follower
    is_measuring = follower.running and follower.state.get("phase") == Phase.MEASURING
    return str(follower.news.get("run") or "") if is_measuring else ""


def _keys() -> list[tuple[str, str]]:
    panels = [(str(number), panel.name) for number, panel in enumerate(PANELS, start=1)]
    own = [entry for panel in PANELS for entry in panel.keys]
    return [*panels, ("a", "the alarms"), ("F9", "LIGHT OFF"), ("?", "this list"), *own]


def _build_bars(off_port: int) -> None:
    """Add the safety bar and the watchdog."""
    script_values = {
        "offPort": off_port,
        "dark": DARK,
        "staleS": STALE_S,
        "deadS": DEAD_S,
        "lost": {"title": AlarmKey.DESK_LOST, "remedy": AlarmKey.DESK_LOST.remedy},
    }
    ui.add_css(static("theme.css", "desk.css"))
    scripts = static("page.js", "safety.js", "watchdog.js")
    ui.add_head_html(f"<script>window.rigDesk = {json.dumps(script_values)};\n{scripts}</script>")
    ui.add_body_html(static("bars.html"))
