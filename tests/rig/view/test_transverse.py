"""X(t) is shown in two parts: the fast mode, and what the slow mode leaks across the swing."""

import numpy as np
import pytest

from processing.units import ARCSEC_RAD
from rig.view.transverse import TransverseCurves

PERIOD_S, TURNING = 4.07, 5e-4
T_S = np.arange(0.0, 60.0, 0.01)


def leakage(time_s: np.ndarray) -> np.ndarray:
    return np.asarray(124.0 * np.cos(2.0 * np.pi * time_s / PERIOD_S) * np.sin(0.03 + TURNING * time_s))


def fast_mode(time_s: np.ndarray) -> np.ndarray:
    return np.asarray(1.2 * np.exp(-time_s / 200.0) * np.cos(2.0 * np.pi * 5.1 * time_s / PERIOD_S))


def seen(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    angle = 0.03 + TURNING * time_s
    slow, fast = 124.0 * np.cos(2.0 * np.pi * time_s / PERIOD_S), fast_mode(time_s)
    x = slow * np.sin(angle) + fast * np.cos(angle) - 30.0
    return x, slow * np.cos(angle) - fast * np.sin(angle) + 15.0


def balance(time_s: float) -> dict[str, tuple[float, float]]:
    rotation = TURNING if time_s > 16.0 else np.nan
    return {
        "line_angle_rad": (0.03 + TURNING * time_s, 1e-6),
        "rotation_rad_per_s": (rotation, 1e-6),
        "rest_x": (-30.0 * ARCSEC_RAD, 1e-9),
        "rest_y": (15.0 * ARCSEC_RAD, 1e-9),
    }


@pytest.mark.parametrize("live", [True, False], ids=["as they come", "balances first"])
def test_both_parts_are_told_apart(live: bool) -> None:
    across = TransverseCurves()
    ready_s = [PERIOD_S * (2 + k) for k in range(12)]
    if not live:
        for time_s in ready_s:
            across.balance(time_s - PERIOD_S, balance(time_s - PERIOD_S), ARCSEC_RAD)
    times, fast, leaked = [], [], []
    for block_s in np.split(T_S, 100):
        while live and ready_s and ready_s[0] < block_s[0]:
            # of the two periods before it
            middle_s = ready_s.pop(0) - PERIOD_S
            across.balance(middle_s, balance(middle_s), ARCSEC_RAD)
        parts = across.samples(block_s, *seen(block_s))
        if parts is None:
            assert live
            assert block_s[0] < 2.2 * PERIOD_S
            continue
        for column, values in zip((times, fast, leaked), parts, strict=True):
            column.append(values)
    np.testing.assert_array_equal(np.concatenate(times), T_S)
    off = np.abs(np.concatenate(fast) - fast_mode(T_S))
    # before the rotation is known the line is a period late
    assert np.max(off[T_S > 22.0]) < 0.05
    assert np.max(off) < 1.0
    np.testing.assert_allclose(np.concatenate(leaked)[T_S > 22.0], leakage(T_S)[T_S > 22.0], atol=0.05)


def test_without_a_balance_nothing_is_separated_and_little_is_kept() -> None:
    across = TransverseCurves()
    for block_s in np.split(np.arange(0.0, 600.0, 0.1), 100):
        assert across.samples(block_s, np.zeros(len(block_s)), np.zeros(len(block_s))) is None
    across.balance(700.0, balance(0.0), ARCSEC_RAD)
    found = across.samples(np.array([701.0]), np.array([-30.0]), np.array([15.0]))
    assert found is not None
    time_s, fast, _ = found
    assert len(time_s) < 300
    assert np.isnan(fast[0])
    assert fast[-1] == pytest.approx(0.0)


def test_a_balance_of_an_older_record_without_a_rest_position_is_none() -> None:
    across = TransverseCurves()
    across.balance(5.0, {"line_angle_rad": (0.1, 1e-6)}, ARCSEC_RAD)
    assert across.samples(np.array([6.0]), np.array([0.0]), np.array([1.0])) is None
