"""Rig: what the camera sees with its figures, exposure and region, then the checks before a run."""

import html
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import MouseEventArguments

from acquisition.camera import CameraSettings
from processing.errors import ConfigurationError
from rig.desk import tables
from rig.desk.aligner import EXPOSE, Aligner
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.panels.between_runs import as_typed, setting_field
from rig.desk.panels.live_picture import LivePicture, has_picture, look_now
from rig.desk.tab import DELIBERATE, Handler, Tab, apart, at_once, box
from rig.presentation import Verdict

KEYS = (("z", "rig: zoom 1, 4, 16"),)
_SIZE = (800, 540)
_STEP, _STEP_DB = 1.25, 1.0
_BARS = 64
_LEAST_REGION_PX = 8
_NEEDS = "settings need a live picture"
_SHORT = 24
"""Letters of a number that stands in a lamp."""


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    with ui.element("div").classes("grid align"):
        picture = AlignPicture(desk, tab)
        controls = CameraControls(desk, tab)
    checks = PreflightChecks(desk, tab)

    def refresh() -> None:
        picture.refresh()
        controls.refresh()
        checks.refresh()

    tab.key("z", picture.zoom)
    tab.every(0.3, refresh)
    refresh()


class AlignPicture:
    """The live picture with its buttons; a rectangle drawn over the whole frame is the camera's region."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._corner: tuple[float, float] | None = None
        with ui.column().classes("box"):
            self._picture = LivePicture(desk, tab, _SIZE, self._mouse)
            with ui.row():
                self._begin = tab.button("Live picture", apart(desk.begin_aligning))
                self._begin.props(f'color="positive" {DELIBERATE}')
                self._end = tab.button("Stop", apart(desk.end_aligning)).props("outline")
                self._zooming = ui.button("Zoom 1", on_click=self.zoom)
                self._zooming.props('outline aria-label="Zoom to the spot, key z"')
                # it begins the picture anew, and with it the light
                tab.button("Whole sensor", self._whole).props(f"outline {DELIBERATE}")
                self._keep = tab.button("Keep for runs", lambda: desk.keep_camera(aligner_of(desk).applied))
                self._keep.props("outline")
            self._kept = ui.label().classes("dim")

    def refresh(self) -> None:
        """Show which buttons can do something, and what is kept."""
        now = self._desk.aligner
        self._begin.set_visibility(now is None)
        self._end.set_visibility(now is not None)
        self._keep.set_enabled(now is not None and now.running)
        self._zooming.set_enabled(has_picture(self._desk))
        self._kept.set_text(_kept(self._desk))

    def zoom(self) -> None:
        """The next zoom."""
        self._picture.zoom_on()
        self._zooming.set_text(f"Zoom {self._picture.zoom}")

    def _mouse(self, event: MouseEventArguments) -> None:
        if self._desk.aligner is None or self._picture.zoom != 1:
            return
        if event.type == "pointerdown":
            self._corner = event.image_x, event.image_y
        elif self._corner is not None:
            x, y = self._corner
            left, top = min(x, event.image_x), min(y, event.image_y)
            width, height = abs(event.image_x - x), abs(event.image_y - y)
            drawn = (
                f"<rect x='{left}' y='{top}' width='{width}' height='{height}' fill='none' "
                "stroke='white' stroke-width='2'/>"
            )
            if event.type == "pointerup":
                self._corner = None
                if min(width, height) > _LEAST_REGION_PX:
                    _ask_region(self._desk, left, top, width, height)
                else:
                    drawn = ""
            self._picture.element.content = drawn

    async def _whole(self) -> None:
        self._picture.element.content = ""
        await run.io_bound(self._desk.align_whole_sensor)


class CameraControls:
    """Lamps of the beam, exposure and gain, histogram, focus and figures of the picture."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk, self._tab = desk, tab
        self._fields: dict[str, ui.input] = {}
        self._needing: list[ui.button] = []
        # on a low screen it scrolls by itself: picture and buttons stay
        with box("", "scrolls", region="lamps and settings"):
            self._lamps = ui.html(sanitize=False).classes("full-width")
            self._lamps.props('role="status" aria-label="lamps"')
            self._note = ui.label().props('role="status"')
            self._setting("exposure_us", "exposure / µs", lambda us, sense: us * _STEP**sense)
            self._setting("gain_db", "gain / dB", lambda db, sense: db + sense * _STEP_DB)
            bars, line = (ChartCurve("pixels", style="bars"),), (ChartCurve("sharpness_per_px"),)
            self._histogram = Chart("histogram", "level_dn", bars, height="100px")
            self._focus = Chart("focus", "elapsed_s", line, height="110px")
            with at_once(ui.expansion("figures", value=True)).classes("full-width"):
                self._figures = ui.html(sanitize=False).classes("full-width").props('aria-live="off"')

    def refresh(self) -> None:
        """Show the newest look, and what is set at the camera."""
        now = self._desk.aligner
        for button in self._needing:
            button.set_enabled(now is not None and now.running)
        wrong = "" if now is None else now.problem or now.darkness
        self._note.set_text(wrong or (_NEEDS if now is None else now.note))
        self._note.classes(remove="caution dim", add="caution" if wrong else "dim")
        self._show_applied(CameraSettings() if now is None else now.applied)
        sharpness = [] if now is None else list(now.focus)
        self._focus.show([sharpness[:: 1 + len(sharpness) // 200]], empty="no sharpness yet")
        look = look_now(self._desk)
        if look is None:
            self._figures.set_content("")
            self._lamps.set_content("")
            self._histogram.show([[]], empty="no picture yet")
            return
        best = max((one for _, one in sharpness), default=0.0)
        # of a frame that is dark on purpose there is nothing to be judged: why it is stands below
        dark = now is not None and bool(now.darkness)
        self._lamps.set_content("" if dark else _lamps(look.lamps(best)))
        self._figures.set_content(tables.table(look.rows(), "figures of the picture"))
        counts, edges = np.histogram(look.image, _BARS, (0, look.full_scale_dn + 1))
        middles = 0.5 * (edges[1:] + edges[:-1])
        self._histogram.show(
            [[(float(at), round(math.log10(1 + n), 3)) for at, n in zip(middles, counts, strict=True)]]
        )

    def _setting(self, name: str, label: str, step: Callable[[float, int], float]) -> None:
        """A row for one setting: field, Set, for the exposure Auto, and a step down (-1) and up (1)."""
        what = label.partition(" ")[0]
        with ui.row().classes("items-center no-wrap full-width"):
            field = setting_field(self._desk, f"camera.{name}", label, None, is_number=True)
            field.props("hide-bottom-space stack-label").classes("col")
            self._fields[name] = field
            self._small("Set", partial(self._typed, name, field), f"Set {label}")
            if name == "exposure_us":
                self._small("Auto", lambda: aligner_of(self._desk).wish(EXPOSE), "Auto exposure")
            for sign, words, sense in (("-", "smaller", -1), ("+", "larger", 1)):
                self._small(sign, partial(self._turned, name, step, sense), f"{words} {what}")

    def _small(self, text: str, do: Handler, words: str) -> None:
        button = self._tab.button(text, do).props(f'outline dense aria-label="{words}"').classes("step")
        self._needing.append(button)

    def _typed(self, name: str, field: ui.input) -> None:
        key, value = f"camera.{name}", as_typed(field.value, True)
        if value == "":
            raise ConfigurationError(f"{key}: the field is empty; type a number, then press Set")
        if fault := self._desk.fault(key, value):
            raise ConfigurationError(fault)
        aligner_of(self._desk).wish(CameraSettings.model_validate({name: value}))

    def _turned(self, name: str, step: Callable[[float, int], float], sense: int) -> None:
        def wanted(applied: CameraSettings) -> CameraSettings:
            stated = getattr(applied, name)
            if stated is None:
                raise ConfigurationError(
                    "this camera does not report its setting; type a value, then press Set"
                )
            return CameraSettings.model_validate({name: step(stated, sense)})

        aligner_of(self._desk).wish(wanted)

    def _show_applied(self, applied: CameraSettings) -> None:
        for name, field in self._fields.items():
            value = getattr(applied, name)
            said = "" if value is None else f"now {value:.6g}"
            if field.props.get("placeholder") != said:
                field.props(f'placeholder="{said}"')


def aligner_of(desk: Desk) -> Aligner:
    """The live picture; raises ConfigurationError without one."""
    if desk.aligner is None:
        raise ConfigurationError("no live picture: press Live picture first")
    return desk.aligner


def _lamps(verdicts: Sequence[Verdict]) -> str:
    """A lamp for each; what is to be done stands below."""
    shown, told = [], []
    for one in verdicts:
        kind = "no" if not one.ok else "caution" if one.remedy else "go"
        # a beam's verdict is a sentence; it is among the figures
        words = one.measured if len(one.measured) < _SHORT else kind
        shown.append(f"<span class='{kind}'>{html.escape(f'{one.name} {words}')}</span>")
        if one.remedy:
            why = "; ".join(filter(None, (one.reason, one.remedy)))
            told.append(f"<div class='{kind}'>{html.escape(f'{one.name}: {why}')}</div>")
    return f"<div class='lamps'>{''.join(shown)}</div>{''.join(told)}"


def _ask_region(desk: Desk, left: float, top: float, width: float, height: float) -> None:
    """Ask the camera for the rectangle, which is in px of the picture."""
    aligner = desk.aligner
    look = None if aligner is None else aligner.look
    if aligner is None or look is None:
        return
    rows, columns = look.image.shape
    scale = min(_SIZE[0] / columns, _SIZE[1] / rows)
    # the frame is in the middle of the picture
    left -= 0.5 * (_SIZE[0] - columns * scale)
    top -= 0.5 * (_SIZE[1] - rows * scale)
    aligner.wish_region(*(round(one / scale) for one in (left, top, width, height)))


def _kept(desk: Desk) -> str:
    lines = ", ".join(
        f"{key} = {value:g}" for key, value in desk.kept.items() if isinstance(value, int | float)
    )
    return f"used for everything this desk starts: {lines}" if lines else ""


class PreflightChecks:
    """The button that runs the checks, their verdict, and a light for each."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        with ui.column().classes("box"):
            with ui.row().classes("items-center"):
                check = apart(desk.start, "doctor", "--preflight", "--json")
                self._button = tab.button("Run preflight", check)
                self._button.props(f'color="positive" size="lg" {DELIBERATE}')
                self._ending = tab.button("End", self._end).props("outline")
                self._verdict = ui.label().classes("advice").props('role="status" aria-live="polite"')
                self._words = ui.label().style("white-space: pre-line")
            self._failing = ui.html(sanitize=False).classes("full-width")
            with at_once(ui.expansion("passed")).classes("full-width") as self._folded:
                self._passing = ui.html(sanitize=False).classes("full-width")

    def refresh(self) -> None:
        """Show what the running session, or the last command, has found."""
        job, news = self._desk.jobs.get("doctor"), self._desk.following.news
        found: Sequence[Mapping[str, Any]] = ()
        said = "it checks whether a run can be made"
        if news.get("preflight"):
            found = news["preflight"]
        elif job is not None:
            found = job.newest.get("preflight", {}).get("table", ())
            said = "\n".join(list(job.said)[-3:])
            if job.running:
                said = doing(job.newest.get("state")) or "the camera is opened"
        self._button.set_enabled(job is None or not job.running)
        self._ending.set_visibility(job is not None and job.running and not found)
        against = [one for one in found if not one["ok"]]
        shown_first = against + [one for one in found if one["ok"] and (one["remedy"] or not one["made"])]
        passed = [one for one in found if one not in shown_first]
        self._verdict.set_text("" if not found else "NO-GO" if against else "GO")
        self._verdict.set_visibility(bool(found))
        self._verdict.classes(remove="go no", add="no" if against else "go")
        done = "" if self._desk.following.running else _next(len(against))
        self._words.set_text(done if found else said)
        self._failing.set_content(lights(shown_first))
        self._passing.set_content(lights(passed))
        self._folded.set_text(f"{len(passed)} of {len(found)} checks passed")
        self._folded.set_visibility(bool(passed))

    def _end(self) -> None:
        if "doctor" in self._desk.jobs:
            self._desk.jobs["doctor"].end()


def _next(against: int) -> str:
    """What is to be done after the checks."""
    if not against:
        return "Nothing prevents a run: start it in Measure."
    what = "This stands" if against == 1 else f"These {against} stand"
    return f"{what} against a run: follow the remedies below, then run preflight again."


def lights(verdicts: Sequence[Mapping[str, Any]]) -> str:
    """A row for each verdict: its light, its number against the limit, reason and remedy."""
    rows = []
    for one in verdicts:
        judged = (
            ("no", "NO-GO") if not one["ok"]
            else ("caution", "caution") if one["remedy"]
            else ("go", "go") if one["made"]
            else ("dim", "not checked")
        )  # fmt: skip
        why = "; ".join(html.escape(str(one[key])) for key in ("reason", "remedy") if one[key])
        rows.append(
            f"<tr><td class='{judged[0]} judged'><span class='light' style='background: currentcolor'></span>"
            f"{judged[1]}</td><th scope='row'>{html.escape(str(one['name']))}</th>"
            f"<td>{html.escape(str(one['measured']))}</td>"
            f"<td class='dim'>{html.escape(str(one['limit']))}</td></tr>"
            + (f"<tr><td></td><td></td><td colspan='2' class='{judged[0]}'>{why}</td></tr>" if why else "")
        )
    return f"<table class='rows' aria-label='preflight'>{''.join(rows)}</table>"
