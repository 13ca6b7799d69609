"""The live picture of the running session, else of the camera that is being aligned."""

from collections.abc import Callable
from itertools import count

import cv2
import numpy as np
from nicegui import ui
from nicegui.events import MouseEventArguments

from rig.desk.desk import Desk
from rig.desk.follower import phase_text
from rig.desk.tab import Tab
from rig.devices import AlignmentFrame, annotated_picture

_INTERVAL_S = 0.2
"""A picture is that of the request before, so this is its age, too."""
_QUALITY = (cv2.IMWRITE_JPEG_QUALITY, 90)
# the colours of neighbours are not averaged: a single saturated pixel keeps its own
_SAMPLING = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
_NUMBERS = count()


class LivePicture:
    """A picture whose address changes with each frame; a slow browser skips frames. `zoom` is 1, 4 or 16."""

    def __init__(
        self,
        desk: Desk,
        tab: Tab,
        size: tuple[int, int],
        on_mouse: Callable[[MouseEventArguments], object] | None = None,
    ) -> None:
        self._desk, self._size = desk, size
        self.zoom = 1
        width, height = size
        with ui.element("div").classes("relative-position camera").style(f"--aspect: {width / height:.4f}"):
            self.element = ui.interactive_image(
                size=(width, height), on_mouse=on_mouse, events=["pointerdown", "pointerup", "pointermove"]
            )
            self.element.classes("picture full-width")
            self.element.props('role="img" aria-label="live picture of the camera"')
            self._label = ui.label().classes("absolute-center why-none").props('role="status"')
        tab.on_interval(_INTERVAL_S, self._refresh)
        self._refresh()

    def next_zoom(self) -> None:
        """Go on to the next zoom."""
        self.zoom = {1: 4, 4: 16, 16: 1}[self.zoom]

    def _refresh(self) -> None:
        why = _why_none(self._desk)
        self._label.set_text(why)
        self._label.set_visibility(bool(why))
        if self._desk.picture_source is not None:
            width, height = self._size
            self.element.set_source(
                f"/picture?width={width}&height={height}&zoom={self.zoom}&n={next(_NUMBERS)}"
            )
        elif self.element.source:
            # an old picture could be taken for the present one
            self.element.set_source("")


def _why_none(desk: Desk) -> str:
    """Why there is no picture; empty if there is one."""
    source, job = desk.picture_source, desk.live_picture
    if source is not None and source.frame is not None:
        return ""
    if job is not None:
        return f"waiting for the first frame. {job.output[-1] if job.output else ''}"
    if source is not None:
        return f"no frame yet: {phase_text(source.state) or 'opening devices, compiling kernels'}"
    if desk.picture_problem:
        return f"the live picture has ended: {desk.picture_problem}"
    return "No live picture yet. Press Live picture to light the laser and show the camera's view."


def newest_frame(desk: Desk) -> AlignmentFrame | None:
    """The newest frame that the desk has; None without one. Never blocks."""
    return None if desk.picture_source is None else desk.picture_source.frame


def picture_now(desk: Desk, width_px: int, height_px: int, zoom: float) -> bytes:
    """The newest frame as JPEG of this size, annotated; black without a frame. Blocks.

    A request shows that the page is being looked at: the live picture stays lit.
    """
    if desk.picture_source is not None:
        desk.picture_source.ask_picture()
    frame = newest_frame(desk)
    canvas = np.zeros((height_px, width_px, 3), np.uint8)
    if frame is not None:
        picture = annotated_picture(frame, width_px, height_px, zoom)
        rows, columns = picture.shape[:2]
        left, top = (width_px - columns) // 2, (height_px - rows) // 2
        canvas[top : top + rows, left : left + columns] = picture
    # a PNG takes ten times as long
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(canvas, cv2.COLOR_RGB2BGR), (*_QUALITY, *_SAMPLING))
    return jpeg.tobytes()
