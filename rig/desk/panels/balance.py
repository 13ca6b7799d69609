"""Balance: the stretched trajectory, arrows at the weights of the pendulum, what was learned."""

import html
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import run, ui

from processing.errors import ConfigurationError, RigError
from rig.balance import HEAD, Learned, history_path, learned
from rig.desk import drawings
from rig.desk.desk import Desk
from rig.desk.jobs import Job
from rig.desk.tab import DELIBERATE, Tab, tell
from rig.instrument import WEIGHTS, complete
from rig.presentation import with_uncertainty

_STRETCHES = (1.0, 5.0, 20.0)
_WAY_LINES = 40
_STATE = {True: ("go", "go"), False: ("no", "NO"), None: ("dim", "?")}


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    stretch = 0

    def job() -> Job | None:
        found = desk.jobs.get("balance")
        return found if found is not None and found.running else None

    async def measure() -> None:
        running = job()
        if running is None:
            words = ["--seed", "1"] if desk.config.simulated else []
            await run.io_bound(desk.start, "balance", "--json", *words)
        elif _asks(running):
            running.answer("")

    def turned() -> None:
        running = job()
        if running is None or not _asks(running):
            raise ConfigurationError("first measure: a turn is stated between two measurements")
        running.answer(f"{weight.value} {(turns.value or '').strip()}")

    async def forget() -> None:
        running = job()
        if running is not None:
            if not _asks(running):
                raise ConfigurationError("wait for the end of the measurement")
            running.answer("f")
        else:
            await run.io_bound(desk.start, "balance", "--forget-last")
        await history()

    def end() -> None:
        running = job()
        if running is not None:
            if _asks(running):
                running.answer("q")
                running.ending = True
            else:
                running.end()

    async def history() -> None:
        try:
            found = await run.io_bound(_learned, desk)
        except RigError as error:
            tell(str(error))
            return
        if found is not None:
            rows = [list(HEAD), *found.rows] if found.rows else [["nothing was learned yet"]]
            text = "".join(f"<div>{html.escape(line)}</div>" for line in found.lines)
            past.set_content(drawings.table(rows, "turns that were learned from") + text)

    def stretched() -> None:
        nonlocal stretch
        stretch = (stretch + 1) % len(_STRETCHES)

    with ui.element("div").classes("three even"):
        with ui.column().classes("box"):
            with ui.row():
                begin = ui.button("Measure", on_click=tab.act(measure)).props(
                    f'color="positive" aria-label="measure the balance" {DELIBERATE}'
                )
                ui.button("End", on_click=tab.act(end)).props("outline")
                ui.button("Stretch", on_click=stretched).props("outline")
            way = ui.html(sanitize=False).classes("full-width")
        with ui.column().classes("box"):
            ui.label("what to turn").classes("title")
            advice = ui.label().classes("middle").props('role="status" aria-live="polite"')
            pendulum = ui.html(sanitize=False).classes("full-width")
            with ui.row().classes("items-center no-wrap full-width"):
                weight = (
                    ui.select(list(WEIGHTS), value=WEIGHTS[0], label="weight")
                    .props("dense outlined")
                    .style("min-width: 90px")
                )
                turns = ui.input("turns, + clockwise").props('dense outlined data-key="turns"')
                # the next measurement follows, which lights
                ui.button("Turned", on_click=tab.act(turned)).props(f'color="positive" {DELIBERATE}')
            wrong = ui.label().classes("no").props('role="alert"')
        with ui.column().classes("box"):
            ui.label("faults").classes("title")
            faults = ui.html(sanitize=False).classes("full-width")
    with ui.column().classes("full-width box"):
        with ui.row().classes("items-center"):
            ui.label("history").classes("title")
            ui.button("Show", on_click=history).props("dense outline")
            ui.button("Forget the last turn", on_click=tab.act(forget)).props("dense outline")
        past = ui.html(sanitize=False).classes("full-width")

    def refresh() -> None:
        shown = desk.jobs.get("balance")
        begin.set_enabled(shown is None or not shown.running or _asks(shown))
        if shown is None:
            news = desk.following.news
            path = news.get("path") or {"x": [], "y": []}
            next_step = (news.get("balance") or {}).get("next_step")
            advice.set_text(next_step or "measure: let it swing, not too far")
            unit = str(news.get("unit") or "arcsec")
            way.set_content(drawings.trajectory(path["x"], path["y"], unit, (380, 330), _STRETCHES[stretch]))
            pendulum.set_content(drawing(None))
            return
        x, y = _way(shown)
        way.set_content(drawings.trajectory(x, y, "arcsec", (380, 330), _STRETCHES[stretch]))
        last: Mapping[str, Any] = next(
            (one for one in reversed(shown.lines) if one["kind"] in ("found", "rejected")), {}
        )
        words = str(last.get("why") or last.get("text") or "")
        if shown.running and not _asks(shown):
            words = "measuring: hands off"
        if not shown.running and shown.status:
            words = " ".join(list(shown.said)[-2:]) or words
        advice.set_text(words)
        pendulum.set_content(drawing(last.get("turn") if not shown.running or _asks(shown) else None))
        seen = shown.newest.get("found" if _asks(shown) else "live", {})
        faults.set_content(_table(seen.get("faults") or [], seen.get("before") or []))
        said = shown.lines[-1] if shown.lines else {}
        again = shown.lines[-2] if len(shown.lines) > 1 else {}
        wrong.set_text(str(again.get("problem") or said.get("problem") or ""))

    tab.every(0.3, refresh)
    refresh()


def drawing(turn: Mapping[str, Any] | None) -> str:
    """The pendulum from above and from the side, its weights, an arrow round the one to be turned."""
    places = {"x": (150, 60), "y": (60, 145), "height": (270, 40)}
    parts = [
        "<circle cx='60' cy='60' r='30' fill='none' stroke='var(--ink)' stroke-width='2'/>",
        "<circle cx='60' cy='60' r='5' fill='var(--ink)'/>",
        "<line x1='90' y1='60' x2='150' y2='60' stroke='var(--ink)' stroke-width='3'/>",
        "<line x1='60' y1='90' x2='60' y2='145' stroke='var(--ink)' stroke-width='3'/>",
        "<line x1='270' y1='40' x2='270' y2='130' stroke='var(--ink)' stroke-width='3'/>",
        "<circle cx='270' cy='138' r='8' fill='none' stroke='var(--ink)' stroke-width='2'/>",
        "<line x1='225' y1='147' x2='315' y2='147' stroke='var(--dim)'/>",
        "<text x='4' y='14'>from above</text><text x='225' y='14'>from the side</text>",
    ]
    for name, (x, y) in places.items():
        chosen = turn is not None and turn["weight"] == name
        colour = "var(--warn)" if chosen else "var(--dim)"
        parts.append(f"<circle cx='{x}' cy='{y}' r='11' fill='{colour}'/>")
        parts.append(f"<text x='{x + 15}' y='{y + 24}'>{name}</text>")
        if chosen and turn is not None:
            parts += [_arrow(x, y, math.copysign(1.0, part)) for part in turn["parts"][:1]]
    said = ""
    if turn is not None:
        clock = ", then ".join(
            f"{abs(part):.2f} {'clockwise' if part > 0 else 'anticlockwise'}" for part in turn["parts"]
        )
        said = f"turn weight {turn['weight']}: {clock}"
        parts.append("<text x='4' y='184'>the arrow: as one looks at the weight's screw</text>")
    return (
        "<svg viewBox='0 0 330 190' width='100%' style='max-height:210px' role='img' "
        f"aria-label='{said or 'the pendulum and its weights'}'>{''.join(parts)}</svg>"
    )


def _arrow(x: float, y: float, sense: float) -> str:
    """Three quarters of a circle round (x, y), with its head; `sense` > 0: clockwise as seen."""
    radius = 20.0
    turned = [sense * math.radians(-90 + 270 * part / 24) for part in range(25)]
    at = [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in turned]
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in at)
    (tip_x, tip_y), angle = at[-1], turned[-1] + sense * math.pi / 2
    head = " ".join(
        f"{tip_x + 9 * math.cos(angle + off):.1f},{tip_y + 9 * math.sin(angle + off):.1f}"
        for off in (0.0, 2.4, -2.4)
    )
    return (
        f"<polyline points='{line}' fill='none' stroke='var(--warn)' stroke-width='3'/>"
        f"<polygon points='{head}' fill='var(--warn)'/>"
    )


def _asks(job: Job) -> bool:
    """Whether the command waits for an answer."""
    return bool(job.lines) and job.lines[-1]["kind"] == "ask"


def _way(job: Job) -> tuple[list[float | None], list[float | None]]:
    x: list[float | None] = []
    y: list[float | None] = []
    pieces = deque((one for one in job.lines if one["kind"] == "way"), maxlen=_WAY_LINES)
    for piece in pieces:
        x += piece["x"]
        y += piece["y"]
    return x, y


def _table(faults: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for k, fault in enumerate(faults):
        style, word = _STATE[fault["ok"]]
        was = f"<td class='dim'>{_number(before[k])}</td>" if k < len(before) else ""
        meaning = "" if fault["ok"] in (True, None) else html.escape(str(fault["meaning"]))
        rows.append(
            f"<tr><td class='{style}'>{word}</td><th scope='row'>{html.escape(str(fault['name']))}</th>"
            f"<td>{_number(fault)}</td>{was}<td class='dim'>limit {fault['limit']:g}</td></tr>"
            + (f"<tr><td></td><td colspan='4'>{meaning}</td></tr>" if meaning else "")
        )
    return f"<table class='rows' aria-label='faults of the balance'>{''.join(rows)}</table>"


def _number(fault: Mapping[str, Any]) -> str:
    if fault["value"] is None or fault["u_value"] is None:
        return "not known"
    shown = with_uncertainty(fault["value"], fault["u_value"], signed=True)
    return html.escape(f"{shown} {fault['unit']}".rstrip())


def _learned(desk: Desk) -> Learned:
    config = complete(desk.checked())
    return learned(config, history_path(config, None))
