"""The page between sessions: result and next steps of the last session, and the form of the next."""

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


def typed_value(text: str | None, is_number: bool) -> object:
    """The value of a field: a number if one was typed; else text, which the model judges."""
    if not is_number:
        return text or ""
    text = (text or "").strip()
    for read in (int, float):
        with suppress(ValueError):
            return read(text)
    return text


_FIELDS = {
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
"""Fields of the form by box: the name of the key in `[session]`, the label, and whether it is a number."""
_RELEASE = {
    "at once": "the record begins with the first frame, whether the pendulum moves or not",
    "by hand": "the pendulum comes to rest and is checked; then you are asked to release it",
    "magnet": "the magnet holds the pendulum and releases it once it is at rest",
    "starter": "the pendulum comes to rest and is checked; then the starter pushes it",
}


def build_form(desk: Desk, tab: Tab) -> ui.element:
    """Build the form; returns its element."""
    session = desk.config.session
    fields: dict[str, tuple[ui.input, bool]] = {}

    def values() -> dict[str, object]:
        typed = {key: typed_value(field.value, is_number) for key, (field, is_number) in fields.items()}
        # an empty field for a number states nothing
        return {key: value for key, value in typed.items() if value != "" or not fields[key][1]}

    async def start() -> None:
        next_session = desk.checked(values()).session
        # the permission holds for one session only
        force.set_value(False)
        runs = "one run" if next_session.runs == 1 else f"{next_session.runs} runs"
        if await question.ask(f"Start {runs} of {next_session.sample or 'an unnamed sample'}?"):
            folder = await run.io_bound(desk.start_session, values(), force=bool(force.value))
            ui.notify(f"the session is starting in {folder}")

    question = Question(tab, "start the session", "Start the session")
    with question.options:
        force = ui.checkbox("measure even if preflight says no-go (this session only)")
    with ui.element("div").classes("grid thirds") as form:
        for title, rows in _FIELDS.items():
            with box(title, head="middle"):
                for name, label, is_number in rows:
                    key, value = f"session.{name}", getattr(session, name)
                    text = "" if value is None else f"{value:.10g}" if is_number else str(value)
                    fields[key] = text_field(label, text, key).classes("full-width"), is_number
        with box("3 · Start", head="middle"):
            ui.label(f"Release {desk.config.start.way}: {_RELEASE[desk.config.start.way]}.")
            ui.label("A dialog asks once more before the laser is lit.").classes("dim")
            tab.button("Start …", start).props(
                'color="positive" size="xl" aria-label="Start … a session"'
            ).classes("full-width")
    return form


_KINDS = {RunState.COMPLETE: "go", RunState.STOPPED: "caution"}
NEXT_RUN = "next-run"
"""Identifier of the element on the page that begins the form of the next session."""


def build_result(desk: Desk, tab: Tab) -> None:
    """Build the summary of the last session; nothing without one."""
    last: tuple[SessionSummary | None, bool, str] = None, False, ""

    async def look() -> None:
        nonlocal last
        if not desk.follower.running:
            last = await run.io_bound(desk.last_summary), desk.follower.is_fitting_last, desk.start_problem

    def draw(present: tuple[SessionSummary | None, bool, str]) -> None:
        summary, is_being_fitted, problem = present
        if summary is not None:
            _build_summary(desk, tab, summary, is_being_fitted)
        elif problem:
            # a session without a record leaves nothing but the lines that it printed
            _build_failure(desk, problem)

    tab.on_interval(1.0, look)
    tab.column(lambda: last, draw)


def _build_summary(desk: Desk, tab: Tab, summary: SessionSummary, is_being_fitted: bool) -> None:
    def fit() -> None:
        fit_again(desk, summary.folder)
        ui.notify(f"rig fit {summary.folder.name} runs; its output is below the list of sessions")

    state = "no run made" if summary.ended is None else str(summary.ended)
    kind = "no" if summary.ended is None else _KINDS.get(summary.ended, "no")
    result, steps = summary.headline or "its report is being made", ""
    if not is_being_fitted:
        result = summary.headline or "no result"
        items = [f"<li><b>{html.escape(step)}</b></li>" for step in summary.next_steps]
        items += [f"<li>{html.escape(remark)}</li>" for remark in summary.remarks]
        steps = f"<ul>{''.join(items)}</ul>" if items else "<div>nothing can be done about it</div>"
    with ui.element("div").classes("grid wide-left"):
        with box("the last session"):
            _html(
                f"<span role='status'>{tables.span(state, f'advice {kind}')}</span> "
                + tables.span(f"{summary.folder.name}: {summary.progress_text}", "dim")
                + tables.span(result, "advice", "div")
                + tables.span(summary.u_covers and f"the uncertainty is of {summary.u_covers}", "dim", "div")
                + steps
            )
            with ui.row():
                if summary.report is not None:
                    show = partial(open_in_browser_tab, desk, summary.report)
                    ui.button("Report", on_click=show).props('outline size="lg"')
                if not summary.headline and not is_being_fitted:
                    # a run that has failed has a record, too
                    tab.button("Fit", fit, 'outline size="lg"')
                to_next = f"document.getElementById('{NEXT_RUN}').scrollIntoView({{block: 'start'}})"
                ui.button("Next run").props('outline size="lg"').on("click", js_handler=f"() => {to_next}")
            others = tables.table(summary.other_results, "all parameters") if summary.other_results else ""
            _html(others + _last_lines(desk))
        if summary.limits:
            bars = [
                tables.LimitBar(limit.name, f"{100 * limit.share:.0f} %", limit.share, None, "dim")
                for limit in summary.limits
            ]
            with box("what limits it"):
                _html(tables.bars(bars, "sources of the uncertainty, by their share"))


def _build_failure(desk: Desk, problem: str) -> None:
    folder = desk.session_folder
    with box("the last session"):
        _html(
            f"<span role='status'>{tables.span('failed', 'advice no')}</span> "
            + tables.span(folder.name if folder is not None else "", "dim")
            + tables.span(problem, "no", "div")
            + _last_lines(desk)
        )


def _last_lines(desk: Desk) -> str:
    lines = "<br>".join(map(html.escape, desk.last_lines()))
    return f"<details><summary>its last words</summary><div class='dim'>{lines}</div></details>"


def _html(content: str) -> None:
    ui.html(content, sanitize=False).classes("full-width")
