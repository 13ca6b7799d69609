"""The page: head with state and keys, alarms over everything, one panel at a time; and how it looks."""

import html
import json
from functools import partial

from nicegui import run, ui
from nicegui.events import KeyEventArguments

from rig.control import LatchedTrip
from rig.desk import safety_bar
from rig.desk.desk import Desk, Started
from rig.desk.following import doing
from rig.desk.panels import PANELS
from rig.desk.safety import lamps
from rig.desk.tab import DELIBERATE, Tab
from rig.instrument import Phase
from rig.presentation import palette

_LOOK_S = 0.25


def build_page(desk: Desk, off_port: int) -> None:
    """Build the page for one tab of a browser; `off_port` is where LIGHT OFF is heard beside this server."""
    tab = Tab(desk)
    ui.add_css(STYLE + safety_bar.STYLE)
    ui.add_head_html(f"<script>{SCRIPT}{safety_bar.script(off_port)}</script>")
    ui.add_body_html(NIGHT + safety_bar.BAR)
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
            ui.notify(await run.io_bound(desk.acknowledge, trip.number))

    async def light() -> None:
        ui.notify(await run.io_bound(desk.light))

    with ui.dialog() as leave, ui.card():
        trip_text = ui.label().classes("middle")
        ui.label("Look that nobody is in the beam's way. Acknowledging lights nothing.")
        with ui.row():
            allow = ui.button("Acknowledge", on_click=tab.act(acknowledged))
            allow.props(f'color="negative" {DELIBERATE}')
            ui.button("Not now", on_click=leave.close).props("outline")
    with ui.element("div").classes("cries"):
        alarm = ui.label().classes("alarm").props('role="alert" aria-live="assertive"')
        acknowledge = ui.button("Acknowledge …", on_click=tab.act(ask_leave))
        acknowledge.props('color="negative" size="lg"').classes("full-width")
        again = ui.button("Light again", on_click=tab.act(light)).props(f'size="lg" {DELIBERATE}')
        again.classes("full-width")
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
    tab.key("?", _keys().open)

    def pressed(event: KeyEventArguments) -> None:
        if event.action.keydown and not (event.modifiers.ctrl or event.modifiers.alt or event.modifiers.meta):
            tab.press(str(event.key))

    # of what is typed into a field nothing is a key
    ui.keyboard(on_key=pressed, repeating=False, ignore=["input", "select", "textarea"])

    def refresh() -> None:
        if not desk.somebody_acts:
            desk.take(tab.name)
        acting.set_text("" if tab.acts else "this tab watches")
        take.set_visibility(not tab.acts)
        news = desk.following.news
        run_state = news.get("state") or {}
        state.set_text(_state(desk))
        safety = desk.safety.now
        cry = str(run_state.get("alarm") or "")
        if safety.trip is not None:
            cry = safety.trip.text
            acknowledge.set_text(f"Acknowledge trip {safety.trip.number} …")
        alarm.set_text(cry.upper())
        alarm.set_visibility(bool(cry))
        acknowledge.set_visibility(safety.trip is not None)
        again.set_visibility(desk.waits_for_light)
        told = str(run_state.get("instruction") or "")
        instruction.set_text(told.upper())
        instruction.set_visibility(bool(told))
        shown = json.dumps(lamps(safety, _recording(desk)))
        ui.run_javascript(f"window.rigSafety({shown}, {json.dumps(cry)})")

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


def _recording(desk: Desk) -> str:
    """What is being recorded; empty if nothing is."""
    news = desk.following.news
    if desk.following.running:
        return str(news.get("run") or "") if (news.get("state") or {}).get("phase") == Phase.MEASURING else ""
    return next((name for name, job in desk.jobs.items() if job.running and name.startswith("camera")), "")


def _night() -> None:
    ui.run_javascript("window.rigNight(!document.documentElement.classList.contains('night'))")


def _keys() -> ui.dialog:
    panels = [
        f"<tr><th>{number}</th><td>{panel.name}</td></tr>" for number, panel in enumerate(PANELS, start=1)
    ]
    others = [("n", "red night theme"), ("F9", "LIGHT OFF")]
    others += [entry for panel in PANELS for entry in panel.keys]
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in others]
    with ui.dialog() as dialog, ui.card():
        ui.html(f"<table class='rows'>{''.join(panels + lines)}</table>", sanitize=False)
    return dialog


STYLE = f"""
:root {{ color-scheme: dark; --ink: #e8e8e8; --dim: #9aa4ad; --ground: #0e1113; --card: #181d21;
  --go: {palette.BLUISH_GREEN}; --warn: {palette.ORANGE}; --no: {palette.VERMILLION};
  --line: {palette.SKY_BLUE}; }}
html.night {{ filter: url(#night); }}
body {{ background: var(--ground); color: var(--ink); font-size: 16px; }}
.q-header {{ background: var(--card) !important; min-height: 40px; padding: 2px 12px !important;
  align-items: center !important; }}
.q-page, .q-tab-panels, .q-tab-panel {{ background: var(--ground) !important; color: var(--ink); }}
.q-tab-panel {{ padding: 6px 10px; }}
.nicegui-content {{ padding: 0; gap: 4px; }} .box {{ gap: 6px; }} .q-tab-panel > * {{ gap: 8px; }}
.q-tab-panel {{ gap: 8px; }}
.box {{ background: var(--card); border-radius: 6px; padding: 10px 12px; }}
.title {{ color: var(--dim); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }}
.large {{ font-size: 76px; line-height: 1; font-variant-numeric: tabular-nums; font-weight: 600; }}
.middle {{ font-size: 30px; line-height: 1.2; font-variant-numeric: tabular-nums; }}
.two, .three {{ display: grid; gap: 8px; width: 100%; grid-template-columns: minmax(0, 2fr) minmax(0, 1fr); }}
.three {{ grid-template-columns: minmax(0, 1.25fr) minmax(0, 1fr) minmax(0, 1fr); }}
.two.half {{ grid-template-columns: repeat(2, minmax(0, 1fr)); }}
.three.even {{ grid-template-columns: repeat(3, minmax(0, 1fr)); }}
@media (max-width: 900px) {{
  .two, .three, .two.half, .three.even {{ grid-template-columns: minmax(0, 1fr); }} }}
html.dead .q-tab-panels, html.dead .cries, html.dead .q-header {{ opacity: .35; }}
.cries {{ position: sticky; top: 40px; z-index: 1000; width: 100%; }}
.why-none {{ font-size: 20px; text-align: center; width: 80%; }}
.rows {{ border-collapse: collapse; width: 100%; font-size: 14px; line-height: 1.3;
  font-variant-numeric: tabular-nums; }}
.rows td, .rows th {{ padding: 2px 8px 2px 0; vertical-align: top; text-align: left; font-weight: 400; }}
.rows .judged {{ white-space: nowrap; width: 1%; }}
.rows th {{ color: var(--dim); white-space: nowrap; }}
.dim {{ color: var(--dim); }} .go {{ color: var(--go); }} .caution {{ color: var(--warn); }}
.no {{ color: var(--no); font-weight: 700; }}
.light {{ display: inline-block; width: 12px; height: 12px; border-radius: 6px; margin-right: 6px; }}
.alarm {{ background: {palette.VERMILLION}; color: #000; font-size: 26px; font-weight: 700; padding: 8px 14px;
  animation: flash 1s steps(2, jump-none) infinite; width: 100%; }}
.instruction {{ background: {palette.YELLOW}; color: #000; font-size: 30px; font-weight: 700;
  padding: 8px 14px; width: 100%; }}
@keyframes flash {{ from {{ opacity: 1 }} to {{ opacity: .55 }} }}
@media (prefers-reduced-motion: reduce) {{ .alarm {{ animation: none; }} }}
.events {{ font-size: 14px; max-height: 190px; overflow-y: auto; width: 100%; }}
svg text {{ fill: var(--dim); font-size: 12px; }}
.text-negative, .q-field--error .q-field__messages {{ color: #ff8a65 !important; }}
.picture {{ background: #000; }} .picture img {{ image-rendering: pixelated; touch-action: none; }}
:focus-visible {{ outline: 2px solid var(--line); outline-offset: 2px; }}
"""

NIGHT = """
<svg width="0" height="0" style="position: absolute" aria-hidden="true"><filter id="night"
  color-interpolation-filters="sRGB"><feColorMatrix values=".55 .55 .3 0 0  0 0 0 0 0  0 0 0 0 0  0 0 0 1 0"/>
</filter></svg>
"""
"""Turns the brightness of everything on the page into red, the pictures of the camera included."""

SCRIPT = """
window.rigNight = function (on) {
  document.documentElement.classList.toggle('night', on);
  localStorage.setItem('night', on ? '1' : '');
};
window.rigNight(localStorage.getItem('night') === '1');
"""
