"""The dialogue of the balance as a page shows it: an unknown fault is never go."""

from typing import Any

from rig.prepare import BalanceStage, balance_dialogue


def fault(ok: bool | None) -> dict[str, Any]:
    value = None if ok is None else 1.0
    return {
        "name": "spin",
        "value": value,
        "u_value": value,
        "unit": "",
        "limit": 2.0,
        "meaning": "m",
        "ok": ok,
    }


def found(ok: bool | None, turn: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"kind": "found", "faults": [fault(ok)], "before": [], "text": "balanced: all", "turn": turn}


ASK = {"kind": "ask", "question": "?"}


def test_what_is_not_known_is_measured_again() -> None:
    shown = balance_dialogue([found(None), ASK], [], running=True, failed=False)
    assert shown.asks
    assert shown.advice == "Measure again, with a larger swing"
    assert shown.unknown == ["spin"]
    assert "spin" in shown.detail
    assert balance_dialogue([found(True), ASK], [], running=True, failed=False).advice == "Balanced: all"


def test_the_advice_is_short_and_says_why_beside() -> None:
    turn = {"weight": "x", "parts": [0.5, -0.25], "why": "it leans", "swing_arcsec": None}
    shown = balance_dialogue([found(False, turn), ASK], [], running=True, failed=False)
    assert shown.advice == "Turn weight x: 0.50 turns clockwise, then 0.25 turns anticlockwise"
    assert shown.detail == "it leans; the second turn takes the play out of the screw"
    assert shown.turn == turn


def test_stages_and_answers_that_are_none() -> None:
    way = {"kind": "way", "x": [1.0, None], "y": [2.0, None]}
    measuring = balance_dialogue([found(False), ASK, way], [], running=True, failed=False)
    assert (measuring.stage, measuring.turn) == (BalanceStage.MEASURING, None)
    assert (measuring.x, measuring.y) == ([1.0, None], [2.0, None])
    wrong = balance_dialogue(
        [found(False), {"kind": "wrong", "problem": "no"}, ASK], [], running=True, failed=False
    )
    assert wrong.problem == "no"
    failed = balance_dialogue([], ["a", "rig: no camera"], running=False, failed=True)
    assert (failed.stage, failed.detail) == (BalanceStage.FAILED, "a rig: no camera")


def test_once_it_is_measured_the_whole_measurement_is_drawn_and_no_earlier_one() -> None:
    earlier = [{"kind": "way", "x": [9.0], "y": [9.0]}, found(False), ASK]
    now = [{"kind": "way", "x": [float(k)], "y": [0.0]} for k in range(90)]
    measuring = balance_dialogue([*earlier, *now], [], running=True, failed=False)
    assert (measuring.x[0], measuring.x[-1]) == (50.0, 89.0)
    measured = balance_dialogue([*earlier, *now, found(True), ASK], [], running=True, failed=False)
    assert measured.x == [float(k) for k in range(90)]
