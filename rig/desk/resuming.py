"""Resume: the dialog that asks before the missing runs of an interrupted session are made."""

from collections.abc import Callable
from pathlib import Path

from nicegui import run, ui

from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab


def resume_dialog(desk: Desk, tab: Tab) -> Callable[[Path], None]:
    """Build it where it is made; returns what opens it for a session's folder."""
    asked: Path | None = None

    async def resume() -> None:
        begin.close()
        if (folder := asked) is not None:
            await run.io_bound(desk.resume_session, folder)
            ui.notify(f"{folder} continues; see Measure")

    with ui.dialog().props('aria-label="go on with a session"') as begin, ui.card():
        what = ui.label().classes("middle")
        ui.label("The laser will be lit. Check that nobody is in the beam path.")
        with ui.row():
            tab.button("Go on with it", resume).props(f'color="positive" {DELIBERATE}')
            ui.button("Not now", on_click=begin.close).props("outline")

    def ask(folder: Path) -> None:
        nonlocal asked
        asked = folder
        what.set_text(f"Make the missing runs of {folder}?")
        begin.open()

    return ask
