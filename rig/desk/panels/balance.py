"""Balance: the advice, the trajectory, faults as bars against their limits."""

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
    drawn = tables.static("pendulum.svg")
    if turn is None:
        return drawn.replace("LABEL", "the pendulum and its weights")
    ways = ["clockwise" if part > 0 else "anticlockwise" for part in turn["parts"]]
    told = ", then ".join(f"{abs(part):.2f} {way}" for part, way in zip(turn["parts"], ways, strict=True))
    weight = f"weight {turn['weight']}"
    return drawn.replace("LABEL", f"turn {weight}: {told}").replace(
        f'class="{weight}"', f'class="{weight} turned {ways[0]}"'
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
