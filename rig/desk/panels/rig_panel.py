"""Rig: the live picture with its figures, exposure and region, then the checks before a run."""

import html
import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import cv2
from nicegui import run, ui
from nicegui.events import MouseEventArguments

from acquisition.camera import CameraSettings
from processing.errors import ConfigurationError
from rig.desk import tables
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.follower import phase_text
from rig.desk.panels.between_runs import typed_value
from rig.desk.panels.live_picture import LivePicture, newest_frame
from rig.desk.tab import DELIBERATE, Action, Tab, box, in_background, text_field
from rig.devices import AlignmentFrame
from rig.terminal import Verdict

KEYS = (("z", "rig: zoom 1, 4, 16"),)
_SIZE = (800, 540)
_HISTOGRAM_BARS = 64
_MAX_FOCUS_POINTS = 200
_REDRAW_INTERVAL_S = 0.5
_MIN_REGION_PX = 8
_MAX_LAMP_CHARACTERS = 24
"""Longest text of a number in a lamp."""


def build(desk: Desk, tab: Tab) -> None:
    with ui.element("div").classes("grid align"):
        with ui.column().classes("box"):
            _build_picture(desk, tab)
        # on a low screen this box scrolls: picture and buttons stay
        with box("", "scrolls", region="lamps and settings"):
            _build_controls(desk, tab)
    with ui.column().classes("box"):
        _build_checks(desk, tab)


def _build_picture(desk: Desk, tab: Tab) -> None:
    """Build the live picture with its buttons; a rectangle drawn in it becomes the camera's region."""
    corner: tuple[float, float] | None = None

    async def mouse(event: MouseEventArguments) -> None:
        nonlocal corner
        if desk.live_picture is None or picture.zoom != 1:
            return
        if event.type == "pointerdown":
            corner = event.image_x, event.image_y
        elif corner is not None:
            opposite = event.image_x, event.image_y
            (left, right), (top, bottom) = (sorted(ends) for ends in zip(corner, opposite, strict=True))
            width, height = right - left, bottom - top
            is_region = event.type != "pointerup" or min(width, height) > _MIN_REGION_PX
            if event.type == "pointerup":
                corner = None
            rectangle = (
                f"<rect x='{left}' y='{top}' width='{width}' height='{height}' fill='none' "
                "stroke='white' stroke-width='2'/>"
            )
            picture.element.content = rectangle if is_region else ""
            if corner is None and is_region and (frame := newest_frame(desk)) is not None:
                region = region_drawn(frame, (left, right), (top, bottom))
                order = f"set {region.model_dump_json(exclude_none=True)}"
                await tab.handler(partial(_order, desk, order))()

    async def whole() -> None:
        picture.element.content = ""
        await run.io_bound(desk.align_whole_sensor)

    def own_settings() -> str:
        numbers = ((key, value) for key, value in desk.own_settings.items() if isinstance(value, int | float))
        settings = ", ".join(f"{key} = {value:g}" for key, value in numbers)
        return f"used for everything this desk starts: {settings}" if settings else ""

    def is_on() -> bool:
        return desk.live_picture is not None

    picture = LivePicture(desk, tab, _SIZE, mouse)
    tab.key("z", picture.next_zoom)
    with ui.row():
        begin, end = in_background(desk.begin_aligning), in_background(desk.end_aligning)
        tab.button("Live picture", begin, f'color="positive" {DELIBERATE}', visible=lambda: not is_on())
        tab.button("Stop", end, "outline", visible=is_on)
        tab.button(
            lambda: f"Zoom {picture.zoom}",
            picture.next_zoom,
            'outline aria-label="Zoom to the spot, key z"',
            enabled=lambda: desk.picture_source is not None,
        )
        # the picture begins again, and with it the light
        tab.button("Whole sensor", whole, f"outline {DELIBERATE}")
        keep = desk.keep_camera_settings
        tab.button("Keep for runs", keep, "outline", enabled=lambda: newest_frame(desk) is not None)
    tab.label(own_settings, "dim")


async def _order(desk: Desk, order: str) -> None:
    """Give the live picture an order; the note of its state reports the result."""
    await run.io_bound(desk.follower.order, order)


def region_drawn(
    frame: AlignmentFrame, x_ends: tuple[float, float], y_ends: tuple[float, float]
) -> CameraSettings:
    """Region of the sensor inside a rectangle in px of the picture; the frame may itself be a region."""
    rows, columns = frame.image.shape
    scale = min(_SIZE[0] / columns, _SIZE[1] / rows)
    x_px, width_px = _span_px(x_ends, _SIZE[0], columns, scale)
    y_px, height_px = _span_px(y_ends, _SIZE[1], rows, scale)
    return CameraSettings(
        width_px=width_px,
        height_px=height_px,
        offset_x_px=(frame.applied.offset_x_px or 0) + x_px,
        offset_y_px=(frame.applied.offset_y_px or 0) + y_px,
    )


def _span_px(ends: tuple[float, float], picture_px: int, frame_px: int, scale: float) -> tuple[int, int]:
    """First pixel and number of pixels of the frame, centred in the picture, between two ends of it."""
    margin = 0.5 * (picture_px - frame_px * scale)
    first, last = (min(max(round((end - margin) / scale), 0), frame_px) for end in ends)
    first = max(0, min(first, frame_px - _MIN_REGION_PX))
    return first, max(last - first, min(_MIN_REGION_PX, frame_px))


def _build_controls(desk: Desk, tab: Tab) -> None:
    """Build the lamps of the beam, exposure and gain, histogram, focus and figures of the picture."""

    frame: AlignmentFrame | None = None

    def take() -> None:
        nonlocal frame
        frame = newest_frame(desk)

    def lamps() -> str:
        source = desk.picture_source
        # a frame that is dark on purpose is not judged; the note below gives the reason
        if frame is None or source is None or source.state.get("dark"):
            return ""
        return _lamps(frame.lamps(max((sharpness for _, sharpness in tuple(source.focus)), default=0.0)))

    def note() -> str:
        if desk.live_picture is None:
            return tables.span("settings need a live picture", "dim")
        state = desk.follower.state
        dark = str(state.get("dark") or "")
        return tables.span(dark or str(state.get("note") or ""), "caution" if dark else "dim")

    def figures() -> str:
        return "" if frame is None else tables.table(frame.rows(), "figures of the picture")

    def draw() -> None:
        sharpness = [] if desk.picture_source is None else list(desk.picture_source.focus)
        sharpness = [(time_s - sharpness[0][0], value) for time_s, value in sharpness]
        focus.show([sharpness[:: 1 + len(sharpness) // _MAX_FOCUS_POINTS]], empty="no sharpness yet")
        if frame is None:
            histogram.show([[]], empty="no picture yet")
            return
        end_dn = frame.full_scale_dn + 1
        counts = cv2.calcHist([frame.image], [0], None, [_HISTOGRAM_BARS], [0, end_dn]).ravel().tolist()
        width_dn = end_dn / _HISTOGRAM_BARS
        histogram.show(
            [[((k + 0.5) * width_dn, round(math.log10(1 + count), 3)) for k, count in enumerate(counts)]]
        )

    tab.on_refresh(take)
    tab.html(lamps, props='role="status" aria-label="lamps"')
    tab.html(note, props='role="status"')
    _build_setting(desk, tab, "exposure_us", "exposure / µs", "eE")
    _build_setting(desk, tab, "gain_db", "gain / dB", "gG")
    histogram = Chart("histogram", "level_dn", (ChartCurve("pixels", style="bar"),), "small")
    focus = Chart("focus", "elapsed_s", (ChartCurve("sharpness_per_px"),), "small")
    tab.html(figures, props='aria-live="off"')
    tab.on_interval(_REDRAW_INTERVAL_S, draw)


def _build_setting(desk: Desk, tab: Tab, name: str, label: str, align_keys: str) -> None:
    """Build the row of a setting: field, Set, Auto, steps by the `align_keys` of `rig camera align`."""
    noun, key = label.partition(" ")[0], f"camera.{name}"

    async def order(text: str) -> None:
        # while it is empty, the field states the camera's present value
        field.set_value("")
        await _order(desk, text)

    def small(text: str, action: Action, label: str) -> None:
        props = f'outline dense aria-label="{label}"'
        button = tab.button(text, action, props, enabled=lambda: desk.live_picture is not None)
        button.classes("step")

    async def set_value() -> None:
        value = typed_value(field.value, True)
        if value == "":
            raise ConfigurationError(f"{key}: the field is empty; type a number, then press Set")
        desk.checked({key: value})
        await order(f"set {json.dumps({name: value})}")

    def hint() -> None:
        frame = None if desk.live_picture is None else newest_frame(desk)
        value = None if frame is None else getattr(frame.applied, name)
        placeholder = "" if value is None else f"now {value:.6g}"
        if field.props.get("placeholder") != placeholder:
            field.props(f'placeholder="{placeholder}"')

    with ui.row().classes("items-center no-wrap full-width"):
        field = text_field(label, key=key)
        field.props("hide-bottom-space stack-label").classes("col")
        tab.on_refresh(hint)
        small("Set", set_value, f"Set {label}")
        if name == "exposure_us":
            small("Auto", partial(order, "key a"), "Auto exposure")
        for sign, align_key, adjective in zip("-+", align_keys, ("smaller", "larger"), strict=True):
            small(sign, partial(order, f"key {align_key}"), f"{adjective} {noun}")


def _lamps(verdicts: Sequence[Verdict]) -> str:
    """A lamp for each verdict, with the remedies below."""
    lamps, remedies = [], []
    for verdict in verdicts:
        kind = "no" if not verdict.ok else "caution" if verdict.remedy else "go"
        # the verdict on the beam is a sentence, which stands among the figures
        is_short = len(verdict.measured) < _MAX_LAMP_CHARACTERS
        lamps.append(tables.span(f"{verdict.name} {verdict.measured if is_short else kind}", kind))
        if verdict.remedy:
            why = "; ".join(filter(None, (verdict.reason, verdict.remedy)))
            remedies.append(tables.span(f"{verdict.name}: {why}", kind, "div"))
    return f"<div class='lamps'>{''.join(lamps)}</div>{''.join(remedies)}"


def _build_checks(desk: Desk, tab: Tab) -> None:
    """Build the button that runs the checks, and their results."""

    def runs() -> bool:
        return desk.jobs.running_job("doctor") is not None

    def end() -> None:
        desk.jobs["doctor"].end()

    with ui.row().classes("items-center"):
        check = in_background(desk.start, "doctor", "--preflight", "--json")
        props = f'color="positive" size="lg" {DELIBERATE}'
        tab.button("Run preflight", check, props, enabled=lambda: not runs())
        tab.button("End", end, "outline", visible=lambda: runs() and not _verdicts(desk))
    tab.html(lambda: checks(desk))


def _verdicts(desk: Desk) -> Sequence[Mapping[str, Any]]:
    """Verdicts of the running session, else of the last command; empty before they are made."""
    job = desk.jobs.get("doctor")
    of_command = {} if job is None else job.newest.get("preflight", {})
    verdicts: Sequence[Mapping[str, Any]] = desk.follower.news.get("preflight") or of_command.get("table", ())
    return verdicts


def checks(desk: Desk) -> str:
    """GO or NO-GO, the next step, and a row for each check, failed checks first; before that the progress."""
    verdicts, job = _verdicts(desk), desk.jobs.get("doctor")
    if not verdicts:
        if job is None:
            return tables.span("it checks whether a run can be made")
        if job.running:
            # the command may compile kernels before its first state
            output = job.output[-1] if job.output else "the camera is opened"
            return tables.span(phase_text(job.newest.get("state", {})) or output)
        return tables.span("" if job.end_requested else job.problem, "no")
    failed = [verdict for verdict in verdicts if not verdict["ok"]]
    passed = [verdict for verdict in verdicts if verdict["ok"] and verdict["made"] and not verdict["remedy"]]
    remarkable = [verdict for verdict in verdicts if verdict["ok"] and verdict not in passed]
    result, kind, next_step = "GO", "go", "Nothing prevents a run: start it in Measure."
    if failed:
        subject = "This stands" if len(failed) == 1 else f"These {len(failed)} stand"
        next_step = f"{subject} against a run: follow the remedies below, then run preflight again."
        result, kind = "NO-GO", "no"
    head = f"{tables.span(result, f'advice {kind}')} {'' if desk.follower.running else next_step}"
    count = f"{len(passed)} of {len(verdicts)} checks passed"
    return f"<div role='status'>{head}</div>{_verdict_table([*failed, *remarkable])}" + (
        f"<details><summary>{count}</summary>{_verdict_table(passed)}</details>" if passed else ""
    )


def _verdict_table(verdicts: Sequence[Mapping[str, Any]]) -> str:
    """A row for each verdict: its light, its number against the limit; below it reason and remedy."""
    rows = []
    for verdict in verdicts:
        kind, result = (
            ("no", "NO-GO") if not verdict["ok"]
            else ("caution", "caution") if verdict["remedy"]
            else ("go", "go") if verdict["made"]
            else ("dim", "not checked")
        )  # fmt: skip
        name, measured, limit, *reasons = (
            html.escape(str(verdict[key])) for key in ("name", "measured", "limit", "reason", "remedy")
        )
        rows.append(
            f"<tr><td class='{kind} judged'><span class='light' style='background: currentcolor'></span>"
            f"{result}</td><th scope='row'>{name}</th><td>{measured}</td><td class='dim'>{limit}</td></tr>"
        )
        if any(reasons):
            text = "; ".join(filter(None, reasons))
            rows.append(f"<tr><td></td><td></td><td colspan='2' class='{kind}'>{text}</td></tr>")
    return f"<table class='rows' aria-label='preflight'>{''.join(rows)}</table>" if rows else ""
