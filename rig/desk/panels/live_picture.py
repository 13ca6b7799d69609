"""The live picture: of the running session, else of the camera that is being aligned; and on a panel."""

from collections.abc import Callable
from itertools import count

import cv2
import numpy as np
from nicegui import ui
from nicegui.events import MouseEventArguments

from rig.desk.desk import Desk
from rig.desk.tab import Tab
from rig.devices import AlignmentFrame, annotated_picture

INTERVAL_S = 0.1
_NUMBER = count()


class LivePicture:
    """A picture whose address changes; a browser that is slower skips some. `zoom` is 1, 4 or 16."""

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
            self._words = ui.label().classes("absolute-center why-none").props('role="status"')
        tab.every(INTERVAL_S, self._refresh)
        self._refresh()

    def zoom_on(self) -> None:
        """The next zoom."""
        self.zoom = {1: 4, 4: 16, 16: 1}[self.zoom]

    def _refresh(self) -> None:
        why = _why_none(self._desk)
        self._words.set_text(why)
        self._words.set_visibility(bool(why))
        if self._desk.shown is not None:
            width, height = self._size
            self.element.set_source(
                f"/picture?width={width}&height={height}&zoom={self.zoom}&n={next(_NUMBER)}"
            )
        elif self.element.source:
            # an old picture would be taken for the present
            self.element.set_source("")


def _why_none(desk: Desk) -> str:
    """Why there is no picture; empty if there is one."""
    shown, job = desk.shown, desk.live_picture
    if shown is not None and shown.look is not None:
        return ""
    if job is not None:
        return f"waiting for the first frame. {job.output[-1] if job.output else ''}"
    if shown is not None:
        return f"no frame yet: {shown.doing or 'opening devices, compiling kernels'}"
    if desk.picture_problem:
        return f"the live picture has ended: {desk.picture_problem}"
    return "No live picture yet. Press Live picture to light the laser and show the camera's view."


def look_now(desk: Desk) -> AlignmentFrame | None:
    """The newest look that is here; None without one. Never blocks."""
    return None if desk.shown is None else desk.shown.look


def picture_now(desk: Desk, width_px: int, height_px: int, zoom: float) -> bytes:
    """The newest look as PNG of this size, with all that is drawn into it; black without one. Blocks.

    A page that asks for it is being looked at: the live picture stays lit.
    """
    if desk.shown is not None:
        desk.shown.ask_picture()
    look = look_now(desk)
    shown = np.zeros((height_px, width_px, 3), np.uint8)
    if look is not None:
        drawn = annotated_picture(look, width_px, height_px, zoom)
        rows, columns = drawn.shape[:2]
        left, top = (width_px - columns) // 2, (height_px - rows) // 2
        shown[top : top + rows, left : left + columns] = drawn
    done, png = cv2.imencode(".png", shown[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return png.tobytes() if done else b""
