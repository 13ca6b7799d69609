"""The alarms at the head of every page, with the list that unfolds."""

from functools import partial

from nicegui import ui

from rig.desk.alarm_list import AlarmKey, AlarmRow, AlarmState
from rig.desk.desk import Desk
from rig.desk.dialogs import resume_dialog
from rig.desk.run_reader import clock
from rig.desk.tab import DELIBERATE, Tab, at_once


class AlarmBar:
    """Shows the list; a trip is acknowledged where the light is, which stands beside."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._alarms, self._tab = desk.alarming.alarms, tab
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

    def refresh(self) -> list[AlarmRow]:
        """Show the list as it is now; returns the alarms that cry."""
        rows = self._alarms.rows()
        crying = [row for row in rows if row.cries]
        worst = crying[0] if crying else None
        self._title.set_text("" if worst is None else sentence(f"{worst.key}: {worst.cause}"))
        self._remedy.set_text("" if worst is None else sentence(worst.key.remedy))
        self._banner.set_visibility(worst is not None)
        died = any(row.key is AlarmKey.SESSION_DIED for row in rows)
        self._resume.set_visibility(died and self._resumable() is not None)
        if rows != self._shown:
            self._shown = rows
            self._list.clear()
            with self._list:
                self._show(rows)
        return crying

    def _show(self, rows: list[AlarmRow]) -> None:
        present = [row for row in rows if not row.earlier]
        earlier = [row for row in rows if row.earlier]
        counted = [(str(state), sum(row.state is state for row in present)) for state in AlarmState]
        told = [f"{count} {words}" for words, count in (*counted, ("from before", len(earlier))) if count]
        self._counts.set_text(f"Alarms: {', '.join(told) or 'none'}")
        for row in present:
            self._row(row)
        if earlier:
            with at_once(ui.expansion(f"{len(earlier)} from before")):
                self._tab.button("All of them seen", partial(self._seen, *(row.key for row in earlier)))
                for row in earlier:
                    self._row(row)
        if not rows:
            ui.label("nothing is wrong").classes("dim")

    def _row(self, row: AlarmRow) -> None:
        with ui.element("div").classes(f"alarm-row {row.state}").props(f'data-alarm="{row.key}"'):
            with ui.element("div"):
                again = f" ({row.times} times)" if row.times > 1 else ""
                ui.label(f"{row.key}{again}").classes("text-weight-bold")
                ui.label(f"{row.state}; {_times(row)}").classes("dim")
            ui.label(row.cause).props('aria-label="cause"')
            ui.label(row.key.remedy).props('aria-label="remedy"')
            if row.key is not AlarmKey.TRIP and row.state is not AlarmState.ACKNOWLEDGED:
                button = self._tab.button("Seen", partial(self._seen, row.key))
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
    cleared_s = row.cleared_s if row.state is AlarmState.CLEARED else None
    told = (("since", row.raised_s), ("cleared", cleared_s), ("seen", row.acknowledged_s))
    return ", ".join(f"{word} {clock(at)}" for word, at in told if at is not None)
