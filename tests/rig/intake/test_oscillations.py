"""A table without usable half-cycles is refused for the right reason: a second oscillation as large."""

from pathlib import Path

import numpy as np
import pytest

from processing.errors import DataError
from rig.intake.table import TableColumns
from tests.rig.intake.table_cases import analyse_table

T_S = np.arange(0.0, 100.0, 0.05)
T_NS = np.round(T_S * 1e9).astype(np.int64)
HALF_CYCLE = np.exp(-0.005 * T_S) * np.cos(2 * np.pi / 4.05 * T_S)
FAST = np.exp(-0.002 * T_S) * np.cos(2 * np.pi * 1.7 * T_S + 1)
NOISE = 1e-3 * np.random.default_rng(1).standard_normal((2, len(T_S)))


def test_a_fast_mode_as_large_as_the_swing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "fast.csv"
    table = np.column_stack([T_S, *(np.array([HALF_CYCLE + FAST, 0.3 * HALF_CYCLE + 0.9 * FAST]) + NOISE)])
    np.savetxt(path, table, delimiter=",", fmt="%.6f")
    with pytest.raises(DataError, match="a second oscillation as large, which has to be filtered"):
        analyse_table(path, None, TableColumns("1", ("2", "3"), "arcsec"))


def _warnings(path: Path, x: np.ndarray, y: np.ndarray, positions: tuple[str, ...] = ("x", "y")) -> list[str]:
    np.savetxt(path, np.column_stack([T_S, x, y]), delimiter=",", fmt="%.6f", header="t_s,x,y", comments="")
    found = analyse_table(path, None, TableColumns("t_s", positions, "arcsec"))
    return [line for line in found.longest.warnings if "second oscillation" in line]


@pytest.mark.parametrize("size", [0.02, 0.1])
def test_a_weak_fast_mode_is_named_as_the_reason_of_wide_uncertainties_or_taken_off(
    tmp_path: Path, size: float
) -> None:
    """It widened u(b) forty times, and the report said nothing of it; two positions tell it apart."""
    x, y = 3 * HALF_CYCLE + NOISE[0], HALF_CYCLE + size * FAST + NOISE[1]
    assert not _warnings(tmp_path / "a.csv", x, y)
    (said,) = _warnings(tmp_path / "a.csv", x, y, ("y",))
    assert "a second oscillation at 1.7 Hz" in said
    assert "widens every uncertainty" in said
    assert "--position" in said


def test_noise_a_drift_overtones_and_gaps_are_no_fast_mode(tmp_path: Path) -> None:
    bent = HALF_CYCLE + 0.02 * HALF_CYCLE**2 + 0.01 * HALF_CYCLE**3
    drift = 0.5 * (T_S / 100.0) ** 2 + 0.1 * np.sin(2 * np.pi * T_S / 30.0)
    for k, x in enumerate((HALF_CYCLE, bent, HALF_CYCLE + drift)):
        assert not _warnings(tmp_path / f"{k}.csv", x + NOISE[0], 0.3 * x + NOISE[1])
    with_gap = (bent + NOISE[0]).copy()
    with_gap[400:460] = np.nan
    assert not _warnings(tmp_path / "gap.csv", with_gap, 0.3 * bent + NOISE[1])
    assert not _warnings(tmp_path / "digits.csv", np.round(HALF_CYCLE, 3), np.round(0.3 * HALF_CYCLE, 3))


def test_a_few_slow_swings_from_a_hold_are_one_oscillation(tmp_path: Path) -> None:
    """Herbert's pendulum, held for 2 s: the sides of its nine periods were a second line."""
    t_s = np.arange(0.0, 62.0, 0.01)
    swing = 90.0 * np.exp(-0.014 * (t_s - 2.0)) * np.cos(2 * np.pi * (t_s - 2.0) / 6.1)
    held = np.where(t_s < 2.0, 90.0, swing) + 0.02 * np.random.default_rng(3).standard_normal(len(t_s))
    table = tmp_path / "held.csv"
    np.savetxt(table, np.column_stack([t_s, held]), delimiter=",", fmt="%.6f", header="t_s,y", comments="")
    found = analyse_table(table, None, TableColumns("t_s", ("y",), "mrad"))
    assert not [line for line in found.longest.warnings if "second oscillation" in line]
