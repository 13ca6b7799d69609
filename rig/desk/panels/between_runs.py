"""Between sessions: how the last one went and what comes next; the form of the next one, and its fields."""

import html
from contextlib import suppress

from nicegui import run, ui

from processing.errors import ConfigurationError
from rig.desk import tables
from rig.desk.desk import Desk
from rig.desk.dialogs import Question
from rig.desk.panels.runs import fit_again, open_in_browser_tab
from rig.desk.tab import Tab, at_once, box
from rig.measure import HandOver, RunState
from rig.settings import SessionSettings


def setting_field(desk: Desk, key: str, label: str, value: object, *, is_number: bool = False) -> ui.input:
    """A field for a key of the configuration, judged by its model; an empty number is not stated."""
    shown = "" if value is None else f"{value:.10g}" if isinstance(value, int | float) else str(value)
    field = ui.input(label, value=shown).props(f'dense outlined data-key="{key}" aria-label="{label}"')

    def fault(text: str | None) -> str | None:
        typed = as_typed(text, is_number)
        return None if is_number and typed == "" else desk.fault(key, typed) or None

    field.validation = fault
    return field


def as_typed(text: str | None, is_number: bool) -> object:
    """A number where one was typed; anything else as text, which the model judges."""
    if not is_number:
        return text or ""
    text = (text or "").strip()
    for read in (int, float):
        with suppress(ValueError):
            return read(text)
    return text


_ASKED = {
    "1 · What is measured": (
        ("sample", "sample", False),
        ("operator", "operator", False),
        ("notes", "notes", False),
        ("contact_history", "contact history", False),
    ),
    "2 · How far": (
        ("runs", "runs", True),
        ("initial_amplitude_arcsec", "from / arcsec", True),
        ("final_amplitude_arcsec", "to / arcsec", True),
        ("max_duration_s", "at most / s", True),
    ),
}
"""Keys of `[session]` that the form asks for: name, label, and whether it is a number."""
_RELEASE = {
    "at once": "the record begins with the first frame, whether the pendulum moves or not",
    "by hand": "the pendulum comes to rest and is checked; then you are asked to release it",
    "magnet": "the magnet holds the pendulum and releases it once it is at rest",
    "starter": "the pendulum comes to rest and is checked; then the starter pushes it",
}


def build_form(desk: Desk, tab: Tab) -> ui.element:
    """Build it; returns the element that holds it."""
    session = desk.config.session
    fields: dict[str, tuple[ui.input, bool]] = {}

    def judged() -> dict[str, object]:
        for field, _ in fields.values():
            if field.value and not field.validate():
                raise ConfigurationError(str(field.error))
        typed = {key: as_typed(field.value, is_number) for key, (field, is_number) in fields.items()}
        # an empty number is not stated
        return {key: value for key, value in typed.items() if value != "" or not fields[key][1]}

    def ask() -> None:
        found = desk.checked(judged()).session
        # what was allowed for one session holds for that one
        force.set_value(False)
        question.ask(True, _asked(found))

    async def start(_: bool) -> None:
        values = judged()
        folder = await run.io_bound(desk.start_session, values, force=bool(force.value))
        ui.notify(f"the session is starting in {folder}")

    warning = "The laser will be lit. Check that nobody is in the beam path."
    question = Question(tab, "start the session", warning, "Start the session", start)
    with question.options:
        force = at_once(ui.checkbox("measure even if preflight says no-go (this session only)"))
    with ui.element("div").classes("grid thirds") as form:
        for title, asked in _ASKED.items():
            with box(title, head="middle"):
                for name, label, is_number in asked:
                    key = f"session.{name}"
                    field = setting_field(desk, key, label, getattr(session, name), is_number=is_number)
                    fields[key] = field.classes("full-width"), is_number
        with box("3 · Start", head="middle"):
            ui.label(f"Release {desk.config.start.way}: {_RELEASE[desk.config.start.way]}.")
            ui.label("A dialog asks once more before the laser is lit.").classes("dim")
            tab.button("Start …", ask).props(
                'color="positive" size="xl" aria-label="Start … a session"'
            ).classes("full-width")
    return form


def _asked(session: SessionSettings) -> str:
    runs = "one run" if session.runs == 1 else f"{session.runs} runs"
    return f"Start {runs} of {session.sample or 'an unnamed sample'}?"


_KINDS = {RunState.COMPLETE: "go", RunState.STOPPED: "caution"}
NEXT_RUN = "next-run"
"""Name of the element on the page that begins the next one."""


def _to_next() -> None:
    ui.run_javascript(f"document.getElementById('{NEXT_RUN}').scrollIntoView({{block: 'start'}})")


class RunResult:
    """Shows what the last session hands over; built where it is made, hidden without one."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._drawn: HandOver | None = None
        with ui.element("div").classes("grid wide-left") as self.frame:
            with box("the last session"):
                with ui.row().classes("items-baseline"):
                    self._verdict = ui.label().classes("advice").props('role="status"')
                    self._went = ui.label().classes("dim")
                self._headline = ui.label().classes("advice")
                self._of = ui.label().classes("dim")
                self._next = ui.html(sanitize=False).classes("full-width")
                with ui.row():
                    self._report = ui.button("Report", on_click=self._open).props('outline size="lg"')
                    self._fits = tab.button("Fit", self._fit).props('outline size="lg"')
                    ui.button("Next run", on_click=_to_next).props('outline size="lg"')
                self._others = ui.html(sanitize=False).classes("full-width")
                with at_once(ui.expansion("its last words")).classes("full-width"):
                    self._words = ui.html(sanitize=False).classes("dim")
            with box("what limits it") as self._found:
                self._limits = ui.html(sanitize=False).classes("full-width")
        self.frame.set_visibility(False)
        tab.every(1.0, self._refresh)

    async def _refresh(self) -> None:
        desk = self._desk
        if desk.following.running:
            return
        over = await run.io_bound(desk.hand_over)
        self.frame.set_visibility(over is not None)
        if over is None or over is self._drawn:
            return
        self._drawn = over
        self._verdict.set_text("no run made" if over.ended is None else over.ended.value)
        kind = "no" if over.ended is None else _KINDS.get(over.ended, "no")
        self._verdict.classes(remove="go caution no", add=kind)
        self._went.set_text(f"{over.folder.name}: {over.went}")
        self._headline.set_text(over.headline or "no result")
        self._of.set_text(f"the uncertainty is of {over.of}" if over.of else "")
        lines = [f"<li><b>{html.escape(step)}</b></li>" for step in over.next_steps]
        lines += [f"<li>{html.escape(remark)}</li>" for remark in over.remarks]
        self._next.set_content(f"<ul>{''.join(lines)}</ul>" if lines else "nothing can be done about it")
        self._others.set_content(tables.table(over.others, "all parameters") if over.others else "")
        self._words.set_content("<br>".join(map(html.escape, desk.last_words())))
        bars = [
            tables.LimitBar(one.name, f"{100 * one.share:.0f} %", one.share, None, "dim")
            for one in over.limits
        ]
        self._limits.set_content(tables.bars(bars, "sources of the uncertainty, by their share"))
        self._report.set_visibility(over.report is not None)
        # a run that has failed has a record, too
        self._fits.set_visibility(not over.headline)
        self._found.set_visibility(bool(over.limits))

    def _fit(self) -> None:
        if self._drawn is not None:
            fit_again(self._desk, self._drawn.folder)
            ui.notify(f"rig fit {self._drawn.folder.name} runs; what it says is below the list of sessions")

    def _open(self) -> None:
        over = self._drawn
        if over is None or over.report is None:
            return
        open_in_browser_tab(self._desk, over.report)
