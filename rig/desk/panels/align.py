"""Align: the live picture with its figures, exposure, gain and region, the focus, the rest position."""

import html
import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from nicegui import run, ui
from nicegui.events import MouseEventArguments

from acquisition.camera import CameraSettings
from processing.errors import ConfigurationError
from rig.desk import tables
from rig.desk.aligner import EXPOSE, Aligner, Wish
from rig.desk.at_once import at_once
from rig.desk.chart_options import Curve
from rig.desk.charts import Chart
from rig.desk.desk import Desk
from rig.desk.panels.fields import as_typed, number_field
from rig.desk.panels.live_picture import LivePicture, look_now, no_frame_yet
from rig.desk.tab import DELIBERATE, Handler, Tab
from rig.presentation import Verdict

KEYS = (("z", "align: zoom 1, 4, 16"),)
_SIZE = (800, 540)
_STEP, _STEP_DB = 1.25, 1.0
_BARS = 64
_NEEDS = "settings need a live picture"
_SHORT = 24
"""Letters of a number that stands in a lamp."""


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    corner: list[tuple[float, float]] = []
    fields: dict[str, ui.input] = {}
    needing: list[ui.button] = []

    def mouse(event: MouseEventArguments) -> None:
        """A rectangle drawn over the whole frame becomes the camera's region."""
        if desk.aligner is None or picture.zoom != 1:
            return
        if event.type == "pointerdown":
            corner[:] = [(event.image_x, event.image_y)]
        elif corner:
            x, y = corner[0]
            left, top = min(x, event.image_x), min(y, event.image_y)
            width, height = abs(event.image_x - x), abs(event.image_y - y)
            picture.element.content = (
                f"<rect x='{left}' y='{top}' width='{width}' height='{height}' fill='none' "
                "stroke='white' stroke-width='2'/>"
            )
            if event.type == "pointerup":
                corner.clear()
                if min(width, height) > 8:
                    _ask_region(desk, left, top, width, height)
                else:
                    picture.element.content = ""

    def aligner() -> Aligner:
        if desk.aligner is None:
            raise ConfigurationError("no live picture: press Live picture first")
        return desk.aligner

    def wish(wanted: Wish) -> None:
        aligner().wish(wanted)

    def turned(exposure: float = 1.0, gain_db: float = 0.0) -> None:
        def wanted(applied: CameraSettings) -> CameraSettings:
            stated = applied.exposure_us if exposure != 1.0 else applied.gain_db
            if stated is None:
                raise ConfigurationError(
                    "this camera does not report its setting; type a value, then press Set"
                )
            if exposure != 1.0:
                return CameraSettings(exposure_us=stated * exposure)
            return CameraSettings(gain_db=stated + gain_db)

        wish(wanted)

    def typed(name: str, field: ui.input) -> None:
        key, value = f"camera.{name}", as_typed(field.value, True)
        if value == "":
            raise ConfigurationError(f"{key}: the field is empty; type a number, then press Set")
        if fault := desk.fault(key, value):
            raise ConfigurationError(fault)
        wish(CameraSettings.model_validate({name: value}))

    async def whole() -> None:
        picture.element.content = ""
        await run.io_bound(desk.align_whole_sensor)

    async def start() -> None:
        await run.io_bound(desk.begin_aligning)

    async def stop() -> None:
        await run.io_bound(desk.end_aligning)

    def zoom() -> None:
        picture.zoom_on()
        zooming.set_text(f"Zoom {picture.zoom}")

    with ui.element("div").classes("grid align"):
        with ui.column().classes("box"):
            picture = LivePicture(tab, _SIZE, lambda: _seen(desk), lambda: _why_none(desk), mouse)
            with ui.row():
                begin = tab.button("Live picture", start)
                begin.props(f'color="positive" {DELIBERATE}')
                end = tab.button("Stop", stop).props("outline")
                zooming = ui.button("Zoom 1", on_click=zoom).props(
                    'outline aria-label="Zoom to the spot, key z"'
                )
                # it begins the picture anew, and with it the light
                tab.button("Whole sensor", whole).props(f"outline {DELIBERATE}")
                keep = tab.button("Keep for runs", lambda: desk.keep_camera(aligner().applied))
                needing.append(keep.props("outline"))
            kept = ui.label().classes("dim")
        # on a low screen it scrolls by itself: picture and buttons stay
        with (
            ui.column()
            .classes("box scrolls")
            .props('role="region" aria-label="lamps and settings" tabindex="0"')
        ):
            lamps = ui.html(sanitize=False).classes("full-width").props('role="status" aria-label="lamps"')
            note = ui.label().props('role="status"')
            for name, label, down, up, auto in (
                ("exposure_us", "exposure / µs", lambda: turned(1 / _STEP), lambda: turned(_STEP), True),
                (
                    "gain_db",
                    "gain / dB",
                    lambda: turned(gain_db=-_STEP_DB),
                    lambda: turned(gain_db=_STEP_DB),
                    False,
                ),
            ):
                with ui.row().classes("items-center no-wrap full-width"):
                    field = number_field(desk, f"camera.{name}", label, None)
                    field.props("hide-bottom-space stack-label").classes("col")
                    fields[name] = field
                    put = tab.button("Set", partial(typed, name, field))
                    needing.append(put.props(f'outline dense aria-label="Set {label}"').classes("step"))
                    if auto:
                        find = tab.button("Auto", lambda: wish(EXPOSE))
                        needing.append(find.props('outline dense aria-label="Auto exposure"').classes("step"))
                    needing += _stepper(label.partition(" ")[0], down, up, tab)
            histogram = Chart(
                "histogram", "level_dn", (Curve("pixels", style="bars"),), tools=False, height="100px"
            )
            focus = Chart("focus", "elapsed_s", (Curve("sharpness_per_px"),), tools=False, height="110px")
            with at_once(ui.expansion("figures", value=True)).classes("full-width"):
                figures = ui.html(sanitize=False).classes("full-width").props('aria-live="off"')
    tab.key("z", zoom)

    def show_applied(applied: CameraSettings) -> None:
        for name, field in fields.items():
            value = getattr(applied, name)
            said = "" if value is None else f"now {value:.6g}"
            if field.props.get("placeholder") != said:
                field.props(f'placeholder="{said}"')

    def refresh() -> None:
        now = desk.aligner
        begin.set_visibility(now is None)
        end.set_visibility(now is not None)
        for button in needing:
            button.set_enabled(now is not None and now.running)
        zooming.set_enabled(_seen(desk))
        kept.set_text(_kept(desk))
        wrong = "" if now is None else now.problem or now.darkness
        note.set_text(wrong or (_NEEDS if now is None else now.note))
        note.classes(remove="caution dim", add="caution" if wrong else "dim")
        show_applied(CameraSettings() if now is None else now.applied)
        sharpness = [] if now is None else list(now.focus)
        focus.show([sharpness[:: 1 + len(sharpness) // 200]], empty="no sharpness yet")
        look = look_now(desk)
        if look is None:
            figures.set_content("")
            lamps.set_content("")
            histogram.show([[]], empty="no picture yet")
            return
        best = max((one for _, one in sharpness), default=0.0)
        # of a frame that is dark on purpose there is nothing to be judged: why it is stands below
        dark = now is not None and bool(now.darkness)
        lamps.set_content("" if dark else _lamps(look.lamps(best)))
        figures.set_content(tables.table(look.rows(), "figures of the picture"))
        counts, edges = np.histogram(look.image, _BARS, (0, look.full_scale_dn + 1))
        middles = 0.5 * (edges[1:] + edges[:-1])
        bars = [
            (float(at), round(math.log10(1 + count), 3)) for at, count in zip(middles, counts, strict=True)
        ]
        histogram.show([bars])

    tab.every(0.3, refresh)
    refresh()


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


def _stepper(what: str, down: Handler, up: Handler, tab: Tab) -> Iterator[ui.button]:
    for sign, words, do in (("-", "smaller", down), ("+", "larger", up)):
        yield tab.button(sign, do).props(f'outline dense aria-label="{words} {what}"').classes("step")


def _seen(desk: Desk) -> bool:
    return desk.following.running or desk.aligner is not None


def _why_none(desk: Desk) -> str:
    """Why there is no picture; empty if there is one."""
    now = desk.aligner
    if now is not None:
        if now.problem:
            return f"the live picture has ended: {now.problem}"
        return "" if now.look is not None else f"waiting for the first frame. {now.note}"
    if desk.following.running:
        return no_frame_yet(desk.following)
    return "No live picture yet. Press Live picture to light the laser and show the camera's view."


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
