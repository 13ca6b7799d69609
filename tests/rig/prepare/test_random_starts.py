"""Balancing converges from random starts; what cannot be believed is rejected, and says why."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from processing.balance import Balance, Turn, balance_checks
from rig.prepare.dialogue import Reporter
from rig.prepare.learned_turns import (
    BalanceMeasurement,
    LearnedTurns,
    TurnEffect,
    append_turn,
    read_turns,
)
from tests.rig.command_line import CONFIGS, rig
from tests.rig.prepare.random_starts import LIMITS, follow, modelled_look, random_start

SHAPE = (640, 640)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_random_starts_end_in_balance(seed: int, tmp_path: Path) -> None:
    ended = follow(random_start(seed), seed, tmp_path / "history.jsonl")
    assert ended.converged
    assert not ended.off_the_sensor


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
