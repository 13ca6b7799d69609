"""At the head of every page: who acts and since when, how it is taken over, who sits at this tab."""

import time
from collections.abc import Callable

from nicegui import ui

from rig.desk.acting import ANSWER_S, Actor
from rig.desk.desk import Desk
from rig.desk.login import LOGIN, LOGOUT
from rig.desk.tab import Tab

_LEAVE = f"fetch('{LOGOUT}', {{method: 'POST', redirect: 'manual'}}).then(() => location.assign('{LOGIN}'))"


class Who:
    """Shows who acts; `on_name` is called when somebody says who sits here."""

    def __init__(self, desk: Desk, tab: Tab, on_name: Callable[[], None]) -> None:
        self._desk, self._tab, self._on_name = desk, tab, on_name
        self._text = ui.label().classes("dim").props('role="status" aria-live="polite" id="who-acts"')
        self._take = ui.button("Take over", on_click=self._asked).props("dense outline")
        self._name = ui.button("", on_click=self._ask_name)
        self._name.props('dense flat no-caps aria-label="who sits at this tab"')
        if tab.person.name:
            ui.button("Log out", on_click=lambda: ui.run_javascript(_LEAVE)).props("dense flat")
        with ui.dialog() as self._dialog, ui.card():
            ui.label("Who sits here? Alarms, notes and entries are recorded under this name.")
            self._field = ui.input("name").props('dense outlined autofocus aria-label="name"')
            self._field.on("keydown.enter", self._named)
            ui.button("That is me", on_click=self._named)
        with ui.dialog().props("persistent") as self._wish, ui.card():
            self._wish_text = ui.label().classes("middle")
            ui.label(f"Without an answer this tab is taken over in {ANSWER_S:g} s.")
            with ui.row():
                ui.button("Give it", on_click=lambda: self._answer(give=True))
                ui.button("Keep it", on_click=lambda: self._answer(give=False)).props("outline")

    def refresh(self) -> None:
        """Show it as it is now."""
        tab, actor = self._tab, self._desk.acting.now
        mine = tab.acts
        self._text.set_text(_said(actor, mine=mine, may_act=tab.may_act))
        self._take.set_visibility(tab.may_act and not mine)
        waits = self._desk.acting.waits(tab.name)
        self._take.set_text("asked …" if waits else "Take over")
        self._name.set_text(tab.operator_name or "enter your name")
        wished = mine and actor is not None and bool(actor.asked_by)
        if actor is not None and wished:
            self._wish_text.set_text(f"{actor.asked_by} asks to act")
        if self._wish.value != wished:
            self._wish.set_value(wished)
        if self._desk.acting.refused(tab.name):
            ui.notify("the acting tab keeps its role", type="warning")

    def _asked(self) -> None:
        # the page of somebody who may only watch has no such button, and no page is believed
        if self._tab.may_act and self._desk.acting.ask(self._tab.name, self._tab.operator_name):
            ui.notify("this tab acts now")

    def _answer(self, *, give: bool) -> None:
        self._desk.acting.answer(self._tab.name, give=give)

    def _ask_name(self) -> None:
        if not self._tab.person.name:
            self._field.set_value(self._tab.operator_name)
            self._dialog.open()

    def _named(self) -> None:
        self._dialog.close()
        self._tab.operator_name = str(self._field.value or "").strip()[:60]
        self._desk.acting.called(self._tab.name, self._tab.operator_name)
        self._on_name()


def _said(actor: Actor | None, *, mine: bool, may_act: bool) -> str:
    reads = "" if may_act else "read only; "
    if actor is None:
        return f"{reads}nobody acts"
    since = time.strftime("%H:%M", time.localtime(actor.since_s))
    name = actor.name or "another tab"
    if mine:
        return f"you have acted since {since}"
    return f"{reads}this tab only watches; {name} has acted since {since}" + (
        "" if actor.here else ", not connected"
    )
