"""The page: head with state and keys, alarms over everything, one panel at a time."""

import html
from functools import partial

from nicegui import ui
from nicegui.events import KeyEventArguments

from rig.desk.desk import Desk, Started
from rig.desk.following import doing
from rig.desk.panels import PANELS
from rig.desk.tab import Tab
from rig.desk.theme import NIGHT, SCRIPT, STYLE

_LOOK_S = 0.25


def build_page(desk: Desk) -> None:
    """Build the page for one tab of a browser."""
    tab = Tab(desk)
    ui.add_css(STYLE)
    ui.add_head_html(f"<script>{SCRIPT}</script>")
    ui.add_body_html(NIGHT)
    if not desk.somebody_acts:
        desk.take(tab.name)
    ui.context.client.on_delete(lambda: desk.leave(tab.name))
    with ui.header().classes("items-center no-wrap"):
        ui.label("rig desk").classes("text-weight-bold")
        simulated = ui.label("SIMULATED").classes("no")
        simulated.set_visibility(desk.config.simulated)
        state = ui.label().classes("ellipsis").props('role="status" aria-live="polite"')
        ui.space()
        acting = ui.label().classes("dim")
        take = ui.button("Take over", on_click=lambda: desk.take(tab.name)).props("dense outline")
        ui.button("Night", on_click=_night).props('dense flat aria-label="red night theme, key n"')
        ui.button("Keys", on_click=lambda: tab.press("?")).props('dense flat aria-label="keys, key ?"')
    with ui.element("div").classes("cries"):
        alarm = ui.label().classes("alarm").props('role="alert" aria-live="assertive"')
        acknowledge = ui.button("Acknowledge: nobody is in the beam's way, light is allowed again (key a)")
        acknowledge.props('color="negative" size="lg"').classes("full-width")
        instruction = ui.label().classes("instruction").props('role="alert"')
    with ui.tabs().props("dense align=left").classes("full-width") as tabs:
        for number, panel in enumerate(PANELS, start=1):
            ui.tab(panel.name).props(f'aria-label="{panel.name}, key {number}"')
    shown = PANELS[0].name if not desk.following.running else "Measure"
    tab.shown = shown
    with ui.tab_panels(tabs, value=shown).classes("full-width").props("animated=false keep-alive") as panels:
        for panel in PANELS:
            tab.building = panel.name
            with ui.tab_panel(panel.name):
                panel.build(desk, tab)
    tab.building = ""

    def show(name: str) -> None:
        panels.set_value(name)

    def seen() -> None:
        tab.shown = str(panels.value)

    panels.on_value_change(seen)
    for number, panel in enumerate(PANELS, start=1):
        tab.key(str(number), partial(show, panel.name))
    tab.key("n", _night)
    confirm = tab.act(lambda: ui.notify(desk.acknowledge()))
    acknowledge.on_click(confirm)
    tab.key("a", confirm)
    tab.key("?", _keys().open)

    def pressed(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            tab.press(str(event.key))

    # of what is typed into a field nothing is a key
    ui.keyboard(on_key=pressed, repeating=False, ignore=["input", "select", "textarea"])
    sounding = False

    def refresh() -> None:
        nonlocal sounding
        if not desk.somebody_acts:
            desk.take(tab.name)
        acting.set_text("" if tab.acts else "this tab watches")
        take.set_visibility(not tab.acts)
        news = desk.following.news
        told = news.get("state") or {}
        state.set_text(_state(desk))
        cry, waits = str(told.get("alarm") or ""), desk.unacknowledged
        cry = cry or ("" if waits is None else waits.opened_text)
        alarm.set_text(cry.upper())
        alarm.set_visibility(bool(cry))
        acknowledge.set_visibility(bool(waits))
        asked = str(told.get("instruction") or "")
        instruction.set_text(asked.upper())
        instruction.set_visibility(bool(asked))
        if bool(cry) != sounding:
            sounding = bool(cry)
            ui.run_javascript(f"window.rigAlarm({str(sounding).lower()})")

    refresh()
    ui.timer(_LOOK_S, refresh)


def _state(desk: Desk) -> str:
    following = desk.following
    if following.silent:
        return f"{following.folder and following.folder.name}: does not answer at the moment"
    if following.folder is not None:
        phase = doing(following.news.get("state"))
        return f"{following.folder.name} · {following.news.get('run') or 'session'} · {phase or 'preparing'}"
    if desk.session_state is Started.RUNNING:
        return "a session begins, or is fitted"
    if desk.session_state:
        return f"last session {desk.session_state}: {desk.session_folder and desk.session_folder.name}"
    if desk.session_folder is not None:
        return f"last session: {desk.session_folder.name}"
    running = [name for name, job in desk.jobs.items() if job.running]
    return f"rig {', '.join(running)} runs" if running else f"ready · {desk.source.name}"


def _night() -> None:
    ui.run_javascript("window.rigNight(!document.documentElement.classList.contains('night'))")


def _keys() -> ui.dialog:
    panels = [
        f"<tr><th>{number}</th><td>{panel.name}</td></tr>" for number, panel in enumerate(PANELS, start=1)
    ]
    others = [("n", "red night theme"), ("a", "acknowledge an interlock")]
    others += [entry for panel in PANELS for entry in panel.keys]
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in others]
    with ui.dialog() as dialog, ui.card():
        ui.html(f"<table class='rows'>{''.join(panels + lines)}</table>", sanitize=False)
    return dialog
