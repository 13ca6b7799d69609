"""The live picture on a panel: asked for ten times a second, only while the panel is seen."""

from collections.abc import Callable
from itertools import count

from nicegui import ui
from nicegui.events import MouseEventArguments

from rig.desk.following import Following, doing
from rig.desk.tab import Tab

INTERVAL_S = 0.1
_NUMBER = count()


class LivePicture:
    """A picture whose address changes; a browser that is slower skips some. `zoom` is 1, 4 or 16.

    `wanted` says whether there is something to ask for, `why_none` why nothing is to be seen, in its place;
    empty where there is a picture.
    """

    def __init__(
        self,
        tab: Tab,
        size: tuple[int, int],
        wanted: Callable[[], bool],
        why_none: Callable[[], str],
        on_mouse: Callable[[MouseEventArguments], None] | None = None,
    ) -> None:
        self._size = size
        self._wanted = wanted
        self._why_none = why_none
        self.zoom = 1
        width, height = size
        with ui.element("div").classes("full-width relative-position"):
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
        why = self._why_none()
        self._words.set_text(why)
        self._words.set_visibility(bool(why))
        if self._wanted():
            width, height = self._size
            self.element.set_source(
                f"/picture?width={width}&height={height}&zoom={self.zoom}&n={next(_NUMBER)}"
            )
        elif self.element.source:
            # an old picture would be taken for the present
            self.element.set_source("")


def no_frame_yet(following: Following) -> str:
    """Why a session that runs shows no frame; empty if it does."""
    if following.has_picture:
        return ""
    phase = doing(following.news.get("state"))
    return f"no frame yet: {phase or 'devices are opened, kernels compiled'}"
