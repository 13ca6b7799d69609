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
from rig.desk.aligner import Aligner
from rig.desk.charts import Chart, ChartCurve
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.panels.between_runs import as_typed, setting_field
from rig.desk.panels.live_picture import LivePicture, has_picture, look_now
from rig.desk.tab import DELIBERATE, Handler, Tab, apart, box
from rig.devices import AlignmentFrame
from rig.terminal import Verdict

KEYS = (("z", "rig: zoom 1, 4, 16"),)
_SIZE = (800, 540)
_STEP, _STEP_DB = 1.25, 1.0
_BARS = 64
_LEAST_REGION_PX = 8
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


def aligner_of(desk: Desk) -> Aligner:
    """The live picture; raises ConfigurationError without one."""
    if desk.aligner is None:
        raise ConfigurationError("no live picture: press Live picture first")
    return desk.aligner


def _build_picture(desk: Desk, tab: Tab) -> None:
    """The live picture with its buttons; a rectangle drawn over the whole frame is the camera's region."""
    corner: tuple[float, float] | None = None

    def mouse(event: MouseEventArguments) -> None:
        nonlocal corner
        if desk.aligner is None or picture.zoom != 1:
            return
        if event.type == "pointerdown":
            corner = event.image_x, event.image_y
        elif corner is not None:
            pointed = event.image_x, event.image_y
            (left, right), (top, bottom) = (sorted(ends) for ends in zip(corner, pointed, strict=True))
            width, height = right - left, bottom - top
            is_region = event.type != "pointerup" or min(width, height) > _LEAST_REGION_PX
            if event.type == "pointerup":
                corner = None
                if is_region:
                    _ask_region(desk, left, top, width, height)
            drawn = (
                f"<rect x='{left}' y='{top}' width='{width}' height='{height}' fill='none' "
                "stroke='white' stroke-width='2'/>"
            )
            picture.element.content = drawn if is_region else ""

    async def whole() -> None:
        picture.element.content = ""
        await run.io_bound(desk.align_whole_sensor)

    def kept() -> str:
        numbers = ((key, value) for key, value in desk.kept.items() if isinstance(value, int | float))
        lines = ", ".join(f"{key} = {value:g}" for key, value in numbers)
        return f"used for everything this desk starts: {lines}" if lines else ""

    def is_on() -> bool:
        return desk.aligner is not None

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
            enabled=lambda: has_picture(desk),
        )
        # it begins the picture anew, and with it the light
        tab.button("Whole sensor", whole, f"outline {DELIBERATE}")
        tab.button(
            "Keep for runs",
            lambda: desk.keep_camera(aligner_of(desk).applied),
            "outline",
            enabled=lambda: is_on() and aligner_of(desk).running,
        )
    tab.label(kept, "dim")


def _ask_region(desk: Desk, left: float, top: float, width: float, height: float) -> None:
    """Ask the camera for the rectangle, which is in px of the picture."""
    aligner = aligner_of(desk)
    if (look := aligner.look) is None:
        return
    rows, columns = look.image.shape
    scale = min(_SIZE[0] / columns, _SIZE[1] / rows)
    # the frame is in the middle of the picture
    left -= 0.5 * (_SIZE[0] - columns * scale)
    top -= 0.5 * (_SIZE[1] - rows * scale)
    aligner.wish_region(*(round(one / scale) for one in (left, top, width, height)))


def _build_controls(desk: Desk, tab: Tab) -> None:
    """Lamps of the beam, exposure and gain, histogram, focus and figures of the picture."""

    look: AlignmentFrame | None = None

    def take() -> None:
        nonlocal look
        look = look_now(desk)

    def lamps() -> str:
        now = desk.aligner
        # of a frame that is dark on purpose there is nothing to be judged: why it is stands below
        if look is None or (now is not None and now.darkness):
            return ""
        best = max((one for _, one in (tuple(now.focus) if now else ())), default=0.0)
        return _lamps(look.lamps(best))

    def note() -> str:
        now = desk.aligner
        if now is None:
            return tables.span("settings need a live picture", "dim")
        wrong = now.problem or now.darkness
        return tables.span(wrong or now.note, "caution" if wrong else "dim")

    def figures() -> str:
        return "" if look is None else tables.table(look.rows(), "figures of the picture")

    def draw() -> None:
        now = desk.aligner
        sharpness = [] if now is None else list(now.focus)
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
    _build_setting(desk, tab, "exposure_us", "exposure / µs", lambda us, sense: us * _STEP**sense)
    _build_setting(desk, tab, "gain_db", "gain / dB", lambda db, sense: db + sense * _STEP_DB)
    histogram = Chart("histogram", "level_dn", (ChartCurve("pixels", style="bar"),), "small")
    focus = Chart("focus", "elapsed_s", (ChartCurve("sharpness_per_px"),), "small")
    tab.html(figures, props='aria-live="off"')
    tab.keep(draw)


def _build_setting(desk: Desk, tab: Tab, name: str, label: str, step: Callable[[float, int], float]) -> None:
    """A row for one setting: field, Set, for the exposure Auto, and a step down (-1) and up (1)."""
    what, key = label.partition(" ")[0], f"camera.{name}"

    def ask(wish: Callable[[CameraSettings], CameraSettings]) -> None:
        aligner_of(desk).wish(wish)
        # empty, the field says what the camera has now
        field.set_value("")

    def auto() -> None:
        aligner_of(desk).wish_exposure()
        field.set_value("")

    def small(text: str, do: Handler, words: str) -> None:
        tab.button(
            text,
            do,
            f'outline dense aria-label="{words}"',
            enabled=lambda: desk.aligner is not None and desk.aligner.running,
        ).classes("step")

    def typed() -> None:
        value = as_typed(field.value, True)
        if value == "":
            raise ConfigurationError(f"{key}: the field is empty; type a number, then press Set")
        if fault := desk.fault(key, value):
            raise ConfigurationError(fault)
        wanted = CameraSettings.model_validate({name: value})
        ask(lambda _: wanted)

    def turned(sense: int) -> None:
        def wanted(applied: CameraSettings) -> CameraSettings:
            stated = getattr(applied, name)
            if stated is None:
                raise ConfigurationError(
                    "this camera does not report its setting; type a value, then press Set"
                )
            return CameraSettings.model_validate({name: step(stated, sense)})

        ask(wanted)

    def hint() -> None:
        value = None if desk.aligner is None else getattr(desk.aligner.applied, name)
        placeholder = "" if value is None else f"now {value:.6g}"
        if field.props.get("placeholder") != placeholder:
            field.props(f'placeholder="{placeholder}"')

    with ui.row().classes("items-center no-wrap full-width"):
        field = setting_field(desk, key, label, None, is_number=True)
        field.props("hide-bottom-space stack-label").classes("col")
        tab.keep(hint)
        small("Set", typed, f"Set {label}")
        if name == "exposure_us":
            small("Auto", auto, "Auto exposure")
        small("-", partial(turned, -1), f"smaller {what}")
        small("+", partial(turned, 1), f"larger {what}")


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
