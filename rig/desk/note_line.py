"""A line for notes while a session runs, and the sets of values that were used before."""

from collections.abc import Callable, Mapping

from nicegui import run, ui

from processing.errors import RigError
from rig.desk.at_once import at_once
from rig.desk.desk import Desk
from rig.desk.tab import Tab

_OF_PRESET = (
    "session.sample",
    "session.operator",
    "session.contact_history",
    "session.initial_amplitude_arcsec",
    "session.final_amplitude_arcsec",
    "session.max_duration_s",
    "session.runs",
)
"""What one set holds; notes are of one day."""


def note_line(desk: Desk, tab: Tab) -> None:
    """A field and a button: what is typed goes into the record of the running session, with its time."""

    async def note() -> None:
        text = str(field.value or "").strip()
        if not text:
            raise RigError("an empty note: type some text")
        said = await run.io_bound(desk.following.order, f"note {tab.operator_name}\t{text}")
        # only what is on the session's disk leaves the field
        field.set_value("")
        ui.notify(said)

    with ui.row().classes("full-width no-wrap items-center"):
        field = ui.input("note").props('dense outlined data-draft="note" aria-label="note" maxlength=2000')
        field.classes("full-width")
        field.on("keydown.enter", tab.act(note))
        tab.button("Note", note).props('outline aria-label="note it in the record"')


class Presets:
    """A choice of the sets that this operator has started sessions with; `fields` get what is chosen."""

    def __init__(self, desk: Desk, tab: Tab, fields: Callable[[], Mapping[str, ui.input]]) -> None:
        self._desk, self._tab, self._fields = desk, tab, fields
        self._choice = at_once(ui.select([], label="as before", on_change=self._chosen))
        self._choice.props('dense outlined aria-label="values of an earlier session"').style(
            "min-width: 220px"
        )
        tab.every(1.0, self._refresh)
        self._refresh()

    def used(self, values: Mapping[str, object]) -> None:
        """A session was started with these values."""
        kept = {key: str(values[key]) for key in _OF_PRESET if values.get(key) not in (None, "")}
        name = ", ".join(kept[key] for key in ("session.sample", "session.operator") if key in kept)
        if name:
            self._desk.place.use(self._tab.operator_name, name, kept)

    def _refresh(self) -> None:
        names = list(self._desk.place.presets(self._tab.operator_name))
        if names != self._choice.options:
            self._choice.set_options(names)
        self._choice.set_visibility(bool(names))

    def _chosen(self) -> None:
        values = self._desk.place.presets(self._tab.operator_name).get(str(self._choice.value or ""), {})
        for key, field in self._fields().items():
            if key in values:
                field.set_value(values[key])
