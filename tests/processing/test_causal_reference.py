"""The beam's motion as a reference spot shows it so far."""

import numpy as np
import pytest

from processing.arrays import Floats
from processing.estimate import Estimate
from processing.reference_spot import CausalReference

U_PX = 0.01


def walked(count: int, step_px: float, seed: int = 1) -> Floats:
    return np.cumsum(step_px * np.random.default_rng(seed).standard_normal((count, 2)), axis=0)


def noise(count: int, seed: int = 2) -> Floats:
    return np.asarray(U_PX * np.random.default_rng(seed).standard_normal((count, 2)))


def taken(place: Floats, gain: Estimate, block: int = 64) -> tuple[Floats, Floats]:
    reference, u = CausalReference(gain), np.where(np.isfinite(place), U_PX, np.nan)
    parts = [reference.take(place[k : k + block], u[k : k + block]) for k in range(0, len(place), block)]
    moved, variance = (np.concatenate(one) for one in zip(*parts, strict=True))
    return moved, variance


@pytest.mark.parametrize("step_px", [0.002, 0.02])
def test_a_beam_that_walks_is_followed_within_what_is_said(step_px: float) -> None:
    beam = walked(6000, step_px)
    moved, variance = taken(beam + noise(6000), Estimate(2.0, 0.0))
    off = moved - 2.0 * (beam - beam[:16].mean(axis=0))
    late = slice(500, None)
    spread = off[late] - off[late].mean(axis=0)
    said = np.sqrt(variance[late])
    assert 0.8 < np.sqrt(np.mean((spread / said) ** 2)) < 1.25
    # the pendulum's spot would have moved by much more, and the plain difference be noisier
    assert np.std(spread) < 0.1 * np.std(2.0 * beam[late])
    assert np.std(spread) < 2.0 * U_PX


def test_a_reference_that_only_makes_noise_moves_little() -> None:
    moved, variance = taken(noise(6000), Estimate(1.0, 0.0))
    # its first frames' mean is what it is counted from
    assert np.max(np.std(moved[1000:], axis=0)) < 0.1 * U_PX
    assert np.all(variance[1000:] < (0.1 * U_PX) ** 2)


def test_while_it_is_lost_its_last_place_holds_and_grows_uncertain() -> None:
    beam = walked(4000, 0.02)
    place = beam + noise(4000)
    place[2000:2500] = np.nan
    moved, variance = taken(place, Estimate(1.0, 0.0))
    assert np.all(moved[2000:2500] == moved[1999])
    assert np.all(np.diff(variance[1999:2500], axis=0) > 0)
    off = np.abs(moved[2499] - (beam[2499] - beam[:16].mean(axis=0)))
    assert np.all(off < 4 * np.sqrt(variance[2499]))
    assert np.sqrt(variance[2499]) == pytest.approx(0.02 * np.sqrt(500), rel=0.3)
    # and found again it is followed from where it is
    assert np.all(variance[2510] < 4 * variance[1999])


def test_what_the_gain_is_uncertain_by_is_in_it_and_blocks_do_not_matter() -> None:
    place = walked(1000, 0.02) + noise(1000)
    moved, variance = taken(place, Estimate(1.5, 0.1))
    again = taken(place, Estimate(1.5, 0.1), block=7)
    assert np.array_equal(moved, again[0])
    assert np.array_equal(variance, again[1])
    sure = taken(place, Estimate(1.5, 0.0))[1]
    assert variance - sure == pytest.approx((0.1 / 1.5 * moved) ** 2, rel=1e-6, abs=1e-18)
    nothing = taken(np.full((50, 2), np.nan), Estimate(1.5, 0.1))
    assert not np.any(nothing)


def test_a_place_at_rest_that_was_seen_n_times_is_known_by_the_root_of_n_better() -> None:
    """No frame counts twice, the first no more than others."""
    place = noise(30)
    moved, variance = taken(place, Estimate(1.0, 0.0))
    assert variance == pytest.approx(np.repeat(U_PX**2 / np.arange(1.0, 31.0), 2).reshape(30, 2))
    assert moved[-1] == pytest.approx(place.mean(axis=0) - place[:16].mean(axis=0))
