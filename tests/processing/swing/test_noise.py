"""The noise is estimated from the samples alone."""

import math

import numpy as np
import pytest

from processing.errors import DataError
from processing.swing import estimate_noise, estimate_scatter
from tests.processing.swing.truth import damped_sinusoid


@pytest.mark.parametrize("frames_per_s", [20.0, 100.0, 500.0])
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_noise_of_a_decay(frames_per_s: float, missing: float) -> None:
    rng = np.random.default_rng(31)
    record = damped_sinusoid(rng, 300.0, 30.0, 60, frames_per_s, noise=0.02)
    kept = record.keep(rng.random(len(record.times_ns)) >= missing)
    n = len(kept.times_ns)
    # a median of n normal deviates scatters by 1.17/sqrt(n) of its sigma; overlapping differences: twice that
    assert estimate_noise(kept.times_ns, kept.deflection) == pytest.approx(
        0.02, rel=0.02 + 8 * 1.17 / math.sqrt(n)
    )


@pytest.mark.parametrize(("frames_per_s", "jitter_s"), [(5.0, 0.0), (25.0, 0.0), (25.0, 1e-3)])
def test_jitter_of_the_times(frames_per_s: float, jitter_s: float) -> None:
    """Seen where fast samples scatter more than slow ones; few samples a period are none of it."""
    rng = np.random.default_rng(3)
    time_s = np.arange(0.0, 300.0, 1.0 / frames_per_s)
    position = 124 * np.exp(-time_s / 250) * np.cos(1.54 * time_s) + 0.005 * rng.standard_normal(len(time_s))
    position[100:110] = math.nan
    times_ns = np.rint(1e9 * (time_s + jitter_s * rng.standard_normal(len(time_s)))).astype(np.int64)
    found = estimate_scatter(times_ns, position)
    assert found.jitter_s == pytest.approx(jitter_s, rel=0.1)
    if frames_per_s > 20:
        speed = np.gradient(124 * np.exp(-time_s / 250) * np.cos(1.54 * time_s), time_s)
        true2 = 0.005**2 + (jitter_s * speed) ** 2
        # without jitter the smallest step, at a turning point, passed for rounding: 0.018
        assert np.mean(found.u_deflection**2) == pytest.approx(np.mean(true2), rel=0.2)
        # sample by sample, so that the speeds are those of their own times
        if jitter_s:
            assert np.corrcoef(found.u_deflection, np.sqrt(true2))[0, 1] > 0.999
        assert len(found.u_deflection) == len(times_ns)


def test_bursts_and_lost_spots_do_no_harm() -> None:
    rng = np.random.default_rng(32)
    record = damped_sinusoid(rng, 300.0, 30.0, 60)
    burst = np.where((record.time_s > 30) & (record.time_s < 50), 5.0 * np.sin(60.0 * record.time_s), 0.0)
    burst[rng.random(len(burst)) < 0.1] = np.nan
    assert estimate_noise(record.times_ns, record.deflection + burst) == pytest.approx(0.02, rel=0.3)


def test_whole_pixels() -> None:
    times_ns = np.arange(2000, dtype=np.int64) * 100_000_000
    stairs = np.round(3.0 * np.sin(times_ns * 1e-10))
    assert estimate_noise(times_ns, stairs) == pytest.approx(1.0 / math.sqrt(12.0))


@pytest.mark.parametrize(
    ("times", "values", "words"),
    [
        ([0, 1, 2], [1.0, 2.0, 3.0], "too few"),
        ([0, 1], [1.0], "of one length"),
        ([], [], "too few"),
        (list(range(6)), [1.0, 2.0, 4.0, 8.0, 16.0, 31.0], "at least 7"),
        (list(range(20)), [2.0] * 20, "nothing moves"),
        ([5] * 20, list(range(20)), "too few"),
    ],
)
def test_bad_input(times: list[int], values: list[float], words: str) -> None:
    with pytest.raises(DataError, match=words):
        estimate_noise(np.array(times, dtype=np.int64), np.array(values, dtype=float))
