"""Measure panel: start a session, watch it from a distance, brake, stop; last result, next session."""

from collections.abc import Iterable, Mapping
from typing import Any

from nicegui import run, ui

from processing.errors import RigError
from rig.control import STALE_S
from rig.desk import charts, tables
from rig.desk.charts import Chart, ChartCurve, Mark
from rig.desk.desk import Desk
from rig.desk.panels import run_words as words
from rig.desk.panels.between_runs import NEXT_RUN, RunResult, build_form
from rig.desk.panels.live_picture import LivePicture
from rig.desk.tab import Tab, at_once, box
from rig.instrument import Phase

_SIZE = (420, 300)
_ASK_STOP = "Stop the session? The record is closed and fitted; nothing is lost."
_ASK_KILL = (
    "The session does not answer. End its process? The laser is switched off; the record stays, at worst "
    "without its last second. Then: Fit again fits it, Resume measures missing runs."
)


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel: the last result and the form of the next session, or the state of the running one."""
    with ui.column().classes("full-width") as before:
        RunResult(desk, tab)
        build_form(desk, tab).props(f'id="{NEXT_RUN}"').style("scroll-margin-top: 120px")
    with ui.column().classes("full-width") as steps_box:
        steps = ui.html(sanitize=False).props('role="status" aria-live="polite"')
    with ui.element("div").classes("grid measure fills live") as during:
        with ui.column().classes("stack"):
            numbers = RunNumbers(desk, tab)
            with ui.column().classes("box"):
                LivePicture(desk, tab, _SIZE)
        with ui.column().classes("box"):
            way = charts.TrajectoryChart()
            way.chart.element.style("width: min(100%, max(240px, 32vh))")
            RunCharts(desk, tab)
        with ui.column().classes("stack"):
            facts = RunFacts(desk, tab)

    def refresh() -> None:
        news, running = desk.following.news, desk.following.running
        before.set_visibility(not running and not desk.starting)
        during.set_visibility(running)
        steps_box.set_visibility(running or desk.starting)
        config = desk.following.config or desk.config
        steps.set_content(words.strip(news.get("state") or {}, config.start.way))
        if running:
            is_blind = numbers.refresh(news)
            during.classes(add="blind") if is_blind else during.classes(remove="blind")
            facts.refresh(news)

    def draw() -> None:
        if desk.following.running:
            path = desk.following.news.get("path") or {"x": [], "y": []}
            way.show(path["x"], path["y"], desk.following.unit)

    tab.every(0.25, refresh)
    tab.every(0.5, draw)
    refresh()


class RunNumbers:
    """Large display of amplitude and time left, with Stop and Brake."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        with ui.dialog().props('aria-label="stop the session"') as self._sure, ui.card():
            self._asked = ui.label(_ASK_STOP)
            with ui.row():
                ui.button("Stop it", on_click=lambda: self._sure.submit(True)).props('color="negative"')
                ui.button("Go on", on_click=lambda: self._sure.submit(False)).props("outline")
        with ui.column().classes("box"):
            with ui.row().classes("items-baseline"):
                ui.html("amplitude", tag="h3", sanitize=False).classes("title")
                self._before = ui.label().classes("caution").props('role="status" aria-live="polite"')
            with ui.element("div").classes("huge"):
                self._amplitude = ui.label().props('role="status" aria-live="off" id="amplitude"')
                self._amplitude.style("display: inline")
                self._unit = ui.label().classes("unit").style("display: inline; margin-left: .3em")
            with ui.row().classes("items-baseline"):
                ui.label("time left").classes("title")
                self._left = ui.label().classes("middle")
            self._done = ui.linear_progress(value=0.0, show_value=False)
            self._done.props('aria-label="part of the run done"')
            with ui.row():
                stop = tab.button("Stop", self._stop)
                stop.props('color="negative" size="lg" aria-label="Stop the session"')
                self._brakes = tab.button("Brake", self._brake)
                self._brakes.props('outline size="lg"')

    def refresh(self, news: Mapping[str, Any]) -> bool:
        """Show the state of a session; returns whether its values are old."""
        following, state = self._desk.following, news.get("state") or {}
        value = state.get("amplitude")
        no_frame_s, is_dark = following.frames_age_s, bool(news.get("darkness"))
        is_blind = no_frame_s > STALE_S or is_dark
        from_before = ": values are old" if value is not None else ""
        self._before.set_text(
            f"it is dark{from_before}" if is_dark
            else f"no frame for {no_frame_s:.0f} s{from_before}" if is_blind
            else "" if state.get("phase") == Phase.MEASURING
            else "nothing recorded yet"
        )  # fmt: skip
        self._amplitude.set_text("–" if value is None else f"{float(value):.2f}")
        self._amplitude.classes(remove="dim", add="dim" if value is None else "")
        self._unit.set_text("" if value is None else following.unit)
        self._left.set_text(words.time_left(state))
        self._done.set_value(round(float(state.get("done") or 0.0), 3))
        self._brakes.set_visibility(following.devices.controller is not None)
        self._brakes.set_text("Brake off" if self._brake_is_on else "Brake")
        return is_blind

    @property
    def _brake_is_on(self) -> bool:
        status = self._desk.following.devices.status
        return status is not None and status.brake_on

    async def _stop(self) -> None:
        following = self._desk.following
        self._asked.set_text(_ASK_KILL if following.frozen else _ASK_STOP)
        if following.running and await self._sure:
            ui.notify(await run.io_bound(self._desk.stop_session))

    async def _brake(self) -> None:
        order = "brake off" if self._brake_is_on else "brake on"
        ui.notify(await run.io_bound(self._desk.following.order, order))


class RunFacts:
    """The state of a run in rows, its parameters so far, its events, and the field for a note."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        with box("state of the run", "shrinks old-with-session", region="state of the run"):
            self._learned = ui.html(sanitize=False).classes("full-width")
            self._state = ui.html(sanitize=False).classes("full-width")
        with box("events", "grows"):
            with ui.row().classes("full-width no-wrap items-center"):
                self._noting = ui.input("note").props('dense outlined data-key="note" maxlength=2000')
                self._noting.classes("full-width").on("keydown.enter", tab.act(self._note))
                tab.button("Note", self._note).props('outline aria-label="note it in the record"')
            self._events = ui.html(sanitize=False).classes("events")
            self._events.props('role="log" aria-label="events" tabindex="0"')

    def refresh(self, news: Mapping[str, Any]) -> None:
        """Show the session's state."""
        learned = words.estimate_rows(news.get("state") or {})
        self._learned.set_content(tables.table(learned, "parameters so far"))
        self._state.set_content(tables.table(news.get("rows") or [], "state of the run"))
        newest_first = reversed(tuple(self._desk.following.events))
        self._events.set_content("".join(map(words.event_line, newest_first)))

    async def _note(self) -> None:
        text = str(self._noting.value or "").strip()
        if not text:
            raise RigError("an empty note: type some text")
        said = await run.io_bound(self._desk.following.order, f"note {text}")
        # only what is on the session's disk leaves the field
        self._noting.set_value("")
        ui.notify(said)


_REDRAW_S = 1.0
_KEYS = {"decay": "amplitude", "period": "period_s"}


def _with_fit(key: str) -> tuple[ChartCurve, ...]:
    """Curves of a quantity, of its fit, and of its residuals."""
    left = f"{key.removesuffix('_s')}_residual_in_u"
    return (
        ChartCurve(key, name="measured", style="points"),
        ChartCurve(key, name="fit", colour="second"),
        ChartCurve(left, style="points", row=1),
    )


class RunCharts:
    """Charts of the run, and the toggle that selects one."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._choice = at_once(ui.toggle(list(_KEYS), value="decay", on_change=self._choose))
        self._choice.props('dense no-caps aria-label="which chart"')
        self._charts = {name: Chart(name, "elapsed_s", _with_fit(key)) for name, key in _KEYS.items()}
        self._choose()
        tab.every(_REDRAW_S, self._refresh)

    def _choose(self) -> None:
        for name, chart in self._charts.items():
            chart.frame.set_visibility(name == self._choice.value)

    async def _refresh(self) -> None:
        following = self._desk.following
        if not following.running or not (history := await run.io_bound(following.history)):
            return
        unit, name = following.unit or "arcsec", str(self._choice.value)
        kind = _KEYS[name].removesuffix("_s")
        fit = history["fit"]
        self._charts[name].show(
            [history["swings"][kind], fit[kind], fit[f"{kind}_residual"]],
            unit,
            marks=_marks(following.events, str(following.news.get("run") or "")),
        )


def _marks(events: Iterable[Mapping[str, Any]], run: str) -> list[Mark]:
    """Times and texts of the run's events, without those of earlier runs."""
    return [
        (float(one["elapsed_s"]), f"{one['kind']}: {one['text']}")
        for one in tuple(events)
        if one["run"] == run and one["elapsed_s"] is not None and float(one["elapsed_s"]) >= 0
    ]
