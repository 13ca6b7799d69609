"""Rig: what the camera sees with its figures, exposure and region, then the checks before a run."""

import html
import json
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from nicegui import run, ui
from nicegui.events import MouseEventArguments

from acquisition.camera import CameraSettings
from processing.errors import ConfigurationError
from rig.desk import tables
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.panels.between_runs import as_typed
from rig.desk.panels.live_picture import LivePicture, look_now
from rig.desk.tab import DELIBERATE, Handler, Tab, apart, box, text_field
from rig.devices import AlignmentFrame
from rig.terminal import Verdict

KEYS = (("z", "rig: zoom 1, 4, 16"),)
_SIZE = (800, 540)
_BARS = 64
_MIN_REGION_PX = 8
_SHORT = 24
"""Letters of a number that stands in a lamp."""


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    with ui.element("div").classes("grid align"):
        with ui.column().classes("box"):
            _build_picture(desk, tab)
        # on a low screen it scrolls by itself: picture and buttons stay
        with box("", "scrolls", region="lamps and settings"):
            _build_controls(desk, tab)
    with ui.column().classes("box"):
        _build_checks(desk, tab)


def _build_picture(desk: Desk, tab: Tab) -> None:
    """The live picture with its buttons; a rectangle drawn over the whole frame is the camera's region."""
    corner: tuple[float, float] | None = None

    async def mouse(event: MouseEventArguments) -> None:
        nonlocal corner
        if desk.live_picture is None or picture.zoom != 1:
            return
        if event.type == "pointerdown":
            corner = event.image_x, event.image_y
        elif corner is not None:
            pointed = event.image_x, event.image_y
            (left, right), (top, bottom) = (sorted(ends) for ends in zip(corner, pointed, strict=True))
            width, height = right - left, bottom - top
            is_region = event.type != "pointerup" or min(width, height) > _MIN_REGION_PX
            if event.type == "pointerup":
                corner = None
            rectangle = (
                f"<rect x='{left}' y='{top}' width='{width}' height='{height}' fill='none' "
                "stroke='white' stroke-width='2'/>"
            )
            picture.element.content = rectangle if is_region else ""
            if corner is None and is_region and (look := look_now(desk)) is not None:
                region = region_drawn(look, (left, right), (top, bottom))
                order = f"set {region.model_dump_json(exclude_none=True)}"
                await tab.act(partial(_order, desk, order))()

    async def whole() -> None:
        picture.element.content = ""
        await run.io_bound(desk.align_whole_sensor)

    def kept() -> str:
        numbers = ((key, value) for key, value in desk.kept.items() if isinstance(value, int | float))
        lines = ", ".join(f"{key} = {value:g}" for key, value in numbers)
        return f"used for everything this desk starts: {lines}" if lines else ""

    def is_on() -> bool:
        return desk.live_picture is not None

    picture = LivePicture(desk, tab, _SIZE, mouse)
    tab.key("z", picture.zoom_on)
    with ui.row():
        begin = apart(desk.begin_aligning)
        tab.button("Live picture", begin, f'color="positive" {DELIBERATE}', seen=lambda: not is_on())
        tab.button("Stop", apart(desk.end_aligning), "outline", seen=is_on)
        tab.button(
            lambda: f"Zoom {picture.zoom}",
            picture.zoom_on,
            'outline aria-label="Zoom to the spot, key z"',
            enabled=lambda: desk.shown is not None,
        )
        # it begins the picture anew, and with it the light
        tab.button("Whole sensor", whole, f"outline {DELIBERATE}")
        tab.button("Keep for runs", desk.keep_camera, "outline", enabled=lambda: look_now(desk) is not None)
    tab.label(kept, "dim")


async def _order(desk: Desk, order: str) -> None:
    """Give the live picture an order, whose result its note says."""
    await run.io_bound(desk.following.order, order)


def region_drawn(
    look: AlignmentFrame, x_ends: tuple[float, float], y_ends: tuple[float, float]
) -> CameraSettings:
    """Region of the sensor inside a rectangle in px of the picture; the frame may itself be a region."""
    rows, columns = look.image.shape
    scale = min(_SIZE[0] / columns, _SIZE[1] / rows)
    x_px, width_px = _span_px(x_ends, _SIZE[0], columns, scale)
    y_px, height_px = _span_px(y_ends, _SIZE[1], rows, scale)
    return CameraSettings(
        width_px=width_px,
        height_px=height_px,
        offset_x_px=(look.applied.offset_x_px or 0) + x_px,
        offset_y_px=(look.applied.offset_y_px or 0) + y_px,
    )


def _span_px(ends: tuple[float, float], picture_px: int, frame_px: int, scale: float) -> tuple[int, int]:
    """First pixel and number of pixels of the frame, centred in the picture, between two ends of it."""
    margin = 0.5 * (picture_px - frame_px * scale)
    first, last = (min(max(round((end - margin) / scale), 0), frame_px) for end in ends)
    first = max(0, min(first, frame_px - _MIN_REGION_PX))
    return first, max(last - first, min(_MIN_REGION_PX, frame_px))


def _build_controls(desk: Desk, tab: Tab) -> None:
    """Lamps of the beam, exposure and gain, histogram, focus and figures of the picture."""

    look: AlignmentFrame | None = None

    def take() -> None:
        nonlocal look
        look = look_now(desk)

    def lamps() -> str:
        # of a frame that is dark on purpose there is nothing to be judged: why it is stands below
        if look is None or desk.shown is None or desk.shown.state.get("dark"):
            return ""
        return _lamps(look.lamps(max((one for _, one in tuple(desk.shown.focus)), default=0.0)))

    def note() -> str:
        if desk.live_picture is None:
            return tables.span("settings need a live picture", "dim")
        state = desk.following.state
        dark = str(state.get("dark") or "")
        return tables.span(dark or str(state.get("note") or ""), "caution" if dark else "dim")

    def figures() -> str:
        return "" if look is None else tables.table(look.rows(), "figures of the picture")

    def draw() -> None:
        sharpness = [] if desk.shown is None else list(desk.shown.focus)
        since_s = sharpness[0][0] if sharpness else 0.0
        sharpness = [(at_s - since_s, value) for at_s, value in sharpness]
        focus.show([sharpness[:: 1 + len(sharpness) // 200]], empty="no sharpness yet")
        if look is None:
            histogram.show([[]], empty="no picture yet")
            return
        counts, edges = np.histogram(look.image, _BARS, (0, look.full_scale_dn + 1))
        middles = 0.5 * (edges[1:] + edges[:-1])
        histogram.show(
            [[(float(at), round(math.log10(1 + n), 3)) for at, n in zip(middles, counts, strict=True)]]
        )

    tab.keep(take)
    tab.html(lamps, props='role="status" aria-label="lamps"')
    tab.html(note, props='role="status"')
    _build_setting(desk, tab, "exposure_us", "exposure / µs", "eE")
    _build_setting(desk, tab, "gain_db", "gain / dB", "gG")
    histogram = Chart("histogram", "level_dn", (ChartCurve("pixels", style="bar"),), "small")
    focus = Chart("focus", "elapsed_s", (ChartCurve("sharpness_per_px"),), "small")
    tab.html(figures, props='aria-live="off"')
    tab.keep(draw)


def _build_setting(desk: Desk, tab: Tab, name: str, label: str, keys: str) -> None:
    """A row for one setting: field, Set, Auto for the exposure, steps down and up by the keys of `rig`."""
    what, key = label.partition(" ")[0], f"camera.{name}"

    async def ask(order: str) -> None:
        # empty, the field says what the camera has now
        field.set_value("")
        await _order(desk, order)

    def small(text: str, do: Handler, words: str) -> None:
        tab.button(
            text, do, f'outline dense aria-label="{words}"', enabled=lambda: desk.live_picture is not None
        ).classes("step")

    async def typed() -> None:
        value = as_typed(field.value, True)
        if value == "":
            raise ConfigurationError(f"{key}: the field is empty; type a number, then press Set")
        desk.checked({key: value})
        await ask(f"set {json.dumps({name: value})}")

    def hint() -> None:
        value = None if desk.live_picture is None else getattr(desk.following.applied, name)
        placeholder = "" if value is None else f"now {value:.6g}"
        if field.props.get("placeholder") != placeholder:
            field.props(f'placeholder="{placeholder}"')

    with ui.row().classes("items-center no-wrap full-width"):
        field = text_field(label, key=key)
        field.props("hide-bottom-space stack-label").classes("col")
        tab.keep(hint)
        small("Set", typed, f"Set {label}")
        if name == "exposure_us":
            small("Auto", partial(ask, "key a"), "Auto exposure")
        for text, key_, words in zip("-+", keys, ("smaller", "larger"), strict=True):
            small(text, partial(ask, f"key {key_}"), f"{words} {what}")


def _lamps(verdicts: Sequence[Verdict]) -> str:
    """A lamp for each verdict, with the remedies below."""
    shown, remedies = [], []
    for one in verdicts:
        kind = "no" if not one.ok else "caution" if one.remedy else "go"
        # a beam's verdict is a sentence; it is among the figures
        shown.append(tables.span(f"{one.name} {one.measured if len(one.measured) < _SHORT else kind}", kind))
        if one.remedy:
            why = "; ".join(filter(None, (one.reason, one.remedy)))
            remedies.append(tables.span(f"{one.name}: {why}", kind, "div"))
    return f"<div class='lamps'>{''.join(shown)}</div>{''.join(remedies)}"


def _build_checks(desk: Desk, tab: Tab) -> None:
    """The button that runs the checks, and what they have found."""

    def runs() -> bool:
        return "doctor" in desk.jobs and desk.jobs["doctor"].running

    def end() -> None:
        desk.jobs["doctor"].end()

    with ui.row().classes("items-center"):
        check = apart(desk.start, "doctor", "--preflight", "--json")
        props = f'color="positive" size="lg" {DELIBERATE}'
        tab.button("Run preflight", check, props, enabled=lambda: not runs())
        tab.button("End", end, "outline", seen=lambda: runs() and not _verdicts(desk))
    tab.html(lambda: checks(desk))


def _verdicts(desk: Desk) -> Sequence[Mapping[str, Any]]:
    """What the running session, or the last command, has found; empty before."""
    job = desk.jobs.get("doctor")
    of_command = {} if job is None else job.newest.get("preflight", {})
    found: Sequence[Mapping[str, Any]] = desk.following.news.get("preflight") or of_command.get("table", ())
    return found


def checks(desk: Desk) -> str:
    """The verdict, the next step, and a light for each check, failed ones first; before: its progress."""
    found, job = _verdicts(desk), desk.jobs.get("doctor")
    if not found:
        if job is None:
            return tables.span("it checks whether a run can be made")
        if job.running:
            # before its first state it may compile
            opening = job.output[-1] if job.output else "the camera is opened"
            return tables.span(doing(job.newest.get("state")) or opening)
        return tables.span("" if job.ending else job.problem, "no")
    failed = [one for one in found if not one["ok"]]
    shown_first = failed + [one for one in found if one["ok"] and (one["remedy"] or not one["made"])]
    passed = [one for one in found if one not in shown_first]
    what = "This stands" if len(failed) == 1 else f"These {len(failed)} stand"
    then = f"{what} against a run: follow the remedies below, then run preflight again."
    then = then if failed else "Nothing prevents a run: start it in Measure."
    verdict = tables.span("NO-GO" if failed else "GO", "advice no" if failed else "advice go")
    counted = f"{len(passed)} of {len(found)} checks passed"
    return (
        f"<div role='status'>{verdict} {'' if desk.following.running else then}</div>{lights(shown_first)}"
        + (f"<details><summary>{counted}</summary>{lights(passed)}</details>" if passed else "")
    )


def lights(verdicts: Sequence[Mapping[str, Any]]) -> str:
    """A row for each verdict: its light, its number against the limit, reason and remedy."""
    rows = []
    for one in verdicts:
        kind, judged = (
            ("no", "NO-GO") if not one["ok"]
            else ("caution", "caution") if one["remedy"]
            else ("go", "go") if one["made"]
            else ("dim", "not checked")
        )  # fmt: skip
        name, measured, limit, *why = (
            html.escape(str(one[key])) for key in ("name", "measured", "limit", "reason", "remedy")
        )
        rows.append(
            f"<tr><td class='{kind} judged'><span class='light' style='background: currentcolor'></span>"
            f"{judged}</td><th scope='row'>{name}</th><td>{measured}</td><td class='dim'>{limit}</td></tr>"
        )
        if any(why):
            reasons = "; ".join(filter(None, why))
            rows.append(f"<tr><td></td><td></td><td colspan='2' class='{kind}'>{reasons}</td></tr>")
    return f"<table class='rows' aria-label='preflight'>{''.join(rows)}</table>" if rows else ""
