"""Sessions: list, report, Rerun, replay, compare, fit again, resume what was interrupted."""

from pathlib import Path
from urllib.parse import quote

from nicegui import run, ui

from processing.errors import ConfigurationError
from rig.desk.desk import Desk
from rig.desk.sessions import SERVED, SessionRow, list_sessions
from rig.desk.tab import DELIBERATE, Tab
from rig.wizards import next_free

KEYS = (("o", "sessions: open the report"), ("v", "sessions: show in Rerun"))
_COLUMNS = ("begun", "folder", "sample", "runs", "state")
_LAST_LINES = 14
_MARK = '<q-checkbox v-model="props.selected" dense :aria-label="`mark ${NAME}`" />'


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    again, output = desk.looking_again, desk.config.session.output
    rows: dict[str, SessionRow] = {}
    asked: Path | None = None

    def chosen(least: int = 1, most: int = 1) -> list[Path]:
        folders = [Path(row["folder"]) for row in table.selected]
        if not least <= len(folders) <= most:
            wanted = "one session" if most == 1 else f"at least {least} sessions"
            raise ConfigurationError(f"{len(folders)} sessions are marked; mark {wanted} in the list")
        return folders

    def report() -> None:
        (folder,) = chosen()
        page = rows[str(folder)].report
        if page is None:
            again.start("report", [str(folder)])
            ui.notify("the report is being made; open it when it is done")
        else:
            ui.navigate.to(_served(page), new_tab=True)

    def view() -> None:
        again.start("view", [*map(str, chosen(most=20)), "--view", "web"])

    def replay() -> None:
        (folder,) = chosen()
        records = sorted(folder.glob("run-*.mcap"))
        if not records:
            raise ConfigurationError(f"{folder}: holds no record")
        again.start("replay", [str(records[-1]), "--speed", "10", "--view", "web"])

    def fit() -> None:
        (folder,) = chosen()
        again.start("fit", [str(folder), "-o", str(next_free(folder, "fit"))])

    def compare() -> None:
        page = next_free(output, "comparison", ".html")
        again.start("compare", [*map(str, chosen(2, 20)), "-o", str(page)])

    def ask_resume() -> None:
        nonlocal asked
        (asked,) = chosen()
        row = rows[str(asked)]
        if not row.resumable:
            raise ConfigurationError(
                f"{asked}: is {row.state}; only what was interrupted goes on here, see rig run --resume"
            )
        what.set_text(f"Make the missing runs of {asked}?")
        begin.open()

    async def resume() -> None:
        begin.close()
        if (folder := asked) is not None:
            await run.io_bound(desk.resume_session, folder)
            ui.notify(f"{folder} goes on; see Measure")

    def end() -> None:
        for job in again.jobs.values():
            if job.running:
                job.end()

    with ui.dialog().props('aria-label="go on with a session"') as begin, ui.card():
        what = ui.label().classes("middle")
        ui.label("The laser will be lit. Look that nobody is in the beam's way.")
        with ui.row():
            ui.button("Go on with it", on_click=tab.act(resume)).props(f'color="positive" {DELIBERATE}')
            ui.button("Not now", on_click=begin.close).props("outline")
    with ui.row().classes("items-center"):
        for name, do, words in (
            ("Report", report, "open the report, key o"),
            ("Rerun", view, "show the marked sessions in Rerun, key v"),
            ("Replay", replay, "replay the last run in Rerun, ten times as fast"),
            ("Compare", compare, "compare the marked sessions"),
            ("Fit again", fit, "fit all runs again into a folder of their own"),
            ("Resume …", ask_resume, "make the runs that are missing"),
        ):
            ui.button(name, on_click=tab.act(do)).props(f'outline aria-label="{words}"').tooltip(words)
        ending = ui.button("End it", on_click=tab.act(end)).props("flat")
    with ui.column().classes("full-width box"):
        table = ui.table(
            columns=[
                {"name": name, "label": name, "field": name, "align": "left", "sortable": True}
                for name in _COLUMNS
            ],
            rows=[],
            row_key="folder",
            selection="multiple",
            pagination=10,
        ).classes("full-width")
        table.props('dense flat aria-label="sessions" rows-per-page-label="sessions a page:"')
        table.props(""":selected-rows-label="n => n + ' marked'" """)
        table.add_slot("header-selection", f"<span class='unseen'>marked</span>{_MARK}".replace("NAME", "'all'"))
        table.add_slot("body-selection", _MARK.replace("NAME", "props.row.folder"))
        none = ui.label(f"no session in {output} yet").classes("dim")
    with ui.column().classes("full-width box q-mt-sm"):
        ui.label("what the commands say").classes("title")
        links = ui.row()
        words_of = ui.label().classes("full-width").props('role="log"')
        words_of.style("white-space: pre; overflow: auto; max-height: 300px; font: 13px monospace")
    tab.key("o", tab.act(report))
    tab.key("v", tab.act(view))
    shown: list[tuple[str, str]] = []

    def refresh() -> None:
        nonlocal shown
        found = list_sessions(output, desk.following.folder)
        rows.clear()
        rows.update({str(row.folder): row for row in found})
        listed = [{name: str(getattr(row, name)) for name in _COLUMNS} for row in found]
        if listed != table.rows:
            table.rows = listed
            marked = {row["folder"] for row in table.selected}
            table.selected = [row for row in listed if row["folder"] in marked]
            table.update()
        none.set_visibility(not found)
        said = []
        for name, job in again.jobs.items():
            state = "runs" if job.running else "done" if job.status == 0 else "failed"
            said += [f"rig {name}: {state}", *list(job.said)[-_LAST_LINES:]]
        words_of.set_text("\n".join(said))
        ending.set_visibility(any(job.running for job in again.jobs.values()))
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
    refresh()
