"""A reference spot on the same frames: what moves both spots is taken off, from pixels on."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from processing.arrays import Flags, Floats, Ints
from processing.errors import DataError
from processing.estimate import Estimate
from processing.reference_spot import (
    CorrectedPositions,
    ReferenceVerdict,
    common_motion,
    fitted_gain,
    subtract_common_motion,
)
from processing.spot import SpotTracker
from tests.processing.spot.frames import EIGHT_BIT, exposed, light

RATE_HZ, FRAMES, RELEASED = 20.0, 1600, 800
ROWS, COLUMNS, SIGMA_PX, PEAK_DN = 72, 40, 3.5, 170.0
GAIN = 1.6
"""The reference's arm is shorter: the pendulum's spot moves so many times as far."""
UNKNOWN = Estimate(GAIN, 0.0)


class Tracked(NamedTuple):
    times_ns: Ints
    spot: Floats
    u: Floats
    reference: Floats
    u_reference: Floats
    truth: Floats
    quiet: Flags


@cache
def tracked(seed: int, related: bool = True, walk_px: float = 0.05) -> Tracked:
    """Both spots of frames of which each has a region, by the same tracker; y of both, in px.

    Both are moved by `walk_px` times the root of the time in s; if they are not related, each by its own.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(FRAMES) / RATE_HZ
    walk = np.cumsum(walk_px / np.sqrt(RATE_HZ) * rng.standard_normal(FRAMES))
    other = walk if related else np.cumsum(walk_px / np.sqrt(RATE_HZ) * rng.standard_normal(FRAMES))
    since_s = np.maximum(time_s - RELEASED / RATE_HZ, 0.0)
    swing = 8.0 * np.exp(-since_s / 100.0) * np.sin(2 * np.pi * since_s / 4.1)
    trackers = [SpotTracker(EIGHT_BIT) for _ in range(2)]
    found = np.empty((FRAMES, 4))
    for k in range(FRAMES):
        frame = light((2 * ROWS, COLUMNS), 20.0, 35.0 + swing[k] + GAIN * walk[k], SIGMA_PX, PEAK_DN)
        frame += light((2 * ROWS, COLUMNS), 19.0, ROWS + 36.0 + other[k], SIGMA_PX, PEAK_DN)
        image = exposed(frame, rng)
        for which, tracker in enumerate(trackers):
            spot = tracker.track(image[which * ROWS : (which + 1) * ROWS])
            found[k, 2 * which : 2 * which + 2] = spot.y_px, spot.u_y_px
    times_ns = np.rint(1e9 * time_s).astype(np.int64)
    return Tracked(times_ns, *found.T, 35.0 + swing, time_s < RELEASED / RATE_HZ)


def corrected(run: Tracked, gain: Estimate | None = None) -> CorrectedPositions:
    common = common_motion(run.times_ns, run.reference, run.u_reference)
    gain = gain or fitted_gain(run.spot, run.u, common, run.quiet)
    return subtract_common_motion(run.spot, run.u, common, gain, run.quiet)


def errors(position: Floats, run: Tracked) -> Floats:
    """About their mean: the place of a spot at rest is arbitrary."""
    off = position - run.truth
    return np.asarray(off - off.mean())


@pytest.mark.slow
def test_pointing_is_taken_off_and_what_is_left_is_within_its_uncertainty() -> None:
    run = tracked(1)
    found = corrected(run)
    assert found.verdict is ReferenceVerdict.USED
    assert found.gain.value == pytest.approx(GAIN, abs=4 * found.gain.standard_uncertainty)
    assert found.gain.standard_uncertainty < 0.05 * GAIN
    before, after = (float(np.std(errors(one, run))) for one in (run.spot, found.position_px))
    assert after < 0.15 * before
    # little more than the spot's own noise, in which there is no pointing
    assert float(np.median(run.u)) < after < 2.2 * float(np.median(run.u))
    stated = corrected(run, UNKNOWN)
    pulls = errors(stated.position_px, run) / stated.u_px
    assert float(np.std(pulls)) == pytest.approx(1.0, abs=0.12)
    assert not found.fallen_back.any()


def test_a_filter_takes_less_of_the_reference_than_all_and_more_of_its_motion_than_none() -> None:
    run = tracked(1, walk_px=0.01)
    common = common_motion(run.times_ns, run.reference, run.u_reference)
    whole = run.spot - GAIN * run.reference
    filtered = float(np.std(errors(corrected(run, UNKNOWN).position_px, run)))
    assert filtered < 0.8 * np.std(errors(whole, run))
    assert filtered < 0.6 * np.std(errors(run.spot, run))
    assert 0.5 < common.share < 1.0
    assert np.all(common.u[common.known] < 0.75 * np.median(run.u_reference))


@pytest.mark.slow
def test_an_unrelated_reference_is_refused() -> None:
    run = tracked(3, related=False)
    for gain in (None, UNKNOWN):
        found = corrected(run, gain)
        assert found.verdict is ReferenceVerdict.NO_GAIN
        assert found.position_px is run.spot
        assert found.u_px is run.u


def test_a_reference_that_only_makes_noise_moves_nothing() -> None:
    run = tracked(1)
    rng = np.random.default_rng(5)
    noise = run.u_reference * rng.standard_normal(FRAMES)
    found = corrected(run._replace(reference=noise), UNKNOWN)
    assert np.max(np.abs(found.position_px - run.spot) / run.u) < 0.5
    assert found.verdict in (ReferenceVerdict.QUIET, ReferenceVerdict.NO_GAIN)


def test_frames_without_a_reference_fall_back_and_say_so() -> None:
    run = tracked(1)
    lost = run.reference.copy()
    gap, blink = slice(1000, 1080), slice(1200, 1204)
    lost[gap] = lost[blink] = np.nan
    found = corrected(run._replace(reference=lost))
    assert np.flatnonzero(found.fallen_back).tolist() == list(range(1000, 1080))
    assert np.array_equal(found.position_px[gap], run.spot[gap])
    # they have the pointing in them, and their uncertainty says it
    assert np.all(found.u_px[gap] > 5 * run.u[gap])
    assert np.all(found.u_px[blink] < 2.5 * run.u[blink])


def test_too_few_frames_are_said() -> None:
    run = tracked(1)
    with pytest.raises(DataError, match="the reference spot is found in 150 frames; 200 are needed"):
        common_motion(run.times_ns[:150], run.reference[:150], run.u_reference[:150])
    common = common_motion(run.times_ns, run.reference, run.u_reference)
    with pytest.raises(DataError, match="100 frames at rest have both spots"):
        fitted_gain(run.spot, run.u, common, np.arange(FRAMES) < 100)
