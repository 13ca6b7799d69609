"""The form before a session: what is measured, how far, and the start, as three steps beside each other."""

from nicegui import run, ui

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.panels.fields import number_field, stated, text_field
from rig.desk.tab import DELIBERATE, Tab, at_once
from rig.settings import SessionSettings

_RELEASE = {
    "at once": "the record begins with the first frame, whether the pendulum moves or not",
    "by hand": "the pendulum comes to rest and is checked; then you are asked to release it",
    "magnet": "the magnet holds the pendulum and releases it once it is at rest",
    "starter": "the pendulum comes to rest and is checked; then the starter pushes it",
}


def build_form(desk: Desk, tab: Tab) -> ui.element:
    """Build it; returns the element that holds it."""
    session = desk.config.session

    def judged() -> dict[str, object]:
        for field, _ in fields.values():
            if field.value and not field.validate():
                raise ConfigurationError(str(field.error))
        return stated(fields)

    def ask() -> None:
        found = desk.checked(judged()).session
        # what was allowed for one session holds for that one
        force.set_value(False)
        what.set_text(_asked(found))
        begin.open()

    async def start() -> None:
        begin.close()
        values = judged()
        folder = await run.io_bound(desk.start_session, values, force=bool(force.value))
        ui.notify(f"the session is starting in {folder}")

    with ui.dialog().props('aria-label="start the session"') as begin, ui.card():
        what = ui.label().classes("middle")
        ui.label("The laser will be lit. Check that nobody is in the beam path.")
        force = at_once(ui.checkbox("measure even if preflight says no-go (this session only)"))
        with ui.row():
            tab.button("Start the session", start).props(f'color="positive" {DELIBERATE}')
            ui.button("Not now", on_click=begin.close).props("outline")
    with ui.element("div").classes("grid thirds") as form:
        with ui.column().classes("box"):
            ui.html("1 · What is measured", tag="h3", sanitize=False).classes("middle")
            sample = text_field(desk, "session.sample", "sample", session.sample)
            operator = text_field(desk, "session.operator", "operator", session.operator)
            notes = text_field(desk, "session.notes", "notes", session.notes)
            history = text_field(desk, "session.contact_history", "contact history", session.contact_history)
        with ui.column().classes("box"):
            ui.html("2 · How far", tag="h3", sanitize=False).classes("middle")
            runs = number_field(desk, "session.runs", "runs", session.runs)
            first = number_field(
                desk, "session.initial_amplitude_arcsec", "from / arcsec", session.initial_amplitude_arcsec
            )
            last = number_field(
                desk, "session.final_amplitude_arcsec", "to / arcsec", session.final_amplitude_arcsec
            )
            longest = number_field(desk, "session.max_duration_s", "at most / s", session.max_duration_s)
            for field in (runs, first, last, longest):
                field.classes("full-width")
        with ui.column().classes("box"):
            ui.html("3 · Start", tag="h3", sanitize=False).classes("middle")
            ui.label(f"Release {desk.config.start.way}: {_RELEASE[desk.config.start.way]}.")
            ui.label("A dialog asks once more before the laser is lit.").classes("dim")
            tab.button("Start …", ask).props(
                'color="positive" size="xl" aria-label="Start … a session"'
            ).classes("full-width")
    fields = {
        "session.sample": (sample, False),
        "session.operator": (operator, False),
        "session.notes": (notes, False),
        "session.contact_history": (history, False),
        "session.runs": (runs, True),
        "session.initial_amplitude_arcsec": (first, True),
        "session.final_amplitude_arcsec": (last, True),
        "session.max_duration_s": (longest, True),
    }
    return form


def _asked(session: SessionSettings) -> str:
    runs = "one run" if session.runs == 1 else f"{session.runs} runs"
    return f"Start {runs} of {session.sample or 'an unnamed sample'}?"
