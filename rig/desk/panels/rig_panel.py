"""Rig: what the camera sees with its exposure, then the checks before a run, on one panel."""

from nicegui import ui

from rig.desk.desk import Desk
from rig.desk.panels.align import AlignPicture, CameraControls
from rig.desk.panels.preflight import Expected, PreflightChecks
from rig.desk.tab import Tab

KEYS = (("z", "rig: zoom 1, 4, 16"),)


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    with ui.element("div").classes("grid align"):
        picture = AlignPicture(desk, tab)
        controls = CameraControls(desk, tab)
    with ui.element("div").classes("grid wide-left"):
        checks = PreflightChecks(desk, tab)
        Expected(desk, tab)

    def refresh() -> None:
        picture.refresh()
        controls.refresh()
        checks.refresh()

    tab.key("z", picture.zoom)
    tab.every(0.3, refresh)
    refresh()
