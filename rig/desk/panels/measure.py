"""Measure panel: start a session, watch it from a distance, brake, stop; last result, next session."""

from nicegui import run, ui

from processing.errors import RigError
from rig.control import STALE_S
from rig.desk import charts, tables
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.dialogs import Question
from rig.desk.panels import run_words as words
from rig.desk.panels.between_runs import NEXT_RUN, build_form, build_result
from rig.desk.panels.live_picture import LivePicture
from rig.desk.tab import Tab, box, text_field
from rig.instrument import Phase

_SIZE = (420, 300)
_ASK_STOP = "Stop the session? The record is closed and fitted; nothing is lost."
_ASK_KILL = (
    "The session does not answer. End its process? The laser is switched off; the record stays, at worst "
    "without its last second. Then: Fit again fits it, Resume measures missing runs."
)


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel: the last result and the form of the next session, or the state of the running one."""
    following = desk.following
    with ui.column().classes("full-width") as before:
        build_result(desk, tab)
        build_form(desk, tab).props(f'id="{NEXT_RUN}"').style("scroll-margin-top: 120px")
    tab.html(lambda: _steps(desk), props='role="status" aria-live="polite"')
    with ui.element("div").classes("grid measure fills live") as during:
        with ui.column().classes("stack"):
            with ui.column().classes("box"):
                _build_numbers(desk, tab)
            with ui.column().classes("box"):
                LivePicture(desk, tab, _SIZE)
        with ui.column().classes("box"):
            way = charts.TrajectoryChart()
            way.chart.element.style("width: min(100%, max(240px, 32vh))")
            _build_decay(desk, tab)
        with ui.column().classes("stack"):
            _build_facts(desk, tab)

    def refresh() -> None:
        before.set_visibility(not following.running and not desk.starting)
        during.set_visibility(following.running)
        during.classes(add="blind") if _why_blind(desk) else during.classes(remove="blind")
        if following.running:
            path = following.news.get("path") or {"x": [], "y": []}
            way.show(path["x"], path["y"], following.unit)

    tab.keep(refresh)


def _why_blind(desk: Desk) -> str:
    """Why the values of a run are old; empty while they are not."""
    no_frame_s = desk.following.frames_age_s
    if desk.following.news.get("darkness"):
        return "it is dark"
    return f"no frame for {no_frame_s:.0f} s" if no_frame_s > STALE_S else ""


def _build_numbers(desk: Desk, tab: Tab) -> None:
    """Large display of amplitude and time left, with Stop and Brake."""
    following = desk.following
    properties = 'color="negative"'
    question = Question(tab, "stop the session", "Stop it", "", no="Go on", properties=properties)

    def amplitude() -> str:
        value = desk.following.state.get("amplitude")
        if value is None:
            return tables.span("–", "dim")
        return f"{float(value):.2f}{tables.span(f' {following.unit}', 'unit')}"

    def remark() -> str:
        why = _why_blind(desk)
        if not why and (no_swing_s := float(desk.following.state.get("no_swing_s") or 0.0)):
            why = f"no swing for {no_swing_s:.0f} s"
        if why:
            return f"{why}: values are old" if desk.following.state.get("amplitude") is not None else why
        return "" if desk.following.state.get("phase") == Phase.MEASURING else "nothing recorded yet"

    def brake_is_on() -> bool:
        status = following.safety.status
        return status is not None and status.brake_on

    async def stop() -> None:
        if following.running and await question.ask(_ASK_KILL if following.frozen else _ASK_STOP):
            ui.notify(await run.io_bound(desk.stop_session))

    async def brake() -> None:
        ui.notify(await run.io_bound(following.order, "brake off" if brake_is_on() else "brake on"))

    with ui.row().classes("items-baseline"):
        ui.html("amplitude", tag="h3", sanitize=False).classes("title")
        tab.label(remark, "caution", 'role="status" aria-live="polite"')
    tab.html(amplitude, "huge", 'role="status" aria-live="off" id="amplitude"')
    with ui.row().classes("items-baseline"):
        ui.label("time left").classes("title")
        tab.label(lambda: words.time_left(desk.following.state), "middle")
    done = ui.linear_progress(value=0.0, show_value=False).props('aria-label="part of the run done"')
    tab.keep(lambda: done.set_value(round(float(desk.following.state.get("done") or 0.0), 3)))
    with ui.row():
        tab.button("Stop", stop, 'color="negative" size="lg" aria-label="Stop the session"')
        tab.button(
            lambda: "Brake off" if brake_is_on() else "Brake",
            brake,
            'outline size="lg"',
            seen=lambda: following.safety.controller is not None,
            # a brake would end the decay unseen: the session refuses it, too
            enabled=lambda: brake_is_on() or desk.following.state.get("phase") != Phase.MEASURING,
        )


def _build_facts(desk: Desk, tab: Tab) -> None:
    """The state of a run in rows, its parameters so far, its events, and the field for a note."""

    async def note() -> None:
        text = str(noting.value or "").strip()
        if not text:
            raise RigError("an empty note: type some text")
        reply = await run.io_bound(desk.following.order, f"note {text}")
        # only what is on the session's disk leaves the field
        noting.set_value("")
        ui.notify(reply)

    def facts() -> str:
        rows = desk.following.news.get("rows") or []
        learned = tables.table(words.estimate_rows(desk.following.state), "parameters so far")
        return f"{learned}{tables.table(rows, 'state of the run')}"

    def events() -> str:
        return "".join(map(words.event_line, reversed(words.listed(tuple(desk.following.events)))))

    with box("state of the run", "shrinks old-with-session", region="state of the run"):
        tab.html(facts)
    with box("events", "grows"):
        with ui.row().classes("full-width no-wrap items-center"):
            noting = text_field("note").props("maxlength=2000").classes("full-width")
            noting.on("keydown.enter", tab.act(note))
            tab.button("Note", note, 'outline aria-label="note it in the record"')
        tab.html(events, "events", 'role="log" aria-label="events" tabindex="0"')


def _steps(desk: Desk) -> str:
    if not desk.following.running and not desk.starting:
        return ""
    return words.strip(desk.following.state, (desk.following.config or desk.config).start.way)


_REDRAW_S = 1.0


def _build_decay(desk: Desk, tab: Tab) -> None:
    """The chart of the amplitude since the run began, with the law fitted so far."""
    measured = ChartCurve("amplitude", name="measured", style="scatter")
    chart = Chart("decay", "elapsed_s", (measured, ChartCurve("amplitude", name="fit", colour="second")))

    async def refresh() -> None:
        following = desk.following
        if following.running and (history := await run.io_bound(following.history)):
            chart.show([history["measured"], history["fit"]], following.unit or "arcsec")

    tab.every(_REDRAW_S, refresh)
