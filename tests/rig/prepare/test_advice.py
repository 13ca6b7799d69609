"""Following the advice brings the simulated rig within the limits; the effect of a turn is learned."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from processing.balance import (
    Balance,
    Room,
    Turn,
    Unreachable,
    WeightResponses,
    balance_checks,
)
from rig.instrument import complete
from rig.instrument.balance import nominal_effects
from rig.prepare import BalanceStage, balance_dialogue
from rig.prepare.dialogue import Reporter
from rig.prepare.learned_turns import (
    BalanceMeasurement,
    LearnedTurns,
    TurnEffect,
    append_turn,
    read_turns,
    show_turns,
)
from rig.settings import Configuration
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words
from tests.rig.prepare.random_starts import LIMITS, follow, modelled_look, random_start
from tests.rig.view.rrd_contents import column, measured

CONFIG = complete(Configuration(camera={"driver": "simulated"}))
U = np.array([0.01, 0.01, 1e-8])


def test_the_effect_of_a_turn_is_learned() -> None:
    responses = WeightResponses(nominal_effects(CONFIG), LIMITS)
    moved = np.array([210.0, -35.0, 0.0])
    # the first turn takes up the play of the screw, the second shows the effect
    for number in range(2):
        responses.learn("x", 3.0, number * moved, (number + 1) * moved, U)
    effect, u_effect = responses.effect("x")
    assert effect[:2] * 3.0 == pytest.approx(moved[:2], rel=0.02)
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


def found(ok: bool | None, turn: dict[str, Any] | None = None) -> dict[str, Any]:
    value = None if ok is None else 1.0
    fault = {"name": "spin", "value": value, "u_value": value, "unit": "", "limit": 2.0, "meaning": "m"}
    return {
        "kind": "found",
        "faults": [{**fault, "ok": ok}],
        "before": [],
        "text": "balanced: all",
        "turn": turn,
    }


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


SHAPE = (640, 640)


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_random_starts_end_in_balance(seed: int, tmp_path: Path) -> None:
    ended = follow(random_start(seed), seed, tmp_path / "history.jsonl")
    assert ended.converged
    assert not ended.off_the_sensor
    # with weights that might be three times as strong as their drawings
    assert ended.turns <= 8


def test_without_any_knowledge_of_the_weights_it_ends_in_balance(tmp_path: Path) -> None:
    start = random_start(2)
    balance = start.config.balance
    unknown = {
        name: getattr(balance, name).model_copy(update={"sense": 0})
        for name in ("weight_x", "weight_y", "weight_height")
    }
    config = start.config.model_copy(update={"balance": replace(balance, **unknown)})
    ended = follow(start._replace(config=config), 2, tmp_path / "history.jsonl")
    assert ended.converged


def test_parallel_weights_are_called_out_of_reach_within_four_looks(tmp_path: Path) -> None:
    # with this start short turns would be lost in the play of the screws
    ended = follow(random_start(3, parallel=True), 3, tmp_path / "history.jsonl")
    assert ended.said_unreachable
    assert ended.looks <= 4


def the_other_way(turn: Turn) -> Turn:
    return turn._replace(turns=-turn.turns, then=-turn.then)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "seed"), [(0, 0), (1, 1), (2, 2)])
def test_a_turn_made_the_wrong_way_is_recovered_from(
    seed: int, wrong: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def hand(number: int, turn: Turn) -> Turn:
        return the_other_way(turn) if number == wrong else turn

    ended = follow(random_start(seed), seed, tmp_path / "history.jsonl", 25, hand)
    assert ended.converged, ended


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("weight", ["x", "height"])
def test_a_weight_that_does_not_move_is_named(
    seed: int, weight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def hand(_number: int, turn: Turn) -> Turn:
        return turn._replace(turns=0.0, then=0.0) if turn.weight == weight else turn

    ended = follow(random_start(seed), seed, tmp_path / "history.jsonl", 25, hand)
    said = capsys.readouterr().err
    if not ended.converged:
        assert f"it looks as if weight {weight} does not move" in said
        assert ended.said_unreachable
        assert ended.turns <= 15


@pytest.fixture
def sound() -> Balance:
    """A start whose swing stays on the sensor."""
    start = random_start(1)
    release = start.config.simulation.release.model_copy(update={"amplitude_arcsec": 40.0})
    balance = modelled_look(start.config.simulation.model_copy(update={"release": release}), 1).balance
    assert balance is not None
    return balance


def test_looks_that_cannot_be_believed_are_rejected_and_the_turn_is_kept(
    tmp_path: Path, sound: Balance
) -> None:
    session = LearnedTurns(random_start(1).config, tmp_path / "history.jsonl")
    assert session.take(BalanceMeasurement(sound, 0.0, SHAPE)) == ""
    session.note_turns("x", [0.2])
    assert "30 % of the spots were lost" in session.take(BalanceMeasurement(sound, 0.3, SHAPE))
    assert "no swing was seen" in session.take(BalanceMeasurement(None, 0.0, SHAPE))
    # half the period: a harmonic was taken for the swing
    assert "cannot be" in session.take(
        BalanceMeasurement(replace(sound, period_s=0.5 * sound.period_s), 0.0, SHAPE)
    )
    assert "not on the sensor" in session.take(BalanceMeasurement(replace(sound, rest_y=2e-3), 0.0, SHAPE))
    back = session.way_back()
    assert back is not None
    assert (back.weight, back.turns) == ("x", -0.1)
    assert not read_turns(tmp_path / "history.jsonl")
    assert session.take(BalanceMeasurement(replace(sound, rest_x=sound.rest_x + 5e-5), 0.0, SHAPE)) == ""
    (pair,) = read_turns(tmp_path / "history.jsonl")
    assert (pair.weight, pair.parts) == ("x", (0.2,))


def test_a_spot_that_is_gone_is_searched_on_both_sides_of_where_the_turn_began(
    tmp_path: Path, sound: Balance
) -> None:
    session = LearnedTurns(random_start(1).config, tmp_path / "history.jsonl")
    session.take(BalanceMeasurement(sound, 0.0, SHAPE))
    session.note_turns("x", [0.4])
    place, places = 0.4, []
    for _ in range(4):
        session.take(BalanceMeasurement(None, 1.0, SHAPE))
        back = session.way_back()
        assert back is not None
        session.note_turns("x", back.parts)
        places.append(place := place + back.turns)
    assert places == pytest.approx([0.2, 0.0, 0.6, 0.8])


def test_a_change_that_the_turn_cannot_have_made_is_not_learned(
    tmp_path: Path, sound: Balance, capsys: pytest.CaptureFixture[str]
) -> None:
    session = LearnedTurns(random_start(1).config, tmp_path / "history.jsonl")
    session.take(BalanceMeasurement(sound, 0.0, SHAPE))
    session.note_turns("height", [0.05])
    session.take(BalanceMeasurement(replace(sound, rest_x=sound.rest_x - 4e-4), 0.0, SHAPE))
    assert "nothing is learned from this turn" in capsys.readouterr().err
    assert session.responses.learned_turns["height"] == 0
    assert not read_turns(tmp_path / "history.jsonl")


def test_a_false_pair_of_an_earlier_session_is_not_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "history.jsonl"
    good = {
        "weight": "y",
        "turns": 0.5,
        "before": [0.0, 50.0, 0.0],
        "after": [0.0, 8.0, 0.0],
        "u": [0.01] * 3,
    }
    path.write_text(json.dumps(good) + "\n" + json.dumps({**good, "after": [0.0, 8.0, -18010e-6]}) + "\n")
    session = LearnedTurns(random_start(0).config, path)
    assert session.responses.learned_turns["y"] == 1
    assert "cannot be: the period that was found is not the pendulum's" in capsys.readouterr().err


def test_the_history_is_shown_and_its_last_turn_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "history.jsonl"
    for turns in (0.5, 0.25):
        zero = np.zeros(3)
        after = np.array([0.0, 84.0 * turns, 0.0])
        append_turn(path, TurnEffect("", "y", (turns,), zero, after, zero + 1e-9))
    words = ("balance", CONFIGS / "demo.toml", "--history-file", path)
    shown = rig(*words, "--history")
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.count("yes") == 2
    assert "one turn of y" in shown.stdout
    assert rig(*words, "--forget-last").stdout.count("yes") == 1
    assert [pair.parts for pair in read_turns(path)] == [(0.5,)]


def test_no_turn_is_larger_than_a_weak_weight_needs(tmp_path: Path, sound: Balance) -> None:
    config = random_start(1).config
    session = LearnedTurns(config, tmp_path / "history.jsonl")
    session.take(BalanceMeasurement(sound, 0.0, SHAPE))
    turn = session.advice()
    assert isinstance(turn, Turn)
    # 84 arcsec a turn by the drawing; a third of it, and the play of the screw
    distance = math.hypot(sound.rest_x, sound.rest_y) / 4.848e-6
    assert abs(turn.turns) < 2 * distance / (0.3 * 84) + 0.6 + 0.75


def test_what_was_not_determined_is_unknown_and_no_go(
    sound: Balance, capsys: pytest.CaptureFixture[str]
) -> None:
    faults = balance_checks(replace(sound, rotation_rad_per_s=math.nan), (0.0, 1e-6), LIMITS)
    Reporter().report_measurement(faults, [], None)
    lines = capsys.readouterr().out.splitlines()
    (spin,) = [line for line in lines if " spin" in line]
    assert spin.startswith("?")
