"""What a reference spot would take off, from made-up places of both spots of a pendulum at rest."""

import numpy as np
import pytest

from processing.errors import DataError
from processing.reference_gain import ReferenceAtRest, reference_at_rest

RATE_HZ, PERIOD_S, NOISE_PX = 25.0, 4.1, 0.01


def compared(seed: int, *, common: bool = True, walk_px: float = 0.02, gain: float = 1.6) -> ReferenceAtRest:
    """A beam that walks, and the swing of the pendulum that is larger; the true gain is 1.6."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(60 * RATE_HZ)) / RATE_HZ

    def walk() -> np.ndarray:
        return np.cumsum(walk_px / np.sqrt(RATE_HZ) * rng.standard_normal(len(time_s)))

    def noise() -> np.ndarray:
        return NOISE_PX * rng.standard_normal(len(time_s))

    beam = walk()
    swing = (0.4 + 0.003 * time_s) * np.cos(2 * np.pi * time_s / PERIOD_S + 1.0)
    spot = 300.0 + swing + 1.6 * beam + noise()
    reference = 600.0 + (beam if common else walk()) + noise()
    u = np.full(len(time_s), NOISE_PX)
    times_ns = np.rint(1e9 * time_s).astype(np.int64)
    return reference_at_rest(times_ns, spot, u, reference, u, gain=gain, period_s=PERIOD_S)


def test_a_related_reference_takes_the_beam_off_and_shows_its_gain() -> None:
    found = [compared(seed) for seed in range(12)]
    helped = [one.factor.value - 3 * one.factor.standard_uncertainty > 1 for one in found]
    assert np.mean(helped) >= 0.75
    assert np.median([one.factor.value for one in found]) > 1.5
    pulls = [(one.gain.value - 1.6) / one.gain.standard_uncertainty for one in found]
    assert np.sqrt(np.mean(np.square(pulls))) < 2.0
    # the swing is not the beam's, and is left out
    assert all(one.before_px < 0.3 for one in found)
    assert all(one.share > 0.9 for one in found)


def test_an_unrelated_one_does_not_help() -> None:
    found = [compared(seed, common=False) for seed in range(12)]
    helped = [one.factor.value - 3 * one.factor.standard_uncertainty > 1 for one in found]
    assert np.mean(helped) <= 0.1


def test_a_wrong_gain_is_seen() -> None:
    found = compared(3, gain=1.0)
    assert found.gain.value - 1.0 > 4 * found.gain.standard_uncertainty


def test_one_that_stands_still_has_nothing_to_tell() -> None:
    found = compared(4, walk_px=0.0)
    assert found.share < 0.3
    assert found.factor.value == pytest.approx(1.0, abs=0.05)


def test_too_few_frames_are_said() -> None:
    few = np.arange(50) * 40_000_000
    with pytest.raises(DataError, match="found in 50 frames; 200 are needed"):
        reference_at_rest(few, *[np.ones(50)] * 4, gain=1.0, period_s=4.0)
