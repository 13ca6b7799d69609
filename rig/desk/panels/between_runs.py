"""Between sessions: how the last one went and what comes next; the form of the next one."""

import html
from contextlib import suppress
from functools import partial

from nicegui import run, ui

from rig.desk import tables
from rig.desk.desk import Desk
from rig.desk.dialogs import Question
from rig.desk.panels.runs import fit_again, open_in_browser_tab
from rig.desk.tab import Tab, box, text_field
from rig.measure import RunState, SessionSummary


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

    def stated() -> dict[str, object]:
        typed = {key: as_typed(field.value, is_number) for key, (field, is_number) in fields.items()}
        # an empty number is not stated
        return {key: value for key, value in typed.items() if value != "" or not fields[key][1]}

    async def start() -> None:
        found = desk.checked(stated()).session
        # what was allowed for one session holds for that one
        force.set_value(False)
        runs = "one run" if found.runs == 1 else f"{found.runs} runs"
        if await question.ask(f"Start {runs} of {found.sample or 'an unnamed sample'}?"):
            folder = await run.io_bound(desk.start_session, stated(), force=bool(force.value))
            ui.notify(f"the session is starting in {folder}")

    question = Question(tab, "start the session", "Start the session")
    with question.options:
        force = ui.checkbox("measure even if preflight says no-go (this session only)")
    with ui.element("div").classes("grid thirds") as form:
        for title, asked in _ASKED.items():
            with box(title, head="middle"):
                for name, label, is_number in asked:
                    key, value = f"session.{name}", getattr(session, name)
                    shown = "" if value is None else f"{value:.10g}" if is_number else str(value)
                    fields[key] = text_field(label, shown, key).classes("full-width"), is_number
        with box("3 · Start", head="middle"):
            ui.label(f"Release {desk.config.start.way}: {_RELEASE[desk.config.start.way]}.")
            ui.label("A dialog asks once more before the laser is lit.").classes("dim")
            tab.button("Start …", start).props(
                'color="positive" size="xl" aria-label="Start … a session"'
            ).classes("full-width")
    return form


_KINDS = {RunState.COMPLETE: "go", RunState.STOPPED: "caution"}
NEXT_RUN = "next-run"
"""Name of the element on the page that begins the next one."""


def build_result(desk: Desk, tab: Tab) -> None:
    """Add what the last session hands over; nothing without one."""
    over: tuple[SessionSummary | None, bool, str] = None, False, ""

    async def look() -> None:
        nonlocal over
        if not desk.following.running:
            over = await run.io_bound(desk.last_summary), desk.following.fits_last, desk.start_problem

    def draw(drawn: tuple[SessionSummary | None, bool, str]) -> None:
        summary, is_fitted_now, problem = drawn
        if summary is not None:
            _result(desk, tab, summary, is_fitted_now)
        elif problem:
            # without a record a session leaves nothing but its words
            _failure(desk, problem)

    tab.every(1.0, look)
    tab.drawn(lambda: over, draw)


def _result(desk: Desk, tab: Tab, over: SessionSummary, is_fitted_now: bool) -> None:
    def fit() -> None:
        fit_again(desk, over.folder)
        ui.notify(f"rig fit {over.folder.name} runs; what it says is below the list of sessions")

    ended, kind = ("no run made", "no") if over.ended is None else (over.ended, _KINDS.get(over.ended, "no"))
    no_result = "its report is being made" if is_fitted_now else "no result"
    next_steps = () if is_fitted_now else over.next_steps
    steps = [f"<li><b>{html.escape(step)}</b></li>" for step in next_steps]
    steps += [f"<li>{html.escape(remark)}</li>" for remark in over.remarks]
    bars = [
        tables.LimitBar(one.name, f"{100 * one.share:.0f} %", one.share, None, "dim") for one in over.limits
    ]
    with ui.element("div").classes("grid wide-left"):
        with box("the last session"):
            _html(
                f"<span role='status'>{tables.span(ended, f'advice {kind}')}</span> "
                + tables.span(f"{over.folder.name}: {over.progress_text}", "dim")
                + tables.span(over.headline or no_result, "advice", "div")
                + tables.span(over.u_covers and f"the uncertainty is of {over.u_covers}", "dim", "div")
                + ("" if is_fitted_now else _listed(steps))
            )
            with ui.row():
                if over.report is not None:
                    show = partial(open_in_browser_tab, desk, over.report)
                    ui.button("Report", on_click=show).props('outline size="lg"')
                if not over.headline and not is_fitted_now:
                    # a run that has failed has a record, too
                    tab.button("Fit", fit, 'outline size="lg"')
                to_next = f"document.getElementById('{NEXT_RUN}').scrollIntoView({{block: 'start'}})"
                ui.button("Next run").props('outline size="lg"').on("click", js_handler=f"() => {to_next}")
            others = tables.table(over.other_results, "all parameters") if over.other_results else ""
            _html(others + _last_words(desk))
        if over.limits:
            with box("what limits it"):
                _html(tables.bars(bars, "sources of the uncertainty, by their share"))


def _failure(desk: Desk, problem: str) -> None:
    folder = desk.session_folder
    with box("the last session"):
        _html(
            f"<span role='status'>{tables.span('failed', 'advice no')}</span> "
            + tables.span(folder.name if folder is not None else "", "dim")
            + tables.span(problem, "no", "div")
            + _last_words(desk)
        )


def _last_words(desk: Desk) -> str:
    last_words = "<br>".join(map(html.escape, desk.last_words()))
    return f"<details><summary>its last words</summary><div class='dim'>{last_words}</div></details>"


def _listed(steps: list[str]) -> str:
    return f"<ul>{''.join(steps)}</ul>" if steps else "<div>nothing can be done about it</div>"


def _html(content: str) -> None:
    ui.html(content, sanitize=False).classes("full-width")
