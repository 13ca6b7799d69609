"""Beams that no Gaussian fits: one model a run, the learned profile, real beams moved by known amounts."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.spot import Spot, SpotFlag, SpotModel, SpotTracker
from processing.spot.model_choice import ModelChoice
from processing.spot.sensor_model import PixelNoise
from tests.processing.spot.frames import (
    EIGHT_BIT,
    LIT_EIGHT_BIT,
    errors_px,
    exposed,
    light,
    scatter_over_claimed,
)
from tests.processing.spot.moved_beams import MovedImage, RealBeam

SHAPE = (110, 120)


def lopsided(x: float, y: float) -> NDArray[np.float64]:
    """A core on a wider disc that lies beside it, and a ghost of 4 % at 12 px."""
    core = light(SHAPE, x, y, 5, 140) + light(SHAPE, x + 3, y - 2, 9, 40, 7)
    return core + light(SHAPE, x + 9, y + 8, 5, 6)


def place(k: int) -> tuple[float, float]:
    return 60 + 25 * math.sin(0.06 * k), 54 + 2 * math.cos(0.05 * k)


def test_the_fourier_shift_is_exact() -> None:
    moved = MovedImage(light((100, 120), 60, 50, 6, 180, 4), 0.0)
    for x, y in ((0.5, -0.25), (17.31, 9.87), (-20.04, 0.0)):
        exact = light((100, 120), 60 + x, 50 + y, 6, 180, 4)
        assert np.abs(moved.at(x, y) - exact).max() < 1e-3


def test_a_lopsided_beam_is_followed_by_its_own_profile() -> None:
    """The position keeps its meaning at the change of the model, and scatters as it claims."""
    rng = np.random.default_rng(3)
    tracker, again = SpotTracker(LIT_EIGHT_BIT), SpotTracker(LIT_EIGHT_BIT)
    spots: list[Spot] = []
    for k in range(320):
        image = exposed(lopsided(*place(k)), rng, sensor=LIT_EIGHT_BIT)
        spots.append(tracker.track(image))
        # the pixels that a record keeps give the same spots
        x0, y0, x1, y1 = tracker.record_window(spots[-1], SHAPE)
        # and so do more than those
        x0, y0 = max(x0 - 5 * (k % 2), 0), max(y0 - 3 * (k % 2), 0)
        x1, y1 = x1 + 4 * (k % 2), y1 + 2 * (k % 2)
        second = again.track(image[y0:y1, x0:x1].copy(), (x0, y0), SHAPE)
        assert abs(second.x_px - spots[-1].x_px) < 1e-3 * second.u_x_px
        assert abs(second.y_px - spots[-1].y_px) < 1e-3 * second.u_y_px
        assert second.flags == spots[-1].flags
    assert tracker.model is SpotModel.LEARNED
    learned = np.array([bool(spot.flags & SpotFlag.LEARNED) for spot in spots])
    change = int(np.argmax(learned))
    assert learned[change:].all()
    assert all(spot.flags & SpotFlag.POOR_FIT for spot in spots[:change])
    assert not any(spot.flags & (SpotFlag.POOR_FIT | SpotFlag.MULTIPLE) for spot in spots[change:])
    truth = np.array([place(k) for k in range(320)])
    errors = errors_px(spots, truth)
    assert scatter_over_claimed(spots[change:], truth[change:]) == pytest.approx([1, 1], abs=0.15)
    # and so it does before: what a Gaussian misses moves with the beam and scatters nothing
    assert np.mean([spot.chi2_per_dof for spot in spots[:change]]) > 2.0
    assert scatter_over_claimed(spots[:change], truth[:change]) == pytest.approx([1, 1], abs=0.2)
    u_jump = errors[:change].std(axis=0) / math.sqrt(change / 4)
    assert np.all(np.abs(errors[change:].mean(axis=0) - errors[:change].mean(axis=0)) < 5 * u_jump)


def test_a_gaussian_beam_stays_gaussian_and_a_changed_one_is_noticed() -> None:
    rng = np.random.default_rng(4)
    tracker = SpotTracker(EIGHT_BIT)
    assert tracker.model is None
    for k in range(140):
        tracker.track(exposed(light(SHAPE, *place(k), 5, 180), rng))
    assert tracker.model is SpotModel.ONE
    models = set()
    for k in range(480):
        tracker.track(exposed(lopsided(*place(k)), rng))
        models.add(tracker.model)
    assert models == {SpotModel.ONE, None, SpotModel.LEARNED}


def test_a_beam_on_a_gradient_is_where_it_is() -> None:
    rng = np.random.default_rng(6)
    tracker = SpotTracker(LIT_EIGHT_BIT)
    slope = 0.2 * (np.arange(SHAPE[1]) - 60) + 20
    spots, truth = [], []
    for k in range(320):
        x, y = place(k)
        spot = tracker.track(exposed(light(SHAPE, x, y, 5, 160) + slope, rng, sensor=LIT_EIGHT_BIT))
        if tracker.model is not None:
            spots.append(spot)
            truth.append((x, y))
    assert tracker.model is SpotModel.LEARNED
    # the gradient shifts the Gaussian by a constant, which the profile keeps
    assert scatter_over_claimed(spots[1:], np.array(truth[1:])) == pytest.approx([1, 1], abs=0.25)


@pytest.mark.slow
def test_a_real_beam_moves_as_it_is_moved(shared_data: Path) -> None:
    """Averaged over 5 x 5 pixels, which is faster; the benchmark of real beams takes all of them whole."""
    rng = np.random.default_rng(7)
    real = RealBeam(shared_data / "beams" / "t-510mm.pgm", binned=5)
    tracker = SpotTracker(real.sensor)
    k = 0
    while tracker.model is None:
        tracker.track(real.frame(20 * math.sin(0.06 * k), 3 * math.cos(0.05 * k), rng))
        k += 1
    truth = rng.uniform(-30, 30, (60, 2))
    spots = [tracker.track(real.frame(x, y, rng)) for x, y in truth]
    errors = errors_px(spots, truth)
    scatter, ratio = errors.std(axis=0, ddof=1), scatter_over_claimed(spots, truth)
    assert np.all((ratio > 0.8) & (ratio < 1.3))
    assert np.all(scatter / real.bound_px() < 1.3)  # 1.15, and 1.6 standard deviations of 60 frames
    for axis in (0, 1):
        assert abs(np.polyfit(truth[:, axis], errors[:, axis], 1)[0]) < 0.01


@pytest.mark.parametrize(("side_px", "windows", "lost"), [(20, 32, 1), (200, 25, 0), (400, 16, 0)])
def test_a_large_spot_is_judged_by_fewer_windows_and_a_hidden_one_has_no_part(
    side_px: int, windows: int, lost: int
) -> None:
    choice = ModelChoice(PixelNoise(1.0, 0.0, 255.0, 0.0), lambda *_: None)
    image = np.zeros((side_px, side_px), np.uint8)
    spot = Spot(*[side_px / 9.0] * 9, chi2_per_dof=0.5, flags=0)
    hidden = Spot(*[math.nan] * 10, flags=int(SpotFlag.LOST))
    seen = 0
    while choice.model is None:
        choice.add(hidden if lost and seen == 30 else spot, lambda: (image, (0, 0)))
        seen += 1
    assert choice.model is SpotModel.ONE
    assert seen == 4 * windows + lost
    assert choice.changed(1.1, 257.0)
    assert not choice.changed(1.1, 255.0)
    assert not choice.changed(0.9, 257.0)
