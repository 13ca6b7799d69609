"""Dialogs of the page: a trip that is acknowledged, a session that goes on, the list of keys."""

import html
from collections.abc import Callable, Sequence
from pathlib import Path

from nicegui import run, ui

from rig.control import LatchedTrip
from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab


class TripDialog:
    """Asks before a trip is acknowledged: the one that is read, also if another comes meanwhile."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._asked: LatchedTrip | None = None
        with ui.dialog().props('aria-label="acknowledge a trip"') as self._dialog, ui.card():
            self._text = ui.label().classes("middle")
            ui.label("Check that nobody is in the beam path. Acknowledging lights nothing.")
            with ui.row():
                self._allow = tab.button("Acknowledge", self._acknowledged)
                self._allow.props(f'color="negative" {DELIBERATE}')
                ui.button("Not now", on_click=self._dialog.close).props("outline")

    def ask(self) -> None:
        """Open it for the trip that waits."""
        self._asked = self._desk.safety.trip
        if self._asked is not None:
            self._text.set_text(self._asked.text)
            self._allow.set_text(f"Acknowledge trip {self._asked.number}")
            self._dialog.open()

    async def _acknowledged(self) -> None:
        self._dialog.close()
        if self._asked is not None:
            ui.notify(await run.io_bound(self._desk.lighting.acknowledge, self._asked.number))


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


def keys_dialog(keys: Sequence[tuple[str, str]]) -> ui.dialog:
    """The list of keys, each with what it does."""
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in keys]
    with ui.dialog().props('aria-label="keys"') as dialog, ui.card():
        ui.label("Keys").classes("middle")
        ui.html(f"<table class='rows'>{''.join(lines)}</table>", sanitize=False)
    return dialog
