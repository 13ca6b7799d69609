"""Of two positions the one along the motion is found, whatever else either of them does."""

from pathlib import Path

import numpy as np
import pytest

from rig.analysis.results import SessionResults
from rig.intake.table import TableColumns
from rig.intake.trajectory import along_and_across
from tests.rig.intake.table_cases import analyse_table

T_S = np.arange(0.0, 200.0, 0.05)
PERIOD_S, DECREMENT = 2.5, 0.025
SWING = 100.0 * np.exp(-DECREMENT / PERIOD_S * T_S) * np.cos(2.0 * np.pi / PERIOD_S * T_S)


def noise(seed: int) -> np.ndarray:
    return np.asarray(0.02 * np.random.default_rng(seed).standard_normal(len(T_S)))


def fitted(folder: Path, x: np.ndarray, y: np.ndarray) -> SessionResults:
    path = folder / "two.csv"
    np.savetxt(path, np.column_stack([T_S, x, y]), delimiter=",", header="t,x,y", comments="", fmt="%.6f")
    return analyse_table(path, None, TableColumns(positions=("x", "y"), unit="mm"))


def judge(found: SessionResults, amplitude: float = 98.76) -> None:
    assert found.runs[0].amplitudes[0] == pytest.approx(amplitude, rel=1e-3)
    for estimate, true in (
        (found.number("mean_period_s"), PERIOD_S),
        (found.number("log_decrement"), DECREMENT),
    ):
        assert abs(estimate.value - true) < 4 * estimate.standard_uncertainty
        assert estimate.standard_uncertainty < 1e-4 * true


def test_a_value_that_stands_for_none_does_not_turn_the_direction(tmp_path: Path) -> None:
    x = noise(1)
    x[1000] = -9999.0
    judge(fitted(tmp_path, x, SWING + noise(2)))


@pytest.mark.parametrize("power", [1, 2])
def test_nor_does_a_rest_position_that_drifts_further_than_the_swing(tmp_path: Path, power: int) -> None:
    judge(fitted(tmp_path, 300.0 * (T_S / T_S[-1]) ** power + noise(1), SWING + noise(2)))


@pytest.mark.parametrize("turned_deg", [0.0, 37.0, 90.0, 143.0])
def test_the_direction_is_that_of_the_swing(turned_deg: float) -> None:
    sine, cosine = np.sin(np.radians(turned_deg)), np.cos(np.radians(turned_deg))
    x, y = SWING * sine + noise(1), SWING * cosine + noise(2)
    along, across = along_and_across((x, y))
    assert np.std(across) == pytest.approx(0.02, rel=0.05)
    assert abs(np.corrcoef(along, SWING)[0, 1]) > 0.999999


@pytest.mark.parametrize("turned_deg", [0.0, 37.0, 90.0, 143.0, 200.0, 290.0])
def test_an_ellipse_keeps_its_sense(turned_deg: float) -> None:
    """The singular vectors' signs decided it, so that planes of swing turned the other way."""
    sine, cosine = np.sin(np.radians(turned_deg)), np.cos(np.radians(turned_deg))
    aside = 0.1 * np.gradient(SWING, T_S) * PERIOD_S / (2.0 * np.pi)
    x, y = SWING * sine + aside * cosine, SWING * cosine - aside * sine
    along, across = along_and_across((x, y))
    area, found = (
        float(np.sum(one[:-1] * two[1:] - one[1:] * two[:-1])) for one, two in ((x, y), (across, along))
    )
    assert found == pytest.approx(area, rel=1e-3)


def test_a_swing_whose_direction_turns_is_followed(tmp_path: Path) -> None:
    """Its amplitude along one direction is too small wherever it goes another way."""
    angle = np.radians(20.0) * (T_S / T_S[-1] - 0.5)
    found = fitted(tmp_path, np.sin(angle) * SWING + noise(1), np.cos(angle) * SWING + noise(2))
    judge(found)
    (said,) = [one for one in found.runs[0].notes if "direction" in one]
    # the larger, first swings are most of the mean direction
    assert "4.48 degrees" in said
    assert "14.97 at last" in said
    assert not any("direction" in one for one in found.runs[0].warnings)
    straight = fitted(tmp_path, np.sin(0.3) * SWING + noise(1), np.cos(0.3) * SWING + noise(2))
    assert not any("direction" in one for one in (*straight.runs[0].notes, *straight.runs[0].warnings))


def test_so_is_a_second_push_in_another_direction(tmp_path: Path) -> None:
    rest = np.zeros(200)
    y = np.concatenate([SWING, rest, 0.6 * SWING * np.cos(0.4)])
    x = np.concatenate([0.0 * SWING, rest, 0.6 * SWING * np.sin(0.4)])
    path = tmp_path / "pushed.csv"
    rows = np.column_stack([0.05 * np.arange(len(x)), x, y])
    rows[:, 1:] += 0.02 * np.random.default_rng(3).standard_normal((len(x), 2))
    np.savetxt(path, rows, delimiter=",", header="t,x,y", comments="", fmt="%.6f")
    found = analyse_table(path, None, TableColumns(positions=("x", "y"), unit="mm"))
    assert len(found.runs) == 2
    assert found.runs[1].number("log_decrement").value == pytest.approx(DECREMENT, rel=1e-3)
    assert found.runs[1].amplitudes[0] == pytest.approx(0.6 * 98.76, rel=2e-3)
    assert any("direction" in one for one in found.runs[1].notes)


def test_nor_is_a_second_mode_across_taken_for_a_turn(tmp_path: Path) -> None:
    fast = 30.0 * np.exp(-T_S / 150.0) * np.cos(2.0 * np.pi / 0.51 * T_S)
    found = fitted(tmp_path, fast + noise(1), SWING + noise(2))
    judge(found)
    assert not any("direction" in one for one in found.runs[0].warnings)
