"""Measure panel: start a session, watch it from a distance, brake, stop; last result, next session."""

from nicegui import run, ui

from processing.errors import RigError
from rig.control import STALE_S
from rig.desk import charts, tables
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.dialogs import Question
from rig.desk.panels import run_texts
from rig.desk.panels.between_runs import NEXT_RUN, build_form, build_result
from rig.desk.panels.live_picture import LivePicture
from rig.desk.tab import Tab, box, text_field
from rig.instrument import Phase

_SIZE = (420, 300)
_REDRAW_INTERVAL_S = 1.0
"""Interval of what grows with the run: its events, and the curve of the amplitude."""
_ASK_STOP = "Stop the session? The record is closed and fitted; nothing is lost."
_ASK_KILL = (
    "The session does not answer. End its process? The laser is switched off; the record stays, at worst "
    "without its last second. Afterwards Fit again fits the record, and Resume measures the missing runs."
)


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel: the last result and the form of the next session, or the state of the running one."""
    follower = desk.follower
    with ui.column().classes("full-width") as idle_part:
        build_result(desk, tab)
        build_form(desk, tab).props(f'id="{NEXT_RUN}"').style("scroll-margin-top: 120px")
    tab.html(lambda: _step_bar(desk), props='role="status" aria-live="polite"')
    with ui.element("div").classes("grid measure fills live") as running_part:
        with ui.column().classes("stack"):
            with ui.column().classes("box"):
                _build_numbers(desk, tab)
            with ui.column().classes("box"):
                LivePicture(desk, tab, _SIZE)
        with ui.column().classes("box"):
            trajectory = charts.TrajectoryChart()
            trajectory.chart.element.style("width: min(100%, max(240px, 32vh))")
            _build_decay(desk, tab)
        with ui.column().classes("stack"):
            _build_state(desk, tab)

    def refresh() -> None:
        idle_part.set_visibility(not follower.running and not desk.starting)
        running_part.set_visibility(follower.running)
        running_part.classes(add="blind") if _why_blind(desk) else running_part.classes(remove="blind")
        if follower.running:
            path = follower.news.get("path") or {"x": [], "y": []}
            trajectory.show(path["x"], path["y"], follower.unit)

    tab.on_refresh(refresh)


def _why_blind(desk: Desk) -> str:
    """Why the values of a run are old; empty while they are not."""
    if desk.follower.news.get("darkness"):
        return "it is dark"
    age_s = desk.follower.frames_age_s
    return f"no frame for {age_s:.0f} s" if age_s > STALE_S else ""


def _build_numbers(desk: Desk, tab: Tab) -> None:
    """Build the large display of amplitude and time left, with Stop and Brake."""
    follower = desk.follower
    properties = 'color="negative"'
    question = Question(tab, "stop the session", "Stop it", "", no="Go on", properties=properties)

    def amplitude() -> str:
        value = follower.state.get("amplitude")
        if value is None:
            return tables.span("–", "dim")
        return f"{float(value):.2f}{tables.span(f' {follower.unit}', 'unit')}"

    def remark() -> str:
        why = _why_blind(desk)
        if not why and (no_swing_s := float(follower.state.get("no_swing_s") or 0.0)):
            why = f"no swing for {no_swing_s:.0f} s"
        if why:
            return f"{why}: values are old" if follower.state.get("amplitude") is not None else why
        return "" if follower.state.get("phase") == Phase.MEASURING else "nothing recorded yet"

    def brake_is_on() -> bool:
        status = follower.safety.status
        return status is not None and status.brake_on

    async def stop() -> None:
        if follower.running and await question.ask(_ASK_KILL if follower.frozen else _ASK_STOP):
            ui.notify(await run.io_bound(desk.stop_session))

    async def brake() -> None:
        ui.notify(await run.io_bound(follower.order, "brake off" if brake_is_on() else "brake on"))

    with ui.row().classes("items-baseline"):
        ui.html("amplitude", tag="h3", sanitize=False).classes("title")
        tab.label(remark, "caution", 'role="status" aria-live="polite"')
    tab.html(amplitude, "huge", 'role="status" aria-live="off" id="amplitude"')
    with ui.row().classes("items-baseline"):
        ui.label("time left").classes("title")
        tab.label(lambda: run_texts.time_left(follower.state), "middle")
    bar = ui.linear_progress(value=0.0, show_value=False).props('aria-label="part of the run done"')
    tab.on_refresh(lambda: bar.set_value(round(float(follower.state.get("done") or 0.0), 3)))
    with ui.row():
        tab.button("Stop", stop, 'color="negative" size="lg" aria-label="Stop the session"')
        tab.button(
            lambda: "Brake off" if brake_is_on() else "Brake",
            brake,
            'outline size="lg"',
            visible=lambda: follower.safety.controller is not None,
            # the brake would end the decay without a trace in the record: the session refuses it as well
            enabled=lambda: brake_is_on() or follower.state.get("phase") != Phase.MEASURING,
        )


def _build_state(desk: Desk, tab: Tab) -> None:
    """Build the state of a run in rows, its parameters so far, its events, and the field for a note."""
    follower = desk.follower

    async def note() -> None:
        text = str(field.value or "").strip()
        if not text:
            raise RigError("an empty note: type some text")
        reply = await run.io_bound(follower.order, f"note {text}")
        # the field is cleared only after the session has confirmed that the note is recorded
        field.set_value("")
        ui.notify(reply)

    def state() -> str:
        estimates = tables.table(run_texts.estimate_rows(follower.state), "parameters so far")
        return f"{estimates}{tables.table(follower.news.get('rows') or [], 'state of the run')}"

    def list_events() -> None:
        newest_first = reversed(run_texts.sorted_events(tuple(follower.events)))
        events.set_content("".join(map(run_texts.event_line, newest_first)))

    with box("state of the run", "shrinks old-with-session", region="state of the run"):
        tab.html(state)
    with box("events", "grows"):
        with ui.row().classes("full-width no-wrap items-center"):
            field = text_field("note").props("maxlength=2000").classes("full-width")
            field.on("keydown.enter", tab.handler(note))
            tab.button("Note", note, 'outline aria-label="note it in the record"')
        events = ui.html(sanitize=False).classes("events")
        events.props('role="log" aria-label="events" tabindex="0"')
    tab.on_interval(_REDRAW_INTERVAL_S, list_events)


def _step_bar(desk: Desk) -> str:
    if not desk.follower.running and not desk.starting:
        return ""
    return run_texts.step_bar(desk.follower.state, (desk.follower.config or desk.config).start.way)


def _build_decay(desk: Desk, tab: Tab) -> None:
    """Build the chart of the amplitude since the run began, with the law fitted so far."""
    measured = ChartCurve("amplitude", name="measured", style="scatter")
    chart = Chart("decay", "elapsed_s", (measured, ChartCurve("amplitude", name="fit", colour="second")))

    async def refresh() -> None:
        follower = desk.follower
        if follower.running and (history := await run.io_bound(follower.history)):
            chart.show([history["measured"], history["fit"]], follower.unit or "arcsec")

    tab.on_interval(_REDRAW_INTERVAL_S, refresh)
