"""Spots with hot pixels, saturation, edges of the sensor, ghosts, tilt, and loss of the spot."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from processing.errors import DataError
from processing.spot import SensorModel, Spot, SpotFlag, SpotTracker
from processing.spot.fit_values import AMPLITUDE, BACKGROUND, PARAMETERS, SIGMA_X, SIGMA_Y, SpotFit
from processing.spot.outcome import significant
from tests.processing.spot.frames import (
    EIGHT_BIT,
    errors_px,
    exposed,
    light,
    pulls,
    rms,
    rms_tolerance,
    tilted_light,
)

Image = NDArray[np.uint8] | NDArray[np.uint16]
Make = Callable[[float, float, np.random.Generator], Image]
N = 96
FRAMES = 60


def run(
    make: Make, *, cold: bool, centre: tuple[float, float] = (48, 48), frames: int = FRAMES
) -> tuple[list[Spot], NDArray[np.float64]]:
    """Spots and their places over frames at random phases."""
    rng = np.random.default_rng(11)
    tracker = SpotTracker(EIGHT_BIT)
    truth = np.array(centre) + rng.uniform(-0.5, 0.5, (frames, 2))
    spots = []
    for x, y in truth:
        if cold:
            tracker.reset()
        spots.append(tracker.track(make(x, y, rng)))
    return spots, truth


def assert_claims_are_true(spots: list[Spot], truth: NDArray[np.float64]) -> None:
    found = pulls(spots, truth)
    assert 1 / rms(found) == pytest.approx(1, abs=0.03 + rms_tolerance(found.size))


def assert_near(spot: Spot, x: float, y: float) -> None:
    assert math.hypot(spot.x_px - x, spot.y_px - y) < 6 * math.hypot(spot.u_x_px, spot.u_y_px)


def hot(x: float, y: float, rng: np.random.Generator) -> Image:
    frame = exposed(light((N, N), x, y, 6, 180), rng)
    for column, row in rng.integers(33, 63, (3, 2)):
        frame[row, column] = 255
    return frame


def plain(x: float, y: float, rng: np.random.Generator) -> Image:
    return exposed(light((N, N), x, y, 6, 180), rng)


def clipped(x: float, y: float, rng: np.random.Generator) -> Image:
    """At four times full scale."""
    return exposed(light((N, N), x, y, 6, 1000), rng)


@pytest.mark.parametrize("cold", [False, True])
@pytest.mark.parametrize(
    ("make", "x", "flag", "share", "limit_px"),
    [
        (hot, 48, SpotFlag.OUTLIERS, 0.95, 6.0e-3),
        (clipped, 48, SpotFlag.SATURATED, 1.0, 3.2e-3),
        (plain, 9, SpotFlag.EDGE, 1.0, 7.5e-3),
    ],
    ids=["hot pixels", "clipped", "cut by the sensor's edge"],
)
def test_a_spoilt_spot_is_flagged_and_stands_near_its_place(
    make: Make, x: float, flag: SpotFlag, share: float, limit_px: float, cold: bool
) -> None:
    spots, truth = run(make, cold=cold, centre=(x, 48))
    assert np.mean([bool(spot.flags & flag) for spot in spots]) >= share
    assert not any(spot.flags & SpotFlag.LOST for spot in spots)
    assert rms(errors_px(spots, truth)) < limit_px * (1 + rms_tolerance(truth.size))
    if make is clipped:
        assert_claims_are_true(spots, truth)


def hollow(x: float, y: float, peak: float) -> NDArray[np.float64]:
    """Light of a beam that is half as bright in its middle as on its rim."""
    v, u = np.mgrid[:120, :120]
    r2 = ((u - x) ** 2 + (v - y) ** 2) / 64.0
    density = (0.5 + r2) * np.exp(-r2)
    return np.asarray(peak * density / density.max())


@pytest.mark.slow
@pytest.mark.parametrize(("peak", "is_clipped"), [(170, False), (300, True)])
@pytest.mark.parametrize("followed", [False, True])
def test_saturated_is_what_the_camera_gave_at_full_scale(
    peak: float, is_clipped: bool, followed: bool
) -> None:
    """The Gaussian that fits a hollow beam's flanks is far beyond full scale where no pixel is."""
    rng = np.random.default_rng(5)
    tracker = SpotTracker(EIGHT_BIT)
    spots = []
    for x, y in 60 + rng.uniform(-0.5, 0.5, (8, 2)):
        if not followed:
            tracker.reset()
        frame = exposed(hollow(x, y, peak), rng)
        assert (frame.max() == 255) == is_clipped
        spots.append(tracker.track(frame))
    assert {bool(spot.flags & SpotFlag.SATURATED) for spot in spots} == {is_clipped}
    assert min(spot.amplitude_dn for spot in spots) > 255


@pytest.mark.slow
@pytest.mark.parametrize("cold", [False, True])
def test_ghost_under_the_flank(cold: bool) -> None:
    def ghost(x: float, y: float, rng: np.random.Generator) -> Image:
        both = light((130, 200), x, y, 12, 180) + light((130, 200), x + 40, y, 12, 4.5)
        return exposed(both, rng)

    spots, truth = run(ghost, cold=cold, centre=(90, 65), frames=30)
    assert all(spot.flags & SpotFlag.MULTIPLE for spot in spots)
    bias = 1e3 * errors_px(spots, truth)[:, 0].mean()
    # 2 mpx, and four standard deviations of a mean of 30 frames at 6 mpx each
    assert abs(bias) < 2.0 + 4 * 6.0 / math.sqrt(30)


@pytest.mark.parametrize("cold", [False, True])
@pytest.mark.parametrize("angle", [0.5, -0.7, 1.2])
def test_tilted_ellipse(angle: float, cold: bool) -> None:
    spots, truth = run(
        lambda x, y, rng: exposed(tilted_light((N, N), x, y, (8, 5), angle, 180), rng), cold=cold, frames=40
    )
    # the first frames that are followed from no tilt need not have it
    last = spots[-1]
    turned = (last.rotation_rad - angle + (math.pi / 2 if last.sigma_x_px < last.sigma_y_px else 0)) % math.pi
    assert min(turned, math.pi - turned) < 0.01
    assert sorted((last.sigma_x_px, last.sigma_y_px)) == pytest.approx([5, 8], rel=0.01)
    assert_claims_are_true(spots, truth)


@pytest.mark.parametrize(("sigma", "peak"), [(3, 20), (6, 20), (12, 80)])
def test_two_hundred_hot_pixels_do_not_fool_the_search(sigma: float, peak: float) -> None:
    rng = np.random.default_rng(int(10 * sigma + peak))
    base = exposed(np.zeros(SHAPE), rng)
    tracker = SpotTracker(EIGHT_BIT)
    for _ in range(6):
        x, y = rng.uniform(100, 1150), rng.uniform(100, 900)
        frame = near_light(x, y, sigma, peak, base, rng)
        frame[rng.integers(0, 1024, 200), rng.integers(0, 1280, 200)] = rng.integers(50, 255, 200)
        tracker.reset()
        spot = tracker.track(frame)
        assert_near(spot, x, y)


@pytest.mark.parametrize("hot_pixels", [0, 200])
def test_no_spot_is_lost_not_invented(hot_pixels: int) -> None:
    rng = np.random.default_rng(5)
    for _ in range(6):
        frame = np.rint(6 + rng.normal(0, 1.5, (480, 640))).astype(np.uint8)
        frame[rng.integers(0, 480, hot_pixels), rng.integers(0, 640, hot_pixels)] = 200
        spot = SpotTracker(EIGHT_BIT).track(frame)
        assert spot.flags == SpotFlag.LOST
        assert all(math.isnan(value) for value in spot[:10])


def test_found_again_after_a_loss_and_after_a_jump() -> None:
    rng = np.random.default_rng(6)
    tracker = SpotTracker(EIGHT_BIT)
    shape = (240, 320)

    def at(x: float, y: float) -> Spot:
        return tracker.track(exposed(light(shape, x, y, 6, 180), rng))

    assert at(80, 100).x_px == pytest.approx(80, abs=0.05)
    assert tracker.track(exposed(np.zeros(shape), rng)).flags & SpotFlag.LOST
    assert at(200, 60).x_px == pytest.approx(200, abs=0.05)
    jumped = at(60, 180)
    assert (jumped.x_px, jumped.y_px) == pytest.approx((60, 180), abs=0.05)


SHAPE = (1024, 1280)


def near_light(x: float, y: float, sigma: float, peak: float, base: Image, rng: np.random.Generator) -> Image:
    """A full frame: the base with a spot exposed into it."""
    frame = base.copy()
    reach = int(6 * sigma)
    column, row, side = int(x) - reach, int(y) - reach, 2 * reach + 1
    frame[row : row + side, column : column + side] = exposed(
        light((side, side), x - column, y - row, sigma, peak), rng
    )
    return frame


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "peak"), [(3, 20), (6, 180), (12, 600)])
def test_knocked_the_spot_is_found_in_the_same_frame(sigma: float, peak: float) -> None:
    """Steps of 8 px a frame, each in another direction: the expected place is up to 16 px wrong."""
    rng = np.random.default_rng([int(sigma), int(peak)])
    base = exposed(np.zeros(SHAPE), rng)
    angle = rng.uniform(0, 2 * math.pi, 25)
    truth = np.array([640.3, 512.6]) + 8 * np.cumsum(np.column_stack((np.cos(angle), np.sin(angle))), axis=0)
    tracker = SpotTracker(EIGHT_BIT)
    spots = []
    for x, y in truth:
        spots.append(tracker.track(near_light(x, y, sigma, peak, base, rng)))
    assert_claims_are_true(spots, truth)
    expected = SpotFlag.SATURATED if peak > 255 else 0
    assert {spot.flags & ~SpotFlag.OUTLIERS for spot in spots} == {expected}


@pytest.mark.parametrize("way", [(1, 0), (-0.6, 0.8)])
def test_knocked_and_moving_on_it_is_followed_again(way: tuple[float, float]) -> None:
    rng = np.random.default_rng(3)
    base = exposed(np.zeros(SHAPE), rng)
    tracker = SpotTracker(EIGHT_BIT)
    for k in (0, 0, *range(1, 20)):
        x, y = 640.3 + 8 * k * way[0], 512.6 + 8 * k * way[1]
        spot = tracker.track(near_light(x, y, 3, 180, base, rng))
        assert_near(spot, x, y)
        assert spot.flags & ~SpotFlag.OUTLIERS == 0


def test_a_reflection_where_the_spot_was_is_not_taken_for_it() -> None:
    rng = np.random.default_rng(4)
    base = exposed(np.zeros(SHAPE), rng)
    tracker = SpotTracker(EIGHT_BIT)
    for x, y in ((640.3, 512.6), (640.2, 512.4)):
        tracker.track(near_light(x, y, 6, 180, base, rng))
    dim = near_light(650.0, 520.0, 6, 40, base, rng)
    spot = tracker.track(near_light(200.4, 800.7, 6, 180, dim, rng))
    assert (spot.x_px, spot.y_px) == pytest.approx((200.4, 800.7), abs=0.05)


@pytest.mark.parametrize("place", [(70.3, 60.8), (640.3, 13.2), (1275.1, 512.0)])
def test_knocked_to_the_edge_it_is_said_to_be_there(place: tuple[float, float]) -> None:
    rng = np.random.default_rng(5)
    wide = (SHAPE[0] + 160, SHAPE[1] + 160)
    base = exposed(np.zeros(wide), rng)
    tracker = SpotTracker(EIGHT_BIT)

    def at(x: float, y: float) -> Spot:
        whole = near_light(x + 80, y + 80, 6, 180, base, rng)
        return tracker.track(np.ascontiguousarray(whole[80:-80, 80:-80]))

    x, y = place
    towards = (640 - x, 512 - y)
    step = 18 / math.hypot(*towards)
    for back in (0.1, 0.05):
        at(x + (step + back) * towards[0], y + (step + back) * towards[1])
    spot = at(x, y)
    assert_near(spot, x, y)
    assert bool(spot.flags & SpotFlag.EDGE) == (not (18 < x < 1261 and 18 < y < 1005))


@pytest.mark.parametrize("read_noise_e", [2.0, 40.0])
def test_noise_alone_is_no_spot_and_a_faint_spot_is_one(read_noise_e: float) -> None:
    """Whatever the sensor's noise: what counts is the light in units of it."""
    rng = np.random.default_rng(6)
    sensor = SensorModel(1.0, read_noise_e, 4095, pedestal_dn=400.0)
    sigma_dn = math.sqrt(sensor.dark_variance_dn2)
    found = []
    for _ in range(20):
        dark = 400 + sigma_dn * rng.standard_normal((60, 80))
        assert SpotTracker(sensor).track(np.rint(dark).astype(np.uint16)).flags & SpotFlag.LOST
        lit = dark + light((60, 80), 40.3, 30.6, 4.0, 5 * sigma_dn)
        spot = SpotTracker(sensor).track(np.rint(lit).astype(np.uint16))
        found.append(not spot.flags & SpotFlag.LOST and abs(spot.x_px - 40.3) < 6 * spot.u_x_px)
    assert np.mean(found) > 0.9


@pytest.mark.parametrize("read_noise_e", [2.0, 40.0])
def test_a_matched_filter_of_four_standard_deviations_decides(read_noise_e: float) -> None:
    """Signal to noise of a Gaussian spot: A sqrt(pi sigma_x sigma_y) over the noise of a pixel."""
    sensor = SensorModel(1.0, read_noise_e, 4095, pedestal_dn=400.0)
    p = np.zeros(PARAMETERS)
    p[[SIGMA_X, SIGMA_Y, BACKGROUND]] = 4.0, 3.0, 400.0
    fit = SpotFit(True, 100.0, 100, 0, 29, 6, False, False)
    for ratio, seen in ((3.9, False), (4.1, True)):
        p[AMPLITUDE] = ratio * math.sqrt(sensor.dark_variance_dn2 / (math.pi * 12))
        assert significant(p, sensor.pixel_noise, fit) is seen
    assert not significant(p, sensor.pixel_noise, fit._replace(outliers=31))


def cut_by(offset: float, *, angle: float = 0.0, blur_px: float = 0.0) -> Make:
    """Frames with an obstacle that covers what lies beyond a line, so far from the middle."""
    y_px, x_px = np.mgrid[:N, :N]
    beyond = (x_px - 48) * math.cos(angle) + (y_px - 48) * math.sin(angle) - offset
    left = 0.5 * (1.0 - np.tanh(beyond / blur_px)) if blur_px else (beyond < 0.0).astype(float)
    return lambda x, y, rng: exposed(left * light((N, N), x, y, 6, 180), rng)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset", "angle", "cold"),
    [(-3.0, 0.0, True), (3.0, 0.0, False), (6.0, 0.5, True), (10.0, 2.2, False), (15.0, 0.0, True)],
)
def test_what_an_obstacle_leaves_of_a_spot_tells_its_place(offset: float, angle: float, cold: bool) -> None:
    spots, truth = run(cut_by(offset, angle=angle), cold=cold, frames=40)
    assert not any(spot.flags & SpotFlag.LOST for spot in spots)
    assert np.mean([bool(spot.flags & SpotFlag.CUT) for spot in spots]) > 0.95
    assert_claims_are_true(spots, truth)


def test_a_spot_of_which_hardly_anything_is_left_is_lost() -> None:
    spots, _ = run(cut_by(-12.0), cold=True, frames=20)
    assert all(spot.flags & SpotFlag.LOST for spot in spots)


@pytest.mark.parametrize(("offset", "blur_px"), [(0.0, 4.0), (3.0, 2.0), (6.0, 4.0), (6.0, 2.0)])
def test_an_obstacle_without_a_sharp_edge_widens_what_is_known_of_the_place(
    offset: float, blur_px: float
) -> None:
    rng = np.random.default_rng(11)
    tracker = SpotTracker(EIGHT_BIT)
    while tracker.model is None:
        tracker.track(plain(*48 + rng.uniform(-0.5, 0.5, 2), rng))
    covered = cut_by(offset, blur_px=blur_px)
    for _ in range(20):
        x, y = 48 + rng.uniform(-0.5, 0.5, 2)
        spot = tracker.track(covered(x, y, rng))
        assert spot.flags & SpotFlag.LOST or abs(spot.x_px - x) < 3.0 * spot.u_x_px


@pytest.mark.parametrize("shape", [(1, 64), (3, 64), (4, 64), (64, 4)])
def test_a_region_too_small_for_a_search_is_refused(shape: tuple[int, int]) -> None:
    """A search reads four rows at once; the fewer rows of such a region would be read beyond their end."""
    with pytest.raises(DataError, match=r"at least 5 x 5 pixels are needed"):
        SpotTracker(EIGHT_BIT).track(np.zeros(shape, np.uint8))
    assert SpotTracker(EIGHT_BIT).track(np.zeros((5, 64), np.uint8)).flags & SpotFlag.LOST
