"""Ticks and seconds: numbers and arrays alike, rounded to the nearest tick."""

import numpy as np

from processing.units import nanoseconds, seconds


def test_numbers_and_arrays_agree_in_every_bit() -> None:
    ticks_ns = np.random.default_rng(1).integers(-(10**17), 10**17, 1000)
    times_s = seconds(ticks_ns)
    assert [seconds(int(tick)) for tick in ticks_ns] == times_s.tolist()
    assert [nanoseconds(float(time)) for time in times_s] == nanoseconds(times_s).tolist()


def test_a_time_becomes_the_nearest_tick() -> None:
    assert [nanoseconds(time_s) for time_s in (0.1 + 0.2, -1.4e-9, 1.6e-9)] == [300_000_000, -1, 2]
    assert nanoseconds(np.array([0.29, 1.6e-9])).tolist() == [290_000_000, 2]
    assert isinstance(nanoseconds(np.float64(0.29)), int)
    assert seconds(1_500_000_000) == 1.5
