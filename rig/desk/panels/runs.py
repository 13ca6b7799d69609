"""Runs: the sessions made so far; find, report, show in Rerun, fit again, resume."""

import html
import json
import re
import time
from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.dialogs import resume_dialog
from rig.desk.sessions import SERVED, SessionRow
from rig.desk.tab import Tab
from rig.measure import session_summary
from rig.prepare import next_free

KEYS = (("o", "runs: open the report"), ("v", "runs: show in Rerun"))
_COLUMNS = ("begun", "name", "sample", "runs", "state", "result", "conditions", "operator")
_HEADS = {"name": "folder"}
_ROWS_PER_PAGE, _LAST_LINES = 15, 14
_MOST_ROWS = 500
"""Largest number of rows that are sent to the browser; older ones are found by a search."""
_PAUSE_OVER_WORK = 15.0
"""Ratio of the pause between two looks through the folder to the time that the last look took."""
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${props.row.folder}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        actions = ui.row().classes("items-center")
    listed = SessionList(desk)
    with actions:
        _build_actions(desk, tab, listed)
    with ui.column().classes("full-width box q-mt-sm"):
        ui.label("output of the commands").classes("title")
        tab.html(lambda: _view_link(desk))
        output = tab.label(lambda: _output(desk), "full-width", 'role="log"')
        output.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    async def refresh() -> None:
        await listed.refresh(str(find.value or ""))

    find.on_value_change(refresh)
    tab.every(1.0, refresh)


def _build_actions(desk: Desk, tab: Tab, listed: "SessionList") -> None:
    """Buttons that act on the session that is marked in the list."""
    resume = resume_dialog(desk, tab)

    def chosen() -> SessionRow:
        if listed.marked is None:
            raise ConfigurationError("no session is marked; mark one in the list")
        return listed.marked

    def report() -> None:
        row = chosen()
        if (made := session_summary(row.folder).report) is not None:
            open_in_browser_tab(desk, made)
            return
        desk.jobs.begin("report", str(row.folder))
        ui.notify("the report is being written; open it when it is finished")

    def view() -> None:
        desk.jobs.begin("view", str(chosen().folder), "--view", "web")

    async def ask_resume() -> None:
        row = chosen()
        if not row.resumable:
            raise ConfigurationError(
                f"{row.folder}: is {row.state}; only a session that lacks runs can be resumed"
            )
        await resume(row.folder)

    def end() -> None:
        for _, job in desk.jobs.running(uses_camera=False):
            job.end()

    for name, do, words in (
        ("Report", report, "open the report, key o"),
        ("Rerun", view, "show the session in Rerun, key v"),
        ("Fit again", lambda: fit_again(desk, chosen().folder), "refit all runs into a new folder"),
        ("Resume …", ask_resume, "measure missing runs"),
    ):
        # the label that a screen reader reads begins with the visible text
        props = f'outline aria-label="{name}: {words}"'
        tab.button(name, do, props, enabled=lambda: listed.marked is not None).tooltip(words)
    tab.key("o", tab.act(report))
    tab.key("v", tab.act(view))
    tab.label(lambda: "mark a session" if listed.marked is None else f"{listed.marked.name} is marked", "dim")
    tab.button("End it", end, "flat", seen=lambda: bool(desk.jobs.running(uses_camera=False)))


def _output(desk: Desk) -> str:
    """State of each command that uses no camera, and the last lines of its output."""
    lines: list[str] = []
    for name, job in tuple(desk.jobs.items()):
        if not job.uses_camera:
            state = "runs" if job.running else "done" if job.status == 0 else "failed"
            lines += [f"rig {name}: {state}", *list(job.output)[-_LAST_LINES:]]
    return "\n".join(lines)


def _view_link(desk: Desk) -> str:
    """A link to Rerun's page, which `rig view` serves; empty while it does not run."""
    view = desk.jobs.get("view")
    lines = " ".join(view.output) if view is not None and view.running else ""
    at = re.search(r"http://127\.0\.0\.1:\d+\S*", lines)
    return f"<a href='{html.escape(at[0])}' target='_blank'>open what rig view shows</a>" if at else ""


def fit_again(desk: Desk, folder: Path) -> None:
    """Fit the runs of a session again, into a folder of their own."""
    desk.jobs.begin("fit", str(folder), "-o", str(next_free(folder, "fit")))


def open_in_browser_tab(desk: Desk, page: Path) -> None:
    """Open a file of the output folder in a new browser tab."""
    name = page.absolute().relative_to(desk.config.session.output.absolute()).as_posix()
    ui.run_javascript(f"window.open({json.dumps(f'{SERVED}/{quote(name)}')}, '_blank')")


class SessionList:
    """Table of the sessions that a search finds, of which one may be `marked`; it is added to the page."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._rows: dict[str, SessionRow] = {}
        self._due_s = 0.0
        self.marked: SessionRow | None = None
        columns = [
            {"name": name, "label": _HEADS.get(name, name), "field": name, "align": "left"}
            for name in _COLUMNS
        ]
        # the browser shows it page by page
        self.table = ui.table(
            columns=columns, rows=[], row_key="folder", selection="multiple", pagination=_ROWS_PER_PAGE
        ).classes("full-width box")
        self.table.props(f'dense flat aria-label="sessions" :rows-per-page-options="[{_ROWS_PER_PAGE}]"')
        self.table.props('hide-selected-banner no-data-label="no session is found"')
        self.table.add_slot("header-selection", "<span class='unseen'>marked</span>")
        self.table.add_slot("body-selection", _MARK)
        self.table.on_select(self._mark)

    async def refresh(self, words: str) -> None:
        """Show the sessions that the search finds now."""
        began_s = time.monotonic()
        if began_s >= self._due_s:
            await run.io_bound(self._desk.sessions.look)
            # a large folder is looked through less often
            self._due_s = time.monotonic() + _PAUSE_OVER_WORK * (time.monotonic() - began_s)
        found = self._desk.sessions.rows(self._desk.following.folder, words)[:_MOST_ROWS]
        self._rows = {str(row.folder): row for row in found}
        if self.marked is not None:
            self.marked = self._rows.get(str(self.marked.folder), self.marked)
        listed = [
            {"folder": folder, **{name: getattr(row, name) for name in _COLUMNS}}
            for folder, row in self._rows.items()
        ]
        if listed != self.table.rows:
            self.table.rows = listed
            self._select()

    def _mark(self) -> None:
        # only one session is marked: the new one replaces the previous one
        before = None if self.marked is None else str(self.marked.folder)
        names = [str(row["folder"]) for row in self.table.selected]
        marked = next((name for name in names if name != before), names[0] if names else "")
        self.marked = self._rows.get(marked)
        self._select()

    def _select(self) -> None:
        marked = None if self.marked is None else str(self.marked.folder)
        self.table.selected = [row for row in self.table.rows if row["folder"] == marked]
        self.table.update()
