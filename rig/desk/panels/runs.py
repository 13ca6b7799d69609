"""Runs: the sessions made so far and the archive; find, report, show in Rerun, fit again, resume."""

import json
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
_LAMP = """<q-td :props="props"><span v-if="props.value" :class="props.value">
  <span class="light" style="background: currentcolor"></span>{{ props.value }}</span></q-td>"""
_ROWS_PER_PAGE, _LAST_LINES = 15, 14
_MOST_ROWS = 500
"""Largest number of rows that are sent to the browser; older ones are found by a search."""
_PAUSE_OVER_WORK = 15.0
"""Ratio of the pause between two looks through the folder to the time that the last look took."""
_REREAD_S = 30.0
"""Interval of reading the archive for added runs."""
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${props.row.folder}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        list_choice = ui.toggle(["sessions", "archive"], value="sessions")
        list_choice.props('dense no-caps aria-label="which list"')
        actions = ui.row().classes("items-center")
    listed, archived = SessionList(desk), ArchivedRuns(desk.archive)
    with actions:
        _build_actions(desk, tab, listed)
    with ui.column().classes("full-width box q-mt-sm"):
        ui.label("output of the commands").classes("title")
        tab.html(lambda: _view_link(desk))
        output = tab.label(lambda: _output(desk), "full-width", 'role="log"')
        output.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    async def refresh() -> None:
        words, is_archive = str(find.value or ""), list_choice.value == "archive"
        list_choice.set_visibility(desk.archive.is_file())
        archived.table.set_visibility(is_archive)
        listed.table.set_visibility(not is_archive)
        actions.set_visibility(not is_archive)
        await listed.refresh(words)
        if is_archive:
            await archived.refresh(words)

    list_choice.on_value_change(refresh)
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
        records = records_in_folder(chosen().folder)
        # of several runs the last
        shown = max(records, key=lambda path: path.stat().st_mtime, default=chosen().folder)
        desk.jobs.begin("view", str(shown), "--view", "web")

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
        ("Rerun", view, "show its last run in Rerun, key v"),
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


def rerun_address(desk: Desk) -> str:
    """Address of Rerun's page, which `rig view` serves; empty while it does not run."""
    view = desk.jobs.get("view")
    lines = " ".join(view.output) if view is not None and view.running else ""
    at = re.search(r"http://127\.0\.0\.1:\d+\S*", lines)
    return at[0] if at else ""


def _view_link(desk: Desk) -> str:
    shown = f"<a href='{RERUN}' target='_blank'>open what rig view shows</a>"
    return shown if rerun_address(desk) else ""


def fit_again(desk: Desk, folder: Path) -> None:
    """Fit the runs of a session again, into a folder of their own."""
    desk.jobs.begin("fit", str(folder), "-o", str(next_free(folder, "fit")))


def open_in_browser_tab(desk: Desk, page: Path) -> None:
    """Open a file of the output folder in a new browser tab."""
    name = page.absolute().relative_to(desk.config.session.output.absolute()).as_posix()
    ui.run_javascript(f"window.open({json.dumps(f'{SERVED}/{quote(name)}')}, '_blank')")


def _table(label: str, **how: Any) -> ui.table:
    """A table that the browser shows page by page, the newest first."""
    table = ui.table(columns=[], rows=[], pagination=_ROWS_PER_PAGE, **how).classes("full-width box")
    return table.props(f'dense flat aria-label="{label}" :rows-per-page-options="[{_ROWS_PER_PAGE}]"')


def _columns(names: Sequence[str]) -> list[dict[str, str]]:
    return [{"name": name, "label": _head(name), "field": name, "align": "left"} for name in names]


def _head(column: str) -> str:
    """Name of a column, with the unit of a number."""
    if column not in NUMBERS:
        return {"name": "folder"}.get(column, column)
    shown = quantity(NUMBERS[column])
    symbol = {"sigma": "σ"}.get(column, column)
    return f"{symbol} / ({shown.unit})" if shown.unit else symbol


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
        self.table.add_slot("body-selection", _MARK)
        self.table.add_slot("body-cell-balance", _LAMP)
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


class ArchivedRuns:
    """Table of the runs of an archive that a search finds; it is added to the page."""

    def __init__(self, archive: Path) -> None:
        self._archive = archive
        self._searched, self._searched_s = "", -_REREAD_S
        self.table = _table("runs of the archive")

    async def refresh(self, words: str) -> None:
        """Show the runs that the search finds; the archive is read again for other words or after a while."""
        now_s = time.monotonic()
        if words == self._searched and now_s - self._searched_s < _REREAD_S:
            return
        self._searched, self._searched_s = words, now_s
        self._say(f"{self._archive} is read …")
        try:
            found = await run.io_bound(find_runs, self._archive, words, _MOST_ROWS)
        except RigError as error:
            self.table.rows = []
            self._say(str(error))
            return
        if found is None or self._searched != words:
            # the search was changed meanwhile
            return
        self.table.columns = [{**one, "label": one["name"]} for one in _columns(found.head)]
        self.table.rows = [dict(zip(found.head, row, strict=True)) for row in found.shown]
        self._say(f"no run in {self._archive} is found")

    def _say(self, nothing: str) -> None:
        """Show a text in the place of rows while there are none."""
        self.table.props["no-data-label"] = nothing
        self.table.update()
