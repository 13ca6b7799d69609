"""Runs: the sessions made so far and the archive; find, report, show in Rerun, fit again, resume."""

import json
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.archive import find_runs
from rig.calibrate import next_free
from rig.desk.desk import Desk
from rig.desk.dialogs import resume_dialog
from rig.desk.sessions import NUMBERS, SERVED, LastRun, SessionRow, last_run
from rig.desk.tab import Tab, at_once
from rig.presentation import quantity

KEYS = (("o", "runs: open the report"), ("v", "runs: show in Rerun"))
_COLUMNS = ("begun", "name", "sample", "runs", "state", *LastRun._fields, "conditions", "operator")
_STATED = ("begun", "sample", "runs", "state", "conditions", "operator")
_LAMP = """<q-td :props="props"><span v-if="props.value" :class="props.value">
  <span class="light" style="background: currentcolor"></span>{{ props.value }}</span></q-td>"""
_ROWS_PER_PAGE, _LAST_LINES = 15, 14
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${props.row.folder}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    desk.sessions.start()
    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        which = at_once(ui.toggle(["sessions", "archive"], value="sessions"))
        which.props('dense no-caps aria-label="which list"')
        actions = Actions(desk, tab)
    archived = ArchivedRuns(desk, tab, lambda: str(find.value or ""), lambda: which.value == "archive")
    archived.frame.set_visibility(False)
    listed = SessionList(desk, lambda: str(find.value or ""), actions.mark)
    output = CommandOutput(desk)

    async def choose() -> None:
        is_archive = which.value == "archive"
        for one in (listed.frame, *actions.elements):
            one.set_visibility(not is_archive)
        archived.frame.set_visibility(is_archive)
        await archived.refresh()

    async def refresh() -> None:
        which.set_visibility(desk.archive.is_file())
        await listed.refresh()
        actions.refresh()
        output.refresh()

    which.on_value_change(choose)
    find.on_value_change(listed.search_again)
    tab.key("o", tab.act(actions.report))
    tab.key("v", tab.act(actions.view))
    tab.every(1.0, refresh)


class PagedTable(ABC):
    """A table that is shown page by page; `rows` is what its buttons call them. Built where it is made."""

    def __init__(self, label: str, rows: str = "", **how: Any) -> None:
        self._first = 0
        with ui.column().classes("full-width box") as self.frame:
            self._table = ui.table(columns=[], rows=[], pagination=0, **how).classes("full-width")
            self._table.props(f'dense flat hide-pagination aria-label="{label}"')
            with ui.row().classes("items-center"):
                self._newer = ui.button(f"Newer{rows}", on_click=partial(self._turn, -1))
                self._place = ui.label().props('role="status"')
                self._older = ui.button(f"Older{rows}", on_click=partial(self._turn, 1))
        for button in (self._newer, self._older):
            button.props("outline dense")

    @abstractmethod
    async def refresh(self) -> None:
        """Show what is found now."""

    async def _turn(self, pages: int) -> None:
        self._first = max(0, self._first + pages * _ROWS_PER_PAGE)
        await self.refresh()

    def _show_place(self, shown: int, found: int, every: int, where: str, nothing: str) -> None:
        last = self._first + shown
        of = f"{found:,}" if found == every else f"{found:,} found, of {every:,}"
        self._place.set_text(f"{self._first + 1} to {last} of {of}{where}" if shown else nothing)
        self._newer.set_enabled(self._first > 0)
        self._older.set_enabled(last < found)


class SessionList(PagedTable):
    """The sessions that are found, page by page; the one that is marked stays so on other pages."""

    def __init__(
        self, desk: Desk, words: Callable[[], str], on_mark: Callable[[SessionRow | None], None]
    ) -> None:
        self._desk, self._words, self._on_mark = desk, words, on_mark
        self._rows: dict[str, SessionRow] = {}
        self._last_runs: dict[SessionRow, LastRun] = {}
        self._marked = ""
        super().__init__("sessions", row_key="folder", selection="multiple")
        self._table.columns = _columns({name: _head(name) for name in _COLUMNS})
        self._table.props("hide-selected-banner")
        self._table.add_slot("header-selection", "<span class='unseen'>marked</span>")
        self._table.add_slot("body-selection", _MARK)
        self._table.add_slot("body-cell-balance", _LAMP)
        self._table.on_select(self._mark)

    async def search_again(self) -> None:
        """Search again from page 1."""
        self._first = 0
        await self.refresh()

    async def refresh(self) -> None:
        """Show what is found now."""
        desk = self._desk
        page = desk.sessions.page(desk.following.folder, self._words(), self._first, _ROWS_PER_PAGE)
        self._rows = {str(row.folder): row for row in page.rows}
        if self._marked in self._rows:
            self._on_mark(self._rows[self._marked])
        if new := [row for row in page.rows if row not in self._last_runs and row.state != "running"]:
            found = await run.io_bound(lambda: [last_run(row.folder) for row in new])
            self._last_runs.update(zip(new, found or [], strict=False))
        listed = [self._cells(row) for row in page.rows]
        if listed != self._table.rows:
            self._table.rows = listed
            self._table.selected = [row for row in listed if row["folder"] == self._marked]
            self._table.update()
        nothing = f"no session in {desk.config.session.output} is found"
        self._show_place(len(page.rows), page.found, page.all, "", nothing)

    def _cells(self, row: SessionRow) -> dict[str, str]:
        stated = {name: str(getattr(row, name)) for name in _STATED}
        found = self._last_runs.get(row, LastRun())._asdict()
        return {"folder": str(row.folder), "name": row.folder.name, **stated, **found}

    def _mark(self) -> None:
        # another one takes the place of the one before
        names = [str(row["folder"]) for row in self._table.selected]
        self._marked = next((name for name in names if name != self._marked), names[0] if names else "")
        self._table.selected = [row for row in self._table.rows if row["folder"] == self._marked]
        self._on_mark(self._rows.get(self._marked))


class Actions:
    """Buttons that act on the marked session."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._marked: SessionRow | None = None
        self._resume = resume_dialog(desk, tab)
        self._buttons = [
            # what is read aloud begins with what is seen
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
    """The last words of the commands that need no camera, and the address of what Rerun shows."""

    def __init__(self, desk: Desk) -> None:
        self._jobs = desk.jobs
        with ui.column().classes("full-width box q-mt-sm"):
            ui.label("output of the commands").classes("title")
            self._link = ui.link("open what rig view shows", "", new_tab=True)
            self._words = ui.label().classes("full-width").props('role="log"')
            self._words.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    def refresh(self) -> None:
        """Show how each of them stands, and what they have said by now."""
        lines: list[str] = []
        address = ""
        for name, job in tuple(self._jobs.items()):
            if not job.uses_camera:
                state = "runs" if job.running else "done" if job.status == 0 else "failed"
                lines += [f"rig {name}: {state}", *list(job.said)[-_LAST_LINES:]]
        view = self._jobs.get("view")
        for line in list(view.said) if view is not None and view.running else ():
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


class ArchivedRuns(PagedTable):
    """The runs of the archive; `words` says what is searched, `wanted` whether it is to be seen."""

    def __init__(self, desk: Desk, tab: Tab, words: Callable[[], str], wanted: Callable[[], bool]) -> None:
        self._desk, self._words, self._wanted = desk, words, wanted
        self._asked: tuple[str, int] | None = None
        self._asked_s = 0.0
        super().__init__("runs of the archive", " runs")
        self._table.props("hide-no-data")
        tab.every(1.0, self.refresh)

    async def refresh(self) -> None:
        """Show what is found now; the archive is read again only for other words, or after a while."""
        archive, words = self._desk.archive, self._words()
        if not (archive.is_file() and self._wanted()):
            return
        if self._asked is None or words != self._asked[0]:
            self._first = 0
        now, now_s = (words, self._first), time.monotonic()
        if now == self._asked and now_s - self._asked_s < _REREAD_S:
            return
        self._asked, self._asked_s = now, now_s
        if not self._table.rows:
            self._place.set_text(f"{archive} is read …")
        try:
            found = await run.io_bound(find_runs, archive, words, self._first, _ROWS_PER_PAGE)
        except RigError as error:
            self._table.rows = []
            self._place.set_text(str(error))
            return
        if found is None or self._asked != now:
            # typed on meanwhile
            return
        listed, count, every = found
        self._table.columns = _columns({name: name for name in listed.head})
        self._table.rows = [dict(zip(listed.head, row, strict=True)) for row in listed.shown]
        self._table.update()
        self._show_place(len(listed.shown), count, every, f" in {archive}", f"no run in {archive} is found")
