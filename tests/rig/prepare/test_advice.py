"""Following the advice brings the simulated rig within the limits; the effect of a turn is learned."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.balance import BalanceLimits, Room, Unreachable, WeightResponses
from rig.instrument.balance import nominal_effects
from rig.prepare import BalanceStage, balance_dialogue
from rig.prepare.learned_turns import LearnedTurns, show_turns
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words
from tests.rig.prepare.cases import CONFIG, follow_advice, seen, state_of, trimmed_pendulum
from tests.rig.view.rrd_contents import column, measured

LIMITS = BalanceLimits()
U = np.array([0.01, 0.01, 1e-8])


def test_following_the_advice_balances_the_simulated_rig_in_few_moves() -> None:
    cases = [follow_advice(seed) for seed in range(4)]
    assert all(case.within_limits for case in cases)
    # from 10 arcmin, with weights that might be three times as strong as their drawings
    assert all(case.moves <= 8 for case in cases)


def test_without_any_knowledge_test_turns_are_advised_and_it_ends_in_the_limits() -> None:
    case = follow_advice(3, nominal_known=False)
    assert case.within_limits


def test_the_effect_of_a_turn_is_learned_to_the_error_of_the_hand() -> None:
    pendulum = trimmed_pendulum(4)
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    after = state_of(seen(pendulum.settings, 1))
    # the first turn takes up the play of the screw, the second shows the effect
    for seed in (2, 3):
        before = after
        pendulum.turn("x", 3.0)
        after = state_of(seen(pendulum.settings, seed))
        responses.learn("x", 3.0, before, after, U)
    effect, u_effect = responses.effect("x")
    # the hand's error is 0.01 turn in 3 turns, the tilt's curvature 1e-5: a hundredth covers both
    assert effect[0] * 3.0 == pytest.approx(after[0] - before[0], rel=0.02)
    assert u_effect[0] < 0.05 * abs(effect[0])
    assert responses.learned_turns == {"x": 2, "y": 0, "height": 0}


@pytest.mark.parametrize(
    ("apart_deg", "moved_arcsec", "unreachable"), [(0.0, 40.0, True), (12.0, 40.0, False), (0.0, 0.3, False)]
)
def test_weights_are_out_of_reach_only_if_their_lines_are_known_to_be_one(
    apart_deg: float, moved_arcsec: float, unreachable: bool
) -> None:
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    for name, angle_deg in (("x", 30.0), ("y", 30.0 + apart_deg)):
        angle = math.radians(angle_deg)
        moved = moved_arcsec * np.array([math.cos(angle), math.sin(angle), 0.0])
        before = np.array([-25.0, 60.0, 3e-6])
        responses.learn(name, 0.5, before, before + moved, U)
    across = 50.0 * np.array([-math.sin(math.radians(30.0)), math.cos(math.radians(30.0)), 0.0])
    assert isinstance(responses.advise(across), Unreachable) == unreachable


def test_a_number_that_is_not_known_teaches_nothing() -> None:
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    mean, u = responses.effect("y")
    nan = np.full(3, np.nan)
    responses.learn("y", 1.0, nan, nan, U)
    assert (responses.effect("y")[0] == mean).all()
    assert (responses.effect("y")[1] == u).all()
    assert responses.advise(np.zeros(3)) is None


def test_the_sign_says_which_way() -> None:
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    away = responses.advise(np.array([100.0, 0.0, 0.0]))
    back = responses.advise(np.array([-100.0, 0.0, 0.0]))
    assert away is not None
    assert back is not None
    assert away.weight == back.weight == "x"
    assert away.turns == -back.turns < 0


@pytest.mark.parametrize("tilt_arcsec", [2.0, -2.0])
def test_where_no_turn_leaves_the_spot_on_the_sensor_a_small_one_goes_towards_balance(
    tilt_arcsec: float,
) -> None:
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    state = np.array([tilt_arcsec, 0.0, 0.0])
    nowhere = Room(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.full(2, -1e6))
    turn = responses.test_turn("x", state, nowhere, "no room")
    assert turn.turns == pytest.approx(-math.copysign(0.02, tilt_arcsec * responses.effect("x")[0][0]))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_balance_follows_its_own_advice_from_frames_on(tmp_path: Path) -> None:
    done = rig(
        *("balance", CONFIGS / "demo.toml", "--follow", "7"),
        *("--history-file", tmp_path / "history.jsonl", "--set", "simulation.axes.rest_fast_arcsec=25"),
        *("--set", "simulation.axes.rest_slow_arcsec=-20", "--rrd", tmp_path / "looks.rrd"),
        *set_words({key: value for key, value in SMALL.items() if key.startswith("simulation")}),
    )
    assert done.returncode == 0, done.stderr
    assert "turn weight" in done.stdout
    assert "the weights are right" in done.stdout or "balanced" in done.stdout
    looks = len((tmp_path / "history.jsonl").read_text().splitlines())
    assert looks >= 2
    turned = [json.loads(line) for line in (tmp_path / "audit.jsonl").read_text().splitlines()]
    assert [line["what"] for line in turned] == ["weight turned"] * done.stdout.count("turn weight")
    # one view of all looks, each behind the other, with the advice of each
    advice_s, advice = column(tmp_path / "looks.rrd", "/advice", "TextDocument:text")
    assert "turn weight" in str(advice[0])
    assert "balanced" in str(advice[-1])
    _, rest, _ = measured(tmp_path / "looks.rrd", "/balance/rest_x")
    assert abs(rest[0]) > 20 > 10 > abs(rest[-1])
    assert advice_s[-1] > (looks - 1) * 12.0
    _, events = column(tmp_path / "looks.rrd", "/events", "TextLog:text")
    assert sum("restarted" in str(text) for text in events) == looks - 1


def test_a_history_without_turns_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    show_turns(CONFIG, tmp_path / "none.jsonl")
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'none.jsonl'}: no turn of a weight is noted yet")


def test_a_history_that_was_cut_short_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    history = tmp_path / "history.jsonl"
    turn = {"weight": "x", "turns": 3.0, "before": [30.0, 0, 0], "after": [0.0, 0, 0], "u": [0.01] * 3}
    history.write_text(json.dumps(turn) + "\n" + json.dumps(turn)[:40] + "\n[]\n")
    session = LearnedTurns(CONFIG, history)
    assert session.responses.learned_turns == {"x": 1, "y": 0, "height": 0}


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


def test_a_measurement_that_was_broken_off_advises_no_turn_that_has_been_made() -> None:
    turn = {"weight": "x", "parts": [0.5], "why": "it leans", "swing_arcsec": 58.2}
    told = [found(False, turn), ASK]
    assert balance_dialogue(told, [], running=True, failed=False).detail == (
        "it leans; then let it swing by at most 58 arcsec"
    )
    ended = balance_dialogue([*told, {"kind": "answer", "text": "q"}], [], running=False, failed=False)
    assert ended.turn == turn
    made = {"kind": "answer", "text": "x +0.5"}
    for lines in ([*told, made], [*told, made, {"kind": "live", "faults": []}]):
        broken_off = balance_dialogue(lines, [], running=False, failed=False)
        assert (broken_off.advice, broken_off.turn) == ("Measure", None)


def test_stages_and_answers_that_are_none() -> None:
    way = {"kind": "trajectory", "x": [1.0, None], "y": [2.0, None]}
    measuring = balance_dialogue([found(False), ASK, way], [], running=True, failed=False)
    assert (measuring.stage, measuring.turn) == (BalanceStage.MEASURING, None)
    assert (measuring.x, measuring.y) == ([1.0, None], [2.0, None])
    wrong = balance_dialogue(
        [found(False), {"kind": "wrong", "problem": "no"}, ASK], [], running=True, failed=False
    )
    assert wrong.problem == "no"
    failed = balance_dialogue([], ["b", "a", "rig: no camera"], running=False, failed=True)
    assert (failed.stage, failed.detail) == (BalanceStage.FAILED, "a rig: no camera")


def test_once_it_is_measured_the_whole_measurement_is_drawn_and_no_earlier_one() -> None:
    earlier = [{"kind": "trajectory", "x": [9.0], "y": [9.0]}, found(False), ASK]
    now = [{"kind": "trajectory", "x": [float(k)], "y": [0.0]} for k in range(90)]
    measuring = balance_dialogue([*earlier, *now], [], running=True, failed=False)
    assert (measuring.x[0], measuring.x[-1]) == (50.0, 89.0)
    measured = balance_dialogue([*earlier, *now, found(True), ASK], [], running=True, failed=False)
    assert measured.x == [float(k) for k in range(90)]
