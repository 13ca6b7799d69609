"""The live picture on a panel: asked for ten times a second, only while the panel is seen."""

from collections.abc import Callable
from itertools import count

from nicegui import ui
from nicegui.events import MouseEventArguments

from rig.desk.tab import Tab

INTERVAL_S = 0.1
_NUMBER = count()


class LivePicture:
    """A picture whose address changes; a browser that is slower skips some. `zoom` is 1, 4 or 16."""

    def __init__(
        self,
        tab: Tab,
        size: tuple[int, int],
        wanted: Callable[[], bool],
        on_mouse: Callable[[MouseEventArguments], None] | None = None,
    ) -> None:
        self._size = size
        self._wanted = wanted
        self.zoom = 1
        width, height = size
        self.element = ui.interactive_image(
            size=(width, height), on_mouse=on_mouse, events=["mousedown", "mouseup", "mousemove"]
        )
        self.element.classes("picture full-width").props('role="img" aria-label="live picture of the camera"')
        tab.every(INTERVAL_S, self._refresh)

    def zoom_on(self) -> None:
        """The next zoom."""
        self.zoom = {1: 4, 4: 16, 16: 1}[self.zoom]

    def _refresh(self) -> None:
        if self._wanted():
            width, height = self._size
            self.element.set_source(
                f"/picture?width={width}&height={height}&zoom={self.zoom}&n={next(_NUMBER)}"
            )
