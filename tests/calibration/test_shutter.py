"""Rolling shutter: the row time is found from the second harmonic, and the times of spots are put right."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import true_path
from calibration.shutter import Shutter, fit_row_time
from processing.errors import DataError
from processing.units import seconds

RATE_HZ, PERIOD_S, ROWS = 50.0, 2.0, 400


def seen_rows(
    row_time_s: float, frames: int = 3000, tangent: float = 0.0, decay_s: float = 200.0
) -> tuple[np.ndarray, np.ndarray]:
    """Frame times, and the row on which a swing of 150 px is seen, with friction and a bent light lever."""
    times_s = np.arange(frames) / RATE_HZ

    def row_at(at_s: np.ndarray) -> np.ndarray:
        swing = np.exp(-at_s / decay_s) * np.cos(2 * np.pi * at_s / PERIOD_S + 0.7)
        return 190.0 + 150.0 * swing + tangent * swing**2

    y_px = row_at(times_s)
    for _ in range(60):
        y_px = row_at(times_s + row_time_s * y_px)
    return times_s, y_px


@pytest.mark.parametrize("row_time_us", [15.0, 30.0, -10.0, 0.0])
@pytest.mark.parametrize("tangent", [0.0, 3.0])
def test_the_row_time_is_found_whatever_the_geometry_adds(row_time_us: float, tangent: float) -> None:
    times_s, y_px = seen_rows(1e-6 * row_time_us, tangent=tangent)
    noisy = y_px + np.random.default_rng(1).normal(0.0, 0.02, len(y_px))
    found = fit_row_time(times_s, noisy)
    assert found.u_row_time_s < 0.1e-6
    assert abs(found.row_time_s - 1e-6 * row_time_us) < 4 * found.u_row_time_s
    assert 0.2 < found.chi2_per_dof < 2.5


@pytest.mark.parametrize("decay_s", [30.0, 60.0])
def test_a_strong_drag_bends_no_row_time(decay_s: float) -> None:
    """The curvature of the decay changes within a stretch: the row time was 3 to 30 ns off, 8 u."""
    times_s, y_px = seen_rows(15e-6, decay_s=decay_s)
    found = fit_row_time(times_s, y_px + np.random.default_rng(1).normal(0.0, 1e-4, len(y_px)))
    assert found.u_row_time_s < 2e-9
    assert abs(found.row_time_s - 15e-6) < 3 * found.u_row_time_s


@pytest.mark.parametrize(("row_time_us", "skew"), [(0.0, 0.0), (15.0, 0.0), (0.0, 3.0)])
def test_the_contact_s_overtones_are_not_taken_for_a_row_time(row_time_us: float, skew: float) -> None:
    """The simulated pendulum, whose friction and elasticity make odd harmonics that fade with the swing.

    On a sensor that is not perpendicular to the beam the third one and the swing together make a second one.
    """
    motion = true_path(SimulationSettings(), 120.0, 2 * RATE_HZ)
    times_s = seconds(motion.times_ns)
    tangent = np.tan(2.0 * motion.y_rad)
    true_px = 320.0 - tangent * (1.0 + skew * tangent) / 4.8e-6
    y_px = true_px
    for _ in range(20):
        y_px = CubicSpline(times_s, true_px)(times_s + 1e-6 * row_time_us * y_px)
    z = []
    for seed in range(8):
        noisy = y_px + np.random.default_rng(seed).normal(0.0, 0.003, len(y_px))
        found = fit_row_time(times_s[:-2:2], noisy[:-2:2])
        assert found.u_row_time_s < 3e-9
        z.append((found.row_time_s - 1e-6 * row_time_us) / found.u_row_time_s)
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))
    assert np.sqrt(np.mean(np.square(z))) < 1 + 4 / np.sqrt(2 * len(z))


@pytest.mark.parametrize("first_row", ["top", "bottom"])
def test_corrected_times_are_those_at_which_the_spot_was_there(first_row: str) -> None:
    """15 us a row: half-periods differ by 9 ms; corrected, the swing is a pure one again."""
    row_time_s = 15e-6
    shutter = Shutter(row_time_s, first_row=first_row)  # type: ignore[arg-type]
    times_s, y_px = seen_rows(row_time_s if first_row == "top" else -row_time_s)
    frame_ns = np.rint(1e9 * times_s).astype(np.int64)
    assert abs(fit_row_time(1e-9 * frame_ns, y_px).row_time_s) > 14e-6
    spot_ns = shutter.times_ns(frame_ns, y_px, ROWS)
    assert abs(fit_row_time(1e-9 * spot_ns, y_px).row_time_s) < 0.03e-6
    assert np.all(np.diff(spot_ns) > 0)


def test_a_frame_without_a_spot_keeps_its_place() -> None:
    shutter = Shutter(20e-6)
    frame_ns = np.arange(3, dtype=np.int64) * 10_000_000
    assert shutter.times_ns(frame_ns, np.array([0.0, np.nan, 399.0]), ROWS).tolist() == [
        0,
        10_000_000 + 3_990_000,
        20_000_000 + 7_980_000,
    ]
    assert Shutter().times_ns(frame_ns, np.full(3, np.nan), ROWS) is frame_ns


@pytest.mark.parametrize(
    ("frames", "part", "reason"),
    [
        (3000, 0.05, "over 1[0-9].* rows, at least 20"),
        (900, 1.0, "stretches of 3 periods"),
        (40, 1.0, "to and fro"),
    ],
)
def test_a_run_that_cannot_say_is_refused(frames: int, part: float, reason: str) -> None:
    times_s, y_px = seen_rows(15e-6, frames)
    with pytest.raises(DataError, match=reason):
        fit_row_time(times_s, part * y_px)
