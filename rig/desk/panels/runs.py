"""Runs: the sessions made so far and the archive; find, report, show in Rerun, fit again, resume."""

import json
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.archive import find_runs
from rig.desk.desk import Desk
from rig.desk.dialogs import resume_dialog
from rig.desk.sessions import NUMBERS, SERVED, SessionRow
from rig.desk.tab import Tab, at_once
from rig.prepare import next_free
from rig.terminal import quantity

KEYS = (("o", "runs: open the report"), ("v", "runs: show in Rerun"))
_COLUMNS = ("begun", "name", "sample", "runs", "state", *NUMBERS, "balance", "conditions", "operator")
_LAMP = """<q-td :props="props"><span v-if="props.value" :class="props.value">
  <span class="light" style="background: currentcolor"></span>{{ props.value }}</span></q-td>"""
_ROWS_PER_PAGE, _LAST_LINES = 15, 14
_MOST_ROWS = 500
"""Largest number of rows that are sent to the browser; older ones are found by a search."""
_PAUSE_OVER_WORK = 15.0
"""Ratio of the pause between two looks through the folder to the time that the last look took."""
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${props.row.folder}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""

    def words() -> str:
        return str(find.value or "")

    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        list_choice = at_once(ui.toggle(["sessions", "archive"], value="sessions"))
        list_choice.props('dense no-caps aria-label="which list"')
        actions = Actions(desk, tab)
    listed = SessionList(desk, words, actions.mark)
    archived = ArchivedRuns(desk, words)
    output = CommandOutput(desk)

    async def refresh() -> None:
        is_archive = list_choice.value == "archive"
        list_choice.set_visibility(desk.archive.is_file())
        archived.table.set_visibility(is_archive)
        for one in (listed.table, *actions.elements):
            one.set_visibility(not is_archive)
        await listed.refresh()
        actions.refresh()
        output.refresh()
        await archived.refresh()

    list_choice.on_value_change(refresh)
    find.on_value_change(refresh)
    tab.key("o", tab.act(actions.report))
    tab.key("v", tab.act(actions.view))
    tab.every(1.0, refresh)


def _table(label: str, **how: Any) -> ui.table:
    """A table that the browser shows page by page, the newest first."""
    table = ui.table(columns=[], rows=[], pagination=_ROWS_PER_PAGE, **how).classes("full-width box")
    return table.props(f'dense flat aria-label="{label}" :rows-per-page-options="[{_ROWS_PER_PAGE}]"')


class SessionList:
    """Table of the sessions that the search finds, of which one may be marked; it is added to the page."""

    def __init__(
        self, desk: Desk, words: Callable[[], str], on_mark: Callable[[SessionRow | None], None]
    ) -> None:
        self._desk, self._words, self._on_mark = desk, words, on_mark
        self._rows: dict[str, SessionRow] = {}
        self._marked = ""
        self._due_s = 0.0
        self.table = _table("sessions", row_key="folder", selection="multiple")
        self.table.columns = _columns({name: _head(name) for name in _COLUMNS})
        self.table.props('hide-selected-banner no-data-label="no session is found"')
        self.table.add_slot("header-selection", "<span class='unseen'>marked</span>")
        self.table.add_slot("body-selection", _MARK)
        self.table.add_slot("body-cell-balance", _LAMP)
        self.table.on_select(self._mark)

    async def refresh(self) -> None:
        """Show the sessions that the search finds now."""
        began_s = time.monotonic()
        if began_s >= self._due_s:
            await run.io_bound(self._desk.sessions.look)
            # a large folder is looked through less often
            self._due_s = time.monotonic() + _PAUSE_OVER_WORK * (time.monotonic() - began_s)
        found = self._desk.sessions.rows(self._desk.following.folder, self._words())[:_MOST_ROWS]
        self._rows = {str(row.folder): row for row in found}
        if self._marked in self._rows:
            self._on_mark(self._rows[self._marked])
        listed = [
            {"folder": folder, **{name: getattr(row, name) for name in _COLUMNS}}
            for folder, row in self._rows.items()
        ]
        if listed != self.table.rows:
            self.table.rows = listed
            self.table.selected = [row for row in listed if row["folder"] == self._marked]
            self.table.update()

    def _mark(self) -> None:
        # only one session is marked: the new one replaces the previous one
        names = [str(row["folder"]) for row in self.table.selected]
        self._marked = next((name for name in names if name != self._marked), names[0] if names else "")
        self.table.selected = [row for row in self.table.rows if row["folder"] == self._marked]
        self._on_mark(self._rows.get(self._marked))


class Actions:
    """Buttons that act on the marked session."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._marked: SessionRow | None = None
        self._resume = resume_dialog(desk, tab)
        self._buttons = [
            # the label that a screen reader reads begins with the visible text
            tab.button(name, do).props(f'outline aria-label="{name}: {words}"').tooltip(words)
            for name, do, words in (
                ("Report", self.report, "open the report, key o"),
                ("Rerun", self.view, "show the session in Rerun, key v"),
                ("Fit again", self._fit, "refit all runs into a new folder"),
                ("Resume …", self._ask_resume, "measure missing runs"),
            )
        ]
        self._wanted = ui.label().classes("dim")
        self._ending = tab.button("End it", self._end).props("flat")
        self.elements = (*self._buttons, self._wanted)
        self.mark(None)

    def mark(self, row: SessionRow | None) -> None:
        """Mark this session, or none."""
        self._marked = row
        for button in self._buttons:
            button.set_enabled(row is not None)
        self._wanted.set_text("mark a session" if row is None else f"{row.folder.name} is marked")

    def refresh(self) -> None:
        """Show whether a command runs."""
        self._ending.set_visibility(bool(self._desk.jobs.running(uses_camera=False)))

    def report(self) -> None:
        """Open the report, or have it made."""
        row = self._chosen()
        if row.report is None:
            self._desk.jobs.begin("report", str(row.folder), uses_camera=False)
            ui.notify("the report is being written; open it when it is finished")
        else:
            open_in_browser_tab(self._desk, row.report)

    def view(self) -> None:
        """Show the session in Rerun."""
        words = str(self._chosen().folder), "--view", "web"
        self._desk.jobs.begin("view", *words, uses_camera=False)

    def _fit(self) -> None:
        fit_again(self._desk, self._chosen().folder)

    def _end(self) -> None:
        for _, job in self._desk.jobs.running(uses_camera=False):
            job.end()

    def _ask_resume(self) -> None:
        row = self._chosen()
        if not row.resumable:
            raise ConfigurationError(
                f"{row.folder}: is {row.state}; only a session that lacks runs can be resumed"
            )
        self._resume(row.folder)

    def _chosen(self) -> SessionRow:
        if self._marked is None:
            raise ConfigurationError("no session is marked; mark one in the list")
        return self._marked


class CommandOutput:
    """Last lines of the output of commands that use no camera, and a link to the page of `rig view`."""

    def __init__(self, desk: Desk) -> None:
        self._jobs = desk.jobs
        with ui.column().classes("full-width box q-mt-sm"):
            ui.label("output of the commands").classes("title")
            self._link = ui.link("open what rig view shows", "", new_tab=True)
            self._words = ui.label().classes("full-width").props('role="log"')
            self._words.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    def refresh(self) -> None:
        """Show the state of each command and the last lines of its output."""
        lines: list[str] = []
        address = ""
        for name, job in tuple(self._jobs.items()):
            if not job.uses_camera:
                state = "runs" if job.running else "done" if job.status == 0 else "failed"
                lines += [f"rig {name}: {state}", *list(job.output)[-_LAST_LINES:]]
        view = self._jobs.get("view")
        for line in list(view.output) if view is not None and view.running else ():
            address = match[0] if (match := re.search(r"http://127\.0\.0\.1:\d+\S*", line)) else address
        self._words.set_text("\n".join(lines))
        self._link.props(f'href="{address}"')
        self._link.set_visibility(bool(address))


def fit_again(desk: Desk, folder: Path) -> None:
    """Fit the runs of a session again, into a folder of their own."""
    desk.jobs.begin("fit", str(folder), "-o", str(next_free(folder, "fit")), uses_camera=False)


def open_in_browser_tab(desk: Desk, page: Path) -> None:
    """Open a file of the output folder in a new browser tab."""
    name = page.absolute().relative_to(desk.config.session.output.absolute()).as_posix()
    ui.run_javascript(f"window.open({json.dumps(f'{SERVED}/{quote(name)}')}, '_blank')")


def _columns(labels: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "label": label, "field": name, "align": "left"} for name, label in labels.items()]


def _head(column: str) -> str:
    """Name of a column, with the unit of a number."""
    if column not in NUMBERS:
        return {"name": "folder"}.get(column, column)
    shown = quantity(NUMBERS[column])
    symbol = {"sigma": "σ"}.get(column, column)
    return f"{symbol} / ({shown.unit})" if shown.unit else symbol


_REREAD_S = 30.0
"""Interval of reading the archive for added runs."""


class ArchivedRuns:
    """Table of the archive's runs with all `words` of the search; it is added to the page."""

    def __init__(self, desk: Desk, words: Callable[[], str]) -> None:
        self._archive, self._words = desk.archive, words
        self._searched: str | None = None
        self._searched_s = 0.0
        self.table = _table("runs of the archive")

    async def refresh(self) -> None:
        """Show the runs that the search finds; the archive is read again for other words or after a while."""
        words, now_s = self._words(), time.monotonic()
        if not self.table.visible or (words == self._searched and now_s - self._searched_s < _REREAD_S):
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
        self.table.columns = _columns({name: name for name in found.head})
        self.table.rows = [dict(zip(found.head, row, strict=True)) for row in found.shown]
        self._say(f"no run in {self._archive} is found")

    def _say(self, nothing: str) -> None:
        """Show a text in the place of rows while there are none."""
        self.table.props["no-data-label"] = nothing
        self.table.update()
