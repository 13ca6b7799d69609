"""After a run: how it went, the result with its whole uncertainty, what limits it, what comes next."""

import html

from nicegui import run, ui

from rig.desk import tables
from rig.desk.desk import Desk
from rig.desk.panels.runs import open_served
from rig.desk.tab import Tab, at_once
from rig.measure import HandOver, RunState

_KINDS = {RunState.COMPLETE: "go", RunState.STOPPED: "caution"}
NEXT_RUN = "next-run"
"""Name of the element on the page that begins the next one."""


def _to_next() -> None:
    ui.run_javascript(f"document.getElementById('{NEXT_RUN}').scrollIntoView({{block: 'start'}})")


class RunResult:
    """Shows what the last session hands over; built where it is made, hidden without one."""

    def __init__(self, desk: Desk, tab: Tab) -> None:
        self._desk = desk
        self._drawn: HandOver | None = None
        with ui.element("div").classes("grid wide-left") as self.frame:
            with ui.column().classes("box"):
                ui.html("the last session", tag="h3", sanitize=False).classes("title")
                with ui.row().classes("items-baseline"):
                    self._verdict = ui.label().classes("advice").props('role="status"')
                    self._went = ui.label().classes("dim")
                self._headline = ui.label().classes("advice")
                self._of = ui.label().classes("dim")
                self._next = ui.html(sanitize=False).classes("full-width")
                with ui.row():
                    self._report = ui.button("Report", on_click=self._open).props('outline size="lg"')
                    self._fits = tab.button("Fit", self._fit).props('outline size="lg"')
                    ui.button("Next run", on_click=_to_next).props('outline size="lg"')
                self._others = ui.html(sanitize=False).classes("full-width")
                with at_once(ui.expansion("its last words")).classes("full-width"):
                    self._words = ui.html(sanitize=False).classes("dim")
            with ui.column().classes("box") as self._found:
                ui.html("what limits it", tag="h3", sanitize=False).classes("title")
                self._limits = ui.html(sanitize=False).classes("full-width")
        self.frame.set_visibility(False)
        tab.every(1.0, self._refresh)

    async def _refresh(self) -> None:
        desk = self._desk
        if desk.following.running:
            return
        over = await run.io_bound(desk.hand_over)
        self.frame.set_visibility(over is not None)
        if over is None or over is self._drawn:
            return
        self._drawn = over
        self._verdict.set_text("no run made" if over.ended is None else over.ended.value)
        kind = "no" if over.ended is None else _KINDS.get(over.ended, "no")
        self._verdict.classes(remove="go caution no", add=kind)
        self._went.set_text(f"{over.folder.name}: {over.went}")
        self._headline.set_text(over.headline or "no result")
        self._of.set_text(f"the uncertainty is of {over.of}" if over.of else "")
        lines = [f"<li><b>{html.escape(step)}</b></li>" for step in over.next_steps]
        lines += [f"<li>{html.escape(remark)}</li>" for remark in over.remarks]
        self._next.set_content(f"<ul>{''.join(lines)}</ul>" if lines else "nothing can be done about it")
        self._others.set_content(tables.table(over.others, "all parameters") if over.others else "")
        self._words.set_content("<br>".join(map(html.escape, desk.last_words())))
        bars = [
            tables.Bar(one.name, f"{100 * one.share:.0f} %", one.share, None, "dim") for one in over.limits
        ]
        self._limits.set_content(tables.bars(bars, "sources of the uncertainty, by their share"))
        self._report.set_visibility(over.report is not None)
        # a run that has failed has a record, too
        self._fits.set_visibility(not over.headline)
        self._found.set_visibility(bool(over.limits))

    def _fit(self) -> None:
        if self._drawn is not None:
            self._desk.looking_again.fit(self._drawn.folder)
            ui.notify(f"rig fit {self._drawn.folder.name} runs; what it says is below the list of sessions")

    def _open(self) -> None:
        over = self._drawn
        if over is None or over.report is None:
            return
        open_served(self._desk, over.report)
