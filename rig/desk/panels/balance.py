"""Balance: the advice, the trajectory, faults as bars against their limits."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from rig.balance import BalanceStage
from rig.desk import charts, tables
from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab, apart, at_once, box
from rig.instrument import WEIGHTS
from rig.presentation import judged_number

_STATE = {True: ("go", "go"), False: ("no", "NO"), None: ("dim", "?")}


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    balancing = desk.balancing
    advised: Mapping[str, Any] | None = None

    def turned() -> None:
        balancing.turned(str(weight.value), str(turns.value or ""))

    with ui.element("div").classes("at-once"):
        with ui.row().classes("box full-width items-start no-wrap told"):
            with ui.column().classes("col").style("gap: 4px"):
                ui.html("what to do", tag="h3", sanitize=False).classes("title")
                advice = ui.label().classes("advice").props('role="status" aria-live="polite"')
                detail = ui.label().classes("dim")
                with ui.row().classes("items-center"):
                    begin = tab.button("Measure", apart(balancing.measure)).props(
                        f'color="positive" size="lg" aria-label="Measure the balance" {DELIBERATE}'
                    )
                    weight = at_once(ui.select(list(WEIGHTS), value=WEIGHTS[0], label="weight"))
                    weight.props("dense outlined").style("min-width: 100px")
                    turns = ui.input("turns, + clockwise").props('dense outlined data-key="turns"')
                    net = ui.label().classes("dim")
                    # the next measurement follows, which lights
                    stating = tab.button("Turned", turned)
                    stating.props(f'color="positive" {DELIBERATE}')
                    ending = tab.button("End", balancing.end).props("outline")
                wrong = ui.label().classes("no").props('role="alert"')
            pendulum = ui.html(sanitize=False).classes("drawn")
        with ui.element("div").classes("grid halves"):
            with ui.column().classes("box"):
                way = charts.TrajectoryChart()
            with box("faults against their limits", "scrolls", region="faults"):
                faults = ui.html(sanitize=False).classes("full-width")
                tab.button("Forget the last turn", apart(balancing.forget)).props("dense outline")

    def prefill(turn: Mapping[str, Any] | None) -> None:
        """What is advised stands in the fields, once: what is typed over it stays."""
        nonlocal advised
        if turn == advised:
            return
        advised = turn
        net.set_text("" if turn is None else net_of(turn["parts"]))
        if turn is not None:
            weight.set_value(turn["weight"])
            turns.set_value(" ".join(f"{part:+.2f}" for part in turn["parts"]))

    def refresh() -> None:
        shown = balancing.shown
        prefill(shown.turn)
        begin.set_enabled(shown.stage is not BalanceStage.MEASURING)
        begin.set_text("Measure again" if shown.asks else "Measure")
        stating.set_enabled(shown.asks)
        ending.set_visibility(balancing.running)
        advice.set_text(shown.advice)
        detail.set_text(shown.detail)
        wrong.set_text(shown.problem)
        pendulum.set_content(drawing(shown.turn))
        faults.set_content(tables.bars(fault_bars(shown.faults, shown.before), "faults of the balance"))
        way.show(shown.x, shown.y, balancing.unit)

    tab.every(0.3, refresh)
    refresh()


def net_of(parts: Sequence[float]) -> str:
    """What several turns of a screw come to; empty for one."""
    if len(parts) < 2:
        return ""
    return f"net {sum(parts):+.2f} (the second turn takes up the play)"


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
            parts.append(_arrow(x, y, turn["parts"][0]))
    said = ""
    if turn is not None:
        clock = ", then ".join(
            f"{abs(part):.2f} {'clockwise' if part > 0 else 'anticlockwise'}" for part in turn["parts"]
        )
        said = f"turn weight {turn['weight']}: {clock}"
        parts.append("<text x='4' y='184'>the arrow: as one looks at the weight's screw</text>")
    return (
        "<svg viewBox='0 0 330 190' width='100%' style='max-height:170px' role='img' "
        f"aria-label='{said or 'the pendulum and its weights'}'>{''.join(parts)}</svg>"
    )


def _arrow(x: int, y: int, turns: float) -> str:
    """Three quarters of a circle round (x, y), with its head; clockwise as seen for `turns` > 0."""
    return (
        f"<g transform='translate({x} {y}) scale(1 {math.copysign(1, turns):g})' fill='none' "
        "stroke='var(--warn)' stroke-width='3'><path d='M0 -20A20 20 0 1 1 -20 0'/>"
        "<path d='M-20 -9L-13.9 6.6H-26.1Z' fill='var(--warn)' stroke='none'/></g>"
    )


def fault_bars(
    faults: Sequence[Mapping[str, Any]], before: Sequence[Mapping[str, Any]]
) -> list[tables.LimitBar]:
    """A bar for each fault; what is not known is grey, and never go."""
    rows = []
    before = [_in_its_unit(fault) for fault in before]
    for k, fault in enumerate(map(_in_its_unit, faults)):
        part, limit_part = tables.against_limit(fault["value"], fault["limit"])
        was = f"before: {_number(before[k])}" if k < len(before) else ""
        meaning = str(fault["meaning"]) if fault["ok"] is False else ""
        note = "; ".join(filter(None, (meaning, f"limit {fault['limit']:g} {fault['unit']}".rstrip(), was)))
        shown = f"{_STATE[fault['ok']][1]} {_number(fault)}"
        rows.append(
            tables.LimitBar(str(fault["name"]), shown, part, limit_part, _STATE[fault["ok"]][0], note)
        )
    return rows


def _in_its_unit(fault: Mapping[str, Any]) -> Mapping[str, Any]:
    """A fraction in per cent, as sessions and reports have it."""
    if fault["unit"]:
        return fault
    numbers = {name: fault[name] for name in ("value", "u_value", "limit")}
    return {**fault, **{name: one and 100 * one for name, one in numbers.items()}, "unit": "%"}


def _number(fault: Mapping[str, Any]) -> str:
    if fault["value"] is None or fault["u_value"] is None:
        return "not known"
    shown = judged_number(fault["value"], fault["u_value"], fault["limit"])
    return f"{shown} {fault['unit']}".rstrip()
