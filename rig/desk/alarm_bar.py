"""The alarms at the head of every page with the list that unfolds, and the dialogs that they open."""

import html
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from nicegui import run, ui

from rig.control import LatchedTrip
from rig.desk.alarm_list import AlarmKey, AlarmRow, AlarmState
from rig.desk.desk import Desk
from rig.desk.following import clock
from rig.desk.tab import DELIBERATE, Tab, at_once


class AlarmBar:
    """Shows the list; `ask_leave` opens the dialog of a trip, whose acknowledgement is given there only."""

    def __init__(self, desk: Desk, tab: Tab, ask_leave: Callable[[], None]) -> None:
        self._alarms, self._tab, self._ask_leave = desk.alarming.alarms, tab, ask_leave
        self._resumable, self._ask_resume = desk.resumable, resume_dialog(desk, tab)
        self._shown: object = None
        self._banner = ui.element("div").classes("alarm").props('role="alert" aria-live="assertive"')
        with self._banner:
            self._title = ui.label().classes("text-weight-bold")
            self._remedy = ui.label().classes("alarm-remedy")
            ui.button("All", on_click=self.toggle).props('dense flat aria-label="All alarms, key a"')
        self._resume = tab.button("Resume …", self._resumed)
        self._resume.props('color="positive" size="lg" aria-label="Resume … the session that died"')
        self._resume.classes("full-width")
        with at_once(ui.expansion()).classes("full-width alarms").props("dense") as self._fold:
            with self._fold.add_slot("header"):
                self._counts = ui.label().props('role="status" aria-live="polite"')
            self._list = ui.column().classes("full-width")

    def toggle(self) -> None:
        """Unfold the list, or fold it."""
        self._fold.set_value(not self._fold.value)

    def refresh(self, refused: str = "") -> list[AlarmRow]:
        """Show the list as it is now; returns the alarms that cry.

        `refused` says why a trip cannot be acknowledged yet.
        """
        rows = self._alarms.rows()
        crying = [row for row in rows if row.cries]
        worst = crying[0] if crying else None
        self._title.set_text("" if worst is None else sentence(f"{worst.key}: {worst.cause}"))
        self._remedy.set_text("" if worst is None else sentence(worst.alarm.remedy))
        self._banner.set_visibility(worst is not None)
        died = any(row.key is AlarmKey.SESSION_DIED for row in rows)
        self._resume.set_visibility(died and self._resumable() is not None)
        earlier = [row for row in rows if row.earlier]
        rows = [row for row in rows if not row.earlier]
        counted = [(state, sum(row.state is state for row in rows)) for state in AlarmState]
        told = [f"{count} {state}" for state, count in counted if count]
        said = ", ".join([*told, f"{len(earlier)} from before"] if earlier else told)
        self._counts.set_text(f"Alarms: {said or 'none'}")
        now = (rows, earlier, refused)
        if now != self._shown:
            self._shown = now
            self._list.clear()
            with self._list:
                for row in rows:
                    self._row(row, refused)
                if earlier:
                    with at_once(ui.expansion(f"{len(earlier)} from before")):
                        self._tab.button(
                            "All of them seen", partial(self._seen, *(row.key for row in earlier))
                        )
                        for row in earlier:
                            self._row(row, refused)
                if not rows and not earlier:
                    ui.label("nothing is wrong").classes("dim")
        return crying

    def _row(self, row: AlarmRow, refused: str) -> None:
        alarm, tab = row.alarm, self._tab
        with ui.element("div").classes(f"alarm-row {row.state}").props(f'data-alarm="{row.key}"'):
            with ui.element("div"):
                again = f" ({row.times} times)" if row.times > 1 else ""
                ui.label(f"{row.key}{again}").classes("text-weight-bold")
                ui.label(f"{row.state}; {_times(row)}").classes("dim")
            ui.label(row.cause).props('aria-label="cause"')
            ui.label(alarm.remedy).props('aria-label="remedy"')
            with ui.row().classes("no-wrap"):
                if alarm.by_leave and row.cleared_s is None:
                    button = tab.button("Acknowledge trip …", self._ask_leave)
                    button.props("dense outline").set_enabled(not refused)
                elif row.state in (AlarmState.ACTIVE, AlarmState.CLEARED):
                    button = tab.button("Seen", partial(self._seen, row.key))
                    button.props(f'dense outline aria-label="acknowledge {row.key}" {DELIBERATE}')

    def _resumed(self) -> None:
        if (folder := self._resumable()) is not None:
            self._ask_resume(folder)

    def _seen(self, *keys: AlarmKey) -> None:
        for key in keys:
            self._alarms.acknowledge(key)


def sentence(text: str) -> str:
    """With a capital letter."""
    return text[:1].upper() + text[1:]


def _times(row: AlarmRow) -> str:
    """Since when it is as it is."""
    told = (
        ("since", row.raised_s),
        ("cleared", row.cleared_s),
        ("seen", row.acknowledged_s),
    )
    return ", ".join(f"{word} {clock(at)}" for word, at in told if at is not None)


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
        what.set_text(f"Measure the missing runs of {folder}?")
        begin.open()

    return ask


def keys_dialog(keys: Sequence[tuple[str, str]]) -> ui.dialog:
    """The list of keys, each with what it does."""
    lines = [f"<tr><th>{html.escape(key)}</th><td>{html.escape(text)}</td></tr>" for key, text in keys]
    with ui.dialog().props('aria-label="keys"') as dialog, ui.card():
        ui.label("Keys").classes("middle")
        ui.html(f"<table class='rows'>{''.join(lines)}</table>", sanitize=False)
    return dialog
