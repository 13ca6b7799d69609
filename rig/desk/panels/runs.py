"""Runs: the sessions in the output folder and the runs of the archive; report, Rerun, fit again, resume."""

import json
import math
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import run, ui

from acquisition.record import records_in_folder
from processing.errors import ConfigurationError, RigError
from rig.archive import find_runs
from rig.desk.desk import Desk
from rig.desk.dialogs import resume_dialog
from rig.desk.sessions import NUMBERS, SERVED, SessionRow
from rig.desk.tab import Tab
from rig.measure import session_summary
from rig.prepare import next_free
from rig.terminal import quantity

RERUN = "/rerun"
"""Path of the page around Rerun's."""
KEYS = (("o", "runs: open the report"), ("v", "runs: show the last run in Rerun"))
_COLUMNS = ("begun", "name", "sample", "runs", "state", *NUMBERS, "balance", "conditions", "operator")
_BALANCE_CELL = """<q-td :props="props"><span v-if="props.value" :class="props.value">
  <span class="light" style="background: currentcolor"></span>{{ props.value }}</span></q-td>"""
_ROWS_PER_PAGE, _MAX_OUTPUT_LINES = 15, 14
_MAX_ROWS = 500
"""Largest number of rows that are sent to the browser; a search finds older ones."""
_PAUSE_PER_LOOK = 15.0
"""Ratio of the pause between two looks through the folder to the duration of the last look."""
_ARCHIVE_INTERVAL_S = 30.0
"""Interval of reading the archive for added runs."""
_MARK_CELL = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${props.row.folder}`" />'


def build(desk: Desk, tab: Tab) -> None:
    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        list_choice = ui.toggle(["sessions", "archive"], value="sessions")
        list_choice.props('dense no-caps aria-label="which list"')
        actions = ui.row().classes("items-center")
    sessions, archived_runs = SessionList(desk), ArchivedRuns(desk.archive)
    with actions:
        _build_actions(desk, tab, sessions)
    with ui.column().classes("full-width box q-mt-sm"):
        ui.label("output of the commands").classes("title")
        tab.html(lambda: _view_link(desk))
        output = tab.label(lambda: _output(desk), "full-width", 'role="log"')
        output.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    async def refresh() -> None:
        words, is_archive = str(find.value or ""), list_choice.value == "archive"
        list_choice.set_visibility(desk.archive.is_file())
        archived_runs.table.set_visibility(is_archive)
        sessions.table.set_visibility(not is_archive)
        actions.set_visibility(not is_archive)
        await sessions.refresh(words)
        if is_archive:
            await archived_runs.refresh(words)

    list_choice.on_value_change(refresh)
    find.on_value_change(refresh)
    tab.on_interval(1.0, refresh)


def _build_actions(desk: Desk, tab: Tab, sessions: "SessionList") -> None:
    """Build the buttons that act on the session that is marked in the list."""
    resume = resume_dialog(desk, tab)

    def marked() -> SessionRow:
        if sessions.marked is None:
            raise ConfigurationError("no session is marked; mark one in the list")
        return sessions.marked

    def report() -> None:
        folder = marked().folder
        if (path := session_summary(folder).report) is not None:
            open_in_browser_tab(desk, path)
            return
        desk.jobs.begin("report", str(folder))
        ui.notify("the report is being written; open it when it is finished")

    def view() -> None:
        folder = marked().folder
        last_record = max(records_in_folder(folder), key=lambda path: path.stat().st_mtime, default=folder)
        desk.jobs.begin("view", str(last_record), "--view", "web")

    async def ask_resume() -> None:
        row = marked()
        if not row.resumable:
            raise ConfigurationError(
                f"{row.folder}: is {row.state}; only a session that lacks runs can be resumed"
            )
        await resume(row.folder)

    def end() -> None:
        for _, job in desk.jobs.running(uses_camera=False):
            job.end()

    for name, action, tooltip in (
        ("Report", report, "open the report, key o"),
        ("Rerun", view, "show its last run in Rerun, key v"),
        ("Fit again", lambda: fit_again(desk, marked().folder), "refit all runs into a new folder"),
        ("Resume …", ask_resume, "measure missing runs"),
    ):
        # the label for screen readers begins with the visible text
        props = f'outline aria-label="{name}: {tooltip}"'
        tab.button(name, action, props, enabled=lambda: sessions.marked is not None).tooltip(tooltip)
    tab.key("o", tab.handler(report))
    tab.key("v", tab.handler(view))
    tab.label(lambda: f"{sessions.marked.name} is marked" if sessions.marked else "mark a session", "dim")
    tab.button("End it", end, "flat", visible=lambda: bool(desk.jobs.running(uses_camera=False)))


def _output(desk: Desk) -> str:
    """State of each command that uses no camera, and the last lines of its output."""
    lines: list[str] = []
    for name, job in tuple(desk.jobs.items()):
        if not job.uses_camera:
            state = "runs" if job.running else "done" if job.status == 0 else "failed"
            lines += [f"rig {name}: {state}", *list(job.output)[-_MAX_OUTPUT_LINES:]]
    return "\n".join(lines)


def rerun_address(desk: Desk) -> str:
    """Address of Rerun's page, which `rig view` serves; empty while it does not run."""
    job = desk.jobs.running_job("view")
    address = re.search(r"http://127\.0\.0\.1:\d+\S*", "" if job is None else " ".join(job.output))
    return address[0] if address else ""


def _view_link(desk: Desk) -> str:
    return f"<a href='{RERUN}' target='_blank'>open what rig view shows</a>" if rerun_address(desk) else ""


def fit_again(desk: Desk, folder: Path) -> None:
    """Fit the runs of a session again, into a new folder in that of the session."""
    desk.jobs.begin("fit", str(folder), "-o", str(next_free(folder, "fit")))


def open_in_browser_tab(desk: Desk, page: Path) -> None:
    """Open a file of the output folder in a new browser tab."""
    name = page.absolute().relative_to(desk.config.session.output.absolute()).as_posix()
    ui.run_javascript(f"window.open({json.dumps(f'{SERVED}/{quote(name)}')}, '_blank')")


def _table(label: str, **options: Any) -> ui.table:
    """A table that the browser shows page by page."""
    table = ui.table(columns=[], rows=[], pagination=_ROWS_PER_PAGE, **options).classes("full-width box")
    return table.props(f'dense flat aria-label="{label}" :rows-per-page-options="[{_ROWS_PER_PAGE}]"')


def _columns(names: Sequence[str]) -> list[dict[str, str]]:
    return [{"name": name, "label": _column_label(name), "field": name, "align": "left"} for name in names]


def _column_label(column: str) -> str:
    """Label of a column, with the unit of a number."""
    label = {"name": "folder", "sigma": "σ"}.get(column, column)
    unit = quantity(NUMBERS[column]).unit if column in NUMBERS else ""
    return f"{label} / ({unit})" if unit else label


class SessionList:
    """Table of the sessions that a search finds, of which one may be `marked`; it is added to the page."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._rows: dict[str, SessionRow] = {}
        self._due_s = 0.0
        self.marked: SessionRow | None = None
        self.table = _table("sessions", row_key="folder", selection="multiple")
        self.table.columns = _columns(_COLUMNS)
        self.table.props('hide-selected-banner no-data-label="no session is found"')
        self.table.add_slot("header-selection", "<span class='unseen'>marked</span>")
        self.table.add_slot("body-selection", _MARK_CELL)
        self.table.add_slot("body-cell-balance", _BALANCE_CELL)
        self.table.on_select(self._mark)

    async def refresh(self, words: str) -> None:
        """Show the sessions that the search finds now."""
        began_s = time.monotonic()
        if began_s >= self._due_s:
            await run.io_bound(self._desk.sessions.look)
            # a look through a large folder is repeated less often
            self._due_s = time.monotonic() + _PAUSE_PER_LOOK * (time.monotonic() - began_s)
        rows = self._desk.sessions.rows(self._desk.follower.folder, words)[:_MAX_ROWS]
        self._rows = {str(row.folder): row for row in rows}
        if self.marked is not None:
            self.marked = self._rows.get(str(self.marked.folder), self.marked)
        table_rows = [
            {"folder": folder, **{name: getattr(row, name) for name in _COLUMNS}}
            for folder, row in self._rows.items()
        ]
        if table_rows != self.table.rows:
            self.table.rows = table_rows
            self._select()

    @property
    def _marked_folder(self) -> str:
        return "" if self.marked is None else str(self.marked.folder)

    def _mark(self) -> None:
        # only one session is marked: a new mark replaces the last
        folders = [str(row["folder"]) for row in self.table.selected]
        new = [folder for folder in folders if folder != self._marked_folder]
        self.marked = self._rows.get(next(iter(new or folders), ""))
        self._select()

    def _select(self) -> None:
        self.table.selected = [row for row in self.table.rows if row["folder"] == self._marked_folder]
        self.table.update()


class ArchivedRuns:
    """Table of the runs of an archive that a search finds; it is added to the page."""

    def __init__(self, archive: Path) -> None:
        self._archive = archive
        self._words, self._due_s = "", -math.inf
        self.table = _table("runs of the archive")

    async def refresh(self, words: str) -> None:
        """Show the runs that the search finds; the archive is read again for other words or after a while."""
        now_s = time.monotonic()
        if words == self._words and now_s < self._due_s:
            return
        self._words, self._due_s = words, now_s + _ARCHIVE_INTERVAL_S
        self._update(f"{self._archive} is read …")
        try:
            runs = await run.io_bound(find_runs, self._archive, words, _MAX_ROWS)
        except RigError as error:
            self.table.rows = []
            self._update(str(error))
            return
        if runs is None or self._words != words:
            # the search was changed meanwhile
            return
        self.table.columns = [{**column, "label": column["name"]} for column in _columns(runs.head)]
        self.table.rows = [dict(zip(runs.head, row, strict=True)) for row in runs.shown]
        self._update(f"no run in {self._archive} is found")

    def _update(self, empty_text: str) -> None:
        """Send the table to the browser, with the text that stands in it while it has no rows."""
        self.table.props["no-data-label"] = empty_text
        self.table.update()
