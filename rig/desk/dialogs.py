"""Dialogs of a page: questions before anything is lit or allowed light, and the list of keys."""

import html
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Generic, TypeVar

from nicegui import run, ui

from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab

T = TypeVar("T")


class Question(Generic[T]):
    """A dialog that asks before `do` is done with what it was asked about; built where it is made.

    `label` is its name for those who do not see it, `warning` what is to be checked before `yes`; `options`
    holds what a caller adds between them and the buttons.
    """

    def __init__(
        self,
        tab: Tab,
        label: str,
        warning: str,
        yes: str,
        do: Callable[[T], Awaitable[None]],
        colour: str = "positive",
    ) -> None:
        self._do = do
        self._about: T | None = None
        with ui.dialog().props(f'aria-label="{label}"') as self._dialog, ui.card():
            self._text = ui.label().classes("middle")
            ui.label(warning)
            self.options = ui.element("div")
            with ui.row():
                self._yes = tab.button(yes, self._answered).props(f'color="{colour}" {DELIBERATE}')
                ui.button("Not now", on_click=self._dialog.close).props("outline")

    def ask(self, about: T, text: str, yes: str = "") -> None:
        """Open it; `yes` takes the place of the button's words."""
        self._about = about
        self._text.set_text(text)
        if yes:
            self._yes.set_text(yes)
        self._dialog.open()

    async def _answered(self) -> None:
        self._dialog.close()
        if self._about is not None:
            await self._do(self._about)


def trip_dialog(desk: Desk, tab: Tab) -> Callable[[], None]:
    """Build it; returns what asks before the trip that is read is acknowledged, also if another one comes."""

    async def acknowledge(number: int) -> None:
        ui.notify(await run.io_bound(desk.lighting.acknowledge, number))

    warning = "Check that nobody is in the beam path. Acknowledging lights nothing."
    question = Question(tab, "acknowledge a trip", warning, "Acknowledge", acknowledge, "negative")

    def ask() -> None:
        if (trip := desk.safety.trip) is not None:
            question.ask(trip.number, trip.text, f"Acknowledge trip {trip.number}")

    return ask


def resume_dialog(desk: Desk, tab: Tab) -> Callable[[Path], None]:
    """Build it; returns what asks before a session's missing runs are measured."""

    async def resume(folder: Path) -> None:
        await run.io_bound(desk.resume_session, folder)
        ui.notify(f"{folder} continues; see Measure")

    warning = "The laser will be lit. Check that nobody is in the beam path."
    question = Question(tab, "go on with a session", warning, "Go on with it", resume)
    return lambda folder: question.ask(folder, f"Measure the missing runs of {folder}?")


def keys_dialog(keys: Sequence[tuple[str, str]]) -> ui.dialog:
    """The list of keys, each with what it does."""
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in keys]
    with ui.dialog().props('aria-label="keys"') as dialog, ui.card():
        ui.label("Keys").classes("middle")
        ui.html(f"<table class='rows'>{''.join(lines)}</table>", sanitize=False)
    return dialog
