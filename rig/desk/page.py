"""The page: head with state and keys, alarms over everything, one panel at a time."""

import html
import json
import time
from functools import partial

from nicegui import ui
from nicegui.events import KeyEventArguments

from rig.control import STALE_S
from rig.desk.alarm_list import AlarmKey, AlarmRow
from rig.desk.desk import Desk
from rig.desk.dialogs import keys_dialog
from rig.desk.header import build_header
from rig.desk.lighting import lamps
from rig.desk.panels import PANELS
from rig.desk.panels.runs import rerun_address
from rig.desk.sessions import last_state
from rig.desk.tab import Tab
from rig.desk.tables import static
from rig.instrument import Phase

_LOOK_S = 0.25


def build_page(desk: Desk, off_port: int) -> None:
    """Build the page for one tab of a browser; `off_port` is where LIGHT OFF is heard beside this server."""
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

    async def pressed(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            await tab.press(str(event.key))

    # of what is typed into a field nothing is a key
    ui.keyboard(on_key=pressed, repeating=False, ignore=["input", "select", "textarea"])

    _tell_bars(desk)


def build_rerun(desk: Desk, off_port: int) -> None:
    """Build the page around Rerun's own, which does not say that nothing comes any more."""
    _build_bars(off_port)
    ui.html("Rerun", tag="h1", sanitize=False).classes("unseen")
    address = rerun_address(desk)
    gone = "not connected: rig view has ended"
    Tab().label(lambda: "" if rerun_address(desk) == address != "" else gone, "advice no", 'role="alert"')
    if address:
        # what it has shown last stays
        ui.html(f"<iframe title='Rerun' src='{html.escape(address)}'></iframe>", sanitize=False)
    _tell_bars(desk)


def _tell_bars(desk: Desk) -> None:
    """Tell the safety bar, and the line of what is late, some times a second."""

    def refresh() -> None:
        shown = json.dumps(lamps(desk.safety, _recording(desk)))
        alarms = json.dumps([_alarm_values(row) for row in desk.alarming.alarms.rows() if row.cries])
        of_session = json.dumps(_session_age(desk))
        ui.run_javascript(f"window.rigSafety({shown}, {alarms}); window.rigAlarms({alarms}, {of_session});")

    refresh()
    ui.timer(_LOOK_S, refresh)


def _build_panels(desk: Desk, tab: Tab) -> None:
    """The names of the panels, and one panel at a time; a number shows one, too."""
    with ui.tabs().props("dense align=left").classes("full-width") as tabs:
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


def _alarm_values(row: AlarmRow) -> dict[str, str]:
    """Values of an alarm for the browser; an alarm that is raised again has another name."""
    name = f"{row.key}@{row.raised_s:.2f}"
    return {"name": name, "title": row.key, "text": f"{row.cause}\n{row.key.remedy}"}


def _session_age(desk: Desk) -> dict[str, object] | None:
    """Age of the news of the session that the page shows; None without a session."""
    following = desk.following
    if following.folder is None or not following.news:
        return None
    age_s = time.monotonic() - following.heard_s
    return {"who": f"session {following.folder.name}", "age_s": round(age_s, 2)}


def _state(desk: Desk) -> str:
    following = desk.following
    if following.frozen:
        return f"{following.folder and following.folder.name}: does not answer at the moment"
    if following.folder is not None:
        phase = following.doing
        return f"{following.folder.name} · {following.news.get('run') or 'session'} · {phase or 'preparing'}"
    running = [name for name, job in desk.jobs.running(uses_camera=True) if "preflight" not in job.newest]
    if running:
        return f"rig {', '.join(running)} runs"
    if desk.starting:
        return "a session is starting"
    if (folder := desk.session_folder) is not None:
        how = last_state(folder)
        if desk.following.fits_last:
            is_over = how in ("complete", "stopped", "failed")
            report = f"last session {how}, its report is being made: {folder.name}"
            return report if is_over else "a session is starting or being fitted"
        # complete are its records; what it says of fits and conditions is another matter
        more = ", with problems: see Measure" if desk.start_failed else ""
        return f"{f'last session {how}'.rstrip()}{more}: {folder.name}"
    return f"ready · {desk.source.name}"


def _recording(desk: Desk) -> str:
    """Text on the present recording; empty without one."""
    following = desk.following
    is_measuring = following.running and following.state.get("phase") == Phase.MEASURING
    return str(following.news.get("run") or "") if is_measuring else ""


def _keys() -> list[tuple[str, str]]:
    panels = [(str(number), panel.name) for number, panel in enumerate(PANELS, start=1)]
    own = [entry for panel in PANELS for entry in panel.keys]
    return [*panels, ("a", "the alarms"), ("F9", "LIGHT OFF"), ("?", "this list"), *own]


DARK = "/dark"
"""Where LIGHT OFF is sent to, at both servers."""
DEAD_S = 30.0
"""Time without news after which a page is disconnected, not only slow; the desk keeps it as long."""


def _build_bars(off_port: int) -> None:
    """Add the safety bar and the line of what is late; `off_port` is the separate server of LIGHT OFF."""
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
