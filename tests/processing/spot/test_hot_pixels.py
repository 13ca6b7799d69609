"""Hot pixels of a sensor's map are left out of searches and fits, by every model of the beam."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.spot import SensorModel, Spot, SpotFlag, SpotModel, SpotTracker
from tests.processing.spot.frames import (
    LIT_EIGHT_BIT,
    exposed,
    light,
    pulls,
    scatter_over_claimed,
    tilted_light,
)

SHAPE = (96, 110)
WARM_DN = 5.0
"""Less than five standard deviations on the flank of a spot: no outlier, and enough to pull a fit."""


def place(k: int) -> tuple[float, float]:
    return 55 + 14 * math.sin(0.11 * k), 48 + 3 * math.cos(0.08 * k)


def warm(rng: np.random.Generator, share: float = 0.03) -> NDArray[np.float64]:
    """Light that pixels of the upper right half show too much."""
    y, x = np.indices(SHAPE)
    return np.where((rng.random(SHAPE) < share) & (x > y), WARM_DN, 0.0)


def sensors(extra: NDArray[np.float64]) -> tuple[SensorModel, SensorModel]:
    y, x = np.nonzero(extra)
    return LIT_EIGHT_BIT, replace(
        LIT_EIGHT_BIT, hot_pixels_xy=tuple(zip(x.tolist(), y.tolist(), strict=True))
    )


def bias_u(spots: list[Spot], truth: NDArray[np.float64]) -> float:
    """Mean error, in standard uncertainties, where it is largest: of x or y at one of the places."""
    found = pulls(spots, truth)
    means = [found[(truth == at).all(axis=1)].mean(axis=0) for at in np.unique(truth, axis=0)]
    return float(np.abs(means).max())


@pytest.mark.parametrize("sigma_px", [1.7, 5.0])
def test_a_map_takes_the_bias_away(sigma_px: float) -> None:
    rng = np.random.default_rng(5)
    extra = warm(rng, 0.1 if sigma_px < 2 else 0.05)
    without, mapped = (SpotTracker(sensor) for sensor in sensors(extra))
    again = SpotTracker(sensors(extra)[1])
    seen: dict[SpotTracker, list[Spot]] = {without: [], mapped: []}
    truth = np.repeat([place(9 * k) for k in range(4)], 50, axis=0)
    for x, y in truth:
        image = exposed(light(SHAPE, x, y, sigma_px, 120, 1.3 * sigma_px) + extra, rng, sensor=LIT_EIGHT_BIT)
        for tracker, spots in seen.items():
            spots.append(tracker.track(image))
        # the pixels that a record keeps give the same spots, nearly so after a jump
        x0, y0, x1, y1 = mapped.record_window(seen[mapped][-1], SHAPE)
        second = again.track(image[y0:y1, x0:x1].copy(), (x0, y0), SHAPE)
        most_u = 0.05 if len(seen[mapped]) % 50 in (1, 2) else 1e-3
        assert abs(second.x_px - seen[mapped][-1].x_px) < most_u * second.u_x_px
        assert second.flags == seen[mapped][-1].flags
    assert bias_u(seen[without], truth) > 1.0
    assert bias_u(seen[mapped], truth) < 0.5  # three and a half standard deviations of a mean of 50 frames


def test_what_a_map_names_can_have_any_value() -> None:
    """The fit is the same, whatever a pixel that is left out shows."""
    rng = np.random.default_rng(2)
    extra = warm(rng)
    dark, bright = (SpotTracker(sensors(extra)[1]) for _ in range(2))
    for k in range(40):
        image = exposed(light(SHAPE, *place(k), 5, 150), rng, sensor=LIT_EIGHT_BIT)
        first = dark.track(np.where(extra > 0, 0, image).astype(np.uint8))
        second = bright.track(np.where(extra > 0, 255, image).astype(np.uint8))
        assert abs(first.x_px - second.x_px) < 0.02 * first.u_x_px
        assert first.flags == second.flags == 0


def test_a_learned_profile_leaves_them_out_too() -> None:
    rng = np.random.default_rng(4)
    extra = warm(rng)
    tracker, cut = (SpotTracker(sensors(extra)[1]) for _ in range(2))
    spots, truth = [], []
    for k in range(300):
        x, y = place(k)
        beam = light(SHAPE, x, y, 5, 120) + light(SHAPE, x + 4, y - 3, 8, 40)
        image = exposed(beam + 30 * extra, rng, sensor=LIT_EIGHT_BIT)
        spot = tracker.track(image)
        # the map is of the sensor, also for a window
        if k < 180:
            assert abs(cut.track(image[7:, 12:], (12, 7), SHAPE).x_px - spot.x_px) < 0.03 * spot.u_x_px
        if tracker.model is not None:
            spots.append(spot)
            truth.append((x, y))
            assert len(spots) == 1 or spot.flags & ~SpotFlag.LEARNED == 0
    assert tracker.model is SpotModel.LEARNED
    assert np.all(scatter_over_claimed(spots[1:], np.array(truth[1:])) < 1.2)


@pytest.mark.parametrize("angle", [0.7, -0.7])
def test_a_hot_pixel_does_not_move_a_tilted_beam(angle: float) -> None:
    """Filled in is the light of the beam as it is turned: on its long axis much, beside it little."""
    beam = tilted_light(SHAPE, 55.3, 48.6, (7.0, 3.0), angle, 150)
    y, x = np.indices(SHAPE)
    along = math.cos(angle) * (x - 55.3) + math.sin(angle) * (y - 48.6)
    across = math.cos(angle) * (y - 48.6) - math.sin(angle) * (x - 55.3)
    # on one side only, so that wrong values would pull
    extra = np.where((along > 2) & (along < 12) & (abs(across) < 2) & ((x + y) % 3 == 0), 60.0, 0.0)
    tracker = SpotTracker(sensors(extra)[1])
    for _ in range(5):
        spot = tracker.track(np.rint(beam + 6 + extra).astype(np.uint8))
    assert spot.flags == 0
    assert math.hypot(spot.x_px - 55.3, spot.y_px - 48.6) < spot.u_x_px
    assert spot.amplitude_dn == pytest.approx(150, rel=0.01)


def test_a_hot_pixel_beside_two_spots_moves_neither() -> None:
    """The second surface's reflection is light, too: without it in the filling, its flank would pull."""
    rng = np.random.default_rng(7)
    pair = light(SHAPE, 50.2, 48.4, 3, 120) + light(SHAPE, 62.7, 48.9, 3, 50)
    y, x = np.indices(SHAPE)
    extra = np.where((x > 60) & (abs(y - 49) < 5) & ((x + 2 * y) % 4 == 0), 40.0, 0.0)
    plain, mapped = (SpotTracker(sensor) for sensor in sensors(extra))
    for _ in range(30):
        image = exposed(pair, rng, sensor=LIT_EIGHT_BIT)
        first = plain.track(image)
        second = mapped.track(np.where(extra > 0, 255, image).astype(np.uint8))
    assert first.flags == second.flags == SpotFlag.MULTIPLE
    assert abs(first.x_px - second.x_px) < first.u_x_px


def test_a_map_of_pixels_elsewhere_changes_nothing() -> None:
    """Neither where a whole frame is searched nor in the window of a record that holds none of them."""
    rng = np.random.default_rng(8)
    extra = np.zeros(SHAPE)
    extra[[2, 90, 90], [3, 100, 5]] = 1.0
    trackers = [SpotTracker(sensor) for sensor in sensors(extra)]
    for k in range(5):
        image = exposed(light(SHAPE, *place(k), 4, 150), rng, sensor=LIT_EIGHT_BIT)
        plain, mapped = (tracker.track(image) for tracker in trackers)
        assert abs(plain.x_px - mapped.x_px) < 0.01 * plain.u_x_px
    window = image[20:80, 25:90].copy()
    cut = [SpotTracker(sensor).track(window, (25, 20), SHAPE) for sensor in sensors(extra)]
    assert abs(cut[0].x_px - cut[1].x_px) < 0.01 * cut[0].u_x_px
    assert cut[0].x_px == pytest.approx(place(4)[0], abs=0.1)
