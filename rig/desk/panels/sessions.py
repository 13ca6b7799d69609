"""Sessions: find, report, Rerun, replay, compare, fit again, resume what was interrupted."""

import json
from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError
from rig.desk.at_once import at_once
from rig.desk.desk import Desk
from rig.desk.panels.archived_runs import ArchivedRuns
from rig.desk.resuming import resume_dialog
from rig.desk.sessions import NUMBERS, SERVED, LastRun, SessionRow, last_run
from rig.desk.tab import Tab
from rig.presentation import quantity

KEYS = (("o", "sessions: open the report"), ("v", "sessions: show in Rerun"))
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
    again, output = desk.looking_again, desk.config.session.output
    index = desk.sessions
    index.start()
    rows: dict[str, SessionRow] = {}
    marked: dict[str, SessionRow] = {}
    last_runs: dict[SessionRow, LastRun] = {}
    first = 0

    def chosen(least: int = 1, most: int = 1) -> list[Path]:
        folders = [Path(name) for name in marked]
        if not least <= len(folders) <= most:
            wanted = "one session" if most == 1 else f"at least {least} sessions"
            raise ConfigurationError(f"{len(folders)} sessions are marked; mark {wanted} in the list")
        return folders

    def report() -> None:
        (folder,) = chosen()
        page = marked[str(folder)].report
        if page is None:
            again.report(folder)
            ui.notify("the report is being written; open it when it is finished")
        else:
            ui.run_javascript(f"document.querySelector('#report iframe').src = {json.dumps(_served(page))}")
            shown_name.set_text(str(page))
            drawer.open()

    def view() -> None:
        again.view(chosen(most=20))

    def replay() -> None:
        (folder,) = chosen()
        again.replay(folder)

    def fit() -> None:
        (folder,) = chosen()
        again.fit(folder)

    def compare() -> None:
        again.compare(chosen(2, 20), output)

    def ask_resume() -> None:
        (folder,) = chosen()
        row = marked[str(folder)]
        if not row.resumable:
            raise ConfigurationError(
                f"{folder}: is {row.state}; only a session that lacks runs can be resumed"
            )
        resume(folder)

    resume = resume_dialog(desk, tab)
    drawer = ui.dialog().props('position="right" full-height aria-label="report"')
    with drawer, ui.card().classes("report").props('id="report"'):
        with ui.row().classes("items-center full-width no-wrap"):
            shown_name = ui.label().classes("dim ellipsis")
            ui.space()
            ui.button("Close", on_click=drawer.close).props("outline")
        ui.element("iframe").props('title="report"')
    with ui.row().classes("items-center"):
        find = (
            ui.input("find").props('dense outlined clearable type="search" data-key="find"').classes("find")
        )
        actions: list[ui.button] = []
        for name, do, words in (
            ("Report", report, "open the report, key o"),
            ("Rerun", view, "show the marked sessions in Rerun, key v"),
            ("Replay", replay, "replay the last run in Rerun, ten times as fast"),
            ("Compare", compare, "compare the marked sessions"),
            ("Fit again", fit, "refit all runs into a new folder"),
            ("Resume …", ask_resume, "make the missing runs"),
        ):
            # what is read aloud begins with what is seen
            button = tab.button(name, do).props(f'outline aria-label="{name}: {words}"')
            actions.append(button.tooltip(words))
        wanted = ui.label().classes("dim")
        ending = tab.button("End it", again.end).props("flat")
        which = at_once(ui.toggle(["sessions", "archive"], value="sessions"))
        which.props('dense no-caps aria-label="which list"')
    archived = ArchivedRuns(desk, tab, lambda: str(find.value or ""), lambda: which.value == "archive")
    with ui.column().classes("full-width box") as listed_here:
        table = ui.table(
            columns=[
                {"name": name, "label": _head(name), "field": name, "align": "left"} for name in _COLUMNS
            ],
            rows=[],
            row_key="folder",
            selection="multiple",
            pagination=0,
        ).classes("full-width")
        table.props('dense flat hide-pagination hide-selected-banner aria-label="sessions"')
        table.add_slot(
            "header-selection", f"<span class='unseen'>marked</span>{_MARK}".replace("NAME", "'all'")
        )
        table.add_slot("body-cell-balance", _LAMP)
        table.add_slot("body-selection", _MARK.replace("NAME", "props.row.folder"))
        with ui.row().classes("items-center"):
            earlier = ui.button("Newer", on_click=lambda: turn(-1)).props("outline dense")
            place = ui.label().props('role="status"')
            later = ui.button("Older", on_click=lambda: turn(1)).props("outline dense")
            count = ui.label().classes("dim")
    with ui.column().classes("full-width box q-mt-sm"):
        ui.label("output of the commands").classes("title")
        links = ui.row()
        words_of = ui.label().classes("full-width").props('role="log"')
        words_of.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")
    tab.key("o", tab.act(report))
    tab.key("v", tab.act(view))
    shown: list[tuple[str, str]] = []

    def mark() -> None:
        """What is marked stays so on other pages."""
        now = {str(row["folder"]) for row in table.selected}
        for name, row in rows.items():
            if name in now:
                marked[name] = row
            else:
                marked.pop(name, None)
        count.set_text(f"{len(marked)} marked" if marked else "")
        allow()

    def allow() -> None:
        """What is marked decides which buttons can do something."""
        for button in actions:
            least, most = _MARKED.get(button.text, (1, 1))
            button.set_enabled(least <= len(marked) <= most)
        wanted.set_text("" if len(marked) > 1 else "Compare needs two marked" if marked else "mark a session")

    async def turn(pages: int) -> None:
        nonlocal first
        first = max(0, first + pages * _ON_A_PAGE)
        await refresh()

    async def found_anew() -> None:
        nonlocal first
        first = 0
        await refresh()

    async def choose() -> None:
        for one in (listed_here, wanted, *actions):
            one.set_visibility(which.value == "sessions")
        archived.frame.set_visibility(which.value == "archive")
        await archived.refresh()

    table.on_select(mark)
    find.on_value_change(found_anew)
    which.on_value_change(choose)
    archived.frame.set_visibility(False)
    allow()

    async def refresh() -> None:
        nonlocal shown
        which.set_visibility(desk.archive.is_file())
        page = index.page(desk.following.folder, str(find.value or ""), first, _ON_A_PAGE)
        rows.clear()
        rows.update({str(row.folder): row for row in page.rows})
        for name in marked.keys() & rows.keys():
            marked[name] = rows[name]
        if new := [row for row in page.rows if row not in last_runs and row.state != "running"]:
            found = await run.io_bound(lambda: [last_run(row.folder) for row in new])
            last_runs.update(zip(new, found or [], strict=False))
        listed = [
            {
                "folder": str(row.folder),
                "name": row.folder.name,
                **{name: str(getattr(row, name)) for name in _STATED},
                **last_runs.get(row, LastRun())._asdict(),
            }
            for row in page.rows
        ]
        if listed != table.rows:
            table.rows = listed
            table.selected = [row for row in listed if row["folder"] in marked]
            table.update()
        last = first + len(page.rows)
        of = f"{page.found:,}" if page.found == page.all else f"{page.found:,} found, of {page.all:,}"
        place.set_text(f"{first + 1} to {last} of {of}" if page.rows else f"no session in {output} is found")
        earlier.set_enabled(first > 0)
        later.set_enabled(last < page.found)
        words_of.set_text("\n".join(again.said()))
        ending.set_visibility(again.running)
        now = [
            (f"open what rig {name} shows", address)
            for name in again.jobs
            if (address := again.address(name))
        ]
        now += [(page.name, _served(page)) for page in sorted(output.glob("comparison-*.html"))[-3:]]
        if now != shown:
            shown = now
            links.clear()
            with links:
                for text, address in now:
                    ui.link(text, address, new_tab=True)

    def _served(page: Path) -> str:
        return f"{SERVED}/{quote(page.relative_to(output).as_posix())}"

    tab.every(1.0, refresh)


def _head(column: str) -> str:
    """Name of a column, with the unit of a number."""
    if column not in NUMBERS:
        return column
    shown = quantity(NUMBERS[column])
    symbol = {"sigma": "σ"}.get(column, column)
    return f"{symbol} / ({shown.unit})" if shown.unit else symbol
