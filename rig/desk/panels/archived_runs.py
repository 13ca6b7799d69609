"""The runs of the archive as a list to be read: found by the same words as sessions, page by page."""

import time
from collections.abc import Callable

from nicegui import run, ui

from processing.errors import RigError
from rig.archive import find_runs
from rig.desk.desk import Desk
from rig.desk.tab import Tab

_ON_A_PAGE = 15
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
