"""Balance: the advice, the trajectory, faults as bars against their limits."""

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from rig.desk import charts, tables
from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab, apart, box, text_field
from rig.instrument import WEIGHTS
from rig.prepare import BalanceStage
from rig.terminal import judged_number

_STATE = {True: ("go", "go"), False: ("no", "NO"), None: ("dim", "?")}


def build(desk: Desk, tab: Tab) -> None:
    """Build the panel."""
    balancing = desk.balancing
    shown = balancing.shown
    advised: Mapping[str, Any] | None = None

    def refresh() -> None:
        """Take the present state; the advice is written into the fields once, so that typed values stay."""
        nonlocal shown, advised
        shown = balancing.shown
        if shown.turn != advised and shown.turn is not None:
            weight.set_value(shown.turn["weight"])
            turns.set_value(" ".join(f"{part:+.2f}" for part in shown.turn["parts"]))
        advised = shown.turn

    def turned() -> None:
        balancing.turned(str(weight.value), str(turns.value or ""))
        # a turn that was noted must not stand there as one that is yet to be noted
        turns.set_value("")

    with ui.element("div").classes("at-once"):
        with ui.row().classes("box full-width items-start no-wrap told"):
            with ui.column().classes("col").style("gap: 4px"):
                ui.html("what to do", tag="h3", sanitize=False).classes("title")
                tab.label(lambda: shown.advice, "advice", 'role="status" aria-live="polite"')
                tab.label(lambda: shown.detail, "dim")
                with ui.row().classes("items-center"):
                    tab.button(
                        lambda: "Measure again" if shown.asks else "Measure",
                        apart(balancing.measure),
                        f'color="positive" size="lg" aria-label="Measure the balance" {DELIBERATE}',
                        enabled=lambda: shown.stage is not BalanceStage.MEASURING,
                    )
                    weight = ui.select(list(WEIGHTS), value=WEIGHTS[0], label="weight")
                    weight.props("dense outlined").style("min-width: 100px")
                    turns = text_field("turns, + clockwise", key="turns")
                    tab.label(lambda: "" if advised is None else net_of(advised["parts"]), "dim")
                    # the next measurement follows, which lights
                    props = f'color="positive" {DELIBERATE}'
                    tab.button("Turned", turned, props, enabled=lambda: shown.asks)
                    tab.button("End", balancing.end, "outline", seen=lambda: balancing.running)
                tab.label(lambda: shown.problem, "no", 'role="alert"')
            tab.html(lambda: drawing(shown.turn), "drawn")
        with ui.element("div").classes("grid halves"):
            with ui.column().classes("box"):
                way = charts.TrajectoryChart()
            with box("faults against their limits", "scrolls", region="faults"):
                tab.html(
                    lambda: tables.bars(
                        fault_bars(shown.faults, shown.earlier_faults), "faults of the balance"
                    )
                )
                tab.button("Forget the last turn", apart(balancing.forget), "dense outline")
    tab.keep(refresh)
    tab.keep(lambda: way.show(shown.x, shown.y, "arcsec"))


def net_of(parts: Sequence[float]) -> str:
    """Sum of several turns of a screw, as text; empty for a single turn."""
    if len(parts) < 2:
        return ""
    return f"net {sum(parts):+.2f} (the second turn takes up the play)"


def drawing(turn: Mapping[str, Any] | None) -> str:
    """The pendulum from above and from the side, its weights, an arrow round the one to be turned."""
    drawn = tables.static("weights.svg")
    if turn is None:
        return drawn.replace("LABEL", "the pendulum and its weights")
    ways = ["clockwise" if part > 0 else "anticlockwise" for part in turn["parts"]]
    parts = ", then ".join(f"{abs(part):.2f} {way}" for part, way in zip(turn["parts"], ways, strict=True))
    weight = f"weight {turn['weight']}"
    return drawn.replace("LABEL", f"turn {weight}: {parts}").replace(
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
