"""Real decays of other origin: free decay of a seismometer, laser spot of a torsion balance."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from processing.swing import estimate_noise, half_cycles_of, turning_points


@pytest.mark.parametrize(
    ("name", "period_s", "at_least"), [("seismometer-11mm.txt", 15.5, 8), ("seismometer-63.txt", 12.3, 3)]
)
def test_seismometer(shared_data: Path, name: str, period_s: float, at_least: int) -> None:
    table = np.genfromtxt(shared_data / "ringdown" / name, skip_header=2)
    times_ns = np.round(table[:, 0] * 1e9).astype(np.int64)
    noise = estimate_noise(times_ns, table[:, 1])
    assert 0.001 < noise < 0.01
    half_cycles = half_cycles_of(times_ns, table[:, 1], np.full(len(table), noise))
    good = turning_points(half_cycles)
    assert len(good) >= at_least
    assert np.all(np.diff(good.amplitude) < 3.0 * np.hypot(*good.u_amplitude[[0, 1]]))
    half_periods = np.diff(good.time_s) / np.diff(good.index)
    # the period falls along with the amplitude by several per cent; read off the record by eye
    assert 2.0 * np.median(half_periods) == pytest.approx(period_s, rel=0.12)
    assert np.all(good.u_time_s < 0.1 * period_s)
    # a turning point read from the samples directly: the largest of the median of five about it
    for k in range(len(good)):
        half_cycle = next(s for s in half_cycles if s.index == good.index[k])
        near = np.abs(times_ns - half_cycle.turn_time_ns) < 0.5e9
        assert half_cycle.centre + half_cycle.side * half_cycle.amplitude == pytest.approx(
            float(np.median(table[near, 1])), abs=4.0 * max(noise, half_cycle.u_amplitude)
        )


@pytest.mark.parametrize("column", [2, 3])
def test_torsion_balance_gives_no_wrong_swing(shared_data: Path, column: int) -> None:
    """Bounces off stops, whole pixels, uneven steps: no free decay, so nothing unflagged may come out."""
    with gzip.open(shared_data / "ringdown" / "torsion-balance-laser-spot.csv.gz") as lines:
        table = np.genfromtxt(lines, delimiter=",", skip_header=1, usecols=(1, column))
    times_ns = np.round(table[:, 0] * 1e9).astype(np.int64)
    half_cycles = half_cycles_of(
        times_ns, table[:, 1], np.full(len(table), estimate_noise(times_ns, table[:, 1]))
    )
    assert len([s for s in half_cycles if not s.flags]) <= 2
