"""The live picture: of the running session, else of the camera that is being aligned; and on a panel."""

from collections.abc import Callable
from itertools import count

import cv2
import numpy as np
from nicegui import ui
from nicegui.events import MouseEventArguments

from acquisition.camera import CameraSettings
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.tab import Tab
from rig.devices import AlignmentFrame, ReferencePart, annotated_picture, middle_of, picture

INTERVAL_S = 0.1
_NUMBER = count()


class LivePicture:
    """A picture whose address changes; a browser that is slower skips some. `zoom` is 1, 4 or 16."""

    def __init__(
        self,
        desk: Desk,
        tab: Tab,
        size: tuple[int, int],
        on_mouse: Callable[[MouseEventArguments], None] | None = None,
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
        if has_picture(self._desk):
            width, height = self._size
            self.element.set_source(
                f"/picture?width={width}&height={height}&zoom={self.zoom}&n={next(_NUMBER)}"
            )
        elif self.element.source:
            # an old picture would be taken for the present
            self.element.set_source("")


def has_picture(desk: Desk) -> bool:
    """Whether something has the camera whose picture can be asked for."""
    return desk.following.running or desk.aligner is not None


def _why_none(desk: Desk) -> str:
    """Why there is no picture; empty if there is one."""
    now = desk.aligner
    if now is not None:
        if now.problem:
            return f"the live picture has ended: {now.problem}"
        return "" if now.look is not None else f"waiting for the first frame. {now.note}"
    if desk.following.last_picture is not None:
        return ""
    if desk.following.running:
        phase = doing(desk.following.news.get("state"))
        return f"no frame yet: {phase or 'opening devices, compiling kernels'}"
    return "No live picture yet. Press Live picture to light the laser and show the camera's view."


def look_now(desk: Desk) -> AlignmentFrame | None:
    """The newest look that is here; None without one. Never blocks.

    Of a session's beam nothing is judged here: its state says it.
    """
    aligner = desk.aligner
    if aligner is not None:
        return aligner.look
    seen, camera = desk.following.last_picture, desk.following.news.get("camera") or {}
    if seen is None or "full_scale_dn" not in camera:
        return None
    full_scale_dn, config = int(camera["full_scale_dn"]), desk.following.config
    own, reference = seen.image, None
    if config is not None and config.reference is not None and seen.reference is not None:
        row = config.reference.from_row_px
        reference = ReferencePart.in_image(seen.reference, row, seen.image, full_scale_dn)
        own = seen.image[:row]
    figures = picture.figures(own, full_scale_dn)
    middle_px = middle_of(seen.image, None if config is None else config.lever_reference_px)
    applied = CameraSettings.model_validate(camera["applied"])
    return AlignmentFrame(
        seen.image, full_scale_dn, figures, seen.spot, middle_px, applied, reference=reference
    )


def picture_now(desk: Desk, width_px: int, height_px: int, zoom: float) -> bytes:
    """The newest look as PNG of this size, with all that is drawn into it; black without one. Blocks.

    A page that asks for it is being looked at: the live picture stays lit.
    """
    aligner = desk.aligner
    if aligner is None:
        desk.following.picture()
    else:
        aligner.looked_at()
    look = look_now(desk)
    shown = np.zeros((height_px, width_px, 3), np.uint8)
    if look is not None:
        drawn = annotated_picture(look, width_px, height_px, zoom)
        rows, columns = drawn.shape[:2]
        left, top = (width_px - columns) // 2, (height_px - rows) // 2
        shown[top : top + rows, left : left + columns] = drawn
    done, png = cv2.imencode(".png", shown[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return png.tobytes() if done else b""
