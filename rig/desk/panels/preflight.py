"""Preflight: a light for each check with its number and remedy; what the plan expects of a run."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import run, ui

from processing.errors import RigError
from rig.desk import drawings
from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.tab import DELIBERATE, Tab, tell
from rig.instrument import complete
from rig.plan import expected_of, plan_expected, plan_table


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""

    async def start() -> None:
        await run.io_bound(desk.start, "preflight", "--json")

    def end() -> None:
        if "preflight" in desk.jobs:
            desk.jobs["preflight"].end()

    async def plan() -> None:
        working.set_visibility(True)
        try:
            rows = await run.io_bound(_expected, desk) or []
            expected.set_content(drawings.table(rows, "what the plan expects"))
        except RigError as error:
            tell(str(error))
        finally:
            working.set_visibility(False)

    with ui.element("div").classes("two"):
        with ui.column().classes("box"):
            with ui.row().classes("items-center"):
                button = ui.button("Run preflight", on_click=tab.act(start)).props(
                    f'color="positive" aria-label="run preflight" {DELIBERATE}'
                )
                ending = ui.button("End", on_click=tab.act(end)).props("outline")
                verdict = ui.label().classes("middle").props('role="status" aria-live="polite"')
            table = ui.html(sanitize=False).classes("full-width")
        with ui.column().classes("box"):
            ui.label("what a run will tell").classes("title")
            ui.button("Plan", on_click=plan).props("outline")
            working = ui.spinner()
            working.set_visibility(False)
            expected = ui.html(sanitize=False).classes("full-width")

    def refresh() -> None:
        job = desk.jobs.get("preflight")
        news = desk.following.news
        found: Sequence[Mapping[str, Any]] = ()
        words = ""
        if news.get("preflight"):
            found = news["preflight"]
        elif job is not None:
            found = job.newest.get("preflight", {}).get("table", ())
            words = "\n".join(list(job.said)[-3:])
            if job.running:
                words = doing(job.newest.get("state")) or "the camera is opened"
        button.set_enabled(job is None or not job.running)
        ending.set_visibility(job is not None and job.running)
        against = [one for one in found if not one["ok"]]
        verdict.set_text(words if not found else "NO-GO" if against else "GO")
        verdict.classes(remove="go no", add="no" if against else "go")
        table.set_content(lights(found))

    tab.every(0.3, refresh)
    refresh()


def lights(verdicts: Sequence[Mapping[str, Any]]) -> str:
    """A row for each verdict: its light, its number against the limit, reason and remedy."""
    rows = []
    for one in verdicts:
        judged = (
            ("no", "NO-GO") if not one["ok"]
            else ("caution", "caution") if one["remedy"]
            else ("go", "go") if one["made"]
            else ("dim", "not checked")
        )  # fmt: skip
        why = "; ".join(html.escape(str(one[key])) for key in ("reason", "remedy") if one[key])
        rows.append(
            f"<tr><td class='{judged[0]} judged'><span class='light' style='background: currentcolor'></span>"
            f"{judged[1]}</td><th scope='row'>{html.escape(str(one['name']))}</th>"
            f"<td>{html.escape(str(one['measured']))}</td>"
            f"<td class='dim'>{html.escape(str(one['limit']))}</td></tr>"
            + (f"<tr><td></td><td></td><td colspan='2' class='{judged[0]}'>{why}</td></tr>" if why else "")
        )
    return f"<table class='rows' aria-label='preflight'>{''.join(rows)}</table>"


def _expected(desk: Desk) -> list[list[str]]:
    """The plan's row for a run as configured, one line a quantity, and its remark."""
    config = complete(desk.checked())
    session = config.session
    plan = plan_expected(
        expected_of(config), [session.initial_amplitude_arcsec], [session.final_amplitude_arcsec]
    )
    table = plan_table(plan)
    rows = [[name, cell] for name, cell in zip(table.head, table.shown[0], strict=True)]
    return [*rows, ["", table.note]]
