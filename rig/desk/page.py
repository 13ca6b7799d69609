"""The page: head with state and keys, alarms over everything, one panel at a time."""

import json
import time
from functools import partial

from nicegui import ui
from nicegui.events import KeyEventArguments

from rig.control import STALE_S, LatchedTrip, TripCause
from rig.desk.alarm_list import AlarmKey, AlarmRow, AlarmState
from rig.desk.desk import Desk
from rig.desk.dialogs import keys_dialog, resume_dialog, trip_dialog
from rig.desk.following import doing
from rig.desk.lighting import lamps, refusal
from rig.desk.panels import PANELS
from rig.desk.run_reader import clock
from rig.desk.sessions import last_state
from rig.desk.tab import DELIBERATE, Tab, apart, at_once
from rig.desk.tables import static
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


class AlarmBar:
    """Shows the list; a trip is acknowledged where the light is, which stands beside."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._alarms, self._tab = desk.alarming.alarms, tab
        self._resumable, self._ask_resume = desk.resumable, resume_dialog(desk, tab)
        self._shown: object = None
        self._banner = ui.element("div").classes("alarm").props('role="alert" aria-live="assertive"')
        with self._banner:
            self._title = ui.label().classes("text-weight-bold")
            self._remedy = ui.label().classes("alarm-remedy")
            ui.button("All", on_click=self.toggle).props('dense flat aria-label="All alarms, key a"')
        self._resume = tab.button("Resume …", self._resumed)
        self._resume.props('color="positive" size="lg" aria-label="Resume … the session that died"')
        self._resume.classes("full-width")
        with at_once(ui.expansion()).classes("full-width alarms").props("dense") as self._fold:
            with self._fold.add_slot("header"):
                self._counts = ui.label().props('role="status" aria-live="polite"')
            self._list = ui.column().classes("full-width")

    def toggle(self) -> None:
        """Unfold the list, or fold it."""
        self._fold.set_value(not self._fold.value)

    def refresh(self) -> list[AlarmRow]:
        """Show the list as it is now; returns the alarms that cry."""
        rows = self._alarms.rows()
        crying = [row for row in rows if row.cries]
        worst = crying[0] if crying else None
        self._title.set_text("" if worst is None else sentence(f"{worst.key}: {worst.cause}"))
        self._remedy.set_text("" if worst is None else sentence(worst.key.remedy))
        self._banner.set_visibility(worst is not None)
        died = any(row.key is AlarmKey.SESSION_DIED for row in rows)
        self._resume.set_visibility(died and self._resumable() is not None)
        if rows != self._shown:
            self._shown = rows
            self._list.clear()
            with self._list:
                self._show(rows)
        return crying

    def _show(self, rows: list[AlarmRow]) -> None:
        present = [row for row in rows if not row.earlier]
        earlier = [row for row in rows if row.earlier]
        counted = [(str(state), sum(row.state is state for row in present)) for state in AlarmState]
        told = [f"{count} {words}" for words, count in (*counted, ("from before", len(earlier))) if count]
        self._counts.set_text(f"Alarms: {', '.join(told) or 'none'}")
        for row in present:
            self._row(row)
        if earlier:
            with at_once(ui.expansion(f"{len(earlier)} from before")):
                self._tab.button("All of them seen", partial(self._seen, *(row.key for row in earlier)))
                for row in earlier:
                    self._row(row)
        if not rows:
            ui.label("nothing is wrong").classes("dim")

    def _row(self, row: AlarmRow) -> None:
        with ui.element("div").classes(f"alarm-row {row.state}").props(f'data-alarm="{row.key}"'):
            with ui.element("div"):
                again = f" ({row.times} times)" if row.times > 1 else ""
                ui.label(f"{row.key}{again}").classes("text-weight-bold")
                ui.label(f"{row.state}; {_times(row)}").classes("dim")
            ui.label(row.cause).props('aria-label="cause"')
            ui.label(row.key.remedy).props('aria-label="remedy"')
            if row.key is not AlarmKey.TRIP and row.state is not AlarmState.ACKNOWLEDGED:
                button = self._tab.button("Seen", partial(self._seen, row.key))
                button.props(f'dense outline aria-label="acknowledge {row.key}" {DELIBERATE}')

    def _resumed(self) -> None:
        if (folder := self._resumable()) is not None:
            self._ask_resume(folder)

    def _seen(self, *keys: AlarmKey) -> None:
        for key in keys:
            self._alarms.acknowledge(key)


def sentence(text: str) -> str:
    """With a capital letter."""
    return text[:1].upper() + text[1:]


def _times(row: AlarmRow) -> str:
    """Since when it is as it is."""
    cleared_s = row.cleared_s if row.state is AlarmState.CLEARED else None
    told = (("since", row.raised_s), ("cleared", cleared_s), ("seen", row.acknowledged_s))
    return ", ".join(f"{word} {clock(at)}" for word, at in told if at is not None)


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
    if (folder := desk.session_folder) is not None:
        how = last_state(folder)
        if desk.start_runs:
            is_over = how in ("complete", "stopped", "failed")
            report = f"last session {how}, its report is being made: {folder.name}"
            return report if is_over else "a session is starting or being fitted"
        if desk.started is None:
            return f"last session: {folder.name}"
        # complete are its records; what it says of fits and conditions is another matter
        more = ", with problems: see Measure" if desk.start_failed else ""
        return f"last session {how or ('failed' if desk.start_failed else 'done')}{more}: {folder.name}"
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


def build_head(off_port: int) -> None:
    """Add it to the page that is being built; `off_port` is the server of LIGHT OFF beside the event loop."""
    told = {
        "offPort": off_port,
        "dark": DARK,
        "staleS": STALE_S,
        "deadS": _DEAD_S,
        "lost": {"title": AlarmKey.DESK_LOST, "remedy": AlarmKey.DESK_LOST.remedy},
    }
    ui.add_css(static("theme.css", "desk.css"))
    scripts = static("page.js", "safety.js", "watchdog.js")
    ui.add_head_html(f"<script>window.rigDesk = {json.dumps(told)};\n{scripts}</script>")
    ui.add_body_html(static("bars.html"))
