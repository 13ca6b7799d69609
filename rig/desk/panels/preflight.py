"""The checks before a run, a light for each with its number and remedy."""

import html
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import run, ui

from rig.desk.desk import Desk
from rig.desk.following import doing
from rig.desk.tab import DELIBERATE, Tab, at_once


class PreflightChecks:
    """The button that runs the checks, their verdict, and a light for each."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        with ui.column().classes("box"):
            with ui.row().classes("items-center"):
                self._button = tab.button("Run preflight", self._start)
                self._button.props(f'color="positive" size="lg" {DELIBERATE}')
                self._ending = tab.button("End", self._end).props("outline")
                self._verdict = ui.label().classes("advice").props('role="status" aria-live="polite"')
                self._words = ui.label().style("white-space: pre-line")
            self._failing = ui.html(sanitize=False).classes("full-width")
            with at_once(ui.expansion("passed")).classes("full-width") as self._folded:
                self._passing = ui.html(sanitize=False).classes("full-width")

    def refresh(self) -> None:
        """Show what the running session, or the last command, has found."""
        job, news = self._desk.jobs.get("doctor"), self._desk.following.news
        found: Sequence[Mapping[str, Any]] = ()
        said = "it checks whether a run can be made"
        if news.get("preflight"):
            found = news["preflight"]
        elif job is not None:
            found = job.newest.get("preflight", {}).get("table", ())
            said = "\n".join(list(job.said)[-3:])
            if job.running:
                said = doing(job.newest.get("state")) or "the camera is opened"
        self._button.set_enabled(job is None or not job.running)
        self._ending.set_visibility(job is not None and job.running and not found)
        against = [one for one in found if not one["ok"]]
        shown_first = against + [one for one in found if one["ok"] and (one["remedy"] or not one["made"])]
        passed = [one for one in found if one not in shown_first]
        self._verdict.set_text("" if not found else "NO-GO" if against else "GO")
        self._verdict.set_visibility(bool(found))
        self._verdict.classes(remove="go no", add="no" if against else "go")
        done = "" if self._desk.following.running else _next(len(against))
        self._words.set_text(done if found else said)
        self._failing.set_content(lights(shown_first))
        self._passing.set_content(lights(passed))
        self._folded.set_text(f"{len(passed)} of {len(found)} checks passed")
        self._folded.set_visibility(bool(passed))

    async def _start(self) -> None:
        await run.io_bound(self._desk.start, "doctor", "--preflight", "--json")

    def _end(self) -> None:
        if "doctor" in self._desk.jobs:
            self._desk.jobs["doctor"].end()


def _next(against: int) -> str:
    """What is to be done after the checks."""
    if not against:
        return "Nothing prevents a run: start it in Measure."
    what = "This stands" if against == 1 else f"These {against} stand"
    return f"{what} against a run: follow the remedies below, then run preflight again."


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
