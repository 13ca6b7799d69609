"""Balance: the advice, the trajectory, faults as bars against their limits."""

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import ui

from rig.desk import charts, tables
from rig.desk.desk import Desk
from rig.desk.tab import DELIBERATE, Tab, box, in_background, text_field
from rig.instrument import WEIGHTS
from rig.prepare import BalanceStage
from rig.terminal import judged_number

_VERDICTS = {True: ("go", "go"), False: ("no", "NO"), None: ("dim", "?")}
"""Class and text of a fault's verdict; None: not known."""


def build(desk: Desk, tab: Tab) -> None:
    balancing = desk.balancing
    dialogue = balancing.dialogue
    advised: Mapping[str, Any] | None = None

    def refresh() -> None:
        """Read the present state; the advice is written into the fields once, so that typed values stay."""
        nonlocal dialogue, advised
        dialogue = balancing.dialogue
        if dialogue.turn != advised and dialogue.turn is not None:
            weight.set_value(dialogue.turn["weight"])
            turns.set_value(" ".join(f"{part:+.2f}" for part in dialogue.turn["parts"]))
        advised = dialogue.turn

    def state_turn() -> None:
        balancing.state_turn(str(weight.value), str(turns.value or ""))
        # the field is for the next turn
        turns.set_value("")

    with ui.element("div").classes("at-once"):
        with ui.row().classes("box full-width items-start no-wrap told"):
            with ui.column().classes("col").style("gap: 4px"):
                ui.html("what to do", tag="h3", sanitize=False).classes("title")
                tab.label(lambda: dialogue.advice, "advice", 'role="status" aria-live="polite"')
                tab.label(lambda: dialogue.detail, "dim")
                with ui.row().classes("items-center"):
                    tab.button(
                        lambda: "Measure again" if dialogue.asks else "Measure",
                        in_background(balancing.measure),
                        f'color="positive" size="lg" aria-label="Measure the balance" {DELIBERATE}',
                        enabled=lambda: dialogue.stage is not BalanceStage.MEASURING,
                    )
                    weight = ui.select(list(WEIGHTS), value=WEIGHTS[0], label="weight")
                    weight.props("dense outlined").style("min-width: 100px")
                    turns = text_field("turns, + clockwise", key="turns")
                    tab.label(lambda: "" if advised is None else net_of(advised["parts"]), "dim")
                    # the next measurement follows, which lights
                    props = f'color="positive" {DELIBERATE}'
                    tab.button("Turned", state_turn, props, enabled=lambda: dialogue.asks)
                    tab.button("End", balancing.end, "outline", visible=lambda: balancing.running)
                tab.label(lambda: dialogue.problem, "no", 'role="alert"')
            tab.html(lambda: drawing(dialogue.turn), "drawn")
        with ui.element("div").classes("grid halves"):
            with ui.column().classes("box"):
                trajectory = charts.TrajectoryChart()
            with box("faults against their limits", "scrolls", region="faults"):
                tab.html(
                    lambda: tables.bars(
                        fault_bars(dialogue.faults, dialogue.earlier_faults), "faults of the balance"
                    )
                )
                tab.button("Forget the last turn", in_background(balancing.forget), "dense outline")
    tab.on_refresh(refresh)
    tab.on_refresh(lambda: trajectory.show(dialogue.x, dialogue.y, "arcsec"))


def net_of(parts: Sequence[float]) -> str:
    """Sum of several turns of a screw, as text; empty for a single turn."""
    if len(parts) < 2:
        return ""
    return f"net {sum(parts):+.2f} (the second turn takes up the play)"


def drawing(turn: Mapping[str, Any] | None) -> str:
    """The pendulum from above and from the side with its weights; an arrow around the weight to be turned."""
    svg = tables.static("weights.svg")
    if turn is None:
        return svg.replace("LABEL", "the pendulum and its weights")
    senses = ["clockwise" if part > 0 else "anticlockwise" for part in turn["parts"]]
    parts = ", then ".join(
        f"{abs(part):.2f} {sense}" for part, sense in zip(turn["parts"], senses, strict=True)
    )
    weight = f"weight {turn['weight']}"
    return svg.replace("LABEL", f"turn {weight}: {parts}").replace(
        f'class="{weight}"', f'class="{weight} turned {senses[0]}"'
    )


def fault_bars(
    faults: Sequence[Mapping[str, Any]], earlier_faults: Sequence[Mapping[str, Any]]
) -> list[tables.LimitBar]:
    """A bar for each fault; a fault that is not known is grey, and never go."""
    bars = []
    earlier = [f"before: {_number(_in_shown_unit(fault))}" for fault in earlier_faults]
    for k, fault in enumerate(map(_in_shown_unit, faults)):
        fraction, limit_fraction = tables.against_limit(fault["value"], fault["limit"])
        meaning = [str(fault["meaning"])] if fault["ok"] is False and fault["meaning"] else []
        limit = f"limit {fault['limit']:g} {fault['unit']}".rstrip()
        note = "; ".join([*meaning, limit, *earlier[k : k + 1]])
        kind, verdict = _VERDICTS[fault["ok"]]
        text = f"{verdict} {_number(fault)}"
        bars.append(tables.LimitBar(str(fault["name"]), text, fraction, limit_fraction, kind, note))
    return bars


def _in_shown_unit(fault: Mapping[str, Any]) -> Mapping[str, Any]:
    """A fault with its numbers in per cent if they are fractions, as in sessions and reports."""
    if fault["unit"]:
        return fault
    percents = {key: fault[key] and 100 * fault[key] for key in ("value", "u_value", "limit")}
    return {**fault, **percents, "unit": "%"}


def _number(fault: Mapping[str, Any]) -> str:
    if fault["value"] is None or fault["u_value"] is None:
        return "not known"
    number = judged_number(fault["value"], fault["u_value"], fault["limit"])
    return f"{number} {fault['unit']}".rstrip()
