"""Types of image, bad input, real beams, and what a run's flags say of its beam."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from processing.errors import DataError
from processing.spot import MAX_CHOICE_FRAMES, BeamUse, SensorModel, Spot, SpotFlag, SpotModel, SpotTracker
from tests.processing.spot.frames import EIGHT_BIT, exposed, light
from tests.processing.spot.moved_beams import COMPACT


def test_window_of_a_lost_spot_is_the_frame() -> None:
    tracker = SpotTracker(EIGHT_BIT)
    lost = tracker.track(np.full((60, 80), 6, dtype=np.uint8))
    assert tracker.record_window(lost, (60, 80)) == (0, 0, 80, 60)


BASE = exposed(light((120, 140), 60.3, 50.7, 5, 150), np.random.default_rng(9))


@settings(max_examples=40, deadline=None)
@given(dx=st.integers(-25, 40), dy=st.integers(-15, 30))
def test_a_shifted_frame_shifts_the_spot(dx: int, dy: int) -> None:
    still = SpotTracker(EIGHT_BIT).track(BASE)
    moved = SpotTracker(EIGHT_BIT).track(np.roll(BASE, (dy, dx), axis=(0, 1)))
    assert moved.x_px - dx == pytest.approx(still.x_px, abs=0.1 * still.u_x_px)
    assert moved.y_px - dy == pytest.approx(still.y_px, abs=0.1 * still.u_y_px)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), ny=st.integers(5, 40), nx=st.integers(5, 40))
def test_any_frame_gives_a_spot_or_none_but_never_nonsense(seed: int, ny: int, nx: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (ny, nx)).astype(np.uint8)
    spot = SpotTracker(EIGHT_BIT).track(image)
    if spot.flags & SpotFlag.LOST:
        assert all(math.isnan(value) for value in spot[:10])
    else:
        assert all(math.isfinite(value) for value in spot[:10])
        assert min(spot.u_x_px, spot.u_y_px, spot.sigma_x_px, spot.sigma_y_px) > 0


def test_read_only_strided_and_mirrored_views_are_the_same_image() -> None:
    image = BASE
    expected = SpotTracker(EIGHT_BIT).track(image)
    read_only = np.frombuffer(image.tobytes(), dtype=np.uint8).reshape(image.shape)
    wide = np.zeros((120, 280), dtype=np.uint8)
    wide[:, ::2] = image
    for view in (read_only, wide[:, ::2], image[::-1, ::-1].copy()[::-1, ::-1], np.asfortranarray(image)):
        assert SpotTracker(EIGHT_BIT).track(view) == expected
    assert not read_only.flags.writeable


def test_an_image_that_is_none_is_refused() -> None:
    for shape, kind in (((3, 20, 20), np.uint8), ((20, 20), np.float64), ((20, 20), np.int16)):
        with pytest.raises(DataError, match=r"image has shape"):
            SpotTracker(EIGHT_BIT).track(np.zeros(shape, kind))


def test_bad_settings_are_refused() -> None:
    good = {"gain_e_per_dn": 1, "read_noise_e": 1, "full_scale_dn": 255}
    for name, value in (("gain_e_per_dn", 0), ("read_noise_e", -1), ("full_scale_dn", 0), ("prnu", -0.01)):
        with pytest.raises(ValidationError, match=name):
            TypeAdapter(SensorModel).validate_python({**good, name: value})


@pytest.mark.parametrize("name", COMPACT)
def test_interleaved_rows_of_a_real_beam_agree(shared_data: Path, name: str) -> None:
    image = cv2.imread(str(shared_data / "beams" / name), cv2.IMREAD_UNCHANGED)
    full_scale = float(np.iinfo(image.dtype).max)
    sensor = SensorModel(gain_e_per_dn=39.2 if image.dtype == np.uint8 else 1.0, read_noise_e=7.0,
                         full_scale_dn=full_scale, pedestal_dn=float(np.median(image)))  # fmt: skip
    halves: list[Spot] = []
    for start in (0, 1):
        spot = SpotTracker(sensor).track(np.ascontiguousarray(image[start::2]))
        assert not spot.flags & SpotFlag.LOST
        halves.append(spot)
    even, odd = halves
    assert abs(even.x_px - odd.x_px) < 2 * math.hypot(even.u_x_px, odd.u_x_px)
    # odd rows lie half a row of the halved image further down
    assert abs(even.y_px - odd.y_px - 0.5) < 2 * math.hypot(even.u_y_px, odd.u_y_px)
    followed = SpotTracker(sensor)
    first, second = followed.track(image), followed.track(image)
    assert second.x_px == pytest.approx(first.x_px, abs=0.1 * first.u_x_px)


GOOD, POOR, LOST = 0, int(SpotFlag.POOR_FIT), int(SpotFlag.LOST)
LEARNED, TWO = int(SpotFlag.LEARNED), int(SpotFlag.MULTIPLE)


def used(*stretches: tuple[int, int]) -> BeamUse:
    """Of so many frames with each flag; passed in pieces, which must not matter."""
    flags = np.repeat([flag for _, flag in stretches], [count for count, _ in stretches])
    use, pieces = BeamUse(), BeamUse()
    use.take(np.arange(len(flags)), flags)
    for start in range(0, len(flags), 50):
        pieces.take(np.arange(start, min(start + 50, len(flags))), flags[start : start + 50])
    assert vars(use) == vars(pieces)
    return use


def test_frames_before_the_first_learned_profile_are_counted_and_not_judged() -> None:
    use = used((147, POOR), (5000, LEARNED))
    assert (use.model, use.since_frame, use.changes) == (SpotModel.LEARNED, 147, 0)
    assert use.flags[SpotFlag.POOR_FIT] == use.choosing_frames == 147
    assert (use.judged_frames, use.poor_frames) == (5000, 0)


def test_a_beam_that_stops_fitting_in_the_run_is_judged_and_its_change_is_told() -> None:
    late = used((3000, GOOD), (400, POOR), (2000, LEARNED))
    assert (late.model, late.since_frame, late.changes) == (SpotModel.LEARNED, 3400, 1)
    assert (late.judged_frames, late.poor_frames, late.choosing_frames) == (5400, 400, 0)
    again = used((147, POOR), (1000, LEARNED), (300, LEARNED | POOR), (147, POOR), (900, LEARNED))
    assert (again.model, again.since_frame, again.changes) == (SpotModel.LEARNED, 1594, 2)
    assert again.poor_frames == 447


def test_a_short_run_that_never_fits_is_judged_as_a_whole() -> None:
    use = used((MAX_CHOICE_FRAMES, POOR))
    assert use.judged_frames == use.poor_frames == MAX_CHOICE_FRAMES


def test_single_frames_that_the_model_missed_are_no_change() -> None:
    use = used((10, LOST), (200, TWO), (3, GOOD), (20, TWO), (60, GOOD), (500, TWO))
    assert (use.model, use.since_frame, use.changes) == (SpotModel.TWO, 10, 0)
    assert use.flags[SpotFlag.LOST] == 10
    assert used((1, TWO), (400, GOOD)).text == "one Gaussian since frame 1"
    assert used((5, LOST)).text == "no spot"
