"""Runs: the sessions made so far and the archive; find, report, Rerun, compare, fit again, resume."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.archive import find_runs
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
_ON_A_PAGE = 15
_MARKED = {"Rerun": (1, 20), "Compare": (2, 20)}
"""How many are marked, at least and at most, for what takes more than one."""
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${NAME}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    desk.sessions.start()
    with ui.row().classes("items-center"):
        find = ui.input("find").props('dense outlined clearable type="search" data-key="find"')
        find.classes("find")
        actions = Actions(desk, tab)
        which = at_once(ui.toggle(["sessions", "archive"], value="sessions"))
        which.props('dense no-caps aria-label="which list"')
    archived = ArchivedRuns(desk, tab, lambda: str(find.value or ""), lambda: which.value == "archive")
    listed = SessionList(desk, lambda: str(find.value or ""), actions.allow)
    actions.marked = listed.marked
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

    find.on_value_change(listed.find_anew)
    which.on_value_change(choose)
    archived.frame.set_visibility(False)
    tab.key("o", tab.act(actions.report))
    tab.key("v", tab.act(actions.view))
    tab.every(1.0, refresh)


class SessionList:
    """The sessions that are found, page by page; what is marked stays so on other pages."""

    def __init__(self, desk: Desk, words: Callable[[], str], on_mark: Callable[[int], None]) -> None:
        self._desk, self._words, self._on_mark = desk, words, on_mark
        self.marked: dict[str, SessionRow] = {}
        self._rows: dict[str, SessionRow] = {}
        self._last_runs: dict[SessionRow, LastRun] = {}
        self._first = 0
        with ui.column().classes("full-width box") as self.frame:
            columns = [
                {"name": name, "label": _head(name), "field": name, "align": "left"} for name in _COLUMNS
            ]
            self._table = ui.table(
                columns=columns, rows=[], row_key="folder", selection="multiple", pagination=0
            )
            self._table.classes("full-width")
            self._table.props('dense flat hide-pagination hide-selected-banner aria-label="sessions"')
            every = f"<span class='unseen'>marked</span>{_MARK}".replace("NAME", "'all'")
            self._table.add_slot("header-selection", every)
            self._table.add_slot("body-selection", _MARK.replace("NAME", "props.row.folder"))
            self._table.add_slot("body-cell-balance", _LAMP)
            self._table.on_select(self._mark)
            with ui.row().classes("items-center"):
                self._newer = ui.button("Newer", on_click=lambda: self._turn(-1)).props("outline dense")
                self._place = ui.label().props('role="status"')
                self._older = ui.button("Older", on_click=lambda: self._turn(1)).props("outline dense")
                self._count = ui.label().classes("dim")

    async def find_anew(self) -> None:
        """Other words are searched for."""
        self._first = 0
        await self.refresh()

    async def refresh(self) -> None:
        """Show what is found now."""
        desk, first = self._desk, self._first
        page = desk.sessions.page(desk.following.folder, self._words(), first, _ON_A_PAGE)
        self._rows = {str(row.folder): row for row in page.rows}
        for name in self.marked.keys() & self._rows.keys():
            self.marked[name] = self._rows[name]
        if new := [row for row in page.rows if row not in self._last_runs and row.state != "running"]:
            found = await run.io_bound(lambda: [last_run(row.folder) for row in new])
            self._last_runs.update(zip(new, found or [], strict=False))
        listed = [self._cells(row) for row in page.rows]
        if listed != self._table.rows:
            self._table.rows = listed
            self._table.selected = [row for row in listed if row["folder"] in self.marked]
            self._table.update()
        last = first + len(page.rows)
        of = f"{page.found:,}" if page.found == page.all else f"{page.found:,} found, of {page.all:,}"
        nothing = f"no session in {desk.config.session.output} is found"
        self._place.set_text(f"{first + 1} to {last} of {of}" if page.rows else nothing)
        self._newer.set_enabled(first > 0)
        self._older.set_enabled(last < page.found)

    def _cells(self, row: SessionRow) -> dict[str, str]:
        stated = {name: str(getattr(row, name)) for name in _STATED}
        found = self._last_runs.get(row, LastRun())._asdict()
        return {"folder": str(row.folder), "name": row.folder.name, **stated, **found}

    def _mark(self) -> None:
        now = {str(row["folder"]) for row in self._table.selected}
        for name, row in self._rows.items():
            if name in now:
                self.marked[name] = row
            else:
                self.marked.pop(name, None)
        self._count.set_text(f"{len(self.marked)} marked" if self.marked else "")
        self._on_mark(len(self.marked))

    async def _turn(self, pages: int) -> None:
        self._first = max(0, self._first + pages * _ON_A_PAGE)
        await self.refresh()


class Actions:
    """What is done with the sessions that are `marked`, by folder."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self.marked: dict[str, SessionRow] = {}
        self._resume = resume_dialog(desk, tab)
        self._drawer = ui.dialog().props('position="right" full-height aria-label="report"')
        with self._drawer, ui.card().classes("report").props('id="report"'):
            with ui.row().classes("items-center full-width no-wrap"):
                self._shown = ui.label().classes("dim ellipsis")
                ui.space()
                ui.button("Close", on_click=self._drawer.close).props("outline")
            ui.element("iframe").props('title="report"')
        self._buttons = [
            # what is read aloud begins with what is seen
            tab.button(name, do).props(f'outline aria-label="{name}: {words}"').tooltip(words)
            for name, do, words in (
                ("Report", self.report, "open the report, key o"),
                ("Rerun", self.view, "show the marked sessions in Rerun, key v"),
                ("Compare", self._compare, "compare the marked sessions"),
                ("Fit again", self._fit, "refit all runs into a new folder"),
                ("Resume …", self._ask_resume, "make the missing runs"),
            )
        ]
        self._wanted = ui.label().classes("dim")
        self._ending = tab.button("End it", desk.looking_again.end).props("flat")
        self.elements = (*self._buttons, self._wanted)
        self.allow(0)

    def allow(self, count: int) -> None:
        """How many are marked decides which buttons can do something."""
        for button in self._buttons:
            least, most = _MARKED.get(button.text, (1, 1))
            button.set_enabled(least <= count <= most)
        self._wanted.set_text("" if count > 1 else "Compare needs two marked" if count else "mark a session")

    def refresh(self) -> None:
        """Show whether a command runs."""
        self._ending.set_visibility(self._desk.looking_again.running)

    def report(self) -> None:
        """Open the report of the one that is marked, or have it made."""
        (folder,) = self._chosen()
        page = self.marked[str(folder)].report
        if page is None:
            self._desk.looking_again.report(folder)
            ui.notify("the report is being written; open it when it is finished")
        else:
            address = json.dumps(_served(self._desk, page))
            ui.run_javascript(f"document.querySelector('#report iframe').src = {address}")
            self._shown.set_text(str(page))
            self._drawer.open()

    def view(self) -> None:
        """Show those that are marked in Rerun."""
        self._desk.looking_again.view(self._chosen(most=20))

    def _fit(self) -> None:
        (folder,) = self._chosen()
        self._desk.looking_again.fit(folder)

    def _compare(self) -> None:
        self._desk.looking_again.compare(self._chosen(2, 20), self._desk.config.session.output)

    def _ask_resume(self) -> None:
        (folder,) = self._chosen()
        row = self.marked[str(folder)]
        if not row.resumable:
            raise ConfigurationError(
                f"{folder}: is {row.state}; only a session that lacks runs can be resumed"
            )
        self._resume(folder)

    def _chosen(self, least: int = 1, most: int = 1) -> list[Path]:
        folders = [Path(name) for name in self.marked]
        if not least <= len(folders) <= most:
            wanted = "one session" if most == 1 else f"at least {least} sessions"
            raise ConfigurationError(f"{len(folders)} sessions are marked; mark {wanted} in the list")
        return folders


class CommandOutput:
    """The last words of the commands that look at sessions again, and addresses of what they have made."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._linked: list[tuple[str, str]] = []
        with ui.column().classes("full-width box q-mt-sm"):
            ui.label("output of the commands").classes("title")
            self._links = ui.row()
            self._words = ui.label().classes("full-width").props('role="log"')
            self._words.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")

    def refresh(self) -> None:
        """Show what they have said by now."""
        desk, again = self._desk, self._desk.looking_again
        self._words.set_text("\n".join(again.said()))
        shown = [(f"open what rig {name} shows", again.address(name)) for name in again.jobs]
        pages = sorted(desk.config.session.output.glob("comparison-*.html"))[-3:]
        now = [*(one for one in shown if one[1]), *((page.name, _served(desk, page)) for page in pages)]
        if now != self._linked:
            self._linked = now
            self._links.clear()
            with self._links:
                for text, address in now:
                    ui.link(text, address, new_tab=True)


def _served(desk: Desk, page: Path) -> str:
    return f"{SERVED}/{quote(page.relative_to(desk.config.session.output).as_posix())}"


def _head(column: str) -> str:
    """Name of a column, with the unit of a number."""
    if column not in NUMBERS:
        return {"name": "folder"}.get(column, column)
    shown = quantity(NUMBERS[column])
    symbol = {"sigma": "σ"}.get(column, column)
    return f"{symbol} / ({shown.unit})" if shown.unit else symbol


_AGAIN_S = 30.0
"""After so long what others may have added is looked for."""


class ArchivedRuns:
    """The list; `words` says what is searched, `wanted` whether it is to be seen. Built where it is made."""

    def __init__(self, desk: Desk, tab: Tab, words: Callable[[], str], wanted: Callable[[], bool]) -> None:
        self._desk, self._words, self._wanted = desk, words, wanted
        self._first = 0
        self._asked: tuple[str, int] | None = None
        self._asked_s = 0.0
        with ui.column().classes("full-width box") as self.frame:
            self._table = ui.table(columns=[], rows=[], pagination=0).classes("full-width")
            self._table.props('dense flat hide-pagination hide-no-data aria-label="runs of the archive"')
            with ui.row().classes("items-center"):
                self._newer = ui.button("Newer runs", on_click=lambda: self._turn(-1)).props("outline dense")
                self._place = ui.label().props('role="status"')
                self._older = ui.button("Older runs", on_click=lambda: self._turn(1)).props("outline dense")
        tab.every(1.0, self.refresh)

    async def _turn(self, pages: int) -> None:
        self._first = max(0, self._first + pages * _ON_A_PAGE)
        await self.refresh()

    async def refresh(self) -> None:
        """Show what is found now; the archive is read again only for other words, or after a while."""
        archive, words = self._desk.archive, self._words()
        if not (archive.is_file() and self._wanted()):
            return
        if self._asked is None or words != self._asked[0]:
            self._first = 0
        now, now_s = (words, self._first), time.monotonic()
        if now == self._asked and now_s - self._asked_s < _AGAIN_S:
            return
        self._asked, self._asked_s = now, now_s
        if not self._table.rows:
            self._place.set_text(f"{archive} is read …")
        try:
            found = await run.io_bound(find_runs, archive, words, self._first, _ON_A_PAGE)
        except RigError as error:
            self._table.rows = []
            self._place.set_text(str(error))
            return
        if found is None or self._asked != now:
            # typed on meanwhile
            return
        listed, count, every = found
        self._table.columns = [
            {"name": name, "label": name, "field": name, "align": "left"} for name in listed.head
        ]
        self._table.rows = [dict(zip(listed.head, row, strict=True)) for row in listed.shown]
        self._table.update()
        last = self._first + len(listed.shown)
        of = f"{count:,}" if count == every else f"{count:,} found, of {every:,}"
        self._place.set_text(
            f"{self._first + 1} to {last} of {of} in {archive}"
            if listed.shown
            else f"no run in {archive} is found"
        )
        self._newer.set_enabled(self._first > 0)
        self._older.set_enabled(last < count)
