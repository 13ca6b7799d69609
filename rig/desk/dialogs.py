"""Dialogs of the page: questions before anything is lit or allowed light, and the list of keys."""

from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

from nicegui import run, ui

from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab
from rig.desk.tables import table

_LIT = "The laser will be lit. Check that nobody is in the beam path."


class Question:
    """A dialog that asks before something is done.

    `label` is its name for screen readers, `warning` tells what to check before the button `yes` is pressed,
    `properties` are those of this button; `options` holds elements that a caller adds above the buttons.
    """

    def __init__(
        self,
        tab: Tab,
        label: str,
        yes: str,
        warning: str = _LIT,
        *,
        no: str = "Not now",
        properties: str = f'color="positive" {DELIBERATE}',
    ) -> None:
        with ui.dialog().props(f'aria-label="{label}"') as self._dialog, ui.card():
            self._text = ui.label().classes("middle")
            ui.label(warning)
            self.options = ui.element("div")
            with ui.row():
                self._yes = tab.button(yes, lambda: self._dialog.submit(True), properties)
                ui.button(no, on_click=self._dialog.close).props("outline")

    async def ask(self, text: str, yes: str = "") -> bool:
        """Open it, and wait for the answer; `yes` replaces the text of the button."""
        self._text.set_text(text)
        if yes:
            self._yes.set_text(yes)
        return bool(await self._dialog)


def trip_dialog(desk: Desk, tab: Tab) -> Callable[[], Awaitable[None]]:
    """Build the dialog; returns the action that asks, and acknowledges the trip that was shown."""
    warning = "Check that nobody is in the beam path. Acknowledging lights nothing."
    properties = f'color="negative" {DELIBERATE}'
    question = Question(tab, "acknowledge a trip", "Acknowledge", warning, properties=properties)

    async def acknowledge() -> None:
        trip = desk.safety.trip
        if trip is not None and await question.ask(trip.text, f"Acknowledge trip {trip.number}"):
            ui.notify(await run.io_bound(desk.lighting.acknowledge, trip.number))

    return acknowledge


def resume_dialog(desk: Desk, tab: Tab) -> Callable[[Path], Awaitable[None]]:
    """Build the dialog; returns the action that asks, and measures a session's missing runs."""
    question = Question(tab, "go on with a session", "Go on with it")

    async def resume(folder: Path) -> None:
        if await question.ask(f"Measure the missing runs of {folder}?"):
            await run.io_bound(desk.resume_session, folder)
            ui.notify(f"{folder} continues; see Measure")

    return resume


def keys_dialog(keys: Sequence[tuple[str, str]]) -> ui.dialog:
    """The list of keys, each with what it does."""
    with ui.dialog().props('aria-label="keys"') as dialog, ui.card():
        ui.label("Keys").classes("middle")
        ui.html(table(keys, "keys and what they do"), sanitize=False)
    return dialog
